//! SIFT: keypoints that are invariant to scale and rotation and, within limits, to exposure.
//!
//! In: a grey image. Out: its [`Features`]. Cost: five Gaussian filters in every octave with the default number of
//! intervals, then some thousand operations per keypoint. All octaves together have 4/3 of the pixels of the image, or
//! 16/3 if the image is doubled first. Source: Lowe, "Distinctive Image Features from Scale-Invariant Keypoints", IJCV
//! 60(2), 2004; the submodules follow its sections.

mod descriptor;
mod extrema;
mod gradient;
mod orientation;
mod scale_space;

use crate::align::features::{Descriptors, Features, Keypoint, SiftDescriptor, spread};
use crate::plane::Plane;
pub(super) use descriptor::LENGTH;
use rayon::prelude::*;
use scale_space::ScaleSpace;

/// Settings of the detector. The defaults are those of the paper, where it states values.
#[derive(Debug, Clone, PartialEq)]
pub struct SiftOptions {
    /// Number of scale intervals per octave, called s in section 3.
    pub intervals: usize,
    /// Standard deviation of the Gaussian at the first scale of an octave, in pixels (section 3.3).
    pub sigma: f64,
    /// Whether to double the image first, to find features of the smallest scale (section 3.3).
    pub double: bool,
    /// Least absolute value of the difference of Gaussians at an extremum, for grey values scaled to 0..=1 (section 4).
    pub contrast: f64,
    /// Largest ratio of the larger to the smaller principal curvature, called r in section 4.1.
    pub edge_ratio: f64,
    /// Largest number of extrema that are kept, spread over the image. An extremum with several directions becomes
    /// several keypoints.
    pub max_keypoints: usize,
}

impl Default for SiftOptions {
    fn default() -> Self {
        SiftOptions { intervals: 3, sigma: 1.6, double: true, contrast: 0.03, edge_ratio: 10.0, max_keypoints: 5000 }
    }
}

/// Detects the features of `grey`, sorted by position.
///
/// The options must be within the ranges of [`AlignOptions::validate`](crate::align::AlignOptions::validate).
pub fn detect(grey: &Plane<u8>, options: &SiftOptions) -> Features {
    let space = ScaleSpace::new(grey.map(|v| f32::from(v) / 255.0), options);
    let found = extrema::find(&space, options);
    let points = found.iter().map(|extremum| extremum.keypoint(&space, 0.0)).collect::<Vec<_>>();
    let found = spread::strongest(found, &points, (grey.width(), grey.height()), options.max_keypoints);
    let described: Vec<Vec<(Keypoint, SiftDescriptor)>> = found
        .par_iter()
        .map(|extremum| {
            let level = extremum.level(&space);
            orientation::assign(level, extremum)
                .into_iter()
                .map(|angle| (extremum.keypoint(&space, angle), descriptor::describe(level, extremum, angle)))
                .collect()
        })
        .collect();
    let (keypoints, descriptors) = spread::by_position(described.concat()).into_iter().unzip();
    Features { keypoints, descriptors: Descriptors::Sift(descriptors) }
}

#[cfg(test)]
mod tests;
