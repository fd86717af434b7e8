//! Median threshold bitmaps: the shift and the rotation between two exposures, from where they are brighter than their medians.
//!
//! In: the grey pyramids of two frames. Out: an [`MtbMatch`]: the motion reference -> frame to a fraction of a pixel, and the share of
//! pixels that still differ. Cost: some tens of packed comparisons at each level; a third more than those at the finest for all of them.
//! Source: Ward 2003, section 2; the rotation search that alternates with the shift search is the thesis's (chapter 4), made
//! continuous by interpolating the XOR counts.

use super::bitmap::{Difference, Motion, ThresholdBitmaps, difference_in_circle, difference_shifted};
use super::warp::Warp;
use crate::plane::Plane;
use crate::pyramid;

/// How the bitmaps are made and searched.
#[derive(Debug, Clone, PartialEq)]
pub struct MtbOptions {
    /// The largest rotation sought, in degrees to either side.
    pub max_rotation_deg: f64,
    /// The largest shift sought at the coarsest level, as a share of the long side.
    pub max_shift: f64,
    /// Grey levels on either side of the threshold in which pixels do not count (Ward: 4).
    pub exclusion: u8,
}

impl Default for MtbOptions {
    fn default() -> Self {
        MtbOptions { max_rotation_deg: 5.0, max_shift: 0.15, exclusion: 4 }
    }
}

/// Short side of the coarsest level, in pixels: large enough for a bitmap to have shape, small enough to search every shift.
const COARSEST: usize = 32;

/// The percentile of the grey levels that is the threshold: the median, or where that is too extreme another (Ward: the 17th or 83rd).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Percentile(u8);

impl Percentile {
    /// The median.
    pub const MEDIAN: Percentile = Percentile(50);

    /// The one that `percent` of the pixels do not exceed, 1..=99.
    pub const fn new(percent: u8) -> Self {
        Percentile(if percent < 1 {
            1
        } else if percent > 99 {
            99
        } else {
            percent
        })
    }
}

/// Where the median is black or burnt out in one of two frames, another percentile may still part both: those that are tried instead.
const OTHERS: std::ops::RangeInclusive<u8> = 1..=19;

/// How many pixels have each grey level.
#[derive(Debug, Clone)]
pub struct Histogram([u64; 256]);

impl Histogram {
    /// The histogram of `plane`.
    pub fn of(plane: &Plane<u8>) -> Self {
        // Four tables, so that equal neighbours do not wait for each other.
        let mut counts = [[0u32; 256]; 4];
        let mut sum = [0u64; 256];
        for rows in plane.as_slice().chunks(1 << 30) {
            for (i, &v) in rows.iter().enumerate() {
                counts[i % 4][usize::from(v)] += 1;
            }
            for (v, s) in sum.iter_mut().enumerate() {
                *s += counts.iter().map(|c| u64::from(c[v])).sum::<u64>();
            }
            counts = [[0; 256]; 4];
        }
        Histogram(sum)
    }

    fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// The least level that at least `percentile` of the pixels do not exceed.
    pub fn level(&self, percentile: Percentile) -> u8 {
        let wanted = (self.total() * u64::from(percentile.0)).div_ceil(100).max(1);
        let mut below = 0;
        for (v, n) in self.0.iter().enumerate() {
            below += n;
            if below >= wanted {
                return v as u8;
            }
        }
        u8::MAX
    }

    /// Of the pixels that count at this threshold, the share on the side that has fewer: 0 where the bitmap is blank.
    fn balance(&self, percentile: Percentile, exclusion: u8) -> f64 {
        let level = usize::from(self.level(percentile));
        let dark: u64 = self.0[..level.saturating_sub(usize::from(exclusion))].iter().sum();
        let bright: u64 = self.0[(level + usize::from(exclusion) + 1).min(256)..].iter().sum();
        dark.min(bright) as f64 / self.total().max(1) as f64
    }
}

/// A bitmap with a smaller share of its pixels on one side says too little: half of what Ward's outer percentiles can give.
const LEAST_BALANCE: f64 = 0.085;

/// The percentile at which both frames have something to say: the median unless it is too extreme in either, else of every fifth the one
/// that parts both best.
pub fn common_percentile(a: &Histogram, b: &Histogram, exclusion: u8) -> Percentile {
    let balance = |p| a.balance(p, exclusion).min(b.balance(p, exclusion));
    if balance(Percentile::MEDIAN) >= LEAST_BALANCE {
        return Percentile::MEDIAN;
    }
    OTHERS
        .map(|i| Percentile::new(5 * i))
        .fold(Percentile::MEDIAN, |best, p| if balance(p) > balance(best) { p } else { best })
}

