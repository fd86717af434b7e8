//! Exposure steps from the pixels, for frames whose EXIF says nothing, or says what cannot be.
//!
//! In: the code values of all frames. Out: exposures in EV up to a common term; and whether exposures that were written down can be right.
//! Cost: one histogram per frame over a quarter of its pixels, then 256-entry tables.
//!
//! Two frames of a still scene rank its points alike, so equal ranks in their histograms are equal radiances, wherever they lie in the
//! frame: no alignment is needed, and a mover counts for its area only (Grossberg and Nayar, "Determining the camera response from
//! images: what is knowable?", PAMI 2003, section 5). The green channel is taken, at every code of the darker frame that is well exposed
//! in both; each gives a log2 ratio under a curve, of which the weighted median is the step. Frames are chained in order of brightness.
//!
//! The curve is sRGB's of u = (1 + q) x^n / (1 + q x^n) for an exposure x: with q = 0 and n = 1 it is sRGB itself, as of rendered pictures; the
//! larger q, the longer the shoulder of a camera's highlights (Naka & Rushton's law). q is that under which all codes tell the same step. Of n the same
//! paper shows that it cannot be known from histograms, which give log exposures up to a factor; but cameras have shoulder and contrast
//! together. n = 1 + 0.65 q / (q + 1.5) was fitted to five brackets of cameras whose steps are known (renderings under the sRGB curve are right to 1 %).
//! Where the steps are even, they are a whole number of EV, if one is within what is open. Over nine other brackets of cameras five are right to 5 %, eight
//! to 13 %, and one is off by 47 %; film curves, which are no cameras', by up to 90 %.

mod contradiction;

use super::Samples;
use super::colour::srgb_to_linear;
use std::f64::consts::LN_2;

pub use contradiction::{at_odds, contradiction};

