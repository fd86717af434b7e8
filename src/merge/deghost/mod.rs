//! Deghosting: where the other frames show something else than the reference.
//!
//! In: a bracket, where its frames lie, and what their codes mean. Out: [`Ghosts`], for each frame and pixel how far it may take part.
//! Cost: some 400 ns of one core for each cell of each frame, which is 100 ns a pixel at 1.5 MP and under 10 at 12 MP; 70 bytes for each of at
//! most a million cells (more only beyond 64 MP), whatever the number of frames, and a byte for each cell of each frame. Source:
//! the reference as the standard, and the frame's departure from it against what noise allows, are those of Ward's hdrgen (option `-g`);
//! the noise model, the chain of standards and the scales are ours.
//!
//! 1. Every frame is averaged to radiance over cells of 2x2 pixels (4x4 and more in large pictures).
//! 2. Frame by frame, from the reference towards the shorter and towards the longer exposures, the cells are compared with a standard: the
//!    reference, and where that clips or is black, the nearest frame that agrees with it. What a clipped or black code says is
//!    only a bound.
//! 3. The differences, in units of their standard deviation and with their signs, are averaged over larger and larger cells: what alignment,
//!    noise and JPEG leave cancels, what moved adds up. The strongest scale decides; the three channels have one verdict.
//! 4. The verdict is widened and smoothed: a factor in 0..=1, one for all channels, by which the frame's weight is multiplied.
//!
//! On five truth brackets with a mover, hdrgen's e^2 / (e^2 + d^2) with e = 0.08 in the place of all this has a PU21-PSNR 2 to 20 dB below
//! that of leaving the ghosts in: it takes every frame's noise for motion.

pub(super) mod cells;
mod evidence;

use crate::align::warp::Warp;
use crate::align::{Alignment, Rect};
use crate::bracket::{Bracket, Frame};
use crate::budget::Demand;
use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::pyramid::between_cells;
use crate::response::{CODES, ResponseCurve};
use cells::{Cell, Meaning};
use serde::Serialize;
use std::ops::Range;
use std::path::Path;

/// Most cells of a picture, but that none is larger than `LARGEST`.
const MOST_CELLS: usize = Demand::MOST_CELLS as usize;
/// The longest side of a cell, in pixels.
const LARGEST: usize = 8;
/// A frame left out by more than this does not become the standard.
const AGREES: f32 = 0.3;
/// How far around what moved a frame is left out, in pixels: the edges of what moved are mixed with the background.
const MARGIN: usize = 4;

/// How readily a difference is taken for motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deghost {
    /// 0..=1: how much of a difference is too much. At 0.5 a frame is left out in part from 2 standard deviations and wholly from 4;
    /// 0 takes twice, 1 half as many.
    pub strength: f64,
}

impl Default for Deghost {
    fn default() -> Self {
        Deghost { strength: 0.5 }
    }
}

impl Deghost {
    /// Whether the strength is within its range.
    ///
    /// # Errors
    /// [`Error::Option`].
    pub fn validate(&self) -> Result<()> {
        if (0.0..=1.0).contains(&self.strength) {
            return Ok(());
        }
        let reason = format!("{} is no strength; give 0 (least) to 1 (most), as in `--deghost=0.5`", self.strength);
        Err(Error::Option { option: "--deghost", reason })
    }

    /// The standard deviations from which a frame is left out in part, and wholly.
    fn limits(&self) -> (f32, f32) {
        let scale = libm::exp2(1.0 - 2.0 * self.strength) as f32;
        (2.0 * scale, 4.0 * scale)
    }
}

/// How far each frame may take part, over a region of the reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Ghosts {
    region: Rect,
    side: usize,
    strength: f64,
    /// One for each placed frame by rising exposure: its path, and for each cell the factor times 255; none for the reference.
    frames: Vec<(String, Option<Plane<u8>>)>,
}

/// What was left out, for the report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GhostReport {
    /// The strength used.
    pub strength: f64,
    /// The share of the result, by cells, in which some frame was left out by more than half.
    pub ghost_fraction: f64,
    /// The frames but the reference, by rising exposure.
    pub frames: Vec<GhostFrame>,
}

/// What was left out of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GhostFrame {
    /// The file, as it was named.
    pub path: String,
    /// The share of the result, by cells, in which it was left out by more than half.
    pub ghost_fraction: f64,
}

