//! Extrema of the differences of Gaussians, with sub-pixel positions (Lowe 2004, sections 3.1 and 4).

use super::SiftOptions;
use super::scale_space::{Octave, ScaleSpace};
use crate::align::features::{Keypoint, interpolation};
use crate::plane::{Plane, map_bands};
use crate::simd::{Loops, at_least, at_most, vectorised};
use nalgebra::Vector3;

/// An extremum of the difference of Gaussians D; `x`, `y` and `sigma` are in pixels of its octave.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extremum {
    pub(super) octave: usize,
    pub(super) interval: usize,
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) sigma: f64,
    /// |D| at the extremum.
    pub(super) response: f32,
    /// Whether the extremum is bright. If so, D is negative there, because D is the smoother minus the sharper image.
    pub(super) bright: bool,
}

impl Extremum {
    /// Returns the Gaussian image at the scale of the extremum, from which its orientation and descriptor are computed.
    pub(super) fn level<'a>(&self, space: &'a ScaleSpace) -> &'a Plane<f32> {
        &space.octaves[self.octave].gaussians[self.interval]
    }

    /// Returns the extremum as a keypoint, in pixels of the image.
    pub(super) fn keypoint(&self, space: &ScaleSpace, angle: f32) -> Keypoint {
        let step = space.step(self.octave);
        Keypoint {
            x: (self.x * step) as f32,
            y: (self.y * step) as f32,
            scale: (self.sigma * step) as f32,
            angle,
            response: self.response,
            bright: self.bright,
        }
    }
}

/// Width of the image border that is not searched for extrema, in samples.
const BORDER: usize = 5;
/// Largest number of fits. Each one is at the sample nearest to the extremum that the fit before found.
const MOST_MOVES: usize = 5;

/// Returns all extrema that have enough contrast and are not on an edge, ordered by octave, interval, row and column.
pub(super) fn find(space: &ScaleSpace, options: &SiftOptions) -> Vec<Extremum> {
    // The fit of a quadratic changes the value of a sample by at most about half of that value. So weaker samples than
    // this cannot reach the required contrast.
    let least = (0.5 * options.contrast) as f32;
    let mut found = Vec::new();
    for (index, octave) in space.octaves.iter().enumerate() {
        for interval in 1..=options.intervals {
            let (width, height) = (octave.gaussians[interval].width(), octave.gaussians[interval].height());
            let bands = map_bands(height, |rows| {
                let mut band = Vec::new();
                let rows = rows.start.max(BORDER)..rows.end.min(height.saturating_sub(BORDER));
                // `window` holds three consecutive rows of D (difference of Gaussians). `candidates` marks the
                // candidates in the middle row.
                let mut window: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; width]);
                let mut candidates = vec![false; width];
                for y in rows.clone() {
                    window.rotate_left(1);
                    let missing = if y == rows.start { 0 } else { 2 };
                    for (k, row) in window.iter_mut().enumerate().skip(missing) {
                        octave.difference_row(interval, y + k - 1, row);
                    }
                    let [up, here, down] = &window;
                    vectorised(Candidates { up, here, down, least, candidates: &mut candidates });
                    find_in_row(space, index, interval, y, options, &candidates, &mut band);
                }
                band
            });
            found.extend(bands.into_iter().flatten());
        }
    }
    found
}

/// Marks the samples where D is at least `least` and not smaller than at the four neighbours (left, right, above,
/// below), or at most -`least` and not larger than at these neighbours. Only these few samples are compared with all
/// their neighbours later.
struct Candidates<'a> {
    up: &'a [f32],
    here: &'a [f32],
    down: &'a [f32],
    least: f32,
    candidates: &'a mut [bool],
}

impl Loops for Candidates<'_> {
    type Output = ();

    // The loop has no branches, so that the compiler can vectorise it.
    #[inline(always)]
    fn run(self) {
        let least = self.least;
        let n = self.here.len().max(2) - 2;
        let (up, down) = (&self.up[1..][..n], &self.down[1..][..n]);
        let (left, here, right) = (&self.here[..n], &self.here[1..][..n], &self.here[2..][..n]);
        let out = &mut self.candidates[1..][..n];
        for i in 0..n {
            let v = here[i];
            let high = at_least(at_least(left[i], right[i]), at_least(at_least(up[i], down[i]), least));
            let low = at_most(at_most(left[i], right[i]), at_most(at_most(up[i], down[i]), -least));
            out[i] = (v >= high) | (v <= low);
        }
    }
}

