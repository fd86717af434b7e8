//! Divides the exposures of one stream (photographs of one camera and folder) into brackets, at the smallest cost.
//!
//! In: the exposures of one stream in order of time. Out: the ranges that are brackets; photographs between the
//! ranges are in no bracket. Computing time: proportional to the number of frames; for each first frame, at most
//! [`MOST_FRAMES`] ranges (or the number of frames that the user gives) are considered.
//!
//! A division consists of brackets and single photographs. Its cost is the sum of the costs of its parts: a single
//! photograph costs [`SINGLE`]; a bracket costs [`BRACKET`] plus a cost for everything that is unusual about it (see
//! [`cost`]). Dynamic programming finds the division with the smallest cost. This recognises a stray frame beside a
//! repeated pattern. Rules that proceed from frame to frame would take the stray frame as the first frame of the
//! pattern, and all later brackets would be shifted by one frame.
//!
//! Costs are in nats (negative natural logarithms): a cost of 1 means "2.7 times less likely". Source of the
//! algorithm: Jackson et al. 2005, "An algorithm for optimal partitioning of data on an interval". The cost values
//! are not from that paper. They were chosen with the simulated photographers of the tests.

use super::rhythm::{self, Clock, Mode, TimedExposure};
use crate::statistics::median;
use std::collections::BTreeMap;
use std::ops::Range;

/// What is known about the brackets from the user's options.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rules {
    /// Number of frames of every bracket; `None` for any number.
    pub frames: Option<usize>,
    /// Longest pause within a bracket, in seconds.
    pub gap_s: f64,
}

/// Largest number of frames of a bracket if the user does not give the number.
pub(super) const MOST_FRAMES: usize = 32;
/// Two exposures count as equal if they differ by less than this, in stops: half of the smallest step of a camera
/// (1/3 stop).
pub(super) const SAME_STOPS: f64 = 0.17;
/// Smallest range of the exposures of a bracket (brightest minus darkest), in stops.
pub(super) const LEAST_STOPS: f64 = 0.5;

/// Cost of a photograph in no bracket.
const SINGLE: f64 = 3.0;
/// Replaces [`SINGLE`] if the user gives the number of frames of a bracket.
const SINGLE_OF_COUNTED: f64 = 8.0;
/// Cost of a bracket of three frames without unusual properties.
const BRACKET: f64 = 4.0;
/// Additional cost of a bracket of two frames, because two exposures often differ by chance.
const TWO: f64 = 1.5;
/// Additional cost of a bracket of 4, 6, 8, 10 or more frames: brackets of 3, 5, 7 and 9 frames are more common.
const UNUSUAL_COUNT: f64 = 0.3;
/// Cost of a bracket whose exposures span less than a stop.
const NARROW: f64 = 1.0;
/// Cost of each frame that repeats the exposure of an earlier frame of the bracket.
const TWICE: f64 = 4.0;
/// A range with more repeated exposures than this is not considered as a bracket, unless the user gives the number of
/// frames.
const MOST_TWICE: usize = 5;
/// Cost, instead of [`TWICE`], if the last frame repeats the exposure of the frame before it, and at least
/// [`LONG_LADDER`] frames precede it: the photographer had reached the end of the dial.
const ONCE_MORE: f64 = 1.5;
/// Smallest number of frames before the last one for which its repeated exposure costs only [`ONCE_MORE`].
const LONG_LADDER: usize = 5;
/// Cost of each exposure step that differs from the median step of the bracket.
const ODD_STEP: f64 = 1.5;
/// Upper bound of the total cost of such steps in one bracket.
const ODD_STEPS: f64 = 4.0;
/// Cost of each change between getting brighter and getting darker, if no camera uses the order of the exposures.
const TURN: f64 = 0.7;
/// Upper bound of the total cost of these changes of direction in one bracket.
const TURNS: f64 = 5.0;
/// Cost of a bracket that mixes frames in automatic bracket mode with frames in manual or automatic mode, for each
/// frame of the smaller of the two groups.
const MIXED: f64 = 8.0;
/// Cost of each exposure step between two frames in automatic mode, if the recorded compensation does not explain the
/// step. The cause of the step may be a change of the light instead of a bracket.
const METERED: f64 = 3.0;
/// Cost, instead of [`METERED`], of a step of about a stop or more after a pause of at most [`AT_ONCE_S`], if all
/// steps of the bracket are equal. Light does not change so fast and so evenly. So the camera probably took a
/// bracket, although EXIF does not record it.
const METERED_AT_ONCE: f64 = 0.7;
/// Longest pause before a step for which the step costs only [`METERED_AT_ONCE`], in seconds.
const AT_ONCE_S: f64 = 1.0;
/// Cost of each frame that has the same position in the camera's bracketing sequence as an earlier frame.
const PLACE_TWICE: f64 = 2.5;
/// Upper bound of the total cost of repeated positions in one bracket.
const PLACES_TWICE: f64 = 5.0;
/// Gain (negative cost) of a bracket of three or more frames that all have different positions in the camera's
/// bracketing sequence.
const PLACES: f64 = 2.0;
/// Gain (negative cost) if the camera went through its bracketing sequence again with another exposure compensation,
/// and the second pass continues the exposures of the first in even steps. This does not happen by chance.
const EXTENDED: f64 = 4.0;
/// Cost if the same sequence of steps occurs two or more times in a row: the range probably contains several
/// brackets.
const REPEATED: f64 = 4.0;
/// Upper bound of the gain (negative cost) of a bracket whose pattern of exposures was found often on the same card.
const POPULAR: f64 = 2.5;

