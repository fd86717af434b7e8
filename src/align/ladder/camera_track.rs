//! The camera's track over time, from which the transform of a frame with too little detail is inferred, with a bound
//! of its error.
//!
//! In: the transforms of the aligned frames, and the capture times. Out: the transform at another time, and an error
//! bound that holds for 19 of 20 such transforms. Cost: negligible.
//!
//! A hand-held camera is modelled as a random walk in the picture plane. The step from one frame to the next has an
//! isotropic normal distribution. Its variance is unknown and proportional to the time between the two frames. The most
//! likely transform at a time between two frames is then their linear interpolation; before the first or after the last
//! frame, it is the transform of that frame. The error bound follows from K observed steps. These steps give an
//! estimate of the expected squared distance between the true transform and the most likely one. The ratio of the
//! squared distance to this estimate has the F distribution with 2 and 2 K degrees of freedom, because each step has
//! two components (Fisher 1925). The quantiles of this distribution have a closed form. On a tripod, the steps are 0
//! apart from the measurement error. With steps of many pixels, the bound is too large for merging.
//!
//! If a camera shakes around one position, its frames do not drift: they scatter about their mean, independent of time.
//! The same is true for scanned photographs. If this second model is at least 20 times as likely as the random walk
//! (strong evidence according to Kass & Raftery 1995), the inferred transform is the mean, and the bound follows from
//! the scatter about it.

use crate::align::ladder::reduction::UNMOVED_PX;
use crate::align::transform::{Transform, distance};
use crate::bracket::Bracket;

/// The capture time of each frame of `bracket`.
///
/// If all frames have a capture time to fractions of a second: in seconds after the first. If a capture time is
/// coarser: the frame's position in the order of capture; frames with equal times are ordered by file name. If a
/// capture time is missing: the frame's position by rising exposure.
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
        // No two frames were taken at the same time, so equal times are put one tick of the clock apart.
        capture_times[i] =
            if tick < 1.0 { last.map_or(seconds, |last: f64| seconds.max(last + tick)) } else { time as f64 };
        last = Some(capture_times[i]);
    }
    capture_times
}

/// The share of inferred transforms whose error exceeds its bound, if the model of the camera is right.
const WORSE: f64 = 0.05;

/// The transform of an aligned frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct KnownTransform {
    /// The capture time, see [`capture_times`].
    pub(crate) time: f64,
    /// Reference pixel -> frame pixel.
    pub(crate) transform: Transform,
    /// Error estimate of the transform: root mean square over the picture, in pixels.
    pub(crate) error_px: f64,
}

/// The inferred transform of a frame with too little detail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct InferredTransform {
    /// Reference pixel -> frame pixel.
    pub(crate) transform: Transform,
    /// Error bound that holds for 19 of 20 such transforms: root mean square over the picture, in pixels.
    pub(crate) bound_px: f64,
}

impl InferredTransform {
    /// The expected root mean square error E of the transform. It follows from the bound, because a normal error in the
    /// plane exceeds r E with probability exp(-r^2).
    pub(crate) fn expected_px(&self) -> f64 {
        self.bound_px / (-libm::log(WORSE)).sqrt()
    }
}

/// The motion of a camera, fitted to the known transforms of the aligned frames: a path over time, or scatter about one
/// position. It predicts the transform of another frame.
#[derive(Debug, Clone)]
pub(crate) struct CameraTrack {
    size: (usize, usize),
    /// The aligned frames, in the order of their capture times.
    known: Vec<KnownTransform>,
    /// The variance of the camera's motion per unit of time, summed over both axes, in pixels^2.
    variance: f64,
    /// The mean transform and the variance about it, for a camera that shakes around one position.
    scatter_about: Option<(Transform, f64)>,
}

impl CameraTrack {
    /// Fits the track of the camera to the transforms `known`, for frames of `size`. Returns `None` if there are fewer
    /// than two transforms.
    pub(crate) fn new(mut known: Vec<KnownTransform>, size: (usize, usize)) -> Option<Self> {
        known.sort_by(|a, b| a.time.total_cmp(&b.time));
        let count = known.len().checked_sub(1).filter(|&count| count > 0)?;
        let mut track = CameraTrack { size, known, variance: 0.0, scatter_about: None };
        track.variance = track.steps().map(|(far, elapsed)| far / elapsed).sum::<f64>() / count as f64;
        track.scatter_about = track.about_one_place().filter(|_| !track.is_still());
        Some(track)
    }

    /// For each step between successive frames: the square of its length in pixels^2, and its duration.
    fn steps(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let step =
            |pair: &[KnownTransform]| (self.far(&pair[0].transform, &pair[1].transform), pair[1].time - pair[0].time);
        self.known.windows(2).map(step)
    }

