//! PNG: all of its kinds, at 8 or 16 bit.
//!
//! In: the file. Out: RGB at the file's depth; fewer than 8 bit and palettes become 8. Cost: that of the `png` crate.
//! Source: W3C, Portable Network Graphics (third edition), with the eXIf, iCCP, cICP, cHRM and gAMA chunks.

mod colour;

use super::{Found, Reason, Stored, to_rgb};
use crate::bracket::Samples;
use crate::limits::{self, DEFLATE, Limits as Allowed};
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::io::{BufReader, Cursor, Read, Seek};

/// Decodes a PNG file. Checksums are checked up to the end of the file.
pub(super) fn decode(bytes: &[u8], allowed: &Allowed) -> Result<Stored, Reason> {
    let damaged = |e: png::DecodingError| format!("{e}; copy the file again");
    // Beside the picture: its profile, which is packed and may be of any size, its EXIF, and a few of its rows.
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: MOST_BESIDE });
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    let header = decoder.read_header_info().map_err(damaged)?;
    let (width, height) = (header.width as usize, header.height as usize);
    allowed.check_size(width, height)?;
    let pixels = width as u64 * height as u64;
    let bits = header.bits_per_pixel() as u64;
    limits::check_length(bytes.len(), pixels * bits / 8, DEFLATE)?;
    let (bytes_each, channels) = (if header.bit_depth == BitDepth::Sixteen { 2 } else { 1 }, 1 + bits.div_ceil(8));
    // Unpacked, taken apart into words, and as RGB.
    let needed = pixels * bytes_each * (channels.max(3) + 3) + bytes.len() as u64;
    allowed.check_memory((width, height), needed)?;
    let mut reader = decoder.read_info().map_err(damaged)?;
    let size = reader.output_buffer_size().ok_or("it is too large for this machine")?;
    let mut values = limits::room(size)?;
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
    // A profile that could not be unpacked is passed over in silence; an empty one is told to be damaged.
    let begin = bytes.windows(4).position(|kind| kind == b"IDAT").unwrap_or(0);
    let has_profile = bytes[..begin].windows(4).any(|kind| kind == b"iCCP");
    let embedded = info.icc_profile.as_ref().map(|i| i.to_vec()).or(has_profile.then(Vec::new));
    let mut notes = Vec::new();
    Ok(Stored {
        width,
        height,
        samples,
        decoding: needed,
        exif: info.exif_metadata.as_ref().map(|e| e.to_vec()),
        icc: colour::profile(info, embedded, &mut notes),
        has_alpha: matches!(channels, 2 | 4),
        notes,
    })
}

/// Most bytes of what comes with a picture; its largest rows, of 65535 pixels and more, are a fraction of it.
const MOST_BESIDE: usize = 64 << 20;

/// Most bytes of a chunk that is taken for EXIF.
const MOST_EXIF: u32 = 1 << 20;

/// The size, the EXIF and the program, by seeking from chunk to chunk: each says how long it is.
pub(super) fn head<R: Read + Seek>(reader: &mut BufReader<R>) -> Result<Found, Reason> {
    let damaged = |_| Reason::from("it ends before the picture (truncated); copy the file again");
    reader.seek_relative(8).map_err(damaged)?;
    let mut found: Option<Found> = None;
    loop {
        let mut head = [0; 8];
        // EXIF may stand behind the picture, but one that is cut off in its data has its size all the same.
        match (reader.read_exact(&mut head), found.take()) {
            (Ok(()), so_far) => found = so_far,
            (Err(_), Some(so_far)) => return Ok(so_far),
            (Err(e), None) => return Err(damaged(e)),
        }
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]);
        let is_wanted = match &head[4..] {
            b"IHDR" => length >= 13,
            b"eXIf" | b"tEXt" => length <= MOST_EXIF,
            _ => false,
        };
        if !is_wanted {
            match found {
                Some(found) if &head[4..] == b"IEND" => return Ok(found),
                Some(_) => {}
                None => return Err("it does not begin as a PNG does; copy the file again".into()),
            }
            reader.seek_relative(i64::from(length) + 4).map_err(damaged)?;
            continue;
        }
        let mut content = vec![0; length as usize + 4];
        reader.read_exact(&mut content).map_err(damaged)?;
        content.truncate(length as usize);
        match (&head[4..], &mut found) {
            (b"IHDR", _) => {
                let number = |at: usize| u32::from_be_bytes([0, 1, 2, 3].map(|i| content[at + i])) as usize;
                let (width, height, depth) = (number(0), number(4), content[8].max(8));
                found = Some(Found { width, height, depth, exif: None, software: None, refused: None });
            }
            // Of several the decoder takes the first.
            (b"eXIf", Some(found)) => _ = found.exif.get_or_insert(content),
            (_, Some(found)) => {
                if let Some(text) = content.strip_prefix(b"Software\0") {
                    found.software = Some(String::from_utf8_lossy(text).into_owned());
                }
            }
            _ => return Err("it does not begin as a PNG does; copy the file again".into()),
        }
    }
}
