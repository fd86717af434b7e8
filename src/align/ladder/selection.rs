//! Selection among the candidates of a frame, and the verdict that follows.
//!
//! In: [`Candidate`]s. Out: the winner and its uniqueness, or none; the [`Verdict`]. Cost: negligible. A pure function
//! of the candidates.

use crate::align::ladder::candidate::Candidate;
use crate::align::result::{KeypointCounts, Status, Verdict};
use crate::align::transform::Model;

/// Least confidence of an accepted candidate, unless nearly all tiles agree with it.
const LEAST_CONFIDENCE: f64 = 0.35;

/// Fewest agreeing tiles then. A frame of which little is neither black nor clipped is often the one that matters.
const LEAST_AGREEING: usize = 3;

/// Least reliability of an accepted candidate, whatever the number of its tiles.
const LEAST_RELIABILITY: f64 = 0.25;

/// What features found for a frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct FeatureCounts {
    pub(crate) inliers: Option<usize>,
    pub(crate) keypoints: Option<KeypointCounts>,
}

/// Whether a candidate is good enough to merge by.
pub(super) fn is_acceptable(candidate: &Candidate) -> bool {
    let agreement = candidate.agreement();
    let unopposed = agreement.agreeing >= LEAST_AGREEING && agreement.disagreeing * 8 <= agreement.agreeing;
    candidate.confidence() >= LEAST_CONFIDENCE
        || (unopposed && candidate.reliability >= LEAST_RELIABILITY && candidate.error_px < candidate.tolerance_px)
}

/// The candidates of a frame, each with the index of the target that it was found against.
#[derive(Default)]
pub(super) struct Candidates(Vec<(usize, Candidate)>);

impl Candidates {
    pub(super) fn add(&mut self, target: usize, candidate: Option<Candidate>) {
        self.0.extend(candidate.map(|c| (target, c)));
    }

    /// The one with the most evidence; of nearly equals the first, which was found more directly.
    pub(super) fn best(&self) -> Option<(usize, &Candidate)> {
        self.0
            .iter()
            .map(|(b, c)| (*b, c))
            .reduce(|best, other| if other.1.evidence() > best.1.evidence() * 1.01 + 0.5 { other } else { best })
    }

    /// Marks the best as corroborated by features, if `found` holds for it.
    pub(super) fn corroborate(&mut self, found: impl Fn(&Candidate) -> bool) -> bool {
        let best = self.best().map(|(_, c)| c.transform);
        let mut any = false;
        for (_, candidate) in self.0.iter_mut().filter(|(_, c)| best == Some(c.transform)) {
            candidate.corroborated = found(candidate);
            any |= candidate.corroborated;
        }
        any
    }

    /// The best; or, if another one against the same target with comparable evidence is decidedly better on the tiles
    /// that are decided under both, the one whose worst comparison with all others is best. (Under a shift by a
    /// facade's period other tiles are outside the frame, and undecided.)
    pub(super) fn winner(&self, alike: impl Fn(&Candidate, &Candidate) -> bool) -> Option<(usize, &Candidate)> {
        let (target, best) = self.best()?;
        let contenders = self.alternatives(target, best, |_| true);
        let worst_lead = |c: &Candidate| {
            let others = contenders.iter().filter(|o| !alike(o, c));
            others.map(|o| c.tiles.evidence_over(&o.tiles)).fold(f64::INFINITY, f64::min)
        };
        if worst_lead(best) >= -DECISIVE {
            return Some((target, best));
        }
        let leads = contenders.iter().map(|c| (worst_lead(c), *c));
        let winner = leads.reduce(|w, c| if c.0 > w.0 { c } else { w })?;
        Some((target, winner.1))
    }

    /// Those against the same target with comparable evidence for which `is_other` holds; `best` itself may be one.
    fn alternatives(&self, target: usize, best: &Candidate, is_other: impl Fn(&Candidate) -> bool) -> Vec<&Candidate> {
        let least = COMPARABLE_EVIDENCE * best.evidence();
        let same_target = self.0.iter().filter(|(b, _)| *b == target).map(|(_, c)| c);
        same_target.filter(|c| c.evidence() >= least && is_other(c)).collect()
    }

    /// 1 if no other candidate is comparable with `best`; one half if the tiles that are decided under both prefer
    /// `best` to one of the `others` by no more than [`DECISIVE`].
    pub(super) fn uniqueness(&self, (target, best): (usize, &Candidate), others: impl Fn(&Candidate) -> bool) -> f64 {
        let leads = self.alternatives(target, best, others).into_iter().map(|c| best.tiles.evidence_over(&c.tiles));
        let lead = leads.fold(f64::INFINITY, f64::min);
        if lead.is_infinite() { 1.0 } else { lead.max(0.0) / (lead.max(0.0) + DECISIVE) }
    }
}

/// Evidence, as a share of the best candidate's, from which a candidate is comparable with it.
const COMPARABLE_EVIDENCE: f64 = 0.4;

/// Evidence for one candidate over another from which the choice is decided, in nats.
pub(crate) const DECISIVE: f64 = 2.0;

pub(super) fn rejection_reason(candidate: Option<&Candidate>) -> String {
    match candidate {
        None => "it has too little in common with the reference to tell how it moved".into(),
        Some(c) if c.agreement().agreeing + c.agreement().disagreeing < 8 => {
            "too few parts of it are neither black, burnt out nor plain to tell how it moved".into()
        }
        Some(c) => format!(
            "no motion makes it agree with the reference: {} of {} parts contradict the best one",
            c.agreement().disagreeing,
            c.agreement().agreeing + c.agreement().disagreeing
        ),
    }
}

pub(crate) fn aligned_verdict(candidate: &Candidate, found: FeatureCounts) -> Verdict {
    let model = Model::of(&candidate.transform);
    Verdict {
        status: if model == Model::Unmoved { Status::Unmoved } else { Status::Aligned },
        model: Some(model),
        transform: Some(candidate.transform),
        inliers: found.inliers,
        keypoints: found.keypoints,
        error_px: (candidate.agreement().agreeing > 0).then_some(candidate.error_px),
        confidence: candidate.confidence(),
        reason: None,
    }
}

pub(super) fn rejected_verdict(reason: String, confidence: f64, found: FeatureCounts) -> Verdict {
    Verdict {
        status: Status::Rejected,
        model: None,
        transform: None,
        inliers: found.inliers,
        keypoints: found.keypoints,
        error_px: None,
        confidence: confidence.min(LEAST_CONFIDENCE),
        reason: Some(reason),
    }
}
