//! Limits: what a file may ask for, held against what it says of itself before anything is allocated for it.
//!
//! In: sizes out of headers. Out: whether they are allowed, or why not and what to do about it. Cost: none to speak of. A file of a few
//! kilobytes can say to hold terabytes, and can pack gigabytes of zeros; what is believed of it is bounded here.

use std::hint::black_box;

/// What files may ask for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Limits {
    /// The most pixels that a picture may have. Default: [`MAX_PIXELS`](Self::MAX_PIXELS).
    pub max_pixels: u64,
    /// The most memory that one file and its picture may take while it is decoded, and what is made of it then, in bytes. Default: as much as the
    /// system gives.
    pub memory: Option<u64>,
}

impl Default for Limits {
    fn default() -> Self {
        Limits { max_pixels: Limits::MAX_PIXELS, memory: None }
    }
}

/// What the system must be able to give beside a picture, so that it is refused here rather than where nothing can be done about it.
const BESIDE: u64 = 16 << 20;

impl Limits {
    /// 500 million: more than any camera makes, those that shift their sensor (400 million) included; 1.5 GB at 8 bit.
    pub const MAX_PIXELS: u64 = 500_000_000;

    /// Bytes that a pixel takes in a file at most, in the formats that are read: four floats.
    const MOST_OF_A_PIXEL: u64 = 16;

    /// Refuses sizes that are empty or of too many pixels.
    ///
    /// # Errors
    /// The reason and the remedy.
    pub(crate) fn check_size(&self, width: usize, height: usize) -> Result<(), String> {
        let pixels = width as u128 * height as u128;
        if pixels == 0 {
            return Err("it has no pixels".into());
        }
        if pixels > u128::from(self.max_pixels) {
            return Err(format!(
                "it says to be {width}x{height} pixels, more than the {} allowed; if it is, allow it with --max-pixels, as in `--max-pixels {}M`; else it is damaged, copy it again",
                words(self.max_pixels),
                pixels.div_ceil(1_000_000)
            ));
        }
        Ok(())
    }

    /// These limits where so many `bytes` of the memory are held already.
    pub(crate) fn beside(&self, bytes: u64) -> Limits {
        Limits { memory: self.memory.map(|memory| memory.saturating_sub(bytes)), ..*self }
    }

    /// Refuses what takes `bytes` while it is decoded, where that is more than is allowed or than the system gives.
    ///
    /// # Errors
    /// The reason and the remedy.
    pub(crate) fn check_memory(&self, size: (usize, usize), bytes: u64) -> Result<(), String> {
        self.check_memory_while("decoded", size, bytes)
    }

    /// The same of what is `done` to the picture, in a word.
    ///
    /// # Errors
    /// The reason and the remedy.
    pub(crate) fn check_memory_while(
        &self,
        done: &str,
        (width, height): (usize, usize),
        bytes: u64,
    ) -> Result<(), String> {
        let needs =
            || format!("its {width}x{height} pixels need {} MB while they are {done}", bytes.div_ceil(1_000_000));
        if let Some(allowed) = self.memory.filter(|&allowed| bytes > allowed) {
            let allowed = allowed / 1_000_000;
            return Err(format!(
                "{}, more than the {allowed} MB that the memory allowed leaves for it; allow more with --max-memory, or scale it down",
                needs()
            ));
        }
        if !is_given(bytes) {
            let reason = "and the system does not give that much memory; end other programs, raise `ulimit -v`, or scale all frames down";
            return Err(format!("{}, {reason}", needs()));
        }
        Ok(())
    }

    /// The most bytes that a file is read of: what its pixels could take unpacked, and as much again as cameras write beside them.
    pub(crate) fn most_bytes(&self) -> u64 {
        let by_pixels = self.max_pixels.saturating_mul(Limits::MOST_OF_A_PIXEL).saturating_add(256 << 20);
        self.memory.map_or(by_pixels, |memory| memory.min(by_pixels))
    }
}

/// Whether the system gives `bytes` of memory, and a little beside. None of them are touched, so it costs no more than to ask.
pub(crate) fn is_given(bytes: u64) -> bool {
    let Ok(bytes) = usize::try_from(bytes.saturating_add(BESIDE)) else { return false };
    let mut asked: Vec<u8> = Vec::new();
    let given = asked.try_reserve_exact(bytes).is_ok();
    // What is never looked at need not be asked for, a compiler would say.
    black_box(asked.as_ptr());
    given
}

