//! The pipeline: load, align, response, merge, tonemap, write, report.
//!
//! In: the paths of a bracket and [`Options`]. Out: the requested files, and a [`Report`] or an [`Outcome`]. Cost: the
//! sum of the stages; the report has the time of each. [`run`] is for photographs in files, [`merge_bracket`] for a
//! bracket in memory.

#[doc(hidden)]
pub mod camera;
mod crop;
mod files;
mod memory;
mod report;
mod stages;
mod threads;
mod tonemapping;

use crate::align::{AlignMode, AlignOptions, Placement, RejectedBy};
use crate::bracket::colour::Space;
use crate::bracket::{Bracket, LoadOptions};
use crate::budget::Stages;
use crate::error::{Error, Result};
use crate::inspect::{self, tables::Tables};
use crate::merge::RadianceMap;
use crate::merge::deghost::Deghost;
use crate::merge::radiance::calibration::Calibration;
use crate::merge::radiance::normalisation;
use crate::merge::weight::Weight;
use crate::plane::Plane;
use crate::report::Report;
use crate::response::ResponseModel;
use crate::response::file::SavedResponse;
use crate::response::ratios::Exposures;
use crate::tonemap::{DisplayImage, Rendering};
use crate::write::{self, CompleteFile, Output, Pending};
use stages::Run;
use stages::radiance::RadianceRows;
use stages::reference::Aligned;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use threads::in_pool;

pub use crop::Crop;
pub use files::names::{default_folder, default_outputs, default_picture, natural};
pub use files::targets;
pub use memory::merge_bracket;
pub use threads::start_threads;
pub use tonemapping::{TonemapOptions, tonemap_file};

/// Processing options of a bracket, and the output files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Options for reading files, and exposures and reference frame given by the user.
    pub load: LoadOptions,
    /// Alignment.
    pub align: AlignOptions,
    /// Exposure correction.
    pub exposures: Exposures,
    /// Method used to recover the camera response.
    pub response: ResponseModel,
    /// File of a saved response; overrides [`response`](Self::response).
    pub response_file: Option<PathBuf>,
    /// Weighting function; `None` for that which suits the frames: [`Weight::Noise`] for camera raw, else
    /// [`Weight::Hat`].
    pub weight: Option<Weight>,
    /// Deghosting, and its strength.
    pub deghost: Deghost,
    /// Output file of the motion mask, a grey PNG; requires [`deghost`](Self::deghost).
    pub ghost_mask: Option<PathBuf>,
    /// Whether lens flare is subtracted.
    pub flare: bool,
    /// Part of the reference that the results show.
    pub crop: Crop,
    /// Linear colour space of the results; `None` for the colour space of the reference's colour profile.
    pub colour: Option<Space>,
    /// Calibration of radiance to cd/m2.
    pub calibration: Calibration,
    /// Relative exposure t * ISO / N^2, in s, that gives radiance 1 the middle code value. With the same number for
    /// all brackets, their radiances can be compared (normalisation). `None` for the relative exposure of the
    /// reference. Cannot be combined with [`calibration`](Self::calibration).
    pub unit_exposure: Option<f64>,
    /// Tone mapping operator, or exposure fusion.
    pub rendering: Rendering,
    /// Encoding of the files, and whether existing files are replaced.
    pub write: write::Options,
    /// Output files of radiance maps and pictures; the extension selects the format.
    pub outputs: Vec<PathBuf>,
    /// Output files that are always pictures, even with the extension `.tif`.
    pub pictures: Vec<PathBuf>,
    /// Output file of the response; the extension selects JSON, `.rsp` or `.csv`.
    pub save_response: Option<PathBuf>,
    /// Prefix of the output files of the aligned frames, in TIFF format.
    pub save_aligned: Option<PathBuf>,
    /// Prefix of the output files of the displacements of all pixels, in TIFF format.
    pub displacements: Option<PathBuf>,
    /// JSON file of transforms: read if it exists, otherwise written. It is never replaced.
    pub transforms: Option<PathBuf>,
    /// Output file of the report; the extension selects JSON or HTML.
    pub report: Option<PathBuf>,
    /// Largest number of threads; `None` for those of rayon's current thread pool (by default one per core). The
    /// results do not depend on it.
    pub threads: Option<usize>,
}

