//! The features of a frame, which come from its grey image and from its threshold bitmaps.
//!
//! In: a level of a grey pyramid and a [`Detector`]. Out: [`FeatureSets`]. Cost: one run of the detector on the level,
//! and one on each bitmap, which has a quarter as many samples.

use crate::align::features::duplicates::KeypointIndex;
use crate::align::features::keypoint::{Features, Keypoint};
use crate::align::features::sift::{self, SiftOptions};
use crate::align::features::surf::{self, SurfOptions};
use crate::align::grey::GreyPyramid;
use crate::align::result::KeypointCounts;
use crate::plane::Plane;
use crate::pyramid::gaussian;
use rayon::prelude::*;

/// A detector of features, with its options.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Detector {
    Sift(SiftOptions),
    Surf(SurfOptions),
}

impl Detector {
    fn detect(&self, grey: &Plane<u8>) -> Features {
        match self {
            Detector::Sift(options) => sift::detect(grey, options),
            Detector::Surf(options) => surf::detect(grey, options),
        }
    }

    /// Returns the detector for bitmaps. It does not double them, because the only detail of a bitmap smaller than a
    /// pixel is the staircase of its edges.
    ///
    /// SURF's box filters respond to this staircase, too. Therefore SURF needs twice the contrast in a bitmap. Its
    /// threshold is four times as large, because the determinant grows with the square of the contrast. This halves the
    /// number of keypoints.
    fn for_bitmaps(&self) -> Self {
        match self {
            Detector::Sift(options) => Detector::Sift(SiftOptions { double: false, ..options.clone() }),
            Detector::Surf(options) => {
                Detector::Surf(SurfOptions { double: false, contrast: 4.0 * options.contrast, ..options.clone() })
            }
        }
    }
}

/// Features of a frame: of the grey image, and of its threshold bitmaps.
#[derive(Debug, Clone, Default)]
pub(crate) struct FeatureSets {
    pub(crate) plain: Features,
    /// The features of the bitmap at each of [`PERCENTILES`].
    pub(crate) mtb: Vec<Features>,
    pub(crate) counts: KeypointCounts,
}

impl FeatureSets {
    /// Returns the keypoints of all bitmaps. A keypoint that is found in several bitmaps is listed once.
    pub(crate) fn of_bitmaps(&self) -> Vec<Keypoint> {
        additional(&[], &self.mtb)
    }
}

/// Returns the keypoints of `sets` that are neither in `known` nor in an earlier one of `sets`.
fn additional(known: &[Keypoint], sets: &[Features]) -> Vec<Keypoint> {
    let mut index = KeypointIndex::default();
    index.add(known);
    let mut found = Vec::new();
    for set in sets {
        found.extend(set.keypoints.iter().filter(|k| !index.has(k)).copied());
        index.add(&set.keypoints);
    }
    found
}

/// Returns whether `others` has the same keypoint (within a pixel, and of similar scale), for each of `points`.
pub(crate) fn found_among(points: &[Keypoint], others: &[Keypoint]) -> Vec<bool> {
    let mut index = KeypointIndex::default();
    index.add(others);
    points.iter().map(|k| index.has(k)).collect()
}

/// Percentiles of the bitmaps' thresholds: Ward's 17, 50 and 83, two more between them, and one beyond each end.
pub(super) const PERCENTILES: [u64; 7] = [6, 17, 33, 50, 67, 83, 94];

/// Standard deviation of the smoothing before the threshold, in pixels. It removes noise from the edges of the bitmaps.
const SMOOTHING: f64 = 0.7;

/// Detects the features of a frame on level `level` of its pyramid.
pub(crate) fn features(pyramid: &GreyPyramid, level: usize, detector: &Detector, exclusion: u8) -> FeatureSets {
    let grey = pyramid.level(level);
    let smooth = smoothed(grey);
    let for_bitmaps = detector.for_bitmaps();
    let (plain, mtb) = rayon::join(
        || detector.detect(grey),
        || -> Vec<Features> {
            let at = |t: &f32| for_bitmaps.detect(&bitmap(&smooth, *t, exclusion));
            thresholds(&smooth).par_iter().map(at).collect()
        },
    );
    FeatureSets { counts: count(&plain, &mtb), plain, mtb }
}

/// Returns `grey` as floats, smoothed against noise.
pub(super) fn smoothed(grey: &Plane<u8>) -> Plane<f32> {
    gaussian(&grey.map(f32::from), SMOOTHING)
}

/// Number of histogram bins per grey value. One bin would be too coarse: in a dark frame, all percentiles may lie
/// within two or three grey values.
const STEPS: f32 = 16.0;

/// Returns the grey value at each of [`PERCENTILES`].
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

/// Returns the bitmap at `threshold` as a grey image: black below the threshold, white above it.
///
/// Near the threshold, noise would decide between black and white. Ward excludes these pixels. Here the grey values
/// within `exclusion` / 2 of the threshold become a linear ramp from black to white instead. There, noise causes little
/// contrast, and edges keep their positions.
pub(super) fn bitmap(smooth: &Plane<f32>, threshold: f32, exclusion: u8) -> Plane<u8> {
    let slope = 255.0 / f32::from(exclusion.max(1));
    Plane::from_rows(smooth.width(), smooth.height(), |y, row| {
        for (b, v) in row.iter_mut().zip(smooth.row(y)) {
            *b = ((v - threshold) * slope + 128.0).clamp(0.0, 255.0) as u8;
        }
    })
}

/// Returns three numbers of keypoints: in the grey image, in the bitmaps, and in both together. A keypoint that is
/// found in several of these pictures counts once.
pub(super) fn count(plain: &Features, mtb: &[Features]) -> KeypointCounts {
    KeypointCounts {
        plain: plain.len(),
        mtb: additional(&[], mtb).len(),
        merged: plain.len() + additional(&plain.keypoints, mtb).len(),
    }
}
