//! Finds the brackets in folders that were copied from a memory card.
//!
//! In: folders. Out: [`Found`]: the brackets, each with its photographs in order of time, and all photographs that
//! are in no bracket, each with the [`Reason`]. The result does not depend on the order of folders and directory
//! entries, or on the number of threads. Cost: for each photograph, reading its header ([`Header`]), and about 50 us
//! to assign it to a bracket.
//!
//! First, photographs are separated into streams in which the frames of a bracket follow each other (`streams`). Then
//! each stream is divided into brackets at the smallest cost (`segment`). For users:
//! docs/reference/bracket-detection.md.

mod rhythm;
mod segment;
mod streams;
mod twins;
mod walk;

use crate::bracket::exposure;
use crate::bracket::header::Header;
use crate::error::Result;
use crate::limits::Limits;
use rayon::prelude::*;
use std::fmt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Options of the search.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FindOptions {
    /// Number of photographs of every bracket. If it is given, photographs without a recorded exposure are also
    /// grouped. Default: a bracket may have any number from 2 to 32.
    pub frames: Option<usize>,
    /// Longest pause within a bracket, from the end of an exposure to the start of the next, in seconds. Default:
    /// 120.
    pub gap_s: Option<f64>,
    /// If true, each folder is one bracket, regardless of the exposures and times in EXIF.
    pub by_folder: bool,
    /// Folders that are not searched, because results go there.
    pub skip: Vec<PathBuf>,
    /// Largest allowed number of pixels of a photograph; larger photographs are not used. Default:
    /// [`Limits::MAX_PIXELS`].
    pub max_pixels: Option<u64>,
}

/// The brackets and other files in the folders.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Found {
    /// The brackets, sorted by folder, then by time.
    pub brackets: Vec<FoundBracket>,
    /// Photographs that are in no bracket, and folders that cannot be read; sorted by path.
    pub left_over: Vec<LeftOver>,
    /// Number of files whose extension is not that of a photograph: videos, texts, results such as .exr.
    pub other_files: usize,
}

/// A bracket.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundBracket {
    /// The searched folder that contains the bracket.
    pub root: PathBuf,
    /// The folder of the first photograph of the bracket, relative to `root`; empty if this folder is `root` itself.
    pub folder: PathBuf,
    /// The photographs, at least two. They are in order of time, or in order of name if their times are not known.
    pub photographs: Vec<Shot>,
    /// The number of the panorama that contains the bracket, from 0. Consecutive brackets with the same exposure
    /// steps and short pauses between them form one panorama.
    pub set: usize,
}

impl FoundBracket {
    /// Returns for each photograph the relative exposure t ISO / N^2 (s) from its EXIF tags; `None` if they do not
    /// suffice. (The merge may correct it.)
    pub fn exposures(&self) -> Vec<Option<f64>> {
        let tags: Vec<_> = self.photographs.iter().map(|shot| shot.header.exposure).collect();
        let (exposures, _) = exposure::by_tags(&tags);
        exposures.into_iter().map(|exposure| exposure.map(|e| e.relative())).collect()
    }
}

/// A photograph in a bracket.
#[derive(Debug, Clone, PartialEq)]
pub struct Shot {
    /// The path of the file: the path of the searched folder, followed by the path relative to it.
    pub path: PathBuf,
    /// The header of the file.
    pub header: Header,
}

/// A photograph that is in no bracket, or a folder that cannot be read.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOver {
    /// The file or the folder.
    pub path: PathBuf,
    /// Why it is in no bracket, or why the folder cannot be read.
    pub reason: Reason,
}

