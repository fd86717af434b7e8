//! The stages of a run, with the time of each and the warnings so far.
//!
//! In: [`Options`], and for each stage the result of the previous one. Out: the input of the next stage; at the end the
//! report. Cost: the stages.

pub(crate) mod fusion;
pub(crate) mod picture;
pub(crate) mod radiance;
pub(crate) mod reference;
pub(crate) mod response;
pub(crate) mod results;

use super::{Options, Prepared, Progress, Stage, Watch, announce};
use crate::align::transforms_file::SavedAlignment;
use crate::bracket::{self, Bracket, Capture, Frame};
use crate::budget::Stages;
use crate::error::{Result, Warning};
use crate::merge::radiance::calibration::{CalibrationReport, Factor};
use crate::merge::{MergeOptions, Photographed};
use crate::page::{Developed, Page};
use crate::pipeline::files::curves;
use crate::plane::Plane;
use crate::report::{self, Report, Times, WarningReport};
use crate::response::file::SavedResponse;
use crate::tonemap::Rendering;
use crate::write::{self, Metadata, Written, aligned, displacements};
use picture::Picture;
use radiance::Radiance;
use reference::Aligned;
use response::Camera;
use results::Results;
use std::path::PathBuf;
use std::time::Instant;

/// The state of a run.
pub(super) struct Run<'a> {
    pub options: &'a Options,
    watch: Watch<'a>,
    /// The stage that was announced last.
    stage: Option<Stage>,
    /// The file of transforms that was read.
    pub transforms_from: Option<&'a PathBuf>,
    began: Instant,
    times: Times,
    pub warnings: Vec<Warning>,
    /// The HTML report, if requested.
    page: Option<Page>,
}

impl<'a> Run<'a> {
    /// Creates a run with `options`, without a page.
    pub fn new(options: &'a Options, watch: Watch<'a>) -> Self {
        let (times, warnings) = (Times::default(), Vec::new());
        let began = Instant::now();
        Run { options, watch, stage: None, transforms_from: None, began, times, warnings, page: None }
    }

    /// Adds an HTML report, if the user requested one.
    pub fn with_page(mut self) -> Self {
        let is_page = |path: &&PathBuf| report::Format::of(path).is_ok_and(|format| format == report::Format::Html);
        self.page = self.options.report.as_ref().filter(is_page).map(|path| Page::new(path));
        self
    }

    /// Returns the same run, with other `options` from here on.
    pub fn with_options(self, options: &'a Options) -> Self {
        Run { options, ..self }
    }

    /// Announces `stage`, unless it is already running, and starts its clock.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::error::Error::Cancelled).
    pub fn begin(&mut self, stage: Stage) -> Result<Instant> {
        if self.stage.replace(stage) != Some(stage) {
            announce(self.watch, stage)?;
        }
        Ok(Instant::now())
    }

    /// Loads the bracket `images`; memory is planned for these `stages`.
    pub fn load(&mut self, images: &[PathBuf], stages: &Stages) -> Result<Bracket> {
        let began = self.begin(Stage::Load)?;
        // The callback's return value is ignored, because runs are cancelled between stages only.
        let decoded = |done| {
            let _ = (self.watch)(Progress::Decoded(done));
        };
        let (bracket, warnings) = bracket::load_for(stages, images, &self.options.load, &decoded)?;
        self.times.load = Some(began.elapsed().as_secs_f64());
        self.warnings.extend(warnings);
        Ok(bracket)
    }

    /// Aligns `bracket` to its own reference or, if that fails, to another frame: see [`reference::align`].
    pub fn align(&mut self, bracket: Bracket) -> Result<Aligned> {
        let began = self.begin(Stage::Align)?;
        let loaded = bracket.reference_index();
        let (bracket, alignment, warnings) = reference::align(bracket, self.options)?;
        self.times.align = Some(began.elapsed().as_secs_f64());
        if bracket.reference_index() != loaded {
            // These warnings compare the profiles of frames with the profile of the reference, which is another frame
            // now.
            self.warnings.retain(|warning| !matches!(warning, Warning::ProfilesDiffer { .. }));
            self.warnings.extend(bracket::differing_profiles(&bracket));
        }
        self.warnings.extend(warnings);
        let region = self.options.crop.rect(&bracket, &alignment);
        Ok(Aligned { bracket, alignment, region })
    }

