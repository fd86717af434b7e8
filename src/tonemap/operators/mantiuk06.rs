//! Contrast processing: attenuates the perceived contrasts between neighbours at every scale, and reconstructs the
//! picture that has them.
//!
//! In: a scene. Out: its tones. Cost: 2 us of core time per cell; 0.4 s for the largest grid (`log_range::CELLS`
//! cells). Source: Mantiuk, Myszkowski, Seidel, "A Perceptual Framework for Contrast Processing of High Dynamic Range
//! Images" (2006): section 3 (the pyramid of contrasts), 4 (the response to contrast), 5 (back to luminance), 6.1
//! (contrast mapping), 6.2 (contrast equalisation).

use crate::plane::Plane;
use crate::tonemap::overview::Scene;
use crate::tonemap::settings::Setting;
use crate::tonemap::solvers::log_range::LogRange;
use crate::tonemap::solvers::poisson::{Multigrid, conjugate_gradients, divergence};
use crate::tonemap::tones::Tones;

/// Settings of the operator.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// Factor on the eye's response to each contrast: smaller values give a more even picture with stronger detail.
    pub contrast: f64,
    /// Strength of the equalisation of responses: 0 is none, 1 is complete. At 0.5 the noise of skies stays weaker than
    /// the texture of the scene.
    pub equalise: f64,
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
        Options { contrast: 0.3, equalise: 0.5, range_stops: 6.0, brightness: 0.43, saturation: 1.0 }
    }
}

impl Options {
    /// Returns the settings, each with its name, range and description.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::number(
                "contrast",
                (0.02, 1.0),
                &mut self.contrast,
                "factor on the perceived contrast: smaller values give a more even picture with stronger detail",
            ),
            Setting::number(
                "equalise",
                (0.0, 1.0),
                &mut self.equalise,
                "equalisation of contrasts: 0 none, 1 full, where weak and strong contrasts occur equally often",
            ),
            Setting::range(&mut self.range_stops),
            Setting::brightness(&mut self.brightness),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// The coarsest scale has a shorter side of at least this many cells, unless the picture is smaller.
const COARSEST: usize = 3;

/// Relative error at which the solver stops. For a range of ten stops it is a hundredth of a stop.
const TOLERANCE: f64 = 1e-3;

/// Largest number of iterations of the solver; 15 to 30 are needed.
const MOST_STEPS: usize = 60;

/// Returns the tones of `scene`.
pub fn mantiuk06(scene: &Scene, options: &Options) -> Tones {
    let range = LogRange { stops: options.range_stops, brightness: options.brightness, saturation: options.saturation };
    range.tones(scene, |logs| processed(logs, options))
}

/// Returns `logs`, in stops, with mapped contrasts.
fn processed(logs: &Plane<f32>, options: &Options) -> Plane<f32> {
    let mut log10 = logs.clone();
    log10.as_mut_slice().iter_mut().for_each(|l| *l *= std::f32::consts::LOG10_2);
    let mut pyramid = contrasts(log10);
    map(&mut pyramid, options);
    let mut tones = with_contrasts(&pyramid);
    tones.as_mut_slice().iter_mut().for_each(|l| *l *= std::f32::consts::LOG2_10);
    tones
}

/// The contrasts of one scale. A contrast is the log10 of the luminance of a neighbour divided by the luminance of the
/// cell.
#[derive(Debug, Clone)]
struct Contrasts {
    /// First the contrasts to the right neighbours, with 0 in the last column; then the contrasts to the lower
    /// neighbours, with 0 in the last row.
    to: [Plane<f32>; 2],
}

impl Contrasts {
    fn of(level: &Plane<f32>) -> Self {
        let (width, height) = (level.width(), level.height());
        let right = Plane::from_rows(width, height, |y, row| {
            for (c, pair) in row.iter_mut().zip(level.row(y).windows(2)) {
                *c = pair[1] - pair[0];
            }
        });
        let down = Plane::from_rows(width, height, |y, row| {
            let below = level.row((y + 1).min(height - 1));
            for (c, (b, h)) in row.iter_mut().zip(below.iter().zip(level.row(y))) {
                *c = b - h;
            }
        });
        Contrasts { to: [right, down] }
    }

    /// Replaces each contrast c by `change(c, o)`, where o is the contrast at the same place in `other`.
    fn changed(mut self, other: &Contrasts, change: impl Fn(f32, f32) -> f32 + Sync) -> Contrasts {
        for (plane, other) in self.to.iter_mut().zip(&other.to) {
            let width = plane.width();
            plane.fill_bands(|rows, band| {
                for (y, row) in rows.zip(band.chunks_exact_mut(width)) {
                    row.iter_mut().zip(other.row(y)).for_each(|(c, o)| *c = change(*c, *o));
                }
            });
        }
        self
    }

