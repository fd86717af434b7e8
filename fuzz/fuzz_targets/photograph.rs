//! Photographs: the bytes of a file through the header, the decoders, EXIF and ICC.
//!
//! In: a JPEG, PNG, TIFF or DNG; a TIFF is also used as an EXIF block, and an ICC profile as that of a small JPEG.
//! Checked: no panic, no hang, no allocation beyond the size; a loaded picture has the size and depth of its header;
//! exposures are finite; errors name the file.
#![no_main]

use hdralign::bracket::colour::{Found, Profile};
use hdralign::bracket::{LoadOptions, load};
use hdralign::error::Error;
use hdralign_fuzz::{check_error, hash, header, held, put, set_up};
use libfuzzer_sys::fuzz_target;
use std::sync::OnceLock;

/// Largest number of pixels that are decoded.
const MOST_PIXELS: u64 = 1 << 20;

fuzz_target!(init: set_up(), |data: &[u8]| held(|| photograph(data)));

fn photograph(data: &[u8]) {
    check(data, hash(data));
    if data.starts_with(b"II*\0") || data.starts_with(b"MM\0*") {
        check(&with_segment(0xE1, &[b"Exif\0\0", data]), hash(data) >> 8);
    }
    if data.get(36..40) == Some(b"acsp") {
        if let Found::Rgb(profile) = Profile::parse(data.to_vec()) {
            let of = profile.primaries.map(|p| [p.red, p.green, p.blue, p.white]);
            assert!(of.is_none_or(|of| of.as_flattened().iter().all(|v| v.is_finite())), "{of:?}");
        }
        check(&with_segment(0xE2, &[b"ICC_PROFILE\0\x01\x01", data]), hash(data) >> 8);
    }
}

/// Returns a JPEG of 8 x 8 pixels with a segment that has the marker `code` and the content `parts`.
fn with_segment(code: u8, parts: &[&[u8]]) -> Vec<u8> {
    static PLAIN: OnceLock<Vec<u8>> = OnceLock::new();
    let plain = PLAIN.get_or_init(|| {
        let mut bytes = Vec::new();
        let pixels: Vec<u8> = (0..192).map(|i| i as u8).collect();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut bytes);
        encoder.encode(&pixels, 8, 8, image::ExtendedColorType::Rgb8).expect("a JPEG");
        bytes
    });
    let content = parts.concat();
    let length = (content.len() + 2).min(0xFFFF);
    let mut bytes = plain[..2].to_vec();
    bytes.extend([0xFF, code]);
    bytes.extend((length as u16).to_be_bytes());
    bytes.extend(&content[..length - 2]);
    bytes.extend(&plain[2..]);
    bytes
}

/// Reads the file `data` alone, and as a bracket of two equal files.
fn check(data: &[u8], way: u64) {
    let paths = vec![put("a.jpg", data), put("b.png", data)];
    let header = header(&paths[0]);
    // If exposures are given, any picture is accepted; otherwise the file must contain its exposure.
    let ev = (way % 4 != 0).then(|| vec![0.0, 2.0]);
    let options = LoadOptions { ev, max_pixels: MOST_PIXELS, keep_gps: way & 4 != 0, ..LoadOptions::default() };
    let loaded = load(&paths, &options);
    match (&header, &loaded) {
        (Ok(header), Ok((bracket, warnings))) => {
            assert_eq!((header.width, header.height), (bracket.width(), bracket.height()));
            let depth = if bracket.frames()[0].max() == 255 { 8 } else { 16 };
            assert_eq!(header.depth, depth, "bits of a sample");
            for frame in bracket.frames() {
                assert!(frame.exposure.ev().is_finite() && frame.exposure.relative() > 0.0, "{:?}", frame.exposure);
                let p = frame.primaries();
                assert!([p.red, p.green, p.blue, p.white].as_flattened().iter().all(|v| v.is_finite()), "{p:?}");
                assert!(p.to_xyz().is_some(), "{p:?}");
                frame.grey().expect("in memory");
            }
            assert!(warnings.iter().all(|w| !w.to_string().is_empty()));
        }
        (Err(e), Ok(_)) => panic!("the header is refused ({e}), and the file loaded"),
        (header, Err(e)) => {
            check_error(e, ".");
            if let Err(e) = header {
                check_error(e, "a.jpg");
            }
            // The two files have equal content, so their pictures have the same size, but they are not the same file.
            let wrong = matches!(e, Error::SizeMismatch { .. } | Error::SameFile { .. } | Error::TooFewFrames { .. });
            assert!(!wrong, "{e}");
        }
    }
}
