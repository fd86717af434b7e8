//! The operator of the house: edges held back without halos, the curve that distorts contrasts least, and the brightness of a photograph.
//!
//! In: a scene. Out: its tones. Cost: 0.1 us a cell, of which there are at most [`CELLS`]: 40 ms; a pixel two interpolations.
//! Source: `local_laplacian` (Paris et al. 2011, Aubry et al. 2014) for the large edges; `contrast_curve` (Eilertsen et al. 2015) for the rest;
//! Yeganeh & Wang, "Objective Quality Assessment of Tone-Mapped Images" (2013), section III-B, for the brightness and the local contrast that
//! three thousand photographs have.

use super::brightness;
use super::contrast_curve::ContrastCurve;
use super::guide::Guide;
use super::local_laplacian::{Remapping, local_laplacian};
use super::overview::Scene;
use super::settings::Setting;
use super::tones::{Curve, Tones};
use crate::bracket::colour::linear_to_srgb;
use crate::plane::Plane;
use rayon::prelude::*;

/// What may be set; the rest the picture decides.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// What an edge is higher than 1.3 stops is times this: 1 leaves all to the curve, 0 makes every region equally bright.
    pub edges: f64,
    /// Fine contrast: 1 as in the scene, above it raised.
    pub detail: f64,
    /// Stops from black to white on the display. `None`: those with which the picture has the local contrast of a photograph.
    pub range_stops: Option<f64>,
    /// The mean of the picture's code values, 0 to 1.
    pub brightness: f64,
    /// Times the saturation that Mantiuk's fit gives: 1 looks as colourful as the scene, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { edges: 0.5, detail: 1.25, range_stops: None, brightness: 0.44, saturation: 1.25 }
    }
}

impl Options {
    /// What may be set, by name.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::brightness(&mut self.brightness),
            Setting::number("detail", (0.5, 3.0), &mut self.detail, "times the fine contrast of the scene"),
            Setting::number("edges", (0.0, 1.0), &mut self.edges, "what is left of edges over 1.3 stops; 0 is flat"),
            Setting::estimated("range", (3.0, 12.0), &mut self.range_stops, "stops from black to white on the display"),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// Cells that edges are held back on.
pub const CELLS: usize = 1 << 18;

/// The parts of the tones that may be black, and white.
const ENDS: (f64, f64) = (0.002, 0.0005);

/// How many times the luminance of the darkest tone is taken for the veil that a display adds. It is taken off softly, so that what is darker still,
/// as thin lines are, keeps its drawing.
const VEIL: f64 = 1.3;

/// The share that a tone counts for at least: what hardly occurs keeps some of its drawing.
const FLOOR: f64 = 0.35;

/// How far the brightness of a picture may be brought to that asked for, as a power of luminance: a night stays darker than a day.
const POWERS: (f64, f64) = (0.7, 1.5);

/// The tones of `scene`.
pub fn natural(scene: &Scene, options: &Options) -> Tones {
    let grid = scene.coarser(CELLS);
    // What hardly has light would take levels of the filter, and decide nothing; it falls away below the rest as in the scene.
    let lit = grid.lit();
    let remapping = Remapping { edge: 1.3, detail: 1.0 / options.detail, range: options.edges, noise: 0.05 };
    let mut tones = local_laplacian(&lit, &remapping);
    for (v, (l, lit)) in tones.as_mut_slice().iter_mut().zip(grid.logs.as_slice().iter().zip(lit.as_slice())) {
        *v += l - lit;
    }
    let mut sorted = tones.as_slice().to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let range = options.range_stops.unwrap_or_else(|| range(&tones, &sorted, options.brightness));
    let display = Display::new(&sorted, range, options.brightness);
    let scene_range = scene.percentile(0.999) - scene.percentile(0.001);
    let contrast = (range / scene_range.max(1.0)).clamp(0.5, 1.0);
    // Tones are about 0, where the curve's table is.
    let middle = sorted[sorted.len() / 2];
    let mut about = tones;
    about.as_mut_slice().iter_mut().for_each(|v| *v -= middle);
    // Detail finer than a cell may be large, and large detail is hardly raised.
    let finest = 0.6 + 0.4 * options.detail as f32;
    let guide = Guide::fitted(&grid.logs, &about, grid.side, finest);
    let curve = Curve::new(|v| display.at(v + f64::from(middle)), |_| contrast, options.saturation);
    Tones::new(scene.to_srgb, guide, curve, scene.size.0)
}

/// From tones to the display.
struct Display {
    curve: ContrastCurve,
    veil: f64,
    power: f64,
}

impl Display {
    /// Of `range` stops; by a power of luminance the mean code of the tones `sorted` becomes `brightness`, as near as [`POWERS`] allow.
    fn new(sorted: &[f32], range: f64, brightness: f64) -> Self {
        let curve = ContrastCurve::new(sorted, range, ENDS, FLOOR);
        let mut display = Display { curve, veil: VEIL * libm::exp2(-range), power: 1.0 };
        let step = (sorted.len() / 2048).max(1);
        let shown: Vec<f64> = sorted.iter().step_by(step).map(|&v| display.at(v.into())).collect();
        display.power = brightness::power(&shown, brightness, POWERS, 19);
        display
    }

