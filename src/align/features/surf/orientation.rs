//! The dominant direction around a keypoint, from Haar wavelets (Bay 2006, section 4.1).

use super::integral::Integral;
use crate::align::features::Keypoint;
use crate::simd::atan2;
use std::f32::consts::PI;

/// Radius of the circle in which wavelets are sampled, in units of the keypoint's scale.
const RADIUS: i32 = 6;
/// Side of a Haar wavelet, in units of the keypoint's scale.
const WAVELET: f32 = 4.0;
/// Standard deviation of the Gaussian weights, in units of the keypoint's scale.
const SIGMA: f32 = 2.5;
/// Width of the sliding window of directions, in radians.
const WINDOW: f32 = PI / 3.0;

/// Returns the direction of `point` in radians, -pi..=pi.
///
/// A window of 60 degrees slides over the directions of the wavelet responses. In each position, the responses within
/// the window are added as vectors. The result is the direction of the longest sum.
pub(super) fn assign(integral: &Integral, point: &Keypoint) -> f32 {
    let s = point.scale;
    let half = (0.5 * WAVELET * s + 0.5) as usize;
    let mut responses: Vec<(f32, [f32; 2])> = Vec::with_capacity(4 * (RADIUS * RADIUS) as usize);
    let weights: [f32; RADIUS as usize + 1] =
        std::array::from_fn(|i| libm::expf(-((i * i) as f32) / (2.0 * SIGMA * SIGMA)));
    for j in -RADIUS..=RADIUS {
        for i in -RADIUS..=RADIUS {
            if i * i + j * j >= RADIUS * RADIUS {
                continue;
            }
            let weight = weights[i.unsigned_abs() as usize] * weights[j.unsigned_abs() as usize];
            let [dx, dy] = integral.haar(point.x + i as f32 * s, point.y + j as f32 * s, half);
            if dx != 0.0 || dy != 0.0 {
                responses.push((atan2(dy, dx), [weight * dx, weight * dy]));
            }
        }
    }
    responses.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut longest = (0.0, 0.0);
    // Every window starts at one of the responses. After the last response, `end` continues with the first response.
    let (n, mut end, mut sum) = (responses.len(), 0, [0.0f64; 2]);
    for start in 0..n {
        while end < start + n {
            let turn = if end < n { 0.0 } else { 2.0 * PI };
            let (angle, [dx, dy]) = responses[end % n];
            if angle + turn - responses[start].0 >= WINDOW {
                break;
            }
            sum = [sum[0] + f64::from(dx), sum[1] + f64::from(dy)];
            end += 1;
        }
        let length = sum[0] * sum[0] + sum[1] * sum[1];
        if length > longest.0 {
            longest = (length, libm::atan2(sum[1], sum[0]));
        }
        let [dx, dy] = responses[start].1;
        sum = [sum[0] - f64::from(dx), sum[1] - f64::from(dy)];
    }
    longest.1 as f32
}
