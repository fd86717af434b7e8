//! Writes radiance maps and pictures. Every output goes to a temporary file; the temporary files are renamed once all
//! of them are complete.
//!
//! In: pixels by rows, in order, in portions of any size, and the [`Metadata`] for the headers. Out: files. A file
//! under its final name is complete; a failed run removes its temporary files. Bands of 64 rows are encoded in
//! parallel and written in order, so the bytes do not depend on the number of threads. Cost: see each format; before
//! the files are renamed, the run waits until they are on the disk (fsync).
//!
//! Each module uses only those before it: `deflate`, `staging`, `bands`, `metadata`, `row_writer`, `format`, `exif`,
//! then the formats (`exr`, `hdr`, `tiff`, `dng`, `png`, `jpeg`), `picture`, `aligned`, `files`.

pub(crate) mod aligned;
mod bands;
mod deflate;
pub(crate) mod displacements;
pub mod dng;
mod exif;
pub mod exr;
mod files;
mod format;
pub mod hdr;
pub mod jpeg;
mod metadata;
pub mod picture;
pub(crate) mod png;
mod row_writer;
mod staging;
pub mod tiff;

use crate::error::{Error, Result};
use crate::merge::RadianceMap;
use crate::tonemap::DisplayImage;
use std::path::PathBuf;

pub(crate) use files::{Codes, Files, Settled};
pub use format::{Format, Output};
pub use metadata::Metadata;
#[doc(hidden)]
pub use row_writer::{RowWriter, push_all};
#[doc(hidden)]
pub use staging::{
    CompleteFile, NewFolder, Pending, Target, Written, abandon, bytes, check_targets, commit, complete, rename_all,
    sweep, text,
};

/// Options for result files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Whether existing files are replaced; false by default.
    pub overwrite: bool,
    /// Options for OpenEXR.
    pub exr: exr::Options,
    /// Pixel encoding of `.hdr`.
    pub hdr: hdr::Encoding,
    /// Pixel encoding of a radiance `.tif`.
    pub tiff: tiff::Encoding,
    /// Pixel encoding of `.dng`.
    pub dng: dng::Encoding,
    /// Options for `.jpg`.
    pub jpeg: jpeg::Options,
    /// Options for pictures.
    pub picture: picture::Options,
}

impl Options {
    /// Checks that `outputs` can be written with these options.
    ///
    /// # Errors
    /// [`Error::Option`] for a value that is out of range, for an option that a format does not support, and for a
    /// picture option if no picture is written.
    pub fn check(&self, outputs: &[Output]) -> Result<()> {
        self.jpeg.validate()?;
        self.picture.check(outputs, self.jpeg.gain_map)
    }
}

/// Writes all `paths` to temporary files, which [`commit`] renames. The extension of a path decides whether it
/// receives the radiance or the picture.
///
/// # Errors
/// [`Error::UnknownExtension`]; [`Error::Option`] for picture options other than the default; [`Error::Write`]. After
/// an error, no files remain.
pub fn write(
    paths: &[PathBuf],
    radiance: &RadianceMap,
    display: &DisplayImage,
    metadata: &Metadata,
    options: &Options,
) -> Result<Vec<Written>> {
    if options.picture != picture::Options::default() {
        let reason = "`write::write` supports only the default picture options: it writes the given picture unchanged, with 8 bits; for other options, use `pipeline::run` or `pipeline::tonemap_file`".to_owned();
        return Err(Error::Option { option: "--bit-depth", reason });
    }
    let outputs = Output::results(paths)?;
    let metadata = Metadata { primaries: radiance.primaries, ..metadata.clone() };
    let size = (radiance.pixels.width(), radiance.pixels.height());
    let settled = Settled::of(&outputs, radiance, display, options)?;
    let mut files = Files::begin(&outputs, size, &metadata, options, settled)?;
    let rows = radiance.pixels.as_slice();
    files.push(rows, rows, Codes::Eight(display.pixels.as_slice()))?;
    files.finish()
}
