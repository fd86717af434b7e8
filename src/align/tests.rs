//! Tests of [`align`]: the placement of every frame of a bracket.

use super::*;
use crate::align::agreement::periods;
use crate::align::grey::content_and_pyramid;
use crate::align::scene::{Scene, Shot, photograph, rigid, shift};
use crate::align::transform::distance;
use crate::bracket::exposure::Exposure;
use crate::bracket::{Frame, ReferenceChoice, Samples};
use crate::plane::Plane;

const SIZE: (usize, usize) = (384, 256);

/// Returns a frame whose three channels are `grey`.
pub(super) fn frame(name: &str, grey: &Plane<u8>, ev: f64) -> Frame {
    let codes = grey.as_slice().iter().flat_map(|&v| [v, v, v]).collect();
    Frame::new(name.into(), grey.width(), grey.height(), Samples::Eight(codes), Exposure::given(ev).unwrap())
}

/// Returns a bracket with a photograph of the test scene for each of `shots`, each a transform and an exposure in EV.
/// The first of `shots` is the reference.
fn bracket(shots: &[(Transform, f64)]) -> Bracket {
    let frames = shots
        .iter()
        .enumerate()
        .map(|(i, (transform, ev))| {
            frame(&format!("{i}"), &Scene::new(41).photograph(SIZE, transform, Shot::at(*ev)), *ev)
        })
        .collect();
    Bracket::new(frames, &ReferenceChoice::Number(1)).unwrap()
}

fn statuses(alignment: &Alignment) -> Vec<Status> {
    alignment.placements.iter().map(Placement::status).collect()
}

#[test]
fn three_exposures_are_placed_in_order_and_alike_on_any_threads() {
    let (dark, bright) = (rigid(5.5, -3.2, 0.5), shift(-8.3, 4.6));
    let bracket = bracket(&[(Transform::Identity, 0.0), (bright, 1.5), (dark, -1.5)]);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| align(&bracket, &AlignOptions::default()).unwrap())
    };
    let (alignment, warnings) = run(1);
    assert_eq!(run(3).0, alignment);
    assert!(warnings.is_empty(), "{warnings:?}");
    // The bracket sorts its frames by rising exposure.
    assert_eq!(statuses(&alignment), [Status::Aligned, Status::Reference, Status::Aligned]);
    assert_eq!(alignment.placements[1].transform(), Some(Transform::Identity));
    assert_eq!(alignment.placements[1].error_px(), Some(0.0));
    for (i, truth, model) in [(0, dark, Model::Rigid), (2, bright, Model::Shift)] {
        let placement = &alignment.placements[i];
        assert_eq!(placement.model(), Some(model));
        // The tests of `refinement` find such motions within 0.03 px; the limit is three times that.
        let error = placement.transform().unwrap().corner_distance(&truth, SIZE.0, SIZE.1);
        assert!(error < 0.1 && placement.confidence() > 0.8, "{error} {placement:?}");
    }
    let overlap = alignment.overlap;
    assert!(overlap.x0 >= 8 && overlap.y1 <= 252 && overlap.width() > 350 && overlap.height() > 235, "{overlap:?}");
}

#[test]
fn frame_of_another_scene_is_rejected_with_a_warning() {
    let own = Scene::new(41);
    let take = |scene: &Scene, transform: &Transform, ev| scene.photograph(SIZE, transform, Shot::at(ev));
    let frames = vec![
        frame("dark", &take(&own, &shift(3.0, 2.0), -1.0), -1.0),
        frame("middle", &take(&own, &Transform::Identity, 0.0), 0.0),
        frame("stranger", &take(&Scene::new(42), &Transform::Identity, 1.0), 1.0),
    ];
    let bracket = Bracket::new(frames, &ReferenceChoice::Number(2)).unwrap();
    let (alignment, warnings) = align(&bracket, &AlignOptions::default()).unwrap();
    assert_eq!(statuses(&alignment), [Status::Aligned, Status::Reference, Status::Rejected]);
    let placement = &alignment.placements[2];
    assert!(
        placement.transform().is_none() && placement.model().is_none() && placement.reason().is_some(),
        "{placement:?}"
    );
    assert!(
        matches!(&warnings[..], [Warning::FrameRejected { path, reason }] if path.to_str() == Some("stranger") && !reason.is_empty()),
        "{warnings:?}"
    );
    let message = warnings[0].to_string();
    assert!(message.contains("--unmoved stranger") && message.contains("--align none"), "{message}");
    // The rejected frame does not narrow the overlap.
    assert!(alignment.overlap.width() > 375 && alignment.overlap.height() > 248);
}

