//! Reinhard's photographic operator: a global tone curve, or a local one by dodging and burning.
//!
//! In: a scene. Out: its tones. Cost: nothing per cell for the global curve; 0.4 us per cell for the local one. Source:
//! Reinhard, Stark, Shirley, Ferwerda, "Photographic Tone Reproduction for Digital Images" (2002), section 3.1,
//! equations 1 to 4, and 3.2, equations 5 to 9; Reinhard, "Parameter Estimation for Photographic Tone Reproduction"
//! (2003), equations 4 and 5.

use crate::plane::Plane;
use crate::pyramid::gaussian;
use crate::tonemap::guide::Guide;
use crate::tonemap::overview::Scene;
use crate::tonemap::settings::Setting;
use crate::tonemap::tones::{Curve, Tones};

/// Settings of both operators. By default, `key` and `white` are estimated from the picture; the local operator uses
/// the key 0.18.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// The key a, about 0.18: equation 2 scales luminances so that the log-average luminance of the scene becomes a.
    /// `None`: estimated by the global operator, 0.18 for the local one.
    pub key: Option<f64>,
    /// L_white: smallest luminance that maps to white, in units of the scaled luminance of equation 2. `None`:
    /// estimated.
    pub white: Option<f64>,
    /// Factor on the saturation that Mantiuk's colour correction gives (see `tones`): 1 looks as colourful as the
    /// scene, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { key: None, white: None, saturation: 1.0 }
    }
}

impl Options {
    /// Returns the settings, each with its name, range and description.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::estimated(
                "key",
                (0.01, 2.0),
                &mut self.key,
                "luminance to which the average of the scene (geometric mean) is scaled; a luminance of 1 becomes about half of white",
            ),
            Setting::estimated(
                "white",
                (0.1, 1e6),
                &mut self.white,
                "smallest luminance that becomes white; in its unit, the average of the scene is `key`",
            ),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// The tone curve with its parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shoulder {
    /// log2 of (key / log-average luminance). Added to log2 luminance, it gives log2 of the scaled luminance L of
    /// equation 2.
    shift: f64,
    /// 1 / L_white^2.
    inverse_white2: f64,
}

impl Shoulder {
    fn of(scene: &Scene, options: &Options) -> Self {
        // The 1st and the 99th percentile of log2 luminance, and the mean of log2 luminance (equation 1) with values
        // clamped to these percentiles.
        let ends = (scene.percentile(0.01), scene.percentile(0.99));
        let average = scene.average_within(ends);
        let key = options.key.unwrap_or_else(|| key(average, ends).clamp(KEYS.0, KEYS.1));
        let white = options.white.unwrap_or_else(|| white(average, ends, key));
        Shoulder { shift: libm::log2(key) - average, inverse_white2: 1.0 / (white * white) }
    }

    /// Returns equation 4: L_d = L (1 + L / L_white^2) / (1 + L).
    fn display(&self, l: f64) -> f64 {
        l * (1.0 + l * self.inverse_white2) / (1.0 + l)
    }

    /// Returns the slope of the curve on logarithmic axes.
    fn slope(&self, l: f64) -> f64 {
        let w = l * self.inverse_white2;
        1.0 + w / (1.0 + w) - l / (1.0 + l)
    }
}

/// Range of estimated keys. Without this limit, a few lamps would make a plain room too dark, and fog would become too
/// bright.
const KEYS: (f64, f64) = (0.15, 0.45);

/// Returns a by equation 4 of Reinhard 2003: a = 0.18 * 4^((2 log L_av - log L_min - log L_max) / (log L_max - log
/// L_min)).
fn key(average: f64, (dark, bright): (f64, f64)) -> f64 {
    let skew = (2.0 * average - dark - bright) / (bright - dark).max(1.0);
    0.18 * libm::exp2(2.0 * skew)
}

/// Returns L_white by equation 5 of Reinhard 2003: L_white = 1.5 * 2^(log L_max - log L_min - 5). It is limited to
/// between one and two times the scaled luminance of the bright end of the scene: so the bright end is not clipped, and
/// the picture still has nearly white parts. It is also at least 1.
fn white(average: f64, (dark, bright): (f64, f64), key: f64) -> f64 {
    let estimate = 1.5 * libm::exp2(bright - dark - 5.0);
    let brightest = key * libm::exp2(bright - average);
    estimate.min(2.0 * brightest).max(brightest).max(1.0)
}

