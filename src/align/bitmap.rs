//! Packed bitmaps: 64 pixels to a word, compared by XOR, AND and popcount under a shift and a rotation that is never carried out.
//!
//! In: grey planes and thresholds. Out: bitmaps, and how many of their pixels differ under a motion. Cost: about five word operations
//! for 64 pixels under a shift; the same for each piece of a word that stays in one row under a rotation (1 to 7 pieces up to 5 deg).
//! Nothing is allocated per comparison. Source: Ward, "Fast, Robust Image Registration for Compositing High Dynamic Range
//! Photographs from Hand-Held Exposures", JGT 8(2), 2003, section 2.1 and its listing.

use crate::plane::Plane;

/// One bit a pixel; rows are padded to whole words with zeros, and with a zero word at each end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bitmap {
    width: usize,
    height: usize,
    words: Vec<u64>,
}

impl Bitmap {
    /// The pixels of `plane` for which `set` holds.
    pub fn of(plane: &Plane<u8>, set: impl Fn(u8) -> bool) -> Self {
        let (width, height) = (plane.width(), plane.height());
        let stride = width.div_ceil(64) + 2;
        let mut words = vec![0u64; stride * height];
        for (y, row) in words.chunks_exact_mut(stride).enumerate() {
            for (word, pixels) in row[1..].iter_mut().zip(plane.row(y).chunks(64)) {
                *word = pixels.iter().enumerate().fold(0, |bits, (i, &v)| bits | u64::from(set(v)) << i);
            }
        }
        Bitmap { width, height, words }
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

    /// Words of a row, the padding word at each end among them.
    fn stride(&self) -> usize {
        self.width.div_ceil(64) + 2
    }

    fn row(&self, y: usize) -> &[u64] {
        &self.words[y * self.stride()..(y + 1) * self.stride()]
    }
}

/// The 64 bits of a padded row that begin at pixel `bit`; zero outside the row.
#[inline]
fn bits_from(row: &[u64], bit: i64) -> u64 {
    let (word, offset) = (bit.div_euclid(64) + 1, bit.rem_euclid(64) as u32);
    let at = |i: i64| usize::try_from(i).ok().and_then(|i| row.get(i)).copied().unwrap_or(0);
    join(at(word), at(word + 1), offset)
}

/// The 64 bits that begin `offset` (0..64) bits into `low`.
#[inline]
fn join(low: u64, high: u64, offset: u32) -> u64 {
    (low >> offset) | (high << 1) << (63 - offset)
}

/// A median threshold bitmap and the exclusion bitmap that goes with it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThresholdBitmaps {
    /// Brighter than the threshold.
    pub threshold: Bitmap,
    /// Far enough from the threshold for noise not to decide: these pixels count.
    pub exclusion: Bitmap,
}

impl ThresholdBitmaps {
    /// The bitmaps of `plane`: v > `threshold`, and |v - `threshold`| > `tolerance`.
    pub fn new(plane: &Plane<u8>, threshold: u8, tolerance: u8) -> Self {
        ThresholdBitmaps {
            threshold: Bitmap::of(plane, |v| v > threshold),
            exclusion: Bitmap::of(plane, |v| v.abs_diff(threshold) > tolerance),
        }
    }
}

/// A motion of the picture's pixels, reference -> frame: a rotation about the centre, then a shift.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Shift to the right, in pixels.
    pub dx: f64,
    /// Shift downwards, in pixels.
    pub dy: f64,
    /// Rotation from +x towards +y, in radians.
    pub angle: f64,
}

/// How two pairs of bitmaps compare under a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Difference {
    /// Pixels that differ and count in both.
    pub differing: u64,
    /// Pixels that count in both.
    pub compared: u64,
}

impl Difference {
    /// The share of the compared pixels that differ; 1 where none could be compared.
    pub fn rate(&self) -> f64 {
        if self.compared == 0 { 1.0 } else { self.differing as f64 / self.compared as f64 }
    }

    #[inline]
    fn add(&mut self, threshold: (u64, u64), exclusion: (u64, u64), mask: u64) {
        let counted = exclusion.0 & exclusion.1 & mask;
        self.differing += u64::from(((threshold.0 ^ threshold.1) & counted).count_ones());
        self.compared += u64::from(counted.count_ones());
    }
}

