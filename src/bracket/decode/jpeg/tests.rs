//! JPEGs of every kind, and with every kind of damage.

use super::super::tests::{PROGRESSIVE, eight, is_damage, jpeg, read, scene, with_segment};
use super::super::{decode, head};
use crate::limits::Limits;
use image::{ExtendedColorType, ImageEncoder, codecs};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use std::io::{BufReader, Cursor};
use std::path::Path;

/// Encodes a JPEG whose chroma has half the resolution along each axis whose factor is 2.
fn subsampled(rgb: &[u8], (width, height): (usize, usize), factors: (u8, u8), progressive: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 100);
    encoder.set_sampling_factor(SamplingFactor::from_factors(factors.0, factors.1).unwrap());
    encoder.set_progressive(progressive);
    encoder.encode(rgb, width as u16, height as u16, ColorType::Rgb).unwrap();
    bytes
}

/// Returns the index at which the content of the frame header begins, after its marker and its length.
fn frame_header(bytes: &[u8]) -> usize {
    bytes.windows(2).position(|w| matches!(w, [0xFF, 0xC0..=0xC2])).unwrap() + 4
}

/// The padding in the last MCUs has a colour that does not occur in the picture.
#[test]
fn jpeg_with_coarse_chroma_is_not_mixed_with_the_padding_behind_it() {
    let (inside, behind) = ([200, 60, 40], [20, 90, 250]);
    for (factors, progressive) in [((2, 2), false), ((2, 1), false), ((1, 2), false), ((2, 2), true)] {
        // The header is changed below from the padded size to a smaller size. A scan of a single component contains
        // only ceil(size / 8) blocks per axis, so the sizes are chosen so that this number stays the same.
        for (width, height) in [(26_usize, 26_usize), (154, 42), (42, 154)] {
            let stored = |size: usize, factor: u8| size.next_multiple_of(8 * usize::from(factor));
            let (across, down) = (stored(width, factors.0), stored(height, factors.1));
            let pixel = |i: usize| if i % across < width && i / across < height { inside } else { behind };
            let all: Vec<u8> = (0..across * down).flat_map(pixel).collect();
            let mut bytes = subsampled(&all, (across, down), factors, progressive);
            let at = frame_header(&bytes);
            bytes[at + 1..at + 3].copy_from_slice(&(height as u16).to_be_bytes());
            bytes[at + 3..at + 5].copy_from_slice(&(width as u16).to_be_bytes());
            for (i, p) in eight(read(&bytes)).chunks_exact(3).enumerate() {
                let is_near = p.iter().zip(inside).all(|(a, b)| a.abs_diff(b) <= 5);
                assert!(is_near, "{factors:?} {width}x{height}: {},{}: {p:?}", i % width, i / width);
            }
        }
    }
}

#[test]
fn jpeg_with_coarse_chroma_that_was_cut_is_an_error() {
    for progressive in [false, true] {
        let whole = subsampled(&scene(168, 120), (168, 120), (2, 2), progressive);
        assert!(read(&whole).is_ok());
        for part in [0.5, 0.8, 0.95, 0.99] {
            let mut cut = (whole.len() as f64 * part) as usize;
            cut -= usize::from(whole[cut - 1] == 0xFF);
            assert!(is_damage(read(&whole[..cut])), "cut at {part}");
            let closed = [&whole[..cut], &[0xFF, 0xD9]].concat();
            assert!(progressive || is_damage(read(&closed)), "cut at {part} and closed");
        }
    }
}

/// Decoding must use the current thread pool, and must fail if it needs more memory than is allowed.
#[test]
fn jpeg_with_coarse_chroma_and_padding_is_counted_and_the_same_on_any_number_of_threads() {
    let bytes = subsampled(&scene(168, 120), (168, 120), (2, 2), false);
    let decoded = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| eight(read(&bytes)))
    };
    assert_eq!(decoded(1), decoded(3));
    let needed = (168 * 120 * 6 + bytes.len()) as u64;
    let within = |memory| {
        let limits = Limits { memory: Some(memory), ..Limits::default() };
        decode(Path::new("a"), bytes.clone(), &limits)
    };
    assert_eq!(within(needed).unwrap().decoding, needed);
    assert!(is_damage(within(needed - 1)));
}

