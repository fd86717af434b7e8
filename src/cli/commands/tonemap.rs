//! `hdralign tonemap`.

use crate::cli::arguments::input::Reading;
use crate::cli::arguments::picture::Picture;
use crate::cli::arguments::radiance::Radiance;
use crate::cli::arguments::tone::Tone;
use crate::cli::process::leftovers;
use crate::cli::progress::{Bar, Plan};
use crate::cli::summary;
use crate::cli::terminal::Terminal;
use hdralign::error::Error;
use hdralign::pipeline::{self, TonemapOptions};
use hdralign::write;
use std::path::PathBuf;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Reads .exr (half, float, uint), .hdr (RGBE, XYZE) and .tif (float, LogLuv) of any program, known by content.
Values that are no numbers are shown black, infinite ones as the brightest other, negative ones are
drawn to grey until none is; a warning counts them.

Examples:
  hdralign tonemap room.exr                           beside it, room.png
  hdralign tonemap room.hdr -o bright.png
  hdralign tonemap room.hdr -o room.exr               the same radiance in another format";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    /// The radiance map: .exr, .hdr or .tif
    #[arg(value_name = "IN")]
    input: PathBuf,

    /// A result; the extension picks the format: .png (picture), .jpg (picture that lights up on
    /// HDR displays), .exr .hdr .tif (radiance). May be repeated
    /// [default, without --picture: IN as .png, beside it]
    #[arg(short, long, value_name = "OUT", verbatim_doc_comment)]
    output: Vec<PathBuf>,

    /// The picture, whatever the extension: .png, .jpg, or .tif of codes with a profile. May be repeated
    #[arg(long, value_name = "FILE")]
    picture: Vec<PathBuf>,

    #[command(flatten)]
    tone: Tone,

    #[command(flatten)]
    encoding: Picture,

    #[command(flatten)]
    radiance: Radiance,

    /// Threads that compute [default: one for each core]; the results are the same
    #[arg(long, value_name = "N")]
    threads: Option<usize>,

    #[command(flatten)]
    reading: Reading,

    /// Replace files that exist
    #[arg(short, long)]
    force: bool,

    /// Print a report to standard output, as JSON, instead of the paths written
    #[arg(long)]
    json: bool,

    /// No progress, summary or warnings; results are still listed on stdout
    #[arg(short, long)]
    quiet: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let outputs = match args.output.as_slice() {
        [] if args.picture.is_empty() => vec![pipeline::default_picture(&args.input)],
        named => named.to_vec(),
    };
    let options = TonemapOptions {
        operator: args.tone.operator()?,
        colour: args.radiance.colour(),
        outputs,
        pictures: args.picture.clone(),
        write: write::Options { picture: args.encoding.options(), ..args.radiance.write(args.force) },
        threads: args.threads,
        limits: args.reading.limits(),
    };
    leftovers::clear(&[&options.outputs[..], &options.pictures].concat());
    let mut bar = Bar::new(Plan::tonemap(&args.input), args.quiet);
    let report = pipeline::tonemap_file(&args.input, &options, &|p| bar.show(p));
    bar.clear();
    let report = report?;
    if !args.quiet {
        summary::warn(&report.warnings, &Terminal::of_stderr());
        let stops = report.radiance.dynamic_range_stops;
        let (width, height, time) = (report.width_px, report.height_px, report.time_s.total);
        crate::cli::say(format_args!("{width} x {height} pixels, {stops:.1} stops, {time:.2} s"));
        if let Some(light) = report.white_balance {
            crate::cli::say(format_args!("white is {}", summary::white(light)));
        }
    }
    let paths = || report.outputs.iter().map(|path| format!("{path}\n")).collect();
    crate::cli::tell(&if args.json { report.to_json() } else { paths() })?;
    Ok(ExitCode::SUCCESS)
}
