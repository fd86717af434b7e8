//! The pauses between exposures, and the cost of these pauses if the exposures form one bracket (a measure of how
//! unusual they are).
//!
//! In: exposures in order of time. Out: the pauses (the seconds from the end of each exposure to the start of the
//! next), and their cost. Computing time: negligible. Source: EXIF 2.32 does not define whether DateTimeOriginal is
//! the start or the end of an exposure. Most cameras write the start, some the end. [`clock`] detects this from long
//! exposures.

use crate::statistics::of_rank;

/// Longest pause within a bracket, in seconds, unless the user gives another value. Changing a dial by hand in the
/// dark may take more than a minute.
pub(super) const GAP_S: f64 = 120.0;
/// Longest pause between two consecutive brackets of a panorama, in seconds. In this pause, the photographer only
/// turns the tripod head.
pub(super) const SET_S: f64 = 60.0;
/// Longest pause between two consecutive photographs of a burst, in seconds.
pub(super) const BURST_S: f64 = 10.0;

/// The recorded time and settings of one exposure.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct TimedExposure {
    /// Seconds since a start time that is the same for the whole stream; `None` if the time is not known.
    pub at_s: Option<f64>,
    /// Resolution of the clock, in seconds.
    pub resolution_s: f64,
    /// Shutter time in seconds; 0 if unknown.
    pub time_s: f64,
    /// Relative exposure in stops (log2), if known.
    pub ev: Option<f64>,
    /// The exposure mode.
    pub mode: Mode,
    /// The position in the camera's bracketing sequence, in stops, if the camera records it. Otherwise the exposure
    /// compensation.
    pub place: Option<f64>,
    /// The recorded exposure compensation, in stops, if the camera records the position in the sequence separately.
    pub bias: Option<f64>,
    /// Focal length in millimetres.
    pub focal_length_mm: Option<f64>,
}

/// How the exposure was set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Mode {
    AutoBracket,
    Manual,
    Automatic,
    #[default]
    Unknown,
}

/// Which end of an exposure the camera's clock records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Clock {
    Start,
    End,
}

/// Determines which end of an exposure the clock records. Exposures cannot overlap in time. So it computes the
/// overlap under both assumptions and returns the one with less overlap; [`Clock::Start`] if both overlaps are equal.
/// If the clock has whole seconds, the correct assumption also gives some overlap.
pub(super) fn clock(exposures: &[TimedExposure]) -> Clock {
    let overlap = |exposed: fn(&[TimedExposure]) -> f64| {
        let of = |pair: &[TimedExposure]| Some((exposed(pair) - apart(pair)?).max(0.0));
        exposures.windows(2).filter_map(of).sum::<f64>()
    };
    if overlap(|pair| pair[1].time_s) < overlap(|pair| pair[0].time_s) { Clock::End } else { Clock::Start }
}

fn apart(pair: &[TimedExposure]) -> Option<f64> {
    Some(pair[1].at_s? - pair[0].at_s?)
}

/// Returns the seconds from the end of each exposure to the start of the next; `None` if the times are not known.
pub(super) fn gaps(exposures: &[TimedExposure], clock: Clock) -> Vec<Option<f64>> {
    exposures.windows(2).map(|pair| gap(&pair[0], &pair[1], clock)).collect()
}

/// Returns the seconds from the end of exposure `a` to the start of the later exposure `b`.
pub(super) fn gap(a: &TimedExposure, b: &TimedExposure, clock: Clock) -> Option<f64> {
    let exposed = if clock == Clock::Start { a.time_s } else { b.time_s };
    Some((b.at_s? - a.at_s? - exposed).max(0.0))
}

/// A pause costs little up to this length, in seconds, if the camera takes the bracket automatically.
const UNHURRIED_AUTO_S: f64 = 1.0;
/// A pause costs little up to this length, in seconds, in manual mode: the photographer turns dials.
const UNHURRIED_S: f64 = 15.0;
/// A pause costs little up to this length, in seconds, in automatic and unknown modes.
const UNHURRIED_UNKNOWN_S: f64 = 4.0;
/// Weight of the length of a pause: the cost is this factor times ln(1 + pause / pause that costs little).
const LONG: f64 = 0.6;
/// Weight of uneven pauses: the cost of a pause is this factor times |log(pause / median pause of the bracket)|.
const UNEVEN: f64 = 0.8;
/// Differences of this size between the pauses of a bracket are random, in seconds.
const JITTER_S: f64 = 0.5;

/// Returns the cost of the pauses of a bracket: the sum over the pauses of a cost for the length of the pause and a
/// cost for its difference from the median pause.
pub(super) fn cost(exposures: &[TimedExposure], gaps: &[Option<f64>]) -> f64 {
    let known: Vec<f64> = gaps.iter().flatten().copied().collect();
    let rank = known.len().saturating_sub(1) / 2;
    let Some(middle) = of_rank(known, rank) else { return 0.0 };
    let mut sum = 0.0;
    for (gap, pair) in gaps.iter().zip(exposures.windows(2)) {
        let Some(gap) = gap else { continue };
        let is_auto = pair.iter().any(|b| b.mode == Mode::AutoBracket);
        let unhurried = match (is_auto, pair[0].mode) {
            (true, _) => UNHURRIED_AUTO_S,
            (_, Mode::Manual) => UNHURRIED_S,
            _ => UNHURRIED_UNKNOWN_S,
        };
        let resolution = pair[0].resolution_s.max(pair[1].resolution_s);
        // The time of the earlier exposure is added, because after a long exposure the camera may take a dark frame
        // of the same length to subtract the noise.
        let scale = unhurried + resolution + pair[0].time_s;
        let jitter = JITTER_S + resolution + pair[0].time_s;
        sum += LONG * libm::log1p(gap / scale);
        sum += UNEVEN * libm::log((gap + jitter) / (middle + jitter)).abs();
    }
    sum
}
