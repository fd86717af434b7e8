//! The report of a run: the processing of every frame and the results, for programs.
//!
//! In: the results of the stages. Out: JSON in a public format, with the version [`SCHEMA`] and most units in the keys
//! or in a `unit` beside them. Cost: negligible.

pub mod options;
pub mod tonemapped;

use crate::align::{Alignment, Cause, KeypointCounts, Model, Rect, RejectedBy, Status};
use crate::bracket::colour::{Primaries, Space};
use crate::bracket::exposure::{ExposureSource, Reading};
use crate::bracket::{Bracket, Frame};
use crate::error::{Error, Result, Warning};
use crate::merge::MergeReport;
use crate::merge::deghost::GhostReport;
use crate::merge::local::LocalReport;
use crate::merge::radiance::calibration::CalibrationReport;
use crate::merge::radiance::flare::FlareReport;
use crate::response::ResponseReport;
use crate::tonemap::adjust::Light;
use options::OptionsReport;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The formats of a report, selected by the extension of its file.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// `.json`, for programs.
    Json,
    /// `.html`, for people.
    Html,
}

impl Format {
    /// Returns the format for the extension of `path`, which may be in upper or lower case.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`].
    pub fn of(path: &Path) -> Result<Format> {
        match path.extension().unwrap_or_default().to_string_lossy().to_lowercase().as_str() {
            "json" => Ok(Format::Json),
            "html" | "htm" => Ok(Format::Html),
            _ => Err(Error::UnknownExtension { path: path.to_owned(), known: ".json, .html, .htm" }),
        }
    }
}

/// The version of the format. In one version keys may be added, but are never removed.
pub const SCHEMA: &str = "hdralign-report/1";

/// The report of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// The program and its version.
    pub software: &'static str,
    /// Width of every frame, after EXIF orientation.
    pub width_px: usize,
    /// Height of every frame, after EXIF orientation.
    pub height_px: usize,
    /// Options of the run; `None` until the caller sets them.
    pub options: Option<OptionsReport>,
    /// The frame that the others are aligned to.
    pub reference: String,
    /// The frames in order of rising exposure.
    pub frames: Vec<FrameReport>,
    /// File that the transforms were read from, if any.
    pub transforms_from: Option<String>,
    /// The part of the reference frame that the results show.
    pub crop: Crop,
    /// The response that was used; null if the frames were only aligned.
    pub response: Option<ResponseReport>,
    /// Local tone mapping by the camera, and how it was compensated; null if it was not evaluated.
    pub local_processing: Option<LocalReport>,
    /// Statistics of the radiance map; null if the frames were only aligned.
    pub radiance: Option<MergeReport>,
    /// Calibration of radiance to cd/m2; null if radiance is relative.
    pub calibration: Option<CalibrationReport>,
    /// Primaries of the radiance map; null if the frames were only aligned.
    pub colour: Option<ColourReport>,
    /// The light that the picture shows as white; null if this is unchanged from the photographs, or if the frames
    /// were only aligned.
    pub white_balance: Option<Light>,
    /// Result of deghosting; null without deghosting.
    pub ghosts: Option<GhostReport>,
    /// Measured lens flare; null if it was not measured.
    pub flare: Option<FlareReport>,
    /// The files written.
    pub outputs: Vec<String>,
    /// The warnings.
    pub warnings: Vec<WarningReport>,
    /// Wall time of the stages, in seconds.
    pub time_s: Times,
}

/// A rectangle of the reference frame, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Crop {
    /// Column of its left edge.
    pub x_px: usize,
    /// Row of its upper edge.
    pub y_px: usize,
    /// Width of the rectangle.
    pub width_px: usize,
    /// Height of the rectangle.
    pub height_px: usize,
}

impl From<Rect> for Crop {
    fn from(rect: Rect) -> Self {
        Crop { x_px: rect.x0, y_px: rect.y0, width_px: rect.width(), height_px: rect.height() }
    }
}

/// The primaries of a picture.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ColourReport {
    /// The colour space by name; null for other primaries.
    pub space: Option<Space>,
    /// CIE 1931 xy of red, green, blue and white.
    pub primaries: Primaries,
}

impl From<Primaries> for ColourReport {
    fn from(primaries: Primaries) -> Self {
        ColourReport { space: Space::of(&primaries), primaries }
    }
}

