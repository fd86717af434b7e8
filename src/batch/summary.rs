//! The summary of a batch: one row for each job, written as JSON and as CSV.
//!
//! In: jobs and their outcomes. If the outcomes are not given, they are read from the files of the jobs. Out: a
//! [`Summary`]. Cost: negligible, except for reading the jobs' reports.

use super::job::{Brief, Failure};
use super::plan::{Job, Kind};
use super::record::Record;
use super::schedule::Ending;
use crate::error::{Error, Result};
use crate::intake;
use crate::write::{self, Target};
use serde::{Deserialize, Serialize};
use std::io;
use std::path::{Path, PathBuf};

/// The version of the format: keys may be added, but are never removed.
pub const SCHEMA: &str = "hdralign-batch/1";

/// The status of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// The job was done in this run. If the summary is made from files, the job was done in any run.
    Done,
    /// The job was done in a previous run, with the same inputs, options and version.
    Unchanged,
    /// The job failed.
    Failed,
    /// The job was not started, or was interrupted.
    NotDone,
}

impl Status {
    /// Returns the name of the status, as in the JSON and CSV files.
    pub fn name(self) -> &'static str {
        match self {
            Status::Done => "done",
            Status::Unchanged => "unchanged",
            Status::Failed => "failed",
            Status::NotDone => "not-done",
        }
    }
}

/// A row of the summary: one job.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// [`Job::id`].
    pub id: String,
    /// The kind of job.
    pub kind: Kind,
    /// The status of this job.
    pub status: Status,
    /// The number of the panorama that contains the bracket, from 1; null if the job recovers a response.
    pub set: Option<usize>,
    /// The paths of the photographs.
    pub photographs: Vec<String>,
    /// The paths of the results, if the job is done.
    pub outputs: Vec<String>,
    /// The path of the report, if the job is done.
    pub report: Option<String>,
    /// The error message, if the job failed.
    pub error: Option<String>,
    /// Values extracted from the report of the job.
    #[serde(flatten)]
    pub brief: Brief,
}

/// A photograph that is in no bracket, or a folder that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Unused {
    /// The path of the file.
    pub path: String,
    /// Why it is in no bracket, or why the folder cannot be read.
    pub reason: String,
}

/// Numbers of jobs by status.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Counts {
    /// Number of all jobs (`steps` in the JSON).
    #[serde(rename = "steps")]
    pub jobs: usize,
    /// Number of jobs that are [`Status::Done`].
    pub done: usize,
    /// Number of jobs that are [`Status::Unchanged`].
    pub unchanged: usize,
    /// Number of jobs that are [`Status::Failed`].
    pub failed: usize,
    /// Number of jobs that are [`Status::NotDone`].
    pub not_done: usize,
    /// Number of done or unchanged jobs with a degraded result ([`Brief::degraded`]).
    pub degraded: usize,
}

/// The summary of a batch.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// The program and its version.
    pub software: &'static str,
    /// Numbers of jobs by status.
    pub counts: Counts,
    /// The jobs, in the order of the plan (`steps` in the JSON).
    #[serde(rename = "steps")]
    pub jobs: Vec<Row>,
    /// Photographs that are in no bracket, and folders that cannot be read; null if the summary is made from a plan,
    /// which does not contain them.
    pub left_over: Option<Vec<Unused>>,
    /// Wall time in seconds; null if the summary is made from files, because the jobs may have run on other machines.
    pub time_s: Option<f64>,
}

/// The outcome of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Every job is done.
    All,
    /// No job is done.
    None,
    /// Some jobs are done, but not all.
    Some,
}

impl Outcome {
    /// Returns the outcome if `done` of `all` jobs are done; [`Outcome::None`] if there are no jobs.
    pub fn of(done: usize, all: usize) -> Outcome {
        match done {
            0 => Outcome::None,
            _ if done == all => Outcome::All,
            _ => Outcome::Some,
        }
    }
}

impl Summary {
    /// Creates the summary of `jobs`, whose outcomes are `endings` in the same order.
    pub fn new(jobs: &[Job], endings: &[Ending], left_over: Vec<Unused>, time_s: f64) -> Summary {
        let rows = jobs.iter().zip(endings).map(|(job, ending)| {
            let (status, brief, error) = match ending {
                Ending::Done(brief) => (Status::Done, brief.clone(), None),
                Ending::Unchanged(brief) => (Status::Unchanged, brief.clone(), None),
                Ending::Failed(error) => (Status::Failed, Brief::default(), Some(error.clone())),
                Ending::NotStarted => (Status::NotDone, Brief::default(), None),
            };
            row(job, status, brief, error)
        });
        Summary::of(rows.collect(), Some(left_over), Some(time_s))
    }

