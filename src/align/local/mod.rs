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

#[cfg(test)]
mod tests;
