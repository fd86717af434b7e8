//! Blessing: what there is becomes what is expected.
//!
//! In: two names. Out: a copy, byte for byte, in place of the file expected, or of none. Cost: that of a copy and an fsync.
//!
//! The copy is written beside its target and renamed: whoever reads the name has the old file or the new one, and never a part of it. Nobody
//! may read it who might not read the file replaced, or else the file copied.

use super::input::{Input, Pixels};
use crate::error::{Error, Result, Warning};
use crate::intake;
use crate::limits::Limits;
use crate::write::{self, Target};
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

/// Copies the file `actual` over the file `expected`, which need not exist; and what should be known about it. `actual` must be one that can be
/// compared.
///
/// # Errors
/// Those of reading `actual`; [`Error::Option`] where the extensions name different formats; [`Error::Write`].
pub fn bless(expected: &Path, actual: &Path, limits: &Limits) -> Result<(Blessed, Vec<Warning>)> {
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
    let warnings = not_numbers(&input, actual).into_iter().collect();
    let is_there = expected.exists();
    if is_there && fs::read(expected).is_ok_and(|there| there == bytes) {
        return Ok((Blessed::Unchanged, warnings));
    }
    // A link stays one: what it points to is replaced.
    let target = fs::canonicalize(expected).unwrap_or_else(|_| expected.to_owned());
    write::check_targets(&Target::of("--bless", std::slice::from_ref(&target)), &[], true)?;
    let copy = write::complete(&target, &bytes)?;
    copy.restrict(actual)?;
    write::rename_all(vec![copy], true)?;
    Ok((if is_there { Blessed::Replaced } else { Blessed::Created }, warnings))
}

/// The warning that pixels of `input`, the file `path`, are not finite numbers, where some are not.
fn not_numbers(input: &Input, path: &Path) -> Option<Warning> {
    let Pixels::Radiance(map, _) = &input.pixels else { return None };
    let pixels = map.pixels.as_slice();
    let count = pixels.iter().filter(|pixel| pixel.iter().any(|v| !v.is_finite())).count();
    let which = if count == pixels.len() { "all".to_owned() } else { format!("{count} of {}", pixels.len()) };
    let detail = format!(
        "{which} pixels hold values that are not finite numbers (NaN, infinity), which are expected from now on; if they are an error, make the \
         file again and bless that"
    );
    (count > 0).then(|| Warning::Metadata { path: path.to_owned(), detail })
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
