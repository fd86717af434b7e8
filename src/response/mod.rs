//! Response: from code values to the exposure that caused them.
//!
//! In: a bracket, its alignment and a [`ResponseModel`]. Out: a [`ResponseCurve`], g(Z) = ln(E dt) for each channel and code, and a
//! [`ResponseReport`] of how well it is known. Cost: about 0.1 s, bounded whatever the size of the pictures.
//! Source: the letters g, Z, E, dt and w are those of Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from
//! Photographs", section 2.1.
//!
//! A curve that is recovered is then neutralised: the three channels are shifted against each other, never bent, so that equal codes
//! mean equal exposures in the w-weighted mean over all codes. White balance was the camera's affair; grey stays grey.

mod csv;
pub mod debevec;
pub mod file;
mod monotone;
pub mod ratios;
mod rsp;
pub mod samples;

use crate::align::Alignment;
use crate::bracket::Bracket;
use crate::error::{Result, Warning};
use serde::Serialize;
use std::f64::consts::LN_2;

/// Code values of a curve: 0..=255, whatever the depth of the frames.
pub const CODES: usize = 256;

/// The code whose exposure is 1, so that g is 0 there.
pub const MID: usize = 128;

/// Of the exposure at code 1, what code 0 is taken to mean by the stated curves: rounding leaves it anywhere below a half.
const BLACK: f64 = 1.0 / 16.0;

/// The codes below and above which the channels' curves run in parallel.
const ENDS: (usize, usize) = (12, 243);

/// Debevec & Malik's hat w (1997, equation 4) scaled to 0..=1: 0 at codes 0 and 255, 1 halfway between.
pub fn hat(code: f64) -> f64 {
    (code.min(255.0 - code) / 127.5).max(0.0)
}

/// g(Z) = ln(E dt), the logarithm of the exposure that gives code Z, for R, G and B at codes 0..=255: finite and strictly increasing.
///
/// Exposure is relative: g is 0 at code [`MID`] in the mean of the three channels. Between codes the exposure itself, exp(g), is
/// interpolated linearly.
#[derive(Debug, Clone, PartialEq)]
pub struct ResponseCurve {
    ln_exposure: [[f64; CODES]; 3],
    exposure: [[f32; CODES]; 3],
    black: [f64; 3],
}

impl ResponseCurve {
    /// The curve with these logarithms of exposure; none where a value is not finite, out of what a float holds, or does not increase.
    pub fn new(ln_exposure: [[f64; CODES]; 3]) -> Option<Self> {
        let sound = |g: &[f64; CODES]| g.iter().all(|v| v.abs() < 80.0) && g.windows(2).all(|w| w[0] < w[1]);
        ln_exposure.iter().all(sound).then(|| ResponseCurve {
            exposure: ln_exposure.map(|g| g.map(|v| libm::exp(v) as f32)),
            ln_exposure,
            black: [0.0; 3],
        })
    }

    /// The same curve, of a camera that is black up to these codes of R, G and B; none where one is not in 0..128.
    pub fn with_black(self, black: [f64; 3]) -> Option<Self> {
        let sound = black.iter().all(|code| (0.0..128.0).contains(code));
        sound.then_some(ResponseCurve { black, ..self })
    }

    /// The code of channel 0, 1 or 2 up to which a frame is black, film base and noise included: it says no more than that.
    pub fn black(&self, channel: usize) -> f64 {
        self.black[channel]
    }

    /// Exposure proportional to the code.
    pub fn linear() -> Self {
        Self::stated(|v| v)
    }

    /// Exposure by the sRGB transfer function (IEC 61966-2-1): what a camera's picture is taken for when nothing better is known.
    pub fn srgb() -> Self {
        Self::stated(|v| match v {
            v if v <= 0.04045 => v / 12.92,
            v => libm::pow((v + 0.055) / 1.055, 2.4),
        })
    }

    /// The same curve in all channels: `exposure` of a code on the scale 0..=1, which must be positive and increase above 0.
    fn stated(exposure: impl Fn(f64) -> f64) -> Self {
        let at = |code: usize| match code {
            0 => BLACK * exposure(1.0 / 255.0),
            _ => exposure(code as f64 / 255.0),
        };
        let ln_mid = libm::log(at(MID));
        let g = std::array::from_fn(|code| libm::log(at(code)) - ln_mid);
        ResponseCurve { ln_exposure: [g; 3], exposure: [g.map(|v| libm::exp(v) as f32); 3], black: [0.0; 3] }
    }

    /// g of channel 0, 1 or 2 (R, G, B) at codes 0..=255.
    pub fn ln_exposure(&self, channel: usize) -> &[f64; CODES] {
        &self.ln_exposure[channel]
    }

    /// exp(g) of channel 0, 1 or 2 at codes 0..=255.
    pub fn exposures(&self, channel: usize) -> &[f32; CODES] {
        &self.exposure[channel]
    }

