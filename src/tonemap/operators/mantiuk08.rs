//! Display adaptive tone mapping: the tone curve that best reproduces the visible contrasts of a scene on a given
//! display.
//!
//! In: a scene, and the properties of the display and the room. Out: its tones, by one curve for all pixels. Cost: 60
//! ns per cell of a grid of at most `CELLS` cells, and some tens of small quadratic programs; 0.1 s in all. Source:
//! Mantiuk, Daly, Kerofsky, "Display Adaptive Tone Mapping" (2008): section 3 (the problem, solved as a sequence of
//! quadratic programs), 4 (the eye), 5 (the display), 6 (statistics of contrasts by luminance).

use crate::bracket::colour::srgb_to_linear;
use crate::plane::Plane;
use crate::pyramid::burt_adelson::{expand, reduce};
use crate::tonemap::guide::Guide;
use crate::tonemap::overview::Scene;
use crate::tonemap::settings::Setting;
use crate::tonemap::solvers::eye::{response, sensitivity};
use crate::tonemap::solvers::quadratic::minimum;
use crate::tonemap::tones::{Curve, Tones};

/// Settings of the operator.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// Luminance of the display's white, cd/m2.
    pub peak_cd_m2: f64,
    /// Luminance of the display's black in a dark room, cd/m2.
    pub black_cd_m2: f64,
    /// Illuminance in the room, in lux. The screen reflects a hundredth of it; higher values brighten the dark parts.
    pub ambient_lux: f64,
    /// Factor on the contrast of the scene; the product is the contrast to reproduce.
    pub contrast: f64,
    /// Factor on the saturation that Mantiuk's colour correction gives (see `tones`): 1 looks as colourful as the
    /// scene, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        // A liquid crystal display in an office, as in the paper's table.
        Options { peak_cd_m2: 100.0, black_cd_m2: 0.8, ambient_lux: 60.0, contrast: 1.0, saturation: 1.0 }
    }
}

impl Options {
    /// Returns the settings, each with its name, range and description.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::number(
                "peak_cd_m2",
                (20.0, 10_000.0),
                &mut self.peak_cd_m2,
                "luminance of the display's white, cd/m2",
            ),
            Setting::number(
                "black_cd_m2",
                (0.0, 10.0),
                &mut self.black_cd_m2,
                "luminance of the display's black, cd/m2",
            ),
            Setting::number("ambient_lux", (0.0, 50_000.0), &mut self.ambient_lux, "illuminance in the room, lux"),
            Setting::number("contrast", (0.2, 3.0), &mut self.contrast, "factor on the contrast of the scene"),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// Largest number of cells in which contrasts are counted. A cell is treated as one pixel of the display.
const CELLS: usize = 1 << 18;

/// Pixels of the display per degree of visual angle, as for a monitor at arm's length.
const PIXELS_PER_DEGREE: f64 = 30.0;

/// Number of frequency bands, one octave apart: 15, 7.5, 3.75 and 1.9 cycles per degree (section 6).
const BANDS: usize = 4;

/// Smallest distance between neighbouring nodes of the tone curve, in log10 luminance.
const STEP: f64 = 0.1;
/// Largest number of linear pieces of the tone curve.
const MOST_PIECES: usize = 40;

/// Largest contrast that is counted, log10.
const MOST_CONTRAST: f64 = 0.7;

/// Contrast threshold, log10: 1 %.
const SEEN: f64 = 0.0043;

/// Luminance, in cd/m2, to which the eye of a viewer of the real scene is adapted: daylight.
const DAYLIGHT: f64 = 1000.0;

/// If no contrasts occur in a part of the tone curve, a contrast across this gap is added (section 6, disconnected
/// parts). This is its weight, divided by the weight of all contrasts together.
const BRIDGE: f64 = 0.1;

/// Largest number of rounds; in each, responses are linearised again.
const ROUNDS: usize = 60;
/// The curve has converged if no piece changes by more than this in a round, log10.
const SETTLED: f64 = 5e-4;

/// The display in its room (section 5).
#[derive(Debug, Clone, Copy)]
struct Display {
    /// Luminance of black in cd/m2, including reflected light.
    black: f64,
    /// Luminance of white in cd/m2, including reflected light.
    white: f64,
}

