//! Evidence: how far a frame departs from the standard, beyond what noise, response and alignment allow.
//!
//! In: cells of the standard and of a frame. Out: 0..=1 for each cell, 1 where something else is shown. Cost: some 100 ns a cell.
//!
//! The difference of a cell and channel is divided by its standard deviation, of which the square is the sum of
//!
//! - the noise of both codes, through the curve's slope;
//! - a share of the radiance itself: at least `LEAST`, for the curve and the exposures are not known better, and as much as the bracket
//!   shows: the quartiles of the ratio of frame to standard at this level of radiance, over the whole picture. The ratio's median there is
//!   divided out first: it is the response's error, not motion;
//! - the gradient times `ASTRAY` pixels: what alignment and sharpness may differ by at an edge.
//!
//! A bound counts only where it is broken.

use super::cells::{Cell, Meaning};
use crate::plane::{Plane, fold_bands};

/// The least share of the radiance by which frames may differ.
const LEAST: f32 = 0.06;
/// ... and the greatest that is learnt from the bracket, so that a picture full of motion does not excuse it.
const MOST: f32 = 0.25;
/// The greatest factor that is divided out.
const MOST_BIAS: f32 = 1.5;
/// Pixels by which an edge may be astray.
const ASTRAY: f32 = 1.2;
/// Differences beyond so many standard deviations are no surer.
const ENOUGH: f32 = 8.0;
/// What the mean difference is multiplied by, from the smallest scale to the largest: means over more cells vary less.
const SCALES: [f32; 4] = [1.0, 1.2, 1.6, 2.0];

/// Levels of radiance, half a stop each.
const LEVELS: usize = 64;
/// Level of radiance 1.
const UNIT_LEVEL: f32 = 40.0;
/// Bins of the ratio of two radiances: floats that share exponent and first five bits, two stops to either side of 1.
const RATIOS: usize = 128;
const RATIO_SHIFT: u32 = 18;
/// Cells at a level for which what is learnt there counts half.
const FEW: f32 = 400.0;

/// About log2, exact at the powers of 2 and linear between: monotone, and the same on any machine.
#[inline]
fn log2_linear(x: f32) -> f32 {
    x.to_bits() as f32 * (1.0 / (1 << 23) as f32) - 127.0
}

/// At which level of radiance two cells are compared: by their geometric mean.
#[inline]
fn level(a: f32, b: f32) -> f32 {
    (log2_linear(a) + log2_linear(b) + UNIT_LEVEL).clamp(0.0, (LEVELS - 1) as f32)
}

/// What is learnt of a frame against the standard, by channel and level.
struct Usual {
    /// The median ratio of frame to standard.
    bias: [[f32; LEVELS]; 3],
    /// The ratio's standard deviation, by its quartiles.
    spread: [[f32; LEVELS]; 3],
}

impl Usual {
    fn of(standard: &Plane<Cell>, frame: &Plane<Cell>) -> Self {
        let bin = |c: usize, level: usize, ratio: usize| (c * LEVELS + level) * RATIOS + ratio;
        let first = (1.0f32.to_bits() >> RATIO_SHIFT) - RATIOS as u32 / 2;
        let counts = fold_bands(
            standard.height(),
            |rows| {
                let mut counts = vec![0u32; 3 * LEVELS * RATIOS];
                for (s, f) in standard.rows(rows.clone()).iter().zip(frame.rows(rows)) {
                    if s.is_outside() || f.is_outside() || s.clips() || f.clips() {
                        continue;
                    }
                    for c in (0..3).filter(|&c| !s.is_black(c) && !f.is_black(c)) {
                        let (a, b) = (s.radiance[c], f.radiance[c]);
                        let ratio = ((b / a).to_bits() >> RATIO_SHIFT).saturating_sub(first).min(RATIOS as u32 - 1);
                        counts[bin(c, level(a, b) as usize, ratio as usize)] += 1;
                    }
                }
                counts
            },
            vec![0u32; 3 * LEVELS * RATIOS],
            |mut all, part| {
                all.iter_mut().zip(part).for_each(|(a, b)| *a += b);
                all
            },
        );
        let mut usual = Usual { bias: [[1.0; LEVELS]; 3], spread: [[0.0; LEVELS]; 3] };
        for c in 0..3 {
            for level in 0..LEVELS {
                // The neighbours at half weight.
                let at = |level: usize, r: usize| f64::from(counts[bin(c, level, r)]);
                let smooth: Vec<f64> = (0..RATIOS)
                    .map(|r| {
                        let (below, above) = (level.max(1) - 1, (level + 1).min(LEVELS - 1));
                        at(level, r) + 0.5 * (at(below, r) + at(above, r))
                    })
                    .collect();
                let all: f64 = smooth.iter().sum();
                if all < 1.0 {
                    continue;
                }
                let rank = |share: f64| {
                    let mut below = 0.0;
                    let bin = smooth.iter().position(|count| {
                        below += count;
                        below >= share * all
                    });
                    let bits = (bin.unwrap_or(RATIOS - 1) as u32 + first) << RATIO_SHIFT | 1 << (RATIO_SHIFT - 1);
                    f32::from_bits(bits)
                };
                let (lower, median, upper) = (rank(0.25), rank(0.5), rank(0.75));
                let known = all as f32 / (all as f32 + FEW);
                usual.bias[c][level] = (1.0 + (median - 1.0) * known).clamp(1.0 / MOST_BIAS, MOST_BIAS);
                // The quartiles of the normal distribution lie 1.35 standard deviations apart.
                usual.spread[c][level] = ((upper - lower) / (1.35 * median)).min(MOST);
            }
        }
        usual
    }

