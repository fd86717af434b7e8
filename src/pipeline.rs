//! The line: load, align, response, merge, tonemap, write, report.
//!
//! In: the paths of a bracket and [`Options`]. Out: the files asked for, and an [`Outcome`]. Cost: the sum of the stages; the
//! report has each one's time.

mod asked;
pub mod camera;
mod crop;
mod curves;
mod doubts;
mod fusion;
mod line;
mod memory;
mod names;
mod picture;
mod referred;
mod results;
mod slabs;
mod threads;
mod tonemapping;

use crate::align::transforms_file::SavedAlignment;
use crate::align::{AlignMode, AlignOptions, Alignment, Placement};
use crate::bracket::colour::Space;
use crate::bracket::{Bracket, LoadOptions, ReferenceChoice};
use crate::budget::Stages;
use crate::error::{Error, Result};
use crate::inspect::{self, files, tables::Tables};
use crate::merge::calibration::Calibration;
use crate::merge::deghost::{Deghost, Ghosts};
use crate::merge::{MergeOptions, RadianceMap, normalisation, weight::Weight};
use crate::page::Developed;
use crate::plane::Plane;
use crate::report::{self, Report};
use crate::response::ResponseModel;
use crate::response::file::{self, SavedResponse};
use crate::response::ratios::Exposures;
use crate::tonemap::{DisplayImage, Rendering};
use crate::write::{self, CompleteFile, Output, Pending, Target, aligned};
use fusion::Aligned;
use line::{Line, Radiance};
use slabs::Slabs;
use std::path::{Path, PathBuf};
use threads::in_pool;

pub use crop::Crop;
pub use memory::merge_bracket;
pub use names::{default_folder, default_outputs, default_picture, natural};
pub use threads::start_threads;
pub use tonemapping::{TonemapOptions, tonemap_file};

/// What is done to a bracket, and where the results go.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// What the user says of the files.
    pub load: LoadOptions,
    /// How frames are aligned.
    pub align: AlignOptions,
    /// What becomes of the exposures before they are divided out.
    pub exposures: Exposures,
    /// How the response is had.
    pub response: ResponseModel,
    /// A response saved before; it takes the place of [`response`](Self::response).
    pub response_file: Option<PathBuf>,
    /// How far a code is trusted.
    pub weight: Weight,
    /// Whether and how readily what moved is left out.
    pub deghost: Deghost,
    /// Where and how much was left out is written here, as a grey PNG; it needs [`deghost`](Self::deghost).
    pub ghost_mask: Option<PathBuf>,
    /// Whether the veil of scattered light is sought and taken off.
    pub flare: bool,
    /// Which part of the reference the results show.
    pub crop: Crop,
    /// The linear colour space of the results; none for that of the reference's profile.
    pub colour: Option<Space>,
    /// What takes radiance to cd/m2.
    pub calibration: Calibration,
    /// The relative exposure t * ISO / N^2, in s, at which radiance 1 gives the middle code, so that brackets can be laid beside each
    /// other ([normalisation]); none for that of the bracket's own reference. Not with [`calibration`](Self::calibration).
    pub unit_exposure: Option<f64>,
    /// How the picture comes about.
    pub rendering: Rendering,
    /// How files are encoded, and whether those that exist are replaced.
    pub write: write::Options,
    /// Radiance maps and pictures, by extension.
    pub outputs: Vec<PathBuf>,
    /// Pictures, whatever the extension: a `.tif` too.
    pub pictures: Vec<PathBuf>,
    /// The response is saved here, by extension as JSON, `.rsp` or `.csv`.
    pub save_response: Option<PathBuf>,
    /// Aligned frames are saved under this prefix, as TIFF.
    pub save_aligned: Option<PathBuf>,
    /// Transforms: taken from this file where it exists, else written to it, as JSON. It is never replaced.
    pub transforms: Option<PathBuf>,
    /// The report is written here, by extension as JSON or as a page to look at (`.html`).
    pub report: Option<PathBuf>,
    /// Threads that compute; none for as many as there are cores. The results are the same.
    pub threads: Option<usize>,
}

impl Options {
    /// What takes memory where a bracket is aligned.
    pub(crate) fn aligning(&self) -> Stages {
        let features = matches!(self.align.mode, AlignMode::Auto | AlignMode::Sift);
        Stages { features, ..Stages::default() }
    }

