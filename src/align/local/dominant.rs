//! The dominant motion: the homography that fits the largest part of a picture in which parts move differently.
//!
//! In: the cells of a [`LocalField`](super::LocalField), that is, displacements from a transform. Out: the homography
//! within a pixel of most of the cells, or none if the transform is nearly as good. Cost: 200 trials of 8 x 8 equations
//! and 48 refinements, each on up to 1500 cells: some 30 ms. Source: Fischler & Bolles, CACM 24(6), 1981 (random
//! samples, scored by the number of inliers); Chum, Matas & Kittler, DAGM 2003 (the best samples are refined).
//!
//! Refinement minimises the difference of the pixels. Where parts of the picture move differently by a few pixels, its
//! result is a compromise that fits none of them, and it fits the part with the strongest contrast best. Here, all
//! cells whose displacement is more precise than the tolerance have nearly equal weights, whatever their contrast. A
//! less precise cell has a smaller weight, and a cell that moves differently has none.

use crate::align::local::cell::{Cell, square};
use crate::align::transform::{Increment, Model};
use crate::statistics::{TUKEY, biweight, random};
use nalgebra::{DMatrix, DVector, Matrix3};
use std::cmp::Reverse;

/// Tolerances that are tried in the refinement; the result that most cells fit is used. Each is the standard deviation,
/// along an axis, of the displacements that a homography leaves, in pixels of the full size. A cell displaced by
/// [`TUKEY`] times the tolerance (0.9, 1.6 and 2.8 px) or more has no weight. The smallest tolerance makes the
/// homography follow one of several planes, the largest a curved surface as a whole.
const TOLERANCES_PX: [f64; 3] = [0.2, 0.35, 0.6];
/// Displacement up to which a cell fits, in pixels of the full size: no double edge is visible.
const FITS_PX: f64 = 1.0;
/// Number of random samples. If half of the cells have the dominant motion, about twelve samples consist of such cells
/// only.
const TRIALS: u64 = 200;
/// Number of starts that are refined: the best among the motions of the samples and the present transform.
const SETTLED: usize = 16;
/// Number of cells of a sample: four determine a homography.
const SAMPLE: usize = 4;
/// Largest number of cells that a sample is compared with.
const COMPARED: usize = 1500;
/// Numbers of steps of reweighted least squares: in the refinement of each start, and at the end on all cells.
const STEPS: (usize, usize) = (5, 10);
/// Length over which displacements are alike, in cells. A square of cells with this side counts as one observation for
/// the prior and for the error estimate.
const ALIKE_CELLS: f64 = 6.0;
/// A result must increase the number of cells that fit by at least this share of all cells.
const LEAST_GAIN: f64 = 0.01;

/// A homography that fits more of a picture than the present transform. All lengths are in pixels of the level.
pub(super) struct Dominant {
    /// Reference pixel -> frame pixel.
    pub(super) h: Matrix3<f64>,
    /// Expected root mean square error over the whole picture, including the parts without known cells.
    pub(super) error: f64,
}

/// Returns the homography that fits most of `cells`, whose displacements are relative to the transform `h`; none if `h`
/// fits nearly as many.
///
/// `size` is that of the level, `scale` the length of its pixels in pixels of the full size, and `overlap` the number
/// of cells that each pixel counts in.
pub(super) fn search(
    cells: &[Cell],
    h: &Matrix3<f64>,
    size: (usize, usize),
    scale: f64,
    overlap: f64,
) -> Option<Dominant> {
    let fit = Fit { basis: Increment::new(Model::Homography, size.0, size.1), h, factor: ALIKE_CELLS * overlap.sqrt() };
    let sparse: Vec<Cell> = cells.iter().step_by(cells.len().div_ceil(COMPARED)).copied().collect();
    let (checked, still) = (fit.observations(&sparse, FITS_PX / scale), DVector::zeros(fit.basis.parameters()));
    let mut starts: Vec<DVector<f64>> = (0..TRIALS)
        .filter_map(|trial| Some(fit.solve(&drawn(&checked, trial), |_| 1.0, &still, 1.0)?.0))
        .chain([still.clone()])
        .collect();
    starts.sort_by_cached_key(|step| Reverse(fitting(&checked, step)));
    starts.truncate(SETTLED);
    let settled = TOLERANCES_PX.iter().flat_map(|tolerance| {
        let observations = fit.observations(&sparse, tolerance / scale);
        let settle = |start: &DVector<f64>| Some((fit.settle(&observations, start.clone(), STEPS.0)?.0, *tolerance));
        starts.iter().filter_map(settle).collect::<Vec<_>>()
    });
    let (best, tolerance) = settled
        .map(|(step, tolerance)| (fitting(&checked, &step), (step, tolerance)))
        .reduce(|best, other| if other.0 > best.0 { other } else { best })?
        .1;
    let (step, normal) = fit.settle(&fit.observations(cells, tolerance / scale), best, STEPS.1)?;
    let checked = fit.observations(cells, FITS_PX / scale);
    let gain = fitting(&checked, &step) as f64 - fitting(&checked, &still) as f64;
    if gain < LEAST_GAIN * cells.len() as f64 {
        return None;
    }
    let moved = h * fit.basis.matrix(&step);
    let error = fit.factor * fit.basis.expected_error(&normal.cholesky()?.inverse());
    Some(Dominant { h: moved / moved[(2, 2)], error })
}

