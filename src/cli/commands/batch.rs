//! `hdralign batch`.

pub mod found;
mod night;

use crate::cli::arguments::choice::choice;
use crate::cli::arguments::input::{Cut, Method, Work};
use crate::cli::arguments::merging::Merging;
use crate::cli::heading::{INPUT, MERGE, MODE, OUTPUT, RESOURCES};
use clap::parser::ValueSource;
use clap::{ArgAction, ArgMatches, Parser};
use hdralign::batch::find::{self, FindOptions};
use hdralign::batch::job;
use hdralign::batch::name::Template;
use hdralign::batch::plan::{self, Job, Normalisation, Responses, Settings};
use hdralign::batch::summary::{Outcome, Summary};
use hdralign::bracket::{LoadOptions, ReferenceChoice};
use hdralign::error::Error;
use hdralign::pipeline::{self, Options};
use hdralign::write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Examples:
  hdralign batch /media/card --dry-run                list the brackets
  hdralign batch /media/card -d merged                merge them; a second run merges what changed
  hdralign batch scans --by-folder -e=-2,0,2          without EXIF: each folder is a bracket
  hdralign batch pano -d out --shared-response --normalize set --formats exr
  hdralign batch /photos -d out --plan > plan.jsonl   plan for Snakemake, Slurm or GNU parallel
  hdralign batch --run plan.jsonl --id ID             do one job of a plan
  hdralign batch --summarize plan.jsonl               write the summary of a plan";

const AFTER_LONG_HELP: &str = "\
If none of --dry-run, --plan, --run and --summarize is given, batch merges all brackets it finds.
A second run skips what is done. A plan lists the jobs for a scheduler such as Slurm: each job
is run by --run PLAN --id ID, on any machine; --summarize PLAN combines the results at the end.

Exit codes:
  0  all brackets done
  1  nothing done, no bracket found, or another error
  2  wrong usage
  3  one of these:
     - some brackets are done, others are not
     - all brackets are done, but a photograph or folder could not be read
     - all brackets are done, but the summary could not be written at the end
     - all brackets are done, but a result is degraded (only with --strict)
Results of earlier runs count like those of this run. With --dry-run and --plan, every listed
bracket counts as done, and files that cannot be read do not change the code. With
--shared-response, the code is also 3 if the response of a camera was recovered, but no bracket was
merged.
";

/// Returns `arg`, an argument that several commands share, with the help text for this command.
fn adapted(arg: clap::Arg) -> clap::Arg {
    let arg = match arg.get_id().as_str() {
        "ev" => arg.help("Set the exposures in EV, in the order in which the frames were taken").long_help(
            "Set the exposures in EV, in the order in which the frames were taken\n\n\
                 With -e=-2,0,2 the first frame of each bracket is the darkest. Frames without a time in EXIF \
                 are in the order of their names. These exposures replace those in EXIF, and are used even if the \
                 brightness of the photographs contradicts them",
        ),
        "force" => arg.help("Merge all brackets again; replace files that have the same names"),
        "threads" => arg.help("Set the total number of threads [default: one for each core]").long_help(
            "Set the total number of threads [default: one for each core]\n\n\
                 Results do not depend on it",
        ),
        _ => arg,
    };
    if RARE.contains(&arg.get_id().as_str()) { arg.hide_short_help(true) } else { arg }
}

/// Shared options that `-h` does not show for `batch`, although it shows them for other commands.
const RARE: [&str; 9] =
    ["align", "crop", "resize", "white_balance", "brightness", "contrast", "saturation", "shadows", "highlights"];

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP, after_long_help = format!("{AFTER_LONG_HELP}\n{AFTER_HELP}"))]
#[command(mut_args(adapted))]
pub struct Args {
    /// The folders to search, with their subfolders; not with --run or --summarize
    #[arg(value_name = "FOLDER", required_unless_present_any = ["run", "summarize", "name"])]
    folders: Vec<PathBuf>,

    /// List the brackets, and the photographs without a bracket; merge nothing
    ///
    /// Photographs without a bracket are listed with the reason, at most 20 for each reason; with --json, all
    #[arg(long, help_heading = MODE)]
    dry_run: bool,

