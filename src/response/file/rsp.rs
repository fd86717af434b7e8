//! `.rsp`: the response files of Greg Ward's hdrgen.
//!
//! In and out: a [`ResponseCurve`] and three lines of text, for R, G and B: the degree of a polynomial and its
//! coefficients, highest power first. The polynomial gives the relative exposure of code z at x = (z + 1/2) / 256.
//! Cost: negligible. Source: panlib (radiance-org/panlib) `src/phdrimg.h`, the stream operators of PPolynomial, and
//! PbyteVal; degrees 0 to 5.
//!
//! ```text
//! 3 1.16 -0.32 0.15 0.0021
//! 3 1.13 -0.29 0.15 0.0024
//! 3 1.19 -0.35 0.16 0.0018
//! ```
//!
//! Such a polynomial cannot represent every curve of 256 values. For each degree from 1 to 5, a polynomial that is
//! positive and increases at every code is fitted, and the one with the smallest residual is written. The caller finds
//! the loss by reading the text again.

use crate::response::{CODES, MID, ResponseCurve, hat, stops};
use nalgebra::{DMatrix, DVector};
use std::fmt::Write;

/// The highest degree that hdrgen reads.
const MOST_DEGREE: usize = 5;
/// The residual is computed from these codes. The weights of a merge are close to 0 for other codes.
const JUDGED: std::ops::RangeInclusive<usize> = 10..=245;

/// Upper limit of the weight 1 / exposure, where white has the exposure 1. It is reached nine stops below white; for
/// comparison, sRGB's code 10 is 8.4 stops below white.
const BLACKEST: f64 = 512.0;

/// Reads the curve in `text`. The error says why there is no valid curve.
pub(crate) fn read(text: &str) -> Result<ResponseCurve, String> {
    let mut numbers = text.split_whitespace();
    let mut channels = [[0.0; CODES]; 3];
    for (channel, name) in channels.iter_mut().zip(["red", "green", "blue"]) {
        let short = || {
            format!(
                "it ends before the polynomial of {name} is complete; hdrgen writes one line each for red, green and blue"
            )
        };
        let word = numbers.next().ok_or_else(short)?;
        let degree = word.parse().ok().filter(|d| *d <= MOST_DEGREE);
        let degree = degree.ok_or_else(|| {
            format!("{word:?} is not a polynomial degree of {name}; a number from 0 to {MOST_DEGREE} is required")
        })?;
        let mut coefficients = Vec::with_capacity(degree + 1);
        for _ in 0..=degree {
            let word = numbers.next().ok_or_else(short)?;
            let value = word.parse().ok().filter(|v: &f64| v.is_finite());
            coefficients
                .push(value.ok_or_else(|| format!("a coefficient of {name} is {word:?}, which is not a number"))?);
        }
        *channel = std::array::from_fn(|z| evaluate(&coefficients, at(z)));
    }
    if let Some(word) = numbers.next() {
        return Err(format!("{word:?} follows the three polynomials"));
    }
    rising(&mut channels)?;
    // All three channels are divided by one common factor, so that the ratios between hdrgen's channels are kept.
    let ln_mid = channels.iter().map(|x| libm::log(x[MID])).sum::<f64>() / 3.0;
    ResponseCurve::new(channels.map(|x| x.map(|v| libm::log(v) - ln_mid)))
        .ok_or_else(|| "its exposures are too large, too small or too similar".to_owned())
}

/// Replaces the exposures of the darkest codes, where hdrgen's polynomials may fall or be negative, by a straight line
/// that is 0 at x = 0.
fn rising(channels: &mut [[f64; CODES]; 3]) -> Result<(), String> {
    for (x, name) in channels.iter_mut().zip(["red", "green", "blue"]) {
        let sound = |z: usize| x[z] > 0.0 && x[z + 1] > x[z];
        let first = (0..CODES - 1).rev().take_while(|&z| sound(z)).last();
        // hdrgen does not use the dark end. Only a fault in the codes from 63 on makes the curve invalid.
        let first = first.filter(|&z| z < MID / 2).ok_or_else(|| {
            format!("the polynomial of {name} is not positive and increasing from pixel value {} to 255", MID / 2 - 1)
        })?;
        let (value, place) = (x[first], first as f64 + 0.5);
        (0..first).for_each(|z| x[z] = value * (z as f64 + 0.5) / place);
    }
    Ok(())
}

/// Returns the text of a file with `curve` as polynomials, or `None` if no increasing polynomial fits it.
pub(crate) fn write(curve: &ResponseCurve) -> Option<String> {
    let white = (0..3).map(|c| curve.ln_exposure(c)[CODES - 1]).fold(f64::MIN, f64::max);
    let channels: [_; 3] = std::array::from_fn(|c| curve.ln_exposure(c).map(|g| g - white));
    let mut text = String::new();
    for g in &channels {
        let fits = (1..=MOST_DEGREE).filter_map(|degree| fit(g, degree));
        let (coefficients, _) = fits.min_by(|a, b| a.1.total_cmp(&b.1))?;
        let _ = write!(text, "{}", coefficients.len() - 1);
        for v in &coefficients {
            let _ = write!(text, " {v}");
        }
        text.push('\n');
    }
    Some(text)
}

