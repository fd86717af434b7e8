//! The way to the display: linear RGB of any primaries to linear sRGB, into the gamut by hue-keeping desaturation, to 8-bit codes.
//!
//! In: radiance RGB, or linear RGB relative to display white. Out: the other, or codes. Cost: about 10 ns a pixel; the tables are made
//! once. Source: IEC 61966-2-1:1999 (sRGB), section 4.3.

use crate::bracket::colour::{Conversion, Primaries, srgb_to_linear};
use crate::simd::{at_most, floor32, integer32};
use std::sync::LazyLock;

/// Luminance of linear sRGB: the second row of its matrix to XYZ.
pub const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// The luminance of a linear sRGB colour.
#[inline(always)]
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    LUMINANCE[0] * r + LUMINANCE[1] * g + LUMINANCE[2] * b
}

/// Takes linear RGB of some primaries to linear sRGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToSrgb(Option<Conversion>);

impl ToSrgb {
    /// From `primaries`; nothing is done where these are sRGB's to three places, or are no primaries at all.
    pub fn from(primaries: &Primaries) -> Self {
        if primaries.is_close(&Primaries::SRGB, 1e-3) {
            return ToSrgb(None);
        }
        ToSrgb(Conversion::between(primaries, &Primaries::SRGB))
    }

    /// The colour in linear sRGB: components below 0 are colours that sRGB has not.
    #[inline(always)]
    pub fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        match &self.0 {
            None => rgb,
            Some(conversion) => conversion.apply(rgb),
        }
    }
}

/// From where on a colour that nears the edge of the gamut is held back, as a part of the way from grey to the edge.
const KNEE: f32 = 0.75;

/// `rgb`, of luminance `y` relative to display white, drawn towards the grey of that luminance until it is in 0..=1. Hue and luminance
/// stay; towards the bright edge it is slowed from `KNEE` on, so that bright saturated parts keep their drawing and fade to white.
#[inline(always)]
pub fn into_gamut(rgb: [f32; 3], y: f32) -> [f32; 3] {
    let [r, g, b] = rgb;
    let above = r.max(g).max(b) - y;
    let below = y - r.min(g).min(b);
    let room = 1.0 - y;
    // The parts of the way to the bright and the dark edge; what comes of a division by nothing is not taken.
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

/// Cells of the table over 0..=1: narrower than a code even where the curve is steepest (12.92 * 255 codes per 1, so 0.8 of one).
const CELLS: usize = 4096;

struct Codes {
    /// The code at the left edge of every cell.
    base: Vec<u8>,
    /// Where the code after each begins: linear.
    next: [f32; 256],
}

static CODES: LazyLock<Codes> = LazyLock::new(|| {
    let mut next = [f32::INFINITY; 256];
    for (code, begin) in next.iter_mut().enumerate().take(255) {
        let exact = srgb_to_linear((code as f64 + 0.5) / 255.0);
        // The first float at or above: so that comparing floats decides as comparing the exact numbers.
        let nearest = exact as f32;
        *begin = if f64::from(nearest) < exact { nearest.next_up() } else { nearest };
    }
    let code_of = |v: f32| next.partition_point(|&begin| begin <= v) as u8;
    let base = (0..=CELLS).map(|cell| code_of(cell as f32 / CELLS as f32)).collect();
    Codes { base, next }
});

/// The codes of linear light by sRGB, rounded to nearest; outside 0..=1 the nearest end, NaN as 0.
#[derive(Clone, Copy)]
pub struct Encoder(&'static Codes);

impl Encoder {
    /// The encoder; the first makes the tables.
    pub fn new() -> Self {
        Encoder(&CODES)
    }

    /// The code of each of `linear`.
    #[inline(always)]
    pub fn codes<const N: usize>(&self, linear: &[f32; N]) -> [u8; N] {
        let (mut cells, mut codes) = ([0u16; N], [0u8; N]);
        for (cell, &v) in cells.iter_mut().zip(linear) {
            let scaled = v * CELLS as f32;
            let within = if scaled > 0.0 { scaled } else { 0.0 };
            *cell = integer32(floor32(at_most(within, CELLS as f32))) as u16;
        }
        let (base, next) = (self.0.base.as_slice(), &self.0.next);
        for ((code, &cell), &v) in codes.iter_mut().zip(&cells).zip(linear) {
            let below = base[usize::from(cell)];
            *code = below.saturating_add(u8::from(v >= next[usize::from(below)]));
        }
        codes
    }
}

impl Default for Encoder {
    fn default() -> Self {
        Encoder::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Encoder {
        /// One by itself, by casts, which keep within the type: what vectors do instead must not show.
        fn code(&self, linear: f32) -> u8 {
            let cell = ((linear * CELLS as f32) as usize).min(CELLS);
            let base = self.0.base[cell];
            // Infinity is at the end of the last code too.
            let code = base.saturating_add(u8::from(linear >= self.0.next[usize::from(base)]));
            assert_eq!(self.codes(&[linear; 3]), [code; 3], "{linear}");
            code
        }
    }

    /// The transfer as it is printed, in doubles.
    fn textbook(linear: f64) -> f64 {
        if linear <= 0.0031308 { 12.92 * linear } else { 1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055 }
    }

    /// The standard's two branches miss each other by 3e-8 around the knee; a float nearer than 1e-6 of a code to a boundary may fall
    /// to either side.
    #[test]
    fn codes_are_those_of_the_standard() {
        let encoder = Encoder::new();
        let mut values: Vec<f32> = (0..=300_000).map(|i| i as f32 / 300_000.0).collect();
        values.extend(CODES.next.iter().flat_map(|&v| [v.next_down(), v, v.next_up()]).filter(|v| *v <= 1.0));
        for v in values {
            let exact = 255.0 * textbook(f64::from(v));
            let error = (f64::from(encoder.code(v)) - exact).abs();
            assert!(error <= 0.5 + 1e-4, "{v}: {} for {exact}", encoder.code(v));
        }
        let ends = [-1.0, -0.0, f32::NAN, 1.0, 1.0f32.next_down(), 7.0, f32::INFINITY];
        assert_eq!(ends.map(|v| encoder.code(v)), [0, 0, 0, 255, 255, 255, 255]);
    }

    #[test]
    fn every_code_comes_back() {
        let encoder = Encoder::new();
        for code in 0..=255u8 {
            assert_eq!(encoder.code(srgb_to_linear(f64::from(code) / 255.0) as f32), code);
        }
    }

    /// Adobe RGB's green is outside sRGB: published as (-0.3983, 1, -0.0429) of linear sRGB in its second column.
    #[test]
    fn other_primaries_are_converted_and_white_stays_white() {
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

    /// Keeps luminance to rounding, keeps the order and proportions of the differences from grey (hue), and stays within 0..=1.
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
