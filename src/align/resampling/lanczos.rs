//! The Lanczos kernel with three lobes, in a table.
//!
//! In: a position between pixels. Out: the pixels around it and their weights, which sum to 1. Cost: negligible.
//! Source: Turkowski, "Filters for Common Resampling Tasks", Graphics Gems I (1990).

use crate::simd::{floor64, integer64};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Number of pixels under the kernel, along each axis.
pub(crate) const TAPS: usize = 6;
/// Number of pixels under the kernel that come before the pixel at the position rounded down.
pub(crate) const BEFORE: usize = 2;
/// Number of phases (tabulated positions between two pixels) of the kernel. Positions are rounded to the nearest phase.
/// This changes a value by less than 0.2 of 255 along each axis, even at edges from 0 to 255.
const PHASES: usize = 1024;

/// Returns the index of the first pixel under the kernel at `position`, and the phase. `position` is clamped to
/// 0..=`last` first.
#[inline(always)]
pub(crate) fn taps_at(position: f64, last: f64) -> (i32, i32) {
    let position = if position > 0.0 { position } else { 0.0 };
    let position = if position < last { position } else { last };
    let whole = floor64(position);
    let phase = floor64((position - whole) * PHASES as f64 + 0.5);
    (integer64(whole) as i32 - BEFORE as i32, integer64(phase) as i32)
}

/// The kernel's weights at each phase.
pub(crate) static WEIGHTS: LazyLock<Vec<[f32; TAPS]>> = LazyLock::new(|| {
    let weights = |phase| {
        let fraction = f64::from(phase) / PHASES as f64;
        let raw: [f64; TAPS] = std::array::from_fn(|i| lanczos3(i as f64 - BEFORE as f64 - fraction));
        let sum: f64 = raw.iter().sum();
        raw.map(|w| (w / sum) as f32)
    };
    (0..=PHASES as u32).map(weights).collect()
});

/// The Lanczos kernel: sinc(x) sinc(x / 3) for |x| < 3, otherwise 0, where sinc(x) = sin(pi x) / (pi x).
pub(crate) fn lanczos3(x: f64) -> f64 {
    if x == 0.0 {
        1.0
    } else if x.abs() >= 3.0 {
        0.0
    } else {
        let t = PI * x;
        3.0 * libm::sin(t) * libm::sin(t / 3.0) / (t * t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_rounded_down_and_phases_to_the_nearest() {
        for (at, whole, phase) in
            [(0.0, 0, 0), (0.9999, 0, 1024), (1.0, 1, 0), (7.25, 7, 256), (4094.0 + 1.4 / 1024.0, 4094, 1)]
        {
            assert_eq!(taps_at(at, 5000.0), (whole - BEFORE as i32, phase), "{at}");
        }
        assert_eq!([taps_at(-3.0, 9.0), taps_at(f64::NAN, 9.0), taps_at(12.5, 9.0)].map(|p| p.0 + 2), [0, 0, 9]);
    }

    #[test]
    fn weights_sum_to_one_and_whole_places_have_one() {
        for weights in WEIGHTS.iter() {
            // The tolerance is for the rounding of six values below 1 to 24 bits.
            assert!((weights.iter().sum::<f32>() - 1.0).abs() < 4e-7);
        }
        let (first, phase) = taps_at(3.0, 9.0);
        assert!(first + BEFORE as i32 == 3 && (WEIGHTS[phase as usize][BEFORE] - 1.0).abs() < 1e-6);
    }
}
