//! Diagnostics of an alignment, for `inspect` and the report page.
//!
//! In: the grey pyramids of the reference and a frame, and the transform that was found. Out: the bitmaps; the share of
//! the compared pixels that differ, as a function of the rotation and the shift of the frame; the keypoints; the
//! matches of each kind of keypoint, and which of the matches are inliers. Cost: the bitmap search and the features,
//! some tenths of a second per frame. The diagnostics do not influence [`align`](crate::align::align). Source: Ward
//! 2003, section 2; Lowe 2004, section 7.1; the thesis that hdralign is based on. Tables 4.1 to 4.3 of the thesis
//! compare keypoints of the grey picture, of the bitmap and of both. `inspect` makes such tables for any bracket.

use crate::align::AlignOptions;
use crate::align::bitmaps;
use crate::align::bitmaps::{Motion, Rounding, ThresholdBitmaps, Zone, difference_shifted};
use crate::align::features;
use crate::align::features::robust::homography::PointPair;
use crate::align::features::{Detector, FeatureSets, Features, Keypoint, RansacOptions};
use crate::align::grey::{GreyPyramid, Percentile, measured_level};
use crate::align::result::KeypointCounts;
use crate::align::transform::{Transform, distance, level_to_full, map};
use nalgebra::Matrix3;
use rayon::prelude::*;

/// The bitmaps of one frame, on the level on which agreement is measured.
#[derive(Debug, Clone)]
pub struct FrameBitmaps {
    /// The percentile of the grey values that is the threshold.
    pub percentile: Percentile,
    /// The threshold, and the grey values around it that are excluded.
    pub zone: Zone,
    /// The threshold bitmap and the exclusion bitmap.
    pub bitmaps: ThresholdBitmaps,
    /// Length of the side of a pixel of the bitmaps, in pixels of the full size.
    pub scale: f64,
}

impl FrameBitmaps {
    /// Computes the bitmaps of `frame`, at the percentile that is used to compare `frame` with `reference`. Both may be
    /// the same frame.
    pub fn new(reference: &GreyPyramid, frame: &GreyPyramid, options: &AlignOptions) -> Self {
        let [_, frame] = Self::pair(reference, frame, options);
        frame
    }

    /// Computes the bitmaps of both frames in the same way as the bitmap search.
    fn pair(reference: &GreyPyramid, frame: &GreyPyramid, options: &AlignOptions) -> [Self; 2] {
        let level = measured_level(reference);
        let pair = bitmaps::BitmapPair::new(reference, frame, level, options.mtb.exclusion);
        let [a, b] = pair.zones;
        [(pair.reference, a), (pair.frame, b)].map(|(bitmaps, zone)| FrameBitmaps {
            percentile: pair.percentile,
            zone,
            bitmaps,
            scale: (1u64 << level) as f64,
        })
    }

    /// Returns the share of all pixels that are excluded, 0..=1.
    pub fn excluded_share(&self) -> f64 {
        let exclusion = &self.bitmaps.exclusion;
        let (width, height) = (exclusion.width(), exclusion.height());
        let counting: usize = (0..height).map(|y| (0..width).filter(|&x| exclusion.get(x, y)).count()).sum();
        1.0 - counting as f64 / (width * height) as f64
    }
}

/// The share of differing pixels as a function of one parameter of the motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// The values of the parameter, in ascending order: degrees for a rotation, pixels of the full size for a shift.
    pub at: Vec<f64>,
    /// For each value in `at`, the share of the compared pixels that differ, 0..=1.
    pub share: Vec<f64>,
}

impl Curve {
    /// Returns the value of the parameter with the smallest share of differing pixels; if several have it, the first.
    pub fn lowest(&self) -> f64 {
        let best = self.at.iter().zip(&self.share).reduce(|best, here| if here.1 < best.1 { here } else { best });
        best.map_or(0.0, |(at, _)| *at)
    }
}

/// The share of differing pixels between the bitmaps of two frames at the estimated motion, and around it.
#[derive(Debug, Clone, PartialEq)]
pub struct XorCurves {
    /// The motion at the centre of the curves: shift right and down in pixels of the full size, and rotation in
    /// degrees.
    pub centre: [f64; 3],
    /// The share of the compared pixels that differ without motion, 0..=1.
    pub before: f64,
    /// The share of the compared pixels that differ at the estimated motion, 0..=1.
    pub after: f64,
    /// The share of differing pixels as a function of the rotation; the shift is the estimated one.
    pub by_angle: Curve,
    /// The share of differing pixels as a function of the shift to the right; the rotation and the shift downwards are
    /// the estimated ones.
    pub by_dx: Curve,
    /// The share of differing pixels as a function of the shift downwards; the rotation and the shift to the right are
    /// the estimated ones.
    pub by_dy: Curve,
}

