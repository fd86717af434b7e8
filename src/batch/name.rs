//! The names of results, made from a template.
//!
//! In: a template such as `{folder}/{first}-{last}`, and a bracket. Out: a path without extension, relative to the
//! folder for results. Cost: negligible.

use crate::error::{Error, Result};
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};

/// A part of a template.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Field {
    Folder,
    First,
    Last,
    Number,
    Count,
    Set,
    Camera,
    Date,
    Time,
}

/// For each field: its name as the user types it, the field, and its description in the help.
const FIELDS: [(&str, Field, &str); 9] = [
    (
        "folder",
        Field::Folder,
        "the folder of the photographs, relative to the searched folder. With -d and brackets in\n             several searched folders, it usually begins with the name of the searched folder",
    ),
    ("first", Field::First, "the first photograph by name, without extension"),
    ("last", Field::Last, "the last photograph by name, without extension"),
    ("number", Field::Number, "the bracket's number, from 0001"),
    ("count", Field::Count, "the number of photographs in the bracket"),
    ("set", Field::Set, "the number of its panorama, from 001"),
    ("camera", Field::Camera, "the camera, for example Canon_EOS_5D"),
    ("date", Field::Date, "the date when it was taken, for example 2026-11-21"),
    ("time", Field::Time, "the time when it was taken, for example 17-05-59"),
];

#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Text(String),
    Field(Field),
}

/// A valid template for the names of results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Template(Vec<Part>);

/// The values of the fields for one bracket. In the name, a value that is not known becomes `unknown`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Values {
    /// The folder of the photographs, relative to the searched folder. If several folders were searched, it may begin
    /// with the name of the searched folder.
    pub folder: PathBuf,
    /// File name without extension of the photograph that is first in the order of names.
    pub first: OsString,
    /// File name without extension of the photograph that is last in the order of names.
    pub last: OsString,
    /// The bracket's number, from 1.
    pub number: usize,
    /// Number of photographs of the bracket.
    pub count: usize,
    /// The number of the panorama that contains the bracket, from 1.
    pub set: usize,
    /// Make and model of the camera.
    pub camera: Option<String>,
    /// Time when the bracket was taken: `YYYY:MM:DD HH:MM:SS`, as in EXIF.
    pub date_time: Option<String>,
}

impl Default for Template {
    /// `{folder}/{first}-{last}`: results are in the same folders as the photographs.
    fn default() -> Self {
        let text = |t: &str| Part::Text(t.into());
        Template(vec![
            Part::Field(Field::Folder),
            text("/"),
            Part::Field(Field::First),
            text("-"),
            Part::Field(Field::Last),
        ])
    }
}

impl Template {
    /// Parses the template `text`.
    ///
    /// # Errors
    /// [`Error::Option`] if `text` has an unknown field or an unmatched brace, does not end with a name, or leads
    /// outside of the folder for results.
    pub fn parse(text: &str) -> Result<Template> {
        let refused = |reason: String| Error::Option { option: "--name", reason };
        let mut parts = Vec::new();
        let mut rest = text;
        while let Some(begin) = rest.find(['{', '}']) {
            let end = rest[begin..].find('}').filter(|_| rest[begin..].starts_with('{'));
            let Some(end) = end.map(|end| begin + end) else {
                return Err(refused(format!("{text:?} has an unmatched brace; the fields are {}", listed())));
            };
            let name = &rest[begin + 1..end];
            let Some((_, field, _)) = FIELDS.iter().find(|(known, ..)| *known == name) else {
                return Err(refused(format!("there is no field {{{name}}}; the fields are {}", listed())));
            };
            if begin > 0 {
                parts.push(Part::Text(rest[..begin].into()));
            }
            parts.push(Part::Field(*field));
            rest = &rest[end + 1..];
        }
        if !rest.is_empty() {
            parts.push(Part::Text(rest.into()));
        }
        if Path::new(text).components().any(|c| !matches!(c, Component::Normal(_) | Component::CurDir)) {
            return Err(refused(format!(
                "{text:?} begins with `/` or contains `..`; give a path inside the folder for results"
            )));
        }
        if text.is_empty() || text.ends_with('/') {
            return Err(refused(format!(
                "{text:?} ends without a file name; append one, for example `{{first}}-{{last}}`"
            )));
        }
        Ok(Template(parts))
    }

