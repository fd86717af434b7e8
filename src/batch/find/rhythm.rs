//! The pauses between exposures: how long, and what they say of a bracket.
//!
//! In: exposures in the order of time. Out: the seconds from the end of each to the begin of the next, and the cost of such pauses within one
//! bracket. Cost: nothing to speak of. Source: EXIF 2.32 leaves open whether DateTimeOriginal is the begin or the end of an exposure;
//! most cameras write the begin, some the end, and long exposures tell which.

use crate::statistics::of_rank;

/// Longest pause within a bracket unless the user gives one, in seconds. Changing a dial by hand in the dark takes more than a minute.
pub(super) const GAP_S: f64 = 120.0;
/// Longest pause between the brackets of a panorama, in seconds: only the head is turned.
pub(super) const SET_S: f64 = 60.0;
/// Longest pause within a burst, in seconds.
pub(super) const BURST_S: f64 = 10.0;

/// One exposure.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Beat {
    /// Seconds from any begin that the stream has in common; none where nothing says when.
    pub at_s: Option<f64>,
    /// The step of the clock, in seconds.
    pub resolution_s: f64,
    /// Shutter time in seconds; 0 where unknown.
    pub time_s: f64,
    /// Relative exposure, in stops, where known.
    pub ev: Option<f64>,
    /// What set it.
    pub mode: Mode,
    /// What the camera calls its place in the bracket, or the compensation, in stops.
    pub place: Option<f64>,
    /// The compensation beside such a place, in stops.
    pub bias: Option<f64>,
    /// Focal length in millimetres.
    pub focal_length_mm: Option<f64>,
}

/// What set the exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Mode {
    AutoBracket,
    Manual,
    Automatic,
    #[default]
    Unknown,
}

/// What a camera's clock marks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Clock {
    Begin,
    End,
}

/// What the clock marks: two exposures cannot overlap, so what makes them do so for less time is right; the begin, where nothing tells.
/// A clock of whole seconds makes some overlap by either, but by the wrong one more of them.
pub(super) fn clock(beats: &[Beat]) -> Clock {
    let overlap = |exposed: fn(&[Beat]) -> f64| {
        let of = |pair: &[Beat]| Some((exposed(pair) - apart(pair)?).max(0.0));
        beats.windows(2).filter_map(of).sum::<f64>()
    };
    if overlap(|pair| pair[1].time_s) < overlap(|pair| pair[0].time_s) { Clock::End } else { Clock::Begin }
}

fn apart(pair: &[Beat]) -> Option<f64> {
    Some(pair[1].at_s? - pair[0].at_s?)
}

/// Seconds from the end of each exposure to the begin of the next; `None` where nothing says when they were.
pub(super) fn gaps(beats: &[Beat], clock: Clock) -> Vec<Option<f64>> {
    beats.windows(2).map(|pair| gap(&pair[0], &pair[1], clock)).collect()
}

/// Seconds from the end of `a` to the begin of `b`, a later one.
pub(super) fn gap(a: &Beat, b: &Beat, clock: Clock) -> Option<f64> {
    let exposed = if clock == Clock::Begin { a.time_s } else { b.time_s };
    Some((b.at_s? - a.at_s? - exposed).max(0.0))
}

/// A pause of this is as good as none: a camera in an automatic bracket, and hands at the dials.
const UNHURRIED_AUTO_S: f64 = 1.0;
const UNHURRIED_S: f64 = 15.0;
const UNHURRIED_UNKNOWN_S: f64 = 4.0;
/// How fast the cost of a pause rises with the logarithm of its length.
const LONG: f64 = 0.6;
/// The same of its ratio to the rhythm of the others.
const UNEVEN: f64 = 0.8;
/// Pauses differ by so much without any reason, in seconds.
const JITTER_S: f64 = 0.5;

/// What the pauses of a bracket cost: each for its length, and for being another than the middle one of them.
pub(super) fn cost(beats: &[Beat], gaps: &[Option<f64>]) -> f64 {
    let known: Vec<f64> = gaps.iter().flatten().copied().collect();
    let rank = known.len().saturating_sub(1) / 2;
    let Some(middle) = of_rank(known, rank) else { return 0.0 };
    let mut sum = 0.0;
    for (gap, pair) in gaps.iter().zip(beats.windows(2)) {
        let Some(gap) = gap else { continue };
        let is_auto = pair.iter().any(|b| b.mode == Mode::AutoBracket);
        let unhurried = match (is_auto, pair[0].mode) {
            (true, _) => UNHURRIED_AUTO_S,
            (_, Mode::Manual) => UNHURRIED_S,
            _ => UNHURRIED_UNKNOWN_S,
        };
        let resolution = pair[0].resolution_s.max(pair[1].resolution_s);
        // Taking off the noise of a long exposure takes as long again.
        let scale = unhurried + resolution + pair[0].time_s;
        let jitter = JITTER_S + resolution + pair[0].time_s;
        sum += LONG * libm::log1p(gap / scale);
        sum += UNEVEN * libm::log((gap + jitter) / (middle + jitter)).abs();
    }
    sum
}
