//! The features of a frame: of its grey picture, and of its threshold bitmaps.
//!
//! In: a level of a grey pyramid. Out: [`FeatureSets`]. Cost: a run of [`sift`] over the level, one over a quarter of
//! its samples for each bitmap.

use crate::align::features::duplicates::KeypointIndex;
use crate::align::features::keypoint::{Features, Keypoint};
use crate::align::features::sift::{self, SiftOptions};
use crate::align::grey::GreyPyramid;
use crate::align::result::KeypointCounts;
use crate::plane::Plane;
use crate::pyramid::gaussian;
use rayon::prelude::*;

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
        let mut index = KeypointIndex::default();
        let mut all = Vec::with_capacity(self.counts.mtb);
        for set in &self.mtb {
            all.extend(set.keypoints.iter().filter(|k| !index.has(k)).copied());
            index.add(&set.keypoints);
        }
        all
    }
}

/// Which of `points` are also among `others`: within a pixel, and of like scale.
pub(crate) fn found_among(points: &[Keypoint], others: &[Keypoint]) -> Vec<bool> {
    let mut index = KeypointIndex::default();
    index.add(others);
    points.iter().map(|k| index.has(k)).collect()
}

/// Percent of the pixels that are not above the threshold of each bitmap: Ward's 17, 50 and 83, those halfway, and two
/// beyond.
pub(super) const PERCENTILES: [u64; 7] = [6, 17, 33, 50, 67, 83, 94];

/// Smoothing before the threshold, in pixels: it takes the grain off the bitmap's edges.
const SMOOTHING: f64 = 0.7;

/// The features of a frame, on level `level` of its pyramid.
pub(crate) fn features(pyramid: &GreyPyramid, level: usize, sift: &SiftOptions, exclusion: u8) -> FeatureSets {
    let grey = pyramid.level(level);
    let smooth = smoothed(grey);
    // What is finer than a pixel in a bitmap is the staircase of its edges: it is not doubled.
    let coarse = SiftOptions { double: false, ..sift.clone() };
    let (plain, mtb) = rayon::join(
        || sift::detect(grey, sift),
        || -> Vec<Features> {
            let at = |t: &f32| sift::detect(&bitmap(&smooth, *t, exclusion), &coarse);
            thresholds(&smooth).par_iter().map(at).collect()
        },
    );
    FeatureSets { counts: count(&plain, &mtb), plain, mtb }
}

pub(super) fn smoothed(grey: &Plane<u8>) -> Plane<f32> {
    let codes = Plane::from_rows(grey.width(), grey.height(), |y, row| {
        for (v, g) in row.iter_mut().zip(grey.row(y)) {
            *v = f32::from(*g);
        }
    });
    gaussian(&codes, SMOOTHING)
}

/// Steps of a grey value to which a threshold is known: in a dark frame all percentiles may lie within two or three
/// levels.
const STEPS: f32 = 16.0;

/// The level at each of [`PERCENTILES`].
pub(super) fn thresholds(smooth: &Plane<f32>) -> [f32; PERCENTILES.len()] {
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

/// The bitmap at `threshold` as a picture: black below, white above. Within half the exclusion to either side, where
/// noise would decide (Ward's exclusion bitmap), it goes from one to the other in proportion: noise makes no contrast
/// there, and an edge keeps its place.
pub(super) fn bitmap(smooth: &Plane<f32>, threshold: f32, exclusion: u8) -> Plane<u8> {
    let slope = 255.0 / f32::from(exclusion.max(1));
    Plane::from_rows(smooth.width(), smooth.height(), |y, row| {
        for (b, v) in row.iter_mut().zip(smooth.row(y)) {
            *b = ((v - threshold) * slope + 128.0).clamp(0.0, 255.0) as u8;
        }
    })
}

/// How many points there are of each kind; those of several bitmaps, and those of both kinds, counted once.
pub(super) fn count(plain: &Features, mtb: &[Features]) -> KeypointCounts {
    let (mut of_bitmaps, mut of_all) = (KeypointIndex::default(), KeypointIndex::default());
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
