//! A small quadratic program: minimises a quadratic form over non-negative numbers with a bounded sum.
//!
//! In: a positive definite matrix, a vector, and the bound of the sum. Out: the vector at the minimum. Cost: for n
//! numbers, about n steps of n^3 / 6 operations each. Source: Nocedal & Wright, "Numerical Optimization" (2006),
//! section 16.5, algorithm 16.3 (active sets).

/// Returns the x >= 0 with sum x <= `most` that minimises x' H x / 2 - f' x, where ' marks the transpose. `h` holds the
/// rows of H, which is symmetric and positive definite.
pub(crate) fn minimum(h: &[Vec<f64>], f: &[f64], most: f64) -> Vec<f64> {
    let n = f.len();
    let mut x = vec![0.0f64; n];
    let mut is_free = vec![false; n];
    let mut is_full = false;
    let scale = f.iter().fold(1e-300f64, |a, v| a.max(v.abs()));
    // Each step adds or removes one active constraint. The limit on the number of steps stops cycles caused by
    // rounding.
    for _ in 0..20 * n + 20 {
        let free: Vec<usize> = (0..n).filter(|&i| is_free[i]).collect();
        let Some((target, multiplier)) = on_free(h, f, &free, is_full.then_some(most)) else { break };
        // Move towards the target until a variable reaches 0.
        let (mut part, mut bound) = (1.0, None);
        for (&i, &t) in free.iter().zip(&target) {
            if t < 0.0 {
                let until = x[i] / (x[i] - t);
                if until < part {
                    (part, bound) = (until, Some(i));
                }
            }
        }
        let (sum, of_target) = (x.iter().sum::<f64>(), target.iter().sum::<f64>());
        let fills = !is_full && of_target > most && (most - sum) / (of_target - sum) < part;
        if fills {
            part = ((most - sum) / (of_target - sum)).max(0.0);
        }
        for (&i, &t) in free.iter().zip(&target) {
            x[i] = (x[i] + part * (t - x[i])).max(0.0);
        }
        if fills {
            is_full = true;
        } else if let Some(i) = bound {
            (x[i], is_free[i]) = (0.0, false);
        } else if is_full && multiplier < -1e-12 * scale {
            is_full = false;
        } else {
            // Among the variables that are held at 0, free the one whose increase makes the form decrease fastest.
            let slope = |i: usize| h[i].iter().zip(&x).map(|(a, x)| a * x).sum::<f64>() - f[i] + multiplier;
            let bound = (0..n).filter(|&i| !is_free[i]).map(|i| (slope(i), i));
            match bound.min_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((slope, i)) if slope < -1e-10 * scale => is_free[i] = true,
                _ => break,
            }
        }
    }
    x
}

/// Returns the minimum over the variables `free`, with all other variables at 0, and the Lagrange multiplier of the
/// sum. If `sum` is given, the variables are constrained to this sum; otherwise the multiplier is 0.
fn on_free(h: &[Vec<f64>], f: &[f64], free: &[usize], sum: Option<f64>) -> Option<(Vec<f64>, f64)> {
    let factor = cholesky(&free.iter().map(|&i| free.iter().map(|&j| h[i][j]).collect()).collect::<Vec<Vec<f64>>>())?;
    let mut x = solved(&factor, &free.iter().map(|&i| f[i]).collect::<Vec<f64>>());
    let Some(sum) = sum else { return Some((x, 0.0)) };
    let ones = solved(&factor, &vec![1.0; free.len()]);
    let multiplier = (x.iter().sum::<f64>() - sum) / ones.iter().sum::<f64>();
    x.iter_mut().zip(&ones).for_each(|(x, o)| *x -= multiplier * o);
    Some((x, multiplier))
}

/// Returns the lower triangle L of `a` = L L'; `None` when `a` is not positive definite.
fn cholesky(a: &[Vec<f64>]) -> Option<Vec<Vec<f64>>> {
    let mut l: Vec<Vec<f64>> = Vec::new();
    for (i, row) in a.iter().enumerate() {
        let mut next = Vec::with_capacity(i + 1);
        for j in 0..i {
            let above: f64 = next.iter().zip(&l[j]).map(|(p, q): (&f64, &f64)| p * q).sum();
            next.push((row[j] - above) / l[j][j]);
        }
        let left = row[i] - next.iter().map(|p| p * p).sum::<f64>();
        if left.is_nan() || left <= 0.0 {
            return None;
        }
        next.push(left.sqrt());
        l.push(next);
    }
    Some(l)
}

/// Returns the solution x of L L' x = `right`, where `l` is the lower triangle L and L' its transpose.
fn solved(l: &[Vec<f64>], right: &[f64]) -> Vec<f64> {
    let mut x = right.to_vec();
    for i in 0..x.len() {
        let known: f64 = (0..i).map(|j| l[i][j] * x[j]).sum();
        x[i] = (x[i] - known) / l[i][i];
    }
    for i in (0..x.len()).rev() {
        let known: f64 = (i + 1..x.len()).map(|j| l[j][i] * x[j]).sum();
        x[i] = (x[i] - known) / l[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For random programs, the result meets the Karush-Kuhn-Tucker conditions, which are sufficient for a convex
    /// program.
    #[test]
    fn the_conditions_of_a_minimum_hold() {
        let mut state = 7u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 23) - 1.0
        };
        let (mut full, mut bound) = (0, 0);
        for trial in 0..60 {
            let n = 1 + trial % 40;
            let a: Vec<Vec<f64>> = (0..n + 2).map(|_| (0..n).map(|_| random()).collect()).collect();
            let h: Vec<Vec<f64>> = (0..n)
                .map(|i| {
                    let product = |j: usize| a.iter().map(|row| row[i] * row[j]).sum::<f64>();
                    (0..n).map(|j| product(j) + if i == j { 0.01 } else { 0.0 }).collect()
                })
                .collect();
            let f: Vec<f64> = (0..n).map(|_| random() + 0.3).collect();
            let most = 0.05 + random().abs();
            let x = minimum(&h, &f, most);
            let sum: f64 = x.iter().sum();
            assert!(x.iter().all(|x| *x >= 0.0) && sum <= most + 1e-9, "{x:?} {most}");
            let slope: Vec<f64> = (0..n).map(|i| h[i].iter().zip(&x).map(|(a, x)| a * x).sum::<f64>() - f[i]).collect();
            let is_full = sum > most - 1e-9;
            let multiplier = if is_full {
                let free = (0..n).filter(|&i| x[i] > 1e-9);
                free.map(|i| -slope[i]).fold(0.0, f64::max)
            } else {
                0.0
            };
            assert!(multiplier >= -1e-8);
            for i in 0..n {
                let reduced = slope[i] + multiplier;
                assert!(reduced > -1e-7, "{trial}: {i} should be larger, {reduced}");
                assert!(x[i] < 1e-9 || reduced < 1e-7, "{trial}: {i} should be smaller, {reduced}");
            }
            full += usize::from(is_full);
            bound += x.iter().filter(|x| **x == 0.0).count();
        }
        assert!(full > 5 && full < 60 && bound > 50, "every kind of program was tried: {full} {bound}");
    }

    #[test]
    fn one_number_is_the_vertex_or_an_end() {
        assert_eq!(minimum(&[vec![1.0]], &[-1.0], 1.0), [0.0]);
        assert_eq!(minimum(&[vec![4.0]], &[2.0], 1.0), [0.5]);
        assert_eq!(minimum(&[vec![2.0]], &[9.0], 1.0), [1.0]);
        assert!(minimum(&[], &[], 1.0).is_empty());
    }
}
