//! Loading: files to a bracket.
//!
//! In: paths, and what the user says of them. Out: a [`Bracket`] and what there is to say about it; the same whatever the order of the
//! paths, save for `-e` and a reference by number, which go by it. Cost: that of the decoders, one frame per thread.
//!
//! Exposures are the user's where given, else those of EXIF, else, where one is missing or cannot be, estimated from the pixels. A frame that the
//! flash lit shows another scene than those that it did not, and is excluded.

pub(crate) mod copies;

use super::colour::{Found, Profile};
use super::decode::{self, Decoded};
use super::exposure::{Exposure, ExposureSource, ExposureTags, MOST_EV};
use super::header::Header;
use super::window::Store;
use super::{Bracket, Capture, Codes, Frame, OnDisk, ReferenceChoice, Samples, reference};
use crate::bracket::exposure::brightness::{self, Brightness};
use crate::bracket::metadata::capture;
use crate::budget::{Budget, Demand, Stages};
use crate::error::{Error, Result, Warning};
use crate::intake;
use crate::limits::{self, Limits};
use crate::plane::map_at_once;
use crate::scratch::{MemoryLimit, Scratch};
use copies::{Copied, Look};
use exif::{Exif, In, Tag};
use std::collections::HashMap;
use std::io::{self, Cursor};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What the user says of a bracket's files.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadOptions {
    /// Exposures in EV, one a file in the order given; they win over anything the files say. Default: none.
    pub ev: Option<Vec<f64>>,
    /// Which frame the others are aligned to. Default: automatic.
    pub reference: ReferenceChoice,
    /// The most pixels that a photograph may have, by its header. Default: [`Limits::MAX_PIXELS`].
    pub max_pixels: u64,
    /// How much memory may be used: frames that do not fit are put on disk. Default: as much as is needed.
    pub memory: Option<MemoryLimit>,
    /// Whether the results may tell where the photographs were taken. No by default.
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
    /// What one photograph may ask for: of the memory allowed, what the program leaves.
    pub fn limits(&self) -> Limits {
        Limits { max_pixels: self.max_pixels, memory: self.memory.as_ref().map(MemoryLimit::for_pixels) }
    }
}

/// The most photographs of a bracket.
pub const MOST_FRAMES: usize = 1000;

/// Reads the files `paths` as one bracket.
///
/// # Errors
/// Of the command line: [`Error::TooFewFrames`], [`Error::SameFile`], [`Error::Option`]. Of the first file in the order given that fails:
/// [`Error::Read`], [`Error::UnknownFormat`], [`Error::Decode`], [`Error::SizeMismatch`]. [`Error::NoExposure`] where the files do not
/// say how they were exposed and the pixels do not either.
pub fn load(paths: &[PathBuf], options: &LoadOptions) -> Result<(Bracket, Vec<Warning>)> {
    load_with_progress(paths, options, &|_| ())
}

/// As [`load`], and calls `progress` with the number of files done after each, from any thread.
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

