//! The placement of one frame: its transform, or why it is not merged.
//!
//! In: a transform that a method found, that the user set, or that was read from a file. Out: [`Placement`], and its
//! [`Status`] in reports and files. Cost: none.

use crate::align::transform::{Model, Transform};

/// The transform of a frame to the reference, or why it is not merged.
#[derive(Debug, Clone, PartialEq)]
pub enum Placement {
    /// The frame that the others are aligned to.
    Reference,
    /// Aligned by a transform; the identity if the frame did not move.
    Placed(Estimate),
    /// The frame is too dark or too bright to be aligned; its transform is inferred from the other frames. In the
    /// radiance, the frame fills only what is clipped or black in the other frames. [`Estimate::error_px`] is a bound
    /// that holds for 19 of 20 such transforms.
    Assumed(Estimate),
    /// The frame is not merged.
    Rejected {
        /// Who or what rejected the frame.
        by: RejectedBy,
        /// Confidence of the best transform that was found, 0..=1; 1 if the frame was excluded by the user or because
        /// of the flash.
        confidence: f64,
        /// The reason, in words.
        reason: Option<String>,
    },
}

/// A transform, with its error estimate and confidence.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Reference pixel -> frame pixel.
    pub transform: Transform,
    /// The smallest model that explains the motion. A transform that is read from a file is stored as a
    /// [`Transform::Homography`] (unless it is the identity), even if its model is smaller.
    pub model: Model,
    /// Estimate of the root mean square error of the transform over the picture, in pixels; none if it is unknown.
    pub error_px: Option<f64>,
    /// Confidence, 0..=1: below 0.5, the transform is uncertain; 1 if the user set the transform.
    pub confidence: f64,
    /// The parts of the picture that the transform does not fit; none if they were not measured.
    pub displaced: Option<Displaced>,
    /// Why the frame is assumed to be unmoved, or what its transform is inferred from.
    pub reason: Option<String>,
}

/// The parts of the picture that a transform does not map to the right position. They are near objects, if the camera
/// moved sideways, or things that moved.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Displaced {
    /// The share of the displaced parts, 0..=1, among the parts that could be matched; 0 if these are too few. Parts
    /// without detail and clipped parts cannot be matched.
    pub fraction: f64,
    /// Median displacement of the displaced parts, in pixels; 0 if there are none. Parts that stayed at the same pixels
    /// although the camera moved are not in the median.
    pub px: f64,
}

/// Who or what rejected a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RejectedBy {
    /// The alignment, which found no transform.
    Alignment,
    /// The user.
    User,
    /// The flash, which fired in this frame, but not in all frames.
    Flash,
}

/// The kind of a [`Placement`] in reports and files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// [`Placement::Reference`].
    Reference,
    /// [`Placement::Placed`] by a transform that is not the identity.
    Aligned,
    /// [`Placement::Placed`] by the identity.
    Unmoved,
    /// [`Placement::Assumed`].
    Assumed,
    /// Rejected by the alignment.
    Rejected,
    /// Excluded by the user. In files, it has the same name as [`Status::Rejected`]; the key `rejected_by` tells them
    /// apart ([`RejectedBy`]).
    #[serde(rename = "rejected", skip_deserializing)]
    Excluded,
    /// Excluded because the flash fired in this frame, but not in all frames. In files, it has the same name as
    /// [`Status::Rejected`].
    #[serde(rename = "rejected", skip_deserializing)]
    Flash,
}

impl Status {
    /// Who or what rejected the frame; none if the frame is merged.
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
    /// A placement by a `transform` that the user set: with confidence 1 and an unknown error.
    pub fn by_user(transform: Transform) -> Self {
        let model = Model::of(&transform);
        Placement::Placed(Estimate { transform, model, error_px: None, confidence: 1.0, displaced: None, reason: None })
    }

    /// A placement of a frame excluded by the user, or because of the flash.
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

    /// See [`Estimate::error_px`]; 0 for the reference, none for a rejected frame.
    pub fn error_px(&self) -> Option<f64> {
        match self {
            Placement::Reference => Some(0.0),
            Placement::Placed(estimate) | Placement::Assumed(estimate) => estimate.error_px,
            Placement::Rejected { .. } => None,
        }
    }

    /// See [`Estimate::displaced`]; none for the reference and for rejected frames.
    pub fn displaced(&self) -> Option<Displaced> {
        match self {
            Placement::Placed(estimate) | Placement::Assumed(estimate) => estimate.displaced,
            Placement::Reference | Placement::Rejected { .. } => None,
        }
    }

    /// Confidence, 0..=1: below 0.5, the transform is uncertain; 1 for the reference.
    pub fn confidence(&self) -> f64 {
        match self {
            Placement::Reference => 1.0,
            Placement::Placed(Estimate { confidence, .. })
            | Placement::Assumed(Estimate { confidence, .. })
            | Placement::Rejected { confidence, .. } => *confidence,
        }
    }

    /// Why the frame is rejected or assumed to be unmoved, or what its transform is inferred from.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Placement::Reference => None,
            Placement::Placed(Estimate { reason, .. })
            | Placement::Assumed(Estimate { reason, .. })
            | Placement::Rejected { reason, .. } => reason.as_deref(),
        }
    }

    /// The kind of the placement in reports and files.
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
