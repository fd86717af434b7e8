//! Jumps: where depth jumps, and where exactly.
//!
//! In: the [`Choice`]s of all pixels, and the reference. Out: the pixels near jumps; choices that jump at the edges of
//! the picture. Cost: about three hundred operations for each pixel near a jump. Source: weighted median (Ma et al.,
//! "Constant Time Weighted Median Filtering for Stereo Matching and Beyond", ICCV 2013).

use crate::align::following::depth::cost_volume::RADIUS;
use crate::align::following::depth::semi_global::Choice;
use crate::plane::Plane;
use crate::pyramid::cells::{grown_by, near};

/// Neighbours whose labels differ by more than this are on different surfaces.
pub(super) const JUMP: f32 = 1.5;
/// The median is that of the pixels up to this far away. A jump is displaced by at most the radius of a window, so most
/// of the similar pixels within three times this radius are on the right side of it.
const REACH: usize = 3 * RADIUS;
/// A pixel counts exp(-d / `SIMILAR`) in a median if its grey value differs by d from that of the centre.
const SIMILAR: f32 = 12.0;

/// Returns which pixels are at most `reach` pixels from a jump, horizontally and vertically.
pub(super) fn around(choices: &Plane<Choice>, reach: usize) -> Plane<bool> {
    let (width, height) = (choices.width(), choices.height());
    let at = Plane::from_rows(width, height, |y, row: &mut [bool]| {
        let (here, below) = (choices.row(y), choices.row((y + 1).min(height - 1)));
        for (x, is_jump) in row.iter_mut().enumerate() {
            let next = [here[(x + 1).min(width - 1)], below[x]];
            *is_jump = next.iter().any(|next| (next.label - here[x].label).abs() > JUMP);
        }
    });
    grown_by(&at, reach)
}

/// Moves jumps to the edges of the picture: near jumps, a pixel gets the median label of the pixels around it, of which
/// those with a similar grey value count most.
pub(super) fn at_edges(choices: &Plane<Choice>, grey: &Plane<u8>) -> Plane<Choice> {
    let (width, height) = (choices.width(), choices.height());
    let weights: [f32; 256] = std::array::from_fn(|d| libm::expf(-(d as f32) / SIMILAR));
    let is_near = around(choices, REACH);
    Plane::from_rows(width, height, |y, row: &mut [Choice]| {
        row.copy_from_slice(choices.row(y));
        let mut labels = WeightedLabels::default();
        for (x, choice) in row.iter_mut().enumerate().filter(|(x, _)| is_near.at(*x, y)) {
            let here = grey.at(x, y);
            for v in near(y, REACH, height) {
                let columns = near(x, REACH, width);
                for (c, &g) in choices.row(v)[columns.clone()].iter().zip(&grey.row(v)[columns]) {
                    labels.add(c.label, weights[usize::from(g.abs_diff(here))]);
                }
            }
            choice.label = labels.take_median();
        }
    })
}

/// Labels with weights, in bins: each holds the labels that round to the same number.
#[derive(Debug, Default)]
struct WeightedLabels {
    /// For each bin, the sum of the weights, and that of the weighted labels.
    bins: Vec<[f32; 2]>,
}

impl WeightedLabels {
    /// Adds a label.
    #[inline]
    fn add(&mut self, label: f32, weight: f32) {
        let i = (label + 0.5) as usize;
        if i >= self.bins.len() {
            self.bins.resize(i + 1, [0.0; 2]);
        }
        let bin = &mut self.bins[i];
        *bin = [bin[0] + weight, bin[1] + weight * label];
    }

    /// Returns the mean of the bin in which the median is, and empties all bins.
    fn take_median(&mut self) -> f32 {
        let half = 0.5 * self.bins.iter().map(|[weight, _]| weight).sum::<f32>();
        let mut sum = 0.0;
        let mut is_reached = |[weight, _]: &&[f32; 2]| {
            sum += weight;
            sum >= half && *weight > 0.0
        };
        let median = self.bins.iter().find(&mut is_reached).map_or(0.0, |[weight, labels]| labels / weight);
        self.bins.fill([0.0; 2]);
        median
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::uniform;

    #[test]
    fn median_is_near_that_of_the_sorted_labels() {
        let mut labels = WeightedLabels::default();
        for seed in 0..50 {
            let count = 1 + (60.0 * uniform(seed, 0, 0)) as i64;
            let values = (1..=count).map(|i| (20.0 * uniform(seed, i, 1) as f32, uniform(seed, i, 2) as f32));
            let mut sorted: Vec<(f32, f32)> = values.collect();
            sorted.iter().for_each(|&(label, weight)| labels.add(label, weight));
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
            let half = 0.5 * sorted.iter().map(|v| f64::from(v.1)).sum::<f64>();
            let mut sum = 0.0;
            let reached = |v: &&(f32, f32)| {
                sum += f64::from(v.1);
                sum >= half
            };
            let expected = sorted.iter().find(reached).unwrap().0;
            // The mean of a bin is at most one label from the values in it.
            let found = labels.take_median();
            assert!((found - expected).abs() < 1.0, "seed {seed}: {found} instead of {expected}");
        }
    }

    /// The labels jump at a line two pixels beside the edge of the picture, as they do beside a near bar.
    #[test]
    fn jumps_move_to_the_edges() {
        let is_bar = |x: usize| (20..28).contains(&x);
        let grey = Plane::from_rows(48, 20, |y, row: &mut [u8]| {
            for (x, v) in row.iter_mut().enumerate() {
                let noise = (6.0 * uniform(4, x as i64, y as i64)) as u8;
                *v = noise + if is_bar(x) { 180 } else { 90 };
            }
        });
        let choices = Plane::from_rows(48, 20, |_, row: &mut [Choice]| {
            for (x, c) in row.iter_mut().enumerate() {
                *c = Choice { label: if (18..30).contains(&x) { 9.0 } else { 2.0 }, certainty: 1.0 };
            }
        });
        let is_near = around(&choices, 2);
        assert_eq!((0..48).filter(|&x| is_near.at(x, 7)).collect::<Vec<_>>(), [15, 16, 17, 18, 19, 27, 28, 29, 30, 31]);
        let found = at_edges(&choices, &grey);
        for (x, y) in (0..20).flat_map(|y| (0..48).map(move |x| (x, y))) {
            // The label is a quotient of sums of floats.
            let off = found.at(x, y).label - if is_bar(x) { 9.0 } else { 2.0 };
            assert!(off.abs() < 1e-4, "({x}, {y}): {off}");
        }
    }
}
