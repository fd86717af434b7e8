//! Tests of the inspection of a bracket with known motion: the contents of tables and sheets.

use super::*;
use crate::align;
use crate::align::scene::{Scene, Shot, rigid};
use crate::align::{Placement, RejectedBy, Transform};
use crate::bracket::exposure::Exposure;
use crate::bracket::{ReferenceChoice, Samples};
use crate::plane::Plane;

const SIZE: (usize, usize) = (420, 300);

/// Returns a bracket of three exposures of a scene, with known motion between them. The second frame is the reference
/// frame.
fn bracket() -> Bracket {
    let scene = Scene::new(11);
    let frame = |name: &str, ev: f64, warp: Transform| {
        let grey: Plane<u8> = scene.photograph(SIZE, &warp, Shot::at(ev));
        let rgb = grey.as_slice().iter().flat_map(|v| [*v; 3]).collect();
        Frame::new(name.into(), SIZE.0, SIZE.1, Samples::Eight(rgb), Exposure::given(ev).unwrap())
    };
    let frames = vec![
        frame("dark <1>.png", -2.0, rigid(7.0, 4.0, 1.2)),
        frame("middle.png", 0.0, Transform::Identity),
        frame("bright.png", 2.0, rigid(-3.0, 5.0, -0.8)),
    ];
    Bracket::new(frames, &ReferenceChoice::Number(2)).unwrap()
}

fn with_inspection(check: impl FnOnce(Inspection)) {
    let (bracket, options) = (bracket(), AlignOptions::default());
    let (alignment, warnings) = align::align(&bracket, &options).unwrap();
    check(inspect(&bracket, &alignment, &options, &warnings).unwrap());
}

fn drawn(sheet: Option<Sheet>) -> Drawing {
    match sheet {
        Some(Sheet::Drawing(drawing)) => drawing,
        other => panic!("no drawing: {other:?}"),
    }
}

#[test]
fn tables_contain_the_known_values() {
    with_inspection(|inspection| {
        let tables = inspection.tables();
        let json: serde_json::Value = serde_json::from_str(&tables.to_json()).unwrap();
        assert_eq!((&json["schema"], &json["reference"]), (&"hdralign-inspect/1".into(), &"middle.png".into()));
        let dark = &json["frames"][0];
        assert_eq!((&dark["relative_ev"], &dark["exposure_source"]), (&(-2.0).into(), &"given".into()));
        assert_eq!(dark["alignment"]["status"], "aligned");
        for detected in [&dark["features"], &dark["surf"]] {
            for kind in ["plain", "mtb", "merged"] {
                let [keypoints, matches, inliers] =
                    ["keypoints", "matches", "inliers"].map(|key| detected[kind][key].as_u64().unwrap());
                assert!(keypoints > matches && matches >= inliers && inliers > 0, "{kind} {detected}");
            }
            assert_eq!(detected["merged"]["verdict"], "agrees");
        }
        assert_ne!(dark["features"], dark["surf"]);
        let xor = &dark["mtb"]["xor"];
        assert!(xor["after_share"].as_f64() < xor["before_share"].as_f64());
        assert_eq!(
            xor["by_angle_deg"]["at"].as_array().unwrap().len(),
            xor["by_angle_deg"]["share"].as_array().unwrap().len()
        );
        assert!(
            json["frames"][1]["mtb"]["xor"].is_null() && json["frames"][1]["features"]["plain"]["matches"].is_null()
        );
    });
}

#[test]
fn the_text_has_every_table_and_a_row_for_each_photograph() {
    with_inspection(|inspection| {
        let text = inspection.tables().to_text();
        for number in 1..=8 {
            let from = text.find(&format!("Table {number}.")).unwrap_or_else(|| panic!("no table {number}:\n{text}"));
            let table: Vec<&str> = text[from..].lines().skip(1).take_while(|l| !l.is_empty()).collect();
            for name in ["dark <1>.png", "middle.png", "bright.png"] {
                assert_eq!(table.iter().filter(|l| l.starts_with(name)).count(), 1, "table {number}: {name}\n{text}");
            }
            // The line of dashes below the header is as wide as the table.
            let widest = table.iter().take(5).map(|l| l.chars().count()).max();
            assert_eq!(Some(table[1].chars().count()), widest, "table {number}\n{text}");
        }
        assert!(text.contains("-2.00") && text.contains("+2.00") && text.contains("agrees"));
    });
}

