//! The Huffman coding of PIZ: a table of code lengths, then the codes of 16-bit values and of runs of equal values.
//!
//! In: values. Out: the table and the codes, highest bit first. Cost: 2 to 3 ns per value, and 1 ms for the table of
//! 10,000 different values. Source: `ImfHuf.cpp` (`hufCompress`); D. A. Huffman, "A Method for the Construction of
//! Minimum-Redundancy Codes", Proc. IRE 40 (1952). Two sorted queues of nodes instead of a heap are from J. van
//! Leeuwen, "On the construction of Huffman trees" (1976).
//!
//! If two nodes are equally frequent, the node with the lower symbol comes first; an inner node has the symbol of its
//! second child. This rule determines the code lengths, and thereby every byte of the output.

/// Number of symbols: all 16-bit values, and the symbol for runs, which follows the largest value that occurs.
const SYMBOLS: usize = (1 << 16) + 1;

/// Length, in bits, of the longest code that a table can represent; codes of blocks with fewer than 2^39 values are
/// shorter.
const LONGEST: usize = 58;

/// The table of code lengths stores runs of empty entries. Runs of `LONG_RUN` to `MOST_RUN` entries take 14 bits,
/// shorter runs take 6 bits.
const LONG_RUN: usize = 6;
const MOST_RUN: usize = 255 + LONG_RUN;

/// Encodes blocks; keeps its tables from block to block.
#[derive(Debug)]
pub(super) struct Coder {
    /// Two counters for each value, one for values at even positions and one for values at odd positions. With a
    /// single counter, the increments for two equal neighbours would wait for each other.
    counts: Box<[[u32; 1 << 16]; 2]>,
    /// The code of every symbol, shifted left by 6 bits to make room for its length; 0 for symbols that do not occur.
    codes: Box<[u64; SYMBOLS]>,
    /// The frequency of every symbol that occurs, shifted left by 17 bits to make room for the symbol; the rarest
    /// first.
    leaves: Vec<u64>,
    /// For every inner node, a key as in `leaves`, and the number of the node among all nodes; the rarest first.
    inner: Vec<(u64, u32)>,
    /// For every node, leaves first: the number of its parent, later replaced by the depth of the node.
    parents: Vec<u32>,
}

impl Default for Coder {
    fn default() -> Self {
        Coder {
            counts: Box::new([[0; 1 << 16]; 2]),
            codes: Box::new([0; SYMBOLS]),
            leaves: Vec::new(),
            inner: Vec::new(),
            parents: Vec::new(),
        }
    }
}

impl Coder {
    /// Appends the header, the table and the codes for `values`, which must not be empty.
    pub(super) fn encode(&mut self, values: &[u16], out: &mut Vec<u8>) {
        let (first, last) = self.count(values);
        let most_bits = self.assign_lengths();
        self.assign_codes(first, last);
        let start = out.len();
        out.extend_from_slice(&[0; 20]);
        self.put_table(first, last, out);
        let table = out.len() - start - 20;
        let bits = self.put_values(values, last, most_bits, out);
        let header = [first as u32, last as u32, table as u32, bits as u32, 0];
        for (to, number) in out[start..].chunks_exact_mut(4).zip(header) {
            to.copy_from_slice(&number.to_le_bytes());
        }
        self.codes[first..=last].fill(0);
    }

    /// Counts the values and fills `leaves`. Returns the first and the last symbol that occur. The last is the symbol
    /// for runs, one above the largest value.
    fn count(&mut self, values: &[u16]) -> (usize, usize) {
        let [even, odd] = &mut *self.counts;
        let (pairs, rest) = values.as_chunks::<2>();
        for &[a, b] in pairs {
            even[usize::from(a)] += 1;
            odd[usize::from(b)] += 1;
        }
        for &value in rest {
            even[usize::from(value)] += 1;
        }
        self.leaves.clear();
        // Most counters are 0, so they are read in groups of 16, and groups without a count are skipped.
        for (at, (even, odd)) in even.as_chunks_mut::<16>().0.iter_mut().zip(odd.as_chunks_mut::<16>().0).enumerate() {
            if (0..16).fold(0, |any, i| any | even[i] | odd[i]) == 0 {
                continue;
            }
            for i in 0..16 {
                let count = u64::from(even[i]) + u64::from(odd[i]);
                if count > 0 {
                    self.leaves.push(count << 17 | (16 * at + i) as u64);
                }
            }
            (*even, *odd) = ([0; 16], [0; 16]);
        }
        let symbol = |leaf: u64| (leaf & 0x1_ffff) as usize;
        let first = self.leaves.first().map_or(0, |&leaf| symbol(leaf));
        let runs = self.leaves.last().map_or(0, |&leaf| symbol(leaf)) + 1;
        self.leaves.push(1 << 17 | runs as u64);
        self.leaves.sort_unstable();
        (first, runs)
    }

