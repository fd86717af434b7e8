//! Comparing: whether two radiance maps, or two pictures, are the same within a tolerance.
//!
//! In: the expected file, the actual file, and [`Options`]. Out: a [`Comparison`] with its outcome, the differences in
//! stops or in dE, PU21-PSNR and MS-SSIM; and, if requested, a false-colour picture. Cost: reading both files. If any
//! pixel differs, also up to 0.2 us for every pixel; for pictures, another 0.7 us for each pixel that differs (for
//! every pixel if the profiles differ). Sources: CIEDE2000 (Sharma, Wu & Dalal 2005), PU21 (Mantiuk & Azimi 2021),
//! MS-SSIM (Wang, Simoncelli & Bovik 2003), each in the file of its name.
//!
//! Radiance is compared with radiance, and pictures with pictures. The colours that pixels represent are compared: if
//! two radiance maps have different primaries, the second is converted to those of the first; of two pictures with 8
//! and 16 bits, 255 equals 65535. Differences in camera, date, comments and other metadata are reported, but do not
//! affect the outcome.

mod bless;
mod ciede2000;
mod display;
mod input;
mod light;
mod ms_ssim;
mod outcome;
mod picture;
mod pu21;
mod radiance;

pub use bless::{Blessed, bless};

use crate::error::{Error, Result};
use crate::limits;
use crate::plane::{BAND_ROWS, Plane};
use input::{Input, Pixels};
use pu21::Light;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Version of the report format: keys may be added, but are never removed.
pub const SCHEMA: &str = "hdralign-compare/1";

/// Default tolerance for radiance, in stops. It is a third of the rounding error of RGBE in the darkest channels, 14
/// times the rounding error of half floats, and half of the smallest gain worth reporting.
pub const DEFAULT_STOPS: f64 = 0.01;

/// Largest difference that is allowed between a pixel and the expected pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Tolerance {
    /// [`DEFAULT_STOPS`] for radiance; for pictures none, so that pixels must be equal.
    #[default]
    ByKind,
    /// Stops in each channel; for radiance only.
    Stops(f64),
    /// dE by CIEDE2000; for pictures only.
    DeltaE(f64),
}

/// The condition under which two files count as the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Criterion {
    /// The files are the same if at most a share of the pixels exceeds a tolerance.
    Pixels {
        /// Largest difference that is allowed between a pixel and the expected pixel.
        tolerance: Tolerance,
        /// Largest share of pixels beyond the tolerance, in percent.
        most_differing_percent: f64,
    },
    /// The files are the same if the peak signal-to-noise ratio is high enough: PU21-PSNR for radiance, PSNR of code
    /// values for pictures.
    Psnr {
        /// Smallest accepted value, in dB.
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
    /// The condition under which the files count as the same.
    pub criterion: Criterion,
    /// Path of a PNG to write, with the expected picture, the difference in false colours and the actual picture side
    /// by side.
    pub diff: Option<PathBuf>,
    /// Whether the PNG may replace an existing file. Off by default.
    pub overwrite: bool,
    /// Limits on the size of the files and on memory.
    pub allowed: limits::Limits,
}

/// The outcome of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// The files are the same within the tolerance.
    Same,
    /// The files differ.
    Differs,
}

/// One of the two files that are compared.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Side {
    /// The path as given.
    pub path: String,
    /// Width after the orientation is applied.
    pub width_px: usize,
    /// Height after the orientation is applied.
    pub height_px: usize,
    /// Bits of a code value; null for radiance.
    pub depth_bits: Option<u32>,
}

/// The limits that were applied; null for limits that were not.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Limits {
    /// Largest allowed difference in stops ([`Tolerance::Stops`]).
    pub tolerance_stops: Option<f64>,
    /// Largest allowed difference in dE ([`Tolerance::DeltaE`]); 0 if pixels must be equal.
    pub tolerance_de: Option<f64>,
    /// Largest share of pixels beyond the tolerance, in percent.
    pub max_differing_percent: Option<f64>,
    /// Smallest accepted PSNR in dB ([`Criterion::Psnr`]).
    pub min_psnr_db: Option<f64>,
}

/// Statistics of the pixels that differ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Differing {
    /// Number of pixels beyond the tolerance; if the criterion is the PSNR, number of pixels that are not equal.
    pub differing_pixels: usize,
    /// `differing_pixels` in percent of all pixels.
    pub differing_percent: f64,
    /// Number of pixels that are not equal.
    pub unequal_pixels: usize,
    /// The pixel with the largest difference, the first if there are several; null when all are equal.
    pub largest: Option<Largest>,
}

