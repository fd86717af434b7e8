//! A camera's response from one or many brackets: load, align and fine-tune each, pool their samples, save the curve and draw it.
//!
//! In: brackets, or folders of photographs, and [`Options`]. Out: response files, plots, and a [`CameraReport`]. Cost: loading and aligning
//! each bracket, one after the other; of each, what its flat places show is kept.
//! Source: the pooling is that of `response::recover_from`: what a camera does is the same in all its brackets, and together they show
//! more of its codes.

mod folders;
mod seen;

use super::threads::in_pool;
use super::{Prepared, Watch};
use crate::bracket::ReferenceChoice;
use crate::error::{Error, Result};
use crate::inspect::sheets::response as response_plot;
use crate::pipeline::files::curves;
use crate::report::{FrameReport, WarningReport};
use crate::response::file::{Format, SavedResponse};
use crate::response::samples::{self, Places};
use crate::response::{self, ResponseReport};
use crate::write::{self, Target, Written};
use seen::Seen;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The version of the report's format: keys are only ever added to it.
pub const SCHEMA: &str = "hdralign-response-report/1";

/// Patches that are kept of all brackets together, at most: 72 bytes each, and as many of every bracket.
pub const PATCHES: usize = 500_000;
/// Places of each channel in a plot.
const DRAWN: usize = 600;

/// What is made, and how.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// How brackets are loaded and aligned, exposures tuned, the response recovered and files replaced; what it says of outputs does not
    /// count.
    pub pipeline: super::Options,
    /// The curve is saved here, by extension as `.json`, `.rsp` or `.csv`; where there is none, beside the first photograph, named after
    /// the camera.
    pub curves: Vec<PathBuf>,
    /// The curve is drawn here, by extension as `.svg` or `.png`.
    pub plots: Vec<PathBuf>,
    /// Whether a bracket that cannot be loaded or aligned is left out with a warning, instead of stopping all.
    pub lenient: bool,
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

impl Options {
    /// Every file that a run on `images` writes; where none is named, one of a name that the photographs will tell.
    pub fn targets(&self, images: &[PathBuf]) -> Vec<Target> {
        let mut named = self.named();
        let is_beside = |image: &PathBuf| if image.is_dir() { image.join("response.json") } else { image.clone() };
        if self.curves.is_empty() {
            named.extend(Target::of("-o", images.first().map(is_beside).as_slice()));
        }
        named
    }

    /// Those that are named.
    fn named(&self) -> Vec<Target> {
        [Target::of("-o", &self.curves), Target::of("--plot", &self.plots)].concat()
    }
}

/// Recovers the response of the camera that took `images`, photographs and folders; those of one folder are one bracket.
///
/// # Errors
/// Those of [`prepare`]; [`Error::Option`] where a folder holds no bracket, or something is said of one bracket and there are several.
pub fn run(images: &[PathBuf], options: &Options, watch: Watch) -> Result<CameraReport> {
    let brackets = folders::brackets(images)?;
    check_options(&brackets, options)?;
    prepare(&brackets, options, watch)?.commit()
}

/// Recovers the response of the camera that took the photographs `brackets`, each a list of its own; its files are not named yet. Of hundreds of brackets no more is in memory
/// than the frames of one, and [`PATCHES`] patches.
///
/// # Errors
/// See [`Error`]; on any of them no file is there that was not before. [`Error::NoResponse`] where the brackets do not tell, or where
/// none can be used.
pub fn prepare(brackets: &[Vec<PathBuf>], options: &Options, watch: Watch) -> Result<Prepared<CameraReport>> {
    in_pool(options.pipeline.threads, || {
        options.pipeline.align.validate()?;
        let photographs = brackets.concat();
        check_names(&photographs, options)?;
        let began = Instant::now();
        let (seen, mut warnings) = seen::see(brackets, options, watch)?;
        let (curve, recovered, more) = response::recover_from(&places(&seen), &options.pipeline.response)?;
        warnings.extend(more);
        let first = &seen[0];
        if let Some(reason) = recovered.fallback {
            return Err(Error::NoResponse { path: first.path.clone(), reason });
        }
        let saved = SavedResponse { make: first.capture.make.clone(), model: first.capture.model.clone(), curve };
        let mut files = Vec::new();
        let mut curves = options.curves.clone();
        if curves.is_empty() {
            let path = default_output(&photographs, &saved);
            let target = Target::of("-o", std::slice::from_ref(&path));
            write::check_targets(&target, &photographs, options.pipeline.write.overwrite)?;
            curves.push(path);
        }
        let miniatures: Vec<_> = seen.iter().filter_map(|bracket| bracket.miniature.as_ref()).collect();
        for path in &curves {
            files.push(curves::written(&saved, path, &miniatures)?);
        }
        if !options.plots.is_empty() {
            files.extend(plots(&saved, &recovered, &seen, &options.plots)?);
        }
        let names: Vec<PathBuf> = files.iter().map(|w| w.file.target().to_path_buf()).collect();
        let mut pending = Vec::new();
        for written in files {
            warnings.extend(written.warnings);
            pending.push(written.file);
        }
        let report = CameraReport {
            schema: SCHEMA,
            software: concat!("hdralign ", env!("CARGO_PKG_VERSION")),
            camera_make: saved.make.clone(),
            camera_model: saved.model.clone(),
            brackets: seen.into_iter().map(|bracket| bracket.report).collect(),
            response: recovered,
            outputs: names.iter().map(|p| p.to_string_lossy().into_owned()).collect(),
            warnings: warnings.iter().map(WarningReport::from).collect(),
            time_s: began.elapsed().as_secs_f64(),
        };
        Ok(Prepared { report, files: pending, overwrite: options.pipeline.write.overwrite })
    })
}

/// What is said of single frames by their number in one bracket is for one bracket.
fn check_options(brackets: &[Vec<PathBuf>], options: &Options) -> Result<()> {
    let single = |option, reason: &str| Err(Error::Option { option, reason: reason.to_owned() });
    if brackets.len() > 1 && options.pipeline.load.ev.is_some() {
        return single("-e", "it is for one bracket, and there are several; calibrate by that bracket alone");
    }
    if brackets.len() > 1 && matches!(options.pipeline.load.reference, ReferenceChoice::File(_)) {
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
    options.plots.iter().try_for_each(|path| response_plot::format(path).map(|_| ()))?;
    write::check_targets(&options.named(), photographs, options.pipeline.write.overwrite)
}

/// Beside the first photograph, named after the camera: `Canon_EOS_5D.json`; `response.json` where it does not say.
fn default_output(photographs: &[PathBuf], saved: &SavedResponse) -> PathBuf {
    let name = saved.camera();
    let letter = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '.' | '+') { c } else { '_' };
    let name = name.map_or("response".to_owned(), |name| name.chars().map(letter).collect());
    let first = photographs.first().map(PathBuf::as_path).unwrap_or(Path::new(""));
    first.with_file_name(name + ".json")
}

fn places(seen: &[Seen]) -> Vec<&Places> {
    seen.iter().map(|bracket| &bracket.places).collect()
}

/// The plots, whole but not yet named.
fn plots(saved: &SavedResponse, recovered: &ResponseReport, seen: &[Seen], paths: &[PathBuf]) -> Result<Vec<Written>> {
    let drawn = samples::draw(&places(seen), DRAWN);
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
