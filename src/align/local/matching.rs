//! Block matching from coarse to fine: the displacement of small patches from the position that a transform gives.
//!
//! In: a [`FramePair`] and a transform. Out: a [`Match`] for each patch of a level.
//! Cost: nine correlations for a patch that is not displaced, about thirty for a displaced one. Source: the search
//! starts from the best of the displacements of the neighbours on the coarser level, as in Hasinoff et al., "Burst
//! Photography", SIGGRAPH Asia 2016, section 4; normalised cross-correlation (Lewis 1995).

use crate::align::agreement::TileDisplacement;
use crate::align::agreement::pattern::{Pattern, Peak, Shift};
use crate::align::agreement::warped::{Part, Warped};
use crate::align::grey::measured_level;
use crate::align::photometric::CommonExposure;
use crate::align::refinement::FramePair;
use crate::align::transform::{map, on_level};
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::sync::OnceLock;

/// Side of a patch, in pixels of its level. In a photograph of 1 megapixel, this is 32 pixels of the full size, and
/// half of that on the next finer level.
const SIDE: usize = 16;
/// Distance of the patches from the border of the picture, in pixels of the level: the match of a patch is measured
/// with the correlations at the eight shifts around it, and interpolation needs one pixel more.
const BORDER: usize = 2;
/// Largest displacement that is searched, as a share of the long side. Depth displaces near objects by up to 2 %; the
/// rest is for the error of the transform.
const MOST_DISPLACEMENT: f64 = 0.03;
/// Largest displacement that [`near`] searches, in pixels of the level. The search of [`far`] begins on the finest
/// level on which its largest displacement is at most this; if there is none, on the coarsest level.
const COARSEST_REACH: isize = 3;
/// If the correlation of a patch is at least this at the position that the transform gives, and lower at the eight
/// positions around it, no other position is searched.
const ENOUGH_CORRELATION: f32 = 0.9;
/// A patch matches only where its correlation is at least this.
const LEAST_CORRELATION: f32 = 0.5;
/// At another position than that of the transform, a patch matches only if its correlation is at least this (it then
/// explains half of the variance of the patch). [`LEAST_CORRELATION`] suffices for a patch that stayed at the same
/// pixels. If a frame is blurred, patterns that are finer than the blur may be
/// inverted, because the transfer function of a blur has negative lobes (Goodman, Introduction to Fourier Optics, 6.4).
/// Such a pattern matches half a period away, with a lower correlation.
const LEAST_DISPLACED_CORRELATION: f32 = 0.7;

/// The best match of a patch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Match {
    /// The shift of the patch from the position that the transform gives, in whole pixels of the level.
    shift: Shift,
    /// What the match shows of the motion.
    pub(super) found: Found,
}

impl Match {
    /// The displacement of the patch; none if there is none to measure: see [`Found`].
    pub(super) fn displacement(&self) -> Option<TileDisplacement> {
        match self.found {
            Found::Displacement(displacement) => Some(displacement),
            Found::Still | Found::Nothing => None,
        }
    }
}

/// What the best match of a patch shows.
#[derive(Debug, Clone, Copy)]
pub(super) enum Found {
    /// The patch is displaced by this from the position that the transform gives; the displacement may be zero.
    Displacement(TileDisplacement),
    /// The patch stayed at the same pixels, although the transform moves it: it shows dust of the camera or a caption,
    /// not the scene.
    Still,
    /// The patch matches nowhere, or its match is at the limit of the search or of the frame, where it cannot be
    /// measured.
    Nothing,
}

/// The matches of the patches of a level.
#[derive(Debug, Clone)]
pub(super) struct Matches {
    /// The level on which the patches were matched.
    pub(super) level: usize,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Distance between neighbouring patches, in pixels of the level.
    step: usize,
    /// The matches of all patches, row by row. None where the patch is left out of the chessboard, has too little
    /// contrast or too few usable pixels, or is not completely inside the frame.
    pub(super) all: Vec<Option<Match>>,
}

/// Matches every second patch (the fields of one colour of a chessboard) of the level on which agreement is measured,
/// near the position that `h` gives. `h` is in pixels of the full size.
pub(super) fn near(pair: &FramePair, h: &Matrix3<f64>) -> Matches {
    let level = measured_level(pair.reference());
    let grid = Grid { level, step: SIDE, reach: COARSEST_REACH as usize, is_chessboard: true };
    Matches::none().finer(pair, h, grid, &[])
}

