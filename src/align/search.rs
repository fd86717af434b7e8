//! The search for the place of every frame of a bracket, in the order from cheap to dear.
//!
//! In: the grey pyramids. Out: a [`Verdict`] for each frame. Cost: for a frame that settles at once that of [`place::by_bitmaps`]; for
//! one in doubt some times as much.

use super::feature_sets::{self, FeatureSets};
use super::mtb::{self, GreyPyramid};
use super::place::{self, Candidate};
use super::warp::Warp;
use super::{AlignOptions, KeypointCounts, Model, Status, Verdict};
use rayon::prelude::*;
use std::borrow::Cow;

/// A candidate with less confidence is no place at all, unless nearly all that speaks speaks for it.
const LEAST_CONFIDENCE: f64 = 0.35;
/// Tiles that must speak for it then. A frame of which little is neither black nor burnt out is often the one that matters.
const LEAST_VOICES: usize = 3;
/// Confidence in a frame that says nothing itself, where all the others are unmoved.
pub(super) const BY_COMPANY: f64 = 0.6;
/// Fewest matches that make a motion: a homography needs four, chance may add as many.
const LEAST_INLIERS: usize = 10;
/// Bitmaps and features that lead to places no farther apart bear each other out, in pixels of the full size for each 1000 of the
/// diagonal.
const CORROBORATED: f64 = 2.0;

/// One run over a bracket.
pub(super) struct Search<'a> {
    pub(super) pyramids: &'a [GreyPyramid],
    pub(super) reference: usize,
    pub(super) options: &'a AlignOptions,
}

/// What a frame is held against: the reference, or a neighbour laid on its grid.
struct Base<'a> {
    pyramid: Cow<'a, GreyPyramid>,
    /// How far the neighbour itself may be off, in pixels.
    error_px: f64,
    /// How sure the neighbour's own place is.
    confidence: f64,
}

/// What features found for a frame.
#[derive(Debug, Clone, Default)]
struct Found {
    inliers: Option<usize>,
    keypoints: Option<KeypointCounts>,
}

