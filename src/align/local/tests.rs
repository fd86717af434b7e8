//! Tests of local displacements, with scenes in which a part moves.

use super::*;
use crate::align::agreement::pattern::Pattern;
use crate::align::agreement::warped::{Part, Warped};
use crate::align::grey::GreyPyramid;
use crate::align::local::matching;
use crate::align::refinement::FramePair;
use crate::align::scene::{Scene, Shot, photograph, rigid, uniform};
use crate::align::transform::{Transform, distance};
use crate::plane::Plane;

const SIZE: (usize, usize) = (640, 448);

/// Returns a reference and a frame of a scene. In the frame, the columns from `edge` on are displaced by `moved` pixels
/// to the right, in addition to the motion `truth` of the camera.
fn pair_with_depth(edge: f64, moved: f64, noise: f64, truth: &Transform) -> (GreyPyramid, GreyPyramid) {
    let scene = Scene::new(57);
    let shot = |ev, seed| Shot { noise, seed, ..Shot::at(ev) };
    let reference = scene.photograph(SIZE, &Transform::Identity, shot(0.0, 1));
    let near = |x: f64, y: f64| scene.radiance(if x >= edge + moved { x - moved } else { x }, y);
    (GreyPyramid::new(reference), GreyPyramid::new(photograph(SIZE, truth, shot(1.0, 2), near)))
}

fn misfit(edge: f64, moved: f64, noise: f64, truth: &Transform) -> field::Misfit {
    let (reference, frame) = pair_with_depth(edge, moved, noise, truth);
    LocalField::new(&FramePair::new(&reference, &frame, truth), truth).misfit()
}

#[test]
fn share_and_displacement_of_a_near_object_are_measured() {
    let truth = rigid(3.0, -2.0, 0.4);
    for moved in [4.0, 12.0] {
        let found = misfit(480.0, moved, 1.5, &truth);
        // A quarter of the picture moves. A patch within 24 of the 640 columns from the border between the moving and
        // the still part may count as either, and up to 25 columns at the right border of the reference are outside the
        // frame, or their patches are. This explains the range.
        assert!((0.25 - 0.07..0.25 + 0.06).contains(&found.displaced.fraction), "{moved}: {found:?}");
        assert!((found.displaced.px - moved).abs() < 0.3, "{moved}: {found:?}");
        let rms = moved * found.displaced.fraction.sqrt();
        assert!((found.rms_px - rms).abs() < 0.1 * rms, "{moved}: {found:?}");
    }
}

#[test]
fn leaves_that_move_each_by_itself_are_displaced() {
    let scene = Scene::new(57);
    let shot = |ev, seed| Shot { noise: 1.5, seed, ..Shot::at(ev) };
    let reference = GreyPyramid::new(scene.photograph(SIZE, &Transform::Identity, shot(0.0, 1)));
    // In the right half, squares of 36 pixels are displaced by 2.6 pixels, each in another direction. Single patches are
    // searched within 3 pixels.
    let moved = |x: f64, y: f64| {
        let [column, row] = [x, y].map(|v| (v / 36.0).floor() as i64);
        let (sin, cos) = libm::sincos(6.3 * uniform(4, column, row));
        if x < 320.0 { scene.radiance(x, y) } else { scene.radiance(x + 2.6 * cos, y + 2.6 * sin) }
    };
    let frame = GreyPyramid::new(photograph(SIZE, &Transform::Identity, shot(1.0, 2), moved));
    let pair = FramePair::new(&reference, &frame, &Transform::Identity);
    let found = LocalField::new(&pair, &Transform::Identity).misfit();
    // Many patches show several squares, and do not match.
    assert!(found.displaced_surely > 0.05 && (found.displaced.px - 2.6).abs() < 0.3, "{found:?}");
}

#[test]
fn frame_that_its_transform_fits_has_no_misfit_whatever_its_noise() {
    let truth = rigid(-4.0, 1.0, -0.3);
    for noise in [0.0, 1.5, 6.0, 15.0] {
        let found = misfit(1e9, 0.0, noise, &truth);
        assert!(found.displaced.fraction < 0.005 && found.rms_px < 0.15, "{noise}: {found:?}");
    }
}

