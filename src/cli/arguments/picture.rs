//! Arguments on the picture: bit depth, colour space, size, adjustments.

use crate::cli::arguments::adjust::Adjust;
use crate::cli::arguments::choice::choice;
use crate::cli::heading::PICTURE;
use clap::Args;
use hdralign::tonemap::display::codes::{Colours, Depth};
use hdralign::write::picture::{self, Size};

/// How the picture is written.
#[derive(Debug, Args)]
#[command(next_help_heading = PICTURE)]
pub struct Picture {
    /// Set the bits per channel of the picture; a .jpg cannot have 16 bits
    #[arg(long, hide_short_help = true, value_parser = choice::<Depth>(), default_value_t, value_name = "BITS")]
    bit_depth: Depth,

    /// Set the colour space of the picture, which is stored in the file. Colours outside the space are desaturated
    #[arg(long, hide_short_help = true, visible_alias = "picture-color", value_parser = choice::<Colours>(), default_value_t, value_name = "SPACE")]
    picture_colour: Colours,

    /// Shrink the picture: pixels of its longest side, or percent
    ///
    /// For example 2048 or 50%. The picture is resized in linear light and never enlarged. Radiance is never resized
    #[arg(long, value_name = "SIZE")]
    resize: Option<Size>,

    #[command(flatten)]
    adjust: Adjust,
}

impl Picture {
    /// Returns the options of the library for these arguments.
    pub fn options(&self) -> picture::Options {
        picture::Options {
            depth: self.bit_depth,
            colours: self.picture_colour,
            size: self.resize.unwrap_or_default(),
            adjust: self.adjust.options(),
        }
    }
}
