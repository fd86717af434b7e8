//! Models of human vision: the contrast sensitivity function and the response to contrast above the threshold.
//!
//! In: frequencies, luminances, contrasts. Out: sensitivities and responses. Cost: a few powers. Source: Daly, "The
//! Visible Differences Predictor" (1993), section 3.2 (sensitivity); Wilson, "A Transducer Function for Threshold and
//! Suprathreshold Human Vision" (1980); both as given by Mantiuk, Daly, Kerofsky, "Display Adaptive Tone Mapping"
//! (2008), section 4 and appendix.

/// Returns the contrast sensitivity (1 / threshold) at `frequency` cycles per degree. The eye is adapted to `cd_m2`,
/// and sees a picture of one square degree at a distance of half a metre.
pub(crate) fn sensitivity(frequency: f64, cd_m2: f64) -> f64 {
    const PEAK: f64 = 250.0;
    // Daly's factor for the accommodation of the eye at half a metre. His factors for orientation and eccentricity are
    // 1: for horizontal or vertical patterns in the centre of view.
    let nearer = 0.856 * libm::pow(0.5, 0.14);
    PEAK * daly(frequency, cd_m2).min(daly(frequency / nearer, cd_m2))
}

/// Returns S_1 of Daly's equation 3.4, with epsilon = 0.9.
fn daly(frequency: f64, cd_m2: f64) -> f64 {
    let a = 0.801 * libm::pow(1.0 + 0.7 / cd_m2, -0.2);
    let b = 0.9 * frequency * 0.3 * libm::pow(1.0 + 100.0 / cd_m2, 0.15);
    let size = libm::pow(3.23 * libm::pow(frequency * frequency, -0.3), 5.0);
    libm::pow(size + 1.0, -0.2) * a * 0.9 * frequency * libm::exp(-b) * (1.0 + 0.06 * libm::exp(b)).sqrt()
}

/// Returns the response, in just noticeable differences, to a `contrast` in log10 by an eye of this sensitivity.
pub(crate) fn response(contrast: f64, sensitivity: f64) -> f64 {
    let scaled = sensitivity * (libm::exp10(contrast) - 1.0);
    let rising = libm::cbrt(1.0 + scaled * scaled * scaled) - 1.0;
    3.291 * rising / (0.2599 * libm::pow(3.433 + scaled, 0.8))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In daylight, the contrast sensitivity peaks at 2 to 6 cycles per degree, where the threshold is a contrast of
    /// about 0.5 %. In the dark, the sensitivity is lower, most of all at high frequencies.
    #[test]
    fn sensitivity_is_that_of_an_eye() {
        let best = (1..300)
            .map(|f| f64::from(f) / 10.0)
            .max_by(|a, b| sensitivity(*a, 100.0).total_cmp(&sensitivity(*b, 100.0)));
        assert!((2.0..6.0).contains(&best.unwrap()), "{best:?}");
        assert!((100.0..250.0).contains(&sensitivity(best.unwrap(), 100.0)));
        let loss = |f: f64| sensitivity(f, 100.0) / sensitivity(f, 0.1);
        assert!(loss(1.0) > 1.1 && loss(15.0) > 3.0 * loss(1.0), "{} {}", loss(1.0), loss(15.0));
    }

    /// The response at the threshold is about 1. Above the threshold, it is about proportional to the logarithm of
    /// contrast (Weber's law), or rises more slowly.
    #[test]
    fn response_is_one_at_the_threshold_and_then_slows() {
        for s in [20.0, 150.0] {
            let threshold = libm::log10(1.0 + 1.0 / s);
            assert!((response(threshold, s) - 1.0).abs() < 0.05, "{}", response(threshold, s));
            let mut last = f64::INFINITY;
            for step in 2..60 {
                let contrast = 2.0 * threshold * f64::from(step);
                let slope = response(contrast + threshold, s) - response(contrast, s);
                assert!(slope > 0.0 && slope < last * 1.3, "{s} {step}");
                last = slope;
            }
        }
        assert_eq!(response(0.0, 100.0), 0.0);
    }
}
