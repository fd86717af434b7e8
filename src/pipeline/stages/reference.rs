//! The stage of alignment: to the reference of the bracket or, where that fails, to another frame.
//!
//! In: a bracket. Out: its alignment, and the bracket with the reference of that. Cost: that of the alignment; where
//! half of the frames or more cannot be placed, up to three times as much.
//!
//! The reference that is chosen automatically is the frame with the most pixels that are neither clipped nor black.
//! Where that frame is of another scene, was saved mirrored, or someone walked through it, all others are rejected
//! although it is the reference that is wrong. The best of the rejected frames is tried as the reference then, and
//! stays it where more frames are placed with confidence. A reference that the user chose stays.

use crate::align;
use crate::align::preset::PresetTransform;
use crate::align::{AlignMode, Alignment, Rect};
use crate::bracket::{Bracket, ReferenceChoice};
use crate::error::{Result, Warning};
use crate::pipeline::Options;

/// A bracket, its alignment, and the part of the reference that the results show.
pub(crate) struct Aligned {
    pub bracket: Bracket,
    pub alignment: Alignment,
    pub region: Rect,
}

/// References that are tried beside the first.
const OTHERS: usize = 2;
/// Confidence with which frames must be placed to count for another reference: where parallax makes every transform
/// uncertain, the first reference is still the best.
const SURE: f64 = 0.8;
/// ... where no frame is placed with the first.
const LIKELY: f64 = 0.5;

/// Aligns `bracket`, which comes back with the reference that it was aligned to.
///
/// # Errors
/// Those of [`align::align`].
pub(crate) fn align(mut bracket: Bracket, options: &Options) -> Result<(Bracket, Alignment, Vec<Warning>)> {
    let (mut alignment, mut warnings) = align::align(&bracket, &options.align)?;
    if !is_open(options) {
        return Ok((bracket, alignment, warnings));
    }
    // A frame that was placed with one reference is of the same scene as that, and is not tried itself.
    let mut done: Vec<bool> = excluded(&bracket, options);
    for _ in 0..OTHERS {
        let placed = count(&bracket, &alignment, 0.0);
        let among = bracket.frames().len() - excluded(&bracket, options).iter().filter(|&&out| out).count();
        // Of two, nothing tells which is of another scene.
        if among < 3 || 2 * placed > among {
            break;
        }
        mark(&bracket, &alignment, &mut done);
        let Some(other) = bracket.best_of(|i| !done[i]) else { break };
        let first = bracket.reference_index();
        bracket = bracket.with_reference(other);
        let (found, found_warnings) = align::align(&bracket, &options.align)?;
        let least = if placed > 1 { SURE } else { LIKELY };
        if count(&bracket, &found, least) > placed {
            (alignment, warnings) = (found, found_warnings);
        } else {
            mark(&bracket, &found, &mut done);
            bracket = bracket.with_reference(first);
        }
    }
    Ok((bracket, alignment, warnings))
}

/// Whether the reference is chosen automatically, and frames can be rejected.
fn is_open(options: &Options) -> bool {
    let is_ours = matches!(options.load.reference, ReferenceChoice::Auto | ReferenceChoice::AutoExcept(_));
    is_ours
        && options.align.mode == AlignMode::Auto
        && options.align.given.iter().all(|given| given.place == PresetTransform::Excluded)
}

/// The frames that are excluded: by the user, or because of the flash.
fn excluded(bracket: &Bracket, options: &Options) -> Vec<bool> {
    let mut out: Vec<bool> = bracket.frames().iter().map(|frame| frame.excluded.is_some()).collect();
    options.align.given.iter().filter_map(|given| bracket.named(&given.path)).for_each(|i| out[i] = true);
    out
}

/// The number of frames that are placed with `least` confidence, with the reference.
fn count(bracket: &Bracket, alignment: &Alignment, least: f64) -> usize {
    alignment.placed(bracket).filter(|(i, ..)| alignment.placements[*i].confidence() >= least).count()
}

/// Marks the frames that are placed.
fn mark(bracket: &Bracket, alignment: &Alignment, done: &mut [bool]) {
    alignment.placed(bracket).for_each(|(i, ..)| done[i] = true);
}
