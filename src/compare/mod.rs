//! Comparing: are two radiance maps, or two pictures, the same within a tolerance?
//!
//! In: two files, the one expected and the one that is there, and [`Options`]. Out: a [`Comparison`] with its verdict, how far they are
//! apart in stops or in dE, PU21-PSNR and MS-SSIM; a false-colour picture where it is asked for. Cost: reading both, then about 0.2 us a
//! pixel where they differ; nothing where they do not. Sources: CIEDE2000 (Sharma, Wu & Dalal 2005), PU21 (Mantiuk & Azimi 2021), MS-SSIM
//! (Wang, Simoncelli & Bovik 2003), each in the file of its name.
//!
//! Radiance is held against radiance and pictures against pictures. What counts is what pixels mean: of two radiance maps in different
//! primaries the second is taken to those of the first; of two pictures of 8 and of 16 bit, 255 is 65535. Camera, date, comments and
//! the like are told where they differ, and never fail.

mod bless;
mod ciede2000;
mod display;
mod input;
mod light;
mod ms_ssim;
mod picture;
mod pu21;
mod radiance;
mod verdict;

pub use bless::{Blessed, bless};

use crate::error::{Error, Result};
use crate::limits;
use crate::plane::Plane;
use input::{Input, Pixels};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The version of the format: keys are only ever added to it.
pub const SCHEMA: &str = "hdralign-compare/1";

/// Radiance may differ by so much by default, in stops: a third of what rounding to RGBE does to the darkest channels, ten times what
/// rounding to halves does, half of the least gain that is worth a name.
pub const DEFAULT_STOPS: f64 = 0.01;

/// How far a pixel may be from what is expected.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Tolerance {
    /// [`DEFAULT_STOPS`] for radiance; not at all for pictures.
    #[default]
    ByKind,
    /// So many stops in each channel; for radiance alone.
    Stops(f64),
    /// So much by CIEDE2000; for pictures alone.
    DeltaE(f64),
}

/// When two files are the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Criterion {
    /// When no more than a share of the pixels is beyond a tolerance.
    Pixels {
        /// How far a pixel may be off.
        tolerance: Tolerance,
        /// How many may be off by more, in percent of all.
        most_differing_percent: f64,
    },
    /// When the signal is so far above the difference: PU21-PSNR of radiance, PSNR of the codes of pictures.
    Psnr {
        /// The least that will do, in dB.
        least_db: f64,
    },
}

impl Default for Criterion {
    fn default() -> Self {
        Criterion::Pixels { tolerance: Tolerance::ByKind, most_differing_percent: 0.0 }
    }
}

/// How files are compared.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// When they are the same.
    pub criterion: Criterion,
    /// A PNG with the expected picture, the difference in false colours and the actual picture side by side is written here.
    pub diff: Option<PathBuf>,
    /// Whether that replaces a file that exists. No by default.
    pub overwrite: bool,
    /// What the files may ask for.
    pub allowed: limits::Limits,
}

/// What came of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Within the tolerance.
    Same,
    /// Not.
    Differs,
}

/// One of the files.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Side {
    /// As it was named.
    pub path: String,
    /// Width, orientation applied.
    pub width_px: usize,
    /// Height, orientation applied.
    pub height_px: usize,
    /// Bits of a code value; null for radiance.
    pub depth_bits: Option<u32>,
}

/// What the verdict rests on; null what was not asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Limits {
    /// See [`Tolerance::Stops`].
    pub tolerance_stops: Option<f64>,
    /// See [`Tolerance::DeltaE`]; 0 where pixels must be equal.
    pub tolerance_de: Option<f64>,
    /// Of all pixels.
    pub max_differing_percent: Option<f64>,
    /// See [`Criterion::Psnr`].
    pub min_psnr_db: Option<f64>,
}

/// Pixels that are not as expected.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Differing {
    /// Pixels beyond the tolerance; those that are not equal, where the PSNR is what counts.
    pub differing_pixels: usize,
    /// The same, of all pixels.
    pub differing_percent: f64,
    /// Pixels that are not equal.
    pub unequal_pixels: usize,
    /// The pixel that is farthest off, the first of equals; null where all are equal.
    pub largest: Option<Largest>,
}

