//! Writes the format `.hdr` of the program Radiance: RGBE or XYZE pixels after a text header.
//!
//! In: linear RGB by rows. Out: a file that `evalglare`, `pcomb` and `pfilt` read with the right units. RGBE stores
//! W/sr/m2 multiplied by EXPOSURE, so luminance = 179 (0.2126 R + 0.7152 G + 0.0722 B) / EXPOSURE for BT.709's
//! primaries. XYZE stores cd/m2 multiplied by EXPOSURE, so luminance = Y / EXPOSURE. In XYZE a grey pixel has X = Y =
//! Z, as in the program Radiance, and the header has no primaries. The module [`read`](crate::read) reads both. Cost:
//! 25 ns per pixel and core; files have 3 to 4 bytes per pixel. Source: "Radiance File Formats" (Ward, LBNL),
//! "Picture Format"; `src/common/header.c`, `color.c`, `src/px/ra_xyze.c`.

use super::bands::Bands;
use super::metadata::{Metadata, one_line};
use super::row_writer::RowWriter;
use super::staging::{Pending, Written, clamped};
use crate::bracket::colour::{NeutralXyz, Primaries};
use crate::error::Result;
use crate::merge::Photographed;
use crate::pixel::rgbe::Scanline;

/// Luminous efficacy of white in lm/W, as the program Radiance defines it.
pub const WHITE_EFFICACY: f64 = 179.0;

/// Pixel encoding of a Radiance file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Encoding {
    /// Red, green and blue with a shared exponent: the usual encoding.
    #[default]
    Rgbe,
    /// CIE XYZ with a shared exponent: contains every visible colour.
    Xyze,
}

/// The `.hdr` writer.
#[doc(hidden)]
#[derive(Debug)]
pub struct Writer {
    file: Pending,
    bands: Bands<[f32; 3], Scratch>,
    to_stored: ToStored,
    over: u64,
}

/// Conversion from the linear RGB of the rows to the stored components.
#[derive(Debug, Clone, Copy)]
struct ToStored {
    xyz: Option<NeutralXyz>,
    /// The values of the rows are multiplied by this factor; the multiplication is skipped if it is 1.
    factor: f32,
}

impl ToStored {
    fn of(metadata: &Metadata, encoding: Encoding) -> Self {
        // Calibrated radiance is stored in the unit of the encoding, W/sr/m2 or cd/m2, so that the values are also
        // right in programs that ignore EXPOSURE.
        let factor = match (metadata.cd_m2_per_unit, encoding) {
            (None, _) => 1.0,
            (Some(luminance), Encoding::Rgbe) => luminance.get() / WHITE_EFFICACY,
            (Some(luminance), Encoding::Xyze) => luminance.get(),
        };
        let xyz = match encoding {
            Encoding::Rgbe => None,
            Encoding::Xyze => Some(NeutralXyz::of(&metadata.primaries)),
        };
        ToStored { xyz, factor: factor as f32 }
    }

    /// Whether pixels are stored unchanged.
    fn keeps(&self) -> bool {
        self.xyz.is_none() && self.factor == 1.0
    }

    #[inline]
    fn pixel(&self, rgb: [f32; 3]) -> [f32; 3] {
        let stored = self.xyz.map_or(rgb, |xyz| xyz.of_rgb(rgb));
        if self.factor == 1.0 { stored } else { stored.map(|v| v * self.factor) }
    }
}

impl Writer {
    /// Writes the header of a picture of `size` pixels; rows of linear RGB follow.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn new(mut file: Pending, size: (usize, usize), metadata: &Metadata, encoding: Encoding) -> Result<Self> {
        file.put(header(size, metadata, encoding).as_bytes())?;
        Ok(Writer { file, bands: Bands::new(size), to_stored: ToStored::of(metadata, encoding), over: 0 })
    }
}

