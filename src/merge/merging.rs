//! Merges a bracket slab by slab, each slab tile by tile, and each tile row by row. A row is merged from all frames
//! before the next row begins.
//!
//! In: a bracket, its alignment, the response, and the motion masks. Out: [`Slab`]s of radiance, which together are the
//! [`RadianceMap`]. Cost and equation are at the head of [`merge`](super).

use super::allowed::Allowed;
use super::deghost::Ghosts;
use super::fill::{FilledRow, Filling};
use super::layer::{COLUMNS, Fill, Layer, ROWS, Taken, Tile, layers};
use super::local::LocalGain;
use super::mean::{Bounds, Means};
use super::rows::MergedRow;
use super::{MergeOptions, Merged, RadianceMap};
use crate::align::{Alignment, Rect};
use crate::bracket::{Bracket, MergedMosaic};
use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::response::ResponseCurve;
use crate::simd::vectorised;
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Rows of a mosaic that are merged at a time: few enough to take little memory, and many beside the rows above and
/// below that are merged too.
const STRIP: usize = 256;

/// A prepared merge, to be computed at once or slab by slab.
pub struct Merging<'a> {
    bracket: &'a Bracket,
    pub(super) region: Rect,
    pub(super) layers: Vec<Layer<'a>>,
    /// Index in the bracket of the frame of each layer.
    pub(super) frames: Vec<usize>,
    ghosts: Option<&'a Ghosts>,
    /// What the reference allows, if ghosts are removed.
    allowed: Option<Allowed>,
    local: Option<&'a LocalGain>,
    /// The mosaic of the merged radiance, if nothing moved between raw frames.
    mosaic: Option<MergedMosaic>,
}

/// A slab: consecutive rows of the result.
#[derive(Debug, Clone, PartialEq)]
pub struct Slab {
    /// The radiance.
    pub map: RadianceMap,
    /// See [`Merged::all_clipped`].
    pub all_clipped: usize,
    /// See [`Merged::all_black`].
    pub all_black: usize,
}

