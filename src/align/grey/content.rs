//! Brightness of a frame, and the share of its pixels that differ from its black (in a mostly white frame, from its
//! white).
//!
//! In: a frame. Out: its [`Content`] and its grey pyramid. Cost: the pyramid.

use crate::align::grey::{GreyPyramid, Histogram, Percentile};
use crate::bracket::{Frame, Window};
use crate::error::Result;

/// The brightness of a frame and the detail in it.
#[derive(Debug)]
pub(crate) struct Content {
    /// Number of stops by which a dark frame is brightened before its grey values are rounded and averaged, so that
    /// detail is kept; none if the frame is not dark.
    pub(crate) brightening_stops: Option<u32>,
    /// Whether all pixels but the darkest and the brightest percent have nearly the same grey value.
    pub(crate) is_uniform: bool,
    /// The pixels that differ from the black of the frame, or from its white if it is mostly white.
    pub(crate) detail: Detail,
}

impl Content {
    pub(crate) fn of(whole: &Window) -> Self {
        let histogram = Histogram::of_rows((whole.width(), whole.height()), |y, row| whole.grey_row(y, None, row));
        let (nearly_least, nearly_most) =
            (histogram.value_at(Percentile::new(1)), histogram.value_at(Percentile::new(99)));
        // Brightening may clip the brightest percent: lamps then lose their detail, but keep their edges.
        let brightening_stops = Some(nearly_most.leading_zeros().min(MOST_BRIGHTENING))
            .filter(|&brightening_stops| brightening_stops >= LEAST_BRIGHTENING);
        Content {
            brightening_stops,
            is_uniform: nearly_most - nearly_least <= NEARLY_UNIFORM,
            detail: Detail::of(&histogram, (nearly_least, nearly_most), brightening_stops),
        }
    }
}

/// The pixels of a frame that differ from black, or from white in a mostly white frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Detail {
    /// Whether more than half of the frame is bright (median above 127). If so, detail is what differs from the frame's
    /// white; otherwise it is what differs from the frame's black.
    pub(crate) is_white: bool,
    /// The limit of the grey values that count as detail, after [brightening](Content::brightening_stops). Detail is
    /// this value and brighter ones; in a mostly white frame ([`is_white`](Self::is_white)), this value and darker
    /// ones.
    pub(crate) value: u8,
    /// The share of the pixels that are detail, 0..=1.
    pub(crate) share: f64,
}

impl Detail {
    /// Returns the detail of a frame whose 1st and 99th percentiles are `least` and `most`, brightened by
    /// `brightening_stops`.
    fn of(histogram: &Histogram, (least, most): (u8, u8), brightening_stops: Option<u32>) -> Self {
        let brightened = |value: u8| (u32::from(value) << brightening_stops.unwrap_or(0)).min(u8::MAX.into()) as u8;
        // The black of film and sensors may be above 0. So the black of the frame is its 1st percentile, and its white
        // the 99th.
        if histogram.value_at(Percentile::new(50)) > u8::MAX / 2 {
            let value = most.saturating_sub(NEARLY_UNIFORM + 1);
            Detail { is_white: true, value: brightened(value), share: histogram.share(0..=value) }
        } else {
            let value = least.saturating_add(NEARLY_UNIFORM + 1);
            Detail { is_white: false, value: brightened(value), share: histogram.share(value..=u8::MAX) }
        }
    }
}

/// Returns the content of `frame` and its grey pyramid. The pyramid of a large frame lacks the full size.
pub(crate) fn content_and_pyramid(frame: &Frame) -> Result<(Content, GreyPyramid)> {
    let whole = frame.whole()?;
    let content = Content::of(&whole);
    let size = (frame.width(), frame.height());
    let pyramid = GreyPyramid::of_rows(size, |y, row| whole.grey_row(y, content.brightening_stops, row));
    Ok((content, pyramid))
}

/// Largest difference of grey values that noise alone may cause.
const NEARLY_UNIFORM: u8 = 7;
/// A frame that could be brightened by fewer stops than this is not brightened, because the gain is not worth the time.
const LEAST_BRIGHTENING: u32 = 2;
/// Largest brightening, in stops: more would only amplify noise.
const MOST_BRIGHTENING: u32 = 6;