/// The difference when the frame's pixel (x + `dx`, y + `dy`) is held against the reference's (x, y), over the whole overlap.
pub fn difference_shifted(reference: &ThresholdBitmaps, frame: &ThresholdBitmaps, dx: i64, dy: i64) -> Difference {
    let (height, words) = (reference.threshold.height() as i64, reference.threshold.stride() as i64 - 2);
    let (whole, offset) = (dx.div_euclid(64), dx.rem_euclid(64) as u32);
    // Padded indices i + whole and i + whole + 1 must both lie in 0..words + 2, for i in 1..=words.
    let (first, end) = (1.max(-whole), (words + 1).min(words + 1 - whole));
    let mut sum = Difference::default();
    if first >= end {
        return sum;
    }
    let near = first as usize..end as usize;
    let far = (first + whole) as usize..(end + whole) as usize;
    let beyond = far.start + 1..far.end + 1;
    for y in 0.max(-dy)..height.min(height - dy) {
        let (y, v) = (y as usize, (y + dy) as usize);
        let (rt, re) = (&reference.threshold.row(y)[near.clone()], &reference.exclusion.row(y)[near.clone()]);
        let (ft, fe) = (frame.threshold.row(v), frame.exclusion.row(v));
        let (ft_low, ft_high) = (&ft[far.clone()], &ft[beyond.clone()]);
        let (fe_low, fe_high) = (&fe[far.clone()], &fe[beyond.clone()]);
        let (mut differing, mut compared) = (0u64, 0u64);
        for i in 0..rt.len() {
            let counted = re[i] & join(fe_low[i], fe_high[i], offset);
            let differs = (rt[i] ^ join(ft_low[i], ft_high[i], offset)) & counted;
            differing += u64::from(differs.count_ones());
            compared += u64::from(counted.count_ones());
        }
        sum.differing += differing;
        sum.compared += compared;
    }
    sum
}

