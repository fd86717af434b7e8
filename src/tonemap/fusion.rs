//! Exposure fusion (Mertens et al. 2007): blends the best exposed parts of several exposures without seams.
//!
//! `mertens` fuses the aligned frames, without radiance or response; [`natural`](super::natural) fuses exposures
//! computed from the radiance.
//!
//! In: frames of one size, as code values. Out: the fused picture. Cost: 0.25 us for each pixel of each frame, on two
//! cores. Memory: 43 to 53 bytes for each pixel of the result, for any number of frames. Source: Mertens, Kautz, Van
//! Reeth, "Exposure Fusion" (2007), sections 3.1 (quality measures) and 3.2 (fusion), equations 1 to 5.

use super::settings::Setting;
use crate::error::Result;
use crate::plane::Plane;
use crate::pyramid::burt_adelson::{collapse, gaussian_pyramid, laplacian_pyramid, levels};
use rayon::prelude::*;

/// Exponents of the three quality measures.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[serde(tag = "name", rename = "mertens")]
pub struct Options {
    /// Exponent of contrast; 0 ignores it.
    pub contrast: f64,
    /// Exponent of saturation; 0 ignores it.
    pub saturation: f64,
    /// Exponent of well-exposedness; 0 ignores it.
    pub exposedness: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { contrast: 1.0, saturation: 1.0, exposedness: 1.0 }
    }
}

impl Options {
    /// Returns the settings, each with its name, range and description.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::number(
                "contrast",
                (0.0, 4.0),
                &mut self.contrast,
                "exponent of the contrast measure: larger values prefer pixels with detail; 0 ignores it",
            ),
            Setting::number(
                "saturation",
                (0.0, 4.0),
                &mut self.saturation,
                "exponent of the saturation measure: larger values prefer pixels with strong colours",
            ),
            Setting::number(
                "exposedness",
                (0.0, 4.0),
                &mut self.exposedness,
                "exponent of the exposure measure: larger values prefer pixels that are neither dark nor bright",
            ),
        ]
    }
}

/// Standard deviation of the Gaussian around code value 0.5 that measures well-exposedness (section 3.1), for code
/// values 0..=1.
const WELL_EXPOSED: f32 = 0.2;

/// A frame: code values 0..=1 in three planes. Negative values mean that the frame does not cover the pixel.
pub type Channels = [Plane<f32>; 3];

/// Fuses `count` frames of one size. `frame` returns the frame with the given index, and is called twice for each
/// index. Values are code values, 0..=1.
///
/// # Errors
/// Those of `frame`.
pub fn fuse(count: usize, frame: impl Fn(usize) -> Result<Channels>, options: &Options) -> Result<Channels> {
    let mut total: Option<Plane<f32>> = None;
    for k in 0..count {
        let weights = weights(&frame(k)?, options);
        match &mut total {
            None => total = Some(weights),
            Some(sum) => add(sum, &weights),
        }
    }
    let Some(total) = total else { return Ok(std::array::from_fn(|_| Plane::filled(0, 0, 0.0))) };
    let depth = levels((total.width(), total.height()));
    let mut fused: [Vec<Plane<f32>>; 3] = Default::default();
    for k in 0..count {
        let mut channels = frame(k)?;
        let mut share = weights(&channels, options);
        // Equation 4; where no frame has any weight, all frames get the same weight.
        let parts = share.as_mut_slice().par_iter_mut().zip(total.as_slice());
        parts.for_each(|(w, &sum)| *w = if sum > 0.0 { *w / sum } else { 1.0 / count as f32 });
        let shares = gaussian_pyramid(share, depth);
        fused.par_iter_mut().zip(channels.par_iter_mut()).for_each(|(sum, channel)| {
            channel.as_mut_slice().iter_mut().for_each(|v| *v = v.max(0.0));
            let plane = std::mem::replace(channel, Plane::filled(0, 0, 0.0));
            let mut part = laplacian_pyramid(gaussian_pyramid(plane, depth));
            // Equation 5.
            for (level, share) in part.iter_mut().zip(&shares) {
                level.as_mut_slice().iter_mut().zip(share.as_slice()).for_each(|(v, w)| *v *= w);
            }
            if sum.is_empty() {
                *sum = part;
            } else {
                sum.iter_mut().zip(&part).for_each(|(sum, part)| add(sum, part));
            }
        });
    }
    let whole: Vec<Plane<f32>> = fused.into_par_iter().map(collapse).collect();
    let mut whole = whole.into_iter();
    Ok(std::array::from_fn(|_| whole.next().unwrap_or_else(|| Plane::filled(0, 0, 0.0))))
}

fn add(sum: &mut Plane<f32>, part: &Plane<f32>) {
    sum.as_mut_slice().iter_mut().zip(part.as_slice()).for_each(|(s, p)| *s += p);
}

