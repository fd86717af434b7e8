//! Homography from point pairs by the normalised direct linear transformation.
//!
//! In: pairs of points (reference, frame), with weights. Out: the matrix H with x' ~ H x, scaled so that its lower
//! right element is 1. Cost: about 160 multiply-adds per pair, and one 9 x 9 eigenproblem. Source: Hartley & Zisserman,
//! Multiple View Geometry (2nd ed., 2004), algorithm 4.2.

use crate::align::transform::map;
use nalgebra::{Matrix3, SMatrix, SVector};

/// A point of the reference and the corresponding point of the frame, in pixels.
pub type PointPair = ([f64; 2], [f64; 2]);

/// Returns the homography with the least algebraic error for `pairs`. The error is measured in normalised coordinates.
///
/// `weights`, if given, has one weight of at least 0 for each pair. Otherwise all weights are 1.
///
/// Returns none if the pairs do not determine a homography (there are fewer than four, or three of four on a line), if
/// the homography maps a reference point to behind the camera, or if it mirrors the image.
pub fn fit(pairs: &[PointPair], weights: Option<&[f64]>) -> Option<Matrix3<f64>> {
    let weight = |i: usize| weights.map_or(1.0, |w| w[i]);
    if (0..pairs.len()).filter(|&i| weight(i) > 0.0).count() < 4 {
        return None;
    }
    let from = normalisation(pairs.iter().enumerate().map(|(i, p)| (p.0, weight(i))))?;
    let to = normalisation(pairs.iter().enumerate().map(|(i, p)| (p.1, weight(i))))?;
    // The matrix A^T A, in normalised coordinates. A has the rows (0, -x, y' x) and (x, 0, -x' x) of eq. 4.3 for each
    // pair.
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (i, (p, q)) in pairs.iter().enumerate() {
        let ((x, y), (u, v)) = (map(&from, p[0], p[1]), map(&to, q[0], q[1]));
        let rows = [
            SVector::<f64, 9>::from([0.0, 0.0, 0.0, -x, -y, -1.0, v * x, v * y, v]),
            SVector::<f64, 9>::from([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u]),
        ];
        for row in rows {
            normal.ger(weight(i), &row, &row, 1.0);
        }
    }
    let eigen = normal.symmetric_eigen();
    let mut order: [usize; 9] = std::array::from_fn(|i| i);
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    // If the second smallest eigenvalue is 0 within rounding, the homography is not unique.
    if eigen.eigenvalues[order[1]] <= 1e-9 * eigen.eigenvalues[order[8]] {
        return None;
    }
    let h = eigen.eigenvectors.column(order[0]);
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    let h = to.try_inverse()? * h * from;
    let h = h / h[(2, 2)];
    let in_front = pairs.iter().all(|(p, _)| h[(2, 0)] * p[0] + h[(2, 1)] * p[1] + 1.0 > 0.0);
    (h.iter().all(|v| v.is_finite()) && in_front && h.determinant() > 0.0).then_some(h)
}

/// Returns the similarity that moves the weighted centroid of `points` to the origin, and scales their root mean square
/// distance from it to sqrt(2).
fn normalisation(points: impl Iterator<Item = ([f64; 2], f64)> + Clone) -> Option<Matrix3<f64>> {
    let (mut sx, mut sy, mut sw) = (0.0, 0.0, 0.0);
    for (p, w) in points.clone() {
        (sx, sy, sw) = (sx + w * p[0], sy + w * p[1], sw + w);
    }
    let (cx, cy) = (sx / sw, sy / sw);
    let spread: f64 = points.map(|(p, w)| w * ((p[0] - cx) * (p[0] - cx) + (p[1] - cy) * (p[1] - cy))).sum();
    let s = (2.0 * sw / spread).sqrt();
    s.is_finite().then(|| Matrix3::new(s, 0.0, -s * cx, 0.0, s, -s * cy, 0.0, 0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(h: &Matrix3<f64>, n: usize) -> Vec<PointPair> {
        (0..n)
            .map(|i| {
                // The points are on a parabola that is wrapped at the image size, so that three points are hardly ever
                // on a line.
                let (x, y) = ((i * 1237 % 4000) as f64, (i * i * 331 % 3000) as f64);
                let (u, v) = map(h, x, y);
                ([x, y], [u, v])
            })
            .collect()
    }

    const H: Matrix3<f64> = Matrix3::new(1.01, 0.03, -12.5, -0.02, 0.99, 31.0, 2e-6, -3e-6, 1.0);

    #[test]
    fn exact_points_give_the_exact_homography() {
        for n in [4, 5, 40] {
            let h = fit(&pairs(&H, n), None).unwrap();
            for (p, q) in pairs(&H, 50) {
                let (u, v) = map(&h, p[0], p[1]);
                // A has a condition number of up to 134 (for four pairs), so that of A^T A is up to 1.8e4. The relative
                // error is 1.8e4 times 2e-16, or 4e-12; for 4000 px this is 2e-8 px. The tolerance is larger to leave a
                // margin.
                assert!((u - q[0]).hypot(v - q[1]) < 1e-5, "{n}: {h}");
            }
        }
    }

    #[test]
    fn weights_of_zero_hide_a_pair() {
        let mut list = pairs(&H, 12);
        list[3].1 = [0.0, 0.0];
        let mut weights = vec![1.0; 12];
        weights[3] = 0.0;
        let h = fit(&list, Some(&weights)).unwrap();
        assert!((h - H).abs().max() < 1e-6);
    }

    #[test]
    fn open_questions_have_no_answer() {
        let line: Vec<PointPair> = (0..6).map(|i| ([f64::from(i), 2.0 * f64::from(i)], [f64::from(i), 3.0])).collect();
        assert!(fit(&line, None).is_none());
        assert!(fit(&pairs(&H, 3), None).is_none());
        let mirrored: Vec<PointPair> = pairs(&H, 8).into_iter().map(|(p, q)| (p, [-q[0], q[1]])).collect();
        assert!(fit(&mirrored, None).is_none());
    }
}
