//! TIFF with floating-point samples or LogLuv, of any writer.
//!
//! In: a file. Out: the radiance of its first picture, RGB or grey, and the metadata of its tags. Supported: strips and
//! tiles, 16, 32 and 64 bits, every compression and predictor of the `tiff` crate; LogLuv and LogL in strips. Integers
//! are rejected, because they are encoded for a display. Cost: the crate, which decompresses one strip after the other.
//! Source: see [`crate::write::tiff`] and `crate::write::tiff::logluv`.

use super::Contents;
use super::orientation::Turn;
use crate::bracket::colour::{Found, NeutralXyz, Primaries, Profile};
use crate::error::{Error, Result};
use crate::intake;
use crate::limits::{self, Limits};
use crate::merge::radiance::calibration::Factor;

use crate::pixel::logluv;
use crate::plane::Plane;
use crate::tiff_file::{self, Picture, refusal};
use crate::write::Metadata;
use std::io::Cursor;
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult, Limits as Buffers};
use tiff::tags::{IfdPointer, Tag};

/// The tag for the luminance of the stored value 1, in cd/m2 (StoNits is its name in libtiff).
const STONITS: Tag = Tag::Unknown(37439);
const WHITE_POINT: Tag = Tag::Unknown(318);
const CHROMATICITIES: Tag = Tag::Unknown(319);

/// Whether a TIFF contains floats or LogLuv; a TIFF with integers is a picture.
///
/// # Errors
/// [`Error::Read`]; [`Error::Decode`] if its directory is damaged.
pub(super) fn holds_radiance(path: &Path, limits: &Limits) -> Result<bool> {
    let mut bytes = intake::whole(path, limits.most_bytes())?;
    let mut look = || -> Parsed<bool> {
        prepare(&mut bytes)?;
        let mut decoder = Decoder::new(Cursor::new(bytes.as_slice())).map_err(refusal)?;
        let compression = decoder.find_tag_unsigned::<u32>(Tag::Compression).map_err(refusal)?;
        let formats = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).map_err(refusal)?.unwrap_or_default();
        Ok(matches!(compression, Some(34676 | 34677)) || formats.first() == Some(&3))
    };
    look().map_err(|reason| Error::Decode { path: path.to_owned(), format: "TIFF", reason })
}

/// Changes `bytes` so that the crate reads them correctly. Returns the picture and its photometric interpretation.
fn prepare(bytes: &mut [u8]) -> Parsed<(Picture, Option<u16>)> {
    let picture = tiff_file::picture(Cursor::new(&*bytes))?;
    tiff_file::put_first(bytes, picture);
    tiff_file::order_bits(bytes);
    Ok((picture, tiff_file::as_grey(bytes)))
}

type Parsed<T> = std::result::Result<T, String>;
type Bytes<'a> = Decoder<Cursor<&'a [u8]>>;

