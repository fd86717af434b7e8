//! A pair of frames for refinement: both at a common exposure on every level, and the points to compare.
//!
//! In: the grey pyramids of a reference and a frame, and an approximate transform. Out: for each requested level, both
//! frames and the points; they are computed on first use and kept. Cost: [`CommonExposure`], and one pass over the
//! reference for the points.

use crate::align::grey::{GreyPyramid, measured_level};
use crate::align::photometric::{CommonExposure, ToneTables};
use crate::align::refinement::patch::Patches;
use crate::align::resampling::cubic::BORDER;
use crate::align::transform::{Transform, on_level};
use nalgebra::Matrix3;
use std::sync::{Mutex, OnceLock, PoisonError};

/// Approximate number of cells into which a level is divided; each cell gives at most one point. (On [`measured_level`]
/// and finer levels, on coarser levels.)
const CELLS: (f64, f64) = (16_000.0, 4_000.0);
/// Standard deviation of the apparent position of an edge, in pixels. Its causes are interpolation, aliasing, and blur
/// in only one of the frames.
const JITTER: f32 = 0.15;

/// A pixel of the reference that is compared with the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Column, in pixels of the level.
    pub x: f64,
    /// Row, in pixels of the level.
    pub y: f64,
    /// Grey value of the reference, at the exposure of the brighter frame.
    pub value: f32,
    /// Gradient, in grey values per pixel.
    pub gradient: [f32; 2],
    /// 1 / standard deviation of the residual. The deviation has two causes: the noise of both frames, and, at strong
    /// gradients, aliasing and blur. Its unit is the deviation that the noise of the brighter frame alone causes.
    pub precision: f32,
}

impl Point {
    /// The point at (x, y) with grey value `value`; the grey values of its neighbours are `left`, `right`, `up` and
    /// `down`.
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

/// A reference and a frame to align to it.
#[derive(Debug)]
pub struct FramePair<'a> {
    reference: &'a GreyPyramid,
    frame: &'a GreyPyramid,
    /// The approximate transform (reference -> frame), in pixels of the full size.
    start: Matrix3<f64>,
    tones: Vec<OnceLock<ToneTables>>,
    levels: Vec<OnceLock<CommonExposure>>,
    points: Vec<OnceLock<Vec<Point>>>,
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
        let points = (0..reference.len()).map(|_| OnceLock::new()).collect();
        FramePair {
            reference,
            frame,
            start,
            tones,
            levels,
            points,
            fine_points: OnceLock::new(),
            patches: Mutex::default(),
        }
    }

    /// The reference.
    pub fn reference(&self) -> &'a GreyPyramid {
        self.reference
    }

    /// The frame.
    pub fn frame(&self) -> &'a GreyPyramid {
        self.frame
    }

    /// Returns the tables that convert both frames to a common exposure on level `i`.
    ///
    /// Each level has its own tables, because noise raises the mean grey value of black pixels, and a coarser level has
    /// less noise.
    pub fn tones(&self, i: usize) -> &ToneTables {
        self.tones[i].get_or_init(|| {
            ToneTables::between(self.reference.level(i), self.frame.level(i), &on_level(&self.start, i))
        })
    }

    /// Returns the points on [`finest_level`](crate::align::grey::finest_level), which the first call computes with
    /// `choose`.
    pub(crate) fn fine_points(&self, choose: impl FnOnce() -> Vec<Point>) -> &[Point] {
        self.fine_points.get_or_init(choose)
    }

    /// Returns the patches of the frame that the previous refinement kept; if there are none, the result of `unread`.
    ///
    /// The positions in the frame of the [`fine_points`](Self::fine_points) change little from one refinement to the
    /// next, so most patches can be reused.
    pub(crate) fn patches(&self, unread: impl FnOnce() -> Patches) -> Patches {
        self.patches.lock().unwrap_or_else(PoisonError::into_inner).take().map_or_else(unread, Patches::reset)
    }

    /// Keeps `patches` for the next refinement.
    pub(crate) fn keep_patches(&self, patches: Patches) {
        *self.patches.lock().unwrap_or_else(PoisonError::into_inner) = Some(patches);
    }

    /// Width and height of the frames.
    pub fn size(&self) -> (usize, usize) {
        self.reference.size(0)
    }

    /// Returns both frames at a common exposure on level `i`.
    pub fn level(&self, i: usize) -> &CommonExposure {
        self.levels[i].get_or_init(|| CommonExposure::new(self.reference.level(i), self.frame.level(i), self.tones(i)))
    }

    /// Returns the points to compare on level `i`: from every cell of the reference, the pixel with the largest
    /// weighted gradient.
    pub fn points(&self, i: usize) -> &[Point] {
        self.points[i].get_or_init(|| {
            let both = self.level(i);
            let cells = if i <= measured_level(self.reference) { CELLS.0 } else { CELLS.1 };
            let area = (both.reference.width() * both.reference.height()) as f64;
            choose_points(both, (area / cells).sqrt().max(1.0) as usize)
        })
    }
}

/// Returns, from every cell of `cell` x `cell` pixels of the reference, the pixel with the largest weighted gradient.
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
                    // The weight is at most 1. Therefore, if the squared gradient is not larger than the best strength
                    // so far, the weight need not be looked up.
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
        points.extend(best.into_iter().filter(|b| b.0 > 0.0).map(|(_, x, y)| {
            let around = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].map(|(x, y)| reference.at(x, y));
            Point::new((x, y), reference.at(x, y), around, tones)
        }));
    }
    points
}
