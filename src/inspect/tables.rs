//! Tables for programs: exposures, alignment, bitmaps, keypoints and matches of every frame.
//!
//! In: the [`Report`] of an alignment, and the bitmaps and features of each frame. Out: `tables.json`. Its version is
//! [`SCHEMA`], and its keys contain the units. Cost: negligible.

use super::{Detected, Evidence};
use crate::align::diagnostics::{Curve, FeatureKind, distance_px};
use crate::align::grey::Percentile;
use crate::align::{Alignment, Status, Transform};
use crate::report::{FrameReport, Report, WarningReport};
use serde::Serialize;
use std::path::PathBuf;

/// The version of the JSON format: keys may be added, but are never removed.
pub const SCHEMA: &str = "hdralign-inspect/1";

/// All tables of a bracket.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tables {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// The program and its version.
    pub software: &'static str,
    /// Width of every frame, after EXIF orientation.
    pub width_px: usize,
    /// Height of every frame, after EXIF orientation.
    pub height_px: usize,
    /// Width of the pyramid level used for bitmaps and features.
    pub level_width_px: usize,
    /// Height of the pyramid level used for bitmaps and features.
    pub level_height_px: usize,
    /// The path of the frame that the others are aligned to.
    pub reference: String,
    /// The frames, from the smallest to the largest exposure.
    pub frames: Vec<FrameTable>,
    /// The paths of the files that were written.
    pub outputs: Vec<String>,
    /// The warnings of the alignment.
    pub warnings: Vec<WarningReport>,
    /// The running times of the detectors. They are not written to the files, because the files must have the same
    /// bytes in every run.
    #[serde(skip)]
    pub times: DetectorTimes,
}

/// For each detector, the elapsed time for finding the keypoints of all frames and their matches, in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectorTimes {
    /// Time of SIFT.
    pub sift_s: f64,
    /// Time of SURF.
    pub surf_s: f64,
}

/// The measured values for one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameTable {
    /// The exposure and the alignment of the frame, as in the report of `merge`.
    #[serde(flatten)]
    pub report: FrameReport,
    /// Exposure of the frame divided by the exposure of the reference frame, in stops (log2).
    pub relative_ev: f64,
    /// The bitmaps of the frame.
    pub mtb: BitmapTable,
    /// The SIFT keypoints of the frame, and the motion that they alone give.
    pub features: FeatureTable,
    /// The SURF keypoints of the frame, and the motion that they alone give.
    pub surf: FeatureTable,
}

/// The bitmaps of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BitmapTable {
    /// The percentile of the grey values that is used as the threshold.
    pub percentile: Percentile,
    /// The threshold, a grey value 0..=255.
    pub threshold_level: u8,
    /// Fraction of the pixels that are excluded because their grey value is too close to the threshold.
    pub excluded_share: f64,
    /// Difference from the bitmap of the reference frame; null for the reference frame.
    pub xor: Option<XorTable>,
}

/// Difference of two bitmaps: the number of pixels that differ, divided by the number of pixels that are excluded in
/// neither.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct XorTable {
    /// Fraction of the pixels that differ before alignment.
    pub before_share: f64,
    /// Fraction of the pixels that differ after alignment.
    pub after_share: f64,
    /// Fraction as a function of the rotation in degrees. The shift is the shift of the found motion.
    pub by_angle_deg: Samples,
    /// Fraction as a function of the shift to the right in pixels. Rotation and downward shift are as in the found
    /// motion.
    pub by_dx_px: Samples,
    /// Fraction as a function of the downward shift in pixels. Rotation and shift to the right are as in the found
    /// motion.
    pub by_dy_px: Samples,
}

/// Points of a curve.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Samples {
    /// Values of the rotation or shift at the points.
    pub at: Vec<f64>,
    /// Fraction of the pixels that differ at each value in `at`.
    pub share: Vec<f64>,
}

impl From<&Curve> for Samples {
    fn from(curve: &Curve) -> Self {
        Samples { at: curve.at.clone(), share: curve.share.clone() }
    }
}

/// The keypoints that one detector found in a frame, of three kinds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureTable {
    /// Keypoints of the photograph.
    pub plain: KindTable,
    /// Keypoints of the median threshold bitmaps of the photograph.
    pub mtb: KindTable,
    /// Keypoints of the photograph and of its bitmaps together; a keypoint found in both is counted once.
    pub merged: KindTable,
}

impl FeatureTable {
    /// Returns the three kinds in the order of the fields.
    pub(super) fn kinds(&self) -> [&KindTable; 3] {
        [&self.plain, &self.mtb, &self.merged]
    }
}

/// The results for keypoints of one kind. For the reference frame, all values except `keypoints` are null.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KindTable {
    /// Number of keypoints.
    pub keypoints: usize,
    /// Number of matches with the reference frame.
    pub matches: Option<usize>,
    /// Number of matches that are inliers of the robust estimator.
    pub inliers: Option<usize>,
    /// Distance between the motion from these keypoints and the motion of the alignment, in px: the root mean square
    /// over the picture. Null if one of the two motions is missing.
    pub off_px: Option<f64>,
    /// Result of the comparison of the motion from these keypoints with the alignment.
    pub verdict: Option<MotionComparison>,
}

