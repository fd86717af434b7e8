//! Exposure: how much light a frame was given, and where that is known from.
//!
//! In: EXIF, or the user's `-e` list. Out: an [`Exposure`] per frame, and the relative exposure t * ISO / N^2 by which radiance is
//! divided out of the response. Source: EXIF 2.32, section 4.6.5 (tags and their APEX counterparts); ISO 2720 for the relation.

use serde::Serialize;

/// Where a frame's exposure was had from: the one that won.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExposureSource {
    /// EXIF tags of the file.
    Exif,
    /// The `-e` list of the user.
    Given,
    /// Estimated from the pixels, because the file says nothing or contradicts them.
    Estimated,
}

/// How a frame was exposed.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    /// Shutter time in seconds, if known.
    pub time_s: Option<f64>,
    /// The f-number, if known.
    pub f_number: Option<f64>,
    /// Sensitivity, if known.
    pub iso: Option<f64>,
    relative: f64,
    /// Where the relative exposure is from.
    pub source: ExposureSource,
    /// The tags that won, for the report: `ExposureTime, FNumber, ISOSpeedRatings`, or `-e`.
    pub tags: String,
}
impl Exposure {
    /// An exposure of which only its relative value is known, as the user's `-e` list gives it; positive and finite.
    pub fn given(relative: f64) -> Self {
        Exposure {
            time_s: None,
            f_number: None,
            iso: None,
            relative,
            source: ExposureSource::Given,
            tags: "-e".to_owned(),
        }
    }

    /// The relative exposure t * ISO / N^2 (s), or 2^EV where EV was given; positive and finite.
    pub fn relative(&self) -> f64 {
        self.relative
    }
}
