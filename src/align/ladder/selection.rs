//! Selection among the candidates of a frame, and the placement that follows.
//!
//! In: [`Candidate`]s. Out: the selected candidate and its uniqueness, or none; the [`Placement`]. Cost: negligible.
//! The result depends only on the candidates.

use crate::align::ladder::candidate::Candidate;
use crate::align::ladder::thresholds::{
    ACCEPTED_CONFIDENCE, ACCEPTED_RELIABILITY, COMPARABLE_EVIDENCE, DECISIVE_NATS, EXPLAINING_TILES,
    LATER_EVIDENCE_FACTOR, LATER_EVIDENCE_TILES, UNOPPOSED_AGREEING, UNOPPOSED_AGREEING_PER_DISAGREEING,
};
use crate::align::result::{Estimate, Placement, RejectedBy};
use crate::align::transform::Model;

/// Whether a candidate is good enough to merge the frame.
pub(super) fn is_acceptable(candidate: &Candidate) -> bool {
    let agreement = candidate.agreement();
    let is_unopposed = agreement.agreeing >= UNOPPOSED_AGREEING
        && agreement.disagreeing * UNOPPOSED_AGREEING_PER_DISAGREEING <= agreement.agreeing;
    candidate.confidence() >= ACCEPTED_CONFIDENCE
        || (is_unopposed
            && candidate.reliability >= ACCEPTED_RELIABILITY
            && (candidate.is_precise() || candidate.is_precise_at_tiles()))
}

/// The candidates of a frame, each with the index of the target (the reference, or a warped neighbour) that the frame
/// was aligned to.
#[derive(Default)]
pub(super) struct Candidates(Vec<(usize, Candidate)>);

impl Candidates {
    pub(super) fn add(&mut self, target: usize, candidate: Option<Candidate>) {
        self.0.extend(candidate.map(|c| (target, c)));
    }

    /// Whether `property` is true for any of the candidates for `target`.
    pub(super) fn any(&self, target: usize, property: impl Fn(&Candidate) -> bool) -> bool {
        self.0.iter().any(|(b, c)| *b == target && property(c))
    }

    /// The candidate with the most evidence (tiles that agree minus tiles that disagree). If several are nearly equal,
    /// the first, which was found more directly.
    pub(super) fn best(&self) -> Option<(usize, &Candidate)> {
        self.0.iter().map(|(b, c)| (*b, c)).reduce(|best, other| {
            if other.1.evidence() > best.1.evidence() * LATER_EVIDENCE_FACTOR + LATER_EVIDENCE_TILES {
                other
            } else {
                best
            }
        })
    }

    /// Marks the best candidate as corroborated if `found`, which says whether features gave the same transform, is
    /// true for it. Returns whether it is true.
    pub(super) fn corroborate(&mut self, found: impl Fn(&Candidate) -> bool) -> bool {
        let best = self.best().map(|(_, c)| c.transform);
        let mut any = false;
        for (_, candidate) in self.0.iter_mut().filter(|(_, c)| best == Some(c.transform)) {
            candidate.corroborated = found(candidate);
            any |= candidate.corroborated;
        }
        any
    }

    /// The selected candidate and its target.
    ///
    /// This is the [best](Self::best) candidate, unless another candidate with the same target and comparable evidence
    /// is decisively better in a direct comparison. Then every such candidate is compared with each of the others, and
    /// the one whose worst result is the highest is selected. Two candidates are compared only on tiles that have a
    /// correlation under both transforms. (In a repeating facade, a shift that is wrong by one period may have more
    /// evidence, only because it leaves more tiles inside the frame.)
    pub(super) fn winner(&self) -> Option<(usize, &Candidate)> {
        let (target, best) = self.best()?;
        let contenders = self.alternatives(target, best, |_| true);
        let worst_lead =
            |c: &Candidate| contenders.iter().map(|o| c.tiles.distinction_from(&o.tiles)).fold(f64::INFINITY, f64::min);
        if worst_lead(best) >= -DECISIVE_NATS {
            return Some((target, best));
        }
        let leads = contenders.iter().map(|c| (worst_lead(c), *c));
        let winner = leads.reduce(|w, c| if c.0 > w.0 { c } else { w })?;
        Some((target, winner.1))
    }

