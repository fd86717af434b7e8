//! The memory budget of a bracket: what its stages hold, what each thread adds, and what fits into a [`MemoryLimit`] therefore.
//!
//! In: the limit, and the number and size of the frames. Out: whether the frames stay in memory, how many are decoded at a time, how many threads
//! compute, and how much is merged at a time. Cost: none. No result depends on it.
//!
//! This is the rule, and the only place that states it. A run takes no more than
//!
//! ```text
//! MemoryLimit::PROGRAM + held + threads * thread()
//! ```
//!
//! | held by | frames in memory | frames on disk |
//! |---|---|---|
//! | loading | all frames, and what decoders need beside them | what decoders need, as many at a time as fit |
//! | alignment | all frames and their grey pyramids | the pyramids, and one whole frame or the features of one |
//! | deghosting | all frames, and its cells | one whole frame, and the cells |
//! | merging to writing | all frames and all radiance | half of what is left, in rows of all frames and of radiance |
//!
//! Frames stay in memory where that fits with all threads. Else they are on disk, and so many threads compute as fit beside what is held. One thread and
//! one frame at a time are the floor: where they do not fit either, the limit is exceeded, by as much as the manual states.

use crate::scratch::MemoryLimit;

/// Bytes that a thread adds whatever the size of the frames: tables, points and patches of a comparison, and what the allocator keeps from stage to
/// stage. Measured on nine frames of 12 MP on 1 to 16 threads.
const THREAD: u64 = 4 << 20;
/// Bytes of a scale space for each pixel: six floats, and all octaves have a third as many again as the first.
const SCALE_SPACE: u64 = 4 * 6 * 4 / 3;
/// Bytes that a thread adds for each column: bands of 64 rows of radiance, of the picture and of what is encoded of them. Measured likewise.
const COLUMN: u64 = 64 * 20;
/// Bytes of a cell of deghosting: two frames', and what is made of them.
const CELL: u64 = 70;

/// What the frames of a bracket take, and what there is for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Budget {
    /// Bytes for all of it.
    available: u64,
    frames: u64,
    width: u64,
    /// Pixels of a frame.
    pixels: u64,
    /// Bytes of a frame's code values.
    frame: u64,
}

impl Budget {
    /// Frames of more pixels have a grey pyramid without the full size.
    pub const WHOLE_PYRAMID: u64 = 4_000_000;
    /// The most pixels of the level on which agreement is measured and features are sought.
    pub const MEASURED_PIXELS: u64 = 600_000;
    /// Cells that deghosting has at most, but that none is larger than 8 x 8 pixels.
    pub const MOST_CELLS: u64 = 1 << 20;

    /// The budget of so many frames of `size` pixels, the code values of each `frame` bytes, within `limit`.
    pub fn new(limit: &MemoryLimit, frames: usize, size: (usize, usize), frame: u64) -> Self {
        let (width, pixels) = (size.0 as u64, size.0 as u64 * size.1 as u64);
        Budget { available: limit.for_pixels(), frames: frames as u64, width, pixels, frame }
    }

    /// Pixels of the level on which agreement is measured and features are sought.
    fn measured(&self) -> u64 {
        std::iter::successors(Some(self.pixels), |pixels| Some(pixels / 4))
            .find(|&pixels| pixels <= Budget::MEASURED_PIXELS)
            .unwrap_or(0)
    }

    /// What a thread adds: more than a comparison takes the scale space of a bitmap.
    fn thread(&self) -> u64 {
        THREAD + SCALE_SPACE * self.measured() + COLUMN * self.width
    }

    /// The scale space of a frame's grey picture, which is doubled first.
    fn features(&self) -> u64 {
        4 * SCALE_SPACE * self.measured()
    }

    /// The grey pyramids of all frames: levels of which each has a quarter of the pixels of the one before.
    fn pyramids(&self) -> u64 {
        let thirds = if self.pixels <= Budget::WHOLE_PYRAMID { 4 } else { 1 };
        self.frames * self.pixels * thirds / 3
    }

