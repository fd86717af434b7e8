//! Downscaling row by row, in linear light, so that fine bright detail keeps its brightness.
//!
//! In: rows of light or radiance, from the first to the last, in portions of any size. Out: rows of the smaller picture
//! as they become complete. Cost: 25 ns per pixel, summed over all threads. Memory: about 75 bytes for each input
//! column, and the rows of one portion. Source: Turkowski, "Filters for Common Resampling Tasks", Graphics Gems I
//! (1990): Lanczos' kernel with three lobes, scaled to the pixels of the smaller picture, applied along one axis after
//! the other.
//!
//! Linear light has a large range, so the negative lobes of the kernel would draw a black line beside a bright window.
//! The result is therefore clamped to the range of the pixels under the kernel's main lobe.

use crate::align::resampling::lanczos::lanczos3;
use rayon::prelude::*;
use std::collections::VecDeque;
use std::ops::Range;

/// Radius of the kernel, in pixels of the smaller picture.
const REACH: f64 = 3.0;

/// The input pixels and weights of each output pixel, along one axis.
#[derive(Debug, Clone)]
struct Taps {
    /// For each output pixel: the range of its input pixels, the index of its first weight in `weights`, and the range
    /// of the input pixels under the main lobe.
    places: Vec<(Range<usize>, usize, Range<usize>)>,
    weights: Vec<f32>,
}

impl Taps {
    /// Computes the weights that scale `from` pixels to `to` pixels; `to` is not larger than `from`.
    fn new(from: usize, to: usize) -> Self {
        let step = from as f64 / to as f64;
        let (mut places, mut weights) = (Vec::with_capacity(to), Vec::new());
        for i in 0..to {
            let centre = (i as f64 + 0.5) * step - 0.5;
            let within = |reach: f64| {
                // The cast clamps negative positions to 0.
                let first = (centre - reach * step).ceil() as usize;
                let last = ((centre + reach * step).floor() as usize).min(from - 1);
                first..last + 1
            };
            let seen = within(REACH);
            let raw: Vec<f64> = seen.clone().map(|j| lanczos3((j as f64 - centre) / step)).collect();
            let sum: f64 = raw.iter().sum();
            places.push((seen, weights.len(), within(1.0)));
            weights.extend(raw.iter().map(|w| (w / sum) as f32));
        }
        Taps { places, weights }
    }

