//! The features of a frame, of two kinds: of the plain picture, and of its median threshold bitmap; and the motion between two frames
//! on which both kinds agree.
//!
//! In: grey pyramids. Out: [`FeatureSets`], and of two of them a [`Consensus`]. Cost: two runs of [`sift`] over the level on which
//! features are sought; for a pair of frames four tables of matches and two of [`ransac`]. Source: the thesis, section 4.3 (keypoints
//! of the bitmap are many where the plain picture is dark or bright, and few where it is not; both together are always enough).

use super::KeypointCounts;
use super::features::{Features, Guide, Keypoint, match_mutual};
use super::homography::Pair;
use super::mtb::{self, GreyPyramid, MtbOptions};
use super::ransac::{self, Consensus, RansacOptions};
use super::sift::{self, SiftOptions};
use super::warp::map;
use crate::plane::Plane;
use nalgebra::Matrix3;

/// Features of a frame: of the plain picture, and of its median threshold bitmap.
#[derive(Debug, Clone, Default)]
pub(super) struct FeatureSets {
    pub(super) plain: Features,
    pub(super) mtb: Features,
    pub(super) counts: KeypointCounts,
}

/// The features of a frame, on level `level` of its pyramid.
pub(super) fn features(pyramid: &GreyPyramid, level: usize, sift: &SiftOptions, mtb: &MtbOptions) -> FeatureSets {
    let grey = pyramid.level(level);
    let plain = sift::detect(grey, sift);
    let histogram = pyramid.histogram(level);
    let threshold = histogram.level(mtb::own_percentile(histogram, mtb.exclusion));
    let bitmap = Plane::from_rows(grey.width(), grey.height(), |y, row| {
        for (v, g) in row.iter_mut().zip(grey.row(y)) {
            *v = if *g > threshold { 255 } else { 0 };
        }
    });
    let mtb = sift::detect(&bitmap, sift);
    let counts =
        KeypointCounts { plain: plain.len(), mtb: mtb.len(), merged: plain.len() + mtb.len() - repeated(&plain, &mtb) };
    FeatureSets { plain, mtb, counts }
}

/// How many keypoints of the bitmap are points of the plain picture too: within a pixel, and of like scale.
fn repeated(plain: &Features, mtb: &Features) -> usize {
    let cell = |x: f32, y: f32| ((x / 2.0).floor() as i64, (y / 2.0).floor() as i64);
    let mut cells: std::collections::BTreeMap<(i64, i64), Vec<usize>> = std::collections::BTreeMap::new();
    for (i, k) in plain.keypoints.iter().enumerate() {
        cells.entry(cell(k.x, k.y)).or_default().push(i);
    }
    let same = |a: &Keypoint, b: &Keypoint| {
        let (dx, dy) = (a.x - b.x, a.y - b.y);
        dx * dx + dy * dy <= 1.0 && a.scale < 1.3 * b.scale && b.scale < 1.3 * a.scale
    };
    mtb.keypoints
        .iter()
        .filter(|k| {
            let (cx, cy) = cell(k.x, k.y);
            (cy - 1..=cy + 1).any(|y| {
                (cx - 1..=cx + 1)
                    .any(|x| cells.get(&(x, y)).is_some_and(|c| c.iter().any(|&i| same(&plain.keypoints[i], k))))
            })
        })
        .count()
}

/// The homography that the matches of both sets agree on, in pixels of the full size, and those that do; sought once more among the
/// matches near the places that it gives, where what repeats elsewhere no longer competes (Hartley & Zisserman 2004, algorithm 4.6).
pub(super) fn by_matches(
    reference: &FeatureSets,
    frame: &FeatureSets,
    to_full: &Matrix3<f64>,
    ratio: f64,
    options: &RansacOptions,
) -> Option<Consensus> {
    let in_full = RansacOptions { threshold: options.threshold * to_full[(0, 0)], ..options.clone() };
    let first = ransac::search(&pairs(reference, frame, to_full, ratio, None), &in_full)?;
    let motion = to_full.try_inverse()? * first.homography * to_full;
    let guide = Guide { motion, radius: GUIDED_PX };
    let second = ransac::search(&pairs(reference, frame, to_full, ratio, Some(&guide)), &in_full);
    Some(second.filter(|s| s.inliers.len() > first.inliers.len()).unwrap_or(first))
}

/// How far from its place a guided match may lie, in pixels of the level: some times what makes it an inlier.
const GUIDED_PX: f64 = 10.0;

/// The matches of both sets, in pixels of the full size.
fn pairs(
    reference: &FeatureSets,
    frame: &FeatureSets,
    to_full: &Matrix3<f64>,
    ratio: f64,
    guide: Option<&Guide>,
) -> Vec<Pair> {
    let full = |k: &Keypoint| {
        let (x, y) = map(to_full, k.x.into(), k.y.into());
        [x, y]
    };
    let mut pairs: Vec<Pair> = [(&reference.plain, &frame.plain), (&reference.mtb, &frame.mtb)]
        .into_iter()
        .flat_map(|(a, b)| {
            let matches = match_mutual(a, b, ratio, guide);
            matches.into_iter().map(|m| (full(&a.keypoints[m.reference]), full(&b.keypoints[m.frame])))
        })
        .collect();
    drop_repeated(&mut pairs, to_full[(0, 0)]);
    pairs
}

/// Of pairs that join the same two places, within a pixel of the level, only the first stays: a point found in both pictures, or with two
/// directions, has one voice.
fn drop_repeated(pairs: &mut Vec<Pair>, pixel: f64) {
    let cell = |p: &Pair| [p.0[0], p.0[1], p.1[0], p.1[1]].map(|v| (v / (1.5 * pixel)).floor() as i64);
    let mut seen = std::collections::BTreeSet::new();
    pairs.retain(|p| seen.insert(cell(p)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_found_twice_are_counted_once() {
        let features = |list: &[(f32, f32, f32)]| Features {
            keypoints: list
                .iter()
                .map(|&(x, y, scale)| Keypoint { x, y, scale, angle: 0.0, response: 0.1, bright: true })
                .collect(),
            descriptors: vec![[0; 128]; list.len()],
        };
        let plain = features(&[(10.0, 10.0, 2.0), (50.0, 20.0, 3.0), (0.2, 0.1, 2.0)]);
        let bitmap = features(&[
            (10.7, 10.6, 2.0), // 0.92 px off: the same
            (10.8, 10.7, 2.0), // 1.06 px off: another
            (49.9, 19.5, 3.8), // 1.27 times the scale: the same
            (49.9, 19.5, 4.0), // 1.33 times
            (-0.1, 0.0, 2.0),  // across the border between cells: the same
            (90.0, 90.0, 2.0),
        ]);
        assert_eq!(repeated(&plain, &bitmap), 3);
        assert_eq!((repeated(&plain, &Features::default()), repeated(&Features::default(), &bitmap)), (0, 0));
    }
}
