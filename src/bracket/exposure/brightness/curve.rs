//! Fits camera curves to pairs of frames, and computes the exposure steps that follow from each curve.
//!
//! In: the matched pixel values of each pair of frames. Out: for each kind of curve, its likelihood, and the steps that
//! follow from its best curve, with their uncertainties. Cost: some hundred sums over the matches of all pairs for
//! each kind.
//!
//! A curve is the log2 of the exposure as a function of the pixel value. Its slope is the slope of the sRGB curve times
//! exp(p), where p is a cubic polynomial of the pixel value, given by four Legendre terms. Matches never determine the
//! constant term of p, because it multiplies all steps by the same factor (Grossberg and Nayar, "Determining the camera
//! response from images: what is knowable?", PAMI 2003). So the constant term is inferred from the other terms by
//! priors: normal distributions of the four terms, one for each [`Kind`]. The best terms are found by iteratively
//! reweighted Gauss-Newton steps. The likelihood of a kind is the likelihood of its best terms, multiplied by the
//! volume of the region around these terms in which other terms are nearly as likely (Laplace's approximation).

use crate::bracket::colour::srgb_to_linear;
use nalgebra::{Matrix4, Vector4};
use std::sync::LazyLock;

/// A pixel value of the darker frame (`from`), and the pixel value of the same rank in the brighter frame (`to`).
#[derive(Debug, Clone, Copy)]
pub(super) struct Match {
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) weight: f64,
}

/// The matches of two frames.
pub(super) struct Pair {
    pub(super) matches: Vec<Match>,
    /// Share of the pixels of the darker frame whose values are in the range of the matches.
    pub(super) share: f64,
    /// Whether all matched values are well exposed. Otherwise some are barely exposed: there the curves of cameras
    /// differ most, and the step is uncertain.
    pub(super) is_well_exposed: bool,
}

/// A class of curves. `share` is the fraction of photographs that have such a curve. `mean` and `covariance` (its lower
/// triangle) are the prior distribution of the four terms of the curve.
struct Kind {
    share: f64,
    mean: [f64; 4],
    covariance: [f64; 10],
}

/// The kinds of curves. Their distributions were fitted to measured or computed curves, at pixel values 16 to 248. The
/// standard deviation of each term was increased by 0.04 to 0.08, because there are few curves. The shares are
/// estimates and matter little: doubling the share of renderings or of films changes the mean error of rendered and of
/// photographed brackets by less than 1 %.
const KINDS: [Kind; 5] = [
    // Renderings, which have the sRGB curve itself.
    Kind { share: 0.35, mean: [0.0; 4], covariance: [0.0004, 0.0, 0.0004, 0.0, 0.0, 0.0004, 0.0, 0.0, 0.0, 0.0004] },
    // Renderings with more contrast: an sRGB value y becomes (1 - s) y + s (3 y^2 - 2 y^3), with s from 0.05 to 1.
    Kind {
        share: 0.1,
        mean: [-0.113, 0.204, 0.245, 0.039],
        covariance: [0.0100, -0.0120, 0.0194, -0.0086, 0.0137, 0.0140, -0.0038, 0.0055, 0.0039, 0.0034],
    },
    // JPEGs of five cameras of 2002 to 2021, from brackets whose exposures are known.
    Kind {
        share: 0.4,
        mean: [-0.077, 0.698, 0.401, 0.026],
        covariance: [0.0032, -0.0004, 0.0112, 0.0011, 0.0039, 0.0209, 0.0012, 0.0020, 0.0044, 0.0194],
    },
    // Negative film, video and scanners: curves of the Database of Response Functions.
    Kind {
        share: 0.13,
        mean: [-0.058, 0.166, 0.171, -0.084],
        covariance: [0.0241, 0.0230, 0.0339, 0.0004, 0.0036, 0.0065, -0.0005, -0.0007, 0.0017, 0.0059],
    },
    // Slides and papers of high contrast: curves of the same database.
    Kind {
        share: 0.02,
        mean: [-0.576, 0.705, 0.508, 0.020],
        covariance: [0.0416, 0.0145, 0.0486, -0.0044, 0.0254, 0.0353, 0.0065, 0.0153, 0.0093, 0.0212],
    },
];
/// A broad distribution, with which the standard deviation of a match is estimated before the kinds are fitted.
const ANY: Kind = Kind {
    share: 1.0,
    mean: [-0.1, 0.3, 0.25, 0.0],
    covariance: [0.09, 0.0, 0.16, 0.0, 0.0, 0.09, 0.0, 0.0, 0.0, 0.04],
};
/// Standard deviation of a match, in pixel values: `USUAL` is the initial estimate, `ROUNDING` is the minimum, due to
/// rounding.
const USUAL: f64 = 1.5;
const ROUNDING: f64 = 0.6;
/// A match whose error is this many standard deviations has a quarter of its weight (Geman and McClure's function).
const OFF: f64 = 3.0;
/// Number of neighbouring pixel values whose matches have correlated errors, so that together they count as one match.
/// This is an estimate: with 8 or 14, the mean error of rendered brackets changes by less than 1 %.
const ALIKE: f64 = 12.0;
/// `ROUNDS` is the number of Gauss-Newton steps. `STRIDE` is the largest change of a term in one step; a change of one
/// term by 0.7 at most doubles a slope (exp(0.7) = 2).
const ROUNDS: usize = 8;
const STRIDE: f64 = 0.7;