/// In the dark reference, noise and rounding hide that the scene repeats; the brighter frame shows it.
#[test]
fn scene_that_repeats_is_recognised_although_the_reference_is_dark() {
    let scene = Scene::new(43);
    let tiles = |x: f64, y: f64| {
        let tile = scene.radiance((x + 0.1 * y).rem_euclid(31.0), (y - 0.1 * x).rem_euclid(31.0));
        1.0 + 0.2 * tile.log2()
    };
    let take = |name, transform: &Transform, ev| frame(name, &photograph(SIZE, transform, Shot::at(ev), tiles), ev);
    let frames = vec![take("dark", &Transform::Identity, -9.0), take("bright", &shift(4.0, 3.0), -2.0)];
    let bracket = Bracket::new(frames, &ReferenceChoice::Number(1)).unwrap();
    let options = AlignOptions::default();
    let repeats = |frame: &Frame| {
        let pyramid = content_and_pyramid(frame).unwrap().1;
        periods(&pyramid, options.mtb.max_shift).is_some_and(|periods| !periods.is_empty())
    };
    assert_eq!([0, 1].map(|i| repeats(&bracket.frames()[i])), [false, true]);
    let (alignment, _) = align(&bracket, &options).unwrap();
    let placement = &alignment.placements[1];
    assert_eq!(placement.status(), Status::Rejected, "{placement:?}");
    assert!(placement.reason().is_some_and(|reason| reason.contains("the scene repeats")), "{placement:?}");
}

/// Exposure, in EV, of a frame without usable detail. The brightest parts of the scene have a radiance of 2^5
/// (`Scene::radiance`). At -16 EV their code value is 255 (0.18 * 2^(5 - 16))^(1 / 2.2) = 4, which is too little to
/// compare tiles.
const NEARLY_BLACK: f64 = -16.0;

#[test]
fn black_frame_among_others_that_did_not_move_is_assumed_unmoved() {
    let still = [(Transform::Identity, 0.0), (Transform::Identity, 1.0), (Transform::Identity, NEARLY_BLACK)];
    let (alignment, warnings) = align(&bracket(&still), &AlignOptions::default()).unwrap();
    let placement = &alignment.placements[0];
    assert_eq!(statuses(&alignment), [Status::Assumed, Status::Reference, Status::Unmoved], "{placement:?}");
    assert_eq!((placement.transform(), placement.model()), (Some(Transform::Identity), Some(Model::Unmoved)));
    assert!(placement.error_px().is_some_and(|error| error < 1.0) && placement.confidence() > 0.5, "{placement:?}");
    assert!(matches!(&warnings[..], [Warning::FrameAssumed { is_dark: true, is_still: true, .. }]), "{warnings:?}");
    assert!(!warnings[0].degrades() && warnings[0].to_string().contains("did not move between the other 2 frames"));
}

#[test]
fn black_frame_among_others_that_moved_little_is_assumed_within_its_error() {
    // The camera drifts slowly, in the order of the exposures.
    let drift = |k: f64| shift(0.5 * k, -0.3 * k);
    let shots =
        [(drift(0.0), 0.0), (drift(1.0), 1.0), (drift(2.0), 2.0), (drift(-1.0), -1.0), (drift(-2.0), NEARLY_BLACK)];
    let (alignment, warnings) = align(&bracket(&shots), &AlignOptions::default()).unwrap();
    let placement = &alignment.placements[0];
    assert_eq!(placement.status(), Status::Assumed, "{placement:?}");
    let error = distance(&placement.transform().unwrap(), &drift(-2.0), SIZE.0, SIZE.1);
    assert!(error <= placement.error_px().unwrap() && placement.error_px().unwrap() < 3.0, "{error} {placement:?}");
    assert!(matches!(&warnings[..], [Warning::FrameAssumed { is_still: false, .. }]), "{warnings:?}");
    assert!(warnings[0].degrades());
}

