//! Least squares by orthogonal transformations.
//!
//! In: weighted equations, row by row. Out: the unknowns, and the condition of the equations. Cost: 2 n^2 operations
//! per row for n unknowns (about 4 us for n = 47), and one singular value decomposition of an n x n matrix. Memory: a
//! few hundred rows, however many are added. Source: Golub & Van Loan, "Matrix Computations", sections 5.2
//! (Householder), 5.3 (full-rank least squares) and 5.4 (R-SVD).
//!
//! Householder reflections combine the rows into a triangular matrix R. Apart from the rounding of `f64`, R has the
//! same singular values and the same solution as the matrix of all rows. The normal equations A'A would square the
//! singular values and lose half of the digits. The singular values decide whether there is a solution: see
//! [`fit::determined`].

use crate::response::fit::{self, Fitted};
use nalgebra::{DMatrix, SVD};

/// Number of rows that are folded into the triangle at once; these rows and the triangle fit into the cache of a core.
const ROWS: usize = 128;
/// Largest number of steps of the singular value decomposition; it converges in two or three per unknown.
const STEPS: usize = 30 * 256;

/// Equations in several unknowns. There may be more equations than fit into memory.
pub struct LeastSquares {
    /// The upper rows are the triangle of the equations [A b] that are already folded. Below are the rows that are not
    /// yet folded, and zeros.
    rows: DMatrix<f64>,
    waiting: usize,
}

impl LeastSquares {
    /// Creates a system without equations.
    pub fn new(unknowns: usize) -> Self {
        LeastSquares { rows: DMatrix::zeros(unknowns + 1 + ROWS, unknowns + 1), waiting: 0 }
    }

    /// Adds the equation `scale` x (`row` x unknowns) = `scale` x right, where `row` ends in the right side.
    pub fn push(&mut self, row: &[f64], scale: f64) {
        let at = self.rows.ncols() + self.waiting;
        row.iter().enumerate().for_each(|(k, v)| self.rows[(at, k)] = scale * v);
        self.waiting += 1;
        if self.waiting == ROWS {
            self.fold();
        }
    }

    /// Folds the pending rows into the triangle.
    fn fold(&mut self) {
        let (rows, columns) = self.rows.shape();
        let triangle = std::mem::take(&mut self.rows).qr().unpack_r();
        self.rows = triangle.resize(rows, columns, 0.0);
        self.waiting = 0;
    }

    /// Returns the unknowns, and the ratio of the largest to the smallest singular value of the equations.
    pub fn solve(mut self) -> Fitted<(Vec<f64>, f64)> {
        self.fold();
        let n = self.rows.ncols() - 1;
        let right = self.rows.view((0, n), (n, 1)).into_owned();
        let triangle = self.rows.view((0, 0), (n, n)).into_owned();
        if triangle.iter().any(|v| !v.is_finite()) {
            return Err(fit::undetermined(f64::NAN));
        }
        let svd = SVD::try_new(triangle, true, true, f64::EPSILON, STEPS).ok_or_else(|| fit::undetermined(f64::NAN))?;
        let condition = svd.singular_values.max() / svd.singular_values.min();
        fit::determined(condition)?;
        let solution = svd.solve(&right, 0.0).map_err(str::to_owned)?;
        Ok((solution.as_slice().to_vec(), condition))
    }
}

