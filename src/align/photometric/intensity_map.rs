//! The intensity mapping function: the grey value of one frame that corresponds to each grey value of the other.
//!
//! In: pairs of grey values of two frames, roughly aligned. Out: a monotone [`IntensityMap`]. Cost: one pass over the
//! pairs. Source: Grossberg & Nayar, "Determining the Camera Response from Images: What Is Knowable?", PAMI 25(11),
//! 2003, section 5: in two exposures of one scene, the pixels have the same order of brightness. Therefore the map
//! follows from the two histograms, and small misalignments do not matter.

/// Number of entries of the map: one for each grey value of the first frame.
const KNOTS: usize = 256;
/// A slope is measured between two points at this distance below and above, in grey values.
const SLOPE_REACH: f32 = 4.0;

/// A monotone map of grey values 0..=255 from the first frame of the samples to the second.
#[derive(Debug, Clone, PartialEq)]
pub struct IntensityMap {
    values: Vec<f32>,
}

impl IntensityMap {
    /// Returns the map that gives the first values of the pairs the same distribution as the second values; the
    /// identity if there are no samples.
    pub fn from_samples(samples: &[(u8, u8)]) -> Self {
        if samples.is_empty() {
            return IntensityMap { values: (0..KNOTS).map(|v| v as f32).collect() };
        }
        let (mut reference, mut frame) = ([0u32; KNOTS], [0u32; KNOTS]);
        for &(r, f) in samples {
            reference[usize::from(r)] += 1;
            frame[usize::from(f)] += 1;
        }
        // The samples of each frame are sorted; the rank of a sample is its position in this order. A value of the
        // first frame is mapped to the value of the second frame at the same rank. If several samples have the value,
        // the middle of their ranks is used.
        let mut values = vec![f32::NAN; KNOTS];
        let (mut rank, mut below, mut at) = (0.0f64, 0.0f64, 0);
        for (v, value) in values.iter_mut().enumerate() {
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
            *value = (at as f64 - 0.5 + within.clamp(0.0, 1.0)) as f32;
        }
        fill_gaps(&mut values);
        IntensityMap { values }
    }

    /// Returns the second frame's value for the value `v` of the first frame.
    #[inline]
    pub fn at(&self, v: f32) -> f32 {
        let v = v.clamp(0.0, (KNOTS - 1) as f32);
        let i = (v as usize).min(KNOTS - 2);
        let t = v - i as f32;
        self.values[i] + t * (self.values[i + 1] - self.values[i])
    }

    /// Returns the slope of the map at value `v`; 0 where the second frame is clipped.
    #[inline]
    pub fn slope(&self, v: f32) -> f32 {
        let (low, high) = ((v - SLOPE_REACH).max(0.0), (v + SLOPE_REACH).min((KNOTS - 1) as f32));
        (self.at(high) - self.at(low)) / (high - low)
    }
}

/// Replaces missing values (NaN) by interpolation between the known ones. Before the first known value, the first is
/// repeated; after the last known value, the last.
fn fill_gaps(values: &mut [f32]) {
    let known: Vec<usize> = (0..values.len()).filter(|&i| !values[i].is_nan()).collect();
    let (Some(&first), Some(&last)) = (known.first(), known.last()) else {
        return;
    };
    for pair in known.windows(2) {
        let (a, b) = (values[pair[0]], values[pair[1]]);
        for i in pair[0] + 1..pair[1] {
            values[i] = a + (b - a) * (i - pair[0]) as f32 / (pair[1] - pair[0]) as f32;
        }
    }
    let (low, high) = (values[first], values[last]);
    values[..first].fill(low);
    values[last + 1..].fill(high);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_the_map_from_pairs_that_do_not_even_match() {
        let f = |v: f32| 255.0 * (v / 255.0).powf(0.6);
        let n = 20_000;
        let reference: Vec<f32> = (0..n).map(|i| 20.0 + 200.0 * i as f32 / n as f32).collect();
        // The pairs do not match: the frame's values come from the reference's values in another order, as if from
        // other positions of the scene.
        let samples: Vec<(u8, u8)> =
            (0..n).map(|i| (reference[i].round() as u8, f(reference[i * 7919 % n]).round() as u8)).collect();
        let map = IntensityMap::from_samples(&samples);
        for v in [30.0f32, 77.3, 140.0, 210.0] {
            // Rounding causes an error of at most half a grey value in each of the two frames.
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
    fn unknown_base_changes_nothing() {
        assert_eq!(IntensityMap::from_samples(&[]).at(77.0), 77.0);
    }
}