    /// For schedulers: print the jobs, a line of JSON for each (the plan)
    #[arg(long, help_heading = MODE, conflicts_with = "dry_run")]
    plan: bool,

    /// For schedulers: run jobs of a plan; select them with --id
    #[arg(long, help_heading = MODE, value_name = "PLAN", requires = "id", conflicts_with_all = ["folders", "plan", "dry_run", "summarize"])]
    run: Option<PathBuf>,

    /// Select a job of the plan; required with --run, may be repeated
    #[arg(long, help_heading = MODE, value_name = "ID", requires = "run")]
    id: Vec<String>,

    /// Combine the results of the jobs of a plan into batch.json and batch.csv
    #[arg(long, help_heading = MODE, value_name = "PLAN", conflicts_with_all = ["folders", "plan", "dry_run"])]
    summarize: Option<PathBuf>,

    #[command(flatten)]
    finding: Finding,

    #[command(flatten)]
    acting: Acting,

    /// Read the camera response from a file: .json, .rsp or .csv
    #[arg(long, help_heading = MERGE, value_name = "FILE", conflicts_with_all = ["response_model", "response_degree", "shared_response"])]
    response: Option<PathBuf>,

    /// Recover one response for each camera, from all its brackets
    #[arg(long, help_heading = MERGE)]
    shared_response: bool,

    #[command(flatten)]
    places: Places,

    /// Print a JSON summary to stdout instead of the names of the results
    ///
    /// With --dry-run, print the brackets that were found. No effect with --plan and --run
    #[arg(long, help_heading = OUTPUT)]
    json: bool,

    /// Also print the warnings of this run, and the brackets already done
    ///
    /// By default, each bracket that is merged gets a line with the number of its warnings. The summary at the end
    /// counts the brackets already done. The summary also shows the first warning of each degraded result, for at most
    /// 10 results. With -v, the warnings of a merged bracket follow its line, and each bracket already done gets a line
    /// too. With -q, stdout still gets the file names, JSON, or the list of --dry-run; stderr gets only errors, and
    /// messages after Ctrl-C or another signal. -v has no effect with --dry-run, --plan, --run or --summarize
    #[arg(short, long, help_heading = OUTPUT, conflicts_with = "quiet")]
    verbose: bool,

    #[command(flatten)]
    work: Work,

    /// Set the number of brackets merged at the same time
    ///
    /// By default, N is the number of threads. If memory is short, fewer brackets are merged at the same time. The
    /// results do not depend on N
    #[arg(long, help_heading = RESOURCES, value_name = "N")]
    jobs: Option<usize>,
}

/// Names and formats of the results.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = OUTPUT)]
struct Places {
    /// Set the folder for the results [default: beside the photographs]
    ///
    /// With `batch night -d out`, results of night/x/IMG_1.jpg go to out/x. If several of the given folders contain
    /// brackets, the results go to out/night/x. The folder given with -d is searched only if it is also one of the folders
    /// to search
    #[arg(short = 'd', long = "output-folder", value_name = "FOLDER")]
    output: Option<PathBuf>,

    /// Set the names of the results; `--name help` lists the fields
    #[arg(long, value_name = "TEMPLATE", default_value = "{folder}/{first}-{last}")]
    name: String,

    /// Set formats: exr hdr tif dng (radiance), png jpg
    ///
    /// The given formats replace the default formats. exr, hdr, tif and dng contain the radiance, png and jpg the picture.
    /// For a .tif with the picture give --pictures tif
    #[arg(long, value_name = "FORMAT,...", value_delimiter = ',', default_value = "exr,png")]
    formats: Vec<String>,

    /// In addition to --formats, write the picture as tif, png or jpg
    ///
    /// Use it for a picture as tif, because tif in --formats means radiance
    #[arg(long, value_name = "FORMAT,...", value_delimiter = ',')]
    pictures: Vec<String>,

    /// Also write an HTML report for each bracket
    #[arg(long)]
    page: bool,
}

/// How brackets are found.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = INPUT)]
struct Finding {
    /// Expect exactly N photographs in each bracket
    ///
    /// Photographs whose EXIF has no exposure are then used too. Photographs whose EXIF has no time are in the order of
    /// their names. Photographs that are left over are in no bracket
    #[arg(long, value_name = "N")]
    bracket: Option<usize>,

