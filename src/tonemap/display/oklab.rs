//! OkLab, Björn Ottosson's perceptual colour space, in which desaturation along a straight line keeps the hue.
//!
//! In: linear sRGB. Out: lightness, a (green to red) and b (blue to yellow); and back. Cost: 8 ns per pixel in scalar
//! code, 2 ns with wide vectors. Source: Ottosson, "A perceptual color space for image processing" (2020), the matrices
//! of 2021-01-25.

use crate::simd::{at_least, at_most};

/// Lightness, 0..=1 on a display, and the colour coordinates a and b.
pub(crate) type Lab = [f32; 3];

const TO_CONES: [[f32; 3]; 3] = [
    [0.412_221_46, 0.536_332_55, 0.051_445_995],
    [0.211_903_5, 0.680_699_5, 0.107_396_96],
    [0.088_302_46, 0.281_718_85, 0.629_978_7],
];
/// For the conversion of cone responses L, M and S to linear sRGB: coefficients of L - M and S - M. Each row of
/// Ottosson's matrix sums to 1, so M has the coefficient 1 and grey stays exactly grey.
const FROM_CONES: [[f32; 2]; 3] =
    [[4.076_741_7, 0.230_969_94], [-1.268_438, -0.341_319_38], [-0.004_196_086_3, 1.707_614_7]];
const TO_LAB: [[f32; 3]; 3] = [
    [0.210_454_26, 0.793_617_8, -0.004_072_047],
    [1.977_998_5, -2.428_592_2, 0.450_593_7],
    [0.025_904_037, 0.782_771_77, -0.808_675_77],
];
const FROM_LAB: [[f32; 3]; 3] =
    [[1.0, 0.396_337_78, 0.215_803_76], [1.0, -0.105_561_346, -0.063_854_17], [1.0, -0.089_484_18, -1.291_485_5]];

#[inline(always)]
fn times(m: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    [
        m[0][0] * v[0] + m[0][1] * v[1] + m[0][2] * v[2],
        m[1][0] * v[0] + m[1][1] * v[1] + m[1][2] * v[2],
        m[2][0] * v[0] + m[2][1] * v[1] + m[2][2] * v[2],
    ]
}

/// Returns the cube root of `value` >= 0, with a relative error below 3e-7.
#[inline(always)]
fn cube_root(value: f32) -> f32 {
    // Dividing the bits by 3 divides the exponent, which gives the root within 6 %. Each of Halley's steps cubes the
    // error or better.
    let mut root = f32::from_bits(value.to_bits() / 3 + 709_921_077);
    for _ in 0..2 {
        let cube = root * root * root;
        root *= (cube + 2.0 * value) / (2.0 * cube + value);
    }
    root
}

/// Returns the OkLab colour of `rgb`; negative cone responses are clamped to 0.
#[inline(always)]
pub(crate) fn from_linear(rgb: [f32; 3]) -> Lab {
    // This is written out because closures over arrays are not always inlined, and code that is not inlined is not
    // vectorised.
    let [l, m, s] = times(&TO_CONES, rgb);
    times(&TO_LAB, [cube_root(at_least(l, 0.0)), cube_root(at_least(m, 0.0)), cube_root(at_least(s, 0.0))])
}

/// Returns the linear sRGB of `lab`; components are below 0 or above 1 outside its gamut.
#[inline(always)]
pub(crate) fn to_linear(lab: Lab) -> [f32; 3] {
    let [l, m, s] = times(&FROM_LAB, lab);
    let (l, m, s) = (l * l * l, m * m * m, s * s * s);
    let (l, s) = (l - m, s - m);
    [
        m + FROM_CONES[0][0] * l + FROM_CONES[0][1] * s,
        m + FROM_CONES[1][0] * l + FROM_CONES[1][1] * s,
        m + FROM_CONES[2][0] * l + FROM_CONES[2][1] * s,
    ]
}

/// Number of bisection steps to find the edge of the gamut. They find it to 1/512 of the chroma, which is less than
/// half an 8-bit code value.
const HALVINGS: usize = 9;

/// Tolerance, in linear light, for rounding errors of the conversion.
const ROUNDING: f32 = 1e-5;

/// Whether `rgb` is in the gamut.
#[inline(always)]
fn is_within([r, g, b]: [f32; 3]) -> bool {
    (at_least(at_least(r, g), b) <= 1.0 + ROUNDING) & (at_most(at_most(r, g), b) >= -ROUNDING)
}

