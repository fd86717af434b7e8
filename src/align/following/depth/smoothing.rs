//! Smoothing of labels by total generalised variation: planes in depth stay planes, and jumps stay sharp.
//!
//! In: the [`Choice`] of each pixel, and the reference. Out: a smooth label for each pixel. Cost: about sixty
//! operations for each pixel and iteration. Source: Bredies, Kunisch & Pock, "Total Generalized Variation", SIAM J.
//! Imaging Sciences 3(3), 2010; with weights at the edges of the picture as in Ranftl et al., "Pushing the Limits of
//! Stereo Using Variational Stereo Estimation", IV 2012; primal-dual iteration of Chambolle & Pock 2011.
//!
//! min over q and v of sum a1 w |grad q - v| + a0 |E v| + c |q - q0|: v is the slope of the surface, E v the
//! symmetrised derivative of v, w is small at edges of the picture, c is the certainty of the label q0.

use crate::align::following::depth::jumps::JUMP;
use crate::align::following::depth::semi_global::Choice;
use crate::plane::Plane;
use crate::simd::{Loops, at_least, at_most, vectorised};
use std::ops::Range;

/// Weight of a difference between the gradient and the slope, a1.
const GRADIENT: f32 = 1.0;
/// Weight of a change of the slope, a0.
const SLOPE: f32 = 4.0;
/// The weight w at an edge of d grey values is exp(-d / `EDGE`), plus [`LEAST_WEIGHT`].
const EDGE: f32 = 6.0;
const LEAST_WEIGHT: f32 = 0.02;
/// Number of iterations.
const ITERATIONS: usize = 90;
/// Step of the iteration: 1 / L, where L^2 = 12 bounds the squared norm of the derivatives.
const STEP: f32 = 0.288_675_13;

/// Returns the smooth labels of `choices`; `grey` is the reference.
pub(super) fn smooth(choices: &Plane<Choice>, grey: &Plane<u8>) -> Plane<f32> {
    let (width, height) = (choices.width(), choices.height());
    let weights = edge_weights(choices, grey);
    let [labels, certainties] = [choices.map(|c| c.label), choices.map(|c| c.certainty)];
    let mut primal = Plane::from_rows(width * PRIMAL, height, |y, row: &mut [f32]| {
        row[LABEL * width..][..width].copy_from_slice(labels.row(y));
        row[NEXT_LABEL * width..][..width].copy_from_slice(labels.row(y));
    });
    let mut dual = Plane::filled(width * DUAL, height, 0.0f32);
    let nothing = vec![0.0f32; width * DUAL];
    for _ in 0..ITERATIONS {
        dual.fill_rows(|y, row| {
            let (above, below) = (primal.row(y.saturating_sub(1)), primal.row((y + 1).min(height - 1)));
            vectorised(DualStep { here: primal.row(y), above, below, weights: weights.row(y), row });
        });
        primal.fill_rows(|y, row| {
            let above = if y > 0 { dual.row(y - 1) } else { &nothing };
            let below = if y + 1 < height { dual.row(y + 1) } else { &nothing };
            let (here, is_first) = (dual.row(y), y == 0);
            let chosen = [labels.row(y), certainties.row(y)];
            vectorised(PrimalStep { here, above, below, is_first, chosen, row });
        });
    }
    Plane::from_rows(width, height, |y, row| row.copy_from_slice(&primal.row(y)[LABEL * width..][..width]))
}

/// The weight w of each pixel, multiplied by [`GRADIENT`]. It is lower at jumps, so that all jumps cost the same.
fn edge_weights(choices: &Plane<Choice>, grey: &Plane<u8>) -> Plane<f32> {
    let weights: Vec<f32> = (0..=255u8).map(|d| GRADIENT * (libm::expf(-f32::from(d) / EDGE) + LEAST_WEIGHT)).collect();
    let (width, height) = (grey.width(), grey.height());
    Plane::from_rows(width, height, |y, row| {
        let next = (y + 1).min(height - 1);
        for (x, weight) in row.iter_mut().enumerate() {
            let right = (x + 1).min(width - 1);
            let here = grey.at(x, y);
            let edge = grey.at(right, y).abs_diff(here).max(grey.at(x, next).abs_diff(here));
            let label = choices.at(x, y).label;
            let jump = [choices.at(right, y), choices.at(x, next)].map(|c| (c.label - label).abs());
            *weight = weights[usize::from(edge)] * JUMP / jump[0].max(jump[1]).max(JUMP);
        }
    })
}

/// The variables of a row are in one slice: all labels, then all slopes in x, and so on. Primal variables: label q,
/// slope v, and their extrapolations.
const PRIMAL: usize = 6;
const LABEL: usize = 0;
const NEXT_LABEL: usize = 1;
/// Dual variables: of grad q - v (x, y), and of E v (xx, yy, xy).
const DUAL: usize = 5;

