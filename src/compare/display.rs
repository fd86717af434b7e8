//! Compares display pictures, in code values and in dE.
//!
//! In: two pictures of one size. Out: for each pixel how different it looks, and summary statistics. Cost: 0.6 us for
//! each pixel that differs. Source: see `ciede2000` for dE. The PSNR is over all channels.
//!
//! If the two profiles are equivalent, pixels are equal if and only if their code values are equal. Otherwise the
//! colours that the code values represent are compared. CIELAB is relative to the white of the expected picture. For
//! PU21 (see `pu21`), the display is assumed to have a white of 100 cd/m2 and a black of 0.

use super::ciede2000::{self, Lab};
use super::light::Codes;
use super::pu21::Light;
use super::{ChannelCodes, DisplayDifference, Magnitudes, Measured, Unit, by_bands};
use crate::bracket::colour::Conversion;
use crate::bracket::{Photograph, Samples};
use crate::plane::Plane;
use nalgebra::{Matrix3, Vector3};

/// Assumed luminance of display white, in cd/m2.
const WHITE_CD_M2: f32 = 100.0;
/// Smallest dE that is assigned to pixels whose code values differ, so that they never count as equal.
const LEAST_DE: f64 = 1e-6;
/// If the profiles differ, pixels with a dE below this count as equal, to allow for rounding in profiles.
const ROUNDED_DE: f64 = 0.05;

/// Compares the picture `b` with the picture `a`, both of one size.
pub(super) fn measure(a: &Photograph, b: &Photograph) -> Measured {
    let (left, mut right) = (Codes::of(a), Codes::of(b));
    let by_codes = left.mean_the_same(&right);
    let max = a.samples.max().max(b.samples.max());
    if by_codes {
        right.primaries = left.primaries;
    }
    let (light_a, light_b) = (
        linear(a, &left, None),
        linear(b, &right, Conversion::between(&right.primaries, &left.primaries).filter(|_| !by_codes)),
    );
    let (wide_a, wide_b) = (rescaled(&a.samples, max), rescaled(&b.samples, max));
    let to_lab = to_lab(&left);
    let (width, height) = (a.width, a.height);
    let (plane, tallies) = by_bands((width, height), |tally: &mut Tally, at| {
        let codes = |codes: &[u16]| [codes[3 * at], codes[3 * at + 1], codes[3 * at + 2]];
        let (p, q) = (codes(&wide_a), codes(&wide_b));
        tally.add(p, q);
        if p == q && by_codes {
            return 0.0;
        }
        let lab = |light: &Plane<[f32; 3]>| to_lab(light.as_slice()[at]);
        let de = ciede2000::difference(lab(&light_a), lab(&light_b));
        let de = match by_codes {
            true => de.max(LEAST_DE),
            false if de < ROUNDED_DE => 0.0,
            false => de,
        };
        tally.de += de;
        de as f32
    });
    let total = tallies.iter().fold(Tally::default(), Tally::merged);
    let weights = left.primaries.luminance().map(|w| w as f32);
    let of = |pixels| Light { pixels, scale: WHITE_CD_M2, weights };
    let (light_a, light_b) = (of(&light_a), of(&light_b));
    let pixels = (width * height).max(1) as f64;
    let names = ["red", "green", "blue"];
    let squares = total.squares as f64 / (3.0 * pixels);
    let psnr = (squares > 0.0).then(|| 20.0 * libm::log10(f64::from(max) / squares.sqrt()));
    let display = DisplayDifference {
        channels: [0, 1, 2].map(|c| ChannelCodes {
            channel: names[c],
            max_codes: total.max[c],
            mean_codes: total.sum[c] as f64 / pixels,
        }),
        de_max: plane.as_slice().iter().fold(0.0, |most, v| v.max(most)).into(),
        de_mean: total.de / pixels,
        psnr_db: psnr,
    };
    Measured::new(Magnitudes { plane, unit: Unit::DeltaE }, (&light_a, &light_b), None, Some(display))
}

/// Sums over pixels. Sums of code values are integers, which do not depend on the order of summation; sums of dE are
/// always added in the same order.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    max: [u16; 3],
    sum: [i64; 3],
    squares: u128,
    de: f64,
}

impl Tally {
    fn add(&mut self, p: [u16; 3], q: [u16; 3]) {
        for c in 0..3 {
            let off = i64::from(q[c]) - i64::from(p[c]);
            self.max[c] = self.max[c].max(p[c].abs_diff(q[c]));
            self.sum[c] += off;
            self.squares += u128::from(off.unsigned_abs() * off.unsigned_abs());
        }
    }

    fn merged(self, other: &Tally) -> Tally {
        Tally {
            max: [0, 1, 2].map(|c| self.max[c].max(other.max[c])),
            sum: [0, 1, 2].map(|c| self.sum[c] + other.sum[c]),
            squares: self.squares + other.squares,
            de: self.de + other.de,
        }
    }
}

/// Returns the code values on a scale from 0 to `max`.
fn rescaled(samples: &Samples, max: u16) -> Vec<u16> {
    match samples {
        Samples::Eight(v) if max == u16::MAX => v.iter().map(|&code| u16::from(code) * 257).collect(),
        Samples::Eight(v) => v.iter().map(|&code| code.into()).collect(),
        Samples::Sixteen(v) => v.clone(),
    }
}

/// Returns the picture in linear light from 0 to 1, with `conversion` applied if there is one.
fn linear(photograph: &Photograph, codes: &Codes, conversion: Option<Conversion>) -> Plane<[f32; 3]> {
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

/// Returns the conversion of linear light with the primaries of `codes` to CIELAB, relative to the white of these
/// primaries.
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
    fn differences_are_those_by_hand_and_none_for_equal_pictures() {
        let a = eight(|_| 100);
        let b = eight(|i| if i % 3 == 1 { 104 } else { 100 });
        let found = measure(&a, &b);
        let difference = found.display.unwrap();
        assert_eq!(difference.channels.map(|c| (c.max_codes, c.mean_codes)), [(0, 0.0), (4, 4.0), (0, 0.0)]);
        let expected = 20.0 * libm::log10(255.0 / (16.0f64 / 3.0).sqrt());
        assert!((difference.psnr_db.unwrap() - expected).abs() < 1e-9);
        assert!(
            (difference.de_mean - difference.de_max).abs() < 1e-6 && difference.de_max > 1.0 && difference.de_max < 5.0
        );
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
        let difference = measure(&wide, &wide).display.unwrap();
        assert_eq!((difference.de_max, difference.psnr_db), (0.0, None));
    }
}