impl RowWriter<[f32; 3]> for Writer {
    fn push(&mut self, rows: &[[f32; 3]]) -> Result<()> {
        let Writer { file, bands, to_stored, over } = self;
        let width = bands.width;
        bands.push(
            rows,
            |_, pixels, scratch, out| encode_band(pixels, width, to_stored, scratch, out),
            |bytes, beyond| {
                *over += beyond;
                file.put(bytes)
            },
        )
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        self.bands.complete().map_err(|e| self.file.error(e))?;
        let warnings = clamped(&self.file, self.over, "are above 1.7e38 and were set to 1.7e38");
        Written::ended(self.file, warnings)
    }
}

/// Buffers for a row: its values in the stored unit and colour space, and their encoding.
#[derive(Debug, Default)]
struct Scratch {
    stored: Vec<[f32; 3]>,
    scanline: Scanline,
}

/// Appends the encoded rows to `out`; returns the number of values out of range.
fn encode_band(
    pixels: &[[f32; 3]],
    width: usize,
    to_stored: &ToStored,
    scratch: &mut Scratch,
    out: &mut Vec<u8>,
) -> u64 {
    out.reserve(pixels.len() * 4);
    let Scratch { stored, scanline } = scratch;
    let rows = pixels.chunks_exact(width).map(|row| {
        if to_stored.keeps() {
            return scanline.put(row, out);
        }
        stored.clear();
        stored.extend(row.iter().map(|&p| to_stored.pixel(p)));
        scanline.put(stored, out)
    });
    rows.sum()
}

/// Returns the header, the blank line and the resolution line.
fn header((width, height): (usize, usize), metadata: &Metadata, encoding: Encoding) -> String {
    let mut lines = vec!["#?RADIANCE".to_owned()];
    // Readers convert pixels to W/sr/m2: they divide by EXPOSURE, and in XYZE also by 179. The radiances in comments
    // must have the same unit.
    let unit = metadata.cd_m2_per_unit.map_or(1.0, |luminance| luminance.get() / WHITE_EFFICACY);
    let in_unit = |comment: &String| match Photographed::read([comment]) {
        Some(photographed) if unit != 1.0 => photographed.times(unit).to_string(),
        _ => one_line(comment),
    };
    lines.extend(metadata.comments.iter().map(|comment| format!("# {}", in_unit(comment))));
    lines.push(format!("SOFTWARE={}", one_line(&metadata.software)));
    lines.extend(metadata.camera().map(|c| format!("CAMERA={c}")));
    let date = metadata.capture.date.as_deref().map(one_line);
    lines.extend(date.map(|d| format!("CAPDATE= {d}")));
    // LENS and the names below are specific to hdralign; other readers skip unknown names.
    lines.extend(metadata.capture.lens.as_deref().map(|l| format!("LENS={}", one_line(l))));
    let numbers = [
        ("FOCAL_LENGTH_MM", metadata.capture.focal_length_mm),
        ("SHUTTER_S", metadata.time_s),
        ("F_NUMBER", metadata.f_number),
        ("ISO", metadata.iso),
    ];
    lines.extend(numbers.into_iter().filter_map(|(name, v)| v.map(|v| format!("{name}={v}"))));
    // EXPOSURE is at column 0 and occurs once: evalglare fails on a tab before it, and multiplies the values if there
    // are several.
    lines.push(format!("EXPOSURE={:e}", exposure(metadata, encoding)));
    match encoding {
        Encoding::Rgbe => {
            let Primaries { red, green, blue, white } = metadata.primaries;
            let xy = [red, green, blue, white].map(|[x, y]| format!(" {x:.4} {y:.4}"));
            lines.push(format!("PRIMARIES={}", xy.concat()));
            lines.push("FORMAT=32-bit_rle_rgbe".into());
        }
        Encoding::Xyze => lines.push("FORMAT=32-bit_rle_xyze".into()),
    }
    format!("{}\n\n-Y {height} +X {width}\n", lines.join("\n"))
}

