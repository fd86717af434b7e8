//! Several brackets of one camera and one scene: one unit of radiance, one response.

use crate::support::{FRAMES, Folder, jpeg};
use hdralign::align::{AlignMode, AlignOptions};
use hdralign::bracket::{LoadOptions, ReferenceChoice};
use hdralign::error::Error;
use hdralign::merge::radiance::calibration::Calibration;
use hdralign::pipeline::camera::{self, CameraReport};
use hdralign::pipeline::{self, Options, Outcome};
use hdralign::response::ResponseModel;
use hdralign::response::ratios::Exposures;
use image::{Rgb, RgbImage};
use std::path::PathBuf;

const SIZE: (u32, u32) = (160, 120);

/// Returns t ISO / N^2 of frame `i`, as in its EXIF: from 1/512 s in steps of two stops, at f/8 and ISO 100.
fn exposure(i: usize) -> f64 {
    f64::powi(4.0, i as i32 - 1) / 512.0 * 100.0 / 64.0
}

/// Returns the radiance of the scene at a pixel: tiles of ten pixels, over ten stops. It is grey, so that the
/// subsampling of chroma in JPEG has no effect.
fn scene(x: u32, y: u32) -> f64 {
    f64::exp2(f64::from((x / 10) * 7 + (y / 10) * 13) % 101.0 / 10.0 - 3.0)
}

/// Creates a folder with frames of [`scene`], encoded by the sRGB curve, `s1.jpg` to `s5.jpg`.
fn scenes() -> Folder {
    let folder = Folder::empty();
    for i in 1..=FRAMES {
        let picture = RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
            let light = (scene(x, y) * exposure(i)).clamp(0.0, 1.0);
            let encoded = if light <= 0.0031308 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
            Rgb([(255.0 * encoded + 0.5) as u8; 3])
        });
        folder.put(&format!("s{i}.jpg"), &jpeg(&picture, Some(i)));
    }
    folder
}

fn of(folder: &Folder, frames: std::ops::RangeInclusive<usize>) -> Vec<PathBuf> {
    frames.map(|i| folder.at(format!("s{i}.jpg"))).collect()
}

fn options(unit_exposure: Option<f64>) -> Options {
    Options {
        load: LoadOptions { reference: ReferenceChoice::Number(2), ..LoadOptions::default() },
        align: AlignOptions { mode: AlignMode::None, ..AlignOptions::default() },
        exposures: Exposures::AsGiven,
        response: ResponseModel::Srgb,
        unit_exposure,
        ..Options::default()
    }
}

/// Returns the median ratio of green in `b` to green in `a` over the pixels that are well exposed in frame 3, which
/// both brackets contain.
fn ratio(a: &Outcome, b: &Outcome) -> f64 {
    let mut ratios = Vec::new();
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            // These are the code values 63 to 188 of the sRGB curve.
            if (0.05..0.5).contains(&(scene(x, y) * exposure(3))) {
                let at = |o: &Outcome| f64::from(o.radiance.pixels.at(x as usize, y as usize)[1]);
                ratios.push(at(b) / at(a));
            }
        }
    }
    assert!(ratios.len() > 1000, "{}", ratios.len());
    ratios.sort_by(f64::total_cmp);
    ratios[ratios.len() / 2]
}

#[test]
fn normalised_brackets_have_the_same_unit() {
    let folder = scenes();
    let develop = |frames, unit| pipeline::develop(&of(&folder, frames), &options(unit), &pipeline::unwatched).unwrap();
    let (short, long) = (develop(1..=3, None), develop(3..=5, None));
    let unit_of = |o: &Outcome| {
        let radiance = o.report.radiance.as_ref().unwrap();
        (radiance.reference_exposure, radiance.unit_exposure_s)
    };
    assert_eq!(unit_of(&short), (exposure(2), Some(exposure(2))));
    // Code values are rounded, and JPEG quantises them in steps of 2. So a pixel has an error of up to one code value,
    // or 3 %, and the median over thousands of pixels with errors of either sign an error below 1 %.
    let own = ratio(&short, &long);
    assert!((own / (exposure(4) / exposure(2)) - 1.0).abs() < 0.01, "{own}");

    let unit = 0.037;
    let (short_in_unit, long_in_unit) = (develop(1..=3, Some(unit)), develop(3..=5, Some(unit)));
    let common = ratio(&short_in_unit, &long_in_unit);
    assert!((common - 1.0).abs() < 0.01, "{common}");
    assert_eq!(unit_of(&short_in_unit), (exposure(2), Some(unit)));
    assert_eq!(unit_of(&long_in_unit), (exposure(4), Some(unit)));
    // The same bracket in another unit has radiance that differs by `factor`, except for two roundings to `f32`, with
    // relative errors of 2^-24 = 6e-8 each.
    let factor = unit / exposure(2);
    for (a, b) in short.radiance.pixels.as_slice().iter().zip(short_in_unit.radiance.pixels.as_slice()) {
        assert!((0..3).all(|c| (f64::from(b[c]) / (f64::from(a[c]) * factor) - 1.0).abs() < 1.2e-7), "{a:?} {b:?}");
    }
    // At the unit exposure, radiance 1 gives the middle code value. By the sRGB curve, the exposure of the middle code
    // value is 0.2158 of the exposure that saturates. In the scene, a pixel saturates if the product of radiance and
    // exposure is 1.
    let (x, y) = (0..SIZE.0).map(|x| (x, 5)).find(|&(x, y)| (0.1..0.3).contains(&(scene(x, y) * exposure(3)))).unwrap();
    let light = f64::from(long_in_unit.radiance.pixels.at(x as usize, y as usize)[1]) * 0.2158 / unit;
    assert!((light / scene(x, y) - 1.0).abs() < 0.03, "{light} {}", scene(x, y));
}

