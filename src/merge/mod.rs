//! Merging: radiance from aligned frames, their exposures and the response.
//!
//! In: a bracket, where its frames lie, and what their codes mean. Out: a [`RadianceMap`] on the reference's pixels, and a
//! [`Merged`]. Cost: about 15 ns of one core for each pixel of each frame, and as much again where it moved.
//! Source: Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs", section 2.2.
//!
//! The radiance of a pixel is the weighted mean over the frames j, for each channel,
//!
//! ```text
//! E = sum_j w_j X_j / dt_j  /  sum_j w_j,        X = exp(g(Z)),  w_j = w(Z_j) sqrt(dt_j) v(max of R, G, B in j) u_j + e_j
//! ```
//!
//! - The mean is of exposures, not of their logarithms as in the paper's equation 6: on ten truth brackets, with the hat and the true
//!   curve, the mean of logarithms has a PU21-PSNR lower by 1.2 dB, though an RMS error in stops that is no larger.
//! - v judges the three channels together: where one is about to clip, the camera's colour processing has spoilt the others, and
//!   a frame that holds all three has the say. Else a clipped channel would leave a cast.
//! - u judges the frames together: where a shorter one vouches for more light than this one can hold, and its brightest channel is near
//!   the top, it clips here whatever its codes. JPEG's ringing beside clipped pixels, and noise, pull codes down from the top, where each
//!   stands for the most light and would darken the mean most. Under noise weights this alone is worth 17 dB on truth brackets.
//! - e_j decides where no frame is trusted: the shortest exposure where all clip, the longest where all are black. It is a weight
//!   in the same mean, of the size of one code's, and fades linearly over the codes: there is no border between weighted and decided.
//! - A frame of which the place is only [assumed](crate::align::Status::Assumed) is not among the j: it fills what they clip, or what is black in all of
//!   them (`fill`).
//! - Of frames that are locally processed, X_j / dt_j is multiplied by the frame's [gain](local) there, and so is what it vouches for and clips at.
//!
//! **Units.** dt is the frame's relative exposure over that of the reference, and g(128) = 0: radiance 1 is what gave the reference
//! its middle code. A reference that is well exposed has its picture within about 0.001 to 5, so that all that a bracket can hold stays
//! inside a half-float's 6e-8..65504. Divide by [`Merged::reference_exposure`] to compare brackets of different exposure, or have
//! them [normalised](normalisation).

pub mod calibration;
pub mod deghost;
mod fill;
pub mod flare;
pub mod gamut;
mod layer;
pub mod local;
mod mean;
pub mod miniature;
mod noise;
pub mod normalisation;
pub mod share;
pub mod statistics;
pub mod weight;

use crate::align::{Alignment, Rect};
use crate::bracket::Bracket;
use crate::bracket::colour::Primaries;
use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::response::ResponseCurve;
use crate::simd::vectorised;
use calibration::Unit;
use deghost::Ghosts;
use fill::{FilledRow, Filling};
use layer::{COLUMNS, Fill, Layer, ROWS, Tile, layers};
use local::LocalGain;
use mean::{Bounds, Means, MergedRow, Taken};
use serde::Serialize;
use statistics::Statistics;
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use weight::Weight;

/// The least radiance: below what any curve and exposure give, so that no value is 0.
pub const FLOOR: f32 = 1e-12;

/// Linear radiance.
#[derive(Debug, Clone, PartialEq)]
pub struct RadianceMap {
    /// Linear RGB by rows; every value finite and positive.
    pub pixels: Plane<[f32; 3]>,
    /// What red, green, blue and white are.
    pub primaries: Primaries,
}

/// How frames are merged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MergeOptions {
    /// How far a code is trusted.
    pub weight: Weight,
    /// The pixels of the reference that are wanted: its [overlap](Alignment::overlap) with the others, or all of it.
    pub region: Rect,
}

