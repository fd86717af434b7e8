//! Tests of the detector on images with known features.

use super::*;
use crate::align::features::match_mutual;

/// Gaussian blobs on grey: (x, y, sigma, height).
fn blobs(width: usize, height: usize, list: &[(f64, f64, f64, f64)]) -> Plane<u8> {
    Plane::from_rows(width, height, |y, row| {
        for (x, v) in row.iter_mut().enumerate() {
            let sum: f64 = list
                .iter()
                .map(|&(cx, cy, s, h)| h * (-((x as f64 - cx).powi(2) + (y as f64 - cy).powi(2)) / (2.0 * s * s)).exp())
                .sum();
            *v = (110.0 + sum).round() as u8;
        }
    })
}

#[test]
fn a_blob_is_found_at_its_place_and_scale() {
    for (x, y, sigma) in [(60.3, 50.6, 3.0), (64.0, 64.0, 5.0), (70.2, 55.9, 8.0)] {
        for double in [false, true] {
            let options = SiftOptions { double, ..SiftOptions::default() };
            let found = detect(&blobs(128, 120, &[(x, y, sigma, 100.0)]), &options);
            let best = found.keypoints.iter().max_by(|a, b| a.response.total_cmp(&b.response)).unwrap();
            assert!((f64::from(best.x) - x).abs() < 0.1 && (f64::from(best.y) - y).abs() < 0.1, "{best:?}");
            // D = L(k s) - L(s) of a blob of width b, blurred already by 0.5, is largest where s^2 k = b^2 (from
            // d/ds of 1 / (1 + s^2 / b^2) at both scales): s = b / sqrt(k) = 0.89 b.
            assert!((f64::from(best.scale) / (0.89 * sigma) - 1.0).abs() < 0.1, "{best:?} for {sigma}");
        }
    }
}

#[test]
fn faint_blobs_and_edges_are_not_features() {
    assert!(detect(&blobs(128, 128, &[(64.0, 64.0, 4.0, 8.0)]), &SiftOptions::default()).is_empty());
    let edge = Plane::from_rows(128, 128, |_, row| row[64..].fill(200));
    assert!(detect(&edge, &SiftOptions::default()).is_empty());
    assert!(detect(&Plane::filled(5, 7, 9), &SiftOptions::default()).is_empty());
}

/// Irregular texture with detail at all scales, rotated about the centre and scaled.
fn texture(width: usize, height: usize, turn: f64, zoom: f64) -> Plane<u8> {
    let mut state = 17u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24)
    };
    let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
    let list: Vec<(f64, f64, f64, f64)> = (0..220)
        .map(|_| {
            let (px, py) = ((random() - 0.5) * 1.3 * width as f64, (random() - 0.5) * 1.3 * height as f64);
            let (s, c) = turn.sin_cos();
            let sigma = (2.0 + 5.0 * random() * random()) * zoom;
            (cx + zoom * (c * px - s * py), cy + zoom * (s * px + c * py), sigma, 120.0 * (random() - 0.5))
        })
        .collect();
    blobs(width, height, &list)
}

#[test]
fn features_survive_rotation_scale_and_contrast() {
    let (width, height) = (300, 260);
    let options = SiftOptions { contrast: 0.01, ..SiftOptions::default() };
    let plain = detect(&texture(width, height, 0.0, 1.0), &options);
    for (turn, zoom) in [(0.0, 1.0), (0.6, 1.0), (0.2, 1.25)] {
        let mut other = texture(width, height, turn, zoom);
        other.as_mut_slice().iter_mut().for_each(|v| *v = (f64::from(*v) * 0.7 + 30.0) as u8);
        let found = detect(&other, &options);
        let matches = match_mutual(&plain, &found, 0.8, None);
        let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        let right = matches
            .iter()
            .filter(|m| {
                let (a, b) = (&plain.keypoints[m.reference], &found.keypoints[m.frame]);
                let (px, py) = (f64::from(a.x) - cx, f64::from(a.y) - cy);
                let (s, c) = turn.sin_cos();
                let (u, v) = (cx + zoom * (c * px - s * py), cy + zoom * (s * px + c * py));
                (f64::from(b.x) - u).hypot(f64::from(b.y) - v) < 1.5
            })
            .count();
        assert!(right >= 40 && right * 10 >= matches.len() * 9, "{right} of {} right at {turn}, {zoom}", matches.len());
    }
}

#[test]
fn a_limit_keeps_the_picture_covered() {
    let picture = texture(300, 260, 0.0, 1.0);
    let options = SiftOptions { contrast: 0.005, ..SiftOptions::default() };
    // A round blob has several directions and is then several keypoints at one position.
    let places = |options: &SiftOptions| {
        let mut places: Vec<(f32, f32)> = detect(&picture, options).keypoints.iter().map(|k| (k.x, k.y)).collect();
        places.dedup();
        places
    };
    let all = places(&options).len();
    let few = places(&SiftOptions { max_keypoints: all / 2, ..options });
    assert!(few.len() <= all / 2 && few.len() * 5 >= all * 2, "{} of {all}", few.len());
    for (left, top) in [(0.0, 0.0), (150.0, 0.0), (0.0, 130.0), (150.0, 130.0)] {
        let inside =
            few.iter().filter(|k| k.0 >= left && k.0 < left + 150.0 && k.1 >= top && k.1 < top + 130.0).count();
        assert!(inside * 8 >= few.len(), "{inside} of {}", few.len());
    }
}

#[test]
fn the_same_on_any_number_of_threads() {
    let picture = texture(300, 260, 0.1, 1.0);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| detect(&picture, &SiftOptions { contrast: 0.01, ..SiftOptions::default() }))
    };
    let one = run(1);
    assert!(one.len() > 10);
    assert_eq!(one, run(3));
}