/// The pixel with the largest difference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Largest {
    /// Column of the pixel.
    pub x_px: usize,
    /// Row of the pixel.
    pub y_px: usize,
    /// For radiance, the difference in the channel where it is largest. Null if the expected and the actual value of a
    /// channel differ and are not both finite.
    pub stops: Option<f64>,
    /// For pictures, the difference by CIEDE2000.
    pub de: Option<f64>,
    /// Expected red, green and blue: radiance, or code values.
    pub expected: [Option<f64>; 3],
    /// Actual red, green and blue: radiance, or code values.
    pub actual: [Option<f64>; 3],
}

/// Differences of one channel of radiance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChannelStops {
    /// `red`, `green` or `blue`.
    pub channel: &'static str,
    /// The largest difference.
    pub max_stops: f64,
    /// Root mean square difference.
    pub rms_stops: f64,
    /// Signed mean difference, positive if the actual file is brighter: for files that differ by a gain, the gain.
    pub mean_stops: f64,
}

/// Differences of two radiance maps.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RadianceDifference {
    /// The floor, a radiance: differences of darker values are divided by the floor, instead of by the value itself.
    pub floor: f64,
    /// Differences of red, green and blue.
    pub channels: [ChannelStops; 3],
    /// Root mean square difference over all channels.
    pub rms_stops: f64,
    /// Signed mean difference over all channels.
    pub mean_stops: f64,
    /// Number of pixels with a channel whose expected and actual values differ and are not both finite. These pixels
    /// are excluded from the means.
    pub not_comparable_pixels: usize,
    /// Luminance of radiance 1 in cd/m2, used for PU21. If the expected file is calibrated, it follows from that file.
    /// Otherwise it is chosen so that the 99.9th percentile of the expected luminance is 1000.
    pub cd_m2_per_unit: f64,
}

/// Differences of one channel of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChannelCodes {
    /// `red`, `green` or `blue`.
    pub channel: &'static str,
    /// The largest difference, in code values of the file with more bits.
    pub max_codes: u16,
    /// Signed mean difference, positive if the actual file is brighter.
    pub mean_codes: f64,
}

/// Differences of two pictures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DisplayDifference {
    /// Differences of red, green and blue.
    pub channels: [ChannelCodes; 3],
    /// The largest difference by CIEDE2000.
    pub de_max: f64,
    /// The mean difference by CIEDE2000 over all pixels.
    pub de_mean: f64,
    /// PSNR of the code values of all channels; null when they are equal.
    pub psnr_db: Option<f64>,
}

/// A metadata value that differs between the files.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Changed {
    /// Name of the value.
    pub key: &'static str,
    /// Value in the expected file; null if that file has none.
    pub expected: Option<String>,
    /// Value in the actual file; null if that file has none.
    pub actual: Option<String>,
}

/// The result of comparing two files.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// The program and its version.
    pub software: &'static str,
    /// Whether the files count as the same.
    pub verdict: Outcome,
    /// The reason for the outcome, as text.
    pub reason: String,
    /// The expected file.
    pub expected: Side,
    /// The actual file.
    pub actual: Side,
    /// The limits that were applied.
    pub limits: Limits,
    /// Whether the files have the same bytes.
    pub bytes_equal: bool,
    /// Whether every pixel is equal; null when the sizes differ.
    pub pixels_equal: Option<bool>,
    /// Statistics of the pixels that differ; null if the sizes differ.
    pub differing: Option<Differing>,
    /// Differences of radiance; null when the sizes differ, and for pictures.
    pub radiance: Option<RadianceDifference>,
    /// Differences of pictures; null when the sizes differ, and for radiance.
    pub display: Option<DisplayDifference>,
    /// PU21-PSNR of red, green and blue; null when all pixels are equal or the sizes differ.
    pub pu21_psnr_db: Option<f64>,
    /// MS-SSIM of PU21 luminance; null when the sizes differ or a side has less than 11 pixels.
    pub ms_ssim: Option<f64>,
    /// Other metadata that differ.
    pub metadata: Vec<Changed>,
    /// Path of the difference picture, if one was requested.
    pub diff: Option<String>,
    /// Warnings about the files.
    pub warnings: Vec<String>,
}

impl Comparison {
    /// Returns whether the files count as the same.
    pub fn is_same(&self) -> bool {
        self.verdict == Outcome::Same
    }

    /// Returns the comparison as JSON, with a final line feed. Numbers that are not finite are null.
    pub fn to_json(&self) -> String {
        // Serialisation fails only for maps with keys that are not strings; the comparison contains no maps.
        let json = serde_json::to_string_pretty(self).unwrap_or_default();
        json + "\n"
    }
}

