//! Exposure: how much light a frame was given, and where that is known from.
//!
//! In: the EXIF of all frames, or the user's `-e` list. Out: an [`Exposure`] per frame, and the relative exposure t * ISO / N^2 by
//! which radiance is divided out of the response. Cost: nothing to speak of.
//! Source: EXIF 2.32, section 4.6.5 (tags and their APEX counterparts) and 4.6.5.2 (the sensitivities); ISO 2720 for the relation.

use exif::{Exif, In, Tag, Value};
use serde::Serialize;

/// Where a frame's exposure was had from: the one that won.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExposureSource {
    /// EXIF tags of the file.
    Exif,
    /// The `-e` list of the user.
    Given,
    /// Estimated from the pixels, because the file says nothing or contradicts them.
    Estimated,
}

/// How a frame was exposed.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    /// Shutter time in seconds, if known.
    pub time_s: Option<f64>,
    /// The f-number, if known.
    pub f_number: Option<f64>,
    /// Sensitivity, if known.
    pub iso: Option<f64>,
    relative: f64,
    /// Where the relative exposure is from.
    pub source: ExposureSource,
    /// The tags that won, for the report: `ExposureTime, FNumber, PhotographicSensitivity`, or `-e`; empty where estimated.
    pub tags: String,
}

impl Exposure {
    /// An exposure of `ev` stops over one second at f/1 and ISO 1, as the user gives it; the camera's own numbers are unknown.
    /// `None` where 2^`ev` is no positive, finite number.
    pub fn given(ev: f64) -> Option<Self> {
        Exposure::at(ev, ExposureSource::Given, "-e".into())
    }

    /// An exposure of `ev` stops that was had from the pixels; `None` where 2^`ev` is no positive, finite number.
    pub fn estimated(ev: f64) -> Option<Self> {
        Exposure::at(ev, ExposureSource::Estimated, String::new())
    }

    fn at(ev: f64, source: ExposureSource, tags: String) -> Option<Self> {
        Some(Exposure { time_s: None, f_number: None, iso: None, relative: positive(libm::exp2(ev))?, source, tags })
    }

    /// An exposure as the camera noted it, in seconds; what is `None` counts as a factor of 1, so it must be missing in the
    /// whole bracket. `None` where the relative exposure is no positive, finite number.
    pub fn from_camera(time_s: f64, f_number: Option<f64>, iso: Option<f64>, tags: String) -> Option<Self> {
        let (n, s) = (f_number.unwrap_or(1.0), iso.unwrap_or(1.0));
        Some(Exposure {
            time_s: Some(time_s),
            f_number,
            iso,
            relative: positive(time_s * s / (n * n))?,
            source: ExposureSource::Exif,
            tags,
        })
    }

    /// The relative exposure t * ISO / N^2 (s), or 2^EV where EV was given; positive and finite.
    pub fn relative(&self) -> f64 {
        self.relative
    }

    /// log2 of the relative exposure: stops.
    pub fn ev(&self) -> f64 {
        libm::log2(self.relative)
    }
}

/// A value and the tag it was had from.
pub type Tagged = Option<(f64, &'static str)>;

/// What the EXIF of one file says of its exposure; a value that is 0, negative or no number counts as missing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ExposureTags {
    /// Shutter time in seconds.
    pub time_s: Tagged,
    /// The f-number.
    pub f_number: Tagged,
    /// Sensitivity.
    pub iso: Tagged,
}

impl ExposureTags {
    /// Reads the tags in the order of their worth: the plain number first, then its APEX counterpart.
    pub fn read(exif: &Exif) -> Self {
        let number = |tag: Tag| exif.get_field(tag, In::PRIMARY).and_then(|f| first_number(&f.value));
        let plain = |tag: Tag| number(tag).and_then(positive);
        // APEX values beyond +-40 (10^12) are fill patterns, not exposures.
        let apex = |tag: Tag| number(tag).filter(|x| x.abs() <= 40.0);
        let time_s = plain(Tag::ExposureTime)
            .map(|t| (t, "ExposureTime"))
            .or_else(|| apex(Tag::ShutterSpeedValue).map(|x| (libm::exp2(-x), "ShutterSpeedValue")));
        let f_number = plain(Tag::FNumber).map(|n| (n, "FNumber")).or_else(|| {
            // 0 would be f/1, but is what bodies write for a lens that they cannot read.
            let x = apex(Tag::ApertureValue).and_then(positive)?;
            Some((libm::exp2(x / 2.0), "ApertureValue"))
        });
        // 65535 says "more than fits" (EXIF 2.3, PhotographicSensitivity), and the true value stands in one of the others.
        let iso = plain(Tag::PhotographicSensitivity)
            .filter(|&s| s != 65535.0)
            .map(|s| (s, "PhotographicSensitivity"))
            .or_else(|| plain(Tag::ISOSpeed).map(|s| (s, "ISOSpeed")))
            .or_else(|| plain(Tag::RecommendedExposureIndex).map(|s| (s, "RecommendedExposureIndex")))
            .or_else(|| plain(Tag::StandardOutputSensitivity).map(|s| (s, "StandardOutputSensitivity")))
            .or_else(|| plain(Tag::ExposureIndex).map(|s| (s, "ExposureIndex")));
        ExposureTags { time_s, f_number, iso }
    }
}

