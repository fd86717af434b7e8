//! Placing one frame: from the bitmaps, from features, from a neighbour; judged by the pixels; reduced to the smallest model that does.
//!
//! In: the grey pyramids of the reference and a frame, and warps to start from. Out: a [`Candidate`] with its agreement, or none; then
//! the smallest [`Model`] that explains it as well. Cost: that of [`refine`] and [`agreement::measure`] for each start.

use super::agreement::{self, Agreement};
use super::features::{Features, Guide, Keypoint, match_mutual};
use super::homography::Pair;
use super::intensity_map::CommonExposure;
use super::mtb::{self, GreyPyramid, MtbOptions};
use super::ransac::{self, Consensus, RansacOptions};
use super::refine::{refine, restrict};
use super::sift::{self, SiftOptions};
use super::warp::{Warp, corners, map};
use super::{KeypointCounts, Model};
use crate::plane::Plane;
use nalgebra::Matrix3;

/// About so many pixels has the largest level on which pixels are compared: more add nothing but time.
const REFINED_PIXELS: usize = 4_000_000;
/// ... on which agreement is measured, and features are sought.
const MEASURED_PIXELS: usize = 600_000;
/// Smoothing before agreement is measured, in pixels.
const AGREEMENT_SMOOTHING: f64 = 1.0;
/// Levels above the finest from which refinement starts: a warp that is off by 8 px is off by one there.
const CAPTURE_LEVELS: usize = 3;
/// The noise of neighbouring pixels is not independent (smoothing, JPEG, aliasing): what is left is so many times what it would leave if
/// it were. Measured on rendered brackets.
const NOISE_FACTOR: f64 = 4.0;
/// Warps that do the same to the picture within this are the same, in pixels (root mean square over the picture).
const SAME_PX: f64 = 0.03;
/// A smaller model that is so many times farther off, before it is fitted, will not do.
const HOPELESS: f64 = 5.0;
/// A frame whose warp is no more than this is unmoved: resampling would cost more than it mends, in pixels.
const UNMOVED_PX: f64 = 0.2;

/// A warp that was found for a frame, and what speaks for it.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    /// Reference pixel -> frame pixel.
    pub(super) warp: Warp,
    /// The tiles' opinion.
    pub(super) agreement: Agreement,
    /// What noise leaves, and what the tiles see, in pixels of the full size.
    pub(super) error_px: f64,
    /// How far what it was held against can itself be trusted, 0..=1.
    pub(super) trust: f64,
    /// An error at which the warp is half as good, in pixels: [`TOLERANCE_PX`] for a picture of up to 2000 pixels across, more for a larger.
    pub(super) tolerance_px: f64,
    /// Whether features, by themselves, led to the same place.
    pub(super) corroborated: bool,
}

impl Candidate {
    /// 0..=1: how much the tiles speak for it, less where they see it off by half a pixel or more.
    pub(super) fn confidence(&self) -> f64 {
        let off = self.error_px / self.tolerance_px;
        let tiles = self.agreement.share() * self.agreement.coverage();
        let word = if self.corroborated { tiles.max(TWO_WITNESSES) } else { tiles };
        self.trust * word / (1.0 + off * off)
    }

    /// Whether nothing more need be tried: nearly all tiles confirm, many of them, and none of them is off.
    pub(super) fn is_settled(&self) -> bool {
        let spoke = self.agreement.confirm + self.agreement.contradict;
        self.agreement.confirm >= 12 && self.agreement.contradict * 40 <= spoke && self.error_px < 0.5
    }
}

/// The frame on the reference's grid, that lies in it by `warp`; its border goes on where it does not reach.
pub(super) fn laid_on_reference(frame: &GreyPyramid, warp: &Warp) -> GreyPyramid {
    let grey = frame.level(0);
    let (width, height) = (grey.width(), grey.height());
    let h = warp.matrix(width, height);
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    GreyPyramid::new(Plane::from_rows(width, height, |y, row| {
        for (x, v) in row.iter_mut().enumerate() {
            let (u, w) = map(&h, x as f64, y as f64);
            let (u, w) = (u.clamp(0.0, right), w.clamp(0.0, bottom));
            let (left, top) = ((u as usize).min(width.max(2) - 2), (w as usize).min(height.max(2) - 2));
            let (fx, fy) = ((u - left as f64) as f32, (w - top as f64) as f32);
            let (upper, lower) = (grey.row(top), grey.row((top + 1).min(height - 1)));
            let next = (left + 1).min(width - 1);
            let mix = |r: &[u8]| f32::from(r[left]) * (1.0 - fx) + f32::from(r[next]) * fx;
            *v = (mix(upper) * (1.0 - fy) + mix(lower) * fy + 0.5) as u8;
        }
    }))
}

