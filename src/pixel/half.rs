//! Half floats (16 bits); values beyond the largest half float are clamped to it instead of becoming infinite.
//!
//! In: pixels. Out: planes of the nearest half floats, or of the low and high words of the floats. Cost: under 1 ns a
//! value. Source: IEEE 754-2008, sections 3.6 and 4.3.1. The `half` crate rounds in the same way, but turns values
//! beyond the largest half float into infinity, and small values into 0; the tests compare with it.

use crate::simd::{Loops, vectorised};

/// The largest half float.
pub(crate) const HALF_MAX: f32 = 65504.0;

/// The bits of [`HALF_MAX`] as a float.
const MAX_BITS: u32 = HALF_MAX.to_bits();

/// Returns the bits of the half float nearest to `v`, ties to even (IEEE 754-2008, 4.3.1).
///
/// Values beyond the largest half float, in magnitude, become the largest. Values other than 0 below the smallest
/// become the smallest, so that only black is 0. NaN becomes 0.
#[inline(always)]
pub(crate) fn half_bits(v: f32) -> u16 {
    let bits = v.to_bits();
    let sign = (bits >> 16) & 0x8000;
    let size = bits & 0x7fff_ffff;
    // All cases are computed and one is selected, so that loops can be vectorised.
    // 2^-14 and above, normal numbers: rebias the exponent by 127 - 15 and round off 13 bits of the mantissa.
    let rebiased = size.wrapping_sub(112 << 23);
    let normal = rebiased.wrapping_add(0xfff + ((rebiased >> 13) & 1)) >> 13;
    // Subnormal numbers, in units of 2^-24: the sum of 1/2 and a float below 2^-14 has the number of units in its last
    // bits, rounded to nearest even.
    let units = (f32::from_bits(size) + 0.5).to_bits().wrapping_sub(0.5f32.to_bits());
    let small = units.max(u32::from(size > 0));
    let finite = if size >= 0x3880_0000 { normal } else { small };
    let clamped = if size >= MAX_BITS { 0x7bff } else { finite };
    if size > 0x7f80_0000 { 0 } else { (sign | clamped) as u16 }
}

/// See [`planes_of_halves`].
struct Halves<'a> {
    pixels: &'a [[f32; 3]],
    planes: &'a mut [u16],
}

impl Loops for Halves<'_> {
    type Output = u64;

    #[inline(always)]
    fn run(self) -> u64 {
        let size = self.pixels.len();
        let (b, rest) = self.planes.split_at_mut(size);
        let (g, r) = rest.split_at_mut(size);
        let mut beyond = 0;
        // Parts of 1024 pixels stay in the cache, and the count of too large values in a part fits a u32.
        let parts = self.pixels.chunks(1024).zip(b.chunks_mut(1024)).zip(g.chunks_mut(1024)).zip(r.chunks_mut(1024));
        for (((pixels, b), g), r) in parts {
            let mut over = 0u32;
            let values = pixels.as_flattened();
            let mut halves = [0u16; 3 * 1024];
            let halves = &mut halves[..values.len()];
            for (to, &v) in halves.iter_mut().zip(values) {
                over += u32::from(v.to_bits() & 0x7fff_ffff > MAX_BITS);
                *to = half_bits(v);
            }
            for (((p, b), g), r) in halves.as_chunks::<3>().0.iter().zip(b).zip(g).zip(r) {
                (*r, *g, *b) = (p[0], p[1], p[2]);
            }
            beyond += u64::from(over);
        }
        beyond
    }
}

/// Writes `pixels` as half floats to three planes, one after the other: all B, then G, then R. Returns the number of
/// values that were beyond the largest half float or NaN.
pub(crate) fn planes_of_halves(pixels: &[[f32; 3]], planes: &mut [u16]) -> u64 {
    vectorised(Halves { pixels, planes })
}

/// Writes the floats of `pixels` to six planes: the low 16-bit words of B, the high words of B, then the low and high
/// words of G and of R.
pub(crate) fn planes_of_floats(pixels: &[[f32; 3]], planes: &mut [u16]) {
    vectorised(Floats { pixels, planes });
}

/// See [`planes_of_floats`].
struct Floats<'a> {
    pixels: &'a [[f32; 3]],
    planes: &'a mut [u16],
}

impl Loops for Floats<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let size = self.pixels.len();
        for (channel, planes) in [2, 1, 0].into_iter().zip(self.planes.chunks_exact_mut(2 * size)) {
            let (low, high) = planes.split_at_mut(size);
            for ((p, low), high) in self.pixels.iter().zip(low).zip(high) {
                let bits = p[channel].to_bits();
                (*low, *high) = (bits as u16, (bits >> 16) as u16);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::exr::prelude::f16;

    /// The results are compared with the `half` crate for every half float, every midpoint between two of them, and
    /// the floats next to the midpoint.
    #[test]
    fn halves_are_rounded_by_the_standard() {
        for h in 0..0x7bffu16 {
            let (low, high) = (f16::from_bits(h).to_f32(), f16::from_bits(h + 1).to_f32());
            let middle = (low + high) / 2.0;
            for v in [low, high, middle, middle.next_up(), middle.next_down(), low.next_up()] {
                let want = f16::from_f32(v).to_bits();
                let want = if v > 0.0 { want.max(1) } else { want };
                assert_eq!((half_bits(v), half_bits(-v)), (want, want | 0x8000), "{v}");
            }
        }
        assert_eq!([65504.1, 65520.0, 1e9, f32::INFINITY].map(half_bits), [0x7bff; 4]);
        assert_eq!([-65504.1, -1e9, f32::NEG_INFINITY].map(half_bits), [0xfbff; 3]);
        assert_eq!([f32::from_bits(1), 1e-12, 0.0, f32::NAN].map(half_bits), [1, 1, 0, 0]);
    }

    #[test]
    fn planes_contain_the_values_of_the_pixels() {
        let pixels: Vec<[f32; 3]> =
            (0..2500).map(|i| [i as f32 * 0.37 - 99.0, 65000.0 + i as f32, 1e-7 * i as f32]).collect();
        let size = pixels.len();
        let mut planes = vec![0; 3 * size];
        let beyond = planes_of_halves(&pixels, &mut planes);
        assert_eq!(beyond, 2500 - 505, "65504 and values below are kept");
        let mut floats = vec![0; 6 * size];
        planes_of_floats(&pixels, &mut floats);
        for (i, p) in pixels.iter().enumerate() {
            for c in 0..3 {
                let plane = 2 - c;
                assert_eq!(planes[plane * size + i], half_bits(p[c]));
                let word = |n: usize| u32::from(floats[(2 * plane + n) * size + i]);
                assert_eq!(word(1) << 16 | word(0), p[c].to_bits());
            }
        }
        let not_numbers = [[f32::NAN, f32::INFINITY, -65505.0]];
        assert_eq!(planes_of_halves(&not_numbers, &mut [0; 3]), 3);
    }
}
