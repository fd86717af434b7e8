//! Mertens: the picture straight from the aligned frames, by [exposure fusion](super::fusion). No radiance, no response.
//!
//! In: what may be set. Out: the exponents of the measures. Cost: none. Source: Mertens, Kautz, Van Reeth, "Exposure Fusion" (2007), section 3.1.

use super::fusion::Exponents;
use super::settings::Setting;

/// What may be set: the exponents of the three measures, by which each counts.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[serde(tag = "name", rename = "mertens")]
pub struct Options {
    /// Of contrast: 0 leaves it out.
    pub contrast: f64,
    /// Of saturation.
    pub saturation: f64,
    /// Of being well exposed.
    pub exposedness: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { contrast: 1.0, saturation: 1.0, exposedness: 1.0 }
    }
}

impl Options {
    /// What may be set, by name.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::number("contrast", (0.0, 4.0), &mut self.contrast, "how much contrast counts; 0 not at all"),
            Setting::number("saturation", (0.0, 4.0), &mut self.saturation, "how much colourfulness counts"),
            Setting::number("exposedness", (0.0, 4.0), &mut self.exposedness, "how much it counts to be well exposed"),
        ]
    }

    /// The exponents of the measures.
    pub fn exponents(&self) -> Exponents {
        Exponents { contrast: self.contrast, saturation: self.saturation, exposedness: self.exposedness }
    }
}