/// A cell as an observation of the motion.
#[derive(Debug, Clone, Copy)]
struct Observation {
    /// Derivatives of the position by the parameters of the motion.
    jacobian: [[f64; 2]; 8],
    displacement: [f64; 2],
    /// Inverse of the covariance [xx, xy, yy] of the displacement, to which the square of the tolerance was added.
    precision: [f64; 3],
}

impl Observation {
    fn new(cell: &Cell, basis: &Increment, tolerance: f64) -> Self {
        let [x, y] = cell.centre;
        // The covariance is S^-1 + t^2 I; its inverse is (S + t^2 det(S) I) / (1 + t^2 tr(S) + t^4 det(S)).
        let [xx, xy, yy] = cell.precision;
        let (t2, det) = (tolerance * tolerance, (xx * yy - xy * xy).max(0.0));
        let below = 1.0 + t2 * (xx + yy) + t2 * t2 * det;
        let precision = [(xx + t2 * det) / below, xy / below, (yy + t2 * det) / below];
        Observation { jacobian: basis.jacobian(x, y), displacement: cell.displacement, precision }
    }

    /// The length of the residual displacement after the motion `step`, in standard deviations.
    fn off(&self, step: &DVector<f64>) -> f64 {
        let [mut x, mut y] = self.displacement;
        for (s, j) in step.iter().zip(&self.jacobian) {
            x -= s * j[0];
            y -= s * j[1];
        }
        square(self.precision, [x, y]).max(0.0).sqrt()
    }
}

/// Returns the number of `observations` that differ from the motion `step` by less than a standard deviation. If their
/// tolerance is [`FITS_PX`], these are the cells that fit.
fn fitting(observations: &[Observation], step: &DVector<f64>) -> usize {
    observations.iter().filter(|o| o.off(step) < 1.0).count()
}

/// The observations of sample `trial`.
fn drawn(all: &[Observation], trial: u64) -> Vec<Observation> {
    let index = |draw: usize| (random(0, trial, draw as u64) % all.len() as u64) as usize;
    (0..SAMPLE).map(|draw| all[index(draw)]).collect()
}

/// The least squares problem of the motion's parameters.
struct Fit<'a> {
    basis: Increment,
    h: &'a Matrix3<f64>,
    /// Ratio of the standard error to that of independent observations.
    factor: f64,
}

impl Fit<'_> {
    /// The observations of `cells`, with a tolerance in pixels of the level.
    fn observations(&self, cells: &[Cell], tolerance: f64) -> Vec<Observation> {
        cells.iter().map(|cell| Observation::new(cell, &self.basis, tolerance)).collect()
    }

    /// Repeats [`Fit::solve`] with Tukey's weights.
    fn settle(
        &self,
        observations: &[Observation],
        start: DVector<f64>,
        steps: usize,
    ) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let mut found = (start, DMatrix::identity(0, 0));
        for _ in 0..steps {
            let weight = |o: &Observation| biweight(o.off(&found.0) / TUKEY);
            found = self.solve(observations, weight, &found.0, self.factor)?;
        }
        Some(found)
    }

    /// The motion with the least weighted residuals, and the matrix of its normal equations.
    ///
    /// The prior is that of the transform after the motion `at`, and `factor` the ratio of the standard error to that
    /// of independent observations.
    fn solve(
        &self,
        observations: &[Observation],
        weight: impl Fn(&Observation) -> f64,
        at: &DVector<f64>,
        factor: f64,
    ) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let n = self.basis.parameters();
        let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for o in observations {
            let weight = weight(o);
            if weight == 0.0 {
                continue;
            }
            let [xx, xy, yy] = o.precision.map(|p| weight * p);
            let [x, y] = o.displacement;
            let pull = [xx * x + xy * y, xy * x + yy * y];
            for p in 0..n {
                let [jx, jy] = o.jacobian[p];
                b[p] -= jx * pull[0] + jy * pull[1];
                let along = [xx * jx + xy * jy, xy * jx + yy * jy];
                for q in 0..=p {
                    a[(p, q)] += o.jacobian[q][0] * along[0] + o.jacobian[q][1] * along[1];
                }
            }
        }
        for p in 0..n {
            for q in 0..p {
                a[(q, p)] = a[(p, q)];
            }
        }
        // The prior depends on the change from `at`. For the motion from zero, its vector b is the one at `at` minus
        // its matrix A times `at`.
        let (mut prior_a, mut prior_b) = (DMatrix::zeros(n, n), DVector::zeros(n));
        self.basis.add_prior(&(self.h * self.basis.matrix(at)), factor, &mut prior_a, &mut prior_b);
        b += prior_b - &prior_a * at;
        a += prior_a;
        Some((self.basis.solve(a.clone(), b)?, a))
    }
}
