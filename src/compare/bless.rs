//! Blessing: what there is becomes what is expected.
//!
//! In: two names. Out: a copy, byte for byte, in place of the file expected, or of none. Cost: that of a copy and an fsync.
//!
//! The copy is written beside its target and renamed: whoever reads the name has the old file or the new one, and never a part of it.

use super::input::Input;
use crate::error::{Error, Result};
use crate::intake;
use crate::limits::Limits;
use crate::write;
use std::fs;
use std::path::Path;

/// What was done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blessed {
    /// There was no such file.
    Created,
    /// The file was replaced.
    Replaced,
    /// The files were the same to the byte; nothing was done.
    Unchanged,
}

/// Copies the file `actual` over the file `expected`, which need not exist. `actual` must be one that can be compared.
///
/// # Errors
/// Those of reading `actual`; [`Error::Option`] where the extensions name different formats; [`Error::Write`].
pub fn bless(expected: &Path, actual: &Path, limits: &Limits) -> Result<Blessed> {
    let input = Input::open(actual, limits)?;
    if format(expected) != format(actual) {
        let reason = format!(
            "copies bytes, and {} and {} are of different formats; give them one extension",
            expected.display(),
            actual.display()
        );
        return Err(Error::Option { option: "--bless", reason });
    }
    let bytes = intake::whole(actual, limits.most_bytes())?;
    input.check_unchanged()?;
    let is_there = expected.exists();
    if is_there && fs::read(expected).is_ok_and(|there| there == bytes) {
        return Ok(Blessed::Unchanged);
    }
    // A link stays one: what it points to is replaced.
    let target = fs::canonicalize(expected).unwrap_or_else(|_| expected.to_owned());
    write::check_targets(std::slice::from_ref(&target), &[], true)?;
    write::place(vec![write::whole(&target, &bytes)?], true)?;
    Ok(if is_there { Blessed::Replaced } else { Blessed::Created })
}

/// The extension, and one name for those that have two.
fn format(path: &Path) -> String {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match extension.as_str() {
        "jpeg" => "jpg".into(),
        "tiff" => "tif".into(),
        "pic" => "hdr".into(),
        _ => extension,
    }
}
