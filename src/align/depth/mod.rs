//! Depth: the motion of each pixel of a scene in which nothing moved but the camera.
//!
//! In: a bracket and its alignment. Out: a [`Relief`]: one relative depth for each pixel of the reference, and a
//! [`Camera`] for each frame, which maps a pixel and its depth to a position in the frame. Cost: about two seconds of
//! two cores for five frames of 1.5 megapixels.
//!
//! One homography fits all frames of a scene only if the scene is flat or far, or the camera only turned. Otherwise
//! near and far things are displaced against each other. If nothing in the scene moved, these displacements have one
//! cause in all frames, the depth. It is measured from all frames together: where one frame is clipped, others are not.
//!
//! 1. `sights`: the displacements of patches in each frame. `direction`, `geometry`: the cameras that explain them.
//! 2. `cost_volume`: how well each depth explains the frames. `semi_global`: the best depths. `ground`: the depth where
//!    nothing is known. `smoothing`: planes stay planes.
//! 3. `motion`: the motion of each frame, with depth or without.

mod camera;
mod cost_volume;
mod direction;
mod geometry;
mod ground;
mod motion;
mod semi_global;
mod sights;
mod smoothing;

pub use motion::{Motion, motions};

use crate::align::Alignment;
use crate::align::depth::camera::{Camera, CameraMotion, Coordinates};
use crate::align::depth::cost_volume::{CostVolume, Labels, usable};
use crate::align::depth::geometry::Geometry;
use crate::align::depth::ground::Ground;
use crate::align::depth::sights::Sight;
use crate::align::grey::{GreyPyramid, content_and_pyramid, measured_level};
use crate::align::local::patches;
use crate::align::refinement::FramePair;
use crate::align::transform::{level_to_full, on_level};
use crate::bracket::Bracket;
use crate::budget::Demand;
use crate::error::Result;
use crate::plane::{Plane, map_at_once};

/// Distance between labels: the displacement in the frame that moves most, in pixels of the level.
const LABEL_PX: f64 = 0.5;
/// Largest number of labels.
const MOST_LABELS: usize = Demand::MOST_LABELS as usize;
/// The labels cover the depths of all patches but this share at each end, and a margin.
const OUTLYING: f64 = 0.005;

/// The depth of a scene, and the cameras of the frames.
#[derive(Debug, Clone)]
struct Relief {
    /// Level of the grey pyramid that has one depth for each pixel.
    level: usize,
    /// Relative depth of each pixel of the level.
    depths: Plane<f32>,
    /// The camera of each frame, in pixels of the full size; none for the reference and for frames whose camera is
    /// unknown.
    cameras: Vec<Option<Camera>>,
}

impl Relief {
    /// Measures the depth of the scene of `bracket`; none if one homography for each frame explains it.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch) if a frame on disk cannot be read.
    fn measure(bracket: &Bracket, alignment: &Alignment) -> Result<Option<Self>> {
        let prepared = bracket.map_whole(content_and_pyramid);
        let pyramids: Vec<GreyPyramid> = prepared.into_iter().map(|p| p.map(|p| p.1)).collect::<Result<Vec<_>>>()?;
        Ok(Self::of(&pyramids, bracket.reference_index(), alignment, bracket.at_once()))
    }

