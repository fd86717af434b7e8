//! SIFT: keypoints that survive scale, rotation and, up to a point, exposure.
//!
//! In: a grey picture. Out: its [`Features`]. Cost: five Gaussians an octave over the picture (four thirds of it in
//! all, 16/3 where it is doubled first), then some thousand operations a keypoint. Source: Lowe, "Distinctive Image
//! Features from Scale-Invariant Keypoints", IJCV 60(2), 2004; each child is one of its sections.

mod descriptor;
mod extrema;
mod gradient;
mod orientation;
mod scale_space;

use crate::align::features::{Features, Keypoint};
use crate::plane::Plane;
use rayon::prelude::*;
use scale_space::ScaleSpace;

/// Settings of the detector; the defaults are the paper's.
#[derive(Debug, Clone, PartialEq)]
pub struct SiftOptions {
    /// s: intervals of scale in an octave (section 3.3).
    pub intervals: usize,
    /// The Gaussian's standard deviation at the first scale of an octave, in pixels (section 3.3).
    pub sigma: f64,
    /// Whether the picture is doubled first, for the features of smallest scale (section 3.3).
    pub double: bool,
    /// Least |D| at an extremum, grey values being 0..=1 (section 4).
    pub contrast: f64,
    /// r: largest ratio of the principal curvatures (section 4.1).
    pub edge_ratio: f64,
    /// At most so many keypoints, spread evenly over the picture.
    pub max_keypoints: usize,
}

impl Default for SiftOptions {
    fn default() -> Self {
        SiftOptions { intervals: 3, sigma: 1.6, double: true, contrast: 0.03, edge_ratio: 10.0, max_keypoints: 5000 }
    }
}

/// The features of `grey`, sorted by place. The options are within the ranges of
/// [`AlignOptions::validate`](crate::align::AlignOptions::validate).
pub fn detect(grey: &Plane<u8>, options: &SiftOptions) -> Features {
    let base = Plane::from_rows(grey.width(), grey.height(), |y, row| {
        for (v, g) in row.iter_mut().zip(grey.row(y)) {
            *v = f32::from(*g) / 255.0;
        }
    });
    let space = ScaleSpace::new(&base, options);
    let mut found = extrema::find(&space, options);
    spread(&mut found, grey.width(), grey.height(), options.max_keypoints, |e| e.keypoint(&space, 0.0));
    let described: Vec<Vec<(Keypoint, crate::align::features::Descriptor)>> = found
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

/// Cells along the long side in which keypoints are rationed.
const CELLS: usize = 12;

/// Keeps at most `most` of `found`: in each of the picture's cells the strongest, with what poor cells leave given to
/// the rich ones.
fn spread<T>(found: &mut Vec<T>, width: usize, height: usize, most: usize, keypoint: impl Fn(&T) -> Keypoint) {
    if found.len() <= most {
        return;
    }
    let cell = (width.max(height) as f32 / CELLS as f32).max(1.0);
    let columns = (width as f32 / cell) as usize + 1;
    let rows = (height as f32 / cell) as usize + 1;
    let mut cells: Vec<Vec<(f32, usize)>> = vec![Vec::new(); columns * rows];
    for (i, item) in found.iter().enumerate() {
        let k = keypoint(item);
        let at = ((k.y.max(0.0) / cell) as usize).min(rows - 1) * columns
            + ((k.x.max(0.0) / cell) as usize).min(columns - 1);
        cells[at].push((k.response, i));
    }
    // All the cells' strongest first, then all the cells' second strongest, and so on.
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
