//! Gradient domain compression: attenuates steep gradients at every scale, keeps gentle ones, and integrates the
//! result.
//!
//! In: a scene. Out: its tones. Cost: 1 us of core time per cell; 0.2 s for the largest grid (`log_range::CELLS`
//! cells). Source: Fattal, Lischinski, Werman, "Gradient Domain High Dynamic Range Compression" (2002), section 3,
//! equations 3 to 6 (integration), and section 4 (attenuation).

use crate::plane::{Plane, fold_bands};
use crate::pyramid::burt_adelson::{expand, gaussian_pyramid};
use crate::tonemap::overview::Scene;
use crate::tonemap::settings::Setting;
use crate::tonemap::solvers::log_range::LogRange;
use crate::tonemap::solvers::poisson::integrated;
use crate::tonemap::tones::Tones;

/// Settings of the operator.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// Gradients above this multiple of the mean gradient of their scale are attenuated according to `beta`. The paper
    /// uses 0.1, which attenuates most of the picture.
    pub alpha: f64,
    /// Exponent of (gradient / alpha) at every scale; 1 changes nothing. The paper uses 0.8 to 0.9.
    pub beta: f64,
    /// Gradients below this multiple of the mean gradient count as noise. They get the same factor as a gradient at
    /// this limit. The paper has no such limit and so amplifies the noise of skies.
    pub noise: f64,
    /// Stops from black to white on the display.
    pub range_stops: f64,
    /// Target for the mean code value of the picture, 0 to 1; it is not always reached.
    pub brightness: f64,
    /// Factor on the saturation that Mantiuk's colour correction gives (see `tones`): 1 looks as colourful as the
    /// scene, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { alpha: 1.0, beta: 0.85, noise: 1.0, range_stops: 6.0, brightness: 0.43, saturation: 1.0 }
    }
}

impl Options {
    /// Returns the settings, each with its name, range and description.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::number(
                "alpha",
                (0.01, 3.0),
                &mut self.alpha,
                "gradients (edges) stronger than this are weakened according to beta; 1 is the mean gradient",
            ),
            Setting::number(
                "beta",
                (0.6, 1.0),
                &mut self.beta,
                "1 changes nothing; smaller values weaken strong contrasts more (exponent of gradient / alpha)",
            ),
            Setting::number(
                "noise",
                (0.0, 3.0),
                &mut self.noise,
                "gradients up to this count as noise; 1 is the mean gradient of each scale",
            ),
            Setting::range(&mut self.range_stops),
            Setting::brightness(&mut self.brightness),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// The coarsest scale has a shorter side of at least this many cells (section 4), unless the picture is smaller.
const COARSEST: usize = 32;

/// Returns the tones of `scene`.
pub fn fattal(scene: &Scene, options: &Options) -> Tones {
    let range = LogRange { stops: options.range_stops, brightness: options.brightness, saturation: options.saturation };
    range.tones(scene, |logs| compressed(logs, options))
}

/// Returns `logs` with attenuated gradients.
fn compressed(logs: &Plane<f32>, options: &Options) -> Plane<f32> {
    let kept = attenuation(logs, options);
    let (width, height) = (logs.width(), logs.height());
    // Equation 4, with forward differences as in section 3. A difference lies between two cells, so its factor is the
    // mean of the factors of these cells.
    let right = Plane::from_rows(width, height, |y, row| {
        let (l, k) = (logs.row(y), kept.row(y));
        for x in 0..width - 1 {
            row[x] = (l[x + 1] - l[x]) * 0.5 * (k[x] + k[x + 1]);
        }
    });
    let down = Plane::from_rows(width, height, |y, row| {
        let below = (y + 1).min(height - 1);
        for (x, d) in row.iter_mut().enumerate() {
            *d = (logs.at(x, below) - logs.at(x, y)) * 0.5 * (kept.at(x, y) + kept.at(x, below));
        }
    });
    integrated(&right, &down)
}

