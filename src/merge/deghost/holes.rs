//! Holes: places where the reference is clipped, and the shorter frames show motion.
//!
//! In: for each cell the radiance of the reference and of the shorter frames, and their weights. Out: [`Holes`]:
//! radiance that is interpolated from the surroundings, and its weight. Cost: about 100 ns per cell if there are holes,
//! and 20 ns per pixel in them. Source: the pull-push algorithm of Gortler et al. 1996, "The Lumigraph", section 3.4.2.
//!
//! A clipped reference gives only a lower bound of the radiance. If the shorter frames show a moving object in front of
//! a bright sky, no frame shows the sky there, and the mean would be a grey patch in the shape of the object. But the
//! connected clipped surroundings are about as bright. Therefore the hole is filled from the nearest known cells of
//! these surroundings, by interpolating the logarithm of radiance, channel by channel. This also restores the colour,
//! which clipped pixels have lost. Filling never makes the brightest channel darker, and is used only where the
//! reference is clipped.

use super::cells::Cell;
use super::region;
use crate::merge::FLOOR;
use crate::merge::layer::CLIPS;
use crate::plane::Plane;
use crate::pyramid::cells::{gathered, row_between_cells};
use crate::response::ResponseCurve;

/// The radiance that fills the holes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Holes {
    /// Radiance by cells, for each channel.
    radiance: [Plane<f32>; 3],
    /// Weight of that radiance in each cell, times 255.
    counts: Plane<u8>,
    /// For each channel, two limits: the reference may be clipped above the first radiance, and is certainly clipped
    /// above the second.
    clips: [(f32, f32); 3],
}

/// What the reference and the shorter frames show in one cell.
#[derive(Debug, Clone, Copy, Default)]
struct Known {
    /// Radiance of the longest frame that has full weight and is not clipped, among the reference and the shorter
    /// frames. If all frames with full weight are clipped, it is the radiance of the shortest of them, which is a lower
    /// bound.
    radiance: [f32; 3],
    /// Whether the radiance is exact and not a bound.
    is_sure: bool,
    /// Number of the shortest frame that is clipped and has full weight. 0 is the reference, 1 the next shorter frame,
    /// and so on.
    clipping: u8,
    /// Whether a frame shorter than that one has a reduced weight.
    is_missed: bool,
    /// Largest weight of a frame that is shorter than that one and not clipped, times 255.
    kept: u8,
}

impl Known {
    /// Whether a frame might show more here if nothing had moved.
    fn is_hole(&self) -> bool {
        self.is_missed && self.kept < u8::MAX
    }
}

/// What the frames shorter than the reference show of the clipped parts of the reference.
pub(super) struct Shorter {
    known: Plane<Known>,
    frames: u8,
}

impl Shorter {
    /// Creates the record from the cells of the reference; [`add`](Self::add) then adds the shorter frames.
    pub fn than(reference: &Plane<Cell>) -> Self {
        let of = |cell: &Cell| Known { radiance: cell.radiance, is_sure: !cell.clips(), ..Known::default() };
        let cells = reference.as_slice().iter().map(of).collect();
        Shorter { known: Plane::from_vec(reference.width(), reference.height(), cells), frames: 0 }
    }

    /// Adds the next shorter frame, with the weights `kept`.
    pub fn add(&mut self, frame: &Plane<Cell>, kept: &Plane<u8>) {
        self.frames = self.frames.saturating_add(1);
        let number = self.frames;
        self.known.fill_rows(|y, row| {
            for ((known, cell), &kept) in row.iter_mut().zip(frame.row(y)).zip(kept.row(y)) {
                if cell.is_outside() {
                    continue;
                }
                known.is_missed |= kept < u8::MAX;
                if !cell.clips() {
                    known.kept = known.kept.max(kept);
                }
                if kept == u8::MAX && !known.is_sure {
                    (known.radiance, known.is_sure) = (cell.radiance, !cell.clips());
                    if cell.clips() {
                        // Whatever a longer frame shows here, it is clipped too or shows something else.
                        (known.clipping, known.is_missed, known.kept) = (number, false, 0);
                    }
                }
            }
        });
    }

