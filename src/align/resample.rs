//! Resampling: a frame's code values on the reference's grid, in a single step.
//!
//! In: a [`Frame`] and a [`Warp`]. Out: code values as floats, by rows, with a mark where the frame does not reach.
//! Cost: 36 multiply-adds a value; a copy where nothing moves. Source: Lanczos' kernel with three lobes, as Turkowski, "Filters for
//! Common Resampling Tasks", Graphics Gems I (1990), recommends it for photographs; its weights are normalised to sum to 1.

use super::warp::{Warp, map};
use crate::bracket::{Codes, Window};
use crate::simd::{Loops, vectorised};
use nalgebra::Matrix3;
use std::f64::consts::PI;
use std::ops::Range;
use std::sync::LazyLock;

/// What [`resample_rows`] puts into all three channels where the frame has no pixel.
pub const OUTSIDE: f32 = -1.0;

/// Pixels under the kernel, along each axis.
const TAPS: usize = 6;
/// Of these, how many lie before the pixel that the place falls behind.
const BEFORE: usize = 2;
/// Values of a row that are summed at once: those of the taps' pixels, and of a part of the next, so that they fill whole vectors.
const LANES: usize = 24;
/// Positions of the kernel between two pixels: 1/1024 px apart, so that the rounding is under a tenth of a code at the steepest edge.
const PHASES: usize = 1024;

/// The rows of a frame of `size` pixels that are read for the reference's pixels `columns` x `rows`.
pub fn rows_under(warp: &Warp, size: (usize, usize), columns: &Range<usize>, rows: &Range<usize>) -> Range<usize> {
    if columns.is_empty() || rows.is_empty() {
        return 0..0;
    }
    if *warp == Warp::Identity {
        return rows.clone();
    }
    let h = warp.matrix(size.0, size.1);
    let corners = [columns.start, columns.end - 1].map(|x| [rows.start, rows.end - 1].map(|y| (x as f64, y as f64)));
    let corners = corners.as_flattened();
    let w = |&(x, y): &(f64, f64)| h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)];
    // A homography takes a convex figure to a convex one, unless it takes a line across it to infinity.
    if !(corners.iter().all(|c| w(c) > 0.0) || corners.iter().all(|c| w(c) < 0.0)) {
        return 0..size.1;
    }
    let places = corners.iter().map(|&(x, y)| map(&h, x, y).1);
    let (top, bottom) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    // The taps, and a row for rounding; a cast from float keeps within the type.
    let first = (top - (BEFORE + 1) as f64).max(0.0) as usize;
    let end = (bottom + (TAPS - BEFORE + 1) as f64).max(0.0) as usize;
    first.min(size.1)..end.min(size.1)
}

/// The frame's code values, on the scale 0..=255 whatever its depth, at the reference's pixels `columns` x `rows`, by rows into `out`.
///
/// A pixel whose place lies outside the rectangle of the frame's pixel centres is [`OUTSIDE`] in all channels.
///
/// # Panics
/// When `out` does not hold `columns.len() * rows.len()` pixels, or `window` not the [`rows_under`] them.
pub fn resample_rows(window: &Window, warp: &Warp, columns: Range<usize>, rows: Range<usize>, out: &mut [[f32; 3]]) {
    assert_eq!(out.len(), columns.len() * rows.len());
    let (size, first) = ((window.width(), window.height()), window.rows().start);
    match window.codes() {
        Codes::Eight(codes) => Source { codes, first, size, scale: 1.0 }.resample(warp, columns, rows, out),
        Codes::Sixteen(codes) => Source { codes, first, size, scale: 1.0 / 257.0 }.resample(warp, columns, rows, out),
    }
}

/// The code values of a frame, and what takes them to 0..=255.
struct Source<'a, T> {
    codes: &'a [T],
    /// The row that the codes begin with.
    first: usize,
    /// Of the whole frame.
    size: (usize, usize),
    scale: f32,
}

