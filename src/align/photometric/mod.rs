//! Two frames as the brighter of them would show them, so that their pixels can be compared.
//!
//! In: two frames, roughly aligned. Out: [`ToneTables`], a table of levels for each of them and what each level can be trusted; and with
//! them the two planes ([`CommonExposure`]), smoothed. Cost: one pass over some samples; a table look-up and six multiply-adds a pixel.
//! Source: Grossberg & Nayar 2003 (see [`intensity_map`](crate::align::photometric::intensity_map)); Burt & Adelson, "The Laplacian Pyramid as a Compact
//! Image Code", IEEE Trans. Communications 31(4), 1983 (the binomial kernel).
//!
//! The darker is mapped to the brighter because clipping is then the same in both; and it is mapped before it is smoothed, because
//! the other way round the edges of clipped areas would move.

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
