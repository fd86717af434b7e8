//! JPEG with an Ultra HDR gain map after the picture: every program shows the picture, and HDR displays apply the
//! map.
//!
//! In: radiance and the picture, by rows. Out: one file with two JPEGs: the picture with GContainer XMP, the ISO
//! version block and the multi-picture index; and the map with its parameters as XMP and as the ISO block. Cost: 35
//! ns per pixel and core. Memory: the encoded picture and the encoded map, about two bytes per pixel, because the
//! header of the file contains their sizes. Source: Google, "Ultra HDR Image Format v1.1"; ISO 21496-1:2025, annex C;
//! CIPA DC-007 (MPF), sections 5.2 and A.2; libultrahdr, the layout described at `JpegR::appendGainMap`.
//!
//! Gains are computed from the pixels of the decoded JPEG, not of the original picture, so that the map also corrects
//! the losses of the JPEG.

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

/// Options for `.jpg`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// The quality of the picture, 1 to 100, on the scale of libjpeg. Default: 93.
    pub quality: u8,
    /// Size of the gain map. Default: full.
    pub gain_map: Resolution,
}

impl Default for Options {
    fn default() -> Self {
        Options { quality: 93, gain_map: Resolution::Full }
    }
}

impl Options {
    /// Checks the quality.
    ///
    /// # Errors
    /// [`Error::Option`].
    pub fn validate(&self) -> Result<()> {
        if (1..=100).contains(&self.quality) {
            return Ok(());
        }
        let reason = format!("{} is not a valid quality; give 1 to 100", self.quality);
        Err(Error::Option { option: "--jpeg-quality", reason })
    }
}
