//! Missing, equal, reversed and impossible exposures; copies of photographs.

use super::*;

fn relative(merged: &Merged, file: &str) -> f64 {
    merged.frame(file)["relative_exposure"].as_f64().expect("a number")
}

/// Returns the difference of the exposures of `a` and `b` in stops, positive if that of `b` is longer.
fn stops(merged: &Merged, a: &str, b: &str) -> f64 {
    libm::log2(relative(merged, b) / relative(merged, a))
}

/// Returns the sources of the exposures of `files`.
fn sources<'a>(merged: &'a Merged, files: &[&str]) -> Vec<&'a str> {
    files.iter().map(|file| merged.frame(file)["exposure_source"].as_str().expect("a text")).collect()
}

/// Writes frames 2, 3 and 4, which are two stops apart, with the EXIF of the frames `exif`; returns the names.
fn window(folder: &Folder, exif: [usize; 3]) -> String {
    exposed(folder, &[(&frame(2), exif[0]), (&frame(3), exif[1]), (&frame(4), exif[2])])
}

#[test]
fn exif_that_is_reversed_or_equal_is_not_used() {
    for exif in [[4, 3, 2], [3, 3, 3]] {
        let folder = Folder::empty();
        let names = window(&folder, exif);
        let merged = merged(&folder, &names);
        assert!(merged.warns(true, &["contradict the pixels", "estimated", "-e"]), "{:?}", merged.warnings());
        for (a, b) in [("f1.jpg", "f2.jpg"), ("f2.jpg", "f3.jpg")] {
            let seen = stops(&merged, a, b);
            // The estimated exposures are accurate to some tenths of a stop.
            assert!((seen - 2.0).abs() < 0.4, "{a} {b}: {seen}");
        }
        assert_eq!(strict(&folder, &names), 3);
    }
}

/// One frame of three has an exposure time of 0, an infinite or undefined one, or none.
#[test]
fn exif_that_is_missing_or_impossible_in_one_frame_is_estimated() {
    for odd in [timed(&frame(4), 0, 1), timed(&frame(4), 1, 0), timed(&frame(4), 0, 0), jpeg(&frame(4), None)] {
        let folder = Folder::empty();
        let names = window(&folder, [2, 3, 4]);
        folder.put("f3.jpg", &odd);
        let merged = merged(&folder, &names);
        assert!(merged.warns(true, &["f3.jpg has no usable exposure in its EXIF"]), "{:?}", merged.warnings());
        assert_eq!(sources(&merged, &["f1.jpg", "f2.jpg", "f3.jpg"]), ["exif", "exif", "estimated"]);
        assert!((stops(&merged, "f2.jpg", "f3.jpg") - 2.0).abs() < 0.4, "{}", stops(&merged, "f2.jpg", "f3.jpg"));
    }
}

/// The time of one frame is wrong by a factor of a million.
#[test]
fn exif_that_is_off_by_a_million_is_not_used() {
    for (num, denom) in [(125_000, 1), (1, 8_000_000)] {
        let folder = Folder::empty();
        let times = [(1, 128), (1, 32), (num, denom)];
        for (i, (num, denom)) in times.into_iter().enumerate() {
            folder.put(&format!("f{}.jpg", i + 1), &timed(&frame(i + 2), num, denom));
        }
        let merged = merged(&folder, "f1.jpg f2.jpg f3.jpg");
        assert!(merged.warns(true, &["contradict the pixels", "-e"]), "{:?}", merged.warnings());
        assert!((stops(&merged, "f2.jpg", "f3.jpg") - 2.0).abs() < 0.4, "{}", stops(&merged, "f2.jpg", "f3.jpg"));
    }
}

#[test]
fn exif_wrong_by_a_stop_is_partly_corrected_with_a_warning() {
    let folder = Folder::empty();
    for (i, denom) in [128, 32, 16].into_iter().enumerate() {
        folder.put(&format!("f{}.jpg", i + 1), &timed(&frame(i + 2), 1, denom));
    }
    let merged = merged(&folder, "f1.jpg f2.jpg f3.jpg");
    assert!(
        merged.warns(true, &["according to the pixels, the exposure should be corrected by", "give -e"]),
        "{:?}",
        merged.warnings()
    );
    assert_eq!(merged.frame("f3.jpg")["exposure_source"], "exif");
}

