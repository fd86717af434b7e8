//! Response: from code values to the exposure that caused them.
//!
//! In: a bracket, its alignment and a [`ResponseModel`]. Out: a [`ResponseCurve`], g(Z) = ln(E dt) for each channel
//! and code, and a [`ResponseReport`] on its accuracy. Cost: about 0.05 s for any size. Source: the letters g, Z, E,
//! dt and w are those of Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs",
//! section 2.1.
//!
//! A recovered curve is neutralised, because the camera has already applied its white balance, so grey codes must stay
//! grey. The three channels keep their shape, but are shifted, so that the mean of g over all codes, weighted by w, is
//! the same in all channels.

pub mod debevec;
pub mod file;
pub(crate) mod fit;
#[doc(hidden)]
pub mod local;
pub mod mitsunaga_nayar;
pub mod ratios;
pub mod robertson;
#[doc(hidden)]
pub mod samples;

use crate::align::Alignment;
use crate::bracket::Bracket;
use crate::bracket::colour::srgb_to_linear;
use crate::error::{Result, Warning};
use fit::Fitted;
use mitsunaga_nayar::Ratio;
use rayon::prelude::*;
use samples::{Places, Sample};
use serde::Serialize;
use std::f64::consts::LN_2;

/// Number of code values of a curve: 0..=255, for frames of any depth.
pub const CODES: usize = 256;

/// The code whose exposure is 1, so that g is 0 there.
pub const MID: usize = 128;

/// Exposure of code 0 divided by the exposure of code 1. Rounding gives code 0 to all exposures below half of the
/// exposure of code 1, and the mean of these exposures is a quarter of the exposure of code 1. No sample determines the
/// exposure of code 0. A smaller ratio would turn values that are only rounded down into dark specks.
const BLACK: f64 = 1.0 / 4.0;

/// The curves of the three channels are made parallel below the first and above the second of these codes.
const ENDS: (usize, usize) = (12, 243);

/// Debevec & Malik's hat w (1997, equation 4) scaled to 0..=1: 0 at codes 0 and 255, 1 halfway between.
pub fn hat(code: f64) -> f64 {
    (code.min(255.0 - code) / 127.5).max(0.0)
}

/// g(Z) = ln(E dt), the logarithm of the exposure that gives code Z, for R, G and B at codes 0..=255. All values are
/// finite, and strictly increasing with the code.
///
/// Exposure is relative: the mean of g over the three channels is 0 at code [`MID`]. Between codes the exposure
/// exp(g) is interpolated linearly.
#[derive(Debug, Clone, PartialEq)]
pub struct ResponseCurve {
    ln_exposure: [[f64; CODES]; 3],
    exposure: [[f32; CODES]; 3],
    black: [f64; 3],
}

impl ResponseCurve {
    /// Returns the curve with these logarithms of exposure, or `None` if a value is not between -80 and 80, where
    /// exposures fit into an `f32`, or if the values do not increase.
    pub fn new(ln_exposure: [[f64; CODES]; 3]) -> Option<Self> {
        let sound = |g: &[f64; CODES]| g.iter().all(|v| v.abs() < 80.0) && g.windows(2).all(|w| w[0] < w[1]);
        ln_exposure.iter().all(sound).then(|| ResponseCurve {
            exposure: ln_exposure.map(|g| g.map(|v| libm::exp(v) as f32)),
            ln_exposure,
            black: [0.0; 3],
        })
    }

    /// Returns the same curve for a camera that is black up to these codes of R, G and B, or `None` if a code is not in
    /// 0..128.
    pub fn with_black(self, black: [f64; 3]) -> Option<Self> {
        let sound = black.iter().all(|code| (0.0..128.0).contains(code));
        sound.then_some(ResponseCurve { black, ..self })
    }

    /// Returns the code of channel 0, 1 or 2 up to which a frame is black, including film base and noise.
    pub fn black(&self, channel: usize) -> f64 {
        self.black[channel]
    }

