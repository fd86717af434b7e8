//! Grey values for the alignment, row by row.
//!
//! In: a row of interleaved RGB pixel values, of 8 or 16 bits. Out: (54 R + 183 G + 19 B) / 256 (Ward 2003, section 2),
//! as 8 bits. Cost: reading the pixel values.

use super::{Codes, Window};
use crate::simd::{Loops, vectorised};

impl Window<'_> {
    /// Writes row `y` of the frame's [`grey`](super::Frame::grey) to `out`, or of
    /// [`grey_brightened`](super::Frame::grey_brightened) where `stops` is given.
    ///
    /// # Panics
    /// If this window (a range of rows of the frame) does not contain row `y`, or the length of `out` is not the width
    /// of the frame.
    pub fn grey_row(&self, y: usize, stops: Option<u32>, out: &mut [u8]) {
        assert_eq!(out.len(), self.width(), "`out` must have one element for each pixel in a row of the frame");
        let first = 3 * self.width() * (y - self.rows().start);
        let row = first..first + 3 * self.width();
        match self.codes() {
            Codes::Eight(v) => vectorised(GreyOfEight { rgb: &v[row], stops, grey: out }),
            Codes::Sixteen(v) => vectorised(GreyOfSixteen { rgb: &v[row], stops, grey: out }),
        }
    }
}

/// A row of 8-bit pixel values and its output. All sums fit 16 bits, since the weights add up to 256.
struct GreyOfEight<'a> {
    rgb: &'a [u8],
    stops: Option<u32>,
    grey: &'a mut [u8],
}

impl Loops for GreyOfEight<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let sum = |p: &[u8; 3]| 54 * u16::from(p[0]) + 183 * u16::from(p[1]) + 19 * u16::from(p[2]);
        let pixels = self.grey.iter_mut().zip(self.rgb.as_chunks::<3>().0);
        match self.stops {
            None => pixels.for_each(|(out, p)| *out = (sum(p) >> 8) as u8),
            Some(stops) => {
                let shift = 8 - stops.min(8);
                pixels.for_each(|(out, p)| *out = (sum(p) >> shift).min(255) as u8);
            }
        }
    }
}

/// A row of 16-bit pixel values and its output.
struct GreyOfSixteen<'a> {
    rgb: &'a [u16],
    stops: Option<u32>,
    grey: &'a mut [u8],
}

impl Loops for GreyOfSixteen<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let pixels = self.grey.iter_mut().zip(self.rgb.as_chunks::<3>().0);
        match self.stops {
            None => pixels
                .for_each(|(out, p)| *out = ((54 * (p[0] >> 8) + 183 * (p[1] >> 8) + 19 * (p[2] >> 8)) >> 8) as u8),
            Some(stops) => {
                let shift = 16 - stops.min(8);
                pixels.for_each(|(out, p)| {
                    let sum = 54 * u32::from(p[0]) + 183 * u32::from(p[1]) + 19 * u32::from(p[2]);
                    *out = (sum >> shift).min(255) as u8;
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::exposure::Exposure;
    use crate::bracket::{Frame, Samples};

    #[test]
    fn grey_is_wards_at_either_depth() {
        let of =
            |samples| Frame::new("a".into(), 1, 1, samples, Exposure::given(0.0).unwrap()).grey().unwrap().at(0, 0);
        assert_eq!(of(Samples::Eight(vec![10, 200, 30])), ((54 * 10 + 183 * 200 + 19 * 30) >> 8) as u8);
        assert_eq!(of(Samples::Sixteen(vec![0x0AFF, 0xC800, 0x1E10])), of(Samples::Eight(vec![10, 200, 30])));
        assert_eq!(of(Samples::Eight(vec![255; 3])), 255);
    }

    #[test]
    fn brightened_grey_keeps_fractions_of_codes() {
        let of = |samples| Frame::new("a".into(), 1, 1, samples, Exposure::given(0.0).unwrap());
        // Without brightening, (54 * 1 + 183 * 2) / 256 = 1.64 is rounded down to 1. With 6 stops, 64 * 1.64 = 105.
        let dark = of(Samples::Eight(vec![1, 2, 0]));
        assert_eq!([0, 6, 8].map(|stops| dark.grey_brightened(stops).unwrap().at(0, 0)), [1, 105, 255]);
        // 164 is 0.64 of an 8-bit pixel value; with 6 stops, 64 * 0.64 = 41.
        let deep = of(Samples::Sixteen(vec![164, 164, 164]));
        assert_eq!([0, 6].map(|stops| deep.grey_brightened(stops).unwrap().at(0, 0)), [0, 41]);
        let plain = of(Samples::Eight(vec![10, 200, 30]));
        assert_eq!(plain.grey_brightened(0).unwrap(), plain.grey().unwrap());
    }

    #[test]
    fn rows_of_grey_are_the_definition_pixel_by_pixel() {
        // Each row is longer than any SIMD vector, and its length is not a multiple of the length of a SIMD vector.
        let (width, height) = (203, 3);
        let codes: Vec<u16> = (0..3 * width * height).map(|i| (i * 40_503 % 65_536) as u16).collect();
        let eight = Samples::Eight(codes.iter().map(|c| (c >> 8) as u8).collect());
        for samples in [eight, Samples::Sixteen(codes)] {
            let frame = Frame::new("a".into(), width, height, samples, Exposure::given(0.0).unwrap());
            let whole = frame.whole().unwrap();
            let sixteen = |i: usize| match whole.codes() {
                Codes::Eight(v) => u32::from(v[i]) << 8,
                Codes::Sixteen(v) => u32::from(v[i]),
            };
            let sum = |i: usize, bits: u32| {
                54 * (sixteen(3 * i) >> bits) + 183 * (sixteen(3 * i + 1) >> bits) + 19 * (sixteen(3 * i + 2) >> bits)
            };
            let slow = |stops: Option<u32>, i: usize| match stops {
                None => sum(i, 8) >> 8,
                Some(stops) => (sum(i, 0) >> (16 - stops)).min(255),
            };
            let mut row = vec![0; width];
            for stops in [None, Some(0), Some(2), Some(6), Some(8)] {
                for y in 0..height {
                    whole.grey_row(y, stops, &mut row);
                    assert!((0..width).all(|x| u32::from(row[x]) == slow(stops, y * width + x)), "{stops:?}");
                }
            }
        }
    }
}
