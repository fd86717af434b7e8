//! The stage of the response: corrected exposures, and what code values mean.
//!
//! In: an aligned bracket, and a response that was saved before, if one is given. Out: a [`Camera`], and warnings where
//! the response is of another camera, the frames contradict it, or no curve explains them. Cost: that of sampling the
//! frames and of fitting the curve, some tenths of a second.

use crate::align::AlignMode;
use crate::bracket::{Bracket, Capture};
use crate::error::{Error, Result, Warning};
use crate::merge::local::{self, LocalGain, LocalReport};
use crate::pipeline::Options;
use crate::pipeline::stages::reference::Aligned;
use crate::response::file::SavedResponse;
use crate::response::local::{Evidence, evidence};
use crate::response::ratios::{self, Exposures};
use crate::response::samples::Places;
use crate::response::{self, ResponseCurve, ResponseReport};
use std::path::Path;

/// The response, and what was found on the way to it.
pub(crate) struct Camera {
    pub curve: ResponseCurve,
    pub report: ResponseReport,
    /// Whether frames are locally processed; none where that was not looked at.
    evidence: Option<Evidence>,
}

impl Camera {
    /// Whether frames are locally processed.
    pub fn is_local(&self) -> bool {
        self.evidence.as_ref().is_some_and(|evidence| evidence.is_local)
    }

    /// The report's section on local processing, with the `gain` that was merged with.
    pub fn local_report(&self, gain: Option<&LocalGain>) -> Option<LocalReport> {
        self.evidence.as_ref().map(|evidence| LocalReport::of(evidence, gain))
    }
}

/// Corrects the exposures of the bracket where that is asked for, and finds its response.
pub(crate) fn find(
    aligned: Aligned,
    saved: Option<SavedResponse>,
    options: &Options,
) -> Result<(Aligned, Camera, Vec<Warning>)> {
    let Aligned { bracket, alignment, region } = aligned;
    let is_tuned = options.exposures == Exposures::FineTuned;
    let is_sought = saved.is_none() && options.response.is_sought();
    let is_needed = is_tuned || is_sought || saved.is_some() || options.save_response.is_some();
    let mut places = if is_needed { Places::of(&bracket, &alignment)? } else { Places::default() };
    let (bracket, mut warnings) =
        if is_tuned { ratios::fine_tuned(bracket, &mut places) } else { (bracket, Vec::new()) };
    let evidence = processing(&bracket, &places, options);
    let is_local = evidence.is_some_and(|evidence| evidence.is_local);
    let (curve, report) = match saved {
        None if is_local => {
            if options.save_response.is_some() {
                return Err(Error::LocallyProcessed { path: bracket.reference().path().to_owned() });
            }
            let placed = alignment.placed(&bracket).map(|(_, frame, _)| frame.path().to_owned());
            warnings.push(Warning::LocallyProcessed { paths: placed.collect() });
            let curve = evidence.as_ref().map_or_else(ResponseCurve::srgb, local::curve);
            let fallback = Some("the frames are locally processed, which no curve explains".to_owned());
            (curve, ResponseReport { model: "srgb", fallback, ..ResponseReport::default() })
        }
        Some(saved) => {
            let path = options.response_file.as_deref().unwrap_or(Path::new(""));
            warnings.extend(differing_response(path, &saved, &bracket.reference().capture));
            warnings.extend(contradicted_response(path, &saved.curve, &places, is_local)?);
            (saved.curve, ResponseReport { model: "file", ..ResponseReport::default() })
        }
        None => {
            let (curve, report, more) = response::recover_from(&[&places], &options.response)?;
            warnings.extend(more);
            (curve, report)
        }
    };
    // A curve that is given is not doubted: the frames are merged as functions of exposure.
    let evidence = evidence.filter(|_| report.model != "file");
    Ok((Aligned { bracket, alignment, region }, Camera { curve, report, evidence }, warnings))
}

/// The warning of the response `saved` in the file `path` where the photographs of `capture` are of another camera; none
/// where one of them has no camera.
fn differing_response(path: &Path, saved: &SavedResponse, capture: &Capture) -> Option<Warning> {
    let found = saved.camera()?;
    let kept = capture.camera()?;
    let detail = format!("is the response of {found}, and the photographs were taken by {kept}");
    (found != kept).then(|| Warning::ResponseDoubtful { path: path.to_owned(), detail })
}

/// The warning of the curve in the file `path` where the photographs contradict it, or any curve (`is_local`).
fn contradicted_response(
    path: &Path,
    curve: &ResponseCurve,
    places: &Places,
    is_local: bool,
) -> Result<Option<Warning>> {
    let warning = |(found, own)| {
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
    Ok(response::contradiction(curve, places)?.map(warning))
}

/// Whether the frames are locally processed, by `places` of `bracket`. None where the user states a curve, which is not
/// doubted, and where frames are not aligned: these may differ from place to place because they moved.
pub(crate) fn processing(bracket: &Bracket, places: &Places, options: &Options) -> Option<Evidence> {
    let may_be_local = options.response.is_sought() && options.align.mode != AlignMode::None;
    let longer_side = bracket.width().max(bracket.height());
    if may_be_local { evidence(places, longer_side) } else { None }
}
