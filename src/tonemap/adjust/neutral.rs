//! Estimates the light of a scene from the picture, for white balance.
//!
//! In: the overview of a scene, or the pixels around a spot that is known to be grey. Out: the [`Light`] in which the
//! mean of the scene, or the spot, is grey. Cost: 20 ns per cell; for a spot, one pass over the picture. Source:
//! Buchsbaum, "A spatial processor model for object colour perception" (1980): scenes are assumed to be grey on
//! average. Here the average is taken after the tone curve of Reinhard et al. 2002, equation 3. The higher exponents of
//! Finlayson, Trezzi, "Shades of Gray and Colour Constancy" (2004), were tried and rejected: with them a window or a
//! screen in the picture determines the result, instead of the room.

use super::white::{self, Light, OPTION};
use crate::bracket::colour::Primaries;
use crate::error::{Error, Result};
use crate::merge::FLOOR;
use crate::plane::Plane;
use crate::tonemap::display::{LUMINANCE, ToSrgb};
use crate::tonemap::overview::Scene;
use rayon::prelude::*;
use std::ops::Range;

/// Percentiles of luminance: only cells between these two are used. Cells below are too dark to have a reliable colour;
/// cells above are lamps, windows and clipped parts.
const ENDS: (f64, f64) = (0.05, 0.95);
/// The white moves from the white of the photographs towards the mean colour, by this fraction of the way, both in
/// reciprocal temperature and in tint. It does not move the whole way, because the camera has already balanced white
/// and no scene is exactly grey on average. The value was chosen by eye on four photographed brackets, so that lamp
/// light stays warm.
const SHARE: f64 = 0.6;

/// Returns the light to show as white in `scene`; `None` when the mean is not the colour of a light.
pub fn auto(scene: &Scene) -> Option<Light> {
    let [dark, bright] = [ENDS.0, ENDS.1].map(|part| scene.percentile(part) as f32);
    let middle = scene.percentile(0.5) as f32;
    let [r, g, b] = LUMINANCE.map(f64::from);
    let mut sums = [0.0f64; 3];
    for (&log, &[red, blue]) in scene.logs.as_slice().iter().zip(scene.colours.as_slice()) {
        if (dark..=bright).contains(&log) {
            let [red, blue] = [red, blue].map(f64::from);
            let green = ((1.0 - r * red - b * blue) / g).max(0.0);
            // Values are compressed as on a display, because in a mean of radiance a window would dominate.
            let shown = 1.0 / (1.0 + libm::exp2(f64::from(middle - log)));
            sums.iter_mut().zip([red, green, blue]).for_each(|(sum, ratio)| *sum += shown * ratio);
        }
    }
    let found = of_linear(sums)?;
    let mired = |kelvin: f64| 1e6 / kelvin;
    let white = mired(white::D65.kelvin);
    let kelvin = mired(white + SHARE * (mired(found.kelvin) - white));
    Some(Light { kelvin, tint: SHARE * found.tint }.rounded())
}

/// Returns the light with this colour in linear sRGB.
fn of_linear([r, g, b]: [f64; 3]) -> Option<Light> {
    let xyz = Primaries::SRGB.to_xyz()? * nalgebra::Vector3::new(r, g, b);
    let sum = xyz.x + xyz.y + xyz.z;
    (sum > 0.0).then(|| Light::of_xy([xyz.x / sum, xyz.y / sum]))?
}

/// A pixel that is grey according to the user, and the square around it. The square is a hundredth of the longer side
/// wide.
#[derive(Debug, Clone)]
pub struct Spot {
    at: (usize, usize),
    rows: Range<usize>,
    columns: Range<usize>,
    seen: Vec<[f32; 3]>,
    /// The largest value of each channel over the picture.
    most: [f32; 3],
    /// The sum of each channel over the picture.
    sums: [f64; 3],
    pixels: usize,
}

/// Smallest radius of the square in pixels, so that noise is averaged.
const LEAST_REACH: usize = 2;
/// The radius is the longer side divided by this.
const REACHES: usize = 200;

impl Spot {
    /// Creates the spot at the pixel `at` of a picture of `size` pixels.
    ///
    /// # Errors
    /// [`Error::Option`] when the pixel is outside of the picture.
    pub fn new(at: (usize, usize), size: (usize, usize)) -> Result<Self> {
        let ((x, y), (width, height)) = (at, size);
        if x >= width || y >= height {
            return Err(refused(
                at,
                &format!("is outside of the picture, which has {width} x {height} pixels before --resize"),
            ));
        }
        let reach = (width.max(height) / REACHES).max(LEAST_REACH);
        let around = |at: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
        let (rows, columns) = (around(y, height), around(x, width));
        Ok(Spot { at, rows, columns, seen: Vec::new(), most: [0.0; 3], sums: [0.0; 3], pixels: 0 })
    }

