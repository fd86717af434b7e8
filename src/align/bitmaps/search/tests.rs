//! Tests of the percentiles and of the search. The search is checked with known motions, and against Ward's loop as
//! printed in the paper.

use super::*;
use crate::align::bitmaps::MtbOptions;
use crate::align::bitmaps::threshold::common_percentile;
use crate::align::grey::GreyPyramid;
use crate::align::scene::{Scene, Shot, photograph, rigid, shift, uniform};
use crate::align::transform::Transform;

fn plane(values: &[(u8, usize)]) -> Plane<u8> {
    let data: Vec<u8> = values.iter().flat_map(|&(v, n)| std::iter::repeat_n(v, n)).collect();
    Plane::from_vec(data.len(), 1, data)
}

fn histogram(values: &[(u8, usize)]) -> Histogram {
    Histogram::of(&plane(values))
}

#[test]
fn a_level_is_the_least_that_enough_pixels_do_not_exceed() {
    // The values are 0 to 99. The 17th, 50th and 83rd percentiles are the values of the 17th, 50th and 83rd pixel in
    // ascending order.
    let ramp: Vec<(u8, usize)> = (0..100).map(|v| (v, 1)).collect();
    let levels = [Percentile::new(17), Percentile::MEDIAN, Percentile::new(83)].map(|p| histogram(&ramp).value_at(p));
    assert_eq!(levels, [16, 49, 82]);
    // If half of the pixels have one value and half have another, the median is the lower value. With one more pixel of
    // the upper value, the median is the upper value.
    assert_eq!(histogram(&[(10, 50), (20, 50)]).value_at(Percentile::MEDIAN), 10);
    assert_eq!(histogram(&[(10, 50), (20, 51)]).value_at(Percentile::MEDIAN), 20);
    for end in [0, 255] {
        for p in [Percentile::new(17), Percentile::MEDIAN, Percentile::new(83)] {
            assert_eq!(histogram(&[(end, 7)]).value_at(p), end);
            assert_eq!(histogram(&[(end, 1)]).value_at(p), end);
        }
    }
}

#[test]
fn another_percentile_is_used_if_the_median_is_clipped_or_black() {
    let spread: Vec<(u8, usize)> = (40..140).map(|v| (v, 4)).collect();
    let normal = histogram(&spread);
    let with = |end: u8| histogram(&[&spread[..], &[(end, 600)]].concat());
    let (burnt, black) = (with(255), with(0));
    assert_eq!(common_percentile(&normal, &normal, 4), Percentile::MEDIAN);
    // The threshold must not be the value that most pixels have, and its percentile must leave at least 15 % of the
    // pixels on either side.
    let parts = |h: &Histogram, p: Percentile| (40..140).contains(&h.value_at(p)) && (15..=85).contains(&p.percent());
    for crowded in [&burnt, &black] {
        let own = common_percentile(crowded, crowded, 4);
        assert!(own != Percentile::MEDIAN && parts(crowded, own), "{own:?}");
        // In one frame the values are spread, in the other most values are at one end of the range. At the common
        // percentile, both bitmaps must have structure, whichever frame is given first.
        let common = common_percentile(&normal, crowded, 4);
        assert!(common != Percentile::MEDIAN && parts(crowded, common), "{common:?}");
        assert_eq!(common_percentile(crowded, &normal, 4), common);
    }
    assert_eq!(common_percentile(&normal, &normal, 4), Percentile::MEDIAN);
}

/// Returns a dark and a bright photograph of a scene. The bright one is taken under `transform` and is two stops
/// brighter; its highlights are clipped.
fn pair(size: (usize, usize), transform: &Transform) -> (GreyPyramid, GreyPyramid) {
    let take = |transform: &Transform, ev| GreyPyramid::new(Scene::new(5).photograph(size, transform, Shot::at(ev)));
    (take(&Transform::Identity, -1.0), take(transform, 1.0))
}

fn found(size: (usize, usize), transform: &Transform) -> Motion {
    let (a, b) = pair(size, transform);
    search(&a, &b, 0, &MtbOptions::default()).motion
}

