//! `hdralign inspect`.

use crate::cli::arguments::input::Aligned;
use crate::cli::process::leftovers;
use crate::cli::progress::{Bar, Plan};
use crate::cli::summary;
use crate::cli::terminal::Terminal;
use hdralign::error::Error;
use hdralign::pipeline;
use std::path::PathBuf;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Into the folder go, for each photograph NAME:
  NAME.threshold.png, NAME.exclusion.png   the median threshold bitmap, and what of it counts
  NAME.keypoints.svg, .png                 keypoints: plain, of the bitmap, both
  NAME.matches.svg, .png                   matches with the reference, inliers and outliers
  NAME.xor.svg, .png                       differing pixels against rotation and shift
  NAME.edges.svg, .png                     edges in two colours, before and after alignment
and tables.txt, tables.json: exposures, keypoints, matches, places, bitmaps.

Examples:
  hdralign inspect *.jpg                   beside them, FIRST-LAST.inspect
  hdralign inspect *.jpg -d look --json";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    #[command(flatten)]
    aligned: Aligned,

    /// The folder for everything, made if it is not there [default: FIRST-LAST.inspect beside the photographs]
    #[arg(short = 'd', long, value_name = "FOLDER")]
    folder: Option<PathBuf>,

    /// Print the tables to standard output, as JSON, instead of the paths written
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let Aligned { images, work, .. } = &args.aligned;
    let folder = args.folder.clone().unwrap_or_else(|| pipeline::default_folder(images));
    leftovers::clear(&[folder.join("tables.txt")]);
    let mut bar = Bar::new(Plan::inspect(images), work.quiet);
    let tables = pipeline::inspect(images, &args.aligned.options(), &folder, &|p| bar.show(p));
    bar.clear();
    let tables = tables?;
    if !work.quiet {
        summary::warn(&tables.warnings, &Terminal::of_stderr());
        crate::cli::say(tables.to_text().trim_end_matches('\n'));
    }
    let paths = || tables.outputs.iter().map(|path| format!("{path}\n")).collect();
    crate::cli::tell(&if args.json { tables.to_json() } else { paths() })?;
    Ok(crate::cli::exit_code(work.strict && tables.is_degraded()))
}
