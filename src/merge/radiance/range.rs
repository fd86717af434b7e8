//! The range of a result: from the noise floor to where the shortest frame clips.
//!
//! In: a bracket, its alignment and the response. Out: two radiances. Cost: the noise of the longest frame, 5 ms.
//!
//! The floor is the radiance that equals its own noise sigma after merging with inverse variances as weights: 1 /
//! sigma^2 = sum_j (dt_j / (sigma_Z dX/dZ))^2. Here sigma_Z is the noise of a code value, dX/dZ the slope of the
//! response, and dt_j the exposure of frame j divided by the exposure of the reference frame. In frames of 8 bits, JPEG
//! and noise lift black by up to 6 code values (`LIFT`). There, code values up to 6 above black are not counted,
//! because their radiance is not that of the scene. In frames of 16 bits all code values above black count.

use crate::align::Alignment;
use crate::bracket::{Bracket, Frame};
use crate::error::Result;
use crate::merge::layer::{CLIPS, LIFT};
use crate::merge::noise::Noise;
use crate::merge::radiance::statistics::{BT709, Statistics};
use crate::response::{CODES, ResponseCurve};
use serde::Serialize;

/// Number of steps per stop of the search for the floor.
const PER_STOP: usize = 16;
/// The floor is searched down to this many stops below the clipping of the longest frame. 16-bit code values have fewer
/// stops.
const DEEPEST: usize = 20;

/// The limits of reliable radiance, in the unit of the radiance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limits {
    /// The radiance of grey at which signal and noise are equal.
    pub noise_floor: f64,
    /// The radiance of grey from which on the shortest frame clips.
    pub clipping: f64,
}

impl Limits {
    /// Returns the limits of the merged frames of `bracket`, or `None` if no radiance is above the noise.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch) if frames are on disk and cannot be read.
    pub fn of(bracket: &Bracket, alignment: &Alignment, curve: &ResponseCurve) -> Result<Option<Limits>> {
        let reference = bracket.reference().exposure.relative();
        let placed: Vec<&Frame> = alignment.placed(bracket).map(|(_, frame, _)| frame).collect();
        let (Some(shortest), Some(longest)) = (placed.first(), placed.last()) else { return Ok(None) };
        let is_fine = longest.max() > u16::from(u8::MAX);
        let noise = if is_fine { Noise::of_fine(longest)? } else { Noise::of(longest, false)? };
        let least: [f64; 3] = std::array::from_fn(|c| curve.black(c) + if is_fine { 0.0 } else { LIFT as f64 });
        let time = |frame: &Frame| frame.exposure.relative() / reference;
        let times: Vec<f64> = placed.iter().map(|frame| time(frame)).collect();
        let clips = |frame: &Frame| grey(|c| f64::from(curve.exposures(c)[CLIPS.1])) / time(frame);
        // Returns the sum, over the frames, of the squared ratio of signal to noise.
        let ratio = |radiance: f64| -> f64 {
            let of_frame = |time: &f64| {
                let codes: [f64; 3] = std::array::from_fn(|c| f64::from(curve.code(c, (radiance * time) as f32)));
                if (0..3).any(|c| codes[c] <= least[c] || codes[c] > CLIPS.1 as f64) {
                    return 0.0;
                }
                let sigma = grey(|c| noise.deviation(c, codes[c]) * slope(curve, c, codes[c])) / time;
                (radiance / sigma) * (radiance / sigma)
            };
            times.iter().map(of_frame).sum()
        };
        let from = clips(longest);
        let down = |i: usize| from * libm::exp2(-(i as f64) / PER_STOP as f64);
        let floor = (1..PER_STOP * DEEPEST).map(down).take_while(|&radiance| ratio(radiance) >= 1.0).last();
        Ok(floor.map(|noise_floor| Limits { noise_floor, clipping: clips(shortest) }))
    }

    /// Returns the limits multiplied by `factor`.
    pub fn times(self, factor: f64) -> Limits {
        Limits { noise_floor: self.noise_floor * factor, clipping: self.clipping * factor }
    }

    /// Returns the range of `statistics` within the limits, in stops, without the darkest thousandth and the brightest
    /// ten-thousandth of the pixels.
    pub fn stops(&self, statistics: &Statistics) -> f64 {
        let darkest = f64::from(statistics.p0_1).max(self.noise_floor);
        let brightest = f64::from(statistics.p99_99).min(self.clipping);
        libm::log2(brightest / darkest).max(0.0)
    }
}

/// Returns the luminance of the channel values `of(0)`, `of(1)` and `of(2)`.
fn grey(of: impl Fn(usize) -> f64) -> f64 {
    (0..3).map(|c| f64::from(BT709[c]) * of(c)).sum()
}

