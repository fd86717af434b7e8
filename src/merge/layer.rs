//! Layers: the frames of a merge, with the radiance and weight of each code value.
//!
//! In: a bracket, its alignment and the response. Out: for a tile of the region, the code values of each frame; for a
//! code value, its radiance, its weight, and a lower bound of the radiance. Cost: a few ns per pixel and frame, plus
//! resampling if a frame moved.

use super::noise::Noise;
use super::weight::Weight;
use crate::align::resampling::{resample_rows, rows_under};
use crate::align::{Alignment, Motion, Placement};
use crate::bracket::{Bracket, Frame, Window};
use crate::error::Result;
use crate::response::{CODES, ResponseCurve};
use crate::simd::{Loops, at_least, at_most, floor32, integer32, vectorised};
use std::ops::Range;

/// Largest width of a tile in pixels. The tiles of all frames fit into the L2 cache.
pub(super) const COLUMNS: usize = 128;
/// Largest height of a tile in pixels.
pub(super) const ROWS: usize = 32;
/// Number of values from one row to the next in the planes of a tile: the columns, one pixel of margin on either side,
/// and padding.
const LINE: usize = COLUMNS + 8;
/// Largest number of rows of a tile, with a margin of one pixel.
const LINES: usize = ROWS + 2;

/// Number of code values by which noise and JPEG may brighten a pixel. The lower bound of a pixel's radiance is the
/// radiance of its code value minus this number.
pub(super) const LIFT: usize = 6;
/// Two code values between which a frame begins to clip. If a shorter frame shows more radiance than the second code
/// value stands for, the frame is clipped. If a shorter frame shows less than the first code value stands for, the
/// frame is not clipped.
pub(super) const CLIPS: (usize, usize) = (230, 250);
/// Two parameters of the factor v of the [equation](super). First, the width of the range of code values below white in
/// which v falls as the brightest channel rises; v is 1 below this range. Second, the value of v at white. It is not 0,
/// so that a frame with one clipped channel still contributes to the other channels if every frame without clipping is
/// darker by some stops.
const GUARD: (f32, f32) = (16.0, 0.25);

/// Pixels with a channel of at least this code value count as clipped.
const TOP: f32 = 253.0;
/// Factor on the weight of a clipped pixel and its eight neighbours, because JPEG ringing, sharpening and resampling
/// change the neighbours. On rendered brackets, 0.5 instead of 1 gains 0.1 to 0.6 dB if frames moved, and loses 0.05 dB
/// if none did.
const RINGING: f32 = 0.5;

/// Largest radiance, about 2^80. The radiance of the reference frame's middle code value is 1. The smallest radiance is
/// 1 divided by this limit. Real exposures and responses are well within this limit, which keeps sums finite.
const MOST_RADIANCE: f64 = 1e24;
/// Largest weight, as a multiple of the weight of the middle code value in the longest exposure: about 2^37. Real
/// exposures and responses are well within this limit, which keeps sums finite.
const MOST_WEIGHT: f32 = 1e11;

/// Radiance, weight and lower bound of each code value of a channel of one frame.
#[derive(Clone)]
struct Table {
    /// X / dt.
    radiance: [f32; CODES],
    weight: [f32; CODES],
    /// Lower bound of the radiance: X / dt at the code value minus [`LIFT`].
    bound: [f32; CODES],
}

/// Radiance (X / dt), weight and lower bound of the radiance of a code value; the fourth value is padding.
pub(super) type Meaning = [f32; 4];

/// The [`Meaning`] of a code value, and its slope to the next code value.
#[derive(Clone, Copy)]
struct Entry {
    at: Meaning,
    slope: Meaning,
}

impl Table {
    fn entries(&self) -> Vec<Entry> {
        let entry = |code: usize| {
            let slope = |of: &[f32; CODES]| if code + 1 < CODES { of[code + 1] - of[code] } else { 0.0 };
            Entry {
                at: [self.radiance[code], self.weight[code], self.bound[code], 0.0],
                slope: [slope(&self.radiance), slope(&self.weight), 0.0, 0.0],
            }
        };
        (0..CODES).map(entry).collect()
    }
}

/// The code values of one frame in a tile, and a mask of the pixels near clipped ones.
pub(super) struct Tile {
    /// Resampled pixels, with a margin of one pixel where the frame has pixels there.
    codes: Vec<[f32; 3]>,
    /// Code values of each channel; the first pixel of the tile is at column and row 1.
    planes: [Vec<f32>; 3],
    /// Marks of each pixel, [`CLIPPED`] and [`PAINTED`]; the first pixel of the tile is at column and row 1.
    clipped: Vec<u8>,
    /// Marks of each pixel and of its eight neighbours, combined; the first pixel of the tile is at column and row 0.
    beside: Vec<u8>,
}

