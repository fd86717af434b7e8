//! Exposure correction: exposure ratios estimated from the pixels.
//!
//! In: a bracket and the codes of its frames at flat places. Out: for each frame, the stops by which its exposure is
//! [corrected](Correction), within bounds; usually 0. Cost: a few systems of about sixty unknowns, a few milliseconds.
//! Source: Ward's hdrgen, option -e, which corrects exposures too; the model is Debevec & Malik 1997, equation 3, with
//! the exposures as additional unknowns:
//!
//! ```text
//! minimise  sum_ij w(Z_ij)^2 [g(Z_ij) - ln E_i - ln dt_j - d_j]^2  +  lambda sum |g''|^2  +  sum_j d_j^2 / sigma^2
//! ```
//!
//! where g, all ln E_i and the corrections d_j are unknowns. They are found together, because each alone would absorb
//! the errors of the others. Z_ij is the code of place i at exposure dt_j, and sigma the standard deviation of the
//! recorded exposures. g is the sRGB curve plus a cubic spline for each channel. Two things cannot be determined from
//! pixels and stay as recorded: a factor that is common to all exposures, and a power to which all exposure ratios are
//! raised, because it only changes the contrast of g (Grossberg & Nayar 2003). Therefore d is orthogonal to the changes
//! of ln dt that such a factor or power causes. So brackets of only two different exposures are never corrected. Places
//! that contradict the others (motion) lose their weight by Tukey's biweight. If all corrections are within the
//! uncertainty of the fit, none is applied, so that exact exposures are not changed.

use super::fit::tukey;
use super::samples::{Places, Sample, draw};
use super::{hat, stops};
use crate::bracket::Bracket;
use crate::bracket::colour::srgb_to_linear;
use crate::bracket::exposure::ExposureSource;
use crate::error::Warning;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::LN_2;

/// Whether exposures are corrected before the frames are divided by them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum Exposures {
    /// Correct the values of the exposures to match the pixels: by up to 1/6 stop if all are from EXIF, by up to 3/4
    /// stop if all are estimated. No exposure is corrected in these three cases: -e is given; some exposures are from
    /// EXIF and some are estimated; the bracket has only two different exposures.
    #[default]
    FineTuned,
    /// Use the values from EXIF, from -e or from the estimate without correction.
    AsGiven,
}

/// The correction of one frame's exposure.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Correction {
    /// Number of stops that are added to the frame's EV.
    pub stops: f64,
    /// The correction that fits best, in stops, if it is out of bounds.
    pub wanted_stops: Option<f64>,
}

/// Largest number of places for each channel.
const PLACES: usize = 1000;
/// Number of intervals of the spline.
const INTERVALS: usize = 16;
/// Number of coefficients of the spline.
const SPLINE: usize = INTERVALS + 3;
/// lambda, the weight of the squared second differences of the spline's coefficients.
const SMOOTHNESS: f64 = 3e-5;
/// Number of rounds in which places that contradict the others lose their weight.
const ROUNDS: usize = 3;
/// Number of places that count as independent in the estimate of uncertainty. It is far below the number of places,
/// because many places have the same error of the model.
const INDEPENDENT: f64 = 50.0;
/// Lower bound of the root mean square misfit, in stops.
const NOISE: f64 = 0.01;
/// Corrections are applied only if one of them is at least this large, in stops. For comparison: on 25 of 27 rendered
/// brackets with exact exposures, all corrections are within 0.006.
const STILL: f64 = 0.025;

/// Returns the standard deviation of exposures from `source`, and the largest correction; both in stops.
fn leeway(source: ExposureSource) -> (f64, f64) {
    match source {
        // The rounding of exposure times in EXIF (1/15 for 1/16 s) causes errors of 0.09 stops, a mechanical shutter
        // or aperture about as much.
        ExposureSource::Exif => (0.07, 1.0 / 6.0),
        ExposureSource::Estimated => (0.35, 0.75),
        ExposureSource::Given => (0.0, 0.0),
    }
}

/// Corrects the exposures of `bracket` and of its `places`. Returns the bracket and warnings.
pub fn fine_tuned(bracket: Bracket, places: &mut Places) -> (Bracket, Vec<Warning>) {
    let (corrections, warnings) = corrections(&bracket, places);
    let bracket = bracket.corrected(&corrections.iter().map(|c| c.stops).collect::<Vec<_>>());
    places.time(&bracket);
    (bracket, warnings)
}

