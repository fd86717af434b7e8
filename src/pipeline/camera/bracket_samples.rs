//! Samples of the brackets of one camera, one after the other.
//!
//! In: the photographs of each bracket. Out: for each bracket its section of the report, and samples of its flat
//! places. The number of samples is limited, so that the samples of all brackets fit into memory. Cost: loading and
//! aligning.

use super::super::stages::Run;
use super::super::threads::in_pool;
use super::super::{Watch, check_placed};
use super::{BracketReport, Options, PATCHES};
use crate::align::preset::Preset;
use crate::bracket::Capture;
use crate::error::{Error, Result, Warning};
use crate::merge::miniature::Miniature;
use crate::pipeline::files::curves;
use crate::pipeline::stages::reference::Aligned;
use crate::pipeline::stages::response::processing;
use crate::report::Report;
use crate::response::ratios::{self, Exposures};
use crate::response::samples::Places;
use std::path::PathBuf;

/// The data of a bracket that are kept, without its frames.
pub(super) struct BracketSamples {
    /// The file of the reference.
    pub path: PathBuf,
    pub capture: Capture,
    pub places: Places,
    /// Pixels for measuring the error of response files whose format stores a curve only approximately; `None` if no
    /// such file is written.
    pub miniature: Option<Miniature>,
    pub report: BracketReport,
}

/// Returns the data of all `brackets` that can be used; there is at least one.
///
/// # Errors
/// The error of the first bracket that cannot be used. If `lenient` is set, such brackets are skipped instead, and the
/// errors are [`Error::NoResponse`] if no bracket is left, and [`Error::Scratch`] and [`Error::Cancelled`], which are
/// not the fault of a bracket.
pub(super) fn collect(
    brackets: &[Vec<PathBuf>],
    options: &Options,
    watch: Watch,
) -> Result<(Vec<BracketSamples>, Vec<Warning>)> {
    let most = PATCHES / brackets.len().max(1);
    let mut collected = Vec::with_capacity(brackets.len());
    let mut found_given = 0;
    let (mut warnings, mut left_out) = (Vec::new(), Vec::new());
    for paths in brackets {
        match one(paths, brackets.len(), options, watch) {
            Ok((mut bracket, given, found)) => {
                bracket.places.thin(most);
                found_given += given;
                warnings.extend(found);
                collected.push(bracket);
            }
            Err(error) if options.lenient && !matches!(error, Error::Scratch { .. } | Error::Cancelled) => {
                let path = paths.first().cloned().unwrap_or_default();
                left_out.push(Warning::BracketLeftOut { path, reason: error.to_string() });
            }
            Err(error) => return Err(error),
        }
    }
    if collected.is_empty() {
        let Some(Warning::BracketLeftOut { path, reason }) = left_out.into_iter().next() else {
            return Err(Error::TooFewFrames { given: 0 });
        };
        let reason = format!("none of the {} brackets can be used; the first one: {reason}", brackets.len());
        return Err(Error::NoResponse { path, reason });
    }
    if left_out.is_empty() && found_given < options.pipeline.align.given.len() {
        let reason =
            "a photograph that is given with one of these options is in none of the brackets; correct its name"
                .to_owned();
        return Err(Error::Option { option: "--leave-out or --unmoved", reason });
    }
    warnings.extend(left_out);
    warnings.extend(differing_cameras(&collected));
    Ok((collected, warnings))
}

/// Processes the bracket `paths`, one of `brackets` brackets. Returns also the number of transforms that the user gave
/// for its frames, and its warnings.
fn one(
    paths: &[PathBuf],
    brackets: usize,
    options: &Options,
    watch: Watch,
) -> Result<(BracketSamples, usize, Vec<Warning>)> {
    let mut own = options.pipeline.clone();
    let mut run = Run::new(&options.pipeline, watch);
    let bracket = run.load(paths, &own.aligning())?;
    if brackets > 1 {
        own.align.given.retain(|given: &Preset| bracket.named(&given.path).is_some());
    }
    let mut run = run.with_options(&own);
    let (aligned, mut places) = in_pool(bracket.threads(), || {
        let aligned = run.align(bracket)?;
        check_placed(&aligned)?;
        let places = Places::of(&aligned.bracket, &aligned.alignment)?;
        Ok((aligned, places))
    })?;
    let Aligned { mut bracket, alignment, .. } = aligned;
    let mut warnings = run.warnings;
    if own.exposures == Exposures::FineTuned {
        let (tuned, more) = ratios::fine_tuned(bracket, &mut places);
        warnings.extend(more);
        bracket = tuned;
    }
    if processing(&bracket, &places, &own).is_some_and(|evidence| evidence.is_local) {
        return Err(Error::LocallyProcessed { path: bracket.reference().path().to_owned() });
    }
    let miniature = curves::miniature(&options.curves, &bracket, &alignment, brackets)?;
    let Report { reference, frames, .. } = Report::new(&bracket, &alignment, alignment.overlap);
    let first = bracket.reference();
    let (path, capture) = (first.path().to_owned(), first.capture.clone());
    let collected = BracketSamples { path, capture, places, miniature, report: BracketReport { reference, frames } };
    Ok((collected, own.align.given.len(), warnings))
}

fn differing_cameras(collected: &[BracketSamples]) -> Vec<Warning> {
    let name = |bracket: &BracketSamples| bracket.capture.camera();
    let Some(kept) = collected.first().and_then(name) else { return Vec::new() };
    let others = collected.iter().filter_map(|bracket| Some((bracket, name(bracket)?)));
    let others = others.filter(|(_, found)| *found != kept);
    others
        .map(|(bracket, found)| Warning::CamerasDiffer { path: bracket.path.clone(), found, kept: kept.clone() })
        .collect()
}
