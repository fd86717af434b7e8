//! Encoding of linear light as code values.
//!
//! In: linear RGB; 1 is display white. Out: code values of 8 or 16 bits, rounded to nearest, by the transfer function
//! of the picture's [`Colours`]; or, if the picture will be resized later, the linear light itself. Cost: 2 ns per
//! value. The tables are computed once for each transfer function and have 70 kB. Source: IEC 61966-2-1:1999 (sRGB),
//! clause 5; SMPTE EG 432-1 and Apple's Display P3, which has sRGB's transfer function; Adobe RGB (1998) Color Image
//! Encoding, section 4.3.4.

use crate::bracket::colour::{Conversion, Curve, Primaries, Profile, linear_to_srgb, srgb_to_linear};
use crate::simd::{Loops, at_most, floor32, integer32, vectorised};
use rayon::prelude::*;
use std::sync::LazyLock;

/// Colour space of a picture: primaries and transfer function.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum Colours {
    /// sRGB, shown correctly by every program and display.
    #[default]
    Srgb,
    /// Display P3, with more saturated reds and greens, for phones and newer computers.
    DisplayP3,
    /// Adobe RGB (1998), for print; a .jpg then needs --gain-map none.
    AdobeRgb,
}

/// Gamma of Adobe RGB.
const ADOBE: f64 = 563.0 / 256.0;

impl Colours {
    /// Returns the primaries and the white point.
    pub fn primaries(self) -> Primaries {
        match self {
            Colours::Srgb => Primaries::SRGB,
            Colours::DisplayP3 => Primaries::DISPLAY_P3,
            Colours::AdobeRgb => Primaries::ADOBE_RGB,
        }
    }

    /// Returns the linear light of a code value, both 0 to 1.
    pub fn light(self, code: f64) -> f64 {
        match self {
            Colours::Srgb | Colours::DisplayP3 => srgb_to_linear(code),
            Colours::AdobeRgb => libm::pow(code, ADOBE),
        }
    }

    /// Returns the code value of linear light, the inverse of [`light`](Self::light); light is clamped to 0..=1.
    pub fn code(self, light: f64) -> f64 {
        match self {
            Colours::Srgb | Colours::DisplayP3 => linear_to_srgb(light),
            Colours::AdobeRgb => libm::pow(light.clamp(0.0, 1.0), 1.0 / ADOBE),
        }
    }

    /// Returns the ICC profile; `None` for sRGB, which most formats mark in their own way.
    pub fn profile(self) -> Option<Profile> {
        match self {
            Colours::Srgb => None,
            Colours::DisplayP3 => Profile::of(&Primaries::DISPLAY_P3, Curve::Srgb, "Display P3"),
            Colours::AdobeRgb => Profile::of(&Primaries::ADOBE_RGB, Curve::Power(ADOBE), "Adobe RGB (1998)"),
        }
    }
}

/// Bits per channel of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Depth {
    /// Pixel values 0 to 255.
    #[default]
    #[strum(serialize = "8")]
    Eight,
    /// Pixel values 0 to 65535, for further editing.
    #[strum(serialize = "16")]
    Sixteen,
}

impl Depth {
    /// Returns the number of bits.
    pub fn bits(self) -> u8 {
        match self {
            Depth::Eight => 8,
            Depth::Sixteen => 16,
        }
    }
}

/// Number of low bits of a float that are ignored when a cell of the tables is selected. The other bits select one of
/// 256 cells per octave of light. A cell is narrower than an 8-bit code value. Within a cell, 16-bit code values differ
/// from a straight line by at most 0.03.
const CELL_BITS: u32 = 15;
/// Number of octaves of light below 1 that have cells. Darker light gets code value 0, even with 16 bits and a gamma of
/// 2.2.
const OCTAVES: u32 = 40;
/// The smallest light that has a cell of its own.
const LEAST: f32 = f32::from_bits((127 - OCTAVES) << 23);
/// The high bits of [`LEAST`]. The index of a float's cell is the high bits of the float minus this number.
const FIRST: u32 = (127 - OCTAVES) << (23 - CELL_BITS);
/// Number of cells from [`LEAST`] to 1.
const CELLS: usize = (OCTAVES << (23 - CELL_BITS)) as usize;
/// Number of pieces of the table from code values to light.
const PIECES: usize = 4096;

