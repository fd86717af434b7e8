//! Small changes of a transform, and their parameters, which are the unknowns of the refinement.
//!
//! In: a [`Model`] and the size of a plane. Out: the Jacobian of the transform by its parameters, the matrix for given
//! parameters, the prior for a hand-held camera, and the error in pixels that follows from a covariance of the
//! parameters. Cost: negligible. Source: Baker & Matthews, "Lucas-Kanade 20 Years On", IJCV 56(3), 2004, section 3.1
//! (compositional updates).

use crate::align::transform::{GRID, Model, Transform, centre, grid};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2};

/// Prior standard deviation of the change of scale.
///
/// The prior describes a hand-held camera. The scale changes by some thousandths, and there is almost no stretch or
/// shear. Rotations out of the picture plane by some tenths of a degree cause perspective. If a frame has detail
/// everywhere, its pixels determine scale, stretch, shear and perspective a hundred times as precisely as the prior,
/// which then hardly counts. If only a strip of the frame has detail, the prior limits the parameters that the strip
/// does not determine.
const SCALE: f64 = 0.0025;
/// Prior standard deviation of stretch and shear; see [`SCALE`].
const STRETCH: f64 = 0.001;
/// Prior standard deviation of the perspective, in the coordinates of [`Increment`]; see [`SCALE`].
const PERSPECTIVE: f64 = 0.005;

/// The small motions that a model allows, and their parameters.
///
/// Coordinates are relative to the centre of the picture, in units of half the diagonal, so that all parameters are of
/// similar size.
pub(crate) struct Increment {
    model: Model,
    centre: (f64, f64),
    unit: f64,
    size: (usize, usize),
}

