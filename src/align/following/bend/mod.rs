//! Bends: smooth motions that a homography does not describe, because of the lens or the shutter.
//!
//! In: what was [observed](super::Observed) in each frame. Out: a [`Bend`] for each frame, and how well it explains the
//! observations. Cost: some thousand multiply-adds for each observation and round.

pub(super) mod lens;
pub(super) mod shutter;

use crate::align::following::Picture;
use crate::align::following::explained::Explained;
use crate::align::motion::bend::{Bend, BendModel};
use crate::align::transform::off_level;
use nalgebra::Matrix3;

impl Picture {
    /// The bend of a frame whose displacements were measured from `homography`, in pixels of the level.
    fn bend(&self, model: BendModel, homography: &Matrix3<f64>) -> Bend {
        Bend::new(model, &off_level(homography, self.level), self.size)
    }
}

/// For each frame its bend, and how well it explains the observations; none for frames with too few observations.
pub(super) type Bends = Vec<Option<(Bend, Explained)>>;

#[cfg(test)]
mod tests;
