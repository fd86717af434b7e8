//! TIFF files: what the `tiff` crate leaves to be done before and while it decodes, for photographs and radiance maps alike.
//!
//! In: a file. Out: which of its pictures is meant, bytes that the crate reads rightly, and the samples of the picture, interleaved. Cost: a
//! look at each directory; one copy of the samples. Source: TIFF 6.0 (sections 2, 8 and 15); libtiff, `tif_read.c`, for what
//! FillOrder turns round; TIFF/EP and DNG for the tags that tell a camera raw file.

use crate::limits;
use std::io::{Cursor, Read, Seek, SeekFrom};
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

/// Why a file was refused.
type Reason = String;

/// Tags that are looked at, by their numbers.
const SUBFILE: u16 = 254;
const COMPRESSION: u16 = 259;
const PHOTOMETRIC: u16 = 262;
const FILL_ORDER: u16 = 266;
const STRIPS: (u16, u16) = (273, 279);
const TILES: (u16, u16) = (324, 325);
const SUB_DIRECTORIES: u16 = 330;
const EXIF_DIRECTORY: u16 = 34665;
const DNG_VERSION: u16 = 50706;

/// JPEG in a TIFF, whose bits are never turned round (libtiff's TIFF_NOBITREV).
const JPEGS: [u64; 2] = [6, 7];

/// Most directories that are looked at: pictures of one file, of which one is wanted.
const MOST_DIRECTORIES: usize = 64;

/// From this length on the crate refuses a text, and prints a line of its own about it.
const LONGEST_TEXT: u64 = 256 << 20;

/// An entry of a directory.
#[derive(Debug, Clone, Copy)]
struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    /// Where its value is, in the file.
    value: u64,
}

/// A directory: where it is, and what it says.
#[derive(Debug)]
struct Directory {
    at: u64,
    entries: Vec<Entry>,
    next: u64,
}

impl Directory {
    fn entry(&self, tag: u16) -> Option<Entry> {
        self.entries.iter().copied().find(|entry| entry.tag == tag)
    }
}

/// The directories of a file, by seeking.
struct Directories<R> {
    reader: R,
    length: u64,
    is_little: bool,
    is_big: bool,
}

impl<R: Read + Seek> Directories<R> {
    fn of(mut reader: R) -> Option<Self> {
        let length = reader.seek(SeekFrom::End(0)).ok()?;
        let mut found = Directories { reader, length, is_little: true, is_big: false };
        found.is_little = found.bytes(0, 2)? == b"II";
        found.is_big = found.number(2, 2)? == 43;
        Some(found)
    }

    fn bytes(&mut self, at: u64, count: usize) -> Option<Vec<u8>> {
        at.checked_add(count as u64).filter(|&end| end <= self.length)?;
        let mut bytes = vec![0; count];
        self.reader.seek(SeekFrom::Start(at)).ok()?;
        self.reader.read_exact(&mut bytes).ok()?;
        Some(bytes)
    }

    fn number(&mut self, at: u64, length: usize) -> Option<u64> {
        let bytes = self.bytes(at, length)?;
        Some(number(&bytes, self.is_little))
    }

    /// Where the offset of the first directory is, and how long an offset is.
    fn offset(&self) -> (u64, usize) {
        if self.is_big { (8, 8) } else { (4, 4) }
    }

    fn directory(&mut self, at: u64) -> Option<Directory> {
        let (_, word) = self.offset();
        let (count_length, entry_length) = if self.is_big { (8, 20) } else { (2, 12) };
        let count = usize::try_from(self.number(at, count_length)?).ok().filter(|&count| count <= 1 << 16)?;
        let start = at + count_length as u64;
        let all = self.bytes(start, count * entry_length + word)?;
        let (entries, next) = all.split_at(count * entry_length);
        let entries = entries.chunks_exact(entry_length).enumerate().map(|(i, entry)| {
            let (kind, count) = (number(&entry[2..4], self.is_little) as u16, &entry[4..entry_length - word]);
            let count = number(count, self.is_little);
            let held = &entry[entry_length - word..];
            let is_inside = count.saturating_mul(size_of_kind(kind)) <= word as u64;
            let place = start + ((i + 1) * entry_length - word) as u64;
            let value = if is_inside { place } else { number(held, self.is_little) };
            Entry { tag: number(&entry[..2], self.is_little) as u16, kind, count, value }
        });
        Some(Directory { at, entries: entries.collect(), next: number(next, self.is_little) })
    }

