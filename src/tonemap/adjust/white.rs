//! White balance: the light that is shown as white.
//!
//! In: the option. Out: a [`Light`] and its chromaticity. Cost: negligible. Source: CIE 15:2018, section 4.1.2
//! (daylight); Krystek, "An algorithm to calculate correlated colour temperature" (1985), equations 1 and 2 (black
//! bodies); ANSI/IES TM-30-20, annex B (black bodies below 4000 K, daylight above 5000 K, a mixture between); Adobe,
//! DNG SDK 1.7 (the unit of the tint).

use crate::error::{Error, Result};
use std::fmt;
use std::str::FromStr;

/// The light that is shown as white.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum WhiteBalance {
    /// As the photographs show it.
    #[default]
    AsShot,
    /// Estimated from the picture.
    Auto,
    /// Light of this colour.
    Light(Light),
    /// The light in which the surroundings of this pixel are grey: x and y in the picture before resizing.
    Spot(usize, usize),
}

/// The colour of a light as it appears in the photographs. If the camera's white balance was right, this is 6504 K
/// (D65) for any real light.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Light {
    /// Correlated colour temperature in kelvins.
    pub kelvin: f64,
    /// How much greener the light is than daylight or a black body of the same temperature: 3000 times the distance in
    /// CIE 1960 uv. White balance makes the picture more magenta by the same amount.
    pub tint: f64,
}

/// Range of temperatures in kelvins: from candle light to the bluest sky.
pub const KELVINS: (f64, f64) = (2000.0, 25000.0);
/// Range of tints, as in raw converters: a distance of 0.05 in uv, beyond which the correlated colour temperature is
/// not meaningful.
pub const TINTS: (f64, f64) = (-150.0, 150.0);
/// Number of tint units per unit of uv, as in the DNG SDK and the raw converters built on it.
const TINTS_PER_UV: f64 = 3000.0;
/// The white point of displays.
pub(super) const D65: Light = Light { kelvin: 6504.0, tint: 0.0 };
/// The CIE 1931 xy chromaticity of D65, as rounded by the sRGB standard.
const D65_XY: [f64; 2] = [0.3127, 0.3290];

impl Light {
    /// Whether this is the white point of displays, so that nothing has to be balanced.
    pub fn is_white(self) -> bool {
        self == D65
    }

    /// Rounds to numbers that are easy to type: whole kelvins, tenths of a tint. The difference is not visible.
    pub(super) fn rounded(self) -> Light {
        Light { kelvin: self.kelvin.round(), tint: (10.0 * self.tint).round() / 10.0 }
    }

    /// Returns the CIE 1931 xy chromaticity, in colours whose white is D65.
    pub fn xy(self) -> [f64; 2] {
        xy(self.uv())
    }

    /// Returns the CIE 1960 uv chromaticity.
    fn uv(self) -> [f64; 2] {
        let ([u, v], [du, dv]) = (locus(self.kelvin), green(self.kelvin));
        // At 6504 K the daylight formula differs from sRGB's white by 6e-5 (in uv). This difference is subtracted at
        // all temperatures.
        let ([u65, v65], at65) = (uv(D65_XY), locus(D65.kelvin));
        let by = self.tint / TINTS_PER_UV;
        [u + by * du + (u65 - at65[0]), v + by * dv + (v65 - at65[1])]
    }

