//! The intensity mapping function: which grey level of the frame goes with which of the reference.
//!
//! In: two frames, roughly aligned. Out: a monotone [`IntensityMap`], and both frames as the brighter of them would show them
//! ([`CommonExposure`]). Cost: one pass over some samples; a table look-up and a Gaussian a pixel.
//! Source: Grossberg & Nayar, "Determining the Camera Response from Images: What Is Knowable?", PAMI 25(11), 2003, section 5: two
//! exposures of one scene have the same ranks, so the map follows from the two histograms, and small misalignments do not matter.

use super::warp::map;
use crate::plane::Plane;
use crate::pyramid::gaussian;
use nalgebra::Matrix3;

/// Grey levels of the reference at which the map is kept.
const KNOTS: usize = 256;
/// About so many places at which the two frames' levels are taken.
const SAMPLES: f64 = 40_000.0;
/// Grey levels nearer than this to either end of the brighter frame's range may be clipped.
const CLIP_MARGIN: f32 = 5.0;
/// Levels of the darker frame below this are as much noise as light.
const DARKEST: f32 = 2.0;
/// Half the width over which its slope is taken, in grey levels.
const SLOPE_REACH: f32 = 4.0;

/// A monotone map of grey levels 0..=255, reference -> frame.
#[derive(Debug, Clone, PartialEq)]
pub struct IntensityMap {
    levels: Vec<f32>,
}

impl IntensityMap {
    /// The map that takes the distribution of the first of each pair to that of the second; the identity without samples.
    pub fn from_samples(samples: &[(u8, u8)]) -> Self {
        if samples.is_empty() {
            return IntensityMap { levels: (0..KNOTS).map(|v| v as f32).collect() };
        }
        let (mut reference, mut frame) = ([0u32; KNOTS], [0u32; KNOTS]);
        for &(r, f) in samples {
            reference[usize::from(r)] += 1;
            frame[usize::from(f)] += 1;
        }
        // For each level that occurs, the level of the frame at its middle rank.
        let mut levels = vec![f32::NAN; KNOTS];
        let (mut rank, mut below, mut at) = (0.0f64, 0.0f64, 0);
        for (v, level) in levels.iter_mut().enumerate() {
            let n = f64::from(reference[v]);
            let middle = rank + 0.5 * n;
            rank += n;
            if n == 0.0 {
                continue;
            }
            while at + 1 < KNOTS && below + f64::from(frame[at]) < middle {
                below += f64::from(frame[at]);
                at += 1;
            }
            let within = (middle - below) / f64::from(frame[at]).max(1.0);
            *level = (at as f64 - 0.5 + within.clamp(0.0, 1.0)) as f32;
        }
        fill_gaps(&mut levels);
        IntensityMap { levels }
    }

    /// The frame's level for level `v` of the reference.
    #[inline]
    pub fn at(&self, v: f32) -> f32 {
        let v = v.clamp(0.0, (KNOTS - 1) as f32);
        let i = (v as usize).min(KNOTS - 2);
        let t = v - i as f32;
        self.levels[i] + t * (self.levels[i + 1] - self.levels[i])
    }

    /// Whether the frame is the brighter of the two.
    pub fn brightens(&self) -> bool {
        self.levels.iter().enumerate().map(|(v, l)| l - v as f32).sum::<f32>() >= 0.0
    }

    /// How fast the frame's level rises with the reference's at level `v`: 0 where either is clipped.
    #[inline]
    pub fn slope(&self, v: f32) -> f32 {
        let (low, high) = ((v - SLOPE_REACH).max(0.0), (v + SLOPE_REACH).min((KNOTS - 1) as f32));
        (self.at(high) - self.at(low)) / (high - low)
    }
}

/// Levels that do not occur lie on the line between those that do; before the first and after the last, they are as those.
fn fill_gaps(levels: &mut [f32]) {
    let known: Vec<usize> = (0..levels.len()).filter(|&i| !levels[i].is_nan()).collect();
    let (Some(&first), Some(&last)) = (known.first(), known.last()) else {
        return;
    };
    for pair in known.windows(2) {
        let (a, b) = (levels[pair[0]], levels[pair[1]]);
        for i in pair[0] + 1..pair[1] {
            levels[i] = a + (b - a) * (i - pair[0]) as f32 / (pair[1] - pair[0]) as f32;
        }
    }
    let (low, high) = (levels[first], levels[last]);
    levels[..first].fill(low);
    levels[last + 1..].fill(high);
}

/// Two frames as the brighter of them would show them, smoothed.
///
/// The darker is mapped to the brighter because clipping is then the same in both; and it is mapped before it is smoothed, because
/// the other way round the edges of clipped areas would move.
#[derive(Debug, Clone)]
pub struct CommonExposure {
    /// The reference.
    pub reference: Plane<f32>,
    /// The frame, on its own grid.
    pub frame: Plane<f32>,
    trusts: [f32; 256],
}

