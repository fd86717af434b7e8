//! Weighting functions over the code values.
//!
//! In: a response, and for [`Weight::Noise`] the noise of a frame. Out: a table with a weight for each code value of a
//! channel. Cost: negligible. Sources:
//!
//! - The hat is Debevec & Malik 1997, equation 4.
//! - The Gaussian is Robertson, Borman & Stevenson 2003, section III, shifted and scaled so that it is 0 at both ends.
//! - The plateau is from hdrgen by Ward: 1 - (2 z / 255 - 1)^12 for code value z.
//! - The certainty ([`Weight::MannPicard`]) is section 3 of Mann & Picard 1995, "On being undigital with digital
//!   cameras".
//! - Inverse variances as weights ([`Weight::Noise`]) are Gauss' least squares, for cameras as in Granados et al. 2010,
//!   "Optimal HDR reconstruction with linear digital cameras".

use super::noise::Noise;
use crate::response::{CODES, MID, ResponseCurve, hat};

/// Widths of two ranges of code values, one above black and one below white. [`Weight::Noise`] rises from 0 in the
/// first range, and falls to 0 in the second. In both ranges clipping changes the code values, and the variance does
/// not show that.
const FADES: (f64, f64) = (8.0, 40.0);
/// The slope of a response at a code value is computed from the responses this many code values below and above it.
const REACH: usize = 4;

/// Weighting function over the code values, scaled to 0..=255: 0 at both ends, which may be clipped, except for
/// [`Weight::Uniform`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum Weight {
    /// Middle values count most; falls linearly to 0 at black and white.
    #[default]
    Hat,
    /// Middle values count most; a Gaussian with a standard deviation of 45 (of 255).
    Gaussian,
    /// Values count nearly the same; falls to 0 in the lowest and the highest tenth.
    Plateau,
    /// All values count the same, clipped or not.
    Uniform,
    /// A pixel value has a large weight if a small part of a stop changes it much. Mann & Picard 1995.
    MannPicard,
    /// Frames with less noise count more. The weight is 1 / variance. The variance contains the noise (at least one
    /// code value of 8 bits) and an assumed error of response and exposure. The weight falls to 0 near black and white.
    Noise,
}

impl Weight {
    /// Returns the weight, 0..=1, of the code value `code` on the scale 0..=255. `g` is the logarithm of the exposure
    /// of each code value; code values up to `black` are black. For [`Weight::Noise`] the result is only the fading
    /// near black and white. The functions are stretched over the code values above black.
    fn at(self, code: usize, g: &[f64; CODES], black: f64) -> f64 {
        let above = (code as f64 - black).max(0.0);
        let stretched = above * 255.0 / (255.0 - black);
        let off = stretched / 127.5 - 1.0;
        match self {
            Weight::Hat => hat(stretched),
            Weight::Gaussian => {
                let bell = |off: f64| libm::exp(-4.0 * off * off);
                ((bell(off) - bell(1.0)) / (1.0 - bell(1.0))).max(0.0)
            }
            Weight::Plateau => (1.0 - libm::pow(off, 12.0)).max(0.0),
            Weight::Uniform => 1.0,
            Weight::MannPicard if above <= 0.0 || code >= CODES - 1 => 0.0,
            Weight::MannPicard => {
                let least = black.ceil() as usize;
                let steepest = (least + 1..CODES - 1).map(|z| certainty(g, least, z)).fold(f64::MIN_POSITIVE, f64::max);
                certainty(g, least, code) / steepest
            }
            Weight::Noise => (above / FADES.0).min((255.0 - code as f64) / FADES.1).clamp(0.0, 1.0),
        }
    }

    /// Returns the weights of code values 0..=255 of `channel` in a frame with `time` times the exposure of the
    /// reference frame and with `noise`. Up to black they are 0, except for [`Weight::Uniform`].
    ///
    /// Except for [`Weight::Uniform`] and [`Weight::Noise`], weights grow with the square root of the exposure, because
    /// a longer frame has less noise. Weights proportional to the exposure would be right for photon noise only, and
    /// would give small errors of alignment and response in the longest frames too much weight.
    pub(super) fn table(self, curve: &ResponseCurve, channel: usize, time: f64, noise: &Noise) -> [f32; CODES] {
        let (g, black) = (curve.ln_exposure(channel), curve.black(channel));
        std::array::from_fn(|code| {
            let factor = match self {
                Weight::Uniform => 1.0,
                Weight::Noise => within(time * time / noise.variance(curve, channel, code)),
                _ => time.sqrt(),
            };
            (self.at(code, g, black) * factor) as f32
        })
    }

