//! Codes: what the light of a picture is written as.
//!
//! In: linear RGB, 0 to 1 of display white. Out: codes of 8 or 16 bits, rounded to nearest, by the transfer of the picture's [`Colours`]; or the light
//! itself, where it is still to be resized. Cost: 2 ns a value; the tables are made once, 50 kB for each transfer. Source: IEC 61966-2-1:1999 (sRGB),
//! section 4.3; SMPTE EG 432-1 and Apple's Display P3, which has sRGB's transfer; Adobe RGB (1998) Color Image Encoding, section 4.3.4.

use crate::bracket::colour::{Conversion, Curve, Primaries, Profile, linear_to_srgb, srgb_to_linear};
use crate::simd::{Loops, at_most, floor32, integer32, vectorised};
use rayon::prelude::*;
use std::sync::LazyLock;

/// The colours of a picture: primaries and transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum Colours {
    /// sRGB: shown correctly by every program and display.
    #[default]
    Srgb,
    /// Display P3: more saturated reds and greens, for phones and newer computers.
    DisplayP3,
    /// Adobe RGB (1998): for print; .jpg has it only without a gain map.
    AdobeRgb,
}

/// The exponent of Adobe RGB.
const ADOBE: f64 = 563.0 / 256.0;

impl Colours {
    /// Its primaries and white.
    pub fn primaries(self) -> Primaries {
        match self {
            Colours::Srgb => Primaries::SRGB,
            Colours::DisplayP3 => Primaries::DISPLAY_P3,
            Colours::AdobeRgb => Primaries::ADOBE_RGB,
        }
    }

    /// The light of a code, both 0 to 1.
    pub fn light(self, code: f64) -> f64 {
        match self {
            Colours::Srgb | Colours::DisplayP3 => srgb_to_linear(code),
            Colours::AdobeRgb => libm::pow(code, ADOBE),
        }
    }

    /// The inverse of [`light`](Self::light); outside 0..=1 the nearest end.
    pub fn code(self, light: f64) -> f64 {
        match self {
            Colours::Srgb | Colours::DisplayP3 => linear_to_srgb(light),
            Colours::AdobeRgb => libm::pow(light.clamp(0.0, 1.0), 1.0 / ADOBE),
        }
    }

    /// The ICC profile that tells them; none for sRGB, for which most formats have a word of their own.
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
    /// Code values 0 to 255.
    #[default]
    #[strum(serialize = "8")]
    Eight,
    /// Code values 0 to 65535, for further editing.
    #[strum(serialize = "16")]
    Sixteen,
}

impl Depth {
    /// How many they are.
    pub fn bits(self) -> u8 {
        match self {
            Depth::Eight => 8,
            Depth::Sixteen => 16,
        }
    }
}

/// Bits of a float below which a cell of the tables ends: 256 cells to the octave, each narrower than a code of 8 bits, and so narrow that 16-bit codes
/// are straight over it to 0.03 of one.
const CELL_BITS: u32 = 15;
/// Octaves below 1 that have cells: what is darker is code 0 even by a power of 2.2 and with 16 bits.
const OCTAVES: u32 = 40;
/// The least light that has a cell of its own.
const LEAST: f32 = f32::from_bits((127 - OCTAVES) << 23);
/// The cell of that.
const FIRST: u32 = (127 - OCTAVES) << (23 - CELL_BITS);
/// Cells from there to 1.
const CELLS: usize = (OCTAVES << (23 - CELL_BITS)) as usize;
/// Pieces of the table from codes to light.
const PIECES: usize = 4096;

struct Tables {
    /// The 8-bit code at the left edge of every cell.
    base: Vec<u8>,
    /// Where the 8-bit code after each begins: linear.
    next: [f32; 256],
    /// The 16-bit code, not rounded, at the left edge of every cell, and of one more.
    fine: Vec<f32>,
    /// The light at the left edge of every piece of codes, and of one more.
    light: Vec<f32>,
}

