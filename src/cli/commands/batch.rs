//! `hdralign batch`.

mod found;
mod night;

use crate::cli::arguments::choice::choice;
use crate::cli::arguments::input::{Cut, Method, Work};
use crate::cli::arguments::merging::Merging;
use clap::parser::ValueSource;
use clap::{ArgAction, ArgMatches, Parser};
use hdralign::batch::find::{self, FindOptions};
use hdralign::batch::name::Template;
use hdralign::batch::plan::{self, Normalisation, Responses, Settings, Step};
use hdralign::batch::step;
use hdralign::batch::summary::{Summary, Verdict};
use hdralign::bracket::{LoadOptions, ReferenceChoice};
use hdralign::error::Error;
use hdralign::pipeline::{self, Options};
use hdralign::write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Examples:
  hdralign batch /media/card --dry-run                the brackets found, and what is left over and why
  hdralign batch /media/card -d merged                merge them; again, and only what changed is done
  hdralign batch scans --by-folder -e=-2,0,2          no EXIF: a folder a bracket, and the exposures
  hdralign batch pano -d out --shared-response --normalize set --formats exr
  hdralign batch /photos -d out --plan > plan.jsonl   for Snakemake, Slurm, GNU parallel: a line for each step,
  hdralign batch --run plan.jsonl --id ID             one step,
  hdralign batch --summarize plan.jsonl               and the summary of all";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    /// Folders to search, with all that is in them
    #[arg(value_name = "FOLDER", required_unless_present_any = ["run", "summarize", "name"])]
    folders: Vec<PathBuf>,

    /// Print what was found, and what was left over and why; merge nothing
    #[arg(long)]
    dry_run: bool,

    /// Print the plan, a line of JSON for each step; merge nothing
    #[arg(long, conflicts_with = "dry_run")]
    plan: bool,

    /// Do steps of the plan in this file, those named by --id
    #[arg(long, value_name = "PLAN", requires = "id", conflicts_with_all = ["folders", "plan", "dry_run", "summarize"])]
    run: Option<PathBuf>,

    /// The step that is done; may be repeated
    #[arg(long, value_name = "ID", requires = "run")]
    id: Vec<String>,

    /// Write the summary of the plan in this file, by what its steps left behind
    #[arg(long, value_name = "PLAN", conflicts_with_all = ["folders", "plan", "dry_run"])]
    summarize: Option<PathBuf>,

    #[command(flatten)]
    places: Places,

    #[command(flatten)]
    finding: Finding,

    #[command(flatten)]
    acting: Acting,

    /// Use this response for all: .json, .rsp (hdrgen) or .csv (luminance-hdr, pfstools)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["response_model", "response_degree", "shared_response"])]
    response: Option<PathBuf>,

    /// One response for each camera, recovered from all its brackets before they are merged
    #[arg(long)]
    shared_response: bool,

    /// Brackets at a time [default: one for each core, as far as memory goes]; the results are the same
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,

    #[command(flatten)]
    work: Work,

    /// Print the summary to standard output, as JSON, instead of the paths written; with --dry-run what was found
    #[arg(long)]
    json: bool,

    /// Say more: the warnings of each bracket, and which were done before
    #[arg(short, long, conflicts_with = "quiet")]
    verbose: bool,
}

/// Where results go, and which there are.
#[derive(Debug, clap::Args)]
struct Places {
    /// The folder for results, made if it is not there; in it they lie as the photographs do [default: beside the photographs]
    #[arg(short = 'd', long = "output-folder", value_name = "FOLDER")]
    output: Option<PathBuf>,

    /// Names of results, without extension; `--name help` lists the fields
    #[arg(long, value_name = "TEMPLATE", default_value = "{folder}/{first}-{last}")]
    name: String,

    /// The results: exr, hdr, tif, png, jpg, with commas
    #[arg(long, value_name = "FORMAT,...", value_delimiter = ',', default_value = "exr,png")]
    formats: Vec<String>,

