//! What is doubtful of a response: whether it is of another camera, whether the frames contradict it, and whether they have one at all.
//!
//! In: a saved response, or the flat places of a bracket. Out: warnings, and what the places tell of local processing. Cost: some milliseconds.

use super::Options;
use crate::align::AlignMode;
use crate::bracket::{Bracket, Capture};
use crate::error::{Result, Warning};
use crate::response::file::SavedResponse;
use crate::response::local::{Evidence, evidence};
use crate::response::samples::Places;
use crate::response::{self, ResponseCurve};
use std::path::Path;

/// What there is to say of the response `saved` in the file `path` where the photographs of `capture` are of another camera; where one of
/// them does not say its own, nothing.
pub(super) fn differing_response(path: &Path, saved: &SavedResponse, capture: &Capture) -> Option<Warning> {
    let found = saved.camera()?;
    let kept = capture.camera()?;
    let detail = format!("is the response of {found}, and the photographs were taken by {kept}");
    (found != kept).then(|| Warning::ResponseDoubtful { path: path.to_owned(), detail })
}

/// What there is to say of the curve in the file `path` where the photographs contradict it, or any curve (`is_local`).
pub(super) fn contradicted_response(
    path: &Path,
    curve: &ResponseCurve,
    places: &Places,
    is_local: bool,
) -> Result<Option<Warning>> {
    let told = |(found, own)| {
        let detail = match is_local {
            true => format!(
                "the frames are locally processed: they contradict this response by {found:.2} stops, as they do any"
            ),
            false => {
                format!("the frames contradict this response by {found:.2} stops, and one of their own by {own:.2}")
            }
        };
        Warning::ResponseDoubtful { path: path.to_owned(), detail }
    };
    Ok(response::contradiction(curve, places)?.map(told))
}

/// What `places` of `bracket` tell of local processing; none where the user states a curve, for that is taken at its word, and where frames are not aligned: they
/// may lie elsewhere, and differ from place to place by that.
pub(super) fn processing(bracket: &Bracket, places: &Places, options: &Options) -> Option<Evidence> {
    let may_be_local = options.response.is_sought() && options.align.mode != AlignMode::None;
    let longer_side = bracket.width().max(bracket.height());
    if may_be_local { evidence(places, longer_side) } else { None }
}
