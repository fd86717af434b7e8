//! A pair of frames for refinement: both at a common exposure on every level, and the points at which they are
//! compared.
//!
//! In: the grey pyramids of a reference and a frame, and an approximate transform. Out: both frames on each level that
//! is asked for, and its points; each computed once. Cost: that of [`CommonExposure`], and one pass over the reference
//! for the points.

use crate::align::grey::{GreyPyramid, measured_level};
use crate::align::photometric::{CommonExposure, ToneTables};
use crate::align::refinement::patch::Patches;
use crate::align::resampling::cubic::BORDER;
use crate::align::transform::{Transform, on_level};
use crate::plane::Plane;
use nalgebra::Matrix3;
use std::sync::{Mutex, OnceLock, PoisonError};

/// About so many cells, of which each gives a point: on the level of [`measured_level`], and on those above, which
/// only lead to it.
const CELLS: (f64, f64) = (16_000.0, 4_000.0);
/// Residuals at an edge are as if it were displaced by this, in pixels: interpolation, aliasing, a little blur in one
/// of the frames.
const JITTER: f32 = 0.15;

/// A pixel of the reference that is compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Column and row, in pixels of the level.
    pub x: f64,
    /// See `x`.
    pub y: f64,
    /// The reference's level there, at the exposure of the brighter.
    pub value: f32,
    /// Its gradient, in levels a pixel.
    pub gradient: [f32; 2],
    /// 1 / standard deviation of what noise alone would leave here, in units of the darker frame's noise or so: the
    /// noise of both, and what aliasing and blur make of a strong gradient.
    pub precision: f32,
}

impl Point {
    /// The point at (x, y) whose surroundings in a smoothed plane are `level`, `left`, `right`, `up` and `down`.
    pub(crate) fn new(
        (x, y): (usize, usize),
        value: f32,
        [left, right, up, down]: [f32; 4],
        tones: &ToneTables,
    ) -> Self {
        let gradient = [0.5 * (right - left), 0.5 * (down - up)];
        let jitter = JITTER * JITTER * (gradient[0] * gradient[0] + gradient[1] * gradient[1]);
        let precision = 1.0 / (1.0 / tones.weight(value) + jitter).sqrt();
        Point { x: x as f64, y: y as f64, value, gradient, precision }
    }
}

/// One level of both, and where they are compared.
#[derive(Debug)]
pub struct Level {
    /// Both at a common exposure.
    pub both: CommonExposure,
    /// Of every cell of the reference the pixel with the largest weighted gradient.
    pub points: Vec<Point>,
}

/// A reference and a frame that is placed by it.
#[derive(Debug)]
pub struct FramePair<'a> {
    reference: &'a GreyPyramid,
    frame: &'a GreyPyramid,
    /// The transform under which levels are taken.
    start: Matrix3<f64>,
    tones: Vec<OnceLock<ToneTables>>,
    levels: Vec<OnceLock<Level>>,
    /// See [`fine_points`](Self::fine_points).
    fine_points: OnceLock<Vec<Point>>,
    /// See [`patches`](Self::patches).
    patches: Mutex<Option<Patches>>,
}

impl<'a> FramePair<'a> {
    /// The pair of `reference` and `frame`, which `start` aligns approximately.
    pub fn new(reference: &'a GreyPyramid, frame: &'a GreyPyramid, start: &Transform) -> Self {
        let (width, height) = reference.size(0);
        let start = start.matrix(width, height);
        let tones = (0..reference.len()).map(|_| OnceLock::new()).collect();
        let levels = (0..reference.len()).map(|_| OnceLock::new()).collect();
        FramePair { reference, frame, start, tones, levels, fine_points: OnceLock::new(), patches: Mutex::default() }
    }

