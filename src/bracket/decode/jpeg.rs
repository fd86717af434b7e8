//! Decodes JPEG files: baseline and progressive; grey, YCbCr, RGB, CMYK and Adobe's YCCK.
//!
//! In: the file. Out: 8-bit RGB, decoded by zune-jpeg without a copy. Cost: zune-jpeg (7 ns per pixel at 4:2:0), and
//! one pass through the file. Source: ITU-T T.81 (annexes B, F, G), Adobe Technical Note 5116 for the APP14 marker,
//! CIPA DC-007 (MPF) for the images that may follow the first one.
//!
//! Three kinds of files are decoded by jpeg-decoder, which takes three times as long, because zune-jpeg 0.5.15 decodes
//! them wrongly:
//! - sequential files with several scans: zune-jpeg misplaces their blocks where chroma has fewer rows than luma;
//! - files whose chroma has a higher resolution than luma;
//! - files in which zune-jpeg interpolates between the last chroma sample and the padding behind the image, which is
//!   arbitrary.
//!
//! Decoders fill missing data with grey or noise, so the markers are checked before decoding: the file must be complete
//! up to the end of its first image. Further images (MPF previews, gain maps) and trailing bytes are cut off.
//!
//! A repair tool may have added an end marker to a truncated file. To detect this, bits of value 1 are appended to the
//! data of each sequential scan. A code that consists only of ones is not a Huffman code (T.81, annex C), so a decoder
//! that reads past the data of a scan fails. A progressive file must contain every bit of every coefficient.

mod layout;

use super::{Found, Reason, Stored, cmyk_to_rgb};
use crate::bracket::Samples;
use crate::limits::{self, Limits};
use jpeg_decoder::ColorTransform;
use layout::{JPEG_LS, Layout};
use std::io::{BufRead, Read, Seek};
use std::ops::Range;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

const END: [u8; 2] = [0xFF, 0xD9];

/// Entropy-coded data of 64 bits of value 1, which is longer than any Huffman code and the value bits after it. Each
/// 0xFF is followed by a zero byte (T.81, F.1.2.3).
const ONES: [u8; 16] = [0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0];

/// Maximum number of scans. Encoders write about ten, and decoding takes a pass over the whole image for each scan.
const MOST_SCANS: usize = 200;

const UNSUPPORTED_COLOUR: &str = "its kind of colour components is not supported; save it as RGB or grey";

/// Decodes a JPEG file.
pub(super) fn decode(mut bytes: Vec<u8>, limits: &Limits) -> Result<Stored, Reason> {
    let mut layout = Layout::of(&bytes)?;
    if !layout.junk.is_empty() {
        // Padding between segments is harmless, but strict decoding rejects it, so it is removed.
        bytes = without(&bytes, &layout.junk);
        layout = Layout::of(&bytes)?;
    }
    layout.check_complete()?;
    let scans = layout.scan_ends.len();
    if scans > MOST_SCANS {
        return Err(format!(
            "it has {scans} scans (passes over the picture), but at most {MOST_SCANS} are supported; save it as baseline JPEG"
        ));
    }
    let (width, height) = layout.size;
    limits.check_size(width, height)?;
    let pixels = width as u64 * height as u64;
    // The largest number of pixels per byte: a byte holds at most 8 blocks, because a block of 64 samples takes at
    // least one bit, and a sample covers at most 4 x 4 pixels, because a component has at most four times the
    // resolution of another along each axis.
    limits::check_length(bytes.len(), pixels, 64 * 8 * 16)?;
    let is_beyond_zune = layout.is_beyond_zune();
    // Held in memory: the output (RGB, or CMYK and RGB); for a progressive file, all coefficients with 2 bytes each;
    // and where jpeg-decoder is used, all components with 1 byte per pixel.
    let kept = if layout.progressive { 2 } else { 0 } + u64::from(is_beyond_zune);
    let components = layout.sampling.len();
    let rgb = if components == 4 { 4 + 3 } else { 3 };
    let decoding = pixels * (rgb + kept * components as u64) + bytes.len() as u64;
    limits.check_memory((width, height), decoding)?;
    let exif = layout.exif.map(|range| bytes[range].to_vec());
    bytes.truncate(layout.end - END.len());
    if !layout.progressive {
        bytes = with_ones(&bytes, &layout.scan_ends);
    }
    bytes.extend(END);

    // CMYK is inverted in files with Adobe's marker and not inverted in others; zune-jpeg assumes that it is always
    // inverted.
    let plain_cmyk = components == 4 && !layout.adobe;
    let wanted = if plain_cmyk { ColorSpace::CMYK } else { ColorSpace::RGB };
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX))
        .jpeg_set_max_scans(MOST_SCANS)
        .jpeg_set_out_colorspace(wanted);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&bytes), options);
    let damaged = |e: zune_jpeg::errors::DecodeErrors| format!("{}; copy the file again", one_line(&e.to_string()));
    decoder.decode_headers().map_err(damaged)?;
    let (width, height) = decoder.dimensions().ok_or("it has no size")?;
    limits.check_size(width, height)?;
    let icc = decoder.icc_profile();
    let pixels = if is_beyond_zune {
        let space = decoder.input_colorspace().ok_or("it has no components")?;
        by_jpeg_decoder(&bytes, space, plain_cmyk)?
    } else {
        let size = decoder.output_buffer_size().ok_or("it has no size")?;
        let mut pixels = limits::room(size)?;
        decoder.decode_into(&mut pixels).map_err(damaged)?;
        pixels
    };
    let channels = if plain_cmyk { 4 } else { 3 };
    if pixels.len() != channels * width * height {
        return Err(UNSUPPORTED_COLOUR.into());
    }
    let samples = if plain_cmyk { cmyk_to_rgb(&pixels, 255) } else { pixels };
    Ok(Stored {
        width,
        height,
        samples: Samples::Eight(samples),
        decoding,
        exif,
        directory: 0,
        icc,
        has_alpha: false,
        raw: None,
        notes: Vec::new(),
    })
}

