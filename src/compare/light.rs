//! The linear light of a picture's code values, by its colour profile.
//!
//! In: a profile, or none. Out: for each channel the light of every code value, 0 to 1, and the primaries. Cost: at
//! most 65,536 powers a channel. A profile based on lookup tables is treated as sRGB.

use crate::bracket::Photograph;
use crate::bracket::colour::{Primaries, Transfer};

/// The linear light of the code values of a picture.
#[derive(Debug, Clone)]
pub(super) struct Codes {
    transfer: Transfer,
    /// Linear light by code value, for red, green and blue.
    pub curves: [Vec<f32>; 3],
    /// The primaries of the linear light in `curves`.
    pub primaries: Primaries,
}

impl Codes {
    /// Returns the light of the code values of `photograph`, by its profile and bit depth.
    pub fn of(photograph: &Photograph) -> Codes {
        let transfer = Transfer::of(photograph.profile.as_ref());
        let max = photograph.samples.max();
        let light = |c: usize, code: u16| transfer.light(c, f64::from(code) / f64::from(max)) as f32;
        let curves = [0, 1, 2].map(|c| (0..=max).map(|code| light(c, code)).collect());
        let primaries = photograph.profile.as_ref().and_then(|profile| profile.primaries);
        Codes { curves, primaries: primaries.unwrap_or(Primaries::SRGB), transfer }
    }

    /// Returns whether equal code values, each divided by the largest of its picture, represent equal colours in both
    /// pictures. Rounding in profiles is ignored.
    pub fn mean_the_same(&self, other: &Codes) -> bool {
        self.transfer.is_close(&other.transfer) && self.primaries.is_close(&other.primaries, 0.005)
    }
}
