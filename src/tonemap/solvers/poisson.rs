//! Integrates gradients: finds the picture whose differences from cell to cell are nearest to given differences
//! (Poisson equation).
//!
//! In: differences along rows and columns; they need not belong to any picture. Out: the nearest picture with mean 0,
//! for Neumann boundary conditions. Cost: about 10 iterations for any size of grid, each of 0.05 us of core time per
//! cell. Source: Fattal, Lischinski, Werman, "Gradient Domain High Dynamic Range Compression" (2002), section 3,
//! equations 3 to 6, for the problem; Briggs, Henson, McCormick, "A Multigrid Tutorial" (2000), chapters 2 and 3, for
//! the V-cycle; Tatebe, "The Multigrid Preconditioned Conjugate Gradient Method" (1993), for the iterations.

use crate::plane::{Plane, fold_bands};

/// Relative error, in the energy norm of the Laplacian, at which the solver stops. For a range of ten stops it is a
/// thousandth of a stop.
const TOLERANCE: f64 = 1e-4;

/// Largest number of iterations; about ten are needed.
const MOST_STEPS: usize = 40;

/// Returns the picture whose differences are nearest to the given ones by least squares. `right` holds the differences
/// to the right neighbours, `down` the differences to the lower neighbours. The last column of `right` and the last row
/// of `down` are ignored.
pub fn integrated(right: &Plane<f32>, down: &Plane<f32>) -> Plane<f32> {
    let divergence = divergence(right, down);
    let grid = Multigrid::new((right.width(), right.height()));
    let picture = conjugate_gradients(
        &divergence,
        |plane| grid.laplacian(plane),
        |residual| grid.cycle(residual),
        TOLERANCE,
        MOST_STEPS,
    );
    let mean = sum(&picture) / picture.as_slice().len().max(1) as f64;
    let centred = picture.as_slice().iter().map(|v| v - mean as f32).collect();
    Plane::from_vec(picture.width(), picture.height(), centred)
}

/// Returns the negative divergence, which is the transpose of taking differences. For each cell, this is the sum of the
/// differences from its left and upper neighbours to the cell, minus the sum of the differences from the cell to its
/// right and lower neighbours.
pub fn divergence(right: &Plane<f32>, down: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (right.width(), right.height());
    Plane::from_rows(width, height, |y, row| {
        let across = &right.row(y)[..width - 1];
        row[1..].copy_from_slice(across);
        row.iter_mut().zip(across).for_each(|(v, d)| *v -= d);
        if y > 0 {
            row.iter_mut().zip(down.row(y - 1)).for_each(|(v, d)| *v += d);
        }
        if y + 1 < height {
            row.iter_mut().zip(down.row(y)).for_each(|(v, d)| *v -= d);
        }
    })
}

/// Solves `apply`(x) = `right` by preconditioned conjugate gradients.
///
/// `apply` must be symmetric and positive semidefinite, and `precondition` must be a symmetric approximation of the
/// inverse of `apply`. Stops when the residual, in the norm of `precondition`, is below `tolerance` times the residual
/// at the start, or after `most` steps.
pub fn conjugate_gradients(
    right: &Plane<f32>,
    apply: impl Fn(&Plane<f32>) -> Plane<f32>,
    precondition: impl Fn(&Plane<f32>) -> Plane<f32>,
    tolerance: f64,
    most: usize,
) -> Plane<f32> {
    let mut x = Plane::filled(right.width(), right.height(), 0.0f32);
    let mut residual = right.clone();
    let mut guess = precondition(&residual);
    let mut square = dot(&residual, &guess);
    let enough = square * tolerance * tolerance;
    let mut direction = guess.clone();
    for _ in 0..most {
        let applied = apply(&direction);
        let curvature = dot(&direction, &applied);
        if square <= enough || curvature <= 0.0 {
            break;
        }
        let step = (square / curvature) as f32;
        add(&mut x, step, &direction);
        add(&mut residual, -step, &applied);
        guess = precondition(&residual);
        let next = dot(&residual, &guess);
        let turn = (next / square) as f32;
        square = next;
        for (d, g) in direction.as_mut_slice().iter_mut().zip(guess.as_slice()) {
            *d = g + turn * *d;
        }
    }
    x
}

/// Adds `factor` times `plane` to `to`.
fn add(to: &mut Plane<f32>, factor: f32, plane: &Plane<f32>) {
    for (t, p) in to.as_mut_slice().iter_mut().zip(plane.as_slice()) {
        *t += factor * p;
    }
}

fn dot(a: &Plane<f32>, b: &Plane<f32>) -> f64 {
    let of_band = |rows: std::ops::Range<usize>| {
        let pairs = a.rows(rows.clone()).iter().zip(b.rows(rows));
        pairs.map(|(&a, &b)| f64::from(a) * f64::from(b)).sum::<f64>()
    };
    fold_bands(a.height(), of_band, 0.0, |sum, s| sum + s)
}