/// The percentile at which one frame by itself has something to say.
pub fn own_percentile(histogram: &Histogram, exclusion: u8) -> Percentile {
    common_percentile(histogram, histogram, exclusion)
}

/// The grey pyramid of a frame, the largest level first, and the histogram of each level.
#[derive(Debug, Clone)]
pub struct GreyPyramid {
    levels: Vec<(Plane<u8>, Histogram)>,
}

impl GreyPyramid {
    /// The pyramid of `grey`, down to a short side of about 32 pixels.
    pub fn new(grey: Plane<u8>) -> Self {
        let levels = pyramid::halves(grey, COARSEST);
        GreyPyramid {
            levels: levels
                .into_iter()
                .map(|p| {
                    let h = Histogram::of(&p);
                    (p, h)
                })
                .collect(),
        }
    }

    /// Level `i`, 0 the largest.
    pub fn level(&self, i: usize) -> &Plane<u8> {
        &self.levels[i].0
    }

    /// How many levels there are.
    pub fn len(&self) -> usize {
        self.levels.len()
    }

    /// Never: there is always the full size.
    pub fn is_empty(&self) -> bool {
        self.levels.is_empty()
    }

    /// The histogram of level `i`.
    pub fn histogram(&self, i: usize) -> &Histogram {
        &self.levels[i].1
    }

    /// The bitmaps of level `i` at `percentile`.
    pub fn bitmaps(&self, i: usize, percentile: Percentile, exclusion: u8) -> ThresholdBitmaps {
        let (plane, histogram) = &self.levels[i];
        ThresholdBitmaps::new(plane, histogram.level(percentile), exclusion)
    }
}

/// What the bitmaps say of two frames.
#[derive(Debug, Clone, PartialEq)]
pub struct MtbMatch {
    /// The motion reference -> frame, in pixels of the full size.
    pub motion: Motion,
    /// The threshold used in both.
    pub percentile: Percentile,
    /// Within the inscribed circle, how many pixels differ, at the finest level searched.
    pub difference: Difference,
    /// The same where nothing moves.
    pub difference_unmoved: Difference,
}

impl MtbMatch {
    /// The motion as a warp: the identity where there is none.
    pub fn warp(&self) -> Warp {
        if self.motion == Motion::default() {
            return Warp::Identity;
        }
        Warp::Rigid { dx: self.motion.dx, dy: self.motion.dy, angle: self.motion.angle }
    }
}

/// The motion under which the bitmaps of `reference` and `frame` differ least. `finest` is the largest level searched: 0 for the full size.
pub fn search(reference: &GreyPyramid, frame: &GreyPyramid, finest: usize, options: &MtbOptions) -> MtbMatch {
    let coarsest = reference.len() - 1;
    let finest = finest.min(coarsest);
    let percentile = common_percentile(reference.histogram(finest), frame.histogram(finest), options.exclusion);
    let pair = |level| Pair {
        reference: reference.bitmaps(level, percentile, options.exclusion),
        frame: frame.bitmaps(level, percentile, options.exclusion),
        max_angle: options.max_rotation_deg.to_radians(),
    };
    let mut candidates = pair(coarsest).search_everywhere(options.max_shift);
    let mut here = pair(coarsest);
    for level in (finest..coarsest).rev() {
        here = pair(level);
        for candidate in &mut candidates {
            let doubled = Motion { dx: 2.0 * candidate.dx, dy: 2.0 * candidate.dy, ..*candidate };
            *candidate = here.alternate(doubled);
        }
        here.keep_best(&mut candidates, level);
    }
    let motion = here.interpolate(candidates[0]);
    let scale = (1u64 << finest) as f64;
    MtbMatch {
        motion: Motion { dx: motion.dx * scale, dy: motion.dy * scale, ..motion },
        percentile,
        difference: here.difference(&motion),
        difference_unmoved: here.difference(&Motion::default()),
    }
}