/// Returns the brackets among `exposures`, as index ranges in order.
pub(super) fn brackets(exposures: &[TimedExposure], clock: Clock, rules: &Rules) -> Vec<Range<usize>> {
    let gaps = rhythm::gaps(exposures, clock);
    let mut popular = Popular::default();
    let mut found = divided(exposures, &gaps, rules, &popular);
    // Patterns of exposures that were found often become more likely. Two further passes are enough, because the
    // frequent patterns of a card are known after the first pass.
    for _ in 0..2 {
        popular = Popular::of(exposures, &found);
        let again = divided(exposures, &gaps, rules, &popular);
        if again == found {
            break;
        }
        found = again;
    }
    found
}

/// Returns the division with the smallest cost, by dynamic programming over the first frame of the last part. If
/// several divisions have the same cost, it returns the one whose brackets start first.
fn divided(exposures: &[TimedExposure], gaps: &[Option<f64>], rules: &Rules, popular: &Popular) -> Vec<Range<usize>> {
    let single = if rules.frames.is_some() { SINGLE_OF_COUNTED } else { SINGLE };
    // reached[end] is the smallest cost of a division of the frames before `end`. best[end] describes the last part
    // (a bracket or a single frame) of that division: the cost of this part, and its first frame.
    let mut best = vec![(0.0, 0); exposures.len() + 1];
    let mut reached = vec![f64::INFINITY; exposures.len() + 1];
    reached[0] = 0.0;
    for begin in 0..exposures.len() {
        let so_far = reached[begin];
        let mut offer = |end: usize, cost: f64| {
            // `<=` (with a tolerance) instead of `<`: if several last parts give the same total cost, the one that
            // starts latest is kept. So brackets come first and single photographs last.
            if so_far + cost <= reached[end] + 1e-9 {
                reached[end] = so_far + cost;
                best[end] = (cost, begin);
            }
        };
        offer(begin + 1, single);
        let most = rules.frames.unwrap_or(MOST_FRAMES).min(exposures.len() - begin);
        let mut twice = 0;
        for count in 2..=most {
            let end = begin + count;
            let is_again = |b: &TimedExposure| b.ev.zip(exposures[end - 1].ev).is_some_and(|(a, b)| is_same(a, b));
            twice += usize::from(exposures[begin..end - 1].iter().any(is_again));
            if rules.frames.is_none() && twice > MOST_TWICE {
                break;
            }
            let is_near = gaps[end - 2].is_none_or(|gap| gap <= rules.gap_s);
            if !is_near || !is_one_view(&exposures[begin], &exposures[end - 1]) {
                break;
            }
            if rules.frames.is_some_and(|frames| frames != count) {
                continue;
            }
            let (exposures, gaps) = (&exposures[begin..end], &gaps[begin..end - 1]);
            let Some(cost) = cost(exposures, gaps, rules) else { continue };
            offer(end, cost - popular.gain(exposures));
        }
    }
    let mut found = Vec::new();
    let mut end = exposures.len();
    while end > 0 {
        let begin = best[end].1;
        if end - begin > 1 {
            found.push(begin..end);
        }
        end = begin;
    }
    found.reverse();
    found
}

