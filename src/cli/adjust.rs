//! Arguments on what is changed of the picture, with every operator in the same way.

use clap::Args;
use hdralign::tonemap::adjust::{Options, WhiteBalance};

/// What is changed of the picture.
#[derive(Debug, Args)]
pub struct Adjust {
    /// The light that the picture shows as white: `as-shot` changes nothing, `auto` estimates it. KELVIN is its temperature as the photographs
    /// show it, as 5500 or 5500K: 2000 to 25000, below 6504 the picture becomes cooler, above it warmer; with a tint, as 5500,10: -150
    /// to 150, above 0 it becomes more magenta. X,Y is a pixel with grey around it, of the result, before --resize; spot:2400,100 says
    /// so where it might be a light. Radiance stays as it is
    #[arg(long, value_name = "auto|as-shot|KELVIN[,TINT]|X,Y", default_value_t, hide_default_value = true)]
    white_balance: WhiteBalance,

    /// Make the picture brighter, or darker: -5 to 5, stops in its dark parts and less towards white, which nothing reaches
    #[arg(long, value_name = "EV", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    brightness: f64,

    /// More contrast about middle grey, or less: -100 (half) to 100 (twice)
    #[arg(long, value_name = "-100..100", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    contrast: f64,

    /// More colour, or less: -100 (grey) to 100 (twice), at the same hue
    #[arg(long, value_name = "-100..100", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    saturation: f64,

    /// Make dark places brighter, or darker: -100 to 100, which is two stops in the darkest. What is fine in them keeps its contrast
    #[arg(long, value_name = "-100..100", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    shadows: f64,

    /// Make bright places brighter, or darker: -100 (skies and windows come back) to 100
    #[arg(long, value_name = "-100..100", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    highlights: f64,
}

impl Adjust {
    /// What is changed.
    pub fn options(&self) -> Options {
        Options {
            white_balance: self.white_balance,
            brightness: self.brightness,
            contrast: self.contrast,
            saturation: self.saturation,
            shadows: self.shadows,
            highlights: self.highlights,
        }
    }
}