/// What bitmaps and features that agree are worth where tiles say little.
const TWO_WITNESSES: f64 = 0.7;

/// The first level of `pyramid` with at most `pixels` pixels.
pub(super) fn level_within(pyramid: &GreyPyramid, pixels: usize) -> usize {
    let area = |i: usize| pyramid.level(i).width() * pyramid.level(i).height();
    (0..pyramid.len()).find(|&i| area(i) <= pixels).unwrap_or(pyramid.len() - 1)
}

/// The level on which features are sought.
pub(super) fn features_level(pyramid: &GreyPyramid) -> usize {
    level_within(pyramid, MEASURED_PIXELS)
}

/// Pixel of the full size from pixel of level `level`: halving puts the centre of a pixel between two.
pub(super) fn level_to_full(level: usize) -> Matrix3<f64> {
    let scale = (1u64 << level) as f64;
    let offset = (scale - 1.0) / 2.0;
    Matrix3::new(scale, 0.0, offset, 0.0, scale, offset, 0.0, 0.0, 1.0)
}

/// What the bitmaps lead to.
pub(super) fn by_bitmaps(reference: &GreyPyramid, frame: &GreyPyramid, options: &MtbOptions) -> Option<Candidate> {
    let found = mtb::search(reference, frame, level_within(reference, MEASURED_PIXELS), options);
    by_start(reference, frame, &found.warp(), CAPTURE_LEVELS)
}

/// What the bitmaps' other minima lead to: the best few.
pub(super) fn by_rivals(
    reference: &GreyPyramid,
    frame: &GreyPyramid,
    angle: f64,
    options: &MtbOptions,
) -> Vec<Candidate> {
    let coarse = level_within(reference, MEASURED_PIXELS);
    let mut rough: Vec<Candidate> = mtb::rivals(reference, frame, angle, MOST_RIVALS, options)
        .into_iter()
        .filter_map(|m| {
            let start = Warp::Rigid { dx: m.dx, dy: m.dy, angle: m.angle };
            let found = refine(reference, frame, &start, Model::Rigid, (coarse + CAPTURE_LEVELS, coarse))?;
            Some(judge(reference, frame, found.warp, 0.0))
        })
        .collect();
    rough.sort_by(|a, b| b.confidence().total_cmp(&a.confidence()));
    rough.iter().take(BEST_RIVALS).filter_map(|c| by_start(reference, frame, &c.warp, 1)).collect()
}

/// Rivals that are looked at.
const MOST_RIVALS: usize = 8;
/// ... and of these refined to the end.
const BEST_RIVALS: usize = 2;

/// Features of a frame on the level of [`features_level`]: of the plain picture, and of its median threshold bitmap.
#[derive(Debug, Clone, Default)]
pub(super) struct FeatureSets {
    pub(super) plain: Features,
    pub(super) mtb: Features,
    pub(super) counts: KeypointCounts,
}

/// The homography that the matches of both sets agree on, in pixels of the full size, and those that do; sought once more among the
/// matches near the places that it gives, where what repeats elsewhere no longer competes (Hartley & Zisserman 2004, algorithm 4.6).
pub(super) fn by_matches(
    reference: &FeatureSets,
    frame: &FeatureSets,
    to_full: &Matrix3<f64>,
    ratio: f64,
    options: &RansacOptions,
) -> Option<Consensus> {
    let in_full = RansacOptions { threshold: options.threshold * to_full[(0, 0)], ..options.clone() };
    let first = ransac::search(&pairs(reference, frame, to_full, ratio, None), &in_full)?;
    let motion = to_full.try_inverse()? * first.homography * to_full;
    let guide = Guide { motion, radius: GUIDED_PX };
    let second = ransac::search(&pairs(reference, frame, to_full, ratio, Some(&guide)), &in_full);
    Some(second.filter(|s| s.inliers.len() > first.inliers.len()).unwrap_or(first))
}

/// How far from its place a guided match may lie, in pixels of the level: some times what makes it an inlier.
const GUIDED_PX: f64 = 10.0;

