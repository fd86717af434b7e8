//! The cost volume: how well each relative depth explains what all frames show around each pixel.
//!
//! In: the frames on one level, each compared with the reference. Out: a [`CostVolume`], one cost for each pixel and
//! each of the [`Labels`]. Cost: about a hundred operations for each pixel, label and frame. Source: plane sweep
//! (Collins, "A Space-Sweep Approach to True Multi-Image Matching", CVPR 1996); the profile likelihood of two windows
//! that are linear functions of each other depends only on their correlation.
//!
//! A label is a relative depth. Where frames are clipped or too dark, they say nothing about the depth; the other
//! frames do. The borders of clipped areas say most: see [`Compared`].

use crate::align::motion::camera::Camera;
use crate::align::photometric::ToneTables;
use crate::plane::Plane;
use crate::simd::{Loops, at_least, log2, vectorised};
use rayon::prelude::*;
use std::ops::Range;

/// Windows reach this far from their centre, in pixels of the level.
pub(super) const RADIUS: usize = 2;
/// Side of a window.
pub(super) const SIDE: usize = 2 * RADIUS + 1;
/// Rows of a band. Narrower bands compute more rows twice, wider bands do not fit into the cache.
const ROWS: usize = 16;
/// Variance of the noise of a grey value.
pub(super) const NOISE: f32 = 2.0;
/// The share of the variance of a window that is unexplained at its true position.
const UNEXPLAINED: f32 = 0.03;
/// A window with fewer usable pixels says nothing.
const LEAST_USABLE: f32 = 8.0;
/// The grey values that are usable: others are nearly black, or clipped.
const USABLE: std::ops::RangeInclusive<u8> = 5..=250;

/// Cost of a label that is not expected, in natural units of log likelihood.
const UNEXPECTED: f32 = 0.06;
/// From this distance from the expected label on, the cost does not rise further, in labels.
const FAR: f32 = 4.0;

/// Evenly spaced relative depths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Labels {
    pub(super) first: f64,
    pub(super) step: f64,
    pub(super) count: usize,
}

impl Labels {
    /// The relative depth of a label; labels between the whole ones have depths between theirs.
    pub(super) fn depth(&self, label: f32) -> f64 {
        self.first + self.step * f64::from(label)
    }
}

/// The costs of all labels of all pixels.
#[derive(Debug)]
pub(super) struct CostVolume {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) labels: usize,
    /// Cost of each label, label by label for each pixel, row by row. Lower is better.
    pub(super) costs: Vec<u8>,
    /// Number of cost units of a natural unit of log likelihood.
    pub(super) scale: f32,
}

/// Whether a grey value is neither nearly black nor clipped.
pub(super) fn is_usable(value: u8) -> bool {
    USABLE.contains(&value)
}

/// A frame that is compared with the reference: both at the exposure of the brighter one, so that both are clipped in
/// the same areas, and the borders of these areas can be compared.
pub(super) struct Compared {
    /// Grey values of the reference and of the frame; NaN where they are nearly black.
    pub(super) reference: Plane<f32>,
    pub(super) frame: Plane<f32>,
    camera: Camera,
}

impl Compared {
    /// The comparison of two frames by the tables `tones`.
    pub(super) fn new(reference: &Plane<u8>, frame: &Plane<u8>, tones: &ToneTables, camera: Camera) -> Self {
        let converted = |plane: &Plane<u8>, table: &[f32; 256]| {
            plane.map(|v| if v < *USABLE.start() { f32::NAN } else { table[usize::from(v)] })
        };
        let (reference, frame) = (converted(reference, &tones.reference), converted(frame, &tones.frame));
        Compared { reference, frame, camera }
    }
}

