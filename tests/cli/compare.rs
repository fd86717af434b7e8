//! `hdralign compare`: which differences it must detect, which it must accept, and how it reports them.

use crate::support::{Folder, Run};
use hdralign::bracket::colour::Primaries;
use hdralign::merge::RadianceMap;
use hdralign::merge::radiance::calibration::Factor;
use hdralign::plane::Plane;
use hdralign::tonemap::DisplayImage;
use hdralign::write::{self, Metadata, Options};
use image::{Rgb, RgbImage};
use serde_json::Value;
use std::path::Path;

/// Returns a scene with edges and texture over 12 stops, with three different channels.
fn scene() -> Plane<[f32; 3]> {
    Plane::from_rows(160, 120, |y, row| {
        for (x, p) in row.iter_mut().enumerate() {
            let stops = 12.0 * x as f32 / 160.0 - 6.0 + if (x / 9 + y / 7) % 2 == 0 { 0.6 } else { 0.0 };
            let light = libm::exp2f(stops) * (1.0 + 0.1 * libm::sinf(y as f32 * 0.7));
            *p = [light, 0.8 * light + 0.01, 0.5 * light + 0.002];
        }
    })
}

/// Writes radiance as the file `name` with our writers and `options`.
fn put(folder: &Folder, name: &str, pixels: Plane<[f32; 3]>, options: &Options) {
    let map = RadianceMap { pixels, primaries: Primaries::SRGB };
    let display = DisplayImage { pixels: Plane::filled(1, 1, [0; 3]) };
    let options = Options { overwrite: true, ..options.clone() };
    let files =
        write::write(&[folder.at(name)], &map, &display, &Metadata::default(), &options).expect("it is written");
    write::commit(files.into_iter().map(|w| w.file).collect(), true).expect("it is named");
}

fn float() -> Options {
    Options {
        exr: write::exr::Options { sample: write::exr::Sample::Float, ..Default::default() },
        ..Options::default()
    }
}

fn changed(change: impl Fn(usize, usize, [f32; 3]) -> [f32; 3] + Sync) -> Plane<[f32; 3]> {
    let scene = scene();
    Plane::from_rows(160, 120, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, p)| *p = change(x, y, scene.at(x, y)));
    })
}

fn picture() -> RgbImage {
    RgbImage::from_fn(160, 120, |x, y| {
        let wave = (128.0 + 100.0 * libm::sin(f64::from(x) * 0.3) * libm::cos(f64::from(y) * 0.2)) as u8;
        Rgb([wave, (x + y) as u8, 255 - wave / 2])
    })
}

fn compare(folder: &Folder, line: &str) -> (Run, Value) {
    let run = folder.line(&format!("compare {line} --json"));
    let json = serde_json::from_str(&run.stdout).unwrap_or(Value::Null);
    (run, json)
}

/// Runs `compare` and returns the exit code; checks that the verdict in the JSON agrees with it.
fn code(folder: &Folder, line: &str) -> i32 {
    let (run, json) = compare(folder, line);
    let expected = ["same", "differs"].get(run.code as usize).map_or(Value::Null, |v| (*v).into());
    assert_eq!(json["verdict"], expected, "{line}: {run:?}");
    run.code
}

