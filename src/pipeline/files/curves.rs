//! Response files that a run writes, and what merging with them would lose.
//!
//! In: a curve, and a [`Miniature`] of each bracket that it was recovered from. Out: the files, whole but not yet named, with their warnings.
//! Cost: two merges of some thousand pixels for each format that does not hold a whole curve.

use crate::align::Alignment;
use crate::bracket::Bracket;
use crate::error::Result;
use crate::merge::miniature::{self, Miniature};
use crate::response::file::{Format, SavedResponse};
use crate::write::{self, Written};
use std::path::{Path, PathBuf};

/// Pixels over which a loss is taken, of all brackets together, and the fewest of one: of a hundredth of the pixels there are still 160.
const PIXELS: (usize, usize) = (16384, 256);

/// What tells the loss of the files `paths` by one of `brackets` brackets; none where the formats hold all.
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

/// The file `path` of the curve `saved`, which was recovered from brackets of which these are `miniatures`.
///
/// # Errors
/// Those of [`SavedResponse::encode`] and of writing; [`Error::ResponseFormat`](crate::error::Error::ResponseFormat) where nothing like the
/// radiance can be merged with it.
pub(crate) fn written(saved: &SavedResponse, path: &Path, miniatures: &[&Miniature]) -> Result<Written> {
    let encoded = saved.encode(path)?;
    let warning = match encoded.curve == saved.curve {
        true => None,
        false => miniature::loss(miniatures, &saved.curve, &encoded.curve)?.judged(path)?,
    };
    let mut written = write::text(path, &encoded.text)?;
    written.warnings.extend(warning);
    Ok(written)
}
