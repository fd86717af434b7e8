//! The strength of edges at each pixel of a frame.
//!
//! In: grey values. Out: [`Edges`]. Cost: five passes over the picture. The strengths of differently exposed frames
//! are comparable, because they are computed from the logarithm of the grey values and divided by the strength of the
//! strongest edges.

use crate::align::Motion;
use crate::plane::Plane;
use crate::pyramid::gaussian;
use crate::statistics::of_rank;

/// Resamples `small`, a frame at reduced size, to the pixel grid of the reference frame at the same reduced size.
pub(super) fn laid(small: &Plane<u8>, motion: &Motion) -> Grey {
    let (width, height) = (small.width(), small.height());
    let (full_width, full_height) = motion.size();
    let (sx, sy) = (full_width as f64 / width as f64, full_height as f64 / height as f64);
    let place = |x: usize, y: usize| {
        let (u, v) = motion.position((x as f64 + 0.5) * sx - 0.5, (y as f64 + 0.5) * sy - 0.5)?;
        let (u, v) = ((u + 0.5) / sx - 0.5, (v + 0.5) / sy - 0.5);
        let inside = u >= 0.0 && v >= 0.0 && u <= width as f64 - 1.0 && v <= height as f64 - 1.0;
        inside.then_some((u, v))
    };
    let level = |(u, v): (f64, f64)| {
        let (left, top) = (u as usize, v as usize);
        let (fx, fy) = (u - left as f64, v - top as f64);
        let (next, below) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
        let at = |x: usize, y: usize| f64::from(small.at(x, y));
        let upper = at(left, top) * (1.0 - fx) + at(next, top) * fx;
        let lower = at(left, below) * (1.0 - fx) + at(next, below) * fx;
        (upper * (1.0 - fy) + lower * fy).round() as u8
    };
    let levels = Plane::from_rows(width, height, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, out)| *out = place(x, y).map_or(0, level));
    });
    let outside = Plane::from_rows(width, height, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, out)| *out = place(x, y).is_none());
    });
    Grey { levels, outside: Some(outside) }
}

/// A grey picture with a mask of its invalid pixels. Without a mask, all pixels are valid.
pub(super) struct Grey {
    pub(super) levels: Plane<u8>,
    pub(super) outside: Option<Plane<bool>>,
}

/// This is added to grey values before the logarithm is taken, so that noise near black does not give edges.
const BLACK: f64 = 8.0;
/// Standard deviation of the Gaussian smoothing before the gradient is computed, in pixels.
const SMOOTHING: f64 = 0.8;
/// This fraction of the pixels, those with the largest gradients, is shown at full strength.
const STRONGEST: f64 = 0.02;

/// The strength of the edges in a picture.
pub(super) struct Edges {
    /// Strength at each pixel, 0..=255.
    pub(super) strength: Plane<u8>,
    /// The Sobel gradient of the logarithm of grey values that has the strength 255.
    pub(super) full: f32,
}

/// An invalid pixel clearly affects gradients up to this distance, in pixels, through smoothing and the Sobel filter.
const REACH: usize = 3;

impl Grey {
    pub(super) fn whole(levels: Plane<u8>) -> Self {
        Grey { levels, outside: None }
    }

    /// Returns the edges. The strongest edges of the picture have the full strength of 255 if their gradient is at
    /// least `least`. If it is smaller, all edges are weaker.
    pub(super) fn edges(&self, least: f32) -> Edges {
        let (width, height) = (self.levels.width(), self.levels.height());
        let logarithms: [f32; 256] = std::array::from_fn(|v| libm::log(v as f64 + BLACK) as f32);
        let log = Plane::from_rows(width, height, |y, row| {
            for (v, g) in row.iter_mut().zip(self.levels.row(y)) {
                *v = logarithms[usize::from(*g)];
            }
        });
        let smooth = gaussian(&log, SMOOTHING);
        let strength = Plane::from_rows(width, height, |y, row: &mut [f32]| {
            // Pixels at the border lack neighbours for the gradient, so their strength stays 0.
            if y == 0 || y + 1 >= height || width < 3 {
                return;
            }
            let [above, here, below] = [y - 1, y, y + 1].map(|v| smooth.row(v));
            for x in (1..width - 1).filter(|&x| self.is_inside(x, y)) {
                let across = |r: &[f32]| r[x + 1] - r[x - 1];
                let gx = across(above) + 2.0 * across(here) + across(below);
                let gy = below[x - 1] + 2.0 * below[x] + below[x + 1] - above[x - 1] - 2.0 * above[x] - above[x + 1];
                row[x] = (gx * gx + gy * gy).sqrt();
            }
        });
        let all = strength.as_slice();
        let rank = (all.len().saturating_sub(1) as f64 * (1.0 - STRONGEST)) as usize;
        let full = of_rank(all.iter().copied(), rank).unwrap_or(least).max(least);
        let strength = Plane::from_rows(width, height, |y, row| {
            for (v, s) in row.iter_mut().zip(strength.row(y)) {
                *v = (255.0 * (s / full).min(1.0)).round() as u8;
            }
        });
        Edges { strength, full }
    }

    /// Returns whether all pixels within [`REACH`] pixels of (x, y) are valid.
    fn is_inside(&self, x: usize, y: usize) -> bool {
        let Some(outside) = &self.outside else { return true };
        let near = |v: usize, n: usize| v.saturating_sub(REACH)..(v + REACH + 1).min(n);
        let columns = near(x, outside.width());
        near(y, outside.height()).all(|row| outside.row(row)[columns.clone()].iter().all(|o| !o))
    }
}

#[cfg(test)]
mod tests {
    use super::super::views::LEAST_FULL;
    use super::*;
    use crate::align::Transform;
    use crate::align::scene::{Scene, Shot, rigid};

    fn mean_min(a: &Plane<u8>, b: &Plane<u8>) -> f64 {
        let pairs = a.as_slice().iter().zip(b.as_slice());
        pairs.map(|(x, y)| f64::from(*x.min(y))).sum::<f64>() / a.as_slice().len() as f64
    }

    #[test]
    fn edges_are_alike_in_two_exposures_and_coincide_once_aligned() {
        let (size, scene, truth) = ((360, 240), Scene::new(3), rigid(14.0, -9.0, 1.0));
        let reference =
            Grey::whole(scene.photograph(size, &Transform::Identity, Shot::at(0.0))).edges(LEAST_FULL).strength;
        let grey = scene.photograph(size, &truth, Shot::at(-2.0));
        let after = laid(&grey, &Motion::new(&truth, size)).edges(LEAST_FULL).strength;
        // The border of the frame must not count as an edge. Because the frame is shifted by 14 px and rotated by 1
        // deg, this border is in columns 343 to 347.
        assert!((0..size.1).all(|y| after.row(y)[345..].iter().all(|v| *v == 0)));
        let after = mean_min(&reference, &after);
        let (before, most) =
            (mean_min(&reference, &Grey::whole(grey).edges(LEAST_FULL).strength), mean_min(&reference, &reference));
        // After alignment, a difference remains because of noise, resampling, and a strip that the frame does not
        // cover (14 of 360 columns).
        assert!(most - after < 0.5 * (most - before), "{before} {after} {most}");
    }

    #[test]
    fn a_flat_picture_has_no_edges() {
        assert!(Grey::whole(Plane::filled(20, 20, 3u8)).edges(LEAST_FULL).strength.as_slice().iter().all(|v| *v == 0));
    }
}