/// Reads the picture in the `bytes` of a TIFF. LogLuv is multiplied by its StoNits and converted to RGB of BT.2020.
/// Floats without chromaticities and profile are assumed to be BT.709. Values may be any floats.
///
/// # Errors
/// The reason, for damaged files, files with integers, and files that exceed `limits`.
pub fn parse(mut bytes: Vec<u8>, limits: &Limits) -> Parsed<Contents> {
    let (picture, photometric) = prepare(&mut bytes)?;
    let bytes = bytes.as_slice();
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(refusal)?;
    let (width, height) = decoder.dimensions().map_err(refusal)?;
    let (width, height) = (width as usize, height as usize);
    limits.check_size(width, height)?;
    let compression = decoder.find_tag_unsigned::<u32>(Tag::Compression).map_err(refusal)?.unwrap_or(1);
    let pixels = width as u64 * height as u64;
    let samples = u64::from(decoder.find_tag_unsigned::<u16>(Tag::SamplesPerPixel).map_err(refusal)?.unwrap_or(1));
    let depths = decoder.find_tag_unsigned_vec::<u16>(Tag::BitsPerSample).map_err(refusal)?.unwrap_or_default();
    let stored = samples * u64::from(depths.first().copied().unwrap_or(1)).div_ceil(8);
    // Samples other than colour and alpha are not used, and there may be up to 65535 samples per pixel.
    if samples > 8 {
        return Err(format!("it has {samples} channels; radiance has 3 or 1"));
    }
    let is_logluv = matches!(compression, 34676 | 34677);
    let unpacked = if is_logluv { 0 } else { pixels.saturating_mul(stored) };
    // LogLuv encodes each of the 2 or 4 bytes of the pixels of a row separately, at best as runs of 129 values in 2
    // bytes. So a byte of the file stands for at most 65 pixels.
    let least = if is_logluv { pixels / 65 } else { unpacked };
    limits::check_length(bytes.len(), least, if is_logluv { 1 } else { limits::tiff_packing(compression) })?;
    let needed = unpacked + pixels * (4 * samples + 12) + bytes.len() as u64;
    limits.check_memory((width, height), needed)?;
    let mut buffers = Buffers::default();
    let unpacked = usize::try_from(unpacked).unwrap_or(usize::MAX);
    buffers.decoding_buffer_size = buffers.decoding_buffer_size.max(unpacked);
    // One strip may contain the whole picture; tiles extend beyond it by less than a tile.
    buffers.intermediate_buffer_size = buffers.intermediate_buffer_size.max(unpacked);
    decoder = decoder.with_limits(buffers);
    let mut metadata = metadata(&mut decoder);
    let mut pixels = if is_logluv {
        metadata.primaries = Primaries::BT2020;
        logluv(&mut decoder, bytes, (width, height), compression == 34677)?
    } else {
        floats(&mut decoder, photometric)?
    };
    if pixels.len() < width * height {
        return Err(format!("it contains only {} of {} pixels; copy it again", pixels.len(), width * height));
    }
    pixels.truncate(width * height);
    let turn = turn(decoder.find_tag_unsigned::<u16>(Tag::Orientation).ok().flatten().unwrap_or(1));
    let pixels = turn.upright(Plane::from_vec(width, height, pixels));
    let mut contents = Contents::new(pixels, metadata);
    contents.set_unit("StoNits", number(&mut decoder, STONITS));
    if let (true, Some(unit)) = (is_logluv, contents.metadata.cd_m2_per_unit) {
        // Multiplied by StoNits, the values are in cd/m2.
        contents.metadata.cd_m2_per_unit = Some(Factor::ONE);
        contents.metadata.exposure_scale = Factor::ONE.over(unit).unwrap_or(Factor::ONE);
    }
    if !is_logluv && matches!(samples, 2 | 4..) {
        contents.unread.push("alpha".to_owned());
    }
    let others = (0..picture.count).filter(|&number| number != picture.index);
    contents.unread.extend(others.map(|number| format!("image {}", number + 1)));
    Ok(contents)
}

/// Returns the order of the stored lines for the tag Orientation, the position of the first row and the first column
/// (TIFF 6.0, section 8).
fn turn(orientation: u16) -> Turn {
    Turn {
        transposed: matches!(orientation, 5..=8),
        mirrored: matches!(orientation, 2 | 3 | 6 | 7),
        flipped: matches!(orientation, 3 | 4 | 7 | 8),
    }
}

fn floats(decoder: &mut Bytes, photometric: Option<u16>) -> Parsed<Vec<[f32; 3]>> {
    let wanted = match photometric {
        Some(0 | 1) => 1,
        Some(2) => 3,
        Some(5) => return Err("it is CMYK; convert it to RGB first".into()),
        _ => return Err("it is neither RGB nor grey; convert it to RGB first".into()),
    };
    let values: Vec<f32> = match tiff_file::samples(decoder, wanted)? {
        DecodingResult::F16(v) => v.into_iter().map(|v| v.to_f32()).collect(),
        DecodingResult::F32(v) => v,
        DecodingResult::F64(v) => v.into_iter().map(|v| v as f32).collect(),
        _ => {
            return Err(
                "it is a picture for display: its pixel values are integers; those of a radiance map are floating-point or LogLuv".into()
            );
        }
    };
    Ok(match photometric {
        // 0 is white, and 1 black.
        Some(0) => values.into_iter().map(|v| [1.0 - v; 3]).collect(),
        Some(1) => values.into_iter().map(|v| [v; 3]).collect(),
        _ => values.as_chunks::<3>().0.to_vec(),
    })
}

/// Reads strips of LogLuv or, with one sample per pixel, of LogL.
fn logluv(decoder: &mut Bytes, bytes: &[u8], (width, height): (usize, usize), packed: bool) -> Parsed<Vec<[f32; 3]>> {
    let list = |decoder: &mut Bytes, tag| decoder.get_tag_u64_vec(tag).map_err(refusal);
    if decoder.find_tag(Tag::TileWidth).map_err(refusal)?.is_some() {
        return Err("it is LogLuv in tiles; convert it to strips first, for example with `tiffcp -s`".into());
    }
    let grey = decoder.find_tag_unsigned::<u16>(Tag::SamplesPerPixel).map_err(refusal)?.unwrap_or(1) == 1;
    let rows = decoder.find_tag_unsigned::<u32>(Tag::RowsPerStrip).map_err(refusal)?.unwrap_or(u32::MAX) as usize;
    let (offsets, counts) = (list(decoder, Tag::StripOffsets)?, list(decoder, Tag::StripByteCounts)?);
    let neutral = NeutralXyz::of(&Primaries::BT2020);
    let mut pixels = Vec::new();
    let mut row = vec![0; width];
    for (i, (&offset, &count)) in offsets.iter().zip(&counts).enumerate() {
        let cut = || format!("it is damaged or truncated in strip {i}; copy it again");
        let start = usize::try_from(offset).map_err(|_| cut())?;
        let strip = usize::try_from(count).ok().and_then(|n| bytes.get(start..start.checked_add(n)?));
        let mut strip = strip.ok_or_else(cut)?;
        for _ in 0..rows.min(height - pixels.len() / width) {
            if packed {
                let (line, rest) = strip.split_at_checked(3 * width).ok_or_else(cut)?;
                for (code, b) in row.iter_mut().zip(line.chunks_exact(3)) {
                    *code = u32::from_be_bytes([0, b[0], b[1], b[2]]);
                }
                strip = rest;
            } else {
                logluv::take_row(&mut strip, &mut row, if grey { 2 } else { 4 }).ok_or_else(cut)?;
            }
            pixels.extend(row.iter().map(|&code| match (grey, packed) {
                (true, _) => [logluv::luminance16(code) as f32; 3],
                (false, true) => neutral.to_rgb(logluv::decode24(code)),
                (false, false) => neutral.to_rgb(logluv::decode32(code)),
            }));
        }
    }
    Ok(pixels)
}

