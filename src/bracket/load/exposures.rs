//! Chooses the exposures of a bracket: from EXIF where it is consistent, else from the pixels.
//!
//! In: exposure tags and brightness of all frames. Out: an [`Exposure`] for each frame, and warnings. Cost: usually
//! one or more estimates of [`brightness`] for each pair of neighbours, also if EXIF is complete.
//!
//! EXIF is checked frame by frame. An exposure in EXIF is used if it is consistent with the exposures of the other
//! frames. If it is missing or contradicts them, the step from another frame is estimated from the pixels. That frame
//! is the one with the nearest exposure among the frames whose EXIF is used.

use super::super::exposure::{self, Exposure};
use super::Picture;
use crate::bracket::exposure::brightness::{self, Brightness, Estimate};
use crate::bracket::load::copies::{self, Copied};
use crate::error::{Error, Result, Warning};

/// Uncertainty, in stops, of an exposure that is assumed to be that of another frame: the usual step of a bracket.
const ASSUMED_STOPS: f64 = 2.0;

/// Returns the exposures of `pictures`, in their order. Excluded frames are not used to check or estimate others.
pub(super) fn settle(
    pictures: &mut [Picture],
    copies: &[Copied],
    warnings: &mut Vec<Warning>,
) -> Result<Vec<Exposure>> {
    let tags: Vec<_> = pictures.iter().map(|p| p.tags).collect();
    let (by_tags, assumed) = exposure::by_tags(&tags);
    // Sorted by path, so that the result does not depend on the order of the command line.
    let mut order: Vec<usize> = (0..pictures.len()).filter(|&i| pictures[i].excluded.is_none()).collect();
    order.sort_by(|&a, &b| pictures[a].path.cmp(&pictures[b].path));
    let with_exif: Vec<usize> = order.iter().copied().filter(|&i| by_tags[i].is_some()).collect();
    let missing: Vec<usize> = (0..pictures.len()).filter(|i| order.contains(i) && !with_exif.contains(i)).collect();

    let mut written = vec![f64::NAN; pictures.len()];
    with_exif.iter().for_each(|&i| written[i] = by_tags[i].as_ref().map_or(f64::NAN, Exposure::ev));
    let seen = |frames: &[usize]| -> Vec<&Brightness> { frames.iter().map(|&i| &pictures[i].brightness).collect() };
    let (exif_evs, exif_brightness) = (with_exif.iter().map(|&i| written[i]).collect::<Vec<_>>(), seen(&with_exif));
    let contradiction =
        copies::contradiction(copies, &written).or_else(|| brightness::contradiction(&exif_evs, &exif_brightness));
    let accepted: Vec<usize> = match contradiction.as_ref().map(|_| brightness::at_odds(&exif_evs, &exif_brightness)) {
        None => with_exif.clone(),
        Some(Some(odd)) => (0..with_exif.len()).filter(|k| !odd.contains(k)).map(|k| with_exif[k]).collect(),
        Some(None) => Vec::new(),
    };

    let mut exposures = by_tags;
    if accepted.len() < order.len() {
        let what = contradiction.clone().unwrap_or_else(|| match missing.len() {
            1 => format!("{} has no usable exposure in its EXIF", pictures[missing[0]].path.display()),
            n => format!("{n} of {} files have no usable exposure in their EXIF", pictures.len()),
        });
        let unknown = |reason: &str| match missing.first() {
            Some(&first) => Error::NoExposure {
                path: pictures[first].path.clone(),
                reason: format!("it has no usable exposure in its EXIF, and {reason}"),
            },
            None => Error::NoExposure {
                path: pictures[order[0]].path.clone(),
                reason: format!("the exposures in the EXIF data contradict the pixels ({what}), and {reason}"),
            },
        };
        // If all files are copies of one photograph, their true exposures are equal, and no estimate is needed.
        let is_one = missing.is_empty() && copies.len() + 1 == pictures.len();
        let estimate = match is_one {
            true => Some(Estimate::alike(order.len())),
            false => brightness::estimate(&seen(&order)),
        };
        let estimate = estimate
            .ok_or_else(|| unknown("the exposures cannot be estimated from the pixels, because the frames are too dark, too bright or have too few tones"))?;
        if accepted.is_empty() && brightness::all_alike(&estimate.evs) && !is_one {
            return Err(unknown("the frames are equally bright"));
        }
        let places = Places::new(&order, &estimate.evs, &written, &accepted);
        for (at, &i) in order.iter().enumerate().filter(|(_, i)| !accepted.contains(i)) {
            let (from, anchor) = places.anchor(at);
            let estimated = Exposure::estimated(estimate.evs[at] + anchor, estimate.deviation(at, from));
            exposures[i] =
                Some(estimated.ok_or_else(|| unknown("the exposures cannot be calculated from the pixels"))?);
        }
        let uncertainty = estimate.uncertainty();
        let mut by_step = estimate.evs;
        by_step.sort_by(f64::total_cmp);
        let listed: Vec<String> = by_step.iter().map(|step| format!("{step:.1}")).collect();
        let odd = with_exif.iter().filter(|&i| !accepted.is_empty() && !accepted.contains(i));
        let odd: Vec<String> = odd.map(|&i| pictures[i].path.display().to_string()).collect();
        let odd =
            if odd.is_empty() { String::new() } else { format!("; the exposure of {} is ignored", odd.join(", ")) };
        let detail =
            format!("{what}{odd}; the estimates are {} EV, ± {:.0} %", listed.join(", "), 100.0 * uncertainty.abs());
        warnings.push(match contradiction {
            Some(_) => Warning::ExposureContradicted { detail },
            None => Warning::ExposureEstimated { detail },
        });
    }
    // An excluded frame is merged only if the user presets its transform. If such a frame has no usable exposure in its
    // EXIF, its exposure is estimated from the pixels. If the pixels give no estimate, the frame gets the exposure of
    // another frame: of the frames that are not excluded, the first in the order of paths.
    let evs: Vec<f64> = exposures.iter().map(|exposure| exposure.as_ref().map_or(f64::NAN, Exposure::ev)).collect();
    for i in (0..pictures.len()).filter(|&i| evs[i].is_nan()) {
        let all: Vec<usize> = order.iter().copied().chain([i]).collect();
        let estimated = brightness::estimate(&seen(&all)).and_then(|estimate| {
            let at = all.len() - 1;
            let (from, anchor) = Places::new(&all, &estimate.evs, &evs, &order).anchor(at);
            Exposure::estimated(estimate.evs[at] + anchor, estimate.deviation(at, from))
        });
        let assumed = || Exposure::estimated(evs[*order.first()?], ASSUMED_STOPS);
        exposures[i] = estimated.or_else(assumed);
    }
    for (i, detail) in assumed.into_iter().filter(|(i, _)| accepted.contains(i)) {
        let path = pictures[i].path.clone();
        pictures[i].warnings.push(Warning::ExposureIncomplete { path, detail });
    }
    Ok(exposures.into_iter().flatten().collect())
}

