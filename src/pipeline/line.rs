//! The stages of the line, with a clock, and what they have warned of so far.
//!
//! In: what the stage before gave. Out: what the next takes. Cost: that of the stages.

use super::curves;
use super::doubts::{contradicted_response, differing_response, processing};
use super::fusion::Aligned;
use super::picture::Picture;
use super::referred;
use super::results::Results;
use super::slabs::{Room, Slabs};
use super::{Options, Progress, Stage};
use crate::align::transforms_file::SavedAlignment;
use crate::align::{Alignment, Rect};
use crate::bracket::{self, Bracket, Capture, Frame};
use crate::budget::Stages;
use crate::error::{Error, Result, Warning};
use crate::merge::calibration::{self, CalibrationReport, Factor, Unit};
use crate::merge::deghost::{self, Ghosts};
use crate::merge::flare::{self, FlareReport, Veil};
use crate::merge::local::{self, LocalGain, LocalReport};
use crate::merge::range::Limits;
use crate::merge::statistics::{Statistics, Tally};
use crate::merge::{MergeOptions, Merged, Merging, Photographed, gamut, normalisation};
use crate::page::{Developed, Page};
use crate::plane::{BAND_ROWS, Plane};
use crate::report::{self, Report, Times, WarningReport};
use crate::response::file::SavedResponse;
use crate::response::local::Evidence;
use crate::response::ratios::{self, Exposures};
use crate::response::samples::Places;
use crate::response::{self, ResponseCurve, ResponseReport};
use crate::tonemap::Rendering;
use crate::write::{self, Metadata, Pending, Written, aligned};
use std::ops::{ControlFlow, Range};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The radiance, and what was found on the way to it.
pub(super) struct Radiance {
    pub slabs: Slabs,
    /// What the photographs showed of it.
    pub photographed: Option<Photographed>,
    pub merged: Merged,
    /// Between which radiances the frames tell light; none where they are locally processed.
    pub limits: Option<Limits>,
    pub ghosts: Option<Ghosts>,
    pub flare: Option<FlareReport>,
    /// By what the frames were multiplied, where they are locally processed.
    pub local: Option<LocalGain>,
}

/// What codes mean, and what was found on the way to it.
pub(super) struct Camera {
    pub curve: ResponseCurve,
    pub report: ResponseReport,
    /// Whether frames are locally processed; none where that was not looked at.
    pub evidence: Option<Evidence>,
}

impl Camera {
    /// What is known of local processing, where frames are locally processed.
    fn local(&self) -> Option<&Evidence> {
        self.evidence.as_ref().filter(|evidence| evidence.is_local)
    }

    /// What the report says of local processing, with the `gain` that was merged with.
    pub fn local_report(&self, gain: Option<&LocalGain>) -> Option<LocalReport> {
        self.evidence.as_ref().map(|evidence| LocalReport::of(evidence, gain))
    }
}

/// How much of the radiance is in memory at a time.
fn room(bracket: &Bracket, merging: &Merging, options: &Options) -> Room {
    let (Some(scratch), Some(budget)) = (bracket.scratch(), bracket.budget()) else { return Room::Enough };
    let (width, height) = merging.size();
    // Of every row what the frames have of it, moved ones a little more; the radiance, and what is made of it.
    let row = bracket.frames().len() as u64 * bracket.reference().row_bytes() * 5 / 4 + 24 * width as u64;
    let rows = (budget.slab(rayon::current_num_threads()) / row) as usize;
    // Whole bands, and whole cells of the veil.
    let unit = if options.flare { flare::Cells::new(width, height).side() } else { BAND_ROWS };
    Room::Rows((rows / unit * unit).max(unit), scratch.clone())
}

/// What headers say of a result.
pub(super) fn metadata(reference: &Frame, photographed: Option<Photographed>, options: &Options) -> Metadata {
    let cd_m2_per_unit = options.calibration.is_asked().then_some(Factor::ONE);
    let unit = |exposure| format!("radiance 1 is the middle code at t ISO / N^2 = {exposure} s");
    let photographed = photographed.map(|photographed| photographed.to_string());
    let comments = options.unit_exposure.map(unit).into_iter().chain(photographed).collect();
    Metadata { cd_m2_per_unit, comments, ..Metadata::of(reference) }
}