/// How the colours of a block of pixels are shown.
pub(crate) struct Shown<const N: usize> {
    /// Luminance of the scene, positive.
    pub light: [f32; N],
    /// Luminance on the display, 0..=1.
    pub display: [f32; N],
    /// Factor on the chroma that the colour of the scene has at the luminance `display`.
    pub share: [f32; N],
    /// Rotation of hue in radians, from red towards yellow; small.
    pub turn: [f32; N],
}

impl<const N: usize> Shown<N> {
    /// Converts `rgb`, linear sRGB of the scene, in place to the primaries of the display, in 0..=1. Hue is kept, apart
    /// from the rotation `turn`; chroma is reduced where the gamut requires it. `to_display` converts linear sRGB to
    /// the primaries of the display.
    #[inline(always)]
    pub fn colours(&self, [red, green, blue]: &mut [[f32; N]; 3], to_display: impl Fn([f32; 3]) -> [f32; 3]) {
        for i in 0..N {
            let scale = self.display[i] / self.light[i];
            (red[i], green[i], blue[i]) = (red[i] * scale, green[i] * scale, blue[i] * scale);
        }
        let (mut lightness, mut a, mut b) = ([0.0f32; N], [0.0f32; N], [0.0f32; N]);
        for i in 0..N {
            [lightness[i], a[i], b[i]] = from_linear([red[i], green[i], blue[i]]);
        }
        for i in 0..N {
            let (turn, share) = (self.turn[i], self.share[i]);
            // These are the first terms of cosine and sine. They reduce chroma by 0.02 % for a turn of 9 degrees, and
            // by 1.3 % for 25 degrees.
            let keep = share * (1.0 - 0.5 * turn * turn);
            (a[i], b[i]) = (keep * (a[i] - turn * b[i]), keep * (b[i] + turn * a[i]));
            lightness[i] = at_most(lightness[i], 1.0);
        }
        let (mut kept, mut part) = ([0.0f32; N], [1.0f32; N]);
        let mut step = 1.0;
        for _ in 0..=HALVINGS {
            step *= 0.5;
            for i in 0..N {
                let is = is_within(to_display(to_linear([lightness[i], a[i] * part[i], b[i] * part[i]])));
                kept[i] = if is { at_least(kept[i], part[i]) } else { kept[i] };
                part[i] = at_most(if is { part[i] + step } else { part[i] - step }, 1.0);
            }
            // Most blocks are inside the gamut, which the first step finds out.
            if kept.iter().all(|kept| *kept == 1.0) {
                break;
            }
        }
        for i in 0..N {
            let [r, g, b] = to_display(to_linear([lightness[i], a[i] * kept[i], b[i] * kept[i]]));
            red[i] = at_least(at_most(r, 1.0), 0.0);
            green[i] = at_least(at_most(g, 1.0), 0.0);
            blue[i] = at_least(at_most(b, 1.0), 0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White and the primaries of sRGB, as given by Ottosson's page and CSS Color 4.
    #[test]
    fn known_colours_have_the_published_values_and_come_back() {
        for (rgb, lab) in [
            ([1.0, 1.0, 1.0], [1.0, 0.0, 0.0]),
            ([1.0, 0.0, 0.0], [0.627_955, 0.224_863, 0.125_846]),
            ([0.0, 1.0, 0.0], [0.866_440, -0.233_888, 0.179_498]),
            ([0.0, 0.0, 1.0], [0.452_014, -0.032_457, -0.311_528]),
        ] {
            let found = from_linear(rgb);
            assert!(found.iter().zip(lab).all(|(a, b)| (a - b).abs() < 2e-5), "{rgb:?}: {found:?}");
            assert!(to_linear(found).iter().zip(rgb).all(|(a, b)| (a - b).abs() < 1e-5));
        }
        assert!(from_linear([0.0; 3]).iter().all(|v| v.abs() < 1e-6));
    }

    #[test]
    fn cube_roots_are_within_a_few_units_of_the_last_place() {
        for i in -120..60 {
            for part in [1.0, 1.1, 1.37, 1.9] {
                let value = part * libm::exp2f(i as f32 / 2.0);
                let exact = libm::cbrt(f64::from(value));
                assert!((f64::from(cube_root(value)) / exact - 1.0).abs() < 3e-7, "{value}: {}", cube_root(value));
            }
        }
        assert!(cube_root(0.0).abs() < 1e-12);
    }
}
