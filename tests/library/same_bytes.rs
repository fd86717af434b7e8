//! The same photographs give the same bytes on any number of threads, in any order and with any instruction set.

use crate::support::{FRAMES, Folder, jpeg, shrink, window};
use hdralign::bracket::colour::Space;
use hdralign::merge::deghost::Deghost;
use hdralign::merge::radiance::calibration::Calibration;
use hdralign::merge::weight::Weight;
use hdralign::pipeline::{self, Options};
use hdralign::simd::{self, Arm};
use hdralign::tonemap::adjust::{self, WhiteBalance};
use hdralign::tonemap::display::codes::{Colours, Depth};
use hdralign::write::picture::{self, Size};
use hdralign::write::{
    self, dng, exr, hdr,
    jpeg::{self, Resolution},
    tiff,
};
use serde_json::Value;
use std::fs;
use std::path::PathBuf;

/// The output files that are compared, and the response.
const OUTPUTS: [&str; 5] = ["a.exr", "a.hdr", "a.tif", "a.png", "response.json"];

/// Creates a folder with the bracket at half size (600 x 400 pixels: seven bands of rows, the last one short), so that
/// each run takes about a second.
fn folder() -> Folder {
    let folder = Folder::empty();
    for i in 1..=FRAMES {
        let picture = image::open(window(i)).expect("a frame of testdata/window").to_rgb8();
        folder.put(&format!("w{i}.jpg"), &jpeg(&shrink(&picture, 2), Some(i)));
    }
    folder
}

/// Returns the bytes of all outputs, and the report without times.
fn results(folder: &Folder, order: [usize; FRAMES], options: &str) -> (Vec<Vec<u8>>, Value) {
    let images = order.map(|i| format!("w{i}.jpg")).join(" ");
    let outputs = "-o a.exr -o a.hdr -o a.tif -o a.png -o a.jpg --save-response response.json";
    folder.line(&format!("merge {images} {outputs} --report r.json --force {options}")).done();
    let bytes = OUTPUTS.map(|name| folder.bytes(name)).to_vec();
    assert!(bytes.iter().all(|b| b.len() > 1000));
    let mut report: Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    report["time_s"].take();
    OUTPUTS.iter().chain(["r.json"].iter()).for_each(|name| fs::remove_file(folder.at(name)).expect("written again"));
    (bytes, report)
}

fn assert_same(what: &str, (bytes, report): &(Vec<Vec<u8>>, Value), (others, other): &(Vec<Vec<u8>>, Value)) {
    for (name, (a, b)) in OUTPUTS.iter().zip(bytes.iter().zip(others)) {
        let first = a.iter().zip(b).position(|(a, b)| a != b);
        assert!(a == b, "{what}: {name} differs: {} and {} bytes, first at {first:?}", a.len(), b.len());
    }
    assert_eq!(report, other, "{what}: the report");
}

#[test]
fn neither_threads_nor_the_order_of_the_photographs_change_a_byte() {
    let folder = folder();
    let one = results(&folder, [1, 2, 3, 4, 5], "--threads 1");
    assert_eq!(one.1["frames"].as_array().map(Vec::len), Some(FRAMES));
    assert_same("2 threads", &one, &results(&folder, [1, 2, 3, 4, 5], "--threads 2"));
    assert_same("7 threads", &one, &results(&folder, [1, 2, 3, 4, 5], "--threads 7"));
    assert_same("another order", &one, &results(&folder, [4, 1, 5, 3, 2], "--threads 3"));
}

/// By default features are detected and matched only if bitmaps are not certain; with `--align sift` always.
#[test]
fn features_do_not_depend_on_threads_or_order() {
    let folder = folder();
    let one = results(&folder, [1, 2, 3, 4, 5], "--align sift --threads 1");
    let inliers = |f: &Value| f["alignment"]["inliers"].as_u64().is_some_and(|n| n > 10);
    let frames = one.1["frames"].as_array().expect("a list");
    assert!(
        frames.iter().filter(|f| inliers(f)).count() >= 3,
        "features found too little for this test to say anything"
    );
    let other = results(&folder, [5, 4, 1, 3, 2], "--align sift --threads 7");
    assert_same("7 threads in another order", &one, &other);
}

/// Tests options that are off by default: deghosting and flare, noise weights, another response model, another colour
/// space, units, encodings.
#[test]
fn results_of_options_do_not_depend_on_threads_or_order() {
    let folder = folder();
    let options = "--deghost --flare --weight noise --response-model robertson --colour acescg --absolute \
                   --hdr-encoding xyze --tiff-encoding logluv32 --exr-type float";
    let one = results(&folder, [1, 2, 3, 4, 5], &format!("{options} --threads 1"));
    assert_eq!(one.1["response"]["model"], "robertson");
    assert!(one.1["ghosts"]["frames"].as_array().is_some_and(|frames| frames.len() == FRAMES - 1));
    let other = results(&folder, [5, 4, 1, 3, 2], &format!("{options} --threads 7"));
    assert_same("7 threads in another order", &one, &other);
}

