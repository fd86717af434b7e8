//! `hdralign tonemap`: pictures of existing radiance maps.

use crate::support::{Folder, Run, small};
use hdralign::read::read;
use image::imageops::FilterType;
use serde_json::Value;

const MERGE: &str = "merge w2.jpg w3.jpg w4.jpg --align none -q";

fn refused(run: Run, code: i32, said: &str) {
    assert!(run.code == code && run.stderr.contains(said), "{run:?}");
}

#[test]
fn floats_give_the_picture_that_merge_gave_to_the_code() {
    let folder = Folder::with_bracket();
    for (file, options) in [
        ("a.exr", "--exr-type float --exr-compression zip"),
        ("b.exr", "--exr-type float --colour rec2020"),
        ("c.tif", "--colour adobe-rgb"),
        ("d.tif", "--absolute"),
    ] {
        folder.line(&format!("{MERGE} {options} -o {file} -o merged.png --force")).done();
        let run = folder.line(&format!("tonemap {file} -o again.png --force")).done();
        assert_eq!(run.stdout, "again.png\n");
        // Only pixels are compared: the radiance map has only the most important capture data, so the bytes of the
        // files differ.
        let codes = |name: &str| image::open(folder.at(name)).expect("a picture").to_rgb8();
        assert!(codes("merged.png") == codes("again.png"), "{file} {options}");
    }
}

#[test]
fn every_format_gives_nearly_the_same_picture() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr -o a.png --exr-type float")).done();
    let picture = |name: &str| image::open(folder.at(name)).expect("a picture").to_rgb8();
    let expected = picture("a.png");
    // The coarsest encoding, LogLuv24, has steps of 1.1 % of luminance and 0.0035 in u' and v': some code values in
    // dark, saturated parts.
    for (file, options, most) in [
        ("h.exr", "--exr-type half", 1),
        ("r.hdr", "", 3),
        ("x.hdr", "--hdr-encoding xyze", 6),
        ("t.tif", "", 0),
        ("l32.tif", "--tiff-encoding logluv32", 6),
        ("l24.tif", "--tiff-encoding logluv24", 9),
    ] {
        folder.line(&format!("tonemap a.exr -o {file} {options} -q")).done();
        folder.line(&format!("tonemap {file} -o p.png --force -q")).done();
        let found = picture("p.png");
        let differences: Vec<u8> = expected.as_raw().iter().zip(found.as_raw()).map(|(a, b)| a.abs_diff(*b)).collect();
        let mean = differences.iter().map(|&d| f64::from(d)).sum::<f64>() / differences.len() as f64;
        let far = differences.iter().filter(|&&d| d > most).count();
        assert!(mean < 0.8 && far * 500 <= differences.len(), "{file}: mean {mean}, {far} beyond {most}");
    }
}

#[test]
fn temporary_folder_is_named_reported_and_kept() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o room.exr")).done();
    let run = folder.line("tonemap room.exr").done();
    assert_eq!(run.stdout, "room.png\n");
    assert!(run.stderr.contains("300 x 200 pixels"), "{}", run.stderr);
    refused(folder.line("tonemap room.exr"), 1, "--force");
    let run = folder.line("tonemap room.exr --force --json -q").done();
    let json: Value = serde_json::from_str(&run.stdout).expect("JSON alone");
    assert_eq!((&json["schema"], &json["outputs"][0]), (&"hdralign-tonemap/1".into(), &"room.png".into()));
    assert_eq!((&json["width_px"], &json["colour"]["space"]), (&300.into(), &"srgb".into()));
    assert_eq!((&json["radiance"]["unit"], &json["negative_pixels"]), (&"relative".into(), &0.into()));
    assert_eq!(run.stderr, "");
}

#[test]
fn files_without_radiance_are_rejected_with_the_remedy() {
    let folder = Folder::with_bracket();
    let before = folder.listing();
    refused(folder.line("tonemap w1.jpg -o x.png"), 1, "hdralign merge");
    refused(folder.line("tonemap gone.exr"), 1, "gone.exr");
    // The default name of the result would be that of the input, but the error must be about the content of the input.
    folder.put("photo.png", b"\x89PNG\r\n\x1a\n and so on");
    refused(folder.line("tonemap photo.png"), 1, "photo.png: is a PNG picture, not a radiance map");
    std::fs::remove_file(folder.at("photo.png")).unwrap();
    refused(folder.line("tonemap w1.jpg -o x.bmp"), 2, ".png");
    folder.line(&format!("{MERGE} -o room.exr")).done();
    let whole = folder.bytes("room.exr");
    folder.put("cut.exr", &whole[..whole.len() / 2]);
    refused(folder.line("tonemap cut.exr"), 1, "cut.exr: cannot be decoded as OpenEXR");
    refused(folder.line("tonemap room.exr -o room.exr --force"), 2, "another name");
    std::fs::remove_file(folder.at("room.exr")).and_then(|()| std::fs::remove_file(folder.at("cut.exr"))).unwrap();
    assert_eq!(folder.listing(), before, "nothing is left behind");
}

