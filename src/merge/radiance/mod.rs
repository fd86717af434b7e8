//! What is done with merged radiance as a whole: its unit and scale, its gamut, flare taken off, and its range and statistics measured.

pub mod calibration;
pub mod flare;
pub(crate) mod gamut;
pub(crate) mod normalisation;
pub(crate) mod photographed;
pub mod range;
pub mod statistics;