/// Step between the angles of the curve, in degrees. Within [`FINE_REACH`] degrees of the estimated angle, steps of
/// [`FINE_ANGLE_STEP`] degrees are added.
const ANGLE_STEP: f64 = 0.1;
const FINE_ANGLE_STEP: f64 = 0.02;
const FINE_REACH: f64 = 0.4;
/// Largest shift from the estimated motion, left, right, up and down, in pixels of the pyramid level.
const SHIFT_REACH: i64 = 40;

/// Computes the share of pixels that differ, as a function of the rotation and the shift of `frame`. The curves are
/// centred at the motion of `transform`, or, if there is none, at the result of a bitmap search.
pub fn xor_curves(
    reference: &GreyPyramid,
    frame: &GreyPyramid,
    transform: Option<Transform>,
    options: &AlignOptions,
) -> XorCurves {
    let level = measured_level(reference);
    let (width, height) = reference.size(0);
    let own = || bitmaps::search(reference, frame, level, &options.mtb).transform();
    let transform = transform.unwrap_or_else(own);
    let [against, bitmaps] = FrameBitmaps::pair(reference, frame, options);
    let scale = bitmaps.scale;
    let (dx, dy) = transform.shift_px(width, height);
    let angle = transform.rotation_deg(width, height);
    let share = |m: [f64; 3]| {
        let motion = Motion { dx: m[0] / scale, dy: m[1] / scale, angle: m[2].to_radians() };
        let threshold = &against.bitmaps.threshold;
        let mut warped = ThresholdBitmaps::blank(threshold.width(), threshold.height());
        bitmaps.bitmaps.warp_onto(&motion, Rounding::Nearest, &mut warped);
        difference_shifted(&against.bitmaps, &warped, 0, 0).rate()
    };
    let curve = |at: Vec<f64>, motion: &(dyn Fn(f64) -> [f64; 3] + Sync)| {
        let share = at.par_iter().map(|&t| share(motion(t))).collect();
        Curve { at, share }
    };
    let shifts =
        |centre: f64| -> Vec<f64> { (-SHIFT_REACH..=SHIFT_REACH).map(|i| centre + i as f64 * scale).collect() };
    XorCurves {
        centre: [dx, dy, angle],
        before: share([0.0; 3]),
        after: share([dx, dy, angle]),
        by_angle: curve(angles(angle, options.mtb.max_rotation_deg), &|t| [dx, dy, t]),
        by_dx: curve(shifts(dx), &|t| [t, dy, angle]),
        by_dy: curve(shifts(dy), &|t| [dx, t, angle]),
    }
}

/// Returns the angles of the curve, in degrees: the multiples of [`ANGLE_STEP`] up to a largest angle, clockwise and
/// counterclockwise. The largest angle is `most` (the limit of the bitmap search), 1 degree, or 1.2 times the angle
/// `found`, whichever is the largest. Finer steps are added around `found`, which is itself one of the angles.
fn angles(found: f64, most: f64) -> Vec<f64> {
    let reach = most.max(1.0).max(1.2 * found.abs());
    let coarse = (reach / ANGLE_STEP).floor() as i64;
    let fine = (FINE_REACH / FINE_ANGLE_STEP).round() as i64;
    let mut all: Vec<f64> = (-coarse..=coarse).map(|i| i as f64 * ANGLE_STEP).collect();
    all.extend((-fine..=fine).map(|i| found + i as f64 * FINE_ANGLE_STEP));
    all.sort_by(f64::total_cmp);
    all.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    all
}

/// The kind of the keypoints that are matched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeatureKind {
    /// Keypoints of the grey picture.
    Plain,
    /// Keypoints that are detected in the median threshold bitmaps instead of the grey picture.
    Mtb,
    /// Both kinds of keypoints. Keypoints of the grey picture are matched only with each other, and so are those of the
    /// bitmaps.
    Merged,
}

/// The features of one frame, on the level on which they are detected.
#[derive(Debug, Clone)]
pub struct FrameFeatures {
    sets: FeatureSets,
    to_full: Matrix3<f64>,
    size: (usize, usize),
}

