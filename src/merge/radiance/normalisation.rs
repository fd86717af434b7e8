//! Normalisation: the radiance of many brackets in one unit, so that they can be laid beside each other.
//!
//! In: the relative exposure t ISO / N^2 in s that is to be the unit, and the reference frame. Out: the factor on radiance. Cost: one
//! multiplication a value, by [`calibration::calibrate`](crate::merge::radiance::calibration::calibrate).
//!
//! Merged radiance r is relative to the reference's exposure h: 1 is what gave the reference its middle code. So r / h does not depend on
//! the reference, and r u / h is 1 for what gives the middle code at the exposure u. Brackets that share the camera's response and u agree
//! to within what shutter, diaphragm and noise leave; where each recovered a response of its own, to within the difference of those.

use crate::bracket::Frame;
use crate::bracket::exposure::ExposureSource;
use crate::error::{Error, Result};
use crate::merge::radiance::calibration::Calibration;

/// The option by which it is asked for.
const OPTION: &str = "--normalize";

/// Whether `unit_exposure` is one, and nothing else is asked of the unit, before any work is done.
///
/// # Errors
/// [`Error::Option`] where it is no finite number above 0, or where radiance is to be in cd/m2.
pub fn validate(unit_exposure: f64, calibration: &Calibration) -> Result<()> {
    if !(unit_exposure.is_finite() && unit_exposure > 0.0) {
        return refused(format!("{unit_exposure} s is no exposure; give t ISO / N^2 in seconds, above 0"));
    }
    if calibration.camera {
        return refused("with --absolute brackets are in cd/m2, one unit for all; leave one of the two out".into());
    }
    if calibration.is_asked() {
        return refused(
            "--calibration-factor is for the unit of one reference; give --absolute with it, which is one unit for all, or leave it out"
                .into(),
        );
    }
    Ok(())
}

/// Whether the exposure of `reference` can be laid beside that of other brackets: the camera noted it. Where it noted no f-number or
/// no ISO in the whole bracket, as with a lens without contacts, those are taken to be the same in all brackets.
///
/// # Errors
/// [`Error::Option`] where exposures were given or estimated: they are relative within the bracket alone.
pub fn check(reference: &Frame) -> Result<()> {
    let path = reference.path().display();
    let had = match reference.exposure.source {
        ExposureSource::Exif => return Ok(()),
        ExposureSource::Given => "given by -e",
        ExposureSource::Estimated => "estimated from the pixels",
    };
    refused(format!(
        "the exposure of {path} is {had}, not known from its EXIF, so that its radiance cannot be brought to the unit of other brackets; merge it with `{OPTION} bracket`"
    ))
}

/// By what radiance relative to `reference_exposure` is multiplied to be relative to `unit_exposure`.
pub fn factor(unit_exposure: f64, reference_exposure: f64) -> f64 {
    unit_exposure / reference_exposure
}

fn refused(reason: String) -> Result<()> {
    Err(Error::Option { option: OPTION, reason })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Samples;
    use crate::bracket::exposure::Exposure;

    #[test]
    fn only_an_exposure_that_the_camera_noted_is_absolute() {
        let frame = |exposure| Frame::new("a.jpg".into(), 1, 1, Samples::Eight(vec![0; 3]), exposure);
        let noted = |f_number| Exposure::from_camera(0.1, f_number, Some(100.0), String::new()).unwrap();
        assert!(check(&frame(noted(Some(8.0)))).is_ok());
        assert!(check(&frame(noted(None))).is_ok(), "a lens without contacts");
        for (exposure, said) in [(Exposure::given(-2.0), "given by -e"), (Exposure::estimated(0.0, 0.1), "estimated")] {
            let error = check(&frame(exposure.unwrap())).unwrap_err();
            let text = error.to_string();
            assert!(error.is_usage() && text.starts_with("--normalize: ") && text.contains("a.jpg"), "{text}");
            assert!(text.contains(said) && text.contains("--normalize bracket"), "{text}");
        }
    }

    #[test]
    fn one_unit_at_a_time() {
        let (camera, factor) = (true, Some(2.0));
        assert!(validate(0.5, &Calibration::default()).is_ok());
        assert!(
            validate(0.5, &Calibration { camera, factor: None }).is_err_and(|e| e.to_string().contains("one unit"))
        );
        assert!(validate(0.5, &Calibration { camera: false, factor }).is_err_and(|e| e.is_usage()));
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(validate(wrong, &Calibration::default()).is_err_and(|e| e.is_usage()), "{wrong}");
        }
    }
}
