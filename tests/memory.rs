//! A bracket in memory is merged without opening a file. The test is a program of its own, because it forbids its
//! process to open files.
#![cfg(target_os = "linux")]

use hdralign::bracket::exposure::Exposure;
use hdralign::bracket::{Bracket, Frame, ReferenceChoice};
use hdralign::error::Error;
use hdralign::pipeline::{self, Options, Progress, Stage};
use image::{DynamicImage, ImageBuffer};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::ops::ControlFlow;

/// Width and height of the frames.
const SIZE: (u32, u32) = (320, 240);

/// Returns the radiance of the scene: a ramp over eight stops with a texture of two scales.
fn radiance(x: i64, y: i64) -> f64 {
    let texture =
        1.0 + 0.4 * ((x as f64 * 0.31).sin() * (y as f64 * 0.23).cos()) + 0.2 * f64::from((x / 7 + y / 5) as u8 % 3);
    2f64.powf(8.0 * x as f64 / f64::from(SIZE.0) - 5.0) * texture
}

/// Returns a frame with an exposure of `ev` stops, displaced by `shift` pixels, encoded by the sRGB curve.
fn frame(ev: i32, shift: (i64, i64)) -> Frame {
    let image = ImageBuffer::from_fn(SIZE.0, SIZE.1, |x, y| {
        let light = radiance(i64::from(x) + shift.0, i64::from(y) + shift.1) * 2f64.powi(ev);
        let code = if light <= 0.0031308 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
        image::Rgb([(255.0 * code.clamp(0.0, 1.0)).round() as u8; 3])
    });
    let exposure = Exposure::given(f64::from(ev)).expect("finite");
    Frame::from_image(format!("{ev} EV"), DynamicImage::ImageRgb8(image), exposure).expect("a frame")
}

fn bracket() -> Bracket {
    let frames = vec![frame(-2, (3, -2)), frame(0, (0, 0)), frame(2, (-4, 1))];
    Bracket::new(frames, &ReferenceChoice::Number(2)).expect("a bracket")
}

#[test]
fn bracket_in_memory_is_merged_without_opening_a_file() {
    // The threads are started first, because they open files about the processor when they start.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("threads");
    let limit = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: Some(0), ..limit }).expect("a limit");
    assert!(std::fs::File::open("Cargo.toml").is_err(), "files can still be opened");
    let (merged, cancelled, refused, too_bright) = pool.install(|| {
        let merged = pipeline::merge_bracket(bracket(), &Options::default(), &pipeline::unwatched);
        let cancel = |progress| match progress {
            Progress::Begins(Stage::Merge) => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        };
        let cancelled = pipeline::merge_bracket(bracket(), &Options::default(), &cancel);
        let with_file = Options { outputs: vec!["out.exr".into()], ..Options::default() };
        let refused = pipeline::merge_bracket(bracket(), &with_file, &pipeline::unwatched);
        let mut too_bright = Options::default();
        too_bright.write.picture.adjust.brightness = 50.0;
        (merged, cancelled, refused, pipeline::merge_bracket(bracket(), &too_bright, &pipeline::unwatched))
    });
    setrlimit(Resource::Nofile, limit).expect("the limit as it was");

    assert!(matches!(cancelled, Err(Error::Cancelled)), "{cancelled:?}");
    assert!(matches!(refused, Err(Error::Option { option: "outputs", .. })), "{refused:?}");
    assert!(matches!(too_bright, Err(Error::Option { option: "--brightness", .. })), "{too_bright:?}");
    let merged = merged.expect("a result");
    for (frame, truth) in merged.report.frames.iter().zip([[3.0, -2.0], [0.0, 0.0], [-4.0, 1.0]]) {
        // The frame shows at x what the reference shows at x + truth.
        let shift = frame.alignment.shift_px.expect("a transform");
        assert!((0..2).all(|i| (shift[i] + truth[i]).abs() < 0.1), "{}: {shift:?}", frame.path);
    }
    let display = image::RgbImage::from(merged.display.pixels);
    let map = image::Rgb32FImage::from(merged.radiance.pixels);
    assert_eq!(display.dimensions(), map.dimensions());
    // Radiance is relative, so its ratio to that of the scene is constant, except for the rounding of code values,
    // which changes the exposure by 0.2 to 4 %.
    let crop = merged.report.crop;
    let mut ratios = Vec::new();
    for y in (20..map.height() - 20).step_by(7) {
        for x in (20..map.width() - 20).step_by(7) {
            let scene = radiance(i64::from(x) + crop.x_px as i64, i64::from(y) + crop.y_px as i64);
            ratios.push(f64::from(map.get_pixel(x, y)[1]) / scene);
        }
    }
    ratios.sort_by(f64::total_cmp);
    let middle = ratios[ratios.len() / 2];
    let near = ratios.iter().filter(|r| (*r / middle - 1.0).abs() < 0.05).count();
    assert!(near * 10 > ratios.len() * 9, "{near} of {}", ratios.len());
}
