//! The grey pyramid of a frame.
//!
//! In: a grey picture, or its rows. Out: [`GreyPyramid`]: levels of half the size each, with the histogram of each.
//! Cost: one mean of four pixels for each pixel of the smaller levels.

use crate::align::grey::histogram::Histogram;
use crate::budget::Demand;
use crate::plane::Plane;
use crate::pyramid;
use std::sync::OnceLock;

/// Short side of the coarsest level, in pixels: large enough for a bitmap to have shape, small enough to search every
/// shift.
pub(crate) const COARSEST: usize = 32;

/// The grey pyramid of a frame, the largest level first, and the histogram of each level, counted on first use.
#[derive(Debug, Clone)]
pub struct GreyPyramid {
    size: (usize, usize),
    /// How many of the largest levels are not kept.
    passed: usize,
    levels: Vec<(Plane<u8>, OnceLock<Histogram>)>,
}

impl GreyPyramid {
    /// The pyramid of `grey`, down to a short side of about 32 pixels.
    pub fn new(grey: Plane<u8>) -> Self {
        Self::kept((grey.width(), grey.height()), 0, grey)
    }

    /// The pyramid of the picture of `size` of which `row` gives each row. Where it is larger than any level that is
    /// searched, only two rows of it are ever there, and level 0 is not available.
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

    /// The levels from that on which `first` is.
    fn kept(size: (usize, usize), passed: usize, first: Plane<u8>) -> Self {
        let levels = pyramid::halves(first, COARSEST).into_iter().map(|p| (p, OnceLock::new())).collect();
        GreyPyramid { size, passed, levels }
    }

    /// Level `i`, 0 the largest.
    ///
    /// # Panics
    /// When there is none, or it was not kept.
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

    /// How many levels there are.
    pub fn len(&self) -> usize {
        self.passed + self.levels.len()
    }

    /// Never: there is always the full size.
    pub fn is_empty(&self) -> bool {
        self.levels.is_empty()
    }

    /// The histogram of level `i`.
    pub fn histogram(&self, i: usize) -> &Histogram {
        let (plane, histogram) = &self.levels[i - self.passed];
        histogram.get_or_init(|| Histogram::of(plane))
    }
}

/// Pixels of the largest level searched. On photographs of 12 MP the median error was 0.038 px so, and 0.033 px on the
/// full size, which takes four times as long.
pub const ENOUGH_PIXELS: usize = Demand::WHOLE_PYRAMID as usize;

/// About so many pixels has the largest level that is compared pixel by pixel: where agreement is measured and features
/// are sought.
const MEASURED_PIXELS: usize = Demand::MEASURED_PIXELS as usize;

/// ... and the largest on which single points are compared: more add nothing but time.
const REFINED_PIXELS: usize = 4_000_000;

/// The first level of `pyramid` with at most `pixels` pixels.
fn level_within(pyramid: &GreyPyramid, pixels: usize) -> usize {
    let area = |(width, height): (usize, usize)| width * height;
    (0..pyramid.len()).find(|&i| area(pyramid.size(i)) <= pixels).unwrap_or(pyramid.len() - 1)
}

/// The level on which agreement is measured, and features are sought.
pub fn measured_level(pyramid: &GreyPyramid) -> usize {
    level_within(pyramid, MEASURED_PIXELS)
}

/// The largest level on which points are compared.
pub fn finest_level(pyramid: &GreyPyramid) -> usize {
    level_within(pyramid, REFINED_PIXELS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pyramid_by_rows_has_the_same_levels_but_for_a_largest_that_no_search_uses() {
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
