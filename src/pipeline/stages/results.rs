//! The results: radiance and picture to their files, some hundred rows at a time.
//!
//! In: radiance, all of it or slab by slab, and what its picture comes from, which may be smaller. Out: every file that shows them, whole but not yet named. Cost: that of the
//! tone mapping and the encoders. Memory: rows of the picture, and what the encoders hold.

use crate::bracket::colour::Primaries;
use crate::error::Result;
use crate::pipeline::stages::picture::{Each, Picture};
use crate::plane::BAND_ROWS;
use crate::tonemap::display::codes::{Depth, Encoder, encoded};
use crate::tonemap::resize::Resizer;
use crate::write::{self, Codes, Files, Metadata, Output, Settled, Written};
use std::time::{Duration, Instant};

/// Rows that are given to the writers at once: bands enough for all threads, and buffers that stay in the cache.
const AT_ONCE: usize = 8 * BAND_ROWS;
/// Rows that are made smaller at once: what is kept of them is of floats.
const RESIZED_ROWS: usize = 2 * BAND_ROWS;

/// Who wants to see the rows of the picture, in 8 bits and as large as the radiance.
pub(crate) type Shown<'a> = &'a mut dyn FnMut(&[[u8; 3]]);

/// What is written, and how.
pub(crate) struct Results<'a> {
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

/// A picture that is smaller than the radiance: what was taken of it last, in light; and the radiance that it shows, where that is needed.
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

    /// Takes the next rows of radiance, the first of which is row `first`.
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