    /// Bias and spread, between levels.
    #[inline]
    fn at(&self, c: usize, level: f32) -> (f32, f32) {
        // A level's bin holds what lies up to one above it.
        let level = (level - 0.5).max(0.0);
        let below = (level as usize).min(LEVELS - 2);
        let f = level - below as f32;
        let between = |t: &[f32; LEVELS]| t[below] + f * (t[below + 1] - t[below]);
        (between(&self.bias[c]), between(&self.spread[c]))
    }
}

/// The squares of the gradient at column `x` of the middle one of three rows, per cell: by central differences.
#[inline]
fn steepness([above, row, below]: [&[Cell]; 3], x: usize) -> [f32; 3] {
    let (left, right) = (&row[x.max(1) - 1].radiance, &row[(x + 1).min(row.len() - 1)].radiance);
    let (up, down) = (&above[x].radiance, &below[x].radiance);
    std::array::from_fn(|c| {
        let (dx, dy) = (right[c] - left[c], down[c] - up[c]);
        0.25 * (dx * dx + dy * dy)
    })
}

/// How far each cell of `frame` differs from `standard`, in standard deviations, brighter being positive.
fn differences(standard: &Plane<Cell>, frame: &Plane<Cell>, meanings: &[&Meaning], side: usize) -> Plane<[f32; 3]> {
    let usual = Usual::of(standard, frame);
    let (width, height) = (standard.width(), standard.height());
    let astray = (ASTRAY / side as f32) * (ASTRAY / side as f32);
    Plane::from_rows(width, height, |y, row| {
        let three = [y.max(1) - 1, y, (y + 1).min(height - 1)];
        let (of_standard, of_frame) = (three.map(|y| standard.row(y)), three.map(|y| frame.row(y)));
        for (x, out) in row.iter_mut().enumerate() {
            let (s, f) = (&of_standard[1][x], &of_frame[1][x]);
            if s.is_outside() || f.is_outside() {
                continue;
            }
            let (steep_s, steep_f) = (steepness(of_standard, x), steepness(of_frame, x));
            *out = std::array::from_fn(|c| {
                let (a, mut b) = (s.radiance[c], f.radiance[c]);
                let (bias, spread) = usual.at(c, level(a, b));
                if !s.is_bound(c) && !f.is_bound(c) {
                    b /= bias;
                }
                // Brighter than a clipped standard, darker than a black one; and the other way round for the frame.
                let within = match b > a {
                    true => s.is_clipped(c) || f.is_black(c),
                    false => s.is_black(c) || f.is_clipped(c),
                };
                if within {
                    return 0.0;
                }
                let share = LEAST.max(spread) * a.max(b);
                let (noise_a, noise_b) = (a * s.relative_noise(c, meanings), b * f.relative_noise(c, meanings));
                let edge = steep_s[c].max(steep_f[c]) * astray;
                let variance = share * share + noise_a * noise_a + noise_b * noise_b + edge;
                ((b - a) / variance.sqrt()).clamp(-ENOUGH, ENOUGH)
            });
        }
    })
}

/// The plane smoothed by (1, 4, 6, 4, 1) / 16 along both axes; the border stands for what is beyond. [`crate::pyramid::binomial`] is another:
/// of codes through a table, its sums taken from the outside in, which rounds otherwise.
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

/// The means of 2x2; at an odd border of what there is, which bitmaps ([`crate::pyramid::halve`]) drop.
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

