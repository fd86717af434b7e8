//! Fast deflate: Huffman codes and runs, for bytes filtered by a predictor.
//!
//! In: filtered bytes. Out: deflate blocks that end at a byte boundary, so that parts compressed in parallel form one
//! stream when they are concatenated. Cost: 2 ns per byte and core. Photographs become smaller than with a quick
//! search for repetitions, which noise does not have. Source: RFC 1951, sections 3.2.5 to 3.2.7; A. Moffat and J.
//! Katajainen, "In-Place Calculation of Minimum-Redundancy Codes", WADS 1995; the idea to search only for runs of 8
//! bytes is that of the `fdeflate` crate.

mod adler;

pub(crate) use adler::Adler;

/// Bytes that share a code: few enough for the code to fit them, enough for its 150 bytes not to matter.
const BLOCK: usize = 1 << 16;

/// Longest code, in bits: four codes and 7 pending bits fit into one word.
const LONGEST: usize = 14;

/// Literals, the end symbol, and the lengths of repetitions up to 258.
const SYMBOLS: usize = 286;
const END: usize = 256;

/// Largest size of the header of a block, including a part of its last byte.
const TABLE_BYTES: usize = (3 + 14 + 19 * 3 + 4 * (SYMBOLS + 1)).div_ceil(8) + 1;

/// Runs are groups of 8 bytes; the largest number of groups.
const MOST_GROUPS: usize = 32;

/// Appends `raw`, compressed; `last` ends the stream.
pub(crate) fn deflate(raw: &[u8], last: bool, out: &mut Vec<u8>) {
    let mut bits = Bits { out, at: 0, word: 0, held: 0 };
    bits.at = bits.out.len();
    for start in (0..raw.len()).step_by(BLOCK) {
        let before = start.checked_sub(1).map(|i| raw[i]);
        put_block(before, &raw[start..raw.len().min(start + BLOCK)], &mut bits);
    }
    // An empty stored block: it ends at a byte boundary.
    bits.room(8);
    bits.put(u64::from(last), 3);
    bits.align();
    bits.put(0xffff_0000, 32);
    bits.end();
}

/// Appends `raw`, compressed, as a complete zlib stream.
pub(crate) fn zlib(raw: &[u8], out: &mut Vec<u8>) {
    // Deflate, window of 32 KB, fastest.
    out.extend_from_slice(&[0x78, 0x01]);
    deflate(raw, true, out);
    out.extend_from_slice(&Adler::of(raw).sum().to_be_bytes());
}

/// A part of a block.
enum Token<'a> {
    Bytes(&'a [u8; 8]),
    /// The previous byte again, in so many groups of 8.
    Run(usize),
}

