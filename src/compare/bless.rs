//! Blessing: replaces the expected file by the actual one.
//!
//! In: two paths. Out: a copy of the actual file, byte for byte, in place of the expected file, which need not exist.
//! Cost: a copy and an fsync.
//!
//! The copy is written beside its target and renamed, so that readers get either the old file or the complete new one.
//! A copy that replaces a file gets the permissions of that file. A new file gets no permission that the actual file
//! does not have.

use super::input::{Input, Pixels};
use crate::error::{Error, Result, Warning};
use crate::intake;
use crate::limits::Limits;
use crate::write::{self, Target};
use std::fs;
use std::path::Path;

/// What [`bless`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blessed {
    /// The expected file did not exist and was created.
    Created,
    /// The expected file was replaced.
    Replaced,
    /// The files were identical; nothing was written.
    Unchanged,
}

/// Copies the file `actual` to the file `expected`, which need not exist. `actual` must be a file that can be compared.
/// Also returns warnings.
///
/// # Errors
/// Those of reading `actual`; [`Error::Option`] if the extensions belong to different formats; [`Error::Write`].
pub fn bless(expected: &Path, actual: &Path, limits: &Limits) -> Result<(Blessed, Vec<Warning>)> {
    let input = Input::open(actual, limits)?;
    if format(expected) != format(actual) {
        let reason = format!(
            "files are copied byte by byte, but {} and {} have different formats; use one extension for both",
            expected.display(),
            actual.display()
        );
        return Err(Error::Option { option: "--bless", reason });
    }
    let bytes = intake::whole(actual, limits.most_bytes())?;
    input.stamp.check()?;
    let warnings = not_numbers(&input, actual).into_iter().collect();
    let exists = expected.exists();
    if exists && fs::read(expected).is_ok_and(|old| old == bytes) {
        return Ok((Blessed::Unchanged, warnings));
    }
    // A symbolic link is kept; the file that it points to is replaced.
    let target = fs::canonicalize(expected).unwrap_or_else(|_| expected.to_owned());
    write::check_targets(&Target::of("--bless", std::slice::from_ref(&target)), &[], true)?;
    let copy = write::complete(&target, &bytes)?;
    copy.restrict(actual)?;
    write::rename_all(vec![copy], true)?;
    Ok((if exists { Blessed::Replaced } else { Blessed::Created }, warnings))
}

/// Returns a warning if `input`, which was read from the file `path`, has pixels that are not finite numbers.
fn not_numbers(input: &Input, path: &Path) -> Option<Warning> {
    let Pixels::Radiance(map, _) = &input.pixels else { return None };
    let pixels = map.pixels.as_slice();
    let count = pixels.iter().filter(|pixel| pixel.iter().any(|v| !v.is_finite())).count();
    let which = if count == pixels.len() { "all".to_owned() } else { format!("{count} of {}", pixels.len()) };
    let detail = format!(
        "{which} pixels have values that are not finite numbers (NaN, infinity); they are part of the expected file now. If they are an error, \
         create the file again and repeat --bless"
    );
    (count > 0).then(|| Warning::Metadata { path: path.to_owned(), detail })
}

/// Returns the extension in lower case, with one spelling for formats that have two.
fn format(path: &Path) -> String {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match extension.as_str() {
        "jpeg" => "jpg".into(),
        "tiff" => "tif".into(),
        "pic" => "hdr".into(),
        _ => extension,
    }
}
