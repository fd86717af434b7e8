//! Adjusts the light of a picture, the last step before it is encoded.
//!
//! In: rows of light of the picture's primaries, 0..=1, from an operator or from fusion. Out: rows of code values of
//! the adjusted picture. Cost: 5 ns of core time per pixel. Apart from white balance, only luminance is changed:
//! colours keep their hue and, unless saturation is set, the proportions of their linear channels. Colours outside the
//! gamut are desaturated in OkLab.

use super::surroundings::Surroundings;
use super::{Light, MOST, Options};
use crate::bracket::colour::srgb_to_linear;
use crate::plane::Plane;
use crate::simd::{Loops, at_least, at_most, exp2, log2, vectorised};
use crate::tonemap::display::codes::{Code, Colours, Encoder};
use crate::tonemap::display::oklab;
use crate::tonemap::display::{ToSrgb, luminance};

/// Largest change of the log odds by the options shadows and highlights: with the value [`MOST`], in the darkest
/// surroundings by shadows, and in the brightest surroundings by highlights. In the dark, the unit of log odds is a
/// stop. The change is small enough that opposite settings never make a dark surface brighter than a bright one (the
/// remaining slope in the middle tones is 0.31).
const LOCAL_STOPS: f64 = 2.0;

/// Smallest distance of a luminance from black and from white: 2^-24, the spacing of floats just below 1.
const LEAST: f32 = 1.0 / 16_777_216.0;

/// Number of pixels that are computed together.
const BLOCK: usize = 64;

/// Applies adjustments to the light of a picture.
#[derive(Debug, Clone)]
pub struct Adjusted {
    to_srgb: ToSrgb,
    /// `to_srgb` with white balance, for a picture whose white was not balanced in the radiance.
    balanced: Option<ToSrgb>,
    brightness: f32,
    /// Factor on the distance of the log odds from `middle`.
    contrast: f32,
    /// Log odds of the middle code value.
    middle: f32,
    /// Factor on chroma.
    saturation: f32,
    /// Change of the log odds in the darkest surroundings.
    shadows: f32,
    /// Change of the log odds in the brightest surroundings.
    highlights: f32,
    surroundings: Option<Surroundings>,
}

impl Adjusted {
    /// Prepares `options` for a picture of `colours` that is `width` pixels wide; `None` when its light does not
    /// change.
    ///
    /// `light` is the light to show as white; it is `None` if the radiance was already balanced. `display` holds the
    /// luminances, 0..=1, of cells of the picture, and the side of a cell in pixels; it is needed when the options
    /// [need surroundings](Options::needs_surroundings).
    pub fn new(
        options: &Options,
        colours: Colours,
        light: Option<Light>,
        display: Option<(Plane<f32>, usize)>,
        width: usize,
    ) -> Option<Self> {
        let primaries = colours.primaries();
        let middle = srgb_to_linear(128.0 / 255.0);
        (options.changes_light() || light.is_some()).then(|| Adjusted {
            to_srgb: ToSrgb::from(&primaries),
            balanced: light.map(|light| ToSrgb::balanced(&primaries, light.xy())),
            brightness: options.brightness as f32,
            contrast: libm::exp2(options.contrast / MOST) as f32,
            middle: libm::log2(middle / (1.0 - middle)) as f32,
            saturation: (1.0 + options.saturation / MOST) as f32,
            shadows: (LOCAL_STOPS * options.shadows / MOST) as f32,
            highlights: (LOCAL_STOPS * options.highlights / MOST) as f32,
            surroundings: display.map(|(display, side)| Surroundings::new(&display, side, width)),
        })
    }

    /// Adjusts and encodes row `y`, whose light is `light`.
    pub fn row<C: Code>(&self, encoder: &Encoder, y: usize, light: &[[f32; 3]], codes: &mut [[C; 3]]) {
        let mut lines = Vec::new();
        if let Some(surroundings) = &self.surroundings {
            surroundings.guide.row(y, &mut lines);
        }
        vectorised(Row { adjusted: self, lines: &lines, encoder, light, codes });
    }

