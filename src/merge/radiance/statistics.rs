//! Statistics of a radiance map.
//!
//! In: radiance. Out: the range and percentiles of its luminance. Cost: one pass. Percentiles are from a histogram. A
//! bin contains the floats with the same exponent and the same first seven bits of the mantissa. So there are 128 bins
//! per octave, no logarithms are needed, and the result is the same on any machine.

use crate::merge::radiance::calibration::Unit;
use crate::plane::{BAND_ROWS, Plane};
use rayon::prelude::*;
use serde::Serialize;

/// Number of low bits of a float that are ignored.
const DROPPED: u32 = 16;
/// Number of bins: one for each combination of the bits of a positive float that are not ignored.
const BINS: usize = 1 << (31 - DROPPED);

/// Range and percentiles of luminance, in the unit of the map.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Statistics {
    /// The unit: `relative` or `cd/m2`.
    pub unit: Unit,
    /// The minimum.
    pub min: f32,
    /// The maximum.
    pub max: f32,
    /// The 0.1st percentile; all percentiles are accurate to 0.4 %.
    pub p0_1: f32,
    /// The 1st percentile.
    pub p1: f32,
    /// The median.
    pub p50: f32,
    /// The 99th percentile.
    pub p99: f32,
    /// The 99.9th percentile.
    pub p99_9: f32,
    /// The 99.99th percentile, which includes lamps but not hot pixels.
    pub p99_99: f32,
    /// log2 of the ratio of the 99.9th percentile to the 0.1st.
    pub dynamic_range_stops: f64,
    /// max / min, which depends on single pixels.
    pub contrast: f64,
}

/// Contributions of red, green and blue to luminance in ITU-R BT.709.
pub(crate) const BT709: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Returns the luminance of a pixel whose channels contribute by `weights`.
pub(crate) fn luminance([r, g, b]: [f32; 3], weights: [f32; 3]) -> f32 {
    weights[0] * r + weights[1] * g + weights[2] * b
}

/// A histogram of luminance.
#[derive(Debug, Clone, PartialEq)]
pub struct Tally {
    min: f32,
    max: f32,
    bins: Vec<u64>,
}

impl Default for Tally {
    fn default() -> Self {
        Tally { min: f32::INFINITY, max: 0.0, bins: vec![0; BINS] }
    }
}

impl Tally {
    /// Adds `pixels`, whose values are positive and finite; `weights` are the contributions of red, green and blue to
    /// luminance.
    pub fn see(&mut self, pixels: &Plane<[f32; 3]>, weights: [f32; 3]) {
        let band = (BAND_ROWS * pixels.width()).max(1);
        let add = |mut part: Tally, pixels| {
            part.add(pixels, weights);
            part
        };
        // Integers, minimum and maximum do not depend on the order, so each thread may have its own histogram.
        let all = pixels.as_slice().par_chunks(band).fold(Tally::default, add).reduce(Tally::default, Tally::and);
        *self = std::mem::take(self).and(all);
    }

    fn add(&mut self, pixels: &[[f32; 3]], weights: [f32; 3]) {
        // Pixels are processed in blocks, so that luminances are computed with vector instructions before they are
        // counted.
        let mut values = [0.0f32; 64];
        for pixels in pixels.chunks(values.len()) {
            let values = &mut values[..pixels.len()];
            for (value, pixel) in values.iter_mut().zip(pixels) {
                *value = luminance(*pixel, weights);
            }
            for &y in &*values {
                self.min = if y < self.min { y } else { self.min };
                self.max = if y > self.max { y } else { self.max };
                self.bins[((y.to_bits() >> DROPPED) as usize).min(BINS - 1)] += 1;
            }
        }
    }

    fn and(mut self, other: Tally) -> Self {
        (self.min, self.max) = (self.min.min(other.min), self.max.max(other.max));
        self.bins.iter_mut().zip(other.bins).for_each(|(a, b)| *a += b);
        self
    }

    /// Returns the statistics in `unit`.
    pub fn statistics(&self, unit: Unit) -> Statistics {
        let at = |share: f64| percentile(&self.bins, share).clamp(self.min, self.max);
        Statistics {
            unit,
            min: self.min,
            max: self.max,
            p0_1: at(0.001),
            p1: at(0.01),
            p50: at(0.5),
            p99: at(0.99),
            p99_9: at(0.999),
            p99_99: at(0.9999),
            dynamic_range_stops: libm::log2(f64::from(at(0.999)) / f64::from(at(0.001))),
            contrast: f64::from(self.max) / f64::from(self.min),
        }
    }
}

