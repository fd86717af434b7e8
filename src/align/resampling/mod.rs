//! Resampling: the pixel values of a frame on the reference's grid, in one step.
//!
//! In: a [`Window`] of a frame and its [`Motion`]. Out: rows of pixel values as floats, [`OUTSIDE`] where the frame has
//! no pixel, or something else hides it. Cost: at most 56 multiply-adds per value, and fewer if the transform is nearly
//! a shift; for the identity, values are only copied. Source: Turkowski, "Filters for Common Resampling Tasks",
//! Graphics Gems I (1990), who recommends the Lanczos kernel (`lanczos`) for photographs.

pub(crate) mod bilinear;
pub(crate) mod cubic;
pub(crate) mod lanczos;
pub(crate) mod nearest;
mod tile;

use crate::align::motion::Motion;
use crate::align::resampling::lanczos::{BEFORE, TAPS};
use crate::align::resampling::tile::Source;
use crate::align::transform::map;
use crate::bracket::{Codes, Window};
use std::ops::Range;

/// Value of all three channels of a resampled pixel that the frame does not show.
pub const OUTSIDE: f32 = -1.0;

/// Returns the rows of a frame that are needed to resample the reference's pixels `columns` x `rows`.
pub fn rows_under(motion: &Motion, columns: &Range<usize>, rows: &Range<usize>) -> Range<usize> {
    if columns.is_empty() || rows.is_empty() {
        return 0..0;
    }
    if motion.is_identity() {
        return rows.clone();
    }
    let (_, height) = motion.size();
    let corners = [columns.start, columns.end - 1].map(|x| [rows.start, rows.end - 1].map(|y| (x as f64, y as f64)));
    let corners = corners.as_flattened();
    let (mut top, mut bottom) = (f64::INFINITY, f64::NEG_INFINITY);
    for h in motion.bounds(columns, rows) {
        let w = |&(x, y): &(f64, f64)| h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)];
        // A homography maps a rectangle to a convex shape, whose extremes are its corners, unless the line that it maps
        // to infinity crosses the rectangle.
        if !(corners.iter().all(|c| w(c) > 0.0) || corners.iter().all(|c| w(c) < 0.0)) {
            return 0..height;
        }
        let ends = corners.iter().map(|&(x, y)| map(&h, x, y).1);
        (top, bottom) = ends.fold((top, bottom), |(a, b), v| (a.min(v), b.max(v)));
    }
    // Positions outside the frame are clamped. At both ends, the rows under the kernel and spare rows for rounding
    // errors are added.
    let last = (height - 1) as f64;
    let (first, end) = (top.clamp(0.0, last) as usize, bottom.clamp(0.0, last) as usize + 1);
    first.saturating_sub(BEFORE + 1)..(end + TAPS - BEFORE + 1).min(height)
}

/// Resamples a frame at the reference's pixels `columns` x `rows`, and writes them row by row into `out`.
///
/// Values are 0..=255 for any bit depth. A pixel that is hidden in the frame or outside the rectangle of the frame's
/// pixel centres is [`OUTSIDE`] in all channels.
///
/// # Panics
/// If `out` does not have `columns.len() * rows.len()` pixels, or if `window` does not contain all rows of the frame
/// that [`rows_under`] returns for these pixels.
pub fn resample_rows(
    window: &Window,
    motion: &Motion,
    columns: Range<usize>,
    rows: Range<usize>,
    out: &mut [[f32; 3]],
) {
    assert_eq!(out.len(), columns.len() * rows.len());
    let (size, first) = ((window.width(), window.height()), window.rows().start);
    match window.codes() {
        Codes::Eight(codes) => Source { codes, first, size, scale: 1.0 }.resample(motion, columns, rows, out),
        Codes::Sixteen(codes) => Source { codes, first, size, scale: 1.0 / 257.0 }.resample(motion, columns, rows, out),
    }
}

#[cfg(test)]
mod tests;
