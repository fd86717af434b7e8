//! The local field: the displacements of the patches. Each is averaged with the displacements of its neighbours.
//!
//! In: the [matches](super::matching) of the patches. Out: a [`LocalField`], and how many of its cells are displaced
//! ([`Misfit`]). Cost: negligible. Source: weighted least squares over neighbouring patches, with Tukey's biweight.
//!
//! Each match is described by a paraboloid: its peak is the displacement, and its curvature is the precision in each
//! direction. The sum of the paraboloids of neighbouring patches describes a larger patch. A match that differs from
//! the sum around it has a small weight in all sums. The noise is estimated from the scatter of the matches about the
//! field. Therefore a displacement in a dark or noisy frame must be larger to be significant.

use crate::align::agreement::pattern::PEAK_BIAS;
use crate::align::agreement::{MOST_STILL, TileDisplacement};
use crate::align::local::areas::areas;
use crate::align::local::cell::{Cell, precision};
use crate::align::local::matching::Matches;
use crate::align::local::{dominant, matching};
use crate::align::refinement::FramePair;
use crate::align::result::Displaced;
use crate::align::transform::{Transform, map, off_level, on_level};
use crate::statistics::{MEDIAN_SQUARE, TUKEY, biweight, median};
use nalgebra::Matrix3;

/// Number of rounds in which the weights of the matches are computed again.
const ROUNDS: usize = 3;
/// The displacement of a cell is known only if at least this share of the patches around it have a match.
const LEAST_KNOWN: f64 = 0.25;
/// The displacement of a cell is significant only if at least this share of the matches around it agree with each
/// other.
const LEAST_AGREEING: f64 = 0.5;
/// With fewer known cells than this, the misfit is 0, and neither the finer level nor the dominant motion is tried.
const LEAST_CELLS: usize = 16;
/// A cell counts as displaced if its displacement is at least this, in pixels of the full size. A double edge is
/// visible from 2 px on; the value is less, because a cell at an edge of depth measures the mean of two displacements.
const DISPLACED_PX: f64 = 1.5;

/// Unless clearly more than this share of the cells have a significant displacement, the root mean square is 0. Unless
/// clearly more than this share are displaced by [`DISPLACED_PX`], these do not count in it. Such a small part of the
/// picture is more likely a thing that moved, or a wrong match, than an effect of depth. Measured on rendered brackets.
const LEAST_SHARE: f64 = 0.015;
/// Only if the root mean square displacement is at least this, in pixels of the full size, the mode `auto` measures the
/// displacements of a frame that moved on a finer level, if there is one, and searches for the dominant motion. Here,
/// each displacement counts as at most [`DISPLACED_PX`], so that few things that moved far are no reason.
const LEAST_MISFIT_PX: f64 = 0.15;
/// The finer level is used, and the dominant motion is searched, only if clearly more than this share of the cells have
/// a significant displacement: the dominant motion must fit as much more of the picture.
const LEAST_MOVED: f64 = 0.01;
/// If the share of the cells that are displaced, minus its standard error, is this large, the confidence is halved. The
/// aim is a confidence below one half if 3 % of the picture are displaced. The value is smaller than 3 %, because the
/// measured share is too small at edges of depth. Measured on rendered scenes.
pub(crate) const DISPLACED_HALVES: f64 = 0.025;
/// A single patch is displaced if its displacement is at least this, in pixels of the full size. It is more than
/// [`DISPLACED_PX`], because single patches are less certain than cells.
const SINGLE_PX: f64 = 2.0;
/// and if the correlation of the patch falls by at least half of this at a distance of one pixel of the level, in any
/// direction. Otherwise it may be an edge, whose displacement along itself is unknown.
const LEAST_SHARPNESS: f64 = 0.05;
/// A cell is suspicious if it is displaced by at least this, in pixels of the full size.
const SUSPICIOUS_PX: f64 = 1.0;
/// If more than this share of the cells are suspicious or have no match, displacements are searched farther
/// ([`matching::far`]).
const SUSPICIOUS: f64 = 0.01;