    /// Returns the weight of the middle code value. The extra weight e of the frame in the [equation](super) is
    /// proportional to it.
    pub(super) fn middle_weight(self, curve: &ResponseCurve, time: f64, noise: &Noise) -> f32 {
        match self {
            Weight::Uniform => 1.0,
            Weight::Noise => {
                (0..3).map(|c| within(time * time / noise.variance(curve, c, MID)) as f32).sum::<f32>() / 3.0
            }
            _ => time.sqrt() as f32,
        }
    }
}

/// Clamps `weight` to a range that fits into an `f32`, for responses in any unit.
fn within(weight: f64) -> f64 {
    weight.clamp(1e-30, 1e30)
}

/// Returns the number of code values per neper (factor e) of exposure around `code`: the inverse slope of g between the
/// code values [`REACH`] below and above `code`. Code values below `least` are not used.
fn certainty(g: &[f64; CODES], least: usize, code: usize) -> f64 {
    let (from, to) = (code.saturating_sub(REACH).max(least), (code + REACH).min(CODES - 1));
    (to - from) as f64 / (g[to] - g[from])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(weight: Weight, curve: &ResponseCurve) -> [f32; CODES] {
        weight.table(curve, 0, 1.0, &Noise::least())
    }

    #[test]
    fn weights_are_zero_at_the_ends_and_rise_between() {
        let srgb = ResponseCurve::srgb();
        for weight in [Weight::Hat, Weight::Gaussian, Weight::Plateau, Weight::MannPicard, Weight::Noise] {
            let w = table(weight, &srgb);
            assert_eq!((w[0], w[255]), (0.0, 0.0), "{weight:?}");
            assert!(w[1..255].iter().all(|&w| w > 0.0 && w.is_finite()), "{weight:?}");
        }
        for weight in [Weight::Hat, Weight::Gaussian, Weight::Plateau] {
            let w = table(weight, &srgb);
            assert!((1..128).all(|z| (w[z] - w[255 - z]).abs() < 1e-6 && w[z] >= w[z - 1]), "{weight:?}");
        }
        assert_eq!(table(Weight::Uniform, &srgb), [1.0; CODES]);
        // By hand: 51 / 127.5 = 0.4.
        assert!((table(Weight::Hat, &srgb)[51] - 0.4).abs() < 1e-6);
    }

    #[test]
    fn the_certainty_is_the_slope_of_the_response() {
        // For a linear camera, dZ / d ln X = Z, so the certainty is proportional to the code value.
        let w = table(Weight::MannPicard, &ResponseCurve::linear());
        assert!((w[200] / w[100] - 2.0).abs() < 0.01, "{}", w[200] / w[100]);
        // For a logarithmic camera, the certainty is the same at every code value.
        let g = std::array::from_fn(|z| (z as f64 - 128.0) / 40.0);
        let w = table(Weight::MannPicard, &ResponseCurve::new([g; 3]).unwrap());
        assert!((1..255).all(|z| (w[z] - 1.0).abs() < 1e-6));
    }

    /// The camera is linear above a black of 55: dZ / d ln X = Z - 55.
    #[test]
    fn the_certainty_with_a_black_level_is_the_slope_at_the_code_itself() {
        let g = std::array::from_fn(|z| libm::log((z as f64 - 55.0).max(1e-3 * (z + 1) as f64)));
        let lifted = ResponseCurve::new([g; 3]).unwrap().with_black([55.0; 3]).unwrap();
        let w = table(Weight::MannPicard, &lifted);
        assert_eq!((w[55], w[255]), (0.0, 0.0));
        assert!(w[56] > 0.0 && (w[155] / w[105] - 2.0).abs() < 0.01, "{}", w[155] / w[105]);
    }

    #[test]
    fn black_has_no_weight_and_light_counts() {
        let lifted = ResponseCurve::srgb().with_black([15.0; 3]).unwrap();
        let w = table(Weight::Hat, &lifted);
        assert_eq!((w[0], w[15], w[255]), (0.0, 0.0, 0.0));
        // By hand: 135 is the middle of 15..=255.
        assert!((w[135] - 1.0).abs() < 1e-6 && w[16] > 0.0);
        let of = |weight: Weight, time| weight.table(&lifted, 1, time, &Noise::least())[135];
        assert!((of(Weight::Hat, 4.0) / of(Weight::Hat, 1.0) - 2.0).abs() < 1e-6);
        assert!((of(Weight::Noise, 4.0) / of(Weight::Noise, 1.0) - 16.0).abs() < 1e-4);
        assert_eq!(of(Weight::Uniform, 4.0), 1.0);
    }
}
