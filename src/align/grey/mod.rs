//! Grey pictures of the frames: what every method of this stage measures on.
//!
//! In: a frame. Out: its [`GreyPyramid`] with histograms, and how much of the frame is neither black nor white. Cost:
//! one pass over the frame.

mod content;
mod histogram;
mod pyramid;

pub(crate) use content::{Content, Detail, content_and_pyramid};
pub use histogram::{Histogram, Percentile};
pub(crate) use pyramid::COARSEST;
pub use pyramid::{ENOUGH_PIXELS, GreyPyramid, finest_level, measured_level};

use crate::bracket::Frame;
use crate::error::Result;

/// The grey pyramid in which the motion of `frame` is sought, with all its levels.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch), where the frame is on disk.
pub fn grey_pyramid(frame: &Frame) -> Result<GreyPyramid> {
    let brightening_stops = Content::of(&frame.whole()?).brightening_stops;
    Ok(GreyPyramid::new(frame.greys(brightening_stops)?))
}

/// The same as the search has it: of a large frame without the full size, which takes most of the memory.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch), where the frame is on disk.
pub fn searched_pyramid(frame: &Frame) -> Result<GreyPyramid> {
    Ok(content_and_pyramid(frame)?.1)
}