#[test]
fn jpeg_of_unsupported_kinds_is_named_and_not_called_damaged() {
    let refused = |bytes: &[u8]| {
        let limits = Limits::default();
        let whole = decode(Path::new("a"), bytes.to_vec(), &limits).map(|_| ()).unwrap_err().to_string();
        let header = head(Path::new("a"), BufReader::new(Cursor::new(bytes)), &[], &limits).map(|_| ());
        assert_eq!(header.unwrap_err().to_string(), whole);
        assert!(!whole.contains("again"), "{whole}");
        whole
    };
    for factors in [0x31, 0x32] {
        let mut bytes = jpeg(&scene(40, 24), 40);
        let at = frame_header(&bytes);
        bytes[at + 7] = factors;
        bytes[at + 10] = 0x22;
        assert!(refused(&bytes).contains(&format!("factors {}x{}", factors >> 4, factors & 15)));
    }
    let mut fraction = jpeg(&scene(40, 24), 40);
    let at = frame_header(&fraction);
    (fraction[at + 7], fraction[at + 10]) = (0x13, 0x12);
    assert!(refused(&fraction).contains("factors 1x2"));
    let lossless = [&[0xFF, 0xD8, 0xFF, 0xF7, 0, 11, 8, 0, 2, 0, 2, 1, 1, 0x11, 0, 0xFF, 0xDA, 0, 8, 1][..], &[7; 30]];
    assert!(refused(&lossless.concat()).contains("JPEG-LS"));
}

#[test]
fn jpeg_in_colour_and_grey() {
    let rgb = scene(50, 34);
    let decoded = read(&jpeg(&rgb, 50)).unwrap();
    assert_eq!((decoded.width, decoded.height), (50, 34));
    let mean = |v: &[u8]| v.iter().map(|&x| f64::from(x)).sum::<f64>() / v.len() as f64;
    assert!((mean(&eight(Ok(decoded))) - mean(&rgb)).abs() < 1.0);

    let mut grey = Vec::new();
    codecs::jpeg::JpegEncoder::new(&mut grey).write_image(&[100; 256], 16, 16, ExtendedColorType::L8).unwrap();
    assert!(eight(read(&grey)).iter().all(|&v| v.abs_diff(100) <= 1));
}

#[test]
fn jpeg_of_inks() {
    for (name, bytes) in [
        ("Adobe CMYK", &include_bytes!("../../../../tests/fixtures/cmyk-adobe.jpg")[..]),
        ("plain CMYK", include_bytes!("../../../../tests/fixtures/cmyk-plain.jpg")),
        ("YCCK", include_bytes!("../../../../tests/fixtures/ycck.jpg")),
    ] {
        let v = eight(read(bytes));
        for (x, y, wanted) in
            [(8, 8, [255u8, 0, 0]), (24, 8, [0, 255, 0]), (8, 24, [0, 0, 255]), (24, 24, [64, 64, 64])]
        {
            let p = &v[3 * (32 * y + x)..][..3];
            assert!(p.iter().zip(wanted).all(|(a, b)| a.abs_diff(b) <= 4), "{name} at {x},{y}: {p:?}, not {wanted:?}");
        }
    }
}

#[test]
fn progressive_jpeg() {
    let decoded = read(PROGRESSIVE).unwrap();
    assert_eq!((decoded.width, decoded.height), (48, 32));
    // The fixture is a ramp in x.
    let v = eight(Ok(decoded));
    let at = |x: usize| i32::from(v[3 * (48 * 16 + x) + 1]);
    assert!((at(4) - 20).abs() < 8 && (at(40) - 200).abs() < 8, "{} {}", at(4), at(40));
}

/// Fixtures of sequential JPEGs with several scans: one scan per component at 4:2:0; one scan of luma and one of both
/// chroma components at 4:4:0.
const BY_SCANS: [&[u8]; 2] = [
    include_bytes!("../../../../tests/fixtures/scans-420.jpg"),
    include_bytes!("../../../../tests/fixtures/scans-440.jpg"),
];

#[test]
fn jpeg_of_several_sequential_scans_or_fine_chroma_has_its_pixels_in_their_places() {
    let fine_chroma = &include_bytes!("../../../../tests/fixtures/fine-chroma.jpg")[..];
    for bytes in BY_SCANS.into_iter().chain([fine_chroma]) {
        let decoded = read(bytes).unwrap();
        assert_eq!((decoded.width, decoded.height), (40, 44));
        for (i, p) in eight(Ok(decoded)).chunks_exact(3).enumerate() {
            let wanted = [6 * (i % 40) as u8, 5 * (i / 40) as u8, 120];
            // Tolerance of 12: chroma is interpolated from half the resolution, and colours that leave the RGB cube are
            // clipped.
            assert!(p.iter().zip(wanted).all(|(a, b)| a.abs_diff(b) <= 12), "{},{}: {p:?}", i % 40, i / 40);
        }
    }
}

