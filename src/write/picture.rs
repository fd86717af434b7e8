//! What is asked of pictures, whatever their format: bits and colours.
//!
//! In: options and the files named. Out: whether they can be had. Cost: none.

use super::Format;
use super::Output;
use crate::error::{Error, Result};
use crate::tonemap::codes::Depth;

/// How pictures are made.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Options {
    /// Bits of a code. Default: 8.
    pub depth: Depth,
}

impl Options {
    /// Whether `outputs` can be pictures like this.
    ///
    /// # Errors
    /// [`Error::Option`] where one cannot, or where there is none.
    pub fn check(&self, outputs: &[Output]) -> Result<()> {
        let refused = |option, reason: String| Err(Error::Option { option, reason });
        let pictures = || outputs.iter().filter(|output| !output.format.holds_radiance());
        let none = || "no picture is written; name a .png, or leave it out".to_owned();
        if self.depth == Depth::Sixteen {
            if pictures().next().is_none() {
                return refused("--bit-depth", none());
            }
            if let Some(jpeg) = pictures().find(|output| output.format == Format::Jpeg) {
                let name = jpeg.path.display();
                return refused("--bit-depth", format!("{name}: JPEG holds 8 bits; name a .png, or leave it out"));
            }
        }
        Ok(())
    }
}