    /// The reference.
    pub fn reference(&self) -> &'a GreyPyramid {
        self.reference
    }

    /// The frame.
    pub fn frame(&self) -> &'a GreyPyramid {
        self.frame
    }

    /// What brings both to a common exposure on level `i`. Halving averages noise, and black is not black where there
    /// is noise: each level has its own.
    pub fn tones(&self, i: usize) -> &ToneTables {
        let h = || on_level(&self.start, i);
        self.tones[i].get_or_init(|| ToneTables::between(self.reference.level(i), self.frame.level(i), &h()))
    }

    /// The points of [`finest_level`](crate::align::grey::finest_level): what `choose` returns, called once.
    pub(crate) fn fine_points(&self, choose: impl FnOnce() -> Vec<Point>) -> &[Point] {
        self.fine_points.get_or_init(choose)
    }

    /// What was read of the frame about its places of the [`fine_points`](Self::fine_points) when they were last
    /// refined; what `unread` gives, the first time. The places are much the same each time, and what is read there is.
    pub(crate) fn patches(&self, unread: impl FnOnce() -> Patches) -> Patches {
        self.patches.lock().unwrap_or_else(PoisonError::into_inner).take().map_or_else(unread, Patches::anew)
    }

    /// Keeps what was read for the next time.
    pub(crate) fn keep_patches(&self, patches: Patches) {
        *self.patches.lock().unwrap_or_else(PoisonError::into_inner) = Some(patches);
    }

    /// Width and height of the frames.
    pub fn size(&self) -> (usize, usize) {
        self.reference.size(0)
    }

    /// Both frames on level `i`.
    pub fn level(&self, i: usize) -> &Level {
        self.levels[i].get_or_init(|| {
            let both = CommonExposure::new(self.reference.level(i), self.frame.level(i), self.tones(i));
            let cells = if i <= measured_level(self.reference) { CELLS.0 } else { CELLS.1 };
            let area = (both.reference.width() * both.reference.height()) as f64;
            let points = choose_points(&both, (area / cells).sqrt().max(1.0) as usize);
            Level { both, points }
        })
    }
}

/// Of every cell, the pixel with the largest weighted gradient.
fn choose_points(both: &CommonExposure, cell: usize) -> Vec<Point> {
    let (reference, tones) = (&both.reference, &both.tones);
    let (width, height) = (reference.width(), reference.height());
    let mut points = Vec::new();
    if width <= 2 * BORDER {
        return points;
    }
    let inner = width - 2 * BORDER;
    let mut squares = vec![0.0f32; inner];
    for top in (BORDER..height.saturating_sub(BORDER)).step_by(cell) {
        let mut best: Vec<(f32, usize, usize)> = vec![(0.0, 0, 0); inner.div_ceil(cell)];
        for y in top..(top + cell).min(height - BORDER) {
            let (up, row, down) = (reference.row(y - 1), reference.row(y), reference.row(y + 1));
            let (left, right) = (&row[BORDER - 1..][..inner], &row[BORDER + 1..][..inner]);
            let (up, down) = (&up[BORDER..][..inner], &down[BORDER..][..inner]);
            for x in 0..inner {
                let (dx, dy) = (right[x] - left[x], down[x] - up[x]);
                squares[x] = dx * dx + dy * dy;
            }
            for (slot, (i, cell_squares)) in best.iter_mut().zip(squares.chunks(cell).enumerate()) {
                for (k, &square) in cell_squares.iter().enumerate() {
                    // The weight is at most 1: most pixels need no table look-up.
                    if square > slot.0 {
                        let x = BORDER + i * cell + k;
                        let strength = square * tones.weight(row[x]);
                        if strength > slot.0 {
                            *slot = (strength, x, y);
                        }
                    }
                }
            }
        }
        points.extend(best.into_iter().filter(|b| b.0 > 0.0).map(|(_, x, y)| point_of(reference, x, y, tones)));
    }
    points
}

fn point_of(plane: &Plane<f32>, x: usize, y: usize, tones: &ToneTables) -> Point {
    let around = [plane.at(x - 1, y), plane.at(x + 1, y), plane.at(x, y - 1), plane.at(x, y + 1)];
    Point::new((x, y), plane.at(x, y), around, tones)
}
