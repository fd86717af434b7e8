//! A camera's response from one or several brackets: load and align each bracket, correct its exposures, pool the
//! samples of all brackets, recover the curve, save and draw it.
//!
//! In: brackets, or folders of photographs, and [`Options`]. Out: response files, plots, and a [`CameraReport`]. Cost:
//! loading and aligning each bracket, one after the other. Of each bracket, only samples of flat (evenly bright)
//! places are kept. Source: the samples are pooled as in `response::recover_from`, because all brackets of a camera
//! have the same response, and together they contain more code values than one bracket.

mod bracket_samples;
mod folders;

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
use bracket_samples::BracketSamples;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The version of the report's format: keys may be added, but are never removed.
pub const SCHEMA: &str = "hdralign-response-report/1";

/// Largest number of patches (one place of the scene in one frame) that are kept of all brackets together. Each
/// bracket has an equal share. A patch takes 72 bytes.
pub const PATCHES: usize = 500_000;
/// Number of places of the scene per channel in a plot.
const DRAWN: usize = 600;

/// Options of a calibration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Options for loading, alignment, exposure correction, response and replacing files; those for outputs are
    /// ignored.
    pub pipeline: super::Options,
    /// Output files of the curve; the extension selects `.json`, `.rsp` or `.csv`. If empty, the file is beside the
    /// first photograph, named after the camera.
    pub curves: Vec<PathBuf>,
    /// Output files of the plot; the extension selects `.svg` or `.png`.
    pub plots: Vec<PathBuf>,
    /// Whether a bracket that cannot be loaded or aligned is skipped with a warning, instead of ending the run.
    pub lenient: bool,
}

/// The report of a calibration.
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
    /// How the response was determined, and how accurate it is.
    pub response: ResponseReport,
    /// The files written.
    pub outputs: Vec<String>,
    /// The warnings.
    pub warnings: Vec<WarningReport>,
    /// Wall time in seconds.
    pub time_s: f64,
}

/// A bracket.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BracketReport {
    /// The frame that the others are aligned to.
    pub reference: String,
    /// The frames by rising exposure.
    pub frames: Vec<FrameReport>,
}

impl CameraReport {
    /// Returns the report as JSON with a final line feed.
    pub fn to_json(&self) -> String {
        // The report contains only strings, numbers and lists of them, so the conversion cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Whether the result is degraded.
    pub fn is_degraded(&self) -> bool {
        self.warnings.iter().any(|w| w.degrades)
    }
}

impl Options {
    /// Returns every file that a run on `images` writes. If no file is given for the curve, a placeholder stands for
    /// the file that will be named after the camera.
    pub fn targets(&self, images: &[PathBuf]) -> Vec<Target> {
        let mut named = self.named();
        let is_beside = |image: &PathBuf| if image.is_dir() { image.join("response.json") } else { image.clone() };
        if self.curves.is_empty() {
            named.extend(Target::of("-o", images.first().map(is_beside).as_slice()));
        }
        named
    }