/// A placed frame as it is compared.
pub(super) struct Layer<'a> {
    pub(super) frame: &'a Frame,
    warp: Warp,
    pub(super) meaning: Meaning,
}

/// The placed frames of `bracket` by rising exposure, and which of them is the reference.
pub(super) fn layers<'a>(
    bracket: &'a Bracket,
    alignment: &Alignment,
    curve: &ResponseCurve,
) -> (Vec<Layer<'a>>, usize) {
    let unit = bracket.reference().exposure.relative();
    let placed = bracket.frames().iter().zip(&alignment.verdicts).enumerate();
    let mut layers = Vec::new();
    let mut reference = 0;
    for (index, (frame, verdict)) in placed {
        if let Some(warp) = verdict.warp {
            if index == bracket.reference_index() {
                reference = layers.len();
            }
            let meaning = Meaning::of(curve, frame.exposure.relative() / unit);
            layers.push(Layer { frame, warp, meaning });
        }
    }
    (layers, reference)
}

/// Where in `region` each placed frame shows something else than the reference.
///
/// # Errors
/// [`Error::Option`] where the strength is out of its range; [`Error::Scratch`].
pub fn find(
    bracket: &Bracket,
    alignment: &Alignment,
    curve: &ResponseCurve,
    region: Rect,
    options: &Deghost,
) -> Result<Ghosts> {
    find_with_gain(bracket, alignment, curve, region, options, &|_, _, _| 1.0)
}

/// As [`find`], of frames that are locally processed: before they are compared, the radiance of frame i (of the placed ones, by rising exposure) at column x and
/// row y of the region is multiplied by `gain(i, x, y)`.
///
/// # Errors
/// Those of [`find`].
pub fn find_with_gain(
    bracket: &Bracket,
    alignment: &Alignment,
    curve: &ResponseCurve,
    region: Rect,
    options: &Deghost,
    gain: &(dyn Fn(usize, usize, usize) -> f32 + Sync),
) -> Result<Ghosts> {
    options.validate()?;
    let (layers, reference) = layers(bracket, alignment, curve);
    let side = side(region);
    let mut frames: Vec<(String, Option<Plane<u8>>)> =
        layers.iter().map(|layer| (layer.frame.path().to_string_lossy().into_owned(), None)).collect();
    let seen = |i: usize| {
        let mut cells = cells::average(&layers[i], region, side, i as u16)?;
        cells.fill_rows(|y, row| {
            for (x, cell) in row.iter_mut().enumerate() {
                let factor = gain(i, side * x + side / 2, side * y + side / 2);
                cell.radiance.iter_mut().for_each(|v| *v *= factor);
            }
        });
        Ok::<_, Error>(cells)
    };
    for outwards in [(0..reference).rev().collect::<Vec<_>>(), (reference + 1..layers.len()).collect()] {
        if outwards.is_empty() {
            continue;
        }
        let mut standard = seen(reference)?;
        for i in outwards {
            let frame = seen(i)?;
            let meanings: Vec<&Meaning> = layers.iter().map(|layer| &layer.meaning).collect();
            let moved = evidence::moved(&standard, &frame, &meanings, side, options.limits());
            let moved = evidence::widened(&moved, MARGIN.div_ceil(side));
            take_over(&mut standard, &frame, &moved, &meanings);
            frames[i].1 = Some(Plane::from_rows(moved.width(), moved.height(), |y, row| {
                for (kept, m) in row.iter_mut().zip(moved.row(y)) {
                    *kept = (255.0 * (1.0 - m) + 0.5) as u8;
                }
            }));
        }
    }
    Ok(Ghosts { region, side, strength: options.strength, frames })
}

/// The side of a cell in pixels.
fn side(region: Rect) -> usize {
    let cells = |side: usize| region.width().div_ceil(side) * region.height().div_ceil(side);
    let mut side = 2;
    while side < LARGEST && cells(side) > MOST_CELLS {
        side *= 2;
    }
    side
}

/// Where the standard knows only a bound, or little, and the frame that agrees with it knows more, the frame becomes the standard.
fn take_over(standard: &mut Plane<Cell>, frame: &Plane<Cell>, moved: &Plane<f32>, meanings: &[&Meaning]) {
    standard.fill_rows(|y, row| {
        for ((s, f), m) in row.iter_mut().zip(frame.row(y)).zip(moved.row(y)) {
            if *m > AGREES || f.is_outside() {
                continue;
            }
            // All channels or none: a standard has one source.
            let gain = |c: usize| match (s.is_bound(c), f.is_bound(c)) {
                (true, false) => 1,
                (false, true) => -1,
                _ => {
                    let (s, f) = (s.relative_noise(c, meanings), f.relative_noise(c, meanings));
                    i32::from(s > 0.1 && f < 0.5 * s)
                }
            };
            if s.is_outside() || (0..3).map(gain).sum::<i32>() > 0 {
                *s = *f;
            }
        }
    });
}

