//! A single photograph outside a bracket, to be displayed or compared.
//!
//! In: a JPEG, PNG or TIFF, recognised by its content. Out: pixel values, colour profile and capture data. Cost: the
//! decoder.

use super::colour::Profile;
use super::exposure::ExposureTags;
use super::load::{content, profile};
use super::{Capture, Samples, decode};
use crate::bracket::metadata::capture;
use crate::error::{Result, Warning};
use crate::limits::Limits;
use std::path::Path;

/// A decoded photograph, orientation applied.
#[derive(Debug, Clone, PartialEq)]
pub struct Photograph {
    /// Width in pixels, orientation applied.
    pub width: usize,
    /// Height in pixels, orientation applied.
    pub height: usize,
    /// Pixel values, three per pixel; grey is repeated, alpha dropped.
    pub samples: Samples,
    /// Colour profile of the photograph; sRGB is assumed where there is none.
    pub profile: Option<Profile>,
    /// Whether the file has an alpha channel, which is dropped.
    pub has_alpha: bool,
    /// Capture data.
    pub capture: Capture,
    /// Exposure time in seconds, if known.
    pub time_s: Option<f64>,
    /// F-number, if known.
    pub f_number: Option<f64>,
    /// ISO sensitivity, if known.
    pub iso: Option<f64>,
}

impl Photograph {
    /// Reads the file `path` within `limits`. Returns warnings for metadata that was ignored.
    ///
    /// # Errors
    /// [`Error::Read`](crate::error::Error::Read), [`Error::UnknownFormat`](crate::error::Error::UnknownFormat),
    /// [`Error::Decode`](crate::error::Error::Decode), [`Error::Changed`](crate::error::Error::Changed).
    pub fn read(path: &Path, limits: &Limits) -> Result<(Photograph, Vec<Warning>)> {
        let decoded = decode::decode(path, content(path, limits)?, limits)?;
        let mut notes = decoded.notes;
        let tags = decoded.exif.as_ref().map(ExposureTags::read).unwrap_or_default();
        let capture = decoded.exif.as_ref().map(|exif| capture::read(exif, false)).unwrap_or_default();
        let profile = profile(decoded.icc, decoded.exif.as_ref(), &mut notes);
        let warnings = notes.into_iter().map(|detail| Warning::Metadata { path: path.into(), detail }).collect();
        let photograph = Photograph {
            width: decoded.width,
            height: decoded.height,
            samples: decoded.samples,
            profile,
            has_alpha: decoded.has_alpha,
            capture,
            time_s: tags.time_s.map(|t| t.0),
            f_number: tags.f_number.map(|n| n.0),
            iso: tags.iso.map(|s| s.0),
        };
        Ok((photograph, warnings))
    }
}
