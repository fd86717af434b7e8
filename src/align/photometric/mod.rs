//! Two frames at a common exposure, so that their pixels can be compared.
//!
//! In: two frames, roughly aligned. Out: [`ToneTables`]: a table of grey values for each of them and the weight of each
//! grey value; with them the two planes ([`CommonExposure`]), smoothed. Cost: one pass over some samples; a table
//! look-up and six multiply-adds a pixel. Source: Grossberg & Nayar 2003 (`intensity_map`); Burt & Adelson, "The
//! Laplacian Pyramid as a Compact Image Code", IEEE Trans. Communications 31(4), 1983 (the binomial kernel).
//!
//! The darker frame is mapped to the brighter one because clipping is then the same in both. It is mapped before it is
//! smoothed, because otherwise the edges of clipped areas would move.

mod intensity_map;
mod tones;

pub use tones::ToneTables;

use crate::plane::Plane;
use crate::pyramid::binomial;

/// Two frames at a common exposure, smoothed by one pixel.
#[derive(Debug, Clone)]
pub struct CommonExposure {
    /// The reference.
    pub reference: Plane<f32>,
    /// The frame, on its own grid.
    pub frame: Plane<f32>,
    /// What brought them here.
    pub tones: ToneTables,
}

impl CommonExposure {
    /// `reference` and `frame` by `tones`.
    pub fn new(reference: &Plane<u8>, frame: &Plane<u8>, tones: &ToneTables) -> Self {
        CommonExposure {
            reference: binomial(reference, &tones.reference),
            frame: binomial(frame, &tones.frame),
            tones: tones.clone(),
        }
    }
}
