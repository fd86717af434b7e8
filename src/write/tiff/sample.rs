//! Samples of a TIFF, and the predictor that makes rows compressible.
//!
//! In: a row of pixels. Out: its bytes, as differences from the pixel on the left. Cost: see [`super`]. Source: TIFF
//! 6.0, section 14; Adobe Photoshop TIFF Technical Note 3 (floating-point predictor).

/// A sample that TIFF supports: `u8` or `u16` (display- or camera-encoded) or `f32` (linear).
pub trait Sample: Copy + Send + Sync + 'static {
    /// Its size in bits.
    const BITS: u16;
    /// The TIFF sample format: 1 for unsigned integers, 3 for floats.
    const FORMAT: u16;
    /// The TIFF predictor: 2 for integer differences, 3 for the floating-point predictor.
    const PREDICTOR: u16;

    /// Appends the bytes of `row` as differences from the pixel on the left: little-endian for integers, byte by byte
    /// for floats.
    fn put_predicted<const N: usize>(row: &[[Self; N]], out: &mut Vec<u8>);
}

impl Sample for u8 {
    const BITS: u16 = 8;
    const FORMAT: u16 = 1;
    const PREDICTOR: u16 = 2;

    fn put_predicted<const N: usize>(row: &[[u8; N]], out: &mut Vec<u8>) {
        let mut left = [0u8; N];
        for p in row {
            out.extend((0..N).map(|c| p[c].wrapping_sub(left[c])));
            left = *p;
        }
    }
}

impl Sample for u16 {
    const BITS: u16 = 16;
    const FORMAT: u16 = 1;
    const PREDICTOR: u16 = 2;

    fn put_predicted<const N: usize>(row: &[[u16; N]], out: &mut Vec<u8>) {
        let mut left = [0u16; N];
        for p in row {
            for c in 0..N {
                out.extend_from_slice(&p[c].wrapping_sub(left[c]).to_le_bytes());
            }
            left = *p;
        }
    }
}

impl Sample for f32 {
    const BITS: u16 = 32;
    const FORMAT: u16 = 3;
    const PREDICTOR: u16 = 3;

    fn put_predicted<const N: usize>(row: &[[f32; N]], out: &mut Vec<u8>) {
        put_bytes(row, |v| v.to_be_bytes(), out);
    }
}

/// The bits of a half float.
#[derive(Debug, Clone, Copy)]
pub struct Half(pub(crate) u16);

impl Sample for Half {
    const BITS: u16 = 16;
    const FORMAT: u16 = 3;
    const PREDICTOR: u16 = 3;

    fn put_predicted<const N: usize>(row: &[[Half; N]], out: &mut Vec<u8>) {
        put_bytes(row, |v| v.0.to_be_bytes(), out);
    }
}

/// Appends the highest bytes of all samples of the row, then all second bytes, and so on. Each byte is stored as its
/// difference from the byte one pixel before.
fn put_bytes<T: Copy, const N: usize, const B: usize>(row: &[[T; N]], bytes: impl Fn(T) -> [u8; B], out: &mut Vec<u8>) {
    let samples = row.as_flattened();
    let start = out.len();
    for byte in 0..B {
        out.extend(samples.iter().map(|&v| bytes(v)[byte]));
    }
    let bytes = &mut out[start..];
    for i in (N..bytes.len()).rev() {
        bytes[i] = bytes[i].wrapping_sub(bytes[i - N]);
    }
}
