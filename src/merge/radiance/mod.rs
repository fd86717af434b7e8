//! Radiance after the merge: what is applied to the whole map, and what is measured.
//!
//! Applied: [`flare`] subtracts lens flare, [`calibration`] and `normalisation` set the unit, `gamut` the colour space.
//! Measured: [`range`] is the radiance that the bracket covers, [`statistics`] the luminance of the map, `photographed`
//! the brightness of the frames, for tone mapping.

pub mod calibration;
#[doc(hidden)]
pub mod flare;
pub(crate) mod gamut;
pub(crate) mod normalisation;
pub(crate) mod photographed;
#[doc(hidden)]
pub mod range;
#[doc(hidden)]
pub mod statistics;
