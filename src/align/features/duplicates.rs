//! Keypoints and matches that several pictures of one frame have in common, counted once.
//!
//! In: keypoints. Out: which of them lie at one place and are of similar scale. Cost: a look-up in a map of squares for
//! each.

use crate::align::features::keypoint::Keypoint;
use std::collections::BTreeMap;

/// What lies at the points of a picture, by the square of 2 x 2 pixels that each lies in.
struct Squares<T>(BTreeMap<(i64, i64), Vec<T>>);

impl<T> Default for Squares<T> {
    fn default() -> Self {
        Squares(BTreeMap::new())
    }
}

impl<T> Squares<T> {
    fn square(k: &Keypoint) -> (i64, i64) {
        ((k.x / 2.0).floor() as i64, (k.y / 2.0).floor() as i64)
    }

    pub(super) fn add(&mut self, at: &Keypoint, what: T) {
        self.0.entry(Self::square(at)).or_default().push(what);
    }

    /// All that may lie within two pixels of `point`.
    fn about(&self, point: &Keypoint) -> impl Iterator<Item = &T> {
        let (cx, cy) = Self::square(point);
        let squares = (cy - 1..=cy + 1).flat_map(move |y| (cx - 1..=cx + 1).map(move |x| (x, y)));
        squares.filter_map(|at| self.0.get(&at)).flatten()
    }
}

/// Whether two keypoints lie within `radius` pixels of each other.
fn are_within(radius: f32, a: &Keypoint, b: &Keypoint) -> bool {
    let (dx, dy) = (a.x - b.x, a.y - b.y);
    dx * dx + dy * dy <= radius * radius
}

/// Keypoints by where they lie.
#[derive(Default)]
pub(super) struct KeypointIndex(Squares<Keypoint>);

impl KeypointIndex {
    pub(super) fn add(&mut self, points: &[Keypoint]) {
        points.iter().for_each(|k| self.0.add(k, *k));
    }

    /// How many of `points` are not there yet.
    pub(super) fn new_among(&self, points: &[Keypoint]) -> usize {
        points.iter().filter(|k| !self.has(k)).count()
    }

    /// Whether there is a point within a pixel of `point`, and of like scale.
    pub(super) fn has(&self, point: &Keypoint) -> bool {
        let is_same =
            |k: &Keypoint| are_within(1.0, k, point) && k.scale < 1.3 * point.scale && point.scale < 1.3 * k.scale;
        self.0.about(point).any(is_same)
    }
}

/// Pairs of keypoints by where the first of each lies.
#[derive(Default)]
pub(super) struct MatchIndex(Squares<(Keypoint, Keypoint)>);

impl MatchIndex {
    /// Adds the pair of `a` and `b`, unless there is one that joins the same two index: a point found in several
    /// pictures, or with two directions, is one inlier or none. Returns whether it was added.
    pub(super) fn add(&mut self, a: &Keypoint, b: &Keypoint) -> bool {
        let is_same = |(c, d): &(Keypoint, Keypoint)| are_within(ONE_PLACE, a, c) && are_within(ONE_PLACE, b, d);
        let is_new = !self.0.about(a).any(is_same);
        if is_new {
            self.0.add(a, (*a, *b));
        }
        is_new
    }
}

/// Keypoints no farther apart are at one place, in pixels of the level: about twice what each is off (`KEYPOINT_PX` of
/// `estimation`).
const ONE_PLACE: f32 = 1.5;
