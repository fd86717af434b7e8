//! The camera's track over time: the transform at the time of a frame that shows too little to be aligned, with a bound
//! of its error.
//!
//! In: the transforms of the aligned frames, and when each frame was taken. Out: for another time the transform, and
//! the error that 19 of 20 such transforms keep. Cost: negligible.
//!
//! Between two photographs a hand-held camera drifts by a random walk in the picture's plane: the step from frame to
//! frame is normal and isotropic, with an unknown variance that grows with the time between them. A frame between two
//! others then lies most likely on the line between them, in proportion to the times; one before the first or after the
//! last where that lies. With K steps observed, the square of the distance from there, over its expectation from the
//! steps, has the F distribution of 2 and 2 K degrees of freedom (each step gives two components): Fisher 1925. Its
//! quantiles have a closed form. A tripod's frames do not move, so that their steps are 0 but for the measurement
//! error; steps of many pixels lead to an error that no merge can use.
//!
//! Frames of a camera that shakes about one place, or that were scanned, do not drift: each is scattered about the mean
//! of all, independent of time. Where that makes the observed transforms more likely by a Bayes factor of at least 20
//! (which Kass & Raftery 1995 call strong), the mean is taken, with the scatter about it.

use crate::align::ladder::reduction::UNMOVED_PX;
use crate::align::transform::{Transform, distance};
use crate::bracket::Bracket;

/// The capture time of each frame of `bracket`, in seconds by the camera's clock, where all frames have that to
/// fractions of a second; where the clock is coarser, its position in the order in which they were taken, names
/// deciding between equal times; without a clock, its position by rising exposure.
pub(crate) fn capture_times(bracket: &Bracket) -> Vec<f64> {
    let frames = bracket.frames();
    let taken: Option<Vec<_>> = frames.iter().map(|frame| frame.capture.taken).collect();
    let mut order: Vec<usize> = (0..frames.len()).collect();
    let mut capture_times: Vec<f64> = (0..frames.len()).map(|time| time as f64).collect();
    let Some(taken) = taken else { return capture_times };
    order.sort_by_key(|&i| (taken[i], frames[i].path().file_name()));
    let tick = taken.iter().map(|moment| moment.resolution_s()).fold(0.0, f64::max);
    let mut last = None;
    for (time, &i) in order.iter().enumerate() {
        let seconds = taken[i].since(&taken[order[0]]);
        // No two were taken at once.
        capture_times[i] =
            if tick < 1.0 { last.map_or(seconds, |last: f64| seconds.max(last + tick)) } else { time as f64 };
        last = Some(capture_times[i]);
    }
    capture_times
}

/// The share of assumed places that are worse than their stated error, if steps are as they are taken to be.
const WORSE: f64 = 0.05;

/// A frame whose place is known.
#[derive(Debug, Clone, Copy)]
pub(crate) struct KnownTransform {
    /// When it was taken: in seconds, or its position among all frames.
    pub(crate) time: f64,
    /// Its place.
    pub(crate) transform: Transform,
    /// The root mean square error of that over the picture, in pixels.
    pub(crate) error_px: f64,
}

/// The transform of a frame that shows too little.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct InferredTransform {
    /// Its place.
    pub(crate) transform: Transform,
    /// The root mean square distance over the picture, in pixels, that 19 of 20 such places keep.
    pub(crate) bound_px: f64,
}

impl InferredTransform {
    /// The root mean square error that is expected: of a normal error in the plane a share of exp(-r^2) is farther off
    /// than r of these.
    pub(crate) fn expected_px(&self) -> f64 {
        self.bound_px / (-libm::log(WORSE)).sqrt()
    }
}

/// The camera's transform at each time at which it is known.
#[derive(Debug, Clone)]
pub(crate) struct CameraTrack {
    size: (usize, usize),
    /// By time.
    known: Vec<KnownTransform>,
    /// The variance of a step of one unit of time, both axes together, in pixels^2.
    variance: f64,
    /// The mean transform and the variance about it, for a camera that shakes about one place.
    scatter_about: Option<(Transform, f64)>,
}

