//! Finding brackets: folders as they come from a card, to brackets and what is left over.
//!
//! In: folders. Out: [`Found`]: brackets, each with its photographs in the order of time, and every other photograph with the [`Reason`] that it is
//! in none. The same whatever the order of the folders, of their entries and of the threads. Cost: a header a photograph ([`Header`]), and
//! some 50 us to place it.
//!
//! Photographs are taken apart into streams, in which a bracket's frames follow each other (`streams`), and each stream is divided where
//! that costs least (`segment`). See docs/reference/bracket-detection.md for users.

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

/// What the user says of the brackets.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FindOptions {
    /// Brackets are of exactly so many photographs; then also those are found that do not say how or when they were taken, by their names.
    /// Default: any number from 2 to 32.
    pub frames: Option<usize>,
    /// The longest pause in a bracket, from the end of an exposure to the begin of the next, in seconds. Default: 120.
    pub gap_s: Option<f64>,
    /// Each folder is one bracket, whatever its photographs say.
    pub by_folder: bool,
    /// Folders that are not entered: where results go.
    pub skip: Vec<PathBuf>,
    /// The most pixels that a photograph may have; others are left over. Default: [`Limits::MAX_PIXELS`].
    pub max_pixels: Option<u64>,
}

/// What there is in the folders.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Found {
    /// By folder, then by time.
    pub brackets: Vec<FoundBracket>,
    /// Photographs that are in no bracket, and folders that cannot be read; by name.
    pub left_over: Vec<LeftOver>,
    /// Files that are no photographs by their name: videos, texts, results.
    pub other_files: usize,
}

/// A bracket.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundBracket {
    /// The folder given in which it is.
    pub root: PathBuf,
    /// The folder of its first photograph, from `root` on; empty where that is `root` itself.
    pub folder: PathBuf,
    /// In the order of time, or of name where nothing says when they were taken; at least two.
    pub photographs: Vec<Shot>,
    /// The panorama that it belongs to, counted from 0: brackets of one set were taken one after the other, by one pattern.
    pub set: usize,
}

impl FoundBracket {
    /// The relative exposure t ISO / N^2 (s) of each photograph as merging will take it, where its file says.
    pub fn exposures(&self) -> Vec<Option<f64>> {
        let tags: Vec<_> = self.photographs.iter().map(|shot| shot.header.exposure).collect();
        let (exposures, _) = exposure::by_tags(&tags);
        exposures.into_iter().map(|exposure| exposure.map(|e| e.relative())).collect()
    }
}

/// A photograph that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Shot {
    /// The file: the folder given, and the way from there.
    pub path: PathBuf,
    /// What it says of itself.
    pub header: Header,
}

/// A photograph in no bracket.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOver {
    /// The file or the folder.
    pub path: PathBuf,
    /// Why, and what to do about it.
    pub reason: Reason,
}

/// Why a photograph is in no bracket; the text has the remedy where there is one.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Reason {
    /// A raw file; the photograph that is used in its place, where there is one.
    Raw(Option<PathBuf>),
    /// A photograph in a format that is not read.
    Format(&'static str),
    /// Another file of the same shot is used.
    Twin(PathBuf),
    /// The same file by another name is used.
    SameFile(PathBuf),
    /// hdralign wrote it; by the program that the file names.
    Result(String),
    /// It cannot be read: why.
    Unreadable(String),
    /// It does not say how it was exposed.
    NoExposure,
    /// The flash fired, and not in the photographs around it.
    Flash,
    /// No photograph of another exposure is near enough in time.
    Single,
    /// One of so many in a row of one exposure.
    Burst(usize),
    /// By count: fewer than so many are left of its kind.
    Remainder(usize),
    /// By folder: its size, and that of the others.
    OtherSize((usize, usize), (usize, usize)),
    /// By folder: it is the only one.
    Alone,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        match self {
            Reason::Raw(Some(used)) => write!(f, "a raw file; {} beside it is used", name(used)),
            Reason::Raw(None) => {
                write!(f, "a raw file, which is not read; develop it to a 16-bit TIFF, all frames alike")
            }
            Reason::Format(format) => write!(f, "{format}, which is not read; convert it to TIFF or JPEG"),
            Reason::Twin(used) => write!(f, "the same shot as {}, which is used", name(used)),
            Reason::SameFile(used) => write!(f, "the same file as {}, which is used", used.display()),
            Reason::Result(by) => write!(f, "a result, written by {by}"),
            Reason::Unreadable(why) => write!(f, "{why}"),
            Reason::NoExposure => {
                write!(f, "its EXIF has no exposure; group the photographs with --bracket N or --by-folder")
            }
            Reason::Flash => write!(f, "the flash fired, and not in the photographs around it"),
            Reason::Single => write!(
                f,
                "a single one: none of another exposure that goes with it is near in time; --gap sets how near, --bracket N how many"
            ),
            Reason::Burst(count) => write!(
                f,
                "one of {count} in a row of one exposure; if their EXIF is wrong, say what belongs together by --bracket N or --by-folder"
            ),
            Reason::Remainder(frames) => write!(f, "no bracket of {frames} can be made with it and those around it"),
            Reason::OtherSize(own, others) => {
                write!(f, "{}x{} pixels in a folder of {}x{}", own.0, own.1, others.0, others.1)
            }
            Reason::Alone => write!(f, "the only photograph in its folder"),
        }
    }
}

/// Finds the brackets in the folders `roots` and below, and calls `watch` with the number of headers read so far, from any thread.
///
/// # Errors
/// [`Error::Read`](crate::error::Error::Read) where one of `roots` is no folder or cannot be read; [`Error::Option`](crate::error::Error::Option) where a
/// bracket would be of fewer than two or a pause of no length. All else is [left over](Found::left_over).
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
