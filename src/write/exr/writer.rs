//! The OpenEXR writer: header, offset table and blocks of rows.
//!
//! In: linear RGB by rows. Out: an `.exr` file. Cost and source: see [`super`].

use super::piz::Packer;
use super::{Compression, Options, Sample};
use crate::bracket::colour::{Primaries, Space};
use crate::error::Result;
use crate::pixel::half::{planes_of_floats, planes_of_halves};
use crate::plane::BAND_ROWS;
use crate::write::bands::Bands;
use crate::write::metadata::{Metadata, one_line};
use crate::write::row_writer::RowWriter;
use crate::write::staging::{Pending, Written, clamped};
use ::exr::math::Vec2;
use ::exr::meta::attribute::{
    self, AttributeValue, ChannelDescription, Chromaticities, IntegerBounds, LineOrder, SampleType, Text,
};
use ::exr::meta::header::Header;
use ::exr::meta::{BlockDescription, MetaData, magic_number, sequence_end};
use std::io::{self, Seek, SeekFrom, Write};

/// The `.exr` writer.
#[derive(Debug)]
pub struct Writer {
    file: Pending,
    bands: Bands<[f32; 3], Scratch>,
    header: Header,
    sample: Sample,
    /// Position of the offset table in the file, and its entries (`offsets`): the position of every block that is
    /// written.
    table: u64,
    offsets: Vec<u64>,
    at: u64,
    over: u64,
}

impl Writer {
    /// Writes the header of a picture of `size` pixels; rows of linear RGB follow.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn new(mut file: Pending, size: (usize, usize), metadata: &Metadata, options: &Options) -> Result<Self> {
        let header = header(size, metadata, options);
        let mut start = Vec::new();
        put_frame(&header, metadata, &mut start).map_err(|e| file.error(io_error(e)))?;
        let table = start.len() as u64;
        start.resize(start.len() + 8 * header.chunk_count, 0);
        file.put(&start)?;
        Ok(Writer {
            file,
            bands: Bands::new(size),
            sample: options.sample,
            table,
            offsets: Vec::with_capacity(header.chunk_count),
            at: start.len() as u64,
            over: 0,
            header,
        })
    }
}

impl RowWriter<[f32; 3]> for Writer {
    fn push(&mut self, rows: &[[f32; 3]]) -> Result<()> {
        let Writer { file, bands, header, offsets, at, over, .. } = self;
        let (width, sample) = (bands.width, self.sample);
        bands.push(
            rows,
            |first, pixels, scratch, out| encode_band(first, pixels, width, sample, header, scratch, out),
            |bytes, (blocks, beyond)| {
                *over += beyond;
                file.put(bytes)?;
                for length in blocks.map_err(|e| file.error(io_error(e)))? {
                    offsets.push(*at);
                    *at += length as u64;
                }
                Ok(())
            },
        )
    }

    fn finish(mut self: Box<Self>) -> Result<Written> {
        let table: Vec<u8> = self.offsets.iter().flat_map(|at| at.to_le_bytes()).collect();
        let mut end = || -> io::Result<()> {
            self.bands.complete()?;
            self.file.seek(SeekFrom::Start(self.table))?;
            self.file.write_all(&table)
        };
        end().map_err(|e| self.file.error(e))?;
        let what = "are above 65504 and were set to 65504; --exr-type float stores them unchanged";
        let warnings = clamped(&self.file, self.over, what);
        Written::ended(self.file, warnings)
    }
}

