//! Compares exposures from EXIF or the user with the pixels.
//!
//! In: exposures in EV, and the brightness of their frames. Out: why the exposures are impossible, and for which
//! frames. Several sets of frames are tried. Cost: one estimate of a step for each pair of frames that are neighbours
//! in one of these sets.

use super::{Brightness, CAMERAS, STEP, Step, by_brightness, spread, step};
use std::cell::RefCell;
use std::collections::BTreeMap;

/// Written exposures that differ by no more than this, in EV, count as equal.
const ALIKE: f64 = 0.05;
/// If a step is wrong by at least this, in EV, changing light is not the cause, but a typing error, or a tag with
/// another unit.
const FAR_OFF: f64 = 3.0;
/// For more frames than this, only a single contradicting frame is searched for.
const MANY: usize = 12;

/// Returns why `written`, exposures in EV, cannot be those of `frames`; `None` where they are possible.
///
/// Reports only clear contradictions, since the estimate is rough and light may change between frames:
/// - all written exposures are equal, although the brightness of the frames differs by more than 0.6 EV;
/// - of two frames with neighbouring written exposures, one should be brighter by 0.3 EV or more, but is darker by 0.5
///   EV or more;
/// - a written step and a step measured on well exposed pixels differ by at least 3 EV, and the larger of them is at
///   least twice the smaller.
pub fn contradiction(written: &[f64], frames: &[&Brightness]) -> Option<String> {
    let all: Vec<usize> = (0..frames.len()).collect();
    among(&all, written, &Pairs::of(frames))
}

/// The steps between pairs of frames; each step is computed only once.
struct Pairs<'a> {
    frames: &'a [&'a Brightness],
    steps: RefCell<BTreeMap<(usize, usize), Option<Step>>>,
}

impl<'a> Pairs<'a> {
    fn of(frames: &'a [&'a Brightness]) -> Self {
        Pairs { frames, steps: RefCell::default() }
    }

    fn step(&self, from: usize, to: usize) -> Option<Step> {
        *self.steps.borrow_mut().entry((from, to)).or_insert_with(|| step(self.frames[from], self.frames[to]))
    }

    /// Returns the exposure difference between the darkest and the brightest of the frames `which`, in EV, estimated
    /// from the pixels.
    fn spread(&self, which: &[usize]) -> Option<f64> {
        let frames: Vec<&Brightness> = which.iter().map(|&i| self.frames[i]).collect();
        let order = by_brightness(&frames);
        order.windows(2).map(|pair| Some(self.step(which[pair[0]], which[pair[1]])?.ev)).sum()
    }
}

/// Same as [`contradiction`], for the frames `which`.
fn among(which: &[usize], written: &[f64], pairs: &Pairs) -> Option<String> {
    let order = by_written(which, written);
    let all: Vec<f64> = order.iter().map(|&i| written[i]).collect();
    if spread(&all) <= ALIKE {
        let seen = pairs.spread(which)?;
        return (seen > 0.6).then(|| format!("all exposures are equal, but the pictures differ by about {seen:.1} EV"));
    }
    order.windows(2).find_map(|pair| {
        let said = written[pair[1]] - written[pair[0]];
        let Step { ev: seen, is_well_exposed } = pairs.step(pair[0], pair[1])?;
        if said >= 0.3 && seen <= -0.5 {
            let darker = -seen;
            return Some(format!(
                "one frame should be {said:.1} EV brighter than the next, but is {darker:.1} EV darker"
            ));
        }
        let (less, more) = if said < seen { (said, seen) } else { (seen, said) };
        (is_well_exposed && more - less >= FAR_OFF && more >= 2.0 * less).then(|| {
            format!("one frame should be {said:.1} EV brighter than the next, but is brighter by about {seen:.1} EV")
        })
    })
}

/// Returns the indices `which`, sorted by rising written exposure.
fn by_written(which: &[usize], written: &[f64]) -> Vec<usize> {
    let mut order = which.to_vec();
    order.sort_by(|&a, &b| written[a].total_cmp(&written[b]));
    order
}

/// Finds the smallest set of frames, fewer than half of `frames`, without which there is no [`contradiction`] and all
/// steps can be measured. Returns the indices of this set. Of several sets of equal size, returns the one without which
/// the written steps agree best with the measured steps. `None` where there is no such set.
pub fn at_odds(written: &[f64], frames: &[&Brightness]) -> Option<Vec<usize>> {
    let (count, pairs) = (frames.len(), Pairs::of(frames));
    let most = if count <= MANY { (count.max(1) - 1) / 2 } else { 1 };
    (1..=most).find_map(|some| {
        let mut best: Option<(f64, Vec<usize>)> = None;
        let mut odd: Vec<usize> = (0..some).collect();
        loop {
            if let Some(misfit) = without(written, &pairs, &odd)
                && best.as_ref().is_none_or(|(least, _)| misfit < *least)
            {
                best = Some((misfit, odd.clone()));
            }
            // Replaces `odd` by the next combination of `some` indices, in lexicographic order.
            let Some(last) = (0..some).rev().find(|&i| odd[i] < count - some + i) else { break };
            let next = odd[last] + 1;
            odd.truncate(last);
            odd.extend(next..next + some - last);
        }
        best.map(|(_, odd)| odd)
    })
}

/// Compares the written with the measured steps without the frames `odd`. The difference of each step is divided by the
/// difference that is tolerated for it; returns the largest of these quotients. `None` if the remaining frames
/// contradict each other, or a step cannot be measured.
fn without(written: &[f64], pairs: &Pairs, odd: &[usize]) -> Option<f64> {
    let rest: Vec<usize> = (0..written.len()).filter(|i| !odd.contains(i)).collect();
    let order = by_written(&rest, written);
    let mut misfit: f64 = 0.0;
    for pair in order.windows(2) {
        let said = written[pair[1]] - written[pair[0]];
        let seen = pairs.step(pair[0], pair[1])?.ev;
        misfit = misfit.max((said - seen).abs() / (STEP + 2.0 * CAMERAS * said));
    }
    let all: Vec<f64> = order.iter().map(|&i| written[i]).collect();
    // If all written exposures are equal, frames of different brightness are a contradiction as well.
    let is_open = among(&rest, written, pairs).is_some() || (spread(&all) <= ALIKE && misfit > 1.0);
    (!is_open).then_some(misfit)
}