impl Display {
    fn new(options: &Options) -> Self {
        let reflected = 0.01 / std::f64::consts::PI * options.ambient_lux;
        // A black of 0 would give an infinite range, so black is at least a ten thousandth of the peak luminance.
        let black = (options.black_cd_m2 + reflected).clamp(1e-4 * options.peak_cd_m2, 0.5 * options.peak_cd_m2);
        Display { black, white: options.peak_cd_m2 + reflected }
    }

    /// Returns the linear sRGB value to send for a luminance. Real displays have the paper's gamma of 2.2, which shows
    /// the darkest code values darker than sRGB defines them. Lighter values are sent to compensate for this.
    fn linear(&self, cd_m2: f64) -> f64 {
        let part = ((cd_m2 - self.black) / (self.white - self.black)).clamp(0.0, 1.0);
        srgb_to_linear(libm::pow(part, 1.0 / 2.2))
    }

    /// Returns the dynamic range, log10.
    fn range(&self) -> f64 {
        libm::log10(self.white / self.black)
    }
}

/// The contrasts between two nodes in one frequency band.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Contrasts {
    from: usize,
    to: usize,
    band: usize,
    /// Share of these contrasts among all visible contrasts.
    share: f64,
}

/// The nodes of the curve, at equal distances of log10 luminance.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Nodes {
    first: f64,
    step: f64,
    pieces: usize,
}

impl Nodes {
    fn of(scene: &Scene) -> Self {
        let log10 = |p| scene.percentile(p) * std::f64::consts::LOG10_2;
        let (low, high) = (log10(0.0005), log10(0.9995));
        let pieces = ((high - low) / STEP).ceil().clamp(1.0, MOST_PIECES as f64) as usize;
        Nodes { first: low, step: ((high - low) / pieces as f64).max(STEP), pieces }
    }

    /// Returns the index of the node nearest to a log10 luminance.
    fn nearest(&self, log: f64) -> usize {
        libm::round((log - self.first) / self.step).clamp(0.0, self.pieces as f64) as usize
    }
}

/// Returns the tones of `scene`.
pub fn mantiuk08(scene: &Scene, options: &Options) -> Tones {
    let nodes = Nodes::of(scene);
    let grid = scene.coarser(CELLS);
    let contrasts = bridged(&counted(&grid.logs, &nodes), &nodes);
    let display = Display::new(options);
    let pieces = curve(&contrasts, &nodes, &display, options.contrast);
    let ends = ends(&pieces);
    let piece = |log: f64| {
        let at = (log - nodes.first) / nodes.step;
        ((at.max(0.0) as usize).min(nodes.pieces - 1), at)
    };
    let log10_of = |v: f64| v * std::f64::consts::LOG10_2 + nodes.first;
    let shown = |v: f64| {
        let (i, at) = piece(log10_of(v));
        let log = if at <= 0.0 { ends[0] + at * nodes.step } else { ends[i] + (at - i as f64).min(1.0) * pieces[i] };
        display.linear(display.white * libm::exp10(log))
    };
    // The slope of the tone curve at a luminance, averaged over nine pieces (0.9 or more in log10), so that the corners
    // of the piecewise linear curve do not show in the colours.
    let slope = |v: f64| {
        let (i, _) = piece(log10_of(v));
        let about = &pieces[i.saturating_sub(4)..(i + 5).min(nodes.pieces)];
        about.iter().sum::<f64>() / (about.len() as f64 * nodes.step)
    };
    let curve = Curve::new(shown, slope, options.saturation);
    // Tones are in stops from the first node.
    let shift = -nodes.first / std::f64::consts::LOG10_2;
    Tones::new(scene.to_srgb, Guide::shifted(shift), curve, scene.size.0)
}

/// Returns log10 of the display luminance at every node, divided by white. If the curve needs less than the range of
/// the display, the darkest part of that range is unused.
fn ends(pieces: &[f64]) -> Vec<f64> {
    let mut ends = vec![0.0f64; pieces.len() + 1];
    for i in (0..pieces.len()).rev() {
        ends[i] = ends[i + 1] - pieces[i];
    }
    ends
}

