//! Downsampling and smoothing of planes: 2x2 averages, the separable Gaussian and the binomial filter.
//!
//! In: a [`Plane`]. Out: a smaller or smoother plane. Cost: the reduced levels of a pyramid together have a third of
//! the pixels of the image. The Gaussian takes two passes, each with 2 ceil(4 sigma) + 1 multiply-adds per pixel.
//! Source: Ward 2003, section 2 (pyramid by averaging); Lowe 2004, section 3 (the Gaussian scale space is separable).

pub(crate) mod burt_adelson;
pub(crate) mod cells;

use crate::plane::Plane;
use crate::simd::{Loops, vectorised};

/// Halves width and height: every pixel is the rounded mean of four. An odd last column or row is dropped.
pub fn halve(plane: &Plane<u8>) -> Plane<u8> {
    let (width, height) = (plane.width() / 2, plane.height() / 2);
    Plane::from_rows(width, height, |y, row| halve_rows(plane.row(2 * y), plane.row(2 * y + 1), row))
}

/// Computes a row of the halved image from two successive rows, which must be at least twice as long as `half`.
pub fn halve_rows(upper: &[u8], lower: &[u8], half: &mut [u8]) {
    vectorised(Halves { upper, lower, half });
}

struct Halves<'a> {
    upper: &'a [u8],
    lower: &'a [u8],
    half: &'a mut [u8],
}

impl Loops for Halves<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let pairs = self.upper.as_chunks::<2>().0.iter().zip(self.lower.as_chunks::<2>().0);
        for (v, (a, b)) in self.half.iter_mut().zip(pairs) {
            let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
            *v = ((sum + 2) >> 2) as u8;
        }
    }
}

/// Returns the pyramid of `plane`, the largest level first. The short sides of all levels after the first are at least
/// `least_side`.
pub fn halves(plane: Plane<u8>, least_side: usize) -> Vec<Plane<u8>> {
    let mut levels = vec![plane];
    while let Some(last) = levels.last()
        && last.width().min(last.height()) / 2 >= least_side.max(1)
    {
        levels.push(halve(last));
    }
    levels
}

/// Returns every second pixel of every second row, without smoothing: the next octave of a scale space (Lowe 2004,
/// section 3).
pub fn every_second(plane: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (plane.width().div_ceil(2), plane.height().div_ceil(2));
    Plane::from_rows(width, height, |y, row| {
        for (v, pair) in row.iter_mut().zip(plane.row(2 * y).chunks(2)) {
            *v = pair[0];
        }
    })
}

/// Doubles width and height by linear interpolation: pixel (2x, 2y) of the result equals pixel (x, y) of `plane`.
pub fn double(plane: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (plane.width(), plane.height());
    Plane::from_rows(2 * width, 2 * height, |y, row| {
        let upper = plane.row(y / 2);
        let lower = plane.row((y / 2 + y % 2).min(height - 1));
        for (x, pair) in row.chunks_exact_mut(2).enumerate() {
            let here = 0.5 * (upper[x] + lower[x]);
            let next = 0.5 * (upper[(x + 1).min(width - 1)] + lower[(x + 1).min(width - 1)]);
            pair[0] = here;
            pair[1] = 0.5 * (here + next);
        }
    })
}

/// Returns the plane convolved with a Gaussian of standard deviation `sigma` pixels, truncated at 4 sigma; the border
/// is repeated.
pub fn gaussian(plane: &Plane<f32>, sigma: f64) -> Plane<f32> {
    let half = half_kernel(sigma);
    let (width, height, reach) = (plane.width(), plane.height(), half.len() - 1);
    let mut smooth = Plane::filled(width, height, 0.0f32);
    smooth.fill_bands(|rows, band| {
        let mut column = vec![0.0f32; width + 2 * reach];
        let mut above_and_below: Vec<&[f32]> = vec![&[]; 2 * reach + 1];
        for (y, out) in rows.zip(band.chunks_exact_mut(width)) {
            for (k, row) in above_and_below.iter_mut().enumerate() {
                *row = plane.row((y + k).saturating_sub(reach).min(height - 1));
            }
            vectorised(SmoothRow { half: &half, above_and_below: &above_and_below, column: &mut column, out });
        }
    });
    smooth
}

/// Computes a row of a smoothed plane in two passes. The first pass smooths along the columns into the buffer
/// `column`, which is extended by the reach of the kernel at both ends. The second pass smooths this buffer along the
/// row.
struct SmoothRow<'a> {
    half: &'a [f32],
    above_and_below: &'a [&'a [f32]],
    column: &'a mut [f32],
    out: &'a mut [f32],
}