/// Combines the exposures estimated from the pixels (`steps`), which have an arbitrary common offset, with exposures
/// known from EXIF.
struct Places<'a> {
    steps: &'a [f64],
    /// For each frame whose exposure in EXIF is used, its index in `steps`, and the EV to add to its step to get this
    /// exposure. If there is no such frame, `known` has one entry. It is then the frame with the median EV to add among
    /// the frames that have an exposure in EXIF, or, if none has one, the frame with the median step, whose exposure
    /// becomes 0 EV.
    known: Vec<(usize, f64)>,
}

impl<'a> Places<'a> {
    fn new(order: &[usize], steps: &'a [f64], written: &[f64], accepted: &[usize]) -> Self {
        let places = order.iter().enumerate().map(|(at, &i)| (i, (at, written[i] - steps[at])));
        let mut known: Vec<(usize, f64)> =
            places.clone().filter(|(i, _)| accepted.contains(i)).map(|(_, place)| place).collect();
        if known.is_empty() {
            let mut places: Vec<(usize, f64)> =
                places.map(|(_, place)| place).filter(|(_, add)| add.is_finite()).collect();
            if places.is_empty() {
                places = steps.iter().map(|&step| -step).enumerate().collect();
            }
            places.sort_by(|a, b| a.1.total_cmp(&b.1));
            known.push(places[places.len() / 2]);
        }
        Places { steps, known }
    }

    /// Returns the entry of `known` whose step is nearest to the step of the frame `at` (an index in `steps`): the
    /// entry's index in `steps`, and the EV to add to the step of `at`.
    fn anchor(&self, at: usize) -> (usize, f64) {
        let off = |place: &(usize, f64)| (self.steps[place.0] - self.steps[at]).abs();
        let nearest = self.known.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.copied().unwrap_or((at, 0.0))
    }
}
