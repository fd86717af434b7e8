//! The motion of the camera between the frames, and the resampling of the large picture for each frame.
//!
//! Convention, as everywhere in hdralign: a homography maps pixel coordinates of the reference frame (x right, y down,
//! (0, 0) the centre of the top-left pixel) to pixel coordinates of the frame.

use rayon::prelude::*;

use super::scene::{FOCAL, HEIGHT, WIDTH};
use super::vec3::{V3, v3};

/// A 3 x 3 matrix by rows.
pub type Matrix = [[f64; 3]; 3];

/// The motion of one frame: rotations in degrees, shift in pixels.
pub struct Motion {
    pub pan: f64,
    pub tilt: f64,
    pub roll: f64,
    pub shift: [f64; 2],
}

/// The motion of each frame; the middle one, the reference, does not move.
pub const HANDS: [Motion; 5] = [
    Motion { pan: 0.62, tilt: -0.35, roll: -0.48, shift: [-6.3, 9.7] },
    Motion { pan: -0.38, tilt: 0.31, roll: 0.83, shift: [11.6, -4.4] },
    Motion { pan: 0.0, tilt: 0.0, roll: 0.0, shift: [0.0, 0.0] },
    Motion { pan: 0.33, tilt: 0.54, roll: -0.71, shift: [7.9, 13.2] },
    Motion { pan: -0.81, tilt: -0.42, roll: 0.36, shift: [-15.4, -10.8] },
];

pub fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

pub fn inverse(m: &Matrix) -> Matrix {
    let minor = |i: usize, j: usize| {
        let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let det: f64 = (0..3).map(|j| m[0][j] * minor(0, j)).sum();
    std::array::from_fn(|i| std::array::from_fn(|j| minor(j, i) / det))
}

/// Returns the point to which `m` maps the point (x, y).
pub fn apply(m: &Matrix, x: f64, y: f64) -> [f64; 2] {
    let row = |r: &[f64; 3]| r[0] * x + r[1] * y + r[2];
    let w = row(&m[2]);
    [row(&m[0]) / w, row(&m[1]) / w]
}

/// Returns the homography T K Rx(tilt) Ry(pan) Rz(roll) K^-1: reference pixel -> frame pixel.
pub fn homography(m: &Motion) -> Matrix {
    let turn = |degrees: f64| degrees.to_radians().sin_cos();
    let ((sx, cx), (sy, cy), (sz, cz)) = (turn(m.tilt), turn(m.pan), turn(m.roll));
    let x = [[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]];
    let y = [[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]];
    let z = [[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]];
    let k = [[FOCAL, 0.0, (WIDTH as f64 - 1.0) / 2.0], [0.0, FOCAL, (HEIGHT as f64 - 1.0) / 2.0], [0.0, 0.0, 1.0]];
    let t = [[1.0, 0.0, m.shift[0]], [0.0, 1.0, m.shift[1]], [0.0, 0.0, 1.0]];
    let h = product(&product(&t, &k), &product(&product(&product(&x, &y), &z), &inverse(&k)));
    // The scale of a homography is arbitrary; by convention the last element is 1.
    std::array::from_fn(|i| std::array::from_fn(|j| h[i][j] / h[2][2]))
}

/// The large picture. Its pixel (i, j) has its upper left corner at (left + i / scale, top + j / scale), in pixels from
/// the upper left corner of the reference frame.
pub struct Plate {
    pub pixels: Vec<V3>,
    pub width: usize,
    pub height: usize,
    pub left: f64,
    pub top: f64,
    pub scale: f64,
}

impl Plate {
    /// Returns the radiance at the pixel coordinates (x, y) of the reference frame, by Catmull-Rom interpolation,
    /// limited to the range of the nearest four pixels, so that there is no ringing.
    fn at(&self, x: f64, y: f64) -> V3 {
        let (u, v) = ((x + 0.5 - self.left) * self.scale - 0.5, (y + 0.5 - self.top) * self.scale - 0.5);
        let (i, j) = (u.floor(), v.floor());
        let weights = |t: f32| {
            let (t2, t3) = (t * t, t * t * t);
            [-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, -0.5 * t2 + 0.5 * t3]
        };
        let (wx, wy) = (weights((u - i) as f32), weights((v - j) as f32));
        let get = |a: isize, b: isize| {
            let p = (i as isize + a).clamp(0, self.width as isize - 1) as usize;
            let q = (j as isize + b).clamp(0, self.height as isize - 1) as usize;
            self.pixels[q * self.width + p]
        };
        let mut sum = V3::ZERO;
        for b in 0..4 {
            for a in 0..4 {
                sum += get(a as isize - 1, b as isize - 1) * (wx[a] * wy[b]);
            }
        }
        let near = [get(0, 0), get(1, 0), get(0, 1), get(1, 1)];
        let (lo, hi) = near.into_iter().fold((near[0], near[0]), |(lo, hi), p| (lo.min(p), hi.max(p)));
        sum.max(lo).min(hi)
    }

    /// Returns the radiance on each pixel of the frame with the homography `h`: the mean of 3 x 3 points in the pixel.
    pub fn frame(&self, h: &Matrix) -> Vec<V3> {
        let back = inverse(h);
        (0..WIDTH * HEIGHT)
            .into_par_iter()
            .map(|k| {
                let (x, y) = ((k % WIDTH) as f64, (k / WIDTH) as f64);
                let points =
                    (0..9).map(|q| apply(&back, x + f64::from(q % 3 - 1) / 3.0, y + f64::from(q / 3 - 1) / 3.0));
                points.fold(v3(0.0, 0.0, 0.0), |sum, [u, v]| sum + self.at(u, v)) / 9.0
            })
            .collect()
    }
}