impl Loops for SmoothRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let SmoothRow { half, above_and_below, column, out } = self;
        let (width, reach) = (out.len(), half.len() - 1);
        weighted_sum(half, &mut column[reach..reach + width], |k| above_and_below[k]);
        let (first, last) = (column[reach], column[reach + width - 1]);
        column[..reach].fill(first);
        column[reach + width..].fill(last);
        weighted_sum(half, out, |k| &column[k..]);
    }
}

/// Computes, for every `x`, the sum of `at(k)[x]` times the weight of the kernel, over k from 0 to twice the reach of
/// the kernel. It begins with the centre of the kernel, and then adds pairs at equal distances from the centre, from
/// the inside outwards.
#[inline(always)]
fn weighted_sum<'a>(half: &[f32], out: &mut [f32], at: impl Fn(usize) -> &'a [f32]) {
    let (n, reach) = (out.len(), half.len() - 1);
    let pair = |k: usize| (half[k], &at(reach - k)[..n], &at(reach + k)[..n]);
    for (o, v) in out.iter_mut().zip(at(reach)) {
        *o = half[0] * v;
    }
    // Three pairs are added at a time, so that the sums are loaded and stored less often.
    let mut k = 1;
    while k + 2 <= reach {
        let ((p, a, b), (q, c, d), (r, e, f)) = (pair(k), pair(k + 1), pair(k + 2));
        for x in 0..n {
            out[x] = out[x] + p * (a[x] + b[x]) + q * (c[x] + d[x]) + r * (e[x] + f[x]);
        }
        k += 3;
    }
    for k in k..=reach {
        let (w, a, b) = pair(k);
        for x in 0..n {
            out[x] += w * (a[x] + b[x]);
        }
    }
}

/// Looks up the plane's pixels in `table`, and smooths the result with the binomial kernel (1, 4, 6, 4, 1) / 16 along
/// both axes.
///
/// The standard deviation of the kernel is 1 pixel; the border is repeated (Burt & Adelson 1983).
pub fn binomial(plane: &Plane<u8>, table: &[f32; 256]) -> Plane<f32> {
    let (width, height) = (plane.width(), plane.height());
    let mut smooth = Plane::filled(width, height, 0.0f32);
    smooth.fill_bands(|rows, band| {
        let first = rows.start;
        let mut window: [Vec<f32>; 5] = std::array::from_fn(|_| vec![0.0; width]);
        let mut column = vec![0.0f32; width + 4];
        for (y, out) in rows.zip(band.chunks_exact_mut(width)) {
            window.rotate_left(1);
            let missing = if y == first { 0 } else { 4 };
            for (k, row) in window.iter_mut().enumerate().skip(missing) {
                let from = plane.row((y + k).saturating_sub(2).min(height - 1));
                row.iter_mut().zip(from).for_each(|(to, &v)| *to = table[usize::from(v)]);
            }
            vectorised(BinomialRow { window: window.each_ref().map(|row| &row[..]), column: &mut column, out });
        }
    });
    smooth
}

/// Computes a row of a plane smoothed with the binomial kernel, in two passes: first along the columns into the buffer
/// `column`, then along the row.
struct BinomialRow<'a> {
    window: [&'a [f32]; 5],
    column: &'a mut [f32],
    out: &'a mut [f32],
}

impl Loops for BinomialRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let BinomialRow { window, column, out } = self;
        let width = out.len();
        let [a, b, c, d, e] = window.map(|row| &row[..width]);
        let inner = &mut column[2..width + 2];
        for x in 0..width {
            inner[x] = 6.0 * c[x] + 4.0 * (b[x] + d[x]) + (a[x] + e[x]);
        }
        let (first, last) = (column[2], column[width + 1]);
        column[..2].fill(first);
        column[width + 2..].fill(last);
        for (o, c) in out.iter_mut().zip(column.windows(5)) {
            *o = (6.0 * c[2] + 4.0 * (c[1] + c[3]) + (c[0] + c[4])) * (1.0 / 256.0);
        }
    }
}

