//! Decodes TIFF files: grey, palettes, RGB and CMYK, at 8 or 16 bits, in strips, tiles or planes.
//!
//! In: the file. Out: the first image that is not a thumbnail, as RGB at the depth of the file; palettes and depths
//! below 8 bits become 8 bits, extra samples are dropped. Cost: the `tiff` crate, and two copies. Source: TIFF 6.0
//! (sections 4 to 6, 8, 16 and 18); libtiff, `tif_getimage.c`, for colour maps of 8 bit.

use super::{Found, Reason, Stored, cmyk_to_rgb, to_rgb};
use crate::bracket::Samples;
use crate::bracket::raw::{self, Developed};
use crate::limits::{self, Limits as Allowed};
use crate::tiff_file::{self, Directories, Picture, refusal};
use exif::experimental::Writer;
use exif::{Context, Field, In};
use std::io::{Cursor, Read, Seek};
use tiff::Directory;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{IfdPointer, Tag};

/// Size in bytes of the file header, including the offset of the first directory.
const HEADER: usize = 8;

const ICC: Tag = Tag::Unknown(34675);

const FLOATING_POINT: &str = "it contains floating-point values, which are linear already and not from a camera; \
                              give the camera's own 8- or 16-bit pictures";

/// Decodes the first image of a TIFF file that is not a thumbnail.
pub(super) fn decode(mut bytes: Vec<u8>, allowed: &Allowed) -> Result<Stored, Reason> {
    let picture = tiff_file::picture(Cursor::new(&bytes))?;
    if picture.is_dng {
        return developed(bytes, allowed);
    }
    refuse_raw(picture)?;
    let header = bytes[..HEADER].to_vec();
    tiff_file::put_first(&mut bytes, picture);
    tiff_file::order_bits(&mut bytes);
    let photometric = tiff_file::as_grey(&mut bytes);
    let mut decoder = Decoder::new(Cursor::new(&bytes)).map_err(refusal)?;
    let (width, height) = decoder.dimensions().map_err(refusal)?;
    let (width, height) = (width as usize, height as usize);
    allowed.check_size(width, height)?;
    let kind = Kind::of(&mut decoder, photometric)?;
    let pixels = width as u64 * height as u64;
    let compression = decoder.find_tag_unsigned::<u32>(Tag::Compression).ok().flatten().unwrap_or(1);
    let packed = pixels.saturating_mul(kind.samples * kind.depth) / 8;
    limits::check_length(bytes.len(), packed, limits::tiff_packing(compression))?;
    // There are three versions of the samples: first as stored, then without extra samples, then as RGB. At any time,
    // memory holds at most two of them.
    let wanted = kind.colour.samples();
    let (each, stored) = (kind.depth.div_ceil(8), pixels.saturating_mul(kind.samples * kind.depth.div_ceil(8)));
    let needed = stored.saturating_add(pixels * each * wanted.max(3) as u64 + bytes.len() as u64);
    allowed.check_memory((width, height), needed)?;
    // The size was checked above, so the decoder is allowed the memory that the image needs.
    let mut limits = Limits::default();
    let stored = usize::try_from(stored).unwrap_or(usize::MAX);
    limits.decoding_buffer_size = limits.decoding_buffer_size.max(stored);
    limits.intermediate_buffer_size = limits.intermediate_buffer_size.max(stored);
    limits.ifd_value_size = limits.ifd_value_size.max(64 << 20);
    let mut decoder = decoder.with_limits(limits);
    let icc = decoder.find_tag(ICC).ok().flatten().and_then(|v| v.into_u8_vec().ok());

    let samples = match tiff_file::samples(&mut decoder, wanted)? {
        DecodingResult::U8(v) => Samples::Eight(kind.colour.eight(v, kind.depth)),
        DecodingResult::U16(v) => Samples::Sixteen(kind.colour.rgb(v)),
        _ => return Err(FLOATING_POINT.into()),
    };
    if samples.len() != 3 * width * height {
        return Err("its image data does not match its size; copy the file again".into());
    }
    bytes[..HEADER].copy_from_slice(&header);
    Ok(Stored {
        width,
        height,
        samples,
        decoding: needed,
        // kamadak-exif cannot read BigTIFF (version number 43).
        exif: Some(bytes).filter(|b| !b[2..4].contains(&43)),
        directory: picture.index as u16,
        icc,
        has_alpha: kind.has_alpha,
        raw: None,
        notes: Vec::new(),
    })
}

