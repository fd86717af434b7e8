//! Conversion to the display: linear RGB of any primaries to linear sRGB, and gamut mapping by desaturation at constant
//! hue.
//!
//! In: radiance RGB, or linear RGB relative to display white. Out: converted colours. Cost: some nanoseconds a pixel.
//! Source: IEC 61966-2-1:1999 (sRGB), clause 5.

pub mod codes;
pub(crate) mod oklab;

use crate::bracket::colour::{Conversion, Primaries};

/// Weights of red, green and blue in the luminance of linear sRGB: the second row of its matrix to XYZ.
pub const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Returns the luminance of a linear sRGB colour.
#[inline(always)]
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    LUMINANCE[0] * r + LUMINANCE[1] * g + LUMINANCE[2] * b
}

/// Converts linear RGB of some primaries to linear sRGB.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToSrgb(Option<Conversion>);

impl ToSrgb {
    /// Converts from `primaries`. The conversion is the identity when `primaries` are sRGB's within 0.001, or
    /// degenerate.
    pub fn from(primaries: &Primaries) -> Self {
        if primaries.is_close(&Primaries::SRGB, 1e-3) {
            return ToSrgb(None);
        }
        ToSrgb(Conversion::between(primaries, &Primaries::SRGB))
    }

    /// Converts from `primaries` so that light of the chromaticity `light` becomes white. `light` is the CIE xy of that
    /// light in colours that were adapted from the white of `primaries` to D65.
    pub fn balanced(primaries: &Primaries, light: [f64; 2]) -> Self {
        let known = Conversion::balanced(primaries, &Primaries::SRGB, light);
        // Degenerate primaries are treated as sRGB, as by [`from`](Self::from).
        ToSrgb(known.or_else(|| Conversion::balanced(&Primaries::SRGB, &Primaries::SRGB, light)))
    }

    /// Returns the colour in linear sRGB; colours outside its gamut have components below 0.
    #[inline(always)]
    pub fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        match &self.0 {
            None => rgb,
            Some(conversion) => conversion.apply(rgb),
        }
    }
}

/// Colours are compressed if they are farther than this fraction of the way from grey to the bright edge of the gamut.
const KNEE: f32 = 0.75;

/// Desaturates `rgb`, of luminance `y` relative to display white, until it is in 0..=1. Hue and luminance are kept.
/// Towards the bright edge of the gamut, colours beyond `KNEE` are compressed, so that bright saturated areas keep
/// their texture and fade to white.
#[inline(always)]
pub fn into_gamut(rgb: [f32; 3], y: f32) -> [f32; 3] {
    let [r, g, b] = rgb;
    let above = r.max(g).max(b) - y;
    let below = y - r.min(g).min(b);
    let room = 1.0 - y;
    // Fractions of the way from grey to the bright edge, and from grey to the dark edge, of the gamut. Results of a
    // division by 0 are not used.
    let (bright, dark) = (above / room, below / y.max(f32::MIN_POSITIVE));
    let u = (bright - KNEE) / (1.0 - KNEE);
    let slowed = (KNEE + (1.0 - KNEE) * (u / (1.0 + u))) * room / above;
    let keep = if bright > KNEE { slowed } else { 1.0 };
    let keep = if dark > 1.0 { keep.min(1.0 / dark) } else { keep };
    let is_well_within = above <= KNEE * room && below <= y;
    let is_white = y.is_nan() || y >= 1.0;
    rgb.map(|c| {
        let drawn = if is_well_within { c } else { y + (c - y) * keep };
        if is_white { 1.0 } else { drawn }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Adobe RGB's green is outside sRGB: (-0.3983, 1, -0.0429) in linear sRGB, as published.
    #[test]
    fn other_primaries_are_converted_and_white_is_kept() {
        let adobe = Primaries { green: [0.21, 0.71], ..Primaries::SRGB };
        let green = ToSrgb::from(&adobe).apply([0.0, 1.0, 0.0]);
        for (a, b) in green.iter().zip([-0.3983, 1.0, -0.0429]) {
            assert!((a - b).abs() < 2e-3, "{green:?}");
        }
        let equal_energy = Primaries { white: [1.0 / 3.0, 1.0 / 3.0], ..Primaries::SRGB };
        for primaries in [adobe, equal_energy] {
            let white = ToSrgb::from(&primaries).apply([1.0; 3]);
            assert!(white.iter().all(|c| (c - 1.0).abs() < 1e-5), "{white:?}");
        }
        assert_eq!(ToSrgb::from(&Primaries::SRGB), ToSrgb(None));
        let none = Primaries { green: [0.64, 0.33], ..Primaries::SRGB };
        assert_eq!(ToSrgb::from(&none), ToSrgb(None));
    }

    /// Luminance is kept up to rounding, and the result is within 0..=1. Hue is kept: the differences of the channels
    /// from grey keep their proportions.
    #[test]
    fn the_gamut_is_entered_at_the_same_hue_and_luminance() {
        for rgb in [[3.0, 0.2, 0.1], [0.0, 0.0, 8.0], [0.9, 0.95, 1.3], [0.5, -0.1, 0.2], [0.2, 0.3, 0.1]] {
            let y = luminance(rgb);
            let out = into_gamut(rgb, y);
            assert!(out.iter().all(|c| (-1e-6..=1.0).contains(c)), "{rgb:?} to {out:?}");
            assert!((luminance(out) - y).abs() < 1e-5);
            let (f, g) = ((rgb[0] - y) * (out[2] - y), (rgb[2] - y) * (out[0] - y));
            assert!((f - g).abs() < 1e-4 * (1.0 + rgb[2].abs()), "{rgb:?} to {out:?}");
        }
        assert_eq!(into_gamut([0.2, 0.3, 0.1], 0.26), [0.2, 0.3, 0.1]);
        assert_eq!(into_gamut([9.0, 0.0, 0.0], 1.5), [1.0; 3]);
        assert_eq!(into_gamut([0.0; 3], 0.0), [0.0; 3]);
    }
}
