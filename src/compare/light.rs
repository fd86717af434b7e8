//! What the codes of a picture mean: light, by its colour profile.
//!
//! In: a profile, or none. Out: for each channel the light of every code, 0 to 1, and the primaries. Cost: at most 65,536 powers a channel.
//! A profile that works by tables is taken for sRGB.

use crate::bracket::Photograph;
use crate::bracket::colour::{Primaries, Transfer};

/// The light of codes.
#[derive(Debug, Clone)]
pub(super) struct Codes {
    transfer: Transfer,
    /// Red, green, blue: by code.
    pub curves: [Vec<f32>; 3],
    /// What red, green and blue are.
    pub primaries: Primaries,
}

impl Codes {
    /// Those of a photograph.
    pub fn of(photograph: &Photograph) -> Codes {
        let transfer = Transfer::of(photograph.profile.as_ref());
        let max = photograph.samples.max();
        let light = |c: usize, code: u16| transfer.light(c, f64::from(code) / f64::from(max)) as f32;
        let curves = [0, 1, 2].map(|c| (0..=max).map(|code| light(c, code)).collect());
        let primaries = photograph.profile.as_ref().and_then(|profile| profile.primaries);
        Codes { curves, primaries: primaries.unwrap_or(Primaries::SRGB), transfer }
    }

    /// Whether codes of both mean the same, but for what profiles round.
    pub fn mean_the_same(&self, other: &Codes) -> bool {
        self.transfer.is_close(&other.transfer) && self.primaries.is_close(&other.primaries, 0.005)
    }
}
