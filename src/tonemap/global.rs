//! Reinhard's global operator: one curve for all pixels, its parameters from the picture itself.
//!
//! In: radiance. Out: a picture. Cost: 20 ns a pixel and core, the statistics of a sample included.
//! Source: Reinhard, Stark, Shirley, Ferwerda, "Photographic Tone Reproduction for Digital Images" (2002), section 3.1, equations 1 to 4;
//! Reinhard, "Parameter Estimation for Photographic Tone Reproduction" (2003), equations 4 and 5; Mantiuk, Tomaszewska, Heidrich,
//! "Color Correction for Tone Mapping" (2009), equations 3 and 5.

use super::DisplayImage;
use super::display::{Encoder, ToSrgb, into_gamut, luminance};
use crate::bracket::colour::Primaries;
use crate::merge::RadianceMap;
use crate::plane::{Plane, map_bands};
use crate::simd::{Loops, vectorised};

/// What may be set; by default the picture decides.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// The key a: the display luminance (0..1, before the shoulder) of the log-average; about 0.18. `None`: estimated.
    pub key: Option<f64>,
    /// L_white: the smallest luminance that becomes white, in units of the scaled luminance of equation 2. `None`: estimated.
    pub white: Option<f64>,
    /// Times the saturation that Mantiuk's fit gives: 1 looks as colourful as the scene, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { key: None, white: None, saturation: 1.0 }
    }
}

/// What of the scene's luminances decides the curve: log2 of luminance.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Statistics {
    /// The mean of the logarithms (equation 1), those beyond the ends counted as the ends.
    average: f64,
    /// The end below which lies one percent.
    dark: f64,
    /// The end above which lies one percent.
    bright: f64,
}

/// Samples that are enough: percentiles within a tenth of a percent.
const SAMPLES: usize = 1 << 18;

/// A scene as it is seen from top to bottom: the luminances of all pixels, or of every n-th of every n-th row where there are more than
/// enough.
#[derive(Debug, Clone)]
pub struct Scene {
    to_srgb: ToSrgb,
    step: usize,
    /// log2.
    luminances: Vec<f32>,
}

impl Scene {
    /// One of `width` x `height` pixels of which nothing was seen yet.
    pub fn new((width, height): (usize, usize), primaries: &Primaries) -> Self {
        let mut step = 1;
        while (width / step) * (height / step) > SAMPLES {
            step += 1;
        }
        Scene { to_srgb: ToSrgb::from(primaries), step, luminances: Vec::new() }
    }

    /// Sees the rows `pixels`, which begin with row `first`.
    pub fn see(&mut self, first: usize, pixels: &Plane<[f32; 3]>) {
        let (step, to_srgb) = (self.step, self.to_srgb);
        let logs = |rows: std::ops::Range<usize>| -> Vec<f32> {
            rows.filter(|y| (first + y).is_multiple_of(step))
                .flat_map(|y| pixels.row(y).iter().step_by(step))
                .map(|&p| luminance(to_srgb.apply(p)))
                .filter(|l| *l > 0.0 && l.is_finite())
                .map(libm::log2f)
                .collect()
        };
        for band in map_bands(pixels.height(), logs) {
            self.luminances.extend(band);
        }
    }

    /// `None` for a picture without light.
    fn statistics(mut self) -> Option<Statistics> {
        let logs = &mut self.luminances;
        logs.sort_unstable_by(f32::total_cmp);
        let last = logs.len().checked_sub(1)?;
        let (dark, bright) = (logs[last / 100], logs[last - last / 100]);
        let sum: f64 = logs.iter().map(|&l| f64::from(l.clamp(dark, bright))).sum();
        Some(Statistics { average: sum / logs.len() as f64, dark: dark.into(), bright: bright.into() })
    }
}

/// The curve, with its parameters settled: rows can be mapped as they come.
#[derive(Debug, Clone)]
pub struct Curve {
    to_srgb: ToSrgb,
    /// a / log-average: from radiance to the scaled luminance L of equation 2.
    scale: f32,
    /// 1 / L_white^2.
    inverse_white2: f32,
    /// Saturation by scaled luminance: see [`saturation_cell`].
    saturation: Vec<f32>,
}

