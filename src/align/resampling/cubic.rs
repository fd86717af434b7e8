//! Cubic interpolation between the pixels of a smoothed plane.
//!
//! In: a plane and a position. Out: the value there; none near the border. Cost: sixteen multiply-adds.
//! Source: Keys, "Cubic Convolution Interpolation for Digital Image Processing", IEEE Trans. ASSP 29(6), 1981.

use crate::plane::Plane;

/// Width of the border in which the refinement chooses no points, in pixels: the reach of the derivative (1) plus that
/// of the interpolation (2).
pub(crate) const BORDER: usize = 3;

/// Returns the value of `plane` at (u, v) by cubic convolution; none within [`BORDER`] - 1 pixels of the border.
#[inline(always)]
pub(crate) fn cubic(plane: &Plane<f32>, u: f64, v: f64) -> Option<f32> {
    let margin = (BORDER - 1) as f64;
    if !(u >= margin
        && v >= margin
        && u < plane.width() as f64 - 1.0 - margin
        && v < plane.height() as f64 - 1.0 - margin)
    {
        return None;
    }
    let (x, y) = (u as usize, v as usize);
    let fraction = [(u - x as f64) as f32, (v - y as f64) as f32];
    Some(interpolate(fraction, |j| &plane.row(y + j - 1)[x - 1..x + 3]))
}

/// Interpolates between 4 x 4 samples, whose rows are `row(0)` to `row(3)`. The position is `fraction` (x, y) to the
/// right of the second column and below the second row.
#[inline(always)]
pub(crate) fn interpolate<'a>(fraction: [f32; 2], row: impl Fn(usize) -> &'a [f32]) -> f32 {
    let [wx, wy] = fraction.map(keys);
    let mut sum = 0.0;
    for (j, w) in wy.iter().enumerate() {
        let row = row(j);
        sum += w * (wx[0] * row[0] + wx[1] * row[1] + wx[2] * row[2] + wx[3] * row[3]);
    }
    sum
}

/// Returns the weights of four samples in a row. The position is between the second and the third sample, at the
/// distance `t` (0..1) from the second (Keys 1981, a = -1/2).
#[inline(always)]
fn keys(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadratic_is_kept_exactly() {
        // Keys' kernel with a = -1/2 reproduces polynomials up to the second degree.
        let f = |x: f64, y: f64| 3.0 + 0.5 * x - 0.25 * y + 0.125 * x * x - 0.0625 * x * y;
        let plane = Plane::from_rows(20, 16, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = f(x as f64, y as f64) as f32;
            }
        });
        for (u, v) in [(5.0, 6.0), (7.25, 8.5), (12.9, 3.1)] {
            // The tolerance is for the rounding of sixteen values below 64.
            assert!((f64::from(cubic(&plane, u, v).unwrap()) - f(u, v)).abs() < 1e-4, "{u} {v}");
        }
        assert_eq!(
            (cubic(&plane, 1.9, 8.0), cubic(&plane, 8.0, 13.0), cubic(&plane, f64::NAN, 8.0)),
            (None, None, None)
        );
    }
}