/// As [`load_with_progress`], of a bracket to which `stages` are done.
///
/// # Errors
/// As [`load`]; [`Error::Option`] where that does not fit into the memory allowed.
pub(crate) fn load_for(
    stages: &Stages,
    paths: &[PathBuf],
    options: &LoadOptions,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<(Bracket, Vec<Warning>)> {
    if let Some(path) = paths.iter().find(|path| path.is_dir()) {
        let folder = path.display();
        let reason = format!(
            "it is a folder; name the photographs of a bracket in it, as in `{folder}/*.jpg`, or merge all brackets in it by \
             `hdralign batch {folder}`"
        );
        let source = io::Error::new(io::ErrorKind::IsADirectory, reason);
        return Err(Error::Read { path: path.clone(), source });
    }
    if paths.len() < 2 {
        return Err(Error::TooFewFrames { given: paths.len() });
    }
    if paths.len() > MOST_FRAMES {
        let reason = format!(
            "{} photographs are no bracket, which has {MOST_FRAMES} at most; name those of one, or let `hdralign batch FOLDER` find the brackets",
            paths.len()
        );
        return Err(Error::Option { option: "IMAGES", reason });
    }
    let given = options.ev.as_ref().map(|ev| given_exposures(ev, paths.len())).transpose()?;
    refuse_same_files(paths)?;

    let done = AtomicUsize::new(0);
    let read = |path: &PathBuf, scratch: Option<&Arc<Scratch>>| {
        let picture = Picture::read(path, options, scratch);
        progress(1 + done.fetch_add(1, Ordering::Relaxed));
        picture
    };
    let (mut pictures, on_disk) = match &options.memory {
        None => (in_order(map_at_once(paths.len(), paths.len(), |i| read(&paths[i], None)))?, None),
        Some(limit) => read_within(limit, stages, paths, read)?,
    };
    check_sizes(&pictures)?;
    widen_mixed_depths(&mut pictures, on_disk.as_ref().map(|on_disk| &on_disk.scratch))?;

    let mut warnings = Vec::new();
    let copies = copies::find(&pictures.iter().map(Picture::look).collect::<Vec<_>>())?;
    warnings.extend(copies.iter().map(Copied::warning));
    let exposures = match given {
        Some(given) => {
            warnings.extend(doubtful(&pictures, &copies, &given));
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
            notes.insert(picture.path.clone(), picture.warnings);
            let exposure = with_tags(exposure, &picture.tags);
            let size = (picture.width, picture.height);
            let mut frame = Frame::stored(picture.path, size, picture.store, picture.well_exposed, exposure);
            frame.profile = picture.profile;
            frame.capture = picture.capture;
            frame.excluded = picture.excluded;
            frame
        })
        .collect();
    let bracket = Bracket { on_disk, ..Bracket::new(frames, &options.reference)? };
    for frame in bracket.frames() {
        warnings.extend(notes.remove(frame.path()).unwrap_or_default());
    }
    warnings.extend(differing_profiles(&bracket));
    Ok((bracket, warnings))
}

/// All of `paths` by `read`, within the memory of `limit`; where they do not fit, with where they are.
fn read_within(
    limit: &MemoryLimit,
    stages: &Stages,
    paths: &[PathBuf],
    read: impl Fn(&PathBuf, Option<&Arc<Scratch>>) -> Result<Picture> + Sync,
) -> Result<(Vec<Picture>, Option<OnDisk>)> {
    // The first tells how large they are.
    let mut first = read(&paths[0], None)?;
    let demand = Demand {
        stages: *stages,
        frames: paths.len(),
        size: (first.width, first.height),
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
    Ok((in_order(pictures)?, scratch.map(|scratch| OnDisk { scratch, budget })))
}

/// All of them, or the error of the first that failed, whichever did so first.
fn in_order(read: Vec<Result<Picture>>) -> Result<Vec<Picture>> {
    read.into_iter().collect()
}

/// The `-e` list as exposures.
fn given_exposures(ev: &[f64], files: usize) -> Result<Vec<Exposure>> {
    let wrong = |reason| Error::Option { option: "-e", reason };
    if ev.len() != files {
        return Err(wrong(format!(
            "{} exposures for {files} photographs; give one for each, in their order",
            ev.len()
        )));
    }
    ev.iter()
        .map(|&ev| {
            let exposure = Exposure::given(ev).filter(|_| ev.abs() <= MOST_EV);
            exposure
                .ok_or_else(|| wrong(format!("{ev} is no exposure; give stops within +-{MOST_EV}, as in `-e=-2,0,2`")))
        })
        .collect()
}

/// Finds a file that was given twice, by the same or another name. What does not exist is left to the reading.
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

/// One file, read.
struct Picture {
    path: PathBuf,
    width: usize,
    height: usize,
    store: Store,
    /// Bytes that it took while it was decoded.
    decoding: u64,
    brightness: Brightness,
    well_exposed: u64,
    tags: ExposureTags,
    profile: Option<Profile>,
    capture: Capture,
    /// Why it is not to be merged.
    excluded: Option<String>,
    warnings: Vec<Warning>,
}

impl Picture {
    /// Reads `path`; with a scratch file, the codes are put on it.
    fn read(path: &Path, options: &LoadOptions, scratch: Option<&Arc<Scratch>>) -> Result<Self> {
        let limits = options.limits();
        let bytes = content(path, &limits)?;
        refuse_result(path, &bytes, &limits)?;
        let Decoded { width, height, samples, decoding, exif, icc, mut notes, .. } =
            decode::decode(path, bytes, &limits)?;
        let tags = exif.as_ref().map(ExposureTags::read).unwrap_or_default();
        let capture = exif.as_ref().map(|exif| capture::read(exif, options.keep_gps)).unwrap_or_default();
        let profile = profile(icc, exif.as_ref(), &mut notes);
        let warnings = notes.into_iter().map(|detail| Warning::Metadata { path: path.into(), detail }).collect();
        // Here, where another frame is being decoded beside it.
        let (brightness, well_exposed) = (Brightness::of(&samples, width), reference::well_exposed(&samples, width));
        let mut store = Store::Held(samples);
        if let Some(scratch) = scratch {
            store.put_on(scratch)?;
        }
        Ok(Picture {
            path: path.into(),
            width,
            height,
            store,
            decoding,
            brightness,
            well_exposed,
            tags,
            profile,
            capture,
            excluded: None,
            warnings,
        })
    }
}

impl Picture {
    fn look(&self) -> Look<'_> {
        let Picture { path, width, height, store, brightness, well_exposed, .. } = self;
        Look { path, size: (*width, *height), store, brightness, well_exposed: *well_exposed }
    }
}

/// The bytes of the picture `path`. It is read once, so that there is nothing to be seen twice, and differently.
pub(super) fn content(path: &Path, limits: &Limits) -> Result<Vec<u8>> {
    intake::whole_if(path, limits.most_bytes(), |begin| decode::check_format(path, begin))
}

/// Refuses what hdralign made of photographs before: a second `merge *.jpg` would merge the first one's results. What is damaged is left to the
/// decoding.
fn refuse_result(path: &Path, bytes: &[u8], limits: &Limits) -> Result<()> {
    match Header::of(path, Cursor::new(bytes), limits) {
        Ok(header) if header.is_ours() => {
            let path = path.display();
            let reason = format!(
                "{path} is a result of hdralign, not a photograph; leave it out, or give the photographs it was made of"
            );
            Err(Error::Option { option: "IMAGES", reason })
        }
        _ => Ok(()),
    }
}

/// The profile that a file carries, or that its EXIF means.
pub(super) fn profile(icc: Option<Vec<u8>>, exif: Option<&Exif>, notes: &mut Vec<String>) -> Option<Profile> {
    let Some(icc) = icc else {
        // DCF 2.0: "uncalibrated" with the interoperability index R03 is Adobe RGB.
        let exif = exif?;
        let uncalibrated = exif.get_field(Tag::ColorSpace, In::PRIMARY)?.value.get_uint(0) == Some(0xFFFF);
        let r03 = capture::ascii(exif, Tag::InteroperabilityIndex).as_deref() == Some("R03");
        return if uncalibrated && r03 { Profile::adobe_rgb() } else { None };
    };
    match Profile::parse(icc) {
        Found::Rgb(profile) => {
            if profile.primaries.is_none() {
                notes.push(format!(
                    "the primaries of its colour profile ({}) are unknown; sRGB's are assumed",
                    profile.description
                ));
            }
            Some(profile)
        }
        Found::Other(kind) => {
            notes.push(format!("its {kind} colour profile was ignored; sRGB is assumed"));
            None
        }
        Found::Damaged => {
            notes.push("its colour profile is damaged and was ignored; sRGB is assumed".into());
            None
        }
    }
}

fn check_sizes(pictures: &[Picture]) -> Result<()> {
    let size = |p: &Picture| (p.width, p.height);
    let first = &pictures[0];
    match pictures.iter().find(|p| size(p) != size(first)) {
        None => Ok(()),
        Some(odd) => Err(Error::SizeMismatch {
            path: odd.path.clone(),
            size: size(odd),
            other: first.path.clone(),
            other_size: size(first),
        }),
    }
}

/// Code values of one bracket are of one scale: 8-bit frames among 16-bit ones are spread to 0..=65535.
fn widen_mixed_depths(pictures: &mut [Picture], scratch: Option<&Arc<Scratch>>) -> Result<()> {
    if pictures.iter().all(|p| p.store.max() == pictures[0].store.max()) {
        return Ok(());
    }
    for picture in pictures {
        let whole = picture.store.window((picture.width, picture.height), 0..picture.height)?;
        let Codes::Eight(v) = whole.codes() else { continue };
        let wide = Samples::Sixteen(v.iter().map(|&code| u16::from(code) * 257).collect());
        drop(whole);
        picture.well_exposed = reference::well_exposed(&wide, picture.width);
        picture.store = Store::Held(wide);
        if let Some(scratch) = scratch {
            picture.store.put_on(scratch)?;
        }
        let detail = "it is of 8 bit among frames of 16 bit, and was spread to 16".into();
        picture.warnings.push(Warning::Metadata { path: picture.path.clone(), detail });
    }
    Ok(())
}

/// Excludes the frames that were lit by the flash, where at least two others were not; but not the reference that the user chose. Gives what there is
/// to say of those that stay; of the others the user may still say where they lie.
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
            picture.excluded = Some("the flash fired, unlike in the other frames".to_owned());
        }
    }
    warnings.sort_by_key(ToString::to_string);
    Ok(warnings)
}

/// What the pixels say against the exposures that the user gives; these are taken all the same.
fn doubtful(pictures: &[Picture], copies: &[Copied], given: &[Exposure]) -> Option<Warning> {
    let seen: Vec<&Brightness> = pictures.iter().map(|p| &p.brightness).collect();
    let given: Vec<f64> = given.iter().map(Exposure::ev).collect();
    let detail = copies::contradiction(copies, &given).or_else(|| brightness::contradiction(&given, &seen))?;
    Some(Warning::ExposureDoubtful { detail })
}

/// `exposure` with what the file says of its parts. A time that the pixels belie is not repeated.
fn with_tags(mut exposure: Exposure, tags: &ExposureTags) -> Exposure {
    if exposure.source != ExposureSource::Exif {
        exposure.time_s = if exposure.source == ExposureSource::Given { tags.time_s.map(|t| t.0) } else { None };
        exposure.f_number = tags.f_number.map(|n| n.0);
        exposure.iso = tags.iso.map(|s| s.0);
    }
    exposure
}

/// What there is to say of frames whose colours are others than the reference's.
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

mod exposures;
#[cfg(test)]
mod tests;
