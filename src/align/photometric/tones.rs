//! Tables that bring two frames to a common exposure, with the weight of each grey value.
//!
//! In: two frames, roughly aligned. Out: [`ToneTables`]. Cost: one pass over some samples.

use crate::align::photometric::intensity_map::IntensityMap;
use crate::align::transform::map;
use crate::plane::Plane;
use nalgebra::Matrix3;

/// About so many places at which the two frames' values are taken.
const SAMPLES: f64 = 40_000.0;

/// Grey values nearer than this to either end of the brighter frame's range may be clipped.
const CLIP_MARGIN: f32 = 5.0;

/// Levels of the darker frame below this are as much noise as light.
const DARKEST: f32 = 2.0;

/// What brings two frames to a common exposure: the value that goes with each code.
#[derive(Debug, Clone, PartialEq)]
pub struct ToneTables {
    /// For the reference.
    pub reference: [f32; 256],
    /// For the frame.
    pub frame: [f32; 256],
    /// The weight of each grey value of the brighter frame, 0..=1.
    weights: [f32; 256],
}

impl ToneTables {
    /// The tones of `reference` and `frame`, with `h` (reference -> frame) about right: the two histograms decide, not
    /// the places.
    pub fn between(reference: &Plane<u8>, frame: &Plane<u8>, h: &Matrix3<f64>) -> Self {
        let samples = sample(reference, frame, h);
        let identity = std::array::from_fn(|v| v as f32);
        if is_brighter(&samples) {
            let to_frame = IntensityMap::from_samples(&samples);
            let reference = std::array::from_fn(|v| to_frame.at(v as f32));
            return ToneTables { reference, frame: identity, weights: weights(&to_frame) };
        }
        let swapped: Vec<(u8, u8)> = samples.iter().map(|&(r, f)| (f, r)).collect();
        let to_reference = IntensityMap::from_samples(&swapped);
        ToneTables {
            reference: identity,
            frame: std::array::from_fn(|v| to_reference.at(v as f32)),
            weights: weights(&to_reference),
        }
    }

    /// The weight of grey value `v`, 0..=1: 1 / (1 + m'^2), as both frames have noise and the darker's is mapped with
    /// it; 0 near the ends of either frame's range.
    #[inline]
    pub fn weight(&self, v: f32) -> f32 {
        self.weights[usize::from(v as u8)]
    }
}

/// Levels of both at a coarse grid of places that both see.
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

/// Whether the second of each pair, the frame's grey value, is the brighter on average. Every sample counts once: grey
/// values that do not occur have no part in it.
fn is_brighter(samples: &[(u8, u8)]) -> bool {
    samples.iter().map(|&(reference, frame)| i64::from(frame) - i64::from(reference)).sum::<i64>() >= 0
}

/// The weight of each grey value of the brighter frame, 0..=1.
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
            // Rounding to codes leaves 0.25 in each on average, some times that where the darker is brightened;
            // smoothing takes most off.
            assert!(apart / (trusted as f32) < 0.5, "{a} {b}: {}", apart / trusted as f32);
        }
        // What is clipped in the brighter, or black in the darker, is worth nothing.
        let tones = ToneTables::between(&take(0.0), &take(3.0), &Matrix3::identity());
        assert_eq!((tones.weight(254.0), tones.weight(1.0)), (0.0, 0.0));
    }

    #[test]
    fn pair_without_highlights_maps_the_darker_to_the_brighter() {
        // Up to 100 of 255, and one EV more: 100 x 2^(1 / 2.2) = 137.
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
