//! What can go wrong, and what the caller should know although it went right.
//!
//! [`Error`] stops a run: it names the file or the option, says what is wrong and what to do about it.
//! [`Warning`] does not: it travels in the report, and those that [degrade](Warning::degrades) the result make `--strict` exit with 3.

use std::io;
use std::path::PathBuf;

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
    /// A saved response curve could not be used.
    #[error("{}: is no usable response file: {reason}", path.display())]
    ResponseFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
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
    use io::ErrorKind::{FileTooLarge, InvalidFilename, IsADirectory, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    match source.kind() {
        StorageFull => "; make room there, or write to another disk",
        QuotaExceeded => "; the quota is used up: make room there, or write to another disk",
        ReadOnlyFilesystem => "; write to a folder on another disk, or mount this one for writing",
        FileTooLarge => "; allow larger files (`ulimit -f`), or write to a file system that holds them",
        InvalidFilename => "; give it a shorter name",
        IsADirectory if source.raw_os_error().is_some() => "; a folder has that name: move it away, or choose another",
        _ => remedy(source, "; check the folder, its permissions and the space left"),
    }
}

/// EMFILE of Linux, macOS and the BSDs.
const TOO_MANY_OPEN: i32 = 24;

/// EIO of the same.
const INPUT_OUTPUT: i32 = 5;

/// What a user should know about a result that was nevertheless made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Warning {
    /// No model explains this frame's motion; it was left out.
    #[error("{}: left out: {reason}", path.display())]
    FrameRejected {
        /// The frame.
        path: PathBuf,
        /// Why it could not be placed.
        reason: String,
    },
    /// This frame was placed, but with little certainty.
    #[error("{}: aligned with low confidence ({confidence:.2}); look at the result, or leave it out", path.display())]
    LowConfidence {
        /// The frame.
        path: PathBuf,
        /// 0..1.
        confidence: f64,
    },
    /// A photograph is there twice.
    #[error("{}: has the same pixels as {}; it adds nothing, leave one of them out", path.display(), other.display())]
    SamePixels {
        /// The later one, by name.
        path: PathBuf,
        /// The earlier one.
        other: PathBuf,
    },
    /// No frame shows anything by which it could be aligned; all were taken as they lie.
    #[error(
        "{}: neither it nor the others show anything to align by ({reason}); all are merged as they lie, look at the result",
        reference.display()
    )]
    NothingToAlign {
        /// The reference.
        reference: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The exposures written in the files contradict the pixels; the step was estimated from the pixels.
    #[error(
        "the exposures in the files contradict the pixels ({detail}); estimated from the pixels instead, give -e to set them"
    )]
    ExposureContradicted {
        /// What was written and what was seen.
        detail: String,
    },
    /// The files do not say how they were exposed; the steps were estimated from the pixels.
    #[error("the exposures are estimated from the pixels ({detail}); give -e to set them")]
    ExposureEstimated {
        /// What is missing, and what was estimated.
        detail: String,
    },
    /// The pixels contradict the exposures that the user gave; these were used.
    #[error("the exposures given by -e contradict the pixels ({detail}); give them in the order of the files")]
    ExposureDoubtful {
        /// What was given and what was seen.
        detail: String,
    },
    /// The pixels want more of a correction than a frame's exposure may be given.
    #[error(
        "{}: the pixels say that its exposure is off by {wanted_stops:+.2} stops; corrected by {used_stops:+.2}, give -e to set it",
        path.display()
    )]
    ExposureBounded {
        /// The frame.
        path: PathBuf,
        /// What fits best, in stops.
        wanted_stops: f64,
        /// What was done, in stops.
        used_stops: f64,
    },
    /// A part of the exposure is missing in this file and was assumed equal in all.
    #[error("{}: {detail}", path.display())]
    ExposureIncomplete {
        /// The frame.
        path: PathBuf,
        /// Which tag is missing, and what was assumed.
        detail: String,
    },
    /// The response could not be recovered from this bracket; a stated curve was used.
    #[error("the camera's response could not be recovered ({reason}); {used} is used instead")]
    ResponseFallback {
        /// Why.
        reason: String,
        /// The curve that took its place.
        used: String,
    },
    /// One channel of the response could not be recovered; it has the mean curve of the others.
    #[error(
        "the camera's response in {channel} could not be recovered ({reason}); it is taken to be that of the other channels"
    )]
    ResponseBorrowed {
        /// `red`, `green` or `blue`.
        channel: &'static str,
        /// Why.
        reason: String,
    },
    /// The response file is of another camera than the photographs, or they contradict it.
    #[error("{}: {detail}; recover that of the photographs by `hdralign response`, or leave --response out", path.display())]
    ResponseDoubtful {
        /// The response file.
        path: PathBuf,
        /// Why it may be another's.
        detail: String,
    },
    /// Brackets of two cameras were given as one's.
    #[error("{}: was taken by {found}, others by {kept}; one curve is made of both", path.display())]
    CamerasDiffer {
        /// The reference of the bracket.
        path: PathBuf,
        /// Its camera.
        found: String,
        /// The camera of the first bracket.
        kept: String,
    },
    /// A bracket could not be used, and what all brackets of a camera tell was had of the others.
    #[error("{}: its bracket is left out of the response: {reason}", path.display())]
    BracketLeftOut {
        /// The first photograph of the bracket.
        path: PathBuf,
        /// The error.
        reason: String,
    },
    /// Frames carry different colour profiles; that of the reference was kept.
    #[error("{}: its colour profile ({found}) differs from that of the reference ({kept}); it is merged as if it were the same", path.display())]
    ProfilesDiffer {
        /// The frame.
        path: PathBuf,
        /// Its profile.
        found: String,
        /// The reference's profile.
        kept: String,
    },
    /// A part of the file could not be understood, without harm to the pixels.
    #[error("{}: {detail}", path.display())]
    Metadata {
        /// The frame.
        path: PathBuf,
        /// What was ignored.
        detail: String,
    },
    /// What is taken off the radiance is not taken off the frames that are fused.
    #[error("{option} acts on the radiance; the picture by `mertens` is of the frames as they are")]
    FusedAsIs {
        /// What was asked for.
        option: &'static str,
    },
    /// Colours were outside of the colour space asked for.
    #[error("{detail}")]
    OutOfGamut {
        /// How many pixels, and what became of them.
        detail: String,
    },
    /// Values were outside what the output format can hold.
    #[error("{}: {detail}", path.display())]
    OutOfRange {
        /// The output.
        path: PathBuf,
        /// How many values, and what became of them.
        detail: String,
    },
}

impl Warning {
    /// Whether the result is less than what was asked for: a frame left out or doubtful, an exposure guessed, a curve assumed.
    pub fn degrades(&self) -> bool {
        matches!(
            self,
            Warning::FrameRejected { .. }
                | Warning::SamePixels { .. }
                | Warning::NothingToAlign { .. }
                | Warning::LowConfidence { .. }
                | Warning::ExposureContradicted { .. }
                | Warning::ExposureEstimated { .. }
                | Warning::ExposureDoubtful { .. }
                | Warning::ExposureBounded { .. }
                | Warning::ExposureIncomplete { .. }
                | Warning::ResponseFallback { .. }
                | Warning::ResponseBorrowed { .. }
                | Warning::ResponseDoubtful { .. }
                | Warning::CamerasDiffer { .. }
                | Warning::BracketLeftOut { .. }
        )
    }
}
