//! The search for the place of every frame of a bracket, in the order from cheap to dear.
//!
//! In: the grey pyramids. Out: a [`Verdict`] for each frame. Cost: for a frame that settles at once that of [`place::by_bitmaps`]; for
//! one in doubt some times as much.

use crate::align::AlignOptions;
use crate::align::agreement::LEAST_SIDE;
use crate::align::bitmaps;
use crate::align::features;
use crate::align::features::FeatureSets;
use crate::align::grey::{COARSEST, GreyPyramid, Seen, measured_level};
use crate::align::place::{self, Candidate};
use crate::align::refinement::Comparison;
use crate::align::result::{KeypointCounts, Status, Verdict};
use crate::align::transform::{Model, Warp, distance, level_to_full};
use crate::plane::{Plane, map_at_once};
use std::borrow::Cow;

/// A candidate with less confidence is no place at all, unless nearly all that speaks speaks for it.
const LEAST_CONFIDENCE: f64 = 0.35;
/// Tiles that must speak for it then. A frame of which little is neither black nor burnt out is often the one that matters.
const LEAST_VOICES: usize = 3;
/// With less trust in a place no number of tiles makes it one.
const LEAST_TRUST: f64 = 0.25;
/// Fewest matches that make a motion: a homography needs four, chance may add as many.
const LEAST_INLIERS: usize = 10;
/// Bitmaps and features that lead to places no farther apart bear each other out, in pixels of the full size for each 1000 of the
/// diagonal.
const CORROBORATED: f64 = 2.0;
/// Places up to so many times as far apart are one, known less well; others are rivals.
const RIVAL_APART: f64 = 3.0;

/// One run over a bracket.
pub(crate) struct Search<'a> {
    /// The frames' grey pyramids.
    pub(crate) pyramids: &'a [GreyPyramid],
    /// ... and the whole pictures, which are made when they are asked for.
    pub(crate) grey: &'a (dyn Fn(usize) -> Plane<u8> + Sync),
    /// What each frame shows.
    pub(crate) seen: &'a [Seen],
    /// When each was taken: seconds, or its position in the order of all.
    pub(crate) turns: &'a [f64],
    /// Whether all frames are of one tone each.
    pub(crate) is_plain: bool,
    /// How many frames may be compared at a time.
    pub(crate) compared_at_once: usize,
    /// How many frames may have their features sought at a time.
    pub(crate) detected_at_once: usize,
    pub(crate) reference: usize,
    /// The frames whose place is given.
    pub(crate) given: &'a [Option<Verdict>],
    pub(crate) options: &'a AlignOptions,
}

/// What a frame is held against: the reference, or a neighbour laid on its grid.
pub(crate) struct Base<'a> {
    pub(crate) pyramid: Cow<'a, GreyPyramid>,
    /// How far the neighbour itself may be off, in pixels.
    error_px: f64,
    /// How sure the neighbour's own place is.
    confidence: f64,
}

/// What came of holding a frame against the reference.
enum First {
    /// It lies so.
    Settled(Verdict),
    /// It may lie so, if anywhere.
    Doubtful(Option<Candidate>),
}

/// What is known of the reference, for all frames in doubt.
struct Shared {
    /// Its features; none where no frame is in doubt.
    features: Option<FeatureSets>,
    /// Whether it repeats itself.
    repeats: bool,
}

/// What features found for a frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Found {
    pub(crate) inliers: Option<usize>,
    pub(crate) keypoints: Option<KeypointCounts>,
}

