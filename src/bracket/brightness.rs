//! Exposure steps from the pixels, for frames whose EXIF says nothing, or says what cannot be.
//!
//! In: the code values of all frames. Out: exposures in EV up to a common term, and a verdict on exposures that were written down.
//! Cost: one histogram per frame over a quarter of its pixels, then 256-entry tables.
//!
//! Two frames of a still scene rank its points alike, so equal ranks in their histograms are equal radiances, wherever they lie in the
//! frame: no alignment is needed, and a mover counts for its area only (Grossberg and Nayar, "Determining the camera response from
//! images: what is knowable?", PAMI 2003, section 5). The green channel is taken, at every code of the darker frame that is well exposed
//! in both; each gives a log2 ratio under the sRGB curve, of which the weighted median is the step. Frames are chained in order of brightness.
//!
//! The same paper shows what cannot be known: histograms give the steps only up to the camera's contrast. Over fourteen brackets of eight
//! cameras, JPEGs are 1.40 times as steep as sRGB (1.27 to 1.78), a film scan 1.08. Where the steps are even, their median is taken for
//! a whole number of EV, as cameras bracket; otherwise 1.40 is divided out. The result is right to some tenths of the step.

use super::Samples;
use super::colour::srgb_to_linear;

/// How much steeper than sRGB a camera's mid tones are, in the median; see above.
const CONTRAST: f64 = 1.40;
/// The contrasts that whole steps may imply.
const CONTRASTS: std::ops::RangeInclusive<f64> = 1.03..=1.80;
/// Codes between which a code is well exposed; shadows carry noise and flare, highlights the camera's shoulder.
const EXPOSED: (usize, usize) = (24, 200);
/// The same where the former leaves nothing to compare.
const BARELY_EXPOSED: (usize, usize) = (4, 250);
/// Fewer pixels than these beyond a code say nothing about it.
const TAIL: u64 = 32;
/// A step below this, in EV, is none at all.
const STEP: f64 = 0.2;
/// A step that is off by this, in EV, is off by no weather: a slip of the pen, or a tag that counts otherwise.
const FAR_OFF: f64 = 3.0;

/// The histogram of a frame's green channel, at 8 bit.
#[derive(Debug, Clone)]
pub struct Brightness {
    counts: [u64; 256],
    /// `below[k]`: how many are below code `k`; one entry more than codes.
    below: [u64; 257],
}

impl Brightness {
    /// Counts every other pixel of every other row of a picture `width` pixels wide; all of them in a small one.
    pub fn of(samples: &Samples, width: usize) -> Self {
        let stride = if samples.len() < 3 << 16 { 1 } else { 2 };
        let mut counts = [0u64; 256];
        match samples {
            Samples::Eight(v) => count(v, width, stride, |&code| usize::from(code), &mut counts),
            Samples::Sixteen(v) => count(v, width, stride, |&code| usize::from(code >> 8), &mut counts),
        }
        let mut below = [0u64; 257];
        for k in 0..256 {
            below[k + 1] = below[k] + counts[k];
        }
        Brightness { counts, below }
    }

    /// The mean code, 0..=255.
    fn mean(&self) -> f64 {
        let sum: u64 = self.counts.iter().zip(0u64..).map(|(n, code)| n * code).sum();
        sum as f64 / self.total().max(1) as f64
    }

    /// Whether the two have as many pixels of every code.
    pub fn is_like(&self, other: &Brightness) -> bool {
        self.counts == other.counts
    }

    fn total(&self) -> u64 {
        self.below[256]
    }

    /// The code below which `rank` values lie, each code's values spread evenly over one unit about it.
    fn code_at(&self, rank: f64) -> f64 {
        let k = self.below[1..].partition_point(|&n| (n as f64) < rank).min(255);
        let within = (rank - self.below[k] as f64) / self.counts[k].max(1) as f64;
        k as f64 - 0.5 + within.clamp(0.0, 1.0)
    }

    /// How many values lie at about code `k`.
    fn about(&self, k: usize) -> u64 {
        self.below[(k + 3).min(256)] - self.below[k.saturating_sub(1)]
    }
}

