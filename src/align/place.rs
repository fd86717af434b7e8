//! Placing one frame: from the bitmaps, from features, from a neighbour; judged by the pixels; reduced to the smallest model that does.
//!
//! In: the grey pyramids of the reference and a frame, and warps to start from. Out: a [`Candidate`] with its agreement, or none; then
//! the smallest [`Model`] that explains it as well. Cost: that of [`refine`] and [`survey`] for each start.

use crate::align::agreement;
use crate::align::agreement::{Agreement, Survey, TileFit, survey};
use crate::align::bitmaps;
use crate::align::bitmaps::MtbOptions;
use crate::align::grey::{GreyPyramid, finest_level, measured_level};
use crate::align::refinement::{Comparison, refine};
use crate::align::resampling::bilinear::Laid;
use crate::align::transform::{Model, Warp, corners, distance, level_to_full, map, off_level, on_level, restrict};
use crate::plane::Plane;
use std::sync::Arc;

/// Levels above that of agreement from which refinement starts: a warp that is off by 4 px is off by one there.
const CAPTURE_LEVELS: usize = 2;
/// Warps that do the same to the picture within this are the same, in pixels (root mean square over the picture).
const SAME_PX: f64 = 0.03;
/// A smaller model that is so many times farther off, before it is fitted, will not do.
const HOPELESS: f64 = 5.0;
/// A frame whose warp is no more than this is unmoved: resampling would cost more than it mends, in pixels.
pub(crate) const UNMOVED_PX: f64 = 0.2;

/// A warp that was found for a frame, and what speaks for it.
#[derive(Debug, Clone)]
pub(crate) struct Candidate {
    /// Reference pixel -> frame pixel.
    pub(crate) warp: Warp,
    /// The tiles' opinion, all together and each by itself.
    pub(crate) survey: Arc<Survey>,
    /// What noise leaves, and what the tiles see, in pixels of the full size.
    pub(crate) error_px: f64,
    /// Of that, what the tiles see.
    pub(crate) seen_px: f64,
    /// Whether it is where the tiles would have it, rather than the pixels.
    pub(crate) by_tiles: bool,
    /// How far what it was held against can itself be trusted, 0..=1.
    pub(crate) trust: f64,
    /// An error at which the warp is half as good, in pixels: [`TOLERANCE_PX`] for a picture of up to 2000 pixels across, more for a larger.
    pub(crate) tolerance_px: f64,
    /// Whether features, by themselves, led to the same place.
    pub(crate) corroborated: bool,
}

impl Candidate {
    /// The tiles' opinion, all together.
    pub(crate) fn agreement(&self) -> &Agreement {
        &self.survey.agreement
    }

    /// 0..=1: how much the tiles speak for it, less where they see it off by half a pixel or more.
    pub(crate) fn confidence(&self) -> f64 {
        let off = self.error_px / self.tolerance_px;
        let tiles = self.agreement().share() * self.agreement().coverage();
        let word = if self.corroborated { tiles.max(TWO_WITNESSES) } else { tiles };
        self.trust * word / (1.0 + off * off)
    }

    /// How much speaks for it against others: the tiles that do, less those that speak against it.
    pub(crate) fn evidence(&self) -> f64 {
        let off = self.error_px / self.tolerance_px;
        let tiles = self.agreement().confirm as f64 - self.agreement().contradict as f64;
        self.trust * tiles / (1.0 + off * off)
    }

    /// Whether nothing more need be tried: nearly all tiles confirm, many of them, and none of them is off.
    pub(crate) fn is_settled(&self) -> bool {
        let spoke = self.agreement().confirm + self.agreement().contradict;
        self.agreement().confirm >= 12 && self.agreement().contradict * 40 <= spoke && self.error_px < 0.5
    }
}

/// The frame whose grey picture is `grey` on the reference's grid, that lies in it by `warp`; its border goes on where it does not reach.
pub(crate) fn laid_on_reference(grey: &Plane<u8>, warp: &Warp) -> GreyPyramid {
    let laid = Laid::new(grey, warp);
    GreyPyramid::of_rows((grey.width(), grey.height()), |y, row| laid.row(y, row))
}

/// What bitmaps and features that agree are worth where tiles say little.
const TWO_WITNESSES: f64 = 0.7;

