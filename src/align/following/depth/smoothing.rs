//! Smoothing of labels by total generalised variation: planes in depth stay planes, and jumps stay sharp.
//!
//! In: the [`Choice`] of each pixel, and the reference. Out: a smooth label for each pixel. Cost: about sixty
//! operations for each pixel and iteration. Source: Bredies, Kunisch & Pock, "Total Generalized Variation", SIAM J.
//! Imaging Sciences 3(3), 2010; with weights at the edges of the picture as in Ranftl et al., "Pushing the Limits of
//! Stereo Using Variational Stereo Estimation", IV 2012; primal-dual iteration of Chambolle & Pock 2011.
//!
//! min over q and v of sum a1 w |grad q - v| + a0 |E v| + c |q - q0|: v is the slope of the surface, E v the
//! symmetrised derivative of v, w is small at edges of the picture, c is the certainty of the label q0.

use crate::align::following::depth::semi_global::Choice;
use crate::plane::Plane;
use crate::simd::{Loops, at_least, at_most, vectorised};

/// Weight of a difference between the gradient and the slope, a1.
const GRADIENT: f32 = 1.0;
/// Weight of a change of the slope, a0.
const SLOPE: f32 = 4.0;
/// The weight w at an edge of d grey values is exp(-d / `EDGE`), plus [`LEAST_WEIGHT`].
const EDGE: f32 = 6.0;
const LEAST_WEIGHT: f32 = 0.02;
/// Where the chosen labels of neighbours differ by more than this, the weight is as much lower, so that all jumps cost
/// the same.
const JUMP: f32 = 1.5;
/// Number of iterations.
const ITERATIONS: usize = 150;
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

/// The weight w of each pixel, multiplied by [`GRADIENT`].
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
        let width = self.weights.len();
        let [_, label, _, sx, _, sy] = parts::<PRIMAL>(self.here, width);
        let [_, _, _, above_sx, _, above_sy] = parts::<PRIMAL>(self.above, width);
        let [_, below, ..] = parts::<PRIMAL>(self.below, width);
        let [gx, gy, xx, yy, xy] = parts_mut::<DUAL>(self.row, width);
        let is_last = std::ptr::eq(self.here, self.below);
        let mut at = |x: usize, left: usize, right: usize| {
            // Forward differences of the label, minus the slope; none over the last column and row.
            let across = if right == x { 0.0 } else { label[right] - label[x] - sx[x] };
            let along = if is_last { 0.0 } else { below[x] - label[x] - sy[x] };
            let (a, b) = (gx[x] + STEP * across, gy[x] + STEP * along);
            let excess = at_least((a * a + b * b).sqrt() / self.weights[x], 1.0);
            (gx[x], gy[x]) = (a / excess, b / excess);
            // Backward differences of the slope.
            let a = xx[x] + STEP * (sx[x] - sx[left]);
            let b = yy[x] + STEP * (sy[x] - above_sy[x]);
            let c = xy[x] + STEP * 0.5 * ((sx[x] - above_sx[x]) + (sy[x] - sy[left]));
            let excess = at_least((a * a + b * b + 2.0 * c * c).sqrt() / SLOPE, 1.0);
            (xx[x], yy[x], xy[x]) = (a / excess, b / excess, c / excess);
        };
        at(0, 0, 1.min(width - 1));
        for x in 1..width.saturating_sub(1) {
            at(x, x - 1, x + 1);
        }
        if width > 1 {
            at(width - 1, width - 2, width - 1);
        }
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
        let width = chosen.len();
        let [gx, gy, xx, yy, xy] = parts::<DUAL>(self.here, width);
        let [_, above_gy, ..] = parts::<DUAL>(self.above, width);
        let [_, _, _, below_yy, below_xy] = parts::<DUAL>(self.below, width);
        let [label, next_label, sx, next_sx, sy, next_sy] = parts_mut::<PRIMAL>(self.row, width);
        // The adjoint of the backward differences: the first column and row have no difference to the one before.
        let row_counts = if self.is_first { 0.0 } else { 1.0 };
        let mut at = |x: usize, left: Option<usize>, right: Option<usize>| {
            let before = |v: &[f32]| left.map_or(0.0, |i| v[i]);
            let after = |v: &[f32]| right.map_or(0.0, |i| v[i]);
            let column_counts = if left.is_none() { 0.0 } else { 1.0 };
            let moved = label[x] + STEP * (gx[x] - before(gx) + gy[x] - above_gy[x]);
            // The certainty pulls the label towards the chosen one.
            let pull = STEP * certainty[x];
            let new = moved + at_least(at_most(chosen[x] - moved, pull), -pull);
            next_label[x] = 2.0 * new - label[x];
            label[x] = new;
            let change = after(xx) - column_counts * xx[x] + below_xy[x] - row_counts * xy[x];
            let new = sx[x] + STEP * (gx[x] + change);
            next_sx[x] = 2.0 * new - sx[x];
            sx[x] = new;
            let change = below_yy[x] - row_counts * yy[x] + after(xy) - column_counts * xy[x];
            let new = sy[x] + STEP * (gy[x] + change);
            next_sy[x] = 2.0 * new - sy[x];
            sy[x] = new;
        };
        at(0, None, (width > 1).then_some(1));
        for x in 1..width.saturating_sub(1) {
            at(x, Some(x - 1), Some(x + 1));
        }
        if width > 1 {
            at(width - 1, Some(width - 2), None);
        }
    }
}
