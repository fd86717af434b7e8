//! Areas: the part of the picture that each cell of the local field stands for.
//!
//! In: the positions of a grid, which of them have a cell, and which of them the frame shows. Out: for each cell, the
//! number of positions that are nearer to it than to any other cell, and not too far from it. Cost: a search of the
//! surroundings of each position. Source: Voronoi's diagram (Aurenhammer, ACM Computing Surveys 23(3), 1991).
//!
//! A cell exists only where the picture has detail, and where neither frame is clipped. Without the areas, a region of
//! rich detail would count for more than a larger region with little detail.

/// A cell stands for positions up to this distance, as a share of the longer side of the grid. The displacement of a
/// position that is farther from all cells is not known: such positions count for no cell. Measured on rendered
/// brackets.
const FARTHEST: f64 = 0.1;

/// Returns for each position of a grid the number of `shown` positions that are nearer to it than to any other position
/// with a cell. It is 0 for positions without a cell. Of several nearest positions, the one with the lowest index
/// counts. The grid is given row by row, with `columns` columns.
pub(super) fn areas(has_cell: &[bool], columns: usize, shown: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut areas = vec![0; has_cell.len()];
    for position in (0..has_cell.len()).filter(|&i| shown(i)) {
        if let Some(nearest) = nearest(has_cell, columns, position) {
            areas[nearest] += 1;
        }
    }
    areas
}

/// Returns the nearest position with a cell, if it is not farther than [`FARTHEST`]. Searches squares around
/// `position`, from the smallest, until no position outside of the square can be nearer.
fn nearest(has_cell: &[bool], columns: usize, position: usize) -> Option<usize> {
    let rows = has_cell.len() / columns;
    let (column, row) = (position % columns, position / columns);
    let mut best: Option<(usize, usize)> = None;
    let farthest = reach(columns, rows);
    for radius in 0..=farthest {
        if best.is_some_and(|(square, _)| square < radius * radius) {
            break;
        }
        for y in row.saturating_sub(radius)..(row + radius + 1).min(rows) {
            let dy = y.abs_diff(row);
            // In the rows within the square, only the first and the last column belong to its border.
            let step = if dy == radius { 1 } else { 2 * radius };
            for right in (0..=2 * radius).step_by(step) {
                let Some(x) = (column + right).checked_sub(radius).filter(|&x| x < columns) else { continue };
                let (dx, i) = (x.abs_diff(column), y * columns + x);
                if has_cell[i] {
                    best = Some(best.map_or((dx * dx + dy * dy, i), |best| best.min((dx * dx + dy * dy, i))));
                }
            }
        }
    }
    best.filter(|(square, _)| *square <= farthest * farthest).map(|(_, i)| i)
}

/// [`FARTHEST`] in positions of the grid.
fn reach(columns: usize, rows: usize) -> usize {
    (FARTHEST * columns.max(rows) as f64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::random;

    /// The textbook version: compares all distances.
    #[test]
    fn each_position_counts_for_the_nearest_cell() {
        let (columns, rows) = (43, 37);
        let farthest = reach(columns, rows).pow(2);
        for (seed, share) in [(1, 2), (2, 10), (3, 300)] {
            let draw = |i: usize, share: u64| random(seed, i as u64, 0).is_multiple_of(share);
            let has_cell: Vec<bool> = (0..columns * rows).map(|i| i == 200 || draw(i, share)).collect();
            let shown = |i: usize| i % columns > 3;
            let mut expected = vec![0; has_cell.len()];
            for i in (0..columns * rows).filter(|&i| shown(i)) {
                let square = |n: usize| {
                    let (dx, dy) = ((n % columns).abs_diff(i % columns), (n / columns).abs_diff(i / columns));
                    dx * dx + dy * dy
                };
                let nearest = (0..columns * rows).filter(|&n| has_cell[n]).min_by_key(|&n| (square(n), n)).unwrap();
                expected[nearest] += usize::from(square(nearest) <= farthest);
            }
            assert_eq!(areas(&has_cell, columns, shown), expected, "{seed}");
        }
    }

    #[test]
    fn without_cells_there_are_no_areas() {
        assert_eq!(areas(&[false; 12], 4, |_| true), vec![0; 12]);
    }
}
