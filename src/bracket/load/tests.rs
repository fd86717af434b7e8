//! Loading whole brackets, from files made here.

use super::*;
use crate::bracket::Capture;
use crate::bracket::colour::Profile;
use crate::bracket::decode::tests::{jpeg, scene, with_exif};
use exif::{Tag, Value};
use std::fs;
use tempfile::TempDir;

/// A folder of files.
struct Files {
    folder: TempDir,
}

impl Files {
    fn new() -> Self {
        Files { folder: TempDir::new().unwrap() }
    }

    fn add(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }
}

const WIDTH: usize = 128;

/// Returns a smooth scene as 8-bit RGB, exposed by `ev` stops. The simulated camera raises the contrast, compresses the
/// highlights, and applies the sRGB curve.
fn exposed(ev: f64) -> Vec<u8> {
    (0..WIDTH * 96)
        .flat_map(|i| {
            let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
            let scene = 2.5 * (x / 23.0).sin() + 2.0 * (y / 19.0).cos();
            let power = 2f64.powf(scene + ev - 2.5).min(1.0).powf(1.5);
            let light = 9.0 * power / (1.0 + 8.0 * power);
            let v = if light <= 0.0031308 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
            [(v.min(1.0) * 255.0) as u8; 3]
        })
        .collect()
}

fn time(num: u32, denom: u32) -> (Tag, Value) {
    (Tag::ExposureTime, Value::Rational(vec![exif::Rational { num, denom }]))
}

fn f_number(tenths: u32) -> (Tag, Value) {
    (Tag::FNumber, Value::Rational(vec![exif::Rational { num: tenths, denom: 10 }]))
}

fn shot(ev: f64, fields: &[(Tag, Value)]) -> Vec<u8> {
    let plain = jpeg(&exposed(ev), WIDTH);
    if fields.is_empty() { plain } else { with_exif(&plain, fields) }
}

fn evs(bracket: &Bracket) -> Vec<f64> {
    bracket.frames().iter().map(|f| f.exposure.ev()).collect()
}

fn sources(bracket: &Bracket) -> Vec<ExposureSource> {
    bracket.frames().iter().map(|f| f.exposure.source).collect()
}

#[test]
fn a_bracket_is_the_same_in_any_order() {
    let files = Files::new();
    for with_tags in [true, false] {
        let paths: Vec<PathBuf> = [0i32, -2, 2, 1]
            .iter()
            .map(|&ev| {
                let fields = [time(1 << (ev + 2), 400), f_number(80)];
                let bytes = shot(f64::from(ev), if with_tags { &fields } else { &[] });
                files.add(&format!("{with_tags}{ev}.jpg"), &bytes)
            })
            .collect();
        let options = LoadOptions::default();
        let (bracket, warnings) = load(&paths, &options).unwrap();
        let turned: Vec<PathBuf> = [2, 0, 3, 1].iter().map(|&i: &usize| paths[i].clone()).collect();
        let (other, other_warnings) = load(&turned, &options).unwrap();
        for (a, b) in bracket.frames().iter().zip(other.frames()) {
            assert_eq!((a.path(), &a.exposure, &a.profile), (b.path(), &b.exposure, &b.profile));
            assert_eq!(a.whole().unwrap().codes(), b.whole().unwrap().codes());
        }
        assert_eq!((bracket.reference_index(), &warnings), (other.reference_index(), &other_warnings));
        let names: Vec<_> = bracket
            .frames()
            .iter()
            .map(|f| f.path().file_stem().unwrap().to_str().unwrap()[with_tags.to_string().len()..].to_string())
            .collect();
        assert_eq!(names, ["-2", "0", "1", "2"]);
        assert_eq!(warnings.len(), usize::from(!with_tags), "{warnings:?}");
    }
}

#[test]
fn exif_gives_exposure_and_capture() {
    let files = Files::new();
    let text = |s: &str| Value::Ascii(vec![s.as_bytes().to_vec()]);
    let more = [
        (Tag::Make, text("Acme ")),
        (Tag::LensModel, text("50 mm")),
        (Tag::DateTimeOriginal, text("2026:11:20 08:00:00")),
        (Tag::FocalLength, Value::Rational(vec![exif::Rational { num: 50, denom: 1 }])),
    ];
    let dark = files.add("a.jpg", &shot(-1.0, &[&[time(1, 100), f_number(80)], &more[..]].concat()));
    let bright = files
        .add("b.jpg", &shot(1.0, &[time(4, 100), f_number(80), (Tag::DateTimeOriginal, text("0000:00:00 00:00:00"))]));
    let (bracket, warnings) = load(&[bright, dark], &LoadOptions::default()).unwrap();
    assert_eq!(warnings, []);
    let frame = &bracket.frames()[0];
    assert_eq!((frame.exposure.time_s, frame.exposure.f_number, frame.exposure.iso), (Some(0.01), Some(8.0), None));
    // Cameras write rounded times. 1/125 s stands for 2^-7 s. 1/100 s is a third of a stop longer and stands for
    // 2^(-20/3) s. The f-number is 8, which divides the exposure by 64.
    assert!((frame.exposure.relative() / (libm::exp2(-20.0 / 3.0) / 64.0) - 1.0).abs() < 1e-12);
    assert_eq!(frame.exposure.tags, "ExposureTime, FNumber");
    let wanted = Capture {
        make: Some("Acme".into()),
        model: None,
        date: Some("2026:11:20 08:00:00".into()),
        taken: frame.capture.taken,
        lens: Some("50 mm".into()),
        focal_length_mm: Some(50.0),
        exif: frame.capture.exif.clone(),
    };
    assert_eq!(frame.capture, wanted);
    assert_eq!(wanted.taken.map(|moment| moment.to_string()), wanted.date);
    let carried = exif::Reader::new().read_raw(wanted.exif.unwrap()).unwrap();
    assert!(carried.get_field(Tag::LensModel, exif::In::PRIMARY).is_some());
    let unset = &bracket.frames()[1].capture;
    assert_eq!((&unset.date, unset.taken), (&None, None), "the clock was never set");
}

