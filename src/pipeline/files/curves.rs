//! Response files written by a run, and the accuracy that is lost if frames are merged with these files.
//!
//! In: a curve, and a [`Miniature`] (some thousand pixels) of each bracket from which it was recovered. Out: the
//! files, complete but not yet named, with their warnings. Cost: two merges of some thousand pixels for each format
//! that does not represent a curve exactly.

use crate::align::Alignment;
use crate::bracket::Bracket;
use crate::error::Result;
use crate::merge::miniature::{self, Miniature};
use crate::response::file::{Format, SavedResponse};
use crate::write::{self, Written};
use std::path::{Path, PathBuf};

/// Numbers of pixels for which the loss of accuracy is computed: in all brackets together, and at least in each single
/// bracket. The first number is so large that one percent of these pixels is still 160 pixels.
const PIXELS: (usize, usize) = (16384, 256);

/// Returns pixels of `bracket` (one of `brackets` brackets) from which the accuracy lost by the files `paths` is
/// computed; `None` if the formats of all these files are exact.
pub(crate) fn miniature(
    paths: &[PathBuf],
    bracket: &Bracket,
    alignment: &Alignment,
    brackets: usize,
) -> Result<Option<Miniature>> {
    let is_lossy = |path: &PathBuf| Format::of(path).is_ok_and(|format| format != Format::Json);
    let pixels = (PIXELS.0 / brackets).max(PIXELS.1);
    if !paths.iter().any(is_lossy) {
        return Ok(None);
    }
    Miniature::of(bracket, alignment, pixels)
}

/// Writes the curve `saved`, which was recovered from brackets with these `miniatures`, to the file `path`.
///
/// # Errors
/// Those of [`SavedResponse::encode`] and of writing; [`Error::ResponseFormat`](crate::error::Error::ResponseFormat) if
/// radiance merged with this file would not be even roughly right.
pub(crate) fn written(saved: &SavedResponse, path: &Path, miniatures: &[&Miniature]) -> Result<Written> {
    let encoded = saved.encode(path)?;
    let warning = match encoded.curve == saved.curve {
        true => None,
        false => miniature::loss(miniatures, &saved.curve, &encoded.curve)?.warning(path)?,
    };
    let mut written = write::text(path, &encoded.text)?;
    written.warnings.extend(warning);
    Ok(written)
}
