//! The results: radiance and picture to their files, some hundred rows at a time.
//!
//! In: radiance, all of it or slab by slab, and what its picture comes from. Out: every file that shows them, whole but not yet named. Cost: that of the
//! tone mapping and the encoders. Memory: rows of the picture, and what the encoders hold.

use crate::bracket::colour::Primaries;
use crate::error::Result;
use crate::merge::RadianceMap;
use crate::plane::BAND_ROWS;
use crate::tonemap::codes::{Code, Depth, Encoder};
use crate::tonemap::mertens::Channels;
use crate::tonemap::tones::Tones;
use crate::write::{self, Codes, Files, Metadata, Output, Settled, Written};
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// What rows of the picture come from.
pub(super) enum Picture {
    /// From the radiance.
    Toned(Tones),
    /// They are there, encoded, 0 to 1.
    Fused(Channels),
}

impl Picture {
    /// The codes of whole rows of radiance, the first of which is row `first`.
    fn map<C: Code>(&self, encoder: &Encoder, first: usize, rows: &[[f32; 3]], codes: &mut [[C; 3]]) {
        match self {
            Picture::Toned(tones) => tones.map(encoder, first, rows, codes),
            Picture::Fused(channels) => {
                let start = first * channels[0].width();
                for (i, code) in codes.iter_mut().enumerate() {
                    *code = channels.each_ref().map(|c| C::of_encoded(encoder, c.as_slice()[start + i]));
                }
            }
        }
    }

    /// The same of many rows of `width` pixels, side by side, into `codes`.
    fn show<C: Code>(&self, encoder: &Encoder, width: usize, first: usize, rows: &[[f32; 3]], codes: &mut Vec<[C; 3]>) {
        codes.resize(rows.len(), [C::default(); 3]);
        let bands = codes.par_chunks_mut(BAND_ROWS * width).zip(rows.par_chunks(BAND_ROWS * width));
        bands.enumerate().for_each(|(j, (codes, rows))| self.map(encoder, first + j * BAND_ROWS, rows, codes));
    }
}

/// Rows that are given to the writers at once: bands enough for all threads, and buffers that stay in the cache.
const AT_ONCE: usize = 8 * BAND_ROWS;

/// Shows all of the radiance, slab by slab with the number of the first row, as often as it is asked.
pub(super) type Each<'a> = &'a dyn Fn(&mut dyn FnMut(usize, &RadianceMap) -> Result<()>) -> Result<()>;

/// What is written, and how.
pub(super) struct Results<'a> {
    pub outputs: Vec<Output>,
    pub options: &'a write::Options,
    pub metadata: Metadata,
    pub size: (usize, usize),
    pub primaries: Primaries,
    /// The luminance that 0.1 % of the radiance is above.
    pub bright: f32,
}

impl Results<'_> {
    /// The files of the radiance that `each` shows, and of `picture`; whoever wants to see the rows of the picture, in 8 bits, is `shown` them. And the
    /// time that tone mapping took.
    pub fn written(
        self,
        each: Each,
        picture: &Picture,
        mut shown: Option<&mut dyn FnMut(&[[u8; 3]])>,
    ) -> Result<(Vec<Written>, Duration)> {
        let Results { outputs, options, metadata, size, primaries, bright } = self;
        let (encoder, depth) = (Encoder::of(options.picture.colours), options.picture.depth);
        let codes = |y: usize, row: &[[f32; 3]], codes: &mut [[u8; 3]]| picture.map(&encoder, y, row, codes);
        let settled = Settled::seen(&outputs, options, (size, primaries), bright, each, codes)?;
        let metadata = Metadata { primaries, ..metadata };
        let mut files = Files::begin(&outputs, size, &metadata, options, settled)?;
        let (mut eight, mut sixteen) = (Vec::new(), Vec::new());
        let mut mapping = Duration::ZERO;
        each(&mut |first, map| {
            let width = map.pixels.width();
            for (i, rows) in map.pixels.as_slice().chunks(AT_ONCE * width).enumerate() {
                let (began, first) = (Instant::now(), first + i * AT_ONCE);
                if shown.is_some() || depth == Depth::Eight && files.hold_pictures() {
                    picture.show(&encoder, width, first, rows, &mut eight);
                }
                if depth == Depth::Sixteen && files.hold_pictures() {
                    picture.show(&encoder, width, first, rows, &mut sixteen);
                }
                mapping += began.elapsed();
                let codes = match depth {
                    Depth::Eight if files.hold_pictures() => Codes::Eight(&eight),
                    Depth::Sixteen if files.hold_pictures() => Codes::Sixteen(&sixteen),
                    _ => Codes::Eight(&[]),
                };
                files.push(if files.hold_radiance() { rows } else { &[] }, codes)?;
                if let Some(shown) = &mut shown {
                    shown(&eight);
                }
            }
            Ok(())
        })?;
        Ok((files.finish()?, mapping))
    }
}
