//! Transfer curves of colour profiles: pixel value to linear light.
//!
//! In: a profile, or none. Out: the linear value of a pixel value of each channel. Cost: at most one power per value.
//! Source: ICC.1:2022, 10.6 (`curv`) and 10.18 (`para`); IEC 61966-2-1 (sRGB) where there is no profile, or the profile
//! uses tables.

use super::{Profile, srgb_to_linear};
use libm::pow;
use moxcms::{ColorProfile, ToneReprCurve};

/// Transfer curves of red, green and blue; `None` for sRGB's.
#[derive(Debug, Clone)]
pub struct Transfer(Option<[ToneReprCurve; 3]>);

/// Curves whose values differ by less than this, as a fraction of white, count as equal, because profiles round their
/// curves.
const ROUNDING: f64 = 1e-3;

impl Transfer {
    /// Returns the curves of `profile`; sRGB's where there is no profile, or one that uses tables.
    pub fn of(profile: Option<&Profile>) -> Transfer {
        let curves = |profile: &Profile| {
            profile.primaries?;
            let parsed = ColorProfile::new_from_slice(&profile.icc).ok()?;
            Some([parsed.red_trc?, parsed.green_trc?, parsed.blue_trc?])
        };
        Transfer(profile.and_then(curves))
    }

    /// Decodes the pixel value `x` of channel 0, 1 or 2 to linear light, both 0..=1.
    pub fn light(&self, channel: usize, x: f64) -> f64 {
        match &self.0 {
            None => srgb_to_linear(x),
            Some(curves) => evaluate(&curves[channel], x),
        }
    }

    /// Whether both curves decode every 8-bit value to the same light, within the rounding of profiles.
    pub fn is_close(&self, other: &Transfer) -> bool {
        let codes = || (0..=255).map(|code| f64::from(code) / 255.0);
        (0..3).all(|c| codes().all(|x| (self.light(c, x) - other.light(c, x)).abs() < ROUNDING))
    }

    /// Whether the curves are close to sRGB's.
    pub fn is_srgb(&self) -> bool {
        self.is_close(&Transfer(None))
    }
}

/// A transfer curve from which [`Profile::of`] makes a profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Curve {
    /// The sRGB curve (IEC 61966-2-1).
    Srgb,
    /// The inverse of the camera curve that BT.601, BT.709 and BT.2020 of ITU-R share.
    Bt709,
    /// Linear light is the pixel value raised to this power.
    Power(f64),
}

impl Curve {
    pub(super) fn parametric(self) -> ToneReprCurve {
        let numbers = match self {
            Curve::Srgb => vec![2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045],
            Curve::Bt709 => vec![1.0 / 0.45, 1.0 / 1.099, 0.099 / 1.099, 1.0 / 4.5, 0.081],
            Curve::Power(power) => vec![power as f32],
        };
        ToneReprCurve::Parametric(numbers)
    }
}

/// Evaluates the curve at `x`, both 0..=1.
fn evaluate(curve: &ToneReprCurve, x: f64) -> f64 {
    let light = match curve {
        ToneReprCurve::Lut(lines) => match lines.as_slice() {
            [] => x,
            [gamma] => pow(x, f64::from(*gamma) / 256.0),
            lines => {
                let at = x * (lines.len() - 1) as f64;
                let line = (at as usize).min(lines.len() - 2);
                let (low, high) = (f64::from(lines[line]), f64::from(lines[line + 1]));
                (low + (high - low) * (at - line as f64)) / 65535.0
            }
        },
        ToneReprCurve::Parametric(numbers) => {
            let numbers: Vec<f64> = numbers.iter().map(|v| f64::from(*v)).collect();
            // g, a, b, c, d, e, f are the names of the parameters in ICC.1:2022, table 68.
            let (g, a, b, c, d, e, f) = match numbers[..] {
                [g] => (g, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
                [g, a, b] => (g, a, b, 0.0, -b / a, 0.0, 0.0),
                [g, a, b, c] => (g, a, b, 0.0, -b / a, c, c),
                [g, a, b, c, d] => (g, a, b, c, d, 0.0, 0.0),
                [g, a, b, c, d, e, f] => (g, a, b, c, d, e, f),
                _ => (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            };
            if x >= d { pow((a * x + b).max(0.0), g) + e } else { c * x + f }
        }
    };
    light.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_the_standards() {
        let srgb = Curve::Srgb.parametric();
        for i in 0..=100 {
            let x = f64::from(i) / 100.0;
            // The parameters of the curve are `f32`, with relative rounding errors of up to 6e-8.
            assert!((evaluate(&srgb, x) - srgb_to_linear(x)).abs() < 1e-6);
        }
        assert!((evaluate(&ToneReprCurve::Parametric(vec![2.0]), 0.5) - 0.25).abs() < 1e-12);
        assert!((evaluate(&ToneReprCurve::Lut(vec![512]), 0.5) - 0.25).abs() < 1e-12);
        assert!((evaluate(&ToneReprCurve::Lut(vec![0, 13107, 65535]), 0.75) - 0.6).abs() < 1e-12);
        assert_eq!(evaluate(&ToneReprCurve::Lut(vec![0, 65535]), 1.0), 1.0);
        assert_eq!(evaluate(&ToneReprCurve::Lut(vec![]), 0.3), 0.3);
    }
}
