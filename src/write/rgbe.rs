//! RGBE: three mantissas of 8 bits and an exponent in common, and the run lengths in which scanlines of it are kept.
//!
//! In: linear RGB or the bytes of a scanline. Out: the other. Cost: a few ns a pixel. Source: G. Ward, "Real Pixels", Graphics Gems II
//! (1991), section II.5, and the Radiance sources, `src/common/color.c` (`setcolr`, `colr_color`, `fwritecolrs`, `freadcolrs`).

/// A pixel: the mantissas of red, green and blue, and the exponent + 128.
pub(crate) type Rgbe = [u8; 4];

/// The largest number there is: mantissa 255 at exponent byte 255.
const MAX: f32 = 255.0 / 256.0 * f32::from_bits((127 + 127) << 23);

/// The pixel as Ward's `setcolr` makes it, by truncation, and how many of its components were beyond what it holds.
/// Negative components and NaN become 0, as do all of a pixel whose largest is not above 1e-32.
pub(super) fn encode([r, g, b]: [f32; 3]) -> (Rgbe, u64) {
    let over = [r, g, b].iter().filter(|c| c.is_nan() || **c > MAX).count() as u64;
    // Of NaN no comparison holds.
    let [r, g, b] = [r, g, b].map(|c| if c > 0.0 { c.min(MAX) } else { 0.0 });
    let d = r.max(g).max(b);
    if f64::from(d) <= 1e-32 {
        return ([0; 4], over);
    }
    // frexp: d = m 2^e with m in [1/2, 1). The exponent field of a float is biased by 127 for m in [1, 2). Above 1e-32 it is normal.
    let e = (d.to_bits() >> 23) as i32 - 126;
    let scale = pow2(8 - e);
    let [r, g, b] = [r, g, b].map(|c| (c * scale) as u8);
    ([r, g, b, (e + 128) as u8], over)
}

/// The middle of the interval that truncation brought to this pixel: (mantissa + 1/2) 2^(exponent - 128 - 8); 0 at exponent 0.
pub(crate) fn decode([r, g, b, e]: Rgbe) -> [f32; 3] {
    if e == 0 {
        return [0.0; 3];
    }
    let scale = pow2(i32::from(e) - 128);
    [r, g, b].map(|m| (f32::from(m) + 0.5) * (1.0 / 256.0) * scale)
}

/// 2^n, for n from -149 to 127: exact.
fn pow2(n: i32) -> f32 {
    if n >= -126 { f32::from_bits(((n + 127) as u32) << 23) } else { f32::from_bits(1 << (n + 149)) }
}

/// Widths that can be run-length encoded: others are written flat.
pub(super) const RLE_WIDTHS: std::ops::RangeInclusive<usize> = 8..=32767;

/// The shortest run that is worth its two bytes.
const MIN_RUN: usize = 4;

/// Appends the scanline `row`, by components and run-length encoded where the width allows, flat otherwise.
/// A flat pixel is never mistaken for the mark of an encoded line, (2, 2, ..), nor of a repetition, (1, 1, 1, n): the largest mantissa
/// of a pixel that is not 0 is 128 at least.
pub(super) fn put_row(row: &[Rgbe], out: &mut Vec<u8>) {
    if !RLE_WIDTHS.contains(&row.len()) {
        out.extend_from_slice(row.as_flattened());
        return;
    }
    out.extend_from_slice(&[2, 2, (row.len() >> 8) as u8, row.len() as u8]);
    let mut plane = vec![0; row.len()];
    for component in 0..4 {
        for (to, from) in plane.iter_mut().zip(row) {
            *to = from[component];
        }
        put_runs(&plane, out);
    }
}

/// `fwritecolrs` for one component: runs of 4 to 127 equal bytes as (128 + n, byte), the rest as (n, n bytes) with n up to 128.
fn put_runs(bytes: &[u8], out: &mut Vec<u8>) {
    let len = bytes.len();
    let run_at = |at: usize| {
        let most = 127.min(len - at);
        bytes[at..at + most].iter().take_while(|&&b| b == bytes[at]).count()
    };
    let mut at = 0;
    while at < len {
        // The next run that is long enough begins at `start`, and is `run` long; 0 when there is none.
        let (mut start, mut run) = (at, 0);
        while start < len {
            let n = run_at(start);
            if n >= MIN_RUN {
                run = n;
                break;
            }
            start += n;
        }
        // Two or three bytes before it that are all the same are cheaper as a short run.
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

/// Takes the next scanline off the front of `bytes`, encoded in the new or the old way, or flat. `None` when it is damaged or cut short.
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

/// Flat pixels, and (1, 1, 1, n) for n more of the one before; such marks in a row count in steps of 256.
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

    /// `setcolr` as it is printed: frexp in doubles.
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

    /// Truncation leaves a component within the interval [m, m + 1) of its mantissa; the middle is at most half a step away, and a
    /// step is at most 1/128 of the largest component.
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
            put_runs(bytes, &mut out);
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
                put_row(&row, &mut bytes);
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
