//! Pictures against pictures, in codes and in dE.
//!
//! In: two pictures of one size. Out: for each pixel how different it looks, and what that sums up to. Cost: 0.6 us a pixel that differs.
//! Source: CIEDE2000 in its file; PSNR over all channels.
//!
//! Where the profiles mean the same, pixels of equal codes are equal, and no others; where they do not, the light that the codes mean
//! counts. CIELAB is under the white of the expected picture. For PU21 a display shows white with 100 cd/m2, and black with none.

use super::ciede2000::{self, Lab};
use super::light::Codes;
use super::pu21::{self, Light};
use super::{ChannelCodes, DisplayDifference, Magnitudes, Measured, Unit, ms_ssim};
use crate::bracket::colour::Conversion;
use crate::bracket::{Photograph, Samples};
use crate::plane::{BAND_ROWS, Plane};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// What white is on the display, in cd/m2.
const WHITE_CD_M2: f32 = 100.0;
/// Pixels whose codes differ are never told as equal.
const LEAST_DE: f64 = 1e-6;
/// ... and those whose codes mean other colours are equal when they look so, within what profiles round.
const ROUNDED_DE: f64 = 0.05;

/// The picture `b` against the picture `a`, both of one size.
pub(super) fn measure(a: &Photograph, b: &Photograph) -> Measured {
    let (left, mut right) = (Codes::of(a), Codes::of(b));
    let by_codes = left.mean_the_same(&right);
    let max = a.samples.max().max(b.samples.max());
    if by_codes {
        right.primaries = left.primaries;
    }
    let (light_a, light_b) = (
        shone(a, &left, None),
        shone(b, &right, Conversion::between(&right.primaries, &left.primaries).filter(|_| !by_codes)),
    );
    let (wide_a, wide_b) = (widened(&a.samples, max), widened(&b.samples, max));
    let to_lab = to_lab(&left);
    let (width, height) = (a.width, a.height);
    let mut plane = Plane::filled(width, height, 0.0);
    let band = (BAND_ROWS * width).max(1);
    let tallies: Vec<Tally> = plane
        .as_mut_slice()
        .par_chunks_mut(band)
        .enumerate()
        .map(|(i, out)| {
            let mut tally = Tally::default();
            for (k, out) in out.iter_mut().enumerate() {
                let at = i * band + k;
                let codes = |wide: &[u16]| [wide[3 * at], wide[3 * at + 1], wide[3 * at + 2]];
                let (p, q) = (codes(&wide_a), codes(&wide_b));
                tally.see(p, q);
                if p != q || !by_codes {
                    let lab = |light: &Plane<[f32; 3]>| to_lab(light.as_slice()[at]);
                    let de = ciede2000::difference(lab(&light_a), lab(&light_b));
                    let de = match by_codes {
                        true => de.max(LEAST_DE),
                        false if de < ROUNDED_DE => 0.0,
                        false => de,
                    };
                    tally.de += de;
                    *out = de as f32;
                }
            }
            tally
        })
        .collect();
    let total = tallies.iter().fold(Tally::default(), Tally::and);
    let weights = left.primaries.luminance().map(|w| w as f32);
    let of = |pixels| Light { pixels, scale: WHITE_CD_M2, weights };
    let (light_a, light_b) = (of(&light_a), of(&light_b));
    let pixels = (width * height).max(1) as f64;
    let names = ["red", "green", "blue"];
    let is_equal = plane.as_slice().iter().all(|v| *v == 0.0);
    let squares = total.squares as f64 / (3.0 * pixels);
    let psnr = (squares > 0.0).then(|| 20.0 * libm::log10(f64::from(max) / squares.sqrt()));
    Measured {
        radiance: None,
        display: Some(DisplayDifference {
            channels: [0, 1, 2].map(|c| ChannelCodes {
                channel: names[c],
                max_codes: total.max[c],
                mean_codes: total.sum[c] as f64 / pixels,
            }),
            de_max: plane.as_slice().iter().fold(0.0, |most, v| v.max(most)).into(),
            de_mean: total.de / pixels,
            psnr_db: psnr,
        }),
        magnitudes: Magnitudes { plane, unit: Unit::DeltaE },
        pu21_psnr_db: if is_equal { None } else { pu21::psnr(&light_a, &light_b) },
        ms_ssim: if is_equal { ms_ssim::of_equals((width, height)) } else { ms_ssim::ms_ssim(&light_a, &light_b) },
    }
}

/// Sums of codes are whole, and the same in any order; those of dE are folded in order.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    max: [u16; 3],
    sum: [i64; 3],
    squares: u128,
    de: f64,
}

impl Tally {
    fn see(&mut self, p: [u16; 3], q: [u16; 3]) {
        for c in 0..3 {
            let off = i64::from(q[c]) - i64::from(p[c]);
            self.max[c] = self.max[c].max(p[c].abs_diff(q[c]));
            self.sum[c] += off;
            self.squares += u128::from(off.unsigned_abs() * off.unsigned_abs());
        }
    }

