//! The homography of least absolute errors: what one homography can explain of the displacements of patches.
//!
//! In: the [`Observation`]s of a frame. Out: a small homography, relative to the one from which they were measured.
//! Cost: some hundred multiply-adds for each observation and round. Source: iteratively reweighted least squares.

use crate::align::following::observations::Observation;
use crate::align::motion::coordinates::by_homography;
use nalgebra::{SMatrix, SVector};

/// Number of rounds in which weights are computed again.
const ROUNDS: usize = 10;
/// Expected size of the parameters, in pixels of the level. It matters only for parameters that the observations leave
/// open, for example if all observations of a frame are in one corner.
pub(super) const EXPECTED_PX: f64 = 5.0;

/// A small homography: see [`by_homography`]. In pixels of the level.
pub(super) type Homography = SVector<f64, 8>;

/// Derivatives of the displacement of an observed patch by the parameters.
pub(super) fn basis(observation: &Observation) -> SMatrix<f64, 2, 8> {
    SMatrix::from_fn(|row, column| by_homography(observation.at)[row][column])
}

/// The absolute error of a misfit (in variances), smooth at 0.
pub(super) fn absolute(misfit: f64) -> f64 {
    (misfit + 1.0).sqrt() - 1.0
}

/// The homography of least absolute errors.
pub(super) fn fit<'a>(observations: impl Iterator<Item = &'a Observation> + Clone) -> Homography {
    let mut h = Homography::zeros();
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (SMatrix::<f64, 8, 8>::zeros(), Homography::zeros());
        for observation in observations.clone() {
            let basis = basis(observation);
            let d = basis * h;
            let weight = 1.0 / (absolute(observation.misfit([d.x, d.y])) + 1.0);
            let weighed = basis.transpose() * (observation.precision * weight);
            normal += weighed * basis;
            right += weighed * observation.displacement;
        }
        h = solved(normal, right, 1.0 / (EXPECTED_PX * EXPECTED_PX), &Homography::zeros());
    }
    h
}

/// Solves the normal equations, with a pull towards `towards` of strength `hold`.
pub(super) fn solved(
    mut normal: SMatrix<f64, 8, 8>,
    mut right: Homography,
    hold: f64,
    towards: &Homography,
) -> Homography {
    for i in 0..8 {
        normal[(i, i)] += hold;
    }
    right += towards * hold;
    normal.cholesky().map_or(*towards, |c| c.solve(&right))
}
