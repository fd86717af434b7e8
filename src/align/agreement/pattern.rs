//! The pattern of a tile (a square of the reference): its pixels minus their mean; and the normalised cross-correlation
//! of the pattern with the frame.
//!
//! In: two frames at a common exposure, the second warped to the reference's grid, and a square. Out: correlations at
//! whole-pixel shifts, and the paraboloid around the best one. Cost: three multiply-adds per pixel and shift. Source:
//! Lewis 1995 (see [`agreement`](crate::align::agreement)).

use crate::align::agreement::TileDisplacement;
use crate::align::photometric::CommonExposure;
use crate::align::transform::map;
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use nalgebra::Matrix3;

/// A tile is undecided if the standard deviation of its pixels is less than this, in grey values. Only pixels with at
/// least `LEAST_WEIGHT` are used.
pub(super) const LEAST_CONTRAST: f32 = 2.5;

/// A tile is undecided if fewer than this number of its pixels have at least `LEAST_WEIGHT`. The number is small, so
/// that a lamp at night suffices.
const LEAST_PIXELS: f32 = 64.0;

/// Pixels whose grey value has a weight (0..=1, see `ToneTables::weight`) below this are ignored.
const LEAST_WEIGHT: f32 = 0.01;

/// A frame on the reference's grid, with a margin on all sides.
pub(crate) struct Warped {
    /// The pixels of the frame; NaN in the margin and outside the frame.
    plane: Plane<f32>,
    margin: usize,
}

impl Warped {
    /// Warps `frame` with the transform `h`, reference -> frame in pixels of the planes.
    pub(crate) fn new(frame: &Plane<f32>, h: &Matrix3<f64>, (width, height): (usize, usize), margin: usize) -> Self {
        let is_identity = *h == Matrix3::identity();
        let mut plane = Plane::filled(width + 2 * margin, height + 2 * margin, f32::NAN);
        plane.fill_rows(|row_at, row| {
            let Some(y) = row_at.checked_sub(margin).filter(|&y| y < height) else { return };
            let row = &mut row[margin..margin + width];
            if is_identity {
                // This gives the same values as `WarpRow`, which omits the frame's last row and column because they
                // have no next neighbour to interpolate with.
                if y + 1 < frame.height() {
                    let count = width.min(frame.width() - 1);
                    row[..count].copy_from_slice(&frame.row(y)[..count]);
                }
            } else {
                vectorised(WarpRow { frame, h, y, row });
            }
        });
        Warped { plane, margin }
    }

    /// Largest shift at which patterns can be compared, in pixels.
    pub(crate) fn reach(&self) -> isize {
        self.margin as isize
    }
}

/// Computes row `y` of a frame on the reference's grid; leaves pixels outside the frame as they are.
struct WarpRow<'a> {
    frame: &'a Plane<f32>,
    h: &'a Matrix3<f64>,
    y: usize,
    row: &'a mut [f32],
}

impl Loops for WarpRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let WarpRow { frame, h, y, row } = self;
        let (right, bottom) = (frame.width() as f64 - 1.0, frame.height() as f64 - 1.0);
        let is_inside = |(u, w): (f64, f64)| u >= 0.0 && w >= 0.0 && u < right && w < bottom;
        for (start, piece) in row.chunks_mut(PIECE).enumerate().map(|(i, p)| (i * PIECE, p)) {
            // Over a few pixels a homography is linear to within some thousandths of a pixel.
            let from = map(h, start as f64, y as f64);
            let to = map(h, (start + PIECE) as f64, y as f64);
            let step = ((to.0 - from.0) / PIECE as f64, (to.1 - from.1) / PIECE as f64);
            let at = |i: usize| (from.0 + step.0 * i as f64, from.1 + step.1 * i as f64);
            let (first, last) = (at(0), at(piece.len() - 1));
            let (column, line) = (first.0 as usize, first.1 as usize);
            let is_one_line = is_inside(first) && is_inside(last) && line == last.1 as usize;
            if let (true, Ok(piece)) = (is_one_line, <&mut [f32; PIECE]>::try_from(&mut *piece))
                && last.0 as usize == column + PIECE - 1
            {
                // All pixels of the piece are between the same two rows of the frame, each one column to the right of
                // the one before.
                let pixels = |y: usize| frame.row(y)[column..].first_chunk::<{ PIECE + 1 }>();
                let Some((upper, lower)) = pixels(line).zip(pixels(line + 1)) else { continue };
                for (i, v) in piece.iter_mut().enumerate() {
                    let (u, w) = at(i);
                    let (fx, fy) = ((u - (column + i) as f64) as f32, (w - line as f64) as f32);
                    *v = blend((upper[i], upper[i + 1]), (lower[i], lower[i + 1]), (fx, fy));
                }
            } else {
                for (i, v) in piece.iter_mut().enumerate().filter(|(i, _)| is_inside(at(*i))) {
                    let (u, w) = at(i);
                    let (x, y) = (u as usize, w as usize);
                    let (upper, lower) = (&frame.row(y)[x..x + 2], &frame.row(y + 1)[x..x + 2]);
                    let fractions = ((u - x as f64) as f32, (w - y as f64) as f32);
                    *v = blend((upper[0], upper[1]), (lower[0], lower[1]), fractions);
                }
            }
        }
    }
}

