//! Depth: the relative depth of each pixel of a scene in which nothing moved but the camera.
//!
//! In: the result of the search for transforms. Out: a [`Relief`]: one relative depth for each pixel of the reference,
//! and for each frame a [`Camera`], which maps a pixel and its depth to a position in the frame, and which pixels are
//! hidden there. Cost: about ten seconds of one core for five frames of 1.5 megapixels.
//!
//! One homography fits all frames of a scene only if the scene is flat or far, or the camera only turned. Otherwise
//! near and far things are displaced against each other. If nothing in the scene moved, these displacements have one
//! cause in all frames, the depth. It is measured from all frames together: where one frame is clipped, others are not.
//!
//! 1. `geometry`: the camera motions that explain the displacements of patches.
//! 2. `cost_volume`: how well each depth explains the frames. `semi_global`: the best depths. `ground`: the depth where
//!    nothing is known. `smoothing`: planes stay planes.
//! 3. `upsampling`: the depths of a finer level. `visibility`: which pixels something nearer hides in a frame.

mod cost_volume;
mod geometry;
mod ground;
mod semi_global;
mod smoothing;
mod upsampling;
mod visibility;

use crate::align::depth::cost_volume::{Compared, CostVolume, Labels};
use crate::align::depth::geometry::camera_motion::{CameraMotion, Coordinates};
use crate::align::depth::geometry::observations::Observation;
use crate::align::depth::geometry::{Explained, Geometry, LEAST_DISPLACED};
use crate::align::depth::ground::Ground;
use crate::align::depth::semi_global::Choice;
use crate::align::grey::{GreyPyramid, finest_level, measured_level};
use crate::align::ladder::Searched;
use crate::align::local::patches;
use crate::align::motion::camera::Camera;
use crate::align::motion::relief::{Relief, View};
use crate::align::photometric::ToneTables;
use crate::align::refinement::FramePair;
use crate::align::result::{Displaced, Estimate, Placement, RejectedBy};
use crate::align::transform::{Model, Transform, full_to_level, level_to_full, on_level};
use crate::bracket::Bracket;
use crate::budget::Demand;
use crate::plane::{Plane, map_at_once};
use nalgebra::Matrix3;

/// Distance between labels: the displacement in the frame that moves most, in pixels of the level.
const LABEL_PX: f64 = 0.5;
/// Largest number of labels.
const MOST_LABELS: usize = Demand::MOST_LABELS as usize;
/// The labels cover the depths of all patches but this share at each end, and a margin.
const OUTLYING: f64 = 0.005;
/// Number of pixels that are matched together. This limits the memory.
const STRIP_PIXELS: usize = Demand::STRIP_PIXELS as usize;
/// Rows above and below a strip that are matched with it, because a label depends on its neighbours.
const BESIDE: usize = 16;
/// If depth leaves this share of the patches of a frame unexplained, its confidence is one half.
const UNEXPLAINED_HALVES: f64 = 0.1;
/// Depths of neighbours differ by at least this if they are on different surfaces: the displacement in the frame that
/// moves most, in pixels of the level.
const JUMP_PX: f64 = 1.0;

/// Measures the depth of the scene of `bracket`; none if one homography for each frame explains it.
///
/// With depth, the errors and confidences of the placed frames are computed again. A frame that was rejected because
/// parts of it disagree with its transform is placed if they agree with the depth that the placed frames show.
pub(crate) fn follow(bracket: &Bracket, searched: &mut Searched) -> Option<Relief> {
    let reference = bracket.reference_index();
    let may_have_depth = |placement: &Placement| match placement {
        // The transform was given, so it was not checked locally.
        Placement::Placed(Estimate { displaced: None, .. }) => true,
        Placement::Placed(estimate) => estimate.displaced.is_some_and(|d| d.fraction >= LEAST_DISPLACED),
        _ => false,
    };
    if !searched.placements.iter().any(may_have_depth) {
        return None;
    }
    let starts: Vec<Option<Start>> = (0..searched.placements.len())
        .map(|i| Start::of(&searched.placements[i], searched.unaccepted[i]).filter(|_| i != reference))
        .collect();
    let (relief, explained) = relief(&searched.pyramids, reference, &starts, bracket.at_once())?;
    let level = measured_level(&searched.pyramids[reference]);
    let scale = level_to_full(level)[(0, 0)];
    for ((placement, start), (i, explained)) in
        searched.placements.iter_mut().zip(&starts).zip(explained.iter().enumerate())
    {
        if let (Some(start), Some(_)) = (start, relief.view(i)) {
            *placement = placed(start, explained, scale);
        }
    }
    Some(relief)
}

/// The transform from which the displacements of a frame are measured.
struct Start {
    transform: Transform,
    /// Whether the frame was rejected because parts of it disagree with the transform.
    is_rejected: bool,
}

impl Start {
    fn of(placement: &Placement, unaccepted: Option<Transform>) -> Option<Self> {
        match placement {
            // A frame from a tripod is not resampled only because things moved in the scene.
            Placement::Placed(estimate) if estimate.transform == Transform::Identity => None,
            Placement::Placed(estimate) => Some(Start { transform: estimate.transform, is_rejected: false }),
            Placement::Rejected { by: RejectedBy::Alignment, .. } => {
                Some(Start { transform: unaccepted?, is_rejected: true })
            }
            _ => None,
        }
    }
}

