//! Sub-pixel refinement of the bitmap search: the minimum of the XOR counts.
//!
//! In: the bitmaps of two frames at one level, and a motion that is off by a pixel or two. Out: the motion at which the
//! fewest pixels differ, and its error estimate. Cost: each round warps the frame once and counts the differing pixels
//! ten times; two to four rounds are enough. Nothing but the observations is allocated after [`Descent::new`].
//!
//! Source: the counts are Ward's (2003, section 2). The thesis that hdralign is based on tries one angle after another
//! (chapter 4). Here the picture is divided into a grid of cells instead. The counts under shifts of up to two pixels
//! give the displacement of each cell, and a shift and a rotation are fitted to all cells by least squares.

use crate::align::bitmaps::difference::{Difference, Mismatches, difference_shifted, mismatches};
use crate::align::bitmaps::{Motion, Rounding, ThresholdBitmaps};
use nalgebra::{SMatrix, SVector};

/// The descent ends after a step that is shorter than this, in pixels of the level.
const SETTLED: f64 = 0.02;
/// The rate, the fraction of differing pixels among the compared pixels, is valid only if at least this fraction of all
/// pixels is compared.
pub(crate) const LEAST_COMPARED: f64 = 0.1;
/// Largest number of cells along a side of the picture. Each cell gives observations of the motion.
const CELLS: usize = 6;
/// Prior standard deviation of each fitted parameter, in pixels of the level. The prior mean is 0.
const PRIOR_PX: f64 = 1.0;
/// The largest step of a round, in pixels of the level: the largest displacement in [`STEPS`].
const LONGEST_STEP: f64 = 2.0;
/// Number of times that the observations get new weights, computed from their residuals.
const REWEIGHTED: usize = 3;
/// Displacements at which mismatches are counted along each axis, in pixels.
const STEPS: [i64; 5] = [-2, -1, 0, 1, 2];
/// The eight nearest shifts, as (right, down).
const NEIGHBOURS: [(i64, i64); 8] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
/// The error is averaged over a grid with this many points along each side.
const GRID: usize = 7;

/// Number of parameters of the fit.
///
/// The first eight are those of a homography near the identity, with positions in picture heights from the centre. The
/// ninth stands for the difference between the thresholds of frame and reference. Its value is the displacement of an
/// edge that this difference causes.
const UNKNOWNS: usize = 9;
type Row = SVector<f64, UNKNOWNS>;
type Square = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// An equation for the parameters (see [`Descent::observations`]). Each cell gives one for each axis and each kind of
/// edge. The equation says that the scalar product of `row` and the parameters equals `value`, in pixels. If all
/// differing pixels were independent, the variance of `value` would be 1 / `weight`.
#[derive(Debug, Clone, Copy)]
struct Observation {
    row: Row,
    value: f64,
    weight: f64,
}

/// The bitmaps of two frames on one level, with a buffer for the warped frame.
pub(crate) struct Descent<'a> {
    reference: &'a ThresholdBitmaps,
    frame: &'a ThresholdBitmaps,
    warped: ThresholdBitmaps,
    max_angle: f64,
}

impl<'a> Descent<'a> {
    /// Prepares a descent with rotations of at most `max_angle` radians in either direction; 0 allows no rotation.
    pub(crate) fn new(reference: &'a ThresholdBitmaps, frame: &'a ThresholdBitmaps, max_angle: f64) -> Self {
        let warped = ThresholdBitmaps::blank(reference.threshold.width(), reference.threshold.height());
        Descent { reference, frame, warped, max_angle }
    }

    fn width(&self) -> usize {
        self.reference.threshold.width()
    }

    fn height(&self) -> usize {
        self.reference.threshold.height()
    }

    /// Returns the root mean square distance of the picture's pixels from its centre, in pixels.
    pub(crate) fn arm(&self) -> f64 {
        let (width, height) = (self.width() as f64, self.height() as f64);
        ((width * width + height * height) / 12.0).sqrt()
    }

    /// Returns the share of pixels that differ if the warped frame is shifted by (`right`, `down`); 1 if too few pixels
    /// can be compared.
    fn rate_beside(&self, right: i64, down: i64) -> f64 {
        let difference = difference_shifted(self.reference, &self.warped, right, down);
        let area = (self.width() * self.height()) as f64;
        if (difference.compared as f64) < LEAST_COMPARED * area { 1.0 } else { difference.rate() }
    }

