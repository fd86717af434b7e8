//! TIFF files of displacements: two 32-bit floats per pixel.
//!
//! In: displacements (dx, dy) in pixels, by rows; NaN if unknown. Out: a [`Writer`] with two samples per pixel. Cost: see
//! [`super`]. Source: TIFF 6.0: the first sample is grey (section 4), and the second is an extra sample without a
//! meaning that TIFF knows (section 18).

use super::directory::tag;
use super::sample::Sample;
use super::strips::Strips;
use super::writer::Writer;
use crate::error::Result;
use crate::write::bands::Bands;
use crate::write::metadata::Metadata;
use crate::write::staging::Pending;

impl Writer<f32, 2> {
    /// Starts a file of displacements for a picture of `size` pixels, with `metadata`.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn displacements(file: Pending, size: (usize, usize), metadata: &Metadata) -> Result<Self> {
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
