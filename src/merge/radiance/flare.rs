//! Flare (veiling glare): estimates and subtracts the light that lens and sensor scatter over the picture.
//!
//! In: radiance. Out: radiance without flare, and a [`FlareReport`]. Cost: two passes over the picture, and 11 Fourier
//! transforms of 512 x 512, or 15 if flare is found: some 0.3 s of one core. Source: Ward's hdrgen (option `-f`;
//! Reinhard et al., "High Dynamic Range Imaging", 2nd ed. 2010, chapter 4) derives an upper bound of the point spread
//! from the darkness around bright parts, and subtracts at most 98 % of a pixel. Here the bound is computed for the
//! whole picture at once, and used only if the picture shows flare.
//!
//! Flare is the picture convolved with a point spread that falls off with the distance r as 1 / r^k, from 2 cells on; a
//! cell is 1/256 of the longer side. Light that is scattered less far is not estimated.
//!
//! Let s be the share of light that is scattered. No place is darker than the flare there. So s is at most (luminance
//! of the dark parts of a cell) / (flare in this cell for s = 1) in every cell, and at most the minimum of these
//! quotients. A scene without black parts and without flare has such a minimum too, but its dark parts are not brighter
//! in cells with stronger flare. Therefore the cells are sorted into 24 bins by the strength of flare. Flare is found
//! if the darkest cells of at least 6 bins give nearly the same share, these bins span at least a stop, and the share
//! is typical of lenses. Among the exponents that are tried, k is the one with the most such bins.

use crate::merge::radiance::statistics::{BT709, luminance};
use crate::merge::{FLOOR, RadianceMap};
use crate::plane::Plane;
use crate::pyramid::cells::between_cells;
use crate::statistics::of_rank;
use serde::Serialize;
use std::f64::consts::PI;

/// Largest number of cells along the longer side.
const CELLS: usize = 256;
/// Size of the Fourier transforms: twice the cells, so that the convolution does not wrap around.
const SIZE: usize = 2 * CELLS;
/// Smallest distance from a light at which the point spread function is evaluated, in cells.
const NEAREST: f64 = 2.0;
/// Exponents k that are tried.
const EXPONENTS: [f64; 4] = [1.5, 2.0, 2.5, 3.0];
/// Number of bins into which cells are sorted by the strength of the flare.
const BINS: usize = 24;
/// Fractions of the darkest values that are ignored as outliers: the first number is for the cells of a bin, the second
/// for the pixels of a cell.
const DARKER: (f64, f64) = (0.005, 0.05);
/// A bin supports flare if its share of scattered light is within this factor of the minimum over all bins.
const NEAR: f64 = 1.35;
/// Smallest number of supporting bins.
const FEWEST_BINS: usize = 6;
/// Smallest range of flare strengths that the supporting bins must span, in stops.
const RANGE: f64 = 1.0;
/// Range of the shares of scattered light that are subtracted. ISO 9358 gives 0.5 to 5 % for lenses; more is haze or
/// bright shadows.
const SHARES: std::ops::Range<f64> = 0.002..0.1;
/// Smallest ratio of the brightest to the darkest cell at which flare is visible (Ward's bound).
const BRIGHT: f32 = 500.0;
/// Largest fraction of a pixel's radiance that is subtracted.
const MOST: f32 = 0.98;

/// The section of the report on flare.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct FlareReport {
    /// The share of scattered light, which was subtracted; 0 if no flare was found.
    pub scattered_fraction: f64,
    /// The exponent k of the fall-off 1 / r^k; `None` if no flare was found.
    pub falloff_exponent: Option<f64>,
}

/// Subtracts flare from `map`, if any is found. Every value stays positive.
pub fn remove(map: &mut RadianceMap) -> FlareReport {
    let mut cells = Cells::new(map.pixels.width(), map.pixels.height());
    cells.see(&map.pixels);
    let Some(flare) = cells.flare() else { return FlareReport::default() };
    flare.subtract(0, &mut map.pixels);
    flare.report()
}