/// Adds the extrema among the `candidates` of row `y` to `found`.
fn find_in_row(
    space: &ScaleSpace,
    index: usize,
    interval: usize,
    y: usize,
    options: &SiftOptions,
    candidates: &[bool],
    found: &mut Vec<Extremum>,
) {
    let octave = &space.octaves[index];
    for x in (BORDER..candidates.len().saturating_sub(BORDER)).filter(|&x| candidates[x]) {
        let v = octave.difference(interval, x, y);
        let beats = |w: f32| if v > 0.0 { v >= w } else { v <= w };
        let is_extremum = (interval - 1..=interval + 1)
            .all(|i| (y - 1..=y + 1).all(|r| (x - 1..=x + 1).all(|c| beats(octave.difference(i, c, r)))));
        if is_extremum && let Some((interval, x, y, offset, value)) = localise(octave, interval, x, y, options) {
            let response = value.abs();
            if response >= options.contrast && !is_edge(octave, interval, x, y, options.edge_ratio) {
                found.push(Extremum {
                    octave: index,
                    interval,
                    x: x as f64 + offset[0],
                    y: y as f64 + offset[1],
                    sigma: space.sigma_at(interval as f64 + offset[2]),
                    response: response as f32,
                    bright: value < 0.0,
                });
            }
        }
    }
}

/// Fits a quadratic to D around a sample, and moves to the sample nearest to the extremum of the quadratic, until this
/// is the sample of the fit (section 4, eq. 2 and 3).
///
/// Returns interval, x and y of the last sample, the offset of the extremum from this sample, and D at the extremum;
/// none if the moves leave the searched range or do not end.
fn localise(
    octave: &Octave,
    mut interval: usize,
    mut x: usize,
    mut y: usize,
    options: &SiftOptions,
) -> Option<(usize, usize, usize, Vector3<f64>, f64)> {
    for _ in 0..MOST_MOVES {
        let d = |dx: isize, dy: isize, ds: isize| -> f64 {
            let (x, y) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            octave.difference(interval.wrapping_add_signed(ds), x, y).into()
        };
        let (offset, value) = interpolation::extremum(d)?;
        if offset.iter().all(|o| o.abs() <= 0.5) {
            return Some((interval, x, y, offset, value));
        }
        if offset.iter().any(|o| !o.is_finite() || o.abs() > 100.0) {
            return None;
        }
        let plane = &octave.gaussians[interval];
        let step = |i: usize, o: f64, low: usize, high: usize| -> Option<usize> {
            let moved = i as f64 + (o + 0.5).floor();
            (moved >= low as f64 && moved < high as f64).then_some(moved as usize)
        };
        x = step(x, offset[0], BORDER, plane.width() - BORDER)?;
        y = step(y, offset[1], BORDER, plane.height() - BORDER)?;
        interval = step(interval, offset[2], 1, options.intervals + 1)?;
    }
    None
}

/// Whether the ratio of the principal curvatures is at least r, or they have different signs. With the Hessian H of D,
/// this is the case if tr(H)^2 / det(H) >= (r + 1)^2 / r, or if det(H) <= 0 (section 4.1).
fn is_edge(octave: &Octave, interval: usize, x: usize, y: usize, r: f64) -> bool {
    let d = |dx: isize, dy: isize| -> f64 {
        octave.difference(interval, x.wrapping_add_signed(dx), y.wrapping_add_signed(dy)).into()
    };
    let v = d(0, 0);
    let (xx, yy) = (d(1, 0) + d(-1, 0) - 2.0 * v, d(0, 1) + d(0, -1) - 2.0 * v);
    let xy = 0.25 * (d(1, 1) - d(-1, 1) - d(1, -1) + d(-1, -1));
    let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
    determinant <= 0.0 || trace * trace * r >= (r + 1.0) * (r + 1.0) * determinant
}
