//! Fills the range of a display: scales the tones of an operator so that they reach from black to white, whatever their
//! range in stops is.
//!
//! In: a scene and the tones of its cells. Out: its tones on the display. Cost: 60 ns per cell. Source: Mantiuk,
//! Myszkowski, Seidel, "A Perceptual Framework for Contrast Processing of High Dynamic Range Images" (2006), section
//! 6.1: log luminance is scaled so that two percentiles become black and white.

use crate::plane::Plane;
use crate::tonemap::guide::Guide;
use crate::tonemap::overview::Scene;
use crate::tonemap::solvers::brightness;
use crate::tonemap::tones::{Curve, Tones};

/// Largest number of cells of the grid of tones.
pub(crate) const CELLS: usize = 1 << 18;

/// Shares of the tones that are clipped to black and to white.
const CLIPPED: (f64, f64) = (0.01, 0.004);

/// Largest displayed range, divided by the range of the scene. The limit keeps the contrast of fog and of a grey card
/// low.
const MOST_SPREAD: f64 = 1.5;

/// Parameters of the scaling.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LogRange {
    /// Stops from black to white.
    pub stops: f64,
    /// Target of the mean code value, 0 to 1.
    pub brightness: f64,
    /// Factor on the saturation that Mantiuk's colour correction gives (see `tones`).
    pub saturation: f64,
}

/// Smallest and largest exponent used to reach the brightness.
const POWERS: (f64, f64) = (0.8, 1.6);

impl LogRange {
    /// Returns the tones of `scene`; `change` computes tones from the log2 luminances of the cells
    /// ([`lit`](Scene::lit), which limits dark values). These tones are then scaled.
    pub fn tones(&self, scene: &Scene, change: impl FnOnce(&Plane<f32>) -> Plane<f32>) -> Tones {
        let mut grid = scene.coarser(CELLS);
        grid.logs = grid.lit();
        let tones = change(&grid.logs);
        self.filled(scene, &grid, tones)
    }

    /// Returns the tones of `scene`; `tones` are the tones of the cells of `grid` before scaling.
    fn filled(&self, scene: &Scene, grid: &Scene, mut tones: Plane<f32>) -> Tones {
        let mut sorted = tones.as_slice().to_vec();
        sorted.sort_unstable_by(f32::total_cmp);
        let last = sorted.len() - 1;
        // The value with the nearest rank is used. In a small picture this may be the darkest or the brightest value,
        // and then nothing is clipped. `quantile` would clip at least one value at each end.
        let at = |p: f64| sorted[((last as f64 * p).round() as usize).min(last)];
        let (black, white) = (at(CLIPPED.0), at(1.0 - CLIPPED.1));
        let range = scene.percentile(1.0 - CLIPPED.1) - scene.percentile(CLIPPED.0);
        let shown = self.stops.min(MOST_SPREAD * range);
        let spread = shown / f64::from(white - black).max(1e-3);
        tones.as_mut_slice().iter_mut().for_each(|v| *v -= white);
        // The lower end of the display's range maps to black.
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

    /// Returns the code values of a ramp that spans `stops` stops.
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

    /// The ends of the ramp are black and white, its mean code value is the target, and a narrow range is not stretched
    /// to fill the display.
    #[test]
    fn range_is_filled_and_fog_keeps_low_contrast() {
        for stops in [6.0, 12.0] {
            let codes = filled(stops, &PLAIN);
            assert!(
                codes[0] < 3.0 && codes[4] < 9.0 && codes[499] == 255.0 && codes[497] == 255.0,
                "{stops}: {codes:?}"
            );
            assert!(codes[12] > 2.0 && codes[490] < 254.0, "no more than that is clipped: {codes:?}");
            let mean = codes.iter().sum::<f64>() / 500.0;
            assert!((mean - 0.45 * 255.0).abs() < 2.0, "{stops}: {mean}");
        }
        let fog = filled(0.5, &PLAIN);
        assert!(fog[499] == 255.0 && fog[0] > 120.0, "{}", fog[0]);
    }
}
