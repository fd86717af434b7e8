//! Following: the motion of each frame, where one homography for each frame does not suffice.
//!
//! In: the result of the search for transforms. Out: [`Followed`], and new errors and confidences. Cost: nothing if all
//! transforms fit everywhere; otherwise the block matching of [`local`](crate::align::local), and the fits.
//!
//! 1. `observations`: the displacements of small patches from the positions that the transforms give. `homography`: the
//!    best that one homography can do. `explained`: whether a motion explains them better.
//! 2. `bend`: the distortion of the lens, or the motion of the camera while the rows were read. A bend has few
//!    parameters, so it also holds where nothing can be matched.
//! 3. `depth`: the depth of each pixel. It is measured only if no bend suffices.

mod bend;
mod depth;
mod explained;
mod homography;
mod observations;

use crate::align::following::bend::{Bends, lens, shutter};
use crate::align::following::explained::{Explained, LEAST_OBSERVED};
use crate::align::following::homography::Homography;
use crate::align::following::observations::Observation;
use crate::align::grey::{GreyPyramid, measured_level};
use crate::align::ladder::Searched;
use crate::align::local::{Displacements, near_patches, patches};
use crate::align::motion::coordinates::Coordinates;
use crate::align::motion::{Bend, Followed};
use crate::align::refinement::FramePair;
use crate::align::result::{Displaced, Estimate, Placement, RejectedBy};
use crate::align::transform::{Model, Transform, level_to_full, on_level};
use crate::bracket::Bracket;
use crate::plane::map_at_once;
use nalgebra::Matrix3;
use std::sync::Arc;

/// Bends are fitted only if the errors of frames are at least this, in pixels of the full size.
const LEAST_ERROR_PX: f64 = 0.1;
/// Depth is measured only if at least this share of the parts of a frame are displaced.
const LEAST_DISPLACED: f64 = 0.02;
/// Number of observations of a frame to which bends and cameras are fitted. They have at most 32 parameters.
const MOST_FITTED: usize = 1500;
/// If a motion leaves this share of the patches of a frame unexplained, its confidence is one half.
const UNEXPLAINED_HALVES: f64 = 0.1;

/// The transform from which the displacements of a frame are measured.
#[derive(Debug, Clone, Copy)]
struct Start {
    transform: Transform,
    /// Whether the frame was rejected because parts of it disagree with the transform.
    is_rejected: bool,
}

/// The displacements in a frame.
#[derive(Debug, Clone)]
struct Observed {
    observations: Vec<Observation>,
    /// The transform from which they were measured,
    start: Start,
    /// and its homography, in pixels of the level.
    homography: Matrix3<f64>,
    /// The best small homography after it.
    plain: Homography,
}

impl Observed {
    fn new(observations: Vec<Observation>, start: Start, homography: Matrix3<f64>) -> Self {
        let plain = homography::fit(some(&observations));
        Observed { observations, start, homography, plain }
    }

    /// Whether bends may be fitted to the frame.
    fn is_usable(&self) -> bool {
        !self.start.is_rejected && self.observations.len() >= LEAST_OBSERVED
    }
}

/// Some of the `observations`, evenly spread: between [`MOST_FITTED`] and twice as many, if there are so many.
fn some(observations: &[Observation]) -> impl Iterator<Item = &Observation> + Clone {
    observations.iter().step_by((observations.len() / MOST_FITTED).max(1))
}

/// The picture in which motions are fitted.
#[derive(Debug, Clone, Copy)]
struct Picture {
    /// The level of the grey pyramid on which displacements are measured.
    level: usize,
    /// Its coordinates.
    coordinates: Coordinates,
    /// Its height, in units of the coordinates.
    height: f64,
    /// The full size, in pixels.
    size: (usize, usize),
}

impl Picture {
    fn of(pyramid: &GreyPyramid) -> Self {
        let level = measured_level(pyramid);
        let coordinates = Coordinates::new(pyramid.size(level));
        let height = pyramid.size(level).1 as f64 / coordinates.unit;
        Picture { level, coordinates, height, size: pyramid.size(0) }
    }
}

