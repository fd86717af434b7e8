//! The local check: how much of the picture the transform of a frame does not fit.
//!
//! In: the placements of all frames. Out: the same, with the share of the picture that is displaced, and the error and
//! confidence that follow. Cost: that of a [`LocalField`] for each frame.

use crate::align::AlignMode;
use crate::align::ladder::Search;
use crate::align::ladder::thresholds::DISPLACED_HALVES;
use crate::align::local::LocalField;
use crate::align::refinement::FramePair;
use crate::align::result::{Estimate, Placement};
use crate::align::transform::Model;
use crate::plane::map_at_once;

impl Search<'_> {
    /// Checks the transforms of all placed frames that were estimated.
    pub(super) fn check_locally(&self, placements: &mut [Placement]) {
        let checked = map_at_once(placements.len(), self.compared_at_once, |i| match &placements[i] {
            Placement::Placed(estimate) if self.given[i].is_none() && estimate.error_px.is_some() => {
                Some(Placement::Placed(self.checked_locally(i, estimate)))
            }
            _ => None,
        });
        for (placement, checked) in placements.iter_mut().zip(checked) {
            if let Some(checked) = checked {
                *placement = checked;
            }
        }
    }

    /// The estimate with what the local displacements add to its error; in [`AlignMode::Auto`] with the transform of the
    /// dominant motion, if the frame moved.
    fn checked_locally(&self, i: usize, estimate: &Estimate) -> Estimate {
        let pair = FramePair::new(self.reference_pyramid(), &self.pyramids[i], &estimate.transform);
        let field = LocalField::new(&pair, &estimate.transform);
        // A frame of a tripod is not resampled because things moved.
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
