//! The local check: how much of the picture the transform of a frame does not fit.
//!
//! In: the placements of all frames. Out: the same placements, with the share of the picture that is displaced, the
//! error and confidence that follow from it, and with `auto` the transform of the dominant motion where it fits more of
//! the picture. Cost: that of a [`LocalField`] for each frame. The planes of a frame are made again, unless it was
//! settled by the bitmaps and is checked at once.

use crate::align::AlignMode;
use crate::align::ladder::Search;
use crate::align::ladder::thresholds::DISPLACED_HALVES;
use crate::align::local::LocalField;
use crate::align::refinement::FramePair;
use crate::align::result::{Estimate, Placement};
use crate::align::transform::Model;
use crate::plane::map_at_once;

/// The local check of a frame: its estimate before and after the check.
pub(crate) struct LocalCheck {
    before: Estimate,
    after: Estimate,
}

impl Search<'_> {
    /// Checks the transforms of all placed frames that were estimated.
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

    /// Checks frame `i`, whose `pair` is in memory, before all frames are placed.
    pub(super) fn keep_local_check(&self, i: usize, pair: &FramePair, estimate: &Estimate) {
        self.checks[i]
            .get_or_init(|| LocalCheck { before: estimate.clone(), after: self.checked_locally(pair, estimate) });
    }

    /// Returns `estimate` with an error and a confidence that include the local displacements; in [`AlignMode::Auto`]
    /// with the transform of the dominant motion, if the frame moved.
    fn checked_locally(&self, pair: &FramePair, estimate: &Estimate) -> Estimate {
        let field = LocalField::new(pair, &estimate.transform);
        // Things that moved in the scene are no reason to resample a frame from a tripod.
        let is_moved = estimate.model != Model::Unmoved;
        let dominant = if self.options.mode == AlignMode::Auto && is_moved { field.dominant() } else { None };
        let (field, estimate) = match dominant {
            Some((field, error_px)) => {
                let transform = field.transform();
                let model = Model::of(&transform);
                (field, Estimate { transform, model, error_px: Some(error_px), ..estimate.clone() })
            }
            None => (field, estimate.clone()),
        };
        let misfit = field.misfit();
        let off = misfit.displaced_surely / DISPLACED_HALVES;
        Estimate {
            error_px: estimate.error_px.map(|px| (px * px + misfit.rms_px * misfit.rms_px).sqrt()),
            confidence: estimate.confidence / (1.0 + off * off * off * off),
            displaced: Some(misfit.displaced),
            ..estimate
        }
    }
}
