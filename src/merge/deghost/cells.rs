//! Cells: the radiance of a frame on a coarse grid of the reference frame.
//!
//! In: a frame, its motion and the response. Out: the mean radiance of each cell and channel, and whether it is only
//! a bound. Cost: one bilinear sample, which reads four pixels, for every block of 2 x 2 pixels, but at most four for
//! each cell.
//!
//! Means are of exposures, not of code values, because the mean code value of an edge stands for a different exposure
//! in every frame. In a cell with a clipped code value the mean is a lower bound of the radiance; in a cell with a
//! black one it is an upper bound.

use super::{CODES, Layer, Plane, Rect, ResponseCurve};
use crate::bracket::Codes;
use crate::error::Result;

/// Code values above this may be clipped, because JPEG changes clipped values a little.
const CLIPPED: f32 = 248.0;
/// Code values count as black up to this many code values above the black of the response. The camera has cut off the
/// noise below black, so the mean of dark pixels is too bright.
const BLACK: f64 = 5.0;
/// Standard deviation of a code value from rounding, JPEG and the sensor.
const NOISE: f64 = 1.5;

/// Right shift from the bits of a radiance to its index in the noise table of a [`Meaning`]: floats with the same
/// exponent and the same first three bits of the mantissa share an entry, so there are eight entries per octave.
const SHIFT: u32 = 20;

const OUTSIDE: u8 = 1 << 6;

/// Radiance and noise of the code values of a frame.
pub struct Meaning {
    /// Radiance of each code value: its exposure divided by the exposure of the frame.
    radiance: [[f32; CODES]; 3],
    /// Code value up to which a channel counts as black.
    black: [f32; 3],
    /// Upper bound of the radiance of a black cell.
    black_radiance: [f32; 3],
    /// Relative standard deviation, indexed by the exponent and the first bits of the radiance, see [`SHIFT`].
    noise: [Vec<f32>; 3],
}

impl Meaning {
    /// Returns the table for a frame with `time` times the exposure of the reference frame.
    pub fn of(curve: &ResponseCurve, time: f64) -> Self {
        let radiance: [[f32; CODES]; 3] =
            std::array::from_fn(|c| curve.exposures(c).map(|x| (f64::from(x) / time) as f32));
        let black: [f32; 3] = std::array::from_fn(|c| (curve.black(c) + BLACK) as f32);
        Meaning {
            black,
            black_radiance: std::array::from_fn(|c| (f64::from(curve.exposure(c, black[c])) / time) as f32),
            noise: std::array::from_fn(|c| noise(&radiance[c])),
            radiance,
        }
    }
}

/// Returns the noise table of a channel: the relative standard deviation of each radiance from 0 to infinity, in steps
/// given by [`SHIFT`].
fn noise(radiance: &[f32; CODES]) -> Vec<f32> {
    (0..(f32::INFINITY.to_bits() >> SHIFT))
        .map(|step| {
            let x = f32::from_bits(step << SHIFT | 1 << (SHIFT - 1));
            let code = radiance.partition_point(|&r| r < x).clamp(1, CODES - 2);
            let slope = 0.5 * f64::from(radiance[code + 1] - radiance[code - 1]);
            (NOISE * slope / f64::from(x)) as f32
        })
        .collect()
}

/// One cell of one frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cell {
    /// Radiance.
    pub radiance: [f32; 3],
    /// Bits 0 to 2: the channel is clipped; bits 3 to 5: the channel is black; bit 6: the frame does not show the
    /// cell.
    flags: u8,
    /// Index of the frame among the merged frames.
    frame: u16,
}

impl Cell {
    /// Whether the frame does not show the cell.
    pub fn is_outside(&self) -> bool {
        self.flags & OUTSIDE != 0
    }

    /// Whether a channel's radiance is a lower bound.
    pub fn is_clipped(&self, channel: usize) -> bool {
        self.flags >> channel & 1 != 0
    }

    /// Whether a channel's radiance is an upper bound.
    pub fn is_black(&self, channel: usize) -> bool {
        self.flags >> (3 + channel) & 1 != 0
    }

    /// Whether a channel's radiance is a bound of either kind.
    pub fn is_bound(&self, channel: usize) -> bool {
        self.is_clipped(channel) || self.is_black(channel)
    }

    /// Whether some channel is clipped.
    pub fn clips(&self) -> bool {
        self.flags & 7 != 0
    }

    /// Returns this cell with its radiance multiplied by `gain`, for a locally processed frame. A cell with a clipped
    /// channel is marked as outside the frame: a phone leaves clipped pixels white, whatever it does to their
    /// surroundings, so after the gain their radiance is not even a lower bound.
    pub fn with_gain(self, gain: f32) -> Self {
        let outside = if self.clips() { OUTSIDE } else { 0 };
        Cell { radiance: self.radiance.map(|v| v * gain), flags: self.flags | outside, ..self }
    }

