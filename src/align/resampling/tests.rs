//! Tests of the Lanczos resampling against its definition.

use super::*;
use crate::align::motion::Followed;
use crate::align::motion::bend::{Bend, BendModel, Lens, Radial};
use crate::align::motion::camera::Camera;
use crate::align::motion::coordinates::Coordinates;
use crate::align::motion::relief::{Relief, View, Visibility};
use crate::align::resampling::lanczos::lanczos3;
use crate::align::resampling::tile::Source;
use crate::align::transform::Transform;
use crate::bracket::exposure::Exposure;
use crate::bracket::{Frame, Samples};
use crate::plane::Plane;
use nalgebra::{Matrix3, Matrix3x4};
use std::sync::Arc;

fn frame(width: usize, height: usize, f: impl Fn(f64, f64) -> f64) -> Frame {
    let codes = (0..width * height)
        .flat_map(|i| {
            let v = f((i % width) as f64, (i / width) as f64);
            [v, v * 0.5, 255.0 - v].map(|v| (v * 257.0).round() as u16)
        })
        .collect();
    Frame::new("f".into(), width, height, Samples::Sixteen(codes), Exposure::given(0.0).unwrap())
}

fn whole(frame: &Frame, transform: &Transform) -> Vec<[f32; 3]> {
    moved(frame, &Motion::new(transform, (frame.width(), frame.height())))
}

fn moved(frame: &Frame, motion: &Motion) -> Vec<[f32; 3]> {
    let mut out = vec![[0.0; 3]; frame.width() * frame.height()];
    resample_rows(&frame.whole().unwrap(), motion, 0..frame.width(), 0..frame.height(), &mut out);
    out
}

/// The motion of a frame of a scene with two depths, and with depths between; some pixels are hidden.
fn bumpy(width: usize, height: usize) -> Motion {
    let depths = Plane::from_rows(width / 2, height / 2, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, q)| *q = if x > y { 9.0 + 0.05 * x as f32 } else { -2.5 });
    });
    let visibility = depths.map(|q| if q > 10.0 { Visibility::Hidden } else { Visibility::Shown });
    let camera = Camera::new(Matrix3x4::new(1.0, 0.01, 2.3, 0.7, -0.01, 1.0, -1.6, 0.4, 1e-5, 2e-5, 1.0, 1e-4));
    let relief = Relief::new(1, depths, 1.0, vec![Some(View { camera, visibility })]);
    Motion::unmoved((width, height)).following(Some(&Followed::Depth(Arc::new(relief))), 0)
}

/// The motion of a frame whose lens distorts.
fn bent(width: usize, height: usize) -> Motion {
    let coordinates = Coordinates::new((width, height));
    let h = Matrix3::new(1.0, -0.03, 0.05, 0.03, 1.0, -0.02, 0.01, 0.0, 1.0);
    let radials = [[0.1, 0.02], [-0.1, 0.03]].map(|powers| Radial { powers });
    let pixels = coordinates.inverse() * h * coordinates.matrix();
    let bend = Bend::new(BendModel::Lens(Lens::new(coordinates, radials, h)), &pixels, (width, height));
    let motion = Motion::new(&Transform::Homography(pixels), (width, height));
    motion.following(Some(&Followed::Bends(vec![Some(Arc::new(bend))])), 0)
}

/// Computes the resampled value as the double sum of the definition, without tables.
fn textbook(frame: &Frame, u: f64, v: f64, channel: usize) -> f64 {
    let all = frame.whole().unwrap();
    let Codes::Sixteen(codes) = all.codes() else { unreachable!() };
    let (mut sum, mut weight) = (0.0, 0.0);
    for y in v.floor() as isize - 2..=v.floor() as isize + 3 {
        for x in u.floor() as isize - 2..=u.floor() as isize + 3 {
            let w = lanczos3(x as f64 - u) * lanczos3(y as f64 - v);
            let cx = x.clamp(0, frame.width() as isize - 1) as usize;
            let cy = y.clamp(0, frame.height() as isize - 1) as usize;
            sum += w * f64::from(codes[3 * (cy * frame.width() + cx) + channel]) / 257.0;
            weight += w;
        }
    }
    (sum / weight).clamp(0.0, 255.0)
}

#[test]
fn agrees_with_the_textbook_sum() {
    let f = frame(40, 30, |x, y| 120.0 + 60.0 * (0.9 * x).sin() + 50.0 * (0.7 * y + 0.2 * x).cos());
    let transform = Transform::Rigid { dx: 1.37, dy: -0.61, angle: 0.03 };
    let h = transform.matrix(40, 30);
    for (i, pixel) in whole(&f, &transform).iter().enumerate() {
        let (u, v) = map(&h, (i % 40) as f64, (i / 40) as f64);
        if u < 0.0 || v < 0.0 || u > 39.0 || v > 29.0 {
            assert_eq!(*pixel, [OUTSIDE; 3]);
            continue;
        }
        for c in 0..3 {
            // The phase is rounded by at most 1/2048 px along each axis; the slope of the image is below 150 values/px.
            assert!((f64::from(pixel[c]) - textbook(&f, u, v, c)).abs() < 2.0 * 150.0 / 2048.0);
        }
    }
}

