//! Preparation of TIFF files (photographs and radiance maps) for the `tiff` crate, which does not do these steps
//! itself.
//!
//! In: a file. Out: the selected picture, bytes that the crate reads correctly, and the samples of the picture,
//! interleaved. Cost: each directory is read, and the samples are copied once. Source: TIFF 6.0 (sections 2, 8 and
//! 15); libtiff, `tif_read.c`, for FillOrder; TIFF/EP and DNG for the tags of camera raw files.

mod directories;
mod samples;

pub(crate) use directories::{Directories, Directory};
use directories::{MOST_DIRECTORIES, size_of_kind};
pub(crate) use samples::samples;
use std::io::{Cursor, Read, Seek};

/// Why a file was rejected.
type Reason = String;

/// Numbers of the tags that are read.
const SUBFILE: u16 = 254;
const COMPRESSION: u16 = 259;
const PHOTOMETRIC: u16 = 262;
const FILL_ORDER: u16 = 266;
const STRIPS: (u16, u16) = (273, 279);
const TILES: (u16, u16) = (324, 325);
const SUB_DIRECTORIES: u16 = 330;
const EXIF_DIRECTORY: u16 = 34665;
const DNG_VERSION: u16 = 50706;

/// The photometric interpretation of grey whose 0 is black (TIFF 6.0, section 8).
const BLACK_IS_ZERO: u8 = 1;

/// Values of the tag Compression for JPEG. The bits of JPEG data are never reversed (libtiff's TIFF_NOBITREV).
const JPEGS: [u64; 2] = [6, 7];

/// Length of a text tag, in bytes, above which the `tiff` crate rejects the text and prints a message.
const LONGEST_TEXT: u64 = 256 << 20;

impl<R: Read + Seek> Directories<R> {
    fn is_thumbnail(&mut self, directory: &Directory) -> bool {
        self.first_number(directory, SUBFILE).is_some_and(|kind| kind & 1 != 0)
    }

    /// Whether a directory contains the mosaic of a sensor, or linear pixels made from a mosaic.
    fn is_mosaic(&mut self, directory: &Directory) -> bool {
        matches!(self.first_number(directory, PHOTOMETRIC), Some(32803 | 34892))
    }
}

/// The selected picture of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Picture {
    /// Index among the file's pictures.
    pub index: usize,
    /// Number of pictures in the file, up to the first damaged directory.
    pub count: usize,
    /// Offset of its directory in the file.
    at: u64,
    /// Whether the file seems to be a camera raw file: it has a mosaic, it has only thumbnails, or it is a DNG.
    pub is_raw: bool,
    /// Whether it is a DNG.
    pub is_dng: bool,
}

/// Returns the first picture of the file that is not a thumbnail; the first thumbnail if there is no other picture.
///
/// # Errors
/// The reason, if the first directory is damaged or a text is impossibly long.
pub(crate) fn picture(reader: impl Read + Seek) -> Result<Picture, Reason> {
    let damaged = || Reason::from("all of its lists of tags are damaged; copy the file again");
    let mut file = Directories::of(reader).ok_or_else(damaged)?;
    let pictures = file.pictures();
    let first = pictures.first().ok_or_else(damaged)?;
    let mut below = Vec::new();
    for directory in &pictures {
        let exif = file.numbers(directory, EXIF_DIRECTORY).into_iter().flatten().take(1);
        let others = file.numbers(directory, SUB_DIRECTORIES).into_iter().flatten().take(MOST_DIRECTORIES);
        below.extend(exif.chain(others).filter_map(|at| file.directory(at)));
    }
    let all = || pictures.iter().chain(&below);
    if all().flat_map(|p| &p.entries).any(|entry| entry.kind == 2 && entry.count > LONGEST_TEXT) {
        return Err("its header is damaged: it contains a text of impossible length; copy the file again".into());
    }
    let is_mosaic = all().any(|directory| file.is_mosaic(directory));
    let full = pictures.iter().position(|directory| !file.is_thumbnail(directory));
    let is_dng = first.entry(DNG_VERSION).is_some();
    let is_raw = is_mosaic || full.is_none() || is_dng;
    let index = full.unwrap_or(0);
    Ok(Picture { index, count: pictures.len(), at: pictures[index].at, is_raw, is_dng })
}

