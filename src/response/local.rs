//! Local processing: finds out whether the camera tone-mapped the frames locally, so that their code values do not
//! depend on exposure alone.
//!
//! In: the flat places of a bracket. Out: [`Evidence`]: which fraction of an exposure step is found in the code
//! values, and how much the ratio of two frames varies over the picture at equal code values. Cost: some milliseconds
//! for any size. Source: the variance components are those of a one-way analysis of variance (Fisher 1925); the rest
//! is our own.
//!
//! Phones brighten dark neighbourhoods and darken bright ones, differently in every frame. This has two effects:
//!
//! 1. A stop more of exposure brightens a frame by less than a stop. A camera response may have the same effect, but
//!    within bounds. The bounds were measured by converting code values to exposures with the sRGB curve. Between
//!    frames rendered with the 100 measured curves of DoRF (Grossberg & Nayar 2004), the exposure steps found were 0.8
//!    to 2.2 times the true steps (median over a picture). In 14 photographed brackets of six cameras, they were 1.0
//!    to 1.7 times the true steps.
//! 2. Places with equal codes in the shorter frame differ in the longer frame, depending on their position in the
//!    picture. Noise has this effect too, but is independent between neighbours; motion has it only in few places.

use super::ResponseCurve;
use super::samples::{Places, Step};
use super::{CODES, fit, stops};
use crate::statistics::{MEDIAN_DEVIATION, median};

/// Smallest exposure step that is evaluated, in stops.
const STEP: f64 = 0.9;
/// Range of codes that are evaluated. Below it, rounding and the toe of the camera's curve dominate; above it, the
/// shoulder of the curve.
const RANGE: (f64, f64) = (8.0, 247.0);
/// Smallest number of places from which a pair of frames is evaluated.
const FEWEST: usize = 60;
/// Number of places in a block of about equal brightness. The median ratio of each block is the part of the ratios
/// that depends on exposure alone.
const BLOCK: usize = 40;
/// Number of neighbourhoods along the longer side of the picture.
const NEIGHBOURHOODS: usize = 24;
/// Places whose ratio deviates by more than this many robust standard deviations count as motion (the reach of Tukey's
/// biweight).
const REACH: f64 = 4.685;
/// Frames count as locally processed if their variation over the picture, in stops, exceeds LOCAL * f^POWER, where f is
/// the fraction of the nominal exposure step that is found in the pixels. The limit is measured. Without local
/// processing, variation / f^POWER was at most 0.023 on 301 rendered brackets (truth.py), and at most 0.032 on 15
/// photographed brackets, some with motion, mist, film or flash; it was 0.056 on a bracket of water. It was 0.061 or
/// more on 49 of 52 brackets of phones. The other three had 0.004 to 0.022; their curves are at least 1.5 times as
/// steep as sRGB's. Because of the power, the limit depends strongly on f. For f = 1, it is larger than the variation
/// that any camera response causes. For f = 1/2, a small variation exceeds it.
const LOCAL: f64 = 0.04;
const POWER: f64 = 5.0;
/// If frames differ by at least this multiple of their exposure step (in the median), they do not count as locally
/// processed, even if the ratio of two frames varies over the picture. Such a variation may have other causes: it was
/// 0.48 stops on a bracket of water under moving lights. The multiple was 0.40 to 1.02 on 24 brackets with simulated
/// phone processing (truth.py), and 1.17 to 1.59 on six photographed brackets. It is above 1 on the latter because
/// camera curves are steeper than sRGB's.
const COMPRESSED: f64 = 1.2;
/// Number of standard errors that are subtracted from a variance. It is large because other causes than noise also
/// make neighbouring places similar.
const ERRORS: f64 = 4.0;
/// Number of brightness levels. The level with the least compression is assumed to have the full exposure step, because
/// tone mapping compresses and never expands. An alternative was tried: to measure at each place by which fraction of
/// the exposure step two frames differ, and to count the 95th percentile of these fractions as the full step. On 12
/// rendered brackets, details are 0.4 dB worse with it.
const LEVELS: usize = 8;

/// Evidence of local processing in flat places.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Difference of two frames at a place, in stops by the sRGB curve, divided by their exposure step: the median over
    /// all places and pairs of frames.
    pub step_fraction: f64,
    /// The same as [`step_fraction`](Self::step_fraction), but for the brightness level with the largest median, which
    /// is compressed least.
    pub most_step_fraction: f64,
    /// How much the ratio of two frames differs between neighbourhoods of the picture: the standard deviation in stops,
    /// for the pair of frames with the largest one. Variation that the code value or noise explains is subtracted; the
    /// value is 0 if noise explains all of it.
    pub variation_stops: f64,
    /// Whether the frames are locally processed.
    pub is_local: bool,
}

