//! Properties that hold for any small bracket, any options and any radiance. The seed is fixed, so that every run tries
//! the same values.
//!
//! `PROPTEST_CASES=5000 cargo test --test library properties` tries more values.

use hdralign::align::features::RobustMethod;
use hdralign::align::{AlignMode, AlignOptions};
use hdralign::bracket::LoadOptions;
use hdralign::bracket::colour::{Primaries, Space};
use hdralign::compare;
use hdralign::merge::RadianceMap;
use hdralign::merge::deghost::Deghost;
use hdralign::merge::radiance::calibration::Calibration;
use hdralign::merge::weight::Weight;
use hdralign::pipeline::{self, Crop, Options};
use hdralign::plane::Plane;
use hdralign::read::read;
use hdralign::report::Report;
use hdralign::response::file::SavedResponse;
use hdralign::response::ratios::Exposures;
use hdralign::response::{CODES, ResponseCurve, ResponseModel};
use hdralign::tonemap::display::codes::Colours;
use hdralign::tonemap::{self, DisplayImage, Operator, Rendering};
use hdralign::write::picture::{self, Size};
use hdralign::write::{
    self, Metadata, dng, exr, hdr,
    jpeg::{self, Resolution},
    tiff,
};
use image::{DynamicImage, ImageBuffer, Rgb};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::{RngSeed, TestCaseResult, TestRunner};
use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};

/// Tests `property` with `cases` values of `strategy`, the same values in every run.
fn holds<S: Strategy>(cases: u32, strategy: S, property: impl Fn(S::Value) -> TestCaseResult) {
    let asked = std::env::var("PROPTEST_CASES").ok().and_then(|text| text.parse().ok());
    let config = ProptestConfig {
        cases: asked.unwrap_or(cases),
        rng_seed: RngSeed::Fixed(8),
        failure_persistence: None,
        max_shrink_iters: 200,
        ..ProptestConfig::default()
    };
    if let Err(error) = TestRunner::new(config).run(&strategy, property) {
        panic!("{error}");
    }
}

/// The content of the frames of a bracket.
#[derive(Debug, Clone, Copy)]
enum Content {
    /// Light that increases from one corner to the other, with spots, and moves a little from frame to frame.
    Scene,
    /// Random code values, different in each frame.
    Noise,
    /// One code value everywhere.
    Flat(u16),
    /// Alternating black and white pixels.
    Checkerboard,
}

/// A random bracket.
#[derive(Debug, Clone)]
struct Photographs {
    size: (u32, u32),
    content: Content,
    /// Exposures in EV; `None` if they are to be estimated.
    ev: Option<Vec<f64>>,
    frames: usize,
    seed: u32,
    is_deep: bool,
    is_tiff: bool,
}

fn content() -> impl Strategy<Value = Content> {
    prop_oneof![
        8 => Just(Content::Scene),
        2 => Just(Content::Noise),
        1 => select(vec![0, 1, 128 << 8, 65535]).prop_map(Content::Flat),
        1 => Just(Content::Checkerboard),
    ]
}

fn side() -> impl Strategy<Value = u32> {
    prop_oneof![1 => 1..4u32, 1 => 4..20u32, 2 => 20..=40u32]
}

fn photographs() -> impl Strategy<Value = Photographs> {
    let ev = prop_oneof![3 => -4.0..4.0f64, 1 => -40.0..40.0f64, 1 => select(vec![-40.0, 0.0, 40.0])];
    let ev = prop_oneof![4 => vec(ev, 5).prop_map(Some), 1 => Just(None)];
    ((side(), side()), content(), ev, 2..=5usize, any::<u32>(), any::<(bool, bool)>()).prop_map(
        |(size, content, ev, frames, seed, (is_deep, is_tiff))| {
            let ev = ev.map(|ev| ev[..frames].to_vec());
            Photographs { size, content, ev, frames, seed, is_deep, is_tiff }
        },
    )
}

impl Photographs {
    /// Returns a pseudo-random number in 0..1 that depends on the seed and the arguments.
    fn chance(&self, reported: [u32; 3]) -> f64 {
        let mix = |sum: u32, v: u32| (sum ^ v).wrapping_mul(0x9E37_79B1).rotate_left(13);
        f64::from(reported.into_iter().fold(self.seed, mix) >> 8) / f64::from(1 << 24)
    }

