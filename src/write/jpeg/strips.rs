//! Baseline JPEG: 8-bit RGB as YCbCr at full resolution, in independent strips of 64 rows.
//!
//! In: rows of codes. Out: a baseline JPEG. Cost: 15 ns per pixel and core. Source: ITU-T T.81, annex B (markers),
//! E.1.4 (restart intervals), K.3 (the Huffman tables); JFIF 1.02. Pictures are encoded by the `jpeg-encoder` crate.
//!
//! Strips are encoded in parallel as separate pictures, and the data of each strip become one restart interval of the
//! file. So the bytes are the same on any number of threads.

use crate::bracket::colour::Profile;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use std::io;
use std::ops::Range;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Longest side of a picture, in pixels. The format allows 65535, most decoders (libjpeg) 65500.
pub const MOST_SIDE: usize = 65_500;

/// A complete JPEG of some rows, which can be decoded separately.
#[derive(Debug)]
pub(super) struct Strip {
    bytes: Vec<u8>,
    /// The segments of the quantisation and Huffman tables, one after the other.
    tables: Vec<u8>,
    /// Range of the entropy-coded data in `bytes`.
    data: Range<usize>,
}

impl Strip {
    /// Encodes complete rows of `width` pixels; `quality` is 1..=100.
    pub(super) fn encode(pixels: &[[u8; 3]], width: usize, quality: u8) -> io::Result<Self> {
        let side =
            |n: usize| u16::try_from(n).map_err(|_| io::Error::other("a side of a JPEG has at most 65535 pixels"));
        let mut bytes = Vec::with_capacity(pixels.len());
        let mut encoder = Encoder::new(&mut bytes, quality);
        encoder.set_sampling_factor(SamplingFactor::F_1_1);
        let (columns, rows) = (side(width)?, side(pixels.len() / width.max(1))?);
        encoder.encode(pixels.as_flattened(), columns, rows, ColorType::Rgb).map_err(io::Error::other)?;
        let mut tables = Vec::new();
        let start = scan(&bytes, &mut tables)
            .ok_or_else(|| io::Error::other("internal error: the JPEG encoder wrote no image data"))?;
        // The end marker follows the data.
        let data = start..bytes.len().saturating_sub(2).max(start);
        Ok(Strip { bytes, tables, data })
    }

    /// Returns the pixels that a reader of the file decodes. They are the same on any processor.
    pub(super) fn decoded(&self) -> io::Result<Vec<u8>> {
        // `new_safe` decodes without vector instructions. This takes the same time, because most of the time is spent
        // on entropy decoding.
        let options = DecoderOptions::new_safe()
            .set_strict_mode(true)
            .set_max_width(usize::from(u16::MAX))
            .set_max_height(usize::from(u16::MAX))
            .jpeg_set_out_colorspace(ColorSpace::RGB);
        let damaged = |e: zune_jpeg::errors::DecodeErrors| io::Error::other(e.to_string());
        JpegDecoder::new_with_options(ZCursor::new(&self.bytes), options).decode().map_err(damaged)
    }
}

/// Appends the segments of tables to `tables`, and returns the position of the first byte of data.
fn scan(bytes: &[u8], tables: &mut Vec<u8>) -> Option<usize> {
    let mut at = 2;
    loop {
        let &[0xFF, code, high, low] = bytes.get(at..at + 4)? else { return None };
        let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        match code {
            DQT | DHT => tables.extend_from_slice(bytes.get(at..end)?),
            SOS => return Some(end),
            _ => {}
        }
        at = end;
    }
}

const SOF0: u8 = 0xC0;
const DHT: u8 = 0xC4;
const RST0: u8 = 0xD0;
const SOI: u8 = 0xD8;
const EOI: u8 = 0xD9;
const SOS: u8 = 0xDA;
const DQT: u8 = 0xDB;
const DRI: u8 = 0xDD;
/// Application segments: `APP0` for JFIF, `APP1` and `APP2` for content that begins with a name.
pub(super) const APP0: u8 = 0xE0;
pub(super) const APP1: u8 = 0xE1;
pub(super) const APP2: u8 = 0xE2;

/// Appends a segment with the marker code `code` and the content `parts`, one after the other.
///
/// # Errors
/// An error if the segment would be longer than the format allows.
pub(super) fn put_segment(code: u8, parts: &[&[u8]], out: &mut Vec<u8>) -> io::Result<()> {
    let length = 2 + parts.iter().map(|part| part.len()).sum::<usize>();
    let length = u16::try_from(length).map_err(|_| {
        io::Error::other("a part of the metadata is too long for a segment of a JPEG, which has at most 65533 bytes")
    })?;
    out.extend_from_slice(&[0xFF, code]);
    out.extend_from_slice(&length.to_be_bytes());
    parts.iter().for_each(|part| out.extend_from_slice(part));
    Ok(())
}

/// Appends the JFIF segment: square pixels of no stated size.
pub(super) fn put_jfif(out: &mut Vec<u8>) -> io::Result<()> {
    put_segment(APP0, &[b"JFIF\0\x01\x02\0\0\x01\0\x01\0\0"], out)
}

/// Appends `profile`, in as many segments as necessary (ICC.1:2022, B.4).
pub(super) fn put_profile(profile: &Profile, out: &mut Vec<u8>) -> io::Result<()> {
    let parts: Vec<&[u8]> = profile.icc.chunks(65_519).collect();
    let count = u8::try_from(parts.len()).map_err(|_| io::Error::other("the colour profile is too large for JPEG"))?;
    for (number, part) in (1u8..).zip(parts) {
        put_segment(APP2, &[b"ICC_PROFILE\0", &[number, count], part], out)?;
    }
    Ok(())
}

