//! The gain map: for every pixel and channel, the gain that turns the light of the picture into the radiance.
//!
//! In: radiance, and the codes of the picture. Out: a [`Rendition`], which describes how an HDR display shows
//! radiance, and the codes of the map. Cost: reading 200,000 pixels; then 5 ns per pixel and core. Source: ISO
//! 21496-1:2025, clauses 5 and 6; Google, "Ultra HDR Image Format v1.1" (gain map generation); Adobe, "Gain Map"
//! (2023).
//!
//! The HDR rendition, which a display shows if it applies the full map, is the radiance itself, linear and in the
//! primaries of the picture (sRGB's or Display P3's). Its white is chosen so that rendition and picture agree in the
//! mid-tones. So mid-tones have the same brightness on any display. Highlights are brighter than white as in the
//! scene, by up to 6 stops. Shadows may be darker than in the picture, by up to 10 stops. A display with a smaller
//! range applies the map in part.
//!
//! The three channels share one range of gains, for two reasons. Readers of the older metadata support only a common
//! range (libultrahdr refuses to write different ranges), and grey stays grey when the map is compressed.

use crate::bracket::colour::{Conversion, Primaries, srgb_to_linear};
use crate::plane::BAND_ROWS;
use crate::tonemap::display::codes::Colours;

/// A gain is the ratio of the radiance to the light of the picture. This offset is added to both, so that the ratio
/// is defined for black. A smaller offset represents shadows more exactly, but uses more of the map's range.
pub const OFFSET: f64 = 1.0 / 1024.0;

/// Largest brightness above white, in stops; no display has more.
pub const MOST_STOPS: f64 = 6.0;

/// Largest darkening of the picture by the map, in stops; darker radiance is black on any display.
pub(super) const MOST_FALL: f64 = 10.0;

/// Gains and headroom are multiples of 1 / `GRAIN` stops, so that the decimals in the XMP and the fractions in the ISO
/// block are exactly the same.
pub(super) const GRAIN: f64 = 1024.0;

/// Size of the gain map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Resolution {
    /// As large as the picture: contains the radiance of every pixel.
    #[default]
    Full,
    /// Half the width and height: a smaller file, but the radiance is blurred at edges.
    Half,
    /// No gain map: an ordinary JPEG.
    None,
}

impl Resolution {
    /// Returns the number of pixels of the picture per pixel of the map, along either axis; `None` without a map.
    pub(super) fn step(self) -> Option<usize> {
        match self {
            Resolution::Full => Some(1),
            Resolution::Half => Some(2),
            Resolution::None => None,
        }
    }
}

/// How an HDR display shows radiance, and the range of the gains in the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rendition {
    /// The radiance that is shown as the white of the picture, in the unit of the radiance map.
    pub white: f32,
    /// The smallest gain in the map, in stops.
    pub least_stops: f64,
    /// The largest gain in the map, in stops.
    pub most_stops: f64,
    /// The stops above white that a display needs to show all of the radiance.
    pub headroom_stops: f64,
}

impl Default for Rendition {
    /// Returns the rendition for unknown radiance.
    fn default() -> Self {
        Rendition { white: 1.0, least_stops: -MOST_FALL, most_stops: MOST_STOPS, headroom_stops: MOST_STOPS }
    }
}

impl Rendition {
    /// Returns the JPEG quality of the map. It is higher if the map has a larger range, so that a code value covers
    /// more stops; the error in stops is then about the same for all maps. Measured: at least 97 % of the pixels
    /// within the range have an error of at most 0.1 stop.
    pub(super) fn map_quality(&self) -> u8 {
        let range = self.most_stops - self.least_stops;
        (100.0 - 11.0 / range.max(0.1)).round().clamp(90.0, 99.0) as u8
    }
}

/// Converts radiance to the primaries of the picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct ToBase(Option<Conversion>);

impl ToBase {
    /// Creates the conversion from `primaries` to those of `colours`. Nothing is converted if both are equal within
    /// 0.001, or if `primaries` are not valid.
    pub(super) fn of(primaries: &Primaries, colours: Colours) -> Self {
        let is_same = primaries.is_close(&colours.primaries(), 1e-3);
        ToBase(Conversion::between(primaries, &colours.primaries()).filter(|_| !is_same))
    }

    #[inline(always)]
    pub(super) fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        self.0.as_ref().map_or(rgb, |conversion| conversion.apply(rgb))
    }
}

/// Replaces NaN and negative values by 0.
#[inline(always)]
pub(super) fn lit(v: f32) -> f32 {
    if v > 0.0 { v } else { 0.0 }
}

/// Returns the light `v * scale`, where 1 is white, limited to the range of the gain map: 0 to 64, which is 6 stops
/// above white.
#[inline(always)]
pub(super) fn shown(v: f32, scale: f32) -> f32 {
    let scaled = lit(v * scale);
    const MOST: f32 = 64.0;
    if scaled < MOST { scaled } else { MOST }
}

/// The linear light of every 8-bit code.
pub(super) struct Base {
    pub(super) linear: [f32; 256],
}

