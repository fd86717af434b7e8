//! From gradients back to a picture: the one whose differences from cell to cell are nearest to those asked for.
//!
//! In: differences along rows and columns, which need not belong to any picture. Out: the picture, its mean 0. At the borders nothing is
//! asked for (Neumann). Cost: about 10 steps of 0.05 us a cell and core, on any size of grid.
//! Source: Fattal, Lischinski, Werman, "Gradient Domain High Dynamic Range Compression" (2002), section 3, equations 3 to 6, for the problem;
//! Briggs, Henson, McCormick, "A Multigrid Tutorial" (2000), chapters 2 and 3, for the cycle; Tatebe, "The Multigrid Preconditioned Conjugate
//! Gradient Method" (1993), for the steps.

use crate::plane::{Plane, fold_bands};

/// What the error must come down to, in the norm of the operator, as a part of the picture: a thousandth of a stop of ten.
const TOLERANCE: f64 = 1e-4;

/// Steps after which it is as good as it gets; they take about ten.
const MOST_STEPS: usize = 40;

/// The picture whose differences to the right neighbours are nearest to `right` and to the lower ones nearest to `down`, in the sum of
/// squares. The last column of `right` and the last row of `down` have no neighbours and do not count.
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
    let mean = sum(&picture, |v| v.into()) / picture.as_slice().len().max(1) as f64;
    let centred = picture.as_slice().iter().map(|v| v - mean as f32).collect();
    Plane::from_vec(picture.width(), picture.height(), centred)
}

/// What flows into each cell less what flows out: the transpose of taking differences.
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

/// The x of `apply`(x) = `right`, for a symmetric `apply` without negative squares, by conjugate gradients; `precondition` is a symmetric guess
/// at the inverse. Ends when the error, as `precondition` sees it, is below `tolerance` of what it was, or after `most` steps.
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

/// `to` plus `factor` times `plane`.
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

fn sum(plane: &Plane<f32>, of: impl Fn(f32) -> f64 + Sync) -> f64 {
    fold_bands(plane.height(), |rows| plane.rows(rows).iter().map(|&v| of(v)).sum::<f64>(), 0.0, |sum, s| sum + s)
}

/// One direction of a grid: cells, the last of which may be narrower than the others.
#[derive(Debug, Clone)]
struct Axis {
    /// How wide each cell is, in cells of the finest grid.
    widths: Vec<f32>,
    /// Before each cell, and after the last, one over the distance of the centres on either side; 0 at the ends.
    links: Vec<f32>,
    /// For each cell, besides the cell of half its number on the next coarser grid, the other one nearest to it and what that counts for.
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

    /// The widths of the next coarser grid.
    fn halved(widths: &[f32]) -> Vec<f32> {
        widths.chunks(2).map(|pair| pair.iter().sum()).collect()
    }

    fn len(&self) -> usize {
        self.widths.len()
    }

    /// The cells that the coarse cell `at` is made of, with what each counts for: the transpose of interpolation.
    fn children(&self, at: usize) -> impl Iterator<Item = (usize, f32)> {
        let first = (2 * at).saturating_sub(1);
        (first..(2 * at + 3).min(self.len())).filter_map(move |i| {
            let (other, weight) = self.others[i];
            if i / 2 == at {
                Some((i, 1.0 - if other == at { 0.0 } else { weight }))
            } else {
                (other == at).then_some((i, weight))
            }
        })
    }
}

/// Where the middles of cells lie.
fn centres(widths: &[f32]) -> Vec<f32> {
    let mut end = 0.0;
    let centre = |&w: &f32| {
        end += w;
        end - 0.5 * w
    };
    widths.iter().map(centre).collect()
}

/// One grid of those that are ever coarser.
#[derive(Debug, Clone)]
struct Level {
    columns: Axis,
    rows: Axis,
}

/// A grid and its coarser ones, on which large things are settled.
#[derive(Debug, Clone)]
pub struct Multigrid {
    levels: Vec<Level>,
}

/// The part of a Jacobi step that is taken: the best against what alternates from cell to cell.
const DAMPING: f32 = 0.8;

impl Multigrid {
    /// Over `width` x `height` cells.
    pub fn new((width, height): (usize, usize)) -> Self {
        let mut levels = vec![Level { columns: Axis::new(vec![1.0; width]), rows: Axis::new(vec![1.0; height]) }];
        while let Some(last) = levels.last()
            && last.columns.len().max(last.rows.len()) > 1
        {
            let coarser = |axis: &Axis| Axis::new(Axis::halved(&axis.widths));
            let next = Level { columns: coarser(&last.columns), rows: coarser(&last.rows) };
            levels.push(next);
        }
        Multigrid { levels }
    }

