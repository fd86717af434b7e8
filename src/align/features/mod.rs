//! Features: keypoints of the grey image and of its threshold bitmaps, and the homography of their matches.
//!
//! In: grey pyramids. Out: `FeatureSets`, and for two of them a [`Consensus`]. Cost: [`sift`] on one pyramid level, and
//! on a quarter as many samples for each bitmap; for a pair of frames three rounds of matching, two of them guided, and
//! [`ransac`] or [`lmeds`]. Source: the thesis, section 4.3 (the median threshold bitmap has many keypoints where the
//! grey image is dark or bright and has few; both together are always enough).
//!
//! A bitmap has edges at one grey value only, which in a dark frame may be within the noise. Therefore seven bitmaps
//! are used, at fixed percentiles that include Ward's three: at any exposures some of them have structure in both
//! frames. Each bitmap is matched only with the bitmap of the same percentile.

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
    /// The transform with the most inliers; works with up to four fifths wrong matches.
    #[default]
    Ransac,
    /// The transform with the least median of the squared errors. Needs no threshold, but more than half of the matches must be correct.
    Lmeds,
}

#[cfg(test)]
mod tests;
