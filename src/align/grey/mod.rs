//! Grey pyramids of the frames, which all alignment methods use.
//!
//! In: a frame. Out: its [`GreyPyramid`] with histograms, and the share of its pixels that differ from its black (in a
//! mostly white frame, from its white). Cost: one pass over the frame.

mod content;
mod histogram;
mod pyramid;

pub(crate) use content::{Content, Detail, content_and_pyramid};
pub use histogram::{Histogram, Percentile};
pub(crate) use pyramid::COARSEST;
pub(crate) use pyramid::level_within;
pub use pyramid::{ENOUGH_PIXELS, GreyPyramid, finest_level, measured_level};

use crate::bracket::Frame;
use crate::error::Result;

/// Returns the grey pyramid of `frame` with all its levels.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch) if the frame is on disk and cannot be read.
pub fn grey_pyramid(frame: &Frame) -> Result<GreyPyramid> {
    let brightening_stops = Content::of(&frame.whole()?).brightening_stops;
    Ok(GreyPyramid::new(frame.greys(brightening_stops)?))
}

/// Returns the grey pyramid of `frame` that the alignment uses. For a large frame it lacks the full size, to save
/// memory.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch) if the frame is on disk and cannot be read.
pub fn searched_pyramid(frame: &Frame) -> Result<GreyPyramid> {
    Ok(content_and_pyramid(frame)?.1)
}
