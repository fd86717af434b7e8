//! Local displacements: the parts of a frame that a transform does not map to the right position.
//!
//! In: two frames and a transform. Out: the displacement of each cell of the picture from the position that the
//! transform gives ([`LocalField`]), and the share of the cells that are displaced ([`Misfit`](field::Misfit)). Cost,
//! on the level on which agreement is measured: every second patch is matched, with nine correlations of three
//! multiply-adds per pixel. If more than a hundredth of the patches seem displaced or have no match, there are some
//! hundred more correlations for every pixel. In the mode `auto`, if the frame moved and the transform does not fit
//! everywhere, there are some ten more for every pixel of the next finer level.
//!
//! The tiles of [`agreement`](crate::align::agreement) show whether a transform is right at all: they are large, and
//! their displacement is searched within a few pixels only. Near objects, rolling shutter and moving things displace
//! smaller parts of the picture, by more pixels. The patches of this module are smaller and searched farther.

mod areas;
mod cell;
mod dominant;
mod field;
mod matching;

pub(crate) use field::{DISPLACED_HALVES, LocalField};

use crate::align::agreement::TileDisplacement;
use crate::align::local::matching::Matches;
use crate::align::refinement::FramePair;
use nalgebra::Matrix3;

/// The displacements of patches, each with the number of its patch.
pub(crate) type Displacements = Vec<(usize, TileDisplacement)>;

/// Returns the displacements of the patches from the positions that `h` gives, each with the number of its patch, which
/// is the same for all frames of a size. `h` is in pixels of the full size; the displacements are in pixels of the level
/// on which agreement is measured.
///
/// There are patches of two sizes. Large ones find their match also in noise; small ones contain two motions less often.
pub(crate) fn patches(pair: &FramePair, h: &Matrix3<f64>) -> Displacements {
    let large = matching::far(pair, h);
    let small = large.on_finer_level(pair, h);
    let mut all = displacements(&large, 0, 1.0);
    all.extend(small.iter().flat_map(|small| displacements(small, large.all.len(), 2.0)));
    all
}

/// Like [`patches`], but only every second large patch, and only near the position that `h` gives. It takes much less
/// time.
pub(crate) fn near_patches(pair: &FramePair, h: &Matrix3<f64>) -> Displacements {
    displacements(&matching::near(pair, h), 0, 1.0)
}

/// The displacements of patches whose numbers begin at `first`, on a level that is larger by the factor `scale`.
fn displacements(matches: &Matches, first: usize, scale: f64) -> Displacements {
    let on_level = |d: TileDisplacement| TileDisplacement {
        centre: d.centre.map(|c| (c + 0.5) / scale - 0.5),
        sharpness: d.sharpness.map(|s| scale * scale * s),
        pull: d.pull.map(|p| scale * p),
    };
    let each = matches.all.iter().enumerate();
    each.filter_map(|(i, m)| Some((first + i, on_level((*m)?.displacement()?)))).collect()
}

#[cfg(test)]
mod tests;