impl Search<'_> {
    /// From the bitmaps alone: a shift and a rotation.
    pub(super) fn by_bitmaps_alone(&self) -> Vec<Verdict> {
        self.each(|i| {
            let found = mtb::search(self.base(), &self.pyramids[i], 0, &self.options.mtb);
            placed(&place::judge(self.base(), &self.pyramids[i], found.warp(), 0.0), Found::default())
        })
    }

    /// From features alone: a homography.
    pub(super) fn by_features_alone(&self) -> Vec<Verdict> {
        let sets: Vec<FeatureSets> = (0..self.pyramids.len()).into_par_iter().map(|i| self.features(i)).collect();
        let mut verdicts = self.each(|i| {
            let keypoints = Some(sets[i].counts);
            match self.consensus(&sets[self.reference], &sets[i]) {
                Some((warp, inliers)) if inliers >= LEAST_INLIERS => {
                    let candidate = place::judge(self.base(), &self.pyramids[i], warp, 0.0);
                    placed(&candidate, Found { inliers: Some(inliers), keypoints })
                }
                other => {
                    let inliers = other.map_or(0, |c| c.1);
                    let reason =
                        format!("only {inliers} matching keypoints agree on a motion, {LEAST_INLIERS} are needed");
                    rejected(reason, 0.0, Found { inliers: Some(inliers), keypoints })
                }
            }
        });
        verdicts[self.reference].keypoints = Some(sets[self.reference].counts);
        verdicts
    }

    /// By all means, as far as needed.
    pub(super) fn auto(&self) -> Vec<Verdict> {
        let first: Vec<Option<Candidate>> = (0..self.pyramids.len())
            .into_par_iter()
            .map(|i| {
                let frame = (i != self.reference).then(|| &self.pyramids[i])?;
                place::by_bitmaps(self.base(), frame, &self.options.mtb)
            })
            .collect();
        let settled: Vec<Option<Verdict>> = (0..self.pyramids.len())
            .into_par_iter()
            .map(|i| {
                let candidate = first[i].as_ref().filter(|c| c.is_settled())?;
                Some(placed(&place::reduce(self.base(), &self.pyramids[i], candidate.clone()), Found::default()))
            })
            .collect();
        let doubtful = (0..settled.len()).any(|i| i != self.reference && settled[i].is_none());
        let features = doubtful.then(|| self.features(self.reference));
        // From the reference outwards, to the darker and to the brighter side, so that a frame in doubt finds its neighbour placed.
        let side = |order: Vec<usize>| self.outwards(&order, &first, &settled, features.as_ref());
        let (darker, brighter) = rayon::join(
            || side((0..self.reference).rev().collect()),
            || side((self.reference + 1..settled.len()).collect()),
        );
        let mut verdicts: Vec<Verdict> = darker.into_iter().rev().collect();
        let keypoints = features.map(|f| f.counts);
        verdicts.push(Verdict { keypoints, ..Verdict::by_definition(Status::Reference) });
        verdicts.extend(brighter);
        self.keep_company(&mut verdicts);
        verdicts
    }

    fn base(&self) -> &GreyPyramid {
        &self.pyramids[self.reference]
    }

    fn size(&self) -> (usize, usize) {
        (self.base().level(0).width(), self.base().level(0).height())
    }

    /// `verdict` of every frame but the reference, in parallel.
    fn each(&self, verdict: impl Fn(usize) -> Verdict + Sync) -> Vec<Verdict> {
        let reference = || Verdict::by_definition(Status::Reference);
        let place = |i| if i == self.reference { reference() } else { verdict(i) };
        (0..self.pyramids.len()).into_par_iter().map(place).collect()
    }

    fn features(&self, i: usize) -> FeatureSets {
        let level = place::features_level(self.base());
        feature_sets::features(&self.pyramids[i], level, &self.options.sift, &self.options.mtb)
    }

    /// The homography that the matches agree on, and how many do.
    fn consensus(&self, reference: &FeatureSets, frame: &FeatureSets) -> Option<(Warp, usize)> {
        let to_full = place::level_to_full(place::features_level(self.base()));
        let found = feature_sets::by_matches(reference, frame, &to_full, self.options)?;
        Some((Warp::Homography(found.homography), found.inliers.len()))
    }

    /// The verdicts of the frames of `order`, each of which is the neighbour of the one before it, the first that of the reference.
    fn outwards(
        &self,
        order: &[usize],
        first: &[Option<Candidate>],
        settled: &[Option<Verdict>],
        features: Option<&FeatureSets>,
    ) -> Vec<Verdict> {
        let mut verdicts: Vec<Verdict> = Vec::with_capacity(order.len());
        for (k, &i) in order.iter().enumerate() {
            let verdict = match &settled[i] {
                Some(verdict) => verdict.clone(),
                None => {
                    let neighbour = k.checked_sub(1).map(|k| (order[k], &verdicts[k]));
                    self.doubtful(i, first[i].clone(), neighbour, features)
                }
            };
            verdicts.push(verdict);
        }
        verdicts
    }

    /// The verdict of a frame that the bitmaps did not settle.
    fn doubtful(
        &self,
        i: usize,
        first: Option<Candidate>,
        neighbour: Option<(usize, &Verdict)>,
        features: Option<&FeatureSets>,
    ) -> Verdict {
        let frame = &self.pyramids[i];
        let reference = Base { pyramid: Cow::Borrowed(self.base()), error_px: 0.0, confidence: 1.0 };
        let mut bases = vec![reference];
        bases.extend(neighbour.and_then(|(n, verdict)| self.stand_in(n, verdict)));
        // Which base it was held against, and what came of it.
        let mut best: Option<(usize, Candidate)> = first.map(|c| (0, c));
        for (b, base) in bases.iter().enumerate().skip(1) {
            let found = place::by_bitmaps(&base.pyramid, frame, &self.options.mtb);
            keep_better(&mut best, b, found.map(|c| base.discount(c)));
        }
        let mut found = Found::default();
        let mut is_corroborated = false;
        let is_settled = |best: &Option<(usize, Candidate)>| best.as_ref().is_some_and(|(_, c)| c.is_settled());
        if let (false, Some(reference)) = (is_settled(&best), features) {
            let own = self.features(i);
            found.keypoints = Some(own.counts);
            if let Some((start, inliers)) = self.consensus(reference, &own) {
                found.inliers = Some(inliers);
                let (width, height) = self.size();
                let near = CORROBORATED / 1000.0 * ((width * width + height * height) as f64).sqrt();
                let same = |c: &Candidate| place::distance(&c.warp, &start, width, height) <= near;
                is_corroborated = inliers >= 2 * LEAST_INLIERS && best.as_ref().is_some_and(|(_, c)| same(c));
                if let (true, Some((_, candidate))) = (is_corroborated, &mut best) {
                    candidate.corroborated = true;
                }
                if !is_corroborated {
                    for (b, base) in bases.iter().enumerate() {
                        let candidate = place::by_start(&base.pyramid, frame, &start, 1);
                        keep_better(&mut best, b, candidate.map(|c| base.discount(c)));
                    }
                }
            }
        }
        if !is_settled(&best) && !is_corroborated {
            let (width, height) = self.size();
            let angle = best.as_ref().map_or(0.0, |(_, c)| c.warp.rotation_deg(width, height).to_radians());
            for (b, base) in bases.iter().enumerate() {
                for rival in place::by_rivals(&base.pyramid, frame, angle, &self.options.mtb) {
                    keep_better(&mut best, b, Some(base.discount(rival)));
                }
            }
        }
        match best {
            Some((b, candidate)) if is_a_place(&candidate) => {
                let reduced = place::reduce(&bases[b].pyramid, frame, candidate);
                placed(&bases[b].discount(reduced), found)
            }
            other => {
                let candidate = other.map(|(_, c)| c);
                let confidence = candidate.as_ref().map_or(0.0, Candidate::confidence);
                rejected(why(candidate.as_ref()), confidence, found)
            }
        }
    }

    /// The placed neighbour `n` on the reference's grid: what is measured against it is measured in the reference's pixels.
    fn stand_in(&self, n: usize, verdict: &Verdict) -> Option<Base<'_>> {
        let warp = verdict.warp?;
        let pyramid = match warp {
            Warp::Identity => Cow::Borrowed(&self.pyramids[n]),
            warp => Cow::Owned(place::laid_on_reference(&self.pyramids[n], &warp)),
        };
        Some(Base { pyramid, error_px: verdict.error_px.unwrap_or(0.0), confidence: verdict.confidence })
    }

    /// A frame too dark or too bright to say anything is unmoved where all the others are: it stood on the same tripod.
    fn keep_company(&self, verdicts: &mut [Verdict]) {
        let still = verdicts.iter().filter(|v| v.status == Status::Unmoved).count();
        let moved = verdicts.iter().any(|v| v.status == Status::Aligned);
        if still == 0 || moved {
            return;
        }
        for (i, verdict) in verdicts.iter_mut().enumerate() {
            if verdict.status == Status::Rejected {
                let here = place::judge(self.base(), &self.pyramids[i], Warp::Identity, 0.0);
                if here.agreement.contradict <= here.agreement.confirm {
                    let found = Found { inliers: verdict.inliers, keypoints: verdict.keypoints };
                    *verdict = placed(&here, found);
                    verdict.confidence = verdict.confidence.max(BY_COMPANY);
                }
            }
        }
    }
}

