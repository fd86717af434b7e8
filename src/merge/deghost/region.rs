//! Regions: from the evidence of single cells to the removed parts of a frame.
//!
//! In: for each cell whether it differs or moved. Out: connected parts; masks without gaps; a weight that rises around
//! a mask. Cost: about 10 ns per cell.
//!
//! Connected parts that differ and moved are removed completely, for two reasons. The middle of a moving object may
//! look like its background. And a reduced weight is not enough: a tenth of a long exposure's weight may still be ten
//! times the weight of the reference.

use crate::plane::Plane;
use crate::pyramid::cells::{gathered, grown_by, near};

/// Returns the connected parts of `plane`, from top to bottom: the columns and rows of each.
pub fn parts(plane: &Plane<bool>) -> Vec<Vec<(usize, usize)>> {
    let mut left = plane.clone();
    let all = (0..plane.height()).flat_map(|y| (0..plane.width()).map(move |x| (x, y)));
    all.map(|at| taken(&mut left, at)).filter(|part| !part.is_empty()).collect()
}

/// Removes the connected part that contains `at` from `left` and returns it; it is empty if `at` is false in `left`.
/// Cells are connected by sides and corners.
fn taken(left: &mut Plane<bool>, at: (usize, usize)) -> Vec<(usize, usize)> {
    let (width, height) = (left.width(), left.height());
    let mut part = Vec::new();
    if std::mem::take(&mut left.row_mut(at.1)[at.0]) {
        part.push(at);
    }
    let mut next = 0;
    while let Some(&(x, y)) = part.get(next) {
        next += 1;
        for v in y.saturating_sub(1)..(y + 2).min(height) {
            for u in x.saturating_sub(1)..(x + 2).min(width) {
                if std::mem::take(&mut left.row_mut(v)[u]) {
                    part.push((u, v));
                }
            }
        }
    }
    part
}

/// Whether a true cell of `plane` has a neighbour, left, right, above or below, that is false or outside of the plane.
pub fn is_border(plane: &Plane<bool>, (x, y): (usize, usize)) -> bool {
    let is_inside = x > 0 && y > 0 && x + 1 < plane.width() && y + 1 < plane.height();
    !(is_inside && plane.at(x - 1, y) && plane.at(x + 1, y) && plane.at(x, y - 1) && plane.at(x, y + 1))
}

/// Closes gaps that are at most `2 * reach` cells wide.
pub fn closed(plane: &Plane<bool>, reach: usize) -> Plane<bool> {
    let not = |mut plane: Plane<bool>| {
        plane.as_mut_slice().iter_mut().for_each(|is| *is = !*is);
        plane
    };
    not(grown_by(&not(grown_by(plane, reach)), reach))
}

/// Returns the factor, times 255, by which the weight of a frame is multiplied. It is 0 up to a distance of `reach`
/// cells from the true cells of `plane`, rises over the next `2 * fade` cells, and is 255 beyond them.
pub fn kept(plane: &Plane<bool>, reach: usize, fade: usize) -> Plane<u8> {
    let (width, height) = (plane.width(), plane.height());
    // The mean below extends `fade` cells to either side. So cells up to a distance of `reach + fade` are excluded, to
    // get a weight of 0 up to a distance of `reach`.
    let wide = grown_by(plane, reach + fade);
    let free = Plane::from_vec(width, height, wide.as_slice().iter().map(|&is| usize::from(!is)).collect());
    let free = gathered(&free, fade, |sum, number| *sum += number);
    Plane::from_rows(width, height, |y, row: &mut [u8]| {
        let rows = near(y, fade, height).len();
        for (x, (kept, free)) in row.iter_mut().zip(free.row(y)).enumerate() {
            let all = rows * near(x, fade, width).len();
            *kept = ((255 * free + all / 2) / all) as u8;
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the plane in which '#' is true.
    fn plane(rows: &[&str]) -> Plane<bool> {
        let cells = rows.iter().flat_map(|row| row.bytes().map(|b| b == b'#')).collect();
        Plane::from_vec(rows[0].len(), rows.len(), cells)
    }

    #[test]
    fn parts_are_connected_by_corners_too_and_their_borders_are_seen() {
        let all = plane(&["##...##", "..#..##", "...#...", "#......"]);
        assert_eq!(parts(&all).iter().map(Vec::len).collect::<Vec<_>>(), [4, 4, 1]);
        let square = plane(&[".....", ".###.", ".###.", ".###.", "....."]);
        assert_eq!(parts(&square)[0].iter().filter(|&&at| is_border(&square, at)).count(), 8);
        assert!(is_border(&Plane::filled(3, 3, true), (0, 1)) && !is_border(&Plane::filled(3, 3, true), (1, 1)));
    }

    #[test]
    fn gaps_are_closed_and_borders_are_kept() {
        let with_gap = plane(&["###..###"; 9]);
        assert_eq!(closed(&with_gap, 1), plane(&["########"; 9]));
        let alone = plane(&[".......", ".......", "...#...", ".......", "......."]);
        assert_eq!(closed(&alone, 1), alone);
        // Motion near the border of the picture is assumed to continue beyond it, so the gap to the border is closed.
        assert_eq!(closed(&plane(&[".#.....", ".......", "......."]), 1), plane(&["##.....", ".......", "......."]));
    }

    #[test]
    fn weight_is_zero_around_moved_cells_and_rises_beyond() {
        let mut plane = Plane::filled(40, 30, false);
        plane.row_mut(15)[20] = true;
        let kept = kept(&plane, 2, 2);
        assert!((18..=22).all(|x| kept.at(x, 15) == 0), "{:?}", kept.row(15));
        // The weight rises by a fifth with each cell.
        assert_eq!(&kept.row(15)[22..28], [0, 51, 102, 153, 204, 255]);
        let all = super::kept(&Plane::filled(9, 9, true), 2, 2);
        assert!(all.as_slice().iter().all(|&v| v == 0));
    }
}
