//! The local check: for each frame, the share of the picture that its transform does not fit.
//!
//! In: the placements of all frames. Out: the same placements, with the share of the parts that are displaced, an
//! error that usually includes them, and a confidence that is reduced by both. In the mode `auto`, the dominant motion
//! of the cells may replace the transform of a frame: if the frame moved, and the dominant motion fits more of the
//! picture. Cost: a [`LocalField`] for each placed frame whose transform was estimated; for some frames a second one
//! on the finer level. The planes of a frame are computed again for this, with one exception: in the mode `auto`, a
//! frame that was aligned at the first attempt is checked at once, while its planes are in memory. It is checked a
//! second time only if its placement was changed afterwards.

use crate::align::AlignMode;
use crate::align::ladder::Search;
use crate::align::ladder::candidate::tolerance_px;
use crate::align::ladder::thresholds::UNCERTAIN;
use crate::align::local::{DISPLACED_HALVES, LocalField};
use crate::align::refinement::FramePair;
use crate::align::result::{Estimate, Placement};
use crate::align::transform::Model;
use crate::plane::map_at_once;

/// The result of the local check of a frame: its estimate before and after the check.
pub(crate) struct LocalCheck {
    before: Estimate,
    after: Estimate,
}

impl Search<'_> {
    /// Checks all placed frames whose transforms were estimated, not preset, and have an error estimate.
    pub(super) fn check_locally(&self, placements: &mut [Placement]) {
        let checked = map_at_once(placements.len(), self.compared_at_once, |i| match &placements[i] {
            Placement::Placed(estimate) if self.given[i].is_none() && estimate.error_px.is_some() => {
                let known = self.checks[i].get().filter(|check| check.before == *estimate);
                Some(Placement::Placed(known.map_or_else(
                    || {
                        let pair = FramePair::new(self.reference_pyramid(), &self.pyramids[i], &estimate.transform);
                        self.checked_locally(&pair, estimate)
                    },
                    |check| check.after.clone(),
                )))
            }
            _ => None,
        });
        for (placement, checked) in placements.iter_mut().zip(checked) {
            if let Some(checked) = checked {
                *placement = checked;
            }
        }
    }

    /// Checks frame `i` while the planes of its `pair` are in memory, and stores the result for
    /// [`check_locally`](Self::check_locally).
    pub(super) fn keep_local_check(&self, i: usize, pair: &FramePair, estimate: &Estimate) {
        self.checks[i]
            .get_or_init(|| LocalCheck { before: estimate.clone(), after: self.checked_locally(pair, estimate) });
    }

    /// Returns `estimate` with an error and a confidence that include the local displacements. In [`AlignMode::Auto`],
    /// if the frame moved, and the dominant motion fits more of the picture than the transform does, the dominant
    /// motion replaces the transform.
    fn checked_locally(&self, pair: &FramePair, estimate: &Estimate) -> Estimate {
        let field = LocalField::new(pair, &estimate.transform);
        // A frame from a tripod is not resampled only because things moved in the scene.
        let may_change = self.options.mode == AlignMode::Auto && estimate.model != Model::Unmoved;
        let finer = if may_change { field.on_finer_level(pair) } else { None };
        let field = finer.unwrap_or(field);
        let dominant = if may_change { field.dominant() } else { None };
        let (field, estimate) = match dominant {
            Some((field, error_px)) => {
                let transform = field.transform();
                let model = Model::of(&transform);
                (field, Estimate { transform, model, error_px: Some(error_px), ..estimate.clone() })
            }
            None => (field, estimate.clone()),
        };
        let square = |v: f64| v * v;
        let misfit = field.misfit();
        let displaced = misfit.displaced_surely / DISPLACED_HALVES;
        let error_px = estimate.error_px.map(|px| (square(px) + square(misfit.rms_px)).sqrt());
        let off = error_px.unwrap_or(0.0) / (UNCERTAIN * tolerance_px(self.size()));
        Estimate {
            error_px,
            confidence: estimate.confidence / ((1.0 + square(square(displaced))) * (1.0 + square(off))),
            displaced: Some(misfit.displaced),
            ..estimate
        }
    }
}