#[test]
fn a_shift_a_gain_and_a_swapped_channel_are_caught_in_radiance() {
    let folder = Folder::empty();
    put(&folder, "a.exr", scene(), &float());
    let scene = scene();
    put(&folder, "shifted.exr", changed(|x, y, _| scene.at(x.saturating_sub(1), y)), &float());
    let (run, json) = compare(&folder, "a.exr shifted.exr");
    assert_eq!((run.code, &json["verdict"]), (1, &"differs".into()));
    assert!(
        json["differing"]["differing_percent"].as_f64().unwrap() > 90.0 && json["ms_ssim"].as_f64().unwrap() < 0.99
    );

    let gain = libm::exp2f(0.02);
    put(&folder, "gain.exr", changed(|_, _, p| p.map(|v| v * gain)), &float());
    let (run, json) = compare(&folder, "a.exr gain.exr");
    assert_eq!(run.code, 1);
    let mean = json["radiance"]["mean_stops"].as_f64().unwrap();
    // At most 0.1 % of the values are below the floor, where a difference counts as less.
    assert!((mean - 0.02).abs() < 1e-4, "{mean}");
    assert!(run.stderr.contains("most of ACTUAL is brighter by nearly the same factor: 0.020 stops"), "{}", run.stderr);
    assert_eq!(code(&folder, "a.exr gain.exr --tolerance-stops 0.021"), 0);

    put(&folder, "swapped.exr", changed(|_, _, [r, g, b]| [b, g, r]), &float());
    let (run, json) = compare(&folder, "a.exr swapped.exr");
    assert_eq!((run.code, &json["radiance"]["channels"][1]["max_stops"]), (1, &0.0.into()));
    assert!(json["radiance"]["channels"][0]["rms_stops"].as_f64().unwrap() > 0.5);

    // A difference in one channel of one pixel, and the position of this pixel.
    put(&folder, "one.exr", changed(|x, y, p| if (x, y) == (93, 41) { [p[0], p[1], 1.5 * p[2]] } else { p }), &float());
    let (run, json) = compare(&folder, "a.exr one.exr");
    let largest = &json["differing"]["largest"];
    assert_eq!((run.code, &json["differing"]["differing_pixels"]), (1, &1.into()));
    assert_eq!((&largest["x_px"], &largest["y_px"]), (&93.into(), &41.into()));
    assert!((largest["stops"].as_f64().unwrap() - libm::log2(1.5)).abs() < 1e-4);
    assert_eq!(code(&folder, "a.exr one.exr --max-differing 0.01"), 0);
    assert_eq!(code(&folder, "a.exr one.exr --max-differing 0.001"), 1);
}

#[test]
fn lossless_encoding_passes_and_coarse_rounding_fails() {
    let folder = Folder::empty();
    put(&folder, "a.exr", scene(), &float());
    let exr = |compression| Options {
        exr: write::exr::Options { compression, sample: write::exr::Sample::Float },
        ..Options::default()
    };
    put(&folder, "zip.exr", scene(), &exr(write::exr::Compression::Zip16));
    put(&folder, "none.exr", scene(), &exr(write::exr::Compression::None));
    put(&folder, "a.tif", scene(), &Options::default());
    for other in ["zip.exr", "none.exr", "a.tif", "a.exr"] {
        let (run, json) = compare(&folder, &format!("a.exr {other} --tolerance-stops 0"));
        assert_eq!((run.code, &json["pixels_equal"]), (0, &true.into()), "{other}: {run:?}");
        assert_eq!(json["bytes_equal"], Value::from(other == "a.exr"));
        assert_eq!((&json["pu21_psnr_db"], &json["ms_ssim"]), (&Value::Null, &1.0.into()));
    }
    // Half floats round by at most 0.0007 stops; RGBE by up to 0.0056 stops in the brightest channel, and by far more
    // in the others.
    let half = Options {
        exr: write::exr::Options { sample: write::exr::Sample::Half, ..Default::default() },
        ..Options::default()
    };
    put(&folder, "half.exr", scene(), &half);
    put(&folder, "a.hdr", scene(), &Options::default());
    let (run, json) = compare(&folder, "a.exr half.exr");
    assert_eq!((run.code, &json["pixels_equal"]), (0, &false.into()));
    assert!(json["radiance"]["channels"][0]["max_stops"].as_f64().unwrap() < 0.0008);
    assert_eq!(code(&folder, "a.exr half.exr --tolerance-stops 0"), 1);
    // An RGBE file that is read and written again has the same pixels.
    let (map, _) = hdralign::read::read(&folder.at("a.hdr")).unwrap();
    put(&folder, "b.hdr", map.pixels, &Options::default());
    assert_eq!(code(&folder, "a.hdr b.hdr --tolerance-stops 0"), 0);
    assert_eq!(code(&folder, "a.exr a.hdr"), 1);
    assert_eq!(code(&folder, "a.exr a.hdr --min-psnr 40"), 0);
    assert_eq!(code(&folder, "a.exr a.hdr --min-psnr 90"), 1);
}

