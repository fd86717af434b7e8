//! Exposure: how much light a frame was given, and where that is known from.
//!
//! In: the EXIF of all frames, or the user's `-e` list. Out: an [`Exposure`] per frame, and the relative exposure t * ISO / N^2 by
//! which radiance is divided out of the response. Cost: nothing to speak of.
//! Source: EXIF 2.32, section 4.6.5 (tags and their APEX counterparts) and 4.6.5.2 (the sensitivities); ISO 2720 for the relation.

pub(super) mod brightness;
pub(super) mod nominal;

use exif::{Exif, In, Tag, Value};
use nominal::Numbers;
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

/// How the numbers of a file were taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reading {
    /// As they are written.
    AsWritten,
    /// For the exact steps that they were rounded from: 1/30 s for 1/32, f/11 for f/11.31, ISO 250 for 252.
    ExactSteps,
}

/// No camera goes farther, in stops from t * ISO / N^2 = 1 s: from 2^-40 s on, radiance leaves what a half-float holds.
pub const MOST_EV: f64 = 40.0;

/// How a frame was exposed.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    /// Shutter time in seconds, as written, if known.
    pub time_s: Option<f64>,
    /// The f-number, as written, if known.
    pub f_number: Option<f64>,
    /// Sensitivity, as written, if known.
    pub iso: Option<f64>,
    relative: f64,
    correction_stops: f64,
    /// Standard deviation from the nearest exposure that is known, in stops, where this one was estimated.
    pub uncertainty_stops: Option<f64>,
    /// What the numbers were taken for.
    pub reading: Reading,
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

    /// An exposure of `ev` stops that was had from the pixels, with this standard deviation; `None` where 2^`ev` is no positive, finite number.
    pub fn estimated(ev: f64, uncertainty_stops: f64) -> Option<Self> {
        let exposure = Exposure::at(ev, ExposureSource::Estimated, String::new())?;
        Some(Exposure { uncertainty_stops: Some(uncertainty_stops), ..exposure })
    }

    fn at(ev: f64, source: ExposureSource, tags: String) -> Option<Self> {
        Some(Exposure {
            time_s: None,
            f_number: None,
            iso: None,
            relative: positive(libm::exp2(ev))?,
            correction_stops: 0.0,
            uncertainty_stops: None,
            reading: Reading::AsWritten,
            source,
            tags,
        })
    }

    /// An exposure as the camera noted it, in seconds; what is `None` counts as a factor of 1, so it must be missing in the
    /// whole bracket. `None` where the relative exposure is beyond +-[`MOST_EV`]: no camera noted that.
    pub fn from_camera(time_s: f64, f_number: Option<f64>, iso: Option<f64>, tags: String) -> Option<Self> {
        let (n, s) = (f_number.unwrap_or(1.0), iso.unwrap_or(1.0));
        Some(Exposure {
            time_s: Some(time_s),
            f_number,
            iso,
            relative: positive(time_s * s / (n * n)).filter(|relative| libm::log2(*relative).abs() <= MOST_EV)?,
            correction_stops: 0.0,
            uncertainty_stops: None,
            reading: Reading::AsWritten,
            source: ExposureSource::Exif,
            tags,
        })
    }

    /// The same, fine-tuned by so many stops on top of what it was fine-tuned before. A correction that is no finite number, or leaves
    /// none, changes nothing.
    pub fn corrected(&self, stops: f64) -> Self {
        let corrected = positive(self.relative * libm::exp2(stops)).filter(|_| stops.is_finite());
        match corrected {
            Some(relative) => Exposure { relative, correction_stops: self.correction_stops + stops, ..self.clone() },
            None => self.clone(),
        }
    }

    /// Stops by which the relative exposure was corrected from the pixels; it contains them.
    pub fn correction_stops(&self) -> f64 {
        self.correction_stops
    }

    /// The relative exposure t * ISO / N^2 (s), or 2^EV where EV was given, any correction included; positive and finite.
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
    /// Whether the time has the form of a number on a dial: 1/60, 13/10, 10/600, but not 16666667/1000000000.
    pub is_time_printed: bool,
    /// ShutterSpeedValue, in stops under 1 s.
    pub shutter_speed: Option<f64>,
    /// Whether the flash fired.
    pub flash: bool,
}

impl ExposureTags {
    /// Reads the tags in the order of their worth: the plain number first, then its APEX counterpart.
    pub fn read(exif: &Exif) -> Self {
        let number = |tag: Tag| exif.get_field(tag, In::PRIMARY).and_then(|f| first_number(&f.value));
        let plain = |tag: Tag| number(tag).and_then(positive);
        // APEX values beyond +-40 (10^12) are fill patterns, not exposures.
        let apex = |tag: Tag| number(tag).filter(|x| x.abs() <= 40.0);
        let shutter_speed = apex(Tag::ShutterSpeedValue);
        let time_s = plain(Tag::ExposureTime)
            .map(|t| (t, "ExposureTime"))
            .or_else(|| shutter_speed.map(|x| (libm::exp2(-x), "ShutterSpeedValue")));
        let is_time_printed = exif.get_field(Tag::ExposureTime, In::PRIMARY).is_some_and(|f| is_printed(&f.value));
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
        // The lowest bit (EXIF 2.32, Flash).
        let flash = number(Tag::Flash).is_some_and(|flash| flash as u32 & 1 == 1);
        ExposureTags { time_s, f_number, iso, is_time_printed, shutter_speed, flash }
    }