/// The caller's function that progress is reported to.
#[derive(Clone, Copy)]
enum Watch<'a> {
    Plain(&'a (dyn Fn(Progress) + Sync)),
    /// It may cancel the run.
    Cancelling(&'a (dyn Fn(Progress) -> ControlFlow<()> + Sync)),
}

impl Watch<'_> {
    fn report(self, progress: Progress) -> ControlFlow<()> {
        match self {
            Watch::Plain(watch) => {
                watch(progress);
                ControlFlow::Continue(())
            }
            Watch::Cancelling(watch) => watch(progress),
        }
    }
}

/// The stages with a clock, and what they have warned of so far.
pub(super) struct Line<'a> {
    watch: Watch<'a>,
    pub began: Instant,
    times: Times,
    pub warnings: Vec<Warning>,
    /// The page, where one is asked for.
    page: Option<Page>,
}

impl<'a> Line<'a> {
    pub fn new(watch: &'a (dyn Fn(Progress) + Sync)) -> Self {
        Line::watched(Watch::Plain(watch))
    }

    /// As [`new`](Self::new); where `watch` breaks, the run is cancelled before the next stage.
    pub fn cancellable(watch: &'a (dyn Fn(Progress) -> ControlFlow<()> + Sync)) -> Self {
        Line::watched(Watch::Cancelling(watch))
    }

    fn watched(watch: Watch<'a>) -> Self {
        Line { watch, began: Instant::now(), times: Times::default(), warnings: Vec::new(), page: None }
    }

    /// With a page, where the report is to be one.
    pub fn with_page(mut self, options: &Options) -> Self {
        let is_page = |path: &&PathBuf| report::Format::of(path).is_ok_and(|format| format == report::Format::Html);
        self.page = options.report.as_ref().filter(is_page).map(|path| Page::new(path));
        self
    }

    /// What the page needs of the frames, while they are there.
    pub fn gather(
        &mut self,
        bracket: &Bracket,
        alignment: &Alignment,
        region: Rect,
        developed: Option<&Developed>,
        options: &Options,
    ) -> Result<()> {
        let Some(mut page) = self.page.take() else { return Ok(()) };
        let gathered = || page.gather(bracket, alignment, region, &options.align, &self.warnings, developed);
        let ((), time_s) = self.timed(Stage::Inspect, gathered)?;
        page.take_time(time_s);
        self.page = Some(page);
        Ok(())
    }

    /// `work`, announced, and its time in seconds.
    ///
    /// # Errors
    /// Those of `work`; [`Error::Cancelled`] where the caller breaks off.
    pub fn timed<R>(&self, stage: Stage, work: impl FnOnce() -> Result<R>) -> Result<(R, f64)> {
        if self.watch.report(Progress::Begins(stage)).is_break() {
            return Err(Error::Cancelled);
        }
        let began = Instant::now();
        let result = work()?;
        Ok((result, began.elapsed().as_secs_f64()))
    }

    /// The bracket, to which `stages` are done.
    pub fn load(&mut self, images: &[PathBuf], stages: &Stages, options: &Options) -> Result<Bracket> {
        let watch = self.watch;
        // Runs are cancelled between stages only.
        let decoded = |done| {
            let _ = watch.report(Progress::Decoded(done));
        };
        let load = || bracket::load_for(stages, images, &options.load, &decoded);
        let ((bracket, warnings), time_s) = self.timed(Stage::Load, load)?;
        self.times.load = Some(time_s);
        self.warnings.extend(warnings);
        Ok(bracket)
    }