/// Eliminates an unknown that occurs only in the weighted `rows` of one place, each `width` long. `own` is the column
/// of this unknown. A Householder reflection makes all elements of `own` but the first 0. So only the first row still
/// contains the unknown, and is dropped. Returns the other rows.
pub fn eliminate<'a>(rows: &'a mut [f64], width: usize, own: &mut [f64]) -> &'a [f64] {
    let norm = own.iter().map(|v| v * v).sum::<f64>().sqrt();
    if norm > 0.0 {
        own[0] += if own[0] < 0.0 { -norm } else { norm };
        let square: f64 = own.iter().map(|v| v * v).sum();
        let mut along = vec![0.0; width];
        for (row, v) in rows.chunks_exact(width).zip(&*own) {
            along.iter_mut().zip(row).for_each(|(sum, a)| *sum += v * a);
        }
        for (row, v) in rows.chunks_exact_mut(width).zip(&*own) {
            row.iter_mut().zip(&along).for_each(|(a, sum)| *a -= 2.0 / square * v * sum);
        }
    }
    &rows[width..]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::fit::scene::noise;
    use nalgebra::DVector;

    #[test]
    fn solution_and_condition_are_those_of_the_whole_matrix() {
        let (m, n) = (3 * ROWS + 17, 9);
        let a = DMatrix::from_fn(m, n, |i, k| noise(n * i + k));
        let b = DVector::from_fn(m, |i, _| noise(7919 + i));
        let mut equations = LeastSquares::new(n);
        for i in 0..m {
            let row: Vec<f64> = a.row(i).iter().copied().chain([b[i]]).collect();
            equations.push(&row.iter().map(|v| v / 3.0).collect::<Vec<_>>(), 3.0);
        }
        let (x, condition) = equations.solve().unwrap();
        let svd = a.svd(true, true);
        let expected = svd.solve(&b, 0.0).unwrap();
        assert!(x.iter().zip(&expected).all(|(x, e)| (x - e).abs() < 1e-13));
        let whole = svd.singular_values.max() / svd.singular_values.min();
        assert!((condition / whole - 1.0).abs() < 1e-12);
    }

    /// The test uses Läuchli's matrix. Its condition number is 3e4, and the square of that number is 1e9.
    #[test]
    fn digits_are_lost_by_the_condition_and_not_by_its_square() {
        let small = 5e-5;
        let mut equations = LeastSquares::new(2);
        // The solution is (1, -1); rows: [1 1 | 0], [small 0 | small], [0 small | -small].
        [[1.0, 1.0, 0.0], [small, 0.0, small], [0.0, small, -small]].iter().for_each(|row| equations.push(row, 1.0));
        let (x, condition) = equations.solve().unwrap();
        assert!((condition * small / 2f64.sqrt() - 1.0).abs() < 1e-8, "{condition}");
        // The tolerance is the condition number, 3e4, times the rounding error of 2e-16, with a margin. With normal
        // equations the error would be 1e-8.
        assert!((x[0] - 1.0).abs() < 1e-11 && (x[1] + 1.0).abs() < 1e-11, "{x:?}");
    }

    #[test]
    fn equations_without_a_solution_of_their_own_are_refused() {
        let mut equations = LeastSquares::new(2);
        (0..9).for_each(|i| equations.push(&[1.0, 2.0, f64::from(i)], 1.0));
        assert!(equations.solve().unwrap_err().contains("do not determine the curve"));
        let mut equations = LeastSquares::new(1);
        equations.push(&[f64::NAN, 1.0], 1.0);
        assert!(equations.solve().is_err());
        assert!(LeastSquares::new(3).solve().is_err());
    }

    #[test]
    fn an_eliminated_unknown_leaves_the_others_as_they_are() {
        // Seven equations in three common unknowns, and in one unknown that no other equation contains.
        let (m, n) = (7, 3);
        let a = DMatrix::from_fn(m, n + 1, |i, k| noise(5 * i + k));
        let b = DVector::from_fn(m, |i, _| noise(997 + i));
        let mut rows: Vec<f64> =
            (0..m).flat_map(|i| (0..n).map(|k| a[(i, k)]).chain([b[i]]).collect::<Vec<_>>()).collect();
        let mut own: Vec<f64> = (0..m).map(|i| a[(i, n)]).collect();
        let left = eliminate(&mut rows, n + 1, &mut own);
        assert_eq!(left.len(), (m - 1) * (n + 1));
        let mut equations = LeastSquares::new(n);
        left.chunks_exact(n + 1).for_each(|row| equations.push(row, 1.0));
        let (x, _) = equations.solve().unwrap();
        let expected = a.svd(true, true).solve(&b, 0.0).unwrap();
        assert!(x.iter().zip(&expected).all(|(x, e)| (x - e).abs() < 1e-13));
    }
}
