//! Tests of the detector on images with known features.

use super::*;
use crate::align::features::patterns::{blobs, check_repeatability, texture};

#[test]
fn blob_is_found_at_its_position_and_scale() {
    for (x, y, sigma) in [(60.3, 50.6, 3.0), (64.0, 64.0, 5.0), (70.2, 55.9, 8.0)] {
        for (height, bright) in [(100.0, true), (-100.0, false)] {
            for double in [false, true] {
                let options = SurfOptions { double, ..SurfOptions::default() };
                let found = detect(&blobs(128, 120, &[(x, y, sigma, height)]), &options);
                let best = found.keypoints.iter().max_by(|a, b| a.response.total_cmp(&b.response)).unwrap();
                // The second octave samples only every second pixel, so positions are less precise than those of SIFT.
                assert!((f64::from(best.x) - x).abs() < 0.3 && (f64::from(best.y) - y).abs() < 0.3, "{best:?}");
                // For a blob with standard deviation b, the middle lobe of the best box filter reaches from one
                // inflection point to the other, so it is 2 b long. The side of the filter is three lobes, 6 b, and its
                // scale is 1.2 / 9 of the side, 0.8 b. The sides of neighbouring filters differ by a factor of less
                // than 2. A parabola through their responses finds the scale with an error of at most a seventh.
                assert!((f64::from(best.scale) / (0.8 * sigma) - 1.0).abs() < 1.0 / 7.0, "{best:?} for {sigma}");
                assert_eq!(best.bright, bright);
            }
        }
    }
}

#[test]
fn faint_blobs_and_edges_are_not_features() {
    assert!(detect(&blobs(128, 128, &[(64.0, 64.0, 4.0, 8.0)]), &SurfOptions::default()).is_empty());
    let edge = Plane::from_rows(128, 128, |_, row| row[64..].fill(200));
    assert!(detect(&edge, &SurfOptions::default()).is_empty());
    for (width, height) in [(5, 7), (9, 9), (1, 40)] {
        assert!(detect(&Plane::filled(width, height, 9), &SurfOptions::default()).is_empty());
    }
}

/// Box filters do not rotate with the image. So there are fewer matches than with SIFT, and a smaller share of them is
/// correct.
#[test]
fn features_survive_rotation_scale_and_contrast() {
    check_repeatability(|grey| detect(grey, &SurfOptions { contrast: 1e-4, ..SurfOptions::default() }), (15, 0.75));
}

/// In this test, the image becomes brighter in a known direction.
#[test]
fn direction_is_that_of_the_gradients() {
    for degrees in [-170.0f32, -60.0, 0.0, 35.0, 90.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let ramp = Plane::from_rows(101, 101, |y, row: &mut [u8]| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = (128.0 + 1.5 * (cos * (x as f32 - 50.0) + sin * (y as f32 - 50.0))).round() as u8;
            }
        });
        let point = Keypoint { x: 50.0, y: 50.0, scale: 2.0, angle: 0.0, response: 1.0, bright: true };
        let angle = orientation::assign(&Integral::new(&ramp), &point).to_degrees();
        let turn = (angle - degrees + 540.0).rem_euclid(360.0) - 180.0;
        // Grey values are rounded, so the slope is known to a hundredth, and its direction to 0.01 rad = 0.6 degrees.
        assert!(turn.abs() < 1.0, "{angle} for {degrees}");
    }
}

#[test]
fn the_same_on_any_number_of_threads() {
    let picture = texture(300, 260, 0.1, 1.0);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| detect(&picture, &SurfOptions { contrast: 1e-4, ..SurfOptions::default() }))
    };
    let one = run(1);
    assert!(one.len() > 10);
    assert_eq!(one, run(3));
}
