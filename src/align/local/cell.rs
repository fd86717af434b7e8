//! A cell of the local field: the displacement of a place, and how precisely it is known.
//!
//! In: the sum of the paraboloids of the matches around a place. Out: a [`Cell`]. Cost: negligible. Source: the inverse
//! covariance of a weighted mean.

/// A displacement is significant if its square, in units of its variance, exceeds this. Independent normal errors would
/// never exceed it, but matches of a noisy frame are maxima among many, and the errors of neighbours are correlated.
/// Measured on rendered brackets.
const SIGNIFICANT: f64 = 40.0;
/// Slope of the correlation that a difference between the tones of the frames causes, per pixel of the level. This
/// slope displaces the peak of a soft edge far, and that of a sharp edge hardly. Measured on rendered brackets that are
/// out of focus.
const TONE_SLOPE: f64 = 0.003;

/// A cell of the field. All lengths are in pixels of the level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    /// Its centre in the reference.
    pub(super) centre: [f64; 2],
    /// Its displacement d: a detail at x in the reference is found in the frame where the transform maps x + d.
    pub(super) displacement: [f64; 2],
    /// Inverse covariance of the displacement, [xx, xy, yy].
    pub(super) precision: [f64; 3],
    /// Whether most of the matches around it agree with each other.
    pub(super) agrees: bool,
}

impl Cell {
    /// Whether the displacement is greater than its error.
    pub(super) fn is_significant(&self) -> bool {
        self.agrees && square(self.precision, self.displacement) > SIGNIFICANT
    }
}

/// The inverse covariance of the displacement at the peak of the sum of `count` paraboloids with the sharpness `sum`.
///
/// Noise has the covariance v `sum`^-1, and differences of the tones have t^2 S^-2, with the mean sharpness S and t =
/// [`TONE_SLOPE`]. With k = `count` / v, the inverse of their sum is k S (S + k t^2 I)^-1 S.
pub(super) fn precision(sum: [f64; 3], count: f64, v: f64) -> [f64; 3] {
    let [xx, xy, yy] = sum.map(|s| s / count);
    let k = count / v;
    let tones = k * TONE_SLOPE * TONE_SLOPE + 1e-12;
    let (a, c) = (xx + tones, yy + tones);
    let scale = k / (a * c - xy * xy);
    // (p, q) and (r, s) are the rows of S (S + k t^2 I)^-1 without its denominator; the result is this matrix times S.
    let (p, q) = (xx * c - xy * xy, xy * a - xx * xy);
    let (r, s) = (xy * c - yy * xy, yy * a - xy * xy);
    [scale * (p * xx + q * xy), scale * (p * xy + q * yy), scale * (r * xy + s * yy)]
}

/// Returns d^T S d for the symmetric matrix S = [xx, xy, yy].
pub(super) fn square(sharpness: [f64; 3], d: [f64; 2]) -> f64 {
    sharpness[0] * d[0] * d[0] + 2.0 * sharpness[1] * d[0] * d[1] + sharpness[2] * d[1] * d[1]
}
