//! The motions of all frames, and the relative depths of the patches, from the displacements of the patches.
//!
//! In: the [`Observation`]s of each frame. Out: a [`Geometry`], and how well it explains the observations. Cost: some
//! hundred multiply-adds for each observation and round. Source: alternating robust least squares: given the depths,
//! the motions of the frames are independent; given the motions, the depths of the patches are.
//!
//! `direction`: the start. `camera_motion`: the parameters of a camera. `patch_depths`: the depths, and whether frames
//! predict those of each other.

pub(super) mod camera_motion;
mod direction;
mod patch_depths;

use crate::align::following::MOST_FITTED;
use crate::align::following::depth::geometry::camera_motion::{CameraMotion, PARAMETERS};
use crate::align::following::depth::geometry::direction::Start;
use crate::align::following::depth::geometry::patch_depths::{predicted, refit_depths};
use crate::align::following::explained::{Explained, LEAST_OBSERVED, ROUNDS, weight};
use crate::align::following::homography::EXPECTED_PX;
use crate::align::following::observations::Observation;
use nalgebra::{SMatrix, SVector, Vector2};
use std::ops::Range;

/// Steps for the motion of a frame in a round: in the first, and in the others.
const STEPS: (usize, usize) = (10, 2);
/// Rounds in which the depths of all patches are computed, after the motions.
const DEPTH_ROUNDS: Range<usize> = ROUNDS - 10..ROUNDS;

/// The depths that the other frames show leave at most this share of the misfits of a frame. On rendered scenes, the
/// share is 0.04 to 0.67 with depth, and at least 0.92 with leaves, smeared frames, noise and people.
const MOST_LEFT_BY_OTHERS: f64 = 0.8;

/// The golden ratio.
const GOLDEN: f64 = 1.618_033_988_749_895;

/// The motions of all frames.
#[derive(Debug, Clone)]
pub(super) struct Geometry {
    /// The motion of each frame; none for frames with too few observations.
    pub(super) motions: Vec<Option<CameraMotion>>,
    /// The relative depth of each patch; none for patches without an observation.
    pub(super) depths: Vec<Option<f64>>,
    /// How well depth explains the observations of each frame.
    pub(super) explained: Vec<Explained>,
    /// What remains of the misfits that homographies leave if the depth of each patch is what the other frames show;
    /// none if no patch was observed in two frames.
    predicted: Option<f64>,
}

impl Geometry {
    /// Whether depth explains what homographies leave unexplained, and the frames agree about it. Depths can be chosen
    /// so that they explain one frame, even if it is only smeared; but then the other frames do not predict them.
    pub(super) fn is_depth(&self) -> bool {
        Explained::are_better(&self.explained) && self.predicted.is_none_or(|left| left <= MOST_LEFT_BY_OTHERS)
    }
}

/// Computes the motions from the observations of each frame; none if no frame has enough observations. `unit` is the
/// unit of the coordinates, in pixels. The motions have few parameters, so some of the patches determine them.
pub(super) fn fit(frames: &[&[Observation]], patches: usize, unit: f64) -> Option<Geometry> {
    let some = some_patches(frames);
    let starts: Vec<Option<Start>> =
        some.iter().map(|f| (f.len() >= LEAST_OBSERVED).then(|| direction::search(f))).collect();
    // The frame with most parallax gives the first depths.
    let gain = |i: &usize| starts[*i].as_ref().map_or(0.0, |s| s.gain * some[*i].len() as f64);
    let first = (0..some.len()).filter(|&i| starts[i].is_some()).max_by(|a, b| gain(a).total_cmp(&gain(b)))?;
    let mut depths = vec![None; patches];
    let start = starts[first].as_ref()?;
    for observation in &some[first] {
        depths[observation.patch] = Some(start.depth(observation));
    }
    let mut motions: Vec<Option<CameraMotion>> = vec![None; frames.len()];
    let some: Vec<&[Observation]> = some.iter().map(Vec::as_slice).collect();
    for round in 0..ROUNDS {
        let weight = weight(round);
        for (motion, (start, observations)) in motions.iter_mut().zip(starts.iter().zip(&some)) {
            *motion =
                start.as_ref().and_then(|start| refit_motion(motion, start, observations, &depths, unit, &weight));
        }
        refit_depths(&some, &motions, &mut depths, unit, &weight);
        normalise(&mut motions, &mut depths);
    }
    for round in DEPTH_ROUNDS {
        refit_depths(frames, &motions, &mut depths, unit, &weight(round));
    }
    normalise(&mut motions, &mut depths);
    let explained = (0..frames.len()).map(|i| match (&starts[i], &motions[i]) {
        (Some(start), Some(motion)) => explained(frames[i], &start.without_depth(), motion, &depths, unit),
        _ => Explained::default(),
    });
    let explained = explained.collect();
    let predicted = predicted(frames, &starts, &motions, &depths, unit);
    Some(Geometry { motions, depths, explained, predicted })
}

/// The observations of some patches, the same in all frames: about [`MOST_FITTED`] of the frame with most
/// observations.
fn some_patches(frames: &[&[Observation]]) -> Vec<Vec<Observation>> {
    let most = frames.iter().map(|observations| observations.len()).max().unwrap_or(0);
    let share = (MOST_FITTED as f64 / most as f64).min(1.0);
    // The fractional parts of the multiples of the golden ratio are evenly spread over 0..1.
    let is_taken = |o: &&Observation| o.patch as f64 * GOLDEN % 1.0 <= share;
    frames.iter().map(|observations| observations.iter().filter(is_taken).copied().collect()).collect()
}

/// How well the `motion` of a frame and the depths explain its `observations`.
fn explained(
    observations: &[Observation],
    plain: &CameraMotion,
    motion: &CameraMotion,
    depths: &[Option<f64>],
    unit: f64,
) -> Explained {
    let predicted = |o: &Observation| Some(motion.displacement(o.at, depths[o.patch]?, unit));
    Explained::new(observations, |o| plain.displacement(o.at, 0.0, unit), predicted)
}

/// One Gauss-Newton step of the motion of a frame whose depths are known.
fn step(motion: &CameraMotion, known: &[(&Observation, f64)], unit: f64, weight: &impl Fn(f64) -> f64) -> CameraMotion {
    let mut normal = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
    let mut right = SVector::<f64, PARAMETERS>::zeros();
    for &(observation, q) in known {
        let d = motion.displacement(observation.at, q, unit);
        let r = observation.displacement - Vector2::from(d);
        let jacobian = SMatrix::from_rows(&CameraMotion::by_parameters(observation.at, q).map(|row| row.transpose()));
        let weighed = jacobian.transpose() * (observation.precision * weight(observation.misfit(d)));
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

/// Computes the motion of a frame from the depths of its patches, beginning with `motion`, or else with `start`.
/// Without enough depths, `motion` remains.
fn refit_motion(
    motion: &Option<CameraMotion>,
    start: &Start,
    observations: &[Observation],
    depths: &[Option<f64>],
    unit: f64,
    weight: &impl Fn(f64) -> f64,
) -> Option<CameraMotion> {
    let known: Vec<(&Observation, f64)> = observations.iter().filter_map(|o| Some((o, depths[o.patch]?))).collect();
    if known.len() < LEAST_OBSERVED {
        return *motion;
    }
    let (first, steps) = motion.map_or_else(|| (start.without_depth(), STEPS.0), |motion| (motion, STEPS.1));
    Some((0..steps).fold(first, |motion, _| step(&motion, &known, unit, weight)))
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
