//! The plan of a batch: one line for each job. A workflow engine can run the jobs on any machine and in any order, if
//! each job runs after the jobs in its `needs`.
//!
//! In: the brackets that were found, and settings for the results. Out: [`Job`]s, each of which can be written as a
//! line of JSON. Cost: negligible.
//!
//! The line of a job contains everything that affects its results. To run the job, a machine needs this line, the
//! input files and, if the job uses one, the response file. Paths are absolute.

mod names;

use super::estimate::Size;
use super::find::FoundBracket;
use super::name::{Template, Values, plain};
use crate::error::{Error, Result};
use crate::intake;
use crate::pipeline::natural;
use crate::statistics::of_rank;
use names::{JobFiles, Unique};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The version of the format: keys may be added, but are never removed.
pub const SCHEMA: &str = "hdralign-plan/1";

/// The kind of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Merges a bracket.
    Merge,
    /// Recovers the response of a camera from one or more brackets.
    Response,
}

/// One job of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// [`SCHEMA`].
    pub schema: String,
    /// The program and its version, because another version may write files with different bytes.
    pub software: String,
    /// The kind of the job.
    pub kind: Kind,
    /// The identifier of the job, unique in the plan. It contains only letters, digits, `.`, `_` and `-`.
    pub id: String,
    /// Ids of the jobs that must be done first.
    pub needs: Vec<String>,
    /// The photographs in order. If the job has several brackets, the photographs of each are consecutive.
    pub inputs: Vec<PathBuf>,
    /// Number of photographs of each bracket; their sum is the number of `inputs`.
    pub brackets: Vec<usize>,
    /// The number of the panorama that contains the bracket, from 1; null if the job recovers a response.
    pub set: Option<usize>,
    /// The result files.
    pub outputs: Vec<PathBuf>,
    /// The files of `outputs` that come from `--pictures`: they are tone-mapped pictures, whatever their extension.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pictures: Vec<PathBuf>,
    /// The HTML report page, if requested.
    pub page: Option<PathBuf>,
    /// The JSON report. It also contains the record of the job (hashes of its inputs and results).
    pub report: PathBuf,
    /// The JSON file that is written if the job fails. It contains the reason.
    pub failure: PathBuf,
    /// The response file; null if the response is recovered from the bracket.
    pub response: Option<PathBuf>,
    /// The unit of radiance: the relative exposure t ISO / N^2 (s) at which a radiance of 1 has the middle code
    /// value. Null if this is the exposure of the reference frame.
    pub unit_exposure_s: Option<f64>,
    /// Options of `hdralign batch` that affect the results, as the user typed them.
    pub options: Vec<String>,
    /// Width of the photographs in pixels.
    pub width_px: usize,
    /// Height of the photographs in pixels.
    pub height_px: usize,
    /// Number of threads that the estimates of memory and time assume.
    pub threads: usize,
    /// Upper bound of the memory that the job needs, in units of 10^6 bytes.
    pub memory_mb: u64,
    /// Estimated wall time on one core of a server of 2023, in seconds.
    pub time_s: f64,
    /// The JSON file with the summary of all jobs.
    pub summary: PathBuf,
}

/// A bracket, with all its properties that the job depends on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Planned {
    /// The searched folder that contains the bracket.
    pub root: PathBuf,
    /// The folder of the photographs, relative to `root`.
    pub folder: PathBuf,
    /// The photographs in order.
    pub photographs: Vec<PathBuf>,
    /// Width and height of each photograph in pixels, after EXIF orientation.
    pub size: (usize, usize),
    /// Bits per sample.
    pub depth: u8,
    /// Relative exposures t ISO / N^2 (s) of the photographs whose exposure is known.
    pub exposures: Vec<f64>,
    /// Make and model of the camera.
    pub camera: Option<String>,
    /// The time when the first photograph was taken, as in EXIF.
    pub date_time: Option<String>,
    /// The number of the panorama that contains the bracket, from 1.
    pub set: usize,
}

impl From<&FoundBracket> for Planned {
    fn from(found: &FoundBracket) -> Planned {
        let first = found.photographs.first().map(|shot| &shot.header);
        Planned {
            root: found.root.clone(),
            folder: found.folder.clone(),
            photographs: found.photographs.iter().map(|shot| shot.path.clone()).collect(),
            size: first.map_or((0, 0), |header| (header.width, header.height)),
            depth: found.photographs.iter().map(|shot| shot.header.depth).max().unwrap_or(8),
            exposures: found.exposures().into_iter().flatten().collect(),
            camera: first.and_then(|header| header.camera.clone()),
            date_time: first.and_then(|header| Some(header.taken?.to_string())),
            set: found.set + 1,
        }
    }
}

