//! `hdralign batch`: finding brackets, merging them, keeping results, and reporting.

mod again;
mod plan;
mod stopped;

use super::support::card::Card;
use super::support::{Folder, Run};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Writes `brackets` small brackets into two folders in `in`; returns their paths.
fn card(folder: &Folder, brackets: usize) -> Vec<Vec<PathBuf>> {
    let mut card = Card::new(150);
    for k in 0..brackets {
        card.folder = PathBuf::from(if k < 2 { "a" } else { "b" });
        card.brackets(1, 3, 2.0);
    }
    card.write(&folder.at("in"))
}

/// Returns the files in `out` with their contents, sorted by name, without reports and summaries.
fn results(folder: &Folder) -> Vec<(PathBuf, Vec<u8>)> {
    fn gather(folder: &Path, all: &mut Vec<(PathBuf, Vec<u8>)>) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                gather(&path, all);
            } else if !path.extension().is_some_and(|e| e == "json" || e == "csv") {
                let bytes = std::fs::read(&path).expect("a result");
                all.push((path, bytes));
            }
        }
    }
    let mut all = Vec::new();
    gather(&folder.at("out"), &mut all);
    all.sort();
    all
}

fn summary(folder: &Folder) -> Value {
    serde_json::from_slice(&folder.bytes("out/batch.json")).expect("JSON")
}

fn counts(folder: &Folder) -> [u64; 4] {
    let counts = &summary(folder)["counts"];
    ["done", "unchanged", "failed", "not_done"].map(|key| counts[key].as_u64().expect("a number"))
}

#[test]
fn simulated_card_is_merged() {
    let folder = Folder::empty();
    let paths = card(&folder, 3);
    let run = folder.line("batch in -d out").done();
    let expected = ["a/IMG_0001-IMG_0003", "a/IMG_0004-IMG_0006", "b/IMG_0007-IMG_0009"];
    let named: Vec<PathBuf> =
        expected.iter().flat_map(|n| ["exr", "png"].map(|e| folder.at(format!("out/{n}.{e}")))).collect();
    assert_eq!(run.stdout.lines().map(PathBuf::from).collect::<Vec<_>>(), named);
    assert_eq!(results(&folder).into_iter().map(|(path, _)| path).collect::<Vec<_>>(), named);
    assert_eq!(counts(&folder), [3, 0, 0, 0]);
    assert!(run.stderr.contains("3 done of 3") && run.stderr.contains("[3/3]"), "{}", run.stderr);

    // The results have the same bytes as those of a separate merge, and the report has the contents of the report of
    // `merge`.
    let inputs: Vec<&str> = paths[1].iter().map(|p| p.to_str().unwrap()).collect();
    folder.run([&["merge", "-o", "one.exr", "-o", "one.png", "--report", "one.json"], &inputs[..]].concat()).done();
    assert!(folder.bytes("one.exr") == folder.bytes("out/a/IMG_0004-IMG_0006.exr"));
    assert!(folder.bytes("one.png") == folder.bytes("out/a/IMG_0004-IMG_0006.png"));
    let report = |name: &str| serde_json::from_slice::<Value>(&folder.bytes(name)).unwrap();
    let (one, own) = (report("one.json"), report("out/a/IMG_0004-IMG_0006.json"));
    assert_eq!((&one["frames"], &one["schema"]), (&own["frames"], &own["schema"]));
    assert_eq!(own["step"]["outputs"][0]["bytes"], folder.bytes("one.exr").len());

    let rows = csv_rows(&folder);
    assert_eq!((rows.len(), rows[1].as_str()), (3, "a_IMG_0004-IMG_0006"));
}

/// Returns the ids in `batch.csv`.
fn csv_rows(folder: &Folder) -> Vec<String> {
    let table = String::from_utf8(folder.bytes("out/batch.csv")).expect("UTF-8");
    table.lines().skip(1).map(|line| line.split(',').next().unwrap_or_default().to_owned()).collect()
}

#[test]
fn dry_run_lists_the_brackets() {
    let folder = Folder::empty();
    let mut card = Card::new(96);
    card.brackets(2, 3, 2.0).single(0.0);
    card.write(&folder.at("in"));
    folder.put("in/notes.txt", b"x");
    let table = folder.line("batch in --dry-run -d out").done().stdout;
    assert!(table.contains("IMG_0001-IMG_0003") && table.contains("0 -2 +2"), "{table}");
    assert!(table.contains("in no bracket, 1 photograph") && table.contains("IMG_0007.JPG"), "{table}");
    assert!(
        table.contains("2 brackets of 6 photographs, 1 photograph in no bracket, 1 file of other kinds"),
        "{table}"
    );
    let json: Value = serde_json::from_str(&folder.line("batch in --dry-run --json").done().stdout).unwrap();
    assert_eq!(json["schema"], "hdralign-found/1");
    assert_eq!(json["brackets"][1]["photographs"][2], "in/IMG_0006.JPG");
    assert!(json["left_over"][0]["reason"].as_str().unwrap().contains("--gap"), "{json}");
    assert!(!folder.at("out").exists());
}

#[test]
fn missing_brackets_are_explained() {
    let folder = Folder::empty();
    std::fs::create_dir(folder.at("in")).unwrap();
    let nothing = |line: &str, said: &str| {
        let run = folder.line(line);
        assert!(run.code == 1 && run.stderr.contains(said) && run.stdout.is_empty(), "{run:?}");
    };
    nothing("batch in", "there are no photographs");
    let mut card = Card::new(96);
    card.has_exif = false;
    card.brackets(1, 3, 2.0);
    card.write(&folder.at("in"));
    nothing("batch in -d out", "--by-folder");
    nothing("batch nowhere", "nowhere");
    assert_eq!(folder.line("batch --name x").code, 2);
    // If the user groups the photographs, they are merged.
    folder.line("batch in -d out --by-folder -q").done();
    assert_eq!(counts(&folder), [1, 0, 0, 0]);
}

