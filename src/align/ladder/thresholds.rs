//! Thresholds of the ladder (the order of the alignment methods): when a method suffices, which candidate is selected,
//! and which candidates are accepted.
//!
//! In: nothing. Out: constants, each with its unit and provenance. "Chosen on rendered brackets" means that a value has
//! no derivation, but gave good results on rendered brackets, whose true transforms are known. A table in the tests of
//! `selection` shows the effect of the values.

// When a candidate is settled, that is, when no other method is tried.

/// A candidate is settled (good enough without other methods) only if at least this many tiles agree with it. Chosen on
/// rendered brackets.
pub(super) const SETTLED_AGREEING: usize = 12;
/// A candidate is settled only if at most one tile in this many disagrees with it. Undecided tiles do not count. Chosen
/// on rendered brackets.
pub(super) const SETTLED_DECIDED_PER_DISAGREEING: usize = 40;
/// A candidate is settled only if its error estimate is less than this, in pixels of the full size. A misalignment of
/// half a pixel shows no double edge.
pub(super) const SETTLED_ERROR_PX: f64 = 0.5;

// Which candidates are accepted.

/// A candidate is accepted if its confidence is at least this, 0..=1. The best transform between two different rendered
/// scenes has less (test `another_scene_never_settles`).
pub(super) const ACCEPTED_CONFIDENCE: f64 = 0.35;
/// A candidate with less confidence than [`ACCEPTED_CONFIDENCE`] is accepted only if at least this many tiles agree,
/// and nearly none disagrees. The number is small, because a frame that is mostly black or clipped has few tiles with
/// contrast, but is often an important one.
pub(super) const UNOPPOSED_AGREEING: usize = 3;
/// "Nearly none disagrees" means that at least this many tiles agree for each tile that disagrees. Chosen on rendered
/// brackets.
pub(super) const UNOPPOSED_AGREEING_PER_DISAGREEING: usize = 8;
/// A candidate with less confidence than [`ACCEPTED_CONFIDENCE`] is accepted only if its reliability is at least this,
/// 0..=1. Chosen on rendered brackets.
pub(super) const ACCEPTED_RELIABILITY: f64 = 0.25;
/// If a rejected frame has a candidate, and does not match at several positions, the message says how many tiles
/// disagree, if at least this many tiles agree or disagree. Otherwise it says that too few parts of the frame can be
/// compared. Chosen on rendered brackets.
pub(super) const EXPLAINING_TILES: usize = 8;
/// Error estimate that halves the confidence of a candidate, in pixels, for pictures with a diagonal of up to 2000
/// pixels. If the eight coefficients of the error of a homography are random and equally large (with half the width as
/// the unit of length), the error exceeds 1.7 times its root mean square in 3 % of the picture (median of 2000 draws).
/// So at this value, 3 % are off by 2 px.
pub(super) const TOLERANCE_PX: f64 = 1.2;
/// The error estimate that halves the confidence once more, after the local check, as a multiple of the tolerance.
/// Together, the two halve it at half the tolerance. This is because in 1 of 20 frames of rendered brackets, the error
/// estimate is less than half of the actual error.
pub(super) const UNCERTAIN: f64 = 2.0 / 3.0;
/// The median displacement of tiles under the true transform, due to noise, in pixels of the level on which tiles are
/// measured. Measured on rendered brackets.
pub(super) const TILE_NOISE_PX: f64 = 0.05;

// Which candidate is selected.

/// Candidates found first come from more direct methods. A later candidate is better than an earlier one only if its
/// evidence is greater than the earlier one's times this factor, plus [`LATER_EVIDENCE_TILES`]. Chosen on rendered
/// brackets.
pub(super) const LATER_EVIDENCE_FACTOR: f64 = 1.01;
/// See [`LATER_EVIDENCE_FACTOR`]; in tiles. Without this margin, rounding errors would decide between candidates with
/// equal evidence.
pub(super) const LATER_EVIDENCE_TILES: f64 = 0.5;
/// A candidate is compared directly with the best one if its evidence is at least this multiple of the best one's.
/// Chosen on rendered brackets.
pub(super) const COMPARABLE_EVIDENCE: f64 = 0.4;
/// One candidate is decisively better than another if the evidence for it over the other exceeds this, in nats: a
/// likelihood ratio of e^2, about 7 to 1.
pub(crate) const DECISIVE_NATS: f64 = 2.0;

// Features.

/// If features are the only method, a homography is accepted only if it has at least this many inliers: four matches
/// always fit, four more may fit by chance, and two are a margin. If there are other methods, features corroborate a
/// candidate only with at least twice as many inliers. Chosen on rendered brackets.
pub(super) const LEAST_INLIERS: usize = 10;
/// Features corroborate the best candidate only if their two transforms differ by no more than this, in pixels of the
/// full size per 1000 pixels of the diagonal. Chosen on rendered brackets.
pub(super) const CORROBORATED_PX: f64 = 2.0;
/// Two candidates count as the same if their transforms differ by no more than this multiple of [`CORROBORATED_PX`];
/// otherwise they are alternatives. Chosen on rendered brackets.
pub(super) const SAME_APART: f64 = 3.0;
/// If features corroborate a candidate, the part of its confidence that comes from the tiles is raised to at least
/// this, 0..=1, because few tiles may have contrast. Chosen on rendered brackets.
pub(super) const CORROBORATED_CONFIDENCE: f64 = 0.7;

// Frames that are inferred from others.

/// Confidence, 0..=1, of a transform that is inferred from other frames, if its expected error is 0; with a larger
/// error the confidence is lower. The value is above 0.5, so that such a frame does not count as uncertain, and below
/// the confidence that agreeing tiles give. Chosen on rendered brackets.
pub(crate) const INFERRED_CONFIDENCE: f64 = 0.6;
/// Transforms are inferred only from frames with at least this confidence, 0..=1: their transform is more likely right
/// than wrong.
pub(super) const INFERRING_CONFIDENCE: f64 = 0.5;