/// The displacements of the cells of a picture from the positions that a transform gives.
#[derive(Debug)]
pub(crate) struct LocalField {
    /// The transform from which the displacements are measured, in pixels of the level.
    h: Matrix3<f64>,
    /// The matches from which the displacements were measured.
    matches: Matches,
    /// The single patches that are displaced.
    single: SinglePatches,
    /// Size of the level of the matches, in pixels.
    size: (usize, usize),
    /// The cells whose displacement is known.
    pub(super) cells: Vec<Cell>,
    misfit: Misfit,
}

/// How many of the cells a transform does not fit. All lengths are in pixels of the full size.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Misfit {
    /// The cells that are displaced by at least [`DISPLACED_PX`].
    pub(crate) displaced: Displaced,
    /// The share of the cells that are displaced, minus the standard error of this share, 0..=1. The standard error is
    /// large if few cells are known, as in a dark frame.
    pub(crate) displaced_surely: f64,
    /// Root mean square displacement over the picture, minus the part that is due to [`PEAK_BIAS`]. Each cell counts
    /// with the area that it stands for. Displacements that are not significant, or that too few cells have, count as 0
    /// (see [`LEAST_SHARE`]).
    pub(crate) rms_px: f64,
}

impl LocalField {
    /// Measures the displacements of the frame from the positions that `transform` gives.
    pub(crate) fn new(pair: &FramePair, transform: &Transform) -> Self {
        let (width, height) = pair.size();
        let h = transform.matrix(width, height);
        let near = matching::near(pair, &h);
        let unmatched = near.unmatched();
        let single = SinglePatches::of(&near);
        let field = Self::of(near, single, pair, &h);
        let displaced = field.lengths_px().filter(|(px, _)| *px >= SUSPICIOUS_PX).count() + unmatched;
        if displaced as f64 <= SUSPICIOUS * (field.cells.len() + unmatched) as f64 {
            return field;
        }
        Self::of(matching::far(pair, &h), single, pair, &h)
    }

    /// The field of `matches` under the transform `h`, in pixels of the full size.
    fn of(matches: Matches, single: SinglePatches, pair: &FramePair, h: &Matrix3<f64>) -> Self {
        let h = on_level(h, matches.level);
        let size = pair.reference().size(matches.level);
        let is_shown = |[x, y]: [f64; 2]| {
            let (u, v) = map(&h, x, y);
            u >= 0.0 && v >= 0.0 && u <= (size.0 - 1) as f64 && v <= (size.1 - 1) as f64
        };
        let cells = smoothed(&matches, is_shown);
        Self::with(matches, single, h, size, cells)
    }

    /// `h` is in pixels of the level of the matches, and `size` is the size of that level.
    fn with(matches: Matches, single: SinglePatches, h: Matrix3<f64>, size: (usize, usize), cells: Vec<Cell>) -> Self {
        let field = LocalField { h, matches, single, size, cells, misfit: Misfit::default() };
        LocalField { misfit: field.measured(), ..field }
    }

    /// Returns the field of the next finer level, if there is one, and if the transform does not fit everywhere. On
    /// that level, fewer patches contain two motions.
    pub(crate) fn on_finer_level(&self, pair: &FramePair) -> Option<Self> {
        if !self.may_be_compromise() {
            return None;
        }
        let h = off_level(&self.h, self.matches.level);
        Some(Self::of(self.matches.on_finer_level(pair, &h)?, self.single, pair, &h))
    }

