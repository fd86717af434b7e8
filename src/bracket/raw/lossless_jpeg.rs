//! Lossless JPEG, in which most DNG files and many camera raw files store their samples.
//!
//! In: a JPEG stream with the frame type SOF3. Out: its [`Samples`], 2 to 16 bits each. Cost: about 8 ns for each
//! sample. Source: ITU-T T.81, annexes C (Huffman tables), F (categories) and H (lossless mode).

use crate::bracket::raw::Reason;
use std::ops::Range;

/// Decoded samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Samples {
    /// Number of samples of a row: those of all components, interleaved.
    pub(super) width: usize,
    pub(super) height: usize,
    /// Row by row.
    pub(super) values: Vec<u16>,
}

/// Markers (T.81, table B.1).
const START: u8 = 0xD8;
const END: u8 = 0xD9;
const LOSSLESS_FRAME: u8 = 0xC3;
const HUFFMAN_TABLES: u8 = 0xC4;
const SCAN: u8 = 0xDA;
const RESTART_INTERVAL: u8 = 0xDD;
const FIRST_RESTART: u8 = 0xD0;

/// Codes up to this length are decoded by one look-up.
const SHORT: u32 = 11;
/// Largest number of components. More than this are not in camera files, and T.81 allows no more in a scan.
const MOST_COMPONENTS: usize = 4;

/// Decodes the stream `bytes`.
///
/// # Errors
/// The reason, if the stream is damaged or no lossless JPEG, or has not `count` samples.
pub(super) fn decode(bytes: &[u8], count: usize) -> Result<Samples, Reason> {
    let mut header = Header::read(bytes)?;
    let (components, (width, height)) = (header.components.len(), header.size);
    if width * components * height != count {
        return Err(damaged(format!("a part has {} samples instead of {count}", width * components * height)));
    }
    let row = width * components;
    let mut values = vec![0u16; count];
    let scan = header.scan.take().ok_or_else(|| damaged("it has no scan".into()))?;
    let interval = if header.interval == 0 { width * height } else { header.interval };
    if !interval.is_multiple_of(width) {
        return Err(damaged("its restart interval is not a number of rows".into()));
    }
    let rows = interval / width;
    let mut bits = Bits::new(bytes, scan.start);
    for first in (0..height).step_by(rows) {
        if first > 0 {
            bits.restart((first / rows - 1) as u8)?;
        }
        let last = (first + rows).min(height);
        for y in first..last {
            let (above, here) = values[..(y + 1) * row].split_at_mut(y * row);
            let above = (y > first).then(|| &above[(y - 1) * row..]);
            match components {
                1 => scan.row::<1>(&mut bits, above, here)?,
                2 => scan.row::<2>(&mut bits, above, here)?,
                3 => scan.row::<3>(&mut bits, above, here)?,
                _ => scan.row::<4>(&mut bits, above, here)?,
            }
        }
    }
    bits.check()?;
    Ok(Samples { width: row, height, values })
}

fn damaged(detail: String) -> Reason {
    format!("its lossless JPEG data is damaged ({detail}); copy the file again")
}

/// What precedes the coded samples.
struct Header {
    /// Width and height, in pixels of each component.
    size: (usize, usize),
    /// Identifiers of the components.
    components: Vec<u8>,
    /// Number of pixels between restarts; 0 for none.
    interval: usize,
    scan: Option<Scan>,
}

/// How the samples are coded.
struct Scan {
    /// Where the coded samples begin in the stream.
    start: usize,
    /// The Huffman table of each component.
    tables: Vec<Table>,
    /// Number of the predictor, 1..=7 (T.81, table H.1).
    predictor: u8,
    /// Prediction of the first sample.
    initial: u16,
    /// Point transform: the samples are shifted to the left by so many bits.
    shift: u32,
}

impl Header {
    fn read(bytes: &[u8]) -> Result<Self, Reason> {
        if bytes.get(..2) != Some(&[0xFF, START]) {
            return Err(damaged("it does not begin as a JPEG".into()));
        }
        let mut header = Header { size: (0, 0), components: Vec::new(), interval: 0, scan: None };
        let mut tables: [Option<Table>; 4] = [const { None }; 4];
        let (mut at, mut precision) = (2, 0);
        loop {
            let (marker, segment) = segment(bytes, at)?;
            let content = &bytes[segment.clone()];
            match marker {
                LOSSLESS_FRAME => precision = header.read_frame(content)?,
                0xC0..=0xC2 | 0xC5..=0xC7 | 0xC9..=0xCF => {
                    return Err(
                        "its JPEG data is not lossless, which is not supported; convert it to a DNG with lossless \
                                compression"
                            .into(),
                    );
                }
                HUFFMAN_TABLES => read_tables(content, &mut tables)?,
                RESTART_INTERVAL => header.interval = usize::from(short(content, 0)?),
                SCAN => {
                    header.scan = Some(header.read_scan(content, segment.end, &tables, precision)?);
                    return Ok(header);
                }
                END => return Err(damaged("it has no scan".into())),
                _ => {}
            }
            at = segment.end;
        }
    }