impl Curve {
    /// Settles the parameters for `radiance`.
    pub fn estimate(radiance: &RadianceMap, options: &Options) -> Self {
        let mut scene = Scene::new((radiance.pixels.width(), radiance.pixels.height()), &radiance.primaries);
        scene.see(0, &radiance.pixels);
        Self::settled(scene, options)
    }

    /// Settles the parameters for `scene`, all of which was seen.
    pub fn settled(scene: Scene, options: &Options) -> Self {
        let to_srgb = scene.to_srgb;
        let none = Statistics { average: 0.0, dark: 0.0, bright: 0.0 };
        let scene = scene.statistics().unwrap_or(none);
        let key = options.key.unwrap_or_else(|| key(&scene).clamp(KEYS.0, KEYS.1));
        let white = options.white.unwrap_or_else(|| white(&scene, key));
        let inverse_white2 = 1.0 / (white * white);
        let saturation = (0..CELLS_PER_OCTAVE * OCTAVES)
            .map(|cell| (options.saturation * saturation(cell_luminance(cell), inverse_white2)) as f32)
            .collect();
        Curve {
            to_srgb,
            scale: (key * libm::exp2(-scene.average)) as f32,
            inverse_white2: inverse_white2 as f32,
            saturation,
        }
    }

    /// Maps `rows` of radiance to codes; both of one length.
    pub fn map(&self, rows: &[[f32; 3]], codes: &mut [[u8; 3]]) {
        vectorised(Mapped { curve: self, encoder: Encoder::new(), rows, codes });
    }

    /// Linear sRGB relative to display white, of as many pixels as are worked out side by side.
    #[inline(always)]
    fn pixels(&self, rgb: &mut [[f32; BLOCK]; 3]) {
        let [red, green, blue] = rgb;
        let (mut light, mut share) = ([0.0; BLOCK], [0.0; BLOCK]);
        for i in 0..BLOCK {
            let [r, g, b] = self.to_srgb.apply([red[i], green[i], blue[i]]).map(|c| c * self.scale);
            (red[i], green[i], blue[i]) = (r, g, b);
            light[i] = luminance([r, g, b]);
        }
        for i in 0..BLOCK {
            share[i] = self.saturation[saturation_cell(light[i])];
        }
        for i in 0..BLOCK {
            // Beyond any display; finite, so that what follows is.
            let l = if light[i] > 1e12 { 1e12 } else { light[i] };
            let display = shoulder(l, self.inverse_white2);
            // Mantiuk's equation 3: ((C / L - 1) s + 1) L_d.
            let ratio = display / l;
            let grey = display * (1.0 - share[i]);
            let toned = [red[i], green[i], blue[i]].map(|c| (c * ratio) * share[i] + grey);
            let [r, g, b] = into_gamut(toned, display);
            // Without light, or without a number, it is black.
            let is_lit = light[i] > 0.0;
            red[i] = if is_lit { r } else { 0.0 };
            green[i] = if is_lit { g } else { 0.0 };
            blue[i] = if is_lit { b } else { 0.0 };
        }
    }
}

/// Pixels that are worked out side by side.
const BLOCK: usize = 64;

/// Rows that are mapped to codes.
struct Mapped<'a> {
    curve: &'a Curve,
    encoder: Encoder,
    rows: &'a [[f32; 3]],
    codes: &'a mut [[u8; 3]],
}

impl Loops for Mapped<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let mut rgb = [[0.0f32; BLOCK]; 3];
        for (pixels, codes) in self.rows.chunks(BLOCK).zip(self.codes.chunks_mut(BLOCK)) {
            let [red, green, blue] = &mut rgb;
            for (((r, g), b), p) in red.iter_mut().zip(green).zip(blue).zip(pixels) {
                (*r, *g, *b) = (p[0], p[1], p[2]);
            }
            self.curve.pixels(&mut rgb);
            let encoded = rgb.each_ref().map(|channel| self.encoder.codes(channel));
            for (i, out) in codes.iter_mut().enumerate() {
                *out = [encoded[0][i], encoded[1][i], encoded[2][i]];
            }
        }
    }
}

/// Equation 4: L_d = L (1 + L / L_white^2) / (1 + L).
#[inline(always)]
fn shoulder(l: f32, inverse_white2: f32) -> f32 {
    l * (1.0 + l * inverse_white2) / (1.0 + l)
}

/// Estimates are kept in between: a few lamps in a plain room would otherwise have it darker than anyone remembers it, and fog brighter.
const KEYS: (f64, f64) = (0.15, 0.45);