    /// Returns this field with displacements from the [dominant motion](dominant) instead of the present transform, and
    /// the error estimate of the dominant motion in pixels of the full size. None if the present transform fits nearly
    /// as much of the picture.
    pub(crate) fn dominant(&self) -> Option<(Self, f64)> {
        if !self.may_be_compromise() {
            return None;
        }
        let found = dominant::search(&self.cells, &self.h, self.size, self.scale())?;
        let back = found.h.try_inverse()? * self.h;
        let moved = |cell: &Cell| {
            let ([x, y], [dx, dy]) = (cell.centre, cell.displacement);
            let (u, v) = map(&back, x + dx, y + dy);
            Cell { displacement: [u - x, v - y], ..*cell }
        };
        let cells = self.cells.iter().map(moved).collect();
        // The displacements of single patches from the dominant motion are unknown.
        let field = Self::with(self.matches.clone(), SinglePatches::default(), found.h, self.size, cells);
        Some((field, self.scale() * found.error))
    }

    /// Returns the transform from which the displacements are measured, in pixels of the full size.
    pub(crate) fn transform(&self) -> Transform {
        Transform::Homography(off_level(&self.h, self.matches.level))
    }

    /// Length of a pixel of the level, in pixels of the full size.
    pub(super) fn scale(&self) -> f64 {
        (1u64 << self.matches.level) as f64
    }

    /// The lengths of the significant displacements, in pixels of the full size, each with the area of its cell.
    fn lengths_px(&self) -> impl Iterator<Item = (f64, f64)> {
        let length = |&Cell { displacement: [x, y], area, .. }: &Cell| (self.scale() * (x * x + y * y).sqrt(), area);
        self.cells.iter().filter(|c| c.is_significant()).map(length)
    }

    /// Returns how many of the cells are displaced; zeros if fewer than [`LEAST_CELLS`] cells are known.
    pub(crate) fn misfit(&self) -> Misfit {
        self.misfit
    }

    /// Whether the transform may be a compromise between several motions: whether at least [`LEAST_CELLS`] cells are
    /// known, clearly more than [`LEAST_MOVED`] of them have a significant displacement, and the root mean square
    /// displacement, with each displacement counted as at most [`DISPLACED_PX`], is at least [`LEAST_MISFIT_PX`].
    fn may_be_compromise(&self) -> bool {
        let all = self.cells.len() as f64;
        let capped: Vec<(f64, f64)> = self.lengths_px().map(|(px, area)| (px.min(DISPLACED_PX), area)).collect();
        self.cells.len() >= LEAST_CELLS
            && self.surely(capped.len() as f64, all) >= LEAST_MOVED
            && self.rms_px(capped.into_iter(), all) >= LEAST_MISFIT_PX
    }

    /// Returns the share of `count` in `all` cells, minus the standard error of this share.
    fn surely(&self, count: f64, all: f64) -> f64 {
        let independent = (all / self.matches.overlap().pow(2) as f64).max(1.0);
        surely(count / all, independent)
    }

    /// Returns the root mean square of `lengths`, each with the area of its cell, over `all` cells, minus the part that
    /// is due to [`PEAK_BIAS`].
    fn rms_px(&self, lengths: impl Iterator<Item = (f64, f64)>, all: f64) -> f64 {
        // The mean area of a cell is 1.
        let squares: f64 = lengths.map(|(px, area)| area * px * px).sum();
        let bias_px = self.scale() * PEAK_BIAS;
        (squares / all - bias_px * bias_px).max(0.0).sqrt()
    }