/// Rejects camera raw files other than DNG: TIFF files that contain a sensor mosaic or only thumbnails.
fn refuse_raw(picture: Picture) -> Result<(), Reason> {
    if picture.is_raw {
        return Err("it looks like a camera raw file (NEF, ARW, ...); convert it to DNG, for example with Adobe's DNG Converter".into());
    }
    Ok(())
}

/// Develops a DNG file.
fn developed(bytes: Vec<u8>, allowed: &Allowed) -> Result<Stored, Reason> {
    let Developed { width, height, samples, needed, profile, raw } = raw::develop(&bytes, allowed)?;
    Ok(Stored {
        width,
        height,
        samples: Samples::Sixteen(samples),
        decoding: needed,
        exif: Some(bytes),
        directory: 0,
        icc: profile.map(|profile| profile.icc),
        has_alpha: false,
        raw: Some(raw),
        notes: Vec::new(),
    })
}

/// Colour and depth of the samples.
struct Kind {
    colour: Colour,
    /// Samples per pixel.
    samples: u64,
    /// Bits per sample.
    depth: u64,
    has_alpha: bool,
}

impl Kind {
    /// Reads the kind of the current image of `decoder`. `photometric` is the photometric interpretation of the image.
    fn of<R: Read + Seek>(decoder: &mut Decoder<R>, photometric: Option<u16>) -> Result<Kind, Reason> {
        let mut numbers = |tag| decoder.find_tag_unsigned_vec::<u16>(tag).ok().flatten().unwrap_or_default();
        // 3 is "floating point" (TIFF 6.0, section 19).
        if numbers(Tag::SampleFormat).first() == Some(&3) {
            return Err(FLOATING_POINT.into());
        }
        let depth = numbers(Tag::BitsPerSample).first().copied().unwrap_or(1);
        let samples = numbers(Tag::SamplesPerPixel).first().copied().unwrap_or(1);
        let unsupported = |what: &str| Err(format!("it is {what}, which is not supported; save it as grey or RGB"));
        let colour = match photometric {
            Some(0) => Colour::InverseGrey,
            Some(1) => Colour::Grey,
            Some(2) => Colour::Rgb,
            Some(3) => Colour::Palette(numbers(Tag::ColorMap)),
            Some(5) => Colour::Cmyk,
            Some(6) => return unsupported("YCbCr"),
            Some(8..=10) => return unsupported("CIE L*a*b*"),
            Some(32844 | 32845) => return unsupported("LogLuv"),
            _ => return unsupported("an image of unknown colours (PhotometricInterpretation)"),
        };
        let is_palette = matches!(colour, Colour::Palette(_));
        if depth > 8 && (depth != 16 || is_palette) {
            let samples = if is_palette { "palette" } else { "samples" };
            return Err(format!(
                "its {samples} of {depth} bits are not supported; save it as grey or RGB with 8 or 16 bits"
            ));
        }
        // If ExtraSamples does not describe the extra samples, programs use the first of them as alpha.
        let extra = usize::from(samples).saturating_sub(colour.samples());
        let described = numbers(Tag::ExtraSamples);
        let has_alpha = extra > described.len() || described.iter().any(|kind| matches!(kind, 1 | 2));
        Ok(Kind { colour, samples: samples.into(), depth: depth.into(), has_alpha })
    }
}

/// Colour model of the samples of a pixel, without extra samples.
enum Colour {
    Grey,
    /// Grey whose value 0 is white.
    InverseGrey,
    Rgb,
    /// The colour map: all red values, then all green values, then all blue values.
    Palette(Vec<u16>),
    Cmyk,
}

impl Colour {
    /// Samples per pixel.
    fn samples(&self) -> usize {
        match self {
            Colour::Grey | Colour::InverseGrey | Colour::Palette(_) => 1,
            Colour::Rgb => 3,
            Colour::Cmyk => 4,
        }
    }

    /// Converts 8-bit samples to interleaved RGB. Samples that have fewer bits in the file (`depth`) are already scaled
    /// to the full range.
    fn eight(&self, values: Vec<u8>, depth: u64) -> Vec<u8> {
        let Colour::Palette(map) = self else { return self.rgb(values) };
        let last = (1 << depth.min(8)) - 1;
        let shift = if map.iter().all(|&v| v < 256) { 0 } else { 8 };
        let entry = |index: usize, c: usize| map.get(c * (last + 1) + index).map_or(0, |v| (v >> shift) as u8);
        let colours: Vec<[u8; 3]> = (0..=last).map(|index| [0, 1, 2].map(|c| entry(index, c))).collect();
        values.iter().flat_map(|&v| colours[usize::from(v) * last / 255]).collect()
    }

