//! The displacements of patches in all frames: the data from which the cameras are computed.
//!
//! In: for each frame, its pair with the reference, and the transform of its placement. Out: [`Observation`]s. Cost:
//! the block matching of [`local`](crate::align::local), some hundred correlations per pixel of its level.

use crate::align::agreement::TileDisplacement;
use crate::align::motion::coordinates::Coordinates;
use nalgebra::{Matrix2, Vector2};

/// Standard deviation of the noise of a correlation. The displacement of a patch is as uncertain as its correlation
/// is flat.
const CORRELATION_NOISE: f64 = 0.03;
/// Least standard deviation of the displacement of a patch, in pixels of the level. A patch shows several depths.
const LEAST_ERROR: f64 = 0.15;

/// The displacement of a patch of the reference in one frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Observation {
    /// Number of the patch; the same in all frames.
    pub(super) patch: usize,
    /// Centre of the patch, in [`Coordinates`].
    pub(super) at: [f64; 2],
    /// Displacement from the position that the transform gives, in pixels of the level.
    pub(super) displacement: Vector2<f64>,
    /// Inverse covariance of the displacement.
    pub(super) precision: Matrix2<f64>,
}

impl Observation {
    /// The observation of patch `patch` with the displacement `found`.
    pub(super) fn new(patch: usize, found: &TileDisplacement, coordinates: &Coordinates) -> Self {
        let [xx, xy, yy] = found.sharpness;
        // Along an edge, the displacement is unknown. There, the precision is nearly 0.
        let least = 1e-6 + 1e-3 * (xx + yy);
        let sharpness = Matrix2::new(xx + least, xy, xy, yy + least);
        let inverse = sharpness.try_inverse().unwrap_or_else(Matrix2::zeros);
        let covariance = inverse * CORRELATION_NOISE + Matrix2::identity() * (LEAST_ERROR * LEAST_ERROR);
        Observation {
            patch,
            at: coordinates.of(found.centre),
            displacement: inverse * Vector2::from(found.pull),
            precision: covariance.try_inverse().unwrap_or_else(Matrix2::zeros),
        }
    }

    /// Squared distance of the displacement `d` from the measured one, in variances.
    pub(super) fn misfit(&self, d: [f64; 2]) -> f64 {
        let r = self.displacement - Vector2::from(d);
        (self.precision * r).dot(&r)
    }
}
