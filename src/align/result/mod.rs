//! The result of the alignment: for each frame its status, its transform and how certain it is; the area that all
//! frames cover.
//!
//! In: transforms. Out: [`Verdict`] and [`Alignment`]; the common [`Rect`] and the warnings that follow from them.
//! Cost: negligible.

mod overlap;
pub(crate) mod warnings;

pub use overlap::Rect;

use crate::align::transform::{Model, Transform};
use crate::bracket::{Bracket, Frame};

/// The status of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// The frame that the others are aligned to.
    Reference,
    /// Moved, and aligned by a transform.
    Aligned,
    /// Found not to have moved: its transform is exactly the identity.
    Unmoved,
    /// Too dark or too bright to be aligned: its transform is inferred from the other frames; it is merged only where
    /// all of them clip, or are black. Its error is a bound that 19 of 20 such transforms keep.
    Assumed,
    /// Could not be aligned; it is not merged.
    Rejected,
    /// Excluded by the user, and takes no part either. Files of the versions 1 have both by one name, and who did it by
    /// another key ([`RejectedBy`]).
    #[serde(rename = "rejected", skip_deserializing)]
    Excluded,
    /// Excluded because the flash fired in it, unlike in the others; by the same name in files.
    #[serde(rename = "rejected", skip_deserializing)]
    Flash,
}

/// Who took a frame out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RejectedBy {
    /// The alignment, which could not place it.
    Alignment,
    /// The user.
    User,
    /// The flash, which fired in this frame alone.
    Flash,
}

impl Status {
    /// Who took the frame out; none where it takes part.
    pub fn rejected_by(self) -> Option<RejectedBy> {
        match self {
            Status::Reference | Status::Aligned | Status::Unmoved | Status::Assumed => None,
            Status::Rejected => Some(RejectedBy::Alignment),
            Status::Excluded => Some(RejectedBy::User),
            Status::Flash => Some(RejectedBy::Flash),
        }
    }
}

/// Keypoints found in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub struct KeypointCounts {
    /// In the plain picture.
    pub plain: usize,
    /// In its median threshold bitmap.
    pub mtb: usize,
    /// In both together, points found twice counted once.
    pub merged: usize,
}

/// The alignment of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// What became of the frame.
    pub status: Status,
    /// The smallest model that explains its motion; none where it takes no part.
    pub model: Option<Model>,
    /// Its transform, reference pixel -> frame pixel; none where it takes no part.
    pub transform: Option<Transform>,
    /// Matches that RANSAC agreed on; none where features were not needed.
    pub inliers: Option<usize>,
    /// Keypoints in this frame; none where features were not needed.
    pub keypoints: Option<KeypointCounts>,
    /// Estimate of the root mean square error of the transform over the picture, in pixels; none where it is unknown.
    /// Of a place that is [assumed](Status::Assumed) the error that 19 of 20 such places keep.
    pub error_px: Option<f64>,
    /// Confidence, 0..1: under 0.5 is uncertain; 1 where the user has set it.
    pub confidence: f64,
    /// Why it was rejected, or is taken to be unmoved without evidence, or what its transform is inferred from.
    pub reason: Option<String>,
}

impl Verdict {
    /// The identity, for the reference or for a frame that the user has set to unmoved.
    pub(crate) fn with_identity(status: Status) -> Self {
        Verdict {
            status,
            model: Some(Model::Unmoved),
            transform: Some(Transform::Identity),
            inliers: None,
            keypoints: None,
            error_px: (status == Status::Reference).then_some(0.0),
            confidence: 1.0,
            reason: None,
        }
    }
}

/// The place of every frame of a bracket.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// One verdict per frame, in the order of [`Bracket::frames`].
    pub verdicts: Vec<Verdict>,
    /// The largest rectangle of the reference that all placed frames cover.
    pub overlap: Rect,
}

impl Alignment {
    /// Every frame of `bracket` unmoved, without looking at it: for a rigid tripod.
    pub fn unmoved(bracket: &Bracket) -> Self {
        Alignment {
            verdicts: unmoved_but(bracket, &vec![None; bracket.frames().len()]),
            overlap: Rect { x0: 0, y0: 0, x1: bracket.width(), y1: bracket.height() },
        }
    }

    /// The frames of `bracket` that take part in what follows: the index of each, the frame, and its transform.
    pub fn placed<'a>(&'a self, bracket: &'a Bracket) -> impl Iterator<Item = (usize, &'a Frame, Transform)> {
        let all = bracket.frames().iter().zip(&self.verdicts).enumerate();
        all.filter_map(|(i, (frame, verdict))| Some((i, frame, verdict.transform?)))
    }
}

/// Every frame of `bracket` unmoved, except those whose verdict is `given`.
pub(crate) fn unmoved_but(bracket: &Bracket, given: &[Option<Verdict>]) -> Vec<Verdict> {
    let status = |i| if i == bracket.reference_index() { Status::Reference } else { Status::Unmoved };
    let verdict =
        |(i, given): (usize, &Option<Verdict>)| given.clone().unwrap_or_else(|| Verdict::with_identity(status(i)));
    given.iter().enumerate().map(verdict).collect()
}
