//! The DNG writer: strips of the linear picture, the preview, and the directories.
//!
//! In: radiance by rows. Out: a file. Cost and source: see [`super`].

use super::preview::Preview;
use super::{Brightness, Encoding, tags};
use crate::error::Result;
use crate::merge::radiance::photographed::Photographed;
use crate::pixel::half::half_bits;
use crate::write::bands::Bands;
use crate::write::deflate::zlib;
use crate::write::exif;
use crate::write::metadata::Metadata;
use crate::write::row_writer::RowWriter;
use crate::write::staging::{Pending, Written};
use crate::write::tiff::directory::tag;
use crate::write::tiff::strips::Strips;
use crate::write::tiff::{Half, Sample};
use std::io;

/// Writes radiance to a DNG.
#[derive(Debug)]
pub(crate) struct Writer {
    strips: Strips,
    bands: Bands<[f32; 3], Vec<u8>>,
    encoding: Encoding,
    preview: Preview,
    metadata: Metadata,
    brightness: Brightness,
}

/// The largest value of an integer.
const INTEGER_WHITE: f32 = 65535.0;

impl Writer {
    /// Starts a picture of `size` pixels.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub(crate) fn new(
        file: Pending,
        size: (usize, usize),
        metadata: &Metadata,
        encoding: Encoding,
        brightness: Brightness,
    ) -> Result<Self> {
        let bits = if encoding == Encoding::Float { 32 } else { 16 };
        let mut strips = Strips::begin(file, size, 3, 3 * u64::from(bits))?;
        let directory = &mut strips.directory;
        directory.short(tag::BITS, &[bits; 3]);
        if encoding == Encoding::Integer {
            directory.short(tag::COMPRESSION, &[1]);
            tags::linear(directory, size, INTEGER_WHITE as u64);
        } else {
            directory.short(tag::COMPRESSION, &[8]);
            directory.short(tag::PREDICTOR, &[f32::PREDICTOR]);
            directory.short(tag::SAMPLE_FORMAT, &[f32::FORMAT; 3]);
            tags::linear(directory, size, 1);
        }
        let (bands, preview) = (Bands::new(size), Preview::new(size));
        Ok(Writer { strips, bands, encoding, preview, metadata: metadata.clone(), brightness })
    }
}

impl RowWriter<[f32; 3]> for Writer {
    fn push(&mut self, rows: &[[f32; 3]]) -> Result<()> {
        let Writer { strips, bands, encoding, preview, brightness, .. } = self;
        let (width, scale) = (bands.width, 1.0 / brightness.most);
        preview.see(rows);
        bands.push(
            rows,
            |_, pixels, raw, out| pack(pixels, width, (*encoding, scale), raw, out),
            |strip, packed| {
                packed.map_err(|e| strips.file.error(e))?;
                strips.put(strip)
            },
        )
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let Writer { mut strips, bands, encoding, preview, metadata, brightness } = *self;
        let size = (bands.width, bands.height);
        bands.complete().map_err(|e| strips.file.error(e))?;
        let baseline = brightness.baseline(Photographed::read(&metadata.comments));
        let white = f64::from(brightness.most) * libm::exp2(-baseline);
        let jpeg = preview.jpeg(&metadata.primaries, white).map_err(|e| strips.file.error(e))?;
        let at = strips.append(&jpeg)?;
        let linear = strips.described();
        let is_float = encoding != Encoding::Integer;
        let mut main = tags::main(&metadata, (preview.size(), at, jpeg.len()), (linear, is_float), baseline);
        // The preview is sRGB, and the linear picture has a matrix, so the file needs no profile.
        let fields = exif::of_tiff(size, &Metadata { profile: None, ..metadata });
        main.photograph(&fields);
        strips.directory = main;
        Written::ended(strips.end()?, Vec::new())
    }
}

/// Appends a strip; radiance is multiplied by `scale`.
fn pack(
    pixels: &[[f32; 3]],
    width: usize,
    (encoding, scale): (Encoding, f32),
    raw: &mut Vec<u8>,
    out: &mut Vec<u8>,
) -> io::Result<()> {
    let scaled = |pixel: &[f32; 3]| pixel.map(|v| v * scale);
    if encoding == Encoding::Integer {
        let code = |v: f32| (v.clamp(0.0, 1.0) * INTEGER_WHITE + 0.5) as u16;
        pixels.iter().flat_map(|pixel| scaled(pixel).map(code)).for_each(|v| out.extend(v.to_le_bytes()));
        return Ok(());
    }
    raw.clear();
    for row in pixels.chunks_exact(width) {
        let row = row.iter().map(scaled);
        match encoding {
            Encoding::Half => Half::put_predicted(&row.map(|p| p.map(|v| Half(half_bits(v)))).collect::<Vec<_>>(), raw),
            _ => f32::put_predicted(&row.collect::<Vec<_>>(), raw),
        }
    }
    zlib(raw, out)
}