/// For each pixel value `k`: the stops by which the exposure rises from `k` to `k + 1` under the sRGB curve, and the
/// values of the four Legendre polynomials at `k + 1/2`.
static SRGB: LazyLock<Vec<(f64, Vector4<f64>)>> = LazyLock::new(|| {
    let stops = |code: usize| libm::log2(srgb_to_linear(code as f64 / 255.0));
    let rise = |k: usize| {
        // The sRGB exposure of pixel value 0 is minus infinity in stops, so the rise from 1 to 2 is used for 0 as well.
        let k = k.max(1);
        let t = 2.0 * (k as f64 + 0.5) / 255.0 - 1.0;
        let polynomials = [1.0, t, (3.0 * t * t - 1.0) / 2.0, (5.0 * t * t - 3.0) * t / 2.0];
        (stops(k + 1) - stops(k), Vector4::from(polynomials))
    };
    (0..255).map(rise).collect()
});

/// A curve. For each pixel value: the exposure in stops, its derivative with respect to each term, and its rise to the
/// next pixel value.
struct Curve {
    stops: Vec<f64>,
    change: Vec<Vector4<f64>>,
    rise: Vec<f64>,
}

/// For a match and a curve: the exposure of pixel value `to` divided by the exposure of pixel value `from`, in stops,
/// and the derivative of this ratio with respect to each term.
struct Ratio {
    stops: f64,
    change: Vector4<f64>,
    /// Error of `stops` if both pixel values have independent errors of one unit, and the derivative of the logarithm
    /// of this error with respect to each term.
    code: f64,
    code_change: Vector4<f64>,
}

impl Curve {
    fn new(terms: &Vector4<f64>) -> Self {
        let (mut stops, mut change, mut rise) = (vec![0.0], vec![Vector4::zeros()], Vec::new());
        for (k, (srgb, polynomials)) in SRGB.iter().enumerate() {
            let more = srgb * libm::exp(terms.dot(polynomials));
            rise.push(more);
            stops.push(stops[k] + more);
            change.push(change[k] + polynomials * more);
        }
        Curve { stops, change, rise }
    }

    fn at(&self, code: f64) -> (f64, Vector4<f64>, usize) {
        let k = (code.max(0.0) as usize).min(254);
        let share = (code - k as f64).clamp(0.0, 1.0);
        let stops = self.stops[k] * (1.0 - share) + self.stops[k + 1] * share;
        (stops, self.change[k] * (1.0 - share) + self.change[k + 1] * share, k)
    }

    fn ratio(&self, matched: &Match) -> Ratio {
        let ((from, from_change, k), (to, to_change, l)) = (self.at(matched.from), self.at(matched.to));
        let (a, b) = (self.rise[k] * self.rise[k], self.rise[l] * self.rise[l]);
        Ratio {
            stops: to - from,
            change: to_change - from_change,
            code: (a + b).sqrt(),
            code_change: (SRGB[k].1 * a + SRGB[l].1 * b) / (a + b),
        }
    }
}

/// Steps under the best curve of a kind.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    /// Log likelihood of the kind, up to a term that is common to all kinds.
    pub(super) likelihood: f64,
    /// Step of each pair, in EV.
    pub(super) steps: Vec<f64>,
    /// Variance of each step, if this curve is the true one.
    pub(super) variances: Vec<f64>,
    /// Standard deviation of the logarithm of the common factor of all steps, which the matches do not determine.
    pub(super) scale: f64,
    /// For each pair of frames, the standard deviation of a match, in pixel values.
    codes: Vec<f64>,
}

/// Fits a curve of each kind to `pairs`. Kinds without a finite result are left out.
pub(super) fn fits(pairs: &[Pair]) -> Vec<Fit> {
    let Some(any) = fit(pairs, &ANY, &vec![USUAL; pairs.len()]) else { return Vec::new() };
    let codes: Vec<f64> = any.codes.iter().map(|code| code.max(ROUNDING)).collect();
    KINDS.iter().filter_map(|kind| fit(pairs, kind, &codes)).collect()
}

/// Contribution of a pair to the normal equations of the terms.
struct Share {
    normal: Matrix4<f64>,
    gradient: Vector4<f64>,
    cost: f64,
    step: f64,
    variance: f64,
    change: Vector4<f64>,
    code: f64,
}