#[test]
fn results_have_the_requested_names_and_formats() {
    let folder = Folder::empty();
    card(&folder, 3);
    let run = folder.run([
        "batch",
        "in",
        "-d",
        "out",
        "--name",
        "{date}/{number}-{camera}",
        "--formats",
        "hdr,jpg",
        "--page",
    ]);
    let stdout = run.done().stdout;
    let first = "out/2026-09-19/0001-hdralign_Card_One";
    for extension in ["hdr", "jpg", "html", "json"] {
        assert!(folder.at(format!("{first}.{extension}")).is_file(), "{extension}: {stdout}");
    }
    assert_eq!(stdout.lines().count(), 9, "{stdout}");
    let wrong = |arguments: &[&str], said: &str| {
        let run = folder.run([&["batch", "in"], arguments].concat());
        assert!(run.code == 2 && run.stderr.contains(said), "{run:?}");
    };
    wrong(&["--name", "{lens}"], "{camera}");
    wrong(&["--name", "../{first}"], "contains `..`");
    wrong(&["--formats", "exr,gif"], "gif");
    wrong(&["--formats", "exr,exr"], "twice");
    wrong(&["--bracket", "1"], "at least 2 photographs");
    wrong(&["--gap=-3"], "--gap");
    wrong(&["--jobs", "0"], "--jobs");
    wrong(&["--normalize", "set", "--absolute"], "--normalize");
    assert!(folder.line("batch --name help").done().stdout.contains("{folder}"));
}

#[test]
fn unusable_bracket_does_not_stop_the_batch() {
    let folder = Folder::empty();
    let mut card = Card::new(150);
    card.brackets(1, 3, 2.0).brackets(1, 3, 2.0).last().is_truncated = true;
    card.brackets(1, 3, 2.0);
    card.write(&folder.at("in"));
    let run = folder.line("batch in -d out -q");
    assert_eq!(run.code, 3, "{run:?}");
    assert!(run.stderr.contains("IMG_0006.JPG") && run.stderr.contains("truncated"), "{}", run.stderr);
    assert_eq!(run.stdout.lines().count(), 4);
    assert_eq!(counts(&folder), [2, 0, 1, 0]);
    let failed = &summary(&folder)["steps"][1];
    assert!(
        failed["error"].as_str().unwrap().contains("IMG_0006.JPG") && failed["outputs"].as_array().unwrap().is_empty()
    );
    assert!(folder.at("out/IMG_0004-IMG_0006.failed.json").is_file());
    // The damaged photograph is copied again and now complete: its bracket is merged, and the others are unchanged.
    card.shots[5].is_truncated = false;
    card.write(&folder.at("in"));
    folder.line("batch in -d out").done();
    assert_eq!(counts(&folder), [1, 2, 0, 0]);
    assert!(!folder.at("out/IMG_0004-IMG_0006.failed.json").exists());
}

#[test]
fn one_response_is_recovered_for_a_camera() {
    let folder = Folder::empty();
    card(&folder, 3);
    let run = folder.line("batch in -d out --shared-response --formats exr").done();
    assert_eq!(counts(&folder), [4, 0, 0, 0]);
    assert!(run.stderr.contains("jobs       4 done of 4"), "{}", run.stderr);
    let response = "out/response-hdralign_Card_One.response.json";
    assert!(folder.at(response).is_file());
    let report: Value = serde_json::from_slice(&folder.bytes("out/b/IMG_0007-IMG_0009.json")).unwrap();
    assert_eq!(report["response"]["model"], "file");
    assert!(report["options"]["response_file"].as_str().unwrap().ends_with(response), "{report}");
    folder.line("batch in -d out --shared-response --formats exr").done();
    assert_eq!(counts(&folder), [0, 4, 0, 0]);
    // The curve that was recovered, given as a file, gives the same bytes.
    let shared = folder.bytes("out/a/IMG_0001-IMG_0003.exr");
    folder.run(["batch", "in", "-d", "given", "--response", response, "--formats", "exr"]).done();
    assert!(folder.bytes("given/a/IMG_0001-IMG_0003.exr") == shared);
}

#[test]
fn a_panorama_has_one_unit_of_radiance() {
    let folder = Folder::empty();
    let mut card = Card::new(150);
    card.bracket(&[0.0, -2.0, 2.0]).bracket(&[1.0, -1.0, 3.0]);
    card.write(&folder.at("in"));
    folder.line("batch in -d out --normalize all --formats exr").done();
    let unit = |name: &str| {
        let report: Value = serde_json::from_slice(&folder.bytes(name)).unwrap();
        let radiance = &report["radiance"];
        (radiance["unit_exposure_s"].as_f64(), radiance["reference_exposure"].as_f64())
    };
    let (first, second) = (unit("out/IMG_0001-IMG_0003.json"), unit("out/IMG_0004-IMG_0006.json"));
    assert_eq!(first.0, second.0);
    assert!(first.0.is_some() && first.1 != second.1, "{first:?} {second:?}");
}

/// Checks that a run failed, and returns its stderr without line breaks.
fn refused(run: Run) -> String {
    assert_ne!(run.code, 0, "{run:?}");
    run.stderr.split_whitespace().collect::<Vec<_>>().join(" ")
}