/// Evaluates the `places` of a bracket whose frames have a longer side of `longer_side` pixels. Returns `None` if there
/// are too few places.
pub fn evidence(places: &Places, longer_side: usize) -> Option<Evidence> {
    let srgb = ResponseCurve::srgb();
    let level = |code: f64| stops(fit::at(srgb.ln_exposure(0), code));
    let black = places.black();
    let (mut fractions, mut variations, mut most_step_fraction) = (Vec::new(), Vec::new(), 0.0f64);
    for (exposed, steps) in places.steps(STEP) {
        let counts = |step: &&Step| {
            step.codes.0.min(step.codes.1) > RANGE.0.max(2.0 * black[step.channel])
                && step.codes.0.max(step.codes.1) < RANGE.1
        };
        let mut ratios: Vec<Ratio> = steps
            .iter()
            .filter(counts)
            .map(|step| {
                let (a, b) = (level(step.codes.0), level(step.codes.1));
                Ratio { at: step.at, channel: step.channel, level: (a + b) / 2.0, stops: b - a }
            })
            .collect();
        if ratios.len() < 3 * FEWEST {
            continue;
        }
        fractions.extend(ratios.iter().map(|ratio| ratio.stops / exposed));
        ratios.sort_by(|a, b| a.level.total_cmp(&b.level).then(a.at.cmp(&b.at)));
        let levels = medians(&ratios.iter().collect::<Vec<_>>(), LEVELS);
        most_step_fraction = levels.iter().fold(most_step_fraction, |most, level| most.max(level.1 / exposed));
        variations.extend(variation(&ratios, longer_side.div_ceil(NEIGHBOURHOODS).max(1)));
    }
    let step_fraction = median(fractions)?;
    let variation_stops = variations.into_iter().fold(0.0, f64::max);
    Some(Evidence {
        step_fraction,
        most_step_fraction,
        variation_stops,
        is_local: step_fraction < COMPRESSED && variation_stops > LOCAL * libm::pow(step_fraction.max(0.0), POWER),
    })
}

/// The ratio of two frames at one place in one channel.
struct Ratio {
    at: (usize, usize),
    channel: usize,
    /// Mean of the logarithms of exposure in both frames, by the sRGB curve, in stops.
    level: f64,
    /// log2 of the exposure in the longer frame divided by the exposure in the shorter frame.
    stops: f64,
}

/// Returns how much the ratio of the two frames of a pair varies between neighbourhoods of `side` pixels: a lower bound
/// of the standard deviation, in stops. Noise, and variation that the code value explains, are subtracted.
fn variation(ratios: &[Ratio], side: usize) -> Option<f64> {
    let mut residuals: Vec<((usize, usize), f64)> = Vec::new();
    for channel in 0..3 {
        let mut of: Vec<&Ratio> = ratios.iter().filter(|ratio| ratio.channel == channel).collect();
        of.sort_by(|a, b| a.level.total_cmp(&b.level).then(a.at.cmp(&b.at)));
        let usual = medians(&of, (of.len() / BLOCK).clamp(1, CODES));
        residuals.extend(of.iter().map(|ratio| (ratio.at, ratio.stops - between(&usual, ratio.level))));
    }
    // The values of the channels of a place are replaced by one value, their median.
    residuals.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut places: Vec<((usize, usize), f64)> =
        residuals.chunk_by(|a, b| a.0 == b.0).map(|all| (all[0].0, all[all.len() / 2].1)).collect();
    let reach = REACH * median(places.iter().map(|(_, v)| v.abs()))? / MEDIAN_DEVIATION;
    places.retain(|(_, v)| v.abs() <= reach);
    if places.len() < FEWEST {
        return None;
    }
    let cell = |(x, y): (usize, usize)| (y / side, x / side);
    places.sort_by(|a, b| cell(a.0).cmp(&cell(b.0)).then(a.0.cmp(&b.0)));
    // The products of the values of two places in the same neighbourhood are averaged. Noise cancels; the mean is the
    // variance that the two places have in common.
    let (mut products, mut pairs, mut spread) = (0.0, 0.0, 0.0);
    for group in places.chunk_by(|a, b| cell(a.0) == cell(b.0)) {
        let sum: f64 = group.iter().map(|(_, v)| v).sum();
        let square: f64 = group.iter().map(|(_, v)| v * v).sum();
        let fourth: f64 = group.iter().map(|(_, v)| v * v * v * v).sum();
        let n = group.len() as f64;
        products += sum * sum - square;
        spread += square * square - fourth;
        pairs += n * (n - 1.0);
    }
    if pairs < 1.0 {
        return None;
    }
    // If the values are independent, the variance of the mean product is the sum of the squared products divided by
    // the square of the number of pairs; each pair counts once. A variance computed from the mean noise of the picture
    // would be too low, because dark places are noisier and close to each other.
    let error = (spread / 2.0).max(0.0).sqrt() / (pairs / 2.0);
    Some((products / pairs - ERRORS * error).max(0.0).sqrt())
}

/// Divides the `sorted` ratios into `blocks` blocks. Returns the level and the median ratio of each block.
fn medians(sorted: &[&Ratio], blocks: usize) -> Vec<(f64, f64)> {
    let size = sorted.len().div_ceil(blocks).max(1);
    let of = |block: &[&Ratio]| Some((block[block.len() / 2].level, median(block.iter().map(|ratio| ratio.stops))?));
    sorted.chunks(size).filter_map(of).collect()
}

/// Returns the ratio at `level`, interpolated between the blocks and extrapolated beyond the first and the last.
fn between(usual: &[(f64, f64)], level: f64) -> f64 {
    if usual.len() < 2 {
        return usual.first().map_or(0.0, |block| block.1);
    }
    let after = usual.partition_point(|block| block.0 < level).clamp(1, usual.len() - 1);
    let (a, b) = (usual[after - 1], usual[after]);
    if b.0 > a.0 { a.1 + (level - a.0) / (b.0 - a.0) * (b.1 - a.1) } else { a.1 }
}
