//! The strongest keypoints of every part of an image, and the order of keypoints.
//!
//! In: keypoints. Out: at most a given number of them, spread over the image; or all of them, sorted by position. Cost:
//! a sort.

use crate::align::features::Keypoint;

/// Number of cells along the long side of the image.
const CELLS: usize = 12;

/// Returns at most `most` of the items `all`. The strongest items of every cell of the image are kept, so that the
/// whole image is covered.
///
/// If some cells have few keypoints, the other cells keep more. `points[i]` is the keypoint that belongs to `all[i]`.
pub(super) fn strongest<T>(all: Vec<T>, points: &[Keypoint], (width, height): (usize, usize), most: usize) -> Vec<T> {
    if all.len() <= most {
        return all;
    }
    let cell = (width.max(height) as f32 / CELLS as f32).max(1.0);
    let columns = (width as f32 / cell) as usize + 1;
    let rows = (height as f32 / cell) as usize + 1;
    let mut cells: Vec<Vec<(f32, usize)>> = vec![Vec::new(); columns * rows];
    for (i, k) in points.iter().enumerate() {
        let at = ((k.y.max(0.0) / cell) as usize).min(rows - 1) * columns
            + ((k.x.max(0.0) / cell) as usize).min(columns - 1);
        cells[at].push((k.response, i));
    }
    // First the strongest of every cell, then the second strongest of every cell, and so on.
    let mut order: Vec<(usize, f32, usize)> = Vec::with_capacity(points.len());
    for cell in &mut cells {
        cell.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.extend(cell.iter().enumerate().map(|(rank, &(response, i))| (rank, response, i)));
    }
    order.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)).then(a.2.cmp(&b.2)));
    let mut keep = vec![false; all.len()];
    for &(_, _, i) in &order[..most] {
        keep[i] = true;
    }
    all.into_iter().zip(keep).filter_map(|(item, keep)| keep.then_some(item)).collect()
}

/// Sorts keypoints, with their descriptors, by position, so that their order does not depend on threads.
pub(super) fn by_position<D>(mut all: Vec<(Keypoint, D)>) -> Vec<(Keypoint, D)> {
    all.sort_by(|(a, _), (b, _)| {
        a.y.total_cmp(&b.y)
            .then(a.x.total_cmp(&b.x))
            .then(a.scale.total_cmp(&b.scale))
            .then(a.angle.total_cmp(&b.angle))
    });
    all
}