/// Statistics of a picture, read from top to bottom: for each cell the mean, and the luminance of its dark pixels.
#[derive(Debug, Clone)]
pub struct Cells {
    /// Side of a cell, in pixels.
    side: usize,
    columns: usize,
    means: Vec<[f32; 3]>,
    dark: Vec<f32>,
}

impl Cells {
    /// Creates the statistics of a picture of `width` x `height` pixels, of which nothing is read yet.
    pub fn new(width: usize, height: usize) -> Self {
        let side = width.max(height).div_ceil(CELLS).max(1);
        Cells { side, columns: width.div_ceil(side), means: Vec::new(), dark: Vec::new() }
    }

    /// Returns the side of a cell in pixels. [`see`](Self::see) takes a multiple of this number of rows.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Reads the next rows: a multiple of [`side`](Self::side), or all that remain.
    pub fn see(&mut self, pixels: &Plane<[f32; 3]>) {
        let side = self.side;
        let both = Plane::from_rows(self.columns, pixels.height().div_ceil(side), |j, row: &mut [([f32; 3], f32)]| {
            for (i, cell) in row.iter_mut().enumerate() {
                let (mut sum, mut all) = ([0.0f32; 3], Vec::with_capacity(side * side));
                for y in side * j..(side * (j + 1)).min(pixels.height()) {
                    for pixel in &pixels.row(y)[side * i..(side * (i + 1)).min(pixels.width())] {
                        sum = std::array::from_fn(|c| sum[c] + pixel[c]);
                        all.push(luminance(*pixel, BT709));
                    }
                }
                let rank = (DARKER.1 * (all.len() - 1) as f64) as usize;
                let dark = *all.select_nth_unstable_by(rank, f32::total_cmp).1;
                *cell = (sum.map(|s| s / all.len() as f32), dark);
            }
        });
        for (mean, dark) in both.into_vec() {
            self.means.push(mean);
            self.dark.push(dark);
        }
    }

    /// Returns the flare of the picture, or `None` if none is found.
    pub fn flare(self) -> Option<Flare> {
        let size = (self.columns, self.means.len() / self.columns.max(1));
        let brightest = self.means.iter().map(|&mean| luminance(mean, BT709)).fold(0.0, f32::max);
        let darkest = self.dark.iter().fold(f32::MAX, |least, &d| least.min(d));
        if brightest < BRIGHT * darkest {
            return None;
        }
        let means = Plane::from_vec(size.0, size.1, self.means);
        let dark = Plane::from_vec(size.0, size.1, self.dark);
        let channels: [Spectrum; 3] = std::array::from_fn(|c| {
            Spectrum::of(|x, y| if x < size.0 && y < size.1 { f64::from(means.at(x, y)[c]) } else { 0.0 })
        });
        let grey = channels[0].scaled(0.2126).plus(&channels[1].scaled(0.7152)).plus(&channels[2].scaled(0.0722));
        let mut best: Option<(Support, f64)> = None;
        for exponent in EXPONENTS {
            let found = support(&dark, &grey.times(&spread(exponent)).values(size));
            // If two exponents have equal support, the smaller one is kept, which comes first: its flare reaches
            // farther.
            if best.as_ref().is_none_or(|(b, _)| (found.bins, found.stops) > (b.bins, b.stops)) {
                best = Some((found, exponent));
            }
        }
        let (found, exponent) = best.filter(|(found, _)| found.is_flare())?;
        let spread = spread(exponent);
        let channels = channels.map(|channel| channel.times(&spread).values(size));
        Some(Flare { side: self.side, share: found.share, exponent, channels })
    }
}

/// Flare that was found.
#[derive(Debug, Clone)]
pub struct Flare {
    side: usize,
    /// The share of scattered light.
    share: f64,
    exponent: f64,
    /// The flare of R, G and B in each cell, for a share of 1.
    channels: [Plane<f64>; 3],
}

