//! Refinement: iterative photometric alignment, from an error of about a pixel down to the noise limit.
//!
//! In: a [`FramePair`] and an approximate transform. Out: the transform of a given model with the least photometric
//! error, and an error estimate. Cost: both frames are converted to a common exposure on each level down to
//! [`measured_level`]; on the finest level, only about 16,000 patches are converted. In addition, 0.1 us for each point
//! and step. Source: Baker & Matthews, "Lucas-Kanade 20 Years On", IJCV 56(3), 2004, section 3.1 (compositional
//! updates). In addition, the residuals are weighted by Tukey's biweight.

mod fine_level;
mod frame_pair;
mod normal_equations;
mod patch;

pub use frame_pair::FramePair;

use crate::align::grey::{finest_level, measured_level};
use crate::align::refinement::frame_pair::Point;
use crate::align::refinement::patch::Patches;
use crate::align::resampling::cubic::cubic;
use crate::align::transform::{
    Block, Increment, Model, Transform, blocks, fitted_error, map, off_level, on_level, restrict, to_transform,
};
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use crate::statistics::median;
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Largest number of steps on each level.
const MOST_STEPS: usize = 12;
/// The iteration on a level ends after a step that moves every corner by less than this, in pixels of the level: (on
/// the last level, on the other levels).
const STILL: (f64, f64) = (0.005, 0.05);
/// If the steps on a level move a corner by more than this in total, in pixels of the level, they diverge: the levels are
/// smoothed with a standard deviation of one pixel, so a pixel does not show what is farther away. In a pattern that
/// repeats, the steps may end at any period. Chosen on rendered brackets: no right result was lost.
const MOST_MOVE: f64 = 16.0;
/// With fewer points than this, nothing is solved.
const LEAST_POINTS: usize = 50;
/// The actual error, divided by the error that would result if the noise of all pixels were independent. In fact,
/// smoothing, JPEG and aliasing correlate the noise of neighbouring pixels. Used to weight the prior against the
/// pixels. Measured on rendered brackets. The error estimate depends on this value in two ways: through the prior, and,
/// if only few blocks have detail, directly (see [`fitted_error`]).
const NOISE_FACTOR: f64 = 4.0;
/// Error that all points of a frame have in common, in pixels of the level. It is due to the interpolation between
/// pixels, and the residuals do not show it. Measured on rendered brackets whose frames are shifted.
const INTERPOLATION_BIAS: f64 = 0.005;
/// Number of points that a thread processes at a time.
const PIECE: usize = 1024;

/// A refined transform and its error estimate. All lengths are in pixels of level 0.
#[derive(Debug, Clone)]
pub struct Refined {
    /// The transform (reference pixel -> frame pixel), of the requested model.
    pub transform: Transform,
    /// Estimated error, root mean square over the image, in pixels. Its causes are noise, and parts of the image that
    /// the model does not fit.
    pub error_px: f64,
}

/// Refines `start` as a transform of `model`, level by level from `levels.0` (coarsest) to `levels.1` (0 is the largest
/// level).
///
/// Levels with more pixels than [`measured_level`] are skipped, with one exception: if level `levels.1` has more
/// pixels, the last stage is on [`finest_level`], where only patches around the points are read. Returns none if the
/// common area of the frames has too little structure, or if the steps diverge.
pub fn refine(pair: &FramePair, start: &Transform, model: Model, levels: (usize, usize)) -> Option<Refined> {
    let (coarsest, finest) = levels;
    let (width, height) = pair.size();
    let measured = measured_level(pair.reference()).max(finest);
    let mut state = restrict(&start.matrix(width, height), model, width, height);
    let mut last = None;
    for level in (measured..=coarsest.min(pair.reference().len() - 1)).rev() {
        let (whole, points) = (pair.level(level), pair.points(level));
        let residuals = |h: &Matrix3<f64>, out: &mut [f32]| {
            let pieces = points.par_chunks(PIECE).zip(out.par_chunks_mut(PIECE));
            pieces.for_each(|(points, out)| vectorised(Residuals { points, h, frame: &whole.frame, out }));
        };
        let stage = Stage::new(pair, level, level == finest, points)?;
        (state, last) = stage.solve(state, model, residuals)?;
    }
    if finest < measured {
        let points = fine_level::points(pair);
        let mut seen = pair.patches(|| Patches::unread(points.len()));
        let residuals = |h: &Matrix3<f64>, out: &mut [f32]| fine_level::residuals(pair, &mut seen, h, out);
        let stage = Stage::new(pair, finest_level(pair.reference()), true, points)?;
        let solved = stage.solve(state, model, residuals);
        pair.keep_patches(seen);
        (state, last) = solved?;
    }
    Some(Refined { transform: to_transform(&state, model, width, height), error_px: last? })
}

