//! Demosaicing: three colours for each pixel of a Bayer mosaic.
//!
//! In: linear values of a mosaic. Out: [stretched](super::stretch) RGB, white balanced, 1 where they are clipped. Cost:
//! about a hundred operations for each pixel. Source: Pekkucuksen & Altunbasak, "Gradient Based Threshold Free Color
//! Filter Array Interpolation", ICIP 2010.
//!
//! The difference between green and the other colour of a row (or column) is estimated along rows and along columns.
//! At each red or blue pixel, it is averaged in four directions; a direction counts the less, the more the difference
//! changes there. So green is interpolated along edges and not across them. Red and blue follow from their differences
//! to green.
//!
//! The differences are those of stretched values: the green and the red of a leaf have the same ratio in its light and
//! in its shadow.
//!
//! A tile and all its intermediate values fit into the L2 cache. In a tile, a step of 1 goes to the next column and a
//! step of [`WIDTH`] to the next row. All loops run over whole tiles; values in the border of a tile are wrong, the
//! more the later they are computed, and are not used.

use super::Area;
use super::colour::Balance;
use super::pattern::Pattern;
use crate::plane::Plane;
use crate::simd::{Loops, at_most, vectorised};
use rayon::prelude::*;

/// Width of the border of a tile: the filters below reach 3 (red and blue), 2 (directions), 2 + 1 (changes) and 2
/// pixels (differences) far.
pub(super) const BORDER: usize = 12;
/// Columns and rows of a tile.
const COLUMNS: usize = 232;
const ROWS: usize = 128;
/// Columns with the border.
const WIDTH: usize = COLUMNS + 2 * BORDER;
/// Added to the sums of changes, so that they can be inverted.
const LEAST_CHANGE: f32 = 1e-4;

/// Interpolates the colours that the mosaic `linear` lacks in `area`; `encoded` converts each pixel.
pub(super) fn demosaic<T: Copy + Default + Send>(
    linear: &Plane<f32>,
    pattern: &Pattern,
    balance: Balance,
    area: Area,
    encoded: impl Fn([f32; 3]) -> T + Sync,
) -> Vec<T> {
    let mut pixels = vec![T::default(); area.width * area.height];
    pixels.par_chunks_mut(ROWS * area.width).enumerate().for_each_init(Tile::new, |tile, (band, out)| {
        for left in (0..area.width).step_by(COLUMNS) {
            let at = (area.left + left, area.top + band * ROWS);
            tile.interpolate(linear, pattern, balance, at, out.len() / area.width);
            for (y, row) in out.chunks_exact_mut(area.width).enumerate() {
                let columns = left..(left + COLUMNS).min(area.width);
                let [red, green, blue] = tile.row(y, pattern, at);
                for (x, pixel) in row[columns].iter_mut().enumerate() {
                    *pixel = encoded([red[x], green[x], blue[x]]);
                }
            }
        }
    });
    pixels
}

/// The index, within 0..`length`, at the same distance from the end on the other side of it. Mirrored pixels have the
/// same colour.
fn mirrored(i: isize, length: usize) -> usize {
    let last = length as isize - 1;
    if last == 0 {
        return 0;
    }
    let i = i.rem_euclid(2 * last);
    i.min(2 * last - i) as usize
}

/// A part of a mosaic with a border on all sides, and what is computed from it. Rows are [`WIDTH`] values long.
struct Tile {
    /// Stretched values of the mosaic.
    mosaic: Vec<f32>,
    /// 1 at green pixels, -1 at others.
    sign: Vec<f32>,
    /// Green minus the other colour, along rows and along columns.
    differences: [Vec<f32>; 2],
    /// 1 over the square of the change of the differences around, along rows and along columns.
    weights: [Vec<f32>; 2],
    /// Mean of the differences of five pixels, times their weight.
    means: [Vec<f32>; 2],
    scratch: [Vec<f32>; 2],
    /// Green minus the pixel's own colour: 0 at green pixels.
    difference: Vec<f32>,
    /// A row of red, green and blue.
    row: [[f32; COLUMNS]; 3],
}

impl Tile {
    fn new() -> Self {
        let empty = || vec![0.0; WIDTH * (ROWS + 2 * BORDER)];
        Tile {
            mosaic: empty(),
            sign: empty(),
            differences: [empty(), empty()],
            weights: [empty(), empty()],
            means: [empty(), empty()],
            scratch: [empty(), empty()],
            difference: empty(),
            row: [[0.0; COLUMNS]; 3],
        }
    }

