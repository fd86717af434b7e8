//! The TIFF writer for displacements: two 32-bit floats per pixel.
//!
//! In: displacements (dx, dy) in pixels, by rows; NaN if unknown. Out: a TIFF, as written by [`super::writer`], but with
//! two samples per pixel. Cost: see [`super`]. Source: TIFF 6.0: the first sample is grey (section 4), and the second is
//! an extra sample without a meaning that TIFF knows (section 18).

use super::directory::tag;
use super::sample::Sample;
use super::strips::Strips;
use super::writer::pack;
use crate::error::Result;
use crate::write::bands::Bands;
use crate::write::metadata::Metadata;
use crate::write::row_writer::RowWriter;
use crate::write::staging::{Pending, Written};

/// The writer for displacements.
#[derive(Debug)]
pub struct Writer {
    strips: Strips,
    bands: Bands<[f32; 2], Vec<u8>>,
}

impl Writer {
    /// Starts a file for a picture of `size` pixels, with `metadata`.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn new(file: Pending, size: (usize, usize), metadata: &Metadata) -> Result<Self> {
        let mut strips = Strips::begin(file, size, 2, 64)?;
        let directory = &mut strips.directory;
        directory.short(tag::BITS, &[32; 2]);
        directory.short(tag::COMPRESSION, &[8]);
        directory.short(tag::PHOTOMETRIC, &[1]);
        directory.short(tag::PREDICTOR, &[f32::PREDICTOR]);
        directory.short(tag::EXTRA_SAMPLES, &[0]);
        directory.short(tag::SAMPLE_FORMAT, &[f32::FORMAT; 2]);
        directory.capture(metadata);
        Ok(Writer { strips, bands: Bands::new(size) })
    }
}

impl RowWriter<[f32; 2]> for Writer {
    fn push(&mut self, rows: &[[f32; 2]]) -> Result<()> {
        let Writer { strips, bands } = self;
        let width = bands.width;
        bands.push(
            rows,
            |_, pixels, raw, out| pack(pixels, width, raw, out),
            |strip, packed| {
                packed.map_err(|e| strips.file.error(e))?;
                strips.put(strip)
            },
        )
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        self.bands.complete().map_err(|e| self.strips.file.error(e))?;
        Written::ended(self.strips.end()?, Vec::new())
    }
}