/// What the bitmaps lead to, and the comparison that it was had from.
pub(crate) fn by_bitmaps<'a>(
    reference: &'a GreyPyramid,
    frame: &'a GreyPyramid,
    options: &MtbOptions,
) -> (Comparison<'a>, Option<Candidate>) {
    let start = bitmaps::search(reference, frame, measured_level(reference), options).warp();
    let pair = Comparison::new(reference, frame, &start);
    let candidate = by_start(&pair, &start, CAPTURE_LEVELS);
    (pair, candidate)
}

/// What the bitmaps' other minima lead to: the best few refined to the end, then the others as far as they were followed.
pub(crate) fn by_rivals(pair: &Comparison, angle: f64, options: &MtbOptions) -> Vec<Candidate> {
    let measured = measured_level(pair.reference());
    let mut rough: Vec<Candidate> = bitmaps::rivals(pair.reference(), pair.frame(), angle, MOST_RIVALS, options)
        .into_iter()
        .filter_map(|m| {
            let start = Warp::Rigid { dx: m.dx, dy: m.dy, angle: m.angle };
            let found = refine(pair, &start, Model::Rigid, (measured + CAPTURE_LEVELS, measured))?;
            Some(judge(pair, found.warp, 0.0))
        })
        .collect();
    rough.sort_by(|a, b| b.evidence().total_cmp(&a.evidence()));
    let refined: Vec<Candidate> = rough.iter().take(BEST_RIVALS).filter_map(|c| by_start(pair, &c.warp, 0)).collect();
    refined.into_iter().chain(rough).collect()
}

/// Rivals that are looked at.
const MOST_RIVALS: usize = 8;
/// ... and of these refined to the end.
const BEST_RIVALS: usize = 2;

/// Refines `start` as a homography, from `capture` levels above that of agreement, and asks the tiles; follows them where they see it off.
pub(crate) fn by_start(pair: &Comparison, start: &Warp, capture: usize) -> Option<Candidate> {
    let levels = (measured_level(pair.reference()) + capture, finest_level(pair.reference()));
    // What is little determined at first may be well determined after the first step; a smaller model holds where a larger runs away.
    let found = [Model::Homography, Model::Rigid, Model::Shift].into_iter().find_map(|model| {
        let found = refine(pair, start, model, levels)?;
        is_sane(&found.warp, pair.size()).then_some(found)
    })?;
    let (candidate, fit) = judged(pair, found.warp, found.error_px);
    Some(by_tiles(pair, &candidate, fit).unwrap_or(candidate))
}

/// Where the tiles take `from`, if they see it off by more than they can err, and agree better there.
fn by_tiles(pair: &Comparison, from: &Candidate, mut fit: Option<TileFit>) -> Option<Candidate> {
    let level = measured_level(pair.reference());
    let mut best = None;
    for _ in 0..TILE_STEPS {
        let Some(seen) = fit.filter(|f| f.surprise > SURE && f.moved > TILES_SEE) else { break };
        let warp = Warp::Homography(off_level(&seen.h, level));
        if !is_sane(&warp, pair.size()) {
            break;
        }
        let (next, next_fit) = judged(pair, warp, level_to_full(level)[(0, 0)] * seen.error);
        let before = best.as_ref().unwrap_or(from);
        // Further on than before, by the tiles' own account and by that of their correlations.
        let nearer = next_fit.as_ref().is_some_and(|next| next.moved < seen.moved);
        if !nearer || next.survey.against(&before.survey) < 0.0 {
            break;
        }
        fit = next_fit;
        best = Some(Candidate { by_tiles: true, ..next });
    }
    best
}

/// Steps that the tiles may take.
const TILE_STEPS: usize = 5;
/// They are followed where they see a warp off by so many times what they can err ([`TileFit::surprise`]),
const SURE: f64 = 2.0;
/// ... and by more than this, in pixels of their level.
const TILES_SEE: f64 = 0.05;

/// The tiles' opinion of `warp`.
pub(crate) fn judge(pair: &Comparison, warp: Warp, noise_px: f64) -> Candidate {
    judged(pair, warp, noise_px).0
}

/// The tiles' opinion of `warp`, and where they would have it.
fn judged(pair: &Comparison, warp: Warp, noise_px: f64) -> (Candidate, Option<TileFit>) {
    let level = measured_level(pair.reference());
    let (width, height) = pair.size();
    let h = on_level(&warp.matrix(width, height), level);
    let both = &pair.level(level).both;
    let survey = survey(both, &h);
    let fit = agreement::fit(&survey, &h, (both.reference.width(), both.reference.height()));
    let tolerance_px = tolerance_px((width, height));
    // What is beyond the tiles' own error is the warp's.
    let seen = match &fit {
        Some(fit) => (fit.moved * fit.moved - fit.error * fit.error).max(0.0).sqrt(),
        None => (survey.agreement.offset - TILE_NOISE).max(0.0),
    };
    let seen_px = level_to_full(level)[(0, 0)] * seen;
    let error_px = (noise_px * noise_px + seen_px * seen_px).sqrt();
    let candidate = Candidate {
        warp,
        survey: Arc::new(survey),
        error_px,
        seen_px,
        trust: 1.0,
        tolerance_px,
        corroborated: false,
        by_tiles: false,
    };
    (candidate, fit)
}

