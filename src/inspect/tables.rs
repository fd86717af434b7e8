//! Tables: exposures, places, bitmaps, keypoints and matches of every frame, as JSON for programs and as text for people.
//!
//! In: the [`Report`] of an alignment and each frame's evidence. Out: `tables.json`, versioned by [`SCHEMA`], units in its keys, and
//! `tables.txt`, the same in columns. Cost: none. Tables 2 to 4 of the text are Tables 4.1 to 4.3 of the thesis, for any bracket:
//! keypoints, matches and what they are worth, for the plain picture, for its bitmap, and for both merged.

use crate::align::evidence::{Curve, FeatureKind, FrameBitmaps, FrameFeatures, Matching, XorCurves, distance_px};
use crate::align::mtb::Percentile;
use crate::align::warp::Warp;
use crate::align::{Model, Status};
use crate::bracket::exposure::ExposureSource;
use crate::report::{FrameReport, Report, WarningReport};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The version of the JSON: keys are only ever added to it.
pub const SCHEMA: &str = "hdralign-inspect/1";

/// All tables of a bracket.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tables {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// The program and its version.
    pub software: &'static str,
    /// Width of every frame, orientation applied.
    pub width_px: usize,
    /// Height of every frame, orientation applied.
    pub height_px: usize,
    /// Width of the level on which bitmaps are shown and features sought.
    pub level_width_px: usize,
    /// Its height.
    pub level_height_px: usize,
    /// The frame that the others are aligned to.
    pub reference: String,
    /// The frames by rising exposure.
    pub frames: Vec<FrameTable>,
    /// The files written.
    pub outputs: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<WarningReport>,
}

/// What is known of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameTable {
    /// Exposure and place, as in the report of a run.
    #[serde(flatten)]
    pub report: FrameReport,
    /// Exposure over the reference's, in stops.
    pub relative_ev: f64,
    /// Its bitmaps.
    pub mtb: BitmapTable,
    /// Its keypoints, and what they are worth.
    pub features: FeatureTable,
}

/// The bitmaps of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BitmapTable {
    /// The percentile of the grey levels that is the threshold.
    pub percentile: Percentile,
    /// The threshold, a grey level 0..=255.
    pub threshold_level: u8,
    /// The share of the pixels that are too near the threshold to count.
    pub excluded_share: f64,
    /// How it compares with the reference's; null for the reference.
    pub xor: Option<XorTable>,
}

/// What differs between two bitmaps, as a share of the pixels that count in both.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct XorTable {
    /// Where nothing moves.
    pub before_share: f64,
    /// Under the motion found.
    pub after_share: f64,
    /// At each rotation, in degrees, shifted as found.
    pub by_angle_deg: Samples,
    /// At each shift to the right, in pixels, turned as found.
    pub by_dx_px: Samples,
    /// At each shift downwards, in pixels, turned as found.
    pub by_dy_px: Samples,
}

/// A curve.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Samples {
    /// Where.
    pub at: Vec<f64>,
    /// What differs there.
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
    /// SIFT on the plain picture.
    pub plain: KindTable,
    /// SIFT on its median threshold bitmap.
    pub mtb: KindTable,
    /// Both, points found twice counted once.
    pub merged: KindTable,
}

impl FeatureTable {
    fn kinds(&self) -> [&KindTable; 3] {
        [&self.plain, &self.mtb, &self.merged]
    }
}

/// Keypoints of one kind; all but their number is null for the reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KindTable {
    /// How many.
    pub keypoints: usize,
    /// Of these, matched with the reference's.
    pub matches: Option<usize>,
    /// Of these, believed by RANSAC.
    pub inliers: Option<usize>,
    /// Root mean square distance over the picture between the motion that they agree on and the place found; null without either.
    pub off_px: Option<f64>,
    /// What they alone would have led to.
    pub verdict: Option<KindVerdict>,
}

/// Whether keypoints of one kind lead to the place found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum KindVerdict {
    /// They do, within [`NEAR_PX`].
    Agrees,
    /// They lead elsewhere.
    Differs,
    /// Too few agree on any motion.
    NoMotion,
    /// They agree on a motion, but the frame was rejected, so there is no place to hold it against.
    NoPlace,
}

