//! Scaling: reduces pictures by averaging over cells, row by row.
//!
//! In: rows of a picture of any number of channels, from first to last, in parts of any size. Out: the same picture
//! with fewer pixels. Cost: some ns per pixel, and one byte of memory for each output value. In the mean of a cell,
//! every pixel is weighted by the part of the pixel that is inside the cell. So fine patterns become a uniform area,
//! without moiré, for any reduction factor. Code values are averaged directly (not the light), which is accurate enough
//! for viewing.

use crate::plane::Plane;
use std::ops::Range;

/// A reduction of a picture with `N` channels.
#[derive(Debug, Clone)]
pub struct Reduced<const N: usize> {
    full: (usize, usize),
    size: (usize, usize),
    /// For each column of the picture: the first cell that the column overlaps, and the part of the column in that
    /// cell, multiplied by the number of cells so that it is an integer. The rest of the column is in the next cell.
    columns: Vec<(usize, u32)>,
    /// Number of rows that were received.
    rows: usize,
    /// The row that was received last, summed over the columns of each cell.
    line: Vec<[u32; N]>,
    /// The row of cells that is being summed.
    sums: Vec<[u64; N]>,
    done: Vec<[u8; N]>,
}

/// Returns the size of a picture of `full` (width, height) after reduction to at most `most` pixels along its long
/// side.
pub fn within(full: (usize, usize), most: usize) -> (usize, usize) {
    let long = full.0.max(full.1);
    if long <= most {
        return full;
    }
    let side = |n: usize| ((n * most + long / 2) / long).max(1);
    (side(full.0), side(full.1))
}

/// Returns the size of a picture of `full` (width, height) after reduction to a total of at most about `most` pixels.
/// A picture that exceeds `most` by at most a fourth keeps its size, because such a small reduction would only blur
/// it.
pub fn within_pixels(full: (usize, usize), most: usize) -> (usize, usize) {
    let all = full.0 * full.1;
    if all <= most * 5 / 4 {
        return full;
    }
    let scale = (most as f64 / all as f64).sqrt();
    within(full, ((full.0.max(full.1) as f64 * scale) as usize).max(1))
}

/// Scaling by integer factors: `by` x `by` pixels become one, or one becomes `times` x `times`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cells {
    /// Reduction factor: a block of `by` x `by` pixels becomes one pixel.
    pub by: usize,
    /// Enlargement factor: a pixel becomes a block of `times` x `times` pixels.
    pub times: usize,
}

impl Cells {
    /// Returns the integer factors for a picture whose long side should have between `least` and `most` pixels. A
    /// longer side is reduced by the smallest factor that suffices. A shorter side is enlarged by the largest factor
    /// that does not exceed `least`.
    pub fn within((width, height): (usize, usize), least: usize, most: usize) -> Cells {
        let side = width.max(height).max(1);
        Cells { by: side.div_ceil(most), times: (least / side).max(1) }
    }

    /// Returns the scaled size of a picture of `width` x `height` pixels.
    pub fn size(self, (width, height): (usize, usize)) -> (usize, usize) {
        (width.div_ceil(self.by) * self.times, height.div_ceil(self.by) * self.times)
    }

    /// Scales a picture of `size` pixels; `cell` returns the colour of a range of columns and rows.
    pub fn picture(
        self,
        size: (usize, usize),
        cell: impl Fn(Range<usize>, Range<usize>) -> [u8; 3] + Sync,
    ) -> Plane<[u8; 3]> {
        let (across, down) = self.size(size);
        Plane::from_rows(across, down, |y, row| {
            let pixels = |i: usize, n: usize| {
                let first = i / self.times * self.by;
                first..(first + self.by).min(n)
            };
            let rows = pixels(y, size.1);
            row.iter_mut().enumerate().for_each(|(x, v)| *v = cell(pixels(x, size.0), rows.clone()));
        })
    }
}

/// Divides `full` pixels in a line into `cells` cells of equal length. Returns the cell in which pixel `i` begins,
/// and the part of the pixel in that cell, multiplied by `cells` so that it is an integer.
fn share(i: usize, full: usize, cells: usize) -> (usize, usize) {
    let cell = i * cells / full;
    (cell, ((i + 1) * cells).min((cell + 1) * full) - i * cells)
}

