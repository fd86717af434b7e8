//! The response by least squares, after Debevec & Malik 1997, equation 3.
//!
//! In: the [`Sample`]s of a channel. Out: g(Z) = ln(E dt) and what is known about it, or the reason why it cannot be
//! recovered. Cost: about 5 ms per round and channel for 2000 samples in four frames. Source: Debevec & Malik 1997,
//! section 2.1, equations 3 and 4, and the program gsolve.m in their appendix, with whose result the tests compare.
//!
//! The paper minimises
//!
//! ```text
//! O = sum_ij { w(Z_ij) [g(Z_ij) - ln E_i - ln dt_j] }^2 + lambda sum_z [ w(z) g''(z) ]^2
//! ```
//!
//! where g and all ln E_i are unknowns, by a singular value decomposition of a matrix with a column for each unknown.
//! Z_ij is the code of place i in frame j, E_i the radiance of place i, dt_j the exposure of frame j, and w the weight
//! of a code. Here each ln E_i is eliminated first, because it is only in the rows of its own place: a Householder
//! reflection replaces these rows by one row fewer, without ln E_i. The singular value decomposition is applied to the
//! remaining equations, in g only. So thousands of places need no more columns than dozens. Normal equations would also
//! need few columns, but would square the condition number. Five things differ from the paper:
//!
//! - Z_ij is the mean of a patch and lies between two codes; g is interpolated linearly between them.
//! - The first sum is divided by the sum of its w^2, so that lambda has the same meaning for any number of samples and
//!   frames.
//! - Places that contradict the others (motion) lose their weight in a few rounds of Tukey's biweight.
//! - Not g must be smooth, but the difference between g and the sRGB curve. If all frames are k stops apart, any wave
//!   of period k can be added to g (Grossberg & Nayar 2003, "what is knowable"). The smoothness term decides between
//!   these curves, and cameras are closer to the sRGB curve than to a straight line. On brackets with film curves,
//!   errors of 0.05 and 0.2 stops fall to 0.03.
//! - The difference is a cubic spline with 47 coefficients instead of 256 values: the same curve, fifty times faster.

use super::fit::{self, Fitted, Found, between};
use super::samples::Sample;
use super::{CODES, MID, ResponseCurve, hat};
use crate::error::{Error, Result};
use crate::response::fit::least_squares::{LeastSquares, eliminate};
use crate::response::fit::spline::Basis;

/// Options of the fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Largest number of places for each channel; 24 or more.
    pub samples: usize,
    /// The weight lambda of the smoothness term; the mean square error of the samples has weight 1. Positive. The
    /// default of 30 was compared with a weight of 100 on 130 rendered brackets: the error is the same in the middle of
    /// the code range, and two thirds as large at the ends. With a weight of 10, the curve follows noise and waves. It
    /// also does so with weights derived from the residual of each bracket.
    pub smoothness: f64,
    /// Number of rounds in which contradicting samples lose their weight; 0 for plain least squares.
    pub rounds: usize,
}

impl Default for Options {
    fn default() -> Self {
        Options { samples: 2000, smoothness: 30.0, rounds: 3 }
    }
}

impl Options {
    /// # Errors
    /// [`Error::Option`] if a value cannot be used.
    pub fn validate(&self) -> Result<()> {
        fit::enough(self.samples)?;
        if self.smoothness > 0.0 && self.smoothness.is_finite() {
            return Ok(());
        }
        let reason = format!("the smoothness must be positive, not {}", self.smoothness);
        Err(Error::Option { option: "--response-model", reason })
    }
}

/// Returns g of one channel, or the reason why it cannot be recovered.
pub(super) fn channel(samples: &[Sample], options: &Options) -> Fitted<Found> {
    fit::check(samples)?;
    let (srgb, basis) = (ResponseCurve::srgb(), Basis::cubic());
    let solve = |trust: &[f64]| solve(samples, trust, options.smoothness, &basis, srgb.ln_exposure(0));
    let mut trust = vec![1.0; samples.len()];
    for _ in 0..options.rounds {
        trust = fit::biweight(samples, &solve(&trust)?.0);
    }
    let (g, condition) = solve(&trust)?;
    Ok(Found { g, trust, condition: Some(condition), degree: None })
}

