//! Thresholds of the ladder: when a method suffices, which candidate wins, and what is accepted.
//!
//! In: nothing. Out: constants, each with its unit and provenance. "Chosen" means on rendered brackets with known
//! transforms, without a derivation. The tables in the tests of `selection` hold what follows from them.

// When bitmaps suffice.

/// Fewest agreeing tiles of a settled candidate. Chosen.
pub(super) const SETTLED_AGREEING: usize = 12;
/// Of so many decided tiles of a settled candidate at most one disagrees. Chosen.
pub(super) const SETTLED_DECIDED_PER_DISAGREEING: usize = 40;
/// Largest error estimate of a settled candidate, in pixels of the full size: half a pixel still shows no double edge.
pub(super) const SETTLED_ERROR_PX: f64 = 0.5;

// What is accepted.

/// Least confidence of an accepted candidate, 0..=1, unless nearly all tiles agree with it. A wrong transform between
/// rendered scenes stays below it (`another_scene_never_settles`).
pub(super) const ACCEPTED_CONFIDENCE: f64 = 0.35;
/// Fewest agreeing tiles of a candidate that nearly all tiles agree with. A frame of which little is neither black nor
/// clipped is often the one that matters.
pub(super) const UNOPPOSED_AGREEING: usize = 3;
/// Of so many agreeing tiles at most one disagrees there. Chosen.
pub(super) const UNOPPOSED_AGREEING_PER_DISAGREEING: usize = 8;
/// Least reliability of an accepted candidate, 0..=1, whatever the number of its tiles. Chosen.
pub(super) const ACCEPTED_RELIABILITY: f64 = 0.25;
/// Fewest decided tiles with which a rejection is explained by their disagreement rather than by their number. Chosen.
pub(super) const EXPLAINING_TILES: usize = 8;
/// Error estimate at which a transform is half as good, in pixels for pictures up to 2000 pixels across. Chosen.
pub(super) const TOLERANCE_PX: f64 = 1.5;
/// The median offset of tiles under the true transform, in pixels of their level. Measured on rendered brackets.
pub(super) const TILE_NOISE_PX: f64 = 0.05;

// Which of several wins.

/// A candidate found later wins with so many times the evidence of an earlier, more direct one ...
pub(super) const LATER_EVIDENCE_FACTOR: f64 = 1.01;
/// ... and half a tile more, so that rounding of equal evidence does not decide.
pub(super) const LATER_EVIDENCE_TILES: f64 = 0.5;
/// Evidence, as a share of the best candidate's, from which a candidate is comparable with it. Chosen.
pub(super) const COMPARABLE_EVIDENCE: f64 = 0.4;
/// Evidence for one candidate over another from which the choice is decided, in nats: odds of 7 to 1.
pub(crate) const DECISIVE_NATS: f64 = 2.0;

// Features.

/// Fewest matches that make a motion: a homography needs four, chance may add as many. Chosen.
pub(super) const LEAST_INLIERS: usize = 10;
/// Bitmaps and features corroborate each other if their transforms differ by no more than this, in pixels of the full
/// size for each 1000 of the diagonal. Chosen.
pub(super) const CORROBORATED_PX: f64 = 2.0;
/// Transforms up to this many times as far apart are the same, known less well; others are alternatives. Chosen.
pub(super) const SAME_APART: f64 = 3.0;
/// Confidence of a candidate on which bitmaps and features agree, 0..=1, where few tiles are decided. Chosen.
pub(super) const CORROBORATED_CONFIDENCE: f64 = 0.7;

// Frames that are inferred from others.

/// Confidence in a transform that is inferred from other frames without error, 0..=1; it falls with the expected error.
/// Above [`INFERRING_CONFIDENCE`], so that such a frame is not doubtful, and below what tiles give. Chosen.
pub(crate) const INFERRED_CONFIDENCE: f64 = 0.6;
/// Least confidence of a frame from which others are inferred, 0..=1: more likely right than wrong.
pub(super) const INFERRING_CONFIDENCE: f64 = 0.5;
