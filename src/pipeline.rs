//! The line: load, align, response, merge, tonemap, write, report.
//!
//! In: the paths of a bracket and [`Options`]. Out: the files asked for, and an [`Outcome`]. Cost: the sum of the stages; the
//! report has each one's time.

pub mod camera;
mod names;
mod tonemapping;

use crate::align::given::SavedAlignment;
use crate::align::{self, AlignOptions, Alignment, Rect};
use crate::bracket::colour::Space;
use crate::bracket::{self, Bracket, LoadOptions, ReferenceChoice};
use crate::error::{Error, Result, Warning};
use crate::inspect::{self, files, tables::Tables};
use crate::merge::calibration::{self, Calibration, CalibrationReport, Unit};
use crate::merge::deghost::{self, Deghost, Ghosts};
use crate::merge::flare::{self, FlareReport};
use crate::merge::statistics::Statistics;
use crate::merge::{self, MergeOptions, MergeReport, Merged, RadianceMap, gamut, weight::Weight};
use crate::report::{Report, Times, WarningReport};
use crate::response::file::{self, SavedResponse};
use crate::response::ratios::{self, Exposures};
use crate::response::samples::Places;
use crate::response::{self, ResponseCurve, ResponseModel, ResponseReport};
use crate::tonemap::{self, DisplayImage, Operator};
use crate::write::{self, Metadata, Written, aligned};
use std::path::{Path, PathBuf};
use std::time::Instant;

pub use names::{default_folder, default_outputs, default_picture};
pub use tonemapping::{TonemapOptions, tonemap_file};

/// Which part of the reference the results show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Crop {
    /// The largest rectangle found that all placed frames cover.
    #[default]
    Common,
    /// All of it; where fewer frames reach, fewer are merged.
    None,
}

impl Crop {
    fn rect(self, bracket: &Bracket, alignment: &Alignment) -> Rect {
        match self {
            Crop::Common => alignment.overlap,
            Crop::None => Rect { x0: 0, y0: 0, x1: bracket.width(), y1: bracket.height() },
        }
    }
}

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
    pub deghost: Option<Deghost>,
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
    /// How luminance is brought into the range of a display.
    pub operator: Operator,
    /// How files are encoded, and whether those that exist are replaced.
    pub write: write::Options,
    /// Radiance maps and pictures, by extension.
    pub outputs: Vec<PathBuf>,
    /// The response is saved here, by extension as JSON, `.rsp` or `.csv`.
    pub save_response: Option<PathBuf>,
    /// Aligned frames are saved under this prefix, as TIFF.
    pub save_aligned: Option<PathBuf>,
    /// Transforms: taken from this file where it exists, else written to it, as JSON. It is never replaced.
    pub transforms: Option<PathBuf>,
    /// The report is written here, as JSON.
    pub report: Option<PathBuf>,
    /// Threads that compute; none for as many as there are cores. The results are the same.
    pub threads: Option<usize>,
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

