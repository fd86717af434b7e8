//! Agreement with true transforms, and with transforms that have a known error.

use super::*;
use crate::align::photometric::ToneTables;
use crate::align::scene::{Scene, Shot, photograph, rigid, shift};
use crate::align::transform::Transform;
use crate::plane::Plane;

const SIZE: (usize, usize) = (480, 320);

/// Returns the agreement of two exposures with the transform `claimed`.
fn agreement_of(reference: &Plane<u8>, frame: &Plane<u8>, claimed: &Transform) -> Agreement {
    let h = claimed.matrix(SIZE.0, SIZE.1);
    check_tiles(&CommonExposure::new(reference, frame, &ToneTables::between(reference, frame, &h)), &h).agreement
}

fn taken(transform: &Transform, ev: f64) -> Plane<u8> {
    Scene::new(31).photograph(SIZE, transform, Shot::at(ev))
}

#[test]
fn the_truth_is_borne_out_and_errors_are_measured() {
    let truth = rigid(4.3, -2.2, 0.6);
    for (a, b) in [(-1.0, 1.0), (1.0, -1.0)] {
        let (reference, frame) = (taken(&Transform::Identity, a), taken(&truth, b));
        let right = agreement_of(&reference, &frame, &truth);
        let tiles = right.agreeing + right.disagreeing + right.undecided;
        assert_eq!(tiles, 16 * 10, "480 x 320 in tiles of 30");
        assert!(right.disagreeing == 0 && 2 * right.agreeing > tiles, "{right:?}");
        // The position of a tile of 900 pixels is measured with an error of some hundredths of a pixel
        // (`TILE_NOISE_PX`).
        assert!(right.offset < 0.1, "{right:?}");
        // Here the transform is off by (0.3, -0.4), which is half a pixel. All tiles must measure this.
        let near = agreement_of(&reference, &frame, &rigid(4.3 + 0.3, -2.2 - 0.4, 0.6));
        assert!(near.disagreeing == 0 && (near.offset - 0.5).abs() < 0.1, "{near:?}");
        // Here it is off by five pixels, which is beyond the search range of the tiles.
        let far = agreement_of(&reference, &frame, &rigid(4.3 + 3.0, -2.2 - 4.0, 0.6));
        assert!(far.disagreeing > 2 * far.agreeing, "{far:?}");
        assert!(far.share() < 0.35 && right.share() > 0.9);
    }
}

#[test]
fn moving_object_contradicts_only_in_its_tiles() {
    let scene = Scene::new(31);
    // Tiles are 30 px wide. The moving object covers 4 x 3 tiles. It may also affect the ring of tiles around them, so
    // at most 6 x 5 tiles disagree.
    let with_mover = |x: f64, y: f64| {
        let inside = (150.0..270.0).contains(&x) && (90.0..180.0).contains(&y);
        scene.radiance(if inside { x + 40.0 } else { x }, y)
    };
    let frame = photograph(SIZE, &Transform::Identity, Shot::at(1.0), with_mover);
    let found = agreement_of(&taken(&Transform::Identity, 0.0), &frame, &Transform::Identity);
    assert!((6..=30).contains(&found.disagreeing), "{found:?}");
    assert!(found.agreeing > 80 && found.offset < 0.1, "{found:?}");
}

/// A watermark hides the scene in part of the frame, and stays at the same pixels although the camera moves.
#[test]
fn still_tiles_are_ignored_unless_they_are_the_majority() {
    let truth = shift(9.0, 6.0);
    let reference = taken(&Transform::Identity, 0.0);
    let moved = taken(&truth, 0.0);
    let with_overlay = |columns: usize| {
        Plane::from_rows(SIZE.0, SIZE.1, |y, row| {
            row[..columns].copy_from_slice(&reference.row(y)[..columns]);
            row[columns..].copy_from_slice(&moved.row(y)[columns..]);
        })
    };
    // Tiles are 30 px wide. First the overlay covers seven of sixteen columns, then ten.
    let few = agreement_of(&reference, &with_overlay(210), &truth);
    assert!(few.disagreeing <= 10 && few.agreeing > 50, "{few:?}");
    let many = agreement_of(&reference, &with_overlay(300), &truth);
    assert!(many.disagreeing > many.agreeing, "{many:?}");
}

