//! The files to compare: radiance maps or display pictures, recognised by content.
//!
//! In: a file. Out: its pixels and metadata. Cost: the decoders.

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

/// A file that was read.
pub(super) struct Input {
    path: PathBuf,
    pub pixels: Pixels,
    pub warnings: Vec<Warning>,
    /// The state of the file when it was read, by which later changes of the file are detected.
    pub stamp: Stamp,
}

/// The contents of a file.
pub(super) enum Pixels {
    Radiance(RadianceMap, Box<Metadata>),
    Display(Box<Photograph>),
}

impl Input {
    /// Reads the file `path` within `limits`.
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

    /// Returns the width and height in pixels.
    pub fn size(&self) -> (usize, usize) {
        match &self.pixels {
            Pixels::Radiance(map, _) => (map.pixels.width(), map.pixels.height()),
            Pixels::Display(photograph) => (photograph.width, photograph.height),
        }
    }

    /// Returns the memory of the pixels in bytes.
    pub fn bytes(&self) -> u64 {
        match &self.pixels {
            Pixels::Radiance(map, _) => size_of_val(map.pixels.as_slice()) as u64,
            Pixels::Display(photograph) => photograph.samples.bytes(),
        }
    }

    /// Returns what the file contains, for messages.
    pub fn kind(&self) -> &'static str {
        match self.pixels {
            Pixels::Radiance(..) => "radiance",
            Pixels::Display(_) => "a display picture",
        }
    }

    /// Returns the file name without folders, for messages.
    pub fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Returns the description of the file for the report.
    pub fn side(&self) -> Side {
        let (width_px, height_px) = self.size();
        let depth_bits = match &self.pixels {
            Pixels::Radiance(..) => None,
            Pixels::Display(photograph) => Some(if photograph.samples.max() == u16::MAX { 16 } else { 8 }),
        };
        Side { path: self.path.to_string_lossy().into_owned(), width_px, height_px, depth_bits }
    }

    /// Returns red, green and blue at a pixel: radiance, or code values.
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

    /// Returns whether the files have the same bytes.
    pub fn bytes_equal(&self, other: &Input) -> Result<bool> {
        let equal = self.compare_bytes(other)?;
        self.stamp.check()?;
        other.stamp.check()?;
        Ok(equal)
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

    /// Returns the metadata values that differ between the files.
    pub fn changed(&self, other: &Input) -> Vec<Changed> {
        let both = self.metadata().into_iter().zip(other.metadata());
        let text = |value: Option<Value>| value.map(|value| value.to_string());
        both.filter(|((_, a), (_, b))| !is_same(a.as_ref(), b.as_ref()))
            .map(|((key, a), (_, b))| Changed { key, expected: text(a), actual: text(b) })
            .collect()
    }

    /// Returns the metadata in a fixed order.
    fn metadata(&self) -> [(&'static str, Option<Value>); 11] {
        let number = |v: Option<f64>| v.map(Value::Number);
        let text = |v: Option<String>| v.map(Value::Text);
        let (capture, time, aperture, iso, unit, colour, comments) = match &self.pixels {
            Pixels::Radiance(_, m) => {
                let comments = (!m.comments.is_empty()).then(|| m.comments.join("\n"));
                let unit = m.cd_m2_per_unit.map(Factor::get);
                (&m.capture, m.time_s, m.f_number, m.iso, unit, Some(chromaticities(&m.primaries)), comments)
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

/// A value of the metadata.
enum Value {
    Text(String),
    Number(f64),
}

impl Display for Value {
    /// Writes numbers with as many digits as an `f32` has.
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        match self {
            Value::Text(text) => f.write_str(text),
            Value::Number(number) => write!(f, "{}", *number as f32),
        }
    }
}

/// Returns whether both values are the same. Numbers may differ by the precision of an `f32`, the lowest precision in
/// which a format stores them.
fn is_same(a: Option<&Value>, b: Option<&Value>) -> bool {
    match (a, b) {
        (None, None) => true,
        (Some(Value::Text(a)), Some(Value::Text(b))) => a == b,
        (Some(Value::Number(a)), Some(Value::Number(b))) => {
            a == b || (a - b).abs() <= f64::from(f32::EPSILON) * a.abs() || a.is_nan() && b.is_nan()
        }
        _ => false,
    }
}

/// Number of names in a warning about many parts.
const NAMED: usize = 8;

/// Returns a warning that the parts `unread` of the file `path` are not compared; `None` if there are no such parts.
fn not_compared(path: &Path, unread: &[String]) -> Option<Warning> {
    let (last, others) = unread.split_last()?;
    let list = match (others, others.len().checked_sub(NAMED)) {
        ([], _) => format!("{last} is"),
        (_, None | Some(0)) => format!("{} and {last} are", others.join(", ")),
        (_, Some(more)) => format!("{} and {} others are", others[..NAMED].join(", "), more + 1),
    };
    Some(Warning::Metadata { path: path.to_owned(), detail: format!("its {list} not compared") })
}

/// Returns the primaries as text, rounded so that the text is the same for formats that store them less precisely.
fn chromaticities(primaries: &Primaries) -> String {
    let Primaries { red, green, blue, white } = primaries;
    [red, green, blue, white].map(|xy| format!("{:.4} {:.4}", xy[0], xy[1])).join(", ")
}