/// Returns the tones of `scene` by one global curve.
pub fn global(scene: &Scene, options: &Options) -> Tones {
    let shoulder = Shoulder::of(scene, options);
    let curve = Curve::new(|v| shoulder.display(libm::exp2(v)), |v| shoulder.slope(libm::exp2(v)), options.saturation);
    Tones::new(scene.to_srgb, Guide::shifted(shoulder.shift), curve, scene.size.0)
}

/// Largest number of cells of the local operator. The paper gives the scales in pixels, for pictures with about this
/// number of pixels.
const CELLS: usize = 1 << 19;

/// Scaled luminances are limited to this many stops below and above 1, so that their squares do not overflow.
const FARTHEST: f32 = 60.0;

/// Number of scales (section 3.2); the smallest scale is 1 cell.
const SCALES: usize = 8;
/// Ratio of each scale to the one before (section 3.2).
const RATIO: f64 = 1.6;
/// Size of the centre divided by the scale: 1 / (2 sqrt 2) (section 3.2).
const CENTRE: f64 = 0.353_553_390_593_273_8;
/// The sharpening phi (section 3.2).
const PHI: f64 = 8.0;
/// Centre and surround count as similar if their relative difference is below this value (section 3.2).
const THRESHOLD: f32 = 0.05;

/// Returns the tones of `scene` by dodging and burning: the curve of each cell depends on the luminance around the
/// cell, up to the nearest edge.
pub fn local(scene: &Scene, options: &Options) -> Tones {
    let scene = scene.coarser(CELLS);
    let key = options.key.unwrap_or(0.18);
    let shoulder = Shoulder::of(&scene, &Options { key: Some(key), ..options.clone() });
    let (width, height) = (scene.logs.width(), scene.logs.height());
    let scaled = Plane::from_rows(width, height, |y, row| {
        for (l, &log) in row.iter_mut().zip(scene.logs.row(y)) {
            *l = libm::exp2f((log + shoulder.shift as f32).clamp(-FARTHEST, FARTHEST));
        }
    });
    let around = surroundings(&scaled, key);
    // Equation 9 with the white of equation 4. Tones are stored as log2, which can be interpolated.
    let inverse_white2 = shoulder.inverse_white2 as f32;
    let tones = Plane::from_rows(width, height, |y, row| {
        for ((v, &l), &a) in row.iter_mut().zip(scaled.row(y)).zip(around.row(y)) {
            *v = libm::log2f(l * (1.0 + l * inverse_white2) / (1.0 + a));
        }
    });
    let guide = Guide::fitted(&scene.logs, &tones, scene.side, 1.0);
    // The contrast that remains of large structures: the slope of L_d = L / (1 + L) (equation 3) on logarithmic axes is
    // 1 - L_d.
    let slope = |v: f64| 1.0 - libm::exp2(v).min(0.99);
    let curve = Curve::new(libm::exp2, slope, options.saturation);
    Tones::new(scene.to_srgb, guide, curve, scene.size.0)
}

