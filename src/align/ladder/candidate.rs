//! A candidate: a transform that was found for a frame, with the result of its check by tiles, error estimate and
//! confidence.
//!
//! In: a pair of frames and a transform. Out: a [`Candidate`]. Cost: [`check_tiles`].

use crate::align::agreement;
use crate::align::agreement::{Agreement, TileCheck, TileFit, UNEXPLAINED, check_tiles};
use crate::align::grey::measured_level;
use crate::align::ladder::thresholds::{
    CORROBORATED_CONFIDENCE, SETTLED_AGREEING, SETTLED_DECIDED_PER_DISAGREEING, SETTLED_ERROR_PX, TILE_NOISE_PX,
    TOLERANCE_PX,
};
use crate::align::refinement::FramePair;
use crate::align::transform::{Transform, level_to_full, on_level};
use std::sync::Arc;

/// A transform that was found for a frame, and the evidence for it.
#[derive(Debug, Clone)]
pub(crate) struct Candidate {
    /// Reference pixel -> frame pixel.
    pub(crate) transform: Transform,
    /// The check of the transform by tiles.
    pub(crate) tiles: Arc<TileCheck>,
    /// The error estimate of the method that found the transform, in pixels of the full size; 0 if it is unknown, or if
    /// the frame is set to unmoved and was not aligned to a neighbour. If the frame was aligned to a neighbour, with
    /// the error a, and the neighbour has the error b, the value is sqrt(a^2 + b^2). If `reduce` then chooses a smaller
    /// model, the value is the larger of the error of this model and b.
    pub(crate) noise_px: f64,
    /// The measured displacement of the tiles, reduced by the smallest error that the measurement may have, in pixels
    /// of the full size. It is never negative. With enough tiles for a fit, it is sqrt(m^2 - e^2), where m is the
    /// distance of the fitted transform from `transform` ([`TileFit::moved`]), and e the least error of the fit
    /// ([`TileFit::least_error`]). With fewer tiles, it is the median displacement of the agreeing tiles minus
    /// [`TILE_NOISE_PX`]. If `reduce` replaces the transform by one that tiles cannot distinguish from it, this value
    /// is kept. But `reduce` may raise it for a shift or a rigid transform, and limits it for an unmoved frame.
    pub(crate) tiles_px: f64,
    /// The median displacement of the agreeing tiles, in pixels of the full size.
    pub(crate) offset_px: f64,
    /// The part of the displacement of the tiles that its expected error does not explain.
    pub(crate) excess_px: f64,
    /// Whether the transform was fitted to the displacements of the tiles.
    pub(crate) by_tiles: bool,
    /// Confidence of the picture that the frame was aligned to (1 for the reference), times the uniqueness of the
    /// candidate (see [`uniqueness`](super::selection::Candidates::uniqueness)), 0..=1.
    pub(crate) reliability: f64,
    /// The error that halves the confidence, in pixels: [`TOLERANCE_PX`] for a picture with a diagonal of up to 2000
    /// pixels, more for a larger one.
    pub(crate) tolerance_px: f64,
    /// Whether features independently gave the same transform.
    pub(crate) corroborated: bool,
}

impl Candidate {
    /// The agreement of all tiles.
    pub(crate) fn agreement(&self) -> &Agreement {
        &self.tiles.agreement
    }

    /// The expected error, root mean square over the picture, in pixels of the full size.
    pub(crate) fn error_px(&self) -> f64 {
        (self.noise_px * self.noise_px + self.excess_px * self.excess_px).sqrt()
    }

    /// A cautious estimate of the error, in the same unit, for decisions. Nearly the whole displacement of the tiles
    /// counts. [`error_px`](Self::error_px) counts only the part that the expected error of the displacement does not
    /// explain. Under a wrong transform, this expected error is often large too, and could explain most of a large
    /// displacement.
    pub(super) fn most_px(&self) -> f64 {
        (self.noise_px * self.noise_px + self.tiles_px * self.tiles_px).sqrt()
    }

    /// Whether even the cautious estimate of the error is small enough to merge the frame.
    pub(super) fn is_precise(&self) -> bool {
        self.most_px() < self.tolerance_px
    }

