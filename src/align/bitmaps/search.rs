//! The search for the motion with the fewest differing pixels between two bitmaps, from the coarsest level down.
//!
//! In: the grey pyramids of two frames. Out: an [`MtbMatch`]; other motions under which the bitmaps nearly agree. Cost:
//! see [`bitmaps`](crate::align::bitmaps).

use crate::align::bitmaps::descent::{Descent, LEAST_COMPARED};
use crate::align::bitmaps::difference::difference_shifted;
use crate::align::bitmaps::threshold::{common_histograms, common_percentile, matched_zones};
use crate::align::bitmaps::{Motion, MtbMatch, MtbOptions, Rounding, ThresholdBitmaps, Zone};
use crate::align::grey::{ENOUGH_PIXELS, GreyPyramid, Histogram, Percentile, level_within};
use crate::plane::Plane;

/// Finds the motion with the fewest differing pixels between the bitmaps of `reference` and `frame`.
///
/// `finest` is the index of the largest level that may be searched. Levels of more than [`ENOUGH_PIXELS`] pixels are
/// skipped, except the coarsest level, which is always searched.
pub fn search(reference: &GreyPyramid, frame: &GreyPyramid, finest: usize, options: &MtbOptions) -> MtbMatch {
    let coarsest = reference.len() - 1;
    let finest = finest.clamp(level_within(reference, ENOUGH_PIXELS), coarsest);
    let max_angle = options.max_rotation_deg.to_radians();
    let mut pair = BitmapPair::new(reference, frame, coarsest, options.exclusion);
    let mut candidates = pair.search_everywhere(options.max_shift, max_angle);
    let mut level = coarsest;
    loop {
        let is_certain = pair.short_side() >= CERTAIN_SIDE || level == finest;
        let mut descent = Descent::new(&pair.reference, &pair.frame, max_angle);
        let rounds = if level == finest { MOST_ROUNDS } else { ROUNDS };
        let turn = 1.0 / descent.arm();
        let distinct = |a: &Motion, b: &Motion| {
            (a.dx - b.dx).abs().max((a.dy - b.dy).abs()) > 1.0 || (a.angle - b.angle).abs() > turn
        };
        if candidates.len() > 1 || !is_certain {
            // Keeps the best two thirds of the candidates. If sub-pixel refinement follows, also drops the candidates
            // whose rate of differing pixels is much higher than the lowest rate: refinement would not reduce it
            // enough.
            let descended: Vec<(f64, Motion)> = candidates.iter().map(|&c| descent.descend_by_pixels(c)).collect();
            let least = descended.iter().fold(f64::INFINITY, |least, (rate, _)| rate.min(least));
            let near = descended.into_iter().filter(|(rate, _)| !is_certain || *rate <= MOST_EXCESS * least).collect();
            candidates = best_distinct(near, (2 * candidates.len()).div_ceil(3), distinct);
        }
        if is_certain {
            for c in &mut candidates {
                *c = descent.descend(*c, rounds);
            }
            if candidates.len() > 1 {
                let refined = candidates.iter().map(|c| (descent.rate(c, Rounding::Dithered), *c)).collect();
                candidates = best_distinct(refined, 1, distinct);
            }
        }
        if level == finest {
            return pair.conclude(&mut descent, candidates[0], level, reference.size(0));
        }
        level -= 1;
        for c in &mut candidates {
            *c = Motion { dx: 2.0 * c.dx, dy: 2.0 * c.dy, ..*c };
        }
        pair = if is_certain {
            let (a, b) = (reference.level(level), frame.level(level));
            let (in_a, in_b) = common_histograms(a, b, &candidates[0]);
            BitmapPair::from_histograms(a, b, (&in_a, &in_b), exclusion_at(level, options.exclusion))
        } else {
            BitmapPair::new(reference, frame, level, options.exclusion)
        };
    }
}

/// Finds further motions under which the bitmaps nearly agree. Such motions exist if facades repeat or surfaces are
/// uniform.
///
/// Tries all shifts within the search range on a level of moderate size, each with a rotation by `angle` radians.
/// Returns at most `most` distinct motions, the best first.
pub fn alternatives(
    reference: &GreyPyramid,
    frame: &GreyPyramid,
    angle: f64,
    most: usize,
    options: &MtbOptions,
) -> Vec<Motion> {
    let level = reference.level_narrower_than(2 * ALTERNATIVES_SIDE);
    let pair = BitmapPair::new(reference, frame, level, options.exclusion);
    let scale = (1u64 << level) as f64;
    let rated = pair.rate_shifts(angle, pair.reach(options.max_shift));
    let distinct = |a: &Motion, b: &Motion| (a.dx - b.dx).abs().max((a.dy - b.dy).abs()) > 3.5;
    let found = best_distinct(rated, most, distinct);
    found.into_iter().map(|m| Motion { dx: m.dx * scale, dy: m.dy * scale, ..m }).collect()
}

