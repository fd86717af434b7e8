//! The operator of the house: edges held back without halos, the curve that distorts contrasts least, and the brightness of a photograph.
//!
//! In: a scene. Out: its tones. Cost: 0.1 us a cell, of which there are at most [`CELLS`]: 40 ms; a pixel two interpolations.
//! Source: `local_laplacian` (Paris et al. 2011, Aubry et al. 2014) for the large edges; `contrast_curve` (Eilertsen et al. 2015) for the rest.

use super::contrast_curve::ContrastCurve;
use super::guide::Guide;
use super::local_laplacian::{Remapping, local_laplacian};
use super::overview::Scene;
use super::settings::Setting;
use super::tones::{Curve, Tones};
use crate::bracket::colour::linear_to_srgb;

/// What may be set; the rest the picture decides.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// What an edge is higher than 1.3 stops is times this: 1 leaves all to the curve, 0 makes every region equally bright.
    pub edges: f64,
    /// Fine contrast: 1 as in the scene, above it raised.
    pub detail: f64,
    /// Stops from black to white on the display; a screen in a room shows 6 to 8.
    pub range_stops: f64,
    /// The mean of the picture's code values, 0 to 1.
    pub brightness: f64,
    /// Times the saturation that Mantiuk's fit gives: 1 looks as colourful as the scene, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { edges: 0.7, detail: 1.25, range_stops: 5.0, brightness: 0.44, saturation: 1.15 }
    }
}

impl Options {
    /// What may be set, by name.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::number("brightness", (0.1, 0.9), &mut self.brightness, "the mean of the picture's codes, of 1"),
            Setting::number("detail", (0.5, 3.0), &mut self.detail, "times the fine contrast of the scene"),
            Setting::number("edges", (0.0, 1.0), &mut self.edges, "what is left of edges over 1.3 stops; 0 is flat"),
            Setting::number("range", (3.0, 12.0), &mut self.range_stops, "stops from black to white on the display"),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// Cells that edges are held back on.
pub const CELLS: usize = 1 << 18;

/// The parts of the tones that may be black, and white.
const ENDS: (f64, f64) = (0.002, 0.0005);

/// What of the luminance of the darkest tone is taken for the veil that a display adds, and taken off.
const VEIL: f64 = 0.7;

/// The share that a tone counts for at least: what hardly occurs keeps some of its drawing.
const FLOOR: f64 = 0.15;

/// How far the brightness of a picture may be brought to that asked for, as a power of luminance: a night stays darker than a day.
const POWERS: (f64, f64) = (0.7, 1.5);

/// The tones of `scene`.
pub fn natural(scene: &Scene, options: &Options) -> Tones {
    let mut grid = scene.coarser(CELLS);
    let dark = scene.percentile(0.001) as f32 - 1.0;
    grid.logs.as_mut_slice().iter_mut().for_each(|l| *l = l.max(dark));
    let remapping = Remapping { edge: 1.3, detail: 1.0 / options.detail, range: options.edges, noise: 0.05 };
    let tones = local_laplacian(&grid.logs, &remapping);
    let mut sorted = tones.as_slice().to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let curve = ContrastCurve::new(&sorted, options.range_stops, ENDS, FLOOR);
    let veil = VEIL * libm::exp2(-options.range_stops);
    let shown = |v: f64| ((libm::exp2(curve.at(v)) - veil) / (1.0 - veil)).max(0.0);
    let power = power(&sorted, shown, options.brightness);
    let scene_range = scene.percentile(0.999) - scene.percentile(0.001);
    let contrast = (options.range_stops / scene_range.max(1.0)).clamp(0.5, 1.0);
    // Tones are about 0, where the curve's table is.
    let middle = sorted[sorted.len() / 2];
    let mut about = tones;
    about.as_mut_slice().iter_mut().for_each(|v| *v -= middle);
    let guide = Guide::fitted(&grid.logs, &about, grid.side, options.detail as f32);
    let display = |v: f64| libm::pow(shown(v + f64::from(middle)), power);
    Tones::new(scene.to_srgb, guide, Curve::new(display, |_| contrast, options.saturation), scene.size.0)
}

/// The power of luminance with which the mean code of the tones is `brightness`.
fn power(sorted: &[f32], shown: impl Fn(f64) -> f64, brightness: f64) -> f64 {
    let step = (sorted.len() / 4096).max(1);
    let tones: Vec<f64> = sorted.iter().step_by(step).map(|&v| shown(v.into())).collect();
    let (mut low, mut high) = POWERS;
    for _ in 0..30 {
        let power = 0.5 * (low + high);
        let mean = tones.iter().map(|t| linear_to_srgb(libm::pow(*t, power))).sum::<f64>() / tones.len() as f64;
        if mean > brightness {
            low = power;
        } else {
            high = power;
        }
    }
    0.5 * (low + high)
}
