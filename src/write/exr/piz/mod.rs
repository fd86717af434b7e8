//! PIZ, OpenEXR's lossless wavelet compression of blocks of 32 rows.
//!
//! In: the rows of a block as planes of 16-bit values. Out: the block as it is stored in the file. Cost: 10 ns per
//! value and core for half floats of noisy photographs; memory only for buffers that are reused. Source: the PIZ
//! format of C. Rouet in OpenEXR: `ImfPizCompressor.cpp`, `ImfWav.cpp`, `ImfHuf.cpp`.
//!
//! A block is compressed in three steps. The values that occur are replaced by consecutive numbers, so that fewer
//! bits are needed. A wavelet transform turns smooth areas into small differences. A Huffman code with run lengths
//! compresses the result. The tests compare the bytes with those of the `exr` crate, which takes three times as long.

mod huffman;
mod wavelet;

use crate::simd::{Loops, vectorised};

/// Compresses blocks; keeps its tables and buffers from block to block.
#[derive(Debug)]
pub(super) struct Packer {
    width: usize,
    /// Number of 16-bit words per sample: 1 or 2.
    words: usize,
    /// The words of B, G and R, one channel after the other. For floats, each channel has first all low words, then
    /// all high words.
    planes: Vec<u16>,
    coded: Vec<u16>,
    scratch: Vec<u16>,
    /// For every 16-bit value: 1 if it occurs in the block, otherwise 0.
    occurs: Box<[u8; 1 << 16]>,
    /// For every 16-bit value: its number among the values that occur.
    numbers: Box<[u16; 1 << 16]>,
    coder: huffman::Coder,
}

impl Default for Packer {
    fn default() -> Self {
        Packer {
            width: 0,
            words: 1,
            planes: Vec::new(),
            coded: Vec::new(),
            scratch: Vec::new(),
            occurs: Box::new([0; 1 << 16]),
            numbers: Box::new([0; 1 << 16]),
            coder: huffman::Coder::default(),
        }
    }
}

impl Packer {
    /// Returns the planes of a block, which must be filled before [`pack`](Self::pack): B, G and R one after the
    /// other, each with its low words first. The block has `rows` rows of `width` samples; a sample has `words`
    /// 16-bit words, 1 or 2.
    pub(super) fn planes(&mut self, width: usize, rows: usize, words: usize) -> &mut [u16] {
        (self.width, self.words) = (width, words);
        self.planes.resize(3 * words * rows * width, 0);
        &mut self.planes
    }

    /// Compresses the block in [`planes`](Self::planes) and appends it to `out`. If the uncompressed block is not
    /// larger, appends that instead.
    pub(super) fn pack(&mut self, out: &mut Vec<u8>) {
        let start = out.len();
        let size = self.planes.len() / (3 * self.words);
        let highest = self.number(out);
        let (planes, numbers) = (&self.planes, &self.numbers);
        self.coded.clear();
        self.coded.extend(planes.iter().map(|&value| numbers[usize::from(value)]));
        for plane in self.coded.chunks_exact_mut(size) {
            wavelet::transform(plane, self.width, highest, &mut self.scratch);
        }
        let coded = if self.words == 1 {
            &self.coded
        } else {
            interleave(&self.coded, size, &mut self.scratch);
            &self.scratch
        };
        let length = out.len();
        out.extend_from_slice(&[0; 4]);
        self.coder.encode(coded, out);
        // A block of 32 rows is always smaller than 2 GB, so its length fits into 32 bits.
        let packed = (out.len() - length - 4) as u32;
        out[length..length + 4].copy_from_slice(&packed.to_le_bytes());
        if out.len() - start >= 2 * self.planes.len() {
            out.truncate(start);
            self.put_plain(out);
        }
    }