    /// Returns the light with this xy chromaticity. Its temperature is that of the nearest point of the locus (of
    /// daylight and black bodies). `None` when the chromaticity is too far from the locus.
    pub fn of_xy(chromaticity: [f64; 2]) -> Option<Light> {
        let [u, v] = uv(chromaticity);
        // The search is in mireds (1e6 / K), because equal steps of reciprocal temperature look alike.
        let ends = (1e6 / KELVINS.1, 1e6 / KELVINS.0);
        let away = |mired: f64| {
            let at = Light { kelvin: 1e6 / mired, tint: 0.0 }.uv();
            libm::hypot(u - at[0], v - at[1])
        };
        let count = (ends.1 - ends.0) as usize;
        let nearest = (0..=count).map(|i| ends.0 + i as f64).min_by(|a, b| away(*a).total_cmp(&away(*b)))?;
        let (mut low, mut high) = ((nearest - 1.0).max(ends.0), (nearest + 1.0).min(ends.1));
        for _ in 0..60 {
            let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
            if away(a) < away(b) {
                high = b;
            } else {
                low = a;
            }
        }
        let mired = 0.5 * (low + high);
        let kelvin = 1e6 / mired;
        let ([du, dv], at) = (green(kelvin), Light { kelvin, tint: 0.0 }.uv());
        let tint = TINTS_PER_UV * ((u - at[0]) * du + (v - at[1]) * dv);
        let beside = TINTS_PER_UV * ((u - at[0]) * dv - (v - at[1]) * du).abs();
        // Beyond the ends of the range, the direction to the nearest temperature is not perpendicular to the locus.
        ((TINTS.0..=TINTS.1).contains(&tint) && beside < BESIDE).then_some(Light { kelvin, tint })
    }

    /// Checks that temperature and tint are in range.
    ///
    /// # Errors
    /// [`Error::Option`] when temperature or tint is out of range.
    pub(super) fn validate(self) -> Result<()> {
        self.out_of_range().map_or(Ok(()), |reason| Err(Error::Option { option: OPTION, reason }))
    }

    /// Returns why temperature or tint is not usable; `None` when both are in range.
    fn out_of_range(self) -> Option<String> {
        if !(KELVINS.0..=KELVINS.1).contains(&self.kelvin) {
            return Some(format!("{} K is outside of {} to {} K; {FORMS}", self.kelvin, KELVINS.0, KELVINS.1));
        }
        let is_tint = (TINTS.0..=TINTS.1).contains(&self.tint);
        (!is_tint).then(|| format!("a tint of {} is outside of {} to {}; {FORMS}", self.tint, TINTS.0, TINTS.1))
    }
}

/// The command line option.
pub(super) const OPTION: &str = "--white-balance";
/// The accepted forms of the option, for messages.
const FORMS: &str = "give `auto`, `as-shot`, a temperature as in `5500` or `5500K`, with a tint as in `5500,10`, or a grey spot of the picture as in `1200,800` \
                     (`spot:2100,90` if the numbers could also be a temperature and a tint)";
/// A colour should be on the line that is perpendicular to the locus at its temperature. This is the largest accepted
/// distance from this line, in units of the tint. Larger distances occur beyond the ends of the range of temperatures.
const BESIDE: f64 = 1.0;

/// Returns the CIE 1960 uv of daylight and black bodies of temperature `t`, in kelvins.
fn locus(t: f64) -> [f64; 2] {
    let daylight = 0.001 * (t - 4000.0).clamp(0.0, 1000.0);
    let ([a, b], [c, d]) = (black_body(t.min(5000.0)), self::daylight(t.max(4000.0)));
    [a + daylight * (c - a), b + daylight * (d - b)]
}

/// Returns the uv of a black body by Krystek's rational approximations, exact to 1e-4 from 1000 to 15000 K.
fn black_body(t: f64) -> [f64; 2] {
    let u = (0.860_117_757 + t * (1.541_182_54e-4 + t * 1.286_412_12e-7))
        / (1.0 + t * (8.424_202_35e-4 + t * 7.081_451_63e-7));
    let v = (0.317_398_726 + t * (4.228_062_45e-5 + t * 4.204_816_91e-8))
        / (1.0 + t * (-2.897_418_16e-5 + t * 1.614_560_53e-7));
    [u, v]
}

