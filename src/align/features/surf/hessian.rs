//! The Fast-Hessian detector: maxima of the determinant of the Hessian, approximated by box filters (Bay 2006, section
//! 3).

use super::SurfOptions;
use super::integral::Integral;
use crate::align::features::{Keypoint, interpolation};
use crate::plane::{Plane, map_bands};

/// Number of filters in an octave. A maximum over three neighbouring filters can only be at the second or the third
/// one.
const FILTERS: usize = 4;
/// Side of the smallest filter, in pixels.
const SMALLEST: usize = 9;
/// Scale of the smallest filter: the standard deviation of the Gaussian that it approximates, in pixels.
const SMALLEST_SCALE: f64 = 1.2;
/// Weight of Dxy, which makes the filter for xy comparable with those for xx and yy (equation 3).
const BALANCE: f32 = 0.9;

/// Returns the side of filter `index` of octave `octave`, in pixels. The sides are 9, 15, 21, 27 in the first octave;
/// 15, 27, 39, 51 in the second; 27, 51, 75, 99 in the third; and so on.
pub(super) fn side(octave: usize, index: usize) -> usize {
    // The growth from filter to filter doubles with each octave. The smallest filter of an octave has the size of the
    // second filter of the octave before.
    let growth = 6 << octave;
    SMALLEST + (growth - 6) + growth * index
}

/// The determinants of the Hessian with one filter, at every `step`-th pixel; 0 if the filter is not inside the image.
struct Responses {
    step: usize,
    side: usize,
    determinants: Plane<f32>,
}

/// Returns the second derivatives xx, yy and xy at a pixel, for grey values scaled to 0..=1, divided by the area of the
/// filter.
fn derivatives(integral: &Integral, x: usize, y: usize, side: usize) -> [f32; 3] {
    let (lobe, half) = (side / 3, side / 2);
    let (left, right, top, bottom) = (x - half, x + half + 1, y - half, y + half + 1);
    // The filters of xx and yy have three lobes. Each lobe is `lobe` pixels (a third of the side) long in the direction
    // of the derivative, and 2 `lobe` - 1 pixels wide.
    let across = |at: usize| (at + 1 - lobe, at + lobe);
    let middle = |at: usize| (at - lobe / 2, at + lobe / 2 + 1);
    let signed = |sum: u32| sum as i32;
    let xx = signed(integral.sum((left, right), across(y))) - 3 * signed(integral.sum(middle(x), across(y)));
    let yy = signed(integral.sum(across(x), (top, bottom))) - 3 * signed(integral.sum(across(x), middle(y)));
    let (before, after) = (|at: usize| (at - lobe, at), |at: usize| (at + 1, at + 1 + lobe));
    let xy = signed(integral.sum(before(x), before(y))) + signed(integral.sum(after(x), after(y)))
        - signed(integral.sum(after(x), before(y)))
        - signed(integral.sum(before(x), after(y)));
    let scale = 1.0 / (255 * side * side) as f32;
    [xx, yy, xy].map(|d| d as f32 * scale)
}

/// Returns the determinant of the Hessian with the elements xx, yy and xy.
fn determinant([xx, yy, xy]: [f32; 3]) -> f32 {
    xx * yy - (BALANCE * xy) * (BALANCE * xy)
}

