//! Frames: the part of each frame that the result shows, reduced for the page.
//!
//! In: a frame and its motion. Out: its pixels on the grid of the result, reduced. Cost: resampling.

use crate::align::resampling::{resample_rows, rows_under};
use crate::align::{Motion, Rect};
use crate::bracket::Frame;
use crate::draw::scale::Reduced;
use crate::error::Result;
use crate::plane::{BAND_ROWS, Plane};
use rayon::prelude::*;

/// Number of bands that are resampled at once.
const AT_ONCE: usize = 8;

/// Resamples `frame` by `motion` to the part `region` of the reference, and reduces it to `size` pixels. Pixels that
/// the frame does not show are black. The frame is read in bands, so that a frame on disk need not fit into memory.
pub(in crate::page) fn frame(
    frame: &Frame,
    motion: &Motion,
    region: Rect,
    size: (usize, usize),
) -> Result<Plane<[u8; 3]>> {
    let (width, height) = (region.width(), region.height());
    let mut reduced = Reduced::new((width, height), size);
    let mut rows = vec![[0u8; 3]; width * height.min(AT_ONCE * BAND_ROWS)];
    for first in (0..height).step_by(AT_ONCE * BAND_ROWS) {
        let rows = &mut rows[..width * (height - first).min(AT_ONCE * BAND_ROWS)];
        let bands = rows.par_chunks_mut(BAND_ROWS * width).enumerate();
        bands.try_for_each_init(Vec::new, |codes, (band, to)| -> Result<()> {
            let y = region.y0 + first + band * BAND_ROWS;
            let (across, down) = (region.x0..region.x1, y..y + to.len() / width);
            let window = frame.window(rows_under(motion, &across, &down))?;
            codes.resize(to.len(), [0.0f32; 3]);
            resample_rows(&window, motion, across, down, codes);
            to.iter_mut().zip(codes.iter()).for_each(|(to, p)| *to = p.map(|v| (v + 0.5).clamp(0.0, 255.0) as u8));
            Ok(())
        })?;
        reduced.push(rows);
    }
    Ok(reduced.finish())
}
