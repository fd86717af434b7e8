//! The response as a polynomial, after Mitsunaga & Nayar 1999, for exposures that are only approximately known.
//!
//! In: the [`Sample`]s of a channel. Out: g(Z) = ln f(Z) with the exposure [`Ratio`]s that fit it, or the reason why
//! it cannot be recovered. Cost: a dozen least-squares problems of at most ten unknowns for each degree, about 0.3 s
//! in all for 2000 samples. Source: Mitsunaga & Nayar 1999, "Radiometric self calibration", sections 3.1 to 3.3: f(M)
//! = sum_n c_n M^n minimises
//!
//! ```text
//! O = sum_qp [f(M_pq) - R_{q,q+1} f(M_p,q+1)]^2
//! ```
//!
//! where the sum is over all places p and all consecutive exposures q (the shorter) and q + 1. M_pq is the code of
//! place p in exposure q, and R_{q,q+1} the ratio of exposure q to exposure q + 1. Then each R_{q,q+1} is computed from
//! f, as the mean of f(M_pq) / f(M_p,q+1), and both steps are repeated until f no longer changes. The degree is the
//! smallest that fits. Eight things differ from the paper:
//!
//! - The sum is of relative errors: each error is divided by R f(M_p,q+1), with the f of the previous round. Absolute
//!   errors would be dominated by bright codes.
//! - Each pair has a weight: the square of the smaller of the hat weights of its two codes.
//! - R is the geometric mean of the ratios, with these weights.
//! - f is 1 at code 128. In the paper it is 1 at code 255, which no unclipped sample has.
//! - f is a sum of Chebyshev polynomials: the same polynomial, from equations that are ten orders of magnitude better
//!   conditioned.
//! - Places that contradict the others lose their weight, as in the other models.
//! - The estimated R replace the given ones only if the error is clearly smaller. They are reported in any case.
//! - For any power u, f^u and R^u fit as well as f and R, so f and R drift to some power during the rounds. Afterwards
//!   both are raised to the power with which R agrees best with the given exposures.

use super::fit::{self, Fitted, Found};
use super::samples::{Sample, View};
use super::{CODES, MID, ResponseCurve, hat};
use crate::error::{Error, Result};
use crate::response::fit::least_squares::LeastSquares;
use std::ops::RangeInclusive;

/// Degrees that are tried.
const DEGREES: RangeInclusive<usize> = 3..=10;
/// Values of the Chebyshev polynomials T_0 to T_10 at a code.
type Terms = [f64; 11];
/// A higher degree is used if it reduces the error to less than this fraction of the error with the lower degree.
const BETTER: f64 = 0.98;
/// Smallest slope of ln f per code that a response has, from code 10 to 245: a tenth of sRGB's smallest. A polynomial
/// with a smaller slope has waves that equal exposure steps do not determine, and that a camera does not have.
const RISE: f64 = 1e-3;
/// Estimated ratios are used only if the error with them is less than this fraction of the error with the given ratios.
/// A smaller reduction does not count, because f and R can drift together and still fit as well as before.
const REFINED: f64 = 0.8;
/// The first number is the largest number of rounds. In as many rounds as the second number, only f is fitted; later
/// rounds also estimate R.
const ROUNDS: (usize, usize) = (20, 2);
/// f has converged if no value changes by more than this fraction.
const STAYS: f64 = 1e-4;
/// Smallest f, so that it has a logarithm. For comparison: in the sRGB curve, f at code 0 is about 1/2800 of f at code
/// 128.
const LEAST: f64 = 1e-5;
/// Allowed range of the power to which given exposure ratios are raised to agree with the estimated ratios. No camera
/// needs a power outside of it.
const POWER: RangeInclusive<f64> = 0.5..=2.0;

/// Options of the fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Largest number of places for each channel; 24 or more.
    pub samples: usize,
    /// Degree of the polynomial, 1 to 10; `None` for the smallest degree from 3 to 10 that fits.
    pub degree: Option<usize>,
}

impl Default for Options {
    fn default() -> Self {
        Options { samples: 2000, degree: None }
    }
}

