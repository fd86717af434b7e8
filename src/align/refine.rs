//! Refinement: from about a pixel to the noise limit, on the pixels themselves.
//!
//! In: the grey pyramids of two frames and a warp that is about right. Out: the warp of a chosen model under which their pixels agree
//! best, and how well the pixels determine it. Of the two the darker is mapped to the exposure of the brighter, where clipping is the
//! same in both, and then both are smoothed: the other way round, edges of clipped areas would move. Cost: two Gaussians a level, and
//! some 25,000 points a step, one to each small cell of the picture.
//! Source: Baker & Matthews, "Lucas-Kanade 20 Years On", IJCV 56(3), 2004, section 2.2 (compositional updates); Tukey's biweight.

use super::Model;
use super::intensity_map::CommonExposure;
use super::mtb::GreyPyramid;
use super::warp::{Warp, centre, map};
use crate::plane::Plane;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2};

/// Standard deviation of the smoothing before pixels are compared, in pixels of the level: enough for cubic interpolation to be exact.
const SMOOTHING: f64 = 1.0;
/// About so many cells, of which each gives a point: at the finest level, and at those that only lead to it.
const CELLS: (f64, f64) = (20_000.0, 6_000.0);
/// Steps at each level, at the most.
const MOST_STEPS: usize = 12;
/// A step that moves no corner by more than this ends the level, in pixels of the level: the finest, and those that only lead to it.
const STILL: (f64, f64) = (0.005, 0.05);
/// Pixels nearest the border that are not used: the reach of the derivative and of the interpolation.
const BORDER: usize = 3;
/// Fewer points than this say nothing.
const LEAST_POINTS: usize = 50;
/// Residuals at an edge are as if it were displaced by this, in pixels: interpolation, aliasing, a little blur in one of the frames.
const JITTER: f32 = 0.15;
/// Tukey's constant: 95 % efficient on normal noise.
const TUKEY: f32 = 4.685;

/// A refined warp and how well the pixels determine it. All lengths are in pixels of level 0.
#[derive(Debug, Clone)]
pub struct Refined {
    /// Reference pixel -> frame pixel, of the model that was asked for.
    pub warp: Warp,
    /// Robust standard deviation of the differences that are left, in grey levels of the frame.
    pub noise: f64,
    /// The mean of Tukey's loss over the points: 0 perfect, 1 nothing in common.
    pub loss: f64,
    /// Root mean square error over the picture that the noise alone would leave, in pixels.
    pub error_px: f64,
    /// Points used.
    pub points: usize,
}

/// Refines `start` level by level from `coarsest` to `finest` (0 the largest), as a warp of `model`.
///
/// None where the overlap holds too little to go by, or the steps run away.
pub fn refine(
    reference: &GreyPyramid,
    frame: &GreyPyramid,
    start: &Warp,
    model: Model,
    levels: (usize, usize),
) -> Option<Refined> {
    let (coarsest, finest) = levels;
    let full = reference.level(0);
    let h0 = start.matrix(full.width(), full.height());
    let mut state = restrict(&h0, model, full.width(), full.height());
    let mut last = None;
    for level in (finest..=coarsest.min(reference.len() - 1)).rev() {
        let stage = Stage::new(reference.level(level), frame.level(level), level, level == finest, &state)?;
        let (h, fit) = stage.solve(state, model)?;
        state = h;
        last = Some(fit);
    }
    let fit = last?;
    let warp = to_warp(&state, model, full.width(), full.height());
    Some(Refined { warp, ..fit })
}

/// The warp of `model` nearest to `h`, in the sense that it does the same to the centre and to its surroundings.
pub(super) fn restrict(h: &Matrix3<f64>, model: Model, width: usize, height: usize) -> Matrix3<f64> {
    let warp = Warp::Homography(*h);
    let (dx, dy) = warp.shift_px(width, height);
    match model {
        Model::Unmoved => Matrix3::identity(),
        Model::Shift => Warp::Rigid { dx, dy, angle: 0.0 }.matrix(width, height),
        Model::Rigid => {
            let angle = warp.rotation_deg(width, height).to_radians();
            Warp::Rigid { dx, dy, angle }.matrix(width, height)
        }
        Model::Homography => *h,
    }
}

