//! Samples: places of the scene with their codes in the frames, and the code up to which a frame is black.
//!
//! In: a bracket and its alignment. Out: for each channel, [`Sample`]s from flat places of the overlap, spread over
//! picture and brightness; the same on any number of threads. Cost: a bounded number of 5x5 patches is read, at most
//! about 20 ms on two cores for any size. Source: Debevec & Malik 1997, section 2.1, on how to choose pixels: well
//! distributed in the picture and over the codes, from places of low variance, so that noise and edges do not matter.
//! They choose a few dozen pixels by hand; here the samples are means over thousands of patches.

use crate::align::resampling::nearest::{Strip, placed};
use crate::align::{Alignment, Rect};
use crate::bracket::{Bracket, Codes};
use crate::error::Result;
use crate::statistics::of_rank;
use rayon::prelude::*;
use std::cmp::Ordering;
use std::f64::consts::LN_2;
use std::ops::Range;

/// Side of a patch in pixels.
const PATCH: usize = 5;
/// Number of candidate patches along each side of a cell of the picture. The flattest candidate of the cell is used.
const TRIES: usize = 2;
/// Largest number of patches that are read, for any size and number of frames.
const READ: usize = 60_000;
/// A patch is used in a frame if all its codes are in this range; codes beyond it may be clipped.
const SEEN: (f64, f64) = (2.0, 253.0);
/// Largest standard deviation within a flat patch, in codes.
const ROUGH: f64 = 12.0;
/// If a patch is darker in a longer exposure than in a shorter one, and the difference exceeds a tolerance, something
/// moved. The tolerance is this number of codes plus the noise of the patch.
const DARKER: f64 = 2.0;
/// Smallest increase of a patch's code per stop of exposure: the larger one of a fraction of the code and a number of
/// codes. If the increase is smaller, the shorter exposure is at the black of the film or sensor, and is not used.
/// Camera curves rise by a fifth to a third of the code per stop.
const RISE: (f64, f64) = (0.05, 0.5);
/// Two parameters of the estimate of black. First, the smallest number of patches that is sufficient. Second, the
/// fraction of their codes that is below the estimate.
const BLACK: (usize, f64) = (20, 0.95);
/// This code and higher codes are never black.
const DARK: f64 = 64.0;
/// Number of bins of brightness. Samples are distributed evenly to the bins.
const BINS: usize = 32;

/// A place in one frame and one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Z, the mean code of the patch, on the scale 0..=255 for any depth.
    pub code: f64,
    /// ln dt of the frame, where dt is its relative exposure divided by the relative exposure of the reference.
    pub ln_time: f64,
}

/// A place in one channel in frames of different exposure: at least two views, by rising exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The views; none is clipped.
    pub views: Vec<View>,
}

/// One channel of a patch.
#[derive(Debug, Clone, Copy)]
struct Patch {
    mean: f64,
    deviation: f64,
    seen: bool,
}

/// A place of the scene, with its patches in every frame. A patch is `None` if the frame does not cover the place.
#[derive(Debug, Clone)]
struct Candidate {
    /// Column and row of the patch's top-left pixel in the reference.
    at: (usize, usize),
    patches: Vec<Option<[Patch; 3]>>,
    roughness: f64,
}

/// The flat places of a bracket, with their codes in all merged frames.
#[derive(Debug, Clone, Default)]
pub struct Places {
    /// For each frame, by rising exposure: its index in the bracket, and ln dt, where dt is its exposure divided by the
    /// exposure of the reference.
    frames: Vec<(usize, f64)>,
    places: Vec<Candidate>,
}

/// A place in one channel, in a shorter and a longer exposure; neither is clipped or at the black of the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    /// Column and row of the place in the reference.
    pub at: (usize, usize),
    /// 0, 1 or 2: R, G or B.
    pub channel: usize,
    /// The mean codes of the patch in the shorter and the longer exposure, on the scale 0..=255.
    pub codes: (f64, f64),
}

/// Samples drawn from the places, and the black of each channel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Drawn {
    /// Samples for R, G and B.
    pub channels: [Vec<Sample>; 3],
    /// The code of R, G and B up to which a frame is black, including noise; 0 if no frame is.
    pub black: [f64; 3],
}