fn count<T>(v: &[T], width: usize, stride: usize, code: impl Fn(&T) -> usize, counts: &mut [u64; 256]) {
    // By turns into two: neighbours that are alike would wait for each other.
    let mut others = [0u64; 256];
    for row in v.chunks_exact(3 * width).step_by(stride) {
        if stride == 2 {
            let (fours, rest) = row.as_chunks::<12>();
            for four in fours {
                counts[code(&four[1])] += 1;
                others[code(&four[7])] += 1;
            }
            rest.chunks_exact(3).step_by(2).for_each(|pixel| counts[code(&pixel[1])] += 1);
        } else {
            let (pairs, last) = row.as_chunks::<6>();
            for pair in pairs {
                counts[code(&pair[1])] += 1;
                others[code(&pair[4])] += 1;
            }
            last.chunks_exact(3).for_each(|pixel| counts[code(&pixel[1])] += 1);
        }
    }
    counts.iter_mut().zip(others).for_each(|(count, other)| *count += other);
}

/// The step from `dark` to `bright` in EV, were the camera's curve that of sRGB; `None` where nothing is well exposed in both.
fn step(dark: &Brightness, bright: &Brightness) -> Option<f64> {
    step_within(dark, bright, EXPOSED).or_else(|| step_within(dark, bright, BARELY_EXPOSED))
}

fn step_within(dark: &Brightness, bright: &Brightness, (low, high): (usize, usize)) -> Option<f64> {
    let (lowest, highest) = (low as f64, high as f64);
    // Rises from both ends, but reaches 1 soon: the middle is not better than the rest.
    let trust = |code: f64| (code - lowest + 1.0).min(highest + 1.0 - code).min(40.0);
    let scale = bright.total() as f64 / dark.total().max(1) as f64;
    let (mut ratios, mut tones) = (Vec::new(), 0);
    for k in low..high {
        let below = dark.below[k + 1];
        if below.min(dark.total() - below) < TAIL {
            continue;
        }
        let (from, to) = (k as f64 + 0.5, bright.code_at(below as f64 * scale));
        if (lowest..=highest).contains(&to) {
            let seen = dark.about(k).min((bright.about(to as usize) as f64 / scale) as u64);
            let weight = trust(from).min(trust(to)) * (seen as f64).sqrt();
            ratios.push((libm::log2(linear(to) / linear(from)), weight));
            tones += usize::from(dark.counts[k] > 0);
        }
    }
    // Fewer codes than these are a chance match. A drawing of two tones is all gap: between them rank says nothing.
    if ratios.len() < 8 || tones < 4 {
        return None;
    }
    ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = ratios.iter().map(|r| r.1).sum::<f64>() / 2.0;
    let mut so_far = 0.0;
    ratios
        .iter()
        .find(|(_, weight)| {
            so_far += weight;
            so_far >= half
        })
        .map(|r| r.0)
}

/// The sRGB curve (IEC 61966-2-1) of a code 0..=255.
fn linear(code: f64) -> f64 {
    srgb_to_linear(code / 255.0)
}

/// The exposures of `frames` in EV, in their order, that of the darkest being 0. `None` where neighbours in brightness cannot be compared.
/// Ties go by index, so hand frames over in an order of their own.
pub fn estimate(frames: &[Brightness]) -> Option<Vec<f64>> {
    let mut order: Vec<usize> = (0..frames.len()).collect();
    order.sort_by(|&a, &b| frames[a].mean().total_cmp(&frames[b].mean()));
    let steps: Vec<f64> =
        order.windows(2).map(|pair| step(&frames[pair[0]], &frames[pair[1]])).collect::<Option<_>>()?;
    let contrast = contrast(&steps);
    let mut evs = vec![0.0; frames.len()];
    for (pair, step) in order.windows(2).zip(&steps) {
        evs[pair[1]] = evs[pair[0]] + step / contrast;
    }
    Some(evs)
}

/// What to divide the steps by: see the head of this file.
fn contrast(steps: &[f64]) -> f64 {
    let real: Vec<f64> = steps.iter().copied().filter(|&s| s > STEP * CONTRAST).collect();
    let middle = median(&real);
    let off: Vec<f64> = real.iter().map(|s| (s - middle).abs()).collect();
    if real.len() < 2 || median(&off) > 0.25 * middle {
        return CONTRAST;
    }
    (1..=4)
        .map(|whole| middle / f64::from(whole))
        .filter(|c| CONTRASTS.contains(c))
        .min_by(|a, b| libm::log2(a / CONTRAST).abs().total_cmp(&libm::log2(b / CONTRAST).abs()))
        .unwrap_or(CONTRAST)
}

/// The middle value, or the mean of the two in the middle; 0 of none.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match (sorted.len(), sorted.len() / 2) {
        (0, _) => 0.0,
        (n, half) if n % 2 == 0 => (sorted[half - 1] + sorted[half]) / 2.0,
        (_, half) => sorted[half],
    }
}

