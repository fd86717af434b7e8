//! JPEG, with an Ultra HDR gain map behind the picture: every program shows the picture, and HDR displays apply the map.
//!
//! In: radiance and the picture, by rows. Out: one file of two JPEGs: the picture with GContainer XMP, the ISO version block and the
//! multi-picture index, and the map with its numbers as XMP and as the ISO block. Cost: 35 ns a pixel and core. Memory: both encoded, about
//! two bytes a pixel, as the head of the file tells their sizes.
//! Source: Google, "Ultra HDR Image Format v1.1"; ISO 21496-1:2025, annex C; CIPA DC-007 (MPF), sections 5.2 and A.2; libultrahdr, the
//! layout described at `JpegR::appendGainMap`.
//!
//! Gains are of what the encoded picture decodes to, not of what it was encoded from: what the JPEG of the picture loses, the map
//! gives back.

mod gain_map;
mod strips;
mod survey;
mod ultra_hdr;
mod writer;

use crate::error::{Error, Result};

#[doc(hidden)]
pub use gain_map::Rendition;
pub use gain_map::Resolution;
pub(crate) use survey::Survey;
pub(crate) use writer::Writer;

/// How `.jpg` is encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// The quality of the picture, 1 to 100, on the scale of libjpeg. Default: 93.
    pub quality: u8,
    /// How large the gain map is. Default: full.
    pub gain_map: Resolution,
}

impl Default for Options {
    fn default() -> Self {
        Options { quality: 93, gain_map: Resolution::Full }
    }
}

impl Options {
    /// Whether the quality is one.
    ///
    /// # Errors
    /// [`Error::Option`].
    pub fn validate(&self) -> Result<()> {
        if (1..=100).contains(&self.quality) {
            return Ok(());
        }
        let reason = format!("{} is no quality; give 1 to 100", self.quality);
        Err(Error::Option { option: "--jpeg-quality", reason })
    }
}
