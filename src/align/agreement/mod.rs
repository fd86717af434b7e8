//! Agreement: a local check of a transform, tile by tile. Its measure, the correlation, is not what the bitmap search,
//! the feature matching or the refinement optimises.
//!
//! In: two frames whose grey values are mapped to a common exposure, and a transform. Out: the number of tiles that
//! agree with the transform, the number of tiles that disagree, and the displacements of the agreeing tiles. Cost:
//! about twenty correlations per tile, each with three multiply-adds per pixel. Source: normalised cross-correlation
//! (Lewis, "Fast Normalized Cross-Correlation", Vision Interface 1995), which does not depend on gain and offset. Each
//! tile is searched within a few pixels of its position.

pub(crate) mod pattern;
mod period;
mod tile;
mod tile_fit;
pub(crate) mod warped;

pub(crate) use period::periods;
pub(crate) use tile_fit::{TileFit, fit};

use crate::align::agreement::tile::{Tile, check_tile};
use crate::align::agreement::warped::{Part, Warped};
use crate::align::photometric::CommonExposure;
use crate::align::transform::map;
use crate::statistics::median;
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::sync::OnceLock;

/// Number of tiles along the long side of the picture.
const TILES: usize = 16;
/// Smallest side of a tile, in pixels. A picture whose short side is smaller has no tiles and cannot be checked.
pub(crate) const LEAST_SIDE: usize = 8;
/// Tiles that did not move although the transform moves them (captions, watermarks, dust) are ignored, if their share
/// of all tiles that can be compared is at most this. If the share is larger, these tiles may be the scene, and the
/// transform may follow something that moved; then they count as disagreeing.
pub(crate) const MOST_STILL: f64 = 0.5;
/// Search range of a tile around its position, in pixels in each direction along each axis.
const REACH: isize = 3;

/// The agreement of the tiles with a transform.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Agreement {
    /// Number of tiles whose best match is at the position given by the transform (at most 1.5 pixels of the compared
    /// planes away), or hardly better than the match at this position, which must have a correlation of at least 0.4.
    pub agreeing: usize,
    /// Number of tiles with enough structure whose best match is at another position, or that match nowhere.
    pub disagreeing: usize,
    /// Number of the other tiles. There are three kinds: tiles that are uniform, too dark, too bright, or mostly
    /// outside the frame; tiles that are faint in both frames and match nowhere; and tiles that stayed at the same
    /// pixels although the transform moves them. (The last kind counts as disagreeing if it is more than half of the
    /// tiles that can be compared.)
    pub undecided: usize,
    /// Number of cells of a 3 x 3 grid over the picture that contain an agreeing tile, 0..=9.
    pub parts: usize,
    /// The median distance of the agreeing tiles' best matches from the positions given by the transform, in pixels of
    /// the compared planes.
    pub offset: f64,
}

impl Agreement {
    /// The number of agreeing tiles divided by the number of agreeing and disagreeing tiles. Before the division, 1.5
    /// is added to the numerator and 5 to the denominator, so that with few tiles the share is close to 0.3.
    pub fn share(&self) -> f64 {
        (self.agreeing as f64 + 1.5) / ((self.agreeing + self.disagreeing) as f64 + 5.0)
    }

    /// How much of the picture has agreeing tiles: 1/2 if there are none, 1 if there are some in at least
    /// `ENOUGH_PARTS` of 3 x 3 cells of the picture.
    pub fn coverage(&self) -> f64 {
        0.5 + 0.5 * self.parts.min(ENOUGH_PARTS) as f64 / ENOUGH_PARTS as f64
    }
}

/// If at least this many of the 3 x 3 cells of the picture have agreeing tiles, the whole picture counts as covered.
const ENOUGH_PARTS: usize = 4;

impl TileCheck {
    /// Returns the evidence for this transform compared with that of `other`, in nats, from the tiles that have a
    /// correlation in both checks.
    ///
    /// A transform leaves 1 - correlation^2 of a tile's variance unexplained; a negative correlation counts as 0. To
    /// this share, `UNEXPLAINED` is added. The evidence is the sum over the tiles of the logarithm of a ratio: the
    /// unexplained share under `other`, divided by that under this transform. It is positive if this transform matches
    /// better, negative if the other does.
    pub fn evidence_over(&self, other: &TileCheck) -> f64 {
        self.evidence_by_tile(other).sum()
    }

