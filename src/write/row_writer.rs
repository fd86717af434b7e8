//! What every output format implements: rows in, in order, then the end of the file.
//!
//! In: rows of pixels. Out: a [`Written`]. Cost: see each format.

use super::staging::Written;
use crate::error::Result;
use crate::plane::Plane;

/// What every output format implements: rows in, in order, then the end. `P` is the pixel.
///
/// Bands may arrive as they are merged while several writers run; a writer encodes what it is given in parallel before it returns.
/// A writer that is dropped unfinished leaves nothing behind.
pub trait RowWriter<P>: Send {
    /// Takes the next complete rows, without gaps: any number of them, `rows.len()` a multiple of the width.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write) when the encoder or the disk fails.
    ///
    /// # Panics
    /// When a row is incomplete or there are more than the picture has: an error of the caller, never of a file.
    fn push(&mut self, rows: &[P]) -> Result<()>;

    /// Ends the file after its last row.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write) when the disk fails or rows are missing.
    fn finish(self: Box<Self>) -> Result<Written>;
}

/// All of `plane` through `writer`.
///
/// # Errors
/// Those of the writer.
pub fn push_all<P>(mut writer: Box<dyn RowWriter<P> + '_>, plane: &Plane<P>) -> Result<Written> {
    writer.push(plane.as_slice())?;
    writer.finish()
}