/// A row of a tile. Values beyond the width of the tile are undefined.
#[derive(Clone, Copy)]
pub(super) struct Row<'a> {
    /// R, G and B, 0..=255; negative outside the frame.
    pub codes: [&'a [f32; COLUMNS]; 3],
    /// Marks of the pixel and of its neighbours, combined: [`CLIPPED`], [`PAINTED`].
    pub beside: &'a [u8; COLUMNS],
}

/// Mark of a pixel with a channel at [`TOP`] or above.
pub(super) const CLIPPED: u8 = 1;
/// Mark of a pixel with some channels at white and the others at 0, in a frame other than the reference: no scene is
/// like that, but the borders of registered scans are. Such a pixel has no weight, and gives no lower bound of the
/// radiance.
pub(super) const PAINTED: u8 = 2;

impl Tile {
    pub fn new() -> Self {
        Tile {
            codes: vec![[0.0; 3]; LINES * (COLUMNS + 2)],
            planes: std::array::from_fn(|_| vec![0.0; LINES * LINE]),
            clipped: vec![0; LINES * LINE],
            beside: vec![0; ROWS * LINE],
        }
    }

    /// Reads the pixels of `layer` that correspond to `columns` and `rows` of the reference frame, at most one tile.
    /// `window` contains the rows of the frame that are needed.
    pub fn read(&mut self, layer: &Layer, window: &Window, columns: Range<usize>, rows: Range<usize>) {
        let (c, r) = (wide(&columns, window.width()), wide(&rows, window.height()));
        let size = (c.len(), r.len());
        let at = (1 + c.start - columns.start, 1 + r.start - rows.start);
        let codes = &mut self.codes[..size.0 * size.1];
        resample_rows(window, &layer.motion, c, r, codes);
        let painted = if layer.is_reference { 0 } else { PAINTED };
        vectorised(Apart { size, at, painted, codes, planes: &mut self.planes, clipped: &mut self.clipped });
        vectorised(Beside { rows: rows.len(), clipped: &self.clipped, beside: &mut self.beside });
    }

    /// Returns row `y` of the tile, or `None` after the last row.
    #[inline(always)]
    pub fn row(&self, y: usize) -> Option<Row<'_>> {
        let plane = |c: usize| self.planes[c].get((y + 1) * LINE + 1..)?.first_chunk();
        Some(Row { codes: [plane(0)?, plane(1)?, plane(2)?], beside: self.beside.get(y * LINE..)?.first_chunk()? })
    }
}

/// Splits the channels of a tile and marks clipped pixels.
struct Apart<'a> {
    /// Numbers of columns and rows of `codes`.
    size: (usize, usize),
    /// Column and row in `planes` of the first pixel of `codes`.
    at: (usize, usize),
    /// The mark for painted pixels: [`PAINTED`], or 0 in the reference frame.
    painted: u8,
    codes: &'a [[f32; 3]],
    planes: &'a mut [Vec<f32>; 3],
    clipped: &'a mut [u8],
}

impl Loops for Apart<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let (width, _) = self.size;
        // Pixels outside the frame are not clipped.
        self.clipped.fill(0);
        let [red, green, blue] = self.planes;
        for (y, codes) in self.codes.chunks_exact(width).enumerate() {
            let from = (self.at.1 + y) * LINE + self.at.0;
            let (red, green) = (&mut red[from..from + width], &mut green[from..from + width]);
            let (blue, clipped) = (&mut blue[from..from + width], &mut self.clipped[from..from + width]);
            for x in 0..width {
                let [r, g, b] = codes[x];
                (red[x], green[x], blue[x]) = (r, g, b);
                let (tops, ends) = ([r >= 254.5, g >= 254.5, b >= 254.5], [r <= 0.5, g <= 0.5, b <= 0.5]);
                let is_painted = (tops[0] | ends[0])
                    & (tops[1] | ends[1])
                    & (tops[2] | ends[2])
                    & (tops[0] | tops[1] | tops[2])
                    & (ends[0] | ends[1] | ends[2]);
                let is_clipped = u8::from(r >= TOP) | u8::from(g >= TOP) | u8::from(b >= TOP);
                clipped[x] = is_clipped | if is_painted { self.painted } else { 0 };
            }
        }
    }
}

/// Marks the clipped and painted pixels and their neighbours.
struct Beside<'a> {
    rows: usize,
    clipped: &'a [u8],
    beside: &'a mut [u8],
}

