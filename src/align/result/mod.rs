//! The result of the alignment: the placement of each frame, the features found for it, and the area that all frames
//! cover.
//!
//! In: transforms. Out: [`Placement`] and [`Alignment`], the common [`Rect`], and warnings.
//! Cost: negligible.

mod overlap;
mod placement;
pub(crate) mod warnings;

pub use overlap::Rect;
pub use placement::{Displaced, Estimate, Placement, RejectedBy, Status};

use crate::align::motion::{Cause, Followed, Motion};
use crate::align::transform::Transform;
use crate::bracket::{Bracket, Frame};

/// Numbers of keypoints found in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub struct KeypointCounts {
    /// Number of keypoints in the grey picture.
    pub plain: usize,
    /// Number of keypoints in the median threshold bitmaps of the picture.
    pub mtb: usize,
    /// Number of keypoints in the grey picture or the bitmaps; a keypoint found in both is counted once.
    pub merged: usize,
}

/// Numbers of keypoints and inliers of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FeatureCounts {
    /// Number of inliers of the robust estimator; none or 0 if it was not used or found no homography.
    pub inliers: Option<usize>,
    /// Numbers of keypoints in this frame; none if features were not needed.
    pub keypoints: Option<KeypointCounts>,
}

/// The placement of every frame of a bracket.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// One placement per frame, in the order of [`Bracket::frames`].
    pub placements: Vec<Placement>,
    /// Numbers of keypoints and inliers of each frame, in the same order. They are for information only.
    pub features: Vec<FeatureCounts>,
    /// The largest rectangle of the reference that all placed frames cover.
    pub overlap: Rect,
    /// What one homography for each frame does not describe; none if nothing is left, or if it was not measured.
    pub followed: Option<Followed>,
}

impl Alignment {
    /// An alignment with every frame of `bracket` unmoved, for a rigid tripod. The pixels are not examined.
    pub fn unmoved(bracket: &Bracket) -> Self {
        let (placements, features) = unmoved_but(bracket, &vec![None; bracket.frames().len()]);
        let overlap = Rect { x0: 0, y0: 0, x1: bracket.width(), y1: bracket.height() };
        Alignment { placements, features, overlap, followed: None }
    }

    /// The frames of `bracket` that are merged: the index of each, the frame, and its motion.
    pub fn placed<'a>(&self, bracket: &'a Bracket) -> impl Iterator<Item = (usize, &'a Frame, Motion)> {
        bracket.frames().iter().enumerate().filter_map(|(i, frame)| Some((i, frame, self.motion(bracket, i)?)))
    }

    /// Why the transform of frame `i` does not suffice; none if it does, or if nothing better is known.
    pub fn cause(&self, i: usize) -> Option<Cause> {
        self.followed.as_ref()?.cause(i)
    }

    /// The motion of frame `i` of `bracket`; none for a rejected frame.
    pub fn motion(&self, bracket: &Bracket, i: usize) -> Option<Motion> {
        let motion = Motion::new(&self.placements[i].transform()?, (bracket.width(), bracket.height()));
        Some(motion.following(self.followed.as_ref(), i))
    }
}

/// A frame's placement, and its numbers of keypoints and inliers.
pub(crate) type Found = (Placement, FeatureCounts);

/// Every frame of `bracket` unmoved, except those whose placement is `given`.
pub(crate) fn unmoved_but(bracket: &Bracket, given: &[Option<Found>]) -> (Vec<Placement>, Vec<FeatureCounts>) {
    let unmoved = |i| {
        if i == bracket.reference_index() { Placement::Reference } else { Placement::by_user(Transform::Identity) }
    };
    let all = given.iter().enumerate();
    all.map(|(i, given)| given.clone().unwrap_or_else(|| (unmoved(i), FeatureCounts::default()))).unzip()
}
