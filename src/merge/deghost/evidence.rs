//! Evidence of motion: places where a frame differs from the standard by more than errors of noise, response and
//! alignment explain.
//!
//! In: cells of a frame, and cells of the standard that the frame is compared with. The standard is the reference
//! frame, or, where the reference is clipped, black or noisy, another frame that agrees with the reference. Out: for
//! each cell whether it moved. Cost: some 100 ns per cell, and 100 ns more for a cell that differs.
//!
//! The difference of a cell and channel is divided by its standard deviation: the root of the sum of the squares of
//!
//! - the noise of the code values of frame and standard, converted to radiance by the slope of the response;
//! - a share of the radiance, explained below;
//! - the gradient times some pixels, for errors of alignment and differences of sharpness at edges: see [`astray`].
//!
//! The share of the radiance is the sum of two terms. The first term is the radiance times the largest of these
//! fractions:
//!
//! - `LEAST`, because response and exposures are not known more exactly;
//! - in cells with a clipped channel, `SHIFTED`, because the camera mixes that channel into the other channels;
//! - the [usual](super::usual) spread of the ratio of frame to standard. (The usual bias of the ratio is divided out
//!   first.)
//!
//! The second term is `LEAST` times the difference between the brightest channel and this channel, because cameras and
//! JPEG mix the channels differently at each exposure.
//!
//! A clipped or black cell is only a bound of the radiance, and differs only if the bound is violated. Differences are
//! averaged over larger and larger cells, and the strongest of these means decides how much the cell differs. A cell
//! differs certainly if its difference reaches a limit that depends on the strength of deghosting. A connected region
//! of cells that differ by at least half of this limit has moved in either of two cases:
//!
//! - A cell in the region differs certainly, and its [structure](super::structure) differs too. In addition, the step
//!   of the ratio across the border is at least `EXPLAINED` times the limit.
//! - The border of the region is long, and the step of the ratio across the border is at least half of the limit.
//!
//! The step of the ratio across the border is a mean over the border cells of the region. For each border cell, it is
//! the largest change of the ratio of frame to standard from this cell to a neighbour, in standard deviations of the
//! change. (The limit is a number of standard deviations too.)

use super::cells::{Cell, Meaning};
use super::region;
use super::structure::{Ratio, Scales};
use super::usual::{Usual, level};
use crate::plane::Plane;
use crate::pyramid::cells::row_between_cells;
use crate::simd::log2;

/// A fraction with two uses. First: without motion, the standard deviation of a difference is at least this fraction of
/// the radiance. Second: the camera may mix this fraction of the brightest channel into another channel. The second use
/// matters for saturated colours: lamp light on wood has sixteen times as much red as blue, so 6 % of the red is as
/// much as all of the blue.
const LEAST: f32 = 0.06;
/// In cells with a clipped channel, the standard deviation of a difference is at least this fraction of the radiance.
/// It is larger than [`LEAST`], because the camera has mixed the clipped channel into the others. Measured on saturated
/// colours of four cameras.
const SHIFTED: f32 = 0.25;
/// Factor from a small relative difference to octaves: log2(1 + x) is about x log2(e).
const OCTAVES: f32 = std::f32::consts::LOG2_E;
/// Displacement of an edge, in pixels, that is expected without motion, because the frames differ in sharpness.
const BLURRED: f32 = 0.3;
/// How much farther an edge may be displaced than the estimated error of the alignment, which is a mean over the whole
/// picture.
const ASTRAY: f32 = 4.0;
/// An edge is displaced by at most this without motion, in pixels. Larger estimates of the error are due to motion.
const MOST_ASTRAY: f32 = 1.2;
/// Differences are limited to this many standard deviations.
const ENOUGH: f32 = 8.0;
/// Factor on the mean difference at each scale, from the smallest to the largest, because means over more cells vary
/// less.
const SCALES: [f32; 4] = [1.0, 1.2, 1.6, 2.0];
/// Largest factor by which the difference at one scale may exceed that at the next smaller scale. Without this limit,
/// cells beside a moving object would differ, because the mean at the larger scale includes the object.
const RAISE: f32 = 2.0;

/// A region has moved only if the ratio of frame to standard changes, from the border cells of the region to their
/// neighbours, by at least this on average. The unit is the difference at which a cell differs certainly: 4 standard
/// deviations at the default strength. So the mean change must be at least 1.2 standard deviations. On twelve rendered
/// brackets the mean change is 1.3 to 11 around motion, and 0.6 to 1.1 around walls of another colour and where
/// exposures are wrong.
const EXPLAINED: f32 = 0.3;
/// A region in which no cell differs certainly counts as moved only if it has at least this many border cells. Noise of
/// neighbouring cells is similar. Even if ten of them count as only one independent value, noise changes the mean over
/// this many cells by less than 0.2 standard deviations.
const LONG: usize = 100;