    /// Returns the share of pixels that differ under `motion`; 1 if too few pixels can be compared.
    pub(crate) fn rate(&mut self, motion: &Motion, rounding: Rounding) -> f64 {
        self.frame.warp_onto(motion, rounding, &mut self.warped);
        self.rate_beside(0, 0)
    }

    /// Descends from `start` until no neighbouring motion has a lower rate (share of differing pixels), in at most
    /// eight rounds; returns the rate and the motion.
    ///
    /// The neighbours are tried in this order: the eight nearest shifts, then rotations in either direction that move
    /// the pixels by half a pixel or by one pixel (root mean square). This method is for small pictures, whose cells
    /// have too few edges for [`descend`](Self::descend).
    pub(crate) fn descend_by_pixels(&mut self, start: Motion) -> (f64, Motion) {
        let mut best = (self.rate(&start, Rounding::Nearest), start);
        let step = 0.5 / self.arm();
        // Each round but the last lowers the rate. The limit of eight rounds bounds the time if noise lowers the rate
        // again and again.
        for _ in 0..8 {
            let centre = best.1;
            self.frame.warp_onto(&centre, Rounding::Nearest, &mut self.warped);
            for (right, down) in NEIGHBOURS {
                let rate = self.rate_beside(right, down);
                if rate < best.0 {
                    best = (rate, centre.beside(right, down));
                }
            }
            let shifted = best.1;
            for turn in if self.max_angle > 0.0 { &[-2.0, -1.0, 1.0, 2.0][..] } else { &[] } {
                let turned = Motion { angle: shifted.angle + turn * step, ..shifted };
                if turned.angle.abs() <= self.max_angle {
                    let rate = self.rate(&turned, Rounding::Nearest);
                    if rate < best.0 {
                        best = (rate, turned);
                    }
                }
            }
            if best.1 == centre {
                break;
            }
        }
        best
    }

    /// Descends from `start` to the motion with the fewest differing pixels, in at most `rounds` steps.
    pub(crate) fn descend(&mut self, start: Motion, rounds: usize) -> Motion {
        let mut here = start;
        let height = self.height() as f64;
        for _ in 0..rounds {
            let observations = self.observations(&here);
            // A rotation by a small angle a displaces (x, y) by (-a y, a x).
            let fit = Fit::of(&observations, self.free());
            let limit = |v: f64| v.clamp(-LONGEST_STEP, LONGEST_STEP);
            let (dx, dy) = (limit(fit.best[0]), limit(fit.best[3]));
            let turn = (fit.best[4] / height).clamp(-LONGEST_STEP / self.arm(), LONGEST_STEP / self.arm());
            let angle = (here.angle + turn).clamp(-self.max_angle, self.max_angle);
            here = Motion { dx: here.dx + dx, dy: here.dy + dy, angle };
            if dx.abs().max(dy.abs()).max(turn.abs() * self.arm()) < SETTLED {
                break;
            }
        }
        here
    }

    /// Returns the differing pixels under `motion`, and the error estimate of `motion`: root mean square over the
    /// picture, in pixels of the level.
    ///
    /// The square of the error is the sum of two parts. The first is the variance of the fitted shift and rotation. The
    /// second covers motion that no shift and rotation describes. For it, a homography is fitted to the same
    /// observations. The part is the mean square change of position by this homography, minus the value that is
    /// expected by chance.
    pub(crate) fn assess(&mut self, motion: &Motion) -> (Difference, f64) {
        let observations = self.observations(motion);
        let difference = difference_shifted(self.reference, &self.warped, 0, 0);
        let (rigid, homography) = (Fit::of(&observations, self.free()), Fit::of(&observations, HOMOGRAPHY));
        let aspect = self.width() as f64 / self.height() as f64;
        let at = |i: usize| (i as f64 + 0.5) / GRID as f64 - 0.5;
        let (mut chance, mut beyond) = (0.0, 0.0);
        for i in 0..GRID * GRID {
            for axis in 0..2 {
                let row = field(axis, at(i % GRID) * aspect, at(i / GRID));
                let variance = |fit: &Fit| (row.transpose() * fit.covariance * row)[0];
                chance += variance(&rigid);
                beyond += row.dot(&homography.best) * row.dot(&homography.best) - variance(&homography);
            }
        }
        (difference, ((chance + beyond.max(0.0)) / (GRID * GRID) as f64).sqrt())
    }

