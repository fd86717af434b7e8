//! The response by alternation, after Robertson, Borman & Stevenson 2003.
//!
//! In: the [`Sample`]s of a channel. Out: g(Z) = ln I(Z), or the reason why it cannot be recovered. Cost: about a
//! hundred sweeps over the samples, each about 0.1 ms for 2000. Source: Robertson, Borman & Stevenson 2003,
//! "Estimation-theoretic approach to dynamic range enhancement using multiple exposures", section IV: the exposures
//! I_m of all codes m and the irradiances x_j of all places j minimise
//!
//! ```text
//! O = sum_ij w_ij (I(y_ij) - t_i x_j)^2
//! ```
//!
//! where y_ij is the code of place j in frame i, and t_i the exposure of frame i. Each Gauss-Seidel iteration (sweep)
//! first computes the x_j for the current I_m: x_j = sum_i w t_i I / sum_i w t_i^2. It then computes the I_m for these
//! x_j: the mean of t_i x_j over all views (places in one frame) of code m. Finally, all I_m are divided by I_128. w is
//! the Gaussian of the paper, exp(-4 (y - 127.5)^2 / 127.5^2). Five things differ from the paper:
//!
//! - y_ij is the mean of a patch and lies between two codes; I is interpolated linearly between them, and a view counts
//!   for both codes.
//! - w is divided by I^2, so that the relative error is minimised. Absolute errors would be dominated by bright
//!   codes, and dark codes would have errors of at least 0.1 stops (measured on rendered brackets).
//! - The change of ln I in a sweep is smoothed over the codes (Whittaker 1923). Without smoothing the sweeps converge
//!   to noise: the sums have no unique minimum, because nothing relates a code to its neighbours.
//! - The sweeps start from the sRGB curve instead of a line, and end when they reduce the objective by less than a
//!   thousandth, so that whatever the frames do not determine stays as in the sRGB curve.
//! - Places that contradict the others (motion) lose their weight in three rounds, as in the other models.

use super::fit::{self, Fitted, Found, between};
use super::samples::{Sample, View};
use super::{CODES, MID, ResponseCurve};
use crate::error::{Error, Result};

/// Smallest factor by which a sweep may change an exposure.
const LEAST: f64 = 0.2;

/// Options of the fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Largest number of places for each channel; 24 or more.
    pub samples: usize,
    /// Weight of the smoothness term, positive. The term is the sum over the codes of the squared second differences of
    /// a sweep's change of ln I. The other term is scaled to one view per code on average.
    pub smoothness: f64,
    /// Sweeps are repeated as long as each reduces the objective by at least this fraction; positive, below 1.
    pub gain: f64,
    /// Largest number of sweeps in all rounds; 1 or more.
    pub sweeps: usize,
    /// Number of rounds in which contradicting samples lose their weight; 0 for none.
    pub rounds: usize,
}

impl Default for Options {
    fn default() -> Self {
        Options { samples: 2000, smoothness: 1e4, gain: 1e-3, sweeps: 400, rounds: 3 }
    }
}

impl Options {
    /// # Errors
    /// [`Error::Option`] if a value cannot be used.
    pub fn validate(&self) -> Result<()> {
        fit::enough(self.samples)?;
        let reason = if !(self.smoothness > 0.0 && self.smoothness.is_finite()) {
            format!("the smoothness must be positive, not {}", self.smoothness)
        } else if !(self.gain > 0.0 && self.gain < 1.0) {
            format!("the smallest gain must be between 0 and 1, not {}", self.gain)
        } else if self.sweeps == 0 {
            "the number of sweeps (iterations) must be at least 1, not 0".to_owned()
        } else {
            return Ok(());
        };
        Err(Error::Option { option: "--response-model", reason })
    }
}