/// Other motions under which the bitmaps nearly agree: what a facade's period or plain surfaces make of the search. At most `most`,
/// the best first, no two alike, all with the rotation of `angle`; sought over all shifts at a level of moderate size.
pub fn rivals(
    reference: &GreyPyramid,
    frame: &GreyPyramid,
    angle: f64,
    most: usize,
    options: &MtbOptions,
) -> Vec<Motion> {
    let level = (0..reference.len())
        .find(|&i| reference.level(i).width().min(reference.level(i).height()) < 2 * RIVALS_SIDE)
        .unwrap_or(reference.len() - 1);
    let percentile = common_percentile(reference.histogram(level), frame.histogram(level), options.exclusion);
    let pair = Pair {
        reference: reference.bitmaps(level, percentile, options.exclusion),
        frame: frame.bitmaps(level, percentile, options.exclusion),
        max_angle: angle.abs(),
    };
    let scale = (1u64 << level) as f64;
    let rated = pair.rate_shifts(angle, pair.reach(options.max_shift));
    let distinct = |a: &Motion, b: &Motion| (a.dx - b.dx).abs().max((a.dy - b.dy).abs()) > 3.5;
    let found = best_distinct(rated, most, distinct);
    found.into_iter().map(|m| Motion { dx: m.dx * scale, dy: m.dy * scale, ..m }).collect()
}

/// The bitmaps of two frames at one level.
struct Pair {
    reference: ThresholdBitmaps,
    frame: ThresholdBitmaps,
    max_angle: f64,
}

impl Pair {
    /// Radius of the inscribed circle, in pixels.
    fn radius(&self) -> f64 {
        self.reference.threshold.width().min(self.reference.threshold.height()) as f64 / 2.0
    }

    fn difference(&self, motion: &Motion) -> Difference {
        difference_in_circle(&self.reference, &self.frame, motion)
    }

    /// The share that differs; 1 where so little can be compared that it says nothing.
    fn rate(&self, motion: &Motion) -> f64 {
        let difference = self.difference(motion);
        let circle = std::f64::consts::PI * self.radius() * self.radius();
        if (difference.compared as f64) < 0.1 * circle { 1.0 } else { difference.rate() }
    }

    /// The largest shift sought along an axis, in pixels of this level.
    fn reach(&self, max_shift: f64) -> i64 {
        let bitmap = &self.reference.threshold;
        libm::ceil(max_shift * bitmap.width().max(bitmap.height()) as f64) as i64
    }

