//! Transforms given by the user: read from a file, excluded frames, and frames that did not move.

use crate::support::Folder;
use serde_json::Value;

fn report(stdout: &str) -> Value {
    serde_json::from_str(stdout).expect("a report")
}

fn frame<'a>(report: &'a Value, path: &str) -> &'a Value {
    let frames = report["frames"].as_array().expect("frames");
    frames.iter().find(|f| f["path"] == path).map(|f| &f["alignment"]).expect(path)
}

#[test]
fn transforms_are_written_once_and_taken_ever_after() {
    let folder = Folder::with_bracket();
    let found = folder.line("align w2.jpg w3.jpg w4.jpg --reference 2 --transforms t.json").done();
    assert_eq!(found.stdout, "t.json\n");
    let text = std::fs::read_to_string(folder.at("t.json")).expect("a file");
    let saved: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((&saved["schema"], &saved["reference"]), (&"hdralign-transforms/1".into(), &"w3.jpg".into()));
    // The result is exactly the one without the file; the reference is that of the file.
    folder.line("merge w2.jpg w3.jpg w4.jpg --reference 2 -o found.exr").done();
    let taken = folder.line("merge w2.jpg w3.jpg w4.jpg --transforms t.json -o taken.exr --json").done();
    assert!(std::fs::read(folder.at("found.exr")).unwrap() == std::fs::read(folder.at("taken.exr")).unwrap());
    let said = report(&taken.stdout);
    assert_eq!((&said["transforms_from"], &said["reference"]), (&"t.json".into(), &"w3.jpg".into()));
    // A transform that the user changed in the file is used, and --force does not replace the file.
    let mut moved = saved.clone();
    moved["frames"][0]["homography"] = serde_json::json!([1.0, 0.0, 12.5, 0.0, 1.0, -7.0, 0.0, 0.0, 1.0]);
    std::fs::write(folder.at("t.json"), moved.to_string()).unwrap();
    let used = folder.line("align w2.jpg w3.jpg w4.jpg --transforms t.json --force --json").done();
    assert_eq!(frame(&report(&used.stdout), "w2.jpg")["shift_px"], serde_json::json!([12.5, -7.0]));
    assert_eq!(std::fs::read_to_string(folder.at("t.json")).unwrap(), moved.to_string());
}

#[test]
fn transforms_of_other_photographs_are_refused() {
    let folder = Folder::with_bracket();
    folder.line("align w2.jpg w3.jpg w4.jpg --reference 2 --transforms t.json").done();
    let text = std::fs::read_to_string(folder.at("t.json")).unwrap();
    let before = folder.listing();
    for (file, changed, says) in [
        ("t.json", text.replace("\"width_px\": 300", "\"width_px\": 301"), "301x200"),
        ("t.json", text.replace("w3.jpg", "other.jpg"), "other photographs"),
        ("t.json", text.replace("w3.jpg", "w2.jpg"), "--reference w2.jpg"),
        ("t.json", text.replace("w2.jpg", "x.jpg").replace("w4.jpg", "y.jpg"), "none of these"),
        ("t.json", "nonsense".into(), "not a JSON object"),
    ] {
        folder.put(file, changed.as_bytes());
        let run = folder.line("merge w2.jpg w3.jpg w4.jpg --reference 2 --transforms t.json -o a.exr");
        assert!(run.code == 1 && run.stderr.contains("t.json") && run.stderr.contains(says), "{says}: {run:?}");
        folder.put(file, text.as_bytes());
        assert_eq!(folder.listing(), before);
    }
}

#[test]
fn frames_are_left_out_or_left_unmoved_by_name() {
    let folder = Folder::with_bracket();
    let run =
        folder.line("align w2.jpg w3.jpg w4.jpg --reference 2 --leave-out w2.jpg --unmoved w4.jpg --json --strict");
    assert_eq!(run.code, 0, "what was asked for does not degrade: {run:?}");
    let said = report(&run.stdout);
    let (out, still) = (frame(&said, "w2.jpg"), frame(&said, "w4.jpg"));
    assert_eq!((&out["status"], &out["homography"]), (&"rejected".into(), &Value::Null));
    assert_eq!((&still["status"], &still["confidence"]), (&"unmoved".into(), &1.0.into()));
    assert_eq!(said["crop"]["width_px"], 300, "what is left out does not narrow the crop");
    // An excluded frame is not selected as the reference; to choose it as the reference is an error.
    let automatic = folder.line("align w2.jpg w3.jpg w4.jpg --json").done();
    let best = report(&automatic.stdout)["reference"].as_str().expect("a name").to_owned();
    let without = folder.line(&format!("align w2.jpg w3.jpg w4.jpg --leave-out {best} --json")).done();
    assert_ne!(report(&without.stdout)["reference"], best.as_str());
    for (line, says) in [
        ("--reference w3.jpg --leave-out w3.jpg", "is the reference"),
        ("--leave-out nobody.jpg", "not among the photographs"),
        ("--unmoved nobody.jpg", "not among the photographs"),
    ] {
        let run = folder.line(&format!("align w2.jpg w3.jpg w4.jpg {line}"));
        assert!(run.code == 2 && run.stderr.contains(says), "{run:?}");
    }
}

