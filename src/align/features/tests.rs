//! Tests of the features of bitmaps: keypoints in dark frames, matches, and counts without duplicates.

use super::*;
use crate::align::AlignOptions;
use crate::align::bitmaps::MtbOptions;
use crate::align::features::estimation::Matches;
use crate::align::features::extraction::{PERCENTILES, bitmap, count, smoothed, thresholds};
use crate::align::grey::{GreyPyramid, measured_level};
use crate::align::result::KeypointCounts;
use crate::align::scene::{Scene, Shot, perspective};
use crate::align::transform::{Transform, map};
use nalgebra::Matrix3;

const SIZE: (usize, usize) = (480, 320);

fn sets(seed: u64, transform: &Transform, ev: f64) -> FeatureSets {
    let pyramid = GreyPyramid::new(Scene::new(seed).photograph(SIZE, transform, Shot::at(ev)));
    features(
        &pyramid,
        measured_level(&pyramid),
        &Detector::Sift(SiftOptions::default()),
        MtbOptions::default().exclusion,
    )
}

fn by_plain_alone(sets: &FeatureSets) -> FeatureSets {
    FeatureSets { plain: sets.plain.clone(), ..FeatureSets::default() }
}

#[test]
fn bitmaps_raise_the_matches_of_dark_and_bright_frames() {
    let options = AlignOptions::default();
    for seed in [21, 22] {
        let reference = sets(seed, &Transform::Identity, 0.0);
        for ev in [-5.0, -4.0, 3.0] {
            let frame = sets(seed, &perspective(), ev);
            let counts = frame.counts;
            assert!(counts.merged >= 3 * counts.plain && counts.merged >= counts.mtb, "{ev}: {counts:?}");
            let inliers = |a: &FeatureSets, b: &FeatureSets| {
                by_matches(a, b, &Matrix3::identity(), &options).map_or(0, |c| c.inliers.len())
            };
            let all = by_matches(&reference, &frame, &Matrix3::identity(), &options).unwrap();
            let alone = inliers(&by_plain_alone(&reference), &by_plain_alone(&frame));
            println!("{seed} {ev}: {counts:?}, {} inliers, {alone} by the plain ones", all.inliers.len());
            assert!(all.inliers.len() >= 3 * alone && all.inliers.len() >= 60, "{ev}: {} {alone}", all.inliers.len());
            let transform = Transform::Homography(all.homography);
            let off = transform.corner_distance(&perspective(), SIZE.0, SIZE.1);
            assert!(off < 1.0, "{ev}: {off} px");
        }
    }
}

#[test]
fn either_robust_method_finds_the_motion() {
    let (reference, frame) = (sets(21, &Transform::Identity, 0.0), sets(21, &perspective(), 1.0));
    let by = |robust| {
        let options = AlignOptions { robust, ..AlignOptions::default() };
        by_matches(&reference, &frame, &Matrix3::identity(), &options).unwrap()
    };
    let (ransac, lmeds) = (by(RobustMethod::Ransac), by(RobustMethod::Lmeds));
    for found in [&ransac, &lmeds] {
        let off = Transform::Homography(found.homography).corner_distance(&perspective(), SIZE.0, SIZE.1);
        assert!(off < 0.5 && found.inliers.len() > 100, "{off} px, {}", found.inliers.len());
    }
    // LMedS accepts inliers within a different distance than RANSAC.
    assert_ne!(ransac.inliers, lmeds.inliers);
}

#[test]
fn noise_about_a_threshold_makes_few_points() {
    // The picture is a uniform surface with noise: half of its pixels are above the median, and half below.
    let flat = |_: f64, _: f64| 1.0;
    let shot = Shot { ev: 0.0, noise: 1.0, seed: 5 };
    let noise = crate::align::scene::photograph(SIZE, &Transform::Identity, shot, flat);
    let smooth = smoothed(&noise);
    let median = thresholds(&smooth)[3];
    let options = SiftOptions { double: false, max_keypoints: usize::MAX, ..SiftOptions::default() };
    let points = |exclusion| sift::detect(&bitmap(&smooth, median, exclusion), &options).len();
    // A bitmap with hard edges (exclusion 1) is full of speckles; a ramp at the threshold (exclusion 4) reduces their
    // contrast.
    assert!(points(1) > 200 && points(4) * 10 < points(1), "{} {}", points(1), points(4));
}

