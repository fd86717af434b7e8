//! Expansion: what a phone compressed is taken back, where it is larger than a neighbourhood.
//!
//! In: the merged radiance of locally processed frames, and by how much to expand it. Out: radiance whose large differences are those of the scene. Cost: two
//! passes over the picture, a logarithm a pixel each, and an exponential.
//! Source: base and detail as in Durand & Dorsey 2002; the base is that of the guided filter (He, Sun & Tang 2013) of the logarithm of luminance by itself, whose
//! coefficients are found on cells and interpolated (the fast guided filter, He & Sun 2015).
//!
//! A local tone mapping divides the logarithm of luminance into a base, whose differences are compressed, and details, which are kept. An edge of some
//! stops is part of the base: else there were halos.

use super::LUMINANCE;
use crate::merge::FLOOR;
use crate::merge::statistics::luminance;
use crate::plane::Plane;
use crate::pyramid::cells::{gathered, row_between_cells};
use rayon::prelude::*;

/// Cells along the longer side, at most.
const CELLS: usize = 256;
/// The filter's radius as a share of the longer side: a neighbourhood of a twelfth.
const RADIUS: usize = 24;
/// The variance from which on half of the differences belong to the base, in square stops: an edge of 2.8 stops. On truth brackets of phones, 1 has a
/// PU21-PSNR of details lower by 0.6 dB, and 0.5 by 2.5.
const EDGE: f64 = 2.0;

/// Of a cell: the sums of the logarithm of luminance, in stops, and of its square, and pixels.
type Moments = [f64; 3];

/// The sums over the cells of a picture, which come from top to bottom.
#[derive(Debug, Clone)]
pub struct Sums {
    size: (usize, usize),
    side: usize,
    sums: Plane<Moments>,
}

/// What radiance is multiplied by.
#[derive(Debug, Clone)]
pub struct Expansion {
    side: usize,
    /// By cells: base = a times logarithm + b.
    coefficients: Plane<[f32; 2]>,
    /// Stops that are added for each stop of the base.
    more: f32,
}

/// The logarithm of a pixel's luminance, in stops.
fn stops(pixel: &[f32; 3]) -> f32 {
    libm::log2f(luminance(*pixel, LUMINANCE).max(FLOOR))
}

impl Sums {
    /// Nothing yet, of a picture of `size` pixels.
    pub fn new(size: (usize, usize)) -> Self {
        let longer = size.0.max(size.1);
        let side = std::iter::successors(Some(1), |side| Some(2 * side)).find(|side| longer.div_ceil(*side) <= CELLS);
        let side = side.unwrap_or(1);
        Sums { size, side, sums: Plane::filled(size.0.div_ceil(side), size.1.div_ceil(side), [0.0; 3]) }
    }

    /// Adds the next rows, of which the first is row `first` of the picture.
    pub fn add(&mut self, first: usize, pixels: &Plane<[f32; 3]>) {
        let (side, columns) = (self.side, self.sums.width());
        let last = first + pixels.height();
        let cells = self.sums.as_mut_slice().par_chunks_mut(columns).enumerate();
        // Each row of cells by itself, pixel after pixel: the sums do not depend on where a slab ends.
        cells.filter(|(j, _)| j * side < last && (j + 1) * side > first).for_each(|(j, cells)| {
            for y in (j * side).max(first)..((j + 1) * side).min(last) {
                for (cell, pixels) in cells.iter_mut().zip(pixels.row(y - first).chunks(side)) {
                    for pixel in pixels {
                        let v = f64::from(stops(pixel));
                        *cell = [cell[0] + v, cell[1] + v * v, cell[2] + 1.0];
                    }
                }
            }
        });
    }

