//! Tests of the stage, and a static bracket for the tests of other stages.

use super::*;
use crate::bracket::exposure::Exposure;
use crate::bracket::{Frame, ReferenceChoice, Samples};

/// Returns a static bracket with exposures `times`. `radiance` gives the radiance at a column and row; code values
/// follow sRGB.
pub(crate) fn still(
    (width, height): (usize, usize),
    times: &[f64],
    radiance: impl Fn(usize, usize) -> [f64; 3],
) -> (Bracket, Alignment) {
    let encode = |x: f64| match x.clamp(0.0, 1.0) {
        x if x <= 0.0031308 => 12.92 * x,
        x => 1.055 * libm::pow(x, 1.0 / 2.4) - 0.055,
    };
    let frame = |&time: &f64| {
        let pixels = (0..width * height).flat_map(|i| radiance(i % width, i / width));
        let codes = pixels.map(|e| (255.0 * encode(e * time) + 0.5) as u8).collect();
        Frame::new(
            format!("{time}.png").into(),
            width,
            height,
            Samples::Eight(codes),
            Exposure::given(libm::log2(time)).unwrap(),
        )
    };
    let bracket =
        Bracket::new(times.iter().map(frame).collect(), &ReferenceChoice::Number(1 + times.len() / 2)).unwrap();
    let alignment = Alignment::unmoved(&bracket);
    (bracket, alignment)
}

/// Returns the radiance of tiles of 20 pixels, over ten stops.
fn tiles(x: usize, y: usize) -> [f64; 3] {
    let e = libm::exp2(((x / 20) * 7 + (y / 20) * 13) as f64 % 101.0 / 10.0 - 8.0);
    [e, 1.1 * e, 0.8 * e]
}

#[test]
fn curve_of_a_bracket_is_recovered_and_grey_stays_grey() {
    let (bracket, alignment) = still((400, 300), &[0.25, 1.0, 4.0], tiles);
    let (curve, report, warnings) = recover(&bracket, &alignment, &ResponseModel::default()).unwrap();
    assert!(warnings.is_empty() && report.channels.is_some(), "{report:?}");
    let (srgb, n) = (ResponseCurve::srgb(), 236.0);
    for c in 0..3 {
        let d = |z: usize| stops(curve.ln_exposure(c)[z] - srgb.ln_exposure(c)[z]);
        // A shift that is common to all channels does not matter. The tolerance of 0.05 stops is 3.5 %.
        let mean = (10..=245).map(|z| stops(curve.ln_exposure(1)[z] - srgb.ln_exposure(1)[z])).sum::<f64>() / n;
        let rms = ((10..=245).map(|z| (d(z) - mean) * (d(z) - mean)).sum::<f64>() / n).sqrt();
        assert!(rms < 0.05, "channel {c}: {rms} stops");
    }
    let mean = |c: usize| (0..CODES).map(|z| hat(z as f64) * curve.ln_exposure(c)[z]).sum::<f64>();
    assert!((mean(0) - mean(1)).abs() < 1e-9 && (mean(2) - mean(1)).abs() < 1e-9);
}

/// Shifts the curve by the constant that brings it closest to the sRGB curve. Returns the root mean square of the
/// remaining difference over codes 10..=245 of all channels, in stops.
fn off(curve: &ResponseCurve) -> f64 {
    let srgb = ResponseCurve::srgb();
    let codes = (0..3).flat_map(|c| (10..=245).map(move |z| (c, z)));
    let d: Vec<f64> = codes.map(|(c, z)| stops(curve.ln_exposure(c)[z] - srgb.ln_exposure(c)[z])).collect();
    let mean = d.iter().sum::<f64>() / d.len() as f64;
    (d.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / d.len() as f64).sqrt()
}

fn recovered() -> [ResponseModel; 3] {
    [
        ResponseModel::default(),
        ResponseModel::Robertson(Default::default()),
        ResponseModel::MitsunagaNayar(Default::default()),
    ]
}

#[test]
fn every_model_recovers_the_curve() {
    let (bracket, alignment) = still((400, 300), &[0.25, 1.0, 4.0], tiles);
    for (model, name) in recovered().iter().zip(["debevec", "robertson", "mitsunaga-nayar"]) {
        let (curve, report, warnings) = recover(&bracket, &alignment, model).unwrap();
        assert_eq!((report.model, warnings.len()), (name, 0), "{report:?}");
        assert!(off(&curve) < 0.05, "{name}: {}", off(&curve));
        let ratios = report.exposure_ratios.unwrap_or_default();
        assert_eq!(ratios.len(), if name == "mitsunaga-nayar" { 2 } else { 0 });
        // The steps are two stops each, and exact: estimates differ only by the rounding of codes.
        assert!(ratios.iter().all(|r| r.given_stops == 2.0 && (r.found_stops - 2.0).abs() < 0.03), "{ratios:?}");
    }
}

