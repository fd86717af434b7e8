//! Bitmaps of a frame, warped to the reference's grid by a shift and a rotation.
//!
//! In: a frame's bitmaps and a [`Motion`]. Out: the bitmaps on the reference's grid. Other motions with the same
//! rotation can then be tried by shifting these bitmaps, without warping again. Cost: each word is copied in pieces, at
//! some 10 ns each: one piece without rotation, about 7 (at most 11) at 5 degrees; nothing is allocated. Source: the
//! thesis that hdralign is based on rotates the picture pixel by pixel (chapter 4); the decomposition of a rotated row
//! into pieces of the frame's rows is new here.

use crate::align::bitmaps::ThresholdBitmaps;
use crate::align::bitmaps::bitmap::bits_from;

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

impl Motion {
    /// Returns the motion that first moves each pixel `right` columns to the right and `down` rows down, and then
    /// applies `self`.
    pub fn beside(&self, right: i64, down: i64) -> Motion {
        let (s, c) = (libm::sin(self.angle), libm::cos(self.angle));
        let (right, down) = (right as f64, down as f64);
        Motion { dx: self.dx + c * right - s * down, dy: self.dy + s * right + c * down, ..*self }
    }
}

/// How a position between pixels is rounded to a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rounding {
    /// To the nearest pixel.
    Nearest,
    /// To one of the two neighbouring pixels, more often to the nearer one. Which one follows from a fixed sequence of
    /// numbers, one for each row and each word of 64 pixels. Counts of differing pixels then vary smoothly with the
    /// motion. With rounding to the nearest pixel they have steps, which would bias every result towards motions by
    /// whole pixels.
    Dithered,
}

/// The positions of a grid's pixels under a motion. They are in fixed point with 32 fractional bits, so sums are exact
/// and the same on every machine.
struct PixelMap {
    rounding: Rounding,
    /// `cos` and `sin`: the number of columns and rows by which the position moves for one pixel to the right.
    cos: i64,
    sin: i64,
    /// Number of pixels to the right by which the row changes by 2^-32, the unit of the fixed point; 0 if the row does
    /// not change within the width.
    run: f64,
    /// `origin`: the position to which pixel (0, 0) maps. `down`: the displacement of the position for one pixel down.
    origin: (i64, i64),
    down: (i64, i64),
}

/// The first pixel of a row of the grid is mapped to a position (column and row, in fixed point). The block is this
/// position plus the rounding offset of one word of 64 pixels of the row.
struct Block(i64, i64);

const ONE: f64 = 4_294_967_296.0;

impl PixelMap {
    fn new(motion: &Motion, rounding: Rounding, width: usize, height: usize) -> Self {
        let (cx, cy) = ((width - 1) as f64 / 2.0, (height - 1) as f64 / 2.0);
        let (sin, cos) = (libm::sin(motion.angle), libm::cos(motion.angle));
        let fixed = |v: f64| (v * ONE) as i64;
        let origin = (fixed(cx + motion.dx - cos * cx + sin * cy), fixed(cy + motion.dy - sin * cx - cos * cy));
        let run = if (sin * width as f64).abs() < 1e-6 { 0.0 } else { 1.0 / (sin.abs() * ONE) };
        let sin = if run == 0.0 { 0 } else { fixed(sin) };
        PixelMap { rounding, cos: fixed(cos), sin, run, origin, down: (-sin, fixed(cos)) }
    }

    /// Returns the block for word `word` (64 pixels) of row `y`.
    #[inline]
    fn block(&self, word: usize, y: usize) -> Block {
        // These offsets are added to a position before it is truncated. The multiples (modulo 1) of powers of the
        // plastic number, of sqrt 2 and of the golden ratio are evenly distributed along rows, along columns and over
        // the plane.
        let (half_x, half_y) = match self.rounding {
            Rounding::Nearest => (1 << 31, 1 << 31),
            Rounding::Dithered => {
                let (w, y) = (word as u32, y as u32);
                let spread = |a: u32, b: u32| i64::from(w.wrapping_mul(a).wrapping_add(y.wrapping_mul(b)));
                (spread(0x9E37_79B9, 0xC13F_A9A9), spread(0x6A09_E667, 0x91E1_0DA5))
            }
        };
        let y = y as i64;
        Block(self.origin.0 + y * self.down.0 + half_x, self.origin.1 + y * self.down.1 + half_y)
    }

