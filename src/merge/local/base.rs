//! The base of a locally processed frame, and the curve with which the phone compressed it.
//!
//! In: the logarithm of each frame's exposure on cells. Out: for each cell the base as a function of the logarithm of a
//! pixel, and the curve that maps the base of a frame to the base of the scene. Cost: two box filters over at most 256
//! x 256 cells for each frame, and some passes over the cells of each pair of frames. Source: base and detail as in
//! Durand & Dorsey 2002. The base is the result of the guided filter (He, Sun & Tang 2013) on the logarithm of
//! luminance, guided by itself, computed on cells and interpolated (He & Sun 2015). The curve is recovered like a
//! camera response (Debevec & Malik 1997), from bases instead of code values.
//!
//! A local tone mapping compresses the base and keeps the details. An edge of several stops is part of the base,
//! otherwise there would be halos. A phone renders each frame independently. The rendering of a base depends only on
//! that base, so one curve is valid for all frames and places. One more stop of exposure raises the original base by
//! one stop.

use crate::plane::Plane;
use crate::pyramid::cells::gathered;
use crate::statistics::{MEDIAN_DEVIATION, biweight, median};
use nalgebra::{SMatrix, SVector};

/// Longer side of the picture divided by the radius of the filter: a neighbourhood is a twelfth of the longer side
/// wide.
const RADIUS: usize = 24;
/// Epsilon of the guided filter, in square stops: in a neighbourhood with this variance, half of a difference belongs
/// to the base. An edge of 2.8 stops through the middle of the neighbourhood has this variance. On 12 rendered brackets
/// of phones, 4 instead of 2 lowers the PU21-PSNR of details by 0.4 dB.
const EDGE: f32 = 2.0;
/// The curve is linear between this many values of the frame's base (knots): at least one for each stop that an 8-bit
/// frame shows.
const KNOTS: usize = 13;
/// Weight of the curve's squared second derivative; the mean squared error has weight 1. On the 12 brackets of
/// [`EDGE`], dividing or multiplying this weight by five changes the PU21-PSNR of details by 0.1 dB.
const SMOOTH: f64 = 0.01;
/// Number of passes of least squares. In the first pass all cells have the same weight; in the others, cells with
/// motion have less.
const PASSES: usize = 6;
/// Tukey's biweight is 0 for errors of at least this many robust standard deviations.
const REACH: f64 = 4.685;
/// The standard deviation of the difference of two bases is assumed to be at least this, in stops. The value is 0.6
/// times the least error that deghosting assumes for a cell: 6 % (0.084 stops).
const LEAST: f64 = 0.05;
/// Allowed range of the slope of the curve, in stops of the scene's base per stop of the frame's base. The slope is at
/// least 1, because a phone compresses and never expands. A slope above the range would amplify noise.
const SLOPES: (f64, f64) = (1.0, 2.5);
/// Smallest number of pairs from which the curve is determined.
const FEWEST: usize = 100;

/// Returns for each cell the coefficients a and b of the base a x + b, where x is the logarithm of a pixel. `stops` are
/// the logarithms of the cells, `None` outside of the frame.
pub(super) fn coefficients(stops: &Plane<Option<f32>>) -> Plane<[f32; 2]> {
    let longer = stops.width().max(stops.height());
    let radius = (longer as f64 / RADIUS as f64).round().max(1.0) as usize;
    let moments = mapped(stops, |v: &Option<f32>| v.map_or([0.0; 3], |v| [v, v * v, 1.0]));
    let own = mapped(&gathered(&moments, radius, add), |[sum, square, count]: &[f32; 3]| {
        if *count == 0.0 {
            return [0.0; 3];
        }
        let mean = sum / count;
        let variance = (square / count - mean * mean).max(0.0);
        let a = variance / (variance + EDGE);
        [a, mean - a * mean, 1.0]
    });
    mapped(&gathered(&own, radius, add), |[a, b, count]: &[f32; 3]| [a / count.max(1.0), b / count.max(1.0)])
}

/// Applies `of` to each value of a plane.
pub(super) fn mapped<S: Sync, T: Copy + Default + Send>(plane: &Plane<S>, of: impl Fn(&S) -> T + Sync) -> Plane<T> {
    Plane::from_rows(plane.width(), plane.height(), |y, row: &mut [T]| {
        row.iter_mut().zip(plane.row(y)).for_each(|(out, v)| *out = of(v));
    })
}