/// The matches of both sets, in pixels of the full size.
pub(super) fn pairs(
    reference: &FeatureSets,
    frame: &FeatureSets,
    to_full: &Matrix3<f64>,
    ratio: f64,
    guide: Option<&Guide>,
) -> Vec<Pair> {
    let full = |k: &Keypoint| {
        let (x, y) = map(to_full, k.x.into(), k.y.into());
        [x, y]
    };
    let mut pairs: Vec<Pair> = [(&reference.plain, &frame.plain), (&reference.mtb, &frame.mtb)]
        .into_iter()
        .flat_map(|(a, b)| {
            let matches = match_mutual(a, b, ratio, guide);
            matches.into_iter().map(|m| (full(&a.keypoints[m.reference]), full(&b.keypoints[m.frame])))
        })
        .collect();
    drop_repeated(&mut pairs, to_full[(0, 0)]);
    pairs
}

/// Of pairs that join the same two places, within a pixel of the level, only the first stays: a point found in both pictures, or with two
/// directions, has one voice.
pub(super) fn drop_repeated(pairs: &mut Vec<Pair>, pixel: f64) {
    let cell = |p: &Pair| [p.0[0], p.0[1], p.1[0], p.1[1]].map(|v| (v / (1.5 * pixel)).floor() as i64);
    let mut seen = std::collections::BTreeSet::new();
    pairs.retain(|p| seen.insert(cell(p)));
}

/// Refines `start` as a homography, from `capture` levels above the finest, and asks the tiles.
pub(super) fn by_start(
    reference: &GreyPyramid,
    frame: &GreyPyramid,
    start: &Warp,
    capture: usize,
) -> Option<Candidate> {
    let finest = level_within(reference, REFINED_PIXELS);
    // What is little determined at first may be well determined after the first step; a smaller model holds where a larger runs away.
    [Model::Homography, Model::Rigid, Model::Shift].into_iter().find_map(|model| {
        let found = refine(reference, frame, start, model, (finest + capture, finest))?;
        let candidate = judge(reference, frame, found.warp, NOISE_FACTOR * found.error_px);
        is_sane(&candidate.warp, reference).then_some(candidate)
    })
}

/// The tiles' opinion of `warp`.
pub(super) fn judge(reference: &GreyPyramid, frame: &GreyPyramid, warp: Warp, noise_px: f64) -> Candidate {
    let level = level_within(reference, MEASURED_PIXELS);
    let to_full = level_to_full(level);
    let full = reference.level(0);
    let from_full = to_full.try_inverse().unwrap_or_else(Matrix3::identity);
    let h = from_full * warp.matrix(full.width(), full.height()) * to_full;
    let both = CommonExposure::new(reference.level(level), frame.level(level), &h, AGREEMENT_SMOOTHING);
    let agreement = agreement::measure(&both, &h);
    // A tile's own place is known to a few hundredths of a pixel.
    let seen = to_full[(0, 0)] * (agreement.offset - TILE_NOISE).max(0.0);
    let error_px = (noise_px * noise_px + seen * seen).sqrt();
    let diagonal = ((full.width() * full.width() + full.height() * full.height()) as f64).sqrt();
    let tolerance_px = TOLERANCE_PX * (diagonal / 2000.0).max(1.0);
    Candidate { warp, agreement, error_px, trust: 1.0, tolerance_px, corroborated: false }
}

/// See [`Candidate::tolerance_px`].
const TOLERANCE_PX: f64 = 1.5;

/// The median offset of tiles under the true warp, in pixels of the level. Measured on rendered brackets.
const TILE_NOISE: f64 = 0.05;

/// Whether a camera held in hands could have done this: no corner farther than a third of the diagonal, no side half or twice as long.
fn is_sane(warp: &Warp, pyramid: &GreyPyramid) -> bool {
    let (width, height) = (pyramid.level(0).width(), pyramid.level(0).height());
    let diagonal = ((width * width + height * height) as f64).sqrt();
    let h = warp.matrix(width, height);
    let before = corners(width, height);
    let after = before.map(|(x, y)| map(&h, x, y));
    let side = |c: &[(f64, f64); 4], i: usize| {
        let (a, b) = (c[i], c[(i + 1) % 4]);
        ((a.0 - b.0) * (a.0 - b.0) + (a.1 - b.1) * (a.1 - b.1)).sqrt()
    };
    warp.corner_distance(&Warp::Identity, width, height) < diagonal / 3.0
        && (0..4).all(|i| (0.5..2.0).contains(&(side(&after, i) / side(&before, i).max(1.0))))
}

