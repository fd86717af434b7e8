//! Contribution of each frame to the result, pixel by pixel.
//!
//! In: a [`Merging`]. Out: for each merged frame its weight divided by the sum of the weights of all frames, on a grid
//! of cells. Cost: the same as for merging one row of each cell. The weights are those of the merge itself: a frame's
//! weight is the increase of the sum of weights as the frame is added.

use super::fill::{FilledRow, Filling};
use super::layer::{COLUMNS, Taken, Tile};
use super::mean::Means;
use super::rows::WeighedRow;
use super::{Merging, Rect};
use crate::error::Result;
use crate::plane::Plane;
use crate::simd::vectorised;
use rayon::prelude::*;

/// The weight of one frame, divided by the sum of the weights of all frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Share {
    /// Index of the frame in the bracket.
    pub frame: usize,
    /// Mean share, 0..=1, in each cell of the result.
    pub cells: Plane<f32>,
}

impl Share {
    /// Mean over the result, 0..=1.
    pub fn mean(&self) -> f64 {
        let cells = self.cells.as_slice();
        cells.iter().map(|&v| f64::from(v)).sum::<f64>() / cells.len().max(1) as f64
    }
}

impl Merging<'_> {
    /// Returns the shares of the frames, by rising exposure, on a grid of `size` (columns, rows) cells over the result.
    /// Only the middle row of each cell is computed.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch) if frames are on disk and cannot be read.
    ///
    /// # Panics
    /// If there are more cells than pixels, or none.
    pub fn shares(&self, size: (usize, usize)) -> Result<Vec<Share>> {
        let (width, height) = self.size();
        let (across, down) = size;
        assert!(across > 0 && down > 0 && across <= width && down <= height);
        let rows: Vec<Result<Vec<Vec<f32>>>> = (0..down)
            .into_par_iter()
            .map(|cell| self.share_row((2 * cell + 1) * height / (2 * down), across))
            .collect();
        let rows = rows.into_iter().collect::<Result<Vec<_>>>()?;
        let plane = |layer: usize| {
            Plane::from_vec(across, down, rows.iter().flat_map(|row| row[layer].iter().copied()).collect())
        };
        Ok((0..self.layers.len()).map(|layer| Share { frame: self.frames[layer], cells: plane(layer) }).collect())
    }

    /// Returns the shares in row `y` of the result: for each frame, the means within `across` cells.
    fn share_row(&self, y: usize, across: usize) -> Result<Vec<Vec<f32>>> {
        let Rect { x0, y0, .. } = self.region;
        let width = self.region.width();
        let rows = y0 + y..y0 + y + 1;
        let (mut means, mut tile) = (Means::new(), self.layers.iter().map(|_| Tile::new()).collect::<Vec<_>>());
        let mut sums = vec![vec![0.0f32; across]; self.layers.len()];
        let mut counts = vec![0.0f32; across];
        let kept: Vec<Vec<f32>> = (0..self.layers.len()).map(|i| self.kept(i, y..y + 1)).collect();
        let bases: Vec<Vec<[f32; 2]>> = (0..self.layers.len()).map(|i| self.base(i, y..y + 1)).collect();
        let mut gain: Vec<Vec<f32>> = bases.iter().map(|base| vec![1.0; base.len()]).collect();
        let mut filling = Filling::new();
        let windows =
            self.layers.iter().map(|layer| layer.window(&(x0..x0 + width), &rows)).collect::<Result<Vec<_>>>()?;
        for left in (0..width).step_by(COLUMNS) {
            let columns = left..(left + COLUMNS).min(width);
            let whole = x0 + columns.start..x0 + columns.end;
            for ((layer, window), tile) in self.layers.iter().zip(&windows).zip(&mut tile) {
                tile.read(layer, window, whole.clone(), rows.clone());
            }
            self.multiply(&tile, &bases, &columns, &mut gain);
            let taken: Vec<Taken> =
                kept.iter().zip(&gain).map(|(kept, gain)| Taken::part(kept, gain, columns.clone())).collect();
            let mut weights = vec![[0.0f32; COLUMNS]; self.layers.len()];
            let (layers, tiles, taken) = (&self.layers[..], &tile[..], &taken[..]);
            vectorised(WeighedRow { fill: None, layers, tiles, taken, means: &mut means, weights: &mut weights });
            for fill in self.fills() {
                let (y, mut line) = (0, [[0.0; 3]; COLUMNS]);
                let (filling, known, radiance) = (&mut filling, &mut means, &mut line[..columns.len()]);
                vectorised(FilledRow { layers, tiles, taken, y, fill, filling, known, radiance });
                let (mut means, mut own) = (Means::new(), vec![[0.0f32; COLUMNS]; layers.len()]);
                vectorised(WeighedRow { fill: Some(fill), layers, tiles, taken, means: &mut means, weights: &mut own });
                mix(&mut weights, &own, filling.part());
            }
            for (i, x) in columns.enumerate() {
                let cell = x * across / width;
                let all: f32 = weights.iter().map(|w| w[i]).sum();
                // The sum is 0 where no frame covers the pixel.
                if all > 0.0 {
                    sums.iter_mut().zip(&weights).for_each(|(sum, w)| sum[cell] += w[i] / all);
                }
                counts[cell] += 1.0;
            }
        }
        for sum in &mut sums {
            sum.iter_mut().zip(&counts).for_each(|(sum, count)| *sum /= count.max(1.0));
        }
        Ok(sums)
    }
}

