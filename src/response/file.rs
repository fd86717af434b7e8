//! Response files: a curve, saved and used again.
//!
//! In and out: a [`ResponseCurve`] and a file, in the [`Format`] that its extension says. Cost: none. JSON of the schema
//! `hdralign-response/1` is the program's own, in which every number comes back as it was:
//!
//! ```json
//! { "schema": "hdralign-response/1", "camera_make": "Canon", "camera_model": "EOS 5D", "black_code": [0.0, 0.0, 0.0],
//!   "ln_exposure": { "red": [-9.1, ...], "green": [...], "blue": [...] } }
//! ```
//!
//! `ln_exposure` holds, for codes 0 to 255 (of a 16-bit picture: the code / 257), the natural logarithm of the relative exposure.

use super::fit::RESIDUAL;
use super::{CODES, ResponseCurve, csv, rsp, stops};
use crate::bracket::Capture;
use crate::error::{Error, Result, Warning};
use crate::intake;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What helps whose file is none.
const MAKE_ONE: &str = "; make one by `hdralign response`, or give its own extension to another program's: .rsp (hdrgen), .csv (luminance-hdr)";

/// The version of the format; a reader refuses any other.
pub const SCHEMA: &str = "hdralign-response/1";

/// The formats of response files, told by the extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// `.json`: everything, to the last bit.
    Json,
    /// `.rsp`: three polynomials, as hdrgen reads and writes them.
    Rsp,
    /// `.csv`: a matrix, as luminance-hdr reads and writes it; those of pfstools are read.
    Csv,
}

impl Format {
    /// The extensions that are known, for messages.
    pub const KNOWN: &str = ".json, .rsp, .csv";

    /// The format that `path` asks for by its extension, in any case.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`].
    pub fn of(path: &Path) -> Result<Format> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        match extension.as_str() {
            "json" => Ok(Format::Json),
            "rsp" => Ok(Format::Rsp),
            "csv" => Ok(Format::Csv),
            _ => Err(Error::UnknownExtension { path: path.to_owned(), known: Format::KNOWN }),
        }
    }
}

/// A curve as a text file.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoded {
    /// All of the file.
    pub text: String,
    /// What radiance is off by, merged with the file in place of the curve: root mean square over the channels and the codes that
    /// [decide](super::samples::deciding), in stops; 0 where it is all there.
    pub residual_stops: f64,
    /// The channel that is farthest off at one of these codes, and how far, in stops.
    pub worst: (&'static str, f64),
}

impl Encoded {
    /// What there is to say of the file `path` where it holds less than the curve.
    pub fn lossy(&self, path: &Path) -> Option<Warning> {
        let (channel, most) = self.worst;
        let detail = format!(
            "radiance merged with it is off by {:.2} stops (root mean square over the photographs, {channel} by up to {most:.2}); .json holds all of the curve",
            self.residual_stops
        );
        (self.residual_stops > LOSS).then(|| Warning::OutOfRange { path: path.to_owned(), detail })
    }
}

/// Residual of a file that is not worth a word, in stops: what curves of two brackets of one camera differ by.
pub(super) const LOSS: f64 = 0.01;

/// What nine decimals miss of a camera's curve is below this, and not told, in stops.
const DECIMALS: f64 = 1e-3;

/// `text`, which is read as `read`, in place of `curve`: both are 1 at the middle code in the mean of the channels, as radiance is, so
/// that nothing is shifted before it is compared. None where it is off by more than what no curve may [contradict](RESIDUAL) frames by.
fn encoded(text: String, read: &ResponseCurve, curve: &ResponseCurve, deciding: &[[u64; CODES]; 3]) -> Option<Encoded> {
    let (mut squares, mut count, mut worst) = (0.0, 0, ("red", 0.0));
    for (c, channel) in ["red", "green", "blue"].into_iter().enumerate() {
        for z in (0..CODES).filter(|&z| deciding[c][z] > 0) {
            let miss = stops(read.ln_exposure(c)[z] - curve.ln_exposure(c)[z]).abs();
            squares += deciding[c][z] as f64 * miss * miss;
            count += deciding[c][z];
            if miss > worst.1 {
                worst = (channel, miss);
            }
        }
    }
    let residual_stops = (squares / count.max(1) as f64).sqrt();
    (residual_stops <= RESIDUAL).then_some(Encoded { text, residual_stops, worst })
}