/// Returns the correction of each frame of `bracket` from its `places`, and warnings.
pub fn corrections(bracket: &Bracket, places: &Places) -> (Vec<Correction>, Vec<Warning>) {
    let none = || (vec![Correction::default(); bracket.frames().len()], Vec::new());
    let Some(first) = bracket.frames().first() else { return none() };
    let (sigma, bound) = leeway(first.exposure.source);
    if bound <= 0.0 || bracket.frames().iter().any(|frame| frame.exposure.source != first.exposure.source) {
        return none();
    }
    let samples = draw(&[places], PLACES).channels;
    // Samples contain exposures, not frames, so frames with equal exposures get equal corrections.
    let mut times: Vec<f64> = samples.iter().flatten().flat_map(|s| s.views.iter().map(|v| v.ln_time)).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let Some(wanted) = fit(&samples, &times, sigma) else { return none() };
    if wanted.iter().all(|d| d.abs() < STILL) {
        return none();
    }
    let reference = bracket.reference().exposure.relative();
    let mut warnings = Vec::new();
    let corrections = bracket.frames().iter().map(|frame| {
        let ln_time = libm::log(frame.exposure.relative() / reference);
        let found = times.iter().position(|&t| t == ln_time).map_or(0.0, |j| wanted[j]);
        let used = found.clamp(-bound, bound);
        if used != found {
            let path = frame.path().to_owned();
            warnings.push(Warning::ExposureBounded { path, wanted_stops: found, used_stops: used });
        }
        Correction { stops: used, wanted_stops: (used != found).then_some(found) }
    });
    (corrections.collect(), warnings)
}

/// Returns the corrections of the exposures `times`, in stops, or `None` if there are too few exposures or samples.
fn fit(samples: &[Vec<Sample>; 3], times: &[f64], sigma: f64) -> Option<Vec<f64>> {
    let free = free_directions(times);
    if free.is_empty() {
        return None;
    }
    let free = DMatrix::from_columns(&free);
    let mut trust: Vec<Vec<f64>> = samples.iter().map(|s| vec![1.0; s.len()]).collect();
    let mut noise = 3.0 * NOISE * LN_2;
    let mut d = DVector::zeros(times.len());
    for round in 0..=ROUNDS {
        let sums: Vec<Sums> = (0..3).into_par_iter().map(|c| Sums::of(&samples[c], &trust[c], times)).collect();
        let (g, found) = solve(&sums, &free, noise, sigma * LN_2)?;
        d = found;
        if round < ROUNDS {
            let fits: Vec<(Vec<f64>, f64, f64)> =
                (0..3).into_par_iter().map(|c| misfits(&samples[c], &trust[c], times, &g[c], &d)).collect();
            let (square, weight) = fits.iter().fold((0.0, 0.0), |(s, w), f| (s + f.1, w + f.2));
            noise = (square / weight.max(f64::MIN_POSITIVE)).sqrt().max(NOISE * LN_2);
            trust = fits.into_iter().map(|(misfits, ..)| tukey(&misfits)).collect();
        }
    }
    d.iter().all(|v| v.is_finite()).then(|| d.iter().map(|&v| stops(v)).collect())
}

/// Returns the directions in which the logarithms of the exposures may be corrected, as unit vectors (Gram-Schmidt).
/// They are orthogonal to each other and to two directions: multiplying all exposures by the same factor, and raising
/// them all to the same power.
fn free_directions(times: &[f64]) -> Vec<DVector<f64>> {
    let n = times.len();
    let unit = |j: usize| DVector::from_fn(n, |i, _| f64::from(i == j));
    let candidates = [DVector::repeat(n, 1.0), DVector::from_row_slice(times)].into_iter().chain((0..n).map(unit));
    let mut basis: Vec<DVector<f64>> = Vec::new();
    for candidate in candidates {
        let mut v = candidate.clone();
        // Two passes are enough for orthogonality in spite of rounding.
        for _ in 0..2 {
            for b in &basis {
                v -= b * b.dot(&v);
            }
        }
        let length = v.norm();
        if length > 1e-6 * candidate.norm() {
            basis.push(v / length);
        }
    }
    basis.drain(..basis.len().min(2));
    basis
}

/// Returns ln of the exposure that gives a code by the sRGB curve; finite at code 0.
fn base(code: f64) -> f64 {
    libm::log(srgb_to_linear(code.max(0.25) / 255.0))
}

/// Returns the index of the first of the four coefficients that have a weight at a code, and the four weights. The
/// splines are cubic B-splines whose knots (the codes where their pieces meet) are evenly spaced. In `spline.rs`, the
/// knots are not evenly spaced, and only integer codes are evaluated.
fn spline(code: f64) -> (usize, [f64; 4]) {
    let x = (code / 255.0 * INTERVALS as f64).clamp(0.0, INTERVALS as f64 - 1e-9);
    let f = x - x.floor();
    let (one, f2, f3) = (1.0 - f, f * f, f * f * f);
    let b = [one * one * one, 3.0 * f3 - 6.0 * f2 + 4.0, -3.0 * f3 + 3.0 * f2 + 3.0 * f + 1.0, f3];
    (x as usize, b.map(|v| v / 6.0))
}

/// Normal equations of one channel, for the coefficients of its spline and the corrections. The unknown ln E of each
/// place is eliminated: the weighted mean of the rows of the place is subtracted from each of them.
struct Sums {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    weight: f64,
}

