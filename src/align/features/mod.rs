//! The features of a frame, of two kinds: of the plain picture, and of its threshold bitmaps; and the motion between two frames on which
//! both kinds agree.
//!
//! In: grey pyramids. Out: [`FeatureSets`], and of two of them a [`Consensus`]. Cost: a run of [`sift`] over the level on which features
//! are sought, one over a quarter of its samples for each bitmap; for a pair of frames three tables of matches, two of them guided, and
//! [`ransac`] or [`lmeds`]. Source: the thesis, section 4.3 (keypoints of the median threshold bitmap are many where the plain picture is
//! dark or bright and has few; both together are always enough).
//!
//! One bitmap has edges at one grey level, and in a dark frame it may lie where there is only noise. There are seven, at fixed
//! percentiles, Ward's three among them: whatever the exposures, two frames have some in common that say something in both, and as each
//! is matched with its like alone, no match can join two that cannot be the same.

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

/// How the matches that agree on a motion are told from the wrong ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RobustMethod {
    /// [`ransac`]: the motion with which most agree, to within a threshold; four fifths may be wrong.
    #[default]
    Ransac,
    /// [`lmeds`]: the motion that half of them fit best, with no threshold; fewer than half may be wrong.
    Lmeds,
}

#[cfg(test)]
mod tests;