    /// Where its frames lie, and the bracket with the reference that this is of: that which it has, or another ([`referred`]).
    pub fn align(&mut self, bracket: Bracket, options: &Options) -> Result<(Bracket, Alignment)> {
        let reference = bracket.reference_index();
        let align = || referred::align(bracket, options);
        let ((bracket, alignment, warnings), time_s) = self.timed(Stage::Align, align)?;
        self.times.align = Some(time_s);
        if bracket.reference_index() != reference {
            // Of colours that are others than the reference's there is something else to say.
            self.warnings.retain(|warning| !matches!(warning, Warning::ProfilesDiffer { .. }));
            self.warnings.extend(bracket::differing_profiles(&bracket));
        }
        self.warnings.extend(warnings);
        Ok((bracket, alignment))
    }

    /// The bracket with the exposures that are divided out, and what its codes mean.
    pub fn response(
        &mut self,
        bracket: Bracket,
        alignment: &Alignment,
        saved: Option<SavedResponse>,
        options: &Options,
    ) -> Result<(Bracket, Camera)> {
        let ((bracket, camera, warnings), time_s) = self.timed(Stage::Response, || -> Result<_> {
            let is_tuned = options.exposures == Exposures::FineTuned;
            let is_sought = saved.is_none() && options.response.is_sought();
            let is_needed = is_tuned || is_sought || saved.is_some() || options.save_response.is_some();
            let mut places = if is_needed { Places::of(&bracket, alignment)? } else { Places::default() };
            let (bracket, mut warnings) =
                if is_tuned { ratios::fine_tuned(bracket, &mut places) } else { (bracket, Vec::new()) };
            let evidence = processing(&bracket, &places, options);
            let is_local = evidence.is_some_and(|evidence| evidence.is_local);
            let (curve, report) = match saved {
                None if is_local => {
                    if options.save_response.is_some() {
                        return Err(Error::LocallyProcessed { path: bracket.reference().path().to_owned() });
                    }
                    let placed = alignment.placed(&bracket).map(|(_, frame, _)| frame.path().to_owned());
                    warnings.push(Warning::LocallyProcessed { paths: placed.collect() });
                    let curve = evidence.as_ref().map_or_else(ResponseCurve::srgb, local::curve);
                    let fallback = Some("the frames are locally processed, which no curve explains".to_owned());
                    (curve, ResponseReport { model: "srgb", fallback, ..ResponseReport::default() })
                }
                Some(saved) => {
                    let path = options.response_file.as_deref().unwrap_or(Path::new(""));
                    warnings.extend(differing_response(path, &saved, &bracket.reference().capture));
                    warnings.extend(contradicted_response(path, &saved.curve, &places, is_local)?);
                    (saved.curve, ResponseReport { model: "file", ..ResponseReport::default() })
                }
                None => {
                    let (curve, report, more) = response::recover_from(&[&places], &options.response)?;
                    warnings.extend(more);
                    (curve, report)
                }
            };
            // A curve that is given is taken at its word: the frames are merged as functions of exposure.
            let evidence = evidence.filter(|_| report.model != "file");
            Ok((bracket, Camera { curve, report, evidence }, warnings))
        })?;
        self.times.response = Some(time_s);
        self.warnings.extend(warnings);
        Ok((bracket, camera))
    }

