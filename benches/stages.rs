//! Time of each stage, in elements (pixels) per second: `cargo bench --bench stages [NAME]`.
//!
//! The planes and frames are those of `testdata/window`, mirrored along both axes to about 3.8 MP.

use ::tiff::encoder::{SRational, TiffEncoder, colortype::Gray16};
use ::tiff::tags::Tag;
use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use hdralign::align::agreement::check_tiles;
use hdralign::align::bitmaps::{MtbOptions, ThresholdBitmaps};
use hdralign::align::features::sift::{SiftOptions, detect};
use hdralign::align::features::{Features, Guide, PointPair, RansacOptions, lmeds, match_mutual, ransac};
use hdralign::align::grey::Percentile;
use hdralign::align::photometric::{CommonExposure, ToneTables};
use hdralign::align::refinement::{FramePair, refine};
use hdralign::align::resampling::resample_rows;
use hdralign::align::{
    AlignOptions, Alignment, Cause, GreyPyramid, Local, Model, Motion, align, bitmaps, grey_pyramid,
};
use hdralign::bracket::{Bracket, Codes, Frame, LoadOptions, ReferenceChoice, Samples, load};
use hdralign::merge::radiance::calibration::Unit;
use hdralign::merge::radiance::flare;
use hdralign::merge::radiance::statistics::Statistics;
use hdralign::merge::weight::Weight;
use hdralign::merge::{MergeOptions, deghost, merge};
use hdralign::pipeline;
use hdralign::plane::Plane;
use hdralign::pyramid::gaussian;
use hdralign::read::read;
use hdralign::response::samples::Places;
use hdralign::response::{ResponseCurve, ResponseModel, ratios, recover_from};
use hdralign::tonemap::{Operator, tonemap};
use hdralign::write::{self, Metadata, exr, hdr, tiff};
use std::hint::black_box;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::Duration;

fn paths() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/window");
    (1..=5).map(|i| folder.join(format!("window_{i}.jpg"))).collect()
}

/// Returns the bracket in its original size, 0.96 MP.
fn small() -> Bracket {
    load(&paths(), &LoadOptions::default()).expect("testdata/window loads").0
}

/// Returns `frame` with its mirror images to the right and below: four times the pixels.
fn mirrored(frame: &Frame) -> Frame {
    let (width, height) = (frame.width(), frame.height());
    let whole = frame.whole().expect("in memory");
    let Codes::Eight(codes) = whole.codes() else { panic!("testdata/window is of 8 bit") };
    let fold = |i: usize, n: usize| if i < n { i } else { 2 * n - 1 - i };
    let mut four = Vec::with_capacity(4 * codes.len());
    for y in 0..2 * height {
        for x in 0..2 * width {
            let at = 3 * (fold(y, height) * width + fold(x, width));
            four.extend_from_slice(&codes[at..at + 3]);
        }
    }
    let mut large =
        Frame::new(frame.path().into(), 2 * width, 2 * height, Samples::Eight(four), frame.exposure.clone());
    large.profile.clone_from(&frame.profile);
    large
}

fn large() -> Bracket {
    let frames = small().frames().iter().map(mirrored).collect();
    Bracket::new(frames, &ReferenceChoice::Number(3)).expect("frames of one size")
}

fn pixels(bracket: &Bracket) -> u64 {
    (bracket.width() * bracket.height()) as u64
}

/// Returns `plane` repeated by mirroring, cropped to a size from column `left` on.
fn mirrored_to(plane: &Plane<u8>, (width, height): (usize, usize), left: usize) -> Plane<u8> {
    let fold = |i: usize, n: usize| if (i / n).is_multiple_of(2) { i % n } else { n - 1 - i % n };
    Plane::from_rows(width, height, |y, row| {
        for (x, v) in row.iter_mut().enumerate() {
            *v = plane.at(fold(x + left, plane.width()), fold(y, plane.height()));
        }
    })
}