#[test]
fn the_users_exposures_win_and_go_by_the_order_given() {
    let files = Files::new();
    let a = files.add("a.jpg", &shot(0.0, &[time(1, 100)]));
    let b = files.add("b.jpg", &shot(-3.0, &[time(1, 50)]));
    let with = |ev: &[f64]| load(&[a.clone(), b.clone()], &LoadOptions { ev: Some(ev.into()), ..Default::default() });
    let (bracket, warnings) = with(&[2.0, -1.0]).unwrap();
    assert_eq!((evs(&bracket), bracket.frames()[0].path()), (vec![-1.0, 2.0], b.as_path()));
    assert_eq!((sources(&bracket), warnings.len()), (vec![ExposureSource::Given; 2], 0));
    for wrong in [&[1.0][..], &[1.0, 2.0, 3.0], &[1.0, f64::NAN], &[f64::INFINITY, 0.0], &[1e9, 0.0]] {
        assert!(matches!(with(wrong), Err(Error::Option { option: "-e", .. })), "{wrong:?}");
    }
}

#[test]
fn missing_exposures_are_estimated_and_reported() {
    let files = Files::new();
    let paths: Vec<_> = (0..3).map(|i| files.add(&format!("{i}.jpg"), &shot(2.0 * f64::from(i) - 2.0, &[]))).collect();
    let (bracket, warnings) = load(&paths, &LoadOptions::default()).unwrap();
    let evs = evs(&bracket);
    assert!((evs[1] - evs[0] - 2.0).abs() < 0.3 && (evs[2] - evs[1] - 2.0).abs() < 0.3 && evs[1] == 0.0, "{evs:?}");
    assert_eq!(sources(&bracket), [ExposureSource::Estimated; 3]);
    assert!(matches!(warnings[..], [Warning::ExposureEstimated { .. }]) && warnings[0].degrades());
}

#[test]
fn one_missing_exposure_is_anchored_by_the_others() {
    let files = Files::new();
    let a = files.add("a.jpg", &shot(-2.0, &[time(1, 400)]));
    let b = files.add("b.jpg", &shot(0.0, &[time(1, 100)]));
    let c = files.add("c.jpg", &shot(2.0, &[]));
    let (bracket, _) = load(&[a, b, c], &LoadOptions::default()).unwrap();
    let evs = evs(&bracket);
    assert!((evs[0] - libm::log2(1.0 / 400.0)).abs() < 0.4 && (evs[2] - libm::log2(0.04)).abs() < 0.6, "{evs:?}");
}

#[test]
fn exif_that_contradicts_the_pixels_is_not_used() {
    let files = Files::new();
    let same = [time(1, 60), f_number(80)];
    let a = files.add("a.jpg", &shot(-1.0, &same));
    let b = files.add("b.jpg", &shot(1.0, &same));
    let (bracket, warnings) = load(&[b.clone(), a], &LoadOptions::default()).unwrap();
    assert!(matches!(warnings[..], [Warning::ExposureContradicted { .. }]), "{warnings:?}");
    assert_eq!(bracket.frames()[1].path(), b);
    assert_eq!((bracket.frames()[0].exposure.time_s, bracket.frames()[0].exposure.f_number), (None, Some(8.0)));

    let c = files.add("c.jpg", &shot(1.02, &same));
    let (_, warnings) = load(&[b, c], &LoadOptions::default()).unwrap();
    assert_eq!(warnings, [], "a burst at one exposure is no contradiction");
}

#[test]
fn equal_pictures_without_exposures_are_refused() {
    let files = Files::new();
    let a = files.add("a.jpg", &shot(0.0, &[]));
    let b = files.add("b.jpg", &shot(0.01, &[]));
    let error = load(&[a, b], &LoadOptions::default()).unwrap_err();
    assert!(matches!(error, Error::NoExposure { .. }) && error.to_string().contains("-e"), "{error}");
}

