//! Packed bitmaps, 64 pixels per word.
//!
//! In: grey planes and their threshold zones. Out: threshold and exclusion bitmaps. Cost: two word operations per pixel
//! (they compile to byte-wise SIMD). Source: Ward 2003, section 2.1 and its listing (see
//! [`bitmaps`](crate::align::bitmaps)).

use crate::align::grey::{GreyPyramid, Percentile};
use crate::plane::Plane;
use std::ops::Range;

/// A bitmap with one bit per pixel.
///
/// Each row is padded with zeros to whole words, and has one more zero word at each end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bitmap {
    width: usize,
    height: usize,
    words: Vec<u64>,
}

impl Bitmap {
    fn blank(width: usize, height: usize) -> Self {
        Bitmap { width, height, words: vec![0; (width.div_ceil(64) + 2) * height] }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Whether the pixel at column `x` of row `y` is set.
    pub fn get(&self, x: usize, y: usize) -> bool {
        self.row(y)[1 + x / 64] >> (x % 64) & 1 == 1
    }

    /// Words per row, including the padding word at each end.
    pub(super) fn stride(&self) -> usize {
        self.width.div_ceil(64) + 2
    }

    pub(crate) fn row(&self, y: usize) -> &[u64] {
        let stride = self.stride();
        &self.words[y * stride..(y + 1) * stride]
    }

    pub(crate) fn row_mut(&mut self, y: usize) -> &mut [u64] {
        let stride = self.stride();
        &mut self.words[y * stride..(y + 1) * stride]
    }
}

/// Gathers the lowest bits of eight bytes into one byte: bit i of the result is the lowest bit of byte i. All other
/// bits of the bytes must be 0.
///
/// The constant is the sum of the terms 2^(7 (8 - j)) for j in 0..8. Byte i times term j sets bit 8 i + 7 (8 - j) of
/// the product. This is a different bit for every pair (i, j), so there are no carries. The eight pairs with i = j set
/// the eight bits of the top byte.
#[inline]
fn gather(bytes: [u8; 8]) -> u64 {
    u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56
}

/// Packs 64 pixels into a word. `set` returns 1 for a pixel whose bit is to be set, else 0.
#[inline]
fn pack(pixels: &[u8; 64], set: impl Fn(u8) -> u8) -> u64 {
    let flags = pixels.map(set);
    let (eights, _) = flags.as_chunks::<8>();
    eights.iter().rev().fold(0, |bits, &eight| bits << 8 | gather(eight))
}

/// Returns the 64 bits of a padded row that start at pixel `bit`; bits outside the row are zero.
#[inline]
pub(crate) fn bits_from(row: &[u64], bit: i64) -> u64 {
    // Pixel `bit` is in word `first` of the padded row. If word `first` or the word after it is beyond either end of
    // the row, all needed bits are padding, which is zero.
    let first = usize::try_from((bit >> 6) + 1).unwrap_or(row.len());
    match row.get(first..).and_then(|r| r.first_chunk::<2>()) {
        Some(&[low, high]) => join(low, high, (bit & 63) as u32),
        None => 0,
    }
}

/// Returns the 64 bits that start `offset` (0..64) bits into `low` and continue in `high`.
#[inline(always)]
pub(super) fn join(low: u64, high: u64, offset: u32) -> u64 {
    (low >> offset) | (high << 1) << (63 - offset)
}

/// The threshold between dark and bright, and the grey values around it that are excluded from comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Zone {
    /// The lowest excluded grey value.
    pub low: u8,
    /// The highest grey value that is dark.
    pub threshold: u8,
    /// The highest excluded grey value.
    pub high: u8,
}

impl Zone {
    /// Returns the zone that excludes grey values up to `tolerance` away from `threshold`.
    pub fn about(threshold: u8, tolerance: u8) -> Self {
        Zone { low: threshold.saturating_sub(tolerance), threshold, high: threshold.saturating_add(tolerance) }
    }
}

/// A median threshold bitmap and its exclusion bitmap.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThresholdBitmaps {
    /// Set where the pixel is brighter than the threshold.
    pub threshold: Bitmap,
    /// Set where the pixel is compared: its value is so far from the threshold that noise does not move it to the other
    /// side.
    pub exclusion: Bitmap,
}

