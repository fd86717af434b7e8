//! Exposure of each frame, and its source.
//!
//! In: the [`ExposureTags`] of all frames, or the user's `-e` list. Out: an [`Exposure`] per frame with the relative
//! exposure t * ISO / N^2. Cost: negligible. Source: ISO 2720 for the relation.

pub(super) mod brightness;
mod nominal;
mod tags;

pub(super) use tags::first_number;
#[doc(hidden)]
pub use tags::{ExposureTags, Tagged};

use serde::Serialize;

/// Source of a frame's exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExposureSource {
    /// Read from the EXIF tags of the file.
    Exif,
    /// Given by the user with `-e`.
    Given,
    /// Estimated from the pixels, because the file has no exposure or one that contradicts the pixels.
    Estimated,
}

/// How the exposure values of a file were interpreted.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reading {
    /// The values are used as they are written.
    AsWritten,
    /// The written values are rounded, and the exact steps that they stand for are used: 1/32 s for 1/30 s, f/11.31 for
    /// f/11, ISO 252 for ISO 250.
    ExactSteps,
}

/// Largest magnitude of an exposure in EV, where 0 EV is t * ISO / N^2 = 1 s. No camera goes further.
pub const MOST_EV: f64 = 40.0;

/// How a frame was exposed.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    /// Exposure time in seconds, as written, if known.
    pub time_s: Option<f64>,
    /// The f-number, as written, if known.
    pub f_number: Option<f64>,
    /// ISO sensitivity, as written, if known.
    pub iso: Option<f64>,
    relative: f64,
    correction_stops: f64,
    /// Standard deviation, in stops, of the difference between this exposure and the nearest known exposure of the
    /// bracket; `None` where this exposure was not estimated.
    pub uncertainty_stops: Option<f64>,
    /// How the values were interpreted.
    pub reading: Reading,
    /// Source of the relative exposure.
    pub source: ExposureSource,
    /// The tags that were used, for the report: `ExposureTime, FNumber, PhotographicSensitivity`, or `-e`; empty where
    /// estimated.
    pub tags: String,
}

impl Exposure {
    /// Returns the exposure `ev` stops above one second at f/1 and ISO 1, as given by the user; time, f-number and ISO
    /// are unknown. `None` where 2^`ev` is not positive and finite.
    pub fn given(ev: f64) -> Option<Self> {
        Some(Exposure::new(positive(libm::exp2(ev))?, ExposureSource::Given, "-e".into()))
    }

    /// Returns an exposure of `ev` stops that was estimated from the pixels with the standard deviation
    /// `uncertainty_stops`. `None` where 2^`ev` is not positive and finite.
    pub fn estimated(ev: f64, uncertainty_stops: f64) -> Option<Self> {
        let exposure = Exposure::new(positive(libm::exp2(ev))?, ExposureSource::Estimated, String::new());
        Some(Exposure { uncertainty_stops: Some(uncertainty_stops), ..exposure })
    }

    /// Returns an exposure recorded by the camera, with the time in seconds. An f-number or ISO that is `None` counts
    /// as a factor of 1, so it must be missing in the whole bracket. `None` where the relative exposure is beyond
    /// +-[`MOST_EV`], which no camera reaches.
    pub fn from_camera(time_s: f64, f_number: Option<f64>, iso: Option<f64>, tags: String) -> Option<Self> {
        let (n, s) = (f_number.unwrap_or(1.0), iso.unwrap_or(1.0));
        let relative = positive(time_s * s / (n * n)).filter(|relative| libm::log2(*relative).abs() <= MOST_EV)?;
        let exposure = Exposure::new(relative, ExposureSource::Exif, tags);
        Some(Exposure { time_s: Some(time_s), f_number, iso, ..exposure })
    }

    fn new(relative: f64, source: ExposureSource, tags: String) -> Self {
        Exposure {
            time_s: None,
            f_number: None,
            iso: None,
            relative,
            correction_stops: 0.0,
            uncertainty_stops: None,
            reading: Reading::AsWritten,
            source,
            tags,
        }
    }

    /// Returns the exposure corrected by further `stops`. The correction is ignored if it is not finite, or if the
    /// corrected exposure would not be positive and finite.
    pub fn corrected(&self, stops: f64) -> Self {
        let corrected = positive(self.relative * libm::exp2(stops)).filter(|_| stops.is_finite());
        match corrected {
            Some(relative) => Exposure { relative, correction_stops: self.correction_stops + stops, ..self.clone() },
            None => self.clone(),
        }
    }

    /// Sum of the corrections, in stops; [`relative`](Self::relative) includes it.
    pub fn correction_stops(&self) -> f64 {
        self.correction_stops
    }

    /// Relative exposure t * ISO / N^2 in seconds, or 2^EV where EV was given. Includes the correction; positive and
    /// finite.
    pub fn relative(&self) -> f64 {
        self.relative
    }

    /// Exposure in EV: log2 of the relative exposure.
    pub fn ev(&self) -> f64 {
        libm::log2(self.relative)
    }
}

/// Computes the exposures of a bracket from the tags of its frames, in their order; `None` for a frame whose tags do
/// not suffice. Also returns the assumptions made, as (frame index, text).
///
/// If all frames have nominal values (dial markings), these are replaced by the exact steps that they stand for. An
/// f-number or ISO that is missing in all frames counts as a factor of 1. If it is missing only in some frames, and the
/// other frames all have the same value, this value is assumed. If the other frames have different values, the result
/// for the frame is `None`.
pub fn by_tags(tags: &[ExposureTags]) -> (Vec<Option<Exposure>>, Vec<(usize, String)>) {
    let (mut exposures, assumed) = as_written(tags);
    if let Some(exact) = nominal::exact(tags) {
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

/// The f-number or ISO of the frames that have one.
#[derive(Clone, Copy)]
enum Common {
    /// No frame has a value.
    Absent,
    /// All values are equal, within 1.5 %.
    Value(f64),
    /// The values differ.
    Varied,
}

fn common(values: impl Iterator<Item = Tagged>) -> Common {
    values.flatten().fold(Common::Absent, |so_far, (v, _)| match so_far {
        Common::Absent => Common::Value(v),
        // f/5.6 is 5.6 in FNumber, and may be 5.657 in ApertureValue (APEX). These values differ by 1 % and count as
        // equal.
        Common::Value(first) if (v - first).abs() <= 0.015 * first => so_far,
        _ => Common::Varied,
    })
}

/// Returns the value to use. `Some(None)` where all frames lack the value; `None` where this frame lacks it and the
/// values of the other frames differ.
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
fn positive(x: f64) -> Option<f64> {
    (x.is_finite() && x > 0.0).then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

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
        // Pixel values are divided by the relative exposure, so it must never be 0 or infinite, whatever the camera
        // wrote.
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
    fn rounded_exposures_are_read_as_exact_steps_and_reported() {
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
    fn tag_missing_in_all_frames_is_ignored() {
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
