//! Parses the markers of a JPEG up to the end of its first image.
//!
//! In: the file. Out: the positions of its parts, and the values of its frame and scan headers. Cost: one search for
//! 0xFF through the file. Source: ITU-T T.81, annex B.

use super::Reason;
use std::ops::Range;

/// Start-of-frame marker code of JPEG-LS (ITU-T T.87, annex C).
pub(super) const JPEG_LS: u8 = 0xF7;

/// Segments and headers of the first image.
#[derive(Default)]
pub(super) struct Layout {
    pub exif: Option<Range<usize>>,
    pub adobe: bool,
    /// Width and height, in pixels.
    pub size: (usize, usize),
    /// The horizontal and vertical sampling factor of each component.
    pub sampling: Vec<[u8; 2]>,
    pub progressive: bool,
    /// Ranges of bytes between segments that must be removed before decoding.
    pub junk: Vec<Range<usize>>,
    /// For each component: its identifier, and for each of its 64 coefficients, 1 plus the lowest bit that was sent, or
    /// 0 if the coefficient was not sent.
    sent: Vec<(u8, [u8; 64])>,
    /// Index just past the entropy-coded data of each scan.
    pub scan_ends: Vec<usize>,
    /// Index just past the end marker.
    pub end: usize,
}

impl Layout {
    pub fn of(bytes: &[u8]) -> Result<Self, Reason> {
        let truncated = || {
            let kb = bytes.len().div_ceil(1000);
            format!("it ends before the end of the picture, after {kb} kB (truncated); copy the file again")
        };
        let mut layout = Layout::default();
        let mut at = 2;
        loop {
            let marker = next_marker(bytes, at).ok_or_else(truncated)?;
            // `marker` is the index of the marker's code. One or more 0xFF are before the code; `first_ff` is the index
            // of the first of them.
            let first_ff = bytes[at..marker].iter().rposition(|&b| b != 0xFF).map_or(at, |i| at + i + 1);
            if first_ff > at {
                layout.junk.push(at..first_ff);
            }
            at = marker + 1;
            match bytes[marker] {
                0xD9 => {
                    layout.end = at;
                    return if layout.scan_ends.is_empty() {
                        Err("it contains no picture data; copy the file again".into())
                    } else {
                        Ok(layout)
                    };
                }
                // The marker TEM has no content and no length, but decoders expect a length, so it is removed.
                0x01 => layout.junk.push(first_ff..at),
                0xD0..=0xD8 => continue,
                code => {
                    let length = bytes.get(at..at + 2).ok_or_else(truncated)?;
                    let length = usize::from(u16::from_be_bytes([length[0], length[1]]));
                    let body = at + 2..at + length;
                    let content = bytes.get(body.clone()).ok_or_else(truncated)?;
                    at += length;
                    layout.segment(code, content, body)?;
                    if code == 0xDA {
                        at = scan_end(bytes, at).ok_or_else(truncated)?;
                        // Fill bytes (0xFF) may precede the marker that ends the scan; they are not data.
                        let fill = bytes[..at].iter().rev().take_while(|&&b| b == 0xFF).count();
                        layout.scan_ends.push(at - fill);
                    }
                }
            }
        }
    }

