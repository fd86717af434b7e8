//! Transforms: reference pixel -> frame pixel.
//!
//! In: a shift, a rotation, or a homography. Out: its 3x3 matrix on pixel coordinates of the full size or of a pyramid
//! level; its shift, its rotation, and its distance to another transform. Cost: negligible. Source: Hartley &
//! Zisserman, Multiple View Geometry (2nd ed., 2004), section 2.4 (a hierarchy of transformations).

mod covariance;
mod increment;
mod model;

pub(crate) use covariance::{Block, blocks, fitted_error};
pub(crate) use increment::Increment;
pub use model::Model;
pub(crate) use model::{restrict, to_transform};

use nalgebra::Matrix3;
use std::f64::consts::PI;

/// Maps **reference pixel -> frame pixel**, both in pixels with (0, 0) at the centre of the top-left pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Transform {
    /// The frame did not move.
    Identity,
    /// A rotation R about the picture's centre c, and a shift d: x' = c + R(angle) (x - c) + d. A pure shift if the
    /// angle is 0.
    Rigid {
        /// Shift to the right, in pixels.
        dx: f64,
        /// Shift downwards, in pixels.
        dy: f64,
        /// Rotation from +x towards +y (clockwise on the screen), in radians.
        angle: f64,
    },
    /// A homography in homogeneous coordinates: x' ~ H x. The lower right element of H is 1.
    Homography(Matrix3<f64>),
}

impl Transform {
    /// Returns the matrix on homogeneous pixel coordinates, for pictures of this size; its lower right element is 1.
    pub fn matrix(&self, width: usize, height: usize) -> Matrix3<f64> {
        match *self {
            Transform::Identity => Matrix3::identity(),
            Transform::Rigid { dx, dy, angle } => {
                let (cx, cy) = centre(width, height);
                let (s, c) = (libm::sin(angle), libm::cos(angle));
                Matrix3::new(c, -s, cx + dx - c * cx + s * cy, s, c, cy + dy - s * cx - c * cy, 0.0, 0.0, 1.0)
            }
            Transform::Homography(h) => h,
        }
    }

    /// Returns the displacement of the picture's centre, in pixels.
    pub fn shift_px(&self, width: usize, height: usize) -> (f64, f64) {
        let (cx, cy) = centre(width, height);
        let (x, y) = map(&self.matrix(width, height), cx, cy);
        (x - cx, y - cy)
    }

    /// Returns the rotation at the picture's centre, in degrees from +x towards +y.
    pub fn rotation_deg(&self, width: usize, height: usize) -> f64 {
        let h = self.matrix(width, height);
        let (cx, cy) = centre(width, height);
        let ((x0, y0), (x1, y1)) = (map(&h, cx - 1.0, cy), map(&h, cx + 1.0, cy));
        libm::atan2(y1 - y0, x1 - x0) * 180.0 / PI
    }

    /// Returns the largest distance between the positions of a corner under this transform and under `other`, in
    /// pixels.
    pub fn corner_distance(&self, other: &Transform, width: usize, height: usize) -> f64 {
        let (a, b) = (self.matrix(width, height), other.matrix(width, height));
        corners(width, height)
            .iter()
            .map(|&(x, y)| {
                let ((ax, ay), (bx, by)) = (map(&a, x, y), map(&b, x, y));
                ((ax - bx) * (ax - bx) + (ay - by) * (ay - by)).sqrt()
            })
            .fold(0.0, f64::max)
    }
}

/// Returns the centre of a picture, in pixels; along a side with an even number of pixels, it is between two of them.
pub fn centre(width: usize, height: usize) -> (f64, f64) {
    ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0)
}

/// Returns the centres of the four corner pixels.
pub fn corners(width: usize, height: usize) -> [(f64, f64); 4] {
    let (r, b) = (width as f64 - 1.0, height as f64 - 1.0);
    [(0.0, 0.0), (r, 0.0), (r, b), (0.0, b)]
}

/// Number of points along each axis over which errors and distances are averaged.
const GRID: usize = 9;

/// Returns a grid of `GRID` x `GRID` points over the whole picture, row by row.
fn grid(width: usize, height: usize) -> impl Iterator<Item = (f64, f64)> {
    let at = |k: usize, n: usize| (n as f64 - 1.0) * k as f64 / (GRID as f64 - 1.0);
    (0..GRID * GRID).map(move |i| (at(i % GRID, width), at(i / GRID, height)))
}

