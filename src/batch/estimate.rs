//! What a step takes, before it is done: memory and time.
//!
//! In: how many photographs, and of what size. Out: bytes and seconds of one core. Cost: none.
//! Source: measured, see the tests; memory is meant to be enough, time to be about right on a core of a server of 2023.

use crate::scratch::MemoryLimit;

/// What alignment takes of small pictures too: descriptors, candidates, tables; and what the allocator keeps of the step before.
const ALIGNING: u64 = 40 << 20;

/// What a step is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Whether the frames are merged, and not only looked at for the response.
    pub merges: bool,
    /// Photographs of the bracket; of the largest one where there are several.
    pub frames: usize,
    /// Photographs of all brackets.
    pub photographs: usize,
    /// Pixels of one.
    pub pixels: usize,
    /// Bytes of one: 3, or 6 with 16 bit.
    pub bytes: usize,
    /// Whether what moved is sought.
    pub seeks_ghosts: bool,
    /// Whether the frames are fused.
    pub fuses: bool,
}

impl Size {
    /// Bytes of the whole process at its peak, if it may have them: with less, what does not fit is put on disk.
    pub fn memory(&self) -> u64 {
        let pixels = self.pixels as u64;
        let frames = self.frames as u64;
        // Codes and pyramids of all frames; the radiance, or what comparing two frames needs, whichever is more, with a quarter to spare.
        let of_frames = pixels * frames * (10 * self.bytes as u64 + 6) / 10;
        let of_results = if self.fuses { 64 } else { 16 } * pixels;
        let of_small = 14 * pixels.min(4_000_000);
        let of_ghosts = if self.seeks_ghosts { 80 * pixels.min(1_000_000) } else { 0 };
        MemoryLimit::PROGRAM + ALIGNING + of_frames + of_results + of_small + of_ghosts
    }

    /// Seconds of one core.
    pub fn time_s(&self) -> f64 {
        let megapixels = self.pixels as f64 / 1e6;
        let photographs = self.photographs as f64;
        let aligning = photographs * (0.06 + 0.022 * megapixels);
        if !self.merges {
            return 0.3 + aligning;
        }
        let merging = photographs * megapixels * if self.seeks_ghosts { 0.08 } else { 0.02 };
        let fusing = if self.fuses { 0.15 * photographs * megapixels } else { 0.0 };
        aligning + merging + fusing + 0.1 + 0.05 * megapixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_takes_more() {
        let size = |frames, pixels, seeks_ghosts, fuses| Size {
            merges: true,
            frames,
            photographs: frames,
            pixels,
            bytes: 3,
            seeks_ghosts,
            fuses,
        };
        let plain = size(3, 12_000_000, false, false);
        for more in [
            size(5, 12_000_000, false, false),
            size(3, 24_000_000, false, false),
            size(3, 12_000_000, true, false),
            size(3, 12_000_000, false, true),
        ] {
            assert!(more.memory() > plain.memory() && more.time_s() > plain.time_s(), "{more:?}");
        }
        // Seen on one core: four frames of 12 MP took 365 MB and 2.8 s, ten 595 MB and 6.2 s.
        for (frames, megabytes, seconds) in [(4, 365, 2.8), (10, 595, 6.2)] {
            let size = size(frames, 12_040_000, false, false);
            let (memory, time) = (size.memory() / 1_000_000, size.time_s());
            assert!((megabytes..megabytes * 3 / 2).contains(&memory), "{memory}");
            assert!((0.7 * seconds..1.5 * seconds).contains(&time), "{time}");
        }
        assert!(Size { bytes: 6, ..plain }.memory() > plain.memory());
    }
}
