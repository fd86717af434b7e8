//! Linear RGB colour spaces and conversions between them.
//!
//! In: chromaticities. Out: matrices to CIE XYZ and between sets of primaries. Cost: negligible. Source: SMPTE RP
//! 177-1993 (matrix from primaries); Lam 1985 (Bradford's adaptation, as in ICC.1:2022, annex E); the standards named
//! at each set of primaries; interop ids: ASWF Color Interop Forum, "Color Space Encodings" (2024).
//!
//! Chromaticities are rounded to `f32` before use, because no file format stores them more precisely: values read back
//! from a file then give bit-identical results.

mod profile;
mod transfer;

#[doc(hidden)]
pub use profile::{Found, Profile};
#[doc(hidden)]
pub use transfer::{Curve, Transfer};

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use strum::IntoEnumIterator;

/// The CIE 1931 xy chromaticities of red, green, blue and white.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Primaries {
    /// xy of the colour RGB (1, 0, 0).
    pub red: [f64; 2],
    /// xy of the colour RGB (0, 1, 0).
    pub green: [f64; 2],
    /// xy of the colour RGB (0, 0, 1).
    pub blue: [f64; 2],
    /// xy of the colour RGB (1, 1, 1).
    pub white: [f64; 2],
}

/// Chromaticities (xy) of the D65 and D50 whites, rounded as in the standards.
const D65: [f64; 2] = [0.3127, 0.3290];
const D50: [f64; 2] = [0.3457, 0.3585];
/// Chromaticity of the equal-energy white, XYZ (1, 1, 1).
const EQUAL_ENERGY: [f64; 2] = [1.0 / 3.0, 1.0 / 3.0];
/// Bradford's matrix from XYZ to cone responses (ICC.1, annex E).
const BRADFORD: Matrix3<f64> = Matrix3::new(0.8951, 0.2664, -0.1614, -0.7502, 1.7135, 0.0367, 0.0389, -0.0685, 1.0296);

impl Primaries {
    /// ITU-R BT.709 and sRGB, D65.
    pub const SRGB: Primaries = Primaries { red: [0.64, 0.33], green: [0.30, 0.60], blue: [0.15, 0.06], white: D65 };
    /// Display P3, D65.
    pub const DISPLAY_P3: Primaries =
        Primaries { red: [0.680, 0.320], green: [0.265, 0.690], blue: [0.150, 0.060], white: D65 };
    /// Adobe RGB (1998), D65.
    pub const ADOBE_RGB: Primaries =
        Primaries { red: [0.64, 0.33], green: [0.21, 0.71], blue: [0.15, 0.06], white: D65 };
    /// ITU-R BT.2020, D65.
    pub const BT2020: Primaries =
        Primaries { red: [0.708, 0.292], green: [0.170, 0.797], blue: [0.131, 0.046], white: D65 };
    /// ProPhoto RGB (ROMM, ISO 22028-2), D50.
    pub const PROPHOTO: Primaries =
        Primaries { red: [0.7347, 0.2653], green: [0.1596, 0.8404], blue: [0.0366, 0.0001], white: D50 };
    /// ACEScg (AP1; AMPAS S-2014-004), the ACES white.
    pub const ACES_AP1: Primaries =
        Primaries { red: [0.713, 0.293], green: [0.165, 0.830], blue: [0.128, 0.044], white: [0.32168, 0.33767] };

    /// ACES2065-1 (AP0; SMPTE ST 2065-1), the ACES white. It contains every colour; its blue has a negative y.
    pub const ACES_AP0: Primaries =
        Primaries { red: [0.7347, 0.2653], green: [0.0, 1.0], blue: [0.0001, -0.0770], white: [0.32168, 0.33767] };

    /// Whether no coordinate is negative, as required by formats that store chromaticities as unsigned fractions.
    pub fn are_positive(&self) -> bool {
        self.all().iter().all(|v| *v >= 0.0)
    }

