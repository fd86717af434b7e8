//! From the grid to the pixels: what an operator found for cells, as a straight line in each place that takes a pixel's own luminance
//! to its tone.
//!
//! In: log2 luminance l and tone v of every cell. Out: for every place a and b of v = a l + b, so that edges and all detail finer than a cell
//! are the picture's own. Cost: 60 ns a cell; a pixel two linear interpolations. Source: He, Sun, Tang, "Guided Image Filtering" (2013),
//! section 3.1, equations 5 and 6, by which the ways of Kopf, Cohen, Lischinski, Uyttendaele, "Joint Bilateral Upsampling" (2007) to work
//! small and to show large become a straight line.

use crate::plane::Plane;
use crate::pyramid::cells::{Mix, between_cells};

/// The tone of every place: v = a l + b.
#[derive(Debug, Clone, PartialEq)]
pub struct Guide {
    /// Sides of a cell in pixels.
    side: usize,
    /// a and b of every cell; one cell stands for all places.
    lines: Plane<[f32; 2]>,
}

/// Cells on either side that a line is fitted to.
const REACH: usize = 2;

/// Variance of l, in square stops, from which on the fit is trusted rather than the slope of plain detail.
const TRUSTED: f32 = 0.02;

/// A line rises, and no steeper than this: detail is not blown up.
const STEEPEST: f32 = 1.5;

impl Guide {
    /// v = l + `shift` everywhere.
    pub fn shifted(shift: f64) -> Self {
        Guide { side: 1, lines: Plane::filled(1, 1, [1.0, shift as f32]) }
    }

    /// The lines on which the tones `tones` of cells of `side` pixels lie over their luminances `logs`; where a place is flat, detail keeps
    /// the contrast `detail`. Where cells are pixels it is `tones` itself.
    pub fn fitted(logs: &Plane<f32>, tones: &Plane<f32>, side: usize, detail: f32) -> Self {
        let (width, height) = (logs.width(), logs.height());
        if side == 1 || width * height == 1 {
            let line = |(&l, &v)| if side == 1 { [0.0, v] } else { [detail, v - detail * l] };
            let lines = logs.as_slice().iter().zip(tones.as_slice()).map(line).collect();
            return Guide { side, lines: Plane::from_vec(width, height, lines) };
        }
        // Equations 5 and 6 with the slope drawn to `detail` instead of 0.
        let moments = Plane::from_rows(width, height, |y, row| {
            for (m, (&l, &v)) in row.iter_mut().zip(logs.row(y).iter().zip(tones.row(y))) {
                *m = [l, v, l * l, l * v];
            }
        });
        let means = box_mean(&moments);
        let lines = Plane::from_rows(width, height, |y, row| {
            for (line, &[l, v, ll, lv]) in row.iter_mut().zip(means.row(y)) {
                let (variance, covariance) = ((ll - l * l).max(0.0), lv - l * v);
                let a = ((covariance + TRUSTED * detail) / (variance + TRUSTED)).clamp(0.0, STEEPEST);
                *line = [a, v - a * l];
            }
        });
        Guide { side, lines: box_mean(&lines) }
    }

    /// The lines that smooth `values` of cells of `side` pixels: where their variance is `half`, half of what differs from the surroundings is left; edges are
    /// kept. The guided filter of a picture by itself (section 3.2).
    pub fn smoothed(values: &Plane<f32>, side: usize, half: f32) -> Self {
        let (width, height) = (values.width(), values.height());
        let moments = Plane::from_rows(width, height, |y, row| {
            row.iter_mut().zip(values.row(y)).for_each(|(m, &v)| *m = [v, v * v]);
        });
        let means = box_mean(&moments);
        let lines = Plane::from_rows(width, height, |y, row| {
            for (line, &[v, vv]) in row.iter_mut().zip(means.row(y)) {
                let variance = (vv - v * v).max(0.0);
                let a = variance / (variance + half);
                *line = [a, v - a * v];
            }
        });
        Guide { side, lines: box_mean(&lines) }
    }

    /// The lines of row `y` of the picture, one for each column of cells, into `row`.
    pub fn row(&self, y: usize, row: &mut Vec<[f32; 2]>) {
        self.row_of(&self.lines, y, row);
    }