    /// The relative exposure in EV by these tags alone, as written; `None` without a time. What else is missing counts as a factor of 1.
    pub fn ev(&self) -> Option<f64> {
        let value = |tagged: Tagged| tagged.map(|(value, _)| value);
        let exposure = Exposure::from_camera(value(self.time_s)?, value(self.f_number), value(self.iso), String::new());
        exposure.map(|exposure| exposure.ev())
    }

    fn numbers(&self) -> Numbers {
        let value = |tagged: Tagged| tagged.map(|(value, _)| value);
        Numbers {
            time_s: value(self.time_s),
            f_number: value(self.f_number),
            iso: value(self.iso),
            is_time_printed: self.is_time_printed,
            shutter_speed: self.shutter_speed,
        }
    }

    /// The same tags with other numbers.
    fn with(&self, numbers: &Numbers) -> Self {
        let value = |tagged: Tagged, number: Option<f64>| tagged.map(|(value, tag)| (number.unwrap_or(value), tag));
        ExposureTags {
            time_s: value(self.time_s, numbers.time_s),
            f_number: value(self.f_number, numbers.f_number),
            iso: value(self.iso, numbers.iso),
            ..*self
        }
    }
}

/// Whether a rational is one that people write: of few digits, and in lowest terms a whole number, one over one, or tenths.
fn is_printed(value: &Value) -> bool {
    let Value::Rational(v) = value else { return false };
    let Some(r) = v.first().filter(|r| r.num > 0 && r.denom > 0) else { return false };
    let (mut a, mut b) = (r.num, r.denom);
    while b > 0 {
        (a, b) = (b, a % b);
    }
    let (num, denom) = (r.num / a, r.denom / a);
    // 1/1.3 s is 10/13, 1/2.5 s 2/5.
    r.denom <= MOST_PRINTED && (num == 1 || denom == 1 || 10 % denom == 0 || 10 % num == 0)
}

/// Greatest denominator that is written for people, 1/16000 s in tenths; those who measure write a million and more.
const MOST_PRINTED: u32 = 160_000;

/// The exposures of a bracket by its tags, in the same order, `None` where they do not suffice; and, by frame, what was assumed.
///
/// Printed numbers count as the exact steps that they stand for, where the whole bracket has them.
/// An f-number or an ISO that is missing everywhere is a factor of 1. Where it is missing in some frames only, the others' value is
/// assumed if they have one value; otherwise nothing is assumed, and the frame's exposure is missing.
pub fn by_tags(tags: &[ExposureTags]) -> (Vec<Option<Exposure>>, Vec<(usize, String)>) {
    let (mut exposures, assumed) = as_written(tags);
    let numbers: Vec<Numbers> = tags.iter().map(ExposureTags::numbers).collect();
    if let Some(exact) = nominal::exact(&numbers) {
        let exact: Vec<_> = tags.iter().zip(&exact).map(|(t, n)| t.with(n)).collect();
        for (written, exact) in exposures.iter_mut().zip(as_written(&exact).0) {
            if let (Some(written), Some(exact)) = (written, exact) {
                (written.relative, written.reading) = (exact.relative, Reading::ExactSteps);
            }
        }
    }
    (exposures, assumed)
}

fn as_written(tags: &[ExposureTags]) -> (Vec<Option<Exposure>>, Vec<(usize, String)>) {
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
            ..ExposureTags::default()
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
        // What is divided out is never 0 and never infinite, whatever the camera wrote.
        let of = |time, f, iso| by_tags(&[tags(Some(time), Some(f), Some(iso))]).0[0].clone();
        assert_eq!(of(30.0, 1.0, 4_000_000.0).map(|e| e.ev().round()), Some(27.0));
        assert_eq!(of(1e-5, 64.0, 25.0).map(|e| e.ev().round()), Some(-24.0));
        for (time, f, iso) in [
            (4_294_967_295.0, 1.0, 65_534.0),
            (1.0, 1.0 / 4_294_967_295.0, 100.0),
            (1.0 / 4_294_967_295.0, 4_294_967_295.0, 1.0),
            (f64::MAX, 1.0, f64::MAX),
            (f64::MIN_POSITIVE, 8.0, 100.0),
        ] {
            assert_eq!(of(time, f, iso), None);
        }
        assert!(Exposure::given(5000.0).is_none() && Exposure::given(f64::NAN).is_none());
    }

    #[test]
    fn printed_times_are_told_from_measured_ones_by_their_form() {
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

    #[test]
    fn a_bracket_of_printed_numbers_counts_by_exact_steps_and_says_so() {
        let frame = |time: f64| ExposureTags { is_time_printed: true, ..tags(Some(time), Some(11.0), Some(100.0)) };
        let (exposures, _) = by_tags(&[frame(1.0 / 60.0), frame(1.0 / 15.0)]);
        let [a, b] = [0, 1].map(|i| exposures[i].as_ref().unwrap());
        assert_eq!((b.relative() / a.relative(), a.reading), (4.0, Reading::ExactSteps));
        assert_eq!((a.time_s, a.f_number), (Some(1.0 / 60.0), Some(11.0)));
        let (exposures, _) = by_tags(&[frame(1.0 / 60.0), frame(1.0 / 17.0)]);
        assert_eq!(exposures[0].as_ref().unwrap().reading, Reading::AsWritten);
    }

    #[test]
    fn corrections_add_up_and_are_remembered() {
        let exposure = Exposure::given(-3.0).unwrap().corrected(2.0).corrected(1.0);
        assert_eq!((exposure.relative(), exposure.correction_stops()), (1.0, 3.0));
        assert_eq!(exposure.corrected(f64::NAN), exposure);
        assert_eq!(exposure.corrected(5000.0), exposure);
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
