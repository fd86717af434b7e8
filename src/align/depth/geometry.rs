//! The motions of all frames, and the relative depths of the patches, from the displacements of the patches.
//!
//! In: the [`Sight`]s of each frame. Out: a [`Geometry`], if depth explains the sights. Cost: some hundred
//! multiply-adds for each sight and round. Source: alternating robust least squares: given the depths, the motions of
//! the frames are independent; given the motions, the depths of the patches are. The weights are those of Geman &
//! McClure; their scale is large at first (graduated non-convexity, Blake & Zisserman 1987).

use crate::align::depth::camera::{CameraMotion, EXPECTED_PX, PARAMETERS};
use crate::align::depth::direction::{self, Start};
use crate::align::depth::sights::Sight;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// A frame with fewer sights has no motion.
const LEAST_SIGHTS: usize = 100;
/// Number of rounds.
const ROUNDS: usize = 30;
/// In the first rounds, weights fall less with the misfit.
const CONVEX_ROUNDS: usize = 10;
/// Scale of the misfits in the first round, in standard deviations, and its factor from round to round, down to 1.
const FIRST_SCALE: (f64, f64) = (16.0, 0.8);
/// Steps for the motion of a frame in a round: in the first, and in the others.
const STEPS: (usize, usize) = (10, 2);
/// A sight is unexplained if its misfit is more than this, in variances.
const MOST_MISFIT: f64 = 9.0;
/// There is depth to be measured if one homography for each frame leaves at least this share of the sights unexplained,
const LEAST_DISPLACED: f64 = 0.02;
/// and if depth leaves at most this share of them unexplained. Things that move by themselves are not explained by
/// depth. On rendered scenes, the share is at most 0.2 with depth, and at least 0.7 with leaves and persons that move.
const MOST_UNEXPLAINED: f64 = 0.33;
/// The motions of all frames.
#[derive(Debug, Clone)]
pub(super) struct Geometry {
    /// The motion of each frame; none for frames with too few sights.
    pub(super) motions: Vec<Option<CameraMotion>>,
    /// The relative depth of each patch; none for patches without a sight.
    pub(super) depths: Vec<Option<f64>>,
}

/// Computes the motions from the sights of each frame; none if no frame has enough sights, or if depth does not explain
/// what homographies leave unexplained. `unit` is the unit of the coordinates, in pixels.
pub(super) fn fit(frames: &[Vec<Sight>], patches: usize, unit: f64) -> Option<Geometry> {
    let starts: Vec<Option<Start>> =
        frames.iter().map(|f| (f.len() >= LEAST_SIGHTS).then(|| direction::search(f))).collect();
    // The frame with most parallax gives the first depths.
    let gain = |i: &usize| starts[*i].as_ref().map_or(0.0, |s| s.gain * frames[*i].len() as f64);
    let first = (0..frames.len()).filter(|&i| starts[i].is_some()).max_by(|a, b| gain(a).total_cmp(&gain(b)))?;
    let mut depths = vec![None; patches];
    let start = starts[first].as_ref()?;
    for sight in &frames[first] {
        depths[sight.patch] = Some(start.depth(sight));
    }
    let mut motions: Vec<Option<CameraMotion>> = vec![None; frames.len()];
    for round in 0..ROUNDS {
        let scale = (FIRST_SCALE.0 * power(FIRST_SCALE.1, round)).max(1.0);
        let weight = |misfit: f64| {
            let w = 1.0 / (1.0 + misfit / (scale * scale)).sqrt();
            if round < CONVEX_ROUNDS { w } else { w * w }
        };
        for (i, sights) in frames.iter().enumerate() {
            let Some(start) = &starts[i] else { continue };
            let (mut motion, steps) = motions[i].map_or_else(|| (start.without_depth(), STEPS.0), |m| (m, STEPS.1));
            let known: Vec<(&Sight, f64)> = sights.iter().filter_map(|s| Some((s, depths[s.patch]?))).collect();
            if known.len() < LEAST_SIGHTS {
                continue;
            }
            for _ in 0..steps {
                motion = step(&motion, &known, unit, weight);
            }
            motions[i] = Some(motion);
        }
        refit_depths(frames, &motions, &mut depths, unit, weight);
        normalise(&mut motions, &mut depths);
    }
    let with_depth = |i: usize, s: &Sight| {
        let motion = motions[i].as_ref()?;
        Some(s.misfit(motion.displacement(s.at, depths[s.patch]?, unit)))
    };
    let without =
        |i: usize, s: &Sight| Some(s.misfit(starts[i].as_ref()?.without_depth().displacement(s.at, 0.0, unit)));
    let share = |misfit: &dyn Fn(usize, &Sight) -> Option<f64>| {
        let all: Vec<f64> =
            frames.iter().enumerate().flat_map(|(i, f)| f.iter().filter_map(move |s| misfit(i, s))).collect();
        all.iter().filter(|&&m| m > MOST_MISFIT).count() as f64 / all.len().max(1) as f64
    };
    let [with, without] = [share(&with_depth), share(&without)];
    (without >= LEAST_DISPLACED && with <= MOST_UNEXPLAINED * without).then_some(Geometry { motions, depths })
}

