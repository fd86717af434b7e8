//! Decodes PNG files of every colour type, at 8 or 16 bits.
//!
//! In: the file. Out: RGB at the depth of the file; palettes and depths below 8 bits become 8 bits. Cost: the `png`
//! crate. Source: W3C, Portable Network Graphics (third edition), with the eXIf, iCCP, cICP, cHRM and gAMA chunks;
//! ImageMagick, `coders/png.c`, and exiv2, `pngchunk_int.cpp`, for "Raw profile type exif", which programs wrote before
//! eXIf existed and many still write.

mod colour;

use super::{Found, Reason, Stored, to_rgb};
use crate::bracket::Samples;
use crate::limits::{self, DEFLATE, Limits as Allowed};
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::io::{BufReader, Cursor, ErrorKind, Read, Seek};

/// Decodes a PNG file. Checksums are checked up to the end of the file.
pub(super) fn decode(bytes: &[u8], allowed: &Allowed) -> Result<Stored, Reason> {
    let damaged = |e: png::DecodingError| format!("{e}; copy the file again");
    // This limits the memory for everything except the image: the profile, which is compressed and may expand to any
    // size, the EXIF, and a few rows.
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: MOST_BESIDE });
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.ignore_checksums(false);
    let header = decoder.read_header_info().map_err(damaged)?;
    let (width, height) = (header.width as usize, header.height as usize);
    allowed.check_size(width, height)?;
    let pixels = width as u64 * height as u64;
    let bits = header.bits_per_pixel() as u64;
    limits::check_length(bytes.len(), pixels * bits / 8, DEFLATE)?;
    // At the peak, memory holds the decompressed samples, for 16 bits also a copy of them as words, and the pixels as
    // RGB. A tRNS chunk adds an alpha channel; a palette is expanded to RGB, with alpha if it has a tRNS chunk.
    let channels = match header.color_type {
        ColorType::Indexed => 4,
        other => other.samples() as u64 + 1,
    };
    let (bytes_each, copies) = if header.bit_depth == BitDepth::Sixteen { (2, 2) } else { (1, 1) };
    let needed = pixels * bytes_each * (copies * channels + 3) + bytes.len() as u64;
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
        return Err(
            "it is an animated PNG whose first image is smaller than the picture; save it as a plain PNG".into()
        );
    }
    let info = reader.info();
    // The png crate ignores a profile that it cannot decompress. An empty profile takes its place here, which is
    // reported as damaged later.
    let begin = bytes.windows(4).position(|kind| kind == b"IDAT").unwrap_or(0);
    let has_profile = bytes[..begin].windows(4).any(|kind| kind == b"iCCP");
    let embedded = info.icc_profile.as_ref().map(|i| i.to_vec()).or(has_profile.then(Vec::new));
    let mut notes = Vec::new();
    let found = head(&mut BufReader::new(Cursor::new(bytes)))?;
    Ok(Stored {
        width,
        height,
        samples,
        decoding: needed,
        exif: found.exif,
        directory: 0,
        icc: colour::profile(info, embedded, &mut notes),
        has_alpha: matches!(channels, 2 | 4),
        raw: None,
        notes,
    })
}

/// Limit in bytes of the memory for everything but the image; a few rows of 65535 pixels are a fraction of it.
const MOST_BESIDE: usize = 64 << 20;

/// Maximum size in bytes of an EXIF chunk.
const MOST_EXIF: u32 = 1 << 20;

/// Reads the size, the EXIF and the name of the writing program, by seeking from chunk to chunk.
pub(super) fn head<R: Read + Seek>(reader: &mut BufReader<R>) -> Result<Found, Reason> {
    let damaged = |e: std::io::Error| match e.kind() {
        ErrorKind::UnexpectedEof => "it ends before its end marker (truncated); copy the file again".to_owned(),
        _ => e.to_string(),
    };
    reader.seek_relative(8).map_err(damaged)?;
    let mut found: Option<Found> = None;
    // An eXIf chunk takes precedence over a "Raw profile type exif" text chunk; of several of the same kind, the first
    // is used.
    let mut raw_profile = None;
    loop {
        let mut head = [0; 8];
        let read = reader.read_exact(&mut head);
        // EXIF may follow the image data, so all chunks are read. If the file is cut off after its size, the data found
        // so far is returned, unless a chunk with text or EXIF is incomplete.
        let is_end = read.is_err() || &head[4..] == b"IEND";
        match (read, found.take()) {
            (_, Some(so_far)) if is_end => return Ok(Found { exif: so_far.exif.or(raw_profile), ..so_far }),
            (Err(e), None) => return Err(damaged(e)),
            (_, so_far) => found = so_far,
        }
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]);
        let is_wanted = match &head[4..] {
            b"IHDR" => length == 13,
            b"eXIf" => length <= MOST_EXIF,
            // Raw profiles have two digits per byte of EXIF, plus line ends.
            b"tEXt" | b"zTXt" | b"iTXt" => length <= 3 * MOST_EXIF,
            _ => false,
        };
        if !is_wanted {
            if found.is_none() {
                return Err("it does not begin as a PNG does; copy the file again".into());
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
            (b"eXIf", Some(found)) => _ = found.exif.get_or_insert(content),
            (kind, Some(found)) => match text(kind, &content) {
                Some((b"Software", text)) if kind == b"tEXt" => {
                    found.software = Some(String::from_utf8_lossy(&text).into_owned());
                }
                Some((b"Raw profile type exif" | b"Raw profile type APP1", text)) if raw_profile.is_none() => {
                    raw_profile = exif_of_profile(&text);
                }
                _ => {}
            },
            _ => return Err("it does not begin as a PNG does; copy the file again".into()),
        }
    }
}

/// Returns the keyword and the text in the `content` of a text chunk; `kind` is tEXt, zTXt or iTXt.
fn text<'a>(kind: &[u8], content: &'a [u8]) -> Option<(&'a [u8], Vec<u8>)> {
    let cut = |bytes: &'a [u8]| {
        let end = bytes.iter().position(|&b| b == 0)?;
        Some((&bytes[..end], &bytes[end + 1..]))
    };
    let (keyword, rest) = cut(content)?;
    let (is_packed, packed) = match kind {
        b"tEXt" => (false, rest),
        b"zTXt" => (true, rest.get(1..)?),
        _ => {
            let (_language, rest_of) = cut(rest.get(2..)?)?;
            let (_keyword, text) = cut(rest_of)?;
            (rest[0] == 1, text)
        }
    };
    let mut text = Vec::new();
    if is_packed {
        flate2::read::ZlibDecoder::new(packed).take(3 * u64::from(MOST_EXIF)).read_to_end(&mut text).ok()?;
    } else {
        text.extend_from_slice(packed);
    }
    Some((keyword, text))
}

/// Returns the EXIF of a raw profile, from its TIFF header on. The text is a name, the length, and lines of two
/// hexadecimal digits per byte.
fn exif_of_profile(text: &[u8]) -> Option<Vec<u8>> {
    let text = std::str::from_utf8(text).ok()?;
    let mut words = text.split_ascii_whitespace();
    let (_name, length) = (words.next()?, words.next()?.parse::<usize>().ok()?);
    let digits: Option<Vec<u8>> = words.flat_map(str::chars).map(|c| c.to_digit(16).map(|d| d as u8)).collect();
    let bytes: Vec<u8> = digits?.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect();
    let bytes = bytes.get(..length)?;
    Some(bytes.strip_prefix(b"Exif\0\0").unwrap_or(bytes).to_vec())
}
