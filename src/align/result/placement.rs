//! The placement of one frame: where it lies over the reference, or why it is not merged.
//!
//! In: what a method found, the user set, or a file of transforms holds. Out: [`Placement`]; its [`Status`] as reports
//! and files name it. Cost: none.

use crate::align::transform::{Model, Transform};

/// Where a frame lies over the reference, or why it is not merged.
#[derive(Debug, Clone, PartialEq)]
pub enum Placement {
    /// The frame that the others are aligned to.
    Reference,
    /// Aligned by a transform; the identity where the frame was found not to have moved.
    Placed(Estimate),
    /// Too dark or too bright to be aligned: its transform is inferred from the other frames. It is merged only where
    /// all of them clip, or are black. [`Estimate::error_px`] is a bound that 19 of 20 such transforms keep.
    Assumed(Estimate),
    /// Not merged.
    Rejected {
        /// Who or what rejected it.
        by: RejectedBy,
        /// Confidence of the best transform that was found, 0..1; 1 where the user excluded the frame.
        confidence: f64,
        /// The reason, in words.
        reason: Option<String>,
    },
}

/// A transform, and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Reference pixel -> frame pixel.
    pub transform: Transform,
    /// The smallest model that explains the motion. A transform that was read from a file is a homography whatever its
    /// model.
    pub model: Model,
    /// Estimate of the root mean square error of the transform over the picture, in pixels; none where it is unknown.
    pub error_px: Option<f64>,
    /// Confidence, 0..1: under 0.5 is uncertain; 1 where the user has set the transform.
    pub confidence: f64,
    /// Why the frame is taken to be unmoved without evidence, or what its transform is inferred from.
    pub reason: Option<String>,
}

/// Who or what rejected a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RejectedBy {
    /// The alignment, which found no transform.
    Alignment,
    /// The user.
    User,
    /// The flash, which fired in this frame alone.
    Flash,
}

/// A [`Placement`] as reports and files name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// [`Placement::Reference`].
    Reference,
    /// [`Placement::Placed`], moved.
    Aligned,
    /// [`Placement::Placed`] by the identity.
    Unmoved,
    /// [`Placement::Assumed`].
    Assumed,
    /// Rejected by the alignment.
    Rejected,
    /// Excluded by the user. Files of the versions 1 have all rejected frames by one name, and who did it by another
    /// key ([`RejectedBy`]).
    #[serde(rename = "rejected", skip_deserializing)]
    Excluded,
    /// Excluded because the flash fired in it, unlike in the others; by the same name in files.
    #[serde(rename = "rejected", skip_deserializing)]
    Flash,
}

impl Status {
    /// Who rejected the frame; none where it is merged.
    pub fn rejected_by(self) -> Option<RejectedBy> {
        match self {
            Status::Reference | Status::Aligned | Status::Unmoved | Status::Assumed => None,
            Status::Rejected => Some(RejectedBy::Alignment),
            Status::Excluded => Some(RejectedBy::User),
            Status::Flash => Some(RejectedBy::Flash),
        }
    }
}

impl Placement {
    /// Placed by `transform`, as a user sets it: with confidence 1 and an unknown error.
    pub fn by_user(transform: Transform) -> Self {
        let model = Model::of(&transform);
        Placement::Placed(Estimate { transform, model, error_px: None, confidence: 1.0, reason: None })
    }

    /// Excluded by the user, or because of the flash.
    pub(crate) fn excluded(by: RejectedBy, reason: String) -> Self {
        Placement::Rejected { by, confidence: 1.0, reason: Some(reason) }
    }

    /// Reference pixel -> frame pixel; none for a rejected frame.
    pub fn transform(&self) -> Option<Transform> {
        match self {
            Placement::Reference => Some(Transform::Identity),
            Placement::Placed(estimate) | Placement::Assumed(estimate) => Some(estimate.transform),
            Placement::Rejected { .. } => None,
        }
    }

    /// The smallest model that explains the motion; none for a rejected frame.
    pub fn model(&self) -> Option<Model> {
        match self {
            Placement::Reference => Some(Model::Unmoved),
            Placement::Placed(estimate) | Placement::Assumed(estimate) => Some(estimate.model),
            Placement::Rejected { .. } => None,
        }
    }

    /// See [`Estimate::error_px`]; 0 for the reference.
    pub fn error_px(&self) -> Option<f64> {
        match self {
            Placement::Reference => Some(0.0),
            Placement::Placed(estimate) | Placement::Assumed(estimate) => estimate.error_px,
            Placement::Rejected { .. } => None,
        }
    }

    /// Confidence, 0..1: under 0.5 is uncertain; 1 for the reference.
    pub fn confidence(&self) -> f64 {
        match self {
            Placement::Reference => 1.0,
            Placement::Placed(Estimate { confidence, .. })
            | Placement::Assumed(Estimate { confidence, .. })
            | Placement::Rejected { confidence, .. } => *confidence,
        }
    }

    /// Why the frame is rejected, taken to be unmoved, or where its transform is from.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Placement::Reference => None,
            Placement::Placed(Estimate { reason, .. })
            | Placement::Assumed(Estimate { reason, .. })
            | Placement::Rejected { reason, .. } => reason.as_deref(),
        }
    }

    /// As reports and files name it.
    pub fn status(&self) -> Status {
        match self {
            Placement::Reference => Status::Reference,
            Placement::Placed(Estimate { transform: Transform::Identity, .. }) => Status::Unmoved,
            Placement::Placed(_) => Status::Aligned,
            Placement::Assumed(_) => Status::Assumed,
            Placement::Rejected { by: RejectedBy::Alignment, .. } => Status::Rejected,
            Placement::Rejected { by: RejectedBy::User, .. } => Status::Excluded,
            Placement::Rejected { by: RejectedBy::Flash, .. } => Status::Flash,
        }
    }
}