/// Solves equation 3 of the paper. Returns g and the condition number of the equations. The difference between g and
/// the curve `about` is a sum of the splines in `basis`.
fn solve(
    samples: &[Sample],
    trust: &[f64],
    smoothness: f64,
    basis: &Basis,
    about: &[f64; CODES],
) -> Fitted<([f64; CODES], f64)> {
    let (unknowns, width) = (basis.count(), basis.count() + 1);
    let mut equations = LeastSquares::new(unknowns);
    let weights = samples.iter().map(|s| s.views.iter().map(fit::square).sum::<f64>());
    let total: f64 = weights.zip(trust).map(|(w2, trust)| trust * w2).sum();
    let (mut rows, mut radiance) = (Vec::new(), Vec::new());
    for (sample, trust) in samples.iter().zip(trust).filter(|(_, trust)| **trust > 0.0) {
        // Each row is w [g(Z_ij) - ln E_i] = w ln dt_j, written for the difference between g and `about`.
        rows.clear();
        rows.resize(sample.views.len() * width, 0.0);
        radiance.clear();
        for (view, row) in sample.views.iter().zip(rows.chunks_exact_mut(width)) {
            let w = hat(view.code);
            between(view.code).iter().for_each(|&(z, f)| basis.add(z, w * f, row));
            row[unknowns] = w * (view.ln_time - fit::at(about, view.code));
            radiance.push(-w);
        }
        let scale = (trust / total).sqrt();
        eliminate(&mut rows, width, &mut radiance).chunks_exact(width).for_each(|row| equations.push(row, scale));
    }
    let mut difference = |terms: &[(usize, f64)], weight: f64| {
        let mut row = vec![0.0; width];
        terms.iter().for_each(|&(z, a)| basis.add(z, a, &mut row));
        equations.push(&row, weight);
    };
    for z in 1..CODES - 1 {
        difference(&[(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)], smoothness.sqrt() * hat(z as f64));
    }
    // g(128) = 0. No other equation determines the offset of g, so any weight gives the same result.
    difference(&[(MID, 1.0)], 1.0);
    let (coefficients, condition) = equations.solve()?;
    let curve = basis.curve(&coefficients);
    Ok((std::array::from_fn(|z| about[z] + curve[z]), condition))
}

#[cfg(test)]
mod tests {
    use super::super::Fit;
    use super::super::fit::scene::{difference, difference_from, noise, scene};
    use super::super::samples::View;
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// Returns the curve and its fit, as `recover` does.
    fn channel(samples: &[Sample], options: &Options) -> Fitted<([f64; CODES], Fit)> {
        fit::finish(samples, super::channel(samples, options)?)
    }

    /// Returns g by gsolve.m of Debevec & Malik's appendix: all unknowns, g(0..=255) and ln E_i, in one matrix, solved
    /// by SVD.
    fn gsolve(z: &[Vec<usize>], b: &[f64], l: f64) -> Vec<f64> {
        let (n, unknowns) = (CODES, CODES + z.len());
        let rows = z.len() * b.len() + n - 1;
        let (mut a, mut right, mut k) = (DMatrix::zeros(rows, unknowns), DVector::zeros(rows), 0);
        for (i, codes) in z.iter().enumerate() {
            for (j, &code) in codes.iter().enumerate() {
                let w = hat(code as f64);
                (a[(k, code)], a[(k, n + i)], right[k]) = (w, -w, w * b[j]);
                k += 1;
            }
        }
        a[(k, MID)] = 1.0;
        for code in 1..n - 1 {
            let w = l * hat(code as f64);
            k += 1;
            (a[(k, code - 1)], a[(k, code)], a[(k, code + 1)]) = (w, -2.0 * w, w);
        }
        let x = a.svd(true, true).solve(&right, 1e-14).unwrap();
        x.as_slice()[..n].to_vec()
    }

    #[test]
    fn without_ln_e_the_solution_is_that_of_the_papers_program() {
        let b = [-1.3, 0.0, 1.1];
        let code = |ln: f64| (128.0 + 40.0 * ln).clamp(0.0, 255.0);
        let z: Vec<Vec<usize>> = (0..30)
            .map(|i| {
                b.iter()
                    .enumerate()
                    .map(|(j, t)| code(0.2 * i as f64 - 3.0 + t + 0.2 * noise(7 * i + j)) as usize)
                    .collect()
            })
            .collect();
        let view = |(&code, &ln_time): (&usize, &f64)| View { code: code as f64, ln_time };
        let samples: Vec<Sample> =
            z.iter().map(|codes| Sample { views: codes.iter().zip(&b).map(view).collect() }).collect();
        let total: f64 = z.iter().flatten().map(|&code| hat(code as f64) * hat(code as f64)).sum();
        // `solve` divides the first sum of equation 3 by the total weight, and `gsolve` does not: so the lambda^2 of
        // `gsolve` is smoothness times the total weight.
        let smoothness = 0.7;
        let expected = gsolve(&z, &b, (smoothness * total).sqrt());
        let (g, _) = solve(&samples, &vec![1.0; samples.len()], smoothness, &Basis::values(), &[0.0; CODES]).unwrap();
        // The tolerance is the condition number, about 1e3, times the rounding error of 2e-16, with a margin for 256
        // terms and for the error of the original program.
        for z in 0..CODES {
            assert!((g[z] - expected[z]).abs() < 1e-10, "code {z}: {} for {}", g[z], expected[z]);
        }
    }

