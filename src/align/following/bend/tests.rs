//! Bends against textbook versions, and against photographs with a known lens and a known shutter.

use super::*;
use crate::align::following::observations::Observation;
use crate::align::following::{Observed, Start, bent};
use crate::align::motion::bend::{Lens, Radial, SHUTTER_PARAMETERS, Shutter, by_shutter, displacement};
use crate::align::motion::coordinates::{Coordinates, by_homography};
use crate::align::motion::{Cause, Followed, Motion};
use crate::align::scene::{Scene, Shot, photograph, uniform};
use crate::align::tests::frame;
use crate::align::transform::{Transform, map};
use crate::align::transforms_file::SavedAlignment;
use crate::align::{AlignOptions, Local, align};
use crate::bracket::{Bracket, ReferenceChoice};
use nalgebra::{Matrix2, Matrix3, SVector, Vector2};
use std::path::Path;
use std::sync::Arc;

const SIZE: (usize, usize) = (480, 320);

fn picture() -> Picture {
    let coordinates = Coordinates::new(SIZE);
    Picture { level: 0, coordinates, height: SIZE.1 as f64 / coordinates.unit, size: SIZE }
}

/// A lens with barrel distortion, a little stronger in the frame than in the reference.
const RADIALS: [Radial; 2] = [Radial { powers: [0.09, -0.02] }, Radial { powers: [0.095, -0.02] }];

/// A frame that was shifted and turned, in [`Coordinates`].
fn turned() -> Matrix3<f64> {
    Matrix3::new(1.0, -0.02, 0.06, 0.02, 1.0, -0.03, 0.01, -0.005, 1.0)
}

/// A hand that trembles: a turn, a tilt and a roll that rise and fall from spline to spline. In units of
/// [`Coordinates`].
fn trembling() -> SVector<f64, SHUTTER_PARAMETERS> {
    SVector::from_fn(|i, _| match i.checked_sub(8) {
        None => 0.0,
        Some(k) => 0.02 * libm::sin(0.7 * (k / 3) as f64 + 1.9 * (k % 3) as f64),
    })
}

#[test]
fn distortion_is_the_inverse_of_the_correction() {
    for powers in [[0.0, 0.0], [0.1, 0.02], [-0.1, -0.02], [0.15, -0.05]] {
        let radial = Radial { powers };
        for at in [[0.0, 0.0], [0.3, -0.2], [1.0, 0.66]] {
            let [u, v] = radial.undistorted(at);
            let factor = radial.inverse_factor(u * u + v * v);
            assert!((u * factor - at[0]).abs() < 1e-9 && (v * factor - at[1]).abs() < 1e-9, "{powers:?} {at:?}");
        }
    }
}

#[test]
fn splines_are_those_of_the_recursion() {
    // The B-spline i of degree k at t, over integer knots (de Boor, A Practical Guide to Splines, IX (14)).
    fn spline(i: i32, k: i32, t: f64) -> f64 {
        let i0 = f64::from(i);
        if k == 0 {
            return if t >= i0 && t < i0 + 1.0 { 1.0 } else { 0.0 };
        }
        let k0 = f64::from(k);
        (t - i0) / k0 * spline(i, k - 1, t) + (i0 + k0 + 1.0 - t) / k0 * spline(i + 1, k - 1, t)
    }
    let height = 1.4;
    for at in [-0.7, -0.31, 0.0, 0.2, 0.699] {
        // At u = 0 and a turn about the vertical axis, the displacement along x is the spline itself.
        let (first, by) = by_shutter([0.0, at], height);
        let t = (at / height + 0.5) * 5.0;
        for k in 0..4 {
            let expected = spline((first + k) as i32 - 3, 3, t);
            assert!((by[3 * k][0] - expected).abs() < 1e-12, "spline {} at {at}", first + k);
        }
    }
}

/// The motion of a frame by `model`, which is nearly the homography `h` in pixels.
fn motion(model: BendModel, h: Matrix3<f64>) -> Motion {
    let followed = Followed::Bends(vec![Some(Arc::new(Bend::new(model, &h, SIZE)))]);
    Motion::new(&Transform::Homography(h), SIZE).following(Some(&followed), 0)
}