impl Tally {
    /// Returns the histogram in steps of `1 / per_stop` stops, from the first step that is not empty to the last. The
    /// result is the index of the first step (step 0 begins at a luminance of 1) and the counts.
    ///
    /// # Panics
    /// If `per_stop` is 0.
    pub fn by_stops(&self, per_stop: usize) -> (i64, Vec<u64>) {
        assert!(per_stop > 0);
        // Bins are far smaller than steps, so the middle of a bin decides to which step its pixels count.
        let step = |bin: usize| {
            let middle = f32::from_bits(((bin as u32) << DROPPED) | (1 << (DROPPED - 1)));
            (libm::log2(f64::from(middle)) * per_stop as f64).floor() as i64
        };
        let held = || self.bins.iter().enumerate().filter(|(_, n)| **n > 0);
        let (Some(first), Some(last)) = (held().next(), held().next_back()) else { return (0, Vec::new()) };
        let (first, last) = (step(first.0), step(last.0));
        let mut counts = vec![0; (last - first + 1) as usize];
        held().for_each(|(bin, n)| counts[(step(bin) - first) as usize] += n);
        (first, counts)
    }
}

impl Statistics {
    /// Returns the statistics in `unit` of `pixels`, whose values are positive and finite; `weights` as in
    /// [`Tally::see`].
    pub fn measured(pixels: &Plane<[f32; 3]>, weights: [f32; 3], unit: Unit) -> Self {
        let mut tally = Tally::default();
        tally.see(pixels, weights);
        tally.statistics(unit)
    }
}

/// Returns the middle of the bin that contains the value of rank `share` (0..=1) times the number of values.
fn percentile(bins: &[u64], share: f64) -> f32 {
    let rank = (share * bins.iter().sum::<u64>() as f64) as u64;
    let mut below = 0;
    let bin = bins.iter().position(|&count| {
        below += count;
        below > rank
    });
    f32::from_bits(((bin.unwrap_or(BINS - 1) as u32) << DROPPED) | 1 << (DROPPED - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(pixels: &Plane<[f32; 3]>) -> Statistics {
        Statistics::measured(pixels, BT709, Unit::Relative)
    }

    #[test]
    fn percentiles_are_those_of_the_sorted_values() {
        let value = |i: usize| libm::exp2((i * 7919 % 10_007) as f64 / 700.0 - 7.0) as f32;
        let pixels = Plane::from_vec(100, 100, (0..10_000).map(|i| [value(i); 3]).collect());
        let mut sorted: Vec<f32> = pixels.as_slice().iter().map(|&p| luminance(p, BT709)).collect();
        sorted.sort_by(f32::total_cmp);
        let s = of(&pixels);
        assert_eq!((s.min, s.max), (sorted[0], sorted[9_999]));
        // The tolerance is half a bin of the histogram: 2^-8 of the value.
        for (found, rank) in [(s.p1, 100), (s.p50, 5_000), (s.p99, 9_900)] {
            assert!((found / sorted[rank] - 1.0).abs() < 1.0 / 255.0, "{found} for {}", sorted[rank]);
        }
        // The range has half a bin of error at either end: 2 * log2(1 + 2^-8) = 0.0113 stops.
        assert!((s.p99_9 / sorted[9_990] - 1.0).abs() < 1.0 / 255.0 && (s.p0_1 / sorted[10] - 1.0).abs() < 1.0 / 255.0);
        let stops = f64::from(sorted[9_990] / sorted[10]);
        assert!((s.dynamic_range_stops - libm::log2(stops)).abs() < 0.012);
    }

    #[test]
    fn weights_and_units_are_those_given() {
        let s = Statistics::measured(&Plane::filled(3, 2, [1.0, 2.0, 4.0]), [0.5, 0.25, 0.25], Unit::CdM2);
        assert_eq!((s.min, s.max, s.unit), (2.0, 2.0, Unit::CdM2));
        assert_eq!(serde_json::to_value(s).unwrap()["unit"], "cd/m2");
    }

    #[test]
    fn steps_of_stops_hold_every_pixel_once() {
        let pixels = Plane::from_vec(4, 1, [0.26f32, 1.0, 1.2, 7.9].map(|v| [v; 3]).to_vec());
        let mut tally = Tally::default();
        tally.see(&pixels, BT709);
        // The log2 of the values is -1.94, 0, 0.26, 2.98; in steps of half a stop: -4, 0, 0, 5.
        assert_eq!(tally.by_stops(2), (-4, vec![1, 0, 0, 0, 2, 0, 0, 0, 0, 1]));
        assert_eq!(tally.by_stops(1).1.iter().sum::<u64>(), 4);
        assert_eq!(Tally::default().by_stops(4), (0, Vec::new()));
    }

    #[test]
    fn a_single_value_is_its_own_percentile() {
        let s = of(&Plane::filled(3, 70, [0.3; 3]));
        assert_eq!((s.p1, s.p50, s.p99), (s.min, s.min, s.min));
        assert_eq!((s.dynamic_range_stops, s.contrast), (0.0, 1.0));
    }
}
