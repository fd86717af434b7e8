//! Runs a batch on this machine: shows the progress, handles interruption, and prints the summary at the end.

use super::found::{entries, left_over, many, unreadable, unused};
use super::{Args, exit_code};
use crate::cli::arguments::input::Work;
use crate::cli::process::interrupt;
use crate::cli::process::leftovers;
use crate::cli::progress::left;
use crate::cli::say;
use crate::cli::summary::duration;
use crate::cli::terminal::Terminal;
use hdralign::batch::find::{self, Found};
use hdralign::batch::job::Brief;
use hdralign::batch::plan::{Job, Kind};
use hdralign::batch::schedule::{self, Ending, Event, Limits};
use hdralign::batch::summary::{self, Outcome, Row, Status, Summary};
use hdralign::error::Error;
use hdralign::pipeline::Options;
use hdralign::write;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Largest number of jobs or files that the summary lists for each kind of problem.
const LISTED: usize = 10;

/// Shows the progress of the search for brackets: the number of headers that were read.
pub struct Searching(ProgressBar);

impl Searching {
    /// Creates the progress display. It is shown only if stderr is a terminal and `quiet` is false.
    pub fn new(quiet: bool) -> Searching {
        let bar = if is_shown(quiet) { ProgressBar::new_spinner() } else { ProgressBar::hidden() };
        if let Ok(style) = ProgressStyle::with_template("{spinner} reading headers: {pos}") {
            bar.set_style(style);
        }
        if !bar.is_hidden() {
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Searching(bar)
    }

    /// Shows `count` as the number of headers that were read.
    pub fn show(&self, count: usize) {
        self.0.set_position(count as u64);
    }
}

impl Drop for Searching {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

fn is_shown(quiet: bool) -> bool {
    !quiet && Terminal::of_stderr().can_redraw
}

/// The progress bar over all jobs, and the lines printed above it.
struct Board {
    bar: ProgressBar,
    began: Instant,
    jobs: usize,
    ended: AtomicUsize,
    /// Estimated times in seconds. The first number is the sum over all jobs. The pair contains the sum over the
    /// ended jobs that were not already done in an earlier run, and the sum over all ended jobs.
    planned: (f64, Mutex<(f64, f64)>),
    quiet: bool,
    verbose: bool,
}

impl Board {
    fn new(jobs: &[Job], args: &Args) -> Board {
        let target =
            if is_shown(args.work.quiet) { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(jobs.len() as u64), target);
        let room = Terminal::of_stderr().width.min(79).saturating_sub(50).clamp(8, 30);
        if let Ok(style) =
            ProgressStyle::with_template(&format!("brackets [{{bar:{room}}}] {{pos}}/{{len}}  {{prefix}}"))
        {
            bar.set_style(style.progress_chars("=> "));
        }
        Board {
            bar,
            began: Instant::now(),
            jobs: jobs.len(),
            ended: AtomicUsize::new(0),
            planned: (jobs.iter().map(|job| job.time_s).sum(), Mutex::new((0.0, 0.0))),
            quiet: args.work.quiet,
            verbose: args.verbose,
        }
    }

    fn see(&self, event: &Event) {
        let (job, ending) = match event {
            Event::Begins(_) => return,
            Event::Fills(job) => return self.bar.suspend(|| say(full(job))),
            Event::Ends(job, ending) => (job, ending),
        };
        let ended = self.ended.fetch_add(1, Ordering::SeqCst) + 1;
        let number = format!("[{ended:>0$}/{1}]", self.jobs.to_string().len(), self.jobs);
        let line = match ending {
            Ending::Done(brief) => Some(format!("{number} {}", described(&job.id, brief, true))),
            Ending::Unchanged(brief) => self.verbose.then(|| format!("{number} {}", described(&job.id, brief, false))),
            Ending::Failed(error) => Some(format!("{number} {}: failed: {error}", job.id)),
            Ending::NotStarted => None,
        };
        let is_failure = matches!(ending, Ending::Failed(_));
        let warnings = match ending {
            Ending::Done(brief) if self.verbose => &brief.warnings[..],
            _ => &[],
        };
        self.bar.suspend(|| {
            // A failed job is an error, so it is printed even with --quiet.
            if let Some(line) = line.filter(|_| is_failure || !self.quiet) {
                let terminal = Terminal::of_stderr();
                let text = if is_failure { terminal.bad(&line) } else { line };
                say(text);
            }
            warnings.iter().for_each(|warning| say(format_args!("    warning: {warning}")));
        });
        self.bar.set_position(ended as u64);
        let is_work = !matches!(ending, Ending::Unchanged(_));
        self.bar.set_prefix(left(self.left_s(job.time_s, is_work)));
    }

