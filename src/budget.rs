//! The memory budget of a bracket: the memory of its stages and threads, and what fits into a [`MemoryLimit`].
//!
//! In: the limit, the stages, and the number and size of the frames. Out: whether the frames stay in memory, how many
//! are decoded at a time, the number of threads, and how many bytes are merged at a time; or an error if the limit is
//! too low. Cost: none. The results of a run do not depend on the budget.
//!
//! This module plans all runs and all jobs of a batch. A run takes at most
//!
//! ```text
//! MemoryLimit::PROGRAM + held + threads * thread()
//! ```
//!
//! where `thread()` is the memory of the buffers of one thread. `held` is the largest memory of any stage, because each
//! stage frees its memory before the next one begins:
//!
//! | stage | frames in memory | frames on disk |
//! |---|---|---|
//! | loading | all frames, buffers of the decoders | buffers of as many decoders as fit |
//! | alignment | all frames, all grey pyramids, features of a frame per thread | all pyramids, one frame or its features |
//! | deghosting | all frames, cells | one frame, cells |
//! | merging | all frames, the radiance map | rows of all frames and of radiance; they get half of the memory left |
//! | tone mapping | all frames, the radiance map, the overview | the overview, rows of radiance |
//! | fusion | all frames, the radiance map, pyramids of the fusion | pyramids of the fusion, one frame |
//! | inspection | as for alignment, but with all pyramid levels; drawings | the same |
//!
//! Frames stay in memory if that fits with all threads. Otherwise they are on disk, and as many threads are used as
//! fit. If even one thread and one frame at a time do not fit, the run is refused.

use crate::error::{Error, Result};
use crate::limits::Limits;
use crate::scratch::MemoryLimit;

/// Bytes that a thread takes for frames of any size: tables, points and patches for the comparison of frames, and
/// memory that the allocator keeps. Measured with nine frames of 12 MP on 1 to 16 threads.
const THREAD: u64 = 4 << 20;
/// Bytes of a scale space per pixel: six floats of 4 bytes. All octaves together have 4/3 of the pixels of the first
/// octave.
const SCALE_SPACE: u64 = 4 * 6 * 4 / 3;
/// Bytes that a thread takes for each column of a frame: bands of 64 rows of radiance, of display values and of
/// encoded data. Measured in the same way as [`THREAD`].
const COLUMN: u64 = 64 * 20;
/// Bytes per cell (a square of pixels) of deghosting: values of two frames, intermediate results, and values where the
/// reference is clipped.
const CELL: u64 = 156;
/// Bytes per cell of deghosting while the pixels of one frame are averaged over the cells.
const AVERAGED: u64 = 48;
/// Bytes per pixel of radiance: three floats.
const RADIANCE: u64 = 12;
/// Bytes per cell of the overview, the grid of mean luminances from which tone mapping begins. Measured for
/// `mantiuk06`, which takes the most.
const TONES: u64 = 48;
/// Three times the bytes that fusion takes per pixel, for any number of frames; the factor of three makes it an
/// integer. The bytes are floats: the sum of weights (4), the pyramid of a frame's weight (16 / 3, because a pyramid
/// has 4/3 of the pixels), three channels of a frame (12), and the three pyramids of the result (16).
const FUSION_3: u64 = 12 + 16 + 36 + 48;
/// Three times the bytes per pixel of the pyramid of one channel (16 / 3). Up to three of these pyramids are computed
/// in parallel.
const CHANNEL_3: u64 = 16;
/// Bytes per drawing of `inspect`. The pictures in a drawing have at most 1600 x 1600 pixels, and its margins
/// and text add few. There are four bytes per pixel to draw, three for the file, and the PNG.
const SHEET: u64 = 24 << 20;
/// Largest number of drawings that are computed at a time, one per thread. It is the number of drawings of one frame.
const SHEETS: u64 = 6;