impl Places {
    /// Finds the flat places in the frames of `bracket`.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch) if frames are on disk.
    pub fn of(bracket: &Bracket, alignment: &Alignment) -> Result<Self> {
        let frames = placed(bracket, alignment);
        let mut seen = Places { frames: frames.iter().map(|frame| (frame.index, 0.0)).collect(), places: Vec::new() };
        seen.time(bracket);
        if frames.len() < 2 {
            return Ok(seen);
        }
        let Rect { x0, y0, x1, .. } = alignment.overlap;
        let (width, height) = (alignment.overlap.width(), alignment.overlap.height());
        let cells = (READ / (TRIES * TRIES * frames.len())).max(1);
        let side = ((width * height) as f64 / cells as f64).sqrt().max((TRIES * PATCH) as f64);
        let (columns, rows) = ((width as f64 / side) as usize, (height as f64 / side) as usize);
        let at = |cell: usize, k: usize| ((cell as f64 + k as f64 / TRIES as f64) * side) as usize;
        let strips: Vec<Result<Vec<Candidate>>> = (0..rows)
            .into_par_iter()
            .map(|row| {
                let read = y0 + at(row, 0)..y0 + at(row, TRIES - 1) + PATCH;
                let strips = frames.iter().map(|frame| frame.strip(&(x0..x1), &read)).collect::<Result<Vec<_>>>()?;
                let best = |column: usize| {
                    let tries = (0..TRIES * TRIES).map(|k| (x0 + at(column, k % TRIES), y0 + at(row, k / TRIES)));
                    tries.filter_map(|(x, y)| look(&strips, x, y)).min_by(|a, b| a.roughness.total_cmp(&b.roughness))
                };
                Ok((0..columns).filter_map(best).collect())
            })
            .collect();
        seen.places = strips.into_iter().collect::<Result<Vec<_>>>()?.concat();
        Ok(seen)
    }

    /// Keeps as many places as possible, evenly over the picture, so that there are at most `patches` patches in all
    /// frames together. Keeps all places if they have no more patches than that.
    pub fn thin(&mut self, patches: usize) {
        let (all, kept) = (self.places.len(), patches / self.frames.len().max(1));
        if all <= kept {
            return;
        }
        let mut index = 0;
        self.places.retain(|_| {
            index += 1;
            index * kept / all > (index - 1) * kept / all
        });
        self.places.shrink_to_fit();
    }

    /// Pairs each frame with the next one that is longer by `least` stops or more. Returns for each pair the number of
    /// stops between both frames, and the codes of both at each place.
    pub(super) fn steps(&self, least: f64) -> Vec<(f64, Vec<Step>)> {
        let stops = |i: usize, j: usize| (self.frames[j].1 - self.frames[i].1) / LN_2;
        let next = |i: usize| (i + 1..self.frames.len()).find(|&j| stops(i, j) >= least).map(|j| (i, j));
        let pairs = (0..self.frames.len()).filter_map(next);
        let of = |place: &Candidate, channel: usize, i: usize, j: usize| {
            let usable = telling(place, &self.frames, channel);
            let patch = |k: usize| place.patches[k].filter(|_| usable.contains(&k)).map(|patch| patch[channel]);
            let (shorter, longer) = (patch(i)?, patch(j)?);
            let seen = shorter.seen && longer.seen;
            seen.then_some(Step { at: place.at, channel, codes: (shorter.mean, longer.mean) })
        };
        let all = |(i, j): (usize, usize)| {
            let steps = self.places.iter().flat_map(|place| (0..3).filter_map(move |c| of(place, c, i, j)));
            (stops(i, j), steps.collect())
        };
        pairs.map(all).collect()
    }

    /// Returns the code of R, G and B up to which a frame is black, including noise; 0 if no frame is.
    pub(super) fn black(&self) -> [f64; 3] {
        std::array::from_fn(|channel| black(&[self], channel))
    }

    /// Updates the exposures to those that `bracket` has now.
    pub fn time(&mut self, bracket: &Bracket) {
        let reference = bracket.reference().exposure.relative();
        for (index, ln_time) in &mut self.frames {
            *ln_time = libm::log(bracket.frames()[*index].exposure.relative() / reference);
        }
    }
}

/// Draws at most `count` samples for each of R, G and B from all the brackets of one camera together, and estimates the
/// code up to which frames are black.
pub fn draw(brackets: &[&Places], count: usize) -> Drawn {
    let drawn: Vec<_> = (0..3).into_par_iter().map(|c| (spread(brackets, c, count), black(brackets, c))).collect();
    let mut all = Drawn::default();
    for (c, (samples, black)) in drawn.into_iter().enumerate() {
        (all.channels[c], all.black[c]) = (samples, black);
    }
    all
}