    /// Returns the curve with exposure proportional to the code.
    pub fn linear() -> Self {
        Self::stated(|v| v)
    }

    /// Returns the sRGB transfer function (IEC 61966-2-1), which is assumed if the response is not known.
    pub fn srgb() -> Self {
        Self::stated(srgb_to_linear)
    }

    /// Returns a curve that is the same for all channels. `exposure` is the exposure of a code on the scale 0..=1; it
    /// must be positive above 0 and increase.
    fn stated(exposure: impl Fn(f64) -> f64) -> Self {
        let at = |code: usize| match code {
            0 => BLACK * exposure(1.0 / 255.0),
            _ => exposure(code as f64 / 255.0),
        };
        let ln_mid = libm::log(at(MID));
        let g = std::array::from_fn(|code| libm::log(at(code)) - ln_mid);
        ResponseCurve { ln_exposure: [g; 3], exposure: [g.map(|v| libm::exp(v) as f32); 3], black: [0.0; 3] }
    }

    /// Returns g of channel 0, 1 or 2 (R, G, B) at codes 0..=255.
    pub fn ln_exposure(&self, channel: usize) -> &[f64; CODES] {
        &self.ln_exposure[channel]
    }

    /// Returns exp(g) of channel 0, 1 or 2 at codes 0..=255.
    pub fn exposures(&self, channel: usize) -> &[f32; CODES] {
        &self.exposure[channel]
    }

    /// Returns the exposure of a code in a channel. The code may be between two integers, and is clamped to 0..=255.
    pub fn exposure(&self, channel: usize, code: f32) -> f32 {
        let code = code.clamp(0.0, 255.0);
        let below = (code as usize).min(CODES - 2);
        let (a, b) = (self.exposure[channel][below], self.exposure[channel][below + 1]);
        a + (code - below as f32) * (b - a)
    }

    /// Returns the code of an `exposure` in a channel, interpolated between integer codes: the inverse of
    /// [`exposure`](Self::exposure).
    pub fn code(&self, channel: usize, exposure: f32) -> f32 {
        let x = &self.exposure[channel];
        let above = x.partition_point(|&v| v < exposure).clamp(1, CODES - 1);
        let (a, b) = (x[above - 1], x[above]);
        let part = if b > a { ((exposure - a) / (b - a)).clamp(0.0, 1.0) } else { 1.0 };
        (above - 1) as f32 + part
    }

    /// Shifts each channel of `g` so that the mean over all codes, weighted by [`hat`], is the same in all channels.
    /// Then shifts all three channels by one amount, so that their mean at code [`MID`] is 0.
    fn neutralised(mut g: [[f64; CODES]; 3]) -> [[f64; CODES]; 3] {
        let weight: f64 = (0..CODES).map(|z| hat(z as f64)).sum();
        for channel in &mut g {
            let mean = (0..CODES).map(|z| hat(z as f64) * channel[z]).sum::<f64>() / weight;
            channel.iter_mut().for_each(|v| *v -= mean);
        }
        let mid = g.iter().map(|channel| channel[MID]).sum::<f64>() / 3.0;
        g.map(|channel| channel.map(|v| v - mid))
    }
}

/// Method used to recover the camera response. If a bracket does not determine it, the sRGB curve is used.
#[derive(Debug, Clone, PartialEq)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum ResponseModel {
    /// Recovered from the bracket: Debevec & Malik 1997.
    Debevec(debevec::Options),
    /// Recovered from the bracket: Robertson, Borman & Stevenson 2003.
    Robertson(robertson::Options),
    /// Recovered from the bracket, as a polynomial: Mitsunaga & Nayar 1999.
    MitsunagaNayar(mitsunaga_nayar::Options),
    /// No recovery: pixel values are proportional to the light, as in linear TIFFs.
    Linear,
    /// No recovery: the standard sRGB curve.
    Srgb,
}

