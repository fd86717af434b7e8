//! Agreement: a local check of a transform, tile by tile, with a measure that bitmaps, features and refinement do not
//! optimise.
//!
//! In: two frames at a common exposure and a transform. Out: how many tiles agree with it, how many disagree, and the
//! displacement of those that agree. Cost: some twenty correlations per tile, with three multiply-adds per pixel.
//! Source: normalised cross-correlation (Lewis, "Fast Normalized Cross-Correlation", Vision Interface 1995), which does
//! not depend on gain and offset, searched within a few pixels.

pub(crate) mod pattern;
mod period;
mod tile;
mod tile_fit;

pub(crate) use period::periods;
pub(crate) use tile_fit::{TileFit, fit};

use crate::align::agreement::pattern::Warped;
use crate::align::agreement::tile::{Tile, check_tile};
use crate::align::photometric::CommonExposure;
use crate::align::transform::map;
use crate::statistics::median;
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::sync::OnceLock;

/// Number of tiles along the long side.
const TILES: usize = 16;
/// Least side of a tile, in pixels. A narrower picture has no tiles and cannot be checked.
pub(crate) const LEAST_SIDE: usize = 8;
/// Parts of the picture that did not move although the transform moves them (captions, watermarks, dust) are not
/// counted if their share is at most this. If it is larger, they may be the scene, and the transform may follow
/// something that moved; then they count against the transform.
pub(crate) const MOST_STILL: f64 = 1.0 / 3.0;
/// Search range of a tile around its position, in pixels.
const REACH: isize = 3;

/// The agreement of the tiles with a transform.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Agreement {
    /// Number of tiles whose best match is at the position given by the transform.
    pub agreeing: usize,
    /// Number of tiles with enough structure that match elsewhere, or nowhere.
    pub disagreeing: usize,
    /// Number of tiles that are uniform, too dark, too bright, or outside the frame.
    pub undecided: usize,
    /// Number of parts of the picture, of three by three, in which a tile agrees.
    pub parts: usize,
    /// The median displacement of the agreeing tiles, in pixels of the planes.
    pub offset: f64,
}

impl Agreement {
    /// The share of the decided tiles that agree, with a prior of five tiles of which one and a half agree.
    pub fn share(&self) -> f64 {
        (self.agreeing as f64 + 1.5) / ((self.agreeing + self.disagreeing) as f64 + 5.0)
    }

    /// The coverage of the picture by agreeing tiles, 1/2..=1.
    pub fn coverage(&self) -> f64 {
        0.5 + 0.5 * self.parts.min(ENOUGH_PARTS) as f64 / ENOUGH_PARTS as f64
    }
}

/// If at least this many parts of the picture have agreeing tiles, the whole picture counts as covered.
const ENOUGH_PARTS: usize = 4;

impl TileCheck {
    /// Evidence for this transform over that of `other`, in nats, from the tiles that are decided in both.
    ///
    /// The sum over the tiles of the logarithm of the ratio of their unexplained variances. Positive for this
    /// transform, negative for the other.
    pub fn evidence_over(&self, other: &TileCheck) -> f64 {
        let unexplained = |c: f32| f64::from(1.0 - c.max(0.0) * c.max(0.0)) + UNEXPLAINED;
        let both = self.correlations.iter().zip(&other.correlations).filter_map(|(a, b)| Some(((*a)?, (*b)?)));
        both.map(|(a, b)| libm::log(unexplained(b) / unexplained(a))).sum()
    }
}

/// Share of a tile's variance that noise leaves unexplained under the true transform.
const UNEXPLAINED: f64 = 0.05;

/// The displacement of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileDisplacement {
    /// Its centre in the reference, in pixels of the planes.
    pub centre: [f64; 2],
    /// Negative second derivatives of its correlation at the best match, [xx, xy, yy], per pixel^2: the precision of
    /// its position in each direction.
    pub sharpness: [f64; 3],
    /// `sharpness` times the displacement from the position given by the transform, in the reference's directions. (In
    /// the direction along an edge, both the sharpness and the pull are zero.)
    pub pull: [f64; 2],
}

/// The check of a transform: all tiles together, and each by itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TileCheck {
    /// The summary of all tiles.
    pub agreement: Agreement,
    /// The correlation of each tile at its position; none where it has too little contrast or is outside the frame.
    pub correlations: Vec<Option<f32>>,
    /// The displacements of the agreeing tiles whose best match is not at the edge of the search range.
    pub displacements: Vec<TileDisplacement>,
}

/// Checks the transform `h`, reference -> frame in pixels of the planes, by tiles.
pub fn check_tiles(both: &CommonExposure, h: &Matrix3<f64>) -> TileCheck {
    let (width, height) = (both.reference.width(), both.reference.height());
    let warped = Warped::new(&both.frame, h, (width, height), REACH as usize);
    // In a strip longer than TILES squares, a tile spans the whole width.
    let side = width.max(height).div_ceil(TILES).min(width.min(height)).max(LEAST_SIDE);
    let (columns, rows) = (width / side, height / side);
    let plain = OnceLock::new();
    let plain = || plain.get_or_init(|| Warped::new(&both.frame, &Matrix3::identity(), (width, height), 0));
    let checked = |i| {
        let place = (i % columns * side, i / columns * side);
        let middle = |at: usize| (at + side / 2) as f64;
        let (x, y) = (middle(place.0), middle(place.1));
        let (u, v) = map(h, x, y);
        let moves = (u - x) * (u - x) + (v - y) * (v - y) > (REACH * REACH) as f64;
        check_tile(both, &warped, || moves.then(plain), place, side)
    };
    let tiles: Vec<Tile> = (0..rows * columns).into_par_iter().map(checked).collect();
    let mut sum = Agreement::default();
    let mut displacements = Vec::new();
    let mut offsets = Vec::new();
    let mut parts = [false; 9];
    let mut still = 0;
    for (i, tile) in tiles.iter().enumerate() {
        match *tile {
            Tile::Undecided => sum.undecided += 1,
            Tile::Disagrees { .. } => sum.disagreeing += 1,
            Tile::Still { .. } => still += 1,
            Tile::Agrees { offset, peak, .. } => {
                sum.agreeing += 1;
                let middle = |at: usize| (at * side) as f64 + (side as f64 - 1.0) / 2.0;
                displacements.extend(peak.map(|p| p.about([middle(i % columns), middle(i / columns)])));
                parts[i / columns * 3 / rows * 3 + i % columns * 3 / columns] = true;
                offsets.push(offset);
            }
        }
    }
    // Tiles that stayed at the same pixels are ignored if they are few. Otherwise the transform may be wrong, so they
    // count as disagreeing.
    if still as f64 <= MOST_STILL * (still + sum.agreeing + sum.disagreeing) as f64 {
        sum.undecided += still;
    } else {
        sum.disagreeing += still;
    }
    sum.parts = parts.iter().filter(|&&p| p).count();
    sum.offset = median(offsets).map_or(0.0, f64::from);
    TileCheck { agreement: sum, correlations: tiles.iter().map(Tile::correlation).collect(), displacements }
}

#[cfg(test)]
mod tests;