/// Section 6: counts the contrasts between cells and their surroundings. Contrasts are counted separately for each
/// frequency band and each pair of nodes of the curve that they connect.
fn counted(logs: &Plane<f32>, nodes: &Nodes) -> Vec<Contrasts> {
    let reach = libm::round(MOST_CONTRAST / nodes.step).max(1.0) as isize;
    let size = nodes.pieces + 1;
    let mut contrasts = Vec::new();
    let mut fine = logs.clone();
    for band in 0..BANDS {
        let coarse = reduce(&fine);
        let around = expand(&coarse, (fine.width(), fine.height()));
        let mut counts = vec![0u64; size * size];
        for (&here, &around) in fine.as_slice().iter().zip(around.as_slice()) {
            let contrast = f64::from(here - around) * std::f64::consts::LOG10_2;
            let at = nodes.nearest(f64::from(around) * std::f64::consts::LOG10_2);
            let most = libm::round(contrast / nodes.step) as isize;
            // A visible contrast of less than half a step counts as one step.
            let steps = if most == 0 && contrast.abs() > SEEN { contrast.signum() as isize } else { most };
            let to = at as isize + steps;
            if steps != 0 && steps.abs() <= reach && (0..size as isize).contains(&to) {
                let (low, high) = (at.min(to as usize), at.max(to as usize));
                counts[low * size + high] += 1;
            }
        }
        let area = (1u64 << (2 * band)) as f64;
        for (i, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            contrasts.push(Contrasts { from: i / size, to: i % size, band, share: count as f64 * area });
        }
        fine = coarse;
    }
    let all: f64 = contrasts.iter().map(|c| c.share).sum();
    contrasts.iter_mut().for_each(|c| c.share /= all);
    contrasts
}

/// If there are no contrasts between two parts of the curve, adds a contrast that connects them.
fn bridged(contrasts: &[Contrasts], nodes: &Nodes) -> Vec<Contrasts> {
    let mut is_used = vec![false; nodes.pieces];
    for c in contrasts {
        is_used[c.from..c.to].fill(true);
    }
    let mut all = contrasts.to_vec();
    let mut from = 0;
    for run in is_used.chunk_by(|a, b| a == b) {
        if !run[0] {
            all.push(Contrasts { from, to: from + run.len(), band: BANDS - 1, share: BRIDGE });
        }
        from += run.len();
    }
    all
}

