//! Layers: the frames that take part in a merge, each with what its codes mean and how far they are trusted.
//!
//! In: a bracket, where its frames lie, and the response. Out: for a tile of the region, each frame's codes; for a code, its radiance, weight
//! and the least that it vouches for. Cost: a few ns a pixel and frame, and resampling where a frame moved.

use super::noise::Noise;
use super::weight::Weight;
use crate::align::resampling::{resample_rows, rows_under};
use crate::align::{Alignment, Placement, Transform};
use crate::bracket::{Bracket, Frame, Window};
use crate::error::Result;
use crate::response::{CODES, ResponseCurve};
use crate::simd::{Loops, at_least, at_most, floor32, integer32, vectorised};
use std::ops::Range;

/// Columns and rows of a tile, at most: what all frames have of it stays in the nearer caches.
pub(super) const COLUMNS: usize = 128;
pub(super) const ROWS: usize = 32;
/// Values from one row of a tile to the next, with a pixel more at both ends, and the most rows.
const LINE: usize = COLUMNS + 8;
const LINES: usize = ROWS + 2;

/// Codes by which noise and JPEG may lift a pixel: what a code vouches for is the radiance of one lower by so many.
pub(super) const LIFT: usize = 6;
/// Codes between which a frame is taken to clip where a shorter one vouches for as much light as they mean.
pub(super) const CLIPS: (usize, usize) = (230, 250);
/// Codes below the top over which a frame's trust falls with its brightest channel, and what it falls to: a frame in which one channel
/// clips still counts for the others where every frame that holds all three is darker by some stops.
const GUARD: (f32, f32) = (16.0, 0.25);

/// A code from which on a pixel counts as clipped, and the share of their weight that its eight neighbours keep: JPEG's ringing, the camera's
/// sharpening and resampling bend them. On truth brackets a half gains 0.1 to 0.6 dB where frames moved, and loses 0.05 where none did.
const TOP: f32 = 253.0;
const RINGING: f32 = 0.5;

/// Radiance over the reference's middle code, at most, and one over it at least; and weight over that of the longest exposure's middle code,
/// at most: 80 stops and 40, beyond what exposures and curves that mean anything give. Sums over a bracket of the largest are finite.
const MOST_RADIANCE: f64 = 1e24;
const MOST_WEIGHT: f32 = 1e11;

/// What a channel's code counts for in one frame.
#[derive(Clone)]
struct Table {
    /// X / dt.
    radiance: [f32; CODES],
    weight: [f32; CODES],
    /// X / dt of the code less [`LIFT`].
    vouched: [f32; CODES],
}

/// What a code means, side by side: X / dt, w, and the radiance that the scene has at least (and nothing, to make four).
pub(super) type Meaning = [f32; 4];

/// What a code means, and what is to be added for each part of the way to the next.
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
                at: [self.radiance[code], self.weight[code], self.vouched[code], 0.0],
                slope: [slope(&self.radiance), slope(&self.weight), 0.0, 0.0],
            }
        };
        (0..CODES).map(entry).collect()
    }
}

/// One frame's codes in a tile of the region, and where clipped pixels are near.
pub(super) struct Tile {
    /// As they are resampled, with a pixel more to every side, where there is one.
    codes: Vec<[f32; 3]>,
    /// By channel, the tile's first pixel at column and row 1.
    planes: [Vec<f32>; 3],
    /// [`CLIPPED`] where a channel is at its top, or as good as, and [`PAINTED`].
    clipped: Vec<u8>,
    /// The same of a pixel and its eight neighbours, the tile's first pixel at column and row 0.
    beside: Vec<u8>,
}

/// A row of a tile; what lies beyond the tile's width means nothing.
#[derive(Clone, Copy)]
pub(super) struct Row<'a> {
    /// R, G and B on the scale 0..=255; below 0 where the frame does not reach.
    pub codes: [&'a [f32; COLUMNS]; 3],
    /// Whether a [`CLIPPED`] or a [`PAINTED`] pixel is near.
    pub beside: &'a [u8; COLUMNS],
}

