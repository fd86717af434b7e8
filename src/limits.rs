//! Limits on the size of images, checked against the header of a file before memory is allocated for it.
//!
//! In: sizes from headers. Out: nothing, or the reason and what to do. Cost: negligible. Without these limits, a file
//! of a few kilobytes can take all memory: its header can claim terabytes, and its compressed data can expand to
//! gigabytes of zeros.

use std::hint::black_box;

/// Limits for input files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Limits {
    /// Largest number of pixels of an image. Default: [`MAX_PIXELS`](Self::MAX_PIXELS).
    pub max_pixels: u64,
    /// Maximum memory in bytes for one file, its decoded image, and what is computed from the image. Default: only the
    /// limit of the system.
    pub memory: Option<u64>,
}

impl Default for Limits {
    fn default() -> Self {
        Limits { max_pixels: Limits::MAX_PIXELS, memory: None }
    }
}

/// Memory in bytes that must be available in addition to that for an image. Without it, a later allocation could fail
/// and abort the process.
const BESIDE: u64 = 16 << 20;

impl Limits {
    /// Default of [`max_pixels`](Self::max_pixels): 500 million, which is 1.5 GB at 8 bits. No camera produces more,
    /// not even by shifting the sensor (400 million).
    pub const MAX_PIXELS: u64 = 500_000_000;

    /// Largest number of bytes per pixel in common files of the supported formats: four floats. Files with more bytes
    /// per pixel may have fewer pixels.
    const BYTES_PER_PIXEL: u64 = 16;

    /// Checks that an image has pixels, and not more than allowed.
    ///
    /// # Errors
    /// The reason and what to do.
    pub(crate) fn check_size(&self, width: usize, height: usize) -> Result<(), String> {
        let pixels = width as u128 * height as u128;
        if pixels == 0 {
            return Err("it has no pixels".into());
        }
        if pixels > u128::from(self.max_pixels) {
            return Err(format!(
                "according to its header it has {width}x{height} pixels, more than the {} allowed; if it is really so \
                 large, give `--max-pixels {}M`; otherwise it is damaged, copy the file again",
                words(self.max_pixels),
                pixels.div_ceil(1_000_000)
            ));
        }
        Ok(())
    }

    /// Returns these limits with less memory, because `bytes` of it are in use already.
    pub(crate) fn beside(&self, bytes: u64) -> Limits {
        Limits { memory: self.memory.map(|memory| memory.saturating_sub(bytes)), ..*self }
    }

    /// Checks that decoding an image of `size` pixels, which takes `bytes` of memory, is allowed and possible.
    ///
    /// # Errors
    /// The reason and what to do, if `bytes` exceeds the limit or what the system provides.
    pub(crate) fn check_memory(&self, size: (usize, usize), bytes: u64) -> Result<(), String> {
        self.check_memory_while("decoding", size, bytes)
    }

    /// As [`check_memory`](Self::check_memory) for another operation; `doing` is its name for the message, such as
    /// "decoding".
    ///
    /// # Errors
    /// Those of [`check_memory`](Self::check_memory).
    pub(crate) fn check_memory_while(
        &self,
        doing: &str,
        (width, height): (usize, usize),
        bytes: u64,
    ) -> Result<(), String> {
        let needs = || format!("{doing} its {width}x{height} pixels needs {} MB", bytes.div_ceil(1_000_000));
        if let Some(allowed) = self.memory.filter(|&allowed| bytes > allowed) {
            let allowed = allowed / 1_000_000;
            return Err(format!(
                "{}, more than the {allowed} MB that remain of the memory limit; raise it with --max-memory, or scale the \
                 image down",
                needs()
            ));
        }
        if !is_available(bytes) {
            return Err(format!(
                "{}, but the system does not provide that much memory; close other programs, raise `ulimit -v`, or scale \
                 all frames down",
                needs()
            ));
        }
        Ok(())
    }

    /// Returns the largest size of a file, in bytes: the size of uncompressed pixels, and 256 MiB for other data of the
    /// camera. It is not more than the memory limit.
    pub(crate) fn most_bytes(&self) -> u64 {
        let by_pixels = self.max_pixels.saturating_mul(Limits::BYTES_PER_PIXEL).saturating_add(256 << 20);
        self.memory.map_or(by_pixels, |memory| memory.min(by_pixels))
    }
}