/// Aligns, calibrates, merges, tone-maps and writes the bracket `images`; gives the results back as well.
///
/// Nothing is named before all is whole: on an error no output exists that did not before. The result does not depend on the order
/// of `images` (but for exposures and a reference given by it), on the number of threads, or on the machine.
///
/// # Errors
/// See [`Error`]; the text names the file and the remedy.
pub fn run(images: &[PathBuf], options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<Outcome> {
    in_pool(options.threads, || {
        check_names(images, options)?;
        let (options, taken) = &with_transforms(options)?;
        let mut line = Line::new(watch);
        let bracket = line.load(images, options)?;
        check_taken(taken, &bracket)?;
        let alignment = line.align(&bracket, options)?;
        check_placed(&bracket, &alignment)?;
        let (bracket, curve, recovered) = line.response(bracket, &alignment, options)?;
        let region = options.crop.rect(&bracket, &alignment);
        let calibration = options.calibration.settle(bracket.reference(), &curve)?;
        let (radiance, merged, ghosts, flare) = line.merge(&bracket, &alignment, &curve, region, options)?;
        let (radiance, merged) = line.units(radiance, merged, options.colour, &calibration);
        let display = line.tonemap(&radiance, options);
        let mut report = Report::new(&bracket, &alignment, region);
        report.transforms_from = taken.as_ref().map(|(path, _)| path.to_string_lossy().into_owned());
        report.response = Some(recovered);
        report.radiance = Some(merged);
        report.calibration = calibration;
        report.colour = Some((&radiance).into());
        report.flare = flare;
        report.ghosts = ghosts.as_ref().map(Ghosts::report);
        let mut files = line.write(&bracket, &alignment, region, Some((&curve, &radiance, &display)), options)?;
        if let (Some(path), Some(ghosts)) = (&options.ghost_mask, &ghosts) {
            files.push(write::mask::write(path, &ghosts.mask())?);
        }
        line.report(&mut report, files, options)?;
        Ok(Outcome { radiance, display, report })
    })
}

/// Aligns the bracket `images`, writes aligned frames and the report where asked for, and gives the report.
///
/// # Errors
/// See [`Error`].
pub fn align_only(images: &[PathBuf], options: &Options, watch: &(dyn Fn(Progress) + Sync)) -> Result<Report> {
    in_pool(options.threads, || {
        check_names(images, options)?;
        let (options, taken) = &with_transforms(options)?;
        let mut line = Line::new(watch);
        let bracket = line.load(images, options)?;
        check_taken(taken, &bracket)?;
        let alignment = line.align(&bracket, options)?;
        let region = options.crop.rect(&bracket, &alignment);
        let mut report = Report::new(&bracket, &alignment, region);
        report.transforms_from = taken.as_ref().map(|(path, _)| path.to_string_lossy().into_owned());
        let files = line.write(&bracket, &alignment, region, None, options)?;
        line.report(&mut report, files, options)?;
        Ok(report)
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
        let bracket = line.load(images, options)?;
        let alignment = line.align(&bracket, options)?;
        let (tables, _) = line.timed(Stage::Inspect, || {
            let inspection = inspect::inspect(&bracket, &alignment, &options.align, &line.warnings);
            files::write(&inspection, folder, options.write.overwrite)
        });
        tables
    })
}

/// More threads than this only cost memory, on any machine.
const MOST_THREADS: usize = 1024;

/// Runs `work` on a pool of `threads` threads, or on the common one.
fn in_pool<R: Send>(threads: Option<usize>, work: impl FnOnce() -> Result<R> + Send) -> Result<R> {
    let Some(threads) = threads else { return work() };
    let refused = |reason: String| Error::Option { option: "--threads", reason };
    if threads == 0 {
        return Err(refused("0 threads cannot work; give 1 or more".into()));
    }
    if threads > MOST_THREADS {
        return Err(refused(format!(
            "{threads} threads are more than {MOST_THREADS}; give about as many as there are cores"
        )));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|e| refused(format!("{threads} threads could not be started: {e}")))?.install(work)
}

/// Whether everything asked for can be written, before any work is done.
fn check_names(images: &[PathBuf], options: &Options) -> Result<()> {
    options.align.validate()?;
    options.calibration.validate()?;
    for path in &options.outputs {
        write::Format::of(path)?;
    }
    for path in [&options.response_file, &options.save_response].into_iter().flatten() {
        file::Format::of(path)?;
    }
    options.deghost.map_or(Ok(()), |deghost| deghost.validate())?;
    write::mask::check(options.ghost_mask.as_deref(), options.deghost.is_some())?;
    let mut files = options.outputs.clone();
    files.extend(options.save_response.clone());
    files.extend(options.report.clone());
    files.extend(options.ghost_mask.clone());
    files.extend(options.transforms.clone().filter(|path| !path.exists()));
    if let Some(prefix) = &options.save_aligned {
        files.extend(aligned::names(prefix, images)?);
    }
    write::check_targets(&files, images, options.write.overwrite)
}

/// Transforms that were there already, and their file.
type Taken = Option<(PathBuf, SavedAlignment)>;

/// `options` with the reference and the places of the file of transforms, where there is one and the user does not say otherwise; then
/// there is none to be written.
fn with_transforms(options: &Options) -> Result<(Options, Taken)> {
    let mut options = options.clone();
    let Some(path) = options.transforms.take_if(|path| path.exists()) else {
        return Ok((options, None));
    };
    let saved = SavedAlignment::read(&path)?;
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
    if alignment.verdicts.iter().filter(|v| v.warp.is_some()).count() > 1 {
        return Ok(());
    }
    let reason = alignment.verdicts.iter().find_map(|v| v.reason.clone()).unwrap_or_default();
    Err(Error::NothingAligned { reference: bracket.reference().path().to_owned(), reason })
}

/// The stages with a clock, and what they have warned of so far.
struct Line<'a> {
    watch: &'a (dyn Fn(Progress) + Sync),
    began: Instant,
    times: Times,
    warnings: Vec<Warning>,
}