impl Flare {
    /// Subtracts the flare from `pixels`, which start at row `first` of the picture.
    pub fn subtract(&self, first: usize, pixels: &mut Plane<[f32; 3]>) {
        let size = (self.channels[0].width(), self.channels[0].height());
        pixels.fill_rows(|y, row| {
            let (above, below, fy) = between_cells(first + y, self.side, size.1);
            for (x, pixel) in row.iter_mut().enumerate() {
                let (left, right, fx) = between_cells(x, self.side, size.0);
                for c in 0..3 {
                    let along = |row: usize| {
                        let (a, b) = (self.channels[c].at(left, row), self.channels[c].at(right, row));
                        a + fx * (b - a)
                    };
                    let flare = self.share * (along(above) + fy * (along(below) - along(above)));
                    pixel[c] = (pixel[c] - flare as f32).max((1.0 - MOST) * pixel[c]).max(FLOOR);
                }
            }
        });
    }

    /// Returns the section of the report.
    pub fn report(&self) -> FlareReport {
        FlareReport { scattered_fraction: self.share, falloff_exponent: Some(self.exponent) }
    }
}

/// Evidence for flare with one exponent.
struct Support {
    /// Upper bound of the share of scattered light.
    share: f64,
    /// The number of bins whose share is close to that bound.
    bins: usize,
    /// The range of flare strengths of these bins, in stops.
    stops: f64,
}

impl Support {
    fn is_flare(&self) -> bool {
        self.bins >= FEWEST_BINS && self.stops >= RANGE && SHARES.contains(&self.share)
    }
}

/// Compares the `dark` parts of the cells with the flare for a share of 1.
fn support(dark: &Plane<f32>, flare: &Plane<f64>) -> Support {
    // Where the flare is 0, the transforms leave rounding errors of some 1e-16 of the largest value. `least` is far
    // above them.
    let least = flare.as_slice().iter().fold(0.0, |a: f64, &b| a.max(b)) * 1e-9;
    let mut cells: Vec<(f64, f64)> =
        flare.as_slice().iter().zip(dark.as_slice()).map(|(&v, &d)| (v.max(least), f64::from(d))).collect();
    cells.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let n = cells.len();
    let bins: Vec<(f64, f64)> = (0..BINS)
        .map(|b| &cells[b * n / BINS..(b + 1) * n / BINS])
        .filter_map(|bin| {
            let shares = bin.iter().map(|(flare, dark)| dark / flare);
            Some((bin.get(bin.len() / 2)?.0, of_rank(shares, (DARKER.0 * bin.len() as f64) as usize)?))
        })
        .collect();
    let share = bins.iter().map(|bin| bin.1).fold(f64::INFINITY, f64::min);
    let near: Vec<f64> = bins.iter().filter(|bin| bin.1 <= NEAR * share).map(|bin| bin.0).collect();
    let stops = near.first().zip(near.last()).map_or(0.0, |(a, b)| libm::log2(b / a));
    Support { share, bins: near.len(), stops }
}

/// Returns the transform of the point spread that falls off as 1 / r^`exponent` around the top left value, with sum 1.
fn spread(exponent: f64) -> Spectrum {
    let away = |i: usize| i.min(SIZE - i) as f64;
    let at = |x: usize, y: usize| {
        let r2 = away(x) * away(x) + away(y) * away(y);
        let reached = r2 >= NEAREST * NEAREST && away(x) < CELLS as f64 && away(y) < CELLS as f64;
        if reached { libm::pow(r2, -0.5 * exponent) } else { 0.0 }
    };
    let sum: f64 = (0..SIZE).map(|y| (0..SIZE).map(|x| at(x, y)).sum::<f64>()).sum();
    Spectrum::of(|x, y| at(x, y) / sum)
}

type Complex = (f64, f64);