/// The shoulders q that are tried; see above.
const SHOULDERS: [f64; 9] = [0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
/// Standard deviations of the steps, as shares of them: of cameras, and where the curve is sRGB's to the rounding of codes.
const CAMERAS: f64 = 0.12;
const CERTAIN: f64 = 0.03;
/// Mean square misfit of a curve that is right, in units of a code: rounding of both codes, and some noise.
const ROUNDING: f64 = 1.0;
/// Codes that are off by more than this many count as this many: something moved.
const MOVED: f64 = 4.0;
/// Codes between which a code is neither clipped nor lost in the noise and flare of shadows.
const EXPOSED: (usize, usize) = (24, 252);
/// The same where the former leaves nothing to compare.
const BARELY_EXPOSED: (usize, usize) = (2, 252);
/// Fewer pixels than these beyond a code say nothing about it.
const TAIL: u64 = 32;
/// A step below this, in EV, is none at all.
const STEP: f64 = 0.2;

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

/// A code of the darker frame and that of the same rank in the brighter.
struct Match {
    from: Tone,
    to: Tone,
    weight: f64,
}

/// A code under the sRGB curve.
#[derive(Clone, Copy)]
struct Tone {
    linear: f64,
    /// What a code more adds.
    rise: f64,
}

impl Tone {
    fn of(code: f64) -> Self {
        let linear = |code: f64| srgb_to_linear(code / 255.0);
        Tone { linear: linear(code), rise: linear(code + 0.5) - linear(code - 0.5) }
    }

    /// log2 of the exposure under a curve with `shoulder`, at n = 1, and what a code more adds to it.
    fn stops(self, shoulder: f64) -> (f64, f64) {
        let Tone { linear, rise } = self;
        let rest = 1.0 + shoulder * (1.0 - linear);
        (libm::log2(linear / rest), rise * (1.0 / linear + shoulder / rest) / LN_2)
    }
}

/// The codes that are exposed in both, well if there are such; `None` where there are too few.
fn matches(dark: &Brightness, bright: &Brightness) -> Option<Vec<Match>> {
    matches_within(dark, bright, EXPOSED).or_else(|| matches_within(dark, bright, BARELY_EXPOSED))
}

fn matches_within(dark: &Brightness, bright: &Brightness, (low, high): (usize, usize)) -> Option<Vec<Match>> {
    let scale = bright.total() as f64 / dark.total().max(1) as f64;
    let (mut matches, mut tones) = (Vec::new(), 0);
    for k in low..high {
        let below = dark.below[k + 1];
        if below.min(dark.total() - below) < TAIL {
            continue;
        }
        let to = bright.code_at(below as f64 * scale);
        if (low as f64..=high as f64).contains(&to) {
            let seen = dark.about(k).min((bright.about(to as usize) as f64 / scale) as u64);
            matches.push(Match { from: Tone::of(k as f64 + 0.5), to: Tone::of(to), weight: (seen as f64).sqrt() });
            tones += usize::from(dark.counts[k] > 0);
        }
    }
    // Fewer codes than these are a chance match. A drawing of two tones is all gap: between them rank says nothing.
    (matches.len() >= 8 && tones >= 4).then_some(matches)
}

/// The step in EV under a curve with `shoulder`, at n = 1, and the mean square misfit of the codes.
fn fit(matches: &[Match], shoulder: f64) -> (f64, f64) {
    // Of each code the step, what a code is in stops, and its weight.
    let mut steps: Vec<(f64, f64, f64)> = matches
        .iter()
        .map(|Match { from, to, weight }| {
            let ((a, rise_a), (b, rise_b)) = (from.stops(shoulder), to.stops(shoulder));
            (b - a, (rise_a * rise_a + rise_b * rise_b).sqrt(), *weight)
        })
        .collect();
    steps.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = steps.iter().map(|(_, code, weight)| weight / code).sum::<f64>() / 2.0;
    let mut so_far = 0.0;
    let median = steps.iter().find(|(_, code, weight)| {
        so_far += weight / code;
        so_far >= half
    });
    let median = median.map_or(0.0, |step| step.0);
    let (mut square, mut total) = (0.0, f64::MIN_POSITIVE);
    for (step, code, weight) in steps {
        let off = ((step - median) / code).abs().min(MOVED);
        square += weight * off * off;
        total += weight;
    }
    (median, square / total)
}

/// Steps in EV, and their standard deviation as a share of them.
struct Steps {
    evs: Vec<f64>,
    uncertainty: f64,
}

/// The steps of pairs of frames of one camera: under the curve that suits all of them best.
fn steps(pairs: &[Vec<Match>]) -> Steps {
    let under = |&shoulder: &f64| {
        let fits: Vec<(f64, f64)> = pairs.iter().map(|pair| fit(pair, shoulder)).collect();
        let misfit = fits.iter().map(|f| f.1).sum::<f64>() / pairs.len().max(1) as f64;
        (shoulder, fits, misfit)
    };
    let best = SHOULDERS.iter().map(under).min_by(|a, b| a.2.total_cmp(&b.2));
    let (shoulder, fits, misfit) = best.unwrap_or((0.0, Vec::new(), 0.0));
    let contrast = 1.0 + 0.65 * shoulder / (shoulder + 1.5);
    let uncertainty = if shoulder == 0.0 && misfit < ROUNDING { CERTAIN } else { CAMERAS };
    let evs: Vec<f64> = fits.iter().map(|f| f.0 / contrast).collect();
    match whole(&evs, uncertainty) {
        Some(factor) => Steps { evs: evs.iter().map(|step| factor * step).collect(), uncertainty },
        None => Steps { evs, uncertainty },
    }
}

/// The step from `dark` to `bright` in EV; `None` where nothing is well exposed in both.
fn step(dark: &Brightness, bright: &Brightness) -> Option<f64> {
    steps(&[matches(dark, bright)?]).evs.first().copied()
}

/// Exposures from the pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// In EV, that of the darkest frame being 0.
    pub evs: Vec<f64>,
    /// The standard deviation of all differences, as a share of them.
    pub uncertainty: f64,
}

/// The exposures of `frames`, in their order. `None` where neighbours in brightness cannot be compared.
/// Ties go by index, so hand frames over in an order of their own.
pub fn estimate(frames: &[Brightness]) -> Option<Estimate> {
    let mut order: Vec<usize> = (0..frames.len()).collect();
    order.sort_by(|&a, &b| frames[a].mean().total_cmp(&frames[b].mean()));
    let pairs: Vec<Vec<Match>> =
        order.windows(2).map(|pair| matches(&frames[pair[0]], &frames[pair[1]])).collect::<Option<_>>()?;
    let steps = steps(&pairs);
    let mut evs = vec![0.0; frames.len()];
    for (pair, step) in order.windows(2).zip(&steps.evs) {
        evs[pair[1]] = evs[pair[0]] + step;
    }
    Some(Estimate { evs, uncertainty: steps.uncertainty })
}