/// Computes the determinants at every `step`-th pixel of row `y`, from column `x` on, for all elements of `out`.
///
/// All boxes of a row have the same upper and lower edges. So ten reads from three rows of differences replace the 32
/// reads of [`derivatives`].
fn fill_row(integral: &Integral, (x, y): (usize, usize), step: usize, side: usize, out: &mut [f32]) {
    let (lobe, half) = (side / 3, side / 2);
    let minus = |mut row: Vec<u32>, other: Vec<u32>, times: u32| {
        row.iter_mut().zip(other).for_each(|(a, b)| *a = a.wrapping_sub(b.wrapping_mul(times)));
        row
    };
    let rows = |top, bottom| integral.between(top, bottom);
    let flat = rows(y + 1 - lobe, y + lobe);
    let upright = minus(rows(y - half, y + half + 1), rows(y - lobe / 2, y + lobe / 2 + 1), 3);
    let corners = minus(rows(y + 1, y + 1 + lobe), rows(y - lobe, y), 1);
    // Element i of the slice `right_of_edge(row)(offset)` belongs to the filter at pixel x + i. It is the value of
    // `row` that is `offset` pixels to the right of the left edge of this filter.
    let length = (out.len() - 1) * step + 1;
    let right_of_edge = |row| move |offset: usize| -> &[u32] { &Vec::as_slice(row)[x - half + offset..][..length] };
    let [left, inner_left, inner_right, right] =
        [0, half - lobe / 2, half + lobe / 2 + 1, side].map(right_of_edge(&flat));
    let [above, below] = [half + 1 - lobe, half + lobe].map(right_of_edge(&upright));
    let [a, b, c, d] = [half - lobe, half, half + 1, half + 1 + lobe].map(right_of_edge(&corners));
    let scale = 1.0 / (255 * side * side) as f32;
    let derivative = |sum: u32| sum as i32 as f32 * scale;
    for (k, v) in out.iter_mut().enumerate() {
        let i = k * step;
        let middle = inner_right[i].wrapping_sub(inner_left[i]);
        let xx = right[i].wrapping_sub(left[i]).wrapping_sub(middle.wrapping_mul(3));
        let yy = below[i].wrapping_sub(above[i]);
        let xy = d[i].wrapping_sub(c[i]).wrapping_sub(b[i].wrapping_sub(a[i]));
        *v = determinant([derivative(xx), derivative(yy), derivative(xy)]);
    }
}

impl Responses {
    fn new(integral: &Integral, step: usize, side: usize) -> Self {
        let (width, height) = (integral.width(), integral.height());
        let half = side / 2;
        let columns = half.div_ceil(step)..(width - half).div_ceil(step);
        let determinants = Plane::from_rows(width.div_ceil(step), height.div_ceil(step), |row, out: &mut [f32]| {
            let y = row * step;
            if y >= half && y + half < height && !columns.is_empty() {
                fill_row(integral, (columns.start * step, y), step, side, &mut out[columns.clone()]);
            }
        });
        Responses { step, side, determinants }
    }

    /// Returns the number of samples at each border of the image for which the filter is not inside the image.
    fn border(&self) -> usize {
        (self.side / 2) / self.step + 1
    }
}

/// Returns the maxima that have at least the required strength, in pixels of the image. Their directions are not
/// computed yet.
pub(super) fn find(integral: &Integral, options: &SurfOptions) -> Vec<Keypoint> {
    let mut found = Vec::new();
    for octave in 0..options.octaves {
        if side(octave, FILTERS - 1) > integral.width().min(integral.height()) {
            break;
        }
        let step = 1 << octave;
        let responses: [Responses; FILTERS] = std::array::from_fn(|i| Responses::new(integral, step, side(octave, i)));
        for three in responses.windows(3) {
            let height = three[1].determinants.height();
            let bands = map_bands(height, |rows| {
                let border = three[2].border();
                let mut band = Vec::new();
                for y in rows.start.max(border)..rows.end.min(height.saturating_sub(border)) {
                    find_in_row(integral, three, y, options, &mut band);
                }
                band
            });
            found.extend(bands.into_iter().flatten());
        }
    }
    found
}

