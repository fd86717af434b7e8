//! MS-SSIM: the structural similarity of two pictures at five scales.
//!
//! In: two pictures in linear light. Out: 1 when they are the same, otherwise less. Cost: 0.1 us per pixel. Source:
//! Wang, Simoncelli & Bovik 2003, "Multi-scale structural similarity for image quality assessment", equation 7 and
//! section 3.2 (the exponents); the window of Wang, Bovik, Sheikh & Simoncelli 2004, section III.B: a Gaussian of 11 x
//! 11 pixels with a standard deviation of 1.5 pixels; K1 = 0.01, K2 = 0.03.
//!
//! The pictures are converted to PU21 luminance, so that radiance is compared as perceived. The dynamic range L of the
//! paper is 256, the encoded value of 100 cd/m2, because PU21 is made for metrics that expect 8-bit pictures. A picture
//! that is too small for five scales is compared at as many scales as fit, with exponents that are normalised to sum to
//! 1.

use super::pu21::Light;
use crate::plane::{Plane, fold_bands};
use crate::simd::{Loops, vectorised};
use std::ops::Range;

/// Exponents from the finest scale to the coarsest.
const EXPONENTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
/// Side of the window in pixels.
const WINDOW: usize = 11;
/// (K1 L)^2, which stabilises the comparison of luminance.
const C1: f64 = 2.56 * 2.56;
/// (K2 L)^2, which stabilises the comparison of contrast and structure.
const C2: f64 = 7.68 * 7.68;

/// Returns the similarity of `a` and `b`; `None` if they are smaller than the window.
pub(super) fn ms_ssim(a: &Light, b: &Light) -> Option<f64> {
    score(a.luminance(), b.luminance())
}

/// Returns the similarity of a picture of this size with itself: 1, or `None` if it is smaller than the window.
pub(super) fn of_equals((width, height): (usize, usize)) -> Option<f64> {
    (width.min(height) >= WINDOW).then_some(1.0)
}

fn score(mut a: Plane<f32>, mut b: Plane<f32>) -> Option<f64> {
    let room = |plane: &Plane<f32>| plane.width().min(plane.height()) >= WINDOW;
    let mut scores: Vec<[f64; 2]> = Vec::new();
    while scores.len() < EXPONENTS.len() && room(&a) {
        if !scores.is_empty() {
            (a, b) = (halved(&a), halved(&b));
            if !room(&a) {
                break;
            }
        }
        scores.push(similarity(&a, &b));
    }
    let exponents = &EXPONENTS[..scores.len()];
    let sum: f64 = exponents.iter().sum();
    let coarsest = scores.len().checked_sub(1)?;
    // The product contains contrast and structure at every scale, and luminance only at the coarsest scale. Negative
    // means count as 0.
    let parts = scores.iter().zip(exponents).enumerate().map(|(i, ([whole, contrast], exponent))| {
        let mean = if i == coarsest { whole } else { contrast };
        libm::pow(mean.max(0.0), exponent / sum)
    });
    Some(parts.product())
}

/// Returns the means of blocks of 2 x 2 pixels; a last row or column without a partner is ignored.
fn halved(plane: &Plane<f32>) -> Plane<f32> {
    Plane::from_rows(plane.width() / 2, plane.height() / 2, |y, row| {
        let (upper, lower) = (plane.row(2 * y), plane.row(2 * y + 1));
        for (x, v) in row.iter_mut().enumerate() {
            *v = 0.25 * ((upper[2 * x] + upper[2 * x + 1]) + (lower[2 * x] + lower[2 * x + 1]));
        }
    })
}