    /// The candidates for `target` that have at least [`COMPARABLE_EVIDENCE`] times the evidence of `best`, and for
    /// which `is_other` is true. They may include `best` itself.
    fn alternatives(&self, target: usize, best: &Candidate, is_other: impl Fn(&Candidate) -> bool) -> Vec<&Candidate> {
        let least = COMPARABLE_EVIDENCE * best.evidence();
        let same_target = self.0.iter().filter(|(b, _)| *b == target).map(|(_, c)| c);
        same_target.filter(|c| c.evidence() >= least && is_other(c)).collect()
    }

    /// The uniqueness of `best`, 0..=1.
    ///
    /// 1 if none of the `others` has comparable evidence. Otherwise it depends on the lead of `best` in the direct
    /// comparison with the closest of the `others`: 0 for no lead, 1/2 for a lead of [`DECISIVE_NATS`].
    pub(super) fn uniqueness(&self, (target, best): (usize, &Candidate), others: impl Fn(&Candidate) -> bool) -> f64 {
        let leads = self.alternatives(target, best, others).into_iter().map(|c| best.tiles.distinction_from(&c.tiles));
        let lead = leads.fold(f64::INFINITY, f64::min);
        if lead.is_infinite() { 1.0 } else { lead.max(0.0) / (lead.max(0.0) + DECISIVE_NATS) }
    }
}

/// The reason why a frame is rejected whose best candidate is `candidate`, in words. If the candidate by itself is good
/// enough, others are as good.
pub(super) fn rejection_reason(candidate: Option<&Candidate>) -> String {
    match candidate {
        None => "it has too little in common with the reference to estimate its motion".into(),
        Some(c) if is_acceptable(c) => {
            "it matches the reference about equally well at several positions, for example because the scene repeats"
                .into()
        }
        Some(c) if c.agreement().agreeing + c.agreement().disagreeing < EXPLAINING_TILES => {
            "too few parts of the frame can be compared with the reference to estimate its motion, for example because \
             most are black, clipped or uniform"
                .into()
        }
        Some(c) => format!(
            "it could not be aligned: {} of {} tiles disagree with the best estimate",
            c.agreement().disagreeing,
            c.agreement().agreeing + c.agreement().disagreeing
        ),
    }
}

/// Converts `candidate` to an [`Estimate`] without a local check.
pub(crate) fn estimate(candidate: &Candidate) -> Estimate {
    Estimate {
        transform: candidate.transform,
        model: Model::of(&candidate.transform),
        error_px: (candidate.agreement().agreeing > 0).then_some(candidate.error_px()),
        confidence: candidate.confidence(),
        displaced: None,
        reason: None,
    }
}

