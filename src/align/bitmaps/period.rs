//! Detection of repeating pictures, in which a frame matches in more than one place.
//!
//! In: a grey pyramid. Out: whether the picture repeats. Cost: a few milliseconds: one packed comparison for every
//! shift within reach, on a small level. Source: Ward's bitmaps (2003), applied to the picture and itself. In a picture
//! that does not repeat, about half of the pixels differ under a shift, and fewer the smaller the shift is. In a facade
//! hardly any pixel differs under a shift by its period, and many differ under a shift by half a period.

use crate::align::bitmaps::difference::difference_shifted;
use crate::align::bitmaps::threshold::own_percentile;
use crate::align::bitmaps::{MtbOptions, ThresholdBitmaps};
use crate::align::grey::GreyPyramid;
use rayon::prelude::*;

/// The short side of the level examined is less than this, in pixels: fine enough for the windows of a facade.
const SIDE: usize = 256;
/// Largest ratio of the share of pixels that differ under a shift by a period to the share under half that shift.
const ALIKE: f64 = 0.6;
/// Smallest period that is detected, in pixels of the level.
const LEAST: i64 = 5;
/// Least share of pixels that differ under a shift by half a period; with a smaller share the picture is uniform rather
/// than periodic.
const LEAST_DIFFERENCE: f64 = 0.03;

/// Whether `picture` matches itself under a shift of more than a few pixels and at most the largest shift of
/// `options` (a periodic pattern).
pub(crate) fn repeats(picture: &GreyPyramid, options: &MtbOptions) -> bool {
    let level = picture.level_narrower_than(SIDE);
    let plane = picture.level(level);
    let bitmaps = ThresholdBitmaps::of_level(
        picture,
        level,
        own_percentile(picture.histogram(level), options.exclusion),
        options.exclusion,
    );
    let reach = (options.max_shift * plane.width().max(plane.height()) as f64) as i64;
    // Shifts by d and by -d compare the same pairs of pixels, so half of all shifts suffice.
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
            // A skyline differs little from itself under a small horizontal shift, and less the smaller the shift is.
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
    fn uniform_picture_has_no_period() {
        for (width, height) in [(1, 1), (3, 200), (300, 200)] {
            let plain = GreyPyramid::new(crate::plane::Plane::filled(width, height, 77));
            assert!(!repeats(&plain, &MtbOptions::default()));
        }
    }
}
