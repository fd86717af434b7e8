//! The grey pyramid of a frame.
//!
//! In: a grey picture, or its rows. Out: [`GreyPyramid`]: levels, each half the size of the one before, with their
//! histograms. Cost: one mean of four pixels for each pixel of the smaller levels.

use crate::align::grey::histogram::Histogram;
use crate::budget::Demand;
use crate::plane::Plane;
use crate::pyramid;
use std::sync::OnceLock;

/// Least length of the short side of the coarsest level, in pixels. It is large enough for a bitmap to have structure,
/// and small enough to try every shift.
pub(crate) const COARSEST: usize = 32;

/// The grey pyramid of a frame, the largest level first. The histogram of each level is computed on first use.
#[derive(Debug, Clone)]
pub struct GreyPyramid {
    size: (usize, usize),
    /// Number of the largest levels, which are not kept.
    passed: usize,
    levels: Vec<(Plane<u8>, OnceLock<Histogram>)>,
}

impl GreyPyramid {
    /// Returns the pyramid of `grey`. The short side of its coarsest level is 32 to 63 pixels, or less if `grey` is
    /// smaller.
    pub fn new(grey: Plane<u8>) -> Self {
        Self::kept((grey.width(), grey.height()), 0, grey)
    }

    /// Returns the pyramid of a picture of `size` whose rows are computed by `row`.
    ///
    /// If the picture has more than [`ENOUGH_PIXELS`] pixels, level 0 is not kept (unless it is the only level); only
    /// two of its rows per thread are in memory.
    pub(crate) fn of_rows(size: (usize, usize), row: impl Fn(usize, &mut [u8]) + Sync) -> Self {
        let (width, height) = size;
        if width * height <= ENOUGH_PIXELS || width.min(height) / 2 < COARSEST {
            return Self::new(Plane::from_rows(width, height, row));
        }
        let mut half = Plane::filled(width / 2, height / 2, 0u8);
        half.fill_bands(|rows, band| {
            let (mut upper, mut lower) = (vec![0; width], vec![0; width]);
            for (y, out) in rows.zip(band.chunks_exact_mut(width / 2)) {
                row(2 * y, &mut upper);
                row(2 * y + 1, &mut lower);
                pyramid::halve_rows(&upper, &lower, out);
            }
        });
        Self::kept(size, 1, half)
    }

    /// Returns the pyramid without its `passed` largest levels; `first` is the largest level that is kept.
    fn kept(size: (usize, usize), passed: usize, first: Plane<u8>) -> Self {
        let levels = pyramid::halves(first, COARSEST).into_iter().map(|p| (p, OnceLock::new())).collect();
        GreyPyramid { size, passed, levels }
    }

    /// Returns level `i`; level 0 is the largest.
    ///
    /// # Panics
    /// If there is no such level, or it was not kept.
    pub fn level(&self, i: usize) -> &Plane<u8> {
        &self.levels[i - self.passed].0
    }

    /// The largest level that was kept.
    pub fn largest(&self) -> &Plane<u8> {
        &self.levels[0].0
    }

    /// Width and height of level `i`, kept or not.
    pub fn size(&self, i: usize) -> (usize, usize) {
        (self.size.0 >> i, self.size.1 >> i)
    }

    /// Number of levels, kept or not.
    pub fn len(&self) -> usize {
        self.passed + self.levels.len()
    }

    /// Always false: there is at least one level.
    pub fn is_empty(&self) -> bool {
        self.levels.is_empty()
    }

    /// Returns the index of the largest kept level whose short side is less than `side` pixels; if there is none, the
    /// index of the coarsest level.
    pub(crate) fn level_narrower_than(&self, side: usize) -> usize {
        (self.passed..self.len()).find(|&i| self.size(i).0.min(self.size(i).1) < side).unwrap_or(self.len() - 1)
    }

    /// The histogram of level `i`.
    pub fn histogram(&self, i: usize) -> &Histogram {
        let (plane, histogram) = &self.levels[i - self.passed];
        histogram.get_or_init(|| Histogram::of(plane))
    }
}

/// Largest number of pixels of a level on which bitmaps are searched for a motion. On photographs of 12 MP, the median
/// error of the motion was 0.038 px with this limit, and 0.033 px at full size, which takes four times as long.
pub const ENOUGH_PIXELS: usize = Demand::WHOLE_PYRAMID as usize;

/// Largest number of pixels of the level that is used to measure agreement and to detect features.
const MEASURED_PIXELS: usize = Demand::MEASURED_PIXELS as usize;

/// Largest number of pixels of the finest level of the refinement: a larger level takes more time without any gain.
const REFINED_PIXELS: usize = 4_000_000;

/// Returns the index of the largest level of `pyramid` with at most `pixels` pixels; if there is none, the index of the
/// coarsest level.
pub(crate) fn level_within(pyramid: &GreyPyramid, pixels: usize) -> usize {
    let area = |(width, height): (usize, usize)| width * height;
    (0..pyramid.len()).find(|&i| area(pyramid.size(i)) <= pixels).unwrap_or(pyramid.len() - 1)
}

/// Returns the index of the level that is used to measure agreement and to detect features.
pub fn measured_level(pyramid: &GreyPyramid) -> usize {
    level_within(pyramid, MEASURED_PIXELS)
}

/// Returns the index of the finest level of the refinement.
pub fn finest_level(pyramid: &GreyPyramid) -> usize {
    level_within(pyramid, REFINED_PIXELS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_of_a_long_strip_by_its_short_side_was_kept() {
        // Usually, a level with fewer than 256 rows would not be reduced further. Level 0 has 250 rows, but more than 4
        // megapixels. So it is not kept, and level 1 is returned.
        let strip = GreyPyramid::of_rows((17_000, 250), |_, row| row.fill(90));
        assert_eq!((strip.passed, strip.level_narrower_than(256)), (1, 1));
    }

    #[test]
    fn a_pyramid_by_rows_has_the_same_levels_but_for_a_largest_that_is_not_kept() {
        for (size, is_kept) in [((2401, 1803), false), ((2000, 1500), true), ((90_000, 50), true)] {
            let grey = Plane::from_rows(size.0, size.1, |y, row| {
                row.iter_mut().enumerate().for_each(|(x, v)| *v = ((x * x / 7 + 31 * y) % 251) as u8);
            });
            let by_rows = GreyPyramid::of_rows(size, |y, row| row.copy_from_slice(grey.row(y)));
            assert_eq!(by_rows.passed == 0, is_kept);
            let whole = GreyPyramid::new(grey);
            assert_eq!(by_rows.len(), whole.len());
            for i in by_rows.passed..whole.len() {
                assert_eq!(by_rows.level(i), whole.level(i));
            }
            for i in 0..whole.len() {
                assert_eq!(by_rows.size(i), (whole.level(i).width(), whole.level(i).height()));
            }
        }
    }
}