fn header((width, height): (usize, usize), metadata: &Metadata, options: &Options) -> Header {
    let sample = match options.sample {
        Sample::Half => SampleType::F16,
        Sample::Float | Sample::Auto => SampleType::F32,
    };
    let compression = match options.compression {
        Compression::Piz => ::exr::compression::Compression::PIZ,
        Compression::Zip16 => ::exr::compression::Compression::ZIP16,
        Compression::Zip1 => ::exr::compression::Compression::ZIP1,
        Compression::None => ::exr::compression::Compression::Uncompressed,
    };
    // Channels are sorted by name.
    let channels = ["B", "G", "R"].map(|name| ChannelDescription::named(name, sample));
    let mut header = Header::new(Text::default(), (width, height), channels.into_iter().collect()).with_encoding(
        compression,
        BlockDescription::ScanLines,
        LineOrder::Increasing,
    );
    let Primaries { red, green, blue, white } = metadata.primaries;
    let xy = |p: [f64; 2]| Vec2(p[0] as f32, p[1] as f32);
    header.shared_attributes.chromaticities =
        Some(Chromaticities { red: xy(red), green: xy(green), blue: xy(blue), white: xy(white) });
    let number = |v: Option<f64>| v.map(|v| v as f32);
    let own = &mut header.own_attributes;
    own.layer_name = None;
    own.white_luminance = number(metadata.white_luminance());
    own.exposure = number(metadata.time_s);
    own.aperture = number(metadata.f_number);
    own.iso_speed = number(metadata.iso);
    own.capture_date = metadata.capture.date.as_deref().and_then(text);
    own.comments = text(&metadata.comments.join("; "));
    own.software_name = text(&metadata.software);
    header
}

/// Writes the magic number, the version and the header.
fn put_frame(header: &Header, metadata: &Metadata, out: &mut Vec<u8>) -> ::exr::error::UnitResult {
    let requirements = MetaData::validate(std::slice::from_ref(header), true)?;
    magic_number::write(out)?;
    requirements.write(out)?;
    for (name, value) in header.all_named_attributes() {
        attribute::write(name, &value, out)?;
    }
    // More standard attributes, for which the crate has no fields. The crate's maps of other attributes are not used,
    // because they have no fixed order.
    let words = |t: &Option<String>| t.as_deref().and_then(text).map(AttributeValue::Text);
    let capture = &metadata.capture;
    let space = Space::of(&metadata.primaries).and_then(Space::interop_id);
    let further = [
        ("cameraMake", words(&capture.make)),
        ("cameraModel", words(&capture.model)),
        ("lensModel", words(&capture.lens)),
        ("nominalFocalLength", capture.focal_length_mm.map(|f| AttributeValue::F32(f as f32))),
        ("colorInteropID", space.and_then(text).map(AttributeValue::Text)),
    ];
    for (name, value) in further {
        if let Some(value) = value {
            attribute::write(name.as_bytes(), &value, out)?;
        }
    }
    sequence_end::write(out)
}

fn text(text: &str) -> Option<Text> {
    Text::new_or_none(one_line(text)).filter(|t| !t.as_slice().is_empty())
}

fn io_error(error: ::exr::error::Error) -> io::Error {
    match error {
        ::exr::error::Error::Io(e) => e,
        other => io::Error::other(other.to_string()),
    }
}

/// The length of every block, and the number of values out of range.
type Encoded = (std::result::Result<Vec<usize>, ::exr::error::Error>, u64);

/// Buffers that are reused from band to band: the tables of PIZ, and planes for the other compressions.
#[derive(Debug, Default)]
struct Scratch {
    packer: Packer,
    planes: Vec<u16>,
}