/// Of no photographs: all codes decide alike, but for the clipped ones.
pub const ALL_CODES: [[u64; CODES]; 3] = {
    let mut codes = [1; CODES];
    (codes[0], codes[CODES - 1]) = (0, 0);
    [codes; 3]
};

/// A curve and the camera whose it is.
#[derive(Debug, Clone, PartialEq)]
pub struct SavedResponse {
    /// EXIF Make of the bracket it was recovered from.
    pub make: Option<String>,
    /// EXIF Model of the bracket it was recovered from.
    pub model: Option<String>,
    /// The curve.
    pub curve: ResponseCurve,
}

impl SavedResponse {
    /// The camera's name; none where it is not known.
    pub fn camera(&self) -> Option<String> {
        Capture { make: self.make.clone(), model: self.model.clone(), ..Capture::default() }.camera()
    }
}

/// The file, as it is written.
#[derive(Serialize, Deserialize)]
struct Document {
    schema: String,
    #[serde(default)]
    camera_make: Option<String>,
    #[serde(default)]
    camera_model: Option<String>,
    #[serde(default)]
    black_code: [f64; 3],
    ln_exposure: Channels,
}

#[derive(Serialize, Deserialize)]
struct Channels {
    red: Vec<f64>,
    green: Vec<f64>,
    blue: Vec<f64>,
}

/// What says which version the rest is of.
#[derive(Deserialize)]
struct Header {
    schema: String,
}

impl SavedResponse {
    /// The text of the file.
    pub fn to_json(&self) -> String {
        let [red, green, blue] = [0, 1, 2].map(|c| self.curve.ln_exposure(c).to_vec());
        let document = Document {
            schema: SCHEMA.to_owned(),
            camera_make: self.make.clone(),
            camera_model: self.model.clone(),
            black_code: std::array::from_fn(|c| self.curve.black(c)),
            ln_exposure: Channels { red, green, blue },
        };
        // Strings and finite numbers alone: nothing in it can fail to be written.
        serde_json::to_string_pretty(&document).unwrap_or_default() + "\n"
    }

    /// The curve as the text of the file `path`. What a format that does not hold all of it is off by counts by the codes that
    /// `deciding` says (of each channel, [how many places](super::samples::deciding) each decides; or [`ALL_CODES`]).
    ///
    /// # Errors
    /// [`Error::UnknownExtension`], and [`Error::ResponseFile`] where the format does not hold the curve, or nothing near it.
    pub fn encode(&self, path: &Path, deciding: &[[u64; CODES]; 3]) -> Result<Encoded> {
        let refused = |reason: &str| Error::ResponseFile { path: path.to_owned(), reason: reason.to_owned() };
        let lossy = |text: String, read: std::result::Result<ResponseCurve, String>, reason: &str| {
            let read = read.map_err(|_| refused(reason))?;
            encoded(text, &read, &self.curve, deciding).ok_or_else(|| refused(reason))
        };
        match Format::of(path)? {
            Format::Json => Ok(Encoded { text: self.to_json(), residual_stops: 0.0, worst: ("red", 0.0) }),
            Format::Csv => {
                let text = csv::write(&self.curve);
                // What is a billionth of white or less is nothing in nine decimals.
                let read = csv::read(&text);
                let all = lossy(text, read, "nine decimals do not hold a curve as steep as this; save it as .json")?;
                let residual_stops = if all.residual_stops < DECIMALS { 0.0 } else { all.residual_stops };
                Ok(Encoded { residual_stops, ..all })
            }
            Format::Rsp => {
                let reason =
                    "no polynomial up to the fifth degree is within half a stop of this curve; save it as .json";
                let text = rsp::write(&self.curve).ok_or_else(|| refused(reason))?;
                let read = rsp::read(&text);
                lossy(text, read, reason)
            }
        }
    }

