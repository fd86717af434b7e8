//! Patches: small smoothed parts of a level, computed without the rest of it.
//!
//! In: a grey plane, a table of grey values and a position. Out: the smoothed values around it, and interpolation
//! between them. Cost: 12 x 12 look-ups and 160 sums of five values for a patch of 8 x 8; sixteen multiply-adds to
//! interpolate. Source: [`binomial`](crate::pyramid::binomial) for the smoothing; Keys 1981 (see
//! [`cubic`](crate::align::resampling::cubic)).

use crate::align::resampling::cubic::interpolate;
use crate::plane::Plane;

/// Number of pixels on each side of a pixel that the smoothing uses.
const REACH: usize = 2;
/// Side of the frame's patches, in pixels: four for the interpolation, and two at each end, so that the point can move.
pub(crate) const FRAME_PATCH: usize = 8;

/// Column and row of the first pixel of a patch, in pixels of the level.
pub(crate) type Origin = [i32; 2];

/// Smoothed grey values, by rows. Aligned so that two rows of eight share a cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Patch<const N: usize>(pub(crate) [[f32; N]; N]);

impl<const N: usize> Patch<N> {
    /// Whether the patch that begins at (`left`, `top`) is inside `plane`, with all pixels that its smoothing uses.
    #[inline(always)]
    pub(crate) fn fits(plane: &Plane<u8>, [left, top]: Origin) -> bool {
        let (reach, far) = (REACH as i64, (N + REACH) as i64);
        let (left, top) = (i64::from(left), i64::from(top));
        left >= reach && top >= reach && left + far <= plane.width() as i64 && top + far <= plane.height() as i64
    }

    /// Computes the patch of `plane` that begins at (`left`, `top`) and [fits](Self::fits): the pixels' values in
    /// `table`, smoothed as in the whole level.
    #[inline(always)]
    pub(crate) fn read(plane: &Plane<u8>, table: &[f32; 256], [left, top]: Origin) -> Self {
        let (left, top) = (left as usize, top as usize);
        let mut along = [[0.0f32; N]; 16];
        for (k, row) in along[..N + 2 * REACH].iter_mut().enumerate() {
            let codes = &plane.row(top + k - REACH)[left - REACH..left + N + REACH];
            let mut levels = [0.0f32; 16];
            for (l, &v) in levels.iter_mut().zip(codes) {
                *l = table[usize::from(v)];
            }
            for i in 0..N {
                row[i] = 6.0 * levels[i + 2] + 4.0 * (levels[i + 1] + levels[i + 3]) + (levels[i] + levels[i + 4]);
            }
        }
        let mut values = [[0.0f32; N]; N];
        for (j, row) in values.iter_mut().enumerate() {
            for i in 0..N {
                let sum =
                    6.0 * along[j + 2][i] + 4.0 * (along[j + 1][i] + along[j + 3][i]) + (along[j][i] + along[j + 4][i]);
                row[i] = sum * (1.0 / 256.0);
            }
        }
        Patch(values)
    }
}

impl Patch<FRAME_PATCH> {
    /// Returns the value at (u, v), in pixels of the level, by cubic convolution; none if the patch lacks one of the
    /// sixteen samples.
    #[inline(always)]
    pub(crate) fn cubic(&self, [left, top]: Origin, u: f64, v: f64) -> Option<f32> {
        let (u, v) = (u - f64::from(left), v - f64::from(top));
        let inside = |t: f64| t >= 1.0 && t < (FRAME_PATCH - 2) as f64;
        if !inside(u) || !inside(v) {
            return None;
        }
        let (x, y) = (u as i32, v as i32);
        let fraction = [(u - f64::from(x)) as f32, (v - f64::from(y)) as f32];
        let (x, y) = (x as usize, y as usize);
        Some(interpolate(fraction, |j| &self.0[y + j - 1][x - 1..x + 3]))
    }
}

/// Patches of the frame, one for each point.
///
/// They are kept between refinements, so that a patch at the same position is read only once. This saves time and does
/// not change the result.
#[derive(Debug)]
pub(crate) struct Patches {
    pub(crate) origins: Vec<Origin>,
    pub(crate) values: Vec<Patch<FRAME_PATCH>>,
    /// Whether the current refinement has chosen the position of each patch.
    pub(crate) is_placed: Vec<bool>,
}

impl Patches {
    /// Returns empty patches for `points` points.
    pub(crate) fn unread(points: usize) -> Self {
        // No patch can be at this position.
        let nowhere = [-1, -1];
        Patches {
            origins: vec![nowhere; points],
            values: vec![Patch([[0.0; FRAME_PATCH]; FRAME_PATCH]); points],
            is_placed: vec![false; points],
        }
    }

    /// Returns these patches for a new refinement: no position counts as chosen, but the values that were read are
    /// kept.
    pub(crate) fn reset(mut self) -> Self {
        self.is_placed.fill(false);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resampling_outside_the_frame_returns_nothing() {
        let plane = Plane::filled(20, 20, 9u8);
        let table = std::array::from_fn(|v| v as f32);
        let fits = |at| Patch::<FRAME_PATCH>::fits(&plane, at);
        assert!(fits([2, 2]) && fits([10, 10]));
        assert!(!fits([1, 2]) && !fits([2, 11]) && !fits([-5, 3]));
        let (at, patch) = ([2, 2], Patch::<FRAME_PATCH>::read(&plane, &table, [2, 2]));
        assert_eq!(patch.cubic(at, 6.5, 5.25), Some(9.0));
        assert_eq!((patch.cubic(at, 2.9, 5.0), patch.cubic(at, 8.0, 5.0)), (None, None));
    }
}