struct Tables {
    /// The 8-bit code value at the lower edge of every cell.
    base: Vec<u8>,
    /// For each 8-bit code value, the linear light at which the next code value begins.
    next: [f32; 256],
    /// The unrounded 16-bit code value at the lower edge of every cell, and at the upper edge of the last cell.
    fine: Vec<f32>,
    /// The range of code values, 0..=1, is split into [`PIECES`] pieces. This is the linear light at the lower end of
    /// each piece, and at the upper end of the last piece.
    light: Vec<f32>,
}

impl Tables {
    fn of(colours: Colours) -> Self {
        let mut next = [f32::INFINITY; 256];
        for (code, begin) in next.iter_mut().enumerate().take(255) {
            let exact = colours.light((code as f64 + 0.5) / 255.0);
            // The first float that is not below `exact`, so that comparing floats gives the same result as comparing
            // exact numbers.
            let nearest = exact as f32;
            *begin = if f64::from(nearest) < exact { nearest.next_up() } else { nearest };
        }
        let edge = |cell: usize| f32::from_bits((FIRST + cell as u32) << CELL_BITS);
        let base = (0..=CELLS).map(|cell| next.partition_point(|&begin| begin <= edge(cell)) as u8).collect();
        let fine = (0..=CELLS + 1).map(|cell| (65535.0 * colours.code(f64::from(edge(cell)))) as f32).collect();
        let light = (0..=PIECES + 1).map(|i| colours.light(i as f64 / PIECES as f64) as f32).collect();
        Tables { base, next, fine, light }
    }
}

static SRGB: LazyLock<Tables> = LazyLock::new(|| Tables::of(Colours::Srgb));
static ADOBE_RGB: LazyLock<Tables> = LazyLock::new(|| Tables::of(Colours::AdobeRgb));

/// Encodes light as code values of a colour space; light is clamped to 0..=1, and NaN becomes 0.
#[doc(hidden)]
#[derive(Clone, Copy)]
pub struct Encoder {
    tables: &'static Tables,
    /// Conversion from linear sRGB to the primaries of the output; `None` if the output is sRGB.
    gamut: Option<Conversion>,
}

impl Encoder {
    /// Returns the encoder of `colours`; the first call for a transfer function computes its tables.
    pub fn of(colours: Colours) -> Self {
        let gamut = match colours {
            Colours::Srgb => None,
            _ => Conversion::between(&Primaries::SRGB, &colours.primaries()),
        };
        Encoder { tables: if colours == Colours::AdobeRgb { &ADOBE_RGB } else { &SRGB }, gamut }
    }

    /// Converts linear sRGB, which may be outside the sRGB gamut, to linear RGB of the picture's primaries.
    #[inline(always)]
    pub fn from_srgb(&self, rgb: [f32; 3]) -> [f32; 3] {
        match &self.gamut {
            None => rgb,
            Some(conversion) => conversion.apply(rgb),
        }
    }

    /// Returns the index of the cell of each value of `light`.
    #[inline(always)]
    fn cells<const N: usize>(light: &[f32; N]) -> [u16; N] {
        let mut cells = [0u16; N];
        for (cell, &v) in cells.iter_mut().zip(light) {
            *cell = ((within(v).to_bits() >> CELL_BITS) - FIRST) as u16;
        }
        cells
    }
}

/// Returns `light` clamped to the range of the cells.
#[inline(always)]
fn within(light: f32) -> f32 {
    at_most(if light > LEAST { light } else { LEAST }, 1.0)
}

impl Default for Encoder {
    fn default() -> Self {
        Encoder::of(Colours::default())
    }
}

/// Encodes `light` to `codes`, which is resized to the same length.
pub fn encoded<C: Code>(encoder: &Encoder, light: &[[f32; 3]], codes: &mut Vec<[C; 3]>) {
    const AT_ONCE: usize = 1 << 12;
    codes.resize(light.len(), [C::default(); 3]);
    let parts = codes.par_chunks_mut(AT_ONCE).zip(light.par_chunks(AT_ONCE));
    parts.for_each(|(codes, light)| vectorised(Encoded { encoder, light, codes }));
}

