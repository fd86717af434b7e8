//! Combines the exposure steps estimated under each kind of curve with a prior of the steps that cameras are set to.
//!
//! In: for each kind of curve, the steps between neighbouring frames, with uncertainties. Out: the mean of each step,
//! and the covariances of the steps. Cost: for each pair of frames and each kind, a table for some hundred factors and
//! twenty step sizes.
//!
//! The common factor of all steps is uncertain by several percent, but photographers set steps of thirds of an EV,
//! mostly of whole EVs, and mostly the same step between all frames. So each possible factor is weighted by how close
//! the multiplied steps are to such values. All probability densities are with respect to the logarithm of a step, so
//! that they do not depend on the kind of curve.

use super::curve::{self, Fit, Pair};
use std::f64::consts::PI;

/// Mean of each step, in EV, and the covariances of the steps.
#[derive(Debug, Clone, Default)]
pub(super) struct Steps {
    pub(super) means: Vec<f64>,
    /// Covariance matrix of the steps, row by row.
    covariances: Vec<f64>,
}

impl Steps {
    /// Returns the variance of the sum of the steps of `range`.
    pub(super) fn variance(&self, range: std::ops::Range<usize>) -> f64 {
        let count = self.means.len();
        range.clone().map(|i| self.covariances[i * count..][range.clone()].iter().sum::<f64>()).sum()
    }
}

/// Number of different steps that can be set on a camera: multiples of a third of an EV, up to 6 EV.
const THIRDS: usize = 18;
/// Prior probability that a step is a whole number of EV, another multiple of a third, or has any other value. These
/// are estimates and matter little: the mean error of fourteen camera brackets is 3 % with these values, 4 % with 0.2,
/// 0.4 and 0.4, and 3 % with 0.6, 0.1 and 0.3.
const WHOLE: f64 = 0.45;
const THIRD: f64 = 0.15;
const OTHER: f64 = 0.4;
/// Probability density of other steps, with respect to the logarithm of the step. The density is uniform from 0.2 to 6
/// EV: 1 / ln(6 / 0.2) = 1 / ln(30).
const ANY: f64 = 0.3;
/// `EVEN` is the prior probability that a bracket of three or more frames has equal steps. `ODD` is the prior
/// probability that a step of such a bracket still differs from the others. These are estimates: 0.3 or 0.8 for `EVEN`,
/// and 0.1 for `ODD`, give results that are as good.
const EVEN: f64 = 0.6;
const ODD: f64 = 0.2;
/// Standard deviation of a step, even if the curve is the true one. It has two parts. `SHARE_OFF` is due to the
/// shutter, as a fraction of the step. `EV_OFF` is due to flicker and motion, in EV; it is divided by the square root
/// of the fraction of matched pixels, and the quotient is at most `MOST_OFF`. Measured on camera brackets with known
/// exposures.
const SHARE_OFF: f64 = 0.02;
const EV_OFF: f64 = 0.04;
const MOST_OFF: f64 = 0.2;
/// Steps below this, in EV, are not used to determine the common factor of the steps.
const NO_STEP: f64 = 0.15;
/// Number of common factors that are tried on either side of 1, and the spacing of their natural logarithms.
const FACTORS: i32 = 100;
const FACTOR: f64 = 0.005;
/// A hypothesis is dropped if its log likelihood is smaller than the largest log likelihood by this or more.
const NEVER: f64 = 14.0;

/// A hypothesis for the steps: its log likelihood, and the mean and the variance of each step.
struct Way {
    log: f64,
    means: Vec<f64>,
    variances: Vec<f64>,
}