/// Why a photograph is in no bracket. The message also says what the user can do about it, if anything.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Reason {
    /// It is a raw file. Contains the path of the photograph that is considered instead, if there is one.
    Raw(Option<PathBuf>),
    /// It is in an unsupported format. Contains the name of the format.
    Format(&'static str),
    /// Another file of the same shot is considered. Contains the path of that file.
    Twin(PathBuf),
    /// The same file is considered under another path. Contains that path.
    SameFile(PathBuf),
    /// It is a result that hdralign wrote. Contains the name and version of the program from its
    /// metadata.
    Result(String),
    /// It cannot be read. Contains the error.
    Unreadable(String),
    /// Its EXIF has no exposure.
    NoExposure,
    /// The flash fired for it, but not for some other photographs of the same camera, lens, size and folder.
    Flash,
    /// It forms no bracket with the photographs before and after it.
    Single,
    /// It is one of several consecutive photographs with the same exposure. Contains their number.
    Burst(usize),
    /// Only with [`FindOptions::frames`]: the photographs around it that are left form no bracket of that number of
    /// frames. Contains that number.
    Remainder(usize),
    /// Only with [`FindOptions::by_folder`]: its size differs from the size that is considered in its folder. Contains
    /// the width and height of the photograph, then the width and height that are considered.
    OtherSize((usize, usize), (usize, usize)),
    /// Only with [`FindOptions::by_folder`]: no other usable photograph of the folder has its size, so it would be
    /// alone in the bracket.
    Alone,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        match self {
            Reason::Raw(Some(used)) => write!(f, "a raw file; {} beside it is considered instead", name(used)),
            Reason::Raw(None) => {
                write!(
                    f,
                    "a raw file of a format that is not supported; convert it to DNG, for example with Adobe's DNG Converter"
                )
            }
            Reason::Format(format) => write!(f, "{format}, which is not supported; convert it to TIFF or JPEG"),
            Reason::Twin(used) => {
                let used = name(used);
                write!(f, "the same shot as {used}; only {used} is considered")
            }
            Reason::SameFile(used) => write!(f, "the same file as {}; only that name is considered", used.display()),
            Reason::Result(by) => write!(f, "a result, written by {by}"),
            Reason::Unreadable(why) => write!(f, "{why}"),
            Reason::NoExposure => {
                write!(f, "its EXIF has no exposure; group the photographs with --bracket N or --by-folder")
            }
            Reason::Flash => write!(
                f,
                "the flash fired, but not for some other photographs of this camera in its folder or the neighbouring folders of the card"
            ),
            Reason::Single => write!(
                f,
                "a single photograph, which forms no bracket with the photographs before and after it; give --gap to change the longest pause within a bracket, or --bracket N for brackets of N frames"
            ),
            Reason::Burst(count) => write!(
                f,
                "one of {count} in a row with the same exposure; if their EXIF is wrong, put each bracket in its own folder and give --by-folder"
            ),
            Reason::Remainder(frames) => {
                write!(
                    f,
                    "no bracket of {frames} is left for it; the photographs of a bracket have the same camera, lens, size, flash and focal length, are in one folder (or in numbered folders of one card), do not all have the same exposure, and have no pause longer than --gap"
                )
            }
            Reason::OtherSize(own, others) => {
                write!(
                    f,
                    "it has {}x{} pixels, but only photographs with {}x{} pixels are considered in its folder",
                    own.0, own.1, others.0, others.1
                )
            }
            Reason::Alone => write!(f, "there is no other usable photograph of its size in its folder"),
        }
    }
}

/// Finds the brackets in the folders `roots` and all folders below them. Calls `watch` with the number of photographs
/// examined so far. The calls come from any thread.
///
/// # Errors
/// [`Error::Read`](crate::error::Error::Read) if one of `roots` is not a folder or cannot be read;
/// [`Error::Option`](crate::error::Error::Option) if [`FindOptions::frames`] is below 2, or [`FindOptions::gap_s`] is
/// invalid. Files and folders below `roots` that cannot be read are in [`Found::left_over`].
pub fn find(roots: &[PathBuf], options: &FindOptions, watch: &(dyn Fn(usize) + Sync)) -> Result<Found> {
    streams::check(options)?;
    let walk::Walk { candidates, mut left_over, other_files } = walk::walk(roots, &options.skip)?;
    let done = AtomicUsize::new(0);
    let limits = Limits { max_pixels: options.max_pixels.unwrap_or(Limits::MAX_PIXELS), ..Limits::default() };
    let headers: Vec<_> = candidates
        .into_par_iter()
        .map(|candidate| {
            let header = candidate.is_read().then(|| Header::read(&candidate.path, &limits));
            watch(1 + done.fetch_add(1, Ordering::Relaxed));
            (candidate, header)
        })
        .collect();
    let shots = twins::photographs(headers, &mut left_over);
    let mut found = streams::grouped(shots, options, left_over);
    found.other_files = other_files;
    Ok(found)
}

#[cfg(test)]
mod tests;