/// Bytes of the sum of the costs of a label.
const COST_SUM: u64 = 2;
/// Bytes of the chosen depths per pixel of the level on which depth is measured.
const CHOSEN: u64 = 8;
/// Bytes of the smoothing per pixel of that level: 15 floats, and a margin for the displacements of the patches.
const SMOOTHED: u64 = 72;
/// Bytes per pixel of the level on which depth is measured, for each frame: the grey values of the frame and of the
/// reference that are compared.
const COMPARED: u64 = 8;
/// Bytes per pixel of the finest level of the refinement that are kept for the merge: the depth. One byte more is kept
/// for each frame: how it shows the pixel.
const KEPT_RELIEF: u64 = 4;
/// Bytes per pixel of that level of the tables of one frame from which hidden pixels are found, and of two masks.
const HIDING: u64 = 10;

/// The stages of a run that determine its memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Stages {
    /// Whether features are detected, in some frames or in all.
    pub features: bool,
    /// Whether frames are merged to radiance, which is then tone-mapped.
    pub merging: bool,
    /// Whether ghosts are removed.
    pub deghosting: bool,
    /// Whether frames are fused.
    pub fusing: bool,
    /// Whether the depth of the scene is measured if it has depth.
    pub following: bool,
    /// Whether `inspect` draws the data of the alignment.
    pub inspecting: bool,
}

/// The input of the budget: stages, number and size of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Demand {
    pub stages: Stages,
    pub frames: usize,
    /// Width and height, in pixels.
    pub size: (usize, usize),
    /// Bytes of the pixel values of a frame.
    pub frame: u64,
    /// Bytes to decode a frame, including its file.
    pub decoding: u64,
}

impl Demand {
    /// Largest number of pixels of a frame whose grey pyramid includes the full size. The pyramid of a larger frame
    /// begins at half its width and height.
    pub const WHOLE_PYRAMID: u64 = 4_000_000;
    /// Largest number of pixels of the pyramid level on which the agreement of frames is measured and features are
    /// detected.
    pub const MEASURED_PIXELS: u64 = 600_000;
    /// Largest number of cells of deghosting. It is exceeded only if even the largest cells, of 8 x 8 pixels, are
    /// more.
    pub const MOST_CELLS: u64 = 1 << 18;
    /// Largest number of depths that are compared for each pixel.
    pub const MOST_LABELS: u64 = 64;
    /// Largest number of costs of depths that are summed at a time, unless a few rows have more.
    pub const STRIP_COSTS: u64 = 6 << 20;
    /// Largest number of cells of the overview of tone mapping (a grid of mean luminances).
    const OVERVIEW_CELLS: u64 = 1 << 20;

    fn pixels(&self) -> u64 {
        self.size.0 as u64 * self.size.1 as u64
    }

    /// Bytes of the buffers of one thread.
    pub fn thread(&self) -> u64 {
        THREAD + COLUMN * self.size.0 as u64
    }

    /// Upper bound of the bytes that each additional thread takes if the frames of this `size` are merged.
    pub fn another_thread(size: (usize, usize)) -> u64 {
        let stages = Stages { features: true, ..Stages::default() };
        let one = Demand { stages, frames: 1, size, frame: 0, decoding: 0 };
        one.thread() + 4 * one.scale_space()
    }

    /// Number of pixels of the pyramid level that is used for agreement, features and depth.
    fn measured_pixels(&self) -> u64 {
        self.pixels_within(Demand::MEASURED_PIXELS)
    }

    /// Number of pixels of the finest level of the refinement.
    fn refined_pixels(&self) -> u64 {
        self.pixels_within(Demand::WHOLE_PYRAMID)
    }

    /// Number of pixels of the largest pyramid level with at most this number of pixels.
    fn pixels_within(&self, most: u64) -> u64 {
        let mut pixels = self.pixels();
        while pixels > most {
            pixels /= 4;
        }
        pixels
    }

    /// Bytes of the scale space on the pyramid level that is used for agreement and features.
    fn scale_space(&self) -> u64 {
        SCALE_SPACE * self.measured_pixels()
    }

