//! Vector instructions: selects code for the instruction set of the processor.
//!
//! In: [`Loops`] over slices. Out: their result. The code that computes it is compiled for the widest vectors of this
//! processor (AVX-512 or AVX2 on x86-64, NEON on 64-bit ARM), or is scalar. Cost: a few nanoseconds per call, so a call
//! should process at least a row.
//!
//! There is one code path ([`Arm`]) for each instruction set. The code paths differ only in speed: Rust neither
//! reorders sums of floats nor fuses multiplications with additions, so all give the same bytes. With [`choose`], tests
//! and benches compare them.

use pulp::{Arch, NullaryFnOnce};
use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::atomic::{AtomicU8, Ordering};

/// An instruction set for which loops are compiled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Arm {
    /// The widest instruction set that this processor supports.
    #[default]
    Native,
    /// AVX-512 of x86 (x86-64-v4).
    Avx512,
    /// AVX2 of x86 (x86-64-v3); its fused multiply-add is not used.
    Avx2,
    /// NEON of 64-bit ARM.
    Neon,
    /// The instructions that every processor of the target supports.
    Scalar,
}

impl Arm {
    /// All code paths, in the order of their discriminants; this processor may not support all of them (see
    /// [`choose`]).
    pub const ALL: [Arm; 5] = [Arm::Native, Arm::Avx512, Arm::Avx2, Arm::Neon, Arm::Scalar];

    /// Returns this code path as a value of the crate `pulp`, or `None` if this processor does not support it.
    #[inline]
    fn arch(self) -> Option<Arch> {
        match self {
            Arm::Native => Some(Arch::new()),
            Arm::Scalar => Some(Arch::Scalar),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Arm::Avx512 => pulp::x86::V4::try_new().map(Arch::V4),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Arm::Avx2 => pulp::x86::V3::try_new().map(Arch::V3),
            #[cfg(target_arch = "aarch64")]
            Arm::Neon => pulp::aarch64::Neon::try_new().map(Arch::Neon),
            #[allow(unreachable_patterns)]
            _ => None,
        }
    }
}

/// Index of the selected code path in [`Arm::ALL`].
static CHOSEN: AtomicU8 = AtomicU8::new(Arm::Native as u8);

/// Selects `arm` for the whole process if this processor supports it; returns whether it does.
///
/// The results do not depend on the code path. Only tests and benches need to select one.
#[must_use = "if false is returned, the processor does not support this code path, and another one remains selected"]
pub fn choose(arm: Arm) -> bool {
    let is_supported = arm.arch().is_some();
    if is_supported {
        CHOSEN.store(arm as u8, Ordering::Relaxed);
    }
    is_supported
}

/// Loops over slices that benefit from vector instructions.
pub trait Loops {
    /// The result.
    type Output;

    /// Runs the loops.
    ///
    /// Mark this function, and all functions that it calls, with `#[inline(always)]`: only inlined code is compiled
    /// with the instructions of the selected code path (long closures are not inlined). Do not start parallel work
    /// inside.
    fn run(self) -> Self::Output;
}

/// Runs `loops` on the selected code path and returns their result.
#[inline]
pub fn vectorised<L: Loops>(loops: L) -> L::Output {
    let chosen = Arm::ALL[usize::from(CHOSEN.load(Ordering::Relaxed))];
    // The code path was supported when it was selected.
    chosen.arch().unwrap_or_default().dispatch(Native(loops))
}

/// The function that pulp calls with the processor's features enabled.
struct Native<L>(L);

impl<L: Loops> NullaryFnOnce for Native<L> {
    type Output = L::Output;

    #[inline(always)]
    fn call(self) -> L::Output {
        self.0.run()
    }
}

/// All floats at or above this limit are integers: 2^23 for `f32`, 2^52 for `f64`. If a smaller positive number is
/// added to the limit, the sum is rounded to an integer, and the low bits of the sum are the number, rounded. This
/// addition replaces Rust's saturating casts, for which there are no vector instructions.
const WHOLE: (f32, f64) = (8_388_608.0, 4_503_599_627_370_496.0);

/// Returns `value` rounded down; `value` must be in 0..2^22.
#[inline(always)]
pub fn floor32(value: f32) -> f32 {
    let near = (value + WHOLE.0) - WHOLE.0;
    if near > value { near - 1.0 } else { near }
}

/// Converts `whole`, which must be an integer in 0..2^23, to `u32`.
#[inline(always)]
pub fn integer32(whole: f32) -> u32 {
    (whole + WHOLE.0).to_bits() & 0x7f_ffff
}

/// Returns `value` rounded down; `value` must be in 0..2^51.
#[inline(always)]
pub fn floor64(value: f64) -> f64 {
    let near = (value + WHOLE.1) - WHOLE.1;
    if near > value { near - 1.0 } else { near }
}

/// Converts `whole`, which must be an integer in 0..2^52, to `u64`.
#[inline(always)]
pub fn integer64(whole: f64) -> u64 {
    (whole + WHOLE.1).to_bits() & ((1 << 52) - 1)
}

/// Returns the larger of the two values, in one vector instruction. The result is NaN if `value` is NaN; it is `value`
/// if only `least` is NaN.
#[inline(always)]
pub fn at_least(value: f32, least: f32) -> f32 {
    if value < least { least } else { value }
}

/// Returns the smaller of the two values; NaN is treated as by [`at_least`].
#[inline(always)]
pub fn at_most(value: f32, most: f32) -> f32 {
    if value > most { most } else { value }
}

