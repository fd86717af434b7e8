//! Frames with defects of the camera: dead rows and columns, hot pixels, shutter and flash, noise.

use super::*;

/// Merges the bracket without defects, for comparison; the reference is the third frame.
fn truth() -> Merged {
    let folder = Folder::empty();
    let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (&frame(4), 4)]);
    merged(&folder, &format!("{names} --reference f3.jpg"))
}

/// Merges the frames after `damaged` changed them. Checks that all are aligned as without damage, to within `most`
/// pixels in every corner.
fn places_hold(damaged: impl Fn(&mut RgbImage, usize), most: f64, least_confidence: f64) -> Merged {
    let folder = Folder::empty();
    let frames: Vec<RgbImage> = (2..=4)
        .map(|i| {
            let mut picture = frame(i);
            damaged(&mut picture, i);
            picture
        })
        .collect();
    let names = exposed(&folder, &[(&frames[0], 2), (&frames[1], 3), (&frames[2], 4)]);
    let merged = merged(&folder, &format!("{names} --reference f3.jpg"));
    let truth = truth();
    for file in ["f1.jpg", "f2.jpg"] {
        assert_eq!(merged.status(file), "aligned", "{file}");
        let off = apart(&merged, &truth, file);
        assert!(off < most, "{file} is off by {off} px");
        assert!(merged.confidence(file) > least_confidence, "{file}: {}", merged.confidence(file));
    }
    merged
}

#[test]
fn dead_row_or_column_does_not_affect_alignment() {
    places_hold(|picture, _| (0..300).for_each(|x| picture.put_pixel(x, 90, Rgb([0; 3]))), 0.3, 0.8);
    places_hold(|picture, _| (0..200).for_each(|y| picture.put_pixel(120, y, Rgb([255; 3]))), 0.3, 0.8);
    // A dead row in only one frame of three.
    places_hold(
        |picture, i| {
            let is_dead = i == 3;
            (0..300).filter(|_| is_dead).for_each(|x| picture.put_pixel(x, 90, Rgb([0; 3])));
        },
        0.3,
        0.8,
    );
}

/// Hot pixels stay at their positions on the sensor while the camera moves by three to five pixels: an alignment to the
/// hot pixels would find no motion.
#[test]
fn hot_pixels_do_not_affect_alignment() {
    let hot = |picture: &mut RgbImage, _| {
        let mut random = Random(5);
        for _ in 0..300 {
            let (x, y) = ((300.0 * random.next()) as u32, (200.0 * random.next()) as u32);
            picture.put_pixel(x, y, Rgb([255; 3]));
        }
    };
    let merged = places_hold(hot, 0.4, 0.8);
    let moved = merged.frame("f1.jpg")["alignment"]["shift_px"][1].as_f64().expect("a number");
    assert!(moved.abs() > 3.0, "{moved}");
    // Hot pixels in frames at night, in which little else is bright.
    let folder = Folder::empty();
    let frames: Vec<RgbImage> = (2..=4)
        .map(|i| {
            let mut night = times(&frame(i), 0.15);
            hot(&mut night, i);
            night
        })
        .collect();
    let names = exposed(&folder, &[(&frames[0], 2), (&frames[1], 3), (&frames[2], 4)]);
    let night = super::merged(&folder, &format!("{names} --reference f3.jpg"));
    for file in ["f1.jpg", "f2.jpg"] {
        assert!(apart(&night, &truth(), file) < 1.0, "{file} is off by {} px", apart(&night, &truth(), file));
    }
}

/// The shutter or flash left half of a frame black: the other frames are not affected, and fill the black half.
#[test]
fn half_black_frame_does_not_affect_the_result() {
    let folder = Folder::empty();
    let mut half = frame(4);
    (0..300 * 100).for_each(|i| half.put_pixel(i % 300, 100 + i / 300, Rgb([0; 3])));
    let names = exposed(&folder, &[(&frame(2), 2), (&frame(3), 3), (&half, 4)]);
    let merged = merged(&folder, &names);
    for file in ["f1.jpg", "f2.jpg"] {
        assert!(merged.confidence(file) > 0.9, "{file}");
    }
    let lit = merged.picture.enumerate_pixels().filter(|(_, y, _)| *y > 120).map(|(_, _, p)| f64::from(p.0[1]));
    let lit: Vec<f64> = lit.collect();
    let mean = lit.iter().sum::<f64>() / lit.len() as f64;
    assert!(mean > 50.0, "the lower half is dark: {mean}");
}

/// Frames of a very noisy night are aligned to within three pixels in every corner, or rejected; they are never aligned
/// wrongly with high confidence.
#[test]
fn a_noisy_night_is_aligned_or_uncertain() {
    for most in [10.0, 25.0, 60.0] {
        let folder = Folder::empty();
        let frames: Vec<RgbImage> = (2..=4).map(|i| Random(i as u64).noisy(&times(&frame(i), 0.3), most)).collect();
        let names = exposed(&folder, &[(&frames[0], 2), (&frames[1], 3), (&frames[2], 4)]);
        let run = folder.line(&format!("merge {names} --reference f3.jpg -o a.exr -o a.png --report r.json"));
        if run.code == 1 {
            assert!(run.stderr.contains("f3.jpg: no other frame was aligned"), "{}", run.stderr);
            assert!(most > 30.0, "{most} codes of noise are too many: {}", run.stderr);
            continue;
        }
        let merged = merged(&folder, &format!("{names} --reference f3.jpg"));
        for file in ["f1.jpg", "f2.jpg"] {
            if merged.status(file) == "rejected" || merged.confidence(file) < 0.5 {
                assert!(merged.warnings().iter().any(|w| w.contains(file)), "{file}: {:?}", merged.warnings());
            } else {
                let off = apart(&merged, &truth(), file);
                assert!(off < 3.0, "{most}: {file} is off by {off} px, confidence {}", merged.confidence(file));
            }
        }
    }
}

/// Two frames of a static scene with equal exposure and different noise give less noise together than one alone.
#[test]
fn noise_is_less_in_two_frames_than_in_one() {
    let folder = Folder::empty();
    let clean = frame(3);
    let noisy = [1, 2].map(|seed| Random(seed).noisy(&clean, 12.0));
    let names = lossless(&folder, &[&noisy[0], &noisy[1]]);
    let options = "--response-model srgb --align none --exposures as-given";
    let both = merged(&folder, &format!("{names} -e=0,0 {options}"));
    let twice = {
        let folder = Folder::empty();
        let names = lossless(&folder, &[&noisy[0], &noisy[0]]);
        merged(&folder, &format!("{names} -e=0,0 {options}"))
    };
    let pure = {
        let folder = Folder::empty();
        let names = lossless(&folder, &[&clean, &clean]);
        merged(&folder, &format!("{names} -e=0,0 {options}"))
    };
    let error = |merged: &Merged| {
        let pairs = merged.radiance.iter().zip(&pure.radiance).filter(|(_, p)| p[1] > 0.2 && p[1] < 2.0);
        let logs: Vec<f64> = pairs.map(|(a, b)| f64::from((a[1] / b[1]).log2()).powi(2)).collect();
        (logs.iter().sum::<f64>() / logs.len() as f64).sqrt()
    };
    let (one, two) = (error(&twice), error(&both));
    // The mean of two frames reduces independent noise at best by the square root of two, to 0.71.
    assert!(two < 0.8 * one, "{two} is not less than {one}");
}