/// Light to encode.
struct Encoded<'a, C> {
    encoder: &'a Encoder,
    light: &'a [[f32; 3]],
    codes: &'a mut [[C; 3]],
}

impl<C: Code> Loops for Encoded<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        const BLOCK: usize = 96;
        let (light, codes) = (self.light.as_flattened(), self.codes.as_flattened_mut());
        let mut block = [0.0f32; BLOCK];
        for (light, codes) in light.chunks(BLOCK).zip(codes.chunks_mut(BLOCK)) {
            block[..light.len()].copy_from_slice(light);
            codes.copy_from_slice(&C::of_light(self.encoder, &block)[..codes.len()]);
        }
    }
}

/// The type of a channel: a code value, or `f32` for linear light.
#[doc(hidden)]
pub trait Code: Copy + Default + Send + Sync + 'static {
    /// Encodes linear light.
    fn of_light<const N: usize>(encoder: &Encoder, light: &[f32; N]) -> [Self; N];

    /// Converts a value that is already encoded, on the scale 0..=1.
    fn of_encoded(encoder: &Encoder, encoded: f32) -> Self;
}

impl Code for u8 {
    #[inline(always)]
    fn of_light<const N: usize>(encoder: &Encoder, light: &[f32; N]) -> [u8; N] {
        let (cells, mut codes) = (Encoder::cells(light), [0u8; N]);
        let (base, next) = (encoder.tables.base.as_slice(), &encoder.tables.next);
        for ((code, &cell), &v) in codes.iter_mut().zip(&cells).zip(light) {
            let below = base[usize::from(cell)];
            *code = below.saturating_add(u8::from(v >= next[usize::from(below)]));
        }
        codes
    }

    #[inline(always)]
    fn of_encoded(_: &Encoder, encoded: f32) -> u8 {
        (255.0 * encoded.clamp(0.0, 1.0) + 0.5) as u8
    }
}

impl Code for u16 {
    #[inline(always)]
    fn of_light<const N: usize>(encoder: &Encoder, light: &[f32; N]) -> [u16; N] {
        let (cells, mut codes) = (Encoder::cells(light), [0u16; N]);
        let fine = encoder.tables.fine.as_slice();
        for ((code, &cell), &v) in codes.iter_mut().zip(&cells).zip(light) {
            let (a, b) = (fine[usize::from(cell)], fine[usize::from(cell) + 1]);
            let part = (within(v).to_bits() & ((1 << CELL_BITS) - 1)) as f32 * (1.0 / (1u32 << CELL_BITS) as f32);
            *code = integer32(floor32(a + part * (b - a) + 0.5)) as u16;
        }
        codes
    }

    #[inline(always)]
    fn of_encoded(_: &Encoder, encoded: f32) -> u16 {
        (65535.0 * encoded.clamp(0.0, 1.0) + 0.5) as u16
    }
}

impl Code for f32 {
    #[inline(always)]
    fn of_light<const N: usize>(_: &Encoder, light: &[f32; N]) -> [f32; N] {
        light.map(|v| at_most(if v > 0.0 { v } else { 0.0 }, 1.0))
    }

    #[inline(always)]
    fn of_encoded(encoder: &Encoder, encoded: f32) -> f32 {
        let place = encoded.clamp(0.0, 1.0) * PIECES as f32;
        let piece = (place as usize).min(PIECES);
        let (a, b) = (encoder.tables.light[piece], encoder.tables.light[piece + 1]);
        a + (place - piece as f32) * (b - a)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Colours; 3] = [Colours::Srgb, Colours::DisplayP3, Colours::AdobeRgb];

    /// Returns the code value of `light` by the transfer functions as printed in the standards, in `f64`.
    fn textbook(colours: Colours, light: f64) -> f64 {
        match colours {
            Colours::AdobeRgb => libm::pow(light, 256.0 / 563.0),
            _ if light <= 0.0031308 => 12.92 * light,
            _ => 1.055 * libm::pow(light, 1.0 / 2.4) - 0.055,
        }
    }

