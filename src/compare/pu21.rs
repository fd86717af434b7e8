//! PU21: encodes luminance so that just noticeable differences have equal size; and the PSNR of encoded values.
//!
//! In: two pictures in linear light and their scale in cd/m2. Out: dB. Cost: a table of 5363 entries, 20 ns per pixel.
//! Source: Mantiuk & Azimi 2021, "PU21: A novel perceptually uniform encoding for adapting existing quality metrics for
//! HDR", table I (banding and glare). The peak of the PSNR is the encoded value of 10,000 cd/m2, 595.39, as in the
//! authors' ColorVideoVDP.
//!
//! The encoding is tabulated in 256 steps per octave, with linear interpolation. Encoded values range to 595; their
//! error is below 1e-3.

use crate::plane::{Plane, fold_bands};

/// p1 to p7 of the paper's equation 1.
const P: [f64; 7] =
    [0.353487901, 0.3734658629, 8.277049286e-05, 0.9062562627, 0.09150303166, 0.9099517204, 596.3148142];
/// Lower end of the range of the encoding, in cd/m2.
const LEAST: f64 = 0.005;
/// Upper end of the range of the encoding, in cd/m2.
const MOST: f64 = 10_000.0;
/// log2 of the number of steps per octave.
const FINE: u32 = 8;
/// Number of low bits of an `f64` that do not select a step of the table.
const BELOW: u32 = f64::MANTISSA_DIGITS - 1 - FINE;

/// A picture in linear light.
pub(super) struct Light<'a> {
    pub pixels: &'a Plane<[f32; 3]>,
    /// Luminance of the pixel value 1, in cd/m2.
    pub scale: f32,
    /// Weights of red, green and blue in luminance.
    pub weights: [f32; 3],
}

impl Light<'_> {
    pub fn size(&self) -> (usize, usize) {
        (self.pixels.width(), self.pixels.height())
    }

    /// Returns the luminance encoded by PU21.
    pub fn luminance(&self) -> Plane<f32> {
        let table = Table::new();
        let [r, g, b] = self.weights;
        Plane::from_rows(self.pixels.width(), self.pixels.height(), |y, row| {
            for (v, p) in row.iter_mut().zip(self.pixels.row(y)) {
                *v = table.code(f64::from((r * p[0] + g * p[1] + b * p[2]) * self.scale)) as f32;
            }
        })
    }
}

/// Returns the PSNR in dB over red, green and blue, each encoded separately; `None` if the pictures are the same.
pub(super) fn psnr(a: &Light, b: &Light) -> Option<f64> {
    let table = Table::new();
    let band = |rows: std::ops::Range<usize>| {
        let pairs = a.pixels.rows(rows.clone()).iter().zip(b.pixels.rows(rows));
        pairs
            .map(|(p, q)| {
                // Computed in `f64`, so that different `f32` values have different encoded values.
                let code = |v: f32, light: &Light| table.code(f64::from(v) * f64::from(light.scale));
                let off = |c: usize| code(p[c], a) - code(q[c], b);
                [0, 1, 2].map(off).iter().map(|d| d * d).sum::<f64>()
            })
            .sum::<f64>()
    };
    let squares = fold_bands(a.pixels.height(), band, 0.0, |sum, more| sum + more);
    let mean = squares / (3 * a.pixels.as_slice().len()) as f64;
    (mean > 0.0).then(|| 20.0 * libm::log10(code(MOST) / mean.sqrt()))
}

/// Returns the encoded value of a luminance in cd/m2, by equation 1 of the paper.
fn code(luminance: f64) -> f64 {
    let power = libm::pow(luminance, P[3]);
    P[6] * (libm::pow((P[0] + P[1] * power) / (1.0 + P[2] * power), P[4]) - P[5])
}

/// A table of encoded values, for all luminances whose `f64` has 0 in the [`BELOW`] lowest bits.
struct Table(Vec<f64>);

impl Table {
    fn new() -> Table {
        let last = MOST.to_bits() >> BELOW;
        // One more entry, because MOST is between entry `last` and the next one.
        Table((Table::first()..=last + 1).map(|i| code(f64::from_bits(i << BELOW))).collect())
    }

    fn first() -> u64 {
        LEAST.to_bits() >> BELOW
    }

    /// Returns the encoded value of a luminance clamped to the range of the encoding; NaN counts as [`LEAST`].
    fn code(&self, luminance: f64) -> f64 {
        // A comparison with NaN is false, so NaN becomes LEAST.
        let luminance = if luminance > LEAST { luminance.min(MOST) } else { LEAST };
        let bits = luminance.to_bits();
        let line = (bits >> BELOW) - Table::first();
        let between = (bits & ((1 << BELOW) - 1)) as f64 / (1u64 << BELOW) as f64;
        let (low, high) = (self.0[line as usize], self.0[line as usize + 1]);
        low + (high - low) * between
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_formula_has_the_papers_range_and_the_table_has_the_formula() {
        // In the paper, 100 cd/m2 is encoded as about 256, and encoded values range to 595.39.
        assert!((code(1e4) - 595.39).abs() < 0.01 && code(0.005).abs() < 0.01 && (code(100.0) - 256.0).abs() < 1.0);
        let table = Table::new();
        let mut worst = 0.0f64;
        for i in 0..20_000 {
            let luminance = libm::exp2(-7.6 + 20.9 * f64::from(i) / 2e4);
            worst = worst.max((table.code(luminance) - code(luminance.clamp(LEAST, MOST))).abs());
        }
        // Linear interpolation between steps of 1/256 octave has an error of about 1e-4.
        assert!(worst < 1e-3, "{worst}");
        assert_eq!([f64::NAN, -1.0, 0.0].map(|v| table.code(v)), [table.code(LEAST); 3]);
        assert_eq!(table.code(f64::INFINITY), table.code(MOST));
    }

    #[test]
    fn the_psnr_is_that_of_the_encoded_difference() {
        let flat = |v: f32| Plane::filled(70, 70, [v; 3]);
        let (a, b) = (flat(0.5), flat(0.6));
        let light = |pixels| Light { pixels, scale: 200.0, weights: [0.2126, 0.7152, 0.0722] };
        let expected = 20.0 * libm::log10(code(1e4) / (code(120.0) - code(100.0)));
        // Each encoded value has an error below 1e-3, and the two values differ by 11. So the error of the PSNR is at
        // most 20 log10(1 + 2e-3 / 11) < 2e-3 dB.
        assert!((psnr(&light(&a), &light(&b)).unwrap() - expected).abs() < 2e-3);
        assert_eq!(psnr(&light(&a), &light(&a)), None);
        let next = flat(0.5f32.next_up());
        assert!(psnr(&light(&a), &light(&next)).is_some_and(|db| db > 120.0), "a float and the next differ");
    }
}