/// The bitmaps of two frames on one level, with thresholds at the same radiance.
pub(crate) struct BitmapPair {
    pub(crate) reference: ThresholdBitmaps,
    pub(crate) frame: ThresholdBitmaps,
    pub(crate) percentile: Percentile,
    /// The threshold zones of the reference and of the frame.
    pub(crate) zones: [Zone; 2],
}

impl BitmapPair {
    pub(crate) fn new(reference: &GreyPyramid, frame: &GreyPyramid, level: usize, exclusion: u8) -> Self {
        let exclusion = exclusion_at(level, exclusion);
        let histograms = (reference.histogram(level), frame.histogram(level));
        BitmapPair::from_histograms(reference.level(level), frame.level(level), histograms, exclusion)
    }

    /// Returns the bitmaps of both frames. Each threshold is at the same percentile of the histogram of its frame.
    fn from_histograms(
        reference: &Plane<u8>,
        frame: &Plane<u8>,
        histograms: (&Histogram, &Histogram),
        exclusion: u8,
    ) -> Self {
        let percentile = common_percentile(histograms.0, histograms.1, exclusion);
        let zones = matched_zones(histograms.0, histograms.1, percentile, exclusion);
        BitmapPair {
            reference: ThresholdBitmaps::new(reference, &zones.0),
            frame: ThresholdBitmaps::new(frame, &zones.1),
            percentile,
            zones: [zones.0, zones.1],
        }
    }

    fn size(&self) -> (usize, usize) {
        (self.reference.threshold.width(), self.reference.threshold.height())
    }

    fn short_side(&self) -> usize {
        self.size().0.min(self.size().1)
    }

    /// Returns the largest horizontal and vertical shift that is searched, in pixels of this level.
    ///
    /// The shifts are limited so that the work is at most [`MOST_WORK`] and that the frames still overlap. With the
    /// default `max_shift`, neither limit matters for pictures up to three times as long as wide.
    fn reach(&self, max_shift: f64) -> (i64, i64) {
        let (width, height) = self.size();
        let reach = libm::ceil(max_shift * width.max(height) as f64) as i64;
        let (mut x, mut y) = (reach.min(width as i64 - 1), reach.min(height as i64 - 1));
        let words = ((width.div_ceil(64) + ROW_WORDS) * height) as i64;
        while (2 * x + 1) * (2 * y + 1) * words > MOST_WORK && x.max(y) > 0 {
            if x >= y { x = x * 7 / 8 } else { y = y * 7 / 8 }
        }
        (x, y)
    }

    /// Returns the share of pixels that differ for each whole-pixel shift up to `reach`, after a rotation by `angle`; 1
    /// if too few pixels can be compared.
    fn rate_shifts(&self, angle: f64, reach: (i64, i64)) -> Vec<(f64, Motion)> {
        let (width, height) = self.size();
        let mut turned = ThresholdBitmaps::blank(width, height);
        self.frame.warp_onto(&Motion { angle, ..Motion::default() }, Rounding::Nearest, &mut turned);
        let mut rated = Vec::with_capacity(((2 * reach.0 + 1) * (2 * reach.1 + 1)) as usize);
        for dy in -reach.1..=reach.1 {
            for dx in -reach.0..=reach.0 {
                let difference = difference_shifted(&self.reference, &turned, dx, dy);
                let is_measured = difference.compared as f64 >= LEAST_COMPARED * (width * height) as f64;
                let motion = Motion { angle, ..Motion::default() }.beside(dx, dy);
                rated.push((if is_measured { difference.rate() } else { 1.0 }, motion));
            }
        }
        rated
    }

