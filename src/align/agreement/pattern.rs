//! The pattern of a tile (a rectangle of the reference): its pixels minus their mean; and the normalised
//! cross-correlation of the pattern with the frame.
//!
//! In: two frames at a common exposure, the second warped to the reference's grid, and a rectangle. Out: correlations
//! at whole-pixel shifts, and the paraboloid around the best one. Cost: three multiply-adds per pixel and shift.
//! Source: Lewis 1995 (see [`agreement`](crate::align::agreement)).

use crate::align::agreement::TileDisplacement;
use crate::align::agreement::warped::{Part, Warped};
use crate::align::photometric::CommonExposure;
use crate::simd::{Loops, vectorised};

/// A tile is undecided if the standard deviation of its pixels is less than this, in grey values. Only pixels with at
/// least `LEAST_WEIGHT` are used.
pub(super) const LEAST_CONTRAST: f32 = 2.5;

/// A tile is undecided if fewer than this number of its pixels have at least `LEAST_WEIGHT`. The number is small, so
/// that a lamp at night suffices.
const LEAST_PIXELS: f32 = 64.0;

/// Pixels whose grey value has a weight (0..=1, see `ToneTables::weight`) below this are ignored.
const LEAST_WEIGHT: f32 = 0.01;

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
    part: Part,
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
    pub(crate) fn new(both: &CommonExposure, part: Part) -> Option<Self> {
        Self::with_contrast(both, part, LEAST_CONTRAST)
    }

    /// The pattern of a tile; none if the standard deviation of its pixels is less than `least`, in grey values, or if
    /// fewer than [`LEAST_PIXELS`] are usable.
    pub(super) fn with_contrast(both: &CommonExposure, part: Part, least: f32) -> Option<Self> {
        let mut values = Vec::with_capacity(part.width * part.height);
        let mut mask = Vec::with_capacity(part.width * part.height);
        for y in part.top..part.top + part.height {
            values.extend_from_slice(&both.reference.row(y)[part.left..part.left + part.width]);
        }
        mask.extend(values.iter().map(|&v| if both.tones.weight(v) >= LEAST_WEIGHT { 1.0 } else { 0.0 }));
        let (count, energy) = vectorised(Centre { values: &mut values, mask: &mask });
        let is_decided = count >= LEAST_PIXELS && energy >= least * least * count;
        is_decided.then_some(Pattern { part, values, mask, count, energy })
    }

    /// Whether the pattern has little contrast in the reference, and the frame has little contrast where the transform
    /// puts the pattern: a standard deviation of less than twice [`LEAST_CONTRAST`]. If such a pattern matches
    /// nowhere, the reason may be noise. If the frame has more contrast, noise is not the reason: the frame shows
    /// something else there than the reference.
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

    /// Returns two sums over the pixels with enough weight. The mean of the frame's grey values is subtracted from
    /// each grey value; the first sum is that of the squares of these differences, the second that of their products
    /// with the pattern. NaN if any pixel of the shifted pattern is outside the frame.
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
        let Part { left, top, width, .. } = pattern.part;
        let rows = pattern.values.chunks_exact(width).zip(pattern.mask.chunks_exact(width));
        for (y, (values, mask)) in rows.enumerate() {
            let frame = warped.row((left as isize + dx, (top + y) as isize + dy), width);
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