/// A pixel, and what it is and should be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Largest {
    /// Its column.
    pub x_px: usize,
    /// Its row.
    pub y_px: usize,
    /// Radiance: by how much the channel that is farthest off is off; null where a value is no number or infinite in one file alone.
    pub stops: Option<f64>,
    /// Pictures: by how much it is off, by CIEDE2000.
    pub de: Option<f64>,
    /// Red, green and blue expected: radiance, or codes.
    pub expected: [Option<f64>; 3],
    /// Red, green and blue there are.
    pub actual: [Option<f64>; 3],
}

/// A channel of radiance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChannelStops {
    /// `red`, `green` or `blue`.
    pub channel: &'static str,
    /// The largest difference.
    pub max_stops: f64,
    /// Root mean square.
    pub rms_stops: f64,
    /// Mean, with its sign: above 0 where the actual is brighter. A gain shows here.
    pub mean_stops: f64,
}

/// How far radiance is apart.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RadianceDifference {
    /// Where stops become differences: below it a difference is held against this much.
    pub floor: f64,
    /// Red, green, blue.
    pub channels: [ChannelStops; 3],
    /// Root mean square of all channels.
    pub rms_stops: f64,
    /// Mean of all channels, with its sign.
    pub mean_stops: f64,
    /// Pixels that are no number, or infinite, in one of the files alone: they are in no mean.
    pub not_comparable_pixels: usize,
    /// What radiance 1 was taken for in cd/m2, for PU21: as the expected file says, or such that its 99.9th percentile is 1000.
    pub cd_m2_per_unit: f64,
}

/// A channel of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChannelCodes {
    /// `red`, `green` or `blue`.
    pub channel: &'static str,
    /// The largest difference, in codes of the deeper file.
    pub max_codes: u16,
    /// Mean, with its sign: above 0 where the actual is brighter.
    pub mean_codes: f64,
}

/// How far pictures are apart.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DisplayDifference {
    /// Red, green, blue.
    pub channels: [ChannelCodes; 3],
    /// The largest difference by CIEDE2000.
    pub de_max: f64,
    /// The mean over all pixels.
    pub de_mean: f64,
    /// Of the codes of all channels; null where they are equal.
    pub psnr_db: Option<f64>,
}

/// Something told in the headers that is not the same.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Changed {
    /// What it is.
    pub key: &'static str,
    /// In the file expected; null where it says nothing.
    pub expected: Option<String>,
    /// In the file there is.
    pub actual: Option<String>,
}

/// Two files, compared.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// The program and its version.
    pub software: &'static str,
    /// The verdict.
    pub verdict: Verdict,
    /// Why, in words.
    pub reason: String,
    /// The file expected.
    pub expected: Side,
    /// The file there is.
    pub actual: Side,
    /// What the verdict rests on.
    pub limits: Limits,
    /// Whether the files are the same to the byte.
    pub bytes_equal: bool,
    /// Whether every pixel is the same; null where the sizes differ.
    pub pixels_equal: Option<bool>,
    /// Null where the sizes differ.
    pub differing: Option<Differing>,
    /// Null where the sizes differ, and for pictures.
    pub radiance: Option<RadianceDifference>,
    /// Null where the sizes differ, and for radiance.
    pub display: Option<DisplayDifference>,
    /// PSNR of red, green and blue by PU21; null where pixels are equal, and where the sizes differ.
    pub pu21_psnr_db: Option<f64>,
    /// MS-SSIM of the luminance by PU21; null where the sizes differ, and for pictures of less than 11 pixels a side.
    pub ms_ssim: Option<f64>,
    /// What else the headers tell differently.
    pub metadata: Vec<Changed>,
    /// The difference picture, where it was asked for.
    pub diff: Option<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl Comparison {
    /// Whether they are the same within what was asked for.
    pub fn is_same(&self) -> bool {
        self.verdict == Verdict::Same
    }

    /// As JSON, ended by a newline. Numbers that are not finite are null.
    pub fn to_json(&self) -> String {
        // Only maps with keys that are no texts could fail, and there are none.
        let json = serde_json::to_string_pretty(self).unwrap_or_default();
        json + "\n"
    }
}