    /// The expansion by `factor` stops for each stop of the base.
    pub fn expansion(&self, factor: f64) -> Expansion {
        let radius = (self.size.0.max(self.size.1) as f64 / (RADIUS * self.side) as f64).round().max(1.0) as usize;
        let moments = gathered(&self.sums, radius, add);
        let coefficients = Plane::from_rows(moments.width(), moments.height(), |y, row: &mut [Moments]| {
            for (out, [sum, square, count]) in row.iter_mut().zip(moments.row(y)) {
                let mean = sum / count;
                let variance = (square / count - mean * mean).max(0.0);
                let a = variance / (variance + EDGE);
                *out = [a, mean - a * mean, 1.0];
            }
        });
        let means = gathered(&coefficients, radius, add);
        let coefficients = Plane::from_rows(means.width(), means.height(), |y, row: &mut [[f32; 2]]| {
            for (out, [a, b, count]) in row.iter_mut().zip(means.row(y)) {
                *out = [(a / count) as f32, (b / count) as f32];
            }
        });
        Expansion { side: self.side, coefficients, more: (factor - 1.0) as f32 }
    }
}

/// Adds the moments of another cell.
fn add(a: &mut Moments, b: &Moments) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
}

impl Expansion {
    /// Expands rows, of which the first is row `first` of the picture. The base of radiance 1 stays.
    pub fn expand(&self, first: usize, pixels: &mut Plane<[f32; 3]>) {
        pixels.fill_rows(|y, row| {
            let mut coefficients = vec![[0.0f32; 2]; row.len()];
            row_between_cells(&self.coefficients, self.side, |v| v, first + y, &mut coefficients);
            for (pixel, [a, b]) in row.iter_mut().zip(coefficients) {
                let factor = libm::exp2f(self.more * (a * stops(pixel) + b));
                pixel.iter_mut().for_each(|v| *v = (*v * factor).max(FLOOR));
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sums(pixels: &Plane<[f32; 3]>) -> Sums {
        let mut sums = Sums::new((pixels.width(), pixels.height()));
        sums.add(0, pixels);
        sums
    }

    /// A step of `stops` in the middle, and a texture of a tenth of a stop to either side.
    fn step(stops: f32) -> Plane<[f32; 3]> {
        Plane::from_rows(700, 300, |y, row: &mut [[f32; 3]]| {
            for (x, v) in row.iter_mut().enumerate() {
                let texture = if (x + y) % 2 == 0 { 0.1 } else { -0.1 };
                *v = [libm::exp2f(texture + if x < 350 { -0.5 * stops } else { 0.5 * stops }); 3];
            }
        })
    }

    #[test]
    fn expansion_doubles_what_is_large_and_keeps_what_is_small() {
        let mut pixels = step(4.0);
        sums(&pixels).expansion(2.0).expand(0, &mut pixels);
        let stops = |x: usize, y: usize| libm::log2f(pixels.at(x, y)[1]);
        // Far from the edge the base is the mean: -2 becomes -4, and the texture stays.
        assert!((stops(40, 100) + 3.9).abs() < 0.02 && (stops(41, 100) + 4.1).abs() < 0.02, "{}", stops(40, 100));
        // At the edge of 4 stops the variance is 4: two thirds of it belong to the base, of which the filter's window has most.
        assert!((stops(351, 101) - stops(349, 101)) > 6.0, "{}", stops(351, 101) - stops(349, 101));
    }

    #[test]
    fn expansion_by_one_is_none_and_colours_stay() {
        let before = step(2.0);
        let mut pixels = before.clone();
        sums(&before).expansion(1.0).expand(0, &mut pixels);
        assert_eq!(pixels, before);
        let mut tinted = Plane::filled(90, 60, [0.5f32, 0.25, 0.125]);
        sums(&tinted).expansion(2.0).expand(0, &mut tinted);
        let [r, g, b] = tinted.at(9, 9);
        assert!((r / g - 2.0).abs() < 1e-5 && (g / b - 2.0).abs() < 1e-5 && r < 0.5, "{r} {g} {b}");
    }

    #[test]
    fn sums_do_not_depend_on_where_slabs_end() {
        let pixels = step(3.0);
        let whole = sums(&pixels);
        let mut parts = Sums::new((700, 300));
        for (first, last) in [(0, 65), (65, 190), (190, 300)] {
            parts.add(first, &Plane::from_vec(700, last - first, pixels.rows(first..last).to_vec()));
        }
        assert_eq!(parts.sums, whole.sums);
    }
}
