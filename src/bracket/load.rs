//! Loading: files to a bracket.
//!
//! In: paths, and what the user says of them. Out: a [`Bracket`] and what there is to say about it; the same whatever the order of the
//! paths, save for `-e` and a reference by number, which go by it. Cost: that of the decoders, one frame per thread.
//!
//! Exposures are the user's where given, else those of EXIF, else, where one is missing or they cannot be, estimated from the pixels.

use super::brightness::{self, Brightness};
use super::capture;
use super::colour::{Found, Profile};
use super::copies::{self, Copied, Look};
use super::decode::{self, Decoded};
use super::exposure::{self, Exposure, ExposureSource, ExposureTags, MOST_EV};
use super::window::Store;
use super::{Bracket, Capture, Codes, Frame, ReferenceChoice, Samples, reference};
use crate::error::{Error, Result, Warning};
use crate::intake;
use crate::limits::{self, Limits};
use crate::scratch::{MemoryLimit, Scratch};
use exif::{Exif, In, Tag};
use rayon::prelude::*;
use std::collections::HashMap;
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
    /// What one photograph may ask for.
    pub fn limits(&self) -> Limits {
        Limits { max_pixels: self.max_pixels, memory: self.memory.as_ref().map(|limit| limit.bytes) }
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
    let (mut pictures, scratch) = match &options.memory {
        None => (in_order(paths.par_iter().map(|path| read(path, None)).collect())?, None),
        Some(limit) => read_within(limit, paths, read)?,
    };
    check_sizes(&pictures)?;
    widen_mixed_depths(&mut pictures, scratch.as_ref())?;

    let mut warnings = Vec::new();
    let copies = copies::find(&pictures.iter().map(Picture::look).collect::<Vec<_>>())?;
    warnings.extend(copies.iter().map(Copied::warning));
    let exposures = match given {
        Some(given) => {
            warnings.extend(doubtful(&pictures, &copies, &given));
            given
        }
        None => settle_exposures(&mut pictures, &copies, &mut warnings)?,
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
            frame
        })
        .collect();
    let bracket = Bracket { scratch, ..Bracket::new(frames, &options.reference)? };
    for frame in bracket.frames() {
        warnings.extend(notes.remove(frame.path()).unwrap_or_default());
    }
    warnings.extend(differing_profiles(&bracket));
    Ok((bracket, warnings))
}

/// All of `paths` by `read`, within the memory of `limit`; where they do not fit, with the scratch file that they are on.
fn read_within(
    limit: &MemoryLimit,
    paths: &[PathBuf],
    read: impl Fn(&PathBuf, Option<&Arc<Scratch>>) -> Result<Picture> + Sync,
) -> Result<(Vec<Picture>, Option<Arc<Scratch>>)> {
    // The first tells how large they are.
    let mut first = read(&paths[0], None)?;
    let (pixels, count) = ((first.width * first.height) as u64, paths.len() as u64);
    let frame = first.store.bytes();
    // Beside the frames, alignment holds a pyramid of each, and merging the radiance.
    let all = count * frame + (count * pixels * 3 / 2).max(12 * pixels);
    let is_held = all <= limit.for_pixels() && limits::is_given(all);
    let scratch = if is_held { None } else { Some(Scratch::in_folder(&limit.folder)?) };
    if let Some(scratch) = &scratch {
        first.store.put_on(scratch)?;
    }
    // While it is decoded, a frame and its file are in memory.
    let at_once = (limit.for_pixels() / (2 * frame)).max(1);
    let mut pictures = vec![Ok(first)];
    for some in paths[1..].chunks(if is_held { paths.len() } else { at_once.min(count) as usize }) {
        pictures.par_extend(some.par_iter().map(|path| read(path, scratch.as_ref())));
    }
    Ok((in_order(pictures)?, scratch))
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
    let mut seen: HashMap<Identity, &PathBuf> = HashMap::new();
    for path in paths {
        let Some(identity) = identity(path) else { continue };
        if let Some(other) = seen.insert(identity, path) {
            return Err(Error::SameFile { path: path.clone(), other: other.clone() });
        }
    }
    Ok(())
}

/// What is one file by whatever name: device and inode; hard links are one, too.
#[cfg(unix)]
pub(crate) type Identity = (u64, u64);

#[cfg(unix)]
pub(crate) fn identity(path: &Path) -> Option<Identity> {
    use std::os::unix::fs::MetadataExt;
    let metadata = std::fs::metadata(path).ok()?;
    Some((metadata.dev(), metadata.ino()))
}

#[cfg(not(unix))]
pub(crate) type Identity = PathBuf;

#[cfg(not(unix))]
pub(crate) fn identity(path: &Path) -> Option<Identity> {
    std::fs::canonicalize(path).ok()
}

/// One file, read.
struct Picture {
    path: PathBuf,
    width: usize,
    height: usize,
    store: Store,
    brightness: Brightness,
    well_exposed: u64,
    tags: ExposureTags,
    profile: Option<Profile>,
    capture: Capture,
    warnings: Vec<Warning>,
}