impl Ghosts {
    /// Whether they are of this region and of these placed frames by rising exposure.
    ///
    /// # Errors
    /// [`Error::Option`] with what they are of.
    pub(super) fn check(&self, region: Rect, frames: &[&Path]) -> Result<()> {
        let refused = |reason| Err(Error::Option { option: "--deghost", reason });
        if self.region != region {
            let Rect { x0, y0, x1, y1 } = self.region;
            return refused(format!(
                "its ghosts were found in columns {x0}..{x1} and rows {y0}..{y1}; find them in the region that is merged"
            ));
        }
        let is_of = |((path, _), frame): (&(String, _), &&Path)| *path == frame.to_string_lossy();
        if self.frames.len() != frames.len() || !self.frames.iter().zip(frames).all(is_of) {
            return refused("its ghosts were found in other frames; find them in those that are merged".to_owned());
        }
        Ok(())
    }

    /// The factors of frame `layer` (of the placed frames, by rising exposure) at `rows` of the region, by rows; nothing where they are 1.
    pub fn kept(&self, layer: usize, rows: Range<usize>) -> Vec<f32> {
        let Some((_, Some(map))) = self.frames.get(layer) else { return Vec::new() };
        let (first, last) =
            (place(rows.start, self.side, map.height()).0, place(rows.end - 1, self.side, map.height()).1);
        if map.rows(first..last + 1).iter().all(|&kept| kept == u8::MAX) {
            return Vec::new();
        }
        let mut out = Vec::with_capacity(rows.len() * self.region.width());
        let mut line = vec![0.0f32; map.width()];
        for y in rows {
            let (above, below, f) = place(y, self.side, map.height());
            for ((v, a), b) in line.iter_mut().zip(map.row(above)).zip(map.row(below)) {
                let (a, b) = (f32::from(*a), f32::from(*b));
                *v = (a + f * (b - a)) * (1.0 / 255.0);
            }
            out.extend((0..self.region.width()).map(|x| {
                let (left, right, f) = place(x, self.side, map.width());
                line[left] + f * (line[right] - line[left])
            }));
        }
        out
    }

    /// Where and how much was left out, at the size of the region: 0 where all frames take part, 255 where all but the reference are left
    /// out, in proportion between.
    pub fn mask(&self) -> Plane<u8> {
        let others = self.frames.iter().filter(|(_, map)| map.is_some()).count().max(1) as f32;
        Plane::from_rows(self.region.width(), self.region.height(), |y, row| {
            let mut left_out = vec![0.0f32; row.len()];
            for i in 0..self.frames.len() {
                left_out.iter_mut().zip(self.kept(i, y..y + 1)).for_each(|(sum, kept)| *sum += 1.0 - kept);
            }
            for (v, sum) in row.iter_mut().zip(left_out) {
                *v = (255.0 * sum / others + 0.5) as u8;
            }
        })
    }

    /// How much was left out.
    pub fn report(&self) -> GhostReport {
        let maps = || self.frames.iter().filter_map(|(path, map)| Some((path, map.as_ref()?.as_slice())));
        // Half of 255, rounded up.
        let is_ghost = |kept: &u8| *kept < 128;
        let cells = maps().next().map_or(0, |(_, map)| map.len());
        let share = |count: usize| count as f64 / cells.max(1) as f64;
        let any = (0..cells).filter(|&i| maps().any(|(_, map)| is_ghost(&map[i]))).count();
        let of = |(path, map): (&String, &[u8])| GhostFrame {
            path: path.clone(),
            ghost_fraction: share(map.iter().filter(|kept| is_ghost(kept)).count()),
        };
        GhostReport { strength: self.strength, ghost_fraction: share(any), frames: maps().map(of).collect() }
    }
}

/// As [`between_cells`]: sides are powers of 2, of which nothing is lost here.
#[inline]
fn place(pixel: usize, side: usize, count: usize) -> (usize, usize, f32) {
    let (first, second, f) = between_cells(pixel, side, count);
    (first, second, f as f32)
}

#[cfg(test)]
mod tests;
