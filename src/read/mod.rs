//! Reading back: radiance maps as our own writers and other programs make them.
//!
//! In: an `.exr`, `.hdr` or floating-point `.tif`, known by its content and never by its name. Out: a [`RadianceMap`] as it was stored,
//! and the [`Metadata`] that came along; with [`read_within`] also what else the file holds. Cost: see each format.
//!
//! What is stored is given as it is by [`read`], but for the scale that a header tells: `.hdr` is divided by its EXPOSURE, LogLuv
//! multiplied by its StoNits. Other programs write 0, negative numbers, infinities and NaN; [`repair`] makes of them what the later
//! stages take, and counts them.

pub mod exr;
pub mod hdr;
pub mod tiff;

use crate::bracket::colour::Primaries;
use crate::error::{Error, Result, Warning};
use crate::intake;
use crate::limits::Limits;
use crate::merge::calibration::Factor;
use crate::merge::gamut::{into_gamut, weights};
use crate::merge::{FLOOR, RadianceMap};
use crate::plane::{BAND_ROWS, Plane};
use crate::write::Metadata;
use rayon::prelude::*;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// The radiance in the file `path`, and what its headers tell. Values may be anything that a float can be.
///
/// # Errors
/// Those of [`read_within`], with the limits that are by default.
pub fn read(path: &Path) -> Result<(RadianceMap, Metadata)> {
    read_within(path, &Limits::default()).map(|Contents { map, metadata, .. }| (map, metadata))
}

/// What a file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Contents {
    /// Its radiance.
    pub map: RadianceMap,
    /// What its headers tell.
    pub metadata: Metadata,
    /// What it holds beside that and is not read: `alpha`, `channel Z`, `layer left`.
    pub unread: Vec<String>,
    /// What was wrong with its headers and what was done about it, for people.
    pub notes: Vec<String>,
}

impl Contents {
    /// The radiance `pixels`, of which the headers told `metadata`, its primaries among it. Primaries that span no colour space are
    /// replaced, with a note.
    fn new(pixels: Plane<[f32; 3]>, mut metadata: Metadata) -> Self {
        let mut notes = Vec::new();
        if metadata.primaries.to_xyz().is_none() {
            metadata.primaries = Primaries::SRGB;
            notes.push("its chromaticities span no colour space; those of BT.709 are assumed".to_owned());
        }
        let map = RadianceMap { pixels, primaries: metadata.primaries };
        Contents { map, metadata, unread: Vec::new(), notes }
    }

    /// `luminance` as the unit of radiance in cd/m2, by the header `name`; radiance stays relative, with a note, where it is no [`Factor`].
    fn set_unit(&mut self, name: &str, luminance: Option<f64>) {
        self.metadata.cd_m2_per_unit = luminance.and_then(Factor::new);
        if let (Some(luminance), None) = (luminance, self.metadata.cd_m2_per_unit) {
            self.notes.push(format!(
                "its {name} is {luminance}, no number from 1e-20 to 1e20; its radiance is taken for relative"
            ));
        }
    }

    /// The notes as warnings about the file `path`.
    pub fn warnings(&self, path: &Path) -> Vec<Warning> {
        let warning = |detail: &String| Warning::Metadata { path: path.to_owned(), detail: detail.clone() };
        self.notes.iter().map(warning).collect()
    }
}

/// All that is known of the file `path`, which may ask for what `limits` allow.
///
/// # Errors
/// [`Error::Read`], [`Error::Changed`]; [`Error::NotRadiance`] where the content is none of the formats; [`Error::Decode`] where it is
/// damaged, cut short, of a kind that is not read, or asks for more than is allowed.
pub fn read_within(path: &Path, limits: &Limits) -> Result<Contents> {
    let kind = Kind::of(path)?;
    let bytes = intake::whole(path, limits.most_bytes())?;
    // The decoders are other people's; should one of them panic on a damaged file, that is this file's fault, not the run's.
    let parsed = catch_unwind(AssertUnwindSafe(|| match kind {
        Kind::Exr => exr::parse(&bytes, limits),
        Kind::Hdr => hdr::parse(&bytes, limits),
        Kind::Tiff => tiff::parse(bytes, limits),
    }));
    let parsed = parsed.unwrap_or_else(|_| Err("it is damaged beyond what its decoder can tell; copy it again".into()));
    let mut contents = parsed.map_err(|reason| Error::Decode { path: path.to_owned(), format: kind.name(), reason })?;
    let scale = std::mem::replace(&mut contents.metadata.exposure_scale, Factor::ONE);
    if scale != Factor::ONE {
        let factor = (1.0 / scale.get()) as f32;
        contents.map.pixels.as_mut_slice().par_iter_mut().for_each(|p| *p = p.map(|v| v * factor));
    }
    Ok(contents)
}