impl Options {
    /// # Errors
    /// [`Error::Option`] if a value cannot be used.
    pub fn validate(&self) -> Result<()> {
        fit::enough(self.samples)?;
        match self.degree {
            Some(degree) if !(1..=*DEGREES.end()).contains(&degree) => {
                let reason = format!("the degree of the polynomial must be from 1 to {}, not {degree}", DEGREES.end());
                Err(Error::Option { option: "--response-degree", reason })
            }
            _ => Ok(()),
        }
    }
}

/// Two consecutive exposures, and their ratio according to the curve.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ratio {
    /// ln dt of the shorter and of the longer exposure, before they are corrected.
    pub ln_times: (f64, f64),
    /// ln of the ratio of the longer to the shorter exposure, as estimated.
    pub ln_ratio: f64,
    /// Sum of the weights of the places.
    pub weight: f64,
}

/// Returns g of one channel and its ratios, or the reason why they cannot be recovered.
pub(super) fn channel(samples: &[Sample], options: &Options) -> Fitted<(Found, Vec<Ratio>)> {
    fit::check(samples)?;
    let degrees = options.degree.map_or(DEGREES, |degree| degree..=degree);
    let pairs = Pairs::of(samples);
    let mut best: Fitted<Polynomial> = Err(fit::undetermined(f64::INFINITY));
    for degree in degrees {
        let found = pairs.clone().alternate(samples, degree, false);
        match (&best, &found) {
            (Ok(best), Ok(found)) if best.rises() && !found.rises() => (),
            (Ok(best), Ok(found)) if best.rises() == found.rises() && found.error > BETTER * best.error => (),
            (Ok(_), Err(_)) => (),
            _ => best = found,
        }
    }
    let mut found = best?;
    if let Ok(refined) = pairs.alternate(samples, found.degree, true)
        && refined.rises() >= found.rises()
        && refined.error < REFINED * found.error
    {
        found = refined;
    }
    let Polynomial { g, trust, ratios, condition, degree, .. } = found;
    Ok((Found { g, trust, condition: Some(condition), degree: Some(degree) }, ratios))
}

/// The curve f that was fitted with one degree, as g = ln f, and its ratios.
struct Polynomial {
    g: [f64; CODES],
    trust: Vec<f64>,
    ratios: Vec<Ratio>,
    condition: f64,
    degree: usize,
    /// Root mean square of ln f(M_pq) - ln f(M_p,q+1) - ln R.
    error: f64,
}

impl Polynomial {
    /// Whether f rises by more than [`RISE`] per code, as a response does.
    fn rises(&self) -> bool {
        self.g[10..=245].windows(2).all(|w| w[1] - w[0] > RISE)
    }
}

/// One place in two consecutive exposures.
#[derive(Clone)]
struct Pair {
    sample: usize,
    ratio: usize,
    shorter: View,
    longer: View,
    /// Chebyshev polynomials at the codes of `shorter` and `longer`.
    terms: (Terms, Terms),
    weight: f64,
}

/// All places in consecutive exposures, and the exposures.
#[derive(Clone)]
struct Pairs {
    all: Vec<Pair>,
    ratios: Vec<Ratio>,
}

impl Pairs {
    fn of(samples: &[Sample]) -> Self {
        let mut ratios: Vec<Ratio> = Vec::new();
        let mut all = Vec::new();
        for (sample, views) in samples.iter().map(|s| &s.views).enumerate() {
            for pair in views.windows(2) {
                let (shorter, longer) = (pair[0], pair[1]);
                let ln_times = (shorter.ln_time, longer.ln_time);
                let known = ratios.iter().position(|r| r.ln_times == ln_times);
                let ratio = known.unwrap_or(ratios.len());
                if known.is_none() {
                    ratios.push(Ratio { ln_times, ln_ratio: ln_times.1 - ln_times.0, weight: 0.0 });
                }
                let weight = hat(shorter.code).min(hat(longer.code));
                let terms = (chebyshev(shorter.code), chebyshev(longer.code));
                all.push(Pair { sample, ratio, shorter, longer, terms, weight: weight * weight });
            }
        }
        Pairs { all, ratios }
    }

