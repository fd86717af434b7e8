//! Adjustments of the picture: white balance, brightness, contrast, saturation, shadows and highlights, with every
//! command and operator.

use crate::support::{Folder, Run, small_jpeg};
use hdralign::bracket::colour::{Primaries, srgb_to_linear};
use hdralign::merge::RadianceMap;
use hdralign::plane::Plane;
use hdralign::tonemap::DisplayImage;
use hdralign::write::{self, Metadata};
use serde_json::Value;

const MERGE: &str = "merge w2.jpg w3.jpg w4.jpg --align none -q --force";

/// Returns the pixels of an 8-bit picture.
fn codes(folder: &Folder, name: &str) -> Vec<[u8; 3]> {
    let picture = image::open(folder.at(name)).unwrap_or_else(|e| panic!("{name}: {e}")).into_rgb8();
    picture.pixels().map(|pixel| pixel.0).collect()
}

/// Returns the luminance of a pixel on the display, relative to white.
fn luminance([r, g, b]: [u8; 3]) -> f64 {
    let light = |code: u8| srgb_to_linear(f64::from(code) / 255.0);
    0.2126 * light(r) + 0.7152 * light(g) + 0.0722 * light(b)
}

/// Returns the mean of red minus blue, and the mean of the largest difference between two channels of a pixel, in code
/// values.
fn tint(pixels: &[[u8; 3]]) -> (f64, f64) {
    let mean = |of: &dyn Fn(&[u8; 3]) -> f64| pixels.iter().map(of).sum::<f64>() / pixels.len() as f64;
    let code = |c: usize| mean(&|p| f64::from(p[c]));
    let apart = mean(&|p| f64::from(p[0].abs_diff(p[1]).max(p[1].abs_diff(p[2])).max(p[0].abs_diff(p[2]))));
    (code(0) - code(2), apart)
}

/// Returns the log odds of the luminance, in stops, at the quantile `part` of the pixels, sorted from dark to bright.
fn at(pixels: &[[u8; 3]], part: f64) -> f64 {
    let mut all: Vec<f64> = pixels.iter().map(|&pixel| luminance(pixel)).collect();
    all.sort_by(f64::total_cmp);
    let y = all[(part * (all.len() - 1) as f64) as usize].clamp(1e-4, 1.0 - 1e-4);
    (y / (1.0 - y)).log2()
}

fn refused(run: &Run, said: &[&str]) {
    assert_eq!(run.code, 2, "{run:?}");
    assert!(said.iter().all(|part| run.stderr.contains(part)), "{}", run.stderr);
}

/// Code values are rounded, so log odds of dark pixels are accurate only to a tenth of a stop.
#[test]
fn every_option_changes_the_picture_of_every_command_and_operator_alike() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    let tonemap = "tonemap a.exr -q --force";
    for line in [tonemap, MERGE, &format!("{MERGE} --tmo mertens"), &format!("{tonemap} --tmo mantiuk06")] {
        let made = |options: &str| {
            folder.line(&format!("{line} --picture a.png {options}")).done();
            codes(&folder, "a.png")
        };
        let plain = made("");
        let brighter = made("--brightness 1");
        for part in [0.3, 0.5, 0.7] {
            let stops = at(&brighter, part) - at(&plain, part);
            assert!((stops - 1.0).abs() < 0.1, "{line} {part}: {stops}");
        }
        assert!(at(&made("--brightness -1"), 0.5) < at(&plain, 0.5) - 0.9, "{line}");
        let range = |pixels: &[[u8; 3]]| at(pixels, 0.9) - at(pixels, 0.1);
        let times = range(&made("--contrast 50")) / range(&plain);
        assert!((times - 2f64.sqrt()).abs() < 0.1, "{line}: {times}");
        assert!(range(&made("--contrast -50")) < 0.8 * range(&plain), "{line}");
        assert!(tint(&made("--saturation -100")).1 < 0.01, "{line}: grey");
        assert!(tint(&made("--saturation 60")).1 > 1.2 * tint(&plain).1, "{line}");
        let lifted = made("--shadows 80");
        let (dark, bright) = (at(&lifted, 0.05) - at(&plain, 0.05), at(&lifted, 0.97) - at(&plain, 0.97));
        assert!(dark > 0.4 && dark > 3.0 * bright && bright > -0.05, "{line}: {dark} {bright}");
        let held = made("--highlights -80");
        let (dark, bright) = (at(&held, 0.05) - at(&plain, 0.05), at(&held, 0.97) - at(&plain, 0.97));
        assert!(bright < -0.4 && bright < 3.0 * dark && dark < 0.05, "{line}: {dark} {bright}");
        let [cool, warm] = ["4000", "12000K"].map(|kelvin| tint(&made(&format!("--white-balance {kelvin}"))).0);
        assert!(cool < tint(&plain).0 - 10.0 && warm > tint(&plain).0 + 10.0, "{line}: {cool} {warm}");
        let green = |pixels: &[[u8; 3]]| {
            let sum = |c: usize| pixels.iter().map(|p| f64::from(p[c])).sum::<f64>();
            2.0 * sum(1) - sum(0) - sum(2)
        };
        assert!(
            green(&made("--white-balance 6504K,60")) < green(&plain),
            "{line}: a greener light, a less green picture"
        );
    }
}

