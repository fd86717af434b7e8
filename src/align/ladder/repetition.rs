//! Scenes that repeat: if a transform is shifted by a period of the scene, the result matches as well, or nearly.
//!
//! In: the grey pyramids of a bracket. Out: the periods of the scene; and further candidates: the best candidate is
//! shifted by each period and refined. Cost: that of [`periods`] for the reference. If the reference is dark, the
//! frames with more exposure are examined too; if it has little detail, all frames. (Frames with a preset placement
//! are not examined.) In a scene that repeats, also the further candidates of each frame: up to [`MOST_ROUNDS`] times
//! two for each period.

use crate::align::agreement::periods;
use crate::align::grey::GreyPyramid;
use crate::align::ladder::Search;
use crate::align::ladder::candidate::Candidate;
use crate::align::ladder::doubtful::Target;
use crate::align::ladder::selection::Candidates;
use crate::align::ladder::starts::by_start;
use crate::align::transform::{Transform, distance};
use nalgebra::Matrix3;

/// Largest number of rounds. In each, the best candidate so far is shifted by every period, in both directions. One
/// round is not enough if the best candidate is off by several periods.
const MOST_ROUNDS: usize = 6;
/// A start that is at most this far from a candidate, in pixels, is not refined: it would usually lead to this
/// candidate again.
const KNOWN_PX: f64 = 0.5;

/// The periods of the scene of a bracket.
pub(super) struct Repetition {
    reference: usize,
    /// For each frame, the shifts under which it matches itself, in its own pixels. Not every frame is examined; for
    /// the others, the list is empty.
    periods: Vec<Vec<(f64, f64)>>,
}

impl Repetition {
    /// Finds the periods of the reference. In a dark reference, noise and rounding may hide them, so the brighter
    /// frames are examined too; if the reference has too little detail, for example because it is clipped, all frames.
    pub(super) fn find(search: &Search) -> Self {
        let reference = search.reference;
        let of = |pyramid: &GreyPyramid| periods(pyramid, search.options.mtb.max_shift);
        let of_reference = of(search.reference_pyramid());
        let is_dark = search.contents[reference].brightening_stops.is_some();
        let is_examined = |i: usize| {
            i != reference && search.given[i].is_none() && (of_reference.is_none() || (is_dark && i > reference))
        };
        let find = |(i, pyramid): (usize, &GreyPyramid)| if is_examined(i) { of(pyramid) } else { None };
        let mut all: Vec<_> = search.pyramids.iter().enumerate().map(find).map(Option::unwrap_or_default).collect();
        all[reference] = of_reference.unwrap_or_default();
        Repetition { reference, periods: all }
    }

    /// Whether frame `i` or the reference matches itself under a shift.
    pub(super) fn concerns(&self, i: usize) -> bool {
        !self.periods[self.reference].is_empty() || !self.periods[i].is_empty()
    }

    /// Returns the transforms that are shifted by one period of frame `i` or of the reference from `h`, which maps the
    /// reference to frame `i`.
    fn shifted(&self, i: usize, h: &Matrix3<f64>) -> Vec<Transform> {
        let shifts = |frame: usize| {
            let both = self.periods[frame].iter().flat_map(|&(dx, dy)| [(dx, dy), (-dx, -dy)]);
            both.map(|(dx, dy)| Matrix3::new(1.0, 0.0, dx, 0.0, 1.0, dy, 0.0, 0.0, 1.0))
        };
        let of_reference = shifts(self.reference).map(|shift| h * shift);
        of_reference.chain(shifts(i).map(|shift| shift * h)).map(Transform::Homography).collect()
    }
}

