//! SIFT: keypoints invariant to scale and rotation and, within limits, to exposure.
//!
//! In: a grey image. Out: its [`Features`]. Cost: five Gaussians per octave (4/3 of the pixels in all, 16/3 if the
//! image is doubled first), then some thousand operations per keypoint. Source: Lowe, "Distinctive Image Features from
//! Scale-Invariant Keypoints", IJCV 60(2), 2004; each submodule is one of its sections.

mod descriptor;
mod extrema;
mod gradient;
mod orientation;
mod scale_space;

use crate::align::features::{Descriptor, Features, Keypoint};
use crate::plane::Plane;
use extrema::Extremum;
use rayon::prelude::*;
use scale_space::ScaleSpace;

/// Settings of the detector; the defaults are the paper's.
#[derive(Debug, Clone, PartialEq)]
pub struct SiftOptions {
    /// s: scale intervals per octave (section 3.3).
    pub intervals: usize,
    /// Standard deviation of the Gaussian at the first scale of an octave, in pixels (section 3.3).
    pub sigma: f64,
    /// Whether to double the image first, for features of the smallest scale (section 3.3).
    pub double: bool,
    /// Least |D| at an extremum, for grey values 0..=1 (section 4).
    pub contrast: f64,
    /// r: largest ratio of the principal curvatures (section 4.1).
    pub edge_ratio: f64,
    /// Largest number of extrema kept, spread over the image; one may become several keypoints.
    pub max_keypoints: usize,
}

impl Default for SiftOptions {
    fn default() -> Self {
        SiftOptions { intervals: 3, sigma: 1.6, double: true, contrast: 0.03, edge_ratio: 10.0, max_keypoints: 5000 }
    }
}

/// The features of `grey`, sorted by position.
///
/// The options must be within the ranges of [`AlignOptions::validate`](crate::align::AlignOptions::validate).
pub fn detect(grey: &Plane<u8>, options: &SiftOptions) -> Features {
    let space = ScaleSpace::new(grey.map(|v| f32::from(v) / 255.0), options);
    let mut found = extrema::find(&space, options);
    limit(&mut found, &space, (grey.width(), grey.height()), options.max_keypoints);
    let described: Vec<Vec<(Keypoint, Descriptor)>> = found
        .par_iter()
        .map(|extremum| {
            let level = extremum.level(&space);
            orientation::assign(level, extremum)
                .into_iter()
                .map(|angle| (extremum.keypoint(&space, angle), descriptor::describe(level, extremum, angle)))
                .collect()
        })
        .collect();
    let mut all: Vec<_> = described.concat();
    all.sort_by(|(a, _), (b, _)| {
        a.y.total_cmp(&b.y)
            .then(a.x.total_cmp(&b.x))
            .then(a.scale.total_cmp(&b.scale))
            .then(a.angle.total_cmp(&b.angle))
    });
    let (keypoints, descriptors) = all.into_iter().unzip();
    Features { keypoints, descriptors }
}

/// Number of cells along the long side of the image for [`limit`].
const CELLS: usize = 12;

/// Keeps at most `most` of `found`: the strongest of each cell of the image, so that all of it is covered.
///
/// What cells with few extrema do not use, the others do.
fn limit(found: &mut Vec<Extremum>, space: &ScaleSpace, (width, height): (usize, usize), most: usize) {
    if found.len() <= most {
        return;
    }
    let cell = (width.max(height) as f32 / CELLS as f32).max(1.0);
    let columns = (width as f32 / cell) as usize + 1;
    let rows = (height as f32 / cell) as usize + 1;
    let mut cells: Vec<Vec<(f32, usize)>> = vec![Vec::new(); columns * rows];
    for (i, extremum) in found.iter().enumerate() {
        let k = extremum.keypoint(space, 0.0);
        let at = ((k.y.max(0.0) / cell) as usize).min(rows - 1) * columns
            + ((k.x.max(0.0) / cell) as usize).min(columns - 1);
        cells[at].push((k.response, i));
    }
    // First the strongest of every cell, then the second strongest of every cell, and so on.
    let mut order: Vec<(usize, f32, usize)> = Vec::with_capacity(found.len());
    for cell in &mut cells {
        cell.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.extend(cell.iter().enumerate().map(|(rank, &(response, i))| (rank, response, i)));
    }
    order.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)).then(a.2.cmp(&b.2)));
    let mut keep = vec![false; found.len()];
    for &(_, _, i) in &order[..most] {
        keep[i] = true;
    }
    let mut keep = keep.into_iter();
    found.retain(|_| keep.next().unwrap_or(false));
}

#[cfg(test)]
mod tests;