    fn of(pyramids: &[GreyPyramid], reference: usize, alignment: &Alignment, at_once: usize) -> Option<Self> {
        let (level, (width, height)) = (measured_level(&pyramids[reference]), pyramids[reference].size(0));
        let coordinates = Coordinates::new(pyramids[reference].size(level));
        let transform = |i: usize| alignment.placements[i].transform().filter(|_| i != reference);
        let frames: Vec<Vec<Sight>> = map_at_once(pyramids.len(), at_once, |i| {
            let Some(transform) = transform(i) else { return Vec::new() };
            let pair = FramePair::new(&pyramids[reference], &pyramids[i], &transform);
            let found = patches(&pair, &transform.matrix(width, height));
            found.iter().map(|(patch, d)| Sight::new(*patch, d, &coordinates)).collect()
        });
        let patches = frames.iter().flatten().map(|s| s.patch + 1).max()?;
        let geometry = geometry::fit(&frames, patches, coordinates.unit)?;
        let labels = labels(&geometry)?;
        let camera = |i: usize| {
            let h = on_level(&transform(i)?.matrix(width, height), level);
            Some(Camera::new(&h, geometry.motions[i].as_ref()?, &coordinates))
        };
        let cameras: Vec<Option<Camera>> = (0..pyramids.len()).map(camera).collect();
        let greys: Vec<&Plane<u8>> = pyramids.iter().map(|pyramid| pyramid.level(level)).collect();
        let smooth = labelled(greys[reference], &greys, &cameras, &labels);
        let cameras = cameras.into_iter().map(|c| c.map(|c| c.at_full_size(&level_to_full(level)))).collect();
        Some(Relief { level, depths: smooth.map(|label| labels.depth(label) as f32), cameras })
    }

    /// Relative depth of the pixel (x, y) of the full size.
    fn depth(&self, x: usize, y: usize) -> f32 {
        let scale = (1u64 << self.level) as f32;
        let at = |v: usize, count: usize| {
            let v = ((v as f32 + 0.5) / scale - 0.5).clamp(0.0, (count - 1) as f32);
            let first = (v as usize).min(count.saturating_sub(2));
            (first, (first + 1).min(count - 1), v - first as f32)
        };
        let (left, right, fx) = at(x, self.depths.width());
        let (top, bottom, fy) = at(y, self.depths.height());
        let d = |x, y| self.depths.at(x, y);
        let upper = d(left, top) + fx * (d(right, top) - d(left, top));
        let lower = d(left, bottom) + fx * (d(right, bottom) - d(left, bottom));
        upper + fy * (lower - upper)
    }
}

/// Returns the label of each pixel of the reference, with a fraction. `greys` are the frames; those that have a camera
/// are compared with the reference.
fn labelled(reference: &Plane<u8>, greys: &[&Plane<u8>], cameras: &[Option<Camera>], labels: &Labels) -> Plane<f32> {
    let seen: Vec<(Plane<f32>, Camera)> =
        greys.iter().zip(cameras).filter_map(|(grey, camera)| Some((usable(grey), (*camera)?))).collect();
    let mut volume = CostVolume::new(&usable(reference), &seen, labels);
    let mut choices = semi_global::choose(&volume, reference);
    if let Some(ground) = Ground::of(&choices) {
        volume.expect(|x, y| ground.label(x, y));
        choices = semi_global::choose(&volume, reference);
    }
    drop(volume);
    smoothing::smooth(&choices, reference)
}

/// The labels for the depths of the patches; none if these do not differ.
fn labels(geometry: &Geometry) -> Option<Labels> {
    let mut depths: Vec<f64> = geometry.depths.iter().flatten().copied().collect();
    depths.sort_by(f64::total_cmp);
    let last = depths.len().checked_sub(1)?;
    let outlying = (OUTLYING * last as f64) as usize;
    let (nearest, farthest) = (depths[outlying], depths[last - outlying]);
    // Displacement of a pixel of relative depth 1, in the frame that moves most.
    let px = |m: &CameraMotion| (m.0[8] * m.0[8] + m.0[9] * m.0[9]).sqrt();
    let most = geometry.motions.iter().flatten().map(px).fold(0.0, f64::max);
    let margin = 0.1 * (farthest - nearest) + 1.0 / most;
    let (first, range) = (nearest - margin, farthest - nearest + 2.0 * margin);
    let count = ((range * most / LABEL_PX).ceil() as usize + 1).clamp(4, MOST_LABELS);
    (range.is_finite()).then(|| Labels { first, step: range / (count - 1) as f64, count })
}

#[cfg(test)]
mod tests;
