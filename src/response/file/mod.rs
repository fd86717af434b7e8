//! Response files: save a curve and read it again.
//!
//! In and out: a [`ResponseCurve`] and a file, in the [`Format`] of its extension. Cost: negligible. JSON with the
//! schema `hdralign-response/1` is the program's own format; every number is read back exactly:
//!
//! ```json
//! { "schema": "hdralign-response/1", "camera_make": "Canon", "camera_model": "EOS 5D", "black_code": [0.0, 0.0, 0.0],
//!   "ln_exposure": { "red": [-9.1, ...], "green": [...], "blue": [...] } }
//! ```
//!
//! `ln_exposure` has, for codes 0 to 255 (of a 16-bit picture: the code / 257), the natural logarithm of the relative
//! exposure.

pub(crate) mod csv;
pub(crate) mod rsp;

use super::fit::RESIDUAL;
use super::{CODES, ResponseCurve};
use crate::bracket::Capture;
use crate::error::{Error, Result, Warning};
use crate::intake;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The remedy if a file cannot be read.
const MAKE_ONE: &str = "; create one with `hdralign response`, or use the extension of the program that wrote it: .rsp (hdrgen), .csv (luminance-hdr)";

/// The version of the format; other versions are rejected.
pub const SCHEMA: &str = "hdralign-response/1";

/// The formats of response files, by extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// `.json`: all data of the curve and its camera, exactly.
    Json,
    /// `.rsp`: three polynomials, as hdrgen reads and writes them.
    Rsp,
    /// `.csv`: a matrix, as luminance-hdr reads and writes it; files of pfstools are also read.
    Csv,
}

impl Format {
    /// The supported extensions, for messages.
    pub const KNOWN: &str = ".json, .rsp, .csv";

    /// Returns the format for the extension of `path`, in upper or lower case.
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

/// A curve encoded as a text file.
#[doc(hidden)]
#[derive(Debug, Clone, PartialEq)]
pub struct Encoded {
    /// The content of the file.
    pub text: String,
    /// The curve that is read from the text: exact, or as accurate as the format allows.
    pub curve: ResponseCurve,
}

/// Root mean square error over the pixels if radiance is merged with one curve instead of another, in stops.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loss {
    /// Error of the luminance.
    pub luminance_stops: f64,
    /// Error of R, G and B.
    pub channel_stops: [f64; 3],
}

impl Loss {
    /// Returns a warning about the accuracy lost by writing the file `path`, if there is any.
    ///
    /// # Errors
    /// [`Error::ResponseFormat`] if more than half a stop is lost. This is also the largest residual with which a
    /// recovered curve is accepted.
    pub fn warning(&self, path: &Path) -> Result<Option<Warning>> {
        let [red, green, blue] = self.channel_stops;
        let off = format!(
            "wrong by {:.2} stops (root mean square of the luminance; red {red:.2}, green {green:.2}, blue {blue:.2})",
            self.luminance_stops
        );
        let most = self.channel_stops.into_iter().fold(self.luminance_stops, f64::max);
        if most > RESIDUAL {
            let reason = format!("if this response file is used, radiance will be {off}");
            return Err(Error::ResponseFormat { path: path.to_owned(), reason });
        }
        let detail = format!("radiance merged with this file is {off}; .json saves the curve exactly");
        Ok((most > LOSS).then(|| Warning::OutOfRange { path: path.to_owned(), detail }))
    }
}

/// Largest loss without a warning, in stops: curves recovered from two brackets of one camera differ by as much.
const LOSS: f64 = 0.01;

/// A curve and its camera.
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
    /// Returns the name of the camera, if it is known.
    pub fn camera(&self) -> Option<String> {
        Capture { make: self.make.clone(), model: self.model.clone(), ..Capture::default() }.camera()
    }
}

/// The content of the JSON file.
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

/// The schema version of the file.
#[derive(Deserialize)]
struct Header {
    schema: String,
}

impl SavedResponse {
    /// Returns the text of the JSON file.
    pub fn to_json(&self) -> String {
        let [red, green, blue] = [0, 1, 2].map(|c| self.curve.ln_exposure(c).to_vec());
        let document = Document {
            schema: SCHEMA.to_owned(),
            camera_make: self.make.clone(),
            camera_model: self.model.clone(),
            black_code: std::array::from_fn(|c| self.curve.black(c)),
            ln_exposure: Channels { red, green, blue },
        };
        // Only strings and finite numbers: writing cannot fail.
        serde_json::to_string_pretty(&document).unwrap_or_default() + "\n"
    }

    /// Encodes the curve as the text of the file `path`.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`], and [`Error::ResponseFormat`] if the format cannot represent the curve even
    /// roughly.
    pub fn encode(&self, path: &Path) -> Result<Encoded> {
        let refused = |reason: &str| Error::ResponseFormat { path: path.to_owned(), reason: reason.to_owned() };
        match Format::of(path)? {
            Format::Json => Ok(Encoded { text: self.to_json(), curve: self.curve.clone() }),
            Format::Csv => {
                let text = csv::write(&self.curve);
                // Exposures below half a billionth of white are 0 in nine decimals.
                let steep = |_| refused("the curve is too steep for the nine decimals of this format");
                let curve = csv::read(&text).map_err(steep)?;
                Ok(Encoded { text, curve })
            }
            Format::Rsp => {
                let none = || refused("no increasing polynomial up to the fifth degree fits this curve");
                let text = rsp::write(&self.curve).ok_or_else(none)?;
                let curve = rsp::read(&text).map_err(|_| none())?;
                Ok(Encoded { text, curve })
            }
        }
    }