#[test]
fn pictures_are_the_same_by_their_codes_and_not_by_their_files() {
    let folder = Folder::empty();
    let a = picture();
    a.save(folder.at("a.png")).unwrap();
    // Files with 16 bits, another compression, or another format have equivalent code values.
    let wide = image::DynamicImage::ImageRgb8(a.clone());
    wide.to_rgb16().save(folder.at("wide.png")).unwrap();
    a.save(folder.at("a.tif")).unwrap();
    // Parts of a file that are not compared are reported.
    wide.to_rgba8().save(folder.at("alpha.png")).unwrap();
    let (run, json) = compare(&folder, "a.png alpha.png");
    assert!(run.code == 0 && json["warnings"][0].as_str().unwrap().contains("alpha is not compared"), "{json}");
    for other in ["a.png", "wide.png", "a.tif"] {
        let (run, json) = compare(&folder, &format!("a.png {other}"));
        assert_eq!((run.code, &json["pixels_equal"]), (0, &true.into()), "{other}: {run:?}");
    }
    let shifted = RgbImage::from_fn(160, 120, |x, y| *a.get_pixel(x.saturating_sub(1), y));
    let brighter = RgbImage::from_fn(160, 120, |x, y| Rgb(a.get_pixel(x, y).0.map(|v| v.saturating_add(1))));
    let swapped = RgbImage::from_fn(160, 120, |x, y| {
        let [r, g, b] = a.get_pixel(x, y).0;
        Rgb([b, g, r])
    });
    for (name, other, least) in [("shifted", shifted, 50.0), ("brighter", brighter, 99.0), ("swapped", swapped, 90.0)] {
        let name = format!("{name}.png");
        other.save(folder.at(&name)).unwrap();
        let (run, json) = compare(&folder, &format!("a.png {name}"));
        let share = json["differing"]["differing_percent"].as_f64().unwrap();
        assert!(run.code == 1 && share > least, "{name}: {share}");
    }
    // A difference of one code value is rarely a dE of 1; in all pixels it is a PSNR of 48.13 dB.
    assert_eq!(code(&folder, "a.png brighter.png --tolerance-de 1 --max-differing 5"), 0);
    let (_, json) = compare(&folder, "a.png brighter.png --min-psnr 48");
    let psnr = json["display"]["psnr_db"].as_f64().unwrap();
    assert!(json["verdict"] == "same" && (48.13..48.6).contains(&psnr), "{psnr}");
    assert_eq!(code(&folder, "a.png brighter.png --min-psnr 49"), 1);
    // Codes of the file with more bits.
    let (run, _) = compare(&folder, "wide.png brighter.png");
    assert!(run.stderr.contains("at most 257, 257, 257 of 65535 in red, green, blue"), "{}", run.stderr);
}