impl<'a> Line<'a> {
    fn new(watch: &'a (dyn Fn(Progress) + Sync)) -> Self {
        Line { watch, began: Instant::now(), times: Times::default(), warnings: Vec::new() }
    }

    /// `work`, announced, and its time.
    fn timed<R>(&self, stage: Stage, work: impl FnOnce() -> R) -> (R, Option<f64>) {
        (self.watch)(Progress::Begins(stage));
        let began = Instant::now();
        let result = work();
        (result, Some(began.elapsed().as_secs_f64()))
    }

    fn load(&mut self, images: &[PathBuf], options: &Options) -> Result<Bracket> {
        let watch = self.watch;
        let decoded = |done| watch(Progress::Decoded(done));
        let (loaded, time) = self.timed(Stage::Load, || bracket::load_with_progress(images, &options.load, &decoded));
        let (bracket, warnings) = loaded?;
        self.times.load = time;
        self.warnings.extend(warnings);
        Ok(bracket)
    }

    fn align(&mut self, bracket: &Bracket, options: &Options) -> Result<Alignment> {
        let (aligned, time) = self.timed(Stage::Align, || align::align(bracket, &options.align));
        let (alignment, warnings) = aligned?;
        self.times.align = time;
        self.warnings.extend(warnings);
        Ok(alignment)
    }

    /// The bracket with the exposures that are divided out, and the curve.
    fn response(
        &mut self,
        bracket: Bracket,
        alignment: &Alignment,
        options: &Options,
    ) -> Result<(Bracket, ResponseCurve, ResponseReport)> {
        let (done, time) = self.timed(Stage::Response, || -> Result<_> {
            let is_tuned = options.exposures == Exposures::FineTuned;
            let is_sought = options.response_file.is_none() && options.response.is_sought();
            let mut places = if is_tuned || is_sought { Places::of(&bracket, alignment) } else { Places::default() };
            let (bracket, mut warnings) =
                if is_tuned { ratios::fine_tuned(bracket, &mut places) } else { (bracket, Vec::new()) };
            let (curve, report) = match &options.response_file {
                Some(path) => {
                    let report = ResponseReport { model: "file", ..ResponseReport::default() };
                    (SavedResponse::read(path)?.curve, report)
                }
                None => {
                    let (curve, report, more) = response::recover_from(&[&places], &options.response)?;
                    warnings.extend(more);
                    (curve, report)
                }
            };
            Ok((bracket, curve, report, warnings))
        });
        let (bracket, curve, report, warnings) = done?;
        self.times.response = time;
        self.warnings.extend(warnings);
        Ok((bracket, curve, report))
    }

    fn merge(
        &mut self,
        bracket: &Bracket,
        alignment: &Alignment,
        curve: &ResponseCurve,
        region: Rect,
        options: &Options,
    ) -> Result<(RadianceMap, Merged, Option<Ghosts>, Option<FlareReport>)> {
        let merging = MergeOptions { weight: options.weight, region };
        let (merged, time) = self.timed(Stage::Merge, || {
            let ghosts = options.deghost.map(|d| deghost::find(bracket, alignment, curve, region, &d)).transpose()?;
            let (mut map, merged) = merge::merge(bracket, alignment, curve, &merging, ghosts.as_ref())?;
            let flare = options.flare.then(|| flare::remove(&mut map));
            Ok((map, merged, ghosts, flare))
        });
        self.times.merge = time;
        merged
    }

