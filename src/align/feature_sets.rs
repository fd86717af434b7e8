//! The features of a frame, of two kinds: of the plain picture, and of its threshold bitmaps; and the motion between two frames on which
//! both kinds agree.
//!
//! In: grey pyramids. Out: [`FeatureSets`], and of two of them a [`Consensus`]. Cost: a run of [`sift`] over the level on which features
//! are sought, one over a quarter of its samples for each bitmap; for a pair of frames three tables of matches, two of them guided, and
//! [`ransac`] or [`lmeds`]. Source: the thesis, section 4.3 (keypoints of the median threshold bitmap are many where the plain picture is
//! dark or bright and has few; both together are always enough).
//!
//! One bitmap has edges at one grey level, and in a dark frame it may lie where there is only noise. There are seven, at fixed
//! percentiles, Ward's three among them: whatever the exposures, two frames have some in common that say something in both, and as each
//! is matched with its like alone, no match can join two that cannot be the same.

use crate::align::bitmaps::MtbOptions;
use crate::align::features::{Features, Guide, Keypoint, match_mutual};
use crate::align::grey::GreyPyramid;
use crate::align::homography::{Pair, fit};
use crate::align::lmeds;
use crate::align::ransac::{self, Consensus, RansacOptions, distance_squared};
use crate::align::result::KeypointCounts;
use crate::align::sift::{self, SiftOptions};
use crate::align::transform::map;
use crate::align::{AlignOptions, RobustMethod};
use crate::plane::Plane;
use crate::pyramid::gaussian;
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Features of a frame: of the plain picture, and of its threshold bitmaps.
#[derive(Debug, Clone, Default)]
pub(crate) struct FeatureSets {
    pub(crate) plain: Features,
    /// One set for each of [`PERCENTILES`].
    pub(crate) mtb: Vec<Features>,
    pub(crate) counts: KeypointCounts,
}

impl FeatureSets {
    /// The keypoints of the bitmaps; what several have, once, as they are counted.
    pub(crate) fn of_bitmaps(&self) -> Vec<Keypoint> {
        let mut places = Places::default();
        let mut all = Vec::with_capacity(self.counts.mtb);
        for set in &self.mtb {
            all.extend(set.keypoints.iter().filter(|k| !places.has(k)).copied());
            places.add(&set.keypoints);
        }
        all
    }
}

/// Which of `points` are also among `others`: within a pixel, and of like scale.
pub(crate) fn found_among(points: &[Keypoint], others: &[Keypoint]) -> Vec<bool> {
    let mut places = Places::default();
    places.add(others);
    points.iter().map(|k| places.has(k)).collect()
}

/// The matches of all sets by the ratio alone, in pixels of the full size.
pub(crate) fn pairs(reference: &FeatureSets, frame: &FeatureSets, to_full: &Matrix3<f64>, ratio: f64) -> Vec<Pair> {
    Matches::new(reference, frame, to_full, ratio, None).pairs
}

/// Percent of the pixels that are not above the threshold of each bitmap: Ward's 17, 50 and 83, those halfway, and two beyond.
const PERCENTILES: [u64; 7] = [6, 17, 33, 50, 67, 83, 94];
/// Smoothing before the threshold, in pixels: it takes the grain off the bitmap's edges.
const SMOOTHING: f64 = 0.7;

/// The features of a frame, on level `level` of its pyramid.
pub(crate) fn features(pyramid: &GreyPyramid, level: usize, sift: &SiftOptions, mtb: &MtbOptions) -> FeatureSets {
    let grey = pyramid.level(level);
    let smooth = smoothed(grey);
    // What is finer than a pixel in a bitmap is the staircase of its edges: it is not doubled.
    let coarse = SiftOptions { double: false, ..sift.clone() };
    let (plain, mtb) = rayon::join(
        || sift::detect(grey, sift),
        || -> Vec<Features> {
            let at = |t: &f32| sift::detect(&bitmap(&smooth, *t, mtb.exclusion), &coarse);
            thresholds(&smooth).par_iter().map(at).collect()
        },
    );
    FeatureSets { counts: count(&plain, &mtb), plain, mtb }
}

fn smoothed(grey: &Plane<u8>) -> Plane<f32> {
    let codes = Plane::from_rows(grey.width(), grey.height(), |y, row| {
        for (v, g) in row.iter_mut().zip(grey.row(y)) {
            *v = f32::from(*g);
        }
    });
    gaussian(&codes, SMOOTHING)
}

/// Steps of a grey level to which a threshold is known: in a dark frame all percentiles may lie within two or three levels.
const STEPS: f32 = 16.0;