impl FrameFeatures {
    /// Detects the features of `frame`.
    pub(crate) fn new(frame: &GreyPyramid, detector: &Detector, options: &AlignOptions) -> Self {
        let level = measured_level(frame);
        FrameFeatures {
            sets: features::features(frame, level, detector, options.mtb.exclusion),
            to_full: level_to_full(level),
            size: (frame.level(level).width(), frame.level(level).height()),
        }
    }

    /// Returns an empty set of features for `frame`, for callers that do not need features.
    pub fn none(frame: &GreyPyramid) -> Self {
        let level = measured_level(frame);
        let sets = FeatureSets { plain: Features::default(), mtb: Vec::new(), counts: KeypointCounts::default() };
        FrameFeatures { sets, to_full: level_to_full(level), size: frame.size(level) }
    }

    /// Width and height of the level on which the features were detected, in pixels.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Number of keypoints of each kind.
    pub fn counts(&self) -> KeypointCounts {
        self.sets.counts
    }

    /// Returns the keypoints of the grey picture and of the bitmaps, in pixels of the full size; a keypoint of several
    /// bitmaps is listed once.
    pub fn keypoints(&self) -> [Vec<Keypoint>; 2] {
        let full = |k: &Keypoint| {
            let (x, y) = map(&self.to_full, k.x.into(), k.y.into());
            Keypoint { x: x as f32, y: y as f32, scale: k.scale * self.to_full[(0, 0)] as f32, ..*k }
        };
        [self.sets.plain.keypoints.iter().map(full).collect(), self.sets.of_bitmaps().iter().map(full).collect()]
    }

    /// For each keypoint of the grey picture, returns whether it is also a keypoint of a bitmap; for each keypoint of
    /// the bitmaps, whether it is also one of the grey picture. Two keypoints are the same if they are within a pixel
    /// of the level and have a similar scale, as in [`counts`](Self::counts).
    pub fn found_twice(&self) -> [Vec<bool>; 2] {
        let (plain, bitmaps) = (&self.sets.plain.keypoints, self.sets.of_bitmaps());
        [features::found_among(plain, &bitmaps), features::found_among(&bitmaps, plain)]
    }

    /// Returns these features with only the keypoints of one kind.
    fn only(&self, kind: FeatureKind) -> FeatureSets {
        let (plain, mtb) = match kind {
            FeatureKind::Plain => (self.sets.plain.clone(), vec![Features::default(); self.sets.mtb.len()]),
            FeatureKind::Mtb => (Features::default(), self.sets.mtb.clone()),
            FeatureKind::Merged => (self.sets.plain.clone(), self.sets.mtb.clone()),
        };
        FeatureSets { plain, mtb, counts: self.sets.counts }
    }
}

/// The matches of a frame's keypoints with the reference's.
#[derive(Debug, Clone, PartialEq)]
pub struct Matching {
    /// Positions in the reference and in the frame, in pixels of the full size.
    pub pairs: Vec<PointPair>,
    /// Whether each pair is an inlier of the robust estimator.
    pub inlier: Vec<bool>,
    /// The transform fitted to the inliers; none if the matches do not agree on one.
    pub transform: Option<Transform>,
}

impl Matching {
    /// Returns the number of inliers.
    pub fn inliers(&self) -> usize {
        self.inlier.iter().filter(|i| **i).count()
    }
}

/// Matches the keypoints of each [`FeatureKind`], in the order of its variants, and finds the inliers.
///
/// Keypoints are matched once, by the ratio test alone, without the further steps of [`align`](crate::align::align).
pub fn matchings(reference: &FrameFeatures, frame: &FrameFeatures, options: &AlignOptions) -> [Matching; 3] {
    let to_full = &reference.to_full;
    let of = |kind| features::pairs(&reference.only(kind), &frame.only(kind), to_full, options.ratio);
    let pairs = [FeatureKind::Plain, FeatureKind::Mtb, FeatureKind::Merged].map(of);
    let in_full = RansacOptions { threshold: options.ransac.threshold * to_full[(0, 0)], ..options.ransac.clone() };
    pairs.map(|pairs| {
        let found = features::agreed(&pairs, &in_full, options.robust);
        let mut inlier = vec![false; pairs.len()];
        for &i in found.iter().flat_map(|f| &f.inliers) {
            inlier[i] = true;
        }
        Matching { pairs, inlier, transform: found.map(|f| Transform::Homography(f.homography)) }
    })
}

