//! Repeated batches: complete results are kept, and files of other owners are not changed.

use super::{card, counts, refused, results};
use crate::support::Folder;
use crate::support::card::Card;
use std::fs;
use std::path::Path;

#[test]
fn unchanged_brackets_are_recognised_by_hash() {
    let folder = Folder::empty();
    let paths = card(&folder, 3);
    folder.line("batch in -d out -q").done();
    let first = results(&folder);
    // A photograph gets another date, with the same bytes.
    let copied = fs::read(&paths[0][0]).unwrap();
    fs::write(&paths[0][0], copied).unwrap();
    folder.line("batch in -d out -q").done();
    assert_eq!(counts(&folder), [0, 3, 0, 0]);
    // One photograph gets other bytes: only its bracket is merged again.
    let mut bytes = fs::read(&paths[1][0]).unwrap();
    bytes.extend(b"behind the picture");
    fs::write(&paths[1][0], bytes).unwrap();
    folder.line("batch in -d out -q").done();
    assert_eq!(counts(&folder), [1, 2, 0, 0]);
    // With another option all brackets are merged again, and the new results replace the previous ones.
    folder.line("batch in -d out -q --weight gaussian").done();
    assert_eq!(counts(&folder), [3, 0, 0, 0]);
    assert!(results(&folder) != first);
    // With --force all brackets are merged again.
    folder.line("batch in -d out -q --weight gaussian --force").done();
    assert_eq!(counts(&folder), [3, 0, 0, 0]);
    // Options for resources do not affect the results.
    folder.line("batch in -d out -q --weight gaussian --jobs 1 --threads 1 --max-memory 100MB").done();
    assert_eq!(counts(&folder), [0, 3, 0, 0]);
}

#[test]
fn a_result_that_somebody_changed_is_kept() {
    let folder = Folder::empty();
    card(&folder, 2);
    folder.line("batch in -d out -q").done();
    let picture = "out/a/IMG_0001-IMG_0003.png";
    folder.put(picture, b"retouched");
    folder.line("batch in -d out -q").done();
    assert_eq!(counts(&folder), [0, 2, 0, 0]);
    let said = refused(folder.line("batch in -d out -q --weight gaussian"));
    assert!(said.contains("IMG_0001-IMG_0003.png: was changed since") && said.contains("--force"), "{said}");
    assert_eq!(counts(&folder), [1, 0, 1, 0]);
    assert_eq!(folder.bytes(picture), b"retouched");
    folder.line("batch in -d out -q --weight gaussian --force").done();
    assert_ne!(folder.bytes(picture), b"retouched");
}

#[test]
fn a_response_file_with_the_name_of_a_report_is_kept() {
    let folder = Folder::empty();
    card(&folder, 1);
    let report = "out/a/IMG_0001-IMG_0003.json";
    fs::create_dir_all(folder.at("out/a")).unwrap();
    let photographs = "in/a/IMG_0001.JPG in/a/IMG_0002.JPG in/a/IMG_0003.JPG";
    folder.line(&format!("response {photographs} -o {report} -q")).done();
    let response = folder.bytes(report);
    let said = refused(folder.line(&format!("batch in -d out -q --response {report} --force")));
    assert!(said.contains("IMG_0001-IMG_0003.json"), "{said}");
    assert_eq!(folder.bytes(report), response);
}

/// After a card is formatted, the camera starts with IMG_0001 again.
#[test]
fn photographs_of_the_same_names_do_not_take_the_place_of_others() {
    let folder = Folder::empty();
    let mut card = Card::new(150);
    card.brackets(1, 3, 2.0).write(&folder.at("in"));
    folder.line("batch in -d out -q").done();
    let first = results(&folder);
    card.shots.iter_mut().for_each(|shot| shot.view = 7);
    card.write(&folder.at("in"));
    let said = refused(folder.line("batch in -d out -q"));
    assert!(said.contains("other photographs") && said.contains("{date}"), "{said}");
    assert!(results(&folder) == first);
    folder.line("batch in -d out -q --force").done();
    assert!(results(&folder) != first);
}

/// A bracket with a damaged frame is merged without this frame, but does not replace the result of the complete
/// bracket.
#[test]
fn a_damaged_frame_does_not_make_a_good_result_worse() {
    let folder = Folder::empty();
    let paths = card(&folder, 2);
    folder.line("batch in -d out -q").done();
    let first = results(&folder);
    fs::write(&paths[0][1], b"").unwrap();
    let run = folder.line("batch in -d out");
    assert_eq!(run.code, 3, "{run:?}");
    let said = run.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("unreadable") && said.contains("IMG_0002.JPG, which exists"), "{said}");
    assert!(results(&folder) == first);
    // If the damaged photograph is removed, the bracket without it is merged.
    fs::remove_file(&paths[0][1]).unwrap();
    folder.line("batch in -d out -q").done();
    assert_eq!(counts(&folder), [1, 1, 0, 0]);
}

#[test]
fn a_file_that_was_there_before_is_kept() {
    let folder = Folder::empty();
    card(&folder, 2);
    fs::create_dir_all(folder.at("out/a")).unwrap();
    for name in ["out/a/IMG_0001-IMG_0003.exr", "out/a/IMG_0004-IMG_0006.json"] {
        folder.put(name, b"{}");
    }
    let said = refused(folder.line("batch in -d out -q"));
    assert!(said.contains("IMG_0003.exr: exists already") && said.contains("IMG_0006.json: exists already"), "{said}");
    assert_eq!(folder.bytes("out/a/IMG_0001-IMG_0003.exr"), b"{}");
    assert_eq!(folder.bytes("out/a/IMG_0004-IMG_0006.json"), b"{}");
}