/// Words of a threshold bitmap, and the words at the same positions of its exclusion bitmap.
pub(super) type Words<'a> = (&'a [u64], &'a [u64]);

impl ThresholdBitmaps {
    /// Returns the bitmaps of level `i` of `pyramid`, with the threshold at `percentile`.
    pub fn of_level(pyramid: &GreyPyramid, i: usize, percentile: Percentile, exclusion: u8) -> Self {
        Self::new(pyramid.level(i), &Zone::about(pyramid.histogram(i).value_at(percentile), exclusion))
    }

    /// The bitmaps of `plane` for the threshold and exclusion of `zone`.
    pub fn new(plane: &Plane<u8>, zone: &Zone) -> Self {
        let Zone { low, threshold, high } = *zone;
        let (width, height) = (plane.width(), plane.height());
        let mut bitmaps = ThresholdBitmaps::blank(width, height);
        for y in 0..height {
            let (rt, re) = (bitmaps.threshold.row_mut(y), bitmaps.exclusion.row_mut(y));
            let (whole, rest) = plane.row(y).as_chunks::<64>();
            let mut last = [0; 64];
            last[..rest.len()].copy_from_slice(rest);
            let words = rt[1..].iter_mut().zip(re[1..].iter_mut());
            for ((t, e), pixels) in words.zip(whole.iter().chain((!rest.is_empty()).then_some(&last))) {
                *t = pack(pixels, |v| u8::from(v > threshold));
                *e = pack(pixels, |v| u8::from(v < low) | u8::from(v > high));
            }
            if !rest.is_empty() {
                let within = u64::MAX >> (64 - rest.len());
                rt[1 + whole.len()] &= within;
                re[1 + whole.len()] &= within;
            }
        }
        bitmaps
    }

    #[inline(always)]
    pub(super) fn words(&self, range: Range<usize>) -> Words<'_> {
        (&self.threshold.words[range.clone()], &self.exclusion.words[range])
    }

    /// Returns bitmaps in which all pixels are excluded from comparison.
    pub fn blank(width: usize, height: usize) -> Self {
        ThresholdBitmaps { threshold: Bitmap::blank(width, height), exclusion: Bitmap::blank(width, height) }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns a picture of blocks of 7 x 5 pixels with pseudorandom grey values, the same for the same seed.
    pub(crate) fn scene(width: usize, height: usize, seed: usize) -> Plane<u8> {
        Plane::from_rows(width, height, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                let h = (x / 7 + seed).wrapping_mul(0x9E37_79B9) ^ (y / 5).wrapping_mul(0x85EB_CA6B);
                *v = (h.wrapping_mul(0xC2B2_AE35) >> 11) as u8;
            }
        })
    }

    pub(crate) fn bitmaps(seed: usize, width: usize, height: usize) -> ThresholdBitmaps {
        ThresholdBitmaps::new(&scene(width, height, seed), &Zone::about(120, 4))
    }

    #[test]
    fn bits_are_where_the_pixels_are() {
        for (width, threshold, tolerance) in [(131, 99, 4), (64, 0, 0), (200, 255, 9), (3, 250, 20)] {
            let plane = scene(width, 3, 1);
            let bitmaps = ThresholdBitmaps::new(&plane, &Zone::about(threshold, tolerance));
            for y in 0..3 {
                for x in 0..width {
                    let v = plane.at(x, y);
                    assert_eq!(bitmaps.threshold.get(x, y), v > threshold);
                    assert_eq!(
                        bitmaps.exclusion.get(x, y),
                        (i32::from(v) - i32::from(threshold)).abs() > tolerance.into()
                    );
                }
                for bitmap in [&bitmaps.threshold, &bitmaps.exclusion] {
                    let row = bitmap.row(y);
                    let padding =
                        [row[0], row[row.len() - 1], row[row.len() - 2].checked_shr(width as u32 % 64).unwrap_or(0)];
                    assert!(width % 64 == 0 || padding == [0; 3]);
                }
            }
        }
    }
}
