//! The direction that a keypoint's surroundings agree on (Lowe 2004, section 5).

use super::extrema::Extremum;
use super::gradient::{Gradients, weights};
use crate::plane::Plane;
use std::f32::consts::PI;

const BINS: usize = 36;
/// The window's Gaussian, in units of the keypoint's scale.
const WINDOW: f64 = 1.5;
/// Peaks as high as this share of the highest make keypoints of their own.
const PEAK: f32 = 0.8;

/// The directions of `extremum`, in radians, -pi..=pi: the highest peak of the histogram of gradients, and those nearly
/// as high.
pub(super) fn assign(level: &Plane<f32>, extremum: &Extremum) -> Vec<f32> {
    let sigma = WINDOW * extremum.sigma;
    let reach = libm::ceil(3.0 * sigma) as isize;
    let (cx, cy) = ((extremum.x + 0.5).floor() as isize, (extremum.y + 0.5).floor() as isize);
    let falloff = (0.5 / (sigma * sigma)) as f32;
    let within =
        |c: isize, n: usize| (c - reach).max(1) as usize..((c + reach).min(n as isize - 2) + 1).max(1) as usize;
    let (columns, rows) = (within(cx, level.width()), within(cy, level.height()));
    let (across, down) = (weights(columns.clone(), extremum.x, falloff), weights(rows.clone(), extremum.y, falloff));
    let mut raw = [0.0f32; BINS];
    let mut gradients = Gradients::default();
    for (y, weight) in rows.zip(down) {
        gradients.fill(level, y, columns.clone());
        for ((length, angle), w) in gradients.length.iter().zip(&gradients.direction).zip(&across) {
            let bin = ((angle + PI) * (BINS as f32 / (2.0 * PI))) as usize % BINS;
            raw[bin] += length * (w * weight);
        }
    }
    // Smoothed by (1 4 6 4 1) / 16, so that a peak is not an accident of the bins.
    let at = |bins: &[f32; BINS], i: usize, d: usize| bins[(i + BINS + d - 2) % BINS];
    let smooth: [f32; BINS] = std::array::from_fn(|i| {
        (at(&raw, i, 0) + at(&raw, i, 4) + 4.0 * (at(&raw, i, 1) + at(&raw, i, 3)) + 6.0 * raw[i]) / 16.0
    });
    let highest = smooth.iter().copied().fold(0.0, f32::max);
    let mut angles = Vec::new();
    for i in 0..BINS {
        let (left, here, right) = (at(&smooth, i, 1), smooth[i], at(&smooth, i, 3));
        if here > left && here >= right && here >= PEAK * highest {
            // The vertex of the parabola through the three bins; bin i is about (i + 1/2).
            let vertex = 0.5 * (left - right) / (left - 2.0 * here + right);
            let angle = (i as f32 + 0.5 + vertex) * (2.0 * PI / BINS as f32) - PI;
            angles.push(if angle > PI { angle - 2.0 * PI } else { angle });
        }
    }
    angles
}