/// Returns, for each piece of the tone curve, its share of the display's log10 range (section 3). With these shares,
/// the eye's responses to the contrasts on the display are as close as possible to its responses to the contrasts of
/// the scene. The responses are linearised at the last solution, and a new solution is computed, until the solutions
/// converge.
fn curve(contrasts: &[Contrasts], nodes: &Nodes, display: &Display, enhanced: f64) -> Vec<f64> {
    let n = nodes.pieces;
    let frequency = |band: usize| 0.5 * PIXELS_PER_DEGREE / f64::from(1u32 << band);
    let aims: Vec<f64> = contrasts
        .iter()
        .map(|c| response((c.to - c.from) as f64 * nodes.step * enhanced, sensitivity(frequency(c.band), DAYLIGHT)))
        .collect();
    // The eye's sensitivity for luminances of the display, in steps of 0.1 in log10.
    let grades = (display.range() / STEP).ceil() as usize + 1;
    let of_band = |band: usize| -> Vec<f64> {
        let grade = |i: usize| sensitivity(frequency(band), display.white * libm::exp10(-STEP * i as f64));
        (0..grades).map(grade).collect()
    };
    let sensitivities: Vec<Vec<f64>> = (0..BANDS).map(of_band).collect();
    let mut pieces = vec![display.range().min(n as f64 * nodes.step) / n as f64; n];
    for _ in 0..ROUNDS {
        let ends = ends(&pieces);
        let (mut h, mut f) = (vec![vec![0.0f64; n]; n], vec![0.0f64; n]);
        for (c, aim) in contrasts.iter().zip(&aims) {
            let shown = (ends[c.to] - ends[c.from]).max(1e-3);
            let grade = (libm::round(-ends[c.from] / STEP) as usize).min(grades - 1);
            let slope = response(shown, sensitivities[c.band][grade]) / shown;
            for i in c.from..c.to {
                f[i] += c.share * slope * aim;
                h[i][c.from..c.to].iter_mut().for_each(|v| *v += c.share * slope * slope);
            }
        }
        // The ridge (a small number on the diagonal) is a regularisation: if two pieces occur only together, it gives
        // them equal shares.
        let ridge = 1e-6 * (0..n).map(|i| h[i][i]).sum::<f64>() / n as f64;
        (0..n).for_each(|i| h[i][i] += ridge);
        let next = minimum(&h, &f, display.range());
        let moved = pieces.iter().zip(&next).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        // Each round goes half of the way to the new solution, because full steps may oscillate.
        pieces.iter_mut().zip(&next).for_each(|(p, n)| *p = 0.5 * (*p + n));
        if moved < SETTLED {
            break;
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;
    use crate::tonemap::overview::Overview;

    /// Returns a scene with a range of `stops`: two textured areas and the ramp between them.
    fn radiance(stops: f32, factor: f32) -> Plane<[f32; 3]> {
        Plane::from_rows(300, 160, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let wave = 0.4 * ((x as f32 * 1.9).sin() + (y as f32 * 1.7).cos());
                let part = ((x as f32 - 130.0) / 40.0).clamp(0.0, 1.0);
                *p = [1.0, 0.8, 0.6].map(|c| c * factor * libm::exp2f(stops * part + wave));
            }
        })
    }

    fn scene(map: &Plane<[f32; 3]>) -> Scene {
        let mut overview = Overview::new((map.width(), map.height()), &Primaries::SRGB);
        overview.see(0, map);
        overview.scene().unwrap()
    }

    fn picture(map: &Plane<[f32; 3]>, options: &Options) -> Plane<[u8; 3]> {
        mantiuk08(&scene(map), options).picture(map)
    }

    /// Returns the sum of squares that section 3 minimises.
    fn distortion(pieces: &[f64], contrasts: &[Contrasts], nodes: &Nodes, display: &Display) -> f64 {
        let frequency = |band: usize| 0.5 * PIXELS_PER_DEGREE / f64::from(1u32 << band);
        let square = |c: &Contrasts| {
            let aim = response((c.to - c.from) as f64 * nodes.step, sensitivity(frequency(c.band), DAYLIGHT));
            let shown = pieces[c.from..c.to].iter().sum::<f64>();
            let luminance = display.white * libm::exp10(-pieces[c.from..].iter().sum::<f64>());
            let seen = response(shown, sensitivity(frequency(c.band), luminance));
            c.share * (seen - aim) * (seen - aim)
        };
        contrasts.iter().map(square).sum()
    }

    /// The result is near the minimum: if one piece of the curve gives a part of its output range to another piece, the
    /// distortion decreases by at most 5 %. It is not exactly the minimum, because the paper's iteration keeps the
    /// ratio of response to contrast fixed in each round.
    #[test]
    fn no_curve_near_by_distorts_less() {
        let scene = scene(&radiance(12.0, 1.0));
        let nodes = Nodes::of(&scene);
        let contrasts = bridged(&counted(&scene.logs, &nodes), &nodes);
        let display = Display::new(&Options::default());
        let pieces = curve(&contrasts, &nodes, &display, 1.0);
        let sum: f64 = pieces.iter().sum();
        assert!(pieces.iter().all(|d| *d >= 0.0) && (sum - display.range()).abs() < 1e-6, "{sum} {}", display.range());
        let least = distortion(&pieces, &contrasts, &nodes, &display);
        let even = vec![sum / pieces.len() as f64; pieces.len()];
        assert!(least < 0.95 * distortion(&even, &contrasts, &nodes, &display), "{least}");
        let n = pieces.len();
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))).filter(|(i, j)| i != j) {
            let mut other = pieces.clone();
            let moved = (0.2 * other[i]).min(0.05);
            other[i] -= moved;
            other[j] += moved;
            let cost = distortion(&other, &contrasts, &nodes, &display);
            assert!(cost > 0.95 * least, "{i} to {j}: {cost} {least}");
        }
    }

    #[test]
    fn brighter_is_brighter_and_a_factor_does_not_matter() {
        let map = radiance(10.0, 1.0);
        let one = picture(&map, &Options::default());
        let other = picture(&radiance(10.0, 1.0 / 4096.0), &Options::default());
        let pairs = one.as_slice().iter().zip(other.as_slice());
        assert!(pairs.into_iter().all(|(p, q)| (0..3).all(|c| p[c].abs_diff(q[c]) <= 1)));
        let ramp = Plane::from_rows(400, 1, |_, row| {
            row.iter_mut().enumerate().for_each(|(x, p)| *p = [libm::exp2f(x as f32 / 36.0); 3])
        });
        let codes = mantiuk08(&scene(&map), &Options::default()).picture(&ramp);
        assert!(codes.row(0).windows(2).all(|w| w[0][1] <= w[1][1]));
        assert!(codes.at(0, 0)[1] < 100 && codes.at(399, 0)[1] == 255);
    }

    /// In a bright room the screen reflects light, so the dark parts of the picture are raised above the reflected
    /// light. On a display with a higher contrast they stay darker.
    #[test]
    fn a_bright_room_lifts_the_dark() {
        let map = radiance(10.0, 1.0);
        let mean = |options: &Options| {
            let picture = picture(&map, options);
            (0..160).flat_map(|y| &picture.row(y)[..100]).map(|p| f64::from(p[1])).sum::<f64>() / 16000.0
        };
        let plain = Options::default();
        let (dim, bright) =
            (Options { ambient_lux: 0.0, ..plain.clone() }, Options { ambient_lux: 5000.0, ..plain.clone() });
        assert!(mean(&bright) > mean(&plain) + 5.0 && mean(&plain) >= mean(&dim), "{} {}", mean(&bright), mean(&plain));
        let better = Options { peak_cd_m2: 1000.0, black_cd_m2: 0.01, ..plain.clone() };
        assert!(mean(&better) < mean(&plain), "{}", mean(&better));
    }

    /// The scene has a low dynamic range, so that the display has room for more contrast.
    #[test]
    fn contrast_reaches_the_target() {
        let map = radiance(1.0, 1.0);
        let spread = |contrast: f64| {
            let codes: Vec<u8> =
                picture(&map, &Options { contrast, ..Options::default() }).as_slice().iter().map(|p| p[1]).collect();
            codes.iter().max().unwrap() - codes.iter().min().unwrap()
        };
        assert!(spread(0.6) + 10 < spread(1.0) && spread(1.0) + 10 < spread(1.6), "{} {}", spread(0.6), spread(1.0));
    }

    /// There is texture at two distant luminances and nothing in between. The curve keeps a gap between them, but does
    /// not give it the whole range of the display.
    #[test]
    fn parts_without_contrast_between_them_hold_together() {
        let nodes = Nodes { first: 0.0, step: 0.1, pieces: 30 };
        let seen = [(0, 1), (1, 2), (28, 29), (29, 30)];
        let contrasts: Vec<Contrasts> =
            seen.iter().map(|&(from, to)| Contrasts { from, to, band: 2, share: 0.25 }).collect();
        let all = bridged(&contrasts, &nodes);
        assert_eq!(all[4..], [Contrasts { from: 2, to: 28, band: BANDS - 1, share: BRIDGE }]);
        let pieces = curve(&all, &nodes, &Display::new(&Options::default()), 1.0);
        let gap: f64 = pieces[2..28].iter().sum();
        assert!((0.3..1.9).contains(&gap), "{gap}");
    }

    #[test]
    fn uniform_pictures_stay_uniform_at_any_size() {
        for (width, height) in [(1, 1), (2, 3), (1, 50), (70, 70)] {
            let flat = picture(&Plane::filled(width, height, [0.3; 3]), &Options::default());
            assert!(flat.as_slice().iter().all(|p| *p == flat.at(0, 0)), "{width}x{height}");
            assert!(flat.at(0, 0)[0] > 80, "{:?}", flat.at(0, 0));
        }
    }
}
