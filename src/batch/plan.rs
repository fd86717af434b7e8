//! The plan: a line for each step, that any engine can run anywhere, in any order that its needs allow.
//!
//! In: brackets that were found, and where their results go. Out: [`Step`]s, and JSON lines of them. Cost: none to speak of.
//!
//! A step needs nothing but its own files: all that acts on its results stands in its line. Paths are absolute.

mod names;

use super::estimate::Size;
use super::find::FoundBracket;
use super::name::{Template, Values, plain};
use crate::error::{Error, Result};
use crate::intake;
use crate::pipeline::natural;
use crate::statistics::of_rank;
use names::{StepFiles, Unique};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The version of the format: keys are only ever added to it.
pub const SCHEMA: &str = "hdralign-plan/1";

/// What is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A bracket is merged.
    Merge,
    /// A camera's response is recovered from brackets.
    Response,
}

/// A step of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// [`SCHEMA`].
    pub schema: String,
    /// The program and its version: another version may give other bytes.
    pub software: String,
    /// What is done.
    pub kind: Kind,
    /// Its name in the plan: letters, digits, `.`, `_` and `-`.
    pub id: String,
    /// Steps that must be done before.
    pub needs: Vec<String>,
    /// The photographs, in their order; of all brackets, one after the other.
    pub inputs: Vec<PathBuf>,
    /// How many of the inputs each bracket has.
    pub brackets: Vec<usize>,
    /// The panorama that the bracket belongs to, from 1; none for a response.
    pub set: Option<usize>,
    /// The results.
    pub outputs: Vec<PathBuf>,
    /// Of the results those that are the picture, whatever their extension.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pictures: Vec<PathBuf>,
    /// The report as a page to look at, where that is wanted.
    pub page: Option<PathBuf>,
    /// The report, as JSON; the step's record is in it.
    pub report: PathBuf,
    /// The JSON file that is written if the job fails, with the reason.
    pub failure: PathBuf,
    /// The response that is used; none where the bracket's own is recovered.
    pub response: Option<PathBuf>,
    /// The relative exposure t ISO / N^2 (s) of which radiance 1 gives the middle code; none for that of the bracket's reference.
    pub unit_exposure_s: Option<f64>,
    /// Options of `hdralign batch` that act on the results, as they are typed.
    pub options: Vec<String>,
    /// Width of the photographs.
    pub width_px: usize,
    /// Height of the photographs.
    pub height_px: usize,
    /// Threads that the estimates are for.
    pub threads: usize,
    /// Memory that is enough, in units of 10^6 bytes.
    pub memory_mb: u64,
    /// Wall time on one core of a server of 2023, about.
    pub time_s: f64,
    /// The summary of all steps.
    pub summary: PathBuf,
}

/// A bracket, as far as its step depends on it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Planned {
    /// Folder for its results when none is named: the one that was searched.
    pub root: PathBuf,
    /// The folder of the photographs below that.
    pub folder: PathBuf,
    /// The photographs, in their order.
    pub photographs: Vec<PathBuf>,
    /// Width and height of each, in pixels, orientation applied.
    pub size: (usize, usize),
    /// Bits of a sample.
    pub depth: u8,
    /// Relative exposures t ISO / N^2 (s), of those that say.
    pub exposures: Vec<f64>,
    /// Make and model.
    pub camera: Option<String>,
    /// When it was taken, as EXIF has it.
    pub date_time: Option<String>,
    /// The panorama that it belongs to, from 1.
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

/// Exposure whose radiance is the unit of a bracket's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Normalisation {
    /// Each bracket's own reference.
    #[default]
    Bracket,
    /// One for all brackets of a panorama, so that their overlaps have the same radiance.
    Set,
    /// One for all brackets.
    All,
}

/// Where the response is from.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Responses {
    /// Each bracket's own.
    #[default]
    Own,
    /// A file, for all.
    Given(PathBuf),
    /// One for each camera, recovered from all its brackets.
    Shared,
}

