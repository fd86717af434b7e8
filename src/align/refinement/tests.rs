//! Tests of refinement with known transforms, different exposures, noise, clipping and moving objects.

use super::*;
use crate::align::grey::GreyPyramid;
use crate::align::scene::{Scene, Shot, perspective, photograph, rigid, shift};
use crate::plane::Plane;

const SIZE: (usize, usize) = (400, 300);

/// The pyramid of a photograph of the test scene.
fn taken(transform: &Transform, shot: Shot) -> GreyPyramid {
    GreyPyramid::new(Scene::new(11).photograph(SIZE, transform, shot))
}

/// Refines `start` from level `coarsest` down to the full size.
fn found(
    reference: &GreyPyramid,
    frame: &GreyPyramid,
    start: &Transform,
    model: Model,
    coarsest: usize,
) -> Option<Refined> {
    refine(&FramePair::new(reference, frame, start), start, model, (coarsest, 0))
}

/// Returns the largest distance between the positions of a corner under `a` and under `b`, in pixels.
fn apart(a: &Transform, b: &Transform) -> f64 {
    a.corner_distance(b, SIZE.0, SIZE.1)
}

#[test]
fn finds_each_model_from_pixels_away() {
    // The tolerances follow from the expected errors. About 25,000 points have gradients of about 10 grey values per
    // pixel. Their noise is 1.5 grey values, or 3 where the darker frame is brightened. Smoothing correlates the noise
    // of 13 neighbouring pixels, so the points count as 25,000 / 13 independent ones. Therefore the error of a shift is
    // 3 / 10 / sqrt(25,000 / 13) = 0.007 px; the error of a homography at the corners is five times as large.
    for (truth, start, model, tolerance) in [
        (shift(5.3, -2.6), shift(2.9, -0.1), Model::Shift, 0.02),
        (rigid(-3.4, 6.2, 0.8), rigid(-1.0, 4.0, 0.5), Model::Rigid, 0.03),
        (perspective(), shift(-0.5, 2.0), Model::Homography, 0.05),
    ] {
        for (dark, bright) in [(-1.0, 1.0), (1.0, -1.0)] {
            let (reference, frame) = (taken(&Transform::Identity, Shot::at(dark)), taken(&truth, Shot::at(bright)));
            let found = found(&reference, &frame, &start, model, 2).unwrap();
            let error = apart(&found.transform, &truth);
            assert!(error < tolerance, "{model:?} {dark} {bright}: {error}, {found:?}");
        }
    }
}

#[test]
fn a_result_has_the_form_of_its_model() {
    let (reference, frame) = (taken(&Transform::Identity, Shot::at(0.0)), taken(&rigid(1.2, 0.4, 0.4), Shot::at(1.0)));
    let transform = |model| found(&reference, &frame, &perspective(), model, 2).unwrap().transform;
    assert!(matches!(transform(Model::Shift), Transform::Rigid { angle: 0.0, .. }));
    assert!(matches!(transform(Model::Rigid), Transform::Rigid { angle, .. } if angle != 0.0));
    assert!(matches!(transform(Model::Homography), Transform::Homography(h) if h[(2, 2)] == 1.0));
}

#[test]
fn edges_of_clipped_areas_do_not_affect_alignment() {
    // The scene is a sawtooth that rises within 6 px and falls within 40 px. In the frame with three stops more, the
    // peaks are clipped, so that the bright part of every tooth extends to the left by some pixels. If clipping were
    // ignored, all steep edges would seem to be shifted in this direction.
    let teeth = |x: f64, y: f64| {
        let t = (x + 6.0 * (y / 17.0).sin()).rem_euclid(46.0);
        let rise = if t < 6.0 { 0.5 - 0.5 * (t / 6.0 * std::f64::consts::PI).cos() } else { (46.0 - t) / 40.0 };
        (6.0 * rise - 3.5 + 0.5 * (y / 5.0).sin()).exp2()
    };
    let truth = shift(0.4, -0.3);
    let take = |transform: &Transform, ev| GreyPyramid::new(photograph(SIZE, transform, Shot::at(ev), teeth));
    for (a, b) in [(-1.0, 2.0), (2.0, -1.0)] {
        let (reference, frame) = (take(&Transform::Identity, a), take(&truth, b));
        let clipped = [&reference, &frame].map(|p| p.level(0).as_slice().iter().filter(|&&v| v == 255).count());
        assert!(clipped.iter().max().unwrap() * 10 > SIZE.0 * SIZE.1, "{clipped:?}");
        let found = found(&reference, &frame, &shift(0.0, 0.0), Model::Shift, 1).unwrap();
        // The limit is twice the tolerance of a shift in `finds_each_model_from_pixels_away`. An error caused by
        // clipping would be tenths of a pixel.
        assert!(apart(&found.transform, &truth) < 0.04, "{a} {b}: {found:?}");
    }
}

