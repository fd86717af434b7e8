//! The finest level of a large image, read only near the points that are compared.
//!
//! In: a [`FramePair`], and its points on the level on which agreement is measured. Out: for each of these points a
//! nearby point of the finest level, and its residual under a transform. Cost: about 250 pixels are read per point (100
//! of the reference, 144 of the frame), however large the image is. Within a refinement, a new patch of the frame is
//! read only when the point leaves the old one.

use crate::align::grey::{finest_level, measured_level};
use crate::align::refinement::frame_pair::Point;
use crate::align::refinement::patch::{FRAME_PATCH, Origin, Patch, Patches};
use crate::align::refinement::{FramePair, PIECE};
use crate::align::transform::{level_to_full, map};
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Side of the smoothed patches of the reference, in pixels. The point is chosen among the inner 4 x 4 pixels; the
/// border of one pixel is needed for their gradients.
const CHOICE: usize = 6;

/// Returns, for each point of the level on which agreement is measured, the nearby point of the finest level with the
/// largest weighted gradient.
pub(crate) fn points<'a>(pair: &'a FramePair) -> &'a [Point] {
    pair.fine_points(|| {
        let (from, to) = (measured_level(pair.reference()), finest_level(pair.reference()));
        let (plane, tones) = (pair.reference().level(to), pair.tones(to));
        let finer = level_to_full(from - to);
        let chosen = pair.points(from).par_iter().filter_map(|p| {
            let (x, y) = map(&finer, p.x, p.y);
            // The patch is placed so that (x, y) is between its four middle pixels.
            let first = |v: f64| (v - 0.5 * (CHOICE as f64 - 1.0) + 0.5) as i32;
            let origin = [first(x), first(y)];
            let patch = vectorised(Around { plane, table: &tones.reference, origin })?;
            best_of(&patch, |level| tones.weight(level)).map(|(i, j)| {
                let v = &patch.0;
                let around = [v[j][i - 1], v[j][i + 1], v[j - 1][i], v[j + 1][i]];
                Point::new((origin[0] as usize + i, origin[1] as usize + j), v[j][i], around, tones)
            })
        });
        chosen.collect()
    })
}

/// Reads the patch of the reference around a point, unless it reaches beyond the border.
struct Around<'a> {
    plane: &'a Plane<u8>,
    table: &'a [f32; 256],
    origin: Origin,
}

impl Loops for Around<'_> {
    type Output = Option<Patch<CHOICE>>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        Patch::<CHOICE>::fits(self.plane, self.origin).then(|| Patch::read(self.plane, self.table, self.origin))
    }
}

/// Computes frame minus reference at every point under `h`, on the finest level; NaN outside the frame.
///
/// If a point has left its patch of the frame, or has none yet, a new patch is read and stored in `patches`.
pub(crate) fn residuals(pair: &FramePair, patches: &mut Patches, h: &Matrix3<f64>, out: &mut [f32]) {
    let level = finest_level(pair.reference());
    let (plane, table) = (pair.frame().level(level), &pair.tones(level).frame);
    let Patches { origins, values, is_placed } = patches;
    let patches = origins.par_chunks_mut(PIECE).zip(values.par_chunks_mut(PIECE)).zip(is_placed.par_chunks_mut(PIECE));
    let pieces = points(pair).par_chunks(PIECE).zip(patches).zip(out.par_chunks_mut(PIECE));
    pieces.for_each(|((points, ((origins, values), is_placed)), out)| {
        vectorised(Piece { points, h, plane, table, origins, values, is_placed, out });
    });
}

/// Computes the residuals of some of the points; `origins`, `values` and `is_placed` have one element for each point.
struct Piece<'a> {
    points: &'a [Point],
    h: &'a Matrix3<f64>,
    plane: &'a Plane<u8>,
    table: &'a [f32; 256],
    origins: &'a mut [Origin],
    values: &'a mut [Patch<FRAME_PATCH>],
    is_placed: &'a mut [bool],
    out: &'a mut [f32],
}

impl Loops for Piece<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let n = self.points.len();
        let (origins, values) = (&mut self.origins[..n], &mut self.values[..n]);
        let (is_placed, out) = (&mut self.is_placed[..n], &mut self.out[..n]);
        for (k, p) in self.points.iter().enumerate() {
            let (u, v) = map(self.h, p.x, p.y);
            let known = if is_placed[k] { values[k].cubic(origins[k], u, v) } else { None };
            let level = match known {
                Some(level) => Some(level),
                None => {
                    read_again(self.plane, self.table, (u, v), (&mut origins[k], &mut values[k], &mut is_placed[k]))
                }
            };
            out[k] = level.map_or(f32::NAN, |level| level - p.value);
        }
    }
}

