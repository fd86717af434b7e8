//! Very small, narrow and wide pictures; very few and very many frames.

use super::*;
use image::imageops;

/// Returns a part of frame `i` of `width` x `height` pixels.
fn piece(i: usize, width: u32, height: u32) -> RgbImage {
    imageops::crop_imm(&frame(i), 120, 60, width, height).to_image()
}

/// The pictures are too small to determine the motion: they are merged without alignment, with a warning.
#[test]
fn smallest_pictures_are_merged_without_alignment() {
    for (width, height) in
        [(1, 1), (1, 40), (40, 1), (2, 2), (3, 3), (2, 33), (5, 4), (8, 8), (16, 3), (16, 16), (31, 31)]
    {
        let folder = Folder::empty();
        let names = exposed(&folder, &[(&piece(2, width, height), 2), (&piece(3, width, height), 3)]);
        let merged = merged(&folder, &names);
        assert_eq!((merged.picture.width(), merged.picture.height()), (width, height));
        let placed = ["f1.jpg", "f2.jpg"].map(|file| merged.status(file).to_owned());
        assert!(placed.iter().all(|status| status != "rejected"), "{width}x{height}: {placed:?}");
        if merged.confidence("f1.jpg").min(merged.confidence("f2.jpg")) < 0.5 {
            let reported =
                merged.warns(true, &["enough detail to be aligned"]) || merged.warns(true, &["low confidence"]);
            assert!(reported, "{width}x{height}: {:?}", merged.warnings());
        }
    }
}

/// Returns a picture that is a long strip, with detail along it.
fn strip(width: u32, height: u32, light: f64) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let (u, v) = (f64::from(x), f64::from(y));
        let scene = 60.0 + 40.0 * libm::sin(u / 90.0 + v) + 20.0 * libm::sin(u * u / 4e7 + 0.3 * v);
        Rgb([0.9, 1.0, 0.8].map(|tint| (light * tint * scene).min(255.0) as u8))
    })
}

/// Strips as long as the longest side of a JPEG, and longer; a search over shifts of 15 % of the long side in both
/// directions would need gigabytes.
#[test]
fn strips_as_long_as_can_be_are_merged() {
    for (width, height) in [(65_500, 4), (65_535, 4), (70_000, 4), (4, 65_536)] {
        let folder = Folder::empty();
        let turned = |picture: RgbImage| if width < height { imageops::rotate90(&picture) } else { picture };
        let of = |light| turned(strip(width.max(height), 4, light));
        let names = lossless(&folder, &[&of(1.0), &of(2.0)]);
        let line = format!("{names} -e=0,1 -o b.hdr -o b.tif");
        let merged = merged(&folder, &line);
        assert_eq!((merged.picture.width(), merged.picture.height()), (width, height));
        assert!(merged.warns(true, &["enough detail to be aligned", "too few"]), "{:?}", merged.warnings());
        for name in ["b.hdr", "b.tif"] {
            let (map, _) = read::read(&folder.at(name)).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!((map.pixels.width(), map.pixels.height()), (width as usize, height as usize), "{name}");
        }
    }
}

/// A picture that is too large for JPEG is an error that names the file, and no file is left.
#[test]
fn a_jpeg_of_a_longer_side_is_refused() {
    let folder = Folder::empty();
    let names = lossless(&folder, &[&strip(65_536, 4, 1.0), &strip(65_536, 4, 2.0)]);
    let before = folder.listing();
    let run = folder.line(&format!("merge {names} -e=0,1 -o a.exr -o a.jpg"));
    assert_eq!(run.code, 1, "{}", run.stderr);
    assert!(run.stderr.contains("a.jpg") && run.stderr.contains("65"), "{}", run.stderr);
    assert_eq!(folder.listing(), before);
}

/// A picture as from a slit camera, long and not too narrow, which is shifted by three pixels in the second frame.
#[test]
fn a_long_picture_is_searched_in_seconds() {
    let folder = Folder::empty();
    let mut random = Random(11);
    let bricks: Vec<f64> = (0..2000 * 6).map(|_| 20.0 + 80.0 * random.next()).collect();
    let slit = |from: u32, light: f64| {
        RgbImage::from_fn(20_000, 40, |x, y| {
            let brick = bricks[((x + from) / 11 % 2000 + 2000 * (y / 7)) as usize];
            Rgb([0.9, 1.0, 0.8].map(|tint| (light * tint * brick) as u8))
        })
    };
    let names = lossless(&folder, &[&slit(0, 1.0), &slit(3, 2.0)]);
    let merged = merged(&folder, &format!("{names} -e=0,1 --reference f1.png"));
    assert_eq!(merged.status("f2.png"), "aligned");
    let shift = &merged.frame("f2.png")["alignment"]["shift_px"];
    assert!((shift[0].as_f64().expect("a number") + 3.0).abs() < 0.3, "{shift}");
}

#[test]
fn a_hundred_frames_are_merged() {
    let folder = Folder::empty();
    let small = imageops::thumbnail(&frame(3), 96, 64);
    let ev = |k: usize| (k as f64 - 50.0) / 25.0;
    let frames: Vec<RgbImage> = (0..100).map(|k| times(&small, libm::exp2(ev(k) / 2.2))).collect();
    let names = lossless(&folder, &frames.iter().collect::<Vec<_>>());
    let given = (0..100).map(|k| format!("{:.2}", ev(k))).collect::<Vec<_>>().join(",");
    let merged = merged(&folder, &format!("{names} -e={given}"));
    let frames = merged.report["frames"].as_array().expect("a list");
    assert_eq!(frames.len(), 100);
    assert!(frames.iter().all(|f| f["alignment"]["status"] != "rejected"), "{:?}", merged.warnings());
}

#[test]
fn bracket_needs_two_frames() {
    let folder = Folder::with_bracket();
    for (line, said) in [("merge", "IMAGES"), ("merge w1.jpg", "at least two")] {
        let run = folder.line(line);
        assert_eq!((run.code, run.stdout.as_str()), (2, ""), "{line}");
        assert!(run.stderr.contains(said), "{}", run.stderr);
    }
}