    /// Bytes of the measurement of depth.
    fn relief(&self) -> u64 {
        let (pixels, frames) = (self.measured_pixels(), self.frames as u64);
        let costs = Demand::MOST_LABELS * pixels;
        let matched =
            costs + (COMPARED * frames * pixels).max(CHOSEN * pixels + COST_SUM * Demand::STRIP_COSTS.min(costs));
        let smoothed = (CHOSEN + SMOOTHED) * pixels;
        let hidden = self.kept_relief() + HIDING * self.refined_pixels();
        if self.stages.following { matched.max(smoothed).max(hidden) } else { 0 }
    }

    /// Bytes of the measured depth.
    fn kept_relief(&self) -> u64 {
        let bytes = KEPT_RELIEF + self.frames as u64;
        if self.stages.following { bytes * self.refined_pixels() } else { 0 }
    }

    /// Bytes of a grey pyramid. The pyramid of a frame with more than `WHOLE_PYRAMID` pixels does not include the full
    /// size. Each level has a quarter of the pixels of the next larger level.
    fn pyramid(&self) -> u64 {
        self.pixels() * if self.pixels() <= Demand::WHOLE_PYRAMID { 4 } else { 1 } / 3
    }

    /// Number of cells of deghosting. Their sides are 2, 4 or 8 pixels.
    fn cells(&self) -> u64 {
        let of_side = |log: u32| self.pixels() >> (2 * log);
        (1..=3).map(of_side).find(|&cells| cells <= Demand::MOST_CELLS).unwrap_or(of_side(3))
    }

    /// Bytes of deghosting, including one byte per cell that is kept for each frame. `whole` is the number of bytes of
    /// a frame that is read from disk, or 0 if all frames are in memory.
    fn deghosting(&self, whole: u64) -> u64 {
        let held = (CELL * self.cells()).max(whole + AVERAGED * self.cells());
        if self.stages.deghosting { held + self.frames as u64 * self.cells() } else { 0 }
    }

    /// Returns the bytes of alignment: the pyramids of all frames, and in addition the largest of four numbers. The
    /// first are the bytes of the comparison of frames on `threads` threads. From the coarsest level to the one that
    /// has twice the width and height of the level of the features, the comparison converts whole levels; of finer
    /// levels it reads only patches. The second are the bytes of the features, which are detected in `detecting` frames
    /// at a time. The third is `whole`, the bytes of a frame that is read from disk (0 if all frames are in memory).
    /// The fourth are the bytes of the measurement of depth.
    ///
    /// Before features are detected, the grey image is doubled in width and height; the bitmaps are not. Each bitmap
    /// is processed by one thread.
    fn aligning(&self, threads: u64, whole: u64, detecting: u64) -> u64 {
        let all = self.frames as u64;
        let pyramids = all * self.pyramid();
        // Frames are aligned in two directions from the reference: towards shorter and towards longer exposures. In
        // each direction, one aligned frame at a time is resampled to the grid of the reference, in full size.
        let sides = detecting.min(2);
        let resampled = sides * self.pixels();
        let features = sides * self.pyramid() + resampled.max((3 * detecting + threads) * self.scale_space());
        let features = if self.stages.features { features } else { 0 };
        let beside = whole.max(2 * threads * self.scale_space()).max(features).max(self.relief());
        if self.stages.inspecting {
            // Each frame has all levels of the pyramid, and two bitmaps.
            let of_frame = self.pixels() * 4 / 3 + self.pixels() / 4;
            return all * of_frame + beside.max(threads.min(SHEETS) * SHEET);
        }
        pyramids + beside
    }

    /// Returns the bytes of merging and tone mapping on `threads` threads, without the rows of [`Budget::slab`].
    /// `pixel` is the number of bytes per pixel of radiance that stay in memory, and `whole` is the number of bytes of
    /// a frame that fusion reads from disk. Each is 0 if there are no such bytes.
    fn merging(&self, threads: u64, pixel: u64, whole: u64) -> u64 {
        let beside = match self.stages.fusing {
            true => (FUSION_3 + CHANNEL_3 * threads.min(3)) * self.pixels() / 3 + whole,
            false => TONES * self.pixels().min(Demand::OVERVIEW_CELLS),
        };
        if self.stages.merging { pixel * self.pixels() + beside } else { 0 }
    }

