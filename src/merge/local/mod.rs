//! Local gain: frames that a phone tone-mapped locally, made comparable.
//!
//! In: a bracket whose frames are locally processed, where they lie, and what their codes mean. Out: [`LocalGain`], by which the radiance of each
//! frame is multiplied, place by place, so that it is the reference's; and an [`Expansion`](expansion::Expansion) of the merged radiance. Cost: that
//! of averaging the frames over cells, some 20 ns a pixel and frame, and of a logarithm and an exponential for each pixel; nothing where frames
//! are not locally processed. Source: the idea that ratios of frames give the local gain is that of hdrgen's and Photomatix' alignment of
//! exposures, taken place by place; the expansion is the inverse of a two-scale tone mapping (Durand & Dorsey 2002) by a guided filter.
//!
//! 1. Every frame is averaged to radiance over cells, 256 along the longer side.
//! 2. From the reference towards the shorter and towards the longer exposures, the ratio of the standard to the frame is averaged over larger and
//!    larger neighbourhoods: where there is nothing to compare, the larger ones decide. The standard is the reference; where that clips or is
//!    black, it is the nearest frame that does not, times its gain. What clips tells no bound: a phone leaves it white, whatever it does around it.
//! 3. What is merged is the reference's rendering, continued where the reference shows nothing. Its details have the camera's contrast, but what is
//!    larger than a neighbourhood was compressed by the phone, as the exposure steps were: that is taken back.

pub mod expansion;
mod smooth;

use super::deghost::cells::{self, Cell};
use super::deghost::{Layer, layers};
use crate::align::{Alignment, Rect};
use crate::bracket::Bracket;
use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::pyramid::cells::row_between_cells;
use crate::response::ResponseCurve;
use crate::response::local::Evidence;
use serde::Serialize;
use smooth::Difference;
use std::ops::Range;
use std::path::Path;

/// Cells along the longer side, at most, that are compared.
const CELLS: usize = 256;
/// Cells on a side of one of the map's.
const COARSER: usize = 4;
/// The least relative standard deviation of a cell: alignment and the curve are not known better. As in deghosting.
const LEAST: f32 = 0.06;
/// Rec. 709 luminance: the gain is one for all channels.
const LUMINANCE: [f32; 3] = super::statistics::BT709;
/// The least share of an exposure step that is taken back wholly: less would make noise of nothing.
const LEAST_FRACTION: f64 = 0.4;
/// The greatest share of an exposure step that frames are taken to keep; what they seem to keep beyond is the steepness of the curve. Of 26 brackets of phones
/// whose curve is about sRGB's (truth.py) all but three keep 0.46 to 0.58.
const MOST_FRACTION: f64 = 0.6;

/// By what the radiance of each frame is multiplied over a region of the reference.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalGain {
    region: Rect,
    /// Of a cell of the maps, in pixels: a power of 2.
    side: usize,
    /// One for each placed frame by rising exposure: its path, and for each cell the factor; none for the reference.
    frames: Vec<(String, Option<Plane<f32>>)>,
}

/// What was found of local processing, for the report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LocalReport {
    /// Whether the frames were tone-mapped locally, so that they were merged with a local gain.
    pub locally_processed: bool,
    /// The median share of an exposure step by which the frames differ.
    pub exposure_step_fraction: f64,
    /// Standard deviation over the picture of the ratio of two frames at the same code.
    pub variation_stops: f64,
    /// By how many stops a stop of the merged frames was expanded where it is larger than a neighbourhood; 1 where nothing was.
    pub expansion: f64,
    /// The frames but the reference, by rising exposure; none where they are not locally processed.
    pub frames: Vec<LocalFrame>,
}

/// The gain of one frame against the reference, beyond what the exposures explain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LocalFrame {
    /// The file, as it was named.
    pub path: String,
    /// The least and the greatest over the result, in stops.
    pub gain_stops: (f64, f64),
}

/// The curve by which codes of locally processed frames are read: that of sRGB, of which `evidence` may show that it is too steep. The curve that fits the
/// frames is not the camera's: it has what was compressed in it.
pub fn curve(evidence: &Evidence) -> ResponseCurve {
    let srgb = ResponseCurve::srgb();
    let power = power(evidence);
    ResponseCurve::new(std::array::from_fn(|c| srgb.ln_exposure(c).map(|g| g / power))).unwrap_or(srgb)
}

/// How many times as steep as the camera's the sRGB curve is at the least: no place may be brightened by more than the exposures were, and no phone keeps more
/// than [`MOST_FRACTION`] of a step.
fn power(evidence: &Evidence) -> f64 {
    evidence.most_step_fraction.max(evidence.step_fraction / MOST_FRACTION).max(1.0)
}

/// By how many stops a stop of what is larger than a neighbourhood is to be expanded.
pub fn expansion(evidence: &Evidence) -> f64 {
    1.0 / (evidence.step_fraction / power(evidence)).clamp(LEAST_FRACTION, 1.0)
}

impl LocalReport {
    /// The report of what was found, with the `gain` that was merged with where the frames are locally processed.
    pub fn of(evidence: &Evidence, gain: Option<&LocalGain>) -> Self {
        LocalReport {
            locally_processed: evidence.is_local,
            exposure_step_fraction: evidence.step_fraction,
            variation_stops: evidence.variation_stops,
            expansion: if evidence.is_local { expansion(evidence) } else { 1.0 },
            frames: gain.map_or_else(Vec::new, LocalGain::report),
        }
    }

    /// The least and the greatest gain of all frames, in stops; none where there is no gain.
    pub fn range_stops(&self) -> Option<(f64, f64)> {
        let ranges = self.frames.iter().map(|frame| frame.gain_stops);
        ranges.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }
}