impl Search<'_> {
    /// Adds candidates: the best candidate is shifted by each period of the scene. The shifted ones may match equally
    /// well, or better. If one of them is then the best, it is shifted in the same way; there are at most
    /// [`MOST_ROUNDS`] such rounds. So the final best candidate is usually compared with the candidates that
    /// differ from it by a period. It is shifted only if more tiles agree with it than disagree; otherwise it is
    /// wrong by more than periods.
    pub(super) fn shift_by_periods(
        &self,
        i: usize,
        targets: &[Target],
        repetition: &Repetition,
        candidates: &mut Candidates,
    ) {
        let (width, height) = self.size();
        let mut shifted = None;
        for _ in 0..MOST_ROUNDS {
            let best = candidates.best().filter(|(_, c)| c.evidence() > 0.0).map(|(b, c)| (b, c.transform));
            let Some((b, best)) = best.filter(|_| best != shifted) else { break };
            shifted = Some((b, best));
            let pair = targets[b].compare(&self.pyramids[i], &best);
            for start in repetition.shifted(i, &best.matrix(width, height)) {
                let is_known = |c: &Candidate| distance(&c.transform, &start, width, height) <= KNOWN_PX;
                if candidates.any(b, is_known) {
                    continue;
                }
                candidates.add(b, by_start(&pair, &start, 0).map(|c| targets[b].discount(c)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::AlignOptions;
    use crate::align::ladder::{AllFound, search};
    use crate::align::scene::{Scene, Shot, photograph, shift};
    use crate::align::tests::frame;
    use crate::bracket::{Bracket, Frame, ReferenceChoice};
    use std::borrow::Cow;

    const SIZE: (usize, usize) = (384, 256);
    const PERIOD: f64 = 31.0;
    const TRUTH: Transform = Transform::Rigid { dx: 4.0, dy: 3.0, angle: 0.0 };

    /// Returns a photograph of a wall of equal tiles.
    fn wall(name: &str, transform: &Transform, ev: f64) -> Frame {
        let scene = Scene::new(43);
        let tiles = |x: f64, y: f64| scene.radiance(x.rem_euclid(PERIOD), y.rem_euclid(PERIOD));
        frame(name, &photograph(SIZE, transform, Shot::at(ev), tiles), ev)
    }

    /// Runs `check` on the search of a bracket whose reference is the first of `frames`.
    fn with_search(frames: Vec<Frame>, check: fn(&Search) -> AllFound) {
        let bracket = Bracket::new(frames, &ReferenceChoice::Number(1)).unwrap();
        let given = vec![None; bracket.frames().len()];
        search(&bracket, &AlignOptions::default(), &given, check).unwrap();
    }

    #[test]
    fn periods_of_a_clipped_reference_are_found_in_another_frame() {
        let frames = vec![wall("white", &Transform::Identity, 12.0), wall("middle", &TRUTH, 0.0)];
        with_search(frames, |search| {
            let max_shift = search.options.mtb.max_shift;
            assert_eq!((search.reference, periods(search.reference_pyramid(), max_shift)), (1, None));
            assert!(Repetition::find(search).concerns(0));
            AllFound::default()
        });
    }

    #[test]
    fn only_a_candidate_that_tiles_support_is_shifted() {
        let frames = vec![wall("reference", &Transform::Identity, 0.0), wall("frame", &TRUTH, 1.0)];
        with_search(frames, |search| {
            let repetition = Repetition::find(search);
            let pyramid = Cow::Borrowed(search.reference_pyramid());
            let targets = [Target { pyramid, error_px: 0.0, confidence: 1.0 }];
            // If the transform is off by half a period, nearly every tile disagrees.
            let off = shift(4.0 + PERIOD / 2.0, 3.0 + PERIOD / 2.0);
            for (start, is_shifted) in [(TRUTH, true), (off, false)] {
                let mut candidates = Candidates::default();
                candidates.add(0, Some(search.evaluate(1, start, 0.0)));
                search.shift_by_periods(1, &targets, &repetition, &mut candidates);
                assert_eq!(candidates.any(0, |c| c.transform != start), is_shifted, "{start:?}");
            }
            AllFound::default()
        });
    }
}