/// Returns Phi of section 4: for each cell the factor on its gradient, which is the product of the factors at all
/// scales.
fn attenuation(logs: &Plane<f32>, options: &Options) -> Plane<f32> {
    let mut levels = 1;
    while (logs.width().min(logs.height()) >> levels) >= COARSEST {
        levels += 1;
    }
    let pyramid = gaussian_pyramid(logs.clone(), levels);
    let mut product: Option<Plane<f32>> = None;
    for level in pyramid.iter().rev() {
        let size = (level.width(), level.height());
        let mut scale = scaling(&steepness(level), options);
        if let Some(coarser) = product {
            let coarser = expand(&coarser, size);
            scale.as_mut_slice().iter_mut().zip(coarser.as_slice()).for_each(|(s, c)| *s *= c);
        }
        product = Some(scale);
    }
    product.unwrap_or_else(|| Plane::filled(logs.width(), logs.height(), 1.0))
}

/// Returns the length of the gradient by central differences. The paper also divides by the cell width of the scale.
/// Here this division would cancel, because gradients are only compared with the mean of their scale.
fn steepness(level: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (level.width(), level.height());
    Plane::from_rows(width, height, |y, row| {
        let (above, below) = (level.row(y.saturating_sub(1)), level.row((y + 1).min(height - 1)));
        let here = level.row(y);
        for (x, g) in row.iter_mut().enumerate() {
            let across = 0.5 * (here[(x + 1).min(width - 1)] - here[x.saturating_sub(1)]);
            let down = 0.5 * (below[x] - above[x]);
            *g = (across * across + down * down).sqrt();
        }
    })
}

