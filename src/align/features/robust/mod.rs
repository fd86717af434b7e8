//! Robust estimation: the homography that most of many partly wrong pairs of points support.
//!
//! In: pairs of points. Out: [`Consensus`]. Cost: one fit of four pairs for each trial. Source: [`ransac`] and
//! [`lmeds`], which do not use each other.

pub(super) mod consensus;
pub mod homography;
pub mod lmeds;
pub mod ransac;

pub use consensus::{Consensus, RansacOptions, distance_squared};

/// Robust estimator for feature matches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum RobustMethod {
    /// The transform that fits more matches than any other; up to four fifths of the matches may be wrong.
    #[default]
    Ransac,
    /// The transform with the least median of the squared errors. Needs no threshold, but more than half of the matches
    /// must be correct.
    Lmeds,
}