    /// Reads a frame header, and returns its precision in bits.
    fn read_frame(&mut self, content: &[u8]) -> Result<u32, Reason> {
        let precision = u32::from(byte(content, 0)?);
        self.size = (usize::from(short(content, 3)?), usize::from(short(content, 1)?));
        let count = usize::from(byte(content, 5)?);
        if !(2..=16).contains(&precision) || self.size.0 * self.size.1 == 0 || !(1..=MOST_COMPONENTS).contains(&count) {
            return Err(damaged(format!("{precision} bits, {count} components, {:?} pixels", self.size)));
        }
        for i in 0..count {
            if byte(content, 7 + 3 * i)? != 0x11 {
                return Err(
                    "its lossless JPEG data has components of several sizes, which is not supported; convert it \
                            to DNG"
                        .into(),
                );
            }
            self.components.push(byte(content, 6 + 3 * i)?);
        }
        Ok(precision)
    }

    /// Reads a scan header; the coded samples begin at `start`.
    fn read_scan(
        &self,
        content: &[u8],
        start: usize,
        tables: &[Option<Table>; 4],
        precision: u32,
    ) -> Result<Scan, Reason> {
        let count = usize::from(byte(content, 0)?);
        let is_all = count == self.components.len() && count > 0;
        let mut of_components = Vec::with_capacity(count);
        for (i, id) in self.components.iter().enumerate() {
            let (found, table) = (byte(content, 1 + 2 * i)?, usize::from(byte(content, 2 + 2 * i)? >> 4));
            let table = tables.get(table).and_then(Option::as_ref);
            of_components
                .push(table.filter(|_| is_all && found == *id).ok_or_else(|| damaged("a table is missing".into()))?);
        }
        let end = 1 + 2 * count;
        let (predictor, shift) = (byte(content, end)?, u32::from(byte(content, end + 2)? & 15));
        if !(1..=7).contains(&predictor) || shift >= precision {
            return Err(damaged(format!("predictor {predictor}, point transform {shift}")));
        }
        let tables = of_components.into_iter().cloned().collect();
        Ok(Scan { start, tables, predictor, initial: 1 << (precision - shift - 1), shift })
    }
}

/// Returns the marker at `at`, and where the content of its segment is.
fn segment(bytes: &[u8], mut at: usize) -> Result<(u8, Range<usize>), Reason> {
    let truncated = || damaged("it ends early".into());
    if bytes.get(at) != Some(&0xFF) {
        return Err(if at < bytes.len() { damaged("a marker is missing".into()) } else { truncated() });
    }
    while bytes.get(at + 1) == Some(&0xFF) {
        at += 1;
    }
    let marker = *bytes.get(at + 1).ok_or_else(truncated)?;
    if marker == END {
        return Ok((END, at..at + 2));
    }
    let length = usize::from(short(bytes, at + 2)?);
    let end = at + 2 + length;
    if length < 2 || end > bytes.len() { Err(truncated()) } else { Ok((marker, at + 4..end)) }
}

fn byte(bytes: &[u8], at: usize) -> Result<u8, Reason> {
    bytes.get(at).copied().ok_or_else(|| damaged("it ends early".into()))
}

fn short(bytes: &[u8], at: usize) -> Result<u16, Reason> {
    Ok(u16::from_be_bytes([byte(bytes, at)?, byte(bytes, at + 1)?]))
}

/// Reads the Huffman tables of a segment.
fn read_tables(mut content: &[u8], tables: &mut [Option<Table>; 4]) -> Result<(), Reason> {
    while !content.is_empty() {
        let number = usize::from(byte(content, 0)? & 15);
        let counts: [u8; 16] =
            content.get(1..17).and_then(|c| c.try_into().ok()).ok_or_else(|| damaged("a table ends early".into()))?;
        let total: usize = counts.iter().map(|&c| usize::from(c)).sum();
        let symbols = content.get(17..17 + total).ok_or_else(|| damaged("a table ends early".into()))?;
        let table = Table::new(&counts, symbols)?;
        *tables.get_mut(number).ok_or_else(|| damaged(format!("table {number}")))? = Some(table);
        content = &content[17 + total..];
    }
    Ok(())
}

