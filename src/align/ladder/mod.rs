//! The ladder: the alignment methods, tried in order from the cheapest to the most expensive.
//!
//! In: the grey pyramids of a bracket. Out: a [`Placement`] for each frame. Cost: [`by_bitmaps`], up to two more
//! refinements and the local check for a frame that needs no other method; several times as much for a difficult frame.
//!
//! A frame is aligned to the reference by bitmaps (`starts`). The transform is refined and then checked (`candidate`).
//! If the check leaves doubt, further candidates are found (`doubtful`): by alignment to the neighbour in exposure that
//! is already aligned, by features, from the other minima of the bitmap search, and, if the scene repeats, by shifting
//! the best candidate by a period (`repetition`). `selection` chooses among the candidates. `reduction` chooses the
//! smallest model that suffices. The transform of a frame with too little detail is inferred from the other frames
//! (`inferred`, `camera_track`). Finally, `local_check` measures how much of the picture the transform does not fit. If
//! the transform is a compromise between several motions, `local_check` replaces it by the homography of the dominant
//! motion. That homography is neither refined on the pixels nor checked by tiles.

mod camera_track;
mod candidate;
mod doubtful;
mod inferred;
mod local_check;
mod reduction;
mod repetition;
mod selection;
mod starts;
mod thresholds;

use crate::align::AlignOptions;
use crate::align::agreement::LEAST_SIDE;
use crate::align::bitmaps;
use crate::align::features;
use crate::align::features::FeatureSets;
use crate::align::grey::{COARSEST, Content, GreyPyramid, content_and_pyramid, measured_level};
use crate::align::ladder::camera_track::capture_times;
use crate::align::ladder::candidate::{Candidate, evaluate};
use crate::align::ladder::local_check::LocalCheck;
use crate::align::ladder::reduction::reduce;
use crate::align::ladder::repetition::Repetition;
use crate::align::ladder::selection::{estimate, rejected, rejection_reason};
use crate::align::ladder::starts::by_bitmaps;
use crate::align::ladder::thresholds::LEAST_INLIERS;
use crate::align::refinement::FramePair;
use crate::align::result::{Estimate, FeatureCounts, Found, Placement};
use crate::align::transform::{Model, Transform, level_to_full};
use crate::bracket::Bracket;
use crate::error::Result;
use crate::plane::{Plane, map_at_once};
use std::sync::OnceLock;

/// The inputs of the alignment of a bracket.
pub(crate) struct Search<'a> {
    /// The grey pyramid of each frame.
    pub(crate) pyramids: &'a [GreyPyramid],
    /// Computes the full-size grey picture of a frame.
    pub(crate) grey: &'a (dyn Fn(usize) -> Plane<u8> + Sync),
    /// Brightness and detail of each frame.
    pub(crate) contents: &'a [Content],
    /// The capture time of each frame, see [`capture_times`].
    pub(crate) capture_times: &'a [f64],
    /// Largest number of frames that are compared with the reference at the same time.
    pub(crate) compared_at_once: usize,
    /// Largest number of frames whose features are detected at the same time.
    pub(crate) detected_at_once: usize,
    pub(crate) reference: usize,
    /// For each frame, the placement that was set before the alignment; otherwise none. The user or a file of
    /// transforms sets it, or the frame is excluded because its flash fired.
    pub(crate) given: &'a [Option<Found>],
    pub(crate) options: &'a AlignOptions,
    /// The local check of each frame that the bitmaps aligned without doubt, made while its planes were in memory.
    pub(crate) checks: Vec<OnceLock<LocalCheck>>,
    /// The transform of each frame that was rejected because too many tiles disagree with it.
    pub(crate) unaccepted: Vec<OnceLock<Transform>>,
}

/// The result of a search.
pub(crate) struct Searched {
    /// The placement of each frame.
    pub(crate) placements: Vec<Placement>,
    /// Numbers of keypoints and inliers of each frame.
    pub(crate) features: Vec<FeatureCounts>,
    /// The grey pyramid of each frame.
    pub(crate) pyramids: Vec<GreyPyramid>,
    /// The transform of each frame that was rejected because too many tiles disagree with it.
    pub(crate) unaccepted: Vec<Option<Transform>>,
}

/// The placements of all frames, and their numbers of keypoints and inliers.
type AllFound = (Vec<Placement>, Vec<FeatureCounts>);

/// The result of aligning a frame to the reference by bitmaps and refinement, without other methods.
enum FirstResult {
    /// No other method is tried. (The local check, or a frame with little detail, may still change the placement.)
    Settled(Found),
    /// Other methods must be tried. Holds the candidate of the bitmaps, if there is one.
    Doubtful(Option<Candidate>),
}

/// What is needed to align the frames that bitmaps and refinement alone do not align ([`FirstResult::Doubtful`]).
struct Shared {
    /// The features of the reference. `None` if bitmaps and refinement aligned every frame, so that features are not
    /// needed.
    features: Option<FeatureSets>,
    repetition: Repetition,
}