/// `base` to the power of `n`.
fn power(base: f64, n: usize) -> f64 {
    (0..n).fold(1.0, |product, _| product * base)
}

/// One Gauss-Newton step of the motion of a frame whose depths are known.
fn step(motion: &CameraMotion, known: &[(&Sight, f64)], unit: f64, weight: impl Fn(f64) -> f64) -> CameraMotion {
    let mut normal = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
    let mut right = SVector::<f64, PARAMETERS>::zeros();
    for &(sight, q) in known {
        let d = motion.displacement(sight.at, q, unit);
        let r = sight.displacement - Vector2::from(d);
        let jacobian = jacobian(sight.at, q);
        let weighed = jacobian.transpose() * (sight.precision * weight(sight.misfit(d)));
        normal += weighed * jacobian;
        right += weighed * r;
    }
    let hold = 1.0 / (EXPECTED_PX * EXPECTED_PX);
    for i in 0..PARAMETERS {
        normal[(i, i)] += hold;
    }
    right -= motion.0 * hold;
    CameraMotion(motion.0 + normal.cholesky().map_or_else(SVector::zeros, |c| c.solve(&right)))
}

/// Derivatives of the displacement by the parameters of a motion, for small motions.
fn jacobian([u, v]: [f64; 2], q: f64) -> SMatrix<f64, 2, PARAMETERS> {
    let [x, y] = CameraMotion::by_homography([u, v]);
    let mut rows = SMatrix::<f64, 2, PARAMETERS>::zeros();
    for i in 0..8 {
        rows[(0, i)] = x[i];
        rows[(1, i)] = y[i];
    }
    (rows[(0, 8)], rows[(0, 10)], rows[(1, 9)], rows[(1, 10)]) = (q, -q * u, q, -q * v);
    rows
}

/// Computes the depth of every patch that a frame with a motion shows.
fn refit_depths(
    frames: &[Vec<Sight>],
    motions: &[Option<CameraMotion>],
    depths: &mut [Option<f64>],
    unit: f64,
    weight: impl Fn(f64) -> f64,
) {
    let mut sums = vec![(0.0, 0.0); depths.len()];
    for (sights, motion) in frames.iter().zip(motions) {
        let Some(motion) = motion else { continue };
        for sight in sights {
            let before = depths[sight.patch];
            let q = before.unwrap_or(0.0);
            let d = motion.displacement(sight.at, q, unit);
            let g = Vector2::from(motion.by_depth(sight.at));
            let r = sight.displacement - Vector2::from(d) + g * q;
            let w = if before.is_some() { weight(sight.misfit(d)) } else { 1.0 };
            let pulled: Matrix2<f64> = sight.precision * w;
            let sum = &mut sums[sight.patch];
            *sum = (sum.0 + (pulled * r).dot(&g), sum.1 + (pulled * g).dot(&g));
        }
    }
    for (depth, (pull, precision)) in depths.iter_mut().zip(sums) {
        *depth = (precision > 1e-9).then(|| pull / precision);
    }
}

/// Scales the depths so that their root mean square deviation is 1; the displacements remain the same.
fn normalise(motions: &mut [Option<CameraMotion>], depths: &mut [Option<f64>]) {
    let count = depths.iter().flatten().count().max(1) as f64;
    let mean = depths.iter().flatten().sum::<f64>() / count;
    let square = depths.iter().flatten().map(|q| (q - mean) * (q - mean)).sum::<f64>() / count;
    let scale = square.sqrt().max(1e-9);
    depths.iter_mut().flatten().for_each(|q| *q /= scale);
    for motion in motions.iter_mut().flatten() {
        for i in 8..PARAMETERS {
            motion.0[i] *= scale;
        }
    }
}
