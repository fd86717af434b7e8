//! What was asked for, beside what came of it: for who reads a report a year later.
//!
//! In: the options of a run. Out: values as they are typed on the command line, with those that were left as they are. Cost: none.

use crate::align::{AlignMode, RobustMethod};
use crate::bracket::colour::Space;
use crate::merge::weight::Weight;
use crate::response::ratios::Exposures;
use crate::tonemap::display::codes::Colours;
use crate::tonemap::{Rendering, adjust};
use serde::Serialize;

/// The options of a run; all from `exposures` on are none where frames were only aligned.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OptionsReport {
    /// Which methods sought the motion.
    pub align: AlignMode,
    /// The robust fit of features.
    pub robust: RobustMethod,
    /// The largest rotation that bitmaps were searched for, to either side.
    pub max_rotation_deg: f64,
    /// Which part of the reference was asked for: `common`, `none`, or `X,Y,WIDTH,HEIGHT` in its pixels.
    pub crop: String,
    /// What became of the exposures.
    pub exposures: Option<Exposures>,
    /// How the response was to be had: `debevec`, `robertson`, `mitsunaga-nayar`, `linear`, `srgb`; none where a file was given.
    pub response_model: Option<&'static str>,
    /// The response file, as it was named.
    pub response_file: Option<String>,
    /// How far codes were trusted.
    pub weight: Option<Weight>,
    /// 0..=1; none where what moved was not to be left out.
    pub deghost_strength: Option<f64>,
    /// Whether flare was sought.
    pub flare: Option<bool>,
    /// The colour space asked for; none for that of the photographs.
    pub colour: Option<Space>,
    /// The tone mapping, by name and with its parameters; those that are none are taken from the picture.
    pub operator: Option<Rendering>,
    /// What was changed of the picture: white balance, as typed, brightness, contrast, saturation, shadows and highlights.
    pub adjust: Option<adjust::Options>,
    /// Bits of a code of the picture: 8 or 16.
    pub bit_depth: Option<u8>,
    /// The colours of the picture.
    pub picture_colour: Option<Colours>,
    /// The size of the picture: pixels of its longest side, or a percentage; none for that of the radiance.
    pub resize: Option<String>,
}