impl Sums {
    fn of(samples: &[Sample], trust: &[f64], times: &[f64]) -> Self {
        let n = SPLINE + times.len();
        let (mut matrix, mut right, mut total) = (DMatrix::zeros(n, n), DVector::zeros(n), 0.0);
        for (sample, &trust) in samples.iter().zip(trust) {
            let (mut all, mut mean, mut value) = (0.0, DVector::<f64>::zeros(n), 0.0);
            for view in &sample.views {
                let Some(j) = times.iter().position(|&t| t == view.ln_time) else { continue };
                let w = trust * hat(view.code) * hat(view.code);
                let y = view.ln_time - base(view.code);
                let (first, b) = spline(view.code);
                let row = [(first, b[0]), (first + 1, b[1]), (first + 2, b[2]), (first + 3, b[3]), (SPLINE + j, -1.0)];
                all += w;
                value += w * y;
                for (k, a) in row {
                    mean[k] += w * a;
                    right[k] += w * a * y;
                    for (l, b) in row {
                        matrix[(k, l)] += w * a * b;
                    }
                }
            }
            if all > 0.0 {
                right.axpy(-value / all, &mean, 1.0);
                matrix.ger(-1.0 / all, &mean, &mean, 1.0);
                total += all;
            }
        }
        Sums { matrix, right, weight: total }
    }
}

/// Returns the coefficients of the three splines, and the corrections.
fn solve(sums: &[Sums], free: &DMatrix<f64>, noise: f64, sigma: f64) -> Option<(Vec<DVector<f64>>, DVector<f64>)> {
    let n = free.nrows();
    let weight: f64 = sums.iter().map(|s| s.weight).sum();
    if weight <= 0.0 {
        return None;
    }
    // The splines are independent of each other: each is eliminated separately, which leaves equations in d (a Schur
    // complement).
    let (mut matrix, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let mut parts = Vec::with_capacity(sums.len());
    for sum in sums {
        let m = &sum.matrix / weight;
        let r = &sum.right / weight;
        let mut curve = m.view((0, 0), (SPLINE, SPLINE)).into_owned();
        for k in 1..SPLINE - 1 {
            for (i, a) in [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)] {
                for (l, b) in [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)] {
                    curve[(i, l)] += SMOOTHNESS * a * b;
                }
            }
        }
        // The first term sets the offset of g, which no other equation determines. The second term regularises
        // coefficients without samples.
        curve[(SPLINE / 2, SPLINE / 2)] += 1.0;
        (0..SPLINE).for_each(|k| curve[(k, k)] += 1e-10);
        let cross = m.view((0, SPLINE), (SPLINE, n)).into_owned();
        let factors = curve.cholesky()?;
        let (by_d, by_r) = (factors.solve(&cross), factors.solve(&r.rows(0, SPLINE).into_owned()));
        matrix += m.view((SPLINE, SPLINE), (n, n)) - cross.tr_mul(&by_d);
        right += r.rows(SPLINE, n) - cross.tr_mul(&by_r);
        parts.push((by_d, by_r));
    }
    let scale = INDEPENDENT / (noise * noise);
    let mut small = free.tr_mul(&(&matrix * free)) * scale;
    (0..small.nrows()).for_each(|k| small[(k, k)] += 1.0 / (sigma * sigma));
    let d = free * small.cholesky()?.solve(&(free.tr_mul(&right) * scale));
    Some((parts.into_iter().map(|(by_d, by_r)| by_r - by_d * &d).collect(), d))
}

/// Returns the root mean square misfit of each place, and two sums over all places: the sum of (weight of the place)
/// w^2 (misfit)^2, and the sum of (weight of the place) w^2. Misfits are in nepers.
fn misfits(
    samples: &[Sample],
    trust: &[f64],
    times: &[f64],
    g: &DVector<f64>,
    d: &DVector<f64>,
) -> (Vec<f64>, f64, f64) {
    let (mut squares, mut weights) = (0.0, 0.0);
    let each = samples.iter().zip(trust).map(|(sample, trust)| {
        let views: Vec<(f64, f64)> = sample
            .views
            .iter()
            .filter_map(|view| {
                let j = times.iter().position(|&t| t == view.ln_time)?;
                let (first, b) = spline(view.code);
                let value: f64 = (0..4).map(|k| b[k] * g[first + k]).sum();
                Some((hat(view.code) * hat(view.code), base(view.code) + value - view.ln_time - d[j]))
            })
            .collect();
        let weight = views.iter().map(|v| v.0).sum::<f64>().max(f64::MIN_POSITIVE);
        let mean = views.iter().map(|v| v.0 * v.1).sum::<f64>() / weight;
        let square: f64 = views.iter().map(|v| v.0 * (v.1 - mean) * (v.1 - mean)).sum();
        squares += trust * square;
        weights += trust * weight;
        (square / views.len().max(1) as f64).sqrt()
    });
    let each = each.collect();
    (each, squares, weights)
}

#[cfg(test)]
mod tests;