/// The smallest power of 2 from 2 on of which no more than `most` lie on the longer side of `region`.
fn side(region: Rect, most: usize) -> usize {
    let longer = region.width().max(region.height());
    std::iter::successors(Some(2), |side| Some(2 * side)).find(|side| longer.div_ceil(*side) <= most).unwrap_or(2)
}

/// The luminance of a cell, as a frame shows it: its logarithm, and the variance of that; infinite where it shows nothing.
#[derive(Debug, Clone, Copy, Default)]
struct Shown {
    stops: f32,
    variance: f32,
}

impl Shown {
    fn of(cell: &Cell, meanings: &[&cells::Meaning]) -> Shown {
        let luminance: f32 = (0..3).map(|c| LUMINANCE[c] * cell.radiance[c]).sum();
        if cell.is_outside() || cell.clips() || (0..3).all(|c| cell.is_black(c)) || luminance <= 0.0 {
            return Shown { stops: 0.0, variance: f32::INFINITY };
        }
        let noise = cell.relative_noise(1, meanings);
        // A share of the radiance is so many nepers.
        let square = std::f32::consts::LOG2_E * std::f32::consts::LOG2_E;
        Shown { stops: libm::log2f(luminance), variance: square * (LEAST * LEAST + noise * noise) }
    }
}

impl LocalGain {
    /// The gains of the placed frames of `bracket` over `region`, whose codes mean what `curve` says.
    ///
    /// # Errors
    /// [`Error::Scratch`].
    pub fn find(bracket: &Bracket, alignment: &Alignment, curve: &ResponseCurve, region: Rect) -> Result<Self> {
        let (layers, reference) = layers(bracket, alignment, curve);
        let fine = side(region, CELLS);
        let meanings: Vec<&cells::Meaning> = layers.iter().map(|layer| &layer.meaning).collect();
        let shown = |i: usize| -> Result<Plane<Shown>> {
            let cells = cells::average(&layers[i], region, fine, i as u16)?;
            Ok(Plane::from_rows(cells.width(), cells.height(), |y, row| {
                row.iter_mut().zip(cells.row(y)).for_each(|(shown, cell)| *shown = Shown::of(cell, &meanings));
            }))
        };
        let name = |layer: &Layer| (layer.frame.path().to_string_lossy().into_owned(), None);
        let mut frames: Vec<(String, Option<Plane<f32>>)> = layers.iter().map(name).collect();
        let of_reference = shown(reference)?;
        for outwards in [(0..reference).rev().collect::<Vec<_>>(), (reference + 1..layers.len()).collect()] {
            let mut standard = of_reference.clone();
            for i in outwards {
                let frame = shown(i)?;
                let differences = Plane::from_rows(frame.width(), frame.height(), |y, row| {
                    for ((d, s), f) in row.iter_mut().zip(standard.row(y)).zip(frame.row(y)) {
                        *d = Difference { stops: s.stops - f.stops, weight: LEAST * LEAST / (s.variance + f.variance) };
                    }
                });
                let gain = smooth::smoothed(&differences, COARSER);
                standard.fill_rows(|y, row| {
                    let mut gains = vec![0.0f32; row.len()];
                    row_between_cells(&gain, COARSER, |v| v, y, &mut gains);
                    for ((s, f), gain) in row.iter_mut().zip(frame.row(y)).zip(gains) {
                        if s.variance.is_infinite() && f.variance.is_finite() {
                            *s = Shown { stops: f.stops + gain, variance: f.variance };
                        }
                    }
                });
                let mut factors = gain;
                factors.fill_rows(|_, row| row.iter_mut().for_each(|v| *v = libm::exp2f(*v)));
                frames[i].1 = Some(factors);
            }
        }
        Ok(LocalGain { region, side: fine * COARSER, frames })
    }

    /// Whether they are of this region and of these placed frames by rising exposure.
    ///
    /// # Errors
    /// [`Error::Option`] with what they are of.
    pub(super) fn check(&self, region: Rect, frames: &[&Path]) -> Result<()> {
        let is_of = |((path, _), frame): (&(String, _), &&Path)| *path == frame.to_string_lossy();
        if self.region == region && self.frames.len() == frames.len() && self.frames.iter().zip(frames).all(is_of) {
            return Ok(());
        }
        let reason = "its local gain was found in other frames or another region; find it in those that are merged";
        Err(Error::Option { option: "--crop", reason: reason.to_owned() })
    }

    /// The factors of frame `layer` (of the placed frames, by rising exposure) at `rows` of the region, by rows; nothing where they are 1.
    pub fn at(&self, layer: usize, rows: Range<usize>) -> Vec<f32> {
        let Some((_, Some(map))) = self.frames.get(layer) else { return Vec::new() };
        let width = self.region.width();
        let mut factors = vec![0.0f32; rows.len() * width];
        for (y, row) in rows.zip(factors.chunks_exact_mut(width)) {
            row_between_cells(map, self.side, |v| v, y, row);
        }
        factors
    }

    /// The range of the gain of each frame but the reference, by rising exposure.
    fn report(&self) -> Vec<LocalFrame> {
        let of = |(path, map): &(String, Option<Plane<f32>>)| {
            let factors = map.as_ref()?.as_slice();
            let (least, most) = factors.iter().fold((f32::MAX, 0.0f32), |(a, b), &v| (a.min(v), b.max(v)));
            let stops = |v: f32| libm::log2(f64::from(v));
            Some(LocalFrame { path: path.clone(), gain_stops: (stops(least), stops(most)) })
        };
        self.frames.iter().filter_map(of).collect()
    }
}

#[cfg(test)]
mod tests;