/// Reads the metadata in the tags; tags that cannot be read are skipped.
fn metadata(decoder: &mut Bytes) -> Metadata {
    let mut metadata = Metadata::default();
    let mut text = |tag| decoder.get_tag_ascii_string(tag).ok().map(|t| t.trim_matches(['\0', ' ']).to_owned());
    metadata.capture.make = text(Tag::Make);
    metadata.capture.model = text(Tag::Model);
    metadata.capture.date = text(Tag::DateTime);
    metadata.comments.extend(text(Tag::ImageDescription).filter(|t| !t.is_empty()));
    let chromaticities = numbers(decoder, CHROMATICITIES).zip(numbers(decoder, WHITE_POINT));
    let stated = match chromaticities.as_ref().map(|(rgb, white)| (rgb.as_slice(), white.as_slice())) {
        Some((&[rx, ry, gx, gy, bx, by], &[wx, wy])) => {
            Some(Primaries { red: [rx, ry], green: [gx, gy], blue: [bx, by], white: [wx, wy] })
        }
        _ => None,
    };
    let by_profile = || match Profile::parse(decoder.get_tag_u8_vec(Tag::IccProfile).ok()?) {
        Found::Rgb(profile) => profile.primaries,
        _ => None,
    };
    let sound = stated.filter(|p| p.to_xyz().is_some());
    metadata.primaries = sound.or_else(by_profile).or(stated).unwrap_or(Primaries::SRGB);
    if let Ok(pointer) = decoder.get_tag_u64(Tag::ExifDirectory) {
        exif(decoder, IfdPointer(pointer), &mut metadata);
    }
    metadata
}

fn exif(decoder: &mut Bytes, pointer: IfdPointer, metadata: &mut Metadata) {
    let Ok(directory) = decoder.read_directory(pointer) else { return };
    let mut tags = decoder.read_directory_tags(&directory);
    let mut find = |tag: u16| tags.find_tag(Tag::Unknown(tag)).ok().flatten();
    let (time, f_number, iso, length) = (find(33434), find(33437), find(34855), find(37386));
    let (date, lens) = (find(36867), find(42036));
    metadata.time_s = time.and_then(|v| fractions(v).pop());
    metadata.f_number = f_number.and_then(|v| fractions(v).pop());
    metadata.iso = iso.and_then(|v| v.into_u32().ok()).map(f64::from);
    metadata.capture.focal_length_mm = length.and_then(|v| fractions(v).pop());
    let text = |v: Option<tiff::decoder::ifd::Value>| v.and_then(|v| v.into_string().ok());
    metadata.capture.date = text(date).or(metadata.capture.date.take());
    metadata.capture.lens = text(lens);
}

/// Returns the numbers of a tag of any numeric type.
fn numbers(decoder: &mut Bytes, tag: Tag) -> Option<Vec<f64>> {
    Some(fractions(decoder.find_tag(tag).ok()??))
}

fn number(decoder: &mut Bytes, tag: Tag) -> Option<f64> {
    numbers(decoder, tag)?.first().copied()
}