/// What came of merging.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Merged {
    /// Frames that took part.
    pub frames: usize,
    /// Pixels of which some channel is at its top code even in the shortest exposure that covers them: their radiance is a lower bound.
    pub all_clipped: usize,
    /// Pixels of which all channels are at code 0 even in the longest exposure that covers them: their radiance is an upper bound.
    pub all_black: usize,
    /// The reference's relative exposure t * ISO / N^2 in s, by which radiance can be divided to be comparable between brackets.
    pub reference_exposure: f64,
}

impl Merged {
    /// The report of it, when the radiance has its unit and its colours: relative to `unit_exposure`, or to the reference's.
    pub fn report(self, radiance: Statistics, unit_exposure: Option<f64>) -> MergeReport {
        let Merged { frames, all_clipped, all_black, reference_exposure } = self;
        let is_relative = radiance.unit == Unit::Relative;
        let unit_exposure_s = is_relative.then_some(unit_exposure.unwrap_or(reference_exposure));
        MergeReport { frames, all_clipped, all_black, reference_exposure, unit_exposure_s, radiance }
    }
}

/// What came of merging, for the report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MergeReport {
    /// [`Merged::frames`].
    pub frames: usize,
    /// [`Merged::all_clipped`].
    pub all_clipped: usize,
    /// [`Merged::all_black`].
    pub all_black: usize,
    /// [`Merged::reference_exposure`].
    pub reference_exposure: f64,
    /// The relative exposure t * ISO / N^2 at which radiance 1 gives the middle code: the reference's, or that which the radiance is
    /// [normalised](normalisation) to. Null in cd/m2.
    pub unit_exposure_s: Option<f64>,
    /// Of the luminance.
    pub radiance: Statistics,
}

/// A merge that is ready to be done, as a whole or slab by slab: the frames that take part, and what their codes mean.
pub struct Merging<'a> {
    bracket: &'a Bracket,
    region: Rect,
    layers: Vec<Layer<'a>>,
    /// Which frame of the bracket each layer is.
    frames: Vec<usize>,
    ghosts: Option<&'a Ghosts>,
    local: Option<&'a LocalGain>,
}

/// Some rows of the result.
#[derive(Debug, Clone, PartialEq)]
pub struct Slab {
    /// Their radiance.
    pub map: RadianceMap,
    /// See [`Merged::all_clipped`].
    pub all_clipped: usize,
    /// See [`Merged::all_black`].
    pub all_black: usize,
}

impl<'a> Merging<'a> {
    /// The merge of `options.region`.
    ///
    /// Frames that are rejected take no part, nor does a frame where it does not cover the pixel. What `ghosts` (found over the same
    /// region, with the same alignment) leaves out of a frame takes no part either: its weight there is multiplied by the factor kept, and a frame of which less
    /// than half is kept decides nothing.
    ///
    /// # Errors
    /// [`Error::Option`] where the region is empty or not within the reference, where no frame was placed, or where `ghosts` are of another
    /// region or other frames; [`Error::Scratch`].
    pub fn of(
        bracket: &'a Bracket,
        alignment: &'a Alignment,
        curve: &ResponseCurve,
        options: &MergeOptions,
        ghosts: Option<&'a Ghosts>,
    ) -> Result<Self> {
        let region = options.region;
        let Rect { x0, y0, x1, y1 } = region;
        if !(x0 < x1 && y0 < y1 && x1 <= bracket.width() && y1 <= bracket.height()) {
            return Err(Error::Option {
                option: "--crop",
                reason: format!(
                    "columns {x0}..{x1} and rows {y0}..{y1} are no part of a picture of {}x{} pixels",
                    bracket.width(),
                    bracket.height()
                ),
            });
        }
        let layers = layers(bracket, alignment, curve, options.weight)?;
        if layers.is_empty() {
            return Err(Error::Option {
                option: "--align",
                reason: "no frame was placed; give `--align none` for a bracket taken from a tripod".to_owned(),
            });
        }
        let frames: Vec<usize> = alignment.placed(bracket).map(|(i, _, _)| i).collect();
        let merging = Merging { bracket, region, layers, frames, ghosts, local: None };
        ghosts.map_or(Ok(()), |ghosts| ghosts.check(region, &merging.paths()))?;
        Ok(merging)
    }

