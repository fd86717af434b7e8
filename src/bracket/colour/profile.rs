//! ICC profiles embedded in photographs.
//!
//! In: the bytes of an ICC profile. Out: its description, and the chromaticities of its red, green, blue and white
//! where it is an RGB profile with a matrix and curves. Cost: negligible. Source: ICC.1:2022, section 8.3 and annexes E
//! and F: colorants are adapted to D50, by the `chad` tag or else by Bradford's transform.

use super::{BRADFORD, Curve, D50, D65, Primaries};
use nalgebra::{Matrix3, Vector3};

/// XYZ of the D50 white of the profile connection space (ICC.1, 7.2.16).
const PCS_WHITE: Vector3<f64> = Vector3::new(0.9642, 1.0, 0.8249);

/// An ICC profile with its unmodified bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// The profile's bytes.
    pub icc: Vec<u8>,
    /// Description that the profile contains, such as `sRGB IEC61966-2.1`.
    pub description: String,
    /// Primaries of the profile. If they are within rounding of a [standard set](Primaries::nearest_standard), they are
    /// replaced by that set. `None` where the profile uses tables or is inconsistent.
    pub primaries: Option<Primaries>,
}

/// Result of parsing a profile.
#[derive(Debug, Clone, PartialEq)]
pub enum Found {
    /// An RGB profile; its primaries may be unknown.
    Rgb(Profile),
    /// A profile of another colour model, with the name of the model; it does not apply to the decoded RGB.
    Other(&'static str),
    /// An unreadable profile.
    Damaged,
}

impl Profile {
    /// Parses an ICC profile.
    pub fn parse(icc: Vec<u8>) -> Found {
        let Ok(parsed) = moxcms::ColorProfile::new_from_slice(&icc) else { return Found::Damaged };
        match parsed.color_space {
            moxcms::DataColorSpace::Rgb => {
                let description = parsed.description.as_ref().map(text).filter(|d| !d.is_empty());
                let primaries = primaries(&parsed).map(|p| p.nearest_standard().unwrap_or(p));
                // Collinear primaries or a white without luminance are invalid.
                let primaries = primaries.filter(|p| p.to_xyz().is_some());
                Found::Rgb(Profile {
                    icc,
                    description: description.unwrap_or_else(|| "unnamed profile".into()),
                    primaries,
                })
            }
            moxcms::DataColorSpace::Gray => Found::Other("grey"),
            moxcms::DataColorSpace::Cmyk => Found::Other("CMYK"),
            _ => Found::Other("non-RGB"),
        }
    }

    /// Returns the sRGB profile, to be embedded in formats without another way to mark sRGB. The bytes are always the
    /// same.
    pub fn srgb() -> Option<Profile> {
        let mut profile = moxcms::ColorProfile::new_srgb();
        // The cICP tag is removed, because it is meant for video.
        profile.cicp = None;
        // In a display profile, the media white must be the white of the connection space (ICC.1, 9.2.36).
        profile.media_white_point = Some(moxcms::Xyzd { x: PCS_WHITE.x, y: PCS_WHITE.y, z: PCS_WHITE.z });
        Profile::made(profile, D65, 1999)
    }

    /// Returns the Adobe RGB (1998) profile, for cameras that indicate it by EXIF only. The bytes are always the same.
    pub fn adobe_rgb() -> Option<Profile> {
        Profile::made(moxcms::ColorProfile::new_adobe_rgb(), D65, 1998)
    }

    /// Creates an RGB profile with a matrix and a curve; `None` where the primaries span no colour space. The bytes are
    /// always the same.
    pub fn of(primaries: &Primaries, curve: Curve, description: &str) -> Option<Profile> {
        let matrix = from_d50(primaries.white)?.try_inverse()? * primaries.to_xyz()?;
        let colorant = |c: usize| moxcms::Xyzd { x: matrix[(0, c)], y: matrix[(1, c)], z: matrix[(2, c)] };
        let mut profile = moxcms::ColorProfile::new_srgb();
        profile.cicp = None;
        profile.media_white_point = Some(moxcms::Xyzd { x: PCS_WHITE.x, y: PCS_WHITE.y, z: PCS_WHITE.z });
        (profile.red_colorant, profile.green_colorant, profile.blue_colorant) = (colorant(0), colorant(1), colorant(2));
        let curve = Some(curve.parametric());
        (profile.red_trc, profile.green_trc, profile.blue_trc) = (curve.clone(), curve.clone(), curve);
        let words = moxcms::LocalizableString::new("en".into(), "US".into(), description.to_owned());
        profile.description = Some(moxcms::ProfileText::Localizable(vec![words]));
        // The profile is dated 2022, the year of ICC.1:2022, which defines such profiles.
        Profile::made(profile, primaries.white, 2022)
    }

