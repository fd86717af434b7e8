//! Conversion of radiance to another colour space.
//!
//! In: a radiance map and a colour space. Out: the radiance in that space, with positive values, and the number of
//! pixels that were outside it. Cost: 3 ns of one core per pixel. Source: see [`crate::bracket::colour`].
//!
//! A colour outside the space has a negative component, which RGBE and most programs cannot represent. The colour is
//! desaturated towards the grey of its luminance until no component is negative: luminance and hue are kept.

use crate::bracket::colour::{Conversion, Primaries, Space};
use crate::error::Warning;
use crate::merge::{FLOOR, RadianceMap};
use crate::plane::BAND_ROWS;
use rayon::prelude::*;

/// Desaturates `rgb` at its luminance until no component is negative, and returns whether that was necessary. `weights`
/// are the contributions of red, green and blue to luminance. Without luminance the result is [`FLOOR`].
#[inline]
pub fn into_gamut(rgb: [f32; 3], weights: [f32; 3]) -> ([f32; 3], bool) {
    let [r, g, b] = rgb;
    let least = r.min(g).min(b);
    if least >= 0.0 {
        return (rgb.map(|c| c.max(FLOOR)), false);
    }
    let y = weights[0] * r + weights[1] * g + weights[2] * b;
    if y.is_nan() || y <= FLOOR {
        return ([FLOOR; 3], true);
    }
    let keep = y / (y - least);
    (rgb.map(|c| (y + keep * (c - y)).max(FLOOR)), true)
}

/// Returns the weights for [`into_gamut`] in a space with these primaries.
pub fn weights(primaries: &Primaries) -> [f32; 3] {
    primaries.luminance().map(|w| w as f32)
}

/// Converts `map` to the space `to`, white to white, and returns the number of pixels that were desaturated. The map is
/// returned unchanged if it is in the space `to` already, or in an unknown one.
pub fn converted(mut map: RadianceMap, to: Space) -> (RadianceMap, usize) {
    let target = to.primaries();
    let Some(conversion) =
        Conversion::between(&map.primaries, &target).filter(|_| !map.primaries.is_close(&target, 1e-5))
    else {
        return (map, 0);
    };
    let weights = weights(&target);
    let band = (BAND_ROWS * map.pixels.width()).max(1);
    let outside = map.pixels.as_mut_slice().par_chunks_mut(band).map(|pixels| {
        let mut outside = 0;
        for pixel in pixels {
            let (inside, drawn) = into_gamut(conversion.apply(*pixel), weights);
            *pixel = inside;
            outside += usize::from(drawn);
        }
        outside
    });
    // Sums of integers do not depend on the order.
    let outside = outside.sum();
    map.primaries = target;
    (map, outside)
}

/// Returns the warning on `outside` pixels that were desaturated, or `None` if there are none.
pub fn warning(outside: usize) -> Option<Warning> {
    let detail = format!(
        "{outside} pixels have colours outside the requested colour space; their saturation is reduced, their luminance is kept"
    );
    (outside > 0).then_some(Warning::OutOfGamut { detail })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::Plane;

    fn map(pixels: Vec<[f32; 3]>, primaries: Primaries) -> RadianceMap {
        RadianceMap { pixels: Plane::from_vec(pixels.len(), 1, pixels), primaries }
    }

    #[test]
    fn colours_within_come_back_and_those_outside_keep_their_luminance() {
        let colours = vec![[0.2, 0.5, 0.7], [3.0, 1.0, 2.0], [1.0; 3]];
        let (wide, outside) = converted(map(colours.clone(), Primaries::SRGB), Space::Rec2020);
        assert_eq!((wide.primaries, outside), (Primaries::BT2020, 0));
        let (back, outside) = converted(wide, Space::Srgb);
        assert_eq!(outside, 0);
        for (a, b) in colours.iter().flatten().zip(back.pixels.as_slice().iter().flatten()) {
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
        // BT.2020's own green is far outside of sRGB.
        let green = [0.0, 2.0, 0.0];
        let (narrow, outside) = converted(map(vec![green], Primaries::BT2020), Space::Srgb);
        assert!(warning(outside).is_some_and(|w| w.to_string().starts_with("1 pixels have colours outside")));
        let [r, g, b] = narrow.pixels.at(0, 0);
        assert!(outside == 1 && r >= FLOOR && b >= FLOOR && g > r && g > b);
        let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        assert!((f64::from(luminance) - 2.0 * Primaries::BT2020.luminance()[1]).abs() < 1e-3, "{luminance}");
    }

    #[test]
    fn same_space_is_unchanged_and_a_colour_without_luminance_is_black() {
        let same = map(vec![[0.1, 0.2, 0.3]], Primaries::DISPLAY_P3);
        assert_eq!(converted(same.clone(), Space::DisplayP3), (same, 0));
        assert_eq!(warning(0), None);
        assert_eq!(into_gamut([-1.0, 0.1, 0.1], [0.2, 0.7, 0.1]), ([FLOOR; 3], true));
        assert_eq!(into_gamut([f32::NAN, -1.0, 0.1], [0.2, 0.7, 0.1]), ([FLOOR; 3], true));
    }
}
