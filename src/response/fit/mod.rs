//! Common parts of the fits: whether the samples determine a curve, which of them contradict it, and whether it is
//! plausible for a camera.
//!
//! In: the [`Sample`]s of a channel and the fit of a model to them. Out: g(Z), rising, with g(128) = 0, and its
//! [accuracy](Fit), or the reason why it cannot be recovered. Cost: a pass over the samples. Source: Tukey's biweight
//! is Beaton & Tukey 1974.

pub(super) mod least_squares;
pub(super) mod monotone;
pub(super) mod spline;

use super::samples::{Sample, View};
use super::{CODES, Fit, MID, hat, stops};
use crate::error::{Error, Result};
use crate::statistics::{self, MEDIAN_DEVIATION, median};
use std::f64::consts::LN_2;

/// Smallest rise of g per code. It is far below the accuracy that matters, but large enough that g can be inverted.
const RISE: f64 = 1e-5;
/// Smallest number of samples from which the response of a channel is recovered.
const FEWEST: usize = 24;
/// Smallest range of the samples' codes from which a response is recovered.
const SPAN: f64 = 96.0;
/// A response is recovered only if the shortest and the longest exposure of the samples differ by at least this many
/// stops.
const STEP: f64 = 0.3;
/// Largest condition number of a least-squares problem. Above it, the solution is noise: singular values below 1e-5 of
/// the largest count as 0. In directions that the codes do not determine, singular values should be 0. But codes have
/// errors of about 1e-3, which leave singular values of up to about 1e-5 of the largest. The condition number of a
/// bracket is about 1e2 to 1e4.
const CONDITION: f64 = 1e5;
/// Range of stops from code 16 to code 240 that a camera may have. For comparison: the sRGB curve has 7.4 stops, a
/// linear curve 3.9, a scan of print film 10.
const CONTRAST: (f64, f64) = (1.5, 16.0);
/// Any range of this many codes between 16 and 240 must span at least this many stops. For comparison: in a curve with
/// the smallest [`CONTRAST`] and the same slope at all codes, such a range spans 0.43 stops. The limit detects samples
/// that contradict each other: they make the fitted curve fall, and it becomes flat when it is made monotone.
const FLAT: (usize, f64) = (64, 0.1);
/// Largest root mean square residual of a valid model, in stops.
pub(super) const RESIDUAL: f64 = 0.5;

/// A result, or the reason why there is none.
pub type Fitted<T> = std::result::Result<T, String>;

/// The fit of a model to the samples of a channel.
#[derive(Debug, Clone)]
pub struct Found {
    /// ln(E dt) at codes 0..=255, plus an unknown constant. It may still fall in places.
    pub g: [f64; CODES],
    /// Weight of each sample, 0..=1.
    pub trust: Vec<f64>,
    /// Ratio of the largest to the smallest singular value of the equations; `None` if no system is solved.
    pub condition: Option<f64>,
    /// Degree of the polynomial, if the model is one.
    pub degree: Option<usize>,
}

/// Makes the curve rise everywhere. Returns it with its accuracy, or the reason why it is not plausible.
pub fn finish(samples: &[Sample], found: Found) -> Fitted<([f64; CODES], Fit)> {
    let Found { g, trust, condition, degree } = found;
    if g.iter().any(|v| !v.is_finite()) {
        return Err("the recovered curve contains infinite or invalid values".to_owned());
    }
    let mut weights = [1e-6; CODES];
    let all: f64 = samples.iter().zip(&trust).flat_map(|(s, t)| s.views.iter().map(move |v| t * square(v))).sum();
    for (sample, trust) in samples.iter().zip(&trust) {
        for view in &sample.views {
            between(view.code).iter().for_each(|&(z, f)| weights[z] += trust * square(view) * f / all);
        }
    }
    let rising = monotone::rising(&g, &weights, RISE);
    let mut curve: [f64; CODES] = std::array::from_fn(|z| rising[z]);
    let mid = curve[MID];
    curve.iter_mut().for_each(|v| *v -= mid);
    let fit = Fit {
        samples: samples.len(),
        outliers: trust.iter().filter(|&&t| t < 0.5).count(),
        residual_stops: stops(residual(samples, &trust, &curve)),
        codes: span(samples, |v| v.code),
        condition,
        degree,
        borrowed: false,
    };
    check_plausible(&curve, &fit).map(|()| (curve, fit))
}

/// Returns the smallest and the largest value of `of` over all views.
fn span(samples: &[Sample], of: fn(&View) -> f64) -> (f64, f64) {
    let values = samples.iter().flat_map(|s| s.views.iter().map(of));
    values.fold((f64::MAX, f64::MIN), |(least, most), v| (least.min(v), most.max(v)))
}

/// Checks that the number of `samples` is large enough for a curve.
pub fn enough(samples: usize) -> Result<()> {
    if samples >= FEWEST {
        return Ok(());
    }
    let reason = format!("{samples} samples are too few for a curve; give {FEWEST} or more");
    Err(Error::Option { option: "--response-model", reason })
}

