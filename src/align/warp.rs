//! Warps: where a pixel of the reference lies in another frame, and resampling a frame by one in a single step.
//!
//! In: a [`Frame`] and a [`Warp`]. Out: code values as floats on the reference's grid, by rows, with a mark where the frame does not
//! reach. Cost: 36 multiply-adds a value (Lanczos, three lobes); a copy where nothing moves.
//! Source: Hartley & Zisserman, Multiple View Geometry (2nd ed., 2004), section 2.4 (a hierarchy of transformations).

use crate::bracket::{Frame, Samples};
use nalgebra::Matrix3;
use std::f64::consts::PI;
use std::ops::Range;

/// Where the reference's pixels lie in a frame: maps **reference pixel -> frame pixel**, both in pixels with (0, 0) at the centre
/// of the top-left one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Warp {
    /// The frame did not move.
    Identity,
    /// x' = c + R(angle) (x - c) + d, c the picture's centre; a shift where the angle is 0.
    Rigid {
        /// Shift to the right, in pixels.
        dx: f64,
        /// Shift downwards, in pixels.
        dy: f64,
        /// Rotation from +x towards +y (clockwise on the screen), in radians.
        angle: f64,
    },
    /// x' ~ H x, with the lower right number 1.
    Homography(Matrix3<f64>),
}

impl Warp {
    /// The warp as a matrix on homogeneous pixel coordinates, for pictures of this size; its lower right number is 1.
    pub fn matrix(&self, width: usize, height: usize) -> Matrix3<f64> {
        match *self {
            Warp::Identity => Matrix3::identity(),
            Warp::Rigid { dx, dy, angle } => {
                let (cx, cy) = centre(width, height);
                let (s, c) = (libm::sin(angle), libm::cos(angle));
                Matrix3::new(
                    c,
                    -s,
                    cx + dx - c * cx + s * cy,
                    s,
                    c,
                    cy + dy - s * cx - c * cy,
                    0.0,
                    0.0,
                    1.0,
                )
            }
            Warp::Homography(h) => h,
        }
    }

    /// How far the picture's centre moves, in pixels.
    pub fn shift_px(&self, width: usize, height: usize) -> (f64, f64) {
        let (cx, cy) = centre(width, height);
        let (x, y) = map(&self.matrix(width, height), cx, cy);
        (x - cx, y - cy)
    }

    /// How far the picture turns at its centre, in degrees, from +x towards +y.
    pub fn rotation_deg(&self, width: usize, height: usize) -> f64 {
        let h = self.matrix(width, height);
        let (cx, cy) = centre(width, height);
        let ((x0, y0), (x1, y1)) = (map(&h, cx - 1.0, cy), map(&h, cx + 1.0, cy));
        libm::atan2(y1 - y0, x1 - x0) * 180.0 / PI
    }

    /// The largest distance between where this warp and another put a corner of the picture, in pixels.
    pub fn corner_distance(&self, other: &Warp, width: usize, height: usize) -> f64 {
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

/// The centre of a picture, between its pixels where a side is even.
pub fn centre(width: usize, height: usize) -> (f64, f64) {
    ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0)
}

/// The centres of the four corner pixels.
pub fn corners(width: usize, height: usize) -> [(f64, f64); 4] {
    let (r, b) = (width as f64 - 1.0, height as f64 - 1.0);
    [(0.0, 0.0), (r, 0.0), (r, b), (0.0, b)]
}

/// x' ~ H x. Not finite on the line that H sends to infinity.
pub fn map(h: &Matrix3<f64>, x: f64, y: f64) -> (f64, f64) {
    let w = h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)];
    (
        (h[(0, 0)] * x + h[(0, 1)] * y + h[(0, 2)]) / w,
        (h[(1, 0)] * x + h[(1, 1)] * y + h[(1, 2)]) / w,
    )
}

/// What [`resample_rows`] puts into all three channels where the frame has no pixel.
pub const OUTSIDE: f32 = -1.0;

/// The frame's code values, on the scale 0..=255 whatever its depth, at the reference's pixels `columns` x `rows`, by rows into `out`.
///
/// A pixel whose place in the frame is outside the rectangle of its pixel centres is [`OUTSIDE`] in all channels.
///
/// # Panics
/// When `out` does not hold `columns.len() * rows.len()` pixels.
pub fn resample_rows(frame: &Frame, warp: &Warp, columns: Range<usize>, rows: Range<usize>, out: &mut [[f32; 3]]) {
    assert_eq!(out.len(), columns.len() * rows.len());
    let h = warp.matrix(frame.width(), frame.height());
    for (y, line) in rows.zip(out.chunks_exact_mut(columns.len().max(1))) {
        for (x, pixel) in columns.clone().zip(line) {
            let (u, v) = map(&h, x as f64, y as f64);
            *pixel = nearest(frame, u, v);
        }
    }
}

fn nearest(frame: &Frame, u: f64, v: f64) -> [f32; 3] {
    let (x, y) = ((u + 0.5).floor(), (v + 0.5).floor());
    if !(x >= 0.0 && y >= 0.0 && x < frame.width() as f64 && y < frame.height() as f64) {
        return [OUTSIDE; 3];
    }
    let i = 3 * (y as usize * frame.width() + x as usize);
    match frame.samples() {
        Samples::Eight(s) => [s[i], s[i + 1], s[i + 2]].map(f32::from),
        Samples::Sixteen(s) => [s[i], s[i + 1], s[i + 2]].map(|c| f32::from(c) / 257.0),
    }
}