fn to_warp(h: &Matrix3<f64>, model: Model, width: usize, height: usize) -> Warp {
    let whole = Warp::Homography(h / h[(2, 2)]);
    let (dx, dy) = whole.shift_px(width, height);
    match model {
        Model::Unmoved => Warp::Identity,
        Model::Shift => Warp::Rigid { dx, dy, angle: 0.0 },
        Model::Rigid => Warp::Rigid { dx, dy, angle: whole.rotation_deg(width, height).to_radians() },
        Model::Homography => whole,
    }
}

/// A pixel of the reference that is compared.
struct Point {
    x: f64,
    y: f64,
    /// The reference's level there, at the exposure of the brighter.
    level: f32,
    /// Its gradient, in levels a pixel.
    gradient: [f32; 2],
    /// 1 / standard deviation of what noise alone would leave here, in units of the darker frame's noise or so: the noise of both, and
    /// what aliasing and blur make of a strong gradient.
    precision: f32,
}

/// One level: the points, and what takes its pixels to those of level 0.
struct Stage {
    /// The frame at the exposure of the brighter.
    frame: Plane<f32>,
    points: Vec<Point>,
    /// Pixel of level 0 from pixel of this level: halving puts the centre of a pixel between two.
    to_full: Matrix3<f64>,
    from_full: Matrix3<f64>,
    scale: f64,
    still: f64,
}

impl Stage {
    fn new(
        reference: &Plane<u8>,
        frame: &Plane<u8>,
        level: usize,
        is_last: bool,
        h_full: &Matrix3<f64>,
    ) -> Option<Self> {
        let scale = (1u64 << level) as f64;
        let offset = (scale - 1.0) / 2.0;
        let to_full = Matrix3::new(scale, 0.0, offset, 0.0, scale, offset, 0.0, 0.0, 1.0);
        let from_full = to_full.try_inverse()?;
        let h = from_full * h_full * to_full;
        let cells = if is_last { CELLS.0 } else { CELLS.1 };
        let cell = ((reference.width() * reference.height()) as f64 / cells).sqrt().max(1.0) as usize;
        let still = if is_last { STILL.0 } else { STILL.1 };
        let both = CommonExposure::new(reference, frame, &h, SMOOTHING);
        let points = choose_points(&both, cell);
        (points.len() >= 50).then_some(Stage { frame: both.frame, points, to_full, from_full, scale, still })
    }

    /// Steps of Gauss and Newton with Tukey's weights until no corner moves.
    fn solve(&self, h_full: Matrix3<f64>, model: Model) -> Option<(Matrix3<f64>, Refined)> {
        let (width, height) = (self.frame.width(), self.frame.height());
        let mut h = self.from_full * h_full * self.to_full;
        let basis = Basis::new(model, width, height);
        let mut residuals: Vec<Option<f32>> = Vec::new();
        let mut noise = 0.0;
        let mut normal = DMatrix::zeros(basis.numbers(), basis.numbers());
        for _ in 0..MOST_STEPS {
            self.residuals(&h, &mut residuals);
            noise = spread(&self.points, &residuals)?;
            let (a, b) = self.normal_equations(&basis, &residuals, noise);
            normal = a.clone();
            let step = basis.solve(a, b)?;
            h *= basis.matrix(&step);
            h /= h[(2, 2)];
            let moved = basis.largest_move(&step);
            if !moved.is_finite() || moved > width as f64 {
                return None;
            }
            if moved < self.still {
                break;
            }
        }
        self.residuals(&h, &mut residuals);
        let used = residuals.iter().flatten().count();
        let loss = self.loss(&residuals, noise);
        let error_px = self.scale * basis.expected_error(&normal)?;
        let h_full = self.to_full * h * self.from_full;
        let refined = Refined { warp: Warp::Identity, noise: noise.into(), loss, error_px, points: used };
        Some((h_full / h_full[(2, 2)], refined))
    }

    /// The frame's level less the reference's at every point; none where the frame does not reach.
    fn residuals(&self, h: &Matrix3<f64>, out: &mut Vec<Option<f32>>) {
        out.clear();
        out.extend(self.points.iter().map(|p| {
            let (u, v) = map(h, p.x, p.y);
            cubic(&self.frame, u, v).map(|f| f - p.level)
        }));
    }

