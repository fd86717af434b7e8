//! Depth: the relative depth of each pixel of a scene in which nothing moved but the camera.
//!
//! In: the result of the search for transforms. Out: a [`Relief`]: one relative depth for each pixel of the reference,
//! and for each frame a [`Camera`], which maps a pixel and its depth to a position in the frame, and which pixels are
//! hidden there. Cost: about four seconds of one core for three frames of 1.5 megapixels.
//!
//! One homography fits all frames of a scene only if the scene is flat or far, or the camera only turned. Otherwise
//! near and far things are displaced against each other. If nothing in the scene moved, these displacements have one
//! cause in all frames, the depth. It is measured from all frames together: where one frame is clipped, others are not.
//!
//! 1. `geometry`: the camera motions that explain the displacements of patches.
//! 2. `cost_volume`: how well each depth explains the frames. `semi_global`: the best depths. `surfaces`: planes of the
//!    scene, for pixels of which nothing is known. `windows`: the costs of pixels near jumps. `jumps`: jumps are at
//!    the edges of the picture. `smoothing`: planes stay planes.
//! 3. `upsampling`: the depths of a finer level. `visibility`: which pixels something nearer hides in a frame.

mod cost_volume;
mod geometry;
mod jumps;
mod semi_global;
mod smoothing;
mod surfaces;
mod upsampling;
mod visibility;
mod windows;

use crate::align::following::depth::cost_volume::{Compared, CostVolume, Labels};
use crate::align::following::depth::geometry::Geometry;
use crate::align::following::depth::geometry::camera_motion::CameraMotion;
use crate::align::following::depth::surfaces::Surfaces;
use crate::align::following::explained::Explained;
use crate::align::following::{Observed, Picture};
use crate::align::grey::{GreyPyramid, finest_level};
use crate::align::motion::camera::Camera;
use crate::align::motion::relief::{Relief, View};
use crate::align::photometric::ToneTables;
use crate::align::transform::{full_to_level, level_to_full};
use crate::budget::Demand;
use crate::plane::Plane;
use nalgebra::Matrix3;

/// Distance between labels: the displacement in the frame that moves most, in pixels of the level.
const LABEL_PX: f64 = 0.5;
/// Largest number of labels.
const MOST_LABELS: usize = Demand::MOST_LABELS as usize;
/// The labels cover the depths of all patches but this share at each end, and a margin.
const OUTLYING: f64 = 0.005;

/// Measures the depth of the scene; none if depth does not explain what homographies leave unexplained. A frame that
/// was rejected gets a view if it agrees with the depth that the other frames show. Also returns how well depth
/// explains each frame.
pub(super) fn relief(
    pyramids: &[GreyPyramid],
    reference: usize,
    frames: &[Option<Observed>],
    picture: &Picture,
) -> Option<(Relief, Vec<Explained>)> {
    let (level, coordinates) = (picture.level, &picture.coordinates);
    let geometry = geometry(frames, coordinates.unit)?;
    let labels = labels(&geometry)?;
    let camera = |i: usize| Some(geometry.motions[i].as_ref()?.camera(&frames[i].as_ref()?.homography, coordinates));
    let cameras: Vec<Option<Camera>> = (0..pyramids.len()).map(camera).collect();
    let greys: Vec<&Plane<u8>> = pyramids.iter().map(|pyramid| pyramid.level(level)).collect();
    let compared = |i: usize| {
        let tones = ToneTables::between(greys[reference], greys[i], &frames[i].as_ref()?.homography);
        Some(Compared::new(greys[reference], greys[i], &tones, cameras[i]?))
    };
    let compared: Vec<Compared> = (0..pyramids.len()).filter_map(compared).collect();
    let smooth = labelled(greys[reference], compared, &labels);
    let mut depths = smooth.map(|label| labels.depth(label) as f32);
    let jump = labels.step as f32 * jumps::JUMP;
    let finest = finest_level(&pyramids[reference]);
    for level in (finest..level).rev() {
        let [coarse, fine] = [level + 1, level].map(|level| pyramids[reference].level(level));
        depths = upsampling::finer(&depths, jump, coarse, fine);
    }
    let between =
        |from: &Matrix3<f64>, to: &Matrix3<f64>| cameras.iter().map(|c| Some((*c)?.between(from, to))).collect();
    let full: Vec<Option<Camera>> = between(&full_to_level(level), &level_to_full(level));
    let to_finest = (full_to_level(level) * level_to_full(finest), full_to_level(finest) * level_to_full(level));
    let of_finest: Vec<Option<Camera>> = between(&to_finest.0, &to_finest.1);
    let greys: Vec<&Plane<u8>> = pyramids.iter().map(|pyramid| pyramid.level(finest)).collect();
    let visibilities = visibility::of(&depths, greys[reference], &greys, &of_finest);
    let view =
        |(camera, visibility): (Option<Camera>, Option<_>)| Some(View { camera: camera?, visibility: visibility? });
    let views = full.into_iter().zip(visibilities).map(view);
    Some((Relief::new(finest, depths, jump, views.collect()), geometry.explained))
}

