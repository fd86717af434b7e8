//! Units: from radiance relative to the reference's exposure to cd/m2.
//!
//! In: what the user knows of the camera, the reference frame and the response. Out: the luminance of radiance 1, or none where it stays
//! relative. Cost: one multiplication a value.
//! Source: the constant is that of Greg Ward's hdrgen, [`CAMERA_CONSTANT`]; ISO 12232:2019, section 6.2, derives 78 / 0.65 = 120 N^2 / (t
//! S) for saturation-based speeds, without the half stop that it leaves for highlights: 85.
//!
//! The top code of a frame with exposure time t in s, f-number N and sensitivity S, each the exact step that was rounded to what the
//! file says and fine-tuned as radiance is, stands for
//!
//! ```text
//! L = 87 N^2 / (t S)  cd/m2
//! ```
//!
//! and what lies below is told by the response. This is empirical: makers rate sensitivity and shape curves as they see fit, lenses lose
//! light, times are rounded; expect half a stop (a factor 0.7 to 1.4), and the same error for every picture of one camera, lens and
//! aperture. One reading of a luminance meter removes it: the factor is the luminance measured over the luminance reported.

use crate::bracket::Frame;
use crate::error::{Error, Result};
use crate::merge::RadianceMap;
use crate::plane::BAND_ROWS;
use crate::response::ResponseCurve;
use rayon::prelude::*;
use serde::Serialize;

/// The luminance of the top code times t S / N^2, in cd/m2 times s.
pub const CAMERA_CONSTANT: f64 = 87.0;

/// A factor on radiance or luminance: finite, above 0, and from 1e-20 to 1e20. From starlight to the sun it is 1e14; beyond, the floats
/// that it is multiplied with end.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factor(f64);

impl Factor {
    /// 1.
    pub const ONE: Factor = Factor(1.0);

    /// `value` as a factor; none where it is out of range or no number.
    pub fn new(value: f64) -> Option<Factor> {
        (1e-20..=1e20).contains(&value).then_some(Factor(value))
    }

    /// Its value.
    pub fn get(self) -> f64 {
        self.0
    }

    /// Both factors together; none where that is out of range.
    pub fn times(self, other: Factor) -> Option<Factor> {
        Factor::new(self.0 * other.0)
    }

    /// This factor without the other; none where that is out of range.
    pub fn over(self, other: Factor) -> Option<Factor> {
        Factor::new(self.0 / other.0)
    }
}

/// What the values of a radiance map are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub enum Unit {
    /// Relative: 1 is what gave the reference its middle code (128 of 255).
    #[default]
    #[serde(rename = "relative")]
    Relative,
    /// Luminance, weighted from red, green and blue, is in cd/m2.
    #[serde(rename = "cd/m2")]
    CdM2,
}

/// What turns relative radiance into cd/m2. By default nothing does.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Calibration {
    /// Whether the camera's exposure time, f-number and sensitivity tell the luminance, by [`CAMERA_CONSTANT`].
    pub camera: bool,
    /// A [`Factor`] on the result. With [`camera`](Self::camera) its correction, near 1 (measured over reported); by
    /// itself the luminance of radiance 1 in cd/m2.
    pub factor: Option<f64>,
}

/// How radiance was calibrated.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CalibrationReport {
    /// The luminance that 87 N^2 / (t S) gives for the reference's top code; null where the camera was not asked.
    pub camera_top_code_cd_m2: Option<f64>,
    /// The user's factor, 1 where none was given.
    pub factor: f64,
    /// By what relative radiance was multiplied: the luminance of 1, in cd/m2.
    pub cd_m2_per_unit: f64,
}

impl Calibration {
    /// Whether the factor is one.
    ///
    /// # Errors
    /// [`Error::Option`].
    pub fn validate(&self) -> Result<()> {
        match self.factor {
            Some(factor) if Factor::new(factor).is_none() => Err(Error::Option {
                option: "--calibration-factor",
                reason: format!(
                    "{factor} is no factor; give a number above 0, from 1e-20 to 1e20: luminance measured over luminance reported"
                ),
            }),
            _ => Ok(()),
        }
    }

    /// Whether the camera tells what is asked of it: `reference` is the frame that [`settle`](Self::settle) will be given.
    ///
    /// # Errors
    /// As there.
    pub fn check(&self, reference: &Frame) -> Result<()> {
        self.validate()?;
        if self.camera { top_code_luminance(reference).map(|_| ()) } else { Ok(()) }
    }

    /// Whether radiance is to be in cd/m2.
    pub fn is_asked(&self) -> bool {
        self.camera || self.factor.is_some()
    }

