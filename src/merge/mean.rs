//! The weighted mean of the pixels of a row over the frames, as it grows.
//!
//! In: what each frame has of the row, by rising exposure. Out: radiance, and how many pixels every frame saw clipped or black. Cost: two dozen
//! multiplications a pixel, channel and frame, eight pixels at a time. The equation and its letters are at the head of [`merge`](super).

use super::FLOOR;
use super::layer::{CLIPPED, COLUMNS, Fill, Layer, Meaning, PAINTED, Row, Taken, Tile};
use crate::simd::{at_least, at_most};

/// e: the extra weight of the shortest and the longest exposure, at the code it decides, as a share of the frame's say; that of one code
/// on the hat. A smaller one would let a second frame that noise lifts from black by one code outvote the longest; a larger one would
/// trust clipped codes.
const DECIDE: f32 = 1.0 / 127.5;
/// What keeps the sum of weights above zero where the shortest exposure is black and the longest clips.
const LEAST: f32 = 1e-6;

/// Codes of the brightest channel from which on a frame may clip here, and from which on it does where shorter ones say so: JPEG pulls a
/// clipped channel down by some codes, one of colour by many, but not all three. A frame far below its top shows something else: what moves.
const MAY_CLIP: (f32, f32) = (205.0, 235.0);

/// A value for each channel and pixel of a row.
pub(super) type Channels = [[f32; COLUMNS]; 3];

/// The means of a row's pixels so far.
pub(super) struct Means {
    sum: Channels,
    pub(super) weight: Channels,
    /// The radiance that the scene has here at least, as shorter exposures vouch for it.
    vouched: Channels,
    /// e X / dt and e of the longest exposure so far.
    longest_sum: Channels,
    pub(super) longest_weight: Channels,
    /// 1 where a frame was believed; where some channel is at its top code even in the shortest exposure; where all channels are at code 0
    /// even in the longest.
    is_seen: [u32; COLUMNS],
    is_clipped: [u32; COLUMNS],
    is_black: [u32; COLUMNS],
    frame: View,
}

/// What the means take of one frame.
struct View {
    meanings: [[Meaning; COLUMNS]; 3],
    /// How far the frame is believed, 0..=1.
    trust: [f32; COLUMNS],
    /// Trust, times the share beside clipped pixels, times v.
    v: [f32; COLUMNS],
    /// The least that u can be.
    below_top: [f32; COLUMNS],
    /// 1 where this is the first frame that is believed, and 1 where it is believed.
    is_first: [u32; COLUMNS],
    is_believed: [u32; COLUMNS],
    /// What radiance is multiplied by, and its inverse.
    gain: [f32; COLUMNS],
    inverse: [f32; COLUMNS],
}

/// Pixels whose radiance is but a bound.
#[derive(Clone, Copy, Default)]
pub(super) struct Bounds {
    /// Of which some channel is at its top code even in the shortest exposure.
    pub clipped: usize,
    /// Of which all channels are at code 0 even in the longest.
    pub black: usize,
}

impl Means {
    pub fn new() -> Self {
        let (none, zero, flags) = ([[0.0; COLUMNS]; 3], [0.0; COLUMNS], [0; COLUMNS]);
        Means {
            sum: none,
            weight: none,
            vouched: none,
            longest_sum: none,
            longest_weight: none,
            is_seen: flags,
            is_clipped: flags,
            is_black: flags,
            frame: View {
                meanings: [[[0.0; 4]; COLUMNS]; 3],
                trust: zero,
                v: zero,
                below_top: zero,
                is_first: flags,
                is_believed: flags,
                gain: zero,
                inverse: zero,
            },
        }
    }

    #[inline(always)]
    pub fn clear(&mut self) {
        for of in [&mut self.sum, &mut self.weight, &mut self.vouched, &mut self.longest_sum, &mut self.longest_weight]
        {
            *of = [[0.0; COLUMNS]; 3];
        }
        (self.is_seen, self.is_clipped, self.is_black) = ([0; COLUMNS], [0; COLUMNS], [0; COLUMNS]);
    }

    /// The means of row `y` over the frames that fill `fill`, or over those whose place is known: layers, tiles, and how each is taken.
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

