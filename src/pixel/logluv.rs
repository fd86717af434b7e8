//! LogLuv pixels: the logarithm of luminance and a CIE 1976 (u', v') chromaticity in 24 or 32 bits, and the run-length
//! coding of 32-bit pixels.
//!
//! In: XYZ with grey at X = Y = Z, or the bytes of a row. Out: the other of the two. Cost: 40 ns a pixel for the
//! logarithm of the encoder; the decoder computes a power of 2 instead. Source: G. Ward Larson, "The LogLuv Encoding
//! for Full Gamut, High Dynamic Range Images", JGT 3(1), 1998; libtiff's `tif_luv.c` and `uvcode.h` for details that
//! the paper leaves open: truncation, byte order, and the squares of the 24-bit index. Unlike in libtiff nothing is
//! dithered, so that the bytes are reproducible.

use std::sync::LazyLock;

/// Side of the square in (u', v') that one index of the 24-bit format represents.
const SQUARE: f64 = 0.0035f32 as f64;
/// Lowest v' of the squares.
const V_START: f64 = 0.01694f32 as f64;
/// (u', v') of the equal-energy white.
const NEUTRAL: [f64; 2] = [0.210526316, 0.473684211];
/// Steps per unit of u' and v' in the 32-bit format.
const UV_SCALE: f64 = 410.0;

/// Rows of squares by increasing v': start of u' in millionths, number of squares, and number of consecutive rows with
/// these values.
#[rustfmt::skip]
const ROWS: [(u32, u16, u16); 82] = [
    (247663, 4, 1), (243779, 6, 1), (241684, 7, 1), (237874, 9, 1), (235906, 10, 1), (232153, 12, 1), (228352, 14, 1),
    (226259, 15, 1), (222371, 17, 1), (220410, 18, 1), (214710, 21, 1), (212714, 22, 1), (210721, 23, 1),
    (204976, 26, 1), (202986, 27, 1), (199245, 29, 1), (195525, 31, 1), (193560, 32, 1), (189878, 34, 1),
    (186216, 36, 2), (182592, 38, 1), (179003, 40, 1), (175466, 42, 1), (172001, 44, 2), (168612, 46, 2),
    (163575, 49, 1), (158642, 52, 3), (153815, 55, 2), (149097, 58, 2), (142746, 62, 3), (138270, 65, 3),
    (132166, 69, 2), (126204, 73, 3), (120381, 77, 4), (112962, 82, 3), (107450, 86, 4), (100343, 91, 3),
    (95126, 95, 4), (88276, 100, 4), (81523, 105, 4), (74861, 110, 4), (68290, 115, 4), (63573, 119, 4),
    (57219, 124, 4), (50985, 129, 5), (44859, 134, 4), (40571, 138, 4), (36339, 142, 4), (32139, 146, 4),
    (27947, 150, 3), (23739, 154, 4), (19504, 158, 3), (16976, 161, 4), (12639, 165, 3), (9991, 168, 3),
    (9016, 170, 3), (6217, 173, 2), (5097, 175, 3), (3909, 177, 2), (2340, 177, 1), (2389, 170, 1), (1068, 164, 1),
    (1653, 157, 1), (717, 150, 1), (1614, 143, 1), (270, 136, 1), (484, 129, 1), (1103, 123, 1), (1242, 115, 1),
    (1188, 109, 1), (1011, 103, 1), (709, 97, 1), (301, 89, 1), (2416, 82, 1), (3251, 76, 1), (3246, 69, 1),
    (4141, 62, 1), (5963, 55, 1), (8839, 47, 1), (10490, 40, 1), (16994, 31, 1), (23659, 21, 1),
];

/// For each row: start of u', number of squares, and total number of squares in the rows of lower v'.
static SQUARES: LazyLock<Vec<(f64, usize, usize)>> = LazyLock::new(|| {
    let rows =
        ROWS.iter().flat_map(|&(start, count, rows)| std::iter::repeat_n((start, usize::from(count)), rows.into()));
    let mut below = 0;
    rows.map(|(start, count)| {
        let row = (f64::from((f64::from(start) * 1e-6) as f32), count, below);
        below += count;
        row
    })
    .collect()
});