    /// Reads the curve in the file `path`, by its extension.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`], [`Error::Read`], [`Error::Changed`], and [`Error::ResponseFile`] if the content is
    /// not a valid curve in that format.
    pub fn read(path: &Path) -> Result<Self> {
        let format = Format::of(path)?;
        let bytes = intake::whole(path, intake::MOST_OF_A_TEXT)?;
        let wrong = |reason: String| Error::ResponseFile { path: path.to_owned(), reason: reason + MAKE_ONE };
        let text = String::from_utf8(bytes).map_err(|_| wrong("it is not a text file".to_owned()))?;
        let bare = |curve| SavedResponse { make: None, model: None, curve };
        match format {
            Format::Json => Self::from_json(&text, path),
            Format::Rsp => rsp::read(&text).map(bare).map_err(wrong),
            Format::Csv => csv::read(&text).map(bare).map_err(wrong),
        }
    }

    /// Reads the curve in `text`, the content of the file `path`.
    ///
    /// # Errors
    /// [`Error::ResponseFile`] if the text is not JSON, or has another schema, or its numbers are not those of a
    /// response: per channel, 256 increasing numbers between -80 and 80, and a black code from 0 to less than 128.
    pub fn from_json(text: &str, path: &Path) -> Result<Self> {
        let wrong = |reason: String| Error::ResponseFile { path: path.to_owned(), reason };
        let header: Header = serde_json::from_str(text).map_err(|e| {
            wrong(format!("it is not a JSON object with a text under the key \"schema\" ({e}){MAKE_ONE}"))
        })?;
        if header.schema != SCHEMA {
            return Err(wrong(format!(
                "it is a file of another kind or version: its schema is {:?}, but {SCHEMA:?} is required",
                header.schema
            )));
        }
        let document: Document = serde_json::from_str(text).map_err(|e| wrong(e.to_string()))?;
        let Channels { red, green, blue } = document.ln_exposure;
        let channel = |name: &str, values: Vec<f64>| {
            let count = values.len();
            let wanted = |_| wrong(format!("{name} has {count} values, and {CODES} are needed"));
            <[f64; CODES]>::try_from(values).map_err(wanted)
        };
        let g = [channel("red", red)?, channel("green", green)?, channel("blue", blue)?];
        let curve = ResponseCurve::new(g).ok_or_else(|| {
            let reason = "its values do not increase from one pixel value to the next, or are not between -80 and 80";
            wrong(reason.to_owned())
        })?;
        let black = |_: ()| wrong("each number in `black_code` must be at least 0 and less than 128".to_owned());
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
        // These numbers have no short decimal form.
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
    fn the_extension_decides_and_the_curve_is_the_one_that_is_read_again() {
        let dir = tempfile::tempdir().unwrap();
        for (name, most) in [("c.json", 0.0), ("c.RSP", 0.1), ("c.csv", 1e-4)] {
            let path = dir.path().join(name);
            let encoded = saved().encode(&path).unwrap();
            std::fs::write(&path, encoded.text).unwrap();
            assert_eq!(SavedResponse::read(&path).unwrap().curve, encoded.curve, "{name}");
            let off = |z: usize| (encoded.curve.ln_exposure(1)[z] - saved().curve.ln_exposure(1)[z]).abs();
            let worst = (10..=245).map(off).fold(0.0, f64::max);
            assert!(worst <= most, "{name}: {worst}");
        }
        assert!(matches!(saved().encode(Path::new("c.txt")), Err(Error::UnknownExtension { .. })));
        let path = dir.path().join("photo.json");
        std::fs::write(&path, [0xFF, 0xD8, 0xFF, 0xE0]).unwrap();
        let message = SavedResponse::read(&path).unwrap_err().to_string();
        assert!(
            message.contains("photo.json")
                && message.contains("not a text file")
                && message.contains("hdralign response")
        );
    }

    #[test]
    fn loss_is_a_warning_from_0_01_stops_and_an_error_from_half_a_stop() {
        let warning = |luminance_stops: f64, blue: f64| {
            Loss { luminance_stops, channel_stops: [0.001, 0.001, blue] }.warning(Path::new("c.rsp"))
        };
        assert_eq!(warning(0.004, 0.009).unwrap(), None);
        let found = warning(0.012, 0.34).unwrap().unwrap().to_string();
        assert!(
            found.contains("c.rsp") && found.contains("wrong by 0.01 stops") && found.contains("blue 0.34"),
            "{found}"
        );
        let refused = warning(0.1, 0.6).unwrap_err().to_string();
        assert!(refused.contains("c.rsp") && refused.contains("blue 0.60") && refused.contains(".json"), "{refused}");
    }

    /// Found by code review for the fuzz target: a curve of forty decades was written as zeros, which could not be
    /// read again.
    #[test]
    fn too_steep_curve_is_not_saved_in_decimals() {
        let steep = |decades: f64| {
            let ln_white = decades * std::f64::consts::LN_10;
            let g = std::array::from_fn(|z| ln_white * (z as f64 - MID as f64) / 255.0);
            SavedResponse { make: None, model: None, curve: ResponseCurve::new([g; 3]).unwrap() }
        };
        let refused = steep(40.0).encode(Path::new("c.csv")).unwrap_err().to_string();
        assert!(refused.contains("c.csv") && refused.contains(".json"), "{refused}");
        assert!(steep(4.0).encode(Path::new("c.csv")).is_ok());
    }

    #[test]
    fn invalid_response_is_rejected_with_its_name_and_fault() {
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
        assert!(reason(&v.to_string()).contains("do not increase"));
        let mut v = good.clone();
        v["ln_exposure"]["red"][255] = 1e300.into();
        assert!(reason(&v.to_string()).contains("red") || reason(&v.to_string()).contains("increase"));
        let mut v = good;
        v["ln_exposure"].as_object_mut().unwrap().remove("blue");
        assert!(reason(&v.to_string()).contains("blue"));
    }
}
