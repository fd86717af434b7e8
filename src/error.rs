//! What can go wrong, and what the caller should know although it went right.
//!
//! [`Error`] stops a run: it names the file or the option, says what is wrong and what to do about it.
//! [`Warning`] does not: it travels in the report, and those that [degrade](Warning::degrades) the result make `--strict` exit with 3.

mod warning;

use std::io;
use std::path::PathBuf;
pub use warning::Warning;

/// The result of every fallible call of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Why a run stopped. The text names the file and the remedy; nothing was left half-written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened or read.
    #[error("{}: cannot be read: {source}{}", path.display(), remedy(source, "; check the name and the permissions"))]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file was written, cut or exchanged while it was read, or between two looks at it.
    #[error("{}: was changed while it was read; wait until it is whole, and start again", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// The content is none of the formats that are read, whatever the extension says.
    #[error("{}: is not a JPEG, PNG or TIFF picture ({found}); convert it first, or leave it out", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What the first bytes look like, in words.
        found: String,
    },
    /// The format is known but the content is damaged or of a kind that is not supported.
    #[error("{}: cannot be decoded as {format}: {reason}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The format by content: `JPEG`, `PNG`, `TIFF`.
        format: &'static str,
        /// What is wrong with it, and the remedy.
        reason: String,
    },
    /// A file that should hold a radiance map holds something else, whatever the extension says.
    #[error(
        "{}: is {found}, not a radiance map; give an .exr, an .hdr or a floating-point .tif, or make one of a bracket with `hdralign merge`",
        path.display()
    )]
    NotRadiance {
        /// The file.
        path: PathBuf,
        /// What the first bytes look like, in words.
        found: &'static str,
    },
    /// A file that should be compared is of none of the formats that are read.
    #[error(
        "{}: cannot be compared ({found}); give an .exr, .hdr or .tif of radiance, or a .png, .jpg or .tif picture",
        path.display()
    )]
    NotComparable {
        /// The file.
        path: PathBuf,
        /// What the first bytes look like, in words.
        found: String,
    },
    /// A radiance map and a display picture were to be compared.
    #[error(
        "{}: holds {kind}, and {} holds {other_kind}; compare radiance with radiance, or pictures with pictures (`hdralign tonemap` makes one)",
        path.display(),
        other.display()
    )]
    KindsDiffer {
        /// The file expected.
        path: PathBuf,
        /// What it holds, in words.
        kind: &'static str,
        /// The file there is.
        other: PathBuf,
        /// What it holds, in words.
        other_kind: &'static str,
    },
    /// A bracket needs at least two frames.
    #[error("a bracket needs at least two photographs, {given} given; name them all")]
    TooFewFrames {
        /// How many were given.
        given: usize,
    },
    /// Frames of one bracket must have one size.
    #[error("{}: is {}x{} pixels, but {} is {}x{}; all frames of a bracket must have one size (orientation applied)",
            path.display(), size.0, size.1, other.display(), other_size.0, other_size.1)]
    SizeMismatch {
        /// The frame that differs.
        path: PathBuf,
        /// Its width and height, in pixels.
        size: (usize, usize),
        /// The first frame.
        other: PathBuf,
        /// Width and height of the first frame, in pixels.
        other_size: (usize, usize),
    },
    /// The same file was given more than once, perhaps by two names.
    #[error("{}: is the same file as {}; give each photograph once", path.display(), other.display())]
    SameFile {
        /// The later name.
        path: PathBuf,
        /// The earlier name.
        other: PathBuf,
    },
    /// No exposure is known and none can be had from the file.
    #[error("{}: {reason}; give the exposures with -e, in EV and in the order of the files, as in `-e=-2,0,2`", path.display())]
    NoExposure {
        /// The file.
        path: PathBuf,
        /// What was looked for and not found.
        reason: String,
    },
    /// No frame could be placed beside the reference: there is nothing to merge.
    #[error("{}: no other photograph could be aligned to it ({reason}); choose another with --reference, or, from a tripod, give --align none", reference.display())]
    NothingAligned {
        /// The reference.
        reference: PathBuf,
        /// Why one of the others was left out.
        reason: String,
    },
    /// A frame was placed where it has no pixel in common with the reference and the other frames.
    #[error(
        "{}: does not overlap {} and the other frames; exclude it with --leave-out, or correct its transform in the file of transforms",
        path.display(),
        reference.display()
    )]
    NoOverlap {
        /// The frame that overlaps the reference least.
        path: PathBuf,
        /// The reference.
        reference: PathBuf,
    },
    /// An option has a value that cannot be used, by itself or with these inputs.
    #[error("{option}: {reason}")]
    Option {
        /// The option as it is typed: `--reference`.
        option: &'static str,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// An output exists already.
    #[error("{}: exists already; choose another name, or replace it with --force", path.display())]
    OutputExists {
        /// The file.
        path: PathBuf,
    },
    /// A result of hdralign's is there, of other photographs.
    #[error(
        "{}: is the result of other photographs of the same names; choose another folder, or a name that tells them apart (`--name` has {{date}} and {{time}}), or replace it with --force",
        path.display()
    )]
    OtherPhotographs {
        /// The file.
        path: PathBuf,
    },
    /// A result was made of a photograph that is there, but does not go with the others any more.
    #[error(
        "{}: was made of {photograph} too, which is there but is found in the bracket no more; is it damaged? copy it again, or replace the result with --force",
        path.display()
    )]
    FrameLost {
        /// The report of the result.
        path: PathBuf,
        /// The name of the photograph.
        photograph: String,
    },
    /// A result was changed since hdralign wrote it.
    #[error("{}: was changed since hdralign wrote it, and is kept; move it away, or replace it with --force", path.display())]
    OutputChanged {
        /// The file.
        path: PathBuf,
    },
    /// The extension of an output is none of those written.
    #[error("{}: the extension must be one of {known}", path.display())]
    UnknownExtension {
        /// The file.
        path: PathBuf,
        /// The extensions that would do.
        known: &'static str,
    },
    /// A result could not be written.
    #[error("{}: cannot be written: {source}{}", path.display(), write_remedy(source))]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system or the encoder said.
        source: io::Error,
    },
    /// The system refused threads.
    #[error(
        "{threads} threads could not be started: {source}; give fewer with --threads, or allow more (`ulimit -u`, `ulimit -v`)"
    )]
    Threads {
        /// How many there should have been.
        threads: usize,
        /// What the system said.
        source: rayon::ThreadPoolBuildError,
    },
    /// The caller broke the run off.
    #[error("the run was cancelled")]
    Cancelled,
    /// The process gives up what it writes, as [`abandon`](crate::write::abandon) told it.
    #[error("{}: is not written, for the run was interrupted; start it again", path.display())]
    Abandoned {
        /// The file, or the first of those that were to be named together.
        path: PathBuf,
    },
    /// What does not fit into the memory allowed could not be put on disk, or had again.
    #[error(
        "{}: cannot hold what does not fit into the memory allowed: {source}; make room there, name another folder with --scratch, or allow more with --max-memory",
        folder.display()
    )]
    Scratch {
        /// The folder of the scratch file.
        folder: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file of transforms could not be used.
    #[error("{}: is no usable file of transforms: {reason}", path.display())]
    TransformsFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// No bracket was found.
    #[error("{}: no bracket was found: {reason}; `hdralign batch FOLDER --dry-run` lists all", path.display())]
    NoBracket {
        /// The first of the folders.
        path: PathBuf,
        /// What was found instead.
        reason: String,
    },
    /// A file of steps could not be used.
    #[error("{}: line {line}: is no plan: {reason}; make one by `hdralign batch --plan FOLDER`", path.display())]
    PlanFile {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// The brackets do not tell the camera's response.
    #[error("{}: the camera's response cannot be recovered ({reason}); give brackets of still scenes, several stops wide", path.display())]
    NoResponse {
        /// The first photograph.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The frames are locally processed, so that there is no response.
    #[error("{}: the frames are locally processed by the camera: their brightness does not follow the exposure, and there is no response to save; merge without `--save-response` or `--shared-response`, or calibrate by frames of which the camera's HDR is off", path.display())]
    LocallyProcessed {
        /// The first photograph.
        path: PathBuf,
    },
    /// A saved response curve could not be used.
    #[error("{}: is no usable response file: {reason}", path.display())]
    ResponseFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The format asked for does not hold the response curve.
    #[error("{}: the response cannot be saved in this format: {reason}; save it as .json", path.display())]
    ResponseFormat {
        /// The file.
        path: PathBuf,
        /// What would be lost.
        reason: String,
    },
}

impl Error {
    /// Whether a result could not be written for want of space: what is written next would fail as well.
    pub fn is_disk_full(&self) -> bool {
        let is_space = |kind| matches!(kind, io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded);
        matches!(self, Error::Write { source, .. } if is_space(source.kind()))
    }

    /// Whether the command line, rather than a file or the machine, is at fault: exit code 2 instead of 1.
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

/// `advice`, but where a name was refused by the program itself, which then says what to do, and where the system says more.
fn remedy(source: &io::Error, advice: &'static str) -> &'static str {
    let is_told = matches!(source.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::IsADirectory);
    match source.raw_os_error() {
        None if is_told && source.get_ref().is_some() => "",
        Some(TOO_MANY_OPEN) if cfg!(unix) => "; allow more open files (`ulimit -n`)",
        Some(INPUT_OUTPUT) if cfg!(unix) => "; the disk or the card may be damaged: copy the file again",
        _ => advice,
    }
}

/// What to do where a file could not be written.
fn write_remedy(source: &io::Error) -> &'static str {
    use io::ErrorKind::{AlreadyExists, FileTooLarge, InvalidFilename, IsADirectory, NotADirectory};
    use io::ErrorKind::{QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    match source.kind() {
        StorageFull => "; make room there, or write to another disk",
        QuotaExceeded => "; the quota is used up: make room there, or write to another disk",
        ReadOnlyFilesystem => "; write to a folder on another disk, or mount this one for writing",
        FileTooLarge => "; allow larger files (`ulimit -f`), or write to a file system that holds them",
        InvalidFilename => "; give it a shorter name",
        // Of folders alone: a file that exists is another error.
        AlreadyExists | NotADirectory => "; it is in the place of a folder: name another, or move the file away",
        IsADirectory if source.raw_os_error().is_some() => "; a folder has that name: move it away, or choose another",
        _ => remedy(source, "; check the folder, its permissions and the space left"),
    }
}

/// EMFILE of Linux, macOS and the BSDs.
const TOO_MANY_OPEN: i32 = 24;

/// EIO of the same.
const INPUT_OUTPUT: i32 = 5;