/// See [`Candidate::tolerance_px`].
const TOLERANCE_PX: f64 = 1.5;

/// [`Candidate::tolerance_px`] of pictures of this size.
pub(crate) fn tolerance_px((width, height): (usize, usize)) -> f64 {
    let diagonal = ((width * width + height * height) as f64).sqrt();
    TOLERANCE_PX * (diagonal / 2000.0).max(1.0)
}

/// The median offset of tiles under the true warp, in pixels of the level. Measured on rendered brackets.
const TILE_NOISE: f64 = 0.05;

/// Whether a camera held in hands could have done this: no corner farther than a third of the diagonal, no side half or twice as long.
fn is_sane(warp: &Warp, (width, height): (usize, usize)) -> bool {
    let diagonal = ((width * width + height * height) as f64).sqrt();
    let h = warp.matrix(width, height);
    let before = corners(width, height);
    let after = before.map(|(x, y)| map(&h, x, y));
    let side = |c: &[(f64, f64); 4], i: usize| {
        let (a, b) = (c[i], c[(i + 1) % 4]);
        ((a.0 - b.0) * (a.0 - b.0) + (a.1 - b.1) * (a.1 - b.1)).sqrt()
    };
    warp.corner_distance(&Warp::Identity, width, height) < diagonal / 3.0
        && (0..4).all(|i| (0.5..2.0).contains(&(side(&after, i) / side(&before, i).max(1.0))))
}

/// The smallest model that explains the motion as well as `whole` does, within what the pixels can tell.
pub(crate) fn reduce(pair: &Comparison, whole: Candidate) -> Candidate {
    let (width, height) = pair.size();
    let level = measured_level(pair.reference());
    // Tiles cannot tell apart what lies nearer than this.
    let alike_px = ALIKE * level_to_full(level)[(0, 0)];
    let opinion = |warp: Warp, noise_px: f64, apart: f64| {
        if apart > alike_px {
            return Candidate { corroborated: whole.corroborated, ..judge(pair, warp, noise_px) };
        }
        let error_px = (noise_px * noise_px + whole.seen_px * whole.seen_px).sqrt();
        Candidate { warp, error_px, ..whole.clone() }
    };
    let still = distance(&whole.warp, &Warp::Identity, width, height);
    if still <= UNMOVED_PX.max(whole.error_px) {
        let unmoved = opinion(Warp::Identity, 0.0, still);
        if unmoved.agreement().share() >= whole.agreement().share() - 0.02 {
            let error_px = unmoved.error_px.min(still.max(SAME_PX));
            return Candidate { error_px, ..unmoved };
        }
    }
    if whole.by_tiles {
        // The pixels would take it back to where the tiles do not want it.
        return whole;
    }
    let finest = finest_level(pair.reference());
    for model in [Model::Shift, Model::Rigid] {
        // The nearest by far is cheap to tell; the best is what counts.
        let near = Warp::Homography(restrict(&whole.warp.matrix(width, height), model, width, height));
        if distance(&whole.warp, &near, width, height) > HOPELESS * SAME_PX.max(whole.error_px) {
            continue;
        }
        let Some(smaller) = refine(pair, &whole.warp, model, (finest, finest)) else {
            continue;
        };
        let apart = distance(&whole.warp, &smaller.warp, width, height);
        if apart <= SAME_PX.max(whole.error_px) {
            // What the whole could not tell from this, this cannot either.
            let noise_px = smaller.error_px.max(0.5 * whole.error_px);
            let candidate = opinion(smaller.warp, noise_px, apart);
            if candidate.agreement().share() >= whole.agreement().share() - 0.02
                && candidate.agreement().offset <= whole.agreement().offset + 0.01
            {
                return candidate;
            }
        }
    }
    whole
}

/// What tiles can tell apart, in pixels of the level on which they are measured.
const ALIKE: f64 = 0.1;

#[cfg(test)]
mod tests;
