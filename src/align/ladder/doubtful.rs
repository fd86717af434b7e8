//! Alignment of a doubtful frame: one for which the result of the bitmaps alone is not good enough. Further methods are
//! tried: alignment to a neighbour in exposure, features, and the other minima of the bitmap search.
//!
//! In: the features of the reference, and the nearest neighbour that was aligned. Out: a [`Placement`], and the numbers
//! of keypoints and inliers. Cost: several times that of a frame that needs only the bitmaps.

use crate::align::grey::GreyPyramid;
use crate::align::ladder::Search;
use crate::align::ladder::Shared;
use crate::align::ladder::candidate::Candidate;
use crate::align::ladder::reduction::reduce;
use crate::align::ladder::selection::{Candidates, estimate, is_acceptable, rejected, rejection_reason};
use crate::align::ladder::starts::{by_alternatives, by_bitmaps, by_start, warped_to_reference};
use crate::align::ladder::thresholds::{CORROBORATED_PX, LEAST_INLIERS, SAME_APART};
use crate::align::refinement::FramePair;
use crate::align::result::{FeatureCounts, Found, Placement};
use crate::align::transform::{Transform, distance};
use std::borrow::Cow;

/// A picture that a frame is aligned to: the reference, or a neighbour in exposure that was warped to the reference's
/// grid.
pub(crate) struct Target<'a> {
    pub(crate) pyramid: Cow<'a, GreyPyramid>,
    /// Error estimate of the neighbour's own transform, in pixels; 0 for the reference.
    pub(super) error_px: f64,
    /// Confidence of the neighbour's own transform, 0..=1; 1 for the reference.
    pub(super) confidence: f64,
}

impl Target<'_> {
    /// The pair of this target and `frame`, which `start` aligns approximately.
    pub(super) fn compare<'b>(&'b self, frame: &'b GreyPyramid, start: &Transform) -> FramePair<'b> {
        FramePair::new(&self.pyramid, frame, start)
    }

    /// Adds the target's own error to the noise of `candidate`, and multiplies the candidate's reliability by the
    /// target's confidence.
    pub(super) fn discount(&self, candidate: Candidate) -> Candidate {
        let noise_px = (candidate.noise_px * candidate.noise_px + self.error_px * self.error_px).sqrt();
        Candidate { noise_px, reliability: candidate.reliability * self.confidence, ..candidate }
    }
}

impl Search<'_> {
    /// Places frame `i`, for which the bitmaps gave only the doubtful candidate `first`, or none.
    pub(super) fn doubtful(
        &self,
        i: usize,
        first: Option<Candidate>,
        neighbour: Option<Target>,
        shared: &Shared,
    ) -> Found {
        let reference = Target { pyramid: Cow::Borrowed(self.reference_pyramid()), error_px: 0.0, confidence: 1.0 };
        let targets: Vec<Target> = [reference].into_iter().chain(neighbour).collect();
        let mut candidates = Candidates::default();
        candidates.add(0, first);
        let counts = self.find_candidates(i, &targets, shared, &mut candidates);
        if shared.repetition.concerns(i) {
            self.shift_by_periods(i, &targets, &shared.repetition, &mut candidates);
        }
        (self.chosen(i, &targets, &candidates), counts)
    }

    /// Adds candidates for frame `i` from the bitmaps of the neighbour, from features, and from the other minima of the
    /// bitmap search, until one is good enough. Returns the numbers of keypoints and inliers.
    fn find_candidates(
        &self,
        i: usize,
        targets: &[Target],
        shared: &Shared,
        candidates: &mut Candidates,
    ) -> FeatureCounts {
        let frame = &self.pyramids[i];
        let (width, height) = self.size();
        let alike = |a: &Transform, b: &Transform| distance(a, b, width, height) <= self.corroborated_px();
        for (b, target) in targets.iter().enumerate().skip(1) {
            let (_, found) = by_bitmaps(&target.pyramid, frame, &self.options.mtb);
            candidates.add(b, found.map(|c| target.discount(c)));
        }
        let mut counts = FeatureCounts::default();
        let mut is_corroborated = false;
        let repeats = shared.repetition.concerns(i);
        let is_settled = |candidates: &Candidates| !repeats && candidates.best().is_some_and(|(_, c)| c.is_settled());
        if let (false, Some(reference)) = (is_settled(candidates), &shared.features) {
            let own = self.features(i);
            counts.keypoints = Some(own.counts);
            if let Some((start, inliers)) = self.consensus(reference, &own) {
                counts.inliers = Some(inliers);
                is_corroborated =
                    inliers >= 2 * LEAST_INLIERS && candidates.corroborate(|c| alike(&c.transform, &start));
                if !is_corroborated {
                    for (b, target) in targets.iter().enumerate() {
                        let candidate = by_start(&target.compare(frame, &start), &start, 0);
                        candidates.add(b, candidate.map(|c| target.discount(c)));
                    }
                }
            }
        }
        // The other minima are also tried if the scene repeats: in such a picture, features fail as easily as bitmaps.
        if repeats || !(is_settled(candidates) || is_corroborated) {
            let start = candidates.best().map_or(Transform::Identity, |(_, c)| c.transform);
            let angle = start.rotation_deg(width, height).to_radians();
            for (b, target) in targets.iter().enumerate() {
                for alternative in by_alternatives(&target.compare(frame, &start), angle, &self.options.mtb) {
                    candidates.add(b, Some(target.discount(alternative)));
                }
            }
        }
        counts
    }

    /// Returns the placement that follows from all `candidates`.
    fn chosen(&self, i: usize, targets: &[Target], candidates: &Candidates) -> Placement {
        let Some((b, best)) = candidates.winner() else { return rejected(rejection_reason(None), 0.0) };
        let (width, height) = self.size();
        let apart = SAME_APART * self.corroborated_px();
        let is_other = |c: &Candidate| distance(&c.transform, &best.transform, width, height) > apart;
        let reliability = best.reliability * candidates.uniqueness((b, best), is_other);
        let unique = Candidate { reliability, ..best.clone() };
        if !is_acceptable(&unique) {
            let _ = self.unaccepted[i].set(best.transform);
            return rejected(rejection_reason(Some(best)), unique.confidence());
        }
        let target = &targets[b];
        let reduced = reduce(&target.compare(&self.pyramids[i], &best.transform), unique);
        let noise_px = reduced.noise_px.max(target.error_px);
        Placement::Placed(estimate(&Candidate { reliability, noise_px, ..reduced }))
    }

    /// [`CORROBORATED_PX`] for pictures of this size, in pixels of the full size.
    fn corroborated_px(&self) -> f64 {
        let (width, height) = self.size();
        CORROBORATED_PX / 1000.0 * ((width * width + height * height) as f64).sqrt()
    }

    /// Frame `n`, warped to the reference's grid, if it was placed. A frame that is aligned to this target therefore
    /// gets a transform from pixels of the reference.
    pub(crate) fn neighbour_target(&self, n: usize, placement: &Placement) -> Option<Target<'_>> {
        let transform = placement.transform()?;
        let pyramid = match transform {
            Transform::Identity => Cow::Borrowed(&self.pyramids[n]),
            transform => Cow::Owned(warped_to_reference(&(self.grey)(n), &transform)),
        };
        Some(Target { pyramid, error_px: placement.error_px().unwrap_or(0.0), confidence: placement.confidence() })
    }
}
