//! RANSAC: the homography that most matches support.
//!
//! In: pairs of points, many of them wrong. Out: a [`Consensus`], or none. Cost: one fit and one pass over the pairs
//! for each trial; the number of trials decreases with the largest share of inliers found so far. Source: Fischler &
//! Bolles, CACM 24(6), 1981. The score is the truncated sum of Torr & Zisserman (MSAC, CVIU 78, 2000). After every
//! improvement, the homography is refitted to its inliers (Chum, Matas & Kittler, DAGM 2003).

use crate::align::features::robust::consensus::{distance_squared, guess, inliers, trials_for};
use crate::align::features::robust::homography::{PointPair, fit};
use crate::align::features::{Consensus, RansacOptions};
use nalgebra::Matrix3;

/// Returns the homography with the lowest score; none if it has fewer than five inliers.
pub fn search(pairs: &[PointPair], options: &RansacOptions) -> Option<Consensus> {
    if pairs.len() < 4 {
        return None;
    }
    let limit = options.threshold * options.threshold;
    let mut best: Option<(f64, Matrix3<f64>)> = None;
    let mut needed = options.max_trials;
    let mut trial = 0;
    while trial < needed {
        let drawn = guess(pairs, options.seed, trial);
        trial += 1;
        let Some(h) = drawn else { continue };
        let cost = score(pairs, &h, limit);
        if best.as_ref().is_none_or(|(c, _)| cost < *c) {
            let (cost, h) = polish(pairs, cost, h, limit);
            best = Some((cost, h));
            needed = needed.min(trials_for(inliers(pairs, &h, limit).len(), pairs.len(), options));
        }
    }
    let (_, homography) = best?;
    Consensus::new(pairs, homography, limit)
}

/// Returns the score of `h`: the sum of the squared distances, each limited to `limit`. Lower is better.
fn score(pairs: &[PointPair], h: &Matrix3<f64>, limit: f64) -> f64 {
    pairs.iter().map(|p| distance_squared(h, p).min(limit)).sum()
}

/// Refits the homography to its inliers as long as the score decreases. The weights of the pairs decrease to 0 at the
/// threshold.
fn polish(pairs: &[PointPair], mut cost: f64, mut h: Matrix3<f64>, limit: f64) -> (f64, Matrix3<f64>) {
    for _ in 0..10 {
        let weights: Vec<f64> = pairs
            .iter()
            .map(|p| {
                let share = 1.0 - distance_squared(&h, p) / limit;
                share.max(0.0) * share.max(0.0)
            })
            .collect();
        let Some(better) = fit(pairs, Some(&weights)) else {
            break;
        };
        let lower = score(pairs, &better, limit);
        if lower >= cost {
            break;
        }
        (cost, h) = (lower, better);
    }
    (cost, h)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::features::robust::consensus::tests::{H, pairs};
    use crate::align::transform::map;

    #[test]
    fn finds_the_homography_among_wrong_matches() {
        for (n, wrong) in [(60, 0), (200, 120), (500, 350)] {
            let found = search(&pairs(n, wrong, 0.5), &RansacOptions::default()).unwrap();
            let right = found.inliers.iter().filter(|&&i| i as u64 >= wrong).count() as u64;
            assert!(right == n - wrong && found.inliers.len() as u64 <= n - wrong + 2);
            // The tolerance follows from the noise. Uniform noise of +-0.5 px has a standard deviation of 0.29 px along
            // each axis. With eight parameters fitted to 2 n equations, the mean leverage is 4 / n, and the leverage of
            // the corners is about 24 / n. For n >= 60, the error of a corner is at most 0.29 sqrt(2) sqrt(24 / 60) =
            // 0.26 px. The tolerance is three times that.
            for (x, y) in [(0.0, 0.0), (2000.0, 0.0), (2000.0, 1500.0), (0.0, 1500.0)] {
                let ((a, b), (c, d)) = (map(&found.homography, x, y), map(&H, x, y));
                assert!((a - c).hypot(b - d) < 0.8);
            }
        }
    }

    #[test]
    fn nonsense_has_no_consensus_worth_the_name() {
        // A random pair is within the threshold of 2.5 px with probability 6.5e-6: the area of a circle of this radius
        // divided by the area of the image. One draw in 11 has the same orientation in both frames (`same_handed`). In
        // 3000 trials with 96 further pairs each, a fifth inlier is found by chance in 1 - exp(-3000 / 11 * 96 *
        // 6.5e-6) = 16 % of the searches, and hardly ever a sixth.
        let search_with = |seed| search(&pairs(100, 100, 0.0), &RansacOptions { seed, ..RansacOptions::default() });
        let found: Vec<Consensus> = (0..20).filter_map(search_with).collect();
        assert!(found.len() <= 8 && found.iter().all(|f| f.inliers.len() == 5), "{found:?}");
        assert!(search(&pairs(3, 0, 0.0), &RansacOptions::default()).is_none());
    }
}