/// Adds the maxima in row `y` of the middle one of the `three` responses to `found`.
fn find_in_row(integral: &Integral, three: &[Responses], y: usize, options: &SurfOptions, found: &mut Vec<Keypoint>) {
    let here = &three[1];
    let (row, border) = (here.determinants.row(y), three[2].border());
    let (step, growth) = (here.step as f64, (here.side - three[0].side) as f64);
    for x in border..row.len().saturating_sub(border) {
        let v = row[x];
        if f64::from(v) < options.contrast || v < row[x - 1] || v < row[x + 1] {
            continue;
        }
        let at = |dx: isize, dy: isize, ds: isize| -> f32 {
            three[1usize.wrapping_add_signed(ds)].determinants.at(x.wrapping_add_signed(dx), y.wrapping_add_signed(dy))
        };
        // If neighbouring samples are equal, only the last one counts as the maximum.
        let is_maximum = (-1..=1).all(|ds| {
            (-1..=1).all(|dy| {
                (-1..=1).all(|dx| if (ds, dy, dx) > (0, 0, 0) { v > at(dx, dy, ds) } else { v >= at(dx, dy, ds) })
            })
        });
        if !is_maximum {
            continue;
        }
        // Interpolates the position of the maximum between the samples. Drops the maximum if this position is more than
        // one sample away from the sampled maximum in any direction.
        let near = interpolation::extremum(|dx, dy, ds| at(dx, dy, ds).into())
            .filter(|(offset, _)| offset.iter().all(|o| o.abs() <= 1.0));
        if let Some((offset, determinant)) = near {
            let [xx, yy, _] = derivatives(integral, x * here.step, y * here.step, here.side);
            found.push(Keypoint {
                x: ((x as f64 + offset[0]) * step) as f32,
                y: ((y as f64 + offset[1]) * step) as f32,
                scale: (SMALLEST_SCALE / SMALLEST as f64 * (here.side as f64 + offset[2] * growth)) as f32,
                angle: 0.0,
                response: determinant as f32,
                bright: xx + yy < 0.0,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_filled_with_the_determinants_of_single_pixels() {
        let integral = Integral::new(&picture(97, 83));
        for (step, side) in [(1, 9), (1, 27), (2, 39), (4, 75)] {
            let responses = Responses::new(&integral, step, side);
            let is_inside = |at: usize, length: usize| at >= side / 2 && at + side / 2 < length;
            for (row, y) in (0..83).step_by(step).enumerate() {
                for (column, x) in (0..97).step_by(step).enumerate() {
                    let expected = match is_inside(x, 97) && is_inside(y, 83) {
                        true => determinant(derivatives(&integral, x, y, side)),
                        false => 0.0,
                    };
                    assert_eq!(responses.determinants.at(column, row), expected, "{step} {side}: {x} {y}");
                }
            }
        }
    }

    #[test]
    fn filters_are_those_of_the_paper() {
        let sides = |octave| [0, 1, 2, 3].map(|index| side(octave, index));
        assert_eq!([sides(0), sides(1), sides(2)], [[9, 15, 21, 27], [15, 27, 39, 51], [27, 51, 75, 99]]);
    }

    fn picture(width: usize, height: usize) -> Plane<u8> {
        Plane::from_rows(width, height, |y, row: &mut [u8]| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = ((x * x * 7 + y * 91 + x * y) % 253) as u8;
            }
        })
    }

    /// The expected values come from the filters of figure 1 of the paper, as tables of weights.
    #[test]
    fn derivatives_are_the_sums_of_weighted_pixels() {
        let grey = picture(40, 40);
        let integral = Integral::new(&grey);
        for (x, y, side) in [(20, 17, 9), (14, 25, 15), (19, 20, 27)] {
            let (lobe, half) = ((side / 3) as isize, (side / 2) as isize);
            let second = |along: isize, across: isize| match across.abs() < lobe {
                true if along.abs() <= lobe / 2 => -2.0,
                true => 1.0,
                false => 0.0,
            };
            let mixed = |dx: isize, dy: isize| match dx.abs() <= lobe && dy.abs() <= lobe {
                true => (dx.signum() * dy.signum()) as f32,
                false => 0.0,
            };
            let mut expected = [0.0f32; 3];
            for dy in -half..=half {
                for dx in -half..=half {
                    let v = f32::from(grey.at((x as isize + dx) as usize, (y as isize + dy) as usize));
                    expected[0] += v * second(dx, dy);
                    expected[1] += v * second(dy, dx);
                    expected[2] += v * mixed(dx, dy);
                }
            }
            let found = derivatives(&integral, x, y, side);
            for (f, e) in found.iter().zip(expected) {
                // The sums are exact integers below 2^24. Only the quotients, which are below 1, are rounded.
                assert!((f - e / (255 * side * side) as f32).abs() < 1e-5, "{side}: {found:?} {expected:?}");
            }
        }
    }
}
