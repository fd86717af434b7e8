//! `hdralign inspect`.

use crate::cli::arguments::input::{Aligned, Work};
use crate::cli::heading::OUTPUT;
use crate::cli::process::leftovers;
use crate::cli::progress::{Bar, Plan};
use crate::cli::summary;
use crate::cli::terminal::Terminal;
use hdralign::error::Error;
use hdralign::pipeline;
use std::path::PathBuf;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Files, for each photograph NAME (for the reference frame only the first three kinds):
  NAME.threshold.png                       median threshold bitmap: pixels brighter than a grey
                                           value (usually the median) are white, others black
  NAME.exclusion.png                       white: pixels that are compared; black: excluded,
                                           because they are close to the grey value
  NAME.keypoints.svg, .png                 keypoints: distinctive details, found in the
                                           photograph, in its threshold bitmaps, or in both
  NAME.matches.svg, .png                   keypoints that match one in the reference frame: inliers
                                           (they agree on one motion) and outliers (they do not)
  NAME.xor.svg, .png                       share of compared pixels in which the bitmaps of frame
                                           and reference differ, as curves over rotation and shift
  NAME.edges.svg, .png                     edges of frame and reference, before and after alignment
and tables.txt, tables.json with exposures, keypoints, matches, transforms and bitmaps.

Examples:
  hdralign inspect *.jpg                   write to FIRST-LAST.inspect beside the photographs
  hdralign inspect *.jpg -d look --json";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    #[command(flatten)]
    aligned: Aligned,

    /// Set the folder for the files; it is created if it does not exist [default: FIRST-LAST.inspect beside the photographs]
    ///
    /// The folder that contains it must exist
    #[arg(short = 'd', long, help_heading = OUTPUT, value_name = "FOLDER")]
    folder: Option<PathBuf>,

    /// Print the tables as JSON for scripts instead of the names of the files
    ///
    /// They are printed to stdout; everything else goes to stderr
    #[arg(long, help_heading = OUTPUT)]
    json: bool,

    #[command(flatten)]
    work: Work,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let (images, work) = (&args.aligned.images, &args.work);
    let folder = args.folder.clone().unwrap_or_else(|| pipeline::default_folder(images));
    leftovers::clear(&[folder.join("tables.txt")]);
    let mut bar = Bar::new(Plan::inspect(images), work.quiet);
    let tables = pipeline::inspect(images, &args.aligned.options(work), &folder, &|p| bar.show(p));
    bar.clear();
    let tables = tables?;
    if !work.quiet {
        summary::warn(&tables.warnings, &Terminal::of_stderr());
        crate::cli::say(tables.to_text().trim_end_matches('\n'));
        crate::cli::say(format!(
            "\nTime for keypoints and matches of all frames: SIFT {:.1} s, SURF {:.1} s",
            tables.times.sift_s, tables.times.surf_s
        ));
    }
    let paths = || tables.outputs.iter().map(|path| format!("{path}\n")).collect();
    crate::cli::tell(&if args.json { tables.to_json() } else { paths() })?;
    Ok(crate::cli::exit_code(work.strict && tables.is_degraded()))
}