impl Loops for Beside<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (y, beside) in self.beside.chunks_exact_mut(LINE).take(self.rows).enumerate() {
            let clipped = &self.clipped[y * LINE..(y + 3) * LINE];
            for x in 0..COLUMNS {
                let three =
                    |row: usize| clipped[row * LINE + x] | clipped[row * LINE + x + 1] | clipped[row * LINE + x + 2];
                beside[x] = three(0) | three(1) | three(2);
            }
        }
    }
}

/// Which pixels of the result a frame with an [assumed](Placement::Assumed) transform contributes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fill {
    /// Pixels that are clipped in the other frames.
    Clipped,
    /// Pixels that are black in the other frames.
    Black,
}

/// A frame of the merge.
pub(super) struct Layer<'a> {
    frame: &'a Frame,
    motion: Motion,
    is_reference: bool,
    /// For each channel the meaning of each code value.
    entries: [Vec<Entry>; 3],
    /// Largest code value at which an interpolation to the next code value starts: 254, or 255 if all code values are
    /// integers.
    last: f32,
    /// The weight of the middle code value.
    pub middle_weight: f32,
    /// What the frame fills if its transform is assumed; `None` if the transform is known.
    pub fill: Option<Fill>,
    /// The code value up to which the frame is black, the largest of all channels.
    pub black: f32,
    /// Whether each channel of a pixel gets the smallest weight of the three channels.
    pub is_joint: bool,
    /// For each channel, two numbers from [`CLIPS`]. First, the radiance at and above which the frame is clipped.
    /// Second, 1 divided by the width of the range below it in which the frame begins to clip.
    pub clips: [(f32, f32); 3],
    /// The factor v of the [equation](super) for pixels whose brightest channel is at white.
    pub guard: f32,
    /// Factor on the weight of clipped pixels and of their neighbours.
    pub ringing: f32,
}

/// Returns `range`, extended by one at both ends, but not beyond 0..`most`.
fn wide(range: &Range<usize>, most: usize) -> Range<usize> {
    range.start.saturating_sub(1)..(range.end + 1).min(most)
}

impl Layer<'_> {
    /// Returns the rows of the frame that `columns` and `rows` of the reference frame need.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch) if the frame is on disk and cannot be read.
    pub fn window(&self, columns: &Range<usize>, rows: &Range<usize>) -> Result<Window<'_>> {
        let size = (self.frame.width(), self.frame.height());
        self.frame.window(rows_under(&self.motion, &wide(columns, size.0), &wide(rows, size.1)))
    }

    /// Whether the frame has the pixels of the reference, without resampling.
    pub fn is_still(&self) -> bool {
        self.motion.is_identity()
    }

    /// Changes the weights for a locally processed bracket. Every frame gets the same weights, because a phone
    /// amplifies the noise of what it brightens. And all channels of a pixel get the same weight, because the phone
    /// changed them together.
    ///
    /// On 7 rendered brackets of phones, equal weights of the frames gain 0.7 dB (PU21-PSNR of details), and equal
    /// weights of the channels up to 2.6 dB.
    pub fn weigh_as_local(&mut self) {
        let middle_weight = at_least(self.middle_weight, f32::MIN_POSITIVE);
        for entry in self.entries.iter_mut().flatten() {
            (entry.at[1], entry.slope[1]) = (entry.at[1] / middle_weight, entry.slope[1] / middle_weight);
        }
        (self.middle_weight, self.is_joint) = (1.0, true);
    }

    /// Returns the factor v of the [equation](super) for pixels whose brightest channel has the code value `top`.
    #[inline(always)]
    pub fn guard(&self, top: f32) -> f32 {
        let v = (255.0 - floor32(top)) * (1.0 / GUARD.0);
        at_most(at_least(v, self.guard), 1.0)
    }

    /// Writes the meanings of `codes` to `meanings`: radiance and weight are interpolated between code values, the
    /// lower bound is not.
    #[inline(always)]
    pub fn look_up(&self, channel: usize, codes: &[f32; COLUMNS], meanings: &mut [Meaning; COLUMNS]) {
        let (mut below, mut part) = ([0u8; COLUMNS], [0.0f32; COLUMNS]);
        for x in 0..COLUMNS {
            let code = at_most(at_least(codes[x], 0.0), 255.0);
            let whole = at_most(floor32(code), self.last);
            (below[x], part[x]) = (integer32(whole) as u8, code - whole);
        }
        // Indexing a slice of unknown length makes the compiler load the four values of a pixel at once, instead of
        // gathering each value from eight pixels.
        let entries = self.entries[channel].as_slice();
        for x in 0..COLUMNS {
            let entry = &entries[usize::from(below[x])];
            for k in 0..4 {
                meanings[x][k] = entry.at[k] + part[x] * entry.slope[k];
            }
        }
    }
}

