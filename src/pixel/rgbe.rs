//! RGBE: three 8-bit mantissas with a shared exponent, and the run-length coding of scanlines.
//!
//! In: linear RGB or the bytes of a scanline. Out: the other of the two. Cost: a few ns a pixel. Source: G. Ward, "Real
//! Pixels", Graphics Gems II (1991), section II.5, and the Radiance sources, `src/common/color.c` (`setcolr`,
//! `colr_color`, `fwritecolrs`, `freadcolrs`).

use crate::simd::{Loops, floor32, integer32, vectorised};

/// A pixel: the mantissas of red, green and blue, and the exponent + 128.
pub(crate) type Rgbe = [u8; 4];

/// The largest value of the encoding: mantissa 255 at exponent byte 255.
const MAX: f32 = 255.0 / 256.0 * f32::from_bits((127 + 127) << 23);

/// The largest float that is not above 1e-32.
const SMALLEST: f32 = {
    let nearest = 1e-32f32;
    if nearest as f64 <= 1e-32 { nearest } else { f32::from_bits(nearest.to_bits() - 1) }
};

/// Encodes a pixel as Ward's `setcolr` does, by truncation; also returns the number of components that were too large
/// or NaN.
///
/// Negative components and NaN become 0. A pixel whose largest component is not above 1e-32 becomes black.
#[inline(always)]
pub(crate) fn encode(rgb: [f32; 3]) -> (Rgbe, u32) {
    // All cases are computed and one is selected, so that loops can be vectorised. Comparisons with NaN are false.
    let over = rgb.map(|c| u32::from(c > MAX || c.is_nan()));
    let [r, g, b] = rgb.map(|c| if c < MAX { c } else { MAX }).map(|c| if c > 0.0 { c } else { 0.0 });
    let [r, g, b] = [(rgb[0], r), (rgb[1], g), (rgb[2], b)].map(|(given, c)| if given.is_nan() { 0.0 } else { c });
    let larger = |a: f32, b: f32| if a > b { a } else { b };
    let d = larger(larger(r, g), b);
    // As in frexp, d = m 2^e with m in [1/2, 1). The exponent field of a float is biased by 127 for m in [1, 2), so it
    // is e + 126. Floats above 1e-32 are normal.
    let biased = d.to_bits() >> 23;
    // 2^(8 - e), which is normal for e from -106 to 127; for smaller e the pixel is black.
    let scale = f32::from_bits((261u32.wrapping_sub(biased) & 0xff) << 23);
    let is_black = d <= SMALLEST;
    let mantissa = |c: f32| if is_black { 0 } else { integer32(floor32(c * scale)) as u8 };
    let exponent = if is_black { 0 } else { (biased + 2) as u8 };
    ([mantissa(r), mantissa(g), mantissa(b), exponent], over[0] + over[1] + over[2])
}

/// Decodes a pixel to the centre of the interval that [`encode`] truncates to this pixel: (mantissa + 1/2) 2^(exponent
/// byte - 136); 0 for exponent byte 0.
pub(crate) fn decode([r, g, b, e]: Rgbe) -> [f32; 3] {
    if e == 0 {
        return [0.0; 3];
    }
    let scale = pow2(i32::from(e) - 128);
    [r, g, b].map(|m| (f32::from(m) + 0.5) * (1.0 / 256.0) * scale)
}

/// Returns 2^n, exactly, for n from -149 to 127.
fn pow2(n: i32) -> f32 {
    if n >= -126 { f32::from_bits(((n + 127) as u32) << 23) } else { f32::from_bits(1 << (n + 149)) }
}

/// Widths that can be run-length encoded; scanlines of other widths are written flat (uncompressed).
pub(crate) const RLE_WIDTHS: std::ops::RangeInclusive<usize> = 8..=32767;

/// Minimum number of equal bytes that are encoded as a run.
const MIN_RUN: usize = 4;

