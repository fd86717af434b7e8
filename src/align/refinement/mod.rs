//! Refinement: iterative photometric alignment, from about a pixel to the noise limit.
//!
//! In: a [`FramePair`] and an approximate transform. Out: the transform of a chosen model under which the pixels of
//! both agree best, and how well the pixels determine it. Cost: two planes at a common exposure for each level up to
//! [`measured_level`], then some 16,000 patches of the finest level; 0.1 us a point and step. Source: Baker & Matthews,
//! "Lucas-Kanade 20 Years On", IJCV 56(3), 2004, section 2.2 (compositional updates); Tukey's biweight.

mod fine_level;
mod frame_pair;
mod normal_equations;
mod patch;

pub use frame_pair::FramePair;

use crate::align::grey::{finest_level, measured_level};
use crate::align::refinement::frame_pair::Point;
use crate::align::refinement::patch::Patches;
use crate::align::resampling::cubic::cubic;
use crate::align::transform::{Increment, Model, Transform, map, off_level, on_level, restrict, to_transform};
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use nalgebra::{DMatrix, Matrix3};
use rayon::prelude::*;

/// Steps at each level, at the most.
const MOST_STEPS: usize = 12;
/// A step that moves no corner by more than this ends the level, in pixels of the level: the finest, and those that
/// only lead to it.
const STILL: (f64, f64) = (0.005, 0.05);
/// Fewest points for a solution.
const LEAST_POINTS: usize = 50;
/// The noise of neighbouring pixels is not independent (smoothing, JPEG, aliasing): what is left is so many times what
/// it would leave if it were. Measured on rendered brackets.
const NOISE_FACTOR: f64 = 4.0;
/// A refined transform and how well the pixels determine it. All lengths are in pixels of level 0.
#[derive(Debug, Clone)]
pub struct Refined {
    /// Reference pixel -> frame pixel, of the requested model.
    pub transform: Transform,
    /// Root mean square error over the picture that noise leaves, in pixels.
    pub error_px: f64,
}

/// Refines `start` level by level from `coarsest` to `finest` (0 the largest), as a transform of `model`. Of the levels
/// larger than [`measured_level`] only [`finest_level`] is used, in patches, if `finest` is below it.
///
/// None where the overlap holds too little to go by, or the steps run away.
pub fn refine(pair: &FramePair, start: &Transform, model: Model, levels: (usize, usize)) -> Option<Refined> {
    let (coarsest, finest) = levels;
    let (width, height) = pair.size();
    let measured = measured_level(pair.reference()).max(finest);
    let mut state = restrict(&start.matrix(width, height), model, width, height);
    let mut last = None;
    for level in (measured..=coarsest.min(pair.reference().len() - 1)).rev() {
        let whole = pair.level(level);
        let residuals = |h: &Matrix3<f64>, out: &mut [f32]| {
            let pieces = whole.points.par_chunks(PIECE).zip(out.par_chunks_mut(PIECE));
            pieces.for_each(|(points, out)| vectorised(Residuals { points, h, frame: &whole.both.frame, out }));
        };
        let stage = Stage::new(pair, level, level == finest, &whole.points)?;
        let (h, error_px) = stage.solve(state, model, residuals)?;
        (state, last) = (h, Some(error_px));
    }
    if finest < measured {
        let points = fine_level::points(pair);
        let mut seen = pair.patches(|| Patches::unread(points.len()));
        let residuals = |h: &Matrix3<f64>, out: &mut [f32]| fine_level::residuals(pair, &mut seen, h, out);
        let stage = Stage::new(pair, finest_level(pair.reference()), true, points)?;
        let solved = stage.solve(state, model, residuals);
        pair.keep_patches(seen);
        let (h, error_px) = solved?;
        (state, last) = (h, Some(error_px));
    }
    Some(Refined { transform: to_transform(&state, model, width, height), error_px: last? })
}

/// Points that are looked at together, by one thread.
const PIECE: usize = 1024;

/// On a level that is there as a whole: the frame's level less the reference's at some of the points.
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

/// One level: the points, and what is small there.
struct Stage<'a> {
    points: &'a [Point],
    level: usize,
    size: (usize, usize),
    still: f64,
}

impl<'a> Stage<'a> {
    fn new(pair: &FramePair, level: usize, is_last: bool, points: &'a [Point]) -> Option<Self> {
        let plane = pair.reference().level(level);
        let still = if is_last { STILL.0 } else { STILL.1 };
        (points.len() >= LEAST_POINTS).then_some(Stage { points, level, size: (plane.width(), plane.height()), still })
    }

    /// Steps of Gauss and Newton with Tukey's weights until no corner moves. `residuals` gives the frame's level less
    /// the reference's at every point under a transform; not a number where the frame does not reach. Gives the
    /// transform, and [`Refined::error_px`].
    fn solve(
        &self,
        h_full: Matrix3<f64>,
        model: Model,
        mut residuals: impl FnMut(&Matrix3<f64>, &mut [f32]),
    ) -> Option<(Matrix3<f64>, f64)> {
        let (width, height) = self.size;
        let mut h = on_level(&h_full, self.level);
        let basis = Increment::new(model, width, height);
        let rows: Vec<[f64; 8]> = self.points.iter().map(|p| basis.row(p.x, p.y, p.gradient)).collect();
        let mut left = vec![0.0f32; self.points.len()];
        let mut normal = DMatrix::zeros(basis.parameters(), basis.parameters());
        for _ in 0..MOST_STEPS {
            residuals(&h, &mut left);
            let noise = spread(self.points, &left)?;
            let (mut a, mut b) = normal_equations::equations(basis.parameters(), self.points, &rows, &left, noise);
            basis.add_prior(&h, NOISE_FACTOR, &mut a, &mut b);
            normal = a.clone();
            let step = basis.solve(a, b)?;
            h *= basis.matrix(&step);
            h /= h[(2, 2)];
            let moved = basis.largest_move(&step);
            if !moved.is_finite() || moved > width as f64 {
                return None;
            }
            if moved < self.still {
                break;
            }
        }
        let error_px = NOISE_FACTOR * (1u64 << self.level) as f64 * basis.expected_error(&normal)?;
        Some((off_level(&h, self.level), error_px))
    }
}

/// The robust standard deviation of the weighted residuals: 1.4826 times the median of their absolutes, at least half a
/// grey value.
fn spread(points: &[Point], residuals: &[f32]) -> Option<f32> {
    // The bits of parameters that are not negative are ordered as they are.
    let seen = points.iter().zip(residuals).filter(|(_, r)| !r.is_nan());
    let mut absolutes: Vec<u32> = seen.map(|(p, r)| (r * p.precision).abs().to_bits()).collect();
    if absolutes.len() < LEAST_POINTS {
        return None;
    }
    let middle = absolutes.len() / 2;
    let (_, median, _) = absolutes.select_nth_unstable(middle);
    Some((1.4826 * f32::from_bits(*median)).max(0.5))
}

#[cfg(test)]
mod tests;