/// A map of another program contains NaN, infinity and a colour outside of sRGB.
#[test]
fn invalid_values_are_reported_and_the_others_shown() {
    let folder = Folder::empty();
    let mut values = vec![0.5f32; 3 * 64];
    values[0] = f32::NAN;
    values[4] = f32::INFINITY;
    values[6] = -0.25;
    let layer = exr::prelude::SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
        let i = 3 * (at.y() * 8 + at.x());
        (values[i], values[i + 1], values[i + 2])
    });
    use exr::prelude::WritableImage;
    exr::prelude::Image::from_channels((8, 8), layer).write().to_file(folder.at("odd.exr")).unwrap();
    // reinhard02 applies one curve to all pixels, so that equal values stay equal.
    let run = folder.line("tonemap odd.exr --tmo reinhard02 --json").done();
    let json: Value = serde_json::from_str(&run.stdout).unwrap();
    let counts = ["not_number_pixels", "infinite_pixels", "negative_pixels"].map(|key| json[key].clone());
    assert_eq!(counts, [Value::from(1), 1.into(), 1.into()]);
    assert_eq!(run.stderr.matches("warning: odd.exr: 1 pixels").count(), 3, "{}", run.stderr);
    let picture = image::open(folder.at("odd.png")).unwrap().to_rgb8();
    assert_eq!(picture.get_pixel(0, 0).0, [0; 3]);
    // The infinite value is shown as the largest finite value, which is the grey around it.
    assert!(picture.get_pixel(5, 5).0 != [0; 3] && picture.get_pixel(1, 0) == picture.get_pixel(5, 5));
    // `read` returns the values as they are in the file.
    assert!(read(&folder.at("odd.exr")).unwrap().0.pixels.at(0, 0)[0].is_nan());
}

#[test]
fn every_operator_has_its_look_and_its_settings() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o room.exr")).done();
    let mut seen = Vec::new();
    for name in ["natural", "reinhard02", "reinhard02-local", "drago", "durand", "fattal", "mantiuk06", "mantiuk08"] {
        folder.line(&format!("tonemap room.exr --tmo {name} -o a.png --force -q")).done();
        folder.line(&format!("tonemap room.exr --tmo {name} --tmo-set saturation=0 -o grey.png --force -q")).done();
        let grey = image::open(folder.at("grey.png")).expect("a picture").to_rgb8();
        assert!(grey.pixels().all(|p| p.0[0] == p.0[1] && p.0[1] == p.0[2]), "{name} without colour");
        let bytes = folder.bytes("a.png");
        assert!(!seen.contains(&bytes), "{name} is another's picture");
        seen.push(bytes);
        // Parameters are listed with their ranges; values out of range are rejected by name.
        let help = folder.line(&format!("tonemap room.exr --tmo {name} --tmo-set help"));
        assert!(help.code == 0 && help.stdout.contains(name) && help.stdout.contains("saturation="), "{help:?}");
        refused(folder.line(&format!("tonemap room.exr --tmo {name} --tmo-set colour=1")), 2, "has no `colour`");
    }
    // Fusion needs the frames: it is not listed, but refused with a reason.
    assert!(!folder.line("tonemap -h").done().stdout.contains("mertens"));
    refused(folder.line("tonemap room.exr --tmo mertens -o fused.png"), 2, "hdralign merge --tmo mertens");
    // Neither a radiance map nor photographs are needed to list the parameters.
    let help = folder.line("tonemap room.exr --tmo drago --tmo-set help").done();
    for line in
        ["tonemap --tmo drago --tmo-set help", "merge --tmo-set help --tmo drago", "batch --tmo=drago --tmo-set=help"]
    {
        assert_eq!(folder.line(line).done().stdout, help.stdout, "{line}");
    }
    refused(folder.line("align --tmo-set help"), 2, "--tmo-set");
    refused(folder.line("tonemap room.exr --tmo-set brightness=7"), 2, "from 0.1 to 0.9");
    refused(folder.line("tonemap room.exr --tmo-set brightness"), 2, "KEY=VALUE");
    refused(folder.line("tonemap room.exr --tmo-set brightness=much"), 2, "is not a number");
    refused(folder.line("tonemap room.exr --tmo mertens"), 2, "merge --tmo mertens");
}

#[test]
fn fusion_is_of_the_frames_and_needs_room() {
    let folder = Folder::with_bracket();
    let merge = MERGE.replace(" -q", "");
    let run = folder.line(&format!("{merge} --tmo mertens --flare -o fused.png -o room.exr")).done();
    assert!(run.stderr.contains("--flare acts on the radiance"), "{}", run.stderr);
    folder.line("tonemap room.exr -o toned.png -q").done();
    assert!(folder.bytes("fused.png") != folder.bytes("toned.png"));
    // Fusion of these frames needs 48 bytes per pixel, 72 MB, which is more than the smallest allowed limit.
    for i in 2..=3 {
        image::imageops::resize(&small(i), 1500, 1000, FilterType::Nearest)
            .save(folder.at(format!("large{i}.png")))
            .unwrap();
    }
    let large = "merge -e=0,2 large2.png large3.png --align none -q --tmo mertens --max-memory 64MB -o no.png";
    refused(folder.line(large), 2, "MB at least, and 64 MB are allowed");
}
