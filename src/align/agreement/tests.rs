//! What the tiles say of warps that are right, and of such as are wrong by a known amount.

use super::*;
use crate::align::photometric::Tones;
use crate::align::scene::{Scene, Shot, photograph, rigid, shift};
use crate::align::transform::Warp;

const SIZE: (usize, usize) = (480, 320);

/// The opinion of `claimed` on two exposures, the second moved by `truth`.
fn opinion(reference: &Plane<u8>, frame: &Plane<u8>, claimed: &Warp) -> Agreement {
    let h = claimed.matrix(SIZE.0, SIZE.1);
    survey(&CommonExposure::new(reference, frame, &Tones::between(reference, frame, &h)), &h).agreement
}

fn taken(warp: &Warp, ev: f64) -> Plane<u8> {
    Scene::new(31).photograph(SIZE, warp, Shot::at(ev))
}

#[test]
fn the_truth_is_borne_out_and_errors_are_measured() {
    let truth = rigid(4.3, -2.2, 0.6);
    for (a, b) in [(-1.0, 1.0), (1.0, -1.0)] {
        let (reference, frame) = (taken(&Warp::Identity, a), taken(&truth, b));
        let right = opinion(&reference, &frame, &truth);
        let tiles = right.confirm + right.contradict + right.silent;
        assert_eq!(tiles, 16 * 10, "480 x 320 in tiles of 30");
        assert!(right.contradict == 0 && 2 * right.confirm > tiles, "{right:?}");
        // A tile of 900 pixels is placed to some hundredths of a pixel (TILE_NOISE in `place`).
        assert!(right.offset < 0.1 && right.correlation > 0.9, "{right:?}");
        // Half a pixel is beyond none of the tiles, but they see it.
        let near = opinion(&reference, &frame, &rigid(4.3 + 0.3, -2.2 - 0.4, 0.6));
        assert!(near.contradict == 0 && (near.offset - 0.5).abs() < 0.1, "{near:?}");
        // Five pixels is beyond the tiles' reach.
        let far = opinion(&reference, &frame, &rigid(4.3 + 3.0, -2.2 - 4.0, 0.6));
        assert!(far.contradict > 2 * far.confirm, "{far:?}");
        assert!(far.share() < 0.35 && right.share() > 0.9);
    }
}

#[test]
fn what_moves_by_itself_contradicts_alone() {
    let scene = Scene::new(31);
    // Tiles are 30 px: the mover has 4 x 3 of them, and 6 x 5 with those that it may touch.
    let with_mover = |x: f64, y: f64| {
        let inside = (150.0..270.0).contains(&x) && (90.0..180.0).contains(&y);
        scene.radiance(if inside { x + 40.0 } else { x }, y)
    };
    let frame = photograph(SIZE, &Warp::Identity, Shot::at(1.0), with_mover);
    let said = opinion(&taken(&Warp::Identity, 0.0), &frame, &Warp::Identity);
    assert!((6..=30).contains(&said.contradict), "{said:?}");
    assert!(said.confirm > 80 && said.offset < 0.1, "{said:?}");
}

#[test]
fn plain_and_clipped_pictures_are_silent() {
    let plain = Plane::filled(SIZE.0, SIZE.1, 120);
    let said = opinion(&plain, &plain, &Warp::Identity);
    assert_eq!((said.confirm, said.contradict, said.silent), (0, 0, 160));
    assert_eq!(said.share(), 0.3);
    // Eleven stops up all is clipped; eleven down all is black.
    for ev in [11.0, -11.0] {
        let said = opinion(&taken(&Warp::Identity, 0.0), &taken(&Warp::Identity, ev), &Warp::Identity);
        assert_eq!((said.confirm, said.contradict), (0, 0), "{ev}");
    }
}

#[test]
fn outside_the_frame_tiles_are_silent() {
    let truth = shift(120.0, 0.0);
    let said = opinion(&taken(&Warp::Identity, 0.0), &taken(&truth, 0.5), &truth);
    // Columns beyond 360 - 3 are not in the frame: four of the sixteen columns of tiles and the one that the border's margin cuts.
    assert!(said.silent >= 40 && said.confirm + said.contradict <= 120 && said.confirm > 60, "{said:?}");
    assert_eq!(said.contradict, 0, "{said:?}");
}

#[test]
fn gain_and_offset_do_not_matter() {
    // The planes as they are, without the intensity map, which would take them off: correlation must do it.
    let float = |p: &Plane<u8>, gain: f32, offset: f32| {
        Plane::from_vec(SIZE.0, SIZE.1, p.as_slice().iter().map(|&v| gain * f32::from(v) + offset).collect())
    };
    let (a, b) = (taken(&Warp::Identity, 0.0), taken(&Warp::Identity, 0.1));
    let tones = Tones::between(&a, &b, &Matrix3::identity());
    let mut both = CommonExposure::new(&a, &b, &tones);
    let plain = float(&b, 1.0, 0.0);
    both.frame = plain.clone();
    let one = survey(&both, &Matrix3::identity()).agreement;
    assert!(one.confirm > 100);
    both.frame = float(&b, 0.5, 64.0);
    let other = survey(&both, &Matrix3::identity()).agreement;
    assert_eq!((one.confirm, one.contradict, one.silent), (other.confirm, other.contradict, other.silent));
    // Sums of 900 products of floats.
    assert!((one.offset - other.offset).abs() < 1e-2 && (one.correlation - other.correlation).abs() < 1e-2);
}
