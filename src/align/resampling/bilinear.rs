//! Bilinear resampling of a grey image to the pixel grid of another image.
//!
//! In: a grey plane and a [`Transform`] into it. Out: rows of the grid, one at a time, so that they need not all be in
//! memory. Cost: two divisions and four reads per pixel. Beyond the border of the image, its border pixels are
//! repeated.

use crate::align::transform::{Transform, map};
use crate::plane::Plane;
use crate::simd::{Loops, floor64, integer64, vectorised};
use nalgebra::Matrix3;

/// A grey image, and the transform of the grid into it.
pub(crate) struct BilinearRows<'a> {
    grey: &'a Plane<u8>,
    h: Matrix3<f64>,
}

impl<'a> BilinearRows<'a> {
    /// Prepares resampling to a grid of the size of `grey`; `transform` maps pixels of the grid to pixels of `grey`.
    pub(crate) fn new(grey: &'a Plane<u8>, transform: &Transform) -> Self {
        BilinearRows { grey, h: transform.matrix(grey.width(), grey.height()) }
    }

    /// Computes row `y` of the grid.
    pub(crate) fn row(&self, y: usize, out: &mut [u8]) {
        if self.grey.width() < 2 || self.grey.height() < 2 {
            out.iter_mut().enumerate().for_each(|(x, v)| *v = self.pixel(x, y));
        } else {
            vectorised(Row { source: self, y, out });
        }
    }

    /// Returns pixel (`x`, `y`) of the grid by the textbook formula, for narrow images and tests.
    fn pixel(&self, x: usize, y: usize) -> u8 {
        let (width, height) = (self.grey.width(), self.grey.height());
        let (u, v) = map(&self.h, x as f64, y as f64);
        let (u, v) = (u.clamp(0.0, width as f64 - 1.0), v.clamp(0.0, height as f64 - 1.0));
        let (left, top) = ((u as usize).min(width.max(2) - 2), (v as usize).min(height.max(2) - 2));
        let (fx, fy) = ((u - left as f64) as f32, (v - top as f64) as f32);
        let (right, bottom) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
        let at = |x: usize, y: usize| f32::from(self.grey.at(x, y));
        let mix = |y: usize| at(left, y) * (1.0 - fx) + at(right, y) * fx;
        (mix(top) * (1.0 - fy) + mix(bottom) * fy + 0.5) as u8
    }
}

/// Number of pixels processed together in each of the three steps: positions, reads, interpolation.
const BLOCK: usize = 64;

/// Computes a row of a grid of at least 2 x 2 pixels.
struct Row<'a, 'b> {
    source: &'a BilinearRows<'b>,
    y: usize,
    out: &'a mut [u8],
}

impl Loops for Row<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let (grey, h, y) = (self.source.grey, &self.source.h, self.y as f64);
        let width = grey.width() as f64;
        let last = (width - 1.0, grey.height() as f64 - 1.0);
        let (upper_codes, lower_codes) = (grey.as_slice(), &grey.as_slice()[grey.width()..]);
        let mut positions = [0u64; BLOCK];
        let (mut fx, mut fy) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
        let (mut upper, mut lower) = ([[0u8; 2]; BLOCK], [[0u8; 2]; BLOCK]);
        for (block, out) in self.out.chunks_mut(BLOCK).enumerate() {
            let first = (block * BLOCK) as i32;
            for i in 0..BLOCK {
                let (u, v) = map(h, f64::from(first + i as i32), y);
                let (u, v) = (within(u, last.0), within(v, last.1));
                let (left, top) = (least(floor64(u), last.0 - 1.0), least(floor64(v), last.1 - 1.0));
                fx[i] = (u - left) as f32;
                fy[i] = (v - top) as f32;
                positions[i] = integer64(top * width + left);
            }
            for i in 0..out.len() {
                let at = positions[i] as usize;
                if let (Some(&[a, b]), Some(&[c, d])) = (upper_codes.get(at..at + 2), lower_codes.get(at..at + 2)) {
                    (upper[i], lower[i]) = ([a, b], [c, d]);
                }
            }
            for (i, out) in out.iter_mut().enumerate() {
                let mix = |pair: [u8; 2]| f32::from(pair[0]) * (1.0 - fx[i]) + f32::from(pair[1]) * fx[i];
                // The value is less than 256, so it fits into `u8`.
                *out = (mix(upper[i]) * (1.0 - fy[i]) + mix(lower[i]) * fy[i] + 0.5) as i32 as u8;
            }
        }
    }
}

/// Clamps `v` to 0..=`most`, without the check of the bounds that `clamp` makes.
#[inline(always)]
fn within(v: f64, most: f64) -> f64 {
    let v = if v < 0.0 { 0.0 } else { v };
    if v > most { most } else { v }
}

#[inline(always)]
fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::{Scene, Shot, perspective, rigid, shift};

    #[test]
    fn rows_side_by_side_are_the_textbooks_pixels() {
        for size in [(203, 90), (64, 3), (2, 2), (1, 40), (40, 1), (1, 1)] {
            let grey = Scene::new(2).photograph(size, &Transform::Identity, Shot::at(0.0));
            // These transforms map pixels beyond each side of the image, onto its border, and to NaN.
            let nowhere = Transform::Homography(Matrix3::from_element(f64::NAN));
            for transform in [
                Transform::Identity,
                shift(0.5, 0.25),
                shift(-300.0, 200.0),
                rigid(3.3, -40.7, 4.0),
                perspective(),
                nowhere,
            ] {
                let rows_of = BilinearRows::new(&grey, &transform);
                let mut row = vec![77; size.0];
                for y in 0..size.1 {
                    rows_of.row(y, &mut row);
                    let slow: Vec<u8> = (0..size.0).map(|x| rows_of.pixel(x, y)).collect();
                    assert_eq!(row, slow, "row {y} of {size:?} under {transform:?}");
                }
            }
        }
    }

    #[test]
    fn identity_changes_nothing_and_half_a_pixel_is_the_mean() {
        let grey = Plane::from_vec(3, 2, vec![10, 20, 40, 10, 20, 40]);
        let row = |transform: &Transform| {
            let mut row = [0; 3];
            BilinearRows::new(&grey, transform).row(1, &mut row);
            row
        };
        assert_eq!((row(&Transform::Identity), row(&shift(0.5, 0.0))), ([10, 20, 40], [15, 30, 40]));
    }
}
