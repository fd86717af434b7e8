//! DNG: linear radiance for raw developers.
//!
//! In: radiance by rows. Out: a DNG with linear RGB ("LinearRaw") in strips of 64 rows, and a JPEG preview. Cost: that
//! of a TIFF with half floats. Source: Adobe, "Digital Negative Specification", version 1.6.0.0 (2021), in this module
//! called DNG.
//!
//! The largest value of the radiance becomes 1, the white level, because some developers scale floats by their largest
//! value otherwise. BaselineExposure says by how many stops developers must brighten that, so that the picture is as
//! bright as the photographs.
//!
//! The colours are those of the radiance: ColorMatrix1 maps XYZ to its primaries, and AsShotNeutral is 1, 1, 1.

mod preview;
mod tags;
mod writer;

use crate::bracket::colour::Primaries;
use crate::merge::FLOOR;
use crate::merge::radiance::photographed::Photographed;
use crate::plane::Plane;
use crate::simd::{at_least, log2};
use rayon::prelude::*;
pub(crate) use writer::Writer;

/// Pixel encoding of a DNG.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Encoding {
    /// 16-bit floats, deflated: 14 stops below the brightest pixel with a precision of 0.05 %, 24 in all.
    #[default]
    Half,
    /// 32-bit floats, deflated: exactly as merged, apart from the scale.
    Float,
    /// 16-bit integers, not compressed: larger files with fewer stops, for programs that read no floats
    /// (dcraw, RawTherapee).
    Integer,
}

/// The brightness of a DNG.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Brightness {
    /// The value that becomes the white level.
    most: f32,
    /// The logarithm to base 2 of the mean luminance of dark and bright parts.
    mean_stops: f64,
}

/// Share of white that the middle of a picture has.
const MIDDLE: f64 = 0.18;

impl Default for Brightness {
    fn default() -> Self {
        Brightness { most: 1.0, mean_stops: libm::log2(MIDDLE) }
    }
}

/// Finds the [`Brightness`] of radiance.
#[derive(Debug)]
pub(super) struct Survey {
    weights: [f32; 3],
    most: f32,
    /// Sum of the logarithms to base 2 of the luminance, and number of pixels.
    sum: (f64, usize),
}

impl Survey {
    pub(super) fn new(primaries: &Primaries) -> Self {
        Survey { weights: primaries.luminance().map(|w| w as f32), most: 0.0, sum: (0.0, 0) }
    }

    /// Adds rows. The sums are those of rows, so that they do not depend on how rows are divided.
    pub(super) fn see(&mut self, pixels: &Plane<[f32; 3]>) {
        let weights = self.weights;
        let of_row = |y: usize| {
            let luminance = |p: &[f32; 3]| weights[0] * p[0] + weights[1] * p[1] + weights[2] * p[2];
            let stops = |p: &[f32; 3]| f64::from(log2(at_least(luminance(p), FLOOR)));
            let row = pixels.row(y);
            (row.iter().flatten().fold(0.0, |most, &v| at_least(v, most)), row.iter().map(stops).sum::<f64>())
        };
        let rows: Vec<(f32, f64)> = (0..pixels.height()).into_par_iter().map(of_row).collect();
        for (most, sum) in rows {
            (self.most, self.sum.0) = (at_least(most, self.most), self.sum.0 + sum);
        }
        self.sum.1 += pixels.width() * pixels.height();
    }

    pub(super) fn brightness(&self) -> Brightness {
        if self.most > 0.0 && self.most.is_finite() && self.sum.0.is_finite() {
            Brightness { most: self.most, mean_stops: self.sum.0 / self.sum.1 as f64 }
        } else {
            Brightness::default()
        }
    }
}

impl Brightness {
    /// How many stops brighter than the white level white is shown: as the photographs between the longest and the
    /// shortest show it; without photographs, so that the mean is shown as the middle.
    fn baseline(&self, photographed: Option<Photographed>) -> f64 {
        let white = match photographed {
            Some(p) => 0.5 * (libm::log2(p.longest) + libm::log2(p.shortest)) + p.white_stops,
            None => self.mean_stops - libm::log2(MIDDLE),
        };
        let stops = libm::log2(f64::from(self.most)) - white;
        // DNG has no limits; beyond these, the headers were not written by this program.
        if stops.is_finite() { stops.clamp(-30.0, 30.0) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests;
