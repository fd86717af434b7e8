//! Detection of repeating pictures: a frame then matches in more than one place, and the first match need not be the
//! right one.
//!
//! In: a grey pyramid. Out: yes or no. Cost: a few milliseconds: one packed comparison for every shift within reach, on
//! a small level. Source: Ward's bitmaps (2003), of the picture against itself. A picture that does not repeat differs
//! by about half its pixels under a shift, or by less and less towards none; a facade hardly differs at its period, and
//! much half-way.

use crate::align::bitmaps::difference::difference_shifted;
use crate::align::bitmaps::threshold::own_percentile;
use crate::align::bitmaps::{MtbOptions, ThresholdBitmaps};
use crate::align::grey::GreyPyramid;
use rayon::prelude::*;

/// Short side of the level that is looked at: fine enough for the windows of a facade.
const SIDE: usize = 256;
/// At its period a picture differs by no more than this share of what it does on the way there.
const ALIKE: f64 = 0.6;
/// Shifts smaller than this are not distinguished from none, in pixels of the level.
const LEAST: i64 = 5;
/// Where the picture differs from itself by less than this on the way, it is plain rather than periodic.
const LEAST_DIFFERENCE: f64 = 0.03;

/// Whether `picture` looks the same again, shifted by more than a few pixels, and no farther than `options` has frames
/// sought.
pub(crate) fn repeats(picture: &GreyPyramid, options: &MtbOptions) -> bool {
    let fits = |i: &usize| picture.size(*i).0.min(picture.size(*i).1) < SIDE;
    let level = (0..picture.len()).find(fits).unwrap_or(picture.len() - 1);
    let plane = picture.level(level);
    let bitmaps = ThresholdBitmaps::of_level(
        picture,
        level,
        own_percentile(picture.histogram(level), options.exclusion),
        options.exclusion,
    );
    let reach = (options.max_shift * plane.width().max(plane.height()) as f64) as i64;
    // Shifts by d and by -d compare the same pixels.
    let side = (2 * reach + 1) as usize;
    let rate = |dx: i64, dy: i64| difference_shifted(&bitmaps, &bitmaps, dx, dy).rate();
    let rates: Vec<f64> = (0..side * (reach as usize + 1))
        .into_par_iter()
        .map(|i| rate((i % side) as i64 - reach, (i / side) as i64))
        .collect();
    let at = |dx: i64, dy: i64| {
        let (dx, dy) = if dy < 0 { (-dx, -dy) } else { (dx, dy) };
        rates[dy as usize * side + (dx + reach) as usize]
    };
    let is_period = |dx: i64, dy: i64| {
        let here = at(dx, dy);
        let half = at(dx / 2, dy / 2);
        half > LEAST_DIFFERENCE
            && here < ALIKE * half
            && (-1..=1).all(|j| (-1..=1).all(|i| (i, j) == (0, 0) || here <= at(dx + i, dy + j)))
    };
    (0..reach).any(|dy| (1 - reach..reach).any(|dx| dx.abs().max(dy) >= LEAST && is_period(dx, dy)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::{Scene, Shot, photograph};
    use crate::align::transform::Transform;

    const SIZE: (usize, usize) = (480, 320);

    #[test]
    fn a_facade_repeats_and_a_landscape_does_not() {
        for seed in 1..6 {
            let scene = Scene::new(seed);
            let taken = |radiance: &(dyn Fn(f64, f64) -> f64 + Sync)| {
                GreyPyramid::new(photograph(SIZE, &Transform::Identity, Shot::at(0.0), radiance))
            };
            assert!(!repeats(&taken(&|x, y| scene.radiance(x, y)), &MtbOptions::default()), "{seed}");
            // A skyline looks much the same a little to the side, and more so the less it is shifted.
            assert!(
                !repeats(
                    &taken(&|x, y| if y < 150.0 + 0.1 * x { 4.0 } else { 0.1 * scene.radiance(x, y) }),
                    &MtbOptions::default()
                ),
                "{seed}"
            );
            let facade = |x: f64, y: f64| {
                let wall = x > 60.0;
                if wall { scene.radiance(x.rem_euclid(34.0), y.rem_euclid(41.0)) } else { scene.radiance(x, y) }
            };
            assert!(repeats(&taken(&facade), &MtbOptions::default()), "{seed}");
        }
    }

    #[test]
    fn nothing_does_not_repeat() {
        for (width, height) in [(1, 1), (3, 200), (300, 200)] {
            let plain = GreyPyramid::new(crate::plane::Plane::filled(width, height, 77));
            assert!(!repeats(&plain, &MtbOptions::default()));
        }
    }
}
