//! Histograms of frames, and matches between the pixel values of two frames.
//!
//! In: pixel values. Out: pairs of pixel values of equal radiance. Cost: one pass over a quarter of the pixels, then
//! operations on 256-entry tables.

use super::curve::{Match, Pair};
use crate::bracket::Samples;

/// Range of well exposed pixel values: they are not clipped, and are above the noise and flare of shadows. In scans,
/// pixel values below this range do not depend on the exposure.
const EXPOSED: (usize, usize) = (24, 250);
/// Range that is used where [`EXPOSED`] leaves too few matches.
const BARELY_EXPOSED: (usize, usize) = (2, 252);
/// A pixel value is matched only if at least this many pixels have this value or a lower one, and at least this many
/// have a higher one.
const TAIL: u64 = 32;

/// Histogram of the green channel, at 8 bits.
#[derive(Debug, Clone)]
pub(super) struct Histogram {
    pub(super) counts: [u64; 256],
    /// `below[k]`: number of values below `k`.
    below: [u64; 257],
}

impl Histogram {
    /// Counts every other pixel of every other row of an image `width` pixels wide, or all pixels of a small image.
    pub(super) fn of(samples: &Samples, width: usize) -> Self {
        let stride = if samples.len() < 3 << 16 { 1 } else { 2 };
        let mut counts = [0u64; 256];
        match samples {
            Samples::Eight(v) => count(v, width, stride, |&code| usize::from(code), &mut counts),
            Samples::Sixteen(v) => count(v, width, stride, |&code| usize::from(code >> 8), &mut counts),
        }
        Histogram::from(counts)
    }

    /// Mean pixel value, 0..=255.
    pub(super) fn mean(&self) -> f64 {
        let sum: u64 = self.counts.iter().zip(0u64..).map(|(n, code)| n * code).sum();
        sum as f64 / self.total().max(1) as f64
    }

    fn total(&self) -> u64 {
        self.below[256]
    }

    /// Returns the pixel value, between integers, that is larger than `rank` of the counted values. The values in each
    /// bin are treated as evenly spread over one unit.
    fn code_at(&self, rank: f64) -> f64 {
        let k = self.below[1..].partition_point(|&n| (n as f64) < rank).min(255);
        let within = (rank - self.below[k] as f64) / self.counts[k].max(1) as f64;
        k as f64 - 0.5 + within.clamp(0.0, 1.0)
    }

    /// Returns the number of pixels with values from `k` - 1 to `k` + 2.
    fn about(&self, k: usize) -> u64 {
        self.below[(k + 3).min(256)] - self.below[k.saturating_sub(1)]
    }
}

impl From<[u64; 256]> for Histogram {
    fn from(counts: [u64; 256]) -> Self {
        let mut below = [0u64; 257];
        for k in 0..256 {
            below[k + 1] = below[k] + counts[k];
        }
        Histogram { counts, below }
    }
}

fn count<T>(v: &[T], width: usize, stride: usize, code: impl Fn(&T) -> usize, counts: &mut [u64; 256]) {
    // Two tables are used alternately, because two consecutive increments of the same bin would have to wait for each
    // other.
    let mut others = [0u64; 256];
    for row in v.chunks_exact(3 * width).step_by(stride) {
        if stride == 2 {
            let (fours, rest) = row.as_chunks::<12>();
            for four in fours {
                counts[code(&four[1])] += 1;
                others[code(&four[7])] += 1;
            }
            rest.chunks_exact(3).step_by(2).for_each(|pixel| counts[code(&pixel[1])] += 1);
        } else {
            let (pairs, last) = row.as_chunks::<6>();
            for pair in pairs {
                counts[code(&pair[1])] += 1;
                others[code(&pair[4])] += 1;
            }
            last.chunks_exact(3).for_each(|pixel| counts[code(&pixel[1])] += 1);
        }
    }
    counts.iter_mut().zip(others).for_each(|(count, other)| *count += other);
}

/// Matches the pixel values that are well exposed in both frames. If these are too few, matches those that are at least
/// barely exposed; `None` where these are too few as well.
pub(super) fn matches(dark: &Histogram, bright: &Histogram) -> Option<Pair> {
    matches_within(dark, bright, EXPOSED).or_else(|| matches_within(dark, bright, BARELY_EXPOSED))
}

fn matches_within(dark: &Histogram, bright: &Histogram, (low, high): (usize, usize)) -> Option<Pair> {
    let scale = bright.total() as f64 / dark.total().max(1) as f64;
    let (mut matches, mut tones) = (Vec::new(), 0);
    for k in low..high {
        let below = dark.below[k + 1];
        if below.min(dark.total() - below) < TAIL {
            continue;
        }
        let to = bright.code_at(below as f64 * scale);
        if (low as f64..=high as f64).contains(&to) {
            let seen = dark.about(k).min((bright.about(to as usize) as f64 / scale) as u64);
            matches.push(Match { from: k as f64 + 0.5, to, weight: (seen as f64).sqrt() });
            tones += usize::from(dark.counts[k] > 0);
        }
    }
    // Fewer than 8 matches may be due to chance. In an image of few tones, no ranks lie between the tones.
    if matches.len() < 8 || tones < 4 {
        return None;
    }
    let (first, last) = (matches.first()?.from as usize, matches.last()?.from as usize);
    let share = (dark.below[last + 1] - dark.below[first]) as f64 / dark.total() as f64;
    Some(Pair { matches, share, is_well_exposed: (low, high) == EXPOSED })
}