    /// Adds a frame's row, as it is `taken`. A pixel that the frame does not reach, or that is painted, is one that is not believed.
    #[inline(always)]
    pub fn add(&mut self, layer: &Layer, row: &Row, Taken { kept, gain }: Taken) {
        let View { meanings, trust, v, below_top, is_first, is_believed, gain: factor, inverse } = &mut self.frame;
        let gain = &gain[..gain.len().min(COLUMNS)];
        factor[..gain.len()].copy_from_slice(gain);
        factor[gain.len()..].fill(1.0);
        for x in 0..COLUMNS {
            inverse[x] = 1.0 / factor[x];
        }
        let kept = &kept[..kept.len().min(COLUMNS)];
        trust[..kept.len()].copy_from_slice(kept);
        trust[kept.len()..].fill(1.0);
        let [red, green, blue] = row.codes;
        for x in 0..COLUMNS {
            let top = at_least(at_least(red[x], green[x]), blue[x]);
            let is_shown = red[x] >= 0.0 && row.beside[x] & PAINTED == 0;
            let t = if is_shown { trust[x] } else { 0.0 };
            let is_beside = row.beside[x] & CLIPPED != 0;
            trust[x] = t;
            v[x] = t * (if is_beside { layer.ringing } else { 1.0 }) * layer.guard(top);
            // Beside clipped pixels, between which and their darker neighbours a moved frame is interpolated, any code may be a clipped one's.
            let below = at_most(at_least((MAY_CLIP.1 - top) * (1.0 / (MAY_CLIP.1 - MAY_CLIP.0)), 0.0), 1.0);
            below_top[x] = if is_beside { 0.0 } else { below };
            // A frame that is not believed does not decide.
            let believed = u32::from(t >= 0.5);
            let first = believed & (self.is_seen[x] ^ 1);
            is_believed[x] = believed;
            is_first[x] = first;
            self.is_seen[x] |= believed;
            self.is_clipped[x] |= first & u32::from(top >= 254.5);
            self.is_black[x] = if believed != 0 { u32::from(top <= 0.5) } else { self.is_black[x] };
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
            let (sum, weight, vouched) = (&mut self.sum[c], &mut self.weight[c], &mut self.vouched[c]);
            let (longest_sum, longest_weight) = (&mut self.longest_sum[c], &mut self.longest_weight[c]);
            for x in 0..COLUMNS {
                let [radiance, trusted, vouches, _] = meanings[x];
                let radiance = radiance * factor[x];
                let unclipped = at_most(at_least((sure - vouched[x] * inverse[x]) * slope, below_top[x]), 1.0);
                let w = trusted * v[x] * unclipped;
                vouched[x] = at_least(trust[x] * vouches * factor[x], vouched[x]);
                let (say, code) = (trust[x] * layer.say, codes[x] / 255.0);
                let e = say * (DECIDE * code + LEAST);
                let e = if is_first[x] != 0 { e } else { 0.0 };
                sum[x] = (sum[x] + w * radiance) + e * radiance;
                weight[x] = (weight[x] + w) + e;
                // Where it clips it does not decide what is dark, whatever its code.
                let e = say * unclipped * (DECIDE * (1.0 - code) + LEAST);
                longest_sum[x] = if is_believed[x] != 0 { e * radiance } else { longest_sum[x] };
                longest_weight[x] = if is_believed[x] != 0 { e } else { longest_weight[x] };
            }
        }
    }

    /// The radiance of the row, [`FLOOR`] where no frame covers it.
    #[inline(always)]
    pub fn radiance(&self, radiance: &mut Channels) {
        for c in 0..3 {
            for x in 0..COLUMNS {
                let mean = (self.sum[c][x] + self.longest_sum[c][x]) / (self.weight[c][x] + self.longest_weight[c][x]);
                radiance[c][x] = if self.is_seen[x] != 0 { mean.max(FLOOR) } else { FLOOR };
            }
        }
    }

    /// Whether a frame is believed at pixel `x`.
    #[inline(always)]
    pub fn is_seen(&self, x: usize) -> bool {
        self.is_seen[x] != 0
    }

    /// Whether the frame that was added last is believed at pixel `x`.
    #[inline(always)]
    pub fn is_last_believed(&self, x: usize) -> bool {
        self.frame.is_believed[x] != 0
    }

