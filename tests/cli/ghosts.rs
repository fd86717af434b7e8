//! What moved, and the veil of flare, as the command line has them.

use crate::support::{Folder, jpeg, small};
use image::Rgb;

#[test]
fn what_one_frame_shows_is_left_out_and_the_mask_says_where() {
    let folder = Folder::with_bracket();
    let mut painted = small(4);
    for (x, y) in (130..170).flat_map(|x| (80..120).map(move |y| (x, y))) {
        painted.put_pixel(x, y, Rgb([if (x + y) / 8 % 2 == 0 { 40 } else { 60 }; 3]));
    }
    folder.put("w4.jpg", &jpeg(&painted, Some(4)));
    let line = "merge w2.jpg w3.jpg w4.jpg --reference w3.jpg --crop none -o a.exr --deghost --ghost-mask m.png --report r.json";
    assert_eq!(folder.line(line).done().stdout, "a.exr\nm.png\nr.json\n");
    let mask = image::open(folder.at("m.png")).expect("a picture");
    assert_eq!((mask.color(), mask.width(), mask.height()), (image::ColorType::L8, 300, 200));
    let mask = mask.to_luma8();
    // One of two others is left out: half of 255.
    assert!(mask.get_pixel(150, 100)[0] >= 127, "{}", mask.get_pixel(150, 100)[0]);
    let mut all: Vec<u8> = mask.pixels().map(|p| p[0]).collect();
    all.sort_unstable();
    assert_eq!(all[all.len() / 2], 0, "half of the picture is left out");
    let report: serde_json::Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    let frames = report["ghosts"]["frames"].as_array().expect("a list");
    assert_eq!((frames.len(), frames[1]["path"].as_str()), (2, Some("w4.jpg")));
    // The square is 2.7 % of the picture.
    assert!(frames[1]["ghost_fraction"].as_f64().expect("a number") > 0.02, "{frames:?}");
    assert_eq!(report["ghosts"]["strength"], 0.5);
    assert!(report["flare"].is_null());
}

#[test]
fn flare_is_sought_where_it_is_asked_for() {
    let folder = Folder::with_bracket();
    folder.line("merge w2.jpg w3.jpg w4.jpg -o a.exr --flare --report r.json").done();
    let report: serde_json::Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    let share = report["flare"]["scattered_fraction"].as_f64().expect("a number");
    assert!((0.0..0.5).contains(&share), "{share}");
    assert_eq!(report["flare"]["falloff_exponent"].is_null(), share == 0.0);
    assert!(report["ghosts"].is_null());
}

#[test]
fn what_makes_no_sense_is_refused_before_any_work() {
    let folder = Folder::with_bracket();
    let before = folder.listing();
    for (options, said) in [
        ("--deghost=1.5", "--deghost"),
        ("--deghost=much", "--deghost"),
        ("--ghost-mask m.png", "--deghost"),
        ("--deghost --ghost-mask m.jpg", ".png"),
    ] {
        let run = folder.line(&format!("merge w2.jpg w3.jpg -o a.exr {options}"));
        assert_eq!(run.code, 2, "{options}\n{}", run.stderr);
        assert!(run.stderr.contains(said), "{options}\n{}", run.stderr);
        assert_eq!(folder.listing(), before, "{options}");
    }
}
