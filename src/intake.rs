//! Reading of complete files into memory.
//!
//! In: a path, and the largest size. Out: all bytes of the file at one moment. It is an error if the file is written
//! or truncated while it is read. (If another file gets its name meanwhile, the old file is read.) Cost: one read.
//! Pipes are read to their end or to the largest size.

use crate::error::{Error, Result};
use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Largest size of reports, of response files, and of files with transforms, in bytes. A JSON report of a bracket has
/// about 2 kB per photograph, a file with transforms less than 1 kB per photograph. A response file that hdralign
/// writes has at most 30 kB.
pub(crate) const MOST_OF_A_TEXT: u64 = 64 << 20;

/// Largest size of a plan of batch jobs, in bytes. One job takes about 1 kB.
pub(crate) const MOST_OF_A_PLAN: u64 = 1 << 30;

/// Reads all bytes of the file `path`, at most `most`.
///
/// # Errors
/// [`Error::Read`], also for folders, for files larger than `most`, and if there is not enough memory;
/// [`Error::Changed`].
pub(crate) fn whole(path: &Path, most: u64) -> Result<Vec<u8>> {
    whole_if(path, most, |_| Ok(()))
}

/// Number of bytes at the beginning of a file by which its format is recognised.
const BEGIN: u64 = 512;

/// As [`whole`], but only if `is_wanted` accepts the first bytes. If it does not, nothing more is read, because the
/// file may be endless.
///
/// # Errors
/// Those of [`whole`] and of `is_wanted`.
pub(crate) fn whole_if(path: &Path, most: u64, is_wanted: impl FnOnce(&[u8]) -> Result<()>) -> Result<Vec<u8>> {
    let unreadable = |source| Error::Read { path: path.to_owned(), source };
    let mut file = open(path)?;
    let before = file.metadata().map_err(unreadable)?;
    let is_file = before.is_file();
    let length = if is_file { before.len() } else { 0 };
    if length > most {
        return Err(too_long(path, length, most));
    }
    let mut bytes = Vec::new();
    let expected = usize::try_from(length).unwrap_or(usize::MAX).saturating_add(1);
    if bytes.try_reserve_exact(expected).is_err() {
        let mb = length.div_ceil(1_000_000);
        let reason = "but the system does not provide that much memory; close other programs, or raise `ulimit -v`";
        return Err(refused(path, format!("it has {mb} MB, {reason}")));
    }
    // Reads one byte more than expected, to detect growing and endless files.
    let read = if is_file { length.saturating_add(1) } else { most.saturating_add(1) };
    (&mut file).take(read.min(BEGIN)).read_to_end(&mut bytes).map_err(unreadable)?;
    is_wanted(&bytes)?;
    (&mut file).take(read.saturating_sub(BEGIN)).read_to_end(&mut bytes).map_err(unreadable)?;
    if !is_file && bytes.len() as u64 > most {
        return Err(too_long(path, bytes.len() as u64, most));
    }
    let after = file.metadata().map_err(unreadable)?;
    if is_file && (bytes.len() as u64 != length || state(&before) != state(&after)) {
        return Err(Error::Changed { path: path.to_owned() });
    }
    Ok(bytes)
}

/// As [`whole`], for text; invalid UTF-8 becomes replacement characters.
///
/// # Errors
/// Those of [`whole`].
pub(crate) fn text(path: &Path, most: u64) -> Result<String> {
    let bytes = whole(path, most)?;
    Ok(String::from_utf8(bytes).unwrap_or_else(|e| String::from_utf8_lossy(e.as_bytes()).into_owned()))
}

/// Opens the file `path`, which must not be a folder.
///
/// # Errors
/// [`Error::Read`].
pub(crate) fn open(path: &Path) -> Result<File> {
    if path.is_dir() {
        return Err(refused(path, "it is a folder; name a file in it".into()));
    }
    File::open(path).map_err(|source| Error::Read { path: path.to_owned(), source })
}

/// As [`open`], but refuses pipes and devices: they may block or be endless, and cannot be read twice.
///
/// # Errors
/// [`Error::Read`].
pub(crate) fn open_regular(path: &Path) -> Result<File> {
    let metadata = std::fs::metadata(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    if !metadata.is_file() && !metadata.is_dir() {
        return Err(refused(path, "it is a pipe or a device; name a file".into()));
    }
    open(path)
}

/// Returns an error whose `reason` includes what to do. [`Error::Read`] adds no advice to errors of the kind
/// `InvalidInput`.
fn refused(path: &Path, reason: String) -> Error {
    Error::Read { path: path.to_owned(), source: io::Error::new(io::ErrorKind::InvalidInput, reason) }
}

fn too_long(path: &Path, length: u64, most: u64) -> Error {
    let [length, most] = [length, most].map(|bytes| bytes.div_ceil(1_000_000));
    let reason = format!(
        "it has {length} MB or more, but at most {most} MB are read; name another file (for an image, --max-pixels and \
         --max-memory allow more)"
    );
    refused(path, reason)
}

/// Identity of a file that does not depend on its name: device and inode. Hard links are the same file.
#[cfg(unix)]
pub(crate) type Identity = (u64, u64);

/// The identity of the file or folder `path`, following links; `None` if it does not exist.
#[cfg(unix)]
pub(crate) fn identity(path: &Path) -> Option<Identity> {
    use std::os::unix::fs::MetadataExt;
    let metadata = std::fs::metadata(path).ok()?;
    Some((metadata.dev(), metadata.ino()))
}

/// Identity of a file that does not depend on its name: its canonical path.
#[cfg(not(unix))]
pub(crate) type Identity = PathBuf;

/// The identity of the file or folder `path`, following links; `None` if it does not exist.
#[cfg(not(unix))]
pub(crate) fn identity(path: &Path) -> Option<Identity> {
    std::fs::canonicalize(path).ok()
}

/// Length of a file and time of its last modification. A change of either shows that the file was changed.
type State = (u64, Option<SystemTime>);

fn state(metadata: &Metadata) -> State {
    (metadata.len(), metadata.modified().ok())
}

/// The state of a file at one moment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Stamp {
    path: PathBuf,
    state: State,
}

