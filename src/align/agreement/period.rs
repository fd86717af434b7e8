//! The periods of a picture that repeats itself. A frame of such a picture matches it at more than one shift.
//!
//! In: a grey pyramid. Out: the shifts under which the picture matches itself. Cost: nine patches of 32 x 32 pixels,
//! correlated at every second shift within the search range on a small pyramid level: some 10 ms. Source: normalised
//! cross-correlation (Lewis 1995) of the picture with itself.
//!
//! The longer the shift, the less similar a picture is to its shifted self. In a picture that does not repeat, the
//! similarity stays low. In a facade, it is high again when the shift is the period, and low when it is half the
//! period.

use crate::align::agreement::pattern::{LEAST_CONTRAST, Pattern, Shift};
use crate::align::agreement::warped::{Part, Warped};
use crate::align::agreement::{Agreement, check_tiles};
use crate::align::grey::{GreyPyramid, level_within, measured_level};
use crate::align::refinement::{FramePair, refine};
use crate::align::transform::{Model, Transform, on_level};
use crate::statistics::median;
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Largest number of pixels of the pyramid level that is examined. Such a level still shows the joints of a tiled wall.
const PIXELS: usize = 200_000;
/// Side of a patch, in pixels of the examined level.
const SIDE: usize = 32;
/// If too few patches have the contrast of other patterns ([`LEAST_CONTRAST`]), patches are used whose standard
/// deviation is at least this, in grey values. It may be small: the level is smoothed, and two patches of noise at
/// different places of a picture are not alike.
const FAINT_CONTRAST: f32 = 1.0;
/// Number of patches along each side of the picture.
const PATCHES: usize = 3;
/// A shift is not examined if fewer patches than this can be compared under it.
const LEAST_PATCHES: usize = 6;
/// Distance between neighbouring shifts that are tried, in pixels of the examined level. The level is smoothed with a
/// standard deviation of one pixel, so the similarity changes little within this distance.
const STRIDE: isize = 2;
/// Smallest period that is detected, in pixels of the examined level.
const LEAST: isize = 6;
/// A shift is a period only if the similarity under it (the median correlation of the patches) is at least this. Noise
/// makes the similarity smaller than 1; at this value, the variance of the noise is a quarter of that of the pattern.
const ALIKE: f64 = 0.8;
/// A shift is a period only if the dissimilarity under it (1 - similarity) is less than this multiple of the
/// dissimilarity under half the shift.
const NEARER: f64 = 0.5;
/// A shift is a period only if the tiles that agree under it outnumber the disagreeing ones by at least this share of
/// all tiles with contrast. The value is half of `COMPARABLE_EVIDENCE`, the share of the evidence at which a shifted
/// alignment of a frame counts as comparable with the true one: noise reduces the evidence of the true alignment.
const LEAST_EVIDENCE: f64 = 0.2;
/// Largest number of shifts that are confirmed and returned: those with the greatest similarity.
const MOST: usize = 6;