/// Returns equation 3: the product of contrast, saturation and well-exposedness, each raised to its exponent; 0 outside
/// the frame.
fn weights(channels: &Channels, options: &Options) -> Plane<f32> {
    let (width, height) = (channels[0].width(), channels[0].height());
    let grey = Plane::from_rows(width, height, |y, row| {
        let [red, green, blue] = [channels[0].row(y), channels[1].row(y), channels[2].row(y)];
        for (grey, ((r, g), b)) in row.iter_mut().zip(red.iter().zip(green).zip(blue)) {
            *grey = (r + g + b) / 3.0;
        }
    });
    let power = |value: f32, exponent: f64| match exponent {
        0.0 => 1.0,
        1.0 => value,
        _ => libm::powf(value, exponent as f32),
    };
    let bells: Vec<f32> = (0..=1024).map(|i| power(bell(i as f32 / 1024.0), options.exposedness)).collect();
    Plane::from_rows(width, height, |y, row| {
        let (above, here, below) = (grey.row(y.saturating_sub(1)), grey.row(y), grey.row((y + 1).min(height - 1)));
        let [red, green, blue] = [channels[0].row(y), channels[1].row(y), channels[2].row(y)];
        for (x, w) in row.iter_mut().enumerate() {
            let (left, right) = (here[x.saturating_sub(1)], here[(x + 1).min(width - 1)]);
            let contrast = (above[x] + below[x] + left + right - 4.0 * here[x]).abs();
            let (r, g, b) = (red[x] - here[x], green[x] - here[x], blue[x] - here[x]);
            let variance = (r * r + g * g + b * b) / 3.0;
            let bell = |v: f32| bells[(v.clamp(0.0, 1.0) * 1024.0) as usize];
            let exposed = bell(red[x]) * bell(green[x]) * bell(blue[x]);
            let weight = power(contrast, options.contrast) * power(variance.sqrt(), options.saturation) * exposed;
            // A uniform grey area has neither contrast nor saturation in any frame. There the small terms let
            // well-exposedness alone determine the weights.
            *w = if red[x] < 0.0 { 0.0 } else { weight + 1e-9 + 1e-6 * exposed };
        }
    })
}

/// Returns the well-exposedness of section 3.1: a Gaussian around 0.5.
fn bell(value: f32) -> f32 {
    let d = (value - 0.5) / WELL_EXPOSED;
    libm::expf(-0.5 * d * d)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(value: [f32; 3], size: (usize, usize)) -> Channels {
        value.map(|v| Plane::filled(size.0, size.1, v))
    }

    fn fused(frames: &[Channels]) -> Channels {
        fuse(frames.len(), |k| Ok(frames[k].clone()), &Options::default()).unwrap()
    }

    #[test]
    fn one_frame_is_itself() {
        let frame: Channels = [0, 1, 2].map(|c| {
            Plane::from_rows(37, 21, |y, row| {
                for (x, v) in row.iter_mut().enumerate() {
                    *v = ((x * 5 + y * 3 + c * 11) % 23) as f32 / 23.0;
                }
            })
        });
        let whole = fused(std::slice::from_ref(&frame));
        for (a, b) in whole.iter().zip(&frame) {
            assert!(a.as_slice().iter().zip(b.as_slice()).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }

    /// The left half is well exposed in one frame, the right half in the other. Except near the middle, the fused
    /// picture shows the frame that is well exposed there.
    #[test]
    fn each_frame_contributes_where_it_is_well_exposed() {
        let half = |left: f32, right: f32| -> Channels {
            [1.0, 0.9, 0.8].map(|tint| {
                Plane::from_rows(256, 64, |_, row| {
                    for (x, v) in row.iter_mut().enumerate() {
                        *v = tint * if x < 128 { left } else { right };
                    }
                })
            })
        };
        let frames = [half(0.5, 0.01), half(0.999, 0.5)];
        let whole = fused(&frames);
        let (left, right) = (whole[0].at(5, 32), whole[0].at(250, 32));
        assert!((left - 0.5).abs() < 0.08 && (right - 0.5).abs() < 0.08, "{left} {right}");
    }

    /// For uniform frames, fusion with the pyramids of section 3.2 gives the same as fusion without pyramids: a
    /// weighted mean.
    #[test]
    fn uniform_frames_give_their_weighted_mean_without_outside_pixels() {
        let frames = [flat([0.2, 0.3, 0.4], (40, 30)), flat([0.6, 0.5, 0.7], (40, 30)), flat([-1.0; 3], (40, 30))];
        let weights: Vec<f32> = frames.iter().map(|f| weights(f, &Options::default()).at(20, 15)).collect();
        assert_eq!(weights[2], 0.0);
        let whole = fused(&frames);
        for c in 0..3 {
            let mean =
                (weights[0] * frames[0][c].at(0, 0) + weights[1] * frames[1][c].at(0, 0)) / (weights[0] + weights[1]);
            assert!((whole[c].at(20, 15) - mean).abs() < 1e-4);
        }
    }
}