#[test]
fn sizes_odd_values_and_headers() {
    let folder = Folder::empty();
    put(&folder, "a.exr", scene(), &float());
    put(&folder, "cut.exr", Plane::from_rows(159, 120, |_, row| row.fill([1.0; 3])), &float());
    let (run, json) = compare(&folder, "a.exr cut.exr --diff d.png");
    assert_eq!((run.code, &json["pixels_equal"], &json["differing"]), (1, &Value::Null, &Value::Null));
    assert!(json["reason"].as_str().unwrap().contains("159 x 120"), "{json}");
    assert!(folder.at("d.png").is_file());

    // Other programs write such values; hdralign does not.
    let odd = |name: &str, value: f32| {
        use exr::prelude::WritableImage;
        let scene = scene();
        let layer = exr::prelude::SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
            let p = if (at.x(), at.y()) == (5, 6) { [value; 3] } else { scene.at(at.x(), at.y()) };
            (p[0], p[1], p[2])
        });
        exr::prelude::Image::from_channels((160, 120), layer).write().to_file(folder.at(name)).unwrap();
    };
    odd("nan.exr", f32::NAN);
    odd("nan-too.exr", f32::NAN);
    odd("inf.exr", f32::INFINITY);
    assert_eq!(code(&folder, "nan.exr nan-too.exr --tolerance-stops 0"), 0);
    for other in ["nan.exr", "inf.exr"] {
        // Such a difference exceeds every tolerance, but a share of the pixels may exceed it.
        let (run, json) = compare(&folder, &format!("a.exr {other} --tolerance-stops 1000"));
        assert_eq!((run.code, &json["radiance"]["not_comparable_pixels"]), (1, &1.into()));
        let largest = &json["differing"]["largest"];
        assert_eq!((&largest["x_px"], &largest["y_px"], &largest["stops"]), (&5.into(), &6.into(), &Value::Null));
        assert_eq!(code(&folder, &format!("a.exr {other} --min-psnr 1")), 1);
        assert_eq!(code(&folder, &format!("a.exr {other} --max-differing 1")), 0);
    }
    assert_eq!(code(&folder, "inf.exr nan.exr"), 1);
    // Differences between headers are reported, and never change the outcome.
    let (run, json) = compare(&folder, "nan.exr nan-too.exr");
    assert!(run.code == 0 && json["metadata"].as_array().is_some_and(Vec::is_empty));
    let bracket = Folder::with_bracket();
    bracket.line("merge w2.jpg w3.jpg w4.jpg --align none -q -o a.exr").done();
    std::fs::copy(bracket.at("a.exr"), folder.at("merged.exr")).unwrap();
    let (map, _) = hdralign::read::read(&folder.at("merged.exr")).unwrap();
    put(&folder, "bare.exr", map.pixels, &Options::default());
    let (run, json) = compare(&folder, "merged.exr bare.exr");
    assert_eq!(run.code, 0, "{run:?}");
    let keys: Vec<&str> = json["metadata"].as_array().unwrap().iter().filter_map(|m| m["key"].as_str()).collect();
    assert!(keys.contains(&"time_s") && run.stderr.contains("header"), "{keys:?}");
}

#[test]
fn incomparable_files_are_an_error_and_not_a_difference() {
    let folder = Folder::empty();
    put(&folder, "a.exr", scene(), &float());
    picture().save(folder.at("a.png")).unwrap();
    folder.put("words.txt", b"no picture at all");
    let whole = folder.bytes("a.exr");
    folder.put("cut.exr", &whole[..whole.len() / 2]);
    let before = folder.listing();
    for (line, said) in [
        ("a.exr a.png", "a.exr: contains radiance, but a.png contains a display picture"),
        ("gone.exr a.exr", "gone.exr: cannot be read"),
        ("a.exr gone.exr", "gone.exr: cannot be read"),
        ("a.exr words.txt", "words.txt: cannot be compared"),
        ("a.exr cut.exr", "cut.exr: cannot be decoded"),
        ("a.exr .", "it is a folder"),
        ("a.exr a.exr --tolerance-de 1", "--tolerance-stops"),
        ("a.png a.png --tolerance-stops 1", "--tolerance-de"),
        ("a.exr a.exr --tolerance-stops -1", "-1 is not a tolerance"),
        ("a.exr a.exr --max-differing 101", "percent"),
        ("a.exr a.exr --diff d.jpg", ".png"),
        ("a.exr a.exr --diff a.png", "--force"),
        ("a.png a.png --diff a.png --force", "another name"),
        ("a.exr", "Usage"),
    ] {
        let run = folder.line(&format!("compare {line}"));
        assert!(run.code == 2 && run.stdout.is_empty() && run.stderr.contains(said), "{line}: {run:?}");
    }
    assert_eq!(folder.listing(), before, "nothing is left behind");
}