impl Search<'_> {
    /// Aligns each frame by bitmaps alone; each transform is a shift and a rotation.
    pub(crate) fn by_bitmaps_alone(&self) -> AllFound {
        self.each(|i| {
            let found = bitmaps::search(self.reference_pyramid(), &self.pyramids[i], 0, &self.options.mtb);
            let checked = self.evaluate(i, found.transform(), found.error_px);
            (Placement::Placed(estimate(&checked)), FeatureCounts::default())
        })
    }

    /// Aligns each frame by features alone; each transform is a homography.
    pub(crate) fn by_features_alone(&self) -> AllFound {
        let sets = map_at_once(self.pyramids.len(), self.detected_at_once, |i| self.features(i));
        let (placements, mut counts) = self.each(|i| {
            let keypoints = Some(sets[i].counts);
            match self.consensus(&sets[self.reference], &sets[i]) {
                Some((transform, inliers)) if inliers >= LEAST_INLIERS => {
                    let placement = Placement::Placed(estimate(&self.evaluate(i, transform, 0.0)));
                    (placement, FeatureCounts { inliers: Some(inliers), keypoints })
                }
                other => {
                    let inliers = other.map_or(0, |c| c.1);
                    let reason =
                        format!("only {inliers} matching keypoints agree on a transform; {LEAST_INLIERS} are needed");
                    (rejected(reason, 0.0), FeatureCounts { inliers: Some(inliers), keypoints })
                }
            }
        });
        counts[self.reference].keypoints = Some(sets[self.reference].counts);
        (placements, counts)
    }

    /// Aligns each frame by as many methods as it needs.
    pub(crate) fn auto(&self) -> AllFound {
        let (width, height) = self.size();
        if width.min(height) < LEAST_SIDE {
            let (mut placements, counts) =
                self.each(|_| (rejected(rejection_reason(None), 0.0), FeatureCounts::default()));
            self.leave_uniform_frames_unmoved(&mut placements);
            return (placements, counts);
        }
        let repetition = Repetition::find(self);
        let first = map_at_once(self.pyramids.len(), self.compared_at_once, |i| self.first(i, repetition.concerns(i)));
        let is_settled = |i: usize| i == self.reference || matches!(first[i], FirstResult::Settled(_));
        let features = (0..first.len()).any(|i| !is_settled(i)).then(|| self.features(self.reference));
        let shared = Shared { features, repetition };
        // Frames are placed outwards from the reference, on the darker and on the brighter side, so that the inner
        // neighbour of a frame is placed before the frame itself.
        let orders: [Vec<usize>; 2] =
            [(0..self.reference).rev().collect(), (self.reference + 1..first.len()).collect()];
        let mut sides = map_at_once(2, self.detected_at_once, |side| self.outwards(&orders[side], &first, &shared));
        let (brighter, darker) = (sides.pop().unwrap_or_default(), sides.pop().unwrap_or_default());
        let keypoints = shared.features.as_ref().map(|f| f.counts);
        let reference = (Placement::Reference, FeatureCounts { inliers: None, keypoints });
        let (mut placements, counts): AllFound = darker.into_iter().rev().chain([reference]).chain(brighter).unzip();
        self.keep_static_frames_static(&mut placements);
        let known = self.known(&placements);
        self.accept_static(&mut placements);
        self.infer_from_track(known, &mut placements);
        self.leave_uniform_frames_unmoved(&mut placements);
        (placements, counts)
    }

    /// Whether frame `i` was rejected because its alignment failed, not because the user or the flash excluded it.
    fn could_not_align(&self, i: usize, placement: &Placement) -> bool {
        self.given[i].is_none() && matches!(placement, Placement::Rejected { .. })
    }

    /// Aligns frame `i` to the reference by bitmaps and refinement.
    fn first(&self, i: usize, repeats: bool) -> FirstResult {
        if i == self.reference {
            return FirstResult::Doubtful(None);
        }
        if let Some(given) = &self.given[i] {
            return FirstResult::Settled(given.clone());
        }
        let (pair, candidate) = by_bitmaps(self.reference_pyramid(), &self.pyramids[i], &self.options.mtb);
        match candidate {
            Some(c) if c.is_settled() && !repeats => {
                let estimate = estimate(&reduce(&pair, c));
                self.keep_local_check(i, &pair, &estimate);
                FirstResult::Settled((Placement::Placed(estimate), FeatureCounts::default()))
            }
            other => FirstResult::Doubtful(other),
        }
    }

    pub(crate) fn reference_pyramid(&self) -> &GreyPyramid {
        &self.pyramids[self.reference]
    }

    pub(crate) fn size(&self) -> (usize, usize) {
        self.reference_pyramid().size(0)
    }

    /// Applies `find` to every frame that is neither the reference nor preset, in parallel.
    fn each(&self, find: impl Fn(usize) -> Found + Sync) -> AllFound {
        let place = |i: usize| match &self.given[i] {
            Some(given) => given.clone(),
            None if i == self.reference => (Placement::Reference, FeatureCounts::default()),
            None => find(i),
        };
        map_at_once(self.pyramids.len(), self.compared_at_once, place).into_iter().unzip()
    }

    fn features(&self, i: usize) -> FeatureSets {
        let level = measured_level(self.reference_pyramid());
        features::features(&self.pyramids[i], level, &self.options.detector(), self.options.mtb.exclusion)
    }

    /// The homography that the robust estimator finds from the matches, and the number of its inliers.
    fn consensus(&self, reference: &FeatureSets, frame: &FeatureSets) -> Option<(Transform, usize)> {
        let to_full = level_to_full(measured_level(self.reference_pyramid()));
        let found = features::by_matches(reference, frame, &to_full, self.options)?;
        Some((Transform::Homography(found.homography), found.inliers.len()))
    }

    /// Checks `transform` by tiles, as a candidate for frame `i`. `noise_px` is the error estimate of the method
    /// that found it; 0 if it is unknown.
    pub(crate) fn evaluate(&self, i: usize, transform: Transform, noise_px: f64) -> Candidate {
        evaluate(&FramePair::new(self.reference_pyramid(), &self.pyramids[i], &transform), transform, noise_px)
    }

    /// Places the frames of `order`, which starts next to the reference. A frame whose first result is not final is
    /// also compared with a neighbour: the nearest frame that precedes it in `order` and was placed.
    fn outwards(&self, order: &[usize], first: &[FirstResult], shared: &Shared) -> Vec<Found> {
        let mut all: Vec<Found> = Vec::with_capacity(order.len());
        for &i in order {
            let found = match &first[i] {
                FirstResult::Settled(found) => found.clone(),
                FirstResult::Doubtful(candidate) => {
                    let mut before = order.iter().zip(&all).rev();
                    let nearest = before.find_map(|(&n, (placement, _))| self.neighbour_target(n, placement));
                    self.doubtful(i, candidate.clone(), nearest, shared)
                }
            };
            all.push(found);
        }
        all
    }

    /// Leaves frames unmoved if none could be aligned because all are uniform or shorter than [`COARSEST`] on one side.
    ///
    /// Such frames cannot be aligned, and a uniform picture does not need alignment. The confidence is 0, because any
    /// other transform would fit as well.
    fn leave_uniform_frames_unmoved(&self, placements: &mut [Placement]) {
        if placements.iter().any(|p| *p != Placement::Reference && p.transform().is_some()) {
            return;
        }
        let (width, height) = self.size();
        let reason = if self.contents.iter().all(|content| content.is_uniform) {
            "every frame is uniform".to_owned()
        } else if width.min(height) < COARSEST {
            format!("{width}x{height} pixels are too few")
        } else {
            return;
        };
        for (i, placement) in placements.iter_mut().enumerate() {
            if self.could_not_align(i, placement) {
                *placement = Placement::Placed(Estimate {
                    transform: Transform::Identity,
                    model: Model::Unmoved,
                    error_px: None,
                    confidence: 0.0,
                    displaced: None,
                    reason: Some(reason.clone()),
                });
            }
        }
    }
}