    fn weighted(self, weights: &Contrasts) -> Contrasts {
        self.changed(weights, |c, w| c * w)
    }
}

/// Returns the contrasts of `level` and of all coarser scales (section 3).
fn contrasts(mut level: Plane<f32>) -> Vec<Contrasts> {
    let mut pyramid = vec![Contrasts::of(&level)];
    while level.width().min(level.height()) >= 2 * COARSEST {
        level = halved(&level);
        pyramid.push(Contrasts::of(&level));
    }
    pyramid
}

/// Returns the means of 2 x 2 cells. At the right and the lower border, only the cells that exist are averaged.
fn halved(plane: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (plane.width(), plane.height());
    Plane::from_rows(width.div_ceil(2), height.div_ceil(2), |y, row| {
        let (upper, lower) = (plane.row(2 * y), plane.row((2 * y + 1).min(height - 1)));
        for (v, (a, b)) in row.iter_mut().zip(upper.chunks(2).zip(lower.chunks(2))) {
            *v = 0.25 * (a[0] + b[0] + a[a.len() - 1] + b[b.len() - 1]);
        }
    })
}

/// Adds the transpose of [`halved`], applied to `coarse`, to `fine`.
fn add_spread(fine: &mut Plane<f32>, coarse: &Plane<f32>) {
    let (width, height) = (fine.width(), fine.height());
    let share = |at: usize, of: usize| if at + 1 == of && of % 2 == 1 { 1.0f32 } else { 0.5 };
    fine.fill_bands(|rows, band| {
        for (y, row) in rows.zip(band.chunks_exact_mut(width)) {
            let (part, from) = (share(y, height), coarse.row(y / 2));
            for (pair, c) in row.chunks_mut(2).zip(from) {
                let across = if pair.len() == 1 { 1.0 } else { 0.5 };
                pair.iter_mut().for_each(|v| *v += part * across * c);
            }
        }
    });
}

/// Equalises the responses to contrasts, then scales them (section 6).
fn map(pyramid: &mut [Contrasts], options: &Options) {
    let scale = options.contrast as f32;
    if options.equalise == 0.0 {
        for level in pyramid {
            for c in level.to.iter_mut().flat_map(Plane::as_mut_slice) {
                *c = inverse(scale * response(c.abs())).copysign(*c);
            }
        }
        return;
    }
    // Section 6.2: the combined response of both directions.
    let both = |level: &Contrasts| -> Vec<f32> {
        let pairs = level.to[0].as_slice().iter().zip(level.to[1].as_slice());
        pairs.map(|(right, down)| libm::hypotf(response(right.abs()), response(down.abs()))).collect()
    };
    let mut sorted: Vec<f32> = pyramid.iter().flat_map(both).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let (count, most) = (sorted.len() as f32, sorted[sorted.len() - 1]);
    let part = options.equalise as f32;
    for level in pyramid {
        let strengths = both(level);
        for plane in &mut level.to {
            for (c, &strength) in plane.as_mut_slice().iter_mut().zip(&strengths) {
                let equal = most * sorted.partition_point(|s| *s < strength) as f32 / count;
                let factor = (1.0 - part) + part * equal / strength.max(1e-6);
                *c = inverse(scale * factor * response(c.abs())).copysign(*c);
            }
        }
    }
}

/// The contrast threshold, log10.
const SEEN: f32 = 0.0043;
/// The contrast (log10) above which the discrimination threshold follows the power law of section 4.
const BEND: f32 = 0.016_777_934;

/// Section 4: the discrimination threshold of a contrast G is FACTOR G^POWER.
const FACTOR: f32 = 0.038_737;
const POWER: f32 = 0.537_756;

fn least_difference(contrast: f32) -> f32 {
    if contrast < BEND { SEEN } else { FACTOR * libm::powf(contrast, POWER) }
}

/// Returns the response to a contrast (log10), in just noticeable differences (section 4). It is the integral of 1 /
/// [`least_difference`] from 0 to the contrast.
fn response(contrast: f32) -> f32 {
    if contrast < BEND {
        return contrast / SEEN;
    }
    let rising = |c: f32| libm::powf(c, 1.0 - POWER) / (FACTOR * (1.0 - POWER));
    BEND / SEEN + rising(contrast) - rising(BEND)
}

