//! `hdralign align`.

use crate::cli::arguments::input::{Common, Results};
use crate::cli::heading::OUTPUT;
use crate::cli::process::leftovers;
use crate::cli::progress::{Bar, Plan};
use hdralign::error::Error;
use hdralign::pipeline::{self, Options};
use std::path::PathBuf;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Examples:
  hdralign align *.jpg --transforms transforms.json   write the transforms, for `merge --transforms`
  hdralign align *.jpg --save-aligned aligned_        write aligned_IMG_0001.tif and so on
  hdralign align --align mtb --max-rotation 10 *.jpg --json";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    #[command(flatten)]
    common: Common,

    /// Write the aligned frames as TIFF with the bit depth of the photographs; the file names are PREFIX followed by
    /// the name of the photograph
    #[arg(long, help_heading = OUTPUT, value_name = "PREFIX")]
    save_aligned: Option<PathBuf>,

    /// Write the displacement of every pixel of the reference in every other photograph as TIFF with two 32-bit floats
    /// per pixel; the file names are PREFIX followed by the name of the photograph
    ///
    /// The floats are dx and dy in pixels: a detail at (x, y) in the reference is at (x + dx, y + dy) in the photograph.
    /// They are NaN where the photograph does not show the detail: outside of it, and behind something nearer. See
    /// --local
    #[arg(long, help_heading = OUTPUT, value_name = "PREFIX")]
    displacements: Option<PathBuf>,

    #[command(flatten)]
    results: Results,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let options = Options {
        save_aligned: args.save_aligned.clone(),
        displacements: args.displacements.clone(),
        ..args.results.options(&args.common)
    };
    leftovers::clear(&pipeline::targets(&args.common.aligned.images, &options)?);
    let mut bar = Bar::new(Plan::align(&args.common.aligned.images), args.results.work.quiet);
    let report = pipeline::align_only(&args.common.aligned.images, &options, &|p| bar.show(p));
    bar.clear();
    crate::cli::finish(&report?, &args.results)
}
