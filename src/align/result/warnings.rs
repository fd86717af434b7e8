//! Warnings about an alignment: rejected and uncertain frames, and a small overlap.
//!
//! In: a bracket and the placement of each frame. Out: [`Warning`]s, and the largest rectangle that all aligned frames
//! cover. Cost: the [overlap](overlap::largest).

use crate::align::motion::Motion;
use crate::align::result::{Displaced, Estimate, Placement, Rect, RejectedBy, overlap};
use crate::align::transform::Transform;
use crate::bracket::Bracket;
use crate::error::{Error, Result, Warning};
use nalgebra::Matrix3;

/// A frame with less confidence than this, 0..=1, gets a warning.
const LOW_CONFIDENCE: f64 = 0.5;
/// There is a warning if the frames' common area is less than this share of the reference. For comparison: two frames
/// with the largest shifts that the bitmap search tries by default
/// ([`MtbOptions::max_shift`](crate::align::bitmaps::MtbOptions::max_shift), in opposite directions along the long
/// side) leave a share of 0.7.
const LEAST_OVERLAP: f64 = 0.5;

/// Returns the warnings about single frames.
pub(crate) fn of_frames(bracket: &Bracket, placements: &[Placement]) -> Vec<Warning> {
    let unaligned = placements.iter().find_map(|placement| match placement {
        Placement::Placed(Estimate { transform: Transform::Identity, reason, .. }) => reason.clone(),
        _ => None,
    });
    let nothing = |reason| Warning::NothingToAlign { reference: bracket.reference().path().into(), reason };
    let mut warnings: Vec<Warning> = unaligned.map(nothing).into_iter().collect();
    let is_still = placements.iter().filter_map(Placement::transform).all(|transform| transform == Transform::Identity);
    for (i, (frame, placement)) in bracket.frames().iter().zip(placements).enumerate() {
        let path = frame.path().to_path_buf();
        // The flash fired, but the frame is merged nevertheless, because its transform is preset.
        if frame.excluded.is_some() && placement.transform().is_some() {
            warnings.push(Warning::FlashFired { path: path.clone(), is_used: true });
        }
        match placement {
            Placement::Rejected { by: RejectedBy::Alignment, reason, .. } => {
                warnings.push(Warning::FrameRejected { path, reason: reason.clone().unwrap_or_default() });
            }
            Placement::Rejected { by: RejectedBy::Flash, .. } => {
                warnings.push(Warning::FlashFired { path, is_used: false });
            }
            Placement::Assumed(estimate) => warnings.push(Warning::FrameAssumed {
                path,
                reason: estimate.reason.clone().unwrap_or_default(),
                error_px: estimate.error_px.unwrap_or_default(),
                is_dark: i < bracket.reference_index(),
                is_still,
            }),
            Placement::Placed(Estimate { confidence, displaced, reason: None, .. }) if *confidence < LOW_CONFIDENCE => {
                let Displaced { fraction: displaced_fraction, px: displaced_px } = displaced.unwrap_or_default();
                warnings.push(Warning::LowConfidence {
                    path,
                    confidence: *confidence,
                    displaced_fraction,
                    displaced_px,
                });
            }
            Placement::Rejected { by: RejectedBy::User, .. } | Placement::Placed(_) | Placement::Reference => {}
        }
    }
    warnings
}

/// Returns the largest rectangle of the reference that all placed frames cover, and a warning if it is small.
pub(crate) fn common_overlap(bracket: &Bracket, motions: &[(usize, Motion)]) -> Result<(Rect, Option<Warning>)> {
    let (width, height) = (bracket.width(), bracket.height());
    // A frame covers a pixel at any depth if it covers it at the lowest and at the highest depth, because the edges of
    // the frame are straight.
    let placed: Vec<(usize, [Matrix3<f64>; 2])> = motions.iter().map(|(i, motion)| (*i, motion.extremes())).collect();
    let common = overlap::largest(&placed.iter().flat_map(|p| p.1).collect::<Vec<_>>(), width, height);
    let share = |rect: Rect| (rect.width() * rect.height()) as f64 / (width * height) as f64;
    // The frame whose largest rectangle covers the smallest share of the reference (the first, if several do), and this
    // share.
    let least = || {
        let shares =
            placed.iter().map(|(i, extremes)| (*i, overlap::largest(extremes, width, height).map_or(0.0, share)));
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
