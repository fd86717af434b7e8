//! The whole pipeline on tiny brackets.
//!
//! In: 2 to 5 photographs of 1 to 24 pixels per side, with any content and exposure, 8 or 16 bits, and any options.
//! Checked: no panic; an error about the bracket or the options, never about files or the machine; otherwise
//! positive, finite radiance, confidences in 0..=1, a report that is JSON, and outputs that can be read; for some
//! inputs the same bytes on sixteen threads, in another order, and with very little memory.
#![no_main]

use arbitrary::{Arbitrary, Unstructured};
use hdralign::align::{AlignMode, AlignOptions, RobustMethod};
use hdralign::bracket::colour::Space;
use hdralign::bracket::{LoadOptions, ReferenceChoice};
use hdralign::error::Error;
use hdralign::merge::radiance::calibration::Calibration;
use hdralign::merge::deghost::Deghost;
use hdralign::merge::weight::Weight;
use hdralign::pipeline::{self, Crop, Options};
use hdralign::response::ratios::Exposures;
use hdralign::response::{ResponseModel, debevec, mitsunaga_nayar, robertson};
use hdralign::scratch::MemoryLimit;
use hdralign::tonemap::settings::Place;
use hdralign::tonemap::{Operator, Rendering};
use hdralign::write::{exr, hdr, jpeg, tiff};
use hdralign::{read, tonemap};
use hdralign_fuzz::{folder, held, set_up};
use image::{DynamicImage, ImageBuffer, Rgb};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;

fuzz_target!(init: set_up(), |case: Case| held(|| line(&case)));

/// The content of the first photograph. The others show it moved and with another exposure, except for
/// [`Noise`](Content::Noise).
#[derive(Debug, Clone, Copy, Arbitrary)]
enum Content {
    /// The bytes of the input.
    Bytes,
    /// Different noise in each frame.
    Noise,
    Flat(u16),
    Gradient { x: i8, y: i8 },
    Checkerboard { side: u8 },
    /// Pseudo-random blobs.
    Blobs(u16),
}

/// Differences between a frame and the first frame.
#[derive(Debug, Clone, Copy, Arbitrary)]
struct Departure {
    shift: (i8, i8),
    quarter_turn: bool,
    mirrored: bool,
    noise: u8,
    dead_row: Option<u8>,
    hot_pixel: Option<(u8, u8)>,
}

#[derive(Debug)]
struct Case {
    width: u32,
    height: u32,
    deep: bool,
    /// Whether the first frame has another bit depth than the others.
    mixed: bool,
    content: Content,
    departures: Vec<Departure>,
    /// Exposures in EV that are given for the frames.
    ev: Vec<f64>,
    /// Exposures in EV of the pixels of the frames, which may contradict `ev`.
    gains: Vec<f64>,
    bytes: Vec<u8>,
    options: Options,
    again: bool,
}

/// Returns exposures in EV: in even steps as by cameras, or any numbers, or impossible ones.
fn exposures(u: &mut Unstructured, count: usize) -> arbitrary::Result<Vec<f64>> {
    let kind = u.int_in_range(0..=7)?;
    (0..count)
        .map(|i| {
            Ok(match kind {
                0..=3 => f64::from(u.int_in_range(1..=4u8)?) * i as f64 - 3.0,
                4 => 0.0,
                5 => f64::from(i8::arbitrary(u)?) / 3.0,
                6 => *u.choose(&[-40.0, 40.0, 0.0, -20.0, 20.0, 1e-9, 39.999])?,
                _ => f64::arbitrary(u)?,
            })
        })
        .collect()
}