    /// A = sum w J^T g g^T J and b = sum w J^T g r, in units of the noise.
    fn normal_equations(&self, basis: &Basis, residuals: &[Option<f32>], noise: f32) -> (DMatrix<f64>, DVector<f64>) {
        let n = basis.numbers();
        let mut a = [[0.0f64; 8]; 8];
        let mut b = [0.0f64; 8];
        for (p, r) in self.points.iter().zip(residuals) {
            let Some(r) = r else { continue };
            let w = f64::from(tukey_weight(r * p.precision / noise) * p.precision * p.precision / (noise * noise));
            if w == 0.0 {
                continue;
            }
            let j = basis.row(p.x, p.y, p.gradient);
            for i in 0..n {
                let wj = w * j[i];
                b[i] += wj * f64::from(*r);
                for k in i..n {
                    a[i][k] += wj * j[k];
                }
            }
        }
        (DMatrix::from_fn(n, n, |i, k| a[i.min(k)][i.max(k)]), DVector::from_fn(n, |i, _| b[i]))
    }

    fn loss(&self, residuals: &[Option<f32>], noise: f32) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (p, r) in self.points.iter().zip(residuals) {
            let Some(r) = r else { continue };
            let strength =
                f64::from((p.gradient[0] * p.gradient[0] + p.gradient[1] * p.gradient[1]) * p.precision * p.precision);
            let t = f64::from((r * p.precision / (TUKEY * noise)).abs().min(1.0));
            let inside = 1.0 - t * t;
            sum += strength * (1.0 - inside * inside * inside);
            weight += strength;
        }
        if weight > 0.0 { sum / weight } else { 1.0 }
    }
}

/// Of every cell, the pixel that says most about where it is: that with the largest trusted gradient.
fn choose_points(both: &CommonExposure, cell: usize) -> Vec<Point> {
    let reference = &both.reference;
    let (width, height) = (reference.width(), reference.height());
    let mut points = Vec::new();
    if width <= 2 * BORDER {
        return points;
    }
    for top in (BORDER..height.saturating_sub(BORDER)).step_by(cell) {
        let mut best: Vec<(f32, usize, usize)> = vec![(0.0, 0, 0); (width - 2 * BORDER).div_ceil(cell)];
        for y in top..(top + cell).min(height - BORDER) {
            let (up, row, down) = (reference.row(y - 1), reference.row(y), reference.row(y + 1));
            for x in BORDER..width - BORDER {
                let (dx, dy) = (row[x + 1] - row[x - 1], down[x] - up[x]);
                let strength = (dx * dx + dy * dy) * both.trust(row[x]);
                let slot = &mut best[(x - BORDER) / cell];
                if strength > slot.0 {
                    *slot = (strength, x, y);
                }
            }
        }
        points.extend(best.into_iter().filter(|b| b.0 > 0.0).map(|(_, x, y)| {
            let half = |a: f32, b: f32| 0.5 * (a - b);
            let level = reference.at(x, y);
            let gradient = [
                half(reference.at(x + 1, y), reference.at(x - 1, y)),
                half(reference.at(x, y + 1), reference.at(x, y - 1)),
            ];
            let jitter = JITTER * JITTER * (gradient[0] * gradient[0] + gradient[1] * gradient[1]);
            let precision = 1.0 / (1.0 / both.trust(level) + jitter).sqrt();
            Point { x: x as f64, y: y as f64, level, gradient, precision }
        }));
    }
    points
}

/// Tukey's biweight of a residual in units of its standard deviation.
fn tukey_weight(r: f32) -> f32 {
    let t = r / TUKEY;
    let inside = (1.0 - t * t).max(0.0);
    inside * inside
}

/// The robust standard deviation of the trusted residuals: 1.4826 times the median of their absolutes, at least half a grey level.
fn spread(points: &[Point], residuals: &[Option<f32>]) -> Option<f32> {
    let mut absolutes: Vec<f32> =
        points.iter().zip(residuals).filter_map(|(p, r)| r.map(|r| (r * p.precision).abs())).collect();
    if absolutes.len() < LEAST_POINTS {
        return None;
    }
    let middle = absolutes.len() / 2;
    let (_, median, _) = absolutes.select_nth_unstable_by(middle, f32::total_cmp);
    Some((1.4826 * *median).max(0.5))
}

/// Keys' cubic convolution at (u, v); none within [`BORDER`] - 1 pixels of the border.
pub(super) fn cubic(plane: &Plane<f32>, u: f64, v: f64) -> Option<f32> {
    let margin = (BORDER - 1) as f64;
    if !(u >= margin
        && v >= margin
        && u < plane.width() as f64 - 1.0 - margin
        && v < plane.height() as f64 - 1.0 - margin)
    {
        return None;
    }
    let (x, y) = (u as usize, v as usize);
    let (wx, wy) = (keys((u - x as f64) as f32), keys((v - y as f64) as f32));
    let mut sum = 0.0;
    for (j, w) in wy.iter().enumerate() {
        let row = &plane.row(y + j - 1)[x - 1..x + 3];
        sum += w * (wx[0] * row[0] + wx[1] * row[1] + wx[2] * row[2] + wx[3] * row[3]);
    }
    Some(sum)
}

