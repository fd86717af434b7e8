//! Tone mapping: from radiance to a picture.

use crate::plane::Plane;

/// A display-encoded picture: 8-bit sRGB transfer, primaries as recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct DisplayImage {
    /// RGB by rows.
    pub pixels: Plane<[u8; 3]>,
}