    #[test]
    fn known_curves_come_back() {
        let times = [-4.0, -2.0, 0.0, 2.0];
        let gamma = scene(600, &times, |x| libm::pow(x, 1.0 / 2.2));
        let (g, fit) = channel(&gamma, &Options::default()).unwrap();
        let off = difference(&g, |v| libm::pow(v, 2.2));
        // Near code 10, where sRGB's straight toe ends, the smoothness pulls the curve towards this toe, which the
        // camera does not have.
        assert!(off < 0.05, "{off} {fit:?}");
        assert!(g.windows(2).all(|w| w[0] < w[1]) && g[MID] == 0.0);
        // The camera is logarithmic: all its codes together span 12 stops. In the scene, only codes of at least 21
        // occur.
        let log = scene(600, &times, |x| 1.0 + libm::log2(x.max(1e-9)) / 12.0);
        let (g, fit) = channel(&log, &Options::default()).unwrap();
        let off = difference_from(24, &g, |v| libm::exp2(12.0 * v));
        // The tolerance is larger than above, because the smoothness adds error for a curve so far from sRGB's.
        assert!(off < 0.06, "{off} {fit:?}");
    }

    #[test]
    fn splines_are_as_good_as_free_values() {
        let samples = scene(600, &[-4.0, -2.0, 0.0, 2.0], |x| libm::pow(x, 1.0 / 2.2));
        let srgb = ResponseCurve::srgb();
        let within =
            |basis: &Basis| solve(&samples, &vec![1.0; samples.len()], 10.0, basis, srgb.ln_exposure(0)).unwrap().0;
        let (free, splines) = (within(&Basis::values()), within(&Basis::cubic()));
        // The tolerance is a hundredth of the 0.05 stops that are allowed for a known curve.
        assert!(difference(&splines, |v| libm::exp(fit::at(&free, 255.0 * v))) < 0.0005);
    }

    #[test]
    fn equal_steps_do_not_let_a_wave_in() {
        // The curve of a print film, steep in the shadows. The exposures are two stops apart, so they do not determine
        // a wave with a period of two stops.
        let (n, s) = (0.8, libm::pow(0.05, 0.8));
        let samples = scene(600, &[-2.0, 0.0, 2.0], |x| (1.0 + s) * libm::pow(x, n) / (libm::pow(x, n) + s));
        let film = |v: f64| libm::pow(v * s / (1.0 + s - v), 1.0 / n);
        let (g, fit) = channel(&samples, &Options::default()).unwrap();
        let about_srgb = difference_from(24, &g, film);
        assert!(about_srgb < 0.035, "{about_srgb} {fit:?}");
        let (trust, smoothness) = (vec![1.0; samples.len()], Options::default().smoothness);
        let (straight, _) = solve(&samples, &trust, smoothness, &Basis::values(), &[0.0; CODES]).unwrap();
        let straight = difference_from(24, &straight, film);
        assert!(straight > 1.2 * about_srgb, "{straight} and {about_srgb}");
    }

    #[test]
    fn motion_does_not_affect_the_curve() {
        let mut samples = scene(600, &[-2.0, 0.0, 2.0], |x| libm::pow(x, 1.0 / 2.2));
        for sample in samples.iter_mut().step_by(8) {
            let last = sample.views.len() - 1;
            sample.views[last].code = 0.5 * (sample.views[last].code + 250.0);
        }
        let bent = |rounds| {
            let options = Options { rounds, ..Options::default() };
            difference(&channel(&samples, &options).unwrap().0, |v| libm::pow(v, 2.2))
        };
        let (plain, robust) = (bent(0), bent(3));
        // In an eighth of the places something moved, and each of these places became brighter in the longest exposure.
        // Without the robust rounds, the error is 0.211 stops. With any number of rounds, 0.083 stops remain, because
        // motion that is not larger than the noise cannot be detected. The test checks the ratio of the two errors, not
        // the accuracy.
        assert!(robust < plain / 2.4, "{robust} and {plain} stops");
    }

    #[test]
    fn twice_the_samples_give_the_same_curve() {
        let samples = scene(300, &[-2.0, 0.0, 2.0], |x| libm::pow(x, 1.0 / 2.2));
        let (once, _) = channel(&samples, &Options::default()).unwrap();
        let (twice, _) = channel(&[samples.clone(), samples].concat(), &Options::default()).unwrap();
        assert!(once.iter().zip(&twice).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn samples_that_do_not_determine_a_curve_give_a_reason() {
        let why = |samples: &[Sample]| channel(samples, &Options::default()).unwrap_err();
        let gamma = |x: f64| libm::pow(x, 1.0 / 2.2);
        assert!(why(&scene(10, &[0.0, 2.0], gamma)).contains("smooth areas"));
        assert!(why(&scene(600, &[0.0, 0.0], gamma)).contains("0.00 stops"));
        assert!(why(&scene(600, &[-1.0, 0.0], |x| 0.3 + 0.1 * x)).contains("only pixel values"));
        // The exposures are 0.1 stops apart, but are recorded as 2 nepers apart: EXIF is wrong.
        let mut lie = scene(600, &[0.0, 0.1], gamma);
        lie.iter_mut().for_each(|s| s.views[1].ln_time = 2.0);
        assert!(
            why(&lie).contains("stops from pixel value 16 to 240") || why(&lie).contains("do not fit their exposures")
        );
    }
}