impl<const N: usize> Reduced<N> {
    /// Creates a reduction from `full` pixels to `size`, which is not larger.
    pub fn new(full: (usize, usize), size: (usize, usize)) -> Self {
        let column = |x| {
            let (cell, part) = share(x, full.0, size.0);
            (cell, part as u32)
        };
        let columns = (0..full.0).map(column).collect();
        let (line, sums) = (vec![[0; N]; size.0 + 1], vec![[0; N]; size.0]);
        Reduced { full, size, columns, rows: 0, line, sums, done: Vec::with_capacity(size.0 * size.1) }
    }

    /// Adds the next complete rows.
    pub fn push(&mut self, pixels: &[[u8; N]]) {
        for row in pixels.chunks_exact(self.full.0).take(self.full.1 - self.rows) {
            self.line.fill([0; N]);
            let whole = self.size.0 as u32;
            for (pixel, &(cell, part)) in row.iter().zip(&self.columns) {
                for c in 0..N {
                    self.line[cell][c] += part * u32::from(pixel[c]);
                    self.line[cell + 1][c] += (whole - part) * u32::from(pixel[c]);
                }
            }
            let (cell, part) = share(self.rows, self.full.1, self.size.1);
            self.add(part as u64);
            self.rows += 1;
            if self.rows * self.size.1 >= (cell + 1) * self.full.1 {
                let all = (self.full.0 * self.full.1) as u64;
                self.done.extend(self.sums.iter().map(|sum| sum.map(|v| ((v + all / 2) / all) as u8)));
                self.sums.fill([0; N]);
                self.add((self.size.1 - part) as u64);
            }
        }
    }

    /// Adds the row that was received last, multiplied by `times`, to the current row of cells.
    fn add(&mut self, times: u64) {
        for (sum, v) in self.sums.iter_mut().zip(&self.line) {
            (0..N).for_each(|c| sum[c] += times * u64::from(v[c]));
        }
    }

    /// Returns the reduced picture; parts for which no rows were received are black.
    pub fn finish(&self) -> Plane<[u8; N]> {
        let mut done = self.done.clone();
        done.resize(self.size.0 * self.size.1, [0; N]);
        Plane::from_vec(self.size.0, self.size.1, done)
    }
}

/// Reduces a plane to at most `most` (width, height), by area averages and with the same factor in both directions. A
/// plane that is small enough is returned unchanged. Sums are floats, so a mean of exactly n + 1/2 may be rounded up
/// or down, while [`reduce_to`] always rounds it up.
pub fn reduce(plane: &Plane<u8>, most: (usize, usize)) -> Plane<u8> {
    let (w, h) = (plane.width(), plane.height());
    let share = (most.0 as f64 / w as f64).min(most.1 as f64 / h as f64);
    if share >= 1.0 {
        return plane.clone();
    }
    let size = |n: usize| ((n as f64 * share).round() as usize).max(1);
    let (width, height) = (size(w), size(h));
    let (step_x, step_y) = (w as f64 / width as f64, h as f64 / height as f64);
    Plane::from_rows(width, height, |y, row| {
        let rows = parts(y, step_y, h);
        for (x, v) in row.iter_mut().enumerate() {
            let columns = parts(x, step_x, w);
            let mut sum = 0.0;
            for &(j, wy) in &rows {
                let line = plane.row(j);
                sum += wy * columns.iter().map(|&(i, wx)| wx * f64::from(line[i])).sum::<f64>();
            }
            *v = (sum / (step_x * step_y)).round() as u8;
        }
    })
}

/// Returns the pixels of a line of `n` pixels that cell `i` overlaps, where a cell has a length of `step` pixels: the
/// index of each pixel, and the fraction of the pixel that is inside the cell.
fn parts(i: usize, step: f64, n: usize) -> Vec<(usize, f64)> {
    let (from, to) = (i as f64 * step, (i + 1) as f64 * step);
    let last = (to.ceil() as usize).min(n);
    (from as usize..last).map(|k| (k, (to.min(k as f64 + 1.0) - from.max(k as f64)).max(0.0))).collect()
}