    /// Creates the summary of `jobs` from their files, for jobs that were run elsewhere. A job has failed if its
    /// failure file exists. It is done if its report has the same options and version and its results are complete.
    pub fn collected(jobs: &[Job]) -> Summary {
        let rows = jobs.iter().map(|job| {
            let results: Vec<PathBuf> = job.outputs.iter().chain(&job.page).cloned().collect();
            let record = Record::read(&job.report).filter(|record| {
                record.options == job.options && record.software == job.software && record.is_whole(&results)
            });
            match (record.and_then(|_| Brief::read(&job.report)), Failure::read(job)) {
                // A completed job removes its failure file. So if both the report and the failure file exist, the
                // report is of an earlier run, and the job failed later.
                (_, Some(failure)) => row(job, Status::Failed, Brief::default(), Some(failure.error)),
                (Some(brief), None) => row(job, Status::Done, brief, None),
                (None, None) => row(job, Status::NotDone, Brief::default(), None),
            }
        });
        Summary::of(rows.collect(), None, None)
    }

    fn of(jobs: Vec<Row>, left_over: Option<Vec<Unused>>, time_s: Option<f64>) -> Summary {
        let count = |status| jobs.iter().filter(|row| row.status == status).count();
        let counts = Counts {
            jobs: jobs.len(),
            done: count(Status::Done),
            unchanged: count(Status::Unchanged),
            failed: count(Status::Failed),
            not_done: count(Status::NotDone),
            degraded: jobs.iter().filter(|row| row.brief.degraded).count(),
        };
        Summary { schema: SCHEMA, software: super::SOFTWARE, counts, jobs, left_over, time_s }
    }

    /// Returns the outcome of the batch.
    pub fn outcome(&self) -> Outcome {
        Outcome::of(self.counts.done + self.counts.unchanged, self.counts.jobs)
    }