/// Returns the root mean square distance, over the picture, between the positions of a pixel under `a` and under `b`,
/// in pixels.
pub(crate) fn distance(a: &Transform, b: &Transform, width: usize, height: usize) -> f64 {
    let (ha, hb) = (a.matrix(width, height), b.matrix(width, height));
    let sum: f64 = grid(width, height)
        .map(|(x, y)| {
            let ((ax, ay), (bx, by)) = (map(&ha, x, y), map(&hb, x, y));
            (ax - bx) * (ax - bx) + (ay - by) * (ay - by)
        })
        .sum();
    (sum / (GRID * GRID) as f64).sqrt()
}

/// Returns the matrix that maps a pixel of `level` to a pixel of the full size.
///
/// The matrix has an offset. Along each axis, a pixel of a level covers two pixels of the next larger level, and its
/// centre is between their centres.
pub fn level_to_full(level: usize) -> Matrix3<f64> {
    let scale = (1u64 << level) as f64;
    let offset = (scale - 1.0) / 2.0;
    Matrix3::new(scale, 0.0, offset, 0.0, scale, offset, 0.0, 0.0, 1.0)
}

/// Returns the matrix that maps a pixel of the full size to a pixel of `level`.
pub fn full_to_level(level: usize) -> Matrix3<f64> {
    let scale = (1u64 << level) as f64;
    let offset = (1.0 - scale) / (2.0 * scale);
    Matrix3::new(1.0 / scale, 0.0, offset, 0.0, 1.0 / scale, offset, 0.0, 0.0, 1.0)
}

/// Converts `h` from pixels of the full size to pixels of `level`.
pub fn on_level(h: &Matrix3<f64>, level: usize) -> Matrix3<f64> {
    full_to_level(level) * h * level_to_full(level)
}

/// Converts `h` from pixels of `level` to pixels of the full size; the lower right element of the result is 1.
pub fn off_level(h: &Matrix3<f64>, level: usize) -> Matrix3<f64> {
    let whole = level_to_full(level) * h * full_to_level(level);
    whole / whole[(2, 2)]
}

/// Maps the point (x, y) by the matrix `h` in homogeneous coordinates. The result is not finite for points on the line
/// that `h` maps to infinity.
#[inline(always)]
pub fn map(h: &Matrix3<f64>, x: f64, y: f64) -> (f64, f64) {
    let w = h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)];
    ((h[(0, 0)] * x + h[(0, 1)] * y + h[(0, 2)]) / w, (h[(1, 0)] * x + h[(1, 1)] * y + h[(1, 2)]) / w)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rigid_warp_turns_about_the_centre() {
        let transform = Transform::Rigid { dx: 3.0, dy: -2.0, angle: 0.1 };
        let (dx, dy) = transform.shift_px(101, 51);
        assert!((dx - 3.0).abs() < 1e-12 && (dy + 2.0).abs() < 1e-12);
        assert!((transform.rotation_deg(101, 51) - 0.1f64.to_degrees()).abs() < 1e-9);
        // The point one pixel to the right of the centre moves to (cos, sin) from the shifted centre (53, 23). With y
        // pointing down, this is clockwise on the screen.
        let (x, y) = map(&transform.matrix(101, 51), 51.0, 25.0);
        assert!((x - 53.0 - 0.1f64.cos()).abs() < 1e-12 && (y - 23.0 - 0.1f64.sin()).abs() < 1e-12);
    }

    #[test]
    fn corner_distance_is_that_of_the_worst_corner() {
        let h = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1e-4, 0.0, 1.0);
        // x' = x / (1 + 1e-4 x) and y' = y / (1 + 1e-4 x). The right corners (x = 100) move by 100 - 100 / 1.01
        // horizontally. The lower right corner (y = 50) also moves by 50 - 50 / 1.01 vertically.
        let (across, along): (f64, f64) = (100.0 - 100.0 / 1.01, 50.0 - 50.0 / 1.01);
        let worst = Transform::Homography(h).corner_distance(&Transform::Identity, 101, 51);
        assert!((worst - across.hypot(along)).abs() < 1e-9);
    }
}
