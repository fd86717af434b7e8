//! Tests of the local gain on synthetic phones.

use super::*;
use crate::align::Alignment;
use crate::bracket::exposure::Exposure;
use crate::bracket::{Bracket, Frame, ReferenceChoice, Samples};
use crate::merge::weight::Weight;
use crate::merge::{MergeOptions, Merging};
use crate::response::local::evidence;
use crate::response::samples::Places;

const SIZE: (usize, usize) = (360, 240);

/// The scene: a dark room with a bright window, textured by a quarter of a stop.
fn scene(x: usize, y: usize) -> f64 {
    let window = (200..300).contains(&x) && (60..160).contains(&y);
    let texture = libm::exp2(0.125 * libm::sin(x as f64 / 9.0) + 0.125 * libm::cos(y as f64 / 7.0));
    let shade = libm::exp2(x as f64 / 180.0 - 1.0);
    texture * if window { 6.0 * shade } else { 0.1 * shade }
}

/// The base of the scene, without its texture, from which a phone computes its gain.
fn base(x: usize, y: usize) -> f64 {
    let window = (200..300).contains(&x) && (60..160).contains(&y);
    libm::exp2(x as f64 / 180.0 - 1.0) * if window { 6.0 } else { 0.1 }
}

/// Returns three frames two stops apart with the sRGB curve; the middle one is the reference. `phone` is the fraction
/// of a stop of the base that a phone keeps, except in very dark and very bright places; 1 means no local tone mapping.
fn frames(phone: f64) -> (Bracket, Alignment) {
    let frame = |stops: f64| {
        let time = libm::exp2(stops);
        let code = |i: usize| {
            let (x, y) = (i % SIZE.0, i / SIZE.0);
            let gain = libm::pow(base(x, y) * time / 0.18, phone - 1.0).clamp(0.25, 3.0);
            let v = (scene(x, y) * time * if phone < 1.0 { gain } else { 1.0 }).clamp(0.0, 1.0);
            let curve = ResponseCurve::srgb();
            let middle = f64::from(curve.exposure(0, 255.0));
            let table = curve.exposures(0);
            // The noise, of about one code value, is a hash of the position.
            let noise = ((i as u64 + 7 * time as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 62) as i64 - 1;
            (table.partition_point(|&x| f64::from(x) < v * middle) as i64 + noise).clamp(0, 255) as u8
        };
        let codes = (0..SIZE.0 * SIZE.1).flat_map(|i| [code(i); 3]).collect();
        let exposure = Exposure::given(stops).unwrap();
        Frame::new(format!("{stops}").into(), SIZE.0, SIZE.1, Samples::Eight(codes), exposure)
    };
    let all = [-2.0, 0.0, 2.0].map(frame).into();
    let bracket = Bracket::new(all, &ReferenceChoice::Number(2)).unwrap();
    let alignment = Alignment::unmoved(&bracket);
    (bracket, alignment)
}

fn found((bracket, alignment): &(Bracket, Alignment)) -> Evidence {
    evidence(&Places::of(bracket, alignment).unwrap(), SIZE.0).unwrap()
}

#[test]
fn evidence_of_compressed_steps_is_local_and_of_a_cameras_is_not() {
    let (phone, camera) = (found(&frames(0.45)), found(&frames(1.0)));
    assert!(phone.is_local && phone.step_fraction < 0.7, "{phone:?}");
    assert!(!camera.is_local && (camera.step_fraction - 1.0).abs() < 0.05, "{camera:?}");
    assert!(camera.variation_stops < 0.03, "{camera:?}");
}

/// Returns the radiance of `bracket`, merged with its gain and without.
fn merged(bracket: &Bracket, alignment: &Alignment) -> [Plane<[f32; 3]>; 2] {
    let curve = ResponseCurve::srgb();
    let local = LocalGain::find(bracket, alignment, &curve, alignment.overlap).unwrap();
    let options = MergeOptions { weight: Weight::Hat, region: alignment.overlap };
    [Some(&local), None].map(|local| {
        let merging = Merging::of(bracket, alignment, &curve, &options, None).unwrap();
        merging.with_local_gain(local).unwrap().slab(0..SIZE.1).unwrap().map.pixels
    })
}

/// Returns by how many stops the second place is brighter than the first.
fn contrast(map: &Plane<[f32; 3]>, first: (usize, usize), second: (usize, usize)) -> f64 {
    let stops = |(x, y)| f64::from(libm::log2f(map.at(x, y)[1]));
    stops(second) - stops(first)
}

#[test]
fn gain_gives_back_the_scenes_contrast_small_and_large_and_across_an_edge() {
    let (bracket, alignment) = frames(0.45);
    let [with, without] = merged(&bracket, &alignment);
    // Four pairs of places are compared: two places in the texture, two places in the shading of the room, the two
    // sides of the edge of the window, and the room and the middle of the window.
    let places = [((40, 100), (68, 100)), ((20, 30), (180, 200)), ((196, 110), (204, 110)), ((120, 110), (250, 110))];
    for (first, second) in places {
        let truth = libm::log2(scene(second.0, second.1) / scene(first.0, first.1));
        let error = |map| (contrast(map, first, second) - truth).abs();
        // The tolerance is large because of the window. From the room to the window there are 5.9 stops, and the frames
        // keep 0.45 of them: 2.7 stops. In a neighbourhood with such an edge in its middle, the variance of the
        // logarithm is 1.8, so only half of the edge belongs to the base.
        assert!(error(&with) < 0.1 + 0.3 * truth.abs(), "{first:?} {second:?}: {truth}, {} off", error(&with));
        assert!(truth.abs() < 2.0 || error(&without) > 1.1 * error(&with), "{first:?} {second:?}: {}", error(&without));
    }
}

#[test]
fn report_of_a_phone_has_the_range_of_each_frame_against_the_reference() {
    let (bracket, alignment) = frames(0.45);
    let local = LocalGain::find(&bracket, &alignment, &ResponseCurve::srgb(), alignment.overlap).unwrap();
    let report = LocalReport::of(&found(&(bracket.clone(), alignment.clone())), Some(&local));
    assert!(report.locally_processed && report.frames.len() == 2 && report.expansion > 1.3, "{report:?}");
    assert!(report.range_stops().is_some_and(|(least, most)| least < -0.5 && most > 0.5), "{report:?}");
    assert!(local.against_reference(1, 0..9).is_empty(), "the reference has none");
    // The phone brightened the longer frame less than the reference, and the shorter one more.
    assert!(local.against_reference(0, 30..31)[40] < 1.0 && local.against_reference(2, 30..31)[40] > 1.0);
}

#[test]
fn lights_of_a_phones_frames_are_shown_by_a_shorter_exposure() {
    let (bracket, alignment) = frames(0.45);
    let local = LocalGain::find(&bracket, &alignment, &ResponseCurve::srgb(), alignment.overlap).unwrap();
    let photographed = Photographed { longest: 0.25, shortest: 4.0, contrast: 1.0, white_stops: 2.2 };
    let expanded = local.photographed(photographed);
    // The 2.2 stops from the middle to white are expanded by a factor of at most 2.5. So white becomes brighter by at
    // most 2.5 x 2.2 - 2.2 = 1.5 x 2.2 stops.
    assert!(expanded.shortest > 4.5 && expanded.shortest < 4.0 * libm::exp2(1.5 * 2.2), "{expanded:?}");
    assert_eq!(Photographed { shortest: 4.0, ..expanded }, photographed);
}

#[test]
fn gain_of_a_cameras_frames_is_one() {
    let (bracket, alignment) = frames(1.0);
    let local = LocalGain::find(&bracket, &alignment, &ResponseCurve::srgb(), alignment.overlap).unwrap();
    for i in [0, 2] {
        // The tolerance is 10 %. Noise and rounding of one code value are 0.03 stops at the middle code value, and less
        // in the mean of a cell.
        assert!(local.against_reference(i, 0..SIZE.1).iter().all(|gain| (gain - 1.0).abs() < 0.1));
    }
}

#[test]
fn gain_of_another_region_is_refused() {
    let (bracket, alignment) = frames(0.45);
    let curve = ResponseCurve::srgb();
    let part = Rect { x0: 8, y0: 0, x1: 200, y1: 240 };
    let local = LocalGain::find(&bracket, &alignment, &curve, part).unwrap();
    let options = MergeOptions { weight: Weight::Hat, region: alignment.overlap };
    let merging = Merging::of(&bracket, &alignment, &curve, &options, None).unwrap();
    assert!(merging.with_local_gain(Some(&local)).is_err());
}

#[test]
fn curve_is_flattened_where_no_phone_could_have_kept_so_much() {
    let steepness = |step_fraction, most_step_fraction| {
        let evidence = Evidence { step_fraction, most_step_fraction, variation_stops: 0.1, is_local: true };
        ResponseCurve::srgb().ln_exposure(0)[250] / curve(&evidence).ln_exposure(0)[250]
    };
    assert!((steepness(0.5, 0.9) - 1.0).abs() < 1e-9);
    // Under the sRGB curve, two frames differ by 1.6 exposure steps at some brightness level. In truth they can differ
    // by at most one step, so the stops between the code values of sRGB are divided by 1.6.
    assert!((steepness(0.8, 1.6) - 1.6).abs() < 1e-9);
    // In the median over the picture, a phone's frames differ by at most 0.6 of an exposure step (`MOST_FRACTION`). If
    // they differ by a full step under sRGB, the stops between its code values are divided by 1 / 0.6, although no
    // brightness level shows more than a full step.
    assert!((steepness(1.0, 1.0) - 1.0 / 0.6).abs() < 1e-9);
}
