//! Rows of a frame's pixel values, from memory or from disk.
//!
//! In: a frame and a range of its rows. Out: their pixel values as a slice. Cost: none where the frame is in memory,
//! else one read of the scratch file.

use super::Samples;
use crate::error::Result;
use crate::scratch::{Kept, Scratch};
use std::ops::Range;
use std::sync::Arc;

/// Pixel values of a frame, in memory or on disk.
#[derive(Debug, Clone)]
pub(super) enum Store {
    /// In memory.
    Held(Samples),
    /// On disk, 8 bit.
    Eight(Kept<u8>),
    /// On disk, 16 bit.
    Sixteen(Kept<u16>),
}

impl Store {
    /// Moves the pixel values to the scratch file if they are in memory.
    pub fn put_on(&mut self, scratch: &Arc<Scratch>) -> Result<()> {
        if let Store::Held(samples) = self {
            *self = match samples {
                Samples::Eight(v) => Store::Eight(scratch.put(v)?),
                Samples::Sixteen(v) => Store::Sixteen(scratch.put(v)?),
            };
        }
        Ok(())
    }

    /// Size in bytes of the pixel values in memory; if they are on disk, the size that they would have in memory.
    pub fn bytes(&self) -> u64 {
        self.len() as u64 * if self.max() == u16::from(u8::MAX) { 1 } else { 2 }
    }

    /// Number of pixel values: three per pixel.
    pub fn len(&self) -> usize {
        match self {
            Store::Held(samples) => samples.len(),
            Store::Eight(kept) => kept.len(),
            Store::Sixteen(kept) => kept.len(),
        }
    }

    /// The largest possible pixel value.
    pub fn max(&self) -> u16 {
        match self {
            Store::Held(samples) => samples.max(),
            Store::Eight(_) => u8::MAX.into(),
            Store::Sixteen(_) => u16::MAX,
        }
    }

    /// Reads the rows `rows` of a frame of `size` pixels.
    pub fn window(&self, size: (usize, usize), rows: Range<usize>) -> Result<Window<'_>> {
        let range = 3 * size.0 * rows.start..3 * size.0 * rows.end;
        let codes = match self {
            Store::Held(samples) => Part::Held(samples, range),
            Store::Eight(kept) => Part::Read(Samples::Eight(kept.get(range)?)),
            Store::Sixteen(kept) => Part::Read(Samples::Sixteen(kept.get(range)?)),
        };
        Ok(Window { size, rows, codes })
    }
}

/// A range of rows of a frame.
#[derive(Debug, Clone)]
pub struct Window<'a> {
    size: (usize, usize),
    rows: Range<usize>,
    codes: Part<'a>,
}

#[derive(Debug, Clone)]
enum Part<'a> {
    Held(&'a Samples, Range<usize>),
    Read(Samples),
}

/// Interleaved RGB pixel values by rows, at the depth of the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Codes<'a> {
    /// 0..=255.
    Eight(&'a [u8]),
    /// 0..=65535.
    Sixteen(&'a [u16]),
}

impl Window<'_> {
    /// Width of the frame, in pixels.
    pub fn width(&self) -> usize {
        self.size.0
    }

    /// Height of the whole frame, in pixels.
    pub fn height(&self) -> usize {
        self.size.1
    }

    /// Range of rows of the frame that the window contains.
    pub fn rows(&self) -> Range<usize> {
        self.rows.clone()
    }

    /// Pixel values of all rows of the window, from the first pixel of its first row on.
    pub fn codes(&self) -> Codes<'_> {
        let (samples, range) = match &self.codes {
            Part::Held(samples, range) => (*samples, range.clone()),
            Part::Read(samples) => (samples, 0..samples.len()),
        };
        match samples {
            Samples::Eight(v) => Codes::Eight(&v[range]),
            Samples::Sixteen(v) => Codes::Sixteen(&v[range]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_and_disk_show_the_same() {
        let dir = tempfile::tempdir().unwrap();
        let scratch = Scratch::in_folder(dir.path()).unwrap();
        let eight = Samples::Eight((0..3 * 5 * 7).map(|i| i as u8).collect());
        let sixteen = Samples::Sixteen((0..3 * 5 * 7).map(|i| i * 601).collect());
        for samples in [eight, sixteen] {
            let (mut disk, held) = (Store::Held(samples.clone()), Store::Held(samples));
            disk.put_on(&scratch).unwrap();
            assert!(!matches!(disk, Store::Held(_)));
            assert_eq!((disk.len(), disk.max()), (held.len(), held.max()));
            for rows in [0..7, 2..5, 6..7, 3..3] {
                let (a, b) = (disk.window((5, 7), rows.clone()).unwrap(), held.window((5, 7), rows.clone()).unwrap());
                assert_eq!(a.codes(), b.codes());
                assert_eq!((a.rows(), a.width(), a.height()), (rows, 5, 7));
            }
        }
    }
}
