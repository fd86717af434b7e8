//! Local gain: compensation for the local tone mapping of phones.
//!
//! In: a bracket of locally processed frames, its alignment and response. Out: [`LocalGain`], factors by which the
//! radiance of each pixel of each frame is multiplied to obtain the radiance of the scene. Cost: about 20 ns per pixel
//! and frame to average the frames over cells, plus a logarithm and an exponential for each pixel of each frame;
//! nothing if frames are not locally processed. Source: the inverse of a two-scale tone mapping (Durand & Dorsey 2002)
//! with a curve that is recovered from the exposures (`base`).
//!
//! 1. Every frame is averaged to exposure over at most 256 cells along the longer side, and its base, which is the
//!    logarithm of brightness without details, is computed.
//! 2. Without tone mapping, the bases of two frames at the same cell would differ by the difference of their exposures.
//!    The curve with which the phone compressed the bases is fitted to the differences that are found.
//! 3. The curve gives the scene's base for each value of a frame's base. Each pixel is brightened by the scene's base
//!    minus the frame's base, in stops. Details keep the camera's contrast; structures that are larger than a
//!    neighbourhood, and edges of several stops, get their original contrast. This is done before merging, so that
//!    frames that were brightened differently at the same place agree.

mod base;

use super::deghost::cells::{self, Cell};
use super::deghost::layers;
use super::layer::{COLUMNS, Layer, Meaning, Row};
use crate::align::{Alignment, Rect};
use crate::bracket::Bracket;
use crate::error::{Error, Result};
use crate::merge::{FLOOR, Photographed};
use crate::plane::Plane;
use crate::pyramid::cells::{Mix, row_between_cells};
use crate::response::ResponseCurve;
use crate::response::local::Evidence;
use crate::simd::{Loops, at_least, log2, vectorised};
use base::{BaseCurve, Pair, coefficients, mapped};
use serde::Serialize;
use std::ops::Range;
use std::path::Path;

/// Largest number of cells along the longer side.
const CELLS: usize = 256;
/// Weights of R, G and B in the luminance (Rec. 709) that determines the gain, which is the same for all channels.
const LUMINANCE: [f32; 3] = crate::merge::radiance::statistics::BT709;
/// A phone brightens short exposures, so the pixels of two frames differ by only a fraction of their exposure step.
/// This constant is the largest median of this fraction that phones are assumed to have. If the median measured with
/// the sRGB curve is larger than this constant, the sRGB curve has too many stops between two code values, and they are
/// divided (see [`power`]). Measured with truth.py: of 26 phone brackets with a curve close to sRGB's, 23 have a
/// fraction of 0.46 to 0.58.
const MOST_FRACTION: f64 = 0.6;

/// Factors for the radiance of each frame over a region of the reference frame.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalGain {
    region: Rect,
    /// Side of a cell in pixels: a power of 2.
    side: usize,
    /// The merged frames by rising exposure.
    frames: Vec<Processed>,
    /// Index of the reference frame in `frames`.
    reference: usize,
    curve: BaseCurve,
}

/// A frame that is locally processed.
#[derive(Debug, Clone, PartialEq)]
struct Processed {
    path: String,
    /// The coefficients a and b of each cell: the base is a x + b, where x is log2 of a pixel's radiance.
    base: Plane<[f32; 2]>,
    /// For each cell the scene's base minus the frame's base, in stops, and whether the content of the cell is known.
    lacks: Plane<(f32, bool)>,
}

/// The section of the report on local processing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LocalReport {
    /// Whether the frames were tone-mapped locally, so that they were merged with a local gain.
    pub locally_processed: bool,
    /// Median, over the picture, of the difference of two frames divided by their exposure step.
    pub exposure_step_fraction: f64,
    /// Standard deviation over the picture, in stops, of the ratio of two frames at the same code value.
    pub variation_stops: f64,
    /// Mean expansion of structures that are larger than a neighbourhood, in stops of the result per stop of the
    /// frames; 1 without expansion.
    pub expansion: f64,
    /// The frames except the reference, by rising exposure; empty if frames are not locally processed.
    pub frames: Vec<LocalFrame>,
}

/// The gain of one frame divided by the gain of the reference. The difference of their exposures is not included.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LocalFrame {
    /// Path of the file, as given.
    pub path: String,
    /// Smallest and largest gain, in stops, over the cells that are known in both the frame and the reference. Both are
    /// 0 if there are none.
    pub gain_stops: (f64, f64),
}

/// Returns the response used for locally processed frames: that of sRGB, with fewer stops between the code values if
/// `evidence` shows that sRGB has too many. A response fitted to the frames would contain their compression.
pub fn curve(evidence: &Evidence) -> ResponseCurve {
    let srgb = ResponseCurve::srgb();
    let power = power(evidence);
    ResponseCurve::new(std::array::from_fn(|c| srgb.ln_exposure(c).map(|g| g / power))).unwrap_or(srgb)
}