/// Estimates the steps of `pairs` of frames of one camera, averaged over all kinds of curves.
pub(super) fn of(pairs: &[Pair]) -> Option<Steps> {
    let fits = curve::fits(pairs);
    let off: Vec<f64> = pairs.iter().map(|pair| (EV_OFF / pair.share.sqrt()).min(MOST_OFF)).collect();
    let likeliest = fits.iter().map(|fit| fit.likelihood).max_by(f64::total_cmp)?;
    let mut ways = Vec::new();
    for fit in fits.iter().filter(|fit| fit.likelihood > likeliest - NEVER) {
        let scale = fit.scale.max(FACTOR);
        for factor in -FACTORS..=FACTORS {
            let factor = f64::from(factor) * FACTOR;
            let unlikely = factor * factor / (scale * scale) / 2.0;
            if unlikely < NEVER {
                let log = fit.likelihood - likeliest - unlikely - libm::log(scale);
                add_ways(log, fit, &off, libm::exp(factor), &mut ways);
            }
        }
    }
    let best = ways.iter().map(|way| way.log).max_by(f64::total_cmp)?;
    ways.retain(|way| way.log > best - NEVER);
    let weights: Vec<f64> = ways.iter().map(|way| libm::exp(way.log - best)).collect();
    let total: f64 = weights.iter().sum();
    let count = ways.first()?.means.len();
    let mut means = vec![0.0; count];
    for (way, weight) in ways.iter().zip(&weights) {
        means.iter_mut().zip(&way.means).for_each(|(sum, mean)| *sum += weight / total * mean);
    }
    let mut covariances = vec![0.0; count * count];
    for (way, weight) in ways.iter().zip(&weights) {
        for i in 0..count {
            let off = weight / total * (way.means[i] - means[i]);
            for j in 0..count {
                covariances[i * count + j] += off * (way.means[j] - means[j]);
            }
            covariances[i * count + i] += weight / total * way.variances[i];
        }
    }
    Some(Steps { means, covariances })
}

/// Adds the hypotheses for the steps of `fit` multiplied by `factor`. In one hypothesis, the steps are independent. For
/// each step size that can be set on a camera, there is another: each step has this size, or, with the probability
/// [`ODD`], any other size. `off` is the standard deviation of each step due to flicker and motion ([`EV_OFF`]).
fn add_ways(log: f64, fit: &Fit, off: &[f64], factor: f64, ways: &mut Vec<Way>) {
    let nominal = |third: usize| third as f64 / 3.0;
    let chance = |third: usize| if third.is_multiple_of(3) { WHOLE / 6.0 } else { THIRD / 12.0 };
    // For each step, its value, its variance, and its probability densities at the steps that can be set on a camera. A
    // step below `NO_STEP` has no densities.
    let seen: Vec<(f64, f64, Vec<f64>)> = fit
        .steps
        .iter()
        .zip(&fit.variances)
        .zip(off)
        .map(|((&step, &variance), off)| {
            let error = (variance + (SHARE_OFF * step) * (SHARE_OFF * step) + off * off).sqrt();
            let value = factor * step;
            if step < NO_STEP {
                return (value, (factor * error) * (factor * error), Vec::new());
            }
            let error = factor * error;
            let densities = (1..=THIRDS).map(|third| {
                let off = (value - nominal(third)) / error;
                libm::exp(-off * off / 2.0) * value / (error * (2.0 * PI).sqrt())
            });
            (value, error * error, densities.collect())
        })
        .collect();

    let even = if fit.steps.len() > 1 { EVEN } else { 0.0 };
    let mut way = Way { log: log + libm::log(1.0 - even), means: Vec::new(), variances: Vec::new() };
    for (value, variance, densities) in &seen {
        let weights: Vec<f64> = densities.iter().zip(1..).map(|(density, third)| density * chance(third)).collect();
        let set: f64 = weights.iter().sum();
        let other = OTHER * ANY;
        let mean =
            (other * value + weights.iter().zip(1..).map(|(w, third)| w * nominal(third)).sum::<f64>()) / (other + set);
        let square = |at: f64| (at - mean) * (at - mean);
        let spread: f64 = weights.iter().zip(1..).map(|(w, third)| w * square(nominal(third))).sum();
        way.log += libm::log(other + set);
        way.means.push(mean);
        way.variances.push((other * (variance + square(*value)) + spread) / (other + set));
    }
    ways.push(way);
    if even == 0.0 {
        return;
    }
    for third in 1..=THIRDS {
        let log = log + libm::log(even * chance(third) / (WHOLE + THIRD));
        let mut way = Way { log, means: Vec::new(), variances: Vec::new() };
        for (value, variance, densities) in &seen {
            let set = densities.get(third - 1).map_or(0.0, |density| (1.0 - ODD) * density);
            let odd = ODD * ANY;
            let share = set / (set + odd);
            way.log += libm::log(set + odd);
            way.means.push(share * nominal(third) + (1.0 - share) * value);
            let apart = value - nominal(third);
            way.variances.push((1.0 - share) * (variance + share * apart * apart));
        }
        ways.push(way);
    }
}
