//! The usual difference, where nothing moved, between a frame and the standard with which it is compared.
//!
//! In: cells of a frame and of the standard. Out: the median and the spread of the ratio of frame to standard, for each
//! channel and level of radiance. The median is the error of the response; the spread is due to noise and alignment.
//! Cost: about 10 ns per cell.

use super::cells::Cell;
use crate::plane::{Plane, fold_bands};

/// Upper limit of the estimated spread, so that much motion in a picture does not count as noise.
const MOST: f32 = 0.25;
/// Largest factor by which the usual bias is corrected.
const MOST_BIAS: f32 = 1.5;

/// Number of levels of radiance, each half a stop wide.
const LEVELS: usize = 64;
/// Index of the level of radiance 1.
const UNIT_LEVEL: f32 = 40.0;
/// Number of bins of the histogram of ratios of two radiances. The histogram is for ratios from 1/4 to 4.
const RATIOS: usize = 128;
/// Right shift from the bits of a ratio to its bin: floats with the same exponent and the same first five bits of the
/// mantissa share a bin.
const RATIO_SHIFT: u32 = 18;
/// In a level of radiance with this many cells, half of the measured bias is corrected; with more cells, more of it.
const FEW: f32 = 400.0;

/// Approximates log2: exact at powers of 2 and linear between them, so monotone, and the same on any machine.
#[inline]
fn log2_linear(x: f32) -> f32 {
    x.to_bits() as f32 * (1.0 / (1 << 23) as f32) - 127.0
}

/// Returns the level of radiance of two cells: the level of the geometric mean of their radiances.
#[inline]
pub fn level(a: f32, b: f32) -> f32 {
    (log2_linear(a) + log2_linear(b) + UNIT_LEVEL).clamp(0.0, (LEVELS - 1) as f32)
}

/// Bias and spread of the ratio of a frame to the standard, by channel and level of radiance.
pub struct Usual {
    /// Median ratio of frame to standard.
    bias: [[f32; LEVELS]; 3],
    /// Standard deviation of the ratio, from its quartiles.
    spread: [[f32; LEVELS]; 3],
}

impl Usual {
    /// Estimates bias and spread of the ratio of `frame` to `standard` from the whole picture.
    pub fn of(standard: &Plane<Cell>, frame: &Plane<Cell>) -> Self {
        let bin = |c: usize, level: usize, ratio: usize| (c * LEVELS + level) * RATIOS + ratio;
        let first = (1.0f32.to_bits() >> RATIO_SHIFT) - RATIOS as u32 / 2;
        let counts = fold_bands(
            standard.height(),
            |rows| {
                let mut counts = vec![0u32; 3 * LEVELS * RATIOS];
                for (s, f) in standard.rows(rows.clone()).iter().zip(frame.rows(rows)) {
                    if s.is_outside() || f.is_outside() || s.clips() || f.clips() {
                        continue;
                    }
                    for c in (0..3).filter(|&c| !s.is_black(c) && !f.is_black(c)) {
                        let (a, b) = (s.radiance[c], f.radiance[c]);
                        let ratio = ((b / a).to_bits() >> RATIO_SHIFT).saturating_sub(first).min(RATIOS as u32 - 1);
                        counts[bin(c, level(a, b) as usize, ratio as usize)] += 1;
                    }
                }
                counts
            },
            vec![0u32; 3 * LEVELS * RATIOS],
            |mut all, part| {
                all.iter_mut().zip(part).for_each(|(a, b)| *a += b);
                all
            },
        );
        let mut usual = Usual { bias: [[1.0; LEVELS]; 3], spread: [[0.0; LEVELS]; 3] };
        for c in 0..3 {
            for level in 0..LEVELS {
                // The counts of the two neighbouring levels are added with half weight.
                let at = |level: usize, r: usize| f64::from(counts[bin(c, level, r)]);
                let smooth: Vec<f64> = (0..RATIOS)
                    .map(|r| {
                        let (below, above) = (level.max(1) - 1, (level + 1).min(LEVELS - 1));
                        at(level, r) + 0.5 * (at(below, r) + at(above, r))
                    })
                    .collect();
                let all: f64 = smooth.iter().sum();
                if all < 1.0 {
                    continue;
                }
                let rank = |share: f64| {
                    let mut below = 0.0;
                    let bin = smooth.iter().position(|count| {
                        below += count;
                        below >= share * all
                    });
                    let bits = (bin.unwrap_or(RATIOS - 1) as u32 + first) << RATIO_SHIFT | 1 << (RATIO_SHIFT - 1);
                    f32::from_bits(bits)
                };
                let (lower, median, upper) = (rank(0.25), rank(0.5), rank(0.75));
                let known = all as f32 / (all as f32 + FEW);
                usual.bias[c][level] = (1.0 + (median - 1.0) * known).clamp(1.0 / MOST_BIAS, MOST_BIAS);
                // The quartiles of the normal distribution are 1.35 standard deviations apart.
                usual.spread[c][level] = ((upper - lower) / (1.35 * median)).min(MOST);
            }
        }
        usual
    }

    /// Returns bias and spread, interpolated between levels.
    #[inline]
    pub fn at(&self, c: usize, level: f32) -> (f32, f32) {
        // Entry k of the tables is estimated from cells with a level from k to k + 1, so it is valid at the middle of
        // this range.
        let level = (level - 0.5).max(0.0);
        let below = (level as usize).min(LEVELS - 2);
        let f = level - below as f32;
        let between = |t: &[f32; LEVELS]| t[below] + f * (t[below + 1] - t[below]);
        (between(&self.bias[c]), between(&self.spread[c]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rough_logarithm_is_exact_at_powers_of_two_and_monotone() {
        for e in -20..20 {
            assert_eq!(log2_linear(libm::exp2f(e as f32)), e as f32);
        }
        let x = |i: usize| libm::exp2f(i as f32 / 50.0 - 10.0);
        // The approximation is exact at powers of 2. Between them it is too small, by at most 0.0861.
        assert!((1..1000).all(|i| log2_linear(x(i)) > log2_linear(x(i - 1))));
        assert!((0..1000).all(|i| (log2_linear(x(i)) - (i as f32 / 50.0 - 10.0)).abs() < 0.0862));
    }
}
