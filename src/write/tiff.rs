//! TIFF: RGB of 8 or 16 bits (aligned frames) or 32-bit floats (radiance), by strips of 64 rows, deflated without loss.
//!
//! In: pixels by rows. Out: a little-endian TIFF, or BigTIFF where 4 GB would not do; the directory comes last. Cost: about 12 ns a
//! byte and core. Source: TIFF 6.0, sections 2 (structure), 14 (differencing), 19 (sample format); Adobe Photoshop TIFF Technical Notes
//! (deflate, compression 8) and Technical Note 3 (floating-point predictor); BigTIFF (Aware Systems); ICC.1:2010, B.4 (tag 34675).
//!
//! The `tiff` crate's encoder writes the byte order of the machine and compresses only whole pictures, so the little that is needed of
//! the structure is here; its decoder is the judge in the tests.

use super::ifd::{Directory, tag};
use super::{Bands, Metadata, Pending, RowWriter, Written};
use crate::error::Result;
use crate::plane::BAND_ROWS;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::{self, Seek, SeekFrom, Write};

/// How hard to deflate: the least, for noise does not shrink further whatever is spent on it.
const LEVEL: u32 = 1;

/// A sample that TIFF can hold: `u8` or `u16` (display- or camera-encoded) or `f32` (linear).
pub trait Sample: Copy + Send + Sync + 'static {
    /// Its size.
    const BITS: u16;
    /// The TIFF sample format: 1 for unsigned integers, 3 for floats.
    const FORMAT: u16;
    /// The TIFF predictor: 2 for differences, 3 for those of floats.
    const PREDICTOR: u16;

    /// Appends `row`, predicted from the pixel on the left: little-endian, or by bytes for floats.
    fn put_predicted(row: &[[Self; 3]], out: &mut Vec<u8>);
}

impl Sample for u8 {
    const BITS: u16 = 8;
    const FORMAT: u16 = 1;
    const PREDICTOR: u16 = 2;

    fn put_predicted(row: &[[u8; 3]], out: &mut Vec<u8>) {
        let mut left = [0u8; 3];
        for p in row {
            out.extend((0..3).map(|c| p[c].wrapping_sub(left[c])));
            left = *p;
        }
    }
}

impl Sample for u16 {
    const BITS: u16 = 16;
    const FORMAT: u16 = 1;
    const PREDICTOR: u16 = 2;

    fn put_predicted(row: &[[u16; 3]], out: &mut Vec<u8>) {
        let mut left = [0u16; 3];
        for p in row {
            for c in 0..3 {
                out.extend_from_slice(&p[c].wrapping_sub(left[c]).to_le_bytes());
            }
            left = *p;
        }
    }
}

impl Sample for f32 {
    const BITS: u16 = 32;
    const FORMAT: u16 = 3;
    const PREDICTOR: u16 = 3;

    /// All first bytes of the row, then all second ones, from the sign down; of these the differences, three apart.
    fn put_predicted(row: &[[f32; 3]], out: &mut Vec<u8>) {
        let samples = row.as_flattened();
        let start = out.len();
        for byte in 0..4 {
            out.extend(samples.iter().map(|v| v.to_be_bytes()[byte]));
        }
        let bytes = &mut out[start..];
        for i in (3..bytes.len()).rev() {
            bytes[i] = bytes[i].wrapping_sub(bytes[i - 3]);
        }
    }
}

/// The TIFF writer for pixels `[T; 3]`.
#[derive(Debug)]
pub struct Writer<T> {
    file: Pending,
    bands: Bands<[T; 3]>,
    directory: Directory,
    at: u64,
    strips: Vec<(u64, u64)>,
}

