//! What the other frames of a bracket tell of the place of one.
//!
//! In: the verdicts that the frames have by themselves. Out: those of frames that say little, by what the camera did as the others were taken.
//! Cost: that of holding each such frame against the reference once more, and against its neighbour in exposure on a grid of some ten thousand
//! places.
//!
//! A frame in which nearly all is black, or white, has little to be aligned by, and is often the one that matters: it holds the lamps. Where the
//! others stood still, or moved by little from one to the next, its place is known from theirs ([`assumed`](crate::align::ladder::camera_track)).

use crate::align::grey::{GreyPyramid, Shown, measured_level};
use crate::align::ladder::Search;
use crate::align::ladder::camera_track::{Assumed, Known, Track};
use crate::align::ladder::candidate::{Candidate, tolerance_px};
use crate::align::ladder::selection::{DECISIVE, Found, placed};
use crate::align::result::{Status, Verdict};
use crate::align::transform::{Model, Warp, distance, map, on_level};

/// Confidence in a frame whose place the others tell without any error; it falls with what error they leave.
pub(crate) const BY_COMPANY: f64 = 0.6;
/// Frames that moved by no more than this stood still, in pixels: scans and settling tripods do so much.
const COMPANY_PX: f64 = 1.0;
/// With less confidence a frame's place tells nothing of others'.
const SURE: f64 = 0.5;
/// An assumed place is merged by where its expected error is no more than so many times that at which a place is half as good: in what it fills
/// ([`Status::Assumed`]) an error displaces, and cannot smear.
const FARTHEST: f64 = 2.0;
/// A frame of which no more than this share shows something is nearly black or nearly white. Of lamps and windows of interiors it is up to a tenth,
/// of photographs that were metered nearly all.
const LITTLE: f64 = 0.25;
/// What shows in it must be brighter in its neighbour too than what does not, or darker, in this share of all pairs of places: halfway between what chance
/// gives and all.
const IN_ORDER: f64 = 0.75;
/// Places that are looked at along the longer side.
const PLACES: usize = 256;
/// Fewer that show something say nothing.
const FEWEST: u64 = 16;

impl Search<'_> {
    /// Frames that show little and are said to have moved though most frames stand exactly still are unmoved, unless their tiles are decidedly for the
    /// motion: what little there is, is easily led astray by a pixel.
    pub(crate) fn settle_still(&self, verdicts: &mut [Verdict]) {
        let still = |v: &&Verdict| v.warp == Some(Warp::Identity) && v.confidence >= SURE;
        let sure = verdicts.iter().filter(|v| v.warp.is_some() && v.confidence >= SURE).count();
        if 2 * verdicts.iter().filter(still).count() <= sure.max(2) {
            return;
        }
        for (i, verdict) in verdicts.iter_mut().enumerate() {
            let is_open =
                verdict.status == Status::Aligned && self.given[i].is_none() && self.seen[i].shown.share <= LITTLE;
            let Some(warp) = verdict.warp.filter(|_| is_open) else { continue };
            let (here, there) = (self.judged(i, Warp::Identity), self.judged(i, warp));
            if there.survey.against(&here.survey) <= DECISIVE {
                *verdict = unmoved(&here, verdict, here.error_px);
            }
        }
    }

    /// A frame that could not be aligned is unmoved where all the others are, or as good as, and its own tiles are for it rather than against it.
    pub(crate) fn keep_still(&self, verdicts: &mut [Verdict]) {
        let (width, height) = self.size();
        let others = verdicts.iter().filter(|v| v.status != Status::Reference).filter_map(|v| v.warp);
        let moves: Vec<f64> = others.map(|w| distance(&w, &Warp::Identity, width, height)).collect();
        let farthest = moves.iter().copied().fold(0.0, f64::max);
        if moves.is_empty() || farthest > COMPANY_PX {
            return;
        }
        for (i, verdict) in verdicts.iter_mut().enumerate() {
            if verdict.status == Status::Rejected && self.given[i].is_none() {
                let here = self.judged(i, Warp::Identity);
                let agreement = here.agreement();
                if agreement.confirm > 0 && agreement.contradict <= agreement.confirm {
                    *verdict = unmoved(&here, verdict, here.error_px.max(farthest));
                }
            }
        }
    }

    /// The frames whose place tells that of others.
    pub(crate) fn known(&self, verdicts: &[Verdict]) -> Vec<Known> {
        let known = |(i, v): (usize, &Verdict)| {
            let warp = v.warp.filter(|_| v.confidence >= SURE)?;
            Some(Known { turn: self.turns[i], warp, error_px: v.error_px.unwrap_or(0.0) })
        };
        verdicts.iter().enumerate().filter_map(known).collect()
    }

    /// The frames that are nearly black or white get the places that the `known` ones let expect, where these tell them well enough to merge by.
    pub(crate) fn assume(&self, known: Vec<Known>, verdicts: &mut [Verdict]) {
        let (count, size) = (known.len(), self.size());
        let Some(track) = Track::new(known, size) else { return };
        let before = verdicts.to_vec();
        for (i, verdict) in verdicts.iter_mut().enumerate() {
            let shown = self.seen[i].shown;
            if verdict.status != Status::Rejected || self.given[i].is_some() || shown.share > LITTLE {
                continue;
            }
            let place = track.at(self.turns[i]);
            let off = place.expected_px() / tolerance_px(size);
            if off <= FARTHEST && self.is_in_order(i, &place, shown, &before) {
                let stood = match track.is_still() {
                    true => format!("the camera stood still in the other {count} frames"),
                    false => format!("the camera moved little between the other {count} frames"),
                };
                let tone = if shown.is_white { "white" } else { "black" };
                *verdict = Verdict {
                    status: Status::Assumed,
                    model: Some(Model::of(&place.warp)),
                    warp: Some(place.warp),
                    inliers: verdict.inliers,
                    keypoints: verdict.keypoints,
                    error_px: Some(place.bound_px),
                    confidence: BY_COMPANY / (1.0 + off * off),
                    reason: Some(format!("nearly all of it is {tone}; {stood}")),
                };
            }
        }
    }

    /// Whether what frame `i` shows at `place` is what its nearest neighbour in exposure has brightest, or darkest where the frame is white. A frame of another
    /// scene is not.
    fn is_in_order(&self, i: usize, place: &Assumed, shown: Shown, verdicts: &[Verdict]) -> bool {
        let is_known = |&n: &usize| n != i && verdicts[n].warp.is_some();
        let nearest = (0..verdicts.len()).filter(is_known).min_by_key(|&n| (n.abs_diff(i), n));
        let Some(base) = nearest.and_then(|n| self.stand_in(n, &verdicts[n])) else { return true };
        order(&base.pyramid, &self.pyramids[i], place, shown).is_none_or(|share| share >= IN_ORDER)
    }
}

