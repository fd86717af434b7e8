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

/// Codes of the brightest channel from which on a frame may clip here, and from which on it does where shorter ones say so: JPEG pulls a
/// clipped channel down by some codes, one of colour by many, but not all three. A frame far below its top shows something else: what moves.
const MAY_CLIP: (f32, f32) = (205.0, 235.0);

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
        // Beside clipped pixels, between which and their darker neighbours a moved frame is interpolated, any code may be a clipped one's.
        let beside = share < 1.0;
        let below_top =
            if beside { 0.0 } else { ((MAY_CLIP.1 - top) * (1.0 / (MAY_CLIP.1 - MAY_CLIP.0))).clamp(0.0, 1.0) };
        let mut unclipped = [0.0; 3];
        for c in 0..3 {
            let (sure, slope) = layer.clips[c];
            unclipped[c] = ((sure - self.vouched[c]) * slope).clamp(below_top, 1.0);
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

#[cfg(test)]
mod tests {
    use super::super::layer::layers;
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
    fn beside_clipped_pixels_a_frame_counts_half() {
        let at = |x: usize, y: usize| if (x, y) == (4, 3) { [255; 3] } else { [140; 3] };
        let (bracket, alignment) = bracket(&[(-2.0, &|_, _| [90; 3]), (0.0, &at)]);
        let curve = ResponseCurve::srgb();
        let layers = layers(&bracket, &alignment, &curve, Weight::Hat).unwrap();
        let window = layers[1].window(&(0..SIZE.0), &(0..SIZE.1)).unwrap();
        let mut shares = Vec::new();
        for y in 0..SIZE.1 {
            let strip = layers[1].strip(&window, 0..SIZE.0, y..y + 1);
            layers[1].row(&strip, 0, SIZE.0, |x, _, share| shares.push((x, y, share)));
        }
        assert_eq!(shares.len(), SIZE.0 * SIZE.1);
        for (x, y, share) in shares {
            let near = x.abs_diff(4) <= 1 && y.abs_diff(3) <= 1;
            assert_eq!(share, if near { 0.5 } else { 1.0 }, "{x} {y}");
        }
    }
}