/// Returns log2 of `value`, which must be positive, normal and finite. The error is at most 2e-7, or 2e-7 of the result
/// if that is larger.
#[inline(always)]
pub fn log2(value: f32) -> f32 {
    // value = 2^e m with m between sqrt(1/2) and sqrt(2), so that the series of artanh below is short.
    let bits = value.to_bits().wrapping_sub(ROOT_OF_HALF) as i32;
    let e = bits >> 23;
    let m = f32::from_bits(value.to_bits().wrapping_sub((e << 23) as u32));
    // ln m = 2 (t + t^3/3 + t^5/5 + ..), t = (m - 1) / (m + 1), |t| < 0.172: the truncation error is below 4e-8.
    let t = (m - 1.0) / (m + 1.0);
    let t2 = t * t;
    let series = 1.0 + t2 * (1.0 / 3.0 + t2 * (1.0 / 5.0 + t2 * (1.0 / 7.0)));
    e as f32 + (2.0 * std::f32::consts::LOG2_E) * (t * series)
}

/// sqrt(1/2), as bits.
const ROOT_OF_HALF: u32 = 0x3f35_04f3;

/// Returns 2 to the power of `value`, which must be in -126..=127, with a relative error of at most 3e-7.
#[inline(always)]
pub fn exp2(value: f32) -> f32 {
    // 2^value = 2^e 2^f with an integer e and |f| <= 1/2, so that the series of the exponential is short. `biased` is e
    // plus 127, the exponent as a float stores it.
    let biased = floor32(value + 127.5);
    let x = (value - (biased - 127.0)) * std::f32::consts::LN_2;
    // The series of the exponential up to the sixth power of x. As |x| < 0.347, the truncation error is below 1.3e-7.
    let high = 1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0 + x * (1.0 / 720.0)));
    let series = 1.0 + x * (1.0 + x * (0.5 + x * high));
    f32::from_bits(integer32(biased) << 23) * series
}

/// Returns atan2 with an error of at most 2e-4 rad (0.01 degrees).
#[inline(always)]
pub fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ax < ay { (ax, ay) } else { (ay, ax) };
    // The divisor is at least the smallest normal number, which avoids 0 / 0.
    let a = low / if high > f32::MIN_POSITIVE { high } else { f32::MIN_POSITIVE };
    let s = a * a;
    // This odd polynomial is the minimax approximation of atan on 0..=1.
    let r = ((-0.046_496_473 * s + 0.159_314_22) * s - 0.327_622_76) * s * a + a;
    let r = if ay > ax { FRAC_PI_2 - r } else { r };
    let r = if x < 0.0 { PI - r } else { r };
    if y < 0.0 { -r } else { r }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Polynomial<'a>(&'a [f32]);

    impl Loops for Polynomial<'_> {
        type Output = Vec<u32>;

        #[inline(always)]
        fn run(self) -> Vec<u32> {
            self.0.iter().map(|&x| ((x * 0.7 + 0.1) * x + x.sqrt() / 3.0).to_bits()).collect()
        }
    }

    #[test]
    fn all_arms_give_the_same_bits() {
        let values: Vec<f32> = (0..1003).map(|i| 1.0 / (i as f32 + 0.3)).collect();
        let textbook = Polynomial(&values).run();
        let here = Arm::ALL.into_iter().filter(|&arm| choose(arm)).inspect(|arm| {
            assert_eq!(vectorised(Polynomial(&values)), textbook, "{arm:?}");
        });
        assert!(here.count() >= 2, "the native arm and the scalar one");
        assert!(choose(Arm::default()));
    }

    #[test]
    fn whole_numbers_are_those_of_the_casts() {
        for i in 0..200_000u32 {
            let v = i as f32 * 20.971_51;
            assert_eq!((floor32(v), integer32(floor32(v))), (v.floor(), v.floor() as u32));
            let w = f64::from(v) * 701.3;
            assert_eq!((floor64(w), integer64(floor64(w))), (w.floor(), w.floor() as u64));
        }
        assert_eq!(
            (floor32(0.999_999_94), floor32(4_194_303.5), integer32(8_388_607.0)),
            (0.0, 4_194_303.0, 8_388_607)
        );
        assert_eq!(
            (at_least(1.0, 2.0), at_most(1.0, 2.0), at_least(3.0, 2.0), at_most(3.0, 2.0)),
            (2.0, 1.0, 3.0, 2.0)
        );
    }

    #[test]
    fn logarithms_are_those_of_the_library() {
        let values = (0..200_000).map(|i| f32::from_bits(0x0080_0000 + i * 10_600)).filter(|v| v.is_finite());
        for value in values.chain([1.0, 2.0, 0.5, 1.0f32.next_down(), f32::MIN_POSITIVE, f32::MAX]) {
            let exact = libm::log2(f64::from(value));
            assert!((f64::from(log2(value)) - exact).abs() <= 2e-7 * exact.abs().max(1.0), "{value}");
        }
        assert_eq!([1.0, 2.0, 0.25].map(log2), [0.0, 1.0, -2.0]);
    }

    #[test]
    fn powers_of_two_are_those_of_the_library() {
        for i in -126_000..=127_000 {
            let value = i as f32 / 1000.0;
            let exact = libm::exp2(f64::from(value));
            assert!((f64::from(exp2(value)) / exact - 1.0).abs() <= 3e-7, "{value}");
        }
        assert_eq!([0.0, 1.0, -126.0, 127.0].map(exp2), [1.0, 2.0, f32::MIN_POSITIVE, 2.0f32.powi(127)]);
    }

    #[test]
    fn the_angle_is_that_of_the_platform() {
        for i in 0..3600 {
            let angle = (i as f32 - 1799.5) / 1800.0 * PI;
            let (y, x) = (7.0 * angle.sin(), 7.0 * angle.cos());
            assert!((atan2(y, x) - y.atan2(x)).abs() < 2e-4, "{angle}");
        }
        assert_eq!(atan2(0.0, 0.0), 0.0);
    }
}