    /// Returns the fields with their descriptions for the help, one field per line.
    pub fn help() -> String {
        FIELDS.iter().map(|(name, _, about)| format!("  {:<10} {about}\n", format!("{{{name}}}"))).collect()
    }

    /// Returns the path of a bracket's results, without extension.
    pub fn path(&self, values: &Values) -> PathBuf {
        let mut text = OsString::new();
        for part in &self.0 {
            match part {
                Part::Text(t) => text.push(t),
                Part::Field(field) => text.push(values.text(*field)),
            }
        }
        // If a bracket is in the searched folder itself, `{folder}` is empty. A `/` after it is then removed.
        Path::new(&text).components().filter(|c| matches!(c, Component::Normal(_))).collect()
    }
}

impl Values {
    /// Returns the value of `field`. It may be invalid UTF-8, because names of files and folders may be.
    fn text(&self, field: Field) -> OsString {
        let date_time = self.date_time.as_deref().unwrap_or("unknown unknown");
        let (date, time) = date_time.split_once(' ').unwrap_or((date_time, "unknown"));
        let text = match field {
            Field::Folder => return self.folder.clone().into_os_string(),
            Field::First => return self.first.clone(),
            Field::Last => return self.last.clone(),
            Field::Number => format!("{:04}", self.number),
            Field::Count => self.count.to_string(),
            Field::Set => format!("{:03}", self.set),
            Field::Camera => plain(self.camera.as_deref().unwrap_or("unknown")),
            Field::Date => date.replace(':', "-"),
            Field::Time => time.replace(':', "-"),
        };
        text.into()
    }
}

/// Replaces every character of `text` but ASCII letters, digits, `-` and `.` by `_`: others may have a meaning for
/// shells, job systems or file systems.
pub fn plain(text: &str) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '-' | '.') { c } else { '_' };
    let plain: String = text.chars().map(letter).collect();
    // A dot at the start would hide the file, and a dash would make the name look like an option.
    if plain.starts_with(['.', '-']) { format!("_{}", &plain[1..]) } else { plain }
}

fn listed() -> String {
    FIELDS.iter().map(|(name, ..)| format!("{{{name}}}")).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values() -> Values {
        Values {
            folder: "night/a".into(),
            first: "IMG_1".into(),
            last: "IMG_3".into(),
            number: 7,
            count: 3,
            set: 2,
            camera: Some("Canon EOS 5D".into()),
            date_time: Some("2026:11:21 17:05:59".into()),
        }
    }

    #[test]
    fn fields_are_filled_in() {
        let path = |template: &str| Template::parse(template).unwrap().path(&values());
        assert_eq!(Template::parse("{folder}/{first}-{last}").unwrap(), Template::default());
        assert_eq!(Template::default().path(&values()), Path::new("night/a/IMG_1-IMG_3"));
        let here = Values { folder: PathBuf::new(), ..values() };
        assert_eq!(Template::default().path(&here), Path::new("IMG_1-IMG_3"));
        assert_eq!(
            path("{date}/{camera} {time} {number}x{count}"),
            Path::new("2026-11-21/Canon_EOS_5D 17-05-59 0007x3")
        );
        assert_eq!(path("set{set}/{first}"), Path::new("set002/IMG_1"));
        let unknown = Values { camera: None, date_time: None, ..values() };
        assert_eq!(
            Template::parse("{date} {time} {camera}").unwrap().path(&unknown),
            Path::new("unknown unknown unknown")
        );
    }

    #[test]
    fn invalid_template_is_rejected_with_the_list_of_fields() {
        for (wrong, said) in [
            ("{lens}", "{folder}"),
            ("{first", "brace"),
            ("first}", "brace"),
            ("../{first}", "contains `..`"),
            ("/tmp/{first}", "begins with"),
            ("{folder}/", "ends without a file name"),
            ("", "ends without a file name"),
        ] {
            let error = Template::parse(wrong).unwrap_err();
            assert!(error.is_usage() && error.to_string().contains(said), "{wrong}: {error}");
        }
    }

    #[test]
    fn plain_names_are_plain() {
        assert_eq!(["a b/ü.jpg", "-x", ".x", "Canon EOS"].map(plain), ["a_b__.jpg", "_x", "_x", "Canon_EOS"]);
    }
}