/// 0..=1 for each cell: how surely `frame` shows something else than `standard`. `limits` are the standard deviations at which it begins
/// and is sure.
pub fn moved(
    standard: &Plane<Cell>,
    frame: &Plane<Cell>,
    meanings: &[&Meaning],
    side: usize,
    limits: (f32, f32),
) -> Plane<f32> {
    let mut mean = binomial(&differences(standard, frame, meanings, side));
    let mut levels = Vec::new();
    for scale in SCALES {
        if !levels.is_empty() {
            mean = binomial(&halved(&mean));
        }
        levels.push(Plane::from_rows(mean.width(), mean.height(), |y, row| {
            for (v, d) in row.iter_mut().zip(mean.row(y)) {
                let strength = scale * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
                *v = ((strength - limits.0) / (limits.1 - limits.0)).clamp(0.0, 1.0);
            }
        }));
    }
    // The strongest scale decides.
    let mut all = levels.pop();
    while let Some(finer) = levels.pop() {
        all = all.map(|coarse| stronger(&finer, &coarse));
    }
    all.unwrap_or_else(|| Plane::filled(standard.width(), standard.height(), 0.0))
}

/// The greater of `finer` and of `coarse`, which has half the size, interpolated.
fn stronger(finer: &Plane<f32>, coarse: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (finer.width(), finer.height());
    Plane::from_rows(width, height, |y, row| {
        let (above, below, fy) = super::place(y, 2, coarse.height());
        let (above, below) = (coarse.row(above), coarse.row(below));
        for (x, (v, here)) in row.iter_mut().zip(finer.row(y)).enumerate() {
            let (left, right, fx) = super::place(x, 2, coarse.width());
            let at = |line: &[f32]| line[left] + fx * (line[right] - line[left]);
            let (a, b) = (at(above), at(below));
            *v = here.max(a + fy * (b - a));
        }
    })
}

/// The greatest value within `reach` cells, smoothed by the binomial kernel.
pub fn widened(plane: &Plane<f32>, reach: usize) -> Plane<f32> {
    let (width, height) = (plane.width(), plane.height());
    let window = |i: usize, size: usize| i.saturating_sub(reach)..(i + reach + 1).min(size);
    let along = Plane::from_rows(width, height, |y, row| {
        let line = plane.row(y);
        for (x, v) in row.iter_mut().enumerate() {
            *v = line[window(x, width)].iter().fold(0.0, |a: f32, &b| a.max(b));
        }
    });
    let wide = Plane::from_rows(width, height, |y, row: &mut [f32]| {
        for line in window(y, height).map(|y| along.row(y)) {
            row.iter_mut().zip(line).for_each(|(v, &l)| *v = v.max(l));
        }
    });
    crate::pyramid::gaussian(&wide, 1.0)
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
            // Some ten roundings of values below 16.
            assert!((f64::from(fast.at(x as usize, y as usize)[1]) - sum).abs() < 1e-5);
        }
    }

    #[test]
    fn halves_keep_the_mean_and_the_odd_border() {
        let plane = Plane::from_vec(3, 1, vec![[1.0; 3], [3.0; 3], [8.0; 3]]);
        assert_eq!(halved(&plane).as_slice(), [[2.0; 3], [8.0; 3]]);
    }

    #[test]
    fn what_is_widened_covers_its_surroundings_and_no_more() {
        let mut plane = Plane::filled(40, 30, 0.0f32);
        plane.row_mut(15)[20] = 1.0;
        let wide = widened(&plane, 2);
        // Smoothed by a Gaussian of one cell: 4 cells further nothing is left.
        assert!(wide.at(20, 15) > 0.97 && wide.at(22, 15) > 0.6 && wide.at(27, 15) == 0.0);
        let sure = Plane::filled(9, 9, 1.0f32);
        assert!(widened(&sure, 2).as_slice().iter().all(|v| (v - 1.0).abs() < 1e-6));
    }

    #[test]
    fn the_rough_logarithm_is_exact_at_powers_of_two_and_monotone() {
        for e in -20..20 {
            assert_eq!(log2_linear(libm::exp2f(e as f32)), e as f32);
        }
        let x = |i: usize| libm::exp2f(i as f32 / 50.0 - 10.0);
        // Between powers it is below by at most 0.0861.
        assert!((1..1000).all(|i| log2_linear(x(i)) > log2_linear(x(i - 1))));
        assert!((0..1000).all(|i| (log2_linear(x(i)) - (i as f32 / 50.0 - 10.0)).abs() < 0.0862));
    }
}
