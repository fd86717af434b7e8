//! Alignment: where every frame's pixels lie in the reference, and how sure that is.
//!
//! In: a [`Bracket`]. Out: an [`Alignment`]: a [`Verdict`] for each frame, by the smallest [`Model`] that explains its motion, each
//! straight to the reference. Cost: for a frame of 12 MP about what its decoding costs.
//!
//! `auto` goes from cheap to dear and stops where the picture's tiles agree: bitmaps ([`mtb`]) refined on the pixels ([`refine`]);
//! features ([`sift`] on the plain picture and on its bitmap) where that leaves a doubt; the bitmaps' other minima; the way by a
//! neighbour in exposure. What a stage finds is only ever a start for [`refine`] against the reference, and only [`agreement`], which no
//! stage optimises, says whether it is right.

pub mod agreement;
pub mod bitmap;
pub mod features;
pub mod homography;
pub mod intensity_map;
pub mod mtb;
mod overlap;
mod place;
pub mod ransac;
pub mod refine;
pub mod resample;
#[cfg(test)]
pub(crate) mod scene;
pub mod sift;
pub mod warp;

use crate::bracket::Bracket;
use crate::error::{Error, Result, Warning};
use mtb::{GreyPyramid, MtbOptions};
use nalgebra::Matrix3;
use place::{Candidate, FeatureSets};
use ransac::RansacOptions;
use rayon::prelude::*;
use sift::SiftOptions;
use warp::Warp;

/// Which methods seek the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum AlignMode {
    /// All of them, as far as needed; every result judged.
    #[default]
    Auto,
    /// Median threshold bitmaps alone: shift and rotation.
    Mtb,
    /// SIFT on the plain picture and its bitmap, and RANSAC: a homography.
    Sift,
    /// None: the frames are taken as they lie.
    None,
}

/// How frames are aligned.
#[derive(Debug, Clone, PartialEq)]
pub struct AlignOptions {
    /// Which methods.
    pub mode: AlignMode,
    /// The bitmaps and their search.
    pub mtb: MtbOptions,
    /// The detector.
    pub sift: SiftOptions,
    /// A match must be nearer than this share of the second nearest (Lowe 2004, section 7.1).
    pub ratio: f64,
    /// The robust fit; its threshold is in pixels of the level on which features are sought.
    pub ransac: RansacOptions,
}

impl Default for AlignOptions {
    fn default() -> Self {
        AlignOptions {
            mode: AlignMode::Auto,
            mtb: MtbOptions::default(),
            sift: SiftOptions::default(),
            ratio: 0.8,
            ransac: RansacOptions::default(),
        }
    }
}

impl AlignOptions {
    /// Checks the values against their ranges.
    ///
    /// # Errors
    /// [`Error::Option`] for the first that is out of range.
    pub fn validate(&self) -> Result<()> {
        let angle = self.mtb.max_rotation_deg;
        if !(0.0..=45.0).contains(&angle) {
            let reason = format!("{angle} is not within 0..45 degrees; give a number such as 5");
            return Err(Error::Option { option: "--max-rotation", reason });
        }
        Ok(())
    }
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// The frame that the others are aligned to.
    Reference,
    /// Moved, and placed by a warp.
    Aligned,
    /// Found not to have moved: its warp is exactly the identity.
    Unmoved,
    /// Not placed; it takes no part in what follows.
    Rejected,
}

/// What a warp is allowed to do, from the least to the most.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// Nothing.
    Unmoved,
    /// Shift: two numbers.
    Shift,
    /// Shift and rotation about the centre: three numbers.
    Rigid,
    /// Any view of a plane, or any turn of the camera: eight numbers.
    Homography,
}

/// Keypoints found in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct KeypointCounts {
    /// In the plain picture.
    pub plain: usize,
    /// In its median threshold bitmap.
    pub mtb: usize,
    /// In both together, points found twice counted once.
    pub merged: usize,
}

/// A rectangle of pixels: columns `x0..x1`, rows `y0..y1` of the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Rect {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Column after the last.
    pub x1: usize,
    /// Row after the last.
    pub y1: usize,
}

impl Rect {
    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.x1 - self.x0
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.y1 - self.y0
    }
}