/// Returns the value at the fractions (`fx`, `fy`) of the way between four pixels: (left, right) of the upper and the
/// lower row.
#[inline(always)]
fn blend(upper: (f32, f32), lower: (f32, f32), (fx, fy): (f32, f32)) -> f32 {
    let (top, bottom) = (upper.0 + fx * (upper.1 - upper.0), lower.0 + fx * (lower.1 - lower.0));
    top + fy * (bottom - top)
}

/// Length, in pixels, of the parts of a row within which positions are interpolated linearly.
const PIECE: usize = 16;

/// Error of the measured displacement of a tile, in pixels of the planes: root mean square over tiles that are not
/// displaced. The error has two causes: interpolation, and the paraboloid that approximates the peak of the
/// correlation. Measured on rendered brackets of planar scenes.
pub(crate) const PEAK_BIAS: f64 = 0.03;

/// The paraboloid through the correlations around a tile's best match.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Peak {
    at: Shift,
    gradient: [f64; 2],
    sharpness: [f64; 3],
}

impl Peak {
    /// Returns the paraboloid through the correlations at a shift and at its eight neighbours; none if one of them is
    /// NaN, or if they have no maximum along x or y. `at` returns the correlation at a shift.
    pub(crate) fn around((x, y): Shift, mut at: impl FnMut(Shift) -> f32) -> Option<Self> {
        let mut c = [[0.0f64; 3]; 3];
        for (j, row) in (-1..).zip(&mut c) {
            for (i, v) in (-1..).zip(row) {
                *v = f64::from(at((x + i, y + j)));
            }
        }
        let gradient = [0.5 * (c[1][2] - c[1][0]), 0.5 * (c[2][1] - c[0][1])];
        let xx = 2.0 * c[1][1] - c[1][0] - c[1][2];
        let yy = 2.0 * c[1][1] - c[0][1] - c[2][1];
        let xy = -0.25 * (c[2][2] - c[2][0] - c[0][2] + c[0][0]);
        // A paraboloid through a curved ridge may rise along the crest and have no maximum. The cross term is limited
        // so that it has one.
        let limit = 0.95 * (xx * yy).max(0.0).sqrt();
        let known = c.iter().flatten().all(|v| v.is_finite()) && xx >= 0.0 && yy >= 0.0;
        known.then(|| Peak { at: (x, y), gradient, sharpness: [xx, xy.clamp(-limit, limit), yy] })
    }

    /// Returns the displacement of the tile with this centre. With the sharpness S and the gradient g at `at`, the peak
    /// is at `at` + S^-1 g, so `pull`, which is S times the displacement, is S `at` + g.
    pub(crate) fn about(&self, centre: [f64; 2]) -> TileDisplacement {
        let [xx, xy, yy] = self.sharpness;
        let (x, y) = (self.at.0 as f64, self.at.1 as f64);
        let pull = [xx * x + xy * y + self.gradient[0], xy * x + yy * y + self.gradient[1]];
        TileDisplacement { centre, sharpness: self.sharpness, pull }
    }
}

/// The pixels of a tile in the reference minus their mean; 0 where the weight is below `LEAST_WEIGHT`.
pub(crate) struct Pattern {
    left: usize,
    top: usize,
    side: usize,
    /// The pixels, row by row.
    values: Vec<f32>,
    /// 1 where a pixel has enough weight, 0 elsewhere.
    mask: Vec<f32>,
    /// Number of pixels with enough weight.
    pub(crate) count: f32,
    /// The sum of the squares of `values`.
    energy: f32,
}

impl Pattern {
    /// The pattern of a tile; none if it has too little contrast or fewer than [`LEAST_PIXELS`] usable pixels.
    pub(crate) fn new(both: &CommonExposure, left: usize, top: usize, side: usize) -> Option<Self> {
        Self::with_contrast(both, left, top, side, LEAST_CONTRAST)
    }

    /// The pattern of a tile; none if the standard deviation of its pixels is less than `least`, in grey values, or if
    /// fewer than [`LEAST_PIXELS`] are usable.
    pub(super) fn with_contrast(
        both: &CommonExposure,
        left: usize,
        top: usize,
        side: usize,
        least: f32,
    ) -> Option<Self> {
        let mut values = Vec::with_capacity(side * side);
        let mut mask = Vec::with_capacity(side * side);
        for y in top..top + side {
            values.extend_from_slice(&both.reference.row(y)[left..left + side]);
        }
        mask.extend(values.iter().map(|&v| if both.tones.weight(v) >= LEAST_WEIGHT { 1.0 } else { 0.0 }));
        let (count, energy) = vectorised(Centre { values: &mut values, mask: &mask });
        let is_decided = count >= LEAST_PIXELS && energy >= least * least * count;
        is_decided.then_some(Pattern { left, top, side, values, mask, count, energy })
    }

