//! Exposure fusion within the line: the aligned frames to a picture, without radiance.
//!
//! In: a bracket and its alignment. Out: the picture, 8-bit sRGB. Cost: each frame resampled twice, and where something moved once more
//! for each frame towards the reference; and the fusion.

use crate::align::resample::{OUTSIDE, resample_rows};
use crate::align::warp::Warp;
use crate::align::{Alignment, Rect};
use crate::bracket::colour::{Conversion, Primaries, Transfer, linear_to_srgb};
use crate::bracket::{Bracket, Frame};
use crate::error::Result;
use crate::merge::deghost::Ghosts;
use crate::plane::{BAND_ROWS, Plane, band_count, band_rows};
use crate::response::{CODES, ResponseCurve};
use crate::tonemap::mertens::{self, Channels};
use rayon::prelude::*;

/// What is fused.
pub(super) struct Aligned<'a> {
    pub bracket: &'a Bracket,
    pub alignment: &'a Alignment,
    /// The part of the reference that the picture shows.
    pub region: Rect,
    pub curve: &'a ResponseCurve,
    /// What is left out of the frames, over `region`.
    pub ghosts: Option<&'a Ghosts>,
}

impl Aligned<'_> {
    /// The picture.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch).
    pub fn fused(&self, options: &mertens::Options) -> Result<Plane<[u8; 3]>> {
        let placed: Vec<Placed> = self.alignment.placed(self.bracket).collect();
        let to_srgb = ToSrgb::of(self.bracket.reference());
        let channels = |k: usize| -> Result<Channels> {
            let mut channels = self.codes(&placed, k)?;
            if let Some(to_srgb) = &to_srgb {
                let [red, green, blue] = &mut channels;
                let rows = red.as_mut_slice().par_iter_mut().zip(green.as_mut_slice()).zip(blue.as_mut_slice());
                rows.filter(|((r, _), _)| **r >= 0.0)
                    .for_each(|((r, g), b)| [*r, *g, *b] = to_srgb.codes([*r, *g, *b]));
            }
            Ok(channels)
        };
        let codes = mertens::fuse(placed.len(), channels, options)?;
        let (width, height) = (codes[0].width(), codes[0].height());
        Ok(Plane::from_rows(width, height, |y, row| {
            for (x, to) in row.iter_mut().enumerate() {
                *to = codes.each_ref().map(|c| (255.0 * c.at(x, y).clamp(0.0, 1.0) + 0.5) as u8);
            }
        }))
    }

    /// The codes 0..=1 of frame `k` of those placed, -1 outside it; where something moved, what it would show of the next frame towards the reference,
    /// which is as much changed. To give it no weight there would not do: the coarse levels of the pyramids carry what moved beyond its borders.
    fn codes(&self, placed: &[Placed], k: usize) -> Result<Channels> {
        let chain = self.chain(placed, k);
        let height = self.region.height();
        // Of the frames after the first only the bands in which something is left out of all before them.
        let mut asked = vec![vec![true; band_count(height)]];
        for pair in chain.windows(2) {
            let is_left_out = |band| self.ghosts.is_some_and(|g| !g.kept(pair[0], band_rows(band, height)).is_empty());
            let more =
                asked.last().into_iter().flatten().enumerate().map(|(band, is)| *is && is_left_out(band)).collect();
            asked.push(more);
        }
        let mut next: Option<Channels> = None;
        for (i, asked) in asked.iter().enumerate().rev() {
            let mut planes = self.resampled(&placed[chain[i]], asked)?;
            if let (Some(next), Some(ghosts)) = (&next, self.ghosts) {
                let factor = placed[chain[i]].1.exposure.relative() / placed[chain[i + 1]].1.exposure.relative();
                for (c, (own, next)) in planes.iter_mut().zip(next).enumerate() {
                    let table = changed(self.curve, c, factor);
                    own.fill_bands(|rows, band| {
                        let kept = ghosts.kept(chain[i], rows.clone());
                        for ((v, next), kept) in band.iter_mut().zip(next.rows(rows)).zip(kept) {
                            if *next >= 0.0 && *v >= 0.0 && kept < 1.0 {
                                let instead = between(&table, *next);
                                *v = instead + kept * (*v - instead);
                            }
                        }
                    });
                }
            }
            next = Some(planes);
        }
        Ok(next.unwrap_or_else(|| std::array::from_fn(|_| Plane::filled(0, 0, 0.0))))
    }

    /// The codes 0..=1 of a placed frame, -1 outside it, in the bands that are asked for; 0 in the others.
    fn resampled(&self, (_, frame, warp): &Placed, asked: &[bool]) -> Result<Channels> {
        let window = frame.whole()?;
        let (region, width, height) = (self.region, self.region.width(), self.region.height());
        let mut planes: Channels = std::array::from_fn(|_| Plane::filled(width, height, 0.0f32));
        let band = BAND_ROWS * width;
        let [red, green, blue] = planes.each_mut().map(|p| p.as_mut_slice().par_chunks_mut(band));
        let bands = red.zip(green).zip(blue).enumerate().filter(|(i, _)| asked[*i]);
        bands.for_each_init(Vec::new, |codes, (i, ((red, green), blue))| {
            codes.resize(red.len(), [0.0f32; 3]);
            let y = region.y0 + i * BAND_ROWS;
            resample_rows(&window, warp, region.x0..region.x1, y..y + red.len() / width, codes);
            for (((r, g), b), code) in red.iter_mut().zip(green).zip(blue).zip(codes.iter()) {
                // Overshoot of the kernel must not be taken for what is outside.
                [*r, *g, *b] = if code[0] == OUTSIDE { [-1.0; 3] } else { code.map(|c| (c / 255.0).clamp(0.0, 1.0)) };
            }
        });
        Ok(planes)
    }

    /// Frame `k` of those placed, and those towards the reference by which it is continued where something is left out of it, in turn.
    fn chain(&self, placed: &[Placed], k: usize) -> Vec<usize> {
        let reference = placed.iter().position(|(i, _, _)| *i == self.bracket.reference_index()).unwrap_or(k);
        let next = |&k: &usize| {
            let is_whole = self.ghosts.is_none_or(|ghosts| ghosts.is_whole(k));
            (!is_whole && k != reference).then(|| if k < reference { k + 1 } else { k - 1 })
        };
        std::iter::successors(Some(k), next).collect()
    }
}

/// A placed frame: its number in the bracket, itself, and where it lies.
type Placed<'a> = (usize, &'a Frame, Warp);

/// For each code of a channel the code 0..=1 that a frame exposed `factor` times as long has.
fn changed(curve: &ResponseCurve, channel: usize, factor: f64) -> [f32; CODES] {
    let exposures = curve.exposures(channel);
    exposures.map(|x| {
        let x = (f64::from(x) * factor) as f32;
        let above = exposures.partition_point(|&e| e < x).clamp(1, CODES - 1);
        let (a, b) = (exposures[above - 1], exposures[above]);
        let part = if b > a { ((x - a) / (b - a)).clamp(0.0, 1.0) } else { 1.0 };
        ((above - 1) as f32 + part) / (CODES - 1) as f32
    })
}

/// The entry of `table` for a code 0..=1, between entries.
fn between(table: &[f32; CODES], code: f32) -> f32 {
    let at = code * (CODES - 1) as f32;
    let below = (at as usize).min(CODES - 2);
    table[below] + (at - below as f32) * (table[below + 1] - table[below])
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