/// Returns the merged frames, by rising exposure. The middle code value of the longest exposure has weight 1.
pub(super) fn layers<'a>(
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    curve: &ResponseCurve,
    weight: Weight,
) -> Result<Vec<Layer<'a>>> {
    let reference = bracket.reference().exposure.relative();
    let fill = |i: usize| {
        let fill = if i < bracket.reference_index() { Fill::Clipped } else { Fill::Black };
        matches!(alignment.placements[i], Placement::Assumed(_)).then_some(fill)
    };
    let seen = |(i, frame, motion): (usize, &'a Frame, Motion)| {
        let noise = match weight {
            Weight::Noise => Noise::of(frame, !motion.is_identity())?,
            _ => Noise::least(),
        };
        Ok((frame, motion, frame.exposure.relative() / reference, noise, (fill(i), i == bracket.reference_index())))
    };
    let mut placed = alignment.placed(bracket).map(seen).collect::<Result<Vec<_>>>()?;
    if bracket.reference().is_raw() {
        let all: Vec<Noise> = placed.iter().map(|(.., noise, _)| noise.clone()).collect();
        placed.iter_mut().for_each(|(.., noise, _)| noise.raise(all.iter()));
    }
    let most = placed.last().map_or(1.0, |(_, _, time, noise, _)| weight.middle_weight(curve, *time, noise));
    let placed = placed.into_iter();
    let layer = |(frame, motion, time, noise, (fill, is_reference))| Layer {
        fill,
        is_reference,
        ..layer(frame, motion, (time, &noise), curve, weight, most)
    };
    Ok(placed.map(layer).collect())
}

/// Returns the layer of `frame`, whose exposure is `time` times that of the reference. Weights are divided by `most`,
/// the weight of the middle code value of the longest exposure.
fn layer<'a>(
    frame: &'a Frame,
    motion: Motion,
    (time, noise): (f64, &Noise),
    curve: &ResponseCurve,
    weight: Weight,
    most: f32,
) -> Layer<'a> {
    let tables: [Table; 3] = std::array::from_fn(|c| {
        let radiance =
            curve.exposures(c).map(|x| (f64::from(x) / time).clamp(1.0 / MOST_RADIANCE, MOST_RADIANCE) as f32);
        Table {
            radiance,
            weight: weight.table(curve, c, time, noise).map(|w| at_most(w / most, MOST_WEIGHT)),
            bound: std::array::from_fn(|code| match code.saturating_sub(LIFT) {
                lower if lower as f64 <= curve.black(c) => 0.0,
                lower => radiance[lower],
            }),
        }
    });
    let clips = |table: &Table| match weight {
        Weight::Uniform => (f32::MAX, 1.0),
        _ => {
            let (begins, sure) = (table.radiance[CLIPS.0], table.radiance[CLIPS.1]);
            // The difference is 0 if the response is flat between the two code values. Its inverse must stay finite,
            // because 0 times infinity is not a number.
            (sure, 1.0 / at_least(sure - begins, f32::MIN_POSITIVE))
        }
    };
    Layer {
        frame,
        is_reference: false,
        // A frame of 8 bits that did not move has integer code values only.
        last: if frame.max() == u16::from(u8::MAX) && motion.is_identity() { 255.0 } else { 254.0 },
        motion,
        middle_weight: weight.middle_weight(curve, time, noise) / most,
        fill: None,
        black: (0..3).map(|c| curve.black(c)).fold(0.0, f64::max) as f32,
        is_joint: false,
        clips: std::array::from_fn(|c| clips(&tables[c])),
        guard: if weight == Weight::Uniform { 1.0 } else { GUARD.1 },
        ringing: if weight == Weight::Uniform { 1.0 } else { RINGING },
        entries: std::array::from_fn(|c| tables[c].entries()),
    }
}

/// Factors on the weight and on the radiance of each pixel in a row of a frame.
#[derive(Clone, Copy)]
pub(super) struct Taken<'a> {
    /// Factor of the motion mask on the weight of each pixel, 0..=1; 1 for pixels beyond the end of the slice.
    pub kept: &'a [f32],
    /// Factor on the radiance of each pixel; 1 for pixels beyond the end of the slice.
    pub gain: &'a [f32],
}

impl<'a> Taken<'a> {
    /// Selects the pixels `part` of `kept` and `gain`, which may be empty.
    pub fn part(kept: &'a [f32], gain: &'a [f32], part: Range<usize>) -> Self {
        Taken { kept: kept.get(part.clone()).unwrap_or(&[]), gain: gain.get(part).unwrap_or(&[]) }
    }
}