    /// Computes the differences of the tile whose first pixel, without the border, is `left`, `top` of `linear`.
    fn interpolate(
        &mut self,
        linear: &Plane<f32>,
        pattern: &Pattern,
        balance: Balance,
        (left, top): (usize, usize),
        rows: usize,
    ) {
        let count = WIDTH * (rows + 2 * BORDER);
        let column = |x: usize| mirrored((left + x) as isize - BORDER as isize, linear.width());
        let is_inside = left >= BORDER && left - BORDER + WIDTH <= linear.width();
        let (mosaic, sign) = (&mut self.mosaic[..count], &mut self.sign[..count]);
        for (y, (mosaic, sign)) in mosaic.chunks_exact_mut(WIDTH).zip(sign.chunks_exact_mut(WIDTH)).enumerate() {
            let v = mirrored((top + y) as isize - BORDER as isize, linear.height());
            if is_inside {
                mosaic.copy_from_slice(&linear.row(v)[left - BORDER..][..WIDTH]);
            } else {
                mosaic.iter_mut().enumerate().for_each(|(x, m)| *m = linear.row(v)[column(x)]);
            }
            // Neighbours have two colours, in turn.
            let colours = [0, 1].map(|x| pattern.at(column(x), v));
            let signs = colours.map(|colour| if colour == 1 { 1.0 } else { -1.0 });
            sign.as_chunks_mut::<2>().0.fill(signs);
            vectorised(Stretched { mosaic, factors: colours.map(|colour| balance.factor(colour)), balance });
        }
        for (direction, step) in [1, WIDTH].into_iter().enumerate() {
            vectorised(Direction {
                step,
                mosaic: &self.mosaic[..count],
                sign: &self.sign[..count],
                differences: &mut self.differences[direction][..count],
                weights: &mut self.weights[direction][..count],
                means: &mut self.means[direction][..count],
                scratch: self.scratch.each_mut().map(|s| &mut s[..count]),
            });
        }
        vectorised(Combined {
            sign: &self.sign[..count],
            weights: self.weights.each_ref().map(|w| &w[..count]),
            means: self.means.each_ref().map(|m| &m[..count]),
            difference: &mut self.difference[..count],
        });
    }

    /// Returns red, green and blue of row `y` of the tile at `left`, `top`.
    fn row(&mut self, y: usize, pattern: &Pattern, (left, top): (usize, usize)) -> &[[f32; COLUMNS]; 3] {
        let first = (y + BORDER) * WIDTH + BORDER;
        // The other colour of the row.
        let colours = [0, 1].map(|x| pattern.at(left + x, top + y));
        let own = if colours[0] == 1 { colours[1] } else { colours[0] };
        let [red, green, blue] = &mut self.row;
        let (same, opposite) = if own == 0 { (red, blue) } else { (blue, red) };
        let (mosaic, sign, difference) = (&self.mosaic, &self.sign[first..], &self.difference);
        vectorised(Row { first, mosaic: &mosaic[first..], sign, difference, green, same, opposite });
        &self.row
    }
}

/// Stretches a row of a mosaic.
struct Stretched<'a> {
    mosaic: &'a mut [f32],
    /// Factors of white balance of even and of odd pixels.
    factors: [f32; 2],
    balance: Balance,
}

impl Loops for Stretched<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [even, odd] = self.factors;
        for pair in self.mosaic.as_chunks_mut::<2>().0 {
            (pair[0], pair[1]) = (pair[0] * even, pair[1] * odd);
        }
        for m in self.mosaic.iter_mut() {
            *m = self.balance.stretched(*m);
        }
    }
}

/// Computes the differences along one direction, their means and their weights.
struct Direction<'a> {
    /// Distance of neighbours.
    step: usize,
    mosaic: &'a [f32],
    sign: &'a [f32],
    differences: &'a mut [f32],
    weights: &'a mut [f32],
    means: &'a mut [f32],
    scratch: [&'a mut [f32]; 2],
}

/// The elements of `values` that are `by` before and after each of those from `margin` on to as many before the end.
#[inline(always)]
fn beside(values: &[f32], margin: usize, by: usize) -> [&[f32]; 2] {
    let count = values.len() - 2 * margin;
    [&values[margin - by..][..count], &values[margin + by..][..count]]
}

/// Writes the sums of five values, `step` apart.
#[inline(always)]
fn sums(values: &[f32], step: usize, out: &mut [f32]) {
    let margin = 2 * step;
    let count = values.len() - 2 * margin;
    let ([a, e], [b, d]) = (beside(values, margin, 2 * step), beside(values, margin, step));
    let (c, out) = (&values[margin..][..count], &mut out[margin..][..count]);
    for i in 0..count {
        out[i] = a[i] + b[i] + c[i] + d[i] + e[i];
    }
}