/// The placement of a frame that depth explains. `scale` is the side of a pixel of the level, in pixels.
fn placed(start: &Start, explained: &Explained, scale: f64) -> Placement {
    let (fraction, px) = (explained.unexplained(), scale * explained.off);
    let square = |v: f64| v * v;
    Placement::Placed(Estimate {
        transform: start.transform,
        model: Model::of(&start.transform),
        error_px: Some(scale * explained.rms),
        confidence: 1.0 / (1.0 + square(square(fraction / UNEXPLAINED_HALVES))),
        displaced: Some(Displaced { fraction, px }),
        reason: None,
    })
}

/// Like [`follow`]; also returns how well depth explains each frame.
fn relief(
    pyramids: &[GreyPyramid],
    reference: usize,
    starts: &[Option<Start>],
    at_once: usize,
) -> Option<(Relief, Vec<Explained>)> {
    let (level, (width, height)) = (measured_level(&pyramids[reference]), pyramids[reference].size(0));
    let coordinates = Coordinates::new(pyramids[reference].size(level));
    let observed: Vec<Vec<Observation>> = map_at_once(pyramids.len(), at_once, |i| {
        let Some(Start { transform, .. }) = &starts[i] else { return Vec::new() };
        let pair = FramePair::new(&pyramids[reference], &pyramids[i], transform);
        let found = patches(&pair, &transform.matrix(width, height));
        found.iter().map(|(patch, d)| Observation::new(*patch, d, &coordinates)).collect()
    });
    let patches = observed.iter().flatten().map(|s| s.patch + 1).max()?;
    let is_rejected = |i: usize| starts[i].as_ref().is_some_and(|start| start.is_rejected);
    let mut frames: Vec<&[Observation]> =
        (0..observed.len()).map(|i| if is_rejected(i) { &[][..] } else { &observed[i] }).collect();
    let mut geometry = geometry::fit(&frames, patches, coordinates.unit).filter(Geometry::is_depth)?;
    let is_placed = |i: &usize| geometry.explains(&observed[*i], coordinates.unit).is_convincing();
    let placed: Vec<usize> = (0..frames.len()).filter(|&i| is_rejected(i)).filter(is_placed).collect();
    if !placed.is_empty() {
        placed.into_iter().for_each(|i| frames[i] = &observed[i]);
        geometry = geometry::fit(&frames, patches, coordinates.unit).filter(Geometry::is_depth)?;
    }
    let labels = labels(&geometry)?;
    let camera = |i: usize| {
        let h = on_level(&starts[i].as_ref()?.transform.matrix(width, height), level);
        Some(geometry.motions[i].as_ref()?.camera(&h, &coordinates))
    };
    let cameras: Vec<Option<Camera>> = (0..pyramids.len()).map(camera).collect();
    let greys: Vec<&Plane<u8>> = pyramids.iter().map(|pyramid| pyramid.level(level)).collect();
    let compared = |i: usize| {
        let h = on_level(&starts[i].as_ref()?.transform.matrix(width, height), level);
        let tones = ToneTables::between(greys[reference], greys[i], &h);
        Some(Compared::new(greys[reference], greys[i], &tones, cameras[i]?))
    };
    let compared: Vec<Compared> = (0..pyramids.len()).filter_map(compared).collect();
    let smooth = labelled(greys[reference], &compared, &labels);
    drop(compared);
    let mut depths = smooth.map(|label| labels.depth(label) as f32);
    let jump = (labels.step * JUMP_PX / LABEL_PX) as f32;
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
    let hidden = visibility::hidden(&depths, greys[reference], &greys, &of_finest);
    let views = full.into_iter().zip(hidden).map(|(camera, hidden)| Some(View { camera: camera?, hidden: hidden? }));
    Some((Relief::new(finest, depths, jump, views.collect()), geometry.explained))
}

/// Returns the label of each pixel of the `reference`, with a fraction.
fn labelled(reference: &Plane<u8>, frames: &[Compared], labels: &Labels) -> Plane<f32> {
    let mut choices = matched(reference, frames, labels, None);
    if let Some(ground) = Ground::of(&choices) {
        choices = matched(reference, frames, labels, Some(&ground));
    }
    smoothing::smooth(&choices, reference)
}

/// Chooses the label of each pixel, strip by strip; with `ground`, its labels are preferred.
fn matched(reference: &Plane<u8>, frames: &[Compared], labels: &Labels, ground: Option<&Ground>) -> Plane<Choice> {
    let (width, height) = (reference.width(), reference.height());
    let strip = (STRIP_PIXELS / width).saturating_sub(2 * BESIDE).max(BESIDE);
    let mut choices = Vec::with_capacity(width * height);
    for first in (0..height).step_by(strip) {
        let end = (first + strip).min(height);
        let rows = first.saturating_sub(BESIDE)..(end + BESIDE).min(height);
        let mut volume = CostVolume::new(width, rows.clone(), frames, labels);
        if let Some(ground) = ground {
            volume.expect(|x, y| ground.label(x, rows.start + y));
        }
        let grey = Plane::from_vec(width, rows.len(), reference.rows(rows.clone()).to_vec());
        choices.extend_from_slice(semi_global::choose(&volume, &grey).rows(first - rows.start..end - rows.start));
    }
    Plane::from_vec(width, height, choices)
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