/// `frame`, which lies in `base` at `place`: of all pairs of a place where it shows something and one where it does not, the share that is in the same order in
/// `base`, ties counting half; none where too little shows. (The statistic of Mann & Whitney 1947.)
fn order(base: &GreyPyramid, frame: &GreyPyramid, place: &Assumed, shown: Shown) -> Option<f64> {
    let level = measured_level(base);
    let (size, (width, height)) = (base.size(0), base.size(level));
    let h = on_level(&place.warp.matrix(size.0, size.1), level);
    let (base, frame) = (base.level(level), frame.level(level));
    let step = width.max(height).div_ceil(PLACES);
    // By the base's level, where the frame shows nothing and where it shows something.
    let mut counts = [[0u64; 2]; 256];
    for y in (0..height).step_by(step) {
        for x in (0..width).step_by(step) {
            let (u, v) = map(&h, x as f64, y as f64);
            let (u, v) = ((u + 0.5).floor(), (v + 0.5).floor());
            if u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64 {
                let code = frame.at(u as usize, v as usize);
                let shows = if shown.is_white { code <= shown.level } else { code >= shown.level };
                counts[usize::from(base.at(x, y))][usize::from(shows)] += 1;
            }
        }
    }
    let total = |k: usize| counts.iter().map(|n| n[k]).sum::<u64>();
    let (nothing, something) = (total(0), total(1));
    if nothing < FEWEST || something < FEWEST {
        return None;
    }
    let (mut below, mut twice) = (0, 0);
    for [not, does] in counts {
        twice += does * (2 * below + not);
        below += not;
    }
    let share = twice as f64 / (2 * nothing * something) as f64;
    Some(if shown.is_white { 1.0 - share } else { share })
}

/// The verdict on a frame that is taken to be unmoved, as its tiles see it `here`, in place of the one that it had.
fn unmoved(here: &Candidate, had: &Verdict, error_px: f64) -> Verdict {
    let found = Found { inliers: had.inliers, keypoints: had.keypoints };
    let verdict = placed(here, found);
    Verdict { confidence: verdict.confidence.max(BY_COMPANY), error_px: Some(error_px), ..verdict }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::grey::Histogram;
    use crate::align::scene::{Scene, Shot, shift};

    const SIZE: (usize, usize) = (384, 256);

    #[test]
    fn order_of_brightness_is_kept_by_the_same_scene_and_by_no_other() {
        let warp = shift(3.0, -2.0);
        let take = |seed, ev| Scene::new(seed).photograph(SIZE, &warp, Shot::at(ev));
        let base = GreyPyramid::new(Scene::new(41).photograph(SIZE, &Warp::Identity, Shot::at(0.0)));
        let place = Assumed { warp, bound_px: 1.0 };
        for (ev, is_white) in [(-5.0, false), (3.0, true)] {
            let in_order = |seed| {
                let frame = take(seed, ev);
                // The brightest tenth of the black frame, and the darkest of the white one.
                let histogram = Histogram::of(&frame);
                let level = (0..=u8::MAX).find(|&v| histogram.share(0..=v) > if is_white { 0.1 } else { 0.9 }).unwrap();
                let shown = Shown { is_white, level, share: 0.1 };
                order(&base, &GreyPyramid::new(frame), &place, shown).unwrap()
            };
            let (same, other) = (in_order(41), in_order(42));
            assert!(same > 0.9 && other < IN_ORDER, "{ev}: {same} {other}");
        }
        let nothing = Shown { is_white: false, level: u8::MAX, share: 0.0 };
        let black = GreyPyramid::new(crate::plane::Plane::filled(SIZE.0, SIZE.1, 0));
        assert_eq!(order(&base, &black, &place, nothing), None);
    }
}