impl CameraTrack {
    /// The track through `known`, the frames of which are of `size`; none through a single transform, which has no
    /// step.
    pub(crate) fn new(mut known: Vec<KnownTransform>, size: (usize, usize)) -> Option<Self> {
        known.sort_by(|a, b| a.time.total_cmp(&b.time));
        let count = known.len().checked_sub(1).filter(|&count| count > 0)?;
        let mut track = CameraTrack { size, known, variance: 0.0, scatter_about: None };
        track.variance = track.steps().map(|(far, elapsed)| far / elapsed).sum::<f64>() / count as f64;
        track.scatter_about = track.about_one_place().filter(|_| !track.is_still());
        Some(track)
    }

    /// The square of each step in pixels^2, and the time that it took.
    fn steps(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let step =
            |pair: &[KnownTransform]| (self.far(&pair[0].transform, &pair[1].transform), pair[1].time - pair[0].time);
        self.known.windows(2).map(step)
    }

    /// The mean square over the picture of how far two places are apart.
    fn far(&self, a: &Transform, b: &Transform) -> f64 {
        let far = distance(a, b, self.size.0, self.size.1);
        far * far
    }

    /// The mean place and the variance about it, where these explain what is seen decidedly better than steps do.
    fn about_one_place(&self) -> Option<(Transform, f64)> {
        let mut mean = self.known[0].transform;
        for (k, known) in self.known.iter().enumerate().skip(1) {
            mean = between(&mean, &known.transform, 1.0 / (k + 1) as f64, self.size);
        }
        let (all, count) = (self.known.len() as f64, self.known.len() as f64 - 1.0);
        // What did not move may have moved by so much between two frames, of which each has half.
        let unseen = UNMOVED_PX * UNMOVED_PX;
        let scatter =
            self.known.iter().map(|known| self.far(&mean, &known.transform)).sum::<f64>() / count + 0.5 * unseen;
        // The logarithm of the ratio of the likelihoods of the steps: these are independent in a walk, and have a
        // covariance of determinant `all` each way if frames scatter.
        let wander: f64 = self.steps().map(|(_, elapsed)| libm::log(self.variance * elapsed + unseen)).sum();
        let gain = wander - count * libm::log(scatter) - libm::log(all);
        (gain > -libm::log(WORSE)).then_some((mean, scatter))
    }

    /// Whether the camera stood still: all places are the same.
    pub(crate) fn is_still(&self) -> bool {
        self.known.iter().all(|k| k.transform == self.known[0].transform)
    }

    /// The transform of the frame that was taken at `time`.
    pub(crate) fn at(&self, time: f64) -> InferredTransform {
        let steps = self.known.len() - 1;
        if let Some((transform, scatter)) = self.scatter_about {
            let own = scatter * (1.0 + 1.0 / self.known.len() as f64);
            return InferredTransform { transform, bound_px: (own * quantile(steps)).sqrt() };
        }
        let next = self.known.partition_point(|k| k.time < time);
        let (transform, elapsed, error_px) = match (next.checked_sub(1).map(|i| self.known[i]), self.known.get(next)) {
            (Some(before), Some(after)) => {
                let (since, until) = (time - before.time, after.time - time);
                let part = since / (since + until);
                let transform = between(&before.transform, &after.transform, part, self.size);
                (transform, until * part, before.error_px.max(after.error_px))
            }
            (Some(last), None) => (last.transform, time - last.time, last.error_px),
            (None, first) => {
                let first = first.copied().unwrap_or(self.known[0]);
                (first.transform, first.time - time, first.error_px)
            }
        };
        let wandered = self.variance * elapsed * quantile(steps);
        // What did not move may have moved by so much.
        let own = -libm::log(WORSE) * (error_px * error_px + UNMOVED_PX * UNMOVED_PX);
        InferredTransform { transform, bound_px: (wandered + own).sqrt() }
    }
}

/// What a variable with the F distribution of 2 and 2 `steps` degrees of freedom exceeds by chance of [`WORSE`].
fn quantile(steps: usize) -> f64 {
    let k = steps as f64;
    k * (libm::pow(WORSE, -1.0 / k) - 1.0)
}

