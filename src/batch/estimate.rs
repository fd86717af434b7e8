//! Estimates of memory and time for a job, before it runs.
//!
//! In: number and size of the photographs. Out: peak memory in bytes, and time on one core in seconds. Cost:
//! negligible. Source: the memory is the upper bound that the [`budget`](crate::budget) module computes for a run.
//! The formula for the time was fitted to measurements on one core of a server of 2023 (see the tests).

use crate::budget::{Demand, Stages};

/// The properties of a job that determine its memory and time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Whether the job merges the frames; if false, it only recovers the response from them.
    pub merges: bool,
    /// Number of photographs of the bracket. If the job has several brackets: of the largest one.
    pub frames: usize,
    /// Number of photographs of all brackets of the job.
    pub photographs: usize,
    /// Width and height of a photograph, in pixels.
    pub size: (usize, usize),
    /// Bytes per pixel of a frame in memory: 3 with 8 bits per sample, 6 with 16 bits.
    pub bytes: usize,
    /// Whether depth is measured if the scene has depth.
    pub follows: bool,
    /// Whether motion is detected.
    pub seeks_ghosts: bool,
    /// Whether the frames are merged by exposure fusion.
    pub fuses: bool,
}

impl Size {
    /// Returns the peak memory of the whole process in bytes, for one thread and without a memory limit. With a
    /// limit, frames are moved to disk, and the process needs less.
    pub fn memory(&self) -> u64 {
        let frame = (self.size.0 * self.size.1 * self.bytes) as u64;
        let stages = Stages {
            features: true,
            merging: self.merges,
            following: self.follows,
            deghosting: self.seeks_ghosts,
            fusing: self.fuses,
            ..Stages::default()
        };
        // Decoding a file holds three copies of it: the file, the pixels as the file stores them, and the pixels of
        // the frame.
        Demand { stages, frames: self.frames, size: self.size, frame, decoding: 3 * frame }.enough(1)
    }

    /// Returns the estimated time on one core, in seconds.
    pub fn time_s(&self) -> f64 {
        let megapixels = (self.size.0 * self.size.1) as f64 / 1e6;
        let photographs = self.photographs as f64;
        let aligning = photographs * (0.06 + 0.022 * megapixels);
        if !self.merges {
            return 0.3 + aligning;
        }
        let merging = photographs * megapixels * if self.seeks_ghosts { 0.03 } else { 0.02 };
        let fusing = if self.fuses { 0.15 * photographs * megapixels } else { 0.0 };
        aligning + merging + fusing + 0.1 + 0.05 * megapixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_takes_more() {
        let size = |frames, width, seeks_ghosts, fuses| Size {
            merges: true,
            follows: false,
            frames,
            photographs: frames,
            size: (width, 3000),
            bytes: 3,
            seeks_ghosts,
            fuses,
        };
        let plain = size(3, 4000, false, false);
        for more in [
            size(5, 4000, false, false),
            size(3, 8000, false, false),
            size(3, 4000, true, false),
            size(3, 4000, false, true),
        ] {
            assert!(more.memory() >= plain.memory() && more.time_s() > plain.time_s(), "{more:?}");
        }
        // The estimates are compared with measurements of frames of 12 MP. Memory: 3 frames took 328 MB, 9 frames 540
        // MB. Time on one core: 4 frames took 2.8 s, 10 frames 6.2 s.
        for (frames, megabytes) in [(3, 328), (9, 540)] {
            let memory = size(frames, 4013, false, false).memory() / 1_000_000;
            assert!((megabytes..megabytes * 5 / 4).contains(&memory), "{memory}");
        }
        for (frames, seconds) in [(4, 2.8), (10, 6.2)] {
            let time = size(frames, 4013, false, false).time_s();
            assert!((0.7 * seconds..1.5 * seconds).contains(&time), "{time}");
        }
        assert!(Size { bytes: 6, ..plain }.memory() > plain.memory());
    }
}