/// Returns the increasing polynomial of this degree, highest power first, that is closest to exp(g) in stops, weighted
/// by the hat; and its root mean square distance in stops.
///
/// The result is the closest polynomial of this degree, if it increases everywhere. Otherwise it is the closest sum of
/// cumulative Bernstein polynomials (see [`bernstein_sums`]) with non-negative weights: such a sum always increases.
fn fit(g: &[f64; CODES], degree: usize) -> Option<(Vec<f64>, f64)> {
    let columns = bernstein_sums(degree);
    // Because of d ln x = dx / x, least squares with the weights 1 / x minimise the error of the logarithm. The weight
    // is limited near black.
    let weight = |z: usize| (hat(z as f64) + 0.02) * libm::exp(-g[z]).min(BLACKEST);
    let matrix = DMatrix::from_fn(CODES, degree + 1, |z, k| weight(z) * evaluate(&columns[k], at(z)));
    let right = DVector::from_fn(CODES, |z, _| weight(z) * libm::exp(g[z]));
    let (normal, right) = (matrix.tr_mul(&matrix), matrix.tr_mul(&right));
    let polynomial = |weights: &[f64]| -> Vec<f64> {
        (0..=degree).map(|i| weights.iter().zip(&columns).map(|(w, column)| w * column[i]).sum()).collect()
    };
    let rated = |coefficients: Vec<f64>| {
        let x: Vec<f64> = (0..CODES).map(|z| evaluate(&coefficients, at(z))).collect();
        if !(x[0] > 0.0 && x.windows(2).all(|w| w[0] < w[1])) {
            return None;
        }
        let miss = |z: usize| stops(libm::log(x[z]) - g[z]);
        let n = JUDGED.count() as f64;
        let mean = JUDGED.map(miss).sum::<f64>() / n;
        let residual = (JUDGED.map(|z| (miss(z) - mean) * (miss(z) - mean)).sum::<f64>() / n).sqrt();
        Some((coefficients, residual))
    };
    // Non-negative least squares, by trying which of at most six weights are zero.
    let free = |set: usize| {
        let used: Vec<usize> = (0..=degree).filter(|k| set >> k & 1 == 1).collect();
        let small = DMatrix::from_fn(used.len(), used.len(), |i, k| normal[(used[i], used[k])]);
        let part = DVector::from_fn(used.len(), |i, _| right[used[i]]);
        let solved = small.cholesky()?.solve(&part);
        let mut weights = vec![0.0; degree + 1];
        used.iter().zip(solved.iter()).for_each(|(&k, &w)| weights[k] = w);
        Some(weights)
    };
    let all = (1 << (degree + 1)) - 1;
    let unbound = free(all).and_then(|weights| rated(polynomial(&weights)));
    unbound.or_else(|| {
        let subsets = (1..=all).filter_map(free).filter(|weights| weights.iter().all(|w| *w >= 0.0));
        let candidates = subsets.filter_map(|weights| rated(polynomial(&weights)));
        candidates.min_by(|a, b| a.1.total_cmp(&b.1))
    })
}

/// Returns, for k from 0 to `degree`, the sum of the Bernstein polynomials b_k to b_degree, as coefficients, highest
/// power first: 1 for k = 0; all others rise from 0 to 1.
fn bernstein_sums(degree: usize) -> Vec<Vec<f64>> {
    let choose = |n: usize, k: usize| (0..k).fold(1.0, |c, i| c * (n - i) as f64 / (i + 1) as f64);
    let bernstein = |k: usize| {
        // b_k = C(n, k) x^k (1 - x)^(n - k).
        let mut coefficients = vec![0.0; degree + 1];
        for i in 0..=degree - k {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            coefficients[degree - (k + i)] = sign * choose(degree, k) * choose(degree - k, i);
        }
        coefficients
    };
    let sum = |k: usize| {
        (k..=degree)
            .map(bernstein)
            .fold(vec![0.0; degree + 1], |sum, b| sum.iter().zip(b).map(|(s, v)| s + v).collect())
    };
    (0..=degree).map(sum).collect()
}

/// Returns the position x of code z in hdrgen's polynomials.
fn at(z: usize) -> f64 {
    (z as f64 + 0.5) / 256.0
}

