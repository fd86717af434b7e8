//! One job: merge a bracket or recover a response, completely or not at all, and only if it is not done yet.
//!
//! In: a [`Job`] and its options. Out: its files, and a [`Brief`] of its report. Cost: that of `pipeline::prepare`,
//! and of reading inputs and outputs once for their hashes.
//!
//! A job may be started again at any time by any process: complete results are kept, and interrupted jobs are run
//! again. A job replaces only its own earlier results. Two processes that run the same job at the same time end
//! with the same files.

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
    /// Whether the result is degraded: a frame was rejected or is uncertain, or an exposure or the response was
    /// estimated or assumed.
    pub degraded: bool,
    /// Warnings for the user.
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

    /// Extracts the brief from the report in the file `path`; `None` if that cannot be read.
    pub fn read(path: &Path) -> Option<Brief> {
        Some(Brief::of(&serde_json::from_slice(&intake::whole(path, intake::MOST_OF_A_TEXT).ok()?).ok()?))
    }
}

/// The state of a job after its pixels were computed.
#[derive(Debug)]
pub enum Started<'a> {
    /// The job was done in an earlier run, with the same inputs, options and version.
    Unchanged(Brief),
    /// All results are written to temporary files, which do not have their final names yet.
    Made(Box<Made<'a>>),
}

/// A job whose files are written, but may not be on the disk yet and do not have their final names.
#[derive(Debug)]
pub struct Made<'a> {
    job: &'a Job,
    key: String,
    inputs: Vec<Content>,
    replaced: Vec<String>,
    /// Existing results and report of this job.
    existing: Vec<PathBuf>,
    prepared: Prepared,
}

/// The temporary files of a job and its report, by the kind of the job.
#[derive(Debug)]
enum Prepared {
    Merged(Box<pipeline::Prepared<Report>>),
    Recovered(Box<pipeline::Prepared<CameraReport>>),
}

/// Runs `job` up to the naming of its files. Of `options`, the job itself replaces the files, the response and the unit
/// of radiance. With `force` a finished job is run again, and existing files are replaced even if the job did not write
/// them.
///
/// # Errors
/// Those of [`pipeline::run`]; [`Error::Changed`] if a photograph changed during the run; [`Error::OutputExists`],
/// [`Error::OutputChanged`] and [`Error::OtherPhotographs`] for an existing result that neither this job nor an earlier
/// form of it wrote; [`Error::FrameLost`] if a photograph of the earlier run still exists, but is not in the job.
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
    // The names are checked here, because the message of `pipeline::prepare` would mention -o, which is not an option
    // of `batch`.
    write::check_targets(&Target::of("--name", &results), &job.inputs, true)?;
    let older = existing.iter().filter(|path| **path != job.report);
    let replaced = older.map(|path| Ok(Content::of(path)?.sha256)).collect::<Result<_>>()?;
    let prepared = match job.kind {
        Kind::Merge => Prepared::Merged(Box::new(pipeline::prepare(&job.inputs, options, watch)?)),
        Kind::Response => {
            let options = camera::Options {
                pipeline: options.clone(),
                curves: job.outputs.clone(),
                plots: Vec::new(),
                // One failing bracket does not stop the others.
                lenient: true,
            };
            Prepared::Recovered(Box::new(camera::prepare(&job.by_bracket(), &options, watch)?))
        }
    };
    // Photographs are read once for the record and once for their pixels. If they changed in between, the record would
    // not describe the photographs that were merged.
    stamps.iter().try_for_each(Stamp::check)?;
    Ok(Started::Made(Box::new(Made { job, key, inputs, replaced, existing, prepared })))
}

/// Checks that existing files may be replaced: this job wrote them before, from these photographs.
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
    /// Waits until all files are on the disk, and gives them their names: first the report, so that its record shows
    /// that the other files are from this job even if the process is interrupted.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::OutputExists`] if a file was created in the meantime.
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

/// Names the report and then the results. Files in `existing`, and files that another process wrote in the meantime for
/// the same job (`twin` is its record), are replaced.
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

/// Returns the record of another process that ran the same job in the meantime, if any: a workflow engine may start a
/// job again while it is still running elsewhere.
fn twin(job: &Job, key: &str) -> Option<Record> {
    Record::read(&job.report).filter(|record| record.key == key)
}

/// Returns whether another process that runs the same job, and so writes the same files, has named all of them. Waits
/// for this at most [`TRIES`] tenths of a second.
fn is_done_by_twin(job: &Job, own: &Record) -> bool {
    let results: Vec<PathBuf> = job.outputs.iter().chain(&job.page).cloned().collect();
    let is_done = || twin(job, &own.key).is_some_and(|record| record.is_whole(&results));
    (0..TRIES).any(|i| {
        std::thread::sleep(Duration::from_millis(if i == 0 { 0 } else { 100 }));
        is_done()
    })
}

/// Number of checks, a tenth of a second apart, whether another process that runs the same job has renamed all its
/// files.
const TRIES: u32 = 50;

/// Returns the [`Content`] of a complete temporary file under its final name.
fn content(file: &CompleteFile) -> Result<Content> {
    let target = file.target();
    let failed = |source| Error::Write { path: target.to_owned(), source };
    Content::read(target, file.open().map_err(failed)?).map_err(failed)
}

/// Returns `report` as JSON. It contains only strings, numbers and lists of them, so the conversion cannot fail.
fn as_value(report: &impl Serialize) -> Value {
    serde_json::to_value(report).unwrap_or_default()
}

/// Runs `job` completely. Returns its brief, and true if it was run, or false if its results existed already.
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

/// Writes `error` to [`Job::failure`], beside the results of `job`. Nothing happens if this is not possible, or if a
/// file with that name exists that is not a recorded failure.
pub fn remember_failure(job: &Job, error: &str) {
    let failure = Failure { schema: FAILURE.into(), id: job.id.clone(), error: error.into() };
    let text = serde_json::to_string_pretty(&failure).unwrap_or_default() + "\n";
    let folder = job.failure.parent().unwrap_or(Path::new("."));
    let _ = fs::create_dir_all(folder);
    let is_ours = Failure::read(job).is_some();
    let _ = write::complete(&job.failure, text.as_bytes()).and_then(|whole| write::rename_all(vec![whole], is_ours));
}

/// Removes the recorded failure of a completed job.
fn forget_failure(job: &Job) {
    if Failure::read(job).is_some() {
        // An error is ignored: the results are complete. A summary from files then shows the old failure.
        let _ = fs::remove_file(&job.failure);
    }
}
