//! `hdralign merge`.

use super::input::Common;
use super::progress::{Bar, Plan};
use super::radiance::Radiance;
use super::recovery::Recovery;
use super::tone::Tone;
use clap::ValueEnum;
use hdralign::bracket::LoadOptions;
use hdralign::error::Error;
use hdralign::merge::calibration::Calibration;
use hdralign::merge::deghost::Deghost;
use hdralign::merge::weight::Weight;
use hdralign::pipeline::{self, Options};
use std::path::PathBuf;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Examples:
  hdralign merge *.jpg                                beside them, FIRST-LAST.exr and .png
  hdralign merge *.jpg -o room.exr -o room.hdr -o room.jpg
  hdralign merge -e=-2,0,2 a.png b.png c.png          no EXIF: the exposures, in EV
  hdralign merge --deghost --ghost-mask moved.png *.jpg   people who walked on; and where they were
  hdralign merge --align none --crop none *.tif -o studio.exr";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    #[command(flatten)]
    common: Common,

    /// A result; the extension picks the format: .exr .hdr .tif (radiance), .png (picture),
    /// .jpg (picture that lights up on HDR displays). May be repeated
    /// [default: FIRST-LAST.exr and .png beside the photographs]
    #[arg(short, long, value_name = "OUT", verbatim_doc_comment)]
    output: Vec<PathBuf>,

    #[command(flatten)]
    recovery: Recovery,

    /// Use a response saved before, instead of recovering it: .json, .rsp (hdrgen) or .csv (luminance-hdr, pfstools)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["response_model", "response_degree"])]
    response: Option<PathBuf>,

    /// Save the response; the extension picks the format: .json, .rsp (hdrgen), .csv (luminance-hdr)
    #[arg(long, value_name = "FILE")]
    save_response: Option<PathBuf>,

    /// How far a code value is trusted
    #[arg(long, value_enum, default_value_t, value_name = "NAME")]
    weight: WeightArg,

    /// Leave out of the other photographs what is not as the reference shows it: people, cars, leaves, water. STRENGTH is 0 (only what is
    /// plainly different) to 1 (whatever may be); 0.5 where none is given
    #[arg(long, value_name = "STRENGTH", num_args = 0..=1, require_equals = true, default_missing_value = "0.5")]
    deghost: Option<f64>,

    /// Write where and how much was left out, as a grey PNG of the result's size: 0 nothing, 255 all photographs but the reference
    #[arg(long, value_name = "FILE", requires = "deghost")]
    ghost_mask: Option<PathBuf>,

    /// Take off the veil that lens and sensor scatter over the picture, where there is one
    #[arg(long)]
    flare: bool,

    #[command(flatten)]
    tone: Tone,

    #[command(flatten)]
    radiance: Radiance,

    /// Radiance in cd/m2 by the reference's exposure: its top code is 87 N^2 / (t ISO), within about half a stop
    #[arg(long)]
    absolute: bool,

    /// Multiply the radiance, which is then in cd/m2: with --absolute luminance measured over luminance reported,
    /// near 1; alone the cd/m2 of a radiance of 1, which is what gave the reference its middle code
    #[arg(long, value_name = "X", allow_negative_numbers = true, verbatim_doc_comment)]
    calibration_factor: Option<f64>,

    /// Let the .jpg tell where the photograph was taken, as the reference does
    #[arg(long)]
    keep_gps: bool,

    /// Write the aligned frames too, as TIFF: PREFIX and the photograph's name
    #[arg(long, value_name = "PREFIX")]
    save_aligned: Option<PathBuf>,
}

/// See [`Weight`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum WeightArg {
    /// Rises linearly from both ends to the middle
    #[default]
    Hat,
    /// A bell about the middle
    Gaussian,
    /// Nearly 1 but for the ends
    Plateau,
    /// 1 for all
    Uniform,
    /// Mann & Picard's certainty: the slope of the response
    MannPicard,
    /// The inverse of the variance: light, rounding and the frame's noise as measured
    Noise,
}

impl Args {
    fn options(&self) -> Result<Options, Error> {
        self.check_strength()?;
        let outputs = if self.output.is_empty() {
            pipeline::default_outputs(&self.common.aligned.images)
        } else {
            self.output.clone()
        };
        let common = self.common.options();
        let memory = self.common.aligned.memory(outputs.first().map(PathBuf::as_path));
        Ok(Options {
            load: LoadOptions { memory, keep_gps: self.keep_gps, ..common.load.clone() },
            outputs,
            exposures: self.recovery.exposures(),
            response: self.recovery.model()?,
            response_file: self.response.clone(),
            save_response: self.save_response.clone(),
            weight: match self.weight {
                WeightArg::Hat => Weight::Hat,
                WeightArg::Gaussian => Weight::Gaussian,
                WeightArg::Plateau => Weight::Plateau,
                WeightArg::Uniform => Weight::Uniform,
                WeightArg::MannPicard => Weight::MannPicard,
                WeightArg::Noise => Weight::Noise,
            },
            deghost: self.deghost.map(|strength| Deghost { strength }),
            ghost_mask: self.ghost_mask.clone(),
            flare: self.flare,
            colour: self.radiance.colour(),
            calibration: Calibration { camera: self.absolute, factor: self.calibration_factor },
            rendering: self.tone.rendering()?,
            save_aligned: self.save_aligned.clone(),
            write: self.radiance.write(common.write.overwrite),
            ..common
        })
    }
}

impl Args {
    /// A strength after a space is a photograph to the parser: who means one is told how it is typed.
    fn check_strength(&self) -> Result<(), Error> {
        let images = &self.common.aligned.images;
        let strength = images.iter().find(|image| {
            let number = image.to_str().and_then(|name| name.parse::<f64>().ok());
            number.is_some_and(|n| (0.0..=1.0).contains(&n)) && !image.exists()
        });
        match strength.filter(|_| self.deghost.is_some()) {
            None => Ok(()),
            Some(name) => {
                let name = name.display();
                let reason = format!("there is no photograph {name}; a strength is given as in `--deghost={name}`");
                Err(Error::Option { option: "--deghost", reason })
            }
        }
    }
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    if let Some(help) = args.tone.help() {
        super::tell(&help)?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut bar = Bar::new(Plan::merge(&args.common.aligned.images, args.deghost.is_some()), args.common.aligned.quiet);
    let report = pipeline::run(&args.common.aligned.images, &args.options()?, &|p| bar.show(p));
    bar.clear();
    super::finish(&report?, &args.common)
}
