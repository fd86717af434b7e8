//! Deghosting and flare, tested with the program.

use crate::support::{Folder, jpeg, small};
use image::Rgb;

#[test]
fn ghost_is_removed_and_shown_in_the_mask() {
    let folder = Folder::with_bracket();
    let mut painted = small(4);
    for (x, y) in (130..170).flat_map(|x| (80..120).map(move |y| (x, y))) {
        painted.put_pixel(x, y, Rgb([if (x + y) / 8 % 2 == 0 { 40 } else { 60 }; 3]));
    }
    folder.put("w4.jpg", &jpeg(&painted, Some(4)));
    let line = "merge w2.jpg w3.jpg w4.jpg --reference w3.jpg --crop none -o a.exr --ghost-mask m.png --report r.json";
    let run = folder.line(line).done();
    assert_eq!(run.stdout, "a.exr\nm.png\nr.json\n");
    assert!(run.stderr.contains("movement") && run.stderr.contains("in the middle; shown as in "), "{}", run.stderr);
    let mask = image::open(folder.at("m.png")).expect("a picture");
    assert_eq!((mask.color(), mask.width(), mask.height()), (image::ColorType::L8, 300, 200));
    let mask = mask.to_luma8();
    // In the square one of the two other frames is not used, so the mask is half of 255.
    assert!(mask.get_pixel(150, 100)[0] >= 127, "{}", mask.get_pixel(150, 100)[0]);
    let mut all: Vec<u8> = mask.pixels().map(|p| p[0]).collect();
    all.sort_unstable();
    assert_eq!(all[all.len() / 2], 0, "half of the picture is left out");
    let report: serde_json::Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    let frames = report["ghosts"]["frames"].as_array().expect("a list");
    assert_eq!((frames.len(), frames[1]["path"].as_str()), (2, Some("w4.jpg")));
    // The painted square is 2.7 % of the picture.
    assert!(frames[1]["ghost_fraction"].as_f64().expect("a number") > 0.02, "{frames:?}");
    assert_eq!(report["ghosts"]["strength"], 0.5);
    let region = &report["ghosts"]["regions"][0];
    let number = |key: &str| region[key].as_u64().expect("a number");
    assert!(number("x_px") <= 130 && number("x_px") + number("width_px") >= 170, "{region}");
    assert!(number("y_px") <= 80 && number("y_px") + number("height_px") >= 120, "{region}");
    assert!(report["flare"].is_null());
}

#[test]
fn flare_is_estimated_on_request() {
    let folder = Folder::with_bracket();
    folder.line("merge w2.jpg w3.jpg w4.jpg -o a.exr --flare --report r.json").done();
    let report: serde_json::Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    let share = report["flare"]["scattered_fraction"].as_f64().expect("a number");
    assert!((0.0..0.5).contains(&share), "{share}");
    assert_eq!(report["flare"]["falloff_exponent"].is_null(), share == 0.0);
    assert_eq!(report["ghosts"]["ghost_fraction"], 0.0);
}

#[test]
fn contradicting_options_are_rejected_before_any_work() {
    let folder = Folder::with_bracket();
    let before = folder.listing();
    for (options, said) in [
        ("--deghost=1.5", "--deghost"),
        ("--deghost=much", "--deghost"),
        ("--deghost=off --ghost-mask m.png", "--deghost"),
        ("--deghost off", "--deghost=off"),
        ("--deghost --ghost-mask m.jpg", ".png"),
    ] {
        let run = folder.line(&format!("merge w2.jpg w3.jpg -o a.exr {options}"));
        assert_eq!(run.code, 2, "{options}\n{}", run.stderr);
        assert!(run.stderr.contains(said), "{options}\n{}", run.stderr);
        assert_eq!(folder.listing(), before, "{options}");
    }
}

/// Returns the mean code value of the painted square in `picture`.
fn square(folder: &Folder, picture: &str) -> f64 {
    let picture = image::open(folder.at(picture)).expect("a picture").to_luma8();
    let pixels = (135..165).flat_map(|x| (85..115).map(move |y| (x, y)));
    pixels.map(|(x, y)| f64::from(picture.get_pixel(x, y)[0])).sum::<f64>() / 900.0
}

#[test]
fn ghosts_are_removed_for_every_operator_unless_off() {
    let folder = Folder::with_bracket();
    let mut painted = small(4);
    for (x, y) in (130..170).flat_map(|x| (80..120).map(move |y| (x, y))) {
        painted.put_pixel(x, y, Rgb([if (x + y) / 8 % 2 == 0 { 40 } else { 60 }; 3]));
    }
    for operator in ["natural", "mertens"] {
        let line = |name: &str, more: &str| {
            let line =
                format!("merge w2.jpg w3.jpg {name}.jpg --reference w3.jpg --align none --tmo {operator} {more}");
            folder.line(&format!("{line} -o {name}.png --force")).done();
            square(&folder, &format!("{name}.png"))
        };
        let clean = line("w4", "");
        folder.put("p4.jpg", &jpeg(&painted, Some(4)));
        let (found, ghostly) = (line("p4", ""), line("p4", "--deghost=off"));
        // Without the ghost, the square is merged from two of three frames, so it is nearly as without a ghost.
        assert!((found - clean).abs() < 0.25 * (ghostly - clean).abs(), "{operator}: {found} {ghostly} for {clean}");
        assert!((found - clean).abs() < 6.0, "{operator}: {found} for {clean}");
    }
}
