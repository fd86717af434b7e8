//! The weighted mean of one pixel over the frames, as it grows.
//!
//! In: [`View`]s by rising exposure. Out: radiance, and whether every frame was clipped or black. Cost: a dozen multiplications a view.
//! The equation and its letters are at the head of [`merge`](super).

use super::FLOOR;
use super::layer::{Layer, View};

/// e: the extra weight of the shortest and the longest exposure, at the code it decides, as a share of the frame's say; that of one code
/// on the hat. A smaller one would let a second frame that noise lifts from black by one code outvote the longest; a larger one would
/// trust clipped codes.
const DECIDE: f32 = 1.0 / 127.5;
/// What keeps the sum of weights above zero where the shortest exposure is black and the longest clips.
const LEAST: f32 = 1e-6;

/// The mean of a pixel so far.
#[derive(Clone, Copy, Default)]
pub(super) struct Mean {
    sum: [f32; 3],
    weight: [f32; 3],
    /// The radiance that the scene has here at least, as shorter exposures vouch for it.
    vouched: [f32; 3],
    /// e X / dt and e of the longest exposure so far.
    longest: ([f32; 3], [f32; 3]),
    is_seen: bool,
    is_clipped: bool,
    is_black: bool,
}

impl Mean {
    /// Adds a frame's view, of which `trust` (0..=1) is believed; its weight counts by `share`.
    #[inline(always)]
    pub fn add(&mut self, layer: &Layer, view: &View, share: f32, trust: f32) {
        let top = view.code[0].max(view.code[1]).max(view.code[2]);
        let v = trust * share * layer.guard[top as usize & 255];
        let mut unclipped = [0.0; 3];
        for c in 0..3 {
            let (sure, slope) = layer.clips[c];
            unclipped[c] = ((sure - self.vouched[c]) * slope).clamp(0.0, 1.0);
            let w = view.weight[c] * v * unclipped[c];
            self.sum[c] += w * view.radiance[c];
            self.weight[c] += w;
            self.vouched[c] = self.vouched[c].max(trust * view.vouched[c]);
        }
        // A frame that is not believed does not decide.
        if trust < 0.5 {
            return;
        }
        let (say, code) = (trust * layer.say, view.code);
        if !self.is_seen {
            self.is_seen = true;
            self.is_clipped = top >= 254.5;
            for c in 0..3 {
                let e = say * (DECIDE * (code[c] / 255.0) + LEAST);
                self.sum[c] += e * view.radiance[c];
                self.weight[c] += e;
            }
        }
        self.is_black = top <= 0.5;
        // Where it clips it does not decide what is dark, whatever its code.
        let e: [f32; 3] = std::array::from_fn(|c| say * unclipped[c] * (DECIDE * (1.0 - code[c] / 255.0) + LEAST));
        self.longest = (std::array::from_fn(|c| e[c] * view.radiance[c]), e);
    }

    /// The radiance; none where no frame covers the pixel.
    #[inline]
    pub fn radiance(&self) -> Option<[f32; 3]> {
        let (sum, weight) = &self.longest;
        let of = |c: usize| ((self.sum[c] + sum[c]) / (self.weight[c] + weight[c])).max(FLOOR);
        self.is_seen.then(|| [of(0), of(1), of(2)])
    }

    /// Whether some channel is at its top code even in the shortest exposure.
    pub fn is_clipped(&self) -> bool {
        self.is_clipped
    }

    /// Whether all channels are at code 0 even in the longest exposure.
    pub fn is_black(&self) -> bool {
        self.is_black
    }
}
