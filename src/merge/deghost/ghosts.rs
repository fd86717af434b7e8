//! Motion masks of all frames: for the merge, for `--ghost-mask`, and for the report.
//!
//! In: a factor on the weight for each cell of each frame. Out: the factor at each pixel; for the report, the removed
//! share of each frame and the regions. Cost: a few ns per pixel where something moved.

use super::holes::Holes;
use super::{region, tolerance};
use crate::align::Rect;
use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::pyramid::cells::{between_cells, row_between_cells};
use serde::Serialize;
use std::ops::Range;
use std::path::Path;

/// The motion masks of all frames, over a region of the reference frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Ghosts {
    pub(super) region: Rect,
    pub(super) side: usize,
    pub(super) strength: f64,
    /// For each merged frame, by rising exposure: its path, and for each cell the factor on the weight, 0..=1, times
    /// 255. `None` for the reference frame and for frames with assumed transforms.
    pub(super) frames: Vec<(String, Option<Plane<u8>>)>,
    /// Radiance that is interpolated from the surroundings, where the reference frame is clipped and all shorter frames
    /// are removed.
    pub(super) holes: Option<Holes>,
}

/// The section of the report on motion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GhostReport {
    /// The strength used.
    pub strength: f64,
    /// Share of the cells of the result in which deghosting reduced the weight of at least one frame by more than half.
    pub ghost_fraction: f64,
    /// Share of the cells of the result in which the reference frame is clipped and the shorter frames are removed, so
    /// that radiance is interpolated from the surroundings.
    pub continued_fraction: f64,
    /// The frames that were compared, by rising exposure: all but the reference frame and those with assumed
    /// transforms.
    pub frames: Vec<GhostFrame>,
    /// The largest connected regions in which the weight of at least one frame was reduced by more than half, the
    /// largest first: at most [`MOST_REGIONS`].
    pub regions: Vec<GhostRegion>,
}

/// Largest number of regions in a report.
pub const MOST_REGIONS: usize = 16;

/// A region where something moved.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GhostRegion {
    /// First column, in pixels of the result.
    pub x_px: usize,
    /// First row, in pixels of the result.
    pub y_px: usize,
    /// Number of columns.
    pub width_px: usize,
    /// Number of rows.
    pub height_px: usize,
    /// Share of the result, by cells, that moved in this region.
    pub ghost_fraction: f64,
}

/// The motion in one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GhostFrame {
    /// Path of the file, as given.
    pub path: String,
    /// Share of the cells of the result in which deghosting reduced the weight of the frame by more than half.
    pub ghost_fraction: f64,
}

impl GhostReport {
    /// Returns where the largest region of motion is in a result of `size` pixels, as text like "at the bottom right".
    /// `None` if nothing moved.
    pub fn place(&self, size: (usize, usize)) -> Option<String> {
        let most = self.regions.first()?;
        let (x, y) = (most.x_px + most.width_px / 2, most.y_px + most.height_px / 2);
        let third = |at: usize, size: usize| (3 * at / size.max(1)).min(2);
        let row = ["at the top", "in the middle", "at the bottom"][third(y, size.1)];
        let column = [" left", "", " right"][third(x, size.0)];
        Some(format!("{row}{column}"))
    }
}

impl Ghosts {
    /// Checks that the masks are of `region` and of `frames`, by rising exposure.
    ///
    /// # Errors
    /// [`Error::Option`] if the masks are of another region or of other frames.
    pub(in crate::merge) fn check(&self, region: Rect, frames: &[&Path]) -> Result<()> {
        let refused = |reason| Err(Error::Option { option: "--deghost", reason });
        if self.region != region {
            let Rect { x0, y0, x1, y1 } = self.region;
            return refused(format!(
                "the ghosts (an argument of this function) are for columns {x0}..{x1} and rows {y0}..{y1}; find them again for the region of this merge"
            ));
        }
        let is_of = |((path, _), frame): (&(String, _), &&Path)| *path == frame.to_string_lossy();
        if self.frames.len() != frames.len() || !self.frames.iter().zip(frames).all(is_of) {
            return refused(
                "the ghosts (an argument of this function) are for other frames; find them again for the frames of this merge".to_owned(),
            );
        }
        Ok(())
    }

