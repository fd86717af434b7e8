//! A frame on the grid of the reference.
//!
//! In: a frame and a transform. Out: the frame's grey values at the reference's pixels, NaN outside the frame; and the
//! part of a tile that the frame shows. Cost: one bilinear interpolation per pixel.

use crate::align::transform::map;
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use nalgebra::Matrix3;

/// A rectangle of pixels of the reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Part {
    pub(crate) left: usize,
    pub(crate) top: usize,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

impl Part {
    /// The square of `side` x `side` pixels whose top-left pixel is (`left`, `top`).
    pub(crate) fn square(left: usize, top: usize, side: usize) -> Self {
        Part { left, top, width: side, height: side }
    }

    /// Number of pixels.
    fn area(&self) -> usize {
        self.width * self.height
    }

    /// The positions (x, y) of all pixels.
    fn pixels(self) -> impl Iterator<Item = (usize, usize)> {
        let columns = self.left..self.left + self.width;
        (self.top..self.top + self.height).flat_map(move |y| columns.clone().map(move |x| (x, y)))
    }

    /// Returns the first and last column and row, each with the rest of the rectangle.
    fn sides(&self) -> [(Part, Part); 4] {
        let Part { left, top, width, height } = *self;
        let column = |left| Part { left, width: 1, ..*self };
        let row = |top| Part { top, height: 1, ..*self };
        let (narrower, lower) = (Part { width: width - 1, ..*self }, Part { height: height - 1, ..*self });
        [
            (column(left), Part { left: left + 1, ..narrower }),
            (column(left + width - 1), narrower),
            (row(top), Part { top: top + 1, ..lower }),
            (row(top + height - 1), lower),
        ]
    }

    /// Returns the centre: the mean of the pixels' positions.
    pub(crate) fn centre(&self) -> [f64; 2] {
        let middle = |at: usize, length: usize| at as f64 + (length as f64 - 1.0) / 2.0;
        [middle(self.left, self.width), middle(self.top, self.height)]
    }
}

/// A frame on the reference's grid, with a margin on all sides.
pub(crate) struct Warped {
    /// The pixels of the frame; NaN in the margin and outside the frame.
    plane: Plane<f32>,
    margin: usize,
}

impl Warped {
    /// Warps `frame` with the transform `h`, reference -> frame in pixels of the planes.
    pub(crate) fn new(frame: &Plane<f32>, h: &Matrix3<f64>, (width, height): (usize, usize), margin: usize) -> Self {
        let is_identity = *h == Matrix3::identity();
        let mut plane = Plane::filled(width + 2 * margin, height + 2 * margin, f32::NAN);
        plane.fill_rows(|row_at, row| {
            let Some(y) = row_at.checked_sub(margin).filter(|&y| y < height) else { return };
            let row = &mut row[margin..margin + width];
            if is_identity {
                // This gives the same values as `WarpRow`, which omits the frame's last row and column because they
                // have no next neighbour to interpolate with.
                if y + 1 < frame.height() {
                    let count = width.min(frame.width() - 1);
                    row[..count].copy_from_slice(&frame.row(y)[..count]);
                }
            } else {
                vectorised(WarpRow { frame, h, y, row });
            }
        });
        Warped { plane, margin }
    }

    /// Returns a rectangle within `part` that the frame shows completely; none if it is less than half of `part`.
    /// Columns and rows at the sides are removed until no pixel is outside the frame.
    pub(super) fn shown(&self, part: Part) -> Option<Part> {
        let is_missing = |&(x, y): &(usize, usize)| self.plane.row(y + self.margin)[x + self.margin].is_nan();
        let missing = |side: Part| side.pixels().filter(is_missing).count() as f64 / side.area() as f64;
        let mut shown = part;
        while 2 * shown.area() >= part.area() {
            let sides = shown.sides().map(|(side, rest)| (missing(side), rest));
            let (most, rest) = sides.into_iter().reduce(|a, b| if b.0 > a.0 { b } else { a })?;
            if most == 0.0 {
                return Some(shown);
            }
            shown = rest;
        }
        None
    }

