//! Frames of different scenes; mirrored, rotated and enlarged frames; motion.

use super::*;
use image::imageops::{self, FilterType};

/// Merges two good frames and the wrong frame `stray`. Checks that `stray` is rejected, with low confidence and a
/// reason, for any choice of the reference, and that the good frames are aligned as without it.
fn stray_is_left_out(stray: &RgbImage, exif: usize) {
    let alone = {
        let folder = Folder::empty();
        let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3)]);
        merged(&folder, &names)
    };
    let folder = Folder::empty();
    let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (stray, exif)]);
    let merged = merged(&folder, &names);
    assert_eq!(merged.status("f3.jpg"), "rejected", "{:?}", merged.warnings());
    assert!(merged.confidence("f3.jpg") < 0.35, "{}", merged.confidence("f3.jpg"));
    assert!(merged.warns(true, &["f3.jpg: rejected"]), "{:?}", merged.warnings());
    for file in ["f1.jpg", "f2.jpg"] {
        assert!(merged.confidence(file) > 0.9 && apart(&merged, &alone, file) < 1e-9, "{file}");
    }
    assert_eq!(merged.radiance, alone.radiance, "the stray shows in the radiance");
    assert_eq!(strict(&folder, &names), 3);
}

#[test]
fn a_frame_of_another_scene_is_left_out() {
    stray_is_left_out(&elsewhere(4), 4);
}

#[test]
fn a_mirrored_frame_is_left_out() {
    stray_is_left_out(&imageops::flip_horizontal(&frame(4)), 4);
}

#[test]
fn an_upside_down_frame_is_left_out() {
    stray_is_left_out(&imageops::rotate180(&frame(4)), 4);
}

#[test]
fn a_frame_of_another_zoom_is_left_out() {
    let large = imageops::resize(&frame(4), 750, 500, FilterType::CatmullRom);
    stray_is_left_out(&imageops::crop_imm(&large, 225, 150, 300, 200).to_image(), 4);
}

/// A camera held by hand, or focus breathing, can make a frame appear 15 % closer; it is aligned.
#[test]
fn a_frame_a_little_closer_is_aligned() {
    let folder = Folder::empty();
    let large = imageops::resize(&frame(3), 345, 230, FilterType::CatmullRom);
    let closer = imageops::crop_imm(&large, 22, 15, 300, 200).to_image();
    let names = exposed(&folder, &[(&frame(2), 2), (&closer, 3), (&frame(4), 4)]);
    let merged = merged(&folder, &names);
    for file in ["f1.jpg", "f2.jpg", "f3.jpg"] {
        assert!(merged.status(file) != "rejected" && merged.confidence(file) > 0.8, "{}", merged.frame(file));
    }
}

#[test]
fn a_frame_turned_by_90_degrees_is_left_out_or_of_another_size() {
    let square = |i: usize| imageops::crop_imm(&frame(i), 50, 0, 200, 200).to_image();
    let folder = Folder::empty();
    let names = exposed(&folder, &[(&square(2), 2), (&square(3), 3), (&imageops::rotate90(&square(4)), 4)]);
    let squares = merged(&folder, &names);
    assert_eq!(squares.status("f3.jpg"), "rejected");
    assert!(squares.confidence("f1.jpg").min(squares.confidence("f2.jpg")) > 0.9);

    let folder = Folder::empty();
    let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (&imageops::rotate90(&frame(4)), 4)]);
    refused(&folder, &names, &["f3.jpg", "200x300", "f1.jpg", "300x200", "the same size"]);
}

/// All frames show different scenes: whatever the reference is, nothing can be merged.
#[test]
fn frames_of_different_scenes_are_refused() {
    let folder = Folder::empty();
    let other = imageops::rotate180(&elsewhere(3));
    let names = exposed(&folder, &[(&frame(2), 2), (&other, 3), (&elsewhere(4), 4)]);
    refused(&folder, &names, &["no other frame was aligned", "choose another reference with --reference"]);
    let two = "f1.jpg f3.jpg";
    refused(&folder, two, &["no other frame was aligned"]);
}

/// Two of five frames show another scene, and one of these two has the most usable pixels of all: the other three are
/// merged.
#[test]
fn the_scene_of_most_frames_is_merged() {
    let folder = Folder::empty();
    let (dark, bright) = (elsewhere(2), elsewhere(4));
    let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (&frame(4), 4), (&dark, 2), (&bright, 4)]);
    let merged = merged(&folder, &names);
    for (file, is_left_out) in
        [("f1.jpg", false), ("f2.jpg", false), ("f3.jpg", false), ("f4.jpg", true), ("f5.jpg", true)]
    {
        assert_eq!(merged.status(file) == "rejected", is_left_out, "{file}");
    }
}

/// A reference chosen by the user is kept, even if it is wrong.
#[test]
fn the_users_reference_is_not_exchanged() {
    let folder = Folder::empty();
    let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (&elsewhere(4), 4)]);
    refused(&folder, &format!("{names} --reference f3.jpg"), &["f3.jpg: no other frame was aligned to it"]);
}

/// The middle of the picture is different in each frame: the rest of the picture determines the motion.
#[test]
fn different_centre_in_each_frame_does_not_affect_alignment() {
    let (good, bad) = (Folder::empty(), Folder::empty());
    let truth = merged(&good, &exposed(&good, &[(&frame(2), 2), (&frame(3), 3), (&frame(4), 4)]));
    let crowd = |i: usize| {
        let mut random = Random(i as u64);
        let mut picture = frame(i);
        for (x, y) in (0..20).flat_map(|x| (0..13).map(move |y| (80 + 7 * x, 50 + 7 * y))) {
            let coat = Rgb([0; 3].map(|_| (230.0 * random.next()) as u8));
            (0..49).for_each(|k| picture.put_pixel(x + k % 7, y + k / 7, coat));
        }
        picture
    };
    let names = exposed(&bad, &[(&crowd(2), 2), (&crowd(3), 3), (&crowd(4), 4)]);
    for options in ["", "--deghost"] {
        let merged = merged(&bad, &format!("{names} --reference f3.jpg {options}"));
        for file in ["f1.jpg", "f2.jpg"] {
            assert_eq!(merged.status(file), "aligned", "{file} {options}");
            // The true motion is 3 to 5 pixels; only half of the tiles show it.
            let off = apart(&merged, &truth, file);
            assert!(off < 1.0, "{file} {options}: {off}");
        }
    }
}