/// The exposure that defines the unit of radiance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Normalisation {
    /// Each bracket has its own scale, from the exposure of its reference frame.
    #[default]
    Bracket,
    /// All brackets of a panorama have the same scale, so that they can be stitched.
    Set,
    /// All brackets of the run have the same scale.
    All,
}

/// The source of the response.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Responses {
    /// The response of each bracket is recovered from that bracket.
    #[default]
    Own,
    /// This response file is used for all brackets.
    Given(PathBuf),
    /// One response for each camera is recovered from all brackets of that camera.
    Shared,
}

/// Settings for the results of all brackets.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Settings {
    /// The folder for the results; `None` to write them into the folder of the photographs (with another
    /// template than the default, below the searched folder).
    pub output: Option<PathBuf>,
    /// The template for the names of results.
    pub template: Template,
    /// Extensions of the results, without dots; at least one.
    pub formats: Vec<String>,
    /// Extensions of the pictures that are written in addition to `formats`.
    pub pictures: Vec<String>,
    /// Whether an HTML report page is written for each bracket.
    pub page: bool,
    /// The source of the response.
    pub responses: Responses,
    /// The exposure that defines the unit of radiance.
    pub normalisation: Normalisation,
    /// Options that affect the results, as the user typed them.
    pub options: Vec<String>,
    /// Whether depth is measured if the scene has depth.
    pub follows: bool,
    /// Whether motion is detected.
    pub seeks_ghosts: bool,
    /// Whether pictures are made by exposure fusion.
    pub fuses: bool,
}

/// Returns the jobs for `brackets`; the jobs that recover a response come first. Ids and file names are unique. They
/// depend on the order of `brackets` only if two jobs would have the same name, if the pattern of the names has the
/// number, or if there are several folders to search and no output folder (then some files go below the first).
///
/// # Errors
/// [`Error::Option`] if a path cannot be made absolute.
pub fn plan(brackets: &[Planned], settings: &Settings) -> Result<Vec<Job>> {
    let absolute = |path: &Path| {
        let reason = |e| Error::Option { option: "FOLDER", reason: format!("{}: {e}", path.display()) };
        std::path::absolute(path).map_err(reason)
    };
    let roots: BTreeSet<&Path> = brackets.iter().map(|b| b.root.as_path()).collect();
    let first_root = brackets.first().map_or(Path::new("."), |b| &b.root);
    let home = absolute(settings.output.as_deref().unwrap_or(first_root))?;
    let summary = home.join("batch.json");
    let units = units(brackets, settings.normalisation);
    let mut files = Unique::default();
    files.reserve([summary.clone(), summary.with_extension("csv")]);
    let mut ids = Unique::default();
    let mut jobs = Vec::with_capacity(brackets.len());
    let shared = match settings.responses {
        Responses::Shared => responses(brackets, settings, &summary, &mut files, &mut ids, absolute)?,
        Responses::Own | Responses::Given(_) => BTreeMap::new(),
    };
    for (i, bracket) in brackets.iter().enumerate() {
        let name =
            settings.template.path(&values(bracket, i, if roots.len() > 1 { Some(&bracket.root) } else { None }));
        let base = match &settings.output {
            Some(_) => home.join(&name),
            // Results go to the searched folder that contains the bracket. So their names need not contain the name
            // of that folder.
            None => absolute(&bracket.root)?.join(settings.template.path(&values(bracket, i, None))),
        };
        let formats = || settings.formats.iter().chain(&settings.pictures).map(String::as_str);
        let base = files.path(base, |base| JobFiles::new(base, formats(), settings.page).all());
        let JobFiles { outputs, page, report, failure } = JobFiles::new(&base, formats(), settings.page);
        let id = ids.text(plain(&name.to_string_lossy()));
        let own = shared.get(&bracket.camera);
        let response = match &settings.responses {
            Responses::Own => None,
            Responses::Given(path) => Some(absolute(path)?),
            Responses::Shared => own.and_then(|job: &Job| job.outputs.first().cloned()),
        };
        let photographs = bracket.photographs.len();
        let size = Size {
            merges: true,
            frames: photographs,
            photographs,
            size: bracket.size,
            bytes: bytes(bracket.depth),
            follows: settings.follows,
            seeks_ghosts: settings.seeks_ghosts,
            fuses: settings.fuses,
        };
        jobs.push(Job {
            schema: SCHEMA.into(),
            software: super::SOFTWARE.into(),
            kind: Kind::Merge,
            needs: own.map(|job| job.id.clone()).into_iter().collect(),
            inputs: bracket.photographs.iter().map(|path| absolute(path)).collect::<Result<_>>()?,
            brackets: vec![photographs],
            set: Some(bracket.set),
            pictures: outputs[settings.formats.len()..].to_vec(),
            outputs,
            page,
            report,
            failure,
            response,
            unit_exposure_s: units.get(&unit_of(bracket, settings.normalisation)).copied().flatten(),
            options: settings.options.clone(),
            width_px: bracket.size.0,
            height_px: bracket.size.1,
            threads: 1,
            memory_mb: size.memory().div_ceil(1_000_000),
            time_s: rounded(size.time_s()),
            summary: summary.clone(),
            id,
        });
    }
    let mut all: Vec<Job> = shared.into_values().collect();
    all.extend(jobs);
    Ok(all)
}