/// How many bytes deflate makes of one at best: 258 of 2 bits (RFC 1951).
pub(crate) const DEFLATE: u64 = 1032;

/// The same of a TIFF's packings (TIFF 6.0, sections 9 and 13); of those that know no bound, any.
pub(crate) fn tiff_packing(compression: u32) -> u64 {
    match compression {
        1 => 1,
        32773 => 64,
        // A code of 12 bits stands for less than 4096 bytes.
        5 => 4096 * 2 / 3,
        8 | 32946 => DEFLATE,
        _ => u64::MAX,
    }
}

/// Refuses a file of `length` bytes that cannot hold `bytes` of pixels by a packing that makes of one byte `most` at best: what is not there
/// needs no room.
///
/// # Errors
/// The reason and the remedy.
pub(crate) fn check_length(length: usize, bytes: u64, most: u64) -> Result<(), String> {
    if bytes / most > length as u64 {
        return Err("it is too short for its size (truncated); copy the file again".into());
    }
    Ok(())
}

/// Room for `count` values that are about to be decoded.
///
/// # Errors
/// The reason and the remedy.
pub(crate) fn reserved<T>(count: usize) -> Result<Vec<T>, String> {
    let mut values = Vec::new();
    let refused =
        |_| "the system does not give the memory for its pixels; end other programs, or scale all frames down";
    values.try_reserve_exact(count).map_err(refused)?;
    Ok(values)
}

/// The same, all of them zero.
///
/// # Errors
/// The reason and the remedy.
pub(crate) fn room<T: Copy + Default>(count: usize) -> Result<Vec<T>, String> {
    let mut values = reserved(count)?;
    values.resize(count, T::default());
    Ok(values)
}

/// `count` as people say it.
fn words(count: u64) -> String {
    if count >= 1_000_000 { format!("{} million", count / 1_000_000) } else { count.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_refused_with_the_number_that_would_do() {
        let limits = Limits::default();
        assert_eq!(limits.check_size(25_000, 20_000), Ok(()));
        let reason = limits.check_size(25_000, 20_001).unwrap_err();
        assert!(
            reason.contains("25000x20001") && reason.contains("500 million") && reason.contains("--max-pixels 501M")
        );
        assert!(limits.check_size(usize::MAX, usize::MAX).unwrap_err().contains("--max-pixels"), "no overflow");
        assert!(limits.check_size(0, 7).is_err() && limits.check_size(7, 0).is_err());
        assert!(Limits { max_pixels: 99, memory: None }.check_size(10, 10).unwrap_err().contains("the 99 allowed"));
    }

    #[test]
    fn memory_is_refused_by_what_is_allowed_and_by_what_there_is() {
        let limits = Limits { memory: Some(300_000_000), ..Limits::default() };
        assert_eq!(limits.check_memory((10_000, 10_000), 300_000_000), Ok(()));
        let reason = limits.check_memory((10_000, 10_000), 300_000_001).unwrap_err();
        assert!(
            reason.contains("10000x10000") && reason.contains("301 MB") && reason.contains("the 300 MB"),
            "{reason}"
        );
        assert!(reason.contains("--max-memory"), "{reason}");
        // More than an address can tell apart.
        let reason = Limits::default().check_memory((1, 1), 1 << 60).unwrap_err();
        assert!(reason.contains("the system does not give"), "{reason}");
        assert!(is_given(1 << 20) && !is_given(u64::MAX));
    }

    #[test]
    fn what_cannot_be_there_is_known_by_the_length() {
        assert_eq!(check_length(100, 100 * DEFLATE, DEFLATE), Ok(()));
        assert!(check_length(99, 100 * DEFLATE, DEFLATE).unwrap_err().contains("truncated"));
        assert!(check_length(99, 100, tiff_packing(1)).is_err() && check_length(9, 100, tiff_packing(34712)).is_ok());
        assert_eq!(room::<u16>(3).unwrap(), [0; 3]);
        assert!(room::<u64>(usize::MAX / 8).unwrap_err().contains("does not give the memory"));
    }

    #[test]
    fn files_may_be_as_long_as_their_pixels() {
        assert_eq!(Limits { max_pixels: 1000, memory: None }.most_bytes(), 16_000 + (256 << 20));
        assert_eq!(Limits { max_pixels: 1000, memory: Some(5) }.most_bytes(), 5);
        assert_eq!(Limits { max_pixels: u64::MAX, memory: None }.most_bytes(), u64::MAX);
    }
}
