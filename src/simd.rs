//! Vector instructions: the one place where the processor is asked what it has.
//!
//! In: [`Loops`] over plain slices. Out: what they give, computed by code that the compiler made for the widest vectors this processor has
//! (AVX-512 or AVX2 on x86-64, NEON on 64-bit ARM), or by the scalar arm. Cost: a few nanoseconds a call: give it a row or more.
//!
//! The arms differ in nothing but speed: Rust neither reorders sums of floats nor fuses a product with a sum, whatever instructions it may
//! use, so the loops give the same bytes on every arm. [`choose`] lets tests and benches hold them side by side.

use pulp::{Arch, NullaryFnOnce};
use std::sync::atomic::{AtomicBool, Ordering};

/// For which processor loops are run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Arm {
    /// The widest that this processor has.
    #[default]
    Native,
    /// The least that every processor of the target has.
    Scalar,
}

static IS_SCALAR: AtomicBool = AtomicBool::new(false);

/// From now on all of the process runs on `arm`. The results are the same: it is for tests and benches.
pub fn choose(arm: Arm) {
    IS_SCALAR.store(arm == Arm::Scalar, Ordering::Relaxed);
}

/// Loops over plain slices that are worth the widest vectors.
pub trait Loops {
    /// What they give.
    type Output;

    /// Runs them. Mark it, and whatever it calls, `#[inline(always)]`: only what is inlined is compiled for the arm (a closure that is
    /// long is not). Start no parallel work inside.
    fn run(self) -> Self::Output;
}

/// What `loops` give, run on the chosen arm.
#[inline]
pub fn vectorised<L: Loops>(loops: L) -> L::Output {
    if IS_SCALAR.load(Ordering::Relaxed) { loops.run() } else { Arch::new().dispatch(Native(loops)) }
}

/// What pulp calls with the processor's features enabled.
struct Native<L>(L);

impl<L: Loops> NullaryFnOnce for Native<L> {
    type Output = L::Output;

    #[inline(always)]
    fn call(self) -> L::Output {
        self.0.run()
    }
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
    fn both_arms_give_the_same_bits() {
        let values: Vec<f32> = (0..1003).map(|i| 1.0 / (i as f32 + 0.3)).collect();
        let native = vectorised(Polynomial(&values));
        choose(Arm::Scalar);
        let scalar = vectorised(Polynomial(&values));
        choose(Arm::Native);
        assert_eq!(native, scalar);
    }
}