    /// Returns the relative standard deviation of a channel.
    #[inline]
    pub fn relative_noise(&self, channel: usize, meanings: &[&Meaning]) -> f32 {
        let step = (self.radiance[channel].to_bits() >> SHIFT) as usize;
        meanings[usize::from(self.frame)].noise[channel].get(step).copied().unwrap_or(0.0)
    }
}

/// Returns the cells of `region` in `layer`. `side` is the side of a cell in pixels, an even number; `number` is the
/// index of the frame among the merged frames.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch) if the frame is on disk and cannot be read.
pub fn average(layer: &Layer, region: Rect, side: usize, number: u16) -> Result<Plane<Cell>> {
    let radiance = &layer.meaning.radiance;
    Ok(match layer.frame.whole()?.codes() {
        Codes::Eight(codes) => {
            let of = |code: u8, c: usize| (f32::from(code), radiance[c][usize::from(code)]);
            averaged(layer, codes, of, region, side, number)
        }
        Codes::Sixteen(codes) => {
            let of = |code: u16, c: usize| {
                let code = f32::from(code) * (1.0 / 257.0);
                let below = (code as usize).min(CODES - 2);
                let (a, b) = (radiance[c][below], radiance[c][below + 1]);
                (code, a + (code - below as f32) * (b - a))
            };
            averaged(layer, codes, of, region, side, number)
        }
    })
}

/// Returns the positions, within a cell, of the blocks of 2x2 pixels that are read. In cells of up to 4x4 pixels all
/// blocks are read. In larger cells four blocks are read: two in one row and two in another row, in other columns.
fn blocks(side: usize) -> Vec<(usize, usize)> {
    let (half, step) = (side / 2, (side / 4).max(1));
    let rows = (0..half).step_by(step).enumerate();
    rows.flat_map(|(i, b)| (0..half).step_by(step).map(move |a| (2 * (a + i % step), 2 * b))).collect()
}

/// Like [`average`]. For a stored code value and a channel, `of` returns the code value on the scale 0..=255 and its
/// radiance.
fn averaged<T: Copy + Sync>(
    layer: &Layer,
    codes: &[T],
    of: impl Fn(T, usize) -> (f32, f32) + Sync,
    region: Rect,
    side: usize,
    number: u16,
) -> Plane<Cell> {
    let Layer { frame, motion, meaning, .. } = layer;
    let (width, height) = (frame.width(), frame.height());
    let blocks = blocks(side);
    let share = 1.0 / blocks.len() as f32;
    Plane::from_rows(region.width().div_ceil(side), region.height().div_ceil(side), |j, row| {
        for (i, cell) in row.iter_mut().enumerate() {
            let (mut sum, mut flags) = ([0.0f32; 3], 0u8);
            // Each block of 2x2 pixels of the reference frame is sampled at its centre. If the frame is not displaced,
            // bilinear interpolation gives the mean of the block.
            for (a, b) in &blocks {
                let x = ((region.x0 + side * i + a) as f64 + 0.5).min((region.x1 - 1) as f64);
                let y = ((region.y0 + side * j + b) as f64 + 0.5).min((region.y1 - 1) as f64);
                let Some((u, v)) = motion.inside(x, y) else {
                    flags |= OUTSIDE;
                    break;
                };
                let (left, top) = (u as usize, v as usize);
                let (fx, fy) = ((u - left as f64) as f32, (v - top as f64) as f32);
                let (next, under) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
                let taps = [
                    (top * width + left, (1.0 - fx) * (1.0 - fy)),
                    (top * width + next, fx * (1.0 - fy)),
                    (under * width + left, (1.0 - fx) * fy),
                    (under * width + next, fx * fy),
                ];
                for (pixel, weight) in taps {
                    let (mut least, mut most) = (f32::INFINITY, 0.0f32);
                    for c in 0..3 {
                        let (code, radiance) = of(codes[3 * pixel + c], c);
                        sum[c] += weight * radiance;
                        flags |= u8::from(code > CLIPPED) << c | u8::from(code <= meaning.black[c]) << (3 + c);
                        (least, most) = (least.min(code), most.max(code));
                    }
                    // No scene has a channel at white and another at 0: the colour is painted, as in the borders of
                    // registered scans.
                    flags |= if least <= 0.5 && most >= 254.5 { OUTSIDE } else { 0 };
                }
            }
            let mut cell_radiance = sum.map(|s| s * share);
            for c in 0..3 {
                if flags >> (3 + c) & 1 != 0 {
                    cell_radiance[c] = cell_radiance[c].max(meaning.black_radiance[c]);
                }
            }
            *cell = Cell { radiance: cell_radiance, flags, frame: number };
        }
    })
}