/// Matches all patches of the level on which agreement is measured, up to [`MOST_DISPLACEMENT`] from the position that
/// `h` gives. The patches overlap by half. `h` is in pixels of the full size.
pub(super) fn far(pair: &FramePair, h: &Matrix3<f64>) -> Matches {
    let measured = measured_level(pair.reference());
    let last = pair.reference().len() - 1;
    let is_coarse = |&level: &usize| reach(pair, level) <= COARSEST_REACH as f64;
    let coarsest = (measured..=last).find(is_coarse).unwrap_or(last);
    (measured..=coarsest).rev().fold(Matches::none(), |found, level| {
        let starts = if level == coarsest { &RIM[..] } else { &[] };
        let reach = reach(pair, level).ceil() as usize + 1;
        found.finer(pair, h, Grid { level, step: SIDE / 2, reach, is_chessboard: false }, starts)
    })
}

/// Largest displacement that [`far`] searches, in pixels of `level`.
fn reach(pair: &FramePair, level: usize) -> f64 {
    let (width, height) = pair.size();
    MOST_DISPLACEMENT * width.max(height) as f64 / (1u64 << level) as f64
}

/// The patches of a level that are to be matched. All lengths are in pixels of the level.
struct Grid {
    level: usize,
    /// Distance between neighbouring patches.
    step: usize,
    /// Largest shift that is searched, along each axis.
    reach: usize,
    /// Whether only every second patch is matched: the fields of one colour of a chessboard.
    is_chessboard: bool,
}

impl Matches {
    fn none() -> Self {
        Matches { level: 0, columns: 0, rows: 0, step: SIDE, all: Vec::new() }
    }

    /// Matches all patches of the next finer level, if there is one. They do not overlap. The search starts from the
    /// shifts in `self`. `h` is in pixels of the full size.
    ///
    /// On this level, a patch covers a quarter of the area of the scene that it covers on the previous level. So fewer
    /// patches contain two motions, for example at railings and twigs.
    pub(super) fn on_finer_level(&self, pair: &FramePair, h: &Matrix3<f64>) -> Option<Self> {
        let level = self.level.checked_sub(1)?;
        let reach = reach(pair, level).ceil() as usize + 1;
        Some(self.finer(pair, h, Grid { level, step: SIDE, reach, is_chessboard: false }, &[]))
    }

    /// Number of patches along a row, and along a column, to which a pixel belongs.
    pub(super) fn overlap(&self) -> usize {
        SIDE / self.step
    }

    /// The centre of patch `i`, in pixels of the level.
    pub(super) fn centre(&self, i: usize) -> [f64; 2] {
        centre([i % self.columns, i / self.columns].map(|at| BORDER + at * self.step))
    }

    /// Returns the matches of the patches of `grid`. Unless `self` is empty, the level of `grid` is finer by one than
    /// that of `self`. The search starts from (0, 0), and from the best of the shifts in `self` and in `starts`. `h` is
    /// in pixels of the full size.
    fn finer(&self, pair: &FramePair, h: &Matrix3<f64>, grid: Grid, starts: &[Shift]) -> Self {
        let Grid { level, step, reach, is_chessboard } = grid;
        let search = PatchSearch::new(pair.level(level), &on_level(h, level), reach);
        let count = |length: usize| (length + step).saturating_sub(SIDE + 2 * BORDER) / step;
        let [columns, rows] = [search.both.reference.width(), search.both.reference.height()].map(count);
        let find = |i: usize| {
            let place = [i % columns, i / columns];
            let is_left_out = is_chessboard && (place[0] + place[1]) % 2 == 1;
            let first = place.map(|at| BORDER + at * step);
            if is_left_out { None } else { search.find(first, self.candidates(first).iter().chain(starts)) }
        };
        let all: Vec<Option<Match>> = (0..columns * rows).into_par_iter().map(find).collect();
        Matches { level, columns, rows, step, all }
    }

    /// Returns the number of patches with enough contrast and usable pixels that have no match ([`Found::Nothing`]).
    pub(super) fn unmatched(&self) -> usize {
        self.all.iter().flatten().filter(|m| matches!(m.found, Found::Nothing)).count()
    }

