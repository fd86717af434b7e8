//! The memory budget of a bracket: what its stages hold, what each thread adds, and what fits into a [`MemoryLimit`] therefore.
//!
//! In: the limit, and what is done to how many frames of which size. Out: whether the frames stay in memory, how many are decoded at a time, how many
//! threads compute, and how much is merged at a time; or that it does not fit at all. Cost: none. No result depends on it.
//!
//! This is the rule, and the only place that states it: a run, and a step of a batch, is planned by it. A run takes no more than
//!
//! ```text
//! MemoryLimit::PROGRAM + held + threads * thread()
//! ```
//!
//! where `held` is the most that one of the stages holds, for the memory of each is given back before the next begins:
//!
//! | stage | frames in memory | frames on disk |
//! |---|---|---|
//! | loading | all frames, and what decoders need beside them | what decoders need, as many at a time as fit |
//! | alignment | all frames and their grey pyramids, and the features of a frame for each thread | the pyramids, and one whole frame or the features of one |
//! | deghosting | all frames, and its cells | one whole frame, and the cells |
//! | merging | all frames and all radiance | half of what is left, in rows of all frames and of radiance |
//! | tone mapping | the same, and the overview | the overview, and rows of radiance |
//! | fusion | the same, and its pyramids | its pyramids, and one whole frame |
//! | inspection | as alignment, but of pyramids all levels; and what is drawn | the same |
//!
//! Frames stay in memory where that fits with all threads. Else they are on disk, and so many threads compute as fit beside what is held. One thread and
//! one frame at a time are the floor: where they do not fit either, the run is refused.

use crate::error::{Error, Result};
use crate::limits::Limits;
use crate::scratch::MemoryLimit;

/// Bytes that a thread adds whatever the size of the frames: tables, points and patches of a comparison, and what the allocator keeps for it.
/// Measured on nine frames of 12 MP on 1 to 16 threads.
const THREAD: u64 = 4 << 20;
/// Bytes of a scale space for each pixel: six floats, and all octaves have a third as many again as the first.
const SCALE_SPACE: u64 = 4 * 6 * 4 / 3;
/// Bytes that a thread adds for each column: bands of 64 rows of radiance, of the picture and of what is encoded of them. Measured likewise.
const COLUMN: u64 = 64 * 20;
/// Bytes of a cell of deghosting: two frames', what is made of them, and what is known where the reference clips.
const CELL: u64 = 156;
/// Bytes of a cell while a frame is averaged beside the standard.
const AVERAGED: u64 = 48;
/// Bytes of a pixel of radiance: three floats.
const RADIANCE: u64 = 12;
/// Bytes of a cell of the overview while an operator works on it: of `mantiuk06`, which takes the most. Measured.
const TONES: u64 = 48;
/// A third of the bytes of fusion for each pixel, whatever the number of frames: floats of the sum of weights (4), of a frame's weight in a pyramid,
/// which has a third more (16 / 3), of three channels of a frame (12), and of three pyramids of the picture so far (16); ...
const FUSION_3: u64 = 12 + 16 + 36 + 48;
/// ... and of each channel that is made a pyramid at the time (16 / 3), of which there are three.
const CHANNEL_3: u64 = 16;
/// Bytes of a sheet that inspection draws: at most 1600 x 1600 pixels, of four bytes as they are drawn, of three for the file, and the PNG.
const SHEET: u64 = 24 << 20;
/// Sheets that are drawn at a time, if there are as many threads: those of a frame.
const SHEETS: u64 = 6;

/// What is done to a bracket, as far as it takes memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Stages {
    /// Features are sought, of frames in doubt or of all.
    pub features: bool,
    /// Frames are merged to radiance, which is tone-mapped.
    pub merging: bool,
    /// What moved is sought.
    pub deghosting: bool,
    /// Frames are fused.
    pub fusing: bool,
    /// What the alignment rests on is drawn.
    pub inspecting: bool,
}

/// What is done to how many frames of which size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Demand {
    pub stages: Stages,
    pub frames: usize,
    /// Width and height, in pixels.
    pub size: (usize, usize),
    /// Bytes of a frame's code values.
    pub frame: u64,
    /// Bytes that a frame takes while it is decoded, with its file.
    pub decoding: u64,
}

impl Demand {
    /// Frames of more pixels have a grey pyramid without the full size.
    pub const WHOLE_PYRAMID: u64 = 4_000_000;
    /// The most pixels of the level on which agreement is measured and features are sought.
    pub const MEASURED_PIXELS: u64 = 600_000;
    /// Cells that deghosting has at most, but that none is larger than 8 x 8 pixels.
    pub const MOST_CELLS: u64 = 1 << 18;
    /// Cells that the overview of tone mapping has at most.
    const OVERVIEW_CELLS: u64 = 1 << 20;