/// Computes the residuals (frame minus reference) of some points on a level whose smoothed frame is in memory as a
/// whole.
struct Residuals<'a> {
    points: &'a [Point],
    h: &'a Matrix3<f64>,
    frame: &'a Plane<f32>,
    out: &'a mut [f32],
}

impl Loops for Residuals<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (p, out) in self.points.iter().zip(self.out) {
            let (u, v) = map(self.h, p.x, p.y);
            *out = cubic(self.frame, u, v).map_or(f32::NAN, |f| f - p.value);
        }
    }
}

/// The refinement on one level: its points, its size, and whether it is the last level.
struct Stage<'a> {
    points: &'a [Point],
    level: usize,
    size: (usize, usize),
    is_last: bool,
}

impl<'a> Stage<'a> {
    fn new(pair: &FramePair, level: usize, is_last: bool, points: &'a [Point]) -> Option<Self> {
        let plane = pair.reference().level(level);
        (points.len() >= LEAST_POINTS).then_some(Stage {
            points,
            level,
            size: (plane.width(), plane.height()),
            is_last,
        })
    }

    /// Iterates Gauss-Newton steps with Tukey's weights until every corner moves by less than [`STILL`]. Returns the
    /// transform, and on the last level [`Refined::error_px`].
    ///
    /// `residuals` computes frame minus reference at every point under a given transform, NaN for points outside the
    /// frame.
    fn solve(
        &self,
        h_full: Matrix3<f64>,
        model: Model,
        mut residuals: impl FnMut(&Matrix3<f64>, &mut [f32]),
    ) -> Option<(Matrix3<f64>, Option<f64>)> {
        let (width, height) = self.size;
        let still = if self.is_last { STILL.0 } else { STILL.1 };
        let start = on_level(&h_full, self.level);
        let mut h = start;
        let basis = Increment::new(model, width, height);
        let rows: Vec<[f64; 8]> = self.points.iter().map(|p| basis.row(p.x, p.y, p.gradient)).collect();
        let mut left = vec![0.0f32; self.points.len()];
        let mut weights = vec![0.0f32; self.points.len()];
        let mut found = None;
        for _ in 0..MOST_STEPS {
            residuals(&h, &mut left);
            let noise = spread(self.points, &left)?;
            normal_equations::weights(self.points, &left, noise, &mut weights);
            let (data, mut b) = normal_equations::equations(basis.parameters(), &rows, &left, &weights);
            let mut a = data.clone();
            basis.add_prior(&h, NOISE_FACTOR, &mut a, &mut b);
            let step = basis.solve(a.clone(), b)?;
            h *= basis.matrix(&step);
            h /= h[(2, 2)];
            let away = Transform::Homography(h).corner_distance(&Transform::Homography(start), width, height);
            // The distance of a corner that is not a number counts as 0.
            if away > MOST_MOVE || h.iter().any(|v| !v.is_finite()) {
                return None;
            }
            found = Some(a - data);
            if basis.largest_move(&step) < still {
                break;
            }
        }
        let transform = off_level(&h, self.level);
        if !self.is_last {
            return Some((transform, None));
        }
        let prior = found?;
        let block = |points: Vec<usize>| {
            let rows: Vec<[f64; 8]> = points.iter().map(|&i| rows[i]).collect();
            let left: Vec<f32> = points.iter().map(|&i| left[i]).collect();
            let weights: Vec<f32> = points.iter().map(|&i| weights[i]).collect();
            normal_equations::equations(basis.parameters(), &rows, &left, &weights)
        };
        let places = self.points.iter().map(|p| [p.x, p.y]);
        let blocks: Vec<Block> = blocks(places, self.size).into_iter().map(block).collect();
        let error = fitted_error(&basis, &blocks, &prior, NOISE_FACTOR)?;
        let error = (error * error + INTERPOLATION_BIAS * INTERPOLATION_BIAS).sqrt();
        Some((transform, Some((1u64 << self.level) as f64 * error)))
    }
}

/// Returns the robust standard deviation of the residuals, each multiplied by the precision of its point: 1.4826 times
/// the median absolute value, at least 0.5.
fn spread(points: &[Point], residuals: &[f32]) -> Option<f32> {
    let inside = points.iter().zip(residuals).filter(|(_, r)| !r.is_nan());
    let absolutes: Vec<f32> = inside.map(|(p, r)| (r * p.precision).abs()).collect();
    if absolutes.len() < LEAST_POINTS {
        return None;
    }
    median(absolutes).map(|median| (1.4826 * median).max(0.5))
}

#[cfg(test)]
mod tests;
