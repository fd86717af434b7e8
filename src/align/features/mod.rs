//! Features: keypoints of the grey image and of its threshold bitmaps, and the homography of their matches.
//!
//! In: grey pyramids. Out: `FeatureSets`, and a [`Consensus`] for two of them. Cost for each frame: [`sift`] or
//! [`surf`] on one pyramid level, and again on each bitmap of this level; a bitmap has a quarter as many samples,
//! because it is not doubled. Cost for a pair of frames: three rounds of matching, two of them guided, and [`ransac`]
//! or [`lmeds`]. Source: section 4.3 of the thesis that hdralign is based on. It finds that a dark or bright grey image
//! has few keypoints but its median threshold bitmap has many, and that both together always have enough.
//!
//! A bitmap has edges at one grey value only, and in a dark frame the noise may hide these edges. Therefore seven
//! bitmaps are used, at fixed percentiles that include Ward's three. Whatever the exposures are, some of the bitmaps
//! have structure in both frames. Each bitmap is matched only with the bitmap of the same percentile.

mod duplicates;
mod estimation;
mod extraction;
mod interpolation;
mod keypoint;
mod matching;
pub mod robust;
pub mod sift;
mod spread;
pub mod surf;

pub(crate) use estimation::{agreed, by_matches, pairs};
pub(crate) use extraction::{Detector, FeatureSets, features, found_among};
pub use keypoint::{Descriptors, Features, Keypoint, SiftDescriptor, SurfDescriptor};
pub use matching::{Guide, Match, match_mutual};
pub use robust::homography::PointPair;
pub use robust::{Consensus, RansacOptions, RobustMethod, distance_squared, lmeds, ransac};
pub use sift::SiftOptions;
pub use surf::SurfOptions;

#[cfg(test)]
mod patterns;
#[cfg(test)]
mod tests;
