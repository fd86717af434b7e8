//! The weighted mean over the frames, for the pixels of a row.
//!
//! In: the row of each frame, by rising exposure. Out: radiance, and the number of pixels that are clipped or black in
//! every frame. Cost: two dozen multiplications per pixel, channel and frame, eight pixels at a time. The equation and
//! its letters are at the head of [`merge`](super).

use super::FLOOR;
use super::layer::{CLIPPED, COLUMNS, Fill, Layer, Meaning, PAINTED, Row, Taken, Tile};
use crate::simd::{at_least, at_most};

/// Upper limit of e, the extra weight of the shortest and of the longest exposure. The unit is the weight of the
/// frame's middle code value. The limit equals the hat weight of code value 1. If the limit were smaller, a shorter
/// frame in which noise lifts a black pixel by one code value would outweigh the longest exposure. If it were larger,
/// clipped code values would contribute too much.
const DECIDE: f32 = 1.0 / 127.5;
/// Smallest e, in units of the weight of the frame's middle code value. It keeps the sum of weights above zero where
/// the shortest exposure is black and the longest is clipped.
const LEAST: f32 = 1e-6;

/// Two code values of a frame's brightest channel. Up to the first, the frame is never treated as clipped. From the
/// second on, it is clipped if a shorter frame shows more radiance than this frame can hold. JPEG lowers a clipped
/// channel by some code values, and one channel of a saturated colour by many, but never all three by many. So if the
/// brightest channel is far below white, the frame is not clipped but shows another object, which moved.
pub(super) const MAY_CLIP: (f32, f32) = (205.0, 235.0);

/// A value for each channel and pixel of a row.
pub(super) type Channels = [[f32; COLUMNS]; 3];

/// The means of the pixels of a row, over the frames added so far.
pub(super) struct Means {
    sum: Channels,
    pub(super) weight: Channels,
    /// Lower bound of the radiance, from shorter exposures.
    bound: Channels,
    /// e X / dt of the [equation](super), for the longest exposure added so far; `longest_weight` is the e of this
    /// exposure.
    longest_sum: Channels,
    pub(super) longest_weight: Channels,
    /// 1 where a frame was used.
    is_seen: [u32; COLUMNS],
    /// 1 where a channel is at white even in the shortest exposure.
    is_clipped: [u32; COLUMNS],
    /// 1 where all channels are at code value 0 even in the longest exposure.
    is_black: [u32; COLUMNS],
    frame: View,
}

/// The row of one frame, prepared for the mean.
struct View {
    meanings: [[Meaning; COLUMNS]; 3],
    /// Factor of the motion mask on the frame's weight, 0..=1; 0 where the frame is not used.
    share: [f32; COLUMNS],
    /// Product of three factors: `share`, the factor v of the [equation](super), and [`Layer::ringing`] for clipped
    /// pixels and their neighbours (1 for other pixels).
    v: [f32; COLUMNS],
    /// Lower bound of the factor u of the [equation](super), from the brightest channel.
    below_top: [f32; COLUMNS],
    /// 1 where this is the first frame that is used.
    is_first: [u32; COLUMNS],
    /// 1 where this frame is used.
    is_used: [u32; COLUMNS],
    /// Factor on the radiance.
    gain: [f32; COLUMNS],
    /// Inverse of the factor on the radiance.
    inverse: [f32; COLUMNS],
}

/// Numbers of pixels whose radiance is only a bound.
#[derive(Clone, Copy, Default)]
pub(super) struct Bounds {
    /// Number of pixels with a channel at white even in the shortest exposure.
    pub clipped: usize,
    /// Number of pixels with all channels at code value 0 even in the longest exposure.
    pub black: usize,
}

impl Means {
    pub fn new() -> Self {
        let (none, zero, flags) = ([[0.0; COLUMNS]; 3], [0.0; COLUMNS], [0; COLUMNS]);
        Means {
            sum: none,
            weight: none,
            bound: none,
            longest_sum: none,
            longest_weight: none,
            is_seen: flags,
            is_clipped: flags,
            is_black: flags,
            frame: View {
                meanings: [[[0.0; 4]; COLUMNS]; 3],
                share: zero,
                v: zero,
                below_top: zero,
                is_first: flags,
                is_used: flags,
                gain: zero,
                inverse: zero,
            },
        }
    }

