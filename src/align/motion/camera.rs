//! The camera of a frame relative to the reference: where the frame shows a pixel of the reference, given the pixel's
//! relative depth.
//!
//! In: a matrix. Out: a [`Camera`], which maps a position and a relative depth to a position in the frame. Cost: three
//! dot products and a division. Source: plane plus parallax (Irani & Anandan, "Parallax Geometry of Pairs of Points for
//! 3D Scene Analysis", ECCV 1996).
//!
//! If nothing in the scene moves, then x' ~ H x + q e for all pixels x of the reference (Hartley & Zisserman, Multiple
//! View Geometry, 13.3): a homography H, the epipole e of the frame, and the relative depth q of the pixel, which is
//! the same in all frames. Here, q has no unit, and another q' = a q + b x + c y + d would do as well with other H and
//! e; only the displacements have a meaning.

use nalgebra::{Matrix3, Matrix3x4, Matrix4};

/// A camera: maps pixels of the reference and their relative depths to pixels of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Camera {
    /// Maps (x, y, 1, q) to homogeneous coordinates of the frame.
    matrix: Matrix3x4<f64>,
}

impl Camera {
    /// The camera of `matrix`, which maps (x, y, 1, q) to homogeneous coordinates of the frame.
    pub(crate) fn new(matrix: Matrix3x4<f64>) -> Self {
        Camera { matrix }
    }

    /// The camera that maps the position by `before`, then by this camera, and then by `after`.
    pub(crate) fn between(&self, before: &Matrix3<f64>, after: &Matrix3<f64>) -> Self {
        let mut keeping_depth = Matrix4::identity();
        keeping_depth.fixed_view_mut::<3, 3>(0, 0).copy_from(before);
        Camera { matrix: after * self.matrix * keeping_depth }
    }

    /// The homogeneous position in the frame of the pixel (x, y) with relative depth 0, and its change per unit of
    /// relative depth.
    #[inline(always)]
    pub(crate) fn line(&self, x: f64, y: f64) -> ([f64; 3], [f64; 3]) {
        let m = &self.matrix;
        (std::array::from_fn(|i| m[(i, 0)] * x + m[(i, 1)] * y + m[(i, 2)]), std::array::from_fn(|i| m[(i, 3)]))
    }

    /// Position in the frame of the pixel (x, y) of the reference with relative depth `q`.
    #[inline(always)]
    pub(crate) fn position(&self, x: f64, y: f64, q: f64) -> (f64, f64) {
        let (at, by) = self.line(x, y);
        let w = at[2] + q * by[2];
        ((at[0] + q * by[0]) / w, (at[1] + q * by[1]) / w)
    }

    /// The homography of all pixels with relative depth `q`.
    pub(crate) fn homography(&self, q: f64) -> Matrix3<f64> {
        let m = &self.matrix;
        let mut h: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into();
        for i in 0..3 {
            h[(i, 2)] += q * m[(i, 3)];
        }
        h
    }
}
