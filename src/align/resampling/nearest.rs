//! Nearest-neighbour access to the pixels of aligned frames, without interpolation.
//!
//! In: a bracket and its alignment. Out: the pixel values of some rows of each aligned frame, and for a pixel of the
//! reference, the index of the corresponding pixel in these rows. Cost: a matrix product for each requested pixel. Use
//! this where an error of half a pixel does no harm, as in uniform areas or in statistics of many pixels; otherwise use
//! [`resampling`](crate::align::resampling).

use crate::align::motion::Motion;
use crate::align::resampling::rows_under;
use crate::align::result::Alignment;
use crate::bracket::{Bracket, Frame, Window};
use crate::error::Result;
use std::ops::Range;

/// An aligned frame.
pub struct Placed<'a> {
    /// The frame.
    pub frame: &'a Frame,
    /// The index of the frame in the bracket.
    pub index: usize,
    motion: Motion,
}

/// Returns the aligned frames of `bracket`.
pub fn placed<'a>(bracket: &'a Bracket, alignment: &'a Alignment) -> Vec<Placed<'a>> {
    alignment.placed(bracket).map(|(index, frame, motion)| Placed { frame, index, motion }).collect()
}

impl Placed<'_> {
    /// Returns the rows of the frame that correspond to the reference's `columns` and `rows`.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch) if a frame on disk cannot be read.
    pub fn strip(&self, columns: &Range<usize>, rows: &Range<usize>) -> Result<Strip<'_>> {
        let window = self.frame.window(rows_under(&self.motion, columns, rows))?;
        Ok(Strip { window, motion: &self.motion })
    }
}

/// Some rows of a frame.
pub struct Strip<'a> {
    /// The pixel values of these rows.
    pub window: Window<'a>,
    motion: &'a Motion,
}

impl Strip<'_> {
    /// Finds the square of the frame that corresponds to a square of the reference, and returns the index of its first
    /// value in `window`, the rows of the frame that are in memory.
    ///
    /// The reference's square has `side` x `side` pixels; its top-left pixel is (x, y). Returns none if the
    /// corresponding square is not completely inside the frame, or hidden.
    pub fn start(&self, x: usize, y: usize, side: usize) -> Option<usize> {
        let (width, height) = (self.window.width(), self.window.height());
        let (x, y) = if self.motion.is_identity() {
            (x, y)
        } else {
            let half = (side / 2) as f64;
            let (u, v) = self.motion.position(x as f64 + half, y as f64 + half)?;
            let (u, v) = ((u + 0.5).floor() - half, (v + 0.5).floor() - half);
            if !(u >= 0.0 && v >= 0.0) {
                return None;
            }
            (u as usize, v as usize)
        };
        let fits = x.saturating_add(side) <= width && y.saturating_add(side) <= height;
        fits.then(|| 3 * ((y - self.window.rows().start) * width + x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::{Placement, Transform};
    use crate::bracket::Codes;
    use crate::response::tests::still;

    #[test]
    fn a_pixel_is_found_where_the_warp_puts_it() {
        let (bracket, mut alignment) = still((60, 60), &[0.5, 1.0], |x, y| [0.002 * (x + 3 * y) as f64; 3]);
        let code = |alignment: &Alignment, x, y| {
            let frames = placed(&bracket, alignment);
            let strip = frames[0].strip(&(0..60), &(y..y + 1)).unwrap();
            let Codes::Eight(codes) = strip.window.codes() else { unreachable!() };
            strip.start(x, y, 1).map(|start| codes[start])
        };
        let expected = code(&alignment, 17, 24);
        alignment.placements[0] = Placement::by_user(Transform::Rigid { dx: 7.2, dy: 3.9, angle: 0.0 });
        assert_eq!(code(&alignment, 10, 20), expected);
        assert!(expected.is_some() && code(&alignment, 55, 20).is_none());
    }
}
