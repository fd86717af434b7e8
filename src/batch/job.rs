//! One job: merge a bracket or recover a response, completely or not at all, and only if it is not done yet.
//!
//! In: a [`Job`] and its options. Out: the result files, and a [`Brief`] (an extract) of the report. Cost:
//! `pipeline::prepare`, and reading inputs and outputs once for their hashes, and replaced outputs twice.
//!
//! Any process may start a job again at any time: complete results are kept, and an interrupted job is run again.
//! Without `--force`, a job replaces only its own earlier results. If two processes run the same job at the same
//! time, the result is the same as from one process.

use super::plan::{Job, Kind};
use super::record::{self, Content, Record};
use crate::error::{Error, Result};
use crate::intake::{self, Stamp};
use crate::pipeline::camera::{self, CameraReport};
use crate::pipeline::{self, Options, Watch};
use crate::report::Report;
use crate::write::{self, CompleteFile, Target};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The part of a report that a summary shows.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Brief {
    /// Whether the result is degraded: a frame was rejected or is uncertain, or an exposure or the response had to be
    /// estimated or assumed.
    pub degraded: bool,
    /// The texts of the warnings.
    pub warnings: Vec<String>,
    /// Number of rejected photographs.
    pub left_out: usize,
    /// The smallest confidence of the merged frames.
    pub least_confidence: Option<f64>,
    /// Wall time of the run that wrote the files.
    pub time_s: Option<f64>,
}

impl Brief {
    /// Extracts the brief from a report.
    pub fn of(report: &Value) -> Brief {
        let list = |value: &Value, key: &str| value[key].as_array().cloned().unwrap_or_default();
        let warnings = list(report, "warnings");
        let mut frames = list(report, "frames");
        frames.extend(list(report, "brackets").iter().flat_map(|bracket| list(bracket, "frames")));
        let places: Vec<&Value> = frames.iter().map(|frame| &frame["alignment"]).collect();
        let is_left_out = |place: &&&Value| place["status"] == "rejected";
        let confidences = places.iter().filter(|p| !is_left_out(p)).filter_map(|p| p["confidence"].as_f64());
        Brief {
            degraded: warnings.iter().any(|w| w["degrades"] == true),
            warnings: warnings.iter().filter_map(|w| w["message"].as_str().map(str::to_owned)).collect(),
            left_out: places.iter().filter(is_left_out).count(),
            least_confidence: confidences.reduce(f64::min),
            time_s: report["time_s"].as_f64().or_else(|| report["time_s"]["total"].as_f64()),
        }
    }

    /// Extracts the brief from the report in the file `path`; `None` if the file cannot be read.
    pub fn read(path: &Path) -> Option<Brief> {
        Some(Brief::of(&serde_json::from_slice(&intake::whole(path, intake::MOST_OF_A_TEXT).ok()?).ok()?))
    }
}

/// The result of [`begin`].
#[derive(Debug)]
pub enum Started<'a> {
    /// The job was done in an earlier run, with the same inputs, options and version.
    Unchanged(Brief),
    /// The job was run. All results are in temporary files, which do not have their final names yet.
    Made(Box<Made<'a>>),
}

/// A job whose temporary files are written. They may not be on the disk yet, and do not have their final names.
#[derive(Debug)]
pub struct Made<'a> {
    job: &'a Job,
    key: String,
    inputs: Vec<Content>,
    replaced: Vec<String>,
    /// The result files and the report of this job that existed before the run.
    existing: Vec<PathBuf>,
    prepared: Prepared,
}

/// The temporary files of a job and its report, depending on the kind of job.
#[derive(Debug)]
enum Prepared {
    Merged(Box<pipeline::Prepared<Report>>),
    Recovered(Box<pipeline::Prepared<CameraReport>>),
}