    /// Bytes that all frames take in memory with what is made of them, where that fits with so many `threads`. Of the pyramids, the cells of
    /// deghosting and the radiance each is gone before the next is there. Features, which frames in doubt alone need, are not counted.
    pub fn in_memory(&self, threads: usize) -> Option<u64> {
        let held = self.frames * self.frame + self.pyramids().max(12 * self.pixels).max(self.cells());
        (held.saturating_add(self.thread() * threads as u64) <= self.available).then_some(held)
    }

    /// How many frames are decoded at a time, of which each takes `bytes` while it is; all of them stay in memory, or none.
    pub fn decoders(&self, stay: bool, bytes: u64) -> usize {
        let kept = if stay { self.frames * self.frame } else { 0 };
        usize::try_from(self.available.saturating_sub(kept) / bytes.max(1)).unwrap_or(usize::MAX).max(1)
    }

    /// The cells of deghosting.
    fn cells(&self) -> u64 {
        CELL * (self.pixels / 4).min(Budget::MOST_CELLS.max(self.pixels / 64))
    }

    /// What is held where the frames are on disk. The cells of deghosting, where it `seeks_ghosts`, come when the pyramids are gone.
    fn on_disk(&self, seeks_ghosts: bool) -> u64 {
        let aligning = self.pyramids() + self.frame.max(self.features());
        if seeks_ghosts { aligning.max(self.cells() + self.frame) } else { aligning }
    }

    /// Of `threads` those that fit where the frames are on disk.
    pub fn threads(&self, threads: usize, seeks_ghosts: bool) -> usize {
        let rest = self.available.saturating_sub(self.on_disk(seeks_ghosts));
        threads.min(usize::try_from(rest / self.thread()).unwrap_or(usize::MAX)).max(1)
    }

    /// Bytes of frames and radiance that are merged at a time on so many `threads` where the frames are on disk: half of the rest, for the allocator keeps
    /// some of the slab before.
    pub fn slab(&self, threads: usize) -> u64 {
        self.available.saturating_sub(self.thread() * threads as u64) / 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of 12 MP and 8 bit within so many megabytes.
    fn budget(frames: usize, megabytes: u64) -> Budget {
        let limit = MemoryLimit { bytes: megabytes * 1_000_000, folder: "x".into() };
        Budget::new(&limit, frames, (4000, 3000), 36_000_000)
    }

    #[test]
    fn threads_are_fewer_where_memory_is_less_and_never_none() {
        let on = |megabytes| budget(9, megabytes).threads(16, false);
        assert_eq!((on(64), on(150)), (1, 1));
        assert_eq!(on(100_000), 16);
        let all: Vec<usize> = (100..800).step_by(20).map(on).collect();
        assert!(all.is_sorted() && all.contains(&2) && all.contains(&16), "{all:?}");
        assert_eq!(budget(9, 100_000).threads(3, true), 3);
    }

    #[test]
    fn all_that_is_planned_fits() {
        for frames in [2, 3, 9, 30] {
            for megabytes in [256, 512, 1000, 3000] {
                for threads in [1, 2, 16, 64] {
                    let budget = budget(frames, megabytes);
                    let bytes = megabytes * 1_000_000 - MemoryLimit::PROGRAM;
                    if let Some(held) = budget.in_memory(threads) {
                        assert!(held + budget.thread() * threads as u64 <= bytes);
                    }
                    let (fitting, floor) = (budget.threads(threads, true), budget.on_disk(true));
                    assert!(fitting == 1 || floor + budget.thread() * fitting as u64 <= bytes);
                    assert!(fitting == 1 || 2 * budget.slab(fitting) + budget.thread() * fitting as u64 <= bytes);
                    for stay in [false, true] {
                        let kept = if stay { frames as u64 * 36_000_000 } else { 0 };
                        let decoders = budget.decoders(stay, 108_000_000);
                        assert!(decoders == 1 || kept + decoders as u64 * 108_000_000 <= bytes);
                    }
                }
            }
        }
    }

    #[test]
    fn more_threads_need_more_memory_for_frames_that_stay_in_it() {
        assert!(budget(9, 700).in_memory(1).is_some() && budget(9, 700).in_memory(64).is_none());
        assert_eq!(budget(9, 100_000).in_memory(64), Some(9 * 36_000_000 + 144_000_000));
        assert_eq!(budget(9, 64).in_memory(1), None);
    }
}
