//! TIFFs of every kind of colour, written entry by entry.

use super::super::tests::{eight, read};
use super::head;
use crate::bracket::Samples;
use crate::tiff_file::tests::{DATA, Entries, file, rgb, with};
use exif::In;
use std::io::Cursor;

/// Returns the entries of an uncompressed picture with `samples` samples per pixel of `depth` bits each, and the given
/// photometric interpretation.
fn of_kind((width, height): (u32, u32), samples: u32, depth: u32, photometric: u32) -> Entries {
    let row = (width * samples * depth).div_ceil(8);
    let kinds = [
        (258, 3, vec![depth; samples as usize]),
        (262, 3, vec![photometric]),
        (277, 3, vec![samples]),
        (279, 4, vec![row * height]),
    ];
    kinds.into_iter().fold(rgb(width, height, DATA), with)
}

/// Replaces each sample by its difference from the same sample of the previous pixel in the row, as predictor 2 stores
/// it.
fn differences(samples: &[u16], width: usize, per_pixel: usize) -> Vec<u16> {
    let row = |row: &[u16]| -> Vec<u16> {
        let before = |i: usize| i.checked_sub(per_pixel).map_or(0, |i| row[i]);
        row.iter().enumerate().map(|(i, v)| v.wrapping_sub(before(i))).collect()
    };
    samples.chunks_exact(width * per_pixel).flat_map(row).collect()
}

#[test]
fn tiff_with_alpha_or_extra_samples_has_its_colours_with_a_predictor_or_without() {
    let size = (5, 3);
    // Grey with 0 as black, grey with 0 as white, and RGB. Each is tested with alpha, with one or two extra samples of
    // unspecified meaning, and with an extra sample that ExtraSamples does not describe.
    for (photometric, colours) in [(1, 1), (0, 1), (2, 3)] {
        for (extra, has_alpha) in
            [(vec![1], true), (vec![2], true), (vec![0], false), (vec![0, 0], false), (vec![], true)]
        {
            let samples = colours + extra.len().max(1);
            let values: Vec<u16> = (0..15 * samples).map(|i| (i * i * 997 % 65_521) as u16).collect();
            let seen = |v: u16| if photometric == 0 { u16::MAX - v } else { v };
            let pixel = |p: &[u16]| [0, 1, 2].map(|c| seen(p[c.min(colours - 1)]));
            let wanted: Vec<u16> = values.chunks_exact(samples).flat_map(pixel).collect();
            for predictor in [1, 2] {
                let stored = if predictor == 2 { differences(&values, 5, samples) } else { values.clone() };
                let mut entries = with(of_kind(size, samples as u32, 16, photometric), (317, 3, vec![predictor]));
                if !extra.is_empty() {
                    entries = with(entries, (338, 3, extra.clone()));
                }
                let data: Vec<u8> = stored.iter().flat_map(|v| v.to_le_bytes()).collect();
                let decoded = read(&file(&data, &[entries])).unwrap();
                assert_eq!(decoded.has_alpha, has_alpha, "{photometric} {extra:?}");
                assert!(decoded.samples == Samples::Sixteen(wanted.clone()), "{photometric} {extra:?} {predictor}");
            }
            let eights: Vec<u8> = values.iter().map(|&v| v as u8).collect();
            let wanted: Vec<u8> = wanted.iter().map(|&v| v as u8).collect();
            let mut entries = of_kind(size, samples as u32, 8, photometric);
            if !extra.is_empty() {
                entries = with(entries, (338, 3, extra));
            }
            assert_eq!(eight(read(&file(&eights, &[entries]))), wanted);
        }
    }
}