/// Motions no farther apart are the same, in pixels for each 1000 of the picture's diagonal (root mean square): what matches that are
/// good to a pixel or so of their level tell apart.
const NEAR_PX: f64 = 1.0;
/// Fewer inliers are chance: four are always right.
const LEAST_INLIERS: usize = 10;

/// What was found for one frame beside its report; the last two are none for the reference.
pub(super) struct Found<'a> {
    pub(super) bitmaps: &'a FrameBitmaps,
    pub(super) features: &'a FrameFeatures,
    pub(super) xor: Option<&'a XorCurves>,
    pub(super) matchings: Option<&'a [Matching; 3]>,
    pub(super) warp: Option<&'a Warp>,
}

impl Tables {
    /// The tables of the frames of `report`, of which each has its `found`.
    pub(super) fn new(report: Report, found: &[Found]) -> Self {
        let size = (report.width_px, report.height_px);
        let reference = report.frames.iter().find(|f| f.alignment.status == Status::Reference);
        let exposure = reference.map_or(1.0, |f| f.relative_exposure);
        let level = found.first().map_or(size, |f| f.features.size());
        let frames = report.frames.into_iter().zip(found).map(|(report, found)| FrameTable {
            relative_ev: libm::log2(report.relative_exposure / exposure),
            mtb: bitmap_table(found),
            features: feature_table(found, size),
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
        }
    }

    /// Records the files written.
    pub(super) fn add_outputs(&mut self, paths: &[PathBuf]) {
        self.outputs.extend(paths.iter().map(|p| p.to_string_lossy().into_owned()));
    }

    /// Whether the result is less than what was asked for: with `--strict` the exit code is 3.
    pub fn is_degraded(&self) -> bool {
        self.warnings.iter().any(|w| w.degrades)
    }

    /// The tables as JSON, ended by a line feed.
    pub fn to_json(&self) -> String {
        // Strings, numbers and lists of them: nothing in it can fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// The tables in columns, for people.
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{}: {} frames of {} x {} pixels; reference {}\nBitmaps and keypoints on the level of {} x {} pixels.\n",
            self.software,
            self.frames.len(),
            self.width_px,
            self.height_px,
            file_name(&self.reference),
            self.level_width_px,
            self.level_height_px,
        );
        let mut add = |title: &str, note: &str, header: &[&str], row: &dyn Fn(&FrameTable) -> Vec<String>| {
            text += &format!("\n{title}\n{}", columns(header, self.frames.iter().map(row)));
            if !note.is_empty() {
                text += &format!("{note}\n");
            }
        };
        add(
            "Table 1. Exposures",
            "",
            &["photograph", "time", "f", "ISO", "EV to reference", "known from"],
            &exposure_row,
        );
        add(
            "Table 2. Keypoints: plain SIFT, SIFT on the MTB, both merged",
            "Merged counts a point that was found in both only once. gain: merged over plain.",
            &["photograph", "EV", "plain", "MTB", "merged", "gain"],
            &keypoint_row,
        );
        add(
            "Table 3. Matches with the reference, and of these inliers of RANSAC",
            "Matched by the ratio test and mutually, without a guide; alignment itself goes further.",
            &["photograph", "EV", "plain", "inliers", "MTB", "inliers", "merged", "inliers"],
            &match_row,
        );
        add(
            "Table 4. What each kind of keypoint by itself would have led to, held against the alignment",
            "px: root mean square distance over the picture between its motion and the alignment's.",
            &["photograph", "EV", "plain", "px", "MTB", "px", "merged", "px"],
            &verdict_row,
        );
        add(
            "Table 5. Alignment",
            "Shift of the picture's centre and rotation, reference to frame: right, down, right towards down.",
            &["photograph", "status", "model", "dx px", "dy px", "rotation deg", "error px", "confidence"],
            &place_row,
        );
        add(
            "Table 6. Median threshold bitmaps",
            "XOR: share of the pixels counting in both bitmaps, within the inscribed circle, that differ, unmoved and as aligned.",
            &["photograph", "percentile", "threshold", "excluded %", "XOR before %", "XOR after %"],
            &bitmap_row,
        );
        let reasons = self.frames.iter().filter_map(|f| f.report.alignment.reason.as_ref().map(|r| (f, r)));
        for (frame, reason) in reasons {
            text += &format!("\n{}: left out: {reason}\n", file_name(&frame.report.path));
        }
        text
    }
}

