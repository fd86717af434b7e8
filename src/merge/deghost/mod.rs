//! Deghosting: motion masks, which mark where a frame shows something else than the reference frame.
//!
//! In: a bracket, its alignment and the response. Out: [`Ghosts`], for each frame and pixel a factor on the weight.
//! Cost: some 200 ns of one core for each cell of each frame, and 200 more if something differs; this is about 4 ns per
//! pixel of a frame of 12 MP. Memory: 156 bytes per cell, whatever the number of frames, plus one byte for each cell of
//! each frame, two if the frame is shorter than the reference. There are at most 262,144 cells, or more beyond 16 MP.
//! Source: comparing each frame with the reference frame in units of noise is from Ward's hdrgen (option `-g`). Four
//! things are ours: the noise model, the use of another frame where the reference is clipped (step 2), the scales, and
//! the edge criterion.
//!
//! 1. For every frame, the mean radiance is computed in cells of 2x2 pixels (4x4 and 8x8 in large pictures): `cells`.
//! 2. Each frame is compared, cell by cell, with the standard: the reference frame, or, where the reference is clipped,
//!    black or noisy, the nearest frame that agrees with it. The order is from the reference towards the shorter
//!    exposures, then from the reference towards the longer ones. A clipped or black code value is only a bound of the
//!    radiance. Differences between frame and standard that are usual in the whole picture are not motion: `usual`.
//! 3. The differences, in units of their standard deviation and with their signs, are averaged over larger and larger
//!    cells: errors of alignment, noise and JPEG cancel, motion adds up. The cell size with the strongest mean decides,
//!    for all three channels together: `evidence`.
//! 4. A difference is motion if only one of the two, standard or frame, has an edge there: `structure`. A connected
//!    region that differs is removed completely, with a soft border, only if such edges along its border are strong
//!    enough on average: `region`.
//! 5. Where something moved, shorter frames that are black are removed too, because black agrees with any dark object.
//! 6. Where the reference frame is clipped and the shorter frames are removed, radiance is interpolated from the
//!    clipped surroundings: `holes`.
//! 7. The merged radiance is limited to what the code values of the reference allow: `allowed`.
//!
//! A bracket in which nothing moved, not even the camera, gives the same bytes as without deghosting.
//!
//! hdrgen's weight e^2 / (e^2 + d^2), with e = 0.08 and the difference d from the reference, is not used, because it
//! treats noise as motion: on five rendered brackets with motion, its PU21-PSNR is 2 to 20 dB lower than without
//! deghosting.

pub(super) mod cells;
mod evidence;
mod ghosts;
mod holes;
mod region;
mod structure;
mod usual;

use crate::align::{Alignment, Motion, Placement, Rect};
use crate::bracket::{Bracket, Frame};
use crate::budget::Demand;
use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::pyramid::cells::grown_by;
use crate::response::{CODES, ResponseCurve};
use cells::{Cell, Meaning};
#[doc(hidden)]
pub use ghosts::{GhostFrame, GhostRegion, GhostReport, Ghosts, MOST_REGIONS};
use holes::Shorter;
use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// Cells are enlarged until there are at most this many, or until their side is [`LARGEST`].
const MOST_CELLS: usize = Demand::MOST_CELLS as usize;
/// The longest side of a cell, in pixels.
const LARGEST: usize = 8;
/// Half the width, in cells, of the widest gap in a motion mask that is closed. There are gaps because parts of a
/// moving object may look like the background.
const GAP: usize = 3;
/// Width, in cells, of a margin around a motion mask. The margin is removed too, because there the edge of the object
/// is mixed with the background.
const MARGIN: usize = 2;
/// Cells up to this distance, in cells, from a motion mask may still contain the edge of the moving object.
const EDGE: usize = 1;
/// Half the width of the soft border, in cells.
const FADE: usize = 2;

/// Strength of deghosting.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Deghost {
    /// With a strength of [`AUTO`].
    #[default]
    Auto,
    /// No deghosting: all frames are merged everywhere.
    Off,
    /// 0..=1. At 0.5 a region is removed if it differs by 2 standard deviations, and by 4 somewhere; 0 doubles these
    /// thresholds and the distance of the limits that the reference sets, 1 halves them.
    Strength(f64),
}

/// The strength of [`Deghost::Auto`].
pub const AUTO: f64 = 0.5;

impl Deghost {
    /// Returns the strength, or `None` if deghosting is off.
    pub fn strength(self) -> Option<f64> {
        match self {
            Deghost::Auto => Some(AUTO),
            Deghost::Off => None,
            Deghost::Strength(strength) => Some(strength),
        }
    }

