//! Gradients as length and direction, and the Gaussian that weighs them, without the platform's functions.

use crate::plane::Plane;
use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::LazyLock;

/// The gradient at (x, y), which must not be on the border: its length and its direction from +x towards +y, in radians.
#[inline]
pub(super) fn gradient(level: &Plane<f32>, x: usize, y: usize) -> (f32, f32) {
    let dx = level.at(x + 1, y) - level.at(x - 1, y);
    let dy = level.at(x, y + 1) - level.at(x, y - 1);
    ((dx * dx + dy * dy).sqrt(), atan2(dy, dx))
}

/// atan2 to within 2e-4 rad, a hundredth of a degree: a thousandth of a histogram's bin.
#[inline]
pub(super) fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ax < ay { (ax, ay) } else { (ay, ax) };
    if high == 0.0 {
        return 0.0;
    }
    let a = low / high;
    let s = a * a;
    // Minimax polynomial of atan on 0..=1 in odd powers.
    let r = ((-0.046_496_473 * s + 0.159_314_22) * s - 0.327_622_76) * s * a + a;
    let r = if ay > ax { FRAC_PI_2 - r } else { r };
    let r = if x < 0.0 { PI - r } else { r };
    if y < 0.0 { -r } else { r }
}

/// Steps of the table of exp(-t) for each unit of t.
const STEPS: f32 = 256.0;
static EXP: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..=(16.0 * STEPS) as usize).map(|i| libm::exp(-(i as f64) / f64::from(STEPS)) as f32).collect());

/// exp(-t) for t >= 0 to within 1/512 of itself; 0 from 16 on.
#[inline]
pub(super) fn exp_minus(table: &[f32], t: f32) -> f32 {
    table.get((t * STEPS + 0.5) as usize).copied().unwrap_or(0.0)
}

/// The table that [`exp_minus`] reads.
pub(super) fn exp_table() -> &'static [f32] {
    &EXP
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_angle_is_that_of_the_platform() {
        for i in 0..3600 {
            let angle = (i as f32 - 1799.5) / 1800.0 * PI;
            let (y, x) = (7.0 * angle.sin(), 7.0 * angle.cos());
            assert!((atan2(y, x) - y.atan2(x)).abs() < 2e-4, "{angle}");
        }
        assert_eq!(atan2(0.0, 0.0), 0.0);
    }

    #[test]
    fn the_exponential_is_that_of_the_platform() {
        for i in 0..1000 {
            let t = i as f32 * 0.0159;
            assert!((exp_minus(exp_table(), t) / (-t).exp() - 1.0).abs() < 1.0 / 500.0);
        }
        assert_eq!(exp_minus(exp_table(), 1e9), 0.0);
    }
}