/// The difference under `motion`, to the nearest pixel, within the circle inscribed in the reference.
///
/// Along a row of the reference the frame's row changes only every 1 / sin(angle) pixels; each piece between is a packed shift.
pub fn difference_in_circle(reference: &ThresholdBitmaps, frame: &ThresholdBitmaps, motion: &Motion) -> Difference {
    let (width, height) = (reference.threshold.width() as i64, reference.threshold.height() as i64);
    let (cx, cy) = ((width - 1) as f64 / 2.0, (height - 1) as f64 / 2.0);
    let radius = width.min(height) as f64 / 2.0;
    let (sin, cos) = (libm::sin(motion.angle), libm::cos(motion.angle));
    let mut sum = Difference::default();
    for y in 0..height {
        let down = y as f64 - cy;
        let half = radius * radius - down * down;
        if half <= 0.0 {
            continue;
        }
        let half = half.sqrt();
        let (left, right) = (((cx - half).ceil() as i64).max(0), ((cx + half).floor() as i64 + 1).min(width));
        // The place of pixel x is (cos x + u0, sin x + v0); half a pixel is added so that floor rounds to the nearest.
        let u0 = cx + motion.dx - cos * cx - sin * down + 0.5;
        let v0 = cy + motion.dy - sin * cx + cos * down + 0.5;
        let (rt, re) = (reference.threshold.row(y as usize), reference.exclusion.row(y as usize));
        let mut x = left;
        while x < right {
            let row = (v0 + sin * x as f64).floor();
            let end = if sin > 0.0 {
                (((row + 1.0 - v0) / sin).ceil().max((x + 1) as f64)).min(right as f64) as i64
            } else if sin < 0.0 {
                (((row - v0) / sin).floor() + 1.0).max((x + 1) as f64).min(right as f64) as i64
            } else {
                right
            };
            if row >= 0.0 && row < height as f64 {
                let (ft, fe) = (frame.threshold.row(row as usize), frame.exclusion.row(row as usize));
                while x < end {
                    let stop = end.min((x / 64 + 1) * 64);
                    let middle = (x + stop) / 2;
                    let shift = (u0 + cos * middle as f64).floor() as i64 - middle;
                    let word = x / 64;
                    let mask = (u64::MAX << (x % 64)) & (u64::MAX >> (63 - (stop - 1) % 64));
                    let at = 64 * word + shift;
                    let i = word as usize + 1;
                    sum.add((rt[i], bits_from(ft, at)), (re[i], bits_from(fe, at)), mask);
                    x = stop;
                }
            }
            x = end;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of several sizes, the same for the same seed.
    fn scene(width: usize, height: usize, seed: usize) -> Plane<u8> {
        Plane::from_rows(width, height, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                let h = (x / 7 + seed).wrapping_mul(0x9E37_79B9) ^ (y / 5).wrapping_mul(0x85EB_CA6B);
                *v = (h.wrapping_mul(0xC2B2_AE35) >> 11) as u8;
            }
        })
    }

    fn bitmaps(seed: usize, width: usize, height: usize) -> ThresholdBitmaps {
        ThresholdBitmaps::new(&scene(width, height, seed), 120, 4)
    }

    fn by_pixel(
        a: &ThresholdBitmaps,
        b: &ThresholdBitmaps,
        place: impl Fn(i64, i64) -> Option<(i64, i64)>,
    ) -> Difference {
        let (width, height) = (a.threshold.width() as i64, a.threshold.height() as i64);
        let mut sum = Difference::default();
        for y in 0..height {
            for x in 0..width {
                let Some((u, v)) = place(x, y) else { continue };
                if u < 0 || v < 0 || u >= width || v >= height {
                    continue;
                }
                let at = |m: &Bitmap, x: i64, y: i64| m.get(x as usize, y as usize);
                if at(&a.exclusion, x, y) && at(&b.exclusion, u, v) {
                    sum.compared += 1;
                    sum.differing += u64::from(at(&a.threshold, x, y) != at(&b.threshold, u, v));
                }
            }
        }
        sum
    }

    #[test]
    fn bits_are_where_the_pixels_are() {
        let plane = scene(131, 3, 1);
        let bitmap = Bitmap::of(&plane, |v| v > 99);
        for y in 0..3 {
            for x in 0..131 {
                assert_eq!(bitmap.get(x, y), plane.at(x, y) > 99);
            }
        }
    }

    #[test]
    fn packed_shifts_count_as_pixel_by_pixel() {
        for (width, height) in [(64, 9), (131, 20), (200, 17), (5, 5)] {
            let (a, b) = (bitmaps(1, width, height), bitmaps(2, width, height));
            for dx in [-300, -131, -65, -64, -63, -7, -1, 0, 1, 3, 62, 63, 64, 65, 128, 130, 199, 400] {
                for dy in [-30, -4, 0, 1, 8, 19, 30] {
                    let slow = by_pixel(&a, &b, |x, y| Some((x + dx, y + dy)));
                    assert_eq!(difference_shifted(&a, &b, dx, dy), slow, "{width}x{height} by {dx}, {dy}");
                }
            }
        }
    }

    #[test]
    fn rotation_by_pieces_counts_as_pixel_by_pixel() {
        let (width, height) = (230, 170);
        let (a, b) = (bitmaps(1, width, height), bitmaps(3, width, height));
        let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        for angle in [0.0f64, 0.002, -0.01, 0.04, -0.0873] {
            for (dx, dy) in [(0.0, 0.0), (3.25, -2.5), (-40.0, 11.0)] {
                let fast = difference_in_circle(&a, &b, &Motion { dx, dy, angle });
                let slow = by_pixel(&a, &b, |x, y| {
                    let (px, py) = (x as f64 - cx, y as f64 - cy);
                    let radius = height.min(width) as f64 / 2.0;
                    let (s, c) = (angle.sin(), angle.cos());
                    let (u, v) = (cx + dx + c * px - s * py, cy + dy + s * px + c * py);
                    (px * px + py * py <= radius * radius)
                        .then_some(((u + 0.5).floor() as i64, (v + 0.5).floor() as i64))
                });
                // A piece takes its column from its middle: with cos(5 deg) = 0.9962 it strays by a pixel in at most
                // 0.0038 * 64 / 2 = 12 % of the cases, and then only where a block ends there (a seventh of the columns).
                let off = fast.differing.abs_diff(slow.differing) as f64 / slow.compared as f64;
                assert!(off < 0.12 / 7.0, "{angle} {dx} {dy}: {fast:?} {slow:?}");
                assert!(fast.compared.abs_diff(slow.compared) as f64 <= 0.01 * slow.compared as f64);
            }
        }
    }
}