    /// Returns the best distinct motions among all whole-pixel shifts within [`reach`](Self::reach), each at all
    /// angles.
    ///
    /// The angles are spaced so that each step moves the rim of the inscribed circle by a pixel.
    fn search_everywhere(&self, max_shift: f64, max_angle: f64) -> Vec<Motion> {
        let step = 2.0 / self.short_side() as f64;
        let turns = libm::floor(max_angle / step) as i64;
        let reach = self.reach(max_shift);
        let rated = (-turns..=turns).flat_map(|turn| self.rate_shifts(turn as f64 * step, reach)).collect();
        best_distinct(rated, BEAM, |a, b| {
            (a.dx - b.dx).abs().max((a.dy - b.dy).abs()) > 1.5 || (a.angle - b.angle).abs() > 1.5 * step
        })
    }

    /// Returns the match at full size for the motion `found` on `level`. If this motion is at most [`SIGNIFICANT`]
    /// times its error, returns the match without motion instead.
    fn conclude(&self, descent: &mut Descent, found: Motion, level: usize, full: (usize, usize)) -> MtbMatch {
        let scale = (1u64 << level) as f64;
        let (width, height) = self.size();
        let (mut difference, error) = descent.assess(&found);
        let mut error_px = scale * error;
        // When a level with an odd number of columns or rows is halved, the last one is lost. So the centre of a level,
        // which is the centre of rotation, is not exactly at the centre of the full size.
        let off = |full: usize, here: usize| (scale * here as f64 - full as f64) / 2.0;
        let (x, y) = (off(full.0, width), off(full.1, height));
        let (s, c) = (libm::sin(found.angle), libm::cos(found.angle));
        let mut motion = Motion {
            dx: scale * found.dx + x - (c * x - s * y),
            dy: scale * found.dy + y - (s * x + c * y),
            angle: found.angle,
        };
        let rim = scale * found.angle * descent.arm();
        let moved = (motion.dx * motion.dx + motion.dy * motion.dy + rim * rim).sqrt();
        let difference_unmoved = difference_shifted(&self.reference, &self.frame, 0, 0);
        if moved <= SIGNIFICANT * error_px {
            (motion, difference, error_px) = (Motion::default(), difference_unmoved, error_px.max(moved));
        }
        MtbMatch { motion, error_px, percentile: self.percentile, difference, difference_unmoved }
    }
}

/// Returns the half-width of the exclusion zone on `level`. Every halving of the size halves the noise, but not the
/// rounding to grey values, so the half-width is rounded up.
fn exclusion_at(level: usize, exclusion: u8) -> u8 {
    exclusion.div_ceil(1 << level.min(7))
}

/// A motion of at most this multiple of its error estimate is treated as no motion.
const SIGNIFICANT: f64 = 2.0;

/// Alternatives are usually searched on the level whose short side has at least this many pixels and less than twice as
/// many; in a smaller picture, at full size. It is fine enough for the periods of facades.
const ALTERNATIVES_SIDE: usize = 128;

/// Largest number of bitmap words that are compared for one angle when every shift is tried. It takes some tenths of a
/// second. With the default `max_shift`, a picture reaches this limit only if it is much longer than wide; in
/// [`alternatives`], only if it is more than three times as long as wide.
const MOST_WORK: i64 = 1 << 29;
/// Overhead of starting a row, expressed as the number of words that could be compared in the same time.
const ROW_WORDS: usize = 8;

/// Largest number of candidates that the search on the coarsest level begins with. Each level keeps at most two thirds
/// of its candidates, rounded up; the first level with sub-pixel refinement keeps one.
const BEAM: usize = 9;

/// Before sub-pixel refinement, a candidate is dropped if its rate of differing pixels is more than this multiple of
/// the lowest rate.
const MOST_EXCESS: f64 = 1.5;

/// On levels whose short side has at least this many pixels, motions are refined to fractions of a pixel, and only the
/// best candidate is followed.
const CERTAIN_SIDE: usize = 200;

/// Number of rounds of the descent on each level but the finest.
const ROUNDS: usize = 2;
/// Number of rounds of the descent on the finest level.
const MOST_ROUNDS: usize = 4;

/// Returns the motions with the lowest rates, at most `most`, each of which is `distinct` from all motions returned
/// before it.
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

/// Orders motions of equal rate: the smaller motion comes first.
fn smaller(a: &Motion, b: &Motion) -> std::cmp::Ordering {
    let size = |m: &Motion| m.dx * m.dx + m.dy * m.dy;
    size(a).total_cmp(&size(b)).then(a.angle.abs().total_cmp(&b.angle.abs()))
}

#[cfg(test)]
mod tests;
