//! Tests of exposure steps that are estimated from pixels. The frames are computed from a scene, with the sRGB curve,
//! which renderings have, or with the tone curves of typical cameras.

use super::*;
use crate::bracket::colour::linear_to_srgb;

fn estimate(frames: &[Brightness]) -> Option<Estimate> {
    super::estimate(&frames.iter().collect::<Vec<_>>())
}

fn contradiction(written: &[f64], frames: &[Brightness]) -> Option<String> {
    super::contradiction(written, &frames.iter().collect::<Vec<_>>())
}

fn at_odds(written: &[f64], frames: &[Brightness]) -> Option<Vec<usize>> {
    super::at_odds(written, &frames.iter().collect::<Vec<_>>())
}

/// Returns the brightness of the scene [`five_decades`], exposed by `ev` stops and moved by `shift` pixels to the side.
/// `curve` contains the strength q of the shoulder of the camera curve, and its exponent n.
fn seen(ev: f64, curve: (f64, f64), shift: usize) -> Brightness {
    seen_above(0, ev, curve, shift)
}

/// As [`seen`], but no pixel value is below `floor`, because a scanner or flare hides darker values.
fn seen_above(floor: u8, ev: f64, (q, n): (f64, f64), shift: usize) -> Brightness {
    let shoulder = |light: f64| linear_to_srgb((1.0 + q) * light.powf(n) / (1.0 + q * light.powf(n)));
    taken(|x, y| five_decades(x + shift, y), ev, floor, shoulder)
}

fn five_decades(x: usize, y: usize) -> f64 {
    2.2 * ((x as f64 / 23.0).sin() + (y as f64 / 17.0).cos() + 0.3 * ((x * y) as f64 / 90.0).sin())
}

/// Returns the brightness of `scene` (in EV), exposed by `ev` stops. `curve` converts light to pixel values, both
/// 0..=1; no pixel value is below `floor`.
fn taken(scene: impl Fn(usize, usize) -> f64, ev: f64, floor: u8, curve: impl Fn(f64) -> f64) -> Brightness {
    let (width, height) = (160, 120);
    let mut samples = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let code = curve(2f64.powf(scene(x, y) + ev - 2.5).min(1.0));
            let noise = if floor > 0 { ((x * 7 + y * 13) % 5) as u8 } else { 0 };
            samples.extend([0, ((code.min(1.0) * 255.0).round() as u8).max(floor + noise), 0]);
        }
    }
    Brightness::of(&Samples::Eight(samples), width)
}

/// As [`seen`], under the curve of a typical camera.
fn picture(ev: f64, shift: usize) -> Brightness {
    seen(ev, (8.0, 1.5), shift)
}

#[test]
fn even_steps_of_cameras_come_out_whole() {
    for (step, curve) in [(1.0, (8.0, 1.4)), (1.0, (8.0, 1.7)), (2.0, (4.0, 1.5)), (3.0, (16.0, 1.6))] {
        let frames: Vec<_> = (0..4).map(|i| seen(step * f64::from(i) - 4.0, curve, 3 * i as usize)).collect();
        let evs = estimate(&frames).unwrap().evs;
        for (i, ev) in evs.iter().enumerate() {
            assert!((ev - step * i as f64).abs() < 0.12 * step, "{step} EV under {curve:?}: {evs:?}");
        }
    }
}

#[test]
fn steps_of_rendered_pairs_are_right_to_a_twentieth_whatever_they_are() {
    for step in [0.4, 0.72, 1.35, 2.2, 3.3] {
        for base in [-3.0, -1.0, 0.5] {
            let pair = [seen(base, (0.0, 1.0), 0), seen(base + step, (0.0, 1.0), 0)];
            let estimate = estimate(&pair).unwrap();
            let (ev, deviation) = (estimate.evs[1], estimate.deviation(0, 1));
            assert!((ev / step - 1.0).abs() < 0.05, "{step} from {base}: {ev}");
            assert!((ev - step).abs() < 2.0 * deviation && deviation < 0.05 * step + 0.1, "{ev} +- {deviation}");
        }
    }
}

#[test]
fn camera_steps_are_within_the_reported_uncertainty() {
    for curve in [(1.0, 1.2), (4.0, 1.45), (8.0, 1.5), (8.0, 1.7), (32.0, 1.65)] {
        let estimate = estimate(&[seen(-2.0, curve, 0), seen(-0.3, curve, 5)]).unwrap();
        let (ev, deviation) = (estimate.evs[1], estimate.deviation(0, 1));
        assert!((ev - 1.7).abs() < 2.0 * deviation, "{curve:?}: {ev} +- {deviation}");
    }
}