    /// Returns the summary as JSON, with a newline at the end.
    pub fn to_json(&self) -> String {
        // The summary contains only strings, numbers and lists of them, so the conversion cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Returns the summary as CSV (RFC 4180, but lines end with LF): a header row, then a row for each job.
    pub fn to_csv(&self) -> String {
        let mut writer = csv::Writer::from_writer(Vec::new());
        // Writing to memory does not fail, and all rows have the same length.
        let _ = writer.write_record(COLUMNS);
        for row in &self.jobs {
            let number = |n: Option<f64>| n.map(|n| n.to_string()).unwrap_or_default();
            let _ = writer.write_record([
                row.id.clone(),
                row.status.name().to_owned(),
                row.set.map(|set| set.to_string()).unwrap_or_default(),
                row.photographs.len().to_string(),
                row.photographs.first().cloned().unwrap_or_default(),
                row.photographs.last().cloned().unwrap_or_default(),
                row.outputs.join(";"),
                row.brief.left_out.to_string(),
                number(row.brief.least_confidence),
                row.brief.degraded.to_string(),
                row.brief.warnings.join("; "),
                row.error.clone().unwrap_or_default(),
                number(row.brief.time_s),
            ]);
        }
        writer.into_inner().map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default()
    }

    /// Writes the summary as JSON to `path`, and as CSV to the same path with the extension `csv`. Existing files are
    /// replaced under the conditions of [`check`].
    ///
    /// # Errors
    /// [`Error::Write`]. This includes the case that a file exists which may not be replaced.
    pub fn write(&self, path: &Path, overwrite: bool) -> Result<[PathBuf; 2]> {
        let [json, table] = files(path);
        let whole = vec![
            write::complete(&json, self.to_json().as_bytes())?,
            write::complete(&table, self.to_csv().as_bytes())?,
        ];
        write::rename_all(whole, overwrite || is_summary(path)).map_err(kept)?;
        Ok([json, table])
    }
}

/// Checks that a summary can be written to `path`, before any job runs. An existing file may be replaced if it is the
/// summary of another run, or if `overwrite` is true. The CSV file beside it does not itself show that it is a
/// summary. So it may be replaced if the JSON file may be replaced.
///
/// # Errors
/// [`Error::Write`].
pub fn check(path: &Path, overwrite: bool) -> Result<()> {
    write::check_targets(&Target::of("-d", &files(path)), &[], overwrite || is_summary(path)).map_err(kept)
}

/// Returns the paths of the JSON file and the CSV file.
fn files(path: &Path) -> [PathBuf; 2] {
    [path.to_owned(), path.with_extension("csv")]
}

/// Returns whether the file `path` is a summary: its schema is [`SCHEMA`].
fn is_summary(path: &Path) -> bool {
    #[derive(Deserialize)]
    struct Header {
        schema: String,
    }
    // A summary is about as long as the plan of the same jobs, so the same limit on the length is used.
    let header = intake::whole(path, intake::MOST_OF_A_PLAN).ok().and_then(|text| serde_json::from_slice(&text).ok());
    header.is_some_and(|Header { schema }| schema == SCHEMA)
}

/// Replaces [`Error::OutputExists`], which advises to choose another name. A summary cannot have another name, so the
/// new error gives other advice.
fn kept(error: Error) -> Error {
    let Error::OutputExists { path } = error else { return error };
    let reason =
        "it exists already, and `hdralign batch` may not have written it; move it away, or replace it with --force";
    Error::Write { path, source: io::Error::new(io::ErrorKind::InvalidInput, reason) }
}

const COLUMNS: [&str; 13] = [
    "id",
    "status",
    "set",
    "photographs",
    "first",
    "last",
    "outputs",
    "left_out",
    "least_confidence",
    "degraded",
    "warnings",
    "error",
    "time_s",
];

fn row(job: &Job, status: Status, brief: Brief, error: Option<String>) -> Row {
    let text = |path: &PathBuf| path.to_string_lossy().into_owned();
    let is_done = matches!(status, Status::Done | Status::Unchanged);
    let results = job.outputs.iter().chain(&job.page);
    Row {
        id: job.id.clone(),
        kind: job.kind,
        status,
        set: job.set,
        photographs: job.inputs.iter().map(text).collect(),
        outputs: results.filter(|_| is_done).map(text).collect(),
        report: is_done.then(|| text(&job.report)),
        error,
        brief,
    }
}

#[cfg(test)]
mod tests {
    use super::super::plan::tests::job;
    use super::*;

    fn summary(endings: &[Ending]) -> Summary {
        let jobs: Vec<Job> = endings.iter().map(|_| job()).collect();
        Summary::new(&jobs, endings, Vec::new(), 1.5)
    }

    #[test]
    fn outcome_is_all_some_or_none() {
        let done = || Ending::Done(Brief::default());
        let failed = || Ending::Failed("x, \"y\"\nz".into());
        assert_eq!(summary(&[done(), Ending::Unchanged(Brief::default())]).outcome(), Outcome::All);
        assert_eq!(summary(&[done(), failed()]).outcome(), Outcome::Some);
        assert_eq!(summary(&[Ending::NotStarted, failed()]).outcome(), Outcome::None);
        assert_eq!(summary(&[]).outcome(), Outcome::None);
    }

    #[test]
    fn every_job_has_a_row() {
        let degraded = Brief { degraded: true, left_out: 1, least_confidence: Some(0.25), ..Brief::default() };
        let all = summary(&[Ending::Done(degraded), Ending::Failed("a, \"b\"".into())]);
        let json: serde_json::Value = serde_json::from_str(&all.to_json()).unwrap();
        assert_eq!((&json["schema"], &json["time_s"]), (&SCHEMA.into(), &1.5.into()));
        assert_eq!((&json["counts"]["done"], &json["counts"]["degraded"]), (&1.into(), &1.into()));
        assert_eq!(json["steps"][0]["least_confidence"], 0.25);
        assert_eq!(json["steps"][1]["status"], "failed");
        assert!(json["steps"][1]["outputs"].as_array().unwrap().is_empty());
        let table = all.to_csv();
        let mut reader = csv::Reader::from_reader(table.as_bytes());
        let rows: Vec<csv::StringRecord> = reader.records().map(|r| r.unwrap()).collect();
        assert_eq!((rows.len(), &rows[1][11]), (2, "a, \"b\""));
        assert_eq!(&rows[0][6], "/in/a/IMG_1-IMG_2.exr;/in/a/IMG_1-IMG_2.png");
    }
}