    /// Writes the length of the code of every symbol to `codes`. Returns the number of bits of all values, if none is
    /// encoded as a run, plus the bits of one code for runs.
    fn assign_lengths(&mut self) -> u64 {
        let Coder { codes, leaves, inner, parents, .. } = self;
        let leaf_count = leaves.len();
        parents.clear();
        parents.resize(2 * leaf_count - 1, 0);
        inner.clear();
        let (mut next_leaf, mut next_inner) = (0, 0);
        for node in leaf_count..2 * leaf_count - 1 {
            // Takes the node with the smallest key from `leaves` and `inner`; called twice for each new node.
            let mut least = || {
                let inner_key = inner.get(next_inner).map_or(u64::MAX, |n: &(u64, u32)| n.0);
                let leaf_key = leaves.get(next_leaf).map_or(u64::MAX, |&key| key);
                if leaf_key < inner_key {
                    next_leaf += 1;
                    (leaf_key, next_leaf - 1)
                } else {
                    next_inner += 1;
                    (inner_key, inner[next_inner - 1].1 as usize)
                }
            };
            let ((rare, a), (frequent, b)) = (least(), least());
            (parents[a], parents[b]) = (node as u32, node as u32);
            // The key contains the sum of the frequencies and the symbol of the second child. No previous inner node
            // is more frequent, but an equally frequent one may have a larger symbol; the new node is inserted before
            // it.
            let key = frequent + (rare >> 17 << 17);
            let mut at = inner.len();
            while at > next_inner && inner[at - 1].0 > key {
                at -= 1;
            }
            inner.insert(at, (key, node as u32));
        }
        // Depths are computed from the root, which is the last node, downwards: each node is one deeper than its
        // parent.
        let root = 2 * leaf_count - 2;
        parents[root] = 0;
        for node in (0..root).rev() {
            parents[node] = parents[parents[node] as usize] + 1;
        }
        leaves.iter().zip(parents.iter()).fold(0, |bits, (&leaf, &length)| {
            codes[(leaf & 0x1_ffff) as usize] = u64::from(length);
            bits + (leaf >> 17) * u64::from(length)
        })
    }

    /// Assigns the canonical codes: longer codes have lower values; codes of the same length rise with the symbol.
    fn assign_codes(&mut self, first: usize, last: usize) {
        let mut next = [0u64; LONGEST + 1];
        let codes = &mut self.codes[first..=last];
        for &length in codes.iter().filter(|&&length| length > 0) {
            next[length as usize] += 1;
        }
        let mut code = 0;
        for count in next.iter_mut().rev() {
            let above = (code + *count) >> 1;
            *count = code;
            code = above;
        }
        for entry in codes.iter_mut().filter(|entry| **entry > 0) {
            let length = *entry;
            let code = &mut next[length as usize];
            *entry = *code << 6 | length;
            *code += 1;
        }
    }

    /// Writes the lengths of the codes, 6 bits each; symbols that do not occur are written as runs.
    fn put_table(&self, first: usize, last: usize, out: &mut Vec<u8>) {
        let codes = &self.codes[first..=last];
        // One byte for each entry is enough: an entry takes at most 6 bits, and a run of six or more entries takes
        // only 14 bits.
        let mut bits = Bits::within(out, codes.len() + 8);
        let mut at = 0;
        while at < codes.len() {
            if codes[at] > 0 {
                bits.put(codes[at] & 63, 6);
                at += 1;
                continue;
            }
            // Every run ends before the last symbol, because that symbol occurs.
            let run = codes[at..].iter().take(MOST_RUN).take_while(|&&code| code == 0).count();
            match run {
                1 => bits.put(0, 6),
                ..LONG_RUN => bits.put((59 + run - 2) as u64, 6),
                _ => bits.put((63 << 8 | (run - LONG_RUN)) as u64, 14),
            }
            at += run;
        }
        bits.end();
    }

    /// Writes the codes of the values. Repetitions are written with the symbol `runs` where that is shorter, so at
    /// most `most_bits` bits are written. Returns the number of bits.
    fn put_values(&self, values: &[u16], runs: usize, most_bits: u64, out: &mut Vec<u8>) -> u64 {
        let codes = &self.codes[..];
        let of_runs = codes[runs];
        let mut bits = Bits::within(out, (most_bits / 8) as usize + 16);
        let mut at = 0;
        while at < values.len() {
            let value = values[at];
            let code = codes[usize::from(value)];
            at += 1;
            // Usually neither this value nor the next is repeated. The codes of both are then written in one step, if
            // they have at most 56 bits together.
            if let Some(&[next, after]) = values[at..].first_chunk::<2>()
                && (next != value) & (after != next)
            {
                let other = codes[usize::from(next)];
                let (length, more) = (code & 63, other & 63);
                if length + more <= 56 {
                    bits.put((code >> 6) << more | other >> 6, length + more);
                    at += 1;
                    continue;
                }
            }
            if values.get(at) != Some(&value) {
                bits.put(code >> 6, code & 63);
                continue;
            }
            // Number of repetitions after the first value.
            let again = values[at..].iter().take(255).take_while(|&&v| v == value).count();
            at += again;
            let length = code & 63;
            if length + (of_runs & 63) + 8 < length * again as u64 {
                bits.put(code >> 6, length);
                bits.put(of_runs >> 6, of_runs & 63);
                bits.put(again as u64, 8);
            } else {
                for _ in 0..=again {
                    bits.put(code >> 6, length);
                }
            }
        }
        bits.end()
    }
}

