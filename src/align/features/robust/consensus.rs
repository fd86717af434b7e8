//! Common parts of the robust estimators: options, random samples, and the inliers of a homography.
//!
//! In: pairs of points, many of them wrong. Out: [`Consensus`]. Cost: one fit for each trial. Source: Fischler &
//! Bolles, CACM 24(6), 1981.
//!
//! Trial *i* draws its four pairs with a random generator that depends only on the seed and *i*, so the result is the
//! same on any machine.

use crate::align::features::robust::homography::{PointPair, fit};
use crate::align::transform::map;
use crate::statistics::random;
use nalgebra::Matrix3;

/// Options of the robust estimators.
#[derive(Debug, Clone, PartialEq)]
pub struct RansacOptions {
    /// Largest distance of an inlier from its predicted position, in pixels.
    pub threshold: f64,
    /// Required probability that at least one trial draws four inliers.
    pub confidence: f64,
    /// Largest number of trials.
    pub max_trials: u64,
    /// Seed of the random samples.
    pub seed: u64,
}

impl Default for RansacOptions {
    fn default() -> Self {
        RansacOptions { threshold: 2.5, confidence: 0.9999, max_trials: 3000, seed: 0 }
    }
}

/// A homography and its inliers.
#[derive(Debug, Clone, PartialEq)]
pub struct Consensus {
    /// Reference pixel -> frame pixel.
    pub homography: Matrix3<f64>,
    /// Indices, ascending, of the pairs whose distance is within the estimator's limit: RANSAC's threshold, or the
    /// radius that LMedS estimates.
    pub inliers: Vec<usize>,
    /// Root mean square distance of the inliers from their predicted positions, in pixels.
    pub rms: f64,
}

impl Consensus {
    /// Returns the consensus of `homography`. Its inliers are the pairs whose squared distance is at most `limit`. None
    /// if there are fewer than five inliers.
    pub(crate) fn new(pairs: &[PointPair], homography: Matrix3<f64>, limit: f64) -> Option<Self> {
        let inliers = inliers(pairs, &homography, limit);
        // Any four pairs determine a homography under which they are inliers, so four inliers prove nothing.
        if inliers.len() < 5 {
            return None;
        }
        let sum: f64 = inliers.iter().map(|&i| distance_squared(&homography, &pairs[i])).sum();
        Some(Consensus { rms: (sum / inliers.len() as f64).sqrt(), homography, inliers })
    }
}

/// Maps the pair's first point by `h`, and returns the squared distance from the result to the second point, in pixels
/// squared.
pub fn distance_squared(h: &Matrix3<f64>, pair: &PointPair) -> f64 {
    let (u, v) = map(h, pair.0[0], pair.0[1]);
    (u - pair.1[0]) * (u - pair.1[0]) + (v - pair.1[1]) * (v - pair.1[1])
}

/// Returns the homography of the four pairs that trial number `trial` draws; none if no camera can produce such pairs.
pub(crate) fn guess(pairs: &[PointPair], seed: u64, trial: u64) -> Option<Matrix3<f64>> {
    let four = draw(seed, trial, pairs.len()).map(|i| pairs[i]);
    same_handed(&four).then(|| fit(&four, None))?
}

/// Returns the indices of the pairs whose squared distance under `h` is at most `limit`.
pub(crate) fn inliers(pairs: &[PointPair], h: &Matrix3<f64>, limit: f64) -> Vec<usize> {
    (0..pairs.len()).filter(|&i| distance_squared(h, &pairs[i]) <= limit).collect()
}

/// Returns the number of trials that suffice if `right` of `all` pairs are correct, at most `options.max_trials`. With
/// probability p (`options.confidence`), at least one of these trials draws four correct pairs.
///
/// The number is ln(1 - p) / ln(1 - q). Here q = C(right, 4) / C(all, 4) is the probability that a single trial draws
/// four correct pairs. The four pairs of a trial are drawn without replacement.
pub(crate) fn trials_for(right: usize, all: usize, options: &RansacOptions) -> u64 {
    let all_four: f64 = (0..4).map(|i| right.saturating_sub(i) as f64 / (all - i) as f64).product();
    // `trials` is infinite or NaN if q = 0 or p = 1. The comparison with `max_trials` is then false.
    let trials = (libm::log1p(-options.confidence) / libm::log1p(-all_four)).ceil();
    if trials < options.max_trials as f64 { (trials as u64).max(1) } else { options.max_trials }
}

