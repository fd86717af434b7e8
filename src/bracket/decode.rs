//! Decoding: the bytes of a file to code values, oriented, with the metadata that came along.
//!
//! In: a JPEG, PNG or TIFF, known by its content and never by its name. Out: interleaved RGB at the file's own depth, 8 or 16 bit;
//! grey is repeated, alpha dropped (a bracket has no background to be laid over), CMYK taken to RGB without its profile.
//! Cost: that of the decoders; 8-bit samples are written once, 16-bit ones once more, and once more again where the EXIF turns the picture.
//!
//! Damage is an error, never a grey filler: what could not be decoded was never photographed.

mod fields;
mod jpeg;
mod orient;
mod png;
mod sniff;
mod tiff;

use super::Samples;
use crate::error::{Error, Result};
use crate::limits::Limits;
use exif::{Exif, In, Tag};
use sniff::Format;
use std::io::{BufRead, BufReader, Read, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// A decoded file: pixels as they are to be seen, and its metadata unread.
pub(super) struct Decoded {
    /// In pixels, orientation applied.
    pub width: usize,
    /// In pixels, orientation applied.
    pub height: usize,
    /// Interleaved RGB.
    pub samples: Samples,
    /// Bytes that it took while it was decoded, with the file.
    pub decoding: u64,
    /// What EXIF there is.
    pub exif: Option<Exif>,
    /// An RGB or unknown ICC profile, as found.
    pub icc: Option<Vec<u8>>,
    /// Whether the file has alpha, which is left out.
    pub has_alpha: bool,
    /// What was ignored, in words.
    pub notes: Vec<String>,
}

/// What a format's decoder gives: the picture as stored.
struct Stored {
    width: usize,
    height: usize,
    samples: Samples,
    /// Bytes that it took while it was decoded, with the file.
    decoding: u64,
    /// EXIF from its TIFF header on; a TIFF file is its own.
    exif: Option<Vec<u8>>,
    /// Which directory of that block is the picture's: 0, unless the first is a thumbnail's.
    directory: u16,
    icc: Option<Vec<u8>>,
    /// Whether there was more than colour.
    has_alpha: bool,
    /// What was ignored, in words.
    notes: Vec<String>,
}

/// Why a file was refused, in words for [`Error::Decode`].
type Reason = String;

/// Whether `begin`, the first bytes of the file `path`, are those of a format that is decoded.
///
/// # Errors
/// [`Error::UnknownFormat`].
pub(super) fn check_format(path: &Path, begin: &[u8]) -> Result<()> {
    sniff::format(begin).map(|_| ()).map_err(|found| Error::UnknownFormat { path: path.into(), found })
}

/// Decodes `bytes`, the content of the file `path`, if it asks for no more than `limits`.
///
/// # Errors
/// [`Error::UnknownFormat`] with what the content looks like; [`Error::Decode`] for damage, unsupported kinds and excessive sizes.
pub(super) fn decode(path: &Path, bytes: Vec<u8>, limits: &Limits) -> Result<Decoded> {
    let format = sniff::format(&bytes).map_err(|found| Error::UnknownFormat { path: path.into(), found })?;
    // The decoders are other people's; should one of them panic on a damaged file, that is this file's fault, not the run's.
    let stored = catch_unwind(AssertUnwindSafe(|| match format {
        Format::Jpeg => jpeg::decode(bytes, limits),
        Format::Png => png::decode(&bytes, limits),
        Format::Tiff => tiff::decode(bytes, limits),
    }))
    .unwrap_or_else(|_| Err("the content is damaged beyond what its decoder can tell; copy the file again".into()))
    .map_err(|reason| Error::Decode { path: path.into(), format: format.name(), reason })?;

    let mut notes = stored.notes;
    let exif = stored.exif.and_then(|raw| {
        let exif = fields::parsed(raw, stored.directory);
        if exif.is_none() {
            notes.push("its EXIF is damaged and was ignored".into());
        }
        exif
    });
    let turn = orientation(exif.as_ref());
    let (samples, width, height) = orient::apply(stored.samples, stored.width, stored.height, turn);
    // Where it is turned it is there twice.
    let turning = if turn == 1 { 0 } else { 2 * samples.bytes() };
    Ok(Decoded {
        width,
        height,
        samples,
        decoding: stored.decoding.max(turning),
        exif,
        icc: stored.icc,
        has_alpha: stored.has_alpha,
        notes,
    })
}

fn orientation(exif: Option<&Exif>) -> u32 {
    exif.and_then(|e| e.get_field(Tag::Orientation, In::PRIMARY)?.value.get_uint(0)).unwrap_or(1)
}

/// What a file says of itself before its picture.
pub(super) struct Head {
    /// In pixels, orientation applied: as [`decode`] gives it.
    pub width: usize,
    /// In pixels, orientation applied.
    pub height: usize,
    /// Bits per sample; fewer than 8 count as 8.
    pub depth: u8,
    /// What EXIF there is.
    pub exif: Option<Exif>,
    /// The program that the file names outside of its EXIF.
    pub software: Option<String>,
    /// Why [`decode`] would refuse it for its kind.
    pub refused: Option<Error>,
}

/// What a format's walk finds.
struct Found {
    width: usize,
    height: usize,
    depth: u8,
    exif: Option<Vec<u8>>,
    software: Option<String>,
    refused: Option<Reason>,
}

/// Bytes read at a time: the EXIF of most cameras is a few times as long, the way from chunk to chunk much shorter.
const AT_ONCE: usize = 8192;

/// Reads what `file`, the content of the file `path`, says of itself, without its pixels; of the EXIF of a TIFF, the `wanted` tags. Damage of
/// the pixels is not seen.
///
/// # Errors
/// [`Error::Read`]; [`Error::UnknownFormat`]; [`Error::Decode`] where the size cannot be told, is none or is more than `limits` has.
pub(super) fn head(path: &Path, file: impl Read + Seek, wanted: &[Tag], limits: &Limits) -> Result<Head> {
    let unreadable = |source| Error::Read { path: path.into(), source };
    let mut reader = BufReader::with_capacity(AT_ONCE, file);
    let begin = reader.fill_buf().map_err(unreadable)?;
    let format = sniff::format(begin).map_err(|found| Error::UnknownFormat { path: path.into(), found })?;
    let error = |reason| Error::Decode { path: path.into(), format: format.name(), reason };
    let found = catch_unwind(AssertUnwindSafe(|| match format {
        Format::Jpeg => jpeg::head(&mut reader),
        Format::Png => png::head(&mut reader),
        Format::Tiff => tiff::head(&mut reader, wanted),
    }))
    .unwrap_or_else(|_| Err("the content is damaged beyond what its decoder can tell; copy the file again".into()))
    .map_err(error)?;
    limits.check_size(found.width, found.height).map_err(error)?;
    let exif = found.exif.and_then(|raw| fields::parsed(raw, 0));
    let (width, height) = match orientation(exif.as_ref()) {
        5..=8 => (found.height, found.width),
        _ => (found.width, found.height),
    };
    let refused = found.refused.map(error);
    Ok(Head { width, height, depth: found.depth, exif, software: found.software, refused })
}

/// Interleaved RGB from interleaved pixels of `channels`: grey, grey + alpha, RGB or RGB + alpha.
fn to_rgb<T: Copy>(values: Vec<T>, channels: usize) -> Vec<T> {
    match channels {
        1 | 2 => values.chunks_exact(channels).flat_map(|p| [p[0]; 3]).collect(),
        3 => values,
        _ => values.chunks_exact(channels).flat_map(|p| [p[0], p[1], p[2]]).collect(),
    }
}

/// RGB from CMYK inks, of which `max` is full cover, with no profile: each ink takes away its complement.
fn cmyk_to_rgb<T: Copy + Into<u32> + TryFrom<u32>>(inks: &[T], channels: usize, max: u32) -> Vec<T> {
    let light = |ink: T, black: T| {
        let product = (max - ink.into()) as u64 * (max - black.into()) as u64;
        let value = ((product + u64::from(max) / 2) / u64::from(max)) as u32;
        T::try_from(value).unwrap_or(ink)
    };
    inks.chunks_exact(channels).flat_map(|p| [light(p[0], p[3]), light(p[1], p[3]), light(p[2], p[3])]).collect()
}

#[cfg(test)]
pub(super) mod tests;
