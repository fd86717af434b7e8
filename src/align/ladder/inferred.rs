//! Transforms inferred from the other frames of a bracket, for frames with too little detail.
//!
//! In: the placements of all frames. Out: the placements of frames with little detail, inferred from the motion of the
//! camera between the other frames. Cost, for each such frame: at most two more checks by tiles, and a
//! comparison with the neighbour in exposure at some tens of thousands of samples. A neighbour that moved is warped at
//! full size for it.
//!
//! A frame that is nearly all black or white has little detail for alignment, but is often important: it may be the
//! only one with unclipped lamps. If the camera stood still for the other frames, or moved little from one to the next,
//! the transform of this frame is inferred from theirs ([`camera_track`](crate::align::ladder::camera_track)).

use crate::align::grey::{Detail, GreyPyramid, measured_level};
use crate::align::ladder::Search;
use crate::align::ladder::camera_track::{CameraTrack, InferredTransform, KnownTransform};
use crate::align::ladder::candidate::{Candidate, tolerance_px};
use crate::align::ladder::selection::estimate;
use crate::align::ladder::thresholds::{DECISIVE_NATS, INFERRED_CONFIDENCE, INFERRING_CONFIDENCE};
use crate::align::result::{Estimate, Placement};
use crate::align::transform::{Model, Transform, distance, map, on_level};

/// Largest displacement, in pixels, of a frame that counts as static. It is not smaller, because scanned photographs,
/// and frames from a tripod that settles, can be displaced by this much.
const STATIC_PX: f64 = 1.0;
/// Largest expected error of an assumed transform, as a multiple of the error that halves the confidence
/// ([`tolerance_px`]). The value is greater than 1, because in the radiance such a frame fills only what has no detail
/// in any other frame ([`Placement::Assumed`]): there, an error displaces the detail, but does not blur it.
const MOST_EXPECTED_ERROR: f64 = 2.0;
/// A frame counts as nearly black or nearly white if at most this share of its pixels have detail. The value is between
/// two cases: the lamps and windows of an interior are up to a tenth of the pixels; in a normally exposed photograph,
/// nearly all pixels have detail.
const LITTLE_DETAIL: f64 = 0.25;
/// If the order of brightness can be compared, a transform is assumed only if at least this share of pairs of pixels
/// have the same order in the frame and in its neighbour in exposure. The value is halfway between chance (0.5) and all
/// pairs (1).
const IN_ORDER: f64 = 0.75;
/// Largest number of samples along the longer side, for the comparison of the order of brightness.
const GRID: usize = 256;
/// The order of brightness is compared only if at least this many samples have detail, and at least this many have
/// none.
const LEAST_SAMPLES: u64 = 16;