    /// Whether every coordinate differs from that of `other` by at most `tolerance`. A tolerance of 0.005 includes the
    /// rounding of profiles and is not visible.
    pub fn is_close(&self, other: &Primaries, tolerance: f64) -> bool {
        self.all().iter().zip(other.all()).all(|(a, b)| (a - b).abs() <= tolerance)
    }

    fn all(&self) -> [f64; 8] {
        let Primaries { red: [rx, ry], green: [gx, gy], blue: [bx, by], white: [wx, wy] } = *self;
        [rx, ry, gx, gy, bx, by, wx, wy]
    }

    /// Returns the standard set within 0.005 of these primaries, if any.
    pub fn nearest_standard(&self) -> Option<Primaries> {
        Space::of(self).map(Space::primaries)
    }

    /// Returns the matrix from linear RGB to XYZ, which maps RGB (1, 1, 1) to the white with luminance 1 (RP 177).
    /// `None` where the primaries span no colour space, for example because they lie on a line.
    pub fn to_xyz(&self) -> Option<Matrix3<f64>> {
        let rounded = |xy: [f64; 2]| xyz(xy.map(|v| f64::from(v as f32)));
        let columns = Matrix3::from_columns(&[self.red, self.green, self.blue].map(rounded));
        let scale = columns.try_inverse()? * rounded(self.white);
        let matrix = columns * Matrix3::from_diagonal(&scale);
        matrix.iter().all(|v| v.is_finite()).then_some(matrix)
    }

    /// Returns the contributions of red, green and blue to luminance: the second row of [`to_xyz`](Self::to_xyz). For
    /// sRGB, and where the primaries span no colour space, these are the rounded weights of BT.709.
    pub fn luminance(&self) -> [f64; 3] {
        match (self.is_close(&Self::SRGB, 1e-6), self.to_xyz()) {
            (false, Some(m)) => [m[(1, 0)], m[(1, 1)], m[(1, 2)]],
            // BT.709's weights, rounded as in BT.709 and in Radiance.
            _ => [0.2126, 0.7152, 0.0722],
        }
    }
}

/// Decodes an sRGB value to linear, both 0..=1 (IEC 61966-2-1:1999, clause 5).
pub fn srgb_to_linear(encoded: f64) -> f64 {
    if encoded <= 0.04045 { encoded / 12.92 } else { libm::pow((encoded + 0.055) / 1.055, 2.4) }
}

/// The inverse of [`srgb_to_linear`]; the input is clamped to 0..=1.
pub fn linear_to_srgb(linear: f64) -> f64 {
    let linear = linear.clamp(0.0, 1.0);
    if linear <= 0.0031308 { 12.92 * linear } else { 1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055 }
}

/// A linear colour space with a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum Space {
    /// ITU-R BT.709 primaries, D65: most programs.
    Srgb,
    /// Display P3, D65: phones and newer computers.
    DisplayP3,
    /// Adobe RGB (1998), D65: print.
    AdobeRgb,
    /// ITU-R BT.2020, D65: HDR video.
    Rec2020,
    /// ProPhoto RGB, D50: photo editing.
    Prophoto,
    /// ACEScg (AP1 primaries, ACES white): visual effects.
    Acescg,
}

impl Space {
    /// Returns the primaries and the white of the space.
    pub fn primaries(self) -> Primaries {
        match self {
            Space::Srgb => Primaries::SRGB,
            Space::DisplayP3 => Primaries::DISPLAY_P3,
            Space::AdobeRgb => Primaries::ADOBE_RGB,
            Space::Rec2020 => Primaries::BT2020,
            Space::Prophoto => Primaries::PROPHOTO,
            Space::Acescg => Primaries::ACES_AP1,
        }
    }

    /// Returns the space whose primaries are within 0.005 of these, if any.
    pub fn of(primaries: &Primaries) -> Option<Space> {
        Space::iter().find(|space| primaries.is_close(&space.primaries(), 0.005))
    }

    /// The `colorInteropID` of the space in OpenEXR; ProPhoto has none.
    pub fn interop_id(self) -> Option<&'static str> {
        match self {
            Space::Srgb => Some("lin_rec709_scene"),
            Space::DisplayP3 => Some("lin_p3d65_scene"),
            Space::AdobeRgb => Some("lin_adobergb_scene"),
            Space::Rec2020 => Some("lin_rec2020_scene"),
            Space::Prophoto => None,
            Space::Acescg => Some("lin_ap1_scene"),
        }
    }
}