/// Weights of the four samples about a place `t` of the way from the second to the third (Keys 1981, a = -1/2).
fn keys(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2]
}

/// The small motions of a model, in coordinates about the centre in units of half the diagonal, so that all numbers are alike in size.
struct Basis {
    model: Model,
    centre: (f64, f64),
    unit: f64,
    size: (usize, usize),
}

impl Basis {
    fn new(model: Model, width: usize, height: usize) -> Self {
        let half = |n: usize| n as f64 / 2.0;
        let unit = (half(width) * half(width) + half(height) * half(height)).sqrt();
        Basis { model, centre: centre(width, height), unit, size: (width, height) }
    }

    /// How many numbers the model has.
    fn numbers(&self) -> usize {
        match self.model {
            Model::Unmoved => 0,
            Model::Shift => 2,
            Model::Rigid => 3,
            Model::Homography => 8,
        }
    }

    /// d(place) / d(numbers) at (x, y), in pixels.
    fn jacobian(&self, x: f64, y: f64) -> [[f64; 2]; 8] {
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

    /// J^T g at (x, y).
    fn row(&self, x: f64, y: f64, g: [f32; 2]) -> [f64; 8] {
        let (gx, gy) = (f64::from(g[0]), f64::from(g[1]));
        self.jacobian(x, y).map(|j| gx * j[0] + gy * j[1])
    }

    /// -A^-1 b; none where A is singular.
    fn solve(&self, a: DMatrix<f64>, b: DVector<f64>) -> Option<DVector<f64>> {
        let step = -a.cholesky()?.solve(&b);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// The motion of the reference's pixels that the numbers `d` stand for.
    fn matrix(&self, d: &DVector<f64>) -> Matrix3<f64> {
        let (cx, cy) = self.centre;
        let from =
            Matrix3::new(1.0 / self.unit, 0.0, -cx / self.unit, 0.0, 1.0 / self.unit, -cy / self.unit, 0.0, 0.0, 1.0);
        let to = Matrix3::new(self.unit, 0.0, cx, 0.0, self.unit, cy, 0.0, 0.0, 1.0);
        let m = match self.model {
            Model::Unmoved => Matrix3::identity(),
            Model::Shift => Matrix3::new(1.0, 0.0, d[0], 0.0, 1.0, d[1], 0.0, 0.0, 1.0),
            Model::Rigid => {
                let (s, c) = (libm::sin(d[2]), libm::cos(d[2]));
                Matrix3::new(c, -s, d[0], s, c, d[1], 0.0, 0.0, 1.0)
            }
            Model::Homography => Matrix3::new(1.0 + d[2], d[3], d[0], d[4], 1.0 + d[5], d[1], d[6], d[7], 1.0),
        };
        to * m * from
    }

    /// The farthest that the motion `d` moves a corner, in pixels.
    fn largest_move(&self, d: &DVector<f64>) -> f64 {
        Warp::Homography(self.matrix(d)).corner_distance(&Warp::Identity, self.size.0, self.size.1)
    }

    /// The root mean square over the picture of the error that A^-1, the covariance of the numbers, stands for, in pixels.
    fn expected_error(&self, a: &DMatrix<f64>) -> Option<f64> {
        let covariance = a.clone().cholesky()?.inverse();
        const GRID: usize = 9;
        let mut sum = 0.0;
        for i in 0..GRID * GRID {
            let place = |k: usize, n: usize| (n as f64 - 1.0) * k as f64 / (GRID as f64 - 1.0);
            let j = self.jacobian(place(i % GRID, self.size.0), place(i / GRID, self.size.1));
            let mut local = Matrix2::zeros();
            for p in 0..self.numbers() {
                for q in 0..self.numbers() {
                    local += covariance[(p, q)] * Vector2::from(j[p]) * Vector2::from(j[q]).transpose();
                }
            }
            sum += local.trace();
        }
        Some((sum / (GRID * GRID) as f64).sqrt())
    }
}

#[cfg(test)]
mod tests;