impl Picture {
    /// Reads `path`; with a scratch file, the codes are put on it.
    fn read(path: &Path, options: &LoadOptions, scratch: Option<&Arc<Scratch>>) -> Result<Self> {
        let Decoded { width, height, samples, exif, icc, mut notes, .. } = decoded(path, &options.limits())?;
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
            brightness,
            well_exposed,
            tags,
            profile,
            capture,
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

/// The file `path`, decoded. It is read once, so that there is nothing to be seen twice, and differently.
pub(super) fn decoded(path: &Path, limits: &Limits) -> Result<Decoded> {
    let bytes = intake::whole_if(path, limits.most_bytes(), |begin| decode::check_format(path, begin))?;
    decode::decode(path, bytes, limits)
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

/// What the pixels say against the exposures that the user gives; these are taken all the same.
fn doubtful(pictures: &[Picture], copies: &[Copied], given: &[Exposure]) -> Option<Warning> {
    let seen: Vec<Brightness> = pictures.iter().map(|p| p.brightness.clone()).collect();
    let given: Vec<f64> = given.iter().map(Exposure::ev).collect();
    let detail = copies::contradiction(copies, &given).or_else(|| brightness::contradiction(&given, &seen))?;
    Some(Warning::ExposureDoubtful { detail })
}

/// The exposures by EXIF where they are whole and possible, else by the pixels.
fn settle_exposures(pictures: &mut [Picture], copies: &[Copied], warnings: &mut Vec<Warning>) -> Result<Vec<Exposure>> {
    let tags: Vec<_> = pictures.iter().map(|p| p.tags).collect();
    let (by_tags, assumed) = exposure::by_tags(&tags);
    let missing: Vec<usize> = (0..by_tags.len()).filter(|&i| by_tags[i].is_none()).collect();

    // By path, so that ties and chains are the same in any order of the command line.
    let mut order: Vec<usize> = (0..pictures.len()).collect();
    order.sort_by(|&a, &b| pictures[a].path.cmp(&pictures[b].path));
    let seen: Vec<Brightness> = order.iter().map(|&i| pictures[i].brightness.clone()).collect();

    let warning: fn(String) -> Warning;
    let what;
    // Frames whose EXIF is kept, though that of others is not believed.
    let mut kept = vec![false; pictures.len()];
    if let Some(&first) = missing.first() {
        what = match missing.len() {
            1 => format!("{} does not say how it was exposed", pictures[first].path.display()),
            n => format!("{n} of {} files do not say how they were exposed", pictures.len()),
        };
        warning = |detail| Warning::ExposureEstimated { detail };
    } else {
        let written: Vec<f64> = by_tags.iter().flatten().map(Exposure::ev).collect();
        let by_path: Vec<f64> = order.iter().map(|&i| written[i]).collect();
        let contradiction =
            copies::contradiction(copies, &written).or_else(|| brightness::contradiction(&by_path, &seen));
        let Some(contradiction) = contradiction else {
            for (i, detail) in assumed {
                let path = pictures[i].path.clone();
                pictures[i].warnings.push(Warning::ExposureIncomplete { path, detail });
            }
            return Ok(by_tags.into_iter().flatten().collect());
        };
        what = contradiction;
        warning = |detail| Warning::ExposureContradicted { detail };
        if let Some(odd) = brightness::at_odds(&by_path, &seen) {
            (0..order.len()).filter(|k| !odd.contains(k)).for_each(|k| kept[order[k]] = true);
        }
    }

    let unknown = |reason: &str| match missing.first() {
        Some(&first) => Error::NoExposure {
            path: pictures[first].path.clone(),
            reason: format!("it has no usable exposure in its EXIF, and {reason}"),
        },
        None => Error::NoExposure {
            path: pictures[order[0]].path.clone(),
            reason: format!("the exposures in the files contradict the pixels ({what}), and {reason}"),
        },
    };
    // Copies of one photograph were exposed as one, whatever it shows.
    let is_one = missing.is_empty() && copies.len() + 1 == pictures.len();
    let steps = if is_one { Some(vec![0.0; pictures.len()]) } else { brightness::estimate(&seen) };
    let steps = steps
        .ok_or_else(|| unknown("the pictures are too dark, too bright or too plain to tell it from the pixels"))?;
    if brightness::all_alike(&steps) && !is_one {
        return Err(unknown("the pictures are equally bright"));
    }
    // The steps hang in the air; where files do say something, it is right on the whole, so its median anchors them; where some of it is
    // kept, the nearest of that does.
    let mut offsets: Vec<f64> =
        order.iter().zip(&steps).filter_map(|(&i, step)| Some(by_tags[i].as_ref()?.ev() - step)).collect();
    if offsets.is_empty() {
        offsets = steps.iter().map(|step| -step).collect();
    }
    let near: Vec<(f64, f64)> = (0..order.len()).filter(|&k| kept[order[k]]).map(|k| (steps[k], offsets[k])).collect();
    offsets.sort_by(f64::total_cmp);
    let anchor = |step: f64| {
        let nearest = near.iter().min_by(|a, b| (a.0 - step).abs().total_cmp(&(b.0 - step).abs()));
        nearest.map_or(offsets[offsets.len() / 2], |(_, offset)| *offset)
    };

    let mut exposures = by_tags;
    for (&i, &step) in order.iter().zip(&steps).filter(|(i, _)| !kept[**i]) {
        exposures[i] = Exposure::estimated(step + anchor(step));
    }
    let exposures: Vec<Exposure> = exposures.into_iter().flatten().collect();
    let mut by_step = steps;
    by_step.sort_by(f64::total_cmp);
    let listed: Vec<String> = by_step.iter().map(|step| format!("{step:.1}")).collect();
    let odd = order.iter().filter(|&&i| kept.contains(&true) && !kept[i]);
    let odd: Vec<String> = odd.map(|&i| pictures[i].path.display().to_string()).collect();
    let kept = if odd.is_empty() { String::new() } else { format!("; that of {} is not believed", odd.join(", ")) };
    warnings.push(warning(format!("{what}{kept}; their steps are about {} EV", listed.join(", "))));
    if exposures.len() != pictures.len() {
        return Err(unknown("the pixels give no usable number"));
    }
    Ok(exposures)
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

#[cfg(test)]
mod tests;