/// The largest difference in `evs`.
pub fn spread(evs: &[f64]) -> f64 {
    let largest = evs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = evs.iter().copied().fold(f64::INFINITY, f64::min);
    if evs.is_empty() { 0.0 } else { largest - least }
}

/// Whether pictures are all the same as far as exposure goes.
pub fn all_alike(evs: &[f64]) -> bool {
    spread(evs) < STEP
}

/// Why `written`, the exposures in EV that the files give, cannot be those of `frames`; `None` where they may well be.
///
/// Plain contradictions only, since the estimate is rough and light may change between frames: all written alike although the pictures
/// differ by more than 0.6 EV; a frame written brighter than its neighbour by 0.3 EV or more that is darker by 0.5 EV or more; or a step
/// that is at least twice, and at least 3 EV more, or as much less, than the pictures have.
pub fn contradiction(written: &[f64], frames: &[Brightness]) -> Option<String> {
    if spread(written) <= 0.05 {
        let seen = spread(&estimate(frames)?);
        return (seen > 0.6).then(|| format!("all say the same, but the pictures differ by about {seen:.1} EV"));
    }
    let mut order: Vec<usize> = (0..frames.len()).collect();
    order.sort_by(|&a, &b| written[a].total_cmp(&written[b]));
    order.windows(2).find_map(|pair| {
        let said = written[pair[1]] - written[pair[0]];
        let seen = step(&frames[pair[0]], &frames[pair[1]])? / CONTRAST;
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

/// Which of `frames` are at odds with the others where most agree with what was `written`: the fewest, and fewer than half, without which every
/// step is seen as it was written. `None` where there are no such.
pub fn at_odds(written: &[f64], frames: &[Brightness]) -> Option<Vec<usize>> {
    let count = frames.len();
    let most = if count <= MANY { (count.max(1) - 1) / 2 } else { 1 };
    (1..=most).find_map(|some| {
        let mut odd: Vec<usize> = (0..some).collect();
        loop {
            if agree(written, frames, &odd) {
                return Some(odd);
            }
            // The next of the combinations, in order.
            let last = (0..some).rev().find(|&i| odd[i] < count - some + i)?;
            let next = odd[last] + 1;
            odd.truncate(last);
            odd.extend(next..next + some - last);
        }
    })
}

/// Of more frames than these only one is looked for that is at odds.
const MANY: usize = 12;

/// Whether the frames but those of `odd` show the steps that are written.
fn agree(written: &[f64], frames: &[Brightness], odd: &[usize]) -> bool {
    let mut order: Vec<usize> = (0..frames.len()).filter(|i| !odd.contains(i)).collect();
    order.sort_by(|&a, &b| written[a].total_cmp(&written[b]));
    order.windows(2).all(|pair| {
        let said = written[pair[1]] - written[pair[0]];
        let seen = step(&frames[pair[0]], &frames[pair[1]]).map(|step| step / CONTRAST);
        // As far apart as cameras' contrasts are: 1.27 to 1.78, of which 1.4 is divided out.
        seen.is_some_and(|seen| (said - seen).abs() <= 0.2 + 0.25 * said)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scene of five decades under a curve `contrast` times as steep as sRGB's, `ev` stops over the base; `shift` pixels to the side.
    fn picture(ev: f64, contrast: f64, shift: usize) -> Brightness {
        let (width, height) = (160, 120);
        let mut samples = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let scene =
                    ((x + shift) as f64 / 23.0).sin() + (y as f64 / 17.0).cos() + 0.3 * ((x * y) as f64 / 90.0).sin();
                let light = 2f64.powf(2.2 * scene + ev - 2.5).powf(contrast);
                let v = if light <= 0.0031308 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
                samples.extend([0, (v.min(1.0) * 255.0).round() as u8, 0]);
            }
        }
        Brightness::of(&Samples::Eight(samples), width)
    }

    #[test]
    fn even_steps_come_out_whole_whatever_the_contrast() {
        for (step, contrast) in [(1.0, 1.1), (1.0, 1.5), (2.0, 1.4), (3.0, 1.35)] {
            let frames: Vec<_> = (0..4).map(|i| picture(step * f64::from(i) - 4.0, contrast, 3 * i as usize)).collect();
            let evs = estimate(&frames).unwrap();
            for (i, ev) in evs.iter().enumerate() {
                assert!((ev - step * i as f64).abs() < 0.12 * step, "{step} EV at contrast {contrast}: {evs:?}");
            }
        }
    }

    #[test]
    fn order_does_not_matter() {
        let frames: Vec<_> = [2.0, -1.0, 0.0, -2.0].map(|ev| picture(ev, 1.4, 0)).into();
        let evs = estimate(&frames).unwrap();
        let turned: Vec<_> = frames.iter().rev().cloned().collect();
        let back: Vec<f64> = estimate(&turned).unwrap().into_iter().rev().collect();
        assert_eq!(evs, back);
        assert!(evs[3] == 0.0 && evs[0] > evs[2] && evs[2] > evs[1]);
    }

    #[test]
    fn equal_pictures_are_alike_and_contradict_nothing() {
        let frames = [picture(0.0, 1.4, 0), picture(0.0, 1.4, 9), picture(0.1, 1.4, 4)];
        assert!(all_alike(&estimate(&frames).unwrap()));
        assert_eq!(contradiction(&[-3.0; 3], &frames), None);
    }

    #[test]
    fn equal_exposures_of_different_pictures_contradict() {
        let frames = [picture(0.0, 1.4, 0), picture(1.0, 1.4, 0)];
        assert!(contradiction(&[-5.0, -5.0], &frames).is_some());
        assert_eq!(contradiction(&[-5.0, -4.0], &frames), None);
        assert!(contradiction(&[-4.0, -5.0], &frames).is_some());
        // A third of a stop in light is weather, not a contradiction.
        assert_eq!(contradiction(&[0.0, 0.0], &[picture(0.0, 1.4, 0), picture(0.3, 1.4, 0)]), None);
    }

    #[test]
    fn a_step_that_is_far_off_contradicts() {
        let frames = [picture(0.0, 1.4, 0), picture(2.0, 1.4, 0)];
        // A millionth and a million are 20 EV; two EV more than there are may be a rough estimate.
        assert_eq!(contradiction(&[0.0, 4.0], &frames), None);
        assert!(contradiction(&[0.0, 22.0], &frames).is_some());
        assert!(contradiction(&[22.0, 0.0], &frames).is_some());
        let far = [picture(-2.0, 1.4, 0), picture(2.0, 1.4, 0)];
        assert!(contradiction(&[0.0, 0.5], &far).is_some());
        assert_eq!(contradiction(&[0.0, 2.5], &far), None);
    }

    #[test]
    fn the_few_are_at_odds_with_the_many() {
        let frames: Vec<_> = [-2.0, 0.0, 2.0, 1.0, -1.0].map(|ev| picture(ev, 1.4, 0)).into();
        let true_evs = [-2.0, 0.0, 2.0, 1.0, -1.0];
        let with = |changes: &[(usize, f64)]| {
            let mut written = true_evs;
            changes.iter().for_each(|&(i, ev)| written[i] = ev);
            at_odds(&written, &frames)
        };
        assert_eq!(with(&[(2, 20.0)]), Some(vec![2]));
        assert_eq!(with(&[(1, -9.0), (3, 7.0)]), Some(vec![1, 3]));
        // Three of five are not the few, and of three that are turned round no two agree.
        assert_eq!(with(&[(0, 9.0), (1, -9.0), (3, 14.0)]), None);
        assert_eq!(at_odds(&[2.0, 0.0, -2.0], &frames[..3]), None);
        assert_eq!(at_odds(&[0.0, 0.0], &frames[..2]), None);
    }

    /// Between its two codes anything may be: a step has nothing to hold on to.
    #[test]
    fn two_tones_tell_no_step() {
        let tones = |dark: u8, bright: u8| {
            let codes = (0..3 * 64 * 64).map(|i| if i / 24 % 2 == 0 { dark } else { bright }).collect();
            Brightness::of(&Samples::Eight(codes), 64)
        };
        assert_eq!(estimate(&[tones(15, 115), tones(30, 190)]), None);
        assert_eq!(contradiction(&[0.0, 2.0], &[tones(15, 115), tones(30, 190)]), None);
    }

    #[test]
    fn sixteen_bits_give_what_eight_give() {
        let eight: Vec<u8> = (0..3 * 64 * 64u32).map(|i| (i * 7 % 251) as u8).collect();
        let sixteen = eight.iter().map(|&c| u16::from(c) * 257).collect();
        let (a, b) = (Brightness::of(&Samples::Eight(eight), 64), Brightness::of(&Samples::Sixteen(sixteen), 64));
        assert_eq!(a.counts, b.counts);
    }

    #[test]
    fn black_and_white_cannot_be_compared() {
        let flat = |v: u8| Brightness::of(&Samples::Eight(vec![v; 3 * 64 * 64]), 64);
        assert_eq!(estimate(&[flat(0), flat(255)]), None);
    }
}
