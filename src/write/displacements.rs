//! Writes the displacement of every pixel in every merged frame, as TIFF.
//!
//! In: a bracket and its alignment. Out: one file per frame, named `PREFIX` followed by the name of the frame, with two
//! floats for each pixel of the reference: where the frame shows the pixel, minus the position of the pixel. NaN if
//! the frame does not show it. Cost: a few operations for each pixel of each frame.

use super::aligned::{self, BANDS_AT_ONCE};
use super::metadata::Metadata;
use super::row_writer::RowWriter;
use super::staging::{Pending, Written};
use super::tiff;
use crate::align::{Alignment, Motion};
use crate::bracket::{Bracket, Frame};
use crate::error::Result;
use crate::plane::BAND_ROWS;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Returns the paths of the displacements of `images`.
///
/// # Errors
/// [`Error::Option`](crate::error::Error::Option) if two frames would have the same path.
pub fn names(prefix: &Path, images: &[PathBuf]) -> Result<Vec<PathBuf>> {
    aligned::names("--displacements", prefix, images)
}

/// Writes the displacements of every merged frame of `bracket` but the reference, with the `metadata` of the frame.
///
/// # Errors
/// [`Error::Write`](crate::error::Error::Write).
pub fn write(
    bracket: &Bracket,
    alignment: &Alignment,
    prefix: &Path,
    metadata: impl Fn(&Frame) -> Metadata,
) -> Result<Vec<Written>> {
    let (width, height) = (bracket.width(), bracket.height());
    let mut files = Vec::new();
    for (_, frame, motion) in alignment.placed(bracket).filter(|(i, ..)| *i != bracket.reference_index()) {
        let file = Pending::create(&aligned::name(prefix, frame.path()))?;
        let mut writer = Box::new(tiff::Writer::displacements(file, (width, height), &metadata(frame))?);
        let mut rows = vec![[0.0f32; 2]; width * height.min(BANDS_AT_ONCE * BAND_ROWS)];
        for first in (0..height).step_by(BANDS_AT_ONCE * BAND_ROWS) {
            let rows = &mut rows[..width * (height - first).min(BANDS_AT_ONCE * BAND_ROWS)];
            rows.par_chunks_exact_mut(width).enumerate().for_each(|(i, row)| {
                for (x, to) in row.iter_mut().enumerate() {
                    *to = displacement(&motion, x, first + i);
                }
            });
            writer.push(rows)?;
        }
        files.push(writer.finish()?);
    }
    Ok(files)
}

/// The displacement of the pixel (x, y); NaN if the frame does not show it.
fn displacement(motion: &Motion, x: usize, y: usize) -> [f32; 2] {
    let (x, y) = (x as f64, y as f64);
    motion.seen(x, y).map_or([f32::NAN; 2], |(u, v)| [(u - x) as f32, (v - y) as f32])
}
