//! The report is a public format: its keys, their types and their meaning.

use crate::support::Folder;
use serde_json::Value;

fn written(folder: &Folder, line: &str) -> Value {
    folder.line(&format!("{line} --report r.json --force")).done();
    serde_json::from_slice(&folder.bytes("r.json")).expect("JSON")
}

fn number(v: &Value, key: &str) -> f64 {
    v[key].as_f64().unwrap_or_else(|| panic!("{key} is no number: {}", v[key]))
}

fn text<'a>(v: &'a Value, key: &str) -> &'a str {
    v[key].as_str().unwrap_or_else(|| panic!("{key} is no text: {}", v[key]))
}

fn keys(v: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = v.as_object().expect("an object").keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

/// Checks that `v` has the keys `wanted`; it may have others, because keys may be added to the format.
fn assert_has(v: &Value, wanted: &[&str]) {
    for key in wanted {
        assert!(keys(v).contains(key), "{key} is missing among {:?}", keys(v));
    }
}

fn check_alignment(a: &Value) {
    assert_has(
        a,
        &[
            "status",
            "model",
            "homography",
            "shift_px",
            "rotation_deg",
            "inliers",
            "keypoints",
            "error_px",
            "confidence",
        ],
    );
    let status = text(a, "status");
    assert!(["reference", "aligned", "unmoved", "assumed", "rejected"].contains(&status), "{status}");
    assert!((0.0..=1.0).contains(&number(a, "confidence")));
    assert!(a["inliers"].is_null() || a["inliers"].is_u64());
    if !a["keypoints"].is_null() {
        assert!(["plain", "mtb", "merged"].iter().all(|k| a["keypoints"][*k].is_u64()), "{}", a["keypoints"]);
    }
    if status == "rejected" {
        assert!(["homography", "model", "shift_px", "rotation_deg"].iter().all(|k| a[*k].is_null()), "{a}");
        return;
    }
    assert!(["unmoved", "shift", "rigid", "homography"].contains(&text(a, "model")));
    let nine: Vec<f64> =
        a["homography"].as_array().expect("a list").iter().map(|n| n.as_f64().expect("a number")).collect();
    assert_eq!(nine.len(), 9);
    assert_eq!(nine[8], 1.0);
    let still = nine == [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    assert_eq!(still, status != "aligned", "{status}: {nine:?}");
    let shift: Vec<f64> =
        a["shift_px"].as_array().expect("a list").iter().map(|n| n.as_f64().expect("a number")).collect();
    assert_eq!(shift.len(), 2);
    // The centre of a 300 x 200 picture is moved by the homography (nine numbers by rows) by the shift.
    let (x, y) = (149.5, 99.5);
    let w = nine[6] * x + nine[7] * y + nine[8];
    assert!(((nine[0] * x + nine[1] * y + nine[2]) / w - x - shift[0]).abs() < 1e-9);
    assert!(((nine[3] * x + nine[4] * y + nine[5]) / w - y - shift[1]).abs() < 1e-9);
    assert!(number(a, "rotation_deg").abs() < 10.0);
    assert!(a["error_px"].is_null() || number(a, "error_px") >= 0.0);
}

#[test]
fn a_merge_reports_every_key_of_the_contract() {
    let folder = Folder::with_bracket();
    let report = written(&folder, "merge w2.jpg w4.jpg w3.jpg --reference w3.jpg -o a.exr -o a.png");
    assert_has(
        &report,
        &["schema", "reference", "frames", "crop", "response", "radiance", "outputs", "warnings", "time_s"],
    );
    assert_eq!(report["schema"], "hdralign-report/1");
    assert_eq!(report["reference"], "w3.jpg");
    assert_eq!((number(&report, "width_px"), number(&report, "height_px")), (300.0, 200.0));
    let frames = report["frames"].as_array().expect("a list");
    assert_eq!(frames.iter().map(|f| text(f, "path")).collect::<Vec<_>>(), ["w2.jpg", "w3.jpg", "w4.jpg"]);
    for (frame, seconds) in frames.iter().zip([1.0 / 128.0, 1.0 / 32.0, 1.0 / 8.0]) {
        assert_eq!(number(frame, "time_s"), seconds);
        assert_eq!((number(frame, "f_number"), number(frame, "iso")), (8.0, 100.0));
        // t * ISO / N^2.
        assert!((number(frame, "relative_exposure") / (seconds * 100.0 / 64.0) - 1.0).abs() < 1e-12);
        assert_eq!(text(frame, "exposure_source"), "exif");
        check_alignment(&frame["alignment"]);
    }
    let statuses: Vec<&str> = frames.iter().map(|f| text(&f["alignment"], "status")).collect();
    assert_eq!(statuses, ["aligned", "reference", "aligned"]);
    assert_eq!(report["outputs"], serde_json::json!(["a.exr", "a.png"]));
    assert!(report["warnings"].is_array());
    assert!(number(&report["time_s"], "total") > 0.0);
    let crop = &report["crop"];
    let picture = image::open(folder.at("a.png")).expect("the picture");
    assert_eq!(
        (number(crop, "width_px"), number(crop, "height_px")),
        (picture.width().into(), picture.height().into())
    );
    assert!(number(crop, "x_px") + number(crop, "width_px") <= 300.0);
    assert!(number(crop, "y_px") + number(crop, "height_px") <= 200.0);
    let radiance = &report["radiance"]["radiance"];
    assert!(number(radiance, "min") < number(radiance, "max"), "{radiance}");
    assert!((5.0..30.0).contains(&number(radiance, "dynamic_range_stops")), "{radiance}");
    // An 8-bit frame has at most 9.2 stops: code values 6 to 250 of the sRGB curve are 9.04 stops.
    let merged = &report["radiance"];
    let exposures: Vec<f64> = report["frames"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|frame| number(frame, "relative_exposure").log2())
        .collect();
    let span = exposures.iter().fold(f64::MIN, |a, &b| a.max(b)) - exposures.iter().fold(f64::MAX, |a, &b| a.min(b));
    let within = (number(&merged["limits"], "clipping") / number(&merged["limits"], "noise_floor")).log2();
    let held = number(merged, "range_stops");
    assert!(span + 5.0 < within && within < span + 9.2 && held <= within && held > 5.0, "{span}: {merged}");
    assert!(keys(radiance).iter().any(|k| k.contains("percentile") || k.starts_with('p')), "{radiance}");
    assert_eq!(text(&report["response"], "model"), "debevec");
}

#[test]
fn requested_options_are_in_the_report() {
    let folder = Folder::with_bracket();
    let merge = "merge w2.jpg w3.jpg w4.jpg -o a.png";
    let asked = written(&folder, merge)["options"].clone();
    let expected = serde_json::json!({
        "align": "auto", "local": "auto", "robust": "ransac", "max_rotation_deg": 5.0, "crop": "common", "exposures": "fine-tuned",
        "response_model": "debevec", "response_file": null, "weight": "hat", "deghost_strength": 0.5, "flare": false,
        "colour": null, "operator": {
            "name": "natural", "brightness": null, "contrast": 0.2, "detail": 1.0, "saturation": 1.0
        },
        "adjust": {
            "white_balance": "as-shot", "brightness": 0.0, "contrast": 0.0, "saturation": 0.0, "shadows": 0.0,
            "highlights": 0.0
        },
        "bit_depth": 8, "picture_colour": "srgb", "resize": null
    });
    assert_eq!(asked, expected);
    let more = "--align mtb --local off --robust lmeds --max-rotation 2 --crop none --exposures as-given --response-model srgb \
                --weight mann-picard --deghost=0.25 --flare --colour rec2020 --bit-depth 16 --picture-colour adobe-rgb \
                --resize 50%";
    let asked = written(&folder, &format!("{merge} {more}"))["options"].clone();
    for (key, value) in [
        ("align", Value::from("mtb")),
        ("local", "off".into()),
        ("robust", "lmeds".into()),
        ("max_rotation_deg", 2.0.into()),
        ("crop", "none".into()),
        ("exposures", "as-given".into()),
        ("response_model", "srgb".into()),
        ("weight", "mann-picard".into()),
        ("deghost_strength", 0.25.into()),
        ("flare", true.into()),
        ("colour", "rec2020".into()),
        ("bit_depth", 16.into()),
        ("picture_colour", "adobe-rgb".into()),
        ("resize", "50%".into()),
    ] {
        assert_eq!(asked[key], value, "{key}");
    }
    folder.line(&format!("{merge} --force --save-response c.json")).done();
    let asked = written(&folder, &format!("{merge} --response c.json"))["options"].clone();
    assert_eq!((&asked["response_file"], &asked["response_model"]), (&"c.json".into(), &Value::Null));
    let aligned = written(&folder, "align w2.jpg w3.jpg")["options"].clone();
    assert_eq!(
        (&aligned["align"], &aligned["weight"], &aligned["operator"]),
        (&"auto".into(), &Value::Null, &Value::Null)
    );
}

#[test]
fn every_source_of_the_response_is_reported() {
    let folder = Folder::with_bracket();
    let found = |model: &str| {
        let line = "merge w1.jpg w2.jpg w3.jpg w4.jpg w5.jpg --force -o a.hdr --report r.json --response-model";
        folder.line(&format!("{line} {model}")).done();
        let report: Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
        (report["response"].clone(), folder.bytes("a.hdr"))
    };
    let (robertson, by_robertson) = found("robertson");
    assert_eq!((text(&robertson, "model"), robertson["exposure_ratios"].is_null()), ("robertson", true));
    // `robertson` solves no system of equations, so there is no condition number.
    assert!(robertson["channels"][1]["condition"].is_null(), "{robertson}");
    let (cubic, by_cubic) = found("mitsunaga-nayar --response-degree 3");
    assert_eq!(text(&cubic, "model"), "mitsunaga-nayar");
    for channel in 0..3 {
        assert_eq!(number(&cubic["channels"][channel], "degree"), 3.0);
        assert_eq!(cubic["channels"][channel]["borrowed"], false);
        assert!(number(&cubic["channels"][channel], "condition") > 1.0);
    }
    let ratios = cubic["exposure_ratios"].as_array().expect("ratios");
    assert_eq!(ratios.len(), 4, "{ratios:?}");
    assert!(ratios.iter().all(|r| (number(r, "given_stops") - number(r, "found_stops")).abs() < 1.0), "{ratios:?}");
    let (_, by_free) = found("mitsunaga-nayar --response-degree 6");
    assert!(by_cubic != by_free && by_cubic != by_robertson);
}

#[test]
fn the_printed_report_is_the_written_one_but_for_the_clock() {
    let folder = Folder::with_bracket();
    let run = folder.line("align w2.jpg w3.jpg w4.jpg --json --report r.json").done();
    let mut printed: Value = serde_json::from_str(&run.stdout).expect("JSON");
    let mut file: Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    printed["time_s"].take();
    file["time_s"].take();
    assert_eq!(printed, file);
    assert!(printed["response"].is_null() && printed["radiance"].is_null());
}

#[test]
fn static_frame_is_unmoved_and_frame_of_another_scene_rejected() {
    let folder = Folder::with_bracket();
    let report = written(&folder, "align w2.jpg w3.jpg --align none --reference 2");
    let status = |r: &Value, i: usize| r["frames"][i]["alignment"]["status"].as_str().map(str::to_owned);
    assert_eq!(status(&report, 0).as_deref(), Some("unmoved"));
    assert_eq!(status(&report, 1).as_deref(), Some("reference"));
    // A rotated picture looks like a picture of another scene.
    let other = image::imageops::rotate180(&crate::support::small(4));
    folder.put("w4.jpg", &crate::support::jpeg(&other, Some(4)));
    let report = written(&folder, "align w2.jpg w3.jpg w4.jpg --reference 2");
    assert_eq!(status(&report, 2).as_deref(), Some("rejected"));
    report["frames"].as_array().expect("a list").iter().for_each(|f| check_alignment(&f["alignment"]));
    let warnings = report["warnings"].as_array().expect("a list");
    let warning =
        warnings.iter().find(|w| text(w, "message").contains("w4.jpg")).expect("a warning that names the frame");
    assert_eq!(warning["degrades"], true);
    assert_eq!(folder.line("align w2.jpg w3.jpg w4.jpg --reference 2 --strict").code, 3);
    assert_eq!(folder.line("align w2.jpg w3.jpg w4.jpg --reference 2").code, 0);
}