/// Encodes scanlines, and keeps the buffers for the next scanline.
#[derive(Debug, Default)]
pub(crate) struct Scanline {
    /// The bytes of a scanline by component: all of red, then of green, of blue, and the exponents.
    components: Vec<u8>,
    /// For each byte of a component, 1 if [`MIN_RUN`] equal bytes begin there, else 0.
    begins: Vec<u8>,
}

impl Scanline {
    /// Appends the scanline of `pixels`: by components and run-length encoded if the width allows it, otherwise flat
    /// (uncompressed). Returns the number of values that were too large or NaN. A flat pixel cannot be confused with
    /// the start of an encoded scanline, (2, 2, ..), or with a repetition, (1, 1, 1, n), because the largest mantissa
    /// of a pixel other than black is at least 128.
    pub(crate) fn put(&mut self, pixels: &[[f32; 3]], out: &mut Vec<u8>) -> u64 {
        let width = pixels.len();
        self.components.resize(4 * width, 0);
        let over = vectorised(Encode { pixels, components: &mut self.components });
        self.put_components(width, out);
        over
    }

    fn put_components(&mut self, width: usize, out: &mut Vec<u8>) {
        if !RLE_WIDTHS.contains(&width) {
            out.extend((0..width).flat_map(|x| [0, 1, 2, 3].map(|c| self.components[c * width + x])));
            return;
        }
        out.extend_from_slice(&[2, 2, (width >> 8) as u8, width as u8]);
        for component in self.components.chunks_exact(width) {
            put_runs(component, &mut self.begins, out);
        }
    }
}

/// Encodes pixels to components.
struct Encode<'a> {
    pixels: &'a [[f32; 3]],
    components: &'a mut [u8],
}

/// Number of pixels whose channels are separated at a time, so that their encoding can be vectorised.
const LANES: usize = 64;

impl Loops for Encode<'_> {
    type Output = u64;

    #[inline(always)]
    fn run(self) -> u64 {
        let width = self.pixels.len();
        let (r, rest) = self.components.split_at_mut(width);
        let (g, rest) = rest.split_at_mut(width);
        let (b, e) = rest.split_at_mut(width);
        let mut over = 0;
        let to = r.chunks_mut(LANES).zip(g.chunks_mut(LANES)).zip(b.chunks_mut(LANES)).zip(e.chunks_mut(LANES));
        for (pixels, (((r, g), b), e)) in self.pixels.chunks(LANES).zip(to) {
            let mut channels = [[0.0f32; LANES]; 3];
            for (i, p) in pixels.iter().enumerate() {
                (channels[0][i], channels[1][i], channels[2][i]) = (p[0], p[1], p[2]);
            }
            let mut encoded = [[0u8; LANES]; 4];
            let mut beyond = 0;
            for i in 0..LANES {
                let ([r, g, b, e], count) = encode([channels[0][i], channels[1][i], channels[2][i]]);
                (encoded[0][i], encoded[1][i], encoded[2][i], encoded[3][i]) = (r, g, b, e);
                // Lanes after the last pixel are black, so they do not add to the count.
                beyond += count;
            }
            over += u64::from(beyond);
            for (to, from) in [r, g, b, e].into_iter().zip(&encoded) {
                to.copy_from_slice(&from[..to.len()]);
            }
        }
        over
    }
}

/// Marks every byte that starts four equal bytes.
struct Mark<'a> {
    bytes: &'a [u8],
    begins: &'a mut [u8],
}

impl Loops for Mark<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let n = self.begins.len();
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| &self.bytes[i..i + n]);
        for ((((to, a), b), c), d) in self.begins.iter_mut().zip(a).zip(b).zip(c).zip(d) {
            *to = u8::from((a ^ b) | (b ^ c) | (c ^ d) == 0);
        }
    }
}

/// Returns the first position at or after `at` that is marked in `begins`.
fn next_run(begins: &[u8], at: usize) -> Option<usize> {
    let from = begins.get(at..)?;
    let (eights, rest) = from.as_chunks::<8>();
    match eights.iter().position(|eight| u64::from_le_bytes(*eight) != 0) {
        Some(i) => Some(at + 8 * i + (u64::from_le_bytes(eights[i]).trailing_zeros() / 8) as usize),
        None => rest.iter().position(|&mark| mark != 0).map(|i| at + 8 * eights.len() + i),
    }
}