/// Returns the value of a polynomial, highest power first, by Horner's method.
fn evaluate(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().fold(0.0, |sum, c| sum * x + c)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shifts one curve by the constant that brings it closest to the other. Returns the root mean square of the
    /// remaining difference over codes 10..=245 of all channels, in stops.
    fn difference(a: &ResponseCurve, b: &ResponseCurve) -> f64 {
        let d: Vec<f64> = (0..3)
            .flat_map(|c| JUDGED.map(move |z| (c, z)))
            .map(|(c, z)| stops(a.ln_exposure(c)[z] - b.ln_exposure(c)[z]))
            .collect();
        let mean = d.iter().sum::<f64>() / d.len() as f64;
        (d.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / d.len() as f64).sqrt()
    }

    #[test]
    fn the_highest_power_is_first_and_codes_are_at_their_middle() {
        let curve = read("2 3 0.5 0.25\n1 2 0.1\n3 1 0 0 0.001\n").unwrap();
        let x = |z: f64| (z + 0.5) / 256.0;
        let ratio = |c: usize, a: usize, b: usize| libm::exp(curve.ln_exposure(c)[a] - curve.ln_exposure(c)[b]);
        let square = |z: f64| 3.0 * x(z) * x(z) + 0.5 * x(z) + 0.25;
        assert!((ratio(0, 200, 10) - square(200.0) / square(10.0)).abs() < 1e-9);
        assert!((ratio(1, 200, 10) - (2.0 * x(200.0) + 0.1) / (2.0 * x(10.0) + 0.1)).abs() < 1e-9);
        // The ratios between the channels are also kept.
        let mixed = libm::exp(curve.ln_exposure(0)[50] - curve.ln_exposure(1)[50]);
        assert!((mixed - square(50.0) / (2.0 * x(50.0) + 0.1)).abs() < 1e-9);
    }

    #[test]
    fn a_polynomial_comes_back_as_it_was() {
        let first = read("3 1.16 -0.32 0.15 0.0021\n3 1.13 -0.29 0.15 0.0024\n4 0.3 0.9 -0.35 0.16 0.0018\n").unwrap();
        let second = read(&write(&first).unwrap()).unwrap();
        // A polynomial of degree 4 is also one of degree 5, so that only rounding errors remain: about 1e-16 times the
        // condition number of the powers (1e8).
        assert!(difference(&first, &second) < 1e-6, "{}", difference(&first, &second));
    }

    #[test]
    fn curve_is_read_back_within_the_precision_of_the_format() {
        let text = write(&ResponseCurve::srgb()).unwrap();
        let off = difference(&ResponseCurve::srgb(), &read(&text).unwrap());
        assert!(off < 0.05 && text.lines().count() == 3, "{off}");
    }

    #[test]
    fn a_curve_that_no_polynomial_suits_is_still_written_as_one_that_rises() {
        // A film curve: black for thirty codes, and steep at both ends.
        let film = |z: usize| {
            let v = z as f64 / 255.0;
            6.0 * v + 2.5 * v.max(0.8) * v.max(0.8) - 3.0 * (0.12 - v).max(0.0) - 1.5 * libm::exp(-40.0 * v)
        };
        let curve = ResponseCurve::new([std::array::from_fn(film); 3]).unwrap();
        let off = difference(&curve, &read(&write(&curve).unwrap()).unwrap());
        assert!(off < 0.5, "{off}");
    }

    #[test]
    fn sums_of_bernstein_polynomials_rise_from_0_to_1() {
        for degree in 1..=MOST_DEGREE {
            let sums = bernstein_sums(degree);
            assert!((evaluate(&sums[0], 0.3) - 1.0).abs() < 1e-12);
            for sum in &sums[1..] {
                let x: Vec<f64> = (0..=50).map(|i| evaluate(sum, f64::from(i) / 50.0)).collect();
                assert!(
                    x[0].abs() < 1e-12 && (x[50] - 1.0).abs() < 1e-12 && x.windows(2).all(|w| w[0] <= w[1] + 1e-12)
                );
            }
        }
    }

    #[test]
    fn invalid_rsp_files_are_rejected_with_a_reason() {
        assert!(read("").unwrap_err().contains("red"));
        assert!(read("2 1 0 0\n2 1 0 0\n").unwrap_err().contains("blue"));
        assert!(read("6 1 1 1 1 1 1 1\n").unwrap_err().contains("degree"));
        assert!(read("1 1 x\n").unwrap_err().contains("\"x\""));
        assert!(read("1 1 0\n1 1 0\n1 1 0\n5").unwrap_err().contains("follows"));
        for wrong in ["1 -1 1", "1 1 -5"] {
            let reason = read(&format!("{wrong}\n1 1 0\n1 1 0\n")).unwrap_err();
            assert!(reason.contains("red is not positive and increasing from pixel value 63"), "{reason}");
        }
        assert!(read("1 inf 0\n").unwrap_err().contains("not a number"));
    }

    #[test]
    fn a_dark_end_that_falls_is_led_to_zero() {
        let curve = read(&"2 1 -0.05 0.0001\n".repeat(3)).unwrap();
        let g = curve.ln_exposure(0);
        assert!(g.windows(2).all(|w| w[0] < w[1]));
        assert!((g[1] - g[0] - libm::log(3.0)).abs() < 1e-9);
    }
}
