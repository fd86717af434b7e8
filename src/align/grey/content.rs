//! How bright a frame is, and how much of it shows more than black or white.
//!
//! In: a frame. Out: its [`Content`] and its grey pyramid. Cost: that of the pyramid.

use crate::align::grey::{GreyPyramid, Histogram, Percentile};
use crate::bracket::{Frame, Window};
use crate::error::Result;

/// How a frame is looked at.
#[derive(Debug)]
pub(crate) struct Content {
    /// The brightening_stops by which its grey picture is brightened, so that neither rounding nor halving takes away
    /// what little a dark frame shows.
    pub(crate) brightening_stops: Option<u32>,
    /// Whether it is of one tone.
    pub(crate) is_uniform: bool,
    /// The tones beyond which it shows something, and the share of its pixels that do.
    pub(crate) detail: Detail,
}

impl Content {
    pub(crate) fn of(whole: &Window) -> Self {
        let histogram = Histogram::of_rows((whole.width(), whole.height()), |y, row| whole.grey_row(y, None, row));
        let (nearly_least, nearly_most) =
            (histogram.value_at(Percentile::new(1)), histogram.value_at(Percentile::new(99)));
        // What is brighter than nearly all may burn out: a lamp still has its edge.
        let brightening_stops = Some(nearly_most.leading_zeros().min(MOST_BRIGHTENING))
            .filter(|&brightening_stops| brightening_stops >= LEAST_BRIGHTENING);
        Content {
            brightening_stops,
            is_uniform: nearly_most - nearly_least <= NEARLY_UNIFORM,
            detail: Detail::of(&histogram, (nearly_least, nearly_most), brightening_stops),
        }
    }
}

/// What a frame shows beside the one tone that most of it may have: black or white.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Detail {
    /// Whether the tone is white: the rest is what is darker.
    pub(crate) is_white: bool,
    /// The value of the picture as it is [looked at](Content::brightening_stops) from which up, or where it is white
    /// down, a pixel shows something.
    pub(crate) value: u8,
    /// The share of the pixels that do, 0..=1.
    pub(crate) share: f64,
}

impl Detail {
    /// What a picture shows of which nearly all values are from `least` to `most`, and which is brightened by
    /// `brightening_stops`.
    fn of(histogram: &Histogram, (least, most): (u8, u8), brightening_stops: Option<u32>) -> Self {
        let brightened = |value: u8| (u32::from(value) << brightening_stops.unwrap_or(0)).min(u8::MAX.into()) as u8;
        // Film and sensors have blacks of their own, above 0.
        if histogram.value_at(Percentile::new(50)) > u8::MAX / 2 {
            let value = most.saturating_sub(NEARLY_UNIFORM + 1);
            Detail { is_white: true, value: brightened(value), share: histogram.share(0..=value) }
        } else {
            let value = least.saturating_add(NEARLY_UNIFORM + 1);
            Detail { is_white: false, value: brightened(value), share: histogram.share(value..=u8::MAX) }
        }
    }
}

/// How `frame` is looked at, and its grey pyramid but for the full size.
pub(crate) fn content_and_pyramid(frame: &Frame) -> Result<(Content, GreyPyramid)> {
    let whole = frame.whole()?;
    let seen = Content::of(&whole);
    let size = (frame.width(), frame.height());
    let pyramid = GreyPyramid::of_rows(size, |y, row| whole.grey_row(y, seen.brightening_stops, row));
    Ok((seen, pyramid))
}

/// A frame within so many codes of black, or of white, may hold nothing but noise.
const NEARLY_UNIFORM: u8 = 7;
/// Brightening that is worth the pass over the frame.
const LEAST_BRIGHTENING: u32 = 2;
/// ... and beyond which there is only noise.
const MOST_BRIGHTENING: u32 = 6;