/// Tiles, windows and shared column sums must not change the result: the expected value of each pixel is computed for
/// this pixel alone, as a sum in the same order.
#[test]
fn tiles_give_the_same_bits_as_pixels_by_themselves() {
    let f = frame(300, 90, |x, y| 128.0 + 127.0 * (1.3 * x).sin() * (0.9 * y + 0.1 * x).cos());
    let all = f.whole().unwrap();
    let Codes::Sixteen(codes) = all.codes() else { unreachable!() };
    let source = Source { codes, first: 0, size: (300, 90), scale: 1.0 / 257.0 };
    let perspective = Matrix3::new(1.002, 0.004, -3.2, -7e-5, 1.003, -2.4, -8e-6, 2e-5, 1.0);
    let horizon = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.01, 0.0, 1.0);
    let transforms = [
        Transform::Rigid { dx: 3.3, dy: -2.7, angle: 0.0 },
        Transform::Rigid { dx: -0.4, dy: 1.6, angle: 0.002 },
        Transform::Rigid { dx: 9.0, dy: 4.0, angle: 0.2 },
        Transform::Rigid { dx: 20.0, dy: 0.0, angle: 1.5 },
        Transform::Rigid { dx: 400.0, dy: 0.0, angle: 0.0 },
        Transform::Homography(perspective),
        Transform::Homography(horizon),
    ];
    let motions = transforms.map(|transform| Motion::new(&transform, (300, 90)));
    for motion in motions.into_iter().chain([bumpy(300, 90), bent(300, 90)]) {
        for (i, pixel) in moved(&f, &motion).iter().enumerate() {
            let at = motion.position((i % 300) as f64, (i / 300) as f64);
            let at = at.filter(|(u, v)| (0.0..=299.0).contains(u) && (0.0..=89.0).contains(v));
            let expected = at.map_or([OUTSIDE; 3], |(u, v)| source.at(u, v));
            assert_eq!(pixel.map(f32::to_bits), expected.map(f32::to_bits), "{motion:?} {i}");
        }
    }
}

#[test]
fn whole_pixel_shifts_and_identity_are_exact() {
    let f = frame(20, 12, |x, y| (7.0 * x + 3.0 * y) % 256.0);
    let still = whole(&f, &Transform::Identity);
    let moved = whole(&f, &Transform::Rigid { dx: 2.0, dy: 1.0, angle: 0.0 });
    for y in 0..11 {
        for x in 0..18 {
            for c in 0..3 {
                assert!((moved[y * 20 + x][c] - still[(y + 1) * 20 + x + 2][c]).abs() < 1e-4);
            }
        }
    }
    assert_eq!(moved[19], [OUTSIDE; 3]);
}

#[test]
fn eight_and_sixteen_bit_frames_agree() {
    let eight: Vec<u8> = (0..3 * 16 * 16).map(|i| (i * 37 % 256) as u8).collect();
    let sixteen = eight.iter().map(|&c| u16::from(c) * 257).collect();
    let make = |s| Frame::new("f".into(), 16, 16, s, Exposure::given(0.0).unwrap());
    let transform = Transform::Rigid { dx: 0.4, dy: 0.3, angle: 0.01 };
    let (a, b) = (whole(&make(Samples::Eight(eight)), &transform), whole(&make(Samples::Sixteen(sixteen)), &transform));
    for (p, q) in a.iter().zip(&b) {
        for c in 0..3 {
            assert!((p[c] - q[c]).abs() < 1e-3);
        }
    }
}

/// Only the rows of the frame that `rows_under` returns for a strip of the reference are in memory. The result is the
/// same as with the whole frame, and no other row is read.
#[test]
fn the_rows_under_a_strip_are_enough() {
    let f = frame(60, 90, |x, y| 100.0 + 90.0 * (0.31 * x * y).sin());
    let perspective = Matrix3::new(1.02, 0.03, -2.0, -0.04, 0.97, 3.0, 2e-4, -3e-4, 1.0);
    let transforms = [
        Transform::Identity,
        Transform::Rigid { dx: 3.3, dy: -7.8, angle: 0.2 },
        Transform::Rigid { dx: 0.0, dy: 80.0, angle: -0.1 },
        Transform::Homography(perspective),
    ];
    let motions = transforms.map(|transform| Motion::new(&transform, (60, 90)));
    for motion in motions.into_iter().chain([bumpy(60, 90), bent(60, 90)]) {
        let all = moved(&f, &motion);
        for rows in [0..1, 5..21, 40..90] {
            let under = rows_under(&motion, &(4..57), &rows);
            assert!(!motion.is_identity() || under == rows);
            let mut part = vec![[0.0; 3]; 53 * rows.len()];
            resample_rows(&f.window(under).unwrap(), &motion, 4..57, rows.clone(), &mut part);
            for (line, y) in part.chunks_exact(53).zip(rows) {
                assert_eq!(line, &all[60 * y + 4..60 * y + 57]);
            }
        }
    }
    let horizon = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.1, 0.0, -2.0);
    assert_eq!(rows_under(&Motion::new(&Transform::Homography(horizon), (60, 90)), &(0..60), &(3..4)), 0..90);
}
