//! The results: radiance and picture are written to their files, some hundred rows at a time.
//!
//! In: radiance, in one or several parts, and the source of its picture, which may be smaller. Out: every result file,
//! complete but not yet named. Cost: tone mapping and the encoders. Memory: rows of the picture, and buffers of the
//! encoders.

use crate::bracket::colour::Primaries;
use crate::error::Result;
use crate::pipeline::stages::picture::{Each, Picture};
use crate::plane::BAND_ROWS;
use crate::tonemap::display::codes::{Depth, Encoder, encoded};
use crate::tonemap::resize::Resizer;
use crate::write::{self, Codes, Files, Metadata, Output, Settled, Written};
use std::time::{Duration, Instant};

/// Number of rows passed to the writers at once: enough to occupy all threads, and few enough for buffers that stay in
/// the cache.
const AT_ONCE: usize = 8 * BAND_ROWS;
/// Number of rows that are resized at once; fewer than [`AT_ONCE`], because they are resized as floats, which take
/// more memory.
const RESIZED_ROWS: usize = 2 * BAND_ROWS;

/// Callback for the rows of the picture, in 8 bits and in the size of the radiance.
pub(crate) type Shown<'a> = &'a mut dyn FnMut(&[[u8; 3]]);

/// What is written, and how.
pub(crate) struct Results<'a> {
    pub outputs: Vec<Output>,
    pub options: &'a write::Options,
    pub metadata: Metadata,
    pub size: (usize, usize),
    pub primaries: Primaries,
    /// The 99.9th percentile of the luminance.
    pub bright: f32,
}

impl Results<'_> {
    /// Writes the files of the radiance that `each` passes, and of `picture`. Calls `shown` with the rows of the
    /// picture in 8 bits. Returns also the time of tone mapping.
    pub fn written(self, each: Each, picture: &Picture, mut shown: Option<Shown>) -> Result<(Vec<Written>, Duration)> {
        let Results { outputs, options, metadata, size, primaries, bright } = self;
        let (encoder, depth) = (Encoder::of(options.picture.colours), options.picture.depth);
        let codes = |y: usize, row: &[[f32; 3]], codes: &mut [[u8; 3]]| picture.map(&encoder, size.0, y, row, codes);
        let settled = Settled::seen(&outputs, options, (size, primaries), bright, each, codes)?;
        let metadata = Metadata { primaries, ..metadata };
        let mut files = Files::begin(&outputs, size, &metadata, options, settled)?;
        let (pictures, to) = (files.hold_pictures(), options.picture.size.of(size));
        let mut smaller = (pictures && to != size).then(|| Smaller::new(size, to, files.hold_gains()));
        let is_full = pictures && smaller.is_none();
        let (mut eight, mut sixteen) = (Vec::new(), Vec::new());
        let mut mapping = Duration::ZERO;
        each(&mut |first, map| {
            for (i, rows) in map.pixels.as_slice().chunks(AT_ONCE * size.0).enumerate() {
                let (began, first) = (Instant::now(), first + i * AT_ONCE);
                if shown.is_some() || is_full && depth == Depth::Eight {
                    picture.show(&encoder, size.0, first, rows, &mut eight);
                }
                if is_full && depth == Depth::Sixteen {
                    picture.show(&encoder, size.0, first, rows, &mut sixteen);
                }
                mapping += began.elapsed();
                match depth {
                    _ if !is_full => files.push(rows, &[], Codes::Eight(&[]))?,
                    Depth::Eight => files.push(rows, rows, Codes::Eight(&eight))?,
                    Depth::Sixteen => files.push(rows, rows, Codes::Sixteen(&sixteen))?,
                }
                if let Some(shown) = &mut shown {
                    shown(&eight);
                }
                if let Some(smaller) = &mut smaller {
                    for (i, rows) in rows.chunks(RESIZED_ROWS * size.0).enumerate() {
                        let began = Instant::now();
                        smaller.take(picture, &encoder, first + i * RESIZED_ROWS, rows);
                        let light = &smaller.light.1;
                        let codes = match depth {
                            Depth::Eight => {
                                encoded(&encoder, light, &mut eight);
                                Codes::Eight(&eight)
                            }
                            Depth::Sixteen => {
                                encoded(&encoder, light, &mut sixteen);
                                Codes::Sixteen(&sixteen)
                            }
                        };
                        mapping += began.elapsed();
                        files.push(&[], smaller.radiance(), codes)?;
                    }
                }
            }
            Ok(())
        })?;
        Ok((files.finish()?, mapping))
    }
}

/// Reduces the rows of the tone-mapped picture from the size of the radiance to the smaller size that is written, in
/// linear light. The rows of the radiance are reduced too if a file with a gain map needs them.
struct Smaller {
    width: usize,
    full: Vec<[f32; 3]>,
    light: (Resizer, Vec<[f32; 3]>),
    radiance: Option<(Resizer, Vec<[f32; 3]>)>,
}

impl Smaller {
    fn new(from: (usize, usize), to: (usize, usize), has_radiance: bool) -> Self {
        let resizer = || (Resizer::new(from, to), Vec::new());
        Smaller { width: from.0, full: Vec::new(), light: resizer(), radiance: has_radiance.then(resizer) }
    }

    /// Adds the next rows of radiance, from row `first` on.
    fn take(&mut self, picture: &Picture, encoder: &Encoder, first: usize, rows: &[[f32; 3]]) {
        picture.show(encoder, self.width, first, rows, &mut self.full);
        self.light.0.push(&self.full, &mut self.light.1);
        if let Some((resizer, out)) = &mut self.radiance {
            resizer.push(rows, out);
        }
    }

    fn radiance(&self) -> &[[f32; 3]] {
        self.radiance.as_ref().map_or(&[], |(_, rows)| rows)
    }
}