/// The memory limit is so low that all frames are on disk, and the radiance is computed in slabs of the smallest
/// height.
#[test]
fn little_memory_does_not_change_a_byte() {
    let folder = folder();
    for options in
        ["", "--deghost --flare --weight noise --colour acescg --absolute --tiff-encoding logluv24", "-C none"]
    {
        let ample = results(&folder, [1, 2, 3, 4, 5], options);
        let little = results(&folder, [1, 2, 3, 4, 5], &format!("{options} --threads 16 --max-memory 64MB"));
        assert_same(options, &ample, &little);
    }
    assert!(folder.listing().iter().all(|(name, _)| name.ends_with(".jpg")), "nothing is left behind");
}

/// Returns the files and the report for `options`, computed with the instruction set `arm`. The choice of `arm` is
/// global in the process, so only one test of this file calls the library; the others start the program.
fn on(arm: Arm, folder: &Folder, options: &Options) -> (Vec<Vec<u8>>, Value) {
    assert!(simd::choose(arm));
    let images: Vec<PathBuf> = (1..=FRAMES).map(|i| folder.at(format!("w{i}.jpg"))).collect();
    let report = pipeline::run(&images, options, &pipeline::unwatched).expect("the window merges");
    assert!(simd::choose(Arm::Native));
    let mut report: Value = serde_json::from_str(&report.to_json()).expect("JSON");
    report["time_s"].take();
    (options.outputs.iter().map(|path| fs::read(path).expect("an output")).collect(), report)
}

#[test]
fn vector_instructions_do_not_change_a_byte() {
    let folder = folder();
    let outputs = ["a.exr", "a.hdr", "a.tif", "a.dng", "a.png", "a.jpg"].map(|name| folder.at(name)).to_vec();
    let by_default =
        Options { outputs, write: write::Options { overwrite: true, ..Default::default() }, ..Options::default() };
    let asked_for = Options {
        weight: Some(Weight::Noise),
        deghost: Deghost::Auto,
        flare: true,
        colour: Some(Space::Acescg),
        calibration: Calibration { camera: true, factor: None },
        write: write::Options {
            overwrite: true,
            exr: exr::Options { sample: exr::Sample::Float, ..Default::default() },
            hdr: hdr::Encoding::Xyze,
            tiff: tiff::Encoding::LogLuv32,
            dng: dng::Encoding::Float,
            jpeg: jpeg::Options { gain_map: Resolution::Half, ..Default::default() },
            picture: picture::Options { colours: Colours::DisplayP3, size: Size::Percent(60.0), ..Default::default() },
        },
        ..by_default.clone()
    };
    let adjust = adjust::Options {
        white_balance: WhiteBalance::Auto,
        brightness: 0.7,
        contrast: -20.0,
        saturation: 40.0,
        shadows: 60.0,
        highlights: -70.0,
    };
    let fine = |size| Options {
        outputs: vec![folder.at("a.png")],
        write: write::Options {
            overwrite: true,
            picture: picture::Options { depth: Depth::Sixteen, colours: Colours::AdobeRgb, size, adjust },
            ..Default::default()
        },
        ..Options::default()
    };
    let arms: Vec<Arm> = Arm::ALL.into_iter().filter(|&arm| arm != Arm::Native && simd::choose(arm)).collect();
    assert_eq!(arms, of_processor(), "an arm that this processor has would go untested");
    println!("{} of {} arms: {arms:?}", arms.len(), Arm::ALL.len() - 1);
    for options in [by_default, asked_for, fine(Size::Full), fine(Size::Longest(100))] {
        let (native, reported) = on(Arm::Native, &folder, &options);
        for &arm in &arms {
            let (others, other) = on(arm, &folder, &options);
            for (path, (a, b)) in options.outputs.iter().zip(native.iter().zip(&others)) {
                let first = a.iter().zip(b).position(|(a, b)| a != b);
                assert!(a == b, "{arm:?}: {}: {} and {} bytes, first at {first:?}", path.display(), a.len(), b.len());
            }
            assert_eq!(reported, other, "{arm:?}: the report");
        }
    }
}

/// Returns the instruction sets of this processor according to the standard library, independently of pulp.
fn of_processor() -> Vec<Arm> {
    let mut arms = Vec::new();
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    {
        let bytes_and_words = is_x86_feature_detected!("avx512bw") && is_x86_feature_detected!("avx512dq");
        let lengths = is_x86_feature_detected!("avx512vl") && is_x86_feature_detected!("avx512cd");
        if is_x86_feature_detected!("avx512f") && bytes_and_words && lengths {
            arms.push(Arm::Avx512);
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            arms.push(Arm::Avx2);
        }
    }
    #[cfg(target_arch = "aarch64")]
    arms.push(Arm::Neon);
    arms.push(Arm::Scalar);
    arms
}