    /// Pictures beside the results, whatever the extension: tif (of codes), png, jpg, with commas; none that --formats has
    #[arg(long, value_name = "FORMAT,...", value_delimiter = ',')]
    pictures: Vec<String>,

    /// Make a page to look at of each bracket, .html
    #[arg(long)]
    page: bool,
}

/// How brackets are told.
#[derive(Debug, clap::Args)]
struct Finding {
    /// Every bracket has N photographs; so those without EXIF are found too, by their names
    #[arg(long, value_name = "N")]
    bracket: Option<usize>,

    /// The longest pause within a bracket, in seconds, from the end of an exposure to the begin of the next [default: 120]
    #[arg(long, value_name = "SECONDS")]
    gap: Option<f64>,

    /// Every folder is a bracket
    #[arg(long, conflicts_with_all = ["bracket", "gap"])]
    by_folder: bool,
}

/// What acts on the results: it stands in the plan.
#[derive(Debug, clap::Args)]
struct Acting {
    #[command(flatten)]
    method: Method,

    /// The photograph of each bracket that the others are aligned to: its number, from 1, in the order of time [default: the best]
    #[arg(long, value_name = "N")]
    reference: Option<usize>,

    #[command(flatten)]
    cut: Cut,

    #[command(flatten)]
    merging: Merging,

    /// Set the exposure whose radiance is the unit
    #[arg(long, alias = "normalise", value_parser = choice::<Normalisation>(), default_value_t, value_name = "WHAT")]
    normalize: Normalisation,
}

/// The options of a step, as its line has them.
#[derive(Debug, Parser)]
#[command(no_binary_name = true)]
struct Typed {
    #[command(flatten)]
    acting: Acting,
}

impl Acting {
    /// The library's options that these arguments stand for; files and limits are none of theirs.
    fn options(&self) -> Result<Options, Error> {
        let options = self.merging.options(self.method.options())?;
        let reference = self.reference.map_or(ReferenceChoice::Auto, ReferenceChoice::Number);
        let load = LoadOptions { reference, ..options.load };
        Ok(Options { load, crop: self.cut.crop, ..options })
    }

    /// Those of a step.
    fn of(step: &Step) -> Result<Options, Error> {
        let refused = |reason: String| Error::Option { option: "--run", reason: format!("{}: {reason}", step.id) };
        Typed::try_parse_from(&step.options).map_err(|e| refused(e.to_string()))?.acting.options()
    }

    /// What the user typed of them, in one word each.
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
        return steps(path, args, &typed);
    }
    if let Some(path) = &args.summarize {
        return summarize(path, args);
    }
    if args.folders.is_empty() {
        let reason = "no folder is given to search; name one or more".to_owned();
        return Err(Error::Option { option: "FOLDER", reason });
    }
    pipeline::start_threads()?;
    let bar = night::Searching::new(args.work.quiet);
    let found = find::find(&args.folders, &args.find_options(), &|count| bar.show(count));
    drop(bar);
    let found = found?;
    let brackets = found::planned(&found);
    let options = args.acting.options()?;
    let steps = plan::plan(&brackets, &args.settings(typed, &options)?)?;
    if args.dry_run {
        crate::cli::tell(&if args.json { found::json(&found, &steps) } else { found::table(&found, &steps) })?;
        return Ok(if steps.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS });
    }
    if steps.is_empty() {
        return Err(found::nothing(&args.folders, &found));
    }
    if args.plan { print_plan(&steps, &found, args) } else { night::run(&steps, &found, options, args) }
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
                return twice("--formats", format!("{format} stands there twice"));
            }
        }
        for (i, format) in pictures.iter().enumerate() {
            if pictures[..i].contains(format) || formats.contains(format) {
                let reason = format!("{format} stands there or in --formats already; a name has one file");
                return twice("--pictures", reason);
            }
        }
        let paths =
            |formats: &[String]| formats.iter().map(|f| Path::new("result").with_extension(f)).collect::<Vec<_>>();
        let results = [write::Output::results(&paths(&formats))?, write::Output::pictures(&paths(&pictures))?];
        acting.write.check(&results.concat())?;
        let normalisation = self.acting.normalize;
        if normalisation != Normalisation::Bracket && acting.calibration.is_asked() {
            let reason =
                "radiance in cd/m2 has one unit already; leave --absolute and --calibration-factor out, or this";
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
            seeks_ghosts: acting.deghost.is_on(),
            fuses: matches!(acting.rendering, hdralign::tonemap::Rendering::Fused(_)),
        })
    }
}