/// The Fourier transform of a picture of [`SIZE`] x [`SIZE`] real values.
#[derive(Clone)]
struct Spectrum(Plane<Complex>);

impl Spectrum {
    fn of(value: impl Fn(usize, usize) -> f64 + Sync) -> Self {
        let picture = Plane::from_rows(SIZE, SIZE, |y, row: &mut [Complex]| {
            row.iter_mut().enumerate().for_each(|(x, v)| *v = (value(x, y), 0.0));
        });
        Spectrum(transformed(transformed(picture, 1.0), 1.0))
    }

    fn scaled(&self, weight: f64) -> Self {
        self.with(self, |a, _| (weight * a.0, weight * a.1))
    }

    fn plus(&self, other: &Self) -> Self {
        self.with(other, |a, b| (a.0 + b.0, a.1 + b.1))
    }

    /// Returns the transform of the convolution of both pictures.
    fn times(&self, other: &Self) -> Self {
        self.with(other, |a, b| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0))
    }

    fn with(&self, other: &Self, op: impl Fn(Complex, Complex) -> Complex) -> Self {
        let both = self.0.as_slice().iter().zip(other.0.as_slice());
        Spectrum(Plane::from_vec(SIZE, SIZE, both.map(|(&a, &b)| op(a, b)).collect()))
    }

    /// Returns the top left part of the picture.
    fn values(self, (width, height): (usize, usize)) -> Plane<f64> {
        let picture = transformed(transformed(self.0, -1.0), -1.0);
        let scale = 1.0 / (SIZE * SIZE) as f64;
        Plane::from_rows(width, height, |y, row| {
            row.iter_mut().zip(picture.row(y)).for_each(|(v, c)| *v = c.0 * scale);
        })
    }
}

/// Transforms each row of `plane`, and returns the result transposed.
fn transformed(mut plane: Plane<Complex>, sign: f64) -> Plane<Complex> {
    let roots: Vec<Complex> = (0..SIZE / 2)
        .map(|k| {
            let angle = -sign * 2.0 * PI * k as f64 / SIZE as f64;
            (libm::cos(angle), libm::sin(angle))
        })
        .collect();
    plane.fill_rows(|_, row| transform(row, &roots));
    Plane::from_rows(SIZE, SIZE, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, v)| *v = plane.at(y, x));
    })
}