    /// Set the longest pause in a bracket, in seconds [default: 120]
    ///
    /// It is measured from the end of an exposure to the start of the next
    #[arg(long, value_name = "SECONDS")]
    gap: Option<f64>,

    /// Treat every folder as one bracket
    #[arg(long, conflicts_with_all = ["bracket", "gap"])]
    by_folder: bool,
}

/// Options that change the results. They are part of the plan.
#[derive(Debug, clap::Args)]
struct Acting {
    #[command(flatten)]
    method: Method,

    /// Set the reference frame of each bracket by its number (1 is the first)
    ///
    /// Frames are numbered in the order in which they were taken. By default, the reference is the best exposed frame
    #[arg(long, help_heading = INPUT, value_name = "N")]
    reference: Option<usize>,

    #[command(flatten)]
    merging: Merging,

    /// Use one brightness scale per bracket, per panorama (set) or for all brackets
    ///
    /// The value 1.0 stands for the same radiance in all results with the same scale. Panoramas can then be stitched
    #[arg(long, help_heading = MERGE, alias = "normalise", value_parser = choice::<Normalisation>(), default_value_t, value_name = "WHAT")]
    normalize: Normalisation,

    #[command(flatten)]
    cut: Cut,
}

/// The options of a job, as in its line of the plan.
#[derive(Debug, Parser)]
#[command(no_binary_name = true)]
struct Typed {
    #[command(flatten)]
    acting: Acting,
}

impl Acting {
    /// Returns the options of the library for these arguments. File names and resource limits are not included.
    fn options(&self) -> Result<Options, Error> {
        let options = self.merging.options(self.method.options())?;
        let reference = self.reference.map_or(ReferenceChoice::Auto, ReferenceChoice::Number);
        let load = LoadOptions { reference, ..options.load };
        Ok(Options { load, crop: self.cut.crop, ..options })
    }

    /// Parses the options that the plan contains for `job`.
    fn of(job: &Job) -> Result<Options, Error> {
        let refused = |reason: String| Error::Option { option: "--run", reason: format!("{}: {reason}", job.id) };
        Typed::try_parse_from(&job.options).map_err(|e| refused(e.to_string()))?.acting.options()
    }

    /// Returns the options that the user typed, each as one word of the form `--name` or `--name=value`.
    fn typed(matches: &ArgMatches) -> Vec<String> {
        let all = <Acting as clap::Args>::augment_args(clap::Command::new("batch"));
        let is_typed = |id: &str| matches.value_source(id) == Some(ValueSource::CommandLine);
        let word = |arg: &clap::Arg| {
            let name = format!("--{}", arg.get_long()?);
            if matches!(arg.get_action(), ArgAction::SetTrue) {
                return Some(name);
            }
            let values = matches.get_raw(arg.get_id().as_str())?;
            let values: Vec<_> = values.map(|value| value.to_string_lossy()).collect();
            Some(format!("{name}={}", values.join(",")))
        };
        all.get_arguments().filter(|arg| is_typed(arg.get_id().as_str())).filter_map(word).collect()
    }
}

pub fn run(args: &Args, matches: Option<&ArgMatches>) -> Result<ExitCode, Error> {
    if args.places.name == "help" {
        crate::cli::tell(&format!("--name TEMPLATE, of\n{}", Template::help()))?;
        return Ok(ExitCode::SUCCESS);
    }
    let typed = matches.map(Acting::typed).unwrap_or_default();
    if let Some(path) = &args.run {
        return jobs(path, args, &typed);
    }
    if let Some(path) = &args.summarize {
        return summarize(path, args);
    }
    if args.folders.is_empty() {
        let reason = "no folder to search; give one or more".to_owned();
        return Err(Error::Option { option: "FOLDER", reason });
    }
    pipeline::start_threads(args.work.threads)?;
    let bar = night::Searching::new(args.work.quiet);
    let found = find::find(&args.folders, &args.find_options(), &|count| bar.show(count));
    drop(bar);
    let found = found?;
    let brackets = found::planned(&found);
    let options = args.acting.options()?;
    let jobs = plan::plan(&brackets, &args.settings(typed, &options)?)?;
    if args.dry_run {
        crate::cli::tell(&if args.json { found::json(&found, &jobs) } else { found::table(&found, &jobs) })?;
        return Ok(if jobs.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS });
    }
    if jobs.is_empty() {
        return Err(found::nothing(&args.folders, &found));
    }
    if args.plan { print_plan(&jobs, &found, args) } else { night::run(&jobs, &found, options, args) }
}

