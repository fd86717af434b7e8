//! Gaussian and Laplacian pyramids of Burt & Adelson.
//!
//! In: planes of floats. Out: planes of half the size, rounded up, and back. Cost: 4 ns per pixel and level; all
//! levels together have a third more pixels than the first level. Source: Burt & Adelson, "The Laplacian Pyramid as a
//! Compact Image Code" (1983), sections REDUCE and EXPAND, with a = 3/8.

use crate::plane::Plane;

/// Returns the number of levels of a pyramid whose coarsest level is the first with a short side of at most 4 pixels.
pub fn levels((width, height): (usize, usize)) -> usize {
    let mut side = width.min(height);
    let mut levels = 1;
    while side > 4 {
        side = side.div_ceil(2);
        levels += 1;
    }
    levels
}

/// Returns the next coarser level: every second pixel of `plane`, smoothed by (1 4 6 4 1) / 16 along both axes; the
/// border is repeated.
pub fn reduce(plane: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (plane.width(), plane.height());
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let mut coarse = Plane::filled(w, h, 0.0f32);
    // The buffer has two extra pixels at each end, so that the loop needs no special case for the border.
    let mut column = vec![0.0f32; width + 4];
    for y in 0..h {
        let row = |d: isize| plane.row((2 * y as isize + d).clamp(0, height as isize - 1) as usize);
        let rows = [row(-2), row(-1), row(0), row(1), row(2)];
        for (x, sum) in column[2..width + 2].iter_mut().enumerate() {
            *sum = 0.0625 * (rows[0][x] + rows[4][x]) + 0.25 * (rows[1][x] + rows[3][x]) + 0.375 * rows[2][x];
        }
        let (first, last) = (column[2], column[width + 1]);
        column[..2].fill(first);
        column[width + 2..].fill(last);
        for (to, c) in coarse.row_mut(y).iter_mut().zip(column.windows(5).step_by(2)) {
            *to = 0.0625 * (c[0] + c[4]) + 0.25 * (c[1] + c[3]) + 0.375 * c[2];
        }
    }
    coarse
}

/// Returns `coarse`, enlarged to the size of the level from which [`reduce`] has computed it.
pub fn expand(coarse: &Plane<f32>, (width, height): (usize, usize)) -> Plane<f32> {
    let mut fine = Plane::filled(width, height, 0.0f32);
    let (w, h) = (coarse.width(), coarse.height());
    let mut column = vec![0.0f32; w + 2];
    for y in 0..height {
        let at = y / 2;
        let (above, here, below) = (coarse.row(at.saturating_sub(1)), coarse.row(at), coarse.row((at + 1).min(h - 1)));
        let between = &mut column[1..=w];
        if y % 2 == 0 {
            for (x, sum) in between.iter_mut().enumerate() {
                *sum = 0.125 * (above[x] + below[x]) + 0.75 * here[x];
            }
        } else {
            for (x, sum) in between.iter_mut().enumerate() {
                *sum = 0.5 * (here[x] + below[x]);
            }
        }
        column[0] = column[1];
        column[w + 1] = column[w];
        for (pair, c) in fine.row_mut(y).chunks_mut(2).zip(column.windows(3)) {
            pair[0] = 0.125 * (c[0] + c[2]) + 0.75 * c[1];
            if let Some(second) = pair.get_mut(1) {
                *second = 0.5 * (c[1] + c[2]);
            }
        }
    }
    fine
}

/// The Gaussian pyramid of `plane` with `levels` levels, the finest first.
pub fn gaussian_pyramid(plane: Plane<f32>, levels: usize) -> Vec<Plane<f32>> {
    let mut pyramid = vec![plane];
    for finer in 0..levels.saturating_sub(1) {
        pyramid.push(reduce(&pyramid[finer]));
    }
    pyramid
}

/// Converts a Gaussian pyramid to a Laplacian pyramid: each level minus the enlarged next coarser level. The coarsest
/// level is unchanged.
pub fn laplacian_pyramid(mut pyramid: Vec<Plane<f32>>) -> Vec<Plane<f32>> {
    for i in 1..pyramid.len() {
        let (finer, coarser) = pyramid.split_at_mut(i);
        combine(&mut finer[i - 1], &coarser[0], |v, smooth| *v -= smooth);
    }
    pyramid
}

/// Returns the image of a Laplacian pyramid; a plane without pixels for a pyramid without levels.
pub fn collapse(mut pyramid: Vec<Plane<f32>>) -> Plane<f32> {
    let mut image = pyramid.pop().unwrap_or_else(|| Plane::filled(0, 0, 0.0));
    while let Some(mut level) = pyramid.pop() {
        combine(&mut level, &image, |v, smooth| *v += smooth);
        image = level;
    }
    image
}

/// Enlarges the next `coarser` level to the size of `level`. Then calls `change` with every pixel of `level` and the
/// pixel at the same position of the enlarged level.
fn combine(level: &mut Plane<f32>, coarser: &Plane<f32>, change: impl Fn(&mut f32, f32)) {
    let smooth = expand(coarser, (level.width(), level.height()));
    level.as_mut_slice().iter_mut().zip(smooth.as_slice()).for_each(|(v, &s)| change(v, s));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize) -> Plane<f32> {
        Plane::from_rows(width, height, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = ((x * 31 + y * 17) % 29) as f32 - 10.0;
            }
        })
    }

    /// The tolerance is ten roundings of f32 values below 32: 10 * 32 * 2^-24 = 2e-5.
    #[test]
    fn levels_are_the_double_sums_of_the_paper() {
        let weight = |d: isize| [0.0625, 0.25, 0.375, 0.25, 0.0625][(d + 2) as usize];
        for (w, h) in [(23, 14), (8, 9), (5, 1), (2, 2)] {
            let plane = picture(w, h);
            let at = |p: &Plane<f32>, x: isize, y: isize| {
                let (x, y) = (x.clamp(0, p.width() as isize - 1), y.clamp(0, p.height() as isize - 1));
                f64::from(p.at(x as usize, y as usize))
            };
            let coarse = reduce(&plane);
            assert_eq!((coarse.width(), coarse.height()), (w.div_ceil(2), h.div_ceil(2)));
            let fine = expand(&coarse, (w, h));
            for (x, y) in (0..h as isize).flat_map(|y| (0..w as isize).map(move |x| (x, y))) {
                let (mut sum, mut back) = (0.0, 0.0);
                for (i, j) in (-2..=2).flat_map(|j| (-2..=2).map(move |i| (i, j))) {
                    sum += weight(i) * weight(j) * at(&plane, 2 * x + i, 2 * y + j);
                    if (x - i) % 2 == 0 && (y - j) % 2 == 0 {
                        back += 4.0 * weight(i) * weight(j) * at(&coarse, (x - i) / 2, (y - j) / 2);
                    }
                }
                if x < coarse.width() as isize && y < coarse.height() as isize {
                    assert!((at(&coarse, x, y) - sum).abs() < 2e-5, "{x}, {y}");
                }
                assert!((at(&fine, x, y) - back).abs() < 2e-5, "{x}, {y} of {w}x{h}");
            }
        }
    }

    /// The tolerance is one rounding of f32 values below 64 for each level.
    #[test]
    fn a_laplacian_pyramid_is_its_picture() {
        for (w, h) in [(100, 75), (33, 2), (1, 1)] {
            let plane = picture(w, h);
            let whole = collapse(laplacian_pyramid(gaussian_pyramid(plane.clone(), levels((w, h)))));
            for (a, b) in whole.as_slice().iter().zip(plane.as_slice()) {
                assert!((a - b).abs() < 2e-5);
            }
        }
    }
}
