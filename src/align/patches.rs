//! Patches: the finest level of a large picture, only where it is looked at.
//!
//! In: a [`Comparison`], with its points on the level on which agreement is measured. Out: points of the finest level, one near each of
//! them, and the frame's level at any place near where a warp puts them. Cost: some 150 pixels a point, whatever the size of the picture, read again only
//! when a point leaves its patch.

use super::comparison::{Comparison, Point, finest_level, level_to_full, measured_level};
use super::cubic::keys;
use super::warp::map;
use crate::plane::Plane;
use nalgebra::Matrix3;

/// Side of the smoothed patch of the reference: 4 x 4 pixels among which the point is chosen, and those around them for gradients.
const CHOICE: usize = 6;
/// Side of the smoothed patch of the frame: 4 x 4 for the interpolation, and two pixels on each side for the steps.
const SEEN: usize = 8;
/// Reach of the smoothing, in pixels.
const REACH: usize = 2;

/// A smoothed patch: its values by rows, and where the first lies.
#[derive(Debug, Clone, Copy)]
struct Patch<const N: usize> {
    left: usize,
    top: usize,
    values: [[f32; N]; N],
}

impl<const N: usize> Patch<N> {
    /// The patch of `plane` by `table`, smoothed as [`binomial`](crate::pyramid::binomial) does, whose first pixel is (left, top); none
    /// where the smoothing would reach beyond the border.
    fn read(plane: &Plane<u8>, table: &[f32; 256], (left, top): (isize, isize)) -> Option<Self> {
        let reach = REACH as isize;
        let far = (N + REACH) as isize;
        if left < reach || top < reach || left + far > plane.width() as isize || top + far > plane.height() as isize {
            return None;
        }
        let (left, top) = (left as usize, top as usize);
        let mut along = [[0.0f32; N]; 16];
        for (k, row) in along[..N + 2 * REACH].iter_mut().enumerate() {
            let codes = &plane.row(top + k - REACH)[left - REACH..left + N + REACH];
            let mut levels = [0.0f32; 16];
            for (l, &v) in levels.iter_mut().zip(codes) {
                *l = table[usize::from(v)];
            }
            for (i, v) in row.iter_mut().enumerate() {
                let l = &levels[i..i + 5];
                *v = 6.0 * l[2] + 4.0 * (l[1] + l[3]) + (l[0] + l[4]);
            }
        }
        let mut values = [[0.0f32; N]; N];
        for (j, row) in values.iter_mut().enumerate() {
            for (i, v) in row.iter_mut().enumerate() {
                let sum =
                    6.0 * along[j + 2][i] + 4.0 * (along[j + 1][i] + along[j + 3][i]) + (along[j][i] + along[j + 4][i]);
                *v = sum * (1.0 / 256.0);
            }
        }
        Some(Patch { left, top, values })
    }
}

/// Near each of the points of the level on which agreement is measured, the point of the finest level, which is larger, that says most
/// about where it is.
pub(super) fn points<'a>(pair: &'a Comparison) -> &'a [Point] {
    pair.fine_points(|| {
        let (from, to) = (measured_level(pair.reference()), finest_level(pair.reference()));
        let (plane, tones) = (pair.reference().level(to), pair.tones(to));
        let finer = level_to_full(from - to);
        let chosen = pair.level(from).points.iter().filter_map(|p| {
            let (x, y) = map(&finer, p.x, p.y);
            // The four pixels in the middle of the patch are those about (x, y).
            let first = |v: f64| (v - 0.5 * (CHOICE as f64 - 1.0) + 0.5) as isize;
            let patch = Patch::<CHOICE>::read(plane, &tones.reference, (first(x), first(y)))?;
            best_of(&patch, |level| tones.trust(level)).map(|(i, j)| {
                let v = &patch.values;
                let around = [v[j][i - 1], v[j][i + 1], v[j - 1][i], v[j + 1][i]];
                Point::new((patch.left + i, patch.top + j), v[j][i], around, tones)
            })
        });
        chosen.collect()
    })
}

/// What the frame shows near its places of the points, on the finest level; read when it is first looked at.
#[derive(Debug)]
pub(super) struct Patches(Vec<Option<Patch<SEEN>>>);

impl Patches {
    /// None read yet, for so many points.
    pub(super) fn unread(points: usize) -> Self {
        Patches(vec![None; points])
    }

    /// The frame's level less the reference's at every point under `h`; none where the frame does not reach.
    pub(super) fn residuals(&mut self, pair: &Comparison, h: &Matrix3<f64>, out: &mut Vec<Option<f32>>) {
        let level = finest_level(pair.reference());
        let (plane, table) = (pair.frame().level(level), &pair.tones(level).frame);
        out.clear();
        out.extend(points(pair).iter().zip(&mut self.0).map(|(p, seen)| {
            let (u, v) = map(h, p.x, p.y);
            if let Some(level) = seen.as_ref().and_then(|patch| cubic(patch, u, v)) {
                return Some(level - p.level);
            }
            // Place it so that (u, v) lies in the middle; the comparison also refuses what is not a number.
            let within = |t: f64, n: usize| t >= 0.0 && t < n as f64;
            if !within(u, plane.width()) || !within(v, plane.height()) {
                return None;
            }
            let half = SEEN as isize / 2 - 1;
            *seen = Patch::read(plane, table, (u as isize - half, v as isize - half));
            seen.as_ref().and_then(|patch| cubic(patch, u, v)).map(|level| level - p.level)
        }));
    }
}

