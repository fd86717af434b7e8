//! Errors and warnings.
//!
//! An [`Error`] stops a run; in a batch, it stops the job. Most texts name the file or option, what is wrong and what
//! to do. A [`Warning`] is part of
//! the report. With `--strict`, warnings that [degrade](Warning::degrades) the result change the exit code to 3.

mod warning;

use std::io;
use std::path::PathBuf;
pub use warning::Warning;

/// The result of all fallible functions of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// The reason why a run stopped. No incomplete files are left behind.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened or read.
    #[error("{}: cannot be read: {source}{}", path.display(), remedy(source, "; check the name and the permissions"))]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// A file was written, truncated or replaced while it was read, or between two accesses.
    #[error("{}: was changed while it was read; wait until it is complete, then start again", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// The content is not in a supported format, whatever the extension is.
    #[error("{}: is not a JPEG, PNG, TIFF or DNG image ({found}); convert it, or leave it out", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What the first bytes look like, in words.
        found: String,
    },
    /// The content is damaged, or a variant of the format that is not supported.
    #[error("{}: cannot be decoded as {format}: {reason}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The format, detected from the content: `JPEG`, `PNG`, `TIFF`, `OpenEXR` or `Radiance HDR`;
        /// `image` for an image in memory.
        format: &'static str,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// A file is not a radiance map, whatever the extension is.
    #[error(
        "{}: is {found}, not a radiance map; give an .exr, .hdr or floating-point .tif file, or create one from a bracket with `hdralign merge`",
        path.display()
    )]
    NotRadiance {
        /// The file.
        path: PathBuf,
        /// What the first bytes look like, in words.
        found: &'static str,
    },
    /// A file to be compared is not in a supported format.
    #[error(
        "{}: cannot be compared ({found}); give a radiance map (.exr, .hdr, .tif) or a picture (.png, .jpg, .tif)",
        path.display()
    )]
    NotComparable {
        /// The file.
        path: PathBuf,
        /// What the first bytes look like, in words.
        found: String,
    },
    /// A radiance map was to be compared with a display picture, which is not possible.
    #[error(
        "{}: contains {kind}, but {} contains {other_kind}; compare two radiance maps or two pictures (`hdralign tonemap` creates pictures)",
        path.display(),
        other.display()
    )]
    KindsDiffer {
        /// The file with the expected values.
        path: PathBuf,
        /// What the expected file contains, in words.
        kind: &'static str,
        /// The file with the actual values.
        other: PathBuf,
        /// What the actual file contains, in words.
        other_kind: &'static str,
    },
    /// The bracket has fewer than two frames.
    #[error("a bracket needs at least two photographs, {given} given; name all of its photographs")]
    TooFewFrames {
        /// Number of files that were given.
        given: usize,
    },
    /// The frames have different sizes.
    #[error("{}: is {}x{} pixels, but {} is {}x{}; all frames of a bracket must have the same size (after rotation by their EXIF orientation); leave out the files of another size",
            path.display(), size.0, size.1, other.display(), other_size.0, other_size.1)]
    SizeMismatch {
        /// The frame that differs.
        path: PathBuf,
        /// Width and height of the frame that differs, in pixels.
        size: (usize, usize),
        /// The first frame.
        other: PathBuf,
        /// Width and height of the first frame, in pixels.
        other_size: (usize, usize),
    },
    /// The same file was given more than once, perhaps under two names.
    #[error("{}: is the same file as {}; give each photograph once", path.display(), other.display())]
    SameFile {
        /// The path that was given later.
        path: PathBuf,
        /// The path that was given earlier.
        other: PathBuf,
    },
    /// The exposure is not given by the user, cannot be taken from the file, and cannot be estimated from the pixels.
    #[error("{}: {reason}; give the exposures with -e, in EV and in the order of the files, for example `-e=-2,0,2`", path.display())]
    NoExposure {
        /// The file.
        path: PathBuf,
        /// Why there is no exposure.
        reason: String,
    },
    /// All frames besides the reference are rejected or excluded, so there is nothing to merge.
    #[error("{}: {reason}", reference.display())]
    NothingAligned {
        /// The reference.
        reference: PathBuf,
        /// Why no other frame is merged, and what to do.
        reason: String,
    },
    /// No part of the reference is in all merged frames.
    #[error(
        "{}: the merged frames have no part of {} in common; this frame shows the least of it; exclude this frame with --leave-out (in a batch, use `hdralign merge` for this), or correct the transform of this frame if you gave a file of transforms",
        path.display(),
        reference.display()
    )]
    NoOverlap {
        /// The frame that covers the smallest rectangle of the reference.
        path: PathBuf,
        /// The reference.
        reference: PathBuf,
    },
    /// The value of an option is invalid, in general or for these inputs.
    #[error("{option}: {reason}")]
    Option {
        /// The option as typed, for example `--reference`.
        option: &'static str,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// An output file already exists.
    #[error("{}: exists already; choose another name, or replace it with --force", path.display())]
    OutputExists {
        /// The file.
        path: PathBuf,
    },
    /// An existing result has the name of the new result, but was made from other photographs.
    #[error(
        "{}: was made from other photographs; choose another folder or unique names (for example {{date}} and {{time}} in `--name`), or replace it with --force",
        path.display()
    )]
    OtherPhotographs {
        /// The file.
        path: PathBuf,
    },
    /// A photograph of an earlier result exists but is no longer detected as part of the bracket.
    #[error(
        "{}: was made with {photograph}, which exists but is no longer detected as part of the bracket; copy the photograph again if it is damaged, or give --force to merge without it",
        path.display()
    )]
    FrameLost {
        /// The report of the result.
        path: PathBuf,
        /// The photograph.
        photograph: String,
    },
    /// A result was modified after hdralign wrote it.
    #[error("{}: was changed since hdralign wrote it, and is not replaced; move it, or replace it with --force", path.display())]
    OutputChanged {
        /// The file.
        path: PathBuf,
    },
    /// The extension of an output is unknown.
    #[error("{}: the extension must be one of {known}", path.display())]
    UnknownExtension {
        /// The file.
        path: PathBuf,
        /// The known extensions.
        known: &'static str,
    },
    /// A result could not be written.
    #[error("{}: cannot be written: {source}{}", path.display(), write_remedy(source))]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the system or the encoder.
        source: io::Error,
    },
    /// The threads could not be started.
    #[error(
        "{}threads could not be started: {source}; give fewer with --threads if the command has it, or allow more (`ulimit -u`, `ulimit -v`)",
        if *threads == 0 { String::new() } else { format!("{threads} ") }
    )]
    Threads {
        /// Number of threads that should be started; 0 for the default number.
        threads: usize,
        /// The error of the system.
        source: rayon::ThreadPoolBuildError,
    },
    /// The caller cancelled the run.
    #[error("the run was cancelled")]
    Cancelled,
    /// The output was abandoned by [`abandon`](crate::write::abandon).
    #[error("{}: was not written, because the run was interrupted; start it again", path.display())]
    Abandoned {
        /// The file, or the first of several files that are committed together.
        path: PathBuf,
    },
    /// The scratch file, for data that do not fit into the memory limit, could not be created, written or read.
    #[error(
        "{}: the scratch file cannot be used: {source}; delete some files there, name another folder with --scratch, or raise the memory limit with --max-memory",
        folder.display()
    )]
    Scratch {
        /// The folder of the scratch file.
        folder: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// A file of transforms is invalid.
    #[error("{}: is not a usable file of transforms: {reason}", path.display())]
    TransformsFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A folder contains no bracket.
    #[error("{}: no bracket was found: {reason}; `hdralign batch FOLDER --dry-run` shows how the photographs were grouped", path.display())]
    NoBracket {
        /// The first of the folders.
        path: PathBuf,
        /// What was found instead, in words.
        reason: String,
    },
    /// A plan of batch jobs is invalid.
    #[error("{}: line {line}: is not a valid plan: {reason}; create one with `hdralign batch FOLDER --plan`", path.display())]
    PlanFile {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// The camera's response cannot be recovered from the brackets.
    #[error("{}: the camera's response cannot be recovered ({reason}); give brackets of static scenes that span several stops", path.display())]
    NoResponse {
        /// The reference frame of the first bracket used, or the first photograph if no bracket can be used.
        path: PathBuf,
        /// Why the response cannot be recovered.
        reason: String,
    },
    /// The camera tone-mapped the frames locally, so they have no response.
    #[error("{}: the camera changed parts of the frames (local tone mapping), so there is no response to save; merge without `--save-response` or `--shared-response`, or use frames taken with the camera's HDR mode off", path.display())]
    LocallyProcessed {
        /// The reference frame.
        path: PathBuf,
    },
    /// A response file is invalid.
    #[error("{}: is not a usable response file: {reason}", path.display())]
    ResponseFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The requested format cannot represent the response curve.
    #[error("{}: the response cannot be saved in this format: {reason}; save it as .json", path.display())]
    ResponseFormat {
        /// The file.
        path: PathBuf,
        /// What would be lost.
        reason: String,
    },
}

impl Error {
    /// Returns whether a file could not be written because the disk is full or the quota is used up, so that further
    /// files would fail as well.
    pub fn is_disk_full(&self) -> bool {
        let is_space = |kind| matches!(kind, io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded);
        matches!(self, Error::Write { source, .. } if is_space(source.kind()))
    }

    /// Returns whether the command line is wrong, not a file or the machine: the exit code is then 2 instead of 1.
    pub fn is_usage(&self) -> bool {
        matches!(
            self,
            Error::TooFewFrames { .. }
                | Error::SameFile { .. }
                | Error::Option { .. }
                | Error::UnknownExtension { .. }
                | Error::KindsDiffer { .. }
        )
    }
}

/// Returns what to do if a file cannot be accessed: `advice`, unless the kind of error allows more specific advice.
///
/// The text is empty if the program itself refused the file, because its reason already includes what to do.
fn remedy(source: &io::Error, advice: &'static str) -> &'static str {
    let has_advice = matches!(source.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::IsADirectory);
    match source.raw_os_error() {
        None if has_advice && source.get_ref().is_some() => "",
        Some(TOO_MANY_OPEN) if cfg!(unix) => "; allow more open files (`ulimit -n`)",
        Some(INPUT_OUTPUT) if cfg!(unix) => "; the disk or the card may be damaged: copy the file again",
        _ => advice,
    }
}

/// Returns what to do if a file cannot be written.
fn write_remedy(source: &io::Error) -> &'static str {
    use io::ErrorKind::{AlreadyExists, FileTooLarge, InvalidFilename, IsADirectory, NotADirectory};
    use io::ErrorKind::{QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    match source.kind() {
        StorageFull => "; delete some files there, or write to another disk",
        QuotaExceeded => "; the quota is used up: delete some files there, or write to another disk",
        ReadOnlyFilesystem => "; write to a folder on another disk, or mount this one for writing",
        FileTooLarge => "; allow larger files (`ulimit -f`), or write to a file system that holds them",
        InvalidFilename => "; give it a shorter name",
        // These errors concern only folders; an existing output is reported as `Error::OutputExists`.
        AlreadyExists | NotADirectory => {
            "; there is a file where this path needs a folder: choose another folder, or move the file"
        }
        IsADirectory if source.raw_os_error().is_some() => {
            "; a folder has that name: move it away, or choose another name"
        }
        _ => remedy(source, "; check the folder, its permissions and the free disk space"),
    }
}

/// The error number EMFILE (too many open files) on Linux, macOS and the BSDs.
const TOO_MANY_OPEN: i32 = 24;

/// The error number EIO (input/output error) on Linux, macOS and the BSDs.
const INPUT_OUTPUT: i32 = 5;