fn fractions(value: tiff::decoder::ifd::Value) -> Vec<f64> {
    use tiff::decoder::ifd::Value;
    match value {
        Value::List(values) => values.into_iter().flat_map(fractions).collect(),
        Value::Rational(n, d) => vec![f64::from(n) / f64::from(d)],
        Value::Float(v) => vec![f64::from(v)],
        Value::Double(v) => vec![v],
        other => other.into_u64().map(|v| v as f64).into_iter().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::RadianceMap;
    use crate::write::tiff::Writer;
    use crate::write::{Pending, commit, push_all};
    use tiff::encoder::colortype::{Gray32Float, RGB8, RGB32Float, RGB64Float};
    use tiff::encoder::{Compression, DeflateLevel, TiffEncoder};

    fn parsed(bytes: Vec<u8>) -> Parsed<(RadianceMap, Metadata)> {
        parse(bytes, &Limits::default()).map(|contents| (contents.map, contents.metadata))
    }

    fn picture() -> Plane<[f32; 3]> {
        Plane::from_rows(37, 130, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [x as f32 * 0.1, y as f32 - 3.0, 1e-9 * (x * y) as f32];
            }
        })
    }

    #[test]
    fn own_files_are_read_back_exactly_with_metadata() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.tif");
        let mut metadata = Metadata {
            time_s: Some(1.0 / 30.0),
            f_number: Some(5.6),
            iso: Some(400.0),
            primaries: Primaries::PROPHOTO,
            cd_m2_per_unit: Some(Factor::ONE),
            comments: vec!["by hand".into()],
            ..Metadata::default()
        };
        metadata.capture.model = Some("M".into());
        metadata.capture.lens = Some("EF 50".into());
        metadata.capture.date = Some("2009:07:11 12:34:56".into());
        metadata.capture.focal_length_mm = Some(50.0);
        let writer = Writer::<f32>::new(Pending::create(&path).unwrap(), (37, 130), &metadata).unwrap();
        commit(vec![push_all(Box::new(writer), &picture()).unwrap().file], false).unwrap();
        let (map, back) = crate::read::read(&path).unwrap();
        assert!(map.pixels == picture());
        assert_eq!(back, metadata);
        let bytes = std::fs::read(&path).unwrap();
        for cut in [bytes.len() / 2, 10, 300] {
            assert!(parsed(bytes[..cut].to_vec()).is_err(), "cut at {cut}");
        }
    }

    type Write<'a> = dyn Fn(&mut TiffEncoder<Cursor<&mut Vec<u8>>>) + 'a;

    #[test]
    fn other_writers_floats_are_read_and_their_integers_refused() {
        let packed = |compression, write: &Write| {
            let mut bytes = Vec::new();
            write(&mut TiffEncoder::new(Cursor::new(&mut bytes)).unwrap().with_compression(compression));
            bytes
        };
        let file = |write: &Write| packed(Compression::Uncompressed, write);
        let picture = picture();
        let values = picture.as_slice().as_flattened();
        for compression in [Compression::Uncompressed, Compression::Lzw, Compression::Deflate(DeflateLevel::Fast)] {
            let rgb = packed(compression, &|encoder| {
                let mut image = encoder.new_image::<RGB32Float>(37, 130).unwrap();
                image.encoder().write_tag(Tag::Orientation, 3u16).unwrap();
                image.rows_per_strip(16).unwrap();
                image.write_data(values).unwrap();
            });
            let (map, metadata) = parsed(rgb).unwrap();
            // Rotated by 180 degrees.
            assert!(map.pixels.as_slice().iter().rev().eq(picture.as_slice()));
            assert_eq!(metadata.primaries, Primaries::SRGB);
        }
        let doubles: Vec<f64> = values.iter().map(|&v| f64::from(v)).collect();
        let wide = file(&|encoder| encoder.write_image::<RGB64Float>(37, 130, &doubles).unwrap());
        assert!(parsed(wide).unwrap().0.pixels == picture);
        let grey = file(&|encoder| encoder.write_image::<Gray32Float>(37, 130, &values[..37 * 130]).unwrap());
        assert_eq!(parsed(grey).unwrap().0.pixels.at(1, 0), [values[1]; 3]);
        let codes = file(&|encoder| encoder.write_image::<RGB8>(2, 1, &[1, 2, 3, 4, 5, 6]).unwrap());
        assert!(parsed(codes).unwrap_err().contains("are integers"));
    }

    /// TIFF 6.0's eight orientations of a 2 x 3 picture whose stored pixels are numbered by rows; the expected orders
    /// are written by hand.
    #[test]
    fn orientations_are_those_of_the_standard() {
        let upright: [(u16, [u8; 6]); 8] = [
            (1, [0, 1, 2, 3, 4, 5]),
            (2, [1, 0, 3, 2, 5, 4]),
            (3, [5, 4, 3, 2, 1, 0]),
            (4, [4, 5, 2, 3, 0, 1]),
            (5, [0, 2, 4, 1, 3, 5]),
            (6, [4, 2, 0, 5, 3, 1]),
            (7, [5, 3, 1, 4, 2, 0]),
            (8, [1, 3, 5, 0, 2, 4]),
        ];
        for (orientation, expected) in upright {
            let stored = Plane::from_vec(2, 3, (0..6u8).collect());
            assert_eq!(turn(orientation).upright(stored).as_slice(), expected, "{orientation}");
        }
    }
}