    /// Assigns consecutive numbers to the values that occur, in rising order; the value 0 always gets a number.
    /// Appends a bitmap of the values that occur, in which 0 is not marked: the indices of its first and last
    /// non-zero byte, then the bytes from the first to the last. Returns the highest number.
    fn number(&mut self, out: &mut Vec<u8>) -> u16 {
        self.occurs.fill(0);
        for &value in &self.planes {
            self.occurs[usize::from(value)] = 1;
        }
        self.occurs[0] = 1;
        let mut count = 0u16;
        for (number, &occurs) in self.numbers.iter_mut().zip(self.occurs.iter()) {
            *number = count;
            // If all 65536 values occur, `count` wraps around to 0; `highest` is right in this case, too.
            count = count.wrapping_add(u16::from(occurs));
        }
        let highest = count.wrapping_sub(1);
        self.occurs[0] = 0;
        let (eights, _) = self.occurs.as_chunks::<8>();
        // The multiplication collects the lowest bits of the eight bytes in the top byte, without carry.
        let byte = |eight: &[u8; 8]| (u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8;
        let is_used = |eight: &[u8; 8]| *eight != [0; 8];
        let first = eights.iter().position(is_used).unwrap_or(0);
        let last = eights.iter().rposition(is_used).unwrap_or(0);
        out.extend_from_slice(&(first as u16).to_le_bytes());
        out.extend_from_slice(&(last as u16).to_le_bytes());
        out.extend(eights[first..=last].iter().map(byte));
        highest
    }

    /// Appends the uncompressed block: row by row, in each row channel by channel, in each channel sample by sample.
    fn put_plain(&self, out: &mut Vec<u8>) {
        let (width, words) = (self.width, self.words);
        let size = self.planes.len() / (3 * words);
        for row in 0..size / width {
            for channel in self.planes.chunks_exact(words * size) {
                for x in row * width..(row + 1) * width {
                    out.extend((0..words).flat_map(|word| channel[word * size + x].to_le_bytes()));
                }
            }
        }
    }
}

/// Interleaves the words of every pair of planes: the first plane has the low words of `size` samples, the second
/// plane has the high words.
fn interleave(planes: &[u16], size: usize, out: &mut Vec<u16>) {
    out.resize(planes.len(), 0);
    for (pair, to) in planes.chunks_exact(2 * size).zip(out.chunks_exact_mut(2 * size)) {
        let (low, high) = pair.split_at(size);
        vectorised(Interleave { low, high, to });
    }
}

struct Interleave<'a> {
    low: &'a [u16],
    high: &'a [u16],
    to: &'a mut [u16],
}

impl Loops for Interleave<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let (pairs, _) = self.to.as_chunks_mut::<2>();
        for ((to, &low), &high) in pairs.iter_mut().zip(self.low).zip(self.high) {
            *to = [low, high];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::exr::compression::Compression;
    use ::exr::math::Vec2;
    use ::exr::meta::BlockDescription::ScanLines;
    use ::exr::meta::attribute::{ChannelDescription, IntegerBounds, LineOrder, SampleType, Text};
    use ::exr::meta::header::Header;

    /// Compresses a block with the `exr` crate. `samples` has the block row by row, and each row channel by channel.
    fn by_the_crate(width: usize, rows: usize, words: usize, samples: &[u16]) -> Vec<u8> {
        let kind = if words == 1 { SampleType::F16 } else { SampleType::F32 };
        let channels = ["B", "G", "R"].map(|name| ChannelDescription::named(name, kind)).into_iter().collect();
        let header = Header::new(Text::default(), (width, rows), channels);
        let header = header.with_encoding(Compression::PIZ, ScanLines, LineOrder::Increasing);
        let bytes = samples.iter().flat_map(|v| v.to_ne_bytes()).collect();
        let bounds = IntegerBounds::new((0, 0), Vec2(width, rows));
        Compression::PIZ.compress_image_section_to_le(&header, bytes, bounds).unwrap()
    }

    /// Checks that `packer` and the crate give the same bytes for a block whose words are `value(plane, index in the
    /// plane)`.
    fn check(packer: &mut Packer, (width, rows, words): (usize, usize, usize), value: impl Fn(usize, usize) -> u16) {
        let size = width * rows;
        for (i, to) in packer.planes(width, rows, words).iter_mut().enumerate() {
            *to = value(i / size, i % size);
        }
        let mut samples = Vec::new();
        for y in 0..rows {
            for channel in 0..3 {
                for x in 0..width {
                    samples.extend((0..words).map(|word| value(channel * words + word, y * width + x)));
                }
            }
        }
        let mut ours = b"before".to_vec();
        packer.pack(&mut ours);
        assert!(ours[6..] == by_the_crate(width, rows, words, &samples), "{width}x{rows}, {words} words");
    }

    /// One packer is used for all blocks, so that the test detects data that are left over from the previous block.
    #[test]
    fn blocks_are_those_of_the_exr_crate_to_the_byte() {
        let noise = |plane: usize, i: usize| ((plane * 1_000_003 + i).wrapping_mul(2_654_435_761) >> 13) as u16;
        let mut packer = Packer::default();
        for size in [(1, 1), (1, 32), (40, 1), (2, 2), (3, 5), (31, 32), (64, 32), (333, 32), (97, 17), (2000, 32)] {
            for words in [1, 2] {
                let size = (size.0, size.1, words);
                check(&mut packer, size, |plane, i| {
                    0x3800 + (i / 7) as u16 % 999 + plane as u16 + noise(plane, i) % 37
                });
                check(&mut packer, size, |_, _| 0);
                check(&mut packer, size, |_, _| 0x3c00);
                check(&mut packer, size, |plane, i| if noise(plane, i) % 50 == 0 { noise(plane, i) } else { 0x3c00 });
                // More than 2^14 different values, which need the 16-bit wavelet.
                check(&mut packer, size, |plane, i| noise(plane, i) / if plane % 2 == 0 { 3 } else { 900 });
                // Incompressible values.
                check(&mut packer, size, noise);
                check(&mut packer, size, |plane, i| (plane * size.0 * size.1 + i) as u16);
            }
        }
    }
}