impl Search<'_> {
    /// From the bitmaps alone: a shift and a rotation.
    pub(crate) fn by_bitmaps_alone(&self) -> Vec<Verdict> {
        self.each(|i| {
            let found = bitmaps::search(self.base(), &self.pyramids[i], 0, &self.options.mtb);
            let seen = self.judged(i, found.warp());
            // Each sees errors that the other does not.
            placed(&Candidate { error_px: seen.error_px.max(found.error_px), ..seen }, Found::default())
        })
    }

    /// From features alone: a homography.
    pub(crate) fn by_features_alone(&self) -> Vec<Verdict> {
        let sets = map_at_once(self.pyramids.len(), self.detected_at_once, |i| self.features(i));
        let mut verdicts = self.each(|i| {
            let keypoints = Some(sets[i].counts);
            match self.consensus(&sets[self.reference], &sets[i]) {
                Some((warp, inliers)) if inliers >= LEAST_INLIERS => {
                    placed(&self.judged(i, warp), Found { inliers: Some(inliers), keypoints })
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
    pub(crate) fn auto(&self) -> Vec<Verdict> {
        let (width, height) = self.size();
        if width.min(height) < LEAST_SIDE {
            let mut verdicts = self.each(|_| rejected(why(None), 0.0, Found::default()));
            self.take_as_they_lie(&mut verdicts);
            return verdicts;
        }
        let repeats = bitmaps::repeats(self.base(), &self.options.mtb);
        let first = map_at_once(self.pyramids.len(), self.compared_at_once, |i| self.first(i, repeats));
        let is_settled = |i: usize| i == self.reference || matches!(first[i], First::Settled(_));
        let features = (0..first.len()).any(|i| !is_settled(i)).then(|| self.features(self.reference));
        let shared = Shared { features, repeats };
        // From the reference outwards, to the darker and to the brighter side, so that a frame in doubt finds its neighbour placed.
        let orders: [Vec<usize>; 2] =
            [(0..self.reference).rev().collect(), (self.reference + 1..first.len()).collect()];
        let mut sides = map_at_once(2, self.detected_at_once, |side| self.outwards(&orders[side], &first, &shared));
        let (brighter, darker) = (sides.pop().unwrap_or_default(), sides.pop().unwrap_or_default());
        let mut verdicts: Vec<Verdict> = darker.into_iter().rev().collect();
        let keypoints = shared.features.as_ref().map(|f| f.counts);
        verdicts.push(Verdict { keypoints, ..Verdict::by_definition(Status::Reference) });
        verdicts.extend(brighter);
        self.settle_still(&mut verdicts);
        let known = self.known(&verdicts);
        self.keep_still(&mut verdicts);
        self.assume(known, &mut verdicts);
        self.take_as_they_lie(&mut verdicts);
        verdicts
    }

    /// What bitmaps and pixels, held against the reference alone, make of frame `i`.
    fn first(&self, i: usize, repeats: bool) -> First {
        if i == self.reference {
            return First::Doubtful(None);
        }
        if let Some(given) = &self.given[i] {
            return First::Settled(given.clone());
        }
        let (pair, candidate) = place::by_bitmaps(self.base(), &self.pyramids[i], &self.options.mtb);
        match candidate {
            Some(c) if c.is_settled() && !repeats => First::Settled(placed(&place::reduce(&pair, c), Found::default())),
            other => First::Doubtful(other),
        }
    }

    pub(crate) fn base(&self) -> &GreyPyramid {
        &self.pyramids[self.reference]
    }

    pub(crate) fn size(&self) -> (usize, usize) {
        self.base().size(0)
    }

    /// `verdict` of every frame but the reference, in parallel.
    fn each(&self, verdict: impl Fn(usize) -> Verdict + Sync) -> Vec<Verdict> {
        let reference = || Verdict::by_definition(Status::Reference);
        let place = |i: usize| match &self.given[i] {
            Some(given) => given.clone(),
            None if i == self.reference => reference(),
            None => verdict(i),
        };
        map_at_once(self.pyramids.len(), self.compared_at_once, place)
    }

    fn features(&self, i: usize) -> FeatureSets {
        let level = measured_level(self.base());
        features::features(&self.pyramids[i], level, &self.options.sift, self.options.mtb.exclusion)
    }

    /// The homography that the matches agree on, and how many do.
    fn consensus(&self, reference: &FeatureSets, frame: &FeatureSets) -> Option<(Warp, usize)> {
        let to_full = level_to_full(measured_level(self.base()));
        let found = features::by_matches(reference, frame, &to_full, self.options)?;
        Some((Warp::Homography(found.homography), found.inliers.len()))
    }

    /// Frame `i` placed by `warp`, as the tiles see it.
    pub(crate) fn judged(&self, i: usize, warp: Warp) -> Candidate {
        place::judge(&Comparison::new(self.base(), &self.pyramids[i], &warp), warp, 0.0)
    }

    /// The verdicts of the frames of `order`, from the reference outwards: a frame in doubt is also compared with the nearest before it that was
    /// placed.
    fn outwards(&self, order: &[usize], first: &[First], shared: &Shared) -> Vec<Verdict> {
        let mut verdicts: Vec<Verdict> = Vec::with_capacity(order.len());
        for &i in order {
            let verdict = match &first[i] {
                First::Settled(verdict) => verdict.clone(),
                First::Doubtful(candidate) => {
                    let nearest = order.iter().zip(&verdicts).rev().find_map(|(&n, verdict)| self.stand_in(n, verdict));
                    self.doubtful(i, candidate.clone(), nearest, shared)
                }
            };
            verdicts.push(verdict);
        }
        verdicts
    }

    /// The verdict of a frame that the bitmaps did not settle.
    fn doubtful(&self, i: usize, first: Option<Candidate>, neighbour: Option<Base>, shared: &Shared) -> Verdict {
        let frame = &self.pyramids[i];
        let (width, height) = self.size();
        let near = CORROBORATED / 1000.0 * ((width * width + height * height) as f64).sqrt();
        let alike = |a: &Warp, b: &Warp| distance(a, b, width, height) <= near;
        let reference = Base { pyramid: Cow::Borrowed(self.base()), error_px: 0.0, confidence: 1.0 };
        let mut bases = vec![reference];
        bases.extend(neighbour);
        let mut pool = Pool::default();
        pool.add(0, first);
        for (b, base) in bases.iter().enumerate().skip(1) {
            let (_, found) = place::by_bitmaps(&base.pyramid, frame, &self.options.mtb);
            pool.add(b, found.map(|c| base.discount(c)));
        }
        let mut found = Found::default();
        let mut is_corroborated = false;
        let is_settled = |pool: &Pool| !shared.repeats && pool.best().is_some_and(|(_, c)| c.is_settled());
        if let (false, Some(reference)) = (is_settled(&pool), &shared.features) {
            let own = self.features(i);
            found.keypoints = Some(own.counts);
            if let Some((start, inliers)) = self.consensus(reference, &own) {
                found.inliers = Some(inliers);
                is_corroborated = inliers >= 2 * LEAST_INLIERS && pool.corroborate(|c| alike(&c.warp, &start));
                if !is_corroborated {
                    for (b, base) in bases.iter().enumerate() {
                        let candidate = place::by_start(&base.compare(frame, &start), &start, 0);
                        pool.add(b, candidate.map(|c| base.discount(c)));
                    }
                }
            }
        }
        // Where a picture repeats itself, features are as easily deceived as bitmaps.
        if shared.repeats || !(is_settled(&pool) || is_corroborated) {
            let start = pool.best().map_or(Warp::Identity, |(_, c)| c.warp);
            let angle = start.rotation_deg(width, height).to_radians();
            for (b, base) in bases.iter().enumerate() {
                for rival in place::by_rivals(&base.compare(frame, &start), angle, &self.options.mtb) {
                    pool.add(b, Some(base.discount(rival)));
                }
            }
        }
        let same = |a: &Candidate, b: &Candidate| distance(&a.warp, &b.warp, width, height) <= RIVAL_APART * near;
        let Some((b, best)) = pool.winner(same) else {
            return rejected(why(None), 0.0, found);
        };
        let doubt = pool.doubt((b, best), |c| !same(c, best));
        let best = Candidate { trust: best.trust * doubt, ..best.clone() };
        if !is_a_place(&best) {
            return rejected(why(Some(&best)), best.confidence(), found);
        }
        let reduced = place::reduce(&bases[b].compare(frame, &best.warp), best.clone());
        let error_px = reduced.error_px.max(bases[b].error_px);
        placed(&Candidate { trust: best.trust, error_px, ..reduced }, found)
    }

    /// Frame `n`, if it was placed, on the reference's grid: what is measured against it is measured in the reference's pixels.
    pub(crate) fn stand_in(&self, n: usize, verdict: &Verdict) -> Option<Base<'_>> {
        let warp = verdict.warp?;
        let pyramid = match warp {
            Warp::Identity => Cow::Borrowed(&self.pyramids[n]),
            warp => Cow::Owned(place::laid_on_reference(&(self.grey)(n), &warp)),
        };
        Some(Base { pyramid, error_px: verdict.error_px.unwrap_or(0.0), confidence: verdict.confidence })
    }
}

impl Search<'_> {
    /// Where no frame shows anything, none of them can be placed, nor need it be: a black picture lies right anywhere. Nor can frames that are
    /// smaller than any level that is searched. That another place would not do as well is not known, so there is no confidence in this one.
    fn take_as_they_lie(&self, verdicts: &mut [Verdict]) {
        let others = || verdicts.iter().filter(|v| v.status != Status::Reference);
        if others().any(|v| v.warp.is_some()) {
            return;
        }
        let (width, height) = self.size();
        let reason = match (self.is_plain, width.min(height) < COARSEST) {
            (true, _) => "each of them is of one tone all over".to_owned(),
            (_, true) => format!("{width}x{height} pixels are too few"),
            _ => return,
        };
        for (i, verdict) in verdicts.iter_mut().enumerate() {
            if verdict.status == Status::Rejected && self.given[i].is_none() {
                let unmoved = Verdict::by_definition(Status::Unmoved);
                let (inliers, keypoints) = (verdict.inliers, verdict.keypoints);
                *verdict = Verdict { inliers, keypoints, confidence: 0.0, reason: Some(reason.clone()), ..unmoved };
            }
        }
    }
}

impl Base<'_> {
    /// `frame` held against this base, in which it lies about as `start` says.
    fn compare<'b>(&'b self, frame: &'b GreyPyramid, start: &Warp) -> Comparison<'b> {
        Comparison::new(&self.pyramid, frame, start)
    }

    /// What was found against this base, with the base's own error and doubt.
    fn discount(&self, candidate: Candidate) -> Candidate {
        let error_px = (candidate.error_px * candidate.error_px + self.error_px * self.error_px).sqrt();
        Candidate { error_px, trust: candidate.trust * self.confidence, ..candidate }
    }
}

/// Whether a candidate is good enough to merge by.
fn is_a_place(candidate: &Candidate) -> bool {
    let agreement = candidate.agreement();
    let unopposed = agreement.confirm >= LEAST_VOICES && agreement.contradict * 8 <= agreement.confirm;
    candidate.confidence() >= LEAST_CONFIDENCE
        || (unopposed && candidate.trust >= LEAST_TRUST && candidate.error_px < candidate.tolerance_px)
}

/// The places that were found for a frame, and the base against which each was.
#[derive(Default)]
struct Pool(Vec<(usize, Candidate)>);

impl Pool {
    fn add(&mut self, base: usize, candidate: Option<Candidate>) {
        self.0.extend(candidate.map(|c| (base, c)));
    }

    /// The one for which most speaks; of nearly equals the first, which was had more directly.
    fn best(&self) -> Option<(usize, &Candidate)> {
        self.0
            .iter()
            .map(|(b, c)| (*b, c))
            .reduce(|best, other| if other.1.evidence() > best.1.evidence() * 1.01 + 0.5 { other } else { best })
    }

    /// Marks the best as led to by features as well, if it is what they `found`.
    fn corroborate(&mut self, found: impl Fn(&Candidate) -> bool) -> bool {
        let best = self.best().map(|(_, c)| c.warp);
        let mut any = false;
        for (_, candidate) in self.0.iter_mut().filter(|(_, c)| best == Some(c.warp)) {
            candidate.corroborated = found(candidate);
            any |= candidate.corroborated;
        }
        any
    }

    /// The best; or, where another held against the same base, for which nearly as much speaks, has decidedly more of the tiles on its
    /// side that speak under both, the one that comes off best against all others. (Under a shift by a facade's period other tiles lie
    /// outside the frame, and say nothing.)
    fn winner(&self, alike: impl Fn(&Candidate, &Candidate) -> bool) -> Option<(usize, &Candidate)> {
        let (base, best) = self.best()?;
        let contenders = self.rivals(base, best, |_| true);
        let worst_lead = |c: &Candidate| {
            let others = contenders.iter().filter(|o| !alike(o, c));
            others.map(|o| c.survey.against(&o.survey)).fold(f64::INFINITY, f64::min)
        };
        if worst_lead(best) >= -DECISIVE {
            return Some((base, best));
        }
        let leads = contenders.iter().map(|c| (worst_lead(c), *c));
        let winner = leads.reduce(|w, c| if c.0 > w.0 { c } else { w })?;
        Some((base, winner.1))
    }

    /// Those held against the same base as `best` for which nearly as much speaks, and which are what `is_other` asks for; `best` itself
    /// may be.
    fn rivals(&self, base: usize, best: &Candidate, is_other: impl Fn(&Candidate) -> bool) -> Vec<&Candidate> {
        let least = RIVALRY * best.evidence();
        let same_base = self.0.iter().filter(|(b, _)| *b == base).map(|(_, c)| c);
        same_base.filter(|c| c.evidence() >= least && is_other(c)).collect()
    }

    /// 1 where nothing rivals `best`; half where one of the `others` does so that the tiles that speak under both are for `best` by no
    /// more than [`DECISIVE`].
    fn doubt(&self, (base, best): (usize, &Candidate), others: impl Fn(&Candidate) -> bool) -> f64 {
        let leads = self.rivals(base, best, others).into_iter().map(|c| best.survey.against(&c.survey));
        let lead = leads.fold(f64::INFINITY, f64::min);
        if lead.is_infinite() { 1.0 } else { lead.max(0.0) / (lead.max(0.0) + DECISIVE) }
    }
}

/// A candidate rivals another where so many times as much speaks for it.
const RIVALRY: f64 = 0.4;
/// Fewer nats leave it undecided which is right.
pub(crate) const DECISIVE: f64 = 2.0;

fn why(candidate: Option<&Candidate>) -> String {
    match candidate {
        None => "it has too little in common with the reference to tell how it moved".into(),
        Some(c) if c.agreement().confirm + c.agreement().contradict < 8 => {
            "too few parts of it are neither black, burnt out nor plain to tell how it moved".into()
        }
        Some(c) => format!(
            "no motion makes it agree with the reference: {} of {} parts contradict the best one",
            c.agreement().contradict,
            c.agreement().confirm + c.agreement().contradict
        ),
    }
}

pub(crate) fn placed(candidate: &Candidate, found: Found) -> Verdict {
    let model = Model::of(&candidate.warp);
    Verdict {
        status: if model == Model::Unmoved { Status::Unmoved } else { Status::Aligned },
        model: Some(model),
        warp: Some(candidate.warp),
        inliers: found.inliers,
        keypoints: found.keypoints,
        error_px: (candidate.agreement().confirm > 0).then_some(candidate.error_px),
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