/// Measures the bitmap search, from two grey planes to the shift; `benches/mtb_beside_opencv.py` compares it with
/// `cv2.AlignMTB`.
fn bitmaps(c: &mut Criterion) {
    let bracket = small();
    let [reference, frame] = [2, 3].map(|i| bracket.frames()[i].grey().expect("in memory"));
    let mut group = c.benchmark_group("mtb");
    for (name, size) in [("12 MP", (4096, 3072)), ("1024x768", (1024, 768))] {
        let planes = [mirrored_to(&reference, size, 0), mirrored_to(&frame, size, 23)];
        group.throughput(Throughput::Elements((size.0 * size.1) as u64));
        let pyramid = |plane: Plane<u8>| GreyPyramid::new(plane);
        let fresh = || planes.clone();
        group.bench_function(format!("grey pyramid {name}"), |b| {
            b.iter_batched(|| planes[0].clone(), pyramid, BatchSize::LargeInput);
        });
        let both = planes.clone().map(pyramid);
        group.bench_function(format!("bitmaps {name}"), |b| {
            b.iter(|| ThresholdBitmaps::of_level(black_box(&both[0]), 0, Percentile::MEDIAN, 4));
        });
        for (what, max_rotation_deg) in [("shift", 0.0), ("shift and rotation", 5.0)] {
            let options = MtbOptions { max_rotation_deg, ..MtbOptions::default() };
            let search = |planes: [Plane<u8>; 2]| {
                let [a, b] = planes.map(pyramid);
                bitmaps::search(&a, &b, 0, &options)
            };
            group.bench_function(format!("{what} {name}"), |b| b.iter_batched(fresh, search, BatchSize::LargeInput));
        }
    }
}

fn alignment(c: &mut Criterion) {
    let bracket = large();
    let [reference, frame] = [2, 3].map(|i| GreyPyramid::new(bracket.frames()[i].grey().expect("in memory")));
    let all = pixels(&bracket);
    let mut group = c.benchmark_group("align");
    group.throughput(Throughput::Elements(all));
    group.bench_function("grey pyramid of a frame", |b| b.iter(|| grey_pyramid(black_box(&bracket.frames()[3]))));
    group.bench_function("smoothed", |b| {
        let values = frame.level(0).map(f32::from);
        b.iter(|| gaussian(black_box(&values), 1.6));
    });
    let options = MtbOptions::default();
    let start = bitmaps::search(&reference, &frame, 0, &options).transform();
    for (name, model) in [("refine rigid", Model::Rigid), ("refine homography", Model::Homography)] {
        group.bench_function(name, |b| {
            b.iter(|| {
                let pair = FramePair::new(&reference, &frame, black_box(&start));
                refine(&pair, &start, model, (3, 0))
            })
        });
    }
    let h = start.matrix(bracket.width(), bracket.height());
    group.bench_function("common exposure", |b| {
        b.iter(|| {
            let tones = ToneTables::between(reference.level(0), frame.level(0), black_box(&h));
            CommonExposure::new(reference.level(0), frame.level(0), &tones)
        });
    });
    let tones = ToneTables::between(reference.level(0), frame.level(0), &h);
    let both = CommonExposure::new(reference.level(0), frame.level(0), &tones);
    group.bench_function("agreement", |b| b.iter(|| check_tiles(&both, black_box(&h))));
    let mut out = vec![[0.0f32; 3]; all as usize];
    let window = bracket.frames()[3].whole().expect("in memory");
    let motion = Motion::new(&start, (bracket.width(), bracket.height()));
    group.bench_function("resample", |b| {
        b.iter(|| {
            let (columns, rows) = (0..bracket.width(), 0..bracket.height());
            resample_rows(&window, black_box(&motion), columns, rows, &mut out);
        });
    });
    group.throughput(Throughput::Elements(5 * all));
    group.bench_function("whole bracket", |b| b.iter(|| align(black_box(&bracket), &AlignOptions::default())));
}

/// Returns `frame` at the exposure of `like`, with each pixel fetched from the place that `displaced` returns for it, by
/// bilinear interpolation.
fn retaken(frame: &Frame, like: &Frame, displaced: impl Fn(f64, f64) -> (f64, f64)) -> Frame {
    let (width, height) = (frame.width(), frame.height());
    let whole = frame.whole().expect("in memory");
    let Codes::Eight(codes) = whole.codes() else { panic!("testdata/window is of 8 bit") };
    let ratio = like.exposure.relative() / frame.exposure.relative();
    let code = |v: f64| (255.0 * (ratio * (v / 255.0).powf(2.2)).min(1.0).powf(1.0 / 2.2) + 0.5) as u8;
    let mut moved = Vec::with_capacity(codes.len());
    for i in 0..width * height {
        let (x, y) = displaced((i % width) as f64, (i / width) as f64);
        let (x, y) = (x.clamp(0.0, width as f64 - 1.001), y.clamp(0.0, height as f64 - 1.001));
        let (at, fx, fy) = (3 * (y as usize * width + x as usize), x.fract(), y.fract());
        for c in at..at + 3 {
            let across = |c: usize| f64::from(codes[c]) * (1.0 - fx) + f64::from(codes[c + 3]) * fx;
            moved.push(code(across(c) * (1.0 - fy) + across(c + 3 * width) * fy));
        }
    }
    let mut new = Frame::new(like.path().into(), width, height, Samples::Eight(moved), like.exposure.clone());
    new.profile.clone_from(&frame.profile);
    new
}

