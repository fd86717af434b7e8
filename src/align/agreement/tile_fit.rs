//! The transform that fits the displacements of the tiles best.
//!
//! In: a [`TileCheck`] of a transform. Out: the small change of the transform that moves most tiles to their best
//! match, and its error estimate. Cost: negligible compared with the check. Source: Newton's method on the sum of the
//! tiles' correlations; tiles on moving objects are down-weighted (Tukey's biweight).
//!
//! Flare, motion blur, and noise that distorts the intensity map can make the grey values at all edges brighter, or at
//! all edges darker. [`refinement`](crate::align::refinement) mistakes this change for motion. The fit to the tiles is
//! not affected, because correlation does not depend on a tile's own gain and offset.

use crate::align::agreement::pattern::PEAK_BIAS;
use crate::align::agreement::{TileCheck, TileDisplacement};
use crate::align::transform::{Block, Increment, Model, blocks, fitted_error};
use crate::statistics::{MEDIAN_SQUARE, TUKEY, biweight, median};
use nalgebra::{DMatrix, DVector, Matrix3};

/// With fewer tiles than this, nothing is fitted.
const LEAST_TILES: usize = 8;
/// The actual error, divided by the error that would result if the errors of all tiles were independent, in scenes
/// where the tiles match well.
const CORRELATION_FACTOR: f64 = 1.5;
/// Number of rounds of reweighting.
const ROUNDS: usize = 5;

/// The transform fitted to the displacements of the tiles.
#[derive(Debug, Clone)]
pub(crate) struct TileFit {
    /// The fitted transform, in pixels of the planes.
    pub(crate) h: Matrix3<f64>,
    /// The distance of the fitted transform from the checked one: root mean square over the picture, in pixels of the
    /// planes.
    pub(crate) moved: f64,
    /// The error estimate of the fitted transform, in the same unit: from the scatter of the displacements, and from
    /// [`PEAK_BIAS`].
    pub(crate) error: f64,
    /// The error of the fitted transform if the errors of the tiles were nearly independent (see
    /// [`CORRELATION_FACTOR`]), in the same unit. Under a wrong transform, neighbouring tiles are often displaced
    /// alike, in a way that no homography explains. Then `error` is larger than this.
    pub(crate) least_error: f64,
    /// How much the fit changes the parameters of the checked transform: the root mean square change, in standard
    /// errors. These are computed as if the errors of the tiles were nearly independent. The value is about 1 if the
    /// checked transform is right, because then only noise changes the parameters.
    pub(crate) significance: f64,
}

/// Fits a transform to the displacements of the tiles under `h`, for planes of `size`; none if there are too few tiles.
pub(crate) fn fit(check_tiles: &TileCheck, h: &Matrix3<f64>, size: (usize, usize)) -> Option<TileFit> {
    let tiles = &check_tiles.displacements;
    if tiles.len() < LEAST_TILES {
        return None;
    }
    let basis = Increment::new(Model::Homography, size.0, size.1);
    let n = basis.parameters();
    let places: Vec<[[f64; 2]; 8]> = tiles.iter().map(|t| basis.jacobian(t.centre[0], t.centre[1])).collect();
    let blocks = blocks(tiles.iter().map(|t| t.centre), size);
    let (mut prior, mut pull) = (DMatrix::zeros(n, n), DVector::zeros(n));
    basis.add_prior(h, CORRELATION_FACTOR, &mut prior, &mut pull);
    let mut step = DVector::zeros(n);
    for round in 0..=ROUNDS {
        let misfits: Vec<f64> = tiles.iter().zip(&places).map(|(t, j)| misfit(t, j, &step)).collect();
        let variance = (median(misfits.iter().copied())? / MEDIAN_SQUARE).max(1e-12);
        let equations = |block: &Vec<usize>| {
            let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
            for (tile, j, misfit) in block.iter().map(|&i| (&tiles[i], &places[i], misfits[i])) {
                let weight = biweight((misfit / variance).sqrt() / TUKEY) / variance;
                for p in 0..n {
                    // Displacements are in the reference's pixels. If a tile matches farther right, the step moves the
                    // transform to the right, hence the minus sign: `solve` returns the solution of A step = -b.
                    b[p] -= weight * (j[p][0] * tile.pull[0] + j[p][1] * tile.pull[1]);
                    let pulled = times(tile, j[p]);
                    for q in 0..n {
                        a[(p, q)] += weight * (j[q][0] * pulled[0] + j[q][1] * pulled[1]);
                    }
                }
            }
            (a, b)
        };
        let parts: Vec<Block> = blocks.iter().map(equations).collect();
        let (a, b) = parts.iter().fold((prior.clone(), pull.clone()), |(a, b), part| (a + &part.0, b + &part.1));
        if round == ROUNDS {
            // The scores of the residuals after the step.
            let score = |(a, b): Block| {
                let score = &a * &step + b;
                (a, score)
            };
            let scores: Vec<Block> = parts.into_iter().map(score).collect();
            let scatter = fitted_error(&basis, &scores, &prior, CORRELATION_FACTOR)?;
            let moved = h * basis.matrix(&step);
            let significance = (step.dot(&(&a * &step)) / n as f64).max(0.0).sqrt() / CORRELATION_FACTOR;
            return Some(TileFit {
                h: moved / moved[(2, 2)],
                moved: basis.mean_move(&step),
                error: (scatter * scatter + PEAK_BIAS * PEAK_BIAS).sqrt(),
                least_error: CORRELATION_FACTOR * basis.expected_error(&a.cholesky()?.inverse()),
                significance,
            });
        }
        step = basis.solve(a, b)?;
    }
    None
}

/// Returns the sharpness matrix S of the tile times `v`.
fn times(tile: &TileDisplacement, v: [f64; 2]) -> [f64; 2] {
    let [xx, xy, yy] = tile.sharpness;
    [xx * v[0] + xy * v[1], xy * v[0] + yy * v[1]]
}

/// Returns the squared residual of a tile after the parameters have changed by `step` (s): (d - J s)^T S (d - J s),
/// with the tile's displacement d, its sharpness S, and the derivatives J of its position with respect to the
/// parameters (`j`).
fn misfit(tile: &TileDisplacement, j: &[[f64; 2]; 8], step: &DVector<f64>) -> f64 {
    let mut moved = [0.0; 2];
    for (p, s) in step.iter().enumerate() {
        moved[0] += j[p][0] * s;
        moved[1] += j[p][1] * s;
    }
    let fitted = times(tile, moved);
    let left = [tile.pull[0] - fitted[0], tile.pull[1] - fitted[1]];
    // With r = S (d - J s), which is `left`, the residual is r^T S^-1 r. Along an edge both r and S are zero, so a
    // small multiple of the identity is added to S before it is inverted.
    let [xx, xy, yy] = tile.sharpness;
    let safe = 0.02 * (xx + yy) + 1e-12;
    let (xx, yy) = (xx + safe, yy + safe);
    let determinant = xx * yy - xy * xy;
    (yy * left[0] * left[0] - 2.0 * xy * left[0] * left[1] + xx * left[1] * left[1]) / determinant
}
