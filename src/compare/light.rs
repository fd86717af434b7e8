//! What the codes of a picture mean: light, by its colour profile.
//!
//! In: a profile, or none. Out: for each channel the light of every code, 0 to 1, and the primaries. Cost: at most 65,536 powers a channel.
//! Source: ICC.1:2022, 10.6 (`curv`) and 10.18 (`para`); IEC 61966-2-1 where there is no profile, or one that works by tables.

use crate::bracket::Photograph;
use crate::bracket::colour::{Primaries, srgb_to_linear};
use libm::pow;
use moxcms::{ColorProfile, ToneReprCurve};

/// The light of codes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Codes {
    /// Red, green, blue: by code.
    pub curves: [Vec<f32>; 3],
    /// What red, green and blue are.
    pub primaries: Primaries,
}

impl Codes {
    /// Those of a photograph.
    pub fn of(photograph: &Photograph) -> Codes {
        let max = photograph.samples.max();
        let by_profile = photograph.profile.as_ref().and_then(|profile| {
            let parsed = ColorProfile::new_from_slice(&profile.icc).ok()?;
            let curves = [parsed.red_trc?, parsed.green_trc?, parsed.blue_trc?];
            Some(Codes { curves: curves.map(|c| table(max, |x| evaluate(&c, x))), primaries: profile.primaries? })
        });
        by_profile.unwrap_or_else(|| {
            let curve = table(max, srgb_to_linear);
            Codes { curves: [curve.clone(), curve.clone(), curve], primaries: Primaries::SRGB }
        })
    }

    /// Whether codes of both mean the same, but for what profiles round.
    pub fn mean_the_same(&self, other: &Codes) -> bool {
        let step = |codes: &Codes| (codes.curves[0].len() - 1) / 255;
        let close = (0..256).all(|code| {
            (0..3).all(|c| {
                let light = |codes: &Codes| codes.curves[c][code * step(codes)];
                (light(self) - light(other)).abs() < 1e-3
            })
        });
        close && self.primaries.is_close(&other.primaries, 0.005)
    }
}

fn table(max: u16, curve: impl Fn(f64) -> f64) -> Vec<f32> {
    (0..=max).map(|code| curve(f64::from(code) / f64::from(max)) as f32).collect()
}

/// The light of `x`, both 0 to 1.
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
            // g, a, b, c, d, e, f of the standard's table 68.
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
        let srgb = ToneReprCurve::Parametric(vec![2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045]);
        for i in 0..=100 {
            let x = f64::from(i) / 100.0;
            // Its numbers are floats, within 6e-8.
            assert!((evaluate(&srgb, x) - srgb_to_linear(x)).abs() < 1e-6);
        }
        assert!((evaluate(&ToneReprCurve::Parametric(vec![2.0]), 0.5) - 0.25).abs() < 1e-12);
        assert!((evaluate(&ToneReprCurve::Lut(vec![512]), 0.5) - 0.25).abs() < 1e-12);
        assert!((evaluate(&ToneReprCurve::Lut(vec![0, 13107, 65535]), 0.75) - 0.6).abs() < 1e-12);
        assert_eq!(evaluate(&ToneReprCurve::Lut(vec![0, 65535]), 1.0), 1.0);
        assert_eq!(evaluate(&ToneReprCurve::Lut(vec![]), 0.3), 0.3);
        assert_eq!(table(255, |x| x).len(), 256);
    }
}
