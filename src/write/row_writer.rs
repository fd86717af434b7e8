//! The interface of output formats: rows in order, then the end of the file.
//!
//! In: rows of pixels. Out: a [`Written`]. Cost: see each format.

use super::staging::Written;
use crate::error::Result;
use crate::plane::Plane;

/// The interface of output formats: rows in order, then the end. `P` is the pixel.
///
/// Rows may arrive while they are merged, and several writers may run at the same time. A writer encodes its rows in
/// parallel before it returns. No file remains if the writer is dropped before the end.
pub trait RowWriter<P>: Send {
    /// Adds the next complete rows, in order: any number of them, with `rows.len()` a multiple of the width.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write) if encoding or writing fails.
    ///
    /// # Panics
    /// If a row is incomplete, or there are more rows than the picture has: an error of the caller, never of a file.
    fn push(&mut self, rows: &[P]) -> Result<()>;

    /// Ends the file after its last row.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write) if writing fails or rows are missing.
    fn finish(self: Box<Self>) -> Result<Written>;
}

/// Writes all of `plane` with `writer`.
///
/// # Errors
/// Those of the writer.
pub fn push_all<P>(mut writer: Box<dyn RowWriter<P> + '_>, plane: &Plane<P>) -> Result<Written> {
    writer.push(plane.as_slice())?;
    writer.finish()
}
