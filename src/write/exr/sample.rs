//! The sample type of an OpenEXR file, half or float, and how well half floats represent the radiance.
//!
//! In: linear RGB by rows. Out: a [`Sample`]. Cost: one pass over the values.

use crate::pixel::half::HALF_MAX;
use crate::simd::{Loops, vectorised};

/// Sample type of an OpenEXR file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Sample {
    /// half, or float if the radiance needs more range or precision.
    #[default]
    Auto,
    /// 16-bit floats: values up to 65504. Values are rounded by at most 1/2048 of the value; values below 0.000062 are
    /// less exact.
    Half,
    /// 32-bit floats: exactly as merged.
    Float,
}

/// Below this value, the step of a half float, 2^-24, is more than 1 % of the value.
const HALF_FINE: f32 = 6e-6;

impl Sample {
    /// Returns the sample type for a radiance map with this `fit`. [`Auto`](Self::Auto) becomes floats if a value is
    /// above 65504, or if more than one value in a thousand is below 6e-6, where rounding to a half float can change
    /// the value by more than 0.5 %. Otherwise it becomes half floats. The other sample types are returned unchanged.
    pub fn settled(self, fit: Fit) -> Sample {
        match self {
            Sample::Auto if fit.over > 0 || fit.fine > fit.values / 1000 => Sample::Float,
            Sample::Auto => Sample::Half,
            given => given,
        }
    }
}

/// Counts of values that show how well half floats represent a radiance map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Fit {
    /// Number of values above the largest half, 65504.
    pub over: u64,
    /// Number of values below 6e-6, for which the steps of a half are coarse.
    pub fine: u64,
    /// Number of all values.
    pub values: u64,
}

impl Fit {
    /// Counts the values of some rows.
    pub fn of(rows: &[[f32; 3]]) -> Fit {
        vectorised(Count(rows.as_flattened()))
    }

    /// Adds the counts of other rows.
    pub fn and(self, other: Fit) -> Fit {
        Fit { over: self.over + other.over, fine: self.fine + other.fine, values: self.values + other.values }
    }
}

struct Count<'a>(&'a [f32]);

impl Loops for Count<'_> {
    type Output = Fit;

    #[inline(always)]
    fn run(self) -> Fit {
        let mut fit = Fit { over: 0, fine: 0, values: self.0.len() as u64 };
        // The counters have 32 bits like the values, so that they fill complete SIMD vectors. They do not overflow
        // for 2^20 values.
        for part in self.0.chunks(1 << 20) {
            let (mut over, mut fine) = (0u32, 0u32);
            for &v in part {
                over += u32::from(v > HALF_MAX);
                fine += u32::from(v < HALF_FINE);
            }
            fit.over += u64::from(over);
            fit.fine += u64::from(fine);
        }
        fit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::Plane;

    #[test]
    fn halves_are_taken_where_they_do() {
        let fit = |picture: &Plane<[f32; 3]>| picture.as_slice().chunks(7).map(Fit::of).fold(Fit::default(), Fit::and);
        let settled = |picture: Plane<[f32; 3]>| Sample::Auto.settled(fit(&picture));
        assert_eq!(settled(Plane::filled(30, 70, [65504.0, 1.0, 1e-5])), Sample::Half);
        assert_eq!(settled(Plane::filled(30, 70, [1.0, 1.0, 5e-6])), Sample::Float);
        let mut sun = Plane::filled(30, 70, [1.0; 3]);
        sun.row_mut(69)[29][1] = 65520.0;
        assert_eq!(settled(sun.clone()), Sample::Float);
        assert_eq!(Sample::Half.settled(fit(&sun)), Sample::Half);
        // A few dark values do not require floats.
        sun.row_mut(69)[29] = [1e-9; 3];
        assert_eq!(settled(sun), Sample::Half);
    }
}