/// Returns the uv of daylight by CIE 15, equations 4.5 to 4.7, from 4000 to 25000 K.
fn daylight(t: f64) -> [f64; 2] {
    let x = if t <= 7000.0 {
        0.244_063 + (0.099_11e3 + (2.9678e6 - 4.6070e9 / t) / t) / t
    } else {
        0.237_040 + (0.247_48e3 + (1.9018e6 - 2.0064e9 / t) / t) / t
    };
    uv([x, x * (2.870 - 3.0 * x) - 0.275])
}

/// Returns the unit vector perpendicular to the locus at `t`, towards green.
fn green(t: f64) -> [f64; 2] {
    // The direction of the locus is the difference of two points, a millionth of the temperature above and below `t`.
    let (a, b) = (locus(t * (1.0 - 1e-6)), locus(t * (1.0 + 1e-6)));
    let (du, dv) = (b[0] - a[0], b[1] - a[1]);
    let length = libm::hypot(du, dv);
    // Along the locus u decreases from red to blue.
    [dv / length, -du / length]
}

fn uv([x, y]: [f64; 2]) -> [f64; 2] {
    let scale = 3.0 - 2.0 * x + 12.0 * y;
    [4.0 * x / scale, 6.0 * y / scale]
}

fn xy([u, v]: [f64; 2]) -> [f64; 2] {
    let scale = 4.0 + 2.0 * u - 8.0 * v;
    [3.0 * u / scale, 2.0 * v / scale]
}

impl FromStr for WhiteBalance {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<WhiteBalance, String> {
        match text {
            "auto" => return Ok(WhiteBalance::Auto),
            "as-shot" => return Ok(WhiteBalance::AsShot),
            _ => {}
        }
        let wrong = || format!("{text:?} is not a white balance; {FORMS}");
        if let Some(spot) = text.strip_prefix("spot:") {
            let at = spot.split_once(',').and_then(|(x, y)| Some((x.trim().parse().ok()?, y.trim().parse().ok()?)));
            return at.map(|(x, y)| WhiteBalance::Spot(x, y)).ok_or_else(wrong);
        }
        let upper = text.to_uppercase();
        let numbers = upper.replacen('K', "", 1);
        let mut numbers = numbers.splitn(2, ',').map(|number| number.trim().parse::<f64>().map_err(|_| wrong()));
        let kelvin = numbers.next().unwrap_or_else(|| Err(wrong()))?;
        let tint = numbers.next().transpose()?;
        let has_unit = upper.split(',').next().is_some_and(|first| first.trim().ends_with('K'));
        let light = Light { kelvin, tint: tint.unwrap_or(0.0) };
        let reason = light.out_of_range();
        // Two numbers may be a light or a pixel; they are a light if they can be.
        if let Some(y) = tint.filter(|_| !has_unit && reason.is_some()) {
            let is_pixel = [kelvin, y].iter().all(|v| *v >= 0.0 && v.fract() == 0.0 && *v < 1e9);
            return if is_pixel { Ok(WhiteBalance::Spot(kelvin as usize, y as usize)) } else { Err(wrong()) };
        }
        if !has_unit && upper.contains('K') {
            return Err(wrong());
        }
        reason.map_or(Ok(WhiteBalance::Light(light)), Err)
    }
}

impl fmt::Display for WhiteBalance {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            WhiteBalance::AsShot => f.write_str("as-shot"),
            WhiteBalance::Auto => f.write_str("auto"),
            WhiteBalance::Light(light) => light.fmt(f),
            WhiteBalance::Spot(x, y) => write!(f, "spot:{x},{y}"),
        }
    }
}