/// A Huffman table: codes of the categories of differences.
#[derive(Clone)]
struct Table {
    /// For the next [`SHORT`] bits: the length of the code in them, and its category. Length 0: the code is longer.
    short: Vec<[u8; 2]>,
    /// For each length, the first number, in 16 bits, that is beyond the codes of this length (T.81, F.2.2.3).
    limits: [u32; 17],
    /// For each length, what is added to a code to get the index of its category.
    offsets: [i32; 17],
    categories: Vec<u8>,
}

impl Table {
    fn new(counts: &[u8; 16], categories: &[u8]) -> Result<Self, Reason> {
        let is_valid = categories.iter().all(|&c| c <= 16);
        let mut table = Table {
            short: vec![[0, 0]; 1 << SHORT],
            limits: [0; 17],
            offsets: [0; 17],
            categories: categories.to_vec(),
        };
        let (mut code, mut index) = (0u32, 0usize);
        for length in 1..=16u32 {
            let count = usize::from(counts[length as usize - 1]);
            table.offsets[length as usize] = index as i32 - code as i32;
            for _ in 0..count {
                if code >= 1 << length || !is_valid {
                    return Err(damaged("a Huffman table is impossible".into()));
                }
                if length <= SHORT {
                    let first = (code << (SHORT - length)) as usize;
                    table.short[first..first + (1 << (SHORT - length))].fill([length as u8, categories[index]]);
                }
                code += 1;
                index += 1;
            }
            table.limits[length as usize] = code << (16 - length);
            code <<= 1;
        }
        Ok(table)
    }

    /// The length and the category of the code at the beginning of these 16 bits; length 0 if there is none.
    #[inline(always)]
    fn at(&self, next: u32) -> (u32, u32) {
        let [length, category] = self.short[(next >> (16 - SHORT)) as usize];
        if length > 0 { (u32::from(length), u32::from(category)) } else { self.at_long(next) }
    }

    #[cold]
    fn at_long(&self, next: u32) -> (u32, u32) {
        let Some(length) = (SHORT + 1..=16).find(|&length| next < self.limits[length as usize]) else { return (0, 0) };
        let index = (next >> (16 - length)) as i32 + self.offsets[length as usize];
        usize::try_from(index).ok().and_then(|i| self.categories.get(i)).map_or((0, 0), |&c| (length, u32::from(c)))
    }
}

impl Scan {
    /// Decodes a row of `N` interleaved components; `above` is the row above, if it may be used.
    fn row<const N: usize>(&self, bits: &mut Bits, above: Option<&[u16]>, row: &mut [u16]) -> Result<(), Reason> {
        let Some(above) = above else {
            // The first row is predicted from the left, its first sample from the middle of the range.
            return self.samples::<N>(bits, row, [self.initial; N], |_, left, _| left);
        };
        let start: [u16; N] = std::array::from_fn(|c| above[c] >> self.shift);
        let shift = self.shift;
        // The samples above and to the left of it; the arithmetic is modulo 2^16.
        let up = |i: usize| above[i] >> shift;
        let up_left = |i: usize| above[i - N] >> shift;
        let half = |a: u16, b: u16| ((i32::from(a) - i32::from(b)) >> 1) as u16;
        match self.predictor {
            1 => self.samples::<N>(bits, row, start, |_, left, _| left),
            2 => self.samples::<N>(bits, row, start, |i, _, _| up(i)),
            3 => self.samples::<N>(bits, row, start, |i, _, _| up_left(i)),
            4 => self.samples::<N>(bits, row, start, |i, left, _| left.wrapping_add(up(i)).wrapping_sub(up_left(i))),
            5 => self.samples::<N>(bits, row, start, |i, left, _| left.wrapping_add(half(up(i), up_left(i)))),
            6 => self.samples::<N>(bits, row, start, |i, left, _| up(i).wrapping_add(half(left, up_left(i)))),
            _ => self.samples::<N>(bits, row, start, |i, left, _| ((u32::from(left) + u32::from(up(i))) / 2) as u16),
        }
    }

