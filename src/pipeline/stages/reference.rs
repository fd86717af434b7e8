//! Alignment: to the reference of the bracket or, if that fails, to another frame.
//!
//! In: a bracket. Out: its alignment, and the bracket with the reference that was used. Cost: the alignment; up to
//! three times as much if at least half of the frames are rejected.
//!
//! By default the reference is the frame with the most pixels that are neither clipped nor black. If that frame shows
//! another scene, is mirrored, or somebody walked through it, all other frames are rejected although only the
//! reference is wrong. Then the best of the rejected frames is tried as the reference, and is used if more frames are
//! aligned to it with confidence. A reference chosen by the user is kept.

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

/// Largest number of other references that are tried after the first.
const OTHERS: usize = 2;
/// A frame counts in favour of another reference only if its confidence is at least this. If parallax makes every
/// transform uncertain, no frame counts, and the first reference, which is still the best one, is kept.
const SURE: f64 = 0.8;
/// Replaces [`SURE`] if no other frame is aligned to the current reference.
const LIKELY: f64 = 0.5;

/// Aligns `bracket`. Returns it with the reference to which it was aligned.
///
/// # Errors
/// Those of [`align::align`].
pub(crate) fn align(mut bracket: Bracket, options: &Options) -> Result<(Bracket, Alignment, Vec<Warning>)> {
    let (mut alignment, mut warnings) = align::align(&bracket, &options.align)?;
    if !is_open(options) {
        return Ok((bracket, alignment, warnings));
    }
    // A frame that was aligned to a reference shows the same scene as that reference. So it need not be tried as the
    // reference itself.
    let mut done: Vec<bool> = excluded(&bracket, options);
    for _ in 0..OTHERS {
        let placed = count(&bracket, &alignment, 0.0);
        let among = bracket.frames().len() - excluded(&bracket, options).iter().filter(|&&out| out).count();
        // If there are only two frames, it is not known which of them shows another scene.
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

/// Whether the reference is chosen automatically and, in addition, frames can be rejected.
fn is_open(options: &Options) -> bool {
    let is_ours = matches!(options.load.reference, ReferenceChoice::Auto | ReferenceChoice::AutoExcept(_));
    is_ours
        && options.align.mode == AlignMode::Auto
        && options.align.given.iter().all(|given| given.place == PresetTransform::Excluded)
}

/// Returns which frames are excluded by the user, or because of the flash.
fn excluded(bracket: &Bracket, options: &Options) -> Vec<bool> {
    let mut out: Vec<bool> = bracket.frames().iter().map(|frame| frame.excluded.is_some()).collect();
    options.align.given.iter().filter_map(|given| bracket.named(&given.path)).for_each(|i| out[i] = true);
    out
}

/// Returns the number of frames that are aligned with at least the confidence `least`, including the reference.
fn count(bracket: &Bracket, alignment: &Alignment, least: f64) -> usize {
    alignment.placed(bracket).filter(|(i, ..)| alignment.placements[*i].confidence() >= least).count()
}

/// Sets `done` for the frames that are aligned.
fn mark(bracket: &Bracket, alignment: &Alignment, done: &mut [bool]) {
    alignment.placed(bracket).for_each(|(i, ..)| done[i] = true);
}
