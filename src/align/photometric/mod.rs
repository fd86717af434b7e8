//! Conversion of two frames to a common exposure, so that their pixels can be compared.
//!
//! In: two frames, roughly aligned. Out: [`ToneTables`] (a table of grey values for each frame, and the weight of each
//! grey value), and with them the two smoothed planes ([`CommonExposure`]). Cost: one pass over some samples; a table
//! look-up and six multiply-adds per pixel. Source: Grossberg & Nayar 2003 (`intensity_map`); Burt & Adelson, "The
//! Laplacian Pyramid as a Compact Image Code", IEEE Trans. Communications 31(4), 1983 (the binomial kernel).
//!
//! The grey values of the darker frame are converted to the exposure of the brighter frame, so that both are clipped in
//! the same areas. The mapping comes before the smoothing; otherwise the edges of clipped areas would move.

mod intensity_map;
mod tones;

pub(crate) use intensity_map::IntensityMap;
pub use tones::ToneTables;

use crate::plane::Plane;
use crate::pyramid::binomial;

/// Two frames at a common exposure, smoothed with a standard deviation of one pixel.
#[derive(Debug, Clone)]
pub struct CommonExposure {
    /// The reference.
    pub reference: Plane<f32>,
    /// The frame, in its own pixels: it is not warped to the reference.
    pub frame: Plane<f32>,
    /// The tables by which both were converted.
    pub tones: ToneTables,
}

impl CommonExposure {
    /// Converts `reference` and `frame` with `tones`, and smooths both.
    pub fn new(reference: &Plane<u8>, frame: &Plane<u8>, tones: &ToneTables) -> Self {
        CommonExposure {
            reference: binomial(reference, &tones.reference),
            frame: binomial(frame, &tones.frame),
            tones: tones.clone(),
        }
    }
}
