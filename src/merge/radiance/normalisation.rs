//! Normalisation: one unit of radiance for many brackets, so that they can be compared and stitched.
//!
//! In: the reference frame, and the relative exposure u = t ISO / N^2, in s, at which radiance 1 shall give the middle
//! code value. Out: the factor on radiance. Cost: one multiplication per value, by
//! [`calibration::calibrate`](crate::merge::radiance::calibration::calibrate).
//!
//! Merged radiance r is relative to the exposure h of the reference frame: where r is 1, this frame has the middle code
//! value. At the exposure u, the middle code value needs the radiance r = h / u. The factor u / h makes this radiance
//! 1, whichever frame is the reference. Brackets with the same response and the same u agree within the errors of
//! shutter, aperture and noise. Brackets with separate responses also differ by the difference of the responses.

use crate::bracket::Frame;
use crate::bracket::exposure::ExposureSource;
use crate::error::{Error, Result};
use crate::merge::radiance::calibration::Calibration;

/// The option that selects normalisation.
const OPTION: &str = "--normalize";

/// Checks `unit_exposure`, and that no other unit is requested.
///
/// # Errors
/// [`Error::Option`] if it is not finite and above 0, or if radiance is calibrated.
pub fn validate(unit_exposure: f64, calibration: &Calibration) -> Result<()> {
    if !(unit_exposure.is_finite() && unit_exposure > 0.0) {
        return refused(format!(
            "{unit_exposure} s is not a valid exposure; give (exposure time x ISO / f-number squared) in seconds, above 0"
        ));
    }
    if calibration.camera {
        return refused("with --absolute all brackets are in cd/m2 already; remove --absolute or --normalize".into());
    }
    if calibration.is_asked() {
        return refused(
            "cannot be combined with --calibration-factor, because the factor is valid only for the exposure of one reference frame; \
             remove --calibration-factor, or replace --normalize with --absolute"
                .into(),
        );
    }
    Ok(())
}

/// Checks that the exposure of `reference` can be compared with that of other brackets: it must be from EXIF. If
/// f-number or ISO are missing in the whole bracket, as with a lens without contacts, the missing values are assumed to
/// be the same in all brackets.
///
/// # Errors
/// [`Error::Option`] if exposures were given or estimated: they are relative within the bracket only.
pub fn check(reference: &Frame) -> Result<()> {
    let path = reference.path().display();
    let origin = match reference.exposure.source {
        ExposureSource::Exif => return Ok(()),
        ExposureSource::Given => "given by -e",
        ExposureSource::Estimated => "estimated from the pixels",
    };
    refused(format!(
        "the exposure of {path} is {origin} and not from EXIF, so this bracket cannot have the same brightness scale as others; give `{OPTION} bracket`"
    ))
}

/// Returns the factor by which radiance is multiplied, so that radiance 1 gives the middle code value at
/// `unit_exposure` instead of `reference_exposure`.
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
            validate(0.5, &Calibration { camera, factor: None }).is_err_and(|e| e.to_string().contains("--absolute"))
        );
        assert!(validate(0.5, &Calibration { camera: false, factor }).is_err_and(|e| e.is_usage()));
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(validate(wrong, &Calibration::default()).is_err_and(|e| e.is_usage()), "{wrong}");
        }
    }
}
