//! TIFF: RGB of 8 or 16 bits (pictures, aligned frames) or 32-bit floats (radiance), in strips of 64 rows that are
//! compressed losslessly with deflate.
//!
//! In: pixels by rows. Out: a little-endian TIFF, or BigTIFF if the file might exceed 4 GB; the directory comes last.
//! The primaries of radiance are in the tags of TIFF 6.0, section 20, or, if a coordinate is negative, in an ICC
//! profile. If radiance is calibrated, the tag StoNits contains the luminance of the value 1. Cost: about 12 ns per
//! byte and core. Source: TIFF 6.0, sections 2 (structure), 14 (differencing), 19 (sample format); Adobe Photoshop
//! TIFF Technical Notes (deflate, compression 8) and Technical Note 3 (floating-point predictor); BigTIFF (Aware
//! Systems); ICC.1:2010, B.4 (tag 34675).
//!
//! The `tiff` crate's encoder writes the byte order of the machine and compresses strip after strip on one thread, so
//! this module writes the structure of the file itself; the tests read it with the decoder of that crate.

pub(super) mod directory;
mod displacement;
pub(crate) mod logluv;
mod sample;
pub(super) mod strips;
mod writer;

use crate::pixel::logluv::Depth;

pub(crate) use sample::Half;
#[doc(hidden)]
pub use sample::Sample;
#[doc(hidden)]
pub use writer::Writer;

/// Pixel encoding of radiance in a TIFF.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Encoding {
    /// 32-bit floats: exactly as merged.
    #[default]
    Float,
    /// LogLuv, 24 bits: 16 stops in steps of 1.1 %. Smaller files, read by fewer programs.
    #[strum(serialize = "logluv24")]
    LogLuv24,
    /// LogLuv, 32 bits: 128 stops in steps of 0.27 %. Smaller files, read by fewer programs.
    #[strum(serialize = "logluv32")]
    LogLuv32,
}

impl Encoding {
    /// Returns the bits per pixel of LogLuv; `None` for floats.
    pub(crate) fn depth(self) -> Option<Depth> {
        match self {
            Encoding::Float => None,
            Encoding::LogLuv24 => Some(Depth::Bits24),
            Encoding::LogLuv32 => Some(Depth::Bits32),
        }
    }
}