/// Conversion of linear RGB between colour spaces: a matrix, by rows.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conversion([[f32; 3]; 3]);

impl Conversion {
    /// Returns the conversion from linear RGB of `from` to linear RGB of `to`. White is mapped to white, by Bradford's
    /// transform where the two whites differ. `None` where `from` or `to` spans no colour space.
    pub fn between(from: &Primaries, to: &Primaries) -> Option<Self> {
        let matrix = to.to_xyz()?.try_inverse()? * adaptation(from.white, to.white)? * from.to_xyz()?;
        Self::of(matrix)
    }

    /// Same as [`between`](Self::between), followed by Bradford's transform from the white `light`, an xy chromaticity,
    /// to the white of `to`.
    pub fn balanced(from: &Primaries, to: &Primaries, light: [f64; 2]) -> Option<Self> {
        let adapted = adaptation(light, to.white)? * adaptation(from.white, to.white)?;
        Self::of(to.to_xyz()?.try_inverse()? * adapted * from.to_xyz()?)
    }

    fn of(matrix: Matrix3<f64>) -> Option<Self> {
        let rows = [0, 1, 2].map(|r| [0, 1, 2].map(|c| matrix[(r, c)] as f32));
        rows.as_flattened().iter().all(|v| v.is_finite()).then_some(Conversion(rows))
    }

    /// Converts the linear RGB colour `c`.
    #[inline(always)]
    pub fn apply(&self, c: [f32; 3]) -> [f32; 3] {
        // Written out because a closure over the rows is not inlined in vectorised loops.
        let [p, q, r] = &self.0;
        [
            p[0] * c[0] + p[1] * c[1] + p[2] * c[2],
            q[0] * c[0] + q[1] * c[1] + q[2] * c[2],
            r[0] * c[0] + r[1] * c[1] + r[2] * c[2],
        ]
    }
}

/// Conversion between linear RGB and the XYZ of formats that store no primaries. Readers of these formats expect that
/// grey has X = Y = Z (Radiance's `ra_xyze`, libtiff's LogLuv), so chromaticities are adapted to the equal-energy white
/// by Bradford's transform. Y is set to the exact luminance before this adaptation, because the adaptation changes the
/// Y of saturated colours by some percent.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeutralXyz {
    to_xyz: Conversion,
    to_rgb: Conversion,
    weights: [f32; 3],
    /// Smallest and largest ratio Y' / Y of all colours within the primaries, where Y is the luminance of a colour, and
    /// Y' its luminance after the adaptation to the equal-energy white.
    keeps: [f32; 2],
}

