//! Extrema of the differences of Gaussians, placed between the samples (Lowe 2004, sections 3.1 and 4).

use super::SiftOptions;
use super::scale_space::{Octave, ScaleSpace};
use crate::align::features::Keypoint;
use crate::plane::{Plane, map_bands};
use crate::simd::{Loops, vectorised};
use nalgebra::{Matrix3, Vector3};

/// An extremum of D, in pixels of its octave.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extremum {
    pub(super) octave: usize,
    pub(super) interval: usize,
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) sigma: f64,
    /// |D| at the extremum.
    pub(super) response: f32,
    /// Whether D is negative there: the difference is of the smoother to the sharper.
    pub(super) bright: bool,
}

impl Extremum {
    /// The picture in which its surroundings are looked at: the Gaussian of its scale.
    pub(super) fn level<'a>(&self, space: &'a ScaleSpace) -> &'a Plane<f32> {
        &space.octaves[self.octave].gaussians[self.interval]
    }

    /// The extremum as a point of the picture.
    pub(super) fn keypoint(&self, space: &ScaleSpace, angle: f32) -> Keypoint {
        let step = space.step(self.octave);
        Keypoint {
            x: (self.x * step) as f32,
            y: (self.y * step) as f32,
            scale: (self.sigma * step) as f32,
            angle,
            response: self.response,
            bright: self.bright,
        }
    }
}

/// Samples nearest the border that are not looked at.
const BORDER: usize = 5;
/// Moves to a neighbouring sample before a fit is given up.
const MOST_MOVES: usize = 5;

/// All extrema that are strong enough and no edges, by octave, interval, row, column.
pub(super) fn find(space: &ScaleSpace, options: &SiftOptions) -> Vec<Extremum> {
    let mut found = Vec::new();
    for (index, octave) in space.octaves.iter().enumerate() {
        for interval in 1..=options.intervals {
            let height = octave.gaussians[interval].height();
            let bands = map_bands(height, |rows| {
                let mut band = Vec::new();
                let rows = rows.start.max(BORDER)..rows.end.min(height.saturating_sub(BORDER));
                let mut window = Window::new(octave, interval);
                for y in rows {
                    window.go_to(y);
                    // The fit adds at most about half of its value to a sample, so that a weaker one cannot reach the
                    // contrast.
                    window.mark((0.5 * options.contrast) as f32);
                    find_in_row(space, index, interval, y, options, &window.candidates, &mut band);
                }
                band
            });
            found.extend(bands.into_iter().flatten());
        }
    }
    found
}

/// Three rows of D, and where the middle one may have an extremum.
struct Window<'a> {
    octave: &'a Octave,
    interval: usize,
    /// The row below the middle one, and what D is there, above it and in it.
    next: Option<usize>,
    up: Vec<f32>,
    here: Vec<f32>,
    down: Vec<f32>,
    candidates: Vec<bool>,
}

impl<'a> Window<'a> {
    fn new(octave: &'a Octave, interval: usize) -> Self {
        let row = || vec![0.0; octave.gaussians[interval].width()];
        let candidates = vec![false; octave.gaussians[interval].width()];
        Window { octave, interval, next: None, up: row(), here: row(), down: row(), candidates }
    }

    /// Makes `y`, not the first or the last row, the middle one.
    fn go_to(&mut self, y: usize) {
        let row = |y: usize, out: &mut [f32]| self.octave.difference_row(self.interval, y, out);
        if self.next == Some(y) {
            std::mem::swap(&mut self.up, &mut self.here);
            std::mem::swap(&mut self.here, &mut self.down);
        } else {
            row(y - 1, &mut self.up);
            row(y, &mut self.here);
        }
        row(y + 1, &mut self.down);
        self.next = Some(y + 1);
    }

    /// Marks where D is larger than `least` and no smaller than its four neighbours in the plane, or the same below
    /// zero: few samples are left for closer looks.
    fn mark(&mut self, least: f32) {
        let Window { up, here, down, candidates, .. } = self;
        vectorised(Marks { up, here, down, least, candidates });
    }
}

/// See [`Window::mark`].
struct Marks<'a> {
    up: &'a [f32],
    here: &'a [f32],
    down: &'a [f32],
    least: f32,
    candidates: &'a mut [bool],
}

