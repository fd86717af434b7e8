//! Merging: radiance from aligned frames, their exposures and the response.

use crate::bracket::colour::Primaries;
use crate::plane::Plane;

/// Linear radiance.
#[derive(Debug, Clone, PartialEq)]
pub struct RadianceMap {
    /// Linear RGB by rows; every value finite and positive.
    pub pixels: Plane<[f32; 3]>,
    /// What red, green, blue and white are.
    pub primaries: Primaries,
}