    /// Returns the evidence that distinguishes this transform from that of `other`:
    /// [`evidence_over`](Self::evidence_over) minus evidence that most tiles have in common.
    ///
    /// Only parts of the picture that do not repeat distinguish the right transform from one that is shifted by a
    /// period. But interpolation, tones and the precision of the two refinements may make one of the transforms match
    /// slightly better in most tiles. In a scene that repeats exactly, this alone could add up to decisive evidence.
    /// Therefore the median of the tiles' evidence, limited to one nat, is subtracted from the evidence of each tile.
    /// The median is subtracted only if it has the same sign as the sum over the tiles. If the subtraction would
    /// change the sign of the sum, the result is 0.
    pub fn distinction_from(&self, other: &TileCheck) -> f64 {
        let tiles: Vec<f64> = self.evidence_by_tile(other).collect();
        let all: f64 = tiles.iter().sum();
        // For an even number of tiles, `median` is the upper one of the two in the middle.
        let upper = median(tiles.iter().copied()).unwrap_or(0.0);
        let lower = -median(tiles.iter().map(|nats| -nats)).unwrap_or(0.0);
        let common = (0.5 * (upper + lower)).clamp(-MOST_COMMON, MOST_COMMON) * tiles.len() as f64;
        if all > 0.0 { (all - common.max(0.0)).max(0.0) } else { (all - common.min(0.0)).min(0.0) }
    }

    /// Returns the median share of a tile's variance that the transform leaves unexplained, 0..=1; 1 if no tile has a
    /// correlation.
    pub(crate) fn unexplained(&self) -> f64 {
        median(self.correlations.iter().flatten().map(|&c| unexplained(c))).unwrap_or(1.0)
    }

    /// Returns the terms of [`evidence_over`](Self::evidence_over).
    fn evidence_by_tile(&self, other: &TileCheck) -> impl Iterator<Item = f64> {
        let both = self.correlations.iter().zip(&other.correlations).filter_map(|(a, b)| Some(((*a)?, (*b)?)));
        both.map(move |(a, b)| libm::log((unexplained(b) + UNEXPLAINED) / (unexplained(a) + UNEXPLAINED)))
    }
}

/// Returns the share of a tile's variance that a transform leaves unexplained if the tile has the correlation `c` under
/// it, 0..=1. A negative correlation counts as 0.
fn unexplained(c: f32) -> f64 {
    f64::from(1.0 - c.max(0.0) * c.max(0.0))
}

/// Largest evidence per tile, in nats, that [`distinction_from`](TileCheck::distinction_from) subtracts. In rendered
/// scenes that repeat exactly, the tiles of two equally right transforms differ by up to 0.7. Where a scene does not
/// repeat, the tiles of a wrong transform usually differ by more.
const MOST_COMMON: f64 = 1.0;
/// Share of a tile's variance that noise leaves unexplained even under the true transform.
pub(crate) const UNEXPLAINED: f64 = 0.05;

/// The displacement of a tile's best match from the position given by the transform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileDisplacement {
    /// The centre of the tile in the reference, in pixels of the compared planes.
    pub centre: [f64; 2],
    /// The negative second derivatives of the tile's correlation at the best match, [xx, xy, yy], per pixel^2. The
    /// larger they are in a direction, the more precisely the position is known in that direction.
    pub sharpness: [f64; 3],
    /// The matrix `sharpness` times the displacement vector, in the reference's x and y. Along an edge, where the
    /// displacement is unknown, the sharpness and this product are both zero.
    pub pull: [f64; 2],
}

/// The check of a transform: all tiles together, and each by itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TileCheck {
    /// The summary of all tiles.
    pub agreement: Agreement,
    /// The correlation of each tile at its position. None for a tile with too little contrast, for a tile that is
    /// mostly outside the frame, and for a tile that is faint in both frames and matches nowhere.
    pub correlations: Vec<Option<f32>>,
    /// The displacements of the agreeing tiles whose best match is not at the edge of the search range.
    pub displacements: Vec<TileDisplacement>,
}

/// Checks the transform `h`, reference -> frame in pixels of the planes, by tiles.
pub fn check_tiles(both: &CommonExposure, h: &Matrix3<f64>) -> TileCheck {
    let (width, height) = (both.reference.width(), both.reference.height());
    let warped = Warped::new(&both.frame, h, (width, height), REACH as usize);
    // A tile is never larger than the short side. In a strip more than `TILES` times as long as wide, each tile
    // therefore spans the whole width.
    let side = width.max(height).div_ceil(TILES).min(width.min(height)).max(LEAST_SIDE);
    let (columns, rows) = (width / side, height / side);
    let plain = OnceLock::new();
    let plain = || plain.get_or_init(|| Warped::new(&both.frame, &Matrix3::identity(), (width, height), 0));
    let checked = |i| {
        let part = Part::square(i % columns * side, i / columns * side, side);
        let [x, y] = part.centre();
        let (u, v) = map(h, x, y);
        let moves = (u - x) * (u - x) + (v - y) * (v - y) > (REACH * REACH) as f64;
        check_tile(both, &warped, || moves.then(plain), part)
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
            Tile::Agrees { offset, displacement, .. } => {
                sum.agreeing += 1;
                displacements.extend(displacement);
                parts[i / columns * 3 / rows * 3 + i % columns * 3 / columns] = true;
                offsets.push(offset);
            }
        }
    }
    // Tiles that stayed at the same pixels are ignored if they are few. If there are many, the transform may be wrong,
    // so they count as disagreeing.
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