/// Computes the contribution of a pair with `matches`; `code` is the standard deviation of a match, in pixel values.
fn share(matches: &[Match], curve: &Curve, code: f64) -> Share {
    let ratios: Vec<Ratio> = matches.iter().map(|matched| curve.ratio(matched)).collect();
    let total: f64 = matches.iter().map(|matched| matched.weight).sum();
    let count = matches.len() as f64 / ALIKE / total.max(f64::MIN_POSITIVE);
    let weights: Vec<f64> = matches.iter().map(|matched| matched.weight * count).collect();
    let mut by_code: Vec<(f64, f64)> =
        ratios.iter().zip(&weights).map(|(ratio, weight)| (ratio.stops, weight / ratio.code)).collect();
    let mut step = weighted_median(&mut by_code);
    let robust = |off: f64| 1.0 / (1.0 + off * off / (OFF * OFF));
    let mut precision = 0.0;
    for _ in 0..4 {
        let mut sum = 0.0;
        precision = 0.0;
        for (ratio, weight) in ratios.iter().zip(&weights) {
            let unit = ratio.code * code;
            let robust = robust((ratio.stops - step) / unit);
            let weight = weight * robust * robust / (unit * unit);
            sum += weight * ratio.stops;
            precision += weight;
        }
        step = sum / precision;
    }
    let mut change = Vector4::zeros();
    for (ratio, weight) in ratios.iter().zip(&weights) {
        let unit = ratio.code * code;
        let robust = robust((ratio.stops - step) / unit);
        change += ratio.change * (weight * robust * robust / (unit * unit * precision));
    }
    let (mut normal, mut gradient, mut cost) = (Matrix4::zeros(), Vector4::zeros(), 0.0);
    for (ratio, weight) in ratios.iter().zip(&weights) {
        let unit = ratio.code * code;
        let off = (ratio.stops - step) / unit;
        let robust = robust(off);
        let slope = (ratio.change - change) / unit - ratio.code_change * off;
        normal += slope * slope.transpose() * (weight * robust * robust);
        gradient -= slope * (weight * robust * robust * off);
        cost += weight * off * off * robust / 2.0;
    }
    let mut off: Vec<(f64, f64)> =
        ratios.iter().zip(&weights).map(|(ratio, weight)| ((ratio.stops - step).abs() / ratio.code, *weight)).collect();
    // The median absolute value of normally distributed errors is 0.6745 standard deviations.
    let code = weighted_median(&mut off) / 0.6745;
    Share { normal, gradient, cost, step, variance: 1.0 / precision, change, code }
}

/// Fits the best curve of `kind` to `pairs`; `None` where the result is not finite.
fn fit(pairs: &[Pair], kind: &Kind, codes: &[f64]) -> Option<Fit> {
    let (mean, covariance) = (Vector4::from(kind.mean), symmetric(&kind.covariance));
    let prior = covariance.cholesky()?.inverse();
    let mut terms = mean;
    for round in 0.. {
        let curve = Curve::new(&terms);
        let shares: Vec<Share> =
            pairs.iter().zip(codes).map(|(pair, code)| share(&pair.matches, &curve, *code)).collect();
        let off = terms - mean;
        let normal = shares.iter().fold(prior, |sum, share| sum + share.normal);
        let decomposed = normal.cholesky()?;
        if round < ROUNDS {
            let gradient = shares.iter().fold(-(prior * off), |sum, share| sum + share.gradient);
            let by = decomposed.solve(&gradient);
            let longest = by.amax();
            terms += by * if longest > STRIDE { STRIDE / longest } else { 1.0 };
            continue;
        }
        let cost = shares.iter().fold(off.dot(&(prior * off)) / 2.0, |sum, share| sum + share.cost);
        let room = libm::log(normal.determinant() * covariance.determinant()) / 2.0;
        let span: f64 = shares.iter().map(|share| share.step).sum();
        let change: Vector4<f64> = shares.iter().map(|share| share.change).sum();
        let fit = Fit {
            likelihood: libm::log(kind.share) - cost - room,
            scale: change.dot(&decomposed.solve(&change)).sqrt() / span.abs().max(1e-6),
            variances: shares.iter().map(|share| share.variance).collect(),
            codes: shares.iter().map(|share| share.code).collect(),
            steps: shares.iter().map(|share| share.step).collect(),
        };
        return (fit.likelihood.is_finite() && fit.scale.is_finite()).then_some(fit);
    }
    None
}

/// Returns the symmetric matrix whose lower triangle is `lower`, row by row.
fn symmetric(lower: &[f64; 10]) -> Matrix4<f64> {
    Matrix4::from_fn(|i, j| lower[i.max(j) * (i.max(j) + 1) / 2 + i.min(j)])
}

/// Returns the weighted median of (value, weight) pairs: the smallest value at which half of the total weight is
/// reached.
fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = values.iter().map(|value| value.1).sum::<f64>() / 2.0;
    let mut so_far = 0.0;
    let median = values.iter().find(|value| {
        so_far += value.1;
        so_far >= half
    });
    median.map_or(0.0, |value| value.0)
}
