//! The dominant motion: if the parts of a picture move differently, the homography that fits the largest part.
//!
//! In: the cells of a [`LocalField`](super::LocalField), that is, displacements from a given transform. Out: the
//! homography that fits the largest part of the picture to within a pixel, or none if the given transform fits nearly
//! as much. Cost: 200 trials, each of which solves 8 x 8 equations, and 32 refinements, each on up to 1500 cells: some
//! 30 ms. Source: Fischler & Bolles, CACM 24(6), 1981 (random samples, scored by how well they fit); Torr & Zisserman,
//! CVIU 78(1), 2000 (a better fit counts more); Chum, Matas & Kittler, DAGM 2003 (the best samples are refined).
//!
//! The refinement on the pixels minimises the difference of the pixels. If the motions of the parts of a picture differ
//! by a few pixels, its result is a compromise. It fits no part exactly, and fits the part with the strongest contrast
//! best. Here, in contrast, each cell whose displacement is more precise than the tolerance has nearly the same weight
//! for each pixel of its area, whatever its contrast. A less precise cell has a smaller weight, and a cell that moves
//! differently has the weight 0.

use crate::align::local::cell::{Cell, square};
use crate::align::transform::{Block, Increment, Model, blocks, fitted_error};
use crate::statistics::{TUKEY, biweight, random};
use nalgebra::{DMatrix, DVector, Matrix3};

/// Tolerances that are tried in the refinement of the homography; the result that fits the largest area is used. A
/// tolerance is the assumed standard deviation, along an axis, of the displacements of the cells from the homography,
/// in pixels of the full size. A precise cell that is displaced by [`TUKEY`] times the tolerance (0.9 and 2.8 px) or
/// more has no weight. With the smaller tolerance, the homography fits one of several planes; with the larger, it fits
/// a curved surface as a whole.
const TOLERANCES_PX: [f64; 2] = [0.2, 0.6];
/// A cell fits a homography if it is displaced from it by less than this (more, if its displacement is imprecise), in
/// pixels of the full size. Up to this displacement, no double edge is visible.
const FITS_PX: f64 = 1.0;
/// Number of random samples of four cells. If half of the cells have the dominant motion, about twelve samples (200 /
/// 2^4) consist of such cells only.
const TRIALS: u64 = 200;
/// Number of motions that are refined: the best of a list of the motions of all samples, and of no motion (the given
/// transform itself).
const SETTLED: usize = 16;
/// Number of cells of a sample: four points determine a homography.
const SAMPLE: usize = 4;
/// Largest number of cells on which the motions of the samples are compared and refined.
const COMPARED: usize = 1500;
/// Numbers of steps of reweighted least squares: (in the refinement of each motion, at the end on all cells).
const STEPS: (usize, usize) = (5, 10);
/// Actual standard error, divided by the one that would result if all cells were independent. Patches overlap, and
/// neighbouring cells are displaced alike. Measured on rendered brackets.
const CORRELATION_FACTOR: f64 = 4.0;
/// A homography is used only if it fits more of the picture than the given transform, by at least this share of the
/// area of all cells.
const LEAST_GAIN: f64 = 0.01;

/// A homography that fits more of a picture than the given transform. All lengths are in pixels of the level.
pub(super) struct Dominant {
    /// Reference pixel -> frame pixel.
    pub(super) h: Matrix3<f64>,
    /// Expected root mean square error over the whole picture, including the parts whose displacement is not known.
    pub(super) error: f64,
}