/// The motions of a frame by a lens and by a shutter.
fn both() -> [Motion; 2] {
    let Picture { coordinates, height, .. } = picture();
    let h = coordinates.inverse() * turned() * coordinates.matrix();
    let lens = BendModel::Lens(Lens::new(coordinates, RADIALS, turned()));
    let shutter = BendModel::Shutter(Box::new(Shutter::new(coordinates, height, trembling(), h)));
    [motion(lens, h), motion(shutter, h)]
}

#[test]
fn positions_are_those_of_the_model_and_within_their_bounds() {
    let Picture { coordinates, height, .. } = picture();
    for (x, y) in [(0.0, 0.0), (100.0, 250.0), (479.0, 319.0), (240.0, 3.5)] {
        let [lens, shutter] = both();
        let at = coordinates.of([x, y]);
        let [u, v] = RADIALS[0].undistorted(at);
        let (u, v) = map(&turned(), u, v);
        let factor = RADIALS[1].inverse_factor(u * u + v * v);
        let expected = coordinates.pixel([u * factor, v * factor]);
        let (a, b) = lens.position(x, y).unwrap();
        // The table has 1024 linear pieces; the second derivative of the factor is below 0.1.
        assert!((a - expected[0]).abs() < 1e-4 && (b - expected[1]).abs() < 1e-4);
        let [du, dv] = displacement(&trembling(), at, height);
        let (u, v) = map(&turned(), at[0] + du, at[1] + dv);
        let expected = coordinates.pixel([u, v]);
        let (a, b) = shutter.position(x, y).unwrap();
        assert!((a - expected[0]).abs() < 1e-9 && (b - expected[1]).abs() < 1e-9);
    }
    for motion in both() {
        let bounds = motion.bounds(&(0..SIZE.0), &(0..SIZE.1));
        for (x, y) in (0..SIZE.1).step_by(7).flat_map(|y| (0..SIZE.0).step_by(7).map(move |x| (x as f64, y as f64))) {
            let (u, v) = motion.position(x, y).unwrap();
            let [(a, b), (c, d)] = bounds.map(|h| map(&h, x, y));
            assert!(a <= u && u <= c && b <= v && v <= d, "({x}, {y})");
        }
    }
}

/// Observations of `count` patches that are displaced by `displaced` pixels. Each displacement has an error of up to
/// 0.05 pixels along each axis; every fortieth is wrong by up to 8 pixels.
fn observed(count: usize, frame: u64, displaced: impl Fn([f64; 2]) -> [f64; 2]) -> Option<Observed> {
    let number = |seed: u64, i: usize| 2.0 * uniform(seed, i as i64, frame as i64) - 1.0;
    let observation = |i: usize| {
        let at = [number(1, i), 0.66 * number(2, i)];
        let error = if (i + frame as usize).is_multiple_of(40) { 8.0 } else { 0.05 };
        let d = displaced(at);
        let displacement = Vector2::new(d[0] + error * number(3, i), d[1] + error * number(4, i));
        Observation { patch: i, at, displacement, precision: Matrix2::identity() * 40.0 }
    };
    let observations = (0..count).map(observation).collect();
    let start = Start { transform: Transform::Identity, is_rejected: false };
    Some(Observed::new(observations, start, Matrix3::identity()))
}

/// The displacement in pixels of a position by a motion between [`Coordinates`].
fn moved(position: impl Fn(f64, f64) -> (f64, f64)) -> impl Fn([f64; 2]) -> [f64; 2] {
    let coordinates = picture().coordinates;
    move |at| {
        let [x, y] = coordinates.pixel(at);
        let (u, v) = position(x, y);
        [u - x, v - y]
    }
}