#[test]
fn thresholds_split_the_pixels_at_their_percentile() {
    let smooth = smoothed(&Scene::new(3).photograph(SIZE, &Transform::Identity, Shot::at(-3.0)));
    let total = smooth.as_slice().len() as f64;
    for (percent, t) in PERCENTILES.iter().zip(thresholds(&smooth)) {
        let below = smooth.as_slice().iter().filter(|v| **v <= t).count() as f64 / total;
        // The tolerance is 3 %. A threshold is known to a bin of the histogram, a sixteenth of a grey value. In a dark
        // frame, a bin contains at most a few percent of the pixels.
        assert!((below - *percent as f64 / 100.0).abs() < 0.03, "{percent}: {below}");
    }
}

fn keypoints(list: &[(f32, f32, f32)]) -> Features {
    let point = |&(x, y, scale): &(f32, f32, f32)| Keypoint { x, y, scale, angle: 0.0, response: 0.1, bright: true };
    Features { keypoints: list.iter().map(point).collect(), descriptors: Descriptors::Sift(vec![[0; 128]; list.len()]) }
}

#[test]
fn points_found_twice_are_counted_once() {
    let plain = keypoints(&[(10.0, 10.0, 2.0), (50.0, 20.0, 3.0), (0.2, 0.1, 2.0)]);
    let bitmap = keypoints(&[
        (10.7, 10.6, 2.0), // 0.92 px off: the same
        (10.8, 10.7, 2.0), // 1.06 px off: another
        (49.9, 19.5, 3.8), // 1.27 times the scale: the same
        (49.9, 19.5, 4.0), // 1.33 times
        (-0.1, 0.0, 2.0),  // across the border between squares: the same
        (90.0, 90.0, 2.0),
    ]);
    // Only the third keypoint of the second bitmap is in neither the first bitmap nor the grey image.
    let second = keypoints(&[(90.3, 90.0, 2.0), (10.1, 10.0, 2.0), (70.0, 10.0, 2.0)]);
    let of = |mtb: &[Features]| {
        let c = count(&plain, mtb);
        (c.plain, c.mtb, c.merged)
    };
    assert_eq!(of(std::slice::from_ref(&bitmap)), (3, 6, 6));
    assert_eq!(of(&[bitmap, second]), (3, 7, 7));
    assert_eq!(of(&[]), (3, 0, 3));
}

#[test]
fn pair_found_twice_is_one_match() {
    // In both frames, the bitmap's keypoint is the same as the grey image's, some tenths of a pixel away.
    let sets = |x: f32, y: f32, mtb: (f32, f32)| FeatureSets {
        plain: keypoints(&[(x, y, 2.0)]),
        mtb: vec![keypoints(&[(x + mtb.0, y + mtb.1, 2.0)])],
        counts: KeypointCounts::default(),
    };
    let count = |at: f32, mtb: [(f32, f32); 2]| {
        pairs(&sets(at, 10.0, mtb[0]), &sets(at + 30.0, 12.0, mtb[1]), &Matrix3::identity(), 0.8).len()
    };
    for tenth in 0..40 {
        let at = 100.0 + 0.1 * tenth as f32;
        assert_eq!(count(at, [(0.4, -0.3), (0.5, 0.2)]), 1, "{at}");
        // In the reference (first line) or in the frame (second line), the bitmap's keypoint is two pixels away from
        // the grey image's, so it is a different keypoint. So there are two matches.
        assert_eq!(count(at, [(2.0, 0.0), (0.0, 0.0)]), 2, "{at}");
        assert_eq!(count(at, [(0.0, 0.0), (0.0, -2.0)]), 2, "{at}");
    }
}

#[test]
fn large_keypoints_count_less_in_the_last_fit() {
    // There are twelve correct small keypoints, and four large keypoints that are all displaced to the right.
    let place = |i: usize| [(i * 37 % 100) as f64 * 4.0, (i * 61 % 100) as f64 * 3.0];
    let drag = |i: usize| if i < 12 { 0.0 } else { 2.0 };
    let pairs: Vec<PointPair> = (0..16).map(|i| (place(i), [place(i)[0] + drag(i), place(i)[1]])).collect();
    let found = Consensus { homography: Matrix3::identity(), inliers: (0..16).collect(), rms: 1.0 };
    let off = |scale: f64| {
        let scales = (0..16).map(|i| if i < 12 { 1.0 } else { scale }).collect();
        let h = Matches { pairs: pairs.clone(), scales }.settle(found.clone(), 1.0).homography;
        let (x, y) = map(&h, 200.0, 150.0);
        (x - 200.0).hypot(y - 150.0)
    };
    assert!(off(50.0) < 0.1 && off(50.0) < off(5.0), "{} {}", off(50.0), off(5.0));
}
