//! SURF: keypoints and descriptors from sums over boxes of pixels. On photographs, SURF finds about two and a half
//! times as many keypoints as SIFT (table in `docs/how/features.md`).
//!
//! In: a grey image. Out: its [`Features`]. Cost: about 20 additions per pixel for each of the four filters of the
//! first octave, less than half of that for each further octave, and some thousand additions per keypoint. Source: Bay,
//! Tuytelaars & Van Gool, "SURF: Speeded Up Robust Features", ECCV 2006; each submodule implements one of its sections.

mod descriptor;
mod hessian;
mod integral;
mod orientation;

pub(super) use descriptor::LENGTH;

use crate::align::features::{Descriptors, Features, Keypoint, SurfDescriptor, spread};
use crate::plane::Plane;
use crate::pyramid::double;
use integral::Integral;
use rayon::prelude::*;

/// Settings of the detector. The defaults are those of the paper, where it states values.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfOptions {
    /// Number of octaves. After four octaves, keypoints become rare (section 3).
    pub octaves: usize,
    /// Whether to double the image first, to find features of the smallest scale (section 3).
    pub double: bool,
    /// Least determinant of the Hessian at an extremum, for grey values scaled to 0..=1.
    pub contrast: f64,
    /// Largest number of keypoints that are kept, spread over the image.
    pub max_keypoints: usize,
}

impl Default for SurfOptions {
    fn default() -> Self {
        SurfOptions { octaves: 4, double: true, contrast: 0.001, max_keypoints: 5000 }
    }
}

/// Detects the features of `grey`, sorted by position.
///
/// The options must be within the ranges of [`AlignOptions::validate`](crate::align::AlignOptions::validate).
pub fn detect(grey: &Plane<u8>, options: &SurfOptions) -> Features {
    let step = if options.double { 0.5 } else { 1.0 };
    let integral = if options.double {
        // Grey values are not negative, so adding 0.5 before the conversion rounds them to the nearest integer.
        Integral::new(&double(&grey.map(f32::from)).map(|v| (v + 0.5) as u8))
    } else {
        Integral::new(grey)
    };
    let found = hessian::find(&integral, options);
    let size = (integral.width(), integral.height());
    let found = spread::strongest(found.clone(), &found, size, options.max_keypoints);
    let described: Vec<(Keypoint, SurfDescriptor)> = found
        .par_iter()
        .map(|point| {
            let angle = orientation::assign(&integral, point);
            let descriptor = descriptor::describe(&integral, point, angle);
            let keypoint =
                Keypoint { x: point.x * step, y: point.y * step, scale: point.scale * step, angle, ..*point };
            (keypoint, descriptor)
        })
        .collect();
    let (keypoints, descriptors) = spread::by_position(described).into_iter().unzip();
    Features { keypoints, descriptors: Descriptors::Surf(descriptors) }
}

#[cfg(test)]
mod tests;
