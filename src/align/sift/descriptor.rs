//! The surroundings of a keypoint in 4 x 4 histograms of 8 directions (Lowe 2004, section 6.1).

use super::extrema::Extremum;
use super::gradient::{exp_minus, exp_table, gradient};
use crate::align::features::Descriptor;
use crate::plane::Plane;
use std::f32::consts::PI;

/// Histograms along each side.
const CELLS: usize = 4;
/// Directions in each.
const BINS: usize = 8;
/// Width of a cell, in units of the keypoint's scale.
const CELL: f64 = 3.0;
/// No entry of the normalised descriptor exceeds this: large gradients may be a matter of light.
const CLAMP: f32 = 0.2;
/// Length of the descriptor as stored.
const LENGTH: f32 = 512.0;

/// The descriptor of `extremum` seen along `angle`.
pub(super) fn describe(level: &Plane<f32>, extremum: &Extremum, angle: f32) -> Descriptor {
    let cell = CELL * extremum.sigma;
    let (sin, cos) = ((libm::sin(angle.into()) / cell) as f32, (libm::cos(angle.into()) / cell) as f32);
    // The outermost cells are filled by samples up to half a cell beyond them, at the corners sqrt(2) times as far.
    let reach = libm::ceil(cell * std::f64::consts::SQRT_2 * (CELLS as f64 + 1.0) * 0.5) as isize;
    let (cx, cy) = ((extremum.x + 0.5).floor() as isize, (extremum.y + 0.5).floor() as isize);
    let table = exp_table();
    let half = CELLS as f32 / 2.0;
    // One cell more on each side and one direction more, so that the spreading below needs no test.
    let mut histogram = [[[0.0f32; BINS + 1]; CELLS + 2]; CELLS + 2];
    for y in (cy - reach).max(1)..=(cy + reach).min(level.height() as isize - 2) {
        for x in (cx - reach).max(1)..=(cx + reach).min(level.width() as isize - 2) {
            let (dx, dy) = ((x as f64 - extremum.x) as f32, (y as f64 - extremum.y) as f32);
            // In cells along the keypoint's direction and across it.
            let (along, across) = (cos * dx + sin * dy, cos * dy - sin * dx);
            let (column, row) = (along + half - 0.5, across + half - 0.5);
            if column <= -1.0 || row <= -1.0 || column >= CELLS as f32 || row >= CELLS as f32 {
                continue;
            }
            let (length, direction) = gradient(level, x as usize, y as usize);
            // The window's Gaussian has half the descriptor's width: 2 cells.
            let weighted = length * exp_minus(table, (along * along + across * across) * (0.5 / (half * half)));
            let turn = (direction - angle) * (BINS as f32 / (2.0 * PI)) + 2.0 * BINS as f32;
            let (c, r, o) = (column.floor(), row.floor(), turn.floor());
            let (fc, fr, fo) = (column - c, row - r, turn - o);
            let (c, r, o) = ((c + 1.0) as usize, (r + 1.0) as usize, o as usize % BINS);
            for (i, wr) in [(0, 1.0 - fr), (1, fr)] {
                for (j, wc) in [(0, 1.0 - fc), (1, fc)] {
                    let w = weighted * wr * wc;
                    let bins = &mut histogram[r + i][c + j];
                    bins[o] += w * (1.0 - fo);
                    bins[o + 1] += w * fo;
                }
            }
        }
    }
    let mut vector = [0.0f32; CELLS * CELLS * BINS];
    for (i, v) in vector.iter_mut().enumerate() {
        let bins = &histogram[1 + i / (CELLS * BINS)][1 + i / BINS % CELLS];
        *v = bins[i % BINS] + if i % BINS == 0 { bins[BINS] } else { 0.0 };
    }
    normalise(&mut vector);
    vector.iter_mut().for_each(|v| *v = v.min(CLAMP));
    normalise(&mut vector);
    vector.map(|v| (v * LENGTH + 0.5) as u8)
}

fn normalise(vector: &mut [f32]) {
    let length = vector.iter().map(|v| v * v).sum::<f32>().sqrt();
    if length > 0.0 {
        vector.iter_mut().for_each(|v| *v /= length);
    }
}