#[test]
fn finds_shift_and_rotation_between_exposures() {
    for transform in [shift(13.0, -7.0), rigid(0.0, 0.0, 1.3), rigid(-21.4, 9.7, -2.2)] {
        let Transform::Rigid { dx, dy, angle } = transform else { unreachable!() };
        let motion = found((768, 512), &transform);
        // The tolerances allow several times the expected error. One pixel in 100 is at an edge, 4000 pixels in all.
        // Each of them measures the motion to some tenths of a pixel, all together to 0.01 px. An angle of 0.01 degrees
        // moves the rim, at 256 px, by 0.045 px.
        assert!((motion.angle - angle).to_degrees().abs() < 0.01, "{motion:?} for {transform:?}");
        assert!((motion.dx - dx).abs() < 0.1 && (motion.dy - dy).abs() < 0.1, "{motion:?} for {transform:?}");
    }
}

#[test]
fn rotations_down_to_a_hundredth_of_a_degree_are_found() {
    let (mut worst, mut ratios) = (0.0f64, Vec::new());
    for (i, degrees) in [0.01, -0.02, 0.05, -0.1, 0.2, -0.5, 1.0, -2.0, 4.9].into_iter().enumerate() {
        let scene = Scene::new(30 + i as u64);
        let truth = rigid(3.3 * i as f64 - 9.4, 7.7 - 2.1 * i as f64, degrees);
        let Transform::Rigid { dx, dy, angle } = truth else { unreachable!() };
        let size = (512, 384);
        let ev = if i % 2 == 0 { 2.0 } else { -2.0 };
        let take = |transform: &Transform, ev| GreyPyramid::new(scene.photograph(size, transform, Shot::at(ev)));
        let found = search(&take(&Transform::Identity, 0.0), &take(&truth, ev), 0, &MtbOptions::default());
        let motion = found.motion;
        let off = (motion.angle - angle).to_degrees().abs();
        assert!(off < 0.01, "{off} deg for {degrees}: {found:?}");
        let rim = (motion.angle - angle) * ((size.0 * size.0 + size.1 * size.1) as f64 / 12.0).sqrt();
        let error = ((motion.dx - dx).powi(2) + (motion.dy - dy).powi(2) + rim * rim).sqrt();
        worst = worst.max(error);
        ratios.push(found.error_px / error);
    }
    assert!(worst < 0.1, "{worst} px");
    // The estimate is a root mean square, and the error of a single case differs from it. In about four of five cases,
    // the estimate divided by the error is in 0.33..4.
    let fair = ratios.iter().filter(|r| (0.33..4.0).contains(*r)).count();
    assert!(fair >= 7, "{ratios:?}");
}

#[test]
fn motion_outside_the_model_is_part_of_the_error() {
    let take =
        |transform: &Transform, ev| GreyPyramid::new(Scene::new(6).photograph((512, 384), transform, Shot::at(ev)));
    let reference = take(&Transform::Identity, 0.0);
    // The picture is enlarged by 0.6 %. This moves the middle of the upper edge by 1.15 px, and the pixels by 1.1 px
    // (root mean square).
    let (cx, cy, zoom) = (255.5, 191.5, 1.006);
    let larger = nalgebra::Matrix3::new(zoom, 0.0, cx * (1.0 - zoom), 0.0, zoom, cy * (1.0 - zoom), 0.0, 0.0, 1.0);
    let found = search(&reference, &take(&Transform::Homography(larger), 1.0), 0, &MtbOptions::default());
    let truth = 0.006 * ((512.0f64 * 512.0 + 384.0 * 384.0) / 12.0).sqrt();
    assert!((0.7..1.4).contains(&(found.error_px / truth)), "{} for {truth}", found.error_px);
}

