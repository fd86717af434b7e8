//! Alignment: where every frame's pixels lie in the reference, and how sure that is.

pub mod bitmap;
pub mod features;
pub mod homography;
pub mod mtb;
pub mod ransac;
pub mod resample;
pub mod sift;
pub mod warp;

use warp::Warp;

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// The frame that the others are aligned to.
    Reference,
    /// Moved, and placed by a warp.
    Aligned,
    /// Found not to have moved: its warp is exactly the identity.
    Unmoved,
    /// Not placed; it takes no part in what follows.
    Rejected,
}

/// A rectangle of pixels: columns `x0..x1`, rows `y0..y1` of the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rect {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Column after the last.
    pub x1: usize,
    /// Row after the last.
    pub y1: usize,
}

impl Rect {
    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.x1 - self.x0
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.y1 - self.y0
    }
}

/// What is known of one frame's place.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// What became of the frame.
    pub status: Status,
    /// Its warp, reference pixel -> frame pixel; none where it was rejected.
    pub warp: Option<Warp>,
    /// Our own estimate of the mean error of the warp, in pixels.
    pub error_px: f64,
    /// 0..1.
    pub confidence: f64,
}

/// The place of every frame of a bracket.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// One verdict per frame, in the order of [`Bracket::frames`](crate::bracket::Bracket::frames).
    pub verdicts: Vec<Verdict>,
    /// The largest rectangle of the reference that all placed frames cover.
    pub overlap: Rect,
}