    /// Adjusts the display luminances of consecutive pixels in place, starting in column `x`. `lines` are the slopes
    /// and offsets of the guide of the surroundings for this row of the picture.
    #[inline(always)]
    fn luminances(&self, x: usize, lines: &[[f32; 2]], display: &mut [f32; BLOCK]) {
        let mut odds = [0.0f32; BLOCK];
        for i in 0..BLOCK {
            let y = at_least(at_most(display[i], 1.0 - LEAST), LEAST);
            odds[i] = log2(y / (1.0 - y));
        }
        if let Some(surroundings) = &self.surroundings {
            let mut around = odds;
            surroundings.around(x, lines, &mut around);
            for i in 0..BLOCK {
                // Brightness of the surroundings, 0..1; 0.5 at the middle code value.
                let bright = 1.0 / (1.0 + exp2(at_least(at_most(self.middle - around[i], 30.0), -30.0)));
                let dark = 1.0 - bright;
                odds[i] += self.shadows * (dark * dark) + self.highlights * (bright * bright);
            }
        }
        for i in 0..BLOCK {
            let t = self.middle + self.contrast * (odds[i] - self.middle) + self.brightness;
            let odds = exp2(at_least(at_most(t, 60.0), -60.0));
            display[i] = odds / (1.0 + odds);
        }
    }
}

/// A row of light to adjust.
struct Row<'a, C> {
    adjusted: &'a Adjusted,
    lines: &'a [[f32; 2]],
    encoder: &'a Encoder,
    light: &'a [[f32; 3]],
    codes: &'a mut [[C; 3]],
}

