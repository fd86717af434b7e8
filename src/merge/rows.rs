//! Rows of a tile: merges all frames to radiance, or computes their weights for the report.
//!
//! In: the row of each frame, by rising exposure, with weights and factors. Out: the radiance of the row, or the weight
//! of each frame. Cost: the [mean](super::mean).

use super::allowed::Allowed;
use super::layer::{COLUMNS, Fill, Layer, Taken, Tile};
use super::mean::Means;
use crate::simd::Loops;

/// Merges row `y` of the frames with known transforms, within one tile, and writes the radiance to `line`.
pub(super) struct MergedRow<'a, 'b> {
    /// What the reference allows; none if frames are merged whatever the reference shows.
    pub allowed: Option<&'a Allowed>,
    pub layers: &'a [Layer<'b>],
    pub tiles: &'a [Tile],
    pub taken: &'a [Taken<'a>],
    pub y: usize,
    pub means: &'a mut Means,
    pub line: &'a mut [[f32; 3]],
}

impl Loops for MergedRow<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.means.add_all(None, (self.layers, self.tiles, self.taken), self.y);
        let mut radiance = [[0.0; COLUMNS]; 3];
        self.means.radiance(&mut radiance);
        if let Some(allowed) = self.allowed
            && let Some(row) = self.tiles[allowed.reference].row(self.y)
        {
            allowed.limit(&row, &mut radiance);
        }
        let [red, green, blue] = &radiance;
        for (x, pixel) in self.line.iter_mut().enumerate().take(COLUMNS) {
            *pixel = [red[x], green[x], blue[x]];
        }
    }
}

/// Computes the weight of each frame in the first row of a tile, for the report.
pub(super) struct WeighedRow<'a, 'b> {
    /// The frames whose weights are computed. With `None`, these are the frames with known transforms. Otherwise, they
    /// are the frames with an assumed transform that fill pixels of the kind [`Fill`].
    pub fill: Option<Fill>,
    pub layers: &'a [Layer<'b>],
    pub tiles: &'a [Tile],
    /// For each frame, the motion-mask factor on the weight and the gain on the radiance of each pixel.
    pub taken: &'a [Taken<'a>],
    pub means: &'a mut Means,
    /// For each frame and pixel, the sum of the weights of the three channels. It includes the extra weight e of the
    /// [equation](super).
    pub weights: &'a mut [[f32; COLUMNS]],
}

impl Loops for WeighedRow<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.means.clear();
        // If all frames are black at a pixel, the longest frame that is used there determines the radiance. `last` is
        // the index of that frame, `decides` its extra weight e.
        let (mut last, mut decides) = ([None; COLUMNS], [0.0; COLUMNS]);
        for (i, ((layer, tile), taken)) in self.layers.iter().zip(self.tiles).zip(self.taken).enumerate() {
            let Some(row) = tile.row(0).filter(|_| layer.fill == self.fill) else { continue };
            let before = self.means.weight;
            self.means.add(layer, &row, *taken);
            for x in 0..COLUMNS {
                self.weights[i][x] = (0..3).map(|c| self.means.weight[c][x] - before[c][x]).sum();
                if self.means.is_last_used(x) {
                    last[x] = Some(i);
                    decides[x] = (0..3).map(|c| self.means.longest_weight[c][x]).sum();
                }
            }
        }
        for x in 0..COLUMNS {
            if let Some(i) = last[x] {
                self.weights[i][x] += decides[x];
            }
        }
    }
}
