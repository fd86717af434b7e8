//! Layers: the frames that take part in a merge, each with what its codes mean and how far they are trusted.
//!
//! In: a bracket, where its frames lie, and the response. Out: for a strip of rows, each frame's codes; for a code, its radiance, weight
//! and the least that it vouches for. Cost: tables, and resampling where a frame moved.

use super::noise::Noise;
use super::weight::Weight;
use crate::align::resample::{OUTSIDE, resample_rows, rows_under};
use crate::align::warp::Warp;
use crate::align::{Alignment, Status};
use crate::bracket::{self, Bracket, Frame, Window};
use crate::error::Result;
use crate::response::{CODES, ResponseCurve};
use std::ops::Range;

/// Codes by which noise and JPEG may lift a pixel: what a code vouches for is the radiance of one lower by so many.
const LIFT: usize = 6;
/// Codes between which a frame is taken to clip where a shorter one vouches for as much light as they mean.
const CLIPS: (usize, usize) = (230, 250);
/// Codes below the top over which a frame's trust falls with its brightest channel, and what it falls to: a frame in which one channel
/// clips still counts for the others where every frame that holds all three is darker by some stops.
const GUARD: (f32, f32) = (16.0, 0.25);

/// A code from which on a pixel counts as clipped, and the share of their weight that its eight neighbours keep: JPEG's ringing, the camera's
/// sharpening and resampling bend them. On truth brackets a half gains 0.1 to 0.6 dB where frames moved, and loses 0.05 where none did.
const TOP: f32 = 253.0;
const RINGING: f32 = 0.5;

/// One frame's codes in a strip of rows of the region, and where clipped pixels are near.
pub(super) struct Strip<'a> {
    codes: Codes<'a>,
    /// Columns and rows of `codes` before the strip's first, and its rows' width: a pixel more to every side, where there is one.
    before: (usize, usize),
    width: usize,
    /// Whether a pixel, its left or its right neighbour is clipped, by rows of `codes`.
    clipped: Vec<bool>,
}

enum Codes<'a> {
    /// As they were decoded, from the strip's first pixel on, and how many there are from one row to the next.
    Exact(&'a [u8], usize),
    /// Resampled.
    Moved(Vec<[f32; 3]>),
}

impl Codes<'_> {
    /// Whether a channel is at its top, or as good as, in each of `width` pixels of `rows` rows.
    fn clipped(&self, width: usize, rows: usize) -> Vec<bool> {
        let mut clipped = vec![false; width * rows];
        match self {
            Codes::Exact(codes, stride) => {
                for (flags, row) in clipped.chunks_exact_mut(width).zip(codes.chunks(*stride)) {
                    for (flag, z) in flags.iter_mut().zip(row.chunks_exact(3)) {
                        *flag = z[0].max(z[1]).max(z[2]) >= TOP as u8;
                    }
                }
            }
            Codes::Moved(codes) => {
                for (flag, z) in clipped.iter_mut().zip(codes) {
                    *flag = z[0].max(z[1]).max(z[2]) >= TOP;
                }
            }
        }
        clipped
    }
}

/// What a channel's code counts for in one frame.
#[derive(Clone)]
struct Table {
    /// X / dt.
    radiance: [f32; CODES],
    weight: [f32; CODES],
    /// X / dt of the code less [`LIFT`].
    vouched: [f32; CODES],
}

/// One pixel of one frame, in its three channels.
#[derive(Clone, Copy)]
pub(super) struct View {
    /// On the scale 0..=255.
    pub code: [f32; 3],
    /// X / dt.
    pub radiance: [f32; 3],
    /// w.
    pub weight: [f32; 3],
    /// The radiance that the scene has here at least.
    pub vouched: [f32; 3],
}

/// A frame that takes part.
pub(super) struct Layer<'a> {
    frame: &'a Frame,
    warp: Warp,
    tables: Box<[Table; 3]>,
    /// The weight of the frame's middle code.
    pub say: f32,
    /// For each channel the radiance from which on the frame clips for sure, and the inverse of the range over which it begins to.
    pub clips: [(f32, f32); 3],
    /// v by the brightest channel's code.
    pub guard: [f32; CODES],
}

