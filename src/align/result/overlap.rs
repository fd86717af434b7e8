//! The overlap: the largest rectangle of the reference that all aligned frames cover.
//!
//! In: homographies. Out: a [`Rect`], or none. Cost: the edges of all frames are evaluated some 15,000 times.
//!
//! A homography keeps the four edges of a frame straight, so the frame covers the intersection of four half-planes.
//! Once the left and right sides of the rectangle are chosen, the best upper and lower sides follow directly. The
//! logarithm of the area is a concave function of the left and right sides, so that ternary search finds its only
//! maximum. If the height is negative, the search uses the height instead of the area. The height is concave, too, and
//! leads the search back to positive heights. Vertical edges limit the range of columns that is searched.

use nalgebra::{Matrix3, Vector3};

/// A rectangle of pixels: columns `x0..x1`, rows `y0..y1` of the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Rect {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Column after the last.
    pub x1: usize,
    /// Row after the last.
    pub y1: usize,
}

impl Rect {
    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.x1 - self.x0
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.y1 - self.y0
    }
}

/// The largest rectangle of a `width` x `height` reference whose pixel centres are inside all frames; none where the
/// frames have no pixel in common.
pub(crate) fn largest(homographies: &[Matrix3<f64>], width: usize, height: usize) -> Option<Rect> {
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    // Each edge of a frame is a vector n; a pixel (x, y) is on its inner side if n . (x, y, 1) >= 0. The four edges are
    // u >= 0, v >= 0, u <= right and v <= bottom, where (u, v) is the frame's pixel; each is multiplied by the third
    // homogeneous coordinate, which is positive.
    let (upright, sloping): (Vec<_>, Vec<_>) = homographies
        .iter()
        .filter(|h| **h != Matrix3::identity())
        .flat_map(|h| {
            let row = |i: usize| Vector3::new(h[(i, 0)], h[(i, 1)], h[(i, 2)]);
            [row(0), row(1), right * row(2) - row(0), bottom * row(2) - row(1)]
        })
        .partition(|n| n.y == 0.0);
    let (left, right) = horizontal_span(&upright, right)?;
    let span = |x0: f64, x1: f64| vertical_span(&sloping, x0, x1, bottom);
    let area = |x0: f64, x1: f64| {
        let (y0, y1) = span(x0, x1);
        if y1 < y0 { y1 - y0 } else { (x1 - x0 + 1.0) * (y1 - y0 + 1.0) }
    };
    let best_right = |x0: f64| top_of(|x1| area(x0, x1), x0, right);
    let x0 = top_of(|x0| area(x0, best_right(x0)), left, right);
    let x1 = best_right(x0);
    let (x0, x1) = (inwards_up(x0), inwards_down(x1));
    let (y0, y1) = span(x0, x1);
    let (y0, y1) = (inwards_up(y0), inwards_down(y1));
    (x0 <= x1 && y0 <= y1).then(|| Rect { x0: x0 as usize, y0: y0 as usize, x1: x1 as usize + 1, y1: y1 as usize + 1 })
}

/// Positions that are within this of an integer count as this integer, in pixels: they may have rounding errors.
const WHOLE: f64 = 1e-6;

fn inwards_up(v: f64) -> f64 {
    (v - WHOLE).ceil().max(0.0)
}

fn inwards_down(v: f64) -> f64 {
    (v + WHOLE).floor()
}

/// Returns the first and the last column within 0..=`right` that are on the inner side of all `upright` edges (n.y =
/// 0); none if there is no such column.
fn horizontal_span(upright: &[Vector3<f64>], right: f64) -> Option<(f64, f64)> {
    let (mut x0, mut x1) = (0.0f64, right);
    for n in upright {
        if n.x > 0.0 {
            x0 = x0.max(-n.z / n.x);
        } else if n.x < 0.0 {
            x1 = x1.min(-n.z / n.x);
        } else if n.z < 0.0 {
            return None;
        }
    }
    (x0 <= x1).then_some((x0, x1))
}

/// Returns the first and the last row in which the columns `x0` to `x1` are on the inner side of all `sloping` edges
/// (n.y != 0).
fn vertical_span(sloping: &[Vector3<f64>], x0: f64, x1: f64, bottom: f64) -> (f64, f64) {
    let (mut y0, mut y1) = (0.0f64, bottom);
    for n in sloping {
        // The end of the row (`x0` or `x1`) that is nearer to the edge, or farther outside, decides.
        let across = (n.x * x0).min(n.x * x1) + n.z;
        if n.y > 0.0 {
            y0 = y0.max(-across / n.y);
        } else {
            y1 = y1.min(-across / n.y);
        }
    }
    (y0, y1)
}

