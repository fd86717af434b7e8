//! The directory of a TIFF: tags with their values, and the header that points to it.
//!
//! In: tags and values in any order. Out: little-endian bytes, for TIFF or BigTIFF. Cost: none to speak of.
//! Source: TIFF 6.0, section 2; BigTIFF (Aware Systems).

use super::one_line;
use std::collections::BTreeMap;

/// The tags that are written.
pub(super) mod tag {
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
    pub const PREDICTOR: u16 = 317;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const ICC: u16 = 34675;
}

const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const UNDEFINED: u16 = 7;
const LONG8: u16 = 16;

/// An image file directory: tags in rising order, each with its type, count and bytes.
#[derive(Debug)]
pub(super) struct Directory {
    pub(super) big: bool,
    entries: BTreeMap<u16, (u16, u64, Vec<u8>)>,
}

impl Directory {
    pub(super) fn new(big: bool) -> Self {
        let entries = BTreeMap::new();
        Directory { big, entries }
    }

    fn put(&mut self, tag: u16, kind: u16, count: u64, bytes: Vec<u8>) {
        self.entries.insert(tag, (kind, count, bytes));
    }

    pub(super) fn short(&mut self, tag: u16, values: &[u16]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.put(tag, SHORT, values.len() as u64, bytes);
    }

    pub(super) fn long(&mut self, tag: u16, values: &[u64]) {
        let bytes = values.iter().flat_map(|&v| self.word(v)).collect();
        self.put(tag, if self.big { LONG8 } else { LONG }, values.len() as u64, bytes);
    }

    pub(super) fn text(&mut self, tag: u16, text: Option<&str>) {
        let text = one_line(text.unwrap_or_default());
        if !text.is_empty() {
            self.put(tag, ASCII, text.len() as u64 + 1, [text.as_bytes(), &[0]].concat());
        }
    }

    pub(super) fn opaque(&mut self, tag: u16, bytes: &[u8]) {
        self.put(tag, UNDEFINED, bytes.len() as u64, bytes.to_vec());
    }

    /// An offset or count: 4 bytes, or 8 in BigTIFF.
    fn word(&self, value: u64) -> Vec<u8> {
        if self.big {
            value.to_le_bytes().to_vec()
        } else {
            // Sizes were weighed when the kind was chosen.
            (value as u32).to_le_bytes().to_vec()
        }
    }

    /// The first bytes of the file, which say where the directory is.
    pub(super) fn file_header(&self, place: u64) -> Vec<u8> {
        let magic: &[u8] = if self.big { b"II\x2b\0\x08\0\0\0" } else { b"II\x2a\0" };
        [magic, &self.word(place)].concat()
    }

    /// The directory as it stands at `place`, and behind it the values that are too long for their entries.
    pub(super) fn bytes(&self, place: u64) -> Vec<u8> {
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
        // No further directory.
        out.extend(self.word(0));
        out.extend(behind);
        out
    }
}
