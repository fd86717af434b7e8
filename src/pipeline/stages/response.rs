//! Response: corrects the exposures, and determines the response of the camera.
//!
//! In: an aligned bracket, and a saved response, if given. Out: a [`Camera`], and warnings if the saved response is of
//! another camera, if the frames contradict it, or if no curve fits the frames. Cost: sampling the frames and fitting
//! the curve, some tenths of a second.

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
use crate::response::{self, ResponseCurve, ResponseModel, ResponseReport};
use std::path::Path;

/// The response, and data about it.
pub(crate) struct Camera {
    pub curve: ResponseCurve,
    pub report: ResponseReport,
    /// Evidence of local processing (tone mapping in the camera that differs between parts of a frame); `None` if it
    /// was not evaluated.
    evidence: Option<Evidence>,
}

impl Camera {
    /// Whether frames are locally processed.
    pub fn is_local(&self) -> bool {
        self.evidence.as_ref().is_some_and(|evidence| evidence.is_local)
    }

    /// Returns the report's section on local processing, with the `gain` used for merging.
    pub fn local_report(&self, gain: Option<&LocalGain>) -> Option<LocalReport> {
        self.evidence.as_ref().map(|evidence| LocalReport::of(evidence, gain))
    }
}

/// Corrects the exposures of the bracket, if requested, and determines its response.
pub(crate) fn find(
    aligned: Aligned,
    saved: Option<SavedResponse>,
    options: &Options,
) -> Result<(Aligned, Camera, Vec<Warning>)> {
    let Aligned { bracket, alignment, region } = aligned;
    let model = model(&bracket, options);
    let is_tuned = options.exposures == Exposures::FineTuned;
    let is_recovered = saved.is_none() && model.is_recovered();
    let is_needed = is_tuned || is_recovered || saved.is_some() || options.save_response.is_some();
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
            let fallback = Some("the frames are locally processed, and no curve fits them".to_owned());
            (curve, ResponseReport { model: "srgb", fallback, ..ResponseReport::default() })
        }
        Some(saved) => {
            let path = options.response_file.as_deref().unwrap_or(Path::new(""));
            warnings.extend(differing_response(path, &saved, &bracket.reference().capture, is_local));
            warnings.extend(contradicted_response(path, &saved.curve, &places, is_local)?);
            (saved.curve, ResponseReport { model: "file", ..ResponseReport::default() })
        }
        None => {
            let (curve, report, more) = response::recover_from(&[&places], &model)?;
            warnings.extend(more);
            (curve, report)
        }
    };
    // A response from a file is accepted: the frames are merged with it, even if they are locally processed.
    let evidence = evidence.filter(|_| report.model != "file");
    Ok((Aligned { bracket, alignment, region }, Camera { curve, report, evidence }, warnings))
}

/// The model of the response: that of the options, or sRGB for raw files, which are encoded with it.
fn model(bracket: &Bracket, options: &Options) -> ResponseModel {
    if bracket.reference().is_raw() { ResponseModel::Srgb } else { options.response.clone() }
}

/// Returns a warning if the response `saved` in the file `path` is of another camera than `capture`; `None` if one of
/// the two cameras is not known.
fn differing_response(path: &Path, saved: &SavedResponse, capture: &Capture, is_local: bool) -> Option<Warning> {
    let found = saved.camera()?;
    let kept = capture.camera()?;
    let remedy = remedy(is_local);
    let detail = format!("is the response of {found}, but the photographs were taken with {kept}; {remedy}");
    (found != kept).then(|| Warning::ResponseDoubtful { path: path.to_owned(), detail })
}

/// Returns a warning if the photographs contradict the curve in the file `path`. With `is_local`, the warning says
/// that they contradict any other curve, too.
fn contradicted_response(
    path: &Path,
    curve: &ResponseCurve,
    places: &Places,
    is_local: bool,
) -> Result<Option<Warning>> {
    let warning = |(found, own)| {
        let remedy = remedy(is_local);
        let detail = match is_local {
            true => format!(
                "does not fit the frames (error {found:.2} stops), and no other response does, because the frames are \
                 locally processed; {remedy}"
            ),
            false => format!(
                "does not fit the frames (error {found:.2} stops); a response recovered from the frames fits better \
                 (error {own:.2} stops); {remedy}"
            ),
        };
        Warning::ResponseDoubtful { path: path.to_owned(), detail }
    };
    Ok(response::contradiction(curve, places)?.map(warning))
}

/// Returns what to do if a response file does not fit the photographs. From locally processed frames no response can be
/// recovered.
fn remedy(is_local: bool) -> &'static str {
    match is_local {
        true => "omit --response or --shared-response, so that hdralign undoes the camera's local tone mapping",
        false => {
            "recover the response of the photographs with `hdralign response`, or omit --response or --shared-response"
        }
    }
}

/// Returns the evidence of local processing from `places` of `bracket`. `None` if the user chose a linear or sRGB
/// curve, and if frames are not aligned, because then differences between places may be due to the camera's motion.
pub(crate) fn processing(bracket: &Bracket, places: &Places, options: &Options) -> Option<Evidence> {
    let may_be_local = model(bracket, options).is_recovered() && options.align.mode != AlignMode::None;
    let longer_side = bracket.width().max(bracket.height());
    if may_be_local { evidence(places, longer_side) } else { None }
}
