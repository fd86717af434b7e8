//! The cut of rows into bands: what every writer does with the rows it is pushed.
//!
//! In: rows in order, in portions of any size. Out: the fixed bands of 64 rows, encoded in parallel and handed on in order, so that
//! neither the portions nor the threads show in the file. Cost: a copy of rows that do not fill a band; 16 encoded bands in memory.

use crate::error::Result;
use crate::plane::BAND_ROWS;
use rayon::prelude::*;
use std::io;

/// Bands encoded side by side before they are written: bounds the memory, and has no part in the bytes.
const BANDS_AT_ONCE: usize = 16;

/// Cuts rows that come in any portions into the fixed bands, encodes these in parallel and hands the results on in order.
#[derive(Debug)]
pub(super) struct Bands<P> {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Rows handed on; always at the start of a band, or the end.
    done: usize,
    rest: Vec<P>,
}

impl<P: Copy + Sync> Bands<P> {
    pub(super) fn new((width, height): (usize, usize)) -> Self {
        Bands { width, height, done: 0, rest: Vec::new() }
    }

    /// Takes `rows`; `encode(first row, pixels)` makes of each band what `sink` then gets.
    pub(super) fn push<R: Send>(
        &mut self,
        mut rows: &[P],
        encode: impl Fn(usize, &[P]) -> R + Sync,
        mut sink: impl FnMut(R) -> Result<()>,
    ) -> Result<()> {
        let band = BAND_ROWS * self.width;
        let missing = (self.height - self.done) * self.width - self.rest.len();
        assert!(
            rows.len().is_multiple_of(self.width) && rows.len() <= missing,
            "rows come whole, and not more than there are"
        );
        let last = rows.len() == missing;
        if !self.rest.is_empty() {
            let (fill, further) = rows.split_at(rows.len().min(band - self.rest.len()));
            self.rest.extend_from_slice(fill);
            rows = further;
            if self.rest.len() < band && !last {
                return Ok(());
            }
            let full = std::mem::take(&mut self.rest);
            sink(encode(self.done, &full))?;
            self.done += full.len() / self.width;
        }
        let whole = if last { rows.len() } else { rows.len() / band * band };
        for group in rows[..whole].chunks(BANDS_AT_ONCE * band) {
            let first = self.done;
            let encoded: Vec<R> =
                group.par_chunks(band).enumerate().map(|(i, pixels)| encode(first + i * BAND_ROWS, pixels)).collect();
            encoded.into_iter().try_for_each(&mut sink)?;
            self.done += group.len() / self.width;
        }
        self.rest.extend_from_slice(&rows[whole..]);
        Ok(())
    }

    /// That every row has come.
    pub(super) fn complete(&self) -> io::Result<()> {
        if self.done == self.height {
            return Ok(());
        }
        Err(io::Error::other(format!(
            "only {} of {} rows were given",
            self.done + self.rest.len() / self.width.max(1),
            self.height
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every portioning must give the same bands: (first row, rows, first value) tells one from another.
    #[test]
    fn bands_do_not_depend_on_the_portions() {
        let (width, height) = (3, 64 * 18 + 5);
        let pixels: Vec<u32> = (0..(width * height) as u32).collect();
        let cut = |portion: usize| {
            let mut bands = Bands::new((width, height));
            let mut seen = Vec::new();
            for rows in pixels.chunks(portion * width) {
                let encode = |first: usize, p: &[u32]| (first, p.len() / width, p[0]);
                bands
                    .push(rows, encode, |band| {
                        seen.push(band);
                        Ok(())
                    })
                    .unwrap();
            }
            bands.complete().unwrap();
            seen
        };
        let expected: Vec<_> =
            (0..19).map(|b| (64 * b, if b == 18 { 5 } else { 64 }, (64 * b * width) as u32)).collect();
        for portion in [1, 7, 63, 64, 65, 130, height] {
            assert_eq!(cut(portion), expected, "{portion} rows at a time");
        }
    }

    #[test]
    fn missing_rows_are_an_error() {
        let mut bands = Bands::new((2, 100));
        bands.push(&[0u8; 140], |_, _| (), |()| Ok(())).unwrap();
        assert_eq!(bands.complete().unwrap_err().to_string(), "only 70 of 100 rows were given");
    }
}
