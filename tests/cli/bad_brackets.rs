//! Unusual and damaged brackets: the results stated in `docs/reference/bad-input.md`.

use crate::support::{FRAMES, Folder, jpeg, jpeg_with, ratio, small};
use exif::Tag;
use hdralign::read;
use image::{Rgb, RgbImage};
use img_parts::{Bytes, ImageEXIF};
use serde_json::Value;
use std::io::Cursor;
use std::sync::OnceLock;

mod exposures;
mod kinds;
mod night;
mod plain;
mod scenes;
mod sensors;
mod sizes;
mod sweep;

/// Returns frame `i` of the small bracket, 300 x 200 pixels; it is decoded once.
fn frame(i: usize) -> RgbImage {
    static FRAMES_SEEN: OnceLock<Vec<RgbImage>> = OnceLock::new();
    FRAMES_SEEN.get_or_init(|| (1..=FRAMES).map(small).collect())[i - 1].clone()
}

/// Returns a picture of 120 x 80 pixels of one colour.
fn flat(colour: [u8; 3]) -> RgbImage {
    RgbImage::from_pixel(120, 80, Rgb(colour))
}

/// Writes each picture with the EXIF of the frame given with it, as `f1.jpg`, `f2.jpg`, ...; returns the names.
fn exposed(folder: &Folder, pictures: &[(&RgbImage, usize)]) -> String {
    let name = |n: usize| format!("f{}.jpg", n + 1);
    for (n, (picture, i)) in pictures.iter().enumerate() {
        folder.put(&name(n), &jpeg(picture, Some(*i)));
    }
    (0..pictures.len()).map(name).collect::<Vec<_>>().join(" ")
}

/// Writes the pictures losslessly, without EXIF, as `f1.png`, `f2.png`, ...; returns the names.
fn lossless(folder: &Folder, pictures: &[&RgbImage]) -> String {
    let name = |n: usize| format!("f{}.png", n + 1);
    for (n, picture) in pictures.iter().enumerate() {
        folder.put(&name(n), &png(picture));
    }
    (0..pictures.len()).map(name).collect::<Vec<_>>().join(" ")
}

/// Returns `picture` as a PNG.
fn png(picture: &RgbImage) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).expect("a PNG");
    bytes.into_inner()
}

/// Returns `picture` as a JPEG whose EXIF has an exposure time of `num / denom` s and no flash.
fn timed(picture: &RgbImage, num: u32, denom: u32) -> Vec<u8> {
    shot(picture, (num, denom), false)
}

/// Returns `picture` as a JPEG whose EXIF has this exposure time (s), with or without flash.
fn shot(picture: &RgbImage, (num, denom): (u32, u32), flash: bool) -> Vec<u8> {
    // 0x19: the flash fired, in automatic mode; 0x18: it did not fire.
    let flash = exif::Value::Short(vec![0x18 + u16::from(flash)]);
    jpeg_with(picture, &[(Tag::ExposureTime, ratio(num, denom)), (Tag::Flash, flash)])
}

/// Returns `file`, a JPEG or PNG, with the EXIF of frame `i`.
fn with_exif_of(i: usize, file: Vec<u8>) -> Vec<u8> {
    let exif =
        img_parts::jpeg::Jpeg::from_bytes(Bytes::from(crate::support::small_jpeg(i).to_vec())).expect("a JPEG").exif();
    let mut file = img_parts::DynImage::from_bytes(Bytes::from(file)).expect("readable").expect("a JPEG or PNG");
    file.set_exif(exif);
    file.encoder().bytes().to_vec()
}

/// Returns a frame of another scene, a wall of planks and a lamp, which is as bright as frame `i`.
fn elsewhere(i: usize) -> RgbImage {
    let light = libm::exp2(2.0 * i as f64 - 6.0);
    let mut random = Random(77);
    let plank: Vec<f64> = (0..26).map(|_| 0.05 + 0.4 * random.next()).collect();
    RgbImage::from_fn(300, 200, |x, y| {
        let (u, v) = (f64::from(x), f64::from(y));
        let tilted = ((u + 0.35 * v) / 16.0) as usize;
        let grain = 1.0 + 0.25 * libm::sin(0.9 * v + 13.0 * plank[tilted] * u);
        let lamp = 3.0 * libm::exp(-((u - 210.0) * (u - 210.0) + (v - 60.0) * (v - 60.0)) / 900.0);
        let seen =
            |tint: f64| (255.0 * libm::pow((light * tint * (plank[tilted] * grain + lamp)).min(1.0), 0.45)) as u8;
        Rgb([seen(1.0), seen(0.9), seen(0.75)])
    })
}

/// A generator of random numbers in 0..1 that are the same on every machine (Knuth's congruential generator).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns `picture` with uniform noise from -`most` to `most` code values in each sample.
    fn noisy(&mut self, picture: &RgbImage, most: f64) -> RgbImage {
        let mut noisy = picture.clone();
        for sample in noisy.iter_mut() {
            *sample = (f64::from(*sample) + most * (2.0 * self.next() - 1.0)).round().clamp(0.0, 255.0) as u8;
        }
        noisy
    }
}

