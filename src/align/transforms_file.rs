//! The file of transforms: a saved alignment that can be used again.
//!
//! Converts the placements of a bracket ([`SavedAlignment`]) to JSON of the schema `hdralign-transforms/1`, and back.
//! No digit of a number is lost when it is written and read. Cost: negligible.
//!
//! ```json
//! { "schema": "hdralign-transforms/1", "width_px": 4000, "height_px": 3000, "reference": "IMG_2.jpg", "frames": [
//!   { "file": "IMG_1.jpg", "status": "aligned", "model": "shift", "homography": [1.0, 0.0, 3.25, ...],
//!     "error_px": 0.02, "confidence": 0.98, "inliers": null, "keypoints": null, "reason": null } ] }
//! ```
//!
//! `homography` holds the nine numbers of the matrix that maps a reference pixel to a frame pixel, row by row; (0, 0)
//! is the centre of the top-left pixel. If `status` is `rejected`, `homography` is null, and `rejected_by` is
//! `alignment`, `user` or `flash`. For other frames, `rejected_by` is null. Older files lack this key: in them, a
//! rejected frame with confidence 1 was excluded by the user. A frame whose `status` is `assumed` is merged as
//! [`Placement::Assumed`]. A transform without `confidence` has confidence 1, as if set by the user.

use crate::align::preset::{Preset, PresetTransform, check};
use crate::align::result::{Alignment, Estimate, FeatureCounts, Found, KeypointCounts, Placement, RejectedBy, Status};
use crate::align::transform::{Model, Transform};
use crate::bracket::{self, Bracket};
use crate::error::{Error, Result};
use crate::intake;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The schema of the format; files of other schemas are rejected.
pub const SCHEMA: &str = "hdralign-transforms/1";

/// The placements of a bracket, to be saved and used again.
#[derive(Debug, Clone, PartialEq)]
pub struct SavedAlignment {
    /// Width and height of every frame, in pixels.
    pub size: (usize, usize),
    /// The name of the reference's file.
    pub reference: PathBuf,
    /// The file name and the placement of every frame but the reference.
    pub frames: Vec<Preset>,
}

/// The content of the file of transforms.
#[derive(Serialize, Deserialize)]
struct Document {
    schema: String,
    width_px: usize,
    height_px: usize,
    reference: String,
    frames: Vec<FrameDocument>,
}

#[derive(Serialize, Deserialize)]
struct FrameDocument {
    file: String,
    status: Status,
    rejected_by: Option<RejectedBy>,
    model: Option<Model>,
    homography: Option<[f64; 9]>,
    error_px: Option<f64>,
    confidence: Option<f64>,
    inliers: Option<usize>,
    keypoints: Option<KeypointCounts>,
    reason: Option<String>,
}

/// The schema of the file, read before the rest.
#[derive(Deserialize)]
struct Header {
    schema: String,
}

impl SavedAlignment {
    /// Returns the placements in `alignment`, with the file names of the frames of `bracket`.
    pub fn of(bracket: &Bracket, alignment: &Alignment) -> Self {
        let name = |i: usize| bracket.frames()[i].path().file_name().unwrap_or_default().into();
        let known = |i: usize| PresetTransform::Known(Box::new(alignment.placements[i].clone()), alignment.features[i]);
        let others = (0..bracket.frames().len()).filter(|&i| i != bracket.reference_index());
        SavedAlignment {
            size: (bracket.width(), bracket.height()),
            reference: name(bracket.reference_index()),
            frames: others.map(|i| Preset { path: name(i), place: known(i) }).collect(),
        }
    }

    /// Returns the text of the file.
    pub fn to_json(&self) -> String {
        let text = |path: &Path| path.to_string_lossy().into_owned();
        let frame = |given: &Preset| {
            let (placement, features) = given.place.found();
            let matrix = placement.transform().map(|transform| transform.matrix(self.size.0, self.size.1));
            FrameDocument {
                file: text(&given.path),
                status: placement.status(),
                rejected_by: placement.status().rejected_by(),
                model: placement.model(),
                homography: matrix.map(|h| std::array::from_fn(|i| h[(i / 3, i % 3)])),
                error_px: placement.error_px(),
                confidence: Some(placement.confidence()),
                inliers: features.inliers,
                keypoints: features.keypoints,
                reason: placement.reason().map(str::to_owned),
            }
        };
        let document = Document {
            schema: SCHEMA.to_owned(),
            width_px: self.size.0,
            height_px: self.size.1,
            reference: text(&self.reference),
            frames: self.frames.iter().map(frame).collect(),
        };
        // Serialising strings and finite numbers cannot fail.
        serde_json::to_string_pretty(&document).unwrap_or_default() + "\n"
    }

