//! The wavelet transform of PIZ: sums (stored as means) and differences of neighbours in both directions. The next
//! level transforms the sums in the same way, and so on.
//!
//! In: a plane of 16-bit values. Out: the coefficients in place. Where the column or the row number is odd, they are
//! differences; elsewhere, they are the results of the next level. Cost: 0.5 ns per value. Source: `ImfWav.cpp`
//! (`wav2Encode`, `wenc14`, `wenc16`).
//!
//! The sums of a level are copied to a separate plane for the next level, so that the values that a level combines
//! are next to each other in memory.

use crate::simd::{Loops, vectorised};

/// Transforms `plane` with `width` values per row, none above `highest`; `scratch` is overwritten.
pub(super) fn transform(plane: &mut [u16], width: usize, highest: u16, scratch: &mut Vec<u16>) {
    let height = plane.len() / width;
    // A level needs scratch space of half the size of its plane. The plane of the next level has a quarter of the
    // size, so all levels together need less space than one plane.
    scratch.resize(plane.len().max(scratch.len()), 0);
    if highest < 1 << 14 {
        level::<false>(plane, width, height, scratch);
    } else {
        level::<true>(plane, width, height, scratch);
    }
}

/// Transforms one level and all smaller levels. If `WIDE`, values use all 16 bits, and sums and differences wrap
/// around. Otherwise values have at most 14 bits, so that sums and differences fit.
fn level<const WIDE: bool>(plane: &mut [u16], width: usize, height: usize, scratch: &mut [u16]) {
    if width < 2 || height < 2 {
        return;
    }
    let (columns, rows) = (width / 2, height / 2);
    let (sums, scratch) = scratch.split_at_mut(rows * columns);
    let (across, scratch) = scratch.split_at_mut(rows * columns);
    vectorised(Split::<WIDE> { plane, width, sums, across });
    level::<WIDE>(sums, columns, rows, scratch);
    vectorised(Join::<WIDE> { plane, width, sums, across });
}

/// Returns the mean of two values and their difference.
#[inline(always)]
fn pair<const WIDE: bool>(a: u16, b: u16) -> (u16, u16) {
    if WIDE {
        let a = a ^ 0x8000;
        // This is the mean of `a` and `b`, computed without a 17th bit for the sum.
        let mean = (a & b) + ((a ^ b) >> 1);
        (if a < b { mean ^ 0x8000 } else { mean }, a.wrapping_sub(b))
    } else {
        let sum = (a as i16).wrapping_add(b as i16);
        ((sum >> 1) as u16, a.wrapping_sub(b))
    }
}

/// Transforms each block of 2 x 2 values: writes its sum to `sums`, its horizontal difference to `across`, and the
/// other two differences to the lower row of the block in `plane`.
struct Split<'a, const WIDE: bool> {
    plane: &'a mut [u16],
    width: usize,
    sums: &'a mut [u16],
    across: &'a mut [u16],
}

impl<const WIDE: bool> Loops for Split<'_, WIDE> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.width;
        let columns = width / 2;
        let pairs = self.plane.chunks_exact_mut(2 * width);
        for ((two, sums), across) in
            pairs.zip(self.sums.chunks_exact_mut(columns)).zip(self.across.chunks_exact_mut(columns))
        {
            let (upper, lower) = two.split_at_mut(width);
            let above = upper.as_chunks::<2>().0;
            let below = lower.as_chunks_mut::<2>().0;
            for (((above, below), sum), across) in above.iter().zip(below.iter_mut()).zip(sums).zip(across) {
                let (upper, difference) = pair::<WIDE>(above[0], above[1]);
                let (lower, other) = pair::<WIDE>(below[0], below[1]);
                (*sum, below[0]) = pair::<WIDE>(upper, lower);
                (*across, below[1]) = pair::<WIDE>(difference, other);
            }
            if width % 2 == 1 {
                let end = width - 1;
                (upper[end], lower[end]) = pair::<WIDE>(upper[end], lower[end]);
            }
        }
    }
}

/// Copies `sums` and `across` back to `plane`. If the number of rows is odd, transforms the last row.
struct Join<'a, const WIDE: bool> {
    plane: &'a mut [u16],
    width: usize,
    sums: &'a [u16],
    across: &'a [u16],
}

impl<const WIDE: bool> Loops for Join<'_, WIDE> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.width;
        let columns = width / 2;
        let mut pairs = self.plane.chunks_exact_mut(2 * width);
        let planes = self.sums.chunks_exact(columns).zip(self.across.chunks_exact(columns));
        for (two, (sums, across)) in pairs.by_ref().zip(planes) {
            let upper = two[..2 * columns].as_chunks_mut::<2>().0;
            for ((to, &sum), &across) in upper.iter_mut().zip(sums).zip(across) {
                *to = [sum, across];
            }
        }
        for two in pairs.into_remainder().as_chunks_mut::<2>().0 {
            (two[0], two[1]) = pair::<WIDE>(two[0], two[1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The reference implementation: the loops of `wav2Encode`, in place and with strides.
    fn textbook(values: &mut [u16], width: usize, height: usize, wide: bool) {
        let pair = |a: u16, b: u16| {
            if wide {
                let a = (i32::from(a) + 0x8000) & 0xffff;
                let (mut m, d) = ((a + i32::from(b)) >> 1, a - i32::from(b));
                if d < 0 {
                    m = (m + 0x8000) & 0xffff;
                }
                (m as u16, d as u16)
            } else {
                let (a, b) = (i32::from(a as i16), i32::from(b as i16));
                (((a + b) >> 1) as u16, (a - b) as u16)
            }
        };
        let mut p = 1;
        while 2 * p <= width.min(height) {
            let mut on = |i: usize, j: usize| (values[i], values[j]) = pair(values[i], values[j]);
            for y in (0..=height - 2 * p).step_by(2 * p) {
                for x in (0..=width - 2 * p).step_by(2 * p) {
                    let at = y * width + x;
                    let down = at + p * width;
                    on(at, at + p);
                    on(down, down + p);
                    on(at, down);
                    on(at + p, down + p);
                }
                if width & p != 0 {
                    let at = y * width + width / (2 * p) * 2 * p;
                    on(at, at + p * width);
                }
            }
            if height & p != 0 {
                let y = height / (2 * p) * 2 * p;
                for x in (0..=width - 2 * p).step_by(2 * p) {
                    on(y * width + x, y * width + x + p);
                }
            }
            p *= 2;
        }
    }

    #[test]
    fn every_size_is_as_by_the_textbook() {
        let mut scratch = Vec::new();
        for width in (1..40).chain([64, 100, 129]) {
            for height in [1, 2, 3, 5, 8, 17, 31, 32] {
                for highest in [0x3fff, 0xffff] {
                    let value = |i: usize| (i.wrapping_mul(40_503) >> 3) as u16 & highest;
                    let mut ours: Vec<u16> = (0..width * height).map(value).collect();
                    let mut theirs = ours.clone();
                    transform(&mut ours, width, highest, &mut scratch);
                    textbook(&mut theirs, width, height, highest == 0xffff);
                    assert!(ours == theirs, "{width}x{height}");
                }
            }
        }
    }
}