/// Returns the weights of the Gaussian from its centre outwards, to one side; the weights of the whole kernel sum to 1.
fn half_kernel(sigma: f64) -> Vec<f32> {
    let reach = libm::ceil(4.0 * sigma) as usize;
    let raw: Vec<f64> = (0..=reach).map(|k| libm::exp(-0.5 * (k as f64 / sigma) * (k as f64 / sigma))).collect();
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.iter().map(|w| (w / sum) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_rounded_means() {
        let plane = Plane::from_vec(5, 3, vec![1, 2, 10, 20, 9, 3, 4, 30, 41, 9, 9, 9, 9, 9, 9]);
        let half = halve(&plane);
        assert_eq!((half.width(), half.height(), half.as_slice()), (2, 1, &[3u8, 25][..]));
    }

    #[test]
    fn halving_side_by_side_is_halving_one_by_one() {
        for (width, height) in [(16, 2), (37, 5), (64, 4), (131, 7)] {
            let plane = Plane::from_rows(width, height, |y, row| {
                for (x, v) in row.iter_mut().enumerate() {
                    // The values include 0 and 255, so that a carry of a sum into a neighbouring pixel would be found.
                    *v = ((x * 97 + y * 61) % 260).saturating_sub(4).min(255) as u8;
                }
            });
            let half = halve(&plane);
            for y in 0..height / 2 {
                for x in 0..width / 2 {
                    let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| u32::from(plane.at(2 * x + i, 2 * y + j)));
                    assert_eq!(u32::from(half.at(x, y)), (four.iter().sum::<u32>() + 2) / 4);
                }
            }
        }
        assert_eq!(halve(&Plane::filled(40, 2, 255u8)), Plane::filled(20, 1, 255u8));
    }

    #[test]
    fn halves_are_at_least_of_the_requested_size() {
        let sizes =
            |w, h| halves(Plane::filled(w, h, 0u8), 32).iter().map(|p| p.height().min(p.width())).collect::<Vec<_>>();
        assert_eq!(sizes(300, 256), [256, 128, 64, 32]);
        assert_eq!(sizes(300, 255), [255, 127, 63]);
        assert_eq!(sizes(10, 1), [1]);
    }

    #[test]
    fn the_gaussian_agrees_with_the_double_sum() {
        for (w, h, sigma) in [(23, 71, 1.3), (77, 9, 2.0)] {
            let plane = Plane::from_rows(w, h, |y, row| {
                for (x, v) in row.iter_mut().enumerate() {
                    *v = ((x * 31 + y * 17) % 29) as f32;
                }
            });
            let fast = gaussian(&plane, sigma);
            let reach = (4.0f64 * sigma).ceil() as isize;
            let g = |d: isize| (-0.5 * (d as f64 / sigma).powi(2)).exp();
            for y in 0..h as isize {
                for x in 0..w as isize {
                    let (mut sum, mut weight) = (0.0, 0.0);
                    for dy in -reach..=reach {
                        for dx in -reach..=reach {
                            let at = plane.at(
                                (x + dx).clamp(0, w as isize - 1) as usize,
                                (y + dy).clamp(0, h as isize - 1) as usize,
                            );
                            sum += g(dx) * g(dy) * f64::from(at);
                            weight += g(dx) * g(dy);
                        }
                    }
                    // Two passes of 17 weights round f32 values below 32 at most 34 times: 34 * 32 * 2^-24 = 6.5e-5.
                    assert!((f64::from(fast.at(x as usize, y as usize)) - sum / weight).abs() < 6.5e-5);
                }
            }
        }
    }

    #[test]
    fn the_binomial_agrees_with_the_double_sum() {
        let (w, h) = (19, 131);
        let plane = Plane::from_rows(w, h, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = ((x * 31 + y * 17) % 251) as u8;
            }
        });
        let table: [f32; 256] = std::array::from_fn(|v| (v * v) as f32 / 256.0);
        let fast = binomial(&plane, &table);
        for y in 0..h as isize {
            for x in 0..w as isize {
                let mut sum = 0.0;
                for (j, wy) in (-2..).zip([1.0, 4.0, 6.0, 4.0, 1.0]) {
                    for (i, wx) in (-2..).zip([1.0, 4.0, 6.0, 4.0, 1.0]) {
                        let (u, v) = ((x + i).clamp(0, w as isize - 1), (y + j).clamp(0, h as isize - 1));
                        sum += wx * wy / 256.0 * f64::from(table[usize::from(plane.at(u as usize, v as usize))]);
                    }
                }
                // Two passes of 5 weights round f32 values below 256 about ten times: 10 * 256 * 2^-24 = 1.5e-4.
                assert!((f64::from(fast.at(x as usize, y as usize)) - sum).abs() < 2e-4);
            }
        }
    }

    #[test]
    fn doubling_keeps_the_pixels_and_a_ramp() {
        let plane = Plane::from_rows(6, 5, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = (2 * x + 3 * y) as f32;
            }
        });
        let twice = double(&plane);
        for y in 0..9 {
            for x in 0..11 {
                assert_eq!(twice.at(x, y), x as f32 + 1.5 * y as f32);
            }
        }
        assert_eq!(every_second(&twice), plane);
    }
}
