//! Tests of the detector on images with known features.

use super::*;
use crate::align::features::patterns::{blobs, check_repeatability, texture};

#[test]
fn a_blob_is_found_at_its_place_and_scale() {
    for (x, y, sigma) in [(60.3, 50.6, 3.0), (64.0, 64.0, 5.0), (70.2, 55.9, 8.0)] {
        for double in [false, true] {
            let options = SiftOptions { double, ..SiftOptions::default() };
            let found = detect(&blobs(128, 120, &[(x, y, sigma, 100.0)]), &options);
            let best = found.keypoints.iter().max_by(|a, b| a.response.total_cmp(&b.response)).unwrap();
            assert!((f64::from(best.x) - x).abs() < 0.1 && (f64::from(best.y) - y).abs() < 0.1, "{best:?}");
            // Let L(s) be the image smoothed with standard deviation s. For a blob with standard deviation b, L(s) at
            // its centre is proportional to 1 / (1 + s^2 / b^2). So |D| = |L(k s) - L(s)| is largest where k s^2 = b^2,
            // at s = b / sqrt(k) = 0.89 b. The assumed blur of 0.5 px hardly matters.
            assert!((f64::from(best.scale) / (0.89 * sigma) - 1.0).abs() < 0.1, "{best:?} for {sigma}");
        }
    }
}

#[test]
fn faint_blobs_and_edges_are_not_features() {
    assert!(detect(&blobs(128, 128, &[(64.0, 64.0, 4.0, 8.0)]), &SiftOptions::default()).is_empty());
    let edge = Plane::from_rows(128, 128, |_, row| row[64..].fill(200));
    assert!(detect(&edge, &SiftOptions::default()).is_empty());
    assert!(detect(&Plane::filled(5, 7, 9), &SiftOptions::default()).is_empty());
}

#[test]
fn features_survive_rotation_scale_and_contrast() {
    check_repeatability(|grey| detect(grey, &SiftOptions { contrast: 0.01, ..SiftOptions::default() }), (40, 0.9));
}

#[test]
fn a_limit_keeps_the_picture_covered() {
    let picture = texture(300, 260, 0.0, 1.0);
    let options = SiftOptions { contrast: 0.005, ..SiftOptions::default() };
    // A round blob may have several directions, and then becomes several keypoints at one position.
    let places = |options: &SiftOptions| {
        let mut places: Vec<(f32, f32)> = detect(&picture, options).keypoints.iter().map(|k| (k.x, k.y)).collect();
        places.dedup();
        places
    };
    let all = places(&options).len();
    let few = places(&SiftOptions { max_keypoints: all / 2, ..options });
    assert!(few.len() <= all / 2 && few.len() * 5 >= all * 2, "{} of {all}", few.len());
    for (left, top) in [(0.0, 0.0), (150.0, 0.0), (0.0, 130.0), (150.0, 130.0)] {
        let inside =
            few.iter().filter(|k| k.0 >= left && k.0 < left + 150.0 && k.1 >= top && k.1 < top + 130.0).count();
        assert!(inside * 8 >= few.len(), "{inside} of {}", few.len());
    }
}

#[test]
fn the_same_on_any_number_of_threads() {
    let picture = texture(300, 260, 0.1, 1.0);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| detect(&picture, &SiftOptions { contrast: 0.01, ..SiftOptions::default() }))
    };
    let one = run(1);
    assert!(one.len() > 10);
    assert_eq!(one, run(3));
}