/// Where a channel is at its top.
pub(super) const CLIPPED: u8 = 1;
/// Where channels are at their top and the others at 0, in another frame than the reference: no light is so, but the borders of registered scans are. Such a
/// pixel has no weight, and is no lower bound of the radiance.
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

    /// Takes what `layer`, of which `window` is read, has at columns `columns` and rows `rows` of the reference, no more than a tile of
    /// them.
    pub fn read(&mut self, layer: &Layer, window: &Window, columns: Range<usize>, rows: Range<usize>) {
        let (c, r) = (wide(&columns, window.width()), wide(&rows, window.height()));
        let size = (c.len(), r.len());
        let at = (1 + c.start - columns.start, 1 + r.start - rows.start);
        let codes = &mut self.codes[..size.0 * size.1];
        resample_rows(window, &layer.warp, c, r, codes);
        let painted = if layer.is_reference { 0 } else { PAINTED };
        vectorised(Apart { size, at, painted, codes, planes: &mut self.planes, clipped: &mut self.clipped });
        vectorised(Beside { rows: rows.len(), clipped: &self.clipped, beside: &mut self.beside });
    }

    /// Row `y`; none beyond the last.
    #[inline(always)]
    pub fn row(&self, y: usize) -> Option<Row<'_>> {
        let plane = |c: usize| self.planes[c].get((y + 1) * LINE + 1..)?.first_chunk();
        Some(Row { codes: [plane(0)?, plane(1)?, plane(2)?], beside: self.beside.get(y * LINE..)?.first_chunk()? })
    }
}

/// Takes the channels of a tile apart, and sees where they clip.
struct Apart<'a> {
    /// Columns and rows of `codes`.
    size: (usize, usize),
    /// Where the first of them lies.
    at: (usize, usize),
    /// What pixels of a painted colour are.
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
        // Beyond the picture's border there is nothing that could clip.
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

/// Sees where clipped pixels are near.
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

/// What a frame of which the place is only [assumed](Placement::Assumed) takes part in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fill {
    /// In what the other frames clip.
    Clipped,
    /// In what is black in the other frames.
    Black,
}

/// A frame that takes part.
pub(super) struct Layer<'a> {
    frame: &'a Frame,
    warp: Transform,
    is_reference: bool,
    /// By channel and code.
    entries: [Vec<Entry>; 3],
    /// The last code whose entry begins what lies between it and the next: 255 where nothing lies between codes.
    last: f32,
    /// The weight of the frame's middle code.
    pub say: f32,
    /// What it is to fill, where its place is assumed; none where it is known.
    pub fill: Option<Fill>,
    /// The code up to which it is black, in any channel.
    pub black: f32,
    /// Whether all channels have the weight of the one that is trusted least.
    pub is_joint: bool,
    /// For each channel the radiance from which on the frame clips for sure, and the inverse of the range over which it begins to.
    pub clips: [(f32, f32); 3],
    /// What v falls to where the brightest channel is at its top.
    pub guard: f32,
    /// The share of its weight that a pixel beside clipped ones keeps.
    pub ringing: f32,
}

/// `range` and one more to either side, where there is one.
fn wide(range: &Range<usize>, most: usize) -> Range<usize> {
    range.start.saturating_sub(1)..(range.end + 1).min(most)
}

impl Layer<'_> {
    /// What is needed of the frame for tiles of columns `columns` and rows `rows` of the reference.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch), where the frame is on disk.
    pub fn window(&self, columns: &Range<usize>, rows: &Range<usize>) -> Result<Window<'_>> {
        let size = (self.frame.width(), self.frame.height());
        self.frame.window(rows_under(&self.warp, size, &wide(columns, size.0), &wide(rows, size.1)))
    }

    /// Weighs the frame as one of a bracket that is locally processed: as much as every other, for a phone lifts the noise of what it brightens; and its
    /// channels together, for they were changed together.
    ///
    /// On 7 truth brackets of kind `phone`, the first is worth 0.7 dB (PU21-PSNR of details), and the second up to 2.6.
    pub fn weigh_as_local(&mut self) {
        let say = at_least(self.say, f32::MIN_POSITIVE);
        for entry in self.entries.iter_mut().flatten() {
            (entry.at[1], entry.slope[1]) = (entry.at[1] / say, entry.slope[1] / say);
        }
        (self.say, self.is_joint) = (1.0, true);
    }

    /// v of pixels whose brightest channel has code `top`.
    #[inline(always)]
    pub fn guard(&self, top: f32) -> f32 {
        let v = (255.0 - floor32(top)) * (1.0 / GUARD.0);
        at_most(at_least(v, self.guard), 1.0)
    }

    /// What `codes` of a channel mean, into `meanings`: interpolated between codes, but that a code vouches for what the lower does.
    #[inline(always)]
    pub fn look_up(&self, channel: usize, codes: &[f32; COLUMNS], meanings: &mut [Meaning; COLUMNS]) {
        let (mut below, mut part) = ([0u8; COLUMNS], [0.0f32; COLUMNS]);
        for x in 0..COLUMNS {
            let code = at_most(at_least(codes[x], 0.0), 255.0);
            let whole = at_most(floor32(code), self.last);
            (below[x], part[x]) = (integer32(whole) as u8, code - whole);
        }
        // As a slice, whose length the compiler does not know: else it would gather eight pixels' numbers one by one instead of four at once.
        let entries = self.entries[channel].as_slice();
        for x in 0..COLUMNS {
            let entry = &entries[usize::from(below[x])];
            for k in 0..4 {
                meanings[x][k] = entry.at[k] + part[x] * entry.slope[k];
            }
        }
    }
}

