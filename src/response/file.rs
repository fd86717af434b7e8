//! Response files: a curve, saved and used again.
//!
//! In and out: a [`ResponseCurve`] and JSON of the schema `hdralign-response/1`; every number comes back as it was. Cost: none.
//!
//! ```json
//! { "schema": "hdralign-response/1", "camera_make": "Canon", "camera_model": "EOS 5D", "black_code": [0.0, 0.0, 0.0],
//!   "ln_exposure": { "red": [-9.1, ...], "green": [...], "blue": [...] } }
//! ```
//!
//! `ln_exposure` holds, for codes 0 to 255 (of a 16-bit picture: the code / 257), the natural logarithm of the relative exposure.

use super::{CODES, ResponseCurve};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The version of the format; a reader refuses any other.
pub const SCHEMA: &str = "hdralign-response/1";

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

    /// The curve in the file `path`.
    ///
    /// # Errors
    /// [`Error::Read`]; otherwise as [`from_json`](Self::from_json).
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        Self::from_json(&text, path)
    }

    /// The curve in `text`, the content of the file `path`.
    ///
    /// # Errors
    /// [`Error::ResponseFile`] where the text is no JSON, of another schema, or its numbers are no response: 256 to a channel, finite
    /// and rising.
    pub fn from_json(text: &str, path: &Path) -> Result<Self> {
        let wrong = |reason: String| Error::ResponseFile { path: path.to_owned(), reason };
        let header: Header = serde_json::from_str(text)
            .map_err(|e| wrong(format!("it is no JSON with a \"schema\" ({e}); make one by `hdralign response`")))?;
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
    use super::*;

    fn saved() -> SavedResponse {
        let srgb = *ResponseCurve::srgb().ln_exposure(0);
        // Digits that no short decimal has.
        let g = [0.0, 1.0 / 3.0, 1.0 / 7.0].map(|d| srgb.map(|v| v * (1.0 + d / 100.0) + d));
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