impl Stamp {
    /// The current state of the file `path`.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub(crate) fn of(path: &Path) -> Result<Stamp> {
        let metadata = std::fs::metadata(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        Ok(Stamp { path: path.to_owned(), state: state(&metadata) })
    }

    /// Checks that the file is unchanged since this stamp was made.
    ///
    /// # Errors
    /// [`Error::Changed`] if it was changed or removed.
    pub(crate) fn check(&self) -> Result<()> {
        match Stamp::of(&self.path) {
            Ok(now) if now == *self => Ok(()),
            _ => Err(Error::Changed { path: self.path.clone() }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_whole_up_to_its_limit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, b"0123456789").unwrap();
        assert_eq!(whole(&path, 10).unwrap(), b"0123456789");
        let error = whole(&path, 9).unwrap_err().to_string();
        assert!(error.contains("1 MB or more") && error.contains("--max-pixels"), "{error}");
        std::fs::write(&path, b"").unwrap();
        assert_eq!(whole(&path, 0).unwrap(), b"");
        assert!(whole(dir.path(), 9).unwrap_err().to_string().contains("it is a folder"));
        assert!(matches!(whole(&dir.path().join("gone"), 9), Err(Error::Read { .. })));
        std::fs::write(&path, b"caf\xe9").unwrap();
        assert_eq!(text(&path, 9).unwrap(), "caf\u{fffd}");
        let long: Vec<u8> = (0..2000).map(|i| (i % 251) as u8).collect();
        std::fs::write(&path, &long).unwrap();
        assert_eq!(whole(&path, 2000).unwrap(), long);
        let unwanted = whole_if(&path, 2000, |begin| {
            assert_eq!(begin, &long[..512]);
            Err(Error::Changed { path: path.clone() })
        });
        assert!(unwanted.is_err());
    }

    /// The files are sparse, so they take no space on the disk.
    #[test]
    fn impossible_length_is_rejected_before_reading() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let error = whole(&path, 1 << 30).unwrap_err().to_string();
        assert!(error.contains("1099512 MB") && error.contains("1074 MB"), "{error}");
        // This file is within the allowed size, but a usual machine does not have so much memory.
        File::create(&path).unwrap().set_len(1 << 42).unwrap();
        if !crate::limits::is_available(1 << 42) {
            assert!(whole(&path, 1 << 50).unwrap_err().to_string().contains("does not provide that much memory"));
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn endless_input_is_read_up_to_the_limit() {
        let error = whole(Path::new("/dev/zero"), 5_000_000).unwrap_err().to_string();
        assert!(error.contains("6 MB or more, but at most 5 MB are read"), "{error}");
        assert!(open_regular(Path::new("/dev/zero")).unwrap_err().to_string().contains("a pipe or a device"));
    }

    /// The metadata of files in /proc has the length 0, so they seem to grow.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_that_grows_is_refused() {
        assert!(matches!(whole(Path::new("/proc/self/status"), 1 << 20), Err(Error::Changed { .. })));
    }

    /// Each change happens after the first bytes were read and before the rest.
    #[test]
    fn file_changed_between_two_reads_is_refused() {
        use std::io::Write;
        use std::time::Duration;
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let length = 4 * BEGIN as usize;
        let write = || File::options().write(true).open(&path).unwrap();
        let append = || File::options().append(true).open(&path).unwrap().write_all(&[2]).unwrap();
        let cut = || write().set_len(BEGIN + 1).unwrap();
        let overwrite = || write().write_all(&vec![2; length]).unwrap();
        let changes: [(&str, &dyn Fn()); 3] = [("append", &append), ("cut", &cut), ("overwrite", &overwrite)];
        for (name, change) in changes {
            std::fs::write(&path, vec![1; length]).unwrap();
            // The time is set back, because two writes within one tick of the clock have the same time.
            write().set_modified(SystemTime::now() - Duration::from_secs(60)).unwrap();
            let changed = |_: &[u8]| {
                change();
                Ok(())
            };
            assert!(matches!(whole_if(&path, 1 << 20, changed), Err(Error::Changed { .. })), "{name}");
        }
        // This gives the name to another file, which does not change the file that is open.
        std::fs::write(&path, vec![1; length]).unwrap();
        let replace = |_: &[u8]| {
            std::fs::write(dir.path().join("b"), [2]).unwrap();
            std::fs::rename(dir.path().join("b"), &path).unwrap();
            Ok(())
        };
        assert_eq!(whole_if(&path, 1 << 20, replace).unwrap(), vec![1; length]);
    }

    #[test]
    fn a_stamp_knows_its_file_again() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, b"01").unwrap();
        let stamp = Stamp::of(&path).unwrap();
        stamp.check().unwrap();
        std::fs::write(&path, b"012").unwrap();
        let error = stamp.check().unwrap_err();
        assert!(error.to_string().contains("was changed while it was read"), "{error}");
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(stamp.check(), Err(Error::Changed { .. })));
    }
}
