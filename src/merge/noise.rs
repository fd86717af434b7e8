//! Noise of a frame: the standard deviation of its code values.
//!
//! In: a frame. Out: the standard deviation for each channel and step of brightness, and from it the variance of the
//! exposure of a code value. Cost: at most 16,384 blocks of 8x8 pixels are read, whatever the size: about 5 ms per
//! frame. Source: Liu, Freeman, Szeliski & Kang 2006, "Noise Estimation from a Single Image", which measures noise as a
//! function of brightness by the lower envelope of the variances of flat parts of one picture. The mixed difference
//! that cancels slopes is Immerkaer's (1996).
//!
//! For each block, two numbers are computed: its mean, and the mean square of z(x, y) - z(x+1, y) - z(x, y+1) + z(x+1,
//! y+1). A quarter of this mean square is the variance of white noise, even on a slope. Texture increases the mean
//! square, so the lower quartile over the blocks of a step of brightness is used. Noise that the camera or JPEG has
//! smoothed is underestimated; [`LEAST`] is the minimum.

use crate::bracket::{Codes, Frame};
use crate::error::Result;
use crate::response::{CODES, ResponseCurve};
use crate::statistics::of_rank;

/// Side of a block in pixels: the size and the grid of the blocks of JPEG.
const BLOCK: usize = 8;
/// Largest number of blocks that are read from a frame.
const READ: usize = 16_384;
/// Number of steps of brightness that the code values are divided into.
pub(super) const STEPS: usize = 16;
/// Smallest number of values from which the quantile of a step of brightness is computed. In steps with fewer values, it
/// is interpolated.
const FEWEST: usize = 12;
/// Quantile of the variances of the blocks of a step that is used as the variance of the noise.
const QUANTILE: f64 = 0.25;
/// Smallest standard deviation of a code value. Rounding to integers alone gives 0.29; most of the rest is from the
/// rounding of JPEG coefficients.
const LEAST: f64 = 1.0;
/// Relative error of response and exposure: the first number is for a frame that is not displaced, the second for a
/// frame that is displaced and interpolated.
const ERROR: (f64, f64) = (0.02, 0.05);

/// Relative error for camera raw, whose response is known.
const RAW_ERROR: (f64, f64) = (0.002, 0.01);

/// A positive value for each step of brightness.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BySteps([f64; STEPS]);

/// The noise of one frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Noise {
    /// Variance of the code value in the middle of each step of brightness, for R, G and B.
    steps: [BySteps; 3],
    /// Relative standard deviation of the radiance, the same at any code value: one of [`ERROR`], or [`RAW_ERROR`].
    error: f64,
}

impl Noise {
    /// Returns the noise of a frame with [`LEAST`] at every code value.
    pub(super) fn least() -> Self {
        Noise { steps: [(); 3].map(|_| BySteps([LEAST * LEAST; STEPS])), error: ERROR.0 }
    }

    /// Measures the noise of `frame`; `moved` is true if the frame is interpolated.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch) if the frame is on disk and cannot be read.
    pub(super) fn of(frame: &Frame, moved: bool) -> Result<Self> {
        let (least, error) = if frame.is_raw() { (LEAST / 257.0, RAW_ERROR) } else { (LEAST, ERROR) };
        Ok(Noise { steps: shown(frame, least)?, error: if moved { error.1 } else { error.0 } })
    }

    /// Measures the noise of a 16-bit `frame`. The minimum is [`LEAST`] in units of 16-bit code values, because the
    /// frame is not from JPEG.
    ///
    /// # Errors
    /// Those of [`of`](Self::of).
    pub(super) fn of_fine(frame: &Frame) -> Result<Self> {
        Ok(Noise { steps: shown(frame, LEAST / 257.0)?, error: ERROR.0 })
    }