    /// Finds a run of pixels from `x`, up to `end` at most, that map to adjacent pixels of one row of the frame.
    /// Returns the end of the run, and the column and row to which pixel `x` maps.
    #[inline]
    fn piece(&self, block: &Block, x: i64, end: i64) -> (i64, i64, i64) {
        let column = |x: i64| (block.0 + x * self.cos) >> 32;
        let (down, first) = (block.1 + x * self.sin, column(x));
        let row = down >> 32;
        let mut piece_end = end;
        if self.sin != 0 {
            let fraction = down & 0xFFFF_FFFF;
            let left = if self.sin > 0 { (1 << 32) - fraction } else { fraction + 1 };
            piece_end = end.min(x + 1 + (left as f64 * self.run) as i64);
            // Rounding may make the run one pixel too long.
            if (block.1 + (piece_end - 1) * self.sin) >> 32 != row {
                piece_end -= 1;
            }
        }
        while column(piece_end - 1) - first != piece_end - 1 - x {
            piece_end = (x + piece_end) / 2;
        }
        (piece_end, first, row)
    }
}

impl ThresholdBitmaps {
    /// Warps these bitmaps to the grid of `onto`, which has the same size.
    ///
    /// `motion` maps pixel (x, y) of `onto` to a position, which `rounding` rounds to a pixel of these bitmaps; that
    /// pixel is copied. If it is outside of the bitmaps, pixel (x, y) is excluded. Within a row of `onto`, the row that
    /// is copied from changes only every 1 / sin(angle) pixels. Each piece between such changes is copied by shifting
    /// packed words.
    ///
    /// # Panics
    /// When the sizes differ.
    pub fn warp_onto(&self, motion: &Motion, rounding: Rounding, onto: &mut ThresholdBitmaps) {
        let (width, height) = (self.threshold.width(), self.threshold.height());
        assert_eq!(
            (width, height),
            (onto.threshold.width(), onto.threshold.height()),
            "both sets of bitmaps must have the same width and height"
        );
        let places = PixelMap::new(motion, rounding, width, height);
        for y in 0..height {
            let (rt, re) = (onto.threshold.row_mut(y), onto.exclusion.row_mut(y));
            for (word, (t, e)) in rt[1..].iter_mut().zip(re[1..].iter_mut()).take(width.div_ceil(64)).enumerate() {
                let (mut x, end) = (64 * word as i64, width.min(64 * word + 64) as i64);
                let block = places.block(word, y);
                (*t, *e) = (0, 0);
                while x < end {
                    let (piece_end, column, row) = places.piece(&block, x, end);
                    if let Some(row) = usize::try_from(row).ok().filter(|&r| r < height) {
                        let mask = (u64::MAX << (x & 63)) & (u64::MAX >> (63 - ((piece_end - 1) & 63)));
                        let at = 64 * word as i64 + column - x;
                        *t |= bits_from(self.threshold.row(row), at) & mask;
                        *e |= bits_from(self.exclusion.row(row), at) & mask;
                    }
                    x = piece_end;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::bitmaps::Bitmap;
    use crate::align::bitmaps::bitmap::tests::bitmaps;

    /// Returns the pixels of both bitmaps of `frame`, warped pixel by pixel: (x, y) of the result is pixel `place(x,
    /// y)` of the frame.
    fn warped_by_pixel(frame: &ThresholdBitmaps, place: impl Fn(i64, i64) -> (i64, i64)) -> Vec<(bool, bool)> {
        let (width, height) = (frame.threshold.width() as i64, frame.threshold.height() as i64);
        let pixel = |i: i64| {
            let (u, v) = place(i % width, i / width);
            let inside = u >= 0 && v >= 0 && u < width && v < height;
            let at = |m: &Bitmap| inside && m.get(u as usize, v as usize);
            (at(&frame.threshold), at(&frame.exclusion))
        };
        (0..width * height).map(pixel).collect()
    }

    #[test]
    fn laying_by_pieces_is_laying_pixel_by_pixel() {
        let (width, height) = (230, 170);
        let frame = bitmaps(3, width, height);
        let mut warped = bitmaps(4, width, height);
        let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        for angle in [0.0f64, 1e-12, 0.002, -0.01, 0.04, -0.0873, 0.7] {
            for (dx, dy) in [(0.0, 0.0), (3.25, -2.5), (-40.3, 11.0), (1000.0, 0.0), (0.0, -400.7)] {
                for rounding in [Rounding::Nearest, Rounding::Dithered] {
                    let motion = Motion { dx, dy, angle };
                    frame.warp_onto(&motion, rounding, &mut warped);
                    let places = PixelMap::new(&motion, rounding, width, height);
                    let slow = warped_by_pixel(&frame, |x, y| {
                        let block = places.block(x as usize / 64, y as usize);
                        ((block.0 + x * places.cos) >> 32, (block.1 + x * places.sin) >> 32)
                    });
                    let at = |i: usize| (i % width, i / width);
                    for (i, slow) in slow.into_iter().enumerate() {
                        let (x, y) = at(i);
                        assert_eq!(
                            (warped.threshold.get(x, y), warped.exclusion.get(x, y)),
                            slow,
                            "{motion:?} at {x}, {y}"
                        );
                    }
                    // The positions differ from the exact ones under the motion by at most half a pixel (nearest) or a
                    // pixel (dithered), plus a rounding error of 2^-32 px for each pixel along the row.
                    let (s, c) = (angle.sin(), angle.cos());
                    let most = if rounding == Rounding::Nearest { 0.5 } else { 1.0 } + 1e-6;
                    for (x, y) in [(0, 0), (229, 0), (100, 169)] {
                        let block = places.block(x as usize / 64, y as usize);
                        let (px, py) = (x as f64 - cx, y as f64 - cy);
                        let off_x = ((block.0 + x * places.cos) >> 32) as f64 - (cx + dx + c * px - s * py);
                        let off_y = ((block.1 + x * places.sin) >> 32) as f64 - (cy + dy + s * px + c * py);
                        assert!(off_x.abs() <= most && off_y.abs() <= most, "{motion:?} at {x}, {y}: {off_x} {off_y}");
                    }
                }
            }
        }
    }

    #[test]
    fn dithering_is_even() {
        // A shift of 0.3 px is rounded to 1 px in three of ten words, and to 0 px in the other words, in any part of
        // the picture.
        let places = PixelMap::new(&Motion { dx: 0.3, dy: 0.3, angle: 0.0 }, Rounding::Dithered, 64 * 36, 1700);
        let share = |words: std::ops::Range<usize>, rows: std::ops::Range<usize>| {
            let all: Vec<(i64, i64)> = rows
                .flat_map(|y| words.clone().map(move |w| (w, y)))
                .map(|(w, y)| {
                    let Block(u, v) = places.block(w, y);
                    (u >> 32, (v >> 32) - y as i64)
                })
                .collect();
            let sum = all.iter().fold((0, 0), |s, p| (s.0 + p.0, s.1 + p.1));
            [sum.0 as f64 / all.len() as f64, sum.1 as f64 / all.len() as f64]
        };
        // Among n consecutive elements of such a sequence, the fraction of any value differs from an even distribution
        // by a few times ln n / n.
        for (words, rows, most) in
            [(0..36, 0..1700, 0.002), (5..6, 0..1700, 0.01), (0..36, 700..702, 0.06), (8..16, 300..310, 0.06)]
        {
            let [x, y] = share(words.clone(), rows.clone());
            assert!((x - 0.3).abs() < most && (y - 0.3).abs() < most, "{words:?} {rows:?}: {x} {y}");
        }
    }
}