/// Returns the variables of a row.
#[inline(always)]
fn parts<const N: usize>(row: &[f32], width: usize) -> [&[f32]; N] {
    std::array::from_fn(|i| &row[i * width..][..width])
}

/// Returns the variables of a row, to change them.
#[inline(always)]
fn parts_mut<const N: usize>(mut row: &mut [f32], width: usize) -> [&mut [f32]; N] {
    std::array::from_fn(|_| {
        let (part, rest) = std::mem::take(&mut row).split_at_mut(width);
        row = rest;
        part
    })
}

/// Raises the dual variables of a row, and limits them.
struct DualStep<'a> {
    /// Primal variables of this row, and of the rows above and below; at the border, of this row again.
    here: &'a [f32],
    above: &'a [f32],
    below: &'a [f32],
    weights: &'a [f32],
    row: &'a mut [f32],
}

impl Loops for DualStep<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let weights = self.weights;
        let (width, last) = (weights.len(), weights.len() - 1);
        let [_, label, _, sx, _, sy] = parts::<PRIMAL>(self.here, width);
        let [_, _, _, above_sx, _, above_sy] = parts::<PRIMAL>(self.above, width);
        let [_, below, ..] = parts::<PRIMAL>(self.below, width);
        let [gx, gy, xx, yy, xy] = parts_mut::<DUAL>(self.row, width);
        let below = (!std::ptr::eq(self.here, self.below)).then_some(below);
        for (part, right) in [(0..last, Some(&label[1..])), (last..width, None)] {
            let of = |v| part_of(v, &part);
            let (gx, gy) = (&mut gx[part.clone()], &mut gy[part.clone()]);
            raise_gradients(of(label), right, below.map(of), [of(sx), of(sy)], of(weights), gx, gy);
        }
        for (part, left) in [(0..1, 0..1), (1..width, 0..last)] {
            let of = |v| part_of(v, &part);
            let slopes = [sx, sy].map(|v| [of(v), part_of(v, &left)]);
            let (xx, yy, xy) = (&mut xx[part.clone()], &mut yy[part.clone()], &mut xy[part.clone()]);
            raise_changes(slopes, [of(above_sx), of(above_sy)], xx, yy, xy);
        }
    }
}

/// The elements `part` of `v`.
#[inline(always)]
fn part_of<'a>(v: &'a [f32], part: &Range<usize>) -> &'a [f32] {
    &v[part.clone()]
}

/// Raises the dual variables of grad q - v. `right` and `below` are the labels of the neighbours; none at the border,
/// where there is no difference.
///
/// This and the following steps are functions with short loops, because long closures are not inlined and slices in one
/// row are not known to be separate; both would prevent vector instructions.
#[inline(always)]
fn raise_gradients(
    label: &[f32],
    right: Option<&[f32]>,
    below: Option<&[f32]>,
    [sx, sy]: [&[f32]; 2],
    weights: &[f32],
    gx: &mut [f32],
    gy: &mut [f32],
) {
    let count = gx.len();
    let [label, sx, sy, weights] = [label, sx, sy, weights].map(|v| &v[..count]);
    let [right, below] = [right, below].map(|v| v.map(|v| &v[..count]));
    let gy = &mut gy[..count];
    for x in 0..count {
        let across = right.map_or(0.0, |right| right[x] - label[x] - sx[x]);
        let along = below.map_or(0.0, |below| below[x] - label[x] - sy[x]);
        let (a, b) = (gx[x] + STEP * across, gy[x] + STEP * along);
        let excess = at_least((a * a + b * b).sqrt() / weights[x], 1.0);
        (gx[x], gy[x]) = (a / excess, b / excess);
    }
}

/// Raises the dual variables of E v. The slopes in x and in y are each given here and one pixel to the left, and
/// `above`.
#[inline(always)]
fn raise_changes(
    [[sx, left_sx], [sy, left_sy]]: [[&[f32]; 2]; 2],
    above: [&[f32]; 2],
    xx: &mut [f32],
    yy: &mut [f32],
    xy: &mut [f32],
) {
    let count = xx.len();
    let [sx, left_sx, sy, left_sy] = [sx, left_sx, sy, left_sy].map(|v| &v[..count]);
    let [above_sx, above_sy] = above.map(|v| &v[..count]);
    let (yy, xy) = (&mut yy[..count], &mut xy[..count]);
    for x in 0..count {
        let a = xx[x] + STEP * (sx[x] - left_sx[x]);
        let b = yy[x] + STEP * (sy[x] - above_sy[x]);
        let c = xy[x] + STEP * 0.5 * ((sx[x] - above_sx[x]) + (sy[x] - left_sy[x]));
        let excess = at_least((a * a + b * b + 2.0 * c * c).sqrt() / SLOPE, 1.0);
        (xx[x], yy[x], xy[x]) = (a / excess, b / excess, c / excess);
    }
}