impl Options {
    /// Returns the weighting function for the frames of `bracket`. The noise of camera raw is known well enough for
    /// inverse variances; photographs have been processed, so their middle values are trusted most.
    pub(crate) fn weight_for(&self, bracket: &Bracket) -> Weight {
        self.weight.unwrap_or(if bracket.reference().is_raw() { Weight::Noise } else { Weight::Hat })
    }

    /// Returns the stages that determine the memory of a run that aligns.
    pub(crate) fn aligning(&self) -> Stages {
        let features = matches!(self.align.mode, AlignMode::Auto | AlignMode::Sift | AlignMode::Surf);
        Stages { features, following: self.align.follows(), ..Stages::default() }
    }

    /// Returns the stages that determine the memory of a run that merges.
    pub(crate) fn merging(&self) -> Stages {
        let fusing = matches!(self.rendering, Rendering::Fused(_));
        Stages { merging: true, deghosting: self.deghost.is_on(), fusing, ..self.aligning() }
    }

    /// Returns the output files of radiance maps and pictures.
    fn results(&self) -> Result<Vec<Output>> {
        Ok([Output::results(&self.outputs)?, Output::pictures(&self.pictures)?].concat())
    }
}

/// The result of a run in memory.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Linear radiance.
    pub radiance: RadianceMap,
    /// The picture.
    pub display: DisplayImage,
    /// What was done, as a report.
    pub report: Report,
}

/// A stage of a run, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Reading and decoding.
    Load,
    /// Alignment.
    Align,
    /// The response.
    Response,
    /// Merging.
    Merge,
    /// Tone mapping.
    Tonemap,
    /// Collecting and drawing the data that show how the frames were aligned, for an HTML report or for `inspect`.
    Inspect,
    /// Writing.
    Write,
}

/// Progress of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// A stage begins.
    Begins(Stage),
    /// This number of frames has been decoded.
    Decoded(usize),
}

/// Callback that receives the progress, from any thread. If it returns `Break` for [`Progress::Begins`], the run is
/// cancelled before that stage with [`Error::Cancelled`] and writes no file. The return value for
/// [`Progress::Decoded`] is ignored.
pub type Watch<'a> = &'a (dyn Fn(Progress) -> ControlFlow<()> + Sync);

/// A [`Watch`] that ignores the progress and never cancels.
pub fn unwatched(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Reports the start of `stage` to `watch`.
///
/// # Errors
/// [`Error::Cancelled`].
fn announce(watch: Watch, stage: Stage) -> Result<()> {
    if watch(Progress::Begins(stage)).is_break() { Err(Error::Cancelled) } else { Ok(()) }
}

/// Aligns, calibrates, merges, tone-maps and writes the bracket `images`, and returns the report.
///
/// Files are written under temporary names, and get their final names only when all are complete. So after an error
/// there are no new output files. The result does not depend on the order of `images` (unless exposures or the
/// reference are given by position), on the number of threads, on the memory limit, or on the machine.
///
/// # Errors
/// See [`Error`]; the text names the file and the remedy.
pub fn run(images: &[PathBuf], options: &Options, watch: Watch) -> Result<Report> {
    prepare(images, options, watch)?.commit()
}

/// The report of a run, and its complete temporary files, not yet renamed.
#[doc(hidden)]
#[derive(Debug)]
pub struct Prepared<R> {
    /// The report; the outputs that it lists do not exist yet.
    pub report: R,
    files: Vec<Pending>,
    overwrite: bool,
}

impl<R> Prepared<R> {
    /// Waits until all files are on the disk, and returns them with the report.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn complete(self) -> Result<(R, Vec<CompleteFile>)> {
        let files = self.files.into_iter().map(Pending::complete).collect::<Result<_>>()?;
        Ok((self.report, files))
    }

    /// Renames all files to their final names.
    ///
    /// # Errors
    /// [`Error::OutputExists`] if a target was created meanwhile and may not be replaced; [`Error::Write`].
    pub fn commit(self) -> Result<R> {
        write::commit(self.files, self.overwrite)?;
        Ok(self.report)
    }
}

