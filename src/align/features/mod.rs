//! Features: keypoints of the grey picture and of its threshold bitmaps, and the homography on which their matches
//! agree.
//!
//! In: grey pyramids. Out: `FeatureSets`, and for two of them a [`Consensus`]. Cost: a run of [`sift`] over the level
//! on which features are detected, one over a quarter of its samples for each bitmap; for a pair of frames three tables
//! of matches, two of them guided, and [`ransac`] or [`lmeds`]. Source: the thesis, section 4.3 (the median threshold
//! bitmap has many keypoints where the grey picture is dark or bright and has few; both together are always enough).
//!
//! One bitmap has edges at one grey value, and in a dark frame that may lie within the noise. There are seven bitmaps,
//! at fixed percentiles, Ward's three among them: whatever the exposures, some of them have structure in both frames.
//! Each is matched only with its counterpart.

mod consensus;
mod duplicates;
mod estimation;
mod extraction;
pub mod homography;
mod keypoint;
pub mod lmeds;
mod matching;
pub mod ransac;
pub mod sift;

pub use consensus::{Consensus, RansacOptions, distance_squared};
pub(crate) use estimation::{agreed, by_matches, pairs};
pub(crate) use extraction::{FeatureSets, features, found_among};
pub use homography::PointPair;
pub use keypoint::{Descriptor, Features, Keypoint};
pub use matching::{Guide, Match, match_mutual};
pub use sift::SiftOptions;

/// Robust estimator for feature matches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum RobustMethod {
    /// The transform with the most inliers; up to four fifths of the matches may be wrong.
    #[default]
    Ransac,
    /// The transform with the least median of squares, without a threshold; fewer than half of the matches may be wrong.
    Lmeds,
}

#[cfg(test)]
mod tests;