/// Returns g of one channel, or the reason why it cannot be recovered.
pub(super) fn channel(samples: &[Sample], options: &Options) -> Fitted<Found> {
    fit::check(samples)?;
    let seen: Vec<Vec<SweepView>> = samples.iter().map(|s| s.views.iter().map(SweepView::of).collect()).collect();
    let mut g = *ResponseCurve::srgb().ln_exposure(0);
    let mut trust = vec![1.0; samples.len()];
    let mut left = options.sweeps;
    for round in 0..=options.rounds {
        let mut last = f64::INFINITY;
        while left > 0 {
            left -= 1;
            let (next, objective) = sweep(&seen, &trust, &g, options.smoothness)?;
            if objective.is_nan() || objective > last * (1.0 - options.gain) {
                break;
            }
            (g, last) = (next, objective);
        }
        if round < options.rounds {
            trust = fit::biweight(samples, &g);
        }
    }
    Ok(Found { g, trust, condition: None, degree: None })
}

/// A view, with the values that each sweep needs.
struct SweepView {
    /// The two neighbouring codes, with their weights.
    codes: [(usize, f64); 2],
    /// Relative exposure t.
    time: f64,
    /// The Gaussian w, largest halfway between black and white.
    weight: f64,
}

impl SweepView {
    fn of(view: &View) -> Self {
        let off = view.code / 127.5 - 1.0;
        SweepView { codes: between(view.code), time: libm::exp(view.ln_time), weight: libm::exp(-4.0 * off * off) }
    }

    /// Returns t / I.
    fn rate(&self, exposure: &[f64; CODES]) -> f64 {
        self.time / self.codes.iter().map(|&(z, f)| f * exposure[z]).sum::<f64>()
    }
}

/// Updates all x_j and then all I_m. Returns the new ln I, and the root mean square of 1 - t x / I with the old I.
fn sweep(samples: &[Vec<SweepView>], trust: &[f64], g: &[f64; CODES], smoothness: f64) -> Fitted<([f64; CODES], f64)> {
    let exposure = g.map(libm::exp);
    let (mut change, mut count) = ([0.0; CODES], [0.0; CODES]);
    let (mut square, mut weight) = (0.0, 0.0);
    for (sample, trust) in samples.iter().zip(trust) {
        let (mut above, mut below) = (0.0, 0.0);
        for seen in sample {
            let rate = seen.rate(&exposure);
            above += seen.weight * rate;
            below += seen.weight * rate * rate;
        }
        let x = above / below;
        for seen in sample {
            let error = seen.rate(&exposure) * x - 1.0;
            square += trust * seen.weight * error * error;
            weight += trust * seen.weight;
            for (z, f) in seen.codes {
                change[z] += trust * f * error;
                count[z] += trust * f;
            }
        }
    }
    let mean = count.iter().sum::<f64>() / CODES as f64;
    if mean.is_nan() || mean <= 0.0 {
        return Err(fit::undetermined(f64::INFINITY));
    }
    let smooth = whittaker(&count.map(|n| n / mean), &change.map(|c| c / mean), smoothness);
    let mut next: [f64; CODES] = std::array::from_fn(|z| g[z] + libm::log((1.0 + smooth[z]).max(LEAST)));
    let mid = next[MID];
    next.iter_mut().for_each(|v| *v -= mid);
    Ok((next, (square / weight).sqrt()))
}

/// Returns the values u that minimise sum_z n_z (u_z - c_z / n_z)^2 + lambda sum_z (u_{z-1} - 2 u_z + u_{z+1})^2. n_z
/// is the total weight of the views at code z. c_z is the weighted sum of the relative errors t x / I - 1 of these
/// views, so c_z / n_z is the mean of these errors. Codes without views are interpolated by cubics. Before the first
/// and after the last code with views, they are extrapolated linearly. Solves a pentadiagonal system by L D L'.
fn whittaker(n: &[f64; CODES], c: &[f64; CODES], lambda: f64) -> [f64; CODES] {
    let (mut diagonal, mut first, mut second) = (*n, [0.0; CODES], [0.0; CODES]);
    for z in 1..CODES - 1 {
        diagonal[z - 1] += lambda;
        diagonal[z] += 4.0 * lambda;
        diagonal[z + 1] += lambda;
        first[z - 1] -= 2.0 * lambda;
        first[z] -= 2.0 * lambda;
        second[z - 1] += lambda;
    }
    // L has 1 on its diagonal, and `first` and `second` on the two diagonals below it. Before they are divided by D,
    // `first` and `second` contain D L'.
    let mut u = *c;
    for z in 0..CODES {
        let d = diagonal[z];
        let (a, b) = (first[z] / d, second[z] / d);
        if z + 1 < CODES {
            diagonal[z + 1] -= a * first[z];
            first[z + 1] -= a * second[z];
            u[z + 1] -= a * u[z];
        }
        if z + 2 < CODES {
            diagonal[z + 2] -= b * second[z];
            u[z + 2] -= b * u[z];
        }
        (first[z], second[z]) = (a, b);
    }
    for z in (0..CODES).rev() {
        u[z] /= diagonal[z];
        if z + 1 < CODES {
            u[z] -= first[z] * u[z + 1];
        }
        if z + 2 < CODES {
            u[z] -= second[z] * u[z + 2];
        }
    }
    u
}