/// Like [`run`], but does not rename the files or wait until they are on the disk.
///
/// # Errors
/// Those of [`run`].
pub fn prepare(images: &[PathBuf], options: &Options, watch: Watch) -> Result<Prepared<Report>> {
    Ok(merge_files(images, options, watch, false)?.0)
}

/// Like [`run`], and also returns the results in memory, regardless of the memory limit.
///
/// # Errors
/// Those of [`run`].
pub fn develop(images: &[PathBuf], options: &Options, watch: Watch) -> Result<Outcome> {
    let (prepared, results) = merge_files(images, options, watch, true)?;
    results.outcome(prepared)
}

/// The radiance and the picture of a run, after all files are written. The radiance may be in memory or on disk.
struct InMemory {
    radiance: RadianceRows,
    /// The picture; empty unless it was requested.
    display: Plane<[u8; 3]>,
}

impl InMemory {
    /// Renames the files, then returns the results with the report.
    fn outcome(self, prepared: Prepared<Report>) -> Result<Outcome> {
        let (radiance, display) = (self.radiance.whole()?, DisplayImage { pixels: self.display });
        Ok(Outcome { radiance, display, report: prepared.commit()? })
    }
}

/// Like [`prepare`], and also returns the results. The picture is empty unless `is_kept`.
fn merge_files(
    images: &[PathBuf],
    options: &Options,
    watch: Watch,
    is_kept: bool,
) -> Result<(Prepared<Report>, InMemory)> {
    on_files(images, options, watch, Options::merging, |run, bracket, saved| merge_loaded(run, bracket, saved, is_kept))
}

/// Checks the options and the names of all files, loads the bracket `images` for these `stages`, and calls `work` with
/// the bracket and the saved response, on as many threads as memory allows.
fn on_files<R: Send>(
    images: &[PathBuf],
    options: &Options,
    watch: Watch,
    stages: fn(&Options) -> Stages,
    work: impl FnOnce(Run, Bracket, Option<SavedResponse>) -> Result<R> + Send,
) -> Result<R> {
    in_pool(options.threads, || {
        files::check(images, options)?;
        let (options, transforms) = &files::with_transforms(images, options)?;
        let saved = options.response_file.as_deref().map(SavedResponse::read).transpose()?;
        let mut run = Run::new(options, watch).with_page();
        let bracket = run.load(images, &stages(options))?;
        if let Some((path, transforms)) = transforms {
            transforms.check(&bracket, path)?;
            run.transforms_from = Some(path);
        }
        in_pool(bracket.threads(), move || work(run, bracket, saved))
    })
}