/// Returns the contrast that has this [`response`].
fn inverse(response: f32) -> f32 {
    if response < BEND / SEEN {
        return response * SEEN;
    }
    let at_bend = libm::powf(BEND, 1.0 - POWER);
    libm::powf(at_bend + (response - BEND / SEEN) * FACTOR * (1.0 - POWER), 1.0 / (1.0 - POWER))
}

/// Returns the picture whose contrasts at all scales are nearest to the contrasts in `pyramid`. Differences are
/// weighted by their visibility (section 5).
fn with_contrasts(pyramid: &[Contrasts]) -> Plane<f32> {
    let visibility = |level: &Contrasts| level.clone().changed(level, |_, c| SEEN / least_difference(c.abs()));
    let weights: Vec<Contrasts> = pyramid.iter().map(visibility).collect();
    let target: Vec<Contrasts> = pyramid.iter().zip(&weights).map(|(level, w)| level.clone().weighted(w)).collect();
    let grid = Multigrid::new((pyramid[0].to[0].width(), pyramid[0].to[0].height()));
    conjugate_gradients(
        &gathered(&target),
        |plane| normal(plane, &weights),
        |residual| grid.cycle(residual),
        TOLERANCE,
        MOST_STEPS,
    )
}

/// Applies the matrix of the weighted normal equations, which is symmetric.
fn normal(plane: &Plane<f32>, weights: &[Contrasts]) -> Plane<f32> {
    let levels = contrasts(plane.clone()).into_iter().zip(weights);
    gathered(&levels.map(|(level, w)| level.weighted(w)).collect::<Vec<_>>())
}