    fn one<C: Code>(encoder: &Encoder, light: f32) -> C {
        C::of_light(encoder, &[light; 3])[1]
    }

    /// The tolerances have these reasons. The two branches of sRGB differ by 3e-8 where they meet. If a float is closer
    /// than 1e-6 code values to a rounding boundary, it may be rounded up or down. 16-bit code values have an error of
    /// 0.03 because of the interpolation over 1/256 octave, and of 0.01 because of the rounding of `f32`.
    #[test]
    fn codes_are_those_of_the_standards() {
        for colours in ALL {
            let encoder = Encoder::of(colours);
            let mut values: Vec<f32> = (0..=300_000).map(|i| i as f32 / 300_000.0).collect();
            values.extend((0..20_000).map(|i| libm::exp2f(-41.0 * i as f32 / 20_000.0)));
            let bounds = encoder.tables.next.iter().flat_map(|&v| [v.next_down(), v, v.next_up()]);
            values.extend(bounds.filter(|v| *v <= 1.0));
            for v in values {
                let exact = textbook(colours, f64::from(v));
                let eight = f64::from(one::<u8>(&encoder, v)) - 255.0 * exact;
                assert!(eight.abs() <= 0.5 + 1e-4, "{colours:?} {v}: {eight}");
                let sixteen = f64::from(one::<u16>(&encoder, v)) - 65535.0 * exact;
                assert!(sixteen.abs() <= 0.55, "{colours:?} {v}: {sixteen}");
            }
            let ends = [-1.0, -0.0, f32::NAN, 1.0, 7.0, f32::INFINITY];
            assert_eq!(ends.map(|v| one::<u8>(&encoder, v)), [0, 0, 0, 255, 255, 255]);
            assert_eq!(ends.map(|v| one::<u16>(&encoder, v)), [0, 0, 0, 65535, 65535, 65535]);
        }
    }

    #[test]
    fn every_code_comes_back() {
        for colours in ALL {
            let encoder = Encoder::of(colours);
            for code in 0..=255u8 {
                assert_eq!(one::<u8>(&encoder, colours.light(f64::from(code) / 255.0) as f32), code, "{colours:?}");
                assert_eq!(u8::of_encoded(&encoder, f32::from(code) / 255.0), code);
            }
            for code in 0..=65535u16 {
                assert_eq!(one::<u16>(&encoder, colours.light(f64::from(code) / 65535.0) as f32), code, "{colours:?}");
                let encoded = f32::from(code) / 65535.0;
                assert_eq!(u16::of_encoded(&encoder, encoded), code);
                let light = f64::from(f32::of_encoded(&encoder, encoded));
                assert!((light - colours.light(f64::from(encoded))).abs() < 1e-6, "{colours:?} {code}");
            }
        }
    }

    /// A reader of the profile recovers the light that was encoded.
    #[test]
    fn profile_determines_the_colours() {
        assert_eq!(Colours::Srgb.profile(), None);
        for colours in [Colours::DisplayP3, Colours::AdobeRgb] {
            let profile = colours.profile().unwrap();
            assert_eq!(profile.primaries, Some(colours.primaries()));
            let transfer = crate::bracket::colour::Transfer::of(Some(&profile));
            for code in 0..=100 {
                let code = f64::from(code) / 100.0;
                assert!((transfer.light(1, code) - colours.light(code)).abs() < 2e-5, "{colours:?} {code}");
            }
        }
        // White stays white, and sRGB's green is inside both gamuts.
        let [p3, adobe] = [Colours::DisplayP3, Colours::AdobeRgb].map(Encoder::of);
        for encoder in [p3, adobe] {
            assert!(encoder.from_srgb([1.0; 3]).iter().all(|c| (c - 1.0).abs() < 1e-5));
            assert!(encoder.from_srgb([0.0, 1.0, 0.0]).iter().all(|c| (0.0..=1.0).contains(c)));
        }
    }
}