    #[inline(always)]
    pub fn clear(&mut self) {
        for of in [&mut self.sum, &mut self.weight, &mut self.bound, &mut self.longest_sum, &mut self.longest_weight] {
            *of = [[0.0; COLUMNS]; 3];
        }
        (self.is_seen, self.is_clipped, self.is_black) = ([0; COLUMNS], [0; COLUMNS], [0; COLUMNS]);
    }

    /// Computes the means of row `y`. If `fill` is a kind of pixels (clipped or black), the means are over the frames
    /// with an assumed transform that fill pixels of this kind. If it is `None`, they are over the frames with a known
    /// transform.
    #[inline(always)]
    pub fn add_all(&mut self, fill: Option<Fill>, (layers, tiles, taken): (&[Layer], &[Tile], &[Taken]), y: usize) {
        self.clear();
        for ((layer, tile), taken) in layers.iter().zip(tiles).zip(taken) {
            if layer.fill == fill
                && let Some(row) = tile.row(y)
            {
                self.add(layer, &row, *taken);
            }
        }
    }

    /// Adds the row of a frame. Pixels outside the frame and [`PAINTED`] pixels are not used.
    #[inline(always)]
    pub fn add(&mut self, layer: &Layer, row: &Row, Taken { kept, gain }: Taken) {
        let View { meanings, share, v, below_top, is_first, is_used, gain: factor, inverse } = &mut self.frame;
        let gain = &gain[..gain.len().min(COLUMNS)];
        factor[..gain.len()].copy_from_slice(gain);
        factor[gain.len()..].fill(1.0);
        for x in 0..COLUMNS {
            inverse[x] = 1.0 / factor[x];
        }
        let kept = &kept[..kept.len().min(COLUMNS)];
        share[..kept.len()].copy_from_slice(kept);
        share[kept.len()..].fill(1.0);
        let [red, green, blue] = row.codes;
        for x in 0..COLUMNS {
            let top = at_least(at_least(red[x], green[x]), blue[x]);
            let is_shown = red[x] >= 0.0 && row.beside[x] & PAINTED == 0;
            let t = if is_shown { share[x] } else { 0.0 };
            let is_beside = row.beside[x] & CLIPPED != 0;
            share[x] = t;
            v[x] = t * (if is_beside { layer.ringing } else { 1.0 }) * layer.guard(top);
            // Beside clipped pixels u has no lower bound: in a frame that was resampled, any code value there may
            // include a clipped pixel.
            let below = at_most(at_least((MAY_CLIP.1 - top) * (1.0 / (MAY_CLIP.1 - MAY_CLIP.0)), 0.0), 1.0);
            below_top[x] = if is_beside { 0.0 } else { below };
            // A frame whose weight is reduced to less than half does not decide whether the pixel is clipped or black.
            let used = u32::from(t >= 0.5);
            let first = used & (self.is_seen[x] ^ 1);
            is_used[x] = used;
            is_first[x] = first;
            self.is_seen[x] |= used;
            self.is_clipped[x] |= first & u32::from(top >= 254.5);
            self.is_black[x] = if used != 0 { u32::from(top <= 0.5) } else { self.is_black[x] };
        }
        for c in 0..3 {
            layer.look_up(c, row.codes[c], &mut meanings[c]);
        }
        if layer.is_joint {
            let [red, green, blue] = meanings;
            for x in 0..COLUMNS {
                let least = at_most(at_most(red[x][1], green[x][1]), blue[x][1]);
                (red[x][1], green[x][1], blue[x][1]) = (least, least, least);
            }
        }
        for c in 0..3 {
            let (codes, meanings, (sure, slope)) = (row.codes[c], &meanings[c], layer.clips[c]);
            let (sum, weight, bound) = (&mut self.sum[c], &mut self.weight[c], &mut self.bound[c]);
            let (longest_sum, longest_weight) = (&mut self.longest_sum[c], &mut self.longest_weight[c]);
            for x in 0..COLUMNS {
                let [radiance, weighted, lower, _] = meanings[x];
                let radiance = radiance * factor[x];
                let unclipped = at_most(at_least((sure - bound[x] * inverse[x]) * slope, below_top[x]), 1.0);
                let w = weighted * v[x] * unclipped;
                bound[x] = at_least(share[x] * lower * factor[x], bound[x]);
                let (middle, code) = (share[x] * layer.middle_weight, codes[x] / 255.0);
                let e = middle * (DECIDE * code + LEAST);
                let e = if is_first[x] != 0 { e } else { 0.0 };
                sum[x] = (sum[x] + w * radiance) + e * radiance;
                weight[x] = (weight[x] + w) + e;
                // The factor `unclipped` is u: a clipped frame (u = 0) does not determine dark pixels, whatever its
                // code value.
                let e = middle * unclipped * (DECIDE * (1.0 - code) + LEAST);
                longest_sum[x] = if is_used[x] != 0 { e * radiance } else { longest_sum[x] };
                longest_weight[x] = if is_used[x] != 0 { e } else { longest_weight[x] };
            }
        }
    }