    /// The directories of the file's pictures, in their order; up to the first that is not sound.
    fn pictures(&mut self) -> Vec<Directory> {
        let (at, word) = self.offset();
        let mut found: Vec<Directory> = Vec::new();
        let mut next = self.number(at, word).unwrap_or(0);
        while next != 0 && found.len() < MOST_DIRECTORIES && found.iter().all(|seen| seen.at != next) {
            let Some(directory) = self.directory(next) else { break };
            next = directory.next;
            found.push(directory);
        }
        found
    }

    /// The whole numbers of the entry `tag`, if it has any.
    fn numbers(&mut self, directory: &Directory, tag: u16) -> Option<Vec<u64>> {
        let entry = directory.entry(tag)?;
        let size = match entry.kind {
            1 | 3 | 4 | 13 | 16 | 18 => size_of_kind(entry.kind),
            _ => return None,
        };
        let length = usize::try_from(entry.count.checked_mul(size)?).ok()?;
        let bytes = self.bytes(entry.value, length)?;
        Some(bytes.chunks_exact(size as usize).map(|bytes| number(bytes, self.is_little)).collect())
    }

    fn first_number(&mut self, directory: &Directory, tag: u16) -> Option<u64> {
        self.numbers(directory, tag)?.first().copied()
    }

    fn is_thumbnail(&mut self, directory: &Directory) -> bool {
        self.first_number(directory, SUBFILE).is_some_and(|kind| kind & 1 != 0)
    }

    /// Whether it holds a sensor's mosaic, or the linear pixels that were made of one.
    fn is_mosaic(&mut self, directory: &Directory) -> bool {
        matches!(self.first_number(directory, PHOTOMETRIC), Some(32803 | 34892))
    }
}

fn number(bytes: &[u8], is_little: bool) -> u64 {
    let add = |sum: u64, b: &u8| sum << 8 | u64::from(*b);
    if is_little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) }
}

/// Bytes of a value of a type (TIFF 6.0, section 2; BigTIFF); of an unknown type, as of the longest.
fn size_of_kind(kind: u16) -> u64 {
    match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        _ => 8,
    }
}

/// Which picture of a file is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Picture {
    /// Its place among the file's pictures.
    pub index: usize,
    /// Where its directory is, in the file.
    at: u64,
    /// Whether the file looks like a camera raw: a mosaic, or thumbnails without a picture.
    pub is_raw: bool,
}

/// The first picture of the file that is no thumbnail of another.
///
/// # Errors
/// The reason, where a directory is not sound.
pub(crate) fn picture(reader: impl Read + Seek) -> Result<Picture, Reason> {
    let damaged = || Reason::from("it has no sound directory; copy the file again");
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
        return Err("one of its texts says to be longer than any file has; copy the file again".into());
    }
    let is_mosaic = all().any(|directory| file.is_mosaic(directory));
    let full = pictures.iter().position(|directory| !file.is_thumbnail(directory));
    let is_raw = is_mosaic || full.is_none() || first.entry(DNG_VERSION).is_some();
    let index = full.unwrap_or(0);
    Ok(Picture { index, at: pictures[index].at, is_raw })
}

/// Makes `picture` the first of the file `bytes`.
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