    /// The exposure that a channel's code means; the code may lie between two, and is taken into 0..=255.
    pub fn exposure(&self, channel: usize, code: f32) -> f32 {
        let code = code.clamp(0.0, 255.0);
        let below = (code as usize).min(CODES - 2);
        let (a, b) = (self.exposure[channel][below], self.exposure[channel][below + 1]);
        a + (code - below as f32) * (b - a)
    }

    /// Shifts the channels against each other until the w-weighted mean over all codes is the same in each, and all three until
    /// their mean at code [`MID`] is 0.
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

/// How the response is had.
#[derive(Debug, Clone, PartialEq)]
pub enum ResponseModel {
    /// From the bracket, after Debevec & Malik 1997; the sRGB curve where the bracket does not tell.
    Debevec(debevec::Options),
    /// Codes are proportional to exposure.
    Linear,
    /// The sRGB transfer function.
    Srgb,
}

impl Default for ResponseModel {
    fn default() -> Self {
        ResponseModel::Debevec(debevec::Options::default())
    }
}

/// How the response was had, and how well it is known.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ResponseReport {
    /// The curve that is used: `debevec`, `linear`, `srgb`.
    pub model: &'static str,
    /// What was found of each channel, where the curve was sought in the bracket.
    pub channels: Option<[Fit; 3]>,
    /// Why the curve asked for was not used.
    pub fallback: Option<String>,
}

/// How well one channel's curve is known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Fit {
    /// Places of the scene that were used.
    pub samples: usize,
    /// Of these, those that were given less than half their weight, since they contradict the others.
    pub outliers: usize,
    /// Root mean square of g(Z) - ln E - ln dt, weighted as it was fitted, in stops.
    pub residual_stops: f64,
    /// The least and the greatest code that a sample has.
    pub codes: (f64, f64),
    /// Ratio of the largest to the least singular value of the system of equations.
    pub condition: f64,
}

/// The response of the camera that took `bracket`, by `model`.
///
/// # Errors
/// [`Error::Option`](crate::error::Error::Option) where an option has no usable value. A bracket that does not tell its response is no error: the sRGB curve is
/// given, with [`Warning::ResponseFallback`].
pub fn recover(
    bracket: &Bracket,
    alignment: &Alignment,
    model: &ResponseModel,
) -> Result<(ResponseCurve, ResponseReport, Vec<Warning>)> {
    recover_from(&[(bracket, alignment)], model)
}

/// The response of the camera that took all of `brackets`, by `model`: their samples are pooled, each bracket's exposures
/// relative to its own reference.
///
/// # Errors
/// As [`recover`].
pub fn recover_from(
    brackets: &[(&Bracket, &Alignment)],
    model: &ResponseModel,
) -> Result<(ResponseCurve, ResponseReport, Vec<Warning>)> {
    let stated = |curve, model| {
        let report = ResponseReport { model, ..ResponseReport::default() };
        (curve, report, Vec::new())
    };
    let options = match model {
        ResponseModel::Linear => return Ok(stated(ResponseCurve::linear(), "linear")),
        ResponseModel::Srgb => return Ok(stated(ResponseCurve::srgb(), "srgb")),
        ResponseModel::Debevec(options) => options,
    };
    options.validate()?;
    let drawn = samples::draw(brackets, options.samples);
    let fitted = debevec::recover(&drawn.channels, options);
    let curve = fitted.as_ref().ok().and_then(|(g, _)| {
        let g = ResponseCurve::neutralised(with_common_ends(*g));
        ResponseCurve::new(g)?.with_black(drawn.black)
    });
    Ok(match (fitted, curve) {
        (Ok((_, fits)), Some(curve)) => {
            let report = ResponseReport { model: "debevec", channels: Some(fits), fallback: None };
            (curve, report, Vec::new())
        }
        (fitted, _) => {
            let reason = fitted.err().unwrap_or_else(|| "the curve found is not finite".to_owned());
            let report = ResponseReport { model: "srgb", channels: None, fallback: Some(reason.clone()) };
            let used = "the sRGB curve".to_owned();
            (ResponseCurve::srgb(), report, vec![Warning::ResponseFallback { reason, used }])
        }
    })
}

/// The curves with the same steps in all channels at both ends, the median ones: few samples are there, and where channels part, what is
/// black or white in the scene takes a colour.
fn with_common_ends(g: [[f64; CODES]; 3]) -> [[f64; CODES]; 3] {
    let step = |z: usize| {
        let mut steps = g.map(|channel| channel[z + 1] - channel[z]);
        steps.sort_by(f64::total_cmp);
        steps[1]
    };
    g.map(|mut channel| {
        for z in (0..ENDS.0).rev() {
            channel[z] = channel[z + 1] - step(z);
        }
        for z in ENDS.1..CODES - 1 {
            channel[z + 1] = channel[z] + step(z);
        }
        channel
    })
}

