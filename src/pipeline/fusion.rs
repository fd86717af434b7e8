//! Exposure fusion within the line: the aligned frames to a picture, without radiance.
//!
//! In: a bracket and its alignment. Out: the picture, 8-bit sRGB. Cost: each frame resampled twice, and the fusion.

use crate::align::resample::{OUTSIDE, resample_rows};
use crate::align::{Alignment, Rect};
use crate::bracket::Bracket;
use crate::bracket::colour::{Conversion, Primaries, srgb_to_linear};
use crate::error::{Error, Result};
use crate::plane::{BAND_ROWS, Plane};
use crate::tonemap::display::Encoder;
use crate::tonemap::mertens::{self, BYTES_PER_PIXEL, Channels};
use rayon::prelude::*;

/// The picture of the part `region` of the placed frames.
///
/// # Errors
/// [`Error::Option`] where memory does not suffice; [`Error::Scratch`].
pub(super) fn fused(
    bracket: &Bracket,
    alignment: &Alignment,
    region: Rect,
    options: &mertens::Options,
    memory: Option<u64>,
) -> Result<Plane<[u8; 3]>> {
    let needed = BYTES_PER_PIXEL * region.width() as u64 * region.height() as u64;
    if let Some(allowed) = memory.filter(|allowed| *allowed < needed) {
        let (needed, allowed) = (needed.div_ceil(1_000_000), allowed / 1_000_000);
        let reason = format!(
            "`mertens` takes {needed} MB for this picture and {allowed} MB are allowed; give a larger --max-memory, or another --tmo"
        );
        return Err(Error::Option { option: "--tmo", reason });
    }
    let frames = bracket.frames().iter().zip(&alignment.verdicts);
    let placed: Vec<_> = frames.filter_map(|(frame, verdict)| Some((frame, verdict.warp?))).collect();
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
                let value = if code[0] == OUTSIDE { [-1.0; 3] } else { code.map(|c| (c / 255.0).clamp(0.0, 1.0)) };
                [*r, *g, *b] = value;
            }
        });
        Ok(planes)
    };
    let codes = mertens::fuse(placed.len(), channels, options)?;
    Ok(shown(&codes, &bracket.reference().primaries()))
}

/// Codes of the camera's colour space as codes of sRGB. The transfer of the frames is taken for sRGB's, as displays do.
fn shown(codes: &Channels, primaries: &Primaries) -> Plane<[u8; 3]> {
    let conversion = if primaries.is_close(&Primaries::SRGB, 1e-3) {
        None
    } else {
        Conversion::between(primaries, &Primaries::SRGB)
    };
    let (width, height) = (codes[0].width(), codes[0].height());
    let encoder = Encoder::new();
    Plane::from_rows(width, height, |y, row| {
        for (x, to) in row.iter_mut().enumerate() {
            let code = codes.each_ref().map(|c| c.at(x, y).clamp(0.0, 1.0));
            *to = match &conversion {
                None => code.map(|c| (255.0 * c + 0.5) as u8),
                Some(conversion) => encoder.codes(&conversion.apply(code.map(|c| srgb_to_linear(c.into()) as f32))),
            };
        }
    })
}