/// Follows what the homographies of the frames of `bracket` do not describe; none if they suffice, or if nothing else
/// explains the displacements.
///
/// The errors and confidences of the frames that are followed are computed again. A frame that was rejected because
/// parts of it disagree with its transform is placed if they agree with the depth that the placed frames show.
pub(crate) fn follow(bracket: &Bracket, searched: &mut Searched) -> Option<Followed> {
    let reference = bracket.reference_index();
    let is_displaced = searched.placements.iter().any(is_displaced);
    if !is_displaced && !may_be_bent(&searched.placements) {
        return None;
    }
    let start = |i: usize| Start::of(&searched.placements[i], searched.unaccepted[i]).filter(|_| i != reference);
    let starts: Vec<Option<Start>> = (0..searched.placements.len()).map(start).collect();
    let picture = Picture::of(&searched.pyramids[reference]);
    let pyramids = &searched.pyramids;
    let observed = |patches| observed(pyramids, reference, &starts, &picture, patches, bracket.at_once());
    if !is_displaced && bent(&observed(near_patches), &picture).is_none() {
        return None;
    }
    let frames = observed(patches);
    let (followed, explained) = match bent(&frames, &picture) {
        Some(bends) => {
            let parted =
                |bend: Option<(Bend, Explained)>| bend.map(|(bend, explained)| (Arc::new(bend), explained)).unzip();
            let (bends, explained): (_, Vec<Option<Explained>>) = bends.into_iter().map(parted).unzip();
            (Followed::Bends(bends), explained.into_iter().map(Option::unwrap_or_default).collect())
        }
        None => {
            let (relief, explained) = depth::relief(pyramids, reference, &frames, &picture)?;
            (Followed::Depth(Arc::new(relief)), explained)
        }
    };
    let scale = level_to_full(picture.level)[(0, 0)];
    let placements = searched.placements.iter_mut().zip(&starts);
    for ((placement, start), (i, explained)) in placements.zip(explained.iter().enumerate()) {
        if let (Some(start), true) = (start, followed.cause(i).is_some()) {
            *placement = placed(start, explained, scale);
        }
    }
    Some(followed)
}

/// Whether parts of a frame are displaced by more than a bend.
fn is_displaced(placement: &Placement) -> bool {
    match placement {
        // The transform was given, so it was not checked locally.
        Placement::Placed(Estimate { displaced: None, .. }) => true,
        Placement::Placed(Estimate { displaced: Some(displaced), .. }) => displaced.fraction >= LEAST_DISPLACED,
        _ => false,
    }
}

/// Whether the errors of half of the frames that moved are so large that they may be due to the lens or the shutter.
fn may_be_bent(placements: &[Placement]) -> bool {
    let error = |placement: &Placement| match placement {
        Placement::Placed(Estimate { transform: Transform::Homography(_), error_px, .. }) => *error_px,
        _ => None,
    };
    let errors: Vec<f64> = placements.iter().filter_map(error).collect();
    let large = errors.iter().filter(|px| **px >= LEAST_ERROR_PX).count();
    large > 0 && 2 * large >= errors.len()
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

/// Measures the displacements of `patches` in each frame with a start.
fn observed(
    pyramids: &[GreyPyramid],
    reference: usize,
    starts: &[Option<Start>],
    picture: &Picture,
    patches: fn(&FramePair, &Matrix3<f64>) -> Displacements,
    at_once: usize,
) -> Vec<Option<Observed>> {
    map_at_once(pyramids.len(), at_once, |i| {
        let start = starts[i]?;
        let pair = FramePair::new(&pyramids[reference], &pyramids[i], &start.transform);
        let h = start.transform.matrix(picture.size.0, picture.size.1);
        let observation = |(patch, d): &_| Observation::new(*patch, d, &picture.coordinates);
        let observations = patches(&pair, &h).iter().map(observation).collect();
        Some(Observed::new(observations, start, on_level(&h, picture.level)))
    })
}

/// The bends that explain the displacements of patches, if there are such bends.
fn bent(frames: &[Option<Observed>], picture: &Picture) -> Option<Bends> {
    let found = [lens::fit(frames, picture), shutter::fit(frames, picture)];
    let explained = |bends: &Bends| bends.iter().flatten().map(|(_, explained)| *explained).collect::<Vec<_>>();
    let sufficient = found.into_iter().filter_map(|bends| Some((Explained::sufficient(&explained(&bends))?, bends)));
    sufficient.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, bends)| bends)
}

/// The placement of a frame whose motion is explained. `scale` is the side of a pixel of the level, in pixels.
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
