//! Arguments of the commands that merge: from aligned frames to radiance and a picture.

use crate::cli::arguments::choice::choice;
use crate::cli::arguments::picture::Picture;
use crate::cli::arguments::radiance::Radiance;
use crate::cli::arguments::recovery::Recovery;
use crate::cli::arguments::tone::Tone;
use crate::cli::heading::{MERGE, OUTPUT};
use clap::Args;
use hdralign::bracket::LoadOptions;
use hdralign::error::Error;
use hdralign::merge::deghost::Deghost;
use hdralign::merge::radiance::calibration::Calibration;
use hdralign::merge::weight::Weight;
use hdralign::pipeline::Options;
use hdralign::write;

/// How frames are merged, and how the results are written.
#[derive(Debug, Args)]
#[command(next_help_heading = MERGE)]
pub struct Merging {
    #[command(flatten)]
    recovery: Recovery,

    /// Set the weighting function: how much each pixel value counts in the merge; for experts [default: hat; noise for
    /// camera raw]
    #[arg(long, hide_short_help = true, value_parser = choice::<Weight>(), value_name = "NAME")]
    weight: Option<Weight>,

    /// Remove ghosts: auto, off, or 0 to 1 (--deghost=0.8) [default: auto]
    ///
    /// Things that moved are shown as in the reference frame. Strength 0 removes only clear ghosts. Strength 1 also
    /// removes faint ghosts. The value auto means strength 0.5. The value off removes no ghosts, so things that moved
    /// may appear several times. A value must follow the = directly, as in --deghost=0.8
    #[arg(
        long,
        value_name = "STRENGTH",
        num_args = 0..=1,
        require_equals = true,
        default_value_t,
        hide_default_value = true,
        default_missing_value = "auto"
    )]
    pub deghost: Deghost,

    /// Subtract lens flare (veiling glare: the haze that bright areas spread over the picture), if any is found
    #[arg(long, hide_short_help = true)]
    flare: bool,

    #[command(flatten)]
    pub tone: Tone,

    #[command(flatten)]
    picture: Picture,

    #[command(flatten)]
    radiance: Radiance,

    /// Scale the radiance to cd/m2, computed from the exposure of the reference frame (accurate to about half a stop)
    ///
    /// The largest possible pixel value (255, or 65535 with 16 bits) in the reference frame stands for 87 N^2 / (t x
    /// ISO) cd/m2, where N is the f-number and t the exposure time in s. With -e, this pixel value stands for 87 / 2^EV
    /// cd/m2, where EV is the exposure that you give for the reference frame
    #[arg(long, hide_short_help = true)]
    absolute: bool,

    /// Multiply the radiance by X to get cd/m2
    ///
    /// With --absolute, X is a quotient, usually about 1: a luminance that you measured, divided by the luminance of
    /// the same place in a result without --calibration-factor. Without --absolute, X is the luminance in cd/m2 of a
    /// place that is middle grey (pixel value 128 of 255) in the reference frame
    #[arg(long, hide_short_help = true, value_name = "X", allow_negative_numbers = true)]
    calibration_factor: Option<f64>,

    /// Keep the GPS position of the reference frame in pictures; radiance files never have it
    #[arg(long, help_heading = OUTPUT, hide_short_help = true)]
    keep_gps: bool,
}

impl Merging {
    /// Returns `options` with the values of these arguments.
    pub fn options(&self, options: Options) -> Result<Options, Error> {
        Ok(Options {
            load: LoadOptions { keep_gps: self.keep_gps, ..options.load },
            exposures: self.recovery.exposures,
            response: self.recovery.model()?,
            weight: self.weight,
            deghost: self.deghost,
            flare: self.flare,
            colour: self.radiance.colour(),
            calibration: Calibration { camera: self.absolute, factor: self.calibration_factor },
            rendering: self.tone.rendering()?,
            write: write::Options { picture: self.picture.options(), ..self.radiance.write(options.write.overwrite) },
            ..options
        })
    }
}