#[test]
fn unused_adjustments_change_no_byte_and_radiance_never_changes() {
    let folder = Folder::with_bracket();
    let nothing = "--white-balance as-shot --brightness 0 --contrast 0 --saturation 0 --shadows 0 --highlights 0";
    for tmo in ["natural", "mertens"] {
        folder.line(&format!("{MERGE} --tmo {tmo} -o a.exr -o a.jpg -o a.png")).done();
        folder.line(&format!("{MERGE} --tmo {tmo} -o b.exr -o b.jpg -o b.png {nothing}")).done();
        folder.line(&format!("{MERGE} --tmo {tmo} -o c.exr -o c.png --white-balance 6504K,0")).done();
        let all = "--white-balance auto --brightness 1 --contrast 20 --saturation 30 --shadows 40 --highlights -50";
        folder.line(&format!("{MERGE} --tmo {tmo} -o d.exr -o d.png {all}")).done();
        for (a, b) in
            [("a.exr", "b.exr"), ("a.jpg", "b.jpg"), ("a.png", "b.png"), ("a.png", "c.png"), ("a.exr", "d.exr")]
        {
            assert!(folder.bytes(a) == folder.bytes(b), "{tmo}: {a} {b}");
        }
        assert!(folder.bytes("a.png") != folder.bytes("d.png"), "{tmo}");
    }
}

/// The gain map is relative to the adjusted picture: the decoded radiance does not change.
#[test]
fn gain_map_is_made_for_the_adjusted_picture() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    let map = |options: &str| {
        folder.line(&format!("tonemap a.exr -o a.jpg -q --force {options}")).done();
        let bytes = folder.bytes("a.jpg");
        let second = bytes.windows(4).rposition(|w| w[..3] == [0xFF, 0xD8, 0xFF]).expect("a second picture");
        let map = image::load_from_memory(&bytes[second..]).expect("a JPEG").into_rgb8();
        map.pixels().map(|p| f64::from(p.0[1])).sum::<f64>() / f64::from(map.width() * map.height())
    };
    assert!((map("") - map("--shadows 100 --highlights -100")).abs() > 1.0);
}

#[test]
fn merge_and_tonemap_give_the_same_adjusted_picture_on_any_threads() {
    let folder = Folder::with_bracket();
    for white in ["auto", "150,150", "5000K,12"] {
        let all = format!("--white-balance {white} --brightness -0.4 --shadows 60 --highlights -60 --saturation 15");
        folder.line(&format!("{MERGE} -o a.exr --exr-type float -o a.tif --picture b.png {all} --threads 1")).done();
        folder.line(&format!("tonemap a.exr -o c.png -q --force {all} --threads 5")).done();
        assert!(codes(&folder, "b.png") == codes(&folder, "c.png"), "{white}");
    }
}

#[test]
fn estimated_white_is_reported_and_reproduces_the_picture() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    for white in ["auto", "spot:150,150"] {
        let run = folder.line(&format!("tonemap a.exr -o a.png --json --force --white-balance {white}")).done();
        let report: Value = serde_json::from_str(&run.stdout).expect("JSON");
        assert_eq!(report["adjust"]["white_balance"], white);
        let found = &report["white_balance"];
        let light = format!("{}K,{}", found["kelvin"], found["tint"]);
        folder.line(&format!("tonemap a.exr -o b.png -q --force --white-balance {light}")).done();
        assert!(codes(&folder, "a.png") == codes(&folder, "b.png"), "{white}: {light}");
        let run =
            folder.line(&format!("merge w2.jpg w3.jpg w4.jpg --align none --force -o c.png --white-balance {white}"));
        assert!(run.done().stderr.contains("--white-balance "), "{white}");
    }
}