/// A number of nepers in stops.
fn stops(ln: f64) -> f64 {
    ln / LN_2
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::bracket::exposure::Exposure;
    use crate::bracket::{Frame, ReferenceChoice, Samples};

    /// A still bracket with exposures `times`: `radiance` of a pixel's column and row, seen through the sRGB curve.
    pub(crate) fn still(
        (width, height): (usize, usize),
        times: &[f64],
        radiance: impl Fn(usize, usize) -> [f64; 3],
    ) -> (Bracket, Alignment) {
        let encode = |x: f64| match x.clamp(0.0, 1.0) {
            x if x <= 0.0031308 => 12.92 * x,
            x => 1.055 * libm::pow(x, 1.0 / 2.4) - 0.055,
        };
        let frame = |&time: &f64| {
            let pixels = (0..width * height).flat_map(|i| radiance(i % width, i / width));
            let codes = pixels.map(|e| (255.0 * encode(e * time) + 0.5) as u8).collect();
            Frame::new(
                format!("{time}.png").into(),
                width,
                height,
                Samples::Eight(codes),
                Exposure::given(libm::log2(time)).unwrap(),
            )
        };
        let bracket =
            Bracket::new(times.iter().map(frame).collect(), &ReferenceChoice::Number(1 + times.len() / 2)).unwrap();
        let alignment = Alignment::unmoved(&bracket);
        (bracket, alignment)
    }

    /// Tiles of 20 pixels, over ten stops.
    fn tiles(x: usize, y: usize) -> [f64; 3] {
        let e = libm::exp2(((x / 20) * 7 + (y / 20) * 13) as f64 % 101.0 / 10.0 - 8.0);
        [e, 1.1 * e, 0.8 * e]
    }

    #[test]
    fn a_bracket_tells_its_curve_and_grey_stays_grey() {
        let (bracket, alignment) = still((400, 300), &[0.25, 1.0, 4.0], tiles);
        let (curve, report, warnings) = recover(&bracket, &alignment, &ResponseModel::default()).unwrap();
        assert!(warnings.is_empty() && report.channels.is_some(), "{report:?}");
        let (srgb, n) = (ResponseCurve::srgb(), 236.0);
        for c in 0..3 {
            let d = |z: usize| stops(curve.ln_exposure(c)[z] - srgb.ln_exposure(c)[z]);
            // A shift common to the channels is of no matter; 0.05 stops are 3.5 %.
            let mean = (10..=245).map(|z| stops(curve.ln_exposure(1)[z] - srgb.ln_exposure(1)[z])).sum::<f64>() / n;
            let rms = ((10..=245).map(|z| (d(z) - mean) * (d(z) - mean)).sum::<f64>() / n).sqrt();
            assert!(rms < 0.05, "channel {c}: {rms} stops");
        }
        let mean = |c: usize| (0..CODES).map(|z| hat(z as f64) * curve.ln_exposure(c)[z]).sum::<f64>();
        assert!((mean(0) - mean(1)).abs() < 1e-9 && (mean(2) - mean(1)).abs() < 1e-9);
    }

    #[test]
    fn one_curve_on_any_number_of_threads() {
        let (bracket, alignment) = still((400, 300), &[0.25, 1.0, 4.0], tiles);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| recover(&bracket, &alignment, &ResponseModel::default()).unwrap().0)
        };
        assert_eq!(on(1), on(3));
    }

    #[test]
    fn a_bracket_that_tells_nothing_gets_the_stated_curve_and_a_warning() {
        for (times, radiance) in [([1.0, 1.0 + 1e-9], 0.2), ([1.0, 4.0], 9.0), ([1.0, 4.0], 0.0)] {
            let (bracket, alignment) = still((100, 80), &times, |_, _| [radiance; 3]);
            let (curve, report, warnings) = recover(&bracket, &alignment, &ResponseModel::default()).unwrap();
            assert_eq!((curve, report.model), (ResponseCurve::srgb(), "srgb"));
            assert!(matches!(&warnings[..], [Warning::ResponseFallback { .. }]), "{warnings:?}");
        }
    }

    #[test]
    fn stated_curves_are_what_they_state() {
        let srgb = ResponseCurve::srgb();
        // Code 188 of sRGB is 0.5029 of the light of 255 (the standard's formula, by hand).
        assert!((srgb.exposure(0, 188.0) / srgb.exposure(0, 255.0) - 0.5029).abs() < 1e-4);
        let linear = ResponseCurve::linear();
        assert!((linear.exposure(2, 64.5) * 128.0 - 64.5).abs() < 1e-4);
        assert!(ResponseCurve::new([[0.0; CODES]; 3]).is_none());
    }
}