#[test]
fn a_smooth_slope_does_not_pull() {
    // The scene becomes brighter towards the top, as in fog, and has little other contrast. Some parts near the upper
    // edge of the frame are clipped.
    let scene = Scene::new(9);
    let fog = |x: f64, y: f64| 1.6 * (-y / 120.0).exp() * scene.radiance(x, y).powf(0.3);
    let truth = shift(5.3, -11.6);
    let take = |transform: &Transform, ev| GreyPyramid::new(photograph((512, 384), transform, Shot::at(ev), fog));
    let motion = search(&take(&Transform::Identity, 0.0), &take(&truth, 2.0), 0, &MtbOptions::default()).motion;
    // On the slope, the brightness rises by one code value in 3 px. A threshold can only be between two code values.
    // Nevertheless the motion must be right to a tenth of a code value, which is 0.3 px.
    assert!((motion.dx - 5.3).abs() < 0.3 && (motion.dy + 11.6).abs() < 0.3, "{motion:?}");
}

#[test]
fn a_large_picture_is_searched_at_half_its_size() {
    // The picture has 4.4 MP and odd sides: its centre of rotation is not the centre of the level of half the size.
    let truth = rigid(-13.37, 21.8, 1.7);
    let take =
        |transform: &Transform, ev| GreyPyramid::new(Scene::new(12).photograph((2301, 1901), transform, Shot::at(ev)));
    let found = search(&take(&Transform::Identity, 0.0), &take(&truth, 1.0), 0, &MtbOptions::default());
    assert!(found.difference.compared < 1150 * 950);
    let off = found.transform().corner_distance(&truth, 2301, 1901);
    assert!(off < 0.1, "{off} px: {found:?}");
}

#[test]
fn unmoved_pair_has_no_motion() {
    let (a, b) = pair((384, 256), &Transform::Identity);
    let result = search(&a, &b, 0, &MtbOptions::default());
    assert_eq!(result.motion, Motion::default());
    assert_eq!(result.difference, result.difference_unmoved);
}

#[test]
fn the_reach_follows_the_size() {
    for (width, height) in [(300, 200), (1200, 800)] {
        let far = (0.12 * width as f64).round();
        let motion = found((width, height), &shift(far, -4.0));
        assert!((motion.dx - far).abs() < 0.5 && (motion.dy + 4.0).abs() < 0.5, "{motion:?} at {width} px");
    }
}

#[test]
fn rotation_is_zero_if_not_allowed() {
    let (a, b) = pair((384, 256), &rigid(3.0, 2.0, 1.0));
    let options = MtbOptions { max_rotation_deg: 0.0, ..MtbOptions::default() };
    assert_eq!(search(&a, &b, 0, &options).motion.angle, 0.0);
    assert!(search(&a, &b, 0, &MtbOptions::default()).motion.angle > 0.9f64.to_radians());
}

/// Returns the share of the compared pixels that differ for each shift, computed by Ward's loop as printed, pixel by
/// pixel; 1 if less than a tenth of the pixels is compared.
fn textbook(a: &Plane<u8>, b: &Plane<u8>, reach: i64, tolerance: u8) -> Vec<(f64, i64, i64)> {
    let median = |p: &Plane<u8>| {
        let mut sorted = p.as_slice().to_vec();
        sorted.sort_unstable();
        sorted[sorted.len().div_ceil(2) - 1]
    };
    let (ma, mb) = (median(a), median(b));
    let (width, height) = (a.width() as i64, a.height() as i64);
    let mut all = Vec::new();
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let (mut differing, mut compared) = (0u32, 0u32);
            for y in 0.max(-dy)..height.min(height - dy) {
                for x in 0.max(-dx)..width.min(width - dx) {
                    let (p, q) = (a.at(x as usize, y as usize), b.at((x + dx) as usize, (y + dy) as usize));
                    if p.abs_diff(ma) > tolerance && q.abs_diff(mb) > tolerance {
                        compared += 1;
                        differing += u32::from((p > ma) != (q > mb));
                    }
                }
            }
            let enough = f64::from(compared) >= 0.1 * (width * height) as f64;
            all.push((if enough { f64::from(differing) / f64::from(compared) } else { 1.0 }, dx, dy));
        }
    }
    all
}