/// Returns the index of the square that contains (u', v'); `None` where there is no square.
fn square([u, v]: [f64; 2]) -> Option<usize> {
    let row = (v - V_START) / SQUARE;
    if row < 0.0 {
        return None;
    }
    let &(start, count, below) = SQUARES.get(row as usize)?;
    let column = (u - start) / SQUARE;
    (column >= 0.0 && (column as usize) < count).then(|| below + column as usize)
}

/// Returns the index for any chromaticity; a chromaticity outside all squares is moved towards neutral until it is
/// inside a square.
fn index(uv: [f64; 2]) -> usize {
    if let Some(index) = square(uv) {
        return index;
    }
    let at = |keep: f64| [0, 1].map(|i| NEUTRAL[i] + keep * (uv[i] - NEUTRAL[i]));
    // Bisection to the precision of a float.
    let (mut inside, mut outside) = (0.0, 1.0);
    for _ in 0..24 {
        let middle = 0.5 * (inside + outside);
        *(if square(at(middle)).is_some() { &mut inside } else { &mut outside }) = middle;
    }
    square(at(inside)).unwrap_or(0)
}

/// Returns the centre of a square; neutral for an invalid index.
fn middle(index: usize) -> [f64; 2] {
    let row = SQUARES.partition_point(|&(_, _, below)| below <= index).saturating_sub(1);
    let (start, count, below) = SQUARES[row];
    if index >= below + count {
        return NEUTRAL;
    }
    [start + ((index - below) as f64 + 0.5) * SQUARE, V_START + (row as f64 + 0.5) * SQUARE]
}

/// Returns (u', v') of XYZ; neutral when there is no light.
fn uv([x, y, z]: [f64; 3]) -> [f64; 2] {
    let sum = x + 15.0 * y + 3.0 * z;
    if sum > 0.0 { [4.0 * x / sum, 9.0 * y / sum] } else { NEUTRAL }
}

/// Returns XYZ of a luminance and a chromaticity; black for luminances of 0 or below.
fn xyz(luminance: f64, [u, v]: [f64; 2]) -> [f32; 3] {
    let s = 6.0 * u - 16.0 * v + 12.0;
    let (x, y) = (9.0 * u / s, 4.0 * v / s);
    if luminance <= 0.0 || y <= 0.0 || !s.is_normal() {
        return [0.0; 3];
    }
    [x / y * luminance, luminance, (1.0 - x - y) / y * luminance].map(|v| v as f32)
}

/// Bits per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// Luminance from 0.00025 to 15.7 in steps of 1.1 %; chromaticity in steps just below the visible threshold.
    Bits24,
    /// Luminance from 5e-20 to 1.8e19 in steps of 0.27 %; chromaticity in steps of 1/410 of u' and v'.
    Bits32,
}

impl Depth {
    /// Smallest and largest luminance of the encoding.
    pub(crate) fn range(self) -> (f32, f32) {
        let (low, high) = match self {
            Depth::Bits24 => RANGE24,
            Depth::Bits32 => RANGE32,
        };
        (low as f32, high as f32)
    }
}

/// Range of luminance of the 24-bit format. Luminances below this range have code 0, black.
const RANGE24: (f64, f64) = (0.0002468, 15.742);
/// Range of luminance of the 32-bit format.
const RANGE32: (f64, f64) = (5.436e-20, 1.8371976e19);

/// Returns the code of a luminance: 0 below `range`, `largest` above it, and otherwise the number of steps from
/// luminance 2^-`octaves` to this luminance, with `steps` per octave.
fn logarithm(luminance: f64, range: (f64, f64), largest: u32, steps: f64, octaves: f64) -> u32 {
    match luminance {
        y if y >= range.1 => largest,
        y if y > range.0 => (steps * (libm::log2(y) + octaves)) as u32,
        _ => 0,
    }
}

/// Encodes XYZ as 10 bits of luminance and 14 of chromaticity.
pub(crate) fn encode24(c: [f32; 3]) -> u32 {
    let c = c.map(f64::from);
    let le = logarithm(c[1], RANGE24, 0x3ff, 64.0, 12.0);
    let ce = index(if le == 0 { NEUTRAL } else { uv(c) });
    le << 14 | ce as u32
}