    fn free(&self) -> Free {
        if self.max_angle > 0.0 { RIGID } else { SHIFT }
    }

    /// Returns the observations of the error of `motion` in all cells.
    ///
    /// Let a cell have edges that are darker on the right, of total height p, and edges that are brighter on the right,
    /// of total height q. The reference's pixel x is compared with the frame's pixel x + t. If t > 0, the frame is
    /// darker than the reference in p t pixels and brighter in q t pixels. If t < 0, it is brighter in p |t| pixels and
    /// darker in q |t| pixels. Excluded pixels reduce each count by the width of the exclusion zones. Different
    /// thresholds in the two frames displace each edge by some distance c. Then the counts of one kind of edge are
    /// reduced more, and the counts of the other kind less. Let D(t) be the number of darker pixels at t, B(t) the
    /// number of brighter pixels at t, and o the unknown displacement at which the frame matches. Then
    ///
    /// D(1) + D(2) - B(-1) - B(-2) = -4 p (o - c), B(1) + B(2) - D(-1) - D(-2) = -4 q (o + c).
    ///
    /// Here p and q are measured as the mean growth of the counts from |t| = 1 to |t| = 2. If edges are sharp, the
    /// equations hold exactly for |o| <= 1. If the counts grow quadratically, they hold for any o. In finely structured
    /// pictures, the counts only grow up to |t| = 1. There the growth from 0 to 1 and the equation D(1) - B(-1) = -2 p
    /// (o - c) are more precise. If o and c are 0, the left sides are 0, whatever the form of the counts.
    fn observations(&mut self, motion: &Motion) -> Vec<Observation> {
        self.frame.warp_onto(motion, Rounding::Dithered, &mut self.warped);
        let (width, height) = (self.width(), self.height());
        let columns = CELLS.min(width.div_ceil(64));
        let mut counts = [[[Mismatches::default(); CELLS * CELLS]; 5]; 2];
        for (axis, steps) in counts.iter_mut().enumerate() {
            for (cells, t) in steps.iter_mut().zip(STEPS) {
                let (dx, dy) = if axis == 0 { (t, 0) } else { (0, t) };
                mismatches(self.reference, &self.warped, (dx, dy), columns, &mut cells[..columns * CELLS]);
            }
        }
        let words = width.div_ceil(64);
        let middle = |i: usize, of: usize, n: usize| (n * i / of + n * (i + 1) / of) as f64 / 2.0;
        let mut observations = Vec::with_capacity(4 * columns * CELLS);
        for cell in 0..columns * CELLS {
            let x = 64.0 * middle(cell % columns, columns, words) - width as f64 / 2.0;
            let y = middle(cell / columns, CELLS, height) - height as f64 / 2.0;
            for (axis, steps) in counts.iter().enumerate() {
                let row = field(axis, x / height as f64, y / height as f64);
                let [far_back, back, here, on, far_on] = steps.each_ref().map(|cells| cells[cell]);
                let kinds = [
                    (here.darker, [on.darker, far_on.darker], here.brighter, [back.brighter, far_back.brighter], -1.0),
                    (here.brighter, [on.brighter, far_on.brighter], here.darker, [back.darker, far_back.darker], 1.0),
                ];
                for (none_on, on, none_back, back, cut) in kinds {
                    let [none, near, far] =
                        [none_on + none_back, on[0] + back[0], on[1] + back[1]].map(|n: u64| n as f64);
                    let asymmetry = [0, 1].map(|k| back[k] as f64 - on[k] as f64);
                    // The growth of the counts, their asymmetry, and the variance of the asymmetry, each for a
                    // displacement of one pixel.
                    let wide = ((far - near) / 2.0, (asymmetry[0] + asymmetry[1]) / 4.0, (near + far) / 16.0);
                    let narrow = ((near - none) / 2.0, asymmetry[0] / 2.0, near / 4.0);
                    let weight = |(growth, _, variance): (f64, f64, f64)| growth * growth / variance.max(1.0);
                    let (growth, asymmetry, variance) = if weight(narrow) > weight(wide) { narrow } else { wide };
                    // If the growth is less than four standard deviations of the asymmetry, it may be due to chance
                    // rather than to an edge.
                    if growth > 0.0 && growth * growth > 16.0 * variance {
                        let mut row = row;
                        row[UNKNOWNS - 1] = cut;
                        observations.push(Observation {
                            row,
                            value: asymmetry / growth,
                            weight: growth * growth / variance,
                        });
                    }
                }
            }
        }
        observations
    }
}