fn sum(plane: &Plane<f32>) -> f64 {
    let of_band = |rows| plane.rows(rows).iter().map(|&v| f64::from(v)).sum::<f64>();
    fold_bands(plane.height(), of_band, 0.0, |sum, s| sum + s)
}

/// One axis of a grid of cells. The last cell may be narrower than the others.
#[derive(Debug, Clone)]
struct Axis {
    /// Width of each cell of this grid, in units of a cell of the finest grid.
    widths: Vec<f32>,
    /// One entry for each border of cells, from the start of the axis to its end: the reciprocal of the distance
    /// between the centres on the two sides of the border. The entries of the two ends are 0.
    links: Vec<f32>,
    /// Cell i is interpolated between two cells of the next coarser grid: cell i / 2 and one neighbour of it. For each
    /// cell, this is the index and the weight of that neighbour.
    others: Vec<(usize, f32)>,
}

impl Axis {
    fn new(widths: Vec<f32>) -> Self {
        let coarser = Axis::halved(&widths);
        let (centres, coarse) = (centres(&widths), centres(&coarser));
        let mut links = vec![0.0f32];
        links.extend(centres.windows(2).map(|pair| 1.0 / (pair[1] - pair[0])));
        links.push(0.0);
        let other = |i: usize| {
            let parent = i / 2;
            let other = if i.is_multiple_of(2) { parent.checked_sub(1) } else { Some(parent + 1) };
            match other.filter(|o| *o < coarse.len()) {
                Some(other) => (other, (centres[i] - coarse[parent]) / (coarse[other] - coarse[parent])),
                None => (parent, 0.0),
            }
        };
        let others = (0..widths.len()).map(other).collect();
        Axis { widths, links, others }
    }

    /// Returns the widths of the cells of the next coarser grid.
    fn halved(widths: &[f32]) -> Vec<f32> {
        widths.chunks(2).map(|pair| pair.iter().sum()).collect()
    }

    /// Returns indices and weights of the cells of this grid that contribute to cell `at` of the next coarser grid.
    /// This is the transpose of interpolation.
    fn children(&self, at: usize) -> impl Iterator<Item = (usize, f32)> {
        let first = (2 * at).saturating_sub(1);
        (first..(2 * at + 3).min(self.widths.len())).filter_map(move |i| {
            let (other, weight) = self.others[i];
            if i / 2 == at {
                Some((i, 1.0 - if other == at { 0.0 } else { weight }))
            } else {
                (other == at).then_some((i, weight))
            }
        })
    }
}

/// Returns the positions of the centres of cells.
fn centres(widths: &[f32]) -> Vec<f32> {
    let mut end = 0.0;
    let centre = |&w: &f32| {
        end += w;
        end - 0.5 * w
    };
    widths.iter().map(centre).collect()
}

/// One grid of the multigrid hierarchy.
#[derive(Debug, Clone)]
struct Level {
    columns: Axis,
    rows: Axis,
}

/// A grid and a sequence of ever coarser grids; the finest is the first.
#[derive(Debug, Clone)]
pub struct Multigrid {
    levels: Vec<Level>,
}

/// Damping of the Jacobi steps. The steps must reduce oscillating errors, which coarser grids cannot represent. On a
/// uniform grid in two dimensions, 0.8 is the best factor: each step reduces all oscillating errors to 0.6 or less.
const DAMPING: f32 = 0.8;

impl Multigrid {
    /// Builds the grids over `width` x `height` cells.
    pub fn new((width, height): (usize, usize)) -> Self {
        let mut levels = vec![Level { columns: Axis::new(vec![1.0; width]), rows: Axis::new(vec![1.0; height]) }];
        while let Some(last) = levels.last()
            && last.columns.widths.len().max(last.rows.widths.len()) > 1
        {
            let coarser = |axis: &Axis| Axis::new(Axis::halved(&axis.widths));
            let next = Level { columns: coarser(&last.columns), rows: coarser(&last.rows) };
            levels.push(next);
        }
        Multigrid { levels }
    }

    /// Returns the negative Laplacian: for each cell the sum of its differences from its (up to four) neighbours.
    pub fn laplacian(&self, plane: &Plane<f32>) -> Plane<f32> {
        self.levels[0].combined(plane, |laplacian, _, _| laplacian)
    }

    /// Approximates the inverse of [`laplacian`](Self::laplacian) by one V-cycle. The approximation is symmetric and
    /// has a relative error of about a tenth.
    pub fn cycle(&self, right: &Plane<f32>) -> Plane<f32> {
        cycle(&self.levels, right)
    }
}