#[test]
fn a_black_frame_among_others_that_moved_is_rejected() {
    let moved = [(Transform::Identity, 0.0), (shift(6.0, -4.0), 1.0), (shift(-3.0, 5.0), NEARLY_BLACK)];
    let bracket = bracket(&moved);
    let (alignment, warnings) = align(&bracket, &AlignOptions::default()).unwrap();
    assert_eq!(
        statuses(&alignment),
        [Status::Rejected, Status::Reference, Status::Aligned],
        "{:?}",
        alignment.placements[0]
    );
    // The rejected frame is not among the placed frames.
    let placed: Vec<_> = alignment.placed(&bracket).map(|(i, frame, motion)| (i, frame.path(), Some(motion))).collect();
    let expected = [1, 2].map(|i| (i, bracket.frames()[i].path(), alignment.motion(&bracket, i)));
    assert_eq!(placed, expected);
    assert!(warnings.iter().any(|w| matches!(w, Warning::FrameRejected { .. })));
}

#[test]
fn frames_without_alignment_are_not_moved() {
    let bracket = bracket(&[(Transform::Identity, 0.0), (shift(6.0, -4.0), 1.0)]);
    let options = AlignOptions { mode: AlignMode::None, ..AlignOptions::default() };
    let (alignment, warnings) = align(&bracket, &options).unwrap();
    assert_eq!(statuses(&alignment), [Status::Reference, Status::Unmoved]);
    assert!(warnings.is_empty() && alignment.placements.iter().all(|p| p.transform() == Some(Transform::Identity)));
    assert_eq!(alignment.overlap, Rect { x0: 0, y0: 0, x1: SIZE.0, y1: SIZE.1 });
}

#[test]
fn each_method_by_itself_finds_the_motion() {
    let truth = rigid(7.0, -5.0, 0.6);
    let bracket = bracket(&[(Transform::Identity, 0.0), (truth, 1.0)]);
    // The limit of the bitmaps is larger than the sum of two errors: 0.3 px of the shift, and 0.02 degrees of the
    // rotation, which is 0.08 px at the corners, 230 px from the centre. The limit of the features follows from the
    // position of a keypoint, which has an error of about 0.6 px.
    for (mode, tolerance) in [(AlignMode::Mtb, 0.6), (AlignMode::Sift, 1.5), (AlignMode::Surf, 1.5)] {
        let (alignment, _) = align(&bracket, &AlignOptions { mode, ..AlignOptions::default() }).unwrap();
        let error = alignment.placements[1].transform().unwrap().corner_distance(&truth, SIZE.0, SIZE.1);
        assert!(error < tolerance, "{mode:?}: {error} px");
    }
}

#[test]
fn option_out_of_range_is_an_error_that_names_it() {
    let bracket = bracket(&[(Transform::Identity, 0.0), (Transform::Identity, 1.0)]);
    let refused = |expected: &str, set: &dyn Fn(&mut AlignOptions)| {
        let mut options = AlignOptions { mode: AlignMode::Sift, ..AlignOptions::default() };
        set(&mut options);
        let error = align(&bracket, &options).unwrap_err();
        assert!(matches!(error, Error::Option { option, .. } if option == expected), "{expected}: {error}");
        assert!(error.is_usage() && error.to_string().contains(" is not within "), "{error}");
    };
    for value in [-0.1, 1e9, f64::NAN] {
        refused("--max-rotation", &|o| o.mtb.max_rotation_deg = value);
        refused("mtb.max_shift", &|o| o.mtb.max_shift = value);
        refused("sift.sigma", &|o| o.sift.sigma = value);
        refused("sift.contrast", &|o| o.sift.contrast = value);
        refused("sift.edge_ratio", &|o| o.sift.edge_ratio = value);
        refused("surf.contrast", &|o| o.surf.contrast = value);
        refused("ratio", &|o| o.ratio = value);
        refused("ransac.threshold", &|o| o.ransac.threshold = value);
        refused("ransac.confidence", &|o| o.ransac.confidence = value);
    }
    refused("sift.intervals", &|o| o.sift.intervals = 0);
    refused("sift.intervals", &|o| o.sift.intervals = usize::MAX);
    refused("sift.max_keypoints", &|o| o.sift.max_keypoints = 0);
    refused("surf.octaves", &|o| o.surf.octaves = 0);
    refused("surf.max_keypoints", &|o| o.surf.max_keypoints = 0);
    refused("ransac.max_trials", &|o| o.ransac.max_trials = 0);
    assert!(AlignOptions::default().validate().is_ok());
}