/// Returns a folder with the small bracket and the file of its transforms `t.json`, in which `change` modified the
/// entry of `w2.jpg`.
fn with_place(change: impl Fn(&mut Value)) -> Folder {
    let folder = Folder::with_bracket();
    folder.line("align w2.jpg w3.jpg w4.jpg --reference 2 --transforms t.json").done();
    let mut saved: Value = serde_json::from_slice(&folder.bytes("t.json")).expect("JSON");
    let frames = saved["frames"].as_array_mut().expect("frames");
    change(frames.iter_mut().find(|f| f["file"] == "w2.jpg").expect("the frame"));
    folder.put("t.json", saved.to_string().as_bytes());
    folder
}

#[test]
fn small_overlap_is_a_warning_and_no_overlap_an_error() {
    let shifted = |dx: f64| {
        with_place(|frame| {
            frame["status"] = "aligned".into();
            frame["homography"] = serde_json::json!([1.0, 0.0, dx, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        })
    };
    for dx in [-250.0, 250.0] {
        let folder = shifted(dx);
        let run = folder.line("merge w2.jpg w3.jpg w4.jpg --transforms t.json -o a.exr --json --strict");
        assert_eq!(run.code, 3, "{run:?}");
        assert!(
            run.stderr.contains(
                "of the reference (this frame alone covers a rectangle of 17 %); exclude this frame with --leave-out"
            ),
            "{run:?}"
        );
        let width = report(&run.stdout)["crop"]["width_px"].as_u64().expect("a width");
        assert!((40..=50).contains(&width), "{width} of 50 pixels");
    }
    let folder = shifted(400.0);
    let before = folder.listing();
    let run = folder.line("merge w2.jpg w3.jpg w4.jpg --transforms t.json -o a.exr");
    assert!(
        run.code == 1 && run.stderr.contains("w2.jpg: the merged frames have no part of w3.jpg in common"),
        "{run:?}"
    );
    assert_eq!(folder.listing(), before);
}

#[test]
fn rejection_in_transforms_is_a_warning_unless_by_the_user() {
    // An entry as a user would write it, without a confidence.
    let folder = with_place(|frame| {
        *frame = serde_json::json!({ "file": "w2.jpg", "status": "rejected", "homography": null, "reason": "a bird" });
    });
    let run = folder.line("align w2.jpg w3.jpg w4.jpg --transforms t.json --json --strict");
    assert_eq!(run.code, 3, "{run:?}");
    assert!(run.stderr.contains("w2.jpg: rejected: a bird"), "{run:?}");
    assert_eq!(frame(&report(&run.stdout), "w2.jpg")["rejected_by"], "alignment");
    // Frames that the user excludes are recorded in the file, and stay excluded in later runs.
    let folder = Folder::with_bracket();
    let line = "align w2.jpg w3.jpg w4.jpg --reference 2 --transforms t.json --json --strict";
    for line in [&format!("{line} --leave-out w2.jpg"), line] {
        let run = folder.line(line).done();
        assert!(!run.stderr.contains("warning"), "{run:?}");
        let said = report(&run.stdout);
        let (out, placed) = (frame(&said, "w2.jpg"), frame(&said, "w4.jpg"));
        assert_eq!((&out["status"], &out["rejected_by"]), (&"rejected".into(), &"user".into()));
        assert_eq!(placed["rejected_by"], Value::Null);
    }
    let saved: Value = serde_json::from_slice(&folder.bytes("t.json")).expect("JSON");
    assert_eq!(saved["frames"][0]["rejected_by"], "user");
}
