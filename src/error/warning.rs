//! What a user should know about a result that was nevertheless made: it travels in the report.

use std::path::PathBuf;

/// What a user should know about a result that was nevertheless made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Warning {
    /// No model explains this frame's motion; it was left out.
    #[error(
        "{}: left out: {reason}; if the camera stood still, give --unmoved {}, or --align none for all",
        path.display(),
        path.file_name().unwrap_or_default().display()
    )]
    FrameRejected {
        /// The frame.
        path: PathBuf,
        /// Why it could not be placed.
        reason: String,
    },
    /// This frame is too dark or too bright to be aligned; its place is assumed from those of the others.
    #[error(
        "{}: too {} to be aligned ({reason}); it is merged as the others let expect, within {error_px:.1} px, and only where they {}; exclude it with --leave-out",
        path.display(),
        if *is_dark { "dark" } else { "bright" },
        if *is_dark { "clip" } else { "are black" }
    )]
    FrameAssumed {
        /// The frame.
        path: PathBuf,
        /// What its place is assumed from.
        reason: String,
        /// The error that 19 of 20 such places keep, in pixels.
        error_px: f64,
        /// Whether it is darker than the reference.
        is_dark: bool,
        /// Whether the camera stood still in all others, so that nothing else is to be expected of it.
        is_still: bool,
    },
    /// This frame was placed, but with little certainty.
    #[error("{}: aligned with low confidence ({confidence:.2}); look at the result, or leave it out", path.display())]
    LowConfidence {
        /// The frame.
        path: PathBuf,
        /// 0..1.
        confidence: f64,
    },
    /// Less than half of the reference is common to all frames.
    #[error(
        "{}: overlaps {:.0} % of the reference, all frames together {:.0} %; exclude it with --leave-out, or keep the whole reference with --crop none",
        path.display(),
        100.0 * overlap,
        100.0 * common
    )]
    SmallOverlap {
        /// The frame that overlaps the reference least.
        path: PathBuf,
        /// The share of the reference that this frame covers by its largest rectangle, 0..1.
        overlap: f64,
        /// The share that all frames cover together, 0..1.
        common: f64,
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
    /// The flash fired in some frames and not in others: their light is not the same.
    #[error(
        "{}: the flash fired, unlike in the other frames; {}",
        path.display(),
        if *is_used { "it is merged all the same, look at the result" } else { "it is excluded; to use it give -e, or name it by --reference or --unmoved" }
    )]
    FlashFired {
        /// The frame.
        path: PathBuf,
        /// Whether it is used: too few were left without it, it is the reference of the user's choice, or the user says where it lies.
        is_used: bool,
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
    /// The camera tone-mapped the frames locally: they are not functions of exposure alone.
    #[error(
        "{}: locally processed by the camera, brightness does not follow the exposure; merged with a local gain, radiance is approximate; \
         to merge the frames as they are give --response-model srgb",
        named(paths)
    )]
    LocallyProcessed {
        /// The frames.
        paths: Vec<PathBuf>,
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
    /// The picture was to be larger than the radiance is.
    #[error("the picture has {longest_px} pixels on its longest side; it is not enlarged to {asked_px}")]
    NotEnlarged {
        /// The longest side that it has, in pixels.
        longest_px: usize,
        /// The longest side that was asked for, in pixels.
        asked_px: usize,
    },
    /// The picture's own white was asked for, and is of no light's colour.
    #[error(
        "--white-balance auto: the picture has the colour of no light on average; white is left as it was; name a temperature, or a grey spot"
    )]
    NoWhite,
    /// Values were outside what the output format can hold.
    #[error("{}: {detail}", path.display())]
    OutOfRange {
        /// The output.
        path: PathBuf,
        /// How many values, and what became of them.
        detail: String,
    },
}

/// Names of files, one after the other.
fn named(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}

impl Warning {
    /// Whether the result is less than what was asked for: a frame left out, assumed or doubtful, an exposure guessed, a curve assumed.
    pub fn degrades(&self) -> bool {
        matches!(
            self,
            Warning::FrameAssumed { is_still: false, .. }
                | Warning::FrameRejected { .. }
                | Warning::SamePixels { .. }
                | Warning::NothingToAlign { .. }
                | Warning::LowConfidence { .. }
                | Warning::SmallOverlap { .. }
                | Warning::ExposureContradicted { .. }
                | Warning::ExposureEstimated { .. }
                | Warning::ExposureDoubtful { .. }
                | Warning::FlashFired { .. }
                | Warning::ExposureBounded { .. }
                | Warning::ExposureIncomplete { .. }
                | Warning::ResponseFallback { .. }
                | Warning::ResponseBorrowed { .. }
                | Warning::LocallyProcessed { .. }
                | Warning::ResponseDoubtful { .. }
                | Warning::CamerasDiffer { .. }
                | Warning::BracketLeftOut { .. }
        )
    }
}