/// Returns phi_k of section 4, the factor at one scale: (alpha / g) (g / alpha)^beta. The gradient g is raised to at
/// least the noise limit.
fn scaling(steepness: &Plane<f32>, options: &Options) -> Plane<f32> {
    let (width, height) = (steepness.width(), steepness.height());
    let of_band = |rows| steepness.rows(rows).iter().map(|&g| f64::from(g)).sum::<f64>();
    let mean = fold_bands(height, of_band, 0.0, |sum, s| sum + s) / (width * height) as f64;
    let (alpha, noise) = ((options.alpha * mean).max(1e-9), (options.noise * mean) as f32);
    let (inverse, power) = ((1.0 / alpha) as f32, (options.beta - 1.0) as f32);
    Plane::from_rows(width, height, |y, row| {
        for (s, &g) in row.iter_mut().zip(steepness.row(y)) {
            let relative = (g.max(noise) * inverse).max(1e-3);
            *s = libm::exp2f(power * libm::log2f(relative));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;
    use crate::tonemap::overview::Overview;

    fn picture(map: &Plane<[f32; 3]>, options: &Options) -> Plane<[u8; 3]> {
        let mut overview = Overview::new((map.width(), map.height()), &Primaries::SRGB);
        overview.see(0, map);
        fattal(&overview.scene().unwrap(), options).picture(map)
    }

    /// Returns the log2 luminance of two textured halves; the right one is six stops brighter.
    fn logs(width: usize, height: usize) -> Plane<f32> {
        Plane::from_rows(width, height, |y, row| {
            for (x, l) in row.iter_mut().enumerate() {
                let wave = 0.3 * ((x as f32 * 0.9).sin() + (y as f32 * 0.7).cos());
                *l = if x > width / 2 { 6.0 } else { 0.0 } + wave;
            }
        })
    }

    fn radiance(logs: &Plane<f32>, factor: f32) -> Plane<[f32; 3]> {
        let pixels = logs.as_slice().iter().map(|&l| [1.0, 0.8, 0.6].map(|c| c * factor * libm::exp2f(l)));
        Plane::from_vec(logs.width(), logs.height(), pixels.collect())
    }

    /// With beta = 1 every gradient is kept, so the picture is recovered up to its mean. The solver's error is 1e-4 of
    /// the range of six stops.
    #[test]
    fn fattal_without_attenuation_changes_nothing() {
        let logs = logs(150, 90);
        let same = compressed(&logs, &Options { beta: 1.0, ..Options::default() });
        let shift = logs.at(0, 0) - same.at(0, 0);
        assert!(logs.as_slice().iter().zip(same.as_slice()).all(|(a, b)| (a - b - shift).abs() < 0.01));
    }

    /// The factors are compared with the paper's phi for one scale.
    #[test]
    fn gradients_are_scaled_as_the_paper_has_it() {
        let steepness = Plane::from_vec(4, 2, vec![0.01f32, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 0.0]);
        let mean = 6.31 / 8.0;
        let options = Options { alpha: 0.1, beta: 0.85, noise: 0.05, ..Options::default() };
        let (scale, alpha) = (scaling(&steepness, &options), 0.1 * mean);
        for (s, &g) in scale.as_slice().iter().zip(steepness.as_slice()) {
            let g = f64::from(g).max(0.05 * mean);
            assert!((f64::from(*s) - alpha / g * (g / alpha).powf(0.85)).abs() < 1e-5);
        }
    }

    /// The edge shrinks more than the texture. The smaller beta is, the more the edge shrinks compared with the
    /// texture.
    #[test]
    fn edges_shrink_more_than_texture() {
        let before = logs(200, 120);
        let swing = |p: &Plane<f32>| {
            let row = &p.row(60)[20..60];
            row.iter().fold(f32::MIN, |a, &v| a.max(v)) - row.iter().fold(f32::MAX, |a, &v| a.min(v))
        };
        let edge = |p: &Plane<f32>| {
            let mean =
                |range: std::ops::Range<usize>| p.row(60)[range.clone()].iter().sum::<f32>() / range.len() as f32;
            mean(106..120) - mean(80..94)
        };
        let mut last = 1.0;
        for beta in [0.95, 0.87, 0.8] {
            let after = compressed(&before, &Options { beta, ..Options::default() });
            let relative = edge(&after) / edge(&before) / (swing(&after) / swing(&before));
            assert!(relative > 0.05 && relative < 0.9 * last, "{beta}: {relative} {last}");
            last = relative;
        }
    }

    #[test]
    fn a_factor_does_not_matter() {
        let logs = logs(120, 80);
        let one = picture(&radiance(&logs, 1.0), &Options::default());
        let other = picture(&radiance(&logs, 1.0 / 4096.0), &Options::default());
        let pairs = one.as_slice().iter().zip(other.as_slice());
        assert!(pairs.into_iter().all(|(p, q)| (0..3).all(|c| p[c].abs_diff(q[c]) <= 1)));
    }

    #[test]
    fn uniform_pictures_stay_uniform_at_any_size() {
        for (width, height) in [(1, 1), (2, 3), (1, 50), (70, 70)] {
            let flat = picture(&Plane::filled(width, height, [0.3; 3]), &Options::default());
            assert!(flat.as_slice().iter().all(|p| *p == flat.at(0, 0)), "{width}x{height}");
            assert!(flat.at(0, 0)[0] > 80, "{:?}", flat.at(0, 0));
        }
        let three = picture(&radiance(&logs(3, 2), 1.0), &Options::default());
        assert!(three.at(2, 1)[1] > three.at(0, 1)[1]);
    }

    #[test]
    fn options_have_their_documented_effect() {
        let map = radiance(&logs(120, 80), 1.0);
        let mean = |options: &Options| {
            let picture = picture(&map, options);
            picture.as_slice().iter().map(|p| f64::from(p[1])).sum::<f64>() / (120.0 * 80.0)
        };
        let plain = Options::default();
        let bright = mean(&Options { brightness: 0.6, ..plain.clone() });
        assert!(bright > mean(&plain) + 10.0);
        let grey = picture(&map, &Options { saturation: 0.0, ..plain.clone() });
        assert!(grey.as_slice().iter().all(|p| p[0].abs_diff(p[2]) <= 1));
        let darkest = |options: &Options| picture(&map, options).as_slice().iter().filter(|p| p[1] < 40).count();
        assert!(darkest(&Options { range_stops: 10.0, ..plain.clone() }) != darkest(&plain));
    }
}