/// Measures the alignment of brackets that no homography explains: with a near object, and with rolling shutter.
fn following(c: &mut Criterion) {
    let plain = large();
    let (width, height) = (plain.width() as f64, plain.height() as f64);
    // Where the camera is at each frame. An object that moved as evenly as a camera could be one that walks.
    let camera = [(-2.0, 1.0), (1.0, -1.0), (0.0, 0.0), (-1.0, -2.0), (2.0, 0.0)];
    let bracket_of = |place: &dyn Fn((f64, f64), f64, f64) -> (f64, f64)| {
        let frames = plain.frames().iter().zip(camera);
        let reference = plain.reference();
        let frames = frames.map(|(like, at)| retaken(reference, like, |x, y| place(at, x, y))).collect();
        Bracket::new(frames, &ReferenceChoice::Number(3)).expect("frames of one size")
    };
    // The near object in the middle moves by 9 px, the rest by 2.
    let near = bracket_of(&|(i, j), x, y| {
        let (u, v) = (x + 9.0 * i - width / 2.0, y + 9.0 * j - height / 2.0);
        let parallax = if u.abs() < width / 6.0 && v.abs() < height / 5.0 { 9.0 } else { 2.0 };
        (x + parallax * i, y + parallax * j)
    });
    // The rows are displaced by a wave of up to 4 px.
    let wave = bracket_of(&|(i, _), x, y| (x + 2.0 * i * (y * 9.0 / height).sin(), y));
    let mut group = c.benchmark_group("following");
    group.throughput(Throughput::Elements(5 * pixels(&plain)));
    for (name, bracket, cause) in [("depth", &near, Cause::Depth), ("bend", &wave, Cause::Shutter)] {
        let (found, _) = align(bracket, &AlignOptions::default()).expect("the bracket is aligned");
        assert!((0..5).any(|i| found.cause(i) == Some(cause)), "{name} is not followed");
        for (what, local) in [("followed", Local::Auto), ("homographies", Local::Off)] {
            let options = AlignOptions { local, ..AlignOptions::default() };
            group.bench_function(format!("{name}, {what}"), |b| b.iter(|| align(black_box(bracket), &options)));
        }
    }
}

fn features(c: &mut Criterion) {
    // Measured at the pyramid level at which the alignment detects features.
    let bracket = small();
    let [first, second] = [2, 3].map(|i| GreyPyramid::new(bracket.frames()[i].grey().expect("in memory")));
    let options = SiftOptions::default();
    let mut group = c.benchmark_group("features");
    let level = first.level(1);
    group.throughput(Throughput::Elements((level.width() * level.height()) as u64));
    group.bench_function("sift", |b| b.iter(|| detect(black_box(level), &options)));
    // Without descriptors: only the scale space and its extrema.
    let undescribed = SiftOptions { max_keypoints: 0, ..options.clone() };
    group.bench_function("sift detect", |b| b.iter(|| detect(black_box(level), &undescribed)));
    // These are the settings that are used for bitmaps.
    let single = SiftOptions { double: false, ..options.clone() };
    group.bench_function("sift not doubled", |b| b.iter(|| detect(black_box(level), &single)));
    let sets: [Features; 2] = [detect(level, &options), detect(second.level(1), &options)];
    group.throughput(Throughput::Elements(sets[0].len() as u64));
    group.bench_function("match", |b| b.iter(|| match_mutual(black_box(&sets[0]), &sets[1], 0.8, None)));
    let place = |set: &Features, i: usize| [f64::from(set.keypoints[i].x), f64::from(set.keypoints[i].y)];
    let pairs: Vec<PointPair> = match_mutual(&sets[0], &sets[1], 0.8, None)
        .iter()
        .map(|m| (place(&sets[0], m.reference), place(&sets[1], m.frame)))
        .collect();
    let guide = ransac::search(&pairs, &RansacOptions::default()).map(|c| Guide { motion: c.homography, radius: 10.0 });
    let guide = guide.expect("the frames of testdata/window match");
    group.bench_function("match guided", |b| b.iter(|| match_mutual(black_box(&sets[0]), &sets[1], 0.8, Some(&guide))));
    group.throughput(Throughput::Elements(pairs.len() as u64));
    group.bench_function("lmeds", |b| b.iter(|| lmeds::search(black_box(&pairs), &RansacOptions::default())));
    group.bench_function("ransac", |b| b.iter(|| ransac::search(black_box(&pairs), &RansacOptions::default())));
}