impl CostVolume {
    /// Computes the volume of a reference of this width and height, from the comparisons with all frames.
    pub(super) fn new((width, height): (usize, usize), frames: &[Compared], labels: &Labels) -> Self {
        let most = -0.5 * log2(UNEXPLAINED) * std::f32::consts::LN_2 * frames.len() as f32;
        let scale = 255.0 / (most + UNEXPECTED);
        let mut volume = CostVolume { width, height, labels: labels.count, costs: Vec::new(), scale };
        let unknown = volume.unknown();
        volume.costs = vec![unknown; width * height * labels.count];
        volume.costs.par_chunks_mut(ROWS * width * labels.count).enumerate().for_each_init(
            || Band::new(width),
            |band, (i, costs)| {
                let rows = i * ROWS..((i + 1) * ROWS).min(height);
                for label in 0..labels.count {
                    let gains = band.gains(frames, labels.depth(label as f32), rows.clone());
                    for (costs, gain) in costs.chunks_exact_mut(labels.count).zip(gains) {
                        costs[label] = unknown.saturating_sub((scale * gain + 0.5) as u8);
                    }
                }
            },
        );
        volume
    }

    /// The cost of a label that explains nothing.
    pub(super) fn unknown(&self) -> u8 {
        255 - (UNEXPECTED * self.scale + 0.5) as u8
    }

    /// Raises the costs of labels that are far from those that `expected` gives for the pixels (x, y), by at most
    /// [`UNEXPECTED`]. Each has a handicap: it counts as if it were farther away, by so many labels.
    pub(super) fn expect<L: Iterator<Item = (f32, f32)>>(&mut self, expected: impl Fn(usize, usize) -> L + Sync) {
        let (width, labels, most) = (self.width, self.labels, UNEXPECTED * self.scale);
        self.costs.par_chunks_mut(width * labels).enumerate().for_each(|(y, costs)| {
            for (x, costs) in costs.chunks_exact_mut(labels).enumerate() {
                let expected: Vec<(f32, f32)> = expected(x, y).collect();
                for (label, cost) in costs.iter_mut().enumerate() {
                    let distances = expected.iter().map(|(at, handicap)| (label as f32 - at).abs() + handicap);
                    let distance = distances.fold(FAR, f32::min);
                    *cost = cost.saturating_add((most * (distance / FAR) + 0.5) as u8);
                }
            }
        });
    }

    /// The costs of pixel `i`.
    pub(super) fn at(&self, i: usize) -> &[u8] {
        &self.costs[i * self.labels..(i + 1) * self.labels]
    }
}

/// Buffers for a band of rows and the [`RADIUS`] rows on both sides.
struct Band {
    width: usize,
    /// For each row: how many frames and the reference are usable (0 or 1), and the products of their values.
    moments: Vec<[Vec<f32>; 6]>,
    /// Sums of the moments over the rows of a window, with [`RADIUS`] columns of zeros on both sides.
    columns: [Vec<f32>; 6],
    warped: Vec<f32>,
    gains: Vec<f32>,
}

impl Band {
    fn new(width: usize) -> Self {
        Band {
            width,
            moments: (0..ROWS + 2 * RADIUS).map(|_| std::array::from_fn(|_| vec![0.0; width])).collect(),
            columns: std::array::from_fn(|_| vec![0.0; width + 2 * RADIUS]),
            warped: vec![0.0; width],
            gains: vec![0.0; ROWS * width],
        }
    }

    /// Returns by how much the log likelihood of the pixels of `rows` rises if they have the relative depth `q`.
    fn gains(&mut self, frames: &[Compared], q: f64, rows: Range<usize>) -> &[f32] {
        let gains = &mut self.gains[..rows.len() * self.width];
        gains.fill(0.0);
        for Compared { reference, frame, camera } in frames {
            for (i, moments) in self.moments[..rows.len() + 2 * RADIUS].iter_mut().enumerate() {
                match (rows.start + i).checked_sub(RADIUS).filter(|&y| y < reference.height()) {
                    Some(y) => {
                        warp_row(frame, camera, q, y, &mut self.warped);
                        vectorised(Products { reference: reference.row(y), frame: &self.warped, moments });
                    }
                    None => moments.iter_mut().for_each(|m| m.fill(0.0)),
                }
            }
            for (i, gains) in gains.chunks_exact_mut(self.width).enumerate() {
                vectorised(Gains { rows: &self.moments[i..i + SIDE], columns: &mut self.columns, gains });
            }
        }
        gains
    }
}