/// A JPEG to which strips are added from the top.
#[derive(Debug)]
pub(super) struct Strips {
    size: (usize, usize),
    /// Number of rows of every strip except the last, a multiple of eight.
    rows: usize,
    tables: Vec<u8>,
    data: Vec<u8>,
    count: usize,
}

impl Strips {
    pub(super) fn new(size: (usize, usize), rows: usize) -> Self {
        Strips { size, rows, tables: Vec::new(), data: Vec::new(), count: 0 }
    }

    /// Adds the next strip.
    pub(super) fn push(&mut self, strip: &Strip) {
        if self.count == 0 {
            self.tables.clone_from(&strip.tables);
        } else {
            self.data.extend_from_slice(&[0xFF, RST0 + ((self.count - 1) % 8) as u8]);
        }
        self.data.extend_from_slice(&strip.bytes[strip.data.clone()]);
        self.count += 1;
    }

    /// Returns the size in bytes of the file that [`end`](Self::end) returns, without the application segments.
    pub(super) fn bytes_without_segments(&self) -> usize {
        // SOI, the tables, SOF0 of three components, DRI, SOS of three components, the data, EOI.
        2 + self.tables.len() + 19 + 6 + 14 + self.data.len() + 2
    }

    /// Returns the file, with `segments` before the tables, in two parts, so that the data need not be copied.
    pub(super) fn end(self, segments: &[u8]) -> io::Result<[Vec<u8>; 2]> {
        let side =
            |n: usize| u16::try_from(n).map_err(|_| io::Error::other("a side of a JPEG has at most 65535 pixels"));
        let (width, height) = (side(self.size.0)?, side(self.size.1)?);
        let interval = side(self.size.0.div_ceil(8) * self.rows.min(self.size.1.next_multiple_of(8)) / 8)?;
        let mut head = vec![0xFF, SOI];
        head.extend_from_slice(segments);
        head.extend_from_slice(&self.tables);
        // Three components, not subsampled. The first component uses the first tables, the other two use the second
        // tables.
        let components = [1, 0x11, 0, 2, 0x11, 1, 3, 0x11, 1];
        put_segment(SOF0, &[&[8], &height.to_be_bytes(), &width.to_be_bytes(), &[3], &components], &mut head)?;
        put_segment(DRI, &[&interval.to_be_bytes()], &mut head)?;
        put_segment(SOS, &[&[3, 1, 0, 2, 0x11, 3, 0x11, 0, 63, 0]], &mut head)?;
        let mut data = self.data;
        data.extend_from_slice(&[0xFF, EOI]);
        Ok([head, data])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::Plane;

    fn picture(width: usize, height: usize) -> Plane<[u8; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [(x * 2) as u8, (y * 3) as u8, ((x * 7919 + y * 104_729) % 61) as u8];
            }
        })
    }

    /// The decoded pixels of the strips must be those that a reader of the file decodes, because the gain map is
    /// computed from the decoded strips.
    #[test]
    fn another_decoder_reads_the_strips() {
        for (width, height) in [(1, 1), (9, 64), (50, 65), (131, 64 * 11 + 9)] {
            let picture = picture(width, height);
            let (mut strips, mut own) = (Strips::new((width, height), 64), Vec::new());
            for pixels in picture.as_slice().chunks(64 * width) {
                let strip = Strip::encode(pixels, width, 90).unwrap();
                own.extend(strip.decoded().unwrap());
                strips.push(&strip);
            }
            let mut segments = Vec::new();
            put_jfif(&mut segments).unwrap();
            let expected = strips.bytes_without_segments() + segments.len();
            let file = strips.end(&segments).unwrap().concat();
            assert_eq!(file.len(), expected);
            let whole = image::load_from_memory(&file).unwrap().to_rgb8();
            assert_eq!(whole.dimensions(), (width as u32, height as u32));
            assert!(whole.as_raw() == &own, "{width}x{height}");
            // Quantisation steps at quality 90 are at most 24; the mean error is far smaller.
            let far =
                own.iter().zip(picture.as_slice().as_flattened()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>();
            assert!(far < 12 * own.len() as u64, "{far}");
        }
    }

    #[test]
    fn long_content_is_cut_where_it_can_be_and_refused_where_not() {
        let profile = |bytes| Profile { icc: vec![1; bytes], description: String::new(), primaries: None };
        let mut out = Vec::new();
        put_profile(&profile(65_519 * 2 + 7), &mut out).unwrap();
        let starts: Vec<usize> =
            out.windows(13).enumerate().filter(|(_, w)| w.starts_with(b"ICC_PROFILE\0")).map(|(i, _)| i).collect();
        assert_eq!(starts, [4, 4 + 65_537, 4 + 2 * 65_537]);
        assert!(starts.iter().enumerate().all(|(i, &at)| out[at + 12..at + 14] == [i as u8 + 1, 3]));
        assert!(put_segment(APP1, &[&[0; 65_533]], &mut out).is_ok());
        assert!(put_segment(APP1, &[&[0; 65_534]], &mut out).is_err());
        assert!(put_profile(&profile(65_519 * 256), &mut out).is_err());
    }
}
