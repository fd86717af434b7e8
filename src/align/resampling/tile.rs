//! Lanczos resampling of rows, tile by tile.
//!
//! In: the pixel values of some rows of a frame, and its motion. Out: pixel values as floats on the reference's grid.
//! Cost: see [`resampling`](crate::align::resampling).
//!
//! The kernel is applied vertically first: the sum over a column of six pixels is a column sum. Then it is applied
//! horizontally to the column sums. The part of the frame under a tile is converted to floats once; beyond the border
//! of the frame, the border pixels are repeated. Neighbouring pixels of the output share column sums if they lie
//! between the same two rows of the frame, at the same fraction between them (the phase).

use crate::align::motion::Motion;
use crate::align::motion::camera::Camera;
use crate::align::motion::relief::Visibility;
use crate::align::resampling::OUTSIDE;
use crate::align::resampling::lanczos::{BEFORE, TAPS, WEIGHTS, taps_at};
use crate::align::transform::map;
use crate::simd::{Loops, vectorised};
use nalgebra::Matrix3;
use std::cell::RefCell;
use std::ops::Range;

/// Largest number of columns and of rows of a tile. With this size, the data of a tile fits into the inner caches.
const TILE: (usize, usize) = (136, 36);

/// Largest number of columns and of rows of the frame under a tile. Tiles that need more are computed pixel by pixel:
/// those of transforms that scale by more than about 4/3, or rotate by more than about 20 degrees, and those with
/// distant depths.
const WINDOW: (usize, usize) = (192, 96);

/// Number of values that are summed together in a vector.
const LANES: usize = 8;

/// Distance between the starts of successive rows in the copied part of the frame, in values. It is longer than a row,
/// so that a whole vector can be read at every pixel.
const STRIDE: usize = 3 * WINDOW.0 + 2 * LANES;

/// Number of column sums (values of a column, weighted and added) that one pixel needs, rounded up to whole vectors.
const SUMS: usize = (3 * TAPS).next_multiple_of(LANES);

/// The pixel values of a frame, and their scale.
pub(super) struct Source<'a, T> {
    pub(super) codes: &'a [T],
    /// The row of the frame with which `codes` begins.
    pub(super) first: usize,
    /// Size of the whole frame.
    pub(super) size: (usize, usize),
    /// Factor that converts pixel values to 0..=255.
    pub(super) scale: f32,
}

impl<T: Copy + Into<f32>> Source<'_, T> {
    /// See [`resample_rows`](crate::align::resampling::resample_rows).
    pub(super) fn resample(&self, motion: &Motion, columns: Range<usize>, rows: Range<usize>, out: &mut [[f32; 3]]) {
        let stride = columns.len();
        if motion.is_identity() {
            for (y, line) in rows.zip(out.chunks_exact_mut(stride.max(1))) {
                let codes = &self.row(y)[3 * columns.start..3 * columns.end];
                vectorised(Copied { codes, scale: self.scale, line: line.as_flattened_mut() });
            }
            return;
        }
        SCRATCH.with_borrow_mut(|scratch| {
            for rows_here in parts(rows.clone(), TILE.1) {
                for columns_here in parts(columns.clone(), TILE.0) {
                    let from = (rows_here.start - rows.start) * stride + columns_here.start - columns.start;
                    let out = &mut out[from..];
                    vectorised(Tile {
                        source: self,
                        motion,
                        columns: columns_here,
                        rows: rows_here.clone(),
                        out,
                        stride,
                        scratch,
                    });
                }
            }
        });
    }

    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> &[T] {
        let from = 3 * (y - self.first) * self.size.0;
        &self.codes[from..from + 3 * self.size.0]
    }

    /// Returns the value at (u, v), which must be within the rectangle of pixel centres. Where the kernel reaches
    /// beyond the border, the border pixels are repeated.
    #[inline(always)]
    pub(super) fn at(&self, u: f64, v: f64) -> [f32; 3] {
        let most = f64::from(i32::MAX);
        let ((left, across), (top, down)) = (taps_at(u, most), taps_at(v, most));
        let clamp = |i: i32, tap: usize, size: usize| (i + tap as i32).clamp(0, size as i32 - 1) as usize;
        let mut value = [0.0f32; 3];
        for (i, wx) in WEIGHTS[across as usize].iter().enumerate() {
            let x = clamp(left, i, self.size.0);
            let mut sum = [0.0f32; 3];
            for (j, wy) in WEIGHTS[down as usize].iter().enumerate() {
                let row = self.row(clamp(top, j, self.size.1));
                for c in 0..3 {
                    sum[c] += wy * row[3 * x + c].into();
                }
            }
            for c in 0..3 {
                value[c] += wx * sum[c];
            }
        }
        value.map(|v| (v * self.scale).clamp(0.0, 255.0))
    }
}