    /// Adds the rows `pixels`, the first of which is row `first` of the picture.
    pub fn see(&mut self, first: usize, pixels: &Plane<[f32; 3]>) {
        let rows = self.rows.start.max(first)..self.rows.end.min(first + pixels.height());
        for y in rows {
            self.seen.extend_from_slice(&pixels.row(y - first)[self.columns.clone()]);
        }
        // Each row is summed on its own and the sums are added in order, so that the result does not depend on the
        // number of threads.
        let of_rows: Vec<_> = (0..pixels.height()).into_par_iter().map(|y| measured(pixels.row(y))).collect();
        for (most, sums) in of_rows {
            for c in 0..3 {
                self.most[c] = self.most[c].max(most[c]);
                self.sums[c] += sums[c];
            }
        }
        self.pixels += pixels.as_slice().len();
    }

    /// Returns the light in which the spot is grey, in a picture of `primaries`. Values at or below `black`, and at or
    /// above `white`, carry no colour.
    ///
    /// # Errors
    /// [`Error::Option`] when the spot is black, clipped, or too colourful to be grey in any light.
    pub fn light(&self, primaries: &Primaries, (black, white): (f32, f32)) -> Result<Light> {
        let refused =
            |why: &str| refused(self.at, &format!("{why}; choose a spot that is grey and neither black nor white"));
        let half = self.seen.len() / 2;
        let count = |is: &dyn Fn(&[f32; 3]) -> bool| self.seen.iter().filter(|pixel| is(pixel)).count();
        if count(&|pixel| !pixel.iter().all(|&v| v > black && v.is_finite())) > half {
            return Err(refused("is black in at least one channel, so its colour is not known"));
        }
        // A spot that is clipped in all photographs has the largest radiance of the picture.
        let ends: [f32; 3] = std::array::from_fn(|c| {
            let mean = self.sums[c] / self.pixels.max(1) as f64;
            let is_far = f64::from(self.most[c]) > FAR * mean;
            if is_far { white.min(self.most[c] * PLATEAU) } else { white }
        });
        if count(&|pixel| pixel.iter().zip(ends).any(|(&v, end)| v >= end)) > half {
            return Err(refused("is clipped, and its colour is lost"));
        }
        let to_srgb = ToSrgb::from(primaries);
        let mut sums = [0.0f64; 3];
        for &pixel in self.seen.iter().filter(|pixel| pixel.iter().all(|v| v.is_finite())) {
            let rgb = to_srgb.apply(pixel);
            sums.iter_mut().zip(rgb).for_each(|(sum, v)| *sum += f64::from(v));
        }
        of_linear(sums).map(Light::rounded).ok_or_else(|| refused("is too colourful to be grey in any light"))
    }
}

/// Values above this share of the largest value are treated as equal to the largest, to allow for rounding.
const PLATEAU: f32 = 0.999;
/// The largest value counts as clipped if it is greater than this factor times the mean. Otherwise the picture is
/// nearly uniform, and its largest value is an ordinary surface.
const FAR: f64 = 1.5;

/// Radiance at or below which a value counts as black. It is not 0, because a radiance map has no values below
/// [`FLOOR`].
pub const BLACK_RADIANCE: f32 = 10.0 * FLOOR;

/// Returns the largest value and the sum of each channel of a row.
fn measured(row: &[[f32; 3]]) -> ([f32; 3], [f64; 3]) {
    let (mut most, mut sums) = ([0.0f32; 3], [0.0f64; 3]);
    for pixel in row {
        for c in 0..3 {
            let v = if pixel[c].is_finite() { pixel[c] } else { 0.0 };
            most[c] = most[c].max(v);
            sums[c] += f64::from(v);
        }
    }
    (most, sums)
}