    /// Returns the holes in the clipped parts of `reference`, or `None` if none can be filled.
    pub fn holes(&self, reference: &Plane<Cell>, curve: &ResponseCurve) -> Option<Holes> {
        let known = &self.known;
        let (width, height) = (known.width(), known.height());
        let is_hole = |(x, y): (usize, usize)| known.at(x, y).is_hole();
        if !(0..height).any(|y| (0..width).any(|x| is_hole((x, y)) && reference.at(x, y).clips())) {
            return None;
        }
        // White is continued by white, and colour by colour: a white coat before a blue wall, of which only the blue is
        // clipped, stays white.
        let parts_of = |is_white: bool| {
            region::parts(&Plane::from_rows(width, height, |y, row: &mut [bool]| {
                for (is, cell) in row.iter_mut().zip(reference.row(y)) {
                    *is = cell.clips() && !cell.is_outside() && (0..3).all(|c| cell.is_clipped(c)) == is_white;
                }
            }))
        };
        let parts = [parts_of(true), parts_of(false)].concat();
        let mut holes: Option<Holes> = None;
        // Holes with the same `clipping`, the number of the shortest frame in which a hole is clipped, are filled
        // together. They are filled only from examples: cells that are clipped in that frame too.
        for clipping in 0..=self.frames {
            let mut counts = Plane::filled(width, height, 0u8);
            let mut weights = Plane::filled(width, height, 0.0f32);
            for part in &parts {
                let is_of = |&&(x, y): &&(usize, usize)| is_hole((x, y)) && known.at(x, y).clipping == clipping;
                let is_example = |&&(x, y): &&(usize, usize)| !is_hole((x, y)) && known.at(x, y).clipping >= clipping;
                // A connected part without a hole gives no examples, because it may be brighter than the holes.
                if part.iter().any(|at| is_of(&at)) && part.iter().any(|at| is_example(&at)) {
                    part.iter().filter(is_example).for_each(|&(x, y)| weights.row_mut(y)[x] = 1.0);
                    part.iter().filter(is_of).for_each(|&(x, y)| counts.row_mut(y)[x] = u8::MAX - known.at(x, y).kept);
                }
            }
            if counts.as_slice().iter().any(|&count| count > 0) {
                // Counts and masks are interpolated between cells. If counts ended with the hole, a dark outline would
                // remain where the mask of the frame that shows the motion ends. So clipped examples beside a hole
                // are filled too, with their own radiance.
                let beside = gathered(&counts, 1, |most, count| *most = (*most).max(*count));
                for (i, count) in counts.as_mut_slice().iter_mut().enumerate() {
                    if weights.as_slice()[i] > 0.0 && !known.as_slice()[i].is_sure {
                        *count = beside.as_slice()[i];
                    }
                }
                let radiance = std::array::from_fn(|c| self.continued(c, &weights));
                let more = Holes { radiance, counts, clips: [(0.0, 0.0); 3] };
                holes = Some(match holes {
                    Some(holes) => holes.with(more),
                    None => more,
                });
            }
        }
        let clips = std::array::from_fn(|c| (curve.exposures(c)[CLIPS.0], curve.exposures(c)[CLIPS.1]));
        holes.map(|holes| Holes { clips, ..holes })
    }

    /// Returns the radiance of channel `c`. It is known in cells with `weights` of 1, and interpolated from them in the
    /// other cells.
    fn continued(&self, c: usize, weights: &Plane<f32>) -> Plane<f32> {
        let stops = Plane::from_rows(weights.width(), weights.height(), |y, row: &mut [f32]| {
            for ((v, known), weight) in row.iter_mut().zip(self.known.row(y)).zip(weights.row(y)) {
                *v = if *weight > 0.0 { libm::log2f(known.radiance[c].max(FLOOR)) } else { 0.0 };
            }
        });
        let mut all = continued(&stops, weights);
        all.as_mut_slice().iter_mut().for_each(|v| *v = libm::exp2f(*v));
        all
    }
}

impl Holes {
    /// Combines these holes with `more`, which are in other cells.
    fn with(mut self, more: Holes) -> Holes {
        for (plane, more_of) in self.radiance.iter_mut().zip(&more.radiance) {
            let cells = plane.as_mut_slice().iter_mut().zip(more_of.as_slice()).zip(more.counts.as_slice());
            cells.filter(|(_, count)| **count > 0).for_each(|((v, more), _)| *v = *more);
        }
        let counts = self.counts.as_mut_slice().iter_mut().zip(more.counts.as_slice());
        counts.for_each(|(count, more)| *count = (*count).max(*more));
        self
    }

    /// Returns the fraction of cells with a weight of more than half.
    pub fn fraction(&self) -> f64 {
        let counts = self.counts.as_slice();
        counts.iter().filter(|&&count| count > u8::MAX / 2).count() as f64 / counts.len().max(1) as f64
    }

