//! Surroundings: the brightness around each pixel, smoothed except at edges.
//!
//! In: the display luminances Y of cells. Out: for each pixel, the log odds log2(Y / (1 - Y)) of its surroundings.
//! Cost: 60 ns per cell of a grid of at most [`CELLS`] cells; two linear interpolations per pixel. Source: He, Sun,
//! "Fast Guided Filter" (2015): a guided filter whose guide is the filtered picture itself, computed on cells and
//! carried to the pixels by linear functions (`guide`).

use super::super::guide::{Columns, Guide, interpolated};
use crate::plane::Plane;
use crate::simd::log2;

/// Largest number of cells. The surroundings of a pixel are five by five cells; five cells are about a thirtieth of the
/// width of a picture.
pub const CELLS: usize = 1 << 14;

/// If the log odds around a cell have this variance, in square stops, half of the cell's deviation from their mean is
/// smoothed away. So deviations of half a stop count as detail of a surface. A step of three stops counts as an edge:
/// 90 % of it is kept.
const DETAIL: f32 = 0.25;

/// Log odds are clamped to -ENDS..=ENDS: beyond this range, surroundings are completely dark or bright.
const ENDS: f32 = 10.0;

/// The brightness around each pixel of a picture.
#[derive(Debug, Clone)]
pub(super) struct Surroundings {
    /// Computes the log odds of a pixel's surroundings from the log odds of the pixel.
    pub guide: Guide,
    columns: Columns,
}

impl Surroundings {
    /// Computes the surroundings in a picture `width` pixels wide with the luminances `display`, 0..=1, of cells of
    /// `side` pixels.
    pub fn new(display: &Plane<f32>, side: usize, width: usize) -> Self {
        let odds =
            |y: &f32| (log2(y.max(f32::MIN_POSITIVE)) - log2((1.0 - y).max(f32::MIN_POSITIVE))).clamp(-ENDS, ENDS);
        let odds = Plane::from_vec(display.width(), display.height(), display.as_slice().iter().map(odds).collect());
        let guide = Guide::smoothed(&odds, side, DETAIL);
        let columns = guide.columns(width);
        Surroundings { guide, columns }
    }

    /// Replaces the log odds of pixels by the log odds of their surroundings. `odds` are log2(Y / (1 - Y)) of the
    /// display luminances Y of consecutive pixels; the first pixel is in column `x`. `lines` are the slopes and offsets
    /// of the guide for this row of the picture.
    #[inline(always)]
    pub fn around<const N: usize>(&self, x: usize, lines: &[[f32; 2]], odds: &mut [f32; N]) {
        for (t, [a, b]) in odds.iter_mut().zip(interpolated(&self.columns, x, lines)) {
            *t = a * *t + b;
        }
    }
}
