//! The TIFF writer for integers and floats: compressed strips and the tags that describe them.
//!
//! In: pixels by rows. Out: a TIFF. Cost and source: see [`super`].

use super::directory::{Directory, tag};
use super::sample::Sample;
use super::strips::Strips;
use crate::bracket::colour::{Curve, Profile};
use crate::error::Result;
use crate::write::bands::Bands;
use crate::write::deflate::zlib;
use crate::write::exif;
use crate::write::metadata::Metadata;
use crate::write::row_writer::RowWriter;
use crate::write::staging::{Pending, Written};
use std::io;

/// The TIFF writer for pixels of `N` samples.
#[derive(Debug)]
pub struct Writer<T, const N: usize = 3> {
    pub(super) strips: Strips,
    pub(super) bands: Bands<[T; N], Vec<u8>>,
}

impl<T: Sample> Writer<T> {
    /// Starts a picture of `size` pixels. Files of integers contain the [`profile`](Metadata::profile), if there is
    /// one. Files of floats contain the [`primaries`](Metadata::primaries).
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn new(file: Pending, size: (usize, usize), metadata: &Metadata) -> Result<Self> {
        Self::begin(file, size, metadata, |directory| directory.capture(metadata))
    }

    /// Starts a display picture, with all EXIF fields of the photograph, and the resolution. Without a profile the
    /// picture is sRGB, and the sRGB profile is written, because TIFF has no other way to mark sRGB.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn picture(file: Pending, size: (usize, usize), metadata: &Metadata) -> Result<Self> {
        let profile = metadata.profile.clone().or_else(Profile::srgb);
        let fields = exif::of_tiff(size, metadata);
        let metadata = Metadata { profile, ..metadata.clone() };
        Self::begin(file, size, &metadata, |directory| directory.photograph(&fields))
    }

    fn begin(
        file: Pending,
        size: (usize, usize),
        metadata: &Metadata,
        describe: impl FnOnce(&mut Directory),
    ) -> Result<Self> {
        let mut strips = Strips::begin(file, size, 3, 3 * u64::from(T::BITS))?;
        let directory = &mut strips.directory;
        directory.short(tag::BITS, &[T::BITS; 3]);
        directory.short(tag::COMPRESSION, &[8]);
        directory.short(tag::PHOTOMETRIC, &[2]);
        directory.short(tag::PREDICTOR, &[T::PREDICTOR]);
        directory.short(tag::SAMPLE_FORMAT, &[T::FORMAT; 3]);
        describe(directory);
        if T::FORMAT == 3 {
            if metadata.primaries.are_positive() {
                directory.primaries(&metadata.primaries);
            } else {
                // The tags do not support negative chromaticities, such as those of ACES2065-1; a profile does.
                let profile =
                    Profile::of(&metadata.primaries, Curve::Power(1.0), "linear RGB of the file's own primaries");
                let unknown = || io::Error::other("its primaries define no colour space");
                directory.opaque(tag::ICC, &profile.ok_or_else(unknown).map_err(|e| strips.file.error(e))?.icc);
            }
            if let Some(luminance) = metadata.white_luminance() {
                directory.double(tag::STONITS, luminance);
            }
        } else if let Some(profile) = &metadata.profile {
            directory.opaque(tag::ICC, &profile.icc);
        }
        Ok(Writer { strips, bands: Bands::new(size) })
    }
}

impl<T: Sample, const N: usize> RowWriter<[T; N]> for Writer<T, N> {
    fn push(&mut self, rows: &[[T; N]]) -> Result<()> {
        let Writer { strips, bands } = self;
        let width = bands.width;
        bands.push(
            rows,
            |_, pixels, raw, out| pack(pixels, width, raw, out),
            |strip, packed| {
                packed.map_err(|e| strips.file.error(e))?;
                strips.put(strip)
            },
        )
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        self.bands.complete().map_err(|e| self.strips.file.error(e))?;
        Written::ended(self.strips.end()?, Vec::new())
    }
}