    /// Luminance relative to display white.
    fn at(&self, v: f64) -> f64 {
        let l = libm::exp2(self.curve.at(v));
        // l - veil where l is far above it, and never 0.
        libm::pow(l * l * (1.0 + self.veil) / (l + self.veil), self.power)
    }
}

/// The ranges that are tried, in stops: below the first a picture is murky, above the last its ends are lost on a screen.
const RANGES: (f64, f64) = (4.5, 7.0);

/// The mean of the standard deviations of codes, of 1, in squares of [`BLOCK`] cells that photographs have.
const LOCAL_CONTRAST: f64 = 18.0 / 255.0;
const BLOCK: usize = 11;

/// The range with which the tones have the local contrast of a photograph: sunlit leaves are given a wider one, fog a narrower one.
fn range(tones: &Plane<f32>, sorted: &[f32], brightness: f64) -> f64 {
    let (mut narrow, mut wide) = RANGES;
    for _ in 0..5 {
        let range = 0.5 * (narrow + wide);
        if local_contrast(tones, &Display::new(sorted, range, brightness), sorted) > LOCAL_CONTRAST {
            narrow = range;
        } else {
            wide = range;
        }
    }
    0.5 * (narrow + wide)
}

/// Entries of codes to a stop.
const PER_STOP: f32 = 32.0;

fn local_contrast(tones: &Plane<f32>, display: &Display, sorted: &[f32]) -> f64 {
    let (low, high) = (sorted[0], sorted[sorted.len() - 1]);
    let count = ((high - low) * PER_STOP) as usize + 1;
    let codes: Vec<f32> = (0..=count)
        .map(|i| linear_to_srgb(display.at(f64::from(low) + i as f64 / f64::from(PER_STOP))) as f32)
        .collect();
    let deviation = |x: usize, y: usize| {
        let (mut sum, mut squares) = (0.0f32, 0.0f32);
        for row in y..y + BLOCK {
            for v in &tones.row(row)[x..x + BLOCK] {
                let code = codes[((v - low) * PER_STOP) as usize];
                sum += code;
                squares += code * code;
            }
        }
        let n = (BLOCK * BLOCK) as f32;
        f64::from(((squares - sum * sum / n).max(0.0) / (n - 1.0)).sqrt())
    };
    let columns = tones.width() / BLOCK;
    let rows: Vec<f64> = (0..tones.height() / BLOCK)
        .into_par_iter()
        .map(|j| (0..columns).map(|i| deviation(i * BLOCK, j * BLOCK)).sum())
        .collect();
    rows.iter().sum::<f64>() / (rows.len() * columns).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;
    use crate::tonemap::overview::Overview;

    fn picture(map: &Plane<[f32; 3]>, options: &Options) -> Plane<[u8; 3]> {
        let mut overview = Overview::new((map.width(), map.height()), &Primaries::SRGB);
        overview.see(0, map);
        natural(&overview.scene().unwrap(), options).picture(map)
    }

    /// A dark room and a bright window, with texture in both, 10 stops apart.
    fn room(factor: f32, texture: f32) -> Plane<[f32; 3]> {
        Plane::from_rows(240, 160, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let window = (80..160).contains(&x) && (40..120).contains(&y);
                let wave = texture * libm::sinf(x as f32 * 0.8) * libm::cosf(y as f32 * 0.7);
                let l = factor * libm::exp2f(if window { 10.0 } else { 0.0 } + wave + x as f32 / 200.0);
                *p = [l, 0.9 * l, 0.7 * l];
            }
        })
    }

    fn mean(codes: &Plane<[u8; 3]>) -> f64 {
        codes.as_slice().iter().map(|p| f64::from(p[1])).sum::<f64>() / codes.as_slice().len() as f64
    }

    #[test]
    fn a_factor_does_not_matter() {
        let one = picture(&room(1.0, 0.5), &Options::default());
        let other = picture(&room(1024.0, 0.5), &Options::default());
        let pairs = one.as_slice().iter().zip(other.as_slice());
        assert!(pairs.into_iter().all(|(p, q)| (0..3).all(|c| p[c].abs_diff(q[c]) <= 1)));
    }

    /// Room and window are both shown: neither is black or white, and in both the texture is seen.
    #[test]
    fn both_sides_of_an_edge_are_shown() {
        let codes = picture(&room(1.0, 0.5), &Options::default());
        for (columns, rows) in [(5..60, 10..150), (90..150, 50..110)] {
            let values: Vec<u8> =
                rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(|(x, y)| codes.at(x, y)[1]).collect();
            let (low, high) = (*values.iter().min().unwrap(), *values.iter().max().unwrap());
            assert!(low > 15 && high - low > 25, "{low} {high}");
            let white = values.iter().filter(|v| **v == 255).count();
            assert!(white < values.len() / 10, "{white} of {}", values.len());
        }
    }

    #[test]
    fn the_settings_do_what_they_say() {
        let map = room(1.0, 0.5);
        let plain = picture(&map, &Options::default());
        assert!((mean(&plain) / 255.0 - Options::default().brightness).abs() < 0.06, "{}", mean(&plain));
        let brighter = picture(&map, &Options { brightness: 0.55, ..Options::default() });
        assert!(mean(&brighter) > mean(&plain) + 5.0);
        let chroma = |codes: &Plane<[u8; 3]>| -> i32 {
            codes.as_slice().iter().map(|p| i32::from(p[0]) - i32::from(p[2])).sum()
        };
        assert!(chroma(&picture(&map, &Options { saturation: 0.0, ..Options::default() })) == 0);
        assert!(chroma(&picture(&map, &Options { saturation: 1.5, ..Options::default() })) > chroma(&plain));
        // Between room and window less is left where edges are left less.
        let step = |edges| {
            let codes = picture(&map, &Options { edges, range_stops: Some(8.0), ..Options::default() });
            f64::from(codes.at(120, 80)[1]) - f64::from(codes.at(30, 80)[1])
        };
        assert!(step(0.2) < step(0.9) - 5.0, "{} {}", step(0.2), step(0.9));
        let deviation = |detail| {
            let codes = picture(&map, &Options { detail, range_stops: Some(6.0), ..Options::default() });
            let row = &codes.row(80)[10..60];
            let mean = row.iter().map(|p| f64::from(p[1])).sum::<f64>() / 50.0;
            row.iter().map(|p| (f64::from(p[1]) - mean).powi(2)).sum::<f64>()
        };
        assert!(deviation(1.8) > 1.2 * deviation(0.8));
    }

    /// Section III-B of Yeganeh & Wang: busy and plain scenes come nearer to one another in local contrast than they are.
    #[test]
    fn plain_scenes_gain_and_busy_ones_lose_contrast() {
        let range = |texture| {
            let logs = Plane::from_rows(240, 160, |y, row| {
                for (x, l) in row.iter_mut().enumerate() {
                    *l = x as f32 / 120.0 + texture * libm::sinf(x as f32 * 0.8) * libm::cosf(y as f32 * 0.7);
                }
            });
            let mut sorted = logs.as_slice().to_vec();
            sorted.sort_unstable_by(f32::total_cmp);
            super::range(&logs, &sorted, 0.44)
        };
        let (plain, busy) = (range(0.05), range(1.5));
        assert!(plain < 4.6 && busy > plain + 0.3, "{plain} {busy}");
    }

    #[test]
    fn the_smallest_and_the_plainest_do_not_fail() {
        for (width, height) in [(1, 1), (2, 3), (40, 30)] {
            let codes = picture(&Plane::filled(width, height, [0.3; 3]), &Options::default());
            assert!(codes.as_slice().iter().all(|p| p[0] == p[1] && p[1] == p[2] && p[0] == codes.at(0, 0)[0]));
        }
    }
}
