//! A batch with bad brackets among good ones: each bad one is reported, and none stops the others.

use super::*;
use image::imageops;
use std::fs;

/// The expected outcome for a folder.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Outcome {
    Done,
    Doubtful,
    Failed,
    /// The folder does not contain two photographs that belong together.
    LeftOver,
}
use Outcome::{Done, Doubtful, Failed, LeftOver};

/// Returns `picture` as a JPEG with the exposure time of frame `i`, 2 to 4: 1/128, 1/32 or 1/8 s.
fn dated(picture: &RgbImage, i: usize) -> Vec<u8> {
    timed(picture, 1, [128, 32, 8][i - 2])
}

fn night() -> Vec<(&'static str, Outcome, Vec<Vec<u8>>)> {
    let good = |i: usize| dated(&frame(i), i);
    let (black, pixel, mirrored) = (flat([0; 3]), RgbImage::new(1, 1), imageops::flip_horizontal(&frame(4)));
    vec![
        ("black", Doubtful, vec![dated(&black, 2), dated(&black, 3)]),
        ("copies", Doubtful, vec![good(3), good(3)]),
        ("cut", Failed, vec![good(2), good(3)[..9000].to_vec()]),
        ("first", Done, vec![good(2), good(3)]),
        ("last", Done, vec![good(3), good(4)]),
        ("mirrored", Doubtful, vec![good(2), good(3), dated(&mirrored, 4)]),
        ("pixel", Doubtful, vec![dated(&pixel, 2), dated(&pixel, 3)]),
        ("scenes", Failed, vec![good(2), dated(&elsewhere(3), 3)]),
        ("sizes", LeftOver, vec![good(2), dated(&imageops::rotate90(&frame(3)), 3)]),
        ("text", LeftOver, vec![good(2), b"a text".to_vec()]),
        ("unknown", Failed, vec![jpeg(&black, None), jpeg(&black, None)]),
    ]
}

/// Returns the number of files with `extension` in the folder `name`.
fn count(folder: &Folder, name: &str, extension: &str) -> usize {
    let Ok(entries) = fs::read_dir(folder.at(name)) else { return 0 };
    entries.filter(|e| e.as_ref().is_ok_and(|e| e.path().extension().is_some_and(|x| x == extension))).count()
}

#[test]
fn batch_with_bad_brackets_merges_the_good_ones_and_reports_each() {
    let folder = Folder::empty();
    let night = night();
    for (name, _, files) in &night {
        fs::create_dir_all(folder.at(format!("in/{name}"))).expect("a folder");
        for (file, bytes) in ["a", "b", "c"].iter().zip(files) {
            folder.put(&format!("in/{name}/{file}.jpg"), bytes);
        }
    }
    let run = folder.line("batch in -d out --by-folder");
    assert_eq!(run.code, 3, "{}", run.stderr);
    let summary: Value = serde_json::from_slice(&folder.bytes("out/batch.json")).expect("JSON");
    let steps = summary["steps"].as_array().expect("a list");
    let left_over = summary["left_over"].as_array().expect("a list");
    let table = String::from_utf8(folder.bytes("out/batch.csv")).expect("UTF-8");
    assert_eq!(table.lines().count(), 1 + steps.len());
    for (name, outcome, _) in &night {
        let step = steps.iter().find(|s| s["id"].as_str().is_some_and(|id| id.starts_with(&format!("{name}_"))));
        let line = table.lines().find(|line| line.starts_with(&format!("{name}_")));
        let files = ["exr", "png"].map(|extension| count(&folder, &format!("out/{name}"), extension));
        let Some(step) = step else {
            assert_eq!((*outcome, line, files), (LeftOver, None, [0, 0]), "{name}");
            let of_it =
                |entry: &&Value| entry["path"].as_str().is_some_and(|path| path.contains(&format!("in/{name}/")));
            assert_eq!(left_over.iter().filter(of_it).count(), 2, "{name}: {left_over:?}");
            continue;
        };
        let line = line.unwrap_or_else(|| panic!("{name} is not in {table}"));
        let is_done = matches!(outcome, Done | Doubtful);
        assert_eq!(step["status"], if is_done { "done" } else { "failed" }, "{step}");
        assert_eq!(step["degraded"], *outcome == Doubtful, "{step}");
        assert!(line.contains(if is_done { ",done," } else { ",failed," }), "{line}");
        assert_eq!(files, if is_done { [1, 1] } else { [0, 0] }, "{name}");
        // At the end, each failed or degraded bracket is listed with the reason.
        let reported = match outcome {
            Failed => step["error"]
                .as_str()
                .map(|error| format!("failed     {}: {error}", step["id"].as_str().expect("an id"))),
            Doubtful => Some(format!("degraded   {}: ", step["id"].as_str().expect("an id"))),
            _ => None,
        };
        assert!(
            reported.iter().all(|reported| run.stderr.contains(reported)),
            "{name}: {reported:?} is not in\n{}",
            run.stderr
        );
    }
    assert!(run.stderr.contains("in/text/b.jpg: is not a JPEG"), "{}", run.stderr);
    assert_eq!(night.iter().filter(|n| n.1 != LeftOver).count(), steps.len());
}