/// What is known of one frame's place.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// What became of the frame.
    pub status: Status,
    /// The smallest model that explains its motion; none where it was rejected.
    pub model: Option<Model>,
    /// Its warp, reference pixel -> frame pixel; none where it was rejected.
    pub warp: Option<Warp>,
    /// Matches that RANSAC agreed on; none where features were not needed.
    pub inliers: Option<usize>,
    /// Keypoints in this frame; none where features were not needed.
    pub keypoints: Option<KeypointCounts>,
    /// Our own estimate of the root mean square error of the warp over the picture, in pixels; none where nothing can be said.
    pub error_px: Option<f64>,
    /// How sure it is, 0..1: under 0.5 is doubtful; 1 where the user said so.
    pub confidence: f64,
    /// Why it was rejected.
    pub reason: Option<String>,
}

impl Verdict {
    /// A frame that lies as the reference does, because it is the reference or because the user says so.
    fn by_definition(status: Status) -> Self {
        Verdict {
            status,
            model: Some(Model::Unmoved),
            warp: Some(Warp::Identity),
            inliers: None,
            keypoints: None,
            error_px: (status == Status::Reference).then_some(0.0),
            confidence: 1.0,
            reason: None,
        }
    }
}

/// The place of every frame of a bracket.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// One verdict per frame, in the order of [`Bracket::frames`].
    pub verdicts: Vec<Verdict>,
    /// The largest rectangle of the reference that all placed frames cover.
    pub overlap: Rect,
}

impl Alignment {
    /// Every frame of `bracket` as it lies, unseen: for a tripod that can be trusted.
    pub fn unmoved(bracket: &Bracket) -> Self {
        let status = |i| if i == bracket.reference_index() { Status::Reference } else { Status::Unmoved };
        Alignment {
            verdicts: (0..bracket.frames().len()).map(|i| Verdict::by_definition(status(i))).collect(),
            overlap: Rect { x0: 0, y0: 0, x1: bracket.width(), y1: bracket.height() },
        }
    }
}

/// A candidate with less confidence is no place at all.
const LEAST_CONFIDENCE: f64 = 0.35;
/// A place with less confidence is told to the user.
const DOUBT: f64 = 0.5;
/// Confidence in a frame that says nothing itself, where all the others are unmoved.
const BY_COMPANY: f64 = 0.6;

/// Places every frame of `bracket`.
///
/// # Errors
/// [`Error::Option`] where an option is out of range. That a frame cannot be placed is no error, but a verdict and a warning.
pub fn align(bracket: &Bracket, options: &AlignOptions) -> Result<(Alignment, Vec<Warning>)> {
    options.validate()?;
    if options.mode == AlignMode::None {
        return Ok((Alignment::unmoved(bracket), Vec::new()));
    }
    let pyramids: Vec<GreyPyramid> = bracket.frames().par_iter().map(|f| GreyPyramid::new(f.grey())).collect();
    let search = Search { pyramids: &pyramids, reference: bracket.reference_index(), options };
    let verdicts = match options.mode {
        AlignMode::Auto | AlignMode::None => search.auto(),
        AlignMode::Mtb => search.each(|i| search.by_bitmaps_alone(i)),
        AlignMode::Sift => search.by_features_alone(),
    };
    let warnings = warn(bracket, &verdicts);
    let warps: Vec<Warp> = verdicts.iter().filter_map(|v| v.warp).collect();
    let overlap = overlap::largest(&warps, bracket.width(), bracket.height());
    Ok((Alignment { verdicts, overlap }, warnings))
}

fn warn(bracket: &Bracket, verdicts: &[Verdict]) -> Vec<Warning> {
    let mut warnings = Vec::new();
    for (frame, verdict) in bracket.frames().iter().zip(verdicts) {
        let path = frame.path().to_path_buf();
        match verdict.status {
            Status::Rejected => {
                let reason = verdict.reason.clone().unwrap_or_default();
                warnings.push(Warning::FrameRejected { path, reason });
            }
            _ if verdict.confidence < DOUBT => {
                warnings.push(Warning::LowConfidence { path, confidence: verdict.confidence });
            }
            _ => {}
        }
    }
    warnings
}

/// One run over a bracket.
struct Search<'a> {
    pyramids: &'a [GreyPyramid],
    reference: usize,
    options: &'a AlignOptions,
}

/// What features found for a frame.
#[derive(Debug, Clone, Default)]
struct Found {
    inliers: Option<usize>,
    keypoints: Option<KeypointCounts>,
}