/// What pixels differ by, and what that is: [f32::INFINITY] where there is no number for it.
#[derive(Debug, Clone)]
struct Magnitudes {
    plane: Plane<f32>,
    unit: Unit,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unit {
    Stops,
    DeltaE,
}

/// What one of the two kinds of files says of itself.
struct Measured {
    magnitudes: Magnitudes,
    radiance: Option<RadianceDifference>,
    display: Option<DisplayDifference>,
    pu21_psnr_db: Option<f64>,
    ms_ssim: Option<f64>,
}

/// Bytes of a pixel while radiance is compared: for eyes, by luminance on several scales, and what differs; and those of pictures, which are taken to
/// light first. Measured.
const MEASURED: (u64, u64) = (16, 36);

/// Refuses what takes more memory to compare than is allowed.
fn check_memory(a: &Input, b: &Input, allowed: &limits::Limits) -> Result<()> {
    let (width, height) = a.size();
    let each = if matches!(a.pixels, Pixels::Radiance(..)) { MEASURED.0 } else { MEASURED.1 };
    let bytes = a.bytes() + b.bytes() + each * width as u64 * height as u64;
    let refused = |reason| Error::Option { option: "--max-memory", reason: format!("{}: {reason}", a.side().path) };
    allowed.check_memory_while("compared", a.size(), bytes).map_err(refused)
}

/// Compares the file `actual` with the file `expected`.
///
/// # Errors
/// [`Error::Read`], [`Error::Changed`], [`Error::Decode`]; [`Error::NotComparable`] where a file is of no format that is read;
/// [`Error::KindsDiffer`] where one is radiance and the other a picture; [`Error::Option`] for a tolerance that is none, or for the other
/// kind, or where the memory allowed does not suffice; those of writing for the difference picture.
pub fn files(expected: &Path, actual: &Path, options: &Options) -> Result<Comparison> {
    verdict::validate(&options.criterion)?;
    if let Some(diff) = &options.diff {
        picture::check(diff, &[expected.to_owned(), actual.to_owned()], options.overwrite)?;
    }
    let a = Input::open(expected, &options.allowed)?;
    let b = Input::open(actual, &options.allowed.beside(a.bytes()))?;
    check_memory(&a, &b, &options.allowed)?;
    let limits = verdict::limits(&options.criterion, &a)?;
    let is_of_a_size = a.size() == b.size();
    let measured = match (&a.pixels, &b.pixels) {
        (Pixels::Radiance(..), Pixels::Display(_)) | (Pixels::Display(_), Pixels::Radiance(..)) => {
            return Err(Error::KindsDiffer {
                path: expected.to_owned(),
                kind: a.kind(),
                other: actual.to_owned(),
                other_kind: b.kind(),
            });
        }
        _ if !is_of_a_size => None,
        (Pixels::Radiance(a, about), Pixels::Radiance(b, _)) => Some(radiance::measure(a, b, about)),
        (Pixels::Display(a), Pixels::Display(b)) => Some(display::measure(a, b)),
    };
    let differing = measured.as_ref().map(|m| verdict::differing(&m.magnitudes, &limits, &a, &b));
    let (verdict, reason) = verdict::judge(&limits, &a, &b, differing.as_ref(), measured.as_ref());
    let bytes_equal = a.bytes_equal(&b)?;
    if let Some(diff) = &options.diff {
        let largest = differing.as_ref().and_then(|d| d.largest).map(|l| (l.x_px, l.y_px));
        let words = picture::Words { title: &reason, limits: &limits, largest };
        picture::write(diff, options.overwrite, (&a, &b), measured.as_ref().map(|m| &m.magnitudes), &words)?;
    }
    let (radiance, display, pu21_psnr_db, ms_ssim) =
        measured.map_or((None, None, None, None), |m| (m.radiance, m.display, m.pu21_psnr_db, m.ms_ssim));
    Ok(Comparison {
        schema: SCHEMA,
        software: concat!("hdralign ", env!("CARGO_PKG_VERSION")),
        verdict,
        reason,
        expected: a.side(),
        actual: b.side(),
        limits,
        bytes_equal,
        pixels_equal: differing.as_ref().map(|d| d.unequal_pixels == 0),
        differing,
        radiance,
        display,
        pu21_psnr_db,
        ms_ssim,
        metadata: a.changed(&b),
        diff: options.diff.as_ref().map(|path| path.to_string_lossy().into_owned()),
        warnings: a.warnings.iter().chain(&b.warnings).map(ToString::to_string).collect(),
    })
}