/// Reinhard 2003, equation 4: a = 0.18 * 4^((2 log L_av - log L_min - log L_max) / (log L_max - log L_min)).
fn key(scene: &Statistics) -> f64 {
    let range = scene.bright - scene.dark;
    let skew = (2.0 * scene.average - scene.dark - scene.bright) / range.max(1.0);
    0.18 * libm::exp2(2.0 * skew)
}

/// Reinhard 2003, equation 5: L_white = 1.5 * 2^(log L_max - log L_min - 5). It is kept between the bright end as the key places
/// it, which must not burn out, and twice that, as nothing would be white otherwise; and is at least 1.
fn white(scene: &Statistics, key: f64) -> f64 {
    let estimate = 1.5 * libm::exp2(scene.bright - scene.dark - 5.0);
    let brightest = key * libm::exp2(scene.bright - scene.average);
    estimate.min(2.0 * brightest).max(brightest).max(1.0)
}

/// Mantiuk's equation 5 with the constants of the linear correction: s = (1 + k1) c^k2 / (1 + k1 c^k2), where c is the slope of the
/// curve in log-log, by which contrast is compressed at this luminance.
fn saturation(l: f64, inverse_white2: f64) -> f64 {
    const K1: f64 = 2.3892;
    const K2: f64 = 0.8552;
    let w = l * inverse_white2;
    let c = 1.0 + w / (1.0 + w) - l / (1.0 + l);
    let power = libm::pow(c.clamp(0.0, 1.0), K2);
    (1.0 + K1) * power / (1.0 + K1 * power)
}

/// The table of saturations goes by the exponent and the first bits of the mantissa of L: no logarithm, and steps of 1/64.
const CELLS_PER_OCTAVE: usize = 64;
const OCTAVES: usize = 48;
const FIRST_OCTAVE: i32 = -24;

/// The cell of `l`; that of the least where it is not positive.
#[inline(always)]
fn saturation_cell(l: f32) -> usize {
    let cell = (l.to_bits() >> 17) as i32 - ((127 + FIRST_OCTAVE) << 6);
    cell.clamp(0, (CELLS_PER_OCTAVE * OCTAVES) as i32 - 1) as usize
}

/// The luminance in the middle of a cell.
fn cell_luminance(cell: usize) -> f64 {
    let bits = (cell as u32 + ((127 + FIRST_OCTAVE) << 6) as u32) << 17 | 1 << 16;
    f32::from_bits(bits).into()
}

