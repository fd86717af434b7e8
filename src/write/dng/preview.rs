//! The preview of a DNG: a small sRGB picture.
//!
//! In: radiance by rows. Out: a JPEG. Cost: three additions for each pixel.

use crate::bracket::colour::{Primaries, linear_to_srgb};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use nalgebra::Vector3;
use std::io;

/// The longer side is at most this, in pixels.
const LONGEST: usize = 1024;
const QUALITY: u8 = 85;

/// Sums of the radiance over squares of pixels.
#[derive(Debug)]
pub(super) struct Preview {
    width: usize,
    /// Side of a square, in pixels.
    side: usize,
    size: (usize, usize),
    sums: Vec<[f32; 3]>,
    /// Number of rows seen.
    rows: usize,
}

impl Preview {
    /// Starts the preview of a picture of `size` pixels.
    pub(super) fn new((width, height): (usize, usize)) -> Self {
        let side = width.max(height).div_ceil(LONGEST);
        // Squares that do not fit are left out; a narrow picture has at least one.
        let size = ((width / side).max(1), (height / side).max(1));
        Preview { width, side, size, sums: vec![[0.0; 3]; size.0 * size.1], rows: 0 }
    }

    /// Width and height of the preview, in pixels.
    pub(super) fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Adds complete rows.
    pub(super) fn see(&mut self, pixels: &[[f32; 3]]) {
        for row in pixels.chunks_exact(self.width) {
            if let Some(sums) = self.sums.chunks_exact_mut(self.size.0).nth(self.rows / self.side) {
                for (sum, pixels) in sums.iter_mut().zip(row.chunks(self.side)) {
                    pixels.iter().for_each(|pixel| (0..3).for_each(|c| sum[c] += pixel[c]));
                }
            }
            self.rows += 1;
        }
    }

    /// The JPEG of radiance with these `primaries`, in which `white` becomes white.
    pub(super) fn jpeg(&self, primaries: &Primaries, white: f64) -> io::Result<Vec<u8>> {
        let from_xyz = Primaries::SRGB.to_xyz().and_then(|m| m.try_inverse());
        let matrix = from_xyz.and_then(|m| Some(m * primaries.to_xyz()?)).unwrap_or_default();
        // The white of other primaries stays white.
        let neutral = matrix * Vector3::repeat(1.0);
        let scale = 1.0 / (white * (self.side * self.side) as f64);
        let code = |linear: f64| (255.0 * linear_to_srgb(linear.clamp(0.0, 1.0)) + 0.5) as u8;
        let pixel = |sum: &[f32; 3]| {
            let rgb = (matrix * Vector3::from(sum.map(f64::from)) * scale).component_div(&neutral);
            [code(rgb.x), code(rgb.y), code(rgb.z)]
        };
        let pixels: Vec<[u8; 3]> = self.sums.iter().map(pixel).collect();
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, QUALITY);
        encoder.set_sampling_factor(SamplingFactor::F_1_1);
        // Both sides are at most LONGEST.
        let (width, height) = (self.size.0 as u16, self.size.1 as u16);
        encoder.encode(pixels.as_flattened(), width, height, ColorType::Rgb).map_err(io::Error::other)?;
        Ok(bytes)
    }
}