fn bitmap_table(found: &Found) -> BitmapTable {
    BitmapTable {
        percentile: found.bitmaps.percentile,
        threshold_level: found.bitmaps.threshold,
        excluded_share: found.bitmaps.excluded_share(),
        xor: found.xor.map(|xor| XorTable {
            before_share: xor.before,
            after_share: xor.after,
            by_angle_deg: (&xor.by_angle).into(),
            by_dx_px: (&xor.by_dx).into(),
            by_dy_px: (&xor.by_dy).into(),
        }),
    }
}

fn feature_table(found: &Found, size: (usize, usize)) -> FeatureTable {
    let counts = found.features.counts();
    let of = |kind: FeatureKind, keypoints| {
        let blank = KindTable { keypoints, matches: None, inliers: None, off_px: None, verdict: None };
        let Some(matchings) = found.matchings else { return blank };
        let matching = &matchings[kind as usize];
        let inliers = matching.inliers();
        let motion = matching.warp.filter(|_| inliers >= LEAST_INLIERS);
        let off_px = motion.zip(found.warp).map(|(own, place)| distance_px(&own, place, size));
        let diagonal = ((size.0 * size.0 + size.1 * size.1) as f64).sqrt();
        let verdict = match (motion, off_px) {
            (None, _) => KindVerdict::NoMotion,
            (Some(_), None) => KindVerdict::NoPlace,
            (Some(_), Some(off)) if off <= NEAR_PX * (diagonal / 1000.0).max(1.0) => KindVerdict::Agrees,
            (Some(_), Some(_)) => KindVerdict::Differs,
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

/// `rows` under `header`: the first column from the left, the others to the right, two spaces between.
fn columns(header: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut all: Vec<Vec<String>> = vec![header.iter().map(|h| (*h).to_owned()).collect()];
    all.extend(rows);
    let width = |c: usize| all.iter().map(|row| row[c].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let rule: Vec<String> = widths.iter().map(|w| "-".repeat(*w)).collect();
    all.insert(1, rule);
    let mut text = String::new();
    for row in &all {
        let cells = row.iter().zip(&widths).enumerate();
        let line: Vec<String> =
            cells.map(|(c, (cell, &w))| if c == 0 { format!("{cell:<w$}") } else { format!("{cell:>w$}") }).collect();
        text += line.join("  ").trim_end();
        text.push('\n');
    }
    text
}

const NOTHING: &str = "-";

fn or_nothing<T>(value: Option<T>, show: impl Fn(T) -> String) -> String {
    value.map_or_else(|| NOTHING.to_owned(), show)
}

/// The name of the photograph, without its folder.
fn file_name(path: &str) -> String {
    Path::new(path).file_name().map_or_else(|| path.to_owned(), |n| n.to_string_lossy().into_owned())
}

/// A shutter time as photographers write it.
pub(super) fn shutter(seconds: f64) -> String {
    if seconds < 0.3 { format!("1/{:.0} s", 1.0 / seconds) } else { format!("{} s", (seconds * 10.0).round() / 10.0) }
}

/// Stops with their sign.
pub(super) fn stops(ev: f64) -> String {
    // What rounds to nothing has no sign.
    if ev.abs() < 0.005 { "0.00".into() } else { format!("{ev:+.2}") }
}

fn exposure_row(frame: &FrameTable) -> Vec<String> {
    let report = &frame.report;
    let source = match report.exposure_source {
        ExposureSource::Exif => "EXIF",
        ExposureSource::Given => "-e",
        ExposureSource::Estimated => "the pixels",
    };
    vec![
        file_name(&report.path),
        or_nothing(report.time_s, shutter),
        or_nothing(report.f_number, |n| format!("{}", (n * 10.0).round() / 10.0)),
        or_nothing(report.iso, |s| format!("{s:.0}")),
        stops(frame.relative_ev),
        source.to_owned(),
    ]
}

fn keypoint_row(frame: &FrameTable) -> Vec<String> {
    let [plain, mtb, merged] = frame.features.kinds().map(|k| k.keypoints);
    let gain = if plain == 0 { NOTHING.to_owned() } else { format!("{:.1}", merged as f64 / plain as f64) };
    let counts = [plain, mtb, merged].map(|n| n.to_string());
    [file_name(&frame.report.path), stops(frame.relative_ev)].into_iter().chain(counts).chain([gain]).collect()
}

fn match_row(frame: &FrameTable) -> Vec<String> {
    let count = |n: Option<usize>| or_nothing(n, |n| n.to_string());
    let cells = frame.features.kinds().into_iter().flat_map(|k| [count(k.matches), count(k.inliers)]);
    [file_name(&frame.report.path), stops(frame.relative_ev)].into_iter().chain(cells).collect()
}

fn verdict_row(frame: &FrameTable) -> Vec<String> {
    let word = |v: KindVerdict| match v {
        KindVerdict::Agrees => "agrees".to_owned(),
        KindVerdict::Differs => "differs".to_owned(),
        KindVerdict::NoMotion => "no motion".to_owned(),
        KindVerdict::NoPlace => "no place".to_owned(),
    };
    let cells = |k: &KindTable| [or_nothing(k.verdict, word), or_nothing(k.off_px, |d| format!("{d:.2}"))];
    let kinds = frame.features.kinds().into_iter().flat_map(cells);
    [file_name(&frame.report.path), stops(frame.relative_ev)].into_iter().chain(kinds).collect()
}

/// What became of a frame, in words.
pub(super) fn status_word(status: Status) -> &'static str {
    match status {
        Status::Reference => "reference",
        Status::Aligned => "aligned",
        Status::Unmoved => "unmoved",
        Status::Rejected => "left out",
    }
}

fn place_row(frame: &FrameTable) -> Vec<String> {
    let place = &frame.report.alignment;
    let model = place.model.map(|m| match m {
        Model::Unmoved => "none",
        Model::Shift => "shift",
        Model::Rigid => "rigid",
        Model::Homography => "homography",
    });
    let shift = |axis: usize| or_nothing(place.shift_px, |s| format!("{:.2}", s[axis] + 0.0));
    vec![
        file_name(&frame.report.path),
        status_word(place.status).to_owned(),
        or_nothing(model, str::to_owned),
        shift(0),
        shift(1),
        or_nothing(place.rotation_deg, |a| format!("{a:.3}")),
        or_nothing(place.error_px, |e| format!("{e:.2}")),
        format!("{:.2}", place.confidence),
    ]
}

/// The percentile in words.
pub(super) fn percentile_word(percentile: Percentile) -> &'static str {
    match percentile {
        Percentile::Low => "17th",
        Percentile::Median => "median",
        Percentile::High => "83rd",
    }
}

fn bitmap_row(frame: &FrameTable) -> Vec<String> {
    let mtb = &frame.mtb;
    let percent = |share: f64| format!("{:.2}", 100.0 * share);
    vec![
        file_name(&frame.report.path),
        percentile_word(mtb.percentile).to_owned(),
        mtb.threshold_level.to_string(),
        percent(mtb.excluded_share),
        or_nothing(mtb.xor.as_ref(), |x| percent(x.before_share)),
        or_nothing(mtb.xor.as_ref(), |x| percent(x.after_share)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_whatever_is_in_them() {
        let rows = [vec!["Zwölf.jpg".to_owned(), "7".into()], vec!["a".into(), "123456".into()]];
        let text = columns(&["photograph", "n"], rows.into_iter());
        assert_eq!(text, "photograph       n\n----------  ------\nZwölf.jpg        7\na           123456\n");
    }

    #[test]
    fn times_and_stops_are_as_photographers_write_them() {
        assert_eq!([1.0 / 512.0, 0.25, 0.5, 2.0, 32.0].map(shutter), ["1/512 s", "1/4 s", "0.5 s", "2 s", "32 s"]);
        assert_eq!([-2.0, 0.0, -1e-12, 1.333].map(stops), ["-2.00", "0.00", "0.00", "+1.33"]);
    }
}
