//! The closest monotone curve.
//!
//! In: values and weights. Out: values that rise by at least a given step everywhere, and have the smallest weighted
//! squared differences from the input. Cost: one pass. Source: Ayer, Brunk, Ewing, Reid & Silverman 1955, "An
//! empirical distribution function for sampling with incomplete information": pool adjacent violators.

/// Returns `values` changed as little as possible, in weighted squares, so that each is at least `step` above the
/// previous one.
///
/// Weights are positive. Values that rise enough already are returned unchanged, except for rounding.
pub fn rising(values: &[f64], weights: &[f64], step: f64) -> Vec<f64> {
    // A curve rises by `step` if it does not fall after a line of that slope is subtracted.
    let mut blocks: Vec<(f64, f64, usize)> = Vec::with_capacity(values.len());
    for (i, (&v, &w)) in values.iter().zip(weights).enumerate() {
        let mut block = (v - step * i as f64, w, 1);
        while let Some(&(mean, weight, count)) = blocks.last() {
            if mean <= block.0 {
                break;
            }
            blocks.pop();
            let sum = weight + block.1;
            block = ((mean * weight + block.0 * block.1) / sum, sum, count + block.2);
        }
        blocks.push(block);
    }
    let level = blocks.iter().flat_map(|&(mean, _, count)| std::iter::repeat_n(mean, count));
    level.enumerate().map(|(i, v)| v + step * i as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::rising;

    #[test]
    fn monotone_curve_is_unchanged() {
        let v = [0.0, 0.5, 0.75, 4.0];
        assert_eq!(rising(&v, &[1.0; 4], 0.125), v);
    }

    #[test]
    fn violators_are_pooled_by_weight() {
        // By hand: 3 and 0 with weights 1 and 2 pool to 1; the 5 after them is unchanged.
        assert_eq!(rising(&[3.0, 0.0, 5.0], &[1.0, 2.0, 1.0], 0.0), [1.0, 1.0, 5.0]);
    }

    #[test]
    fn no_other_rising_curve_is_nearer() {
        let (v, w) = ([0.3, -0.2, 0.9, 0.1, 0.15, 2.0, 1.5], [1.0, 3.0, 0.5, 2.0, 1.0, 0.1, 4.0]);
        let cost = |x: &[f64]| x.iter().zip(&v).zip(&w).map(|((a, b), w)| w * (a - b) * (a - b)).sum::<f64>();
        let best = rising(&v, &w, 0.05);
        assert!(best.windows(2).all(|p| p[1] - p[0] >= 0.05 - 1e-12));
        // The problem is convex: if no small feasible change of a run of values improves it, nothing does.
        for (from, to) in (0..7).flat_map(|a| (a + 1..=7).map(move |b| (a, b))) {
            for d in [-1e-3, 1e-3] {
                let mut other = best.clone();
                other[from..to].iter_mut().for_each(|x| *x += d);
                let feasible = other.windows(2).all(|p| p[1] - p[0] >= 0.05);
                assert!(!feasible || cost(&other) >= cost(&best));
            }
        }
    }
}