/// Returns the weights of the window along one side; they sum to 1.
fn gaussian() -> [f64; WINDOW] {
    let weights: [f64; WINDOW] = std::array::from_fn(|i| {
        let d = i as f64 - (WINDOW / 2) as f64;
        libm::exp(-d * d / (2.0 * 1.5 * 1.5))
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// Returns the means of l(x, y) c(x, y) s(x, y) and of c(x, y) s(x, y) (luminance, contrast, structure), over all
/// positions where the window is within the picture.
fn similarity(a: &Plane<f32>, b: &Plane<f32>) -> [f64; 2] {
    let (width, height) = (a.width() + 1 - WINDOW, a.height() + 1 - WINDOW);
    let weights = gaussian();
    let sums = fold_bands(
        height,
        |rows: Range<usize>| {
            let mut sums = [0.0; 2];
            let mut columns = vec![[0.0; 5]; a.width()];
            for y in rows {
                let [whole, contrast] = vectorised(Row { a, b, y, weights: &weights, columns: &mut columns });
                sums[0] += whole;
                sums[1] += contrast;
            }
            sums
        },
        [0.0; 2],
        |sum, more: [f64; 2]| [sum[0] + more[0], sum[1] + more[1]],
    );
    sums.map(|s| s / (width * height) as f64)
}

/// The windows of one row, whose similarities are summed.
struct Row<'a> {
    a: &'a Plane<f32>,
    b: &'a Plane<f32>,
    y: usize,
    weights: &'a [f64; WINDOW],
    /// Buffer for the weighted sums down each column: of a, b, aa, bb and ab.
    columns: &'a mut [[f64; 5]],
}

impl Loops for Row<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn run(self) -> [f64; 2] {
        let Row { a, b, y, weights, columns } = self;
        columns.fill([0.0; 5]);
        for (i, &w) in weights.iter().enumerate() {
            for ((sums, &p), &q) in columns.iter_mut().zip(a.row(y + i)).zip(b.row(y + i)) {
                let (p, q) = (f64::from(p), f64::from(q));
                let terms = [p, q, p * p, q * q, p * q];
                for k in 0..5 {
                    sums[k] += w * terms[k];
                }
            }
        }
        let mut total = [0.0; 2];
        for window in columns.windows(WINDOW) {
            let mut m = [0.0; 5];
            for (column, &w) in window.iter().zip(weights) {
                for k in 0..5 {
                    m[k] += w * column[k];
                }
            }
            let [p, q, pp, qq, pq] = m;
            let (pp, qq, pq) = (pp - p * p, qq - q * q, pq - p * q);
            let luminance = (2.0 * p * q + C1) / (p * p + q * q + C1);
            let contrast = (2.0 * pq + C2) / (pp + qq + C2);
            total[0] += luminance * contrast;
            total[1] += contrast;
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(i: usize) -> f32 {
        (i.wrapping_mul(2_654_435_761) >> 7 & 0xff) as f32
    }

    fn texture(width: usize, height: usize) -> Plane<f32> {
        Plane::from_rows(width, height, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = 128.0 + 60.0 * libm::sinf(x as f32 * 0.21 + y as f32 * 0.13) + 0.2 * noise(x + 977 * y);
            }
        })
    }

    /// Computes [`similarity`] by equations 13 and 6 of the 2004 paper as printed.
    fn textbook(a: &Plane<f32>, b: &Plane<f32>) -> [f64; 2] {
        let w = gaussian();
        let (mut whole, mut contrast, mut n) = (0.0, 0.0, 0.0);
        for y in 0..=a.height() - WINDOW {
            for x in 0..=a.width() - WINDOW {
                let mean = |f: &dyn Fn(f64, f64) -> f64| {
                    let mut sum = 0.0;
                    for j in 0..WINDOW {
                        for i in 0..WINDOW {
                            sum += w[i] * w[j] * f(f64::from(a.at(x + i, y + j)), f64::from(b.at(x + i, y + j)));
                        }
                    }
                    sum
                };
                let (ma, mb) = (mean(&|p, _| p), mean(&|_, q| q));
                let (va, vb) = (mean(&|p, _| (p - ma) * (p - ma)), mean(&|_, q| (q - mb) * (q - mb)));
                let cov = mean(&|p, q| (p - ma) * (q - mb));
                let cs = (2.0 * cov + C2) / (va + vb + C2);
                whole += cs * (2.0 * ma * mb + C1) / (ma * ma + mb * mb + C1);
                contrast += cs;
                n += 1.0;
            }
        }
        [whole / n, contrast / n]
    }

    #[test]
    fn result_equals_the_textbook_version() {
        let a = texture(40, 33);
        let b = Plane::from_rows(40, 33, |y, row| {
            (0..40).for_each(|x| row[x] = 0.9 * a.at(x, y) + noise(x * 31 + y) * 0.1)
        });
        let (found, expected) = (similarity(&a, &b), textbook(&a, &b));
        // Variances are differences of numbers near 2e4 with relative errors of 1e-12, so the errors of variances are
        // below 1e-7 times C2.
        for (f, e) in found.iter().zip(expected) {
            assert!((f - e).abs() < 1e-7, "{found:?} {expected:?}");
        }
    }

    #[test]
    fn likeness_is_ordered() {
        let a = texture(200, 190);
        let shifted = Plane::from_rows(200, 190, |y, row| (0..200).for_each(|x| row[x] = a.at((x + 3) % 200, y)));
        let brighter = Plane::from_rows(200, 190, |y, row| (0..200).for_each(|x| row[x] = 1.05 * a.at(x, y)));
        let of = |b: &Plane<f32>| score(a.clone(), b.clone()).unwrap();
        assert!((of(&a) - 1.0).abs() < 1e-12);
        assert!(of(&brighter) > 0.98 && of(&brighter) < 1.0 && of(&shifted) < of(&brighter));
        let small = |n| score(texture(n, n), texture(n, n));
        assert_eq!(small(10), None);
        assert!((small(11).unwrap() - 1.0).abs() < 1e-12);
        assert_eq!((of_equals((10, 90)), of_equals((11, 90))), (None, Some(1.0)));
    }
}
