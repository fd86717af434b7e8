//! Capture data other than the exposure.
//!
//! In: EXIF. Out: a [`Capture`], and the name of the camera. Blank fields, padding, and dates of a clock that was never
//! set are left out. Cost: negligible. Source: EXIF 2.32, sections 4.6.4 and 4.6.5.

use crate::bracket::metadata::carried;
use crate::bracket::metadata::moment::{is_date, taken};
use crate::bracket::{Capture, exposure};
use exif::{Exif, In, Tag, Value};

/// Reads the data that is copied to the outputs, including the GPS position if `keep_gps`.
pub(crate) fn read(exif: &Exif, keep_gps: bool) -> Capture {
    let focal_length = exif.get_field(Tag::FocalLength, In::PRIMARY).and_then(|f| exposure::first_number(&f.value));
    Capture {
        make: ascii(exif, Tag::Make),
        model: ascii(exif, Tag::Model),
        date: ascii(exif, Tag::DateTimeOriginal).or_else(|| ascii(exif, Tag::DateTime)).filter(|d| is_date(d)),
        taken: taken(&|tag| ascii(exif, tag)),
        lens: ascii(exif, Tag::LensModel),
        focal_length_mm: focal_length.filter(|&f| f > 0.0),
        exif: carried::carried(exif, keep_gps),
    }
}

impl Capture {
    /// Returns make and model as one text without a repeated make: `Canon EOS 5D`. `None` where neither is known.
    pub fn camera(&self) -> Option<String> {
        let text = |t: &Option<String>| t.as_deref().unwrap_or_default().trim_matches(['\0', ' ']).to_owned();
        let (make, model) = (text(&self.make), text(&self.model));
        let first_word = make.split(' ').next().unwrap_or_default().to_lowercase();
        let is_said = model.to_lowercase().starts_with(&first_word);
        let name = if is_said { model } else { format!("{make} {model}").trim_end().to_owned() };
        (!name.is_empty()).then_some(name)
    }
}

/// Returns the first string of a text field, without padding; `None` where it is empty.
pub(crate) fn ascii(exif: &Exif, tag: Tag) -> Option<String> {
    let Value::Ascii(lines) = &exif.get_field(tag, In::PRIMARY)?.value else {
        return None;
    };
    let text = String::from_utf8_lossy(lines.first()?);
    let text: String = text.chars().filter(|c| !c.is_control()).collect();
    let text = text.trim();
    (!text.is_empty()).then(|| text.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_make_is_not_repeated() {
        let camera = |make: &str, model: &str| {
            let text = |t: &str| (!t.is_empty()).then(|| t.to_owned());
            Capture { make: text(make), model: text(model), ..Capture::default() }.camera()
        };
        assert_eq!(camera("Canon", "Canon EOS 5D").as_deref(), Some("Canon EOS 5D"));
        assert_eq!(camera("NIKON CORPORATION", "NIKON D40\0").as_deref(), Some("NIKON D40"));
        assert_eq!(camera("samsung", "SM-A528B").as_deref(), Some("samsung SM-A528B"));
        assert_eq!(camera("Leica ", "").as_deref(), Some("Leica"));
        assert_eq!(camera("", "D90").as_deref(), Some("D90"));
        assert_eq!(camera("", " "), None);
    }
}
