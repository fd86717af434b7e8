//! `hdralign compare`.

use crate::cli::arguments::input::Reading;
use crate::cli::process::leftovers;
use crate::cli::terminal::Terminal;
use hdralign::compare::{self, Blessed, Comparison, Criterion, Options, Tolerance};
use hdralign::error::Error;
use hdralign::pipeline;
use std::path::PathBuf;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Exit codes, the same as of cmp and diff:
  0  same within the tolerance, or accepted with --bless
  1  different, or not of the same size
  2  error: wrong usage, a file that cannot be read or written, radiance compared with a picture

Examples:
  hdralign compare golden/room.exr room.exr
  hdralign compare golden/room.png room.png --tolerance-de 1 --max-differing 0.1
  hdralign compare golden/room.png room.png --min-psnr 45
  hdralign compare golden/room.exr room.exr --diff room-diff.png --json > room.json
  hdralign compare golden/room.exr room.exr --bless     accept the new result";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    /// The expected file: radiance (.exr, .hdr, .tif with floats or LogLuv) or a picture (.png, .jpg, .tif with
    /// integers)
    #[arg(value_name = "EXPECTED")]
    expected: PathBuf,

    /// The file to check
    #[arg(value_name = "ACTUAL")]
    actual: PathBuf,

    /// Set the largest difference allowed in any channel of radiance, in stops [default: 0.01]
    #[arg(long, value_name = "STOPS", conflicts_with = "tolerance_de", allow_negative_numbers = true)]
    tolerance_stops: Option<f64>,

    /// Set the largest difference allowed in any pixel of a picture, in CIEDE2000 [default: 0]
    ///
    /// A difference of about 1 is just visible side by side. In dark parts, a step of 1 in the pixel values can be a
    /// difference of more than 1
    #[arg(long, value_name = "DE", allow_negative_numbers = true)]
    tolerance_de: Option<f64>,

    /// Set the percentage of pixels that may exceed the tolerance
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, allow_negative_numbers = true)]
    max_differing: f64,

    /// Instead of the tolerance, require that the whole images are at least this similar (PSNR, in dB)
    ///
    /// A higher PSNR means more similar. For pictures it is computed from the pixel values, for radiance from PU21
    /// values: PU21 is a scale on which equal differences look equally large
    #[arg(
        long,
        value_name = "DB",
        conflicts_with_all = ["tolerance_stops", "tolerance_de", "max_differing"],
        allow_negative_numbers = true
    )]
    min_psnr: Option<f64>,

    /// Write the expected image, the difference in false colours and the actual image side by side
    #[arg(long, value_name = "PNG")]
    diff: Option<PathBuf>,

    /// Accept the result: copy ACTUAL to EXPECTED, even without --force, and exit with 0
    #[arg(long)]
    bless: bool,

    #[command(flatten)]
    reading: Reading,

    /// Replace an existing file of --diff
    #[arg(short, long)]
    force: bool,

    /// Print the comparison as JSON to stdout
    #[arg(long)]
    json: bool,

    /// Print no summary or warnings, only errors and file names
    ///
    /// Use -q in scripts. The option -q does not change what is printed to stdout: the names of the files written, or
    /// JSON. Errors go to stderr
    #[arg(short, long)]
    quiet: bool,
}

impl Args {
    fn options(&self) -> Options {
        let criterion = match self.min_psnr {
            Some(least_db) => Criterion::Psnr { least_db },
            None => Criterion::Pixels {
                tolerance: match (self.tolerance_stops, self.tolerance_de) {
                    (Some(stops), _) => Tolerance::Stops(stops),
                    (None, Some(de)) => Tolerance::DeltaE(de),
                    (None, None) => Tolerance::ByKind,
                },
                most_differing_percent: self.max_differing,
            },
        };
        Options { criterion, diff: self.diff.clone(), overwrite: self.force, allowed: self.reading.limits() }
    }
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let terminal = Terminal::of_stderr();
    let say = |line: &str| {
        if !args.quiet {
            crate::cli::say(line);
        }
    };
    pipeline::start_threads(None)?;
    leftovers::clear(&args.diff.iter().chain(args.bless.then_some(&args.expected)).collect::<Vec<_>>());
    let compared = match compare::files(&args.expected, &args.actual, &args.options()) {
        Ok(compared) => Some(compared),
        // With --bless, the actual file replaces the expected file. So the expected file may be missing or damaged.
        Err(Error::Read { path, .. } | Error::Decode { path, .. } | Error::NotComparable { path, .. })
            if args.bless && path == args.expected =>
        {
            None
        }
        Err(error) => return Err(error),
    };
    if let Some(compared) = &compared {
        summary(compared, &terminal).iter().for_each(|line| say(line));
    }
    let mut results = match (&compared, args.json) {
        (Some(compared), true) => compared.to_json(),
        (Some(compared), false) => compared.diff.iter().map(|path| format!("{path}\n")).collect(),
        (None, _) => String::new(),
    };
    let mut code = ExitCode::from(if compared.as_ref().is_some_and(Comparison::is_same) { 0 } else { 1 });
    if args.bless {
        let (expected, actual) = (args.expected.display(), args.actual.display());
        let (blessed, warnings) = compare::bless(&args.expected, &args.actual, &args.reading.limits())?;
        warnings.iter().for_each(|warning| say(&format!("warning: {warning}")));
        say(&match blessed {
            Blessed::Created => format!("accepted: {expected} did not exist; it is now a copy of {actual}"),
            Blessed::Replaced => format!("accepted: {expected} is now a copy of {actual}"),
            Blessed::Unchanged => format!("accepted, nothing to do: {expected} already has the same bytes as {actual}"),
        });
        if !args.json && blessed != Blessed::Unchanged {
            results += &format!("{expected}\n");
        }
        code = ExitCode::SUCCESS;
    }
    crate::cli::tell(&results)?;
    Ok(code)
}

