use super::*;
use crate::bracket::colour::srgb_to_linear;
use crate::bracket::{Codes, LoadOptions, load};
use crate::write::metadata::Metadata;
use crate::write::{Pending, RowWriter, commit};
use std::path::Path;

const SIZE: (usize, usize) = (70, 130);

/// A ramp of ten stops in three colours, up to 40.
fn radiance() -> Plane<[f32; 3]> {
    Plane::from_rows(SIZE.0, SIZE.1, |y, row| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let v = 40.0 * libm::exp2f(-((x * SIZE.1 + y) as f32) / 910.0);
            *pixel = [v, 0.5 * v, 0.25 * v];
        }
    })
}

fn metadata() -> Metadata {
    let photographed = Photographed { longest: 0.5, shortest: 2.0, contrast: 1.5, white_stops: 2.0 };
    let mut metadata = Metadata { comments: vec![photographed.to_string()], time_s: Some(0.01), ..Metadata::default() };
    (metadata.f_number, metadata.iso) = (Some(4.0), Some(100.0));
    // Results of this program are refused as photographs.
    metadata.software = "another program".into();
    metadata
}

fn brightness(radiance: &Plane<[f32; 3]>) -> Brightness {
    let mut survey = Survey::new(&Primaries::SRGB);
    survey.see(radiance);
    survey.brightness()
}

/// Writes the file, `portion` rows at a time.
fn write(path: &Path, encoding: Encoding, portion: usize) -> Vec<u8> {
    let radiance = radiance();
    let file = Pending::create(path).unwrap();
    let mut writer = Box::new(Writer::new(file, SIZE, &metadata(), encoding, brightness(&radiance)).unwrap());
    radiance.as_slice().chunks(portion * SIZE.0).for_each(|rows| writer.push(rows).unwrap());
    commit(vec![writer.finish().unwrap().file], true).unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn files_are_read_as_camera_raw_in_any_encoding() {
    let dir = tempfile::tempdir().unwrap();
    for encoding in [Encoding::Half, Encoding::Float, Encoding::Integer] {
        let paths = ["a.dng", "b.dng"].map(|name| dir.path().join(name));
        let [first, second] = [write(&paths[0], encoding, 130), write(&paths[1], encoding, 1)];
        assert!(first == second, "portions of rows do not change the bytes");
        let options = LoadOptions { ev: Some(vec![0.0, 1.0]), ..LoadOptions::default() };
        let (bracket, _) = load(&paths, &options).unwrap();
        let frame = &bracket.frames()[0];
        assert_eq!((frame.width(), frame.height(), frame.is_raw()), (SIZE.0, SIZE.1, true));
        let profile = frame.profile.as_ref().and_then(|profile| profile.primaries.as_ref());
        assert!(profile.unwrap().is_close(&Primaries::SRGB, 1e-4), "{profile:?}");
        let whole = frame.whole().unwrap();
        let Codes::Sixteen(codes) = whole.codes() else { panic!("16 bits") };
        for (found, pixel) in codes.as_chunks::<3>().0.iter().zip(radiance().as_slice()) {
            for c in 0..3 {
                let (found, expected) = (srgb_to_linear(f64::from(found[c]) / 65535.0), f64::from(pixel[c]) / 40.0);
                // A half float has an error of up to 2^-11 of its value, an integer one of 0.5 / 65535. The codes of 16
                // bits in the sRGB curve have an error of up to 1e-5, and reading one of 2e-6 of white.
                assert!((found - expected).abs() < 5e-4 * expected + 2e-5, "{encoding}: {found} instead of {expected}");
            }
        }
    }
}

#[test]
fn baseline_exposure_is_that_of_the_photographs() {
    let brightness = brightness(&radiance());
    // The middle of the bracket has its middle code value at 1, and white two stops above it. The radiance is up to 40.
    let baseline = brightness.baseline(Photographed::read(&metadata().comments));
    assert!((baseline - libm::log2(40.0 / 4.0)).abs() < 1e-9, "{baseline}");
    // Without photographs, the mean becomes the middle: the ramp has ten stops, so its mean is five below 40.
    let luminance = 0.2126 + 0.5 * 0.7152 + 0.25 * 0.0722;
    let expected = 5.0 - libm::log2(luminance) + libm::log2(MIDDLE);
    let baseline = brightness.baseline(None);
    assert!((baseline - expected).abs() < 0.01, "{baseline} instead of {expected}");
    assert_eq!(Survey::new(&Primaries::SRGB).brightness(), Brightness::default());
}

#[test]
fn preview_shows_the_picture() {
    let mut preview = preview::Preview::new((3000, 100));
    let pixels: Vec<[f32; 3]> =
        (0..3000 * 100).map(|i| if i % 3000 < 1500 { [2.0; 3] } else { [0.5, 0.0, 0.0] }).collect();
    pixels.chunks(3000 * 7).for_each(|rows| preview.see(rows));
    assert_eq!(preview.size(), (1000, 33));
    let jpeg = preview.jpeg(&Primaries::SRGB, 2.0).unwrap();
    let decoded = image::load_from_memory(&jpeg).unwrap().to_rgb8();
    let near = |x: u32, expected: [u8; 3]| {
        let found = decoded.get_pixel(x, 20).0;
        assert!((0..3).all(|c| found[c].abs_diff(expected[c]) < 6), "{found:?}");
    };
    near(200, [255; 3]);
    // A quarter of white.
    near(800, [137, 0, 0]);
}
