//! `response`, response files, and exposures: whether those of EXIF or estimates from the pixels are used.

use crate::support::{FRAMES, Folder, small, small_jpeg, window};
use serde_json::Value;
use std::fs;

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// Creates two brackets, each in its own folder.
fn two_brackets() -> Folder {
    let folder = Folder::empty();
    for name in ["night", "church"] {
        fs::create_dir(folder.at(name)).expect("a folder");
        for i in 1..=FRAMES {
            folder.put(&format!("{name}/{i}.jpg"), small_jpeg(i));
        }
    }
    folder
}

fn names(folder: &Folder) -> Vec<String> {
    folder.listing().into_iter().map(|(name, _)| name).collect()
}

#[test]
fn folders_are_brackets_and_all_requested_files_are_written() {
    let folder = two_brackets();
    let line = "response night church -o c.json -o c.rsp -o c.csv --plot c.svg --plot c.png --align none --json";
    let report = json(&folder.line(line).done().stdout);
    assert_eq!(report["schema"], "hdralign-response-report/1");
    assert_eq!(report["brackets"].as_array().map(Vec::len), Some(2));
    assert_eq!(report["brackets"][1]["frames"].as_array().map(Vec::len), Some(FRAMES));
    assert!(report["response"]["channels"][0]["residual_stops"].as_f64().is_some_and(|r| r < 0.2), "{report}");
    let expected = ["c.json", "c.rsp", "c.csv", "c.svg", "c.png"];
    assert_eq!(report["outputs"], serde_json::json!(expected));
    assert_eq!(names(&folder), ["c.csv", "c.json", "c.png", "c.rsp", "c.svg", "church", "night"]);
    let svg = String::from_utf8(folder.bytes("c.svg")).expect("text");
    assert!(svg.contains("code value") && svg.contains("2 brackets"));
    let plot = image::open(folder.at("c.png")).expect("a picture");
    assert!(plot.width() > 800);
    // The format of hdrgen has a line for each channel: a degree n and n + 1 coefficients.
    let rsp = String::from_utf8(folder.bytes("c.rsp")).expect("text");
    for line in rsp.lines() {
        let numbers: Vec<f64> = line.split(' ').map(|w| w.parse().expect("a number")).collect();
        assert_eq!(numbers[0] as usize + 2, numbers.len());
    }
    assert_eq!(rsp.lines().count(), 3);
}

#[test]
fn a_saved_curve_of_any_format_gives_nearly_the_same_radiance() {
    let folder = Folder::with_bracket();
    let merge = "merge w2.jpg w3.jpg w4.jpg --align none --exposures as-given --force";
    let percentile = |more: &str| {
        let report = json(&folder.line(&format!("{merge} {more} -o a.hdr --json")).done().stdout);
        report["radiance"]["radiance"]["dynamic_range_stops"].as_f64().expect("a number")
    };
    let own = percentile("--save-response c.json");
    percentile("--save-response c.csv");
    percentile("--save-response c.rsp");
    let bytes = folder.bytes("a.hdr");
    assert_eq!(percentile("--response c.json"), own);
    assert_eq!(folder.bytes("a.hdr"), bytes, "a curve saved as JSON is the same curve");
    for (file, most) in [("c.csv", 0.01), ("c.rsp", 0.5)] {
        let other = percentile(&format!("--response {file}"));
        assert!((other - own).abs() < most, "{file}: {other} stops for {own}");
    }
}

#[test]
fn default_name_of_a_curve_is_that_of_the_camera() {
    let folder = two_brackets();
    let run = folder.line("response night church --align none").done();
    let path = run.stdout.trim();
    assert!(path.starts_with("night/") && path.ends_with(".json") && folder.at(path).is_file(), "{path}");
    assert!(run.stderr.contains("10 frames in 2 brackets"), "{}", run.stderr);
    let again = folder.line("response night church --align none");
    assert!(again.code == 1 && again.stderr.contains("--force"), "{again:?}");
    let report = json(&String::from_utf8(folder.bytes(path)).expect("text"));
    assert_eq!(report["schema"], "hdralign-response/1");
}

#[test]
fn failed_calibrations_leave_no_files() {
    let folder = two_brackets();
    let before = names(&folder);
    let refused = |line: &str, code: i32, words: &str| {
        let run = folder.line(line);
        assert!(run.code == code && run.stderr.contains(words), "{line}: {run:?}");
        assert_eq!(names(&folder), before, "{line}");
    };
    refused("response night church -e=-2,0,2 -o c.json", 2, "several");
    refused("response night church --reference night/3.jpg -o c.json", 2, "--reference");
    refused("response night church/1.jpg -o c.json", 2, "at least two");
    refused("response night -o c.txt", 2, ".json, .rsp, .csv");
    refused("response night -o c.json --plot c.pdf", 2, ".svg, .png");
    refused("response night church --leave-out nobody.jpg -o c.json", 2, "in none of the brackets");
    // Frames with equal pixels of one colour do not determine a response.
    fs::create_dir(folder.at("night/flat")).expect("a folder");
    for name in ["a", "b"] {
        image::RgbImage::from_pixel(64, 48, image::Rgb([90, 90, 90]))
            .save(folder.at(format!("night/flat/{name}.png")))
            .expect("a picture");
    }
    refused("response night/flat -e=0,2 --align none -o c.json --plot c.svg", 1, "cannot be recovered");
}

