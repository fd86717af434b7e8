//! Descriptors: 4 x 4 histograms of 8 gradient directions around a keypoint (Lowe 2004, section 6.1).

use super::extrema::Extremum;
use super::gradient::{Gradients, Surroundings};
use crate::align::features::SiftDescriptor;
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use std::f32::consts::PI;
use std::ops::Range;

/// Number of cells (histograms) along each side of the descriptor.
const CELLS: usize = 4;
/// Number of bins of gradient directions per cell.
const BINS: usize = 8;
/// Number of bins of a cell during accumulation. The last one is additional; at the end it is added to the first one.
const CELL_BINS: usize = BINS + 1;
/// Number of bins in a row of cells during accumulation. The row has an additional cell at each end.
const ROW: usize = (CELLS + 2) * CELL_BINS;
/// Width of a cell, in units of the keypoint's scale.
const CELL: f64 = 3.0;
/// Largest entry of the normalised descriptor. It limits large gradients, which may be due to the illumination.
const CLAMP: f32 = 0.2;
/// Euclidean length of the stored descriptor.
pub(in crate::align::features) const LENGTH: f32 = 512.0;

/// Returns the descriptor of `extremum` relative to the direction `angle`.
pub(super) fn describe(level: &Plane<f32>, extremum: &Extremum, angle: f32) -> SiftDescriptor {
    let cell = CELL * extremum.sigma;
    let (sin, cos) = ((libm::sin(angle.into()) / cell) as f32, (libm::cos(angle.into()) / cell) as f32);
    // Samples contribute up to half a cell beyond the outermost cells. At the corners, this is sqrt(2) times as far
    // from the centre as along the sides.
    let reach = cell * std::f64::consts::SQRT_2 * (CELLS as f64 + 1.0) * 0.5;
    let half = CELLS as f32 / 2.0;
    // The Gaussian window has a standard deviation of half the descriptor's width, which is 2 cells.
    let falloff = (0.5 / (f64::from(half) * f64::from(half) * cell * cell)) as f32;
    let Surroundings { columns, rows, weights_x, weights_y } = Surroundings::new(level, extremum, reach, falloff);
    let (mut gradients, mut samples) = (Gradients::default(), Samples::default());
    // Because of the additional cells and directions, `Samples::accumulate` needs no special cases at the ends.
    let mut histogram = [0.0f32; (CELLS + 2) * ROW];
    for (y, weight_y) in rows.zip(weights_y) {
        let dy = (y as f64 - extremum.y) as f32;
        let inside = crossing(extremum.x, dy, (sin, cos), half + 0.5);
        let (first, end) = (inside.start.max(columns.start), inside.end.min(columns.end));
        if first >= end {
            continue;
        }
        gradients.fill(level, y, first..end);
        let weights_x = &weights_x[first - columns.start..];
        samples.resize(end - first);
        let (x, gradients) = (extremum.x, &gradients);
        vectorised(SampleRow { x, dy, sin, cos, angle, first, weight_y, weights_x, gradients, samples: &mut samples });
        samples.accumulate(&mut histogram);
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

/// The samples of a row, and their positions in the histograms. The buffers are reused for the next row.
#[derive(Default)]
struct Samples {
    /// Index of the first bin that the sample is added to.
    at: Vec<i32>,
    /// Share of the sample that goes to the next cell to the right, 0..1.
    right: Vec<f32>,
    /// Share of the sample that goes to the next cell below, 0..1.
    down: Vec<f32>,
    /// Share of the sample that goes to the next direction, 0..1.
    turned: Vec<f32>,
    weight: Vec<f32>,
}

impl Samples {
    fn resize(&mut self, n: usize) {
        self.at.resize(n, 0);
        for numbers in [&mut self.right, &mut self.down, &mut self.turned, &mut self.weight] {
            numbers.resize(n, 0.0);
        }
    }

    /// Adds every sample to eight bins: two rows of cells times two columns times two directions. The last of these
    /// bins is ROW + CELL_BINS + 1 after the first one.
    fn accumulate(&self, histogram: &mut [f32; (CELLS + 2) * ROW]) {
        let places = self.at.iter().zip(&self.right).zip(&self.down).zip(&self.turned).zip(&self.weight);
        for ((((at, fc), fr), fo), weight) in places {
            let at = *at as usize;
            let Some(near) = histogram.get_mut(at..at + ROW + CELL_BINS + 2) else {
                continue;
            };
            let (upper, lower) = (weight * (1.0 - fr), weight * fr);
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
}

/// Computes the positions of a row of samples in the histograms.
struct SampleRow<'a> {
    /// Column of the keypoint.
    x: f64,
    /// Distance of the row from the keypoint, positive downwards, in pixels.
    dy: f32,
    /// `sin` and `cos`: sine and cosine of the keypoint's direction, divided by the width of a cell in pixels. They
    /// rotate offsets in pixels and scale them to cells.
    sin: f32,
    cos: f32,
    /// Direction of the keypoint.
    angle: f32,
    /// Column of the first sample.
    first: usize,
    weight_y: f32,
    weights_x: &'a [f32],
    gradients: &'a Gradients,
    samples: &'a mut Samples,
}

impl Loops for SampleRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let SampleRow { x, dy, sin, cos, angle, first, weight_y, weights_x, gradients, samples } = self;
        let Samples { at, right, down, turned, weight } = samples;
        let n = at.len();
        let (length, direction) = (&gradients.length[..n], &gradients.direction[..n]);
        let weights_x = &weights_x[..n];
        let (right, down) = (&mut right[..n], &mut down[..n]);
        let (turned, weight) = (&mut turned[..n], &mut weight[..n]);
        let (half, last) = (CELLS as f32 / 2.0, CELLS as f32 + 1.0);
        let first = first as i32;
        for i in 0..n {
            let dx = (f64::from(first + i as i32) - x) as f32;
            // Position in cells, along and across the keypoint's direction. Position 0 is the centre of the additional
            // cell before the first one.
            let (column, row) = (cos * dx + sin * dy + half + 0.5, cos * dy - sin * dx + half + 0.5);
            let is_inside = !((column <= 0.0) | (row <= 0.0) | (column >= last) | (row >= last));
            let turn = (direction[i] - angle) * (BINS as f32 / (2.0 * PI)) + 2.0 * BINS as f32;
            // For samples inside, `column`, `row` and `turn` are positive, so the conversion rounds down.
            let (c, r, o) = (column as i32, row as i32, turn as i32);
            (right[i], down[i], turned[i]) = (column - c as f32, row - r as f32, turn - o as f32);
            // Samples outside are added to the first bins with weight 0.
            at[i] = if is_inside { r * ROW as i32 + c * CELL_BINS as i32 + o % BINS as i32 } else { 0 };
            weight[i] = if is_inside { length[i] * (weights_x[i] * weight_y) } else { 0.0 };
        }
    }
}

/// Returns the columns of a row that are inside a rotated square, and one more column at each end.
///
/// The centre of the square is at column `x`, `dy` pixels above the row; its sides are 2 `side` long. `side` is in the
/// unit by which `sin` and `cos` are divided.
fn crossing(x: f64, dy: f32, (sin, cos): (f32, f32), side: f32) -> Range<usize> {
    let (mut low, mut high) = (f32::NEG_INFINITY, f32::INFINITY);
    // A sample at column x + dx is inside if |cos dx + sin dy| < side and |cos dy - sin dx| < side.
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
    fn row_crosses_the_square_at_its_samples() {
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
                // `found` has one more column at each end, and rounding may add another one at each end.
                assert!(found.len() <= inside.len() + 4, "{k} {dy}: {found:?} for {inside:?}");
            }
        }
    }
}