    /// The same merge of frames that are locally processed: the radiance of each is multiplied by its gain (found over the same region, with the same
    /// alignment).
    ///
    /// # Errors
    /// [`Error::Option`] where the gain is of another region or other frames.
    pub fn with_local_gain(self, local: Option<&'a LocalGain>) -> Result<Self> {
        local.map_or(Ok(()), |local| local.check(self.region, &self.paths()))?;
        let mut merging = Merging { local, ..self };
        if local.is_some() {
            merging.layers.iter_mut().for_each(Layer::weigh_as_local);
        }
        Ok(merging)
    }

    /// The frames that take part, by rising exposure.
    fn paths(&self) -> Vec<&'a Path> {
        self.frames.iter().map(|&i| self.bracket.frames()[i].path()).collect()
    }

    /// What frames of which the place is assumed are to fill.
    fn fills(&self) -> Vec<Fill> {
        let is_asked = |fill: &Fill| self.layers.iter().any(|layer| layer.fill == Some(*fill));
        [Fill::Clipped, Fill::Black].into_iter().filter(is_asked).collect()
    }

    /// How far each pixel of layer `i` is believed at `rows` of the region; nothing where wholly. A frame that fills is not compared with what it fills.
    fn kept(&self, i: usize, rows: Range<usize>) -> Vec<f32> {
        let ghosts = self.ghosts.filter(|_| self.layers[i].fill.is_none());
        ghosts.map_or_else(Vec::new, |ghosts| ghosts.kept(i, rows))
    }

    /// What the radiance of each pixel of layer `i` is multiplied by at `rows` of the region; nothing where by 1.
    fn gain(&self, i: usize, rows: Range<usize>) -> Vec<f32> {
        self.local.map_or_else(Vec::new, |local| local.at(i, rows))
    }

    /// Width and height of the result, in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.region.width(), self.region.height())
    }

    /// What came of it, where `bounds` are the [`Slab::all_clipped`] and [`Slab::all_black`] of all slabs together.
    pub fn merged(&self, (all_clipped, all_black): (usize, usize)) -> Merged {
        let reference_exposure = self.bracket.reference().exposure.relative();
        Merged { frames: self.layers.len(), all_clipped, all_black, reference_exposure }
    }

    /// The rows `rows` of the result, which do not depend on where the slab begins and ends.
    ///
    /// # Errors
    /// [`Error::Scratch`], where frames are on disk.
    ///
    /// # Panics
    /// When the result has no such rows.
    pub fn slab(&self, rows: Range<usize>) -> Result<Slab> {
        let Rect { x0, y0, x1, .. } = self.region;
        assert!(rows.start < rows.end && rows.end <= self.region.height());
        let (first, columns) = (rows.start, x0..x1);
        let whole = y0 + rows.start..y0 + rows.end;
        let windows = self.layers.iter().map(|layer| layer.window(&columns, &whole)).collect::<Result<Vec<_>>>()?;
        let (all_clipped, all_black) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let width = self.region.width();
        let mut pixels = Plane::filled(width, rows.len(), [0.0; 3]);
        let fills = self.fills();
        let scratch = || {
            let filling = (!fills.is_empty()).then(Filling::new);
            (Means::new(), filling, self.layers.iter().map(|_| Tile::new()).collect::<Vec<_>>())
        };
        pixels.fill_bands_with(scratch, |(means, filling, tiles), rows, band| {
            let mut bounds = Bounds::default();
            for (strip, out) in rows.step_by(ROWS).zip(band.chunks_mut(ROWS * width)) {
                let rows = first + strip..first + strip + out.len() / width;
                let kept: Vec<Vec<f32>> = (0..self.layers.len()).map(|i| self.kept(i, rows.clone())).collect();
                let gain: Vec<Vec<f32>> = (0..self.layers.len()).map(|i| self.gain(i, rows.clone())).collect();
                for left in (0..width).step_by(COLUMNS) {
                    let columns = left..(left + COLUMNS).min(width);
                    for ((layer, window), tile) in self.layers.iter().zip(&windows).zip(&mut *tiles) {
                        let columns = x0 + columns.start..x0 + columns.end;
                        tile.read(layer, window, columns, y0 + rows.start..y0 + rows.end);
                    }
                    for (y, line) in out.chunks_exact_mut(width).enumerate() {
                        let part = y * width + columns.start..y * width + columns.end;
                        let taken: Vec<Taken> =
                            kept.iter().zip(&gain).map(|(kept, gain)| Taken::part(kept, gain, part.clone())).collect();
                        let line = &mut line[columns.clone()];
                        vectorised(MergedRow { layers: &self.layers, tiles, taken: &taken, y, means, line });
                        if let Some(filling) = filling {
                            for &fill in &fills {
                                let (layers, taken, known) = (&self.layers, &taken[..], &mut *means);
                                let radiance = &mut *line;
                                vectorised(FilledRow { layers, tiles, taken, y, fill, filling, known, radiance });
                            }
                        }
                        let found = means.bounds(line.len());
                        bounds.clipped += found.clipped;
                        bounds.black += found.black;
                    }
                }
            }
            // Whole numbers add up to the same in any order.
            all_clipped.fetch_add(bounds.clipped, Ordering::Relaxed);
            all_black.fetch_add(bounds.black, Ordering::Relaxed);
        });
        let map = RadianceMap { pixels, primaries: self.bracket.reference().primaries() };
        Ok(Slab { map, all_clipped: all_clipped.into_inner(), all_black: all_black.into_inner() })
    }
}