#[test]
fn bless_copies_the_file_and_reports_it() {
    let folder = Folder::empty();
    put(&folder, "new.exr", scene(), &float());
    let run = folder.line("compare golden.exr new.exr --bless").done();
    assert!(run.stderr.contains("golden.exr did not exist") && run.stdout == "golden.exr\n", "{run:?}");
    assert_eq!(folder.bytes("golden.exr"), folder.bytes("new.exr"));
    let run = folder.line("compare golden.exr new.exr --bless").done();
    assert!(run.stderr.contains("already") && run.stdout.is_empty());
    put(&folder, "new.exr", changed(|_, _, p| p.map(|v| 2.0 * v)), &float());
    assert_eq!(folder.line("compare golden.exr new.exr -q").code, 1);
    let run = folder.line("compare golden.exr new.exr --bless").done();
    assert!(run.stderr.contains("differs: ") && run.stderr.contains("now a copy"), "{run:?}");
    assert_eq!(folder.line("compare golden.exr new.exr").done().stdout, "");
    // With --bless, the expected file may be damaged, but the actual file must not be.
    folder.put("golden.exr", b"cut short");
    folder.line("compare golden.exr new.exr --bless -q").done();
    assert_eq!(folder.bytes("golden.exr"), folder.bytes("new.exr"));
    folder.put("new.exr", b"cut short");
    assert_eq!(folder.line("compare golden.exr new.exr --bless").code, 2);
    picture().save(folder.at("p.png")).unwrap();
    let run = folder.line("compare gone.exr p.png --bless");
    assert!(run.code == 2 && run.stderr.contains("one extension") && !folder.at("gone.exr").exists(), "{run:?}");
    assert!(folder.listing().iter().all(|(name, _)| !name.contains("part")), "no temporary file is left");
}

#[test]
fn values_that_are_not_numbers_are_blessed_with_a_warning() {
    let folder = Folder::empty();
    put(&folder, "one.exr", changed(|x, y, rgb| if (x, y) == (3, 4) { [f32::INFINITY; 3] } else { rgb }), &float());
    put(&folder, "all.exr", changed(|_, _, _| [f32::NAN; 3]), &float());
    for (name, said) in
        [("one.exr", "warning: one.exr: 1 of "), ("all.exr", "warning: all.exr: all pixels have values")]
    {
        let run = folder.line(&format!("compare golden.exr {name} --bless")).done();
        assert!(run.stderr.contains(said) && run.stderr.contains("NaN"), "{}", run.stderr);
        // The warning is also given if the expected file is already equal.
        assert!(folder.line(&format!("compare golden.exr {name} --bless")).done().stderr.contains(said));
    }
}

#[test]
fn the_difference_picture_shows_where() {
    let folder = Folder::empty();
    put(&folder, "a.exr", scene(), &float());
    put(&folder, "b.exr", changed(|x, y, p| if (x, y) == (20, 100) { p.map(|v| 4.0 * v) } else { p }), &float());
    let run = folder.line("compare a.exr b.exr --diff d.png");
    assert_eq!((run.code, run.stdout.as_str()), (1, "d.png\n"));
    let page = image::open(folder.at("d.png")).unwrap().to_rgb8();
    // The three panels are 160 x 120 pixels, magnified twice, 10 pixels apart, with margins of 20 pixels left and 76
    // above.
    let at = |panel: u32, x: u32, y: u32| page.get_pixel(20 + panel * 330 + 2 * x, 76 + 2 * y).0;
    // The difference of 2 stops is at the end of the scale, which is white; equal pixels are grey.
    assert_eq!(at(1, 20, 100), [255; 3]);
    let [r, g, b] = at(1, 100, 100);
    assert!(r == g && g == b && r < 100);
    assert!(at(2, 20, 100)[0] > at(0, 20, 100)[0] && at(2, 100, 50) == at(0, 100, 50));
    // A second run writes the same bytes.
    let first = folder.bytes("d.png");
    folder.line("compare a.exr b.exr --diff d.png --force -q");
    assert!(folder.bytes("d.png") == first);
}

