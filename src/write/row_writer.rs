//! The interface of output formats: rows in order, then the end of the file.
//!
//! In: rows of pixels. Out: a [`Written`]. Cost: see each format.

use super::staging::Written;
use crate::error::Result;
use crate::plane::Plane;

/// The interface of output formats: rows in order, then the end. `P` is the pixel.
///
/// Rows may be pushed while later rows are still being merged, and several writers may run at the same time. `push`
/// encodes its rows on several threads and returns when they are encoded. No file remains if the writer is dropped
/// before the end.
pub trait RowWriter<P>: Send {
    /// Adds the next complete rows, in order: any number of them, with `rows.len()` a multiple of the width.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write) if encoding or writing fails.
    ///
    /// # Panics
    /// If a row is incomplete, or there are more rows than the picture has. This is a mistake of the caller and is
    /// never caused by a file.
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