/// Runs all stages after loading.
fn merge_loaded(
    mut run: Run,
    bracket: Bracket,
    saved: Option<SavedResponse>,
    is_kept: bool,
) -> Result<(Prepared<Report>, InMemory)> {
    let options = run.options;
    options.crop.check(&bracket)?;
    options.calibration.check(bracket.reference())?;
    options.unit_exposure.map_or(Ok(()), |_| normalisation::check(bracket.reference()))?;
    let aligned = run.align(bracket)?;
    check_placed(&aligned)?;
    let (aligned, camera) = run.response(aligned, saved)?;
    let response_file = run.write_response(&aligned, &camera)?;
    options.write.picture.adjust.check((aligned.region.width(), aligned.region.height()))?;
    let calibration = options.calibration.settle(aligned.bracket.reference(), &camera.curve)?;
    let radiance = run.merge(&aligned, &camera, calibration)?;
    let picture = run.tonemap(&aligned, &camera, &radiance)?;
    run.gather(&aligned, Some((&camera, &radiance)))?;
    let frames = run.write_frames(&aligned)?;
    let metadata = stages::metadata(aligned.bracket.reference(), radiance.photographed, options);
    let report = report::of_merge(&aligned, camera, &radiance, &picture, options);
    // Frees the frames, because the encoders need the memory.
    drop(aligned);
    let (mut files, display) = run.write_results(&radiance, &picture, metadata, is_kept)?;
    files.extend(response_file.into_iter().chain(frames));
    if let (Some(path), Some(ghosts)) = (&options.ghost_mask, &radiance.ghosts) {
        files.push(write::png::mask::write(path, &ghosts.mask())?);
    }
    Ok((run.report(report, files)?, InMemory { radiance: radiance.rows, display }))
}

/// Aligns the bracket `images`, writes the requested aligned frames and report, and returns the report.
///
/// # Errors
/// See [`Error`].
pub fn align_only(images: &[PathBuf], options: &Options, watch: Watch) -> Result<Report> {
    on_files(images, options, watch, Options::aligning, |mut run, bracket, _| {
        run.options.crop.check(&bracket)?;
        let aligned = run.align(bracket)?;
        run.gather(&aligned, None)?;
        let report = report::of_alignment(&aligned, run.options);
        let files = run.write_frames(&aligned)?;
        run.report(report, files)?.commit()
    })
}

/// Aligns the bracket `images`, and writes tables, bitmaps and drawings that show the alignment. They are written into
/// `folder`.
///
/// Uses only the options for loading, alignment, threads and overwriting. Returns the tables, which list the files.
///
/// # Errors
/// See [`Error`]; on an error there are no new files.
pub fn inspect(images: &[PathBuf], options: &Options, folder: &Path, watch: Watch) -> Result<Tables> {
    in_pool(options.threads, || {
        options.align.validate()?;
        inspect::files::check(folder, images, options.write.overwrite)?;
        let mut run = Run::new(options, watch);
        let bracket = run.load(images, &Stages { inspecting: true, ..options.aligning() })?;
        in_pool(bracket.threads(), move || {
            let Aligned { bracket, alignment, .. } = run.align(bracket)?;
            run.begin(Stage::Inspect)?;
            let inspection = inspect::inspect(&bracket, &alignment, &options.align, &run.warnings)?;
            inspect::files::write(&inspection, folder, options.write.overwrite)
        })
    })
}

/// Checks the ranges of the options that do not name files.
fn validate(options: &Options) -> Result<()> {
    options.align.validate()?;
    options.rendering.validate()?;
    options.write.picture.adjust.validate()?;
    options.calibration.validate()?;
    options.unit_exposure.map_or(Ok(()), |exposure| normalisation::validate(exposure, &options.calibration))?;
    options.deghost.validate()
}

/// Checks that at least one frame besides the reference can be merged.
fn check_placed(Aligned { bracket, alignment, .. }: &Aligned) -> Result<()> {
    if alignment.placed(bracket).count() > 1 {
        return Ok(());
    }
    let is_unaligned = |p: &&Placement| matches!(p, Placement::Rejected { by: RejectedBy::Alignment, .. });
    let reason = match alignment.placements.iter().find(is_unaligned) {
        Some(placement) => format!(
            "no other frame was aligned to it ({}); choose another reference with --reference, or give --align none if \
             the camera was on a tripod",
            placement.reason().unwrap_or_default()
        ),
        None => "all other frames are excluded; exclude fewer of them".to_owned(),
    };
    Err(Error::NothingAligned { reference: bracket.reference().path().to_owned(), reason })
}
