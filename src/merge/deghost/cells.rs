//! Cells: a frame's radiance on a coarse grid of the reference.
//!
//! In: a frame, where it lies, what its codes mean. Out: the mean radiance of each cell and channel, and whether it is only a bound.
//! Cost: four taps for every four pixels.
//!
//! Means are of exposures, not of codes: the mean code of an edge means another exposure in every frame. Of a cell with a clipped code the
//! mean is a lower bound, of one with a black code an upper one.

use super::{CODES, Layer, Plane, Rect, ResponseCurve, Transform};
use crate::align::transform::map;
use crate::bracket::Codes;
use crate::error::Result;

/// Codes from here on may be clipped: JPEG moves them by some codes.
const CLIPPED: f32 = 248.0;
/// Codes up to so many above the black level are black: the camera cut off what was below, so that the mean is too bright.
const BLACK: f64 = 5.0;
/// Standard deviation of a code by rounding, JPEG and the sensor, in codes.
const NOISE: f64 = 1.5;

/// Steps of a [`Meaning`]'s noise to an octave of radiance: floats that share exponent and first three bits.
const SHIFT: u32 = 20;

const OUTSIDE: u8 = 1 << 6;

/// What a frame's codes mean.
pub struct Meaning {
    /// Radiance at each code: exposure over the frame's time.
    radiance: [[f32; CODES]; 3],
    /// Codes up to which a channel is black.
    black: [f32; 3],
    /// The radiance up to which a black cell may reach.
    black_radiance: [f32; 3],
    /// Standard deviation over radiance, by the radiance's exponent and first bits.
    noise: [Vec<f32>; 3],
}

impl Meaning {
    /// That of a frame exposed `time` times as long as the reference.
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

/// The relative standard deviation for each step of radiance from 0 to infinity.
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
    /// Bits 0 to 2: a channel is clipped; 3 to 5: it is black; 6: the frame does not cover the cell.
    flags: u8,
    /// The frame, among those placed.
    frame: u16,
}

impl Cell {
    /// Whether the frame does not cover it.
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

    /// The same cell of a frame that a camera processed locally: multiplied by `gain`, and nothing is known where it clips. What clips is white
    /// whatever is around it, and so is no bound of what the gain makes of another frame.
    pub fn with_gain(self, gain: f32) -> Self {
        let outside = if self.clips() { OUTSIDE } else { 0 };
        Cell { radiance: self.radiance.map(|v| v * gain), flags: self.flags | outside, ..self }
    }

    /// The standard deviation of a channel over its radiance.
    #[inline]
    pub fn relative_noise(&self, channel: usize, meanings: &[&Meaning]) -> f32 {
        let step = (self.radiance[channel].to_bits() >> SHIFT) as usize;
        meanings[usize::from(self.frame)].noise[channel].get(step).copied().unwrap_or(0.0)
    }
}

/// The cells of `region`, each `side` pixels (even), as `layer` sees them; it is placed frame number `number`.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch), where the frame is on disk.
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

/// The blocks of 2x2 pixels of a cell that are looked at, by their columns and rows: four of larger cells, of every other row alternately.
fn blocks(side: usize) -> Vec<(usize, usize)> {
    let (half, step) = (side / 2, (side / 4).max(1));
    let rows = (0..half).step_by(step).enumerate();
    rows.flat_map(|(i, b)| (0..half).step_by(step).map(move |a| (2 * (a + i % step), 2 * b))).collect()
}

/// As [`average`]; `of` gives a code on the scale 0..=255, and its radiance in a channel.
fn averaged<T: Copy + Sync>(
    layer: &Layer,
    codes: &[T],
    of: impl Fn(T, usize) -> (f32, f32) + Sync,
    region: Rect,
    side: usize,
    number: u16,
) -> Plane<Cell> {
    let Layer { frame, warp, meaning, .. } = layer;
    let (width, height) = (frame.width(), frame.height());
    let (right, bottom) = ((width - 1) as f64, (height - 1) as f64);
    let h = warp.matrix(width, height);
    let still = *warp == Transform::Identity;
    let blocks = blocks(side);
    let share = 1.0 / blocks.len() as f32;
    Plane::from_rows(region.width().div_ceil(side), region.height().div_ceil(side), |j, row| {
        for (i, cell) in row.iter_mut().enumerate() {
            let (mut sum, mut flags) = ([0.0f32; 3], 0u8);
            // Blocks of 2x2 pixels of the reference, each by its centre: bilinear there is their mean where nothing moved.
            for (a, b) in &blocks {
                let x = ((region.x0 + side * i + a) as f64 + 0.5).min((region.x1 - 1) as f64);
                let y = ((region.y0 + side * j + b) as f64 + 0.5).min((region.y1 - 1) as f64);
                let (u, v) = if still { (x, y) } else { map(&h, x, y) };
                // Written so that a place that is no number is outside too.
                if !(u >= 0.0 && v >= 0.0 && u <= right && v <= bottom) {
                    flags |= OUTSIDE;
                    break;
                }
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
                    // No light has a channel at the top and another at 0: the colour is painted, as the borders of registered scans are.
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
