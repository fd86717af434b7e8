//! The tone curve that distorts the contrasts of a scene least: steep where much of the picture is, flat where little is.
//!
//! In: how often which tone occurs. Out: a curve of straight pieces that brings all of them into the range of a display. Cost: none.
//! Source: Eilertsen, Mantiuk, Unger, "Real-time Noise-aware Tone Mapping" (2015), section 4.1, equations 3 to 11.

use super::overview::quantile;

/// The curve: log2 display luminance for a log2 tone.
#[derive(Debug, Clone, PartialEq)]
pub struct ContrastCurve {
    /// The tone of the first node.
    first: f64,
    /// From node to node, in stops.
    step: f64,
    /// log2 display luminance of the nodes; rising, the last 0.
    nodes: Vec<f64>,
}

/// Nodes to a stop.
const PER_STOP: f64 = 8.0;

impl ContrastCurve {
    /// For the tones `sorted`, rising and at least one, and a display of `range` stops. A part `black` of the tones may lie below
    /// the range and a part `burnt` above it. `floor` is a share, in parts of an even one, that every tone counts for at least: 0 leaves nothing to tones that do not occur.
    pub fn new(sorted: &[f32], range: f64, (black, burnt): (f64, f64), floor: f64) -> Self {
        let (low, high) = (f64::from(quantile(sorted, black)), f64::from(quantile(sorted, 1.0 - burnt)));
        let pieces = ((high - low) * PER_STOP).ceil().max(1.0) as usize;
        let step = ((high - low) / pieces as f64).max(1e-3);
        let mut shares = vec![0.0f64; pieces];
        for &v in sorted {
            shares[(((f64::from(v) - low) / step).max(0.0) as usize).min(pieces - 1)] += 1.0 / sorted.len() as f64;
        }
        for share in &mut shares {
            *share = share.max(floor / pieces as f64);
        }
        let slopes = slopes(&shares, step, range);
        let mut nodes = vec![0.0];
        for slope in slopes {
            nodes.push(nodes[nodes.len() - 1] + slope * step);
        }
        let top = nodes[nodes.len() - 1];
        nodes.iter_mut().for_each(|y| *y -= top);
        ContrastCurve { first: low, step, nodes }
    }

    /// log2 display luminance of the tone `v`: at most 0; below the first node it goes on falling as the scene does.
    pub fn at(&self, v: f64) -> f64 {
        let place = (v - self.first) / self.step;
        if place <= 0.0 {
            return self.nodes[0] + v - self.first;
        }
        let piece = place as usize;
        match self.nodes.get(piece..piece + 2) {
            Some(ends) => ends[0] + (place - piece as f64) * (ends[1] - ends[0]),
            None => 0.0,
        }
    }
}

/// Equation 11: s_k = 1 - (N d - r) / (p_k d sum 1/p), of those that it leaves above 0; a slope is never above 1, as no contrast is raised.
fn slopes(shares: &[f64], step: f64, range: f64) -> Vec<f64> {
    if shares.len() as f64 * step <= range {
        return vec![1.0; shares.len()];
    }
    let mut is_used: Vec<bool> = shares.iter().map(|p| *p > 0.0).collect();
    loop {
        let used = || shares.iter().zip(&is_used).filter(|(_, used)| **used).map(|(p, _)| *p);
        let (count, inverse) = (used().count() as f64, used().map(|p| 1.0 / p).sum::<f64>());
        let excess = ((count * step - range) / (step * inverse)).max(0.0);
        let slopes: Vec<f64> =
            shares.iter().zip(&is_used).map(|(p, used)| if *used { 1.0 - excess / p } else { 0.0 }).collect();
        if slopes.iter().all(|s| *s >= 0.0) {
            return slopes;
        }
        for (used, slope) in is_used.iter_mut().zip(&slopes) {
            *used &= *slope > 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn even(count: usize, range: f32) -> Vec<f32> {
        (0..count).map(|i| range * i as f32 / count as f32).collect()
    }

    #[test]
    fn what_fits_is_left_alone() {
        let curve = ContrastCurve::new(&even(1000, 4.0), 6.0, (0.0, 0.0), 0.0);
        assert!((curve.at(1.0) - curve.at(3.0) + 2.0).abs() < 1e-9);
        assert_eq!(curve.at(100.0), 0.0);
        assert!(curve.at(-1.0) < curve.at(0.0));
    }

    /// Even tones: equation 11 gives every slope r / (N d).
    #[test]
    fn even_tones_are_compressed_evenly() {
        let curve = ContrastCurve::new(&even(100_000, 12.0), 6.0, (0.0, 0.0), 0.0);
        for v in [1.0, 5.0, 9.0] {
            assert!((curve.at(v + 1.0) - curve.at(v) - 0.5).abs() < 0.01, "{v}");
        }
    }

    /// The minimum of sum p (1 - s)^2 under sum s d = r, s >= 0: no small change that keeps the sum makes it less.
    #[test]
    fn no_other_slopes_distort_less() {
        let shares = [0.3, 0.05, 0.001, 0.0, 0.2, 0.1, 0.3, 0.049];
        let found = slopes(&shares, 1.0, 3.5);
        let cost = |s: &[f64]| shares.iter().zip(s).map(|(p, s)| p * (1.0 - s) * (1.0 - s)).sum::<f64>();
        assert!((found.iter().sum::<f64>() - 3.5).abs() < 1e-9 && found.iter().all(|s| (0.0..=1.0).contains(s)));
        for (i, j) in (0..8).flat_map(|i| (0..8).map(move |j| (i, j))).filter(|(i, j)| i != j) {
            let mut other = found.clone();
            let change = 0.01f64.min(other[i]);
            other[i] -= change;
            other[j] += change;
            assert!(cost(&other) >= cost(&found) - 1e-12, "{i} {j}");
        }
    }
}
