//! Images with known features, for the tests of the detectors.

use crate::align::features::{Features, match_mutual};
use crate::plane::Plane;

/// Returns Gaussian blobs on a grey background. `list` has (x, y, sigma, height) of each blob.
pub(super) fn blobs(width: usize, height: usize, list: &[(f64, f64, f64, f64)]) -> Plane<u8> {
    Plane::from_rows(width, height, |y, row| {
        for (x, v) in row.iter_mut().enumerate() {
            let sum: f64 = list
                .iter()
                .map(|&(cx, cy, s, h)| {
                    let (dx, dy) = (x as f64 - cx, y as f64 - cy);
                    h * libm::exp(-(dx * dx + dy * dy) / (2.0 * s * s))
                })
                .sum();
            *v = (110.0 + sum).round() as u8;
        }
    })
}

/// Returns an irregular texture with detail at many scales, rotated by `turn` radians about the centre and enlarged
/// `zoom` times.
pub(super) fn texture(width: usize, height: usize, turn: f64, zoom: f64) -> Plane<u8> {
    let mut state = 17u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24)
    };
    let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
    let list: Vec<(f64, f64, f64, f64)> = (0..220)
        .map(|_| {
            let (px, py) = ((random() - 0.5) * 1.3 * width as f64, (random() - 0.5) * 1.3 * height as f64);
            let (s, c) = (libm::sin(turn), libm::cos(turn));
            let sigma = (2.0 + 5.0 * random() * random()) * zoom;
            (cx + zoom * (c * px - s * py), cy + zoom * (s * px + c * py), sigma, 120.0 * (random() - 0.5))
        })
        .collect();
    blobs(width, height, &list)
}

/// Checks that the features of `detect` survive changes of rotation, scale and contrast. At least `least` matches must
/// be correct, and these must be at least the share `share` of all matches.
pub(super) fn check_repeatability(detect: impl Fn(&Plane<u8>) -> Features, (least, share): (usize, f64)) {
    let (width, height) = (300, 260);
    let plain = detect(&texture(width, height, 0.0, 1.0));
    for (turn, zoom) in [(0.0, 1.0), (0.6, 1.0), (0.2, 1.25)] {
        let mut other = texture(width, height, turn, zoom);
        other.as_mut_slice().iter_mut().for_each(|v| *v = (f64::from(*v) * 0.7 + 30.0) as u8);
        let found = detect(&other);
        let matches = match_mutual(&plain, &found, 0.8, None);
        let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        let right = matches
            .iter()
            .filter(|m| {
                let (a, b) = (&plain.keypoints[m.reference], &found.keypoints[m.frame]);
                let (px, py) = (f64::from(a.x) - cx, f64::from(a.y) - cy);
                let (s, c) = (libm::sin(turn), libm::cos(turn));
                let (u, v) = (cx + zoom * (c * px - s * py), cy + zoom * (s * px + c * py));
                libm::hypot(f64::from(b.x) - u, f64::from(b.y) - v) < 1.5
            })
            .count();
        assert!(
            right >= least && right as f64 >= share * matches.len() as f64,
            "only {right} of {} matches are correct between a picture and its copy, turned by {turn} rad and enlarged {zoom} times",
            matches.len()
        );
    }
}