/// The level at each of [`PERCENTILES`].
fn thresholds(smooth: &Plane<f32>) -> [f32; PERCENTILES.len()] {
    let mut counts = [0u64; 256 * STEPS as usize];
    let most = counts.len() - 1;
    for v in smooth.as_slice() {
        counts[((v * STEPS) as usize).min(most)] += 1;
    }
    let total: u64 = counts.iter().sum();
    PERCENTILES.map(|percent| {
        let mut below = 0;
        let reached = counts.iter().position(|n| {
            below += n;
            below * 100 >= total * percent
        });
        (reached.unwrap_or(most) as f32 + 0.5) / STEPS
    })
}

/// The bitmap at `threshold` as a picture: black below, white above. Within half the exclusion to either side, where noise would decide
/// (Ward's exclusion bitmap), it goes from one to the other in proportion: noise makes no contrast there, and an edge keeps its place.
fn bitmap(smooth: &Plane<f32>, threshold: f32, exclusion: u8) -> Plane<u8> {
    let slope = 255.0 / f32::from(exclusion.max(1));
    Plane::from_rows(smooth.width(), smooth.height(), |y, row| {
        for (b, v) in row.iter_mut().zip(smooth.row(y)) {
            *b = ((v - threshold) * slope + 128.0).clamp(0.0, 255.0) as u8;
        }
    })
}

/// How many points there are of each kind; those of several bitmaps, and those of both kinds, counted once.
fn count(plain: &Features, mtb: &[Features]) -> KeypointCounts {
    let (mut of_bitmaps, mut of_all) = (Places::default(), Places::default());
    let mut counts = KeypointCounts { plain: plain.len(), mtb: 0, merged: plain.len() };
    of_all.add(&plain.keypoints);
    for set in mtb {
        counts.mtb += of_bitmaps.new_among(&set.keypoints);
        counts.merged += of_all.new_among(&set.keypoints);
        of_bitmaps.add(&set.keypoints);
        of_all.add(&set.keypoints);
    }
    counts
}

/// What lies at the points of a picture, by the square of 2 x 2 pixels that each lies in.
struct Squares<T>(BTreeMap<(i64, i64), Vec<T>>);

impl<T> Default for Squares<T> {
    fn default() -> Self {
        Squares(BTreeMap::new())
    }
}

impl<T> Squares<T> {
    fn square(k: &Keypoint) -> (i64, i64) {
        ((k.x / 2.0).floor() as i64, (k.y / 2.0).floor() as i64)
    }

    fn add(&mut self, at: &Keypoint, what: T) {
        self.0.entry(Self::square(at)).or_default().push(what);
    }

    /// All that may lie within two pixels of `point`.
    fn about(&self, point: &Keypoint) -> impl Iterator<Item = &T> {
        let (cx, cy) = Self::square(point);
        let squares = (cy - 1..=cy + 1).flat_map(move |y| (cx - 1..=cx + 1).map(move |x| (x, y)));
        squares.filter_map(|at| self.0.get(&at)).flatten()
    }
}

/// Whether two keypoints lie within `radius` pixels of each other.
fn are_within(radius: f32, a: &Keypoint, b: &Keypoint) -> bool {
    let (dx, dy) = (a.x - b.x, a.y - b.y);
    dx * dx + dy * dy <= radius * radius
}

/// Keypoints by where they lie.
#[derive(Default)]
struct Places(Squares<Keypoint>);

impl Places {
    fn add(&mut self, points: &[Keypoint]) {
        points.iter().for_each(|k| self.0.add(k, *k));
    }

    /// How many of `points` are not there yet.
    fn new_among(&self, points: &[Keypoint]) -> usize {
        points.iter().filter(|k| !self.has(k)).count()
    }

    /// Whether there is a point within a pixel of `point`, and of like scale.
    fn has(&self, point: &Keypoint) -> bool {
        let is_same =
            |k: &Keypoint| are_within(1.0, k, point) && k.scale < 1.3 * point.scale && point.scale < 1.3 * k.scale;
        self.0.about(point).any(is_same)
    }
}

/// Pairs of keypoints by where the first of each lies.
#[derive(Default)]
struct Joined(Squares<(Keypoint, Keypoint)>);

impl Joined {
    /// Adds the pair of `a` and `b`, unless there is one that joins the same two places: a point found in several pictures, or with two
    /// directions, is one inlier or none. Returns whether it was added.
    fn add(&mut self, a: &Keypoint, b: &Keypoint) -> bool {
        let is_same = |(c, d): &(Keypoint, Keypoint)| are_within(ONE_PLACE, a, c) && are_within(ONE_PLACE, b, d);
        let is_new = !self.0.about(a).any(is_same);
        if is_new {
            self.0.add(a, (*a, *b));
        }
        is_new
    }
}

/// Keypoints no farther apart are at one place, in pixels of the level: about twice what each is off ([`KEYPOINT_PX`]).
const ONE_PLACE: f32 = 1.5;

