//! `hdralign tonemap`.

use crate::cli::arguments::input::Reading;
use crate::cli::arguments::picture::Picture;
use crate::cli::arguments::radiance::Radiance;
use crate::cli::arguments::tone::{self, Tone};
use crate::cli::heading::{OUTPUT, RESOURCES};
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
The input is an .exr, .hdr or .tif file from any program. A .tif file needs floating-point or LogLuv
pixels. hdralign changes values that light cannot have, and prints a warning:
- a pixel with NaN (not a number) becomes black
- infinity becomes the largest finite value of the image, minus infinity its negative
- then a colour with a negative value is made less saturated, so that no value is negative; if its
  luminance is not positive, it becomes black

Examples:
  hdralign tonemap room.exr                           write room.png beside it
  hdralign tonemap room.hdr --brightness 1 -o bright.png
  hdralign tonemap room.hdr -o room.exr               convert the radiance to another format";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP, mut_arg("tmo", |tmo| tmo.value_parser(tone::operators())))]
pub struct Args {
    /// The radiance map (HDR file): .exr, .hdr or .tif
    #[arg(value_name = "IN")]
    input: PathBuf,

    #[command(flatten)]
    tone: Tone,

    #[command(flatten)]
    encoding: Picture,

    /// Write a result: .png .jpg (picture; .jpg with a gain map for HDR displays), .exr .hdr .tif .dng (radiance)
    ///
    /// May be repeated. Without -o and --picture, room.exr gives room.png beside it
    #[arg(short, long, help_heading = OUTPUT, value_name = "OUT")]
    output: Vec<PathBuf>,

    /// Write the picture: .png, .jpg, or .tif with 8 or 16 bits; may be repeated
    #[arg(long, help_heading = OUTPUT, hide_short_help = true, value_name = "FILE")]
    picture: Vec<PathBuf>,

    /// Replace existing files
    #[arg(short, long, help_heading = OUTPUT)]
    force: bool,

    /// Print a JSON report for scripts instead of the names of the results
    ///
    /// It is printed to stdout; everything else goes to stderr
    #[arg(long, help_heading = OUTPUT)]
    json: bool,

    /// Print no progress, summary or warnings, only errors and file names
    ///
    /// Use -q in scripts. The option -q does not change what is printed to stdout: the names of the files written, or
    /// JSON. Errors go to stderr. Without -q, progress is shown if stderr is a terminal
    #[arg(short, long, help_heading = OUTPUT)]
    quiet: bool,

    #[command(flatten)]
    radiance: Radiance,

    /// Set the number of threads [default: one for each core]
    ///
    /// Results do not depend on it
    #[arg(long, help_heading = RESOURCES, value_name = "N")]
    threads: Option<usize>,

    #[command(flatten)]
    reading: Reading,
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
        let picture = options.write.picture.size.of((width, height));
        let resized = match picture == (width, height) {
            true => String::new(),
            false => format!(", picture {} x {}", picture.0, picture.1),
        };
        crate::cli::say(format_args!("{width} x {height} pixels{resized}, {stops:.1} stops, {time:.2} s"));
        if let Some(light) = report.white_balance {
            crate::cli::say(format_args!("white is {}", summary::white(light)));
        }
    }
    let paths = || report.outputs.iter().map(|path| format!("{path}\n")).collect();
    crate::cli::tell(&if args.json { report.to_json() } else { paths() })?;
    Ok(ExitCode::SUCCESS)
}
