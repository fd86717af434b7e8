//! The normal equations of a refinement step.
//!
//! In: for each point, its residual r, its precision, and the derivatives J^T g of its grey value by the parameters (J:
//! Jacobian of the position by the parameters, g: gradient of the grey value). Out: the matrix A = sum w J^T g g^T J
//! and the vector b = sum w J^T g r, with a robust weight w for each point. Cost: at most 56 multiply-adds per point
//! for eight parameters. Source: Baker, Gross, Ishikawa & Matthews, "Lucas-Kanade 20 Years On: Part 2",
//! CMU-RI-TR-03-01, 2003 (robust error functions, iteratively reweighted least squares); the weights are Tukey's
//! biweight.

use crate::align::refinement::frame_pair::Point;
use crate::simd::{Loops, vectorised};
use crate::statistics;
use nalgebra::{DMatrix, DVector};

/// [`statistics::TUKEY`] in single precision.
const TUKEY: f32 = statistics::TUKEY as f32;

/// Returns A and b for the first `n` parameters.
///
/// `rows` has J^T g of each point, with zeros from element `n` on. `residuals` has frame minus reference at each point.
/// Outside the frame it is NaN, and the point's weight in `weights` must be 0.
pub(super) fn equations(
    n: usize,
    rows: &[[f64; 8]],
    residuals: &[f32],
    weights: &[f32],
) -> (DMatrix<f64>, DVector<f64>) {
    let (a, b) = if n <= 4 {
        vectorised(Sums::<4> { weights, rows, residuals })
    } else {
        vectorised(Sums::<8> { weights, rows, residuals })
    };
    (DMatrix::from_fn(n, n, |i, k| a[i.min(k)][i.max(k)]), DVector::from_fn(n, |i, _| b[i]))
}

/// Computes the weight w of every point, 0 where the residual is NaN. `noise` is the standard deviation of the
/// residuals times the precisions.
pub(super) fn weights(points: &[Point], residuals: &[f32], noise: f32, weights: &mut [f32]) {
    vectorised(Weights { points, residuals, noise, weights });
}

/// Does the work of [`weights`].
struct Weights<'a> {
    points: &'a [Point],
    residuals: &'a [f32],
    noise: f32,
    weights: &'a mut [f32],
}

impl Loops for Weights<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let noise = self.noise;
        for (w, (p, r)) in self.weights.iter_mut().zip(self.points.iter().zip(self.residuals)) {
            *w = tukey_weight(r * p.precision / noise) * p.precision * p.precision / (noise * noise);
        }
    }
}

/// Returns Tukey's biweight for `r`, a residual divided by its standard deviation; 0 for NaN.
#[inline(always)]
fn tukey_weight(r: f32) -> f32 {
    let t = r / TUKEY;
    let inside = 1.0 - t * t;
    let inside = if inside > 0.0 { inside } else { 0.0 };
    inside * inside
}

/// Computes A and b for the first `N` parameters. The sums over the points are in the order of the points. Only the
/// upper triangle of A is complete.
struct Sums<'a, const N: usize> {
    weights: &'a [f32],
    rows: &'a [[f64; 8]],
    residuals: &'a [f32],
}

impl<const N: usize> Loops for Sums<'_, N> {
    type Output = ([[f64; 8]; 8], [f64; 8]);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let (mut a, mut b) = ([[0.0f64; 8]; 8], [0.0f64; 8]);
        for ((w, row), r) in self.weights.iter().zip(self.rows).zip(self.residuals) {
            let (w, r) = (f64::from(*w), f64::from(*r));
            if w == 0.0 {
                continue;
            }
            for i in 0..N {
                b[i] += w * row[i] * r;
            }
            for i in 0..N {
                let weighed = w * row[i];
                // Columns are processed in groups of four, beginning with the group that contains the diagonal.
                for k in i / 4 * 4..N {
                    a[i][k] += weighed * row[k];
                }
            }
        }
        (a, b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sums_are_those_of_the_formula_to_the_bit() {
        let value = |i: usize| ((i * 7919 % 1013) as f64 - 500.0) / 97.0;
        let count = 331;
        let points: Vec<Point> = (0..count)
            .map(|i| Point { x: 0.0, y: 0.0, value: 0.0, gradient: [0.0; 2], precision: 0.1 + (i % 7) as f32 / 8.0 })
            .collect();
        // Every eleventh point is outside the frame; some others have a weight of 0.
        let residuals: Vec<f32> = (0..count).map(|i| if i % 11 == 3 { f32::NAN } else { value(i) as f32 }).collect();
        let noise = 0.8f32;
        for n in [2, 3, 8] {
            let rows: Vec<[f64; 8]> =
                (0..count).map(|i| std::array::from_fn(|k| if k < n { value(8 * i + k) } else { 0.0 })).collect();
            let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
            for ((p, j), r) in points.iter().zip(&rows).zip(&residuals).filter(|(_, r)| !r.is_nan()) {
                let t = r * p.precision / noise / TUKEY;
                let inside = (1.0 - t * t).max(0.0);
                let w = f64::from(inside * inside * p.precision * p.precision / (noise * noise));
                for i in 0..n {
                    b[i] += w * j[i] * f64::from(*r);
                    for k in 0..n {
                        a[(i, k)] += w * j[i.min(k)] * j[i.max(k)];
                    }
                }
            }
            assert!(a[(0, 0)] > 0.0);
            let mut found = vec![0.0f32; count];
            weights(&points, &residuals, noise, &mut found);
            assert_eq!(equations(n, &rows, &residuals, &found), (a, b), "{n}");
        }
    }
}