/// Fetches the pixels of row `y` of the reference from `frame` by bilinear interpolation: NaN outside, and where one of
/// the four pixels is NaN.
fn warp_row(frame: &Plane<f32>, camera: &Camera, q: f64, y: usize, to: &mut [f32]) {
    let (at, by) = camera.line(0.0, y as f64);
    let (next, _) = camera.line(1.0, y as f64);
    let start: [f32; 3] = std::array::from_fn(|i| (at[i] + q * by[i]) as f32);
    let slope: [f32; 3] = std::array::from_fn(|i| (next[i] - at[i]) as f32);
    let (width, height) = (frame.width(), frame.height());
    let values = frame.as_slice();
    for (x, to) in to.iter_mut().enumerate() {
        let x = x as f32;
        let w = 1.0 / (start[2] + x * slope[2]);
        let (u, v) = ((start[0] + x * slope[0]) * w, (start[1] + x * slope[1]) * w);
        *to = if u >= 0.0 && v >= 0.0 && u < (width - 1) as f32 && v < (height - 1) as f32 {
            let (left, top) = (u as usize, v as usize);
            let (fx, fy) = (u - left as f32, v - top as f32);
            let i = top * width + left;
            let upper = values[i] + fx * (values[i + 1] - values[i]);
            let lower = values[i + width] + fx * (values[i + width + 1] - values[i + width]);
            upper + fy * (lower - upper)
        } else {
            f32::NAN
        };
    }
}

/// Computes the moments of a row.
struct Products<'a> {
    reference: &'a [f32],
    frame: &'a [f32],
    moments: &'a mut [Vec<f32>; 6],
}

impl Loops for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [n, a, b, aa, bb, ab] = self.moments;
        let count = self.reference.len();
        let (n, a, b) = (&mut n[..count], &mut a[..count], &mut b[..count]);
        let (aa, bb, ab) = (&mut aa[..count], &mut bb[..count], &mut ab[..count]);
        let frame = &self.frame[..count];
        for x in 0..count {
            let (r, f) = (self.reference[x], frame[x]);
            let sum = r + f;
            let is_known = !sum.is_nan();
            let (r, f) = if is_known { (r, f) } else { (0.0, 0.0) };
            n[x] = if is_known { 1.0 } else { 0.0 };
            (a[x], b[x], aa[x], bb[x], ab[x]) = (r, f, r * r, f * f, r * f);
        }
    }
}

/// Adds the gains of one frame to those of a row.
struct Gains<'a> {
    /// The moments of the rows of the windows.
    rows: &'a [[Vec<f32>; 6]],
    columns: &'a mut [Vec<f32>; 6],
    gains: &'a mut [f32],
}

impl Loops for Gains<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.gains.len();
        for (i, column) in self.columns.iter_mut().enumerate() {
            let column = &mut column[RADIUS..RADIUS + width];
            let rows: [&[f32]; SIDE] = std::array::from_fn(|row| &self.rows[row][i][..width]);
            for x in 0..width {
                column[x] = rows[0][x] + rows[1][x] + rows[2][x] + rows[3][x] + rows[4][x];
            }
        }
        let columns: [&[f32]; 6] = std::array::from_fn(|i| &self.columns[i][..width + 2 * RADIUS]);
        for x in 0..width {
            let sum = |c: &[f32]| c[x] + c[x + 1] + c[x + 2] + c[x + 3] + c[x + 4];
            let n = sum(columns[0]);
            let per = 1.0 / at_least(n, 1.0);
            let (a, b) = (sum(columns[1]) * per, sum(columns[2]) * per);
            let aa = at_least(sum(columns[3]) * per - a * a, 0.0) + NOISE;
            let bb = at_least(sum(columns[4]) * per - b * b, 0.0) + NOISE;
            let ab = at_least(sum(columns[5]) * per - a * b, 0.0);
            let unexplained = 1.0 + UNEXPLAINED - ab * ab / (aa * bb);
            let gain = at_least(-0.5 * std::f32::consts::LN_2 * log2(unexplained), 0.0);
            let share = n * (1.0 / (SIDE * SIDE) as f32);
            self.gains[x] += if n >= LEAST_USABLE { share * gain } else { 0.0 };
        }
    }
}