/// Exposures given by the user are used, with a warning if they are impossible; radiance is always valid.
#[test]
fn exposures_of_the_user_are_used_with_a_warning() {
    let folder = Folder::empty();
    let names = window(&folder, [2, 3, 4]);
    for (ev, is_warned) in [
        ("-2,0,2", false),
        ("2,0,-2", true),
        ("0,0,0", true),
        ("-20,0,20", true),
        ("-2,0,20", true),
        ("-40,0,40", true),
        ("-2,1,2", false),
    ] {
        let merged = merged(&folder, &format!("{names} -e={ev}"));
        assert_eq!(merged.warns(true, &["-e contradict the pixels"]), is_warned, "{ev}: {:?}", merged.warnings());
        assert_eq!(merged.frame("f1.jpg")["exposure_source"], "given");
    }
}

/// A copy of a frame under another name, with the same exposure: the radiance is that of the single frame, no more
/// accurate, and there is a warning.
#[test]
fn copy_of_a_frame_is_merged_with_a_warning() {
    let folder = Folder::empty();
    let names = exposed(&folder, &[(&frame(3), 3), (&frame(3), 3)]);
    let merged = merged(&folder, &names);
    assert!(
        merged.warns(true, &["f2.jpg: has the same pixels as f1.jpg", "leave one of them out"]),
        "{:?}",
        merged.warnings()
    );
    assert_eq!(merged.status("f2.jpg"), "unmoved");
    assert!(merged.confidence("f2.jpg") > 0.9);
    assert_eq!(merged.report["crop"]["width_px"], 300);
    assert_eq!(strict(&folder, &names), 3);
}

/// One photograph with two different exposures counts as one exposure: the radiance is that of the single frame.
#[test]
fn a_copy_with_another_exposure_is_one_exposure() {
    let (one, two) = (Folder::empty(), Folder::empty());
    let honest = merged(&one, &exposed(&one, &[(&frame(3), 3), (&frame(3), 3)]));
    let names = exposed(&two, &[(&frame(3), 2), (&frame(3), 3)]);
    let lying = merged(&two, &names);
    assert!(
        lying.warns(true, &["f2.jpg has the same pixels as f1.jpg", "differs by 2.0 EV"]),
        "{:?}",
        lying.warnings()
    );
    assert_eq!(stops(&lying, "f1.jpg", "f2.jpg"), 0.0);
    assert_eq!(lying.radiance, honest.radiance);
    assert_eq!(strict(&two, &names), 3);
}

/// A copy of a frame with another exposure does not affect the exposures of other frames.
#[test]
fn a_copy_among_others_has_the_exposure_of_its_pixels() {
    let folder = Folder::empty();
    let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (&frame(3), 5)]);
    let merged = merged(&folder, &names);
    assert!(merged.warns(true, &["f3.jpg: has the same pixels as f2.jpg"]), "{:?}", merged.warnings());
    assert!(merged.warns(true, &["contradict the pixels", "estimated"]), "{:?}", merged.warnings());
    assert!(stops(&merged, "f2.jpg", "f3.jpg").abs() < 0.05);
    assert!((stops(&merged, "f1.jpg", "f2.jpg") - 2.0).abs() < 0.6, "{}", stops(&merged, "f1.jpg", "f2.jpg"));
}

/// The bracket has a frame of another scene that is too dark for its exposure: the exposures of the other two, which
/// agree with the pixels, are used.
#[test]
fn one_frame_that_is_at_odds_does_not_affect_the_others() {
    let folder = Folder::empty();
    let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (&elsewhere(1), 5)]);
    let merged = merged(&folder, &names);
    assert!(
        merged.warns(true, &["contradict the pixels", "the exposure of f3.jpg is ignored"]),
        "{:?}",
        merged.warnings()
    );
    assert_eq!(sources(&merged, &["f1.jpg", "f2.jpg", "f3.jpg"]), ["exif", "exif", "estimated"]);
    assert!((stops(&merged, "f1.jpg", "f2.jpg") - 2.0).abs() < 1e-6, "{}", stops(&merged, "f1.jpg", "f2.jpg"));
    assert_eq!(merged.status("f3.jpg"), "rejected");
}

#[test]
fn equal_frames_without_exif_need_exposures() {
    let folder = Folder::empty();
    let names = lossless(&folder, &[&frame(3), &frame(3)]);
    refused(&folder, &names, &["f1.png", "no usable exposure", "equally bright", "-e"]);
}