#[test]
fn every_sheet_is_well_formed_with_its_stated_size() {
    with_inspection(|inspection| {
        for i in 0..3 {
            let expected = if i == 1 { 3 } else { 6 };
            assert_eq!(inspection.kinds(i).len(), expected);
            for &kind in inspection.kinds(i) {
                match inspection.sheet(i, kind).unwrap() {
                    Some(Sheet::Bitmap(png)) => {
                        let reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
                        assert_eq!((reader.info().width, reader.info().height), (SIZE.0 as u32, SIZE.1 as u32));
                    }
                    sheet => {
                        let drawing = drawn(sheet);
                        let svg = drawing.to_svg();
                        resvg::usvg::roxmltree::Document::parse(&svg).unwrap();
                        // Lines with embedded pictures are skipped, because their base64 data may contain `NaN` or
                        // `inf` by chance.
                        let marks = svg.lines().filter(|l| !l.starts_with("<image"));
                        assert!(marks.clone().all(|l| !l.contains("NaN") && !l.contains("inf")), "{kind:?}");
                        let pixels = drawing.to_pixels().unwrap();
                        assert_eq!((pixels.width(), pixels.height()), (drawing.width(), drawing.height()));
                        // The sheet is not empty: more than 5 % of its pixels are not white.
                        let marked = pixels.as_slice().iter().filter(|p| **p != [255; 3]).count();
                        assert!(marked * 20 > pixels.as_slice().len(), "{kind:?}");
                    }
                }
            }
        }
        assert_eq!(inspection.sheet(1, SheetKind::Matches), Ok(None));
    });
}

#[test]
fn a_rejected_frame_is_drawn_without_an_after() {
    let (bracket, options) = (bracket(), AlignOptions::default());
    let mut alignment = Alignment::unmoved(&bracket);
    let (by, reason) = (RejectedBy::Alignment, Some("a reason".into()));
    alignment.placements[0] = Placement::Rejected { by, confidence: 0.0, reason };
    let inspection = inspect(&bracket, &alignment, &options, &[]).unwrap();
    assert!(inspection.tables().to_text().contains("dark <1>.png: rejected: a reason"));
    let merged = inspection.tables().frames[0].features.merged;
    assert_eq!((merged.off_px, merged.verdict), (None, Some(tables::MotionComparison::NoPlace)));
    let edges = drawn(inspection.sheet(0, SheetKind::Edges).unwrap()).to_svg();
    assert!(edges.contains("before: as photographed") && !edges.contains("after: aligned"));
    let xor = drawn(inspection.sheet(0, SheetKind::Xor).unwrap()).to_svg();
    assert!(xor.contains("bitmaps match best; it is not used"));
}

#[test]
fn bitmaps_that_contradict_a_transform_are_reported() {
    let (bracket, options) = (bracket(), AlignOptions::default());
    let (mut alignment, warnings) = align::align(&bracket, &options).unwrap();
    let warning = "the bitmaps differ more after alignment than before";
    assert!(!inspect(&bracket, &alignment, &options, &warnings).unwrap().tables().to_text().contains(warning));
    alignment.placements[0] = Placement::by_user(rigid(-40.0, 30.0, -3.0));
    let text = inspect(&bracket, &alignment, &options, &warnings).unwrap().tables().to_text();
    assert!(text.contains(&format!("dark <1>.png: {warning}")) && !text.contains(&format!("bright.png: {warning}")));
}

#[test]
fn the_same_bracket_gives_the_same_bytes_on_any_number_of_threads() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut all = Vec::new();
            with_inspection(|inspection| {
                all.push(inspection.tables().to_json());
                for kind in [SheetKind::Keypoints, SheetKind::Matches, SheetKind::Xor, SheetKind::Edges] {
                    all.push(drawn(inspection.sheet(0, kind).unwrap()).to_svg());
                }
            });
            all
        })
    };
    assert!(on(1) == on(3));
}

#[test]
fn a_part_is_the_same_but_for_the_features_left_out() {
    let (bracket, options) = (bracket(), AlignOptions::default());
    let (alignment, warnings) = align::align(&bracket, &options).unwrap();
    let whole = inspect(&bracket, &alignment, &options, &warnings).unwrap();
    let part = inspect_part(&bracket, &alignment, &options, &warnings, &|i| i != 2).unwrap();
    assert_eq!(part.features(0).counts(), whole.features(0).counts());
    assert_eq!(part.matching(0), whole.matching(0));
    assert!(part.features(2).counts().merged == 0 && part.matching(2).is_some_and(|m| m.pairs.is_empty()));
    assert_eq!(part.xor(2), whole.xor(2));
    assert_eq!(part.overlay(2, 200).unwrap(), whole.overlay(2, 200).unwrap());
    assert!(part.overlay(1, 200).unwrap().is_none());
}