/// Divides `raw` into groups of 8 and the remaining bytes; groups that repeat the previous byte, which is `before`
/// for the first, become runs.
#[inline(always)]
fn tokens<'a>(before: Option<u8>, raw: &'a [u8], mut take: impl FnMut(Token<'a>)) -> &'a [u8] {
    let (groups, rest) = raw.as_chunks::<8>();
    let again = |byte: u8| u64::from(byte) * 0x0101_0101_0101_0101;
    // There is no byte before the very first; a value that differs from the first group prevents a run.
    let first = groups.first().map_or(0, |g| u64::from_le_bytes(*g));
    let (mut repeated, mut run) = (before.map_or(!first, again), 0);
    for group in groups {
        if u64::from_le_bytes(*group) == repeated {
            run += 1;
            if run == MOST_GROUPS {
                take(Token::Run(run));
                run = 0;
            }
            continue;
        }
        if run > 0 {
            take(Token::Run(run));
            run = 0;
        }
        take(Token::Bytes(group));
        repeated = again(group[7]);
    }
    if run > 0 {
        take(Token::Run(run));
    }
    rest
}

fn put_block(before: Option<u8>, raw: &[u8], bits: &mut Bits) {
    // Four counts of each byte, because increments of the same counter wait for each other.
    let mut counts = [[0u32; 256]; 4];
    let mut runs = [0u32; MOST_GROUPS + 1];
    let rest = tokens(before, raw, |token| match token {
        Token::Bytes(group) => {
            for (i, &byte) in group.iter().enumerate() {
                counts[i % 4][usize::from(byte)] += 1;
            }
        }
        Token::Run(groups) => runs[groups] += 1,
    });
    rest.iter().for_each(|&byte| counts[0][usize::from(byte)] += 1);
    let mut all = [0u32; SYMBOLS];
    for byte in 0..256 {
        all[byte] = counts.iter().map(|part| part[byte]).sum();
    }
    all[END] = 1;
    for (groups, &count) in runs.iter().enumerate().skip(1) {
        all[length_symbol(8 * groups).0] += count;
    }

    let lengths = code_lengths(&all);
    let codes = canonical(&lengths);
    let entry = |symbol: usize| Code { bits: u64::from(codes[symbol]), length: u32::from(lengths[symbol]) };
    let mut literals = [Code::default(); 256];
    for (byte, literal) in literals.iter_mut().enumerate() {
        *literal = entry(byte);
    }
    let mut repetitions = [Code::default(); MOST_GROUPS + 1];
    for (groups, to) in repetitions.iter_mut().enumerate().skip(1) {
        let (symbol, extra_bits, extra) = length_symbol(8 * groups);
        let Code { bits, length } = entry(symbol);
        // It is followed by a distance of 1, whose code is a single 0.
        *to = Code { bits: bits | u64::from(extra) << length, length: length + extra_bits + 1 };
    }

    let of_bytes: u64 = (0..=END).map(|s| u64::from(all[s]) * u64::from(lengths[s])).sum();
    let of_runs: u64 = runs.iter().zip(&repetitions).map(|(&n, code)| u64::from(n) * u64::from(code.length)).sum();
    bits.room(((of_bytes + of_runs) / 8) as usize + TABLE_BYTES);
    put_table(&lengths, bits);
    let rest = tokens(before, raw, |token| match token {
        Token::Bytes(group) => {
            let (fours, _) = group.as_chunks::<4>();
            for four in fours {
                let [a, b, c, d] = four.map(|byte| literals[usize::from(byte)]);
                bits.put_code(a.then(b).then(c.then(d)));
            }
        }
        Token::Run(groups) => bits.put_code(repetitions[groups]),
    });
    for &byte in rest {
        bits.put_code(literals[usize::from(byte)]);
    }
    bits.put_code(entry(END));
}

/// Writes the header of a block that is not the last, and the lengths of its codes: 4 bits each, because compressing
/// them would save only 50 bytes.
fn put_table(lengths: &[u8; SYMBOLS], bits: &mut Bits) {
    bits.put(0b100, 3);
    // All 286 symbols, 1 distance, all 19 symbols of the code of the lengths.
    bits.put(29 | 15 << 10, 14);
    // The lengths 0 to 15 have codes of 4 bits; repetitions of lengths, which come first in the specified order, have
    // none.
    for i in 0..19 {
        bits.put(if i < 3 { 0 } else { 4 }, 3);
    }
    let reversed = |length: u8| u64::from(length.reverse_bits() >> 4);
    lengths.iter().for_each(|&length| bits.put(reversed(length), 4));
    // The code of the distance 1.
    bits.put(reversed(1), 4);
}

/// Returns the symbol of a repetition of 3 to 258 bytes, and the number and value of the extra bits (section 3.2.5).
fn length_symbol(length: usize) -> (usize, u32, u32) {
    const BASES: [usize; 29] = [
        3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227,
        258,
    ];
    let at = BASES.partition_point(|&base| base <= length) - 1;
    let extra_bits = if (8..28).contains(&at) { at as u32 / 4 - 1 } else { 0 };
    (257 + at, extra_bits, (length - BASES[at]) as u32)
}

/// Returns the lengths of codes for symbols with these counts: optimal under [`LONGEST`], or nearly so if that limit
/// applies; 0 for symbols that do not occur. At least two occur.
fn code_lengths(counts: &[u32; SYMBOLS]) -> [u8; SYMBOLS] {
    // From the rarest up; of equally frequent ones the lower symbol first. A block has fewer than 2^23 of each.
    let mut leaves: Vec<u32> = (0..SYMBOLS).filter(|&s| counts[s] > 0).map(|s| counts[s] << 9 | s as u32).collect();
    leaves.sort_unstable();
    let n = leaves.len();
    let root = 2 * n - 2;
    let mut weights = [0u32; 2 * SYMBOLS];
    let mut parents = [0u16; 2 * SYMBOLS];
    for (weight, leaf) in weights.iter_mut().zip(&leaves) {
        *weight = leaf >> 9;
    }
    let (mut leaf, mut inner) = (0, n);
    for node in n..=root {
        for _ in 0..2 {
            let is_leaf = leaf < n && (inner == node || weights[leaf] <= weights[inner]);
            let least = if is_leaf { &mut leaf } else { &mut inner };
            weights[node] += weights[*least];
            parents[*least] = node as u16;
            *least += 1;
        }
    }
    // From the root down: each is one deeper than its parent. Then the number of codes of each length.
    parents[root] = 0;
    let mut of_length = [0usize; LONGEST + 1];
    for node in (0..root).rev() {
        parents[node] = parents[usize::from(parents[node])] + 1;
        if node < n {
            of_length[usize::from(parents[node]).min(LONGEST)] += 1;
        }
    }
    // Codes that were shortened violate Kraft's inequality; lengthening the longest of the others corrects it.
    let mut room: usize = of_length.iter().enumerate().skip(1).map(|(length, &n)| n << (LONGEST - length)).sum();
    while room > 1 << LONGEST {
        of_length[LONGEST] -= 1;
        let parent = (1..LONGEST).rev().find(|&length| of_length[length] > 0).unwrap_or(1);
        of_length[parent] -= 1;
        of_length[parent + 1] += 2;
        room -= 1;
    }
    let mut lengths = [0; SYMBOLS];
    let longest_first = (1..=LONGEST).rev().flat_map(|length| std::iter::repeat_n(length as u8, of_length[length]));
    for (leaf, length) in leaves.iter().zip(longest_first) {
        lengths[(leaf & 511) as usize] = length;
    }
    lengths
}

/// Returns the codes of these lengths (section 3.2.2), first bit lowest.
fn canonical(lengths: &[u8; SYMBOLS]) -> [u16; SYMBOLS] {
    let mut next = [0u16; LONGEST + 2];
    for &length in lengths.iter().filter(|&&length| length > 0) {
        next[usize::from(length) + 1] += 1;
    }
    for length in 1..next.len() {
        next[length] = (next[length] + next[length - 1]) << 1;
    }
    let mut codes = [0; SYMBOLS];
    for (code, &length) in codes.iter_mut().zip(lengths).filter(|(_, length)| **length > 0) {
        let of_length = &mut next[usize::from(length)];
        *code = of_length.reverse_bits() >> (16 - length);
        *of_length += 1;
    }
    codes
}

/// Some bits, first bit lowest, and their number.
#[derive(Debug, Clone, Copy, Default)]
struct Code {
    bits: u64,
    length: u32,
}

impl Code {
    #[inline(always)]
    fn then(self, next: Code) -> Code {
        Code { bits: self.bits | next.bits << self.length, length: self.length + next.length }
    }
}

/// Writes bits from the lowest of each byte up.
struct Bits<'a> {
    out: &'a mut Vec<u8>,
    at: usize,
    /// Fewer than 8 pending bits; above them zeros.
    word: u64,
    held: u32,
}

