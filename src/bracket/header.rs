//! Reads the header of a photograph without decoding its pixels.
//!
//! In: a path. Out: a [`Header`]: the size that the decoder would return, camera, time, exposure, and bracketing data.
//! Cost: 0.1 ms; 10 to 60 kB are read, with seeks. (The chunks of a PNG may be short; then
//! the whole file is read.) Source: EXIF 2.32, sections 4.6.4 and 4.6.5. Canon's maker note
//! contains the position in an automatic bracket and the serial number: P. Harvey's ExifTool, "Canon Tags".

use super::Capture;
use super::decode;
use super::exposure::{ExposureTags, first_number};
use crate::bracket::metadata::capture::ascii;
pub use crate::bracket::metadata::moment::Moment;
use crate::bracket::metadata::moment::taken;
use crate::error::Result;
use crate::intake;
use crate::limits::Limits;
use exif::{Exif, In, Tag, Value};
use std::io::{Read, Seek};
use std::path::Path;

/// How the exposure was set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExposureMode {
    /// Automatic bracketing, according to EXIF ExposureMode or to a non-zero bracket value in Canon's maker note.
    AutoBracket,
    /// Manual exposure.
    Manual,
    /// Automatic exposure.
    Automatic,
}

/// Header data of a photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// Width in pixels, orientation applied.
    pub width: usize,
    /// Height in pixels, orientation applied.
    pub height: usize,
    /// Bits per sample: 8 or 16; 32 in a float TIFF that hdralign wrote.
    pub depth: u8,
    /// Make and model as one text.
    pub camera: Option<String>,
    /// EXIF Make.
    pub make: Option<String>,
    /// EXIF Model.
    pub model: Option<String>,
    /// Serial number of the camera body.
    pub serial: Option<String>,
    /// EXIF LensModel.
    pub lens: Option<String>,
    /// EXIF FocalLength, in millimetres.
    pub focal_length_mm: Option<f64>,
    /// Time of the exposure.
    pub taken: Option<Moment>,
    /// Exposure tags.
    pub exposure: ExposureTags,
    /// Exposure compensation, in stops.
    pub bias_stops: Option<f64>,
    /// How the exposure was set, where known.
    pub mode: Option<ExposureMode>,
    /// Offset in stops from the middle of an automatic bracket, from Canon's maker note.
    pub bracket_stops: Option<f64>,
    /// The program that wrote the file.
    pub software: Option<String>,
}

/// The tags read for a header. From a TIFF, only these tags are read, one by one.
const WANTED: [Tag; 25] = [
    Tag::Make,
    Tag::Model,
    Tag::Orientation,
    Tag::Software,
    Tag::DateTime,
    Tag::DateTimeOriginal,
    Tag::DateTimeDigitized,
    Tag::SubSecTime,
    Tag::SubSecTimeOriginal,
    Tag::SubSecTimeDigitized,
    Tag::ExposureTime,
    Tag::ShutterSpeedValue,
    Tag::FNumber,
    Tag::ApertureValue,
    Tag::PhotographicSensitivity,
    Tag::ISOSpeed,
    Tag::RecommendedExposureIndex,
    Tag::StandardOutputSensitivity,
    Tag::ExposureIndex,
    Tag::ExposureBiasValue,
    Tag::ExposureMode,
    Tag::Flash,
    Tag::FocalLength,
    Tag::LensModel,
    Tag::BodySerialNumber,
];

impl Header {
    /// Reads the header of the photograph `path` within `limits`.
    ///
    /// # Errors
    /// [`Error::Read`](crate::error::Error::Read) where the file cannot be read.
    /// [`Error::UnknownFormat`](crate::error::Error::UnknownFormat) and [`Error::Decode`](crate::error::Error::Decode)
    /// where the decoder would also reject the kind or size of the image. The kind of image is not checked for results
    /// of hdralign.
    pub fn read(path: &Path, limits: &Limits) -> Result<Self> {
        Header::of(path, intake::open_regular(path)?, limits)
    }

    /// Same as [`read`](Self::read), from `file`, the content of the file `path`.
    pub(super) fn of(path: &Path, file: impl Read + Seek, limits: &Limits) -> Result<Self> {
        let head = decode::head(path, file, &WANTED, limits)?;
        let exif = head.exif.as_ref();
        let text = |tag| exif.and_then(|e| ascii(e, tag));
        let notes = exif.and_then(Canon::read).unwrap_or_default();
        let named = Capture { make: text(Tag::Make), model: text(Tag::Model), ..Capture::default() };
        let mode = match number(exif, Tag::ExposureMode) {
            _ if notes.bracket_stops.is_some_and(|stops| stops != 0.0) => Some(ExposureMode::AutoBracket),
            Some(0.0) => Some(ExposureMode::Automatic),
            Some(1.0) => Some(ExposureMode::Manual),
            Some(2.0) => Some(ExposureMode::AutoBracket),
            _ => None,
        };
        let header = Header {
            width: head.width,
            height: head.height,
            depth: head.depth,
            camera: named.camera(),
            make: named.make,
            model: named.model,
            serial: text(Tag::BodySerialNumber).or(notes.serial),
            lens: text(Tag::LensModel),
            focal_length_mm: number(exif, Tag::FocalLength).filter(|&f| f > 0.0),
            taken: taken(&text),
            exposure: exif.map(ExposureTags::read).unwrap_or_default(),
            bias_stops: number(exif, Tag::ExposureBiasValue).filter(|bias| bias.abs() <= 20.0),
            mode,
            bracket_stops: notes.bracket_stops,
            software: text(Tag::Software).or(head.software),
        };
        match head.refused {
            Some(refused) if !header.is_ours() => Err(refused),
            _ => Ok(header),
        }
    }

