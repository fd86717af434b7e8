//! A miniature: some thousand pixels of a bracket as a small bracket, to measure the effect of another response on the
//! radiance.
//!
//! In: a bracket and its alignment. Out: a [`Miniature`], and the difference of the radiance with two responses. Cost:
//! about a hundred rows of each frame are read; some milliseconds.
//!
//! Two responses that are nearly equal at most code values may give different radiance: dark pixels have little weight
//! but are many, and where all frames are clipped or black a single code value decides. Therefore evenly spaced pixels
//! are merged with both responses.

use super::weight::Weight;
use super::{MergeOptions, merge};
use crate::align::resampling::nearest::{Placed, placed};
use crate::align::{Alignment, Rect};
use crate::bracket::{Bracket, Codes, Frame, ReferenceChoice, Samples};
use crate::error::Result;
use crate::merge::radiance::gamut::weights;
use crate::response::ResponseCurve;
use crate::response::file::Loss;
use rayon::prelude::*;

/// Some pixels of a bracket, aligned to the reference frame, in one row.
#[derive(Debug, Clone)]
pub struct Miniature {
    bracket: Bracket,
    alignment: Alignment,
}

impl Miniature {
    /// Reads about `pixels` evenly spaced pixels of the overlap of the merged frames. `None` if the frames do not
    /// overlap.
    ///
    /// # Errors
    /// [`Error::TooFewFrames`](crate::error::Error::TooFewFrames) if fewer than two frames were aligned;
    /// [`Error::Scratch`](crate::error::Error::Scratch).
    pub fn of(bracket: &Bracket, alignment: &Alignment, pixels: usize) -> Result<Option<Self>> {
        let Rect { x0, y0, x1, y1 } = alignment.overlap;
        let step = (((x1 - x0) * (y1 - y0)) as f64 / pixels as f64).sqrt().max(1.0);
        // Returns the centres of cells with a side of `step` pixels.
        let middles = |first: usize, end: usize| -> Vec<usize> {
            let cells = (((end - first) as f64 / step) as usize).max(1);
            (0..cells).map(|k| first + (end - first) * (2 * k + 1) / (2 * cells)).collect()
        };
        let columns = middles(x0, x1);
        let placed = placed(bracket, alignment);
        // Returns for each frame its code values at those pixels of row `y` that all frames cover.
        let read = |&y: &usize| -> Result<Vec<Vec<u16>>> {
            let strips = placed.iter().map(|frame| frame.strip(&(x0..x1), &(y..y + 1))).collect::<Result<Vec<_>>>()?;
            let mut rows = vec![Vec::with_capacity(3 * columns.len()); strips.len()];
            for &x in &columns {
                let starts: Option<Vec<usize>> = strips.iter().map(|strip| strip.start(x, y, 1)).collect();
                for ((row, strip), at) in rows.iter_mut().zip(&strips).zip(starts.into_iter().flatten()) {
                    row.extend(match strip.window.codes() {
                        Codes::Eight(codes) => [0, 1, 2].map(|c| u16::from(codes[at + c])),
                        Codes::Sixteen(codes) => [0, 1, 2].map(|c| codes[at + c]),
                    });
                }
            }
            Ok(rows)
        };
        let rows = middles(y0, y1).par_iter().map(read).collect::<Result<Vec<_>>>()?;
        let frame = |(i, placed): (usize, &Placed)| {
            let codes: Vec<u16> = rows.iter().flat_map(|row| row[i].iter().copied()).collect();
            let width = codes.len() / 3;
            let samples = match placed.frame.max() {
                255 => Samples::Eight(codes.iter().map(|&code| code as u8).collect()),
                _ => Samples::Sixteen(codes),
            };
            Frame::new(placed.frame.path().to_owned(), width, 1, samples, placed.frame.exposure.clone())
        };
        if rows.iter().all(|row| row.iter().all(Vec::is_empty)) {
            return Ok(None);
        }
        let frames = placed.iter().enumerate().map(frame).collect();
        let bracket = Bracket::new(frames, &ReferenceChoice::File(bracket.reference().path().to_owned()))?;
        let alignment = Alignment::unmoved(&bracket);
        Ok(Some(Miniature { bracket, alignment }))
    }
}

/// Merges `miniatures` twice, with the response `read` and with `curve`. Returns the root mean square difference of the
/// radiances over all pixels, in stops.
///
/// # Errors
/// Those of [`merge`].
pub fn loss(miniatures: &[&Miniature], curve: &ResponseCurve, read: &ResponseCurve) -> Result<Loss> {
    let (mut squares, mut count) = ([0.0; 4], 0);
    for Miniature { bracket, alignment } in miniatures {
        let options = MergeOptions { weight: Weight::default(), region: alignment.overlap };
        let merged = |curve| merge(bracket, alignment, curve, &options, None).map(|(map, _)| map);
        let (expected, found) = (merged(curve)?, merged(read)?);
        let weights = weights(&expected.primaries).map(f64::from);
        for (a, b) in expected.pixels.as_slice().iter().zip(found.pixels.as_slice()) {
            let ratio = |c: usize| f64::from(b[c]) / f64::from(a[c]);
            let light = |pixel: &[f32; 3]| (0..3).map(|c| weights[c] * f64::from(pixel[c])).sum::<f64>();
            let ratios = [light(b) / light(a), ratio(0), ratio(1), ratio(2)];
            for (sum, ratio) in squares.iter_mut().zip(ratios) {
                let off = libm::log2(ratio);
                *sum += off * off;
            }
            count += 1;
        }
    }
    let [luminance, channels @ ..] = squares.map(|sum: f64| (sum / count.max(1) as f64).sqrt());
    Ok(Loss { luminance_stops: luminance, channel_stops: channels })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::{Placement, Transform};
    use crate::response::tests::still;

    #[test]
    fn a_curve_of_twice_the_exposure_is_off_by_a_stop_in_every_pixel() {
        let (bracket, mut alignment) =
            still((300, 200), &[0.25, 1.0, 4.0], |x, y| [0.01 * x as f64, 0.02 * y as f64, 0.3]);
        alignment.placements[0] = Placement::by_user(Transform::Rigid { dx: 3.4, dy: -2.0, angle: 0.0 });
        alignment.overlap = Rect { x0: 4, y0: 2, x1: 290, y1: 190 };
        let miniature = Miniature::of(&bracket, &alignment, 2000).unwrap().unwrap();
        let pixels = miniature.bracket.width();
        assert!((1800..=2000).contains(&pixels), "{pixels}");
        let curve = ResponseCurve::srgb();
        let twice = [0, 1, 2].map(|c| curve.ln_exposure(c).map(|g| g + std::f64::consts::LN_2));
        let twice = ResponseCurve::new(twice).unwrap();
        let found = loss(&[&miniature, &miniature], &curve, &twice).unwrap();
        let all = [found.luminance_stops, found.channel_stops[0], found.channel_stops[1], found.channel_stops[2]];
        // The tolerance allows for the rounding of radiance to the 24 bits of `f32`.
        assert!(all.iter().all(|stops| (stops - 1.0).abs() < 1e-5), "{found:?}");
        assert_eq!(loss(&[&miniature], &curve, &curve).unwrap().luminance_stops, 0.0);
    }
}