fn refused((x, y): (usize, usize), reason: &str) -> Error {
    Error::Option { option: OPTION, reason: format!("the spot {x},{y} {reason}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tonemap::overview::Overview;

    const SIZE: (usize, usize) = (600, 400);
    /// A lamp of 3200 K, slightly green.
    const LAMP: Light = Light { kelvin: 3200.0, tint: 10.0 };

    /// Returns the linear sRGB of a chromaticity, with luminance 1.
    fn rgb([x, y]: [f64; 2]) -> [f32; 3] {
        let xyz = nalgebra::Vector3::new(x / y, 1.0, (1.0 - x - y) / y);
        let rgb = Primaries::SRGB.to_xyz().unwrap().try_inverse().unwrap() * xyz;
        [rgb.x as f32, rgb.y as f32, rgb.z as f32]
    }

    /// Returns surfaces of many colours and luminances in one light. One corner is black, and a lamp clips in the
    /// opposite corner.
    fn scene(light: Light) -> Plane<[f32; 3]> {
        let lit = rgb(light.xy());
        Plane::from_rows(SIZE.0, SIZE.1, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let of = |k: usize| 0.05 + ((x / 20 * 7 + y / 20 * k) % 23) as f32 / 23.0;
                *p = [of(3) * lit[0], of(5) * lit[1], of(11) * lit[2]];
                if x < 60 && y < 60 {
                    *p = [FLOOR; 3];
                }
                if x > 540 && y > 340 {
                    *p = [30.0, 30.0, 20.0];
                }
            }
        })
    }

    fn spot(picture: &Plane<[f32; 3]>, at: (usize, usize), portion: usize) -> Result<Light> {
        let mut spot = Spot::new(at, (picture.width(), picture.height()))?;
        for first in (0..picture.height()).step_by(portion) {
            let rows = first..(first + portion).min(picture.height());
            spot.see(first, &Plane::from_vec(picture.width(), rows.len(), picture.rows(rows).to_vec()));
        }
        spot.light(&Primaries::SRGB, (BLACK_RADIANCE, f32::INFINITY))
    }

    #[test]
    fn spot_is_grey_in_the_light_that_it_gives() {
        let mut picture = scene(LAMP);
        let card = rgb(LAMP.xy());
        for y in 195..206 {
            // The spot has noise, which must be averaged.
            picture.row_mut(y)[295..306].iter_mut().enumerate().for_each(|(x, p)| {
                *p = card.map(|c| 0.2 * c * if (x + y).is_multiple_of(2) { 1.1 } else { 0.9 });
            });
        }
        for portion in [1, 64, 400] {
            let found = spot(&picture, (300, 200), portion).unwrap();
            assert!((found.kelvin - LAMP.kelvin).abs() < 10.0 && (found.tint - LAMP.tint).abs() < 0.6, "{found}");
            let [r, g, b] = ToSrgb::balanced(&Primaries::SRGB, found.xy()).apply(card);
            assert!((r - g).abs() < 1e-3 && (b - g).abs() < 2e-3, "{r} {g} {b}");
        }
    }

    #[test]
    fn spot_without_colour_is_refused_with_the_reason() {
        let mut picture = scene(LAMP);
        picture.row_mut(300)[290..311].fill([0.0, 0.0, 0.5]);
        for y in 290..311 {
            picture.row_mut(y)[290..311].fill([0.0, 0.5, 0.001]);
        }
        for (at, said) in [
            ((600, 5), "600 x 400 pixels"),
            ((5, 400), "outside"),
            ((30, 30), "black"),
            ((570, 370), "clipped"),
            ((300, 300), "black"),
        ] {
            let error = spot(&picture, at, 64).unwrap_err();
            assert!(error.is_usage() && error.to_string().contains(said), "{at:?}: {error}");
            assert!(error.to_string().starts_with(&format!("--white-balance: the spot {},{} ", at.0, at.1)));
        }
        for y in 290..311 {
            picture.row_mut(y)[290..311].fill([0.01, 0.5, 0.01]);
        }
        let error = spot(&picture, (300, 300), 64).unwrap_err();
        assert!(error.to_string().contains("too colourful"), "{error}");
    }

    #[test]
    fn picture_of_one_grey_is_not_clipped() {
        let grey = Plane::filled(40, 30, rgb(LAMP.xy()));
        let found = spot(&grey, (20, 10), 7).unwrap();
        assert!((found.kelvin - LAMP.kelvin).abs() < 5.0, "{found}");
    }

    /// The scene is grey on average, so the mean colour is the colour of its light, and white moves by `SHARE` of the
    /// way towards it. A lamp that is much brighter than the surfaces does not dominate.
    #[test]
    fn auto_moves_white_partly_to_the_mean_colour() {
        let auto = |light: Light| {
            let mut overview = Overview::new(SIZE, &Primaries::SRGB);
            overview.see(0, &scene(light));
            auto(&overview.scene().unwrap()).unwrap()
        };
        let mired = |light: Light| 1e6 / light.kelvin - 1e6 / 6504.0;
        // In daylight, the mean of the surfaces differs from grey by a few mireds and tints.
        let plain = auto(white::D65);
        assert!(mired(plain).abs() < 6.0 && plain.tint.abs() < 12.0, "{plain}");
        for light in [LAMP, Light { kelvin: 11_000.0, tint: -15.0 }] {
            let found = auto(light);
            let off =
                (mired(found) - mired(plain) - SHARE * mired(light), found.tint - plain.tint - SHARE * light.tint);
            assert!(off.0.abs() < 8.0 && off.1.abs() < 5.0, "{light}: {found}, {off:?}");
        }
    }
}