    /// The share that differs at every whole shift up to `reach`, turned by `angle`.
    fn rate_shifts(&self, angle: f64, reach: i64) -> Vec<(f64, Motion)> {
        let area = (self.reference.threshold.width() * self.reference.threshold.height()) as f64;
        let mut rated = Vec::with_capacity((2 * reach + 1).pow(2) as usize);
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let motion = Motion { dx: dx as f64, dy: dy as f64, angle };
                // Without a rotation the corners can speak as well.
                let rate = if angle == 0.0 {
                    let difference = difference_shifted(&self.reference, &self.frame, dx, dy);
                    if (difference.compared as f64) < LEAST_COMPARED * area { 1.0 } else { difference.rate() }
                } else {
                    self.rate(&motion)
                };
                rated.push((rate, motion));
            }
        }
        rated
    }

    /// Every whole shift within reach, at every angle that moves the circle's rim by a pixel: the best few that are not neighbours.
    fn search_everywhere(&self, max_shift: f64) -> Vec<Motion> {
        let step = 1.0 / self.radius();
        let turns = libm::floor(self.max_angle / step) as i64;
        let reach = self.reach(max_shift);
        let rated = (-turns..=turns).flat_map(|turn| self.rate_shifts(turn as f64 * step, reach)).collect();
        best_distinct(rated, BEAM, |a, b| {
            (a.dx - b.dx).abs().max((a.dy - b.dy).abs()) > 1.5 || (a.angle - b.angle).abs() > 1.5 * step
        })
    }

    /// Shift and rotation in turn, from `start`, until neither changes: the nine neighbours, then the angles that move the rim by
    /// half a pixel and by a pixel.
    fn alternate(&self, start: Motion) -> Motion {
        let step = 0.5 / self.radius();
        let mut best = (self.rate(&start), start);
        // Each round that goes on lowers the rate, so this ends; the bound is for plateaus of noise.
        for _ in 0..8 {
            let before = best.1;
            for _ in 0..4 {
                let centre = best.1;
                for (dx, dy) in NEIGHBOURS {
                    self.try_motion(&mut best, Motion { dx: centre.dx + dx, dy: centre.dy + dy, ..centre });
                }
                if best.1 == centre {
                    break;
                }
            }
            if self.max_angle > 0.0 {
                let centre = best.1;
                for turn in [-2.0, -1.0, 1.0, 2.0] {
                    self.try_motion(&mut best, Motion { angle: centre.angle + turn * step, ..centre });
                }
            }
            if best.1.angle == before.angle {
                break;
            }
        }
        best.1
    }

    fn try_motion(&self, best: &mut (f64, Motion), motion: Motion) {
        if motion.angle.abs() <= self.max_angle {
            let rate = self.rate(&motion);
            if rate < best.0 {
                *best = (rate, motion);
            }
        }
    }

    /// Orders the candidates by what still differs and drops those that are worse by far, all but one from the third level on.
    fn keep_best(&self, candidates: &mut Vec<Motion>, level: usize) {
        let mut rated: Vec<(f64, Motion)> = candidates.iter().map(|m| (self.rate(m), *m)).collect();
        rated.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| smaller(&a.1, &b.1)));
        let keep = if level == 0 || self.radius() >= 100.0 { 1 } else { BEAM / 2 };
        *candidates = rated.into_iter().take(keep).map(|(_, m)| m).collect();
    }

    /// The lowest point between the steps, along each axis by itself, as they are nearly independent.
    fn interpolate(&self, start: Motion) -> Motion {
        let turn = 1.0 / self.radius();
        let angle =
            if self.max_angle > 0.0 { self.vertex(|t| Motion { angle: start.angle + t * turn, ..start }) } else { 0.0 };
        let turned = Motion { angle: start.angle + angle * turn, ..start };
        let dx = self.vertex(|t| Motion { dx: turned.dx + t, ..turned });
        let dy = self.vertex(|t| Motion { dy: turned.dy + t, ..turned });
        let motion = Motion { dx: turned.dx + dx, dy: turned.dy + dy, ..turned };
        // No motion stays exactly no motion unless moving measurably helps.
        if self.rate(&Motion::default()) <= self.rate(&motion) { Motion::default() } else { motion }
    }

    /// Where on -1..=1 the rate is lowest. Two pictures of one scene differ in proportion to how far they are displaced, so
    /// r(t) = r0 + s |t - t0| near the lowest point; with r at -2, -1, 1, 2, s = (r2 + r-2 - r1 - r-1) / 2 and
    /// t0 = (r-2 + r-1 - r1 - r2) / (4 s), exactly so for |t0| <= 1.
    fn vertex(&self, along: impl Fn(f64) -> Motion) -> f64 {
        let [far_left, left, right, far_right] = [-2.0, -1.0, 1.0, 2.0].map(|t| self.rate(&along(t)));
        let slope = (far_right + far_left - right - left) / 2.0;
        if slope <= 0.0 { 0.0 } else { ((far_left + left - right - far_right) / (4.0 * slope)).clamp(-1.0, 1.0) }
    }
}

/// Where a smaller share of the pixels can be compared, the rate says nothing.
const LEAST_COMPARED: f64 = 0.1;

/// Short side of the level on which rivals are sought, in pixels: fine enough for the periods of facades.
const RIVALS_SIDE: usize = 128;

/// Candidates followed from the coarsest level on.
const BEAM: usize = 6;

const NEIGHBOURS: [(f64, f64); 8] =
    [(-1.0, -1.0), (0.0, -1.0), (1.0, -1.0), (-1.0, 0.0), (1.0, 0.0), (-1.0, 1.0), (0.0, 1.0), (1.0, 1.0)];

/// The best `most` of the rated motions of which each is `distinct` from those before it.
fn best_distinct(
    mut rated: Vec<(f64, Motion)>,
    most: usize,
    distinct: impl Fn(&Motion, &Motion) -> bool,
) -> Vec<Motion> {
    rated.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| smaller(&a.1, &b.1)));
    let mut kept: Vec<Motion> = Vec::with_capacity(most);
    for (_, motion) in rated {
        if kept.len() < most && kept.iter().all(|k| distinct(k, &motion)) {
            kept.push(motion);
        }
    }
    kept
}

/// Of equal rates the smaller motion comes first.
fn smaller(a: &Motion, b: &Motion) -> std::cmp::Ordering {
    let size = |m: &Motion| m.dx * m.dx + m.dy * m.dy;
    size(a).total_cmp(&size(b)).then(a.angle.abs().total_cmp(&b.angle.abs()))
}

#[cfg(test)]
mod tests;