/// Reduces a grey picture to `size`, which must not be larger than the picture.
pub fn reduce_to(plane: &Plane<u8>, size: (usize, usize)) -> Plane<u8> {
    let mut reduced = Reduced::new((plane.width(), plane.height()), size);
    reduced.push(plane.as_slice().as_chunks::<1>().0);
    Plane::from_vec(size.0, size.1, reduced.finish().into_vec().into_flattened())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_means_in_whatever_parts_the_rows_come() {
        let (width, height) = (23, 17);
        let pixel = |i: usize| [(i % width * 10) as u8, (i / width * 12) as u8, 77];
        let pixels: Vec<[u8; 3]> = (0..width * height).map(pixel).collect();
        for size in [(7, 5), (16, 17), (1, 1)] {
            let mut reduced = Reduced::new((width, height), size);
            for part in pixels.chunks(5 * width) {
                reduced.push(part);
            }
            let small = reduced.finish();
            // The definition: the mean of all pixels, each weighted by its area in the cell.
            let overlap = |i: usize, full: usize, cell: usize, cells: usize| {
                let (from, to) = (i as f64 / full as f64, (i + 1) as f64 / full as f64);
                let (left, right) = (cell as f64 / cells as f64, (cell + 1) as f64 / cells as f64);
                (to.min(right) - from.max(left)).max(0.0)
            };
            for (y, x) in (0..size.1).flat_map(|y| (0..size.0).map(move |x| (y, x))) {
                let area = |i: usize| overlap(i % width, width, x, size.0) * overlap(i / width, height, y, size.1);
                let all: f64 = (0..width * height).map(area).sum();
                for c in 0..3 {
                    let sum: f64 = (0..width * height).map(|i| area(i) * f64::from(pixels[i][c])).sum();
                    let off = (f64::from(small.at(x, y)[c]) - sum / all).abs();
                    assert!(off < 0.5 + 1e-6, "{size:?} {x} {y} {c}: {off}");
                }
            }
        }
    }

    #[test]
    fn small_pictures_are_unchanged() {
        let mut reduced = Reduced::new((3, 2), within((3, 2), 400));
        let pixels: Vec<[u8; 3]> = (0..6).map(|i| [i, 2 * i, 255 - i]).collect();
        reduced.push(&pixels);
        assert_eq!(reduced.finish().as_slice(), pixels);
        assert_eq!((within((4000, 3000), 1400), within((3, 9000), 100)), ((1400, 1050), (1, 100)));
        assert_eq!((within_pixels((4000, 3000), 3_000_000), within_pixels((30, 20), 500)), ((2000, 1500), (30, 20)));
    }

    #[test]
    fn areas_keep_their_mean() {
        let plane = Plane::from_rows(30, 20, |y, row| (0..30).for_each(|x| row[x] = (7 * x + 3 * y) as u8));
        let small = reduce(&plane, (11, 100));
        assert_eq!((small.width(), small.height()), (11, 7));
        let mean = |p: &Plane<u8>| p.as_slice().iter().map(|&v| f64::from(v)).sum::<f64>() / p.as_slice().len() as f64;
        // Each value is rounded by at most a half in either direction, so the errors of the 77 values cancel in the
        // mean.
        assert!((mean(&plane) - mean(&small)).abs() < 0.2);
        assert_eq!(reduce(&plane, (30, 20)), plane);
        // In a picture that is linear in x and y, the mean of a cell is the value at the centre of the cell. Cell x
        // has its centre at (x + 1/2) 30/11 - 1/2.
        let expected = 7.0 * (5.5 * 30.0 / 11.0 - 0.5) + 3.0 * (3.5 * 20.0 / 7.0 - 0.5);
        assert!((f64::from(small.at(5, 3)) - expected).abs() <= 0.51);
    }

    #[test]
    fn panels_fit_and_lose_no_pixel() {
        assert_eq!(Cells::within((4000, 3000), 360, 1200), Cells { by: 4, times: 1 });
        assert_eq!(Cells::within((4000, 3000), 360, 1200).size((4000, 2999)), (1000, 750));
        assert_eq!(Cells::within((60, 100), 360, 1200).size((60, 100)), (180, 300));
        // `cell` receives every pixel, so that a single pixel of a 4 x 4 block can be made visible.
        let fit = Cells { by: 4, times: 1 };
        let panel = fit.picture((9, 8), |columns, rows| {
            [u8::from(columns.contains(&8) && rows.contains(&3)), columns.len() as u8, rows.len() as u8]
        });
        assert_eq!((panel.width(), panel.height()), (3, 2));
        assert_eq!((panel.at(2, 0), panel.at(0, 1)), ([1, 1, 4], [0, 4, 4]));
    }
}
