//! The camera of a frame relative to the reference: where the frame shows a pixel of the reference, given the pixel's
//! relative depth.
//!
//! In: a [`CameraMotion`], the parameters that are fitted to the displacements of patches. Out: a [`Camera`], which
//! maps a position and a relative depth to a position in the frame. Cost: three dot products and a division. Source:
//! plane plus parallax (Irani & Anandan, "Parallax Geometry of Pairs of Points for 3D Scene Analysis", ECCV 1996).
//!
//! If nothing in the scene moves, then x' ~ H x + q e for all pixels x of the reference (Hartley & Zisserman, Multiple
//! View Geometry, 13.3): a homography H, the epipole e of the frame, and the relative depth q of the pixel, which is
//! the same in all frames. Here, q has no unit, and another q' = a q + b x + c y + d would do as well with other H and
//! e; only the displacements have a meaning.

use nalgebra::{Matrix3, Matrix3x4, Matrix4, RowVector4, SVector, Vector4};

/// Number of parameters of a [`CameraMotion`].
pub(super) const PARAMETERS: usize = 11;
/// Expected size of the parameters of a motion, in pixels of the level. It matters only for parameters that the sights
/// leave open, for example if all sights of a frame are in one corner.
pub(super) const EXPECTED_PX: f64 = 5.0;

/// The coordinates in which motions are fitted: the centre of the picture is (0, 0), half the long side is 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Coordinates {
    centre: [f64; 2],
    /// Length of the unit, in pixels.
    pub(super) unit: f64,
}

impl Coordinates {
    pub(super) fn new((width, height): (usize, usize)) -> Self {
        let [right, bottom] = [width, height].map(|length| length as f64 - 1.0);
        Coordinates { centre: [right / 2.0, bottom / 2.0], unit: (right.max(bottom) / 2.0).max(1.0) }
    }

    pub(super) fn of(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [(x - self.centre[0]) / self.unit, (y - self.centre[1]) / self.unit]
    }

    fn matrix(&self) -> Matrix3<f64> {
        let [x, y] = self.centre;
        Matrix3::new(1.0, 0.0, -x, 0.0, 1.0, -y, 0.0, 0.0, self.unit) / self.unit
    }

    fn inverse(&self) -> Matrix3<f64> {
        let [x, y] = self.centre;
        Matrix3::new(self.unit, 0.0, x, 0.0, self.unit, y, 0.0, 0.0, 1.0)
    }
}

/// The motion of a frame relative to a homography from which displacements were measured: a small second homography (8
/// parameters) and an epipole (3). All parameters are displacements in pixels: at the distance of one unit from the
/// centre, and, for the epipole, of a pixel with relative depth 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CameraMotion(pub(super) SVector<f64, PARAMETERS>);

impl CameraMotion {
    /// Displacement at the position `at`, in [`Coordinates`], of a pixel with relative depth `q`. In pixels.
    pub(super) fn displacement(&self, [u, v]: [f64; 2], q: f64, unit: f64) -> [f64; 2] {
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

    /// Derivatives of the displacement by the parameters of the homography at (u, v), for small motions: of x and of y.
    pub(super) fn by_homography([u, v]: [f64; 2]) -> [[f64; 8]; 2] {
        [[u, v, 1.0, 0.0, 0.0, 0.0, u * u, u * v], [0.0, 0.0, 0.0, u, v, 1.0, u * v, v * v]]
    }

    /// Derivative of the displacement by the relative depth at (u, v), for small motions.
    pub(super) fn by_depth(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [self.0[8] - self.0[10] * u, self.0[9] - self.0[10] * v]
    }
}

/// A camera: maps pixels of the reference and their relative depths to pixels of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Camera {
    matrix: Matrix3x4<f64>,
}

impl Camera {
    /// The camera with `motion` relative to the homography `h`, which maps pixels of the reference to pixels of the
    /// frame.
    pub(super) fn new(h: &Matrix3<f64>, motion: &CameraMotion, coordinates: &Coordinates) -> Self {
        let inner = coordinates.inverse() * motion.matrix(coordinates.unit);
        Camera { matrix: h * inner * keeping_depth(&coordinates.matrix()) }
    }

    /// Returns the camera in pixels of the full size, if `self` is in pixels of a level; `to_full` maps pixels of the
    /// level to pixels of the full size.
    pub(super) fn at_full_size(&self, to_full: &Matrix3<f64>) -> Self {
        let back = to_full.try_inverse().unwrap_or_else(Matrix3::identity);
        Camera { matrix: to_full * self.matrix * keeping_depth(&back) }
    }

    /// The homogeneous position in the frame of the pixel (x, y) with relative depth 0, and its change per unit of
    /// relative depth.
    pub(super) fn line(&self, x: f64, y: f64) -> ([f64; 3], [f64; 3]) {
        let m = &self.matrix;
        (std::array::from_fn(|i| m[(i, 0)] * x + m[(i, 1)] * y + m[(i, 2)]), std::array::from_fn(|i| m[(i, 3)]))
    }

    /// Position in the frame of the pixel (x, y) of the reference with relative depth `q`.
    pub(super) fn position(&self, x: f64, y: f64, q: f64) -> (f64, f64) {
        let (at, by) = self.line(x, y);
        let w = at[2] + q * by[2];
        ((at[0] + q * by[0]) / w, (at[1] + q * by[1]) / w)
    }
}

/// Returns the matrix that maps the position by `h` and keeps the relative depth.
fn keeping_depth(h: &Matrix3<f64>) -> Matrix4<f64> {
    let mut whole = Matrix4::identity();
    whole.fixed_view_mut::<3, 3>(0, 0).copy_from(h);
    whole
}