    /// Returns the code value of a pixel, 0..=65535.
    fn code(&self, frame: usize, x: u32, y: u32, channel: u32) -> u16 {
        match self.content {
            Content::Flat(code) => code,
            Content::Checkerboard => ((x + y) % 2) as u16 * 65535,
            Content::Noise => (self.chance([frame as u32, y << 8 | x, channel]) * 65535.0) as u16,
            Content::Scene => {
                let (x, y) = (x + frame as u32 % 3, y + self.seed % 2 * frame as u32);
                let blot = self.chance([7, x / 4, ((y / 4) << 2) | channel]);
                let light = f64::from(x + 2 * y + 1) / 60.0 * (0.2 + blot);
                let ev = self.ev.as_ref().map_or(1.5 * frame as f64, |ev| ev[frame]);
                ((light * ev.clamp(-6.0, 6.0).exp2() / 4.0).powf(1.0 / 2.2).min(1.0) * 65535.0) as u16
            }
        }
    }

    /// Writes the photographs into `folder` and returns their paths.
    fn write(&self, folder: &Path) -> Vec<PathBuf> {
        let (width, height) = self.size;
        let extension = if self.is_tiff { "tif" } else { "png" };
        let frame = |i: usize| {
            let deep = |x, y| Rgb([0, 1, 2].map(|c| self.code(i, x, y, c)));
            let picture = if self.is_deep {
                DynamicImage::ImageRgb16(ImageBuffer::from_fn(width, height, deep))
            } else {
                DynamicImage::ImageRgb8(ImageBuffer::from_fn(width, height, |x, y| {
                    Rgb(deep(x, y).0.map(|c| (c >> 8) as u8))
                }))
            };
            let path = folder.join(format!("f{i}.{extension}"));
            picture.save(&path).expect("a photograph");
            path
        };
        (0..self.frames).map(frame).collect()
    }
}

fn operator() -> impl Strategy<Value = Operator> {
    select(vec![
        Operator::Natural(Default::default()),
        Operator::Reinhard02(Default::default()),
        Operator::Reinhard02Local(Default::default()),
        Operator::Drago(Default::default()),
        Operator::Durand(Default::default()),
        Operator::Fattal(Default::default()),
        Operator::Mantiuk06(Default::default()),
        Operator::Mantiuk08(Default::default()),
    ])
}

fn writing() -> impl Strategy<Value = write::Options> {
    (
        select(vec![exr::Sample::Auto, exr::Sample::Half, exr::Sample::Float]),
        select(vec![exr::Compression::Piz, exr::Compression::Zip16, exr::Compression::Zip1, exr::Compression::None]),
        select(vec![hdr::Encoding::Rgbe, hdr::Encoding::Xyze]),
        select(vec![tiff::Encoding::Float, tiff::Encoding::LogLuv24, tiff::Encoding::LogLuv32]),
        select(vec![dng::Encoding::Half, dng::Encoding::Float, dng::Encoding::Integer]),
        (1..=100u8, select(vec![Resolution::Full, Resolution::Half, Resolution::None])),
    )
        .prop_map(|(sample, compression, hdr, tiff, dng, (quality, gain_map))| write::Options {
            overwrite: true,
            exr: exr::Options { sample, compression },
            hdr,
            tiff,
            dng,
            jpeg: jpeg::Options { quality, gain_map },
            picture: picture::Options::default(),
        })
}

/// Picture options that `.jpg` supports.
fn pictures() -> impl Strategy<Value = picture::Options> {
    let sizes = vec![Size::Full, Size::Longest(20), Size::Percent(37.0), Size::Percent(99.0)];
    (select(vec![Colours::Srgb, Colours::DisplayP3]), select(sizes)).prop_map(|(colours, size)| picture::Options {
        colours,
        size,
        ..picture::Options::default()
    })
}