impl NeutralXyz {
    /// Creates the conversion for RGB of `primaries`, or of sRGB where `primaries` span no colour space.
    pub fn of(primaries: &Primaries) -> Self {
        let settled = |primaries: &Primaries| {
            let matrix = primaries.to_xyz()?;
            let to_xyz = Conversion::of(adaptation(primaries.white, EQUAL_ENERGY)? * matrix)?;
            let to_rgb = Conversion::of(matrix.try_inverse()? * adaptation(EQUAL_ENERGY, primaries.white)?)?;
            Some((to_xyz, to_rgb, primaries.luminance().map(|w| w as f32)))
        };
        let none = Conversion([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let settled = settled(primaries).or_else(|| settled(&Primaries::SRGB));
        let (to_xyz, to_rgb, weights) = settled.unwrap_or((none, none, [0.0, 1.0, 0.0]));
        // The ratio Y' / Y of any colour within the primaries is between the smallest and the largest ratio of red,
        // green and blue.
        let keeps = [0, 1, 2].map(|c| to_xyz.0[1][c] / weights[c]);
        let keeps = [keeps.into_iter().fold(f32::INFINITY, f32::min), keeps.into_iter().fold(0.0, f32::max)];
        NeutralXyz { to_xyz, to_rgb, weights, keeps }
    }

    fn luminance(&self, rgb: [f32; 3]) -> f32 {
        self.weights[0] * rgb[0] + self.weights[1] * rgb[1] + self.weights[2] * rgb[2]
    }

    /// Converts `rgb` to XYZ; components below 0 become 0.
    #[inline]
    pub fn of_rgb(&self, rgb: [f32; 3]) -> [f32; 3] {
        let (xyz, y) = (self.to_xyz.apply(rgb), self.luminance(rgb));
        let keep = y / xyz[1];
        if keep.is_finite() && keep > 0.0 { [xyz[0] * keep, y, xyz[2] * keep].map(|v| v.max(0.0)) } else { [0.0; 3] }
    }

    /// Converts `xyz` to RGB whose luminance is the Y of `xyz`; components may be below 0.
    ///
    /// The matrix gives RGB of another luminance, so they are multiplied by the ratio of Y to that luminance. This
    /// ratio has no bound far outside of the visible chromaticities. So it is clamped to `keeps`, its range within the
    /// primaries, and the luminance that is still missing is added as grey. Small finite XYZ then give small finite
    /// RGB.
    #[inline]
    pub fn to_rgb(&self, xyz: [f32; 3]) -> [f32; 3] {
        let rgb = self.to_rgb.apply(xyz);
        let y = self.luminance(rgb);
        let (keep, [least, most]) = (xyz[1] / y, self.keeps);
        if y > 0.0 && (least..=most).contains(&keep) {
            return rgb.map(|v| v * keep);
        }
        let keep = if y > 0.0 && keep < least { least } else { most };
        let grey = xyz[1] - keep * y;
        rgb.map(|v| v * keep + grey)
    }
}

/// Returns the XYZ of a chromaticity at luminance 1.
fn xyz([x, y]: [f64; 2]) -> Vector3<f64> {
    Vector3::new(x / y, 1.0, (1.0 - x - y) / y)
}

/// Returns Bradford's transform of XYZ from one white to another: cone responses are multiplied by the ratio of the
/// cone responses of the two whites.
fn adaptation(from: [f64; 2], to: [f64; 2]) -> Option<Matrix3<f64>> {
    let cones = |white: [f64; 2]| BRADFORD * xyz(white.map(|v| f64::from(v as f32)));
    let ratio = cones(to).component_div(&cones(from));
    Some(BRADFORD.try_inverse()? * Matrix3::from_diagonal(&ratio) * BRADFORD)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares the matrices with those printed in the standards, to four decimal places.
    #[test]
    fn matrices_to_xyz_are_those_printed() {
        let srgb = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]];
        let rec2020 = [[0.6370, 0.1446, 0.1689], [0.2627, 0.6780, 0.0593], [0.0000, 0.0281, 1.0610]];
        let ap1 = [[0.6625, 0.1340, 0.1562], [0.2722, 0.6741, 0.0537], [-0.0056, 0.0041, 1.0103]];
        for (space, printed) in [(Space::Srgb, srgb), (Space::Rec2020, rec2020), (Space::Acescg, ap1)] {
            let ours = space.primaries().to_xyz().unwrap();
            for (row, values) in printed.iter().enumerate() {
                for (column, value) in values.iter().enumerate() {
                    assert!((ours[(row, column)] - value).abs() < 1e-4, "{space:?} {ours}");
                }
            }
        }
    }

