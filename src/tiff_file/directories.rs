//! The directories (IFDs) of a TIFF file.
//!
//! In: a file. Out: its [`Directory`]s and the values of their entries. Cost: each directory and each value is read
//! with a seek. Source: TIFF 6.0, section 2; BigTIFF.

use std::io::{Read, Seek, SeekFrom};

/// Largest number of directories (IFDs) that are read. Each describes one picture of the file, and only one picture is
/// used.
pub(super) const MOST_DIRECTORIES: usize = 64;

/// An entry of a directory.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entry {
    pub(super) tag: u16,
    pub(super) kind: u16,
    pub(super) count: u64,
    /// Offset of the value in the file.
    pub(super) value: u64,
}

/// A directory (IFD): its offset in the file, its entries, and the offset of the next directory.
#[derive(Debug)]
pub(crate) struct Directory {
    pub(super) at: u64,
    pub(super) entries: Vec<Entry>,
    next: u64,
}

impl Directory {
    pub(super) fn entry(&self, tag: u16) -> Option<Entry> {
        self.entries.iter().copied().find(|entry| entry.tag == tag)
    }
}

/// The directories of a file, read by seeking.
pub(crate) struct Directories<R> {
    reader: R,
    length: u64,
    pub(crate) is_little: bool,
    is_big: bool,
}

impl<R: Read + Seek> Directories<R> {
    pub(crate) fn of(mut reader: R) -> Option<Self> {
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

    pub(super) fn number(&mut self, at: u64, length: usize) -> Option<u64> {
        let bytes = self.bytes(at, length)?;
        Some(number(&bytes, self.is_little))
    }

    /// Returns the position in the file header at which the offset of the first directory is stored, and the number
    /// of bytes of this offset.
    pub(super) fn offset(&self) -> (u64, usize) {
        if self.is_big { (8, 8) } else { (4, 4) }
    }

    pub(crate) fn directory(&mut self, at: u64) -> Option<Directory> {
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

    /// Returns the directories of the file's pictures in order, up to the first damaged directory.
    pub(crate) fn pictures(&mut self) -> Vec<Directory> {
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

    /// Returns the values of the entry `tag`, if the entry exists and its type is an integer.
    pub(crate) fn numbers(&mut self, directory: &Directory, tag: u16) -> Option<Vec<u64>> {
        let entry = directory.entry(tag)?;
        let size = match entry.kind {
            1 | 3 | 4 | 13 | 16 | 18 => size_of_kind(entry.kind),
            _ => return None,
        };
        let length = usize::try_from(entry.count.checked_mul(size)?).ok()?;
        let bytes = self.bytes(entry.value, length)?;
        Some(bytes.chunks_exact(size as usize).map(|bytes| number(bytes, self.is_little)).collect())
    }

    /// Returns the type and the bytes of the entry `tag`, if it has at most 64 KB.
    pub(crate) fn value(&mut self, directory: &Directory, tag: u16) -> Option<(u16, Vec<u8>)> {
        let entry = directory.entry(tag)?;
        let length = entry.count.checked_mul(size_of_kind(entry.kind)).filter(|&length| length <= 1 << 16)?;
        Some((entry.kind, self.bytes(entry.value, length as usize)?))
    }

    /// Returns the bytes of the entry `tag`, if it is of bytes.
    pub(crate) fn opaque(&mut self, directory: &Directory, tag: u16) -> Option<Vec<u8>> {
        let entry = directory.entry(tag).filter(|entry| matches!(entry.kind, 1 | 7))?;
        self.bytes(entry.value, usize::try_from(entry.count).ok()?)
    }

    /// Returns the values of the entry `tag` as real numbers, whatever their type: integers, fractions or floats.
    pub(crate) fn reals(&mut self, directory: &Directory, tag: u16) -> Option<Vec<f64>> {
        let entry = directory.entry(tag)?;
        let size = size_of_kind(entry.kind);
        let length = usize::try_from(entry.count.checked_mul(size)?).ok()?;
        let bytes = self.bytes(entry.value, length)?;
        let is_little = self.is_little;
        let real = |bytes: &[u8]| {
            let all = number(bytes, is_little);
            let half = |i: usize| number(&bytes[4 * i..4 * i + 4], is_little) as u32;
            Some(match entry.kind {
                1 | 3 | 4 | 13 | 16 | 18 => all as f64,
                5 => f64::from(half(0)) / f64::from(half(1)),
                6 => f64::from(all as u8 as i8),
                8 => f64::from(all as u16 as i16),
                9 => f64::from(all as u32 as i32),
                10 => f64::from(half(0) as i32) / f64::from(half(1) as i32),
                11 => f64::from(f32::from_bits(all as u32)),
                12 => f64::from_bits(all),
                _ => return None,
            })
        };
        bytes.chunks_exact(size as usize).map(real).collect()
    }

    pub(crate) fn first_number(&mut self, directory: &Directory, tag: u16) -> Option<u64> {
        self.numbers(directory, tag)?.first().copied()
    }
}

fn number(bytes: &[u8], is_little: bool) -> u64 {
    let add = |sum: u64, b: &u8| sum << 8 | u64::from(*b);
    if is_little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) }
}

/// Returns the size in bytes of a value of the type `kind` (TIFF 6.0, section 2; BigTIFF). For unknown types it
/// returns the largest size, 8.
pub(super) fn size_of_kind(kind: u16) -> u64 {
    match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        _ => 8,
    }
}