impl Base<'_> {
    /// What was found against this base, with the base's own error and doubt.
    fn discount(&self, candidate: Candidate) -> Candidate {
        let error_px = (candidate.error_px * candidate.error_px + self.error_px * self.error_px).sqrt();
        Candidate { error_px, trust: candidate.trust * self.confidence, ..candidate }
    }
}

/// Whether a candidate is good enough to merge by.
fn is_a_place(candidate: &Candidate) -> bool {
    let agreement = &candidate.agreement;
    let unopposed = agreement.confirm >= LEAST_VOICES && agreement.contradict * 8 <= agreement.confirm;
    candidate.confidence() >= LEAST_CONFIDENCE || (unopposed && candidate.error_px < candidate.tolerance_px)
}

/// Keeps the more confident of the two; of nearly equals the first, which was had more directly.
fn keep_better(best: &mut Option<(usize, Candidate)>, base: usize, other: Option<Candidate>) {
    if let Some(other) = other
        && best.as_ref().is_none_or(|(_, b)| other.confidence() > b.confidence() + 0.005)
    {
        *best = Some((base, other));
    }
}

fn why(candidate: Option<&Candidate>) -> String {
    match candidate {
        None => "it has too little in common with the reference to tell how it moved".into(),
        Some(c) if c.agreement.confirm + c.agreement.contradict < 8 => {
            "too few parts of it are neither black, burnt out nor plain to tell how it moved".into()
        }
        Some(c) => format!(
            "no motion makes it agree with the reference: {} of {} parts contradict the best one",
            c.agreement.contradict,
            c.agreement.confirm + c.agreement.contradict
        ),
    }
}

fn placed(candidate: &Candidate, found: Found) -> Verdict {
    let model = Model::of(&candidate.warp);
    Verdict {
        status: if model == Model::Unmoved { Status::Unmoved } else { Status::Aligned },
        model: Some(model),
        warp: Some(candidate.warp),
        inliers: found.inliers,
        keypoints: found.keypoints,
        error_px: (candidate.agreement.confirm > 0).then_some(candidate.error_px),
        confidence: candidate.confidence(),
        reason: None,
    }
}

fn rejected(reason: String, confidence: f64, found: Found) -> Verdict {
    Verdict {
        status: Status::Rejected,
        model: None,
        warp: None,
        inliers: found.inliers,
        keypoints: found.keypoints,
        error_px: None,
        confidence: confidence.min(LEAST_CONFIDENCE),
        reason: Some(reason),
    }
}