/// All frames except one are black or clipped: there is nothing to merge.
#[test]
fn all_but_one_clipped_or_black_is_refused() {
    let (white, black) = (RgbImage::from_pixel(300, 200, Rgb([255; 3])), RgbImage::new(300, 200));
    let middle = frame(3);
    for pictures in [
        [(&middle, 3), (&white, 4), (&white, 5)],
        [(&black, 1), (&black, 2), (&middle, 3)],
        [(&black, 1), (&middle, 3), (&white, 5)],
    ] {
        let folder = Folder::empty();
        let names = exposed(&folder, &pictures);
        let reference = format!("f{}.jpg", 1 + pictures.iter().position(|p| p.1 == 3).expect("the middle"));
        refused(&folder, &names, &[&format!("{reference}: no other frame was aligned"), "--align none"]);
        // With --align none they are merged, although black and clipped.
        let lain = merged(&folder, &format!("{names} --align none"));
        assert_eq!(lain.report["crop"]["width_px"], 300);
    }
}

/// One blank frame with two good ones is rejected.
#[test]
fn a_blank_frame_beside_good_ones_is_left_out() {
    for (blank, at) in [(0, 1), (255, 5)] {
        let folder = Folder::empty();
        let picture = RgbImage::from_pixel(300, 200, Rgb([blank; 3]));
        let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (&picture, at)]);
        let merged = merged(&folder, &names);
        assert_eq!(merged.status("f3.jpg"), "rejected");
        assert!(merged.warns(true, &["f3.jpg: rejected"]), "{:?}", merged.warnings());
        assert!(merged.confidence("f1.jpg").min(merged.confidence("f2.jpg")) > 0.8);
    }
}

/// The lamp is 1000 times as bright as white in the frame of 1 s: only the frame of 1/2000 s, which is black except for
/// the lamp, shows its brightness.
#[test]
fn a_black_frame_of_a_still_camera_is_assumed_and_has_the_lamp() {
    let picture = frame(4);
    let is_lamp = |x: u32, y: u32| x.abs_diff(90) < 8 && y.abs_diff(60) < 8;
    // The picture shows a room with radiance from 0 to 1.
    let code = |radiance: f64| (255.0 * radiance.min(1.0).powf(1.0 / 2.2) + 0.5) as u8;
    let taken = |time: f64| {
        RgbImage::from_fn(300, 200, |x, y| {
            let room = picture.get_pixel(x, y).0.map(|v| (f64::from(v) / 255.0).powf(2.2));
            Rgb(room.map(|v| code(time * if is_lamp(x, y) { 1000.0 } else { v })))
        })
    };
    let folder = Folder::empty();
    let times = [(1, 2000), (1, 4), (1, 1), (4, 1)];
    for (n, (num, denom)) in times.into_iter().enumerate() {
        folder.put(&format!("f{n}.jpg"), &timed(&taken(f64::from(num) / f64::from(denom)), num, denom));
    }
    let names = "f0.jpg f1.jpg f2.jpg f3.jpg";
    let found = merged(&folder, &format!("{names} --response-model srgb --strict"));
    // The frame is aligned by the tile of the lamp, or assumed from the other frames.
    let status = found.status("f0.jpg");
    assert!(["assumed", "unmoved"].contains(&status), "{status}");
    // Without f0.jpg, the shortest frame (1/4 s) clips at radiance 4, which is 1/250 of that of the lamp.
    let brightest = |merged: &Merged| merged.radiance.iter().map(|p| p[1]).fold(0.0, f32::max);
    let without = merged(&folder, &format!("{names} --response-model srgb --leave-out f0.jpg"));
    let factor = brightest(&found) / brightest(&without);
    assert!((factor / 250.0 - 1.0).abs() < 0.3, "{factor}");
}

/// Returns `picture` with the light of a flash on near objects.
fn lit(mut picture: RgbImage) -> RgbImage {
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        let near = libm::exp(-((f64::from(x) - 150.0).powi(2) + (f64::from(y) - 100.0).powi(2)) / 8000.0);
        pixel.0 = pixel.0.map(|code| (f64::from(code) + 160.0 * near).min(255.0) as u8);
    }
    picture
}

/// Writes three frames, and one with flash and the exposure of the first; returns the names.
fn with_flash(folder: &Folder) -> &'static str {
    for (i, denom) in [128, 32, 8].into_iter().enumerate() {
        folder.put(&format!("f{}.jpg", i + 1), &timed(&frame(i + 2), 1, denom));
    }
    folder.put("flash.jpg", &shot(&lit(frame(2)), (1, 128), true));
    "f1.jpg f2.jpg f3.jpg flash.jpg"
}