/// The root mean square distance over the picture of where two warps put a pixel.
pub(super) fn distance(a: &Warp, b: &Warp, width: usize, height: usize) -> f64 {
    const GRID: usize = 9;
    let (ha, hb) = (a.matrix(width, height), b.matrix(width, height));
    let place = |k: usize, n: usize| (n as f64 - 1.0) * k as f64 / (GRID as f64 - 1.0);
    let sum: f64 = (0..GRID * GRID)
        .map(|i| {
            let (x, y) = (place(i % GRID, width), place(i / GRID, height));
            let ((ax, ay), (bx, by)) = (map(&ha, x, y), map(&hb, x, y));
            (ax - bx) * (ax - bx) + (ay - by) * (ay - by)
        })
        .sum();
    (sum / (GRID * GRID) as f64).sqrt()
}

/// The smallest model that explains the motion as well as `whole` does, within what the pixels can tell.
pub(super) fn reduce(reference: &GreyPyramid, frame: &GreyPyramid, whole: Candidate) -> Candidate {
    let (width, height) = (reference.level(0).width(), reference.level(0).height());
    let finest = level_within(reference, REFINED_PIXELS);
    let still = distance(&whole.warp, &Warp::Identity, width, height);
    if still <= UNMOVED_PX.max(whole.error_px) {
        let unmoved = judge(reference, frame, Warp::Identity, 0.0);
        if unmoved.agreement.share() >= whole.agreement.share() - 0.02 {
            let error_px = unmoved.error_px.min(still.max(SAME_PX));
            return Candidate { error_px, corroborated: whole.corroborated, ..unmoved };
        }
    }
    for model in [Model::Shift, Model::Rigid] {
        // The nearest by far is cheap to tell; the best is what counts.
        let near = Warp::Homography(restrict(&whole.warp.matrix(width, height), model, width, height));
        if distance(&whole.warp, &near, width, height) > HOPELESS * SAME_PX.max(whole.error_px) {
            continue;
        }
        let Some(smaller) = refine(reference, frame, &whole.warp, model, (finest, finest)) else {
            continue;
        };
        let apart = distance(&whole.warp, &smaller.warp, width, height);
        if apart <= SAME_PX.max(whole.error_px) {
            let judged = judge(reference, frame, smaller.warp, NOISE_FACTOR * smaller.error_px);
            let candidate = Candidate { corroborated: whole.corroborated, ..judged };
            if candidate.agreement.share() >= whole.agreement.share() - 0.02
                && candidate.agreement.offset <= whole.agreement.offset + 0.01
            {
                return candidate;
            }
        }
    }
    whole
}

/// The features of a frame, on the level of [`features_level`].
pub(super) fn features(pyramid: &GreyPyramid, sift: &SiftOptions, mtb: &MtbOptions) -> FeatureSets {
    let level = features_level(pyramid);
    let grey = pyramid.level(level);
    let plain = sift::detect(grey, sift);
    let histogram = pyramid.histogram(level);
    let threshold = histogram.level(mtb::own_percentile(histogram, mtb.exclusion));
    let bitmap = Plane::from_rows(grey.width(), grey.height(), |y, row| {
        for (v, g) in row.iter_mut().zip(grey.row(y)) {
            *v = if *g > threshold { 255 } else { 0 };
        }
    });
    let mtb = sift::detect(&bitmap, sift);
    let counts =
        KeypointCounts { plain: plain.len(), mtb: mtb.len(), merged: plain.len() + mtb.len() - repeated(&plain, &mtb) };
    FeatureSets { plain, mtb, counts }
}

/// How many keypoints of the bitmap are points of the plain picture too: within a pixel, and of like scale.
fn repeated(plain: &Features, mtb: &Features) -> usize {
    let cell = |x: f32, y: f32| ((x / 2.0).floor() as i64, (y / 2.0).floor() as i64);
    let mut cells: std::collections::BTreeMap<(i64, i64), Vec<usize>> = std::collections::BTreeMap::new();
    for (i, k) in plain.keypoints.iter().enumerate() {
        cells.entry(cell(k.x, k.y)).or_default().push(i);
    }
    let same = |a: &Keypoint, b: &Keypoint| {
        let (dx, dy) = (a.x - b.x, a.y - b.y);
        dx * dx + dy * dy <= 1.0 && a.scale < 1.3 * b.scale && b.scale < 1.3 * a.scale
    };
    mtb.keypoints
        .iter()
        .filter(|k| {
            let (cx, cy) = cell(k.x, k.y);
            (cy - 1..=cy + 1).any(|y| {
                (cx - 1..=cx + 1)
                    .any(|x| cells.get(&(x, y)).is_some_and(|c| c.iter().any(|&i| same(&plain.keypoints[i], k))))
            })
        })
        .count()
}

#[cfg(test)]
mod tests;