/// What even `steps` are to be multiplied by, that they are a whole number of EV, as cameras bracket; `None` where no number is within twice the
/// `uncertainty`, or two are.
fn whole(steps: &[f64], uncertainty: f64) -> Option<f64> {
    let real: Vec<f64> = steps.iter().copied().filter(|&s| s > STEP).collect();
    let middle = median(&real);
    let off: Vec<f64> = real.iter().map(|s| (s - middle).abs()).collect();
    if real.len() < 2 || median(&off) > uncertainty * middle {
        return None;
    }
    let factors = (1..=5).map(|whole| f64::from(whole) / middle);
    let mut near = factors.filter(|factor| libm::log(*factor).abs() <= 2.0 * uncertainty);
    near.next().filter(|_| near.next().is_none())
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A scene of five decades, `ev` stops over the base, under the curve with the shoulder q and the exponent n; `shift` pixels to the side.
    fn seen(ev: f64, curve: (f64, f64), shift: usize) -> Brightness {
        seen_above(0, ev, curve, shift)
    }

    /// The same where nothing is below the code `floor`, under which a scanner or flare hides it.
    fn seen_above(floor: u8, ev: f64, (q, n): (f64, f64), shift: usize) -> Brightness {
        let (width, height) = (160, 120);
        let mut samples = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let scene =
                    ((x + shift) as f64 / 23.0).sin() + (y as f64 / 17.0).cos() + 0.3 * ((x * y) as f64 / 90.0).sin();
                let power = 2f64.powf(2.2 * scene + ev - 2.5).min(1.0).powf(n);
                let light = (1.0 + q) * power / (1.0 + q * power);
                let v = if light <= 0.0031308 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
                let noise = if floor > 0 { ((x * 7 + y * 13) % 5) as u8 } else { 0 };
                samples.extend([0, ((v.min(1.0) * 255.0).round() as u8).max(floor + noise), 0]);
            }
        }
        Brightness::of(&Samples::Eight(samples), width)
    }

    /// The same by a camera.
    fn picture(ev: f64, shift: usize) -> Brightness {
        seen(ev, (8.0, 1.5), shift)
    }

    #[test]
    fn even_steps_of_cameras_come_out_whole() {
        for (step, curve) in [(1.0, (8.0, 1.4)), (1.0, (8.0, 1.7)), (2.0, (4.0, 1.5)), (3.0, (16.0, 1.6))] {
            let frames: Vec<_> = (0..4).map(|i| seen(step * f64::from(i) - 4.0, curve, 3 * i as usize)).collect();
            let Estimate { evs, uncertainty } = estimate(&frames).unwrap();
            for (i, ev) in evs.iter().enumerate() {
                assert!((ev - step * i as f64).abs() < 0.12 * step, "{step} EV under {curve:?}: {evs:?}");
            }
            assert_eq!(uncertainty, CAMERAS);
        }
    }

    #[test]
    fn steps_of_rendered_pairs_are_right_to_a_twentieth_whatever_they_are() {
        for step in [0.4, 0.72, 1.35, 2.2, 3.3] {
            for base in [-3.0, -1.0, 0.5] {
                let Estimate { evs, uncertainty } =
                    estimate(&[seen(base, (0.0, 1.0), 0), seen(base + step, (0.0, 1.0), 0)]).unwrap();
                assert!((evs[1] / step - 1.0).abs() < 0.05, "{step} from {base}: {evs:?}");
                assert_eq!(uncertainty, CERTAIN);
            }
        }
    }

    #[test]
    fn steps_of_a_camera_are_within_the_uncertainty_that_is_told() {
        for curve in [(1.0, 1.2), (4.0, 1.45), (8.0, 1.5), (8.0, 1.7), (32.0, 1.65)] {
            let Estimate { evs, uncertainty } = estimate(&[seen(-2.0, curve, 0), seen(-0.3, curve, 5)]).unwrap();
            assert!((evs[1] / 1.7 - 1.0).abs() < 2.0 * uncertainty, "{curve:?}: {evs:?}");
            assert_eq!(uncertainty, CAMERAS);
        }
    }

    #[test]
    fn shadows_that_are_alike_in_all_frames_hide_no_step() {
        let frames: Vec<_> = (0..3).map(|i| seen_above(8, f64::from(i) - 4.0, (8.0, 1.5), 0)).collect();
        let Estimate { evs, .. } = estimate(&frames).unwrap();
        assert!(evs.windows(2).all(|pair| (pair[1] - pair[0] - 1.0).abs() < 0.2), "{evs:?}");
    }

    #[test]
    fn order_does_not_matter() {
        let frames: Vec<_> = [2.0, -1.0, 0.0, -2.0].map(|ev| picture(ev, 0)).into();
        let evs = estimate(&frames).unwrap().evs;
        let turned: Vec<_> = frames.iter().rev().cloned().collect();
        let back: Vec<f64> = estimate(&turned).unwrap().evs.into_iter().rev().collect();
        assert_eq!(evs, back);
        assert!(evs[3] == 0.0 && evs[0] > evs[2] && evs[2] > evs[1]);
    }

    #[test]
    fn equal_pictures_are_alike_and_contradict_nothing() {
        let frames = [picture(0.0, 0), picture(0.0, 9), picture(0.1, 4)];
        assert!(all_alike(&estimate(&frames).unwrap().evs));
        assert_eq!(contradiction(&[-3.0; 3], &frames), None);
    }

    #[test]
    fn equal_exposures_of_different_pictures_contradict() {
        let frames = [picture(0.0, 0), picture(1.0, 0)];
        assert!(contradiction(&[-5.0, -5.0], &frames).is_some());
        assert_eq!(contradiction(&[-5.0, -4.0], &frames), None);
        assert!(contradiction(&[-4.0, -5.0], &frames).is_some());
        // A third of a stop in light is weather, not a contradiction.
        assert_eq!(contradiction(&[0.0, 0.0], &[picture(0.0, 0), picture(0.3, 0)]), None);
    }

    #[test]
    fn a_step_that_is_far_off_contradicts() {
        let frames = [picture(0.0, 0), picture(2.0, 0)];
        // A millionth and a million are 20 EV; two EV more than there are may be a rough estimate.
        assert_eq!(contradiction(&[0.0, 4.0], &frames), None);
        assert!(contradiction(&[0.0, 22.0], &frames).is_some());
        assert!(contradiction(&[22.0, 0.0], &frames).is_some());
        let far = [picture(-2.0, 0), picture(2.0, 0)];
        assert!(contradiction(&[0.0, 0.5], &far).is_some());
        assert_eq!(contradiction(&[0.0, 2.5], &far), None);
    }

    #[test]
    fn the_few_are_at_odds_with_the_many() {
        let frames: Vec<_> = [-2.0, 0.0, 2.0, 1.0, -1.0].map(|ev| picture(ev, 0)).into();
        let true_evs = [-2.0, 0.0, 2.0, 1.0, -1.0];
        let with = |changes: &[(usize, f64)]| {
            let mut written = true_evs;
            changes.iter().for_each(|&(i, ev)| written[i] = ev);
            at_odds(&written, &frames)
        };
        assert_eq!(with(&[(2, 20.0)]), Some(vec![2]));
        assert_eq!(with(&[(1, -9.0), (3, 7.0)]), Some(vec![1, 3]));
        // ... whatever the contrast of the camera: of half of sRGB's the steps are seen at a third.
        let flat: Vec<_> = [-4.0, 0.0, 4.0, 2.0].map(|ev| seen(ev, (0.0, 0.5), 0)).into();
        assert_eq!(at_odds(&[-4.0, 0.0, 20.0, 2.0], &flat), Some(vec![2]));
        // Of two without which nothing contradicts, that without which the steps are nearest.
        assert_eq!(at_odds(&[-2.0, 2.5, 2.0], &frames[..3]), Some(vec![1]));
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