fn options() -> impl Strategy<Value = Options> {
    let weights =
        vec![Weight::Hat, Weight::Gaussian, Weight::Plateau, Weight::Uniform, Weight::MannPicard, Weight::Noise];
    let models = vec![
        ResponseModel::default(),
        ResponseModel::Robertson(Default::default()),
        ResponseModel::MitsunagaNayar(Default::default()),
        ResponseModel::Linear,
        ResponseModel::Srgb,
    ];
    let spaces = vec![None, Some(Space::Srgb), Some(Space::Rec2020), Some(Space::Acescg)];
    let rendering =
        prop_oneof![6 => operator().prop_map(Rendering::Toned), 1 => Just(Rendering::Fused(Default::default()))];
    let factor = prop_oneof![3 => Just(None), 1 => (-30..=30i32).prop_map(|e| Some(10f64.powi(e)))];
    let robust = select(vec![RobustMethod::Ransac, RobustMethod::Lmeds]);
    let none = AlignMode::None;
    let modes =
        vec![AlignMode::Auto, AlignMode::Auto, AlignMode::Mtb, AlignMode::Sift, AlignMode::Surf, none, none, none];
    (
        (select(modes), robust, select(models), select(weights), select(spaces)),
        (rendering, factor, prop::option::of(0.0..=1.0f64), any::<[bool; 3]>(), (writing(), pictures())),
    )
        .prop_map(
            |((mode, robust, response, weight, colour), (rendering, factor, strength, switches, writing))| {
                let (write, picture) = writing;
                Options {
                    align: AlignOptions { mode, robust, ..AlignOptions::default() },
                    exposures: if switches[0] { Exposures::FineTuned } else { Exposures::AsGiven },
                    response,
                    weight: Some(weight),
                    deghost: strength.map_or(Deghost::Off, Deghost::Strength),
                    flare: switches[1],
                    crop: if switches[2] { Crop::Common } else { Crop::None },
                    colour,
                    calibration: Calibration { camera: false, factor },
                    rendering,
                    write: write::Options { picture, ..write },
                    ..Options::default()
                }
            },
        )
}

/// Checks that values in the report are in their ranges.
fn sound(report: &Report) -> TestCaseResult {
    let json: serde_json::Value =
        serde_json::from_str(&report.to_json()).map_err(|e| TestCaseError::fail(e.to_string()))?;
    prop_assert_eq!(json["frames"].as_array().map(Vec::len), Some(report.frames.len()));
    for frame in &report.frames {
        let place = &frame.alignment;
        prop_assert!((0.0..=1.0).contains(&place.confidence), "confidence {}", place.confidence);
        prop_assert!(place.homography.is_none_or(|h| h.iter().all(|v| v.is_finite())), "{:?}", place.homography);
        prop_assert!(place.error_px.is_none_or(|e| e.is_finite() && e >= 0.0), "{:?}", place.error_px);
    }
    Ok(())
}

/// Checks that a higher code value means more light.
fn rises(curve: &ResponseCurve) -> TestCaseResult {
    for c in 0..3 {
        let (g, x) = (curve.ln_exposure(c), curve.exposures(c));
        prop_assert!(g.iter().all(|v| v.is_finite()) && g.windows(2).all(|w| w[0] < w[1]), "{g:?}");
        prop_assert!(x.iter().all(|v| v.is_finite() && *v > 0.0) && x.windows(2).all(|w| w[0] <= w[1]), "{x:?}");
    }
    Ok(())
}

/// Returns the bytes of all results, and the report without times.
fn results(folder: &Path, names: &[&str], report: &Report) -> Vec<Vec<u8>> {
    let mut json: serde_json::Value = serde_json::from_str(&report.to_json()).expect("JSON");
    json["time_s"].take();
    let mut all: Vec<Vec<u8>> = names.iter().map(|name| fs::read(folder.join(name)).expect("a result")).collect();
    all.push(json.to_string().into_bytes());
    all
}

