//! Warnings about a result, as listed in the report.

use std::path::PathBuf;

/// A warning about a result.
///
/// The HTML report relies on the form of the text:
///
/// - If the text says what to do, this is its last part, after the last semicolon. In some warnings the last part says
///   what was done instead, as in [`ResponseFallback`](Self::ResponseFallback). The HTML report does not distinguish
///   them.
/// - Most measured values are in parentheses or follow a colon. Warnings that differ only in such values, and in the
///   frames that they begin with, are shown once. Warnings with another form are shown once for each different text,
///   as [`ExposureBounded`](Self::ExposureBounded) is.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Warning {
    /// A frame could not be aligned and is not merged.
    #[error(
        "{}: rejected: {reason}; if the camera did not move, give --unmoved {} (in a batch, use `hdralign merge` for this), or --align none for all frames",
        path.display(),
        path.file_name().unwrap_or_default().display()
    )]
    FrameRejected {
        /// The frame.
        path: PathBuf,
        /// Why it could not be aligned.
        reason: String,
    },
    /// A frame is too dark or too bright to be aligned; its transform is assumed from those of the other frames.
    #[error(
        "{}: too {} to be aligned ({reason}): its position is estimated from the other frames, probably to within {error_px:.1} px; the radiance uses it only where all frames with a known position are (nearly) {}; if it is misaligned there, exclude it with --leave-out (in a batch, use `hdralign merge` for this)",
        path.display(),
        if *is_dark { "dark" } else { "bright" },
        if *is_dark { "clipped" } else { "black" }
    )]
    FrameAssumed {
        /// The frame.
        path: PathBuf,
        /// Why the assumption is justified.
        reason: String,
        /// Error of the assumed transform that is not exceeded in 19 of 20 cases, in pixels.
        error_px: f64,
        /// Whether the frame is darker than the reference.
        is_dark: bool,
        /// Whether the camera did not move in any of the other frames.
        is_still: bool,
    },
    /// A frame was aligned with low confidence.
    #[error(
        "{}: aligned with low confidence ({confidence:.2}){}; check the result, or exclude this frame with --leave-out (in a batch, use `hdralign merge` for this)",
        path.display(), displaced_words(*displaced_fraction, *displaced_px)
    )]
    LowConfidence {
        /// The frame.
        path: PathBuf,
        /// The confidence, 0..1.
        confidence: f64,
        /// Share of the compared parts that are displaced, 0..1.
        displaced_fraction: f64,
        /// Median displacement of the displaced parts, in pixels.
        displaced_px: f64,
    },
    /// The largest rectangle that all merged frames cover is less than half of the reference.
    #[error(
        "{}: the largest rectangle that all frames cover is only {:.0} % of the reference (this frame alone covers a rectangle of {:.0} %); exclude this frame with --leave-out (in a batch, use `hdralign merge` for this), or keep the whole reference with --crop none (merge, align and batch)",
        path.display(),
        100.0 * common,
        100.0 * overlap
    )]
    SmallOverlap {
        /// The frame that covers the smallest rectangle of the reference.
        path: PathBuf,
        /// Area of the largest rectangle that this frame covers, as a fraction of the reference's area, 0..1.
        overlap: f64,
        /// Area of the largest rectangle that all merged frames cover, as a fraction of the reference's area, 0..1.
        common: f64,
    },
    /// Two frames have the same pixels.
    #[error("{}: has the same pixels as {} and adds nothing; leave one of them out", path.display(), other.display())]
    SamePixels {
        /// The frame whose path sorts later.
        path: PathBuf,
        /// The frame whose path sorts earlier.
        other: PathBuf,
    },
    /// No frame has enough detail to be aligned; all are merged without alignment.
    #[error(
        "{}: no frame has enough detail to be aligned ({reason}): all are merged without alignment; check the result",
        reference.display()
    )]
    NothingToAlign {
        /// The reference.
        reference: PathBuf,
        /// Why the frames cannot be aligned.
        reason: String,
    },
    /// Exposures in the EXIF data contradict the pixels; some or all were replaced by estimates.
    #[error(
        "exposures in the EXIF data contradict the pixels ({detail}), so some or all are estimated from the pixels instead; give -e to set them"
    )]
    ExposureContradicted {
        /// The exposures of the files and the estimates.
        detail: String,
    },
    /// Some or all files have no usable exposure; the missing exposures were estimated from the pixels.
    #[error("missing exposures are estimated from the pixels ({detail}); give -e to set them")]
    ExposureEstimated {
        /// What is missing, and what was estimated.
        detail: String,
    },
    /// The flash fired in some frames only, so the illumination differs.
    #[error(
        "{}: the flash fired, unlike in other frames; {}",
        path.display(),
        if *is_used { "it is merged anyway, check the result" } else { "it is excluded; to use it anyway, give -e with the exposures of all frames, or make it the reference with --reference" }
    )]
    FlashFired {
        /// The frame.
        path: PathBuf,
        /// Whether it is used: too few frames would remain, or the user chose it as reference or set its transform.
        is_used: bool,
    },
    /// The exposures given by the user contradict the pixels; they are used anyway.
    #[error(
        "the exposures given by -e contradict the pixels ({detail}) and are used anyway; give them in the order of the files"
    )]
    ExposureDoubtful {
        /// The given exposures and the estimates.
        detail: String,
    },
    /// The pixels require a larger correction of the exposure of a frame than the largest that is applied.
    #[error(
        "{}: according to the pixels, the exposure should be corrected by {wanted_stops:+.2} stops; it was corrected by only {used_stops:+.2} stops, which is the limit; to set the exposures, give -e",
        path.display()
    )]
    ExposureBounded {
        /// The frame.
        path: PathBuf,
        /// The correction that fits the pixels best, in stops.
        wanted_stops: f64,
        /// The correction used, in stops.
        used_stops: f64,
    },
    /// A part of the exposure, such as the ISO, is missing in a file; the value of the other files was assumed.
    #[error("{}: {detail}", path.display())]
    ExposureIncomplete {
        /// The frame.
        path: PathBuf,
        /// The missing tag, and the assumption.
        detail: String,
    },
    /// The response could not be recovered from the bracket; another curve is used.
    #[error("the camera's response could not be recovered ({reason}); {used} is used instead")]
    ResponseFallback {
        /// Why the response could not be recovered.
        reason: String,
        /// The curve that is used.
        used: String,
    },
    /// The response of one channel could not be recovered; the mean of the recovered channels is used.
    #[error(
        "the camera's response in {channel} could not be recovered ({reason}); the mean of the recovered channels is used instead"
    )]
    ResponseBorrowed {
        /// `red`, `green` or `blue`.
        channel: &'static str,
        /// Why the response of the channel could not be recovered.
        reason: String,
    },
    /// The camera tone-mapped the frames locally, so their values depend on more than the exposure.
    #[error(
        "{}: locally processed by the camera, which brightened or darkened parts of the picture; the radiance is \
         corrected for this, but it is only approximate; to merge without this correction, give --response-model srgb",
        named(paths)
    )]
    LocallyProcessed {
        /// The frames.
        paths: Vec<PathBuf>,
    },
    /// The response file was made for a camera that did not take the photographs, or does not fit the photographs.
    #[error("{}: {detail}", path.display())]
    ResponseDoubtful {
        /// The response file.
        path: PathBuf,
        /// Why the response may not be valid for the photographs, and what to do.
        detail: String,
    },
    /// Brackets for which one response is recovered are from different cameras.
    #[error("{}: was taken with {found}, other brackets with {kept}, and one curve is fitted to both; give brackets of one camera", path.display())]
    CamerasDiffer {
        /// The reference frame of the bracket.
        path: PathBuf,
        /// The camera of the bracket.
        found: String,
        /// The camera of the first bracket.
        kept: String,
    },
    /// One response is recovered from several brackets, and one of these brackets could not be used.
    #[error("{}: its bracket is not used for the response: {reason}", path.display())]
    BracketLeftOut {
        /// The first photograph of the bracket.
        path: PathBuf,
        /// Text of the error of this bracket.
        reason: String,
    },
    /// The colour profile of a frame differs from the profile of the reference. The profile of the reference is used.
    #[error("{}: its colour profile ({found}) differs from that of the reference ({kept}) and is ignored; convert all frames to the same profile", path.display())]
    ProfilesDiffer {
        /// The frame.
        path: PathBuf,
        /// The profile of the frame.
        found: String,
        /// The profile of the reference.
        kept: String,
    },
    /// Shots were given as camera raw files and as other files; the raw files are used.
    #[error("{}: not used{}, because the camera raw file of the same shot was given too ({})",
        path.display(),
        if *count > 1 { format!(", like {} other file{}", count - 1, if *count > 2 { "s" } else { "" }) } else { String::new() },
        raw.display()
    )]
    RawPreferred {
        /// The first file that is not used.
        path: PathBuf,
        /// The raw file of the same shot.
        raw: PathBuf,
        /// The number of files that are not used.
        count: usize,
    },
    /// A part of a file was not read, was assumed, or was changed, such as metadata or pixels that are not numbers.
    #[error("{}: {detail}", path.display())]
    Metadata {
        /// The file.
        path: PathBuf,
        /// What was found, and what was done.
        detail: String,
    },
    /// The user gave an option that acts on radiance only, and frames are fused without radiance.
    #[error("{option} acts on the radiance only, not on the picture by `mertens`; choose another --tmo to apply it")]
    FusedAsIs {
        /// The option.
        option: &'static str,
    },
    /// Colours were outside the requested colour space.
    #[error("{detail}")]
    OutOfGamut {
        /// The number of pixels outside the colour space, and how they were changed.
        detail: String,
    },
    /// The requested size of the picture is larger than the size of the radiance map.
    #[error("the picture has {longest_px} pixels on its longest side and is not enlarged to {asked_px}")]
    NotEnlarged {
        /// Longest side of the picture, in pixels.
        longest_px: usize,
        /// The requested longest side, in pixels.
        asked_px: usize,
    },
    /// The mean colour of the picture is not the colour of a light source, so the white balance was not changed.
    #[error(
        "--white-balance auto: the mean colour is not the colour of a light source, so the white balance is unchanged; give a temperature or a grey spot"
    )]
    NoWhite,
    /// Values were outside the range of the output format.
    #[error("{}: {detail}", path.display())]
    OutOfRange {
        /// The output.
        path: PathBuf,
        /// The number of values outside the range, and how they were changed.
        detail: String,
    },
}