/// Applies the transpose of [`contrasts`].
fn gathered(pyramid: &[Contrasts]) -> Plane<f32> {
    let mut sum: Option<Plane<f32>> = None;
    for level in pyramid.iter().rev() {
        let mut here = divergence(&level.to[0], &level.to[1]);
        if let Some(coarser) = sum {
            add_spread(&mut here, &coarser);
        }
        sum = Some(here);
    }
    sum.unwrap_or_else(|| Plane::filled(0, 0, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;
    use crate::tonemap::overview::Overview;

    /// Returns the log2 luminance of two textured halves; the right one is six stops brighter.
    fn logs(width: usize, height: usize) -> Plane<f32> {
        Plane::from_rows(width, height, |y, row| {
            for (x, l) in row.iter_mut().enumerate() {
                let wave = 0.1 * ((x as f32 * 0.9).sin() + (y as f32 * 0.7).cos());
                *l = if x > width / 2 { 6.0 } else { 0.0 } + wave;
            }
        })
    }

    fn picture(map: &Plane<[f32; 3]>, options: &Options) -> Plane<[u8; 3]> {
        let mut overview = Overview::new((map.width(), map.height()), &Primaries::SRGB);
        overview.see(0, map);
        mantiuk06(&overview.scene().unwrap(), options).picture(map)
    }

    fn radiance(logs: &Plane<f32>, factor: f32) -> Plane<[f32; 3]> {
        let pixels = logs.as_slice().iter().map(|&l| [1.0, 0.8, 0.6].map(|c| c * factor * libm::exp2f(l)));
        Plane::from_vec(logs.width(), logs.height(), pixels.collect())
    }

    fn dot(a: &Plane<f32>, b: &Plane<f32>) -> f64 {
        a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    }

    /// The slope of `response` is 1 / (discrimination threshold), and `inverse` is the inverse function of `response`.
    #[test]
    fn the_response_counts_differences_that_are_just_seen() {
        assert!((least_difference(0.999_999 * BEND) - FACTOR * BEND.powf(POWER)).abs() < 1e-7, "no step at the bend");
        for contrast in [0.001f32, 0.01, 0.02, 0.1, 0.5, 2.0, 4.0] {
            let slope = (response(1.001 * contrast) - response(contrast)) / (0.001 * contrast);
            // The tolerance is 2 %, because the slope is a difference of f32 values up to 100 over an interval of
            // 0.001.
            assert!((slope * least_difference(contrast) - 1.0).abs() < 0.02, "{contrast}: {slope}");
            assert!((inverse(response(contrast)) / contrast - 1.0).abs() < 1e-4);
        }
    }

    /// For the expected result, [`contrasts`] is written as a dense matrix with a column for each unit vector, and its
    /// weighted normal equations are solved in `f64`.
    #[test]
    fn solution_minimises_the_weighted_squares() {
        for (w, h) in [(13, 9), (7, 12), (2, 3)] {
            let n = w * h;
            // The compressed contrasts do not belong to any picture.
            let compressed =
                |level: &Contrasts| level.clone().changed(level, |c, _| inverse(0.3 * response(c.abs())).copysign(c));
            let pyramid: Vec<Contrasts> = contrasts(logs(w, h)).iter().map(compressed).collect();
            let flat = |p: &[Contrasts]| -> Vec<f64> {
                p.iter().flat_map(|l| l.to.iter().flat_map(|p| p.as_slice().iter().map(|v| f64::from(*v)))).collect()
            };
            let columns: Vec<Vec<f64>> = (0..n)
                .map(|i| {
                    let mut one = Plane::filled(w, h, 0.0f32);
                    one.as_mut_slice()[i] = 1.0;
                    flat(&contrasts(one))
                })
                .collect();
            let target = flat(&pyramid);
            let weight: Vec<f64> = target.iter().map(|t| f64::from(SEEN / least_difference(t.abs() as f32))).collect();
            let product = |a: &[f64], b: &[f64]| (0..a.len()).map(|k| a[k] * weight[k] * b[k]).sum::<f64>();
            let matrix = nalgebra::DMatrix::from_fn(n, n, |i, j| product(&columns[i], &columns[j]) + 1.0);
            let vector = nalgebra::DVector::from_fn(n, |i, _| product(&columns[i], &target));
            let expected = matrix.cholesky().unwrap().solve(&vector);
            let found = with_contrasts(&pyramid);
            let mean = found.as_slice().iter().map(|v| f64::from(*v)).sum::<f64>() / n as f64;
            for (a, b) in found.as_slice().iter().zip(expected.iter()) {
                // The expected error is [`TOLERANCE`] (a thousandth) times the picture's range of some units; 0.01
                // leaves a margin.
                assert!((f64::from(*a) - mean - b).abs() < 0.01, "{w}x{h}: {a} {b}");
            }
        }
    }

    /// Conjugate gradients require that [`gathered`], C', is the transpose of [`contrasts`], C: <C a, b> = <a, C' b>.
    #[test]
    fn gathering_is_the_transpose_of_taking_contrasts() {
        let (a, b) = (logs(21, 14), logs(28, 21));
        let b = Plane::from_rows(21, 14, |y, row| row.copy_from_slice(&b.row(y + 5)[3..24]));
        let (of_a, of_b) = (contrasts(a.clone()), contrasts(b));
        let pairs = of_a.iter().zip(&of_b).flat_map(|(a, b)| a.to.iter().zip(&b.to));
        let (one, other) = (pairs.map(|(a, b)| dot(a, b)).sum::<f64>(), dot(&a, &gathered(&of_b)));
        assert!((one - other).abs() < 1e-4 * one.abs(), "{one} {other}");
    }

    #[test]
    fn mantiuk06_without_scaling_changes_nothing() {
        let logs = logs(120, 77);
        let same = processed(&logs, &Options { contrast: 1.0, equalise: 0.0, ..Options::default() });
        let shift = logs.at(0, 0) - same.at(0, 0);
        assert!(logs.as_slice().iter().zip(same.as_slice()).all(|(a, b)| (a - b - shift).abs() < 0.03));
    }

    /// The edge of six stops shrinks more than the texture, and with equalisation this difference is greater.
    #[test]
    fn strong_contrasts_are_weakened_more() {
        let before = logs(160, 100);
        let mean = |p: &Plane<f32>, range: std::ops::Range<usize>| {
            p.row(50)[range.clone()].iter().sum::<f32>() / range.len() as f32
        };
        let edge = |p: &Plane<f32>| mean(p, 86..100) - mean(p, 60..74);
        let swing = |p: &Plane<f32>| {
            let row = &p.row(50)[20..60];
            row.iter().fold(f32::MIN, |a, &v| a.max(v)) - row.iter().fold(f32::MAX, |a, &v| a.min(v))
        };
        let relative = |options: &Options| {
            let after = processed(&before, options);
            edge(&after) / edge(&before) / (swing(&after) / swing(&before))
        };
        let mapped = relative(&Options { contrast: 0.4, equalise: 0.0, ..Options::default() });
        let equalised = relative(&Options { contrast: 0.4, equalise: 1.0, ..Options::default() });
        assert!(mapped > 0.0 && mapped < 0.7, "{mapped}");
        assert!(equalised > 0.0 && equalised < mapped, "{equalised} {mapped}");
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
            for equalise in [0.0, 1.0] {
                let map = Plane::filled(width, height, [0.3; 3]);
                let flat = picture(&map, &Options { equalise, ..Options::default() });
                assert!(flat.as_slice().iter().all(|p| *p == flat.at(0, 0)), "{width}x{height}");
                assert!(flat.at(0, 0)[0] > 80, "{:?}", flat.at(0, 0));
            }
        }
    }
}