    /// Whether the file is a result of hdralign, according to the program and version in its Software tag.
    pub fn is_ours(&self) -> bool {
        let version = self.software.as_deref().and_then(|by| by.strip_prefix(concat!(env!("CARGO_PKG_NAME"), " ")));
        version.is_some_and(|version| version.starts_with(|c: char| c.is_ascii_digit()))
    }

    /// Relative exposure in EV, as written; `None` where the file has no exposure time.
    pub fn ev(&self) -> Option<f64> {
        self.exposure.ev()
    }
}

fn number(exif: Option<&Exif>, tag: Tag) -> Option<f64> {
    exif.and_then(|e| first_number(&e.get_field(tag, In::PRIMARY)?.value))
}

/// Values from Canon's maker note, which is a TIFF directory whose offsets count from the start of the EXIF block.
#[derive(Default)]
struct Canon {
    bracket_stops: Option<f64>,
    serial: Option<String>,
}

impl Canon {
    fn read(exif: &Exif) -> Option<Self> {
        if !ascii(exif, Tag::Make)?.starts_with("Canon") {
            return None;
        }
        let Value::Undefined(note, at) = &exif.get_field(Tag::MakerNote, In::PRIMARY)?.value else { return None };
        let (block, is_little) = (exif.buf(), exif.little_endian());
        let short = |at: usize| {
            let bytes = [*block.get(at)?, *block.get(at + 1)?];
            Some(if is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
        };
        let long = |at: usize| {
            let (first, second) = (u32::from(short(at)?), u32::from(short(at + 2)?));
            Some(if is_little { first | second << 16 } else { first << 16 | second })
        };
        let begin = *at as usize;
        let count = usize::from(short(begin)?).min(note.len() / 12);
        let entry = |tag: u16| (0..count).map(|i| begin + 2 + 12 * i).find(|&at| short(at) == Some(tag));
        // ShotInfo (tag 4) is an array of 16-bit integers; the integer at index 17 is AEBBracketValue.
        let bracket_stops = || {
            let entry = entry(4)?;
            let is_there = short(entry + 2)? == 3 && long(entry + 4)? > 17;
            let value = short(long(entry + 8)? as usize + 2 * 17)?.cast_signed();
            is_there.then_some(canon_stops(value)).filter(|stops| stops.abs() <= 20.0)
        };
        let serial = || {
            let entry = entry(12)?;
            Some(long(entry + 8)?.to_string()).filter(|_| short(entry + 2) == Some(4) && long(entry + 4) == Some(1))
        };
        Some(Canon { bracket_stops: bracket_stops(), serial: serial() })
    }
}

/// Converts an exposure offset of Canon's maker note to stops. The unit is 1/32 stop, but the remainders 12 and 20
/// stand for exactly one and two thirds of a stop.
fn canon_stops(value: i16) -> f64 {
    let (whole, part) = (value.unsigned_abs() & !31, value.unsigned_abs() & 31);
    let part = match part {
        12 => 32.0 / 3.0,
        20 => 64.0 / 3.0,
        other => f64::from(other),
    };
    (f64::from(whole) + part).copysign(f64::from(value)) / 32.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the EXIF of a Canon whose maker note has a serial number, and points to ShotInfo at the offset `at` from
    /// the start of the EXIF block.
    fn canon(at: u32, bracket: i16) -> Exif {
        let mut note = 2_u16.to_be_bytes().to_vec();
        let entry = |tag: u16, kind: u16, count: u32, value: u32| {
            [&tag.to_be_bytes()[..], &kind.to_be_bytes(), &count.to_be_bytes(), &value.to_be_bytes()].concat()
        };
        note.extend(entry(4, 3, 33, at));
        note.extend(entry(12, 4, 1, 1_130_415_723));
        note.extend((0..33).flat_map(|i| if i == 17 { bracket.to_be_bytes() } else { [0, 9] }));
        let make = Value::Ascii(vec![b"Canon".to_vec()]);
        let fields = [(Tag::Make, make), (Tag::MakerNote, Value::Undefined(note, 0))];
        exif::Reader::new().read_raw(decode::tests::exif_bytes(&fields)).unwrap()
    }

    #[test]
    fn position_in_the_bracket_is_read_from_canon_maker_notes() {
        let unplaced = canon(0, 0);
        let Value::Undefined(_, begin) = unplaced.get_field(Tag::MakerNote, In::PRIMARY).unwrap().value else {
            panic!()
        };
        let read = |value: i16| Canon::read(&canon(begin + 2 + 2 * 12, value)).unwrap();
        for (value, stops) in [(0, 0.0), (-32, -1.0), (64, 2.0), (12, 1.0 / 3.0), (-52, -5.0 / 3.0), (16, 0.5)] {
            assert!((read(value).bracket_stops.unwrap() - stops).abs() < 1e-12, "{value}");
        }
        assert_eq!(read(0).serial.as_deref(), Some("1130415723"));
        // Offsets outside the block are ignored.
        assert_eq!(Canon::read(&canon(u32::MAX - 40, 32)).unwrap().bracket_stops, None);
    }
}
