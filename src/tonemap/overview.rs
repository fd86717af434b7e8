//! Overview of a scene: the statistics that an operator needs before it can map the first row.
//!
//! In: radiance rows, from top to bottom, in portions of any height. Out: a [`Scene`]: mean luminance and colour on a
//! grid of square cells, and a sample of the luminances. Cost: 4 ns of core time per pixel. Memory: at most
//! [`MOST_CELLS`] cells, however large the picture is.

use super::display::{LUMINANCE, ToSrgb, luminance};
use crate::bracket::colour::Primaries;
use crate::merge::Photographed;
use crate::plane::Plane;
use crate::simd::{Loops, at_least, at_most, log2, vectorised};
use rayon::prelude::*;

/// Largest number of cells. Pictures with fewer pixels have one cell per pixel. Operators may use coarser grids.
pub const MOST_CELLS: usize = 1 << 20;

/// Approximate largest number of sampled luminances. It is enough for percentiles that are exact to a tenth of a
/// percent.
const SAMPLES: usize = 1 << 18;

/// Collects the overview of a scene while its rows arrive.
#[derive(Debug, Clone)]
pub struct Overview {
    to_srgb: ToSrgb,
    size: (usize, usize),
    side: usize,
    /// For every cell: the sum of log2 luminance, the sums of red and of blue divided by luminance, and the number of
    /// lit pixels.
    cells: Plane<[f32; 4]>,
    step: usize,
    /// log2 luminance of every `step`-th pixel of every `step`-th row.
    sample: Vec<f32>,
    photographed: Option<Photographed>,
}

impl Overview {
    /// Starts the overview of a picture of `width` x `height` pixels.
    pub fn new((width, height): (usize, usize), primaries: &Primaries) -> Self {
        let (mut side, mut step) = (1, 1);
        while width.div_ceil(side) * height.div_ceil(side) > MOST_CELLS {
            side += 1;
        }
        while (width / step) * (height / step) > SAMPLES {
            step += 1;
        }
        Overview {
            to_srgb: ToSrgb::from(primaries),
            size: (width, height),
            side,
            cells: Plane::filled(width.div_ceil(side), height.div_ceil(side), [0.0; 4]),
            step,
            sample: Vec::new(),
            photographed: None,
        }
    }

    /// Adds the description of the photographs.
    pub fn photographed(self, photographed: Option<Photographed>) -> Self {
        Overview { photographed, ..self }
    }

    /// Sets the conversion of colours so that light of the chromaticity `light` becomes white. `light` is a CIE xy in
    /// colours that were adapted from the white of `primaries`, the primaries of the radiance, to D65.
    pub fn balanced(self, primaries: &Primaries, light: [f64; 2]) -> Self {
        Overview { to_srgb: ToSrgb::balanced(primaries, light), ..self }
    }

    /// Adds the rows `pixels`, the first of which is row `first` of the picture. The result does not depend on how many
    /// rows each call adds, because each cell sums its pixels in order.
    pub fn see(&mut self, first: usize, pixels: &Plane<[f32; 3]>) {
        let (side, step, to_srgb) = (self.side, self.step, self.to_srgb);
        let (width, end) = (pixels.width(), first + pixels.height());
        if width == 0 || first == end {
            return;
        }
        let columns = self.cells.width();
        let rows = self.cells.as_mut_slice()[first / side * columns..].par_chunks_mut(columns).enumerate();
        let samples: Vec<Vec<f32>> = rows
            .take(end.div_ceil(side) - first / side)
            .with_min_len(8)
            .map_init(
                || (vec![0.0f32; width], vec![[0.0f32; 2]; width]),
                |(logs, ratios), (i, cells)| {
                    let mut sample = Vec::new();
                    let top = (first / side + i) * side;
                    for y in top.max(first)..(top + side).min(end) {
                        vectorised(Logs { to_srgb: &to_srgb, row: pixels.row(y - first), logs, ratios });
                        let seen = logs.chunks(side).zip(ratios.chunks(side));
                        for (cell, (logs, ratios)) in cells.iter_mut().zip(seen) {
                            for (&log, [red, blue]) in logs.iter().zip(ratios) {
                                let is_lit = log > UNLIT;
                                cell[0] += if is_lit { log } else { 0.0 };
                                cell[1] += red;
                                cell[2] += blue;
                                cell[3] += if is_lit { 1.0 } else { 0.0 };
                            }
                        }
                        if y.is_multiple_of(step) {
                            sample.extend(logs.iter().step_by(step).filter(|log| **log > UNLIT));
                        }
                    }
                    sample
                },
            )
            .collect();
        self.sample.extend(samples.iter().flatten());
    }

