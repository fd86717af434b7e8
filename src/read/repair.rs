//! Repair of values that other programs write and the later stages do not accept.
//!
//! In: a radiance map of any floats. Out: the radiance map with every value positive and finite, and counts of the
//! changes. Cost: two passes over the pixels.

use crate::error::Warning;
use crate::merge::radiance::gamut::{into_gamut, weights};
use crate::merge::{FLOOR, RadianceMap};
use crate::plane::BAND_ROWS;
use rayon::prelude::*;
use std::path::Path;

/// Counts of the changed pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Repaired {
    /// Number of pixels with NaN, which become black.
    pub not_numbers: usize,
    /// Number of pixels with an infinite value. The value becomes the largest finite value of the picture ([`FLOOR`] if
    /// there is none above it), and keeps its sign.
    pub infinite: usize,
    /// Number of pixels with a negative value, that is, with a colour outside the gamut of the primaries. These pixels
    /// are desaturated at their luminance until they are inside; black if the luminance is not positive.
    pub negative: usize,
}

impl Repaired {
    /// Returns a warning for each kind of change.
    pub fn warnings(&self, path: &Path) -> Vec<Warning> {
        let all = [
            (self.not_numbers, "pixels are not numbers (NaN); they are shown black"),
            (
                self.infinite,
                "pixels have infinite values; these are limited to the largest finite value, if there is one",
            ),
            (
                self.negative,
                "pixels have negative values (colours outside the gamut); they are desaturated until they are inside, \
                 or black if their luminance is not positive",
            ),
        ];
        let found = all.into_iter().filter(|(count, _)| *count > 0);
        found
            .map(|(count, what)| Warning::Metadata { path: path.to_owned(), detail: format!("{count} {what}") })
            .collect()
    }
}

/// Returns `map` with every value positive and finite, and the counts of the changes. Zeros become [`FLOOR`] without
/// being counted. A map from the merge stage is not changed.
pub fn repair(mut map: RadianceMap) -> (RadianceMap, Repaired) {
    let values = || map.pixels.as_slice().as_flattened().par_iter();
    let greatest = values().copied().filter(|v| v.is_finite()).reduce(|| FLOOR, f32::max);
    let weights = weights(&map.primaries);
    let band = (BAND_ROWS * map.pixels.width()).max(1);
    let parts = map.pixels.as_mut_slice().par_chunks_mut(band).map(|pixels| {
        let mut done = Repaired::default();
        for pixel in pixels {
            if pixel.iter().any(|v| v.is_nan()) {
                done.not_numbers += 1;
                *pixel = [FLOOR; 3];
                continue;
            }
            if pixel.iter().any(|v| v.is_infinite()) {
                done.infinite += 1;
                *pixel = pixel.map(|v| v.clamp(-greatest, greatest));
            }
            let (inside, drawn) = into_gamut(*pixel, weights);
            done.negative += usize::from(drawn);
            *pixel = inside;
        }
        done
    });
    // Sums of integers are the same in any order.
    let done = parts.reduce(Repaired::default, |a, b| Repaired {
        not_numbers: a.not_numbers + b.not_numbers,
        infinite: a.infinite + b.infinite,
        negative: a.negative + b.negative,
    });
    (map, done)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;
    use crate::plane::Plane;

    #[test]
    fn invalid_values_are_corrected_and_counted() {
        let odd = vec![
            [f32::NAN, 1.0, 1.0],
            [f32::INFINITY, 2.0, 7.0],
            [-0.1, 1.0, 1.0],
            [-1.0, -1.0, -1.0],
            [0.0, 0.5, 0.5],
            [f32::NEG_INFINITY, 1.0, 1.0],
        ];
        let map = RadianceMap { pixels: Plane::from_vec(6, 1, odd), primaries: Primaries::SRGB };
        let (repaired, done) = repair(map);
        assert_eq!(done, Repaired { not_numbers: 1, infinite: 2, negative: 3 });
        assert!(repaired.pixels.as_slice().as_flattened().iter().all(|v| *v >= FLOOR && v.is_finite()));
        assert_eq!((repaired.pixels.at(0, 0), repaired.pixels.at(1, 0)), ([FLOOR; 3], [7.0, 2.0, 7.0]));
        assert_eq!((repaired.pixels.at(4, 0), repaired.pixels.at(3, 0)), ([FLOOR, 0.5, 0.5], [FLOOR; 3]));
        let [r, g, b] = repaired.pixels.at(2, 0);
        let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        assert!((luminance - (0.7874 - 0.02126)).abs() < 1e-5 && r == FLOOR && g == b);
        assert_eq!(repair(repaired.clone()), (repaired, Repaired::default()));
        assert_eq!(done.warnings(Path::new("a.exr")).len(), 3);
    }
}