    /// Computes the [`misfit`](Self::misfit).
    fn measured(&self) -> Misfit {
        if self.cells.len() < LEAST_CELLS {
            return Misfit::default();
        }
        let displaced: Vec<f64> = self.lengths_px().map(|(px, _)| px).filter(|&px| px >= DISPLACED_PX).collect();
        // Captions, watermarks, dust and the fixed noise of the sensor stay at the same pixels when the camera moves.
        // Such cells are ignored, unless their share exceeds [`MOST_STILL`]: then the transform may be wrong, so they
        // count as displaced.
        let still = self.matches.still();
        let still = if still as f64 <= MOST_STILL * (self.cells.len() + still) as f64 { 0 } else { still };
        let all = (self.cells.len() + still) as f64;
        let displaced_or_still = (displaced.len() + still) as f64;
        let displaced_surely = self.surely(displaced_or_still, all);
        let most_px = if displaced_surely < LEAST_SHARE { DISPLACED_PX } else { f64::INFINITY };
        let counting: Vec<(f64, f64)> = self.lengths_px().filter(|&(px, _)| px < most_px).collect();
        let is_counted = self.surely(counting.len() as f64, all) >= LEAST_SHARE;
        let displaced = Displaced { fraction: displaced_or_still / all, px: median(displaced).unwrap_or(0.0) };
        Misfit {
            rms_px: if is_counted { self.rms_px(counting.into_iter(), all) } else { 0.0 },
            displaced_surely: displaced_surely.max(self.single.surely),
            displaced: if self.single.surely > displaced_surely { self.single.displaced } else { displaced },
        }
    }
}

/// The single patches that are displaced, as leaves in the wind are. The field does not show them, because it is a mean
/// over neighbouring patches.
#[derive(Debug, Clone, Copy, Default)]
struct SinglePatches {
    /// The displaced patches.
    displaced: Displaced,
    /// Their share, minus its standard error, 0..=1.
    surely: f64,
}

impl SinglePatches {
    fn of(matches: &Matches) -> Self {
        let scale = (1u64 << matches.level) as f64;
        let found = matches.all.iter().flatten().filter_map(|m| m.displacement());
        let all = (found.clone().count() + matches.unmatched()).max(1) as f64;
        let length = |found: TileDisplacement| {
            let [xx, xy, yy] = found.sharpness;
            let least = 0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
            let mut sum = Sum::default();
            sum.add(1.0, &found);
            let [dx, dy] = sum.peak();
            (least >= LEAST_SHARPNESS).then(|| scale * (dx * dx + dy * dy).sqrt())
        };
        let lengths: Vec<f64> = found.filter_map(length).filter(|&px| px >= SINGLE_PX).collect();
        let share = lengths.len() as f64 / all;
        let displaced = Displaced { fraction: share, px: median(lengths).unwrap_or(0.0) };
        SinglePatches { displaced, surely: surely(share, all) }
    }
}

/// Returns `share` minus its standard error, if it is that of `independent` parts.
fn surely(share: f64, independent: f64) -> f64 {
    (share - (share * (1.0 - share) / independent).sqrt()).max(0.0)
}

/// The weighted sum of the paraboloids of several matches: their sharpness S (negative second derivatives), and their
/// pull S d, with the displacement d.
#[derive(Clone, Copy, Default)]
struct Sum {
    sharpness: [f64; 3],
    pull: [f64; 2],
}

impl Sum {
    fn add(&mut self, weight: f64, d: &TileDisplacement) {
        self.sharpness.iter_mut().zip(d.sharpness).for_each(|(s, v)| *s += weight * v);
        self.pull.iter_mut().zip(d.pull).for_each(|(s, v)| *s += weight * v);
    }

    /// The displacement at the peak of the sum. On a straight edge, many displacements fit equally well; the result is
    /// the shortest of them.
    fn peak(&self) -> [f64; 2] {
        let [xx, xy, yy] = self.sharpness;
        let safe = 1e-3 * (xx + yy) + 1e-9;
        let (xx, yy) = (xx + safe, yy + safe);
        let determinant = xx * yy - xy * xy;
        let [px, py] = self.pull;
        [(yy * px - xy * py) / determinant, (xx * py - xy * px) / determinant]
    }
}