/// Encodes one component as `fwritecolrs` does: a run of n = 4 to 127 equal bytes as the count 128 + n and the byte,
/// and n = 1 to 128 other bytes as the count n and the bytes.
fn put_runs(bytes: &[u8], begins: &mut Vec<u8>, out: &mut Vec<u8>) {
    let len = bytes.len();
    begins.resize(len.saturating_sub(MIN_RUN - 1), 0);
    vectorised(Mark { bytes, begins });
    let mut at = 0;
    while at < len {
        // Start and length of the next run of at least [`MIN_RUN`] bytes; the length is 0 when there is none.
        let (start, run) = match next_run(begins, at) {
            Some(start) => (start, bytes[start..].iter().take(127).take_while(|&&b| b == bytes[start]).count()),
            None => (len, 0),
        };
        // If only two or three bytes, all equal, come before that run, they take less space as a short run.
        if (2..MIN_RUN).contains(&(start - at)) && bytes[at..start].iter().all(|&b| b == bytes[at]) {
            out.extend_from_slice(&[128 + (start - at) as u8, bytes[at]]);
            at = start;
        }
        for part in bytes[at..start].chunks(128) {
            out.push(part.len() as u8);
            out.extend_from_slice(part);
        }
        if run > 0 {
            out.extend_from_slice(&[128 + run as u8, bytes[start]]);
        }
        at = start + run;
    }
}

/// Decodes the next scanline from the front of `bytes`: in the new or the old run-length encoding, or flat
/// (uncompressed). `None` when the scanline is damaged or truncated.
pub(crate) fn take_row(bytes: &mut &[u8], row: &mut [Rgbe]) -> Option<()> {
    let width = row.len();
    if let Some(&[2, 2, high, low]) = bytes.first_chunk::<4>()
        && RLE_WIDTHS.contains(&width)
        && high < 128
    {
        if usize::from(high) << 8 | usize::from(low) != width {
            return None;
        }
        *bytes = &bytes[4..];
        return take_components(bytes, row);
    }
    take_old(bytes, row)
}

fn take_components(bytes: &mut &[u8], row: &mut [Rgbe]) -> Option<()> {
    for component in 0..4 {
        let mut at = 0;
        while at < row.len() {
            let (&code, rest) = bytes.split_first()?;
            let n = usize::from(if code > 128 { code - 128 } else { code });
            let to = row.get_mut(at..at + n).filter(|to| !to.is_empty())?;
            let taken = if code > 128 { 1 } else { n };
            let (from, rest) = rest.split_at_checked(taken)?;
            for (i, pixel) in to.iter_mut().enumerate() {
                pixel[component] = if code > 128 { from[0] } else { from[i] };
            }
            *bytes = rest;
            at += n;
        }
    }
    Some(())
}

