//! Sub-pixel end of the bitmap search: the minimum of the XOR counts.
//!
//! In: the bitmaps of two frames at one level, and a motion that is off by a pixel or two. Out: the motion at which the
//! fewest pixels differ, and its error estimate. Cost: a round warps the frame once and counts eight times; two to four
//! rounds are enough. Nothing but the observations is allocated after [`Descent::new`]. Source: the counts are Ward's
//! (2003, section 2). Where the thesis tries angle after angle (chapter 4), here the counts of each part of the
//! picture, a pixel or two to either side, give the displacement of that part; shift and rotation are the least-squares
//! fit to all parts.

use crate::align::bitmaps::difference::{Difference, Mismatches, difference_shifted, mismatches};
use crate::align::bitmaps::{Motion, Rounding, ThresholdBitmaps};
use nalgebra::{SMatrix, SVector};

/// A step by less changes nothing that matters, in pixels of the level.
const SETTLED: f64 = 0.02;
/// Least share of the pixels that must be compared for a rate.
pub(crate) const LEAST_COMPARED: f64 = 0.1;
/// Parts of the picture along a side, each of which gives observations of the motion.
const PARTS: usize = 6;
/// How far the motion, or a part from it, may be off before anything is known, in pixels of the level.
const PRIOR_PX: f64 = 1.0;
/// The largest step of a round, in pixels of the level: the counts reach no farther.
const LONGEST_STEP: f64 = 2.0;
/// Times that the parts are weighed anew by their residuals.
const REWEIGHTED: usize = 3;
/// Displacements at which is counted, in pixels.
const STEPS: [i64; 5] = [-2, -1, 0, 1, 2];
/// The shifts tried from the middle.
const NEIGHBOURS: [(i64, i64); 8] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
/// Points along a side at which the error is averaged.
const GRID: usize = 7;

/// A motion's parameters for the fit: what the eight numbers of a homography near none add to the motion along both
/// axes, at places in heights from the centre; then how much brighter the frame is cut than the reference, as the
/// displacement that this is mistaken for.
const UNKNOWNS: usize = 9;
type Row = SVector<f64, UNKNOWNS>;
type Square = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// The observation of one kind of edge of one part along one axis: `row` . parameters = `value`, in pixels, with
/// variance 1 / `weight` if every differing pixel were independent of the others.
#[derive(Debug, Clone, Copy)]
struct Observation {
    row: Row,
    value: f64,
    weight: f64,
}

/// Two frames' bitmaps at one level, and room to warp_onto one on the other.
pub(crate) struct Descent<'a> {
    reference: &'a ThresholdBitmaps,
    frame: &'a ThresholdBitmaps,
    warped: ThresholdBitmaps,
    max_angle: f64,
}

impl<'a> Descent<'a> {
    /// For rotations of at most `max_angle` radians to either side, none where it is 0.
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

    /// The root mean square distance of a pixel from the centre: what a rotation by a radian moves, in pixels.
    pub(crate) fn arm(&self) -> f64 {
        let (width, height) = (self.width() as f64, self.height() as f64);
        ((width * width + height * height) / 12.0).sqrt()
    }

    /// The share that differs `right` and `down` of where the frame lies now; 1 where too little can be compared.
    fn rate_beside(&self, right: i64, down: i64) -> f64 {
        let difference = difference_shifted(self.reference, &self.warped, right, down);
        let area = (self.width() * self.height()) as f64;
        if (difference.compared as f64) < LEAST_COMPARED * area { 1.0 } else { difference.rate() }
    }

    /// The share that differs under `motion`; 1 where too little can be compared.
    pub(crate) fn rate(&mut self, motion: &Motion, rounding: Rounding) -> f64 {
        self.frame.warp_onto(motion, rounding, &mut self.warped);
        self.rate_beside(0, 0)
    }