#[test]
fn moving_object_does_not_affect_the_refinement() {
    let scene = Scene::new(11);
    // A part of 0.45 x 0.45 of the image is displaced by 9 px.
    let with_mover = |x: f64, y: f64| {
        let inside = (100.0..280.0).contains(&x) && (90.0..225.0).contains(&y);
        scene.radiance(if inside { x - 9.0 } else { x }, y)
    };
    let truth = rigid(2.4, -1.3, 0.3);
    let reference = taken(&Transform::Identity, Shot::at(-1.0));
    let frame = GreyPyramid::new(photograph(SIZE, &truth, Shot::at(1.0), with_mover));
    let found = found(&reference, &frame, &shift(0.5, 0.0), Model::Rigid, 2).unwrap();
    // Plain least squares would have an error of about a fifth (0.45 x 0.45) of the 9 px. With Tukey's weights, pixels
    // of the moved part have no weight unless they match by chance.
    assert!(apart(&found.transform, &truth) < 0.05, "{found:?}");
}

#[test]
fn uniform_picture_is_not_refined() {
    let plain = GreyPyramid::new(Plane::filled(SIZE.0, SIZE.1, 90));
    for model in [Model::Shift, Model::Rigid, Model::Homography] {
        assert!(found(&plain, &plain, &Transform::Identity, model, 2).is_none());
    }
}

#[test]
fn the_error_it_states_is_of_the_right_order() {
    let size = (200, 150);
    let truth = shift(0.7, 0.4);
    let (mut actual, mut stated) = (0.0, 0.0);
    for seed in 0..20 {
        let take = |transform: &Transform, ev, seed| {
            let shot = Shot { ev, noise: 4.0, seed };
            GreyPyramid::new(Scene::new(11).photograph(size, transform, shot))
        };
        let (reference, frame) = (take(&Transform::Identity, 0.0, 2 * seed), take(&truth, 1.0, 2 * seed + 1));
        let found = found(&reference, &frame, &shift(0.0, 0.0), Model::Shift, 1).unwrap();
        let (dx, dy) = found.transform.shift_px(size.0, size.1);
        actual += (dx - 0.7).powi(2) + (dy - 0.4).powi(2);
        stated += found.error_px * found.error_px;
    }
    // 20 pairs of photographs, each with an error in two directions, give 40 errors, so their root mean square has a
    // standard error of 1 / sqrt(2 x 40) = 11 %. A stated error comes from 36 or 9 blocks with two directions each, so
    // it has 1 / sqrt(2 x 72) = 8 % or 17 %, and the mean of 20 has 2 to 4 %. The limits are at least three times 11 %
    // from 1.
    let ratio = f64::sqrt(actual / stated);
    assert!((0.67..1.4).contains(&ratio), "{ratio}: {} against {}", (actual / 20.0).sqrt(), (stated / 20.0f64).sqrt());
}

/// In a soft scene the steps could lead farther than the pixels of a level can show.
#[test]
fn steps_that_lead_far_away_give_no_result() {
    let wave = |v: f64| (v * std::f64::consts::TAU / 200.0).sin();
    let soft = |x: f64, y: f64| 1.0 + 0.8 * wave(x) * wave(y);
    let take = |transform: &Transform| GreyPyramid::new(photograph(SIZE, transform, Shot::at(0.0), soft));
    let reference = take(&Transform::Identity);
    for (moved, is_found) in [(0.8 * MOST_MOVE, true), (1.2 * MOST_MOVE, false)] {
        let frame = take(&shift(moved, 0.0));
        let found = found(&reference, &frame, &Transform::Identity, Model::Shift, 0);
        assert_eq!(found.is_some(), is_found, "{moved}: {found:?}");
    }
}
