//! Applies the EXIF orientation.
//!
//! In: interleaved RGB and the EXIF orientation, 1 to 8. Out: the upright image. Cost: none for 1, else one copy.
//! Source: EXIF 2.32, tag 274, which gives the displayed side of row 0 and column 0 of the stored image.

use crate::bracket::{Pattern, Raw, Samples};
use rayon::prelude::*;

/// Rows that are turned at a time.
const BAND: usize = 16;
/// Columns and rows in which every pattern of colour filters repeats.
const PERIOD: usize = 6;

/// Returns the upright samples, their width and height. An invalid orientation counts as 1.
pub(super) fn apply(samples: Samples, width: usize, height: usize, orientation: u32) -> (Samples, usize, usize) {
    if !(2..=8).contains(&orientation) {
        return (samples, width, height);
    }
    let (seen_width, seen_height) = if orientation >= 5 { (height, width) } else { (width, height) };
    let turned = match samples {
        Samples::Eight(v) => Samples::Eight(turn(&v, width, height, orientation)),
        Samples::Sixteen(v) => Samples::Sixteen(turn(&v, width, height, orientation)),
    };
    (turned, seen_width, seen_height)
}

fn turn<T: Copy + Default + Send + Sync>(stored: &[T], width: usize, height: usize, orientation: u32) -> Vec<T> {
    let (pixels, _) = stored.as_chunks::<3>();
    let last = (width - 1, height - 1);
    let seen_width = if orientation >= 5 { height } else { width };
    let mut seen = vec![[T::default(); 3]; pixels.len()];
    seen.par_chunks_mut(BAND * seen_width).enumerate().for_each(|(band, rows)| {
        // Column by column: where a stored row is displayed as a column, a band of it is read at once.
        for x in 0..seen_width {
            for (y, row) in rows.chunks_exact_mut(seen_width).enumerate() {
                let (column, line) = stored_position((x, band * BAND + y), last, orientation);
                row[x] = pixels[line * width + column];
            }
        }
    });
    seen.into_flattened()
}

/// Returns the colour filters of the upright image. `size` is the width and height of the stored one.
pub(super) fn turned(raw: Raw, size: (usize, usize), orientation: u32) -> Raw {
    // The pattern repeats, so a picture that is larger by a multiple of its size has the same.
    let last = (size.0 - 1 + 2 * PERIOD, size.1 - 1 + 2 * PERIOD);
    let upright = |pattern: Pattern| pattern.seen(|x, y| stored_position((x, y), last, orientation));
    Raw { pattern: raw.pattern.map(upright), ..raw }
}

/// Returns column and row, as stored, of the pixel displayed at column and row (x, y). The last stored column and row
/// are `right` and `bottom`. An invalid orientation counts as 1.
pub(super) fn stored_position(
    (x, y): (usize, usize),
    (right, bottom): (usize, usize),
    orientation: u32,
) -> (usize, usize) {
    match orientation {
        2 => (right - x, y),
        3 => (right - x, bottom - y),
        4 => (x, bottom - y),
        5 => (y, x),
        6 => (y, bottom - x),
        7 => (right - y, bottom - x),
        8 => (right - y, x),
        _ => (x, y),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For each orientation, the side on which row 0 and column 0 of the stored image are displayed, in the words of
    /// EXIF 2.32.
    const STANDARD: [(u32, &str, &str); 8] = [
        (1, "top", "left"),
        (2, "top", "right"),
        (3, "bottom", "right"),
        (4, "bottom", "left"),
        (5, "left", "top"),
        (6, "right", "top"),
        (7, "right", "bottom"),
        (8, "left", "bottom"),
    ];

    #[test]
    fn each_orientation_is_the_standards() {
        // In the stored picture of 4 x 3 pixels, red is 1 in row 0, and green is 1 in column 0.
        let (width, height) = (4, 3);
        let stored: Vec<u8> = (0..height)
            .flat_map(|y| (0..width).flat_map(move |x| [u8::from(y == 0), u8::from(x == 0), (10 * y + x) as u8]))
            .collect();
        for (orientation, row_0, column_0) in STANDARD {
            let (seen, w, h) = apply(Samples::Eight(stored.clone()), width, height, orientation);
            let Samples::Eight(seen) = seen else { panic!("the depth is kept") };
            let on = |side: &str, x: usize, y: usize| match side {
                "top" => y == 0,
                "bottom" => y == h - 1,
                "left" => x == 0,
                _ => x == w - 1,
            };
            for (i, p) in seen.chunks_exact(3).enumerate() {
                let (x, y) = (i % w, i / w);
                assert_eq!(p[0] == 1, on(row_0, x, y), "row 0, orientation {orientation}");
                assert_eq!(p[1] == 1, on(column_0, x, y), "column 0, orientation {orientation}");
            }
            let mut all: Vec<u8> = seen.chunks_exact(3).map(|p| p[2]).collect();
            all.sort();
            assert_eq!(all, [0, 1, 2, 3, 10, 11, 12, 13, 20, 21, 22, 23], "each pixel once");
        }
    }

    #[test]
    fn invalid_orientation_is_upright() {
        let samples = Samples::Sixteen((0..18).collect());
        for orientation in [0, 9, 65535] {
            assert_eq!(apply(samples.clone(), 3, 2, orientation), (samples.clone(), 3, 2));
        }
    }

    #[test]
    fn colour_filters_are_those_of_the_turned_pixels() {
        let pattern = Pattern::bayer([1, 0, 2, 1]);
        for (width, height) in [(4, 6), (5, 6), (4, 7), (5, 7), (1, 1)] {
            // Each pixel has the number of its colour.
            let colours: Vec<u8> =
                (0..width * height).flat_map(|i| [pattern.at(i % width, i / width) as u8; 3]).collect();
            for orientation in 0..=8 {
                let (seen, w, h) = apply(Samples::Eight(colours.clone()), width, height, orientation);
                let Samples::Eight(seen) = seen else { panic!("the depth is kept") };
                let raw = Raw { pattern: Some(pattern.clone()), white: [1.0; 3] };
                let turned = turned(raw, (width, height), orientation).pattern.unwrap();
                for (i, pixel) in seen.chunks_exact(3).enumerate() {
                    assert_eq!(usize::from(pixel[0]), turned.at(i % w, i / w), "{width}x{height}, {orientation}");
                }
                assert_eq!(w * h, width * height);
            }
        }
    }
}
