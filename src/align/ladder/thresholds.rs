//! Thresholds of the ladder: when a method suffices, which candidate wins, and which candidates are accepted.
//!
//! In: nothing. Out: constants, each with its unit and provenance. Those chosen on rendered brackets, whose transforms
//! are known, have no derivation. The tables in the tests of `selection` show their effect.

// When bitmaps suffice.

/// A candidate is settled only if at least this many tiles agree. Chosen on rendered brackets.
pub(super) const SETTLED_AGREEING: usize = 12;
/// A candidate is settled only if it has at least this many decided tiles for each disagreeing tile. Chosen on rendered
/// brackets.
pub(super) const SETTLED_DECIDED_PER_DISAGREEING: usize = 40;
/// Largest error estimate of a settled candidate, in pixels of the full size: half a pixel still shows no double edge.
pub(super) const SETTLED_ERROR_PX: f64 = 0.5;

// What is accepted.

/// Smallest confidence, 0..=1, of an accepted candidate, unless nearly all tiles agree with it. Wrong transforms
/// between different rendered scenes stay below it (test `another_scene_never_settles`).
pub(super) const ACCEPTED_CONFIDENCE: f64 = 0.35;
/// A candidate with less confidence is accepted too if nearly all decided tiles agree, and at least this many. The
/// number is small, because frames that are mostly black or clipped have few decided tiles but are often the important
/// ones.
pub(super) const UNOPPOSED_AGREEING: usize = 3;
/// Nearly all decided tiles agree if at least this many agree for each one that disagrees. Chosen on rendered brackets.
pub(super) const UNOPPOSED_AGREEING_PER_DISAGREEING: usize = 8;
/// A candidate with less than [`ACCEPTED_CONFIDENCE`] must have at least this reliability to be accepted, 0..=1. Chosen
/// on rendered brackets.
pub(super) const ACCEPTED_RELIABILITY: f64 = 0.25;
/// If at least this many tiles are decided, a rejection is explained by their disagreement, otherwise by their small
/// number. Chosen on rendered brackets.
pub(super) const EXPLAINING_TILES: usize = 8;
/// Error estimate that halves the confidence of a candidate, in pixels, for pictures with a diagonal of up to 2000
/// pixels. Chosen on rendered brackets.
pub(super) const TOLERANCE_PX: f64 = 1.5;
/// The median offset of tiles under the true transform, in pixels of their level. Measured on rendered brackets.
pub(super) const TILE_NOISE_PX: f64 = 0.05;

// Which candidate wins.

/// A candidate found later wins if its evidence is greater than this multiple of that of an earlier, more direct one
/// ...
pub(super) const LATER_EVIDENCE_FACTOR: f64 = 1.01;
/// ... plus this number of tiles, so that rounding of equal evidence does not decide.
pub(super) const LATER_EVIDENCE_TILES: f64 = 0.5;
/// A candidate is comparable with the best one if it has at least this share of the best one's evidence. Chosen on
/// rendered brackets.
pub(super) const COMPARABLE_EVIDENCE: f64 = 0.4;
/// Evidence for one candidate over another, in nats, above which it is decisively better: odds of 7 to 1.
pub(crate) const DECISIVE_NATS: f64 = 2.0;

// Features.

/// Fewest inliers of an accepted homography. Four points always fit, four more may fit by chance, and two are a margin.
/// Chosen on rendered brackets.
pub(super) const LEAST_INLIERS: usize = 10;
/// Bitmaps and features corroborate each other if their transforms differ by no more than this, in pixels of the full
/// size for each 1000 of the diagonal. Chosen on rendered brackets.
pub(super) const CORROBORATED_PX: f64 = 2.0;
/// Transforms within this multiple of [`CORROBORATED_PX`] are estimates of the same transform; others are alternatives.
/// Chosen on rendered brackets.
pub(super) const SAME_APART: f64 = 3.0;
/// If bitmaps and features agree on a candidate, its support by tiles is raised to at least this, 0..=1: few tiles may
/// be decided. Chosen on rendered brackets.
pub(super) const CORROBORATED_CONFIDENCE: f64 = 0.7;

// Frames that are inferred from others.

/// Confidence, 0..=1, of a transform that is inferred from other frames, if its expected error is 0; with a larger
/// error the confidence is lower. Above [`INFERRING_CONFIDENCE`], so that such a frame is not uncertain, and below the
/// confidence of agreeing tiles. Chosen on rendered brackets.
pub(crate) const INFERRED_CONFIDENCE: f64 = 0.6;
/// Least confidence of a frame from which the transforms of others are inferred, 0..=1: more likely right than wrong.
pub(super) const INFERRING_CONFIDENCE: f64 = 0.5;

// The local check.

/// Displaced share of the picture that halves the confidence. If 3 % of the picture are displaced, the confidence
/// should be below one half. The value is smaller than 3 %, because the share is underestimated at edges of depth.
/// Measured on rendered scenes.
pub(super) const DISPLACED_HALVES: f64 = 0.025;