#[test]
fn any_bracket_gives_finite_radiance_or_a_message_and_the_same_bytes_twice() {
    let (merged, refused) = (Cell::new(0), Cell::new(0));
    holds(110, (photographs(), options()), |(photographs, options)| {
        let dir = tempfile::tempdir().expect("a folder");
        let names = ["a.exr", "a.hdr", "a.tif", "a.dng", "a.png", "a.jpg", "curve.json"];
        let options = Options {
            load: LoadOptions { ev: photographs.ev.clone(), ..LoadOptions::default() },
            outputs: names[..6].iter().map(|name| dir.path().join(name)).collect(),
            save_response: Some(dir.path().join("curve.json")),
            ..options
        };
        let images = photographs.write(dir.path());
        let run = |threads| {
            pipeline::develop(&images, &Options { threads: Some(threads), ..options.clone() }, &pipeline::unwatched)
        };
        let one = match run(1) {
            Ok(outcome) => outcome,
            Err(error) => {
                refused.set(refused.get() + 1);
                prop_assert!(error.to_string().len() > 20, "{error}");
                prop_assert!(names.iter().all(|name| !dir.path().join(name).exists()), "left after {error}");
                prop_assert_eq!(run(3).err().map(|e| e.to_string()), Some(error.to_string()));
                return Ok(());
            }
        };
        merged.set(merged.get() + 1);
        let values = one.radiance.pixels.as_slice().as_flattened();
        prop_assert!(values.iter().all(|v| v.is_finite() && *v >= 0.0), "radiance");
        sound(&one.report)?;
        rises(&SavedResponse::read(&dir.path().join("curve.json")).expect("a curve").curve)?;
        for name in ["a.exr", "a.hdr", "a.tif"] {
            let (map, _) = read(&dir.path().join(name)).expect("a radiance map");
            prop_assert!(map.pixels.as_slice().as_flattened().iter().all(|v| v.is_finite()), "{}", name);
        }
        let first = results(dir.path(), &names, &one.report);
        let three = run(3).expect("it went well before");
        prop_assert!(first == results(dir.path(), &names, &three.report), "other bytes on three threads");
        prop_assert!(one.radiance == three.radiance && one.display == three.display);
        Ok(())
    });
    let (merged, refused) = (merged.get(), refused.get());
    assert!(4 * merged > refused, "{merged} merged, {refused} refused: this shows little");
}

/// Any radiance value: over sixty decades, black, and the extremes of `f32` and of half floats.
fn light() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => (-30.0..30.0f32).prop_map(|e| 10f32.powf(e)),
        4 => 0.0..2.0f32,
        1 => Just(0.0f32),
        1 => select(vec![f32::MIN_POSITIVE, 1e-45, f32::MAX, 65504.0, 65505.0, 1.7e38]),
    ]
}

/// A radiance map of such values (see [`light`]), or with one such pixel everywhere.
fn radiance() -> impl Strategy<Value = RadianceMap> {
    let pixel = || [light(), light(), light()];
    (side(), side(), any::<bool>()).prop_flat_map(move |(width, height, is_flat)| {
        let count = if is_flat { 1 } else { (width * height) as usize };
        vec(pixel(), count).prop_map(move |pixels| {
            let all = pixels.into_iter().cycle().take((width * height) as usize).collect();
            RadianceMap { pixels: Plane::from_vec(width as usize, height as usize, all), primaries: Primaries::SRGB }
        })
    })
}

/// Writes `map` to the file `name`. Returns the map that is read from the file, and the number of warnings of the
/// writer.
fn there_and_back(folder: &Path, name: &str, map: &RadianceMap, options: &write::Options) -> (RadianceMap, usize) {
    let path = folder.join(name);
    let display = DisplayImage { pixels: Plane::filled(map.pixels.width(), map.pixels.height(), [0; 3]) };
    let written = write::write(std::slice::from_ref(&path), map, &display, &Metadata::default(), options);
    let written = written.expect("written");
    let warnings = written.iter().map(|w| w.warnings.len()).sum();
    write::commit(written.into_iter().map(|w| w.file).collect(), true).expect("named");
    (read(&path).expect("what was written").0, warnings)
}

/// Largest value of RGBE: 255 of 256 parts of 2^127.
const MOST_RGBE: f32 = 255.0 / 256.0 * f32::from_bits((127 + 127) << 23);