    /// Encodes a profile for `white` with a fixed date in `year`, the year of its standard.
    fn made(mut profile: moxcms::ColorProfile, white: [f64; 2], year: u16) -> Option<Profile> {
        let to_d50 = from_d50(white)?.try_inverse()?;
        let row = |r: usize| [to_d50[(r, 0)], to_d50[(r, 1)], to_d50[(r, 2)]];
        profile.chromatic_adaptation = Some(moxcms::Matrix3d { v: [row(0), row(1), row(2)] });
        let mut icc = profile.encode().ok()?;
        // The encoder always writes the current time; a fixed date replaces it (ICC.1, 7.2.8: six 16-bit numbers).
        let date = [year, 11, 1, 0, 0, 0].map(u16::to_be_bytes);
        icc.get_mut(24..36)?.copy_from_slice(date.as_flattened());
        // The encoder rounds the white of the connection space differently from ICC.1 (7.2.16), which validators
        // report, so the bytes of ICC.1 replace it.
        icc.get_mut(68..80)?.copy_from_slice(b"\0\0\xf6\xd6\0\x01\0\0\0\0\xd3\x2d");
        match Profile::parse(icc) {
            Found::Rgb(profile) => Some(profile),
            _ => None,
        }
    }
}

/// Returns the primaries of the profile; `None` where it uses tables or is inconsistent.
fn primaries(profile: &moxcms::ColorProfile) -> Option<Primaries> {
    let colorant = |c: moxcms::Xyzd| Vector3::new(c.x, c.y, c.z);
    let colorants = [profile.red_colorant, profile.green_colorant, profile.blue_colorant].map(colorant);
    if colorants.iter().any(|c| c.y.abs() < 1e-6 && c.x.abs() < 1e-6 && c.z.abs() < 1e-6) {
        return None;
    }
    let chad = profile.chromatic_adaptation.map(|chad| Matrix3::from_fn(|row, column| chad.v[row][column]));
    // moxcms up to 0.9 writes Bradford's cone matrix in place of the adaptation matrix; such a `chad` is ignored.
    if let Some(to_d50) = chad.filter(|chad| (chad - BRADFORD).amax() > 1e-3) {
        return unadapted(&colorants, to_d50.try_inverse()?);
    }
    let stated = profile.media_white_point.and_then(|w| xy(colorant(w))).unwrap_or(D50);
    if (stated[0] - D50[0]).abs() > 0.005 || (stated[1] - D50[1]).abs() > 0.005 {
        return unadapted(&colorants, from_d50(stated)?);
    }
    // A media white of D50 is ambiguous: it may be the white of the colour space, as in ProPhoto, or D50 only because
    // version 4 of ICC requires it in every profile. D65 is assumed to be the white if the primaries are then those of
    // a known space.
    let d65 = unadapted(&colorants, from_d50(D65)?)?;
    if d65.nearest_standard().is_some() { Some(d65) } else { unadapted(&colorants, Matrix3::identity()) }
}

fn text(description: &moxcms::ProfileText) -> String {
    let text = match description {
        moxcms::ProfileText::PlainString(s) => s.as_str(),
        moxcms::ProfileText::Localizable(all) => {
            let english = all.iter().find(|s| s.language == "en").or(all.first());
            english.map_or("", |s| s.value.as_str())
        }
        moxcms::ProfileText::Description(d) if d.ascii_string.is_empty() => d.unicode_string.as_str(),
        moxcms::ProfileText::Description(d) => d.ascii_string.as_str(),
    };
    text.chars().filter(|c| !c.is_control()).collect::<String>().trim().to_string()
}

/// Undoes the adaptation to D50 of the colorants and of the white.
fn unadapted(colorants: &[Vector3<f64>; 3], from_d50: Matrix3<f64>) -> Option<Primaries> {
    let [red, green, blue] = colorants.map(|c| xy(from_d50 * c));
    Some(Primaries { red: red?, green: green?, blue: blue?, white: xy(from_d50 * PCS_WHITE)? })
}

/// Returns the Bradford transform from D50 to the white of chromaticity `white` (ICC.1, annex E).
fn from_d50(white: [f64; 2]) -> Option<Matrix3<f64>> {
    let cones = |xyz: Vector3<f64>| BRADFORD * xyz;
    if white[1] < 1e-3 {
        return None;
    }
    let target = cones(Vector3::new(white[0] / white[1], 1.0, (1.0 - white[0] - white[1]) / white[1]));
    let source = cones(PCS_WHITE);
    Some(BRADFORD.try_inverse()? * Matrix3::from_diagonal(&target.component_div(&source)) * BRADFORD)
}

fn xy(xyz: Vector3<f64>) -> Option<[f64; 2]> {
    let sum = xyz.sum();
    let xy = [xyz.x / sum, xyz.y / sum];
    xy.iter().all(|v| v.is_finite() && v.abs() < 2.0).then_some(xy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use moxcms::ColorProfile;

    /// Builds a version 2 profile without `chad` from `colorants`, which are adapted to D50, and the media white
    /// `white`.
    fn icc(colorants: [[f64; 3]; 3], white: [f64; 3]) -> Vec<u8> {
        let xyz = |v: [f64; 3]| {
            let numbers = v.iter().flat_map(|x| ((x * 65536.0).round() as i32).to_be_bytes());
            [*b"XYZ ", [0; 4]].concat().into_iter().chain(numbers).collect::<Vec<u8>>()
        };
        let mut tags = vec![(*b"wtpt", xyz(white))];
        tags.extend([*b"rXYZ", *b"gXYZ", *b"bXYZ"].into_iter().zip(colorants.map(xyz)));
        for name in [*b"rTRC", *b"gTRC", *b"bTRC"] {
            tags.push((name, [&b"curv\0\0\0\0\0\0\0\x01\x02\x33\0\0"[..]].concat()));
        }
        let name = b"Made by hand\0";
        let mut desc = [&b"desc\0\0\0\0"[..], &(name.len() as u32).to_be_bytes(), name].concat();
        desc.resize(desc.len() + 78, 0);
        desc.resize(desc.len().next_multiple_of(4), 0);
        tags.push((*b"desc", desc));
        let mut out = vec![0; 128];
        out[8] = 2;
        for (at, signature) in [(12, b"mntr"), (16, b"RGB "), (20, b"XYZ "), (36, b"acsp")] {
            out[at..at + 4].copy_from_slice(signature);
        }
        out.extend((tags.len() as u32).to_be_bytes());
        let mut offset = 132 + 12 * tags.len();
        for (name, data) in &tags {
            out.extend(name);
            out.extend((offset as u32).to_be_bytes());
            out.extend((data.len() as u32).to_be_bytes());
            offset += data.len();
        }
        tags.iter().for_each(|(_, data)| out.extend(data));
        let size = out.len() as u32;
        out[..4].copy_from_slice(&size.to_be_bytes());
        out
    }

    /// XYZ of red, green and blue, adapted to D50, as in the profiles published by HP (sRGB), Adobe (Adobe RGB) and
    /// Kodak (ProPhoto).
    const SRGB_D50: [[f64; 3]; 3] = [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]];
    const ADOBE_D50: [[f64; 3]; 3] = [[0.6097, 0.3111, 0.0195], [0.2053, 0.6257, 0.0609], [0.1492, 0.0632, 0.7446]];
    const PROPHOTO_D50: [[f64; 3]; 3] = [[0.7977, 0.2880, 0.0], [0.1352, 0.7119, 0.0], [0.0313, 0.0001, 0.8249]];
    const WHITE_65: [f64; 3] = [0.9505, 1.0, 1.0891];
    const WHITE_50: [f64; 3] = [0.9642, 1.0, 0.8249];

    fn primaries(icc: Vec<u8>) -> Primaries {
        let Found::Rgb(profile) = Profile::parse(icc) else { panic!("no RGB profile") };
        profile.primaries.expect("primaries")
    }

    #[track_caller]
    fn assert_close(found: Primaries, published: Primaries) {
        assert!(found.is_close(&published, 0.002), "{found:?}\n{published:?}");
    }

    #[test]
    fn version_2_profiles_without_chad() {
        assert_close(primaries(icc(SRGB_D50, WHITE_65)), Primaries::SRGB);
        assert_close(primaries(icc(SRGB_D50, WHITE_50)), Primaries::SRGB);
        assert_close(primaries(icc(ADOBE_D50, WHITE_65)), Primaries::ADOBE_RGB);
        assert_close(primaries(icc(ADOBE_D50, WHITE_50)), Primaries::ADOBE_RGB);
        assert_close(primaries(icc(PROPHOTO_D50, WHITE_50)), Primaries::PROPHOTO);
    }

    /// Adaptation matrix from D65 to D50, as LittleCMS writes it.
    const CHAD: [[f64; 3]; 3] =
        [[1.04788, 0.02292, -0.05022], [0.02959, 0.99048, -0.01707], [-0.00925, 0.01508, 0.75168]];

    #[test]
    fn version_4_profiles_with_chad() {
        for (profile, published) in [
            (ColorProfile::new_srgb(), Primaries::SRGB),
            (ColorProfile::new_display_p3(), Primaries::DISPLAY_P3),
            (ColorProfile::new_adobe_rgb(), Primaries::ADOBE_RGB),
            (ColorProfile::new_bt2020(), Primaries::BT2020),
        ] {
            let mut right = profile.clone();
            right.chromatic_adaptation = Some(moxcms::Matrix3d { v: CHAD });
            right.media_white_point = Some(moxcms::Xyzd { x: 0.9642, y: 1.0, z: 0.8249 });
            assert_close(primaries(right.encode().unwrap()), published);
            // This `chad` tag contains Bradford's cone matrix instead of the adaptation matrix, as moxcms writes it.
            assert_close(primaries(profile.encode().unwrap()), published);
        }
    }

    #[test]
    fn descriptions_are_read_from_either_version() {
        let description = |icc| match Profile::parse(icc) {
            Found::Rgb(profile) => profile.description,
            other => panic!("{other:?}"),
        };
        assert_eq!(description(icc(SRGB_D50, WHITE_65)), "Made by hand");
        assert_eq!(description(ColorProfile::new_srgb().encode().unwrap()), "sRGB IEC61966-2.1");
    }

    #[test]
    fn other_kinds_have_no_primaries() {
        let grey = ColorProfile::new_gray_with_gamma(2.2).encode().unwrap();
        assert_eq!(Profile::parse(grey), Found::Other("grey"));
        assert_eq!(Profile::parse(b"no profile".to_vec()), Found::Damaged);
        for colorants in [[[0.0; 3]; 3], [SRGB_D50[0]; 3], [SRGB_D50[0], SRGB_D50[1], SRGB_D50[1]]] {
            let Found::Rgb(none) = Profile::parse(icc(colorants, WHITE_50)) else { panic!("no RGB profile") };
            assert_eq!(none.primaries, None, "{colorants:?}");
        }
    }

    #[test]
    fn the_srgb_profile_is_the_same_every_time() {
        let profile = Profile::srgb().unwrap();
        assert_eq!(
            profile.icc[24..36],
            [7, 207, 0, 11, 0, 1, 0, 0, 0, 0, 0, 0],
            "November 1999, whatever the clock says"
        );
        assert_close(profile.primaries.unwrap(), Primaries::SRGB);
        assert_eq!(profile.description, "sRGB IEC61966-2.1");
        assert!(profile.icc.len() < 700, "{}", profile.icc.len());
    }

    #[test]
    fn profile_made_from_primaries_contains_them() {
        for primaries in [Primaries::ACES_AP0, Primaries::BT2020, Primaries::PROPHOTO] {
            let profile = Profile::of(&primaries, Curve::Power(1.0), "numbers").unwrap();
            // A profile stores colorants in steps of 1/65536.
            assert!(profile.primaries.unwrap().is_close(&primaries, 2e-4), "{:?}", profile.primaries);
            assert_eq!(profile.description, "numbers");
        }
        let flat = Primaries { green: [0.64, 0.33], ..Primaries::SRGB };
        assert_eq!(Profile::of(&flat, Curve::Srgb, "flat"), None);
    }

    #[test]
    fn the_adobe_rgb_profile_is_the_same_every_time() {
        let profile = Profile::adobe_rgb().unwrap();
        assert_eq!(
            profile.icc[24..36],
            [7, 206, 0, 11, 0, 1, 0, 0, 0, 0, 0, 0],
            "November 1998, whatever the clock says"
        );
        assert_close(profile.primaries.unwrap(), Primaries::ADOBE_RGB);
    }
}