    /// Writes the radiance of the row to `radiance`: [`FLOOR`] for pixels that no frame covers.
    #[inline(always)]
    pub fn radiance(&self, radiance: &mut Channels) {
        for c in 0..3 {
            for x in 0..COLUMNS {
                let mean = (self.sum[c][x] + self.longest_sum[c][x]) / (self.weight[c][x] + self.longest_weight[c][x]);
                radiance[c][x] = if self.is_seen[x] != 0 { mean.max(FLOOR) } else { FLOOR };
            }
        }
    }

    /// Whether a frame is used at pixel `x`.
    #[inline(always)]
    pub fn is_seen(&self, x: usize) -> bool {
        self.is_seen[x] != 0
    }

    /// Whether the frame added last is used at pixel `x`.
    #[inline(always)]
    pub fn is_last_used(&self, x: usize) -> bool {
        self.frame.is_used[x] != 0
    }

    /// Updates whether pixel `x` counts as clipped (as black, if `fill` is [`Fill::Black`]), after frames with assumed
    /// transforms have filled it. It no longer does if these frames, whose means are `other`, show it unclipped (not
    /// black).
    pub fn fill(&mut self, x: usize, fill: Fill, other: &Means) {
        match fill {
            Fill::Clipped => self.is_clipped[x] &= other.is_clipped[x],
            Fill::Black => self.is_black[x] &= other.is_black[x],
        }
    }

