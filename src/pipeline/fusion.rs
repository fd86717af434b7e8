//! Exposure fusion within the line: the aligned frames to a picture, without radiance.
//!
//! In: a bracket and its alignment. Out: the picture, 8-bit sRGB. Cost: each frame resampled twice, and the fusion.

use crate::align::resample::{OUTSIDE, resample_rows};
use crate::align::{Alignment, Rect};
use crate::bracket::colour::{Conversion, Primaries, Transfer, linear_to_srgb};
use crate::bracket::{Bracket, Frame};
use crate::error::Result;
use crate::plane::{BAND_ROWS, Plane};
use crate::tonemap::mertens::{self, Channels};
use rayon::prelude::*;

/// The picture of the part `region` of the placed frames.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch).
pub(super) fn fused(
    bracket: &Bracket,
    alignment: &Alignment,
    region: Rect,
    options: &mertens::Options,
) -> Result<Plane<[u8; 3]>> {
    let frames = bracket.frames().iter().zip(&alignment.verdicts);
    let placed: Vec<_> = frames.filter_map(|(frame, verdict)| Some((frame, verdict.warp?))).collect();
    let to_srgb = ToSrgb::of(bracket.reference());
    let channels = |k: usize| -> Result<Channels> {
        let (frame, warp) = &placed[k];
        let window = frame.whole()?;
        let (width, height) = (region.width(), region.height());
        let mut planes: Channels = std::array::from_fn(|_| Plane::filled(width, height, 0.0f32));
        let band = BAND_ROWS * width;
        let [red, green, blue] = planes.each_mut().map(|p| p.as_mut_slice().par_chunks_mut(band));
        let bands = red.zip(green).zip(blue).enumerate();
        bands.for_each_init(Vec::new, |codes, (i, ((red, green), blue))| {
            codes.resize(red.len(), [0.0f32; 3]);
            let y = region.y0 + i * BAND_ROWS;
            resample_rows(&window, warp, region.x0..region.x1, y..y + red.len() / width, codes);
            for (((r, g), b), code) in red.iter_mut().zip(green).zip(blue).zip(codes.iter()) {
                // Overshoot of the kernel must not be taken for what is outside.
                let inside = || code.map(|c| (c / 255.0).clamp(0.0, 1.0));
                [*r, *g, *b] = match &to_srgb {
                    _ if code[0] == OUTSIDE => [-1.0; 3],
                    None => inside(),
                    Some(to_srgb) => to_srgb.codes(inside()),
                };
            }
        });
        Ok(planes)
    };
    let codes = mertens::fuse(placed.len(), channels, options)?;
    let (width, height) = (codes[0].width(), codes[0].height());
    Ok(Plane::from_rows(width, height, |y, row| {
        for (x, to) in row.iter_mut().enumerate() {
            *to = codes.each_ref().map(|c| (255.0 * c.at(x, y).clamp(0.0, 1.0) + 0.5) as u8);
        }
    }))
}

/// The way from the codes of a frame to those of sRGB, both 0 to 1: the measures of fusion are made for what a display shows.
struct ToSrgb {
    transfer: Transfer,
    conversion: Conversion,
}

impl ToSrgb {
    /// None where `frame` is in sRGB, or in no space.
    fn of(frame: &Frame) -> Option<ToSrgb> {
        let (primaries, transfer) = (frame.primaries(), Transfer::of(frame.profile.as_ref()));
        let is_srgb = primaries.is_close(&Primaries::SRGB, 1e-3) && transfer.is_srgb();
        let conversion = Conversion::between(&primaries, &Primaries::SRGB).filter(|_| !is_srgb)?;
        Some(ToSrgb { transfer, conversion })
    }

    fn codes(&self, codes: [f32; 3]) -> [f32; 3] {
        let light = [0, 1, 2].map(|c| self.transfer.light(c, codes[c].into()) as f32);
        self.conversion.apply(light).map(|v| linear_to_srgb(v.into()) as f32)
    }
}
