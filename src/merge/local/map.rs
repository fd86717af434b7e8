//! A map on cells, read between their centres.
//!
//! In: a value for each cell. Out: the value at each pixel, bilinear. Cost: of a row that of its cells, and an interpolation for each pixel.
//! Source: the textbook's.

use crate::plane::Plane;
use crate::pyramid::between_cells;

/// What can be interpolated.
pub(super) trait Mix: Copy {
    /// `part`, 0..=1, of the way to `other`.
    fn towards(self, other: Self, part: f32) -> Self;
}

impl Mix for f32 {
    fn towards(self, other: Self, part: f32) -> Self {
        self + part * (other - self)
    }
}

impl<const N: usize> Mix for [f32; N] {
    fn towards(self, other: Self, part: f32) -> Self {
        std::array::from_fn(|i| self[i].towards(other[i], part))
    }
}

/// A value for each cell of `side` pixels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Map<T> {
    pub side: usize,
    pub cells: Plane<T>,
}

/// The values of a [`Map`] in one row of pixels.
pub(super) struct Row<T> {
    side: usize,
    cells: Vec<T>,
}

impl<T: Mix> Map<T> {
    /// Row `y` of the pixels.
    pub fn row(&self, y: usize) -> Row<T> {
        let (above, below, part) = between_cells(y, self.side, self.cells.height());
        let pairs = self.cells.row(above).iter().zip(self.cells.row(below));
        Row { side: self.side, cells: pairs.map(|(a, b)| a.towards(*b, part as f32)).collect() }
    }

    /// The value at column `x` and row `y`.
    pub fn at(&self, x: usize, y: usize) -> T {
        let (above, below, down) = between_cells(y, self.side, self.cells.height());
        let (left, right, along) = between_cells(x, self.side, self.cells.width());
        let column = |i: usize| self.cells.row(above)[i].towards(self.cells.row(below)[i], down as f32);
        column(left).towards(column(right), along as f32)
    }
}

impl<T: Mix> Row<T> {
    /// The value at column `x`.
    pub fn at(&self, x: usize) -> T {
        let (left, right, part) = between_cells(x, self.side, self.cells.len());
        self.cells[left].towards(self.cells[right], part as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_and_rows_agree_and_a_slope_stays_one() {
        let map = Map { side: 4, cells: Plane::from_vec(3, 2, [[0.0, 1.0], [4.0, 1.0], [8.0, 1.0]].repeat(2)) };
        for (x, y) in (0..12).flat_map(|x| [(x, 0), (x, 5)]) {
            // Cells have their values at their centres, 1.5, 5.5 and 9.5; beyond the outer ones it is theirs.
            let slope = [(x as f32 - 1.5).clamp(0.0, 8.0), 1.0];
            assert_eq!((map.at(x, y), map.row(y).at(x)), (slope, slope), "{x} {y}");
        }
    }
}
