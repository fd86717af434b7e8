//! Semi-global matching: the label of each pixel, such that labels explain the frames and neighbours have similar
//! labels.
//!
//! In: a [`CostVolume`]. Out: for each pixel, its label (with a fraction) and how certain it is. Cost: about six
//! operations for each pixel, label and direction. Source: Hirschmueller, "Stereo Processing by Semiglobal Matching and
//! Mutual Information", PAMI 30(2), 2008, section 2.3: along each of eight directions,
//! L(p, d) = C(p, d) + min(L(p', d), L(p', d +- 1) + P1, min L(p', k) + P2) - min L(p', k).

use crate::align::following::depth::cost_volume::CostVolume;
use crate::budget::Demand;
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use rayon::prelude::*;
use std::ops::Range;

/// Cost of a step by one label, P1, in natural units of log likelihood.
const STEP: f32 = 0.3;
/// Cost of a larger step, P2, in the same units. It is lower where the reference has an edge.
const JUMP: f32 = 2.5;
/// P2 is halved where neighbouring pixels differ by this, in grey values. It falls with the square of the difference.
const EDGE: f32 = 8.0;
/// Least value of P2, in natural units of log likelihood.
const LEAST_JUMP: f32 = 0.1;
/// Number of costs that are summed at a time, unless a few rows have more. This limits the memory.
const STRIP_COSTS: usize = Demand::STRIP_COSTS as usize;
/// Rows above and below a strip that are matched with it, because a label depends on its neighbours.
const BESIDE: usize = 16;
/// Pixels of a row that are processed together.
const BLOCK: usize = 64;

/// The label of a pixel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Choice {
    /// The label, with a fraction.
    pub(super) label: f32,
    /// By how much the label is better than the mean of all, in natural units of log likelihood.
    pub(super) certainty: f32,
}

/// Chooses the label of each pixel of `volume`, strip by strip. `grey` is the reference.
pub(super) fn choose(volume: &CostVolume, grey: &Plane<u8>) -> Plane<Choice> {
    let (width, height) = (volume.width, volume.height);
    let rows = (STRIP_COSTS / (width * volume.labels)).saturating_sub(2 * BESIDE).max(BESIDE);
    let mut choices = Vec::with_capacity(width * height);
    for first in (0..height).step_by(rows) {
        let end = (first + rows).min(height);
        let strip = Strip { volume, grey, rows: first.saturating_sub(BESIDE)..(end + BESIDE).min(height) };
        let chosen = strip.choose();
        choices.extend_from_slice(chosen.rows(first - strip.rows.start..end - strip.rows.start));
    }
    Plane::from_vec(width, height, choices)
}

/// Some rows of a volume, and the grey values of the reference there.
struct Strip<'a> {
    volume: &'a CostVolume,
    grey: &'a Plane<u8>,
    rows: Range<usize>,
}

impl Strip<'_> {
    /// The costs of the pixel (x, y) of the strip.
    #[inline(always)]
    fn costs(&self, x: usize, y: usize) -> &[u8] {
        self.volume.at((self.rows.start + y) * self.volume.width + x)
    }

    /// The grey values of row `y` of the strip.
    #[inline(always)]
    fn grey(&self, y: usize) -> &[u8] {
        self.grey.row(self.rows.start + y)
    }

    /// Chooses the label of each pixel of the strip.
    fn choose(&self) -> Plane<Choice> {
        let (width, labels) = (self.volume.width, self.volume.labels);
        let mut sums = vec![0u16; width * self.rows.len() * labels];
        self.along_rows(&mut sums);
        for is_down in [true, false] {
            for slant in [-1, 0, 1] {
                self.across_rows(&mut sums, is_down, slant);
            }
        }
        Plane::from_rows(width, self.rows.len(), |y, row| {
            for (x, choice) in row.iter_mut().enumerate() {
                let sums = &sums[(y * width + x) * labels..][..labels];
                *choice = chosen(sums, self.costs(x, y), self.volume.scale);
            }
        })
    }

    /// Adds the costs of the paths from the left and from the right.
    fn along_rows(&self, sums: &mut [u16]) {
        let (width, labels) = (self.volume.width, self.volume.labels);
        sums.par_chunks_mut(width * labels).enumerate().for_each_init(
            || [vec![WALL; labels + 2], vec![WALL; labels + 2]],
            |paths, (y, sums)| vectorised(AlongRow { strip: self, y, sums, paths }),
        );
    }

    /// Adds the costs of the paths that come from the row above (`is_down`) or below, and from `slant` columns to the
    /// left.
    fn across_rows(&self, sums: &mut [u16], is_down: bool, slant: isize) {
        let (width, height, labels) = (self.volume.width, self.rows.len(), self.volume.labels);
        let stride = labels + 2;
        let mut before = Paths { costs: vec![WALL; width * stride], least: vec![0; width] };
        let mut here = before.clone();
        for i in 0..height {
            let y = if is_down { i } else { height - 1 - i };
            let last = if is_down { y.wrapping_sub(1) } else { y + 1 };
            let row = Row { strip: self, y, y_before: (last < height).then_some(last), slant };
            let sums = &mut sums[y * width * labels..(y + 1) * width * labels];
            let paths = here.costs.par_chunks_mut(BLOCK * stride).zip(here.least.par_chunks_mut(BLOCK));
            sums.par_chunks_mut(BLOCK * labels).zip(paths).enumerate().for_each(|(block, (sums, (costs, least)))| {
                vectorised(Block { row: &row, x: block * BLOCK, before: &before, costs, least, sums });
            });
            std::mem::swap(&mut before, &mut here);
        }
    }
}