#[test]
fn invalid_response_file_is_named_with_the_remedy() {
    let folder = Folder::with_bracket();
    folder.put("photo.json", small_jpeg(1));
    folder.put("short.rsp", b"3 1 2 3\n");
    folder.put("other.csv", b"a;b;c\n1;2;3\n");
    for (file, words) in [("photo.json", "not a text file"), ("short.rsp", "red"), ("other.csv", "no matrix")] {
        let run = folder.line(&format!("merge w2.jpg w3.jpg --response {file} -o a.hdr"));
        assert!(run.code == 1 && run.stderr.contains(file) && run.stderr.contains(words), "{run:?}");
        assert!(run.stderr.contains("hdralign response"), "{run:?}");
    }
    let run = folder.line("merge w2.jpg w3.jpg --response w4.jpg -o a.hdr");
    assert!(run.code == 2 && run.stderr.contains(".json, .rsp, .csv"), "{run:?}");
    assert!(!folder.at("a.hdr").exists());
}

#[test]
fn unusable_response_file_is_an_error_before_any_work() {
    let folder = Folder::with_bracket();
    folder.put("bad.json", b"{}");
    // The response file is read before the photographs: that one of them is missing was not noticed.
    for file in ["bad.json", "none.json"] {
        let run = folder.line(&format!("merge w2.jpg gone.jpg --response {file} -o a.hdr"));
        assert!(run.code == 1 && run.stderr.contains(file) && !run.stderr.contains("gone.jpg"), "{run:?}");
    }
}

#[test]
fn the_curve_of_another_camera_is_used_with_a_warning() {
    let folder = Folder::with_bracket();
    let merge = "merge w2.jpg w3.jpg w4.jpg --align none --force -o a.hdr";
    folder.line(&format!("{merge} --save-response own.json")).done();
    let saved = json(&String::from_utf8(folder.bytes("own.json")).expect("text"));
    assert!(saved["camera_model"].is_string(), "{}", saved["camera_model"]);
    let own = folder.line(&format!("{merge} --response own.json --strict")).done();
    assert!(!own.stderr.contains("warning"), "{}", own.stderr);
    let mut other = saved.clone();
    (other["camera_make"], other["camera_model"]) = ("Acme".into(), "One".into());
    folder.put("other.json", other.to_string().as_bytes());
    let run = folder.line(&format!("{merge} --response other.json --strict"));
    let said = ["warning: other.json", "Acme One", saved["camera_model"].as_str().unwrap_or("?")];
    assert!(run.code == 3 && said.iter().all(|words| run.stderr.contains(words)), "{run:?}");
    // A response file that names no camera is accepted.
    (other["camera_make"], other["camera_model"]) = (Value::Null, Value::Null);
    folder.put("nobody.json", other.to_string().as_bytes());
    folder.line(&format!("{merge} --response nobody.json --strict")).done();
}

#[test]
fn exposures_given_in_the_wrong_order_are_used_with_a_warning() {
    let folder = Folder::with_bracket();
    let turned = folder.line("merge -e=2,0,-2 w2.jpg w3.jpg w4.jpg --align none -o a.hdr --json").done();
    let report = json(&turned.stdout);
    let doubts = report["warnings"].as_array().expect("a list").iter();
    let doubts: Vec<_> =
        doubts.filter(|w| w["message"].as_str().is_some_and(|m| m.contains("-e contradict"))).collect();
    assert!(doubts.len() == 1 && doubts[0]["degrades"] == true, "{report}");
    assert!(report["frames"].as_array().expect("frames").iter().all(|f| f["exposure_correction_stops"] == 0.0));
    let right = folder.line("merge -e=-2,0,2 w2.jpg w3.jpg w4.jpg --align none -o b.hdr").done();
    assert!(!right.stderr.contains("contradict"), "{}", right.stderr);
}