    pub fn merge(
        &mut self,
        bracket: &Bracket,
        alignment: &Alignment,
        camera: &Camera,
        region: Rect,
        options: &Options,
    ) -> Result<Radiance> {
        let curve = &camera.curve;
        let merging = MergeOptions { weight: options.weight, region };
        let (merged, time_s) = self.timed(Stage::Merge, || {
            let local = camera.local().map(|_| LocalGain::find(bracket, alignment, curve, region)).transpose()?;
            let gain = local.as_ref().map(|local| move |layer: usize, rows: Range<usize>| local.at(layer, rows));
            let gain = gain.as_ref().map(|gain| gain as deghost::Gain);
            let ghosts = |strength| deghost::find(bracket, alignment, curve, region, strength, gain);
            let ghosts = options.deghost.strength().map(ghosts).transpose()?;
            let merging = Merging::of(bracket, alignment, curve, &merging, ghosts.as_ref())?;
            let merging = merging.with_local_gain(local.as_ref())?;
            let (mut slabs, bounds) = Slabs::merged(&merging, &room(bracket, &merging, options))?;
            let merged = merging.merged(bounds);
            let limits = if local.is_none() { Limits::of(bracket, alignment, curve)? } else { None };
            let mut flare = None;
            if options.flare {
                let mut cells = flare::Cells::new(slabs.size().0, slabs.size().1);
                slabs.each(|_, map| {
                    cells.see(&map.pixels);
                    Ok(())
                })?;
                let veil = cells.veil();
                flare = Some(veil.as_ref().map_or_else(FlareReport::default, Veil::report));
                if let Some(veil) = veil {
                    slabs = slabs.changed(|first, mut map| {
                        veil.take_off(first, &mut map.pixels);
                        map
                    })?;
                }
            }
            // Those that are left out too: how long somebody exposed says how bright the place is.
            let exposures = bracket.frames().iter().map(|frame| frame.exposure.relative());
            let photographed = Photographed::of(exposures, bracket.reference().exposure.relative(), curve);
            let photographed = match &local {
                Some(local) => photographed.map(|photographed| local.photographed(photographed)),
                None => photographed,
            };
            Ok(Radiance { slabs, photographed, merged, limits, ghosts, flare, local })
        })?;
        self.times.merge = Some(time_s);
        Ok(merged)
    }

    /// Radiance in the colour space and the unit that are wanted, and the statistics of that.
    pub fn units(
        &mut self,
        radiance: Radiance,
        calibration: &Option<CalibrationReport>,
        options: &Options,
    ) -> Result<(Radiance, Statistics)> {
        let began = Instant::now();
        let mut slabs = radiance.slabs;
        let mut outside = 0;
        let normalised = |unit| normalisation::factor(unit, radiance.merged.reference_exposure);
        let calibrated = calibration.as_ref().map(|calibration| calibration.cd_m2_per_unit);
        let factor = calibrated.or(options.unit_exposure.map(normalised));
        let photographed = radiance.photographed.map(|photographed| photographed.times(factor.unwrap_or(1.0)));
        if options.colour.is_some() || factor.is_some() {
            slabs = slabs.changed(|_, map| {
                let (mut map, drawn) = match options.colour {
                    Some(space) => gamut::converted(map, space),
                    None => (map, 0),
                };
                outside += drawn;
                if let Some(factor) = factor {
                    calibration::calibrate(&mut map, factor);
                }
                map
            })?;
        }
        self.warnings.extend(gamut::warning(outside));
        let mut tally = Tally::default();
        slabs.each(|_, map| {
            tally.see(&map.pixels, gamut::weights(&map.primaries));
            Ok(())
        })?;
        if let Some(page) = &mut self.page {
            page.take_luminance(tally.by_stops(Page::PER_STOP));
        }
        let statistics = tally.statistics(calibration.map_or(Unit::Relative, |_| Unit::CdM2));
        self.times.merge = self.times.merge.map(|time| time + began.elapsed().as_secs_f64());
        let limits = radiance.limits.map(|limits| limits.times(factor.unwrap_or(1.0)));
        Ok((Radiance { slabs, photographed, limits, ..radiance }, statistics))
    }

    /// What rows of the picture come from.
    pub fn tonemap(
        &mut self,
        slabs: &Slabs,
        photographed: Option<Photographed>,
        aligned: &Aligned,
        options: &Options,
    ) -> Result<Picture> {
        let mut unused = Vec::new();
        let (picture, time_s) = self.timed(Stage::Tonemap, || {
            let operator = match &options.rendering {
                Rendering::Toned(operator) => operator,
                Rendering::Fused(fused) => {
                    unused.extend(options.flare.then_some("--flare"));
                    let channels = aligned.fused(fused, options.write.picture.colours)?;
                    return Picture::fused(channels, &options.write.picture);
                }
            };
            let shape = (slabs.size(), slabs.primaries());
            Picture::toned(&|see| slabs.each(see), shape, photographed, operator, &options.write.picture)
        })?;
        self.times.tonemap = Some(time_s);
        self.warnings.extend(unused.into_iter().map(|option| Warning::FusedAsIs { option }));
        self.warnings.extend(picture.warning(&options.write.picture));
        Ok(picture)
    }