/// Returns the derivatives of the displacement along `axis` (0 is x, 1 is y) with respect to each parameter, at the
/// position (`x`, `y`) in picture heights from the centre.
fn field(axis: usize, x: f64, y: f64) -> Row {
    Row::from(if axis == 0 {
        [1.0, x, y, 0.0, 0.0, 0.0, x * x, x * y, 0.0]
    } else {
        [0.0, 0.0, 0.0, 1.0, x, y, x * y, y * y, 0.0]
    })
}

/// The free parameters of a model. Each is a linear combination of the nine parameters, given as (index, factor).
type Free = &'static [&'static [(usize, f64)]];
const SHIFT: Free = &[&[(0, 1.0)], &[(3, 1.0)], &[(8, 1.0)]];
const RIGID: Free = &[&[(0, 1.0)], &[(3, 1.0)], &[(2, -1.0), (4, 1.0)], &[(8, 1.0)]];
const HOMOGRAPHY: Free = &[
    &[(0, 1.0)],
    &[(1, 1.0)],
    &[(2, 1.0)],
    &[(3, 1.0)],
    &[(4, 1.0)],
    &[(5, 1.0)],
    &[(6, 1.0)],
    &[(7, 1.0)],
    &[(8, 1.0)],
];

/// A robust least-squares fit (reweighted with Cauchy's weights), and its covariance.
struct Fit {
    best: Row,
    covariance: Square,
}

impl Fit {
    fn of(observations: &[Observation], free: Free) -> Self {
        let mut basis = Square::zeros();
        for (k, terms) in free.iter().enumerate() {
            for &(i, share) in *terms {
                basis[(i, k)] = share;
            }
        }
        let mut fit = Fit { best: Row::zeros(), covariance: Square::zeros() };
        // If a pixel differs, its neighbours often differ too. So the actual variance is larger than for independent
        // pixels, by the factor `noise`, which is estimated from the residuals.
        let mut noise: f64 = 1.0;
        for pass in 0..=REWEIGHTED {
            let mut normal = Square::identity() / (PRIOR_PX * PRIOR_PX);
            let mut right = Row::zeros();
            let (mut sum, mut total_weight) = (0.0, 0.0);
            for observation in observations {
                let row = basis.transpose() * observation.row;
                let off = observation.value - observation.row.dot(&fit.best);
                let squared = off * off * observation.weight / noise;
                let robust = if pass == 0 { 1.0 } else { 1.0 / (1.0 + squared / (CAUCHY * CAUCHY)) };
                normal += row * row.transpose() * (observation.weight * robust / noise);
                right += row * (observation.value * observation.weight * robust / noise);
                sum += off * off * observation.weight * robust;
                total_weight += robust;
            }
            let inverse = normal.try_inverse().unwrap_or_else(|| Square::identity() * (PRIOR_PX * PRIOR_PX));
            fit = Fit { best: basis * (inverse * right), covariance: basis * inverse * basis.transpose() };
            noise = (sum / (total_weight - free.len() as f64).max(1.0)).max(1.0);
        }
        fit
    }
}

