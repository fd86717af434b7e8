//! The motions of all frames, and the relative depths of the patches, from the displacements of the patches.
//!
//! In: the [`Observation`]s of each frame. Out: a [`Geometry`], and how well it explains the observations. Cost: some
//! hundred multiply-adds for each observation and round. Source: alternating robust least squares: given the depths,
//! the motions of the frames are independent; given the motions, the depths of the patches are. The weights are those
//! of Geman & McClure; their scale is large at first (graduated non-convexity, Blake & Zisserman 1987).
//!
//! `observations`: the displacements of patches. `direction`: the start. `camera_motion`: the parameters of a camera.

pub(super) mod camera_motion;
mod direction;
pub(super) mod observations;

use crate::align::depth::geometry::camera_motion::{CameraMotion, EXPECTED_PX, PARAMETERS};
use crate::align::depth::geometry::direction::Start;
use crate::align::depth::geometry::observations::Observation;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// A frame with fewer observations has no motion.
const LEAST_OBSERVED: usize = 100;
/// Number of rounds.
const ROUNDS: usize = 30;
/// In the first rounds, weights fall less with the misfit.
const CONVEX_ROUNDS: usize = 10;
/// Scale of the misfits in the first round, in standard deviations, and its factor from round to round, down to 1.
const FIRST_SCALE: (f64, f64) = (16.0, 0.8);
/// Steps for the motion of a frame in a round: in the first, and in the others.
const STEPS: (usize, usize) = (10, 2);
/// An observation is unexplained if its misfit is more than this, in variances.
const MOST_MISFIT: f64 = 9.0;
/// There is depth to be measured if one homography for each frame leaves at least this share of the observations
/// unexplained,
pub(super) const LEAST_DISPLACED: f64 = 0.02;
/// and if depth leaves at most this share of them unexplained. Things that move by themselves are not explained by
/// depth. On rendered scenes, the share is at most 0.2 with depth, and at least 0.7 with leaves and persons that move.
const MOST_UNEXPLAINED: f64 = 0.33;
/// A frame that was rejected is placed only if the depths that other frames show leave at most this share of its
/// observations unexplained. With a wrong transform, or in another scene, patches match by chance.
const MOST_UNEXPLAINED_ALONE: f64 = 0.15;

/// The motions of all frames.
#[derive(Debug, Clone)]
pub(super) struct Geometry {
    /// The motion of each frame; none for frames with too few observations.
    pub(super) motions: Vec<Option<CameraMotion>>,
    /// The relative depth of each patch; none for patches without an observation.
    pub(super) depths: Vec<Option<f64>>,
    /// How well depth explains the observations of each frame.
    pub(super) explained: Vec<Explained>,
}

/// How well the motion of a frame explains its observations.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Explained {
    /// Number of observations of patches whose depth is known.
    count: usize,
    /// Number of observations that one homography leaves unexplained,
    without_depth: usize,
    /// and that are unexplained with depth.
    with_depth: usize,
    /// Root mean square distance of the explained observations from the motion, in pixels of the level. Each counts by
    /// its precision, along the direction in which it is precise.
    pub(super) rms: f64,
    /// Median distance of the unexplained observations from the motion, in pixels of the level; 0 if there are none.
    pub(super) off: f64,
}

impl Explained {
    /// The share of the observations that is unexplained with depth, 0..=1; 1 if there are too few.
    pub(super) fn unexplained(&self) -> f64 {
        if self.count < LEAST_OBSERVED { 1.0 } else { self.with_depth as f64 / self.count as f64 }
    }

    /// Whether there is something that homographies leave unexplained, and depth explains most of it.
    fn is_depth(&self) -> bool {
        let (with, without) = (self.with_depth as f64, self.without_depth as f64);
        without >= LEAST_DISPLACED * self.count as f64 && without > 0.0 && with <= MOST_UNEXPLAINED * without
    }

    /// Whether the depth that other frames show explains a frame that was rejected because parts of it disagree with one
    /// homography.
    pub(super) fn is_convincing(&self) -> bool {
        self.unexplained() <= MOST_UNEXPLAINED_ALONE
    }
}

impl Geometry {
    /// Whether depth explains what homographies leave unexplained.
    pub(super) fn is_depth(&self) -> bool {
        let sum = |of: fn(&Explained) -> usize| self.explained.iter().map(of).sum();
        let (count, without_depth, with_depth) = (sum(|e| e.count), sum(|e| e.without_depth), sum(|e| e.with_depth));
        Explained { count, without_depth, with_depth, ..Explained::default() }.is_depth()
    }
}

impl Geometry {
    /// How well the depths explain another frame, whose patches did not contribute to them. A frame of another scene
    /// matches at displacements that these depths do not explain.
    pub(super) fn explains(&self, observations: &[Observation], unit: f64) -> Explained {
        let depth = |o: &Observation| self.depths.get(o.patch).copied().flatten();
        let known: Vec<(&Observation, f64)> = observations.iter().filter_map(|o| Some((o, depth(o)?))).collect();
        if known.len() < LEAST_OBSERVED {
            return Explained::default();
        }
        let without = direction::search(observations).without_depth();
        let mut motion = without;
        for round in 0..ROUNDS {
            motion = step(&motion, &known, unit, &weight(round));
        }
        explained(observations, [&without, &motion], &self.depths, unit)
    }
}