/// Adds the sums `b` of another cell to `a`.
fn add(a: &mut [f32; 3], b: &[f32; 3]) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
}

/// The bases of two frames at one cell, in stops, and the difference of their exposures in stops.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub bases: (f32, f32),
    pub stops: f32,
}

/// The scene's base minus a frame's base, in stops, as a function of the frame's base: linear between knots and beyond
/// them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BaseCurve {
    low: f32,
    step: f32,
    lacks: [f32; KNOTS],
}

impl BaseCurve {
    /// Returns the curve that maps both bases of each pair to bases of the scene that differ by as many stops as the
    /// exposures. The curve is 0 everywhere if there are too few pairs or all bases are equal.
    pub fn of(pairs: &[Pair]) -> BaseCurve {
        BaseCurve::recovered(pairs).unwrap_or(BaseCurve { low: 0.0, step: 1.0, lacks: [0.0; KNOTS] })
    }

    fn recovered(pairs: &[Pair]) -> Option<BaseCurve> {
        if pairs.len() < FEWEST {
            return None;
        }
        let mut bases: Vec<f32> = pairs.iter().flat_map(|pair| [pair.bases.0, pair.bases.1]).collect();
        bases.sort_by(f32::total_cmp);
        // The knots span the bases without the darkest and the brightest 0.5 %, because these few would extend the
        // curve far.
        let few = bases.len() / 200;
        let (low, step) = (bases[few], (bases[bases.len() - 1 - few] - bases[few]) / (KNOTS - 1) as f32);
        if step <= f32::EPSILON {
            return None;
        }
        let values = fitted(pairs, f64::from(low), f64::from(step))?;
        let mut lacks = [0.0f32; KNOTS];
        for k in 1..KNOTS {
            let slope = ((values[k] - values[k - 1]) / f64::from(step)).clamp(SLOPES.0, SLOPES.1);
            lacks[k] = lacks[k - 1] + (slope - 1.0) as f32 * step;
        }
        let mut curve = BaseCurve { low, step, lacks };
        // Base 0, the middle code value, keeps its radiance.
        let middle = curve.at(0.0);
        curve.lacks.iter_mut().for_each(|v| *v -= middle);
        Some(curve)
    }

    /// Returns the scene's base minus the frame's base, in stops, where the frame's base is `v`.
    #[inline(always)]
    pub fn at(&self, v: f32) -> f32 {
        let along = (v - self.low) / self.step;
        let k = (along.max(0.0) as usize).min(KNOTS - 2);
        self.lacks[k] + (along - k as f32) * (self.lacks[k + 1] - self.lacks[k])
    }

    /// Returns the mean slope of the scene's base as a function of the frame's base.
    pub fn slope(&self) -> f64 {
        1.0 + f64::from((self.lacks[KNOTS - 1] - self.lacks[0]) / (self.step * (KNOTS - 1) as f32))
    }
}