impl Search<'_> {
    fn base(&self) -> &GreyPyramid {
        &self.pyramids[self.reference]
    }

    fn others(&self) -> Vec<usize> {
        (0..self.pyramids.len()).filter(|&i| i != self.reference).collect()
    }

    /// `verdict` of every frame but the reference, in parallel.
    fn each(&self, verdict: impl Fn(usize) -> Verdict + Sync) -> Vec<Verdict> {
        let place = |i| {
            if i == self.reference { Verdict::by_definition(Status::Reference) } else { verdict(i) }
        };
        (0..self.pyramids.len()).into_par_iter().map(place).collect()
    }

    fn by_bitmaps_alone(&self, i: usize) -> Verdict {
        let found = mtb::search(self.base(), &self.pyramids[i], 0, &self.options.mtb);
        let (model, warp) = match found.warp() {
            Warp::Rigid { dx: 0.0, dy: 0.0, angle: 0.0 } => (Model::Unmoved, Warp::Identity),
            warp @ Warp::Rigid { angle: 0.0, .. } => (Model::Shift, warp),
            warp => (Model::Rigid, warp),
        };
        placed(model, &place::judge(self.base(), &self.pyramids[i], warp, 0.0), &Found::default())
    }

    fn by_features_alone(&self) -> Vec<Verdict> {
        let sets: Vec<FeatureSets> = (0..self.pyramids.len()).into_par_iter().map(|i| self.features(i)).collect();
        let to_full = place::level_to_full(place::features_level(self.base()));
        self.each(|i| {
            let keypoints = Some(sets[i].counts);
            let consensus = place::by_matches(
                &sets[self.reference],
                &sets[i],
                &to_full,
                self.options.ratio,
                None,
                &self.options.ransac,
            );
            match consensus {
                Some(c) if c.inliers.len() >= LEAST_INLIERS => {
                    let warp = Warp::Homography(c.homography);
                    let found = Found { inliers: Some(c.inliers.len()), keypoints };
                    placed(Model::Homography, &place::judge(self.base(), &self.pyramids[i], warp, 0.0), &found)
                }
                other => {
                    let inliers = other.map_or(0, |c| c.inliers.len());
                    let reason =
                        format!("only {inliers} matching keypoints agree on a motion, {LEAST_INLIERS} are needed");
                    rejected(reason, 0.0, &Found { inliers: Some(inliers), keypoints })
                }
            }
        })
    }

    fn features(&self, i: usize) -> FeatureSets {
        place::features(&self.pyramids[i], &self.options.sift, &self.options.mtb)
    }

    fn auto(&self) -> Vec<Verdict> {
        let mut best: Vec<Option<Candidate>> = (0..self.pyramids.len())
            .into_par_iter()
            .map(|i| {
                if i == self.reference {
                    return None;
                }
                place::by_bitmaps(self.base(), &self.pyramids[i], &self.options.mtb)
            })
            .collect();
        let mut found = vec![Found::default(); self.pyramids.len()];
        self.try_features(&mut best, &mut found);
        self.try_rivals(&mut best);
        self.try_neighbours(&mut best);
        let mut verdicts = self.each(|i| {
            let Some(candidate) =
                best[i].clone().filter(|c| c.agreement.confirm > 0 && c.confidence() >= LEAST_CONFIDENCE)
            else {
                let confidence = best[i].as_ref().map_or(0.0, Candidate::confidence);
                return rejected(why(best[i].as_ref()), confidence, &found[i]);
            };
            let (model, candidate) = place::reduce(self.base(), &self.pyramids[i], candidate);
            placed(model, &candidate, &found[i])
        });
        self.keep_company(&mut verdicts, &best, &found);
        verdicts
    }

    /// The frames whose place is still in doubt.
    fn unsettled(&self, best: &[Option<Candidate>]) -> Vec<usize> {
        self.others().into_iter().filter(|&i| best[i].as_ref().is_none_or(|c| !c.is_settled())).collect()
    }

    fn try_features(&self, best: &mut [Option<Candidate>], found: &mut [Found]) {
        let doubtful = self.unsettled(best);
        if doubtful.is_empty() {
            return;
        }
        let wanted: Vec<usize> = std::iter::once(self.reference).chain(doubtful.iter().copied()).collect();
        let sets: Vec<FeatureSets> = wanted.par_iter().map(|&i| self.features(i)).collect();
        let to_full = place::level_to_full(place::features_level(self.base()));
        let results: Vec<(Option<usize>, Option<Candidate>)> = (1..wanted.len())
            .into_par_iter()
            .map(|k| {
                let consensus =
                    place::by_matches(&sets[0], &sets[k], &to_full, self.options.ratio, None, &self.options.ransac);
                let Some(consensus) = consensus else {
                    return (None, None);
                };
                let start = Warp::Homography(consensus.homography);
                let candidate = place::by_start(self.base(), &self.pyramids[wanted[k]], &start, 1);
                (Some(consensus.inliers.len()), candidate)
            })
            .collect();
        for (k, (inliers, candidate)) in results.into_iter().enumerate() {
            let i = wanted[k + 1];
            found[i] = Found { inliers, keypoints: Some(sets[k + 1].counts) };
            keep_better(&mut best[i], candidate);
        }
        found[self.reference].keypoints = Some(sets[0].counts);
    }

    fn try_rivals(&self, best: &mut [Option<Candidate>]) {
        let doubtful = self.unsettled(best);
        let (width, height) = (self.base().level(0).width(), self.base().level(0).height());
        let results: Vec<Vec<Candidate>> = doubtful
            .par_iter()
            .map(|&i| {
                let angle = best[i].as_ref().map_or(0.0, |c| c.warp.rotation_deg(width, height).to_radians());
                place::by_rivals(self.base(), &self.pyramids[i], angle, &self.options.mtb)
            })
            .collect();
        for (i, rivals) in doubtful.into_iter().zip(results) {
            for rival in rivals {
                keep_better(&mut best[i], Some(rival));
            }
        }
    }

    /// From the reference outwards: a frame in doubt is placed against the next one, and starts from there.
    fn try_neighbours(&self, best: &mut [Option<Candidate>]) {
        let (width, height) = (self.base().level(0).width(), self.base().level(0).height());
        let mut outwards = self.unsettled(best);
        outwards.sort_by_key(|&i| (i.abs_diff(self.reference), i));
        for i in outwards {
            let neighbour = if i < self.reference { i + 1 } else { i - 1 };
            if neighbour == self.reference {
                continue;
            }
            let Some(first) = best[neighbour].as_ref().filter(|c| c.confidence() >= DOUBT) else {
                continue;
            };
            let Some(second) = place::by_bitmaps(&self.pyramids[neighbour], &self.pyramids[i], &self.options.mtb)
            else {
                continue;
            };
            let h: Matrix3<f64> = second.warp.matrix(width, height) * first.warp.matrix(width, height);
            let start = Warp::Homography(h / h[(2, 2)]);
            keep_better(&mut best[i], place::by_start(self.base(), &self.pyramids[i], &start, 0));
        }
    }

    /// A frame too dark or too bright to say anything is unmoved where all the others are: it stood on the same tripod.
    fn keep_company(&self, verdicts: &mut [Verdict], best: &[Option<Candidate>], found: &[Found]) {
        let others = self.others();
        let still = others.iter().filter(|&&i| verdicts[i].status == Status::Unmoved).count();
        let moved = others.iter().any(|&i| verdicts[i].status == Status::Aligned);
        if still == 0 || moved {
            return;
        }
        for i in others {
            if verdicts[i].status == Status::Rejected {
                let here = place::judge(self.base(), &self.pyramids[i], Warp::Identity, 0.0);
                let says_otherwise = here.agreement.contradict > here.agreement.confirm
                    || best[i].as_ref().is_some_and(|c| c.agreement.confirm > here.agreement.confirm + 3);
                if !says_otherwise {
                    verdicts[i] = placed(Model::Unmoved, &here, &found[i]);
                    verdicts[i].confidence = verdicts[i].confidence.max(BY_COMPANY);
                }
            }
        }
    }
}

/// Fewest matches that make a motion: a homography needs four, chance may add as many.
const LEAST_INLIERS: usize = 10;

fn keep_better(best: &mut Option<Candidate>, other: Option<Candidate>) {
    if let Some(other) = other
        && best.as_ref().is_none_or(|b| other.confidence() > b.confidence() + 0.005)
    {
        *best = Some(other);
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

fn placed(model: Model, candidate: &Candidate, found: &Found) -> Verdict {
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

fn rejected(reason: String, confidence: f64, found: &Found) -> Verdict {
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

#[cfg(test)]
mod tests;
