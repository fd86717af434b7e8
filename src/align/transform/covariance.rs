//! The error of an [`Increment`] that was fitted to observations, estimated from the residuals themselves.
//!
//! In: for each block of the picture, its part of the normal equations; a prior. Out: the expected error over the
//! picture, or none if the observations and the prior do not determine the parameters. Cost: the solution of a small
//! system of equations per block. Source: the jackknife that leaves out one group of observations at a time (Efron &
//! Tibshirani, An Introduction to the Bootstrap, 1993, chapter 11; for regression, Cameron & Miller, Journal of Human
//! Resources 50(2), 2015, section VI).
//!
//! The residuals of neighbouring points are not independent. Smoothing, JPEG and aliasing correlate them. Where the
//! model does not fit, because of the tones, the lens or a thing that moved, neighbouring residuals have the same sign.
//! Therefore the picture is divided into blocks. Each block is left out in turn, and the parameters that follow from
//! the other blocks are computed. The scatter of these parameters is the measure of their error.
//!
//! If the lens or the shutter distorts the frame, residuals have the same sign in even larger parts of the picture. So
//! the error is estimated from larger blocks, too, and the larger of the two errors counts.

use super::Increment;
use nalgebra::{DMatrix, DVector};

/// Number of blocks along each side of the picture; even. Blocks must be large, so that residuals in different blocks
/// are independent, but numerous enough for the covariance of eight parameters.
const BLOCKS: usize = 6;
/// The matrix A is computed with the weight w of Tukey's biweight, but the covariance of an M-estimate depends on psi',
/// the derivative of psi(r) = w r by the residual r (Huber, Robust Statistics, 1981, section 7.6). This constant is
/// mean psi' / mean w = 0.758 / 0.915 for normal residuals r, where w = (1 - t^2)^2 and psi' = (1 - t^2) (1 - 5 t^2)
/// with t = r / 4.685. For residuals in two dimensions, the quotient is 0.685 / 0.834, nearly the same.
const CURVATURE: f64 = 0.83;
/// The actual error, divided by the error that would result if the errors of different blocks were independent.
/// Measured on rendered brackets.
const BETWEEN_BLOCKS: f64 = 1.15;
/// Share of the matrix D (see [`covariance`]) that is added when a block is left out. Without it, there would be no
/// solution if no other block has any detail.
const LEAST_LEFT: f64 = 0.01;

/// The sums over the observations of a block: the matrix A = sum w J^T S J of the normal equations, and the score sum w
/// J^T S r. J is the Jacobian of the position by the parameters, S the precision of an observation, r its residual, and
/// w its weight.
pub(crate) type Block = (DMatrix<f64>, DVector<f64>);

/// Divides the observations at `places`, in pixels of a plane of `size`, into blocks. Returns the indices of the
/// observations of each block, row by row. Blocks may be empty.
pub(crate) fn blocks(places: impl Iterator<Item = [f64; 2]>, size: (usize, usize)) -> Vec<Vec<usize>> {
    let mut blocks = vec![Vec::new(); BLOCKS * BLOCKS];
    for (i, [x, y]) in places.enumerate() {
        let along = |t: f64, n: usize| (t as usize * BLOCKS / n).min(BLOCKS - 1);
        blocks[along(y, size.1) * BLOCKS + along(x, size.0)].push(i);
    }
    blocks
}

/// Returns the root mean square error over the picture that is to be expected of the parameters of `basis`, in pixels.
/// It is estimated twice, from the `blocks` and from the [`larger`] blocks; the larger estimate is returned. For the
/// arguments, see [`covariance`].
pub(crate) fn fitted_error(basis: &Increment, blocks: &[Block], prior: &DMatrix<f64>, factor: f64) -> Option<f64> {
    let error = |blocks: &[Block]| Some(basis.expected_error(&covariance(blocks, prior, factor)?));
    Some(error(blocks)?.max(error(&larger(blocks))?))
}

/// Joins each 2 x 2 blocks to a larger block.
fn larger(blocks: &[Block]) -> Vec<Block> {
    let side = BLOCKS / 2;
    let square = |i: usize| {
        let first = i / side * 2 * BLOCKS + i % side * 2;
        let four = [first, first + 1, first + BLOCKS, first + BLOCKS + 1].map(|at| &blocks[at]);
        let (mut matrix, mut score) = four[0].clone();
        for (other_matrix, other_score) in &four[1..] {
            matrix += other_matrix;
            score += other_score;
        }
        (matrix, score)
    };
    (0..side * side).map(square).collect()
}

