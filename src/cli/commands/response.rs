//! `hdralign response`.

use crate::cli::arguments::input::{Aligned, Work};
use crate::cli::arguments::recovery::Recovery;
use crate::cli::commands::batch::found::many;
use crate::cli::heading::OUTPUT;
use crate::cli::process::leftovers;
use crate::cli::progress::{Bar, Plan};
use crate::cli::summary;
use crate::cli::terminal::Terminal;
use hdralign::error::Error;
use hdralign::pipeline;
use hdralign::pipeline::camera::{self, CameraReport};
use std::path::PathBuf;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Photographs of the same folder are one bracket. A folder stands for its JPEG, PNG and TIFF files.
The response is better with several brackets, with a wide range of exposures, and without motion.

Examples:
  hdralign response *.jpg                             write Canon_EOS_5D.json beside the photographs
  hdralign response night/ church/ -o 5d.json --plot 5d.svg
  hdralign response *.jpg -o 5d.rsp                   write a file for `hdrgen -r`
  hdralign merge --response 5d.json *.jpg             use it";

/// Returns `arg`, an argument that several commands share, with the help text for this command.
fn adapted(arg: clap::Arg) -> clap::Arg {
    match arg.get_id().as_str() {
        "images" => arg.help("Photographs (JPEG, PNG or TIFF) of one or several brackets, or folders of photographs"),
        "reference" => arg
            .help("Set the reference frame of each bracket by its number (1 is the first); if there is one bracket, a file name works too")
            .long_help(
                "Set the reference frame of each bracket by its number (1 is the first); if there is one bracket, a file name works too\n\n\
                 The other frames are aligned to it. Photographs are numbered within their bracket: in the \
                 order of the command or, if a folder is given, in the order of their names. By default, \
                 the reference is the best exposed frame",
            ),
        "ev" => arg
            .help("Set the exposures in EV, one for each photograph, in the order of the photographs in the command; only if there is one bracket")
            .long_help(
                "Set the exposures in EV, one for each photograph, in the order of the photographs in the command; only if there is one bracket\n\n\
                 With -e=-2,0,2 the first photograph is the darkest. *.jpg or a folder stands for the files in the order of their names. \
                 These exposures replace those in EXIF, and are used even if the brightness of the photographs contradicts them",
            ),
        _ => arg,
    }
}

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP, mut_args(adapted))]
pub struct Args {
    #[command(flatten)]
    aligned: Aligned,

    #[command(flatten)]
    recovery: Recovery,

    /// Write the response: .json, .rsp (hdrgen) or .csv (luminance-hdr); may be repeated [default: CAMERA.json beside the first photograph]
    #[arg(short, long, help_heading = OUTPUT, value_name = "FILE")]
    output: Vec<PathBuf>,

    /// Draw the response: .svg or .png; may be repeated
    #[arg(long, help_heading = OUTPUT, value_name = "FILE")]
    plot: Vec<PathBuf>,

    /// Print a JSON report for scripts instead of the names of the results
    ///
    /// It is printed to stdout; everything else goes to stderr
    #[arg(long, help_heading = OUTPUT)]
    json: bool,

    #[command(flatten)]
    work: Work,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let (images, work) = (&args.aligned.images, &args.work);
    let options = camera::Options {
        pipeline: pipeline::Options {
            response: args.recovery.model()?,
            exposures: args.recovery.exposures,
            ..args.aligned.options(work)
        },
        curves: args.output.clone(),
        plots: args.plot.clone(),
        lenient: false,
    };
    leftovers::clear(&options.targets(images));
    let mut bar = Bar::new(Plan::unknown(), work.quiet);
    let report = camera::run(images, &options, &|p| bar.show(p));
    bar.clear();
    let report = report?;
    if !work.quiet {
        summarise(&report);
    }
    let paths = || report.outputs.iter().map(|path| format!("{path}\n")).collect();
    crate::cli::tell(&if args.json { report.to_json() } else { paths() })?;
    Ok(crate::cli::exit_code(work.strict && report.is_degraded()))
}

/// Prints the warnings and the accuracy of the response on stderr.
fn summarise(report: &CameraReport) {
    let terminal = Terminal::of_stderr();
    summary::warn(&report.warnings, &terminal);
    let frames: usize = report.brackets.iter().map(|b| b.frames.len()).sum();
    let brackets = report.brackets.len();
    let mut words = vec![report.response.model.to_owned(), format!("{frames} frames in {}", many(brackets, "bracket"))];
    if let Some(fits) = &report.response.channels {
        for (fit, name) in fits.iter().zip(["red", "green", "blue"]) {
            let (least, most) = fit.codes;
            words.push(format!("{name}: error {:.3} stops (pixel values {least:.0} to {most:.0})", fit.residual_stops));
        }
    }
    words.push(format!("{:.2} s", report.time_s));
    terminal.wrapped(&words.join(", "), 0).iter().for_each(crate::cli::say);
}