/// Among the inner pixels of `patch`, that with the largest trusted gradient.
fn best_of(patch: &Patch<CHOICE>, trust: impl Fn(f32) -> f32) -> Option<(usize, usize)> {
    let v = &patch.values;
    let (mut best, mut at) = (0.0, None);
    for j in 1..CHOICE - 1 {
        for i in 1..CHOICE - 1 {
            let (dx, dy) = (v[j][i + 1] - v[j][i - 1], v[j + 1][i] - v[j - 1][i]);
            let square = dx * dx + dy * dy;
            if square > best {
                let strength = square * trust(v[j][i]);
                if strength > best {
                    (best, at) = (strength, Some((i, j)));
                }
            }
        }
    }
    at
}

/// Keys' cubic convolution at (u, v), in pixels of the level; none where the patch does not hold all sixteen samples.
fn cubic(patch: &Patch<SEEN>, u: f64, v: f64) -> Option<f32> {
    let (u, v) = (u - patch.left as f64, v - patch.top as f64);
    let inside = |t: f64| t >= 1.0 && t < (SEEN - 2) as f64;
    if !inside(u) || !inside(v) {
        return None;
    }
    let (x, y) = (u as usize, v as usize);
    let (wx, wy) = (keys((u - x as f64) as f32), keys((v - y as f64) as f32));
    let mut sum = 0.0;
    for (j, w) in wy.iter().enumerate() {
        let row = &patch.values[y + j - 1][x - 1..x + 3];
        sum += w * (wx[0] * row[0] + wx[1] * row[1] + wx[2] * row[2] + wx[3] * row[3]);
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::super::cubic;
    use super::super::mtb::GreyPyramid;
    use super::super::scene::{Scene, Shot, rigid};
    use super::super::warp::Warp;
    use super::*;

    /// Large enough for the finest level to be below that of agreement.
    const SIZE: (usize, usize) = (1000, 700);

    fn pair() -> (GreyPyramid, GreyPyramid, Warp) {
        let truth = rigid(2.3, -1.6, 0.4);
        let take = |warp: &Warp, ev| GreyPyramid::new(Scene::new(3).photograph(SIZE, warp, Shot::at(ev)));
        (take(&Warp::Identity, -1.0), take(&truth, 1.0), truth)
    }

    #[test]
    fn a_patch_is_what_the_whole_level_holds_there() {
        let (reference, frame, truth) = pair();
        let pair = Comparison::new(&reference, &frame, &truth);
        let whole = &pair.level(0).both;
        let points = points(&pair);
        let mut patches = Patches::unread(points.len());
        assert!(points.len() > 3000, "{}", points.len());
        for p in points {
            // The same sums, along before down, of values below 256.
            assert!((p.level - whole.reference.at(p.x as usize, p.y as usize)).abs() < 1e-3);
        }
        let h = truth.matrix(SIZE.0, SIZE.1);
        let mut out = Vec::new();
        // Twice: from new patches, and from those that are there; then from such as must be read again.
        let away = rigid(8.3, 5.5, -0.4).matrix(SIZE.0, SIZE.1);
        for h in [h, h, away] {
            patches.residuals(&pair, &h, &mut out);
            let mut compared = 0;
            for (p, r) in points.iter().zip(&out) {
                let (u, v) = map(&h, p.x, p.y);
                if let (Some(r), Some(f)) = (r, cubic::cubic(&whole.frame, u, v)) {
                    // As above.
                    assert!((f - p.level - r).abs() < 1e-3);
                    compared += 1;
                }
            }
            assert!(compared * 10 > 9 * points.len(), "{compared}");
        }
    }

    #[test]
    fn beyond_the_border_there_is_nothing() {
        let plane = Plane::filled(20, 20, 9u8);
        let table = std::array::from_fn(|v| v as f32);
        let is_there = |at| Patch::<SEEN>::read(&plane, &table, at).is_some();
        assert!(is_there((2, 2)) && is_there((10, 10)));
        assert!(!is_there((1, 2)) && !is_there((2, 11)) && !is_there((-5, 3)));
        let patch = Patch::<SEEN>::read(&plane, &table, (2, 2)).unwrap();
        assert_eq!(cubic(&patch, 6.5, 5.25), Some(9.0));
        assert_eq!((cubic(&patch, 2.9, 5.0), cubic(&patch, 8.0, 5.0)), (None, None));
    }
}
