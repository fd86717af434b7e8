//! The directory of a TIFF, which has tags with their values, and the file header, which points to the directory.
//!
//! In: tags and values in any order, and the capture data or EXIF fields. Out: little-endian bytes, for TIFF or
//! BigTIFF. Cost: negligible. Source: TIFF 6.0, sections 2 and 20 (chromaticities); BigTIFF (Aware Systems); EXIF
//! 2.32, section 4.6; libtiff (StoNits).

use crate::bracket::colour::Primaries;
use crate::write::exif::fraction;
use crate::write::metadata::{Metadata, one_line};
use ::exif::{Context, Field, Value};
use std::collections::BTreeMap;

/// The tags that are written.
pub(crate) mod tag {
    pub const WIDTH: u16 = 256;
    pub const HEIGHT: u16 = 257;
    pub const BITS: u16 = 258;
    pub const COMPRESSION: u16 = 259;
    pub const PHOTOMETRIC: u16 = 262;
    pub const DESCRIPTION: u16 = 270;
    pub const MAKE: u16 = 271;
    pub const MODEL: u16 = 272;
    pub const STRIP_OFFSETS: u16 = 273;
    pub const SAMPLES: u16 = 277;
    pub const ROWS_PER_STRIP: u16 = 278;
    pub const STRIP_COUNTS: u16 = 279;
    pub const PLANAR: u16 = 284;
    pub const SOFTWARE: u16 = 305;
    pub const DATE: u16 = 306;
    pub const PREDICTOR: u16 = 317;
    pub const WHITE_POINT: u16 = 318;
    pub const CHROMATICITIES: u16 = 319;
    pub const EXTRA_SAMPLES: u16 = 338;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const EXPOSURE_TIME: u16 = 33434;
    pub const F_NUMBER: u16 = 33437;
    pub const EXIF: u16 = 34665;
    pub const GPS: u16 = 34853;
    pub const ICC: u16 = 34675;
    pub const ISO: u16 = 34855;
    pub const EXIF_VERSION: u16 = 36864;
    pub const DATE_ORIGINAL: u16 = 36867;
    pub const FOCAL_LENGTH: u16 = 37386;
    pub const STONITS: u16 = 37439;
    pub const LENS_MODEL: u16 = 42036;
}

const BYTE: u16 = 1;
const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const RATIONAL: u16 = 5;
const UNDEFINED: u16 = 7;
const SIGNED_RATIONAL: u16 = 10;
const DOUBLE: u16 = 12;
const LONG8: u16 = 16;

/// An image file directory: tags in increasing order, each with its type, count and bytes.
#[derive(Debug)]
pub(crate) struct Directory {
    pub(crate) big: bool,
    entries: BTreeMap<u16, (u16, u64, Vec<u8>)>,
    /// The directories to which tags point: [`tag::EXIF`], [`tag::GPS`].
    others: BTreeMap<u16, Directory>,
}

impl Directory {
    pub(crate) fn new(big: bool) -> Self {
        Directory { big, entries: BTreeMap::new(), others: BTreeMap::new() }
    }

    /// Adds the capture data of the reference frame: camera and date and, in the EXIF directory, exposure and lens.
    /// The frame's size, orientation and location are not copied.
    pub(crate) fn capture(&mut self, metadata: &Metadata) {
        let capture = &metadata.capture;
        self.text(tag::DESCRIPTION, Some(&metadata.comments.join("; ")));
        self.text(tag::MAKE, capture.make.as_deref());
        self.text(tag::MODEL, capture.model.as_deref());
        self.text(tag::SOFTWARE, Some(&metadata.software));
        self.text(tag::DATE, capture.date.as_deref());
        let mut exif = Directory::new(self.big);
        let mut number = |tag, value: Option<f64>| {
            if let Some(value) = value.filter(|v| v.is_finite() && *v > 0.0) {
                exif.rational(tag, &[value]);
            }
        };
        number(tag::EXPOSURE_TIME, metadata.time_s);
        number(tag::F_NUMBER, metadata.f_number);
        number(tag::FOCAL_LENGTH, capture.focal_length_mm);
        match metadata.iso.map(f64::round) {
            // EXIF requires the value 65535 for sensitivities that do not fit into 16 bits.
            Some(iso) if iso >= 1.0 => exif.short(tag::ISO, &[iso.min(65535.0) as u16]),
            _ => {}
        }
        exif.text(tag::DATE_ORIGINAL, capture.date.as_deref());
        exif.text(tag::LENS_MODEL, capture.lens.as_deref());
        if !exif.entries.is_empty() {
            exif.opaque(tag::EXIF_VERSION, b"0232");
            self.others.insert(tag::EXIF, exif);
        }
    }