impl Search<'_> {
    /// Sets moved frames with little detail to unmoved, if most of the frames with sufficient confidence have exactly
    /// the identity.
    ///
    /// Frames with little detail are easily misaligned by a pixel. A frame keeps its transform if its tiles match
    /// decisively better with it than with the identity.
    pub(crate) fn keep_static_frames_static(&self, placements: &mut [Placement]) {
        let sure =
            || placements.iter().filter(|p| p.confidence() >= INFERRING_CONFIDENCE).filter_map(|p| p.transform());
        if 2 * sure().filter(|transform| *transform == Transform::Identity).count() <= sure().count().max(2) {
            return;
        }
        for (i, placement) in placements.iter_mut().enumerate() {
            let Placement::Placed(Estimate { transform, .. }) = *placement else { continue };
            let has_detail = self.contents[i].detail.share > LITTLE_DETAIL;
            if transform == Transform::Identity || has_detail || self.given[i].is_some() {
                continue;
            }
            let (here, there) = (self.evaluate(i, Transform::Identity, 0.0), self.evaluate(i, transform, 0.0));
            if there.tiles.evidence_over(&here.tiles) <= DECISIVE_NATS {
                *placement = unmoved(&here, here.error_px());
            }
        }
    }

    /// Sets a frame that could not be aligned to unmoved, if all aligned frames are static and at least as many of its
    /// tiles agree with the identity as disagree.
    pub(crate) fn accept_static(&self, placements: &mut [Placement]) {
        let (width, height) = self.size();
        let others = placements.iter().filter(|p| **p != Placement::Reference).filter_map(Placement::transform);
        let moves: Vec<f64> = others.map(|w| distance(&w, &Transform::Identity, width, height)).collect();
        let farthest = moves.iter().copied().fold(0.0, f64::max);
        if moves.is_empty() || farthest > STATIC_PX {
            return;
        }
        for (i, placement) in placements.iter_mut().enumerate() {
            if self.could_not_align(i, placement) {
                let here = self.evaluate(i, Transform::Identity, 0.0);
                let agreement = here.agreement();
                if agreement.agreeing > 0 && agreement.disagreeing <= agreement.agreeing {
                    *placement = unmoved(&here, here.error_px().max(farthest));
                }
            }
        }
    }

    /// The transforms of the frames that have enough confidence to infer other transforms from them.
    pub(crate) fn known(&self, placements: &[Placement]) -> Vec<KnownTransform> {
        let known = |(i, placement): (usize, &Placement)| {
            let transform = placement.transform().filter(|_| placement.confidence() >= INFERRING_CONFIDENCE)?;
            let error_px = placement.error_px().unwrap_or(0.0);
            Some(KnownTransform { time: self.capture_times[i], transform, error_px })
        };
        placements.iter().enumerate().filter_map(known).collect()
    }

    /// Gives nearly black or white frames that could not be aligned the transform that the `known` transforms predict,
    /// if its expected error is small enough, and if the frame then has the same order of brightness as its neighbour
    /// in exposure.
    pub(crate) fn infer_from_track(&self, known: Vec<KnownTransform>, placements: &mut [Placement]) {
        let (count, size) = (known.len(), self.size());
        let Some(track) = CameraTrack::new(known, size) else { return };
        let before = placements.to_vec();
        for (i, placement) in placements.iter_mut().enumerate() {
            let detail = self.contents[i].detail;
            if !self.could_not_align(i, placement) || detail.share > LITTLE_DETAIL {
                continue;
            }
            let place = track.at(self.capture_times[i]);
            let off = place.expected_px() / tolerance_px(size);
            if off <= MOST_EXPECTED_ERROR && self.has_same_brightness_order(i, &place, detail, &before) {
                let motion = if track.is_still() { "did not move" } else { "moved little" };
                let tone = if detail.is_white { "white" } else { "black" };
                *placement = Placement::Assumed(Estimate {
                    transform: place.transform,
                    model: Model::of(&place.transform),
                    error_px: Some(place.bound_px),
                    confidence: INFERRED_CONFIDENCE / (1.0 + off * off),
                    displaced: None,
                    reason: Some(format!(
                        "nearly all pixels are {tone}, and the camera {motion} between the other {count} frames"
                    )),
                });
            }
        }
    }

    /// Whether the detail of frame `i`, placed by `place`, covers the brightest part of its nearest placed neighbour in
    /// exposure (the darkest part, if frame `i` is nearly white). In a frame of another scene, it does not. True if the
    /// two cannot be compared.
    fn has_same_brightness_order(
        &self,
        i: usize,
        place: &InferredTransform,
        detail: Detail,
        placements: &[Placement],
    ) -> bool {
        let is_known = |&n: &usize| n != i && placements[n].transform().is_some();
        let nearest = (0..placements.len()).filter(is_known).min_by_key(|&n| (n.abs_diff(i), n));
        let Some(target) = nearest.and_then(|n| self.neighbour_target(n, &placements[n])) else { return true };
        brightness_order(&target.pyramid, &self.pyramids[i], place, detail).is_none_or(|share| share >= IN_ORDER)
    }
}