    /// Returns the weight factors of a frame at the pixels of `rows` of the region, row by row; empty if all factors
    /// are 1. `layer` is the frame's index among the placed frames by rising exposure.
    pub fn kept(&self, layer: usize, rows: Range<usize>) -> Vec<f32> {
        let Some((_, Some(map))) = self.frames.get(layer) else { return Vec::new() };
        let between = |y| between_cells(y, self.side, map.height());
        let (first, last) = (between(rows.start).0, between(rows.end - 1).1);
        if map.rows(first..last + 1).iter().all(|&kept| kept == u8::MAX) {
            return Vec::new();
        }
        let width = self.region.width();
        let mut kept = vec![0.0f32; rows.len() * width];
        for (y, row) in rows.zip(kept.chunks_exact_mut(width)) {
            row_between_cells(map, self.side, |kept| f32::from(kept) / 255.0, y, row);
        }
        kept
    }

    /// Fills the merged `pixels` from their surroundings where the reference frame is clipped and all shorter frames
    /// are removed. `pixels` are whole rows; the first one is row `first` of the region.
    pub(crate) fn fill(&self, first: usize, pixels: &mut [[f32; 3]]) {
        if let Some(holes) = &self.holes {
            for (y, row) in pixels.chunks_exact_mut(self.region.width()).enumerate() {
                holes.fill(self.side, first + y, row);
            }
        }
    }

    /// Returns a mask, at the size of the region, of how much was removed: 0 where all frames are merged, 255 where
    /// only the reference frame is merged, and proportional values in between.
    pub fn mask(&self) -> Plane<u8> {
        let others = self.frames.iter().filter(|(_, map)| map.is_some()).count().max(1) as f32;
        Plane::from_rows(self.region.width(), self.region.height(), |y, row| {
            let mut left_out = vec![0.0f32; row.len()];
            for i in 0..self.frames.len() {
                left_out.iter_mut().zip(self.kept(i, y..y + 1)).for_each(|(sum, kept)| *sum += 1.0 - kept);
            }
            for (v, sum) in row.iter_mut().zip(left_out) {
                *v = (255.0 * sum / others + 0.5) as u8;
            }
        })
    }

    /// Returns the report: how much of each frame was removed, and where.
    pub fn report(&self) -> GhostReport {
        let maps = || self.frames.iter().filter_map(|(path, map)| Some((path, map.as_ref()?.as_slice())));
        // The limit is half of 255, rounded up.
        let is_ghost = |kept: &u8| *kept < 128;
        let cells = maps().next().map_or(0, |(_, map)| map.len());
        let share = |count: usize| count as f64 / cells.max(1) as f64;
        let any: Vec<bool> = (0..cells).map(|i| maps().any(|(_, map)| is_ghost(&map[i]))).collect();
        let all = share(any.iter().filter(|is| **is).count());
        let of = |(path, map): (&String, &[u8])| GhostFrame {
            path: path.clone(),
            ghost_fraction: share(map.iter().filter(|kept| is_ghost(kept)).count()),
        };
        let (width, height) = (self.region.width(), self.region.height());
        let any = if any.is_empty() {
            Plane::filled(0, 0, false)
        } else {
            Plane::from_vec(width.div_ceil(self.side), height.div_ceil(self.side), any)
        };
        let mut parts = region::parts(&any);
        // The sort is stable: among equally large parts, the part that begins further up comes first.
        parts.sort_by_key(|part| std::cmp::Reverse(part.len()));
        let region = |part: &Vec<(usize, usize)>| {
            let range = |of: &dyn Fn(&(usize, usize)) -> usize, size: usize| {
                let least = part.iter().map(of).min().unwrap_or(0) * self.side;
                let most = (part.iter().map(of).max().unwrap_or(0) + 1) * self.side;
                (least, most.min(size) - least)
            };
            let ((x_px, width_px), (y_px, height_px)) = (range(&|at| at.0, width), range(&|at| at.1, height));
            GhostRegion { x_px, y_px, width_px, height_px, ghost_fraction: share(part.len()) }
        };
        let regions = parts.iter().take(MOST_REGIONS).map(region).collect();
        GhostReport {
            strength: self.strength,
            ghost_fraction: all,
            continued_fraction: self.holes.as_ref().map_or(0.0, Holes::fraction),
            frames: maps().map(of).collect(),
            regions,
        }
    }

    /// The factor on all thresholds: 1 with the default strength.
    pub(in crate::merge) fn tolerance(&self) -> f64 {
        tolerance(self.strength)
    }

    /// Whether frame `layer` has its full weight everywhere.
    pub fn is_whole(&self, layer: usize) -> bool {
        let map = self.frames.get(layer).and_then(|(_, map)| map.as_ref());
        map.is_none_or(|map| map.as_slice().iter().all(|&kept| kept == u8::MAX))
    }
}