#[test]
fn files_are_read_back_within_the_precision_of_their_format() {
    holds(150, (radiance(), writing()), |(map, options)| {
        let dir = tempfile::tempdir().expect("a folder");
        let floats = write::Options {
            exr: exr::Options { sample: exr::Sample::Float, ..options.exr.clone() },
            tiff: tiff::Encoding::Float,
            ..options.clone()
        };
        for name in ["a.exr", "a.tif"] {
            let (back, warnings) = there_and_back(dir.path(), name, &map, &floats);
            prop_assert!(back.pixels == map.pixels && warnings == 0, "{name}");
        }

        let halves =
            write::Options { exr: exr::Options { sample: exr::Sample::Half, ..options.exr.clone() }, ..options };
        let (back, warnings) = there_and_back(dir.path(), "h.exr", &map, &halves);
        let mut over = false;
        for (v, half) in map.pixels.as_slice().as_flattened().iter().zip(back.pixels.as_slice().as_flattened()) {
            over |= *v > 65504.0;
            // The error is at most half of the last of 11 bits, v / 2048. Below 2^-14 it is at most 2^-24 = 6e-8,
            // because values other than 0 are never rounded to 0.
            let off = (v.min(65504.0) - half).abs();
            prop_assert!(off <= v * (1.0 / 2048.0) || off <= 6e-8, "{v} as {half}");
            prop_assert_eq!(*half == 0.0, *v == 0.0);
        }
        prop_assert_eq!(warnings, usize::from(over));

        let rgbe = write::Options { hdr: hdr::Encoding::Rgbe, ..halves.clone() };
        let (back, warnings) = there_and_back(dir.path(), "a.hdr", &map, &rgbe);
        let mut over = false;
        for (pixel, stored) in map.pixels.as_slice().iter().zip(back.pixels.as_slice()) {
            let most = pixel.iter().copied().fold(0.0, f32::max);
            over |= most > MOST_RGBE;
            for (v, stored) in pixel.iter().zip(stored) {
                // The mantissa of the largest component has 8 bits, of which the first is set, so a step is at most
                // 1/128 of this component. A stored value is the middle of a step, so the error is at most 1/256 of it.
                let off = (v.min(MOST_RGBE) - stored).abs();
                prop_assert!(off <= most * (1.0 / 255.0) || most < 1e-37, "{pixel:?} as {stored}");
            }
        }
        prop_assert_eq!(warnings, usize::from(over));

        for (name, options) in [
            ("l24.tif", write::Options { tiff: tiff::Encoding::LogLuv24, ..halves.clone() }),
            ("l32.tif", write::Options { tiff: tiff::Encoding::LogLuv32, ..halves.clone() }),
            ("x.hdr", write::Options { hdr: hdr::Encoding::Xyze, ..halves.clone() }),
        ] {
            let (back, _) = there_and_back(dir.path(), name, &map, &options);
            prop_assert!(back.pixels.as_slice().as_flattened().iter().all(|v| v.is_finite()), "{}", name);
        }
        Ok(())
    });
}

#[test]
fn any_radiance_gives_a_picture_the_same_on_any_number_of_threads() {
    let pools = [1, 3].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads"));
    holds(200, (radiance(), operator()), |(map, operator)| {
        let size = (map.pixels.width(), map.pixels.height());
        // As in `tonemap`: zeros become the floor.
        let (map, _) = hdralign::read::repair(map);
        let [one, three] = [0, 1].map(|i| pools[i].install(|| tonemap::tonemap(&map, None, &operator)));
        prop_assert_eq!((one.pixels.width(), one.pixels.height()), size);
        prop_assert!(one == three, "{} differs by threads", operator.name());
        let first = map.pixels.at(0, 0);
        if map.pixels.as_slice().iter().all(|p| *p == first) {
            let codes = one.pixels.as_slice();
            prop_assert!(codes.iter().all(|c| *c == codes[0]), "{}: one light, many codes", operator.name());
        }
        Ok(())
    });
}

#[test]
fn file_compared_with_itself_is_equal() {
    holds(40, (radiance(), writing()), |(map, options)| {
        let dir = tempfile::tempdir().expect("a folder");
        for name in ["a.exr", "a.hdr", "a.tif"] {
            there_and_back(dir.path(), name, &map, &options);
            let path = dir.path().join(name);
            let compared = compare::files(&path, &path, &compare::Options::default()).expect("comparable");
            prop_assert!(compared.is_same() && compared.bytes_equal, "{}: {}", name, compared.reason);
            let json: serde_json::Value = serde_json::from_str(&compared.to_json()).expect("JSON");
            prop_assert_eq!(&json["verdict"], "same");
            // A copy of the file under another name is also the same.
            let copy = dir.path().join(format!("copy-{name}"));
            fs::copy(&path, &copy).expect("a copy");
            let compared = compare::files(&path, &copy, &compare::Options::default()).expect("comparable");
            prop_assert!(compared.is_same(), "{}: {}", name, compared.reason);
        }
        Ok(())
    });
}