/// Computes one V-cycle over `levels`, starting from 0, with two smoothing steps before the correction by the coarser
/// grids and two after it.
fn cycle(levels: &[Level], right: &Plane<f32>) -> Plane<f32> {
    let ([level, coarser @ ..], true) = (levels, levels.len() > 1) else {
        // A single cell has no differences.
        return Plane::filled(right.width(), right.height(), 0.0);
    };
    let mut x = level.first_step(right);
    x = level.step(&x, right);
    let residual = level.residual(&x, right);
    let correction = cycle(coarser, &level.restricted(&residual));
    level.add_interpolated(&mut x, &correction);
    x = level.step(&x, right);
    level.step(&x, right)
}

impl Level {
    /// Calls `combine` for every cell of `plane` with the negative Laplacian, the diagonal element of its matrix and
    /// the index of the cell. Returns the results.
    fn combined(&self, plane: &Plane<f32>, combine: impl Fn(f32, f32, usize) -> f32 + Sync) -> Plane<f32> {
        let (width, height) = (plane.width(), plane.height());
        let links = &self.columns.links;
        Plane::from_rows(width, height, |y, row| {
            let (before, after, tall) = (self.rows.links[y], self.rows.links[y + 1], self.rows.widths[y]);
            let (here, above) = (plane.row(y), plane.row(y.saturating_sub(1)));
            let below = plane.row((y + 1).min(height - 1));
            for (x, v) in row.iter_mut().enumerate() {
                *v = self.columns.widths[x] * (before * (here[x] - above[x]) + after * (here[x] - below[x]));
            }
            for x in 1..width {
                row[x] += tall * links[x] * (here[x] - here[x - 1]);
            }
            for x in 1..width {
                row[x - 1] += tall * links[x] * (here[x - 1] - here[x]);
            }
            for (x, v) in row.iter_mut().enumerate() {
                *v = combine(*v, self.diagonal(x, y), y * width + x);
            }
        })
    }

    #[inline(always)]
    fn diagonal(&self, x: usize, y: usize) -> f32 {
        let (columns, rows) = (&self.columns, &self.rows);
        columns.widths[x] * (rows.links[y] + rows.links[y + 1])
            + rows.widths[y] * (columns.links[x] + columns.links[x + 1])
    }

    /// Returns the result of a damped Jacobi step from 0.
    fn first_step(&self, right: &Plane<f32>) -> Plane<f32> {
        Plane::from_rows(right.width(), right.height(), |y, row| {
            for (x, (v, r)) in row.iter_mut().zip(right.row(y)).enumerate() {
                *v = DAMPING * r / self.diagonal(x, y);
            }
        })
    }

    /// Returns the result of a damped Jacobi step from `x`.
    fn step(&self, x: &Plane<f32>, right: &Plane<f32>) -> Plane<f32> {
        let (x_of, right) = (x.as_slice(), right.as_slice());
        self.combined(x, |laplacian, diagonal, i| x_of[i] + DAMPING * (right[i] - laplacian) / diagonal)
    }

    fn residual(&self, x: &Plane<f32>, right: &Plane<f32>) -> Plane<f32> {
        let right = right.as_slice();
        self.combined(x, |laplacian, _, i| right[i] - laplacian)
    }

    /// Restricts `fine` to the next coarser grid by the transpose of interpolation.
    fn restricted(&self, fine: &Plane<f32>) -> Plane<f32> {
        let width = fine.width();
        Plane::from_rows(width.div_ceil(2), fine.height().div_ceil(2), |y, row| {
            let mut column = vec![0.0f32; width];
            for (j, weight) in self.rows.children(y) {
                column.iter_mut().zip(fine.row(j)).for_each(|(c, v)| *c += weight * v);
            }
            for (x, v) in row.iter_mut().enumerate() {
                *v = self.columns.children(x).map(|(i, weight)| weight * column[i]).sum();
            }
        })
    }

