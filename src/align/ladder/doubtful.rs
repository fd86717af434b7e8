//! A frame that the bitmaps alone did not settle: compared with a neighbour in exposure too, by features, by the bitmaps' other minima.
//!
//! In: what is known of the reference, and the nearest neighbour that was aligned. Out: a [`Verdict`]. Cost: some times that of a frame that
//! the bitmaps settle.

use crate::align::grey::GreyPyramid;
use crate::align::ladder::LEAST_INLIERS;
use crate::align::ladder::Search;
use crate::align::ladder::Shared;
use crate::align::ladder::candidate::Candidate;
use crate::align::ladder::reduction::reduce;
use crate::align::ladder::selection::Found;
use crate::align::ladder::selection::Pool;
use crate::align::ladder::selection::is_a_place;
use crate::align::ladder::selection::placed;
use crate::align::ladder::selection::rejected;
use crate::align::ladder::selection::why;
use crate::align::ladder::starts::by_bitmaps;
use crate::align::ladder::starts::by_rivals;
use crate::align::ladder::starts::by_start;
use crate::align::ladder::starts::laid_on_reference;
use crate::align::refinement::Comparison;
use crate::align::result::Verdict;
use crate::align::transform::{Warp, distance};
use std::borrow::Cow;

/// Bitmaps and features that lead to places no farther apart bear each other out, in pixels of the full size for each 1000 of the
/// diagonal.
const CORROBORATED: f64 = 2.0;

/// Places up to so many times as far apart are one, known less well; others are rivals.
const RIVAL_APART: f64 = 3.0;

/// What a frame is held against: the reference, or a neighbour laid on its grid.
pub(crate) struct Base<'a> {
    pub(crate) pyramid: Cow<'a, GreyPyramid>,
    /// How far the neighbour itself may be off, in pixels.
    pub(super) error_px: f64,
    /// How sure the neighbour's own place is.
    pub(super) confidence: f64,
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

impl Search<'_> {
    /// The verdict of a frame that the bitmaps did not settle.
    pub(super) fn doubtful(
        &self,
        i: usize,
        first: Option<Candidate>,
        neighbour: Option<Base>,
        shared: &Shared,
    ) -> Verdict {
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
            let (_, found) = by_bitmaps(&base.pyramid, frame, &self.options.mtb);
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
                        let candidate = by_start(&base.compare(frame, &start), &start, 0);
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
                for rival in by_rivals(&base.compare(frame, &start), angle, &self.options.mtb) {
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
        let reduced = reduce(&bases[b].compare(frame, &best.warp), best.clone());
        let error_px = reduced.error_px.max(bases[b].error_px);
        placed(&Candidate { trust: best.trust, error_px, ..reduced }, found)
    }

    /// Frame `n`, if it was placed, on the reference's grid: what is measured against it is measured in the reference's pixels.
    pub(crate) fn stand_in(&self, n: usize, verdict: &Verdict) -> Option<Base<'_>> {
        let warp = verdict.warp?;
        let pyramid = match warp {
            Warp::Identity => Cow::Borrowed(&self.pyramids[n]),
            warp => Cow::Owned(laid_on_reference(&(self.grey)(n), &warp)),
        };
        Some(Base { pyramid, error_px: verdict.error_px.unwrap_or(0.0), confidence: verdict.confidence })
    }
}