    /// Converts samples other than palette indices to interleaved RGB.
    fn rgb<T: Copy + Into<u32> + TryFrom<u32> + Bounded>(&self, values: Vec<T>) -> Vec<T> {
        match self {
            Colour::Rgb => values,
            Colour::Cmyk => cmyk_to_rgb(&values, T::MAX),
            Colour::Grey | Colour::Palette(_) => to_rgb(values, 1),
            Colour::InverseGrey => {
                let inverse = |v: T| T::try_from(T::MAX - v.into()).unwrap_or(v);
                to_rgb(values.into_iter().map(inverse).collect(), 1)
            }
        }
    }
}

/// The largest pixel value of a sample type.
trait Bounded {
    const MAX: u32;
}

impl Bounded for u8 {
    const MAX: u32 = 255;
}

impl Bounded for u16 {
    const MAX: u32 = 65535;
}

/// Reads the size and the EXIF of the first image that is not a thumbnail, by seeking to its directories. Also returns
/// why `decode` would reject this kind of image.
pub(super) fn head<R: Read + Seek>(mut reader: R, wanted: &[exif::Tag]) -> Result<Found, Reason> {
    let picture = tiff_file::picture(&mut reader)?;
    if picture.is_dng {
        return head_of_dng(reader, wanted);
    }
    let index = picture.index;
    let refused = refuse_raw(picture).err();
    reader.rewind().map_err(|e| e.to_string())?;
    let mut decoder = Decoder::new(reader).map_err(refusal)?;
    let first = decoder.ifd_pointer().filter(|_| index > 0);
    decoder.seek_to_image(index).map_err(refusal)?;
    let (width, height) = decoder.dimensions().map_err(refusal)?;
    let depths = decoder.find_tag_unsigned_vec::<u16>(Tag::BitsPerSample).ok().flatten().unwrap_or_default();
    let photometric = decoder.find_tag_unsigned::<u16>(Tag::PhotometricInterpretation).ok().flatten();
    let refused = refused.or(Kind::of(&mut decoder, photometric).err());
    let depth = depths.first().map_or(8, |&bits| bits.clamp(8, 64) as u8);
    let (width, height) = (width as usize, height as usize);
    // This tag is also read from a BigTIFF, whose EXIF is not read.
    let software = decoder.get_tag_ascii_string(Tag::Software).ok();
    let exif = if is_big(&mut decoder) { None } else { fields(&mut decoder, first, wanted) };
    Ok(Found { width, height, depth, exif, software, refused })
}

/// The same for a DNG file, whose mosaic the decoder of other TIFF files rejects. What holds for the whole file is in
/// its first directory.
fn head_of_dng<R: Read + Seek>(mut reader: R, wanted: &[exif::Tag]) -> Result<Found, Reason> {
    let ((width, height), refused) = raw::head(&mut reader)?;
    let damaged = || "its list of tags is damaged; copy the file again".to_owned();
    let mut file = Directories::of(reader).ok_or_else(damaged)?;
    let main = file.pictures().into_iter().next().ok_or_else(damaged)?;
    let below = file.first_number(&main, exif::Tag::ExifIFDPointer.number()).and_then(|at| file.directory(at));
    let mut fields = Vec::new();
    for &tag in wanted {
        let below = below.as_ref().filter(|_| tag.context() == Context::Exif);
        let found = below.into_iter().chain([&main]).find_map(|directory| {
            let (kind, bytes) = file.value(directory, tag.number())?;
            stored_value(kind, &bytes, file.is_little)
        });
        fields.extend(found.map(|value| Field { tag, ifd_num: In::PRIMARY, value }));
    }
    let software = file.value(&main, exif::Tag::Software.number()).map(|(_, bytes)| text(&bytes));
    Ok(Found { width, height, depth: 16, exif: written(&fields), software, refused })
}

/// The text of an entry, without the zeros at its end.
fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned()
}