/// Returns the root mean square distance between the positions of a pixel under two transforms, over a picture of
/// `size`.
pub fn distance_px(a: &Transform, b: &Transform, size: (usize, usize)) -> f64 {
    distance(a, b, size.0, size.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::features::distance_squared;
    use crate::align::scene::{Scene, Shot, rigid};

    const SIZE: (usize, usize) = (420, 300);

    fn pair(transform: &Transform) -> [GreyPyramid; 2] {
        let scene = Scene::new(5);
        [(Transform::Identity, 0.0), (*transform, 2.0)]
            .map(|(w, ev)| GreyPyramid::new(scene.photograph(SIZE, &w, Shot::at(ev))))
    }

    #[test]
    fn curves_are_lowest_at_the_true_motion() {
        let truth = rigid(9.0, -6.0, 1.7);
        let [reference, frame] = pair(&truth);
        let curves = xor_curves(&reference, &frame, Some(truth), &AlignOptions::default());
        // Positions in bitmaps are rounded to whole pixels. Therefore two angles can be distinguished only if a pixel
        // at the rim, 150 px from the centre, has positions under them that are half a pixel or more apart. This is a
        // difference of 0.2 degrees.
        assert!((curves.by_angle.lowest() - 1.7).abs() <= 0.2, "{}", curves.by_angle.lowest());
        assert!((curves.by_dx.lowest() - 9.0).abs() <= 1.0 && (curves.by_dy.lowest() + 6.0).abs() <= 1.0);
        assert!(curves.after < 0.3 * curves.before, "{} {}", curves.after, curves.before);
        assert!(
            curves.by_angle.at.windows(2).all(|w| w[0] < w[1])
                && curves.by_angle.at.len() == curves.by_angle.share.len()
        );
        assert!(curves.by_angle.at.first().is_some_and(|a| *a <= -4.9));
    }

    #[test]
    fn a_frame_without_a_place_is_shown_about_its_bitmaps_own() {
        let truth = rigid(9.0, -6.0, 1.7);
        let [reference, frame] = pair(&truth);
        let curves = xor_curves(&reference, &frame, None, &AlignOptions::default());
        assert!((curves.centre[0] - 9.0).abs() < 1.0 && (curves.centre[2] - 1.7).abs() < 0.3, "{:?}", curves.centre);
    }

    #[test]
    fn excluded_pixels_of_bitmaps_are_reported() {
        let [reference, frame] = pair(&Transform::Identity);
        let options = AlignOptions::default();
        let bitmaps = FrameBitmaps::new(&reference, &frame, &options);
        let zone = bitmaps.zone;
        let near = frame.level(0).as_slice().iter().filter(|v| (zone.low..=zone.high).contains(v));
        let expected = near.count() as f64 / (SIZE.0 * SIZE.1) as f64;
        assert!((bitmaps.excluded_share() - expected).abs() < 1e-12 && bitmaps.scale == 1.0);
    }

    #[test]
    fn inliers_agree_with_the_truth() {
        let truth = rigid(9.0, -6.0, 1.7);
        let options = AlignOptions::default();
        let [reference, frame] = pair(&truth).map(|p| FrameFeatures::new(&p, &options.detector(), &options));
        let [plain, mtb, merged] = matchings(&reference, &frame, &options);
        assert!(merged.pairs.len() <= plain.pairs.len() + mtb.pairs.len() && merged.pairs.len() >= plain.pairs.len());
        let inliers = [&plain, &mtb, &merged].map(Matching::inliers);
        assert!(inliers[0] >= 10 && inliers[1] >= 10 && inliers[2] >= inliers[0], "{inliers:?}");
        let h = truth.matrix(SIZE.0, SIZE.1);
        let off = |p: &PointPair| distance_squared(&h, p).sqrt();
        for (pair, inlier) in merged.pairs.iter().zip(&merged.inlier) {
            // Inliers are within the threshold of the motion that was found. That motion has itself an error of less
            // than a pixel, which is added to the limit.
            assert!(!inlier || off(pair) < options.ransac.threshold + 1.0);
        }
        assert!(distance_px(&truth, &merged.transform.unwrap(), SIZE) < 1.0);
        let counts = frame.counts();
        assert_eq!(frame.keypoints().map(|k| k.len()), [counts.plain, counts.mtb]);
        let twice = frame.found_twice().map(|t| t.iter().filter(|t| **t).count());
        assert!(twice[0] > 0 && twice[1] == counts.plain + counts.mtb - counts.merged, "{twice:?} {counts:?}");
    }
}