    /// Reads the file `path`.
    ///
    /// # Errors
    /// [`Error::Read`] if the file cannot be read, [`Error::Changed`] if it changes while it is read; otherwise the
    /// errors of [`from_json`](Self::from_json).
    pub fn read(path: &Path) -> Result<Self> {
        Self::from_json(&intake::text(path, intake::MOST_OF_A_TEXT)?, path)
    }

    /// Parses `text`, the content of the file `path`.
    ///
    /// # Errors
    /// [`Error::TransformsFile`] if the text is not JSON, if it has another schema, if a confidence is not within
    /// 0..=1, or if a homography is invalid. A homography must be nine finite numbers; it must neither move a corner
    /// behind the camera nor mirror the picture.
    pub fn from_json(text: &str, path: &Path) -> Result<Self> {
        let wrong = |reason: String| Error::TransformsFile { path: path.to_owned(), reason };
        let header: Header = serde_json::from_str(text)
            .map_err(|e| wrong(format!("it is not a JSON object with a text under the key \"schema\" ({e})")))?;
        if header.schema != SCHEMA {
            return Err(wrong(format!(
                "it is a file of another kind or version: its schema is {:?}, but {SCHEMA:?} is required",
                header.schema
            )));
        }
        let document: Document = serde_json::from_str(text).map_err(|e| wrong(e.to_string()))?;
        let size = (document.width_px, document.height_px);
        let frames = document.frames.into_iter().map(|frame| {
            let file = frame.file.clone();
            let (placement, features) = found(frame, size).map_err(|reason| wrong(format!("{file}: {reason}")))?;
            Ok(Preset { path: file.into(), place: PresetTransform::Known(Box::new(placement), features) })
        });
        Ok(SavedAlignment { size, reference: document.reference.into(), frames: frames.collect::<Result<_>>()? })
    }

    /// Checks whether this alignment, read from the file `path`, is for the photographs `images`.
    ///
    /// # Errors
    /// [`Error::TransformsFile`] if the reference is not among `images`.
    pub fn check_names(&self, images: &[PathBuf], path: &Path) -> Result<()> {
        let images: Vec<&Path> = images.iter().map(PathBuf::as_path).collect();
        if bracket::named(&images, &self.reference).is_some() {
            return Ok(());
        }
        let reason = format!(
            "it is for other photographs, because its reference {} is not among those of this run; to write new transforms, give the name of a new file",
            self.reference.display()
        );
        Err(Error::TransformsFile { path: path.to_owned(), reason })
    }

    /// Checks whether this alignment, read from the file `path`, is for `bracket`.
    ///
    /// # Errors
    /// [`Error::TransformsFile`] if the size or the reference differs from that of `bracket`, or if the file has none
    /// of the frames of `bracket`.
    pub fn check(&self, bracket: &Bracket, path: &Path) -> Result<()> {
        let wrong = |reason: String| Err(Error::TransformsFile { path: path.to_owned(), reason });
        let (width, height) = (bracket.width(), bracket.height());
        if self.size != (width, height) {
            let (w, h) = self.size;
            return wrong(format!(
                "it is for photographs of {w}x{h} pixels, but these have {width}x{height}; to write the transforms of these, give the name of a new file"
            ));
        }
        if bracket.named(&self.reference) != Some(bracket.reference_index()) {
            return wrong(format!(
                "its reference is {}, but this bracket has the reference {}; give --reference {}, or delete the file",
                self.reference.display(),
                bracket.reference().path().display(),
                self.reference.display()
            ));
        }
        if !self.frames.iter().any(|given| bracket.named(&given.path).is_some()) {
            return wrong(
                "it contains none of these photographs; to write the transforms of these, give the name of a new file"
                    .into(),
            );
        }
        Ok(())
    }
}

