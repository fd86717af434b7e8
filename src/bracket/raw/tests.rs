//! Raw files that are written tag by tag.

use super::lossless_jpeg::tests::{Coding, encoded, uniform};
use super::*;
use crate::bracket::colour::Primaries;
use crate::tiff_file::tests::{DATA, Entries, file, with};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::Write;

const SIZE: (usize, usize) = (44, 30);

fn floats(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

/// Tags of a Bayer mosaic of 16-bit samples in one strip of `length` bytes. The camera sees sRGB, and daylight as grey.
fn mosaic(length: usize) -> Entries {
    // From XYZ to linear sRGB (IEC 61966-2-1).
    let matrix = [3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570];
    let mut entries = vec![
        (254, 4, vec![0]),
        (256, 4, vec![SIZE.0 as u32]),
        (257, 4, vec![SIZE.1 as u32]),
        (258, 3, vec![16]),
        (259, 3, vec![1]),
        (262, 3, vec![32803]),
        (273, 4, vec![DATA]),
        (277, 3, vec![1]),
        (278, 4, vec![SIZE.1 as u32]),
        (279, 4, vec![length as u32]),
        (33421, 3, vec![2, 2]),
        (33422, 1, vec![0, 1, 1, 2]),
        (50706, 1, vec![1, 4, 0, 0]),
        (50714, 4, vec![100]),
        (50717, 4, vec![4100]),
        (50721, 11, floats(&matrix)),
        (50728, 11, floats(&[1.0, 1.0, 1.0])),
    ];
    entries.sort();
    entries
}

/// Values of 12 bits.
fn values() -> Vec<u16> {
    (0..SIZE.0 * SIZE.1).map(|i| 100 + (3900.0 * uniform(1, i as u64, 0)) as u16).collect()
}

/// The samples that are read from a file.
fn read(data: &[u8], entries: Entries) -> Result<Vec<u16>, Reason> {
    match dng::read(&file(data, &[entries]), &Limits::default())?.0.values {
        Values::Integers(plane) => Ok(plane.into_vec()),
        Values::Floats(_) => panic!("floats"),
    }
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn integers_are_read_however_they_are_packed() {
    let values = values();
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(read(&bytes, mosaic(bytes.len())), Ok(values.clone()));
    // Twelve bits each.
    let pairs = values.as_chunks::<2>().0;
    let packed: Vec<u8> =
        pairs.iter().flat_map(|&[a, b]| [(a >> 4) as u8, (a << 4) as u8 | (b >> 8) as u8, b as u8]).collect();
    assert_eq!(read(&packed, with(mosaic(packed.len()), (258, 3, vec![12]))), Ok(values.clone()));
    // Differences, deflated.
    let difference =
        |i: usize| if i.is_multiple_of(SIZE.0) { values[i] } else { values[i].wrapping_sub(values[i - 1]) };
    let bytes: Vec<u8> = (0..values.len()).flat_map(|i| difference(i).to_le_bytes()).collect();
    let data = deflated(&bytes);
    let entries = with(with(mosaic(data.len()), (259, 3, vec![8])), (317, 3, vec![2]));
    assert_eq!(read(&data, entries.clone()), Ok(values.clone()));
    assert!(read(&data[..data.len() / 2], entries).is_err());
}

#[test]
fn tiles_of_lossless_jpeg_are_cut_at_the_edges() {
    let values = values();
    let (tile, coding) = (32, Coding { bits: 12, components: 2, predictor: 1, restart_rows: 0 });
    let (mut data, mut offsets, mut lengths) = (Vec::new(), Vec::new(), Vec::new());
    for column in 0..2 {
        let at = |i: usize| {
            let (x, y) = ((column * tile + i % tile).min(SIZE.0 - 1), (i / tile).min(SIZE.1 - 1));
            values[y * SIZE.0 + x]
        };
        let part = encoded(&(0..tile * tile).map(at).collect::<Vec<u16>>(), tile, coding);
        offsets.push(DATA + data.len() as u32);
        lengths.push(part.len() as u32);
        data.extend(part);
    }
    let mut entries = mosaic(0);
    entries.retain(|(tag, ..)| !matches!(tag, 273 | 278 | 279));
    for entry in [
        (259, 3, vec![7]),
        (258, 3, vec![12]),
        (322, 3, vec![tile as u32]),
        (323, 3, vec![tile as u32]),
        (324, 4, offsets),
        (325, 4, lengths),
    ] {
        entries = with(entries, entry);
    }
    assert_eq!(read(&data, entries), Ok(values));
}

#[test]
fn floats_are_read_with_their_predictor() {
    let count = 3 * SIZE.0;
    // Halves that are whole numbers up to 1023 have the bits of `half`.
    let half = |v: u32| match v {
        0 => 0,
        v => (v.ilog2() + 15) << 10 | (v << (10 - v.ilog2()) & 1023),
    };
    let whole: Vec<u32> = (0..count * SIZE.1).map(|i| (1024.0 * uniform(2, i as u64, 0)) as u32).collect();
    let mut data = Vec::new();
    for row in whole.chunks_exact(count) {
        let planes: Vec<u8> = [8, 0].iter().flat_map(|s| row.iter().map(move |&v| (half(v) >> s) as u8)).collect();
        data.extend((0..planes.len()).map(|i| if i < 3 { planes[i] } else { planes[i].wrapping_sub(planes[i - 3]) }));
    }
    let data = deflated(&data);
    let mut entries = mosaic(data.len());
    entries.retain(|(tag, ..)| !matches!(tag, 33421 | 33422 | 50714 | 50717));
    for entry in [
        (258, 3, vec![16; 3]),
        (259, 3, vec![8]),
        (262, 3, vec![34892]),
        (277, 3, vec![3]),
        (317, 3, vec![3]),
        (339, 3, vec![3; 3]),
    ] {
        entries = with(entries, entry);
    }
    let (sensor, _) = dng::read(&file(&data, &[entries]), &Limits::default()).unwrap();
    let Values::Floats(found) = sensor.values else { panic!("integers") };
    assert_eq!(found.into_vec(), whole.iter().map(|&v| v as f32).collect::<Vec<f32>>());
}

#[test]
fn grey_stays_grey_and_levels_are_applied() {
    // A quarter of white everywhere, in all colours.
    let data: Vec<u8> = std::iter::repeat_n(1100u16, SIZE.0 * SIZE.1).flat_map(u16::to_le_bytes).collect();
    let entries = with(mosaic(data.len()), (50719, 4, vec![4, 6]));
    let entries = with(entries, (50720, 4, vec![30, 20]));
    let entries = with(entries, (50829, 4, vec![2, 4, 30, 44]));
    let developed = develop(&file(&data, &[entries]), &Limits::default()).unwrap();
    assert_eq!((developed.width, developed.height), (30, 20));
    // sRGB encodes 0.25 as 0.5371.
    let expected = (65535.0 * linear_to_srgb(0.25)).round();
    assert!(developed.samples.iter().all(|&v| (f64::from(v) - expected).abs() <= 1.0), "{:?}", &developed.samples[..3]);
    let primaries = developed.profile.unwrap().primaries.unwrap();
    assert!(primaries.is_close(&Primaries::SRGB, 0.002), "{primaries:?}");
}

#[test]
fn what_is_not_supported_is_named() {
    let data = [0u8; 2 * 44 * 30];
    for (entry, words) in [
        ((259, 3, vec![34892]), "lossy compression"),
        ((258, 3, vec![32]), "samples of 32 bits"),
        ((33422, 1, vec![0, 1, 2, 3]), "2x2 RGBC"),
        ((277, 3, vec![2]), "2 samples per pixel"),
        ((50714, 4, vec![4100]), "black and white levels"),
        ((50829, 4, vec![0, 0, 31, 44]), "list of tags is damaged"),
        ((273, 4, vec![2000]), "truncated"),
    ] {
        let reason = read(&data, with(mosaic(data.len()), entry)).unwrap_err();
        assert!(reason.contains(words), "{reason}");
    }
    let mut without = mosaic(data.len());
    without.retain(|(tag, ..)| *tag != 50721);
    assert!(read(&data, without).unwrap_err().contains("colour matrices"));
}

#[test]
fn damaged_files_are_errors_or_pictures() {
    let data: Vec<u8> = values().iter().flat_map(|v| v.to_le_bytes()).collect();
    let bytes = file(&data, &[with(mosaic(data.len()), (50829, 4, vec![0, 0, 30, 44]))]);
    for seed in 0..3000 {
        let mut damaged = bytes.clone();
        // Most of the damage is in the tags, which are behind the samples.
        let at = data.len() + (uniform(9, seed, 0) * (bytes.len() - data.len()) as f64) as usize;
        damaged[at] = (256.0 * uniform(9, seed, 1)) as u8;
        let limits = Limits { max_pixels: 100_000, ..Limits::default() };
        if let Ok(developed) = develop(&damaged, &limits) {
            assert_eq!(developed.samples.len(), 3 * developed.width * developed.height);
        }
        assert!(develop(&damaged[..at], &limits).is_err() || at + 4 > bytes.len(), "{at} bytes of {}", bytes.len());
    }
}

/// Compares the samples of rendered brackets with those that were rendered: `HDRALIGN_RAW_TRUTH` is a folder that
/// `truth_raw.py` of the measuring tools made.
#[test]
fn samples_are_those_of_the_rendered_brackets() {
    let Some(folder) = std::env::var_os("HDRALIGN_RAW_TRUTH") else { return };
    let mut count = 0;
    for case in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let npy = std::fs::read(case.join("mosaic.npy")).unwrap();
        let start = 10 + usize::from(u16::from_le_bytes([npy[8], npy[9]]));
        let truth: serde_json::Value =
            serde_json::from_slice(&std::fs::read(case.join("truth.json")).unwrap()).unwrap();
        let frames = truth["frames"].as_array().unwrap();
        let size = (npy.len() - start) / frames.len();
        for (frame, expected) in frames.iter().zip(npy[start..].chunks_exact(size)) {
            let path = case.join(frame["file"].as_str().unwrap());
            let (sensor, _) = dng::read(&std::fs::read(&path).unwrap(), &Limits::default()).unwrap();
            let Values::Integers(found) = sensor.values else { panic!("floats") };
            let found: Vec<u8> = found.as_slice().iter().flat_map(|v| v.to_le_bytes()).collect();
            assert!(found == expected, "{}", path.display());
            count += 1;
        }
    }
    assert!(count > 0, "there are no brackets in the folder");
}