    /// What `plane`, which has the same cells, has at row `y` of the picture, for each column of cells, into `row`.
    pub fn row_of<T: Mix>(&self, plane: &Plane<T>, y: usize, row: &mut Vec<T>) {
        let (first, second, part) = between_cells(y, self.side, plane.height());
        row.clear();
        let pairs = plane.row(first).iter().zip(plane.row(second));
        row.extend(pairs.map(|(&p, &q)| p.towards(q, part as f32)));
        // One more, so that every column has a right neighbour.
        row.extend(row.last().copied());
    }

    /// Where in such a row each of `width` pixels lies: the cell, and the part of the way to the next one.
    pub fn columns(&self, width: usize) -> (Vec<u32>, Vec<f32>) {
        (0..width)
            .map(|x| {
                let (cell, _, part) = between_cells(x, self.side, self.lines.width());
                (cell as u32, part as f32)
            })
            .unzip()
    }
}

/// The means over squares of 2 REACH + 1 cells; the border cell stands for those beyond.
fn box_mean<const N: usize>(plane: &Plane<[f32; N]>) -> Plane<[f32; N]>
where
    [f32; N]: Default,
{
    let (width, height) = (plane.width(), plane.height());
    let side = (2 * REACH + 1) as f32;
    Plane::from_rows(width, height, |y, row| {
        let mut columns = vec![[0.0f32; N]; width + 2 * REACH];
        for j in 0..=2 * REACH {
            let from = plane.row((y + j).saturating_sub(REACH).min(height - 1));
            for (sum, v) in columns[REACH..].iter_mut().zip(from) {
                for i in 0..N {
                    sum[i] += v[i];
                }
            }
        }
        let (first, last) = (columns[REACH], columns[width + REACH - 1]);
        columns[..REACH].fill(first);
        columns[width + REACH..].fill(last);
        for (mean, window) in row.iter_mut().zip(columns.windows(2 * REACH + 1)) {
            *mean = std::array::from_fn(|i| window.iter().map(|c| c[i]).sum::<f32>() / (side * side));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scene with an edge and texture, on cells of 4 pixels, and tones that are a curve of it: at the pixels the curve comes back within a
    /// few hundredths of a stop; on the edge, 5 stops high, one line leaves the curve by up to 0.02 (5 / 2)^2 = 0.125.
    #[test]
    fn lines_carry_a_curve_to_the_pixels() {
        let pixel = |x: usize, y: usize| if x > 150 { 3.0 } else { -2.0 } + 0.3 * ((x * 5 + y * 3) as f32 * 0.1).sin();
        let curve = |l: f32| 0.5 * l + 0.02 * l * l;
        let logs = Plane::from_rows(75, 50, |cy, row| {
            for (cx, cell) in row.iter_mut().enumerate() {
                *cell = (0..16).map(|i| pixel(4 * cx + i % 4, 4 * cy + i / 4)).sum::<f32>() / 16.0;
            }
        });
        let tones = Plane::from_vec(75, 50, logs.as_slice().iter().map(|&l| curve(l)).collect());
        let guide = Guide::fitted(&logs, &tones, 4, 0.5);
        let (cells, parts) = guide.columns(300);
        let mut row = Vec::new();
        let mut worst = 0.0f32;
        for y in 0..200 {
            guide.row(y, &mut row);
            for x in 0..300 {
                let (p, q) = (row[cells[x] as usize], row[cells[x] as usize + 1]);
                let [a, b] = [0, 1].map(|i| p[i] + parts[x] * (q[i] - p[i]));
                let l = pixel(x, y);
                worst = worst.max((a * l + b - curve(l)).abs());
            }
        }
        assert!(worst < 0.1, "{worst}");
    }

    #[test]
    fn where_cells_are_pixels_tones_are_as_they_were_found() {
        let logs = Plane::from_rows(20, 10, |y, row| row.iter_mut().enumerate().for_each(|(x, l)| *l = (x * y) as f32));
        let tones =
            Plane::from_rows(20, 10, |y, row| row.iter_mut().enumerate().for_each(|(x, v)| *v = (x + y) as f32));
        let guide = Guide::fitted(&logs, &tones, 1, 1.0);
        let mut row = Vec::new();
        guide.row(7, &mut row);
        let (cells, parts) = guide.columns(20);
        assert!((0..20).all(|x| row[cells[x] as usize] == [0.0, (x + 7) as f32] && parts[x] == 0.0));
    }
}
