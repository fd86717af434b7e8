//! Intake: files into memory, whole and unchanged.
//!
//! In: a path, and how long the file may be. Out: all of its bytes, of one moment: a file that is written, cut or exchanged meanwhile is an
//! error, for half of one photograph and half of another is none. Cost: one read. Pipes are read to their end, as far as allowed.

use crate::error::{Error, Result};
use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// The most bytes of a response, a file of transforms, a report: those that are written take under a megabyte.
pub(crate) const MOST_OF_A_TEXT: u64 = 64 << 20;

/// The most bytes of a plan: some 2 kB to a step.
pub(crate) const MOST_OF_A_PLAN: u64 = 1 << 30;

/// All bytes of the file `path`, of which there may be `most`.
///
/// # Errors
/// [`Error::Read`], also for folders, for what is longer, and where the memory for it is not given; [`Error::Changed`].
pub(crate) fn whole(path: &Path, most: u64) -> Result<Vec<u8>> {
    whole_if(path, most, |_| Ok(()))
}

/// Bytes by which a format is known.
const BEGIN: u64 = 512;

/// As [`whole`], of what `is_wanted` by its first bytes; nothing more is read of others, which may have no end.
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
        return Err(unreadable(too_long(length, most)));
    }
    let mut bytes = Vec::new();
    let expected = usize::try_from(length).unwrap_or(usize::MAX).saturating_add(1);
    bytes.try_reserve_exact(expected).map_err(|_| unreadable(not_given(length)))?;
    // One more than there should be: a file that grows is seen by it, and one that has no end as well.
    let read = if is_file { length.saturating_add(1) } else { most.saturating_add(1) };
    (&mut file).take(read.min(BEGIN)).read_to_end(&mut bytes).map_err(unreadable)?;
    is_wanted(&bytes)?;
    (&mut file).take(read.saturating_sub(BEGIN)).read_to_end(&mut bytes).map_err(unreadable)?;
    if !is_file && bytes.len() as u64 > most {
        return Err(unreadable(too_long(bytes.len() as u64, most)));
    }
    let after = file.metadata().map_err(unreadable)?;
    if is_file && (bytes.len() as u64 != length || !is_same(&before, &after)) {
        return Err(Error::Changed { path: path.to_owned() });
    }
    Ok(bytes)
}

/// As [`whole`], for text; what is no UTF-8 in it becomes a replacement character.
///
/// # Errors
/// Those of [`whole`].
pub(crate) fn text(path: &Path, most: u64) -> Result<String> {
    let bytes = whole(path, most)?;
    Ok(String::from_utf8(bytes).unwrap_or_else(|e| String::from_utf8_lossy(e.as_bytes()).into_owned()))
}

/// The file `path`, open, if it is no folder.
///
/// # Errors
/// [`Error::Read`].
pub(crate) fn open(path: &Path) -> Result<File> {
    let unreadable = |source| Error::Read { path: path.to_owned(), source };
    if path.is_dir() {
        let reason = "it is a folder; name the files in it, as in `folder/*.jpg`";
        return Err(unreadable(io::Error::new(io::ErrorKind::IsADirectory, reason)));
    }
    File::open(path).map_err(unreadable)
}

/// As [`open`], but of what can be read from any place again: no pipe and no device, which may never end, or keep who opens them waiting.
///
/// # Errors
/// [`Error::Read`].
pub(crate) fn open_regular(path: &Path) -> Result<File> {
    let unreadable = |source| Error::Read { path: path.to_owned(), source };
    let metadata = std::fs::metadata(path).map_err(unreadable)?;
    if !metadata.is_file() && !metadata.is_dir() {
        let reason = "it is a pipe or a device; name a file";
        return Err(unreadable(io::Error::new(io::ErrorKind::InvalidInput, reason)));
    }
    open(path)
}

fn too_long(length: u64, most: u64) -> io::Error {
    let mb = |bytes: u64| bytes.div_ceil(1_000_000);
    let reason = format!(
        "it is of {} MB or more, and {} MB may be read; it is no such file, or allow more with --max-pixels and --max-memory",
        mb(length),
        mb(most)
    );
    io::Error::new(io::ErrorKind::InvalidInput, reason)
}

fn not_given(length: u64) -> io::Error {
    let mb = length.div_ceil(1_000_000);
    let reason = format!(
        "it is of {mb} MB, and the system does not give that much memory; end other programs, or raise `ulimit -v`"
    );
    io::Error::new(io::ErrorKind::InvalidInput, reason)
}

/// What tells one file from another, by whatever name: device and inode. Hard links are one file, too.
#[cfg(unix)]
pub(crate) type Identity = (u64, u64);

/// The identity of the file or folder `path`, through links; none where there is no such file.
#[cfg(unix)]
pub(crate) fn identity(path: &Path) -> Option<Identity> {
    use std::os::unix::fs::MetadataExt;
    let metadata = std::fs::metadata(path).ok()?;
    Some((metadata.dev(), metadata.ino()))
}

/// What tells one file from another, by whatever name: the path that the system gives it.
#[cfg(not(unix))]
pub(crate) type Identity = PathBuf;

/// The identity of the file or folder `path`, through links; none where there is no such file.
#[cfg(not(unix))]
pub(crate) fn identity(path: &Path) -> Option<Identity> {
    std::fs::canonicalize(path).ok()
}

fn is_same(a: &Metadata, b: &Metadata) -> bool {
    a.len() == b.len() && a.modified().ok() == b.modified().ok()
}

/// A file at one moment: by this it is known again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Stamp {
    path: PathBuf,
    length: u64,
    modified: Option<SystemTime>,
}

impl Stamp {
    /// Of the file `path`, now.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub(crate) fn of(path: &Path) -> Result<Stamp> {
        let metadata = std::fs::metadata(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        Ok(Stamp { path: path.to_owned(), length: metadata.len(), modified: metadata.modified().ok() })
    }

    /// Refuses a file that is another now, or is gone.
    ///
    /// # Errors
    /// [`Error::Changed`].
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

    /// A sparse file takes no room on the disk, whatever it says of its length.
    #[test]
    fn an_absurd_length_is_refused_before_it_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let error = whole(&path, 1 << 30).unwrap_err().to_string();
        assert!(error.contains("1099512 MB") && error.contains("1074 MB"), "{error}");
        // Allowed, but no machine gives it: the address space of a process ends at 2^47.
        File::create(&path).unwrap().set_len(1 << 42).unwrap();
        if !crate::limits::is_given(1 << 42) {
            assert!(whole(&path, 1 << 50).unwrap_err().to_string().contains("does not give that much memory"));
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_has_no_end_is_left_at_the_limit() {
        let error = whole(Path::new("/dev/zero"), 5_000_000).unwrap_err().to_string();
        assert!(error.contains("6 MB or more, and 5 MB may be read"), "{error}");
        assert!(open_regular(Path::new("/dev/zero")).unwrap_err().to_string().contains("a pipe or a device"));
    }

    /// Files that say nothing of their length and are longer: those of /proc are seen as files that grew.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_that_grows_is_refused() {
        assert!(matches!(whole(Path::new("/proc/self/status"), 1 << 20), Err(Error::Changed { .. })));
    }

    /// Each change comes after the first bytes were read and before the others are.
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
            // Two writes within one tick of the clock are of one time.
            write().set_modified(SystemTime::now() - Duration::from_secs(60)).unwrap();
            let changed = |_: &[u8]| {
                change();
                Ok(())
            };
            assert!(matches!(whole_if(&path, 1 << 20, changed), Err(Error::Changed { .. })), "{name}");
        }
        // Another file under the same name is not the one that is open.
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
