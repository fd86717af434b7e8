//! Frames with local tone mapping by a phone, tested with the program.

use crate::support::Folder;
use image::{Rgb, RgbImage};
use std::io::Cursor;

/// Returns a frame of a dark room with a bright window, with an exposure `stops` longer than that of the middle frame,
/// as rendered by a camera or a phone. The phone brightens dark parts and darkens bright parts, up to a limit,
/// separately for the window and the room.
fn frame(stops: i32, is_phone: bool) -> Vec<u8> {
    let picture = RgbImage::from_fn(360, 240, |x, y| {
        let window = (200..300).contains(&x) && (60..160).contains(&y);
        let base = (f64::from(x) / 180.0 - 1.0).exp2() * if window { 6.0 } else { 0.1 } * f64::from(stops).exp2();
        let texture = (0.25 * (f64::from(x) / 9.0).sin() + 0.25 * (f64::from(y) / 7.0).cos()).exp2();
        let gain = if is_phone { (base / 0.18).powf(-0.55).clamp(0.25, 3.0) } else { 1.0 };
        let v = (base * texture * gain).min(1.0);
        let code = if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        // Noise of up to two code values, from a hash of the position.
        let noise = (x + 360 * y + stops.unsigned_abs()).wrapping_mul(0x9E37_79B9) >> 30;
        Rgb([(255.0 * code + f64::from(noise) - 1.0).clamp(0.0, 255.0) as u8; 3])
    });
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).expect("memory is enough");
    bytes.into_inner()
}

fn folder(is_phone: bool) -> Folder {
    let folder = Folder::empty();
    for (name, stops) in [("a.png", -2), ("b.png", 0), ("c.png", 2)] {
        folder.put(name, &frame(stops, is_phone));
    }
    folder
}

const MERGE: &str = "merge a.png b.png c.png -e -2,0,2 --reference b.png -o o.exr --force";

fn report(folder: &Folder) -> serde_json::Value {
    serde_json::from_slice(&folder.bytes("r.json")).expect("JSON")
}

#[test]
fn frames_of_a_phone_are_named_merged_with_a_gain_and_strict_exits_with_3() {
    let folder = folder(true);
    let run = folder.line(&format!("{MERGE} --report r.json"));
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stderr.contains("a.png, b.png, c.png: locally processed"), "{}", run.stderr);
    assert!(run.stderr.contains("frames     tone-mapped locally by the camera"), "{}", run.stderr);
    let local = report(&folder)["local_processing"].clone();
    assert_eq!(local["locally_processed"], true, "{local}");
    let frames = local["frames"].as_array().expect("a list");
    assert_eq!(
        (frames.len(), frames[0]["path"].as_str(), frames[1]["path"].as_str()),
        (2, Some("a.png"), Some("c.png"))
    );
    let gain = |i: usize| [0, 1].map(|k: usize| frames[i]["gain_stops"][k].as_f64().expect("a number"));
    // The longer frame was brightened less than the reference, the shorter one more.
    assert!(gain(1)[1] > 0.5 && gain(0)[0] < -0.5, "{local}");
    assert_eq!(folder.line(&format!("{MERGE} --strict")).code, 3);
    folder.line(&format!("{MERGE} --report r.html")).done();
    let html = folder.bytes("r.html");
    let html = String::from_utf8_lossy(&html);
    // The page has an overlay of the local processing of each frame except the reference.
    for words in [
        "Local gain",
        "class=\"over gain\"",
        "name=\"gain\"",
        "id=\"gain-0\"",
        "id=\"gain-2\"",
        "<dt>Phone processing</dt>",
    ] {
        assert!(html.contains(words), "{words}");
    }
    assert!(!html.contains("id=\"gain-1\""), "the reference has a gain");
}

#[test]
fn frames_of_a_camera_and_of_a_curve_that_the_user_states_are_merged_as_they_are() {
    let camera = folder(false);
    camera.line(&format!("{MERGE} --report r.json")).done();
    let local = report(&camera)["local_processing"].clone();
    assert_eq!((&local["locally_processed"], &local["expansion"]), (&false.into(), &1.0.into()), "{local}");
    let phone = folder(true);
    let run = phone.line(&format!("{MERGE} --response-model srgb --report r.json"));
    assert!(run.code == 0 && !run.stderr.contains("locally processed"), "{}", run.stderr);
    assert!(report(&phone)["local_processing"].is_null());
}

#[test]
fn response_of_a_phone_is_not_saved_and_that_of_a_camera_is() {
    let phone = folder(true);
    let response = "response a.png b.png c.png -e -2,0,2 --reference b.png -o c.json --force";
    for line in [format!("{MERGE} --save-response c.json"), response.to_owned()] {
        let run = phone.line(&line);
        assert_eq!(run.code, 1, "{}", run.stderr);
        assert!(run.stderr.contains("b.png: the camera changed parts of the frames"), "{}", run.stderr);
        assert!(!phone.at("c.json").exists() && !phone.at("o.exr").exists());
    }
    // A curve given by the user can be saved.
    phone.line(&format!("{MERGE} --response-model srgb --save-response c.json")).done();
    let camera = folder(false);
    camera.line(&format!("{MERGE} --save-response c.json")).done();
    assert!(camera.at("c.json").exists());
}
