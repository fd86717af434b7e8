//! Statistics: order statistics and robust weights that every stage uses.
//!
//! In: values in any order. Out: the value of a rank, the median; weights. Cost: some ns a value. Source: Hoare 1961, "Algorithm 65: find";
//! Beaton & Tukey 1974, "The fitting of power series" (the biweight).

use std::cmp::Ordering;

/// Numbers with a total order.
pub trait Ordered: Copy {
    /// As `total_cmp` of the standard library.
    fn order(&self, other: &Self) -> Ordering;
}

impl Ordered for f32 {
    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

impl Ordered for f64 {
    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

/// The value of `rank` of `values`, the smallest being of rank 0; none where there are not so many.
pub fn of_rank<T: Ordered>(values: impl IntoIterator<Item = T>, rank: usize) -> Option<T> {
    let mut values: Vec<T> = values.into_iter().collect();
    (rank < values.len()).then(|| *values.select_nth_unstable_by(rank, T::order).1)
}

/// The median of `values`, of an even number the upper one; none of none.
pub fn median<T: Ordered>(values: impl IntoIterator<Item = T>) -> Option<T> {
    let values: Vec<T> = values.into_iter().collect();
    let middle = values.len() / 2;
    of_rank(values, middle)
}

/// Standard deviations of a normal distribution in its median absolute deviation: the normal quantile of 3/4.
pub const MEDIAN_DEVIATION: f64 = 0.6745;

/// Tukey's biweight of a residual that is `t` of the reach: 1 for 0, 0 from 1 on and of what is not a number.
pub fn biweight(t: f64) -> f64 {
    let inside = (1.0 - t * t).max(0.0);
    inside * inside
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_those_of_the_sorted_values() {
        let values: Vec<f64> = (0..101u32).map(|i| f64::from(i * 37 % 101)).collect();
        assert!((0..101).all(|rank| of_rank(values.iter().copied(), rank) == Some(rank as f64)));
        assert_eq!((of_rank(values, 101), of_rank::<f32>([], 0)), (None, None));
        assert_eq!(
            (median([3.0, 1.0, 2.0]), median([4.0f32, 1.0, 3.0, 2.0]), median::<f64>([])),
            (Some(2.0), Some(3.0), None)
        );
        // -0 before 0, and what is not a number last.
        assert_eq!(of_rank([f32::NAN, 0.0, -0.0], 0).map(f32::to_bits), Some((-0.0f32).to_bits()));
    }

    #[test]
    fn biweight_falls_from_one_to_zero() {
        assert_eq!([0.0, 0.5, 1.0, 7.0, f64::NAN].map(biweight), [1.0, 0.5625, 0.0, 0.0, 0.0]);
    }
}