/// The motions of the frames, and the depths of the patches; none if depth does not explain the placed frames. A frame
/// that was rejected contributes if it agrees with the others.
///
/// The depths of two pictures alone may be wrong where a pattern repeats, so a rejected frame that disagrees with these
/// depths may still be right. Therefore each rejected frame is fitted together with the frames that contribute. The one
/// that is explained best contributes too, and so on, until none is explained well enough.
fn geometry(frames: &[Option<Observed>], unit: f64) -> Option<Geometry> {
    let patches = frames.iter().flatten().flat_map(|f| &f.observations).map(|o| o.patch + 1).max()?;
    let is_rejected = |i: usize| frames[i].as_ref().is_some_and(|frame| frame.start.is_rejected);
    let mut is_used: Vec<bool> = (0..frames.len()).map(|i| !is_rejected(i)).collect();
    let fit = |is_used: &[bool]| {
        let used = |i: usize| frames[i].as_ref().filter(|_| is_used[i]).map_or(&[][..], |f| &f.observations);
        geometry::fit(&(0..frames.len()).map(used).collect::<Vec<_>>(), patches, unit)
    };
    let mut geometry = fit(&is_used).filter(Geometry::is_depth)?;
    loop {
        let with = |i: usize| {
            let mut is_used = is_used.clone();
            is_used[i] = true;
            Some((i, fit(&is_used)?))
        };
        let joined = (0..frames.len()).filter(|&i| !is_used[i]).filter_map(with);
        let unexplained = |(i, geometry): &(usize, Geometry)| geometry.explained[*i].unexplained();
        match joined.min_by(|a, b| unexplained(a).total_cmp(&unexplained(b))) {
            Some((i, joined)) if joined.explained[i].is_convincing() && joined.is_depth() => {
                geometry = joined;
                is_used[i] = true;
            }
            _ => return Some(geometry),
        }
    }
}

/// Returns the label of each pixel of the `reference`, with a fraction.
fn labelled(reference: &Plane<u8>, frames: Vec<Compared>, labels: &Labels) -> Plane<f32> {
    let mut volume = CostVolume::new((reference.width(), reference.height()), &frames, labels);
    drop(frames);
    let mut choices = semi_global::choose(&volume, reference);
    // In a scene without planes, such as hills, depth jumps rarely, and most of the jumps that are found are errors.
    if let Some(surfaces) = Surfaces::of(&choices) {
        windows::select(&mut volume, &choices, reference);
        drop(choices);
        volume.expect(|x, y| surfaces.labels(x, y));
        choices = jumps::at_edges(&semi_global::choose(&volume, reference), reference);
        surfaces.attract(&mut choices, &volume);
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
