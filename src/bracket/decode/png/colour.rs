//! Colour profile of a PNG from its chunks: code points, an ICC profile, or primaries and an exponent.
//!
//! In: the chunks of the header. Out: an ICC profile, or none for sRGB. Cost: negligible. Source: W3C, Portable Network
//! Graphics (third edition): cICP takes precedence over iCCP, iCCP over sRGB, and sRGB over cHRM and
//! gAMA; ITU-T H.273, tables 2 and 3, for the numbers of cICP.

use crate::bracket::colour::{Curve, Primaries, Profile};
use png::{CodingIndependentCodePoints, Info};

/// The gAMA value 1/2.2 stands for the sRGB curve. The tolerance includes 0.45455, 0.4545 and 0.45, which writers use
/// for it.
const SRGB_GAMMA: (f64, f64) = (1.0 / 2.2, 0.005);

/// Returns the ICC profile, or `None` where the chunks mean sRGB; `embedded` is the profile of iCCP. Unsupported values
/// are ignored and added to `notes`.
pub(super) fn profile(info: &Info, embedded: Option<Vec<u8>>, notes: &mut Vec<String>) -> Option<Vec<u8>> {
    if let Some(points) = &info.coding_independent_code_points {
        if let Some((primaries, curve)) = of_code_points(points) {
            return made(primaries, curve, notes);
        }
        let CodingIndependentCodePoints { color_primaries, transfer_function, .. } = points;
        notes.push(format!(
            "the colours of its cICP chunk (primaries {color_primaries}, transfer {transfer_function}) are not supported and were ignored"
        ));
    }
    if embedded.is_some() || info.srgb.is_some() {
        return embedded;
    }
    let primaries = info.chrm_chunk.map_or(Primaries::SRGB, |c| {
        let xy = |(x, y): (png::ScaledFloat, png::ScaledFloat)| [x, y].map(|v| f64::from(v.into_scaled()) / 1e5);
        Primaries { red: xy(c.red), green: xy(c.green), blue: xy(c.blue), white: xy(c.white) }
    });
    // An exponent of 0 is invalid and is ignored.
    let gamma = info.gama_chunk.map(|v| f64::from(v.into_scaled()) / 1e5).filter(|gamma| *gamma > 0.0);
    let is_of_srgb = |gamma: f64| is_srgb(&primaries) && (gamma - SRGB_GAMMA.0).abs() <= SRGB_GAMMA.1;
    let curve = gamma.filter(|gamma| !is_of_srgb(*gamma)).map_or(Curve::Srgb, |gamma| Curve::Power(1.0 / gamma));
    made(primaries, curve, notes)
}

/// Returns the primaries and curve for the H.273 code points used by photographs; `None` for other code points, for
/// limited range, and for pixel values that are not RGB.
fn of_code_points(points: &CodingIndependentCodePoints) -> Option<(Primaries, Curve)> {
    let primaries = match points.color_primaries {
        1 => Primaries::SRGB,
        9 => Primaries::BT2020,
        12 => Primaries::DISPLAY_P3,
        _ => return None,
    };
    let curve = match points.transfer_function {
        1 | 6 | 14 | 15 => Curve::Bt709,
        4 => Curve::Power(2.2),
        5 => Curve::Power(2.8),
        8 => Curve::Power(1.0),
        13 => Curve::Srgb,
        _ => return None,
    };
    (points.is_video_full_range_image && points.matrix_coefficients == 0).then_some((primaries, curve))
}

fn is_srgb(primaries: &Primaries) -> bool {
    primaries.nearest_standard() == Some(Primaries::SRGB)
}

fn made(primaries: Primaries, curve: Curve, notes: &mut Vec<String>) -> Option<Vec<u8>> {
    if curve == Curve::Srgb && is_srgb(&primaries) {
        return None;
    }
    let power = match curve {
        Curve::Srgb => "sRGB curve".to_owned(),
        Curve::Bt709 => "BT.709 curve".to_owned(),
        Curve::Power(power) => format!("gamma {power:.2}"),
    };
    let [red, green, blue] = [primaries.red, primaries.green, primaries.blue].map(|[x, y]| format!("{x:.4} {y:.4}"));
    let profile = Profile::of(&primaries, curve, &format!("PNG: {red}, {green}, {blue}, {power}"));
    if profile.is_none() {
        notes.push("its cHRM chunk defines no colour space and was ignored; sRGB is assumed".to_owned());
    }
    profile.map(|profile| profile.icc)
}