    /// The radiance and the picture, whole but not yet named; and the picture, where it is to be kept.
    pub fn results(
        &mut self,
        slabs: &Slabs,
        statistics: &Statistics,
        picture: &Picture,
        metadata: Metadata,
        keep: bool,
        options: &Options,
    ) -> Result<(Vec<Written>, Plane<[u8; 3]>)> {
        let (width, height) = slabs.size();
        let mut page = self.page.take();
        let is_seen = keep || page.is_some();
        if let Some(page) = &mut page {
            page.take_profile(options.write.picture.colours.profile());
        }
        let mut kept = Vec::with_capacity(if keep { width * height } else { 0 });
        let mut shown = |codes: &[[u8; 3]]| {
            if let Some(page) = &mut page {
                page.see((width, height), codes);
            }
            if keep {
                kept.extend_from_slice(codes);
            }
        };
        let ((files, mapping), time_s) = self.timed(Stage::Write, || {
            let results = Results {
                outputs: options.results()?,
                options: &options.write,
                metadata,
                size: (width, height),
                primaries: slabs.primaries(),
                bright: statistics.p99_9,
            };
            results.written(&|see| slabs.each(see), picture, is_seen.then_some(&mut shown))
        })?;
        self.page = page;
        self.warnings.extend(options.write.picture.size.warning((width, height)));
        let mapping = mapping.as_secs_f64();
        self.times.tonemap = self.times.tonemap.map(|time| time + mapping);
        self.times.write = Some(self.times.write.unwrap_or(0.0) + time_s - mapping);
        Ok((files, Plane::from_vec(width, if keep { height } else { 0 }, kept)))
    }

    /// The file of the curve where one is asked for, whole but not yet named.
    pub fn curve_file(
        &mut self,
        bracket: &Bracket,
        alignment: &Alignment,
        curve: &ResponseCurve,
        options: &Options,
    ) -> Result<Option<Written>> {
        let Some(path) = &options.save_response else { return Ok(None) };
        let Capture { make, model, .. } = bracket.reference().capture.clone();
        let saved = SavedResponse { make, model, curve: curve.clone() };
        let miniature = curves::miniature(std::slice::from_ref(path), bracket, alignment, 1)?;
        curves::written(&saved, path, &Vec::from_iter(&miniature)).map(Some)
    }

    /// All files but those of the results, the curve and the report, whole but not yet named.
    pub fn others(
        &mut self,
        bracket: &Bracket,
        alignment: &Alignment,
        region: Rect,
        options: &Options,
    ) -> Result<Vec<Written>> {
        let reference = bracket.reference();
        let (written, time_s) = self.timed(Stage::Write, || -> Result<Vec<Written>> {
            let mut files = Vec::new();
            if let Some(path) = &options.transforms {
                files.push(write::text(path, &SavedAlignment::of(bracket, alignment).to_json())?);
            }
            if let Some(prefix) = &options.save_aligned {
                // What the unit of radiance is says nothing of frames.
                let metadata = Metadata { comments: Vec::new(), ..metadata(reference, None, options) };
                files.extend(aligned::write(bracket, alignment, region, prefix, &metadata)?);
            }
            Ok(files)
        })?;
        self.times.write = Some(self.times.write.unwrap_or(0.0) + time_s);
        Ok(written)
    }

    /// Completes the report, and gives all files: `files`, and that of the report.
    pub fn report(mut self, report: &mut Report, files: Vec<Written>, options: &Options) -> Result<Vec<Pending>> {
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
            let text = self.page.as_ref().map_or_else(|| Ok(report.to_json()), |page| page.to_html(report))?;
            pending.push(write::text(path, &text)?.file);
        }
        Ok(pending)
    }
}