    /// Bytes of the run in addition to [`MemoryLimit::PROGRAM`], with all frames in memory.
    fn in_memory(&self, threads: usize) -> u64 {
        let (detecting, threads) = (threads.min(self.frames) as u64, threads as u64);
        let merging = self.merging(threads, RADIANCE, 0);
        let after = self.kept_relief() + merging.max(self.deghosting(0));
        let held = self.aligning(threads, 0, detecting).max(after) + threads * self.thread();
        self.frames as u64 * self.frame + held.max(self.decoding.saturating_sub(self.frame))
    }

    /// Bytes of the run in addition to [`MemoryLimit::PROGRAM`], with the frames on disk.
    fn on_disk(&self, threads: usize) -> u64 {
        let (whole, threads) = (self.frame, threads as u64);
        let merging = self.merging(threads, 0, whole);
        let after = self.kept_relief() + merging.max(self.deghosting(whole));
        let held = self.aligning(threads, whole, 1).max(after) + threads * self.thread();
        held.max(self.decoding)
    }

    /// Least memory limit, in bytes, with which all frames stay in memory.
    pub fn enough(&self, threads: usize) -> u64 {
        MemoryLimit::PROGRAM + self.in_memory(threads)
    }

    /// Least possible memory limit, in bytes.
    fn least(&self) -> u64 {
        MemoryLimit::PROGRAM + self.on_disk(1)
    }
}

/// Returns the number of threads, at most `threads`, that fit for tone mapping a radiance map of `size` pixels.
///
/// # Errors
/// The reason and what to do, if not even one thread fits.
pub(crate) fn tonemapping(limits: &Limits, size: (usize, usize), threads: usize) -> std::result::Result<usize, String> {
    let demand = Demand { stages: Stages::default(), frames: 0, size, frame: 0, decoding: 0 };
    let held = (RADIANCE + 3) * demand.pixels() + TONES * demand.pixels().min(Demand::OVERVIEW_CELLS);
    limits.check_memory_while("tone-mapping", size, held + demand.thread())?;
    let rest = limits.memory.unwrap_or(u64::MAX) - held;
    Ok(threads.min(usize::try_from(rest / demand.thread()).unwrap_or(usize::MAX)))
}

/// The memory demand of a bracket, and the available memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Budget {
    /// Bytes available for pixels and threads.
    available: u64,
    demand: Demand,
}

impl Budget {
    /// The budget of `demand` within `limit`.
    ///
    /// # Errors
    /// [`Error::Option`] if the limit is too low.
    pub fn new(limit: &MemoryLimit, demand: Demand) -> Result<Self> {
        if demand.least() <= limit.bytes {
            return Ok(Budget { available: limit.for_pixels(), demand });
        }
        let (least, allowed) = (demand.least().div_ceil(1_000_000), limit.bytes / 1_000_000);
        let (frames, (width, height)) = (demand.frames, demand.size);
        let fused =
            if demand.stages.fusing { ", or choose another --tmo (`mertens` takes the most memory)" } else { "" };
        let reason = format!(
            "{frames} frames of {width}x{height} pixels take {least} MB at least, and {allowed} MB are allowed (by default \
             three quarters of the free memory); give `--max-memory {least}MB` or more, or scale the frames down{fused}"
        );
        Err(Error::Option { option: "--max-memory", reason })
    }

    /// Returns the bytes of the run with all frames in memory, on `threads` threads; `None` if they do not fit.
    pub fn in_memory(&self, threads: usize) -> Option<u64> {
        Some(self.demand.in_memory(threads)).filter(|&held| held <= self.available)
    }

    /// Returns the number of frames to decode at a time; `stay`: whether all frames stay in memory.
    pub fn decoders(&self, stay: bool) -> usize {
        let Demand { frames, frame, decoding, .. } = self.demand;
        let kept = if stay { frames as u64 * frame } else { 0 };
        usize::try_from(self.available.saturating_sub(kept) / (THREAD + decoding)).unwrap_or(usize::MAX).max(1)
    }

    /// Returns the number of threads, at most `threads`, that fit if the frames are on disk.
    pub fn threads(&self, threads: usize) -> usize {
        (1..=threads).rev().find(|&threads| self.demand.on_disk(threads) <= self.available).unwrap_or(1)
    }