    /// What takes memory where it is merged.
    pub(crate) fn merging(&self) -> Stages {
        let fusing = matches!(self.rendering, Rendering::Fused(_));
        Stages { merging: true, deghosting: self.deghost.is_on(), fusing, ..self.aligning() }
    }

    /// The radiance maps and pictures.
    fn results(&self) -> Result<Vec<Output>> {
        Ok([Output::results(&self.outputs)?, Output::pictures(&self.pictures)?].concat())
    }

    /// Whether the file of transforms is there, and so is read and not written.
    fn takes_transforms(&self) -> bool {
        self.transforms.as_ref().is_some_and(|path| path.exists())
    }
}

/// What a run makes, beside its files.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Linear radiance.
    pub radiance: RadianceMap,
    /// The picture.
    pub display: DisplayImage,
    /// What was done.
    pub report: Report,
}

/// A step of the line.
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
    /// Writing.
    Write,
    /// Gathering what the alignment rests on, and drawing it.
    Inspect,
}

/// What is going on, for whoever watches; called from any thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// A stage begins.
    Begins(Stage),
    /// So many of the frames are decoded.
    Decoded(usize),
}

/// Aligns, calibrates, merges, tone-maps and writes the bracket `images`; gives the report.
///
/// Nothing is named before all is whole: on an error no output exists that did not before. The result does not depend on the order
/// of `images` (but for exposures and a reference given by it), on the number of threads, on the memory allowed, or on the machine.
///
/// # Errors
/// See [`Error`]; the text names the file and the remedy.
pub fn run(images: &[PathBuf], options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<Report> {
    prepare(images, options, watch)?.commit()
}

/// What a run made, whole but for its names; and its report.
#[derive(Debug)]
pub struct Prepared<R> {
    /// What was done; the outputs in it are not there yet.
    pub report: R,
    files: Vec<Pending>,
    overwrite: bool,
}

impl<R> Prepared<R> {
    /// Waits until all is on the disk, and gives the files with the report.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn complete(self) -> Result<(R, Vec<CompleteFile>)> {
        let files = self.files.into_iter().map(Pending::complete).collect::<Result<_>>()?;
        Ok((self.report, files))
    }

    /// Gives all files their names.
    ///
    /// # Errors
    /// [`Error::OutputExists`] where a target has appeared meanwhile and may not be replaced; [`Error::Write`].
    pub fn commit(self) -> Result<R> {
        write::commit(self.files, self.overwrite)?;
        Ok(self.report)
    }
}