impl<'a> Merging<'a> {
    /// Prepares the merge of `options.region`.
    ///
    /// Rejected frames are not merged. Weights are multiplied by the motion masks `ghosts`, which must be of the same
    /// region and alignment. Where a mask keeps less than half of a frame, that frame does not decide whether a pixel
    /// is clipped or black.
    ///
    /// # Errors
    /// [`Error::Option`] if the region is empty or not within the reference frame, no frame was aligned, or `ghosts`
    /// are of another region or other frames; [`Error::Scratch`].
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
                    "columns {x0}..{x1} and rows {y0}..{y1} are not within the {}x{} pixels of the reference frame",
                    bracket.width(),
                    bracket.height()
                ),
            });
        }
        let layers = layers(bracket, alignment, curve, options.weight)?;
        if layers.is_empty() {
            return Err(Error::Option {
                option: "--align",
                reason: "no frame was aligned; give --align none if the camera was on a tripod".to_owned(),
            });
        }
        let frames: Vec<usize> = alignment.placed(bracket).map(|(i, _, _)| i).collect();
        let merging = Merging { bracket, region, layers, frames, ghosts, allowed: None, local: None, mosaic: None };
        let merging = Merging { mosaic: merging.mosaic(curve), ..merging };
        let Some(ghosts) = ghosts else { return Ok(merging) };
        ghosts.check(region, &merging.paths())?;
        // If nothing moved, neither the camera nor the scene, the mean is better than the reference alone.
        let is_still = |(i, layer): (usize, &Layer)| layer.is_still() && ghosts.is_whole(i);
        let reference = merging.frames.iter().position(|&i| i == bracket.reference_index());
        let allowed = match reference {
            Some(i) if !merging.layers.iter().enumerate().all(is_still) => {
                Some(Allowed::measure(&merging, i, curve, ghosts.tolerance())?)
            }
            _ => None,
        };
        Ok(Merging { allowed, ..merging })
    }

    /// The mosaic of the merged radiance; none if a frame moved, or has no such colour filters.
    fn mosaic(&self, curve: &ResponseCurve) -> Option<MergedMosaic> {
        let frames = || self.frames.iter().map(|&i| &self.bracket.frames()[i]);
        let raw = self.bracket.reference().raw.as_ref();
        let pattern = raw?.pattern.as_ref()?;
        let is_measured = |layer: &Layer| layer.is_still() && layer.fill.is_none();
        if !(self.layers.iter().all(is_measured) && frames().all(|frame| frame.raw.as_ref() == raw)) {
            return None;
        }
        let (x0, y0) = (self.region.x0, self.region.y0);
        let times = || frames().map(|frame| frame.exposure.relative() / self.bracket.reference().exposure.relative());
        let (shortest, longest) = (times().next()? as f32, times().next_back()? as f32);
        let exposure = |code: f32| (0..3).map(move |c| curve.exposure(c, code));
        let white = exposure(255.0).fold(0.0, f32::max) / shortest;
        let black = exposure(0.0).fold(f32::INFINITY, f32::min) / longest;
        let pattern = pattern.seen(|x, y| (x0 + x, y0 + y));
        Some(MergedMosaic::new(pattern, [black, white], longest / shortest))
    }

    /// Adds the gains of locally processed frames; the gains must be of the same region and alignment.
    ///
    /// # Errors
    /// [`Error::Option`] if the gain is of another region or other frames.
    pub fn with_local_gain(self, local: Option<&'a LocalGain>) -> Result<Self> {
        local.map_or(Ok(()), |local| local.check(self.region, &self.paths()))?;
        let mut merging = Merging { local, ..self };
        if local.is_some() {
            // The reference is locally processed too, so its code values stand for other radiances.
            merging.allowed = None;
            merging.layers.iter_mut().for_each(Layer::weigh_as_local);
        }
        Ok(merging)
    }

    /// Returns the paths of the merged frames, by rising exposure.
    fn paths(&self) -> Vec<&'a Path> {
        self.frames.iter().map(|&i| self.bracket.frames()[i].path()).collect()
    }

    /// Returns what the frames with assumed transforms fill: clipped pixels, black pixels, both or none.
    pub(super) fn fills(&self) -> Vec<Fill> {
        let is_asked = |fill: &Fill| self.layers.iter().any(|layer| layer.fill == Some(*fill));
        [Fill::Clipped, Fill::Black].into_iter().filter(is_asked).collect()
    }

    /// Returns the factors, 0..=1, by which the motion mask multiplies the weights of layer `i`, one for each pixel in
    /// `rows` of the region; empty if all factors are 1. The motion mask is not applied to a frame with an assumed
    /// transform.
    pub(super) fn kept(&self, i: usize, rows: Range<usize>) -> Vec<f32> {
        let ghosts = self.ghosts.filter(|_| self.layers[i].fill.is_none());
        ghosts.map_or_else(Vec::new, |ghosts| ghosts.kept(i, rows))
    }

    /// Returns the [base](LocalGain::base) of layer `i` at `rows` of the region; empty if frames are not locally
    /// processed.
    pub(super) fn base(&self, i: usize, rows: Range<usize>) -> Vec<[f32; 2]> {
        self.local.map_or_else(Vec::new, |local| local.base(i, rows))
    }

    /// Writes to `gain` the factors by which the radiance of each layer is multiplied, at the columns `columns` of the
    /// region. `tiles` contain only these columns; the rows of `bases` and `gain` contain all columns. Does nothing
    /// without a local gain, where the factors are 1.
    pub(super) fn multiply(
        &self,
        tiles: &[Tile],
        bases: &[Vec<[f32; 2]>],
        columns: &Range<usize>,
        gain: &mut [Vec<f32>],
    ) {
        let Some(local) = self.local else { return };
        let width = self.region.width();
        for (((layer, tile), base), gain) in self.layers.iter().zip(tiles).zip(bases).zip(gain) {
            for (y, (base, gain)) in base.chunks_exact(width).zip(gain.chunks_exact_mut(width)).enumerate() {
                if let Some(row) = tile.row(y) {
                    local.multiply(layer, &row, &base[columns.clone()], &mut gain[columns.clone()]);
                }
            }
        }
    }

    /// Width and height of the result, in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.region.width(), self.region.height())
    }

    /// Returns the statistics of the merge. The argument is the sums of [`Slab::all_clipped`] and [`Slab::all_black`]
    /// over all slabs.
    pub fn merged(&self, (all_clipped, all_black): (usize, usize)) -> Merged {
        let reference_exposure = self.bracket.reference().exposure.relative();
        Merged { frames: self.layers.len(), all_clipped, all_black, reference_exposure }
    }

    /// Merges `rows` of the result. The values do not depend on how the result is divided into slabs.
    ///
    /// # Errors
    /// [`Error::Scratch`] if frames are on disk and cannot be read.
    ///
    /// # Panics
    /// If `rows` are empty or not within the result.
    pub fn slab(&self, rows: Range<usize>) -> Result<Slab> {
        assert!(rows.start < rows.end && rows.end <= self.region.height());
        let Some(mosaic) = &self.mosaic else { return self.pixel_by_pixel(rows.clone(), &rows) };
        let (width, border) = (self.region.width(), MergedMosaic::BORDER);
        let (mut pixels, mut bounds) = (Vec::with_capacity(width * rows.len()), (0, 0));
        for first in rows.clone().step_by(STRIP) {
            let strip = first..(first + STRIP).min(rows.end);
            let wide = first.saturating_sub(border)..(strip.end + border).min(self.region.height());
            let slab = self.pixel_by_pixel(wide.clone(), &strip)?;
            pixels.extend(mosaic.demosaiced(&slab.map.pixels, wide.start, strip));
            bounds = (bounds.0 + slab.all_clipped, bounds.1 + slab.all_black);
        }
        let pixels = Plane::from_vec(width, rows.len(), pixels);
        let map = RadianceMap { pixels, primaries: self.bracket.reference().primaries() };
        Ok(Slab { map, all_clipped: bounds.0, all_black: bounds.1 })
    }

    /// Merges `rows` of the result, each pixel by itself. Pixels whose radiance is only a bound are counted in the rows
    /// `counted`.
    pub(super) fn pixel_by_pixel(&self, rows: Range<usize>, counted: &Range<usize>) -> Result<Slab> {
        let Rect { x0, y0, x1, .. } = self.region;
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
                let bases: Vec<Vec<[f32; 2]>> = (0..self.layers.len()).map(|i| self.base(i, rows.clone())).collect();
                let mut gain: Vec<Vec<f32>> = bases.iter().map(|base| vec![1.0; base.len()]).collect();
                for left in (0..width).step_by(COLUMNS) {
                    let columns = left..(left + COLUMNS).min(width);
                    for ((layer, window), tile) in self.layers.iter().zip(&windows).zip(&mut *tiles) {
                        let columns = x0 + columns.start..x0 + columns.end;
                        tile.read(layer, window, columns, y0 + rows.start..y0 + rows.end);
                    }
                    self.multiply(tiles, &bases, &columns, &mut gain);
                    for (y, line) in out.chunks_exact_mut(width).enumerate() {
                        let part = y * width + columns.start..y * width + columns.end;
                        let taken: Vec<Taken> =
                            kept.iter().zip(&gain).map(|(kept, gain)| Taken::part(kept, gain, part.clone())).collect();
                        let line = &mut line[columns.clone()];
                        let (allowed, layers) = (self.allowed.as_ref(), &self.layers);
                        vectorised(MergedRow { allowed, layers, tiles, taken: &taken, y, means, line });
                        if let Some(filling) = filling {
                            for &fill in &fills {
                                let (layers, taken, known) = (&self.layers, &taken[..], &mut *means);
                                let radiance = &mut *line;
                                vectorised(FilledRow { layers, tiles, taken, y, fill, filling, known, radiance });
                            }
                        }
                        if counted.contains(&(rows.start + y)) {
                            let found = means.bounds(line.len());
                            bounds.clipped += found.clipped;
                            bounds.black += found.black;
                        }
                    }
                }
                if let Some(ghosts) = self.ghosts {
                    ghosts.fill(rows.start, out);
                }
            }
            // A sum of integers does not depend on the order of the threads.
            all_clipped.fetch_add(bounds.clipped, Ordering::Relaxed);
            all_black.fetch_add(bounds.black, Ordering::Relaxed);
        });
        let map = RadianceMap { pixels, primaries: self.bracket.reference().primaries() };
        Ok(Slab { map, all_clipped: all_clipped.into_inner(), all_black: all_black.into_inner() })
    }
}

/// Merges a bracket as one slab; see [`Merging::of`].
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