    fn and(self, other: &Tally) -> Tally {
        Tally {
            max: [0, 1, 2].map(|c| self.max[c].max(other.max[c])),
            sum: [0, 1, 2].map(|c| self.sum[c] + other.sum[c]),
            squares: self.squares + other.squares,
            de: self.de + other.de,
        }
    }
}

/// Codes on the scale to `max`.
fn widened(samples: &Samples, max: u16) -> Vec<u16> {
    match samples {
        Samples::Eight(v) if max == u16::MAX => v.iter().map(|&code| u16::from(code) * 257).collect(),
        Samples::Eight(v) => v.iter().map(|&code| code.into()).collect(),
        Samples::Sixteen(v) => v.clone(),
    }
}

/// Linear light, 0 to 1.
fn shone(photograph: &Photograph, codes: &Codes, conversion: Option<Conversion>) -> Plane<[f32; 3]> {
    let (width, height) = (photograph.width, photograph.height);
    Plane::from_rows(width, height, |y, row| {
        for (x, p) in row.iter_mut().enumerate() {
            let at = 3 * (y * width + x);
            let light = |c: usize| {
                let code = match &photograph.samples {
                    Samples::Eight(v) => usize::from(v[at + c]),
                    Samples::Sixteen(v) => usize::from(v[at + c]),
                };
                codes.curves[c][code]
            };
            let light = [0, 1, 2].map(light);
            *p = conversion.map_or(light, |conversion| conversion.apply(light));
        }
    })
}

/// From linear light to CIELAB under its white.
fn to_lab(codes: &Codes) -> impl Fn([f32; 3]) -> Lab + Sync {
    let matrix = codes.primaries.to_xyz().unwrap_or_else(Matrix3::identity);
    let white = matrix * Vector3::repeat(1.0);
    move |light| {
        let xyz = matrix * Vector3::from(light.map(f64::from));
        Lab::of([0, 1, 2].map(|k| xyz[k] / white[k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Capture;
    use crate::bracket::colour::Profile;

    fn picture(samples: Samples, profile: Option<Profile>) -> Photograph {
        let (width, height) = (32, samples.len() / 96);
        let (time_s, f_number, iso) = (None, None, None);
        Photograph {
            width,
            height,
            samples,
            profile,
            has_alpha: false,
            capture: Capture::default(),
            time_s,
            f_number,
            iso,
        }
    }

    fn eight(code: impl Fn(usize) -> u8) -> Photograph {
        picture(Samples::Eight((0..96 * 24).map(code).collect()), None)
    }

    #[test]
    fn codes_psnr_and_signs_are_with_identity() {
        let a = eight(|_| 100);
        let b = eight(|i| if i % 3 == 1 { 104 } else { 100 });
        let found = measure(&a, &b);
        let told = found.display.unwrap();
        assert_eq!(told.channels.map(|c| (c.max_codes, c.mean_codes)), [(0, 0.0), (4, 4.0), (0, 0.0)]);
        let expected = 20.0 * libm::log10(255.0 / (16.0f64 / 3.0).sqrt());
        assert!((told.psnr_db.unwrap() - expected).abs() < 1e-9);
        assert!((told.de_mean - told.de_max).abs() < 1e-6 && told.de_max > 1.0 && told.de_max < 5.0);
        assert!(found.pu21_psnr_db.unwrap() > 30.0);
        let same = measure(&a, &a);
        assert_eq!((same.pu21_psnr_db, same.ms_ssim, same.display.unwrap().psnr_db), (None, Some(1.0), None));
    }

    #[test]
    fn eight_and_sixteen_bits_of_one_picture_are_equal() {
        let a = eight(|i| (i * 7) as u8);
        let wide = Samples::Sixteen((0..96 * 24).map(|i| u16::from((i * 7) as u8) * 257).collect());
        let same = measure(&a, &picture(wide, None));
        assert!(same.magnitudes.plane.as_slice().iter().all(|v| *v == 0.0));
        let off =
            Samples::Sixteen((0..96 * 24).map(|i| (u16::from((i * 7) as u8) * 257) ^ u16::from(i == 50)).collect());
        let off = measure(&a, &picture(off, None));
        assert_eq!(off.magnitudes.plane.as_slice().iter().filter(|v| **v > 0.0).count(), 1);
    }

    #[test]
    fn the_same_codes_in_another_profile_are_other_colours() {
        let codes: Vec<u8> = (0..96 * 24).map(|i| [200, 60, 40][i % 3]).collect();
        let adobe = Profile::adobe_rgb();
        assert!(adobe.is_some());
        let (plain, wide) = (picture(Samples::Eight(codes.clone()), None), picture(Samples::Eight(codes), adobe));
        let found = measure(&plain, &wide).display.unwrap();
        assert!(found.de_mean > 3.0, "{found:?}");
        // Greys of the one are greys of the other, but for the curve.
        let told = measure(&wide, &wide).display.unwrap();
        assert_eq!((told.de_max, told.psnr_db), (0.0, None));
    }
}