    /// Returns the size, in bytes, of the frames and radiance that are merged at a time (a slab) if the frames are on
    /// disk. It is half of the memory that remains beside the buffers of the threads and the measured depth, because the
    /// allocator may keep memory of the previous slab.
    pub fn slab(&self, threads: usize) -> u64 {
        let beside = self.demand.thread() * threads as u64 + self.demand.kept_relief();
        self.available.saturating_sub(beside) / 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MB: u64 = 1_000_000;

    /// The demand of a run that merges frames of 12 MP and 8 bits.
    fn demand(frames: usize) -> Demand {
        let stages = Stages { features: true, merging: true, ..Stages::default() };
        Demand { stages, frames, size: (4000, 3000), frame: 36 * MB, decoding: 40 * MB }
    }

    fn budget(demand: Demand, bytes: u64) -> Result<Budget> {
        Budget::new(&MemoryLimit { bytes, folder: "x".into() }, demand)
    }

    #[test]
    fn less_memory_gives_fewer_threads_but_at_least_one() {
        let on = |megabytes| budget(demand(9), megabytes * MB).unwrap().threads(16);
        assert_eq!((on(110), on(100_000)), (1, 16));
        let all: Vec<usize> = (110..800).step_by(5).map(on).collect();
        assert!(all.is_sorted() && all.contains(&2) && all.contains(&16), "{all:?}");
        assert_eq!(budget(demand(9), 100_000 * MB).unwrap().threads(3), 3);
    }

    #[test]
    fn bracket_over_the_memory_limit_names_a_sufficient_limit() {
        let refused = budget(demand(9), 64 * MB).unwrap_err();
        assert!(refused.is_usage());
        let words = refused.to_string();
        let least = demand(9).least().div_ceil(MB);
        for part in ["9 frames of 4000x3000", "64 MB are allowed", &format!("--max-memory {least}MB")] {
            assert!(words.contains(part), "{words}");
        }
        assert!(budget(demand(9), least * MB).is_ok() && budget(demand(9), demand(9).least() - 1).is_err());
        let fusing = Demand { stages: Stages { fusing: true, ..demand(3).stages }, ..demand(3) };
        assert!(budget(fusing, 512 * MB).unwrap_err().to_string().contains("another --tmo"));
    }

    #[test]
    fn all_that_is_planned_fits() {
        let every = [false, true].map(|on| Stages { deghosting: on, fusing: on, inspecting: !on, ..demand(2).stages });
        for (frames, stages) in [2, 3, 9, 30].into_iter().flat_map(|frames| every.map(|stages| (frames, stages))) {
            let demand = Demand { stages, ..demand(frames) };
            for bytes in [256, 512, 1000, 3000].map(|megabytes| megabytes * MB) {
                let Ok(budget) = budget(demand, bytes) else { continue };
                for threads in [1, 2, 16, 64] {
                    assert_eq!(budget.in_memory(threads).is_some(), demand.enough(threads) <= bytes);
                    let fitting = budget.threads(threads);
                    assert!(MemoryLimit::PROGRAM + demand.on_disk(fitting) <= bytes);
                    let own = MemoryLimit::PROGRAM + demand.thread() * fitting as u64;
                    assert!(2 * budget.slab(fitting) + own <= bytes);
                }
                for kept in [0, frames as u64 * demand.frame] {
                    let decoders = budget.decoders(kept > 0);
                    assert!(decoders == 1 || kept + decoders as u64 * demand.decoding + MemoryLimit::PROGRAM <= bytes);
                }
            }
        }
    }

    #[test]
    fn more_threads_need_more_memory_for_frames_in_memory() {
        let of_nine = budget(demand(9), 700 * MB).unwrap();
        assert!(of_nine.in_memory(1).is_some() && of_nine.in_memory(64).is_none());
        let one = demand(9).enough(1);
        let more = |threads| demand(9).enough(threads) - one;
        assert!((2..64).all(|threads| more(threads) <= (threads as u64 - 1) * Demand::another_thread((4000, 3000))));
    }
}
