//! Reduced pictures: averages over cells, taken as rows come by.
//!
//! In: rows of a picture, from the first to the last, in parts of any number. Out: the same picture in fewer pixels.
//! Cost: some ns a pixel, and
//! three bytes for each pixel of what comes out. Every pixel counts for the part of it that lies in a cell, in whole numbers, so that fine
//! patterns stay even whatever the factor. Codes are averaged as they are, which is good enough for a look.

use crate::align::resampling::{resample_rows, rows_under};
use crate::align::{Rect, Transform};
use crate::bracket::Frame;
use crate::error::Result;
use crate::plane::{BAND_ROWS, Plane};
use rayon::prelude::*;

/// Bands that are resampled at once.
const AT_ONCE: usize = 8;

/// A picture that is being reduced.
#[derive(Debug, Clone)]
pub(super) struct Reduced {
    full: (usize, usize),
    size: (usize, usize),
    /// The cell of each column, and how much of the column lies in it, of the cells' number; the rest lies in the next.
    columns: Vec<(usize, u32)>,
    /// Rows that have come.
    rows: usize,
    /// The last row of these, by cells.
    line: Vec<[u32; 3]>,
    /// The row of cells that is being summed.
    sums: Vec<[u64; 3]>,
    done: Vec<[u8; 3]>,
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

/// The size of a picture of `full` pixels that has at most about `most` altogether; what is larger by less than a fourth keeps its size, for so small
/// a reduction would only make it softer.
pub(super) fn within_pixels(full: (usize, usize), most: usize) -> (usize, usize) {
    let all = full.0 * full.1;
    if all <= most * 5 / 4 {
        return full;
    }
    let scale = (most as f64 / all as f64).sqrt();
    within(full, ((full.0.max(full.1) as f64 * scale) as usize).max(1))
}

/// The cell in which part `i` of `full` begins, of `cells`, and how much of it lies there, of `cells`.
fn share(i: usize, full: usize, cells: usize) -> (usize, usize) {
    let cell = i * cells / full;
    (cell, ((i + 1) * cells).min((cell + 1) * full) - i * cells)
}

impl Reduced {
    /// Of a picture of `full` pixels, to `size`, which is no larger.
    pub fn new(full: (usize, usize), size: (usize, usize)) -> Self {
        let column = |x| {
            let (cell, part) = share(x, full.0, size.0);
            (cell, part as u32)
        };
        let columns = (0..full.0).map(column).collect();
        let (line, sums) = (vec![[0; 3]; size.0 + 1], vec![[0; 3]; size.0]);
        Reduced { full, size, columns, rows: 0, line, sums, done: Vec::with_capacity(size.0 * size.1) }
    }

    /// Takes the next rows, which are whole.
    pub fn push(&mut self, pixels: &[[u8; 3]]) {
        for row in pixels.chunks_exact(self.full.0).take(self.full.1 - self.rows) {
            self.line.fill([0; 3]);
            let whole = self.size.0 as u32;
            for (pixel, &(cell, part)) in row.iter().zip(&self.columns) {
                for c in 0..3 {
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
                self.sums.fill([0; 3]);
                self.add((self.size.1 - part) as u64);
            }
        }
    }

    /// Adds the last row to the row of cells, so many times.
    fn add(&mut self, times: u64) {
        for (sum, v) in self.sums.iter_mut().zip(&self.line) {
            (0..3).for_each(|c| sum[c] += times * u64::from(v[c]));
        }
    }

    /// The reduced picture; what was not seen is black.
    pub fn finish(&self) -> Plane<[u8; 3]> {
        let mut done = self.done.clone();
        done.resize(self.size.0 * self.size.1, [0; 3]);
        Plane::from_vec(self.size.0, self.size.1, done)
    }
}

/// The part `region` of the reference as `frame` shows it, which lies as `warp` says, in `size` pixels; black where it
/// does not reach. Read in bands,
/// so that a frame on disk need not fit into memory.
pub(super) fn frame(frame: &Frame, warp: &Transform, region: Rect, size: (usize, usize)) -> Result<Plane<[u8; 3]>> {
    let (width, height) = (region.width(), region.height());
    let mut reduced = Reduced::new((width, height), size);
    let mut rows = vec![[0u8; 3]; width * height.min(AT_ONCE * BAND_ROWS)];
    for first in (0..height).step_by(AT_ONCE * BAND_ROWS) {
        let rows = &mut rows[..width * (height - first).min(AT_ONCE * BAND_ROWS)];
        let bands = rows.par_chunks_mut(BAND_ROWS * width).enumerate();
        bands.try_for_each_init(Vec::new, |codes, (band, to)| -> Result<()> {
            let y = region.y0 + first + band * BAND_ROWS;
            let (across, down) = (region.x0..region.x1, y..y + to.len() / width);
            let window = frame.window(rows_under(warp, (frame.width(), frame.height()), &across, &down))?;
            codes.resize(to.len(), [0.0f32; 3]);
            resample_rows(&window, warp, across, down, codes);
            to.iter_mut().zip(codes.iter()).for_each(|(to, p)| *to = p.map(|v| (v + 0.5).clamp(0.0, 255.0) as u8));
            Ok(())
        })?;
        reduced.push(rows);
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
        for size in [(7, 5), (16, 17), (1, 1)] {
            let mut reduced = Reduced::new((width, height), size);
            for part in pixels.chunks(5 * width) {
                reduced.push(part);
            }
            let small = reduced.finish();
            // The textbook: every pixel by the area of it that lies in the cell.
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
    fn small_pictures_stay_as_they_are() {
        let mut reduced = Reduced::new((3, 2), within((3, 2), 400));
        let pixels: Vec<[u8; 3]> = (0..6).map(|i| [i, 2 * i, 255 - i]).collect();
        reduced.push(&pixels);
        assert_eq!(reduced.finish().as_slice(), pixels);
        assert_eq!((within((4000, 3000), 1400), within((3, 9000), 100)), ((1400, 1050), (1, 100)));
        assert_eq!((within_pixels((4000, 3000), 3_000_000), within_pixels((30, 20), 500)), ((2000, 1500), (30, 20)));
    }
}
