//! Arguments on what is changed of the picture, with every operator in the same way.

use crate::cli::heading::PICTURE;
use clap::Args;
use hdralign::tonemap::adjust::{Options, WhiteBalance};

/// What is changed of the picture.
#[derive(Debug, Args)]
#[command(next_help_heading = PICTURE)]
pub struct Adjust {
    /// Set the white balance of the picture [default: as-shot]
    ///
    /// auto estimates the light. KELVIN is its temperature, 2000 to 25000: below 6504 the picture becomes cooler, above it warmer. TINT is -150
    /// to 150: above 0 the picture becomes more magenta. X,Y is a grey spot of the result, before --resize; write spot:2400,100 where the
    /// numbers could be a temperature and a tint. Radiance is not changed
    #[arg(long, value_name = "auto|as-shot|KELVIN[,TINT]|X,Y", default_value_t, hide_default_value = true)]
    white_balance: WhiteBalance,

    /// Make the picture brighter or darker, -5 to 5
    ///
    /// The unit is a stop in the dark parts and less towards white, so that nothing is clipped
    #[arg(long, value_name = "EV", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    brightness: f64,

    /// Change the contrast about middle grey: -100 (half) to 100 (twice)
    #[arg(long, value_name = "-100..100", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    contrast: f64,

    /// Change the saturation: -100 (grey) to 100 (twice)
    #[arg(long, value_name = "-100..100", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    saturation: f64,

    /// Make the shadows brighter or darker, -100 to 100
    ///
    /// 100 is two stops in the darkest parts. Local contrast is kept
    #[arg(long, value_name = "-100..100", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    shadows: f64,

    /// Make the highlights brighter or darker, -100 to 100
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