/// An observation with a residual of this many standard deviations has half its weight.
const CAUCHY: f64 = 2.4;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::bitmaps::Zone;
    use crate::align::scene::{Scene, Shot, photograph, rigid};
    use crate::align::transform::Transform;

    const SIZE: (usize, usize) = (384, 288);

    fn cut(scene: &Scene, transform: &Transform, ev: f64, level: u8) -> ThresholdBitmaps {
        ThresholdBitmaps::new(&scene.photograph(SIZE, transform, Shot::at(ev)), &Zone::about(level, 4))
    }

    /// Returns the code value of radiance 1; it is 117 at 0 EV.
    fn code(ev: f64) -> u8 {
        (255.0 * (0.18 * ev.exp2()).powf(1.0 / 2.2)).round() as u8
    }

    #[test]
    fn settles_at_the_motion_from_a_pixel_and_a_half_away() {
        let scene = Scene::new(3);
        let Transform::Rigid { dx, dy, angle } = rigid(4.4, -2.7, 0.8) else { unreachable!() };
        let a = cut(&scene, &Transform::Identity, 0.0, code(0.0));
        let b = cut(&scene, &rigid(4.4, -2.7, 0.8), 1.0, code(1.0));
        let mut descent = Descent::new(&a, &b, 0.1);
        let arm = descent.arm();
        for (x, y, turn) in [(0.0, 0.0, 0.0), (1.5, -1.0, 0.0), (-1.0, 1.2, 1.0), (0.5, 0.5, -1.5)] {
            let start = Motion { dx: dx + x, dy: dy + y, angle: angle + turn / arm };
            let found = descent.descend(start, 8);
            let off = [found.dx - dx, found.dy - dy, (found.angle - angle) * arm];
            assert!(off.iter().all(|o| o.abs() < 0.06), "{off:?} from {start:?}");
        }
    }

    #[test]
    fn a_frame_cut_brighter_is_not_moved() {
        // The scene has two soft edges, 24 px wide and wavy, so that both axes contribute. One edge gets brighter to
        // the right, in all rows. The other edge gets darker to the right, only in a third of the rows.
        let slopes = |x: f64, y: f64| {
            let wave = 12.0 * (y / 9.0).sin();
            let rise = |at: f64| ((x - at - wave) / 24.0).clamp(0.0, 1.0);
            let fall = if y < SIZE.1 as f64 / 3.0 { rise(240.0) } else { 0.0 };
            0.4 + 1.6 * (rise(96.0) - fall)
        };
        let take = |level: u8| {
            let grey = photograph(SIZE, &Transform::Identity, Shot { ev: 0.0, noise: 1.0, seed: level.into() }, slopes);
            ThresholdBitmaps::new(&grey, &Zone::about(level, 2))
        };
        let a = take(125);
        // A threshold that differs by four code values displaces edges by about a pixel. The first edge moves in one
        // direction and the second in the other, and the first edge is three times as high. If the difference of the
        // thresholds were ignored, the result would be off by (3 - 1) / (3 + 1) = 0.5 px.
        for level in [121, 125, 129] {
            let b = take(level);
            let found = Descent::new(&a, &b, 0.0).descend(Motion::default(), 6);
            assert!(found.dx.abs() < 0.1 && found.dy.abs() < 0.1, "{found:?} at {level}");
        }
    }

    #[test]
    fn the_walk_ends_where_no_neighbour_is_lower() {
        let scene = Scene::new(4);
        let a = cut(&scene, &Transform::Identity, 0.0, code(0.0));
        let b = cut(&scene, &rigid(6.0, 5.0, 0.0), 0.0, code(0.0));
        let mut descent = Descent::new(&a, &b, 0.05);
        let (rate, found) = descent.descend_by_pixels(Motion { dx: 3.0, dy: 7.0, angle: 0.01 });
        assert_eq!(rate, descent.rate(&found, Rounding::Nearest));
        for (right, down) in NEIGHBOURS {
            assert!(descent.rate(&found.beside(right, down), Rounding::Nearest) >= rate);
        }
        assert!((found.dx - 6.0).abs() < 0.8 && (found.dy - 5.0).abs() < 0.8, "{found:?}");
    }

    #[test]
    fn without_votes_the_result_is_unknown() {
        let blank = ThresholdBitmaps::blank(SIZE.0, SIZE.1);
        let mut descent = Descent::new(&blank, &blank, 0.05);
        let start = Motion { dx: 2.0, dy: 0.0, angle: 0.01 };
        assert_eq!(descent.descend(start, 3), start);
        let (difference, error_px) = descent.assess(&start);
        assert!(difference == Difference::default() && error_px >= PRIOR_PX, "{error_px}");
    }
}
