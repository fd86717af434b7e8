//! PNG: all of its kinds, at 8 or 16 bit.
//!
//! In: the file. Out: RGB at the file's depth; fewer than 8 bit and palettes become 8. Cost: that of the `png` crate.
//! Source: W3C, Portable Network Graphics (third edition), with the eXIf and iCCP chunks.

use super::{Reason, Stored, check_size, to_rgb};
use crate::bracket::Samples;
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::io::Cursor;

/// Decodes a PNG file. Checksums are checked up to the end of the file.
pub(super) fn decode(bytes: &[u8], max_pixels: u64) -> Result<Stored, Reason> {
    let damaged = |e: png::DecodingError| format!("{e}; copy the file again");
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: usize::MAX });
    decoder.set_transformations(Transformations::EXPAND);
    let header = decoder.read_header_info().map_err(damaged)?;
    let (width, height) = (header.width as usize, header.height as usize);
    check_size(width, height, max_pixels)?;
    let mut reader = decoder.read_info().map_err(damaged)?;
    let size = reader.output_buffer_size().ok_or("it is too large for this machine")?;
    let mut values = vec![0; size];
    let frame = reader.next_frame(&mut values).map_err(damaged)?;
    values.truncate(frame.buffer_size());
    reader.finish().map_err(damaged)?;
    let channels = match frame.color_type {
        ColorType::Grayscale => 1,
        ColorType::GrayscaleAlpha => 2,
        ColorType::Rgb => 3,
        ColorType::Rgba => 4,
        ColorType::Indexed => return Err("its palette is missing; copy the file again".into()),
    };
    let samples = match frame.bit_depth {
        BitDepth::Sixteen => {
            let words = values.as_chunks::<2>().0.iter().map(|&b| u16::from_be_bytes(b)).collect();
            Samples::Sixteen(to_rgb(words, channels))
        }
        _ => Samples::Eight(to_rgb(values, channels)),
    };
    if (frame.width as usize, frame.height as usize) != (width, height) || samples.len() != 3 * width * height {
        return Err("its first frame is smaller than the picture; save it as a plain PNG".into());
    }
    let info = reader.info();
    Ok(Stored {
        width,
        height,
        samples,
        exif: info.exif_metadata.as_ref().map(|e| e.to_vec()),
        icc: info.icc_profile.as_ref().map(|i| i.to_vec()),
    })
}
