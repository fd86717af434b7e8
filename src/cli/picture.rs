//! Arguments on the picture that is written: bits, colours, size, and what is changed of it.

use super::adjust::Adjust;
use clap::{Args, ValueEnum};
use hdralign::tonemap::codes::{Colours, Depth};
use hdralign::write::picture::{self, Size};

/// How the picture is written.
#[derive(Debug, Args)]
pub struct Picture {
    /// Bits of a code of the picture: 16 for who edits it further. JPEG holds 8
    #[arg(long, value_enum, default_value_t, value_name = "BITS")]
    bit_depth: DepthArg,

    /// The colours of the picture: its primaries and curve, and the profile that is embedded. What a space lacks is drawn to grey
    #[arg(long, visible_alias = "picture-color", value_enum, default_value_t, value_name = "SPACE")]
    picture_colour: ColoursArg,

    /// Make the picture smaller, in linear light: the pixels of its longest side, as 2048, or 50%. It is never enlarged, and radiance is
    /// never resized
    #[arg(long, value_name = "PIXELS|PERCENT%")]
    resize: Option<Size>,

    #[command(flatten)]
    adjust: Adjust,
}

/// See [`Colours`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum ColoursArg {
    /// What every program and display shows right
    #[default]
    Srgb,
    /// For displays of phones and newer computers: more saturated reds and greens
    DisplayP3,
    /// Adobe RGB (1998), for print; .jpg needs --gain-map none
    AdobeRgb,
}

/// See [`Depth`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum DepthArg {
    /// Codes 0 to 255
    #[default]
    #[value(name = "8")]
    Eight,
    /// Codes 0 to 65535, of the floats that the tone mapping gives
    #[value(name = "16")]
    Sixteen,
}

impl Picture {
    /// How pictures are made.
    pub fn options(&self) -> picture::Options {
        picture::Options {
            depth: match self.bit_depth {
                DepthArg::Eight => Depth::Eight,
                DepthArg::Sixteen => Depth::Sixteen,
            },
            colours: match self.picture_colour {
                ColoursArg::Srgb => Colours::Srgb,
                ColoursArg::DisplayP3 => Colours::DisplayP3,
                ColoursArg::AdobeRgb => Colours::AdobeRgb,
            },
            size: self.resize.unwrap_or_default(),
            adjust: self.adjust.options(),
        }
    }
}