impl serde::Serialize for WhiteBalance {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl fmt::Display for Light {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}K", self.kelvin)?;
        if self.tint == 0.0 { Ok(()) } else { write!(f, ",{}", self.tint) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CIE 15, tables of daylight and of black bodies: A (2856 K) is a black body, D50 (5003 K) and D75 (7504 K) are
    /// daylight.
    #[test]
    fn lights_have_the_published_chromaticities() {
        for (kelvin, x, y) in [
            (2856.0, 0.44758, 0.40745),
            (5003.0, 0.34567, 0.35851),
            (6504.0, 0.3127, 0.3290),
            (7504.0, 0.29902, 0.31485),
            (2000.0, 0.52669, 0.41331),
        ] {
            let [a, b] = Light { kelvin, tint: 0.0 }.xy();
            assert!((a - x).abs() < 4e-4 && (b - y).abs() < 4e-4, "{kelvin}: {a} {b}");
        }
        // D65 is exact to the digits of the standard.
        let [x, y] = D65.xy();
        assert!((x - 0.3127).abs() < 1e-12 && (y - 0.3290).abs() < 1e-12 && D65.is_white());
    }

    #[test]
    fn light_of_a_colour_is_the_light_that_has_it() {
        for kelvin in [2100.0, 2856.0, 4000.0, 4321.0, 5000.0, 6504.0, 12_000.0, 24_000.0] {
            for tint in [-140.0, -20.0, 0.0, 7.5, 140.0] {
                let light = Light { kelvin, tint };
                let found = Light::of_xy(light.xy()).unwrap();
                let [a, b] = [light.xy(), found.xy()];
                assert!((a[0] - b[0]).abs() < 1e-6 && (a[1] - b[1]).abs() < 1e-6, "{light} {found}");
            }
            let near = Light { kelvin, tint: 20.0 };
            let found = Light::of_xy(near.xy()).unwrap();
            // The locus has corners where the mixture of black body and daylight begins and ends. At a corner there is
            // more than one perpendicular.
            assert!((found.kelvin / kelvin - 1.0).abs() < 6e-3 && (found.tint - 20.0).abs() < 0.2, "{near} {found}");
        }
        // sRGB's red, green and blue have no temperature.
        for colour in [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]] {
            assert_eq!(Light::of_xy(colour), None);
        }
    }

    #[test]
    fn warmer_is_of_a_lower_temperature_and_greener_of_a_higher_tint() {
        let xy = |kelvin: f64, tint: f64| Light { kelvin, tint }.xy();
        let mut kelvin = KELVINS.0;
        while kelvin < KELVINS.1 {
            assert!(xy(kelvin, 0.0)[0] > xy(kelvin * 1.01, 0.0)[0], "{kelvin}");
            assert!(xy(kelvin, 10.0)[1] > xy(kelvin, 0.0)[1], "{kelvin}");
            kelvin *= 1.01;
        }
    }

    #[test]
    fn white_is_typed_as_a_light_or_a_pixel() {
        let light = |kelvin, tint| WhiteBalance::Light(Light { kelvin, tint });
        for (text, expected) in [
            ("auto", WhiteBalance::Auto),
            ("as-shot", WhiteBalance::AsShot),
            ("5500", light(5500.0, 0.0)),
            ("5500K", light(5500.0, 0.0)),
            ("5500k,+10", light(5500.0, 10.0)),
            ("3200K, -7.5", light(3200.0, -7.5)),
            ("5500,10", light(5500.0, 10.0)),
            ("spot:1200,800", WhiteBalance::Spot(1200, 800)),
            // Temperature or tint out of range.
            ("1200,100", WhiteBalance::Spot(1200, 100)),
            ("2400, 800", WhiteBalance::Spot(2400, 800)),
            ("spot:2400,100", WhiteBalance::Spot(2400, 100)),
        ] {
            assert_eq!(text.parse(), Ok(expected), "{text}");
            assert_eq!(expected.to_string().parse(), Ok(expected), "{text}");
        }
        for (text, said) in [
            ("daylight", "`as-shot`"),
            ("5500,-400", "`spot:"),
            ("1200.5,800", "`1200,800`"),
            ("1200K", "outside of 2000 to 25000 K"),
            ("nanK", "outside of 2000"),
            ("5500K,400", "a tint of 400"),
            ("5500,10K", "spot:"),
            ("spot:-1,5", "1200,800"),
            ("K", "not a white balance"),
            ("", "not a white balance"),
        ] {
            let error = text.parse::<WhiteBalance>().unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