/// Turns round the bits of each byte of the first picture's data where its FillOrder says that the lowest comes first. The crate does not
/// know the tag. Where the directory is not sound nothing is done, and the crate will say so.
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
    // Strips may share bytes: each is turned once.
    let mut done = 0;
    for (offset, count) in ranges().unwrap_or_default() {
        let end = usize::try_from(offset.saturating_add(count)).map_or(bytes.len(), |end| end.min(bytes.len()));
        let start = usize::try_from(offset).map_or(end, |start| start.max(done).min(end));
        bytes[start..end].iter_mut().for_each(|byte| *byte = byte.reverse_bits());
        done = done.max(end);
    }
}

/// The crate reads no directory with LogLuv's photometric interpretation; RGB's or grey's is put in its place, in the first picture. The
/// compression tells. Where the directory is not sound nothing is done, and the crate will say so.
pub(crate) fn disguise_logluv(bytes: &mut [u8]) {
    let place = || {
        let mut file = Directories::of(Cursor::new(&*bytes))?;
        let (at, word) = file.offset();
        let at = file.number(at, word)?;
        let first = file.directory(at)?;
        let code: u16 = match file.first_number(&first, PHOTOMETRIC)? {
            32844 => 1,
            32845 => 2,
            _ => return None,
        };
        Some((
            first.entry(PHOTOMETRIC)?.value as usize,
            if file.is_little { code.to_le_bytes() } else { code.to_be_bytes() },
        ))
    };
    if let Some((value, code)) = place() {
        bytes[value..value + 2].copy_from_slice(&code);
    }
}

/// The samples of the picture that `decoder` is at, pixel by pixel, whether they are stored in strips, tiles or planes: as many to a pixel
/// as the colour type has. Of fewer than 8 bit, they become bytes of the full range.
///
/// The crate's own way to read the whole of a picture panics where tiles of a plane reach beyond its lower edge, and calls tiles of LZW
/// that reach beyond an edge damaged. It reads whole rows of tiles right.
///
/// # Errors
/// The reason.
pub(crate) fn samples<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    said: impl Fn(tiff::TiffError) -> Reason,
) -> Result<DecodingResult, Reason> {
    let (width, height) = decoder.dimensions().map_err(&said)?;
    let kind = decoder.colortype().map_err(&said)?;
    let is_planar = decoder.find_tag_unsigned::<u16>(Tag::PlanarConfiguration).map_err(&said)? == Some(2);
    let per_pixel = usize::from(kind.num_samples());
    let stored = decoder.find_tag_unsigned::<u16>(Tag::SamplesPerPixel).map_err(&said)?.unwrap_or(1);
    let predictor = decoder.find_tag_unsigned::<u16>(Tag::Predictor).map_err(&said)?.unwrap_or(1);
    // The crate takes the extra samples out before it adds up the differences to the pixel before.
    if !is_planar && predictor != 1 && stored > kind.num_samples() {
        return Err(format!(
            "it has {stored} samples to a pixel and a predictor, which is not supported; save it as plain RGB, or without predictor"
        ));
    }
    let (planes, per_chunk) = if is_planar { (per_pixel, 1) } else { (1, per_pixel) };
    let (chunk_width, chunk_height) = decoder.chunk_dimensions();
    let (across, down) = (width.div_ceil(chunk_width), height.div_ceil(chunk_height));
    let size = (width as usize, height as usize);
    let depth = kind.bit_depth();
    let bits = u64::from(chunk_width) * per_chunk as u64 * u64::from(depth);
    let row_bytes = usize::try_from(bits.div_ceil(8)).map_err(|_| "its tiles are too large for this machine")?;
    let in_row = chunk_width as usize * per_chunk;
    let mut all: Option<DecodingResult> = None;
    let mut chunk = DecodingResult::U8(Vec::new());
    for plane in 0..planes {
        for (row, column) in (0..down).flat_map(|row| (0..across).map(move |column| (row, column))) {
            let index = (plane as u32 * down + row) * across + column;
            decoder.read_chunk_to_buffer(&mut chunk, index, row_bytes).map_err(&said)?;
            let chunk = match &chunk {
                DecodingResult::U8(packed) if depth < 8 => &DecodingResult::U8(unpacked(packed, in_row, depth)),
                chunk => chunk,
            };
            let place = Place {
                size,
                per_pixel,
                corner: ((column * chunk_width) as usize, (row * chunk_height) as usize),
                chunk_width: chunk_width as usize,
                plane: is_planar.then_some(plane),
            };
            use DecodingResult::{F16, F32, F64, U8, U16};
            match (chunk, &mut all) {
                (U8(chunk), None) => all = Some(U8(place.begun(chunk)?)),
                (U16(chunk), None) => all = Some(U16(place.begun(chunk)?)),
                (F16(chunk), None) => all = Some(F16(place.begun(chunk)?)),
                (F32(chunk), None) => all = Some(F32(place.begun(chunk)?)),
                (F64(chunk), None) => all = Some(F64(place.begun(chunk)?)),
                (U8(chunk), Some(U8(all))) => place.put(chunk, all),
                (U16(chunk), Some(U16(all))) => place.put(chunk, all),
                (F16(chunk), Some(F16(all))) => place.put(chunk, all),
                (F32(chunk), Some(F32(all))) => place.put(chunk, all),
                (F64(chunk), Some(F64(all))) => place.put(chunk, all),
                _ => {
                    return Err(format!(
                        "its samples are whole numbers of {depth} bit or signed, which is not supported; save it with 8 or 16 bit, unsigned"
                    ));
                }
            }
        }
    }
    all.ok_or_else(|| "it has no pixels".into())
}