/// Runs `job`, except for giving its files their final names. The files, the response and the unit of radiance of the
/// job are used; those in `options` are ignored. With `force` a finished job is run again, and existing files are
/// replaced even if the job did not write them.
///
/// # Errors
/// Those of [`pipeline::run`]; [`Error::Changed`] if a photograph changed during the run. For existing files:
/// [`Error::OutputExists`] if no earlier run of the job wrote the file; [`Error::OutputChanged`] if a result was
/// changed after an earlier run wrote it; [`Error::OtherPhotographs`] if the earlier run had other photographs;
/// [`Error::FrameLost`] if a photograph of the earlier run still exists, but is not in the job.
pub fn begin<'a>(job: &'a Job, options: &Options, force: bool, watch: Watch) -> Result<Started<'a>> {
    let stamps: Vec<Stamp> = job.inputs.iter().map(|path| Stamp::of(path)).collect::<Result<_>>()?;
    let inputs: Vec<Content> = job.inputs.iter().map(|path| Content::of(path)).collect::<Result<_>>()?;
    let options = &acting(job, options);
    let key = record::key(job, &inputs, options)?;
    let known = Record::read(&job.report);
    let results: Vec<PathBuf> = job.outputs.iter().chain(&job.page).cloned().collect();
    let is_same = known.as_ref().is_some_and(|record| record.key == key && record.is_whole(&results));
    if let Some(brief) = Brief::read(&job.report).filter(|_| is_same && !force) {
        forget_failure(job);
        return Ok(Started::Unchanged(brief));
    }
    let existing: Vec<PathBuf> =
        results.iter().chain([&job.report]).filter(|path| fs::symlink_metadata(path).is_ok()).cloned().collect();
    if !force {
        check_existing(job, &existing, known.as_ref(), &inputs)?;
    }
    let folder = job.report.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(|source| Error::Write { path: folder.to_owned(), source })?;
    // The names are checked here and not by `pipeline::prepare`, whose message would name the option -o, which
    // `batch` does not have.
    let written: Vec<PathBuf> = results.iter().chain([&job.report]).cloned().collect();
    let read: Vec<PathBuf> = job.inputs.iter().chain(&job.response).cloned().collect();
    write::check_targets(&Target::of("--name", &written), &read, true)?;
    let older = existing.iter().filter(|path| **path != job.report);
    let replaced = older.map(|path| Ok(Content::of(path)?.sha256)).collect::<Result<_>>()?;
    let prepared = match job.kind {
        Kind::Merge => Prepared::Merged(Box::new(pipeline::prepare(&job.inputs, options, watch)?)),
        Kind::Response => {
            let options = camera::Options {
                pipeline: options.clone(),
                curves: job.outputs.clone(),
                plots: Vec::new(),
                // If one bracket fails, the response is recovered from the others.
                lenient: true,
            };
            Prepared::Recovered(Box::new(camera::prepare(&job.by_bracket(), &options, watch)?))
        }
    };
    // Each photograph is read twice: for the hash in the record, and for its pixels. If a photograph changed in
    // between, the record would not describe the photographs that were merged.
    stamps.iter().try_for_each(Stamp::check)?;
    Ok(Started::Made(Box::new(Made { job, key, inputs, replaced, existing, prepared })))
}

/// Checks that the existing files may be replaced: an earlier run of this job must have written them, from these
/// photographs.
fn check_existing(job: &Job, existing: &[PathBuf], known: Option<&Record>, inputs: &[Content]) -> Result<()> {
    let Some(record) = known else {
        return existing.first().map_or(Ok(()), |path| Err(Error::OutputExists { path: path.clone() }));
    };
    if !record.is_of(inputs) {
        return Err(Error::OtherPhotographs { path: job.report.clone() });
    }
    let folders: BTreeSet<&Path> = job.inputs.iter().filter_map(|path| path.parent()).collect();
    let is_lost = |name: &str| {
        inputs.iter().all(|content| content.name != name) && folders.iter().any(|folder| folder.join(name).exists())
    };
    if let Some(lost) = record.inputs.iter().find(|content| job.kind == Kind::Merge && is_lost(&content.name)) {
        return Err(Error::FrameLost { path: job.report.clone(), photograph: lost.name.clone() });
    }
    for path in existing.iter().filter(|path| **path != job.report) {
        if !record.made(path)? {
            let is_named =
                record.outputs.iter().any(|content| path.file_name().is_some_and(|name| *name == *content.name));
            let path = path.clone();
            return Err(if is_named { Error::OutputChanged { path } } else { Error::OutputExists { path } });
        }
    }
    Ok(())
}

/// Returns the options of the pipeline for `job`.
fn acting(job: &Job, options: &Options) -> Options {
    let mut options = options.clone();
    let results = job.outputs.iter().filter(|path| !job.pictures.contains(path));
    options.outputs = results.cloned().collect();
    options.pictures.clone_from(&job.pictures);
    options.report.clone_from(&job.page);
    options.response_file.clone_from(&job.response);
    options.unit_exposure = job.unit_exposure_s;
    // `check_existing` decides which existing files may be replaced.
    options.write.overwrite = true;
    options
}

impl Made<'_> {
    /// Waits until all files are on the disk, and then gives them their final names. The report comes first: even if
    /// the process is interrupted, the record in the report shows that the other files are from this job.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::OutputExists`] if another program created one of the files during the run.
    pub fn commit(self) -> Result<Brief> {
        let Made { job, key, inputs, replaced, existing, prepared } = self;
        let (mut report, files) = match prepared {
            Prepared::Merged(prepared) => {
                let (report, files) = prepared.complete()?;
                (as_value(&report), files)
            }
            Prepared::Recovered(prepared) => {
                let (report, files) = prepared.complete()?;
                (as_value(&report), files)
            }
        };
        let outputs = files.iter().map(content).collect::<Result<Vec<_>>>()?;
        let record = Record {
            id: job.id.clone(),
            key,
            software: job.software.clone(),
            options: job.options.clone(),
            inputs,
            outputs,
            replaced,
        };
        report["step"] = as_value(&record);
        let text = serde_json::to_string_pretty(&report).unwrap_or_default() + "\n";
        let placed = place(write::complete(&job.report, text.as_bytes())?, files, &existing, twin(job, &record.key));
        match placed {
            Err(Error::OutputExists { .. }) if is_done_by_twin(job, &record) => {}
            other => other?,
        }
        forget_failure(job);
        Ok(Brief::of(&report))
    }
}

