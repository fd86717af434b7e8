//! Staging: files get their final names once all files of a run are complete.
//!
//! In: the paths of outputs, and bytes. Out: files under all of these paths, or under none. [`check_targets`] runs
//! before any work is done. A [`Pending`] is a temporary file in the folder of its target; [`commit()`] renames all
//! files of a run. Cost: one fsync for each file.
//!
//! Each file uses only those before it: `anonymous`, `claim`, `temporary`, `complete`, `targets`, `commit`.

mod anonymous;
mod claim;
mod commit;
mod complete;
mod targets;
mod temporary;

use crate::error::{Result, Warning};
use std::path::Path;

pub use claim::sweep;
pub use commit::{CompleteFile, Pending, commit, rename_all};
pub use targets::{Target, check_targets};
pub use temporary::{NewFolder, abandon};

/// A file to which the last byte has been written, and which waits for [`commit()`].
#[derive(Debug)]
pub struct Written {
    /// The file.
    pub file: Pending,
    /// Warnings about its values.
    pub warnings: Vec<Warning>,
}

impl Written {
    /// Starts to sync `file`, to which the last byte has been written, and returns without waiting for the sync.
    pub(crate) fn ended(mut file: Pending, warnings: Vec<Warning>) -> Result<Self> {
        file.sync_ahead()?;
        Ok(Written { file, warnings })
    }
}

/// Writes `text` to a temporary file for `path`, to be committed by [`commit()`].
///
/// # Errors
/// [`Error::Write`](crate::error::Error::Write).
pub fn text(path: &Path, text: &str) -> Result<Written> {
    bytes(path, text.as_bytes())
}

/// Writes `bytes` to a temporary file for `path`, as [`text`] does.
///
/// # Errors
/// [`Error::Write`](crate::error::Error::Write).
pub fn bytes(path: &Path, bytes: &[u8]) -> Result<Written> {
    let mut file = Pending::create(path)?;
    file.put(bytes)?;
    Written::ended(file, Vec::new())
}

/// Writes `bytes` to a complete, synced file for `path`, to be renamed by [`rename_all`].
///
/// # Errors
/// [`Error::Write`](crate::error::Error::Write).
pub fn complete(path: &Path, bytes: &[u8]) -> Result<CompleteFile> {
    let mut file = Pending::create(path)?;
    file.put(bytes)?;
    file.complete()
}

/// Returns a warning that `count` values of `file` were out of range, or no warning if `count` is 0. `what` is the
/// rest of the message after the count.
pub(crate) fn clamped(file: &Pending, count: u64, what: &str) -> Vec<Warning> {
    let warning = Warning::OutOfRange { path: file.target().to_owned(), detail: format!("{count} values {what}") };
    if count > 0 { vec![warning] } else { Vec::new() }
}