    fn pixels(&self) -> u64 {
        self.size.0 as u64 * self.size.1 as u64
    }

    /// What a thread adds.
    pub fn thread(&self) -> u64 {
        THREAD + COLUMN * self.size.0 as u64
    }

    /// What each thread beside the first adds at the most where frames of `size` pixels are in memory.
    pub fn another_thread(size: (usize, usize)) -> u64 {
        let stages = Stages { features: true, ..Stages::default() };
        let one = Demand { stages, frames: 1, size, frame: 0, decoding: 0 };
        one.thread() + 4 * one.scale_space()
    }

    /// The scale space of the level on which agreement is measured and features are sought.
    fn scale_space(&self) -> u64 {
        let mut pixels = self.pixels();
        while pixels > Demand::MEASURED_PIXELS {
            pixels /= 4;
        }
        SCALE_SPACE * pixels
    }

    /// A grey pyramid: levels of which each has a quarter of the pixels of the one before.
    fn pyramid(&self) -> u64 {
        self.pixels() * if self.pixels() <= Demand::WHOLE_PYRAMID { 4 } else { 1 } / 3
    }

    /// The cells of deghosting: squares of pixels, whose sides are powers of 2.
    fn cells(&self) -> u64 {
        let of_side = |log: u32| self.pixels() >> (2 * log);
        (1..=3).map(of_side).find(|&cells| cells <= Demand::MOST_CELLS).unwrap_or(of_side(3))
    }

    /// What deghosting holds, with what is kept of each frame and so much of one `whole` frame.
    fn deghosting(&self, whole: u64) -> u64 {
        let held = (CELL * self.cells()).max(whole + AVERAGED * self.cells());
        if self.stages.deghosting { held + self.frames as u64 * self.cells() } else { 0 }
    }

    /// The pyramids of all frames, and beside them what comparing takes on so many `threads`, or `whole` frames, or the features of `sought` frames at
    /// a time. The grey picture of a frame is doubled before its features are sought, those of bitmaps are not, and each is sought by one thread.
    fn aligning(&self, threads: u64, whole: u64, sought: u64) -> u64 {
        let all = self.frames as u64;
        let pyramids = all * self.pyramid();
        // From the reference to either side a neighbour that was placed is laid on the reference's grid, by its whole grey picture.
        let sides = sought.min(2);
        let doubt = sides * self.pyramid() + (sides * self.pixels()).max((3 * sought + threads) * self.scale_space());
        let doubt = if self.stages.features { doubt } else { 0 };
        let beside = whole.max(threads * self.scale_space()).max(doubt);
        if self.stages.inspecting {
            // All levels, and two bitmaps.
            let of_frame = self.pixels() * 4 / 3 + self.pixels() / 4;
            return all * of_frame + beside.max(threads.min(SHEETS) * SHEET);
        }
        pyramids + beside
    }

    /// What merging and tone mapping hold on so many `threads` beside rows: so much for each `pixel` of radiance, and where frames are fused so much of
    /// one `whole` frame.
    fn merging(&self, threads: u64, pixel: u64, whole: u64) -> u64 {
        let beside = match self.stages.fusing {
            true => (FUSION_3 + CHANNEL_3 * threads.min(3)) * self.pixels() / 3 + whole,
            false => TONES * self.pixels().min(Demand::OVERVIEW_CELLS),
        };
        if self.stages.merging { pixel * self.pixels() + beside } else { 0 }
    }

    /// What is held in memory with all frames, on so many `threads`.
    fn in_memory(&self, threads: usize) -> u64 {
        let (sought, threads) = (threads.min(self.frames) as u64, threads as u64);
        let merging = self.merging(threads, RADIANCE, 0);
        let held = self.aligning(threads, 0, sought).max(merging).max(self.deghosting(0)) + threads * self.thread();
        self.frames as u64 * self.frame + held.max(self.decoding.saturating_sub(self.frame))
    }

    /// What is held in memory where the frames are on disk, on so many `threads`.
    fn on_disk(&self, threads: usize) -> u64 {
        let (whole, threads) = (self.frame, threads as u64);
        let merging = self.merging(threads, 0, whole);
        let held = self.aligning(threads, whole, 1).max(merging).max(self.deghosting(whole)) + threads * self.thread();
        held.max(self.decoding)
    }

    /// Bytes of the process with which nothing need be put on disk, on so many `threads`.
    pub fn enough(&self, threads: usize) -> u64 {
        MemoryLimit::PROGRAM + self.in_memory(threads)
    }

    /// Bytes of the process with which it can be done at all.
    fn least(&self) -> u64 {
        MemoryLimit::PROGRAM + self.on_disk(1)
    }
}

