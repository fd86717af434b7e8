//! The structure of a TIFF: strips of 64 rows in order, followed by the directory.
//!
//! In: compressed strips. Out: a file. Cost: writing. Source: TIFF 6.0, section 2; BigTIFF (Aware Systems).

use super::directory::{Directory, tag};
use crate::error::Result;
use crate::plane::BAND_ROWS;
use crate::write::staging::Pending;
use std::io::{self, Seek, SeekFrom, Write};

/// A file with its strips in order, and its directory at the end.
#[derive(Debug)]
pub(crate) struct Strips {
    pub(crate) file: Pending,
    pub(crate) directory: Directory,
    pub(crate) at: u64,
    strips: Vec<(u64, u64)>,
}

impl Strips {
    /// Starts a picture of `size` pixels, each of `samples` samples, with `bits_per_pixel` bits before compression, in
    /// strips of 64 rows.
    pub(crate) fn begin(mut file: Pending, size: (usize, usize), samples: u16, bits_per_pixel: u64) -> Result<Self> {
        let (width, height) = (size.0 as u64, size.1 as u64);
        let raw = width * height * bits_per_pixel / 8;
        // A BigTIFF is chosen if the file may exceed 4 GB: compressed noise can be a little larger than `raw`, and
        // the directory needs some space.
        let mut directory = Directory::new(raw + raw / 64 + (1 << 24) > u64::from(u32::MAX));
        directory.long(tag::WIDTH, &[width]);
        directory.long(tag::HEIGHT, &[height]);
        directory.long(tag::ROWS_PER_STRIP, &[BAND_ROWS as u64]);
        directory.short(tag::SAMPLES, &[samples]);
        directory.short(tag::PLANAR, &[1]);
        let start = directory.file_header(0);
        file.put(&start)?;
        Ok(Strips { file, directory, at: start.len() as u64, strips: Vec::new() })
    }

    /// Writes the next strip.
    pub(crate) fn put(&mut self, strip: &[u8]) -> Result<()> {
        self.file.put(strip)?;
        self.strips.push((self.at, strip.len() as u64));
        self.at += strip.len() as u64;
        Ok(())
    }

    /// Writes other data after the strips, and returns their offset.
    pub(crate) fn append(&mut self, bytes: &[u8]) -> Result<u64> {
        let at = self.at;
        self.file.put(bytes)?;
        self.at += bytes.len() as u64;
        Ok(at)
    }

    /// Takes the directory, with the places of the strips; another can be set.
    pub(crate) fn described(&mut self) -> Directory {
        let empty = Directory::new(self.directory.big);
        let mut directory = std::mem::replace(&mut self.directory, empty);
        let (offsets, counts): (Vec<u64>, Vec<u64>) = std::mem::take(&mut self.strips).into_iter().unzip();
        if !offsets.is_empty() {
            directory.long(tag::STRIP_OFFSETS, &offsets);
            directory.long(tag::STRIP_COUNTS, &counts);
        }
        directory
    }

    /// Writes the directory, and its offset.
    pub(crate) fn end(mut self) -> Result<Pending> {
        self.directory = self.described();
        // The directory must have an even offset.
        let place = self.at.next_multiple_of(2);
        let mut end = vec![0; (place - self.at) as usize];
        end.extend(self.directory.bytes(place));
        let start = self.directory.file_header(place);
        let file = &mut self.file;
        let mut put = || -> io::Result<()> {
            file.write_all(&end)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&start)
        };
        put().map_err(|e| self.file.error(e))?;
        Ok(self.file)
    }
}