/// Returns the homography that fits the largest part of the picture; none if `h` fits nearly as much. The displacements
/// in `cells` are measured from the positions that `h` gives.
///
/// `size` is the size of the level in pixels, and `scale` the side of one of its pixels in pixels of the full size.
pub(super) fn search(cells: &[Cell], h: &Matrix3<f64>, size: (usize, usize), scale: f64) -> Option<Dominant> {
    let fit = Fit { basis: Increment::new(Model::Homography, size.0, size.1), h };
    let sparse: Vec<Cell> = cells.iter().step_by(cells.len().div_ceil(COMPARED)).copied().collect();
    let (checked, still) = (fit.observations(&sparse, FITS_PX / scale), DVector::zeros(fit.basis.parameters()));
    let mut starts: Vec<(f64, DVector<f64>)> = (0..TRIALS)
        .filter_map(|trial| fit.through(&drawn(&checked, trial)))
        .chain([still.clone()])
        .map(|step| (fitting(&checked, &step), step))
        .collect();
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    starts.truncate(SETTLED);
    let settled = TOLERANCES_PX.iter().flat_map(|tolerance| {
        let observations = fit.observations(&sparse, tolerance / scale);
        let settle = |(_, start): &(f64, DVector<f64>)| {
            let step = fit.settle(&observations, start.clone(), STEPS.0)?;
            Some((fitting(&checked, &step), step, tolerance))
        };
        starts.iter().filter_map(settle).collect::<Vec<_>>()
    });
    let (_, best, tolerance) = settled.reduce(|best, other| if other.0 > best.0 { other } else { best })?;
    let observations = fit.observations(cells, tolerance / scale);
    let step = fit.settle(&observations, best, STEPS.1)?;
    let checked = fit.observations(cells, FITS_PX / scale);
    let gain = fitting(&checked, &step) - fitting(&checked, &still);
    if gain < LEAST_GAIN * cells.len() as f64 {
        return None;
    }
    let moved = h * fit.basis.matrix(&step);
    Some(Dominant { h: moved / moved[(2, 2)], error: fit.error(&observations, cells, &step, size)? })
}

/// A cell as an observation of the motion.
#[derive(Debug, Clone, Copy)]
struct Observation {
    /// For each parameter of the motion, the derivatives (x, y) of the position by it.
    jacobian: [[f64; 2]; 8],
    displacement: [f64; 2],
    /// The part of the picture that the cell stands for; see [`Cell::area`].
    area: f64,
    /// Inverse covariance [xx, xy, yy] of the displacement. The square of the tolerance was added to the covariance,
    /// along both axes, before it was inverted.
    precision: [f64; 3],
}

impl Observation {
    fn new(cell: &Cell, basis: &Increment, tolerance: f64) -> Self {
        let [x, y] = cell.centre;
        // With the precision S of the cell and the tolerance t, the covariance is S^-1 + t^2 I. Its inverse is (S + t^2
        // det(S) I) / (1 + t^2 tr(S) + t^4 det(S)).
        let [xx, xy, yy] = cell.precision;
        let (t2, det) = (tolerance * tolerance, (xx * yy - xy * xy).max(0.0));
        let below = 1.0 + t2 * (xx + yy) + t2 * t2 * det;
        let precision = [(xx + t2 * det) / below, xy / below, (yy + t2 * det) / below];
        Observation { jacobian: basis.jacobian(x, y), displacement: cell.displacement, area: cell.area, precision }
    }

    /// The length of the displacement that remains after the motion with the parameters `step`, in standard deviations.
    fn off(&self, step: &DVector<f64>) -> f64 {
        let [mut x, mut y] = self.displacement;
        for (s, j) in step.iter().zip(&self.jacobian) {
            x -= s * j[0];
            y -= s * j[1];
        }
        square(self.precision, [x, y]).max(0.0).sqrt()
    }
}

/// Returns the area of the `observations` that fit the motion with the parameters `step`.
///
/// Let t be the distance of an observation from this motion, in standard deviations. If t is less than 1, the
/// observation counts with its area times 1 - t^4; otherwise it does not count. If the observations were made with the
/// tolerance [`FITS_PX`], the result is nearly the area of the cells that fit. If two motions fit the same cells, the
/// motion that fits them better usually has the larger result.
fn fitting(observations: &[Observation], step: &DVector<f64>) -> f64 {
    let part = |o: &Observation| {
        let t = o.off(step);
        o.area * (1.0 - t * t * t * t).max(0.0)
    };
    observations.iter().map(part).sum()
}

