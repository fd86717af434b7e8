//! A cell of the local field: the displacement at one position of the picture, and the precision of this displacement.
//!
//! In: the sum of the paraboloids of the matches around a position. Out: the precision of a [`Cell`]. Cost: negligible.
//! Source: the formula for the inverse covariance of a weighted mean.

/// A displacement is significant if its square, divided by its variance, exceeds this. If errors were normal and
/// independent, a smaller value would do. But the match of a patch in a noisy frame is the maximum of many
/// correlations, and the errors of neighbouring patches are correlated. Measured on rendered brackets.
const SIGNIFICANT: f64 = 40.0;
/// Slope that the correlation has at the true position if the tones of the frames differ slightly, per pixel of the
/// level. Such a slope displaces the peak far at a soft edge, and hardly at a sharp edge. Measured on rendered brackets
/// that are out of focus.
const TONE_SLOPE: f64 = 0.003;

/// A cell of the field. All lengths are in pixels of the level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    /// Centre of the cell in the reference.
    pub(super) centre: [f64; 2],
    /// The displacement d: a detail at position x of the reference is found in the frame at the position to which the
    /// transform maps x + d.
    pub(super) displacement: [f64; 2],
    /// Inverse covariance of the displacement, [xx, xy, yy].
    pub(super) precision: [f64; 3],
    /// Whether at least half of the matches around the cell agree with each other.
    pub(super) agrees: bool,
    /// The part of the picture that is nearer to this cell than to any other, divided by its mean over all cells (see
    /// [`areas`](super::areas)).
    pub(super) area: f64,
}

impl Cell {
    /// Whether the displacement is significantly greater than its error.
    pub(super) fn is_significant(&self) -> bool {
        self.agrees && square(self.precision, self.displacement) > SIGNIFICANT
    }
}

/// Returns the inverse covariance [xx, xy, yy] of the displacement at the peak of a sum of `count` paraboloids. `sum`
/// is the sharpness of the sum, and `v` the variance of the noise of one match.
///
/// Two covariances are added. That of the noise is v `sum`^-1. That of differences between the tones is t^2 S^-2, with
/// the mean sharpness S = `sum` / `count` and t = [`TONE_SLOPE`]. With k = `count` / v, the inverse of their sum is k S
/// (S + k t^2 I)^-1 S.
pub(super) fn precision(sum: [f64; 3], count: f64, v: f64) -> [f64; 3] {
    let [xx, xy, yy] = sum.map(|s| s / count);
    let k = count / v;
    let tones = k * TONE_SLOPE * TONE_SLOPE + 1e-12;
    let (a, c) = (xx + tones, yy + tones);
    let scale = k / (a * c - xy * xy);
    // T is S plus `tones` on the diagonal. The matrix S T^-1 det(T) has the rows (p, q) and (r, s). The division by
    // det(T) is in `scale`. The result is k S T^-1 S.
    let (p, q) = (xx * c - xy * xy, xy * a - xx * xy);
    let (r, s) = (xy * c - yy * xy, yy * a - xy * xy);
    [scale * (p * xx + q * xy), scale * (p * xy + q * yy), scale * (r * xy + s * yy)]
}

/// Returns d^T S d for the symmetric matrix S = [xx, xy, yy].
pub(super) fn square(sharpness: [f64; 3], d: [f64; 2]) -> f64 {
    sharpness[0] * d[0] * d[0] + 2.0 * sharpness[1] * d[0] * d[1] + sharpness[2] * d[1] * d[1]
}
