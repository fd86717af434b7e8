//! Descriptors: sums of Haar wavelets in 4 x 4 cells around a keypoint (Bay 2006, section 4.2).

use super::integral::Integral;
use crate::align::features::{Keypoint, SurfDescriptor};

/// Number of cells along each side of the descriptor.
const CELLS: usize = 4;
/// Number of samples along each side of a cell. Neighbouring samples are as far apart as the keypoint's scale.
const SAMPLES: usize = 5;
/// Standard deviation of the Gaussian weights, in units of the keypoint's scale.
const SIGMA: f32 = 3.3;
/// Euclidean length of the stored descriptor. With a larger length, more entries would exceed the range of a signed
/// byte and be clamped.
pub(in crate::align::features) const LENGTH: f32 = 256.0;

/// Returns the descriptor of `point` relative to the direction `angle`: for each cell the sums of dx, |dx|, dy and
/// |dy|.
pub(super) fn describe(integral: &Integral, point: &Keypoint, angle: f32) -> SurfDescriptor {
    let (sin, cos) = (libm::sinf(angle), libm::cosf(angle));
    let s = point.scale;
    // The Haar wavelets have a side of 2 s.
    let half = ((s + 0.5) as usize).max(1);
    let mut sums = [0.0f32; 4 * CELLS * CELLS];
    let side = CELLS * SAMPLES;
    let middle = (side as f32 - 1.0) / 2.0;
    let weights: [f32; CELLS * SAMPLES] = std::array::from_fn(|i| {
        let off = i as f32 - middle;
        libm::expf(-off * off / (2.0 * SIGMA * SIGMA))
    });
    for j in 0..side {
        for i in 0..side {
            let (u, v) = (s * (i as f32 - middle), s * (j as f32 - middle));
            let [dx, dy] = integral.haar(point.x + cos * u - sin * v, point.y + sin * u + cos * v, half);
            let weight = weights[i] * weights[j];
            let (along, across) = (weight * (cos * dx + sin * dy), weight * (cos * dy - sin * dx));
            let cell = &mut sums[4 * (j / SAMPLES * CELLS + i / SAMPLES)..][..4];
            cell[0] += along;
            cell[1] += along.abs();
            cell[2] += across;
            cell[3] += across.abs();
        }
    }
    let length = sums.iter().map(|v| v * v).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
    sums.map(|v| (v / length * LENGTH).round().clamp(-127.0, 127.0) as i8)
}