#[test]
fn contrasty_steps_are_within_the_reported_uncertainty() {
    for contrast in [0.2, 0.5, 0.8] {
        let curve = |light: f64| {
            let code = linear_to_srgb(light);
            code + contrast * (code * code * (3.0 - 2.0 * code) - code)
        };
        for step in [0.72, 1.35, 2.2] {
            let frames = [-1.5, step - 1.5].map(|ev| taken(five_decades, ev, 0, curve));
            let estimate = estimate(&frames).unwrap();
            let (ev, deviation) = (estimate.evs[1], estimate.deviation(0, 1));
            assert!((ev / step - 1.0).abs() < 0.15, "{contrast}: {ev} of {step}");
            assert!((ev - step).abs() < 2.0 * deviation, "{contrast}: {ev} +- {deviation} of {step}");
        }
    }
}

#[test]
fn exposure_step_is_measured_in_the_overlap() {
    // The left sixth of the first frame shows a window, which the other frame does not show.
    let window = |x: usize, y: usize| if x < 26 { 1.0 + 2.0 * (y as f64 / 9.0).sin() } else { five_decades(x, y) };
    let frames = [taken(window, -1.5, 0, linear_to_srgb), taken(|x, y| window(x + 26, y), 0.0, 0, linear_to_srgb)];
    let shared = estimate(&frames).unwrap().evs[1];
    let whole = histogram::matches(&frames[0].histogram, &frames[1].histogram).unwrap();
    let whole = steps::of(&[whole]).unwrap().means[0];
    assert!((shared - 1.5).abs() < 0.05 && (whole - 1.5).abs() > 0.1, "{shared}, of whole frames {whole}");
}

#[test]
fn step_from_few_pixels_is_less_certain() {
    let few = |x: usize, y: usize| if x < 80 && y < 12 { five_decades(2 * x, 10 * y) } else { -20.0 };
    let deviation = |scene: &dyn Fn(usize, usize) -> f64| {
        let frames = [-1.5, 0.2].map(|ev| taken(scene, ev, 0, linear_to_srgb));
        estimate(&frames).unwrap().deviation(0, 1)
    };
    let (few, many) = (deviation(&few), deviation(&five_decades));
    assert!(few > 1.5 * many, "{few}, {many}");
}

#[test]
fn shadows_that_are_alike_in_all_frames_hide_no_step() {
    let frames: Vec<_> = (0..3).map(|i| seen_above(8, f64::from(i) - 4.0, (8.0, 1.5), 0)).collect();
    let evs = estimate(&frames).unwrap().evs;
    assert!(evs.windows(2).all(|pair| (pair[1] - pair[0] - 1.0).abs() < 0.2), "{evs:?}");
}

#[test]
fn order_does_not_matter() {
    let frames: Vec<_> = [2.0, -1.0, 0.0, -2.0].map(|ev| picture(ev, 0)).into();
    let evs = estimate(&frames).unwrap().evs;
    let turned: Vec<_> = frames.iter().rev().cloned().collect();
    let back: Vec<f64> = estimate(&turned).unwrap().evs.into_iter().rev().collect();
    assert_eq!(evs, back);
    assert!(evs[3] == 0.0 && evs[0] > evs[2] && evs[2] > evs[1]);
}

#[test]
fn equal_pictures_do_not_contradict_exposures() {
    let frames = [picture(0.0, 0), picture(0.0, 9), picture(0.1, 4)];
    assert!(all_alike(&estimate(&frames).unwrap().evs));
    assert_eq!(contradiction(&[-3.0; 3], &frames), None);
}

#[test]
fn equal_exposures_of_different_pictures_contradict() {
    let frames = [picture(0.0, 0), picture(1.0, 0)];
    assert!(contradiction(&[-5.0, -5.0], &frames).is_some());
    assert_eq!(contradiction(&[-5.0, -4.0], &frames), None);
    assert!(contradiction(&[-4.0, -5.0], &frames).is_some());
    // A difference of 0.3 EV in light may be due to the weather, and is not a contradiction.
    assert_eq!(contradiction(&[0.0, 0.0], &[picture(0.0, 0), picture(0.3, 0)]), None);
}