#[test]
fn a_missing_f_number_is_assumed_with_a_warning() {
    let files = Files::new();
    let a = files.add("a.jpg", &shot(-1.0, &[time(1, 100), f_number(40)]));
    let b = files.add("b.jpg", &shot(1.0, &[time(1, 25)]));
    let (bracket, warnings) = load(&[a, b.clone()], &LoadOptions::default()).unwrap();
    assert_eq!(evs(&bracket)[1] - evs(&bracket)[0], 2.0);
    assert!(matches!(&warnings[..], [Warning::ExposureIncomplete { path, .. }] if *path == b), "{warnings:?}");
}

#[test]
fn invalid_list_of_files_is_an_error_that_names_the_fault() {
    let files = Files::new();
    let a = files.add("a.jpg", &shot(0.0, &[time(1, 100)]));
    let text = files.add("text.jpg", b"This is not a picture.\n");
    let empty = files.add("empty.jpg", b"");
    let small = files.add("small.jpg", &with_exif(&jpeg(&scene(16, 16), 16), &[time(1, 9)]));
    let gone = files.folder.path().join("gone.jpg");
    let error = |paths: &[&PathBuf]| {
        let paths: Vec<PathBuf> = paths.iter().map(|p| p.to_path_buf()).collect();
        load(&paths, &LoadOptions::default()).unwrap_err()
    };
    assert!(matches!(error(&[]), Error::TooFewFrames { given: 0 }));
    assert!(matches!(error(&[&a]), Error::TooFewFrames { given: 1 }));
    assert!(matches!(error(&[&a, &a]), Error::SameFile { .. }));
    assert!(matches!(error(&[&a, &gone]), Error::Read { path, .. } if path == gone));
    assert!(error(&[&a, &files.folder.path().to_path_buf()]).to_string().contains("folder"));
    assert!(matches!(error(&[&a, &text, &empty]), Error::UnknownFormat { found, .. } if found == "text"));
    assert!(matches!(error(&[&empty, &text, &a]), Error::UnknownFormat { found, .. } if found == "empty file"));
    assert!(matches!(error(&[&a, &small]), Error::SizeMismatch { path, size: (16, 16), .. } if path == small));
}

#[cfg(unix)]
#[test]
fn links_are_the_same_file() {
    let files = Files::new();
    let a = files.add("a.jpg", &shot(0.0, &[]));
    let soft = files.folder.path().join("soft.jpg");
    let hard = files.folder.path().join("hard.jpg");
    std::os::unix::fs::symlink(&a, &soft).unwrap();
    fs::hard_link(&a, &hard).unwrap();
    for link in [soft, hard] {
        let error = load(&[a.clone(), link.clone()], &LoadOptions::default()).unwrap_err();
        assert!(matches!(error, Error::SameFile { path, other } if path == link && other == a));
    }
}

#[test]
fn the_extension_does_not_matter() {
    let files = Files::new();
    let rgb = exposed(0.0);
    let mut png = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut png);
    image::ImageEncoder::write_image(encoder, &rgb, WIDTH as u32, 96, image::ExtendedColorType::Rgb8).unwrap();
    let a = files.add("a.jpg", &png);
    let b = files.add("b.txt", &shot(2.0, &[]));
    let options = LoadOptions { ev: Some(vec![0.0, 2.0]), ..Default::default() };
    let (bracket, _) = load(&[a, b], &options).unwrap();
    assert_eq!(bracket.frames()[0].whole().unwrap().codes(), Codes::Eight(&rgb));
}

#[test]
fn different_profiles_are_a_warning() {
    let files = Files::new();
    let adobe = |bytes: &[u8]| {
        let icc = Profile::adobe_rgb().unwrap().icc;
        crate::bracket::decode::tests::with_segment(bytes, 0xE2, &[&b"ICC_PROFILE\0\x01\x01"[..], &icc].concat())
    };
    let a = files.add("a.jpg", &adobe(&shot(-1.0, &[time(1, 100)])));
    let b = files.add("b.jpg", &shot(1.0, &[time(1, 25)]));
    let options = LoadOptions { reference: ReferenceChoice::Number(1), ..Default::default() };
    let (bracket, warnings) = load(&[a.clone(), b.clone()], &options).unwrap();
    assert!(bracket.reference().primaries().is_close(&crate::bracket::colour::Primaries::ADOBE_RGB, 0.002));
    assert!(matches!(&warnings[..], [Warning::ProfilesDiffer { path, .. }] if *path == b), "{warnings:?}");
}

#[test]
fn progress_counts_the_files() {
    let files = Files::new();
    let paths = [files.add("a.jpg", &shot(0.0, &[])), files.add("b.jpg", &shot(2.0, &[]))];
    let most = AtomicUsize::new(0);
    load_with_progress(&paths, &LoadOptions::default(), &|n| {
        most.fetch_max(n, Ordering::Relaxed);
    })
    .unwrap();
    assert_eq!(most.into_inner(), 2);
}
