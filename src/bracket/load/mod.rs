//! Loads files as a bracket.
//!
//! In: paths and [`LoadOptions`]. Out: a [`Bracket`] and warnings. The result does not depend on the order of the
//! paths, except through `-e` and a reference given by number. Cost: the decoders, which run in parallel, one frame per
//! thread.
//!
//! Exposures are those given by the user, else those in EXIF. Where an exposure in EXIF is missing or contradicts the
//! pixels, it is estimated from the pixels. Frames lit by the flash are excluded, because they show a differently lit
//! scene, if at least two frames were taken without it and the user gives no exposures. A frame chosen as the reference
//! is not excluded.

pub(crate) mod copies;
mod exposures;
mod picture;
mod twins;
mod white;

use super::exposure::{Exposure, ExposureSource, ExposureTags, MOST_EV};
use super::window::Store;
use super::{Bracket, Codes, Frame, OnDisk, ReferenceChoice, Samples, reference};
use crate::bracket::exposure::brightness::{self, Brightness};
use crate::budget::{Budget, Demand, Stages};
use crate::error::{Error, Result, Warning};
use crate::intake;
use crate::limits::{self, Limits};
use crate::plane::map_at_once;
use crate::scratch::{MemoryLimit, Scratch};
use copies::Copied;
use picture::Picture;
pub(super) use picture::{content, profile};
use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Options of [`load`].
#[derive(Debug, Clone, PartialEq)]
pub struct LoadOptions {
    /// Exposures in EV, one per file in the order given; they override the exposures in the files. Default: none.
    pub ev: Option<Vec<f64>>,
    /// The frame that the others are aligned to. Default: automatic.
    pub reference: ReferenceChoice,
    /// Maximum number of pixels of a photograph; the header is checked. Default: [`Limits::MAX_PIXELS`].
    pub max_pixels: u64,
    /// Memory limit; frames that do not fit are moved to disk. Default: no limit.
    pub memory: Option<MemoryLimit>,
    /// Whether to keep the GPS position in the metadata of the results. Default: no.
    pub keep_gps: bool,
}

impl Default for LoadOptions {
    fn default() -> Self {
        LoadOptions {
            ev: None,
            reference: ReferenceChoice::Auto,
            max_pixels: Limits::MAX_PIXELS,
            memory: None,
            keep_gps: false,
        }
    }
}

impl LoadOptions {
    /// Returns the limits for decoding one photograph. `Limits::memory` is the part of the memory limit that is
    /// available for pixels.
    pub fn limits(&self) -> Limits {
        Limits { max_pixels: self.max_pixels, memory: self.memory.as_ref().map(MemoryLimit::for_pixels) }
    }
}

/// Maximum number of photographs in a bracket.
pub const MOST_FRAMES: usize = 1000;

/// Reads the files `paths` as one bracket.
///
/// # Errors
/// For the arguments: [`Error::TooFewFrames`], [`Error::SameFile`], [`Error::Option`]. For the first file, in the order
/// given, that fails: [`Error::Read`], [`Error::UnknownFormat`], [`Error::Decode`], [`Error::SizeMismatch`].
/// [`Error::NoExposure`] where exposures are missing from the files and cannot be estimated from the pixels.
pub fn load(paths: &[PathBuf], options: &LoadOptions) -> Result<(Bracket, Vec<Warning>)> {
    load_with_progress(paths, options, &|_| ())
}

