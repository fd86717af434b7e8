//! What is asked of pictures, whatever their format: bits and colours.
//!
//! In: options and the files named. Out: whether they can be had. Cost: none.

use super::gain_map::Resolution;
use super::{Format, Output};
use crate::error::{Error, Result};
use crate::tonemap::codes::{Colours, Depth};

/// How pictures are made.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Options {
    /// Bits of a code. Default: 8.
    pub depth: Depth,
    /// Primaries and transfer, and the profile that tells them. Default: sRGB.
    pub colours: Colours,
}

impl Options {
    /// Whether `outputs` can be pictures like this; a `.jpg` has the gain map `gain_map`.
    ///
    /// # Errors
    /// [`Error::Option`] where one cannot, or where there is none.
    pub(super) fn check(&self, outputs: &[Output], gain_map: Resolution) -> Result<()> {
        let refused = |option, reason: String| Err(Error::Option { option, reason });
        let asked =
            [("--bit-depth", self.depth != Depth::default()), ("--picture-colour", self.colours != Colours::default())];
        if outputs.iter().all(|output| output.format.holds_radiance())
            && let Some((option, _)) = asked.into_iter().find(|(_, is_asked)| *is_asked)
        {
            return refused(option, "no picture is written; name one by --picture, or leave it out".into());
        }
        let Some(jpeg) = outputs.iter().find(|output| output.format == Format::Jpeg) else { return Ok(()) };
        let name = jpeg.path.display();
        if self.depth == Depth::Sixteen {
            return refused("--bit-depth", format!("{name}: JPEG holds 8 bits; name a .png or .tif, or leave it out"));
        }
        if self.colours == Colours::AdobeRgb && gain_map != Resolution::None {
            let reason = "readers of gain maps know srgb and display-p3; give --gain-map none, or one of these";
            return refused("--picture-colour", format!("{name}: {reason}"));
        }
        Ok(())
    }
}