/// The homography that the matches of all sets agree on, in pixels of the full size, and those that do; sought again among the matches
/// near the places that it gives, where what repeats elsewhere no longer competes (Hartley & Zisserman 2004, algorithm 4.6).
pub(crate) fn by_matches(
    reference: &FeatureSets,
    frame: &FeatureSets,
    to_full: &Matrix3<f64>,
    options: &AlignOptions,
) -> Option<Consensus> {
    let pixel = to_full[(0, 0)];
    let in_full = RansacOptions { threshold: options.ransac.threshold * pixel, ..options.ransac.clone() };
    let search = |matches: &Matches| agreed(&matches.pairs, &in_full, options.robust);
    let mut matches = Matches::new(reference, frame, to_full, options.ratio, None);
    let mut best = search(&matches)?;
    if best.inliers.len() < LEAST_GUIDES {
        return Some(best);
    }
    // The nearer the place is known, the less it takes to be the right one.
    for (radius, ratio) in [(WIDE_PX, options.ratio), (NARROW_PX, 0.5 * (1.0 + options.ratio))] {
        let guide = Guide { motion: to_full.try_inverse()? * best.homography * to_full, radius };
        let guided = Matches::new(reference, frame, to_full, ratio, Some(&guide));
        if let Some(found) = search(&guided).filter(|f| f.inliers.len() > best.inliers.len()) {
            (matches, best) = (guided, found);
        }
    }
    Some(matches.settle(best, pixel))
}

/// The motion on which most of `pairs` agree, by `method`.
pub(crate) fn agreed(pairs: &[Pair], options: &RansacOptions, method: RobustMethod) -> Option<Consensus> {
    match method {
        RobustMethod::Ransac => ransac::search(pairs, options),
        RobustMethod::Lmeds => lmeds::search(pairs, options),
    }
}

/// Where fewer agree it may be by chance, and a guide made of them would find others that do.
const LEAST_GUIDES: usize = 8;
/// How far from its place a guided match may lie, in pixels of the level: some times what makes it an inlier.
const WIDE_PX: f64 = 10.0;
/// ... and once more, when the place is known better.
const NARROW_PX: f64 = 6.0;
/// How far a keypoint of scale 1 is off, in pixels of the level; one of scale s is by the square root of that as much. Measured on rendered
/// brackets.
const KEYPOINT_PX: f64 = 0.6;
/// Refits by which the weights settle.
const REFITS: usize = 8;

/// The matches of all sets.
struct Matches {
    /// In pixels of the full size.
    pairs: Vec<Pair>,
    /// The larger scale of each pair's points, at least 1, in pixels of the level.
    scales: Vec<f64>,
}

impl Matches {
    fn new(
        reference: &FeatureSets,
        frame: &FeatureSets,
        to_full: &Matrix3<f64>,
        ratio: f64,
        guide: Option<&Guide>,
    ) -> Self {
        let full = |k: &Keypoint| {
            let (x, y) = map(to_full, k.x.into(), k.y.into());
            [x, y]
        };
        let plain = [(&reference.plain, &frame.plain)];
        let mut joined = Joined::default();
        let (pairs, scales) = plain
            .into_iter()
            .chain(reference.mtb.iter().zip(&frame.mtb))
            .flat_map(|(a, b)| {
                let matches = match_mutual(a, b, ratio, guide);
                matches.into_iter().map(|m| (&a.keypoints[m.reference], &b.keypoints[m.frame]))
            })
            .filter(|(a, b)| joined.add(a, b))
            .map(|(a, b)| ((full(a), full(b)), f64::from(a.scale.max(b.scale)).max(1.0)))
            .unzip();
        Matches { pairs, scales }
    }

    /// `found`, fitted once more to those that agree, each by how well its keypoints are placed: a large one is placed less well, and one
    /// that is far off counts less (weights of Geman & McClure). `pixel` is the width of a pixel of the level.
    fn settle(&self, found: Consensus, pixel: f64) -> Consensus {
        let right: Vec<Pair> = found.inliers.iter().map(|&i| self.pairs[i]).collect();
        let squares = |h: &Matrix3<f64>| -> Vec<f64> { right.iter().map(|p| distance_squared(h, p)).collect() };
        let mut homography = found.homography;
        for _ in 0..REFITS {
            let weights: Vec<f64> = squares(&homography)
                .iter()
                .zip(&found.inliers)
                .map(|(square, &i)| {
                    let variance = KEYPOINT_PX * KEYPOINT_PX * pixel * pixel * self.scales[i];
                    let near = 1.0 / (1.0 + square / variance);
                    near * near / self.scales[i]
                })
                .collect();
            let Some(better) = fit(&right, Some(&weights)) else {
                break;
            };
            homography = better;
        }
        let rms = (squares(&homography).iter().sum::<f64>() / right.len() as f64).sqrt();
        Consensus { homography, rms, ..found }
    }
}

#[cfg(test)]
mod tests;