/// Returns the number, 1 or more, by which the stops between the code values of sRGB are divided. It is the smallest
/// number with which two conditions hold: two frames differ by at most their exposure step at every brightness level,
/// and their median difference is at most [`MOST_FRACTION`] of the step.
fn power(evidence: &Evidence) -> f64 {
    evidence.most_step_fraction.max(evidence.step_fraction / MOST_FRACTION).max(1.0)
}

impl LocalReport {
    /// Returns the report, with the `gain` used if the frames are locally processed.
    pub fn of(evidence: &Evidence, gain: Option<&LocalGain>) -> Self {
        LocalReport {
            locally_processed: evidence.is_local,
            exposure_step_fraction: evidence.step_fraction,
            variation_stops: evidence.variation_stops,
            expansion: gain.map_or(1.0, |gain| gain.curve.slope()),
            frames: gain.map_or_else(Vec::new, LocalGain::report),
        }
    }

    /// Returns the smallest and the largest gain of all frames, in stops, or `None` without gain.
    pub fn range_stops(&self) -> Option<(f64, f64)> {
        let ranges = self.frames.iter().map(|frame| frame.gain_stops);
        ranges.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }
}

/// Returns the side of a cell: the smallest power of 2, at least 2, with which the longer side of `region` has at most
/// `most` cells.
fn side(region: Rect, most: usize) -> usize {
    let longer = region.width().max(region.height());
    std::iter::successors(Some(2), |side| Some(2 * side)).find(|side| longer.div_ceil(*side) <= most).unwrap_or(2)
}

/// Whether the content of a cell is known. It is unknown if a channel is clipped, because a phone leaves clipped pixels
/// white, or if all channels are black.
fn is_known(cell: &Cell) -> bool {
    !(cell.is_outside() || cell.clips() || (0..3).all(|c| cell.is_black(c)))
}

impl LocalGain {
    /// Computes the gains of the merged frames of `bracket` over `region`, with response `curve`.
    ///
    /// # Errors
    /// [`Error::Scratch`].
    pub fn find(bracket: &Bracket, alignment: &Alignment, curve: &ResponseCurve, region: Rect) -> Result<Self> {
        let (layers, reference) = layers(bracket, alignment, curve);
        let side = side(region, CELLS);
        let unit = bracket.reference().exposure.relative();
        let mut seen = Vec::with_capacity(layers.len());
        for (i, layer) in layers.iter().enumerate() {
            let time = libm::log2(layer.frame.exposure.relative() / unit) as f32;
            let cells = cells::average(layer, region, side, i as u16)?;
            let stops = mapped(&cells, |cell| {
                let luminance: f32 = (0..3).map(|c| LUMINANCE[c] * cell.radiance[c]).sum();
                (!cell.is_outside()).then(|| libm::log2f(luminance.max(FLOOR)) + time)
            });
            let base = coefficients(&stops);
            let bases = Plane::from_rows(cells.width(), cells.height(), |y, row: &mut [(f32, bool)]| {
                for (x, v) in row.iter_mut().enumerate() {
                    let [a, b] = base.at(x, y);
                    *v = (a * stops.at(x, y).unwrap_or(0.0) + b, is_known(&cells.at(x, y)));
                }
            });
            seen.push((time, base, bases));
        }
        let mut pairs = Vec::new();
        for (i, (time, _, bases)) in seen.iter().enumerate() {
            for (longer, _, others) in &seen[i + 1..] {
                let both = bases.as_slice().iter().zip(others.as_slice()).filter(|(a, b)| a.1 && b.1);
                pairs.extend(both.map(|(a, b)| Pair { bases: (a.0, b.0), stops: longer - time }));
            }
        }
        let curve = BaseCurve::of(&pairs);
        let mut frames = Vec::with_capacity(seen.len());
        for ((time, base, bases), layer) in seen.into_iter().zip(&layers) {
            frames.push(Processed {
                path: layer.frame.path().to_string_lossy().into_owned(),
                base: mapped(&base, |[a, b]| [*a, b + a * time]),
                lacks: mapped(&bases, |(base, is_known)| (curve.at(*base), *is_known)),
            });
        }
        Ok(LocalGain { region, side, frames, reference, curve })
    }

    /// Checks that the gains are for this region and these merged frames by rising exposure.
    ///
    /// # Errors
    /// [`Error::Option`] with the difference.
    pub(super) fn check(&self, region: Rect, frames: &[&Path]) -> Result<()> {
        let is_of = |(own, frame): (&Processed, &&Path)| own.path == frame.to_string_lossy();
        if self.region == region && self.frames.len() == frames.len() && self.frames.iter().zip(frames).all(is_of) {
            return Ok(());
        }
        let reason = "the local gain (an argument of this function) is for other frames or another region; find it again for this merge";
        Err(Error::Option { option: "--crop", reason: reason.to_owned() })
    }