impl Tables {
    fn of(colours: Colours) -> Self {
        let mut next = [f32::INFINITY; 256];
        for (code, begin) in next.iter_mut().enumerate().take(255) {
            let exact = colours.light((code as f64 + 0.5) / 255.0);
            // The first float at or above: so that comparing floats decides as comparing the exact numbers.
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

/// Light to the codes of a picture's colours; outside 0..=1 the nearest end, NaN as 0.
#[derive(Clone, Copy)]
pub struct Encoder {
    tables: &'static Tables,
    /// From linear sRGB; none for sRGB.
    gamut: Option<Conversion>,
}

impl Encoder {
    /// That of `colours`; the first makes the tables.
    pub fn of(colours: Colours) -> Self {
        let (tables, gamut) = match colours {
            Colours::Srgb => (&SRGB, None),
            Colours::DisplayP3 => (&SRGB, Conversion::between(&Primaries::SRGB, &colours.primaries())),
            Colours::AdobeRgb => (&ADOBE_RGB, Conversion::between(&Primaries::SRGB, &colours.primaries())),
        };
        Encoder { tables, gamut }
    }

    /// Linear sRGB, beyond its gamut too, as linear light of the picture's primaries.
    #[inline(always)]
    pub fn from_srgb(&self, rgb: [f32; 3]) -> [f32; 3] {
        match &self.gamut {
            None => rgb,
            Some(conversion) => conversion.apply(rgb),
        }
    }

    /// The cell of each of `light`.
    #[inline(always)]
    fn cells<const N: usize>(light: &[f32; N]) -> [u16; N] {
        let mut cells = [0u16; N];
        for (cell, &v) in cells.iter_mut().zip(light) {
            *cell = ((within(v).to_bits() >> CELL_BITS) - FIRST) as u16;
        }
        cells
    }
}

/// `light` as the cells have it.
#[inline(always)]
fn within(light: f32) -> f32 {
    at_most(if light > LEAST { light } else { LEAST }, 1.0)
}

impl Default for Encoder {
    fn default() -> Self {
        Encoder::of(Colours::default())
    }
}

/// The codes of `light`.
pub fn encoded<C: Code>(encoder: &Encoder, light: &[[f32; 3]], codes: &mut Vec<[C; 3]>) {
    const AT_ONCE: usize = 1 << 12;
    codes.resize(light.len(), [C::default(); 3]);
    let parts = codes.par_chunks_mut(AT_ONCE).zip(light.par_chunks(AT_ONCE));
    parts.for_each(|(codes, light)| vectorised(Encoded { encoder, light, codes }));
}

/// Light that is encoded.
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

/// What a channel of a pixel of a picture is: a code, or the light itself.
pub trait Code: Copy + Default + Send + Sync + 'static {
    /// Those of `light`.
    fn of_light<const N: usize>(encoder: &Encoder, light: &[f32; N]) -> [Self; N];

    /// That of a value that was encoded already, on the scale 0..=1.
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

    /// The transfers as they are printed, in doubles.
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

    /// The standard's two branches miss each other by 3e-8 around the knee; a float nearer than 1e-6 of a code to a boundary may fall
    /// to either side. A 16-bit code is straight over 1/256 of an octave: 0.03 of it, and floats of 24 bits round it by 0.01.
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

    /// What a reader of the profile makes of a code is the light that was encoded.
    #[test]
    fn profile_tells_the_colours() {
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
        // Adobe RGB's green in Display P3 and the other way round are outside; white is white.
        let [p3, adobe] = [Colours::DisplayP3, Colours::AdobeRgb].map(Encoder::of);
        for encoder in [p3, adobe] {
            assert!(encoder.from_srgb([1.0; 3]).iter().all(|c| (c - 1.0).abs() < 1e-5));
            assert!(encoder.from_srgb([0.0, 1.0, 0.0]).iter().all(|c| (0.0..=1.0).contains(c)));
        }
    }
}