#[test]
fn place_given_that_no_camera_can_have_is_an_error_that_names_the_frame() {
    let bracket = bracket(&[(Transform::Identity, 0.0), (Transform::Identity, 1.0)]);
    let no_number = Placement::by_user(shift(f64::NAN, 0.0));
    let by = RejectedBy::Alignment;
    let not_known = Placement::Rejected { by, confidence: f64::NAN, reason: None };
    for (placement, says) in [(no_number, "homography"), (not_known, "confidence")] {
        let place = preset::PresetTransform::Known(Box::new(placement), FeatureCounts::default());
        let given = vec![Preset { path: "1".into(), place }];
        let error = align(&bracket, &AlignOptions { given, ..AlignOptions::default() }).unwrap_err();
        assert!(error.is_usage() && error.to_string().contains("1: it"), "{error}");
        assert!(error.to_string().contains(says), "{error}");
    }
}

#[test]
fn small_overlap_warns_and_no_overlap_fails() {
    let bracket = bracket(&[(Transform::Identity, 0.0), (Transform::Identity, 1.0), (Transform::Identity, 2.0)]);
    let align = |shifts: [f64; 2]| {
        let known = |dx| Placement::by_user(shift(dx, 0.0));
        let place = |dx| preset::PresetTransform::Known(Box::new(known(dx)), FeatureCounts::default());
        let given = [1, 2].map(|i| Preset { path: format!("{i}").into(), place: place(shifts[i - 1]) }).to_vec();
        super::align(&bracket, &AlignOptions { given, ..AlignOptions::default() })
    };
    // The frames are 384 pixels wide. A shift by half the width leaves an overlap of one half, which causes no warning.
    assert_eq!(align([-192.0, 0.0]).unwrap().1, []);
    for sign in [-1.0, 1.0] {
        let (alignment, warnings) = align([sign * 10.0, sign * 288.0]).unwrap();
        assert_eq!(alignment.overlap.width(), 96);
        let expected = Warning::SmallOverlap { path: "2".into(), overlap: 0.25, common: 0.25 };
        assert!(expected.degrades());
        assert_eq!(warnings, [expected]);
        let error = align([0.0, sign * 400.0]).unwrap_err();
        assert!(matches!(&error, Error::NoOverlap { path, .. } if path.as_os_str() == "2"), "{error}");
        // Each of the two frames overlaps the reference, but not the other frame.
        assert!(
            matches!(align([-sign * 200.0, sign * 250.0]), Err(Error::NoOverlap { path, .. }) if path.as_os_str() == "2")
        );
    }
}

#[test]
fn frame_beyond_a_rejected_one_is_placed_by_the_nearest_that_was() {
    // The reference (-7 EV) and `bright` (7 EV) are 14 stops apart and have too little in common to be aligned
    // directly. If `middle` (0 EV) is in the bracket, `bright` is aligned to `middle`, its nearest placed neighbour in
    // exposure; `stranger` (2 EV), which is nearer, is rejected.
    let truth = shift(11.0, -7.0);
    let take = |name: &str, seed, transform: &Transform, ev| {
        frame(name, &Scene::new(seed).photograph(SIZE, transform, Shot::at(ev)), ev)
    };
    let reference = || take("reference", 41, &Transform::Identity, -7.0);
    let bright = || take("bright", 41, &truth, 7.0);
    let align = |frames| {
        let bracket = Bracket::new(frames, &ReferenceChoice::Number(1)).unwrap();
        align(&bracket, &AlignOptions::default()).unwrap().0
    };
    assert_eq!(statuses(&align(vec![reference(), bright()])), [Status::Reference, Status::Rejected]);
    let between = [take("middle", 41, &shift(-9.0, 6.0), 0.0), take("stranger", 42, &Transform::Identity, 2.0)];
    let alignment = align([vec![reference()], between.into(), vec![bright()]].concat());
    assert_eq!(
        statuses(&alignment),
        [Status::Reference, Status::Aligned, Status::Rejected, Status::Aligned],
        "{:?}",
        alignment.placements
    );
    let error = alignment.placements[3].transform().unwrap().corner_distance(&truth, SIZE.0, SIZE.1);
    assert!(error < 2.0, "{error} px");
}