#[test]
fn flash_in_one_frame_excludes_it_and_the_others_keep_their_exif() {
    let folder = Folder::empty();
    let names = with_flash(&folder);
    let alone = merged(&folder, "f1.jpg f2.jpg f3.jpg");
    let merged = merged(&folder, names);
    assert!(merged.warns(true, &["flash.jpg: the flash fired", "excluded", "-e"]), "{:?}", merged.warnings());
    assert_eq!(merged.warnings().len(), 1, "{:?}", merged.warnings());
    assert_eq!(merged.status("flash.jpg"), "rejected");
    assert_eq!(sources(&merged, &["f1.jpg", "f2.jpg", "f3.jpg", "flash.jpg"]), ["exif"; 4]);
    assert_eq!(merged.radiance, alone.radiance);
    assert_eq!(strict(&folder, names), 3);
}

#[test]
fn flash_frame_is_merged_where_the_user_insists_or_too_few_are_left() {
    let folder = Folder::empty();
    let names = with_flash(&folder);
    let given = merged(&folder, &format!("{names} -e=-2,0,2,-1 --align none"));
    assert!(
        given.status("flash.jpg") != "rejected" && !given.warns(true, &["the flash fired"]),
        "{:?}",
        given.warnings()
    );
    let reference = merged(&folder, &format!("{names} --reference flash.jpg --align none"));
    assert_eq!(reference.status("flash.jpg"), "reference");
    assert!(reference.warns(true, &["flash.jpg: the flash fired", "merged anyway"]), "{:?}", reference.warnings());
    let unmoved = merged(&folder, &format!("{names} --unmoved flash.jpg"));
    assert_eq!(unmoved.status("flash.jpg"), "unmoved");
    assert!(unmoved.warns(true, &["flash.jpg: the flash fired", "merged anyway"]), "{:?}", unmoved.warnings());
    let left_out = merged(&folder, &format!("{names} --leave-out flash.jpg"));
    assert!(left_out.warnings().is_empty(), "{:?}", left_out.warnings());
    let two = merged(&folder, "f2.jpg flash.jpg --align none");
    assert!(two.status("flash.jpg") != "rejected");
    assert!(two.warns(true, &["flash.jpg: the flash fired", "merged anyway"]), "{:?}", two.warnings());
}

#[test]
fn flash_frame_without_an_exposure_gets_an_estimate_that_does_not_depend_on_the_order() {
    let folder = Folder::empty();
    with_flash(&folder);
    let fired = [(Tag::Flash, exif::Value::Short(vec![0x19]))];
    folder.put("flash.jpg", &jpeg_with(&lit(frame(2)), &fired));
    let merged_with = |names: &str| merged(&folder, &format!("{names} --unmoved flash.jpg"));
    let (one, other) = (merged_with("f1.jpg f2.jpg f3.jpg flash.jpg"), merged_with("f3.jpg flash.jpg f1.jpg f2.jpg"));
    assert_eq!(sources(&one, &["f1.jpg", "f2.jpg", "f3.jpg", "flash.jpg"]), ["exif", "exif", "exif", "estimated"]);
    assert_eq!(one.radiance, other.radiance);
}

#[test]
fn exif_one_frame_wrong_only_that_frame_is_estimated() {
    // For each of four frames: its exposure time is far too long, or far too short.
    let times = [(1, 512), (1, 128), (1, 32), (1, 8)];
    for odd in 0..4 {
        for factor in [(4000, 1), (1, 4000)] {
            let folder = Folder::empty();
            for (i, (num, denom)) in times.into_iter().enumerate() {
                let by = if i == odd { factor } else { (1, 1) };
                folder.put(&format!("f{}.jpg", i + 1), &timed(&frame(i + 1), num * by.0, denom * by.1));
            }
            let merged = merged(&folder, "f1.jpg f2.jpg f3.jpg f4.jpg");
            let wrong = format!("the exposure of f{}.jpg is ignored", odd + 1);
            assert!(merged.warns(true, &["contradict the pixels", &wrong]), "{:?}", merged.warnings());
            let files = ["f1.jpg", "f2.jpg", "f3.jpg", "f4.jpg"];
            let expected: Vec<&str> = (0..4).map(|i| if i == odd { "estimated" } else { "exif" }).collect();
            assert_eq!(sources(&merged, &files), expected);
            for pair in files.windows(2) {
                let seen = stops(&merged, pair[0], pair[1]);
                assert!((seen - 2.0).abs() < 0.6, "{odd} {factor:?}, {pair:?}: {seen}");
            }
        }
    }
}
