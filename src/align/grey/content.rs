//! Frames as they are looked at: how bright, how much they show, and in which order they were taken.
//!
//! In: a bracket. Out: for each frame what is [seen](Seen) of it at a glance, its grey pyramid, and its turn. Cost: that of the pyramid.

use crate::align::grey::{GreyPyramid, Histogram, Percentile};
use crate::bracket::{Frame, Window};
use crate::error::Result;

/// How a frame is looked at.
#[derive(Debug)]
pub(crate) struct Seen {
    /// The stops by which its grey picture is brightened, so that neither rounding nor halving takes away what little a dark frame shows.
    pub(crate) stops: Option<u32>,
    /// Whether it is of one tone.
    pub(crate) is_plain: bool,
    /// The tones beyond which it shows something, and the share of its pixels that do.
    pub(crate) shown: Shown,
}

impl Seen {
    pub(crate) fn of(whole: &Window) -> Self {
        let histogram = Histogram::of_rows((whole.width(), whole.height()), |y, row| whole.grey_row(y, None, row));
        let (nearly_least, nearly_most) = (histogram.level(Percentile::new(1)), histogram.level(Percentile::new(99)));
        // What is brighter than nearly all may burn out: a lamp still has its edge.
        let stops = Some(nearly_most.leading_zeros().min(MOST_STOPS)).filter(|&stops| stops >= LEAST_STOPS);
        Seen {
            stops,
            is_plain: nearly_most - nearly_least <= BLANK,
            shown: Shown::of(&histogram, (nearly_least, nearly_most), stops),
        }
    }
}

/// What a frame shows beside the one tone that most of it may have: black or white.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shown {
    /// Whether the tone is white: the rest is what is darker.
    pub(crate) is_white: bool,
    /// The level of the picture as it is [looked at](Seen::stops) from which up, or where it is white down, a pixel shows something.
    pub(crate) level: u8,
    /// The share of the pixels that do, 0..=1.
    pub(crate) share: f64,
}

impl Shown {
    /// What a picture shows of which nearly all levels are from `least` to `most`, and which is brightened by `stops`.
    fn of(histogram: &Histogram, (least, most): (u8, u8), stops: Option<u32>) -> Self {
        let brightened = |level: u8| (u32::from(level) << stops.unwrap_or(0)).min(u8::MAX.into()) as u8;
        // Film and sensors have blacks of their own, above 0.
        if histogram.level(Percentile::new(50)) > u8::MAX / 2 {
            let level = most.saturating_sub(BLANK + 1);
            Shown { is_white: true, level: brightened(level), share: histogram.share(0..=level) }
        } else {
            let level = least.saturating_add(BLANK + 1);
            Shown { is_white: false, level: brightened(level), share: histogram.share(level..=u8::MAX) }
        }
    }
}

/// How `frame` is looked at, and its grey pyramid but for the full size.
pub(crate) fn look(frame: &Frame) -> Result<(Seen, GreyPyramid)> {
    let whole = frame.whole()?;
    let seen = Seen::of(&whole);
    let size = (frame.width(), frame.height());
    let pyramid = GreyPyramid::of_rows(size, |y, row| whole.grey_row(y, seen.stops, row));
    Ok((seen, pyramid))
}

/// A frame within so many codes of black, or of white, may hold nothing but noise.
const BLANK: u8 = 7;
/// Brightening that is worth the pass over the frame.
const LEAST_STOPS: u32 = 2;
/// ... and beyond which there is only noise.
const MOST_STOPS: u32 = 6;