impl<T: Sample> Writer<T> {
    /// Begins a picture of `size` pixels. Integers carry the [`profile`](Metadata::profile), if there is one.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn new(mut file: Pending, size: (usize, usize), metadata: &Metadata) -> Result<Self> {
        let (width, height) = size;
        let raw = width as u64 * height as u64 * 3 * u64::from(T::BITS / 8);
        // Noise can make deflate grow by a little; the directory needs some room too.
        let mut directory = Directory::new(raw + raw / 64 + (1 << 24) > u64::from(u32::MAX));
        directory.long(tag::WIDTH, &[width as u64]);
        directory.long(tag::HEIGHT, &[height as u64]);
        directory.short(tag::BITS, &[T::BITS; 3]);
        directory.short(tag::COMPRESSION, &[8]);
        directory.short(tag::PHOTOMETRIC, &[2]);
        directory.short(tag::SAMPLES, &[3]);
        directory.long(tag::ROWS_PER_STRIP, &[BAND_ROWS as u64]);
        directory.short(tag::PLANAR, &[1]);
        directory.short(tag::PREDICTOR, &[T::PREDICTOR]);
        directory.short(tag::SAMPLE_FORMAT, &[T::FORMAT; 3]);
        directory.text(tag::DESCRIPTION, Some(&metadata.comments.join("; ")));
        directory.text(tag::MAKE, metadata.capture.make.as_deref());
        directory.text(tag::MODEL, metadata.capture.model.as_deref());
        directory.text(tag::SOFTWARE, Some(&metadata.software));
        if let Some(profile) = metadata.profile.as_ref().filter(|_| T::FORMAT == 1) {
            directory.opaque(tag::ICC, &profile.icc);
        }
        let start = directory.file_header(0);
        file.put(&start)?;
        Ok(Writer { file, bands: Bands::new(size), directory, at: start.len() as u64, strips: Vec::new() })
    }
}

impl<T: Sample> RowWriter<[T; 3]> for Writer<T> {
    fn push(&mut self, rows: &[[T; 3]]) -> Result<()> {
        let Writer { file, bands, at, strips, .. } = self;
        let width = bands.width;
        bands.push(
            rows,
            |_, pixels| deflate(pixels, width),
            |strip| {
                let strip = strip.map_err(|e| file.error(e))?;
                file.put(&strip)?;
                strips.push((*at, strip.len() as u64));
                *at += strip.len() as u64;
                Ok(())
            },
        )
    }

    fn finish(mut self: Box<Self>) -> Result<Written> {
        self.bands.complete().map_err(|e| self.file.error(e))?;
        let (offsets, counts): (Vec<u64>, Vec<u64>) = self.strips.iter().copied().unzip();
        self.directory.long(tag::STRIP_OFFSETS, &offsets);
        self.directory.long(tag::STRIP_COUNTS, &counts);
        // The directory begins at an even place.
        let place = self.at.next_multiple_of(2);
        let mut end = vec![0; (place - self.at) as usize];
        end.extend(self.directory.bytes(place));
        let start = self.directory.file_header(place);
        let file = &mut self.file;
        let mut put = || -> io::Result<()> {
            file.write_all(&end)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&start)
        };
        put().map_err(|e| self.file.error(e))?;
        Ok(Written { file: self.file, warnings: Vec::new() })
    }
}

