//! Exposures that were written down, compared with the pixels.
//!
//! In: exposures in EV, and the histograms of their frames. Out: why they cannot be right; and of which frames. Cost: that of a step for each
//! pair that are neighbours in any set of frames that is tried.

use super::{Brightness, CAMERAS, STEP, by_brightness, spread, step};
use std::cell::RefCell;
use std::collections::BTreeMap;

/// Exposures that are written down and differ by no more, in EV, are one.
const ALIKE: f64 = 0.05;
/// A step that is off by this, in EV, is off by no weather: a slip of the pen, or a tag that counts otherwise.
const FAR_OFF: f64 = 3.0;
/// Of more frames than these only one is looked for that contradicts the others.
const MANY: usize = 12;

/// Why `written`, the exposures in EV that the files give, cannot be those of `frames`; `None` where they may well be.
///
/// Plain contradictions only, since the estimate is rough and light may change between frames: all written alike although the pictures
/// differ by more than 0.6 EV; a frame written brighter than its neighbour by 0.3 EV or more that is darker by 0.5 EV or more; or a step
/// that is at least twice, and at least 3 EV more, or as much less, than the pictures have.
pub fn contradiction(written: &[f64], frames: &[&Brightness]) -> Option<String> {
    let all: Vec<usize> = (0..frames.len()).collect();
    among(&all, written, &Pairs::of(frames))
}

/// The steps between pairs of frames, each computed once.
struct Pairs<'a> {
    frames: &'a [&'a Brightness],
    steps: RefCell<BTreeMap<(usize, usize), Option<f64>>>,
}

impl<'a> Pairs<'a> {
    fn of(frames: &'a [&'a Brightness]) -> Self {
        Pairs { frames, steps: RefCell::default() }
    }

    fn step(&self, from: usize, to: usize) -> Option<f64> {
        *self.steps.borrow_mut().entry((from, to)).or_insert_with(|| step(self.frames[from], self.frames[to]))
    }

    /// How far apart the darkest and the brightest of `which` are, in EV.
    fn spread(&self, which: &[usize]) -> Option<f64> {
        let frames: Vec<&Brightness> = which.iter().map(|&i| self.frames[i]).collect();
        let order = by_brightness(&frames);
        order.windows(2).map(|pair| self.step(which[pair[0]], which[pair[1]])).sum()
    }
}

/// The same of the frames `which`.
fn among(which: &[usize], written: &[f64], pairs: &Pairs) -> Option<String> {
    let order = by_written(which, written);
    let all: Vec<f64> = order.iter().map(|&i| written[i]).collect();
    if spread(&all) <= ALIKE {
        let seen = pairs.spread(which)?;
        return (seen > 0.6).then(|| format!("all say the same, but the pictures differ by about {seen:.1} EV"));
    }
    order.windows(2).find_map(|pair| {
        let said = written[pair[1]] - written[pair[0]];
        let seen = pairs.step(pair[0], pair[1])?;
        if said >= 0.3 && seen <= -0.5 {
            let darker = -seen;
            return Some(format!(
                "one frame should be {said:.1} EV brighter than the next, but is {darker:.1} EV darker"
            ));
        }
        let (less, more) = if said < seen { (said, seen) } else { (seen, said) };
        (more - less >= FAR_OFF && more >= 2.0 * less).then(|| {
            format!("one frame should be {said:.1} EV brighter than the next, but is brighter by about {seen:.1} EV")
        })
    })
}

/// The frames `which`, that first which should be the darkest.
fn by_written(which: &[usize], written: &[f64]) -> Vec<usize> {
    let mut order = which.to_vec();
    order.sort_by(|&a, &b| written[a].total_cmp(&written[b]));
    order
}

/// Which of `frames` contradict the others where most agree with what was `written`: the fewest, and fewer than half, without which there is no
/// [`contradiction`] and all steps can be seen. Of as many, those without which the steps are nearest to those written. `None` where there
/// are no such.
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
            // The next of the combinations, in order.
            let Some(last) = (0..some).rev().find(|&i| odd[i] < count - some + i) else { break };
            let next = odd[last] + 1;
            odd.truncate(last);
            odd.extend(next..next + some - last);
        }
        best.map(|(_, odd)| odd)
    })
}

/// How far the steps of the frames but those of `odd` are from those written, at most, 1 being what the contrasts of cameras leave open;
/// `None` where they contradict each other, or one cannot be seen.
fn without(written: &[f64], pairs: &Pairs, odd: &[usize]) -> Option<f64> {
    let rest: Vec<usize> = (0..written.len()).filter(|i| !odd.contains(i)).collect();
    let order = by_written(&rest, written);
    let mut misfit: f64 = 0.0;
    for pair in order.windows(2) {
        let said = written[pair[1]] - written[pair[0]];
        let seen = pairs.step(pair[0], pair[1])?;
        misfit = misfit.max((said - seen).abs() / (STEP + 2.0 * CAMERAS * said));
    }
    let all: Vec<f64> = order.iter().map(|&i| written[i]).collect();
    // That all say the same is no agreement where they are not as alike.
    let is_open = among(&rest, written, pairs).is_some() || (spread(&all) <= ALIKE && misfit > 1.0);
    (!is_open).then_some(misfit)
}