/// `--plan`.
fn print_plan(steps: &[Step], found: &find::Found, args: &Args) -> Result<ExitCode, Error> {
    let mut lines = Vec::with_capacity(steps.len());
    for step in steps {
        match step.to_line() {
            Ok(line) => lines.push(line + "\n"),
            Err(error) => crate::cli::say(format_args!("hdralign: {error}")),
        }
    }
    crate::cli::tell(&lines.concat())?;
    if !args.work.quiet {
        crate::cli::say(found::counted(found, lines.len()));
    }
    Ok(exit_code(Verdict::of(lines.len(), steps.len())))
}

/// `--run PLAN --id ID`.
fn steps(path: &Path, args: &Args, typed: &[String]) -> Result<ExitCode, Error> {
    if let Some(option) = typed.first() {
        let reason = format!("{option} acts on the results, and those stand in the plan; plan again with it");
        return Err(Error::Option { option: "--run", reason });
    }
    let steps = Step::read(path, &args.id)?;
    let mut done = 0;
    let mut degraded = false;
    let mut results = String::new();
    for step in &steps {
        let mut options = Acting::of(step)?;
        let folder = step.report.parent().unwrap_or(Path::new("."));
        options.load.memory = args.work.memory(|| folder.to_owned());
        options.threads = args.work.threads;
        options.load.max_pixels = largest(step, &args.work);
        match step::run(step, &options, args.work.force, &pipeline::unwatched) {
            Ok((brief, is_new)) => {
                done += 1;
                degraded |= brief.degraded;
                if !args.work.quiet {
                    crate::cli::say(night::told(&step.id, &brief, is_new));
                }
                results.extend(step.outputs.iter().map(|path| format!("{}\n", path.display())));
            }
            Err(error) => crate::cli::say(format_args!("hdralign: {}: {error}", step.id)),
        }
    }
    crate::cli::tell(&results)?;
    let verdict = Verdict::of(done, steps.len());
    Ok(if args.work.strict && degraded && verdict == Verdict::All { ExitCode::from(3) } else { exit_code(verdict) })
}

/// The pixels that a photograph of `step` may have: what is said here, else as many as it was planned with, or by default.
fn largest(step: &Step, work: &Work) -> u64 {
    let planned = (step.width_px as u64).saturating_mul(step.height_px as u64);
    work.largest.given().unwrap_or_else(|| work.largest.pixels().max(planned))
}

/// `--summarize PLAN`.
fn summarize(path: &Path, args: &Args) -> Result<ExitCode, Error> {
    let steps = Step::read_all(path)?;
    let Some(first) = steps.first() else {
        let reason = format!("{}: has no step; there is nothing to sum up", path.display());
        return Err(Error::Option { option: "--summarize", reason });
    };
    night::open_home(&first.summary, args)?;
    let summary = Summary::collected(&steps);
    night::finish(&summary, &first.summary, None, args)
}

fn exit_code(verdict: Verdict) -> ExitCode {
    match verdict {
        Verdict::All => ExitCode::SUCCESS,
        Verdict::None => ExitCode::FAILURE,
        Verdict::Some => ExitCode::from(3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Args as _;

    /// What was typed, and the options that come of it.
    fn typed(words: &[&str]) -> (Vec<String>, Options) {
        let command = Args::augment_args(clap::Command::new("batch"));
        let matches = command.get_matches_from([&["batch", "in"], words].concat());
        let acting = <Args as clap::FromArgMatches>::from_arg_matches(&matches).unwrap().acting;
        (Acting::typed(&matches), acting.options().unwrap())
    }

    #[test]
    fn a_plan_holds_what_was_typed() {
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