/// Returns the covariance of the parameters. The parameters must already be fitted: the scores of all blocks and of the
/// prior add up to zero.
///
/// `prior` is the matrix P that [`add_prior`](super::Increment::add_prior) adds to the normal equations. P is the
/// inverse covariance of the prior, multiplied by `factor`^2. The derivative of the scores by the parameters is D =
/// [`CURVATURE`] A + P, where A is the sum of the matrices of all blocks. If block k, with the matrix A_k and the score
/// s_k, is left out, the scores no longer cancel, and the parameters change by d_k = (D - [`CURVATURE`] A_k)^-1 s_k.
/// (The code adds a small multiple of D to the matrix in parentheses: see [`LEAST_LEFT`].) The covariance is the sum of
/// two parts:
///
/// - from the blocks: (B - 1) / B times the sum of (d_k - m) (d_k - m)^T over the B blocks, where m is the mean of d_k;
/// - from the prior: D^-1 V D^-1, where V = `factor`^2 P is the variance of the score of the prior. Without the
///   multiplication by `factor`^2, this variance would be the inverse covariance of the prior, P / `factor`^2. The
///   multiplication makes the score `factor`^2 times as large, and so its variance `factor`^4 times as large.
///
/// The sum is multiplied by the square of [`BETWEEN_BLOCKS`]. If only few blocks have detail, the covariance that
/// independent noise would cause, multiplied by `factor`^2, is then added. Blocks without detail do not count.
fn covariance(blocks: &[Block], prior: &DMatrix<f64>, factor: f64) -> Option<DMatrix<f64>> {
    let n = prior.nrows();
    let whole = blocks.iter().fold(prior.clone(), |sum, (matrix, _)| sum + matrix * CURVATURE);
    let inverse = whole.clone().cholesky()?.inverse();
    let detailed = blocks.iter().filter(|(matrix, _)| matrix.trace() > 0.0);
    let mut changes = Vec::with_capacity(blocks.len());
    for (matrix, score) in detailed {
        // A multiple of D is added, so that the matrix has an inverse even if no other block has any detail.
        let others = &whole * (1.0 + LEAST_LEFT) - matrix * CURVATURE;
        changes.push(others.cholesky()?.solve(score));
    }
    let count = changes.len() as f64;
    let mean = changes.iter().fold(DVector::zeros(n), |sum, change| sum + change) / count.max(1.0);
    let mut covariance = &inverse * prior * &inverse * (factor * factor);
    for change in &changes {
        let off = change - &mean;
        covariance += &off * off.transpose() * ((count - 1.0) / count);
    }
    covariance *= BETWEEN_BLOCKS * BETWEEN_BLOCKS;
    // The scatter of only a few blocks shows little about the error. Therefore the error that independent noise would
    // cause is added, `factor` times as large.
    if changes.len() <= n {
        let data = blocks.iter().fold(DMatrix::zeros(n, n), |sum, (matrix, _)| sum + matrix);
        covariance += &inverse * data * &inverse * (factor * factor);
    }
    Some(covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::transform::Model;
    use crate::statistics::random;

    const SIDE: usize = 120;

    fn uniform(i: usize, draw: u64) -> f64 {
        random(draw, i as u64, 0) as f64 / u64::MAX as f64 - 0.5
    }

    /// The blocks of a problem with two parameters and SIDE x SIDE observations of precision 1. Successive observations
    /// form groups of the size `alike`. All observations of a group have the same derivatives and the same residual.
    fn problem(alike: usize) -> Vec<Block> {
        let places = (0..SIDE * SIDE).map(|i| [(i % SIDE) as f64, (i / SIDE) as f64]);
        let block = |indices: Vec<usize>| {
            let (mut matrix, mut score) = (DMatrix::zeros(2, 2), DVector::zeros(2));
            for i in indices {
                let row = DVector::from_vec(vec![uniform(i / alike, 2), uniform(i / alike, 3)]);
                // A uniform distribution of width sqrt(12) has the variance 1.
                score += &row * (12f64.sqrt() * uniform(i / alike, 1));
                matrix += &row * row.transpose();
            }
            (matrix, score)
        };
        blocks(places, (SIDE, SIDE)).into_iter().map(block).collect()
    }

    fn sum(blocks: &[Block]) -> Block {
        let zero = (DMatrix::zeros(2, 2), DVector::zeros(2));
        blocks.iter().fold(zero, |(a, b), (matrix, score)| (a + matrix, b + score))
    }

    /// Changes the scores to those of the residuals that a fit without a prior leaves.
    fn fitted(mut blocks: Vec<Block>) -> Vec<Block> {
        let (matrix, score) = sum(&blocks);
        let step = matrix.cholesky().unwrap().solve(&score);
        blocks.iter_mut().for_each(|(matrix, score)| *score -= &*matrix * &step);
        blocks
    }

    #[test]
    fn correlated_residuals_add_as_much_variance_as_they_cause() {
        // The expected variance is `alike` times that of independent noise. The estimate is a sum of 72 squares (36
        // blocks, two parameters), so its standard error is sqrt(2 / 72) = 17 %. The limit of 50 % is three of them.
        for alike in [1, 4, 10] {
            let blocks = fitted(problem(alike));
            let found = covariance(&blocks, &DMatrix::zeros(2, 2), 1.0).unwrap();
            let excess = (found * sum(&blocks).0).trace() / 2.0;
            let expected = alike as f64 * (BETWEEN_BLOCKS / CURVATURE).powi(2);
            assert!((excess / expected - 1.0).abs() < 0.5, "{alike}: {excess} for {expected}");
        }
    }

    /// The textbook version: solves the whole problem again without each block.
    #[test]
    fn covariance_is_that_of_solutions_without_one_block() {
        let blocks = fitted(problem(3));
        let without = |k: usize| {
            let others: Vec<Block> =
                blocks.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, block)| block.clone()).collect();
            let (matrix, score) = sum(&others);
            matrix.cholesky().unwrap().solve(&score)
        };
        let solutions: Vec<DVector<f64>> = (0..blocks.len()).map(without).collect();
        let count = solutions.len() as f64;
        let mean = solutions.iter().fold(DVector::zeros(2), |sum, s| sum + s) / count;
        let scatter = solutions.iter().fold(DMatrix::zeros(2, 2), |sum, s| sum + (s - &mean) * (s - &mean).transpose());
        let expected = scatter * ((count - 1.0) / count * (BETWEEN_BLOCKS / CURVATURE).powi(2));
        let found = covariance(&blocks, &DMatrix::zeros(2, 2), 1.0).unwrap();
        // `LEAST_LEFT` makes each change smaller by a share of about 0.01.
        assert!((&found - &expected).norm() < 0.03 * expected.norm(), "{found} {expected}");
    }

    /// The textbook version: for each larger block, adds up the small blocks that are inside it.
    #[test]
    fn larger_blocks_are_those_of_half_the_number_along_each_side() {
        let side = BLOCKS / 2;
        let numbered = |i: usize| (DMatrix::identity(2, 2) * (i as f64), DVector::from_element(2, i as f64));
        let found = larger(&(0..BLOCKS * BLOCKS).map(numbered).collect::<Vec<_>>());
        assert_eq!(found.len(), side * side);
        for (k, (matrix, score)) in found.iter().enumerate() {
            let inside = |i: &usize| i / BLOCKS / 2 == k / side && i % BLOCKS / 2 == k % side;
            let expected: usize = (0..BLOCKS * BLOCKS).filter(inside).sum();
            assert_eq!((matrix[(0, 0)], score[1]), (expected as f64, expected as f64), "{k}");
        }
    }

    #[test]
    fn residuals_that_are_alike_in_large_parts_have_the_error_of_the_larger_blocks() {
        // If `alike`, all observations in a ninth of the picture have the same residual. If not, each has its own.
        let basis = Increment::new(Model::Shift, SIDE, SIDE);
        let error = |alike: bool| {
            let third = SIDE / 3;
            let places = (0..SIDE * SIDE).map(|i| [(i % SIDE) as f64, (i / SIDE) as f64]);
            let block = |indices: Vec<usize>| {
                let (mut matrix, mut score) = (DMatrix::zeros(2, 2), DVector::zeros(2));
                for i in indices {
                    let group = if alike { i / SIDE / third * 3 + i % SIDE / third } else { i };
                    let residual = DVector::from_vec(vec![uniform(group, 1), uniform(group, 4)]);
                    matrix += DMatrix::identity(2, 2);
                    score += residual;
                }
                (matrix, score)
            };
            let fitted = fitted(blocks(places, (SIDE, SIDE)).into_iter().map(block).collect());
            let none = DMatrix::zeros(2, 2);
            let small = basis.expected_error(&covariance(&fitted, &none, 1.0).unwrap());
            (small, fitted_error(&basis, &fitted, &none, 1.0).unwrap())
        };
        // Four small blocks have the same residual, so the error of the mean is that of nine values, not of 36: twice
        // as much. Two things change this: the factor (B - 1) / B by 4 %, and the larger part that is left out (a
        // ninth) by 9 %.
        let (small, both) = error(true);
        assert!((both / small - 2.0 * 0.96 * 1.09).abs() < 0.02, "{small} {both}");
        let (small, both) = error(false);
        assert!(both / small < 1.5, "{small} {both}");
    }

    #[test]
    fn matrix_without_inverse_has_no_covariance() {
        let none = DMatrix::zeros(2, 2);
        assert_eq!(covariance(&[], &none, 1.0), None);
        assert_eq!(covariance(&[(none.clone(), DVector::zeros(2))], &none, 1.0), None);
    }

    #[test]
    fn few_blocks_have_the_error_of_independent_noise() {
        // After a fit, the score of the only block is zero: its scatter shows nothing.
        let mut blocks = vec![(DMatrix::zeros(2, 2), DVector::zeros(2)); 9];
        blocks[4] = (DMatrix::identity(2, 2) * 4.0, DVector::zeros(2));
        let found = covariance(&blocks, &DMatrix::zeros(2, 2), 3.0).unwrap();
        assert!((found[(0, 0)] - 9.0 / 4.0 / (CURVATURE * CURVATURE)).abs() < 1e-9, "{found}");
    }
}