impl<C: Code> Loops for Row<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Row { adjusted, lines, encoder, .. } = self;
        let mut rgb = [[0.0f32; BLOCK]; 3];
        let (mut light, mut display) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
        let mut x = 0;
        for (pixels, codes) in self.light.chunks(BLOCK).zip(self.codes.chunks_mut(BLOCK)) {
            let [red, green, blue] = &mut rgb;
            for (((r, g), b), p) in red.iter_mut().zip(&mut *green).zip(&mut *blue).zip(pixels) {
                (*r, *g, *b) = (p[0], p[1], p[2]);
            }
            for i in 0..BLOCK {
                let shown = adjusted.to_srgb.apply([red[i], green[i], blue[i]]);
                display[i] = luminance(shown);
                // Balancing here keeps luminance, so that clipped white stays white.
                let [r, g, b] = match &adjusted.balanced {
                    None => shown,
                    Some(balanced) => balanced.apply([red[i], green[i], blue[i]]),
                };
                (red[i], green[i], blue[i]) = (r, g, b);
                light[i] = at_least(luminance([r, g, b]), f32::MIN_POSITIVE);
            }
            adjusted.luminances(x, lines, &mut display);
            let shown = oklab::Shown { light, display, share: [adjusted.saturation; BLOCK], turn: [0.0; BLOCK] };
            shown.colours(&mut rgb, |rgb| encoder.from_srgb(rgb));
            let encoded = rgb.each_ref().map(|channel| C::of_light(encoder, channel));
            for (i, out) in codes.iter_mut().enumerate() {
                *out = [encoded[0][i], encoded[1][i], encoded[2][i]];
            }
            x += pixels.len();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tonemap::adjust::WhiteBalance;
    use crate::tonemap::display::codes::encoded;

    /// Returns the light of the adjusted picture; `around` is the luminance of its surroundings.
    fn adjusted(options: &Options, around: Option<f32>, light: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let cells = around.map(|y| (Plane::filled(3, 1, y), 100));
        let Some(adjusted) = Adjusted::new(options, Colours::Srgb, None, cells, light.len()) else {
            return light.to_vec();
        };
        let mut out = vec![[0.0f32; 3]; light.len()];
        adjusted.row(&Encoder::default(), 0, light, &mut out);
        out
    }

    fn of(change: impl Fn(&mut Options)) -> Options {
        let mut options = Options::default();
        change(&mut options);
        options
    }

    /// Returns greys and tints inside the gamut of the display, at many luminances.
    fn ramp() -> Vec<[f32; 3]> {
        let tint = |i: usize| [[1.0, 1.0, 1.0], [1.0, 0.9, 0.8], [0.7, 0.9, 1.0], [0.9, 1.0, 0.8]][i % 4];
        (0..297).map(|i| tint(i).map(|c: f32| c * libm::exp2f(-12.0 + i as f32 / 297.0 * 11.9))).collect()
    }

    fn odds(y: f32) -> f64 {
        libm::log2(f64::from(y) / (1.0 - f64::from(y)))
    }

    /// The expected values are computed by the formulas of the module documentation in `f64`. In the vectorised code,
    /// logarithms have errors of 2e-7 for values below 16, and powers of 3e-7; the conversion through OkLab is exact to
    /// 1e-5 of linear light.
    #[test]
    fn rows_are_those_of_the_formula() {
        let middle = odds(srgb_to_linear(128.0 / 255.0) as f32);
        let light = ramp();
        for around in [0.0, 0.001, 0.05, 0.2159, 0.6, 0.99, 1.0] {
            let options = of(|o| (o.brightness, o.contrast, o.shadows, o.highlights) = (0.7, -30.0, 60.0, -80.0));
            let bright = 1.0 / (1.0 + libm::exp2(middle - odds(around).clamp(-10.0, 10.0)));
            let local = 2.0 * (0.6 * (1.0 - bright) * (1.0 - bright) - 0.8 * bright * bright);
            let slope = libm::exp2(-0.3);
            for (before, after) in light.iter().zip(adjusted(&options, Some(around), &light)) {
                let y = luminance(*before);
                let power = libm::exp2(middle + slope * (odds(y) + local - middle) + 0.7);
                let ratio = power / (1.0 + power) / f64::from(y);
                let expected = before.map(|c| f64::from(c) * ratio);
                if expected.iter().all(|&c| c <= 1.0) {
                    let off = expected.iter().zip(after).map(|(a, b)| (a - f64::from(b)).abs()).fold(0.0, f64::max);
                    assert!(off < 3e-5, "{around} {before:?}: {after:?} for {expected:?}");
                }
            }
        }
    }

    #[test]
    fn brightness_is_reversible_and_keeps_black_and_white() {
        let light = ramp();
        for stops in [0.5, 2.0, 5.0] {
            let there = adjusted(&of(|o| o.brightness = -stops), None, &light);
            let back = adjusted(&of(|o| o.brightness = stops), None, &there);
            for (a, b) in light.iter().zip(&back) {
                assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-4 + 1e-3 * a[c]), "{stops}: {a:?} {b:?}");
            }
        }
        for end in [-1.0, 1.0] {
            for options in [
                of(|o| o.brightness = 5.0 * end),
                of(|o| o.contrast = 100.0 * end),
                of(|o| (o.shadows, o.highlights) = (100.0 * end, 100.0 * end)),
                of(|o| o.saturation = 100.0 * end),
            ] {
                for around in [0.0, 0.3, 1.0] {
                    let ends = adjusted(&options, Some(around), &[[0.0; 3], [1.0; 3]]);
                    let mut codes = Vec::<[u8; 3]>::new();
                    encoded(&Encoder::default(), &ends, &mut codes);
                    assert_eq!(codes, [[0; 3], [255; 3]], "{options:?} {around}: {ends:?}");
                }
            }
        }
    }

    /// Of two uniform surfaces, the brighter one stays brighter at the extremes of all options.
    #[test]
    fn even_surfaces_keep_their_order_at_the_extremes() {
        for bits in 0..32 {
            let sign = |i: usize| if bits >> i & 1 == 1 { 1.0 } else { -1.0 };
            let options = of(|o| {
                (o.brightness, o.contrast) = (5.0 * sign(0), 100.0 * sign(1));
                (o.shadows, o.highlights, o.saturation) = (100.0 * sign(2), 100.0 * sign(3), 100.0 * sign(4));
            });
            let mut last = -1.0;
            for i in 0..400 {
                let y = libm::exp2f(-14.0 + i as f32 / 400.0 * 13.99);
                let [after, ..] = adjusted(&options, Some(y), &[[y; 3]])[0];
                assert!(after >= last - 1e-6, "{options:?} {y}: {after} after {last}");
                last = after;
            }
        }
    }

    #[test]
    fn saturation_is_times_the_chroma_at_the_same_hue() {
        let light = ramp();
        for (saturation, times) in [(-100.0, 0.0), (-50.0, 0.5), (40.0, 1.4), (100.0, 2.0)] {
            let after = adjusted(&of(|o| o.saturation = saturation), None, &light);
            for (before, after) in light.iter().zip(&after) {
                let ([l, a, b], [m, c, d]) = (oklab::from_linear(*before), oklab::from_linear(*after));
                if after.iter().all(|&v| v < 0.99) {
                    assert!((l - m).abs() < 1e-3, "{before:?} {after:?}");
                    assert!((c - times * a).abs() < 2e-3 && (d - times * b).abs() < 2e-3, "{before:?} {after:?}");
                }
            }
        }
        // Colours outside the gamut are desaturated, and no channel clips.
        let red = adjusted(&of(|o| o.saturation = 100.0), None, &[[0.9, 0.1, 0.1]])[0];
        let hue = |rgb| {
            let [_, a, b] = oklab::from_linear(rgb);
            libm::atan2f(b, a)
        };
        assert!((hue(red) - hue([0.9, 0.1, 0.1])).abs() < 0.02, "{red:?}");
    }

    #[test]
    fn light_shown_as_white_becomes_grey_of_the_same_luminance() {
        let lamp = Light { kelvin: 3400.0, tint: 12.0 };
        for colours in [Colours::Srgb, Colours::DisplayP3, Colours::AdobeRgb] {
            let encoder = Encoder::of(colours);
            let adjusted = Adjusted::new(&Options::default(), colours, Some(lamp), None, 3).unwrap();
            let [x, y] = lamp.xy();
            let xyz = nalgebra::Vector3::new(x / y, 1.0, (1.0 - x - y) / y);
            let card = colours.primaries().to_xyz().unwrap().try_inverse().unwrap() * xyz * 0.3;
            let card = [card.x as f32, card.y as f32, card.z as f32];
            let mut out = [[0.0f32; 3]; 3];
            adjusted.row(&encoder, 0, &[card, [1.0; 3], [0.0; 3]], &mut out);
            assert!(out[0].iter().all(|c| (c - 0.3).abs() < 2e-3), "{colours:?}: {card:?} {:?}", out[0]);
            assert!(out[1].iter().all(|c| *c > 0.999) && out[2].iter().all(|c| *c < 1e-6), "{colours:?}: {out:?}");
        }
        let asked = of(|o| o.white_balance = WhiteBalance::Light(lamp));
        assert!(Adjusted::new(&asked, Colours::Srgb, None, None, 3).is_none(), "it was radiance");
    }

    /// A dark room beside a bright window, both with texture: each changes as a whole, its texture keeps its contrast,
    /// and there is no halo at the edge between them.
    #[test]
    fn places_are_changed_with_their_texture_and_without_halos() {
        let (width, side) = (600, 6);
        let texture = |x: usize| -> f32 { if (x / 2).is_multiple_of(2) { 1.12 } else { 1.0 / 1.12 } };
        let at = |x: usize| texture(x) * if x < 300 { 0.02 } else { 0.75 };
        let cells = Plane::from_rows(width / side, 40, |_, row| {
            row.iter_mut().enumerate().for_each(|(x, cell)| *cell = at(x * side + 1).min(at(x * side + 3)) * 1.12);
        });
        let light: Vec<[f32; 3]> = (0..width).map(|x| [at(x); 3]).collect();
        let options = of(|o| (o.shadows, o.highlights) = (100.0, -100.0));
        let adjusted = Adjusted::new(&options, Colours::Srgb, None, Some((cells, side)), width).unwrap();
        let mut out = vec![[0.0f32; 3]; width];
        adjusted.row(&Encoder::default(), 100, &light, &mut out);
        let moved: Vec<f64> = (0..width).map(|x| odds(out[x][1]) - odds(light[x][1])).collect();
        let mean = |xs: std::ops::Range<usize>| xs.clone().map(|x| moved[x]).sum::<f64>() / xs.len() as f64;
        let (dark, bright) = (mean(100..160), mean(440..500));
        assert!(dark > 1.2 && bright < -0.9, "{dark} {bright}");
        for x in 0..width {
            let off = moved[x] - if x < 300 { dark } else { bright };
            assert!(off.abs() < 0.2, "{x}: {off}");
        }
        let contrast = |of: &[[f32; 3]], x: usize| odds(of[x][1]) - odds(of[x + 2][1]);
        for x in [100, 140, 440, 480] {
            let kept = contrast(&out, x) / contrast(&light, x);
            assert!((0.9..=1.02).contains(&kept), "{x}: {kept}");
        }
    }
}
