//! The range of a display filled: tones in stops, whose ends an operator leaves open, become black and white.
//!
//! In: a scene and the tones of its cells. Out: its tones on the display. Cost: 60 ns a cell.
//! Source: Mantiuk, Myszkowski, Seidel, "A Perceptual Framework for Contrast Processing of High Dynamic Range Images" (2006), section 6.1:
//! luminance is scaled in the logarithm so that percentiles meet black and white.

use crate::plane::Plane;
use crate::tonemap::guide::Guide;
use crate::tonemap::overview::Scene;
use crate::tonemap::solvers::brightness;
use crate::tonemap::tones::{Curve, Tones};

/// Cells that tones are made of.
pub(crate) const CELLS: usize = 1 << 18;

/// The part of the tones at the dark and the bright end that may be black or white.
const BURNT: (f64, f64) = (0.01, 0.004);

/// The range shown is not more than this times that of the scene: fog stays fog, a grey card grey.
const MOST_SPREAD: f64 = 1.5;

/// How the range is filled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LogRange {
    /// Stops from black to white.
    pub stops: f64,
    /// The mean code, of 1, that is aimed at.
    pub brightness: f64,
    /// Times the saturation that Mantiuk's fit gives.
    pub saturation: f64,
}

/// How far brightness may be brought to what is aimed at, as a power of luminance.
const POWERS: (f64, f64) = (0.8, 1.6);

impl LogRange {
    /// The tones of `scene`, whose [lit](Scene::lit) cells become what `change` makes of them.
    pub fn tones(&self, scene: &Scene, change: impl FnOnce(&Plane<f32>) -> Plane<f32>) -> Tones {
        let mut grid = scene.coarser(CELLS);
        grid.logs = grid.lit();
        let tones = change(&grid.logs);
        self.filled(scene, &grid, tones)
    }

    /// The tones on the display of `scene`, for which `tones` are those of the cells of `grid`.
    fn filled(&self, scene: &Scene, grid: &Scene, mut tones: Plane<f32>) -> Tones {
        let mut sorted = tones.as_slice().to_vec();
        sorted.sort_unstable_by(f32::total_cmp);
        let last = sorted.len() - 1;
        // The nearest: whole parts of the tones burn out, and `quantile` would keep a value from each end.
        let at = |p: f64| sorted[((last as f64 * p).round() as usize).min(last)];
        let (black, white) = (at(BURNT.0), at(1.0 - BURNT.1));
        let range = scene.percentile(1.0 - BURNT.1) - scene.percentile(BURNT.0);
        let shown = self.stops.min(MOST_SPREAD * range);
        let spread = shown / f64::from(white - black).max(1e-3);
        tones.as_mut_slice().iter_mut().for_each(|v| *v -= white);
        // Black is at its end of the range, as far as the range is filled.
        let floor = libm::exp2(-self.stops);
        let display = |v: f64| ((libm::exp2(spread * v) - floor) / (1.0 - floor)).max(0.0);
        let step = (sorted.len() / 4096).max(1);
        let linear: Vec<f64> = sorted.iter().step_by(step).map(|&v| display(f64::from(v - white)).min(1.0)).collect();
        let power = brightness::power(&linear, self.brightness, POWERS, 30);
        let contrast = (shown / range.max(1.0)).clamp(0.6, 1.0);
        let guide = Guide::fitted(&grid.logs, &tones, grid.side, 1.0);
        let curve = Curve::new(|v| libm::pow(display(v), power), |_| contrast, self.saturation);
        Tones::new(scene.to_srgb, guide, curve, scene.size.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;
    use crate::tonemap::overview::Overview;

    /// A ramp of so many stops, and what becomes of it.
    fn filled(stops: f64, range: &LogRange) -> Vec<f64> {
        let map = Plane::from_rows(500, 8, |_, row| {
            row.iter_mut().enumerate().for_each(|(x, p)| *p = [libm::exp2(stops * x as f64 / 499.0) as f32; 3])
        });
        let mut overview = Overview::new((500, 8), &Primaries::SRGB);
        overview.see(0, &map);
        let scene = overview.scene().unwrap();
        let picture = range.filled(&scene, &scene, scene.logs.clone()).picture(&map);
        picture.row(3).iter().map(|p| f64::from(p[1])).collect()
    }

    const PLAIN: LogRange = LogRange { stops: 6.0, brightness: 0.45, saturation: 1.0 };

    /// The ends of the ramp are black and white, its mean code is what was asked for, and what is narrow is not spread to fill the range.
    #[test]
    fn the_range_is_filled_and_fog_stays_fog() {
        for stops in [6.0, 12.0] {
            let codes = filled(stops, &PLAIN);
            assert!(
                codes[0] < 3.0 && codes[4] < 9.0 && codes[499] == 255.0 && codes[497] == 255.0,
                "{stops}: {codes:?}"
            );
            assert!(codes[12] > 2.0 && codes[490] < 254.0, "no more than that is burnt: {codes:?}");
            let mean = codes.iter().sum::<f64>() / 500.0;
            assert!((mean - 0.45 * 255.0).abs() < 2.0, "{stops}: {mean}");
        }
        let fog = filled(0.5, &PLAIN);
        assert!(fog[499] == 255.0 && fog[0] > 120.0, "{}", fog[0]);
    }
}