#[test]
fn a_step_that_is_far_off_contradicts() {
    let frames = [picture(0.0, 0), picture(2.0, 0)];
    // A written step that is 2 EV too large is tolerated, because the estimate may be rough. A written step that is 20
    // EV too large, a factor of a million, is a contradiction.
    assert_eq!(contradiction(&[0.0, 4.0], &frames), None);
    assert!(contradiction(&[0.0, 22.0], &frames).is_some());
    assert!(contradiction(&[22.0, 0.0], &frames).is_some());
    let far = [picture(-2.0, 0), picture(2.0, 0)];
    assert!(contradiction(&[0.0, 0.5], &far).is_some());
    assert_eq!(contradiction(&[0.0, 2.5], &far), None);
}

#[test]
fn a_step_between_barely_exposed_frames_does_not_contradict() {
    // The logarithm of this curve is three times as steep as that of the sRGB curve, so a step seems up to three times
    // as large.
    let film = |light: f64| linear_to_srgb(light * light * light);
    let frames = [-5.0, -3.0].map(|ev| taken(five_decades, ev, 0, film));
    let seen = step(&frames[0], &frames[1]).unwrap();
    assert!(seen.ev >= 2.0 + 3.0 && !seen.is_well_exposed, "{seen:?}");
    assert_eq!(contradiction(&[-5.0, -3.0], &frames), None);
}

#[test]
fn the_few_are_at_odds_with_the_many() {
    let frames: Vec<_> = [-2.0, 0.0, 2.0, 1.0, -1.0].map(|ev| picture(ev, 0)).into();
    let true_evs = [-2.0, 0.0, 2.0, 1.0, -1.0];
    let with = |changes: &[(usize, f64)]| {
        let mut written = true_evs;
        changes.iter().for_each(|&(i, ev)| written[i] = ev);
        at_odds(&written, &frames)
    };
    assert_eq!(with(&[(2, 20.0)]), Some(vec![2]));
    assert_eq!(with(&[(1, -9.0), (3, 7.0)]), Some(vec![1, 3]));
    // The odd frame is found even if the contrast of the camera is unusual. The camera here has half of the contrast of
    // sRGB. All measured steps are then much too small, about a third of the true steps.
    let flat: Vec<_> = [-4.0, 0.0, 4.0, 2.0].map(|ev| seen(ev, (0.0, 0.5), 0)).into();
    assert_eq!(at_odds(&[-4.0, 0.0, 20.0, 2.0], &flat), Some(vec![2]));
    // Without frame 1, or without frame 2, there is no contradiction. The written and the measured step agree better
    // without frame 1.
    assert_eq!(at_odds(&[-2.0, 2.5, 2.0], &frames[..3]), Some(vec![1]));
    // Three of five frames are not a minority. Of three frames in reverse order, any two contradict each other.
    assert_eq!(with(&[(0, 9.0), (1, -9.0), (3, 14.0)]), None);
    assert_eq!(at_odds(&[2.0, 0.0, -2.0], &frames[..3]), None);
    assert_eq!(at_odds(&[0.0, 0.0], &frames[..2]), None);
}

/// With only two tones, nothing is known about the curve between them, so the step is not determined.
#[test]
fn two_tones_do_not_determine_a_step() {
    let tones = |dark: u8, bright: u8| {
        let codes = (0..3 * 64 * 64).map(|i| if i / 24 % 2 == 0 { dark } else { bright }).collect();
        Brightness::of(&Samples::Eight(codes), 64)
    };
    assert!(estimate(&[tones(15, 115), tones(30, 190)]).is_none());
    assert_eq!(contradiction(&[0.0, 2.0], &[tones(15, 115), tones(30, 190)]), None);
}

#[test]
fn sixteen_bits_give_the_result_of_eight() {
    let eight: Vec<u8> = (0..3 * 64 * 64u32).map(|i| (i * 7 % 251) as u8).collect();
    let sixteen = eight.iter().map(|&c| u16::from(c) * 257).collect();
    let (a, b) = (Brightness::of(&Samples::Eight(eight), 64), Brightness::of(&Samples::Sixteen(sixteen), 64));
    assert!(a.is_like(&b));
}

#[test]
fn black_and_white_cannot_be_compared() {
    let flat = |v: u8| Brightness::of(&Samples::Eight(vec![v; 3 * 64 * 64]), 64);
    assert!(estimate(&[flat(0), flat(255)]).is_none());
}