    /// The luminance of radiance 1; none where radiance stays relative.
    ///
    /// # Errors
    /// [`Error::Option`] where the camera is asked but the reference does not say its time, f-number and sensitivity, or where the factor
    /// is none.
    pub fn settle(&self, reference: &Frame, curve: &ResponseCurve) -> Result<Option<CalibrationReport>> {
        self.validate()?;
        let factor = self.factor.unwrap_or(1.0);
        if !self.camera {
            let report = CalibrationReport { camera_top_code_cd_m2: None, factor, cd_m2_per_unit: factor };
            return Ok(self.factor.map(|_| report));
        }
        let top_code = top_code_luminance(reference)?;
        // The reference's own exposure is the unit of exposure.
        let weights = reference.primaries().luminance();
        let top: f64 = (0..3).map(|c| weights[c] * f64::from(curve.exposure(c, 255.0))).sum();
        let cd_m2_per_unit = factor * top_code / top;
        Ok(Some(CalibrationReport { camera_top_code_cd_m2: Some(top_code), factor, cd_m2_per_unit }))
    }
}

/// 87 N^2 / (t S) of `frame`, by the [relative exposure](crate::bracket::exposure::Exposure::relative) that radiance is relative to:
/// exact steps and fine-tuning included, so that luminance does not depend on which frame is the reference.
fn top_code_luminance(frame: &Frame) -> Result<f64> {
    let exposure = &frame.exposure;
    let known = [("exposure time", exposure.time_s), ("f-number", exposure.f_number), ("ISO", exposure.iso)];
    let missing: Vec<&str> = known.into_iter().filter(|(_, v)| v.is_none()).map(|(name, _)| name).collect();
    if missing.is_empty() {
        return Ok(CAMERA_CONSTANT / exposure.relative());
    }
    Err(Error::Option {
        option: "--absolute",
        reason: format!(
            "{} does not say its {}; measure one luminance and give --calibration-factor alone, in cd/m2 per unit of radiance",
            frame.path().display(),
            missing.join(" and ")
        ),
    })
}

/// Multiplies `map` by `factor`, into cd/m2 or another unit; what a float does not hold becomes the nearest that it does.
pub fn calibrate(map: &mut RadianceMap, factor: f64) {
    let band = (BAND_ROWS * map.pixels.width()).max(1);
    let scaled = |v: f32| ((f64::from(v) * factor) as f32).clamp(f32::MIN_POSITIVE, f32::MAX);
    map.pixels.as_mut_slice().par_chunks_mut(band).for_each(|pixels| {
        for pixel in pixels {
            *pixel = pixel.map(scaled);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Samples;
    use crate::bracket::colour::Primaries;
    use crate::bracket::exposure::Exposure;
    use crate::plane::Plane;

    fn frame(time_s: Option<f64>, f_number: Option<f64>, iso: Option<f64>) -> Frame {
        let noted = time_s.and_then(|time| Exposure::from_camera(time, f_number, iso, String::new()));
        let exposure = noted.or(Exposure::given(0.0)).unwrap();
        Frame::new("a.jpg".into(), 1, 1, Samples::Eight(vec![0; 3]), exposure)
    }

    /// A linear response has its top code at 255 / 128 of the middle one.
    #[test]
    fn the_top_code_is_87_by_the_exposure() {
        let camera = Calibration { camera: true, factor: None };
        let of = |c: &Calibration, f: &Frame| c.settle(f, &ResponseCurve::linear());
        let report = of(&camera, &frame(Some(0.125), Some(8.0), Some(100.0))).unwrap().unwrap();
        assert!((report.camera_top_code_cd_m2.unwrap() / (87.0 * 64.0 / 12.5) - 1.0).abs() < 1e-12);
        assert!((report.cd_m2_per_unit - 87.0 * 64.0 / 12.5 * 128.0 / 255.0).abs() < 1e-4);
        let both = Calibration { factor: Some(1.25), ..camera };
        let corrected = of(&both, &frame(Some(0.125), Some(8.0), Some(100.0))).unwrap().unwrap();
        assert_eq!(corrected.cd_m2_per_unit, 1.25 * report.cd_m2_per_unit);
        let error = of(&camera, &frame(Some(0.1), None, None)).unwrap_err();
        assert!(error.is_usage() && error.to_string().contains("does not say its f-number and ISO"), "{error}");
        assert!(camera.check(&frame(Some(0.1), None, None)).is_err_and(|e| e.to_string() == error.to_string()));
        assert!(camera.check(&frame(Some(0.125), Some(8.0), Some(100.0))).is_ok());
        assert!(Calibration::default().check(&frame(None, None, None)).is_ok());
    }

    #[test]
    fn a_factor_alone_is_the_luminance_of_one() {
        let bare = frame(None, None, None);
        let curve = ResponseCurve::srgb();
        assert_eq!(Calibration::default().settle(&bare, &curve).unwrap(), None);
        let given = Calibration { camera: false, factor: Some(300.0) };
        assert_eq!(given.settle(&bare, &curve).unwrap().unwrap().cd_m2_per_unit, 300.0);
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e21, 1e-21, f64::MIN_POSITIVE] {
            assert!(Calibration { camera: false, factor: Some(wrong) }.settle(&bare, &curve).is_err());
        }
        let mut map = RadianceMap { pixels: Plane::filled(2, 1, [1e-12, 0.5, 1e37]), primaries: Primaries::SRGB };
        calibrate(&mut map, 300.0);
        assert_eq!(map.pixels.at(1, 0), [3e-10, 150.0, f32::MAX]);
    }
}