/// Decodes, with jpeg-decoder, a file that zune-jpeg decodes wrongly. The result is RGB, or, if `plain_cmyk`, CMYK that
/// is not inverted. `space` is the colour space of the file. Parallel work runs in the current thread pool.
fn by_jpeg_decoder(bytes: &[u8], space: ColorSpace, plain_cmyk: bool) -> Result<Vec<u8>, Reason> {
    let transform = match space {
        ColorSpace::YCbCr => ColorTransform::YCbCr,
        ColorSpace::RGB => ColorTransform::RGB,
        ColorSpace::YCCK => ColorTransform::YCCK,
        ColorSpace::CMYK => ColorTransform::CMYK,
        _ => return Err(UNSUPPORTED_COLOUR.into()),
    };
    let mut decoder = jpeg_decoder::Decoder::new(bytes);
    decoder.set_color_transform(transform);
    let refused = |e: jpeg_decoder::Error| {
        let is_kind = matches!(e, jpeg_decoder::Error::Unsupported(_));
        format!(
            "{}; {}",
            one_line(&e.to_string()),
            if is_kind { "save it as baseline JPEG" } else { "copy the file again" }
        )
    };
    let pixels = decoder.decode().map_err(refused)?;
    Ok(match space {
        // jpeg-decoder inverts CMYK in all files, as if they had Adobe's marker; this is undone here.
        ColorSpace::CMYK | ColorSpace::YCCK if plain_cmyk => pixels.into_iter().map(|ink| 255 - ink).collect(),
        ColorSpace::CMYK | ColorSpace::YCCK => cmyk_to_rgb(&pixels, 255),
        _ => pixels,
    })
}

/// Inserts [`ONES`] before each index in `ends`, which are ascending.
fn with_ones(bytes: &[u8], ends: &[usize]) -> Vec<u8> {
    let mut filled = Vec::with_capacity(bytes.len() + (ends.len() + 1) * ONES.len());
    let mut done = 0;
    for &end in ends {
        filled.extend_from_slice(&bytes[done..end]);
        filled.extend_from_slice(&ONES);
        done = end;
    }
    filled.extend_from_slice(&bytes[done..]);
    filled
}

/// Removes the ascending ranges `junk` in one pass: a damaged file may have a million of them.
fn without(bytes: &[u8], junk: &[Range<usize>]) -> Vec<u8> {
    let ends = junk.iter().map(|range| range.start).chain([bytes.len()]);
    let starts = std::iter::once(0).chain(junk.iter().map(|range| range.end));
    starts.zip(ends).flat_map(|(start, end)| &bytes[start..end]).copied().collect()
}

/// Reads the size and the EXIF from the segments before the image data, and seeks over the other segments. Damage of
/// the image data is not detected.
pub(super) fn head<R: Read + Seek>(reader: &mut std::io::BufReader<R>) -> Result<Found, Reason> {
    let damaged = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::UnexpectedEof => "it ends before the picture (truncated); copy the file again".to_owned(),
        _ => e.to_string(),
    };
    let mut layout = Layout::default();
    let mut exif = None;
    reader.seek_relative(2).map_err(damaged)?;
    loop {
        let code = next_code(reader).map_err(damaged)?;
        match code {
            0xD9 => return Err("it contains no picture data; copy the file again".into()),
            0x01 | 0xD0..=0xD8 => continue,
            0xDA => break,
            _ => {}
        }
        let mut length = [0; 2];
        reader.read_exact(&mut length).map_err(damaged)?;
        let length = usize::from(u16::from_be_bytes(length));
        let length = length.checked_sub(2).ok_or("one of its segments is damaged; copy the file again")?;
        if !matches!(code, 0xC0..=0xCF | 0xE1 | JPEG_LS) {
            reader.seek_relative(length as i64).map_err(damaged)?;
            continue;
        }
        let mut content = vec![0; length];
        reader.read_exact(&mut content).map_err(damaged)?;
        let is_first = layout.exif.is_none();
        layout.segment(code, &content, 0..length)?;
        if let Some(range) = layout.exif.clone().filter(|_| is_first) {
            exif = Some(content[range].to_vec());
        }
    }
    let (width, height) = layout.size;
    Ok(Found { width, height, depth: 8, exif, software: None, refused: None })
}

/// Returns the code of the next marker and skips the bytes before it.
fn next_code(reader: &mut impl BufRead) -> std::io::Result<u8> {
    let mut byte = [0; 1];
    loop {
        while byte[0] != 0xFF {
            reader.read_exact(&mut byte)?;
        }
        while byte[0] == 0xFF {
            reader.read_exact(&mut byte)?;
        }
        if byte[0] != 0 {
            return Ok(byte[0]);
        }
    }
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ").trim_end_matches('.').to_string()
}

#[cfg(test)]
mod tests;
