//! Golden files: every folder in `tests/golden/` is a case. Its `arguments` contain the reduction factor of the
//! bracket and the options of the program; every other file is a result that must have exactly the same bytes.
//!
//! `HDRALIGN_BLESS=1 cargo test --test cli golden` writes the results again: check the changes before committing them.
//! If a result differs, the expected picture, the difference and the actual picture are written side by side to
//! `target/golden/`. To add a case, create a folder with its `arguments` and empty files with the names of the results.

use crate::support::{FRAMES, Folder, shrink, window};
use image::{Rgb, RgbImage};
use std::fs;
use std::path::{Path, PathBuf};

/// Largest size of all golden files together, in bytes.
const MOST_BYTES: usize = 400_000;

struct Case {
    name: String,
    folder: PathBuf,
    /// Reduction factor: pixels of the bracket per pixel of the case, along each side.
    side: u32,
    arguments: Vec<String>,
    /// Names of the files that are compared.
    results: Vec<String>,
}

fn package() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn entries(folder: &Path) -> Vec<String> {
    let name = |e: std::io::Result<fs::DirEntry>| e.expect("an entry").file_name().to_string_lossy().into_owned();
    let mut names: Vec<String> = fs::read_dir(folder).expect("a folder of goldens").map(name).collect();
    names.sort();
    names
}

fn cases() -> Vec<Case> {
    let root = package().join("tests/golden");
    let case = |name: String| {
        let folder = root.join(&name);
        let text = fs::read_to_string(folder.join("arguments")).unwrap_or_else(|e| panic!("{name}/arguments: {e}"));
        let (side, rest) = text.trim().split_once(' ').unwrap_or((text.trim(), ""));
        let results: Vec<String> = entries(&folder).into_iter().filter(|f| f != "arguments").collect();
        assert!(!results.is_empty(), "{name} holds nothing to compare");
        Case {
            side: side.parse().unwrap_or_else(|e| panic!("{name}/arguments begins with no number: {e}")),
            arguments: rest.split_whitespace().map(str::to_owned).collect(),
            folder,
            name,
            results,
        }
    };
    entries(&root).into_iter().map(case).collect()
}

/// Runs `case` and returns its results, in the order of its files.
fn made(case: &Case) -> Vec<Vec<u8>> {
    let folder = Folder::empty();
    let mut line = vec!["merge".to_owned(), "-e=-4,-2,0,2,4".to_owned()];
    for i in 1..=FRAMES {
        let name = format!("w{i}.png");
        let picture = image::open(window(i)).expect("a frame of testdata/window").to_rgb8();
        shrink(&picture, case.side).save(folder.at(&name)).expect("a PNG");
        line.push(name);
    }
    line.extend(case.arguments.iter().cloned());
    line.extend(case.results.iter().flat_map(|name| ["-o".to_owned(), name.clone()]));
    folder.run(&line).done();
    case.results.iter().map(|name| folder.bytes(name)).collect()
}

/// Returns a picture for viewing; radiance is scaled so that its mean is a fifth of white.
fn visible(bytes: &[u8], name: &str) -> Option<RgbImage> {
    if name.ends_with(".png") {
        return Some(image::load_from_memory(bytes).ok()?.to_rgb8());
    }
    let folder = Folder::empty();
    folder.put(name, bytes);
    let pixels = hdralign::read::read(&folder.at(name)).ok()?.0.pixels;
    let mean = pixels.as_slice().iter().flatten().sum::<f32>() / (3 * pixels.as_slice().len()) as f32;
    Some(RgbImage::from_fn(pixels.width() as u32, pixels.height() as u32, |x, y| {
        let shown = |v: f32| (255.0 * (v / (5.0 * mean)).clamp(0.0, 1.0).powf(1.0 / 2.2)) as u8;
        Rgb(pixels.row(y as usize)[x as usize].map(shown))
    }))
}

/// Returns the expected picture, the difference (16 times, around grey) and the actual picture side by side.
fn side_by_side(expected: &RgbImage, actual: &RgbImage) -> RgbImage {
    let (w, h) = (expected.width().max(actual.width()), expected.height().max(actual.height()));
    let at = |p: &RgbImage, x, y| p.get_pixel_checked(x, y).copied().unwrap_or(Rgb([255, 0, 255]));
    RgbImage::from_fn(3 * w + 8, h, |x, y| {
        let (panel, x) = (x / (w + 4), x % (w + 4));
        let (a, b) = (at(expected, x, y), at(actual, x, y));
        match panel {
            _ if x >= w => Rgb([255; 3]),
            0 => a,
            1 => Rgb([0, 1, 2].map(|c| (128 + 16 * (i32::from(b[c]) - i32::from(a[c]))).clamp(0, 255) as u8)),
            _ => b,
        }
    })
}

/// Writes the actual file and a picture of the differences to `target/golden/`. Returns a message with the path of the
/// picture.
fn show(case: &Case, name: &str, expected: &[u8], actual: &[u8]) -> String {
    let folder = package().join("target/golden");
    fs::create_dir_all(&folder).expect("target/golden");
    let first = expected.iter().zip(actual).position(|(a, b)| a != b);
    let mut said = format!("{}/{name}: {} and {} bytes", case.name, expected.len(), actual.len());
    said += &first.map_or(String::new(), |at| format!(", first different at {at}"));
    let kept = folder.join(format!("{}-actual-{name}", case.name));
    fs::write(&kept, actual).expect("a file in target/golden");
    if let (Some(expected), Some(actual)) = (visible(expected, name), visible(actual, name)) {
        let path = folder.join(format!("{}-{name}.png", case.name));
        side_by_side(&expected, &actual).save(&path).expect("a picture in target/golden");
        said += &format!("; expected, difference and actual are in {}", path.display());
    } else {
        said += &format!("; the actual one is {}", kept.display());
    }
    said
}

#[test]
fn results_are_the_goldens_to_the_byte() {
    let bless = std::env::var_os("HDRALIGN_BLESS").is_some_and(|v| v == "1");
    let cases = cases();
    assert!(cases.len() >= 4, "only {} cases found", cases.len());
    let (mut differ, mut total) = (Vec::new(), 0);
    for case in &cases {
        for (name, actual) in case.results.iter().zip(made(case)) {
            let path = case.folder.join(name);
            if bless {
                fs::write(&path, &actual).expect("a golden");
            }
            let expected = fs::read(&path).expect("a golden");
            total += expected.len();
            if expected != actual {
                differ.push(show(case, name, &expected, &actual));
            }
        }
    }
    assert!(differ.is_empty(), "not the goldens (HDRALIGN_BLESS=1 takes the new ones):\n  {}\n", differ.join("\n  "));
    assert!(total < MOST_BYTES, "the goldens have grown to {total} bytes");
}

#[test]
fn difference_picture_is_between_expected_and_actual() {
    let (a, b) = (RgbImage::from_pixel(2, 1, Rgb([10, 20, 30])), RgbImage::from_pixel(2, 2, Rgb([11, 20, 28])));
    let shown = side_by_side(&a, &b);
    assert_eq!(shown.dimensions(), (14, 2));
    assert_eq!([0, 6, 12].map(|x| shown.get_pixel(x, 0).0), [[10, 20, 30], [144, 128, 96], [11, 20, 28]]);
    assert_eq!(shown.get_pixel(0, 1).0, [255, 0, 255], "where one has no pixels");
}
