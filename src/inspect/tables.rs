//! Tables: exposures, alignment, bitmaps, keypoints and matches of every frame, for programs.
//!
//! In: the [`Report`] of an alignment and the evidence of each frame. Out: `tables.json`, with the version [`SCHEMA`]
//! and units in its keys. Cost: negligible.

use super::{Detected, Evidence};
use crate::align::diagnostics::{Curve, FeatureKind, distance_px};
use crate::align::grey::Percentile;
use crate::align::{Alignment, Status, Transform};
use crate::report::{FrameReport, Report, WarningReport};
use serde::Serialize;
use std::path::PathBuf;

/// The version of the JSON: keys may be added, but are never removed.
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
    /// The frame that the others are aligned to.
    pub reference: String,
    /// The frames by rising exposure.
    pub frames: Vec<FrameTable>,
    /// The files written.
    pub outputs: Vec<String>,
    /// The warnings.
    pub warnings: Vec<WarningReport>,
    /// The times of the detectors; not in the files, which have the same bytes every time.
    #[serde(skip)]
    pub times: DetectorTimes,
}

/// Elapsed time in which each detector found the keypoints of all frames and their matches, in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectorTimes {
    /// Time of SIFT.
    pub sift_s: f64,
    /// Time of SURF.
    pub surf_s: f64,
}

/// The measurements of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameTable {
    /// Exposure and alignment, as in the report of a run.
    #[serde(flatten)]
    pub report: FrameReport,
    /// Exposure relative to the reference, in stops.
    pub relative_ev: f64,
    /// The bitmaps of the frame.
    pub mtb: BitmapTable,
    /// The SIFT keypoints of the frame, and the motion found from them.
    pub features: FeatureTable,
    /// The SURF keypoints of the frame, and the motion found from them.
    pub surf: FeatureTable,
}

/// The bitmaps of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BitmapTable {
    /// The percentile of the grey values that is the threshold.
    pub percentile: Percentile,
    /// The threshold, a grey value 0..=255.
    pub threshold_level: u8,
    /// Fraction of the pixels excluded because they are too close to the threshold.
    pub excluded_share: f64,
    /// Difference from the bitmap of the reference; null for the reference.
    pub xor: Option<XorTable>,
}

/// Difference of two bitmaps, as a fraction of the pixels that count in both.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct XorTable {
    /// Share before alignment.
    pub before_share: f64,
    /// Share after alignment.
    pub after_share: f64,
    /// Share at each rotation, in degrees, with the shift of the found motion.
    pub by_angle_deg: Samples,
    /// Share at each shift to the right, in pixels, with the rotation and downward shift of the found motion.
    pub by_dx_px: Samples,
    /// Share at each shift downwards, in pixels, with the rotation and rightward shift of the found motion.
    pub by_dy_px: Samples,
}

/// The samples of a curve.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Samples {
    /// Sampled values of the parameter.
    pub at: Vec<f64>,
    /// Fraction of the pixels that differ, for each value in `at`.
    pub share: Vec<f64>,
}

impl From<&Curve> for Samples {
    fn from(curve: &Curve) -> Self {
        Samples { at: curve.at.clone(), share: curve.share.clone() }
    }
}

/// The three kinds of keypoints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureTable {
    /// Keypoints of the photograph.
    pub plain: KindTable,
    /// Keypoints of the median threshold bitmaps of the photograph.
    pub mtb: KindTable,
    /// Keypoints of photograph and bitmaps; a point found in both is counted once.
    pub merged: KindTable,
}

impl FeatureTable {
    /// Returns the three kinds in the order of the fields.
    pub(super) fn kinds(&self) -> [&KindTable; 3] {
        [&self.plain, &self.mtb, &self.merged]
    }
}

/// Keypoints of one kind; for the reference, all values except `keypoints` are null.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KindTable {
    /// Number of keypoints.
    pub keypoints: usize,
    /// Number of matches with the reference.
    pub matches: Option<usize>,
    /// Number of inliers of the robust estimator.
    pub inliers: Option<usize>,
    /// Root mean square distance over the picture between the motion from these keypoints and the alignment; null if
    /// one of the two is missing.
    pub off_px: Option<f64>,
    /// Comparison of the motion from these keypoints with the alignment.
    pub verdict: Option<MotionComparison>,
}

/// Comparison of the motion from one kind of keypoints with the alignment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionComparison {
    /// The motion is that of the alignment, within `NEAR_PX`.
    Agrees,
    /// The motion differs from that of the alignment.
    Differs,
    /// The keypoints have too few inliers for a motion.
    NoMotion,
    /// A motion was found, but the frame has no transform to compare it with.
    NoPlace,
}

/// Root mean square distance up to which motions count as equal, in px per 1000 px of the picture diagonal: the
/// precision of matches that are accurate to about one pixel of their pyramid level.
const NEAR_PX: f64 = 1.0;
/// Smallest number of inliers of a motion; four are not evidence, because a homography always fits four matches.
const LEAST_INLIERS: usize = 10;

impl Tables {
    /// Creates the tables from the `report`, and the `evidence` and placement of each of its frames.
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

    /// Records the files written.
    pub(super) fn add_outputs(&mut self, paths: &[PathBuf]) {
        self.outputs.extend(paths.iter().map(|p| p.to_string_lossy().into_owned()));
    }

    /// Returns true if a warning degrades the result: with `--strict` the exit code is 3.
    pub fn is_degraded(&self) -> bool {
        self.warnings.iter().any(|w| w.degrades)
    }

    /// Returns the tables as JSON with a final line feed.
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
