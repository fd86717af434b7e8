//! The exposures of a bracket: by EXIF where it can be believed, else by the pixels.
//!
//! In: what the files say and what they show. Out: an [`Exposure`] for each, and what there is to say about them. Cost: tables of 256 entries.
//!
//! EXIF is judged frame by frame: where one contradicts the others, or is missing, those that agree with each other are believed, and what is
//! left is estimated from the pixels, beside the nearest of them.

use super::super::exposure::{self, Exposure};
use super::Picture;
use crate::bracket::exposure::brightness::{self, Brightness, Estimate};
use crate::bracket::load::copies::{self, Copied};
use crate::error::{Error, Result, Warning};

/// The exposures of `pictures`, in their order. Those that are excluded say nothing of the others.
pub(super) fn settle(
    pictures: &mut [Picture],
    copies: &[Copied],
    warnings: &mut Vec<Warning>,
) -> Result<Vec<Exposure>> {
    let tags: Vec<_> = pictures.iter().map(|p| p.tags).collect();
    let (by_tags, assumed) = exposure::by_tags(&tags);
    // By path, so that ties and chains are the same in any order of the command line.
    let mut order: Vec<usize> = (0..pictures.len()).filter(|&i| pictures[i].excluded.is_none()).collect();
    order.sort_by(|&a, &b| pictures[a].path.cmp(&pictures[b].path));
    let said: Vec<usize> = order.iter().copied().filter(|&i| by_tags[i].is_some()).collect();
    let missing: Vec<usize> = (0..pictures.len()).filter(|i| order.contains(i) && !said.contains(i)).collect();

    let mut written = vec![f64::NAN; pictures.len()];
    said.iter().for_each(|&i| written[i] = by_tags[i].as_ref().map_or(f64::NAN, Exposure::ev));
    let seen = |frames: &[usize]| -> Vec<&Brightness> { frames.iter().map(|&i| &pictures[i].brightness).collect() };
    let (said_evs, said_seen) = (said.iter().map(|&i| written[i]).collect::<Vec<_>>(), seen(&said));
    let contradiction =
        copies::contradiction(copies, &written).or_else(|| brightness::contradiction(&said_evs, &said_seen));
    let believed: Vec<usize> = match contradiction.as_ref().map(|_| brightness::at_odds(&said_evs, &said_seen)) {
        None => said.clone(),
        Some(Some(odd)) => (0..said.len()).filter(|k| !odd.contains(k)).map(|k| said[k]).collect(),
        Some(None) => Vec::new(),
    };

    let mut exposures = by_tags;
    if believed.len() < order.len() {
        let what = contradiction.clone().unwrap_or_else(|| match missing.len() {
            1 => format!("{} does not say how it was exposed", pictures[missing[0]].path.display()),
            n => format!("{n} of {} files do not say how they were exposed", pictures.len()),
        });
        let unknown = |reason: &str| match missing.first() {
            Some(&first) => Error::NoExposure {
                path: pictures[first].path.clone(),
                reason: format!("it has no usable exposure in its EXIF, and {reason}"),
            },
            None => Error::NoExposure {
                path: pictures[order[0]].path.clone(),
                reason: format!("the exposures in the files contradict the pixels ({what}), and {reason}"),
            },
        };
        // Copies of one photograph were exposed as one, whatever it shows.
        let is_one = missing.is_empty() && copies.len() + 1 == pictures.len();
        let estimate = match is_one {
            true => Some(Estimate::alike(order.len())),
            false => brightness::estimate(&seen(&order)),
        };
        let estimate = estimate
            .ok_or_else(|| unknown("the pictures are too dark, too bright or too plain to tell it from the pixels"))?;
        if believed.is_empty() && brightness::all_alike(&estimate.evs) && !is_one {
            return Err(unknown("the pictures are equally bright"));
        }
        let places = Places::new(&order, &estimate.evs, &written, &believed);
        for (at, &i) in order.iter().enumerate().filter(|(_, i)| !believed.contains(i)) {
            let (from, anchor) = places.anchor(at);
            let estimated = Exposure::estimated(estimate.evs[at] + anchor, estimate.deviation(at, from));
            exposures[i] = Some(estimated.ok_or_else(|| unknown("the pixels give no usable number"))?);
        }
        let uncertainty = estimate.uncertainty();
        let mut by_step = estimate.evs;
        by_step.sort_by(f64::total_cmp);
        let listed: Vec<String> = by_step.iter().map(|step| format!("{step:.1}")).collect();
        let odd = said.iter().filter(|&i| !believed.is_empty() && !believed.contains(i));
        let odd: Vec<String> = odd.map(|&i| pictures[i].path.display().to_string()).collect();
        let odd = if odd.is_empty() { String::new() } else { format!("; that of {} is not believed", odd.join(", ")) };
        let detail = format!(
            "{what}{odd}; their steps are about {} EV, give or take {:.0} %",
            listed.join(", "),
            100.0 * uncertainty
        );
        warnings.push(match contradiction {
            Some(_) => Warning::ExposureContradicted { detail },
            None => Warning::ExposureEstimated { detail },
        });
    }
    for (i, detail) in assumed.into_iter().filter(|(i, _)| believed.contains(i)) {
        let path = pictures[i].path.clone();
        pictures[i].warnings.push(Warning::ExposureIncomplete { path, detail });
    }
    // What is excluded and says nothing is merged with nothing: any exposure does.
    let any = exposures.iter().flatten().next().cloned();
    Ok(exposures.into_iter().filter_map(|exposure| exposure.or_else(|| any.clone())).collect())
}

/// Where steps from the pixels, which hang in the air, stand among exposures.
struct Places<'a> {
    steps: &'a [f64],
    /// Of the frames that are believed, the index and what is to be added to its step; where there are none, of the middle of all that are
    /// written, which are right on the whole.
    known: Vec<(usize, f64)>,
}

impl<'a> Places<'a> {
    fn new(order: &[usize], steps: &'a [f64], written: &[f64], believed: &[usize]) -> Self {
        let places = order.iter().enumerate().map(|(at, &i)| (i, (at, written[i] - steps[at])));
        let mut known: Vec<(usize, f64)> =
            places.clone().filter(|(i, _)| believed.contains(i)).map(|(_, place)| place).collect();
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

    /// The known frame nearest to the frame `at`, and what is to be added to the steps as to that.
    fn anchor(&self, at: usize) -> (usize, f64) {
        let off = |place: &(usize, f64)| (self.steps[place.0] - self.steps[at]).abs();
        let nearest = self.known.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.copied().unwrap_or((at, 0.0))
    }
}