/// Whether the first bytes of the file `path` are those of a radiance map.
///
/// # Errors
/// [`Error::Read`], [`Error::NotRadiance`].
pub fn check(path: &Path) -> Result<()> {
    Kind::of(path).map(|_| ())
}

/// Whether the file `path` is a radiance map, told by its content; a TIFF, as long as `limits` allow, is one by its floats or its LogLuv.
///
/// # Errors
/// [`Error::Read`]; [`Error::Decode`] for a TIFF whose directory is damaged.
pub fn holds_radiance(path: &Path, limits: &Limits) -> Result<bool> {
    match Kind::of(path) {
        Ok(Kind::Exr | Kind::Hdr) => Ok(true),
        Ok(Kind::Tiff) => tiff::holds_radiance(path, limits),
        Err(Error::NotRadiance { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// The formats that are read.
enum Kind {
    Exr,
    Hdr,
    Tiff,
}

impl Kind {
    /// For messages.
    fn name(&self) -> &'static str {
        match self {
            Kind::Exr => "OpenEXR",
            Kind::Hdr => "Radiance HDR",
            Kind::Tiff => "TIFF",
        }
    }

    /// By the first bytes.
    fn of(path: &Path) -> Result<Self> {
        let unreadable = |source| Error::Read { path: path.to_owned(), source };
        let mut start = Vec::new();
        intake::open_regular(path)?.take(16).read_to_end(&mut start).map_err(unreadable)?;
        let found = match start.as_slice() {
            [0x76, 0x2f, 0x31, 0x01, ..] => return Ok(Kind::Exr),
            [b'#', b'?', ..] => return Ok(Kind::Hdr),
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => return Ok(Kind::Tiff),
            [] => "an empty file",
            [0xff, 0xd8, 0xff, ..] => "a JPEG picture",
            [0x89, b'P', b'N', b'G', ..] => "a PNG picture",
            [b'P', b'F' | b'f', b'\n', ..] => "a PFM picture",
            [_, _, _, _, b'f', b't', b'y', b'p', ..] => "a HEIF, AVIF or MP4 file",
            _ => "of an unknown format",
        };
        Err(Error::NotRadiance { path: path.to_owned(), found })
    }
}

/// How stored lines lie in the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Turn {
    /// Lines are columns.
    pub transposed: bool,
    /// What comes first is on the right.
    pub mirrored: bool,
    /// What comes first is at the bottom.
    pub flipped: bool,
}

impl Turn {
    /// As it is to be seen.
    pub(crate) fn upright<T: Copy + Default + Send + Sync>(self, stored: Plane<T>) -> Plane<T> {
        if !(self.transposed || self.mirrored || self.flipped) {
            return stored;
        }
        let (mut width, mut height) = (stored.width(), stored.height());
        if self.transposed {
            (width, height) = (height, width);
        }
        Plane::from_rows(width, height, |y, row| {
            let y = if self.flipped { height - 1 - y } else { y };
            for (x, p) in row.iter_mut().enumerate() {
                let x = if self.mirrored { width - 1 - x } else { x };
                *p = if self.transposed { stored.at(y, x) } else { stored.at(x, y) };
            }
        })
    }
}

/// What had to be mended before a picture could be used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Repaired {
    /// Pixels with a value that is no number: they are black.
    pub not_numbers: usize,
    /// Pixels with an infinite value, which became the greatest finite value of the picture.
    pub infinite: usize,
    /// Pixels with a negative value: colours that the primaries do not hold, drawn to grey at their luminance until they do; black where
    /// they have none.
    pub negative: usize,
}

impl Repaired {
    /// In words, if anything was done.
    pub fn warnings(&self, path: &Path) -> Vec<Warning> {
        let all = [
            (self.not_numbers, "pixels hold values that are no numbers (NaN); they are shown black"),
            (self.infinite, "pixels hold infinite values; they are shown as bright as the brightest other"),
            (
                self.negative,
                "pixels hold negative values, colours outside of their primaries; they are drawn to grey until inside",
            ),
        ];
        let told = all.into_iter().filter(|(count, _)| *count > 0);
        told.map(|(count, what)| Warning::Metadata { path: path.to_owned(), detail: format!("{count} {what}") })
            .collect()
    }
}

/// `map` with every value positive and finite, and what was done for that. Zeros become [`FLOOR`] without being counted. A map as it was
/// merged is not changed.
pub fn repair(mut map: RadianceMap) -> (RadianceMap, Repaired) {
    let values = || map.pixels.as_slice().as_flattened().par_iter();
    let greatest = values().copied().filter(|v| v.is_finite()).reduce(|| FLOOR, f32::max);
    let weights = weights(&map.primaries);
    let band = (BAND_ROWS * map.pixels.width()).max(1);
    let parts = map.pixels.as_mut_slice().par_chunks_mut(band).map(|pixels| {
        let mut done = Repaired::default();
        for pixel in pixels {
            if pixel.iter().any(|v| v.is_nan()) {
                done.not_numbers += 1;
                *pixel = [FLOOR; 3];
                continue;
            }
            if pixel.iter().any(|v| v.is_infinite()) {
                done.infinite += 1;
                *pixel = pixel.map(|v| v.clamp(-greatest, greatest));
            }
            let (inside, drawn) = into_gamut(*pixel, weights);
            done.negative += usize::from(drawn);
            *pixel = inside;
        }
        done
    });
    // Whole numbers add up to the same in any order.
    let done = parts.reduce(Repaired::default, |a, b| Repaired {
        not_numbers: a.not_numbers + b.not_numbers,
        infinite: a.infinite + b.infinite,
        negative: a.negative + b.negative,
    });
    (map, done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_stage_takes_is_mended_and_counted() {
        let odd = vec![
            [f32::NAN, 1.0, 1.0],
            [f32::INFINITY, 2.0, 7.0],
            [-0.1, 1.0, 1.0],
            [-1.0, -1.0, -1.0],
            [0.0, 0.5, 0.5],
            [f32::NEG_INFINITY, 1.0, 1.0],
        ];
        let map = RadianceMap { pixels: Plane::from_vec(6, 1, odd), primaries: Primaries::SRGB };
        let (mended, done) = repair(map);
        assert_eq!(done, Repaired { not_numbers: 1, infinite: 2, negative: 3 });
        assert!(mended.pixels.as_slice().as_flattened().iter().all(|v| *v >= FLOOR && v.is_finite()));
        assert_eq!((mended.pixels.at(0, 0), mended.pixels.at(1, 0)), ([FLOOR; 3], [7.0, 2.0, 7.0]));
        assert_eq!((mended.pixels.at(4, 0), mended.pixels.at(3, 0)), ([FLOOR, 0.5, 0.5], [FLOOR; 3]));
        let [r, g, b] = mended.pixels.at(2, 0);
        let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        assert!((luminance - (0.7874 - 0.02126)).abs() < 1e-5 && r == FLOOR && g == b);
        assert_eq!(repair(mended.clone()), (mended, Repaired::default()));
        assert_eq!(done.warnings(Path::new("a.exr")).len(), 3);
    }

    #[test]
    fn content_decides_and_what_is_no_radiance_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        for (bytes, named) in [
            (&b"\xff\xd8\xff\xe0 and so on"[..], "JPEG"),
            (b"\x89PNG\r\n\x1a\n", "PNG"),
            (b"", "empty"),
            (b"PF\n2 2\n-1.0\n", "PFM"),
            (b"whatever it is", "unknown"),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let error = read(&path).unwrap_err();
            assert!(matches!(error, Error::NotRadiance { .. }) && error.to_string().contains(named), "{error}");
        }
        for cut in [&b"\x76\x2f\x31\x01\x02\0"[..], b"#?RADIANCE\n", b"II\x2a\0\x08\0\0\0", b"MM\0\x2a\0\0\0\x08"] {
            std::fs::write(&path, cut).unwrap();
            let error = read(&path).unwrap_err();
            assert!(matches!(error, Error::Decode { .. } | Error::Read { .. }), "{error}");
        }
        assert!(matches!(read(dir.path()), Err(Error::Read { .. })));
        std::fs::write(&path, b"\x89PNG\r\n\x1a\n").unwrap();
        assert!(!holds_radiance(&path, &Limits::default()).unwrap());
        std::fs::write(&path, b"#?RADIANCE\n").unwrap();
        assert!(holds_radiance(&path, &Limits::default()).unwrap());
        assert!(matches!(read(&dir.path().join("gone.exr")), Err(Error::Read { .. })));
    }
}
