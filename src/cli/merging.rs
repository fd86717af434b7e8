//! Arguments on merging: from aligned photographs to radiance and a picture, whichever they are.

use super::choice::choice;
use super::picture::Picture;
use super::radiance::Radiance;
use super::recovery::Recovery;
use super::tone::Tone;
use clap::Args;
use hdralign::bracket::LoadOptions;
use hdralign::error::Error;
use hdralign::merge::calibration::Calibration;
use hdralign::merge::deghost::Deghost;
use hdralign::merge::weight::Weight;
use hdralign::pipeline::Options;
use hdralign::write;

/// How radiance and the picture come about.
#[derive(Debug, Args)]
pub struct Merging {
    #[command(flatten)]
    recovery: Recovery,

    /// Set the weighting function over the code values
    #[arg(long, value_parser = choice::<Weight>(), default_value_t, value_name = "NAME")]
    weight: Weight,

    /// Leave out of the other photographs what moved, and is not as the reference shows it: people, cars, leaves, water. off leaves all in; a
    /// strength is 0 (only what is plainly different) to 1 (whatever may be), and that of auto 0.5
    #[arg(
        long,
        value_name = "auto|off|STRENGTH",
        num_args = 0..=1,
        require_equals = true,
        default_value_t,
        default_missing_value = "auto"
    )]
    pub deghost: Deghost,

    /// Take off the veil that lens and sensor scatter over the picture, where there is one
    #[arg(long)]
    flare: bool,

    #[command(flatten)]
    pub tone: Tone,

    #[command(flatten)]
    picture: Picture,

    #[command(flatten)]
    radiance: Radiance,

    /// Radiance in cd/m2 by the reference's exposure: its top code is 87 N^2 / (t ISO), within about half a stop
    #[arg(long)]
    absolute: bool,

    /// Multiply the radiance, which is then in cd/m2: with --absolute luminance measured over luminance reported,
    /// near 1; alone the cd/m2 of a radiance of 1, which is what gave the reference its middle code
    #[arg(long, value_name = "X", allow_negative_numbers = true, verbatim_doc_comment)]
    calibration_factor: Option<f64>,

    /// Let pictures tell where the photograph was taken, as the reference does
    #[arg(long)]
    keep_gps: bool,
}

impl Merging {
    /// `options` with what these arguments say.
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
