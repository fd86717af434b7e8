//! Features: keypoints of the grey image and of its threshold bitmaps, and the homography of their matches.
//!
//! In: grey pyramids. Out: `FeatureSets`, and for two of them a [`Consensus`]. Cost: for each frame [`sift`] or
//! [`surf`] on one pyramid level, and on each bitmap, which has a quarter as many samples because it is not doubled;
//! for a pair of frames three rounds of matching, two of them guided, and [`ransac`] or [`lmeds`]. Source: the thesis,
//! section 4.3 (where the grey image is dark or bright, it has few keypoints and its median threshold bitmap has many;
//! both together are always enough).
//!
//! A bitmap has edges at one grey value only, which in a dark frame may be within the noise. Therefore seven bitmaps
//! are used, at fixed percentiles that include Ward's three: whatever the exposures, some of the bitmaps have structure
//! in both frames. Each bitmap is matched only with the bitmap of the same percentile.

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