#[test]
fn the_packed_search_is_the_textbooks() {
    // A width of 75 px is more than a word of 64 bits, and not a multiple of it. The picture is too small for a second
    // level.
    let take = |transform: &Transform, ev| Scene::new(8).photograph((75, 60), transform, Shot::at(ev));
    for (dx, dy) in [(0.0, 0.0), (4.0, -3.0), (-9.0, 7.0)] {
        let (a, b) = (take(&Transform::Identity, 0.0), take(&shift(dx, dy), 1.0));
        let (pa, pb) = (GreyPyramid::new(a.clone()), GreyPyramid::new(b.clone()));
        assert_eq!(pa.len(), 1);
        let bitmaps = |p: &GreyPyramid| ThresholdBitmaps::of_level(p, 0, Percentile::MEDIAN, 4);
        let zones = [&pa, &pb].map(|p| Zone::about(p.histogram(0).value_at(Percentile::MEDIAN), 4));
        let packed = BitmapPair { reference: bitmaps(&pa), frame: bitmaps(&pb), percentile: Percentile::MEDIAN, zones };
        let reach = packed.reach(0.15);
        assert_eq!(reach, (12, 12));
        let slow = textbook(&a, &b, reach.0, 4);
        let fast: Vec<(f64, i64, i64)> =
            packed.rate_shifts(0.0, reach).into_iter().map(|(rate, m)| (rate, m.dx as i64, m.dy as i64)).collect();
        assert_eq!(fast, slow);
        let best = slow.iter().min_by(|p, q| p.0.total_cmp(&q.0)).unwrap();
        let first = packed.search_everywhere(0.15, 0.0)[0];
        assert_eq!((first.dx as i64, first.dy as i64), (best.1, best.2));
        assert_eq!((first.dx, first.dy), (dx, dy));
    }
}

#[test]
fn rivals_are_the_periods_of_a_facade() {
    // The windows of a floor are 24 px apart, and each has a slightly different brightness. No two floors are alike.
    let facade = |x: f64, y: f64| {
        let (column, floor) = ((x / 24.0).floor(), (y / 31.0).floor());
        let width = 9.0 + 8.0 * uniform(3, floor as i64, 0);
        let lit = (x - 24.0 * column - 12.0).abs() < width / 2.0 && (y - 31.0 * floor - 15.0).abs() < 9.0;
        let own = 0.25 * uniform(4, column as i64, floor as i64);
        if lit { 2.0 + own } else { 0.4 + own + 0.3 * uniform(5, floor as i64, 1) }
    };
    let take = |ev| GreyPyramid::new(photograph((300, 220), &Transform::Identity, Shot::at(ev), facade));
    let found = alternatives(&take(-0.5), &take(0.5), 0.0, 8, &MtbOptions::default());
    assert_eq!((found[0].dx, found[0].dy), (0.0, 0.0), "{found:?}");
    for period in [-24.0, 24.0] {
        assert!(found[1..3].iter().any(|m| m.dx == period && m.dy == 0.0), "{found:?}");
    }
    for (i, a) in found.iter().enumerate() {
        assert!(found[..i].iter().all(|b| (a.dx - b.dx).abs().max((a.dy - b.dy).abs()) > 3.5));
    }
}

/// In a strip that is 65,500 px long, there are 386 million shifts of up to 15 % of the length along both axes, and
/// each would take 32 bytes. So the search range of such strips is limited. The range is not limited for photographs
/// whose sides have the ratio 3 : 1.
#[test]
fn strips_are_searched_within_bounds() {
    let pair = |width: usize, height: usize| {
        let grey = Plane::from_rows(width, height, |y, row| {
            row.iter_mut().enumerate().for_each(|(x, v)| *v = ((x * 7 + y * 3) % 200) as u8);
        });
        let pyramid = GreyPyramid::new(grey);
        BitmapPair::new(&pyramid, &pyramid, 0, 4)
    };
    for (width, height) in [(65_500, 4), (4, 65_500), (20_000, 40), (65_500, 1)] {
        let (x, y) = pair(width, height).reach(0.15);
        assert!(x < width as i64 && y < height as i64, "{width}x{height}: {x} {y}");
        assert!((2 * x + 1) * (2 * y + 1) < 1_000_000, "{width}x{height}: {x} {y}");
    }
    assert_eq!(pair(189, 63).reach(0.15), (29, 29));
    assert_eq!(pair(765, 255).reach(0.15), (115, 115));
}