/// Gives the report and then the results their final names. Replaces the files in `existing`, and files that another
/// process has written for the same job during this run (`twin` is the record of that process). Other files are not
/// replaced.
fn place(report: CompleteFile, files: Vec<CompleteFile>, existing: &[PathBuf], twin: Option<Record>) -> Result<()> {
    let is_ours = |path: &Path| existing.iter().any(|there| there == path);
    let replaces_report = is_ours(report.target()) || twin.is_some();
    write::rename_all(vec![report], replaces_report)?;
    let is_twins = |path: &Path| twin.as_ref().is_some_and(|record| record.made(path).unwrap_or(false));
    let replaces = |file: &CompleteFile| is_ours(file.target()) || is_twins(file.target());
    let (replacing, new): (Vec<CompleteFile>, Vec<CompleteFile>) = files.into_iter().partition(replaces);
    write::rename_all(replacing, true)?;
    write::rename_all(new, false)
}

/// Returns the record of another process that ran the same job during this run, if there is one: a workflow engine
/// may start a job again while it still runs on another machine.
fn twin(job: &Job, key: &str) -> Option<Record> {
    Record::read(&job.report).filter(|record| record.key == key)
}

/// Returns whether another process that runs the same job, and so writes the same files, has given all of them their
/// final names. Waits for this at most [`TRIES`] tenths of a second.
fn is_done_by_twin(job: &Job, own: &Record) -> bool {
    let results: Vec<PathBuf> = job.outputs.iter().chain(&job.page).cloned().collect();
    let is_done = || twin(job, &own.key).is_some_and(|record| record.is_whole(&results));
    (0..TRIES).any(|i| {
        std::thread::sleep(Duration::from_millis(if i == 0 { 0 } else { 100 }));
        is_done()
    })
}

/// Number of times that [`is_done_by_twin`] checks the files of the other process, a tenth of a second apart.
const TRIES: u32 = 50;

/// Returns the [`Content`] of a complete temporary file, with the final name of the file.
fn content(file: &CompleteFile) -> Result<Content> {
    let target = file.target();
    let failed = |source| Error::Write { path: target.to_owned(), source };
    Content::read(target, file.open().map_err(failed)?).map_err(failed)
}

/// Returns `report` as JSON. It contains only strings, numbers and lists of them, so the conversion cannot fail.
fn as_value(report: &impl Serialize) -> Value {
    serde_json::to_value(report).unwrap_or_default()
}

/// Runs `job` completely. Returns its brief, and whether it was run; it is not run if its results are complete and up
/// to date.
///
/// # Errors
/// Those of [`begin`] and [`Made::commit`]; they are also written to [`Job::failure`].
pub fn run(job: &Job, options: &Options, force: bool, watch: Watch) -> Result<(Brief, bool)> {
    let outcome = begin(job, options, force, watch).and_then(|started| match started {
        Started::Unchanged(brief) => Ok((brief, false)),
        Started::Made(made) => Ok((made.commit()?, true)),
    });
    if let Err(error) = &outcome {
        remember_failure(job, &error.to_string());
    }
    outcome
}

/// The reason why a job failed, stored beside its results.
#[derive(Debug, Clone, PartialEq, Serialize, serde::Deserialize)]
pub struct Failure {
    /// `hdralign-failure/1`.
    pub schema: String,
    /// [`Job::id`].
    pub id: String,
    /// The error message.
    pub error: String,
}

impl Failure {
    /// Returns the recorded failure of `job`, if any.
    pub fn read(job: &Job) -> Option<Failure> {
        let failure: Failure =
            serde_json::from_slice(&intake::whole(&job.failure, intake::MOST_OF_A_TEXT).ok()?).ok()?;
        (failure.schema == FAILURE).then_some(failure)
    }
}

/// The version of the format of failures.
const FAILURE: &str = "hdralign-failure/1";

/// Writes `error` to [`Job::failure`], beside the results of `job`. Does nothing if the file cannot be written, or if
/// a file with that name exists that is not a recorded failure.
pub fn remember_failure(job: &Job, error: &str) {
    let failure = Failure { schema: FAILURE.into(), id: job.id.clone(), error: error.into() };
    let text = serde_json::to_string_pretty(&failure).unwrap_or_default() + "\n";
    let folder = job.failure.parent().unwrap_or(Path::new("."));
    let _ = fs::create_dir_all(folder);
    let is_ours = Failure::read(job).is_some();
    let _ = write::complete(&job.failure, text.as_bytes()).and_then(|whole| write::rename_all(vec![whole], is_ours));
}

/// Removes the recorded failure of a job that is done now.
fn forget_failure(job: &Job) {
    if Failure::read(job).is_some() {
        // An error is ignored, because the results are complete. But `batch --summarize` will then show the old
        // failure.
        let _ = fs::remove_file(&job.failure);
    }
}