#[test]
fn json_has_its_schema_and_stderr_the_words() {
    let folder = Folder::empty();
    put(&folder, "a.exr", scene(), &float());
    put(&folder, "b.exr", changed(|_, _, p| p.map(|v| 1.1 * v)), &float());
    let (run, json) = compare(&folder, "a.exr b.exr");
    assert_eq!((&json["schema"], &json["limits"]["tolerance_stops"]), (&"hdralign-compare/1".into(), &0.01.into()));
    assert_eq!((&json["expected"]["path"], &json["actual"]["width_px"]), (&"a.exr".into(), &160.into()));
    let keys: Vec<&String> = json.as_object().unwrap().keys().collect();
    assert!(keys.contains(&&"pu21_psnr_db".to_string()), "{keys:?}");
    assert!(run.stderr.starts_with("differs: "), "{}", run.stderr);
    assert!(!run.stderr.contains('\u{1b}'), "stderr is no terminal");
    let quiet = folder.line("compare a.exr b.exr -q");
    assert_eq!((quiet.code, quiet.stdout.as_str(), quiet.stderr.as_str()), (1, "", ""));
}

/// Returns `bytes`, an EXR with whiteLuminance, with another value of whiteLuminance.
fn with_white(bytes: &[u8], value: f32) -> Vec<u8> {
    let name = b"whiteLuminance\0float\0\x04\0\0\0";
    let at = bytes.windows(name.len()).position(|w| w == name).expect("whiteLuminance") + name.len();
    [&bytes[..at], &value.to_le_bytes(), &bytes[at + 4..]].concat()
}

/// A file with an invalid unit once became black as `.hdr`, and all black files compared as equal.
#[test]
fn invalid_unit_is_ignored_and_black_is_not_equal() {
    let folder = Folder::empty();
    let put_in = |name: &str, unit: Option<f64>, pixels: Plane<[f32; 3]>| {
        let map = RadianceMap { pixels, primaries: Primaries::SRGB };
        let display = DisplayImage { pixels: Plane::filled(1, 1, [0; 3]) };
        let metadata = Metadata { cd_m2_per_unit: unit.and_then(Factor::new), ..Metadata::default() };
        let files = write::write(&[folder.at(name)], &map, &display, &metadata, &float()).expect("it is written");
        write::commit(files.into_iter().map(|w| w.file).collect(), true).expect("it is named");
    };
    put_in("unit.exr", Some(2.0), scene());
    put_in("a.exr", None, scene());
    put_in("black.exr", None, changed(|_, _, _| [0.0; 3]));
    folder.line("tonemap a.exr -o a.hdr -q").done();
    let expected = hdralign::read::read(&folder.at("a.hdr")).unwrap().0;
    let bytes = folder.bytes("unit.exr");
    for value in [0.0, -1.0, f32::NAN, f32::INFINITY, f32::MIN_POSITIVE] {
        folder.put("odd.exr", &with_white(&bytes, value));
        let run = folder.line("tonemap odd.exr -o odd.hdr --force").done();
        assert!(run.stderr.contains("whiteLuminance"), "{value}: {}", run.stderr);
        assert!(hdralign::read::read(&folder.at("odd.hdr")).unwrap().0 == expected, "{value}");
        let (run, json) = compare(&folder, "odd.exr black.exr --min-psnr 60");
        assert!(run.code == 1 && json["warnings"].to_string().contains("whiteLuminance"), "{value}: {json}");
        assert_eq!(code(&folder, "odd.exr a.exr --min-psnr 60"), 0);
    }
    // With this valid unit, the whole scene is below the range of PU21.
    folder.put("dim.exr", &with_white(&bytes, 1e-12));
    let (run, json) = compare(&folder, "dim.exr black.exr --min-psnr 60");
    let reason = json["reason"].as_str().unwrap_or_default();
    assert!(run.code == 1 && reason.contains("not equal, but by differences that PU21-PSNR cannot measure"), "{json}");
}