impl Base {
    pub(super) fn new() -> Self {
        Base { linear: std::array::from_fn(|code| srgb_to_linear(code as f64 / 255.0) as f32) }
    }

    /// Returns log2 of the sum of the light of `code` and [`OFFSET`].
    pub(super) fn stops(&self, code: u8) -> f64 {
        libm::log2(f64::from(self.linear[usize::from(code)]) + OFFSET)
    }
}

/// The table of logarithms ignores this number of low bits of a float. It has 512 cells per octave, so the middle of
/// a cell differs from every value in the cell by about 1/1000 stop at most.
const CELL_BITS: u32 = 14;

/// Converts radiance and codes to codes of the map.
pub(super) struct Gains {
    to_base: ToBase,
    scale: f32,
    /// For each cell (the upper bits of light plus offset), beginning with the cell of black: log2 of light plus
    /// offset, in code values of the map.
    of_light: Vec<f32>,
    /// For each code value of the picture: log2 of its light plus offset, plus the smallest gain, in code values of
    /// the map.
    of_code: [f32; 256],
}

impl Gains {
    pub(super) fn new(rendition: &Rendition, primaries: &Primaries, colours: Colours) -> Self {
        let codes_per_stop = 255.0 / (rendition.most_stops - rendition.least_stops);
        let first = Self::first();
        let last = (64.0 + OFFSET as f32).to_bits() >> CELL_BITS;
        let middle = |cell: u32| f64::from(f32::from_bits(cell << CELL_BITS | 1 << (CELL_BITS - 1)));
        let base = Base::new();
        Gains {
            to_base: ToBase::of(primaries, colours),
            scale: 1.0 / rendition.white,
            of_light: (first..=last).map(|cell| (codes_per_stop * libm::log2(middle(cell))) as f32).collect(),
            of_code: std::array::from_fn(|code| {
                (codes_per_stop * (base.stops(code as u8) + rendition.least_stops)) as f32
            }),
        }
    }

    /// Returns the cell of black, which is the first.
    fn first() -> u32 {
        (OFFSET as f32).to_bits() >> CELL_BITS
    }

    /// Returns the gains of a pixel, in codes of the map, not rounded.
    #[inline(always)]
    fn of(&self, radiance: [f32; 3], codes: [u8; 3]) -> [f32; 3] {
        let light = self.to_base.apply(radiance);
        std::array::from_fn(|c| {
            let cell = ((shown(light[c], self.scale) + OFFSET as f32).to_bits() >> CELL_BITS) - Self::first();
            self.of_light[cell as usize] - self.of_code[usize::from(codes[c])]
        })
    }

    /// Returns the map for rows of `width` pixels, one code for `step` x `step` pixels: their mean gain.
    pub(super) fn codes(&self, radiance: &[[f32; 3]], shown: &[[u8; 3]], width: usize, step: usize) -> Vec<[u8; 3]> {
        // The cast rounds down and limits values to 0..=255.
        let code = |gain: f32| (gain + 0.5) as u8;
        if step == 1 {
            return radiance.iter().zip(shown).map(|(&p, &q)| self.of(p, q).map(code)).collect();
        }
        let mut out = Vec::with_capacity(radiance.len() / (step * step) + width);
        for (rows, shown) in radiance.chunks(step * width).zip(shown.chunks(step * width)) {
            for x in (0..width).step_by(step) {
                let (mut sum, mut count) = ([0.0f32; 3], 0.0);
                for (row, shown) in rows.chunks(width).zip(shown.chunks(width)) {
                    let across = x..(x + step).min(width);
                    for (&p, &q) in row[across.clone()].iter().zip(&shown[across]) {
                        // Gains are limited to the range of the map before they are averaged, so that extreme gains
                        // do not dominate the mean.
                        let gain = self.of(p, q).map(|g| if g > 0.0 { if g < 255.0 { g } else { 255.0 } } else { 0.0 });
                        sum = std::array::from_fn(|c| sum[c] + gain[c]);
                        count += 1.0;
                    }
                }
                out.push(sum.map(|s| code(s / count)));
            }
        }
        out
    }
}

