//! One picture by itself, of no bracket: to be looked at or compared, whatever its exposure.
//!
//! In: a JPEG, PNG or TIFF, known by its content. Out: its code values, what they mean, and what the camera noted. Cost: that of the decoder.

use super::colour::Profile;
use super::exposure::ExposureTags;
use super::load::{content, profile};
use super::{Capture, Samples, decode};
use crate::bracket::metadata::capture;
use crate::error::{Result, Warning};
use crate::limits::Limits;
use std::path::Path;

/// A picture as it is to be seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Photograph {
    /// Width in pixels, orientation applied.
    pub width: usize,
    /// Height in pixels, orientation applied.
    pub height: usize,
    /// Its code values, three to a pixel; grey is repeated, alpha left out.
    pub samples: Samples,
    /// Its colour profile; none is taken for sRGB.
    pub profile: Option<Profile>,
    /// Whether the file has alpha, which is left out of the samples.
    pub has_alpha: bool,
    /// What the camera noted.
    pub capture: Capture,
    /// Shutter time in seconds, if it is written.
    pub time_s: Option<f64>,
    /// The f-number, if it is written.
    pub f_number: Option<f64>,
    /// Sensitivity, if it is written.
    pub iso: Option<f64>,
}

impl Photograph {
    /// Reads the file `path`, which may ask for what `limits` allow, and gives what was ignored in it.
    ///
    /// # Errors
    /// [`Error::Read`](crate::error::Error::Read), [`Error::UnknownFormat`](crate::error::Error::UnknownFormat),
    /// [`Error::Decode`](crate::error::Error::Decode), [`Error::Changed`](crate::error::Error::Changed).
    pub fn read(path: &Path, limits: &Limits) -> Result<(Photograph, Vec<Warning>)> {
        let decoded = decode::decode(path, content(path, limits)?, limits)?;
        let mut notes = decoded.notes;
        let tags = decoded.exif.as_ref().map(ExposureTags::read).unwrap_or_default();
        let capture = decoded.exif.as_ref().map(|exif| capture::read(exif, false)).unwrap_or_default();
        let has_alpha = decoded.has_alpha;
        let profile = profile(decoded.icc, decoded.exif.as_ref(), &mut notes);
        let warnings = notes.into_iter().map(|detail| Warning::Metadata { path: path.into(), detail }).collect();
        let photograph = Photograph {
            width: decoded.width,
            height: decoded.height,
            samples: decoded.samples,
            profile,
            has_alpha,
            capture,
            time_s: tags.time_s.map(|t| t.0),
            f_number: tags.f_number.map(|n| n.0),
            iso: tags.iso.map(|s| s.0),
        };
        Ok((photograph, warnings))
    }
}