/// Of `threads` those that fit beside a radiance map of `size` pixels while it is tone-mapped: radiance, the picture, and the overview.
///
/// # Errors
/// The reason and the remedy, where not even one does.
pub(crate) fn tonemapping(limits: &Limits, size: (usize, usize), threads: usize) -> std::result::Result<usize, String> {
    let demand = Demand { stages: Stages::default(), frames: 0, size, frame: 0, decoding: 0 };
    let held = (RADIANCE + 3) * demand.pixels() + TONES * demand.pixels().min(Demand::OVERVIEW_CELLS);
    limits.check_memory_while("tone-mapped", size, held + demand.thread())?;
    let rest = limits.memory.unwrap_or(u64::MAX) - held;
    Ok(threads.min(usize::try_from(rest / demand.thread()).unwrap_or(usize::MAX)))
}

/// What a bracket takes, and what there is for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Budget {
    /// Bytes for all of it.
    available: u64,
    demand: Demand,
}

impl Budget {
    /// The budget of `demand` within `limit`.
    ///
    /// # Errors
    /// [`Error::Option`] where it cannot be kept.
    pub fn new(limit: &MemoryLimit, demand: Demand) -> Result<Self> {
        if demand.least() <= limit.bytes {
            return Ok(Budget { available: limit.for_pixels(), demand });
        }
        let (least, allowed) = (demand.least().div_ceil(1_000_000), limit.bytes / 1_000_000);
        let (frames, (width, height)) = (demand.frames, demand.size);
        let fused = if demand.stages.fusing { "; or another --tmo, for `mertens` takes the most" } else { "" };
        let reason = format!(
            "{frames} frames of {width}x{height} pixels take {least} MB at least, and {allowed} MB are allowed (by default three \
             quarters of what is free); give `--max-memory {least}MB` or more, or scale the frames down{fused}"
        );
        Err(Error::Option { option: "--max-memory", reason })
    }

    /// Bytes that all frames take in memory with what is made of them, where that fits with so many `threads`.
    pub fn in_memory(&self, threads: usize) -> Option<u64> {
        Some(self.demand.in_memory(threads)).filter(|&held| held <= self.available)
    }

    /// How many frames are decoded at a time; all of them stay in memory, or none.
    pub fn decoders(&self, stay: bool) -> usize {
        let Demand { frames, frame, decoding, .. } = self.demand;
        let kept = if stay { frames as u64 * frame } else { 0 };
        usize::try_from(self.available.saturating_sub(kept) / (THREAD + decoding)).unwrap_or(usize::MAX).max(1)
    }

    /// Of `threads` those that fit where the frames are on disk.
    pub fn threads(&self, threads: usize) -> usize {
        (1..=threads).rev().find(|&threads| self.demand.on_disk(threads) <= self.available).unwrap_or(1)
    }

    /// Bytes of frames and radiance that are merged at a time on so many `threads` where the frames are on disk: half of the rest, for the allocator keeps
    /// some of the slab before where the system does not let it give back what is freed.
    pub fn slab(&self, threads: usize) -> u64 {
        self.available.saturating_sub(self.demand.thread() * threads as u64) / 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MB: u64 = 1_000_000;

    /// Frames of 12 MP and 8 bit, merged.
    fn demand(frames: usize) -> Demand {
        let stages = Stages { features: true, merging: true, ..Stages::default() };
        Demand { stages, frames, size: (4000, 3000), frame: 36 * MB, decoding: 40 * MB }
    }

    fn budget(demand: Demand, bytes: u64) -> Result<Budget> {
        Budget::new(&MemoryLimit { bytes, folder: "x".into() }, demand)
    }

    #[test]
    fn threads_are_fewer_where_memory_is_less_and_never_none() {
        let on = |megabytes| budget(demand(9), megabytes * MB).unwrap().threads(16);
        assert_eq!((on(110), on(100_000)), (1, 16));
        let all: Vec<usize> = (110..800).step_by(5).map(on).collect();
        assert!(all.is_sorted() && all.contains(&2) && all.contains(&16), "{all:?}");
        assert_eq!(budget(demand(9), 100_000 * MB).unwrap().threads(3), 3);
    }

    #[test]
    fn what_does_not_fit_is_refused_with_the_limit_that_would_do() {
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
    fn more_threads_need_more_memory_for_frames_that_stay_in_it() {
        let of_nine = budget(demand(9), 700 * MB).unwrap();
        assert!(of_nine.in_memory(1).is_some() && of_nine.in_memory(64).is_none());
        let one = demand(9).enough(1);
        let more = |threads| demand(9).enough(threads) - one;
        assert!((2..64).all(|threads| more(threads) <= (threads as u64 - 1) * Demand::another_thread((4000, 3000))));
    }
}
