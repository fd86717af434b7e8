//! Rows of a tile over all frames: merged into radiance, or weighed, for people to look at.
//!
//! In: what each frame has of the row, by rising exposure, and how it takes part. Out: the radiance of the row; or the weight of each frame in it. Cost: that of the
//! [mean](super::mean).

use super::layer::{COLUMNS, Fill, Layer, Taken, Tile};
use super::mean::Means;
use crate::simd::Loops;

/// Merges row `y` of a tile into `line`, of the frames whose place is known.
pub(super) struct MergedRow<'a, 'b> {
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
        let [red, green, blue] = &radiance;
        for (x, pixel) in self.line.iter_mut().enumerate().take(COLUMNS) {
            *pixel = [red[x], green[x], blue[x]];
        }
    }
}

/// Weighs what each frame gives of a tile's first row, for people to look at.
pub(super) struct WeighedRow<'a, 'b> {
    /// The frames that are weighed: those that fill this, or those whose place is known.
    pub fill: Option<Fill>,
    pub layers: &'a [Layer<'b>],
    pub tiles: &'a [Tile],
    /// As of a [`MergedRow`].
    pub taken: &'a [Taken<'a>],
    pub means: &'a mut Means,
    /// For each frame and pixel the weights of the three channels together, those that decide included.
    pub weights: &'a mut [[f32; COLUMNS]],
}

impl Loops for WeighedRow<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.means.clear();
        // The last frame believed decides what is dark: which, and by how much.
        let (mut last, mut decides) = ([None; COLUMNS], [0.0; COLUMNS]);
        for (i, ((layer, tile), taken)) in self.layers.iter().zip(self.tiles).zip(self.taken).enumerate() {
            let Some(row) = tile.row(0).filter(|_| layer.fill == self.fill) else { continue };
            let before = self.means.weight;
            self.means.add(layer, &row, *taken);
            for x in 0..COLUMNS {
                self.weights[i][x] = (0..3).map(|c| self.means.weight[c][x] - before[c][x]).sum();
                if self.means.is_last_believed(x) {
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
