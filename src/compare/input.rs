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
use crate::merge::radiance::calibration::Factor;
use crate::read;
use crate::write::Metadata;
use std::fmt::{self, Display, Formatter};
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
            let contents = read::read_within(&path, limits)?;
            let mut warnings = contents.warnings(&path);
            warnings.extend(not_compared(&path, &contents.unread));
            let pixels = Pixels::Radiance(contents.map, Box::new(contents.metadata));
            return Ok(Input { path, pixels, warnings, stamp });
        }
        match Photograph::read(&path, limits) {
            Ok((photograph, mut warnings)) => {
                warnings.extend(not_compared(&path, photograph.has_alpha.then(|| "alpha".to_owned()).as_slice()));
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

    /// What its pixels take in memory.
    pub fn bytes(&self) -> u64 {
        match &self.pixels {
            Pixels::Radiance(map, _) => size_of_val(map.pixels.as_slice()) as u64,
            Pixels::Display(photograph) => photograph.samples.bytes(),
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
        let both = ours.into_iter().zip(theirs).filter(|((_, a), (_, b))| !is_same(a.as_ref(), b.as_ref()));
        let text = |told: Option<Told>| told.map(|told| told.to_string());
        both.map(|((key, a), (_, b))| Changed { key, expected: text(a), actual: text(b) }).collect()
    }

    /// What the headers tell, in an order that is always the same.
    fn told(&self) -> [(&'static str, Option<Told>); 11] {
        let number = |v: Option<f64>| v.map(Told::Number);
        let text = |v: Option<String>| v.map(Told::Text);
        let (capture, time, aperture, iso, unit, colour, comments) = match &self.pixels {
            Pixels::Radiance(_, m) => {
                let comments = (!m.comments.is_empty()).then(|| m.comments.join("\n"));
                (
                    &m.capture,
                    m.time_s,
                    m.f_number,
                    m.iso,
                    m.cd_m2_per_unit.map(Factor::get),
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
            ("make", text(capture.make.clone())),
            ("model", text(capture.model.clone())),
            ("lens", text(capture.lens.clone())),
            ("date", text(capture.date.clone())),
            ("focal_length_mm", number(capture.focal_length_mm)),
            ("time_s", number(time)),
            ("f_number", number(aperture)),
            ("iso", number(iso)),
            ("cd_m2_per_unit", number(unit)),
            ("colour", text(colour)),
            ("comments", text(comments)),
        ]
    }
}

/// Something that headers tell.
enum Told {
    Text(String),
    Number(f64),
}

impl Display for Told {
    /// Numbers in as many digits as a float has.
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        match self {
            Told::Text(text) => f.write_str(text),
            Told::Number(number) => write!(f, "{}", *number as f32),
        }
    }
}

/// Whether both tell the same; of numbers within the precision of a float, which is the coarsest that a format keeps them in.
fn is_same(a: Option<&Told>, b: Option<&Told>) -> bool {
    match (a, b) {
        (None, None) => true,
        (Some(Told::Text(a)), Some(Told::Text(b))) => a == b,
        (Some(Told::Number(a)), Some(Told::Number(b))) => {
            a == b || (a - b).abs() <= f64::from(f32::EPSILON) * a.abs() || a.is_nan() && b.is_nan()
        }
        _ => false,
    }
}

/// Names that a warning has room for.
const NAMED: usize = 8;

/// That `unread` parts of the file `path` have no say.
fn not_compared(path: &Path, unread: &[String]) -> Option<Warning> {
    let (last, others) = unread.split_last()?;
    let list = match (others, others.len().checked_sub(NAMED)) {
        ([], _) => format!("{last} is"),
        (_, None | Some(0)) => format!("{} and {last} are", others.join(", ")),
        (_, Some(more)) => format!("{} and {} others are", others[..NAMED].join(", "), more + 1),
    };
    Some(Warning::Metadata { path: path.to_owned(), detail: format!("its {list} not compared") })
}

/// Rounded as floats are: a format that keeps them coarser is no other colour space.
fn chromaticities(primaries: &Primaries) -> String {
    let Primaries { red, green, blue, white } = primaries;
    [red, green, blue, white].map(|xy| format!("{:.4} {:.4}", xy[0], xy[1])).join(", ")
}