/// Returns whether two frames have the same focal length, within 1 %; true if one of the focal lengths is not known.
pub(super) fn is_one_view(a: &TimedExposure, b: &TimedExposure) -> bool {
    match (a.focal_length_mm, b.focal_length_mm) {
        (Some(a), Some(b)) => (a - b).abs() <= 0.01 * a.max(b),
        _ => true,
    }
}

/// Returns the cost of `exposures` if they are one bracket with the pauses `gaps`, or `None` if they cannot be one.
///
/// The cost is a sum. Its terms are for:
/// - the number of frames;
/// - a narrow range of exposures;
/// - long and uneven pauses;
/// - repeated exposures;
/// - uneven steps;
/// - an order that no camera uses;
/// - frames that the camera metered separately;
/// - a mix of frames with and without automatic bracketing;
/// - repeated positions in the camera's bracketing sequence (a gain if all positions differ);
/// - the same steps two or more times in a row.
///
/// If the camera continued its sequence with another compensation, a gain replaces the terms for order, positions and
/// repeated steps.
fn cost(exposures: &[TimedExposure], gaps: &[Option<f64>], rules: &Rules) -> Option<f64> {
    let known: Option<Vec<f64>> = exposures.iter().map(|b| b.ev).collect();
    let Some(evs) = known else {
        // Exposures that are not known are grouped only if the user gives the number of frames; this costs nothing.
        return rules.frames.map(|_| 0.0);
    };
    let sorted = in_order(&evs);
    let range = sorted[sorted.len() - 1] - sorted[0];
    if range < LEAST_STOPS {
        return None;
    }
    let by_count = if rules.frames.is_some() {
        0.0
    } else {
        match exposures.len() {
            2 => BRACKET + TWO,
            3 => BRACKET,
            5 | 7 | 9 => BRACKET + 0.2,
            _ => BRACKET + UNUSUAL_COUNT,
        }
    };
    let is_narrow = if range < 1.0 - SAME_STOPS { NARROW } else { 0.0 };
    let of_sequence = if is_extended(exposures, &sorted) {
        -EXTENDED
    } else {
        of_order(&evs) + of_places(exposures) + of_repeats(&evs)
    };
    Some(
        by_count
            + is_narrow
            + rhythm::cost(exposures, gaps)
            + of_twice(&evs)
            + of_steps(&sorted)
            + of_modes(exposures, gaps, &evs)
            + of_sequence,
    )
}

fn in_order(evs: &[f64]) -> Vec<f64> {
    let mut sorted = evs.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

fn is_same(a: f64, b: f64) -> bool {
    (a - b).abs() < SAME_STOPS
}

/// Returns the cost of exposures that occur more than once.
fn of_twice(evs: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (i, &ev) in evs.iter().enumerate() {
        if evs[..i].iter().any(|&earlier| is_same(ev, earlier)) {
            let is_end = i + 1 == evs.len() && i >= LONG_LADDER && is_same(ev, evs[i - 1]);
            sum += if is_end { ONCE_MORE } else { TWICE };
        }
    }
    sum
}

/// `sorted` contains the exposures from dark to bright. Returns the cost of the steps between them that differ from
/// the median step.
fn of_steps(sorted: &[f64]) -> f64 {
    let steps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).filter(|&step| step >= SAME_STOPS).collect();
    let Some(middle) = median(steps.iter().copied()) else { return 0.0 };
    let odd = steps.iter().filter(|&&step| (step - middle).abs() > SAME_STOPS + 0.1 * middle).count();
    (ODD_STEP * odd as f64).min(ODD_STEPS)
}