/// Whether any three of the four points have the same orientation (clockwise or not) in both frames. This holds for
/// points in front of the camera.
fn same_handed(four: &[PointPair; 4]) -> bool {
    let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)].iter().all(|&(i, j, k)| {
        let (a, b, c) = (four[i], four[j], four[k]);
        turn(a.0, b.0, c.0) * turn(a.1, b.1, c.1) > 0.0
    })
}

/// Returns four different indices below `n`, which depend only on `seed`, `trial` and `n`.
fn draw(seed: u64, trial: u64, n: usize) -> [usize; 4] {
    let mut four = [0; 4];
    let mut counter = 0;
    for k in 0..4 {
        loop {
            let index = (random(seed, trial, counter) % n as u64) as usize;
            counter += 1;
            if !four[..k].contains(&index) {
                four[k] = index;
                break;
            }
        }
    }
    four
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) const H: Matrix3<f64> = Matrix3::new(0.999, 0.02, -8.0, -0.021, 1.001, 15.0, 1e-6, 2e-6, 1.0);

    fn noise(i: u64, k: u64) -> f64 {
        random(99, i, k) as f64 / u64::MAX as f64 - 0.5
    }

    /// Returns `n` pairs. The first `wrong` of them are random. The other pairs follow `H` with an error of up to
    /// `sigma` px along each axis.
    pub(crate) fn pairs(n: u64, wrong: u64, sigma: f64) -> Vec<PointPair> {
        (0..n)
            .map(|i| {
                let p = [2000.0 * (noise(i, 0) + 0.5), 1500.0 * (noise(i, 1) + 0.5)];
                let (u, v) = map(&H, p[0], p[1]);
                if i < wrong {
                    (p, [2000.0 * (noise(i, 2) + 0.5), 1500.0 * (noise(i, 3) + 0.5)])
                } else {
                    (p, [u + 2.0 * sigma * noise(i, 2), v + 2.0 * sigma * noise(i, 3)])
                }
            })
            .collect()
    }

    #[test]
    fn draws_are_different_and_repeatable() {
        for trial in 0..500 {
            let four = draw(1, trial, 5);
            assert_eq!(four, draw(1, trial, 5));
            assert!((0..4).all(|i| four[i] < 5 && !four[..i].contains(&four[i])));
        }
        assert_ne!(draw(1, 0, 1000), draw(2, 0, 1000));
    }

    #[test]
    fn trials_are_those_of_draws_without_replacement() {
        let options = RansacOptions { max_trials: u64::MAX, ..RansacOptions::default() };
        for (right, all) in [(5, 10), (6, 9), (8, 20), (300, 500)] {
            // The number of ordered draws of four from `n` without replacement.
            let ways = |n: usize| (n - 3..=n).product::<usize>() as f64;
            let hit = ways(right) / ways(all);
            let trials = trials_for(right, all, &options) as f64;
            let miss = |trials: f64| libm::pow(1.0 - hit, trials);
            assert!(miss(trials) <= 1e-4 * (1.0 + 1e-9) && miss(trials - 1.0) > 1e-4, "{right} of {all}: {trials}");
        }
        // If five of ten pairs are correct, C(5, 4) / C(10, 4) = 5 / 210 of the draws succeed. With replacement, 1 / 16
        // would succeed.
        assert_eq!(trials_for(5, 10, &options), 383);
        assert_eq!((trials_for(10, 10, &options), trials_for(3, 10, &options)), (1, u64::MAX));
        assert_eq!(trials_for(3, 10, &RansacOptions::default()), 3000);
    }
}
