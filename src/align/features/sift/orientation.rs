//! The dominant gradient direction around a keypoint (Lowe 2004, section 5).

use super::extrema::Extremum;
use super::gradient::{Gradients, Surroundings};
use crate::plane::Plane;
use std::f32::consts::PI;

/// Number of bins of the histogram of directions.
const BINS: usize = 36;
/// Standard deviation of the Gaussian window, in units of the keypoint's scale.
const WINDOW: f64 = 1.5;
/// Least height of a peak that becomes a keypoint, as a share of the highest peak.
const PEAK: f32 = 0.8;

/// Returns the directions of `extremum`, in radians, -pi..=pi. They are the highest peaks of the histogram of gradient
/// directions.
pub(super) fn assign(level: &Plane<f32>, extremum: &Extremum) -> Vec<f32> {
    let sigma = WINDOW * extremum.sigma;
    let falloff = (0.5 / (sigma * sigma)) as f32;
    let Surroundings { columns, rows, weights_x, weights_y } = Surroundings::new(level, extremum, 3.0 * sigma, falloff);
    let mut raw = [0.0f32; BINS];
    let mut gradients = Gradients::default();
    for (y, weight) in rows.zip(weights_y) {
        gradients.fill(level, y, columns.clone());
        for ((length, angle), w) in gradients.length.iter().zip(&gradients.direction).zip(&weights_x) {
            let bin = ((angle + PI) * (BINS as f32 / (2.0 * PI))) as usize % BINS;
            raw[bin] += length * (w * weight);
        }
    }
    // The histogram is smoothed by (1 4 6 4 1) / 16, so that peaks do not depend on the borders of the bins.
    let at = |bins: &[f32; BINS], i: usize, d: usize| bins[(i + BINS + d - 2) % BINS];
    let smooth: [f32; BINS] = std::array::from_fn(|i| {
        (at(&raw, i, 0) + at(&raw, i, 4) + 4.0 * (at(&raw, i, 1) + at(&raw, i, 3)) + 6.0 * raw[i]) / 16.0
    });
    let highest = smooth.iter().copied().fold(0.0, f32::max);
    let mut angles = Vec::new();
    for i in 0..BINS {
        let (left, here, right) = (at(&smooth, i, 1), smooth[i], at(&smooth, i, 3));
        if here > left && here >= right && here >= PEAK * highest {
            // The maximum of the parabola through the three bins. The centre of bin i is i + 1/2.
            let vertex = 0.5 * (left - right) / (left - 2.0 * here + right);
            let angle = (i as f32 + 0.5 + vertex) * (2.0 * PI / BINS as f32) - PI;
            angles.push(if angle > PI { angle - 2.0 * PI } else { angle });
        }
    }
    angles
}
