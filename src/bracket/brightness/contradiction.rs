//! Exposures that were written down, compared with the pixels.
//!
//! In: exposures in EV, and the histograms of their frames. Out: why they cannot be right; and of which frames. Cost: that of a step for each
//! pair of neighbours, times the sets of frames that are tried.

use super::{Brightness, CAMERAS, STEP, estimate, spread, step};

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
pub fn contradiction(written: &[f64], frames: &[Brightness]) -> Option<String> {
    if spread(written) <= ALIKE {
        let seen = spread(&estimate(frames)?.evs);
        return (seen > 0.6).then(|| format!("all say the same, but the pictures differ by about {seen:.1} EV"));
    }
    let mut order: Vec<usize> = (0..frames.len()).collect();
    order.sort_by(|&a, &b| written[a].total_cmp(&written[b]));
    order.windows(2).find_map(|pair| {
        let said = written[pair[1]] - written[pair[0]];
        let seen = step(&frames[pair[0]], &frames[pair[1]])?;
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

/// Which of `frames` contradict the others where most agree with what was `written`: the fewest, and fewer than half, without which there is no
/// [`contradiction`] and all steps can be seen. Of as many, those without which the steps are nearest to those written. `None` where there
/// are no such.
pub fn at_odds(written: &[f64], frames: &[Brightness]) -> Option<Vec<usize>> {
    let count = frames.len();
    let most = if count <= MANY { (count.max(1) - 1) / 2 } else { 1 };
    (1..=most).find_map(|some| {
        let mut best: Option<(f64, Vec<usize>)> = None;
        let mut odd: Vec<usize> = (0..some).collect();
        loop {
            if let Some(misfit) = without(written, frames, &odd)
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
fn without(written: &[f64], frames: &[Brightness], odd: &[usize]) -> Option<f64> {
    let mut order: Vec<usize> = (0..frames.len()).filter(|i| !odd.contains(i)).collect();
    order.sort_by(|&a, &b| written[a].total_cmp(&written[b]));
    let mut misfit: f64 = 0.0;
    for pair in order.windows(2) {
        let said = written[pair[1]] - written[pair[0]];
        let seen = step(&frames[pair[0]], &frames[pair[1]])?;
        misfit = misfit.max((said - seen).abs() / (STEP + 2.0 * CAMERAS * said));
    }
    let rest: Vec<f64> = order.iter().map(|&i| written[i]).collect();
    let shown: Vec<Brightness> = order.iter().map(|&i| frames[i].clone()).collect();
    // That all say the same is no agreement where they are not as alike.
    let is_open = contradiction(&rest, &shown).is_some() || (spread(&rest) <= ALIKE && misfit > 1.0);
    (!is_open).then_some(misfit)
}