#[test]
fn undetermined_channel_borrows_the_curve_with_a_warning() {
    let (bracket, alignment) = still((400, 300), &[0.25, 1.0, 4.0], |x, y| {
        let [r, g, _] = tiles(x, y);
        [r, g, 0.0]
    });
    for model in recovered() {
        let (curve, report, warnings) = recover(&bracket, &alignment, &model).unwrap();
        assert_eq!(report.channels.unwrap().map(|fit| fit.borrowed), [false, false, true]);
        assert!(matches!(&warnings[..], [Warning::ResponseBorrowed { channel: "blue", .. }]), "{warnings:?}");
        assert!(off(&curve) < 0.05, "{}", off(&curve));
    }
}

#[test]
fn brackets_of_one_camera_give_a_better_curve_together() {
    // One bracket shows the shadows of the curve, the other the rest, at unrelated exposures.
    let dark = still((400, 300), &[0.25, 1.0], |x, y| tiles(x, y).map(|e| 0.02 * e));
    let bright = still((400, 300), &[30.0, 60.0, 120.0], |x, y| tiles(x, y).map(|e| 0.001 + e / 120.0));
    let (_, report, _) = recover(&dark.0, &dark.1, &ResponseModel::default()).unwrap();
    assert!(report.fallback.is_some());
    let [dark, bright] = [dark, bright].map(|(bracket, alignment)| Places::of(&bracket, &alignment).unwrap());
    let (both, report, _) = recover_from(&[&dark, &bright], &ResponseModel::default()).unwrap();
    assert!(report.fallback.is_none() && off(&both) < 0.03, "{} {report:?}", off(&both));
    let (reversed, ..) = recover_from(&[&bright, &dark], &ResponseModel::default()).unwrap();
    // The two curves need not be equal: sums are computed in another order, and if places are equally flat, others of
    // them may be chosen.
    assert!((off(&reversed) - off(&both)).abs() < 0.01);
    let (none, report, _) = recover_from(&[], &ResponseModel::default()).unwrap();
    assert!(none == ResponseCurve::srgb() && report.fallback.is_some());
}

#[test]
fn one_curve_on_any_number_of_threads() {
    let (bracket, alignment) = still((400, 300), &[0.25, 1.0, 4.0], tiles);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| recover(&bracket, &alignment, &ResponseModel::default()).unwrap().0)
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn undetermined_curve_is_replaced_by_srgb_with_a_warning() {
    for (times, radiance) in [([1.0, 1.0 + 1e-9], 0.2), ([1.0, 4.0], 9.0), ([1.0, 4.0], 0.0)] {
        let (bracket, alignment) = still((100, 80), &times, |_, _| [radiance; 3]);
        let (curve, report, warnings) = recover(&bracket, &alignment, &ResponseModel::default()).unwrap();
        assert_eq!((curve, report.model), (ResponseCurve::srgb(), "srgb"));
        assert!(matches!(&warnings[..], [Warning::ResponseFallback { .. }]), "{warnings:?}");
    }
}

#[test]
fn linear_and_srgb_curves_follow_their_definitions() {
    let srgb = ResponseCurve::srgb();
    // Code 188 of sRGB is 0.5029 of the light of 255 (calculated from the standard's formula).
    assert!((srgb.exposure(0, 188.0) / srgb.exposure(0, 255.0) - 0.5029).abs() < 1e-4);
    let linear = ResponseCurve::linear();
    assert!((linear.exposure(2, 64.5) * 128.0 - 64.5).abs() < 1e-4);
    assert!(ResponseCurve::new([[0.0; CODES]; 3]).is_none());
}

#[test]
fn code_is_the_inverse_of_exposure() {
    let curve = ResponseCurve::srgb();
    for code in (0..=2550).map(|z| z as f32 / 10.0) {
        let found = curve.code(1, curve.exposure(1, code));
        // An exposure is rounded twice, by 2^-24 each; a step of one code is at least 2^-8 of the exposure, so the
        // error is at most 2^-15 codes.
        assert!((found - code).abs() < 1e-4, "{code}: {found}");
    }
    assert_eq!((curve.code(0, 0.0), curve.code(0, f32::INFINITY)), (0.0, 255.0));
}