#[test]
fn compromise_between_two_motions_is_replaced_by_the_motion_of_the_larger_part() {
    // Three fifths of the picture have the motion `truth`, the rest moves by 6 pixels more.
    let truth = rigid(3.0, -2.0, 0.4);
    let (reference, frame) = pair_with_depth(384.0, 6.0, 1.5, &truth);
    let compromise = rigid(5.4, -2.0, 0.4);
    let pair = FramePair::new(&reference, &frame, &compromise);
    let field = LocalField::new(&pair, &compromise);
    let (dominant, error_px) = field.dominant().unwrap();
    // Patches at the edge between the two parts fit neither motion and increase the error.
    let off = distance(&dominant.transform(), &truth, SIZE.0, SIZE.1);
    assert!(off < 0.3 && error_px < 1.0, "{off} {error_px}");
    let (before, after) = (field.misfit().displaced.fraction, dominant.misfit().displaced.fraction);
    assert!(before > 0.9 && (after - 0.4).abs() < 0.06, "{before} {after}");
    // No other motion fits more of the picture.
    assert!(dominant.dominant().is_none());
}

#[test]
fn caption_that_does_not_move_with_the_scene_is_not_displaced() {
    let truth = rigid(14.0, -9.0, 0.3);
    let (reference, frame) = pair_with_depth(1e9, 0.0, 1.5, &truth);
    // The lower sixth of both photographs has the same grey values, whatever the exposure.
    let caption = |x: usize, y: usize| if uniform(5, (x / 7) as i64, (y / 9) as i64) < 0.4 { 205 } else { 60 };
    let labelled = |grey: &Plane<u8>| {
        GreyPyramid::new(Plane::from_rows(SIZE.0, SIZE.1, |y, row| {
            row.copy_from_slice(grey.row(y));
            if y >= 5 * SIZE.1 / 6 {
                row.iter_mut().enumerate().for_each(|(x, v)| *v = caption(x, y));
            }
        }))
    };
    let (reference, frame) = (labelled(reference.level(0)), labelled(frame.level(0)));
    let found = LocalField::new(&FramePair::new(&reference, &frame, &truth), &truth).misfit();
    // Beside the caption, patches contain parts of the caption and of the scene. The displacement there is not known.
    assert!(found.displaced.fraction == 0.0 && found.rms_px < 0.1, "{found:?}");
    // If the identity is given as the transform, it fits the caption, but most of the scene is displaced.
    let unmoved = LocalField::new(&FramePair::new(&reference, &frame, &Transform::Identity), &Transform::Identity);
    assert!(unmoved.misfit().displaced.fraction > 0.7, "{:?}", unmoved.misfit());
}

/// Noise that is the same along each column, over a scene of horizontal grain: a patch also matches where its columns
/// stayed, because the grain is the same along each row.
#[test]
fn columns_that_do_not_move_with_the_scene_are_not_displaced() {
    let scene = Scene::new(57);
    let truth = Transform::Rigid { dx: 12.0, dy: -9.0, angle: 0.0 };
    // On the left there is only grain, on the right the scene itself.
    let radiance = |x: f64, y: f64| scene.radiance(if x < 180.0 { 0.02 * x } else { x }, y);
    let take = |transform, ev| {
        let grey = photograph(SIZE, transform, Shot::at(ev), radiance);
        let gain = |x: usize| 1.0 + 0.2 * (uniform(5, x as i64 / 2, 0) as f32 - 0.5);
        GreyPyramid::new(Plane::from_rows(SIZE.0, SIZE.1, |y, row| {
            row.iter_mut().zip(grey.row(y)).enumerate().for_each(|(x, (v, &g))| *v = (gain(x) * f32::from(g)) as u8);
        }))
    };
    let (reference, frame) = (take(&Transform::Identity, 0.0), take(&truth, 0.5));
    let found = LocalField::new(&FramePair::new(&reference, &frame, &truth), &truth).misfit();
    assert!(found.displaced.fraction < 0.01 && found.rms_px < 0.15, "{found:?}");
}