fn radiance(c: &mut Criterion) {
    let bracket = large();
    let placed = Alignment::unmoved(&bracket);
    let all = pixels(&bracket);
    let mut group = c.benchmark_group("radiance");
    group.throughput(Throughput::Elements(5 * all));
    group.bench_function("places", |b| b.iter(|| Places::of(black_box(&bracket), &placed)));
    let places = Places::of(&bracket, &placed).expect("in memory");
    group.bench_function("exposures", |b| b.iter(|| ratios::corrections(black_box(&bracket), &places)));
    for (name, model) in [
        ("debevec", ResponseModel::default()),
        ("robertson", ResponseModel::Robertson(Default::default())),
        ("mitsunaga-nayar", ResponseModel::MitsunagaNayar(Default::default())),
    ] {
        group.bench_function(format!("response {name}"), |b| b.iter(|| recover_from(&[black_box(&places)], &model)));
    }
    let options = MergeOptions { weight: Weight::default(), region: placed.overlap };
    let curve = ResponseCurve::srgb();
    group.bench_function("merge", |b| b.iter(|| merge(black_box(&bracket), &placed, &curve, &options, None)));
    let by_noise = MergeOptions { weight: Weight::Noise, ..options };
    group.bench_function("merge by noise", |b| b.iter(|| merge(black_box(&bracket), &placed, &curve, &by_noise, None)));
    group.bench_function("deghost", |b| {
        b.iter(|| deghost::find(black_box(&bracket), &placed, &curve, placed.overlap, deghost::AUTO, None));
    });
    let (map, _) = merge(&bracket, &placed, &curve, &options, None).expect("a whole region");
    group.throughput(Throughput::Elements(all));
    group.bench_function("flare", |b| {
        b.iter_batched(|| map.clone(), |mut map| flare::remove(&mut map), BatchSize::LargeInput)
    });
    group.bench_function("statistics", |b| {
        b.iter(|| Statistics::measured(black_box(&map.pixels), [0.2126, 0.7152, 0.0722], Unit::Relative));
    });
    group.bench_function("tonemap", |b| b.iter(|| tonemap(black_box(&map), None, &Operator::default())));
    let picture = tonemap(&map, None, &Operator::default());
    let folder = tempfile::tempdir().expect("a temporary folder");
    let metadata = Metadata::of(bracket.reference());
    let floats = exr::Options { sample: exr::Sample::Float, ..exr::Options::default() };
    for (what, names, exr) in [
        ("exr", &["a.exr"][..], exr::Options::default()),
        ("exr floats", &["a.exr"], floats),
        ("hdr", &["a.hdr"], exr::Options::default()),
        ("tif", &["a.tif"], exr::Options::default()),
        ("png", &["a.png"], exr::Options::default()),
        ("exr and png", &["a.exr", "a.png"], exr::Options::default()),
    ] {
        let paths: Vec<PathBuf> = names.iter().map(|name| folder.path().join(name)).collect();
        let options = write::Options { exr, ..write::Options::default() };
        // The files are removed when they are dropped, so this measures encoding and writing to the system's buffers.
        group.bench_function(format!("write {what}"), |b| {
            b.iter(|| write::write(&paths, black_box(&map), &picture, &metadata, &options));
        });
    }
}

/// Returns a Bayer mosaic of `frame`, in a DNG file of a camera with the primaries of sRGB.
fn mosaic(frame: &Frame) -> Vec<u8> {
    let whole = frame.whole().expect("in memory");
    let Codes::Eight(codes) = whole.codes() else { panic!("testdata/window is of 8 bit") };
    let (width, height) = (frame.width(), frame.height());
    let sample = |i: usize| 16 * u16::from(codes[3 * i + (i % width % 2 + i / width % 2)]);
    let samples: Vec<u16> = (0..width * height).map(sample).collect();
    // From XYZ to linear sRGB (IEC 61966-2-1), in 1 / 10,000.
    let matrix = [32406, -15372, -4986, -9689, 18758, 415, 557, -2040, 10570].map(|n| SRational { n, d: 10_000 });
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).expect("a TIFF");
    let mut picture = encoder.new_image::<Gray16>(width as u32, height as u32).expect("a size");
    let tags = picture.encoder();
    tags.write_tag(Tag::PhotometricInterpretation, 32803u16).expect("a tag");
    tags.write_tag(Tag::Unknown(33421), &[2u16, 2][..]).expect("a tag");
    tags.write_tag(Tag::Unknown(33422), &[0u8, 1, 1, 2][..]).expect("a tag");
    tags.write_tag(Tag::Unknown(50706), &[1u8, 4, 0, 0][..]).expect("a tag");
    tags.write_tag(Tag::Unknown(50717), 4080u16).expect("a tag");
    tags.write_tag(Tag::Unknown(50721), &matrix[..]).expect("a tag");
    picture.write_data(&samples).expect("a TIFF");
    bytes.into_inner()
}