    /// Raises the variances to the largest of all `noises`. Frames of one sensor have the same noise at the same code
    /// value, but a dark frame shows it at few code values, and clips part of it at black.
    pub(super) fn raise<'a>(&mut self, noises: impl Iterator<Item = &'a Noise>) {
        for noise in noises {
            for (steps, others) in self.steps.iter_mut().zip(&noise.steps) {
                steps.0.iter_mut().zip(others.0).for_each(|(variance, other)| *variance = variance.max(other));
            }
        }
    }

    /// Returns the standard deviation at `code`, which may lie between two code values.
    pub(super) fn deviation(&self, channel: usize, code: f64) -> f64 {
        self.code_variance(channel, code).sqrt()
    }

    /// Returns the variance of the exposure X at code value Z: (sigma_Z dX/dZ)^2 + (error X)^2.
    pub(super) fn variance(&self, curve: &ResponseCurve, channel: usize, code: usize) -> f64 {
        let x = curve.exposures(channel);
        let (from, to) = (code.saturating_sub(1), (code + 1).min(CODES - 1));
        let slope = f64::from(x[to] - x[from]) / (to - from) as f64;
        let error = self.error * f64::from(x[code]);
        self.code_variance(channel, code as f64) * slope * slope + error * error
    }

    /// Returns the variance of a code value, interpolated between the steps.
    fn code_variance(&self, channel: usize, code: f64) -> f64 {
        self.steps[channel].at(code)
    }
}

impl BySteps {
    /// The step of a code value, 0..=255.
    pub(super) fn step(code: f64) -> usize {
        ((code * STEPS as f64 / CODES as f64) as usize).min(STEPS - 1)
    }

    /// Returns, for each step, the `quantile` of the values `seen` in it, but at least `least`. Steps with too few values
    /// are interpolated between their neighbours.
    pub(super) fn quantile(seen: [Vec<f64>; STEPS], quantile: f64, least: f64) -> Self {
        let seen = seen.into_iter().enumerate().filter(|(_, values)| values.len() >= FEWEST);
        let of = |values: Vec<f64>| {
            let rank = (values.len() as f64 * quantile) as usize;
            of_rank(values, rank)
        };
        let known: Vec<(usize, f64)> = seen.filter_map(|(step, values)| Some((step, of(values)?.max(least)))).collect();
        BySteps(std::array::from_fn(|step| {
            let above = known.iter().find(|(s, _)| *s >= step);
            let below = known.iter().rev().find(|(s, _)| *s <= step);
            match (below, above) {
                (Some((s, v)), Some((t, u))) if t > s => v + (u - v) * (step - s) as f64 / (t - s) as f64,
                (Some((_, v)), _) | (None, Some((_, v))) => *v,
                (None, None) => least,
            }
        }))
    }

    /// Returns the value at a code value, interpolated between the middles of the steps.
    pub(super) fn at(&self, code: f64) -> f64 {
        let at = (code * STEPS as f64 / CODES as f64 - 0.5).clamp(0.0, (STEPS - 1) as f64);
        let below = (at as usize).min(STEPS - 2);
        self.0[below] + (at - below as f64) * (self.0[below + 1] - self.0[below])
    }
}

/// Measures the variance of the code values of `frame`. `least` is the lower limit of the standard deviation.
fn shown(frame: &Frame, least: f64) -> Result<[BySteps; 3]> {
    Ok(match frame.whole()?.codes() {
        Codes::Eight(codes) => measure(codes, frame.width(), 1.0, least),
        Codes::Sixteen(codes) => measure(codes, frame.width(), 257.0, least),
    })
}

/// Returns the variance of `codes` by channel and step of brightness, on the scale 0..=255: the code values are divided
/// by `scale`. The standard deviation is at least `least`.
fn measure<T: Copy + Into<f64>>(codes: &[T], width: usize, scale: f64, least: f64) -> [BySteps; 3] {
    let (columns, rows) = (width / BLOCK, codes.len() / (3 * width) / BLOCK);
    // Every stride-th block in both directions, so that at most READ blocks are read.
    let stride = (1..).find(|s| columns.div_ceil(*s) * rows.div_ceil(*s) <= READ).unwrap_or(1);
    let mut seen: [[Vec<f64>; STEPS]; 3] = Default::default();
    for row in (0..rows).step_by(stride) {
        for column in (0..columns).step_by(stride) {
            for (channel, seen) in seen.iter_mut().enumerate() {
                let at = |x: usize, y: usize| {
                    codes[3 * ((row * BLOCK + y) * width + column * BLOCK + x) + channel].into() / scale
                };
                if let Some((mean, variance)) = block(at) {
                    seen[BySteps::step(mean)].push(variance);
                }
            }
        }
    }
    seen.map(|seen| BySteps::quantile(seen, QUANTILE, least * least))
}