    /// The mean square distance between two transforms over the picture, in pixels^2.
    fn far(&self, a: &Transform, b: &Transform) -> f64 {
        let far = distance(a, b, self.size.0, self.size.1);
        far * far
    }

    /// Returns the mean transform and the variance about it, if a scatter about one position is more than 1 / [`WORSE`]
    /// times as likely as a random walk; otherwise none.
    fn about_one_place(&self) -> Option<(Transform, f64)> {
        let mut mean = self.known[0].transform;
        for (k, known) in self.known.iter().enumerate().skip(1) {
            mean = between(&mean, &known.transform, 1.0 / (k + 1) as f64, self.size);
        }
        let (all, count) = (self.known.len() as f64, self.known.len() as f64 - 1.0);
        // The square of the longest motion between two frames that is not detected. Half of it is attributed to each
        // frame.
        let unseen = UNMOVED_PX * UNMOVED_PX;
        let scatter =
            self.known.iter().map(|known| self.far(&mean, &known.transform)).sum::<f64>() / count + 0.5 * unseen;
        // Logarithm of the likelihood of the steps under the scatter, divided by that under the random walk. In a
        // random walk the steps are independent. If the frames scatter, the covariance matrix of the steps along an
        // axis is the variance of the scatter times a matrix whose determinant is `all`, the number of frames.
        let wander: f64 = self.steps().map(|(_, elapsed)| libm::log(self.variance * elapsed + unseen)).sum();
        let gain = wander - count * libm::log(scatter) - libm::log(all);
        (gain > -libm::log(WORSE)).then_some((mean, scatter))
    }

    /// Whether the camera stood still: all transforms are the same.
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
        // The part of the bound from the error of the neighbouring frame's transform, and from a motion too small to be
        // detected.
        let own = -libm::log(WORSE) * (error_px * error_px + UNMOVED_PX * UNMOVED_PX);
        InferredTransform { transform, bound_px: (wandered + own).sqrt() }
    }
}

/// The quantile of the F distribution with 2 and 2 `steps` degrees of freedom that is exceeded with probability
/// [`WORSE`].
fn quantile(steps: usize) -> f64 {
    let k = steps as f64;
    k * (libm::pow(WORSE, -1.0 / k) - 1.0)
}

/// Interpolates linearly between the transforms `a` (at `part` = 0) and `b` (at `part` = 1).
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
        // Both matrices have 1 as their lower right element. For motions as small as those inferred here, interpolated
        // matrices map a pixel to the interpolated position.
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
        // 95 % quantiles of the F distribution with (2, 2 * steps) degrees of freedom.
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
            // Computed by hand: a motion of 0.2 px (`UNMOVED_PX`) may be undetected, and 1 of 20 normal errors exceeds
            // 1.73 times this length.
            assert!((place.bound_px - 0.2 * 1.7308).abs() < 1e-4, "{place:?}");
        }
        assert!(track.is_still());
        assert!(CameraTrack::new(vec![known(0, Transform::Identity)], SIZE).is_none());
    }

    #[test]
    fn interpolated_transform_is_more_certain_than_extrapolated() {
        let track = CameraTrack::new(vec![known(0, shift(0.0, 0.0)), known(3, rigid(6.0, -3.0, 0.3))], SIZE).unwrap();
        let place = track.at(1.0);
        let error = place.transform.corner_distance(&rigid(2.0, -1.0, 0.1), SIZE.0, SIZE.1);
        assert!(error < 1e-9 && !track.is_still(), "{error}");
        assert!(place.bound_px < track.at(4.0).bound_px && track.at(4.0).bound_px < track.at(6.0).bound_px);
        let tilted = Transform::Homography(rigid(6.0, -3.0, 0.0).matrix(SIZE.0, SIZE.1));
        let track = CameraTrack::new(vec![known(0, Transform::Identity), known(2, tilted)], SIZE).unwrap();
        assert!(track.at(1.0).transform.corner_distance(&shift(3.0, -1.5), SIZE.0, SIZE.1) < 1e-9);
    }

    /// The last position of nineteen of twenty simulated cameras is within the bound, whether they drift or shake, and
    /// for any number of observed steps.
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
            // 95 % of 2000 is 1900. The lower limit is 40 less: twice the standard deviation of this count is 20, and a
            // wrong choice between the two models of the camera costs up to 20 more. The upper limit is higher, because
            // the allowance for undetected motion widens the bound.
            assert!((1860..=1990).contains(&kept), "{seen} {wanders}: {kept}");
        }
    }
}