impl CommonExposure {
    /// Brings `reference` and `frame` together, with `h` (reference -> frame) about right, and smooths them by `sigma` pixels.
    pub fn new(reference: &Plane<u8>, frame: &Plane<u8>, h: &Matrix3<f64>, sigma: f64) -> Self {
        let samples = sample(reference, frame, h);
        let forth = IntensityMap::from_samples(&samples);
        if forth.brightens() {
            let mapped = smooth(reference, |v| forth.at(v), sigma);
            return CommonExposure { reference: mapped, frame: smooth(frame, |v| v, sigma), trusts: trusts(&forth) };
        }
        let swapped: Vec<(u8, u8)> = samples.iter().map(|&(r, f)| (f, r)).collect();
        let back = IntensityMap::from_samples(&swapped);
        let mapped = smooth(frame, |v| back.at(v), sigma);
        CommonExposure { reference: smooth(reference, |v| v, sigma), frame: mapped, trusts: trusts(&back) }
    }

    /// How far level `v` can be trusted, 0..=1: 1 / (1 + m'^2), as both frames have noise and the darker's is mapped with it; 0 near
    /// the ends of either frame's range.
    #[inline]
    pub fn trust(&self, v: f32) -> f32 {
        self.trusts[usize::from(v as u8)]
    }
}

/// Levels of both at a coarse grid of places that both see.
fn sample(reference: &Plane<u8>, frame: &Plane<u8>, h: &Matrix3<f64>) -> Vec<(u8, u8)> {
    let step = ((reference.width() * reference.height()) as f64 / SAMPLES).sqrt().max(1.0) as usize;
    let mut samples = Vec::new();
    for y in (0..reference.height()).step_by(step) {
        for x in (0..reference.width()).step_by(step) {
            let (u, v) = map(h, x as f64, y as f64);
            let (u, v) = ((u + 0.5).floor(), (v + 0.5).floor());
            if u >= 0.0 && v >= 0.0 && u < frame.width() as f64 && v < frame.height() as f64 {
                samples.push((reference.at(x, y), frame.at(u as usize, v as usize)));
            }
        }
    }
    samples
}

/// The plane's levels through `level_of`, smoothed.
fn smooth(plane: &Plane<u8>, level_of: impl Fn(f32) -> f32, sigma: f64) -> Plane<f32> {
    let table: Vec<f32> = (0..=255u8).map(|v| level_of(f32::from(v))).collect();
    let levels = Plane::from_rows(plane.width(), plane.height(), |y, row| {
        for (v, g) in row.iter_mut().zip(plane.row(y)) {
            *v = table[usize::from(*g)];
        }
    });
    gaussian(&levels, sigma)
}

/// For each level of the brighter frame, how far it can be trusted.
fn trusts(map: &IntensityMap) -> [f32; 256] {
    let mut trusts = [0.0; 256];
    let mut darker = 0.0f32;
    for (level, trust) in trusts.iter_mut().enumerate() {
        while darker < 255.0 && map.at(darker) < level as f32 {
            darker += 0.25;
        }
        let usable = |l: f32| (CLIP_MARGIN..=255.0 - CLIP_MARGIN).contains(&l);
        if usable(level as f32) && darker >= DARKEST {
            let slope = map.slope(darker);
            *trust = 1.0 / (1.0 + slope * slope);
        }
    }
    trusts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_the_map_from_pairs_that_do_not_even_match() {
        let f = |v: f32| 255.0 * (v / 255.0).powf(0.6);
        let n = 20_000;
        let reference: Vec<f32> = (0..n).map(|i| 20.0 + 200.0 * i as f32 / n as f32).collect();
        // The frame's samples are those of other places of the same scene: a permutation.
        let samples: Vec<(u8, u8)> =
            (0..n).map(|i| (reference[i].round() as u8, f(reference[i * 7919 % n]).round() as u8)).collect();
        let map = IntensityMap::from_samples(&samples);
        assert!(map.brightens());
        for v in [30.0f32, 77.3, 140.0, 210.0] {
            // Levels are rounded in both: half a level on either side.
            assert!((map.at(v) - f(v)).abs() < 1.0, "{v}: {} {}", map.at(v), f(v));
            let slope = (f(v + 4.0) - f(v - 4.0)) / 8.0;
            assert!((map.slope(v) - slope).abs() < 0.15 * slope);
        }
    }

    #[test]
    fn is_flat_where_the_frame_is_clipped() {
        let samples: Vec<(u8, u8)> = (0..2560u32).map(|i| ((i / 10) as u8, (i / 2).min(255) as u8)).collect();
        let map = IntensityMap::from_samples(&samples);
        assert!(map.slope(150.0) < 0.05 && map.slope(25.0) > 4.0);
        assert!((0..255).all(|v| map.at(v as f32) <= map.at(v as f32 + 1.0)));
    }

    #[test]
    fn nothing_known_is_no_change() {
        assert_eq!(IntensityMap::from_samples(&[]).at(77.0), 77.0);
    }
}