/// Returns the shifts, in pixels of the full size, under which `picture` matches itself; an empty list if it does not
/// repeat, and none if it is too small or has too little detail to be examined. Of a shift and its opposite, only one
/// is returned.
///
/// `max_shift` is the largest shift that is searched, as a share of the long side.
pub(crate) fn periods(picture: &GreyPyramid, max_shift: f64) -> Option<Vec<(f64, f64)>> {
    let level = level_within(picture, PIXELS);
    let (width, height) = picture.size(level);
    if width.min(height) < PATCHES * SIDE {
        return None;
    }
    let pair = FramePair::new(picture, picture, &Transform::Identity);
    let both = pair.level(level);
    let warped = Warped::new(&both.frame, &Matrix3::identity(), (width, height), 0);
    let patches = |contrast: f32| -> Vec<((usize, usize), Pattern)> {
        let patch = |i: usize| {
            let place = |at: usize, length: usize| (2 * at + 1) * length / (2 * PATCHES) - SIDE / 2;
            let (left, top) = (place(i % PATCHES, width), place(i / PATCHES, height));
            Some(((left, top), Pattern::with_contrast(both, Part::square(left, top, SIDE), contrast)?))
        };
        (0..PATCHES * PATCHES).filter_map(patch).collect()
    };
    let clear = patches(LEAST_CONTRAST);
    let patches = if clear.len() < LEAST_PATCHES { patches(FAINT_CONTRAST) } else { clear };
    if patches.len() < LEAST_PATCHES {
        return None;
    }
    let similarity = |(dx, dy): Shift| {
        let within =
            |at: usize, shift: isize, length: usize| at.checked_add_signed(shift).is_some_and(|at| at + SIDE <= length);
        let (mut alike, mut unlike) = (Vec::with_capacity(patches.len()), 0);
        for ((left, top), pattern) in &patches {
            // If the shift moves a patch outside the picture, the opposite shift is used for this patch.
            let is_inside = |&(dx, dy): &Shift| within(*left, dx, width) && within(*top, dy, height);
            let Some(shift) = [(dx, dy), (-dx, -dy)].into_iter().find(is_inside) else { continue };
            let correlation = pattern.correlation(&warped, shift);
            alike.push(correlation);
            unlike += usize::from(f64::from(correlation) < ALIKE);
            // More than half of all patches are below `ALIKE`. So the median is below it too, whatever the remaining
            // patches give.
            if 2 * unlike > patches.len() && alike.len() >= LEAST_PATCHES {
                break;
            }
        }
        if alike.len() < LEAST_PATCHES { f64::NAN } else { median(alike).map_or(f64::NAN, f64::from) }
    };
    let steps = (max_shift * width.max(height) as f64) as isize / STRIDE;
    // If the picture repeats after the shift d, it also repeats after -d. So only half of the shifts are examined.
    let side = 2 * steps + 1;
    let all: Vec<f64> = (0..side * (steps + 1))
        .into_par_iter()
        .map(|i| similarity((STRIDE * (i % side - steps), STRIDE * (i / side))))
        .collect();
    let at = |x: isize, y: isize| {
        let (x, y) = if y < 0 { (-x, -y) } else { (x, y) };
        if x.abs() > steps || y > steps { f64::NAN } else { all[(y * side + x + steps) as usize] }
    };
    let is_period = |x: isize, y: isize| {
        let here = at(x, y);
        here >= ALIKE
            && 1.0 - here < NEARER * (1.0 - at(x / 2, y / 2))
            && (-1..=1).all(|j| (-1..=1).all(|i| at(x + i, y + j).is_nan() || here >= at(x + i, y + j)))
    };
    let half_plane = (0..=steps).flat_map(|y| (-steps..=steps).map(move |x| (x, y)));
    let mut found: Vec<(f64, Shift)> = half_plane
        .filter(|&(x, y)| STRIDE * x.abs().max(y) >= LEAST && (y > 0 || x > 0) && is_period(x, y))
        .map(|(x, y)| (at(x, y), (STRIDE * x, STRIDE * y)))
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let scale = (1u64 << level) as f64;
    let mut periods: Vec<(f64, f64)> = Vec::new();
    if found.is_empty() {
        return Some(periods);
    }
    let least = LEAST_EVIDENCE * agreement(&pair, &Matrix3::identity()).agreeing as f64;
    for (_, (x, y)) in found.into_iter().take(MOST) {
        let refined = confirmed(&pair, (scale * x as f64, scale * y as f64), least);
        let same = |a: &(f64, f64), b: &(f64, f64)| (a.0 - b.0).abs().max((a.1 - b.1).abs()) < scale * LEAST as f64;
        periods.extend(refined.filter(|found| periods.iter().chain([&(0.0, 0.0)]).all(|known| !same(known, found))));
    }
    Some(periods)
}