impl Args {
    fn find_options(&self) -> FindOptions {
        FindOptions {
            frames: self.finding.bracket,
            gap_s: self.finding.gap,
            by_folder: self.finding.by_folder,
            skip: self.places.output.iter().cloned().collect(),
            max_pixels: Some(self.work.largest.pixels()),
        }
    }

    fn settings(&self, options: Vec<String>, acting: &Options) -> Result<Settings, Error> {
        let named = |formats: &[String]| -> Vec<String> {
            formats.iter().map(|f| f.trim_start_matches('.').to_lowercase()).collect()
        };
        let (formats, pictures) = (named(&self.places.formats), named(&self.places.pictures));
        let twice = |option, reason| Err(Error::Option { option, reason });
        for (i, format) in formats.iter().enumerate() {
            if formats[..i].contains(format) {
                return twice("--formats", format!("{format} is given twice"));
            }
        }
        for (i, format) in pictures.iter().enumerate() {
            if pictures[..i].contains(format) || formats.contains(format) {
                let reason = format!("{format} is given twice in --pictures, or also in --formats; give it once");
                return twice("--pictures", reason);
            }
        }
        let paths =
            |formats: &[String]| formats.iter().map(|f| Path::new("result").with_extension(f)).collect::<Vec<_>>();
        // The error of the library names a file and the options of `merge`.
        let of_pictures = |error: Error| match error {
            Error::Option { .. } => {
                let reason = "it takes only formats of pictures (png, jpg, tif); give exr, hdr and dng with --formats";
                Error::Option { option: "--pictures", reason: reason.into() }
            }
            other => other,
        };
        let drawn = write::Output::pictures(&paths(&pictures)).map_err(of_pictures)?;
        acting.write.check(&[write::Output::results(&paths(&formats))?, drawn].concat())?;
        let normalisation = self.acting.normalize;
        if normalisation != Normalisation::Bracket && acting.calibration.is_asked() {
            let reason = "it cannot be combined with --absolute or --calibration-factor; remove it, or these options";
            return Err(Error::Option { option: "--normalize", reason: reason.into() });
        }
        Ok(Settings {
            output: self.places.output.clone(),
            template: Template::parse(&self.places.name)?,
            formats,
            pictures,
            page: self.places.page,
            responses: match &self.response {
                Some(path) => Responses::Given(path.clone()),
                None if self.shared_response => Responses::Shared,
                None => Responses::Own,
            },
            normalisation,
            options,
            follows: acting.align.follows(),
            seeks_ghosts: acting.deghost.is_on(),
            fuses: matches!(acting.rendering, hdralign::tonemap::Rendering::Fused(_)),
        })
    }
}

/// Runs `hdralign batch --plan`: prints the jobs.
fn print_plan(jobs: &[Job], found: &find::Found, args: &Args) -> Result<ExitCode, Error> {
    let mut lines = Vec::with_capacity(jobs.len());
    for job in jobs {
        match job.to_line() {
            Ok(line) => lines.push(line + "\n"),
            Err(error) => crate::cli::say(format_args!("hdralign: {error}")),
        }
    }
    crate::cli::tell(&lines.concat())?;
    if !args.work.quiet {
        crate::cli::say(found::counted(found, lines.len()));
    }
    Ok(exit_code(Outcome::of(lines.len(), jobs.len())))
}