    /// Whether deghosting is on.
    pub fn is_on(self) -> bool {
        self != Deghost::Off
    }

    /// Checks that the strength is within 0..=1.
    ///
    /// # Errors
    /// [`Error::Option`].
    pub fn validate(self) -> Result<()> {
        match self {
            Deghost::Strength(strength) if !(0.0..=1.0).contains(&strength) => {
                let reason = format!("{strength} is not a strength; give 0 (least) to 1 (most), as in --deghost=0.5");
                Err(Error::Option { option: "--deghost", reason })
            }
            _ => Ok(()),
        }
    }
}

impl FromStr for Deghost {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "auto" => Ok(Deghost::Auto),
            "off" => Ok(Deghost::Off),
            _ => text.parse().map(Deghost::Strength).map_err(|_| "give auto, off or a strength from 0 to 1".to_owned()),
        }
    }
}

impl fmt::Display for Deghost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Deghost::Auto => f.write_str("auto"),
            Deghost::Off => f.write_str("off"),
            Deghost::Strength(strength) => write!(f, "{strength}"),
        }
    }
}

/// Returns two thresholds in standard deviations: a cell that reaches the first may have moved; a cell that reaches the
/// second differs certainly.
fn limits(strength: f64) -> (f32, f32) {
    let scale = tolerance(strength) as f32;
    (2.0 * scale, 4.0 * scale)
}

/// The factor on all thresholds: 2 for strength 0, 1 for 0.5, and 1/2 for 1.
fn tolerance(strength: f64) -> f64 {
    libm::exp2(1.0 - 2.0 * strength)
}

/// A frame to compare.
pub(super) struct Layer<'a> {
    pub(super) frame: &'a Frame,
    motion: Motion,
    pub(super) meaning: Meaning,
    /// Displacement of edges, in pixels, that is expected without motion.
    astray_px: f32,
    /// Whether the frame's transform is [assumed](Placement::Assumed). Such a frame only fills what is clipped or black
    /// in all other frames, so it is not compared.
    is_assumed: bool,
}

/// Returns the merged frames of `bracket` by rising exposure, and the index of the reference frame among them.
pub(super) fn layers<'a>(
    bracket: &'a Bracket,
    alignment: &Alignment,
    curve: &ResponseCurve,
) -> (Vec<Layer<'a>>, usize) {
    let unit = bracket.reference().exposure.relative();
    let layer = |(index, frame, motion): (usize, &'a Frame, Motion)| Layer {
        frame,
        motion,
        meaning: Meaning::of(curve, frame.exposure.relative() / unit),
        astray_px: evidence::astray(alignment.placements[index].error_px()),
        is_assumed: matches!(alignment.placements[index], Placement::Assumed(_)),
    };
    let reference = alignment.placed(bracket).position(|(index, ..)| index == bracket.reference_index());
    (alignment.placed(bracket).map(layer).collect(), reference.unwrap_or_default())
}

/// A function that returns the factors on a frame's radiance, row by row; empty if all factors are 1. Its arguments are
/// the frame's index among the merged frames, by rising exposure, and the rows of the region.
pub type Gain<'a> = &'a (dyn Fn(usize, Range<usize>) -> Vec<f32> + Sync);

/// Finds where in `region` each frame shows something else than the reference frame. The radiance of locally processed
/// frames is multiplied by `gain` before the comparison, and only their unclipped cells are compared.
///
/// # Errors
/// [`Error::Option`] if the strength is out of range; [`Error::Scratch`].
pub fn find(
    bracket: &Bracket,
    alignment: &Alignment,
    curve: &ResponseCurve,
    region: Rect,
    strength: f64,
    gain: Option<Gain>,
) -> Result<Ghosts> {
    Deghost::Strength(strength).validate()?;
    let (layers, reference) = layers(bracket, alignment, curve);
    let side = side(region);
    let seen = |i: usize| {
        let mut cells = cells::average(&layers[i], region, side, i as u16)?;
        if let Some(gain) = gain {
            let middle = |cell: usize, size: usize| (side * cell + side / 2).min(size - 1);
            cells.fill_rows(|y, row| {
                let y = middle(y, region.height());
                let factors = gain(i, y..y + 1);
                for (x, cell) in row.iter_mut().enumerate() {
                    let factor = factors.get(middle(x, region.width())).copied().unwrap_or(1.0);
                    *cell = cell.with_gain(factor);
                }
            });
        }
        Ok::<_, Error>(cells)
    };
    let meanings: Vec<&Meaning> = layers.iter().map(|layer| &layer.meaning).collect();
    let mut frames: Vec<(String, Option<Plane<u8>>)> =
        layers.iter().map(|layer| (layer.frame.path().to_string_lossy().into_owned(), None)).collect();
    let shown = seen(reference)?;
    let mut shorter = Shorter::than(&shown);
    let mut black = Vec::new();
    for outwards in [(0..reference).rev().collect::<Vec<_>>(), (reference + 1..layers.len()).collect()] {
        let mut standard = shown.clone();
        for i in outwards.into_iter().filter(|&i| !layers[i].is_assumed) {
            let frame = seen(i)?;
            let astray = layers[i].astray_px / side as f32;
            let moved = region::closed(&evidence::moved(&standard, &frame, &meanings, astray, limits(strength)), GAP);
            take_over(&mut standard, &frame, &moved, &meanings);
            let mut kept = region::kept(&moved, MARGIN, FADE);
            if i < reference {
                keep_beside(&mut kept, &grown_by(&moved, EDGE), (&frame, &shown));
                shorter.add(&frame, &kept);
                black.push((i, underexposed(&frame, &shown)));
            }
            frames[i].1 = Some(kept);
        }
    }
    leave_out_underexposed(&mut frames, &black);
    Ok(Ghosts { region, side, strength, frames, holes: shorter.holes(&shown, curve) })
}