/// Splits `range` into nearly equal parts of at most `most` elements; into as few as possible.
fn parts(range: Range<usize>, most: usize) -> impl Iterator<Item = Range<usize>> {
    let (start, length) = (range.start, range.len());
    let count = length.div_ceil(most);
    (0..count).map(move |i| start + i * length / count..start + (i + 1) * length / count)
}

/// A row of a frame that needs no resampling.
struct Copied<'a, T> {
    codes: &'a [T],
    scale: f32,
    line: &'a mut [f32],
}

impl<T: Copy + Into<f32>> Loops for Copied<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (value, code) in self.line.iter_mut().zip(self.codes) {
            *value = (*code).into() * self.scale;
        }
    }
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch::default());
}

/// Buffers for the computation of a tile.
struct Scratch {
    /// The values of the frame under the tile.
    window: Vec<f32>,
    /// The column sums (the values of a column under the kernel, weighted and added) of a row of the tile.
    sums: Vec<f32>,
    values: Box<[[f32; 4]; TILE.0]>,
    positions: Box<SamplePositions>,
    /// Relative depths of the pixels of a row of the tile, and whether the frame shows them.
    depths: Box<[(f32, bool); TILE.0]>,
}

/// For each pixel of a row of the tile: its position in the window (the part of the frame that was copied for the
/// tile), and where its column sums begin.
struct SamplePositions {
    /// Index of the first column of the window that is under the kernel.
    left: [u32; TILE.0],
    /// Phase between two columns, in units of 1/1024 pixel; see [`taps_at`].
    across: [u32; TILE.0],
    /// Index of the first row of the window that is under the kernel, times 2^16, plus the phase between two rows.
    down: [u32; TILE.0],
    /// 1 if the position is inside the frame, otherwise 0.
    is_inside: [u32; TILE.0],
    /// Index of the pixel's first column sum.
    sums: [u32; TILE.0],
}

impl Default for Scratch {
    fn default() -> Self {
        let none = [0; TILE.0];
        Scratch {
            window: vec![0.0; WINDOW.1 * STRIDE],
            sums: vec![0.0; TILE.0 * SUMS],
            values: Box::new([[0.0; 4]; TILE.0]),
            positions: Box::new(SamplePositions { left: none, across: none, down: none, is_inside: none, sums: none }),
            depths: Box::new([(0.0, true); TILE.0]),
        }
    }
}

/// A tile of the reference to be computed.
struct Tile<'a, 'b, T> {
    source: &'a Source<'b, T>,
    motion: &'a Motion,
    columns: Range<usize>,
    rows: Range<usize>,
    /// The output, beginning at the tile's first pixel.
    out: &'a mut [[f32; 3]],
    /// Distance between successive rows of the output, in pixels.
    stride: usize,
    scratch: &'a mut Scratch,
}

impl<T: Copy + Into<f32>> Loops for Tile<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let last = (self.source.size.0 as f64 - 1.0, self.source.size.1 as f64 - 1.0);
        let bounds = self.motion.bounds(&self.columns, &self.rows);
        let footprint = footprint(&bounds, &self.columns, &self.rows, last);
        let width = self.columns.len();
        let lines = self.rows.zip(self.out.chunks_mut(self.stride).map(|line| &mut line[..width]));
        match footprint {
            Footprint::Outside => lines.for_each(|(_, line)| line.fill([OUTSIDE; 3])),
            Footprint::Window(across, down) => {
                let Scratch { window, sums, values, positions, depths } = self.scratch;
                fill(self.source, &across, &down, window);
                let [h, _] = &bounds;
                let is_affine = h[(2, 0)] == 0.0 && h[(2, 1)] == 0.0 && h[(2, 2)] == 1.0;
                for (y, line) in lines {
                    let (first, origin) = ((self.columns.start, y), (across.start, down.start));
                    if let Some((relief, view)) = self.motion.relief() {
                        for (x, depth) in self.columns.clone().zip(depths.iter_mut()) {
                            let (q, visibility) = relief.at(view, x as f32, y as f32);
                            *depth = (q, visibility == Visibility::Shown);
                        }
                        positions.find_at_depths(&view.camera, depths, first, origin, last);
                    } else if let Some(bend) = self.motion.bend() {
                        for (i, x) in self.columns.clone().enumerate() {
                            positions.set(i, bend.position(x as f64, y as f64), origin, last);
                        }
                    } else if is_affine {
                        positions.find::<true>(h, first, origin, last);
                    } else {
                        positions.find::<false>(h, first, origin, last);
                    }
                    positions.sum(window, sums, width);
                    positions.across(sums, self.source.scale, values, line);
                }
            }
            Footprint::TooLarge => {
                for (y, line) in lines {
                    for (x, pixel) in self.columns.clone().zip(line) {
                        let at = self.motion.inside(x as f64, y as f64);
                        *pixel = at.map_or([OUTSIDE; 3], |(u, v)| self.source.at(u, v));
                    }
                }
            }
        }
    }
}

