//! JPEG: baseline and progressive, grey, YCbCr, RGB, CMYK and Adobe's YCCK.
//!
//! In: the file. Out: 8-bit RGB, by zune-jpeg, straight into its buffer. Cost: zune-jpeg's, and one look for 0xFF through the file.
//! Sequential files of several scans, and those whose chroma is finer than luma, are decoded by jpeg-decoder: zune-jpeg 0.5.15 misplaces
//! blocks of the former where chroma has fewer rows, and samples of the latter.
//! Source: ITU-T T.81 (annexes B, F, G), Adobe Technical Note 5116 for the APP14 marker, CIPA DC-007 (MPF) for what may follow.
//!
//! Decoders fill what is missing with grey or with noise, each in its way, so the file is walked first: it must be whole up to the end of
//! its first image. Further images behind it (MPF previews, gain maps) and trailing bytes are cut off. For a file that was cut and then
//! closed with an end marker by a repair tool, the data of each sequential scan is followed by ones, which are no Huffman code (T.81,
//! annex C): a decoder that runs past its data meets them and fails; a progressive one must have sent every coefficient in full.

use super::{Found, Reason, Stored, cmyk_to_rgb};
use crate::bracket::Samples;
use crate::limits::{self, Limits};
use jpeg_decoder::ColorTransform;
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
    let is_odd = !layout.progressive && scans > 1 || !layout.is_luma_finest;
    // RGB or CMYK; of a progressive file all coefficients, and of what jpeg-decoder reads all components.
    let kept = if layout.progressive { 2 } else { 0 } + u64::from(is_odd);
    let rgb = if layout.components == 4 { 4 + 3 } else { 3 };
    let decoding = pixels * (rgb + kept * layout.components as u64) + bytes.len() as u64;
    limits.check_memory((width, height), decoding)?;
    let exif = layout.exif.map(|range| bytes[range].to_vec());
    bytes.truncate(layout.end - END.len());
    if !layout.progressive {
        bytes = with_ones(&bytes, &layout.scan_ends);
    }
    bytes.extend(END);

    // Without Adobe's marker the inks are as they are; with it they are inverted, as zune-jpeg takes all of them to be.
    let plain_cmyk = layout.components == 4 && !layout.adobe;
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
    let pixels = if is_odd {
        let space = decoder.input_colorspace().ok_or("it has no components")?;
        odd(&bytes, space, plain_cmyk)?
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
fn odd(bytes: &[u8], space: ColorSpace, plain_cmyk: bool) -> Result<Vec<u8>, Reason> {
    let transform = match space {
        ColorSpace::YCbCr => ColorTransform::YCbCr,
        ColorSpace::RGB => ColorTransform::RGB,
        ColorSpace::YCCK => ColorTransform::YCCK,
        ColorSpace::CMYK => ColorTransform::CMYK,
        _ => return Err("its colour components are of a kind that is not supported; save it as RGB or grey".into()),
    };
    let mut decoder = jpeg_decoder::Decoder::new(bytes);
    decoder.set_color_transform(transform);
    let damaged = |e: jpeg_decoder::Error| format!("{}; copy the file again", one_line(&e.to_string()));
    let pixels = decoder.decode().map_err(damaged)?;
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
        if !matches!(code, 0xC0..=0xCF | 0xE1) {
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

/// What the walk through the markers of the first image finds.
#[derive(Default)]
struct Layout {
    exif: Option<Range<usize>>,
    adobe: bool,
    /// Width and height, in pixels.
    size: (usize, usize),
    components: usize,
    /// Whether no component is sampled more finely than the first.
    is_luma_finest: bool,
    progressive: bool,
    /// Bytes between segments that belong to none.
    junk: Vec<Range<usize>>,
    /// By component identifier and coefficient: the bit down to which it was sent, plus one; 0 is "not at all".
    sent: Vec<(u8, [u8; 64])>,
    /// Just past the entropy-coded data of each scan.
    scan_ends: Vec<usize>,
    /// Just past the end marker.
    end: usize,
}

impl Layout {
    fn of(bytes: &[u8]) -> Result<Self, Reason> {
        let truncated = || {
            let kb = bytes.len().div_ceil(1000);
            format!("it ends in the middle of the picture, after {kb} kB (truncated); copy the file again")
        };
        let mut layout = Layout::default();
        let mut at = 2;
        loop {
            let marker = next_marker(bytes, at).ok_or_else(truncated)?;
            // next_marker gives the index of the marker's code, one past its last 0xFF.
            let first_ff = bytes[at..marker].iter().rposition(|&b| b != 0xFF).map_or(at, |i| at + i + 1);
            if first_ff > at {
                layout.junk.push(at..first_ff);
            }
            at = marker + 1;
            match bytes[marker] {
                0xD9 => {
                    layout.end = at;
                    return if layout.scan_ends.is_empty() {
                        Err("it holds no picture data; copy the file again".into())
                    } else {
                        Ok(layout)
                    };
                }
                // TEM: it stands alone and says nothing, but decoders look for its length.
                0x01 => layout.junk.push(first_ff..at),
                0xD0..=0xD8 => continue,
                code => {
                    let length = bytes.get(at..at + 2).ok_or_else(truncated)?;
                    let length = usize::from(u16::from_be_bytes([length[0], length[1]]));
                    let body = at + 2..at + length;
                    let content = bytes.get(body.clone()).ok_or_else(truncated)?;
                    at += length;
                    layout.segment(code, content, body)?;
                    if code == 0xDA {
                        at = scan_end(bytes, at).ok_or_else(truncated)?;
                        // Before a marker there may be more of 0xFF.
                        let fill = bytes[..at].iter().rev().take_while(|&&b| b == 0xFF).count();
                        layout.scan_ends.push(at - fill);
                    }
                }
            }
        }
    }

    fn segment(&mut self, code: u8, content: &[u8], at: Range<usize>) -> Result<(), Reason> {
        match code {
            0xE1 if self.exif.is_none() && content.starts_with(b"Exif\0") && content.len() > 6 => {
                self.exif = Some(at.start + 6..at.end);
            }
            0xEE if content.starts_with(b"Adobe") => self.adobe = true,
            0xC0..=0xC2 => {
                let depth = content.first().copied().unwrap_or(0);
                if depth != 8 {
                    return Err(format!("its samples are of {depth} bit, which is not supported; save it with 8 bit"));
                }
                self.progressive = code == 0xC2;
                let number = |at: usize| Some(u16::from_be_bytes([*content.get(at)?, *content.get(at + 1)?]).into());
                self.size = (number(3).unwrap_or(0), number(1).unwrap_or(0));
                self.components = content.get(5).copied().unwrap_or(0).into();
                let finest = content.get(7).copied().unwrap_or(0);
                let is_finer = |factors: u8| factors >> 4 > finest >> 4 || factors & 15 > finest & 15;
                self.is_luma_finest = !content.iter().skip(7).step_by(3).any(|&factors| is_finer(factors));
                self.sent = content[6.min(content.len())..].chunks_exact(3).map(|c| (c[0], [0; 64])).collect();
            }
            0xC3 | 0xC5..=0xC7 | 0xC9..=0xCB | 0xCD..=0xCF => {
                return Err("it is lossless, hierarchical or arithmetic-coded JPEG, which is not supported; save it as plain JPEG".into());
            }
            0xDA => {
                let count = usize::from(content.first().copied().unwrap_or(0));
                let (Some(of), Some(&[first, last, bits])) =
                    (content.get(1..1 + 2 * count), content.get(1 + 2 * count..4 + 2 * count))
                else {
                    return Err("its scan header is damaged; copy the file again".into());
                };
                for id in of.iter().step_by(2) {
                    for (_, coefficients) in self.sent.iter_mut().filter(|(own, _)| own == id) {
                        let band = usize::from(first.min(63))..=usize::from(last.min(63));
                        coefficients.get_mut(band).into_iter().flatten().for_each(|c| *c = 1 + (bits & 15));
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Whether every component was sent, and in a progressive file every coefficient to its last bit.
    fn check_complete(&self) -> Result<(), Reason> {
        let whole = |sent: &[u8; 64]| {
            if self.progressive { sent.iter().all(|&c| c == 1) } else { sent[0] > 0 }
        };
        if self.sent.is_empty() || !self.sent.iter().all(|(_, sent)| whole(sent)) {
            return Err("scans are missing, it was cut off; copy the file again".into());
        }
        Ok(())
    }
}

/// The index of the next marker's code, at or after `at`; `None` where the file ends before.
fn next_marker(bytes: &[u8], mut at: usize) -> Option<usize> {
    loop {
        at += first_ff(bytes.get(at..)?)?;
        let code = at + bytes[at..].iter().position(|&b| b != 0xFF)?;
        if bytes[code] != 0 {
            return Some(code);
        }
        at = code + 1;
    }
}

/// The index of the first 0xFF: there is one in some 200 bytes of entropy-coded data, and none of the others need be looked at by itself.
fn first_ff(bytes: &[u8]) -> Option<usize> {
    let (groups, _) = bytes.as_chunks::<32>();
    let holds_one = |group: &[u8; 32]| group.iter().fold(false, |any, &b| any | (b == 0xFF));
    let skipped = 32 * groups.iter().position(holds_one).unwrap_or(groups.len());
    bytes[skipped..].iter().position(|&b| b == 0xFF).map(|i| skipped + i)
}

/// The index of the 0xFF of the marker that ends the entropy-coded data at `at`; restart markers belong to the data.
fn scan_end(bytes: &[u8], mut at: usize) -> Option<usize> {
    loop {
        let code = next_marker(bytes, at)?;
        if !(0xD0..=0xD7).contains(&bytes[code]) {
            return Some(code - 1);
        }
        at = code + 1;
    }
}
