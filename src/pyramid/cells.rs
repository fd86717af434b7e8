//! Maps with one value per cell, which is a square of pixels: interpolation between the centres of cells, and sums
//! over neighbouring cells.
//!
//! In: a map. Out: its values at pixels, interpolated linearly between the centres of cells; sums around each cell.
//! Cost: a few operations per pixel for the interpolation; 2 (2 reach + 1) additions per cell for the sums.

use crate::plane::Plane;
use std::ops::Range;

/// Returns the indices of the two of `count` cells between whose centres `pixel` lies, and its position between these
/// centres: 0 at the first centre, and below 1.
///
/// Cells are `side` pixels long. Beyond the centre of the first or the last cell of the map, the position is 0, so
/// that only this cell counts. If `side` is a power of 2, the position is exact, also as `f32`.
#[inline]
pub fn between_cells(pixel: usize, side: usize, count: usize) -> (usize, usize, f64) {
    let at = ((pixel as f64 + 0.5) / side as f64 - 0.5).clamp(0.0, (count - 1) as f64);
    let first = at as usize;
    (first, (first + 1).min(count - 1), at - first as f64)
}

/// Values that can be interpolated linearly.
pub trait Mix: Copy {
    /// The value at `part`, 0..=1, between `self` and `other`.
    fn towards(self, other: Self, part: f32) -> Self;
}

impl Mix for f32 {
    #[inline]
    fn towards(self, other: Self, part: f32) -> Self {
        self + part * (other - self)
    }
}

impl<const N: usize> Mix for [f32; N] {
    #[inline]
    fn towards(self, other: Self, part: f32) -> Self {
        std::array::from_fn(|i| self[i].towards(other[i], part))
    }
}

/// Interpolates row `y` of an image from `map`. The cells of the map have `side` x `side` pixels, and `of` converts
/// their entries to the values that are interpolated.
///
/// The interpolation is linear [between cells](between_cells), first along the columns, then along the row.
pub fn row_between_cells<S: Copy, T: Mix>(map: &Plane<S>, side: usize, of: impl Fn(S) -> T, y: usize, row: &mut [T]) {
    let (above, below, part) = between_cells(y, side, map.height());
    let pairs = map.row(above).iter().zip(map.row(below));
    let down: Vec<T> = pairs.map(|(&a, &b)| of(a).towards(of(b), part as f32)).collect();
    for (x, v) in row.iter_mut().enumerate() {
        let (left, right, part) = between_cells(x, side, map.width());
        *v = down[left].towards(down[right], part as f32);
    }
}

/// Combines with `add`, for each position, the values at most `reach` away from it along each axis, first along the
/// rows.
///
/// If `add` adds, the results are sums over squares. If `add` is a logical or, a result is true if any value in the
/// square is true. Positions beyond the border are skipped.
pub fn gathered<T: Copy + Default + Send + Sync>(
    plane: &Plane<T>,
    reach: usize,
    add: impl Fn(&mut T, &T) + Sync,
) -> Plane<T> {
    let (width, height) = (plane.width(), plane.height());
    let along = Plane::from_rows(width, height, |y, row: &mut [T]| {
        for (x, v) in row.iter_mut().enumerate() {
            plane.row(y)[near(x, reach, width)].iter().for_each(|of| add(v, of));
        }
    });
    Plane::from_rows(width, height, |y, row: &mut [T]| {
        for line in near(y, reach, height).map(|y| along.row(y)) {
            row.iter_mut().zip(line).for_each(|(v, of)| add(v, of));
        }
    })
}

/// Returns the true cells of `plane`, and the cells within `reach` cells of a true one, horizontally and vertically.
pub fn grown_by(plane: &Plane<bool>, reach: usize) -> Plane<bool> {
    gathered(plane, reach, |is, near| *is |= near)
}

/// The positions within `reach` of `i` in 0..`size`.
pub fn near(i: usize, reach: usize, size: usize) -> Range<usize> {
    i.saturating_sub(reach)..(i + reach + 1).min(size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixel_is_interpolated_between_the_centres_of_cells() {
        // Cells of 4 pixels have their centres at 1.5, 5.5, 9.5.
        assert_eq!(
            [0, 1, 2, 5, 6].map(|x| between_cells(x, 4, 3)),
            [(0, 1, 0.0), (0, 1, 0.0), (0, 1, 0.125), (0, 1, 0.875), (1, 2, 0.125)]
        );
        assert_eq!(between_cells(11, 4, 3), (2, 2, 0.0));
        // For 8 cells of 8 pixels, positions are exact multiples of 1/16.
        assert!((0..64).all(|x| (16.0 * between_cells(x, 8, 8).2).fract() == 0.0));
    }

    #[test]
    fn rows_between_cells_are_bilinear_and_scaled() {
        let map = Plane::from_vec(2, 2, vec![0u8, 8, 16, 40]);
        let mut row = [0.0f32; 4];
        // Cells are 2 pixels long. Between the centres of two cells, row 1 is at 1/4, and pixels 1 and 2 of the row are
        // at 1/4 and 3/4.
        row_between_cells(&map, 2, |v| 0.5 * f32::from(v), 1, &mut row);
        let (left, right) = (0.5 * 4.0, 0.5 * 16.0);
        assert_eq!(row, [left, left + 0.25 * (right - left), left + 0.75 * (right - left), right]);
    }

    #[test]
    fn gathered_cells_equal_the_double_sum() {
        let plane = Plane::from_vec(7, 70, (0..490).map(|i: u32| i * i % 11).collect());
        let sums = gathered(&plane, 2, |sum, v| *sum += v);
        for (y, x) in (0..70).flat_map(|y| (0..7).map(move |x| (y, x))) {
            let all = near(y, 2, 70).flat_map(|v| near(x, 2, 7).map(move |u| (u, v)));
            assert_eq!(sums.at(x, y), all.map(|(u, v)| plane.at(u, v)).sum::<u32>(), "{x} {y}");
        }
        assert_eq!((near(0, 2, 7), near(6, 2, 7), near(3, 0, 7)), (0..3, 4..7, 3..4));
    }
}
