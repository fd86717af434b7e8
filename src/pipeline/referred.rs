//! Alignment, and to which frame.
//!
//! In: a bracket. Out: its alignment, to the reference that it has or, where that fails, to another. Cost: that of the alignment; where half
//! of the frames or more cannot be placed, up to three times as much.
//!
//! The reference that is chosen by itself is the frame that sees the most. Where that is a stray of another scene, one that was saved
//! mirrored, or one that someone walked through, it is the reference that is wrong and not all others. Of those that could not be placed
//! beside it the one that sees the most is tried, and taken where more are surely placed beside that. A reference of the user's choice stays.

use super::Options;
use crate::align;
use crate::align::preset::PresetTransform;
use crate::align::{AlignMode, Alignment, Placement};
use crate::bracket::{Bracket, ReferenceChoice};
use crate::error::{Result, Warning};

/// References that are tried beside the first.
const OTHERS: usize = 2;
/// Frames count for another reference that are placed beside it with this confidence: where parallax leaves every place in doubt, the frame that
/// sees the most is still the best to look from.
const SURE: f64 = 0.8;
/// ... and where the first is left alone, with this.
const LIKELY: f64 = 0.5;

/// Aligns `bracket`, which comes back with the reference that it was aligned to.
///
/// # Errors
/// Those of [`align::align`].
pub(super) fn align(mut bracket: Bracket, options: &Options) -> Result<(Bracket, Alignment, Vec<Warning>)> {
    let (mut alignment, mut warnings) = align::align(&bracket, &options.align)?;
    if !is_open(options) {
        return Ok((bracket, alignment, warnings));
    }
    // Who was placed beside one of the references is no stray by itself.
    let mut done: Vec<bool> = left_out(&bracket, options);
    for _ in 0..OTHERS {
        let placed = count(&alignment, 0.0);
        let among = bracket.frames().len() - left_out(&bracket, options).iter().filter(|&&out| out).count();
        // Of two, neither says which is the stray.
        if among < 3 || 2 * placed > among {
            break;
        }
        mark(&bracket, &alignment, &mut done);
        let Some(other) = bracket.best_of(|i| !done[i]) else { break };
        let first = bracket.reference_index();
        bracket = bracket.with_reference(other);
        let (found, said) = align::align(&bracket, &options.align)?;
        let least = if placed > 1 { SURE } else { LIKELY };
        if count(&found, least) > placed {
            (alignment, warnings) = (found, said);
        } else {
            mark(&bracket, &found, &mut done);
            bracket = bracket.with_reference(first);
        }
    }
    Ok((bracket, alignment, warnings))
}

/// Whether the reference is ours to choose, and frames are judged at all.
fn is_open(options: &Options) -> bool {
    let is_ours = matches!(options.load.reference, ReferenceChoice::Auto | ReferenceChoice::AutoExcept(_));
    is_ours
        && options.align.mode == AlignMode::Auto
        && options.align.given.iter().all(|given| given.place == PresetTransform::Excluded)
}

/// Which frames are left out: those that the user names, and those that are excluded by themselves.
fn left_out(bracket: &Bracket, options: &Options) -> Vec<bool> {
    let mut out: Vec<bool> = bracket.frames().iter().map(|frame| frame.excluded.is_some()).collect();
    options.align.given.iter().filter_map(|given| bracket.named(&given.path)).for_each(|i| out[i] = true);
    out
}

/// How many frames take part, with the reference, of which the place is known with `least` confidence.
fn count(alignment: &Alignment, least: f64) -> usize {
    let is_sure = |placement: &&Placement| placement.transform().is_some() && placement.confidence() >= least;
    alignment.placements.iter().filter(is_sure).count()
}

fn mark(bracket: &Bracket, alignment: &Alignment, done: &mut [bool]) {
    alignment.placed(bracket).for_each(|(i, ..)| done[i] = true);
}
