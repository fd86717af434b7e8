//! Metadata for the headers of all formats.
//!
//! In: the reference frame, or the headers of a radiance map. Out: [`Metadata`], and text that is safe in a header.
//! Cost: negligible.

use crate::bracket::colour::{Primaries, Profile};
use crate::bracket::{Capture, Frame};
use crate::merge::radiance::calibration::Factor;

/// Metadata for headers. It does not contain the time of writing.
#[derive(Debug, Clone, PartialEq)]
pub struct Metadata {
    /// The program and its version: `hdralign 0.1.0`.
    pub software: String,
    /// Capture data of the reference frame, such as camera and date.
    pub capture: Capture,
    /// Shutter time of the reference in seconds.
    pub time_s: Option<f64>,
    /// The f-number of the reference.
    pub f_number: Option<f64>,
    /// The sensitivity of the reference.
    pub iso: Option<f64>,
    /// The primaries and the white point of the pixels.
    pub primaries: Primaries,
    /// The pixel values divided by this factor are radiance. The factor is 1 for radiance from the merge.
    pub exposure_scale: Factor,
    /// The luminance of radiance (1, 1, 1) in cd/m2, before multiplication by [`exposure_scale`](Self::exposure_scale);
    /// `None` if radiance is not calibrated.
    pub cd_m2_per_unit: Option<Factor>,
    /// The ICC profile of display-encoded pixels (8- and 16-bit TIFF, PNG, JPEG); `None` means sRGB. Radiance formats
    /// record the `primaries` instead.
    pub profile: Option<Profile>,
    /// Additional comment lines for the header.
    pub comments: Vec<String>,
}

impl Default for Metadata {
    fn default() -> Self {
        Metadata {
            software: concat!("hdralign ", env!("CARGO_PKG_VERSION")).into(),
            capture: Capture::default(),
            time_s: None,
            f_number: None,
            iso: None,
            primaries: Primaries::SRGB,
            exposure_scale: Factor::ONE,
            cd_m2_per_unit: None,
            profile: None,
            comments: Vec::new(),
        }
    }
}

impl Metadata {
    /// Returns the metadata of the reference frame, and defaults for the rest.
    pub fn of(reference: &Frame) -> Self {
        Metadata {
            capture: reference.capture.clone(),
            time_s: reference.exposure.time_s,
            f_number: reference.exposure.f_number,
            iso: reference.exposure.iso,
            profile: reference.profile.clone(),
            ..Metadata::default()
        }
    }

    /// Returns the name of the camera on one line, or `None` if it is unknown.
    pub(super) fn camera(&self) -> Option<String> {
        self.capture.camera().map(|name| one_line(&name)).filter(|name| !name.is_empty())
    }

    /// Returns the luminance of a stored pixel (1, 1, 1) in cd/m2, if it is known.
    pub(super) fn white_luminance(&self) -> Option<f64> {
        Some(self.cd_m2_per_unit?.over(self.exposure_scale)?.get())
    }
}

/// Returns `text` as printable ASCII on one line: the name of a camera must not be able to add a line to a header,
/// and readers expect ASCII.
pub(super) fn one_line(text: &str) -> String {
    let ascii: String = text
        .trim_matches(['\0', ' '])
        .chars()
        .map(|c| match c {
            ' '..='~' => c,
            _ if c.is_whitespace() || c.is_control() => ' ',
            _ => '?',
        })
        .collect();
    ascii.trim().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_is_one_line_of_ascii() {
        let camera = |make: &str, model: &str| {
            let capture = Capture { make: Some(make.into()), model: Some(model.into()), ..Capture::default() };
            Metadata { capture, ..Metadata::default() }.camera()
        };
        assert_eq!(camera("FUJI\nEXPOSURE=9", "X\u{e9}").unwrap(), "FUJI EXPOSURE=9 X?");
        assert_eq!(camera("\n", "\t"), None);
    }
}