impl Bits<'_> {
    /// Reserves space for so many bytes and the pending ones.
    fn room(&mut self, bytes: usize) {
        self.out.resize(self.at + bytes + 8, 0);
    }

    fn put(&mut self, bits: u64, length: u32) {
        self.put_code(Code { bits, length });
    }

    /// Appends at most 56 bits.
    #[inline(always)]
    fn put_code(&mut self, code: Code) {
        self.word |= code.bits << self.held;
        self.held += code.length;
        self.out[self.at..self.at + 8].copy_from_slice(&self.word.to_le_bytes());
        self.at += (self.held >> 3) as usize;
        self.word >>= self.held & 0x38;
        self.held &= 7;
    }

    /// Fills the last byte with zeros.
    fn align(&mut self) {
        if self.held > 0 {
            self.put(0, 8 - self.held);
        }
    }

    fn end(self) {
        self.out.truncate(self.at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Decompresses with another implementation.
    fn inflated(stream: &[u8], length: usize) -> Vec<u8> {
        let mut back = Vec::with_capacity(length + 1);
        let mut decoder = flate2::Decompress::new(false);
        decoder.decompress_vec(stream, &mut back, flate2::FlushDecompress::Sync).unwrap();
        back
    }

    fn noise(length: usize) -> Vec<u8> {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        (0..length).map(|_| next()).collect()
    }

    #[test]
    fn another_decoder_gets_the_same_bytes() {
        let noise = noise(300_000);
        let kinds: [&dyn Fn(usize) -> u8; 6] = [
            &|i| noise[i],
            &|_| 0,
            &|i| if i % 1000 < 700 { 5 } else { noise[i] },
            &|i| noise[i] & noise[(i * 7) % 300_000] & noise[(i * 3) % 300_000],
            &|i| (i / 3000) as u8,
            &|i| u8::from(i == 100_000),
        ];
        for (kind, value) in kinds.into_iter().enumerate() {
            for length in [1, 7, 8, 9, 16, 263, 264, 265, 272, 65_535, 65_536, 65_544, 131_072 + 5, 300_000] {
                let raw: Vec<u8> = (0..length).map(value).collect();
                let mut stream = Vec::new();
                deflate(&raw, false, &mut stream);
                assert!(stream.ends_with(&[0, 0, 0xff, 0xff]));
                assert!(
                    stream.len() <= length + length / 100 + 170 * (1 + length / BLOCK),
                    "{} of {length}",
                    stream.len()
                );
                // The next part is compressed separately, and may begin with the previous bytes.
                deflate(&raw[..length.min(100)], true, &mut stream);
                let both = [&raw[..], &raw[..length.min(100)]].concat();
                assert!(inflated(&stream, both.len()) == both, "kind {kind}, {length} bytes");
            }
        }
    }

    #[test]
    fn runs_are_short() {
        let mut stream = Vec::new();
        deflate(&vec![0; 1 << 20], true, &mut stream);
        // Each block has 155 bytes of table, and 256 runs of 7 bits.
        assert!(stream.len() < 16 * (155 + 256 * 7 / 8 + 4), "{}", stream.len());
    }

    /// Counts that grow like Fibonacci numbers give the deepest trees.
    #[test]
    fn no_code_is_too_long_and_all_fit() {
        for symbols in [2, 3, 14, 15, 20, 24] {
            let mut counts = [0u32; SYMBOLS];
            let (mut a, mut b) = (1, 1);
            for count in &mut counts[7..7 + symbols] {
                *count = a;
                (a, b) = (b, a + b);
            }
            let lengths = code_lengths(&counts);
            assert!(counts.iter().zip(lengths).all(|(&n, length)| (n > 0) == (length > 0)));
            let longest = *lengths.iter().max().unwrap();
            assert_eq!(usize::from(longest), (symbols - 1).min(LONGEST));
            let kraft: usize = lengths.iter().filter(|&&l| l > 0).map(|&l| 1 << (LONGEST - usize::from(l))).sum();
            assert_eq!(kraft, 1 << LONGEST, "the code is complete");
            let used: Vec<u8> = lengths[7..7 + symbols].to_vec();
            assert!(used.is_sorted_by(|a, b| a >= b), "rarer symbols have longer codes");
        }
    }

    #[test]
    fn lengths_have_the_symbols_of_the_standard() {
        let expected = [(8, (262, 0, 0)), (16, (267, 1, 1)), (24, (270, 2, 1)), (64, (276, 3, 5)), (256, (284, 5, 29))];
        for (length, symbol) in expected {
            assert_eq!(length_symbol(length), symbol);
        }
    }
}
