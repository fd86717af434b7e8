//! Frames without detail: black, white, one colour, noise, checkerboards.

use super::*;

/// Merges three frames of one colour each, and checks that they are merged without alignment, with a warning.
fn one_tone(colours: [[u8; 3]; 3]) -> Merged {
    let folder = Folder::empty();
    let frames = colours.map(flat);
    let names = exposed(&folder, &[(&frames[0], 2), (&frames[1], 3), (&frames[2], 4)]);
    let merged = merged(&folder, &names);
    assert!(
        merged.warns(true, &["enough detail to be aligned", "uniform", "without alignment"]),
        "{:?}",
        merged.warnings()
    );
    for file in ["f1.jpg", "f3.jpg"] {
        assert_eq!((merged.status(file), merged.confidence(file)), ("unmoved", 0.0), "{file}");
    }
    assert_eq!(merged.status("f2.jpg"), "reference");
    assert_eq!(strict(&folder, &names), 3);
    assert!(merged.radiance.iter().all(|p| *p == merged.radiance[0]), "one tone is many");
    merged
}

#[test]
fn an_all_black_bracket_is_black() {
    let merged = one_tone([[0; 3]; 3]);
    assert!(merged.picture.pixels().all(|p| p.0 == [0; 3]), "{:?}", merged.picture.get_pixel(0, 0));
    assert_eq!(merged.report["radiance"]["all_black"], 120 * 80);
}

#[test]
fn an_all_white_bracket_is_white() {
    let merged = one_tone([[255; 3]; 3]);
    assert!(merged.picture.pixels().all(|p| p.0 == [255; 3]), "{:?}", merged.picture.get_pixel(0, 0));
    assert_eq!(merged.report["radiance"]["all_clipped"], 120 * 80);
}

#[test]
fn a_bracket_of_one_colour_has_that_colour() {
    // The frames show a colour card at exposures two stops apart, by the sRGB curve. The picture has the colour of the
    // reference.
    let merged = one_tone([[53, 33, 14], [105, 69, 35], [199, 136, 76]]);
    let shown = merged.picture.get_pixel(0, 0).0;
    // JPEG rounds, and the frames are not exactly two stops apart, so the picture differs from the reference by up to 6
    // code values.
    assert!((0..3).all(|c| shown[c].abs_diff([105, 69, 35][c]) <= 6), "{shown:?}");
}

/// Equal pixels at three different exposures are impossible: the frames count as one exposure, and the radiance is that
/// of one frame.
#[test]
fn one_colour_at_every_exposure_is_one_exposure() {
    let merged = one_tone([[128; 3]; 3]);
    assert!(merged.warns(true, &["f2.jpg has the same pixels as f1.jpg", "2.0 EV"]), "{:?}", merged.warnings());
    assert!(merged.radiance.iter().flatten().all(|v| (v - 1.0).abs() < 0.02), "{:?}", merged.radiance[0]);
    assert!(merged.picture.pixels().all(|p| p.0.iter().all(|v| v.abs_diff(128) <= 1)));
}

#[test]
fn one_colour_a_frame_is_that_of_the_frame_that_shows_it() {
    let merged = one_tone([[0; 3], [128; 3], [255; 3]]);
    assert!(
        merged.picture.pixels().all(|p| p.0.iter().all(|v| v.abs_diff(128) <= 1)),
        "{:?}",
        merged.picture.get_pixel(0, 0)
    );
}

#[test]
fn uniform_frames_without_exposures_are_an_error() {
    for colour in [[0; 3], [255; 3], [90, 120, 60]] {
        let folder = Folder::empty();
        let names = lossless(&folder, &[&flat(colour), &flat(colour)]);
        refused(&folder, &names, &["f1.png", "no usable exposure", "too dark, too bright or have too few tones", "-e"]);
        let given = merged(&folder, &format!("{names} -e=-1,1"));
        assert_eq!(given.status("f2.png"), if given.status("f1.png") == "reference" { "unmoved" } else { "reference" });
    }
}

fn noise(seed: u64) -> RgbImage {
    let mut random = Random(seed);
    RgbImage::from_fn(150, 100, |_, _| Rgb([0; 3].map(|_| (256.0 * random.next()) as u8)))
}

#[test]
fn equal_noise_in_each_frame_is_a_static_scene() {
    let folder = Folder::empty();
    let pixels = noise(1);
    let names = lossless(&folder, &[&times(&pixels, 0.5), &pixels]);
    let merged = merged(&folder, &format!("{names} -e=-2,0"));
    for file in ["f1.png", "f2.png"] {
        assert!(matches!(merged.status(file), "unmoved" | "reference"), "{file}");
    }
}

#[test]
fn different_noise_in_each_frame_is_an_error() {
    let folder = Folder::empty();
    let names = lossless(&folder, &[&noise(1), &noise(2), &noise(3)]);
    refused(&folder, &format!("{names} -e=-2,0,2"), &["no other frame was aligned", "--align none"]);
}

fn checkerboard(side: u32, most: u8) -> RgbImage {
    RgbImage::from_fn(120, 80, |x, y| Rgb([if (x / side + y / side).is_multiple_of(2) { most / 8 } else { most }; 3]))
}

/// A checkerboard looks the same after a shift by its period, so the alignment is accepted without a shift. The two
/// code values of each frame do not determine exposures, so EXIF is used.
#[test]
fn checkerboard_is_merged_without_a_shift() {
    let folder = Folder::empty();
    let boards = [60, 110, 200].map(|most| checkerboard(8, most));
    let names = exposed(&folder, &[(&boards[0], 2), (&boards[1], 3), (&boards[2], 4)]);
    let merged = merged(&folder, &names);
    for file in ["f1.jpg", "f2.jpg", "f3.jpg"] {
        assert!(matches!(merged.status(file), "unmoved" | "reference"), "{file}");
        assert_eq!(merged.frame(file)["exposure_source"], "exif", "{file}: {:?}", merged.warnings());
    }
}

/// With squares of one pixel, every second position fits, and only the full size shows the squares, not the reduced
/// pyramid levels.
#[test]
fn pixel_checkerboard_is_an_error_and_is_merged_without_alignment() {
    let folder = Folder::empty();
    let names = lossless(&folder, &[&checkerboard(1, 100), &checkerboard(1, 200)]);
    refused(&folder, &format!("{names} -e=-2,0"), &["no other frame was aligned", "--align none"]);
    let merged = merged(&folder, &format!("{names} -e=-2,0 --align none"));
    assert_ne!(merged.radiance[0], merged.radiance[1]);
}