/// Lowers the primal variables of a row.
struct PrimalStep<'a> {
    /// Dual variables of this row, and of the rows above and below; zeros outside of the picture.
    here: &'a [f32],
    above: &'a [f32],
    below: &'a [f32],
    /// Whether this is the first row.
    is_first: bool,
    /// The chosen labels, and their certainties.
    chosen: [&'a [f32]; 2],
    row: &'a mut [f32],
}

impl Loops for PrimalStep<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [chosen, certainty] = self.chosen;
        let (width, last) = (chosen.len(), chosen.len() - 1);
        let [gx, gy, xx, yy, xy] = parts::<DUAL>(self.here, width);
        let [_, above_gy, ..] = parts::<DUAL>(self.above, width);
        let [_, _, _, below_yy, below_xy] = parts::<DUAL>(self.below, width);
        let [label, next_label, sx, next_sx, sy, next_sy] = parts_mut::<PRIMAL>(self.row, width);
        for (part, left) in [(0..1, None), (1..width, Some(&gx[..last]))] {
            let of = |v| part_of(v, &part);
            let (label, next) = (&mut label[part.clone()], &mut next_label[part.clone()]);
            lower_labels([of(gx), of(gy)], left, of(above_gy), [of(chosen), of(certainty)], label, next);
        }
        // The adjoint of the backward differences: the first column and row have no difference to the one before.
        let row_counts = if self.is_first { 0.0 } else { 1.0 };
        let inner = 1.min(last)..last;
        for part in [0..inner.start, inner, last..width] {
            let of = |v| part_of(v, &part);
            let column_counts = if part.start == 0 { 0.0 } else { 1.0 };
            let right = |v| (part.end < width).then(|| part_of(v, &(part.start + 1..part.end + 1)));
            for (s, next, g, across, along, below) in
                [(&mut *sx, &mut *next_sx, gx, xx, xy, below_xy), (&mut *sy, &mut *next_sy, gy, xy, yy, below_yy)]
            {
                let across = (of(across), right(across), column_counts);
                let along = (of(along), of(below), row_counts);
                lower_slopes(of(g), across, along, &mut s[part.clone()], &mut next[part.clone()]);
            }
        }
    }
}

/// Lowers the labels: `left` is gx of the neighbours; none at the border. The certainty pulls the label towards the
/// chosen one.
#[inline(always)]
fn lower_labels(
    [gx, gy]: [&[f32]; 2],
    left: Option<&[f32]>,
    above_gy: &[f32],
    chosen: [&[f32]; 2],
    label: &mut [f32],
    next: &mut [f32],
) {
    let count = label.len();
    let [gx, gy, above_gy] = [gx, gy, above_gy].map(|v| &v[..count]);
    let [chosen, certainty] = chosen.map(|v| &v[..count]);
    let (left, next) = (left.map(|v| &v[..count]), &mut next[..count]);
    for x in 0..count {
        let moved = label[x] + STEP * (gx[x] - left.map_or(0.0, |left| left[x]) + gy[x] - above_gy[x]);
        let pull = STEP * certainty[x];
        let new = moved + at_least(at_most(chosen[x] - moved, pull), -pull);
        next[x] = 2.0 * new - label[x];
        label[x] = new;
    }
}