/// Makes `picture` the first picture of the file `bytes`.
pub(crate) fn put_first(bytes: &mut [u8], picture: Picture) {
    let Some((at, word, is_little)) = Directories::of(Cursor::new(&*bytes)).map(|file| {
        let (at, word) = file.offset();
        (at as usize, word, file.is_little)
    }) else {
        return;
    };
    let offset = if is_little { picture.at.to_le_bytes() } else { picture.at.to_be_bytes() };
    bytes[at..at + word].copy_from_slice(if is_little { &offset[..word] } else { &offset[8 - word..] });
}

/// Reverses the bits of each byte of the first picture's data if its FillOrder is 2. The `tiff` crate does not know
/// this tag. If the directory is damaged, nothing is changed, and the crate will report the damage.
pub(crate) fn order_bits(bytes: &mut [u8]) {
    let ranges = || {
        let mut file = Directories::of(Cursor::new(&*bytes))?;
        let (at, word) = file.offset();
        let at = file.number(at, word)?;
        let first = file.directory(at)?;
        let compression = file.first_number(&first, COMPRESSION).unwrap_or(1);
        if file.first_number(&first, FILL_ORDER) != Some(2) || JPEGS.contains(&compression) {
            return None;
        }
        let (offsets, counts) = if first.entry(TILES.0).is_some() { TILES } else { STRIPS };
        let offsets = file.numbers(&first, offsets)?.into_iter();
        let mut ranges: Vec<_> = offsets.zip(file.numbers(&first, counts)?).collect();
        ranges.sort_unstable();
        Some(ranges)
    };
    // Strips may share bytes, but each byte must be reversed only once.
    let mut done = 0;
    for (offset, count) in ranges().unwrap_or_default() {
        let end = usize::try_from(offset.saturating_add(count)).map_or(bytes.len(), |end| end.min(bytes.len()));
        let start = usize::try_from(offset).map_or(end, |start| start.max(done).min(end));
        bytes[start..end].iter_mut().for_each(|byte| *byte = byte.reverse_bits());
        done = done.max(end);
    }
}

/// Sets the photometric interpretation of the first picture to grey, and returns the original value. The `tiff` crate
/// then decodes all samples as they are stored, whatever their meaning and number, and applies the predictor to the
/// right samples. Without this change, the crate cannot read palettes and LogLuv, and reads extra samples
/// incorrectly. If the directory is damaged, nothing is changed, and the crate will report the damage.
pub(crate) fn as_grey(bytes: &mut [u8]) -> Option<u16> {
    let mut file = Directories::of(Cursor::new(&*bytes))?;
    let (at, word) = file.offset();
    let at = file.number(at, word)?;
    let first = file.directory(at)?;
    let photometric = file.first_number(&first, PHOTOMETRIC)?;
    let (entry, is_little) = (first.entry(PHOTOMETRIC)?, file.is_little);
    let value = &mut bytes[entry.value as usize..][..size_of_kind(entry.kind) as usize];
    value.fill(0);
    let lowest = if is_little { 0 } else { value.len() - 1 };
    value[lowest] = BLACK_IS_ZERO;
    u16::try_from(photometric).ok()
}

/// Returns the reason why the `tiff` crate rejects a file, and what the user can do.
pub(crate) fn refusal(e: tiff::TiffError) -> Reason {
    match e {
        tiff::TiffError::UnsupportedError(what) => {
            format!("{what}; save it as grey or RGB, with ZIP (deflate) compression or none")
        }
        other => format!("{other}; copy the file again, or save it as grey or RGB"),
    }
}

#[cfg(test)]
pub(crate) mod tests;