/// Checks that samples determine a curve.
pub fn check(samples: &[Sample]) -> Fitted<()> {
    if samples.len() < FEWEST {
        return Err(format!(
            "only {} places can be used, but at least {FEWEST} are needed; usable places are in smooth areas, and at \
             least two frames show them neither clipped nor black",
            samples.len()
        ));
    }
    let (times, codes) = (span(samples, |v| v.ln_time), span(samples, |v| v.code));
    if times.1 - times.0 < STEP * LN_2 {
        return Err(format!(
            "all usable places are in frames whose exposures differ by only {:.2} stops; at least {STEP} stops are needed",
            stops(times.1 - times.0)
        ));
    }
    if codes.1 - codes.0 < SPAN {
        return Err(format!(
            "the usable places have only pixel values from {:.0} to {:.0}; a range of at least {SPAN} is needed, in \
             smooth areas",
            codes.0, codes.1
        ));
    }
    Ok(())
}

/// Checks that the curve is plausible for a camera.
fn check_plausible(g: &[f64; CODES], fit: &Fit) -> Fitted<()> {
    let contrast = stops(g[240] - g[16]);
    let (codes, rise) = FLAT;
    let flat = (16..=240 - codes).find(|&z| stops(g[z + codes] - g[z]) < rise);
    if let Some(z) = flat {
        Err(format!("the recovered response does not rise from pixel value {z} to {}", z + codes))
    } else if !(CONTRAST.0..=CONTRAST.1).contains(&contrast) {
        Err(format!(
            "the recovered curve spans {contrast:.1} stops from pixel value 16 to 240; a camera's spans {} to {}",
            CONTRAST.0, CONTRAST.1
        ))
    } else if fit.residual_stops.is_nan() || fit.residual_stops > RESIDUAL {
        Err(format!(
            "the pixel values of the frames do not fit their exposures: they deviate by {:.2} stops",
            fit.residual_stops
        ))
    } else {
        Ok(())
    }
}

/// Checks that equations with this condition have a solution that is not noise.
pub fn determined(condition: f64) -> Fitted<()> {
    if condition.is_nan() || condition > CONDITION { Err(undetermined(condition)) } else { Ok(()) }
}

/// Returns the reason why there is no solution.
pub fn undetermined(condition: f64) -> String {
    format!("the frames do not determine the curve (condition number {condition:.0e})")
}

/// Returns the two neighbours of a code between integers, with their weights.
pub fn between(code: f64) -> [(usize, f64); 2] {
    let below = (code.max(0.0) as usize).min(CODES - 2);
    let f = code - below as f64;
    [(below, 1.0 - f), (below + 1, f)]
}

/// Returns the interpolated value of a table at a code between integers.
pub fn at(table: &[f64], code: f64) -> f64 {
    between(code).iter().map(|&(z, f)| f * table[z]).sum()
}

/// Returns w^2 of a view.
pub fn square(view: &View) -> f64 {
    let w = hat(view.code);
    w * w
}

/// Returns w^2 and g - ln dt for each view.
fn weighted<'a>(sample: &'a Sample, g: &'a [f64]) -> impl Iterator<Item = (f64, f64)> + Clone + 'a {
    sample.views.iter().map(move |view| (square(view), at(g, view.code) - view.ln_time))
}

/// Returns sum w^2 and sum w^2 (g - ln E - ln dt)^2 of a sample, with the best ln E for g.
fn misfit(sample: &Sample, g: &[f64]) -> (f64, f64) {
    let views = weighted(sample, g);
    let weight: f64 = views.clone().map(|(w2, _)| w2).sum();
    let ln_e = views.clone().map(|(w2, v)| w2 * v).sum::<f64>() / weight;
    (weight, views.map(|(w2, v)| w2 * (v - ln_e) * (v - ln_e)).sum())
}

/// Returns the weighted root mean square of g - ln E - ln dt over all views.
pub fn residual(samples: &[Sample], trust: &[f64], g: &[f64]) -> f64 {
    let sums = samples.iter().zip(trust).map(|(sample, t)| (misfit(sample, g), t));
    let (weight, square) = sums.fold((0.0, 0.0), |(a, b), ((w, s), t)| (a + t * w, b + t * s));
    (square / weight).sqrt()
}

/// Returns the weight of each sample from its weighted misfit, by [`tukey`].
pub fn biweight(samples: &[Sample], g: &[f64]) -> Vec<f64> {
    let misfits: Vec<f64> = samples.iter().map(|s| (misfit(s, g).1 / s.views.len() as f64).sqrt()).collect();
    tukey(&misfits)
}

/// Returns Tukey's biweight of each misfit (0 or more), with a reach of 4.685 robust standard deviations. The biweight
/// is 1 for a misfit of 0, and 0 beyond the reach.
pub fn tukey(misfits: &[f64]) -> Vec<f64> {
    let median = median(misfits.iter().copied()).unwrap_or(0.0);
    let reach = 4.685 * median / MEDIAN_DEVIATION + f64::MIN_POSITIVE;
    misfits.iter().map(|&m| statistics::biweight(m / reach)).collect()
}

