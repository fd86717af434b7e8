//! Tests with TIFF files that are written entry by entry.

use super::*;
use tiff::decoder::{Decoder, DecodingResult};

/// Entries of a directory: the tag, its type (TIFF 6.0, section 2) and its values; a rational has two values.
pub(crate) type Entries = Vec<(u16, u16, Vec<u32>)>;

/// Offset of the data of a [`file`].
pub(crate) const DATA: u32 = 8;

/// Returns a little-endian TIFF: the header, `data`, then the `directories`, each linked from the previous directory.
pub(crate) fn file(data: &[u8], directories: &[Entries]) -> Vec<u8> {
    let mut bytes = [b"II*\0", &[0; 4][..], data].concat();
    let mut link = 4;
    for entries in directories {
        let values: Vec<Vec<u8>> = entries
            .iter()
            .map(|(_, kind, values)| match kind {
                1 | 2 => values.iter().map(|&v| v as u8).collect(),
                3 => values.iter().flat_map(|&v| (v as u16).to_le_bytes()).collect(),
                _ => values.iter().flat_map(|v| v.to_le_bytes()).collect(),
            })
            .collect();
        let mut fields = (entries.len() as u16).to_le_bytes().to_vec();
        for ((tag, kind, numbers), value) in entries.iter().zip(&values) {
            let count = (numbers.len() / if *kind == 5 { 2 } else { 1 }) as u32;
            fields.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
            fields.extend(count.to_le_bytes());
            let mut field = value.clone();
            if value.len() > 4 {
                field = (bytes.len() as u32).to_le_bytes().to_vec();
                bytes.extend(value);
            }
            field.resize(4, 0);
            fields.extend(field);
        }
        let at = bytes.len() as u32;
        bytes[link..link + 4].copy_from_slice(&at.to_le_bytes());
        bytes.extend(fields);
        link = bytes.len();
        bytes.extend([0; 4]);
    }
    bytes
}

/// Returns the entries of an uncompressed 8-bit RGB picture in one strip at `at`.
pub(crate) fn rgb(width: u32, height: u32, at: u32) -> Entries {
    vec![
        (254, 4, vec![0]),
        (256, 4, vec![width]),
        (257, 4, vec![height]),
        (258, 3, vec![8, 8, 8]),
        (259, 3, vec![1]),
        (262, 3, vec![2]),
        (273, 4, vec![at]),
        (277, 3, vec![3]),
        (278, 4, vec![height]),
        (279, 4, vec![3 * width * height]),
    ]
}

/// Returns `entries` with `entry` added or replaced.
pub(crate) fn with(mut entries: Entries, entry: (u16, u16, Vec<u32>)) -> Entries {
    entries.retain(|(tag, ..)| *tag != entry.0);
    entries.push(entry);
    entries.sort();
    entries
}

fn decoded(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    assert_eq!(as_grey(&mut bytes), Some(2));
    let mut decoder = Decoder::new(Cursor::new(bytes)).unwrap();
    match samples(&mut decoder, 3).unwrap() {
        DecodingResult::U8(v) => v,
        other => panic!("{other:?}"),
    }
}

/// The `tiff` crate's function for a whole picture panics on such a file.
#[test]
fn tiles_of_planes_that_reach_beyond_the_edges_are_cut() {
    let (width, height) = (19_usize, 21_usize);
    let value = |x: usize, y: usize, plane: usize| (100 * plane + 5 * x + y) as u8;
    let mut data = Vec::new();
    for plane in 0..3 {
        for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let tile = (0..256).map(|i| (16 * column + i % 16, 16 * row + i / 16));
            data.extend(tile.map(|(x, y)| if x < width && y < height { value(x, y, plane) } else { 255 }));
        }
    }
    let mut entries = rgb(width as u32, height as u32, 0);
    entries.retain(|(tag, ..)| !matches!(tag, 273 | 278 | 279));
    for entry in [
        (284, 3, vec![2]),
        (322, 3, vec![16]),
        (323, 3, vec![16]),
        (324, 4, (0..12).map(|i| DATA + 256 * i).collect()),
        (325, 4, vec![256; 12]),
    ] {
        entries = with(entries, entry);
    }
    let all = decoded(&file(&data, &[entries]));
    assert_eq!(all.len(), 3 * width * height);
    for (i, &v) in all.iter().enumerate() {
        assert_eq!(v, value(i / 3 % width, i / 3 / width, i % 3), "sample {i}");
    }
}