/// Returns for each camera the job that recovers its response from all its brackets.
fn responses(
    brackets: &[Planned],
    settings: &Settings,
    summary: &Path,
    files: &mut Unique,
    ids: &mut Unique,
    absolute: impl Fn(&Path) -> Result<PathBuf>,
) -> Result<BTreeMap<Option<String>, Job>> {
    let mut cameras: BTreeMap<Option<String>, Vec<&Planned>> = BTreeMap::new();
    for bracket in brackets {
        cameras.entry(bracket.camera.clone()).or_default().push(bracket);
    }
    let mut jobs = BTreeMap::new();
    for (camera, brackets) in cameras {
        let name = plain(camera.as_deref().unwrap_or("unknown_camera"));
        let id = ids.text(format!("response-{name}"));
        let wanted = summary.with_file_name(&id);
        let base = files.path(wanted, |base| JobFiles::new(base, ["response.json"], false).all());
        let JobFiles { outputs, page, report, failure } = JobFiles::new(&base, ["response.json"], false);
        let inputs = brackets.iter().flat_map(|b| &b.photographs).map(|path| absolute(path));
        let largest = brackets.iter().map(|b| b.size).max_by_key(|(w, h)| w * h).unwrap_or_default();
        let counts: Vec<usize> = brackets.iter().map(|b| b.photographs.len()).collect();
        let size = Size {
            merges: false,
            frames: counts.iter().copied().max().unwrap_or(0),
            photographs: counts.iter().sum(),
            size: largest,
            bytes: brackets.iter().map(|b| bytes(b.depth)).max().unwrap_or(3),
            follows: settings.follows,
            seeks_ghosts: false,
            fuses: false,
        };
        let job = Job {
            schema: SCHEMA.into(),
            software: super::SOFTWARE.into(),
            kind: Kind::Response,
            needs: Vec::new(),
            inputs: inputs.collect::<Result<_>>()?,
            brackets: counts,
            set: None,
            outputs,
            pictures: Vec::new(),
            page,
            report,
            failure,
            response: None,
            unit_exposure_s: None,
            options: settings.options.clone(),
            width_px: largest.0,
            height_px: largest.1,
            threads: 1,
            memory_mb: size.memory().div_ceil(1_000_000),
            time_s: rounded(size.time_s()),
            summary: summary.to_owned(),
            id,
        };
        jobs.insert(camera, job);
    }
    Ok(jobs)
}

/// Returns the bytes per pixel of a frame in memory, for `depth` bits per sample.
fn bytes(depth: u8) -> usize {
    if depth > 8 { 6 } else { 3 }
}

fn rounded(seconds: f64) -> f64 {
    (seconds * 100.0).round() / 100.0
}

fn values(bracket: &Planned, index: usize, root: Option<&Path>) -> Values {
    let stem = |path: Option<&PathBuf>| path.and_then(|p| p.file_stem()).unwrap_or_default().to_owned();
    let names = || bracket.photographs.iter();
    // `root` is given only if several folders were searched. The results of each of these folders then usually go to a
    // subfolder with its name. (A path such as `.` or `..` has no name.)
    let below = root.and_then(Path::file_name).map(PathBuf::from).unwrap_or_default();
    Values {
        folder: below.join(&bracket.folder),
        first: stem(names().min_by(|a, b| natural(a, b))),
        last: stem(names().max_by(|a, b| natural(a, b))),
        number: index + 1,
        count: bracket.photographs.len(),
        set: bracket.set,
        camera: bracket.camera.clone(),
        date_time: bracket.date_time.clone(),
    }
}

/// Returns the number of the group of brackets that share a unit of radiance and contain `bracket`; `None` if each
/// bracket has its own unit.
fn unit_of(bracket: &Planned, normalisation: Normalisation) -> Option<usize> {
    match normalisation {
        Normalisation::Bracket => None,
        Normalisation::Set => Some(bracket.set),
        Normalisation::All => Some(0),
    }
}