    /// Corrects the exposures, and recovers the camera response or uses `saved`.
    pub fn response(&mut self, aligned: Aligned, saved: Option<SavedResponse>) -> Result<(Aligned, Camera)> {
        let began = self.begin(Stage::Response)?;
        let (aligned, camera, warnings) = response::find(aligned, saved, self.options)?;
        self.times.response = Some(began.elapsed().as_secs_f64());
        self.warnings.extend(warnings);
        Ok((aligned, camera))
    }

    /// Merges the frames to radiance in the colour space and the unit of the results.
    pub fn merge(
        &mut self,
        aligned: &Aligned,
        camera: &Camera,
        calibration: Option<CalibrationReport>,
    ) -> Result<Radiance> {
        let began = self.begin(Stage::Merge)?;
        let (radiance, warning) = radiance::merged(aligned, camera, calibration, self.options)?;
        self.warnings.extend(warning);
        if let Some(page) = &mut self.page {
            page.take_luminance(radiance.tally.by_stops(Page::PER_STOP));
        }
        self.times.merge = Some(began.elapsed().as_secs_f64());
        Ok(radiance)
    }

    /// Tone-maps the radiance, or fuses the frames. Returns the source of the picture's rows.
    pub fn tonemap(&mut self, aligned: &Aligned, camera: &Camera, radiance: &Radiance) -> Result<Picture> {
        let began = self.begin(Stage::Tonemap)?;
        let made = &self.options.write.picture;
        let picture = match &self.options.rendering {
            Rendering::Toned(operator) => {
                let rows = &radiance.rows;
                let shape = (rows.size(), rows.primaries());
                Picture::toned(&|see| rows.each(see), shape, radiance.photographed, operator, made)?
            }
            Rendering::Fused(fused) => {
                if self.options.flare {
                    self.warnings.push(Warning::FusedAsIs { option: "--flare" });
                }
                let ghosts = radiance.ghosts.as_ref();
                Picture::fused(fusion::fused(aligned, &camera.curve, ghosts, fused, made.colours)?, made)?
            }
        };
        self.times.tonemap = Some(began.elapsed().as_secs_f64());
        self.warnings.extend(picture.warning(made));
        Ok(picture)
    }

    /// Collects the data of the HTML report from the frames, before they are freed.
    pub fn gather(&mut self, aligned: &Aligned, merged: Option<(&Camera, &Radiance)>) -> Result<()> {
        let Some(mut page) = self.page.take() else { return Ok(()) };
        let began = self.begin(Stage::Inspect)?;
        let Aligned { bracket, alignment, region } = aligned;
        let merging = MergeOptions { weight: self.options.weight_for(bracket), region: *region };
        let developed = merged.map(|(camera, radiance)| Developed {
            curve: &camera.curve,
            merging,
            ghosts: radiance.ghosts.as_ref(),
            local: radiance.local.as_ref(),
        });
        page.gather(bracket, alignment, *region, &self.options.align, &self.warnings, developed.as_ref())?;
        page.take_time(began.elapsed().as_secs_f64());
        self.page = Some(page);
        Ok(())
    }

    /// Writes the response file, if requested.
    pub fn write_response(&self, aligned: &Aligned, camera: &Camera) -> Result<Option<Written>> {
        let Some(path) = &self.options.save_response else { return Ok(None) };
        let Capture { make, model, .. } = aligned.bracket.reference().capture.clone();
        let saved = SavedResponse { make, model, curve: camera.curve.clone() };
        let miniature = curves::miniature(std::slice::from_ref(path), &aligned.bracket, &aligned.alignment, 1)?;
        curves::written(&saved, path, &Vec::from_iter(&miniature)).map(Some)
    }