/// A property of a transform that has a prior: its value, its prior standard deviation, and its derivatives by the
/// parameters, each as (index of the parameter, derivative).
type Known = (f64, f64, &'static [(usize, f64)]);

impl Increment {
    pub(crate) fn new(model: Model, width: usize, height: usize) -> Self {
        let half = |n: usize| n as f64 / 2.0;
        let unit = (half(width) * half(width) + half(height) * half(height)).sqrt();
        Increment { model, centre: centre(width, height), unit, size: (width, height) }
    }

    /// Returns the number of parameters of the model.
    pub(crate) fn parameters(&self) -> usize {
        match self.model {
            Model::Unmoved => 0,
            Model::Shift => 2,
            Model::Rigid => 3,
            Model::Homography => 8,
        }
    }

    /// Returns the derivatives (x, y) of the position by each parameter, at the pixel (x, y). Parameters have no unit,
    /// so the derivatives are in pixels.
    pub(crate) fn jacobian(&self, x: f64, y: f64) -> [[f64; 2]; 8] {
        let (x, y, u) = ((x - self.centre.0) / self.unit, (y - self.centre.1) / self.unit, self.unit);
        let mut j = [[0.0; 2]; 8];
        match self.model {
            Model::Unmoved => {}
            Model::Shift => (j[0], j[1]) = ([u, 0.0], [0.0, u]),
            Model::Rigid => (j[0], j[1], j[2]) = ([u, 0.0], [0.0, u], [-u * y, u * x]),
            Model::Homography => {
                j = [
                    [u, 0.0],
                    [0.0, u],
                    [u * x, 0.0],
                    [u * y, 0.0],
                    [0.0, u * x],
                    [0.0, u * y],
                    [-u * x * x, -u * x * y],
                    [-u * x * y, -u * y * y],
                ];
            }
        }
        j
    }

    /// Returns J^T g at (x, y): the derivatives of the grey value by each parameter. J is the
    /// [`jacobian`](Self::jacobian), and `g` the gradient of the grey value.
    pub(crate) fn row(&self, x: f64, y: f64, g: [f32; 2]) -> [f64; 8] {
        let (gx, gy) = (f64::from(g[0]), f64::from(g[1]));
        self.jacobian(x, y).map(|j| gx * j[0] + gy * j[1])
    }

    /// Adds the prior to the matrix A and the vector b of the normal equations. The prior makes transforms near a rigid
    /// one more likely (see [`SCALE`]). `h` is the present transform, a matrix on pixels.
    ///
    /// A and b were computed as if the noise of the points were independent. If the actual error is `factor` times as
    /// large, A and b are `factor`^2 times too large. Therefore the prior is multiplied by `factor`^2, too.
    pub(crate) fn add_prior(&self, h: &Matrix3<f64>, factor: f64, a: &mut DMatrix<f64>, b: &mut DVector<f64>) {
        if self.model != Model::Homography {
            return;
        }
        let n = self.to_units() * h * self.to_pixels();
        let n = n / n[(2, 2)];
        // D is the derivative (2 x 2) of the transform at the centre, and phi its rotation. S = R(-phi) D is the
        // derivative without the rotation. It is near the identity; its deviations are scale, stretch and shear.
        let derivative = |i: usize, k: usize| n[(i, k)] - n[(i, 2)] * n[(2, k)];
        let (xx, xy, yx, yy) = (derivative(0, 0), derivative(0, 1), derivative(1, 0), derivative(1, 1));
        let (sum, turn) = (xx + yy, yx - xy);
        let length = (sum * sum + turn * turn).sqrt();
        if length == 0.0 {
            return;
        }
        let (cos, sin) = (sum / length, turn / length);
        let (s_xx, s_xy, s_yx, s_yy) =
            (cos * xx + sin * yx, cos * xy + sin * yy, cos * yx - sin * xx, cos * yy - sin * xy);
        let known: [Known; 5] = [
            (0.5 * (s_xx + s_yy) - 1.0, SCALE, &[(2, 0.5), (5, 0.5)]),
            (0.5 * (s_xx - s_yy), STRETCH, &[(2, 0.5), (5, -0.5)]),
            (0.5 * (s_xy + s_yx), STRETCH, &[(3, 0.5), (4, 0.5)]),
            (n[(2, 0)], PERSPECTIVE, &[(6, 1.0)]),
            (n[(2, 1)], PERSPECTIVE, &[(7, 1.0)]),
        ];
        for (value, deviation, changes) in known {
            let weight = factor * factor / (deviation * deviation);
            for &(i, ci) in changes {
                b[i] += weight * ci * value;
                for &(k, ck) in changes {
                    a[(i, k)] += weight * ci * ck;
                }
            }
        }
    }

    /// Maps pixels to the coordinates of [`Increment`].
    fn to_units(&self) -> Matrix3<f64> {
        let (cx, cy) = self.centre;
        Matrix3::new(1.0 / self.unit, 0.0, -cx / self.unit, 0.0, 1.0 / self.unit, -cy / self.unit, 0.0, 0.0, 1.0)
    }

    /// Maps the coordinates of [`Increment`] to pixels.
    fn to_pixels(&self) -> Matrix3<f64> {
        let (cx, cy) = self.centre;
        Matrix3::new(self.unit, 0.0, cx, 0.0, self.unit, cy, 0.0, 0.0, 1.0)
    }

    /// Solves A d = -b for the parameters d; none if A is singular.
    pub(crate) fn solve(&self, a: DMatrix<f64>, b: DVector<f64>) -> Option<DVector<f64>> {
        let step = -a.cholesky()?.solve(&b);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Returns the matrix, on pixels of the reference, of the small motion with the parameters `d`.
    pub(crate) fn matrix(&self, d: &DVector<f64>) -> Matrix3<f64> {
        let m = match self.model {
            Model::Unmoved => Matrix3::identity(),
            Model::Shift => Matrix3::new(1.0, 0.0, d[0], 0.0, 1.0, d[1], 0.0, 0.0, 1.0),
            Model::Rigid => {
                let (s, c) = (libm::sin(d[2]), libm::cos(d[2]));
                Matrix3::new(c, -s, d[0], s, c, d[1], 0.0, 0.0, 1.0)
            }
            Model::Homography => Matrix3::new(1.0 + d[2], d[3], d[0], d[4], 1.0 + d[5], d[1], d[6], d[7], 1.0),
        };
        self.to_pixels() * m * self.to_units()
    }

    /// Returns the largest displacement of a corner that the motion with the parameters `d` causes, in pixels.
    pub(crate) fn largest_move(&self, d: &DVector<f64>) -> f64 {
        Transform::Homography(self.matrix(d)).corner_distance(&Transform::Identity, self.size.0, self.size.1)
    }

    /// Returns the root mean square displacement over the picture that the motion with the parameters `d` causes, in
    /// pixels.
    pub(crate) fn mean_move(&self, d: &DVector<f64>) -> f64 {
        let sum: f64 = grid(self.size.0, self.size.1)
            .map(|(x, y)| {
                let j = self.jacobian(x, y);
                let along = |k: usize| d.iter().zip(&j).map(|(d, j)| d * j[k]).sum::<f64>();
                along(0) * along(0) + along(1) * along(1)
            })
            .sum();
        (sum / (GRID * GRID) as f64).sqrt()
    }

    /// Returns the root mean square error over the picture, in pixels, if the parameters have this `covariance`.
    pub(crate) fn expected_error(&self, covariance: &DMatrix<f64>) -> f64 {
        let mut sum = 0.0;
        for (x, y) in grid(self.size.0, self.size.1) {
            let j = self.jacobian(x, y);
            let mut local = Matrix2::zeros();
            for p in 0..self.parameters() {
                for q in 0..self.parameters() {
                    local += covariance[(p, q)] * Vector2::from(j[p]) * Vector2::from(j[q]).transpose();
                }
            }
            sum += local.trace();
        }
        (sum / (GRID * GRID) as f64).sqrt()
    }
}