    /// What is known of pixel `x` beyond the range of these frames, because `other` ones fill it.
    pub fn fill(&mut self, x: usize, fill: Fill, other: &Means) {
        match fill {
            Fill::Clipped => self.is_clipped[x] &= other.is_clipped[x],
            Fill::Black => self.is_black[x] &= other.is_black[x],
        }
    }

    /// Of the first `width` pixels those whose radiance is but a bound.
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

    /// The exposure in stops, and the codes of a pixel's column and row.
    type Seen<'a> = (f64, &'a dyn Fn(usize, usize) -> [u8; 3]);

    /// A still bracket of these frames; the reference is the second.
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

    /// The equation at the head of the stage, word for word, of a place without clipped neighbours.
    fn textbook(codes: &[[u8; 3]], times: &[f64], channel: usize) -> f64 {
        let curve = ResponseCurve::srgb();
        let x = |code: u8| f64::from(curve.exposures(channel)[usize::from(code)]);
        let say = |j: usize| (times[j] / times[times.len() - 1]).sqrt();
        let (mut sum, mut weight, mut vouched) = (0.0, 0.0, 0.0f64);
        for (j, codes) in codes.iter().enumerate() {
            let z = codes[channel];
            let top = f64::from(codes.iter().copied().max().unwrap());
            let v = ((255.0 - top) / 16.0).clamp(0.25, 1.0);
            let (begins, sure) = (x(230) / times[j], x(250) / times[j]);
            let below_top = ((235.0 - top) / 30.0).clamp(0.0, 1.0);
            let u = ((sure - vouched) / (sure - begins)).clamp(0.0, 1.0).max(below_top);
            let mut w = hat(f64::from(z)) * say(j) * v * u;
            if j == 0 {
                w += say(j) * (f64::from(z) / 255.0 / 127.5 + 1e-6);
            }
            if j == times.len() - 1 {
                w += say(j) * u * ((1.0 - f64::from(z) / 255.0) / 127.5 + 1e-6);
            }
            sum += w * x(z) / times[j];
            weight += w;
            vouched = vouched.max(if z > 6 { x(z - 6) / times[j] } else { 0.0 });
        }
        sum / weight
    }

    #[test]
    fn every_pixel_is_what_the_equation_says() {
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
                // A dozen operations on floats of 24 bits; u takes the difference of nearly equal numbers.
                assert!((f64::from(pixel[c]) / expected - 1.0).abs() < 2e-4, "{i} {c}: {} for {expected}", pixel[c]);
            }
        }
    }

    #[test]
    fn what_shorter_frames_vouch_for_clips_the_longer_whatever_its_code() {
        // At code 200 two stops down, the longer is beyond its top; JPEG has pulled its codes down.
        let pulled = |_: usize, _: usize| [235, 220, 240];
        let (bracket, alignment) = bracket(&[(-2.0, &|_, _| [200; 3]), (0.0, &pulled)]);
        let truth = 4.0 * ResponseCurve::srgb().exposures(0)[200];
        for weight in [Weight::Hat, Weight::Gaussian, Weight::Plateau, Weight::MannPicard, Weight::Noise] {
            let pixel = merged(&bracket, &alignment, weight)[31];
            assert!((pixel[1] / truth - 1.0).abs() < 1e-3, "{weight:?} {pixel:?} for {truth}");
        }
        // Without that, the plain mean is far off.
        assert!(merged(&bracket, &alignment, Weight::Uniform)[31][1] < 0.8 * truth);
    }

    #[test]
    fn what_glints_in_a_shorter_frame_does_not_silence_a_longer_one_that_shows_none() {
        let of = |glint: u8| {
            let (bracket, alignment) = bracket(&[(-2.0, &|_, _| [glint; 3]), (0.0, &|_, _| [120; 3])]);
            merged(&bracket, &alignment, Weight::Hat)[31][1]
        };
        // The weights of the two alone decide: the longer has twice the say, and its code is nearer to the middle.
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
            // The reference alone, there and in the next column; behind that as if there were no paint.
            for column in 0..=4 {
                let found = with[row * SIZE.0 + column][2];
                assert!((found / x(100) - 1.0).abs() < 1e-3, "{row} {column}: {found} for {}", x(100));
            }
            assert_eq!(with[row * SIZE.0 + 5..(row + 1) * SIZE.0], without[row * SIZE.0 + 5..(row + 1) * SIZE.0]);
        }
        // Where all frames have it, the reference is believed.
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