    /// Counts a job with the estimated time `time_s` as ended, and returns the seconds left: the estimated time of
    /// the jobs that have not ended, times the ratio of elapsed to estimated time so far. `is_work` is false if the
    /// job was already done in an earlier run.
    fn left_s(&self, time_s: f64, is_work: bool) -> Option<f64> {
        let (all, so_far) = &self.planned;
        let mut so_far = so_far.lock().unwrap_or_else(PoisonError::into_inner);
        so_far.1 += time_s;
        if is_work {
            so_far.0 += time_s;
        }
        (so_far.0 > 0.0).then(|| self.began.elapsed().as_secs_f64() / so_far.0 * (all - so_far.1).max(0.0))
    }
}

/// Returns the message for a full disk, which is printed once.
fn full(job: &Job) -> String {
    let folder = job.report.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    format!(
        "hdralign: {}: the disk is full or the quota is used up, so no further bracket is started for this disk; delete some files and run the command again (finished brackets are kept)",
        folder.display()
    )
}

/// Returns the line for a job that is done. `is_new` is false if it was already done in an earlier run.
pub fn described(id: &str, brief: &Brief, is_new: bool) -> String {
    let mut words = Vec::new();
    match brief.time_s.filter(|_| is_new) {
        Some(time) => words.push(format!("done in {}", duration(time))),
        None => words.push(if is_new { "done" } else { "already done" }.to_owned()),
    }
    if brief.left_out > 0 {
        words.push(format!("{} not merged", many(brief.left_out, "frame")));
    }
    if brief.degraded {
        words.push("degraded".into());
    }
    if !brief.warnings.is_empty() {
        words.push(many(brief.warnings.len(), "warning"));
    }
    format!("{id}: {}", words.join(", "))
}

/// Runs all jobs and shows a progress bar. Then writes and prints the summary, and returns the exit code.
pub fn run(jobs: &[Job], found: &Found, options: Options, args: &Args) -> Result<ExitCode, Error> {
    let home = open_home(&jobs[0].summary, args)?;
    let mut options = options;
    let limits = limits(&args.work, args.jobs, &home)?;
    options.load.memory.clone_from(&limits.memory);
    options.load.max_pixels = args.work.largest.pixels();
    leftovers::clear(&jobs.iter().flat_map(|job| [&job.report, &job.summary]).collect::<Vec<_>>());
    let stop = interrupt::stopping();
    let board = Board::new(jobs, args);
    let endings = schedule::run(jobs, &options, &limits, args.work.force, stop, &|event| board.see(&event));
    board.bar.finish_and_clear();
    let summary = Summary::new(jobs, &endings, unused(found), board.began.elapsed().as_secs_f64());
    let left_over = Some(LeftOver { entries: left_over(found), unreadable: unreadable(found) });
    finish(&summary, &jobs[0].summary, left_over.as_ref(), args)
}

/// Creates the folder of the summary file `path`, and returns it. Checks that the summary can be written, because the
/// user should not learn this only after hours of work.
pub fn open_home(path: &Path, args: &Args) -> Result<PathBuf, Error> {
    let home = path.parent().unwrap_or(Path::new(".")).to_owned();
    std::fs::create_dir_all(&home).map_err(|source| Error::Write { path: home.clone(), source })?;
    summary::check(path, args.work.force)?;
    drop(write::complete(path, b"")?);
    Ok(home)
}

/// The photographs in no bracket, and the folders that cannot be read.
pub struct LeftOver<'a> {
    /// All of these photographs and folders, except the results of hdralign.
    entries: Vec<&'a find::LeftOver>,
    /// Those of the entries that cannot be read.
    unreadable: Vec<&'a find::LeftOver>,
}

fn limits(work: &Work, jobs: Option<usize>, home: &Path) -> Result<Limits, Error> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = work.threads.unwrap_or(cores);
    let none = |option| Error::Option { option, reason: "must be at least 1".into() };
    if threads == 0 {
        return Err(none("--threads"));
    }
    if jobs == Some(0) {
        return Err(none("--jobs"));
    }
    Ok(Limits { jobs: jobs.unwrap_or(threads), threads, memory: work.memory(|| home.to_owned()) })
}