    /// Adds `coarse`, interpolated between the centres of its cells, to `fine`.
    fn add_interpolated(&self, fine: &mut Plane<f32>, coarse: &Plane<f32>) {
        let width = fine.width();
        fine.fill_bands(|rows, band| {
            let mut column = vec![0.0f32; coarse.width()];
            for (y, row) in rows.zip(band.chunks_exact_mut(width)) {
                let (other, weight) = self.rows.others[y];
                let (near, far) = (coarse.row(y / 2), coarse.row(other));
                for (c, (n, f)) in column.iter_mut().zip(near.iter().zip(far)) {
                    *c = n + weight * (f - n);
                }
                for (x, (v, &(other, weight))) in row.iter_mut().zip(&self.columns.others).enumerate() {
                    *v += column[x / 2] + weight * (column[other] - column[x / 2]);
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns pseudo-random numbers, which depend only on `seed`.
    fn noise(width: usize, height: usize, seed: u32) -> Plane<f32> {
        let mut state = seed;
        let values = (0..width * height).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        });
        Plane::from_vec(width, height, values.collect())
    }

    /// Returns the expected picture: the normal equations of all differences, solved in `f64` with a dense matrix. The
    /// 1 that is added to every element of the matrix makes the mean 0.
    fn dense(right: &Plane<f32>, down: &Plane<f32>) -> Vec<f64> {
        let (w, h) = (right.width(), right.height());
        let mut matrix = nalgebra::DMatrix::<f64>::from_element(w * h, w * h, 1.0);
        let mut vector = nalgebra::DVector::<f64>::zeros(w * h);
        let mut edge = |i: usize, j: usize, d: f32| {
            for (p, q, s) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                matrix[(p, q)] += s;
            }
            vector[i] -= f64::from(d);
            vector[j] += f64::from(d);
        };
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            if x + 1 < w {
                edge(y * w + x, y * w + x + 1, right.at(x, y));
            }
            if y + 1 < h {
                edge(y * w + x, (y + 1) * w + x, down.at(x, y));
            }
        }
        matrix.cholesky().unwrap().solve(&vector).iter().copied().collect()
    }

    /// The gradients do not belong to any picture; the grids are odd, even and thin. The solver's tolerance is 1e-4,
    /// relative to values of a few units.
    #[test]
    fn solution_minimises_the_squares() {
        for (w, h) in [(1, 1), (2, 3), (1, 17), (16, 16), (21, 13), (3, 30), (25, 24)] {
            let (right, down) = (noise(w, h, 1), noise(w, h, 2));
            let found = integrated(&right, &down);
            for (a, b) in found.as_slice().iter().zip(dense(&right, &down)) {
                assert!((f64::from(*a) - b).abs() < 2e-3, "{w}x{h}: {a} {b}");
            }
        }
    }

    /// The differences of a picture give that picture, on grids that are too large for the dense solution.
    #[test]
    fn the_differences_of_a_picture_are_that_picture() {
        for (w, h) in [(257, 190), (300, 2), (511, 333)] {
            let picture = Plane::from_rows(w, h, |y, row| {
                for (x, v) in row.iter_mut().enumerate() {
                    *v = if x > w / 3 { 5.0 } else { 0.0 } + (0.05 * y as f32).sin() + 0.01 * x as f32;
                }
            });
            let mean = sum(&picture) / (w * h) as f64;
            let at = |x: usize, y: usize| picture.at(x.min(w - 1), y.min(h - 1));
            let right = Plane::from_rows(w, h, |y, row| {
                row.iter_mut().enumerate().for_each(|(x, v)| *v = at(x + 1, y) - at(x, y))
            });
            let down = Plane::from_rows(w, h, |y, row| {
                row.iter_mut().enumerate().for_each(|(x, v)| *v = at(x, y + 1) - at(x, y))
            });
            let found = integrated(&right, &down);
            for (a, b) in found.as_slice().iter().zip(picture.as_slice()) {
                assert!((f64::from(a - b) + mean).abs() < 0.01, "{w}x{h}: {a} {b}");
            }
        }
    }

    /// The cycle is symmetric, as conjugate gradients require.
    #[test]
    fn the_cycle_is_symmetric_and_most_of_the_inverse() {
        for size in [(37, 22), (8, 5), (64, 64)] {
            let grid = Multigrid::new(size);
            let (a, b) = (noise(size.0, size.1, 3), noise(size.0, size.1, 4));
            let (ab, ba) = (dot(&a, &grid.cycle(&b)), dot(&b, &grid.cycle(&a)));
            // The tolerance covers the rounding of the cycle to `f32`, in sums of up to 4000 products of values up to
            // some tens.
            assert!((ab - ba).abs() < 1e-3 * dot(&a, &grid.cycle(&a)), "{ab} {ba}");
            // One cycle leaves at most a fifth of the error in the energy norm. The squares of the norms are compared:
            // 0.2^2 = 0.04.
            let right = grid.laplacian(&a);
            let mut error = grid.cycle(&right);
            error.as_mut_slice().iter_mut().zip(a.as_slice()).for_each(|(e, a)| *e = a - *e);
            let (left, all) = (dot(&error, &grid.laplacian(&error)), dot(&a, &right));
            assert!(left < 0.04 * all, "{size:?}: {}", (left / all).sqrt());
        }
    }

    #[test]
    fn no_gradients_no_picture() {
        let none = Plane::filled(9, 7, 0.0);
        assert!(integrated(&none, &none) == none);
    }

    #[test]
    fn threads_do_not_show() {
        let (right, down) = (noise(200, 150, 5), noise(200, 150, 6));
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| integrated(&right, &down))
        };
        assert!(on(1) == on(5));
    }
}