impl<T: Copy + Into<f32>> Source<'_, T> {
    fn resample(&self, warp: &Warp, columns: Range<usize>, rows: Range<usize>, out: &mut [[f32; 3]]) {
        let lines = rows.zip(out.chunks_exact_mut(columns.len().max(1)));
        if *warp == Warp::Identity {
            for (y, line) in lines {
                let from = 3 * ((y - self.first) * self.size.0 + columns.start);
                for (pixel, code) in line.iter_mut().zip(self.codes[from..].chunks_exact(3)) {
                    *pixel = [code[0], code[1], code[2]].map(|c| c.into() * self.scale);
                }
            }
            return;
        }
        let h = warp.matrix(self.size.0, self.size.1);
        let kernel = &*LANCZOS3;
        for (y, line) in lines {
            vectorised(Line { source: self, kernel, h: &h, first: columns.start, y, line });
        }
    }

    /// The value at (u, v), which lies within the rectangle of pixel centres.
    #[inline(always)]
    fn at(&self, kernel: &Kernel, u: f64, v: f64) -> [f32; 3] {
        let (left, wx) = kernel.place(u);
        let (top, wy) = kernel.place(v);
        let (width, height) = self.size;
        let mut sum = [0.0f32; LANES];
        let inside = left >= 0 && top >= 0 && left as usize + TAPS + 2 <= width && top as usize + TAPS <= height;
        if inside {
            let first = 3 * ((top as usize - self.first) * width + left as usize);
            for (j, w) in wy.iter().enumerate() {
                let from = first + 3 * j * width;
                if let Some(row) = self.codes.get(from..from + LANES).and_then(|r| r.first_chunk::<LANES>()) {
                    for k in 0..LANES {
                        sum[k] += w * row[k].into();
                    }
                }
            }
        } else {
            // At the border the outermost pixel stands for those beyond it.
            let clamp = |i: isize, size: usize| i.clamp(0, size as isize - 1) as usize;
            for (j, w) in wy.iter().enumerate() {
                let y = clamp(top + j as isize, height) - self.first;
                for i in 0..TAPS {
                    let from = 3 * (y * width + clamp(left + i as isize, width));
                    for c in 0..3 {
                        sum[3 * i + c] += w * self.codes[from + c].into();
                    }
                }
            }
        }
        let mut value = [0.0f32; 3];
        for (w, column) in wx.iter().zip(sum.chunks_exact(3)) {
            for c in 0..3 {
                value[c] += w * column[c];
            }
        }
        value.map(|v| (v * self.scale).clamp(0.0, 255.0))
    }
}

/// One row of the reference, whose pixels `h` takes into the frame.
struct Line<'a, 'b, T> {
    source: &'a Source<'b, T>,
    kernel: &'a Kernel,
    h: &'a Matrix3<f64>,
    first: usize,
    y: usize,
    line: &'a mut [[f32; 3]],
}

impl<T: Copy + Into<f32>> Loops for Line<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let (width, height) = self.source.size;
        let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
        for (x, pixel) in (self.first..).zip(self.line) {
            let (u, v) = map(self.h, x as f64, self.y as f64);
            // Written so that a place that is no number is outside too.
            *pixel = if u >= 0.0 && v >= 0.0 && u <= right && v <= bottom {
                self.source.at(self.kernel, u, v)
            } else {
                [OUTSIDE; 3]
            };
        }
    }
}

/// The kernel's weights at each of its positions between two pixels.
struct Kernel {
    weights: Vec<[f32; TAPS]>,
}

static LANCZOS3: LazyLock<Kernel> = LazyLock::new(|| Kernel {
    weights: (0..=PHASES)
        .map(|phase| {
            let fraction = phase as f64 / PHASES as f64;
            let raw: [f64; TAPS] = std::array::from_fn(|i| lanczos3(i as f64 - BEFORE as f64 - fraction));
            let sum: f64 = raw.iter().sum();
            raw.map(|w| (w / sum) as f32)
        })
        .collect(),
});

impl Kernel {
    /// The first pixel under the kernel at place `u`, and the weights.
    #[inline(always)]
    fn place(&self, u: f64) -> (isize, &[f32; TAPS]) {
        // u is at least 0: the conversion cuts off as floor does.
        let whole = u as usize;
        let phase = ((u - whole as f64) * PHASES as f64 + 0.5) as usize;
        (whole as isize - BEFORE as isize, &self.weights[phase])
    }
}