#[test]
fn lens_and_shutter_are_found_from_displacements_with_errors() {
    let truth = both();
    for (i, (cause, rms)) in [(Cause::Lens, 0.03), (Cause::Shutter, 0.06)].into_iter().enumerate() {
        let of = |frame: u64| observed(1200, frame, moved(|x, y| truth[i].position(x, y).unwrap()));
        let frames = [of(0), None, of(2)];
        let found = bent(&frames, &picture()).unwrap();
        for bend in [0, 2].map(|frame| &found[frame].as_ref().unwrap().0) {
            assert_eq!(bend.cause(), cause);
            let mut squares = Vec::new();
            for (x, y) in (0..SIZE.1).step_by(9).flat_map(|y| (0..SIZE.0).step_by(9).map(move |x| (x, y))) {
                let (x, y) = (x as f64, y as f64);
                let ((a, b), (u, v)) = (bend.position(x, y), truth[i].position(x, y).unwrap());
                squares.push((a - u) * (a - u) + (b - v) * (b - v));
            }
            // The errors of 1170 patches, 0.03 px along each axis, spread over 10 or 32 parameters, which gives
            // 0.03 sqrt(2 x 32 / 1170) = 0.007 px, more at the corners; and the parameters are held with their expected
            // sizes.
            let found = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
            assert!(found < rms, "{cause:?}: {found}");
        }
        assert!(found[1].is_none());
    }
}

#[test]
fn no_bend_is_found_without_one() {
    let flat = |frame| {
        observed(1200, frame, |at| {
            let by = by_homography(at);
            by.map(|by| by.iter().zip([1.0, -0.5, 2.0, 0.5, 1.0, -3.0, 0.4, -0.2]).map(|(b, p)| b * p).sum())
        })
    };
    assert!(bent(&[flat(0), None, flat(2)], &picture()).is_none(), "homographies suffice");
    let near = |frame| observed(1200, frame, |[u, v]| if u + 0.3 * v > 0.2 { [4.0, 1.0] } else { [0.0, 0.0] });
    assert!(bent(&[near(0), None, near(2)], &picture()).is_none(), "a near thing is no bend");
    let few = |frame| observed(50, frame, |at| [3.0 * at[1] * at[1], 0.0]);
    assert!(bent(&[few(0), None, few(2)], &picture()).is_none(), "too few patches");
}

#[test]
fn bracket_is_aligned_by_its_lens_and_again_from_its_transforms() {
    let [lens, _] = both();
    let exposures = [-1.5, 0.0, 1.5];
    // The position in the reference of a pixel of the frame, by fixed-point iteration.
    let back = |x: f64, y: f64| {
        (0..30).fold((x, y), |(a, b), _| {
            let (u, v) = lens.position(a, b).unwrap();
            (a + x - u, b + y - v)
        })
    };
    let scene = Scene::new(5);
    let photographs: Vec<_> = exposures
        .iter()
        .enumerate()
        .map(|(i, &ev)| {
            photograph(SIZE, &Transform::Identity, Shot::at(ev), |x, y| {
                let (x, y) = if i == 0 { back(x, y) } else { (x, y) };
                scene.radiance(x, y)
            })
        })
        .collect();
    let frames = photographs.iter().zip(exposures).enumerate();
    let frames = frames.map(|(i, (grey, ev))| frame(&format!("{i}"), grey, ev)).collect();
    let bracket = Bracket::new(frames, &ReferenceChoice::Number(2)).unwrap();
    let (first, warnings) = align(&bracket, &AlignOptions::default()).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(first.cause(0), Some(Cause::Lens), "{first:?}");
    let found = first.motion(&bracket, 0).unwrap();
    for (x, y) in [(10.0, 10.0), (470.0, 12.0), (240.0, 160.0), (12.0, 310.0), (465.0, 305.0)] {
        let ((a, b), (u, v)) = (found.position(x, y).unwrap(), lens.position(x, y).unwrap());
        assert!((a - u).abs() < 0.3 && (b - v).abs() < 0.3, "({x}, {y}): ({a}, {b}) instead of ({u}, {v})");
    }
    let saved = SavedAlignment::of(&bracket, &first).to_json();
    let given = SavedAlignment::from_json(&saved, Path::new("t.json")).unwrap().frames;
    let (again, _) = align(&bracket, &AlignOptions { given, ..AlignOptions::default() }).unwrap();
    assert!(again.followed == first.followed && again.overlap == first.overlap);
    let (off, _) = align(&bracket, &AlignOptions { local: Local::Off, ..AlignOptions::default() }).unwrap();
    assert!(off.followed.is_none());
}
