//! The command line: arguments to library options, progress, printing, exit codes.
//!
//! stdout carries results alone: the paths written, or JSON with `--json`. Everything else goes to stderr.

mod arguments;
mod commands;
mod process;
mod progress;
mod summary;
mod terminal;
mod usage;

use arguments::input::Common;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use hdralign::error::Error;
use hdralign::report::Report;
use std::ffi::OsStr;
use std::io::Write;
use std::process::ExitCode;
use terminal::Terminal;

/// Groups of options in `--help`.
mod heading {
    pub const INPUT: &str = "Input";
    pub const ALIGNMENT: &str = "Alignment";
    pub const MERGE: &str = "Response and merge";
    pub const PICTURE: &str = "Picture";
    pub const OUTPUT: &str = "Output";
    pub const RESOURCES: &str = "Resources";
}

/// Aligns a bracket of exposures, recovers the camera's response, merges to linear radiance, and tone-maps.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100, after_help = AFTER_HELP)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Align, calibrate, merge, tone-map and write
    Merge(Box<commands::merge::Args>),
    /// Find the brackets in folders, and merge them all
    Batch(Box<commands::batch::Args>),
    /// Align only: transforms as JSON, aligned frames as TIFF
    Align(commands::align::Args),
    /// Recover a camera's response from one or many brackets, save and draw it
    Response(commands::response::Args),
    /// Tables and drawings of what the alignment rests on: look before, or find out why
    Inspect(commands::inspect::Args),
    /// Tone-map a radiance map again, without merging again
    Tonemap(commands::tonemap::Args),
    /// Are two radiance maps, or two pictures, the same within a tolerance? The exit code says
    Compare(commands::compare::Args),
    /// Print what a shell needs to complete commands and options
    Completions(commands::completions::Args),
    /// Print the man page, or write those of all commands
    Man(commands::man::Args),
}

const AFTER_HELP: &str = "\
Exit codes:
  0  done
  1  failed, nothing written
  2  wrong usage
  3  with --strict: written, but a frame was left out, assumed or doubtful, the frames overlap by
     less than half, or an exposure or the response was guessed
  compare: 0 the same, 1 they differ, 2 trouble
  batch: 0 all brackets done, 1 none, 3 some

Examples:
  hdralign merge IMG_0001.JPG IMG_0002.JPG IMG_0003.JPG
  hdralign merge *.jpg -o room.exr -o room.png
  hdralign batch /media/card -d merged
  hdralign align *.jpg --save-aligned aligned_
  hdralign response *.jpg -o camera.json --plot camera.svg
  hdralign inspect *.jpg -d look
  hdralign tonemap room.exr -o room.png
  hdralign compare golden/room.exr room.exr";

impl Command {
    /// As it is typed.
    fn name(&self) -> &'static str {
        match self {
            Command::Merge(_) => "merge",
            Command::Batch(_) => "batch",
            Command::Align(_) => "align",
            Command::Response(_) => "response",
            Command::Inspect(_) => "inspect",
            Command::Tonemap(_) => "tonemap",
            Command::Compare(_) => "compare",
            Command::Completions(_) => "completions",
            Command::Man(_) => "man",
        }
    }
}

/// Runs the command line of this process.
pub fn run() -> ExitCode {
    process::panics::guarded(run_command)
}

fn run_command() -> ExitCode {
    if let Some(settings) = arguments::tone::settings_asked(Cli::command()) {
        return ended("", tell(&settings).map(|()| ExitCode::SUCCESS));
    }
    let parsed = Cli::command().try_get_matches().and_then(|m| Ok((Cli::from_arg_matches(&m)?.command, m)));
    let (command, matches) = match parsed {
        Ok(parsed) => parsed,
        Err(asked) => {
            let command = std::env::args_os().nth(1);
            let command = command.as_deref().and_then(OsStr::to_str);
            return answer(&usage::told(asked, &mut Cli::command(), command));
        }
    };
    process::allocator::give_back_soon(&matches);
    let name = command.name();
    process::interrupt::listen();
    let outcome = match command {
        Command::Merge(args) => commands::merge::run(&args),
        Command::Batch(args) => commands::batch::run(&args, matches.subcommand().map(|(_, matches)| matches)),
        Command::Align(args) => commands::align::run(&args),
        Command::Response(args) => commands::response::run(&args),
        Command::Inspect(args) => commands::inspect::run(&args),
        Command::Tonemap(args) => commands::tonemap::run(&args),
        Command::Compare(args) => commands::compare::run(&args),
        Command::Completions(args) => commands::completions::run(&args),
        Command::Man(args) => commands::man::run(&args),
    };
    ended(name, outcome)
}

/// The exit code of the command `name`; what failed is told.
fn ended(name: &str, outcome: Result<ExitCode, Error>) -> ExitCode {
    match outcome {
        Ok(code) => code,
        Err(error) => {
            process::interrupt::give_way();
            // The library knows of no commands.
            let example = match error {
                Error::TooFewFrames { .. } => format!(", as in `hdralign {name} IMG_1.jpg IMG_2.jpg IMG_3.jpg`"),
                _ => String::new(),
            };
            let words = format!("{error}{example}");
            for (i, line) in Terminal::of_stderr().wrapped(&words, 10).iter().enumerate() {
                say(format_args!("{}{line}", if i == 0 { "hdralign: " } else { "          " }));
            }
            // 1 is the answer of `compare` that files differ: trouble is something else.
            ExitCode::from(if error.is_usage() || name == "compare" { 2 } else { 1 })
        }
    }
}

/// Help and the version, which are results, or what is wrong with the arguments.
fn answer(asked: &clap::Error) -> ExitCode {
    let told = asked.print().and_then(|()| std::io::stdout().flush());
    match told.map_or_else(lost, Ok) {
        Err(error) if !asked.use_stderr() => {
            say(format_args!("hdralign: {error}"));
            ExitCode::FAILURE
        }
        _ => u8::try_from(asked.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from),
    }
}

/// Tells what was done, and gives the exit code.
fn finish(report: &Report, common: &Common) -> Result<ExitCode, Error> {
    if !common.aligned.work.quiet {
        summary::print(report, common.verbose);
    }
    let mut results = String::new();
    if common.json {
        results = report.to_json();
    } else {
        let own = common.report().map(|path| path.to_string_lossy().into_owned());
        results.extend(report.outputs.iter().cloned().chain(own).map(|path| path + "\n"));
    }
    tell(&results)?;
    Ok(exit_code(common.aligned.work.strict && report.is_degraded()))
}

/// 3 where the result is less than what was asked for and that matters.
fn exit_code(degraded: bool) -> ExitCode {
    if degraded { ExitCode::from(3) } else { ExitCode::SUCCESS }
}

/// Puts results on stdout.
fn tell(results: &str) -> Result<(), Error> {
    let mut stdout = std::io::stdout().lock();
    stdout.write_all(results.as_bytes()).and_then(|()| stdout.flush()).or_else(lost)
}

/// What it means that stdout took no more: a reader that has heard enough is no failure, for files are written.
fn lost(source: std::io::Error) -> Result<(), Error> {
    if source.kind() == std::io::ErrorKind::BrokenPipe {
        return Ok(());
    }
    let words = format!("{source}; send it elsewhere (files that were to be written are, and are whole)");
    let source = std::io::Error::new(std::io::ErrorKind::InvalidInput, words);
    Err(Error::Write { path: "standard output".into(), source })
}

/// Puts a line on stderr. Where nobody can have it, as on a full disk or by a pipe whose reader is gone, the work goes on all the same.
fn say(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}