/// Places the patch so that (u, v) is in its middle, reads it unless it is already there, and returns the grey value at
/// (u, v). None outside the frame.
#[inline(always)]
fn read_again(
    plane: &Plane<u8>,
    table: &[f32; 256],
    (u, v): (f64, f64),
    (origin, patch, is_placed): (&mut Origin, &mut Patch<FRAME_PATCH>, &mut bool),
) -> Option<f32> {
    // The comparisons are false for NaN.
    let within = |t: f64, n: usize| t >= 0.0 && t < n as f64;
    if !within(u, plane.width()) || !within(v, plane.height()) {
        return None;
    }
    let half = FRAME_PATCH as i32 / 2 - 1;
    let at = [u as i32 - half, v as i32 - half];
    *is_placed = Patch::<FRAME_PATCH>::fits(plane, at);
    if !*is_placed {
        return None;
    }
    if *origin != at {
        (*origin, *patch) = (at, Patch::read(plane, table, at));
    }
    patch.cubic(at, u, v)
}

/// Returns column and row, within `patch`, of the inner pixel with the largest weighted gradient; none if all are 0.
fn best_of(patch: &Patch<CHOICE>, weight: impl Fn(f32) -> f32) -> Option<(usize, usize)> {
    let v = &patch.0;
    let (mut best, mut at) = (0.0, None);
    for j in 1..CHOICE - 1 {
        for i in 1..CHOICE - 1 {
            let (dx, dy) = (v[j][i + 1] - v[j][i - 1], v[j + 1][i] - v[j - 1][i]);
            let square = dx * dx + dy * dy;
            if square > best {
                let strength = square * weight(v[j][i]);
                if strength > best {
                    (best, at) = (strength, Some((i, j)));
                }
            }
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::grey::GreyPyramid;
    use crate::align::resampling::cubic;
    use crate::align::scene::{Scene, Shot, rigid};
    use crate::align::transform::Transform;

    /// This size is large enough that the finest level is larger than the level on which agreement is measured.
    const SIZE: (usize, usize) = (1000, 700);

    fn pair() -> (GreyPyramid, GreyPyramid, Transform) {
        let truth = rigid(2.3, -1.6, 0.4);
        let take =
            |transform: &Transform, ev| GreyPyramid::new(Scene::new(3).photograph(SIZE, transform, Shot::at(ev)));
        (take(&Transform::Identity, -1.0), take(&truth, 1.0), truth)
    }

    #[test]
    fn patch_equals_that_part_of_the_whole_level() {
        let (reference, frame, truth) = pair();
        let pair = FramePair::new(&reference, &frame, &truth);
        let whole = pair.level(0);
        let points = points(&pair);
        let mut patches = Patches::unread(points.len());
        let mut out = vec![0.0; points.len()];
        assert!(points.len() > 3000, "{}", points.len());
        for p in points {
            // Both values are the same sum, computed in another order: the tolerance is for rounding values below 256.
            assert!((p.value - whole.reference.at(p.x as usize, p.y as usize)).abs() < 1e-3);
        }
        let h = truth.matrix(SIZE.0, SIZE.1);
        // The residuals are computed four times: with new patches, with existing patches, with patches that must be
        // read again because the transform moved, and in another refinement, whose result must not depend on the
        // existing patches.
        let away = rigid(8.3, 5.5, -0.4).matrix(SIZE.0, SIZE.1);
        for (h, is_another) in [(h, false), (h, false), (away, false), (h, true)] {
            if is_another {
                patches = patches.reset();
            }
            residuals(&pair, &mut patches, &h, &mut out);
            if is_another {
                let mut fresh = vec![0.0f32; points.len()];
                residuals(&pair, &mut Patches::unread(points.len()), &h, &mut fresh);
                assert!(fresh.iter().zip(&out).all(|(a, b)| a.to_bits() == b.to_bits()));
            }
            let mut compared = 0;
            for (p, r) in points.iter().zip(&out) {
                let (u, v) = map(&h, p.x, p.y);
                if let (false, Some(f)) = (r.is_nan(), cubic::cubic(&whole.frame, u, v)) {
                    // Both values are the same sum, computed in another order.
                    assert!((f - p.value - r).abs() < 1e-3);
                    compared += 1;
                }
            }
            assert!(compared * 10 > 9 * points.len(), "{compared}");
        }
    }
}
