//! Detection of keypoints and matches that are found more than once.
//!
//! In: keypoints, or matches. Out: whether a similar keypoint or match is known already. Cost: for each query, nine
//! look-ups in a map of squares.

use crate::align::features::keypoint::Keypoint;
use std::collections::BTreeMap;

/// Values that belong to keypoints. The key is the square of 2 x 2 pixels that contains the keypoint.
type Squares<T> = BTreeMap<(i64, i64), Vec<T>>;

fn square(k: &Keypoint) -> (i64, i64) {
    ((k.x / 2.0).floor() as i64, (k.y / 2.0).floor() as i64)
}

/// Returns the values in the square of `point` and in the eight squares around it. These include all values within two
/// pixels of `point`.
fn near<'a, T>(squares: &'a Squares<T>, point: &Keypoint) -> impl Iterator<Item = &'a T> {
    let (cx, cy) = square(point);
    let all = (cy - 1..=cy + 1).flat_map(move |y| (cx - 1..=cx + 1).map(move |x| (x, y)));
    all.filter_map(|at| squares.get(&at)).flatten()
}

/// Whether two keypoints are at most `radius` pixels apart.
fn are_within(radius: f32, a: &Keypoint, b: &Keypoint) -> bool {
    let (dx, dy) = (a.x - b.x, a.y - b.y);
    dx * dx + dy * dy <= radius * radius
}

/// Keypoints, indexed by position.
#[derive(Default)]
pub(super) struct KeypointIndex(Squares<Keypoint>);

impl KeypointIndex {
    pub(super) fn add(&mut self, points: &[Keypoint]) {
        points.iter().for_each(|k| self.0.entry(square(k)).or_default().push(*k));
    }

    /// Whether the index has a keypoint within one pixel of `point` whose scale differs by a factor of less than 1.3.
    pub(super) fn has(&self, point: &Keypoint) -> bool {
        let is_same =
            |k: &Keypoint| are_within(1.0, k, point) && k.scale < 1.3 * point.scale && point.scale < 1.3 * k.scale;
        near(&self.0, point).any(is_same)
    }
}

/// Matches (keypoint of the reference, keypoint of the frame), indexed by the position of the reference's keypoint.
#[derive(Default)]
pub(super) struct MatchIndex(Squares<(Keypoint, Keypoint)>);

impl MatchIndex {
    /// Adds the match of `a` and `b` unless a match between the same positions is known. Returns whether the match was
    /// added.
    ///
    /// A point may be found in several bitmaps or with two orientations. It must not count as several inliers.
    pub(super) fn add(&mut self, a: &Keypoint, b: &Keypoint) -> bool {
        let is_same = |(c, d): &(Keypoint, Keypoint)| are_within(ONE_PLACE, a, c) && are_within(ONE_PLACE, b, d);
        let is_new = !near(&self.0, a).any(is_same);
        if is_new {
            self.0.entry(square(a)).or_default().push((*a, *b));
        }
        is_new
    }
}

/// Keypoints up to this distance apart count as being at one position, in pixels of the level. The value is about twice
/// the position error of a keypoint (`KEYPOINT_PX` of `estimation`).
const ONE_PLACE: f32 = 1.5;