    pub fn segment(&mut self, code: u8, content: &[u8], at: Range<usize>) -> Result<(), Reason> {
        match code {
            0xE1 if self.exif.is_none() && content.starts_with(b"Exif\0") && content.len() > 6 => {
                self.exif = Some(at.start + 6..at.end);
            }
            0xEE if content.starts_with(b"Adobe") => self.adobe = true,
            0xC0..=0xC2 => {
                let depth = content.first().copied().unwrap_or(0);
                if depth != 8 {
                    return Err(format!("its samples have {depth} bits, which is not supported; save it with 8 bits"));
                }
                self.progressive = code == 0xC2;
                let number = |at: usize| Some(u16::from_be_bytes([*content.get(at)?, *content.get(at + 1)?]).into());
                self.size = (number(3).unwrap_or(0), number(1).unwrap_or(0));
                let components = content[6.min(content.len())..].chunks_exact(3);
                self.sampling = components.clone().map(|c| [c[1] >> 4, c[1] & 15]).collect();
                self.sent = components.map(|c| (c[0], [0; 64])).collect();
                self.check_sampling()?;
            }
            0xC3 | 0xC5..=0xC7 | 0xC9..=0xCB | 0xCD..=0xCF => {
                return Err("it is lossless, hierarchical or arithmetic-coded JPEG, which is not supported; save it as baseline JPEG".into());
            }
            JPEG_LS => return Err("it is JPEG-LS, which is not supported; save it as baseline JPEG".into()),
            0xDA => {
                let count = usize::from(content.first().copied().unwrap_or(0));
                let (Some(of), Some(&[first, last, bits])) =
                    (content.get(1..1 + 2 * count), content.get(1 + 2 * count..4 + 2 * count))
                else {
                    return Err("its scan header is damaged; copy the file again".into());
                };
                for id in of.iter().step_by(2) {
                    for (_, coefficients) in self.sent.iter_mut().filter(|(own, _)| own == id) {
                        let band = usize::from(first.min(63))..=usize::from(last.min(63));
                        coefficients.get_mut(band).into_iter().flatten().for_each(|c| *c = 1 + (bits & 15));
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Returns the largest sampling factor of any component along `axis`: 0 is across, 1 is down.
    fn finest(&self, axis: usize) -> u8 {
        self.sampling.iter().map(|own| own[axis]).max().unwrap_or(1)
    }

    /// Rejects sampling factors that do not divide the largest one, and a horizontal factor of 3, which zune-jpeg does
    /// not support.
    fn check_sampling(&self) -> Result<(), Reason> {
        let is_fraction =
            |own: &[u8; 2]| (0..2).any(|axis| own[axis] > 0 && !self.finest(axis).is_multiple_of(own[axis]));
        match self.sampling.iter().find(|own| own[0] == 3 || is_fraction(own)) {
            Some([across, down]) => {
                let reason = "which is not supported; save it as baseline JPEG";
                Err(format!("one of its components has the sampling factors {across}x{down}, {reason}"))
            }
            None => Ok(()),
        }
    }

    /// Whether zune-jpeg decodes the pixels of this file wrongly.
    pub fn is_beyond_zune(&self) -> bool {
        let size = [self.size.0, self.size.1];
        let is_finer_than_first = |own: &[u8; 2]| (0..2).any(|axis| own[axis] > self.sampling[0][axis]);
        // A sample at half the resolution covers two pixels. The second of them is interpolated between this sample and
        // the next one. The last sample of a row or column covers two pixels if the number of pixels is even; the
        // sample after it is padding if the picture does not fill the last MCU.
        let is_mixed_with_padding = |axis: usize| {
            let finest = self.finest(axis);
            let is_padded = size[axis].is_multiple_of(2) && !size[axis].is_multiple_of(8 * usize::from(finest));
            is_padded && self.sampling.iter().any(|own| 2 * own[axis] == finest)
        };
        !self.progressive && self.scan_ends.len() > 1
            || self.sampling.iter().any(is_finer_than_first)
            || (0..2).any(is_mixed_with_padding)
    }

    /// Checks that every component was sent and, in a progressive file, every coefficient down to bit 0.
    pub fn check_complete(&self) -> Result<(), Reason> {
        let whole = |sent: &[u8; 64]| {
            if self.progressive { sent.iter().all(|&c| c == 1) } else { sent[0] > 0 }
        };
        if self.sent.is_empty() || !self.sent.iter().all(|(_, sent)| whole(sent)) {
            return Err("it is incomplete: some of its JPEG scans are missing (truncated); copy the file again".into());
        }
        Ok(())
    }
}

/// Returns the index of the code of the next marker at or after `at`; `None` where there is none.
fn next_marker(bytes: &[u8], mut at: usize) -> Option<usize> {
    loop {
        at += first_ff(bytes.get(at..)?)?;
        let code = at + bytes[at..].iter().position(|&b| b != 0xFF)?;
        if bytes[code] != 0 {
            return Some(code);
        }
        at = code + 1;
    }
}

/// Returns the index of the first 0xFF. Searches 32 bytes at a time, since in entropy-coded data about one byte in 200
/// is 0xFF.
fn first_ff(bytes: &[u8]) -> Option<usize> {
    let (groups, _) = bytes.as_chunks::<32>();
    let holds_one = |group: &[u8; 32]| group.iter().fold(false, |any, &b| any | (b == 0xFF));
    let skipped = 32 * groups.iter().position(holds_one).unwrap_or(groups.len());
    bytes[skipped..].iter().position(|&b| b == 0xFF).map(|i| skipped + i)
}

/// Returns the index of the 0xFF of the marker that ends the entropy-coded data that begins at `at`; restart markers
/// belong to the data.
fn scan_end(bytes: &[u8], mut at: usize) -> Option<usize> {
    loop {
        let code = next_marker(bytes, at)?;
        if !(0xD0..=0xD7).contains(&bytes[code]) {
            return Some(code - 1);
        }
        at = code + 1;
    }
}