/// The part of the frame under a tile.
enum Footprint {
    /// The tile is outside the frame.
    Outside,
    /// The columns and the rows of the frame that are needed; some may be beyond the border.
    Window(Range<i32>, Range<i32>),
    /// The part is larger than [`WINDOW`], or cannot be determined.
    TooLarge,
}

#[inline(always)]
fn footprint(bounds: &[Matrix3<f64>], columns: &Range<usize>, rows: &Range<usize>, last: (f64, f64)) -> Footprint {
    let (mut us, mut vs) = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
    let corners = [columns.start, columns.end - 1].map(|x| [rows.start, rows.end - 1].map(|y| (x as f64, y as f64)));
    for &(x, y) in corners.as_flattened() {
        for h in bounds {
            // If all four corners are in front of the horizon (w > 0), the frame under the tile is within the bounding
            // box of the mapped corners.
            let is_before = h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)] > 0.0;
            let (u, v) = map(h, x, y);
            if !(is_before && u.is_finite() && v.is_finite()) {
                return Footprint::TooLarge;
            }
            us = (us.0.min(u), us.1.max(u));
            vs = (vs.0.min(v), vs.1.max(v));
        }
    }
    // The margin of one pixel is for rounding.
    if us.1 < -1.0 || vs.1 < -1.0 || us.0 > last.0 + 1.0 || vs.0 > last.1 + 1.0 {
        return Footprint::Outside;
    }
    let range = |(least, most): (f64, f64), last: f64| {
        // Positions outside the frame are clamped here; `SamplePositions::find` marks them.
        let (first, end) = (least.clamp(0.0, last) as i32 - 1, most.clamp(0.0, last) as i32 + 2);
        first - BEFORE as i32..end + (TAPS - BEFORE - 1) as i32
    };
    let (across, down) = (range(us, last.0), range(vs, last.1));
    if across.len() <= WINDOW.0 && down.len() <= WINDOW.1 {
        Footprint::Window(across, down)
    } else {
        Footprint::TooLarge
    }
}

/// Copies the frame's values at columns `across` and rows `down` to `window`; beyond the border, the border pixels are
/// repeated.
#[inline(always)]
fn fill<T: Copy + Into<f32>>(source: &Source<T>, across: &Range<i32>, down: &Range<i32>, window: &mut [f32]) {
    let (width, height) = (source.size.0 as i32, source.size.1 as i32);
    let inside = across.start.clamp(0, width - 1)..across.end.clamp(1, width);
    let (before, after) = ((inside.start - across.start) as usize, (inside.end - across.start) as usize);
    for (y, row) in down.clone().zip(window.chunks_exact_mut(STRIDE)) {
        let codes = &source.row(y.clamp(0, height - 1) as usize)[3 * inside.start as usize..3 * inside.end as usize];
        let row = &mut row[..3 * across.len()];
        for (value, code) in row[3 * before..3 * after].iter_mut().zip(codes) {
            *value = (*code).into();
        }
        let pixels = row.as_chunks_mut::<3>().0;
        let (first, last) = (pixels[before], pixels[after - 1]);
        pixels[..before].fill(first);
        pixels[after..].fill(last);
    }
}

impl SamplePositions {
    /// Computes the positions of a row of pixels of the reference that begins at pixel `first`.
    ///
    /// `origin` is the frame's pixel at which the window begins, `last` the last pixel of the frame.
    #[inline(always)]
    fn find<const AFFINE: bool>(
        &mut self,
        h: &Matrix3<f64>,
        first: (usize, usize),
        origin: (i32, i32),
        last: (f64, f64),
    ) {
        let (start, y) = (first.0 as i32, first.1 as f64);
        let (a, b, c) = (h[(0, 0)], h[(0, 1)] * y, h[(0, 2)]);
        let (d, e, f) = (h[(1, 0)], h[(1, 1)] * y, h[(1, 2)]);
        let (p, q, r) = (h[(2, 0)], h[(2, 1)] * y, h[(2, 2)]);
        for i in 0..TILE.0 {
            let x = f64::from(start + i as i32);
            let (mut u, mut v) = (a * x + b + c, d * x + e + f);
            // For affine transforms, the divisor is 1, so the division is left out: it would take as long as all the
            // rest.
            if !AFFINE {
                let w = p * x + q + r;
                (u, v) = (u / w, v / w);
            }
            self.set(i, (u, v), origin, last);
        }
    }