    /// Returns the finished overview, after every row was added; `None` when no pixel has light.
    pub fn scene(self) -> Option<Scene> {
        let Overview { to_srgb, size, side, cells, mut sample, photographed, .. } = self;
        let (width, height) = (cells.width(), cells.height());
        let cells = cells.into_vec();
        let lit = || cells.iter().filter(|c| c[3] > 0.0).map(|c| c[0] / c[3]);
        if sample.is_empty() {
            // Few pixels are lit, and none of them was sampled.
            sample.extend(lit());
        }
        let darkest = lit().min_by(f32::total_cmp)?;
        sample.sort_unstable_by(f32::total_cmp);
        let means = |c: &[f32; 4]| match c[3] > 0.0 {
            true => (c[0] / c[3], [c[1] / c[3], c[2] / c[3]]),
            false => (darkest, [1.0; 2]),
        };
        let (logs, colours) = cells.iter().map(means).unzip();
        let (logs, colours) = (Plane::from_vec(width, height, logs), Plane::from_vec(width, height, colours));
        Some(Scene { to_srgb, size, side, logs, colours, sample, photographed })
    }
}

/// Largest range, in stops, of a scene that counts as uniform. Noise and rounding have a smaller range. The falloff of
/// light towards the corners of a picture (vignetting) has a larger one.
const UNIFORM_STOPS: f32 = 0.25;

/// Value that stands for the log2 luminance of a pixel without light.
const UNLIT: f32 = -1000.0;

/// Computes log2 luminance, and red and blue divided by luminance, of a row. The ratios are clamped to the range that
/// sRGB colours have.
struct Logs<'a> {
    to_srgb: &'a ToSrgb,
    row: &'a [[f32; 3]],
    logs: &'a mut [f32],
    ratios: &'a mut [[f32; 2]],
}

impl Loops for Logs<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for ((log, ratios), &pixel) in self.logs.iter_mut().zip(self.ratios.iter_mut()).zip(self.row) {
            let rgb = self.to_srgb.apply(pixel);
            let l = luminance(rgb);
            let is_lit = (f32::MIN_POSITIVE..=f32::MAX).contains(&l);
            let value = log2(l);
            *log = if is_lit { value } else { UNLIT };
            // The upper limits are the ratio of red in pure red, and the ratio of blue in pure blue.
            let ratio = |c: f32, i: usize| at_most(at_least(c / l, 0.0), 1.0 / LUMINANCE[i]);
            *ratios = if is_lit { [ratio(rgb[0], 0), ratio(rgb[2], 2)] } else { [0.0; 2] };
        }
    }
}

/// Returns the quantile `p` (0..=1) of `sorted`, which is ascending and not empty. With five values or more, at least
/// one value lies beyond the result at either end. So a single outlier does not determine the result, even in a small
/// picture.
pub fn quantile(sorted: &[f32], p: f64) -> f32 {
    let last = sorted.len() - 1;
    let place = last as f64 * p;
    let inward = if p < 0.5 { place.ceil() } else { place.floor() };
    let place = if last < 4 { place.round() } else { inward };
    sorted[(place as usize).min(last)]
}

/// The overview of a complete scene.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Conversion to linear sRGB.
    pub to_srgb: ToSrgb,
    /// Width and height of the picture in pixels.
    pub size: (usize, usize),
    /// Side of a cell in pixels; cells at the right and lower border may be smaller.
    pub side: usize,
    /// Mean log2 luminance of each cell; cells without light have the value of the darkest lit cell.
    pub logs: Plane<f32>,
    /// Mean of red divided by luminance, and of blue divided by luminance, in each cell, in linear sRGB.
    pub colours: Plane<[f32; 2]>,
    /// log2 luminances of sampled pixels, ascending.
    sample: Vec<f32>,
    /// Description of the photographs, if they are known.
    pub photographed: Option<Photographed>,
}

impl Scene {
    /// Returns the log2 luminance below which a share `p`, 0..=1, of the pixels lies.
    pub fn percentile(&self, p: f64) -> f64 {
        f64::from(quantile(&self.sample, p))
    }