/// The exposure and alignment of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameReport {
    /// The file, as the user named it.
    pub path: String,
    /// Shutter time in seconds.
    pub time_s: Option<f64>,
    /// The f-number.
    pub f_number: Option<f64>,
    /// ISO sensitivity.
    pub iso: Option<f64>,
    /// Relative exposure including the correction: t * ISO / N^2 in seconds, or 2^EV if EV was given. The merge
    /// divides the frame by this value.
    pub relative_exposure: f64,
    /// Correction of the recorded exposure in stops, determined from the pixels.
    pub exposure_correction_stops: f64,
    /// For an exposure that was estimated from the pixels: standard deviation, in stops, of the difference between
    /// this exposure and the nearest known exposure of the bracket. Null for other exposures.
    pub exposure_uncertainty_stops: Option<f64>,
    /// Whether t, ISO and N are used as recorded, or replaced by the exact steps from which the recorded numbers were
    /// rounded (1/32 s for 1/30 s).
    pub exposure_reading: Reading,
    /// The source of the exposure.
    pub exposure_source: ExposureSource,
    /// The EXIF tags that were used.
    pub exposure_tags: String,
    /// The alignment of the frame.
    pub alignment: AlignmentReport,
}

/// The alignment of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlignmentReport {
    /// Whether and how the frame was aligned.
    pub status: Status,
    /// What rejected the frame: the alignment, the user or the flash; null for a frame that is used.
    pub rejected_by: Option<RejectedBy>,
    /// The smallest model that explains the motion of the frame.
    pub model: Option<Model>,
    /// The 3 x 3 matrix that maps a reference pixel to a frame pixel, row by row; null if the frame was rejected.
    pub homography: Option<[f64; 9]>,
    /// Shift of the picture centre in px: to the right, and down.
    pub shift_px: Option<[f64; 2]>,
    /// Rotation in degrees, clockwise (from right towards down).
    pub rotation_deg: Option<f64>,
    /// Number of matches that agree with the motion; null if features were not needed.
    pub inliers: Option<usize>,
    /// Numbers of keypoints; null if features were not needed.
    pub keypoints: Option<KeypointCounts>,
    /// Estimated root mean square of the alignment error in the picture, in px. For an assumed transform: the error
    /// that is not exceeded with a probability of 95 %.
    pub error_px: Option<f64>,
    /// Confidence, 0..1; below 0.5 is low.
    pub confidence: f64,
    /// Fraction of the compared parts, 0..1, that the transform does not align, for example because of depth or
    /// movement; null if not measured.
    pub displaced_fraction: Option<f64>,
    /// Median displacement, in px, of the parts that the transform does not align.
    pub displaced_px: Option<f64>,
    /// What is followed because the homography does not suffice; null if nothing is. If it is not null, the homography
    /// is only a start.
    pub followed: Option<Cause>,
    /// Why the frame was rejected, excluded or not moved, or how its transform was inferred.
    pub reason: Option<String>,
}

/// A warning.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WarningReport {
    /// Text of the warning.
    pub message: String,
    /// Whether the result is degraded.
    pub degrades: bool,
}

impl From<&Warning> for WarningReport {
    fn from(warning: &Warning) -> Self {
        WarningReport { message: warning.to_string(), degrades: warning.degrades() }
    }
}

/// Wall time in seconds; null for a stage that did not run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Times {
    /// Reading and decoding.
    pub load: Option<f64>,
    /// Alignment.
    pub align: Option<f64>,
    /// Recovering the response.
    pub response: Option<f64>,
    /// Merging.
    pub merge: Option<f64>,
    /// Tone mapping.
    pub tonemap: Option<f64>,
    /// Writing.
    pub write: Option<f64>,
    /// The whole run.
    pub total: f64,
}

impl Report {
    /// Creates the report of a bracket and its alignment; the caller sets the other fields.
    pub fn new(bracket: &Bracket, alignment: &Alignment, crop: Rect) -> Self {
        let size = (bracket.width(), bracket.height());
        let frames = bracket.frames().iter().enumerate();
        let frames = frames.map(|(i, frame)| frame_report(frame, alignment, i, size));
        Report {
            schema: SCHEMA,
            software: concat!("hdralign ", env!("CARGO_PKG_VERSION")),
            width_px: size.0,
            height_px: size.1,
            options: None,
            reference: text(bracket.reference().path()),
            frames: frames.collect(),
            transforms_from: None,
            crop: crop.into(),
            response: None,
            local_processing: None,
            radiance: None,
            calibration: None,
            colour: None,
            white_balance: None,
            ghosts: None,
            flare: None,
            outputs: Vec::new(),
            warnings: Vec::new(),
            time_s: Times::default(),
        }
    }