/// The placement of a frame that could not be aligned. `confidence` is the confidence of the best transform that was
/// found; the placement has at most [`ACCEPTED_CONFIDENCE`].
pub(super) fn rejected(reason: String, confidence: f64) -> Placement {
    let confidence = confidence.min(ACCEPTED_CONFIDENCE);
    Placement::Rejected { by: RejectedBy::Alignment, confidence, reason: Some(reason) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::agreement::{Agreement, TileCheck};
    use crate::align::ladder::thresholds::TOLERANCE_PX;
    use crate::align::result::Status;
    use crate::align::scene::shift;
    use std::sync::Arc;

    /// A candidate for a shift by `x` pixels to the right, with the given numbers of agreeing and disagreeing tiles,
    /// spread over the whole picture.
    fn candidate(x: f64, agreeing: usize, disagreeing: usize) -> Candidate {
        let agreement = Agreement { agreeing, disagreeing, parts: 9.min(agreeing), ..Agreement::default() };
        let correlation = |i| Some(if i < agreeing { 0.95 } else { 0.1 });
        let correlations = (0..agreeing + disagreeing).map(correlation).collect();
        Candidate {
            transform: shift(x, 0.0),
            tiles: Arc::new(TileCheck { agreement, correlations, displacements: Vec::new() }),
            noise_px: 0.1,
            tiles_px: 0.0,
            offset_px: 0.0,
            excess_px: 0.0,
            by_tiles: false,
            reliability: 1.0,
            tolerance_px: TOLERANCE_PX,
            corroborated: false,
        }
    }

    fn candidates(list: impl IntoIterator<Item = (usize, Candidate)>) -> Candidates {
        let mut all = Candidates::default();
        list.into_iter().for_each(|(target, candidate)| all.add(target, Some(candidate)));
        all
    }

    /// Transforms that are more than a pixel apart are different.
    fn alike(a: &Candidate, b: &Candidate) -> bool {
        a.transform.corner_distance(&b.transform, 480, 320) < 1.0
    }

    /// Each row of the table has two parts. The first has the numbers of agreeing and of disagreeing tiles. The second
    /// says whether the candidate is settled (good enough without other methods), whether it is accepted, and its
    /// confidence.
    #[test]
    fn candidate_by_its_tiles_is_settled_accepted_or_rejected() {
        let table = [
            // Many tiles agree and one in forty disagrees. The confidence is (78 + 1.5) / (80 + 5).
            ((78, 2), (true, true, 0.93)),
            // One tile more disagrees, which is too many to settle.
            ((77, 3), (false, true, 0.92)),
            // No tile disagrees, but too few agree to settle.
            ((11, 0), (false, true, 0.78)),
            // Very few tiles agree, but none disagrees.
            ((3, 0), (false, true, 0.49)),
            // As many tiles disagree as agree. The confidence is (10 + 1.5) / (20 + 5).
            ((10, 10), (false, true, 0.46)),
            ((10, 30), (false, false, 0.25)),
            // No tile has enough contrast, as in a black frame. The confidence is the prior share of agreeing tiles
            // (0.3) times the smallest coverage (one half).
            ((0, 0), (false, false, 0.15)),
        ];
        for ((agreeing, disagreeing), (settled, accepted, confidence)) in table {
            let found = candidate(3.0, agreeing, disagreeing);
            assert_eq!((found.is_settled(), is_acceptable(&found)), (settled, accepted), "{agreeing} {disagreeing}");
            assert!((found.confidence() - confidence).abs() < 0.01, "{agreeing} {disagreeing}: {}", found.confidence());
        }
    }

    #[test]
    fn candidate_with_a_large_error_or_an_unreliable_target_is_rejected() {
        let blurred = Candidate { noise_px: 3.0, ..candidate(3.0, 20, 10) };
        let unreliable = Candidate { reliability: 0.2, ..candidate(3.0, 78, 0) };
        assert!(!is_acceptable(&blurred) && !blurred.is_settled(), "{}", blurred.confidence());
        assert!(!is_acceptable(&unreliable), "{}", unreliable.confidence());
    }

    #[test]
    fn candidate_that_is_precise_where_it_has_detail_is_accepted_without_confidence() {
        // The error is large, but the tiles that agree are hardly displaced.
        let with = |agreeing, disagreeing, offset_px| Candidate {
            noise_px: 2.0,
            offset_px,
            ..candidate(3.0, agreeing, disagreeing)
        };
        assert!(is_acceptable(&with(12, 0, 0.1)) && with(12, 0, 0.1).confidence() < ACCEPTED_CONFIDENCE);
        // The tiles are displaced; there are too few of them; some disagree.
        assert!([with(12, 0, 1.3), with(11, 0, 0.1), with(12, 2, 0.1)].iter().all(|c| !is_acceptable(c)));
        // The tiles are displaced, but match nearly perfectly: the picture is out of focus.
        let mut soft = with(12, 0, 1.3);
        Arc::make_mut(&mut soft.tiles).correlations.fill(Some(0.98));
        assert!(is_acceptable(&soft) && soft.confidence() < ACCEPTED_CONFIDENCE);
    }

    #[test]
    fn features_that_find_the_best_candidate_again_raise_its_confidence_alone() {
        let mut all = candidates([(0, candidate(3.0, 6, 4)), (0, candidate(40.0, 3, 5))]);
        let before = all.best().map(|(_, best)| best.confidence());
        assert!(!all.corroborate(|_| false));
        assert!(all.corroborate(|c| alike(c, &candidate(3.2, 0, 0))));
        let after = all.best().map(|(_, best)| best.confidence());
        assert!(before < Some(0.6) && after > Some(0.69), "{before:?} {after:?}");
        assert_eq!(all.0.iter().filter(|(_, c)| c.corroborated).count(), 1);
    }

    #[test]
    fn equal_evidence_is_won_by_the_candidate_found_first_and_is_not_unique() {
        let all = candidates([(0, candidate(3.0, 30, 0)), (0, candidate(40.0, 30, 0))]);
        let (target, winner) = all.winner().unwrap();
        assert_eq!((target, winner.transform), (0, shift(3.0, 0.0)));
        // All tiles match equally well under both transforms.
        assert_eq!(all.uniqueness((target, winner), |c| !alike(c, winner)), 0.0);
    }

    #[test]
    fn candidate_without_a_comparable_alternative_is_unique() {
        let all = candidates([(0, candidate(3.0, 30, 0)), (0, candidate(40.0, 8, 0)), (1, candidate(80.0, 30, 0))]);
        let (target, winner) = all.winner().unwrap();
        assert_eq!(winner.transform, shift(3.0, 0.0));
        assert_eq!(all.uniqueness((target, winner), |c| !alike(c, winner)), 1.0);
    }

    /// A facade that repeats: under a shift that is wrong by one period (here 40 px), more tiles are inside the frame
    /// than under the true shift (3 px), but each tile matches worse. The true shift must be selected.
    #[test]
    fn alternative_that_is_better_on_the_common_tiles_wins_over_more_tiles() {
        let weak = |x, tiles: usize, correlation| {
            let mut found = candidate(x, tiles, 0);
            Arc::make_mut(&mut found.tiles).correlations = vec![Some(correlation); tiles];
            found
        };
        let all = candidates([(0, weak(40.0, 30, 0.7)), (0, weak(3.0, 24, 0.95))]);
        assert_eq!(all.best().unwrap().1.transform, shift(40.0, 0.0));
        let (target, winner) = all.winner().unwrap();
        assert_eq!(winner.transform, shift(3.0, 0.0));
        assert!(all.uniqueness((target, winner), |c| !alike(c, winner)) > 0.5);
    }

    /// Two estimates of the same motion. The second is stated as less precise, but its tiles match better.
    #[test]
    fn better_estimate_of_the_same_transform_wins() {
        let mut better = Candidate { noise_px: 1.0, ..candidate(3.4, 30, 0) };
        Arc::make_mut(&mut better.tiles).correlations = vec![Some(0.98); 30];
        let mut all = candidates([(0, candidate(3.0, 30, 0)), (0, better)]);
        assert_eq!(all.best().unwrap().1.transform, shift(3.0, 0.0));
        // The common evidence of the tiles does not count, so a few tiles must match much better.
        assert_eq!(all.winner().unwrap().1.transform, shift(3.0, 0.0));
        for correlation in &mut Arc::make_mut(&mut all.0[0].1.tiles).correlations[..5] {
            *correlation = Some(0.5);
        }
        assert_eq!(all.winner().unwrap().1.transform, shift(3.4, 0.0));
    }

    #[test]
    fn candidate_against_an_unreliable_neighbour_loses_to_one_against_the_reference() {
        let neighbour = Candidate { reliability: 0.3, ..candidate(40.0, 30, 0) };
        let all = candidates([(1, neighbour), (0, candidate(3.0, 14, 2))]);
        assert_eq!(all.winner().map(|(target, c)| (target, c.transform)), Some((0, shift(3.0, 0.0))));
    }

    #[test]
    fn frame_without_any_candidate_is_rejected_with_the_reason() {
        let none = Candidates::default();
        assert!(none.winner().is_none());
        let placement = rejected(rejection_reason(None), 0.0);
        assert_eq!((placement.status(), placement.transform(), placement.confidence()), (Status::Rejected, None, 0.0));
        assert!(placement.reason().unwrap().contains("too little in common"));
        assert!(rejection_reason(Some(&candidate(0.0, 2, 3))).contains("too few parts"));
        assert!(rejection_reason(Some(&candidate(0.0, 10, 30))).contains("30 of 40 tiles"));
        assert!(rejection_reason(Some(&candidate(0.0, 30, 0))).contains("at several positions"));
    }
}