/// A frame, the standard that it is compared with, and the usual ratio of frame to standard.
struct Pair<'a> {
    standard: &'a Plane<Cell>,
    frame: &'a Plane<Cell>,
    meanings: &'a [&'a Meaning],
    /// Displacement of edges without motion, in cells.
    astray: f32,
    usual: Usual,
}

/// One channel of a cell, in the standard and in the frame.
struct Channel {
    /// First, the radiance of the standard. Second, the radiance of the frame divided by its usual bias.
    radiance: [f32; 2],
    /// The squares of the relative noise of the standard and of the frame.
    noise: [f32; 2],
    /// The usual spread of the ratio of frame to standard.
    spread: f32,
    /// Radiance that the camera may have mixed into this channel from the brightest channel.
    mixed: f32,
    /// Whether one of the two radiances is only a bound, and the other one is within that bound: then they do not
    /// contradict each other.
    is_within: bool,
}

impl Pair<'_> {
    #[inline]
    fn channel(&self, s: &Cell, f: &Cell, c: usize) -> Channel {
        let (a, mut b) = (s.radiance[c], f.radiance[c]);
        let (bias, spread) = self.usual.at(c, level(a, b));
        if !s.is_bound(c) && !f.is_bound(c) {
            b /= bias;
        }
        // A brighter frame agrees with the standard if the standard is clipped or the frame is black. A darker frame
        // agrees with it if the standard is black or the frame is clipped.
        let is_within = match b > a {
            true => s.is_clipped(c) || f.is_black(c),
            false => s.is_black(c) || f.is_clipped(c),
        };
        let mixed = LEAST * (brightest(s).max(brightest(f)) - a.max(b)).max(0.0);
        let noise = [s.relative_noise(c, self.meanings), f.relative_noise(c, self.meanings)];
        Channel { radiance: [a, b], noise: noise.map(|n| n * n), spread, mixed, is_within }
    }

    /// Returns by how many standard deviations each cell of the frame differs from the same cell of the standard, which
    /// the frame is compared with; positive if the frame is brighter.
    fn differences(&self) -> Plane<[f32; 3]> {
        let (width, height) = (self.standard.width(), self.standard.height());
        let astray = self.astray * self.astray;
        Plane::from_rows(width, height, |y, row| {
            let three = [y.max(1) - 1, y, (y + 1).min(height - 1)];
            let (of_standard, of_frame) = (three.map(|y| self.standard.row(y)), three.map(|y| self.frame.row(y)));
            for (x, out) in row.iter_mut().enumerate() {
                let (s, f) = (&of_standard[1][x], &of_frame[1][x]);
                if s.is_outside() || f.is_outside() {
                    continue;
                }
                let (steep_s, steep_f) = (steepness(of_standard, x), steepness(of_frame, x));
                let least = if s.clips() || f.clips() { SHIFTED } else { LEAST };
                *out = std::array::from_fn(|c| {
                    let Channel { radiance: [a, b], noise, spread, mixed, is_within } = self.channel(s, f, c);
                    if is_within {
                        return 0.0;
                    }
                    let share = least.max(spread) * a.max(b) + mixed;
                    let edge = steep_s[c].max(steep_f[c]) * astray;
                    let variance = share * share + a * a * noise[0] + b * b * noise[1] + edge;
                    ((b - a) / variance.sqrt()).clamp(-ENOUGH, ENOUGH)
                });
            }
        })
    }

    /// Returns for each cell log2 of the ratio of frame to standard, and its variance.
    fn ratios(&self) -> Plane<Ratio> {
        Plane::from_rows(self.standard.width(), self.standard.height(), |y, row: &mut [Ratio]| {
            for ((ratio, s), f) in row.iter_mut().zip(self.standard.row(y)).zip(self.frame.row(y)) {
                if s.is_outside() || f.is_outside() {
                    *ratio = Ratio::unknown();
                    continue;
                }
                // [`SHIFTED`] is doubled: the ratio itself is uncertain by this share, and at the edge between a
                // clipped cell and its neighbour the ratio is wrong by as much again.
                let least = if s.clips() || f.clips() { 2.0 * SHIFTED } else { 0.0 };
                for c in 0..3 {
                    let Channel { radiance: [a, b], noise, spread, mixed, is_within } = self.channel(s, f, c);
                    let usual = spread.max(least) + mixed / a.min(b);
                    ratio.standard[c] = log2(a);
                    ratio.ratio[c] = if is_within { 0.0 } else { log2(b / a) };
                    ratio.variance[c] = (noise[0] + noise[1] + usual * usual) * OCTAVES * OCTAVES;
                }
            }
        })
    }
}

