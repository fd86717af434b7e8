//! Durand & Dorsey's operator: splits the picture into a base and a detail layer and compresses the base alone.
//!
//! In: a scene. Out: its tones. Cost: 20 ns per cell of a grid of at most [`CELLS`] cells. Source: Durand & Dorsey,
//! "Fast Bilateral Filtering for the Display of High-Dynamic-Range Images" (2002), sections 4 and 6.

use crate::plane::Plane;
use crate::tonemap::guide::Guide;
use crate::tonemap::overview::Scene;
use crate::tonemap::settings::Setting;
use crate::tonemap::solvers::bilateral::bilateral;
use crate::tonemap::tones::{Curve, Tones};

/// Settings of the operator.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// Range of the compressed base in stops; the paper's "desired contrast" as a logarithm.
    pub base_stops: f64,
    /// Spatial standard deviation of the filter, as a fraction of the longer side of the picture.
    pub reach: f64,
    /// Standard deviation of the filter in luminance, in stops: larger differences count as edges. The paper uses 0.4
    /// in log10, which is 1.33 stops.
    pub edge_stops: f64,
    /// Factor on the saturation that Mantiuk's colour correction gives (see `tones`): 1 looks as colourful as the
    /// scene, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { base_stops: 3.6, reach: 0.02, edge_stops: 1.33, saturation: 1.0 }
    }
}

impl Options {
    /// Returns the settings, each with its name, range and description.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::number(
                "base",
                (0.5, 10.0),
                &mut self.base_stops,
                "range of brightness of large areas, in stops; a larger range is reduced to this, a smaller one stays",
            ),
            Setting::number(
                "reach",
                (0.002, 0.2),
                &mut self.reach,
                "smoothing radius of the base layer, as a fraction of the longer side",
            ),
            Setting::number(
                "edge",
                (0.1, 5.0),
                &mut self.edge_stops,
                "larger differences than this, in stops, are edges and stay sharp",
            ),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// Largest number of cells that the base is computed on.
pub const CELLS: usize = 1 << 19;

/// When the range of the base is measured, this fraction of its values is ignored at each end. The same fraction of the
/// tones may be clipped to white.
const ENDS: f64 = 0.005;

/// Returns the tones of `scene`.
pub fn durand(scene: &Scene, options: &Options) -> Tones {
    let scene = scene.coarser(CELLS);
    let logs = &scene.logs;
    let reach = options.reach * logs.width().max(logs.height()) as f64;
    let base = bilateral(logs, reach.max(1.0) as f32, options.edge_stops as f32);
    let ends = ends(base.as_slice());
    let range = f64::from(ends.1 - ends.0).max(1e-3);
    // A base with a smaller range than `base_stops` is not expanded.
    let factor = (options.base_stops / range).min(1.0) as f32;
    let cells = base.as_slice().iter().zip(logs.as_slice());
    let tones: Vec<f32> = cells.map(|(&b, &l)| factor * (b - ends.1) + (l - b)).collect();
    // In the paper, detail that is brighter than the brightest base is clipped. Here white is the tone that only a
    // share [`ENDS`] of the tones exceeds.
    let white = self::ends(&tones).1;
    let tones = Plane::from_vec(logs.width(), logs.height(), tones);
    let guide = Guide::fitted(logs, &tones, scene.side, 1.0);
    let display = |v: f64| libm::exp2(v - f64::from(white));
    let curve = Curve::new(display, |_| f64::from(factor).max(0.5), options.saturation);
    Tones::new(scene.to_srgb, guide, curve, scene.size.0)
}

/// Returns two values: a share [`ENDS`] of `values` lies below the first, and the same share above the second.
fn ends(values: &[f32]) -> (f32, f32) {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let last = sorted.len() - 1;
    let skipped = (ENDS * last as f64) as usize;
    (sorted[skipped], sorted[last - skipped])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::{Primaries, srgb_to_linear};
    use crate::tonemap::overview::Overview;

    /// Section 4: the two halves of the picture differ by the range of the compressed base, and their detail has the
    /// same contrast as in the scene.
    #[test]
    fn the_base_is_compressed_and_detail_is_not() {
        let wave = |x: usize, y: usize| if (x / 3 + y / 3).is_multiple_of(2) { 0.15 } else { -0.15 };
        let map = Plane::from_rows(400, 200, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [libm::exp2f(if x < 200 { 0.0 } else { 9.0 } + wave(x, y)); 3];
            }
        });
        let mut overview = Overview::new((400, 200), &Primaries::SRGB);
        overview.see(0, &map);
        let scene = overview.scene().unwrap();
        let picture = durand(&scene, &Options { base_stops: 3.0, ..Options::default() }).picture(&map);
        let log = |x: usize, y: usize| libm::log2(srgb_to_linear(f64::from(picture.at(x, y)[1]) / 255.0));
        // The tolerances cover the rounding of code values from 90 to 255 (0.02 stops) and the blur of the bilateral
        // grid, which changes the base by less than 0.1 stops.
        for x in [40, 100, 300, 360] {
            assert!((log(x, 100) - log(x + 3, 100)).abs() - 0.3 < 0.06, "{x}");
        }
        let (dark, bright) = (0.5 * (log(60, 100) + log(63, 100)), 0.5 * (log(320, 100) + log(323, 100)));
        assert!((bright - dark - 3.0).abs() < 0.15, "{dark} {bright}");
    }
}