    /// Fills row `y` of the region, with cells of `side` pixels.
    pub fn fill(&self, side: usize, y: usize, pixels: &mut [[f32; 3]]) {
        let length = pixels.len();
        let counts = row(&self.counts, side, |v| f32::from(v) / 255.0, y, length);
        if counts.iter().all(|&count| count == 0.0) {
            return;
        }
        let more = self.radiance.each_ref().map(|plane| row(plane, side, |v| v, y, length));
        for (x, (pixel, &count)) in pixels.iter_mut().zip(&counts).enumerate().filter(|(_, (_, count))| **count > 0.0) {
            let more = [more[0][x], more[1][x], more[2][x]];
            let clipped: [f32; 3] = std::array::from_fn(|c| {
                let (begins, sure) = self.clips[c];
                ((pixel[c] - begins) / (sure - begins)).clamp(0.0, 1.0)
            });
            let white = clipped.into_iter().fold(1.0, f32::min);
            // `shown` is the fraction of the interpolated radiance `more` that is used. An unclipped channel limits
            // `shown` to pixel / more. A clipped channel does not limit it. A partly clipped channel limits it less.
            let shown = |c: usize| 1.0 - (1.0 - clipped[c]) * (1.0 - pixel[c] / more[c].max(FLOOR)).max(0.0);
            let shown = shown(0).min(shown(1)).min(shown(2));
            // A pixel that is white in all channels has lost its colour, but its brightest channel is a lower bound of
            // the radiance. Therefore `scale` brightens the interpolated radiance until its brightest channel reaches
            // that bound.
            let most = |of: [f32; 3]| of.into_iter().fold(FLOOR, f32::max);
            let scale = (most(*pixel) / most(more)).max(1.0);
            for c in 0..3 {
                let lighter = clipped[c] * (shown * more[c] - pixel[c]).max(0.0);
                let coloured = scale * more[c] - pixel[c];
                pixel[c] += count * (lighter + white * (coloured - lighter));
            }
        }
    }
}

/// Interpolates row `y` of `length` pixels between cells of `side` pixels.
fn row<T: Copy>(cells: &Plane<T>, side: usize, value: impl Fn(T) -> f32, y: usize, length: usize) -> Vec<f32> {
    let mut row = vec![0.0f32; length];
    row_between_cells(cells, side, value, y, &mut row);
    row
}

/// Returns `values` where `weights` (0..=1) are 1. Elsewhere returns the mean of the smallest neighbourhood that has
/// known values, or 0 if no value is known.
fn continued(values: &Plane<f32>, weights: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (values.width(), values.height());
    if width * height <= 1 {
        return values.clone();
    }
    let mut sums = Plane::filled(width.div_ceil(2), height.div_ceil(2), (0.0f32, 0.0f32));
    sums.fill_rows(|y, row| {
        for y in 2 * y..(2 * y + 2).min(height) {
            for (x, (v, w)) in values.row(y).iter().zip(weights.row(y)).enumerate() {
                let (sum, weight) = &mut row[x / 2];
                (*sum, *weight) = (*sum + w * v, *weight + w);
            }
        }
    });
    let plane = |of: fn(&(f32, f32)) -> f32| {
        Plane::from_vec(sums.width(), sums.height(), sums.as_slice().iter().map(of).collect())
    };
    let means = plane(|(sum, weight)| if *weight > 0.0 { sum / weight } else { 0.0 });
    let coarse = continued(&means, &plane(|(_, weight)| weight.min(1.0)));
    Plane::from_rows(width, height, |y, row| {
        row_between_cells(&coarse, 2, |v| v, y, row);
        for ((v, value), weight) in row.iter_mut().zip(values.row(y)).zip(weights.row(y)) {
            *v += weight * (value - *v);
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn continuation_keeps_known_values_and_interpolates() {
        let known = |x: usize| if (20..40).contains(&x) { 0.0 } else { 1.0 };
        let ramp = Plane::from_rows(64, 48, |_, row: &mut [f32]| {
            row.iter_mut().enumerate().for_each(|(x, v)| *v = known(x) * 0.1 * x as f32);
        });
        let weights = Plane::from_rows(64, 48, |_, row: &mut [f32]| {
            row.iter_mut().enumerate().for_each(|(x, v)| *v = known(x));
        });
        let all = continued(&ramp, &weights);
        assert!((0..20).chain(40..64).all(|x| all.at(x, 30) == ramp.at(x, 30)));
        // The ramp rises from 2 to 4 across the gap of 20 cells. The gap is filled with means of up to 32 cells, so it
        // agrees with the ramp only roughly.
        assert!((20..40).all(|x| (all.at(x, 30) - 0.1 * x as f32).abs() < 0.8), "{:?}", all.row(30));
        assert!((20..40).all(|x| all.at(x, 30) >= all.at(x - 1, 30) - 0.15), "{:?}", all.row(30));
    }

    #[test]
    fn continuation_without_known_values_is_empty() {
        let none = Plane::filled(13, 7, 0.0f32);
        assert_eq!(continued(&none, &none), none);
    }
}
