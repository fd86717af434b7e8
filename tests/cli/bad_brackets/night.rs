//! A night's folders with bad brackets among good ones: each has its line, and nothing stops the others.

use super::*;
use crate::support::small_jpeg;
use std::collections::BTreeMap;
use std::fs;

/// Every folder of `batch.csv`: the id, and the line.
fn lines(folder: &Folder) -> BTreeMap<String, String> {
    let table = String::from_utf8(folder.bytes("out/batch.csv")).expect("UTF-8");
    let id = |line: &str| line.split(',').next().unwrap_or_default().to_owned();
    table.lines().skip(1).filter(|line| !line.is_empty()).map(|line| (id(line), line.to_owned())).collect()
}

#[test]
fn a_night_of_bad_brackets_does_the_good_ones_and_tells_of_each() {
    let folder = Folder::empty();
    let night: Vec<(&str, bool, Vec<(&str, Vec<u8>)>)> = vec![
        ("good", true, vec![("a.jpg", small_jpeg(2).to_vec()), ("b.jpg", small_jpeg(3).to_vec())]),
        ("black", true, vec![("a.jpg", jpeg(&flat([0; 3]), Some(2))), ("b.jpg", jpeg(&flat([0; 3]), Some(3)))]),
        (
            "mirrored",
            true,
            vec![
                ("a.jpg", small_jpeg(2).to_vec()),
                ("b.jpg", small_jpeg(3).to_vec()),
                ("c.jpg", jpeg(&image::imageops::flip_horizontal(&frame(4)), Some(4))),
            ],
        ),
        ("scenes", false, vec![("a.jpg", small_jpeg(2).to_vec()), ("b.jpg", jpeg(&elsewhere(3), Some(3)))]),
        ("cut", false, vec![("a.jpg", small_jpeg(2).to_vec()), ("b.jpg", small_jpeg(3)[..9000].to_vec())]),
        (
            "sizes",
            false,
            vec![("a.jpg", small_jpeg(2).to_vec()), ("b.jpg", jpeg(&image::imageops::rotate90(&frame(3)), Some(3)))],
        ),
        ("unknown", false, vec![("a.jpg", jpeg(&flat([0; 3]), None)), ("b.jpg", jpeg(&flat([0; 3]), None))]),
        (
            "pixel",
            true,
            vec![("a.jpg", jpeg(&RgbImage::new(1, 1), Some(2))), ("b.jpg", jpeg(&RgbImage::new(1, 1), Some(3)))],
        ),
        ("last", true, vec![("a.jpg", small_jpeg(3).to_vec()), ("b.jpg", small_jpeg(4).to_vec())]),
    ];
    for (name, _, files) in &night {
        fs::create_dir_all(folder.at(format!("in/{name}"))).expect("a folder");
        files.iter().for_each(|(file, bytes)| folder.put(&format!("in/{name}/{file}"), bytes));
    }
    let run = folder.line("batch in -d out --by-folder -q");
    assert_eq!(run.code, 3, "{}", run.stderr);
    let summary: Value = serde_json::from_slice(&folder.bytes("out/batch.json")).expect("JSON");
    let steps = summary["steps"].as_array().expect("a list");
    assert_eq!(steps.len(), night.len(), "{summary:#}");
    let (table, told) = (lines(&folder), run.stderr.as_str());
    assert_eq!(table.len(), night.len(), "{table:?}");
    for (name, is_done, _) in &night {
        let of_it = |text: &str| text.contains(&format!("in/{name}/")) || text.contains(&format!("{name}_"));
        let step = steps.iter().find(|s| of_it(&s.to_string())).unwrap_or_else(|| panic!("no step of {name}"));
        let line = table.values().find(|line| of_it(line)).unwrap_or_else(|| panic!("no line of {name}: {table:?}"));
        assert_eq!(step["error"].is_null(), *is_done, "{name}: {step}");
        assert_eq!(line.contains("failed"), !is_done, "{name}: {line}");
        let results = ["exr", "png"].map(|extension| {
            let found = fs::read_dir(folder.at(format!("out/{name}")));
            found.map_or(0, |all| {
                all.filter(|e| e.as_ref().is_ok_and(|e| e.path().extension().is_some_and(|x| x == extension))).count()
            })
        });
        assert_eq!(results, if *is_done { [1, 1] } else { [0, 0] }, "{name}");
        if !is_done {
            assert!(told.contains(name), "{name} is not told of: {told}");
        }
    }
}
