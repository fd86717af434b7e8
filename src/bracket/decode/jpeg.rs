//! JPEG: baseline and progressive, grey, YCbCr, RGB, CMYK and Adobe's YCCK.
//!
//! In: the file. Out: 8-bit RGB, by zune-jpeg, straight into its buffer. Cost: zune-jpeg's (7 ns a pixel at 4:2:0), and one look for 0xFF
//! through the file. Three kinds of files go to jpeg-decoder, which takes three times as long, because zune-jpeg 0.5.15 gets them wrong:
//! sequential ones of several scans, whose blocks it misplaces where chroma has fewer rows; those whose chroma is finer than luma; and those
//! whose last chroma sample it interpolates with the padding behind the picture, which is anything.
//! Source: ITU-T T.81 (annexes B, F, G), Adobe Technical Note 5116 for the APP14 marker, CIPA DC-007 (MPF) for what may follow.
//!
//! Decoders fill what is missing with grey or with noise, each in its way, so the file is walked first: it must be whole up to the end of
//! its first image. Further images behind it (MPF previews, gain maps) and trailing bytes are cut off. For a file that was cut and then
//! closed with an end marker by a repair tool, the data of each sequential scan is followed by ones, which are no Huffman code (T.81,
//! annex C): a decoder that runs past its data meets them and fails; a progressive one must have sent every coefficient in full.

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

/// 64 ones of entropy-coded data, more than any code and its value have: each 0xFF is followed by a zero (T.81, F.1.2.3).
const ONES: [u8; 16] = [0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0];

/// Most scans of a picture: encoders make about ten, and each goes through the whole picture, however little it says.
const MOST_SCANS: usize = 200;

/// Decodes a JPEG file.
pub(super) fn decode(mut bytes: Vec<u8>, limits: &Limits) -> Result<Stored, Reason> {
    let mut layout = Layout::of(&bytes)?;
    if !layout.junk.is_empty() {
        // Padding between segments is harmless, but strict decoding refuses it.
        bytes = without(&bytes, &layout.junk);
        layout = Layout::of(&bytes)?;
    }
    layout.check_complete()?;
    let scans = layout.scan_ends.len();
    if scans > MOST_SCANS {
        return Err(format!("it is of {scans} scans, and {MOST_SCANS} are read; save it as plain JPEG"));
    }
    let (width, height) = layout.size;
    limits.check_size(width, height)?;
    let pixels = width as u64 * height as u64;
    // A block of 64 pixels takes a bit, in any kind of scan; chroma may be finer than luma, but by four by four at most.
    limits::check_length(bytes.len(), pixels, 64 * 8 * 16)?;
    let is_beyond_zune = layout.is_beyond_zune();
    // RGB or CMYK; of a progressive file all coefficients, and of what jpeg-decoder reads all components.
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

    // Without Adobe's marker the inks are as they are; with it they are inverted, as zune-jpeg takes all of them to be.
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
        return Err("its colour components are of a kind that is not supported; save it as RGB or grey".into());
    }
    let samples = if plain_cmyk { cmyk_to_rgb(&pixels, 4, 255) } else { pixels };
    Ok(Stored {
        width,
        height,
        samples: Samples::Eight(samples),
        decoding,
        exif,
        directory: 0,
        icc,
        has_alpha: false,
        notes: Vec::new(),
    })
}

/// The pixels of a file that zune-jpeg gets wrong: RGB, or the inks as they are where they are `plain_cmyk`. `space` is that of the file.
/// Parallel work is that of the thread pool it is called in.
fn by_jpeg_decoder(bytes: &[u8], space: ColorSpace, plain_cmyk: bool) -> Result<Vec<u8>, Reason> {
    let transform = match space {
        ColorSpace::YCbCr => ColorTransform::YCbCr,
        ColorSpace::RGB => ColorTransform::RGB,
        ColorSpace::YCCK => ColorTransform::YCCK,
        ColorSpace::CMYK => ColorTransform::CMYK,
        _ => return Err("its colour components are of a kind that is not supported; save it as RGB or grey".into()),
    };
    let mut decoder = jpeg_decoder::Decoder::new(bytes);
    decoder.set_color_transform(transform);
    let refused = |e: jpeg_decoder::Error| {
        let is_kind = matches!(e, jpeg_decoder::Error::Unsupported(_));
        format!(
            "{}; {}",
            one_line(&e.to_string()),
            if is_kind { "save it as plain JPEG" } else { "copy the file again" }
        )
    };
    let pixels = decoder.decode().map_err(refused)?;
    Ok(match space {
        // It takes all inks to be inverted, as Adobe's are.
        ColorSpace::CMYK | ColorSpace::YCCK if plain_cmyk => pixels.into_iter().map(|ink| 255 - ink).collect(),
        ColorSpace::CMYK | ColorSpace::YCCK => cmyk_to_rgb(&pixels, 4, 255),
        _ => pixels,
    })
}

/// `bytes` with [`ONES`] before each of `ends`, which are in order.
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

/// `bytes` without the ranges `junk`, which are in order. In one go: a damaged file may have a million of them.
fn without(bytes: &[u8], junk: &[Range<usize>]) -> Vec<u8> {
    let ends = junk.iter().map(|range| range.start).chain([bytes.len()]);
    let starts = std::iter::once(0).chain(junk.iter().map(|range| range.end));
    starts.zip(ends).flat_map(|(start, end)| &bytes[start..end]).copied().collect()
}

/// What stands before the picture's data, by seeking: the size and the EXIF. Damage behind that is not seen.
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
            0xD9 => return Err("it holds no picture data; copy the file again".into()),
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

/// The code of the next marker; what stands before it is passed over.
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
