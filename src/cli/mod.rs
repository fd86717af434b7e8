//! The command line: conversion of arguments to library options, progress, printing, and exit codes.
//!
//! Only results are printed to stdout: the paths of the result files (for `batch` also those of earlier runs), JSON
//! with `--json`, or text that the user requested (the brackets of a dry run, parameters, help, completions, the man
//! page). Everything else goes to stderr.

mod arguments;
mod commands;
mod process;
mod progress;
mod summary;
mod terminal;
mod usage;

use arguments::input::Results;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use hdralign::error::Error;
use hdralign::report::Report;
use std::ffi::OsStr;
use std::io::Write;
use std::process::ExitCode;
use terminal::Terminal;

/// Headings of the groups of options in `--help`.
mod heading {
    pub const MODE: &str = "Mode";
    pub const INPUT: &str = "Input";
    pub const ALIGNMENT: &str = "Alignment";
    pub const MERGE: &str = "Response and merge";
    pub const PICTURE: &str = "Picture";
    pub const OUTPUT: &str = "Output";
    pub const RESOURCES: &str = "Resources";
}

/// Merge photographs of one scene with different exposures to an HDR file (linear radiance) and a finished picture.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100, after_help = AFTER_HELP)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Align and merge a bracket; write an HDR file (radiance) and a picture
    Merge(Box<commands::merge::Args>),
    /// Find the brackets in folders and merge each of them
    Batch(Box<commands::batch::Args>),
    /// Align a bracket: show how each frame moved, optionally write the aligned frames
    Align(commands::align::Args),
    /// Recover the response of a camera (light to pixel values) from one or more brackets
    Response(commands::response::Args),
    /// Draw pictures that show how a bracket was aligned
    Inspect(commands::inspect::Args),
    /// Make a picture from an HDR file (tone mapping), or convert the file to another format
    Tonemap(commands::tonemap::Args),
    /// Compare two radiance maps or two pictures, within a tolerance
    Compare(commands::compare::Args),
    /// Print a script that lets a shell complete commands with the Tab key
    Completions(commands::completions::Args),
    /// Print the manual page (for the Unix command man), or write those of all commands
    Man(commands::man::Args),
}

const AFTER_HELP: &str = "\
Exit codes:
  0  done
  1  failed; no file was written
     (or all files were written completely, and only printing to stdout failed)
  2  wrong usage
  3  written, but degraded; only with --strict, which `hdralign merge --help` explains
  compare: 0 same, 1 different, 2 error
  batch: 0 all brackets done, 1 none done or another error, 3 done in part or with problems,
         which `hdralign batch --help` explains

Examples:
  hdralign merge IMG_0001.JPG IMG_0002.JPG IMG_0003.JPG
  hdralign merge *.jpg -o room.exr -o room.png
  hdralign batch /media/card -d merged
  hdralign align *.jpg --save-aligned aligned_
  hdralign response *.jpg -o camera.json --plot camera.svg
  hdralign inspect *.jpg -d inspection
  hdralign tonemap room.exr -o room.png
  hdralign compare golden/room.exr room.exr";

impl Command {
    /// Returns the name of the command, as typed on the command line.
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

/// Returns the definition of the command line. If a command has options that `-h` does not show, its help says so.
fn program() -> clap::Command {
    Cli::command().mut_subcommands(|command| {
        if !command.get_arguments().any(clap::Arg::is_hide_short_help_set) {
            return command;
        }
        let help =
            clap::Arg::new("help").short('h').long("help").action(clap::ArgAction::Help).help_heading(None::<&str>);
        command.disable_help_flag(true).arg(
            help.help("Print the most used options (--help prints all)")
                .long_help("Print help: -h with the most used options, --help with all"),
        )
    })
}

/// Runs the program with the command line of this process, and returns the exit code.
pub fn run() -> ExitCode {
    process::panics::guarded(run_command)
}

fn run_command() -> ExitCode {
    if let Some(settings) = arguments::tone::settings_asked(program()) {
        return ended("", tell(&settings).map(|()| ExitCode::SUCCESS));
    }
    let parsed = program().try_get_matches().and_then(|m| Ok((Cli::from_arg_matches(&m)?.command, m)));
    let (command, matches) = match parsed {
        Ok(parsed) => parsed,
        Err(asked) => {
            let command = std::env::args_os().nth(1);
            let command = command.as_deref().and_then(OsStr::to_str);
            return answer(&usage::clear(asked, &mut program(), command));
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

/// Returns the exit code of the command `name`. If the command failed, prints the error.
fn ended(name: &str, outcome: Result<ExitCode, Error>) -> ExitCode {
    match outcome {
        Ok(code) => code,
        Err(error) => {
            process::interrupt::give_way();
            // The example contains the name of the command, which the library does not know. So it is appended here.
            let example = match error {
                Error::TooFewFrames { .. } => format!(", as in `hdralign {name} IMG_1.jpg IMG_2.jpg IMG_3.jpg`"),
                _ => String::new(),
            };
            let words = format!("{error}{example}");
            for (i, line) in Terminal::of_stderr().wrapped(&words, 10).iter().enumerate() {
                say(format_args!("{}{line}", if i == 0 { "hdralign: " } else { "          " }));
            }
            // Exit code 1 of `compare` means that the files differ. So an error of `compare` has exit code 2.
            ExitCode::from(if error.is_usage() || name == "compare" { 2 } else { 1 })
        }
    }
}

/// `asked` is what clap returns instead of arguments. Prints it, and returns the exit code. Requested help and version
/// are printed on stdout; an error in the arguments, or the help if there are no arguments, on stderr.
fn answer(asked: &clap::Error) -> ExitCode {
    let printed = asked.print().and_then(|()| std::io::stdout().flush());
    match printed.map_or_else(lost, Ok) {
        Err(error) if !asked.use_stderr() => {
            say(format_args!("hdralign: {error}"));
            ExitCode::FAILURE
        }
        _ => u8::try_from(asked.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from),
    }
}

/// Prints the summary on stderr and the results on stdout, and returns the exit code.
fn finish(report: &Report, options: &Results) -> Result<ExitCode, Error> {
    if !options.work.quiet {
        summary::print(report, options.verbose);
    }
    let mut results = String::new();
    if options.json {
        results = report.to_json();
    } else {
        let own = options.report().map(|path| path.to_string_lossy().into_owned());
        results.extend(report.outputs.iter().cloned().chain(own).map(|path| path + "\n"));
    }
    tell(&results)?;
    Ok(exit_code(options.work.strict && report.is_degraded()))
}

/// Returns exit code 3 if `degraded`, otherwise 0.
fn exit_code(degraded: bool) -> ExitCode {
    if degraded { ExitCode::from(3) } else { ExitCode::SUCCESS }
}

/// Prints results on stdout.
fn tell(results: &str) -> Result<(), Error> {
    let mut stdout = std::io::stdout().lock();
    stdout.write_all(results.as_bytes()).and_then(|()| stdout.flush()).or_else(lost)
}

/// Handles the error of a write to stdout. A closed pipe is not an error of the program, because the result files are
/// complete.
fn lost(source: std::io::Error) -> Result<(), Error> {
    if source.kind() == std::io::ErrorKind::BrokenPipe {
        return Ok(());
    }
    let words = format!("{source}; redirect stdout to another place (the result files are complete)");
    let source = std::io::Error::new(std::io::ErrorKind::InvalidInput, words);
    Err(Error::Write { path: "standard output".into(), source })
}

/// Prints a line on stderr. Errors are ignored, because a full disk or a closed pipe must not stop the run.
fn say(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}