    /// Decodes a row: the first sample of each component is predicted by `start`, the others by `predicted` from their
    /// index and the sample to the left.
    #[inline(always)]
    fn samples<const N: usize>(
        &self,
        bits: &mut Bits,
        row: &mut [u16],
        start: [u16; N],
        predicted: impl Fn(usize, u16, usize) -> u16,
    ) -> Result<(), Reason> {
        let tables: [&Table; N] = std::array::from_fn(|c| &self.tables[c]);
        let mut left = start;
        for (x, pixel) in row.chunks_exact_mut(N).enumerate() {
            for c in 0..N {
                let prediction = if x == 0 { left[c] } else { predicted(x * N + c, left[c], c) };
                let value = prediction.wrapping_add(bits.difference(tables[c]));
                left[c] = value;
                pixel[c] = value << self.shift;
            }
        }
        if bits.is_beyond() { bits.check() } else { Ok(()) }
    }
}

/// The bits of the coded samples, without stuffed bytes (T.81, F.1.2.3).
struct Bits<'a> {
    bytes: &'a [u8],
    /// The next byte to take.
    at: usize,
    /// The next bits, at the top.
    held: u64,
    /// How many of them are from the stream.
    count: u32,
    /// How many bits were used that the stream does not have.
    missing: u32,
    /// Whether there was a code that no table has.
    is_bad: bool,
}

impl<'a> Bits<'a> {
    fn new(bytes: &'a [u8], at: usize) -> Self {
        Bits { bytes, at, held: 0, count: 0, missing: 0, is_bad: false }
    }

    /// Takes bytes until at least 48 bits are held, or a marker follows.
    #[inline(always)]
    fn fill(&mut self) {
        if let Some(next) = self.bytes.get(self.at..self.at + 8) {
            let next = u64::from_be_bytes([next[0], next[1], next[2], next[3], next[4], next[5], next[6], next[7]]);
            // Whether a byte is 0xFF: its complement has a zero byte.
            let no_ff = (!next).wrapping_sub(0x0101_0101_0101_0101) & next & 0x8080_8080_8080_8080 == 0;
            if no_ff {
                self.held |= next >> self.count;
                let taken = (63 - self.count) / 8;
                self.at += taken as usize;
                self.count += 8 * taken;
                // Bits of the next byte may be held already; they are the same when they are taken again.
                return;
            }
        }
        self.fill_slowly();
    }

    #[cold]
    fn fill_slowly(&mut self) {
        self.held &= if self.count == 0 { 0 } else { !0 << (64 - self.count) };
        while self.count <= 56 {
            let Some(&byte) = self.bytes.get(self.at) else { return };
            if byte == 0xFF {
                if self.bytes.get(self.at + 1) != Some(&0) {
                    return;
                }
                self.at += 1;
            }
            self.at += 1;
            self.held |= u64::from(byte) << (56 - self.count);
            self.count += 8;
        }
    }

    /// Decodes a difference.
    #[inline(always)]
    fn difference(&mut self, table: &Table) -> u16 {
        if self.count < 32 {
            self.fill();
        }
        let (length, category) = table.at((self.held >> 48) as u32);
        self.is_bad |= length == 0;
        let rest = self.held << length;
        // Category 16 is the difference 32768, and has no more bits (T.81, H.1.2.2).
        let extra = if category == 16 { 0 } else { category };
        self.take(length + extra);
        if extra == 0 {
            return if category == 16 { 1 << 15 } else { 0 };
        }
        let value = (rest >> (64 - extra)) as u32;
        let is_negative = value >> (extra - 1) == 0;
        if is_negative { value.wrapping_sub((1 << extra) - 1) as u16 } else { value as u16 }
    }

    #[inline(always)]
    fn take(&mut self, count: u32) {
        self.held <<= count;
        match self.count.checked_sub(count) {
            Some(left) => self.count = left,
            None => {
                self.missing += count - self.count;
                (self.count, self.held) = (0, 0);
            }
        }
    }

    fn is_beyond(&self) -> bool {
        self.is_bad || self.missing > 0
    }

    /// # Errors
    /// The reason, if the stream had not all bits.
    fn check(&self) -> Result<(), Reason> {
        match (self.missing, self.is_bad) {
            (0, false) => Ok(()),
            (0, true) => Err(damaged("a code is unknown".into())),
            _ => Err(damaged("it ends early".into())),
        }
    }

    /// Goes on after the restart marker with this number, modulo 8.
    fn restart(&mut self, number: u8) -> Result<(), Reason> {
        self.check()?;
        // Only bits that fill up a byte may be left before the marker.
        self.fill_slowly();
        let marker = self.bytes.get(self.at..self.at + 2);
        if self.count >= 8 || marker != Some(&[0xFF, FIRST_RESTART + number % 8]) {
            return Err(damaged("a restart marker is missing".into()));
        }
        *self = Bits::new(self.bytes, self.at + 2);
        Ok(())
    }
}

#[cfg(test)]
pub(super) mod tests;