    /// Scales one row of pixels.
    fn line(&self, from: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let pixel = |(seen, first, lobe): &(Range<usize>, usize, Range<usize>)| {
            let (mut sum, mut least, mut most) = ([0.0f32; 3], [f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
            for (p, &weight) in from[seen.clone()].iter().zip(&self.weights[*first..]) {
                for c in 0..3 {
                    sum[c] += weight * p[c];
                }
            }
            for p in &from[lobe.clone()] {
                for c in 0..3 {
                    least[c] = if p[c] < least[c] { p[c] } else { least[c] };
                    most[c] = if p[c] > most[c] { p[c] } else { most[c] };
                }
            }
            std::array::from_fn(|c| clamped(sum[c], least[c], most[c]))
        };
        self.places.iter().map(pixel).collect()
    }
}

/// Clamps `value` to `least..=most`; NaN becomes `least`.
#[inline(always)]
fn clamped(value: f32, least: f32, most: f32) -> f32 {
    let value = if value > least { value } else { least };
    if value < most { value } else { most }
}

/// Downscales a picture row by row.
#[derive(Debug, Clone)]
pub struct Resizer {
    width: usize,
    columns: Taps,
    rows: Taps,
    /// Input rows from row `first` on, already scaled to the output width.
    lines: VecDeque<Vec<[f32; 3]>>,
    first: usize,
    /// Number of output rows that were returned.
    done: usize,
}

impl Resizer {
    /// Prepares to scale a picture of the size `from` to the size `to`. Width and height of `to` are not 0, and not
    /// greater than those of `from`.
    pub fn new(from: (usize, usize), to: (usize, usize)) -> Self {
        let (columns, rows) = (Taps::new(from.0, to.0), Taps::new(from.1, to.1));
        Resizer { width: from.0, columns, rows, lines: VecDeque::new(), first: 0, done: 0 }
    }

    /// Takes whole input rows and replaces the contents of `out` by the output rows that they complete.
    pub fn push(&mut self, rows: &[[f32; 3]], out: &mut Vec<[f32; 3]>) {
        let lines: Vec<Vec<[f32; 3]>> = rows.par_chunks(self.width).map(|row| self.columns.line(row)).collect();
        self.lines.extend(lines);
        let seen = self.first + self.lines.len();
        let places = &self.rows.places;
        let ready = places[self.done..].iter().take_while(|(rows, ..)| rows.end <= seen).count();
        let width = self.columns.places.len();
        out.clear();
        out.resize(ready * width, [0.0; 3]);
        out.par_chunks_mut(width).enumerate().for_each(|(i, to)| self.row(self.done + i, to));
        self.done += ready;
        let needed = places.get(self.done).map_or(seen, |(rows, ..)| rows.start);
        self.lines.drain(..needed - self.first);
        self.first = needed;
    }

    /// Computes output row `y`. All input rows that it depends on must be in `lines`.
    fn row(&self, y: usize, to: &mut [[f32; 3]]) {
        let (seen, first, lobe) = &self.rows.places[y];
        let line = |j: usize| self.lines[j - self.first].as_flattened();
        let to = to.as_flattened_mut();
        for (j, &weight) in seen.clone().zip(&self.rows.weights[*first..]) {
            for (sum, v) in to.iter_mut().zip(line(j)) {
                *sum += weight * v;
            }
        }
        let (mut least, mut most) = (line(lobe.start).to_vec(), line(lobe.start).to_vec());
        for j in lobe.clone().skip(1) {
            for ((least, most), &v) in least.iter_mut().zip(&mut most).zip(line(j)) {
                *least = if v < *least { v } else { *least };
                *most = if v > *most { v } else { *most };
            }
        }
        for ((sum, least), most) in to.iter_mut().zip(least).zip(most) {
            *sum = clamped(*sum, least, most);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::Plane;

    fn resized(picture: &Plane<[f32; 3]>, to: (usize, usize), portion: usize) -> Vec<[f32; 3]> {
        let mut resizer = Resizer::new((picture.width(), picture.height()), to);
        let (mut all, mut out) = (Vec::new(), Vec::new());
        for rows in picture.as_slice().chunks(portion * picture.width()) {
            resizer.push(rows, &mut out);
            all.extend_from_slice(&out);
        }
        assert_eq!(all.len(), to.0 * to.1, "every row comes out");
        all
    }

    fn picture(width: usize, height: usize, value: impl Fn(usize, usize) -> f32 + Sync) -> Plane<[f32; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [1.0, 0.5, 2.0].map(|tint| tint * value(x, y));
            }
        })
    }

    #[test]
    fn portions_do_not_show() {
        let picture = picture(61, 173, |x, y| ((x * 7919 + y * 104_729) % 1009) as f32);
        for to in [(61, 173), (60, 172), (20, 57), (7, 20), (1, 1)] {
            let whole = resized(&picture, to, 173);
            assert!([1, 5, 64].iter().all(|&portion| resized(&picture, to, portion) == whole), "{to:?}");
        }
        // If the size does not change, each pixel has one weight of 1, and its other weights are 0 up to the rounding
        // of sines.
        let same = resized(&picture, (61, 173), 64);
        let off = same.as_flattened().iter().zip(picture.as_slice().as_flattened()).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f32::max) < 1e-3, "the same size is the same picture");
    }

    /// A uniform picture keeps its value and a ramp its slope; an edge with a ratio of 1 : 1000 has no dark or bright
    /// line beside it.
    #[test]
    fn light_is_kept_and_edges_do_not_ring() {
        for to in [(150, 90), (77, 31), (40, 13)] {
            assert!(resized(&picture(200, 120, |_, _| 0.3), to, 64).iter().all(|p| (p[0] - 0.3).abs() < 1e-6));
            let ramp = resized(&picture(200, 120, |x, y| (2 * x + y) as f32), to, 64);
            let (sx, sy) = (200.0 / to.0 as f32, 120.0 / to.1 as f32);
            for (x, y) in (4..to.0 - 4).flat_map(|x| (4..to.1 - 4).map(move |y| (x, y))) {
                let exact = 2.0 * ((x as f32 + 0.5) * sx - 0.5) + (y as f32 + 0.5) * sy - 0.5;
                assert!((ramp[y * to.0 + x][0] - exact).abs() < 0.02 * exact.max(1.0), "{to:?} {x} {y}");
            }
            let edge = resized(&picture(200, 120, |x, y| if x + y > 150 { 1.0 } else { 0.001 }), to, 64);
            assert!(edge.iter().all(|p| (0.001..=1.0).contains(&p[0])), "{to:?}");
        }
        // A grating that is too fine for the smaller picture becomes uniform, with the mean of the grating. Without
        // filtering it would become stripes.
        let grating = resized(&picture(240, 240, |x, _| if x % 3 == 0 { 1.0 } else { 0.0 }), (60, 60), 64);
        assert!(
            grating.iter().skip(60 * 30 + 5).take(50).all(|p| (p[0] - 1.0 / 3.0).abs() < 0.02),
            "{:?}",
            &grating[1830..1840]
        );
    }

    #[test]
    fn threads_do_not_show() {
        let picture = picture(90, 200, |x, y| ((x * 31 + y * 17) % 101) as f32);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| resized(&picture, (37, 83), 64))
        };
        assert!(on(1) == on(5));
    }
}
