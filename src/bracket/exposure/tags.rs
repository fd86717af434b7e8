//! The EXIF tags that give a frame's exposure.
//!
//! In: the EXIF of one file. Out: [`ExposureTags`]. Cost: negligible.
//! Source: EXIF 2.32, section 4.6.5 (tags and their APEX counterparts) and 4.6.5.2 (sensitivities).

use super::{Exposure, positive};
use exif::{Exif, In, Tag, Value};

/// A value and the name of the tag it was read from; `None` where the value is missing.
pub type Tagged = Option<(f64, &'static str)>;

/// The exposure tags of one file. A value that is 0, negative or not a number counts as missing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ExposureTags {
    /// Exposure time in seconds.
    pub time_s: Tagged,
    /// F-number.
    pub f_number: Tagged,
    /// ISO sensitivity.
    pub iso: Tagged,
    /// Whether the time is written as on a shutter dial: 1/60, 13/10, 10/600 (= 1/60), but not 16666667/1000000000.
    pub is_time_printed: bool,
    /// ShutterSpeedValue: -log2 of the exposure time in seconds.
    pub shutter_speed: Option<f64>,
    /// Whether the flash fired.
    pub flash: bool,
}

impl ExposureTags {
    /// Reads the tags; a plain value takes precedence over its APEX counterpart.
    pub fn read(exif: &Exif) -> Self {
        let number = |tag: Tag| exif.get_field(tag, In::PRIMARY).and_then(|f| first_number(&f.value));
        let plain = |tag: Tag| number(tag).and_then(positive);
        // APEX values beyond +-40, a factor of 10^12, are fill patterns and not exposures.
        let apex = |tag: Tag| number(tag).filter(|x| x.abs() <= 40.0);
        let shutter_speed = apex(Tag::ShutterSpeedValue);
        let time_s = plain(Tag::ExposureTime)
            .map(|t| (t, "ExposureTime"))
            .or_else(|| shutter_speed.map(|x| (libm::exp2(-x), "ShutterSpeedValue")));
        let is_time_printed = exif.get_field(Tag::ExposureTime, In::PRIMARY).is_some_and(|f| is_printed(&f.value));
        let f_number = plain(Tag::FNumber).map(|n| (n, "FNumber")).or_else(|| {
            // An ApertureValue of 0 would be f/1, but cameras write 0 for a lens that they cannot read.
            let x = apex(Tag::ApertureValue).and_then(positive)?;
            Some((libm::exp2(x / 2.0), "ApertureValue"))
        });
        let sensitivities = [
            (Tag::PhotographicSensitivity, "PhotographicSensitivity"),
            (Tag::ISOSpeed, "ISOSpeed"),
            (Tag::RecommendedExposureIndex, "RecommendedExposureIndex"),
            (Tag::StandardOutputSensitivity, "StandardOutputSensitivity"),
            (Tag::ExposureIndex, "ExposureIndex"),
        ];
        // PhotographicSensitivity is 65535 where the sensitivity does not fit into it (EXIF 2.3). Another tag then
        // contains the sensitivity.
        let is_overflow = |tag: Tag, s: f64| tag == Tag::PhotographicSensitivity && s == 65535.0;
        let iso = sensitivities
            .into_iter()
            .find_map(|(tag, name)| Some((plain(tag).filter(|&s| !is_overflow(tag, s))?, name)));
        // Bit 0 of Flash (EXIF 2.32): the flash fired.
        let flash = number(Tag::Flash).is_some_and(|flash| flash as u32 & 1 == 1);
        ExposureTags { time_s, f_number, iso, is_time_printed, shutter_speed, flash }
    }

    /// Returns the relative exposure in EV according to these tags alone, as written. `None` without a time; other
    /// missing values count as a factor of 1.
    pub fn ev(&self) -> Option<f64> {
        let value = |tagged: Tagged| tagged.map(|(value, _)| value);
        let exposure = Exposure::from_camera(value(self.time_s)?, value(self.f_number), value(self.iso), String::new());
        exposure.map(|exposure| exposure.ev())
    }
}

/// Largest denominator of a dial marking: 1/16000 s may be written as 10/160000. Measured times have denominators of a
/// million and more.
const MAX_PRINTED_DENOMINATOR: u32 = 160_000;

/// Whether a rational is a dial marking: it has few digits, and in lowest terms it is a whole number, one over a whole
/// number, or a number of tenths or its inverse.
fn is_printed(value: &Value) -> bool {
    let Value::Rational(v) = value else { return false };
    let Some(r) = v.first().filter(|r| r.num > 0 && r.denom > 0) else { return false };
    let (mut a, mut b) = (r.num, r.denom);
    while b > 0 {
        (a, b) = (b, a % b);
    }
    let (num, denom) = (r.num / a, r.denom / a);
    // The last condition accepts 1/1.3 s, which is 10/13, and 1/2.5 s, which is 2/5.
    r.denom <= MAX_PRINTED_DENOMINATOR && (num == 1 || denom == 1 || 10 % denom == 0 || 10 % num == 0)
}