/// Appends a compressed strip.
fn pack<T: Sample, const N: usize>(
    pixels: &[[T; N]],
    width: usize,
    raw: &mut Vec<u8>,
    out: &mut Vec<u8>,
) -> io::Result<()> {
    raw.clear();
    raw.reserve(size_of_val(pixels));
    for row in pixels.chunks_exact(width) {
        T::put_predicted(row, raw);
    }
    zlib(raw, out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Profile;
    use crate::merge::radiance::calibration::Factor;
    use crate::plane::{BAND_ROWS, Plane};
    use crate::write::{commit, push_all};
    use ::tiff::decoder::{Decoder, DecodingResult};
    use ::tiff::tags::Tag;
    use std::io::{Seek, SeekFrom, Write};

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
            // Pretend that the file is very large: start again with the header of a BigTIFF.
            let strips = &mut writer.strips;
            strips.file.seek(SeekFrom::Start(0)).unwrap();
            strips.directory = Directory::new(true);
            let floats = T::FORMAT == 3;
            for (tag, value) in [(tag::WIDTH, size.0), (tag::HEIGHT, size.1), (tag::ROWS_PER_STRIP, BAND_ROWS)] {
                strips.directory.long(tag, &[value as u64]);
            }
            for (tag, values) in [
                (tag::BITS, vec![T::BITS; 3]),
                (tag::COMPRESSION, vec![8]),
                (tag::PHOTOMETRIC, vec![2]),
                (tag::SAMPLES, vec![3]),
                (tag::PREDICTOR, vec![if floats { 3 } else { 2 }]),
                (tag::SAMPLE_FORMAT, vec![T::FORMAT; 3]),
            ] {
                strips.directory.short(tag, &values);
            }
            strips.directory.capture(metadata);
            let start = strips.directory.file_header(0);
            strips.at = start.len() as u64;
            strips.file.write_all(&start).unwrap();
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
    fn tags_contain_the_known_values() {
        let mut metadata = Metadata {
            profile: Some(Profile { icc: (0..=99).collect(), description: String::new(), primaries: None }),
            ..Metadata::default()
        };
        metadata.capture.make = Some("Make\0".into());
        metadata.capture.model = Some("M".into());
        metadata.capture.date = Some("2009:07:11 12:34:56".into());
        metadata.capture.lens = Some("EF 50".into());
        (metadata.time_s, metadata.f_number, metadata.iso) = (Some(1.0 / 60.0), Some(2.8), Some(200.0));
        metadata.cd_m2_per_unit = Some(Factor::ONE);
        let bytes = written(&picture(5, 5, |n| n as u8), &metadata, false);
        let mut decoder = Decoder::new(io::Cursor::new(&bytes)).unwrap();
        assert_eq!(decoder.get_tag_u8_vec(Tag::IccProfile).unwrap(), (0..=99).collect::<Vec<u8>>());
        assert_eq!(decoder.get_tag_ascii_string(Tag::Make).unwrap(), "Make");
        assert_eq!(decoder.get_tag_ascii_string(Tag::Model).unwrap(), "M");
        assert_eq!(decoder.get_tag_ascii_string(Tag::Software).unwrap(), metadata.software);
        assert_eq!(decoder.get_tag_u32(Tag::RowsPerStrip).unwrap(), 64);
        assert!(
            decoder.get_tag_f64(Tag::Unknown(tag::STONITS)).is_err()
                && decoder.get_tag(Tag::Unknown(tag::WHITE_POINT)).is_err()
        );
        // Another reader finds the EXIF fields, in TIFF and in BigTIFF.
        for big in [false, true] {
            let bytes = written(&picture(5, 5, |n| n as f32), &metadata, big);
            let mut decoder = Decoder::new(io::Cursor::new(&bytes)).unwrap();
            let pointer = decoder.get_tag_u64(Tag::ExifDirectory).unwrap();
            let exif = decoder.read_directory(::tiff::tags::IfdPointer(pointer)).unwrap();
            let mut exif = decoder.read_directory_tags(&exif);
            let of = |v: Option<::tiff::decoder::ifd::Value>| format!("{:?}", v.unwrap());
            assert_eq!(of(exif.find_tag(Tag::Unknown(tag::EXPOSURE_TIME)).unwrap()), "Rational(1, 60)");
            assert_eq!(of(exif.find_tag(Tag::Unknown(tag::F_NUMBER)).unwrap()), "Rational(28, 10)");
            assert_eq!(exif.find_tag(Tag::Unknown(tag::ISO)).unwrap().unwrap().into_u32().unwrap(), 200);
            assert_eq!(exif.find_tag(Tag::Unknown(tag::LENS_MODEL)).unwrap().unwrap().into_string().unwrap(), "EF 50");
        }
        let bytes = written(&picture(5, 5, |n| n as f32), &metadata, false);
        let mut decoder = Decoder::new(io::Cursor::new(&bytes)).unwrap();
        assert_eq!(decoder.get_tag_f64(Tag::Unknown(tag::STONITS)).unwrap(), 1.0);
        assert_eq!(decoder.get_tag_ascii_string(Tag::DateTime).unwrap(), "2009:07:11 12:34:56");
        assert!(decoder.get_tag_u8_vec(Tag::IccProfile).is_err(), "a display profile does not apply to radiance");
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
            Writer::<f32>::new(pending, (width, height), &Metadata::default()).unwrap().strips.directory.big
        };
        assert!(!kind(15_000, 20_000) && kind(20_000, 20_000));
    }
}