#[test]
fn plain_and_clipped_pictures_are_silent() {
    let plain = Plane::filled(SIZE.0, SIZE.1, 120);
    let found = agreement_of(&plain, &plain, &Transform::Identity);
    assert_eq!((found.agreeing, found.disagreeing, found.undecided), (0, 0, 160));
    assert_eq!(found.share(), 0.3);
    // At +11 EV all pixels are clipped, at -11 EV nearly all are too dark.
    for ev in [11.0, -11.0] {
        let found =
            agreement_of(&taken(&Transform::Identity, 0.0), &taken(&Transform::Identity, ev), &Transform::Identity);
        assert_eq!((found.agreeing, found.disagreeing), (0, 0), "{ev}");
    }
}

#[test]
fn outside_the_frame_tiles_are_silent() {
    let truth = shift(120.0, 0.0);
    let found = agreement_of(&taken(&Transform::Identity, 0.0), &taken(&truth, 0.5), &truth);
    // The frame does not show the columns from 360 on. So at least four of the sixteen columns of tiles are undecided,
    // with ten tiles each.
    assert!(found.undecided >= 40 && found.agreeing + found.disagreeing <= 120 && found.agreeing > 60, "{found:?}");
    assert_eq!(found.disagreeing, 0, "{found:?}");
}

#[test]
fn a_tile_is_compared_if_the_frame_shows_at_least_half_of_it() {
    // Tiles are 30 px wide. The first frame lacks the last 10 px of the reference, the second the last 20 px.
    for (dx, is_compared) in [(10.0, true), (20.0, false)] {
        let (reference, frame) = (taken(&Transform::Identity, 0.0), taken(&shift(dx, 0.0), 0.0));
        let h = shift(dx, 0.0).matrix(SIZE.0, SIZE.1);
        let both = CommonExposure::new(&reference, &frame, &ToneTables::between(&reference, &frame, &h));
        let check = check_tiles(&both, &h);
        assert_eq!(check.correlations.iter().skip(15).step_by(16).any(Option::is_some), is_compared, "{dx}");
        assert_eq!(check.agreement.disagreeing, 0, "{dx}");
    }
}

#[test]
fn gain_and_offset_do_not_matter() {
    // The correlation must not depend on gain and offset. The intensity map would remove them, so the frame's plane is
    // replaced by its grey values without the map.
    let float = |p: &Plane<u8>, gain: f32, offset: f32| {
        Plane::from_vec(SIZE.0, SIZE.1, p.as_slice().iter().map(|&v| gain * f32::from(v) + offset).collect())
    };
    let (a, b) = (taken(&Transform::Identity, 0.0), taken(&Transform::Identity, 0.1));
    let tones = ToneTables::between(&a, &b, &Matrix3::identity());
    let mut both = CommonExposure::new(&a, &b, &tones);
    let plain = float(&b, 1.0, 0.0);
    both.frame = plain.clone();
    let one_check = check_tiles(&both, &Matrix3::identity());
    let one = &one_check.agreement;
    assert!(one.agreeing > 100);
    both.frame = float(&b, 0.5, 64.0);
    let other_check = check_tiles(&both, &Matrix3::identity());
    let other = &other_check.agreement;
    assert_eq!((one.agreeing, one.disagreeing, one.undecided), (other.agreeing, other.disagreeing, other.undecided));
    // The tolerances allow for rounding errors in sums of 900 products.
    assert!((one.offset - other.offset).abs() < 1e-2);
    for (a, b) in one_check.correlations.iter().flatten().zip(other_check.correlations.iter().flatten()) {
        assert!((a - b).abs() < 1e-2, "{a} {b}");
    }
}