/// A user may have files with the names of summaries.
#[test]
fn summary_of_somebody_else_is_kept_and_the_batch_fails() {
    let folder = Folder::empty();
    card(&folder, 1);
    let plan = folder.line("batch --plan in -d out").done().stdout;
    folder.put("plan.jsonl", plan.as_bytes());
    fs::create_dir(folder.at("out")).unwrap();
    for (name, text) in
        [("out/batch.json", "{\"schema\": \"mine\"}"), ("out/batch.json", "no JSON"), ("out/batch.csv", "a,b\n")]
    {
        folder.put(name, text.as_bytes());
        for line in ["batch in -d out -q", "batch --summarize plan.jsonl"] {
            let run = folder.line(line);
            assert!(run.code == 1 && run.stdout.is_empty(), "{run:?}");
            let said = refused(run);
            assert!(
                said.contains(&format!("{name}: cannot be written")) && said.contains("may not have written it"),
                "{said}"
            );
            assert!(!said.contains("the free disk space"), "{said}");
            assert_eq!(folder.bytes(name), text.as_bytes());
            assert_eq!(fs::read_dir(folder.at("out")).unwrap().count(), 1, "{line}: work was done");
        }
        fs::remove_file(folder.at(name)).unwrap();
    }
    folder.put("out/batch.csv", b"mine");
    folder.line("batch in -d out -q --force").done();
    assert_eq!(counts(&folder), [1, 0, 0, 0]);
    // Now both summary files were written by hdralign, and are replaced.
    folder.line("batch in -d out -q").done();
    assert_eq!(counts(&folder), [0, 1, 0, 0]);
}

#[test]
fn failure_note_of_somebody_else_is_kept() {
    let folder = Folder::empty();
    let paths = card(&folder, 1);
    let bytes = fs::read(&paths[0][1]).unwrap();
    fs::write(&paths[0][1], &bytes[..bytes.len() / 2]).unwrap();
    fs::create_dir_all(folder.at("out/a")).unwrap();
    let note = "out/a/IMG_0001-IMG_0003.failed.json";
    folder.put(note, b"mine");
    refused(folder.line("batch in -d out -q"));
    assert_eq!(folder.bytes(note), b"mine");
    fs::remove_file(folder.at(note)).unwrap();
    for _ in 0..2 {
        refused(folder.line("batch in -d out -q"));
        assert!(String::from_utf8(folder.bytes(note)).unwrap().contains("hdralign-failure/1"));
    }
}

#[test]
fn bracket_with_the_name_of_the_summary_gets_another() {
    let folder = Folder::empty();
    card(&folder, 1);
    for expected in [[1, 0, 0, 0], [0, 1, 0, 0]] {
        let run = folder.line("batch in -d out -q --name batch --formats png").done();
        assert!(run.stdout.ends_with("out/batch-2.png\n"), "{run:?}");
        assert_eq!(counts(&folder), expected);
    }
}

/// After a kill between two renames, a job has a report and only some results: the next run recognises them as its own
/// and completes them.
#[test]
fn interrupted_batch_is_completed_by_the_next_run() {
    let folder = Folder::empty();
    card(&folder, 1);
    let name = |extension: &str| format!("out/a/IMG_0001-IMG_0003.{extension}");
    folder.line("batch in -d out -q").done();
    let first = results(&folder);
    fs::remove_file(folder.at(name("png"))).unwrap();
    fs::write(folder.at("out/a/.hdralign-killedkilled-0.part"), b"x").unwrap();
    fs::write(folder.at("out/a/.hdralign-killedkilled.lock"), include_bytes!("../../support/claim.txt")).unwrap();
    folder.line("batch in -d out -q").done();
    assert_eq!(counts(&folder), [1, 0, 0, 0]);
    assert!(results(&folder) == first, "the rest of the killed run is taken away");

    // State after a kill of a second run with other options, when only its report was renamed: the results are still
    // those of the first run.
    folder.line("batch in -d out -q --weight gaussian").done();
    let (second, report) = (results(&folder), folder.bytes(&name("json")));
    for (path, bytes) in &first {
        fs::write(path, bytes).unwrap();
    }
    folder.line("batch in -d out -q --weight gaussian").done();
    assert!(results(&folder) == second);
    assert_eq!(counts(&folder), [1, 0, 0, 0]);
    assert!(report != folder.bytes(&name("json")), "it has another time");
}

/// Results beside the photographs are not used as photographs in the next run.
#[test]
fn results_beside_the_photographs_are_not_taken_for_some() {
    let folder = Folder::empty();
    card(&folder, 2);
    let batch = |options: &str| {
        folder.line(&format!("batch in -q --formats exr,png,jpg,tif {options}")).done();
        let summary: serde_json::Value = serde_json::from_slice(&folder.bytes("in/batch.json")).unwrap();
        let counts = &summary["counts"];
        let reasons = summary["left_over"].as_array().unwrap().clone();
        (counts["done"].as_u64(), counts["unchanged"].as_u64(), reasons)
    };
    assert_eq!(batch(""), (Some(2), Some(0), vec![]));
    // A folder for results is not searched, unless it is given as a folder to search.
    for options in ["", "-d in", "-d a/../in/."] {
        fs::create_dir_all(folder.at("a")).unwrap();
        let (done, unchanged, reasons) = batch(options);
        assert_eq!((done, unchanged), (Some(0), Some(2)), "{options}");
        assert_eq!(reasons.len(), 6, "{options}: {reasons:?}");
        assert!(reasons.iter().all(|l| l["reason"].as_str().unwrap().contains("a result")), "{reasons:?}");
    }
    assert!(Path::new(&folder.at("in/a/IMG_0001-IMG_0003.jpg")).is_file());
}
