//! A camera's response from one or many brackets: load, align and fine-tune each, pool their samples, save the curve and draw it.
//!
//! In: photographs and folders of them, and [`Options`]. Out: response files, plots, and a [`CameraReport`]. Cost: loading and aligning
//! each bracket, one after the other; of each, what its flat places show is kept.
//! Source: the pooling is that of `response::recover_from`: what a camera does is the same in all its brackets, and together they show
//! more of its codes.

use super::line::Line;
use super::names::natural;
use super::{Progress, check_placed, in_pool};
use crate::align::given::Given;
use crate::bracket::{Capture, ReferenceChoice};
use crate::error::{Error, Result, Warning};
use crate::inspect::response_plot;
use crate::report::{FrameReport, Report, WarningReport};
use crate::response::file::{Format, SavedResponse};
use crate::response::ratios::{self, Exposures};
use crate::response::samples::{self, Places};
use crate::response::{self, ResponseReport};
use crate::write::{self, Written};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The version of the report's format: keys are only ever added to it.
pub const SCHEMA: &str = "hdralign-response-report/1";

/// Extensions of the photographs that are taken from a folder, in any case.
const PHOTOGRAPHS: [&str; 5] = ["jpg", "jpeg", "png", "tif", "tiff"];
/// Places of each channel in a plot.
const DRAWN: usize = 600;

/// What is made, and how.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// How brackets are loaded and aligned, exposures tuned, the response recovered and files replaced; what it says of outputs does not
    /// count.
    pub line: super::Options,
    /// The curve is saved here, by extension as `.json`, `.rsp` or `.csv`; where there is none, beside the first photograph, named after
    /// the camera.
    pub curves: Vec<PathBuf>,
    /// The curve is drawn here, by extension as `.svg` or `.png`.
    pub plots: Vec<PathBuf>,
}

/// What was done.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraReport {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// The program and its version.
    pub software: &'static str,
    /// EXIF Make of the first bracket.
    pub camera_make: Option<String>,
    /// EXIF Model of the first bracket.
    pub camera_model: Option<String>,
    /// The brackets used.
    pub brackets: Vec<BracketReport>,
    /// How the curve was had, and how well it is known.
    pub response: ResponseReport,
    /// The files written.
    pub outputs: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<WarningReport>,
    /// Wall time in seconds.
    pub time_s: f64,
}

/// One bracket.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BracketReport {
    /// The frame that the others are aligned to.
    pub reference: String,
    /// The frames by rising exposure.
    pub frames: Vec<FrameReport>,
}