    /// Whether the content of patch `i` stayed at the same pixels, although the transform predicts a displacement.
    pub(super) fn is_still(&self, i: usize) -> bool {
        self.all[i].is_some_and(|m| matches!(m.found, Found::Still))
    }

    /// Number of patches whose content stayed at the same pixels, although the transform predicts a displacement.
    pub(super) fn still(&self) -> usize {
        self.all.iter().flatten().filter(|m| matches!(m.found, Found::Still)).count()
    }

    /// Returns the shifts from which the search for a patch of the next finer level may start: those of the patches of
    /// this level around it. `first` is the first pixel of the patch. All lengths are in pixels of the finer level.
    fn candidates(&self, first: [usize; 2]) -> Vec<Shift> {
        let [column, row] = first.map(|at| at.saturating_sub(BORDER) / (2 * self.step));
        let near = |at: usize, count: usize| at.saturating_sub(1)..(at + 2).min(count);
        let around = near(row, self.rows).flat_map(|y| near(column, self.columns).map(move |x| y * self.columns + x));
        let mut shifts: Vec<Shift> =
            around.filter_map(|i| self.all[i]).map(|m| (2 * m.shift.0, 2 * m.shift.1)).collect();
        shifts.sort_unstable();
        shifts.dedup();
        shifts
    }
}

/// The centre of the patch whose first pixel is `first`, in pixels of the level.
fn centre(first: [usize; 2]) -> [f64; 2] {
    first.map(|at| at as f64 + (SIDE as f64 - 1.0) / 2.0)
}

/// The planes of a level on which patches are matched.
struct PatchSearch<'a> {
    both: &'a CommonExposure,
    /// The frame, warped by the transform.
    warped: Warped,
    /// The frame at the pixels where it was taken, made on first use.
    unmoved: OnceLock<Warped>,
    /// The inverse of the transform, in pixels of the level.
    back: Matrix3<f64>,
}

impl<'a> PatchSearch<'a> {
    /// `h` is in pixels of the level.
    fn new(both: &'a CommonExposure, h: &Matrix3<f64>, reach: usize) -> Self {
        let warped = Warped::new(&both.frame, h, (both.reference.width(), both.reference.height()), reach);
        PatchSearch { both, warped, unmoved: OnceLock::new(), back: h.try_inverse().unwrap_or_else(Matrix3::identity) }
    }

    /// Returns the match of the patch whose first pixel is `first`; none if the patch has too little contrast, too few
    /// usable pixels, or is not completely inside the frame. `candidates` are shifts from which the search may start.
    fn find<'c>(&self, first: [usize; 2], candidates: impl Iterator<Item = &'c Shift>) -> Option<Match> {
        let pattern = Pattern::new(self.both, Part::square(first[0], first[1], SIDE))?;
        let mut correlations = Correlations { pattern: &pattern, warped: &self.warped, known: Vec::with_capacity(64) };
        let (best, shift) = correlations.search(candidates)?;
        let centre = centre(first);
        let least = if shift == (0, 0) { LEAST_CORRELATION } else { LEAST_DISPLACED_CORRELATION };
        let peak = Peak::around(shift, |shift| correlations.at(shift)).filter(|_| best >= least);
        let is_here = shift == (0, 0) && best >= ENOUGH_CORRELATION;
        let found = match peak {
            _ if !is_here && self.is_still(&pattern, centre, (best, shift)) => Found::Still,
            Some(peak) => Found::Displacement(peak.about(centre)),
            None => Found::Nothing,
        };
        Some(Match { shift, found })
    }

    /// Whether the patch with this centre stayed at the same pixels, although the transform moves it. `best` and
    /// `shift` are the correlation and the shift of its match.
    fn is_still(&self, pattern: &Pattern, centre: [f64; 2], (best, shift): (f32, Shift)) -> bool {
        let (u, v) = map(&self.back, centre[0], centre[1]);
        let away = [u - centre[0], v - centre[1]];
        if away[0] * away[0] + away[1] * away[1] < LEAST_MOTION * LEAST_MOTION {
            return false;
        }
        let shift = [shift.0 as f64, shift.1 as f64];
        let is_unmoved = |axis: usize| (away[axis] - shift[axis]).abs() <= 1.0;
        // A sensor's noise may be the same along each column, or along each row. Such a pattern matches wherever it is
        // shifted along itself; the scene then decides where, and it is where the transform expects it.
        let is_line =
            |axis: usize| is_unmoved(axis) && away[axis].abs() >= LEAST_MOTION && shift[1 - axis].abs() <= 1.0;
        let is_here = (is_unmoved(0) && is_unmoved(1)) || is_line(0) || is_line(1);
        let size = (self.both.reference.width(), self.both.reference.height());
        let unmoved = || Warped::new(&self.both.frame, &Matrix3::identity(), size, 0);
        let still = || pattern.correlation(self.unmoved.get_or_init(unmoved), (0, 0));
        (is_here && best >= LEAST_CORRELATION) || is_better(still(), best)
    }
}

