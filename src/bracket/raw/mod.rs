//! Camera raw: what the sensor measured, before any processing.
//!
//! In: a DNG file. Out: RGB in the colours of the camera, white balanced, 16 bits per sample, encoded with the sRGB
//! curve, and the [`Profile`] of these colours. Cost: mostly that of `demosaic`. Source: Adobe, "Digital Negative
//! Specification", version 1.6.0.0 (2021), in this module called DNG.
//!
//! Samples are encoded with the sRGB curve, as those of other photographs are, because alignment compares grey values
//! of 8 bits: in linear ones, dark parts have no detail.
//!
//! 1. `dng`: the [`Sensor`]: sample values as stored (`chunks`), and what the file says about them (`tags`).
//! 2. `levels`: linear values, 0 for black and 1 for white; `opcodes` brightens what the lens has darkened.
//! 3. `colour`: white balance, and the meaning of the colours; values are put on the scale of `stretch`.
//! 4. `demosaic`: three colours for each pixel. `merged_mosaic`: the same once more, for the mean of unmoved frames.

mod chunks;
mod colour;
mod demosaic;
mod dng;
mod levels;
mod lossless_jpeg;
mod merged_mosaic;
mod opcodes;
mod pattern;
mod stretch;
mod tags;

use crate::bracket::colour::{Curve, Profile, linear_to_srgb};
use crate::limits::Limits;
use crate::plane::Plane;
use crate::simd::{at_least, at_most};
use colour::{Balance, CameraColour};
pub(super) use dng::head;
use levels::Levels;
pub(crate) use merged_mosaic::MergedMosaic;
use opcodes::Gain;
pub use pattern::Pattern;
use stretch::Scale;

/// Why a file was rejected.
type Reason = String;

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Area {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

/// Sample values as stored in the file.
#[derive(Debug, Clone, PartialEq)]
enum Values {
    Integers(Plane<u16>),
    Floats(Plane<f32>),
}

/// What a frame keeps of the camera raw file from which it was developed.
#[derive(Debug, Clone, PartialEq)]
pub struct Raw {
    /// The colour filters in front of the pixels; none if each pixel was measured in three colours.
    pub pattern: Option<Pattern>,
    /// RGB of white in the colours of the camera; the largest is 1. Pixel values are divided by it.
    pub white: [f32; 3],
}

/// The samples of a raw file, and what the file says about them.
#[derive(Debug, Clone, PartialEq)]
struct Sensor {
    values: Values,
    /// The colour filters; none if there are three samples for each pixel.
    pattern: Option<Pattern>,
    /// The part of the picture with an image; the rest is masked.
    active: Area,
    /// The part of the active area that developers show.
    crop: Area,
    levels: Levels,
    /// Corrections of the brightness.
    gains: Vec<Gain>,
    colour: CameraColour,
}

/// A developed raw file.
pub(super) struct Developed {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Interleaved RGB, encoded with the sRGB curve: 0 is black, 65535 is white, and where the first channel clips.
    pub samples: Vec<u16>,
    /// Memory in bytes needed to develop the file, including the bytes of the file.
    pub needed: u64,
    /// The colours of the camera, with the white of the photograph.
    pub profile: Option<Profile>,
    /// The colour filters and the white.
    pub raw: Raw,
}

/// Reads the DNG file `bytes`.
///
/// # Errors
/// The reason, if the file is damaged or of a kind that is not supported.
pub(super) fn develop(bytes: &[u8], limits: &Limits) -> Result<Developed, Reason> {
    let (sensor, needed) = dng::read(bytes, limits)?;
    let mut linear = levels::linear(&sensor)?;
    let balance = Balance::new(sensor.colour.neutral, levels::clip(&linear, &sensor));
    opcodes::apply(&sensor.gains, &mut linear, sensor.levels.samples());
    let Area { left, top, width, height } = sensor.crop;
    let encoding = Encoded::new();
    let encoded = |[r, g, b]: [f32; 3]| [encoding.of(r), encoding.of(g), encoding.of(b)];
    let pixels = match &sensor.pattern {
        Some(pattern) => demosaic::demosaic(&linear, pattern, balance, sensor.crop, encoded),
        None => {
            let rows = (top..top + height).flat_map(|y| &linear.row(y).as_chunks::<3>().0[left..left + width]);
            rows.map(|&pixel| encoded(balance.pixel(pixel))).collect()
        }
    };
    let samples = pixels.into_flattened();
    let profile = Profile::of(&sensor.colour.primaries, Curve::Srgb, "camera");
    let pattern = sensor.pattern.map(|pattern| pattern.seen(|x, y| (left + x, top + y)));
    let raw = Raw { pattern, white: sensor.colour.neutral };
    Ok(Developed { width, height, samples, needed, profile, raw })
}

/// The sRGB curve in steps that are fine enough for 16 bits.
struct Encoded(Vec<f32>);

impl Encoded {
    /// Number of steps of the [stretched](stretch) value, in which the curve is nearly straight.
    const STEPS: usize = 4096;

    fn new() -> Self {
        let scale = Scale::of_sensor();
        let linear = |i: usize| f64::from(scale.linear(i as f32 / Self::STEPS as f32));
        let of = |i: usize| 65535.0 * linear_to_srgb(linear(i)) as f32;
        Encoded((0..=Self::STEPS).map(of).chain([65535.0]).collect())
    }

    /// The encoded value of a stretched one; 0 if it is below black.
    #[inline(always)]
    fn of(&self, stretched: f32) -> u16 {
        let at = at_most(at_least(stretched, 0.0), 1.0) * Self::STEPS as f32;
        let whole = (at as usize).min(Self::STEPS);
        let (from, to) = (self.0[whole], self.0[whole + 1]);
        (from + (at - whole as f32) * (to - from) + 0.5) as u16
    }
}

#[cfg(test)]
mod tests;