/// Returns the lines to print: whether the files are the same, and the measured differences.
fn summary(compared: &Comparison, terminal: &Terminal) -> Vec<String> {
    let bytes = if compared.bytes_equal { ", byte for byte" } else { "" };
    let name = if compared.is_same() { "same" } else { "differs" };
    let verdict = if compared.is_same() { terminal.good(name) } else { terminal.bad(name) };
    let reason = terminal.wrapped(&format!("{}{bytes}", compared.reason), name.len() + 2);
    let mut lines: Vec<String> = reason
        .iter()
        .enumerate()
        .map(|(i, line)| if i == 0 { format!("{verdict}: {line}") } else { format!("  {line}") })
        .collect();
    let mut row = |name: &str, text: String| {
        for (i, line) in terminal.wrapped(&text, 12).iter().enumerate() {
            lines.push(format!("  {:10}{line}", if i == 0 { name } else { "" }));
        }
    };
    if let Some(largest) = compared.differing.as_ref().and_then(|d| d.largest.as_ref()) {
        let off = match (largest.stops, largest.de) {
            (Some(stops), _) => format!("{stops:.3} stops"),
            (_, Some(de)) => format!("dE {de:.2}"),
            _ => "a value is NaN or infinite, in a file or after conversion".into(),
        };
        let values = |rgb: [Option<f64>; 3]| rgb.map(|v| v.map_or("-".into(), number)).join(" ");
        let (expected, actual) = (values(largest.expected), values(largest.actual));
        let place = (largest.x_px, largest.y_px);
        row("largest", format!("{off}, at x {}, y {} (expected {expected}, actual {actual})", place.0, place.1));
    }
    let is_off = compared.pixels_equal == Some(false);
    if let Some(radiance) = compared.radiance.as_ref().filter(|_| is_off) {
        for c in &radiance.channels {
            let (max, rms, mean) = (c.max_stops, c.rms_stops, c.mean_stops);
            row(c.channel, format!("at most {max:.3} stops, RMS {rms:.4}, mean {mean:+.4}"));
        }
        if radiance.not_comparable_pixels > 0 {
            row(
                "odd",
                format!(
                    "pixels that differ because a value is NaN or infinite, in a file or after conversion: {}",
                    radiance.not_comparable_pixels
                ),
            );
        }
        // If the mean of the differences in stops is almost equal to their RMS, most pixels differ by nearly the same
        // factor.
        let (mean, rms) = (radiance.mean_stops, radiance.rms_stops);
        if mean.abs() > 0.002 && mean.abs() > 0.97 * rms {
            let word = if mean > 0.0 { "brighter" } else { "darker" };
            row("gain", format!("most of ACTUAL is {word} by nearly the same factor: {:.3} stops", mean.abs()));
        }
    }
    if let Some(display) = compared.display.as_ref().filter(|_| is_off) {
        let codes = display.channels.map(|c| c.max_codes.to_string()).join(", ");
        let depth = [&compared.expected, &compared.actual].into_iter().filter_map(|side| side.depth_bits).max();
        let most = depth.map_or_else(String::new, |bits| format!(" of {}", (1_u64 << bits) - 1));
        row("codes", format!("differ by at most {codes}{most} in red, green, blue"));
        row("colour", format!("at most dE {:.2}, mean {:.3}", display.de_max, display.de_mean));
        if let Some(psnr) = display.psnr_db {
            row("PSNR", format!("{psnr:.2} dB"));
        }
    }
    if is_off {
        let psnr = compared.pu21_psnr_db.map(|db| format!("PU21-PSNR {db:.2} dB"));
        let structure = compared.ms_ssim.map(|s| format!("MS-SSIM {s:.5}"));
        let both: Vec<String> = psnr.into_iter().chain(structure).collect();
        if !both.is_empty() {
            row("quality", both.join(", "));
        }
    }
    for changed in &compared.metadata {
        let words = |text: &Option<String>| text.as_ref().map_or("none".into(), |t| one_line(t));
        let (expected, actual) = (words(&changed.expected), words(&changed.actual));
        row("header", format!("{}: expected {expected}, actual {actual} (for information)", changed.key));
    }
    for warning in &compared.warnings {
        row("warning", warning.clone());
    }
    lines
}

/// Returns `value` as text: whole numbers below 100000 exactly, other numbers with four or five significant digits.
fn number(value: f64) -> String {
    if value == 0.0 || value.fract() == 0.0 && value.abs() < 1e5 {
        format!("{value}")
    } else if (1e-3..1e5).contains(&value.abs()) {
        format!("{value:.*}", (4.0 - value.abs().log10()).clamp(0.0, 7.0) as usize)
    } else {
        format!("{value:.4e}")
    }
}

/// Returns the first 60 characters of the header value `text`, on one line.
fn one_line(text: &str) -> String {
    let line: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(60).collect();
    line.trim().to_owned()
}