/// Returns the paths separated by commas.
fn named(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// Smallest share of displaced parts that a warning about low confidence mentions.
const MENTIONED_FRACTION: f64 = 0.01;

/// Returns the share of displaced parts as text, and their displacement if it is not 0; empty if the share is less than
/// [`MENTIONED_FRACTION`].
fn displaced_words(fraction: f64, px: f64) -> String {
    if fraction < MENTIONED_FRACTION {
        return String::new();
    }
    let by = if px > 0.0 { format!(" by about {px:.0} px") } else { String::new() };
    format!(
        ": {:.0} % of the parts that could be compared are displaced{by}, perhaps because of parallax or movement",
        100.0 * fraction
    )
}

impl Warning {
    /// Returns whether the result is degraded: a frame, an exposure or the response may be wrong.
    pub fn degrades(&self) -> bool {
        !matches!(
            self,
            Warning::FrameAssumed { is_still: true, .. }
                | Warning::ProfilesDiffer { .. }
                | Warning::Metadata { .. }
                | Warning::RawPreferred { .. }
                | Warning::FusedAsIs { .. }
                | Warning::OutOfGamut { .. }
                | Warning::NotEnlarged { .. }
                | Warning::NoWhite
                | Warning::OutOfRange { .. }
        )
    }
}