/// Writes the summary to `path`, prints it, and returns the exit code. If a folder cannot be read, if a photograph is
/// refused because of its header, or if the summary cannot be written, a batch that did all its jobs gets the exit code
/// for a partly done batch.
pub fn finish(summary: &Summary, path: &Path, left_over: Option<&LeftOver>, args: &Args) -> Result<ExitCode, Error> {
    let files = summary.write(path, args.work.force);
    if !args.work.quiet {
        lines(summary, files.as_ref().ok(), left_over).iter().for_each(say);
    }
    if let Err(error) = &files {
        say(format_args!("hdralign: {error}"));
    }
    let results = if args.json {
        summary.to_json()
    } else {
        summary.jobs.iter().flat_map(|row| &row.outputs).map(|path| format!("{path}\n")).collect()
    };
    crate::cli::tell(&results)?;
    let has_unreadable = left_over.is_some_and(|left_over| !left_over.unreadable.is_empty());
    let outcome = match summary.outcome() {
        Outcome::All if has_unreadable || files.is_err() => Outcome::Some,
        outcome => outcome,
    };
    let is_degraded = args.work.strict && summary.counts.degraded > 0;
    Ok(if is_degraded && outcome == Outcome::All { ExitCode::from(3) } else { exit_code(outcome) })
}

/// Returns a line for each of the first [`LISTED`] texts, and one more line with the number of remaining texts, if
/// any. Each line starts with `label`.
fn listed(label: &str, texts: impl ExactSizeIterator<Item = String>) -> Vec<String> {
    let more = texts.len().saturating_sub(LISTED);
    let mut lines: Vec<String> = texts.take(LISTED).map(|text| format!("{label:<11}{text}")).collect();
    if more > 0 {
        lines.push(format!("{label:<11}and {more} more; batch.json lists all"));
    }
    lines
}

/// Returns the lines of the summary.
fn lines(summary: &Summary, files: Option<&[PathBuf; 2]>, left_over: Option<&LeftOver>) -> Vec<String> {
    let counts = &summary.counts;
    let all = [
        (counts.done, "done"),
        (counts.unchanged, "already done"),
        (counts.failed, "failed"),
        (counts.not_done, "not done"),
        (counts.degraded, "degraded"),
    ];
    let words: Vec<String> = all.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
    // With --shared-response, some jobs recover responses, so not every job stands for a bracket.
    let is_of_brackets = summary.jobs.iter().all(|row| row.kind == Kind::Merge);
    let jobs = if is_of_brackets { "brackets" } else { "jobs" };
    let mut lines = vec![format!("{jobs:<11}{} of {}", words.join(", "), counts.jobs)];
    let with = |is: &dyn Fn(&&Row) -> bool| summary.jobs.iter().filter(is).collect::<Vec<&Row>>();
    let failed = with(&|row| row.status == Status::Failed);
    let why = |row: &&Row| format!("{}: {}", row.id, row.error.as_deref().unwrap_or_default());
    lines.extend(listed("failed", failed.iter().map(why)));
    let doubtful = with(&|row| row.brief.degraded);
    let what = |row: &&Row| format!("{}: {}", row.id, row.brief.warnings.first().map_or("", String::as_str));
    lines.extend(listed("degraded", doubtful.iter().map(what)));
    if let Some(left_over) = left_over {
        let why = |l: &&find::LeftOver| format!("{}: {}", l.path.display(), l.reason);
        lines.extend(listed("unreadable", left_over.unreadable.iter().map(why)));
        if !left_over.entries.is_empty() {
            let count = entries(&left_over.entries);
            lines.push(format!("{:<11}{count}; batch.json and --dry-run list the reasons", "no bracket"));
        }
    }
    if let Some([report, table]) = files {
        lines.push(format!("{:<11}{}, {}", "summary", report.display(), table.display()));
    }
    if let Some(time) = summary.time_s {
        let rate = if counts.done > 0 && time > 0.0 {
            format!(", {:.0} {jobs} an hour", counts.done as f64 / time * 3600.0)
        } else {
            String::new()
        };
        lines.push(format!("{:<11}{}{rate}", "time", duration(time)));
    }
    lines
}