/// Returns the placement and the feature counts that `frame` describes, or what is wrong with `frame`.
fn found(frame: FrameDocument, size: (usize, usize)) -> std::result::Result<Found, String> {
    let features = FeatureCounts { inliers: frame.inliers, keypoints: frame.keypoints };
    let placement = if frame.status.rejected_by().is_some() {
        let by = match frame.rejected_by {
            None if frame.confidence == Some(1.0) => RejectedBy::User,
            None => RejectedBy::Alignment,
            Some(by) => by,
        };
        let by_default = if by == RejectedBy::Alignment { 0.0 } else { 1.0 };
        Placement::Rejected { by, confidence: frame.confidence.unwrap_or(by_default), reason: frame.reason }
    } else {
        let homography = frame.homography.ok_or(
            "its status means that it is merged, but it has no homography; add its nine numbers, or set its status to \
             rejected",
        )?;
        let h = Matrix3::from_row_slice(&homography);
        let transform = match frame.status {
            Status::Unmoved | Status::Assumed if h == Matrix3::identity() => Transform::Identity,
            _ => Transform::Homography(if h[(2, 2)] == 1.0 { h } else { h / h[(2, 2)] }),
        };
        let estimate = Estimate {
            transform,
            model: frame.model.filter(|model| *model != Model::Unmoved).unwrap_or(Model::of(&transform)),
            error_px: frame.error_px,
            confidence: frame.confidence.unwrap_or(1.0),
            displaced: None,
            reason: frame.reason,
        };
        match frame.status {
            Status::Assumed => Placement::Assumed(estimate),
            _ => Placement::Placed(estimate),
        }
    };
    check(&placement, size)?;
    Ok((placement, features))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn saved() -> SavedAlignment {
        let estimate = |transform: Transform| {
            let model = Model::of(&transform);
            Estimate { transform, model, error_px: None, confidence: 0.75, displaced: None, reason: None }
        };
        let rejected = |by| Placement::Rejected { by, confidence: 0.75, reason: None };
        let h = Matrix3::new(1.0 + 1e-9, 0.1 / 3.0, -7.25, -0.03, 0.999, 1.0 / 7.0, 1e-7, -2e-8, 1.0);
        let keypoints = Some(KeypointCounts { plain: 3, mtb: 2, merged: 4 });
        let features = FeatureCounts { inliers: Some(1), keypoints };
        let given = |name: &str, placement| Preset {
            path: name.into(),
            place: PresetTransform::Known(Box::new(placement), features),
        };
        SavedAlignment {
            size: (400, 300),
            reference: "b.jpg".into(),
            frames: vec![
                given("a.jpg", Placement::Placed(estimate(Transform::Homography(h)))),
                given("c.jpg", Placement::Placed(estimate(Transform::Identity))),
                given("d.jpg", rejected(RejectedBy::Alignment)),
                given("e.jpg", rejected(RejectedBy::User)),
                given("f.jpg", Placement::Assumed(estimate(Transform::Identity))),
                given("g.jpg", Placement::Assumed(estimate(Transform::Homography(h)))),
            ],
        }
    }

    #[test]
    fn every_number_comes_back() {
        let saved = saved();
        assert_eq!(SavedAlignment::from_json(&saved.to_json(), Path::new("t.json")).unwrap(), saved);
    }

    #[test]
    fn nonsense_is_refused_with_the_file_and_the_frame() {
        let json = saved().to_json();
        let refused = |text: &str| SavedAlignment::from_json(text, Path::new("t.json")).unwrap_err().to_string();
        for (text, says) in [
            ("no json".to_owned(), "not a JSON object"),
            (json.replace("transforms/1", "transforms/9"), "schema"),
            (json.replace("-7.25", "1e999"), "t.json"),
            (json.replace("0.999", "-0.999"), "a.jpg: its homography"),
            // With this number, the matrix maps a line across the picture, 100 pixels from the left, to infinity.
            (json.replace("1e-7", "-0.01"), "a.jpg: its homography"),
            (json.replace("\"confidence\": 0.75", "\"confidence\": 1.5"), "a.jpg: its confidence"),
            (
                json.replace("\"status\": \"rejected\"", "\"status\": \"unmoved\""),
                "d.jpg: its status means that it is merged, but it has no homography",
            ),
            (json.replace("\"width_px\": 400,", ""), "width_px"),
        ] {
            let message = refused(&text);
            assert!(message.contains("t.json") && message.contains(says), "{message}");
        }
    }

    #[test]
    fn rejection_in_a_file_may_be_by_the_user() {
        let status = |frame: serde_json::Value| {
            let text = serde_json::json!({
                "schema": SCHEMA, "width_px": 4, "height_px": 3, "reference": "b.jpg", "frames": [frame],
            });
            let saved = SavedAlignment::from_json(&text.to_string(), Path::new("t.json")).unwrap();
            saved.frames[0].place.found().0.status()
        };
        let base = serde_json::json!({ "file": "a.jpg", "status": "rejected", "homography": null });
        let with = |key: &str, value: serde_json::Value| {
            let mut frame = base.clone();
            frame[key] = value;
            frame
        };
        assert_eq!(status(base.clone()), Status::Rejected);
        assert_eq!(status(with("rejected_by", "user".into())), Status::Excluded);
        assert_eq!(status(with("rejected_by", "alignment".into())), Status::Rejected);
        // Older versions wrote files without the key `rejected_by`; there, the confidence says who rejected the frame.
        assert_eq!(status(with("confidence", 1.0.into())), Status::Excluded);
        assert_eq!(status(with("confidence", 0.2.into())), Status::Rejected);
    }
}