/// The label with the least sum. Its fraction is that of the vertex of the parabola through its neighbours.
fn chosen(sums: &[u16], costs: &[u8], scale: f32) -> Choice {
    let best = (0..sums.len()).min_by_key(|&i| sums[i]).unwrap_or(0);
    let mean = costs.iter().map(|&c| f32::from(c)).sum::<f32>() / costs.len() as f32;
    let certainty = ((mean - f32::from(costs[best])) / scale).max(0.0);
    if best == 0 || best + 1 == sums.len() {
        return Choice { label: best as f32, certainty };
    }
    let [before, here, after] = [best - 1, best, best + 1].map(|i| f32::from(sums[i]));
    let curvature = before - 2.0 * here + after;
    let fraction = if curvature > 0.0 { 0.5 * (before - after) / curvature } else { 0.0 };
    Choice { label: best as f32 + fraction.clamp(-0.5, 0.5), certainty }
}

/// P1, and P2 between two pixels with these grey values.
pub(super) fn penalties(scale: f32, a: u8, b: u8) -> [u16; 2] {
    let edge = f32::from(a.abs_diff(b)) / EDGE;
    let jump = (JUMP / (1.0 + edge * edge)).max(LEAST_JUMP);
    [scale * STEP, scale * jump].map(|p| (p + 0.5) as u16)
}

/// A large cost that can be added to without overflow: it stands on both sides of the labels of a pixel.
const WALL: u16 = u16::MAX / 2;

/// Computes the path costs of a pixel from those of the pixel before, and adds them to its sums. `before` and `here`
/// have a [`WALL`] on both sides. Returns the least path cost.
#[inline(always)]
fn extend(costs: &[u8], before: &[u16], least: u16, [p1, p2]: [u16; 2], here: &mut [u16], sums: &mut [u16]) -> u16 {
    let count = costs.len();
    let (left, middle, right) = (&before[..count], &before[1..count + 1], &before[2..count + 2]);
    let here = &mut here[1..count + 1];
    let sums = &mut sums[..count];
    let mut new = u16::MAX;
    for i in 0..count {
        let step = left[i].min(right[i]) + p1;
        let path = middle[i].min(step).min(least + p2) - least + u16::from(costs[i]);
        here[i] = path;
        sums[i] += path;
        new = new.min(path);
    }
    new
}

/// Starts a path at a pixel.
#[inline(always)]
fn begin(costs: &[u8], here: &mut [u16], sums: &mut [u16]) -> u16 {
    let mut least = u16::MAX;
    for ((here, sum), &cost) in here[1..].iter_mut().zip(sums).zip(costs) {
        *here = u16::from(cost);
        *sum += *here;
        least = least.min(*here);
    }
    least
}

/// Computes the paths from the left and from the right in a row.
struct AlongRow<'a> {
    strip: &'a Strip<'a>,
    y: usize,
    sums: &'a mut [u16],
    paths: &'a mut [Vec<u16>; 2],
}

impl Loops for AlongRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let AlongRow { strip, y, .. } = self;
        let (width, labels, grey) = (strip.volume.width, strip.volume.labels, strip.grey(y));
        let [before, here] = self.paths;
        for is_from_left in [true, false] {
            let mut least = 0;
            for i in 0..width {
                let x = if is_from_left { i } else { width - 1 - i };
                let costs = strip.costs(x, y);
                let sums = &mut self.sums[x * labels..(x + 1) * labels];
                least = if i == 0 {
                    begin(costs, here, sums)
                } else {
                    let last = if is_from_left { x - 1 } else { x + 1 };
                    let penalties = penalties(strip.volume.scale, grey[x], grey[last]);
                    extend(costs, before, least, penalties, here, sums)
                };
                std::mem::swap(before, here);
            }
        }
    }
}

/// The path costs of a row.
#[derive(Clone)]
struct Paths {
    /// Path costs, with walls, for each pixel.
    costs: Vec<u16>,
    /// The least of them, for each pixel.
    least: Vec<u16>,
}

/// A row whose paths are computed.
struct Row<'a> {
    strip: &'a Strip<'a>,
    y: usize,
    /// The row from which the paths come; none at the first row.
    y_before: Option<usize>,
    slant: isize,
}

/// Some pixels of a [`Row`].
struct Block<'a> {
    row: &'a Row<'a>,
    /// The first pixel.
    x: usize,
    before: &'a Paths,
    costs: &'a mut [u16],
    least: &'a mut [u16],
    sums: &'a mut [u16],
}

impl Loops for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Row { strip, y, y_before, slant } = *self.row;
        let (labels, scale, grey) = (strip.volume.labels, strip.volume.scale, strip.grey(y));
        let grey_before = y_before.map(|y| strip.grey(y));
        let stride = labels + 2;
        let paths = self.costs.chunks_exact_mut(stride).zip(self.least.iter_mut());
        for ((i, (here, least)), sums) in paths.enumerate().zip(self.sums.chunks_exact_mut(labels)) {
            let x = self.x + i;
            let costs = strip.costs(x, y);
            let last = x.wrapping_add_signed(-slant);
            *least = match grey_before.and_then(|grey| grey.get(last)) {
                Some(&before) => {
                    let penalties = penalties(scale, grey[x], before);
                    let before = &self.before.costs[last * stride..(last + 1) * stride];
                    extend(costs, before, self.before.least[last], penalties, here, sums)
                }
                None => begin(costs, here, sums),
            };
        }
    }
}
