//! How well a motion explains the observations of a frame, and the weights with which motions are fitted to them.
//!
//! In: [`Observation`]s, and the displacements that two motions predict. Out: [`Explained`]. Cost: negligible. Sources:
//! the weights of Geman & McClure; their scale is large at first (graduated non-convexity, Blake & Zisserman 1987).

use crate::align::following::observations::Observation;
use nalgebra::Vector2;

/// A frame with fewer observations has no motion.
pub(super) const LEAST_OBSERVED: usize = 100;
/// Number of rounds of a fit.
pub(super) const ROUNDS: usize = 30;
/// In the first rounds, weights fall less with the misfit.
const CONVEX_ROUNDS: usize = 10;
/// Scale of the misfits in the first round, in standard deviations, and its factor from round to round, down to 1.
const FIRST_SCALE: (f64, f64) = (16.0, 0.8);
/// An observation is unexplained if its misfit is more than this, in variances.
const MOST_MISFIT: f64 = 9.0;
/// Depth explains the frames if it leaves at most this share of the misfits that homographies leave. Things that move
/// by themselves are not explained by the motion of the camera. On rendered scenes, the share is at most 0.29 with
/// depth, and at least 0.64 with leaves.
const MOST_LEFT: f64 = 0.33;
/// A motion with few parameters suffices if it leaves at most this mean misfit, in variances. On rendered scenes, 0.19
/// and less remain with the right motion, and 0.8 and more if near and far things are displaced against each other.
const NOISE: f64 = 0.33;
/// It is used if it leaves at most this share of the misfits that one homography leaves. On rendered scenes without
/// bends, the share is at least 0.98.
const CLEARLY: f64 = 0.9;
/// A frame that was rejected is placed only if the motion leaves at most this share of its observations unexplained.
/// With a wrong transform, or in another scene, patches match by chance. On rendered scenes, the share is 0.05 to 0.24 in
/// rejected frames of the scene, and at least 0.6 in frames of another scene.
const MOST_UNEXPLAINED_ALONE: f64 = 0.3;

/// How well the motion of a frame explains its observations.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Explained {
    /// Number of observations that the motion predicts.
    count: usize,
    /// Number of observations that the motion leaves unexplained.
    unexplained: usize,
    /// The sum of the misfits of all observations, in variances, each bounded by [`MOST_MISFIT`]: with one homography,
    cost_by_homography: f64,
    /// and with the motion.
    cost_by_motion: f64,
    /// Root mean square distance of the explained observations from the motion, in pixels of the level. Each counts by
    /// its precision, along the direction in which it is precise.
    pub(super) rms: f64,
    /// Median distance of the unexplained observations from the motion, in pixels of the level; 0 if there are none.
    pub(super) off: f64,
}

impl Explained {
    /// How well the motion `predicted` explains `observations`; it predicts none for a patch whose depth is unknown.
    /// `plain` is what the best homography predicts.
    pub(super) fn new(
        observations: &[Observation],
        plain: impl Fn(&Observation) -> [f64; 2],
        predicted: impl Fn(&Observation) -> Option<[f64; 2]>,
    ) -> Self {
        let mut explained = Explained::default();
        let (mut squares, mut precisions, mut off) = (0.0, 0.0, Vec::new());
        for (observation, d) in observations.iter().filter_map(|o| Some((o, predicted(o)?))) {
            let (plain, misfit) = (observation.misfit(plain(observation)), observation.misfit(d));
            explained.count += 1;
            explained.cost_by_homography += bounded(plain);
            explained.cost_by_motion += bounded(misfit);
            if misfit > MOST_MISFIT {
                off.push((observation.displacement - Vector2::from(d)).norm());
            } else {
                squares += misfit;
                precisions += 0.5 * observation.precision.trace();
            }
        }
        off.sort_by(f64::total_cmp);
        let rms = (squares / f64::max(precisions, 1e-9)).sqrt();
        Explained { unexplained: off.len(), rms, off: off.get(off.len() / 2).copied().unwrap_or(0.0), ..explained }
    }

    /// The sums over `frames`.
    fn sum(frames: &[Explained]) -> Self {
        frames.iter().fold(Explained::default(), |sum, e| Explained {
            count: sum.count + e.count,
            cost_by_homography: sum.cost_by_homography + e.cost_by_homography,
            cost_by_motion: sum.cost_by_motion + e.cost_by_motion,
            ..sum
        })
    }

    /// The share of the observations that the motion leaves unexplained, 0..=1; 1 if there are too few.
    pub(super) fn unexplained(&self) -> f64 {
        if self.count < LEAST_OBSERVED { 1.0 } else { self.unexplained as f64 / self.count as f64 }
    }

    /// Whether homographies leave more than noise in all `frames` together, and the motions little of it.
    pub(super) fn are_better(frames: &[Explained]) -> bool {
        let all = Explained::sum(frames);
        all.cost_by_homography > NOISE * all.count as f64 && all.cost_by_motion <= MOST_LEFT * all.cost_by_homography
    }

    /// The mean misfit in all `frames`, in variances, if each is bounded by [`MOST_MISFIT`]; none if the motions leave
    /// more than noise unexplained, or are not clearly better than homographies.
    pub(super) fn sufficient(frames: &[Explained]) -> Option<f64> {
        let all = Explained::sum(frames);
        let mean = all.cost_by_motion / all.count.max(1) as f64;
        (mean <= NOISE && all.cost_by_motion < CLEARLY * all.cost_by_homography).then_some(mean)
    }

    /// Whether the motion explains a frame that was rejected because parts of it disagree with one homography.
    pub(super) fn is_convincing(&self) -> bool {
        self.unexplained() <= MOST_UNEXPLAINED_ALONE
    }
}

/// The misfit, in variances, bounded by [`MOST_MISFIT`] (Geman & McClure).
pub(super) fn bounded(misfit: f64) -> f64 {
    misfit / (1.0 + misfit / MOST_MISFIT)
}

/// The weight of an observation with a misfit, in variances, in a round.
pub(super) fn weight(round: usize) -> impl Fn(f64) -> f64 {
    let scale = (FIRST_SCALE.0 * power(FIRST_SCALE.1, round)).max(1.0);
    move |misfit: f64| {
        let w = 1.0 / (1.0 + misfit / (scale * scale)).sqrt();
        if round < CONVEX_ROUNDS { w } else { w * w }
    }
}

/// `base` to the power of `n`.
fn power(base: f64, n: usize) -> f64 {
    (0..n).fold(1.0, |product, _| product * base)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame of 1000 observations, with these mean misfits.
    fn frame(by_homography: f64, by_motion: f64) -> Explained {
        let [cost_by_homography, cost_by_motion] = [by_homography, by_motion].map(|mean| 1000.0 * mean);
        Explained { count: 1000, cost_by_homography, cost_by_motion, ..Explained::default() }
    }

    #[test]
    fn a_motion_is_better_if_little_remains_of_more_than_noise() {
        assert!(Explained::are_better(&[frame(0.9, 0.1), frame(0.6, 0.1), frame(2.0, 0.1)]), "small depth");
        assert!(!Explained::are_better(&[frame(1.4, 1.0), frame(1.3, 1.0), frame(1.2, 0.9)]), "leaves");
        assert!(!Explained::are_better(&[frame(0.2, 0.02), frame(0.3, 0.03)]), "homographies leave noise only");
        assert!(Explained::are_better(&[Explained::default(), frame(2.0, 0.1)]), "one frame was observed");
        assert!(!Explained::are_better(&[]), "no frame was observed");
    }
}