/// Lowers the slopes along one axis. `across` and `along` are the dual variables here and in the next column or row,
/// and a factor that is 0 where there is no difference to the column or row before. In the last column there is no next
/// one.
#[inline(always)]
fn lower_slopes(
    g: &[f32],
    across: (&[f32], Option<&[f32]>, f32),
    along: (&[f32], &[f32], f32),
    slope: &mut [f32],
    next: &mut [f32],
) {
    let count = slope.len();
    let [g, a, b, below] = [g, across.0, along.0, along.1].map(|v| &v[..count]);
    let (right, next) = (across.1.map(|v| &v[..count]), &mut next[..count]);
    for x in 0..count {
        let change = right.map_or(0.0, |right| right[x]) - across.2 * a[x] + below[x] - along.2 * b[x];
        let new = slope[x] + STEP * (g[x] + change);
        next[x] = 2.0 * new - slope[x];
        slope[x] = new;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::uniform;

    /// The derivatives as a matrix of f64, entry by entry: row, column, coefficient. Columns are the labels, then the
    /// slopes in x and in y; rows are the two parts of grad q - v, then xx, yy and xy of E v, pixel by pixel.
    fn derivatives(width: usize, height: usize) -> Vec<(usize, usize, f64)> {
        let pixels = width * height;
        let mut entries = Vec::new();
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let i = y * width + x;
            let [label, sx, sy] = [i, pixels + i, 2 * pixels + i];
            // Forward differences of labels, and nothing at the last column and row.
            if x + 1 < width {
                entries.extend([(i, label + 1, 1.0), (i, label, -1.0), (i, sx, -1.0)]);
            }
            if y + 1 < height {
                let row = pixels + i;
                entries.extend([(row, label + width, 1.0), (row, label, -1.0), (row, sy, -1.0)]);
            }
            // Backward differences of slopes, and 0 at the first column and row.
            let (xx, yy, xy) = (2 * pixels + i, 3 * pixels + i, 4 * pixels + i);
            if x > 0 {
                entries.extend([(xx, sx, 1.0), (xx, sx - 1, -1.0), (xy, sy, 0.5), (xy, sy - 1, -0.5)]);
            }
            if y > 0 {
                entries.extend([(yy, sy, 1.0), (yy, sy - width, -1.0), (xy, sx, 0.5), (xy, sx - width, -0.5)]);
            }
        }
        entries
    }

    /// The iteration of Chambolle & Pock 2011, algorithm 1 with theta = 1, with whole vectors. xy stands for two
    /// entries of a symmetric matrix, and counts twice in the scalar product.
    fn textbook(choices: &Plane<Choice>, weights: &Plane<f32>) -> Vec<f64> {
        let (width, height) = (choices.width(), choices.height());
        let (pixels, step) = (width * height, f64::from(STEP));
        let entries = derivatives(width, height);
        let chosen = choices.as_slice();
        let mut primal = vec![0.0f64; 3 * pixels];
        (0..pixels).for_each(|i| primal[i] = f64::from(chosen[i].label));
        let (mut extrapolated, mut dual) = (primal.clone(), vec![0.0f64; 5 * pixels]);
        for _ in 0..ITERATIONS {
            entries.iter().for_each(|&(row, column, k)| dual[row] += step * k * extrapolated[column]);
            for i in 0..pixels {
                let [gx, gy, xx, yy, xy] = std::array::from_fn(|k| dual[k * pixels + i]);
                let gradient = (gx * gx + gy * gy).sqrt() / f64::from(weights.as_slice()[i]);
                let change = (xx * xx + yy * yy + 2.0 * xy * xy).sqrt() / f64::from(SLOPE);
                (0..2).for_each(|k| dual[k * pixels + i] /= gradient.max(1.0));
                (2..5).for_each(|k| dual[k * pixels + i] /= change.max(1.0));
            }
            let before = primal.clone();
            for &(row, column, k) in &entries {
                let counts = if row >= 4 * pixels { 2.0 } else { 1.0 };
                primal[column] -= step * counts * k * dual[row];
            }
            for (label, choice) in primal.iter_mut().zip(chosen) {
                let pull = step * f64::from(choice.certainty);
                *label += (f64::from(choice.label) - *label).clamp(-pull, pull);
            }
            extrapolated = primal.iter().zip(&before).map(|(new, old)| 2.0 * new - old).collect();
        }
        primal.truncate(pixels);
        primal
    }

    #[test]
    fn smooth_labels_are_those_of_the_textbook() {
        for (width, height) in [(23, 17), (2, 9), (9, 2), (1, 5), (5, 1)] {
            let of = |seed: u64, x: usize, y: usize| uniform(seed, x as i64, y as i64) as f32;
            let choices = Plane::from_rows(width, height, |y, row: &mut [Choice]| {
                for (x, c) in row.iter_mut().enumerate() {
                    let label = if x + y < 15 { 2.0 + 0.2 * x as f32 } else { 11.0 };
                    *c = Choice { label: label + 2.0 * of(1, x, y), certainty: of(2, x, y) };
                }
            });
            let grey = Plane::from_rows(width, height, |y, row: &mut [u8]| {
                row.iter_mut().enumerate().for_each(|(x, v)| *v = (60.0 + 20.0 * of(3, x, y)) as u8);
            });
            let expected = textbook(&choices, &edge_weights(&choices, &grey));
            let found = smooth(&choices, &grey);
            for (i, (found, expected)) in found.as_slice().iter().zip(&expected).enumerate() {
                // Each of the 90 iterations adds about ten roundings of values below 16, of at most 1e-6 each. The
                // iteration does not enlarge errors.
                let error = (f64::from(*found) - expected).abs();
                assert!(error < 1e-3, "{width} x {height}, pixel {i}: {found} instead of {expected}");
            }
        }
    }
}