/// Where a chunk belongs.
struct Place {
    /// Of the picture, in pixels.
    size: (usize, usize),
    per_pixel: usize,
    /// Of the chunk, in the picture.
    corner: (usize, usize),
    /// In pixels.
    chunk_width: usize,
    /// Which of the samples the chunk holds, if not all.
    plane: Option<usize>,
}

impl Place {
    /// A whole picture of which `chunk` is the first part.
    fn begun<T: Copy + Default>(&self, chunk: &[T]) -> Result<Vec<T>, Reason> {
        let mut all = limits::room(self.size.0 * self.size.1 * self.per_pixel)?;
        self.put(chunk, &mut all);
        Ok(all)
    }

    /// What reaches beyond the right or the lower edge is left out.
    fn put<T: Copy>(&self, chunk: &[T], all: &mut [T]) {
        let Place { size, per_pixel, corner, chunk_width, plane } = *self;
        let per_chunk = if plane.is_some() { 1 } else { per_pixel };
        let rows = all.chunks_exact_mut(size.0 * per_pixel).skip(corner.1);
        for (row, part) in rows.zip(chunk.chunks_exact(chunk_width * per_chunk)) {
            let row = &mut row[corner.0 * per_pixel..];
            match plane {
                None => row.iter_mut().zip(part).for_each(|(all, &v)| *all = v),
                Some(plane) => row.chunks_exact_mut(per_pixel).zip(part).for_each(|(pixel, &v)| pixel[plane] = v),
            }
        }
    }
}

/// Samples of fewer than 8 bit, `count` to a row that is filled up to whole bytes, as bytes of the full range.
fn unpacked(packed: &[u8], count: usize, depth: u8) -> Vec<u8> {
    let depth = usize::from(depth.max(1));
    let max = (1u16 << depth) - 1;
    let row = (count * depth).div_ceil(8).max(1);
    packed
        .chunks_exact(row)
        .flat_map(|bytes| {
            (0..count).map(move |x| {
                let bit = x * depth;
                // Two bytes hold every sample, also one that straddles a boundary.
                let next = bytes.get(bit / 8 + 1).copied().unwrap_or(0);
                let word = u16::from_be_bytes([bytes[bit / 8], next]);
                let value = (word >> (16 - depth - bit % 8)) & max;
                (value * 255 / max) as u8
            })
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests;
