//! The motion of a camera, in the parameters that are fitted to the displacements of patches.
//!
//! In: parameters. Out: the displacement of a pixel with a relative depth, its derivatives, and the [`Camera`]. Cost:
//! three dot products and a division.

use crate::align::motion::camera::Camera;
use crate::align::motion::coordinates::{Coordinates, by_homography};
use nalgebra::{Matrix3, Matrix3x4, RowVector4, SVector, Vector4};

/// Number of parameters of a [`CameraMotion`].
pub(in crate::align::following::depth) const PARAMETERS: usize = 11;

/// The motion of a frame relative to a homography from which displacements were measured: a small second homography (8
/// parameters) and an epipole (3). All parameters are displacements in pixels: at the distance of one unit from the
/// centre, and, for the epipole, of a pixel with relative depth 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::align::following::depth) struct CameraMotion(
    pub(in crate::align::following::depth) SVector<f64, PARAMETERS>,
);

impl CameraMotion {
    /// The motion without depth, by a small homography.
    pub(in crate::align::following::depth) fn flat(homography: &SVector<f64, 8>) -> Self {
        CameraMotion(SVector::from_fn(|i, _| homography.get(i).copied().unwrap_or(0.0)))
    }

    /// Displacement at the position `at`, in [`Coordinates`], of a pixel with relative depth `q`. In pixels.
    pub(in crate::align::following::depth) fn displacement(&self, [u, v]: [f64; 2], q: f64, unit: f64) -> [f64; 2] {
        let m = self.matrix(unit) * Vector4::new(u, v, 1.0, q);
        [(m.x / m.z - u) * unit, (m.y / m.z - v) * unit]
    }

    /// The matrix that maps (u, v, 1, q) to homogeneous coordinates of the frame, all in [`Coordinates`].
    fn matrix(&self, unit: f64) -> Matrix3x4<f64> {
        let p = self.0 / unit;
        Matrix3x4::from_rows(&[
            RowVector4::new(1.0 + p[0], p[1], p[2], p[8]),
            RowVector4::new(p[3], 1.0 + p[4], p[5], p[9]),
            RowVector4::new(-p[6], -p[7], 1.0, p[10]),
        ])
    }

    /// The camera with this motion relative to the homography `h`, which maps pixels of the reference to pixels of the
    /// frame.
    pub(in crate::align::following::depth) fn camera(&self, h: &Matrix3<f64>, coordinates: &Coordinates) -> Camera {
        let own = Camera::new(self.matrix(coordinates.unit));
        own.between(&coordinates.matrix(), &(h * coordinates.inverse()))
    }

    /// Derivatives of the displacement by all parameters at (u, v), for small motions and a pixel with relative depth
    /// `q`: of x and of y.
    pub(in crate::align::following::depth) fn by_parameters([u, v]: [f64; 2], q: f64) -> [SVector<f64, PARAMETERS>; 2] {
        let [x, y] = by_homography([u, v]);
        let all = |eight: [f64; 8], depth: [f64; 3]| {
            SVector::from_fn(|i, _| if i < eight.len() { eight[i] } else { q * depth[i - eight.len()] })
        };
        [all(x, [1.0, 0.0, -u]), all(y, [0.0, 1.0, -v])]
    }

    /// Derivative of the displacement by the relative depth at (u, v), for small motions.
    pub(in crate::align::following::depth) fn by_depth(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [self.0[8] - self.0[10] * u, self.0[9] - self.0[10] * v]
    }
}