/// Returns the cells, each from the weighted sum of the matches around it. A match has a small weight if its
/// displacement differs from the peak of the sum of its own neighbourhood. Sums and weights are computed alternately.
/// `is_shown` tells whether the frame shows a position of the reference.
fn smoothed(matches: &Matches, is_shown: impl Fn([f64; 2]) -> bool) -> Vec<Cell> {
    // The patches around a cell are together 48 pixels wide. Narrower ones would fail on twigs and railings.
    let radius = matches.overlap();
    // Patches that overlap have similar errors.
    let alike = matches.overlap().pow(2) as f64;
    let known: Vec<Option<TileDisplacement>> = matches.all.iter().map(|m| m.and_then(|m| m.displacement())).collect();
    let around = |i: usize| {
        let (column, row) = (i % matches.columns, i / matches.columns);
        let near = |at: usize, count: usize| at.saturating_sub(radius)..(at + radius + 1).min(count);
        near(row, matches.rows).flat_map(move |y| near(column, matches.columns).map(move |x| y * matches.columns + x))
    };
    let mut weights: Vec<f64> = known.iter().map(|k| f64::from(u8::from(k.is_some()))).collect();
    let mut sums = vec![Sum::default(); known.len()];
    let mut variance = 1.0;
    for _ in 0..ROUNDS {
        for (i, sum) in sums.iter_mut().enumerate() {
            *sum = Sum::default();
            around(i).for_each(|n| known[n].iter().for_each(|d| sum.add(weights[n], d)));
        }
        let misfits: Vec<Option<f64>> =
            known.iter().zip(&sums).map(|(k, sum)| Some(misfit(k.as_ref()?, sum.peak()))).collect();
        let Some(middle) = median(misfits.iter().flatten().copied()) else { return Vec::new() };
        variance = (middle / MEDIAN_SQUARE).max(1e-12);
        for (weight, misfit) in weights.iter_mut().zip(&misfits) {
            *weight = misfit.map_or(0.0, |m| biweight((m / variance).sqrt() / TUKEY));
        }
    }
    let cell = |(i, own): (usize, &Option<TileDisplacement>)| {
        own.as_ref()?;
        // Beside a caption, the displacement is a mixture of that of the scene and of that of the caption.
        if around(i).any(|n| matches.is_still(n)) {
            return None;
        }
        let (mut all, mut agreeing) = (0, 0);
        for n in around(i).filter(|&n| known[n].is_some()) {
            all += 1;
            agreeing += usize::from(weights[n] > 0.0);
        }
        if (all as f64) < LEAST_KNOWN * ((2 * radius + 1) * (2 * radius + 1)) as f64 {
            return None;
        }
        Some(Cell {
            centre: matches.centre(i),
            displacement: sums[i].peak(),
            precision: precision(sums[i].sharpness, agreeing.max(1) as f64, alike * variance),
            agrees: agreeing as f64 >= LEAST_AGREEING * all as f64,
            area: 0.0,
        })
    };
    let mut cells: Vec<Option<Cell>> = known.iter().enumerate().map(cell).collect();
    let has_cell: Vec<bool> = cells.iter().map(Option::is_some).collect();
    let areas = areas(&has_cell, matches.columns, |i| is_shown(matches.centre(i)));
    let mean = areas.iter().sum::<usize>() as f64 / has_cell.iter().filter(|&&has| has).count() as f64;
    for (cell, area) in cells.iter_mut().zip(areas) {
        cell.iter_mut().for_each(|cell| cell.area = area as f64 / mean.max(1e-9));
    }
    cells.into_iter().flatten().collect()
}

/// Returns how much a match differs from the displacement `d`: the squared distance r^T S^-1 r, with r = S (m - d). S
/// is the sharpness of the match, and m its displacement.
fn misfit(own: &TileDisplacement, d: [f64; 2]) -> f64 {
    let [xx, xy, yy] = own.sharpness;
    let left = [own.pull[0] - xx * d[0] - xy * d[1], own.pull[1] - xy * d[0] - yy * d[1]];
    // S is regularised, because both r and S are zero in the direction along an edge.
    let safe = 0.02 * (xx + yy) + 1e-9;
    let (xx, yy) = (xx + safe, yy + safe);
    (yy * left[0] * left[0] - 2.0 * xy * left[0] * left[1] + xx * left[1] * left[1]) / (xx * yy - xy * xy)
}
