//! A candidate: a transform that was found for a frame, and how far it can be trusted.
//!
//! In: a pair of frames and a transform. Out: a [`Candidate`]: agreement, error estimate, confidence. Cost: that of [`survey`].

use crate::align::agreement;
use crate::align::agreement::{Agreement, Survey, TileFit, survey};
use crate::align::grey::measured_level;
use crate::align::refinement::Comparison;
use crate::align::transform::{Warp, level_to_full, on_level};
use std::sync::Arc;

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

/// What bitmaps and features that agree are worth where tiles say little.
const TWO_WITNESSES: f64 = 0.7;

/// The tiles' opinion of `warp`.
pub(crate) fn judge(pair: &Comparison, warp: Warp, noise_px: f64) -> Candidate {
    judged(pair, warp, noise_px).0
}

/// The tiles' opinion of `warp`, and where they would have it.
pub(super) fn judged(pair: &Comparison, warp: Warp, noise_px: f64) -> (Candidate, Option<TileFit>) {
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
