//! Selects one file for each shot. A camera may write a raw file and a JPEG of one shot, and the photographer may add
//! a TIFF.
//!
//! In: the files and their headers. Out: the photographs, one file for each shot, and the files that are not used.
//! Cost: negligible. Source: DCF 2.0, section 4.4: files that differ only in their extension belong to one object.

use super::walk::{Candidate, Kind, Place};
use super::{LeftOver, Reason, Shot};
use crate::bracket::header::Header;
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// A photograph and the folder in which it was found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Placed {
    pub(super) shot: Shot,
    pub(super) place: Arc<Place>,
}

/// Two files with the same name are of one shot if their recorded times differ by at most this, in seconds. Small
/// differences occur because some programs truncate fractions of a second and others round them.
const ONE_SHOT_S: f64 = 2.0;

/// Returns the photographs among `files`, one for each shot, and adds all other files to `left_over`.
pub(super) fn photographs(
    files: Vec<(Candidate, Option<Result<Header>>)>,
    left_over: &mut Vec<LeftOver>,
) -> Vec<Placed> {
    let mut leave = |path: &Path, reason| left_over.push(LeftOver { path: path.into(), reason });
    let mut by_name: BTreeMap<(Arc<Place>, String), Vec<Placed>> = BTreeMap::new();
    let mut raws = Vec::new();
    for (candidate, header) in files {
        let stem = candidate.path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
        let Candidate { path, place, kind } = candidate;
        let name = (place.clone(), stem);
        match (kind, header) {
            (Kind::Raw, _) => raws.push((path, name)),
            (Kind::Other(format), _) => leave(&path, Reason::Format(format)),
            (Kind::Picture, None) => {}
            (Kind::Picture, Some(Err(error))) => {
                let reason = Reason::Unreadable(without_path(&error, &path));
                leave(&path, reason);
            }
            (Kind::Picture, Some(Ok(header))) if header.is_ours() => {
                leave(&path, Reason::Result(header.software.unwrap_or_default()));
            }
            (Kind::Picture, Some(Ok(header))) => {
                by_name.entry(name).or_default().push(Placed { shot: Shot { path, header }, place });
            }
        }
    }
    // Files with the same name are sorted so that the file to use comes first.
    for twins in by_name.values_mut() {
        twins.sort_by(|a, b| rank(&b.shot).cmp(&rank(&a.shot)).then_with(|| a.shot.path.cmp(&b.shot.path)));
    }
    for (path, name) in raws {
        let used = by_name.get(&name).and_then(|twins| twins.first());
        leave(&path, Reason::Raw(used.map(|used| used.shot.path.clone())));
    }
    let mut kept = Vec::new();
    for twins in by_name.into_values() {
        let mut twins = twins.into_iter();
        let Some(best) = twins.next() else { continue };
        for other in twins {
            if is_one_shot(&best.shot, &other.shot) {
                leave(&other.shot.path, Reason::Twin(best.shot.path.clone()));
            } else {
                kept.push(other);
            }
        }
        kept.push(best);
    }
    kept
}

/// Returns the rank of a file; the file with the larger rank is used. The rank compares first whether the exposure is
/// known, then the bit depth, then the format (DNG is better than TIFF, TIFF than PNG, PNG than JPEG).
fn rank(shot: &Shot) -> (bool, u8, u8) {
    let extension = shot.path.extension().unwrap_or_default().to_ascii_lowercase();
    let lossless = match extension.to_str() {
        Some("dng") => 3,
        Some("tif" | "tiff") => 2,
        Some("png") => 1,
        _ => 0,
    };
    (shot.header.ev().is_some(), shot.header.depth, lossless)
}

fn is_one_shot(a: &Shot, b: &Shot) -> bool {
    match (a.header.taken, b.header.taken) {
        (Some(a), Some(b)) => a.since(&b).abs() <= ONE_SHOT_S,
        _ => true,
    }
}

/// Returns the text of `error` without the path at its start, because the path is shown beside the text.
fn without_path(error: &Error, path: &Path) -> String {
    let words = error.to_string();
    words.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&words).to_owned()
}
