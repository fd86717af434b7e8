//! Reduced pictures: averages over cells, taken as rows come by.
//!
//! In: rows of a picture, from the first to the last, in parts of any size. Out: the same picture in fewer pixels. Cost: one addition a value, and
//! four bytes for each value of what comes out. Codes are averaged as they are, which is good enough for a look.

use crate::bracket::{Codes, Frame};
use crate::error::Result;
use crate::plane::{BAND_ROWS, Plane};

/// A picture that is being reduced.
#[derive(Debug, Clone)]
pub(super) struct Reduced {
    full: (usize, usize),
    size: (usize, usize),
    /// The cell of each column.
    cells: Vec<usize>,
    /// Where the next pixel lies, column and row.
    next: (usize, usize),
    sums: Vec<[u32; 3]>,
}

/// The size of a picture of `full` pixels that has at most `most` on its long side.
pub(super) fn within(full: (usize, usize), most: usize) -> (usize, usize) {
    let long = full.0.max(full.1);
    if long <= most {
        return full;
    }
    let side = |n: usize| ((n * most + long / 2) / long).max(1);
    (side(full.0), side(full.1))
}

impl Reduced {
    /// Of a picture of `full` pixels, to at most `most` on the long side.
    pub fn new(full: (usize, usize), most: usize) -> Self {
        let size = within(full, most);
        let cells = (0..full.0).map(|x| x * size.0 / full.0).collect();
        Reduced { full, size, cells, next: (0, 0), sums: vec![[0; 3]; size.0 * size.1] }
    }

    /// Takes what follows, pixels by rows.
    pub fn push(&mut self, pixels: impl Iterator<Item = [u8; 3]>) {
        let ((width, height), (across, down)) = (self.full, self.size);
        let (mut x, mut y) = self.next;
        let mut row = y.min(height - 1) * down / height * across;
        for pixel in pixels {
            for (sum, v) in self.sums[row + self.cells[x]].iter_mut().zip(pixel) {
                *sum += u32::from(v);
            }
            x += 1;
            if x == width {
                (x, y) = (0, y + 1);
                row = y.min(height - 1) * down / height * across;
            }
        }
        self.next = (x, y);
    }

    /// The reduced picture; what was not seen is black.
    pub fn finish(&self) -> Plane<[u8; 3]> {
        let ((width, height), (across, down)) = (self.full, self.size);
        // The pixels of cell `i` of `cells`, of `n`: from the first that falls into it to the first of the next.
        let count = |i: usize, cells: usize, n: usize| ((i + 1) * n).div_ceil(cells) - (i * n).div_ceil(cells);
        Plane::from_rows(across, down, |y, row| {
            let rows = count(y, down, height);
            for (x, pixel) in row.iter_mut().enumerate() {
                let pixels = (rows * count(x, across, width)).max(1) as u32;
                *pixel = self.sums[y * across + x].map(|sum| ((sum + pixels / 2) / pixels).min(255) as u8);
            }
        })
    }
}

/// `frame` as it was photographed, at most `most` pixels on the long side; read in bands, so that one on disk need not fit into memory.
pub(super) fn frame(frame: &Frame, most: usize) -> Result<Plane<[u8; 3]>> {
    let mut reduced = Reduced::new((frame.width(), frame.height()), most);
    for first in (0..frame.height()).step_by(BAND_ROWS) {
        let window = frame.window(first..(first + BAND_ROWS).min(frame.height()))?;
        match window.codes() {
            Codes::Eight(codes) => reduced.push(codes.as_chunks::<3>().0.iter().copied()),
            Codes::Sixteen(codes) => {
                reduced.push(codes.as_chunks::<3>().0.iter().map(|p| p.map(|v| (v >> 8) as u8)));
            }
        }
    }
    Ok(reduced.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_means_in_whatever_parts_the_rows_come() {
        let (width, height) = (23, 17);
        let pixel = |i: usize| [(i % width * 10) as u8, (i / width * 12) as u8, 77];
        let pixels: Vec<[u8; 3]> = (0..width * height).map(pixel).collect();
        let mut reduced = Reduced::new((width, height), 7);
        for part in pixels.chunks(5 * width) {
            reduced.push(part.iter().copied());
        }
        let small = reduced.finish();
        assert_eq!((small.width(), small.height()), (7, 5));
        // The textbook: every pixel to its cell, the mean of each cell.
        for y in 0..5 {
            for x in 0..7 {
                let inside = |i: &usize| i % width * 7 / width == x && i / width * 5 / height == y;
                let mine: Vec<usize> = (0..pixels.len()).filter(inside).collect();
                let mean = |c: usize| {
                    let sum: usize = mine.iter().map(|&i| usize::from(pixels[i][c])).sum();
                    ((sum + mine.len() / 2) / mine.len()) as u8
                };
                assert_eq!(small.at(x, y), [mean(0), mean(1), mean(2)], "{x} {y}");
            }
        }
    }

    #[test]
    fn small_pictures_stay_as_they_are() {
        let mut reduced = Reduced::new((3, 2), 400);
        let pixels: Vec<[u8; 3]> = (0..6).map(|i| [i, 2 * i, 255 - i]).collect();
        reduced.push(pixels.iter().copied());
        assert_eq!(reduced.finish().as_slice(), pixels);
        assert_eq!((within((4000, 3000), 1400), within((3, 9000), 100)), ((1400, 1050), (1, 100)));
    }
}
