//! The result of the alignment: for each frame its status, its transform and how certain it is; the area that all frames cover.
//!
//! In: transforms. Out: [`Verdict`] and [`Alignment`]; the common [`Rect`] and the warnings that follow from them. Cost: negligible.

mod overlap;
pub(crate) mod warnings;

pub use overlap::Rect;

use crate::align::transform::{Model, Transform};
use crate::bracket::{Bracket, Frame};

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// The frame that the others are aligned to.
    Reference,
    /// Moved, and placed by a transform.
    Aligned,
    /// Found not to have moved: its transform is exactly the identity.
    Unmoved,
    /// Too dark or too bright to be aligned, and taken to lie where the other frames let expect; it is merged only where all of them clip, or are
    /// black. Its error is one that 19 of 20 such places keep.
    Assumed,
    /// Could not be placed; it takes no part in what follows.
    Rejected,
    /// Excluded by the user, and takes no part either. Files of the versions 1 have both by one name, and who did it by another key
    /// ([`RejectedBy`]).
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

/// What is known of one frame's place.
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
    /// Our own estimate of the root mean square error of the transform over the picture, in pixels; none where nothing can be said. Of a place that is
    /// [assumed](Status::Assumed) the error that 19 of 20 such places keep.
    pub error_px: Option<f64>,
    /// How sure it is, 0..1: under 0.5 is doubtful; 1 where the user said so.
    pub confidence: f64,
    /// Why it was rejected, or taken as it lies although nothing shows that it lies so, or what its place is assumed from.
    pub reason: Option<String>,
}

impl Verdict {
    /// A frame that lies as the reference does, because it is the reference or because the user says so.
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
    /// Every frame of `bracket` as it lies, unseen: for a tripod that can be trusted.
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

/// Every frame of `bracket` as it lies, but for those whose verdict is `given`.
pub(crate) fn unmoved_but(bracket: &Bracket, given: &[Option<Verdict>]) -> Vec<Verdict> {
    let status = |i| if i == bracket.reference_index() { Status::Reference } else { Status::Unmoved };
    let verdict =
        |(i, given): (usize, &Option<Verdict>)| given.clone().unwrap_or_else(|| Verdict::with_identity(status(i)));
    given.iter().enumerate().map(verdict).collect()
}
