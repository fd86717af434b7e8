//! Exposure fusion: from the aligned frames to a picture, without radiance.
//!
//! In: a bracket and its alignment. Out: the picture, encoded in its colour space. Cost: the fusion, and resampling
//! each frame twice. If something moved, resampling a frame includes resampling the reference and all frames between
//! the frame and the reference.

use crate::align::Motion;
use crate::align::resampling::{OUTSIDE, resample_rows, rows_under};
use crate::bracket::Frame;
use crate::bracket::colour::{Conversion, Transfer};
use crate::error::Result;
use crate::merge::deghost::Ghosts;
use crate::pipeline::stages::reference::Aligned;
use crate::plane::{BAND_ROWS, Plane};
use crate::response::ResponseCurve;
use crate::tonemap::display::codes::Colours;
use crate::tonemap::fusion::{self, Channels};
use rayon::prelude::*;
use std::ops::Range;

/// The frames that are fused.
struct Fused<'a> {
    aligned: &'a Aligned,
    placed: Vec<Placed<'a>>,
    curve: &'a ResponseCurve,
    /// The ghosts of the frames, over the region of `aligned`.
    ghosts: Option<&'a Ghosts>,
}

/// Fuses the frames. Returns code values in the colour space `colours`, from 0 to 1 except for some overshoot.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch).
pub(crate) fn fused(
    aligned: &Aligned,
    curve: &ResponseCurve,
    ghosts: Option<&Ghosts>,
    options: &fusion::Options,
    colours: Colours,
) -> Result<Channels> {
    let placed: Vec<Placed> = aligned.alignment.placed(&aligned.bracket).collect();
    let frames = Fused { aligned, placed, curve, ghosts };
    let to_shown = ToShown::of(aligned.bracket.reference(), colours);
    let channels = |k: usize| -> Result<Channels> {
        let mut channels = frames.codes(k)?;
        if let Some(to_shown) = &to_shown {
            let [red, green, blue] = &mut channels;
            let rows = red.as_mut_slice().par_iter_mut().zip(green.as_mut_slice()).zip(blue.as_mut_slice());
            rows.filter(|((r, _), _)| **r >= 0.0).for_each(|((r, g), b)| [*r, *g, *b] = to_shown.codes([*r, *g, *b]));
        }
        Ok(channels)
    };
    fusion::fuse(frames.placed.len(), channels, options)
}

impl Fused<'_> {
    /// Returns the codes of merged frame `k`, 0..=1; -1 where the frame does not cover the region.
    fn codes(&self, k: usize) -> Result<Channels> {
        let region = self.aligned.region;
        let (width, height) = (region.width(), region.height());
        let mut planes: Channels = std::array::from_fn(|_| Plane::filled(width, height, 0.0f32));
        let [red, green, blue] = planes.each_mut().map(|p| p.as_mut_slice().par_chunks_mut(BAND_ROWS * width));
        red.zip(green).zip(blue).enumerate().try_for_each(|(i, ((red, green), blue))| {
            let first = i * BAND_ROWS;
            let codes = self.rows(k, first..first + red.len() / width)?;
            for (((r, g), b), code) in red.iter_mut().zip(green).zip(blue).zip(codes) {
                [*r, *g, *b] = code;
            }
            Ok(())
        })?;
        Ok(planes)
    }

    /// Returns the codes of merged frame `k` in some rows of the region.
    ///
    /// Where something moved, the codes of the frame are replaced. The new codes are those that the frame would have
    /// for the radiance of its neighbour, the next frame towards the reference. In the neighbour, motion has been
    /// replaced in the same way. If the frame is darker than the reference, the radiance of the neighbour is first
    /// completed by [`Ghosts::fill`] where the reference is clipped. A weight of 0 instead of new codes would not be
    /// enough: the coarse levels of the pyramids would spread the moving object beyond its borders.
    fn rows(&self, k: usize, rows: Range<usize>) -> Result<Vec<[f32; 3]>> {
        let (Fused { aligned, placed, .. }, region) = (self, self.aligned.region);
        let (_, frame, motion) = &placed[k];
        let columns = region.x0..region.x1;
        let lines = region.y0 + rows.start..region.y0 + rows.end;
        let window = frame.window(rows_under(motion, &columns, &lines))?;
        let mut codes = vec![[0.0f32; 3]; columns.len() * lines.len()];
        resample_rows(&window, motion, columns, lines, &mut codes);
        for code in &mut codes {
            // A negative code marks a pixel outside of the frame. So codes below 0 from the overshoot of the
            // resampling kernel are clamped to 0.
            *code = if code[0] == OUTSIDE { [-1.0; 3] } else { code.map(|c| (c / 255.0).clamp(0.0, 1.0)) };
        }
        let reference = placed.iter().position(|(i, _, _)| *i == aligned.bracket.reference_index()).unwrap_or(k);
        let kept = self.ghosts.map_or_else(Vec::new, |ghosts| ghosts.kept(k, rows.clone()));
        if k == reference || kept.is_empty() {
            return Ok(codes);
        }
        let toward = if k < reference { k + 1 } else { k - 1 };
        let next = self.rows(toward, rows.clone())?;
        let time = |k: usize| placed[k].1.exposure.relative() / placed[reference].1.exposure.relative();
        let (time, next_time) = (time(k) as f32, time(toward) as f32);
        let radiance = |code: [f32; 3]| [0, 1, 2].map(|c| self.curve.exposure(c, 255.0 * code[c]) / next_time);
        let mut instead: Vec<[f32; 3]> = next.iter().map(|&code| radiance(code)).collect();
        if let Some(ghosts) = self.ghosts.filter(|_| k < reference) {
            ghosts.fill(rows.start, &mut instead);
        }
        for (((code, next), kept), instead) in codes.iter_mut().zip(&next).zip(kept).zip(instead) {
            if next[0] >= 0.0 && code[0] >= 0.0 && kept < 1.0 {
                *code = std::array::from_fn(|c| {
                    let instead = self.curve.code(c, instead[c] * time) / 255.0;
                    instead + kept * (code[c] - instead)
                });
            }
        }
        Ok(codes)
    }
}