impl Loops for Marks<'_> {
    type Output = ();

    // Side by side and without a branch, so that the compiler takes as many at a time as it can.
    #[inline(always)]
    fn run(self) {
        let least = self.least;
        let n = self.here.len().max(2) - 2;
        let (up, down) = (&self.up[1..][..n], &self.down[1..][..n]);
        let (left, here, right) = (&self.here[..n], &self.here[1..][..n], &self.here[2..][..n]);
        let out = &mut self.candidates[1..][..n];
        for i in 0..n {
            let v = here[i];
            let high = larger(larger(left[i], right[i]), larger(larger(up[i], down[i]), least));
            let low = smaller(smaller(left[i], right[i]), smaller(smaller(up[i], down[i]), -least));
            out[i] = (v >= high) | (v <= low);
        }
    }
}

/// The larger, in one instruction.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller, in one instruction.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

fn find_in_row(
    space: &ScaleSpace,
    index: usize,
    interval: usize,
    y: usize,
    options: &SiftOptions,
    candidates: &[bool],
    found: &mut Vec<Extremum>,
) {
    let octave = &space.octaves[index];
    for x in (BORDER..candidates.len().saturating_sub(BORDER)).filter(|&x| candidates[x]) {
        let v = octave.difference(interval, x, y);
        let beats = |w: f32| if v > 0.0 { v >= w } else { v <= w };
        let is_extremum = (interval - 1..=interval + 1)
            .all(|i| (y - 1..=y + 1).all(|r| (x - 1..=x + 1).all(|c| beats(octave.difference(i, c, r)))));
        if is_extremum && let Some((interval, x, y, offset, value)) = localise(octave, interval, x, y, options) {
            let response = value.abs();
            if response >= options.contrast && !is_edge(octave, interval, x, y, options.edge_ratio) {
                found.push(Extremum {
                    octave: index,
                    interval,
                    x: x as f64 + offset[0],
                    y: y as f64 + offset[1],
                    sigma: space.sigma_at(interval as f64 + offset[2]),
                    response: response as f32,
                    bright: value < 0.0,
                });
            }
        }
    }
}

/// Fits D with a quadratic and moves to the sample nearest its extremum (section 4, eq. 2 and 3): interval, x, y,
/// offset, D there.
fn localise(
    octave: &Octave,
    mut interval: usize,
    mut x: usize,
    mut y: usize,
    options: &SiftOptions,
) -> Option<(usize, usize, usize, Vector3<f64>, f64)> {
    for _ in 0..MOST_MOVES {
        let d = |dx: isize, dy: isize, ds: isize| -> f64 {
            let (x, y) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            octave.difference(interval.wrapping_add_signed(ds), x, y).into()
        };
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
        if offset.iter().all(|o| o.abs() <= 0.5) {
            return Some((interval, x, y, offset, v + 0.5 * gradient.dot(&offset)));
        }
        if offset.iter().any(|o| !o.is_finite() || o.abs() > 100.0) {
            return None;
        }
        let plane = &octave.gaussians[interval];
        let step = |i: usize, o: f64, low: usize, high: usize| -> Option<usize> {
            let moved = i as f64 + (o + 0.5).floor();
            (moved >= low as f64 && moved < high as f64).then_some(moved as usize)
        };
        x = step(x, offset[0], BORDER, plane.width() - BORDER)?;
        y = step(y, offset[1], BORDER, plane.height() - BORDER)?;
        interval = step(interval, offset[2], 1, options.intervals + 1)?;
    }
    None
}

/// Whether the principal curvatures differ by more than r: tr(H)^2 / det(H) >= (r + 1)^2 / r (section 4.1).
fn is_edge(octave: &Octave, interval: usize, x: usize, y: usize, r: f64) -> bool {
    let d = |dx: isize, dy: isize| -> f64 {
        octave.difference(interval, x.wrapping_add_signed(dx), y.wrapping_add_signed(dy)).into()
    };
    let v = d(0, 0);
    let (xx, yy) = (d(1, 0) + d(-1, 0) - 2.0 * v, d(0, 1) + d(0, -1) - 2.0 * v);
    let xy = 0.25 * (d(1, 1) - d(-1, 1) - d(1, -1) + d(-1, -1));
    let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
    determinant <= 0.0 || trace * trace * r >= (r + 1.0) * (r + 1.0) * determinant
}