/// Encodes one band and appends its blocks. The 64 rows of a band are two blocks of PIZ, or four blocks of ZIP.
fn encode_band(
    first: usize,
    pixels: &[[f32; 3]],
    width: usize,
    sample: Sample,
    header: &Header,
    scratch: &mut Scratch,
    out: &mut Vec<u8>,
) -> Encoded {
    let rows = header.compression.scan_lines_per_block();
    debug_assert!(
        BAND_ROWS.is_multiple_of(rows),
        "a band of rows (written at once) must consist of whole blocks of rows (compressed together)"
    );
    let mut over = 0;
    let blocks = pixels.chunks(rows * width).enumerate().map(|(i, block)| {
        let (start, y, size) = (out.len(), first + i * rows, (width, block.len() / width));
        // The cast is exact, because the validation of the header has rejected sides of 2^31 pixels or more.
        out.extend_from_slice(&(y as i32).to_le_bytes());
        out.extend_from_slice(&[0; 4]);
        let words = if sample == Sample::Half { 1 } else { 2 };
        let planes = if header.compression == ::exr::compression::Compression::PIZ {
            scratch.packer.planes(width, size.1, words)
        } else {
            scratch.planes.resize(3 * words * block.len(), 0);
            &mut scratch.planes
        };
        match sample {
            Sample::Half => over += planes_of_halves(block, planes),
            Sample::Float | Sample::Auto => planes_of_floats(block, planes),
        }
        if header.compression == ::exr::compression::Compression::PIZ {
            scratch.packer.pack(out);
        } else {
            let data = plain(planes, width, words);
            let place = IntegerBounds::new(Vec2(0, y as i32), Vec2(size.0, size.1));
            out.extend(header.compression.compress_image_section_to_le(header, data, place)?);
        }
        let length = out.len() - start;
        // A block of at most 32 rows is smaller than 2 GB, so its length fits.
        out[start + 4..start + 8].copy_from_slice(&((length - 8) as u32).to_le_bytes());
        Ok(length)
    });
    let blocks = blocks.collect();
    (blocks, over)
}