impl ResponseModel {
    /// Returns the name used on the command line and in reports.
    pub fn name(&self) -> &'static str {
        self.into()
    }

    /// Whether the response is recovered from the bracket.
    pub fn is_recovered(&self) -> bool {
        !matches!(self, ResponseModel::Linear | ResponseModel::Srgb)
    }
}

impl Default for ResponseModel {
    fn default() -> Self {
        ResponseModel::Debevec(debevec::Options::default())
    }
}

/// How the response was determined, and how accurate it is.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ResponseReport {
    /// Curve that was used: `debevec`, `robertson`, `mitsunaga-nayar`, `linear`, `srgb`, `file`.
    pub model: &'static str,
    /// The fit of each channel, if the curve was recovered from the bracket.
    pub channels: Option<[Fit; 3]>,
    /// Exposure ratios that fit the curve better, if the model estimates them. The merge uses the given exposures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_ratios: Option<Vec<RatioReport>>,
    /// Why the requested curve was not used.
    pub fallback: Option<String>,
}

/// The ratio of two consecutive exposures. Consecutive means: some place of the scene is unclipped in both, and in no
/// exposure between them.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RatioReport {
    /// The shorter and the longer exposure, both divided by the exposure of the reference, in stops.
    pub between_stops: (f64, f64),
    /// Ratio of the longer to the shorter exposure, as given, in stops.
    pub given_stops: f64,
    /// Ratio of the longer to the shorter exposure, as estimated from the pixels, in stops.
    pub found_stops: f64,
}

/// Estimated error of the curve of one channel.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Fit {
    /// Number of places of the scene that were used.
    pub samples: usize,
    /// Number of places with less than half of their weight, because they contradict the others.
    pub outliers: usize,
    /// Weighted root mean square of g(Z) - ln E - ln dt, in stops.
    pub residual_stops: f64,
    /// Smallest and largest code of the samples.
    pub codes: (f64, f64),
    /// Ratio of the largest to the smallest singular value of the system of equations; null for Robertson, which
    /// solves no system, and for a curve borrowed from the other channels.
    pub condition: Option<f64>,
    /// Degree of the polynomial, if the model is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degree: Option<usize>,
    /// True if the response of the channel could not be recovered. The mean response of the recovered channels is then
    /// used for this channel, and the numbers above are 0.
    pub borrowed: bool,
}

/// Recovers the response of the camera that took `bracket`, by `model`.
///
/// # Errors
/// [`Error::Option`](crate::error::Error::Option) if the value of an option cannot be used. A bracket that does not
/// determine its response is no error: the result is the sRGB curve, with [`Warning::ResponseFallback`].
pub fn recover(
    bracket: &Bracket,
    alignment: &Alignment,
    model: &ResponseModel,
) -> Result<(ResponseCurve, ResponseReport, Vec<Warning>)> {
    recover_from(&[&Places::of(bracket, alignment)?], model)
}

/// A saved curve contradicts the frames if sqrt(a^2 - b^2) is above this, in stops. Here a is the residual of the
/// saved curve, and b the residual of a curve recovered from the frames. The root was 0.03 to 0.08 for curves of the
/// same camera from other scenes (14 pairs; Canon 550D and 5D, Samsung A52s), and 0.2 to 0.5 for a linear curve.
const CONTRADICTED: f64 = 0.1;

/// Returns the root mean square residuals, in stops, of `curve` and of a curve recovered from the frames, if `curve`
/// contradicts the frames. It does if the square of its residual exceeds the square of the other residual by more than
/// the square of `CONTRADICTED`; squares are compared because independent errors add in squares. Returns `None` if
/// `curve` fits about as well, or if no curve can be recovered from the frames.
///
/// # Errors
/// As [`recover`].
pub fn contradiction(curve: &ResponseCurve, places: &Places) -> Result<Option<(f64, f64)>> {
    let (_, report, _) = recover_from(&[places], &ResponseModel::default())?;
    let Some(fits) = report.channels else { return Ok(None) };
    let all = |each: [f64; 3]| (each.iter().map(|v| v * v).sum::<f64>() / 3.0).sqrt();
    let own = all(fits.map(|fit| fit.residual_stops));
    let samples = samples::draw(&[places], fits[0].samples).channels;
    let found = all(std::array::from_fn(|c| {
        let g = curve.ln_exposure(c);
        stops(fit::residual(&samples[c], &fit::biweight(&samples[c], g), g))
    }));
    Ok((found * found > own * own + CONTRADICTED * CONTRADICTED).then_some((found, own)))
}