#[test]
fn jpeg_of_several_sequential_scans_that_was_cut_is_an_error() {
    for whole in BY_SCANS {
        let at = |from: usize, is_it: fn(u8) -> bool| {
            let pair = whole[from..].windows(2).position(|w| w[0] == 0xFF && is_it(w[1]));
            pair.map(|i| from + i)
        };
        let mut end = 0;
        while let Some(scan) = at(end, |code| code == 0xDA) {
            end = at(scan + 2, |code| code != 0).expect("a marker behind the scan");
            // Cuts off the last bytes of this scan, and keeps everything after the scan.
            let mut cut = end - 5;
            cut -= usize::from(whole[cut - 1] == 0xFF);
            assert!(is_damage(read(&[&whole[..cut], &whole[end..]].concat())), "before {end} of {}", whole.len());
        }
        assert!(is_damage(read(&whole[..whole.len() - 40])));
    }
}

#[test]
fn truncated_jpeg_is_an_error_at_any_length() {
    for whole in [jpeg(&scene(160, 120), 160), PROGRESSIVE.to_vec()] {
        assert!(read(&whole).is_ok());
        let cuts = [0.02, 0.3, 0.5, 0.8, 0.95, 0.97, 0.99].map(|part| (whole.len() as f64 * part) as usize);
        for cut in cuts.into_iter().chain([whole.len() - 1, whole.len() - 2]) {
            assert!(is_damage(read(&whole[..cut])), "cut at {cut} of {}", whole.len());
            let zeros = [&whole[..cut], &[0; 5000]].concat();
            assert!(is_damage(read(&zeros)), "cut at {cut} of {} and filled with zeros", whole.len());
        }
    }
}

#[test]
fn a_cut_jpeg_that_was_closed_again_is_an_error() {
    let whole = jpeg(&scene(160, 120), 160);
    for part in [0.5, 0.8, 0.95, 0.99] {
        let mut cut = (whole.len() as f64 * part) as usize;
        // Do not cut between 0xFF and the zero byte that follows it.
        cut -= usize::from(whole[cut - 1] == 0xFF);
        assert!(is_damage(read(&[&whole[..cut], &[0xFF, 0xD9]].concat())), "cut at {part}");
    }
    let cut = PROGRESSIVE.len() / 2;
    assert!(is_damage(read(&[&PROGRESSIVE[..cut], &[0xFF, 0xD9]].concat())));
}

#[test]
fn data_after_a_jpeg_and_padding_are_ignored() {
    let whole = jpeg(&scene(64, 48), 64);
    let plain = eight(read(&whole));
    let second = jpeg(&scene(16, 16), 16);
    assert_eq!(eight(read(&[&whole[..], &second].concat())), plain, "a second image, as in MPF");
    assert_eq!(eight(read(&[&whole[..], &second[..40]].concat())), plain, "half a second image");
    assert_eq!(eight(read(&[&whole[..], &[0; 999]].concat())), plain, "zeros");
    assert_eq!(eight(read(&[&whole[..20], &[0; 9], &whole[20..]].concat())), plain, "bytes between segments");
    assert_eq!(eight(read(&[&whole[..2], &[0xFF; 9], &whole[2..]].concat())), plain, "fill bytes");
    let thumbnail = with_segment(&whole, 0xE1, &second);
    assert_eq!(eight(read(&thumbnail)), plain, "a picture within a segment");
    assert!(is_damage(read(&thumbnail[..second.len() + 20])));
}

/// This checks only the result; `tests/cli/limits.rs` checks that such files take little time.
#[test]
fn many_pieces_between_segments_do_no_harm() {
    let whole = jpeg(&scene(64, 48), 64);
    let padding = [0, 0xFF, 0x01].repeat(3_000);
    assert_eq!(eight(read(&[&whole[..20], &padding, &whole[20..]].concat())), eight(read(&whole)));
}

#[test]
fn flat_pictures_of_few_bytes_are_whole() {
    for size in [1usize, 7, 8, 16, 17, 64, 200] {
        for level in [0u8, 128, 255] {
            let v = eight(read(&jpeg(&vec![level; 3 * size * size], size)));
            assert!(v.iter().all(|x| x.abs_diff(level) <= 1), "{size} px of {level}");
        }
    }
}
