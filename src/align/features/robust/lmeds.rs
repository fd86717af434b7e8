//! LMedS: the homography with the least median of squared distances.
//!
//! In: pairs of points, fewer than half of them wrong. Out: a [`Consensus`], or none. Cost: one fit and one pass over
//! the pairs for each trial. The number of trials depends on the number of pairs. If the number of pairs is even, or
//! greater than 50, a confidence of 0.9999 needs 120 to 150 trials. A smaller odd number of pairs needs up to 320
//! trials. Five pairs need the maximum number of trials. Source: Rousseeuw, "Least Median of Squares Regression", JASA
//! 79(388), 1984. Two steps are from Rousseeuw & Leroy (Robust Regression and Outlier Detection, 1987, chapter 5): the
//! estimate of the standard deviation from the median, and the refit.
//!
//! Unlike RANSAC, LMedS needs no threshold, because the median measures the scatter of the inliers. It finds nothing if
//! more than half of the pairs are wrong.

use crate::align::features::robust::consensus::{guess, inliers, trials_for};
use crate::align::features::robust::homography::{PointPair, fit};
use crate::align::features::{Consensus, RansacOptions, distance_squared};
use crate::statistics::median;
use nalgebra::Matrix3;

/// Largest distance of an inlier from its predicted position, in standard deviations (estimated from the median).
const WITHIN: f64 = 2.5;
/// Lower limit of the estimated standard deviation, in pixels: no keypoint is more precise.
const LEAST_SIGMA: f64 = 0.02;
/// If the radius within which pairs count as inliers is at least this multiple of RANSAC's threshold, more than half of
/// the pairs are assumed to be wrong, and there is no result.
const MOST_THRESHOLDS: f64 = 2.0;
/// Largest number of refits; usually two are enough.
const MOST_REFITS: usize = 10;

/// Returns the homography with the least median of squared distances, refitted to its inliers; none if more than half
/// of the pairs seem to be wrong.
///
/// The threshold of `options` is used only to detect that more than half of the pairs are wrong. It does not limit the
/// distance of single pairs.
pub fn search(pairs: &[PointPair], options: &RansacOptions) -> Option<Consensus> {
    if pairs.len() < 5 {
        return None;
    }
    // This number of trials is enough even if only just over half of the pairs are correct, the least share that the
    // median requires.
    let trials = trials_for(pairs.len() / 2 + 1, pairs.len(), options);
    let (median, mut h) = (0..trials)
        .filter_map(|trial| {
            let h = guess(pairs, options.seed, trial)?;
            Some((median_of_squares(pairs, &h), h))
        })
        // If two trials have equal medians, the earlier one is kept.
        .reduce(|best, other| if other.0 < best.0 { other } else { best })?;
    let radius = WITHIN * scale(median, pairs.len()).max(LEAST_SIGMA);
    if radius >= MOST_THRESHOLDS * options.threshold {
        return None;
    }
    let limit = radius * radius;
    let mut right = inliers(pairs, &h, limit);
    for _ in 0..MOST_REFITS {
        let chosen: Vec<PointPair> = right.iter().map(|&i| pairs[i]).collect();
        let Some(refitted) = fit(&chosen, None) else {
            break;
        };
        let still = inliers(pairs, &refitted, limit);
        // If there are fewer inliers than before, the refits diverge.
        if still.len() < right.len() {
            break;
        }
        h = refitted;
        if still == right {
            break;
        }
        right = still;
    }
    Consensus::new(pairs, h, limit)
}

/// Returns the standard deviation of the correct pairs' distances, estimated from the median of all squared distances
/// (Rousseeuw & Leroy 1987, chapter 5, eq. 1.3).
///
/// The factor 1.4826 is exact for residuals along one axis with a normal distribution. The factor in parentheses
/// corrects for small numbers of pairs.
fn scale(median: f64, pairs: usize) -> f64 {
    1.4826 * (1.0 + 5.0 / (pairs as f64 - 4.0)) * median.sqrt()
}

fn median_of_squares(pairs: &[PointPair], h: &Matrix3<f64>) -> f64 {
    median(pairs.iter().map(|p| distance_squared(h, p))).unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::features::robust::consensus::tests::{H, pairs};
    use crate::align::transform::map;

    #[test]
    fn finds_the_homography_where_two_fifths_are_wrong() {
        for (n, wrong) in [(60, 0), (60, 24), (500, 200)] {
            let found = search(&pairs(n, wrong, 0.5), &RansacOptions::default()).unwrap();
            let right = found.inliers.iter().filter(|&&i| i as u64 >= wrong).count() as u64;
            assert!(right == n - wrong && found.inliers.len() as u64 <= n - wrong + 2, "{right} of {n} - {wrong}");
            // By the derivation in the tests of `ransac`, the error at the corners is 0.26 px for 60 correct pairs and
            // 0.34 px for 36. The tolerance is three times that.
            for (x, y) in [(0.0, 0.0), (2000.0, 0.0), (2000.0, 1500.0), (0.0, 1500.0)] {
                let ((a, b), (c, d)) = (map(&found.homography, x, y), map(&H, x, y));
                assert!((a - c).hypot(b - d) < 1.0, "{n} {wrong}");
            }
        }
    }

    #[test]
    fn its_radius_follows_the_scatter() {
        // RANSAC's threshold would accept all correct pairs with both values of `sigma`. The radius of LMedS follows
        // the median instead.
        let rms = |sigma| search(&pairs(200, 60, sigma), &RansacOptions::default()).unwrap().rms;
        let (fine, coarse) = (rms(0.1), rms(0.8));
        assert!((6.0..10.0).contains(&(coarse / fine)), "{fine} {coarse}");
        let mut off = pairs(200, 0, 0.1);
        // This pair has an error of 2 px. It is within RANSAC's threshold, but the error is twenty times the scatter.
        off[7].1[0] += 2.0;
        assert!(!search(&off, &RansacOptions::default()).unwrap().inliers.contains(&7));
    }

    #[test]
    fn exact_pairs_are_all_right() {
        let found = search(&pairs(40, 0, 0.0), &RansacOptions::default()).unwrap();
        assert_eq!(found.inliers.len(), 40);
        assert!(found.rms < 1e-6);
    }

    #[test]
    fn more_outliers_than_inliers_give_no_consensus() {
        for (n, wrong) in [(200, 120), (100, 100), (500, 400)] {
            assert!(search(&pairs(n, wrong, 0.5), &RansacOptions::default()).is_none(), "{wrong} of {n}");
        }
        assert!(search(&pairs(4, 0, 0.0), &RansacOptions::default()).is_none());
    }

    #[test]
    fn the_same_pairs_and_seed_give_the_same() {
        let list = pairs(120, 40, 0.5);
        let by = |seed| search(&list, &RansacOptions { seed, ..RansacOptions::default() }).unwrap();
        assert_eq!(by(3), by(3));
        // Another seed leads to nearly the same inliers, because the result of the refits hardly depends on their
        // start.
        assert!(by(3).inliers.len().abs_diff(by(4).inliers.len()) <= 2);
    }

    #[test]
    fn the_number_of_trials_is_that_for_half_of_wrong_ones() {
        // The expected number is ln(1 - 0.9999) / ln(1 - 1/16) = 142.7, rounded up.
        assert_eq!(trials_for(501, 1000, &RansacOptions::default()), 143);
    }
}