/// Returns the planes as rows, as the crate expects them: each row has all values of B, then of G, then of R, in the
/// byte order of the machine.
fn plain(planes: &[u16], width: usize, words: usize) -> Vec<u8> {
    let size = planes.len() / (3 * words);
    let mut out = vec![0; 2 * planes.len()];
    let rows = out.chunks_exact_mut(3 * words * 2 * width);
    for (y, row) in rows.enumerate() {
        for (channel, to) in planes.chunks_exact(words * size).zip(row.chunks_exact_mut(words * 2 * width)) {
            let (low, high) = channel.split_at(size);
            let low = &low[y * width..][..width];
            if words == 1 {
                for (to, v) in to.as_chunks_mut::<2>().0.iter_mut().zip(low) {
                    *to = v.to_ne_bytes();
                }
            } else {
                let high = &high[y * width..][..width];
                for ((to, &low), &high) in to.as_chunks_mut::<4>().0.iter_mut().zip(low).zip(high) {
                    *to = (u32::from(high) << 16 | u32::from(low)).to_ne_bytes();
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Warning;
    use crate::merge::RadianceMap;
    use crate::merge::radiance::calibration::Factor;
    use crate::plane::Plane;
    use crate::read::read;
    use crate::write::commit;
    use ::exr::prelude::f16;

    fn factor(value: f64) -> Factor {
        Factor::new(value).unwrap()
    }

    fn picture(width: usize, height: usize) -> Plane<[f32; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let v = ((x * 7919 + y * 104_729) % 1000) as f32;
                *p = [v + 0.1, x as f32 / 100.0 + 1e-9, 60.0 * v];
            }
        })
    }

    /// Writes a file in portions of `portion` rows. Returns its bytes, the warnings, and the map and metadata read
    /// from it.
    fn written(
        picture: &Plane<[f32; 3]>,
        metadata: &Metadata,
        options: &Options,
        portion: usize,
    ) -> (Vec<u8>, Vec<Warning>, RadianceMap, Metadata) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        let size = (picture.width(), picture.height());
        let mut writer = Box::new(Writer::new(Pending::create(&path).unwrap(), size, metadata, options).unwrap());
        for rows in picture.as_slice().chunks(portion * size.0) {
            writer.push(rows).unwrap();
        }
        let whole = writer.finish().unwrap();
        commit(vec![whole.file], false).unwrap();
        let (map, back) = read(&path).unwrap();
        (std::fs::read(&path).unwrap(), whole.warnings, map, back)
    }

    /// Returns the half that is written for `v`: small values become the smallest half instead of 0.
    fn half(v: f32) -> f32 {
        let nearest = f16::from_f32(v).to_f32();
        if v > 0.0 { nearest.max(f16::from_bits(1).to_f32()) } else { nearest }
    }

    #[test]
    fn every_encoding_comes_back() {
        for (width, height) in [(1, 1), (33, 63), (130, 200)] {
            let picture = picture(width, height);
            for compression in [Compression::Piz, Compression::Zip16, Compression::Zip1, Compression::None] {
                for sample in [Sample::Half, Sample::Float] {
                    let options = Options { sample, compression };
                    let (_, warnings, map, _) = written(&picture, &Metadata::default(), &options, height);
                    assert_eq!(warnings, []);
                    for (p, q) in picture.as_slice().iter().zip(map.pixels.as_slice()) {
                        let want = match sample {
                            Sample::Half => p.map(half),
                            Sample::Float | Sample::Auto => *p,
                        };
                        assert_eq!(want, *q);
                    }
                }
            }
        }
    }

    #[test]
    fn the_bytes_depend_on_neither_threads_nor_portions() {
        let picture = picture(70, 64 * 18 + 9);
        let on = |threads, portion| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| written(&picture, &Metadata::default(), &Options::default(), portion).0)
        };
        let one = on(1, 2000);
        assert!(one == on(2, 64) && one == on(7, 2000) && one == on(7, 10));
        // Blocks are stored one after the other: the offsets increase.
        let table = offsets(&one, picture.height().div_ceil(32));
        assert!(table.is_sorted() && table[0] > 0 && *table.last().unwrap() < one.len() as u64);
    }

    /// Returns the offset table. It is directly before the first block, and its first entry is the position of that
    /// block; the table is found by this property.
    fn offsets(bytes: &[u8], blocks: usize) -> Vec<u64> {
        let entry = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        let start = (8..bytes.len() - 8).find(|&at| entry(at) == (at + 8 * blocks) as u64).unwrap();
        (0..blocks).map(|i| entry(start + 8 * i)).collect()
    }

    #[test]
    fn known_metadata_are_in_the_header() {
        let mut metadata = Metadata {
            time_s: Some(0.125),
            f_number: Some(8.0),
            iso: Some(100.0),
            cd_m2_per_unit: Some(factor(300.0)),
            exposure_scale: factor(2.0),
            comments: vec!["a".into(), "b".into()],
            ..Metadata::default()
        };
        metadata.capture.make = Some("Make".into());
        metadata.capture.date = Some("2009:07:11 12:34:56".into());
        metadata.capture.lens = Some("EF 50".into());
        metadata.capture.focal_length_mm = Some(50.0);
        let (bytes, _, _, back) = written(&picture(3, 3), &metadata, &Options::default(), 3);
        assert_eq!((back.time_s, back.f_number, back.iso), (Some(0.125), Some(8.0), Some(100.0)));
        assert_eq!((back.cd_m2_per_unit, back.capture.date), (Some(factor(150.0)), metadata.capture.date));
        assert_eq!(back.comments, ["a; b"]);
        let has = |text: &[u8]| bytes.windows(text.len()).any(|w| w == text);
        assert!(has(b"cameraMake\0string\0\x04\0\0\0Make") && has(b"lin_rec709_scene") && has(b"software\0string\0"));
        assert!(
            has(b"lensModel\0string\0\x05\0\0\0EF 50") && has(b"nominalFocalLength\0float\0\x04\0\0\0\0\0\x48\x42")
        );
        assert!(!has(b"owner") && !has(b"cameraModel"));
        let (bytes, _, _, back) = written(&picture(3, 3), &Metadata::default(), &Options::default(), 3);
        assert!(!bytes.windows(14).any(|w| w == b"whiteLuminance"));
        assert!((back.primaries.red[0] - 0.64).abs() < 1e-6);
    }

    #[test]
    fn values_above_the_range_of_halves_are_reported() {
        let bright = Plane::filled(2, 2, [65504.0, 65505.0, 1e-30]);
        let halves = Options { sample: Sample::Half, ..Options::default() };
        let (_, warnings, map, _) = written(&bright, &Metadata::default(), &halves, 2);
        assert!(matches!(&warnings[..], [Warning::OutOfRange { detail, .. }] if detail.starts_with("4 values")));
        assert_eq!(map.pixels.at(1, 1), [65504.0, 65504.0, f16::from_bits(1).to_f32()]);
    }
}