/// Fits the scene's base as a function of the frame's base, by smoothed, reweighted least squares. Returns the value of
/// this function at [`KNOTS`] values of the frame's base: `low`, `low + step` and so on.
fn fitted(pairs: &[Pair], low: f64, step: f64) -> Option<SVector<f64, KNOTS>> {
    let between = |v: f32| {
        let along = ((f64::from(v) - low) / step).clamp(0.0, (KNOTS - 1) as f64);
        let k = (along as usize).min(KNOTS - 2);
        (k, along - k as f64)
    };
    // The equation of a pair: f(base of the longer frame) - f(base of the shorter frame) = difference of the exposures.
    // f is the fitted function; its values are interpolated between two knots.
    let row = |pair: &Pair| {
        let ((i, f), (j, g)) = (between(pair.bases.0), between(pair.bases.1));
        [(j, 1.0 - g), (j + 1, g), (i, f - 1.0), (i + 1, -f)]
    };
    // The pairs do not determine a constant offset of the curve. A very small weight towards 0 makes the solution
    // unique.
    let mut smooth = SMatrix::<f64, KNOTS, KNOTS>::from_diagonal_element(1e-6);
    let bend = [1.0, -2.0, 1.0];
    for (k, p, q) in (0..KNOTS - 2).flat_map(|k| (0..9).map(move |i| (k, i / 3, i % 3))) {
        smooth[(k + p, k + q)] += SMOOTH / (step * step * step) * bend[p] * bend[q];
    }
    let mut weights = vec![1.0; pairs.len()];
    let mut values = SVector::zeros();
    for _ in 0..PASSES {
        let (mut normal, mut right) = (smooth, SVector::<f64, KNOTS>::zeros());
        for (pair, weight) in pairs.iter().zip(&weights) {
            let (row, weight) = (row(pair), weight / pairs.len() as f64);
            for (p, u) in row {
                right[p] += weight * u * f64::from(pair.stops);
                for (q, v) in row {
                    normal[(p, q)] += weight * u * v;
                }
            }
        }
        values = normal.cholesky()?.solve(&right);
        let error = |pair: &Pair| row(pair).iter().map(|(p, u)| u * values[*p]).sum::<f64>() - f64::from(pair.stops);
        let errors: Vec<f64> = pairs.iter().map(error).collect();
        let reach = REACH * (median(errors.iter().map(|e| e.abs()))? / MEDIAN_DEVIATION).max(LEAST);
        weights.iter_mut().zip(&errors).for_each(|(weight, e)| *weight = biweight(e / reach));
    }
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns pairs of frames two stops apart. The phone halves the contrast of scene bases from -4 to 1 stops and
    /// keeps it elsewhere; every ninth pair shows motion.
    fn pairs() -> Vec<Pair> {
        let shown = |scene: f32| scene - 0.5 * (scene.clamp(-4.0, 1.0) + 4.0);
        let moved = |i: usize| if i.is_multiple_of(9) { 3.0 } else { 0.0 };
        let pair = |i: usize| {
            let scene = -6.0 + 7.0 * (i as f32 / 3000.0);
            Pair { bases: (shown(scene), shown(scene + 2.0) + moved(i)), stops: 2.0 }
        };
        (0..3000).map(pair).collect()
    }

    #[test]
    fn curve_of_bases_inverts_the_phone_in_spite_of_motion() {
        let curve = BaseCurve::of(&pairs());
        let slope = |v: f32| 1.0 + (curve.at(v + 0.1) - curve.at(v - 0.1)) / 0.2;
        // A scene base of -4 becomes a frame base of -4, and a scene base of 1 becomes -1.5. So the expected slope is 2
        // for frame bases between -4 and -1.5, and 1 elsewhere. The knots are 0.7 stops apart.
        for (v, expected) in [(-5.3, 1.0), (-3.0, 2.0), (-2.5, 2.0), (-0.2, 1.0)] {
            assert!((slope(v) - expected).abs() < 0.25, "{v}: {} {curve:?}", slope(v));
        }
        assert!(curve.at(0.0).abs() < 1e-5 && curve.slope() > 1.2, "{curve:?}");
    }

    #[test]
    fn curve_without_pairs_is_zero() {
        let alike = vec![Pair { bases: (1.0, 1.0), stops: 2.0 }; 300];
        for pairs in [&[][..], &alike] {
            let curve = BaseCurve::of(pairs);
            assert_eq!((curve.at(-3.0), curve.at(2.0), curve.slope()), (0.0, 0.0, 1.0));
        }
    }

    #[test]
    fn base_has_edges_and_not_texture() {
        let step = |stops: f32| {
            Plane::from_rows(240, 160, |y, row: &mut [Option<f32>]| {
                for (x, v) in row.iter_mut().enumerate() {
                    let texture = if (x + y) % 2 == 0 { 0.1 } else { -0.1 };
                    *v = (x < 230).then_some(texture + if x < 120 { -0.5 * stops } else { 0.5 * stops });
                }
            })
        };
        let base = |stops: f32, x: usize, v: f32| {
            let [a, b] = coefficients(&step(stops)).at(x, 80);
            a * v + b
        };
        // Far from the edge the variance is 0.01, so only 0.01 / (0.01 + EDGE) = 0.5 % of a difference belongs to the
        // base.
        assert!((base(4.0, 30, -1.9) + 2.0).abs() < 0.01 && (base(4.0, 30, -2.1) + 2.0).abs() < 0.01);
        // At the edge the variance is 4, so 4 / (4 + EDGE) = two thirds of a difference belong to the base. Cells that
        // the frame does not cover have no influence.
        assert!(base(4.0, 121, 2.0) - base(4.0, 119, -2.0) > 2.2);
        assert!((base(0.0, 229, 0.1)).abs() < 0.01);
    }
}
