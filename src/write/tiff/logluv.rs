//! LogLuv TIFF: logarithmic luminance and a CIE chromaticity, in 24 or 32 bits per pixel.
//!
//! In: linear RGB by rows. Out: a TIFF with compression 34677 (24 bits, uncompressed) or 34676 (32 bits, run-length
//! encoded) and photometric interpretation 32845, in strips of 64 rows, as read by libtiff, ImageMagick and OpenCV.
//! Grey is written as X = Y = Z, and the white of the primaries as WhitePoint, as `tif_luv.c` requires. The tag
//! StoNits is the factor from stored luminance to cd/m2. Cost: 80 ns per pixel and core; files have 3 bytes per pixel
//! with 24 bits, and about 3 bytes per pixel with 32 bits, because of the run-length encoding. Source: see
//! [`crate::pixel::logluv`].

use super::directory::tag;
use super::strips::Strips;
use crate::bracket::colour::NeutralXyz;
use crate::error::Result;
use crate::merge::radiance::calibration::Unit;
use crate::merge::radiance::gamut::weights;
use crate::merge::radiance::statistics::Statistics;
use crate::merge::{Photographed, RadianceMap};
use crate::pixel::logluv::{self, Depth};
use crate::write::bands::Bands;
use crate::write::metadata::Metadata;
use crate::write::row_writer::RowWriter;
use crate::write::staging::{Pending, Written, clamped};

/// Returns the luminance that 0.1 % of the pixels of `map` exceed.
pub(crate) fn bright(map: &RadianceMap) -> f32 {
    Statistics::measured(&map.pixels, weights(&map.primaries), Unit::Relative).p99_9
}

/// Returns the factor by which the values of a map are multiplied for LogLuv: a power of two of at most 1. With this
/// factor, only the brightest 0.1 % of the pixels, which are above the luminance `bright`, can exceed the largest
/// value of LogLuv. For calibrated radiance, the tag StoNits undoes this factor. For relative radiance there is no
/// StoNits, and the image description records the factor.
pub(crate) fn scale_under(depth: Depth, bright: f32) -> f32 {
    let mut scale = 1.0;
    while bright * scale >= depth.range().1 {
        scale *= 0.5;
    }
    scale
}

/// The LogLuv writer.
#[derive(Debug)]
pub struct Writer {
    strips: Strips,
    bands: Bands<[f32; 3], Vec<u32>>,
    xyz: NeutralXyz,
    depth: Depth,
    scale: f32,
    beyond: u64,
}

impl Writer {
    /// Starts a picture of `size` pixels, whose values are multiplied by `scale`.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn new(file: Pending, size: (usize, usize), metadata: &Metadata, depth: Depth, scale: f32) -> Result<Self> {
        let mut strips = Strips::begin(file, size, 3, 32)?;
        let directory = &mut strips.directory;
        // These bits are those of the 16-bit values that libtiff exchanges with programs. The stored bits are defined
        // by the compression.
        directory.short(tag::BITS, &[16; 3]);
        directory.short(tag::SAMPLE_FORMAT, &[2; 3]);
        let compression = match depth {
            Depth::Bits24 => 34677,
            Depth::Bits32 => 34676,
        };
        directory.short(tag::COMPRESSION, &[compression]);
        directory.short(tag::PHOTOMETRIC, &[32845]);
        directory.white_point(metadata.primaries.white);
        let mut described = metadata.clone();
        for comment in &mut described.comments {
            if let Some(photographed) = Photographed::read([&*comment]) {
                *comment = photographed.times(scale.into()).to_string();
            }
        }
        if metadata.cd_m2_per_unit.is_none() && scale != 1.0 {
            described.comments.push(format!("relative radiance times {scale}"));
        }
        directory.capture(&described);
        if let Some(luminance) = metadata.white_luminance() {
            directory.double(tag::STONITS, luminance / f64::from(scale));
        }
        let xyz = NeutralXyz::of(&metadata.primaries);
        Ok(Writer { strips, bands: Bands::new(size), xyz, depth, scale, beyond: 0 })
    }
}

impl RowWriter<[f32; 3]> for Writer {
    fn push(&mut self, rows: &[[f32; 3]]) -> Result<()> {
        let Writer { strips, bands, xyz, depth, scale, beyond } = self;
        let width = bands.width;
        bands.push(
            rows,
            |_, pixels, row, out| encode_band(pixels, width, xyz, *depth, *scale, row, out),
            |strip, count| {
                *beyond += count;
                strips.put(strip)
            },
        )
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        self.bands.complete().map_err(|e| self.strips.file.error(e))?;
        let (low, high) = self.depth.range();
        let larger = match self.depth {
            Depth::Bits24 => "logluv32 or float",
            Depth::Bits32 => "float",
        };
        let what = format!(
            "of luminance are outside of the range from {:.2e} to {:.3e} and were set to 0 or to the largest value; for a larger range, give --tiff-encoding {larger}",
            low / self.scale,
            high / self.scale
        );
        let warnings = clamped(&self.strips.file, self.beyond, &what);
        Written::ended(self.strips.end()?, warnings)
    }
}