/// Recovers the response of the camera that took several brackets, by `model`. The samples of all `places` are
/// pooled; the exposures of each bracket are relative to its own reference frame.
///
/// # Errors
/// As [`recover`].
pub fn recover_from(
    places: &[&Places],
    model: &ResponseModel,
) -> Result<(ResponseCurve, ResponseReport, Vec<Warning>)> {
    let name = model.name();
    let stated = |curve| {
        let report = ResponseReport { model: name, ..ResponseReport::default() };
        (curve, report, Vec::new())
    };
    let count = match model {
        ResponseModel::Linear => return Ok(stated(ResponseCurve::linear())),
        ResponseModel::Srgb => return Ok(stated(ResponseCurve::srgb())),
        ResponseModel::Debevec(options) => options.validate().map(|()| options.samples)?,
        ResponseModel::Robertson(options) => options.validate().map(|()| options.samples)?,
        ResponseModel::MitsunagaNayar(options) => options.validate().map(|()| options.samples)?,
    };
    let drawn = samples::draw(places, count);
    let channels: Vec<Fitted<Channel>> = drawn.channels.par_iter().map(|samples| channel(samples, model)).collect();
    Ok(match together(&channels, drawn.black) {
        Ok((curve, fits)) => {
            let ratios: Vec<&Ratio> = channels.iter().flatten().flat_map(|channel| &channel.ratios).collect();
            let exposure_ratios = (!ratios.is_empty()).then(|| pooled(&ratios));
            let report = ResponseReport { model: name, channels: Some(fits), exposure_ratios, fallback: None };
            let failed = channels.into_iter().zip(["red", "green", "blue"]);
            let warnings = failed.filter_map(|(fitted, channel)| {
                fitted.err().map(|reason| Warning::ResponseBorrowed { channel, reason })
            });
            (curve, report, warnings.collect())
        }
        Err(reason) => {
            let report = ResponseReport { model: "srgb", fallback: Some(reason.clone()), ..ResponseReport::default() };
            let used = "the sRGB curve".to_owned();
            (ResponseCurve::srgb(), report, vec![Warning::ResponseFallback { reason, used }])
        }
    })
}

/// The curve of one channel, with g(128) = 0 and rising everywhere.
struct Channel {
    g: [f64; CODES],
    fit: Fit,
    ratios: Vec<Ratio>,
}

/// Recovers the curve of one channel by `model`.
fn channel(samples: &[Sample], model: &ResponseModel) -> Fitted<Channel> {
    let (found, ratios) = match model {
        ResponseModel::Robertson(options) => (robertson::channel(samples, options)?, Vec::new()),
        ResponseModel::MitsunagaNayar(options) => mitsunaga_nayar::channel(samples, options)?,
        ResponseModel::Debevec(options) => (debevec::channel(samples, options)?, Vec::new()),
        ResponseModel::Linear | ResponseModel::Srgb => return Err("the curve is given, not recovered".to_owned()),
    };
    let (g, fit) = fit::finish(samples, found)?;
    Ok(Channel { g, fit, ratios })
}