    /// Adds the EXIF fields of a picture, each to its directory.
    pub(crate) fn photograph(&mut self, fields: &[Field]) {
        for field in fields {
            let Some((kind, count, bytes)) = value(&field.value) else { continue };
            let pointer = match field.tag.context() {
                Context::Tiff => None,
                Context::Exif => Some(tag::EXIF),
                Context::Gps => Some(tag::GPS),
                _ => continue,
            };
            let big = self.big;
            let directory = match pointer {
                None => &mut *self,
                Some(pointer) => self.others.entry(pointer).or_insert_with(|| Directory::new(big)),
            };
            directory.put(field.tag.number(), kind, count, bytes);
        }
    }

    /// Adds the primaries and the white point.
    pub(crate) fn primaries(&mut self, primaries: &Primaries) {
        let Primaries { red, green, blue, white } = primaries;
        self.white_point(*white);
        self.rational(tag::CHROMATICITIES, &[*red, *green, *blue].concat());
    }

    pub(crate) fn white_point(&mut self, white: [f64; 2]) {
        self.rational(tag::WHITE_POINT, &white);
    }

    /// Adds a directory to which `pointer` points.
    pub(crate) fn other(&mut self, pointer: u16, directory: Directory) {
        self.others.insert(pointer, directory);
    }

    /// Adds bytes.
    pub(crate) fn bytes_of(&mut self, tag: u16, bytes: &[u8]) {
        self.put(tag, BYTE, bytes.len() as u64, bytes.to_vec());
    }

    /// Adds fractions with a sign, in units of a millionth.
    pub(crate) fn signed_rational(&mut self, tag: u16, values: &[f64]) {
        const UNIT: i32 = 1_000_000;
        let parts = values.iter().map(|&v| ((v * f64::from(UNIT)).round() as i32, UNIT));
        let bytes = parts.flat_map(|(n, d)| [n.to_le_bytes(), d.to_le_bytes()].concat()).collect();
        self.put(tag, SIGNED_RATIONAL, values.len() as u64, bytes);
    }

    pub(crate) fn rational(&mut self, tag: u16, values: &[f64]) {
        let parts = values.iter().map(|&v| fraction(v));
        let bytes = parts.flat_map(|(n, d)| [n.to_le_bytes(), d.to_le_bytes()].concat()).collect();
        self.put(tag, RATIONAL, values.len() as u64, bytes);
    }

    pub(crate) fn double(&mut self, tag: u16, value: f64) {
        self.put(tag, DOUBLE, 1, value.to_le_bytes().to_vec());
    }

    fn put(&mut self, tag: u16, kind: u16, count: u64, bytes: Vec<u8>) {
        self.entries.insert(tag, (kind, count, bytes));
    }

    pub(crate) fn short(&mut self, tag: u16, values: &[u16]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.put(tag, SHORT, values.len() as u64, bytes);
    }

    pub(crate) fn long(&mut self, tag: u16, values: &[u64]) {
        let bytes = values.iter().flat_map(|&v| self.word(v)).collect();
        self.put(tag, if self.big { LONG8 } else { LONG }, values.len() as u64, bytes);
    }

    pub(crate) fn text(&mut self, tag: u16, text: Option<&str>) {
        let text = one_line(text.unwrap_or_default());
        if !text.is_empty() {
            self.put(tag, ASCII, text.len() as u64 + 1, [text.as_bytes(), &[0]].concat());
        }
    }

    pub(crate) fn opaque(&mut self, tag: u16, bytes: &[u8]) {
        self.put(tag, UNDEFINED, bytes.len() as u64, bytes.to_vec());
    }