    /// Radiance in the colour space and the unit that are wanted, and the statistics of that.
    fn units(
        &mut self,
        map: RadianceMap,
        merged: Merged,
        colour: Option<Space>,
        calibration: &Option<CalibrationReport>,
    ) -> (RadianceMap, MergeReport) {
        let (mut map, outside) = match colour {
            Some(space) => gamut::converted(map, space),
            None => (map, 0),
        };
        if outside > 0 {
            let detail = format!(
                "{outside} pixels have colours outside of the colour space asked for; they are drawn to grey until inside, at their luminance"
            );
            self.warnings.push(Warning::OutOfGamut { detail });
        }
        let unit = calibration.map_or(Unit::Relative, |_| Unit::CdM2);
        if let Some(calibration) = calibration {
            calibration::calibrate(&mut map, calibration.cd_m2_per_unit);
        }
        let radiance = Statistics::measured(&map.pixels, gamut::weights(&map.primaries), unit);
        (map, merged.report(radiance))
    }

    fn tonemap(&mut self, radiance: &RadianceMap, options: &Options) -> DisplayImage {
        let (display, time) = self.timed(Stage::Tonemap, || tonemap::tonemap(radiance, &options.operator));
        self.times.tonemap = time;
        display
    }

    /// All files but the report, whole but not yet named.
    fn write(
        &mut self,
        bracket: &Bracket,
        alignment: &Alignment,
        region: Rect,
        merged: Option<(&ResponseCurve, &RadianceMap, &DisplayImage)>,
        options: &Options,
    ) -> Result<Vec<Written>> {
        let reference = bracket.reference();
        let cd_m2_per_unit = options.calibration.is_asked().then_some(1.0);
        let metadata = Metadata { cd_m2_per_unit, ..Metadata::of(reference) };
        let (written, time) = self.timed(Stage::Write, || -> Result<Vec<Written>> {
            let mut files = Vec::new();
            if let Some((curve, radiance, display)) = merged {
                files.extend(write::write(&options.outputs, radiance, display, &metadata, &options.write)?);
                if let Some(path) = &options.save_response {
                    let (make, model) = (reference.capture.make.clone(), reference.capture.model.clone());
                    let encoded = SavedResponse { make, model, curve: curve.clone() }.encode(path)?;
                    let mut written = write::text(path, &encoded.text)?;
                    written.warnings.extend(encoded.lossy(path));
                    files.push(written);
                }
            }
            if let Some(path) = &options.transforms {
                files.push(write::text(path, &SavedAlignment::of(bracket, alignment).to_json())?);
            }
            if let Some(prefix) = &options.save_aligned {
                files.extend(aligned::write(bracket, alignment, region, prefix, &metadata)?);
            }
            Ok(files)
        });
        self.times.write = time;
        written
    }

    /// Completes the report, adds its file to `files`, and gives all of them their names.
    fn report(mut self, report: &mut Report, files: Vec<Written>, options: &Options) -> Result<()> {
        let names: Vec<PathBuf> = files.iter().map(|w| w.file.target().to_path_buf()).collect();
        let mut pending = Vec::new();
        for written in files {
            self.warnings.extend(written.warnings);
            pending.push(written.file);
        }
        report.add_outputs(&names);
        report.warnings = self.warnings.iter().map(WarningReport::from).collect();
        self.times.total = self.began.elapsed().as_secs_f64();
        report.time_s = self.times;
        if let Some(path) = &options.report {
            pending.push(write::text(path, &report.to_json())?.file);
        }
        write::commit(pending, options.write.overwrite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_threads_are_refused() {
        let error = in_pool(Some(0), || Ok(())).unwrap_err();
        assert!(error.is_usage());
    }
}