/// The weight of an observation with a misfit, in variances.
fn weight(round: usize) -> impl Fn(f64) -> f64 {
    let scale = (FIRST_SCALE.0 * power(FIRST_SCALE.1, round)).max(1.0);
    move |misfit: f64| {
        let w = 1.0 / (1.0 + misfit / (scale * scale)).sqrt();
        if round < CONVEX_ROUNDS { w } else { w * w }
    }
}

/// Computes the motions from the observations of each frame; none if no frame has enough observations. `unit` is the
/// unit of the coordinates, in pixels.
pub(super) fn fit(frames: &[&[Observation]], patches: usize, unit: f64) -> Option<Geometry> {
    let starts: Vec<Option<Start>> =
        frames.iter().map(|f| (f.len() >= LEAST_OBSERVED).then(|| direction::search(f))).collect();
    // The frame with most parallax gives the first depths.
    let gain = |i: &usize| starts[*i].as_ref().map_or(0.0, |s| s.gain * frames[*i].len() as f64);
    let first = (0..frames.len()).filter(|&i| starts[i].is_some()).max_by(|a, b| gain(a).total_cmp(&gain(b)))?;
    let mut depths = vec![None; patches];
    let start = starts[first].as_ref()?;
    for observation in frames[first] {
        depths[observation.patch] = Some(start.depth(observation));
    }
    let mut motions: Vec<Option<CameraMotion>> = vec![None; frames.len()];
    for round in 0..ROUNDS {
        let weight = weight(round);
        for (i, observations) in frames.iter().enumerate() {
            let Some(start) = &starts[i] else { continue };
            let (mut motion, steps) = motions[i].map_or_else(|| (start.without_depth(), STEPS.0), |m| (m, STEPS.1));
            let known: Vec<(&Observation, f64)> =
                observations.iter().filter_map(|s| Some((s, depths[s.patch]?))).collect();
            if known.len() < LEAST_OBSERVED {
                continue;
            }
            for _ in 0..steps {
                motion = step(&motion, &known, unit, &weight);
            }
            motions[i] = Some(motion);
        }
        refit_depths(frames, &motions, &mut depths, unit, &weight);
        normalise(&mut motions, &mut depths);
    }
    let explained = (0..frames.len()).map(|i| match (&starts[i], &motions[i]) {
        (Some(start), Some(motion)) => explained(frames[i], [&start.without_depth(), motion], &depths, unit),
        _ => Explained::default(),
    });
    let explained = explained.collect();
    Some(Geometry { motions, depths, explained })
}

/// How well motions without and with depth explain `observations`.
fn explained(
    observations: &[Observation],
    [without, with]: [&CameraMotion; 2],
    depths: &[Option<f64>],
    unit: f64,
) -> Explained {
    let mut explained = Explained::default();
    let (mut squares, mut precisions, mut off) = (0.0, 0.0, Vec::new());
    for (observation, depth) in observations.iter().filter_map(|s| Some((s, depths[s.patch]?))) {
        explained.count += 1;
        explained.without_depth +=
            usize::from(observation.misfit(without.displacement(observation.at, 0.0, unit)) > MOST_MISFIT);
        let d = with.displacement(observation.at, depth, unit);
        let misfit = observation.misfit(d);
        if misfit > MOST_MISFIT {
            off.push((observation.displacement - Vector2::from(d)).norm());
        } else {
            squares += misfit;
            precisions += 0.5 * observation.precision.trace();
        }
    }
    off.sort_by(f64::total_cmp);
    let rms = (squares / f64::max(precisions, 1e-9)).sqrt();
    Explained { with_depth: off.len(), rms, off: off.get(off.len() / 2).copied().unwrap_or(0.0), ..explained }
}

/// `base` to the power of `n`.
fn power(base: f64, n: usize) -> f64 {
    (0..n).fold(1.0, |product, _| product * base)
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

/// Computes the depth of every patch that a frame with a motion shows.
fn refit_depths(
    frames: &[&[Observation]],
    motions: &[Option<CameraMotion>],
    depths: &mut [Option<f64>],
    unit: f64,
    weight: &impl Fn(f64) -> f64,
) {
    let mut sums = vec![(0.0, 0.0); depths.len()];
    for (observations, motion) in frames.iter().zip(motions) {
        let Some(motion) = motion else { continue };
        for observation in *observations {
            let before = depths[observation.patch];
            let q = before.unwrap_or(0.0);
            let d = motion.displacement(observation.at, q, unit);
            let g = Vector2::from(motion.by_depth(observation.at));
            let r = observation.displacement - Vector2::from(d) + g * q;
            let w = if before.is_some() { weight(observation.misfit(d)) } else { 1.0 };
            let pulled: Matrix2<f64> = observation.precision * w;
            let sum = &mut sums[observation.patch];
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