    /// Like [`find`](Self::find), for pixels with these relative `depths`, which are shown or hidden.
    #[inline(always)]
    fn find_at_depths(
        &mut self,
        camera: &Camera,
        depths: &[(f32, bool); TILE.0],
        first: (usize, usize),
        origin: (i32, i32),
        last: (f64, f64),
    ) {
        for (i, &(depth, is_shown)) in depths.iter().enumerate() {
            let (x, y) = ((first.0 + i) as f64, first.1 as f64);
            self.set(i, camera.position(x, y, f64::from(depth)), origin, last);
            self.is_inside[i] &= u32::from(is_shown);
        }
    }

    /// Sets the position of pixel `i` of the row to `at`.
    #[inline(always)]
    fn set(&mut self, i: usize, (u, v): (f64, f64), origin: (i32, i32), last: (f64, f64)) {
        self.is_inside[i] = u32::from(u >= 0.0) & u32::from(v >= 0.0) & u32::from(u <= last.0) & u32::from(v <= last.1);
        let ((left, across), (top, down)) = (taps_at(u, last.0), taps_at(v, last.1));
        self.left[i] = (left - origin.0) as u32;
        self.across[i] = across as u32;
        self.down[i] = ((top - origin.1) << 16 | down) as u32;
    }

    /// Computes the column sums of the first `count` pixels of the row.
    #[inline(always)]
    fn sum(&mut self, window: &[f32], sums: &mut [f32], count: usize) {
        let (left, down, begins) = (&self.left[..count], &self.down[..count], &mut self.sums[..count]);
        let (mut next, mut free) = (0, 0);
        while next < count {
            // Successive pixels of the output share column sums if their positions in the frame are between the same
            // two rows, at the same phase, and each position is at most two columns to the right of the one before.
            let (row, first) = (down[next], left[next]);
            let mut at = first;
            while next < count && down[next] == row && left[next].wrapping_sub(at) <= 2 {
                at = left[next];
                begins[next] = free as u32 + 3 * (at - first);
                next += 1;
            }
            let end = free + (3 * (at - first) as usize + SUMS).next_multiple_of(LANES);
            let weights = &WEIGHTS[(row & 0xFFFF) as usize];
            let mut from = (row >> 16) as usize * STRIDE + 3 * first as usize;
            for sums in sums[free..end].as_chunks_mut::<LANES>().0 {
                let codes = &window[from..from + (TAPS - 1) * STRIDE + LANES];
                let mut sum = [0.0f32; LANES];
                for (j, w) in weights.iter().enumerate() {
                    for k in 0..LANES {
                        sum[k] += w * codes[j * STRIDE + k];
                    }
                }
                *sums = sum;
                from += LANES;
            }
            free = end;
        }
    }

    /// Computes each pixel of `line` from its column sums, and multiplies it by `scale`.
    #[inline(always)]
    fn across(&self, sums: &[f32], scale: f32, values: &mut [[f32; 4]; TILE.0], line: &mut [[f32; 3]]) {
        let count = line.len();
        let (begins, across) = (&self.sums[..count], &self.across[..count]);
        for (i, value) in values[..count].iter_mut().enumerate() {
            // Four values, which fill a vector, are computed at once. The fourth belongs to the next column and is
            // ignored.
            let sums = &sums[begins[i] as usize..begins[i] as usize + 3 * TAPS + 1];
            let mut sum = [0.0f32; 4];
            for (j, w) in WEIGHTS[across[i] as usize].iter().enumerate() {
                for c in 0..4 {
                    sum[c] += w * sums[3 * j + c];
                }
            }
            *value = sum;
        }
        for ((pixel, value), is_inside) in line.iter_mut().zip(values).zip(&self.is_inside) {
            for c in 0..3 {
                let value = (value[c] * scale).clamp(0.0, 255.0);
                pixel[c] = if *is_inside != 0 { value } else { OUTSIDE };
            }
        }
    }
}