/// Returns the cost of changes between getting brighter and getting darker. It is 0 for the three orders that cameras
/// use: monotone; the middle exposure first and then the others from one end to the other; the middle exposure first
/// and then outward, alternating between brighter and darker.
fn of_order(evs: &[f64]) -> f64 {
    let signs: Vec<bool> = evs.windows(2).filter(|w| !is_same(w[0], w[1])).map(|w| w[1] > w[0]).collect();
    let turns = signs.windows(2).filter(|w| w[0] != w[1]).count();
    let rank = |ev: f64| evs.iter().filter(|&&other| other < ev).count();
    let is_from_the_middle = rank(evs[0]) == (evs.len() - 1) / 2 || rank(evs[0]) == evs.len() / 2;
    // The frames after the first are in order from one end to the other, as in 0, -2, -1, 1, 2.
    let is_one_way = |evs: &[f64]| {
        evs.windows(2).all(|w| w[1] > w[0] + SAME_STOPS) || evs.windows(2).all(|w| w[1] < w[0] - SAME_STOPS)
    };
    let is_outward = evs.windows(2).enumerate().all(|(i, w)| {
        let far = |ev: f64| (ev - evs[0]).abs();
        far(w[1]) > far(w[0]) - 2.0 * SAME_STOPS && (i == 0 || (w[1] > evs[0]) != (w[0] > evs[0]))
    });
    if turns == 0 || is_from_the_middle && (is_one_way(&evs[1..]) || is_outward) {
        0.0
    } else {
        (TURN * turns as f64).min(TURNS)
    }
}

/// Returns the cost of a mix of frames with and without automatic bracketing, plus the cost of steps between frames
/// in automatic mode that the recorded compensation does not explain.
fn of_modes(exposures: &[TimedExposure], gaps: &[Option<f64>], evs: &[f64]) -> f64 {
    let count = |mode: Mode| exposures.iter().filter(|b| b.mode == mode).count();
    let (bracketed, others) = (count(Mode::AutoBracket), count(Mode::Manual) + count(Mode::Automatic));
    let mixed = MIXED * bracketed.min(others) as f64;
    let is_even = evs.len() > 2 && of_steps(&in_order(evs)) == 0.0;
    let of_step = |i: usize| {
        let (a, b) = (&exposures[i], &exposures[i + 1]);
        let asked = b.place.unwrap_or(0.0) - a.place.unwrap_or(0.0);
        let given = evs[i + 1] - evs[i];
        // If the recorded compensation changed, the photographer turned a dial. In the meantime the light may have
        // changed by half a stop, so the tolerance is larger.
        let most = if is_same(asked, 0.0) { SAME_STOPS } else { 0.5 };
        if a.mode != Mode::Automatic || b.mode != Mode::Automatic || (given - asked).abs() <= most {
            return 0.0;
        }
        let resolution = a.resolution_s.max(b.resolution_s);
        let is_at_once = gaps[i].is_some_and(|gap| gap <= AT_ONCE_S.max(resolution)) && given.abs() > 1.0 - SAME_STOPS;
        if is_even && is_at_once { METERED_AT_ONCE } else { METERED }
    };
    mixed + (0..gaps.len()).map(of_step).sum::<f64>()
}

