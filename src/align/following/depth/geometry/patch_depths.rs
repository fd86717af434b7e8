//! The relative depth of each patch, from the observations of all frames, or of all but one.
//!
//! In: [`Observation`]s, and the motions of the frames. Out: depths, and how well frames predict those of each other.
//! Cost: some ten multiply-adds for each observation. Source: weighted least squares, one unknown for each patch;
//! `predicted` is a cross-validation by frames (Stone 1974).

use crate::align::following::depth::geometry::camera_motion::CameraMotion;
use crate::align::following::depth::geometry::direction::Start;
use crate::align::following::explained::{ROUNDS, bounded, weight};
use crate::align::following::observations::Observation;
use nalgebra::{Matrix2, Vector2};

/// A patch has no depth if the precision of its depth is at most this.
const LEAST_PRECISION: f64 = 1e-9;

/// What the observations of a patch say about its depth: a pull, and its precision. Their quotient is the depth.
#[derive(Debug, Clone, Copy, Default)]
struct Evidence {
    pull: f64,
    precision: f64,
}

impl Evidence {
    /// The depth, if there is evidence.
    fn depth(self) -> Option<f64> {
        (self.precision > LEAST_PRECISION).then(|| self.pull / self.precision)
    }

    /// The evidence without that of one frame.
    fn without(self, frame: Evidence) -> Evidence {
        Evidence { pull: self.pull - frame.pull, precision: self.precision - frame.precision }
    }

    /// The depth if it is likely to be about 0, with a standard deviation of 1.
    fn likely_depth(self) -> f64 {
        self.pull / (self.precision + 1.0)
    }
}

/// The evidence of the `observations` of a frame for the depths of their patches, which were `depths` before.
fn evidence<'a>(
    observations: &'a [Observation],
    motion: &'a CameraMotion,
    depths: &'a [Option<f64>],
    unit: f64,
    weight: &'a impl Fn(f64) -> f64,
) -> impl Iterator<Item = (usize, Evidence)> + 'a {
    observations.iter().map(move |observation| {
        let before = depths[observation.patch];
        let q = before.unwrap_or(0.0);
        let d = motion.displacement(observation.at, q, unit);
        let g = Vector2::from(motion.by_depth(observation.at));
        let r = observation.displacement - Vector2::from(d) + g * q;
        let w = if before.is_some() { weight(observation.misfit(d)) } else { 1.0 };
        let pulled: Matrix2<f64> = observation.precision * w;
        (observation.patch, Evidence { pull: (pulled * r).dot(&g), precision: (pulled * g).dot(&g) })
    })
}

/// The evidence of all frames with a motion for the depth of each patch.
fn all_evidence(
    frames: &[&[Observation]],
    motions: &[Option<CameraMotion>],
    depths: &[Option<f64>],
    unit: f64,
    weight: &impl Fn(f64) -> f64,
) -> Vec<Evidence> {
    let mut sums = vec![Evidence::default(); depths.len()];
    for (observations, motion) in frames.iter().zip(motions) {
        let Some(motion) = motion else { continue };
        for (patch, evidence) in evidence(observations, motion, depths, unit, weight) {
            let sum = &mut sums[patch];
            *sum = Evidence { pull: sum.pull + evidence.pull, precision: sum.precision + evidence.precision };
        }
    }
    sums
}

/// Computes the depth of every patch that a frame with a motion shows.
pub(super) fn refit_depths(
    frames: &[&[Observation]],
    motions: &[Option<CameraMotion>],
    depths: &mut [Option<f64>],
    unit: f64,
    weight: &impl Fn(f64) -> f64,
) {
    let sums = all_evidence(frames, motions, depths, unit, weight);
    depths.iter_mut().zip(sums).for_each(|(depth, sum)| *depth = sum.depth());
}

/// What remains, in all frames together, of the misfits that homographies leave, if the depth of each patch is what the
/// other frames show; none if no patch was observed in two frames. The depths of a scene deviate by 1 (`normalise`), so
/// that is how far the depth of a patch of which the other frames show little is likely to be from the mean.
pub(super) fn predicted(
    frames: &[&[Observation]],
    starts: &[Option<Start>],
    motions: &[Option<CameraMotion>],
    depths: &[Option<f64>],
    unit: f64,
) -> Option<f64> {
    let weight = weight(ROUNDS);
    let all = all_evidence(frames, motions, depths, unit, &weight);
    let (mut by_homographies, mut by_others) = (0.0, 0.0);
    for ((observations, start), motion) in frames.iter().zip(starts).zip(motions) {
        let (Some(start), Some(motion)) = (start, motion) else { continue };
        let plain = start.without_depth();
        for (observation, (patch, own)) in
            observations.iter().zip(evidence(observations, motion, depths, unit, &weight))
        {
            let others = all[patch].without(own);
            if others.depth().is_some() {
                let cost = |d: [f64; 2]| bounded(observation.misfit(d));
                by_homographies += cost(plain.displacement(observation.at, 0.0, unit));
                by_others += cost(motion.displacement(observation.at, others.likely_depth(), unit));
            }
        }
    }
    (by_homographies > 0.0).then(|| by_others / by_homographies)
}