/// Where results go, and what they have in common.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Settings {
    /// The folder for results; none for beside the photographs.
    pub output: Option<PathBuf>,
    /// Names below that.
    pub template: Template,
    /// Extensions of the results, without dots; there must be one.
    pub formats: Vec<String>,
    /// Extensions of the pictures beside them; none of the same.
    pub pictures: Vec<String>,
    /// Whether a page is made of each.
    pub page: bool,
    /// Where the response is from.
    pub responses: Responses,
    /// Whose exposure is the unit of radiance.
    pub normalisation: Normalisation,
    /// Options that act on the results, as they are typed.
    pub options: Vec<String>,
    /// Whether what moved is sought.
    pub seeks_ghosts: bool,
    /// Whether frames are fused.
    pub fuses: bool,
}

/// The steps for `brackets`, responses first; ids and names are unique, and do not depend on the order of `brackets` where they differ.
///
/// # Errors
/// [`Error::Option`] where a path cannot be made absolute.
pub fn plan(brackets: &[Planned], settings: &Settings) -> Result<Vec<Step>> {
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
    let mut steps = Vec::with_capacity(brackets.len());
    let shared = match settings.responses {
        Responses::Shared => responses(brackets, settings, &summary, &mut files, &mut ids, absolute)?,
        Responses::Own | Responses::Given(_) => BTreeMap::new(),
    };
    for (i, bracket) in brackets.iter().enumerate() {
        let name =
            settings.template.path(&values(bracket, i, if roots.len() > 1 { Some(&bracket.root) } else { None }));
        let base = match &settings.output {
            Some(_) => home.join(&name),
            // Beside the photographs, and below the folder that was searched; several of those are several places already.
            None => absolute(&bracket.root)?.join(settings.template.path(&values(bracket, i, None))),
        };
        let formats = || settings.formats.iter().chain(&settings.pictures).map(String::as_str);
        let base = files.path(base, |base| StepFiles::new(base, formats(), settings.page).all());
        let StepFiles { outputs, page, report, failure } = StepFiles::new(&base, formats(), settings.page);
        let id = ids.text(plain(&name.to_string_lossy()));
        let own = shared.get(&bracket.camera);
        let response = match &settings.responses {
            Responses::Own => None,
            Responses::Given(path) => Some(absolute(path)?),
            Responses::Shared => own.and_then(|step: &Step| step.outputs.first().cloned()),
        };
        let photographs = bracket.photographs.len();
        let size = Size {
            merges: true,
            frames: photographs,
            photographs,
            size: bracket.size,
            bytes: bytes(bracket.depth),
            seeks_ghosts: settings.seeks_ghosts,
            fuses: settings.fuses,
        };
        steps.push(Step {
            schema: SCHEMA.into(),
            software: super::SOFTWARE.into(),
            kind: Kind::Merge,
            needs: own.map(|step| step.id.clone()).into_iter().collect(),
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
    let mut all: Vec<Step> = shared.into_values().collect();
    all.extend(steps);
    Ok(all)
}

/// The steps that recover a response for each camera.
fn responses(
    brackets: &[Planned],
    settings: &Settings,
    summary: &Path,
    files: &mut Unique,
    ids: &mut Unique,
    absolute: impl Fn(&Path) -> Result<PathBuf>,
) -> Result<BTreeMap<Option<String>, Step>> {
    let mut cameras: BTreeMap<Option<String>, Vec<&Planned>> = BTreeMap::new();
    for bracket in brackets {
        cameras.entry(bracket.camera.clone()).or_default().push(bracket);
    }
    let mut steps = BTreeMap::new();
    for (camera, brackets) in cameras {
        let name = plain(camera.as_deref().unwrap_or("unknown_camera"));
        let id = ids.text(format!("response-{name}"));
        let wanted = summary.with_file_name(&id);
        let base = files.path(wanted, |base| StepFiles::new(base, ["response.json"], false).all());
        let StepFiles { outputs, page, report, failure } = StepFiles::new(&base, ["response.json"], false);
        let inputs = brackets.iter().flat_map(|b| &b.photographs).map(|path| absolute(path));
        let largest = brackets.iter().map(|b| b.size).max_by_key(|(w, h)| w * h).unwrap_or_default();
        let counts: Vec<usize> = brackets.iter().map(|b| b.photographs.len()).collect();
        let size = Size {
            merges: false,
            frames: counts.iter().copied().max().unwrap_or(0),
            photographs: counts.iter().sum(),
            size: largest,
            bytes: brackets.iter().map(|b| bytes(b.depth)).max().unwrap_or(3),
            seeks_ghosts: false,
            fuses: false,
        };
        let step = Step {
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
        steps.insert(camera, step);
    }
    Ok(steps)
}

/// Bytes of a pixel in memory.
fn bytes(depth: u8) -> usize {
    if depth > 8 { 6 } else { 3 }
}

fn rounded(seconds: f64) -> f64 {
    (seconds * 100.0).round() / 100.0
}

fn values(bracket: &Planned, index: usize, root: Option<&Path>) -> Values {
    let stem = |path: Option<&PathBuf>| path.and_then(|p| p.file_stem()).unwrap_or_default().to_owned();
    let names = || bracket.photographs.iter();
    // Where several folders were searched, what came of each is in a folder of its own.
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

/// Of which brackets the unit is.
fn unit_of(bracket: &Planned, normalisation: Normalisation) -> Option<usize> {
    match normalisation {
        Normalisation::Bracket => None,
        Normalisation::Set => Some(bracket.set),
        Normalisation::All => Some(0),
    }
}

/// The middle one of the exposures of all brackets that share a unit: about that of their references. Where none is known it is 1 s,
/// and the step says that the photographs do not tell.
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

impl Step {
    /// The step as a line of JSON, without its end.
    ///
    /// # Errors
    /// [`Error::Option`] for a path that is no UTF-8: JSON cannot hold it.
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

    /// The steps in the file `path`.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::PlanFile`] for what is no plan, of another version, or has an id twice.
    pub fn read_all(path: &Path) -> Result<Vec<Step>> {
        let text = intake::text(path, intake::MOST_OF_A_PLAN)?;
        let refused = |line: usize, reason: String| Error::PlanFile { path: path.to_owned(), line, reason };
        let mut steps: Vec<Step> = Vec::new();
        let mut ids = BTreeSet::new();
        for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let step: Step = serde_json::from_str(line).map_err(|e| refused(i + 1, e.to_string()))?;
            if step.schema != SCHEMA {
                return Err(refused(i + 1, format!("its schema is {:?}, and {SCHEMA:?} is read", step.schema)));
            }
            if step.brackets.iter().try_fold(0_usize, |sum, n| sum.checked_add(*n)) != Some(step.inputs.len()) {
                return Err(refused(i + 1, "its brackets do not have as many photographs as there are inputs".into()));
            }
            if !ids.insert(step.id.clone()) {
                return Err(refused(i + 1, format!("the id {:?} stands there twice", step.id)));
            }
            steps.push(step);
        }
        Ok(steps)
    }

    /// The steps `ids` of the plan in the file `path`, in that order.
    ///
    /// # Errors
    /// Those of [`read_all`](Self::read_all); [`Error::Option`] where there is none, or where this version is not the one that planned.
    pub fn read(path: &Path, ids: &[String]) -> Result<Vec<Step>> {
        let all = Step::read_all(path)?;
        ids.iter().map(|id| Step::named(path, &all, id)).collect()
    }

    fn named(path: &Path, all: &[Step], id: &str) -> Result<Step> {
        let refused = |option, reason| Err(Error::Option { option, reason });
        match all.iter().find(|step| step.id == id) {
            None => refused("--id", format!("{}: there is no step {id:?}; `jq -r .id` lists them", path.display())),
            Some(step) if step.software != super::SOFTWARE => refused(
                "--run",
                format!(
                    "{}: this plan is from {}, and this is {}, whose results may have other bytes; create the plan again",
                    path.display(),
                    step.software,
                    super::SOFTWARE
                ),
            ),
            Some(step) => Ok(step.clone()),
        }
    }

    /// The photographs of each bracket.
    pub fn by_bracket(&self) -> Vec<Vec<PathBuf>> {
        let mut rest = self.inputs.iter();
        self.brackets.iter().map(|&n| rest.by_ref().take(n).cloned().collect()).collect()
    }
}

#[cfg(test)]
pub(super) mod tests;
