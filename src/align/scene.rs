//! A random scene for the tests of the alignment, with smooth parts and edges at many scales. The radiance is known at
//! every position, so that photographs under any transform and exposure are computed without resampling.
//!
//! In: a seed, a transform, an exposure. Out: grey planes. Cost: about 0.1 us per pixel.

use crate::align::transform::{Transform, map};
use crate::plane::Plane;

/// A random scene.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene {
    seed: u64,
}

/// The exposure and noise of a photograph. The camera's response is x^(1/2.2); at 0 EV, radiance 1 gives code value
/// 117, and radiance 5.6 is clipped.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shot {
    /// Exposure, in EV.
    pub(crate) ev: f64,
    /// Standard deviation of the noise, in code values, before rounding.
    pub(crate) noise: f64,
    /// Seed of the noise.
    pub(crate) seed: u64,
}

impl Shot {
    pub(crate) fn at(ev: f64) -> Self {
        Shot { ev, noise: 1.5, seed: (ev * 8.0) as i64 as u64 }
    }
}

/// The layers of noise that are added up to the scene: for each, the spacing of its lattice in pixels, and its weight
/// in stops. The finest layer has features of about 5 px, which the pixels sample well.
const LAYERS: [(f64, f64); 5] = [(150.0, 2.0), (61.0, 2.0), (27.0, 1.7), (12.0, 1.2), (5.3, 0.7)];

impl Scene {
    pub(crate) fn new(seed: u64) -> Self {
        Scene { seed }
    }

    /// Returns the radiance at (x, y). Nearly everywhere it is within 2^-6 to 2^6, and its median is about 1.
    pub(crate) fn radiance(&self, x: f64, y: f64) -> f64 {
        let mut stops = 0.0;
        for (k, (spacing, weight)) in LAYERS.iter().enumerate() {
            // Every layer's lattice is rotated by another angle, so that none is aligned to the pixels.
            let (s, c) = (0.5 + 0.7 * k as f64).sin_cos();
            stops += weight * self.layer(k as u64, (c * x - s * y) / spacing, (s * x + c * y) / spacing);
        }
        // Objects: where a layer with a lattice of 35 px is positive, the scene is 1.5 stops brighter than elsewhere;
        // the edge is about 2 px wide.
        let objects = self.layer(9, (0.8 * x + 0.6 * y) / 35.0, (0.8 * y - 0.6 * x) / 35.0);
        stops += 0.75 * (16.0 * objects).tanh();
        stops.exp2()
    }

    /// Returns smooth noise within -1..=1: random values at integer positions, interpolated by a quintic polynomial.
    fn layer(&self, k: u64, x: f64, y: f64) -> f64 {
        let (i, j) = (x.floor(), y.floor());
        let ease = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
        let (u, v) = (ease(x - i), ease(y - j));
        let at = |di: i64, dj: i64| 2.0 * uniform(self.seed ^ (k << 32), i as i64 + di, j as i64 + dj) - 1.0;
        let (top, bottom) = (at(0, 0) + u * (at(1, 0) - at(0, 0)), at(0, 1) + u * (at(1, 1) - at(0, 1)));
        top + v * (bottom - top)
    }

    /// Returns the photograph by a camera that moved by `transform`, which maps a position of the scene (a pixel of an
    /// unmoved camera) to a pixel of the photograph.
    pub(crate) fn photograph(&self, size: (usize, usize), transform: &Transform, shot: Shot) -> Plane<u8> {
        photograph(size, transform, shot, |x, y| self.radiance(x, y))
    }
}

/// Returns the photograph of a scene that has `radiance(x, y)` at each position.
pub(crate) fn photograph(
    (width, height): (usize, usize),
    transform: &Transform,
    shot: Shot,
    radiance: impl Fn(f64, f64) -> f64 + Sync,
) -> Plane<u8> {
    let back = transform.matrix(width, height).try_inverse().unwrap();
    let gain = 0.18 * shot.ev.exp2();
    Plane::from_rows(width, height, |y, row| {
        for (x, v) in row.iter_mut().enumerate() {
            let (u, w) = map(&back, x as f64, y as f64);
            let code = 255.0 * (gain * radiance(u, w)).min(1.0).powf(1.0 / 2.2);
            // The sum of four uniform numbers is nearly normal. Each has a variance of 1/12, so the sum has a standard
            // deviation of 1 / sqrt(3).
            let sum: f64 = (0..4).map(|k| uniform(shot.seed.wrapping_mul(77) + k, x as i64, y as i64) - 0.5).sum();
            let noisy = code + shot.noise * sum * 3f64.sqrt();
            // A clipped pixel has the value 255, whatever its noise.
            *v = if code >= 255.0 { 255 } else { noisy.round().clamp(0.0, 255.0) as u8 };
        }
    })
}

/// Returns a pseudorandom number in 0..1 that depends only on the arguments, by the mixing function of SplitMix64.
pub(crate) fn uniform(seed: u64, i: i64, j: i64) -> f64 {
    let mut z = seed
        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
        .wrapping_add((i as u64).wrapping_mul(0xD1B5_4A32_D192_ED03))
        .wrapping_add((j as u64).wrapping_mul(0xABC9_8388_FB8F_AC03));
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Returns a shift by (dx, dy) pixels.
pub(crate) fn shift(dx: f64, dy: f64) -> Transform {
    Transform::Rigid { dx, dy, angle: 0.0 }
}

/// Returns a shift by (dx, dy) pixels and a rotation in degrees.
pub(crate) fn rigid(dx: f64, dy: f64, degrees: f64) -> Transform {
    Transform::Rigid { dx, dy, angle: degrees.to_radians() }
}

/// Returns a perspective transform. It displaces the four corners of a picture with sides of some hundred pixels by
/// some pixels, each corner differently.
pub(crate) fn perspective() -> Transform {
    Transform::Homography(nalgebra::Matrix3::new(1.004, 0.006, -2.3, -0.005, 0.997, 3.1, 1.2e-5, -1.6e-5, 1.0))
}
