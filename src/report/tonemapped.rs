//! The report of `tonemap`, for programs.
//!
//! In: a radiance map as it was read, and how it was processed. Out: JSON in a public format, with the version
//! [`SCHEMA`] and units in the keys. Cost: two or three passes over the pixels.

use super::{ColourReport, Times, WarningReport};
use crate::merge::radiance::calibration::{Factor, Unit};
use crate::merge::radiance::gamut::weights;
use crate::merge::radiance::statistics::Statistics;
use crate::merge::{FLOOR, RadianceMap};
use crate::plane::Plane;
use crate::tonemap::{Operator, adjust};
use crate::write::Metadata;
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// The version of the format. In one version keys may be added, but are never removed.
pub const SCHEMA: &str = "hdralign-tonemap/1";

/// The input, processing and outputs of a run of `tonemap`.
#[doc(hidden)]
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TonemapReport {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// The program and its version.
    pub software: &'static str,
    /// The radiance map, as the user named it.
    pub input: String,
    /// Width of the radiance map.
    pub width_px: usize,
    /// Height of the radiance map.
    pub height_px: usize,
    /// The tone mapping operator by name, with its parameters; null parameters are computed from the picture.
    pub operator: Operator,
    /// Adjustments of the picture, as the user typed them.
    pub adjust: adjust::Options,
    /// The light that the picture shows as white; null if this is unchanged from the radiance map.
    pub white_balance: Option<adjust::Light>,
    /// The primaries of the radiance.
    pub colour: ColourReport,
    /// The luminance of radiance 1 in cd/m2, if the file contains it (OpenEXR's whiteLuminance, TIFF's StoNits);
    /// otherwise null. It is also null for `.hdr` files: the format defines W/sr/m2, but most files have relative
    /// values.
    pub cd_m2_per_unit: Option<f64>,
    /// Statistics of the luminance of the map as it was read (and converted to the requested colour space), without
    /// black pixels.
    pub radiance: Statistics,
    /// Number of pixels with NaN; these pixels are shown as black.
    pub not_number_pixels: usize,
    /// Number of pixels with an infinite value.
    pub infinite_pixels: usize,
    /// Number of pixels with a negative value.
    pub negative_pixels: usize,
    /// The files written.
    pub outputs: Vec<String>,
    /// The warnings.
    pub warnings: Vec<WarningReport>,
    /// Wall time of the stages, in seconds.
    pub time_s: Times,
}

impl TonemapReport {
    /// Creates the report of `map`, whose values are positive and finite, as it was read from `input`; the caller
    /// sets the other fields.
    pub fn new(input: &Path, map: &RadianceMap, metadata: &Metadata) -> Self {
        let unit = if metadata.cd_m2_per_unit == Some(Factor::ONE) { Unit::CdM2 } else { Unit::Relative };
        TonemapReport {
            schema: SCHEMA,
            software: concat!("hdralign ", env!("CARGO_PKG_VERSION")),
            input: super::text(input),
            width_px: map.pixels.width(),
            height_px: map.pixels.height(),
            operator: Operator::default(),
            adjust: adjust::Options::default(),
            white_balance: None,
            colour: map.primaries.into(),
            cd_m2_per_unit: metadata.cd_m2_per_unit.map(Factor::get),
            radiance: measured(map, unit),
            not_number_pixels: 0,
            infinite_pixels: 0,
            negative_pixels: 0,
            outputs: Vec::new(),
            warnings: Vec::new(),
            time_s: Times::default(),
        }
    }

    /// Returns the report as JSON with a final line feed.
    pub fn to_json(&self) -> String {
        // The report contains only strings, numbers and lists of them, so the conversion cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

/// Returns the statistics of `map` without black pixels, which occur in files from other programs. Their zeros were
/// replaced by [`FLOOR`], which is not a radiance of the scene. If all pixels are black, they are included.
fn measured(map: &RadianceMap, unit: Unit) -> Statistics {
    let weights = weights(&map.primaries);
    let is_lit = |pixel: &&[f32; 3]| pixel.iter().any(|&v| v > FLOOR);
    let pixels = map.pixels.as_slice();
    let black = pixels.len() - pixels.par_iter().filter(is_lit).count();
    if black == 0 || black == pixels.len() {
        return Statistics::measured(&map.pixels, weights, unit);
    }
    let lit: Vec<[f32; 3]> = pixels.iter().filter(is_lit).copied().collect();
    Statistics::measured(&Plane::from_vec(1, lit.len(), lit), weights, unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;

    #[test]
    fn unit_is_cd_m2_only_for_a_factor_of_one() {
        let map = RadianceMap { pixels: Plane::filled(4, 2, [0.5; 3]), primaries: Primaries::BT2020 };
        let json = |luminance| -> serde_json::Value {
            let metadata = Metadata { cd_m2_per_unit: Option::and_then(luminance, Factor::new), ..Metadata::default() };
            serde_json::from_str(&TonemapReport::new(Path::new("a.exr"), &map, &metadata).to_json()).unwrap()
        };
        assert_eq!((&json(None)["radiance"]["unit"], &json(None)["cd_m2_per_unit"]), (&"relative".into(), &().into()));
        assert_eq!(json(Some(1.0))["radiance"]["unit"], "cd/m2");
        assert_eq!(
            (&json(Some(2.0))["radiance"]["unit"], &json(Some(2.0))["cd_m2_per_unit"]),
            (&"relative".into(), &2.0.into())
        );
        assert_eq!((&json(None)["colour"]["space"], &json(None)["width_px"]), (&"rec2020".into(), &4.into()));
    }

    #[test]
    fn black_pixels_are_not_in_the_statistics() {
        let report = |pixels: Vec<[f32; 3]>| {
            let map = RadianceMap { pixels: Plane::from_vec(pixels.len(), 1, pixels), primaries: Primaries::SRGB };
            TonemapReport::new(Path::new("a.tif"), &map, &Metadata::default()).radiance
        };
        let (lit, black) = ([[0.5; 3], [2.0, 2.0, FLOOR]], [FLOOR; 3]);
        assert_eq!(report(vec![lit[0], black, lit[1], black]), report(lit.to_vec()));
        assert!(report(lit.to_vec()).contrast < 4.0 && report(vec![black; 4]).contrast == 1.0);
    }
}