/// Result of the comparison of two motions: the motion from one kind of keypoints, and the motion of the alignment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionComparison {
    /// The two motions are equal, within `NEAR_PX`.
    Agrees,
    /// The two motions differ.
    Differs,
    /// There are too few inliers among these keypoints for a motion.
    NoMotion,
    /// The keypoints give a motion, but the alignment has no transform for the frame.
    NoPlace,
}

/// Two motions count as equal up to this root mean square distance, in px per 1000 px of the picture diagonal; in px
/// if the diagonal is shorter than that. This is the precision of matches that are accurate to about one pixel of
/// their pyramid level.
const NEAR_PX: f64 = 1.0;
/// Smallest number of inliers for a motion. Four inliers would prove nothing, because a homography fits any four
/// matches.
const LEAST_INLIERS: usize = 10;

impl Tables {
    /// Creates the tables from `report`, and from the evidence (bitmaps and features) and the placement (in
    /// `alignment`) of each frame.
    pub(super) fn new(report: Report, evidence: &[Evidence], alignment: &Alignment, times: DetectorTimes) -> Self {
        let size = (report.width_px, report.height_px);
        let reference = report.frames.iter().find(|f| f.alignment.status == Status::Reference);
        let exposure = reference.map_or(1.0, |f| f.relative_exposure);
        let level = evidence.first().map_or(size, |e| e.sift.features.size());
        let found = evidence.iter().zip(&alignment.placements);
        let frames = report.frames.into_iter().zip(found).map(|(report, (evidence, placement))| FrameTable {
            relative_ev: libm::log2(report.relative_exposure / exposure),
            mtb: bitmap_table(evidence),
            features: feature_table(&evidence.sift, placement.transform().as_ref(), size),
            surf: feature_table(&evidence.surf, placement.transform().as_ref(), size),
            report,
        });
        Tables {
            schema: SCHEMA,
            software: report.software,
            width_px: size.0,
            height_px: size.1,
            level_width_px: level.0,
            level_height_px: level.1,
            reference: report.reference,
            frames: frames.collect(),
            outputs: Vec::new(),
            warnings: report.warnings,
            times,
        }
    }

    /// Adds the paths of files that were written.
    pub(super) fn add_outputs(&mut self, paths: &[PathBuf]) {
        self.outputs.extend(paths.iter().map(|p| p.to_string_lossy().into_owned()));
    }

    /// Returns whether a warning degrades the result; with `--strict`, the exit code is then 3.
    pub fn is_degraded(&self) -> bool {
        self.warnings.iter().any(|w| w.degrades)
    }

    /// Returns the tables as JSON, with a newline at the end.
    pub fn to_json(&self) -> String {
        // The tables contain only strings, numbers and lists of them, so the conversion cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

fn bitmap_table(evidence: &Evidence) -> BitmapTable {
    BitmapTable {
        percentile: evidence.bitmaps.percentile,
        threshold_level: evidence.bitmaps.zone.threshold,
        excluded_share: evidence.bitmaps.excluded_share(),
        xor: evidence.xor.as_ref().map(|xor| XorTable {
            before_share: xor.before,
            after_share: xor.after,
            by_angle_deg: (&xor.by_angle).into(),
            by_dx_px: (&xor.by_dx).into(),
            by_dy_px: (&xor.by_dy).into(),
        }),
    }
}

fn feature_table(detected: &Detected, warp: Option<&Transform>, size: (usize, usize)) -> FeatureTable {
    let counts = detected.features.counts();
    let of = |kind: FeatureKind, keypoints| {
        let blank = KindTable { keypoints, matches: None, inliers: None, off_px: None, verdict: None };
        let Some(matchings) = &detected.matchings else { return blank };
        let matching = &matchings[kind as usize];
        let inliers = matching.inliers();
        let motion = matching.transform.filter(|_| inliers >= LEAST_INLIERS);
        let off_px = motion.zip(warp).map(|(own, place)| distance_px(&own, place, size));
        let diagonal = ((size.0 * size.0 + size.1 * size.1) as f64).sqrt();
        let verdict = match (motion, off_px) {
            (None, _) => MotionComparison::NoMotion,
            (Some(_), None) => MotionComparison::NoPlace,
            (Some(_), Some(off)) if off <= NEAR_PX * (diagonal / 1000.0).max(1.0) => MotionComparison::Agrees,
            (Some(_), Some(_)) => MotionComparison::Differs,
        };
        let matches = Some(matching.pairs.len());
        KindTable { matches, inliers: Some(inliers), off_px, verdict: Some(verdict), ..blank }
    };
    FeatureTable {
        plain: of(FeatureKind::Plain, counts.plain),
        mtb: of(FeatureKind::Mtb, counts.mtb),
        merged: of(FeatureKind::Merged, counts.merged),
    }
}
