//! Robust estimation: the homography that most of the point pairs support, although many of the pairs are wrong.
//!
//! In: pairs of points. Out: [`Consensus`]. Cost: one fit to four pairs for each trial. Source: see [`ransac`] and
//! [`lmeds`], which are independent of each other.

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
