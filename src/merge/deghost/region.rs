//! Regions: from evidence cell by cell to what is left out.
//!
//! In: for each cell how far a frame differs, and how surely that is motion. Out: 0 or 1 for each cell; a factor that falls off around it. Cost: some 10 ns
//! a cell.
//!
//! Of what differs the connected parts that somewhere surely moved are left out, wholly: a mover's middle may look like what it hides, and a tenth
//! of a long exposure's weight may still be ten times the reference's.

use crate::plane::Plane;

/// Where of the connected parts of `may` that have something of `is` in them lies something.
pub fn grown(may: &Plane<bool>, is: &Plane<bool>) -> Plane<bool> {
    let mut left = may.clone();
    let mut grown = Plane::filled(may.width(), may.height(), false);
    for y in 0..may.height() {
        for x in (0..may.width()).filter(|&x| is.at(x, y)) {
            taken(&mut left, (x, y)).into_iter().for_each(|(x, y)| grown.row_mut(y)[x] = true);
        }
    }
    grown
}

/// The connected parts of `plane`, from top to bottom: the columns and rows of each.
pub fn parts(plane: &Plane<bool>) -> Vec<Vec<(usize, usize)>> {
    let mut left = plane.clone();
    let all = (0..plane.height()).flat_map(|y| (0..plane.width()).map(move |x| (x, y)));
    all.map(|at| taken(&mut left, at)).filter(|part| !part.is_empty()).collect()
}

/// Takes the connected part that `at` is in out of `left`; it is empty where there is none. Cells are connected by sides and corners.
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

/// With the gaps closed that are less than 2 `reach` cells wide.
pub fn closed(plane: &Plane<bool>, reach: usize) -> Plane<bool> {
    let number = |is: &Plane<bool>, of: bool| {
        Plane::from_rows(is.width(), is.height(), |y, row: &mut [f32]| {
            row.iter_mut().zip(is.row(y)).for_each(|(v, &is)| *v = f32::from(u8::from(is == of)));
        })
    };
    let truth = |of: &Plane<f32>, when: f32| {
        Plane::from_rows(of.width(), of.height(), |y, row: &mut [bool]| {
            row.iter_mut().zip(of.row(y)).for_each(|(is, &v)| *is = v == when);
        })
    };
    let wide = truth(&greatest(&number(plane, true), reach), 1.0);
    truth(&greatest(&number(&wide, false), reach), 0.0)
}

/// 1 within `reach` cells of what is true, falling to 0 over the next `2 fade`.
pub fn widened(plane: &Plane<bool>, reach: usize, fade: usize) -> Plane<f32> {
    let mut wide = Plane::from_rows(plane.width(), plane.height(), |y, row: &mut [f32]| {
        row.iter_mut().zip(plane.row(y)).for_each(|(v, &is)| *v = f32::from(u8::from(is)));
    });
    wide = greatest(&wide, reach + fade);
    // The mean reaches `fade` cells to both sides of the border: what is within `reach` stays 1.
    mean(&wide, fade)
}

/// The mean within `reach` cells to either side, above and below.
fn mean(plane: &Plane<f32>, reach: usize) -> Plane<f32> {
    let (width, height) = (plane.width(), plane.height());
    let window = |i: usize, size: usize| i.saturating_sub(reach)..(i + reach + 1).min(size);
    let along = Plane::from_rows(width, height, |y, row: &mut [f32]| {
        for (x, v) in row.iter_mut().enumerate() {
            let of = &plane.row(y)[window(x, width)];
            *v = of.iter().sum::<f32>() / of.len() as f32;
        }
    });
    Plane::from_rows(width, height, |y, row: &mut [f32]| {
        let rows = window(y, height);
        let count = rows.len() as f32;
        for line in rows.map(|y| along.row(y)) {
            row.iter_mut().zip(line).for_each(|(v, &l)| *v += l);
        }
        row.iter_mut().for_each(|v| *v /= count);
    })
}

/// The greatest value within `reach` cells to either side, above and below.
fn greatest(plane: &Plane<f32>, reach: usize) -> Plane<f32> {
    let (width, height) = (plane.width(), plane.height());
    let window = |i: usize, size: usize| i.saturating_sub(reach)..(i + reach + 1).min(size);
    let along = Plane::from_rows(width, height, |y, row| {
        let line = plane.row(y);
        for (x, v) in row.iter_mut().enumerate() {
            *v = line[window(x, width)].iter().fold(0.0, |a: f32, &b| a.max(b));
        }
    });
    Plane::from_rows(width, height, |y, row: &mut [f32]| {
        for line in window(y, height).map(|y| along.row(y)) {
            row.iter_mut().zip(line).for_each(|(v, &l)| *v = v.max(l));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// '#' is true.
    fn plane(rows: &[&str]) -> Plane<bool> {
        let cells = rows.iter().flat_map(|row| row.bytes().map(|b| b == b'#')).collect();
        Plane::from_vec(rows[0].len(), rows.len(), cells)
    }

    #[test]
    fn what_may_have_moved_goes_with_what_did_where_they_are_connected() {
        let may = plane(&["##...##", "..#..##", "...#...", "#......"]);
        let is = plane(&["#......", "....#..", ".......", "......."]);
        // By corners too; that which may not have moved is none, and the other parts stay.
        assert_eq!(grown(&may, &is), plane(&["##.....", "..#....", "...#...", "......."]));
        assert_eq!(parts(&may).iter().map(Vec::len).collect::<Vec<_>>(), [4, 4, 1]);
    }

    #[test]
    fn gaps_are_closed_and_borders_stay() {
        let with_gap = plane(&["###..###"; 9]);
        assert_eq!(closed(&with_gap, 1), plane(&["########"; 9]));
        let alone = plane(&[".......", ".......", "...#...", ".......", "......."]);
        assert_eq!(closed(&alone, 1), alone);
        // What moved at the border goes on beyond it.
        assert_eq!(closed(&plane(&[".#.....", ".......", "......."]), 1), plane(&["##.....", ".......", "......."]));
    }

    #[test]
    fn what_is_widened_is_whole_within_reach_and_fades_beyond() {
        let mut plane = Plane::filled(40, 30, false);
        plane.row_mut(15)[20] = true;
        let wide = widened(&plane, 2, 2);
        assert!((18..=22).all(|x| (wide.at(x, 15) - 1.0).abs() < 1e-6), "{:?}", wide.row(15));
        assert!((23..27).all(|x| wide.at(x, 15) < wide.at(x - 1, 15)) && wide.at(27, 15) == 0.0, "{:?}", wide.row(15));
        let sure = Plane::filled(9, 9, true);
        assert!(widened(&sure, 2, 2).as_slice().iter().all(|v| (v - 1.0).abs() < 1e-6));
    }
}
