//! Decodes image files to pixel values with the orientation applied, and reads their metadata.
//!
//! In: a JPEG, PNG, TIFF or DNG, recognised by its content and not by its name. Out: interleaved RGB at the depth of
//! the file, 8 or 16 bits; grey is repeated, alpha dropped, CMYK converted to RGB without its profile; a DNG is
//! developed. Cost: the decoders, one copy for 16-bit samples, and another copy where the orientation is not 1.
//!
//! Damage is an error; missing image data is never replaced by a filler.

mod fields;
mod jpeg;
mod orient;
mod png;
mod sniff;
mod tiff;

use super::{Raw, Samples};
use crate::error::{Error, Result};
use crate::limits::Limits;
use exif::{Exif, In, Tag};
use sniff::Format;
use std::io::{BufRead, BufReader, Read, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// A decoded file: pixel values with the orientation applied, and metadata not yet interpreted.
pub(super) struct Decoded {
    /// Width in pixels, orientation applied.
    pub width: usize,
    /// Height in pixels, orientation applied.
    pub height: usize,
    /// Interleaved RGB.
    pub samples: Samples,
    /// Memory in bytes needed to decode the file, including the bytes of the file.
    pub decoding: u64,
    /// EXIF of the file, if any.
    pub exif: Option<Exif>,
    /// The ICC profile of the file, or one made from the colour chunks of a PNG; not yet parsed.
    pub icc: Option<Vec<u8>>,
    /// Whether the file has an alpha channel, which is dropped.
    pub has_alpha: bool,
    /// What a camera raw file shows, orientation applied; none for other files.
    pub raw: Option<Raw>,
    /// Descriptions of the metadata that was ignored.
    pub notes: Vec<String>,
}

/// Result of a decoder: the image as stored.
struct Stored {
    width: usize,
    height: usize,
    samples: Samples,
    /// Memory in bytes needed to decode the file, including the bytes of the file.
    decoding: u64,
    /// EXIF block from its TIFF header on; for a TIFF, the whole file.
    exif: Option<Vec<u8>>,
    /// Index of the directory of `exif` that describes the image: 0 unless the first directory describes a thumbnail.
    directory: u16,
    icc: Option<Vec<u8>>,
    /// Whether the file has an alpha channel, which is dropped.
    has_alpha: bool,
    /// What a camera raw file shows; none for other files.
    raw: Option<Raw>,
    /// Descriptions of the metadata that was ignored.
    notes: Vec<String>,
}

/// Why a file was rejected; the text of [`Error::Decode`].
type Reason = String;

/// Checks that `begin`, the first bytes of the file `path`, belong to a supported format.
///
/// # Errors
/// [`Error::UnknownFormat`].
pub(super) fn check_format(path: &Path, begin: &[u8]) -> Result<()> {
    sniff::format(begin).map(|_| ()).map_err(|found| Error::UnknownFormat { path: path.into(), found })
}

/// Decodes `bytes`, the content of the file `path`, within `limits`.
///
/// # Errors
/// [`Error::UnknownFormat`], which describes what the content looks like; [`Error::Decode`] for damage, unsupported
/// kinds and excessive sizes.
pub(super) fn decode(path: &Path, bytes: Vec<u8>, limits: &Limits) -> Result<Decoded> {
    let format = sniff::format(&bytes).map_err(|found| Error::UnknownFormat { path: path.into(), found })?;
    // A decoder that panics on a damaged file must fail that file only.
    let stored = catch_unwind(AssertUnwindSafe(|| match format {
        Format::Jpeg => jpeg::decode(bytes, limits),
        Format::Png => png::decode(&bytes, limits),
        Format::Tiff => tiff::decode(bytes, limits),
    }))
    .unwrap_or_else(|_| {
        Err("the content is damaged in a way that the decoder does not recognise; copy the file again".into())
    })
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
    // While the orientation is applied, two copies of the samples are in memory: the stored and the upright one.
    let turning = if turn == 1 { 0 } else { 2 * samples.bytes() };
    Ok(Decoded {
        width,
        height,
        samples,
        decoding: stored.decoding.max(turning),
        exif,
        icc: stored.icc,
        has_alpha: stored.has_alpha,
        raw: stored.raw.map(|raw| orient::turned(raw, (stored.width, stored.height), turn)),
        notes,
    })
}

fn orientation(exif: Option<&Exif>) -> u32 {
    exif.and_then(|e| e.get_field(Tag::Orientation, In::PRIMARY)?.value.get_uint(0)).unwrap_or(1)
}

/// Header data of a file.
pub(super) struct Head {
    /// Width in pixels, orientation applied: the same as from [`decode`].
    pub width: usize,
    /// Height in pixels, orientation applied.
    pub height: usize,
    /// Bits per sample; fewer than 8 count as 8.
    pub depth: u8,
    /// EXIF of the file, if any.
    pub exif: Option<Exif>,
    /// The program that wrote the file, where it is named outside of EXIF.
    pub software: Option<String>,
    /// Why [`decode`] would reject this kind of image, if it would.
    pub refused: Option<Error>,
}

/// Header data found by the reader of a format.
struct Found {
    width: usize,
    height: usize,
    depth: u8,
    exif: Option<Vec<u8>>,
    software: Option<String>,
    refused: Option<Reason>,
}

/// Number of bytes read at a time. Many chunk headers fit into it; most EXIF blocks are larger.
const AT_ONCE: usize = 8192;

/// Reads the header of `file`, the content of the file `path`, without decoding pixels. From the EXIF of a TIFF, only
/// the `wanted` tags are read. Damage of the pixel data is not detected.
///
/// # Errors
/// [`Error::Read`]; [`Error::UnknownFormat`]; [`Error::Decode`] where the size is unknown, zero or beyond `limits`.
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
    .unwrap_or_else(|_| {
        Err("the content is damaged in a way that the decoder does not recognise; copy the file again".into())
    })
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

/// Converts interleaved pixels of 1 to 4 `channels` (grey, grey + alpha, RGB, RGB + alpha) to interleaved RGB.
fn to_rgb<T: Copy>(values: Vec<T>, channels: usize) -> Vec<T> {
    match channels {
        1 | 2 => values.chunks_exact(channels).flat_map(|p| [p[0]; 3]).collect(),
        3 => values,
        _ => values.chunks_exact(channels).flat_map(|p| [p[0], p[1], p[2]]).collect(),
    }
}

/// Converts CMYK to RGB without a profile: each channel is (1 - ink) * (1 - black), where `max` stands for an ink of 1.
fn cmyk_to_rgb<T: Copy + Into<u32> + TryFrom<u32>>(inks: &[T], max: u32) -> Vec<T> {
    let light = |ink: T, black: T| {
        let product = (max - ink.into()) as u64 * (max - black.into()) as u64;
        let value = ((product + u64::from(max) / 2) / u64::from(max)) as u32;
        T::try_from(value).unwrap_or(ink)
    };
    inks.chunks_exact(4).flat_map(|p| [light(p[0], p[3]), light(p[1], p[3]), light(p[2], p[3])]).collect()
}

#[cfg(test)]
pub(super) mod tests;
