//! Writing of radiance maps and pictures: every output is written to a temporary file, and all are renamed when all are
//! complete.
//!
//! In: pixels by rows, in order, in portions of any size, and the [`Metadata`] for the headers. Out: files. A path that
//! exists is a complete file; a failed run leaves nothing behind. Bands of 64 rows are encoded in parallel and written
//! in order, so the bytes do not depend on the number of threads. Cost: see each format; the commit waits for the disk
//! (fsync).
//!
//! Each module uses only those before it: `deflate`, `staging`, `bands`, `metadata`, `row_writer`, `format`, `exif`,
//! then the formats (`exr`, `hdr`, `tiff`, `png`, `jpeg`), `picture`, `aligned`, `files`.

pub(crate) mod aligned;
mod bands;
mod deflate;
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
    /// Options for `.jpg`.
    pub jpeg: jpeg::Options,
    /// Options for pictures.
    pub picture: picture::Options,
}

impl Options {
    /// Checks that `outputs` can be written with these options.
    ///
    /// # Errors
    /// [`Error::Option`] for an option that is out of range, not supported by a format, or for pictures if there is
    /// none.
    pub fn check(&self, outputs: &[Output]) -> Result<()> {
        self.jpeg.validate()?;
        self.picture.check(outputs, self.jpeg.gain_map)
    }
}

/// Writes all `paths`, radiance or picture by extension, to temporary files that [`commit`] renames.
///
/// # Errors
/// [`Error::UnknownExtension`]; [`Error::Option`] for options that an 8-bit picture does not support;
/// [`Error::Write`]. No files remain.
pub fn write(
    paths: &[PathBuf],
    radiance: &RadianceMap,
    display: &DisplayImage,
    metadata: &Metadata,
    options: &Options,
) -> Result<Vec<Written>> {
    if options.picture != picture::Options::default() {
        let reason = "the picture is written as it is given, with 8 bits; other picture options need `pipeline::run` or `pipeline::tonemap_file`".to_owned();
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