/// Measures decoding of photographs, and writing and reading of radiance maps in each encoding.
fn files(c: &mut Criterion) {
    let images = paths();
    let mut group = c.benchmark_group("files");
    group.throughput(Throughput::Elements(5 * pixels(&small())));
    group.bench_function("load", |b| b.iter(|| load(black_box(&images), &LoadOptions::default())));
    let bracket = large();
    let placed = Alignment::unmoved(&bracket);
    let options = MergeOptions { weight: Weight::default(), region: placed.overlap };
    let (map, _) = merge(&bracket, &placed, &ResponseCurve::srgb(), &options, None).expect("a whole region");
    let picture = tonemap(&map, None, &Operator::default());
    let folder = tempfile::tempdir().expect("a temporary folder");
    let raw: Vec<PathBuf> = (0..2).map(|i| folder.path().join(format!("{i}.dng"))).collect();
    let shots = bracket.frames().iter().zip(&raw);
    shots.for_each(|(frame, path)| std::fs::write(path, mosaic(frame)).expect("a file"));
    let given = LoadOptions { ev: Some(vec![0.0, 2.0]), ..LoadOptions::default() };
    group.throughput(Throughput::Elements(2 * pixels(&bracket)));
    group.bench_function("load raw", |b| b.iter(|| load(black_box(&raw), &given)));
    let metadata = Metadata::of(bracket.reference());
    let exr = |sample, compression| write::Options { exr: exr::Options { sample, compression }, ..Default::default() };
    let hdr = |hdr| write::Options { hdr, ..Default::default() };
    let tiff = |tiff| write::Options { tiff, ..Default::default() };
    group.throughput(Throughput::Elements(pixels(&bracket)));
    for (what, name, options) in [
        ("exr half piz", "half.exr", exr(exr::Sample::Half, exr::Compression::Piz)),
        ("exr half zip", "zip.exr", exr(exr::Sample::Half, exr::Compression::Zip16)),
        ("exr float piz", "float.exr", exr(exr::Sample::Float, exr::Compression::Piz)),
        ("hdr rgbe", "rgbe.hdr", hdr(hdr::Encoding::Rgbe)),
        ("hdr xyze", "xyze.hdr", hdr(hdr::Encoding::Xyze)),
        ("tiff float", "float.tif", tiff(tiff::Encoding::Float)),
        ("tiff logluv24", "luv24.tif", tiff(tiff::Encoding::LogLuv24)),
        ("tiff logluv32", "luv32.tif", tiff(tiff::Encoding::LogLuv32)),
    ] {
        let path = [folder.path().join(name)];
        let written = || write::write(&path, black_box(&map), &picture, &metadata, &options).expect("a file");
        group.bench_function(format!("write {what}"), |b| b.iter(written));
        write::commit(written().into_iter().map(|w| w.file).collect(), true).expect("a name");
        group.bench_function(format!("read {what}"), |b| b.iter(|| read(black_box(&path[0]))));
    }
}

/// Measures the pipeline from photographs to files, on one and on two threads; `benches/codecs.rs` compares the time
/// for larger photographs with that of the codecs.
fn line(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let images = paths();
    let options = |threads| pipeline::Options {
        outputs: vec![folder.path().join("w.exr"), folder.path().join("w.png")],
        write: write::Options { overwrite: true, ..write::Options::default() },
        threads: Some(threads),
        ..pipeline::Options::default()
    };
    let mut group = c.benchmark_group("line");
    group.throughput(Throughput::Elements(5 * pixels(&small())));
    for (name, options) in [("window, 1 thread", options(1)), ("window, 2 threads", options(2))] {
        group.bench_function(name, |b| {
            b.iter(|| {
                pipeline::run(black_box(&images), &options, &pipeline::unwatched).expect("testdata/window is merged")
            });
        });
    }
}

criterion_group! {
    name = stages;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2));
    targets = bitmaps, alignment, following, features, radiance, files, line
}
criterion_main!(stages);
