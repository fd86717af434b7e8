//! The homography between two frames, estimated from the matches of all their feature sets.
//!
//! In: the [`FeatureSets`] of two frames. Out: a [`Consensus`], or none. Cost: three rounds of matching, two of them
//! guided, each with a robust fit. Source: Hartley & Zisserman, Multiple View Geometry (2nd ed., 2004), algorithm 4.6.

use crate::align::AlignOptions;
use crate::align::features::duplicates::MatchIndex;
use crate::align::features::robust::homography::{PointPair, fit};
use crate::align::features::{
    Consensus, FeatureSets, Guide, Keypoint, RansacOptions, RobustMethod, distance_squared, lmeds, match_mutual, ransac,
};
use crate::align::transform::map;
use nalgebra::Matrix3;

/// Returns the matches of all feature sets that pass the ratio test, in pixels of the full size. The matching is not
/// guided by a homography.
pub(crate) fn pairs(
    reference: &FeatureSets,
    frame: &FeatureSets,
    to_full: &Matrix3<f64>,
    ratio: f64,
) -> Vec<PointPair> {
    Matches::new(reference, frame, to_full, ratio, None).pairs
}

/// Returns the homography that most matches of all feature sets support, and its inliers, in pixels of the full size.
/// None if there is no consensus.
///
/// If there are enough inliers, the matching is repeated twice with a guide: only the keypoints near the position that
/// the best homography so far predicts are candidates. Similar structure elsewhere then no longer competes (Hartley &
/// Zisserman 2004, algorithm 4.6).
pub(crate) fn by_matches(
    reference: &FeatureSets,
    frame: &FeatureSets,
    to_full: &Matrix3<f64>,
    options: &AlignOptions,
) -> Option<Consensus> {
    let pixel = to_full[(0, 0)];
    let in_full = RansacOptions { threshold: options.ransac.threshold * pixel, ..options.ransac.clone() };
    let search = |matches: &Matches| agreed(&matches.pairs, &in_full, options.robust);
    let mut matches = Matches::new(reference, frame, to_full, options.ratio, None);
    let mut best = search(&matches)?;
    if best.inliers.len() < LEAST_GUIDES {
        return Some(best);
    }
    // The ratio test rejects ambiguous matches. The smaller the search radius, the less ambiguity there is, so the
    // second guided matching uses a weaker test.
    for (radius, ratio) in [(WIDE_PX, options.ratio), (NARROW_PX, 0.5 * (1.0 + options.ratio))] {
        let guide = Guide { motion: to_full.try_inverse()? * best.homography * to_full, radius };
        let guided = Matches::new(reference, frame, to_full, ratio, Some(&guide));
        if let Some(found) = search(&guided).filter(|f| f.inliers.len() > best.inliers.len()) {
            (matches, best) = (guided, found);
        }
    }
    Some(matches.settle(best, pixel))
}

/// Returns the homography that most of `pairs` support, estimated with `method`.
pub(crate) fn agreed(pairs: &[PointPair], options: &RansacOptions, method: RobustMethod) -> Option<Consensus> {
    match method {
        RobustMethod::Ransac => ransac::search(pairs, options),
        RobustMethod::Lmeds => lmeds::search(pairs, options),
    }
}

/// Guided matching needs at least this number of inliers. Fewer may agree by chance, and guided matching would confirm
/// them.
const LEAST_GUIDES: usize = 8;
/// Search radius of the first guided matching, in pixels of the pyramid level. The value is four times the default
/// inlier threshold of RANSAC.
const WIDE_PX: f64 = 10.0;
/// Search radius of the second guided matching, in pixels of the pyramid level.
const NARROW_PX: f64 = 6.0;
/// Standard deviation of the position of a keypoint with scale 1, in pixels of the level. It grows with the square root
/// of the scale. Measured on rendered brackets.
const KEYPOINT_PX: f64 = 0.6;
/// Number of iterations of the final reweighted fit.
const REFITS: usize = 8;

/// The matches of all feature sets.
pub(super) struct Matches {
    /// Positions of the matched keypoints, in pixels of the full size.
    pub(super) pairs: Vec<PointPair>,
    /// For each pair, the larger of the scales of its two keypoints, but at least 1, in pixels of the level.
    pub(super) scales: Vec<f64>,
}

impl Matches {
    fn new(
        reference: &FeatureSets,
        frame: &FeatureSets,
        to_full: &Matrix3<f64>,
        ratio: f64,
        guide: Option<&Guide>,
    ) -> Self {
        let full = |k: &Keypoint| {
            let (x, y) = map(to_full, k.x.into(), k.y.into());
            [x, y]
        };
        let mut index = MatchIndex::default();
        let (pairs, scales) = std::iter::once((&reference.plain, &frame.plain))
            .chain(reference.mtb.iter().zip(&frame.mtb))
            .flat_map(|(a, b)| {
                let matches = match_mutual(a, b, ratio, guide);
                matches.into_iter().map(|m| (&a.keypoints[m.reference], &b.keypoints[m.frame]))
            })
            .filter(|(a, b)| index.add(a, b))
            .map(|(a, b)| ((full(a), full(b)), f64::from(a.scale.max(b.scale)).max(1.0)))
            .unzip();
        Matches { pairs, scales }
    }

    /// Fits the homography of `found` again to its inliers, weighted by their precision.
    ///
    /// Matches of large keypoints get a lower weight, because their positions are less precise. Inliers far from their
    /// predicted positions also get a lower weight (Geman & McClure). `pixel` is the width of a pixel of the level, in
    /// pixels of the full size.
    pub(super) fn settle(&self, found: Consensus, pixel: f64) -> Consensus {
        let right: Vec<PointPair> = found.inliers.iter().map(|&i| self.pairs[i]).collect();
        let squares = |h: &Matrix3<f64>| -> Vec<f64> { right.iter().map(|p| distance_squared(h, p)).collect() };
        let mut homography = found.homography;
        for _ in 0..REFITS {
            let weights: Vec<f64> = squares(&homography)
                .iter()
                .zip(&found.inliers)
                .map(|(square, &i)| {
                    let variance = KEYPOINT_PX * KEYPOINT_PX * pixel * pixel * self.scales[i];
                    let near = 1.0 / (1.0 + square / variance);
                    near * near / self.scales[i]
                })
                .collect();
            let Some(better) = fit(&right, Some(&weights)) else {
                break;
            };
            homography = better;
        }
        let rms = (squares(&homography).iter().sum::<f64>() / right.len() as f64).sqrt();
        Consensus { homography, rms, ..found }
    }
}
