//! Local displacements: the parts of a frame that a transform does not map to the right position.
//!
//! In: two frames and a transform. Out: the displacement of each cell of the picture from the position that the
//! transform gives ([`LocalField`]), and the share of the picture that is displaced ([`Misfit`](field::Misfit)). Cost:
//! each pixel of the level on which agreement is measured is in nine correlations, with three multiply-adds each; in
//! some hundred where parts are displaced.
//!
//! The tiles of [`agreement`](crate::align::agreement) are large and searched within a few pixels, to find out whether
//! a transform is right at all. Near objects, rolling shutter and moving things displace smaller parts of the picture,
//! and by more pixels.

mod cell;
mod dominant;
mod field;
mod matching;

pub(crate) use field::LocalField;

#[cfg(test)]
mod tests;