impl Layer<'_> {
    /// What is needed of the frame for strips of columns `columns` and rows `rows` of the reference.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch), where the frame is on disk.
    pub fn window(&self, columns: &Range<usize>, rows: &Range<usize>) -> Result<Window<'_>> {
        let size = (self.frame.width(), self.frame.height());
        self.frame.window(rows_under(&self.warp, size, &wide(columns, size.0), &wide(rows, size.1)))
    }

    /// What the frame, of which `window` is read, has at columns `columns` and rows `rows` of the reference.
    pub fn strip<'w>(&self, window: &'w Window, columns: Range<usize>, rows: Range<usize>) -> Strip<'w> {
        let (c, r) = (wide(&columns, window.width()), wide(&rows, window.height()));
        let (before, width, height) = ((columns.start - c.start, rows.start - r.start), c.len(), r.len());
        let codes = match (window.codes(), self.warp) {
            (bracket::Codes::Eight(codes), Warp::Identity) => {
                let (stride, first) = (3 * window.width(), window.rows().start);
                Codes::Exact(
                    &codes[(r.start - first) * stride + 3 * c.start..(r.end - 1 - first) * stride + 3 * c.end],
                    stride,
                )
            }
            (_, warp) => {
                let mut moved = vec![[OUTSIDE; 3]; width * height];
                resample_rows(window, &warp, c, r, &mut moved);
                Codes::Moved(moved)
            }
        };
        let at_top = codes.clipped(width, height);
        let near = |row: &[bool], x: usize| row[x] | row[x.saturating_sub(1)] | row[(x + 1).min(width - 1)];
        let clipped = at_top.chunks_exact(width).flat_map(|row| (0..width).map(move |x| near(row, x))).collect();
        Strip { codes, before, width, clipped }
    }

    /// Calls `add(x, view, share)` for each of `count` pixels of row `y` of a strip that the frame covers: x from 0, and by what share its
    /// weight counts beside clipped pixels.
    #[inline(always)]
    pub fn row(&self, strip: &Strip, y: usize, count: usize, mut add: impl FnMut(usize, &View, f32)) {
        let (left, width) = (strip.before.0, strip.width);
        let y = y + strip.before.1;
        // Beyond the picture's border there is nothing that could clip.
        let flags = |row: usize| &strip.clipped[row.min(strip.clipped.len() / width - 1) * width + left..];
        let (above, at, below) = (flags(y.saturating_sub(1)), flags(y), flags(y + 1));
        let share = |x: usize| if above[x] | at[x] | below[x] { RINGING } else { 1.0 };
        match &strip.codes {
            Codes::Exact(codes, stride) => {
                let row = codes[y * stride + 3 * left..].chunks_exact(3).take(count);
                for (x, z) in row.enumerate() {
                    add(x, &self.exact([z[0], z[1], z[2]]), share(x));
                }
            }
            Codes::Moved(codes) => {
                for (x, &code) in codes[y * width + left..][..count].iter().enumerate() {
                    if let Some(view) = self.between(code) {
                        add(x, &view, share(x));
                    }
                }
            }
        }
    }

    /// The view that a pixel with these codes is.
    #[inline]
    fn exact(&self, z: [u8; 3]) -> View {
        let at = |of: fn(&Table) -> &[f32; CODES]| std::array::from_fn(|c| of(&self.tables[c])[usize::from(z[c])]);
        View {
            code: z.map(f32::from),
            radiance: at(|t| &t.radiance),
            weight: at(|t| &t.weight),
            vouched: at(|t| &t.vouched),
        }
    }

    /// The view that a pixel between codes is; none where the frame does not reach.
    #[inline]
    fn between(&self, code: [f32; 3]) -> Option<View> {
        if code[0] < 0.0 {
            return None;
        }
        let mut view = View { code, radiance: [0.0; 3], weight: [0.0; 3], vouched: [0.0; 3] };
        for c in 0..3 {
            let (code, table) = (code[c].clamp(0.0, 255.0), &self.tables[c]);
            let below = (code as usize).min(CODES - 2);
            let f = code - below as f32;
            let mix = |t: &[f32; CODES]| t[below] + f * (t[below + 1] - t[below]);
            (view.radiance[c], view.weight[c]) = (mix(&table.radiance), mix(&table.weight));
            view.vouched[c] = table.vouched[below];
        }
        Some(view)
    }
}

/// `range` and one more to either side, where there is one.
fn wide(range: &Range<usize>, most: usize) -> Range<usize> {
    range.start.saturating_sub(1)..(range.end + 1).min(most)
}

/// The frames that were placed, by rising exposure. Weights are such that the longest exposure's middle code has 1.
pub(super) fn layers<'a>(
    bracket: &'a Bracket,
    alignment: &Alignment,
    curve: &ResponseCurve,
    weight: Weight,
) -> Result<Vec<Layer<'a>>> {
    let reference = bracket.reference().exposure.relative();
    let placed = bracket.frames().iter().zip(&alignment.verdicts);
    let mut layers: Vec<Layer> = placed
        .filter(|(_, verdict)| verdict.status != Status::Rejected)
        .filter_map(|(frame, verdict)| {
            let warp = verdict.warp?;
            Some(layer(frame, warp, frame.exposure.relative() / reference, curve, weight))
        })
        .collect::<Result<_>>()?;
    let most = layers.last().map_or(1.0, |layer| layer.say);
    for layer in &mut layers {
        layer.say /= most;
        for table in layer.tables.iter_mut() {
            table.weight.iter_mut().for_each(|w| *w /= most);
        }
    }
    Ok(layers)
}

/// `frame`, exposed `time` times as long as the reference.
fn layer<'a>(frame: &'a Frame, warp: Warp, time: f64, curve: &ResponseCurve, weight: Weight) -> Result<Layer<'a>> {
    let noise = match weight {
        Weight::Noise => Noise::of(frame, warp != Warp::Identity)?,
        _ => Noise::least(),
    };
    let tables = std::array::from_fn(|c| {
        let radiance = curve.exposures(c).map(|x| (f64::from(x) / time) as f32);
        Table {
            radiance,
            weight: weight.table(curve, c, time, &noise),
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
            (sure, 1.0 / (sure - begins))
        }
    };
    Ok(Layer {
        frame,
        warp,
        say: weight.say(curve, time, &noise),
        clips: std::array::from_fn(|c| clips(&tables[c])),
        guard: std::array::from_fn(|code| match weight {
            Weight::Uniform => 1.0,
            _ => ((255.0 - code as f32) / GUARD.0).clamp(GUARD.1, 1.0),
        }),
        tables: Box::new(tables),
    })
}