/// Compares pairs of pixels of `frame`, one with detail and one without. Returns the share of the pairs whose order of
/// brightness is the same in `target`, to which `place` aligns `frame`.
///
/// A pair with equal brightness in `target` counts half. Returns none if there are too few samples. (This is the
/// statistic of Mann & Whitney 1947.)
fn brightness_order(
    target: &GreyPyramid,
    frame: &GreyPyramid,
    place: &InferredTransform,
    detail: Detail,
) -> Option<f64> {
    let level = measured_level(target);
    let (size, (width, height)) = (target.size(0), target.size(level));
    let h = on_level(&place.transform.matrix(size.0, size.1), level);
    let (target, frame) = (target.level(level), frame.level(level));
    let step = width.max(height).div_ceil(GRID);
    // For each grey value of the target, two numbers of samples: those where the frame has no detail, and those where
    // it has detail.
    let mut counts = [[0u64; 2]; 256];
    for y in (0..height).step_by(step) {
        for x in (0..width).step_by(step) {
            let (u, v) = map(&h, x as f64, y as f64);
            let (u, v) = ((u + 0.5).floor(), (v + 0.5).floor());
            if u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64 {
                let code = frame.at(u as usize, v as usize);
                let shows = if detail.is_white { code <= detail.value } else { code >= detail.value };
                counts[usize::from(target.at(x, y))][usize::from(shows)] += 1;
            }
        }
    }
    let total = |k: usize| counts.iter().map(|n| n[k]).sum::<u64>();
    let (nothing, something) = (total(0), total(1));
    if nothing < LEAST_SAMPLES || something < LEAST_SAMPLES {
        return None;
    }
    let (mut below, mut twice) = (0, 0);
    for [not, does] in counts {
        twice += does * (2 * below + not);
        below += not;
    }
    let share = twice as f64 / (2 * nothing * something) as f64;
    Some(if detail.is_white { 1.0 - share } else { share })
}

/// The placement of a frame that is set to unmoved; `here` is the candidate with the identity.
fn unmoved(here: &Candidate, error_px: f64) -> Placement {
    let estimate = estimate(here);
    let confidence = estimate.confidence.max(INFERRED_CONFIDENCE);
    Placement::Placed(Estimate { confidence, error_px: Some(error_px), ..estimate })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::grey::Histogram;
    use crate::align::scene::{Scene, Shot, shift};

    const SIZE: (usize, usize) = (384, 256);

    #[test]
    fn order_of_brightness_is_kept_by_the_same_scene_and_by_no_other() {
        let transform = shift(3.0, -2.0);
        let take = |seed, ev| Scene::new(seed).photograph(SIZE, &transform, Shot::at(ev));
        let target = GreyPyramid::new(Scene::new(41).photograph(SIZE, &Transform::Identity, Shot::at(0.0)));
        let place = InferredTransform { transform, bound_px: 1.0 };
        for (ev, is_white) in [(-5.0, false), (3.0, true)] {
            let in_order = |seed| {
                let frame = take(seed, ev);
                // Detail is the brightest tenth of the black frame, and the darkest tenth of the white one.
                let histogram = Histogram::of(&frame);
                let level = (0..=u8::MAX).find(|&v| histogram.share(0..=v) > if is_white { 0.1 } else { 0.9 }).unwrap();
                let detail = Detail { is_white, value: level, share: 0.1 };
                brightness_order(&target, &GreyPyramid::new(frame), &place, detail).unwrap()
            };
            let (same, other) = (in_order(41), in_order(42));
            assert!(same > 0.9 && other < IN_ORDER, "{ev}: {same} {other}");
        }
        let nothing = Detail { is_white: false, value: u8::MAX, share: 0.0 };
        let black = GreyPyramid::new(crate::plane::Plane::filled(SIZE.0, SIZE.1, 0));
        assert_eq!(brightness_order(&target, &black, &place, nothing), None);
    }
}