/// sinc(x) sinc(x / 3) for |x| < 3, otherwise 0.
fn lanczos3(x: f64) -> f64 {
    if x == 0.0 {
        1.0
    } else if x.abs() >= 3.0 {
        0.0
    } else {
        let t = PI * x;
        3.0 * libm::sin(t) * libm::sin(t / 3.0) / (t * t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::exposure::Exposure;
    use crate::bracket::{Frame, Samples};

    fn frame(width: usize, height: usize, f: impl Fn(f64, f64) -> f64) -> Frame {
        let codes = (0..width * height)
            .flat_map(|i| {
                let v = f((i % width) as f64, (i / width) as f64);
                [v, v * 0.5, 255.0 - v].map(|v| (v * 257.0).round() as u16)
            })
            .collect();
        Frame::new("f".into(), width, height, Samples::Sixteen(codes), Exposure::given(0.0).unwrap())
    }

    fn whole(frame: &Frame, warp: &Warp) -> Vec<[f32; 3]> {
        let mut out = vec![[0.0; 3]; frame.width() * frame.height()];
        resample_rows(&frame.whole().unwrap(), warp, 0..frame.width(), 0..frame.height(), &mut out);
        out
    }

    /// The paper's double sum, pixel by pixel, without tables.
    fn textbook(frame: &Frame, u: f64, v: f64, channel: usize) -> f64 {
        let whole = frame.whole().unwrap();
        let Codes::Sixteen(codes) = whole.codes() else { unreachable!() };
        let (mut sum, mut weight) = (0.0, 0.0);
        for y in v.floor() as isize - 2..=v.floor() as isize + 3 {
            for x in u.floor() as isize - 2..=u.floor() as isize + 3 {
                let w = lanczos3(x as f64 - u) * lanczos3(y as f64 - v);
                let cx = x.clamp(0, frame.width() as isize - 1) as usize;
                let cy = y.clamp(0, frame.height() as isize - 1) as usize;
                sum += w * f64::from(codes[3 * (cy * frame.width() + cx) + channel]) / 257.0;
                weight += w;
            }
        }
        (sum / weight).clamp(0.0, 255.0)
    }

    #[test]
    fn agrees_with_the_textbook_sum() {
        let f = frame(40, 30, |x, y| 120.0 + 60.0 * (0.9 * x).sin() + 50.0 * (0.7 * y + 0.2 * x).cos());
        let warp = Warp::Rigid { dx: 1.37, dy: -0.61, angle: 0.03 };
        let h = warp.matrix(40, 30);
        for (i, pixel) in whole(&f, &warp).iter().enumerate() {
            let (u, v) = map(&h, (i % 40) as f64, (i / 40) as f64);
            if u < 0.0 || v < 0.0 || u > 39.0 || v > 29.0 {
                assert_eq!(*pixel, [OUTSIDE; 3]);
                continue;
            }
            for c in 0..3 {
                // The phase is rounded by at most 1/2048 px on each axis; the kernel's slope times the picture's is under 150 codes/px.
                assert!((f64::from(pixel[c]) - textbook(&f, u, v, c)).abs() < 2.0 * 150.0 / 2048.0);
            }
        }
    }

    #[test]
    fn whole_pixel_shifts_and_identity_are_exact() {
        let f = frame(20, 12, |x, y| (7.0 * x + 3.0 * y) % 256.0);
        let still = whole(&f, &Warp::Identity);
        let moved = whole(&f, &Warp::Rigid { dx: 2.0, dy: 1.0, angle: 0.0 });
        for y in 0..11 {
            for x in 0..18 {
                for c in 0..3 {
                    assert!((moved[y * 20 + x][c] - still[(y + 1) * 20 + x + 2][c]).abs() < 1e-4);
                }
            }
        }
        assert_eq!(moved[19], [OUTSIDE; 3]);
    }

    #[test]
    fn eight_and_sixteen_bit_frames_agree() {
        let eight: Vec<u8> = (0..3 * 16 * 16).map(|i| (i * 37 % 256) as u8).collect();
        let sixteen = eight.iter().map(|&c| u16::from(c) * 257).collect();
        let make = |s| Frame::new("f".into(), 16, 16, s, Exposure::given(0.0).unwrap());
        let warp = Warp::Rigid { dx: 0.4, dy: 0.3, angle: 0.01 };
        let (a, b) = (whole(&make(Samples::Eight(eight)), &warp), whole(&make(Samples::Sixteen(sixteen)), &warp));
        for (p, q) in a.iter().zip(&b) {
            for c in 0..3 {
                assert!((p[c] - q[c]).abs() < 1e-3);
            }
        }
    }

    /// A window of no more than the rows said to be read gives what the whole frame does: else the slices would be out of bounds.
    #[test]
    fn the_rows_under_a_strip_are_enough() {
        let f = frame(60, 90, |x, y| 100.0 + 90.0 * (0.31 * x * y).sin());
        let perspective = Matrix3::new(1.02, 0.03, -2.0, -0.04, 0.97, 3.0, 2e-4, -3e-4, 1.0);
        let warps = [
            Warp::Identity,
            Warp::Rigid { dx: 3.3, dy: -7.8, angle: 0.2 },
            Warp::Rigid { dx: 0.0, dy: 80.0, angle: -0.1 },
            Warp::Homography(perspective),
        ];
        for warp in warps {
            let all = whole(&f, &warp);
            for rows in [0..1, 5..21, 40..90] {
                let under = rows_under(&warp, (60, 90), &(4..57), &rows);
                assert!(warp != Warp::Identity || under == rows);
                let mut part = vec![[0.0; 3]; 53 * rows.len()];
                resample_rows(&f.window(under).unwrap(), &warp, 4..57, rows.clone(), &mut part);
                for (line, y) in part.chunks_exact(53).zip(rows) {
                    assert_eq!(line, &all[60 * y + 4..60 * y + 57]);
                }
            }
        }
        let horizon = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.1, 0.0, -2.0);
        assert_eq!(rows_under(&Warp::Homography(horizon), (60, 90), &(0..60), &(3..4)), 0..90);
    }
}
