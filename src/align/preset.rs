//! Preset transforms: given by the user for single frames, or by a file of transforms, instead of estimated.
//!
//! In: [`Preset`]s. Out: the verdicts on the frames of a bracket that they name. Cost: negligible.

use crate::align::result::{Status, Verdict};
use crate::align::transform::{corners, map};
use crate::bracket::Bracket;
use crate::error::{Error, Result};
use std::path::PathBuf;

/// A frame whose place is given.
#[derive(Debug, Clone, PartialEq)]
pub struct Preset {
    /// Its file, or the name of it.
    pub path: PathBuf,
    /// Its place.
    pub place: PresetTransform,
}

/// See [`Preset`].
#[derive(Debug, Clone, PartialEq)]
pub enum PresetTransform {
    /// None: excluded by the user.
    Excluded,
    /// That of the reference: the user states that it did not move.
    Unmoved,
    /// As it was found before.
    Known(Verdict),
}

impl PresetTransform {
    /// The verdict that this place is.
    pub(crate) fn verdict(&self) -> Verdict {
        match self {
            PresetTransform::Unmoved => Verdict::with_identity(Status::Unmoved),
            PresetTransform::Known(verdict) => verdict.clone(),
            PresetTransform::Excluded => Verdict {
                model: None,
                transform: None,
                reason: Some("left out, as was asked".into()),
                ..Verdict::with_identity(Status::Excluded)
            },
        }
    }
}

/// For every frame of `bracket` the verdict that is given, if one is; the first of several counts, and any before that
/// of a frame that is excluded by itself.
///
/// # Errors
/// [`Error::Option`] where the user names a file that is no frame, excludes the reference, or gives an invalid
/// transform.
pub(crate) fn verdicts(bracket: &Bracket, given: &[Preset]) -> Result<Vec<Option<Verdict>>> {
    let mut verdicts = vec![None; bracket.frames().len()];
    for Preset { path, place } in given {
        let option = match place {
            PresetTransform::Excluded => "--leave-out",
            PresetTransform::Unmoved => "--unmoved",
            PresetTransform::Known(_) => "--transforms",
        };
        let wrong = |reason: String| Error::Option { option, reason };
        let Some(i) = bracket.named(path) else {
            // A file of transforms may hold more frames than are merged now.
            if matches!(place, PresetTransform::Known(_)) {
                continue;
            }
            return Err(wrong(format!("{} is not among the photographs; name one of them", path.display())));
        };
        if let PresetTransform::Known(verdict) = place {
            check(verdict, (bracket.width(), bracket.height()))
                .map_err(|reason| wrong(format!("{}: {reason}", path.display())))?;
        }
        if i == bracket.reference_index() {
            if *place == PresetTransform::Excluded {
                let reason = format!("{} is the reference; choose another with --reference", path.display());
                return Err(wrong(reason));
            }
            continue;
        }
        verdicts[i].get_or_insert_with(|| place.verdict());
    }
    for (i, frame) in bracket.frames().iter().enumerate().filter(|(i, _)| *i != bracket.reference_index()) {
        if let (Some(reason), None) = (&frame.excluded, &verdicts[i]) {
            let verdict = PresetTransform::Excluded.verdict();
            verdicts[i] = Some(Verdict { status: Status::Flash, reason: Some(reason.clone()), ..verdict });
        }
    }
    Ok(verdicts)
}

/// Whether `verdict` can be of a frame of this size; if not, why. A camera sees no corner behind it, and nothing
/// mirrored.
pub(crate) fn check(verdict: &Verdict, (width, height): (usize, usize)) -> std::result::Result<(), String> {
    if !(0.0..=1.0).contains(&verdict.confidence) {
        return Err(format!("its confidence is {}, and not within 0..1", verdict.confidence));
    }
    let takes_part = verdict.status.rejected_by().is_none();
    let Some(transform) = verdict.transform else {
        return if takes_part { Err("it is to be merged, but has no homography".into()) } else { Ok(()) };
    };
    let h = transform.matrix(width, height);
    let is_seen = |&(x, y): &(f64, f64)| {
        let (u, v) = map(&h, x, y);
        h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)] > 0.0 && u.is_finite() && v.is_finite()
    };
    let is_sane =
        h.iter().all(|v| v.is_finite()) && h.determinant() > 0.0 && corners(width, height).iter().all(is_seen);
    match (takes_part, is_sane) {
        (true, true) => Ok(()),
        (true, false) => Err("its homography is none: nine finite numbers that keep the picture in front of the camera and do not mirror it".into()),
        (false, _) => Err("it is rejected, but has a place".into()),
    }
}