    /// Whether the error is small enough to merge the frame where it has detail: enough tiles agree, and they are
    /// hardly displaced, or match nearly perfectly although they are displaced, as in a picture out of focus. The error
    /// over the whole picture may be large if most of the frame is clipped or uniform; but there a displacement does
    /// little harm.
    pub(super) fn is_precise_at_tiles(&self) -> bool {
        self.agreement().agreeing >= SETTLED_AGREEING
            && (self.offset_px < self.tolerance_px || self.tiles.unexplained() <= UNEXPLAINED)
    }

    /// The confidence, 0..=1: the agreement of the tiles, reduced by the error estimate.
    pub(crate) fn confidence(&self) -> f64 {
        let off = self.most_px() / self.tolerance_px;
        let tiles = self.agreement().share() * self.agreement().coverage();
        let support = if self.corroborated { tiles.max(CORROBORATED_CONFIDENCE) } else { tiles };
        self.reliability * support / (1.0 + off * off)
    }

    /// The evidence for the transform, used to rank candidates: the number of agreeing tiles minus the number of
    /// disagreeing tiles, reduced by the error estimate.
    pub(crate) fn evidence(&self) -> f64 {
        let off = self.most_px() / self.tolerance_px;
        let tiles = self.agreement().agreeing as f64 - self.agreement().disagreeing as f64;
        self.reliability * tiles / (1.0 + off * off)
    }

    /// Whether no other method is needed: many tiles agree, almost none disagrees, and the error is small.
    pub(crate) fn is_settled(&self) -> bool {
        let Agreement { agreeing, disagreeing, .. } = *self.agreement();
        agreeing >= SETTLED_AGREEING
            && disagreeing * SETTLED_DECIDED_PER_DISAGREEING <= agreeing + disagreeing
            && self.most_px() < SETTLED_ERROR_PX
    }
}

/// Checks `transform` by tiles. `noise_px` is the error estimate of the method that found it; 0 if it is unknown.
pub(crate) fn evaluate(pair: &FramePair, transform: Transform, noise_px: f64) -> Candidate {
    evaluate_with_fit(pair, transform, noise_px).0
}

/// As [`evaluate`]; also returns the transform fitted to the displacements of the tiles, if there are enough tiles.
pub(super) fn evaluate_with_fit(pair: &FramePair, transform: Transform, noise_px: f64) -> (Candidate, Option<TileFit>) {
    let level = measured_level(pair.reference());
    let (width, height) = pair.size();
    let h = on_level(&transform.matrix(width, height), level);
    let both = pair.level(level);
    let tiles = check_tiles(both, &h);
    let fit = agreement::fit(&tiles, &h, (both.reference.width(), both.reference.height()));
    let tolerance_px = tolerance_px((width, height));
    let scale = level_to_full(level)[(0, 0)];
    let offset_px = scale * tiles.agreement.offset;
    let (tiles_px, excess_px) = match &fit {
        Some(fit) => {
            let (moved, error) = (scale * fit.moved, scale * fit.error);
            let least = scale * fit.least_error;
            let tiles_px = (moved * moved - least * least).max(0.0).sqrt();
            (tiles_px, excess(moved, (noise_px * noise_px + error * error).sqrt()))
        }
        None => {
            let displacement = (offset_px - scale * TILE_NOISE_PX).max(0.0);
            (displacement, displacement)
        }
    };
    let candidate = Candidate {
        transform,
        tiles: Arc::new(tiles),
        noise_px,
        tiles_px,
        offset_px,
        excess_px,
        reliability: 1.0,
        tolerance_px,
        corroborated: false,
        by_tiles: false,
    };
    (candidate, fit)
}

/// Returns the part of a displacement d that its expected error e does not explain, in the same unit: d (1 - (e /
/// d)^2), and 0 if d is less than e (similar to the estimate of James & Stein, 1961, limited to 0 or more).
fn excess(displacement: f64, error: f64) -> f64 {
    if displacement > error { (displacement * displacement - error * error) / displacement } else { 0.0 }
}

/// Returns [`Candidate::tolerance_px`] for a picture of this size.
pub(crate) fn tolerance_px((width, height): (usize, usize)) -> f64 {
    let diagonal = ((width * width + height * height) as f64).sqrt();
    TOLERANCE_PX * (diagonal / 2000.0).max(1.0)
}
