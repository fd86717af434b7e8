//! What is compared: a radiance map or a picture, told apart by content.
//!
//! In: a file. Out: its pixels, and what its headers tell. Cost: that of the decoders.

use super::{Changed, Side};
use crate::bracket::colour::Primaries;
use crate::bracket::{Photograph, Samples};
use crate::error::{Error, Result, Warning};
use crate::intake::Stamp;
use crate::limits::Limits;
use crate::merge::RadianceMap;
use crate::read;
use crate::write::Metadata;
use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// A file, read.
pub(super) struct Input {
    path: PathBuf,
    pub pixels: Pixels,
    pub warnings: Vec<Warning>,
    /// It is read again where bytes are compared.
    stamp: Stamp,
}

/// What it holds.
pub(super) enum Pixels {
    Radiance(RadianceMap, Box<Metadata>),
    Display(Box<Photograph>),
}

impl Input {
    /// Reads the file `path`, which may ask for what `limits` allow.
    pub fn open(path: &Path, limits: &Limits) -> Result<Input> {
        let path = path.to_owned();
        let stamp = Stamp::of(&path)?;
        if read::holds_radiance(&path, limits)? {
            let (map, metadata) = read::read_within(&path, limits)?;
            return Ok(Input { path, pixels: Pixels::Radiance(map, Box::new(metadata)), warnings: Vec::new(), stamp });
        }
        match Photograph::read(&path, limits) {
            Ok((photograph, mut warnings)) => {
                if has_alpha(&path) {
                    let detail = "its alpha is not compared".into();
                    warnings.push(Warning::Metadata { path: path.clone(), detail });
                }
                Ok(Input { path, pixels: Pixels::Display(Box::new(photograph)), warnings, stamp })
            }
            Err(Error::UnknownFormat { path, found }) => Err(Error::NotComparable { path, found }),
            Err(error) => Err(error),
        }
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (usize, usize) {
        match &self.pixels {
            Pixels::Radiance(map, _) => (map.pixels.width(), map.pixels.height()),
            Pixels::Display(photograph) => (photograph.width, photograph.height),
        }
    }

    /// For messages.
    pub fn kind(&self) -> &'static str {
        match self.pixels {
            Pixels::Radiance(..) => "radiance",
            Pixels::Display(_) => "a display picture",
        }
    }

    /// The last part of its name, for people.
    pub fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// For the report.
    pub fn side(&self) -> Side {
        let (width_px, height_px) = self.size();
        let depth_bits = match &self.pixels {
            Pixels::Radiance(..) => None,
            Pixels::Display(photograph) => Some(if photograph.samples.max() == u16::MAX { 16 } else { 8 }),
        };
        Side { path: self.path.to_string_lossy().into_owned(), width_px, height_px, depth_bits }
    }

    /// Red, green and blue at a pixel: radiance, or codes.
    pub fn at(&self, x: usize, y: usize) -> [f64; 3] {
        match &self.pixels {
            Pixels::Radiance(map, _) => map.pixels.at(x, y).map(f64::from),
            Pixels::Display(photograph) => {
                let at = 3 * (y * photograph.width + x);
                match &photograph.samples {
                    Samples::Eight(v) => [0, 1, 2].map(|c| f64::from(v[at + c])),
                    Samples::Sixteen(v) => [0, 1, 2].map(|c| f64::from(v[at + c])),
                }
            }
        }
    }

    /// Whether the files are the same to the byte.
    pub fn bytes_equal(&self, other: &Input) -> Result<bool> {
        let equal = self.compare_bytes(other)?;
        self.stamp.check()?;
        other.stamp.check()?;
        Ok(equal)
    }

    /// Refuses a file that is another than the one that was opened.
    pub fn check_unchanged(&self) -> Result<()> {
        self.stamp.check()
    }

    fn compare_bytes(&self, other: &Input) -> Result<bool> {
        let unreadable = |path: &Path, source| Error::Read { path: path.to_owned(), source };
        let length = |path: &Path| fs::metadata(path).map(|m| m.len()).map_err(|e| unreadable(path, e));
        if length(&self.path)? != length(&other.path)? {
            return Ok(false);
        }
        let open = |path: &Path| File::open(path).map(BufReader::new).map_err(|e| unreadable(path, e));
        let (mut a, mut b) = (open(&self.path)?, open(&other.path)?);
        let (mut left, mut right) = (vec![0; 1 << 16], vec![0; 1 << 16]);
        loop {
            let n = a.read(&mut left).map_err(|e| unreadable(&self.path, e))?;
            if n == 0 {
                return Ok(true);
            }
            b.read_exact(&mut right[..n]).map_err(|e| unreadable(&other.path, e))?;
            if left[..n] != right[..n] {
                return Ok(false);
            }
        }
    }

    /// What the headers tell differently.
    pub fn changed(&self, other: &Input) -> Vec<Changed> {
        let (ours, theirs) = (self.told(), other.told());
        let both = ours.into_iter().zip(theirs);
        both.filter(|(a, b)| a.1 != b.1)
            .map(|((key, expected), (_, actual))| Changed { key, expected, actual })
            .collect()
    }

    /// What the headers tell, in an order that is always the same.
    fn told(&self) -> [(&'static str, Option<String>); 11] {
        let number = |v: Option<f64>| v.map(|v| v.to_string());
        let (capture, time, aperture, iso, unit, colour, comments) = match &self.pixels {
            Pixels::Radiance(_, m) => {
                let comments = (!m.comments.is_empty()).then(|| m.comments.join("\n"));
                (
                    &m.capture,
                    m.time_s,
                    m.f_number,
                    m.iso,
                    m.cd_m2_per_unit,
                    Some(chromaticities(&m.primaries)),
                    comments,
                )
            }
            Pixels::Display(p) => {
                let colour = p.profile.as_ref().map(|p| p.description.clone());
                (&p.capture, p.time_s, p.f_number, p.iso, None, colour, None)
            }
        };
        [
            ("make", capture.make.clone()),
            ("model", capture.model.clone()),
            ("lens", capture.lens.clone()),
            ("date", capture.date.clone()),
            ("focal_length_mm", number(capture.focal_length_mm)),
            ("time_s", number(time)),
            ("f_number", number(aperture)),
            ("iso", number(iso)),
            ("cd_m2_per_unit", number(unit)),
            ("colour", colour),
            ("comments", comments),
        ]
    }
}

/// Whether a PNG says that it has alpha (PNG, section 11.2.1: colour types 4 and 6).
fn has_alpha(path: &Path) -> bool {
    let mut start = [0; 26];
    let is_read = File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok();
    is_read && start.starts_with(b"\x89PNG") && matches!(start[25], 4 | 6)
}

/// Rounded as floats are: a format that keeps them coarser is no other colour space.
fn chromaticities(primaries: &Primaries) -> String {
    let Primaries { red, green, blue, white } = primaries;
    [red, green, blue, white].map(|xy| format!("{:.4} {:.4}", xy[0], xy[1])).join(", ")
}