/// A picture that is large enough for a finer level, with bars of 40 px in front of the scene, 200 px apart, that move
/// by 6 px more than the scene. A cell uses the patches in a square around it, whose side is 96 px on the measured
/// level and 48 px on the finer one.
#[test]
fn on_the_finer_level_more_places_show_one_of_two_motions() {
    let size = (1200, 800);
    let (scene, bars) = (Scene::new(57), Scene::new(58));
    let is_bar = |x: f64| x.rem_euclid(200.0) < 40.0;
    let take = |moved: f64, shot| {
        let radiance = |x: f64, y: f64| {
            if is_bar(x - moved) { bars.radiance(x - moved, y) } else { scene.radiance(x, y) }
        };
        GreyPyramid::new(photograph(size, &Transform::Identity, shot, radiance))
    };
    let (reference, frame) = (take(0.0, Shot::at(0.0)), take(6.0, Shot::at(1.0)));
    let pair = FramePair::new(&reference, &frame, &Transform::Identity);
    let coarse = LocalField::new(&pair, &Transform::Identity);
    let fine = coarse.on_finer_level(&pair).unwrap();
    // Share of the cells that have moved like the scene or like the bars, to within a pixel.
    let one_motion = |field: &LocalField| {
        let off = |c: &cell::Cell, moved: f64| {
            let [x, y] = c.displacement.map(|d| d * field.scale());
            (x - moved).hypot(y)
        };
        let fits = field.cells.iter().filter(|c| off(c, 0.0).min(off(c, 6.0)) < 1.0).count();
        fits as f64 / field.cells.len() as f64
    };
    let (before, after) = (one_motion(&coarse), one_motion(&fine));
    assert!(after > before + 0.1, "{before} {after}");
    // Nothing is displaced: there is no reason for a finer level.
    let still = LocalField::new(&FramePair::new(&reference, &reference, &Transform::Identity), &Transform::Identity);
    assert!(still.on_finer_level(&pair).is_none());
}

#[test]
fn black_frame_has_no_misfit() {
    let scene = Scene::new(57);
    let take = |ev| GreyPyramid::new(scene.photograph(SIZE, &Transform::Identity, Shot::at(ev)));
    let (reference, frame) = (take(0.0), take(-12.0));
    let pair = FramePair::new(&reference, &frame, &Transform::Identity);
    assert_eq!(LocalField::new(&pair, &Transform::Identity).misfit(), field::Misfit::default());
}

/// The expected shift of each patch comes from a search of all shifts within 20 px on the finest level.
#[test]
fn coarse_to_fine_finds_what_a_full_search_finds() {
    let (reference, frame) = pair_with_depth(320.0, 9.0, 1.5, &Transform::Identity);
    let pair = FramePair::new(&reference, &frame, &Transform::Identity);
    let found = matching::far(&pair, &Transform::Identity.matrix(SIZE.0, SIZE.1));
    let both = pair.level(0);
    let h = Transform::Identity.matrix(SIZE.0, SIZE.1);
    let reach = 20;
    let warped = Warped::new(&both.frame, &h, SIZE, reach as usize);
    let (mut same, mut all) = (0, 0);
    // Every seventh patch is compared, except near the borders, where shifts lead outside the frame.
    for i in (0..found.all.len()).step_by(7) {
        let [x, y] = found.centre(i).map(|at| (at - 7.5) as usize);
        let is_inner = x > 32 && y > 32 && x + 48 < SIZE.0 && y + 48 < SIZE.1;
        let Some(displacement) = found.all[i].and_then(|m| m.displacement()).filter(|_| is_inner) else { continue };
        let Some(pattern) = Pattern::new(both, Part::square(x, y, 16)) else { continue };
        let shifts = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
        let best = shifts
            .map(|shift| (pattern.correlation(&warped, shift), shift))
            .reduce(|best, other| if other.0 > best.0 { other } else { best });
        let Some((_, (dx, dy))) = best else { continue };
        let [xx, xy, yy] = displacement.sharpness;
        let expected = [xx * dx as f64 + xy * dy as f64, xy * dx as f64 + yy * dy as f64];
        all += 1;
        // The pull is the sharpness times the displacement. The limit corresponds to an error of one pixel in each
        // direction.
        let off = [displacement.pull[0] - expected[0], displacement.pull[1] - expected[1]];
        same += usize::from(off[0].abs() <= xx + xy.abs() && off[1].abs() <= yy + xy.abs());
    }
    // A twentieth may differ: some patches contain the edge between the two motions.
    assert!(all > 50 && same * 20 >= all * 19, "{same} of {all}");
}
