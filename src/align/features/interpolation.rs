//! The extremum of a quadratic through a sample and its neighbours in position and scale (keypoint localisation).
//!
//! In: the 27 samples around a sampled extremum. Out: the offset and the value of the extremum. Cost: none. Source:
//! Brown & Lowe, "Invariant Features from Interest Point Groups", BMVC 2002; Lowe 2004, section 4, eq. 2 and 3.

use nalgebra::{Matrix3, Vector3};

/// Returns the offset of the extremum from the middle sample, in samples (columns, rows, scales), and the value at the
/// extremum; none if the quadratic has no single extremum.
///
/// `sample` returns the sample at an offset of -1, 0 or 1 in each direction.
pub(super) fn extremum(sample: impl Fn(isize, isize, isize) -> f64) -> Option<(Vector3<f64>, f64)> {
    let d = sample;
    let v = d(0, 0, 0);
    let gradient = 0.5 * Vector3::new(d(1, 0, 0) - d(-1, 0, 0), d(0, 1, 0) - d(0, -1, 0), d(0, 0, 1) - d(0, 0, -1));
    let cross = |a: f64, b: f64, c: f64, e: f64| 0.25 * (a - b - c + e);
    let xy = cross(d(1, 1, 0), d(-1, 1, 0), d(1, -1, 0), d(-1, -1, 0));
    let xs = cross(d(1, 0, 1), d(-1, 0, 1), d(1, 0, -1), d(-1, 0, -1));
    let ys = cross(d(0, 1, 1), d(0, -1, 1), d(0, 1, -1), d(0, -1, -1));
    let hessian = Matrix3::new(
        d(1, 0, 0) + d(-1, 0, 0) - 2.0 * v,
        xy,
        xs,
        xy,
        d(0, 1, 0) + d(0, -1, 0) - 2.0 * v,
        ys,
        xs,
        ys,
        d(0, 0, 1) + d(0, 0, -1) - 2.0 * v,
    );
    let offset = -(hessian.try_inverse()? * gradient);
    Some((offset, v + 0.5 * gradient.dot(&offset)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadratic_is_interpolated_exactly() {
        let top = Vector3::new(0.3, -0.2, 0.4);
        let hessian = Matrix3::new(-2.0, 0.5, 0.1, 0.5, -3.0, -0.4, 0.1, -0.4, -1.5);
        let value = |x: isize, y: isize, s: isize| {
            let off = Vector3::new(x as f64, y as f64, s as f64) - top;
            7.0 + 0.5 * (off.transpose() * hessian * off)[0]
        };
        let (offset, peak) = extremum(value).expect("a single extremum");
        assert!((offset - top).norm() < 1e-12 && (peak - 7.0).abs() < 1e-12, "{offset} {peak}");
    }

    #[test]
    fn plane_has_no_extremum() {
        assert!(extremum(|x, y, _| (2 * x + y) as f64).is_none());
    }
}