/// Returns `picture` with every code value multiplied by `factor`.
fn times(picture: &RgbImage, factor: f64) -> RgbImage {
    let mut scaled = picture.clone();
    scaled.iter_mut().for_each(|v| *v = (f64::from(*v) * factor).round().min(255.0) as u8);
    scaled
}

/// The results of a merge.
struct Merged {
    report: Value,
    radiance: Vec<[f32; 3]>,
    picture: RgbImage,
}

/// Runs `merge NAMES OPTIONS`, which must succeed. Checks that radiance is finite and not negative, that files and
/// report have the same size, and that the warnings are printed.
fn merged(folder: &Folder, line: &str) -> Merged {
    let run = folder.line(&format!("merge {line} -o a.exr -o a.png --report r.json --force")).done();
    let report: Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    let (map, _) = read::read(&folder.at("a.exr")).expect("an EXR");
    let picture = image::open(folder.at("a.png")).expect("a PNG").to_rgb8();
    let size = ["width_px", "height_px"].map(|key| report["crop"][key].as_u64().expect("a number") as usize);
    assert_eq!(size, [map.pixels.width(), map.pixels.height()], "{line}");
    assert_eq!(size, [picture.width() as usize, picture.height() as usize], "{line}");
    let radiance = map.pixels.into_vec();
    assert!(radiance.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "{line}: radiance is no light");
    let reported = run.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    for warning in report["warnings"].as_array().expect("a list") {
        let message = warning["message"].as_str().expect("a text");
        assert!(reported.contains(message), "{line}: {message:?} is not reported:\n{reported}");
    }
    Merged { report, radiance, picture }
}

impl Merged {
    fn frame(&self, file: &str) -> &Value {
        let frames = self.report["frames"].as_array().expect("a list");
        frames.iter().find(|f| f["path"] == file).unwrap_or_else(|| panic!("{file} is not in {frames:?}"))
    }

    fn status(&self, file: &str) -> &str {
        self.frame(file)["alignment"]["status"].as_str().expect("a text")
    }

    fn confidence(&self, file: &str) -> f64 {
        self.frame(file)["alignment"]["confidence"].as_f64().expect("a number")
    }

    fn warnings(&self) -> Vec<&str> {
        self.report["warnings"]
            .as_array()
            .expect("a list")
            .iter()
            .map(|w| w["message"].as_str().expect("a text"))
            .collect()
    }

    /// Returns whether there is a warning that contains all `parts` and whose `degrades` is as given.
    fn warns(&self, degrades: bool, parts: &[&str]) -> bool {
        self.report["warnings"].as_array().expect("a list").iter().any(|w| {
            let message = w["message"].as_str().expect("a text");
            w["degrades"] == degrades && parts.iter().all(|part| message.contains(part))
        })
    }

    /// Returns the positions in the frame `file` of the corners of the reference, in pixels.
    fn corners(&self, file: &str) -> [[f64; 2]; 4] {
        let h = &self.frame(file)["alignment"]["homography"];
        let n = |i: usize| h[i].as_f64().expect("a number");
        [[0.0, 0.0], [299.0, 0.0], [0.0, 199.0], [299.0, 199.0]].map(|[x, y]| {
            let w = n(6) * x + n(7) * y + n(8);
            [(n(0) * x + n(1) * y + n(2)) / w, (n(3) * x + n(4) * y + n(5)) / w]
        })
    }
}

/// Returns the distance between the transforms that two runs found for `file`: the largest distance of a corner, in
/// pixels.
fn apart(a: &Merged, b: &Merged, file: &str) -> f64 {
    let (a, b) = (a.corners(file), b.corners(file));
    let distance = |i: usize| ((a[i][0] - b[i][0]).powi(2) + (a[i][1] - b[i][1]).powi(2)).sqrt();
    (0..4).map(distance).fold(0.0, f64::max)
}

/// Checks that a merge fails: exit code 1, an error with the parts `said`, nothing on stdout, no files.
fn refused(folder: &Folder, line: &str, said: &[&str]) {
    let before = folder.listing();
    let run = folder.line(&format!("merge {line} -o a.exr -o a.png"));
    assert_eq!((run.code, run.stdout.as_str()), (1, ""), "{line}\n{}", run.stderr);
    assert_eq!(folder.listing(), before, "{line}: something was left behind");
    for part in said {
        assert!(run.stderr.contains(part), "{line}\n{}does not say {part:?}", run.stderr);
    }
}

/// Returns the exit code of a merge of `line` with `--strict`.
fn strict(folder: &Folder, line: &str) -> i32 {
    folder.line(&format!("merge {line} -o strict.exr --strict --force")).code
}