/// Returns dX/dZ at a code value.
fn slope(curve: &ResponseCurve, channel: usize, code: f64) -> f64 {
    let x = curve.exposures(channel);
    let below = (code as usize).min(CODES - 2);
    f64::from(x[below + 1]) - f64::from(x[below])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::ReferenceChoice;
    use crate::bracket::Samples;
    use crate::bracket::exposure::Exposure;
    use crate::response::tests::still;

    fn ramp(x: usize, _: usize) -> [f64; 3] {
        [libm::exp2(x as f64 / 20.0 - 9.0); 3]
    }

    /// By hand, for sRGB: code value 250 has 0.956 of the light of white, and code value 6 has 6 / 255 / 12.92 of the
    /// light of white. The ratio of the two is 9.04 stops. The floor is found in steps of a sixteenth of a stop. Every
    /// stop between the shortest and the longest exposure adds one stop to the range.
    #[test]
    fn range_is_that_of_a_frame_and_the_span_of_the_exposures() {
        let curve = ResponseCurve::srgb();
        for (times, span) in [(&[1.0, 1.0][..], 0.0), (&[0.25, 1.0, 4.0], 4.0), (&[0.125, 1.0, 8.0], 6.0)] {
            let (bracket, alignment) = still((240, 70), times, ramp);
            let limits = Limits::of(&bracket, &alignment, &curve).unwrap().unwrap();
            let range = libm::log2(limits.clipping / limits.noise_floor);
            assert!((range - 9.04 - span).abs() < 0.07, "{times:?}: {range}");
            // The limits are in the unit of the radiance: the reference, the middle frame, has its middle code value at
            // radiance 1.
            let clipping = f64::from(curve.exposures(0)[250]) * libm::exp2(span / 2.0);
            assert!((limits.clipping / clipping - 1.0).abs() < 1e-6, "{limits:?}");
            assert_eq!(limits.times(2.0).clipping, 2.0 * limits.clipping);
        }
    }

    #[test]
    fn range_is_bounded_by_the_limits_and_by_the_content() {
        let limits = Limits { noise_floor: 0.01, clipping: 10.24 };
        let stops = |p0_1, p99_99| limits.stops(&Statistics { p0_1, p99_99, ..Statistics::default() });
        assert!((stops(1e-6, 1e6) - 10.0).abs() < 1e-6, "bounded by noise and by clipping");
        assert!((stops(0.5, 2.0) - 2.0).abs() < 1e-6, "fog has no more than it has");
        assert_eq!(stops(20.0, 20.0), 0.0);
    }

    /// The frames have linear code values of 16 bits. With a noise of 2 (of 255), code value 250 is log2(250 / 2) =
    /// 6.97 stops above the noise. With a noise of 0.02, the range ends at the radiance of code value 0.
    #[test]
    fn range_of_16_bit_frames_is_limited_by_noise_or_by_the_response() {
        let noisy = |time: f64, sigma: f64| {
            let mut state = 1u64;
            // SplitMix64.
            let mut random = || {
                state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
                let z = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
                let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
                ((z ^ (z >> 31)) >> 40) as f64 / f64::from(1 << 24) - 0.5
            };
            let codes = (0..3 * 256 * 256).map(|i| {
                let light = 4000.0 + (i / 3 % 256) as f64 * 40.0;
                // The sum of four uniform numbers, of variance 1/12 each, is scaled to variance 1.
                let noise: f64 = (0..4).map(|_| random()).sum::<f64>() * 3f64.sqrt();
                (light * time + 257.0 * sigma * noise).round().clamp(0.0, 65535.0) as u16
            });
            let exposure = Exposure::given(libm::log2(time)).unwrap();
            Frame::new(format!("{time}").into(), 256, 256, Samples::Sixteen(codes.collect()), exposure)
        };
        let curve = ResponseCurve::linear();
        let foot = libm::log2(f64::from(curve.exposures(0)[250] / curve.exposures(0)[0]));
        for (sigma, stops) in [(2.0, 6.97), (0.02, foot)] {
            let frames = vec![noisy(1.0, sigma), noisy(4.0, sigma)];
            let bracket = Bracket::new(frames, &ReferenceChoice::Number(1)).unwrap();
            let limits = Limits::of(&bracket, &Alignment::unmoved(&bracket), &curve).unwrap().unwrap();
            let range = libm::log2(limits.clipping / limits.noise_floor);
            // The noise is estimated by the lower quartile of the blocks, which is a tenth below the true noise.
            assert!((range - 2.0 - stops).abs() < 0.3, "{sigma}: {range}");
        }
    }
}