    /// Returns the factors of the pixels of `rows` of the region, row by row, for pixels as bright as their cell.
    /// `layer` is the frame's index among the merged frames by rising exposure.
    pub fn at(&self, layer: usize, rows: Range<usize>) -> Vec<f32> {
        let Some(frame) = self.frames.get(layer) else { return Vec::new() };
        let mut factors = self.rows(&frame.lacks, |(lacks, _)| lacks, rows);
        factors.iter_mut().for_each(|v| *v = libm::exp2f(*v));
        factors
    }

    /// Like [`at`](LocalGain::at), but divided by the factors of the reference; empty for the reference.
    pub fn against_reference(&self, layer: usize, rows: Range<usize>) -> Vec<f32> {
        if layer == self.reference {
            return Vec::new();
        }
        let mut factors = self.at(layer, rows.clone());
        factors.iter_mut().zip(self.at(self.reference, rows)).for_each(|(v, reference)| *v /= reference);
        factors
    }

    /// Returns the base of frame `layer` as a function of the logarithm of a pixel's radiance (see
    /// [`Processed::base`]), at the pixels of `rows` of the region, row by row.
    pub(super) fn base(&self, layer: usize, rows: Range<usize>) -> Vec<[f32; 2]> {
        self.frames.get(layer).map_or_else(Vec::new, |frame| self.rows(&frame.base, |v| v, rows))
    }

    /// Interpolates the values `of(cell)` at the pixels of `rows` of the region.
    fn rows<S: Copy, T: Mix + Default>(&self, cells: &Plane<S>, of: fn(S) -> T, rows: Range<usize>) -> Vec<T> {
        let width = self.region.width();
        let mut values = vec![T::default(); rows.len() * width];
        for (y, row) in rows.zip(values.chunks_exact_mut(width)) {
            row_between_cells(cells, self.side, of, y, row);
        }
        values
    }

    /// Writes the factors of the radiance of a row of a tile of `layer` into `factors`; `base` is the frame's
    /// [`base`](LocalGain::base) there.
    pub(super) fn multiply(&self, layer: &Layer, row: &Row, base: &[[f32; 2]], factors: &mut [f32]) {
        vectorised(Factors { layer, row, base, curve: &self.curve, factors });
    }

    /// Adjusts the range of the photographs to the expanded radiance. The local gain brightens the highlights of the
    /// shortest frame by the value of the curve at white. So `shortest` is multiplied by the same factor.
    pub fn photographed(&self, photographed: Photographed) -> Photographed {
        let lacks = self.curve.at(photographed.white_stops as f32);
        Photographed { shortest: photographed.shortest * libm::exp2(f64::from(lacks)), ..photographed }
    }

    /// Returns the range of the gain of each frame except the reference, by rising exposure. Only cells that are known
    /// in both the frame and the reference are used.
    fn report(&self) -> Vec<LocalFrame> {
        let Some(reference) = self.frames.get(self.reference) else { return Vec::new() };
        let of = |frame: &Processed| {
            let both = frame.lacks.as_slice().iter().zip(reference.lacks.as_slice()).filter(|(a, b)| a.1 && b.1);
            let all = both.map(|(a, b)| f64::from(a.0 - b.0));
            let range = all.fold(None, |range: Option<(f64, f64)>, v| {
                range.map_or(Some((v, v)), |(least, most)| Some((least.min(v), most.max(v))))
            });
            LocalFrame { path: frame.path.clone(), gain_stops: range.unwrap_or((0.0, 0.0)) }
        };
        let others = self.frames.iter().enumerate().filter(|(i, _)| *i != self.reference);
        others.map(|(_, frame)| of(frame)).collect()
    }
}

/// Computes the factors of a row of a tile.
struct Factors<'a, 'b> {
    layer: &'a Layer<'b>,
    row: &'a Row<'a>,
    base: &'a [[f32; 2]],
    curve: &'a BaseCurve,
    factors: &'a mut [f32],
}

impl Loops for Factors<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let (mut luminance, mut meanings) = ([0.0f32; COLUMNS], [Meaning::default(); COLUMNS]);
        for c in 0..3 {
            self.layer.look_up(c, self.row.codes[c], &mut meanings);
            for x in 0..COLUMNS {
                luminance[x] += LUMINANCE[c] * meanings[x][0];
            }
        }
        for ((factor, [a, b]), luminance) in self.factors.iter_mut().zip(self.base).zip(luminance) {
            *factor = libm::exp2f(self.curve.at(a * log2(at_least(luminance, FLOOR)) + b));
        }
    }
}

#[cfg(test)]
mod tests;