    /// Returns the files that the user named.
    fn named(&self) -> Vec<Target> {
        [Target::of("-o", &self.curves), Target::of("--plot", &self.plots)].concat()
    }
}

/// Recovers the response of the camera that took `images`: photographs and folders; photographs in the same folder
/// are one bracket.
///
/// # Errors
/// Those of [`prepare`]; [`Error::Option`] if a folder contains no bracket, or if an option that applies to one
/// bracket is given with several.
pub fn run(images: &[PathBuf], options: &Options, watch: Watch) -> Result<CameraReport> {
    let brackets = folders::brackets(images)?;
    check_options(&brackets, options)?;
    prepare(&brackets, options, watch)?.commit()
}

/// Recovers the response of the camera that took `brackets`, each a list of photographs. The files do not have their
/// final names yet. Only the frames of one bracket at a time, and [`PATCHES`] patches, are in memory.
///
/// # Errors
/// See [`Error`]; on an error there are no new files. [`Error::NoResponse`] if the brackets do not determine the
/// response, or if none can be used.
pub fn prepare(brackets: &[Vec<PathBuf>], options: &Options, watch: Watch) -> Result<Prepared<CameraReport>> {
    in_pool(options.pipeline.threads, || {
        options.pipeline.align.validate()?;
        let photographs = brackets.concat();
        check_names(&photographs, options)?;
        let began = Instant::now();
        let (collected, mut warnings) = bracket_samples::collect(brackets, options, watch)?;
        let (curve, recovered, more) = response::recover_from(&places(&collected), &options.pipeline.response)?;
        warnings.extend(more);
        let first = &collected[0];
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
        let miniatures: Vec<_> = collected.iter().filter_map(|bracket| bracket.miniature.as_ref()).collect();
        for path in &curves {
            files.push(curves::written(&saved, path, &miniatures)?);
        }
        if !options.plots.is_empty() {
            files.extend(plots(&saved, &recovered, &collected, &options.plots)?);
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
            brackets: collected.into_iter().map(|bracket| bracket.report).collect(),
            response: recovered,
            outputs: names.iter().map(|p| p.to_string_lossy().into_owned()).collect(),
            warnings: warnings.iter().map(WarningReport::from).collect(),
            time_s: began.elapsed().as_secs_f64(),
        };
        Ok(Prepared { report, files: pending, overwrite: options.pipeline.write.overwrite })
    })
}

/// Checks that options which apply to the frames of one bracket are not given for several brackets.
fn check_options(brackets: &[Vec<PathBuf>], options: &Options) -> Result<()> {
    let single = |option, reason: &str| Err(Error::Option { option, reason: reason.to_owned() });
    if brackets.len() > 1 && options.pipeline.load.ev.is_some() {
        return single("-e", "it applies to one bracket, but there are several; run the command on this bracket only");
    }
    if brackets.len() > 1 && matches!(options.pipeline.load.reference, ReferenceChoice::File(_)) {
        return single(
            "--reference",
            "with several brackets, a file name cannot be used, because the file is in only one of them; give a number (the position in each bracket), or omit the option",
        );
    }
    Ok(())
}

/// Checks, before any work, that all requested files can be written.
fn check_names(photographs: &[PathBuf], options: &Options) -> Result<()> {
    options.curves.iter().try_for_each(|path| Format::of(path).map(|_| ()))?;
    options.plots.iter().try_for_each(|path| response_plot::format(path).map(|_| ()))?;
    write::check_targets(&options.named(), photographs, options.pipeline.write.overwrite)
}

/// Returns a path beside the first photograph, named after the camera: `Canon_EOS_5D.json`; `response.json` if the
/// camera is not known.
fn default_output(photographs: &[PathBuf], saved: &SavedResponse) -> PathBuf {
    let name = saved.camera();
    let letter = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '.' | '+') { c } else { '_' };
    let name = name.map_or("response".to_owned(), |name| name.chars().map(letter).collect());
    let first = photographs.first().map(PathBuf::as_path).unwrap_or(Path::new(""));
    first.with_file_name(name + ".json")
}

fn places(collected: &[BracketSamples]) -> Vec<&Places> {
    collected.iter().map(|bracket| &bracket.places).collect()
}

/// Returns the plots, complete but not yet named.
fn plots(
    saved: &SavedResponse,
    recovered: &ResponseReport,
    collected: &[BracketSamples],
    paths: &[PathBuf],
) -> Result<Vec<Written>> {
    let drawn = samples::draw(&places(collected), DRAWN);
    let title = saved.camera().unwrap_or_else(|| "Camera response".to_owned());
    let frames: usize = collected.iter().map(|bracket| bracket.report.frames.len()).sum();
    let mut notes =
        format!("{}, from {frames} photographs in {}.", recovered.model, counted(collected.len(), "bracket"));
    if let Some(fits) = &recovered.channels {
        let residuals = fits.map(|fit| format!("{:.3}", fit.residual_stops));
        notes += &format!(
            " Dots: sampled places of the scene; each place has one dot for each frame in which it is neither clipped nor \
             black. Distance of the samples from the curves of red, green and blue (root mean square): {} stops.",
            residuals.join(", ")
        );
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