    /// Fits f or, if `refined`, f and R alternately.
    fn alternate(mut self, samples: &[Sample], degree: usize, refined: bool) -> Fitted<Polynomial> {
        let values: [Terms; CODES] = std::array::from_fn(|z| chebyshev(z as f64));
        let srgb = ResponseCurve::srgb();
        let mut f = srgb.ln_exposure(0).map(libm::exp);
        let mut trust = vec![1.0; samples.len()];
        let mut condition = 0.0;
        for round in 0..ROUNDS.0 {
            let (coefficients, found) = self.solve(&f, &trust, degree)?;
            condition = found;
            let next: [f64; CODES] = std::array::from_fn(|z| dot(&coefficients, &values[z]).max(LEAST));
            let change = next.iter().zip(&f).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
            f = next;
            trust = fit::biweight(samples, &f.map(libm::log));
            if refined && round >= ROUNDS.1 {
                self.estimate(&f, &trust);
            }
            if change < STAYS {
                break;
            }
        }
        let error = self.error(&f, &trust);
        self.estimate(&f, &trust);
        // The power u for which the estimated ratios are closest to the given ones.
        let (mut both, mut given) = (0.0, 0.0);
        for ratio in &self.ratios {
            let step = ratio.ln_times.1 - ratio.ln_times.0;
            both += ratio.ln_ratio * step;
            given += step * step;
        }
        let power = if refined { both / given } else { 1.0 };
        if !POWER.contains(&power) {
            return Err(format!(
                "the exposure steps estimated from the pixels are {power:.2} times the given steps; a factor from {} to {} is accepted",
                POWER.start(),
                POWER.end()
            ));
        }
        let error = error / power;
        let g = f.map(|v| libm::log(v) / power);
        self.ratios.iter_mut().for_each(|ratio| ratio.ln_ratio /= power);
        Ok(Polynomial { g, trust, ratios: self.ratios, condition, degree, error })
    }

    /// Returns the coefficients of f for the current ratios, with errors relative to the previous `f`, and the
    /// condition of the problem.
    fn solve(&self, f: &[f64; CODES], trust: &[f64], degree: usize) -> Fitted<(Vec<f64>, f64)> {
        let mid = chebyshev(MID as f64);
        let mut equations = LeastSquares::new(degree);
        let mut row = vec![0.0; degree + 1];
        let inverse: Vec<f64> = self.ratios.iter().map(|ratio| libm::exp(-ratio.ln_ratio)).collect();
        for pair in &self.all {
            let ratio = inverse[pair.ratio];
            let (a, b) = &pair.terms;
            // For f(128) = 1, c_0 is replaced by 1 - sum c_n T_n(128), n > 0.
            let constant = 1.0 - ratio;
            for n in 1..=degree {
                row[n - 1] = a[n] - ratio * b[n] - constant * mid[n];
            }
            row[degree] = -constant;
            let scale = ratio * fit::at(f, pair.longer.code);
            equations.push(&row, (pair.weight * trust[pair.sample]).sqrt() / scale);
        }
        let (found, condition) = equations.solve()?;
        let first = 1.0 - dot(&found, &mid[1..]);
        Ok((std::iter::once(first).chain(found).collect(), condition))
    }

    /// Returns ln f(longer) - ln f(shorter) of a pair.
    fn step(pair: &Pair, f: &[f64; CODES]) -> f64 {
        libm::log(fit::at(f, pair.longer.code) / fit::at(f, pair.shorter.code))
    }

    /// Estimates the ratios for the current f: means over the places.
    fn estimate(&mut self, f: &[f64; CODES], trust: &[f64]) {
        let mut sums = vec![(0.0, 0.0); self.ratios.len()];
        for pair in &self.all {
            let weight = pair.weight * trust[pair.sample];
            sums[pair.ratio].0 += weight;
            sums[pair.ratio].1 += weight * Self::step(pair, f);
        }
        for (ratio, (weight, sum)) in self.ratios.iter_mut().zip(sums) {
            ratio.weight = weight;
            // If no place has a weight above 0 in both of two exposures, their given ratio is kept.
            if weight > 0.0 {
                ratio.ln_ratio = sum / weight;
            }
        }
    }