/// The picture of `radiance`.
pub fn reinhard(radiance: &RadianceMap, options: &Options) -> DisplayImage {
    let curve = Curve::estimate(radiance, options);
    let pixels = Plane::from_rows(radiance.pixels.width(), radiance.pixels.height(), |y, row| {
        curve.map(radiance.pixels.row(y), row);
    });
    DisplayImage { pixels }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;

    fn scene(width: usize, height: usize, value: impl Fn(usize, usize) -> [f32; 3] + Sync) -> RadianceMap {
        RadianceMap {
            pixels: Plane::from_rows(width, height, |y, row| {
                for (x, p) in row.iter_mut().enumerate() {
                    *p = value(x, y);
                }
            }),
            primaries: Primaries::SRGB,
        }
    }

    /// Ten stops from left to right, tinted.
    fn ramp(factor: f32) -> RadianceMap {
        scene(500, 70, |x, y| {
            let l = factor * libm::exp2f(x as f32 / 50.0) * (1.0 + y as f32 / 1000.0);
            [l, 0.8 * l, 0.6 * l]
        })
    }

    /// The chain as the papers print it, in doubles: equations 1 to 4, 3 and 5 of Mantiuk, the gamut, the transfer.
    fn textbook(map: &RadianceMap, curve: &Curve, key: f64, x: usize, y: usize) -> [f64; 3] {
        let rgb = map.pixels.at(x, y).map(f64::from);
        let weights = [0.2126, 0.7152, 0.0722];
        let lw: f64 = (0..3).map(|c| weights[c] * rgb[c]).sum();
        let mut scene = Scene::new((map.pixels.width(), map.pixels.height()), &map.primaries);
        scene.see(0, &map.pixels);
        let average = scene.statistics().unwrap().average;
        let l = key / libm::exp2(average) * lw;
        let inverse_white2 = f64::from(curve.inverse_white2);
        let ld = l * (1.0 + l * inverse_white2) / (1.0 + l);
        let s = saturation(l, inverse_white2);
        let linear = rgb.map(|c| ((c / lw - 1.0) * s + 1.0) * ld);
        into_gamut(linear.map(|c| c as f32), ld as f32).map(f64::from)
    }

    /// Between two cells s changes by less than 1/64 (its slope in ln L is below 1): half a cell is 1/128 at most, which moves a
    /// component by that part of its distance from grey, below 1/2: 0.004.
    #[test]
    fn pixels_are_those_of_the_papers() {
        let map = ramp(3.0);
        let options = Options { key: Some(0.18), ..Options::default() };
        let curve = Curve::estimate(&map, &options);
        for x in 0..500 {
            let mut rgb = map.pixels.at(x, 5).map(|c| [c; BLOCK]);
            curve.pixels(&mut rgb);
            let ours = rgb.map(|channel| channel[x % BLOCK]);
            let theirs = textbook(&map, &curve, 0.18, x, 5);
            for c in 0..3 {
                assert!((f64::from(ours[c]) - theirs[c]).abs() < 0.004, "{x}: {ours:?} {theirs:?}");
            }
        }
    }

    #[test]
    fn a_factor_does_not_matter_and_brighter_is_brighter() {
        let one = reinhard(&ramp(1.0), &Options::default());
        // Powers of two scale exactly; of others a rounding may go the other way.
        assert_eq!(one, reinhard(&ramp(1.0 / 1024.0), &Options::default()));
        let row = one.pixels.row(10);
        assert!(row.windows(2).all(|w| (0..3).all(|c| w[0][c] <= w[1][c])), "monotone");
        assert!(row[0][1] < 70 && row[499][1] > 200, "{:?} {:?}", row[0], row[499]);
    }

    /// Half a percent of suns and of black must not move the rest by more than a code.
    #[test]
    fn a_few_suns_and_black_pixels_do_not_decide() {
        let plain = reinhard(&ramp(1.0), &Options::default());
        let clean = ramp(1.0);
        let map = scene(500, 70, |x, y| match (x * 70 + y) % 400 {
            0 => [1e9; 3],
            1 => [1e-9; 3],
            2 => [0.0; 3],
            _ => clean.pixels.at(x, y),
        });
        let other = reinhard(&map, &Options::default());
        for (i, (p, q)) in plain.pixels.as_slice().iter().zip(other.pixels.as_slice()).enumerate() {
            if (i % 500 * 70 + i / 500) % 400 > 2 {
                assert!((0..3).all(|c| p[c].abs_diff(q[c]) <= 3), "{p:?} {q:?}");
            }
        }
    }

    #[test]
    fn without_light_it_is_black_and_nothing_fails() {
        for value in [0.0, f32::NAN, -1.0] {
            let black = reinhard(&scene(3, 3, |_, _| [value; 3]), &Options::default());
            assert!(black.pixels.as_slice().iter().all(|p| *p == [0; 3]), "{value}");
        }
        let grey = reinhard(&scene(9, 9, |_, _| [5.0; 3]), &Options::default());
        assert!(grey.pixels.as_slice().iter().all(|p| p[0] == p[1] && p[1] == p[2] && (90..200).contains(&p[0])));
        let bright = reinhard(&scene(9, 9, |_, _| [f32::MAX; 3]), &Options::default());
        assert!(bright.pixels.at(0, 0)[0] > 90);
    }

    #[test]
    fn the_codes_are_the_same_on_any_number_of_threads() {
        let map = scene(700, 64 * 12, |x, y| [(x * y % 97) as f32, x as f32, 0.01 * y as f32 + 0.1]);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| reinhard(&map, &Options::default()))
        };
        assert!(on(1) == on(2) && on(1) == on(7));
    }

    #[test]
    fn the_key_follows_the_tone() {
        let at = |average| key(&Statistics { average, dark: -5.0, bright: 5.0 });
        // In the middle 0.18; at an end a factor 4 from it, by equation 4.
        assert!((at(0.0) - 0.18).abs() < 1e-12 && (at(5.0) - 0.72).abs() < 1e-12 && (at(-5.0) - 0.045).abs() < 1e-12);
    }
}
