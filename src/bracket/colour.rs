//! The colour profile that a photograph carries, and the primaries that its numbers are of.

use serde::Serialize;

/// The CIE 1931 xy chromaticities of red, green, blue and white.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Primaries {
    /// xy of R = 1.
    pub red: [f64; 2],
    /// xy of G = 1.
    pub green: [f64; 2],
    /// xy of B = 1.
    pub blue: [f64; 2],
    /// xy of R = G = B = 1.
    pub white: [f64; 2],
}

impl Primaries {
    /// ITU-R BT.709 and sRGB, D65.
    pub const SRGB: Primaries = Primaries {
        red: [0.64, 0.33],
        green: [0.30, 0.60],
        blue: [0.15, 0.06],
        white: [0.3127, 0.3290],
    };
}

/// An ICC profile, kept as it was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// The profile's bytes.
    pub icc: Vec<u8>,
    /// Its own description, such as `sRGB IEC61966-2.1`.
    pub description: String,
}