/// The exposures of a bracket by its tags, in the same order, `None` where they do not suffice; and, by frame, what was assumed.
///
/// An f-number or an ISO that is missing everywhere is a factor of 1. Where it is missing in some frames only, the others' value is
/// assumed if they have one value; otherwise nothing is assumed, and the frame's exposure is missing.
pub fn by_tags(tags: &[ExposureTags]) -> (Vec<Option<Exposure>>, Vec<(usize, String)>) {
    let f_numbers = common(tags.iter().map(|t| t.f_number));
    let isos = common(tags.iter().map(|t| t.iso));
    let mut assumed = Vec::new();
    let exposures = tags
        .iter()
        .enumerate()
        .map(|(i, t)| {
            let (time, time_tag) = t.time_s?;
            let mut names = vec![time_tag];
            let mut notes = Vec::new();
            let f_number = fill(t.f_number, f_numbers, "f-number", "f/", &mut names, &mut notes)?;
            let iso = fill(t.iso, isos, "ISO", "ISO ", &mut names, &mut notes)?;
            let exposure = Exposure::from_camera(time, f_number, iso, names.join(", "))?;
            assumed.extend(notes.into_iter().map(|note| (i, note)));
            Some(exposure)
        })
        .collect();
    (exposures, assumed)
}

/// What the frames that have a value have in common.
#[derive(Clone, Copy)]
enum Common {
    /// No frame has one.
    Absent,
    /// All that have one have this.
    Value(f64),
    /// They differ.
    Varied,
}

fn common(values: impl Iterator<Item = Tagged>) -> Common {
    values.flatten().fold(Common::Absent, |so_far, (v, _)| match so_far {
        Common::Absent => Common::Value(v),
        // A hundredth: f/5.6 is written as 5.6 and, by APEX, as 5.657.
        Common::Value(first) if (v - first).abs() <= 0.015 * first => so_far,
        _ => Common::Varied,
    })
}

/// The value to use, `Some(None)` for "missing everywhere", or `None` where none can be assumed.
fn fill(
    own: Tagged,
    others: Common,
    what: &str,
    prefix: &str,
    names: &mut Vec<&'static str>,
    notes: &mut Vec<String>,
) -> Option<Option<f64>> {
    match (own, others) {
        (Some((value, tag)), _) => {
            names.push(tag);
            Some(Some(value))
        }
        (None, Common::Absent) => Some(None),
        (None, Common::Value(value)) => {
            notes.push(format!("its EXIF has no {what}; {prefix}{value} is assumed, as in the other frames"));
            Some(Some(value))
        }
        (None, Common::Varied) => None,
    }
}

/// The first number of a field, of whatever numeric kind.
pub(super) fn first_number(value: &Value) -> Option<f64> {
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

fn positive(x: f64) -> Option<f64> {
    (x.is_finite() && x > 0.0).then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use exif::experimental::Writer;
    use exif::{Field, Rational, SRational};

    /// The tags as read back from EXIF bytes that hold `fields`.
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

    fn tags(time: Option<f64>, f: Option<f64>, iso: Option<f64>) -> ExposureTags {
        ExposureTags {
            time_s: time.map(|t| (t, "ExposureTime")),
            f_number: f.map(|n| (n, "FNumber")),
            iso: iso.map(|s| (s, "ISOSpeed")),
        }
    }

    #[test]
    fn relative_exposure_is_time_times_iso_over_n_squared() {
        let (exposures, assumed) = by_tags(&[tags(Some(0.25), Some(4.0), Some(200.0))]);
        let exposure = exposures[0].as_ref().unwrap();
        assert_eq!((exposure.relative(), exposure.tags.as_str()), (3.125, "ExposureTime, FNumber, ISOSpeed"));
        assert!(assumed.is_empty());
        assert_eq!(Exposure::given(-3.0).unwrap().relative(), 0.125);
        assert_eq!(Exposure::given(-3.0).unwrap().ev(), -3.0);
        assert!(Exposure::given(5000.0).is_none() && Exposure::given(f64::NAN).is_none());
    }

    #[test]
    fn a_part_missing_everywhere_is_no_matter() {
        let (exposures, assumed) = by_tags(&[tags(Some(0.5), None, Some(100.0)), tags(Some(1.0), None, Some(100.0))]);
        assert_eq!(exposures[1].as_ref().unwrap().relative(), 100.0);
        assert_eq!(exposures[1].as_ref().unwrap().f_number, None);
        assert!(assumed.is_empty());
    }

    #[test]
    fn a_part_missing_somewhere_is_assumed_where_the_others_agree() {
        let (exposures, assumed) = by_tags(&[tags(Some(0.5), Some(2.0), None), tags(Some(1.0), None, None)]);
        assert_eq!(exposures[1].as_ref().unwrap().relative(), 0.25);
        assert_eq!(assumed.len(), 1);
        assert!(assumed[0].0 == 1 && assumed[0].1.contains("f/2"), "{assumed:?}");

        let (exposures, assumed) =
            by_tags(&[tags(Some(0.5), Some(2.0), None), tags(Some(1.0), Some(4.0), None), tags(Some(1.0), None, None)]);
        assert!(exposures[0].is_some() && exposures[2].is_none() && assumed.is_empty());
    }
}