fn rendering(u: &mut Unstructured) -> arbitrary::Result<Rendering> {
    let toned = |operator| Rendering::Toned(operator);
    let mut rendering = match u.int_in_range(0..=8)? {
        0 => toned(Operator::Reinhard02(Default::default())),
        1 => toned(Operator::Reinhard02Local(Default::default())),
        2 => toned(Operator::Drago(Default::default())),
        3 => toned(Operator::Durand(Default::default())),
        4 => toned(Operator::Fattal(Default::default())),
        5 => toned(Operator::Mantiuk06(Default::default())),
        6 => toned(Operator::Mantiuk08(Default::default())),
        7 => Rendering::Fused(tonemap::fusion::Options::default()),
        _ => Rendering::default(),
    };
    if bool::arbitrary(u)? {
        for setting in rendering.settings() {
            let (least, most) = setting.range;
            let value = least + (most - least) * f64::from(u8::arbitrary(u)?) / 255.0;
            match setting.place {
                Place::Number(place) => *place = value,
                Place::Estimated(place) => *place = Some(value),
            }
        }
    }
    Ok(rendering)
}

fn options(u: &mut Unstructured, frames: usize) -> arbitrary::Result<Options> {
    let mut options = Options {
        align: AlignOptions {
            mode: *u.choose(&[AlignMode::Auto, AlignMode::Mtb, AlignMode::Sift, AlignMode::None, AlignMode::None])?,
            robust: *u.choose(&[RobustMethod::Ransac, RobustMethod::Lmeds])?,
            ..AlignOptions::default()
        },
        exposures: *u.choose(&[Exposures::FineTuned, Exposures::AsGiven])?,
        response: match u.int_in_range(0..=4)? {
            0 => ResponseModel::Robertson(robertson::Options::default()),
            1 => ResponseModel::MitsunagaNayar(mitsunaga_nayar::Options::default()),
            2 => ResponseModel::Linear,
            3 => ResponseModel::Srgb,
            _ => ResponseModel::Debevec(debevec::Options::default()),
        },
        weight: *u.choose(&[
            Weight::Hat,
            Weight::Gaussian,
            Weight::Plateau,
            Weight::Uniform,
            Weight::MannPicard,
            Weight::Noise,
        ])?,
        deghost: match u.int_in_range(0..=2u8)? {
            0 => Deghost::Strength(f64::from(u8::arbitrary(u)?) / 255.0),
            1 => Deghost::Auto,
            _ => Deghost::Off,
        },
        // The flare correction computes transforms of a fixed size, which take seconds here for any picture.
            flare: u.ratio(1, 100)?,
        crop: *u.choose(&[Crop::Common, Crop::None])?,
        colour: *u.choose(&[None, None, Some(Space::Rec2020), Some(Space::Acescg), Some(Space::Prophoto)])?,
        rendering: rendering(u)?,
        ..Options::default()
    };
    match u.int_in_range(0..=7u8)? {
        0 => options.calibration = Calibration { camera: false, factor: Some(f64::arbitrary(u)?) },
        1 => options.unit_exposure = Some(f64::arbitrary(u)?),
        2 => options.unit_exposure = Some((f64::from(i8::arbitrary(u)?) / 4.0).exp2()),
        3 => options.calibration.factor = Some((f64::from(i8::arbitrary(u)?) / 2.0).exp2()),
        _ => {}
    }
    options.load.reference = match u.int_in_range(0..=3u8)? {
        0 => ReferenceChoice::Number(u.int_in_range(1..=frames)?),
        _ => ReferenceChoice::Auto,
    };
    options.write.overwrite = true;
    options.write.exr.sample = *u.choose(&[exr::Sample::Auto, exr::Sample::Half, exr::Sample::Float])?;
    options.write.exr.compression = *u.choose(&[
        exr::Compression::Piz,
        exr::Compression::Zip16,
        exr::Compression::Zip1,
        exr::Compression::None,
    ])?;
    options.write.hdr = *u.choose(&[hdr::Encoding::Rgbe, hdr::Encoding::Xyze])?;
    options.write.tiff = *u.choose(&[tiff::Encoding::Float, tiff::Encoding::LogLuv24, tiff::Encoding::LogLuv32])?;
    options.write.jpeg.gain_map = *u.choose(&[jpeg::Resolution::Full, jpeg::Resolution::Half])?;
    let formats = u8::arbitrary(u)?;
    let names = ["o.exr", "o.hdr", "o.tif", "o.jpg", "o.png"].iter().enumerate();
    options.outputs = names.filter(|(i, _)| formats >> i & 1 == 1).map(|(_, name)| folder().join(name)).collect();
    Ok(options)
}

