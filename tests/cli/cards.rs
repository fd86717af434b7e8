//! The simulated cards of `tests/support/card.rs` are correct: another EXIF reader reads them, and the program merges
//! their brackets.

use super::support::Folder;
use super::support::card::{Camera, Card};
use exif::{In, Reader, Tag, Value};
use serde_json::Value as Json;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

fn field(path: &Path, tag: Tag) -> Option<String> {
    let bytes = fs::read(path).expect("a shot");
    let found = Reader::new().read_from_container(&mut std::io::Cursor::new(bytes)).expect("EXIF");
    found.get_field(tag, In::PRIMARY).map(|f| match &f.value {
        Value::Ascii(lines) => String::from_utf8(lines.concat()).expect("ASCII"),
        other => other.display_as(tag).to_string(),
    })
}

#[test]
fn simulated_card_has_the_metadata_of_a_camera() {
    let folder = Folder::empty();
    let mut card = Card::new(96);
    card.folder = "DCIM/100TEST".into();
    card.bracket(&[0.0, -2.0, 2.0]).pause(10_000);
    card.camera = Camera { has_sub_seconds: false, serial: "7".into(), ..Camera::default() };
    card.single(5.5).last().has_flash = true;
    let paths = card.write(folder.path());
    assert_eq!(paths.iter().map(Vec::len).collect::<Vec<_>>(), [3, 1]);
    assert_eq!(paths[0][2], folder.at("DCIM/100TEST/IMG_0003.JPG"));
    let all = |tag| paths.iter().flatten().map(|p| field(p, tag)).collect::<Vec<_>>();
    let texts = |t: [&str; 4]| t.map(|s| Some(s.to_owned())).to_vec();
    assert_eq!(all(Tag::ExposureTime), texts(["1/30", "1/125", "1/8", "1.414214"]));
    assert_eq!(all(Tag::ExposureBiasValue), texts(["0", "-2", "2", "0"]));
    assert_eq!(
        all(Tag::ExposureMode)[2..],
        texts(["auto bracket", "auto bracket", "auto bracket", "auto exposure"])[2..]
    );
    assert_eq!(all(Tag::BodySerialNumber), texts(["0815001", "0815001", "0815001", "7"]));
    // The exposures take 32 ms and 8 ms, and a pause of 180 ms follows each.
    assert_eq!(all(Tag::SubSecTimeOriginal)[..3], texts(["00", "21", "40", ""])[..3]);
    assert_eq!(all(Tag::SubSecTimeOriginal)[3], None);
    // 0.4 s until the third exposure, 125 ms for it, and pauses of 180 ms, 8 s (after a bracket) and 10 s (requested).
    assert_eq!(all(Tag::DateTimeOriginal)[3].as_deref(), Some("2026:09:19 17:42:18"));
}

/// The thumbnail in the EXIF is not mistaken for the photograph, and the exposures are read from the EXIF. As the steps
/// are two stops, the recorded times 1/125, 1/30 and 1/8 s are read as exact steps.
#[test]
fn a_cards_brackets_merge_and_no_two_are_alike() {
    let folder = Folder::empty();
    let mut card = Card::new(240);
    card.brackets(2, 3, 2.0);
    card.write(folder.path());
    let mut merged = BTreeSet::new();
    for names in ["IMG_0001.JPG IMG_0002.JPG IMG_0003.JPG", "IMG_0004.JPG IMG_0005.JPG IMG_0006.JPG"] {
        let run = folder.line(&format!("merge {names} -o out.hdr --force --json --strict")).done();
        let report: Json = serde_json::from_str(&run.stdout).expect("JSON");
        let exposures: Vec<f64> = report["frames"]
            .as_array()
            .expect("frames")
            .iter()
            .map(|f| f["relative_exposure"].as_f64().expect("a number"))
            .collect();
        assert_eq!(exposures.iter().map(|e| e / exposures[0]).collect::<Vec<_>>(), [1.0, 4.0, 16.0], "{report:#}");
        merged.insert(folder.bytes("out.hdr"));
    }
    assert_eq!(merged.len(), 2);
}

#[test]
fn a_truncated_shot_is_refused_by_name() {
    let folder = Folder::empty();
    let mut card = Card::new(240);
    card.brackets(1, 3, 2.0).last().is_truncated = true;
    card.write(folder.path());
    assert_eq!(field(&folder.at("IMG_0003.JPG"), Tag::ExposureTime).as_deref(), Some("1/8"));
    let run = folder.line("merge IMG_0001.JPG IMG_0002.JPG IMG_0003.JPG -o out.hdr");
    assert_eq!(run.code, 1, "{}", run.stderr);
    assert!(run.stderr.contains("IMG_0003.JPG"), "{}", run.stderr);
    assert!(!folder.at("out.hdr").exists());
}
