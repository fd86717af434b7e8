//! The surroundings of a keypoint in 4 x 4 histograms of 8 directions (Lowe 2004, section 6.1).

use super::extrema::Extremum;
use super::gradient::{Gradients, weights};
use crate::align::features::Descriptor;
use crate::plane::Plane;
use std::f32::consts::PI;
use std::ops::Range;

/// Histograms along each side.
const CELLS: usize = 4;
/// Directions in each.
const BINS: usize = 8;
/// Numbers of a cell while it is filled: one direction more, which is the first again.
const CELL_BINS: usize = BINS + 1;
/// Numbers of a row of cells while it is filled: one cell more at either end.
const ROW: usize = (CELLS + 2) * CELL_BINS;
/// Width of a cell, in units of the keypoint's scale.
const CELL: f64 = 3.0;
/// No entry of the normalised descriptor exceeds this: large gradients may be a matter of light.
const CLAMP: f32 = 0.2;
/// Length of the descriptor as stored.
const LENGTH: f32 = 512.0;

/// The descriptor of `extremum` seen along `angle`.
pub(super) fn describe(level: &Plane<f32>, extremum: &Extremum, angle: f32) -> Descriptor {
    let cell = CELL * extremum.sigma;
    let (sin, cos) = ((libm::sin(angle.into()) / cell) as f32, (libm::cos(angle.into()) / cell) as f32);
    // The outermost cells are filled by samples up to half a cell beyond them, at the corners sqrt(2) times as far.
    let reach = libm::ceil(cell * std::f64::consts::SQRT_2 * (CELLS as f64 + 1.0) * 0.5) as isize;
    let (cx, cy) = ((extremum.x + 0.5).floor() as isize, (extremum.y + 0.5).floor() as isize);
    let half = CELLS as f32 / 2.0;
    let within =
        |c: isize, n: usize| (c - reach).max(1) as usize..((c + reach).min(n as isize - 2) + 1).max(1) as usize;
    let (columns, rows) = (within(cx, level.width()), within(cy, level.height()));
    // The window's Gaussian has half the descriptor's width, 2 cells, and is round: a product of one along each axis.
    let falloff = (0.5 / (f64::from(half) * f64::from(half) * cell * cell)) as f32;
    let (weights_x, weights_y) =
        (weights(columns.clone(), extremum.x, falloff), weights(rows.clone(), extremum.y, falloff));
    let mut gradients = Gradients::default();
    // One cell more on each side and one direction more, so that the spreading below needs no test.
    let mut histogram = [0.0f32; (CELLS + 2) * ROW];
    for (y, weight_y) in rows.zip(weights_y) {
        let dy = (y as f64 - extremum.y) as f32;
        let inside = crossing(extremum.x, dy, (sin, cos), half + 0.5);
        let (first, end) = (inside.start.max(columns.start), inside.end.min(columns.end));
        if first >= end {
            continue;
        }
        gradients.fill(level, y, first..end);
        let samples = gradients.length.iter().zip(&gradients.direction).zip(&weights_x[first - columns.start..]);
        for (x, ((length, direction), weight_x)) in (first..end).zip(samples) {
            let dx = (x as f64 - extremum.x) as f32;
            // In cells along the keypoint's direction and across it, from one cell before the first.
            let (column, row) = (cos * dx + sin * dy + half + 0.5, cos * dy - sin * dx + half + 0.5);
            let last = CELLS as f32 + 1.0;
            if column <= 0.0 || row <= 0.0 || column >= last || row >= last {
                continue;
            }
            let weighted = length * (weight_x * weight_y);
            let turn = (direction - angle) * (BINS as f32 / (2.0 * PI)) + 2.0 * BINS as f32;
            // All three are positive: what is cut off is what floor would cut off.
            let (c, r, o) = (column as usize, row as usize, turn as usize);
            let (fc, fr, fo) = (column - c as f32, row - r as f32, turn - o as f32);
            let o = o % BINS;
            // Two rows, two cells and two directions: the last lies ROW + CELL_BINS + 1 after the first.
            let at = r * ROW + c * CELL_BINS + o;
            let Some(near) = histogram.get_mut(at..at + ROW + CELL_BINS + 2) else {
                continue;
            };
            let (upper, lower) = (weighted * (1.0 - fr), weighted * fr);
            for (w, k) in [
                (upper * (1.0 - fc), 0),
                (upper * fc, CELL_BINS),
                (lower * (1.0 - fc), ROW),
                (lower * fc, ROW + CELL_BINS),
            ] {
                near[k] += w * (1.0 - fo);
                near[k + 1] += w * fo;
            }
        }
    }
    let mut vector = [0.0f32; CELLS * CELLS * BINS];
    for (i, v) in vector.iter_mut().enumerate() {
        let cell = (1 + i / (CELLS * BINS)) * ROW + (1 + i / BINS % CELLS) * CELL_BINS;
        *v = histogram[cell + i % BINS] + if i % BINS == 0 { histogram[cell + BINS] } else { 0.0 };
    }
    normalise(&mut vector);
    vector.iter_mut().for_each(|v| *v = v.min(CLAMP));
    normalise(&mut vector);
    vector.map(|v| (v * LENGTH + 0.5) as u8)
}

/// The columns, and one more at either end, in which the row `dy` below a centre at column `x` crosses the turned square of which no
/// side is farther from the centre than `side`; sine and cosine are divided by the length of which the side is counted.
fn crossing(x: f64, dy: f32, (sin, cos): (f32, f32), side: f32) -> Range<usize> {
    let (mut low, mut high) = (f32::NEG_INFINITY, f32::INFINITY);
    // |cos dx + sin dy| < side, and |cos dy - sin dx| < side.
    for (slope, offset) in [(cos, sin * dy), (-sin, cos * dy)] {
        if slope.abs() > 1e-6 {
            let (a, b) = ((-side - offset) / slope, (side - offset) / slope);
            (low, high) = (low.max(a.min(b)), high.min(a.max(b)));
        } else if offset.abs() >= side {
            return 0..0;
        }
    }
    let (first, last) = (libm::ceil(x + f64::from(low)) - 1.0, (x + f64::from(high)).floor() + 1.0);
    if last < 0.0 || first > last { 0..0 } else { first.max(0.0) as usize..last as usize + 1 }
}

fn normalise(vector: &mut [f32]) {
    let length = vector.iter().map(|v| v * v).sum::<f32>().sqrt();
    if length > 0.0 {
        vector.iter_mut().for_each(|v| *v /= length);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_crosses_the_square_where_its_samples_lie_in_it() {
        let side = 2.5f32;
        for k in 0..48 {
            let (sin, cos) = (k as f32 * std::f32::consts::PI / 24.0).sin_cos();
            let (sin, cos) = (sin / 4.7, cos / 4.7);
            for dy in -20..=20 {
                let dy = dy as f32 + 0.3;
                let found = crossing(30.4, dy, (sin, cos), side);
                let is_inside = |x: usize| {
                    let dx = x as f32 - 30.4;
                    (cos * dx + sin * dy).abs() < side && (cos * dy - sin * dx).abs() < side
                };
                let inside: Vec<usize> = (0..61).filter(|&x| is_inside(x)).collect();
                assert!(inside.iter().all(|x| found.contains(x)), "{k} {dy}: {found:?} lacks {inside:?}");
                // One more at either end, and what rounding may add.
                assert!(found.len() <= inside.len() + 4, "{k} {dy}: {found:?} for {inside:?}");
            }
        }
    }
}