/// Whether the system provides `bytes` of memory, plus [`BESIDE`]. The memory is reserved but not touched, so the check
/// is cheap.
pub(crate) fn is_available(bytes: u64) -> bool {
    let Ok(bytes) = usize::try_from(bytes.saturating_add(BESIDE)) else { return false };
    let mut reserved: Vec<u8> = Vec::new();
    let is_available = reserved.try_reserve_exact(bytes).is_ok();
    // This prevents the compiler from removing the allocation, which is not used.
    black_box(reserved.as_ptr());
    is_available
}

/// Largest factor by which deflate expands data: 2 bits can represent 258 bytes (RFC 1951).
pub(crate) const DEFLATE: u64 = 1032;

/// Returns the largest factor by which a TIFF compression expands data (TIFF 6.0, sections 9 and 13); `u64::MAX` for
/// unknown compressions.
pub(crate) fn tiff_packing(compression: u32) -> u64 {
    match compression {
        1 => 1,
        32773 => 64,
        // LZW: a code of 12 bits represents fewer than 4096 bytes.
        5 => 4096 * 2 / 3,
        8 | 32946 => DEFLATE,
        _ => u64::MAX,
    }
}

/// Checks that a file of `length` bytes can contain `bytes` of pixels, if its compression expands data by a factor of
/// at most `most`.
///
/// # Errors
/// The reason and what to do, if the file is too short.
pub(crate) fn check_length(length: usize, bytes: u64, most: u64) -> Result<(), String> {
    if bytes / most > length as u64 {
        return Err("the file is too short for the width and height of its picture (truncated); copy it again".into());
    }
    Ok(())
}

/// Returns an empty vector with capacity for `count` values.
///
/// # Errors
/// The reason and what to do, if the system does not provide the memory.
pub(crate) fn reserved<T>(count: usize) -> Result<Vec<T>, String> {
    let mut values = Vec::new();
    match values.try_reserve_exact(count) {
        Ok(()) => Ok(values),
        Err(_) => Err("not enough memory for its pixels; close other programs, or scale all frames down".into()),
    }
}

/// Returns a vector of `count` default values.
///
/// # Errors
/// Those of [`reserved`].
pub(crate) fn room<T: Copy + Default>(count: usize) -> Result<Vec<T>, String> {
    let mut values = reserved(count)?;
    values.resize(count, T::default());
    Ok(values)
}

/// Returns `count` as text; whole millions are given in millions.
fn words(count: u64) -> String {
    let is_in_millions = count > 0 && count.is_multiple_of(1_000_000);
    if is_in_millions { format!("{} million", count / 1_000_000) } else { count.to_string() }
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
        let reason = Limits { max_pixels: 1_900_000, memory: None }.check_size(1500, 1300).unwrap_err();
        assert!(reason.contains("the 1900000 allowed") && reason.contains("--max-pixels 2M"), "{reason}");
    }

    #[test]
    fn memory_is_limited_by_the_option_and_by_the_machine() {
        let limits = Limits { memory: Some(300_000_000), ..Limits::default() };
        assert_eq!(limits.check_memory((10_000, 10_000), 300_000_000), Ok(()));
        let reason = limits.check_memory((10_000, 10_000), 300_000_001).unwrap_err();
        assert!(
            reason.contains("10000x10000") && reason.contains("301 MB") && reason.contains("the 300 MB"),
            "{reason}"
        );
        assert!(reason.contains("--max-memory"), "{reason}");
        // 2^60 bytes exceed the address space.
        let reason = Limits::default().check_memory((1, 1), 1 << 60).unwrap_err();
        assert!(reason.contains("the system does not provide"), "{reason}");
        assert!(is_available(1 << 20) && !is_available(u64::MAX));
    }

    #[test]
    fn impossible_content_is_detected_by_the_length() {
        assert_eq!(check_length(100, 100 * DEFLATE, DEFLATE), Ok(()));
        assert!(check_length(99, 100 * DEFLATE, DEFLATE).unwrap_err().contains("truncated"));
        assert!(check_length(99, 100, tiff_packing(1)).is_err() && check_length(9, 100, tiff_packing(34712)).is_ok());
        assert_eq!(room::<u16>(3).unwrap(), [0; 3]);
        assert!(room::<u64>(usize::MAX / 8).unwrap_err().contains("not enough memory"));
    }

    #[test]
    fn files_may_be_as_long_as_their_pixels() {
        assert_eq!(Limits { max_pixels: 1000, memory: None }.most_bytes(), 16_000 + (256 << 20));
        assert_eq!(Limits { max_pixels: 1000, memory: Some(5) }.most_bytes(), 5);
        assert_eq!(Limits { max_pixels: u64::MAX, memory: None }.most_bytes(), u64::MAX);
    }
}