    /// Writes the transforms and the aligned frames, if requested.
    pub fn write_frames(&mut self, aligned: &Aligned) -> Result<Vec<Written>> {
        let began = self.begin(Stage::Write)?;
        let Aligned { bracket, alignment, region } = aligned;
        let mut files = Vec::new();
        if let Some(path) = &self.options.transforms {
            files.push(write::text(path, &SavedAlignment::of(bracket, alignment).to_json())?);
        }
        // The comments are about the unit and range of radiance, and do not apply to frames.
        let metadata = |frame: &Frame| Metadata { comments: Vec::new(), ..metadata(frame, None, self.options) };
        if let Some(prefix) = &self.options.save_aligned {
            files.extend(aligned::write(bracket, alignment, *region, prefix, metadata)?);
        }
        if let Some(prefix) = &self.options.displacements {
            files.extend(displacements::write(bracket, alignment, prefix, metadata)?);
        }
        self.times.write = Some(began.elapsed().as_secs_f64());
        Ok(files)
    }

    /// Writes the radiance maps and the pictures. Returns the picture if it `is_kept`, otherwise an empty one.
    pub fn write_results(
        &mut self,
        radiance: &Radiance,
        picture: &Picture,
        metadata: Metadata,
        is_kept: bool,
    ) -> Result<(Vec<Written>, Plane<[u8; 3]>)> {
        let began = self.begin(Stage::Write)?;
        let (rows, made) = (&radiance.rows, &self.options.write.picture);
        let (width, height) = rows.size();
        let page = &mut self.page;
        let is_seen = is_kept || page.is_some();
        if let Some(page) = page {
            page.take_profile(made.colours.profile());
        }
        let mut kept = Vec::with_capacity(if is_kept { width * height } else { 0 });
        let mut shown = |codes: &[[u8; 3]]| {
            if let Some(page) = page {
                page.see((width, height), codes);
            }
            if is_kept {
                kept.extend_from_slice(codes);
            }
        };
        let results = Results {
            outputs: self.options.results()?,
            options: &self.options.write,
            metadata,
            size: (width, height),
            primaries: rows.primaries(),
            bright: radiance.statistics.p99_9,
        };
        let (files, mapping) = results.written(&|see| rows.each(see), picture, is_seen.then_some(&mut shown))?;
        self.warnings.extend(made.size.warning((width, height)));
        let mapping = mapping.as_secs_f64();
        self.times.tonemap = self.times.tonemap.map(|time| time + mapping);
        self.times.write = self.times.write.map(|time| time + began.elapsed().as_secs_f64() - mapping);
        Ok((files, Plane::from_vec(width, if is_kept { height } else { 0 }, kept)))
    }

    /// Completes the report, and writes its file.
    pub fn report(mut self, mut report: Report, written: Vec<Written>) -> Result<Prepared<Report>> {
        let names: Vec<PathBuf> = written.iter().map(|w| w.file.target().to_path_buf()).collect();
        let mut files = Vec::new();
        for written in written {
            self.warnings.extend(written.warnings);
            files.push(written.file);
        }
        report.transforms_from = self.transforms_from.map(|path| path.to_string_lossy().into_owned());
        report.add_outputs(&names);
        report.warnings = self.warnings.iter().map(WarningReport::from).collect();
        self.times.total = self.began.elapsed().as_secs_f64();
        report.time_s = self.times;
        if let Some(path) = &self.options.report {
            let text = self.page.as_ref().map_or_else(|| Ok(report.to_json()), |page| page.to_html(&report))?;
            files.push(write::text(path, &text)?.file);
        }
        Ok(Prepared { report, files, overwrite: self.options.write.overwrite })
    }
}

/// Returns the metadata of a result that shows `frame`.
pub(super) fn metadata(frame: &Frame, photographed: Option<Photographed>, options: &Options) -> Metadata {
    let cd_m2_per_unit = options.calibration.is_asked().then_some(Factor::ONE);
    let unit = |exposure| {
        format!("radiance 1.0 gives the middle pixel value (128 of 255) if the exposure (t ISO / N^2) is {exposure} s")
    };
    let photographed = photographed.map(|photographed| photographed.to_string());
    let comments = options.unit_exposure.map(unit).into_iter().chain(photographed).collect();
    Metadata { cd_m2_per_unit, comments, ..Metadata::of(frame) }
}
