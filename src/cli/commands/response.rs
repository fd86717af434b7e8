//! `hdralign response`.

use crate::cli::arguments::input::Aligned;
use crate::cli::arguments::recovery::Recovery;
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
Photographs of one folder are one bracket; a folder stands for the JPEG, PNG and TIFF files in it.
The more brackets of still scenes, and the wider, the better the curve is known.

Examples:
  hdralign response *.jpg                             beside them, named after the camera: Canon_EOS_5D.json
  hdralign response night/ church/ -o 5d.json --plot 5d.svg
  hdralign response *.jpg -o 5d.rsp                   for hdrgen -r 5d.rsp
  hdralign merge --response 5d.json *.jpg             uses it";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP, mut_arg("images", |images| {
    images.help("The photographs of one or many brackets, JPEG, PNG or TIFF, or folders of them")
}))]
pub struct Args {
    #[command(flatten)]
    aligned: Aligned,

    /// The curve; the extension picks the format: .json, .rsp (hdrgen), .csv (luminance-hdr). May be repeated
    /// [default: CAMERA.json beside the first photograph]
    #[arg(short, long, value_name = "FILE", verbatim_doc_comment)]
    output: Vec<PathBuf>,

    /// Draw the curve: .svg or .png. May be repeated
    #[arg(long, value_name = "FILE")]
    plot: Vec<PathBuf>,

    #[command(flatten)]
    recovery: Recovery,

    /// Print a report to standard output, as JSON, instead of the paths written
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let Aligned { images, work, .. } = &args.aligned;
    let options = camera::Options {
        pipeline: pipeline::Options {
            response: args.recovery.model()?,
            exposures: args.recovery.exposures,
            ..args.aligned.options()
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

/// Warnings, and how well the curve is known, on stderr.
fn summarise(report: &CameraReport) {
    let terminal = Terminal::of_stderr();
    summary::warn(&report.warnings, &terminal);
    let frames: usize = report.brackets.iter().map(|b| b.frames.len()).sum();
    let brackets = report.brackets.len();
    let mut words = vec![report.response.model.to_owned(), format!("{frames} frames in {brackets} bracket(s)")];
    if let Some(fits) = &report.response.channels {
        for (fit, name) in fits.iter().zip(["red", "green", "blue"]) {
            let (least, most) = fit.codes;
            words.push(format!("{name} within {:.3} stops over codes {least:.0} to {most:.0}", fit.residual_stops));
        }
    }
    words.push(format!("{:.2} s", report.time_s));
    terminal.wrapped(&words.join(", "), 0).iter().for_each(crate::cli::say);
}