/// All of a [merge](Merging) at once.
///
/// # Errors
/// Those of [`Merging::of`].
pub fn merge(
    bracket: &Bracket,
    alignment: &Alignment,
    curve: &ResponseCurve,
    options: &MergeOptions,
    ghosts: Option<&Ghosts>,
) -> Result<(RadianceMap, Merged)> {
    let merging = Merging::of(bracket, alignment, curve, options, ghosts)?;
    let slab = merging.slab(0..merging.size().1)?;
    let merged = merging.merged((slab.all_clipped, slab.all_black));
    Ok((slab.map, merged))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::Status;
    use crate::align::warp::Warp;
    use crate::response::tests::still;

    fn run(bracket: &Bracket, alignment: &Alignment, weight: Weight) -> (RadianceMap, Merged) {
        let options = MergeOptions { weight, region: alignment.overlap };
        merge(bracket, alignment, &ResponseCurve::srgb(), &options, None).unwrap()
    }

    /// Twelve stops from left to right.
    fn ramp(x: usize, _: usize) -> [f64; 3] {
        [libm::exp2(x as f64 / 20.0 - 9.0); 3]
    }

    #[test]
    fn the_radiance_is_that_of_the_scene_and_seams_are_nowhere() {
        let (bracket, alignment) = still((240, 70), &[0.125, 1.0, 8.0], ramp);
        for weight in [Weight::Hat, Weight::Gaussian, Weight::Plateau] {
            let (map, report) = run(&bracket, &alignment, weight);
            let scale = f64::from(ResponseCurve::srgb().exposure(0, 255.0));
            for x in 0..240 {
                let (found, truth) = (f64::from(map.pixels.at(x, 69)[1]) / scale, ramp(x, 0)[1]);
                // Above 8 the shortest exposure clips, below 0.001 the longest has fewer than 20 codes: half of one is 5 %.
                if (0.001..7.5).contains(&truth) {
                    assert!((found / truth - 1.0).abs() < 0.05, "{weight:?} {x}: {found} for {truth}");
                }
            }
            // It rises over decided and weighted regions alike: to within the rounding of codes.
            assert!((1..240).all(|x| map.pixels.at(x, 0)[0] >= 0.97 * map.pixels.at(x - 1, 0)[0]), "{weight:?}");
            assert_eq!((report.all_clipped, report.all_black), (0, 0));
        }
    }

    #[test]
    fn what_all_frames_clip_is_bright_and_grey_and_what_none_sees_is_dark() {
        let (bracket, alignment) = still((8, 3), &[1.0, 4.0], |x, _| if x < 4 { [90.0, 80.0, 70.0] } else { [0.0; 3] });
        let (map, report) = run(&bracket, &alignment, Weight::Hat);
        assert_eq!((report.all_clipped, report.all_black), (12, 12));
        let (bright, dark) = (map.pixels.at(0, 0), map.pixels.at(7, 0));
        let curve = ResponseCurve::srgb();
        // The reference is the longer: the shorter frame's 255 means four times as much. LEAST lets the other in by 1e-4.
        assert!((bright[0] / (4.0 * curve.exposure(0, 255.0)) - 1.0).abs() < 1e-3);
        assert!(bright[0] == bright[1] && bright[1] == bright[2] && dark[0] > 0.0);
        assert!((dark[0] / curve.exposure(0, 0.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn ghosts_of_another_region_or_of_other_frames_are_refused() {
        let (bracket, alignment) = still((64, 48), &[0.5, 1.0, 2.0], |x, y| [0.05 + 0.003 * (x + y) as f64; 3]);
        let curve = ResponseCurve::srgb();
        let region = Rect { x0: 8, y0: 0, x1: 40, y1: 48 };
        let ghosts = deghost::find(&bracket, &alignment, &curve, region, deghost::AUTO, None).unwrap();
        let merged = |alignment: &Alignment, region| {
            merge(&bracket, alignment, &curve, &MergeOptions { weight: Weight::Hat, region }, Some(&ghosts))
        };
        assert!(merged(&alignment, region).is_ok());
        let moved = Rect { x0: 9, x1: 41, ..region };
        let refused = merged(&alignment, moved).unwrap_err().to_string();
        assert!(refused.contains("--deghost") && refused.contains("columns 8..40"), "{refused}");
        let mut fewer = alignment.clone();
        fewer.verdicts[0].status = Status::Rejected;
        fewer.verdicts[0].warp = None;
        assert!(merged(&fewer, region).is_err_and(|e| e.to_string().contains("other frames")));
    }

    #[test]
    fn moved_frames_and_rejected_ones() {
        let (bracket, mut alignment) = still((40, 30), &[0.5, 1.0, 2.0], |x, y| [0.05 + 0.003 * (x + y) as f64; 3]);
        let (exact, _) = run(&bracket, &alignment, Weight::Hat);
        // Moved by nothing: the interpolated tables must give what the exact ones do.
        alignment.verdicts[0].warp = Some(Warp::Rigid { dx: 0.0, dy: 0.0, angle: 0.0 });
        let (moved, _) = run(&bracket, &alignment, Weight::Hat);
        for (a, b) in exact.pixels.as_slice().iter().zip(moved.pixels.as_slice()) {
            assert!((a[0] / b[0] - 1.0).abs() < 1e-4);
        }
        // Moved out of the picture, it is as if it were rejected.
        alignment.verdicts[0].warp = Some(Warp::Rigid { dx: 1000.0, dy: 0.0, angle: 0.0 });
        let (outside, _) = run(&bracket, &alignment, Weight::Hat);
        alignment.verdicts[0].warp = None;
        let (rejected, report) = run(&bracket, &alignment, Weight::Hat);
        assert_eq!((outside.pixels, report.frames), (rejected.pixels, 2));
    }

    #[test]
    fn the_same_bytes_on_any_number_of_threads_and_a_region_is_a_part() {
        let (bracket, alignment) = still((50, 200), &[0.5, 2.0], |x, y| [0.01 * x as f64, 0.004 * y as f64, 0.1]);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(&bracket, &alignment, Weight::Gaussian))
        };
        let whole = on(1);
        assert_eq!(whole, on(3));
        let region = Rect { x0: 7, y0: 70, x1: 31, y1: 190 };
        let options = MergeOptions { weight: Weight::Gaussian, region };
        let (part, _) = merge(&bracket, &alignment, &ResponseCurve::srgb(), &options, None).unwrap();
        assert!((0..120).all(|y| part.pixels.row(y) == &whole.0.pixels.row(y + 70)[7..31]));
        let options = MergeOptions { region: Rect { x1: 51, ..region }, ..options };
        assert!(merge(&bracket, &alignment, &ResponseCurve::srgb(), &options, None).is_err());
    }
}
