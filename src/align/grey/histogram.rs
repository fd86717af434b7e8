//! Histograms of grey values, and their percentiles.
//!
//! In: grey planes or rows. Out: [`Histogram`], [`Percentile`]. Cost: counting at most about two million pixels.

use crate::plane::Plane;
use std::ops::RangeInclusive;

/// The percentile of the grey values that is used as the threshold of a bitmap: the median, or another percentile if
/// the median gives too few dark or bright pixels (Ward: the 17th or 83rd).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Percentile(pub(crate) u8);

impl Percentile {
    /// The median.
    pub const MEDIAN: Percentile = Percentile(50);

    /// The percentile `percent`, clamped to 1..=99.
    pub const fn new(percent: u8) -> Self {
        Percentile(match percent {
            0 => 1,
            1..=99 => percent,
            _ => 99,
        })
    }

    /// The percent, 1..=99.
    pub fn percent(self) -> u8 {
        self.0
    }

    /// Returns the percentiles to try if the median gives too few dark or bright pixels: every multiple of five.
    pub(crate) fn others() -> impl Iterator<Item = Percentile> {
        (1..=19).map(|i| Percentile(5 * i))
    }
}

/// The number of pixels of each grey value.
#[derive(Debug, Clone)]
pub struct Histogram(pub(crate) [u64; 256]);

impl Histogram {
    /// Returns the histogram of `plane`. In a large plane, only evenly spaced rows are counted, with one to two times
    /// `COUNTED` pixels in all.
    pub fn of(plane: &Plane<u8>) -> Self {
        let mut counts = Counts::default();
        counted_rows((plane.width(), plane.height())).for_each(|y| counts.add(plane.row(y)));
        counts.sum()
    }

    /// Returns the histogram of a picture of this size whose rows are computed by `fill`. It counts the same rows as
    /// [`of`](Self::of).
    pub fn of_rows((width, height): (usize, usize), fill: impl Fn(usize, &mut [u8])) -> Self {
        let (mut counts, mut row) = (Counts::default(), vec![0; width]);
        for y in counted_rows((width, height)) {
            fill(y, &mut row);
            counts.add(&row);
        }
        counts.sum()
    }

    pub(crate) fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// Returns the least grey value v for which at least `percentile` percent of the pixels are v or darker.
    pub fn value_at(&self, percentile: Percentile) -> u8 {
        let wanted = (self.total() * u64::from(percentile.0)).div_ceil(100).max(1);
        let mut below = 0;
        for (v, n) in self.0.iter().enumerate() {
            below += n;
            if below >= wanted {
                return v as u8;
            }
        }
        u8::MAX
    }

    /// Returns the share of the pixels darker than `value`, which may be 256.
    pub(crate) fn share_below(&self, value: usize) -> f64 {
        self.0[..value].iter().sum::<u64>() as f64 / self.total().max(1) as f64
    }

    /// Returns the share of the pixels whose grey value is in `values`.
    pub fn share(&self, values: RangeInclusive<u8>) -> f64 {
        values.map(|value| self.0[usize::from(value)]).sum::<u64>() as f64 / self.total().max(1) as f64
    }

    /// Returns the value v, 0..=256, for which the share of the pixels darker than v is nearest to `share`; the lowest
    /// such value if there are several.
    pub(crate) fn value_of_share(&self, share: f64) -> usize {
        let wanted = share * self.total() as f64;
        let mut below = 0u64;
        let mut best = (wanted, 0);
        for (v, n) in self.0.iter().enumerate() {
            below += n;
            let off = (below as f64 - wanted).abs();
            if off < best.0 {
                best = (off, v + 1);
            }
        }
        best.1
    }
}

/// Returns the indices of the rows that are counted in a picture of this size.
fn counted_rows((width, height): (usize, usize)) -> impl Iterator<Item = usize> {
    (0..height).step_by((width * height / COUNTED).max(1))
}

/// Four tables of counts, used in turn: neighbouring pixels of equal value then increment different tables, so no
/// increment waits for another.
struct Counts([[u32; 256]; 4]);

impl Default for Counts {
    fn default() -> Self {
        Counts([[0; 256]; 4])
    }
}

impl Counts {
    fn add(&mut self, row: &[u8]) {
        let (fours, rest) = row.as_chunks::<4>();
        for four in fours {
            for (table, &v) in self.0.iter_mut().zip(four) {
                table[usize::from(v)] += 1;
            }
        }
        for &v in rest {
            self.0[0][usize::from(v)] += 1;
        }
    }

    fn sum(&self) -> Histogram {
        Histogram(std::array::from_fn(|v| self.0.iter().map(|c| u64::from(c[v])).sum()))
    }
}

/// Least number of pixels that are counted in a large plane (approximately). They are enough for percentiles with an
/// error of less than a tenth of a percent.
const COUNTED: usize = 1 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_plane_is_counted_by_some_of_its_rows() {
        let picture = Plane::from_rows(2048, 1600, |y, row: &mut [u8]| {
            row.iter_mut().enumerate().for_each(|(x, v)| *v = ((x + 31 * y) % 251) as u8);
        });
        let large = Histogram::of(&picture);
        assert_eq!(Histogram::of_rows((2048, 1600), |y, row| row.copy_from_slice(picture.row(y))).0, large.0);
        assert_eq!(large.total(), 2048 * 1600_u64.div_ceil(3));
        for percentile in [5, 17, 33, 50, 67, 83, 95].map(Percentile::new) {
            let expected = 251.0 * f64::from(percentile.0) / 100.0;
            assert!((f64::from(large.value_at(percentile)) - expected).abs() <= 1.0, "{percentile:?}");
        }
    }
}
