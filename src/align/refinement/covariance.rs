//! The covariance of the parameters of a refinement, estimated from the residuals themselves.
//!
//! In: the points of a level with their residuals, and the matrix A of the normal equations without and with the prior.
//! Out: the covariance. Cost: 8 multiply-adds per point. Source: the cluster-robust ("sandwich") covariance of Liang &
//! Zeger, Biometrika 73(1), 1986; for the factor that corrects it if there are few clusters, Cameron & Miller, Journal
//! of Human Resources 50(2), 2015, section VI.
//!
//! The residuals of neighbouring points are not independent. Smoothing, JPEG and aliasing correlate them. Where the
//! model does not fit, because of the tones, the lens or a thing that moved, neighbouring residuals have the same sign.
//! The score of a point is J^T g r w (J: Jacobian of its position by the parameters, g: gradient, r: residual, w:
//! weight). The right side b of the normal equations is the sum of all scores. The picture is divided into blocks, and
//! the sum s of the scores of a block counts as one observation: it adds s s^T to the variance of b.

use crate::align::refinement::frame_pair::Point;
use nalgebra::{DMatrix, DVector};

/// Number of blocks along each side of the picture. Blocks must be large, so that residuals in different blocks are
/// independent, but numerous enough for the covariance of eight parameters.
const BLOCKS: usize = 6;

/// A is computed with the weight w of Tukey's biweight, but the covariance of an M-estimate depends on psi', the
/// derivative of psi(r) = w r by the residual r (Huber, Robust Statistics, 1981, section 7.6). This constant is mean
/// psi' / mean w = 0.758 / 0.915 for normal residuals r, where w = (1 - t^2)^2 and psi' = (1 - t^2) (1 - 5 t^2) with t
/// = r / 4.685.
const CURVATURE: f64 = 0.83;

/// The points of a refinement step, with the factors of their scores.
pub(super) struct Scores<'a> {
    pub(super) points: &'a [Point],
    /// J^T g of each point.
    pub(super) rows: &'a [[f64; 8]],
    /// Frame minus reference at each point; NaN outside the frame.
    pub(super) residuals: &'a [f32],
    /// The weight w of each point.
    pub(super) weights: &'a [f32],
    /// Width and height of the level, in pixels.
    pub(super) size: (usize, usize),
}

impl Scores<'_> {
    /// Returns the covariance of the parameters; none where it is not determined.
    ///
    /// `data` is the matrix A of the points alone. `whole` is A + P. The matrix P is `factor`^2 times the matrix of the
    /// prior (see [`add_prior`](crate::align::transform::Increment::add_prior)). Let S be the covariance of the block
    /// scores, and D = [`CURVATURE`] A + P the derivative of the scores by the parameters. The result is D^-1 (S + A +
    /// `factor`^2 P) D^-1. Here P is multiplied by `factor`^2 once more, because it is a variance: scaling the scores
    /// of the prior by `factor`^2 scales their variance by `factor`^4. A is the variance of independent noise. It is
    /// added so that the result is not too small if few blocks have detail.
    pub(super) fn covariance(&self, data: &DMatrix<f64>, whole: &DMatrix<f64>, factor: f64) -> Option<DMatrix<f64>> {
        let prior = whole - data;
        let inverse = (data * CURVATURE + &prior).cholesky()?.inverse();
        let variance = self.blocks(data.nrows()) + data + prior * (factor * factor);
        Some(&inverse * variance * &inverse)
    }

    /// Returns the sum of s s^T over the blocks, where s is the score of a block, times B / (B - n) for B blocks and
    /// `n` parameters. The factor is needed because the parameters were fitted to the same residuals.
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

    /// Computes the covariance of two parameters. The points form groups of `alike` successive points; all points of a
    /// group have the same derivatives and the same residual. Returns the covariance divided by the covariance for
    /// independent noise.
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
        // The expected variance has two parts: `alike` times that of independent noise, from the blocks, and once that
        // of independent noise, which is always added. Both are divided by the square of the curvature. The part from
        // the blocks is a sum of 72 squares (36 blocks, two parameters), so its standard error is sqrt(2 / 72) = 17 %
        // of `alike`; the curvature increases this to 24 %. The limit of 70 % is almost three standard errors.
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