#[test]
fn bits_are_turned_round_by_fill_order_once_and_never_those_of_jpeg() {
    let picture: Vec<u8> = (0..3 * 5 * 4).map(|i| 4 * i + 1).collect();
    let turned: Vec<u8> = picture.iter().map(|b| b.reverse_bits()).collect();
    let two_rows = |entries| {
        let strips = (273, 4, vec![DATA, DATA + 30]);
        with(with(with(entries, strips), (278, 4, vec![2])), (279, 4, vec![30, 30]))
    };
    let lowest_first = with(two_rows(rgb(5, 4, DATA)), (266, 3, vec![2]));
    let mut bytes = file(&turned, std::slice::from_ref(&lowest_first));
    order_bits(&mut bytes);
    assert_eq!(decoded(&bytes), picture);
    // Both strips are at the same offset.
    let shared = with(lowest_first.clone(), (273, 4, vec![DATA, DATA]));
    let mut bytes = file(&turned, &[shared]);
    order_bits(&mut bytes);
    assert_eq!(decoded(&bytes), [&picture[..30], &picture[..30]].concat());
    for unturned in [two_rows(rgb(5, 4, DATA)), with(lowest_first, (259, 3, vec![7]))] {
        let bytes = file(&turned, &[unturned]);
        let mut same = bytes.clone();
        order_bits(&mut same);
        assert!(same == bytes);
    }
}

#[test]
fn first_picture_without_thumbnails_is_used_and_mosaics_are_raw() {
    let data: Vec<u8> = (0..60).collect();
    let thumbnail = || with(rgb(1, 1, DATA + 30), (254, 4, vec![1]));
    let which = |directories: &[Entries]| {
        let bytes = file(&data, directories);
        let picture = picture(Cursor::new(&bytes)).unwrap();
        (picture.index, picture.is_raw)
    };
    assert_eq!(which(&[rgb(5, 4, DATA)]), (0, false));
    assert_eq!(which(&[rgb(5, 4, DATA), thumbnail()]), (0, false));
    assert_eq!(which(&[thumbnail(), rgb(5, 4, DATA)]), (1, false));
    assert!(which(&[thumbnail()]).1 && which(&[thumbnail(), thumbnail()]).1);
    assert!(which(&[with(rgb(5, 4, DATA), (50706, 1, vec![1, 4, 0, 0]))]).1);
    let mosaic = || with(rgb(5, 4, DATA), (262, 3, vec![32803]));
    assert!(which(&[mosaic()]).1 && which(&[thumbnail(), mosaic()]).1);
    // The mosaic is in a subdirectory of the first directory, as in NEF files. For this, the second directory is
    // removed from the chain of directories, and the tag SubIFDs of the first directory points to it.
    let mut bytes = file(&data, &[with(thumbnail(), (330, 4, vec![0x5555_5555])), mosaic()]);
    let mut directories = Directories::of(Cursor::new(&bytes)).unwrap();
    let chain = directories.pictures();
    let (end, below) = (chain[0].at as usize + 2 + 12 * chain[0].entries.len(), chain[1].at as u32);
    bytes[end..end + 4].fill(0);
    let place = bytes.windows(4).position(|w| w == [0x55; 4]).unwrap();
    bytes[place..place + 4].copy_from_slice(&below.to_le_bytes());
    assert!(picture(Cursor::new(&bytes)).unwrap().is_raw);

    let mut bytes = file(&data, &[thumbnail(), rgb(5, 4, DATA)]);
    let second = picture(Cursor::new(&bytes)).unwrap();
    put_first(&mut bytes, second);
    assert_eq!(decoded(&bytes), data);
}

/// If the `tiff` crate saw such a text, it would print a line that contains a path of the machine on which it was
/// compiled.
#[test]
fn a_text_longer_than_any_file_is_refused_before_the_crate_sees_it() {
    let mut bytes = file(&[0; 60], &[with(rgb(5, 4, DATA), (271, 2, vec![65; 9]))]);
    let mut directories = Directories::of(Cursor::new(&bytes)).unwrap();
    let first = directories.pictures().remove(0);
    let place = first.entries.iter().position(|entry| entry.tag == 271).unwrap();
    let at = first.at as usize + 2 + 12 * place + 4;
    bytes[at..at + 4].copy_from_slice(&0x7FFF_FFFF_u32.to_le_bytes());
    assert!(picture(Cursor::new(&bytes)).unwrap_err().contains("a text of impossible length"));
    for cut in [0, 3, 8, bytes.len() - 5] {
        assert!(picture(Cursor::new(&bytes[..cut])).unwrap_err().contains("lists of tags are damaged"), "{cut}");
    }
}

/// If the photometric interpretation stayed RGB, the `tiff` crate would decode such files to wrong values, without an
/// error.
#[test]
fn extra_samples_are_left_out_with_a_predictor_or_without() {
    let picture: Vec<u8> = (0..5 * 5 * 4).map(|i| (i * i % 251) as u8).collect();
    let colours: Vec<u8> = picture.chunks_exact(5).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let row = |pixels: &[u8]| (0..25).map(|i| pixels[i].wrapping_sub(if i < 5 { 0 } else { pixels[i - 5] })).collect();
    let differences: Vec<u8> = picture.chunks_exact(25).flat_map(|pixels| -> Vec<u8> { row(pixels) }).collect();
    let five = with(with(rgb(5, 4, DATA), (277, 3, vec![5])), (258, 3, vec![8; 5]));
    let five = with(with(five, (338, 3, vec![0, 0])), (279, 4, vec![100]));
    assert_eq!(decoded(&file(&picture, std::slice::from_ref(&five))), colours);
    assert_eq!(decoded(&file(&differences, &[with(five, (317, 3, vec![2]))])), colours);
}