    fn error(&self, f: &[f64; CODES], trust: &[f64]) -> f64 {
        let (mut square, mut weight) = (0.0, f64::MIN_POSITIVE);
        for pair in &self.all {
            let w = pair.weight * trust[pair.sample];
            let off = Self::step(pair, f) - self.ratios[pair.ratio].ln_ratio;
            square += w * off * off;
            weight += w;
        }
        (square / weight).sqrt()
    }
}

/// Returns the Chebyshev polynomials T_0, T_1, ... at a code; codes 0..=255 are mapped to -1..=1.
fn chebyshev(code: f64) -> Terms {
    let x = code / 127.5 - 1.0;
    let mut t = [1.0; 11];
    t[1] = x;
    for n in 2..t.len() {
        t[n] = 2.0 * x * t[n - 1] - t[n - 2];
    }
    t
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::super::fit::scene::{difference, scene};
    use super::*;
    use std::f64::consts::LN_2;

    fn curve(samples: &[Sample], options: &Options) -> ([f64; CODES], super::super::Fit) {
        fit::finish(samples, channel(samples, options).unwrap().0).unwrap()
    }

    #[test]
    fn known_curves_come_back() {
        for power in [1.8, 2.2, 2.6] {
            let samples = scene(800, &[-4.0, -2.0, 0.0, 2.0], |x| libm::pow(x, 1.0 / power));
            let (g, fit) = curve(&samples, &Options::default());
            assert!(difference(&g, |v| libm::pow(v, power)) < 0.04, "{power}: {fit:?}");
        }
    }

    #[test]
    fn a_polynomial_of_its_own_degree_is_exact() {
        // f(M) = M^2 sampled without noise: codes 255 sqrt(X).
        let places = (0..200).map(|i| 0.002 * libm::exp2(f64::from(i) / 25.0));
        let samples: Vec<Sample> = places
            .map(|e| [0.0, 1.0, 2.0].map(|s| View { code: 255.0 * (e * libm::exp2(s)).sqrt(), ln_time: s * LN_2 }))
            .map(|views| Sample { views: views.into_iter().filter(|v| v.code < 250.0).collect() })
            .filter(|s: &Sample| s.views.len() > 1)
            .collect();
        let (g, fit) = curve(&samples, &Options { degree: Some(2), ..Options::default() });
        // f is interpolated linearly between codes when ratios are estimated. Near code 10 the relative error of f is
        // up to 1/440.
        assert!(difference(&g, |v| v * v) < 0.003, "{fit:?}");
        assert_eq!(fit.degree, Some(2));
    }

    #[test]
    fn rough_exposures_are_corrected() {
        // The three exposures are two stops apart. The given exposure of the middle frame is 0.2 stops longer than the
        // true one.
        let mut samples = scene(800, &[-2.0, 0.0, 2.0], |x| libm::pow(x, 1.0 / 2.2));
        let said = 0.2;
        for view in samples.iter_mut().flat_map(|s| &mut s.views).filter(|v| v.ln_time == 0.0) {
            view.ln_time = said * LN_2;
        }
        let (found, ratios) = channel(&samples, &Options::default()).unwrap();
        let stops =
            |i: usize| ratios.iter().find(|r| r.ln_times.0 == [-2.0 * LN_2, said * LN_2][i]).unwrap().ln_ratio / LN_2;
        // Ratios of 2.2 and 1.8 stops were given; 2 and 2 are true. The sum of both ratios is not tested: it depends
        // on the power of the ratios, which only the given ratios determine and which has an error of 2 %.
        assert!((stops(0) - stops(1)).abs() < 0.05, "{} {}", stops(0), stops(1));
        let (g, _) = fit::finish(&samples, found).unwrap();
        assert!(difference(&g, |v| libm::pow(v, 2.2)) < 0.08);
    }

    #[test]
    fn samples_that_do_not_determine_a_curve_are_rejected() {
        assert!(channel(&scene(10, &[0.0, 2.0], |x| x.sqrt()), &Options::default()).is_err());
        assert!(Options { degree: Some(11), ..Options::default() }.validate().is_err());
        assert!(Options { degree: Some(0), ..Options::default() }.validate().is_err());
    }
}
