//! Camera raw: DNG files through the program. The fixtures show two grey halves, four stops apart, with a camera on a
//! tripod.

use crate::support::{Folder, small_jpeg};
use hdralign::read::read;
use serde_json::Value;

const FIXTURES: [(&str, &[u8]); 4] = [
    ("tiles-0.dng", include_bytes!("../fixtures/raw/tiles-0.dng")),
    ("tiles-1.dng", include_bytes!("../fixtures/raw/tiles-1.dng")),
    ("packed-0.dng", include_bytes!("../fixtures/raw/packed-0.dng")),
    ("packed-1.dng", include_bytes!("../fixtures/raw/packed-1.dng")),
];

fn folder() -> Folder {
    let folder = Folder::empty();
    FIXTURES.iter().for_each(|(name, bytes)| folder.put(name, bytes));
    folder
}

/// The mean of the pixels of a map at these columns and rows, in three channels.
fn mean(map: &hdralign::merge::RadianceMap, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> [f64; 3] {
    let pixels = || rows.clone().flat_map(|y| columns.clone().map(move |x| map.pixels.at(x, y)));
    [0, 1, 2].map(|c| pixels().map(|p| f64::from(p[c])).sum::<f64>() / pixels().count() as f64)
}

/// Greys are neutral within 2 %, and the second part is 16 times as bright as the first within 4 %: the noise of the
/// mean of the 60 pixels and more of a part is below 1 %, and half floats are rounded by up to 0.05 %.
fn check_halves(dark: [f64; 3], bright: [f64; 3]) {
    for part in [dark, bright] {
        assert!((part[0] / part[1] - 1.0).abs() < 0.02 && (part[2] / part[1] - 1.0).abs() < 0.02, "{part:?}");
    }
    assert!((bright[1] / dark[1] / 16.0 - 1.0).abs() < 0.04, "{dark:?} {bright:?}");
}

#[test]
fn mosaics_become_linear_and_neutral_however_they_are_stored_and_turned() {
    let folder = folder();
    // Tiles of lossless JPEG in a sub-directory; cut to the area that developers show.
    let run = folder.line("merge tiles-0.dng tiles-1.dng --align none -o tiles.exr --json -q").done();
    let report: Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(report["response"]["model"], "srgb", "{report}");
    let map = read(&folder.at("tiles.exr")).unwrap().0;
    assert_eq!((map.pixels.width(), map.pixels.height()), (39, 14));
    check_halves(mean(&map, 2..14, 2..12), mean(&map, 22..36, 2..12));
    // Packed values of 12 bits in strips, big-endian, with a masked border of odd height; displayed as portrait.
    folder.line("merge packed-0.dng packed-1.dng --align none -o packed.exr -q").done();
    let map = read(&folder.at("packed.exr")).unwrap().0;
    assert_eq!((map.pixels.width(), map.pixels.height()), (20, 33));
    check_halves(mean(&map, 2..18, 2..14), mean(&map, 2..18, 22..31));
}

#[test]
fn of_a_raw_file_and_a_jpeg_of_a_shot_the_raw_file_is_used() {
    let folder = folder();
    let merge = |files: &str, ev: &str, out: &str| folder.line(&format!("merge {files} {ev} --align none -o {out}"));
    merge("tiles-0.dng tiles-1.dng", "-e=0,2", "alone.exr").done();
    for i in 2..4 {
        folder.put(&format!("tiles-{}.JPG", i - 2), small_jpeg(i));
    }
    let run = merge("tiles-0.JPG tiles-0.dng tiles-1.JPG tiles-1.dng", "-e=0,0,2,2", "both.exr").done();
    assert!(run.stderr.contains("tiles-0.JPG: not used, like 1 other file"), "{run:?}");
    assert_eq!(folder.bytes("alone.exr"), folder.bytes("both.exr"));
    // Of other shots, either the raw files or the others are needed.
    folder.put("other.JPG", small_jpeg(2));
    let run = merge("tiles-0.dng other.JPG", "-e=0,2", "x.exr");
    assert!(run.code == 2 && run.stderr.contains("other.JPG") && run.stderr.contains("raw"), "{run:?}");
}

#[test]
fn damaged_raw_files_are_named_and_nothing_is_written() {
    let folder = folder();
    for length in [7, 300, FIXTURES[0].1.len() / 2] {
        folder.put("cut.dng", &FIXTURES[0].1[..length]);
        let run = folder.line("merge cut.dng tiles-1.dng -e=0,2 --align none -o x.exr -q");
        assert!(run.code == 1 && run.stderr.contains("cut.dng"), "{length}: {run:?}");
        assert!(folder.listing().iter().all(|(name, _)| !name.contains("x.exr")), "{:?}", folder.listing());
    }
}

#[test]
fn frames_have_the_white_of_the_reference_whatever_the_camera_chose() {
    let folder = folder();
    // AsShotNeutral: three fractions of 32 bits each, in another place.
    let mut bytes = FIXTURES[0].1.to_vec();
    let tag = [0x28, 0xC6, 5, 0, 3, 0, 0, 0];
    let entry = bytes.windows(8).position(|window| window == tag).unwrap();
    let number = |bytes: &[u8], at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let red = number(&bytes, entry + 8) as usize;
    let changed = number(&bytes, red) / 10 * 9;
    bytes[red..red + 4].copy_from_slice(&changed.to_le_bytes());
    folder.put("other.dng", &bytes);
    let merge = |first: &str, out: &str| {
        folder.line(&format!("merge {first} tiles-1.dng --reference tiles-1.dng --align none -o {out} -q")).done();
        read(&folder.at(out)).unwrap().0
    };
    let (same, other) = (merge("tiles-0.dng", "same.exr"), merge("other.dng", "other.exr"));
    // The code values are rounded once more, and values below black were cut in other places.
    for (a, b) in same.pixels.as_slice().iter().zip(other.pixels.as_slice()) {
        assert!((0..3).all(|c| (a[c] / b[c] - 1.0).abs() < 5e-3), "{a:?} {b:?}");
    }
    check_halves(mean(&other, 2..14, 2..12), mean(&other, 22..36, 2..12));
}
