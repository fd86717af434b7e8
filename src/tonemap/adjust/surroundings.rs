//! Surroundings: how dark or bright it is around each pixel, with edges kept.
//!
//! In: luminance on the display by cells. Out: for each pixel the log odds of its surroundings. Cost: 60 ns a cell, of which there are at most [`CELLS`]; a pixel
//! two linear interpolations. Source: He, Sun, "Fast Guided Filter" (2015): a guided filter of the picture by itself, worked out small and carried
//! to the pixels as straight lines (`guide`).

use super::super::guide::Guide;
use crate::plane::Plane;
use crate::simd::log2;

/// Cells that are looked at: a square of five by five of them, which counts as the surroundings, is a thirtieth of a picture wide.
pub const CELLS: usize = 1 << 14;

/// Variance of log odds, in square stops, of which half is smoothed away: what differs by half a stop to either side is detail of a surface, and a
/// step of three stops is an edge, of which 0.9 is kept.
const DETAIL: f32 = 0.25;

/// Log odds beyond which surroundings are dark or bright, and nothing else.
const ENDS: f32 = 10.0;

/// How dark or bright it is around each pixel of a picture.
#[derive(Debug, Clone)]
pub(super) struct Surroundings {
    /// From the log odds of a pixel to those of its surroundings.
    guide: Guide,
    columns: (Vec<u32>, Vec<f32>),
}

impl Surroundings {
    /// Of a picture `width` pixels wide that has the luminances `display`, 0..=1, by cells of `side` pixels.
    pub fn new(display: &Plane<f32>, side: usize, width: usize) -> Self {
        let odds =
            |y: &f32| (log2(y.max(f32::MIN_POSITIVE)) - log2((1.0 - y).max(f32::MIN_POSITIVE))).clamp(-ENDS, ENDS);
        let odds = Plane::from_vec(display.width(), display.height(), display.as_slice().iter().map(odds).collect());
        let guide = Guide::smoothed(&odds, side, DETAIL);
        let columns = guide.columns(width);
        Surroundings { guide, columns }
    }

    /// The lines of row `y`, by columns of cells, into `lines`.
    pub fn row(&self, y: usize, lines: &mut Vec<[f32; 2]>) {
        self.guide.row(y, lines);
    }

    /// Takes the log odds of pixels, the first of which is in column `x`, to those of what is around them; `lines` are of the row.
    #[inline(always)]
    pub fn around<const N: usize>(&self, x: usize, lines: &[[f32; 2]], odds: &mut [f32; N]) {
        let columns = (self.columns.0[x..].iter(), self.columns.1[x..].iter());
        for ((t, &cell), &part) in odds.iter_mut().zip(columns.0).zip(columns.1) {
            let (p, q) = (lines[cell as usize], lines[cell as usize + 1]);
            let (a, b) = (p[0] + part * (q[0] - p[0]), p[1] + part * (q[1] - p[1]));
            *t = a * *t + b;
        }
    }
}