/// Returns the refined shift, in pixels of the full size, if tiles all over the picture match under it: the agreeing
/// tiles must outnumber the disagreeing ones by at least `least`; if no tile has enough contrast, the shift is
/// confirmed. Without this check, the few patches of [`periods`] may match in a picture that does not repeat, for
/// example on the parts of a lampshade.
fn confirmed(pair: &FramePair, (dx, dy): (f64, f64), least: f64) -> Option<(f64, f64)> {
    let (width, height) = pair.size();
    let measured = measured_level(pair.reference());
    // The shift is known to about one pixel of the level on which [`periods`] compared the patches.
    let start = Transform::Rigid { dx, dy, angle: 0.0 };
    let h = refine(pair, &start, Model::Shift, (measured + 1, measured))?.transform.matrix(width, height);
    let shifted = agreement(pair, &h);
    (shifted.agreeing as f64 - shifted.disagreeing as f64 >= least).then_some((h[(0, 2)], h[(1, 2)]))
}

/// Returns the agreement of all tiles under the transform `h`, which is in pixels of the full size.
fn agreement(pair: &FramePair, h: &Matrix3<f64>) -> Agreement {
    let measured = measured_level(pair.reference());
    check_tiles(pair.level(measured), &on_level(h, measured)).agreement
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::{Scene, Shot, photograph};

    const SIZE: (usize, usize) = (480, 320);
    const REACH: f64 = 0.15;

    /// The periods of a photograph; none also if it has too little detail to be examined.
    fn found(radiance: &(dyn Fn(f64, f64) -> f64 + Sync)) -> Vec<(f64, f64)> {
        found_in(Shot::at(0.0), radiance)
    }

    fn found_in(shot: Shot, radiance: &(dyn Fn(f64, f64) -> f64 + Sync)) -> Vec<(f64, f64)> {
        periods(&GreyPyramid::new(photograph(SIZE, &Transform::Identity, shot, radiance)), REACH).unwrap_or_default()
    }

    #[test]
    fn a_facade_repeats_and_a_landscape_does_not() {
        for seed in 1..6 {
            let scene = Scene::new(seed);
            assert_eq!(found(&|x, y| scene.radiance(x, y)), [], "{seed}");
            // A skyline is similar to itself under a small shift, the more so the smaller the shift. This is not a
            // period.
            let skyline = |x: f64, y: f64| if y < 150.0 + 0.1 * x { 4.0 } else { 0.1 * scene.radiance(x, y) };
            assert_eq!(found(&skyline), [], "{seed}");
            let facade = |x: f64, y: f64| {
                let is_wall = x > 60.0;
                if is_wall { scene.radiance(x.rem_euclid(34.0), y.rem_euclid(41.0)) } else { scene.radiance(x, y) }
            };
            let found = found(&facade);
            // The shifts that are compared are two pixels apart.
            let has = |dx: f64, dy: f64| found.iter().any(|(x, y)| (x - dx).abs() <= 2.0 && (y - dy).abs() <= 2.0);
            assert!(has(34.0, 0.0) && has(0.0, 41.0), "{seed}: {found:?}");
        }
    }

    #[test]
    fn tiles_with_thin_joints_repeat() {
        let joint = |v: f64| (v - 0.1 * v.floor()).rem_euclid(27.0) < 2.0;
        let tiles = |x: f64, y: f64| if joint(x + 0.05 * y) || joint(y - 0.05 * x) { 0.4 } else { 1.0 };
        assert_ne!(found(&tiles), []);
    }

    #[test]
    fn faint_pattern_repeats_and_noise_does_not() {
        // The grey values of the pattern vary by six, with a standard deviation of about 1.2, like plaster or cloth.
        let scene = Scene::new(3);
        let plaster =
            |x: f64, y: f64| 1.0 + 0.03 * (scene.radiance(x.rem_euclid(34.0), y.rem_euclid(41.0)).log2() + 6.0);
        let noisy = |noise: f64| Shot { noise, ..Shot::at(0.0) };
        assert_ne!(found_in(noisy(0.2), &plaster), []);
        assert_eq!(found_in(noisy(1.5), &|_, _| 1.0), []);
    }

    #[test]
    fn uniform_or_small_picture_cannot_be_examined() {
        for (width, height) in [(1, 1), (3, 200), (300, 200)] {
            let plain = GreyPyramid::new(crate::plane::Plane::filled(width, height, 77));
            assert_eq!(periods(&plain, REACH), None);
        }
    }
}
