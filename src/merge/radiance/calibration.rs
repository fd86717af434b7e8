//! Units: from radiance relative to the reference's exposure to cd/m2.
//!
//! In: a [`Calibration`], the reference frame and the response. Out: the luminance of radiance 1, or `None` if radiance
//! stays relative. Cost: one multiplication per value. Source: the constant is that of Greg Ward's hdrgen,
//! [`CAMERA_CONSTANT`]. For comparison, ISO 12232:2019, section 6.2, derives 120 N^2 / (t S) for saturation-based
//! speeds (120 is 78 / 0.65). The standard leaves half a stop for highlights; without this half stop, the constant is
//! 85 N^2 / (t S).
//!
//! The largest code value of a frame with exposure time t in s, f-number N and sensitivity S stands for the luminance L
//! below. If the values in EXIF are recognised as rounded, t, N and S are the exact steps of the camera instead. t S /
//! N^2 includes the exposure correction of the merge.
//!
//! ```text
//! L = 87 N^2 / (t S)  cd/m2
//! ```
//!
//! and lower code values follow from the response. This is empirical: manufacturers define sensitivity and curves
//! differently, lenses lose light, times are rounded. Expect an error of half a stop (a factor of 0.7 to 1.4), the same
//! for all pictures of one camera, lens and aperture. One reading of a luminance meter removes the error: the factor is
//! measured luminance divided by reported luminance.

use crate::bracket::Frame;
use crate::bracket::exposure::ExposureSource;
use crate::error::{Error, Result};
use crate::merge::RadianceMap;
use crate::plane::BAND_ROWS;
use crate::response::ResponseCurve;
use rayon::prelude::*;
use serde::Serialize;

/// Luminance of the largest code value times t S / N^2, in cd/m2 s.
pub const CAMERA_CONSTANT: f64 = 87.0;

/// A factor from 1e-20 to 1e20 by which radiance or luminance is multiplied. This range is sufficient: the sun is about
/// 1e14 times as bright as starlight. With larger factors, results may exceed the range of `f32`.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factor(f64);

impl Factor {
    /// 1.
    pub const ONE: Factor = Factor(1.0);

    /// Returns `value` as a factor, or `None` if it is out of range.
    pub fn new(value: f64) -> Option<Factor> {
        (1e-20..=1e20).contains(&value).then_some(Factor(value))
    }

    /// Returns the value of the factor.
    pub fn get(self) -> f64 {
        self.0
    }

    /// Returns the product of both factors, or `None` if it is out of range.
    pub fn times(self, other: Factor) -> Option<Factor> {
        Factor::new(self.0 * other.0)
    }

    /// Returns this factor divided by `other`, or `None` if the quotient is out of range.
    pub fn over(self, other: Factor) -> Option<Factor> {
        Factor::new(self.0 / other.0)
    }
}

/// The unit of radiance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub enum Unit {
    /// Relative: 1 gives the reference frame its middle code value (128 of 255).
    #[default]
    #[serde(rename = "relative")]
    Relative,
    /// Luminance, weighted from red, green and blue, is in cd/m2.
    #[serde(rename = "cd/m2")]
    CdM2,
}

/// Calibration of radiance to cd/m2. By default radiance stays relative.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Calibration {
    /// Whether to compute luminance from exposure time, f-number and sensitivity, by [`CAMERA_CONSTANT`].
    pub camera: bool,
    /// A [`Factor`] on the result. With [`camera`](Self::camera) it is a correction near 1: measured luminance divided
    /// by reported luminance. Without `camera` it is the luminance of radiance 1 in cd/m2.
    pub factor: Option<f64>,
}

/// The section of the report on calibration.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CalibrationReport {
    /// 87 N^2 / (t S) of the reference frame; null without `camera`.
    pub camera_top_code_cd_m2: Option<f64>,
    /// The factor given, or 1.
    pub factor: f64,
    /// The luminance of relative radiance 1, in cd/m2.
    pub cd_m2_per_unit: f64,
}