/// Converts the first value of an entry of this type; `None` for types that no wanted tag has.
fn stored_value(kind: u16, bytes: &[u8], is_little: bool) -> Option<exif::Value> {
    let long = |at: usize| {
        let bytes = bytes.get(at..at + 4)?.try_into().ok()?;
        Some(if is_little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    };
    let short = || {
        let bytes = bytes.get(..2)?.try_into().ok()?;
        Some(if is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    };
    Some(match kind {
        1 => exif::Value::Byte(vec![*bytes.first()?]),
        2 => exif::Value::Ascii(vec![text(bytes).into_bytes()]),
        3 => exif::Value::Short(vec![short()?]),
        4 => exif::Value::Long(vec![long(0)?]),
        5 => exif::Value::Rational(vec![exif::Rational { num: long(0)?, denom: long(4)? }]),
        8 => exif::Value::SShort(vec![short()?.cast_signed()]),
        9 => exif::Value::SLong(vec![long(0)?.cast_signed()]),
        10 => {
            let (num, denom) = (long(0)?.cast_signed(), long(4)?.cast_signed());
            exif::Value::SRational(vec![exif::SRational { num, denom }])
        }
        _ => return None,
    })
}

/// Whether the file is a BigTIFF. `decode` does not read the EXIF of a BigTIFF either, because kamadak-exif cannot.
fn is_big<R: Read + Seek>(decoder: &mut Decoder<R>) -> bool {
    let mut head = [0; 4];
    let reader = decoder.inner();
    reader.rewind().and_then(|()| reader.read_exact(&mut head)).is_ok() && head[2..].contains(&43)
}

/// Returns the `wanted` fields of the image as a TIFF block. A field that the directory of the image lacks is taken
/// from the directory `first`, except for the orientation. In either case, a tag that EXIF defines for the EXIF
/// directory is first searched for in the EXIF directory that this directory points to, then in this directory itself.
fn fields<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    first: Option<IfdPointer>,
    wanted: &[exif::Tag],
) -> Option<Vec<u8>> {
    let mut sources: Vec<(Directory, Option<Directory>)> = Vec::new();
    for pointer in decoder.ifd_pointer().into_iter().chain(first) {
        let Ok(own) = decoder.read_directory(pointer) else { continue };
        let below = decoder.read_directory_tags(&own).find_tag(Tag::ExifDirectory).ok().flatten();
        let below = below.and_then(|value| value.into_ifd_pointer().ok());
        sources.push((own, below.and_then(|at| decoder.read_directory(at).ok())));
    }
    let mut fields = Vec::new();
    for &tag in wanted {
        let count = if tag == exif::Tag::Orientation { 1 } else { sources.len() };
        let places = sources.iter().take(count).flat_map(|(own, below)| {
            let below = below.as_ref().filter(|_| tag.context() == Context::Exif);
            below.into_iter().chain([own])
        });
        let number = Tag::from_u16_exhaustive(tag.number());
        let mut found = places.filter_map(|directory| {
            decoder.read_directory_tags(directory).find_tag(number).ok().flatten().and_then(exif_value)
        });
        if let Some(value) = found.next() {
            fields.push(Field { tag, ifd_num: In::PRIMARY, value });
        }
    }
    written(&fields)
}

/// The TIFF block of `fields`.
fn written(fields: &[Field]) -> Option<Vec<u8>> {
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, false).ok()?;
    Some(block.into_inner())
}

/// Converts the first value of a tag to the type of kamadak-exif; `None` for types that no wanted tag has.
fn exif_value(value: Value) -> Option<exif::Value> {
    Some(match value {
        Value::List(values) => exif_value(values.into_iter().next()?)?,
        Value::Ascii(text) => exif::Value::Ascii(vec![text.trim_end_matches('\0').as_bytes().to_vec()]),
        Value::Byte(v) => exif::Value::Byte(vec![v]),
        Value::Short(v) => exif::Value::Short(vec![v]),
        Value::SignedShort(v) => exif::Value::SShort(vec![v]),
        Value::Unsigned(v) => exif::Value::Long(vec![v]),
        Value::Signed(v) => exif::Value::SLong(vec![v]),
        Value::Float(v) => exif::Value::Float(vec![v]),
        Value::Double(v) => exif::Value::Double(vec![v]),
        Value::Rational(num, denom) => exif::Value::Rational(vec![exif::Rational { num, denom }]),
        Value::SRational(num, denom) => exif::Value::SRational(vec![exif::SRational { num, denom }]),
        _ => return None,
    })
}

#[cfg(test)]
mod tests;
