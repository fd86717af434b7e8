//! Warnings about an alignment: rejected and uncertain frames, and a small overlap.
//!
//! In: a bracket and the verdict on each frame. Out: [`Warning`]s; the largest rectangle that all aligned frames cover.
//! Cost: that of the [overlap](overlap::largest).

use crate::align::result::{Rect, Status, Verdict, overlap};
use crate::align::transform::Transform;
use crate::bracket::Bracket;
use crate::error::{Error, Result, Warning};

/// Confidence below which a frame has a warning.
const DOUBT: f64 = 0.5;
/// Share of the reference below which the overlap has a warning: most of the reference is lost. Two frames that lie as
/// far apart as the bitmaps seek ([`MtbOptions::max_shift`](crate::align::bitmaps::MtbOptions::max_shift) each
/// way along the long side) leave 0.7.
const LEAST_OVERLAP: f64 = 0.5;

/// The warnings of single frames.
pub(crate) fn of_frames(bracket: &Bracket, verdicts: &[Verdict]) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let unseen = verdicts.iter().filter(|v| v.status == Status::Unmoved).find_map(|v| v.reason.clone());
    warnings
        .extend(unseen.map(|reason| Warning::NothingToAlign { reference: bracket.reference().path().into(), reason }));
    let is_still = verdicts.iter().filter_map(|v| v.transform).all(|transform| transform == Transform::Identity);
    for (i, (frame, verdict)) in bracket.frames().iter().zip(verdicts).enumerate() {
        let path = frame.path().to_path_buf();
        // The user has set its transform.
        if frame.excluded.is_some() && verdict.transform.is_some() {
            warnings.push(Warning::FlashFired { path: path.clone(), is_used: true });
        }
        match verdict.status {
            Status::Rejected => {
                let reason = verdict.reason.clone().unwrap_or_default();
                warnings.push(Warning::FrameRejected { path, reason });
            }
            Status::Assumed => warnings.push(Warning::FrameAssumed {
                path,
                reason: verdict.reason.clone().unwrap_or_default(),
                error_px: verdict.error_px.unwrap_or_default(),
                is_dark: i < bracket.reference_index(),
                is_still,
            }),
            Status::Flash => warnings.push(Warning::FlashFired { path, is_used: false }),
            _ if verdict.confidence < DOUBT && verdict.reason.is_none() => {
                warnings.push(Warning::LowConfidence { path, confidence: verdict.confidence });
            }
            _ => {}
        }
    }
    warnings
}

/// The largest rectangle of the reference that all placed frames cover, and a warning where it is small.
pub(crate) fn common_overlap(bracket: &Bracket, verdicts: &[Verdict]) -> Result<(Rect, Option<Warning>)> {
    let (width, height) = (bracket.width(), bracket.height());
    let placed: Vec<(usize, Transform)> =
        verdicts.iter().enumerate().filter_map(|(i, v)| Some((i, v.transform?))).collect();
    let transforms: Vec<Transform> = placed.iter().map(|&(_, transform)| transform).collect();
    let common = overlap::largest(&transforms, width, height);
    let share = |rect: Rect| (rect.width() * rect.height()) as f64 / (width * height) as f64;
    // The frame that overlaps least by itself, and by how much; of equals the first.
    let least = || {
        let shares =
            placed.iter().map(|&(i, transform)| (i, overlap::largest(&[transform], width, height).map_or(0.0, share)));
        let (i, share) =
            shares.reduce(|least, other| if other.1 < least.1 { other } else { least }).unwrap_or_default();
        (bracket.frames()[i].path().to_path_buf(), share)
    };
    match common {
        Some(rect) if share(rect) >= LEAST_OVERLAP => Ok((rect, None)),
        Some(rect) => {
            let (path, overlap) = least();
            Ok((rect, Some(Warning::SmallOverlap { path, overlap, common: share(rect) })))
        }
        None => Err(Error::NoOverlap { path: least().0, reference: bracket.reference().path().to_path_buf() }),
    }
}