/// Curves in a response file: increasing, constant and invalid ones.
fn responses() -> impl Strategy<Value = [Vec<f64>; 3]> {
    let step = prop_oneof![
        6 => 0.0..0.1f64,
        1 => Just(0.0),
        1 => Just(1e-13),
        1 => -0.001..0.3f64,
    ];
    let rising = (vec(step, CODES), -40.0..20.0f64).prop_map(|(steps, from)| {
        let mut at = from;
        steps
            .into_iter()
            .map(|step| {
                at += step;
                at
            })
            .collect::<Vec<f64>>()
    });
    let sound = (vec(1e-13..0.1f64, CODES), -40.0..20.0f64).prop_map(|(steps, from)| {
        let mut at = from;
        steps
            .into_iter()
            .map(|step| {
                at += step;
                at
            })
            .collect::<Vec<f64>>()
    });
    let channel = prop_oneof![1 => rising, 12 => sound, 1 => vec(-1e3..1e3f64, CODES), 1 => Just(vec![0.5; CODES])];
    [channel.clone().boxed(), channel.clone().boxed(), channel.boxed()]
}

#[test]
fn a_response_that_is_read_rises_or_is_refused() {
    let (used, refused) = (Cell::new(0), Cell::new(0));
    holds(300, responses(), |channels| {
        let dir = tempfile::tempdir().expect("a folder");
        let json = serde_json::json!({
            "schema": "hdralign-response/1",
            "ln_exposure": { "red": channels[0], "green": channels[1], "blue": channels[2] },
        });
        let mut csv = String::from("# rows: 256\n# columns: 7\n");
        for z in 0..CODES {
            let [r, g, b] = [0, 1, 2].map(|c| channels[c][z].exp());
            csv += &format!("{z} 0 {r} 0 {g} 0 {b}\n");
        }
        let rsp: Vec<String> =
            channels.iter().map(|c| format!("3 {} {} {} {}", c[1], c[2] - c[1], c[3] - c[0], c[0])).collect();
        for (name, text) in [("c.json", json.to_string()), ("c.csv", csv), ("c.rsp", rsp.join("\n"))] {
            let path = dir.path().join(name);
            fs::write(&path, text).expect("a file");
            match SavedResponse::read(&path) {
                Ok(saved) => {
                    used.set(used.get() + 1);
                    rises(&saved.curve)?;
                }
                Err(error) => {
                    refused.set(refused.get() + 1);
                    prop_assert!(error.to_string().contains(name), "{error}");
                }
            }
        }
        Ok(())
    });
    let (used, refused) = (used.get(), refused.get());
    assert!(4 * used > refused && 4 * refused > used, "{used} used, {refused} refused");
}

/// With a response curve in any unit, however steep, and with every weighting function, the radiance is finite.
#[test]
fn any_curve_and_any_exposures_give_finite_radiance() {
    let weights = select(vec![Weight::Hat, Weight::Gaussian, Weight::MannPicard, Weight::Noise, Weight::Uniform]);
    let merged = Cell::new(0);
    holds(80, (photographs(), responses(), weights), |(photographs, channels, weight)| {
        let dir = tempfile::tempdir().expect("a folder");
        let g: Option<Vec<[f64; CODES]>> = channels.iter().map(|c| c.clone().try_into().ok()).collect();
        let Some(curve) = g.and_then(|g| ResponseCurve::new([g[0], g[1], g[2]])) else { return Ok(()) };
        let path = dir.path().join("c.json");
        fs::write(&path, SavedResponse { make: None, model: None, curve }.to_json()).expect("a curve");
        let options = Options {
            load: LoadOptions { ev: photographs.ev.clone(), ..LoadOptions::default() },
            align: AlignOptions { mode: AlignMode::None, ..AlignOptions::default() },
            response_file: Some(path),
            weight: Some(weight),
            ..Options::default()
        };
        if let Ok(outcome) = pipeline::develop(&photographs.write(dir.path()), &options, &pipeline::unwatched) {
            merged.set(merged.get() + 1);
            let values = outcome.radiance.pixels.as_slice().as_flattened();
            prop_assert!(values.iter().all(|v| v.is_finite() && *v > 0.0), "{values:?}");
            sound(&outcome.report)?;
        }
        Ok(())
    });
    assert!(merged.get() > 0, "{} merged", merged.get());
}