impl Calibration {
    /// Checks the factor.
    ///
    /// # Errors
    /// [`Error::Option`].
    pub fn validate(&self) -> Result<()> {
        match self.factor {
            Some(factor) if Factor::new(factor).is_none() => Err(Error::Option {
                option: "--calibration-factor",
                reason: format!(
                    "{factor} is not a valid factor; give a number from 1e-20 to 1e20: measured luminance divided by reported luminance"
                ),
            }),
            _ => Ok(()),
        }
    }

    /// Checks that the EXIF of the reference frame has what [`settle`](Self::settle) needs.
    ///
    /// # Errors
    /// As [`settle`](Self::settle).
    pub fn check(&self, reference: &Frame) -> Result<()> {
        self.validate()?;
        if self.camera { top_code_luminance(reference).map(|_| ()) } else { Ok(()) }
    }

    /// Whether radiance is converted to cd/m2.
    pub fn is_asked(&self) -> bool {
        self.camera || self.factor.is_some()
    }

    /// Returns the luminance of radiance 1, or `None` if radiance stays relative.
    ///
    /// # Errors
    /// [`Error::Option`] if the reference frame lacks exposure time, f-number or sensitivity, or the factor is invalid.
    pub fn settle(&self, reference: &Frame, curve: &ResponseCurve) -> Result<Option<CalibrationReport>> {
        self.validate()?;
        let factor = self.factor.unwrap_or(1.0);
        if !self.camera {
            let report = CalibrationReport { camera_top_code_cd_m2: None, factor, cd_m2_per_unit: factor };
            return Ok(self.factor.map(|_| report));
        }
        let top_code = top_code_luminance(reference)?;
        // Radiance refers to the exposure of the reference frame, so the response gives the radiance of its largest
        // code value.
        let weights = reference.primaries().luminance();
        let top: f64 = (0..3).map(|c| weights[c] * f64::from(curve.exposure(c, 255.0))).sum();
        let cd_m2_per_unit = factor * top_code / top;
        Ok(Some(CalibrationReport { camera_top_code_cd_m2: Some(top_code), factor, cd_m2_per_unit }))
    }
}

/// Returns 87 N^2 / (t S) of `frame`, where t S / N^2 is its [relative
/// exposure](crate::bracket::exposure::Exposure::relative). Unlike the values in EXIF, the relative exposure usually has
/// exact steps, and it includes the correction from the pixels. So luminance hardly depends on which frame is the
/// reference.
fn top_code_luminance(frame: &Frame) -> Result<f64> {
    let exposure = &frame.exposure;
    let known = [("exposure time", exposure.time_s), ("f-number", exposure.f_number), ("ISO", exposure.iso)];
    let missing: Vec<&str> = known.into_iter().filter(|(_, v)| v.is_none()).map(|(name, _)| name).collect();
    if missing.is_empty() {
        return Ok(CAMERA_CONSTANT / exposure.relative());
    }
    let why = match exposure.source {
        ExposureSource::Exif => format!("the EXIF has no {}", missing.join(" and ")),
        ExposureSource::Given => "its EXIF does not have all of exposure time, f-number and ISO".to_owned(),
        ExposureSource::Estimated => "its exposure is estimated from the pixels and not from EXIF".to_owned(),
    };
    Err(Error::Option {
        option: "--absolute",
        reason: format!(
            "{}: {why}; measure one luminance and give --calibration-factor (cd/m2 per unit of radiance) instead of --absolute",
            frame.path().display()
        ),
    })
}

/// Multiplies `map` by `factor`. Values are limited to the range of f32.
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

    /// In a linear response the largest code value has 255 / 128 of the exposure of the middle one.
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
        assert!(error.is_usage() && error.to_string().contains("the EXIF has no f-number and ISO"), "{error}");
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