/// Returns the radiance of the brightest channel.
#[inline]
fn brightest(cell: &Cell) -> f32 {
    cell.radiance.iter().copied().fold(0.0, f32::max)
}

/// Returns the square of the gradient of each channel at column `x` of the middle row, by central differences, in
/// radiance per cell.
#[inline]
fn steepness([above, row, below]: [&[Cell]; 3], x: usize) -> [f32; 3] {
    let (left, right) = (&row[x.max(1) - 1].radiance, &row[(x + 1).min(row.len() - 1)].radiance);
    let (up, down) = (&above[x].radiance, &below[x].radiance);
    std::array::from_fn(|c| {
        let (dx, dy) = (right[c] - left[c], down[c] - up[c]);
        0.25 * (dx * dx + dy * dy)
    })
}

/// Returns the plane filtered by (1, 4, 6, 4, 1) / 16 along both axes, with the border repeated.
/// [`crate::pyramid::binomial`] filters code values by a table and rounds differently.
fn binomial(plane: &Plane<[f32; 3]>) -> Plane<[f32; 3]> {
    let (width, height) = (plane.width(), plane.height());
    let near = |i: usize, d: usize, size: usize| (i + d).saturating_sub(2).min(size - 1);
    const WEIGHTS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
    let mut smooth = Plane::filled(width, height, [0.0f32; 3]);
    smooth.fill_bands(|rows, band| {
        let mut column = vec![[0.0f32; 3]; width + 4];
        for (y, out) in rows.zip(band.chunks_exact_mut(width)) {
            column.fill([0.0; 3]);
            for (d, w) in WEIGHTS.iter().enumerate() {
                for (sum, v) in column[2..].iter_mut().zip(plane.row(near(y, d, height))) {
                    for c in 0..3 {
                        sum[c] += w * v[c];
                    }
                }
            }
            let (first, last) = (column[2], column[width + 1]);
            column[..2].fill(first);
            column[width + 2..].fill(last);
            for (o, taps) in out.iter_mut().zip(column.windows(5)) {
                *o = std::array::from_fn(|c| (0..5).map(|d| WEIGHTS[d] * taps[d][c]).sum());
            }
        }
    });
    smooth
}

/// Returns the means of 2x2 cells. If the width or height is odd, the last column or row is paired with itself
/// ([`crate::pyramid::halve`] ignores it instead).
fn halved(plane: &Plane<[f32; 3]>) -> Plane<[f32; 3]> {
    let (width, height) = (plane.width(), plane.height());
    Plane::from_rows(width.div_ceil(2), height.div_ceil(2), |y, row| {
        let (upper, lower) = (plane.row(2 * y), plane.row((2 * y + 1).min(height - 1)));
        for (x, v) in row.iter_mut().enumerate() {
            let (l, r) = (2 * x, (2 * x + 1).min(width - 1));
            *v = std::array::from_fn(|c| 0.25 * (upper[l][c] + upper[r][c] + lower[l][c] + lower[r][c]));
        }
    })
}

/// The displacement of an edge, in pixels, that is expected without motion, if `error_px` is the estimated error of the
/// alignment; none if it was not estimated.
pub fn astray(error_px: Option<f64>) -> f32 {
    let error = error_px.map_or(MOST_ASTRAY, |px| ASTRAY * px as f32);
    (BLURRED * BLURRED + error * error).sqrt().min(MOST_ASTRAY)
}

