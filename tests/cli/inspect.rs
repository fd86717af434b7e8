//! `inspect`: the folder of tables and drawings is complete, or is not created.

use crate::support::{Folder, small_jpeg};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;

const KINDS: [&str; 10] = [
    "threshold.png",
    "exclusion.png",
    "keypoints.svg",
    "keypoints.png",
    "matches.svg",
    "matches.png",
    "xor.svg",
    "xor.png",
    "edges.svg",
    "edges.png",
];

/// Returns the names of the files in the folder `name`, including hidden ones.
fn names(folder: &Folder, name: &str) -> BTreeSet<String> {
    let entries = fs::read_dir(folder.at(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect()
}

#[test]
fn listed_files_are_complete_and_no_others_exist() {
    let folder = Folder::with_bracket();
    let run = folder.line("inspect w2.jpg w4.jpg w3.jpg --reference w3.jpg -d look").done();
    let listed: BTreeSet<String> = run.stdout.lines().map(|p| p.replacen("look/", "", 1)).collect();
    assert_eq!(listed, names(&folder, "look"));
    let mut expected: BTreeSet<String> = ["tables.txt", "tables.json"].map(String::from).into();
    for name in ["w2", "w3", "w4"] {
        // The reference is not compared with itself.
        expected.extend(KINDS[..if name == "w3" { 4 } else { 10 }].iter().map(|kind| format!("{name}.{kind}")));
    }
    assert_eq!(listed, expected);
    for name in listed.iter().filter(|n| n.ends_with(".png")) {
        let picture = image::open(folder.at(format!("look/{name}"))).unwrap_or_else(|e| panic!("{name}: {e}"));
        if name.ends_with("threshold.png") || name.ends_with("exclusion.png") {
            assert_eq!((picture.width(), picture.height()), (300, 200), "{name}");
            assert!(picture.to_luma8().pixels().all(|p| p[0] == 0 || p[0] == 255), "{name}");
        } else {
            // The PNG has the size that the SVG states.
            let svg = String::from_utf8(folder.bytes(&format!("look/{}", name.replace(".png", ".svg")))).expect("text");
            let size = format!("width=\"{}\" height=\"{}\"", picture.width(), picture.height());
            assert!(svg.contains(&size) && svg.ends_with("</svg>\n"), "{name}");
            assert!(
                !svg.contains("http://") || svg.matches("http://").count() == svg.matches("http://www.w3.org/").count()
            );
        }
    }
    let text = String::from_utf8(folder.bytes("look/tables.txt")).expect("text");
    assert!(run.stderr.contains(&text), "the tables are reported as well");
    for name in ["w2.jpg", "w3.jpg", "w4.jpg"] {
        assert_eq!(text.lines().filter(|l| l.starts_with(name)).count(), 8, "{text}");
    }
}

#[test]
fn json_is_the_tables_alone() {
    let folder = Folder::with_bracket();
    let run = folder.line("inspect w2.jpg w3.jpg w4.jpg -d look --json -q").done();
    let json: Value = serde_json::from_str(&run.stdout).expect("one JSON value");
    assert_eq!((run.stderr.as_str(), &json["schema"]), ("", &"hdralign-inspect/1".into()));
    assert_eq!(folder.bytes("look/tables.json"), run.stdout.as_bytes());
    let frames = json["frames"].as_array().expect("frames");
    assert_eq!(frames.len(), 3);
    let placed = frames.iter().filter(|f| f["alignment"]["status"] != "reference");
    for frame in placed {
        for detected in [&frame["features"], &frame["surf"]] {
            let merged = &detected["merged"];
            assert!(merged["keypoints"].as_u64() >= detected["plain"]["keypoints"].as_u64());
            assert!(merged["inliers"].as_u64() > Some(0), "{frame}");
        }
        let xor = &frame["mtb"]["xor"];
        assert!(xor["after_share"].as_f64() < xor["before_share"].as_f64(), "{frame}");
    }
    let outputs = json["outputs"].as_array().expect("outputs");
    assert!(
        outputs.len() == 2 + 4 + 2 * 10 && outputs.iter().all(|p| folder.at(p.as_str().expect("a path")).is_file())
    );
}

#[test]
fn the_folder_is_named_for_the_first_and_the_last_and_may_be_there() {
    let folder = Folder::with_bracket();
    fs::create_dir(folder.at("w2-w3.inspect")).expect("a folder");
    folder.put("w2-w3.inspect/notes.txt", b"mine");
    let run = folder.line("inspect w3.jpg w2.jpg -q").done();
    assert!(run.stderr.is_empty() && run.stdout.lines().all(|p| p.starts_with("w2-w3.inspect/")));
    assert_eq!(folder.bytes("w2-w3.inspect/notes.txt"), b"mine");
}

#[test]
fn existing_files_are_kept_unless_forced() {
    let folder = Folder::with_bracket();
    fs::create_dir(folder.at("look")).expect("a folder");
    folder.put("look/w2.xor.svg", b"old");
    let run = folder.line("inspect w2.jpg w3.jpg -d look");
    assert!(run.code == 1 && run.stdout.is_empty(), "{run:?}");
    assert!(
        run.stderr.contains("w2.xor.svg") && run.stderr.contains("--force") && run.stderr.contains("another name"),
        "{run:?}"
    );
    assert_eq!((names(&folder, "look").len(), folder.bytes("look/w2.xor.svg")), (1, b"old".to_vec()));
    folder.line("inspect w2.jpg w3.jpg -d look --force --reference w3.jpg").done();
    assert!(folder.bytes("look/w2.xor.svg").starts_with(b"<?xml"));
}

#[test]
fn failed_batches_leave_no_files() {
    let folder = Folder::with_bracket();
    fs::create_dir(folder.at("other")).expect("a folder");
    folder.put("other/w2.png", small_jpeg(3));
    let before = folder.listing();
    let cases = [
        ("inspect w2.jpg gone.jpg -d look", 1, "gone.jpg"),
        ("inspect w2.jpg w3.jpg -d none/look", 1, "mkdir"),
        ("inspect w2.jpg w3.jpg -d w4.jpg", 1, "-d"),
        ("inspect w2.jpg other/w2.png -d look", 2, "rename one"),
        ("inspect w2.jpg", 2, "at least two"),
        ("inspect w2.jpg w3.jpg --max-rotation 90", 2, "--max-rotation"),
        // Options of other commands, which would have no effect here.
        ("inspect w2.jpg w3.jpg --crop none", 2, "--crop"),
        ("inspect w2.jpg w3.jpg --report r.json", 2, "--report"),
    ];
    for (line, code, said) in cases {
        let run = folder.line(line);
        assert!(run.code == code && run.stdout.is_empty() && run.stderr.contains(said), "{line}: {run:?}");
        assert_eq!(folder.listing(), before, "{line}");
    }
}

#[test]
fn a_frame_of_something_else_is_drawn_and_degrades() {
    let folder = Folder::with_bracket();
    let mut state = 1u32;
    let noise = image::RgbImage::from_fn(300, 200, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        image::Rgb([(state >> 24) as u8; 3])
    });
    folder.put("noise.jpg", &crate::support::jpeg(&noise, Some(2)));
    let run = folder.line("inspect w3.jpg w4.jpg noise.jpg --reference w3.jpg -d look --strict");
    assert_eq!(run.code, 3, "{run:?}");
    assert!(run.stderr.contains("noise.jpg: rejected") && folder.at("look/noise.edges.png").is_file());
}

#[test]
fn the_same_bytes_on_one_thread_and_on_three() {
    let folder = Folder::with_bracket();
    for (threads, name) in [(1, "one"), (3, "three")] {
        folder.line(&format!("inspect w2.jpg w3.jpg w4.jpg -d {name} --threads {threads}")).done();
    }
    for name in names(&folder, "one").iter().filter(|n| *n != "tables.json") {
        assert!(folder.bytes(&format!("one/{name}")) == folder.bytes(&format!("three/{name}")), "{name}");
    }
}
