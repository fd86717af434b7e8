//! Demosaics a merged bracket once.
//!
//! In: radiance that was merged pixel by pixel from frames with the same colour filters, and without motion. Out: the
//! same radiance where it was measured, and other interpolated values between. Cost: that of `demosaic`, and one
//! exponential for each value.
//!
//! Demosaicing leaves measured samples as they are, so at each pixel, one of the three colours of the merged radiance
//! is the mean of measured samples; the others are means of interpolated ones. These are computed again, from the means
//! of all frames: they have less noise than the samples of a frame, and no frame is clipped where another shows the
//! place, so the directions of edges are found where those of single frames are wrong.

use super::colour::Balance;
use super::demosaic::{BORDER, demosaic};
use super::stretch::Scale;
use super::{Area, Pattern};
use crate::plane::Plane;
use crate::simd::at_least;
use std::ops::Range;

/// A mosaic of merged radiance, to be demosaiced.
#[derive(Debug, Clone)]
pub(crate) struct MergedMosaic {
    pattern: Pattern,
    /// The radiance of white in the shortest frame.
    white: f32,
    /// The least radiance.
    black: f32,
    scale: Scale,
}

impl MergedMosaic {
    /// Rows above and below a part of the picture from which values of this part are interpolated.
    pub(crate) const BORDER: usize = BORDER;

    /// Radiance with colour filters as in `pattern`, from `black` to `white`; `ratio` is the exposure of the longest
    /// frame divided by that of the shortest.
    pub(crate) fn new(pattern: Pattern, [black, white]: [f32; 2], ratio: f32) -> Self {
        MergedMosaic { pattern, white, black, scale: Scale::within(1.0 / ratio) }
    }

    /// Returns `rows` of the demosaiced `radiance`. `first` is the row of the picture at the first row of `radiance`,
    /// which contains [`BORDER`](Self::BORDER) rows more above and below, where the picture has them.
    pub(crate) fn demosaiced(&self, radiance: &Plane<[f32; 3]>, first: usize, rows: Range<usize>) -> Vec<[f32; 3]> {
        let (width, height) = (radiance.width(), radiance.height());
        let pattern = self.pattern.seen(|x, y| (x, first + y));
        let measured = Plane::from_rows(width, height, |y, row: &mut [f32]| {
            for (x, (sample, pixel)) in row.iter_mut().zip(radiance.row(y)).enumerate() {
                *sample = pixel[pattern.at(x, y)];
            }
        });
        let area = Area { left: 0, top: rows.start - first, width, height: rows.len() };
        let linear = |s: f32| at_least(self.white * self.scale.linear(s), self.black);
        let balance = Balance::balanced(self.white, self.scale);
        demosaic(&measured, &pattern, balance, area, |rgb| rgb.map(linear))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::raw::lossless_jpeg::tests::uniform;

    const SIZE: (usize, usize) = (61, 300);

    fn pattern() -> Pattern {
        Pattern::bayer([1, 0, 2, 1])
    }

    /// Radiance from 2^-8 to 2^8, with noise.
    fn radiance() -> Plane<[f32; 3]> {
        let pixel = |x: usize, y: usize| {
            let stops = 16.0 * ((x / 7 + y / 9) % 8) as f64 / 7.0 - 8.0;
            [0, 1, 2].map(|c| libm::exp2(stops + 0.3 * uniform(3, (1000 * y + x) as u64, c)) as f32)
        };
        Plane::from_rows(SIZE.0, SIZE.1, |y, row| row.iter_mut().enumerate().for_each(|(x, p)| *p = pixel(x, y)))
    }

    #[test]
    fn measured_values_stay_and_parts_are_those_of_the_whole() {
        let (mosaic, radiance) = (MergedMosaic::new(pattern(), [0.001, 400.0], 4096.0), radiance());
        let whole = Plane::from_vec(SIZE.0, SIZE.1, mosaic.demosaiced(&radiance, 0, 0..SIZE.1));
        for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
            let (found, c) = (whole.at(x, y), pattern().at(x, y));
            // The scale and its inverse have a relative error of 3e-6: see `stretch`.
            assert!((found[c] / radiance.at(x, y)[c] - 1.0).abs() < 2e-5, "{x} {y}: {found:?}");
            assert!(found.iter().all(|&v| (0.001..=400.1).contains(&v)), "{x} {y}: {found:?}");
        }
        // Slabs have exactly the same values, wherever they are divided.
        for rows in [0..7, 7..130, 130..131, 131..SIZE.1] {
            let wide = rows.start.saturating_sub(MergedMosaic::BORDER)..(rows.end + MergedMosaic::BORDER).min(SIZE.1);
            let part = Plane::from_vec(SIZE.0, wide.len(), radiance.rows(wide.clone()).to_vec());
            let part = mosaic.demosaiced(&part, wide.start, rows.clone());
            assert_eq!(part, whole.rows(rows.clone()), "{rows:?}");
        }
    }

    #[test]
    fn edges_of_any_brightness_have_no_false_colours() {
        let edge = |x: usize| if x < 20 { [0.01; 3] } else { [50.0; 3] };
        let radiance = Plane::from_rows(40, 40, |_, row: &mut [[f32; 3]]| {
            row.iter_mut().enumerate().for_each(|(x, pixel)| *pixel = edge(x));
        });
        let found = MergedMosaic::new(pattern(), [1e-4, 100.0], 1024.0).demosaiced(&radiance, 0, 0..40);
        let found = Plane::from_vec(40, 40, found);
        for (x, y) in (6..34).flat_map(|y| (6..34).map(move |x| (x, y))) {
            let [r, g, b] = found.at(x, y);
            assert!((r / g - 1.0).abs().max((b / g - 1.0).abs()) < 0.1, "({x}, {y}): {r} {g} {b}");
        }
    }
}