/// The frames that were placed, by rising exposure. Weights are such that the longest exposure's middle code has 1.
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
    let seen = |(i, frame, warp): (usize, &'a Frame, Transform)| {
        let noise = match weight {
            Weight::Noise => Noise::of(frame, warp != Transform::Identity)?,
            _ => Noise::least(),
        };
        Ok((frame, warp, frame.exposure.relative() / reference, noise, (fill(i), i == bracket.reference_index())))
    };
    let placed = alignment.placed(bracket).map(seen).collect::<Result<Vec<_>>>()?;
    let most = placed.last().map_or(1.0, |(_, _, time, noise, _)| weight.say(curve, *time, noise));
    let placed = placed.into_iter();
    let layer = |(frame, warp, time, noise, (fill, is_reference))| Layer {
        fill,
        is_reference,
        ..layer(frame, warp, (time, &noise), curve, weight, most)
    };
    Ok(placed.map(layer).collect())
}

/// `frame`, exposed `time` times as long as the reference and as noisy as told; weights are divided by `most`.
fn layer<'a>(
    frame: &'a Frame,
    warp: Transform,
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
            vouched: std::array::from_fn(|code| match code.saturating_sub(LIFT) {
                lower if lower as f64 <= curve.black(c) => 0.0,
                lower => radiance[lower],
            }),
        }
    });
    let clips = |table: &Table| match weight {
        Weight::Uniform => (f32::MAX, 1.0),
        _ => {
            let (begins, sure) = (table.radiance[CLIPS.0], table.radiance[CLIPS.1]);
            // A curve may be flat between the two, and nothing times infinity is no number.
            (sure, 1.0 / at_least(sure - begins, f32::MIN_POSITIVE))
        }
    };
    Layer {
        frame,
        warp,
        is_reference: false,
        // A frame of 8 bit that did not move has whole codes alone.
        last: if frame.max() == u16::from(u8::MAX) && warp == Transform::Identity { 255.0 } else { 254.0 },
        say: weight.say(curve, time, noise) / most,
        fill: None,
        black: (0..3).map(|c| curve.black(c)).fold(0.0, f64::max) as f32,
        is_joint: false,
        clips: std::array::from_fn(|c| clips(&tables[c])),
        guard: if weight == Weight::Uniform { 1.0 } else { GUARD.1 },
        ringing: if weight == Weight::Uniform { 1.0 } else { RINGING },
        entries: std::array::from_fn(|c| tables[c].entries()),
    }
}

/// How a row of a frame takes part.
#[derive(Clone, Copy)]
pub(super) struct Taken<'a> {
    /// How far it is believed at each of the pixels, 0..=1; wholly where it does not say.
    pub kept: &'a [f32],
    /// What its radiance is multiplied by at each of the pixels; 1 where it does not say.
    pub gain: &'a [f32],
}

impl<'a> Taken<'a> {
    /// The pixels `part` of all that `kept` and `gain` say; they say nothing if they are empty.
    pub fn part(kept: &'a [f32], gain: &'a [f32], part: Range<usize>) -> Self {
        Taken { kept: kept.get(part.clone()).unwrap_or(&[]), gain: gain.get(part).unwrap_or(&[]) }
    }
}
