//! Recognises the format of a file by its first bytes.
//!
//! In: the content of a file. Out: the [`Format`] to decode, or a description of what the file looks like, so that the
//! user knows what to convert. Source: the specifications of the formats; the list of camera raw formats follows
//! libraw's identify step.

/// A supported format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Jpeg,
    Png,
    Tiff,
}

impl Format {
    pub(super) fn name(self) -> &'static str {
        match self {
            Format::Jpeg => "JPEG",
            Format::Png => "PNG",
            Format::Tiff => "TIFF",
        }
    }
}

/// First bytes of unsupported formats, and their names.
const OTHERS: [(&[u8], &str); 22] = [
    (b"GIF8", "GIF"),
    (b"BM", "BMP"),
    (b"%PDF", "PDF"),
    (b"%!PS", "PostScript"),
    (b"8BPS", "Photoshop document"),
    (b"v/1\x01", "OpenEXR, a merged radiance map and no photograph"),
    (b"#?RADIANCE", "Radiance HDR, which is merged already"),
    (b"#?RGBE", "Radiance HDR, which is merged already"),
    (b"PF\n", "PFM, which is linear already"),
    (b"P5", "PGM"),
    (b"P6", "PPM"),
    (b"\xff\x0a", "JPEG XL"),
    (b"\0\0\0\x0cJXL ", "JPEG XL"),
    (b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (b"\xff\x4f\xff\x51", "JPEG 2000"),
    (b"FUJIFILMCCD-RAW", "camera raw (Fujifilm RAF)"),
    (b"IIRO", "camera raw (Olympus ORF)"),
    (b"IIRS", "camera raw (Olympus ORF)"),
    (b"MMOR", "camera raw (Olympus ORF)"),
    (b"IIU\0", "camera raw (Panasonic RW2)"),
    (b"PK\x03\x04", "ZIP archive"),
    (b"\0\0\0\0", "it begins with zeros; if it is damaged, copy the file again"),
];

/// Returns the format of `bytes`. If it is not supported, the error describes what `bytes` look like instead.
pub(super) fn format(bytes: &[u8]) -> Result<Format, String> {
    if bytes.starts_with(b"\xff\xd8\xff") {
        return Ok(Format::Jpeg);
    }
    if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Ok(Format::Png);
    }
    let tiff = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|magic| bytes.starts_with(*magic));
    if tiff {
        // A Canon CR2 file is recognised by "CR" in its header; other raw formats based on TIFF are recognised later by
        // their tags.
        return if bytes.get(8..10) == Some(b"CR") { Err("camera raw (Canon CR2)".into()) } else { Ok(Format::Tiff) };
    }
    Err(other(bytes).into())
}

fn other(bytes: &[u8]) -> &'static str {
    if bytes.is_empty() {
        return "empty file";
    }
    if let Some((_, name)) = OTHERS.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return name;
    }
    if bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP") {
        return "WebP";
    }
    if bytes.get(4..8) == Some(b"ftyp") {
        return match bytes.get(8..12) {
            Some(b"heic" | b"heix" | b"hevc" | b"mif1" | b"msf1" | b"heim" | b"heis") => "HEIC",
            Some(b"avif" | b"avis") => "AVIF",
            Some(b"crx ") => "camera raw (Canon CR3)",
            _ => "video",
        };
    }
    let head = &bytes[..bytes.len().min(512)];
    let printable = |b: u8| b >= 0x20 || matches!(b, b'\t' | b'\n' | b'\r' | 0x0c);
    // Text is still text if the end of `head` cuts a multi-byte character in two.
    let utf8 = match std::str::from_utf8(head) {
        Ok(_) => true,
        Err(e) => e.error_len().is_none(),
    };
    if utf8 && head.iter().copied().all(printable) { "text" } else { "unknown data" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn format_of_inputs_is_detected_by_content() {
        assert_eq!(format(b"\xff\xd8\xff\xe1...."), Ok(Format::Jpeg));
        assert_eq!(format(b"\x89PNG\r\n\x1a\n\0\0"), Ok(Format::Png));
        assert_eq!(format(b"MM\0*\0\0\0\x08"), Ok(Format::Tiff));
        assert_eq!(format(b"II+\0\x08\0\0\0"), Ok(Format::Tiff));
    }

    #[test]
    fn unsupported_content_is_named() {
        for (bytes, name) in [
            (&b""[..], "empty file"),
            (b"Dear diary,\n", "text"),
            ("Gr\u{fc}\u{df}e".as_bytes(), "text"),
            (b"\0\0\0\x18ftypheic\0\0\0\0", "HEIC"),
            (b"\0\0\0\x18ftypcrx \0\0\0\0", "camera raw (Canon CR3)"),
            (b"II*\0\x10\0\0\0CR\x02\0", "camera raw (Canon CR2)"),
            (b"v/1\x01\x02\0\0\0", "OpenEXR, a merged radiance map and no photograph"),
            (b"%PDF-1.7", "PDF"),
            (b"RIFF\x10\0\0\0WEBPVP8 ", "WebP"),
            (b"\x01\x02\x03\xfe", "unknown data"),
        ] {
            assert_eq!(format(bytes), Err(name.to_string()));
        }
    }
}