/// Number of rows of the picture per strip, 64. A strip of the map has 64 or 32 rows, which are complete blocks of
/// eight rows.
pub(super) const STRIP_ROWS: usize = BAND_ROWS;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::Plane;
    use crate::write::jpeg::Survey;

    /// Radiance 40 is white; the brightest quarter is shown two stops darker than it is, the rest unchanged.
    fn scene() -> (Plane<[f32; 3]>, Plane<[u8; 3]>) {
        let code = |light: f64| {
            let at = |c: usize| srgb_to_linear(c as f64 / 255.0);
            (0..256).min_by(|&a, &b| (at(a) - light).abs().total_cmp(&(at(b) - light).abs())).unwrap() as u8
        };
        let light = |x: usize| 0.01 * libm::exp2(x as f64 / 30.0);
        let radiance = Plane::from_rows(240, 150, |_, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [1.0, 0.5, 0.25].map(|tint: f32| 40.0 * tint * light(x) as f32);
            }
        });
        let shown = Plane::from_rows(240, 150, |_, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let dimmed = if x < 180 { 1.0 } else { 0.25 };
                *p = [1.0, 0.5, 0.25].map(|tint: f64| code(dimmed * tint * light(x)));
            }
        });
        (radiance, shown)
    }

    fn rendition(radiance: &Plane<[f32; 3]>, shown: &Plane<[u8; 3]>, white: Option<f32>) -> Rendition {
        let mut survey = Survey::new((radiance.width(), radiance.height()), &Primaries::SRGB, Colours::Srgb);
        survey.see(0, radiance, |y, _, codes| codes.copy_from_slice(shown.row(y)));
        survey.rendition(white)
    }

    #[test]
    fn the_mid_tones_agree_and_the_highlights_rise() {
        let (radiance, shown) = scene();
        let found = rendition(&radiance, &shown, None);
        // The tolerance is 3 %: at the darkest mid-tone, a step of one code value is about 3 % of the light.
        assert!((found.white / 40.0 - 1.0).abs() < 0.03, "{found:?}");
        // The peak is 2.5 times white; the brightest 0.2 % of the pixels are not counted. The gains are 0 and 2
        // stops, except for the rounding of code values. Code values below 8 are not counted, and at 8 the rounding
        // is 6 % of the light.
        assert!((found.headroom_stops - libm::log2(2.5)).abs() < 0.1, "{found:?}");
        assert!((found.most_stops - 2.0).abs() < 0.15 && found.least_stops.abs() < 0.15, "{found:?}");
        for stops in [found.most_stops, found.least_stops, found.headroom_stops] {
            assert_eq!((stops * GRAIN).fract(), 0.0);
        }
        let given = rendition(&radiance, &shown, Some(20.0));
        assert_eq!(given.white, 20.0);
        assert!((given.most_stops - found.most_stops - 1.0).abs() < 0.05, "{given:?}");
    }

    #[test]
    fn without_light_or_range_the_numbers_are_still_whole() {
        for value in [0.0, 1.0, f32::NAN, f32::INFINITY, f32::MAX, -1.0] {
            for code in [0, 128, 255] {
                let found = rendition(&Plane::filled(9, 9, [value; 3]), &Plane::filled(9, 9, [code; 3]), None);
                assert!(found.white.is_normal() && found.white > 0.0, "{value} {found:?}");
                assert!(found.most_stops > found.least_stops && found.headroom_stops > 0.0, "{value} {found:?}");
                let gains = Gains::new(&found, &Primaries::SRGB, Colours::Srgb);
                assert_eq!(gains.codes(&[[value; 3]; 6], &[[code; 3]; 6], 3, 2).len(), 2);
            }
        }
    }

    /// The expected codes are computed with the formula of ISO 21496-1 in double precision. The table of logarithms
    /// has an error of 1/1000 stop, which is far below half a code value of the map.
    #[test]
    fn codes_are_those_of_the_formula() {
        let (radiance, shown) = scene();
        let found = rendition(&radiance, &shown, None);
        let ours =
            Gains::new(&found, &Primaries::SRGB, Colours::Srgb).codes(radiance.as_slice(), shown.as_slice(), 240, 1);
        for ((light, codes), ours) in radiance.as_slice().iter().zip(shown.as_slice()).zip(&ours) {
            for c in 0..3 {
                let hdr = (f64::from(light[c]) / f64::from(found.white)).min(64.0);
                let sdr = srgb_to_linear(f64::from(codes[c]) / 255.0);
                let stops = libm::log2((hdr + OFFSET) / (sdr + OFFSET));
                let exact =
                    (255.0 * (stops - found.least_stops) / (found.most_stops - found.least_stops)).clamp(0.0, 255.0);
                assert!((exact - f64::from(ours[c])).abs() < 0.7, "{exact} {}", ours[c]);
            }
        }
    }

    #[test]
    fn half_is_the_mean_of_two_by_two() {
        let found = Rendition { white: 1.0, least_stops: 0.0, most_stops: 2.0, headroom_stops: 2.0 };
        let gains = Gains::new(&found, &Primaries::SRGB, Colours::Srgb);
        // Gains of 0, 1, 2 and 3 stops; the map limits 3 to 2. The third column and row are incomplete cells.
        let light = |stops: f32| [libm::exp2f(stops) * (1.0 + OFFSET as f32) - OFFSET as f32; 3];
        let radiance = [0.0, 1.0, 2.0, 2.0, 3.0, 0.0, 1.0, 1.0, 2.0].map(light);
        let half = gains.codes(&radiance, &[[255; 3]; 9], 3, 2);
        assert_eq!(half, [[159; 3], [128; 3], [128; 3], [255; 3]]);
    }

    #[test]
    fn a_wide_range_is_encoded_finer() {
        let quality = |most_stops| Rendition { most_stops, least_stops: 0.0, ..Rendition::default() }.map_quality();
        assert_eq!([0.125, 2.7, 7.0, 16.0].map(quality), [90, 96, 98, 99]);
    }
}
