//! Patches: small smoothed parts of a level, computed without the rest of the level.
//!
//! In: a grey plane, a table that converts its grey values, and a position. Out: the smoothed values around the
//! position, and the value interpolated between them. Cost: 12 x 12 look-ups and 160 sums of five values for a patch of
//! 8 x 8 pixels; sixteen multiply-adds for each interpolated value. Source: [`binomial`](crate::pyramid::binomial) for
//! the smoothing; Keys 1981 (see [`cubic`](crate::align::resampling::cubic)).

use crate::align::resampling::cubic::interpolate;
use crate::plane::Plane;

/// To smooth a pixel, this number of pixels on each side of it are used.
const REACH: usize = 2;
/// Side of the frame's patches, in pixels: the interpolation needs four, and two more at each end let the point move
/// without reading a new patch.
pub(crate) const FRAME_PATCH: usize = 8;

/// Column and row of the first pixel of a patch, in pixels of the level.
pub(crate) type Origin = [i32; 2];

/// Smoothed grey values, row by row. The alignment makes two rows of eight values share a cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Patch<const N: usize>(pub(crate) [[f32; N]; N]);

impl<const N: usize> Patch<N> {
    /// Whether the patch whose first pixel is (`left`, `top`) is inside `plane`, with all pixels that its smoothing
    /// uses.
    #[inline(always)]
    pub(crate) fn fits(plane: &Plane<u8>, [left, top]: Origin) -> bool {
        let (reach, far) = (REACH as i64, (N + REACH) as i64);
        let (left, top) = (i64::from(left), i64::from(top));
        left >= reach && top >= reach && left + far <= plane.width() as i64 && top + far <= plane.height() as i64
    }

    /// Computes the patch of `plane` whose first pixel is (`left`, `top`): converts the grey values by `table` and
    /// smooths them as in the whole level. The patch must [fit](Self::fits).
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
    /// Interpolates at (u, v), in pixels of the level, by cubic convolution. Returns none if the patch lacks one of the
    /// sixteen samples. `[left, top]` is the first pixel of the patch.
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
/// The patches are kept from one refinement of a pair to the next, so that a patch at the same position need not be
/// read again. This saves time and does not change the result.
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