/// Appends the encoded rows to `out`; returns the number of pixels out of range.
fn encode_band(
    pixels: &[[f32; 3]],
    width: usize,
    xyz: &NeutralXyz,
    depth: Depth,
    scale: f32,
    row: &mut Vec<u32>,
    out: &mut Vec<u8>,
) -> u64 {
    out.reserve(4 * pixels.len());
    let mut beyond = 0;
    let (low, high) = depth.range();
    row.resize(width, 0);
    for rgb in pixels.chunks_exact(width) {
        for (code, &p) in row.iter_mut().zip(rgb) {
            let c = xyz.of_rgb(p).map(|v| v * scale);
            beyond += u64::from(!(low..=high).contains(&c[1]));
            *code = match depth {
                Depth::Bits24 => logluv::encode24(c),
                Depth::Bits32 => logluv::encode32(c),
            };
        }
        match depth {
            Depth::Bits24 => out.extend(row.iter().flat_map(|code: &u32| {
                let [_, a, b, c] = code.to_be_bytes();
                [a, b, c]
            })),
            Depth::Bits32 => logluv::put_row(row, out),
        }
    }
    beyond
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::{Conversion, Primaries};
    use crate::error::Warning;
    use crate::merge::radiance::calibration::Factor;
    use crate::plane::Plane;
    use crate::write::{commit, push_all};

    fn written(map: &RadianceMap, metadata: &Metadata, depth: Depth) -> (RadianceMap, Metadata, Vec<Warning>, Vec<u8>) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.tif");
        let size = (map.pixels.width(), map.pixels.height());
        let metadata = Metadata { primaries: map.primaries, ..metadata.clone() };
        let pending = Pending::create(&path).unwrap();
        let scale = scale_under(depth, bright(map));
        let writer = Writer::new(pending, size, &metadata, depth, scale).unwrap();
        let whole = push_all(Box::new(writer), &map.pixels).unwrap();
        commit(vec![whole.file], false).unwrap();
        let (back, read) = crate::read::read(&path).unwrap();
        (back, read, whole.warnings, std::fs::read(&path).unwrap())
    }

    fn picture(scale: f32) -> RadianceMap {
        let pixels = Plane::from_rows(70, 64 * 3 + 5, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let v = scale * libm::exp2f(y as f32 / 20.0 - 8.0);
                *p = if x < 30 { [v; 3] } else { [v, v * (0.3 + x as f32 / 100.0), v * 0.2] };
            }
        });
        RadianceMap { pixels, primaries: Primaries::SRGB }
    }

    /// The tolerances are half a step. Half a step of luminance is 0.55 % with 24 bits and 0.14 % with 32 bits. Half
    /// a step of the chromaticities u' and v' is 0.00175 with 24 bits and 0.00122 with 32 bits. For the colours of
    /// this test, it changes red or blue by up to 5 % of the largest component.
    #[test]
    fn pixels_are_read_back_within_the_steps() {
        for (depth, tolerance) in [(Depth::Bits24, 0.0056), (Depth::Bits32, 0.0014)] {
            for scale in [1.0, 300.0] {
                let map = picture(scale);
                let luminance = (scale != 1.0).then_some(Factor::ONE);
                let metadata = Metadata { cd_m2_per_unit: luminance, ..Metadata::default() };
                let (back, read, warnings, _) = written(&map, &metadata, depth);
                assert_eq!(warnings, []);
                assert_eq!(read.cd_m2_per_unit, luminance);
                let to_srgb = Conversion::between(&back.primaries, &Primaries::SRGB).unwrap();
                for (a, b) in map.pixels.as_slice().iter().zip(back.pixels.as_slice()) {
                    let b = to_srgb.apply(*b);
                    let y = |c: [f32; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
                    assert!((y(b) / y(*a) - 1.0).abs() < tolerance + 1e-5, "{a:?} {b:?}");
                    let largest = a[0].max(a[1]);
                    assert!((0..3).all(|c| (a[c] - b[c]).abs() < 0.05 * largest), "{a:?} {b:?}");
                }
            }
        }
    }

    #[test]
    fn colours_outside_the_space_are_reported() {
        let mut map = picture(1.0);
        map.pixels.row_mut(3)[5] = [1e6; 3];
        map.pixels.row_mut(3)[6] = [1e-6; 3];
        let (back, _, warnings, _) = written(&map, &Metadata::default(), Depth::Bits24);
        assert!(
            matches!(&warnings[..], [Warning::OutOfRange { detail, .. }] if detail.starts_with("2 values")),
            "{warnings:?}"
        );
        assert!(back.pixels.at(6, 3) == [0.0; 3] && (back.pixels.at(5, 3)[1] - 15.83).abs() < 0.1);
        assert_eq!(written(&map, &Metadata::default(), Depth::Bits32).2, []);
    }

    #[test]
    fn the_bytes_are_the_same_on_any_number_of_threads() {
        let map = picture(1.0);
        let on = |threads, depth| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| written(&map, &Metadata::default(), depth).3)
        };
        assert!([Depth::Bits24, Depth::Bits32].into_iter().all(|depth| on(1, depth) == on(5, depth)));
    }
}