/// Decodes uncompressed pixels and the repetitions of the old encoding: (1, 1, 1, n) repeats the previous pixel n
/// times. The counts of consecutive repetitions are the digits of one number to base 256, lowest digit first.
fn take_old(bytes: &mut &[u8], row: &mut [Rgbe]) -> Option<()> {
    let (mut at, mut shift) = (0, 0);
    while at < row.len() {
        let (&pixel, rest) = bytes.split_first_chunk::<4>()?;
        *bytes = rest;
        if pixel[..3] == [1, 1, 1] {
            let n = usize::from(pixel[3]).checked_shl(shift)?;
            let last = *row.get(at.checked_sub(1)?)?;
            row.get_mut(at..at.checked_add(n)?)?.fill(last);
            at += n;
            shift += 8;
        } else {
            row[at] = pixel;
            at += 1;
            shift = 0;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ward's `setcolr` as printed, with frexp in doubles.
    fn setcolr(rgb: [f32; 3]) -> Rgbe {
        let d = f64::from(rgb[0].max(rgb[1]).max(rgb[2]));
        if d <= 1e-32 {
            return [0; 4];
        }
        let (m, e) = libm::frexp(d);
        let scale = m * 256.0 / d;
        let [r, g, b] = rgb.map(|c| if c > 0.0 { (f64::from(c) * scale) as u8 } else { 0 });
        [r, g, b, (e + 128) as u8]
    }

    /// The runs of `fwritecolrs` as printed.
    fn fwritecolrs(bytes: &[u8]) -> Vec<u8> {
        let (mut out, mut at, len) = (Vec::new(), 0, bytes.len());
        while at < len {
            let (mut begin, mut count) = (at, 0);
            while begin < len {
                count = 1;
                while count < 127 && begin + count < len && bytes[begin + count] == bytes[begin] {
                    count += 1;
                }
                if count >= MIN_RUN {
                    break;
                }
                begin += count;
            }
            if begin - at > 1 && begin - at < MIN_RUN && bytes[at..begin].iter().all(|&b| b == bytes[at]) {
                out.extend([128 + (begin - at) as u8, bytes[at]]);
                at = begin;
            }
            for part in bytes[at..begin].chunks(128) {
                out.push(part.len() as u8);
                out.extend(part);
            }
            at = begin;
            if begin < len && count >= MIN_RUN {
                out.extend([128 + count as u8, bytes[begin]]);
                at += count;
            }
        }
        out
    }

    fn numbers(count: usize) -> impl Iterator<Item = u32> {
        (0..count as u32).map(|i| {
            let mut x = i.wrapping_mul(0x9e37_79b9) ^ 0x5bd1_e995;
            x = (x ^ (x >> 15)).wrapping_mul(0x2c1b_3c6d);
            (x ^ (x >> 12)).wrapping_mul(0x297a_2d39) ^ (x >> 15)
        })
    }

    #[test]
    fn pixels_are_encoded_as_by_setcolr() {
        let mut values: Vec<f32> = numbers(30_000).map(|n| f32::from_bits(n & 0x7fff_ffff)).collect();
        values.retain(|v| *v <= MAX);
        values.extend([0.0, 1e-32, 1.1e-32, 1.0, 0.99999994, 2.0, -1.0, MAX, 0.5]);
        for (i, &v) in values.iter().enumerate() {
            let rgb = [v, v * 0.37, values[(i * 7) % values.len()].min(v)];
            assert_eq!(encode(rgb), (setcolr(rgb), 0), "{rgb:?}");
        }
    }

    /// The test encodes complete rows, also with widths that are not a multiple of [`LANES`].
    #[test]
    fn rows_are_their_pixels() {
        let mut scanline = Scanline::default();
        for width in [1, 63, 64, 65, 1000] {
            let pixels: Vec<[f32; 3]> = numbers(width)
                .map(|n| {
                    [n, n.wrapping_mul(3), n.rotate_left(9)]
                        .map(|n| if n % 50 == 0 { f32::NAN } else { f32::from_bits(n) })
                })
                .collect();
            let over = scanline.put(&pixels, &mut Vec::new());
            let each: Vec<(Rgbe, u32)> = pixels.iter().map(|&p| encode(p)).collect();
            assert_eq!(over, each.iter().map(|(_, over)| u64::from(*over)).sum::<u64>());
            for (x, (pixel, _)) in each.iter().enumerate() {
                assert_eq!([0, 1, 2, 3].map(|c| scanline.components[c * width + x]), *pixel);
            }
        }
    }

    /// The encoder truncates, so a component is in [m, m + 1), where m is its mantissa. The decoder returns the
    /// centre of this interval, at most half a step away, and a step is at most 1/128 of the largest component.
    #[test]
    fn decoding_is_within_half_a_step() {
        for n in numbers(20_000) {
            let v = f32::from_bits(0x2000_0000 + n % 0x4000_0000);
            let (rgbe, _) = encode([v, v / 3.0, v / 1000.0]);
            for (have, want) in decode(rgbe).into_iter().zip([v, v / 3.0, v / 1000.0]) {
                assert!((have - want).abs() <= v / 256.0 * 1.000001, "{have} for {want}");
            }
        }
        assert_eq!(decode([128, 0, 0, 129]), [128.5 / 128.0, 0.5 / 128.0, 0.5 / 128.0]);
        assert_eq!(decode([0; 4]), [0.0; 3]);
    }

    #[test]
    fn too_bright_is_clamped_and_counted() {
        assert_eq!(encode([f32::MAX, f32::INFINITY, 1.0]), ([255, 255, 0, 255], 2));
        assert_eq!(encode([f32::NAN, 1.0, 1.0]), ([0, 128, 128, 129], 1));
        assert_eq!(encode([MAX; 3]), ([255, 255, 255, 255], 0));
    }

    #[test]
    fn runs_are_cut_at_127_and_literals_at_128() {
        let encoded = |bytes: &[u8]| {
            let mut out = Vec::new();
            put_runs(bytes, &mut Vec::new(), &mut out);
            out
        };
        assert_eq!(encoded(&[7; 127]), [255, 7]);
        assert_eq!(encoded(&[7; 128]), [255, 7, 1, 7]);
        assert_eq!(encoded(&[7; 129]), [255, 7, 130, 7]);
        assert_eq!(encoded(&[7; 131]), [255, 7, 132, 7]);
        let ramp: Vec<u8> = (0..=255).collect();
        assert_eq!(encoded(&ramp[..129])[..2], [128, 0]);
        assert_eq!(encoded(&ramp[..129])[129..], [1, 128]);
        // A short run before a long one, then single bytes.
        assert_eq!(encoded(&[1, 1, 2, 2, 2, 2, 3, 4]), [130, 1, 132, 2, 2, 3, 4]);
    }

    #[test]
    fn rows_of_every_make_come_back() {
        let mut scanline = Scanline::default();
        for width in [1, 7, 8, 9, 127, 128, 129, 300, 32767, 32768] {
            for kind in 0..4u32 {
                let row: Vec<Rgbe> = (0..width as u32)
                    .zip(numbers(width))
                    .map(|(x, n)| match kind {
                        0 => [200; 4],
                        1 => [(n >> 8) as u8 | 128, (n >> 16) as u8, n as u8, 130],
                        2 => [128 + (x / 127) as u8 % 100, (x / 128) as u8, (x / 129) as u8, 1],
                        _ => [130, (n % 13 / 12) as u8, (n % 3 / 2) as u8, (x / 2) as u8],
                    })
                    .collect();
                let mut bytes = Vec::new();
                let components = [0, 1, 2, 3].map(|c| row.iter().map(|p| p[c]).collect::<Vec<u8>>()).concat();
                scanline.components = components.clone();
                scanline.put_components(width, &mut bytes);
                if RLE_WIDTHS.contains(&width) {
                    let plain: Vec<u8> = components.chunks(width).flat_map(fwritecolrs).collect();
                    assert!(bytes[4..] == plain, "width {width}, kind {kind}");
                }
                if !RLE_WIDTHS.contains(&width) {
                    assert_eq!(bytes.len(), 4 * width);
                }
                let mut back = vec![[0; 4]; width];
                let mut rest = &bytes[..];
                take_row(&mut rest, &mut back).expect("a whole row");
                assert!(rest.is_empty() && back == row, "width {width}, kind {kind}");
                assert_eq!(take_row(&mut &bytes[..bytes.len() - 1], &mut back), None);
            }
        }
    }

    #[test]
    fn the_old_repetitions_are_read() {
        let bytes = [[9, 8, 7, 128], [1, 1, 1, 2], [1, 1, 1, 1], [5, 5, 5, 5]].concat();
        let mut row = vec![[0; 4]; 1 + 2 + 256 + 1];
        take_row(&mut &bytes[..], &mut row).expect("a whole row");
        assert!(row[..259].iter().all(|p| *p == [9, 8, 7, 128]) && row[259] == [5; 4]);
        assert_eq!(take_row(&mut &bytes[4..], &mut row), None, "nothing to repeat");
    }
}
