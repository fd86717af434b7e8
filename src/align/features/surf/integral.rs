//! The integral image, which gives the sum over a box of any size from only four values (Bay 2006, section 3).

use crate::plane::Plane;

/// For every corner between pixels, the sum of all grey values above it and to its left.
///
/// The sums wrap around in 32 bits. Nevertheless the sum over a box of up to 16 million pixels is exact, because it is
/// a difference of these sums and fits into 32 bits itself.
pub(super) struct Integral {
    /// The sums. This plane has one column and one row more than the image.
    sums: Plane<u32>,
}

impl Integral {
    pub(super) fn new(grey: &Plane<u8>) -> Self {
        let (width, height) = (grey.width(), grey.height());
        let mut sums = vec![0u32; (width + 1) * (height + 1)];
        for y in 0..height {
            let (above, below) = sums[y * (width + 1)..(y + 2) * (width + 1)].split_at_mut(width + 1);
            let mut row = 0u32;
            for ((v, up), sum) in grey.row(y).iter().zip(&above[1..]).zip(&mut below[1..]) {
                row = row.wrapping_add(u32::from(*v));
                *sum = up.wrapping_add(row);
            }
        }
        Integral { sums: Plane::from_vec(width + 1, height + 1, sums) }
    }

    /// Width of the image.
    pub(super) fn width(&self) -> usize {
        self.sums.width() - 1
    }

    /// Height of the image.
    pub(super) fn height(&self) -> usize {
        self.sums.height() - 1
    }

    /// Returns the sum over columns `left..right` and rows `top..bottom`, which must be inside the image.
    #[inline]
    pub(super) fn sum(&self, (left, right): (usize, usize), (top, bottom): (usize, usize)) -> u32 {
        let (above, below) = (self.sums.row(top), self.sums.row(bottom));
        below[right].wrapping_sub(below[left]).wrapping_sub(above[right].wrapping_sub(above[left]))
    }

    /// Returns, for every x in 0..=width, the sum over rows `top..bottom` and columns `0..x`.
    pub(super) fn between(&self, top: usize, bottom: usize) -> Vec<u32> {
        self.sums.row(bottom).iter().zip(self.sums.row(top)).map(|(below, above)| below.wrapping_sub(*above)).collect()
    }

    /// Returns the responses of the two Haar wavelets on the square around (x, y) whose side is 2 `half` pixels: right
    /// half minus left half, and lower half minus upper half. Both are 0 if the square is not inside the image.
    pub(super) fn haar(&self, x: f32, y: f32, half: usize) -> [f32; 2] {
        // The square is centred on the pixel corner that is nearest to (x, y). The conversion turns negative positions
        // into 0.
        let (x, y) = ((x + 1.0) as usize, (y + 1.0) as usize);
        if x < half || y < half || x + half > self.width() || y + half > self.height() {
            return [0.0; 2];
        }
        let (left, right) = (x - half, x + half);
        let (top, bottom) = (y - half, y + half);
        let (above, middle, below) = (self.sums.row(top), self.sums.row(y), self.sums.row(bottom));
        let between = |low: u32, high: u32| high.wrapping_sub(low);
        // These are the sums over the halves of the square. Although the sums wrap around, their differences are exact
        // as signed numbers.
        let west = between(between(above[left], above[x]), between(below[left], below[x]));
        let east = between(between(above[x], above[right]), between(below[x], below[right]));
        let north = between(between(above[left], above[right]), between(middle[left], middle[right]));
        let south = between(between(middle[left], middle[right]), between(below[left], below[right]));
        [east.wrapping_sub(west) as i32 as f32, south.wrapping_sub(north) as i32 as f32]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> Plane<u8> {
        Plane::from_rows(41, 33, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = ((x * 37 + y * y * 91) % 251) as u8;
            }
        })
    }

    #[test]
    fn sums_over_boxes_are_those_of_the_pixels() {
        let (grey, integral) = (picture(), Integral::new(&picture()));
        for (columns, rows) in [((0, 41), (0, 33)), ((3, 4), (7, 20)), ((10, 10), (2, 9)), ((5, 40), (32, 33))] {
            let pixels = (rows.0..rows.1).flat_map(|y| &grey.row(y)[columns.0..columns.1]);
            assert_eq!(integral.sum(columns, rows), pixels.map(|v| u32::from(*v)).sum::<u32>());
        }
    }

    #[test]
    fn wavelets_are_differences_of_halves() {
        let (grey, integral) = (picture(), Integral::new(&picture()));
        for (x, y, half) in [(20.0, 16.0, 3), (7.3, 9.8, 5), (2.0, 2.0, 2), (19.6, 12.4, 1)] {
            // The centre of pixel i is at i, and its edges are half a pixel away.
            let (cx, cy) = ((x + 0.5f32).round() - 0.5, (y + 0.5f32).round() - 0.5);
            let mut expected = [0.0f32; 2];
            for row in 0..33 {
                for column in 0..41 {
                    let (dx, dy) = (column as f32 - cx, row as f32 - cy);
                    if dx.abs() < half as f32 && dy.abs() < half as f32 {
                        expected[0] += dx.signum() * f32::from(grey.at(column, row));
                        expected[1] += dy.signum() * f32::from(grey.at(column, row));
                    }
                }
            }
            assert_eq!(integral.haar(x, y, half), expected, "{x} {y} {half}");
        }
        assert_eq!(integral.haar(1.0, 20.0, 3), [0.0; 2], "not inside");
    }
}