    /// Returns the bytes of an offset or a count: 4 bytes, or 8 in BigTIFF.
    fn word(&self, value: u64) -> Vec<u8> {
        if self.big {
            value.to_le_bytes().to_vec()
        } else {
            // The value fits into 32 bits: larger files are written as BigTIFF.
            (value as u32).to_le_bytes().to_vec()
        }
    }

    /// Returns the first bytes of the file, which contain the offset `place` of the directory.
    pub(crate) fn file_header(&self, place: u64) -> Vec<u8> {
        let magic: &[u8] = if self.big { b"II\x2b\0\x08\0\0\0" } else { b"II\x2a\0" };
        [magic, &self.word(place)].concat()
    }

    /// Returns the directory at offset `place`, followed by the values that do not fit into their entries, and the
    /// other directories.
    pub(crate) fn bytes(&mut self, place: u64) -> Vec<u8> {
        let others = std::mem::take(&mut self.others);
        // The offsets of the other directories are not known yet. They do not change the length of this directory, so
        // 0 is written first.
        others.keys().for_each(|&pointer| self.long(pointer, &[0]));
        let length = self.own_bytes(place).len().next_multiple_of(8);
        let mut behind = Vec::new();
        for (pointer, mut other) in others {
            let at = place + (length + behind.len()) as u64;
            self.long(pointer, &[at]);
            behind.extend(other.bytes(at));
            behind.resize(behind.len().next_multiple_of(8), 0);
        }
        let mut out = self.own_bytes(place);
        if !behind.is_empty() {
            out.resize(length, 0);
            out.extend(behind);
        }
        out
    }

    fn own_bytes(&self, place: u64) -> Vec<u8> {
        let word = if self.big { 8 } else { 4 };
        let count = self.entries.len() as u64;
        let count_bytes = if self.big { count.to_le_bytes().to_vec() } else { (count as u16).to_le_bytes().to_vec() };
        let length = count_bytes.len() + self.entries.len() * (4 + 2 * word) + word;
        let (mut out, mut behind) = (count_bytes, Vec::new());
        for (tag, (kind, count, bytes)) in &self.entries {
            out.extend_from_slice(&tag.to_le_bytes());
            out.extend_from_slice(&kind.to_le_bytes());
            out.extend(self.word(*count));
            if bytes.len() <= word {
                out.extend_from_slice(bytes);
                out.resize(out.len() + word - bytes.len(), 0);
            } else {
                out.extend(self.word(place + (length + behind.len()) as u64));
                behind.extend_from_slice(bytes);
                behind.resize(behind.len().next_multiple_of(8), 0);
            }
        }
        // 0 means that no further directory follows.
        out.extend(self.word(0));
        out.extend(behind);
        out
    }
}

/// Returns the type, the count and the bytes of a field's value, or `None` for a type that EXIF does not have.
fn value(value: &Value) -> Option<(u16, u64, Vec<u8>)> {
    let fractions = |n: u32, d: u32| [n.to_le_bytes(), d.to_le_bytes()].concat();
    let (kind, size, bytes): (u16, usize, Vec<u8>) = match value {
        Value::Byte(v) => (1, 1, v.clone()),
        Value::Ascii(lines) => (ASCII, 1, lines.iter().flat_map(|line| [line, &[0][..]].concat()).collect()),
        Value::Short(v) => (SHORT, 2, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Value::Long(v) => (LONG, 4, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Value::Rational(v) => (RATIONAL, 8, v.iter().flat_map(|v| fractions(v.num, v.denom)).collect()),
        Value::SByte(v) => (6, 1, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Value::Undefined(v, _) => (UNDEFINED, 1, v.clone()),
        Value::SShort(v) => (8, 2, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Value::SLong(v) => (9, 4, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Value::SRational(v) => (10, 8, v.iter().flat_map(|v| fractions(v.num as u32, v.denom as u32)).collect()),
        Value::Float(v) => (11, 4, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Value::Double(v) => (DOUBLE, 8, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Value::Unknown(..) => return None,
    };
    Some((kind, (bytes.len() / size) as u64, bytes))
}