/// As [`run`], but nothing is named: the bytes of all files are on their way to the disk, and whoever waits for them takes no core.
///
/// # Errors
/// Those of [`run`].
pub fn prepare(images: &[PathBuf], options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<Prepared<Report>> {
    Ok(merged(images, options, watch, false)?.0)
}

/// As [`run`], and gives the results in memory too, whatever memory is allowed.
///
/// # Errors
/// Those of [`run`].
pub fn develop(images: &[PathBuf], options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<Outcome> {
    let (prepared, results) = merged(images, options, watch, true)?;
    let Results { radiance, display } = results;
    let radiance = radiance.whole()?;
    Ok(Outcome { radiance, display: DisplayImage { pixels: display }, report: prepared.commit()? })
}

/// What is left when all is written.
struct Results {
    radiance: Slabs,
    /// Empty unless it was to be kept.
    display: Plane<[u8; 3]>,
}

/// The line; the picture is kept where it is wanted.
fn merged(
    images: &[PathBuf],
    options: &Options,
    watch: &(dyn Fn(Progress) + Sync),
    keep: bool,
) -> Result<(Prepared<Report>, Results)> {
    in_pool(options.threads, || {
        check_names(images, options)?;
        let (options, taken) = &with_transforms(images, options)?;
        let saved = options.response_file.as_deref().map(SavedResponse::read).transpose()?;
        let mut line = Line::new(watch).with_page(options);
        let bracket = line.load(images, &options.merging(), options)?;
        in_pool(bracket.threads(), move || {
            check_taken(taken, &bracket)?;
            developed(line, bracket, saved, taken, options, keep)
        })
    })
}

/// The line from the loaded bracket on; the picture is kept where it is wanted.
fn developed(
    mut line: Line,
    bracket: Bracket,
    saved: Option<SavedResponse>,
    taken: &Taken,
    options: &Options,
    keep: bool,
) -> Result<(Prepared<Report>, Results)> {
    options.crop.check(&bracket)?;
    options.calibration.check(bracket.reference())?;
    options.unit_exposure.map_or(Ok(()), |_| normalisation::check(bracket.reference()))?;
    let (bracket, alignment) = line.align(bracket, options)?;
    check_placed(&bracket, &alignment)?;
    let (bracket, camera) = line.response(bracket, &alignment, saved, options)?;
    let curve_file = line.curve_file(&bracket, &alignment, &camera.curve, options)?;
    let region = options.crop.rect(&bracket, &alignment);
    options.write.picture.adjust.check((region.width(), region.height()))?;
    let calibration = options.calibration.settle(bracket.reference(), &camera.curve)?;
    let radiance = line.merge(&bracket, &alignment, &camera, region, options)?;
    let (radiance, statistics) = line.units(radiance, &calibration, options)?;
    let (ghosts, local) = (radiance.ghosts.as_ref(), radiance.local.as_ref());
    let aligned = Aligned { bracket: &bracket, alignment: &alignment, region, curve: &camera.curve, ghosts };
    let photographed = radiance.photographed;
    let picture = line.tonemap(&radiance.slabs, photographed, &aligned, options)?;
    let mut files = line.others(&bracket, &alignment, region, options)?;
    let metadata = line::metadata(bracket.reference(), photographed, options);
    let merging = MergeOptions { weight: options.weight, region };
    let developed = Developed { curve: &camera.curve, merging, ghosts, local };
    line.gather(&bracket, &alignment, region, Some(&developed), options)?;
    let mut report = Report::new(&bracket, &alignment, region);
    // The frames make room for what is encoded.
    drop(bracket);
    let Radiance { slabs, merged, limits, ghosts, flare, local, .. } = radiance;
    report.options = Some(asked::report(options, true));
    report.transforms_from = taken.as_ref().map(|(path, _)| path.to_string_lossy().into_owned());
    report.local_processing = camera.local_report(local.as_ref());
    report.response = Some(camera.report);
    report.radiance = Some(merged.report(statistics, limits, options.unit_exposure));
    report.calibration = calibration;
    report.colour = Some(slabs.primaries().into());
    report.flare = flare;
    report.white_balance = picture.light;
    report.ghosts = ghosts.as_ref().map(Ghosts::report);
    let (results, display) = line.results(&slabs, &statistics, &picture, metadata, keep, options)?;
    files.splice(0..0, results.into_iter().chain(curve_file));
    if let (Some(path), Some(ghosts)) = (&options.ghost_mask, &ghosts) {
        files.push(write::png::mask::write(path, &ghosts.mask())?);
    }
    let files = line.report(&mut report, files, options)?;
    let prepared = Prepared { report, files, overwrite: options.write.overwrite };
    Ok((prepared, Results { radiance: slabs, display }))
}

/// Aligns the bracket `images`, writes aligned frames and the report where asked for, and gives the report.
///
/// # Errors
/// See [`Error`].
pub fn align_only(images: &[PathBuf], options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<Report> {
    in_pool(options.threads, || {
        check_names(images, options)?;
        let (options, taken) = &with_transforms(images, options)?;
        let mut line = Line::new(watch).with_page(options);
        let bracket = line.load(images, &options.aligning(), options)?;
        options.crop.check(&bracket)?;
        in_pool(bracket.threads(), move || {
            check_taken(taken, &bracket)?;
            let (bracket, alignment) = line.align(bracket, options)?;
            let region = options.crop.rect(&bracket, &alignment);
            line.gather(&bracket, &alignment, region, None, options)?;
            let mut report = Report::new(&bracket, &alignment, region);
            report.options = Some(asked::report(options, false));
            report.transforms_from = taken.as_ref().map(|(path, _)| path.to_string_lossy().into_owned());
            let files = line.others(&bracket, &alignment, region, options)?;
            let files = line.report(&mut report, files, options)?;
            write::commit(files, options.write.overwrite)?;
            Ok(report)
        })
    })
}

/// Aligns the bracket `images` and writes what that rests on into `folder`: tables, bitmaps and drawings. Of `options` those for loading,
/// alignment, threads and overwriting count. Gives the tables, which name the files.
///
/// # Errors
/// See [`Error`]; on any of them nothing is there that was not before.
pub fn inspect(
    images: &[PathBuf],
    options: &Options,
    folder: &Path,
    watch: &(dyn Fn(Progress) + Sync),
) -> Result<Tables> {
    in_pool(options.threads, || {
        options.align.validate()?;
        files::check(folder, images, options.write.overwrite)?;
        let mut line = Line::new(watch);
        let bracket = line.load(images, &Stages { inspecting: true, ..options.aligning() }, options)?;
        in_pool(bracket.threads(), move || {
            let (bracket, alignment) = line.align(bracket, options)?;
            let (tables, _) = line.timed(Stage::Inspect, || {
                let inspection = inspect::inspect(&bracket, &alignment, &options.align, &line.warnings)?;
                files::write(&inspection, folder, options.write.overwrite)
            })?;
            Ok(tables)
        })
    })
}

/// Every file that a run on `images` writes.
///
/// # Errors
/// [`Error::Option`] where two aligned frames would have one name.
pub fn targets(images: &[PathBuf], options: &Options) -> Result<Vec<Target>> {
    let mut files = Target::of("-o", &options.outputs);
    files.extend(Target::of("--picture", &options.pictures));
    files.extend(Target::of("--save-response", options.save_response.as_slice()));
    files.extend(Target::of("--report", options.report.as_slice()));
    files.extend(Target::of("--ghost-mask", options.ghost_mask.as_slice()));
    if !options.takes_transforms() {
        files.extend(Target::of("--transforms", options.transforms.as_slice()));
    }
    if let Some(prefix) = &options.save_aligned {
        files.extend(Target::of("--save-aligned", &aligned::names(prefix, images)?));
    }
    Ok(files)
}

/// Every file that a run on `images` reads.
fn sources(images: &[PathBuf], options: &Options) -> Vec<PathBuf> {
    let transforms = options.transforms.iter().filter(|_| options.takes_transforms());
    images.iter().chain(&options.response_file).chain(transforms).cloned().collect()
}

/// Whether the options that concern no file are within their ranges.
fn validate(options: &Options) -> Result<()> {
    options.align.validate()?;
    options.rendering.validate()?;
    options.calibration.validate()?;
    options.unit_exposure.map_or(Ok(()), |exposure| normalisation::validate(exposure, &options.calibration))?;
    options.deghost.validate()
}

/// Whether everything asked for can be written, before any work is done.
fn check_names(images: &[PathBuf], options: &Options) -> Result<()> {
    validate(options)?;
    options.write.check(&options.results()?)?;
    for path in [&options.response_file, &options.save_response].into_iter().flatten() {
        file::Format::of(path)?;
    }
    if let Some(path) = &options.report {
        report::Format::of(path)?;
    }
    write::png::mask::check(options.ghost_mask.as_deref(), options.deghost.is_on())?;
    write::check_targets(&targets(images, options)?, &sources(images, options), options.write.overwrite)
}

/// Transforms that were there already, and their file.
type Taken = Option<(PathBuf, SavedAlignment)>;

/// `options` with the reference and the places of the file of transforms, where there is one and the user does not say otherwise; then
/// there is none to be written.
fn with_transforms(images: &[PathBuf], options: &Options) -> Result<(Options, Taken)> {
    let mut options = options.clone();
    let Some(path) = options.transforms.take_if(|path| path.exists()) else {
        return Ok((options, None));
    };
    let saved = SavedAlignment::read(&path)?;
    saved.check_names(images, &path)?;
    let is_open = match &options.load.reference {
        ReferenceChoice::Auto => true,
        ReferenceChoice::AutoExcept(left_out) => !left_out.contains(&saved.reference),
        ReferenceChoice::Number(_) | ReferenceChoice::File(_) => false,
    };
    if is_open {
        options.load.reference = ReferenceChoice::File(saved.reference.clone());
    }
    options.align.given.extend(saved.frames.iter().cloned());
    Ok((options, Some((path, saved))))
}

/// Whether the transforms that were taken are of `bracket`.
fn check_taken(taken: &Taken, bracket: &Bracket) -> Result<()> {
    taken.as_ref().map_or(Ok(()), |(path, saved)| saved.check(bracket, path))
}

/// Whether there is more to merge than the reference.
fn check_placed(bracket: &Bracket, alignment: &Alignment) -> Result<()> {
    if alignment.placed(bracket).count() > 1 {
        return Ok(());
    }
    let reason = alignment.placements.iter().find_map(Placement::reason).unwrap_or_default().to_owned();
    Err(Error::NothingAligned { reference: bracket.reference().path().to_owned(), reason })
}