/// Returns the mean of a block and its estimate of the noise variance; `None` if one of its code values is clipped or
/// black.
fn block(at: impl Fn(usize, usize) -> f64) -> Option<(f64, f64)> {
    let (mut sum, mut squares) = (0.0, 0.0);
    for y in 0..BLOCK {
        for x in 0..BLOCK {
            let code = at(x, y);
            if !(0.5..=254.5).contains(&code) {
                return None;
            }
            sum += code;
        }
    }
    for y in 0..BLOCK - 1 {
        for x in 0..BLOCK - 1 {
            let mixed = at(x, y) - at(x + 1, y) - at(x, y + 1) + at(x + 1, y + 1);
            squares += mixed * mixed;
        }
    }
    let differences = ((BLOCK - 1) * (BLOCK - 1)) as f64;
    Some((sum / (BLOCK * BLOCK) as f64, squares / differences / 4.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::exposure::Exposure;

    /// Returns a number in -0.5..0.5 that depends only on the seed.
    fn random(seed: u64) -> f64 {
        let x = (seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let x = (x ^ (x >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((x ^ (x >> 29)) >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    /// Returns a frame whose code values rise from left to right, with noise of standard deviation `sigma(code)`.
    fn frame(sigma: impl Fn(f64) -> f64) -> Frame {
        let (width, height) = (512, 256);
        let codes = (0..width * height * 3).map(|i| {
            let code = 20.0 + 210.0 * (i / 3 % width) as f64 / width as f64;
            // The sum of twelve uniform numbers is nearly normal, with variance 1.
            let normal: f64 = (0..12).map(|k| random(12 * i as u64 + k)).sum();
            (code + sigma(code) * normal + 0.5) as u8
        });
        let samples = crate::bracket::Samples::Eight(codes.collect());
        Frame::new("a".into(), width, height, samples, Exposure::given(0.0).expect("a number"))
    }

    #[test]
    fn noise_is_measured_at_every_brightness() {
        let sigma = |code: f64| 1.5 + code / 50.0;
        let noise = Noise::of(&frame(sigma), false).unwrap();
        for code in [40, 100, 160, 220] {
            // The variance of a block is a mean of 49 dependent squares. Its lower quartile is 21 % below the true
            // variance, so the standard deviation is 11 % too small; rounding adds 1/12 to the variance.
            let (found, truth) = (noise.deviation(1, f64::from(code)), sigma(f64::from(code)));
            assert!((0.8..1.05).contains(&(found / truth)), "{code}: {found} for {truth}");
        }
        // The frame has no code values near 0. Their noise is set to that of the darkest step that the frame has.
        assert_eq!(noise.code_variance(0, 0.0), noise.steps[0].0[1]);
    }

    #[test]
    fn a_clean_frame_has_the_least_noise_and_a_moved_one_more_error() {
        assert_eq!(Noise::of(&frame(|_| 0.0), false).unwrap(), Noise::least());
        let curve = ResponseCurve::srgb();
        let (still, moved) = (Noise::of(&frame(|_| 0.0), false).unwrap(), Noise::of(&frame(|_| 0.0), true).unwrap());
        assert!(moved.variance(&curve, 1, 200) > still.variance(&curve, 1, 200));
        // By hand: the exposure X of code 128 is 1, and dX/dZ = 2.4 / (128 + 0.055 * 255) = 0.0169. The variance is
        // the sum of the squares of one code (0.0169) and of 2 % of X (0.02).
        assert!((still.variance(&curve, 1, 128) - (0.0169f64.powi(2) + 0.02f64.powi(2))).abs() < 2e-5);
    }
}