/// Synthetic cameras for the tests of all models.
#[cfg(test)]
pub mod scene {
    use super::*;

    /// Returns a number in -0.5..0.5 that depends only on the seed.
    pub fn noise(seed: usize) -> f64 {
        let x = (seed as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let x = (x ^ (x >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((x ^ (x >> 29)) >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    /// Simulates `count` places whose brightness is evenly spread in stops. A camera photographs these places with the
    /// given exposures, in stops. The response of the camera is the function `code` of the exposure 0..=1. Returns the
    /// places that at least two exposures show neither clipped nor black.
    pub fn scene(count: usize, exposures: &[f64], code: impl Fn(f64) -> f64) -> Vec<Sample> {
        let place = |i: usize| {
            let ln_e = (9.0 * i as f64 / count as f64 - 7.0) * LN_2;
            let views = exposures.iter().enumerate().filter_map(|(j, stops)| {
                let z = 255.0 * code(libm::exp(ln_e + stops * LN_2).min(1.0)) + 1.5 * noise(31 * i + j);
                (2.0..=253.0).contains(&z).then_some(View { code: z, ln_time: stops * LN_2 })
            });
            Sample { views: views.collect() }
        };
        (0..count).map(place).filter(|s| s.views.len() >= 2).collect()
    }

    /// Shifts `g` by the constant that brings it closest to the logarithm of `exposure`. Returns the root mean square
    /// of the remaining difference over codes 10..=245, in stops.
    pub fn difference(g: &[f64; CODES], exposure: impl Fn(f64) -> f64) -> f64 {
        difference_from(10, g, exposure)
    }

    /// Same as [`difference`], but over codes `from`..=245, because `g` is not determined below `from`.
    pub fn difference_from(from: usize, g: &[f64; CODES], exposure: impl Fn(f64) -> f64) -> f64 {
        let d: Vec<f64> = (from..=245).map(|z| stops(g[z] - libm::log(exposure(z as f64 / 255.0)))).collect();
        let mean = d.iter().sum::<f64>() / d.len() as f64;
        (d.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / d.len() as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::scene::scene;
    use super::*;

    fn found(g: impl Fn(usize) -> f64, count: usize) -> Found {
        Found { g: std::array::from_fn(g), trust: vec![1.0; count], condition: Some(1.0), degree: None }
    }

    #[test]
    fn true_curve_has_the_residual_of_noise_and_motion_has_no_weight() {
        let mut samples = scene(400, &[-2.0, 0.0, 2.0], |x| x.sqrt());
        let g: Vec<f64> = (0..CODES).map(|z| 2.0 * libm::log((z as f64).max(0.1) / 255.0)).collect();
        samples[100].views[1].code += 30.0;
        let trust = biweight(&samples, &g);
        assert!(trust[100] < 0.5, "{}", trust[100]);
        let kept = trust.iter().filter(|&&t| t > 0.5).count();
        assert!(kept > 300, "{kept}");
        // The residual should be about 0.007: noise of 0.43 codes is 2 x 0.43 / z nepers of g = 2 ln z, and the middle
        // codes have the largest weights. The curvature of g between codes adds less, 1 / z^2.
        assert!((0.001..0.03).contains(&residual(&samples, &trust, &g)));
    }

    #[test]
    fn a_misfit_far_beyond_the_others_has_no_trust() {
        // The median, 1, is 0.6745 standard deviations of normal misfits, so 4.685 standard deviations are 6.95.
        let trust = tukey(&[0.0, 1.0, 1.0, 1.0, 6.9, 7.0]);
        assert!(
            trust[0] == 1.0 && trust[1] > 0.95 && trust[4] > 0.0 && trust[4] < 1e-3 && trust[5] == 0.0,
            "{trust:?}"
        );
        assert_eq!((tukey(&[0.0; 3]), tukey(&[])), (vec![1.0; 3], Vec::new()));
    }

    #[test]
    fn no_curve_that_is_not_finite_or_no_cameras_passes() {
        let samples = scene(400, &[-2.0, 0.0, 2.0], |x| x.sqrt());
        let n = samples.len();
        assert!(finish(&samples, found(|_| f64::NAN, n)).unwrap_err().contains("invalid values"));
        assert!(finish(&samples, found(|z| 0.2 * z as f64, n)).unwrap_err().contains("stops from pixel value 16"));
        // The curve falls from code 110 to 200, as it does if samples contradict each other.
        let falls =
            found(|z| 2.0 * libm::log(if (110..=200).contains(&z) { 220.0 - z as f64 } else { z as f64 }.max(0.1)), n);
        assert!(finish(&samples, falls).unwrap_err().contains("does not rise"));
        let (g, fit) = finish(&samples, found(|z| 2.0 * libm::log((z as f64).max(0.1)), n)).unwrap();
        assert!(g[MID] == 0.0 && g.windows(2).all(|w| w[0] < w[1]) && !fit.borrowed);
    }
}