fn deflate<T: Sample>(pixels: &[[T; 3]], width: usize) -> io::Result<Vec<u8>> {
    let mut raw = Vec::with_capacity(size_of_val(pixels));
    for row in pixels.chunks_exact(width) {
        T::put_predicted(row, &mut raw);
    }
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(raw.len() / 2), Compression::new(LEVEL));
    encoder.write_all(&raw)?;
    encoder.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Profile;
    use crate::plane::Plane;
    use crate::write::{commit, push_all};
    use ::tiff::decoder::{Decoder, DecodingResult};
    use ::tiff::tags::Tag;

    fn picture<T: Copy + Default + Send>(
        width: usize,
        height: usize,
        value: impl Fn(u32) -> T + Sync,
    ) -> Plane<[T; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [0, 1, 2].map(|c| value(((x * 7919 + y * 104_729 + c * 331) % 100_003) as u32));
            }
        })
    }

    fn written<T: Sample>(picture: &Plane<[T; 3]>, metadata: &Metadata, big: bool) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.tif");
        let size = (picture.width(), picture.height());
        let pending = Pending::create(&path).unwrap();
        let mut writer = Writer::<T>::new(pending, size, metadata).unwrap();
        if big {
            // As if it were huge: start over with the other kind of header.
            writer.file.seek(SeekFrom::Start(0)).unwrap();
            writer.directory.big = true;
            for (tag, value) in [(tag::WIDTH, size.0), (tag::HEIGHT, size.1), (tag::ROWS_PER_STRIP, BAND_ROWS)] {
                writer.directory.long(tag, &[value as u64]);
            }
            let start = writer.directory.file_header(0);
            writer.at = start.len() as u64;
            writer.file.write_all(&start).unwrap();
        }
        let whole = push_all(Box::new(writer), picture).unwrap();
        commit(vec![whole.file], false).unwrap();
        std::fs::read(&path).unwrap()
    }

    fn decoded(bytes: &[u8]) -> DecodingResult {
        Decoder::new(io::Cursor::new(bytes)).unwrap().read_image().unwrap()
    }

    #[test]
    fn another_decoder_reads_the_same_pixels() {
        for (width, height) in [(1, 1), (17, 64), (50, 64 * 3 + 11)] {
            for big in [false, true] {
                let metadata = Metadata::default();
                let eight = picture(width, height, |n| n as u8);
                let DecodingResult::U8(v) = decoded(&written(&eight, &metadata, big)) else { panic!("8 bits") };
                assert_eq!(v, eight.as_slice().as_flattened());
                let sixteen = picture(width, height, |n| n as u16);
                let DecodingResult::U16(v) = decoded(&written(&sixteen, &metadata, big)) else { panic!("16 bits") };
                assert_eq!(v, sixteen.as_slice().as_flattened());
                let floats = picture(width, height, |n| (n as f32 - 3.7) * 1e-3);
                let DecodingResult::F32(v) = decoded(&written(&floats, &metadata, big)) else { panic!("floats") };
                assert_eq!(v, floats.as_slice().as_flattened());
            }
        }
    }

    #[test]
    fn tags_say_what_is_known() {
        let mut metadata = Metadata {
            profile: Some(Profile { icc: (0..=99).collect(), description: String::new(), primaries: None }),
            ..Metadata::default()
        };
        metadata.capture.make = Some("Make\0".into());
        metadata.capture.model = Some("M".into());
        let bytes = written(&picture(5, 5, |n| n as u8), &metadata, false);
        let mut decoder = Decoder::new(io::Cursor::new(&bytes)).unwrap();
        assert_eq!(decoder.get_tag_u8_vec(Tag::IccProfile).unwrap(), (0..=99).collect::<Vec<u8>>());
        assert_eq!(decoder.get_tag_ascii_string(Tag::Make).unwrap(), "Make");
        assert_eq!(decoder.get_tag_ascii_string(Tag::Model).unwrap(), "M");
        assert_eq!(decoder.get_tag_ascii_string(Tag::Software).unwrap(), metadata.software);
        assert_eq!(decoder.get_tag_u32(Tag::RowsPerStrip).unwrap(), 64);
        let bytes = written(&picture(5, 5, |n| n as f32), &metadata, false);
        let mut decoder = Decoder::new(io::Cursor::new(&bytes)).unwrap();
        assert!(decoder.get_tag_u8_vec(Tag::IccProfile).is_err(), "a display profile says nothing of radiance");
    }

    #[test]
    fn the_bytes_are_the_same_on_any_number_of_threads() {
        let picture = picture(80, 64 * 18 + 1, |n| n as u16);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| written(&picture, &Metadata::default(), false))
        };
        assert!(on(1) == on(2) && on(1) == on(7));
    }

    #[test]
    fn more_than_four_gigabytes_are_written_as_bigtiff() {
        let dir = tempfile::tempdir().unwrap();
        let kind = |width: usize, height: usize| {
            let pending = Pending::create(&dir.path().join("x.tif")).unwrap();
            Writer::<f32>::new(pending, (width, height), &Metadata::default()).unwrap().directory.big
        };
        assert!(!kind(15_000, 20_000) && kind(20_000, 20_000));
    }
}
