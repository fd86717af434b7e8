//! Bends: smooth motions that a homography does not describe, because of the lens or the shutter.
//!
//! In: what was [observed](super::Observed) in each frame. Out: a [`Bend`] for each
//! frame, and how well it explains the observations. Cost: some thousand multiply-adds for each observation and round.

pub(super) mod lens;
pub(super) mod shutter;

use crate::align::following::Picture;
use crate::align::following::explained::Explained;
use crate::align::motion::bend::{Bend, Course};
use crate::align::transform::off_level;
use nalgebra::Matrix3;

impl Picture {
    /// The bend of a frame whose displacements were measured from `homography`, in pixels of the level.
    fn bend(&self, course: Course, homography: &Matrix3<f64>) -> Bend {
        Bend::new(course, &off_level(homography, self.level), self.size)
    }
}

/// The bends of all frames.
#[derive(Debug, Clone)]
pub(super) struct Bends {
    /// The bend of each frame; none for frames that are not observed.
    pub(super) bends: Vec<Option<Bend>>,
    /// How well it explains the observations.
    pub(super) explained: Vec<Explained>,
}

#[cfg(test)]
mod tests;