#[test]
fn absolute_files_state_their_unit_and_other_formats_are_rejected() {
    let folder = scenes();
    let files: Vec<PathBuf> = ["a.exr", "a.json", "a.html"].map(|name| folder.at(name)).into();
    let run = |o: Options| pipeline::run(&of(&folder, 1..=3), &o, &pipeline::unwatched);
    run(Options {
        outputs: vec![files[0].clone()],
        report: Some(files[1].clone()),
        save_aligned: Some(folder.at("al_")),
        ..options(Some(0.25))
    })
    .unwrap();
    let json: serde_json::Value = serde_json::from_slice(&folder.bytes("a.json")).unwrap();
    assert_eq!(json["radiance"]["unit_exposure_s"], 0.25);
    let comment = "radiance 1.0 gives the middle pixel value (128 of 255) if the exposure (t ISO / N^2) is 0.25 s";
    let comments = hdralign::read::read(&files[0]).unwrap().1.comments.join("; ");
    assert!(comments.starts_with(comment), "{comments}");
    let has = |name: &str| folder.bytes(name).windows(comment.len()).any(|bytes| bytes == comment.as_bytes());
    let aligned = folder.listing().into_iter().find(|(name, _)| name.starts_with("al_")).unwrap().0;
    assert!(has("a.exr") && !has(&aligned), "a frame has no unit");
    run(Options { report: Some(files[2].clone()), ..options(Some(0.25)) }).unwrap();
    assert!(String::from_utf8_lossy(&folder.bytes("a.html")).contains("at the exposure of --normalize"));

    let given = LoadOptions { ev: Some(vec![-2.0, 0.0, 2.0]), ..LoadOptions::default() };
    let absolute = Calibration { camera: true, factor: None };
    for (o, said) in [
        (Options { load: given, ..options(Some(0.25)) }, "given by -e"),
        (Options { calibration: absolute, ..options(Some(0.25)) }, "--absolute"),
        (options(Some(-1.0)), "above 0"),
    ] {
        let error = run(o).unwrap_err();
        assert!(error.is_usage() && error.to_string().contains(said), "{error}");
    }
    let calibrated = Options { calibration: absolute, report: Some(folder.at("c.json")), ..options(None) };
    run(calibrated).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&folder.bytes("c.json")).unwrap();
    assert!(json["radiance"]["unit_exposure_s"].is_null() && json["radiance"]["reference_exposure"].is_number());
}

/// Recovers the response of `brackets`, saves it as `name`, and returns the report.
fn recover(
    folder: &Folder,
    brackets: &[Vec<PathBuf>],
    name: &str,
    lenient: bool,
) -> hdralign::error::Result<CameraReport> {
    let line = Options { response: ResponseModel::default(), ..options(None) };
    let options = camera::Options { pipeline: line, curves: vec![folder.at(name)], plots: Vec::new(), lenient };
    camera::prepare(brackets, &options, &pipeline::unwatched)?.commit()
}

#[test]
fn unusable_bracket_is_skipped_for_the_response_on_request() {
    let folder = scenes();
    folder.put("bad.jpg", b"\xff\xd8\xff no more");
    let good = [of(&folder, 1..=3), of(&folder, 2..=4), of(&folder, 3..=5)];
    let alone = vec![folder.at("s1.jpg")];
    let bad = vec![folder.at("s1.jpg"), folder.at("bad.jpg")];
    let report = recover(&folder, &good, "good.json", false).unwrap();
    assert_eq!((report.brackets.len(), report.is_degraded()), (3, false));

    let mixed = [good[0].clone(), bad.clone(), good[1].clone(), alone.clone(), good[2].clone()];
    let error = recover(&folder, &mixed, "mixed.json", false).unwrap_err();
    assert!(error.to_string().contains("bad.jpg") && !folder.at("mixed.json").exists(), "{error}");
    let report = recover(&folder, &mixed, "mixed.json", true).unwrap();
    assert_eq!(report.brackets.len(), 3);
    let reported: Vec<&str> = report.warnings.iter().filter(|w| w.degrades).map(|w| w.message.as_str()).collect();
    assert_eq!(reported.len(), 2, "{reported:?}");
    assert!(reported[0].contains("s1.jpg: its bracket is not used") && reported[0].contains("bad.jpg"), "{reported:?}");
    assert!(reported[1].contains("at least two photographs"), "{reported:?}");
    assert_eq!(folder.bytes("mixed.json"), folder.bytes("good.json"), "what is left out takes no part");

    let error = recover(&folder, &[bad, alone], "none.json", true).unwrap_err();
    assert!(matches!(&error, Error::NoResponse { path, .. } if path.ends_with("s1.jpg")), "{error}");
    assert!(error.to_string().contains("none of the 2 brackets") && error.to_string().contains("bad.jpg"), "{error}");
    assert!(recover(&folder, &[], "none.json", true).unwrap_err().is_usage());
    assert!(!folder.at("none.json").exists());
}