/// Whether a position with the correlation `other` matches clearly better than the present position, whose correlation
/// is `best`. A slightly higher correlation is not enough, because a repeated pattern matches nearly as well at a wrong
/// position.
fn is_better(other: f32, best: f32) -> bool {
    let unexplained = |c: f32| 1.0 - c.max(0.0) * c.max(0.0) + UNEXPLAINED;
    other >= LEAST_CORRELATION && unexplained(other) < CLEARLY * unexplained(best)
}

/// The share of a patch's variance that remains unexplained at its true position, due to noise.
const UNEXPLAINED: f32 = 0.05;
/// A position matches clearly better than another if its unexplained variance is less than this multiple of the
/// other's.
const CLEARLY: f32 = 0.8;
/// A patch can be recognised as still only if the transform moves it by at least this, in pixels of the level.
const LEAST_MOTION: f64 = 2.0;

/// The correlations of a patch at all shifts, each computed on first use.
struct Correlations<'a> {
    pattern: &'a Pattern,
    warped: &'a Warped,
    known: Vec<(Shift, f32)>,
}

impl Correlations<'_> {
    /// Returns the correlation at a shift; NaN if the shift is larger than the grid's reach, or leads outside the
    /// frame.
    fn at(&mut self, shift: Shift) -> f32 {
        let reach = self.warped.reach();
        if shift.0.abs() > reach || shift.1.abs() > reach {
            return f32::NAN;
        }
        if let Some(&(_, known)) = self.known.iter().find(|(s, _)| *s == shift) {
            return known;
        }
        let correlation = self.pattern.correlation(self.warped, shift);
        self.known.push((shift, correlation));
        correlation
    }

    /// Returns the correlation and the shift of the match; none if the patch is not completely inside the frame. The
    /// search climbs from (0, 0). Unless the correlation has its maximum there and is at least [`ENOUGH_CORRELATION`],
    /// it also climbs from the candidate with the highest correlation. The second result is used only if it is clearly
    /// better.
    fn search<'c>(&mut self, candidates: impl Iterator<Item = &'c Shift>) -> Option<(f32, Shift)> {
        if self.at((0, 0)).is_nan() {
            return None;
        }
        let here = self.climb((0, 0));
        if here.1 == (0, 0) && here.0 >= ENOUGH_CORRELATION {
            return Some(here);
        }
        let known = candidates.map(|&shift| (self.at(shift), shift)).filter(|(correlation, _)| !correlation.is_nan());
        let Some((_, start)) = known.reduce(|best, other| if other.0 > best.0 { other } else { best }) else {
            return Some(here);
        };
        let other = self.climb(start);
        Some(if is_better(other.0, here.0) { other } else { here })
    }

    /// Climbs from the shift `start` to a local maximum of the correlation; returns the correlation and the shift
    /// there.
    fn climb(&mut self, start: Shift) -> (f32, Shift) {
        let mut best = (self.at(start), start);
        loop {
            let (x, y) = best.1;
            for (dx, dy) in AROUND {
                let c = self.at((x + dx, y + dy));
                if c > best.0 {
                    best = (c, (x + dx, y + dy));
                }
            }
            if best.1 == (x, y) {
                return best;
            }
        }
    }
}

/// The corners, and the middles of the sides, of the square of shifts up to [`COARSEST_REACH`]. On the coarsest level
/// of [`far`], they are the candidates for the start of the search.
const RIM: [Shift; 8] = [(-3, -3), (0, -3), (3, -3), (-3, 0), (3, 0), (-3, 3), (0, 3), (3, 3)];
/// The eight neighbours of a shift.
const AROUND: [Shift; 8] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
