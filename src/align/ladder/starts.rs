//! Candidates made from starting transforms: the result of the bitmap search, its other minima, or a given transform.
//! Each starting transform is refined, and the result is checked by tiles.
//!
//! In: the grey pyramids of the reference and a frame, and transforms to start from. Out: [`Candidate`]s. Cost: for
//! each starting transform, that of [`refine`] and of the check by tiles.

use crate::align::agreement::TileFit;
use crate::align::bitmaps;
use crate::align::bitmaps::MtbOptions;
use crate::align::grey::{GreyPyramid, finest_level, measured_level};
use crate::align::ladder::candidate::{Candidate, evaluate, evaluate_with_fit};
use crate::align::refinement::{FramePair, refine};
use crate::align::resampling::bilinear::BilinearRows;
use crate::align::transform::{Model, Transform, corners, level_to_full, map, off_level};
use crate::plane::Plane;

/// Refinement starts this many levels coarser than the level on which tiles are measured. With 2, an error of 4 px on
/// that level is 1 px on the starting level.
const CAPTURE_LEVELS: usize = 2;

/// The pyramid of `grey` after it was warped to the reference's grid by `transform`. Where `grey` has no pixel, its
/// border pixels are repeated.
pub(crate) fn warped_to_reference(grey: &Plane<u8>, transform: &Transform) -> GreyPyramid {
    let rows = BilinearRows::new(grey, transform);
    GreyPyramid::of_rows((grey.width(), grey.height()), |y, row| rows.row(y, row))
}

/// Aligns `frame` to `reference` by the bitmap search. Returns the refined candidate, and the pair of frames on which
/// it was refined.
pub(crate) fn by_bitmaps<'a>(
    reference: &'a GreyPyramid,
    frame: &'a GreyPyramid,
    options: &MtbOptions,
) -> (FramePair<'a>, Option<Candidate>) {
    let start = bitmaps::search(reference, frame, measured_level(reference), options).transform();
    let pair = FramePair::new(reference, frame, &start);
    let candidate = by_start(&pair, &start, CAPTURE_LEVELS);
    (pair, candidate)
}

/// Candidates from the other minima of the bitmap search. The list begins with the best few, fully refined; then all
/// follow, refined only down to the level on which tiles are measured.
pub(crate) fn by_alternatives(pair: &FramePair, angle: f64, options: &MtbOptions) -> Vec<Candidate> {
    let measured = measured_level(pair.reference());
    let mut rough: Vec<Candidate> =
        bitmaps::alternatives(pair.reference(), pair.frame(), angle, MOST_ALTERNATIVES, options)
            .into_iter()
            .filter_map(|m| {
                let start = Transform::Rigid { dx: m.dx, dy: m.dy, angle: m.angle };
                let found = refine(pair, &start, Model::Rigid, (measured + CAPTURE_LEVELS, measured))?;
                Some(evaluate(pair, found.transform, found.error_px))
            })
            .collect();
    rough.sort_by(|a, b| b.evidence().total_cmp(&a.evidence()));
    let refined: Vec<Candidate> =
        rough.iter().take(REFINED_ALTERNATIVES).filter_map(|c| by_start(pair, &c.transform, 0)).collect();
    refined.into_iter().chain(rough).collect()
}

/// Largest number of alternatives that are evaluated.
const MOST_ALTERNATIVES: usize = 8;
/// Largest number of alternatives that are fully refined.
const REFINED_ALTERNATIVES: usize = 2;

/// Refines `start` as a homography and checks the result by tiles. If the tiles measure a displacement, the transform
/// is corrected by it. Refinement starts `capture` levels coarser than the level on which tiles are measured.
pub(crate) fn by_start(pair: &FramePair, start: &Transform, capture: usize) -> Option<Candidate> {
    let levels = (measured_level(pair.reference()) + capture, finest_level(pair.reference()));
    // If the refinement of a model fails or diverges, the model with the next fewer parameters is used.
    let found = [Model::Homography, Model::Rigid, Model::Shift].into_iter().find_map(|model| {
        let found = refine(pair, start, model, levels)?;
        is_sane(&found.transform, pair.size()).then_some(found)
    })?;
    let (candidate, fit) = evaluate_with_fit(pair, found.transform, found.error_px);
    Some(by_tiles(pair, &candidate, fit).unwrap_or(candidate))
}

/// Corrects the transform of `from` by `fit`, the transform fitted to the displacements of its tiles. Returns none
/// unless the correction is significant and the tiles match better after it.
fn by_tiles(pair: &FramePair, from: &Candidate, mut fit: Option<TileFit>) -> Option<Candidate> {
    let level = measured_level(pair.reference());
    let mut best = None;
    for _ in 0..TILE_STEPS {
        let Some(tiles) = fit.filter(|f| f.significance > LEAST_SIGNIFICANCE && f.moved > LEAST_TILE_MOVE) else {
            break;
        };
        let transform = Transform::Homography(off_level(&tiles.h, level));
        if !is_sane(&transform, pair.size()) {
            break;
        }
        let (next, next_fit) = evaluate_with_fit(pair, transform, level_to_full(level)[(0, 0)] * tiles.error);
        let before = best.as_ref().unwrap_or(from);
        // Each step must reduce the displacement of the tiles without reducing their correlation.
        let nearer = next_fit.as_ref().is_some_and(|next| next.moved < tiles.moved);
        if !nearer || next.tiles.evidence_over(&before.tiles) < 0.0 {
            break;
        }
        fit = next_fit;
        best = Some(Candidate { by_tiles: true, ..next });
    }
    best
}

/// Largest number of successive corrections by tiles.
const TILE_STEPS: usize = 5;
/// A correction is made only if the displacement of the tiles exceeds this multiple of its error
/// ([`TileFit::significance`]).
const LEAST_SIGNIFICANCE: f64 = 2.0;
/// A correction is made only if the displacement of the tiles exceeds this, in pixels of their level.
const LEAST_TILE_MOVE: f64 = 0.05;

/// Whether a hand-held camera can cause this transform: every corner moves by less than a third of the diagonal, and
/// every side keeps between half and twice its length.
pub(super) fn is_sane(transform: &Transform, (width, height): (usize, usize)) -> bool {
    let diagonal = ((width * width + height * height) as f64).sqrt();
    let h = transform.matrix(width, height);
    let before = corners(width, height);
    let after = before.map(|(x, y)| map(&h, x, y));
    let side = |c: &[(f64, f64); 4], i: usize| {
        let (a, b) = (c[i], c[(i + 1) % 4]);
        ((a.0 - b.0) * (a.0 - b.0) + (a.1 - b.1) * (a.1 - b.1)).sqrt()
    };
    transform.corner_distance(&Transform::Identity, width, height) < diagonal / 3.0
        && (0..4).all(|i| (0.5..2.0).contains(&(side(&after, i) / side(&before, i).max(1.0))))
}
