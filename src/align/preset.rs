//! Preset transforms: those that are not estimated, but given by the user for single frames, or read from a file of
//! transforms.
//!
//! In: [`Preset`]s, each of which names a frame. Out: the placements of these frames of a bracket. Cost: negligible.

use crate::align::result::{FeatureCounts, Found, Placement, RejectedBy};
use crate::align::transform::{Transform, corners, map};
use crate::bracket::Bracket;
use crate::error::{Error, Result};
use std::path::PathBuf;

/// A frame whose transform is preset.
#[derive(Debug, Clone, PartialEq)]
pub struct Preset {
    /// The path of the frame's file, or only the file's name.
    pub path: PathBuf,
    /// What is preset: a transform, or the exclusion of the frame.
    pub place: PresetTransform,
}

/// The preset transform of a frame.
#[derive(Debug, Clone, PartialEq)]
pub enum PresetTransform {
    /// The frame is excluded by the user.
    Excluded,
    /// The user states that the frame did not move.
    Unmoved,
    /// A placement that was estimated earlier, with the numbers of keypoints and inliers.
    Known(Box<Placement>, FeatureCounts),
}

impl PresetTransform {
    /// Returns the placement, and the numbers of keypoints and inliers if they are known.
    pub(crate) fn found(&self) -> Found {
        let placement = match self {
            PresetTransform::Known(placement, features) => return (Placement::clone(placement), *features),
            PresetTransform::Unmoved => Placement::by_user(Transform::Identity),
            PresetTransform::Excluded => Placement::excluded(RejectedBy::User, "excluded by the user".into()),
        };
        (placement, FeatureCounts::default())
    }
}

/// Returns the preset placement of each frame of `bracket`, if there is one.
///
/// If a frame has several presets, the first is used. A preset overrides the exclusion of a frame in which the flash
/// fired.
///
/// # Errors
/// [`Error::Option`] if the user names a file that is not a frame of `bracket`, excludes the reference, or gives an
/// invalid transform.
pub(crate) fn given(bracket: &Bracket, given: &[Preset]) -> Result<Vec<Option<Found>>> {
    let mut found = vec![None; bracket.frames().len()];
    for Preset { path, place } in given {
        let option = match place {
            PresetTransform::Excluded => "--leave-out",
            PresetTransform::Unmoved => "--unmoved",
            PresetTransform::Known(..) => "--transforms",
        };
        let wrong = |reason: String| Error::Option { option, reason };
        let Some(i) = bracket.named(path) else {
            // A file of transforms may contain frames that are not in this bracket.
            if matches!(place, PresetTransform::Known(..)) {
                continue;
            }
            return Err(wrong(format!("{} is not among the photographs; name one of them", path.display())));
        };
        if let PresetTransform::Known(placement, _) = place {
            check(placement, (bracket.width(), bracket.height()))
                .map_err(|reason| wrong(format!("{}: {reason}", path.display())))?;
        }
        if i == bracket.reference_index() {
            if *place == PresetTransform::Excluded {
                let reason = format!("{} is the reference; choose another with --reference", path.display());
                return Err(wrong(reason));
            }
            continue;
        }
        found[i].get_or_insert_with(|| place.found());
    }
    for (i, frame) in bracket.frames().iter().enumerate().filter(|(i, _)| *i != bracket.reference_index()) {
        if let (Some(reason), None) = (&frame.excluded, &found[i]) {
            found[i] = Some((Placement::excluded(RejectedBy::Flash, reason.clone()), FeatureCounts::default()));
        }
    }
    Ok(found)
}

/// Checks whether `placement` is possible for a frame of this size.
///
/// The confidence must be within 0..=1. All corners must be in front of the camera, and the picture must not be
/// mirrored.
///
/// # Errors
/// The reason, in words.
pub(crate) fn check(placement: &Placement, (width, height): (usize, usize)) -> std::result::Result<(), String> {
    let confidence = placement.confidence();
    if !(0.0..=1.0).contains(&confidence) {
        return Err(format!("its confidence is {confidence}, which is not within 0..1"));
    }
    let Some(transform) = placement.transform() else { return Ok(()) };
    let h = transform.matrix(width, height);
    let is_seen = |&(x, y): &(f64, f64)| {
        let (u, v) = map(&h, x, y);
        h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)] > 0.0 && u.is_finite() && v.is_finite()
    };
    let is_sane =
        h.iter().all(|v| v.is_finite()) && h.determinant() > 0.0 && corners(width, height).iter().all(is_seen);
    if is_sane {
        return Ok(());
    }
    Err("its homography is invalid: its nine numbers must be finite, and it must not mirror the picture, flatten it to \
         a line, or tilt it so far that a corner lies beyond the horizon; copy the numbers from a file that hdralign wrote"
        .into())
}
