//! Model selection: the smallest model that explains a motion as well as the homography that was found.
//!
//! In: a pair of frames and a [`Candidate`]. Out: a candidate of the smallest sufficient [`Model`]. Cost: a refinement
//! on the finest level for each smaller model that can come near the homography.

use crate::align::grey::{finest_level, measured_level};
use crate::align::ladder::candidate::{Candidate, evaluate};
use crate::align::refinement::{FramePair, refine};
use crate::align::transform::{Model, Transform, distance, level_to_full, restrict};

/// Transforms whose distance is at most this count as the same, in pixels (root mean square over the picture).
const SAME_PX: f64 = 0.03;

/// A transform with fewer parameters explains the motion equally well if its distance from the homography is at most
/// this many standard errors of the homography. A larger distance would be significant at the level of 5 %.
const STANDARD_ERRORS: f64 = 2.0;

/// Up to a certain distance from the homography, a transform with fewer parameters explains the motion equally well
/// (see [`STANDARD_ERRORS`] and [`SAME_PX`]). A smaller model is fitted only if its nearest transform is within this
/// many times that distance.
const MOST_EXCESS: f64 = 5.0;

/// A frame that is displaced by at most this counts as unmoved, in pixels: to resample it would do more harm than good.
pub(crate) const UNMOVED_PX: f64 = 0.2;

/// Reduces the candidate `whole`, usually a homography, to the smallest model that explains the motion equally well
/// within the error.
pub(crate) fn reduce(pair: &FramePair, whole: Candidate) -> Candidate {
    let (width, height) = pair.size();
    let level = measured_level(pair.reference());
    // If a smaller model is closer to `whole` than this, tiles cannot distinguish the two, so the check of `whole` is
    // reused.
    let alike_px = ALIKE * level_to_full(level)[(0, 0)];
    let checked = |transform: Transform, noise_px: f64, apart: f64| {
        if apart > alike_px {
            return Candidate { corroborated: whole.corroborated, ..evaluate(pair, transform, noise_px) };
        }
        Candidate { transform, noise_px, ..whole.clone() }
    };
    let uncertainty_px = STANDARD_ERRORS * whole.most_px();
    let still = distance(&whole.transform, &Transform::Identity, width, height);
    if still <= UNMOVED_PX.max(uncertainty_px) {
        let unmoved = checked(Transform::Identity, 0.0, still);
        if unmoved.agreement().share() >= whole.agreement().share() - 0.02 {
            // If the transform that was found is right, tiles are displaced by about `still` under the identity. A
            // larger displacement is limited to `still`, or to `SAME_PX` if that is larger.
            let most = still.max(SAME_PX);
            let (tiles_px, excess_px) = (unmoved.tiles_px.min(most), unmoved.excess_px.min(most));
            return Candidate { tiles_px, excess_px, ..unmoved };
        }
    }
    if whole.by_tiles {
        // The smaller models are refined on the pixels, which would undo the fit of `whole` to the tiles.
        return whole;
    }
    let finest = finest_level(pair.reference());
    for model in [Model::Shift, Model::Rigid] {
        // Skips the expensive fit for models that cannot come near.
        let near = Transform::Homography(restrict(&whole.transform.matrix(width, height), model, width, height));
        if distance(&whole.transform, &near, width, height) > MOST_EXCESS * SAME_PX.max(uncertainty_px) {
            continue;
        }
        let Some(smaller) = refine(pair, &whole.transform, model, (finest, finest)) else {
            continue;
        };
        let apart = distance(&whole.transform, &smaller.transform, width, height);
        if apart <= SAME_PX.max(uncertainty_px) {
            let candidate = checked(smaller.transform, smaller.error_px, apart);
            if candidate.agreement().share() >= whole.agreement().share() - 0.02
                && candidate.agreement().offset <= whole.agreement().offset + 0.01
            {
                // The smaller model may be insufficient without any sign of it in the tiles. Therefore the cautious
                // estimate of the error is at least that of the homography.
                let (most, noise) = (whole.most_px(), candidate.noise_px);
                let rest_px = (most * most - noise * noise).max(0.0).sqrt();
                return Candidate { tiles_px: candidate.tiles_px.max(rest_px), ..candidate };
            }
        }
    }
    whole
}

/// Tiles can distinguish two transforms only if the distance between the transforms exceeds this, in pixels of the
/// level on which tiles are measured.
const ALIKE: f64 = 0.1;