/// Returns the centre of the XYZ values that [`encode24`] encodes as `code`; black for luminance 0.
pub(crate) fn decode24(code: u32) -> [f32; 3] {
    match code >> 14 & 0x3ff {
        0 => [0.0; 3],
        le => xyz(libm::exp2((f64::from(le) + 0.5) / 64.0 - 12.0), middle((code & 0x3fff) as usize)),
    }
}

/// Encodes XYZ as a sign, 15 bits of luminance, 8 of u' and 8 of v'.
pub(crate) fn encode32(c: [f32; 3]) -> u32 {
    let c = c.map(f64::from);
    let le = logarithm(c[1], RANGE32, 0x7fff, 256.0, 64.0);
    let [ue, ve] = (if le == 0 { NEUTRAL } else { uv(c) }).map(|v| ((UV_SCALE * v) as u32).min(255));
    le << 16 | ue << 8 | ve
}

/// Returns the centre of the XYZ values that [`encode32`] encodes as `code`; black for luminances of 0 and below.
pub(crate) fn decode32(code: u32) -> [f32; 3] {
    let uv = [code >> 8 & 0xff, code & 0xff].map(|v| (f64::from(v) + 0.5) / UV_SCALE);
    xyz(luminance16(code >> 16), uv)
}

/// Returns the luminance of a sign and 15 bits of logarithm, as in a grey LogL pixel; 0 for code 0 and for negative
/// codes.
pub(crate) fn luminance16(le: u32) -> f64 {
    if le == 0 || le & 0x8000 != 0 { 0.0 } else { libm::exp2((f64::from(le) + 0.5) / 256.0 - 64.0) }
}

/// Minimum number of equal bytes that are encoded as a run.
const MIN_RUN: usize = 4;

/// Appends a row of 32-bit pixels: the first bytes of all pixels, then the second and so on, each run-length encoded. A
/// run of n = 2..=129 equal bytes is stored as the count 126 + n and the byte. Up to m = 127 other bytes are stored as
/// the count m and the bytes.
pub(crate) fn put_row(row: &[u32], out: &mut Vec<u8>) {
    let mut plane = vec![0; row.len()];
    for shift in [24, 16, 8, 0] {
        for (to, from) in plane.iter_mut().zip(row) {
            *to = (from >> shift) as u8;
        }
        put_runs(&plane, out);
    }
}

fn put_runs(bytes: &[u8], out: &mut Vec<u8>) {
    let run_at = |at: usize| {
        let most = 129.min(bytes.len() - at);
        bytes[at..at + most].iter().take_while(|&&b| b == bytes[at]).count()
    };
    let mut at = 0;
    while at < bytes.len() {
        let (mut start, mut run) = (at, 0);
        while start < bytes.len() {
            run = run_at(start);
            if run >= MIN_RUN {
                break;
            }
            start += run;
            run = 0;
        }
        for part in bytes[at..start].chunks(127) {
            out.push(part.len() as u8);
            out.extend_from_slice(part);
        }
        if run > 0 {
            out.extend_from_slice(&[(126 + run) as u8, bytes[start]]);
        }
        at = start + run;
    }
}