/// Returns for each cell whether `frame` shows something else than `standard`. `astray` is the displacement of edges
/// without motion, in cells. `limits` are two thresholds in standard deviations: a cell that reaches the first may have
/// moved; a cell that reaches the second differs certainly.
pub fn moved(
    standard: &Plane<Cell>,
    frame: &Plane<Cell>,
    meanings: &[&Meaning],
    astray: f32,
    limits: (f32, f32),
) -> Plane<bool> {
    let pair = Pair { standard, frame, meanings, astray, usual: Usual::of(standard, frame) };
    let strengths = strengths(&pair.differences());
    let (width, height) = (strengths.width(), strengths.height());
    let reach = |least: f32| {
        Plane::from_rows(width, height, |y, row: &mut [bool]| {
            row.iter_mut().zip(strengths.row(y)).for_each(|(is, strength)| *is = *strength >= least);
        })
    };
    let differs = reach(limits.1);
    if !differs.as_slice().contains(&true) {
        return differs;
    }
    let scales = Scales::of(pair.ratios());
    let is_mover = |part: &[(usize, usize)], plane: &Plane<bool>| {
        let border: Vec<_> = part.iter().copied().filter(|&at| region::is_border(plane, at)).collect();
        let mean = scales.mean(&border);
        let is_sure = || part.iter().any(|&(x, y)| differs.at(x, y) && scales.is_changed((x, y), limits.1));
        border.len() >= LONG && mean >= limits.0 || mean >= EXPLAINED * limits.1 && is_sure()
    };
    let mut moved = Plane::filled(width, height, false);
    let mut rest = Plane::filled(width, height, false);
    let may = reach(limits.0);
    for part in region::parts(&may) {
        let is_mover = is_mover(&part, &may);
        let plane = if is_mover { &mut moved } else { &mut rest };
        part.iter().filter(|&&(x, y)| is_mover || differs.at(x, y)).for_each(|&(x, y)| plane.row_mut(y)[x] = true);
    }
    // In a region that did not move as a whole, the parts that differ certainly are tested separately: a moving object
    // may be in front of a wide and faint difference.
    for part in region::parts(&rest).into_iter().filter(|part| is_mover(part, &rest)) {
        part.iter().for_each(|&(x, y)| moved.row_mut(y)[x] = true);
    }
    moved
}

/// Returns the difference of each cell, in standard deviations, combined over the channels, at the scale where it is
/// largest.
fn strengths(differences: &Plane<[f32; 3]>) -> Plane<f32> {
    let mut mean = binomial(differences);
    let mut levels = Vec::new();
    for scale in SCALES {
        if !levels.is_empty() {
            mean = binomial(&halved(&mean));
        }
        levels.push(Plane::from_rows(mean.width(), mean.height(), |y, row| {
            for (v, d) in row.iter_mut().zip(mean.row(y)) {
                *v = scale * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            }
        }));
    }
    let coarsest = levels.pop();
    let all = levels.into_iter().rev().fold(coarsest, |coarse, finer| coarse.map(|coarse| stronger(&finer, &coarse)));
    all.unwrap_or_else(|| Plane::filled(differences.width(), differences.height(), 0.0))
}

/// Returns the maximum of `finer` and the interpolated `coarse`, which has half the size. The result is at most
/// [`RAISE`] times `finer`.
fn stronger(finer: &Plane<f32>, coarse: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (finer.width(), finer.height());
    Plane::from_rows(width, height, |y, row| {
        row_between_cells(coarse, 2, |v| v, y, row);
        row.iter_mut().zip(finer.row(y)).for_each(|(v, here)| *v = here.max(v.min(RAISE * here)));
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(width: usize, height: usize) -> Plane<[f32; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = std::array::from_fn(|c| ((x * 31 + y * 17 + c * 7) % 29) as f32 - 14.0);
            }
        })
    }

    #[test]
    fn the_binomial_agrees_with_the_double_sum() {
        let (w, h) = (19isize, 131isize);
        let plane = noise(w as usize, h as usize);
        let fast = binomial(&plane);
        for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
            let mut sum = 0.0;
            for (j, wy) in (-2..).zip([1.0, 4.0, 6.0, 4.0, 1.0]) {
                for (i, wx) in (-2..).zip([1.0, 4.0, 6.0, 4.0, 1.0]) {
                    let at = plane.at((x + i).clamp(0, w - 1) as usize, (y + j).clamp(0, h - 1) as usize);
                    sum += wx * wy / 256.0 * f64::from(at[1]);
                }
            }
            // The tolerance allows for the rounding errors of some ten operations on values below 16.
            assert!((f64::from(fast.at(x as usize, y as usize)[1]) - sum).abs() < 1e-5);
        }
    }

    #[test]
    fn edges_may_be_displaced_more_if_the_alignment_is_uncertain() {
        // sqrt(0.3^2 + (4 x 0.1)^2) = 0.5, and never more than 1.2.
        assert!((astray(Some(0.1)) - 0.5).abs() < 1e-6);
        assert_eq!([Some(0.0), Some(5.0), None].map(astray), [0.3, 1.2, 1.2]);
    }

    #[test]
    fn halves_keep_the_mean_and_the_odd_border() {
        let plane = Plane::from_vec(3, 1, vec![[1.0; 3], [3.0; 3], [8.0; 3]]);
        assert_eq!(halved(&plane).as_slice(), [[2.0; 3], [8.0; 3]]);
    }
}
