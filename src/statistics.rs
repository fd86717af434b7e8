//! Order statistics and robust weights, used by all stages.
//!
//! In: values in any order. Out: the value of a given rank, the median, weights, pseudo-random numbers. Cost: a few ns
//! per value. Source: Hoare 1961, "Algorithm 65: find"; Beaton & Tukey 1974, "The fitting of power series" (the
//! biweight).

/// Returns the value with rank `rank` (0 for the smallest) in the total order of floats, or `None` if there are not
/// enough `values`.
pub fn of_rank<T: Copy + Into<f64>>(values: impl IntoIterator<Item = T>, rank: usize) -> Option<T> {
    let mut values: Vec<T> = values.into_iter().collect();
    let order = |a: &T, b: &T| (*a).into().total_cmp(&(*b).into());
    (rank < values.len()).then(|| *values.select_nth_unstable_by(rank, order).1)
}

/// Returns the median of `values`, or `None` if there are no values. If the number of values is even, the median is the
/// upper of the two middle values.
pub fn median<T: Copy + Into<f64>>(values: impl IntoIterator<Item = T>) -> Option<T> {
    let values: Vec<T> = values.into_iter().collect();
    let middle = values.len() / 2;
    of_rank(values, middle)
}

/// Median absolute deviation of a normal distribution, in standard deviations: the 3/4 quantile of the standard normal
/// distribution.
pub const MEDIAN_DEVIATION: f64 = 0.6745;

/// Tukey's biweight is 0 for residuals of at least this many standard deviations. With this value the biweight is 95 %
/// efficient on normal noise.
pub const TUKEY: f64 = 4.685;

/// Median of the squared length of a normal vector in the plane, in units of the variance of one component: 2 ln 2.
pub const MEDIAN_SQUARE: f64 = 1.386;

/// Returns Tukey's biweight of `t`, a residual divided by the largest residual that counts: 1 for 0; 0 for |t| >= 1 and
/// for NaN.
pub fn biweight(t: f64) -> f64 {
    let inside = (1.0 - t * t).max(0.0);
    inside * inside
}

/// Returns a pseudo-random number that depends only on `seed`, `trial` and `draw`, by the finaliser of SplitMix64
/// (Steele, Lea & Flood 2014).
pub fn random(seed: u64, trial: u64, draw: u64) -> u64 {
    let mut z = seed ^ (trial << 16 | draw).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
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
        // -0 is before 0, and NaN is last.
        assert_eq!(of_rank([f32::NAN, 0.0, -0.0], 0).map(f32::to_bits), Some((-0.0f32).to_bits()));
    }

    #[test]
    fn biweight_falls_from_one_to_zero() {
        assert_eq!([0.0, 0.5, 1.0, 7.0, f64::NAN].map(biweight), [1.0, 0.5625, 0.0, 0.0, 0.0]);
    }
}