/// Decodes the next row from the front of `bytes`: pixels of four bytes, or of two when `planes` is 2 (grey). `None`
/// when the row is damaged or truncated.
pub(crate) fn take_row(bytes: &mut &[u8], row: &mut [u32], planes: u32) -> Option<()> {
    row.fill(0);
    for shift in (0..planes).rev().map(|p| 8 * p) {
        let mut at = 0;
        while at < row.len() {
            let (&code, rest) = bytes.split_first()?;
            *bytes = rest;
            let n = usize::from(if code >= 128 { code - 126 } else { code });
            // A run beyond the end of the row is truncated, as by libtiff.
            let to = row.len().min(at + n);
            let (from, rest) = bytes.split_at_checked(if code >= 128 { 1 } else { to - at })?;
            for (i, pixel) in row[at..to].iter_mut().enumerate() {
                *pixel |= u32::from(if code >= 128 { from[0] } else { from[i] }) << shift;
            }
            *bytes = rest;
            at = to;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn colours() -> impl Iterator<Item = [f32; 3]> {
        (0..40_000u32).map(|i| {
            let part = |k: u32| f32::from((i.wrapping_mul(k) >> 12) as u16 % 1000) / 1000.0 + 0.05;
            let scale = libm::exp2f((i % 150) as f32 / 10.0 - 11.0);
            [scale * part(2_654_435_761), scale * part(40_503_331), scale * part(97_777_777)]
        })
    }

    /// A step of luminance is 1/64 octave or 1.09 %, so the decoded centre is within 0.55 %. The centre of a square is
    /// within half a side, 0.00175, of every point in it, and real chromaticities lie in the squares.
    #[test]
    fn codes_of_24_bits_are_within_half_a_step() {
        assert_eq!(SQUARES.last().map(|&(_, count, below)| (SQUARES.len(), count + below)), Some((163, 16_289)));
        let mut inside = 0;
        for c in colours().filter(|c| f64::from(c[1]) > RANGE24.0 && f64::from(c[1]) < RANGE24.1) {
            let back = decode24(encode24(c)).map(f64::from);
            let c = c.map(f64::from);
            assert!((back[1] / c[1] - 1.0).abs() < 0.0056, "{c:?} {back:?}");
            if square(uv(c)).is_some() {
                inside += 1;
                let (a, b) = (uv(c), uv(back));
                assert!((0..2).all(|i| (a[i] - b[i]).abs() < 0.0017501), "{c:?} {back:?}");
            }
        }
        assert!(inside > 10_000, "{inside}");
        assert_eq!((decode24(0), decode24(encode24([0.0; 3])), encode24([20.0; 3]) >> 14), ([0.0; 3], [0.0; 3], 0x3ff));
        for index in 0..16_289 {
            assert_eq!(square(middle(index)), Some(index));
        }
        assert_eq!((middle(16_289), square([0.7, 0.1])), (NEUTRAL, None));
        assert!(index([0.7, 0.1]) < 16_289 && index([-3.0, 9.0]) < 16_289);
    }

    /// A step of luminance is 1/256 octave or 0.27 %, so the decoded centre is within 0.136 %. A step of u' and v' is
    /// 1/410, so the centre is within 0.00122.
    #[test]
    fn codes_of_32_bits_are_within_half_a_step() {
        for c in colours() {
            let back = decode32(encode32(c)).map(f64::from);
            let c = c.map(f64::from);
            assert!((back[1] / c[1] - 1.0).abs() < 0.00136);
            // Code 255 also stands for larger u', which no light has.
            let (a, b) = (uv(c), uv(back));
            assert!((0..2).all(|i| (a[i] - b[i]).abs() < 0.00123 || a[i] > 0.62), "{a:?} {b:?}");
        }
        // XYZ (1, 1, 1) as libtiff encodes it: luminance 2^0 as 64 * 256 = 16,384, u' as 0.2105 * 410 = 86, and v' as
        // 0.4737 * 410 = 194.
        assert_eq!(encode32([1.0; 3]), 16_384 << 16 | 86 << 8 | 194);
        assert_eq!([decode32(0), decode32(0xffff_0000), decode32(encode32([0.0; 3]))], [[0.0; 3]; 3]);
        assert_eq!(encode32([f32::MAX; 3]) >> 16, 0x7fff);
    }

    #[test]
    fn rows_of_every_make_come_back() {
        for width in [1usize, 3, 4, 126, 127, 128, 129, 130, 500] {
            for kind in 0..4u32 {
                let pixel = |x: u32| match kind {
                    0 => 0x0102_0304,
                    1 => x.wrapping_mul(2_654_435_761),
                    2 => x / 3,
                    _ => ((x / 130) << 8) | (x / 4),
                };
                let row: Vec<u32> = (0..width as u32).map(pixel).collect();
                let mut bytes = Vec::new();
                put_row(&row, &mut bytes);
                let (mut rest, mut back) = (&bytes[..], vec![9; width]);
                take_row(&mut rest, &mut back, 4).expect("a whole row");
                assert!(rest.is_empty() && back == row, "width {width}, kind {kind}");
                assert_eq!(take_row(&mut &bytes[..bytes.len() - 1], &mut back, 4), None);
            }
        }
        let mut out = Vec::new();
        put_runs(&[7; 130], &mut out);
        assert_eq!(out, [255, 7, 1, 7]);
    }
}