/// Scales `weights` to the sum 1 - `part` in each pixel, and adds the weights `filled`, scaled to the sum `part`.
fn mix(weights: &mut [[f32; COLUMNS]], filled: &[[f32; COLUMNS]], part: &[f32; COLUMNS]) {
    for (x, &part) in part.iter().enumerate() {
        let sum = |of: &[[f32; COLUMNS]]| of.iter().map(|w| w[x]).sum::<f32>().max(f32::MIN_POSITIVE);
        let (known, fill) = (sum(weights), sum(filled));
        for (w, f) in weights.iter_mut().zip(filled) {
            w[x] = (1.0 - part) * w[x] / known + part * f[x] / fill;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::MergeOptions;
    use crate::merge::weight::Weight;
    use crate::response::ResponseCurve;
    use crate::response::tests::still;

    #[test]
    fn shares_are_those_with_which_the_frames_make_the_radiance() {
        // The scene rises by ten stops from left to right: the longest frame shows the dark end, the shortest the
        // bright end.
        let scene = |x: usize, _: usize| [libm::exp2(x as f64 / 20.0 - 9.0); 3];
        let (bracket, alignment) = still((200, 40), &[0.125, 1.0, 8.0], scene);
        let curve = ResponseCurve::srgb();
        let options = MergeOptions { weight: Weight::Hat, region: alignment.overlap };
        let merging = Merging::of(&bracket, &alignment, &curve, &options, None).unwrap();
        let shares = merging.shares((200, 4)).unwrap();
        assert_eq!(shares.iter().map(|s| s.frame).collect::<Vec<_>>(), [0, 1, 2]);
        let radiance = merging.slab(0..40).unwrap().map.pixels;
        let own = |frame: usize, x: usize| {
            let codes = bracket.frames()[frame].window(5..6).unwrap();
            let crate::bracket::Codes::Eight(codes) = codes.codes() else { unreachable!("8 bit") };
            let times = [0.125f32, 1.0, 8.0];
            curve.exposures(1)[usize::from(codes[3 * x + 1])] * bracket_unit(&bracket) / times[frame]
        };
        for x in 0..200 {
            let of = |frame: usize| shares[frame].cells.at(x, 0);
            let all: f32 = (0..3).map(of).sum();
            assert!((all - 1.0).abs() < 1e-4, "{x}: {all}");
            // All channels are equal in this scene. So the sum of the frames' radiances, each multiplied by the share
            // of its frame, is the merged radiance. This is also true beside clipped pixels.
            let mean: f32 = (0..3).map(|frame| of(frame) * own(frame, x)).sum();
            let found = radiance.at(x, 5)[1];
            assert!((mean / found - 1.0).abs() < 2e-3, "{x}: {mean} for {found}");
        }
        assert!(shares[2].cells.at(2, 1) > 0.9 && shares[0].cells.at(199, 1) > 0.9);
        assert!((shares.iter().map(Share::mean).sum::<f64>() - 1.0).abs() < 1e-4);
    }

    /// Returns the relative exposure of the reference frame, at which radiance 1 gives the middle code value.
    fn bracket_unit(bracket: &crate::bracket::Bracket) -> f32 {
        bracket.reference().exposure.relative() as f32
    }
}