/// Combines the curves of the channels. A channel that the scene does not show (a room in yellow light has no blue)
/// gets the mean curve of the recovered channels. Fails if the scene shows no channel.
fn together(channels: &[Fitted<Channel>], black: [f64; 3]) -> Fitted<(ResponseCurve, [Fit; 3])> {
    let known: Vec<&Channel> = channels.iter().flatten().collect();
    if known.is_empty() {
        return Err(channels.iter().find_map(|fitted| fitted.as_ref().err().cloned()).unwrap_or_default());
    }
    let mean = std::array::from_fn(|z| known.iter().map(|channel| channel.g[z]).sum::<f64>() / known.len() as f64);
    let g = std::array::from_fn(|c| channels[c].as_ref().map_or(mean, |channel| channel.g));
    let borrowed = Fit { borrowed: true, ..Fit::default() };
    let fits = std::array::from_fn(|c| channels[c].as_ref().map_or(borrowed, |channel| channel.fit));
    // A borrowed curve is a mean of known ones, and counts as known at all codes.
    let codes = fits.map(|fit: Fit| if fit.borrowed { (0.0, 255.0) } else { fit.codes });
    let curve = ResponseCurve::new(ResponseCurve::neutralised(with_common_ends(g, codes)));
    let curve = curve.and_then(|curve| curve.with_black(black));
    curve.map(|curve| (curve, fits)).ok_or_else(|| "the recovered curve contains infinite or invalid values".to_owned())
}

/// Combines the ratios of the channels, because a frame has one exposure, not three.
fn pooled(ratios: &[&Ratio]) -> Vec<RatioReport> {
    let mut sums: Vec<((f64, f64), f64, f64)> = Vec::new();
    for ratio in ratios {
        let at = sums.iter().position(|(times, ..)| *times == ratio.ln_times);
        let at = at.unwrap_or_else(|| {
            sums.push((ratio.ln_times, 0.0, 0.0));
            sums.len() - 1
        });
        sums[at].1 += ratio.weight;
        sums[at].2 += ratio.weight * ratio.ln_ratio;
    }
    sums.retain(|(_, weight, _)| *weight > 0.0);
    sums.sort_by(|(a, ..), (b, ..)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let report = |((shorter, longer), weight, sum): ((f64, f64), f64, f64)| RatioReport {
        between_stops: (stops(shorter), stops(longer)),
        given_stops: stops(longer - shorter),
        found_stops: stops(sum / weight),
    };
    sums.into_iter().map(report).collect()
}

/// Returns the curves `g` with new slopes where few samples determine the slope: at both ends of the code range and, in
/// each channel, outside the range `codes` of its samples. The new slope at a code is common to all channels: it is the
/// median slope of the channels that have samples there. If the channels differed at the ends, black and white would
/// get a colour.
fn with_common_ends(g: [[f64; CODES]; 3], codes: [(f64, f64); 3]) -> [[f64; CODES]; 3] {
    let step = |z: usize| {
        let saw = |c: usize| codes[c].0 <= z as f64 && (z + 1) as f64 <= codes[c].1;
        let all: Vec<usize> = (0..3).filter(|&c| saw(c)).collect();
        let mut steps: Vec<f64> =
            if all.is_empty() { vec![0, 1, 2] } else { all }.into_iter().map(|c| g[c][z + 1] - g[c][z]).collect();
        steps.sort_by(f64::total_cmp);
        (steps[(steps.len() - 1) / 2] + steps[steps.len() / 2]) / 2.0
    };
    std::array::from_fn(|c| {
        let mut channel = g[c];
        let low = (codes[c].0.ceil() as usize).clamp(ENDS.0, MID);
        let high = (codes[c].1 as usize).clamp(MID, ENDS.1);
        for z in (0..low).rev() {
            channel[z] = channel[z + 1] - step(z);
        }
        for z in high..CODES - 1 {
            channel[z + 1] = channel[z] + step(z);
        }
        channel[0] = channel[0].max(channel[1] + libm::log(BLACK));
        channel
    })
}

/// Converts nepers to stops.
fn stops(ln: f64) -> f64 {
    ln / LN_2
}

#[cfg(test)]
pub(crate) mod tests;