    /// Whether the standard deviation of the pixels is less than twice [`LEAST_CONTRAST`], both in the reference and,
    /// at the position that the transform gives, in the frame. If only the reference is faint, noise does not explain
    /// the contrast of the frame.
    pub(super) fn is_faint_in_both(&self, warped: &Warped) -> bool {
        let faint = 4.0 * LEAST_CONTRAST * LEAST_CONTRAST * self.count;
        self.energy < faint && self.moments(warped, (0, 0)).0 < faint
    }

    /// Returns the correlation with the frame shifted by `shift`; NaN if a needed pixel is outside the frame.
    pub(crate) fn correlation(&self, warped: &Warped, shift: Shift) -> f32 {
        let (variance, products) = self.moments(warped, shift);
        // Where the frame has no structure, its variance is close to 0. The lower limit keeps the correlation low
        // there.
        if variance.is_nan() { f32::NAN } else { products / (self.energy * variance.max(0.25 * self.count)).sqrt() }
    }

    /// Returns two sums over the pixels with enough weight: the squares of the frame's grey values minus their mean,
    /// and their products with the pattern. NaN if any pixel of the shifted square is outside the frame.
    fn moments(&self, warped: &Warped, shift: Shift) -> (f32, f32) {
        let [sum, squares, products] = vectorised(Moments { pattern: self, warped, shift });
        (squares - sum * sum / self.count, products)
    }
}

/// Subtracts the mean of the pixels with enough weight from them, and sets the other pixels to 0.
struct Centre<'a> {
    values: &'a mut [f32],
    mask: &'a [f32],
}

impl Loops for Centre<'_> {
    /// The number of pixels with enough weight, and the sum of the squares of the resulting values.
    type Output = (f32, f32);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let (mut counts, mut sums, mut squares) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        for (values, mask) in self.values.chunks_mut(LANES).zip(self.mask.chunks(LANES)) {
            for (i, (v, m)) in values.iter_mut().zip(mask).enumerate() {
                *v *= m;
                counts[i] += m;
                sums[i] += *v;
            }
        }
        let count = total(&counts);
        let mean = total(&sums) / count.max(1.0);
        for (values, mask) in self.values.chunks_mut(LANES).zip(self.mask.chunks(LANES)) {
            for (i, (v, m)) in values.iter_mut().zip(mask).enumerate() {
                *v -= m * mean;
                squares[i] += *v * *v;
            }
        }
        (count, total(&squares))
    }
}

/// Computes the sums from which the correlation of a pattern with the frame shifted by `shift` follows.
struct Moments<'a> {
    pattern: &'a Pattern,
    warped: &'a Warped,
    shift: Shift,
}

impl Loops for Moments<'_> {
    /// The sums of the frame's grey values, of their squares, and of their products with the pattern.
    type Output = [f32; 3];

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Moments { pattern, warped, shift: (dx, dy) } = self;
        let (mut sums, mut squares, mut products) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        // The sums over the last columns of each row, whose number is less than `LANES`.
        let mut rest = [0.0f32; 3];
        let margin = warped.reach();
        let left = (pattern.left as isize + margin + dx) as usize;
        let rows = pattern.values.chunks_exact(pattern.side).zip(pattern.mask.chunks_exact(pattern.side));
        for (y, (values, mask)) in rows.enumerate() {
            let frame =
                &warped.plane.row(((pattern.top + y) as isize + margin + dy) as usize)[left..left + pattern.side];
            let (v, v_rest) = values.as_chunks::<LANES>();
            let (m, m_rest) = mask.as_chunks::<LANES>();
            let (f, f_rest) = frame.as_chunks::<LANES>();
            for ((v, m), f) in v.iter().zip(m).zip(f) {
                for i in 0..LANES {
                    let counted = m[i] * f[i];
                    sums[i] += counted;
                    squares[i] += counted * f[i];
                    products[i] += v[i] * f[i];
                }
            }
            for ((v, m), f) in v_rest.iter().zip(m_rest).zip(f_rest) {
                rest[0] += m * f;
                rest[1] += m * f * f;
                rest[2] += v * f;
            }
        }
        [total(&sums) + rest[0], total(&squares) + rest[1], total(&products) + rest[2]]
    }
}

/// Number of partial sums that are computed side by side.
const LANES: usize = 8;

/// Returns the sum of `lanes`.
///
/// Not inlined: if the compiler sees the order of these additions, it splits the vectors of the loops before the call,
/// which makes these loops five times slower.
#[inline(never)]
fn total(lanes: &[f32; LANES]) -> f32 {
    lanes.iter().sum()
}

/// A shift of whole pixels: (to the right, down).
pub(crate) type Shift = (isize, isize);
