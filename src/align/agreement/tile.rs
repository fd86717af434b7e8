//! The check of one tile: its best correlation within a few pixels around its position.
//!
//! In: two frames at a common exposure, the second warped to the reference's grid, and a tile. Out: whether the tile
//! agrees, and the paraboloid of its correlations. Cost: about twenty correlations, each with three multiply-adds per
//! pixel.
//! Source: Lewis 1995 (see [`agreement`](crate::align::agreement)).

use crate::align::agreement::pattern::{Pattern, Peak, Shift};
use crate::align::agreement::warped::{Part, Warped};
use crate::align::agreement::{REACH, TileDisplacement};
use crate::align::photometric::CommonExposure;

/// The result for one tile. `correlation` is the one at the position given by the transform. `offset` is the distance
/// of the best match from this position, in pixels.
#[derive(Debug, Clone, Copy)]
pub(super) enum Tile {
    Undecided,
    Agrees {
        offset: f32,
        correlation: f32,
        displacement: Option<TileDisplacement>,
    },
    Disagrees {
        correlation: f32,
    },
    /// The tile stayed at the same pixels, although the transform predicts a displacement.
    Still {
        correlation: f32,
    },
}

impl Tile {
    /// Returns the correlation at the position given by the transform; none for an undecided tile.
    pub(super) fn correlation(&self) -> Option<f32> {
        match *self {
            Tile::Undecided => None,
            Tile::Agrees { correlation, .. } | Tile::Disagrees { correlation } | Tile::Still { correlation } => {
                Some(correlation)
            }
        }
    }
}

/// The correlations of a tile at the shifts within [`REACH`], each computed on first use.
struct Correlations<'a> {
    pattern: &'a Pattern,
    warped: &'a Warped,
    known: [[Option<f32>; SPAN]; SPAN],
}

/// Number of shifts that are searched along an axis.
const SPAN: usize = 2 * REACH as usize + 1;

impl Correlations<'_> {
    /// Returns the correlation at a shift; NaN beyond [`REACH`].
    fn at(&mut self, (dx, dy): Shift) -> f32 {
        if dx.abs() > REACH || dy.abs() > REACH {
            return f32::NAN;
        }
        let known = &mut self.known[(dy + REACH) as usize][(dx + REACH) as usize];
        *known.get_or_insert_with(|| self.pattern.correlation(self.warped, (dx, dy)))
    }

    /// Climbs from `start` to the next local maximum.
    fn climb(&mut self, start: Shift) -> (f32, Shift) {
        let mut best = (self.at(start), start);
        loop {
            let (x, y) = best.1;
            for dy in -1..=1 {
                for dx in -1..=1 {
                    let c = self.at((x + dx, y + dy));
                    if c > best.0 {
                        best = (c, (x + dx, y + dy));
                    }
                }
            }
            if best.1 == (x, y) {
                return best;
            }
        }
    }

    /// Returns the offset from (x, y) to the maximum of a parabola, in steps of (dx, dy) and clamped to -1/2..=1/2; 0
    /// if there is no maximum. The parabola goes through the correlations at (x, y) and at its two neighbours in
    /// direction (dx, dy).
    fn vertex(&mut self, (x, y): Shift, (dx, dy): Shift) -> f32 {
        let (before, here, after) = (self.at((x - dx, y - dy)), self.at((x, y)), self.at((x + dx, y + dy)));
        let bend = before - 2.0 * here + after;
        if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    }
}

/// Checks a tile. If the frame shows only a part of it, this part is checked, if it is at least half of the tile.
///
/// `unmoved` returns the frame without any motion; none if the transform moves the tile by no more than [`REACH`].
pub(super) fn check_tile<'w>(
    both: &CommonExposure,
    warped: &Warped,
    unmoved: impl Fn() -> Option<&'w Warped>,
    tile: Part,
) -> Tile {
    let Some(part) = warped.shown(tile) else { return Tile::Undecided };
    let Some(pattern) = Pattern::new(both, part) else { return Tile::Undecided };
    let mut correlations = Correlations { pattern: &pattern, warped, known: [[None; SPAN]; SPAN] };
    let here = correlations.at((0, 0));
    if here.is_nan() {
        return Tile::Undecided;
    }
    let mut best = correlations.climb((0, 0));
    // There may be a higher maximum elsewhere within the range. The planes are smoothed, so such a maximum is wide and
    // also raises the correlation at the edge of the range. Therefore the edge is searched too.
    for start in RIM {
        if correlations.at(start) > best.0 {
            best = correlations.climb(start);
        }
    }
    let (dx, dy) = (best.1.0 as f32, best.1.1 as f32);
    let away = (dx * dx + dy * dy).sqrt();
    if here < LEAST_CORRELATION || (away > 1.5 && best.0 > here + 0.05) {
        return if best.0 < LEAST_CORRELATION && pattern.is_faint_in_both(warped) {
            Tile::Undecided
        } else if unmoved().is_some_and(|unmoved| pattern.correlation(unmoved, (0, 0)) > best.0.max(LEAST_STILL)) {
            Tile::Still { correlation: here }
        } else {
            Tile::Disagrees { correlation: here }
        };
    }
    let (x, y) = (dx + correlations.vertex(best.1, (1, 0)), dy + correlations.vertex(best.1, (0, 1)));
    Tile::Agrees {
        offset: (x * x + y * y).sqrt(),
        correlation: here,
        displacement: Peak::around(best.1, |shift| correlations.at(shift)).map(|peak| peak.about(part.centre())),
    }
}

/// Shifts at the edge of the range, from which the search for other maxima starts.
const RIM: [Shift; 8] = [(-3, -3), (0, -3), (3, -3), (-3, 0), (3, 0), (-3, 3), (0, 3), (3, 3)];

/// A tile counts as still (not moved) only if its correlation with the unmoved frame exceeds this.
const LEAST_STILL: f32 = 0.7;

/// Least correlation that an agreeing tile must have at the position given by the transform.
const LEAST_CORRELATION: f32 = 0.4;
