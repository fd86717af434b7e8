//! Lossless JPEG against an encoder that is written as the annexes of T.81 are.

use super::*;
use crate::statistics::random;

/// Lengths of the codes of the categories 0 to 16 of [`encoded`]: some are longer than [`SHORT`].
const LENGTHS: [u32; 17] = [2, 3, 3, 3, 4, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// A number from 0 to 1.
pub(in crate::bracket::raw) fn uniform(seed: u64, i: u64, draw: u64) -> f64 {
    random(seed, i, draw) as f64 / u64::MAX as f64
}

/// How the test encodes samples.
#[derive(Debug, Clone, Copy)]
pub(in crate::bracket::raw) struct Coding {
    pub(in crate::bracket::raw) bits: u32,
    pub(in crate::bracket::raw) components: usize,
    pub(in crate::bracket::raw) predictor: u8,
    /// Rows between restarts; 0 for none.
    pub(in crate::bracket::raw) restart_rows: usize,
}

/// Encodes rows of `width` samples, as the annexes of T.81 are written, sample by sample.
pub(in crate::bracket::raw) fn encoded(values: &[u16], width: usize, coding: Coding) -> Vec<u8> {
    let Coding { bits, components: n, predictor, restart_rows } = coding;
    let height = values.len() / width;
    let mut out = vec![0xFF, 0xD8, 0xFF, 0xC3, 0, (8 + 3 * n) as u8, bits as u8];
    out.extend((height as u16).to_be_bytes());
    out.extend(((width / n) as u16).to_be_bytes());
    out.push(n as u8);
    (0..n).for_each(|c| out.extend([c as u8, 0x11, 0]));
    out.extend([0xFF, 0xC4, 0, 19 + 17, 0]);
    out.extend((1..=16).map(|length| LENGTHS.iter().filter(|&&l| l == length).count() as u8));
    out.extend(0..17u8);
    if restart_rows > 0 {
        out.extend([0xFF, 0xDD, 0, 4]);
        out.extend(((restart_rows * width / n) as u16).to_be_bytes());
    }
    out.extend([0xFF, 0xDA, 0, (6 + 2 * n) as u8, n as u8]);
    (0..n).for_each(|c| out.extend([c as u8, 0]));
    out.extend([predictor, 0, 0]);
    let mut codes = [0u32; 17];
    for i in 1..17 {
        codes[i] = (codes[i - 1] + 1) << (LENGTHS[i] - LENGTHS[i - 1]);
    }
    let (mut held, mut count) = (0u64, 0);
    let mut put = |out: &mut Vec<u8>, value: u32, length: u32| {
        (held, count) = (held << length | u64::from(value), count + length);
        while count >= 8 {
            count -= 8;
            let byte = (held >> count) as u8;
            out.push(byte);
            if byte == 0xFF {
                out.push(0);
            }
        }
        count
    };
    let at = |x: usize, y: usize| i32::from(values[y * width + x]);
    for y in 0..height {
        let is_first = y == 0 || (restart_rows > 0 && y % restart_rows == 0);
        if is_first && y > 0 {
            let left = put(&mut out, 0, 0);
            put(&mut out, (1 << ((8 - left) % 8)) - 1, (8 - left) % 8);
            out.extend([0xFF, 0xD0 + ((y / restart_rows - 1) % 8) as u8]);
        }
        for x in 0..width {
            let prediction = match (x < n, is_first) {
                (true, true) => 1 << (bits - 1),
                (false, true) => at(x - n, y),
                (true, false) => at(x, y - 1),
                (false, false) => {
                    let (a, b, c) = (at(x - n, y), at(x, y - 1), at(x - n, y - 1));
                    [a, b, c, a + b - c, a + ((b - c) >> 1), b + ((a - c) >> 1), (a + b) >> 1]
                        [usize::from(predictor) - 1]
                }
            };
            let difference = (at(x, y) - prediction) as i16;
            let category =
                (16 - i32::from(difference).unsigned_abs().min(1 << 15).leading_zeros().saturating_sub(16)).min(16);
            let category = if difference == 0 { 0 } else { category };
            put(&mut out, codes[category as usize], LENGTHS[category as usize]);
            if (1..16).contains(&category) {
                let value = i32::from(difference) - i32::from(difference < 0);
                put(&mut out, value as u32 & ((1 << category) - 1), category);
            }
        }
    }
    let left = put(&mut out, 0, 0);
    put(&mut out, (1 << ((8 - left) % 8)) - 1, (8 - left) % 8);
    out.extend([0xFF, 0xD9]);
    out
}

/// Smooth values with noise and some extremes.
fn samples(width: usize, height: usize, bits: u32) -> Vec<u16> {
    let most = (1u32 << bits) - 1;
    let value = |i: usize| match uniform(3, i as u64, 0) {
        u if u < 0.01 => 0,
        u if u > 0.99 => most as u16,
        u => ((i % width) as f64 / width as f64 * f64::from(most / 2) + 40.0 * u).min(f64::from(most)) as u16,
    };
    (0..width * height).map(value).collect()
}

#[test]
fn all_predictors_components_and_restarts_are_decoded() {
    for (bits, components, predictor, restart_rows) in
        (1..=7).flat_map(|p| [(12, 1, p, 0), (14, 2, p, 0), (16, 3, p, 3), (8, 4, p, 1)])
    {
        let coding = Coding { bits, components, predictor, restart_rows };
        let (width, height) = (60, 11);
        let values = samples(width, height, bits);
        let decoded = decode(&encoded(&values, width, coding), width * height);
        assert_eq!(decoded, Ok(Samples { width, height, values }), "{coding:?}");
    }
}

#[test]
fn damage_is_an_error_or_gives_other_samples() {
    let coding = Coding { bits: 14, components: 2, predictor: 1, restart_rows: 4 };
    let bytes = encoded(&samples(40, 12, 14), 40, coding);
    for length in 0..bytes.len() - 2 {
        assert!(decode(&bytes[..length], 480).is_err(), "the first {length} bytes of {}", bytes.len());
    }
    for seed in 0..2000 {
        let mut damaged = bytes.clone();
        let at = (uniform(7, seed, 0) * bytes.len() as f64) as usize;
        damaged[at] = (uniform(7, seed, 1) * 256.0) as u8;
        if let Ok(samples) = decode(&damaged, 480) {
            assert_eq!(samples.values.len(), 480);
        }
    }
    assert!(decode(&bytes, 481).is_err_and(|reason| reason.contains("480 samples instead of 481")));
}