/// Renderers write alpha, depth and a second view in addition to the colours.
#[test]
fn ignored_parts_of_exr_and_tiff_are_reported() {
    use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};
    let folder = Folder::empty();
    let write = |name: &str, parts: &[(&str, &[&str])]| {
        let layer = |(name, channels): &(&str, &[&str])| {
            let channel = |name: &&str| AnyChannel::new(*name, FlatSamples::F32(vec![0.5; 64]));
            let channels = AnyChannels::sort(channels.iter().map(channel).collect());
            Layer::new((8, 8), LayerAttributes::named(*name), Encoding::UNCOMPRESSED, channels)
        };
        let layers: Vec<_> = parts.iter().map(layer).collect();
        let attributes = exr::meta::header::ImageAttributes::with_size((8, 8));
        Image::from_layers(attributes, layers).write().to_file(folder.at(name)).expect("an EXR");
    };
    let rgb: &[&str] = &["R", "G", "B"];
    let warned = |name: &str| {
        let (run, json) = compare(&folder, &format!("{name} plain.exr"));
        assert_eq!(run.code, 0, "{name}: {json}");
        json["warnings"].to_string()
    };
    write("plain.exr", &[("main", rgb)]);
    assert_eq!(warned("plain.exr"), "[]");
    write("alpha.exr", &[("main", &["R", "G", "B", "A"])]);
    assert!(warned("alpha.exr").contains("its alpha is not compared"));
    write("more.exr", &[("main", &["R", "G", "B", "A", "Z", "left.R", "left.G"]), ("right", rgb)]);
    let said = warned("more.exr");
    assert!(said.contains("alpha, channel Z, layer left and layer right are not compared"), "{said}");
    let mut pages = std::io::Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut pages).expect("a TIFF");
    for light in [0.5; 2] {
        encoder.write_image::<tiff::encoder::colortype::RGB32Float>(8, 8, &[light; 192]).expect("a page");
    }
    std::fs::write(folder.at("pages.tif"), pages.into_inner()).expect("room for it");
    assert!(warned("pages.tif").contains("its image 2 is not compared"));
}

/// OpenEXR stores the f-number 5.6 as an `f32`, 5.599999904632568; TIFF as the fraction 56/10.
#[test]
fn numbers_of_headers_are_compared_as_finely_as_formats_keep_them() {
    let folder = Folder::empty();
    let metadata = |f_number| Metadata { f_number: Some(f_number), time_s: Some(1.0 / 30.0), ..Metadata::default() };
    let put_as = |name: &str, f_number: f64| {
        let map = RadianceMap { pixels: scene(), primaries: Primaries::SRGB };
        let display = DisplayImage { pixels: Plane::filled(1, 1, [0; 3]) };
        let files = write::write(&[folder.at(name)], &map, &display, &metadata(f_number), &float()).expect("files");
        write::commit(files.into_iter().map(|w| w.file).collect(), true).expect("it is named");
    };
    put_as("a.exr", 5.6);
    put_as("a.tif", 5.6);
    put_as("b.exr", 6.3);
    let (_, json) = compare(&folder, "a.exr a.tif");
    let keys: Vec<_> = json["metadata"].as_array().unwrap().iter().map(|changed| changed["key"].clone()).collect();
    assert!(!keys.contains(&"f_number".into()) && !keys.contains(&"time_s".into()), "{json}");
    let (_, json) = compare(&folder, "a.exr b.exr");
    assert_eq!(json["metadata"], serde_json::json!([{ "key": "f_number", "expected": "5.6", "actual": "6.3" }]));
}

/// Kinds of files that some decoders read wrongly; tests/fixtures/README.md describes how each was made from the same
/// pixels.
#[test]
fn files_of_rare_kinds_are_the_picture_that_they_were_made_of() {
    let folder = Folder::empty();
    let ramp = RgbImage::from_fn(40, 44, |x, y| Rgb([6 * x as u8, 5 * y as u8, 120]));
    ramp.save(folder.at("ramp.png")).expect("a picture");
    for (name, psnr) in [
        ("scans-420.jpg", 30),
        ("scans-440.jpg", 30),
        ("fine-chroma.jpg", 30),
        ("planar-tiles.tif", 90),
        ("lzw-tiles.tif", 90),
        ("fill-order.tif", 90),
    ] {
        let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name);
        std::fs::copy(fixture, folder.at(name)).expect("a copy");
        let run = folder.line(&format!("compare ramp.png {name} --min-psnr {psnr}"));
        assert!(run.code == 0 && !run.stderr.contains("panicked"), "{name}: {run:?}");
    }
}