/// Returns the cells in which a shorter `frame` is black in all channels and the `reference` is not clipped: there the
/// frame agrees with any dark object.
fn underexposed(frame: &Plane<Cell>, reference: &Plane<Cell>) -> Plane<bool> {
    Plane::from_rows(frame.width(), frame.height(), |y, row| {
        for ((is, f), s) in row.iter_mut().zip(frame.row(y)).zip(reference.row(y)) {
            *is = (0..3).all(|c| f.is_black(c)) && !s.clips();
        }
    })
}

/// In the cells where a frame is `black`, reduces its weight to the smallest weight that any frame has there. Otherwise
/// a wall that is black in a short frame would be merged with a person in front of it in another frame.
fn leave_out_underexposed(frames: &mut [(String, Option<Plane<u8>>)], black: &[(usize, Plane<bool>)]) {
    let Some((_, first)) = black.first() else { return };
    let mut least = vec![u8::MAX; first.as_slice().len()];
    for kept in frames.iter().filter_map(|(_, kept)| kept.as_ref()) {
        least.iter_mut().zip(kept.as_slice()).for_each(|(least, kept)| *least = (*least).min(*kept));
    }
    for (i, black) in black {
        let Some(kept) = &mut frames[*i].1 else { continue };
        for ((kept, least), is) in kept.as_mut_slice().iter_mut().zip(&least).zip(black.as_slice()) {
            *kept = if *is { *least } else { *kept };
        }
    }
}

/// Gives a shorter frame its full weight outside of `moved`, where the reference frame is white and the shorter frame
/// shows at least as much radiance. Otherwise a white spot would remain around the moving object. Where the shorter
/// frame shows less radiance, as in the soft edge of a moving object, radiance is [interpolated](holes) from the
/// surroundings.
fn keep_beside(kept: &mut Plane<u8>, moved: &Plane<bool>, (frame, reference): (&Plane<Cell>, &Plane<Cell>)) {
    kept.fill_rows(|y, row| {
        let cells = frame.row(y).iter().zip(reference.row(y));
        for ((kept, moved), (f, s)) in row.iter_mut().zip(moved.row(y)).zip(cells) {
            let is_white = (0..3).all(|c| s.is_clipped(c));
            if !moved && is_white && (0..3).any(|c| f.radiance[c] >= s.radiance[c]) {
                *kept = u8::MAX;
            }
        }
    });
}

/// Returns the side of a cell in pixels.
fn side(region: Rect) -> usize {
    let cells = |side: usize| region.width().div_ceil(side) * region.height().div_ceil(side);
    let mut side = 2;
    while side < LARGEST && cells(side) > MOST_CELLS {
        side *= 2;
    }
    side
}

/// Updates `standard`, the cells that the next frames are compared with. A cell of `frame` that did not move replaces
/// the cell of the standard in three cases: the standard has no value there, its value is only a bound of the radiance,
/// or it is much noisier than the frame.
fn take_over(standard: &mut Plane<Cell>, frame: &Plane<Cell>, moved: &Plane<bool>, meanings: &[&Meaning]) {
    standard.fill_rows(|y, row| {
        for ((s, f), moved) in row.iter_mut().zip(frame.row(y)).zip(moved.row(y)) {
            if *moved || f.is_outside() {
                continue;
            }
            // All channels of a cell are replaced or none, so that the standard of a cell is from one frame.
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

#[cfg(test)]
mod tests;
