//! Options of a run that are recorded in its report: options for alignment, merging and the picture, but not options
//! that select frames or control the encoding of files.
//!
//! In: the options of a run. Out: values as they are typed on the command line, including defaults. Cost: negligible.

use crate::align::{AlignMode, Local, RobustMethod};
use crate::bracket::colour::Space;
use crate::merge::weight::Weight;
use crate::response::ratios::Exposures;
use crate::tonemap::display::codes::Colours;
use crate::tonemap::{Rendering, adjust};
use serde::Serialize;

/// The options of a run; `exposures` and all later fields are null if the frames were only aligned.
#[doc(hidden)]
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OptionsReport {
    /// Alignment methods.
    pub align: AlignMode,
    /// Whether the lens, the shutter, and depth are followed where one homography does not suffice.
    pub local: Local,
    /// Robust estimator for feature matches.
    pub robust: RobustMethod,
    /// Largest rotation that is searched with bitmaps, in degrees, in both directions.
    pub max_rotation_deg: f64,
    /// Requested part of the reference frame: `common`, `none`, or `X,Y,WIDTH,HEIGHT` in pixels of the reference.
    pub crop: String,
    /// Exposure correction.
    pub exposures: Option<Exposures>,
    /// Method used to recover the camera response: `debevec`, `robertson`, `mitsunaga-nayar`, `linear`, `srgb`; null
    /// if a file was given.
    pub response_model: Option<&'static str>,
    /// The response file, as the user named it.
    pub response_file: Option<String>,
    /// Weighting function.
    pub weight: Option<Weight>,
    /// Strength of deghosting, 0..=1; null without deghosting.
    pub deghost_strength: Option<f64>,
    /// Whether lens flare is subtracted.
    pub flare: Option<bool>,
    /// Requested colour space; null for the colour space of the photographs.
    pub colour: Option<Space>,
    /// The tone mapping operator by name, with its parameters; null parameters are computed from the picture.
    pub operator: Option<Rendering>,
    /// Adjustments of the picture: white balance as the user typed it, brightness, contrast, saturation, shadows and
    /// highlights.
    pub adjust: Option<adjust::Options>,
    /// Bits per channel of the picture: 8 or 16.
    pub bit_depth: Option<u8>,
    /// Colour space of the picture.
    pub picture_colour: Option<Colours>,
    /// The size of the picture: pixels of its longest side, or a percentage; null for the size of the radiance map.
    pub resize: Option<String>,
}