    /// Whether the scene is uniform: all its light is within `UNIFORM_STOPS`.
    pub fn is_uniform(&self) -> bool {
        let cells = self.logs.as_slice().iter();
        let (least, most) =
            self.sample.iter().chain(cells).fold((f32::MAX, f32::MIN), |(a, b), &l| (a.min(l), b.max(l)));
        most - least <= UNIFORM_STOPS
    }

    /// Returns the mean log2 luminance, with values clamped to the range from `dark` to `bright`.
    pub fn average_within(&self, (dark, bright): (f64, f64)) -> f64 {
        let sum: f64 = self.sample.iter().map(|&l| f64::from(l).clamp(dark, bright)).sum();
        sum / self.sample.len() as f64
    }

    /// Returns the log2 luminances of the cells. Values more than one stop below the 0.1th percentile are raised to
    /// that level, because the differences between them are noise, not contrast.
    pub fn lit(&self) -> Plane<f32> {
        let dark = self.percentile(0.001) as f32 - 1.0;
        let lit = self.logs.as_slice().iter().map(|l| l.max(dark)).collect();
        Plane::from_vec(self.logs.width(), self.logs.height(), lit)
    }

    /// Returns the scene on a coarser grid of at most `cells` cells; each new cell combines a square of old cells.
    pub fn coarser(&self, cells: usize) -> Scene {
        let (width, height) = (self.logs.width(), self.logs.height());
        let mut by = 1;
        while width.div_ceil(by) * height.div_ceil(by) > cells {
            by += 1;
        }
        let (across, down) = (width.div_ceil(by), height.div_ceil(by));
        let means = Plane::from_rows(across, down, |y, row: &mut [[f32; 3]]| {
            for (x, cell) in row.iter_mut().enumerate() {
                let (rows, columns) = (y * by..((y + 1) * by).min(height), x * by..((x + 1) * by).min(width));
                let count = (rows.len() * columns.len()) as f32;
                let cells = rows.flat_map(|y| columns.clone().map(move |x| (x, y)));
                let sums = cells.fold([0.0f32; 3], |[l, r, b], (x, y)| {
                    let [red, blue] = self.colours.at(x, y);
                    [l + self.logs.at(x, y), r + red, b + blue]
                });
                *cell = sums.map(|sum| sum / count);
            }
        });
        let (logs, colours) = means.into_vec().into_iter().map(|[l, r, b]| (l, [r, b])).unzip();
        let (logs, colours) = (Plane::from_vec(across, down, logs), Plane::from_vec(across, down, colours));
        Scene { logs, colours, side: self.side * by, sample: self.sample.clone(), ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize) -> Plane<[f32; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [(1 + (x * 7 + y * 13) % 101) as f32, 2.0, if (x + y) % 50 == 0 { f32::NAN } else { 0.5 }];
            }
        })
    }

    fn seen(pixels: &Plane<[f32; 3]>, portion: usize) -> Scene {
        let mut overview = Overview::new((pixels.width(), pixels.height()), &Primaries::SRGB);
        for first in (0..pixels.height()).step_by(portion) {
            let rows = first..(first + portion).min(pixels.height());
            overview.see(first, &Plane::from_vec(pixels.width(), rows.len(), pixels.rows(rows).to_vec()));
        }
        overview.scene().unwrap()
    }

    #[test]
    fn portions_do_not_show_and_cells_are_means() {
        let pixels = picture(1500, 1100);
        let whole = seen(&pixels, 1100);
        assert_eq!(whole.side, 2);
        for portion in [1, 64, 333] {
            let other = seen(&pixels, portion);
            assert!(other.logs == whole.logs && other.sample == whole.sample, "{portion}");
        }
        for (x, y) in [(0, 0), (749, 549), (100, 77)] {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| luminance(pixels.at(2 * x + i, 2 * y + j)));
            let lit: Vec<f64> = four.iter().filter(|l| l.is_finite()).map(|l| f64::from(*l).log2()).collect();
            let mean = lit.iter().sum::<f64>() / lit.len() as f64;
            // The vectorised logarithm is exact to 2e-7 for values below 8.
            assert!((f64::from(whole.logs.at(x, y)) - mean).abs() < 1e-5);
        }
        let coarse = whole.coarser(1000);
        assert!(coarse.logs.as_slice().len() <= 1000 && coarse.side.is_multiple_of(whole.side));
    }

    #[test]
    fn black_map_has_no_scene() {
        for value in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let mut overview = Overview::new((5, 4), &Primaries::SRGB);
            overview.see(0, &Plane::filled(5, 4, [value; 3]));
            assert!(overview.scene().is_none(), "{value}");
        }
    }
}