    /// Returns `width` pixels of a row, from the reference's pixel (x, y) to the right.
    pub(super) fn row(&self, (x, y): (isize, isize), width: usize) -> &[f32] {
        let left = (x + self.reach()) as usize;
        &self.plane.row((y + self.reach()) as usize)[left..left + width]
    }

    /// Largest shift at which patterns can be compared, in pixels.
    pub(crate) fn reach(&self) -> isize {
        self.margin as isize
    }
}

/// Computes row `y` of a frame on the reference's grid; leaves pixels outside the frame as they are.
struct WarpRow<'a> {
    frame: &'a Plane<f32>,
    h: &'a Matrix3<f64>,
    y: usize,
    row: &'a mut [f32],
}

impl Loops for WarpRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let WarpRow { frame, h, y, row } = self;
        let (right, bottom) = (frame.width() as f64 - 1.0, frame.height() as f64 - 1.0);
        let is_inside = |(u, w): (f64, f64)| u >= 0.0 && w >= 0.0 && u < right && w < bottom;
        for (start, piece) in row.chunks_mut(PIECE).enumerate().map(|(i, p)| (i * PIECE, p)) {
            // Over a few pixels a homography is linear to within some thousandths of a pixel.
            let from = map(h, start as f64, y as f64);
            let to = map(h, (start + PIECE) as f64, y as f64);
            let step = ((to.0 - from.0) / PIECE as f64, (to.1 - from.1) / PIECE as f64);
            let at = |i: usize| (from.0 + step.0 * i as f64, from.1 + step.1 * i as f64);
            let (first, last) = (at(0), at(piece.len() - 1));
            let (column, line) = (first.0 as usize, first.1 as usize);
            let is_one_line = is_inside(first) && is_inside(last) && line == last.1 as usize;
            if let (true, Ok(piece)) = (is_one_line, <&mut [f32; PIECE]>::try_from(&mut *piece))
                && last.0 as usize == column + PIECE - 1
            {
                // All pixels of the piece are between the same two rows of the frame, each one column to the right of
                // the one before.
                let pixels = |y: usize| frame.row(y)[column..].first_chunk::<{ PIECE + 1 }>();
                let Some((upper, lower)) = pixels(line).zip(pixels(line + 1)) else { continue };
                for (i, v) in piece.iter_mut().enumerate() {
                    let (u, w) = at(i);
                    let (fx, fy) = ((u - (column + i) as f64) as f32, (w - line as f64) as f32);
                    *v = blend((upper[i], upper[i + 1]), (lower[i], lower[i + 1]), (fx, fy));
                }
            } else {
                for (i, v) in piece.iter_mut().enumerate().filter(|(i, _)| is_inside(at(*i))) {
                    let (u, w) = at(i);
                    let (x, y) = (u as usize, w as usize);
                    let (upper, lower) = (&frame.row(y)[x..x + 2], &frame.row(y + 1)[x..x + 2]);
                    let fractions = ((u - x as f64) as f32, (w - y as f64) as f32);
                    *v = blend((upper[0], upper[1]), (lower[0], lower[1]), fractions);
                }
            }
        }
    }
}

/// Returns the value at the fractions (`fx`, `fy`) of the way between four pixels: (left, right) of the upper and the
/// lower row.
#[inline(always)]
fn blend(upper: (f32, f32), lower: (f32, f32), (fx, fy): (f32, f32)) -> f32 {
    let (top, bottom) = (upper.0 + fx * (upper.1 - upper.0), lower.0 + fx * (lower.1 - lower.0));
    top + fy * (bottom - top)
}

/// Length, in pixels, of the parts of a row within which positions are interpolated linearly.
const PIECE: usize = 16;