impl<'a> Arbitrary<'a> for Case {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        let frames = u.int_in_range(2..=5)?;
        let (width, height) = (u.int_in_range(1..=24)?, u.int_in_range(1..=24)?);
        let departures = (0..frames).map(|_| Departure::arbitrary(u)).collect::<arbitrary::Result<_>>()?;
        Ok(Case {
            width,
            height,
            deep: u.ratio(1, 3)?,
            mixed: u.ratio(1, 16)?,
            content: Content::arbitrary(u)?,
            departures,
            ev: exposures(u, frames)?,
            gains: exposures(u, frames)?,
            options: {
                let mut options = options(u, frames)?;
                // Without given exposures they are estimated from the pixels.
                let is_given = u.ratio(7, 8)?;
                options.load.ev = is_given.then(Vec::new);
                options
            },
            again: u.ratio(1, 16)?,
            bytes: u.bytes(u.len())?.to_vec(),
        })
    }
}

/// Returns a pseudo-random number from 0 to 65535 that depends only on `i`.
fn drawn(i: u64) -> u16 {
    let mut z = i.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (z >> 40) as u16
}

impl Case {
    /// Returns the light of the scene at a position, 0..=65535.
    fn scene(&self, frame: usize, x: i64, y: i64, c: usize) -> u16 {
        let place = ((y * 64 + x) * 3 + c as i64) as u64;
        match self.content {
            Content::Bytes if self.bytes.is_empty() => 0,
            Content::Bytes => u16::from(self.bytes[place as usize % self.bytes.len()]) * 257,
            Content::Noise => drawn(place.wrapping_add((frame as u64) << 32)),
            Content::Flat(level) => level,
            Content::Gradient { x: a, y: b } => (i64::from(a) * x * 64 + i64::from(b) * y * 64 + 20_000).clamp(0, 65_535) as u16,
            Content::Checkerboard { side } => {
                let side = i64::from(side % 8) + 1;
                if (x.div_euclid(side) + y.div_euclid(side)) % 2 == 0 { 60_000 } else { 3_000 }
            }
            Content::Blobs(seed) => {
                let cell = (y.div_euclid(4) * 64 + x.div_euclid(4)) as u64;
                drawn(cell.wrapping_add(u64::from(seed) << 20)) / 2 + 500 * (x.rem_euclid(4) + y.rem_euclid(4)) as u16
            }
        }
    }

    /// Returns the code value of frame `i` at a pixel and channel, 0..=65535.
    fn code(&self, i: usize, x: u32, y: u32, c: usize) -> u16 {
        let departure = self.departures[i];
        if departure.dead_row == Some(y as u8) {
            return 0;
        }
        if departure.hot_pixel == Some((x as u8, y as u8)) {
            return 65_535;
        }
        let (mut sx, mut sy) = (i64::from(x) + i64::from(departure.shift.0 / 16), i64::from(y) + i64::from(departure.shift.1 / 16));
        if departure.quarter_turn {
            (sx, sy) = (sy, sx);
        }
        if departure.mirrored {
            sx = i64::from(self.width) - 1 - sx;
        }
        let light = f64::from(self.scene(i, sx, sy, c)) * self.gains[i].clamp(-40.0, 40.0).exp2();
        let noise = f64::from(departure.noise) * (f64::from(drawn((u64::from(y) << 32) + u64::from(x) + i as u64)) / 32_768.0 - 1.0);
        // The cast keeps NaN and values out of range within the type.
        (light.sqrt() * 256.0 + 16.0 * noise) as u16
    }