/// Same as [`load`], but calls `progress` after each file, from any thread, with the number of files done.
///
/// # Errors
/// As [`load`].
pub fn load_with_progress(
    paths: &[PathBuf],
    options: &LoadOptions,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<(Bracket, Vec<Warning>)> {
    load_for(&Stages { features: true, merging: true, ..Stages::default() }, paths, options, progress)
}

/// Same as [`load_with_progress`], for a bracket that goes through `stages`.
///
/// # Errors
/// As [`load`]; [`Error::Option`] also where the stages do not fit into the memory limit.
pub(crate) fn load_for(
    stages: &Stages,
    paths: &[PathBuf],
    options: &LoadOptions,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<(Bracket, Vec<Warning>)> {
    if let Some(path) = paths.iter().find(|path| path.is_dir()) {
        let folder = path.display();
        let reason = format!(
            "it is a folder; name the photographs of a bracket in it, for example `{folder}/*.jpg`, or merge all brackets in it with \
             `hdralign batch {folder}`"
        );
        let source = io::Error::new(io::ErrorKind::IsADirectory, reason);
        return Err(Error::Read { path: path.clone(), source });
    }
    let all = paths.len();
    let (kept, preferred) = twins::without_twins(paths);
    let paths: &[PathBuf] = &kept.iter().map(|&i| paths[i].clone()).collect::<Vec<_>>();
    if paths.len() < 2 {
        return Err(Error::TooFewFrames { given: paths.len() });
    }
    if paths.len() > MOST_FRAMES {
        let reason = format!(
            "{} photographs were given, and a bracket has {MOST_FRAMES} at most; name the photographs of one bracket, or run `hdralign batch FOLDER`, which finds the brackets",
            paths.len()
        );
        return Err(Error::Option { option: "IMAGES", reason });
    }
    let given = options.ev.as_ref().map(|ev| given_exposures(ev, all)).transpose()?;
    let given: Option<Vec<Exposure>> = given.map(|given| kept.iter().map(|&i| given[i].clone()).collect());
    refuse_same_files(paths)?;

    let done = AtomicUsize::new(0);
    let read = |path: &PathBuf, scratch: Option<&Arc<Scratch>>| {
        let picture = Picture::read(path, options, scratch);
        progress(1 + done.fetch_add(1, Ordering::Relaxed));
        picture
    };
    let (mut pictures, on_disk) = match &options.memory {
        None => {
            let read = map_at_once(paths.len(), paths.len(), |i| read(&paths[i], None));
            // Errors are collected in the order of the files, so that the error of the first file that fails is
            // returned.
            (read.into_iter().collect::<Result<Vec<_>>>()?, None)
        }
        Some(limit) => read_within(limit, stages, paths, read)?,
    };
    check_kinds(&pictures)?;
    check_sizes(&pictures)?;
    widen_mixed_depths(&mut pictures, on_disk.as_ref().map(|on_disk| &on_disk.scratch))?;

    let mut warnings = Vec::from_iter(preferred);
    let copies = copies::find(&pictures.iter().map(Picture::look).collect::<Vec<_>>())?;
    warnings.extend(copies.iter().map(Copied::warning));
    let exposures = match given {
        Some(given) => {
            warnings.extend(check_given(&pictures, &copies, &given));
            given
        }
        None => {
            warnings.extend(exclude_flash(&mut pictures, &options.reference)?);
            exposures::settle(&mut pictures, &copies, &mut warnings)?
        }
    };
    let mut notes = HashMap::new();
    let frames = pictures
        .into_iter()
        .zip(exposures)
        .map(|(picture, exposure)| {
            let (exposure, size) = (with_tags(exposure, &picture.tags), picture.size());
            notes.insert(picture.path.clone(), picture.warnings);
            let mut frame = Frame::stored(picture.path, size, picture.store, picture.well_exposed, exposure);
            frame.profile = picture.profile;
            frame.raw = picture.raw;
            frame.capture = picture.capture;
            frame.excluded = picture.excluded;
            frame
        })
        .collect();
    let mut bracket = Bracket { on_disk, ..Bracket::new(frames, &options.reference)? };
    white::as_in_reference(&mut bracket)?;
    for frame in bracket.frames() {
        warnings.extend(notes.remove(frame.path()).unwrap_or_default());
    }
    warnings.extend(differing_profiles(&bracket));
    Ok((bracket, warnings))
}

/// Reads all `paths` within the memory of `limit`. Also returns the scratch file and the memory budget where the frames
/// do not fit into memory.
fn read_within(
    limit: &MemoryLimit,
    stages: &Stages,
    paths: &[PathBuf],
    read: impl Fn(&PathBuf, Option<&Arc<Scratch>>) -> Result<Picture> + Sync,
) -> Result<(Vec<Picture>, Option<OnDisk>)> {
    // The budget is computed from the first file, because all frames of a bracket have the same size.
    let mut first = read(&paths[0], None)?;
    let demand = Demand {
        stages: *stages,
        frames: paths.len(),
        size: first.size(),
        frame: first.store.bytes(),
        decoding: first.decoding,
    };
    let budget = Budget::new(limit, demand)?;
    let stay = budget.in_memory(rayon::current_num_threads()).is_some_and(limits::is_available);
    let scratch = if stay { None } else { Some(Scratch::in_folder(&limit.folder)?) };
    if let Some(scratch) = &scratch {
        first.store.put_on(scratch)?;
    }
    let at_once = budget.decoders(stay);
    let others = &paths[1..];
    let mut pictures = vec![Ok(first)];
    pictures.extend(map_at_once(others.len(), at_once, |i| read(&others[i], scratch.as_ref())));
    let pictures = pictures.into_iter().collect::<Result<_>>()?;
    Ok((pictures, scratch.map(|scratch| OnDisk { scratch, budget })))
}

/// Converts the `-e` list to exposures.
fn given_exposures(ev: &[f64], files: usize) -> Result<Vec<Exposure>> {
    let wrong = |reason| Error::Option { option: "-e", reason };
    if ev.len() != files {
        return Err(wrong(format!(
            "{} exposures for {files} photographs; give one exposure for each photograph",
            ev.len()
        )));
    }
    ev.iter()
        .map(|&ev| {
            let exposure = Exposure::given(ev).filter(|_| ev.abs() <= MOST_EV);
            exposure.ok_or_else(|| {
                wrong(format!("{ev} is not an exposure; give an EV from -{MOST_EV} to {MOST_EV}, as in `-e=-2,0,2`"))
            })
        })
        .collect()
}

/// Rejects a file that was given twice, by the same or another name. Missing files are reported when they are read.
fn refuse_same_files(paths: &[PathBuf]) -> Result<()> {
    let mut seen: HashMap<intake::Identity, &PathBuf> = HashMap::new();
    for path in paths {
        let Some(identity) = intake::identity(path) else { continue };
        if let Some(other) = seen.insert(identity, path) {
            return Err(Error::SameFile { path: path.clone(), other: other.clone() });
        }
    }
    Ok(())
}

/// Rejects brackets of raw files and others: the same light has other values in them.
fn check_kinds(pictures: &[Picture]) -> Result<()> {
    let first = |is_raw| pictures.iter().find(|p| p.raw.is_some() == is_raw).map(|p| p.path.display());
    let (Some(raw), Some(other)) = (first(true), first(false)) else { return Ok(()) };
    let reason = format!("{raw} is a camera raw file, and {other} is not; give the raw files only, or leave them out");
    Err(Error::Option { option: "IMAGES", reason })
}

fn check_sizes(pictures: &[Picture]) -> Result<()> {
    let first = &pictures[0];
    match pictures.iter().find(|p| p.size() != first.size()) {
        None => Ok(()),
        Some(odd) => Err(Error::SizeMismatch {
            path: odd.path.clone(),
            size: odd.size(),
            other: first.path.clone(),
            other_size: first.size(),
        }),
    }
}

/// Scales 8-bit frames to 0..=65535 if the bracket also has 16-bit frames, so that all pixel values of the bracket have
/// one scale.
fn widen_mixed_depths(pictures: &mut [Picture], scratch: Option<&Arc<Scratch>>) -> Result<()> {
    if pictures.iter().all(|p| p.store.max() == pictures[0].store.max()) {
        return Ok(());
    }
    for picture in pictures {
        let whole = picture.store.window(picture.size(), 0..picture.height)?;
        let Codes::Eight(v) = whole.codes() else { continue };
        let wide = Samples::Sixteen(v.iter().map(|&code| u16::from(code) * 257).collect());
        drop(whole);
        picture.well_exposed = reference::well_exposed(&wide, picture.width);
        picture.store = Store::Held(wide);
        if let Some(scratch) = scratch {
            picture.store.put_on(scratch)?;
        }
        let detail = "it has 8 bits per channel and other frames have 16; it was converted to 16 bits".into();
        picture.warnings.push(Warning::Metadata { path: picture.path.clone(), detail });
    }
    Ok(())
}

/// Excludes the frames lit by the flash if at least two frames were taken without it; a reference frame chosen by the
/// user is not excluded. Returns warnings for the flash frames that are kept. Excluded frames get no warning here
/// because the user may still include them.
fn exclude_flash(pictures: &mut [Picture], reference: &ReferenceChoice) -> Result<Vec<Warning>> {
    let unlit = pictures.iter().filter(|p| !p.tags.flash).count();
    if unlit == 0 || unlit == pictures.len() {
        return Ok(Vec::new());
    }
    let paths: Vec<&Path> = pictures.iter().map(|p| p.path.as_path()).collect();
    let chosen = reference::chosen(&paths, reference)?;
    let mut warnings = Vec::new();
    for picture in pictures.iter_mut().filter(|p| p.tags.flash) {
        if unlit < 2 || chosen.as_ref() == Some(&picture.path) {
            warnings.push(Warning::FlashFired { path: picture.path.clone(), is_used: true });
        } else {
            picture.excluded = Some("the flash fired, unlike in other frames".to_owned());
        }
    }
    warnings.sort_by_key(ToString::to_string);
    Ok(warnings)
}

/// Warns where the exposures given by the user contradict the pixels; these exposures are used nevertheless.
fn check_given(pictures: &[Picture], copies: &[Copied], given: &[Exposure]) -> Option<Warning> {
    let seen: Vec<&Brightness> = pictures.iter().map(|p| &p.brightness).collect();
    let given: Vec<f64> = given.iter().map(Exposure::ev).collect();
    let detail = copies::contradiction(copies, &given).or_else(|| brightness::contradiction(&given, &seen))?;
    Some(Warning::ExposureDoubtful { detail })
}

/// Adds the f-number, ISO and exposure time in the tags of the file to an `exposure` that is not from EXIF. The time is
/// left out if the exposure was estimated, because the pixels may contradict the recorded time.
fn with_tags(mut exposure: Exposure, tags: &ExposureTags) -> Exposure {
    if exposure.source != ExposureSource::Exif {
        exposure.time_s = if exposure.source == ExposureSource::Given { tags.time_s.map(|t| t.0) } else { None };
        exposure.f_number = tags.f_number.map(|n| n.0);
        exposure.iso = tags.iso.map(|s| s.0);
    }
    exposure
}

/// Warns about frames whose primaries differ from the primaries of the reference frame.
pub(crate) fn differing_profiles(bracket: &Bracket) -> Vec<Warning> {
    let name = |frame: &Frame| frame.profile.as_ref().map_or("none, so sRGB".into(), |p| p.description.clone());
    let kept = bracket.reference();
    bracket
        .frames()
        .iter()
        .filter(|frame| !frame.primaries().is_close(&kept.primaries(), 0.005))
        .map(|frame| Warning::ProfilesDiffer { path: frame.path().into(), found: name(frame), kept: name(kept) })
        .collect()
}

#[cfg(test)]
mod tests;