    /// Published values: sRGB to ACEScg by Bradford's transform (colour-science, `RGB_to_RGB`), and the green of Adobe
    /// RGB in sRGB.
    #[test]
    fn conversions_match_published_matrices_and_keep_white() {
        let to = |from: Space, to: Space, c| Conversion::between(&from.primaries(), &to.primaries()).unwrap().apply(c);
        let close = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-4);
        assert!(close(to(Space::Srgb, Space::Acescg, [1.0, 0.0, 0.0]), [0.6131, 0.0702, 0.0206]));
        assert!(close(to(Space::Srgb, Space::Acescg, [0.0, 0.0, 1.0]), [0.0474, 0.0134, 0.8698]));
        assert!(close(to(Space::AdobeRgb, Space::Srgb, [0.0, 1.0, 0.0]), [-0.3984, 1.0, -0.0430]));
        for from in Space::iter() {
            for other in Space::iter() {
                assert!(close(to(from, other, [1.0; 3]), [1.0; 3]), "{from:?} to {other:?}");
                let there = to(from, other, [0.3, 0.9, 0.1]);
                let back = to(other, from, there);
                assert!(close(back, [0.3, 0.9, 0.1]), "{from:?} by {other:?}: {back:?}");
            }
        }
        let flat = Primaries { green: [0.64, 0.33], ..Primaries::SRGB };
        assert_eq!((flat.to_xyz(), Conversion::between(&flat, &Primaries::SRGB)), (None, None));
    }

    #[test]
    fn grey_has_equal_xyz_and_luminance_is_kept() {
        for space in Space::iter() {
            let (neutral, weights) = (NeutralXyz::of(&space.primaries()), space.primaries().luminance());
            assert!(neutral.of_rgb([0.5; 3]).iter().all(|v| (v - 0.5).abs() < 1e-6));
            for rgb in [[0.2, 0.5, 0.7], [1.0, 0.0, 0.0], [0.0, 0.02, 0.3]] {
                let xyz = neutral.of_rgb(rgb);
                let y: f64 = (0..3).map(|c| weights[c] * f64::from(rgb[c])).sum();
                assert!((f64::from(xyz[1]) - y).abs() < 1e-6);
                let back = neutral.to_rgb(xyz);
                // At the edge of the space, Z may be below 0 after the adaptation, and is then set to 0, which causes a
                // larger error.
                let near = if rgb.contains(&0.0) { 0.01 } else { 1e-5 };
                assert!(back.iter().zip(rgb).all(|(a, b)| (a - b).abs() < near), "{space:?} {rgb:?} {back:?}");
            }
            assert_eq!((neutral.of_rgb([0.0; 3]), neutral.to_rgb([0.0; 3])), ([0.0; 3], [0.0; 3]));
        }
    }

    /// If the ratio of the luminances before and after the adaptation were not clamped, XYZ (21, 0.8, 1.1) would become
    /// RGB (916, -357, 41), because its luminance is 0.8 under one white and nearly 0 under the other.
    #[test]
    fn impossible_colours_keep_their_luminance_in_xyz() {
        let (neutral, weights) = (NeutralXyz::of(&Primaries::BT2020), Primaries::BT2020.luminance());
        for x in (0..400).map(|i| 21.0 + 0.005 * i as f32) {
            for xyz in [[x, 0.8, 1.1], [x, 0.0, 0.0], [0.0, 0.01, x], [x, 0.001, x], [0.0, x, 0.0]] {
                let rgb = neutral.to_rgb(xyz);
                let y: f64 = (0..3).map(|c| weights[c] * f64::from(rgb[c])).sum();
                assert!((y - f64::from(xyz[1])).abs() < 1e-4, "{xyz:?} {rgb:?}");
                assert!(rgb.iter().all(|v| v.abs() < 3.0 * x), "{xyz:?} {rgb:?}");
            }
        }
    }

    /// Files store chromaticities as `f32`: primaries that are read back must give a bit-identical conversion.
    #[test]
    fn primaries_rounded_to_32_bit_floats_are_recognised() {
        let float = |xy: [f64; 2]| xy.map(|v| f64::from(v as f32));
        for p in Space::iter().map(Space::primaries) {
            let read =
                Primaries { red: float(p.red), green: float(p.green), blue: float(p.blue), white: float(p.white) };
            assert_eq!(Conversion::between(&p, &Primaries::SRGB), Conversion::between(&read, &Primaries::SRGB));
            assert_eq!(read.nearest_standard(), Some(p));
        }
        assert_eq!(Primaries::SRGB.luminance(), [0.2126, 0.7152, 0.0722]);
        assert!((Primaries::ADOBE_RGB.luminance()[0] - 0.2973).abs() < 1e-4);
    }
}