/// Returns the value of EXPOSURE: a stored value divided by EXPOSURE is in W/sr/m2 (RGBE) or cd/m2 (XYZE). If
/// radiance is not calibrated, its value 1 is taken as 1 W/sr/m2.
fn exposure(metadata: &Metadata, encoding: Encoding) -> f64 {
    match (metadata.cd_m2_per_unit, encoding) {
        (None, Encoding::Xyze) => metadata.exposure_scale.get() / WHITE_EFFICACY,
        _ => metadata.exposure_scale.get(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Capture;
    use crate::error::Warning;
    use crate::limits::Limits;
    use crate::merge::RadianceMap;
    use crate::merge::radiance::calibration::Factor;
    use crate::pixel::rgbe;
    use crate::plane::Plane;
    use crate::read::hdr;
    use crate::write::{commit, push_all};

    fn parsed(bytes: &[u8]) -> (RadianceMap, Metadata) {
        let contents = hdr::parse(bytes, &Limits::default()).unwrap();
        (contents.map, contents.metadata)
    }

    fn factor(value: f64) -> Factor {
        Factor::new(value).unwrap()
    }

    fn picture(width: usize, height: usize) -> Plane<[f32; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let v = ((x * 7919 + y * 104_729) % 1000) as f32 + 0.25;
                *p = if x / 40 % 2 == 0 { [1.5, 0.75, 0.1] } else { [v, v * v / 50.0, 1.0 / v] };
            }
        })
    }

    fn written(picture: &Plane<[f32; 3]>, metadata: &Metadata) -> (Vec<u8>, Vec<Warning>) {
        encoded(picture, metadata, Encoding::Rgbe)
    }

    fn encoded(picture: &Plane<[f32; 3]>, metadata: &Metadata, encoding: Encoding) -> (Vec<u8>, Vec<Warning>) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.hdr");
        let size = (picture.width(), picture.height());
        let writer = Writer::new(Pending::create(&path).unwrap(), size, metadata, encoding).unwrap();
        let whole = push_all(Box::new(writer), picture).unwrap();
        commit(vec![whole.file], false).unwrap();
        (std::fs::read(&path).unwrap(), whole.warnings)
    }

    #[test]
    fn the_header_is_to_the_letter() {
        let metadata = Metadata {
            software: "hdralign 1.2.3".into(),
            capture: Capture {
                make: Some("Canon".into()),
                model: Some("Canon EOS 5D".into()),
                date: Some("2009:07:11 12:34:56".into()),
                ..Capture::default()
            },
            exposure_scale: factor(0.5),
            ..Metadata::default()
        };
        let golden = "#?RADIANCE\nSOFTWARE=hdralign 1.2.3\nCAMERA=Canon EOS 5D\nCAPDATE= 2009:07:11 12:34:56\nEXPOSURE=5e-1\n\
            PRIMARIES= 0.6400 0.3300 0.3000 0.6000 0.1500 0.0600 0.3127 0.3290\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n";
        assert_eq!(header((3, 2), &metadata, Encoding::Rgbe), golden);
        let (bytes, _) = written(&Plane::filled(3, 2, [1.0, 0.5, 0.25]), &metadata);
        assert_eq!(bytes, [golden.as_bytes(), &[128, 64, 32, 129].repeat(6)].concat());
    }

    /// The luminance of the pixel (1, 1, 1) must be `cd_m2_per_unit` / `exposure_scale`. Readers compute it as 179 G
    /// / EXPOSURE in RGBE (G is green) and as Y / EXPOSURE in XYZE.
    #[test]
    fn calibrated_luminance_is_in_pixels_and_exposure() {
        let metadata = Metadata {
            cd_m2_per_unit: Some(factor(358.0)),
            exposure_scale: factor(4.0),
            comments: vec!["one\ntwo".into()],
            ..Metadata::default()
        };
        let white = Plane::filled(8, 1, [1.0; 3]);
        let (bytes, _) = written(&white, &metadata);
        let (map, back) = parsed(&bytes);
        assert_eq!(back.exposure_scale, factor(4.0));
        // 358 cd/m2 are 2 W/sr/m2 (divided by 179 lm/W). This is stored with the mantissa 128; the reader adds half a
        // step to the mantissa.
        assert_eq!(map.pixels.at(0, 0), [2.0 * 128.5 / 128.0; 3]);
        assert!(bytes.starts_with(b"#?RADIANCE\n# one two\nSOFTWARE="));
        let (bytes, _) = encoded(&white, &metadata, Encoding::Xyze);
        assert!(String::from_utf8_lossy(&bytes).contains("EXPOSURE=4e0\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 8\n"));
        assert_eq!(bytes[bytes.len() - 8..][..2], [136, 179], "358 = 179 / 256 * 2^9 in runs of 8");
        let relative = Metadata { cd_m2_per_unit: None, ..metadata };
        let (bytes, _) = encoded(&white, &relative, Encoding::Xyze);
        let (map, back) = parsed(&bytes);
        // After reading, the exposure scale is 4 again and the value of white is 1.
        assert!((back.exposure_scale.get() - 4.0).abs() < 1e-12 && (map.pixels.at(0, 0)[1] - 1.0).abs() < 0.01);
    }

    /// The tone mapping operator `natural` computes its exposure from the radiances in the comment. They must have
    /// the same unit as the pixels that are read from the file.
    #[test]
    fn radiances_of_the_comment_have_the_unit_of_the_pixels() {
        let photographed = Photographed { longest: 0.5, shortest: 8.0, contrast: 1.2, white_stops: 2.5 };
        let metadata = Metadata {
            cd_m2_per_unit: Some(factor(358.0)),
            comments: vec![photographed.to_string()],
            ..Metadata::default()
        };
        let grey = Plane::filled(8, 1, [0.5; 3]);
        for encoding in [Encoding::Rgbe, Encoding::Xyze] {
            let (map, back) = parsed(&encoded(&grey, &metadata, encoding).0);
            let longest = Photographed::read(&back.comments).unwrap().longest;
            let pixel = f64::from(map.pixels.at(4, 0)[1]) / back.exposure_scale.get();
            // The tolerance of 1 % covers the rounding of a pixel: a step of the mantissa is at most 1/128 of the
            // value.
            assert!((pixel / longest - 1.0).abs() < 0.01, "{encoding}: {pixel} {longest}");
        }
    }

    /// The `image` crate decodes a channel to mantissa * 2^(exponent - 136). hdralign adds half a step of the
    /// mantissa, so its values are larger by that half step.
    #[test]
    fn another_decoder_reads_the_same_pixels() {
        use image::ImageDecoder;
        for (width, height) in [(7, 3), (8, 70), (513, 130), (32768, 2)] {
            let picture = picture(width, height);
            let (bytes, warnings) = written(&picture, &Metadata::default());
            assert_eq!(warnings, []);
            let decoder = image::codecs::hdr::HdrDecoder::new(std::io::Cursor::new(&bytes)).unwrap();
            let mut theirs = vec![0; decoder.total_bytes() as usize];
            decoder.read_image(&mut theirs).unwrap();
            let ours = parsed(&bytes).0.pixels;
            for ((p, q), t) in picture.as_slice().iter().zip(ours.as_slice()).zip(theirs.chunks_exact(12)) {
                let (rgbe, _) = rgbe::encode(*p);
                let step = libm::ldexpf(1.0, i32::from(rgbe[3]) - 136);
                for c in 0..3 {
                    let t = f32::from_ne_bytes(t[4 * c..4 * c + 4].try_into().unwrap());
                    assert_eq!((t, q[c]), (f32::from(rgbe[c]) * step, t + 0.5 * step));
                }
            }
        }
    }

    #[test]
    fn the_bytes_are_the_same_on_any_number_of_threads() {
        let picture = picture(100, 64 * 20 + 3);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| written(&picture, &Metadata::default()).0)
        };
        assert!(on(1) == on(2) && on(1) == on(7));
    }

    #[test]
    fn values_out_of_range_are_reported() {
        let (_, warnings) = written(&Plane::filled(9, 1, [f32::MAX, 1.0, 1.0]), &Metadata::default());
        assert!(matches!(&warnings[..], [Warning::OutOfRange { detail, .. }] if detail.starts_with("9 values")));
    }
}
