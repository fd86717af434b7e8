//! Arguments that adjust the picture, with the same meaning for every operator.

use crate::cli::heading::PICTURE;
use clap::Args;
use hdralign::tonemap::adjust::{Options, WhiteBalance};

/// Adjustments of the picture.
#[derive(Debug, Args)]
#[command(next_help_heading = PICTURE)]
pub struct Adjust {
    /// Set the white balance: as-shot, auto, KELVIN[,TINT], or X,Y (a grey spot)
    ///
    /// as-shot, the default, changes nothing. auto estimates the light. KELVIN[,TINT] is the colour of the light that
    /// should look white. KELVIN is from 2000 to 25000: below 6504 the picture becomes cooler, above it warmer. TINT is
    /// from -150 to 150: below 0 the picture becomes greener, above 0 more magenta. X,Y is the position of a grey spot,
    /// in pixels of the result before --resize. Two numbers that can be KELVIN,TINT, such as 2400,100, are read as
    /// KELVIN,TINT; for a spot at this position, write spot:2400,100. Radiance is not changed
    #[arg(long, value_name = "WHITE", default_value_t, hide_default_value = true)]
    white_balance: WhiteBalance,

    /// Make the picture brighter or darker, -5 to 5 [default: 0]
    ///
    /// With 1, dark parts become one stop brighter. Bright parts become less than one stop brighter, so nothing is
    /// clipped
    #[arg(long, value_name = "EV", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    brightness: f64,

    /// Change the contrast, -100 (half) to 100 (twice) [default: 0]
    ///
    /// Middle grey keeps its brightness
    #[arg(long, value_name = "N", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    contrast: f64,

    /// Change the saturation, -100 (grey) to 100 (twice) [default: 0]
    #[arg(long, value_name = "N", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    saturation: f64,

    /// Make the shadows brighter or darker, -100 to 100 [default: 0]
    ///
    /// With 100, the darkest parts become two stops brighter. Local contrast is kept
    #[arg(long, value_name = "N", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    shadows: f64,

    /// Make the highlights brighter or darker, -100 to 100 [default: 0]
    #[arg(long, value_name = "N", default_value_t, hide_default_value = true, allow_negative_numbers = true)]
    highlights: f64,
}

impl Adjust {
    /// Returns the options of the library for these arguments.
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
