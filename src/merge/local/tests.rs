//! Tests of the local gain on made-up phones.

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

/// The base of the scene: what a phone takes its gain from.
fn base(x: usize, y: usize) -> f64 {
    let window = (200..300).contains(&x) && (60..160).contains(&y);
    libm::exp2(x as f64 / 180.0 - 1.0) * if window { 6.0 } else { 0.1 }
}

/// Three frames two stops apart, the middle one the reference, by the sRGB curve; `phone` keeps so much of a stop of the base that is neither too dark nor
/// too bright.
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
            // A hash of the place for noise of a code.
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

#[test]
fn gain_makes_frames_agree_and_a_window_that_the_reference_clips_is_shown() {
    let (bracket, alignment) = frames(0.45);
    let curve = ResponseCurve::srgb();
    let local = LocalGain::find(&bracket, &alignment, &curve, alignment.overlap).unwrap();
    let options = MergeOptions { weight: Weight::Hat, region: alignment.overlap };
    let merged = |local| {
        let merging = Merging::of(&bracket, &alignment, &curve, &options, None).unwrap();
        merging.with_local_gain(local).unwrap().slab(0..SIZE.1).unwrap().map.pixels
    };
    let (with, without) = (merged(Some(&local)), merged(None));
    // The texture's contrast over some pixels of the same shade, which the phone kept: in stops, against the scene's.
    let contrast = |map: &Plane<[f32; 3]>, x: usize, y: usize| {
        let stops = |x: usize| f64::from(libm::log2f(map.at(x, y)[1])) - libm::log2(base(x, y));
        stops(x + 28) - stops(x)
    };
    let truth = |x: usize, y: usize| libm::log2(scene(x + 28, y) / base(x + 28, y) * base(x, y) / scene(x, y));
    for (x, y) in [(40, 100), (100, 30), (230, 110)] {
        let error = |map| (contrast(map, x, y) - truth(x, y)).abs();
        // The shade of 28 pixels is 0.16 stops, of which up to all may be compressed.
        assert!(error(&with) < 0.2, "{x} {y}: {} and {}", error(&with), error(&without));
    }
    let report = LocalReport::of(&found(&(bracket.clone(), alignment.clone())), Some(&local));
    assert!(report.locally_processed && report.frames.len() == 2 && report.expansion > 1.5, "{report:?}");
    assert!(report.range_stops().is_some_and(|(least, most)| least < -0.5 && most > 0.5), "{report:?}");
}

#[test]
fn gain_of_a_cameras_frames_is_one() {
    let (bracket, alignment) = frames(1.0);
    let local = LocalGain::find(&bracket, &alignment, &ResponseCurve::srgb(), alignment.overlap).unwrap();
    for i in [0, 2] {
        // A code of noise and of rounding is 0.03 stops at the middle, and its mean over a cell less.
        assert!(local.at(i, 0..SIZE.1).iter().all(|gain| (gain - 1.0).abs() < 0.06));
    }
    assert!(local.at(1, 0..SIZE.1).is_empty(), "that of the reference");
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
fn expansion_is_by_the_inverse_of_what_was_kept_and_bounded() {
    let of = |step_fraction, most_step_fraction| {
        expansion(&Evidence { step_fraction, most_step_fraction, variation_stops: 0.1, is_local: true })
    };
    assert!((of(0.5, 0.9) - 2.0).abs() < 1e-12 && (of(0.1, 0.2) - 2.5).abs() < 1e-12);
    // A curve of half the contrast of sRGB's: what seems to be 0.8 of a step is half of it.
    assert!((of(0.8, 1.6) - 2.0).abs() < 1e-12);
    // No phone keeps all of a step: the curve is steeper than sRGB's, though no place shows it.
    assert!((of(1.0, 1.0) - 1.0 / 0.6).abs() < 1e-12);
}