    /// From `start` to a motion none of whose neighbours has a lower rate, and the rate there: the eight nearest shifts
    /// and the angles that move a pixel by half of one and by one, in turn. For small pictures, whose parts have too
    /// few edges each.
    pub(crate) fn descend_by_pixels(&mut self, start: Motion) -> (f64, Motion) {
        let mut best = (self.rate(&start, Rounding::Nearest), start);
        let step = 0.5 / self.arm();
        // Each round that goes on lowers the rate, so this ends; the bound is for plateaus of noise.
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

    /// From `start` to where the fewest pixels differ, in at most `rounds` steps.
    pub(crate) fn descend(&mut self, start: Motion, rounds: usize) -> Motion {
        let mut here = start;
        let height = self.height() as f64;
        for _ in 0..rounds {
            let observations = self.observations(&here);
            // A rotation by a is the field (-a y, a x).
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

    /// How `motion` compares; and how far it may be off, root mean square over the picture, in pixels of the level:
    /// what the observations leave open of a shift and a rotation, and what they would still change about it if they
    /// could agree on any homography, less what chance makes of that.
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

    /// The parts' observations of the error of `motion`.
    ///
    /// Let a part have edges that are brighter on the right, of total height p, and others of total height q. With the
    /// frame t to the right of where it belongs, it is darker than the reference in p t pixels and brighter in q t; t
    /// to the left, the other way round. Pixels near the threshold do not count: each number is less by as much as the
    /// zones are wide, and if one frame is cut brighter than the other by what displaces an edge by c, one kind of
    /// number is less by more, the other by less. With D(t), B(t) the numbers at displacement t, and o the displacement
    /// sought,
    ///
    /// D(1) + D(2) - B(-1) - B(-2) = -4 p (o - c),   B(1) + B(2) - D(-1) - D(-2) = -4 q (o + c),
    ///
    /// where p and q are the mean growth from 1 to 2 on either side. This holds exactly for |o| <= 1 where edges are
    /// sharp, and for any o where the numbers grow as the square. Where the picture is so fine that they grow no
    /// farther than to 1, that of 0 to 1 and
    /// D(1) - B(-1) = -2 p (o - c) say more. At o = 0 the left sides are 0 whatever their form.
    fn observations(&mut self, motion: &Motion) -> Vec<Observation> {
        self.frame.warp_onto(motion, Rounding::Dithered, &mut self.warped);
        let (width, height) = (self.width(), self.height());
        let columns = PARTS.min(width.div_ceil(64));
        let mut counts = [[[Mismatches::default(); PARTS * PARTS]; 5]; 2];
        for (axis, steps) in counts.iter_mut().enumerate() {
            for (parts, t) in steps.iter_mut().zip(STEPS) {
                let (dx, dy) = if axis == 0 { (t, 0) } else { (0, t) };
                mismatches(self.reference, &self.warped, (dx, dy), columns, &mut parts[..columns * PARTS]);
            }
        }
        let words = width.div_ceil(64);
        let middle = |i: usize, of: usize, n: usize| (n * i / of + n * (i + 1) / of) as f64 / 2.0;
        let mut observations = Vec::with_capacity(4 * columns * PARTS);
        for part in 0..columns * PARTS {
            let x = 64.0 * middle(part % columns, columns, words) - width as f64 / 2.0;
            let y = middle(part / columns, PARTS, height) - height as f64 / 2.0;
            for (axis, steps) in counts.iter().enumerate() {
                let row = field(axis, x / height as f64, y / height as f64);
                let [far_back, back, here, on, far_on] = steps.each_ref().map(|parts| parts[part]);
                let kinds = [
                    (here.darker, [on.darker, far_on.darker], here.brighter, [back.brighter, far_back.brighter], -1.0),
                    (here.brighter, [on.brighter, far_on.brighter], here.darker, [back.darker, far_back.darker], 1.0),
                ];
                for (none_on, on, none_back, back, cut) in kinds {
                    let [none, near, far] =
                        [none_on + none_back, on[0] + back[0], on[1] + back[1]].map(|n: u64| n as f64);
                    let lean = [0, 1].map(|k| back[k] as f64 - on[k] as f64);
                    // Growth, lean and count, each with what it comes to for a displacement of 1.
                    let wide = ((far - near) / 2.0, (lean[0] + lean[1]) / 4.0, (near + far) / 16.0);
                    let narrow = ((near - none) / 2.0, lean[0] / 2.0, near / 4.0);
                    let weight = |(growth, _, variance): (f64, f64, f64)| growth * growth / variance.max(1.0);
                    let (growth, lean, variance) = if weight(narrow) > weight(wide) { narrow } else { wide };
                    // What grows by less than chance does is no edge.
                    if growth > 0.0 && growth * growth > 16.0 * variance {
                        let mut row = row;
                        row[UNKNOWNS - 1] = cut;
                        observations.push(Observation {
                            row,
                            value: lean / growth,
                            weight: growth * growth / variance,
                        });
                    }
                }
            }
        }
        observations
    }
}

/// What each parameter adds to the motion along an axis, at a place in heights from the centre.
fn field(axis: usize, x: f64, y: f64) -> Row {
    Row::from(if axis == 0 {
        [1.0, x, y, 0.0, 0.0, 0.0, x * x, x * y, 0.0]
    } else {
        [0.0, 0.0, 0.0, 1.0, x, y, x * y, y * y, 0.0]
    })
}

/// The parameters of a model, each as what it makes of the nine.
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

/// A least-squares fit, robust by reweighting (Cauchy's weights), and how much it leaves open.
struct Fit {
    best: Row,
    covariance: Square,
}

impl Fit {
    fn of(observations: &[Observation], free: Free) -> Self {
        let mut basis = Square::zeros();
        for (k, parts) in free.iter().enumerate() {
            for &(i, share) in *parts {
                basis[(i, k)] = share;
            }
        }
        let mut fit = Fit { best: Row::zeros(), covariance: Square::zeros() };
        // Neighbouring pixels that differ are not independent: the residuals give the number that counts as one.
        let mut noise: f64 = 1.0;
        for pass in 0..=REWEIGHTED {
            let mut normal = Square::identity() / (PRIOR_PX * PRIOR_PX);
            let mut right = Row::zeros();
            let (mut sum, mut total_trust) = (0.0, 0.0);
            for observation in observations {
                let row = basis.transpose() * observation.row;
                let off = observation.value - observation.row.dot(&fit.best);
                let squared = off * off * observation.weight / noise;
                let trust = if pass == 0 { 1.0 } else { 1.0 / (1.0 + squared / (CAUCHY * CAUCHY)) };
                normal += row * row.transpose() * (observation.weight * trust / noise);
                right += row * (observation.value * observation.weight * trust / noise);
                sum += off * off * observation.weight * trust;
                total_trust += trust;
            }
            let inverse = normal.try_inverse().unwrap_or_else(|| Square::identity() * (PRIOR_PX * PRIOR_PX));
            fit = Fit { best: basis * (inverse * right), covariance: basis * inverse * basis.transpose() };
            noise = (sum / (total_trust - free.len() as f64).max(1.0)).max(1.0);
        }
        fit
    }
}

/// A observation this many standard deviations off has half its weight.
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

    /// Radiance 1 has code 117 at 0 EV.
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
        // Slopes of 24 px, wavy so that both axes have a say: three look to the left for every one that looks to the
        // right.
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
        // Four codes are a pixel, which would pull by half of one: (3 - 1) / (3 + 1).
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
    fn without_votes_nothing_is_known() {
        let blank = ThresholdBitmaps::blank(SIZE.0, SIZE.1);
        let mut descent = Descent::new(&blank, &blank, 0.05);
        let start = Motion { dx: 2.0, dy: 0.0, angle: 0.01 };
        assert_eq!(descent.descend(start, 3), start);
        let (difference, error_px) = descent.assess(&start);
        assert!(difference == Difference::default() && error_px >= PRIOR_PX, "{error_px}");
    }
}