/// The difference of every pixel in `unit`. It is [`f32::INFINITY`] if the expected and the actual value of a channel
/// differ and are not both finite.
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

/// The differences of two files of one kind.
struct Measured {
    magnitudes: Magnitudes,
    radiance: Option<RadianceDifference>,
    display: Option<DisplayDifference>,
    pu21_psnr_db: Option<f64>,
    ms_ssim: Option<f64>,
}

impl Measured {
    /// Adds PU21-PSNR and MS-SSIM of `a` and `b`, without computing them when all pixels are equal.
    fn new(
        magnitudes: Magnitudes,
        (a, b): (&Light, &Light),
        radiance: Option<RadianceDifference>,
        display: Option<DisplayDifference>,
    ) -> Measured {
        let (pu21_psnr_db, ms_ssim) = match magnitudes.plane.as_slice().iter().all(|v| *v == 0.0) {
            true => (None, ms_ssim::of_equals(a.size())),
            false => (pu21::psnr(a, b), ms_ssim::ms_ssim(a, b)),
        };
        Measured { magnitudes, radiance, display, pu21_psnr_db, ms_ssim }
    }
}

/// Computes the magnitude of every pixel by `magnitude(sums, index)`, in parallel, with separate sums for each band of
/// rows.
fn by_bands<T: Default + Send>(
    (width, height): (usize, usize),
    magnitude: impl Fn(&mut T, usize) -> f32 + Sync,
) -> (Plane<f32>, Vec<T>) {
    let mut plane = Plane::filled(width, height, 0.0);
    let band = (BAND_ROWS * width).max(1);
    let bands = plane.as_mut_slice().par_chunks_mut(band).enumerate();
    let sums = bands.map(|(i, out)| {
        let mut sums = T::default();
        out.iter_mut().enumerate().for_each(|(k, out)| *out = magnitude(&mut sums, i * band + k));
        sums
    });
    let sums = sums.collect();
    (plane, sums)
}

/// Measured working memory in bytes per pixel. The first number is for radiance maps, the second for pictures, which
/// are converted to linear light first.
const MEASURED: (u64, u64) = (16, 36);

/// Checks that comparing the files does not exceed the memory limit.
fn check_memory(a: &Input, b: &Input, allowed: &limits::Limits) -> Result<()> {
    let (width, height) = a.size();
    let each = if matches!(a.pixels, Pixels::Radiance(..)) { MEASURED.0 } else { MEASURED.1 };
    let bytes = a.bytes() + b.bytes() + each * width as u64 * height as u64;
    let refused = |reason| Error::Option { option: "--max-memory", reason: format!("{}: {reason}", a.side().path) };
    allowed.check_memory_while("comparing", a.size(), bytes).map_err(refused)
}

/// Compares the file `actual` with the file `expected`.
///
/// # Errors
/// [`Error::Read`], [`Error::Changed`], [`Error::Decode`]; [`Error::NotComparable`] for a file of an unknown format;
/// [`Error::KindsDiffer`] if one file is radiance and the other a picture; [`Error::Option`] for an invalid tolerance,
/// a tolerance for the other kind of file, or too little memory; errors of writing the difference picture.
pub fn files(expected: &Path, actual: &Path, options: &Options) -> Result<Comparison> {
    outcome::validate(&options.criterion)?;
    if let Some(diff) = &options.diff {
        picture::check(diff, &[expected.to_owned(), actual.to_owned()], options.overwrite)?;
    }
    let a = Input::open(expected, &options.allowed)?;
    let b = Input::open(actual, &options.allowed.beside(a.bytes()))?;
    check_memory(&a, &b, &options.allowed)?;
    let limits = outcome::limits(&options.criterion, &a)?;

    let measured = match (&a.pixels, &b.pixels) {
        (Pixels::Radiance(..), Pixels::Display(_)) | (Pixels::Display(_), Pixels::Radiance(..)) => {
            return Err(Error::KindsDiffer {
                path: expected.to_owned(),
                kind: a.kind(),
                other: actual.to_owned(),
                other_kind: b.kind(),
            });
        }
        _ if a.size() != b.size() => None,
        (Pixels::Radiance(a, about), Pixels::Radiance(b, _)) => Some(radiance::measure(a, b, about)),
        (Pixels::Display(a), Pixels::Display(b)) => Some(display::measure(a, b)),
    };
    let differing = measured.as_ref().map(|m| outcome::differing(&m.magnitudes, &limits, &a, &b));
    let (verdict, reason) = outcome::decide(&limits, &a, &b, differing.as_ref(), measured.as_ref());
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