#[test]
fn impossible_requests_are_errors_with_the_remedy() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    let before = folder.listing();
    for (options, said) in [
        ("-o b.exr --brightness 1", &["--brightness", "no picture is written", ".png"][..]),
        ("-o b.exr --white-balance auto", &["--white-balance", "no picture is written"]),
        ("-o b.png --brightness 6", &["--brightness", "-5 to 5"]),
        ("-o b.png --contrast nan", &["--contrast", "-100 to 100"]),
        ("-o b.png --shadows -101", &["--shadows", "-100 to 100"]),
        ("-o b.png --saturation much", &["--saturation", "much"]),
        ("-o b.png --white-balance 1500", &["--white-balance", "2000 to 25000 K"]),
        ("-o b.png --white-balance sunny", &["sunny", "`auto`", "`5500K`", "`1200,800`"]),
        ("-o b.png --white-balance 300,10", &["spot 300,10", "300 x 200 pixels"]),
    ] {
        for line in [MERGE, "tonemap a.exr", &format!("{MERGE} --tmo mertens")] {
            refused(&folder.line(&format!("{line} {options}")), said);
            assert_eq!(folder.listing(), before, "{line} {options}");
        }
    }
    for command in ["align", "inspect"] {
        refused(&folder.line(&format!("{command} w2.jpg w3.jpg --brightness 1")), &["--brightness"]);
    }
}

#[test]
fn picture_of_no_lights_colour_keeps_its_white_with_a_warning() {
    let folder = Folder::empty();
    let pixels = Plane::from_rows(60, 40, |_, row: &mut [[f32; 3]]| {
        row.iter_mut().enumerate().for_each(|(x, p)| *p = [0.02, 0.1 + x as f32, 0.01]);
    });
    let map = RadianceMap { pixels, primaries: Primaries::SRGB };
    let picture = DisplayImage { pixels: Plane::filled(60, 40, [0; 3]) };
    let options = write::Options::default();
    let files = write::write(&[folder.at("green.exr")], &map, &picture, &Metadata::default(), &options);
    write::commit(files.expect("radiance").into_iter().map(|w| w.file).collect(), false).expect("a name");
    let plain = folder.line("tonemap green.exr -o a.png -q").done();
    let run = folder.line("tonemap green.exr -o b.png --white-balance auto").done();
    assert!(run.stderr.contains("not the colour of a light source") && plain.stderr.is_empty(), "{}", run.stderr);
    assert!(codes(&folder, "a.png") == codes(&folder, "b.png"));
}

/// The position of a grey spot is that of a pixel before resizing; with a crop, it is relative to the corner of the
/// crop.
#[test]
fn spot_is_counted_from_the_corner_of_the_part_that_is_kept() {
    let folder = Folder::with_bracket();
    let light = |line: &str| {
        folder.line(&format!("{line} -q --force --report r.json")).done();
        let report: Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
        report["white_balance"].clone()
    };
    // What deghosting measures in the whole picture would depend on the crop.
    let merge = "merge w2.jpg w3.jpg w4.jpg --align none --deghost=off -o a.png";
    let whole = light(&format!("{merge} -C none --white-balance spot:150,150"));
    assert!(whole["kelvin"].is_number());
    assert_eq!(light(&format!("{merge} -C 50,40,200,160 --white-balance spot:100,110 --resize 50%")), whole);
}

#[test]
fn batch_adjusts_every_picture_and_its_plan_keeps_it() {
    let folder = Folder::empty();
    std::fs::create_dir(folder.at("in")).expect("a folder");
    for i in 2..=4 {
        folder.put(&format!("in/w{i}.jpg"), small_jpeg(i));
    }
    let batch = |options: &str| folder.line(&format!("batch in --by-folder --name result -q {options}"));
    batch("-d plain --formats png").done();
    batch("-d grey --formats png --saturation -100 --brightness -0.5").done();
    let [plain, grey] = ["plain/result.png", "grey/result.png"].map(|name| codes(&folder, name));
    assert!(tint(&plain).1 > 2.0 && tint(&grey).1 < 0.01 && at(&grey, 0.5) < at(&plain, 0.5) - 0.4);
    let plan = batch("-d planned --white-balance spot:20,30 --plan").done();
    assert!(plan.stdout.contains("--white-balance=spot:20,30"), "{}", plan.stdout);
    refused(&batch("-d none --formats exr --shadows 20"), &["--shadows", "no picture is written"]);
}
