//! Writing of radiance maps and pictures: every output is written to a temporary file, and all are renamed when all are complete.
//!
//! In: pixels by rows, in order, in portions of any size, and the [`Metadata`] for the headers. Out: files. A path that exists is a complete
//! file; a failed run leaves nothing behind. Bands of 64 rows are encoded in parallel and written in order, so the bytes do not depend on
//! the number of threads. Cost: see each format; the commit waits for the disk (fsync).
//!
//! Each module uses only those before it: `deflate`, `staging`, `bands`, `metadata`, `row_writer`, `format`, `exif`, then the formats (`exr`, `hdr`,
//! `tiff`, `png`, `jpeg`), `picture`, `aligned`, `files`.

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

/// How results are written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Whether files that exist are replaced. No by default.
    pub overwrite: bool,
    /// How OpenEXR is encoded.
    pub exr: exr::Options,
    /// What the pixels of `.hdr` are.
    pub hdr: hdr::Encoding,
    /// What the pixels of a radiance `.tif` are.
    pub tiff: tiff::Encoding,
    /// How `.jpg` is encoded.
    pub jpeg: jpeg::Options,
    /// How pictures are made.
    pub picture: picture::Options,
}

impl Options {
    /// Whether `outputs` can be written like this.
    ///
    /// # Errors
    /// [`Error::Option`] for the option that is out of its range, that a format cannot follow, or that is for pictures where there is none.
    pub fn check(&self, outputs: &[Output]) -> Result<()> {
        self.jpeg.validate()?;
        self.picture.check(outputs, self.jpeg.gain_map)
    }
}

/// Writes all of `paths`, the radiance or the picture by extension, to temporary files that [`commit`] renames.
///
/// # Errors
/// [`Error::UnknownExtension`]; [`Error::Option`] for what a picture of 8 bits cannot give; [`Error::Write`]. Nothing is left behind then.
pub fn write(
    paths: &[PathBuf],
    radiance: &RadianceMap,
    display: &DisplayImage,
    metadata: &Metadata,
    options: &Options,
) -> Result<Vec<Written>> {
    if options.picture != picture::Options::default() {
        let reason = "the picture is there already, of 8 bits; `tonemap` and `merge` make others".to_owned();
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
