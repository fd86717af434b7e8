//! A smooth map through differences that are known in places.
//!
//! In: differences on cells, with weights. Out: a coarser map of them, known everywhere. Cost: eight smoothings of a map of at most 64 x 64 cells.
//! Source: normalised convolution (Knutsson & Westin 1993), from the largest neighbourhood to the smallest: each adds what the larger ones leave, where
//! there are enough cells to tell.

use crate::plane::Plane;
use crate::pyramid::cells::row_between_cells;
use crate::pyramid::gaussian;

/// Standard deviations of the neighbourhoods, in cells of the map: from an eighth of the longer side to a sixty-fourth.
const SCALES: [f64; 4] = [8.0, 4.0, 2.0, 1.0];
/// A neighbourhood whose cells together weigh this much has half its say.
const FEW: f32 = 0.25;

/// A difference in stops, and its weight, 0..=1.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Difference {
    pub stops: f32,
    pub weight: f32,
}

/// The map of `differences`, each of its cells `side` of theirs wide; 0 where there is none at all.
pub(super) fn smoothed(differences: &Plane<Difference>, side: usize) -> Plane<f32> {
    let (width, height) = (differences.width().div_ceil(side), differences.height().div_ceil(side));
    let all = differences.as_slice().iter();
    let (sum, weight) = all.fold((0.0f64, 0.0f64), |(sum, weight), d| {
        (sum + f64::from(d.weight) * f64::from(d.stops), weight + f64::from(d.weight))
    });
    let mut map = Plane::filled(width, height, if weight > 0.0 { (sum / weight) as f32 } else { 0.0 });
    for sigma in SCALES {
        let sums = Plane::from_rows(width, height, |j, row: &mut [(f32, f32)]| {
            let mut known = vec![0.0f32; differences.width()];
            for y in side * j..(side * (j + 1)).min(differences.height()) {
                row_between_cells(&map, side, |v| v, y, &mut known);
                for (i, (known, d)) in
                    known.iter().zip(differences.row(y)).enumerate().filter(|(_, (_, d))| d.weight > 0.0)
                {
                    let (left, weight) = &mut row[i / side];
                    *left += d.weight * (d.stops - known);
                    *weight += d.weight;
                }
            }
        });
        let part = |of: fn(&(f32, f32)) -> f32| {
            gaussian(&Plane::from_vec(width, height, sums.as_slice().iter().map(of).collect()), sigma)
        };
        let (left, weight) = (part(|sum| sum.0), part(|sum| sum.1));
        map.fill_rows(|y, row| {
            for ((v, left), weight) in row.iter_mut().zip(left.row(y)).zip(weight.row(y)) {
                *v += left / (weight + FEW);
            }
        });
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(of: impl Fn(usize, usize) -> Difference + Sync) -> Plane<Difference> {
        Plane::from_rows(96, 64, |y, row| row.iter_mut().enumerate().for_each(|(x, d)| *d = of(x, y)))
    }

    #[test]
    fn smoothed_of_a_ramp_known_everywhere_is_the_ramp() {
        let ramp = |x: usize| 0.02 * x as f32;
        let map = smoothed(&plane(|x, _| Difference { stops: ramp(x), weight: 1.0 }), 4);
        let mut row = [0.0f32; 96];
        row_between_cells(&map, 4, |v| v, 32, &mut row);
        for x in 16..80 {
            // A cell of the map is 4 wide, and the smallest neighbourhood as large.
            assert!((row[x] - ramp(x)).abs() < 0.03, "{x}: {}", row[x]);
        }
    }

    #[test]
    fn smoothed_where_nothing_is_known_is_what_the_surroundings_have() {
        let map = smoothed(
            &plane(|x, _| Difference { stops: if x < 40 { -1.0 } else { 9.0 }, weight: f32::from(u8::from(x < 40)) }),
            4,
        );
        assert!(map.as_slice().iter().all(|v| (v + 1.0).abs() < 0.02), "{:?}", map.row(3));
        assert!(smoothed(&plane(|_, _| Difference::default()), 4).as_slice().iter().all(|v| *v == 0.0));
    }
}