    /// Writes the photographs to files and returns their paths.
    fn frames(&self) -> Vec<PathBuf> {
        (0..self.departures.len())
            .map(|i| {
                let is_deep = self.deep != (self.mixed && i == 0);
                let picture = ImageBuffer::from_fn(self.width, self.height, |x, y| Rgb([0, 1, 2].map(|c| self.code(i, x, y, c))));
                let picture = DynamicImage::ImageRgb16(picture);
                let picture = if is_deep { picture } else { DynamicImage::ImageRgb8(picture.to_rgb8()) };
                let path = folder().join(format!("f{i}.png"));
                picture.save(&path).expect("room for a small file");
                path
            })
            .collect()
    }
}

fn line(case: &Case) {
    let frames = case.frames();
    let mut options = case.options.clone();
    options.load.ev = options.load.ev.map(|_| case.ev.clone());
    options.report = Some(folder().join("o.json"));
    let outcome = match pipeline::develop(&frames, &options, &pipeline::unwatched) {
        Ok(outcome) => outcome,
        Err(e) => {
            let is_ours = matches!(
                e,
                Error::NoExposure { .. }
                    | Error::NothingAligned { .. }
                    | Error::NoOverlap { .. }
                    | Error::Option { .. }
                    | Error::NoResponse { .. }
            );
            assert!(is_ours && !e.to_string().is_empty(), "{e}");
            return;
        }
    };
    let pixels = &outcome.radiance.pixels;
    let (width, height) = (pixels.width(), pixels.height());
    assert!(width > 0 && height > 0 && width <= case.width as usize && height <= case.height as usize);
    assert!(pixels.as_slice().as_flattened().iter().all(|v| v.is_finite() && *v > 0.0), "radiance");
    assert_eq!((outcome.display.pixels.width(), outcome.display.pixels.height()), (width, height));
    for frame in &outcome.report.frames {
        let place = &frame.alignment;
        assert!((0.0..=1.0).contains(&place.confidence), "confidence {}", place.confidence);
        assert!(place.homography.is_none_or(|h| h.iter().all(|v| v.is_finite())), "{:?}", place.homography);
    }
    let report = std::fs::read(folder().join("o.json")).expect("a report");
    assert!(serde_json::from_slice::<serde_json::Value>(&report).is_ok());
    for output in &options.outputs {
        let name = output.extension().and_then(|e| e.to_str()).unwrap_or_default();
        let size = if matches!(name, "png" | "jpg") {
            let picture = image::open(output).unwrap_or_else(|e| panic!("{name}: {e}"));
            (picture.width() as usize, picture.height() as usize)
        } else {
            let (map, _) = read::read(output).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(map.pixels.as_slice().as_flattened().iter().all(|v| v.is_finite()), "{name}");
            (map.pixels.width(), map.pixels.height())
        };
        assert_eq!(size, (width, height), "{name}");
    }
    if case.again {
        let bytes = |path: &PathBuf| std::fs::read(path).expect("an output");
        let first: Vec<_> = options.outputs.iter().map(bytes).collect();
        check_again(case, frames, options, &outcome);
        let second: Vec<_> = case.options.outputs.iter().map(bytes).collect();
        assert!(first == second, "other bytes");
    }
}

/// Runs the same bracket in another order, on sixteen threads, with little memory, and compares the results with
/// `first`.
fn check_again(case: &Case, mut frames: Vec<PathBuf>, mut options: Options, first: &pipeline::Outcome) {
    let count = frames.len();
    frames.reverse();
    if let Some(ev) = &mut options.load.ev {
        ev.reverse();
    }
    if let ReferenceChoice::Number(n) = &mut options.load.reference {
        *n = count + 1 - *n;
    }
    // Sixteen threads leave no memory for the frames, so these are moved to disk.
    options.threads = Some(16);
    options.load = LoadOptions {
        memory: Some(MemoryLimit { bytes: MemoryLimit::PROGRAM + (40 << 20), folder: folder().to_owned() }),
        ..options.load
    };
    let second = pipeline::develop(&frames, &options, &pipeline::unwatched);
    let second = second.unwrap_or_else(|e| panic!("it went well before: {e}"));
    assert!(second.radiance == first.radiance, "other radiance of {case:?}");
    assert!(second.display == first.display, "another picture of {case:?}");
}
