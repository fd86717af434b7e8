//! The transform that fits the displacements of the tiles best.
//!
//! In: a [`TileCheck`] of a transform. Out: the small change that moves most tiles to their best match, and its error
//! estimate. Cost: negligible compared with the check. Source: Newton's method on the sum of the correlations; tiles on
//! moving objects are down-weighted (Tukey's biweight).
//!
//! Flare, motion blur, and noise that bends the intensity map change the grey values at all edges in the same
//! direction, and [`refinement`](crate::align::refinement) takes this for motion. The fit to the tiles is not affected,
//! because correlation does not depend on a tile's own gain and offset.

use crate::align::agreement::{TileCheck, TileDisplacement};
use crate::align::transform::{Increment, Model};
use crate::statistics::{MEDIAN_SQUARE, TUKEY, biweight, median};
use nalgebra::{DMatrix, DVector, Matrix3};

/// With fewer tiles than this, nothing is fitted.
const LEAST_TILES: usize = 8;
/// Factor by which the standard error is increased because neighbouring tiles are correlated.
const CORRELATION_FACTOR: f64 = 1.5;
/// Number of rounds of reweighting.
const ROUNDS: usize = 5;

/// The transform fitted to the displacements of the tiles.
#[derive(Debug, Clone)]
pub(crate) struct TileFit {
    /// The fitted transform, in pixels of the planes.
    pub(crate) h: Matrix3<f64>,
    /// Its distance from the transform that was checked, as root mean square over the picture, in pixels of the planes.
    pub(crate) moved: f64,
    /// Its error estimate, in the same unit.
    pub(crate) error: f64,
    /// The root mean square change of the parameters, in units of its error: about 1 if the transform that was checked
    /// is right.
    pub(crate) significance: f64,
}

/// Fits a transform to the displacements of the tiles under `h`, for planes of `size`; none where they are too few.
pub(crate) fn fit(check_tiles: &TileCheck, h: &Matrix3<f64>, size: (usize, usize)) -> Option<TileFit> {
    let tiles = &check_tiles.displacements;
    if tiles.len() < LEAST_TILES {
        return None;
    }
    let basis = Increment::new(Model::Homography, size.0, size.1);
    let n = basis.parameters();
    let places: Vec<[[f64; 2]; 8]> = tiles.iter().map(|t| basis.jacobian(t.centre[0], t.centre[1])).collect();
    let mut step = DVector::zeros(n);
    let mut normal = DMatrix::identity(n, n);
    for _ in 0..ROUNDS {
        let misfits: Vec<f64> = tiles.iter().zip(&places).map(|(t, j)| misfit(t, j, &step)).collect();
        let variance = (median(misfits.iter().copied())? / MEDIAN_SQUARE).max(1e-12);
        let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for ((tile, j), misfit) in tiles.iter().zip(&places).zip(&misfits) {
            let weight = biweight((misfit / variance).sqrt() / TUKEY) / variance;
            for p in 0..n {
                // Displacements are in the reference's pixels: a tile found to the right moves the transform that way.
                b[p] -= weight * (j[p][0] * tile.pull[0] + j[p][1] * tile.pull[1]);
                let pulled = times(tile, j[p]);
                for q in 0..n {
                    a[(p, q)] += weight * (j[q][0] * pulled[0] + j[q][1] * pulled[1]);
                }
            }
        }
        basis.add_prior(h, CORRELATION_FACTOR, &mut a, &mut b);
        step = basis.solve(a.clone(), b)?;
        normal = a;
    }
    let moved = h * basis.matrix(&step);
    let error = CORRELATION_FACTOR * basis.expected_error(&normal.clone().cholesky()?.inverse());
    let significance = (step.dot(&(&normal * &step)) / n as f64).max(0.0).sqrt() / CORRELATION_FACTOR;
    Some(TileFit { h: moved / moved[(2, 2)], moved: basis.mean_move(&step), error, significance })
}

/// The sharpness S of the tile times `v`.
fn times(tile: &TileDisplacement, v: [f64; 2]) -> [f64; 2] {
    let [xx, xy, yy] = tile.sharpness;
    [xx * v[0] + xy * v[1], xy * v[0] + yy * v[1]]
}

/// The residual (d - J s)^T S (d - J s) of a tile with the displacement d and the sharpness S after the step s.
fn misfit(tile: &TileDisplacement, j: &[[f64; 2]; 8], step: &DVector<f64>) -> f64 {
    let mut moved = [0.0; 2];
    for (p, s) in step.iter().enumerate() {
        moved[0] += j[p][0] * s;
        moved[1] += j[p][1] * s;
    }
    let fitted = times(tile, moved);
    let left = [tile.pull[0] - fitted[0], tile.pull[1] - fitted[1]];
    // r^T S^-1 r. S is regularised, because along an edge both r and S vanish.
    let [xx, xy, yy] = tile.sharpness;
    let safe = 0.02 * (xx + yy) + 1e-12;
    let (xx, yy) = (xx + safe, yy + safe);
    let determinant = xx * yy - xy * xy;
    (yy * left[0] * left[0] - 2.0 * xy * left[0] * left[1] + xx * left[1] * left[1]) / determinant
}