    /// Counts the pixels among the first `width` whose radiance is only a bound.
    pub fn bounds(&self, width: usize) -> Bounds {
        let count = |of: &[u32; COLUMNS]| of.iter().take(width).sum::<u32>() as usize;
        Bounds { clipped: count(&self.is_clipped), black: count(&self.is_black) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::layer::{Tile, layers};
    use super::super::weight::Weight;
    use super::super::{MergeOptions, merge};
    use crate::align::Alignment;
    use crate::bracket::exposure::Exposure;
    use crate::bracket::{Bracket, Frame, ReferenceChoice, Samples};
    use crate::response::{ResponseCurve, hat};

    const SIZE: (usize, usize) = (9, 7);

    /// A frame: its exposure in stops, and a function from column and row to the code values of a pixel.
    type Seen<'a> = (f64, &'a dyn Fn(usize, usize) -> [u8; 3]);

    /// Returns a still bracket of these frames; the reference is the second frame.
    fn bracket(frames: &[Seen]) -> (Bracket, Alignment) {
        let frame = |&(stops, code): &Seen| {
            let codes = (0..SIZE.0 * SIZE.1).flat_map(|i| code(i % SIZE.0, i / SIZE.0)).collect();
            let exposure = Exposure::given(stops).unwrap();
            Frame::new(format!("{stops}").into(), SIZE.0, SIZE.1, Samples::Eight(codes), exposure)
        };
        let bracket = Bracket::new(frames.iter().map(frame).collect(), &ReferenceChoice::Number(2)).unwrap();
        let alignment = Alignment::unmoved(&bracket);
        (bracket, alignment)
    }

    fn merged(bracket: &Bracket, alignment: &Alignment, weight: Weight) -> Vec<[f32; 3]> {
        let options = MergeOptions { weight, region: alignment.overlap };
        merge(bracket, alignment, &ResponseCurve::srgb(), &options, None).unwrap().0.pixels.into_vec()
    }

    /// Returns the radiance of a pixel without clipped neighbours, by the equation at the head of
    /// [`merge`](super::super), written out term by term.
    fn textbook(codes: &[[u8; 3]], times: &[f64], channel: usize) -> f64 {
        let curve = ResponseCurve::srgb();
        let x = |code: u8| f64::from(curve.exposures(channel)[usize::from(code)]);
        let middle = |j: usize| (times[j] / times[times.len() - 1]).sqrt();
        let (mut sum, mut weight, mut bound) = (0.0, 0.0, 0.0f64);
        for (j, codes) in codes.iter().enumerate() {
            let z = codes[channel];
            let top = f64::from(codes.iter().copied().max().unwrap());
            let v = ((255.0 - top) / 16.0).clamp(0.25, 1.0);
            let (begins, sure) = (x(230) / times[j], x(250) / times[j]);
            let below_top = ((235.0 - top) / 30.0).clamp(0.0, 1.0);
            let u = ((sure - bound) / (sure - begins)).clamp(0.0, 1.0).max(below_top);
            let mut w = hat(f64::from(z)) * middle(j) * v * u;
            if j == 0 {
                w += middle(j) * (f64::from(z) / 255.0 / 127.5 + 1e-6);
            }
            if j == times.len() - 1 {
                w += middle(j) * u * ((1.0 - f64::from(z) / 255.0) / 127.5 + 1e-6);
            }
            sum += w * x(z) / times[j];
            weight += w;
            bound = bound.max(if z > 6 { x(z - 6) / times[j] } else { 0.0 });
        }
        sum / weight
    }

    #[test]
    fn every_pixel_follows_the_equation() {
        let codes = |j: usize, x: usize, y: usize| {
            std::array::from_fn(|c| ((37 * x + 61 * y + 89 * j + 23 * c + x * y * (j + 2)) % 250) as u8)
        };
        let frames = [0, 1, 2].map(|j| move |x: usize, y: usize| -> [u8; 3] { codes(j, x, y) });
        let (bracket, alignment) = bracket(&[(-2.0, &frames[0]), (0.0, &frames[1]), (1.5, &frames[2])]);
        let times = [0.25, 1.0, libm::exp2(1.5)];
        for (i, pixel) in merged(&bracket, &alignment, Weight::Hat).iter().enumerate() {
            let seen = [0, 1, 2].map(|j| codes(j, i % SIZE.0, i / SIZE.0));
            for c in 0..3 {
                let expected = textbook(&seen, &times, c);
                // The tolerance allows for the rounding of a dozen operations on `f32`, which has 24 bits. The error of
                // u is larger, because u is a difference of nearly equal numbers.
                assert!((f64::from(pixel[c]) / expected - 1.0).abs() < 2e-4, "{i} {c}: {} for {expected}", pixel[c]);
            }
        }
    }

    #[test]
    fn radiance_of_shorter_frames_clips_the_longer_whatever_its_code() {
        // Code value 200 of a frame that is two stops shorter stands for more radiance than the longer frame can hold.
        // JPEG has lowered the clipped code values of the longer frame.
        let pulled = |_: usize, _: usize| [235, 220, 240];
        let (bracket, alignment) = bracket(&[(-2.0, &|_, _| [200; 3]), (0.0, &pulled)]);
        let truth = 4.0 * ResponseCurve::srgb().exposures(0)[200];
        for weight in [Weight::Hat, Weight::Gaussian, Weight::Plateau, Weight::MannPicard, Weight::Noise] {
            let pixel = merged(&bracket, &alignment, weight)[31];
            assert!((pixel[1] / truth - 1.0).abs() < 1e-3, "{weight:?} {pixel:?} for {truth}");
        }
        // With `Weight::Uniform`, u is 1 for every frame: the clipped frame is averaged in too, and the mean is far too
        // dark.
        assert!(merged(&bracket, &alignment, Weight::Uniform)[31][1] < 0.8 * truth);
    }

    #[test]
    fn glint_in_a_shorter_frame_does_not_exclude_a_longer_one() {
        let of = |glint: u8| {
            let (bracket, alignment) = bracket(&[(-2.0, &|_, _| [glint; 3]), (0.0, &|_, _| [120; 3])]);
            merged(&bracket, &alignment, Weight::Hat)[31][1]
        };
        // The longer frame does not count as clipped, so only the weights matter. The longer frame has more weight for
        // two reasons: its middle code value has twice the weight of the shorter frame's middle code value, and its
        // code value 120 is closer to the middle than the shorter frame's 200.
        let x = |code: usize| ResponseCurve::srgb().exposures(1)[code];
        assert!(of(200) < 0.35 * 4.0 * x(200) && of(200) > x(120), "{}", of(200) / x(200));
    }

    #[test]
    fn painted_pixels_have_no_weight_there_and_beside() {
        let paint = |x: usize, _: usize| if x < 4 { [0, 0, 255] } else { [40; 3] };
        let bare: Seen = (0.0, &|_, _| [100; 3]);
        let of = |frames: &[Seen]| {
            let (bracket, alignment) = bracket(frames);
            merged(&bracket, &alignment, Weight::Hat)
        };
        let (with, without) = (of(&[(-2.0, &paint), bare]), of(&[(-2.0, &|_, _| [40; 3]), bare]));
        let x = |code: usize| ResponseCurve::srgb().exposures(2)[code];
        for row in 0..SIZE.1 {
            // Columns 0 to 3 are painted. In these columns and in the neighbouring column 4, only the reference is
            // used. The other columns have the same radiance as without paint.
            for column in 0..=4 {
                let found = with[row * SIZE.0 + column][2];
                assert!((found / x(100) - 1.0).abs() < 1e-3, "{row} {column}: {found} for {}", x(100));
            }
            assert_eq!(with[row * SIZE.0 + 5..(row + 1) * SIZE.0], without[row * SIZE.0 + 5..(row + 1) * SIZE.0]);
        }
        // Where all frames are painted, the reference is used.
        let own = of(&[(-2.0, &|_, _| [255, 0, 0]), (0.0, &|_, _| [255, 0, 0])]);
        assert!(own[31][0] > x(200), "{:?}", own[31]);
    }

    #[test]
    fn beside_clipped_pixels_a_frame_counts_half() {
        let at = |x: usize, y: usize| if (x, y) == (4, 3) { [255; 3] } else { [140; 3] };
        let (bracket, alignment) = bracket(&[(-2.0, &|_, _| [90; 3]), (0.0, &at)]);
        let curve = ResponseCurve::srgb();
        let layers = layers(&bracket, &alignment, &curve, Weight::Hat).unwrap();
        let window = layers[1].window(&(0..SIZE.0), &(0..SIZE.1)).unwrap();
        let mut shares = Vec::new();
        let mut tile = Tile::new();
        for y in 0..SIZE.1 {
            tile.read(&layers[1], &window, 0..SIZE.0, y..y + 1);
            let beside = tile.row(0).unwrap().beside;
            shares.extend((0..SIZE.0).map(|x| (x, y, beside[x])));
        }
        assert_eq!(shares.len(), SIZE.0 * SIZE.1);
        for (x, y, share) in shares {
            let near = x.abs_diff(4) <= 1 && y.abs_diff(3) <= 1;
            assert_eq!(share, u8::from(near), "{x} {y}");
        }
    }
}