#[test]
fn tiff_with_a_palette_has_the_colours_of_its_map() {
    for (depth, stored) in
        [(1_u32, vec![0b1010_0000]), (2, vec![0b1100_0100]), (4, vec![0xF0, 0x20]), (8, vec![255, 0, 3])]
    {
        let last = (1 << depth) - 1;
        let indices: Vec<u32> = match depth {
            8 => vec![255, 0, 3],
            _ => (0..3)
                .map(|x| u32::from(stored[(x * depth / 8) as usize]) >> (8 - depth - x * depth % 8) & last)
                .collect(),
        };
        // Colour maps with 16-bit values, and with 8-bit values as in old files.
        for scale in [257, 256, 1] {
            let value = |index: u32, c: u32| (index * 5 + c * 60 + 9) % 256;
            let map: Vec<u32> = (0..3).flat_map(|c| (0..=last).map(move |i| scale * value(i, c))).collect();
            let entries = with(of_kind((3, 1), 1, depth, 3), (320, 3, map));
            let wanted: Vec<u8> = indices.iter().flat_map(|&i| [0, 1, 2].map(|c| value(i, c) as u8)).collect();
            assert_eq!(eight(read(&file(&stored, &[entries]))), wanted, "{depth} bit, {scale}");
        }
    }
}

#[test]
fn tiff_of_unsupported_kinds_is_named_and_not_called_damaged() {
    let refused = |entries: Entries| {
        let reason = read(&file(&[0; 60], &[entries])).map(|_| ()).unwrap_err().to_string();
        assert!(!reason.contains("again"), "{reason}");
        reason
    };
    // With chroma at half the resolution in both directions, 6 x 6 pixels have 54 bytes of data instead of 108 (3 per
    // pixel).
    let coarse = with(of_kind((6, 6), 3, 8, 6), (530, 3, vec![2, 2]));
    assert!(refused(with(coarse, (279, 4, vec![54]))).contains("YCbCr"));
    assert!(refused(of_kind((4, 4), 3, 8, 8)).contains("L*a*b*"));
    assert!(refused(of_kind((2, 2), 1, 12, 1)).contains("12 bit"));
    assert!(refused(with(of_kind((2, 2), 3, 8, 2), (259, 3, vec![50000]))).contains("compression"));
}

#[test]
fn head_of_a_dng_has_its_exposure_without_decoding() {
    let mut entries: Entries = vec![
        (254, 4, vec![0]),
        (256, 4, vec![60]),
        (257, 4, vec![40]),
        (258, 3, vec![16]),
        (259, 3, vec![1]),
        (262, 3, vec![32803]),
        (273, 4, vec![DATA]),
        (277, 3, vec![1]),
        (279, 4, vec![4800]),
        (305, 2, b"camera\0".map(u32::from).to_vec()),
        (33421, 3, vec![2, 2]),
        (33422, 1, vec![0, 1, 1, 2]),
        (33434, 5, vec![1, 60]),
        (34855, 3, vec![200]),
        (50706, 1, vec![1, 4, 0, 0]),
        (50719, 4, vec![4, 2]),
        (50720, 4, vec![50, 30]),
        // From XYZ to linear sRGB (IEC 61966-2-1).
        (
            50721,
            11,
            [3.2406f32, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570].map(f32::to_bits).to_vec(),
        ),
    ];
    entries.sort();
    let wanted = [exif::Tag::ExposureTime, exif::Tag::PhotographicSensitivity, exif::Tag::FNumber];
    let found = head(Cursor::new(file(&[], &[entries.clone()])), &wanted).unwrap();
    assert_eq!((found.width, found.height, found.depth, found.refused), (50, 30, 16, None));
    assert_eq!(found.software.as_deref(), Some("camera"));
    let exif = exif::Reader::new().read_raw(found.exif.unwrap()).unwrap();
    let shown = |tag| exif.get_field(tag, In::PRIMARY).map(|field| field.display_value().to_string());
    assert_eq!(wanted.map(shown), [Some("1/60".into()), Some("200".into()), None]);
    // Lossy compression is not supported.
    let lossy = head(Cursor::new(file(&[], &[with(entries, (259, 3, vec![34892]))])), &wanted).unwrap();
    assert!(lossy.refused.is_some_and(|reason| reason.contains("lossy compression")));
}