/// The transform a `part` of the way from `a` to `b`.
fn between(a: &Transform, b: &Transform, part: f64, (width, height): (usize, usize)) -> Transform {
    let numbers = |transform: &Transform| match *transform {
        Transform::Identity => Some([0.0; 3]),
        Transform::Rigid { dx, dy, angle } => Some([dx, dy, angle]),
        Transform::Homography(_) => None,
    };
    match (numbers(a), numbers(b)) {
        _ if a == b => *a,
        (Some(a), Some(b)) => {
            let [dx, dy, angle] = std::array::from_fn(|i| a[i] + part * (b[i] - a[i]));
            Transform::Rigid { dx, dy, angle }
        }
        // Both have 1 at the lower right; of motions as small as those that can be assumed, the mean of matrices is
        // that of places.
        _ => {
            let (a, b) = (a.matrix(width, height), b.matrix(width, height));
            Transform::Homography(a + (b - a) * part)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::{rigid, shift, uniform};

    const SIZE: (usize, usize) = (300, 200);

    fn known(time: usize, transform: Transform) -> KnownTransform {
        KnownTransform { time: time as f64, transform, error_px: 0.0 }
    }

    #[test]
    fn quantile_is_that_of_tables() {
        // F(2, 2), F(2, 6) and F(2, 120) at 95 %.
        for (steps, table) in [(1, 19.0), (3, 5.143), (60, 3.072)] {
            assert!((quantile(steps) - table).abs() < 1e-3, "{steps}: {}", quantile(steps));
        }
    }

    #[test]
    fn frame_among_still_ones_is_still_within_a_fraction_of_a_pixel() {
        let track = CameraTrack::new((1..6).map(|time| known(time, Transform::Identity)).collect(), SIZE).unwrap();
        for time in [0.0, 6.0] {
            let place = track.at(time);
            assert_eq!(place.transform, Transform::Identity);
            // By hand: 0.2 px that may be unseen, exceeded 1.73 times by 1 of 20.
            assert!((place.bound_px - 0.2 * 1.7308).abs() < 1e-4, "{place:?}");
        }
        assert!(track.is_still());
        assert!(CameraTrack::new(vec![known(0, Transform::Identity)], SIZE).is_none());
    }

    #[test]
    fn frame_between_two_lies_between_them_and_is_known_better_than_one_beyond() {
        let track = CameraTrack::new(vec![known(0, shift(0.0, 0.0)), known(3, rigid(6.0, -3.0, 0.3))], SIZE).unwrap();
        let place = track.at(1.0);
        let error = place.transform.corner_distance(&rigid(2.0, -1.0, 0.1), SIZE.0, SIZE.1);
        assert!(error < 1e-9 && !track.is_still(), "{error}");
        assert!(place.bound_px < track.at(4.0).bound_px && track.at(4.0).bound_px < track.at(6.0).bound_px);
        let tilted = Transform::Homography(rigid(6.0, -3.0, 0.0).matrix(SIZE.0, SIZE.1));
        let track = CameraTrack::new(vec![known(0, Transform::Identity), known(2, tilted)], SIZE).unwrap();
        assert!(track.at(1.0).transform.corner_distance(&shift(3.0, -1.5), SIZE.0, SIZE.1) < 1e-9);
    }

    /// Nineteen of twenty cameras end within the bound, whether they wander or shake, whatever the number of steps
    /// seen.
    #[test]
    fn bound_is_kept_by_nineteen_of_twenty_cameras() {
        for (seen, wanders) in [(2, true), (4, true), (8, true), (4, false), (12, false)] {
            let walk = |seed: u64| {
                let step = |time: usize, axis: i64| {
                    let sum: f64 = (0..12).map(|k| uniform(seed * 100 + k, time as i64, axis)).sum();
                    sum - 6.0
                };
                let mut at = [0.0; 2];
                let mut places = vec![shift(0.0, 0.0)];
                for time in 1..=seen {
                    let before = if wanders { at } else { [0.0; 2] };
                    at = [before[0] + step(time, 0), before[1] + step(time, 1)];
                    places.push(shift(at[0], at[1]));
                }
                let truth = places.pop().unwrap();
                let known = places.into_iter().enumerate().map(|(time, transform)| known(time, transform)).collect();
                let place = CameraTrack::new(known, SIZE).unwrap().at(seen as f64);
                distance(&place.transform, &truth, SIZE.0, SIZE.1) <= place.bound_px
            };
            let kept = (0..2000).filter(|&seed| walk(seed)).count();
            // Twice the standard deviation of a count of 2000 at 5 % is 20; a choice between the two kinds of camera
            // that is wrong costs as much, and what may have moved unseen widens the bound.
            assert!((1860..=1990).contains(&kept), "{seen} {wanders}: {kept}");
        }
    }
}