/// Transforms `values` in place (Cooley & Tukey 1965, radix 2); `roots` are the powers of the primitive root of the
/// length.
fn transform(values: &mut [Complex], roots: &[Complex]) {
    let n = values.len();
    let bits = n.trailing_zeros();
    for i in 0..n {
        let j = i.reverse_bits() >> (usize::BITS - bits);
        if i < j {
            values.swap(i, j);
        }
    }
    let mut half = 1;
    while half < n {
        for block in values.chunks_exact_mut(2 * half) {
            let (even, odd) = block.split_at_mut(half);
            for (k, (a, b)) in even.iter_mut().zip(odd).enumerate() {
                let w = roots[k * (n / (2 * half))];
                let t = (b.0 * w.0 - b.1 * w.1, b.0 * w.1 + b.1 * w.0);
                *b = (a.0 - t.0, a.1 - t.1);
                *a = (a.0 + t.0, a.1 + t.1);
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;

    /// Returns a dark scene with bright windows, and black objects everywhere.
    fn scene(width: usize, height: usize) -> RadianceMap {
        let pixels = Plane::from_rows(width, height, |y, row: &mut [[f32; 3]]| {
            for (x, v) in row.iter_mut().enumerate() {
                let (bright, black) = (x * 4 / width == 2 && y * 3 / height == 1, (x / 5 + y / 7) % 6 == 0);
                let e = if bright {
                    40.0
                } else if black {
                    0.0005
                } else {
                    0.3 + 0.2 * ((x / 11 + y / 13) % 5) as f32
                };
                *v = [e, 0.9 * e, 0.8 * e];
            }
        });
        RadianceMap { pixels, primaries: Primaries::SRGB }
    }

    /// Returns the flare of `map` for a share of 1, by a double sum.
    fn flare(map: &Plane<[f32; 3]>, exponent: f64) -> Plane<[f64; 3]> {
        let of = |dx: i64, dy: i64| match (dx * dx + dy * dy) as f64 {
            r2 if r2 >= 4.0 => r2.powf(-0.5 * exponent),
            _ => 0.0,
        };
        let most = CELLS as i64 - 1;
        let sum: f64 = (-most..=most).map(|y| (-most..=most).map(|x| of(x, y)).sum::<f64>()).sum();
        Plane::from_rows(map.width(), map.height(), |y, row: &mut [[f64; 3]]| {
            for (x, v) in row.iter_mut().enumerate() {
                for j in 0..map.height() {
                    for (i, p) in map.row(j).iter().enumerate() {
                        let w = of(x as i64 - i as i64, y as i64 - j as i64) / sum;
                        *v = std::array::from_fn(|c| v[c] + w * f64::from(p[c]));
                    }
                }
            }
        })
    }

    #[test]
    fn the_convolution_is_the_double_sum() {
        let map = scene(60, 41);
        let slow = flare(&map.pixels, 2.5);
        let spectrum = Spectrum::of(|x, y| if x < 60 && y < 41 { f64::from(map.pixels.at(x, y)[1]) } else { 0.0 });
        let fast = spectrum.times(&spread(2.5)).values((60, 41));
        let most = slow.as_slice().iter().fold(0.0, |a: f64, v| a.max(v[1]));
        for (a, b) in fast.as_slice().iter().zip(slow.as_slice()) {
            // The transforms round 36 times: in 9 steps for each of 2 axes, forward and back. They round sums that are
            // smaller than the sum of all values, so a tolerance of 1e-10 of the largest value is far above the
            // rounding errors of `f64`.
            assert!((a - b[1]).abs() < 1e-10 * most, "{a} for {}", b[1]);
        }
    }

    #[test]
    fn flare_is_found_and_taken_off() {
        let truth = scene(120, 90);
        for exponent in [2.0, 2.5] {
            let flare = flare(&truth.pixels, exponent);
            let mut seen = truth.clone();
            for (v, add) in seen.pixels.as_mut_slice().iter_mut().zip(flare.as_slice()) {
                *v = std::array::from_fn(|c| (0.97 * f64::from(v[c]) + 0.03 * add[c]) as f32);
            }
            let veiled = seen.clone();
            let report = remove(&mut seen);
            assert!((0.02..=0.033).contains(&report.scattered_fraction), "{exponent}: {report:?}");
            let error = |map: &RadianceMap| {
                let pairs = map.pixels.as_slice().iter().zip(truth.pixels.as_slice()).filter(|(_, t)| t[1] < 0.01);
                pairs.map(|(a, t)| f64::from(a[1] - t[1]).abs()).sum::<f64>()
            };
            assert!(error(&seen) < 0.25 * error(&veiled), "{exponent}: {} of {}", error(&seen), error(&veiled));
            assert!(seen.pixels.as_slice().iter().flatten().all(|&v| v > 0.0));
        }
    }

    #[test]
    fn scene_without_flare_is_unchanged() {
        let flat = RadianceMap { pixels: Plane::filled(70, 50, [0.4; 3]), primaries: Primaries::SRGB };
        // Black objects are only far from the window, so too few bins support flare.
        let mut grey = scene(120, 90);
        for (i, v) in grey.pixels.as_mut_slice().iter_mut().enumerate() {
            *v = v.map(|e| if i % 120 < 12 { e } else { e.max(0.25) });
        }
        for mut map in [scene(120, 90), grey, flat, scene(1, 1), scene(3, 2)] {
            let before = map.clone();
            let report = remove(&mut map);
            assert_eq!((report, &map), (FlareReport::default(), &before));
        }
    }
}