    /// The curve in the file `path`, by its extension.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`], [`Error::Read`], and [`Error::ResponseFile`] where the content is no curve of that format.
    pub fn read(path: &Path) -> Result<Self> {
        let format = Format::of(path)?;
        let bytes = intake::whole(path, intake::MOST_OF_A_TEXT)?;
        let wrong = |reason: String| Error::ResponseFile { path: path.to_owned(), reason: reason + MAKE_ONE };
        let text = String::from_utf8(bytes).map_err(|_| wrong("it is no text".to_owned()))?;
        let bare = |curve| SavedResponse { make: None, model: None, curve };
        match format {
            Format::Json => Self::from_json(&text, path),
            Format::Rsp => rsp::read(&text).map(bare).map_err(wrong),
            Format::Csv => csv::read(&text).map(bare).map_err(wrong),
        }
    }

    /// The curve in `text`, the content of the file `path`.
    ///
    /// # Errors
    /// [`Error::ResponseFile`] where the text is no JSON, of another schema, or its numbers are no response: 256 to a channel, finite
    /// and rising.
    pub fn from_json(text: &str, path: &Path) -> Result<Self> {
        let wrong = |reason: String| Error::ResponseFile { path: path.to_owned(), reason };
        let header: Header = serde_json::from_str(text)
            .map_err(|e| wrong(format!("it is no JSON with a \"schema\" ({e}){MAKE_ONE}")))?;
        if header.schema != SCHEMA {
            return Err(wrong(format!("its schema is {:?}, and {SCHEMA:?} is read", header.schema)));
        }
        let document: Document = serde_json::from_str(text).map_err(|e| wrong(e.to_string()))?;
        let Channels { red, green, blue } = document.ln_exposure;
        let channel = |name: &str, values: Vec<f64>| {
            let count = values.len();
            let wanted = |_| wrong(format!("{name} has {count} values, and {CODES} are needed"));
            <[f64; CODES]>::try_from(values).map_err(wanted)
        };
        let g = [channel("red", red)?, channel("green", green)?, channel("blue", blue)?];
        let curve =
            ResponseCurve::new(g).ok_or_else(|| wrong("its values do not rise from code to code".to_owned()))?;
        let black = |_: ()| wrong("a black_code is not in 0..128".to_owned());
        Ok(SavedResponse {
            make: document.camera_make,
            model: document.camera_model,
            curve: curve.with_black(document.black_code).ok_or(()).map_err(black)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::MID;
    use super::*;

    fn saved() -> SavedResponse {
        let srgb = *ResponseCurve::srgb().ln_exposure(0);
        // Digits that no short decimal has.
        let mean = (1.0 / 3.0 + 1.0 / 7.0) / 3.0;
        let g = [0.0, 1.0 / 3.0, 1.0 / 7.0].map(|d| srgb.map(|v| v * (1.0 + d / 100.0) + d - mean));
        SavedResponse {
            make: Some("A \"Camera\"".to_owned()),
            model: None,
            curve: ResponseCurve::new(g).unwrap().with_black([0.1, 0.0, 7.3]).unwrap(),
        }
    }

    fn reason(text: &str) -> String {
        SavedResponse::from_json(text, Path::new("c.json")).unwrap_err().to_string()
    }

    #[test]
    fn every_bit_comes_back() {
        let text = saved().to_json();
        assert_eq!(SavedResponse::from_json(&text, Path::new("c.json")).unwrap(), saved());
    }

    #[test]
    fn the_extension_decides_and_says_what_is_lost() {
        let dir = tempfile::tempdir().unwrap();
        // Of all codes; of codes 10 to 245 alone the polynomials miss 0.06 stops.
        for (name, most) in [("c.json", 0.0), ("c.RSP", 0.1), ("c.csv", 0.0)] {
            let path = dir.path().join(name);
            let encoded = saved().encode(&path, &ALL_CODES).unwrap();
            assert!(encoded.residual_stops <= most, "{name}: {}", encoded.residual_stops);
            assert_eq!(encoded.lossy(&path).is_some(), most > 0.0);
            std::fs::write(&path, encoded.text).unwrap();
            let back = SavedResponse::read(&path).unwrap().curve;
            let apart = |z: usize| {
                (back.ln_exposure(1)[200] - back.ln_exposure(1)[z])
                    / (saved().curve.ln_exposure(1)[200] - saved().curve.ln_exposure(1)[z])
            };
            // The polynomial misses single codes by more than its residual, here of 2.4 nepers.
            assert!((apart(80) - 1.0).abs() < 0.05, "{name}: {}", apart(80));
        }
        assert!(matches!(saved().encode(Path::new("c.txt"), &ALL_CODES), Err(Error::UnknownExtension { .. })));
        let path = dir.path().join("photo.json");
        std::fs::write(&path, [0xFF, 0xD8, 0xFF, 0xE0]).unwrap();
        let message = SavedResponse::read(&path).unwrap_err().to_string();
        assert!(message.contains("photo.json") && message.contains("no text") && message.contains("hdralign response"));
    }

    /// Found by reading for the fuzzer: a curve of forty decades was written as zeros, and was none when it was read again.
    #[test]
    fn what_no_decimals_hold_is_not_saved_in_them() {
        let steep = |decades: f64| {
            let ln_white = decades * std::f64::consts::LN_10;
            let g = std::array::from_fn(|z| ln_white * (z as f64 - MID as f64) / 255.0);
            SavedResponse { make: None, model: None, curve: ResponseCurve::new([g; 3]).unwrap() }
        };
        let refused = steep(40.0).encode(Path::new("c.csv"), &ALL_CODES).unwrap_err().to_string();
        assert!(refused.contains("c.csv") && refused.contains(".json"), "{refused}");
        assert!(steep(11.0).encode(Path::new("c.csv"), &ALL_CODES).is_err());
        // Where no pixel is dark, the dark codes do not matter.
        let bright = std::array::from_fn(|z| u64::from((128..255).contains(&z)));
        assert_eq!(steep(11.0).encode(Path::new("c.csv"), &[bright; 3]).unwrap().residual_stops, 0.0);
        assert_eq!(steep(4.0).encode(Path::new("c.csv"), &ALL_CODES).unwrap().residual_stops, 0.0);
    }

    #[test]
    fn what_is_no_response_is_refused_with_its_name_and_fault() {
        let good: serde_json::Value = serde_json::from_str(&saved().to_json()).unwrap();
        assert!(reason("P6 2 2").contains("c.json"));
        let mut v = good.clone();
        v["schema"] = "hdralign-response/2".into();
        assert!(reason(&v.to_string()).contains("hdralign-response/2"));
        let mut v = good.clone();
        v["ln_exposure"]["green"].as_array_mut().unwrap().pop();
        assert!(reason(&v.to_string()).contains("green has 255 values"));
        let mut v = good.clone();
        v["ln_exposure"]["blue"][7] = 9.0.into();
        assert!(reason(&v.to_string()).contains("do not rise"));
        let mut v = good.clone();
        v["ln_exposure"]["red"][255] = 1e300.into();
        assert!(reason(&v.to_string()).contains("red") || reason(&v.to_string()).contains("rise"));
        let mut v = good;
        v["ln_exposure"].as_object_mut().unwrap().remove("blue");
        assert!(reason(&v.to_string()).contains("blue"));
    }
}
