//! Samples: places of the scene, and the codes by which the frames saw them; and up to which code a frame is black.
//!
//! In: a bracket and its alignment. Out: for each channel, [`Sample`]s from flat places of the overlap, spread over picture and
//! brightness; the same whatever the number of threads. Cost: a bounded number of 5x5 patches is read, about 20 ms at most on two cores, whatever the size.
//! Source: Debevec & Malik 1997, section 2.1, on how to choose pixels: well distributed in the picture and over the codes, from places
//! of low variance, so that neither noise nor the sampling of an edge counts. Where they take a few dozen pixels by hand, these are
//! means over patches, by the thousand.

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
/// Candidates on a side of a cell, of which the flattest is taken.
const TRIES: usize = 2;
/// Patches that are read in all, at most, whatever the size and the number of frames.
const READ: usize = 60_000;
/// A frame saw a patch if all its codes are in this range: those beyond may be clipped, or nearly so.
const SEEN: (f64, f64) = (2.0, 253.0);
/// Standard deviation within a patch, in codes, above which it is no flat place.
const ROUGH: f64 = 12.0;
/// Codes by which a longer exposure may be darker than a shorter one, beside what the patches' noise explains.
const DARKER: f64 = 2.0;
/// Codes by which a stop more of exposure must brighten a patch, at least, as a share of its code and absolutely: where it does not,
/// the shorter exposure is at the black of the film or the sensor, and says nothing. A camera's curve rises by a fifth to a third.
const RISE: (f64, f64) = (0.05, 0.5);
/// Black is estimated if this many patches show it, and is above this share of them.
const BLACK: (usize, f64) = (20, 0.95);
/// Codes from here on are not black, whatever they say.
const DARK: f64 = 64.0;
/// Steps of brightness among which samples are spread.
const BINS: usize = 32;

/// One frame's view of a place, in one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Z, the mean code of the patch, on the scale 0..=255 whatever the depth.
    pub code: f64,
    /// ln dt of the frame: its relative exposure over that of the reference.
    pub ln_time: f64,
}

/// The views that frames of different exposure have of one place, in one channel; at least two, by rising exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// None is clipped.
    pub views: Vec<View>,
}

/// One channel of a patch.
#[derive(Debug, Clone, Copy)]
struct Patch {
    mean: f64,
    deviation: f64,
    seen: bool,
}

/// A place as all frames saw it; none for a frame that does not cover it.
#[derive(Debug, Clone)]
struct Candidate {
    /// Column and row of the patch's top-left pixel in the reference.
    at: (usize, usize),
    patches: Vec<Option<[Patch; 3]>>,
    roughness: f64,
}

/// The flat places of a bracket, and what the frames that were placed have of them.
#[derive(Debug, Clone, Default)]
pub struct Places {
    /// ln dt of each frame over the reference's, by rising exposure, and which of the bracket's it is.
    frames: Vec<(usize, f64)>,
    places: Vec<Candidate>,
}

/// One place in one channel, as a shorter and a longer exposure saw it; neither is clipped, nor at the black of the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    /// Column and row of the place in the reference.
    pub at: (usize, usize),
    /// 0, 1 or 2: R, G or B.
    pub channel: usize,
    /// The mean codes of the patch in the shorter and the longer exposure, on the scale 0..=255.
    pub codes: (f64, f64),
}

/// What the scene shows of each channel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Drawn {
    /// Samples for R, G and B.
    pub channels: [Vec<Sample>; 3],
    /// The code of R, G and B up to which a frame is black, noise included; 0 where it shows none.
    pub black: [f64; 3],
}

impl Places {
    /// The flat places that the frames of `bracket` saw.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch), where frames are on disk.
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

    /// Keeps places that have no more than `patches` patches together, evenly over the picture; where there are fewer, all.
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

    /// For each frame the next that was exposed longer by `least` stops or more: by how many, and what the two saw of each place, place by
    /// place.
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

    /// The code of R, G and B up to which a frame is black, noise included; 0 where it shows none.
    pub(super) fn black(&self) -> [f64; 3] {
        std::array::from_fn(|channel| black(&[self], channel))
    }

    /// Takes the exposures that `bracket`, of which the places are, has now.
    pub fn time(&mut self, bracket: &Bracket) {
        let reference = bracket.reference().exposure.relative();
        for (index, ln_time) in &mut self.frames {
            *ln_time = libm::log(bracket.frames()[*index].exposure.relative() / reference);
        }
    }
}

/// At most `count` samples for each of R, G and B from all the brackets of one camera together, and where its black is.
pub fn draw(brackets: &[&Places], count: usize) -> Drawn {
    let drawn: Vec<_> = (0..3).into_par_iter().map(|c| (spread(brackets, c, count), black(brackets, c))).collect();
    let mut all = Drawn::default();
    for (c, (samples, black)) in drawn.into_iter().enumerate() {
        (all.channels[c], all.black[c]) = (samples, black);
    }
    all
}

/// Whether a place becomes brighter or darker, by more than [`RISE`], from each frame that shows it to the next longer one; by rising exposure.
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

/// The range of frames that measure a place: not those so short that a longer one is no brighter.
fn telling(place: &Candidate, frames: &[(usize, f64)], channel: usize) -> Range<usize> {
    first_rise(&changes(place, frames, channel))..frames.len()
}

/// The frame from which on a place becomes brighter; the first where it never does: it is black or white throughout.
fn first_rise(changes: &[(usize, Ordering)]) -> usize {
    changes.iter().find(|(_, change)| change.is_gt()).map_or(0, |(i, _)| *i)
}

/// The code up to which a frame is black: where the patches are that say nothing, with two standard deviations for their noise. A patch that something
/// moved across says nothing either, but among others as dark that do.
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
                // Noise makes black darker as often as brighter.
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

/// The code that best parts what is `below` from what is `above`: the fewest lie on the wrong side. The least code of all where none is below.
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

/// What the frames have of the patch whose top-left pixel is (x, y) of the reference, if it is flat and did not change.
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

/// Whether no longer exposure is darker than a shorter one: what moves, is not.
fn brightens(patches: &[Option<[Patch; 3]>], channel: usize) -> bool {
    let mut brightest = f64::MIN;
    patches.iter().flatten().map(|patch| patch[channel]).all(|p| {
        // The mean of n pixels is uncertain by deviation / sqrt(n); three of those are chance.
        let tolerance = DARKER + 3.0 * p.deviation / PATCH as f64;
        let rises = p.mean >= brightest - tolerance;
        brightest = brightest.max(p.mean);
        rises
    })
}

/// The patch of a frame that lies on (x, y) of the reference. A flat patch bears being moved by part of a pixel, so that the
/// nearest whole pixel does.
fn read(strip: &Strip, x: usize, y: usize) -> Option<[Patch; 3]> {
    let start = strip.start(x, y, PATCH)?;
    let stride = 3 * strip.window.width();
    Some(match strip.window.codes() {
        Codes::Eight(codes) => measure(&codes[start..], stride, 1.0),
        Codes::Sixteen(codes) => measure(&codes[start..], stride, 257.0),
    })
}

/// Mean and spread of the patch that `codes` begins with; `scale` codes are one on the scale 0..=255.
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

/// At most `count` samples of a channel, as equal in number over the steps of brightness as there are places; the flattest of each.
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

/// The views of a place in a channel that are not clipped.
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