/// Compares each frame, by rising exposure, with the next longer frame. Returns the index of the shorter frame, and
/// whether the place is brighter or darker by more than [`RISE`] in the longer one.
fn changes(place: &Candidate, frames: &[(usize, f64)], channel: usize) -> Vec<(usize, Ordering)> {
    let views = place.patches.iter().zip(frames).enumerate();
    let views: Vec<_> =
        views.filter_map(|(i, (p, (_, ln_time)))| Some((i, p.as_ref()?[channel].mean, ln_time / LN_2))).collect();
    let change = |pair: &[(usize, f64, f64)]| {
        let (step, rise) = (pair[1].2 - pair[0].2, pair[1].1 - pair[0].1);
        let least = step * (RISE.0 * pair[0].1).max(RISE.1);
        let change = if rise.abs() > least { rise.total_cmp(&0.0) } else { Ordering::Equal };
        (pair[0].0, change)
    };
    views.windows(2).map(change).collect()
}

/// Returns the range of indices of the frames that measure a place. It starts at the first frame whose next longer
/// frame shows the place brighter; in the frames before it, the place is black. If there is no such frame, the range
/// contains all frames.
fn telling(place: &Candidate, frames: &[(usize, f64)], channel: usize) -> Range<usize> {
    first_rise(&changes(place, frames, channel))..frames.len()
}

/// Returns the index of the first frame whose next longer frame shows the place brighter; 0 if there is none, because
/// the place is black in all frames or white in all frames.
fn first_rise(changes: &[(usize, Ordering)]) -> usize {
    changes.iter().find(|(_, change)| change.is_gt()).map_or(0, |(i, _)| *i)
}

/// Returns the code up to which a frame is black: the codes of patches that do not become brighter, plus two standard
/// deviations of their noise. A patch with motion may not become brighter either. But then other patches with the same
/// code do, so this code does not count as black.
fn black(seen: &[&Places], channel: usize) -> f64 {
    let dark = |patch: &&[Patch; 3]| patch[channel].mean < DARK;
    let (mut underexposed, mut exposed) = (Vec::new(), Vec::new());
    for (frames, place) in seen.iter().flat_map(|seen| seen.places.iter().map(|place| (&seen.frames, place))) {
        let changes = changes(place, frames, channel);
        let first = first_rise(&changes);
        underexposed.extend(place.patches[..first].iter().flatten().filter(dark).map(|patch| patch[channel]));
        for (i, change) in changes.into_iter().filter(|(i, _)| *i >= first) {
            let Some(patch) = place.patches[i].as_ref().filter(dark) else { continue };
            match change {
                Ordering::Greater => exposed.push(patch[channel].mean),
                // In black, noise makes the longer exposure darker as often as brighter; in other tones noise never
                // makes it darker.
                Ordering::Less => underexposed.push(patch[channel]),
                Ordering::Equal => {}
            }
        }
    }
    let end = parting(underexposed.iter().map(|patch| patch.mean), exposed);
    let noisy = underexposed.iter().filter(|patch| patch.mean <= end).map(|patch| patch.mean + 2.0 * patch.deviation);
    let codes: Vec<f64> = noisy.filter(|&code| code < DARK).collect();
    let rank = ((codes.len() as f64 * BLACK.1) as usize).min(codes.len().saturating_sub(1));
    if codes.len() < BLACK.0 { 0.0 } else { of_rank(codes, rank).unwrap_or(0.0) }
}

/// Returns the code that best separates `below` from `above`: the fewest codes of `below` are larger than it, and the
/// fewest codes of `above` are not. It is `f64::MIN` if the separation is best when all codes count as `above`.
fn parting(below: impl Iterator<Item = f64>, above: Vec<f64>) -> f64 {
    let mut codes: Vec<(f64, i32)> =
        below.map(|code| (code, 1)).chain(above.into_iter().map(|code| (code, -1))).collect();
    codes.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
    let (mut most, mut right, mut end) = (0, 0, f64::MIN);
    for (code, gain) in codes {
        right += gain;
        if right > most {
            (most, end) = (right, code);
        }
    }
    end
}

/// Reads the patch whose top-left pixel is (x, y) of the reference in all frames. Returns `None` if the patch is not
/// flat, or if it shows motion.
fn look(frames: &[Strip], x: usize, y: usize) -> Option<Candidate> {
    let mut patches: Vec<Option<[Patch; 3]>> = Vec::with_capacity(frames.len());
    let mut roughness: f64 = 0.0;
    for strip in frames {
        let patch = read(strip, x, y);
        for p in patch.iter().flatten().filter(|p| p.seen) {
            roughness = roughness.max(p.deviation);
        }
        if roughness > ROUGH {
            return None;
        }
        patches.push(patch);
    }
    (0..3).all(|channel| brightens(&patches, channel)).then_some(Candidate { at: (x, y), patches, roughness })
}