    /// Four times each cell less its four neighbours, at the borders less those that there are.
    pub fn laplacian(&self, plane: &Plane<f32>) -> Plane<f32> {
        self.levels[0].combined(plane, |laplacian, _, _| laplacian)
    }

    /// A guess at the plane of which `right` is the Laplacian, by one cycle through all grids: symmetric, and off by a tenth or so.
    pub fn cycle(&self, right: &Plane<f32>) -> Plane<f32> {
        cycle(&self.levels, right)
    }
}

/// A V-cycle over `levels` from nothing: two steps before and two after the coarser grids.
fn cycle(levels: &[Level], right: &Plane<f32>) -> Plane<f32> {
    let ([level, coarser @ ..], true) = (levels, levels.len() > 1) else {
        // A single cell differs from nothing.
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
    /// `combine`(Laplacian, diagonal, cell's number) of every cell of `plane`.
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

    /// A damped Jacobi step from nothing.
    fn first_step(&self, right: &Plane<f32>) -> Plane<f32> {
        Plane::from_rows(right.width(), right.height(), |y, row| {
            for (x, (v, r)) in row.iter_mut().zip(right.row(y)).enumerate() {
                *v = DAMPING * r / self.diagonal(x, y);
            }
        })
    }

    /// A damped Jacobi step from `x`.
    fn step(&self, x: &Plane<f32>, right: &Plane<f32>) -> Plane<f32> {
        let (x_of, right) = (x.as_slice(), right.as_slice());
        self.combined(x, |laplacian, diagonal, i| x_of[i] + DAMPING * (right[i] - laplacian) / diagonal)
    }

    fn residual(&self, x: &Plane<f32>, right: &Plane<f32>) -> Plane<f32> {
        let right = right.as_slice();
        self.combined(x, |laplacian, _, i| right[i] - laplacian)
    }

    /// What lies on each cell of the next coarser grid: the transpose of interpolation.
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

    /// Adds to `fine` what the next coarser grid has, interpolated between its centres.
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

    /// Numbers without a pattern, the same each time.
    fn noise(width: usize, height: usize, seed: u32) -> Plane<f32> {
        let mut state = seed;
        let values = (0..width * height).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        });
        Plane::from_vec(width, height, values.collect())
    }

    /// The normal equations of all differences, dense, in doubles; the mean is held at 0 by a rank-one term.
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

    /// Gradients that belong to no picture, on odd, even and thin grids. The tolerance is 1e-4 of values of a few units.
    #[test]
    fn it_is_the_least_squares_picture() {
        for (w, h) in [(1, 1), (2, 3), (1, 17), (16, 16), (21, 13), (3, 30), (25, 24)] {
            let (right, down) = (noise(w, h, 1), noise(w, h, 2));
            let found = integrated(&right, &down);
            for (a, b) in found.as_slice().iter().zip(dense(&right, &down)) {
                assert!((f64::from(*a) - b).abs() < 2e-3, "{w}x{h}: {a} {b}");
            }
        }
    }

    /// Differences of a picture give it back, on a grid too large for the dense oracle, whatever its sides.
    #[test]
    fn the_differences_of_a_picture_are_that_picture() {
        for (w, h) in [(257, 190), (300, 2), (511, 333)] {
            let picture = Plane::from_rows(w, h, |y, row| {
                for (x, v) in row.iter_mut().enumerate() {
                    *v = if x > w / 3 { 5.0 } else { 0.0 } + (0.05 * y as f32).sin() + 0.01 * x as f32;
                }
            });
            let mean = sum(&picture, |v| v.into()) / (w * h) as f64;
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

    /// Interpolation and restriction are each other's transpose, and the cycle is symmetric: conjugate gradients rest on it.
    #[test]
    fn the_cycle_is_symmetric_and_most_of_the_inverse() {
        for size in [(37, 22), (8, 5), (64, 64)] {
            let grid = Multigrid::new(size);
            let (a, b) = (noise(size.0, size.1, 3), noise(size.0, size.1, 4));
            let (ab, ba) = (dot(&a, &grid.cycle(&b)), dot(&b, &grid.cycle(&a)));
            // Values up to some tens, of 4000 products, in single precision.
            assert!((ab - ba).abs() < 1e-3 * dot(&a, &grid.cycle(&a)), "{ab} {ba}");
            // One cycle leaves a fifth at the most, in the norm of the operator.
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