#[test]
fn wrong_exposure_is_corrected_and_reported() {
    let folder = Folder::empty();
    // These PNGs have no EXIF, so their exposures are estimated, and then corrected. JPEGs have EXIF with exact
    // exposures.
    for i in 1..=FRAMES {
        folder.put(&format!("{i}.jpg"), &fs::read(window(i)).expect("a frame"));
        small(i).save(folder.at(format!("{i}.png"))).expect("a picture");
    }
    let frames = |line: &str| {
        let report = json(&folder.line(line).done().stdout);
        let number = |f: &Value, key: &str| f[key].as_f64().unwrap_or_else(|| panic!("{key}: {f}"));
        let frames = report["frames"].as_array().expect("frames").iter();
        frames
            .map(|f| (number(f, "relative_exposure").log2(), number(f, "exposure_correction_stops")))
            .collect::<Vec<_>>()
    };
    let exact = frames("merge 1.jpg 2.jpg 3.jpg 4.jpg 5.jpg -o a.hdr --json");
    assert!(exact.iter().all(|(_, correction)| *correction == 0.0), "{exact:?}");
    let guessed = frames("merge 1.png 2.png 3.png 4.png 5.png --exposures as-given -o b.hdr --json");
    let tuned = frames("merge 1.png 2.png 3.png 4.png 5.png -o c.hdr --json");
    assert!(guessed.iter().all(|(_, correction)| *correction == 0.0));
    // The true steps are exactly two stops. Returns the largest relative difference of a step from the mean step.
    let uneven = |frames: &[(f64, f64)]| {
        let steps: Vec<f64> = frames.windows(2).map(|w| w[1].0 - w[0].0).collect();
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        steps.iter().map(|s| (s - mean).abs()).fold(0.0, f64::max) / mean
    };
    assert!(uneven(&tuned) <= uneven(&guessed) && uneven(&tuned) < 0.05, "{guessed:?} {tuned:?}");
    for ((was, _), (is, correction)) in guessed.iter().zip(&tuned) {
        assert!((was + correction - is).abs() < 1e-9);
    }
}

/// A response file of another camera gives a warning.
#[test]
fn response_that_contradicts_the_frames_is_a_warning() {
    let folder = Folder::with_bracket();
    let merge = "merge w1.jpg w2.jpg w3.jpg w4.jpg w5.jpg --align none --exposures as-given --json --force -o a.exr";
    let report = |options: &str| json(&folder.line(&format!("{merge} {options}")).done().stdout);
    let said = |report: &Value| report["warnings"].to_string();
    // The curve that was recovered from the same frames and saved gives no warning.
    report("--save-response own.json");
    assert!(!said(&report("--response own.json")).contains("does not fit the frames"));
    // A linear curve is not that of this camera.
    folder.put("other.rsp", "1 1 0\n".repeat(3).as_bytes());
    let contradicted = said(&report("--response other.rsp"));
    assert!(contradicted.contains("other.rsp") && contradicted.contains("does not fit the frames"), "{contradicted}");
    let strict = folder.line(&format!("{merge} --response other.rsp --strict"));
    assert_eq!(strict.code, 3, "{}", strict.stderr);
}

/// Many pixels have dark code values, which have very small weights in the fit: the errors of a polynomial there affect
/// the radiance, but hardly the residual of the curve.
#[test]
fn reported_loss_of_a_polynomial_is_the_error_of_the_radiance() {
    let folder = Folder::with_bracket();
    for frames in ["w1.jpg w2.jpg w3.jpg w4.jpg w5.jpg", "w2.jpg w3.jpg w4.jpg"] {
        let merge = format!(
            "merge {frames} --align none --deghost=off --exposures as-given --json --force --exr-type float -o a.exr"
        );
        let merged = |options: &str| {
            let report = json(&folder.line(&format!("{merge} {options}")).done().stdout);
            (report["warnings"].to_string(), hdralign::read::read(&folder.at("a.exr")).expect("radiance").0)
        };
        let (reported, own) = merged("--save-response own.rsp");
        let (_, other) = merged("--response own.rsp");
        let number = |after: &str| -> f64 {
            let rest = reported.split(after).nth(1).unwrap_or_else(|| panic!("no {after:?} in {reported}"));
            let end = rest.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(rest.len());
            rest[..end].parse().expect("a number")
        };
        let off = |light: &dyn Fn(&[f32; 3]) -> f64| {
            let pairs = own.pixels.as_slice().iter().zip(other.pixels.as_slice());
            let squares: f64 = pairs.map(|(a, b)| libm::log2(light(b) / light(a)).powi(2)).sum();
            (squares / own.pixels.as_slice().len() as f64).sqrt()
        };
        let luminance = |p: &[f32; 3]| f64::from(0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]);
        // The reported loss is from 16384 pixels, of which a few per cent dominate the sum of squares: it is accurate
        // to some per cent, in addition to the rounding to two decimals.
        for (after, is) in [("is wrong by ", off(&luminance)), ("blue ", off(&|p| f64::from(p[2])))] {
            assert!(
                (number(after) - is).abs() < 0.1 * is + 0.005,
                "{frames}: {after}{} reported of {is}",
                number(after)
            );
        }
    }
}