/// Returns the exposure that defines the unit of radiance, for each group of brackets with the same unit (see
/// [`unit_of`]). It is the median of all exposures in the group, which is close to the exposure of the reference
/// frames. If no exposure is known it is 1 s; the jobs then report that the photographs have no exposure.
fn units(brackets: &[Planned], normalisation: Normalisation) -> BTreeMap<Option<usize>, Option<f64>> {
    let mut exposures: BTreeMap<Option<usize>, Vec<f64>> = BTreeMap::new();
    for bracket in brackets {
        exposures.entry(unit_of(bracket, normalisation)).or_default().extend(&bracket.exposures);
    }
    let middle = |all: Vec<f64>| {
        let rank = all.len().saturating_sub(1) / 2;
        of_rank(all, rank).unwrap_or(1.0)
    };
    exposures.into_iter().map(|(unit, all)| (unit, unit.map(|_| middle(all)))).collect()
}

impl Job {
    /// Returns the job as a line of JSON without the newline.
    ///
    /// # Errors
    /// [`Error::Option`] if a path is not valid UTF-8, because JSON cannot contain such a path.
    pub fn to_line(&self) -> Result<String> {
        let all = self.inputs.iter().chain(&self.outputs).chain([&self.report, &self.summary]).chain(&self.response);
        if let Some(path) = all.into_iter().find(|path| path.to_str().is_none()) {
            let reason = format!(
                "{}: the name is not valid UTF-8, so a plan cannot contain it; rename the file, or run the batch without a plan",
                path.display()
            );
            return Err(Error::Option { option: "--plan", reason });
        }
        serde_json::to_string(self).map_err(|e| Error::Option { option: "--plan", reason: e.to_string() })
    }

    /// Reads all jobs of the plan in the file `path`.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::PlanFile`] if the file is not a plan, has another version of the format, or contains
    /// an id twice.
    pub fn read_all(path: &Path) -> Result<Vec<Job>> {
        let text = intake::text(path, intake::MOST_OF_A_PLAN)?;
        let refused = |line: usize, reason: String| Error::PlanFile { path: path.to_owned(), line, reason };
        let mut jobs: Vec<Job> = Vec::new();
        let mut ids = BTreeSet::new();
        for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let job: Job = serde_json::from_str(line).map_err(|e| refused(i + 1, e.to_string()))?;
            if job.schema != SCHEMA {
                return Err(refused(
                    i + 1,
                    format!(
                        "it is a file of another kind or version: its schema is {:?}, but {SCHEMA:?} is required",
                        job.schema
                    ),
                ));
            }
            if job.brackets.iter().try_fold(0_usize, |sum, n| sum.checked_add(*n)) != Some(job.inputs.len()) {
                return Err(refused(
                    i + 1,
                    "the numbers of photographs in `brackets` do not add up to the number of `inputs`".into(),
                ));
            }
            if !ids.insert(job.id.clone()) {
                return Err(refused(i + 1, format!("the id {:?} is used twice", job.id)));
            }
            jobs.push(job);
        }
        Ok(jobs)
    }

    /// Reads the jobs with the given `ids` from the plan in the file `path`, in the order of `ids`.
    ///
    /// # Errors
    /// Those of [`read_all`](Self::read_all); [`Error::Option`] if the plan has no job with one of the `ids`, or if
    /// another version of hdralign made the plan.
    pub fn read(path: &Path, ids: &[String]) -> Result<Vec<Job>> {
        let all = Job::read_all(path)?;
        ids.iter().map(|id| Job::named(path, &all, id)).collect()
    }

    fn named(path: &Path, all: &[Job], id: &str) -> Result<Job> {
        let refused = |option, reason| Err(Error::Option { option, reason });
        match all.iter().find(|job| job.id == id) {
            None => refused(
                "--id",
                format!("{}: the plan has no job with id {id:?}; list the ids with `jq -r .id PLAN`", path.display()),
            ),
            Some(job) if job.software != super::SOFTWARE => refused(
                "--run",
                format!(
                    "{}: this plan was made by {}, but you are running {}, and its results may differ; create the plan again",
                    path.display(),
                    job.software,
                    super::SOFTWARE
                ),
            ),
            Some(job) => Ok(job.clone()),
        }
    }

    /// Returns the photographs of each bracket.
    pub fn by_bracket(&self) -> Vec<Vec<PathBuf>> {
        let mut rest = self.inputs.iter();
        self.brackets.iter().map(|&n| rest.by_ref().take(n).cloned().collect()).collect()
    }
}

#[cfg(test)]
pub(super) mod tests;
