//! Brightness: the power function that brings the mean code value of a picture to a target.
//!
//! In: luminances of a picture, relative to display white. Out: the exponent to apply to them. Cost: 40 ns for each
//! luminance in each bisection step. A power function is used because it keeps black, white and the order of
//! luminances.

use crate::bracket::colour::linear_to_srgb;

/// Returns the exponent between `low` and `high` that brings the mean code value (0 to 1) of `linear` nearest to
/// `brightness`. It is found by `halvings` steps of bisection.
pub(crate) fn power(linear: &[f64], brightness: f64, (mut low, mut high): (f64, f64), halvings: usize) -> f64 {
    for _ in 0..halvings {
        let power = 0.5 * (low + high);
        let codes = linear.iter().map(|l| linear_to_srgb(libm::pow(*l, power)));
        if codes.sum::<f64>() / linear.len() as f64 > brightness {
            low = power;
        } else {
            high = power;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_code_is_the_requested_one_or_the_closest() {
        let linear: Vec<f64> = (0..1000).map(|i| f64::from(i) / 999.0).collect();
        let found = |brightness| power(&linear, brightness, (0.5, 2.0), 30);
        for brightness in [0.55, 0.7, 0.8] {
            let power = found(brightness);
            let mean = linear.iter().map(|l| linear_to_srgb(l.powf(power))).sum::<f64>() / 1000.0;
            assert!((mean - brightness).abs() < 1e-6, "{brightness}: {power} {mean}");
        }
        // The range of exponents, from 0.5 to 2, is 1.4e-9 wide after thirty halvings.
        assert!((found(0.0) - 2.0).abs() < 1e-8 && (found(1.0) - 0.5).abs() < 1e-8);
    }
}