/// Returns the random sample of number `trial`: [`SAMPLE`] observations, always the same for the same number.
fn drawn(all: &[Observation], trial: u64) -> Vec<Observation> {
    let index = |draw: usize| (random(0, trial, draw as u64) % all.len() as u64) as usize;
    (0..SAMPLE).map(|draw| all[index(draw)]).collect()
}

/// Tukey's weight of an observation after the motion with the parameters `step`.
fn weight(observation: &Observation, step: &DVector<f64>) -> f64 {
    biweight(observation.off(step) / TUKEY)
}

/// The least squares problem whose unknowns are the parameters of the motion.
struct Fit<'a> {
    basis: Increment,
    h: &'a Matrix3<f64>,
}

impl Fit<'_> {
    /// The observations of `cells`, with a tolerance in pixels of the level.
    fn observations(&self, cells: &[Cell], tolerance: f64) -> Vec<Observation> {
        cells.iter().map(|cell| Observation::new(cell, &self.basis, tolerance)).collect()
    }

    /// Returns the motion that four observations determine. The prior decides what they leave open.
    fn through(&self, sample: &[Observation]) -> Option<DVector<f64>> {
        self.solve(sample.iter().map(|o| (o, 1.0)), &DVector::zeros(self.basis.parameters()), 1.0)
    }

    /// Repeats [`Fit::solve`], each time with Tukey's weights for the residuals of the previous solution.
    fn settle(&self, observations: &[Observation], start: DVector<f64>, steps: usize) -> Option<DVector<f64>> {
        (0..steps).try_fold(start, |step, _| {
            self.solve(observations.iter().map(|o| (o, weight(o, &step))), &step, CORRELATION_FACTOR)
        })
    }

    /// Returns the parameters of the motion with the least sum of weighted squared residuals.
    ///
    /// The prior is linearised at the motion with the parameters `at`. `factor` is the actual standard error, divided
    /// by that of independent observations.
    fn solve<'o>(
        &self,
        weighted: impl Iterator<Item = (&'o Observation, f64)>,
        at: &DVector<f64>,
        factor: f64,
    ) -> Option<DVector<f64>> {
        let ((a, b), (prior, pull)) = (self.equations(weighted), self.prior(at, factor));
        self.basis.solve(a + prior, b + pull)
    }

    /// Returns the matrix A and the vector b of the normal equations A d = -b of weighted observations, without the
    /// prior.
    fn equations<'o>(&self, weighted: impl Iterator<Item = (&'o Observation, f64)>) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.basis.parameters();
        let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (o, weight) in weighted.filter(|(_, weight)| *weight > 0.0) {
            let [xx, xy, yy] = o.precision.map(|p| o.area * weight * p);
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
        (a, b)
    }

    /// Returns the part of the prior in the normal equations. `add_prior` gives equations for the change from `at`.
    /// Here the unknown is the whole motion, so the matrix times `at` is subtracted from the vector.
    fn prior(&self, at: &DVector<f64>, factor: f64) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.basis.parameters();
        let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
        self.basis.add_prior(&(self.h * self.basis.matrix(at)), factor, &mut a, &mut b);
        b -= &a * at;
        (a, b)
    }

    /// Returns the expected root mean square error of a motion over the picture, in pixels of the level.
    ///
    /// `step` has the parameters of the motion. The motion was fitted to `observations`, which were made from `cells`.
    fn error(
        &self,
        observations: &[Observation],
        cells: &[Cell],
        step: &DVector<f64>,
        size: (usize, usize),
    ) -> Option<f64> {
        let block = |indices: Vec<usize>| {
            let (a, b) = self.equations(indices.iter().map(|&i| (&observations[i], weight(&observations[i], step))));
            let score = &a * step + b;
            (a, score)
        };
        let scores: Vec<Block> = blocks(cells.iter().map(|cell| cell.centre), size).into_iter().map(block).collect();
        let prior = self.prior(step, CORRELATION_FACTOR).0;
        fitted_error(&self.basis, &scores, &prior, CORRELATION_FACTOR)
    }
}