impl Loops for Direction<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Direction { step, mosaic, sign, differences, weights, means, scratch: [changes, along] } = self;
        let margin = 2 * step;
        let count = mosaic.len() - 2 * margin;
        let ([before, after], [far_before, far_after]) =
            (beside(mosaic, margin, step), beside(mosaic, margin, 2 * step));
        let (m, s, d) = (&mosaic[margin..][..count], &sign[margin..][..count], &mut differences[margin..][..count]);
        for i in 0..count {
            let between = 0.5 * (before[i] + after[i]);
            let bend = 0.25 * (2.0 * m[i] - far_before[i] - far_after[i]);
            d[i] = s[i] * (m[i] - (between + bend));
        }
        let count = mosaic.len() - 2 * step;
        let ([before, after], change) = (beside(differences, step, step), &mut changes[step..][..count]);
        for i in 0..count {
            change[i] = (before[i] - after[i]).abs();
        }
        sums(changes, 1, along);
        sums(along, WIDTH, changes);
        for (weight, change) in weights.iter_mut().zip(changes.iter()) {
            let change = change + LEAST_CHANGE;
            *weight = 1.0 / (change * change);
        }
        sums(differences, step, means);
        for (mean, weight) in means.iter_mut().zip(weights.iter()) {
            *mean *= 0.2 * weight;
        }
    }
}

/// The values two columns and two rows before and after each pixel but those of two rows at both ends, for values along
/// rows and along columns.
#[inline(always)]
fn around([along_rows, along_columns]: [&[f32]; 2]) -> [[&[f32]; 2]; 2] {
    [beside(along_rows, 2 * WIDTH, 2), beside(along_columns, 2 * WIDTH, 2 * WIDTH)]
}

/// Combines the four directions at red and blue pixels.
struct Combined<'a> {
    sign: &'a [f32],
    weights: [&'a [f32]; 2],
    means: [&'a [f32]; 2],
    difference: &'a mut [f32],
}

impl Loops for Combined<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let margin = 2 * WIDTH;
        let count = self.sign.len() - 2 * margin;
        // The means before a pixel are centred two pixels before it.
        let [[a, b], [c, d]] = around(self.weights);
        let [[e, f], [g, h]] = around(self.means);
        let (sign, difference) = (&self.sign[margin..][..count], &mut self.difference[margin..][..count]);
        for i in 0..count {
            let mean = (e[i] + f[i] + g[i] + h[i]) / (a[i] + b[i] + c[i] + d[i]);
            difference[i] = if sign[i] > 0.0 { 0.0 } else { mean };
        }
    }
}

/// Computes the colours of a row.
struct Row<'a> {
    /// Index of the first pixel of the row in `difference`; the other slices start there.
    first: usize,
    mosaic: &'a [f32],
    sign: &'a [f32],
    difference: &'a [f32],
    green: &'a mut [f32; COLUMNS],
    /// The colour of this row that is not green, and that of the next row.
    same: &'a mut [f32; COLUMNS],
    opposite: &'a mut [f32; COLUMNS],
}

impl Loops for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let at = |dx: isize, dy: isize| -> &[f32] {
            &self.difference[self.first.wrapping_add_signed(dy * WIDTH as isize + dx)..][..COLUMNS]
        };
        let (own, [left, right], [above, below]) = (at(0, 0), [at(-1, 0), at(1, 0)], [at(0, -1), at(0, 1)]);
        let near = [at(-1, -1), at(1, -1), at(-1, 1), at(1, 1)];
        let far = [at(-3, -1), at(3, -1), at(-3, 1), at(3, 1), at(-1, -3), at(1, -3), at(-1, 3), at(1, 3)];
        let (mosaic, sign) = (&self.mosaic[..COLUMNS], &self.sign[..COLUMNS]);
        for x in 0..COLUMNS {
            let green = mosaic[x] + own[x];
            // The filter of the paper, equation 10.
            let near = near[0][x] + near[1][x] + near[2][x] + near[3][x];
            let [a, b, c, d, e, f, g, h] = far;
            let far = a[x] + b[x] + c[x] + d[x] + e[x] + f[x] + g[x] + h[x];
            let across = green - (10.0 * near - far) * (1.0 / 32.0);
            let is_green = sign[x] > 0.0;
            let same = if is_green { green - 0.5 * (left[x] + right[x]) } else { mosaic[x] };
            let opposite = if is_green { green - 0.5 * (above[x] + below[x]) } else { across };
            self.green[x] = at_most(green, 1.0);
            self.same[x] = at_most(same, 1.0);
            self.opposite[x] = at_most(opposite, 1.0);
        }
    }
}

#[cfg(test)]
mod tests;