    /// Records the files written.
    pub fn add_outputs(&mut self, paths: &[PathBuf]) {
        self.outputs.extend(paths.iter().map(|p| text(p)));
    }

    /// Returns the report as JSON with a final line feed.
    pub fn to_json(&self) -> String {
        // The report contains only strings, numbers and lists of them, so the conversion cannot fail. A number that is
        // not finite would become null.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Returns whether no merged frame moved.
    pub fn stood_still(&self) -> bool {
        self.frames.iter().filter_map(|frame| frame.alignment.model).all(|model| model == Model::Unmoved)
    }

    /// Returns whether the result is degraded, so that the exit code is 3 with `--strict`.
    pub fn is_degraded(&self) -> bool {
        self.warnings.iter().any(|w| w.degrades)
    }
}

/// Returns the report on frame `i`, which is `frame`.
fn frame_report(frame: &Frame, alignment: &Alignment, i: usize, (width, height): (usize, usize)) -> FrameReport {
    let (placement, features) = (&alignment.placements[i], &alignment.features[i]);
    let (exposure, transform) = (&frame.exposure, placement.transform());
    FrameReport {
        path: text(frame.path()),
        time_s: exposure.time_s,
        f_number: exposure.f_number,
        iso: exposure.iso,
        relative_exposure: exposure.relative(),
        exposure_correction_stops: exposure.correction_stops(),
        exposure_uncertainty_stops: exposure.uncertainty_stops,
        exposure_reading: exposure.reading,
        exposure_source: exposure.source,
        exposure_tags: exposure.tags.clone(),
        alignment: AlignmentReport {
            status: placement.status(),
            rejected_by: placement.status().rejected_by(),
            model: placement.model(),
            homography: transform.map(|w| {
                let h = w.matrix(width, height);
                std::array::from_fn(|i| h[(i / 3, i % 3)])
            }),
            shift_px: transform.map(|w| w.shift_px(width, height).into()),
            rotation_deg: transform.map(|w| w.rotation_deg(width, height)),
            inliers: features.inliers,
            keypoints: features.keypoints,
            error_px: placement.error_px(),
            confidence: placement.confidence(),
            displaced_fraction: placement.displaced().map(|d| d.fraction),
            displaced_px: placement.displaced().map(|d| d.px),
            followed: alignment.cause(i),
            reason: placement.reason().map(str::to_owned),
        },
    }
}

/// Returns a path as text; invalid UTF-8 becomes a replacement character.
fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::Placement;
    use crate::bracket::exposure::Exposure;
    use crate::bracket::{ReferenceChoice, Samples};

    #[test]
    fn format_is_selected_by_the_extension() {
        let of = |name: &str| Format::of(Path::new(name)).ok();
        assert_eq!(["r.json", "a/R.HTML", "r.htm"].map(of), [Format::Json, Format::Html, Format::Html].map(Some));
        assert_eq!(["r.txt", "r", ".html"].map(of), [None; 3]);
        assert!(Format::of(Path::new("r.txt")).unwrap_err().is_usage());
    }

    #[test]
    fn units_are_in_the_keys_and_a_rejected_frame_has_no_homography() {
        let frame = |name: &str, ev| {
            Frame::new(name.into(), 4, 2, Samples::Eight(vec![0; 24]), Exposure::given(ev).expect("a number"))
        };
        let bracket = Bracket::new(vec![frame("b", 1.0), frame("a", 0.0)], &ReferenceChoice::Number(1)).unwrap();
        let mut alignment = Alignment::unmoved(&bracket);
        alignment.placements[0] =
            Placement::Rejected { by: RejectedBy::Alignment, confidence: 0.25, reason: Some("why".to_owned()) };
        alignment.features[0].keypoints = Some(KeypointCounts { plain: 1, mtb: 2, merged: 3 });
        let whole = alignment.overlap;
        let json: serde_json::Value =
            serde_json::from_str(&Report::new(&bracket, &alignment, whole).to_json()).unwrap();
        assert_eq!(json["schema"], SCHEMA);
        assert_eq!(json["reference"], "b");
        assert_eq!(json["frames"][0]["path"], "a");
        assert_eq!(json["frames"][0]["alignment"]["status"], "rejected");
        assert!(json["frames"][0]["alignment"]["homography"].is_null());
        assert_eq!(json["frames"][0]["alignment"]["keypoints"]["merged"], 3);
        assert_eq!(json["frames"][1]["alignment"]["homography"][8], 1.0);
        assert_eq!(json["frames"][1]["relative_exposure"], 2.0);
        assert_eq!(json["crop"]["width_px"], 4);
    }
}