/// Returns the first number of a field of any numeric type; `None` where it is not finite.
pub(in crate::bracket) fn first_number(value: &Value) -> Option<f64> {
    match value {
        Value::Rational(v) => v.first().map(|r| r.to_f64()),
        Value::SRational(v) => v.first().map(|r| r.to_f64()),
        Value::Float(v) => v.first().map(|&x| f64::from(x)),
        Value::Double(v) => v.first().copied(),
        Value::SShort(v) => v.first().map(|&x| f64::from(x)),
        Value::SLong(v) => v.first().map(|&x| f64::from(x)),
        other => other.get_uint(0).map(f64::from),
    }
    .filter(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use exif::experimental::Writer;
    use exif::{Field, Rational, SRational};

    /// Returns the tags that are read from an EXIF block of `fields`.
    fn read(fields: &[(Tag, Value)]) -> ExposureTags {
        let fields: Vec<Field> =
            fields.iter().map(|(tag, value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() }).collect();
        let mut writer = Writer::new();
        fields.iter().for_each(|f| writer.push_field(f));
        let mut bytes = std::io::Cursor::new(Vec::new());
        writer.write(&mut bytes, false).unwrap();
        ExposureTags::read(&exif::Reader::new().read_raw(bytes.into_inner()).unwrap())
    }

    fn ratio(num: u32, denom: u32) -> Value {
        Value::Rational(vec![Rational { num, denom }])
    }

    fn signed(num: i32, denom: i32) -> Value {
        Value::SRational(vec![SRational { num, denom }])
    }

    #[test]
    fn the_time_is_exposure_time_else_shutter_speed() {
        let speed = (Tag::ShutterSpeedValue, signed(-3, 1));
        assert_eq!(
            read(&[(Tag::ExposureTime, ratio(1, 60)), speed.clone()]).time_s,
            Some((1.0 / 60.0, "ExposureTime"))
        );
        for missing in [ratio(0, 1), ratio(1, 0), ratio(0, 0)] {
            let tags = read(&[(Tag::ExposureTime, missing), speed.clone()]);
            assert_eq!(tags.time_s, Some((8.0, "ShutterSpeedValue")));
        }
        assert_eq!(read(&[(Tag::ShutterSpeedValue, signed(i32::MIN, 1))]).time_s, None);
        assert_eq!(read(&[(Tag::ExposureTime, ratio(0, 0))]).time_s, None);
    }

    #[test]
    fn the_f_number_is_f_number_else_aperture() {
        let aperture = (Tag::ApertureValue, ratio(6, 1));
        assert_eq!(read(&[(Tag::FNumber, ratio(28, 10)), aperture.clone()]).f_number, Some((2.8, "FNumber")));
        assert_eq!(read(&[(Tag::FNumber, ratio(0, 1)), aperture]).f_number, Some((8.0, "ApertureValue")));
        assert_eq!(read(&[(Tag::ApertureValue, ratio(0, 1))]).f_number, None);
    }

    #[test]
    fn the_iso_is_the_first_that_is_usable() {
        let all = [
            (Tag::PhotographicSensitivity, Value::Short(vec![400]), 400.0, "PhotographicSensitivity"),
            (Tag::ISOSpeed, Value::Long(vec![102_400]), 102_400.0, "ISOSpeed"),
            (Tag::RecommendedExposureIndex, Value::Long(vec![204_800]), 204_800.0, "RecommendedExposureIndex"),
            (Tag::StandardOutputSensitivity, Value::Long(vec![51_200]), 51_200.0, "StandardOutputSensitivity"),
            (Tag::ExposureIndex, ratio(160, 1), 160.0, "ExposureIndex"),
        ];
        for first in 0..all.len() {
            let mut fields: Vec<_> = all[first..].iter().map(|(t, v, ..)| (*t, v.clone())).collect();
            assert_eq!(read(&fields).iso, Some((all[first].2, all[first].3)));
            if first > 0 {
                fields.push((Tag::PhotographicSensitivity, Value::Short(vec![65535])));
                assert_eq!(read(&fields).iso, Some((all[first].2, all[first].3)), "65535 means overflow");
            }
        }
        assert_eq!(read(&[(Tag::PhotographicSensitivity, Value::Short(vec![0]))]).iso, None);
    }

    #[test]
    fn printed_times_are_distinguished_from_measured_ones_by_their_form() {
        let printed = |num, denom| read(&[(Tag::ExposureTime, ratio(num, denom))]).is_time_printed;
        assert!(
            [(1, 60), (10, 600), (13, 10), (30, 1), (10, 13), (2, 5), (1, 8000)].map(|(n, d)| printed(n, d))
                == [true; 7]
        );
        assert!(
            [(16_666_667, 1_000_000_000), (8333, 1_000_000), (8_000_000, 1_000_000_000), (17, 1000), (0, 1)]
                .map(|(n, d)| printed(n, d))
                == [false; 5]
        );
    }
}