/// A merged frame: its index in the bracket, the frame, and its motion.
type Placed<'a> = (usize, &'a Frame, Motion);

/// Converts codes of a frame to codes of the picture, both 0 to 1, because the quality measures of fusion are defined
/// for displayed colours.
struct ToShown {
    transfer: Transfer,
    conversion: Conversion,
    colours: Colours,
}

impl ToShown {
    /// Returns `None` if no conversion is needed, because `frame` has the `colours` of the picture, or if the
    /// primaries of `frame` span no colour space.
    fn of(frame: &Frame, colours: Colours) -> Option<ToShown> {
        let (primaries, transfer) = (frame.primaries(), Transfer::of(frame.profile.as_ref()));
        let shown = colours.primaries();
        let is_shown = primaries.is_close(&shown, 1e-3) && transfer.is_close(&Transfer::of(colours.profile().as_ref()));
        let conversion = Conversion::between(&primaries, &shown).filter(|_| !is_shown)?;
        Some(ToShown { transfer, conversion, colours })
    }

    fn codes(&self, codes: [f32; 3]) -> [f32; 3] {
        let light = [0, 1, 2].map(|c| self.transfer.light(c, codes[c].into()) as f32);
        self.conversion.apply(light).map(|v| self.colours.code(v.into()) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::Alignment;
    use crate::bracket::{Bracket, ReferenceChoice};
    use crate::merge::deghost;
    use crate::response::tests::still;

    #[test]
    fn clipped_reference_is_continued_where_a_shorter_frame_is_rejected() {
        let sky = |_: usize, _: usize| [3.0, 2.4, 1.4];
        let is_mover = |x: usize, y: usize| x.abs_diff(120) < 20 && y.abs_diff(90) < 20;
        let mover = |x: usize, y: usize| if is_mover(x, y) { [0.2, 0.15, 0.15] } else { sky(x, y) };
        let times = [0.125, 1.0];
        let frame = |i: usize| if i == 0 { still((240, 180), &times, mover) } else { still((240, 180), &times, sky) };
        let frames = (0..2).map(|i| frame(i).0.frames()[i].clone()).collect();
        let bracket = Bracket::new(frames, &ReferenceChoice::Number(2)).unwrap();
        let (alignment, curve) = (Alignment::unmoved(&bracket), ResponseCurve::srgb());
        let region = alignment.overlap;
        let ghosts = deghost::find(&bracket, &alignment, &curve, region, deghost::AUTO, None).unwrap();
        let aligned = Aligned { bracket, alignment, region };
        let fused = fused(&aligned, &curve, Some(&ghosts), &fusion::Options::default(), Colours::Srgb).unwrap();
        for c in 0..3 {
            // The tolerance is two code values, for the rounding of the codes from which the sky behind the moving
            // object is computed, and of the sums over the pyramid levels. Without deghosting, the code would be 99 at
            // the moving object, and 158 in the sky around it.
            let (found, around) = (255.0 * fused[c].at(120, 90), 255.0 * fused[c].at(20, 90));
            assert!((found - around).abs() < 2.0, "channel {c}: {found} in {around}");
        }
    }
}