/// Appends bits to `out`, from the highest bit of each byte down.
struct Bits<'a> {
    out: &'a mut Vec<u8>,
    start: usize,
    at: usize,
    /// The last `held` bits, which do not fill a byte yet, at the top of the word; the other bits of the word are 0.
    word: u64,
    held: u64,
}

impl<'a> Bits<'a> {
    /// Creates a writer with room for `bytes` bytes. This must be 8 bytes more than needed, because
    /// [`put`](Self::put) always writes 8 bytes.
    fn within(out: &'a mut Vec<u8>, bytes: usize) -> Self {
        let start = out.len();
        out.resize(start + bytes, 0);
        Bits { out, start, at: start, word: 0, held: 0 }
    }

    /// Appends the low `count` bits of `bits`, at most 56. The higher bits of `bits` must be 0.
    #[inline(always)]
    fn put(&mut self, bits: u64, count: u64) {
        self.held += count;
        self.word |= bits << (64 - self.held);
        // All 8 bytes are written. Bytes that are not full yet are overwritten by the next call.
        self.out[self.at..self.at + 8].copy_from_slice(&self.word.to_be_bytes());
        self.at += (self.held >> 3) as usize;
        self.word <<= self.held & 0x38;
        self.held &= 7;
    }

    /// Fills the last byte with zeros and returns the number of bits.
    fn end(self) -> u64 {
        let count = (self.at - self.start) as u64 * 8 + self.held;
        self.out.truncate(self.at + usize::from(self.held > 0));
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The reference implementation: returns (symbol, length of its code) for all symbols that occur. It repeatedly
    /// joins the two rarest nodes of a sorted list, where `ImfHuf.cpp` uses a heap, and counts depths.
    fn textbook(values: &[u16]) -> Vec<(usize, u64)> {
        let mut counts = std::collections::BTreeMap::new();
        values.iter().for_each(|&v| *counts.entry(usize::from(v)).or_insert(0u64) += 1);
        let runs = *counts.keys().last().unwrap() + 1;
        counts.insert(runs, 1);
        let mut nodes: Vec<(u64, usize, Vec<usize>)> = counts.iter().map(|(&s, &n)| (n, s, vec![s])).collect();
        let mut lengths: std::collections::BTreeMap<usize, u64> = counts.keys().map(|&s| (s, 0)).collect();
        while nodes.len() > 1 {
            nodes.sort_by_key(|node| std::cmp::Reverse((node.0, node.1)));
            let (rare, second) = (nodes.pop().unwrap(), nodes.pop().unwrap());
            let leaves = [second.2, rare.2].concat();
            leaves.iter().for_each(|s| *lengths.get_mut(s).unwrap() += 1);
            nodes.push((rare.0 + second.0, second.1, leaves));
        }
        lengths.into_iter().collect()
    }

    #[test]
    fn lengths_are_those_of_a_heap() {
        let mut coder = Coder::default();
        for kind in 0..40u64 {
            let mut state = kind;
            let values: Vec<u16> = (0..30 * (kind as usize + 1))
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    // The distributions range from uniform to steep.
                    let v = (state >> 48) as u16;
                    (0..kind % 4).fold(v % 300, |v, _| v & (state >> 33) as u16)
                })
                .collect();
            let (first, last) = coder.count(&values);
            coder.assign_lengths();
            let ours: Vec<(usize, u64)> =
                (first..=last).map(|s| (s, coder.codes[s])).filter(|(_, length)| *length > 0).collect();
            assert_eq!(ours, textbook(&values), "kind {kind}");
            coder.codes.fill(0);
            assert!(coder.counts.as_flattened().iter().all(|&n| n == 0));
        }
    }

    #[test]
    fn bits_come_from_the_top_down() {
        let mut out = vec![9];
        let mut bits = Bits::within(&mut out, 24);
        for (value, count) in [(0b101, 3), (0, 5), (0x1_2345_6789_abcd, 56), (1, 1)] {
            bits.put(value, count);
        }
        assert_eq!(bits.end(), 65);
        assert_eq!(out, [9, 0b1010_0000, 0x01, 0x23, 0x45, 0x67, 0x89, 0xab, 0xcd, 0x80]);
    }
}
