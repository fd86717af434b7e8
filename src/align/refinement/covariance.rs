//! The covariance of the parameters of a refinement, from the residuals themselves.
//!
//! In: the points of a level with their residuals, the matrix A of the normal equations, and the prior. Out: the
//! covariance. Cost: 8 multiply-adds per point. Source: the cluster-robust ("sandwich") covariance of Liang & Zeger,
//! Biometrika 73(1), 1986, and its factor for few clusters, Cameron & Miller, Journal of Human Resources 50(2), 2015,
//! section VI.
//!
//! The residuals of neighbouring points are not independent: smoothing, JPEG and aliasing correlate them, and where the
//! tones, a lens or a thing that moved do not fit, they have the same sign. Let J^T g r w be the score of a point (J:
//! Jacobian of its position, g: gradient, r: residual, w: weight); b, the right side of the normal equations, is the
//! sum of all scores. The sum s of the scores of a block of the picture is taken as one observation, which adds s s^T
//! to the variance of b.

use crate::align::refinement::frame_pair::Point;
use nalgebra::{DMatrix, DVector};

/// Blocks along each side of the picture: few enough that residuals in different blocks are independent, and enough
/// for a covariance of eight parameters.
const BLOCKS: usize = 6;

/// Derivative of Tukey's score by the residual, as a share of the weight by which it enters A: 0.758 / 0.915, the means
/// of psi' = (1 - t^2) (1 - 5 t^2) and of w = (1 - t^2)^2 with t = r / 4.685 for normal residuals r. (Huber, Robust
/// Statistics, 1981, section 7.6: the covariance of an M-estimate depends on psi', not on w.)
const CURVATURE: f64 = 0.83;

/// The points of a refinement step.
pub(super) struct Scores<'a> {
    pub(super) points: &'a [Point],
    /// J^T g of each point.
    pub(super) rows: &'a [[f64; 8]],
    /// Frame minus reference; NaN outside the frame.
    pub(super) residuals: &'a [f32],
    /// The weight w of each point.
    pub(super) weights: &'a [f32],
    /// Width and height of the level, in pixels.
    pub(super) size: (usize, usize),
}

impl Scores<'_> {
    /// Returns the covariance of the parameters; none where it is not determined.
    ///
    /// `data` is A of the points alone, `whole` is A with the prior P, which counts `factor`^2 times
    /// ([`add_prior`](crate::align::transform::Increment::add_prior)). With the covariance S of the scores and the
    /// derivative D of the scores, which is [`CURVATURE`] A + P, the result is D^-1 (S + A + `factor`^2 P) D^-1. A is
    /// the variance of independent noise, a lower bound where few blocks have detail.
    pub(super) fn covariance(&self, data: &DMatrix<f64>, whole: &DMatrix<f64>, factor: f64) -> Option<DMatrix<f64>> {
        let prior = whole - data;
        let inverse = (data * CURVATURE + &prior).cholesky()?.inverse();
        let variance = self.blocks(data.nrows()) + data + prior * (factor * factor);
        Some(&inverse * variance * &inverse)
    }

    /// The sum, over the blocks, of the squares of their scores, times B / (B - n) for B blocks and `n` parameters:
    /// the parameters were fitted to these residuals.
    fn blocks(&self, n: usize) -> DMatrix<f64> {
        let (width, height) = self.size;
        let mut scores: Vec<Option<DVector<f64>>> = vec![None; BLOCKS * BLOCKS];
        let seen = self.points.iter().zip(self.rows).zip(self.residuals.iter().zip(self.weights));
        for ((point, row), (r, w)) in seen.filter(|(_, (r, _))| !r.is_nan()) {
            let block = point.y as usize * BLOCKS / height * BLOCKS + point.x as usize * BLOCKS / width;
            let score = scores[block].get_or_insert_with(|| DVector::zeros(n));
            let weighted = f64::from(*w) * f64::from(*r);
            score.iter_mut().zip(row).for_each(|(sum, j)| *sum += weighted * j);
        }
        let mut sum = DMatrix::zeros(n, n);
        let mut count = 0.0;
        for score in scores.iter().flatten() {
            sum += score * score.transpose();
            count += 1.0;
        }
        sum * (count / f64::max(count - n as f64, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::random;

    /// The ratio of the covariance of two parameters to that of independent noise, where `alike` points in a row share
    /// their derivatives and their residual.
    fn excess(alike: usize) -> f64 {
        const SIDE: usize = 120;
        let uniform = |i: usize, draw: u64| random(draw, i as u64, 0) as f64 / u64::MAX as f64 - 0.5;
        let points: Vec<Point> = (0..SIDE * SIDE)
            .map(|i| {
                let (x, y) = ((i % SIDE) as f64, (i / SIDE) as f64);
                Point { x, y, value: 0.0, gradient: [0.0; 2], precision: 1.0 }
            })
            .collect();
        // A uniform distribution of width sqrt(12) has the variance 1.
        let residuals: Vec<f32> = (0..points.len()).map(|i| (12f64.sqrt() * uniform(i / alike, 1)) as f32).collect();
        let rows: Vec<[f64; 8]> = (0..points.len())
            .map(|i| [uniform(i / alike, 2), uniform(i / alike, 3), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            .collect();
        let weights = vec![1.0; points.len()];
        let mut data = DMatrix::zeros(2, 2);
        for row in &rows {
            data += DVector::from_row_slice(&row[..2]) * DVector::from_row_slice(&row[..2]).transpose();
        }
        let scores =
            Scores { points: &points, rows: &rows, residuals: &residuals, weights: &weights, size: (SIDE, SIDE) };
        let covariance = scores.covariance(&data, &data, 1.0).unwrap();
        (covariance * data).trace() / 2.0
    }

    #[test]
    fn correlated_residuals_add_as_much_variance_as_they_cause() {
        // The variance of independent noise counts in addition. The square sums of 36 blocks for two parameters have a
        // standard error of sqrt(2 / 72) = 17 % of the first part, which the curvature increases to 24 %.
        for alike in [1, 4, 10] {
            let expected = (alike as f64 + 1.0) / (CURVATURE * CURVATURE);
            assert!((excess(alike) - expected).abs() < 0.7 * alike as f64, "{alike}: {} for {expected}", excess(alike));
        }
    }

    #[test]
    fn matrix_without_inverse_has_no_covariance() {
        let none: Scores = Scores { points: &[], rows: &[], residuals: &[], weights: &[], size: (9, 9) };
        assert_eq!(none.covariance(&DMatrix::zeros(2, 2), &DMatrix::zeros(2, 2), 1.0), None);
    }
}
