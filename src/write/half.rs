//! Halves: floats of 16 bits, clamped rather than infinite.
//!
//! In: a float. Out: the bits of the nearest half. Cost: about 1 ns. Source: IEEE 754-2008, sections 3.6 and 4.3.1. The `half` crate
//! rounds the same but overflows to infinity and loses small values to 0; it is the judge in the tests.

/// The largest half.
pub(super) const HALF_MAX: f32 = 65504.0;

/// The bits of the half nearest to `v`, ties to even (IEEE 754-2008, 4.3.1); beyond the largest, the largest; positive values below the
/// smallest, the smallest, so that black stays the only 0; NaN becomes 0.
pub(super) fn half_bits(v: f32) -> u16 {
    let bits = v.to_bits();
    let sign = ((bits >> 16) & 0x8000) as u16;
    let size = bits & 0x7fff_ffff;
    if v.is_nan() {
        0
    } else if size >= 0x477f_e000 {
        // 65504
        sign | 0x7bff
    } else if size >= 0x3880_0000 {
        // 2^-14 and above, the normal halves: rebias the exponent by 127 - 15 and round off 13 bits of the mantissa.
        let rebiased = size - (112 << 23);
        sign | ((rebiased + 0xfff + ((rebiased >> 13) & 1)) >> 13) as u16
    } else {
        // Subnormal: in 2^-24. Adding 1/2 to a float below 2^-14 leaves that in its last bits, rounded to nearest even.
        let units = (f32::from_bits(size) + 0.5).to_bits() - 0.5f32.to_bits();
        sign | units.max(u32::from(size > 0)) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::exr::prelude::f16;

    /// Every half, every middle between two and the floats beside it, against the `half` crate.
    #[test]
    fn halves_are_rounded_as_the_standard_says() {
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
        assert_eq!([f32::from_bits(1), 1e-12, 0.0, f32::NAN].map(half_bits), [1, 1, 0, 0]);
    }
}