/// Places the frames of `bracket` with the method `find`, except those whose placement is `given`.
pub(crate) fn search(
    bracket: &Bracket,
    options: &AlignOptions,
    given: &[Option<Found>],
    find: fn(&Search) -> AllFound,
) -> Result<Searched> {
    let prepared = bracket.map_whole(content_and_pyramid);
    let (contents, pyramids): (Vec<_>, Vec<_>) = prepared.into_iter().collect::<Result<Vec<_>>>()?.into_iter().unzip();
    let capture_times = capture_times(bracket);
    // The first error of reading a full-size picture. If there is one, the result of the search is discarded.
    let failed = OnceLock::new();
    let grey = |i: usize| {
        bracket.frames()[i].greys(contents[i].brightening_stops).unwrap_or_else(|error| {
            let _ = failed.set(error);
            Plane::filled(bracket.width(), bracket.height(), 0)
        })
    };
    let search = Search {
        pyramids: &pyramids,
        grey: &grey,
        contents: &contents,
        capture_times: &capture_times,
        compared_at_once: bracket.at_once(),
        detected_at_once: bracket.detected_at_once(),
        reference: bracket.reference_index(),
        given,
        options,
        checks: (0..pyramids.len()).map(|_| OnceLock::new()).collect(),
        unaccepted: (0..pyramids.len()).map(|_| OnceLock::new()).collect(),
    };
    let (mut placements, features) = find(&search);
    search.check_locally(&mut placements);
    let unaccepted = search.unaccepted.into_iter().map(OnceLock::into_inner).collect();
    let searched = Searched { placements, features, pyramids, unaccepted };
    failed.into_inner().map_or(Ok(searched), Err)
}

#[cfg(test)]
mod tests;
