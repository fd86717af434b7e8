//! `hdralign merge`.

use crate::cli::arguments::input::{Common, Results};
use crate::cli::arguments::merging::Merging;
use crate::cli::heading::{MERGE, OUTPUT};
use crate::cli::process::leftovers;
use crate::cli::progress::{Bar, Plan};
use hdralign::bracket::LoadOptions;
use hdralign::error::Error;
use hdralign::merge::deghost::Deghost;
use hdralign::pipeline::{self, Options};
use std::path::PathBuf;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Examples:
  hdralign merge *.jpg                            write FIRST-LAST.exr and FIRST-LAST.png
  hdralign merge *.jpg -o room.exr -o room.jpg --report room.html
  hdralign merge *.jpg --picture room.tif --bit-depth 16 --picture-colour adobe-rgb
  hdralign merge -e=-2,0,2 a.png b.png c.png      without EXIF: exposures in EV
  hdralign merge --align none --crop none *.tif -o studio.exr";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    #[command(flatten)]
    common: Common,

    /// Read the camera response from a file instead of recovering it from the bracket: .json, .rsp (hdrgen) or .csv
    /// (luminance-hdr, pfstools)
    #[arg(long, help_heading = MERGE, hide_short_help = true, value_name = "FILE", conflicts_with_all = ["response_model", "response_degree"])]
    response: Option<PathBuf>,

    #[command(flatten)]
    merging: Merging,

    /// Write a result: .exr .hdr .tif .dng (radiance), .png .jpg (picture; .jpg with a gain map for HDR displays)
    ///
    /// May be repeated. If neither -o nor --picture is given, FIRST-LAST.exr and FIRST-LAST.png are written beside the
    /// photographs
    #[arg(short, long, help_heading = OUTPUT, value_name = "OUT")]
    output: Vec<PathBuf>,

    /// Write the picture: .png, .jpg, or .tif with 8 or 16 bits; may be repeated
    #[arg(long, help_heading = OUTPUT, hide_short_help = true, value_name = "FILE")]
    picture: Vec<PathBuf>,

    #[command(flatten)]
    results: Results,

    /// Write the response: .json, .rsp (hdrgen) or .csv (luminance-hdr)
    #[arg(long, help_heading = OUTPUT, hide_short_help = true, value_name = "FILE")]
    save_response: Option<PathBuf>,

    /// Write the motion mask, a grey PNG as large as the result: black where all frames were merged, white where only the
    /// reference frame was used
    #[arg(long, help_heading = OUTPUT, hide_short_help = true, value_name = "FILE")]
    ghost_mask: Option<PathBuf>,

    /// Write the aligned frames as TIFF with the bit depth of the photographs; the file names are PREFIX followed by
    /// the name of the photograph
    #[arg(long, help_heading = OUTPUT, hide_short_help = true, value_name = "PREFIX")]
    save_aligned: Option<PathBuf>,
}

impl Args {
    fn options(&self) -> Result<Options, Error> {
        self.check_strength()?;
        let outputs = if self.output.is_empty() && self.picture.is_empty() {
            pipeline::default_outputs(&self.common.aligned.images)
        } else {
            self.output.clone()
        };
        let folder = || {
            outputs
                .first()
                .or(self.picture.first())
                .and_then(|path| path.parent())
                .map_or_else(std::env::temp_dir, PathBuf::from)
        };
        let memory = self.results.work.memory(folder);
        let options = self.merging.options(self.results.options(&self.common))?;
        Ok(Options {
            load: LoadOptions { memory, ..options.load },
            outputs,
            pictures: self.picture.clone(),
            response_file: self.response.clone(),
            save_response: self.save_response.clone(),
            ghost_mask: self.ghost_mask.clone(),
            save_aligned: self.save_aligned.clone(),
            ..options
        })
    }
}

impl Args {
    /// Returns an error for `--deghost 0.5`, with a space instead of `=`: the argument parser then takes 0.5 for a
    /// photograph.
    fn check_strength(&self) -> Result<(), Error> {
        let images = &self.common.aligned.images;
        let strength = images.iter().find(|image| {
            let strength = image.to_str().and_then(|name| name.parse::<Deghost>().ok());
            strength.is_some_and(|strength| strength.validate().is_ok()) && !image.exists()
        });
        match strength {
            None => Ok(()),
            Some(name) => {
                let name = name.display();
                let reason = format!(
                    "{name} was taken for a photograph, but no file has this name; to set the strength to {name}, write --deghost={name}"
                );
                Err(Error::Option { option: "--deghost", reason })
            }
        }
    }
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let options = args.options()?;
    leftovers::clear(&pipeline::targets(&args.common.aligned.images, &options)?);
    let mut bar =
        Bar::new(Plan::merge(&args.common.aligned.images, args.merging.deghost.is_on()), args.results.work.quiet);
    let report = pipeline::run(&args.common.aligned.images, &options, &|p| bar.show(p));
    bar.clear();
    crate::cli::finish(&report?, &args.results)
}