/// Whether every exposure is at least as bright as all shorter ones, except for noise; false for moving objects.
fn brightens(patches: &[Option<[Patch; 3]>], channel: usize) -> bool {
    let mut brightest = f64::MIN;
    patches.iter().flatten().map(|patch| patch[channel]).all(|p| {
        // The mean of n pixels has a standard error of deviation / sqrt(n). Differences of up to three standard errors
        // may be due to noise.
        let tolerance = DARKER + 3.0 * p.deviation / PATCH as f64;
        let rises = p.mean >= brightest - tolerance;
        brightest = brightest.max(p.mean);
        rises
    })
}

/// Reads the patch of a frame at (x, y) of the reference. The nearest pixel is exact enough, because a flat patch
/// does not change if it is displaced by part of a pixel.
fn read(strip: &Strip, x: usize, y: usize) -> Option<[Patch; 3]> {
    let start = strip.start(x, y, PATCH)?;
    let stride = 3 * strip.window.width();
    Some(match strip.window.codes() {
        Codes::Eight(codes) => measure(&codes[start..], stride, 1.0),
        Codes::Sixteen(codes) => measure(&codes[start..], stride, 257.0),
    })
}

/// Returns the mean and the standard deviation of the patch at the start of `codes`. Dividing by `scale` converts codes
/// to the scale 0..=255.
fn measure<T: Copy + Into<u64>>(codes: &[T], stride: usize, scale: f64) -> [Patch; 3] {
    let (mut sum, mut squares, mut least, mut most) = ([0u64; 3], [0u64; 3], [u64::MAX; 3], [0u64; 3]);
    for row in codes.chunks(stride).take(PATCH) {
        for pixel in row[..3 * PATCH].chunks_exact(3) {
            for c in 0..3 {
                let code: u64 = pixel[c].into();
                sum[c] += code;
                squares[c] += code * code;
                least[c] = least[c].min(code);
                most[c] = most[c].max(code);
            }
        }
    }
    let n = (PATCH * PATCH) as f64;
    std::array::from_fn(|c| {
        let mean = sum[c] as f64 / n;
        Patch {
            mean: mean / scale,
            deviation: (squares[c] as f64 / n - mean * mean).max(0.0).sqrt() / scale,
            seen: least[c] as f64 >= SEEN.0 * scale && most[c] as f64 <= SEEN.1 * scale,
        }
    })
}

/// Returns at most `count` samples of a channel. All bins of brightness get the same number of samples, or fewer if a
/// bin has too few places. The flattest places of each bin are used.
fn spread(seen: &[&Places], channel: usize, count: usize) -> Vec<Sample> {
    let mut bins: [Vec<(f64, usize)>; BINS] = Default::default();
    let all: Vec<_> = seen.iter().flat_map(|seen| seen.places.iter().map(|place| (place, &seen.frames))).collect();
    for (index, &(place, frames)) in all.iter().enumerate() {
        let codes: Vec<Patch> = place.patches.iter().flatten().map(|patch| patch[channel]).collect();
        if sample(place, frames, channel).views.len() >= 2 {
            let mean = codes.iter().map(|p| p.mean).sum::<f64>() / codes.len() as f64;
            bins[((mean * BINS as f64 / 256.0) as usize).min(BINS - 1)].push((place.roughness, index));
        }
    }
    let total = |cap: usize| bins.iter().map(|bin| bin.len().min(cap)).sum::<usize>();
    let cap = (1..=count).take_while(|&cap| total(cap) <= count).last().unwrap_or(0);
    for bin in &mut bins {
        bin.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        bin.truncate(cap);
    }
    let chosen = bins.iter().flatten().map(|&(_, index)| all[index]);
    chosen.map(|(place, frames)| sample(place, frames, channel)).collect()
}

/// Returns the views of a place in a channel that are not clipped.
fn sample(place: &Candidate, frames: &[(usize, f64)], channel: usize) -> Sample {
    let range = telling(place, frames, channel);
    let views = place.patches[range.clone()].iter().zip(&frames[range]).filter_map(|(patch, &(_, ln_time))| {
        let patch = patch.as_ref()?[channel];
        patch.seen.then_some(View { code: patch.mean, ln_time })
    });
    Sample { views: views.collect() }
}

#[cfg(test)]
mod tests;