/// Runs `hdralign batch --run PLAN --id ID`.
fn jobs(path: &Path, args: &Args, typed: &[String]) -> Result<ExitCode, Error> {
    if let Some(option) = typed.first() {
        let reason =
            format!("{option} changes the results; give it when the plan is made (--plan), not when its jobs are run");
        return Err(Error::Option { option: "--run", reason });
    }
    let jobs = Job::read(path, &args.id)?;
    let mut done = 0;
    let mut degraded = false;
    let mut results = String::new();
    for job in &jobs {
        let mut options = Acting::of(job)?;
        let folder = job.report.parent().unwrap_or(Path::new("."));
        options.load.memory = args.work.memory(|| folder.to_owned());
        options.threads = args.work.threads;
        options.load.max_pixels = largest(job, &args.work);
        match job::run(job, &options, args.work.force, &pipeline::unwatched) {
            Ok((brief, is_new)) => {
                done += 1;
                degraded |= brief.degraded;
                if !args.work.quiet {
                    crate::cli::say(night::described(&job.id, &brief, is_new));
                }
                results.extend(job.outputs.iter().map(|path| format!("{}\n", path.display())));
            }
            Err(error) => crate::cli::say(format_args!("hdralign: {}: {error}", job.id)),
        }
    }
    crate::cli::tell(&results)?;
    let outcome = Outcome::of(done, jobs.len());
    Ok(if args.work.strict && degraded && outcome == Outcome::All { ExitCode::from(3) } else { exit_code(outcome) })
}

/// Returns the largest number of pixels that a photograph of `job` may have. This is the limit that the user gave. If
/// the user gave none, it is the default limit, or the size in the plan if that is larger.
fn largest(job: &Job, work: &Work) -> u64 {
    let planned = (job.width_px as u64).saturating_mul(job.height_px as u64);
    work.largest.given().unwrap_or_else(|| work.largest.pixels().max(planned))
}

/// Runs `hdralign batch --summarize PLAN`.
fn summarize(path: &Path, args: &Args) -> Result<ExitCode, Error> {
    let jobs = Job::read_all(path)?;
    let Some(first) = jobs.first() else {
        let reason = format!("{}: the plan has no jobs", path.display());
        return Err(Error::Option { option: "--summarize", reason });
    };
    night::open_home(&first.summary, args)?;
    let summary = Summary::collected(&jobs);
    night::finish(&summary, &first.summary, None, args)
}

fn exit_code(outcome: Outcome) -> ExitCode {
    match outcome {
        Outcome::All => ExitCode::SUCCESS,
        Outcome::None => ExitCode::FAILURE,
        Outcome::Some => ExitCode::from(3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Args as _;

    /// Parses the command line `words`. Returns the options as a plan contains them, and as options of the library.
    fn typed(words: &[&str]) -> (Vec<String>, Options) {
        let command = Args::augment_args(clap::Command::new("batch"));
        let matches = command.get_matches_from([&["batch", "in"], words].concat());
        let acting = <Args as clap::FromArgMatches>::from_arg_matches(&matches).unwrap().acting;
        (Acting::typed(&matches), acting.options().unwrap())
    }

    #[test]
    fn plan_contains_the_options_as_typed() {
        for words in [
            &[][..],
            &["-e=-2,0,2", "--reference", "2", "--align", "mtb", "-C", "none"],
            &["--deghost", "--flare", "--tmo", "drago", "--tmo-set", "bias=0.7", "--exr-type", "float", "-d", "out"],
            &["--deghost=0.25", "--weight", "noise", "--jpeg-quality", "80", "--threads", "3", "--keep-gps"],
            &["--white-balance", "5500k,-10", "--brightness", "-0.5", "--shadows=40", "--highlights", "-30"],
            &["--response-model", "mitsunaga-nayar", "--response-degree", "4", "--absolute", "--force"],
        ] {
            let (line, options) = typed(words);
            let again = Typed::try_parse_from(&line).unwrap().acting.options().unwrap();
            assert_eq!(again, options, "{words:?} as {line:?}");
            assert!(
                !line.iter().any(|word| ["-d", "--output", "--threads", "--force"].iter().any(|o| word.starts_with(o)))
            );
        }
        assert_eq!(typed(&["--deghost", "-e=-2,0,2"]).0, ["--ev=-2,0,2", "--deghost=auto"]);
        assert!(typed(&[]).0.is_empty());
    }
}