#[cfg(test)]
mod tests {
    use super::super::fit::scene::{difference, noise, scene};
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn known_curves_come_back() {
        for power in [1.8, 2.2, 2.6] {
            let samples = scene(800, &[-4.0, -2.0, 0.0, 2.0], |x| libm::pow(x, 1.0 / power));
            let (g, fit) = fit::finish(&samples, channel(&samples, &Options::default()).unwrap()).unwrap();
            assert!(difference(&g, |v| libm::pow(v, power)) < 0.04, "{power}: {fit:?}");
        }
    }

    #[test]
    fn sweeps_do_not_raise_the_objective_and_keep_a_curve_without_error() {
        let samples = scene(800, &[-2.0, 0.0, 2.0], |x| libm::pow(x, 1.0 / 1.8));
        let trust = vec![1.0; samples.len()];
        let seen = |samples: &[Sample]| -> Vec<Vec<SweepView>> {
            samples.iter().map(|s| s.views.iter().map(SweepView::of).collect()).collect()
        };
        let (mut g, mut last) = (*ResponseCurve::srgb().ln_exposure(0), f64::INFINITY);
        for _ in 0..8 {
            let (next, objective) = sweep(&seen(&samples), &trust, &g, 1e4).unwrap();
            assert!(objective < last && next[MID] == 0.0, "{objective} after {last}");
            (g, last) = (next, objective);
        }
        // The samples have no noise, and linear interpolation reproduces a linear curve exactly. So the true curve is a
        // fixed point.
        let exact: Vec<Sample> = (0..100)
            .map(|i| 20.0 + i as f64)
            .map(|z| Sample { views: [1.0, 2.0].map(|t| View { code: t * z, ln_time: libm::log(t) }).to_vec() })
            .collect();
        let line = std::array::from_fn(|z| libm::log((z as f64).max(0.5) / MID as f64));
        let (next, objective) = sweep(&seen(&exact), &[1.0; 100], &line, 1e4).unwrap();
        assert!(objective < 1e-12 && next.iter().zip(&line).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn the_smoother_solves_its_equations() {
        let n = std::array::from_fn(|z| if (40..60).contains(&z) { 0.0 } else { 1.0 + noise(z) });
        let c = std::array::from_fn(|z| n[z] * noise(1000 + z));
        let mut matrix = DMatrix::from_diagonal(&DVector::from_column_slice(&n));
        for z in 1..CODES - 1 {
            for (i, a) in [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)] {
                for (k, b) in [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)] {
                    matrix[(i, k)] += 300.0 * a * b;
                }
            }
        }
        let dense = matrix.cholesky().unwrap().solve(&DVector::from_column_slice(&c));
        // The tolerance is the condition number, about 16 x 300 x 256 = 1e6, times the rounding error of 2e-16, with a
        // margin.
        assert!(whittaker(&n, &c, 300.0).iter().zip(&dense).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn samples_that_do_not_determine_a_curve_are_rejected() {
        let why = |samples: &[Sample]| channel(samples, &Options::default()).unwrap_err();
        assert!(why(&scene(10, &[0.0, 2.0], |x| x.sqrt())).contains("smooth areas"));
        assert!(Options { gain: 1.0, ..Options::default() }.validate().is_err());
    }
}
