//! Transforms inferred from the other frames of a bracket, for frames that show too little.
//!
//! In: the placements of the frames by themselves. Out: those of frames with little detail, by what the camera did
//! while the others were taken. Cost: that of comparing each such frame with the reference once more, and with its
//! neighbour in exposure on a grid of some ten thousand samples.
//!
//! A frame that is nearly all black, or white, has little to be aligned by, and is often the one that matters: it holds
//! the lamps. Where the camera stood still for the others, or moved little from one to the next, its transform follows
//! from theirs ([`camera_track`](crate::align::ladder::camera_track)).

use crate::align::grey::{Detail, GreyPyramid, measured_level};
use crate::align::ladder::Search;
use crate::align::ladder::camera_track::{CameraTrack, InferredTransform, KnownTransform};
use crate::align::ladder::candidate::{Candidate, tolerance_px};
use crate::align::ladder::selection::estimate;
use crate::align::ladder::thresholds::{DECISIVE_NATS, INFERRED_CONFIDENCE, INFERRING_CONFIDENCE};
use crate::align::result::{Estimate, Placement};
use crate::align::transform::{Model, Transform, distance, map, on_level};

/// Frames that moved by no more than this are static, in pixels: scans and settling tripods move by as much.
const STATIC_PX: f64 = 1.0;
/// An assumed place is merged by where its expected error is no more than so many times that at which a place is half
/// as good: in what it fills ([`Placement::Assumed`]) an error displaces, and cannot smear.
const MOST_EXPECTED_ERROR: f64 = 2.0;
/// A frame of which no more than this share shows something is nearly black or nearly white. Of lamps and windows of
/// interiors it is up to a tenth, of photographs that were metered nearly all.
const LITTLE_DETAIL: f64 = 0.25;
/// What shows in it must be brighter in its neighbour too than what does not, or darker, in this share of all pairs of
/// places: halfway between what chance gives and all.
const IN_ORDER: f64 = 0.75;
/// Places that are looked at along the longer side.
const GRID: usize = 256;
/// Fewest samples on either side for a result.
const LEAST_SAMPLES: u64 = 16;

impl Search<'_> {
    /// Frames with little detail that were estimated to have moved, though most frames are exactly static, are set to
    /// unmoved, unless their tiles are decidedly for the motion: little detail is easily misaligned by a pixel.
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
            let (here, there) = (self.evaluate(i, Transform::Identity), self.evaluate(i, transform));
            if there.tiles.evidence_over(&here.tiles) <= DECISIVE_NATS {
                *placement = unmoved(&here, here.error_px);
            }
        }
    }

    /// A frame that could not be aligned is unmoved where all the others are, or as good as, and its own tiles are for
    /// it rather than against it.
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
                let here = self.evaluate(i, Transform::Identity);
                let agreement = here.agreement();
                if agreement.agreeing > 0 && agreement.disagreeing <= agreement.agreeing {
                    *placement = unmoved(&here, here.error_px.max(farthest));
                }
            }
        }
    }

    /// The transforms from which others are inferred.
    pub(crate) fn known(&self, placements: &[Placement]) -> Vec<KnownTransform> {
        let known = |(i, placement): (usize, &Placement)| {
            let transform = placement.transform().filter(|_| placement.confidence() >= INFERRING_CONFIDENCE)?;
            let error_px = placement.error_px().unwrap_or(0.0);
            Some(KnownTransform { time: self.capture_times[i], transform, error_px })
        };
        placements.iter().enumerate().filter_map(known).collect()
    }

    /// Frames that are nearly black or white get the transform that the `known` ones predict, where its error is small
    /// enough to merge.
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
                let stood = match track.is_still() {
                    true => format!("the camera stood still in the other {count} frames"),
                    false => format!("the camera moved little between the other {count} frames"),
                };
                let tone = if detail.is_white { "white" } else { "black" };
                *placement = Placement::Assumed(Estimate {
                    transform: place.transform,
                    model: Model::of(&place.transform),
                    error_px: Some(place.bound_px),
                    confidence: INFERRED_CONFIDENCE / (1.0 + off * off),
                    reason: Some(format!("nearly all of it is {tone}; {stood}")),
                });
            }
        }
    }

    /// Whether what frame `i` shows at `place` is what its nearest neighbour in exposure has brightest, or darkest
    /// where the frame is white. A frame of another scene is not.
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

/// `frame`, which lies in `target` at `place`: of all pairs of a place where it shows something and one where it does
/// not, the share that is in the same order in `target`, ties counting half; none where too little shows. (The
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
    // By the target's grey value, where the frame shows nothing and where it shows something.
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

/// The placement of a frame that is taken to be unmoved, by its tiles `here`.
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
                // The brightest tenth of the black frame, and the darkest of the white one.
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