/// Returns the position of the maximum of a function that has only one on `low..=high`.
fn top_of(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    for _ in 0..60 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if f(a) < f(b) { low = a } else { high = b }
    }
    (low + high) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::transform::{Transform, map};

    fn largest(transforms: &[Transform], width: usize, height: usize) -> Option<Rect> {
        let homographies: Vec<Matrix3<f64>> = transforms.iter().map(|w| w.matrix(width, height)).collect();
        super::largest(&homographies, width, height)
    }

    /// Tries every rectangle with sides on a grid of `step` pixels, and returns the largest area that all frames cover.
    fn by_trial(transforms: &[Transform], width: usize, height: usize, step: usize) -> usize {
        let covered = |x: usize, y: usize| {
            transforms.iter().all(|w| {
                let (u, v) = map(&w.matrix(width, height), x as f64, y as f64);
                u >= 0.0 && v >= 0.0 && u <= width as f64 - 1.0 && v <= height as f64 - 1.0
            })
        };
        let mut best = 0;
        for x0 in (0..width).step_by(step) {
            for y0 in (0..height).step_by(step).filter(|&y0| covered(x0, y0)) {
                for x1 in (x0 + 1..=width).rev().step_by(step).filter(|&x1| covered(x1 - 1, y0)) {
                    for y1 in (y0 + 1..=height).rev().step_by(step) {
                        if covered(x0, y1 - 1) && covered(x1 - 1, y1 - 1) {
                            best = best.max((x1 - x0) * (y1 - y0));
                            break;
                        }
                    }
                }
            }
        }
        best
    }

    #[test]
    fn is_covered_and_as_large_as_trial_finds() {
        let tilted = Transform::Homography(Matrix3::new(1.01, 0.02, -3.0, -0.015, 0.99, 4.0, 1e-4, -5e-5, 1.0));
        for transforms in [
            vec![Transform::Rigid { dx: 7.0, dy: -3.0, angle: 0.0 }],
            vec![
                Transform::Rigid { dx: 2.5, dy: 1.5, angle: 0.06 },
                Transform::Rigid { dx: -4.0, dy: 0.0, angle: -0.02 },
            ],
            vec![Transform::Identity, tilted],
        ] {
            let (width, height) = (120, 80);
            let rect = largest(&transforms, width, height).unwrap();
            for w in &transforms {
                let h = w.matrix(width, height);
                for (x, y) in
                    [(rect.x0, rect.y0), (rect.x1 - 1, rect.y0), (rect.x1 - 1, rect.y1 - 1), (rect.x0, rect.y1 - 1)]
                {
                    let (u, v) = map(&h, x as f64, y as f64);
                    assert!(u >= -1e-5 && v >= -1e-5 && u <= 119.0 + 1e-5 && v <= 79.0 + 1e-5, "{rect:?}");
                }
            }
            // `largest` rounds inwards, so its result may lack up to a row or a column on each side.
            let trial = by_trial(&transforms, width, height, 2);
            assert!(rect.width() * rect.height() + 2 * (width + height) >= trial, "{rect:?} against {trial}");
        }
    }

    #[test]
    fn a_whole_shift_cuts_just_that_off() {
        let shift = Transform::Rigid { dx: 7.0, dy: -3.0, angle: 0.0 };
        assert_eq!(largest(&[shift], 100, 50), Some(Rect { x0: 0, y0: 3, x1: 93, y1: 50 }));
        assert_eq!(largest(&[Transform::Identity], 100, 50), Some(Rect { x0: 0, y0: 0, x1: 100, y1: 50 }));
    }

    #[test]
    fn shift_by_most_of_the_picture_leaves_the_rest() {
        for (dx, dy, rect) in [
            (-90.0, 0.0, Rect { x0: 90, y0: 0, x1: 100, y1: 50 }),
            (90.0, 0.0, Rect { x0: 0, y0: 0, x1: 10, y1: 50 }),
            (0.0, -45.0, Rect { x0: 0, y0: 45, x1: 100, y1: 50 }),
            (-99.0, 49.0, Rect { x0: 99, y0: 0, x1: 100, y1: 1 }),
        ] {
            assert_eq!(largest(&[Transform::Rigid { dx, dy, angle: 0.0 }], 100, 50), Some(rect), "{dx} {dy}");
            // A shift that is 3 % smaller, with a slight rotation, leaves an area with up to three columns and rows
            // more, or up to one column or row less on each side.
            let turned = largest(&[Transform::Rigid { dx: 0.97 * dx, dy: 0.97 * dy, angle: 1e-3 }], 100, 50).unwrap();
            assert!(turned.width() <= rect.width() + 3 && turned.width() + 2 >= rect.width(), "{turned:?}");
            assert!(turned.height() <= rect.height() + 3 && turned.height() + 2 >= rect.height(), "{turned:?}");
        }
    }

    #[test]
    fn frames_without_a_common_pixel_have_no_overlap() {
        let shift = |dx: f64, angle: f64| Transform::Rigid { dx, dy: 0.0, angle };
        for angle in [0.0, 0.02] {
            assert_eq!(largest(&[shift(500.0, angle)], 100, 50), None);
            assert_eq!(largest(&[shift(60.0, angle), shift(-60.0, angle)], 100, 50), None);
            assert!(largest(&[shift(60.0, angle)], 100, 50).is_some());
        }
    }
}