/// Returns V_1 of equation 9: for each cell, `l` blurred at the largest scale for which centre and surround are similar
/// at this scale and at all smaller ones.
fn surroundings(l: &Plane<f32>, key: f64) -> Plane<f32> {
    let blurred = |scale: f64| gaussian(l, CENTRE * scale / std::f64::consts::SQRT_2);
    let (width, height) = (l.width(), l.height());
    let mut scale = 1.0;
    let mut centre = blurred(scale);
    let mut chosen = centre.clone();
    let mut open = Plane::filled(width, height, true);
    for _ in 0..SCALES {
        // The surround of one scale is the centre of the next scale.
        let surround = blurred(scale * RATIO);
        let sharpened = (libm::exp2(PHI) * key / (scale * scale)) as f32;
        for y in 0..height {
            let (centre, surround) = (centre.row(y), surround.row(y));
            for (x, (open, chosen)) in open.row_mut(y).iter_mut().zip(chosen.row_mut(y)).enumerate() {
                let activity = (centre[x] - surround[x]) / (sharpened + centre[x]);
                *open &= activity.abs() < THRESHOLD;
                if *open {
                    *chosen = centre[x];
                }
            }
        }
        scale *= RATIO;
        centre = surround;
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;
    use crate::tonemap::overview::Overview;

    /// Returns a test picture: a ramp of ten stops from left to right. `change` may replace the value of a pixel.
    fn ramp(factor: f32, change: impl Fn(usize, usize) -> Option<f32> + Sync) -> Plane<[f32; 3]> {
        Plane::from_rows(500, 70, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let l = factor * libm::exp2f(x as f32 / 50.0) * (1.0 + y as f32 / 1000.0);
                *p = change(x, y).map_or([l, 0.8 * l, 0.6 * l], |v| [v; 3]);
            }
        })
    }

    fn picture(map: &Plane<[f32; 3]>, tones: fn(&Scene, &Options) -> Tones) -> Plane<[u8; 3]> {
        let mut overview = Overview::new((map.width(), map.height()), &Primaries::SRGB);
        overview.see(0, map);
        tones(&overview.scene().unwrap(), &Options::default()).picture(map)
    }

    #[test]
    fn a_factor_does_not_matter_and_brighter_is_brighter() {
        for tones in [global, local] {
            let one = picture(&ramp(1.0, |_, _| None), tones);
            let other = picture(&ramp(1.0 / 1024.0, |_, _| None), tones);
            // Logarithms of values that differ by a factor round differently, so code values may differ by 1.
            let differ = one.as_slice().iter().zip(other.as_slice());
            assert!(differ.into_iter().all(|(p, q)| (0..3).all(|c| p[c].abs_diff(q[c]) <= 1)));
            let row = one.row(10);
            assert!(row.windows(2).all(|w| (0..3).all(|c| w[0][c] <= w[1][c] + 1)), "monotone");
            assert!(row[0][1] < 70 && row[499][1] > 200, "{:?} {:?}", row[0], row[499]);
        }
    }

    /// A quarter of a percent of the pixels are suns, and half a percent are black. They must not change the other
    /// pixels by more than 3 code values.
    #[test]
    fn a_few_suns_and_black_pixels_do_not_decide() {
        let plain = picture(&ramp(1.0, |_, _| None), global);
        let other = picture(&ramp(1.0, |x, y| [1e9, 1e-9, 0.0].get((x * 70 + y) % 400).copied()), global);
        for (i, (p, q)) in plain.as_slice().iter().zip(other.as_slice()).enumerate() {
            if (i % 500 * 70 + i / 500) % 400 > 2 {
                assert!((0..3).all(|c| p[c].abs_diff(q[c]) <= 3), "{p:?} {q:?}");
            }
        }
    }

    /// Texture on the bright side of an edge keeps more contrast with dodging and burning than with the global curve.
    #[test]
    fn local_contrast_is_kept_in_the_light() {
        let textured = |x: usize, y: usize| {
            let (bright, wave) = (x > 250, if (x / 2 + y / 2).is_multiple_of(2) { 1.15 } else { 0.87 });
            Some(if bright { 200.0 * wave } else { 0.5 })
        };
        let map = ramp(1.0, textured);
        let contrast = |tones| {
            let codes = picture(&map, tones);
            let row = &codes.row(35)[300..400];
            let values: Vec<f64> =
                row.iter().map(|p| crate::bracket::colour::srgb_to_linear(f64::from(p[1]) / 255.0)).collect();
            values.iter().copied().fold(0.0, f64::max) / values.iter().copied().fold(1.0, f64::min)
        };
        let (one, each) = (contrast(global), contrast(local));
        assert!(each > 1.02 * one, "{one} {each}");
    }

    #[test]
    fn the_key_follows_the_tone() {
        let at = |average| key(average, (-5.0, 5.0));
        // By equation 4, the key is 0.18 for an average in the middle of the range, 4 times that at the bright end, and
        // a quarter of that at the dark end.
        assert!((at(0.0) - 0.18).abs() < 1e-12 && (at(5.0) - 0.72).abs() < 1e-12 && (at(-5.0) - 0.045).abs() < 1e-12);
    }
}
