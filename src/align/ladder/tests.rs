//! Tests with one frame: which model is chosen, and that wrong transforms are not accepted.

use super::*;
use crate::align::bitmaps::MtbOptions;
use crate::align::ladder::reduction::reduce;
use crate::align::ladder::starts::{by_bitmaps, by_start, is_sane};
use crate::align::scene::{Scene, Shot, perspective, rigid, shift};
use crate::align::transform::{distance, map};
use nalgebra::Matrix3;

const SIZE: (usize, usize) = (480, 320);

fn taken(transform: &Transform, ev: f64) -> GreyPyramid {
    GreyPyramid::new(Scene::new(21).photograph(SIZE, transform, Shot::at(ev)))
}

#[test]
fn the_smallest_model_that_explains_is_chosen() {
    let reference = taken(&Transform::Identity, 0.0);
    for (truth, expected) in [
        (Transform::Identity, Model::Unmoved),
        (shift(6.4, -3.7), Model::Shift),
        (rigid(2.0, 5.5, 0.7), Model::Rigid),
        (perspective(), Model::Homography),
    ] {
        let frame = taken(&truth, 1.0);
        // As in the ladder, a homography is found first and then reduced.
        let pair = FramePair::new(&reference, &frame, &truth);
        let whole = by_start(&pair, &truth, 1).unwrap();
        let chosen = reduce(&pair, whole);
        let model = Model::of(&chosen.transform);
        assert_eq!(model, expected, "{:?}", chosen.transform);
        // The tests of `refinement` find the corners of a homography with an error of up to 0.05 px. A model with fewer
        // parameters is chosen if it differs from the homography by no more than this error, so the limit is twice as
        // large.
        let error = chosen.transform.corner_distance(&truth, SIZE.0, SIZE.1);
        assert!(error < 0.1, "{error} px for {expected:?}");
        assert!(chosen.confidence() > 0.8, "{chosen:?}");
    }
}

#[test]
fn bitmaps_settle_an_ordinary_pair() {
    let truth = rigid(-11.3, 7.8, 1.1);
    for (a, b) in [(-1.0, 1.0), (1.0, -1.0)] {
        let (reference, frame) = (taken(&Transform::Identity, a), taken(&truth, b));
        let found = by_bitmaps(&reference, &frame, &MtbOptions::default()).1.unwrap();
        assert!(found.is_settled(), "{found:?}");
        assert!(found.transform.corner_distance(&truth, SIZE.0, SIZE.1) < 0.1, "{found:?}");
        // The error estimate must be larger than the actual error, but less than 0.05 px, the limit of the corner
        // errors in the tests of `refinement`.
        let error = distance(&found.transform, &truth, SIZE.0, SIZE.1);
        assert!(error < found.error_px() && found.error_px() < 0.05, "{error} against {}", found.error_px());
    }
}

#[test]
fn another_scene_never_settles() {
    let reference = taken(&Transform::Identity, 0.0);
    let other = GreyPyramid::new(Scene::new(22).photograph(SIZE, &Transform::Identity, Shot::at(1.0)));
    if let Some(found) = by_bitmaps(&reference, &other, &MtbOptions::default()).1 {
        assert!(!found.is_settled() && found.confidence() < 0.35, "{found:?}");
    }
}

#[test]
fn impossible_camera_motion_is_rejected() {
    let (w, h) = (SIZE.0 as f64 - 1.0, SIZE.1 as f64 - 1.0);
    let scaled = |sx: f64, sy: f64| {
        // Scales by (sx, sy) about the centre of the picture.
        let m = Matrix3::new(sx, 0.0, (1.0 - sx) * w / 2.0, 0.0, sy, (1.0 - sy) * h / 2.0, 0.0, 0.0, 1.0);
        Transform::Homography(m)
    };
    for fine in [Transform::Identity, rigid(60.0, -40.0, 10.0), perspective(), scaled(1.3, 1.3), scaled(0.8, 0.8)] {
        assert!(is_sane(&fine, SIZE), "{fine:?}");
    }
    for mad in [scaled(-1.0, 1.0), scaled(1.0, -1.0), scaled(2.1, 2.1), scaled(0.45, 0.45), shift(200.0, 0.0)] {
        assert!(!is_sane(&mad, SIZE), "{mad:?}");
    }
    assert!(!is_sane(&Transform::Homography(Matrix3::from_element(f64::NAN)), SIZE));
}

#[test]
fn a_level_maps_to_the_full_size_centre_to_centre() {
    // Pixel 0 of level 2 is the mean of pixels 0 to 3 of the full size, whose centre is 1.5. Likewise, pixel 5 is the
    // mean of pixels 20 to 23.
    assert_eq!(map(&level_to_full(2), 0.0, 5.0), (1.5, 21.5));
    assert_eq!(level_to_full(0), Matrix3::identity());
}
