//! Tables that convert two frames to a common exposure, and the weight of each grey value.
//!
//! In: two frames, roughly aligned. Out: [`ToneTables`]. Cost: one pass over some samples.

use crate::align::photometric::intensity_map::IntensityMap;
use crate::align::transform::map;
use crate::plane::Plane;
use nalgebra::Matrix3;

/// Approximate number of positions at which both frames are sampled.
const SAMPLES: f64 = 40_000.0;

/// Grey values of the brighter frame that are closer than this to 0 or 255 count as clipped.
const CLIP_MARGIN: f32 = 5.0;

/// Least grey value of the darker frame that is used: lower values are mostly noise.
const DARKEST: f32 = 2.0;

/// For each of two frames, a table that converts its grey values to the common exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct ToneTables {
    /// The value at the common exposure of each grey value of the reference.
    pub reference: [f32; 256],
    /// The value at the common exposure of each grey value of the frame.
    pub frame: [f32; 256],
    /// The weight of each grey value of the brighter frame, 0..=1.
    weights: [f32; 256],
}

impl ToneTables {
    /// Returns the tables of `reference` and `frame`. `h` (reference -> frame) need only be approximate, because the
    /// tables follow from histograms.
    pub fn between(reference: &Plane<u8>, frame: &Plane<u8>, h: &Matrix3<f64>) -> Self {
        let mut samples = sample(reference, frame, h);
        // The brighter frame is the one whose samples have the larger mean. (A comparison of the two tables instead
        // would also count grey values that do not occur in the frames.)
        let is_frame_brighter = samples.iter().map(|&(r, f)| i64::from(f) - i64::from(r)).sum::<i64>() >= 0;
        if !is_frame_brighter {
            samples.iter_mut().for_each(|(r, f)| std::mem::swap(r, f));
        }
        let to_brighter = IntensityMap::from_samples(&samples);
        let (darker, brighter) = (std::array::from_fn(|v| to_brighter.at(v as f32)), std::array::from_fn(|v| v as f32));
        let (reference, frame) = if is_frame_brighter { (darker, brighter) } else { (brighter, darker) };
        ToneTables { reference, frame, weights: weights(&to_brighter) }
    }

    /// Returns the weight of grey value `v` of the brighter frame, 0..=1.
    ///
    /// It is 1 / (1 + m'^2), where m' is the slope of the map from the darker frame to the brighter one: the map also
    /// multiplies the noise of the darker frame by m'. It is 0 where the brighter frame is nearly black or clipped, and
    /// where the darker frame is nearly black.
    #[inline]
    pub fn weight(&self, v: f32) -> f32 {
        self.weights[usize::from(v as u8)]
    }
}

/// Returns pairs of grey values (reference, frame) on a coarse grid of the reference, where both frames have pixels.
fn sample(reference: &Plane<u8>, frame: &Plane<u8>, h: &Matrix3<f64>) -> Vec<(u8, u8)> {
    let step = ((reference.width() * reference.height()) as f64 / SAMPLES).sqrt().max(1.0) as usize;
    let mut samples = Vec::new();
    for y in (0..reference.height()).step_by(step) {
        for x in (0..reference.width()).step_by(step) {
            let (u, v) = map(h, x as f64, y as f64);
            let (u, v) = (u + 0.5, v + 0.5);
            if u >= 0.0 && v >= 0.0 && u < frame.width() as f64 && v < frame.height() as f64 {
                samples.push((reference.at(x, y), frame.at(u as usize, v as usize)));
            }
        }
    }
    samples
}

/// Returns the weight of each grey value of the brighter frame, 0..=1; `map` is from the darker to the brighter frame.
fn weights(map: &IntensityMap) -> [f32; 256] {
    let mut weights = [0.0; 256];
    let mut darker = 0.0f32;
    for (value, weight) in weights.iter_mut().enumerate() {
        while darker < 255.0 && map.at(darker) < value as f32 {
            darker += 0.25;
        }
        let usable = |l: f32| (CLIP_MARGIN..=255.0 - CLIP_MARGIN).contains(&l);
        if usable(value as f32) && darker >= DARKEST {
            let slope = map.slope(darker);
            *weight = 1.0 / (1.0 + slope * slope);
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::photometric::CommonExposure;
    use crate::align::scene::{Scene, Shot};
    use crate::align::transform::Transform;

    #[test]
    fn two_exposures_become_alike_where_they_can_be_trusted() {
        let size = (300, 200);
        let take = |ev| Scene::new(5).photograph(size, &Transform::Identity, Shot { noise: 0.0, ..Shot::at(ev) });
        for (a, b) in [(-1.0, 1.0), (1.0, -1.0)] {
            let (reference, frame) = (take(a), take(b));
            let tones = ToneTables::between(&reference, &frame, &Matrix3::identity());
            let both = CommonExposure::new(&reference, &frame, &tones);
            let (mut trusted, mut apart) = (0, 0.0f32);
            for (r, f) in both.reference.as_slice().iter().zip(both.frame.as_slice()) {
                if tones.weight(*r) > 0.05 {
                    trusted += 1;
                    apart += (r - f).abs();
                }
            }
            assert!(3 * trusted > size.0 * size.1, "{trusted}");
            // Rounding causes a mean error of 0.25 grey values in each frame, and more where the darker frame is
            // brightened. Smoothing removes most of this error.
            assert!(apart / (trusted as f32) < 0.5, "{a} {b}: {}", apart / trusted as f32);
        }
        // Grey values clipped in the brighter frame or black in the darker one have weight 0.
        let tones = ToneTables::between(&take(0.0), &take(3.0), &Matrix3::identity());
        assert_eq!((tones.weight(254.0), tones.weight(1.0)), (0.0, 0.0));
    }

    #[test]
    fn pair_without_highlights_maps_the_darker_to_the_brighter() {
        // The darker frame has grey values up to 100. The brighter frame has 1 EV more, so its values reach 100 x 2^(1
        // / 2.2) = 137.
        let gain = 2f64.powf(1.0 / 2.2);
        let ramp = |gain: f64| {
            Plane::from_rows(101, 40, |_, row: &mut [u8]| {
                row.iter_mut().enumerate().for_each(|(x, v)| *v = (gain * x as f64).round() as u8);
            })
        };
        let (dark, bright) = (ramp(1.0), ramp(gain));
        for (reference, frame) in [(&dark, &bright), (&bright, &dark)] {
            let tones = ToneTables::between(reference, frame, &Matrix3::identity());
            let is_frame_brighter = frame == &bright;
            let (mapped, kept) =
                if is_frame_brighter { (tones.reference, tones.frame) } else { (tones.frame, tones.reference) };
            assert_eq!(kept[90], 90.0, "the brighter is kept");
            assert!((f64::from(mapped[90]) - gain * 90.0).abs() < 1.0, "the darker is mapped: {}", mapped[90]);
        }
    }
}