impl CameraReport {
    /// The report as JSON, ended by a line feed.
    pub fn to_json(&self) -> String {
        // Strings, numbers and lists of them: nothing in it can fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Whether the result is less than what was asked for.
    pub fn is_degraded(&self) -> bool {
        self.warnings.iter().any(|w| w.degrades)
    }
}

/// What is kept of a bracket: its frames are not.
struct Seen {
    /// The reference's file.
    path: PathBuf,
    capture: Capture,
    places: Places,
    report: BracketReport,
}

/// Recovers the response of the camera that took `images`, photographs and folders; those of one folder are one bracket.
///
/// # Errors
/// See [`Error`]; on any of them no file is there that was not before. [`Error::NoResponse`] where the brackets do not tell.
pub fn run(images: &[PathBuf], options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<CameraReport> {
    in_pool(options.line.threads, || {
        options.line.align.validate()?;
        let brackets = brackets(images)?;
        check_options(&brackets, options)?;
        let photographs = brackets.concat();
        check_names(&photographs, options)?;
        let mut line = Line::new(watch);
        let mut seen: Vec<Seen> = Vec::with_capacity(brackets.len());
        let mut found_given = 0;
        for paths in &brackets {
            let mut own = options.line.clone();
            let bracket = line.load(paths, &own)?;
            if brackets.len() > 1 {
                own.align.given.retain(|given: &Given| bracket.named(&given.path).is_some());
            }
            found_given += own.align.given.len();
            let alignment = line.align(&bracket, &own)?;
            check_placed(&bracket, &alignment)?;
            let mut places = Places::of(&bracket, &alignment)?;
            let mut bracket = bracket;
            if own.exposures == Exposures::FineTuned {
                let (tuned, warnings) = ratios::fine_tuned(bracket, &mut places);
                line.warnings.extend(warnings);
                bracket = tuned;
            }
            let Report { reference, frames, .. } = Report::new(&bracket, &alignment, alignment.overlap);
            let first = bracket.reference();
            let (path, capture) = (first.path().to_owned(), first.capture.clone());
            seen.push(Seen { path, capture, places, report: BracketReport { reference, frames } });
        }
        if found_given < options.line.align.given.len() {
            let reason = "a photograph named there is in none of the brackets".to_owned();
            return Err(Error::Option { option: "--leave-out or --unmoved", reason });
        }
        line.warnings.extend(differing_cameras(&seen));
        let places: Vec<&Places> = seen.iter().map(|bracket| &bracket.places).collect();
        let (curve, recovered, warnings) = response::recover_from(&places, &options.line.response)?;
        line.warnings.extend(warnings);
        let first = &seen[0];
        if let Some(reason) = recovered.fallback {
            return Err(Error::NoResponse { path: first.path.clone(), reason });
        }
        let saved = SavedResponse { make: first.capture.make.clone(), model: first.capture.model.clone(), curve };
        let mut files = Vec::new();
        let mut curves = options.curves.clone();
        if curves.is_empty() {
            let path = default_output(&photographs, &saved);
            write::check_targets(std::slice::from_ref(&path), &photographs, options.line.write.overwrite)?;
            curves.push(path);
        }
        for path in &curves {
            let encoded = saved.encode(path)?;
            let mut written = write::text(path, &encoded.text)?;
            written.warnings.extend(encoded.lossy(path));
            files.push(written);
        }
        if !options.plots.is_empty() {
            files.extend(plots(&saved, &recovered, &seen, &options.plots)?);
        }
        let names: Vec<PathBuf> = files.iter().map(|w| w.file.target().to_path_buf()).collect();
        let mut pending = Vec::new();
        for written in files {
            line.warnings.extend(written.warnings);
            pending.push(written.file);
        }
        write::commit(pending, options.line.write.overwrite)?;
        Ok(CameraReport {
            schema: SCHEMA,
            software: concat!("hdralign ", env!("CARGO_PKG_VERSION")),
            camera_make: saved.make.clone(),
            camera_model: saved.model.clone(),
            brackets: seen.into_iter().map(|bracket| bracket.report).collect(),
            response: recovered,
            outputs: names.iter().map(|p| p.to_string_lossy().into_owned()).collect(),
            warnings: line.warnings.iter().map(WarningReport::from).collect(),
            time_s: line.began.elapsed().as_secs_f64(),
        })
    })
}

/// `images` by the folders that they are in, in the order of the first of each; of a folder, the photographs in it by name.
fn brackets(images: &[PathBuf]) -> Result<Vec<Vec<PathBuf>>> {
    let mut found: Vec<(PathBuf, Vec<PathBuf>)> = Vec::new();
    for image in images {
        let paths = if image.is_dir() { photographs(image)? } else { vec![image.clone()] };
        for path in paths {
            let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
            match found.iter_mut().find(|(name, _)| *name == folder) {
                Some((_, bracket)) => bracket.push(path),
                None => found.push((folder, vec![path])),
            }
        }
    }
    if let Some((folder, bracket)) = found.iter().find(|(_, bracket)| bracket.len() < 2) {
        if found.len() == 1 && images.len() == 1 && !images[0].is_dir() {
            return Err(Error::TooFewFrames { given: bracket.len() });
        }
        let reason = format!(
            "of the folder {:?} only {} is given; the photographs of one folder are one bracket, and need to be two or more",
            folder.display().to_string(),
            bracket[0].display()
        );
        return Err(Error::Option { option: "IMAGES", reason });
    }
    Ok(found.into_iter().map(|(_, bracket)| bracket).collect())
}

/// The photographs in `folder`, by their extensions and in the order of their names.
fn photographs(folder: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = |source| Error::Read { path: folder.to_owned(), source };
    let entries = std::fs::read_dir(folder).map_err(unreadable)?;
    let mut paths = entries.map(|e| Ok(e?.path())).collect::<std::io::Result<Vec<_>>>().map_err(unreadable)?;
    let extension = |p: &Path| p.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let is_hidden = |p: &Path| p.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
    paths.retain(|p| PHOTOGRAPHS.contains(&extension(p).as_str()) && !is_hidden(p) && p.is_file());
    paths.sort_by(|a, b| natural(a, b));
    if paths.len() < 2 {
        let found = paths.len();
        let reason =
            format!("{} holds {found} photographs (.jpg, .png, .tif), and a bracket needs two", folder.display());
        return Err(Error::Option { option: "IMAGES", reason });
    }
    Ok(paths)
}

/// What is said of single frames by their number in one bracket is for one bracket.
fn check_options(brackets: &[Vec<PathBuf>], options: &Options) -> Result<()> {
    let single = |option, reason: &str| Err(Error::Option { option, reason: reason.to_owned() });
    if brackets.len() > 1 && options.line.load.ev.is_some() {
        return single("-e", "it is for one bracket, and there are several; calibrate by that bracket alone");
    }
    if brackets.len() > 1 && matches!(options.line.load.reference, ReferenceChoice::File(_)) {
        return single(
            "--reference",
            "a file is in one bracket, and there are several; give a number, or leave it out",
        );
    }
    Ok(())
}

/// Whether everything asked for can be written, before any work is done.
fn check_names(photographs: &[PathBuf], options: &Options) -> Result<()> {
    options.curves.iter().try_for_each(|path| Format::of(path).map(|_| ()))?;
    options.plots.iter().try_for_each(|path| response_plot::Format::of(path).map(|_| ()))?;
    let files: Vec<PathBuf> = options.curves.iter().chain(&options.plots).cloned().collect();
    write::check_targets(&files, photographs, options.line.write.overwrite)
}

/// Beside the first photograph, named after the camera: `Canon_EOS_5D.json`; `response.json` where it does not say.
fn default_output(photographs: &[PathBuf], saved: &SavedResponse) -> PathBuf {
    let name = saved.camera();
    let letter = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '.' | '+') { c } else { '_' };
    let name = name.map_or("response".to_owned(), |name| name.chars().map(letter).collect());
    let first = photographs.first().map(PathBuf::as_path).unwrap_or(Path::new(""));
    first.with_file_name(name + ".json")
}

fn differing_cameras(seen: &[Seen]) -> Vec<Warning> {
    let name = |bracket: &Seen| bracket.capture.camera();
    let Some(kept) = seen.first().and_then(name) else { return Vec::new() };
    let others = seen.iter().filter_map(|bracket| Some((bracket, name(bracket)?)));
    let others = others.filter(|(_, found)| *found != kept);
    others
        .map(|(bracket, found)| Warning::CamerasDiffer { path: bracket.path.clone(), found, kept: kept.clone() })
        .collect()
}

/// The plots, whole but not yet named.
fn plots(saved: &SavedResponse, recovered: &ResponseReport, seen: &[Seen], paths: &[PathBuf]) -> Result<Vec<Written>> {
    let places: Vec<&Places> = seen.iter().map(|bracket| &bracket.places).collect();
    let drawn = samples::draw(&places, DRAWN);
    let title = saved.camera().unwrap_or_else(|| "Camera response".to_owned());
    let frames: usize = seen.iter().map(|bracket| bracket.report.frames.len()).sum();
    let mut notes = format!("{}, from {frames} photographs in {}.", recovered.model, counted(seen.len(), "bracket"));
    if let Some(fits) = &recovered.channels {
        let residuals = fits.map(|fit| format!("{:.3}", fit.residual_stops));
        notes +=
            &format!(" Residual of red, green and blue: {} stops. Dots: places of the scene.", residuals.join(", "));
    }
    let drawing = response_plot::draw(&title, &saved.curve, &drawn, &notes);
    paths.iter().map(|path| write::bytes(path, &response_plot::encode(&drawing, path)?)).collect()
}

fn counted(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_of_a_folder_are_a_bracket() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for folder in ["a", "b", "empty"] {
            std::fs::create_dir(at(folder)).unwrap();
        }
        for name in ["a/10.JPG", "a/9.jpg", "a/notes.txt", "a/.10.jpg", "b/1.png", "b/2.tif"] {
            std::fs::write(at(name), "").unwrap();
        }
        let all = brackets(&[at("a"), at("b/2.tif"), at("b/1.png")]).unwrap();
        assert_eq!(all, [[at("a/9.jpg"), at("a/10.JPG")], [at("b/2.tif"), at("b/1.png")]]);
        assert!(brackets(&[at("empty")]).unwrap_err().to_string().contains("0 photographs"));
        assert!(brackets(&[at("a"), at("b/1.png")]).unwrap_err().to_string().contains("only"));
        assert!(matches!(brackets(&[at("b/1.png")]), Err(Error::TooFewFrames { given: 1 })));
    }

    #[test]
    fn the_response_is_named_after_the_camera() {
        let saved = |model: Option<&str>| SavedResponse {
            make: None,
            model: model.map(str::to_owned),
            curve: crate::response::ResponseCurve::srgb(),
        };
        let photographs = [PathBuf::from("d/1.jpg")];
        assert_eq!(default_output(&photographs, &saved(Some("X/Y 3"))), PathBuf::from("d/X_Y_3.json"));
        assert_eq!(default_output(&photographs, &saved(None)), PathBuf::from("d/response.json"));
    }
}
