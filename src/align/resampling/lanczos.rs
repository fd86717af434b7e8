//! Lanczos' kernel with three lobes, in tables.
//!
//! In: a place between pixels. Out: the pixels about it and their weights, which sum to 1. Cost: negligible.
//! Source: Turkowski, "Filters for Common Resampling Tasks", Graphics Gems I (1990).

use crate::simd::{floor64, integer64};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Pixels under the kernel, along each axis.
pub(crate) const TAPS: usize = 6;
/// Of these, how many lie before the pixel that the place falls behind.
pub(crate) const BEFORE: usize = 2;
/// Positions of the kernel between two pixels: 1/1024 px apart, so that the rounding is under a tenth of a code at the
/// steepest edge.
const PHASES: usize = 1024;

/// The first pixel under the kernel at `place`, brought into 0..=`last`, and the phase.
#[inline(always)]
pub(crate) fn place(place: f64, last: f64) -> (i32, i32) {
    let place = if place > 0.0 { place } else { 0.0 };
    let place = if place < last { place } else { last };
    let whole = floor64(place);
    let phase = floor64((place - whole) * PHASES as f64 + 0.5);
    (integer64(whole) as i32 - BEFORE as i32, integer64(phase) as i32)
}

/// The kernel's weights at each of its positions between two pixels.
pub(crate) struct Kernel {
    pub weights: Vec<[f32; TAPS]>,
}

pub(crate) static LANCZOS3: LazyLock<Kernel> = LazyLock::new(|| Kernel {
    weights: (0..=PHASES)
        .map(|phase| {
            let fraction = phase as f64 / PHASES as f64;
            let raw: [f64; TAPS] = std::array::from_fn(|i| lanczos3(i as f64 - BEFORE as f64 - fraction));
            let sum: f64 = raw.iter().sum();
            raw.map(|w| (w / sum) as f32)
        })
        .collect(),
});

impl Kernel {
    /// The pixel that place `u` falls behind, and the weights.
    #[inline(always)]
    pub fn place(&self, u: f64) -> (usize, &[f32; TAPS]) {
        let (left, phase) = place(u, f64::from(i32::MAX));
        ((left + BEFORE as i32) as usize, &self.weights[phase as usize])
    }
}

/// sinc(x) sinc(x / 3) for |x| < 3, otherwise 0.
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
            assert_eq!(place(at, 5000.0), (whole - BEFORE as i32, phase), "{at}");
        }
        assert_eq!([place(-3.0, 9.0), place(f64::NAN, 9.0), place(12.5, 9.0)].map(|p| p.0 + 2), [0, 0, 9]);
    }

    #[test]
    fn weights_sum_to_one_and_whole_places_have_one() {
        for weights in &LANCZOS3.weights {
            // Six roundings to 24 bits of numbers below 1.
            assert!((weights.iter().sum::<f32>() - 1.0).abs() < 4e-7);
        }
        let nearest = LANCZOS3.place(3.0);
        assert!(nearest.0 == 3 && (nearest.1[BEFORE] - 1.0).abs() < 1e-6);
    }
}
