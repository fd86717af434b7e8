//! Gradients as length and direction, and their Gaussian weights. They are computed without the platform's math
//! library.

use super::extrema::Extremum;
use crate::plane::Plane;
use crate::simd::{Loops, atan2, vectorised};
use std::ops::Range;
use std::sync::LazyLock;

/// The gradients of a range of columns in one row. The buffers are reused for the next row.
#[derive(Debug, Default)]
pub(super) struct Gradients {
    /// The length of each gradient.
    pub(super) length: Vec<f32>,
    /// The direction of each gradient, from +x towards +y, in radians.
    pub(super) direction: Vec<f32>,
}

impl Gradients {
    /// Computes the gradients at `columns` of row `y`. None of these samples may be on the border of the image.
    pub(super) fn fill(&mut self, level: &Plane<f32>, y: usize, columns: Range<usize>) {
        let n = columns.len();
        self.length.resize(n, 0.0);
        self.direction.resize(n, 0.0);
        let (up, here, down) = (level.row(y - 1), level.row(y), level.row(y + 1));
        let (left, right) = (&here[columns.start - 1..][..n], &here[columns.start + 1..][..n]);
        let (up, down) = (&up[columns.clone()], &down[columns]);
        let (length, direction) = (&mut self.length[..n], &mut self.direction[..n]);
        vectorised(RowGradients { neighbours: [left, right, up, down], length, direction });
    }
}

/// Computes the gradient of each sample from its neighbours: left, right, above, below.
struct RowGradients<'a> {
    neighbours: [&'a [f32]; 4],
    length: &'a mut [f32],
    direction: &'a mut [f32],
}

impl Loops for RowGradients<'_> {
    type Output = ();

    // The loop has no branches, so that the compiler can vectorise it.
    #[inline(always)]
    fn run(self) {
        let n = self.length.len();
        let [left, right, up, down] = self.neighbours.map(|values| &values[..n]);
        let (length, direction) = (&mut self.length[..n], &mut self.direction[..n]);
        for i in 0..n {
            let (dx, dy) = (right[i] - left[i], down[i] - up[i]);
            length[i] = (dx * dx + dy * dy).sqrt();
            direction[i] = atan2(dy, dx);
        }
    }
}

/// The range of samples around an extremum that have neighbours on all sides, and the Gaussian weights of its columns
/// and rows.
pub(super) struct Surroundings {
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<usize>,
    pub(super) weights_x: Vec<f32>,
    pub(super) weights_y: Vec<f32>,
}

impl Surroundings {
    /// Returns the samples up to `reach` pixels (rounded up) from the extremum along each axis. At distance d along an
    /// axis, the weight is exp(-d^2 `falloff`).
    pub(super) fn new(level: &Plane<f32>, extremum: &Extremum, reach: f64, falloff: f32) -> Self {
        let reach = libm::ceil(reach) as isize;
        let within = |centre: f64, n: usize| {
            let c = (centre + 0.5).floor() as isize;
            (c - reach).max(1) as usize..((c + reach).min(n as isize - 2) + 1).max(1) as usize
        };
        let (columns, rows) = (within(extremum.x, level.width()), within(extremum.y, level.height()));
        let weight = |position: usize, centre: f64| {
            let d = (position as f64 - centre) as f32;
            exp_minus(d * d * falloff)
        };
        let weights_x = columns.clone().map(|x| weight(x, extremum.x)).collect();
        let weights_y = rows.clone().map(|y| weight(y, extremum.y)).collect();
        Surroundings { columns, rows, weights_x, weights_y }
    }
}

/// Number of entries of the table of exp(-t) per unit of t.
const STEPS: f32 = 256.0;
static EXP: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..=(16.0 * STEPS) as usize).map(|i| libm::exp(-(i as f64) / f64::from(STEPS)) as f32).collect());

/// Returns exp(-t) for t >= 0, with a relative error of at most about 1/512; 0 beyond the end of the table at t = 16.
fn exp_minus(t: f32) -> f32 {
    EXP.get((t * STEPS + 0.5) as usize).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_are_differences_of_the_neighbours() {
        let level = Plane::from_rows(40, 9, |y, row: &mut [f32]| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = ((x * 37 + y * 91) % 53) as f32;
            }
        });
        let mut gradients = Gradients::default();
        for (y, columns) in [(1, 1..39), (4, 7..20), (7, 5..6)] {
            gradients.fill(&level, y, columns.clone());
            assert_eq!(gradients.length.len(), columns.len());
            for (i, x) in columns.enumerate() {
                let dx = level.at(x + 1, y) - level.at(x - 1, y);
                let dy = level.at(x, y + 1) - level.at(x, y - 1);
                assert!((gradients.length[i] - dx.hypot(dy)).abs() < 1e-4);
                assert!((gradients.direction[i] - dy.atan2(dx)).abs() < 2e-4);
            }
        }
    }

    #[test]
    fn the_exponential_is_that_of_the_platform() {
        for i in 0..1000 {
            let t = i as f32 * 0.0159;
            assert!((exp_minus(t) / (-t).exp() - 1.0).abs() < 1.0 / 500.0);
        }
        assert_eq!(exp_minus(1e9), 0.0);
    }
}