/// Returns the cost of repeated positions in the camera's bracketing sequence. It is negative (a gain) if all
/// positions of three or more frames differ.
fn of_places(exposures: &[TimedExposure]) -> f64 {
    let places: Vec<f64> = exposures.iter().filter(|b| b.mode != Mode::Manual).filter_map(|b| b.place).collect();
    let Some(&first) = places.first() else { return 0.0 };
    if places.len() != exposures.len() || places.iter().all(|&p| is_same(p, first)) {
        return 0.0;
    }
    let twice =
        places.iter().enumerate().filter(|(i, p)| places[..*i].iter().any(|earlier| is_same(**p, *earlier))).count();
    match twice {
        0 if places.len() > 2 => -PLACES,
        _ => (PLACE_TWICE * twice as f64).min(PLACES_TWICE),
    }
}

/// Returns whether the camera went through its bracketing sequence more than once, each time with another exposure
/// compensation, and the exposures of all frames together have even steps and no repetition.
fn is_extended(exposures: &[TimedExposure], sorted: &[f64]) -> bool {
    let taken: Option<Vec<(f64, f64)>> = exposures.iter().map(|b| Some((b.place?, b.bias?))).collect();
    let Some(taken) = taken else { return false };
    let is_even = of_steps(sorted) == 0.0 && sorted.windows(2).all(|w| !is_same(w[0], w[1]));
    let mut runs: Vec<&[(f64, f64)]> = Vec::new();
    let mut begin = 0;
    for i in 1..=taken.len() {
        let is_end = i == taken.len() || taken[begin..i].iter().any(|(place, _)| is_same(*place, taken[i].0));
        if is_end {
            runs.push(&taken[begin..i]);
            begin = i;
        }
    }
    // Some cameras record as the bias only the compensation on the dial. Others record the sum of the dialled
    // compensation and the frame's position in the bracketing sequence. Both cases are tried.
    let is_shifted = |dialled: fn(&(f64, f64)) -> f64| {
        let is_constant = |run: &&[(f64, f64)]| run.iter().all(|frame| is_same(dialled(frame), dialled(&run[0])));
        runs.iter().all(is_constant) && runs.windows(2).all(|w| !is_same(dialled(&w[0][0]), dialled(&w[1][0])))
    };
    is_even
        && runs.len() > 1
        && runs.iter().all(|run| run.len() > 1)
        && (is_shifted(|(_, bias)| *bias) || is_shifted(|(place, bias)| bias - place))
}

/// Returns the cost if the exposure steps are those of a shorter bracket two or more times in a row.
fn of_repeats(evs: &[f64]) -> f64 {
    let is_repeated = |period: usize| {
        evs.len().is_multiple_of(period)
            && evs[period..].iter().zip(evs).enumerate().all(|(i, (later, earlier))| {
                let offset = evs[period + i / period * period] - evs[i / period * period];
                is_same(later - earlier, offset)
            })
    };
    // In a ladder (exposures in an order that cameras use), equal steps repeat too; nevertheless it is one bracket.
    let is_ladder = of_order(evs) == 0.0;
    if !is_ladder && (2..=evs.len() / 2).any(is_repeated) { REPEATED } else { 0.0 }
}

/// The number of brackets with each [`pattern`] in the last division.
#[derive(Debug, Default)]
struct Popular(BTreeMap<Vec<i32>, usize>);

impl Popular {
    fn of(exposures: &[TimedExposure], found: &[Range<usize>]) -> Self {
        let mut counts = Popular::default();
        for pattern in found.iter().filter_map(|range| pattern(&exposures[range.clone()])) {
            *counts.0.entry(pattern).or_insert(0) += 1;
        }
        counts
    }

    fn gain(&self, exposures: &[TimedExposure]) -> f64 {
        if self.0.is_empty() {
            return 0.0;
        }
        let others = pattern(exposures).and_then(|pattern| self.0.get(&pattern)).copied().unwrap_or(0);
        libm::log(others.max(1) as f64).min(POPULAR)
    }
}

/// Returns the exposure of each frame of a bracket relative to its first frame, in thirds of a stop.
fn pattern(exposures: &[TimedExposure]) -> Option<Vec<i32>> {
    let first = exposures.first()?.ev?;
    exposures.iter().map(|b| Some(libm::round((b.ev? - first) * 3.0) as i32)).collect()
}

#[cfg(test)]
mod tests;
